"""The rules of the game, all of them, compiled.

Every net is an agent. Its pins are cut into two-pin tasks (:mod:`marouting.trees.decomposition`).
The agent walks them one after the other, one Gcell per move, from a task's start to its target.

* A move **crosses** an edge that the net already uses (no new demand), a via, or an edge whose
  remaining capacity covers the net's demand; with ``overflow="allowed"`` any edge. Then the net
  uses the edge, and its demand is taken.
* Any other move is **blocked**, and so is a move off the grid: the agent stays where it is.
* Either way the step counts. A task ends **joined** on its target, or **failed** after
  ``max_steps`` steps; then the next task starts at its own start pin. The net keeps what it used.
* An agent **terminates** when all its tasks are joined. It is **truncated** when its last task has
  ended and some task failed. The episode of a problem ends with its last agent.
* The nets take turns in ``net_order``: ``sequential``, a net routes to its end before the next
  starts (the paper), or ``round_robin``, one step each.

A step has two halves, move and settle, so that a learner can see where a move arrived before the
next task puts the agent on another pin.
"""

from typing import Any

import numpy as np

from marouting.game.state import MASKS, NOBODY, Crossing, Dynamic, Ending, Static, Status
from marouting.kernels import inlined, place, wide
from marouting.problem.grid import MOVES, VIA_AXIS

# Without branches as far as can be: what an agent meets is as good as random, and a branch that the
# processor guesses wrong takes as long as a whole move.


@inlined
def uses(used: Any, m: int, n: int, edge: int) -> int:
    """1 if agent n of problem m uses an edge, else 0."""
    return used[m, n, edge >> 3] >> (edge & 7) & 1


