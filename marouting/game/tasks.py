"""Which task an agent has, and where it stands when the task begins.

By the paper's rules the tasks of a net are begun in the order of its decomposition; the agent walks
from a task's start, which earlier tasks have reached, to its target, a new pin.

Two options know more of the net than that. Both keep the net's **tree**: all Gcells that its edges
join to its first pin. A task is joined when its new pin is in the tree, whoever joined it: a pin
that a route meets on its way is joined too, and its task is not begun any more.

* ``target: tree``: the agent starts at the new pin, and any Gcell of the tree ends the task. What
  it sees as its target is the Gcell of the tree that was nearest when the task began.
* ``next_task: nearest``: of the pins that are not in the tree and whose tasks have not been begun,
  the one nearest to the tree is next. With ``target: pin`` the agent starts at the Gcell of the
  tree nearest to it.

Distances are Manhattan distances over x, y and layer; ties go to the task listed first, and to the
Gcell with the lowest number. With Steiner trees, "pin" stands for Steiner points as well.
"""

from typing import Any

from marouting.game.edges import uses
from marouting.game.state import NOBODY, Dynamic, Static
from marouting.kernels import compiled, inlined, place, wide
from marouting.problem.grid import AXES, MOVES


@inlined
def holds(bits: Any, m: int, n: int, cell: int) -> int:
    """1 if a set of Gcells (M, N, ceil(G / 8)) of agent n of problem m has a Gcell, else 0."""
    return bits[m, n, cell >> 3] >> (cell & 7) & 1


@inlined
def insert(bits: Any, m: int, n: int, cell: int) -> None:
    """Puts a Gcell into a set of an agent."""
    bits[m, n, cell >> 3] |= 1 << (cell & 7)


@inlined
def clear(bits: Any, m: int, n: int) -> None:
    """Empties a set of an agent."""
    for byte in range(bits.shape[2]):
        bits[m, n, byte] = 0


@inlined
def keeps_tree(static: Static) -> bool:
    """Whether the options need the nets' trees."""
    return static.tree_target | static.nearest_next


@compiled
def grow_tree(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """Finds all Gcells that a net's edges join to its first pin, and the tasks joined by them."""
    agent, queue = dynamic.agents[m, n], static.queue
    first, end = wide(static.first[m, n]), wide(static.first[m, n + 1])
    clear(dynamic.tree, m, n)
    queue[m, 0] = static.tasks[first, 0]
    insert(dynamic.tree, m, n, wide(queue[m, 0]))
    at, size = 0, 1
    while at < size:
        cell = place(queue[m, at])
        at += 1
        for move in range(MOVES):
            ahead = wide(static.neighbour[cell, move])
            if (
                static.exits[cell] >> move & 1
                and uses(dynamic.used, m, n, place(static.edge[cell, move]))
                and not holds(dynamic.tree, m, n, ahead)
            ):
                insert(dynamic.tree, m, n, ahead)
                queue[m, size] = ahead
                size += 1
    joined = 0
    for task in range(first, end):
        joined += wide(holds(dynamic.tree, m, n, wide(static.tasks[task, 1])))
    dynamic.games[m].joined += joined - agent.joined
    agent.joined = joined


@compiled
def nearest_in_tree(static: Static, dynamic: Dynamic, m: int, n: int, pin: int) -> tuple[int, int]:
    """The Gcell of a net's tree that is nearest to another Gcell, and its distance."""
    nearest, least = wide(0), wide(1 << 62)
    for byte in range(dynamic.tree.shape[2]):
        bits = wide(dynamic.tree[m, n, byte])
        cell = 8 * byte
        while bits != 0:
            if bits & 1:
                distance = wide(0)
                for axis in range(AXES):
                    distance += abs(static.position[cell, axis] - static.position[pin, axis])
                if distance < least:
                    nearest, least = cell, distance
            bits >>= 1
            cell += 1
    return nearest, least


@inlined
def is_later(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> bool:
    """Whether an agent may still begin a task, after its present one."""
    begun = task <= dynamic.agents[m, n].task
    if static.nearest_next:
        begun = dynamic.tried[m, task - static.first[m, 0]] != 0
    if keeps_tree(static):
        begun |= holds(dynamic.tree, m, n, wide(static.tasks[task, 1])) != 0
    return not begun


@compiled
def next_task(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The task that an agent begins after its present one; NOBODY if there is none."""
    first, end = wide(static.first[m, n]), wide(static.first[m, n + 1])
    if not static.nearest_next:
        first = wide(dynamic.agents[m, n].task) + 1
    found, least = wide(NOBODY), wide(1 << 62)
    for task in range(first, end):
        if not is_later(static, dynamic, m, n, wide(task)):
            continue
        if not static.nearest_next:
            return wide(task)
        _, distance = nearest_in_tree(static, dynamic, m, n, wide(static.tasks[task, 1]))
        if distance < least:
            found, least = wide(task), distance
    return found


@inlined
def begin_task(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> None:
    """Puts an agent on the start pin of a task, by the paper's rules."""
    agent = dynamic.agents[m, n]
    agent.task = task
    agent.cell = static.tasks[task, 0]
    agent.target = static.tasks[task, 1]
    agent.steps = 0


@compiled
def begin_extended(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> None:
    """:func:`begin_task` by the options."""
    begin_task(static, dynamic, m, n, task)
    agent = dynamic.agents[m, n]
    if static.nearest_next:
        dynamic.tried[m, task - static.first[m, 0]] = 1
    if keeps_tree(static):
        pin = wide(static.tasks[task, 1])
        cell, _ = nearest_in_tree(static, dynamic, m, n, pin)
        agent.cell, agent.target = cell, pin
        if static.tree_target:
            agent.cell, agent.target = pin, cell
    if static.mask_visited:
        clear(dynamic.visited, m, n)
        insert(dynamic.visited, m, n, wide(agent.cell))
    if static.give_back:
        clear(dynamic.taken, m, n)


@compiled
def begin_net(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """Puts an agent whose net uses no edge at the beginning of its first task, by the options."""
    agent = dynamic.agents[m, n]
    first = wide(static.first[m, n])
    dynamic.games[m].joined -= agent.joined
    agent.joined = 0
    agent.task = first - 1
    for task in range(first, wide(static.first[m, n + 1])):
        if static.nearest_next:
            dynamic.tried[m, task - static.first[m, 0]] = 0
    if keeps_tree(static):
        grow_tree(static, dynamic, m, n)
    begin_extended(static, dynamic, m, n, next_task(static, dynamic, m, n))
