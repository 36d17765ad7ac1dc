"""All rules of the game, compiled.

:mod:`marouting.game` has the same rules in plain Python and is their definition: read them there.
``tests/test_game.py`` holds the two equal. Here they act on the arrays of
:mod:`marouting.batch.state`: edges in :mod:`.edges`, tasks and trees in :mod:`.tasks`, rip-up and
reroute in :mod:`.rounds`, the prices of the generalist's games in :mod:`.prices`.

A step has two halves, move and settle, so that a learner can see where a move arrived before the
next task puts the agent on another pin.
"""

from typing import Any

from marouting.batch.bits import byte_of, clear, empty, put
from marouting.batch.edges import demand_of, may_cross, take, use_edges, uses
from marouting.batch.prices import NO_LIMIT, first_present
from marouting.batch.rounds import all_rerouted, answer, final_status, judge, rip_up_next
from marouting.batch.state import MASKS, Dynamic, Option, Static
from marouting.batch.tasks import (
    begin_extended,
    begin_net,
    begin_task,
    clear_move,
    grow_tree,
    holds,
    insert,
    is_on,
    keeps_tree,
    next_task,
)
from marouting.game import NOBODY, RIP_UP, Crossing, Ending, Status
from marouting.kernels import as_index, compiled, i64, inlined
from marouting.problem.grid import MOVES

_SIX = (1 << MOVES) - 1


@inlined
def cross_edge(static: Static, dynamic: Dynamic, m: int, n: int, move: int, tries: int) -> int:
    """One step of one agent, blocked if ``tries`` is 0; returns 1 for an edge new to the net."""
    agent = dynamic.agents[m, n]
    game = dynamic.games[m]
    cell = as_index(agent.cell)
    edge = as_index(static.edge[cell, move])
    crosses = tries & may_cross(static, dynamic, m, n, cell, move)
    own = crosses & uses(dynamic.used, m, n, edge)
    new = crosses ^ own
    agent.crossing = Crossing.BLOCKED + new + 2 * own  # BLOCKED, NEW or OWN: 1, 2 or 3
    demand = i64(new * demand_of(static, m, n, cell, move))
    agent.added_overflow = take(dynamic, m, edge, demand)
    put(dynamic.used, m, n, edge, new)
    game.wirelength += new
    ahead = static.neighbour[cell, move]
    agent.cell = ahead if crosses else agent.cell
    agent.steps += 1
    game.steps += 1
    return new


@inlined
def end_task(static: Static, dynamic: Dynamic, m: int, n: int, arrived: bool) -> None:
    """After a step: the task ends if the agent has arrived, or if its steps are used up."""
    agent = dynamic.agents[m, n]
    agent.ending = Ending.NONE
    if arrived:
        agent.ending = Ending.JOINED
        agent.joined += 1
        dynamic.games[m].joined += 1
    elif agent.steps >= static.max_steps:
        agent.ending = Ending.FAILED


@inlined
def move_agent(static: Static, dynamic: Dynamic, m: int, n: int, move: int) -> None:
    """One step of one agent: it crosses an edge or is blocked, and its task may end."""
    if static.extended is not None:
        move_extended(static, dynamic, m, n, move)
        return
    _ = cross_edge(static, dynamic, m, n, move, i64(1))
    agent = dynamic.agents[m, n]
    end_task(static, dynamic, m, n, agent.cell == agent.target)


@inlined
def move_of(static: Static, action: int) -> int:
    """The move of an action, without its message."""
    return action % i64(static.options[Option.MOVES])


@compiled
def move_extended(static: Static, dynamic: Dynamic, m: int, n: int, move: int) -> None:
    """:func:`move_agent` by the options."""
    agent, game = dynamic.agents[m, n], dynamic.games[m]
    agent.message = move // static.options[Option.MOVES]
    move = move_of(static, move)
    if game.asked:
        answer(static, dynamic, m, n, move == RIP_UP)
        return
    game.just_ripped = 0
    step = min(move, MOVES - 1)
    edge = as_index(static.edge[as_index(agent.cell), step])
    new = cross_edge(static, dynamic, m, n, step, i64(move < MOVES))
    if is_on(static, Option.RELEASE_FAILED) and new:
        insert(static, dynamic, m, Option.TAKEN, n, edge)
    if is_on(static, Option.MASK_VISITED):
        insert(static, dynamic, m, Option.VISITED, n, i64(agent.cell))
    arrived = agent.cell == agent.target
    if is_on(static, Option.TREE_TARGET):
        arrived = holds(static, dynamic, m, Option.TREE, n, i64(agent.cell)) != 0
    end_task(static, dynamic, m, n, arrived)
    if agent.ending != Ending.NONE:
        _end_extended(static, dynamic, m, n)