@inlined
def demand_of(static: Static, m: int, n: int, cell: int, move: int) -> int:
    """What the edge that a move crosses would cost the net: nothing for a via."""
    demand = static.demand[m, n, place(static.position[cell, VIA_AXIS])]
    return demand * (move // 2 != VIA_AXIS)


@inlined
def has_room(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int) -> int:
    """1 if a move from a Gcell crosses an edge that the net uses or whose demand it can pay."""
    edge = place(static.edge[cell, move])
    via = move // 2 == VIA_AXIS
    room = dynamic.remaining[m, edge] >= demand_of(static, m, n, cell, move)
    return (via | room | uses(dynamic.used, m, n, edge)) & (static.exits[cell] >> move)


@inlined
def may_cross(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int) -> int:
    """1 if a move from a Gcell crosses its edge, 0 if it is blocked."""
    anyway = static.overflow_allowed & (static.exits[cell] >> move)
    return has_room(static, dynamic, m, n, cell, move) | anyway


@inlined
def move_agent(static: Static, dynamic: Dynamic, m: int, n: int, move: int) -> None:
    """One step of one agent: the edge is crossed or not, the task ends or not."""
    agent = dynamic.agents[m, n]
    game = dynamic.games[m]
    cell = place(agent.cell)
    edge = place(static.edge[cell, move])
    crosses = may_cross(static, dynamic, m, n, cell, move)
    own = crosses & uses(dynamic.used, m, n, edge)
    new = crosses ^ own
    demand = new * demand_of(static, m, n, cell, move)
    remaining = dynamic.remaining[m, edge]
    agent.crossing = Crossing.BLOCKED + new + 2 * own  # NEW and OWN are the two that follow
    agent.added_overflow = 0
    if remaining < demand:
        # Only the part of the demand that the remaining capacity does not cover overflows.
        agent.added_overflow = demand - max(remaining, 0)
        game.overflow += agent.added_overflow
    dynamic.remaining[m, edge] = remaining - demand
    dynamic.used[m, n, edge >> 3] |= np.uint8(new << (edge & 7))
    game.wirelength += new
    ahead = static.neighbour[cell, move]
    agent.cell = ahead if crosses else agent.cell
    agent.steps += 1
    game.steps += 1
    agent.ending = Ending.NONE
    if agent.cell == agent.target:
        agent.ending = Ending.JOINED
        agent.joined += 1
        game.joined += 1
    elif agent.steps >= static.max_steps:
        agent.ending = Ending.FAILED


@inlined
def wait(dynamic: Dynamic, m: int, n: int) -> None:
    """No step: what the agent's last move did is forgotten."""
    agent = dynamic.agents[m, n]
    agent.added_overflow = 0
    agent.crossing = Crossing.NONE
    agent.ending = Ending.NONE


@inlined
def begin_task(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> None:
    """Puts an agent on the start pin of a task."""
    agent = dynamic.agents[m, n]
    agent.task = task
    agent.cell = static.tasks[task, 0]
    agent.target = static.tasks[task, 1]
    agent.steps = 0


@inlined
def settle_agent(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """After a move: an agent whose task has ended starts its next one, or is done."""
    agent = dynamic.agents[m, n]
    if agent.ending == Ending.NONE or agent.status != Status.ACTIVE:
        return
    if agent.task + 1 < static.first[m, n + 1]:
        begin_task(static, dynamic, m, n, wide(agent.task + 1))
        return
    tasks = static.first[m, n + 1] - static.first[m, n]
    agent.status = Status.TERMINATED if agent.joined == tasks else Status.TRUNCATED
    dynamic.games[m].active -= 1


@inlined
def pass_turn(static: Static, dynamic: Dynamic, m: int) -> None:
    """The turn goes to the next agent: the same one while it routes, if the order is sequential."""
    game = dynamic.games[m]
    if game.active == 0:
        game.agent = NOBODY
        return
    agents = static.order.shape[1]
    turn = game.turn if static.sequential else (game.turn + 1) % agents
    while True:
        n = static.order[m, turn]
        if n != NOBODY and dynamic.agents[m, n].status == Status.ACTIVE:
            break
        turn = (turn + 1) % agents
    game.turn = turn
    game.agent = n


@inlined
def reset_problem(static: Static, dynamic: Dynamic, m: int) -> None:
    """All agents of a problem back to their first pin, all capacity free."""
    # Loops instead of slices: they compile in a tenth of the time.
    for edge in range(static.capacity.shape[1]):
        dynamic.remaining[m, edge] = static.capacity[m, edge]
    game = dynamic.games[m]
    if game.steps != 0:
        for n in range(static.order.shape[1]):
            for byte in range(dynamic.used.shape[2]):
                dynamic.used[m, n, byte] = 0
    game.turn = game.active = game.joined = game.steps = 0
    game.overflow = game.wirelength = 0
    for n in range(static.order.shape[1]):
        agent = dynamic.agents[m, n]
        agent.joined = 0
        wait(dynamic, m, n)
        if static.first[m, n] < static.first[m, n + 1]:
            agent.status = Status.ACTIVE
            game.active += 1
            begin_task(static, dynamic, m, n, wide(static.first[m, n]))
        else:
            agent.status = Status.ABSENT
    game.agent = static.order[m, 0]


@inlined
def move_player(static: Static, dynamic: Dynamic, m: int, move: int) -> None:
    """In one problem, the agent whose turn it is moves, unless it is told not to."""
    n = wide(dynamic.games[m].agent)
    if n == NOBODY:
        return
    if move == NOBODY:
        wait(dynamic, m, n)
    else:
        move_agent(static, dynamic, m, n, move)


@inlined
def settle_player(static: Static, dynamic: Dynamic, m: int) -> None:
    """After the move of :func:`move_player`: the next task starts, and the turn passes."""
    n = wide(dynamic.games[m].agent)
    if n != NOBODY:
        settle_agent(static, dynamic, m, n)
        pass_turn(static, dynamic, m)


@inlined
def move_everyone(static: Static, dynamic: Dynamic, m: int, moves: Any) -> None:
    """In one problem, all agents move once by ``moves`` (M, N), in turn order.

    If the order is sequential, the one whose turn it is moves alone.
    """
    playing = dynamic.games[m].agent
    for k in range(static.order.shape[1]):
        if static.order[m, k] == NOBODY:
            break
        n = place(static.order[m, k])
        if (
            dynamic.agents[m, n].status == Status.ACTIVE
            and moves[m, n] != NOBODY
            and (n == playing or not static.sequential)
        ):
            move_agent(static, dynamic, m, n, place(moves[m, n]))
        else:
            wait(dynamic, m, n)


@inlined
def settle_turns(static: Static, dynamic: Dynamic, m: int) -> None:
    """After all agents of a problem have settled: the turn passes where it has to."""
    playing = wide(dynamic.games[m].agent)
    if playing != NOBODY and (
        static.sequential or dynamic.agents[m, playing].status != Status.ACTIVE
    ):
        pass_turn(static, dynamic, m)


@inlined
def settle_everyone(static: Static, dynamic: Dynamic, m: int) -> None:
    """After the moves of :func:`move_everyone`: next tasks start, and the turn passes."""
    for n in range(static.order.shape[1]):
        settle_agent(static, dynamic, m, n)
    settle_turns(static, dynamic, m)


@inlined
def free_moves(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The moves of an agent that cross an edge, a bit each."""
    cell = place(dynamic.agents[m, n].cell)
    free = wide(0)
    for move in range(MOVES):
        free |= wide(may_cross(static, dynamic, m, n, cell, move)) << move
    return free


@inlined
def write_mask(static: Static, dynamic: Dynamic, m: int, n: int, out: Any, row: int) -> None:
    """Fills a row of ``out`` (K, 6) with the moves of an agent that cross an edge; all if none."""
    free = wide(0)
    if n != NOBODY:
        free = free_moves(static, dynamic, m, place(n))
    for move in range(MOVES):
        out[row, move] = MASKS[free, move]
