"""The tasks of agents: which is next, and where it begins.

The rules are in the section "Tasks" of :mod:`marouting.game`. The options ``target`` and
``next_pin`` keep the net's **tree**, all Gcells that its edges connect to its first pin. With
Steiner trees, "pin" stands for Steiner points as well.
"""

from marouting.batch.bits import empty, has, next_in, put
from marouting.batch.edges import uses
from marouting.batch.places import distance
from marouting.batch.state import Dynamic, Option, Static
from marouting.game import NOBODY, Crossing, Ending
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import MOVES


@compiled
def is_on(static: Static, option: int) -> bool:
    """Whether an option is switched on."""
    return static.options[option] > 0


@compiled
def holds(static: Static, dynamic: Dynamic, m: int, which: int, n: int, element: int) -> int:
    """1 if agent n's set of a kind (``TREE`` to ``BEGUN``) has a Gcell, edge or task, else 0."""
    row = as_index(static.options[which] + n)
    return has(dynamic.sets, m, row, element)


@compiled
def insert(static: Static, dynamic: Dynamic, m: int, which: int, n: int, element: int) -> None:
    """Puts a Gcell, edge or task into a set of an agent."""
    row = as_index(static.options[which] + n)
    put(dynamic.sets, m, row, element, i64(1))


@compiled
def clear(static: Static, dynamic: Dynamic, m: int, which: int, n: int) -> None:
    """Empties a set of an agent."""
    empty(dynamic.sets, m, as_index(static.options[which] + n))


@compiled
def keeps_tree(static: Static) -> bool:
    """Whether the options need the nets' trees."""
    return static.options[Option.TREE] >= 0


@compiled
def grow_tree(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """Finds all Gcells that a net's edges join to its first pin, and the tasks joined by them."""
    agent, numbers = dynamic.agents[m, n], dynamic.numbers
    queue = as_index(static.options[Option.QUEUE])
    first, end = i64(static.first[m, n]), i64(static.first[m, n + 1])
    clear(static, dynamic, m, Option.TREE, n)
    numbers[m, queue] = static.tasks[first, 0]
    insert(static, dynamic, m, Option.TREE, n, i64(numbers[m, queue]))
    at, size = 0, 1
    while at < size:
        cell = as_index(numbers[m, queue + at])
        at += 1
        for move in range(MOVES):
            ahead = i64(static.neighbour[cell, move])
            if (
                static.exits[cell] >> move & 1
                and uses(dynamic.used, m, n, as_index(static.edge[cell, move]))
                and not holds(static, dynamic, m, Option.TREE, n, ahead)
            ):
                insert(static, dynamic, m, Option.TREE, n, ahead)
                numbers[m, queue + size] = ahead
                size += 1
    joined = 0
    for task in range(first, end):
        joined += i64(holds(static, dynamic, m, Option.TREE, n, i64(static.tasks[task, 1])))
    dynamic.games[m].joined += joined - agent.joined
    agent.joined = joined


@compiled
def nearest_in_tree(static: Static, dynamic: Dynamic, m: int, n: int, pin: int) -> tuple[int, int]:
    """The Gcell of a net's tree that is nearest to another Gcell, and its distance."""
    nearest, least = i64(0), i64(1 << 62)
    row = as_index(static.options[Option.TREE] + n)
    cell = next_in(dynamic.sets, m, row, i64(0))
    while cell != NOBODY:
        far = distance(static, cell, pin)
        if (far, cell) < (least, nearest):
            nearest, least = cell, far
        cell = next_in(dynamic.sets, m, row, cell + 1)
    return nearest, least


@compiled
def is_later(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> bool:
    """Whether an agent may still begin a task, after its present one."""
    begun = task <= dynamic.agents[m, n].task
    if is_on(static, Option.NEAREST_NEXT):
        own = i64(task - static.first[m, n])
        begun = holds(static, dynamic, m, Option.BEGUN, n, own) != 0
    if keeps_tree(static):
        pin = i64(static.tasks[task, 1])
        begun |= holds(static, dynamic, m, Option.TREE, n, pin) != 0
    return not begun


@compiled
def next_nearest(
    static: Static, dynamic: Dynamic, m: int, n: int, far: int, after: int
) -> tuple[int, int]:
    """The later task, or NOBODY, whose pin is next after ``far`` and task ``after``; how far."""
    cell = as_index(dynamic.agents[m, n].cell)
    found, least = i64(NOBODY), i64(1 << 62)
    for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
        if not is_later(static, dynamic, m, n, i64(task)):
            continue
        away = distance(static, as_index(static.tasks[task, 1]), cell)
        if (away, task) > (far, after) and away < least:
            found, least = i64(task), away
    return found, least


@compiled
def next_task(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The task that an agent begins after its present one; NOBODY if there is none."""
    first, end = i64(static.first[m, n]), i64(static.first[m, n + 1])
    nearest = is_on(static, Option.NEAREST_NEXT)
    if not nearest:
        first = i64(dynamic.agents[m, n].task) + 1
    found, least = i64(NOBODY), i64(1 << 62)
    for task in range(first, end):
        if not is_later(static, dynamic, m, n, i64(task)):
            continue
        if not nearest:
            return i64(task)
        _, far = nearest_in_tree(static, dynamic, m, n, i64(static.tasks[task, 1]))
        if far < least:
            found, least = i64(task), far
    return found


@compiled
def clear_move(dynamic: Dynamic, m: int, n: int) -> None:
    """An agent does not move: clears what its last move did."""
    agent = dynamic.agents[m, n]
    agent.added_overflow = 0
    agent.crossing = Crossing.NONE
    agent.ending = Ending.NONE


@compiled
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
    if is_on(static, Option.NEAREST_NEXT):
        insert(static, dynamic, m, Option.BEGUN, n, i64(task - static.first[m, n]))
    if keeps_tree(static):
        pin = i64(static.tasks[task, 1])
        cell, _ = nearest_in_tree(static, dynamic, m, n, pin)
        agent.cell, agent.target = cell, pin
        if is_on(static, Option.TREE_TARGET):
            agent.cell, agent.target = pin, cell
    if is_on(static, Option.MASK_VISITED):
        clear(static, dynamic, m, Option.VISITED, n)
        insert(static, dynamic, m, Option.VISITED, n, i64(agent.cell))
    if is_on(static, Option.RELEASE_FAILED):
        clear(static, dynamic, m, Option.TAKEN, n)


@compiled
def begin_net(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """Puts an agent whose net uses no edge at the beginning of its first task, by the options."""
    agent = dynamic.agents[m, n]
    first = i64(static.first[m, n])
    dynamic.games[m].joined -= agent.joined
    agent.joined = 0
    agent.task = first - 1
    if is_on(static, Option.NEAREST_NEXT):
        clear(static, dynamic, m, Option.BEGUN, n)
    if keeps_tree(static):
        grow_tree(static, dynamic, m, n)
    begin_extended(static, dynamic, m, n, next_task(static, dynamic, m, n))