@compiled
def _end_extended(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """What the options do when a task has ended: edges are released, trees grow, nets judged."""
    agent = dynamic.agents[m, n]
    if is_on(static, Option.RELEASE_FAILED) and agent.ending == Ending.FAILED:
        row = as_index(static.options[Option.TAKEN] + n)
        for byte in range(dynamic.sets.shape[2]):
            taken = byte_of(dynamic.sets, m, row, byte)
            if taken != 0:
                kept = byte_of(dynamic.used, m, n, byte) & ~taken
                use_edges(static, dynamic, m, n, byte, kept)
        empty(dynamic.sets, m, row)
    if keeps_tree(static):
        grow_tree(static, dynamic, m, n)
    # Judged with the last move, which is then paid for what becomes of it.
    if dynamic.games[m].ripped > 0 and all_rerouted(static, dynamic, m):
        judge(static, dynamic, m)


@inlined
def settle_agent(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """After a move: an agent whose task has ended starts its next task, or is done."""
    agent = dynamic.agents[m, n]
    if agent.ending == Ending.NONE or agent.status != Status.ACTIVE:
        return
    if static.extended is not None:
        settle_extended(static, dynamic, m, n)
    elif agent.task + 1 < static.first[m, n + 1]:
        begin_task(static, dynamic, m, n, i64(agent.task + 1))
    else:
        agent.status = final_status(static, dynamic, m, n)
        dynamic.games[m].active -= 1


@compiled
def settle_extended(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """:func:`settle_agent` for an agent whose task has ended, by the options."""
    task = i64(NOBODY)
    game = dynamic.games[m]
    if game.round == 0 or game.ripped > 0:  # what was ripped up is not rerouted and judged yet
        task = next_task(static, dynamic, m, n)
    if task != NOBODY:
        begin_extended(static, dynamic, m, n, task)
        return
    agent = dynamic.agents[m, n]
    waits = is_on(static, Option.ROUNDS)
    agent.status = Status.WAITING if waits else final_status(static, dynamic, m, n)
    game.active -= 1


@inlined
def pass_turn(static: Static, dynamic: Dynamic, m: int) -> None:
    """Passes the turn to the next active agent. In sequential order an active agent keeps it."""
    game = dynamic.games[m]
    if game.active == 0 and static.extended is not None and is_on(static, Option.ROUNDS):
        rip_up_next(static, dynamic, m)
    if game.active == 0:
        game.agent, game.turn = NOBODY, 0
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
def clear_problem(static: Static, dynamic: Dynamic, m: int, first: int, step: int) -> None:
    """Before an episode: all capacity is free. One thread of ``step`` does what is its share."""
    # Loops compile in a tenth of the time that slices take.
    for edge in range(first, static.capacity.shape[1], step):
        dynamic.remaining[m, edge] = static.capacity[m, edge]
    if dynamic.games[m].steps != 0:
        clear(dynamic.used, m, first, step)
    if static.extended is not None:
        # What others of its problem had there is of no use to an agent.
        clear(dynamic.sets, m, first, step)


@inlined
def reset_problem(static: Static, dynamic: Dynamic, m: int) -> None:
    """Starts an episode in which all capacity is free: all agents are at their first tasks."""
    game = dynamic.games[m]
    game.turn = game.active = game.joined = game.steps = 0
    game.overflow = game.wirelength = 0
    if static.extended is not None:
        reset_extended(static, dynamic, m)
    for n in range(static.order.shape[1]):
        agent = dynamic.agents[m, n]
        agent.joined = 0
        clear_move(dynamic, m, n)
        if static.first[m, n] < static.first[m, n + 1]:
            agent.status = Status.ACTIVE
            game.active += 1
            if static.extended is not None:
                agent.message = 0
                begin_net(static, dynamic, m, n)
            else:
                begin_task(static, dynamic, m, n, i64(static.first[m, n]))
        else:
            agent.status = Status.ABSENT
    game.agent = static.order[m, 0]


@compiled
def reset_extended(static: Static, dynamic: Dynamic, m: int) -> None:
    """Forgets the rounds of an episode."""
    game = dynamic.games[m]
    game.round = game.place = game.ripped = game.reroutes = game.just_ripped = game.asked = 0
    game.kept_joined = game.kept_overflow = game.kept_wirelength = game.kept_cost = 0
    game.plain = game.stuck = game.negotiations = 0
    game.present = first_present(static) if is_on(static, Option.PRICES) else 0
    game.fewest = NO_LIMIT
    game.began_joined = game.began_overflow = game.began_wirelength = 0
    game.best_joined, game.best_overflow, game.best_wirelength = NOBODY, 0, 0
    if is_on(static, Option.ROUNDS):
        for column in range(static.options[Option.RIPPED], static.options[Option.KEPT_JOINED]):
            dynamic.numbers[m, column] = NOBODY
        for column in range(static.options[Option.HISTORY], static.options[Option.QUEUE]):
            dynamic.numbers[m, column] = 0


@inlined
def move_player(static: Static, dynamic: Dynamic, m: int, move: int) -> None:
    """In one problem, the agent whose turn it is moves, or stays if ``move`` is NOBODY."""
    n = i64(dynamic.games[m].agent)
    if n == NOBODY:
        return
    if move == NOBODY:
        clear_move(dynamic, m, n)
    else:
        move_agent(static, dynamic, m, n, move)


@inlined
def settle_player(static: Static, dynamic: Dynamic, m: int) -> None:
    """After the move of :func:`move_player`: the next task starts, and the turn passes."""
    n = i64(dynamic.games[m].agent)
    if n != NOBODY:
        settle_agent(static, dynamic, m, n)
        pass_turn(static, dynamic, m)


@inlined
def may_move(dynamic: Dynamic, m: int, n: int, alone: bool, move: int) -> bool:
    """Whether an agent moves in a step of all; ``alone``: only the agent whose turn it is does."""
    active = dynamic.agents[m, n].status == Status.ACTIVE
    return active and move != NOBODY and (not alone or n == dynamic.games[m].agent)


@inlined
def move_everyone(static: Static, dynamic: Dynamic, m: int, moves: Any) -> None:
    """In one problem, agents make their moves of ``moves`` (M, N) in turn order."""
    alone = static.sequential or dynamic.games[m].asked != 0
    for k in range(static.order.shape[1]):
        if static.order[m, k] == NOBODY:
            break
        n = as_index(static.order[m, k])
        if may_move(dynamic, m, n, alone, moves[m, n]):
            move_agent(static, dynamic, m, n, as_index(moves[m, n]))
        else:
            clear_move(dynamic, m, n)


@inlined
def settle_turns(static: Static, dynamic: Dynamic, m: int) -> None:
    """After all agents of a problem have settled: the turn passes to the first that is active."""
    game = dynamic.games[m]
    if game.agent != NOBODY:
        if not static.sequential:
            game.turn = static.order.shape[1] - 1
        pass_turn(static, dynamic, m)


@inlined
def settle_everyone(static: Static, dynamic: Dynamic, m: int) -> None:
    """After the moves of :func:`move_everyone`: next tasks start, and the turn passes."""
    for n in range(static.order.shape[1]):
        settle_agent(static, dynamic, m, n)
    settle_turns(static, dynamic, m)


@inlined
def free_moves(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The moves of an agent that cross an edge, or its rip-up actions, one bit each."""
    cell = as_index(dynamic.agents[m, n].cell)
    free = i64(0)
    for move in range(MOVES):
        free |= i64(may_cross(static, dynamic, m, n, cell, move)) << move
    return _free_extended(static, dynamic, m, n, free) if static.extended is not None else free


@compiled
def _free_extended(static: Static, dynamic: Dynamic, m: int, n: int, free: int) -> int:
    """What the options make of an agent's free moves."""
    game, cell = dynamic.games[m], as_index(dynamic.agents[m, n].cell)
    if game.asked and game.agent == n:
        return i64(1 | 1 << RIP_UP)
    waits = i64(is_on(static, Option.WAIT)) << (i64(static.options[Option.MOVES]) - 1)
    if not is_on(static, Option.MASK_VISITED):
        return free | waits
    unvisited = free
    for move in range(MOVES):
        ahead = i64(static.neighbour[cell, move])
        if free >> move & 1 and holds(static, dynamic, m, Option.VISITED, n, ahead):
            unvisited ^= i64(1) << move
    return (unvisited if unvisited else free) | waits


@inlined
def write_moves(static: Static, free: int, out: Any, row: int) -> None:
    """Fills a row of ``out`` (K, A) with a mask: ones for the six moves if none is free."""
    if out.shape[1] == MOVES:
        for move in range(MOVES):
            out[row, move] = MASKS[free, move]
        return
    if free == 0:
        free = i64(_SIX)
    moves = i64(static.options[Option.MOVES])
    for first in range(0, out.shape[1], moves):  # every message goes with every move
        for move in range(moves):
            out[row, first + move] = free >> move & 1
