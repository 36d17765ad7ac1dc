"""What a move pays, compiled: any :class:`marouting.rewards.Prices`.

:func:`marouting.rewards.pay_moves` is the same by columns, and the definition. ``fast`` is a
:class:`marouting.batch.step.FastPath`; ``reward`` (M, K) has a row for each agent, or one for all
agents of a problem.
"""

from typing import Any

import numpy as np

from marouting.batch.bits import next_in
from marouting.batch.edges import demand_of, may_cross, uses
from marouting.batch.observation import paper_reward
from marouting.batch.places import distance
from marouting.batch.rules import may_move, move_agent, move_of
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import clear_move
from marouting.game import NOBODY, Crossing, Ending, Status
from marouting.kernels import as_index, compiled, i64, inlined
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.rewards import Share


@compiled
def move_and_pay(
    static: Static, dynamic: Dynamic, fast: Any, m: int, actions: Any, reward: Any
) -> None:
    """In one problem, agents move in turn order, or the one whose turn it is; pays all agents."""
    for row in range(reward.shape[1]):
        reward[m, row] = 0
    game, team = dynamic.games[m], 0.0
    alone = static.sequential or game.asked != 0
    for k in range(static.order.shape[1] if fast.everyone else 1):
        mover = i64(static.order[m, k] if fast.everyone else game.agent)
        if mover == NOBODY:
            break
        n = as_index(mover)
        move = actions[m, n if fast.everyone else 0]
        if may_move(dynamic, m, n, alone, move):
            team += _move_one(static, dynamic, fast, m, n, as_index(move), reward)
        else:
            clear_move(dynamic, m, n)
    if team == 0:
        return
    agents = 0
    for k in range(static.order.shape[1]):
        agents += static.order[m, k] != NOBODY
    if not fast.everyone:
        reward[m, 0] += agents * team
        return
    for k in range(agents):
        reward[m, as_index(static.order[m, k])] += team


@inlined
def _move_one(
    static: Static, dynamic: Dynamic, fast: Any, m: int, n: int, move: int, reward: Any
) -> Any:
    """An agent moves: pays it and the others; returns what all nets are paid."""
    game, agent, prices = dynamic.games[m], dynamic.agents[m, n], fast.prices
    overflow, joined, wirelength = i64(game.overflow), i64(game.joined), i64(game.wirelength)
    if game.just_ripped:  # edges that nets have just released are paid for with this move
        overflow, joined = i64(game.kept_overflow), i64(game.kept_joined)
        wirelength = i64(game.kept_wirelength)
    cell, first_walk = as_index(agent.cell), game.round == 0
    releases = first_walk and _may_release(static, dynamic, m, n)
    if releases:
        _pay_overflow(static, dynamic, fast, m, n, prices[Share.OTHERS, 0], reward)

    move_agent(static, dynamic, m, n, move)

    overflow -= i64(game.overflow)
    joined = i64(game.joined) - joined
    wirelength -= i64(game.wirelength)
    paid = i64(n if fast.everyone else 0)
    own = np.float64(paper_reward(fast.table, fast.overflow_price, agent))
    own += _worth(prices, Share.MOVER, overflow, joined, wirelength)
    if prices[Share.NEARER, 0] != 0 and agent.crossing != Crossing.ANSWERED:
        target, now = as_index(agent.target), as_index(agent.cell)
        own += prices[Share.NEARER, 0] * distance(static, cell, target)
        own -= prices[Share.NEARER, 1] * distance(static, now, target)
    reward[m, paid] += own
    if first_walk:
        if releases:
            _pay_overflow(static, dynamic, fast, m, n, -prices[Share.OTHERS, 0], reward)
        elif agent.added_overflow > 0 and prices[Share.OTHERS, 0] != 0:
            step = as_index(move_of(static, move))
            edge = as_index(static.edge[cell, step])
            demand = demand_of(static, m, n, cell, step)
            _share_overflow(static, dynamic, fast, m, n, edge, demand, reward)
        if agent.ending == Ending.FAILED and prices[Share.OTHERS, 1] != 0:
            _charge_for_failure(static, dynamic, fast, m, n, reward)
    return _worth(prices, Share.TEAM, overflow, joined, wirelength)


@inlined
def _worth(prices: Any, share: int, overflow: int, joined: int, wirelength: int) -> Any:
    """What a change of the problem's figures pays."""
    return prices[share, 0] * overflow + prices[share, 1] * joined + prices[share, 2] * wirelength


# --- the counterfactual reward --------------------------------------------------------------------


@inlined
def _due(remaining: int, demand: int) -> int:
    """The overflow that an edge would lose if a net released it."""
    return max(-remaining, 0) - max(-remaining - demand, 0)


@inlined
def _may_release(static: Static, dynamic: Dynamic, m: int, n: int) -> bool:
    """Whether an agent's next move may release edges that overflow."""
    last = dynamic.agents[m, n].steps + 1 >= static.max_steps
    return last and static.overflow_allowed and static.options[Option.RELEASE_FAILED] > 0


@compiled
def _share_overflow(
    static: Static, dynamic: Dynamic, fast: Any, m: int, n: int, edge: int, demand: int, reward: Any
) -> None:
    """Charges the other nets on an edge that agent n has just taken, as far as it overflows."""
    remaining, layer = i64(dynamic.remaining[m, edge]), edge // AXES % static.demand.shape[2]
    for other in range(static.order.shape[1]):
        if other == n or not uses(dynamic.used, m, i64(other), edge):
            continue
        own = i64(static.demand[m, other, layer])
        due = _due(remaining, own) - _due(remaining + demand, own)
        reward[m, other if fast.everyone else 0] -= fast.prices[Share.OTHERS, 0] * due


@compiled
def _pay_overflow(
    static: Static, dynamic: Dynamic, fast: Any, m: int, n: int, price: float, reward: Any
) -> None:
    """Pays all nets but agent n's for the overflow that would go if they released their edges."""
    if price == 0:
        return
    for other in range(static.order.shape[1]):
        if other == n:
            continue
        edge = next_in(dynamic.used, m, i64(other), i64(0))
        while edge != NOBODY:
            if dynamic.remaining[m, edge] < 0:
                own = i64(static.demand[m, other, edge // AXES % static.demand.shape[2]])
                due = _due(i64(dynamic.remaining[m, edge]), own)
                reward[m, other if fast.everyone else 0] += price * due
            edge = next_in(dynamic.used, m, i64(other), edge + 1)


@compiled
def _charge_for_failure(
    static: Static, dynamic: Dynamic, fast: Any, m: int, n: int, reward: Any
) -> None:
    """Charges the nets each of which alone keeps agent n, whose task has failed, from its target.

    ``fast.cells`` (M, 2, G) holds the Gcells that have been reached, and marks for them.
    """
    agent, cells = dynamic.agents[m, n], fast.cells
    for cell in range(cells.shape[2]):
        cells[m, 1, cell] = 0
    cells[m, 0, 0] = agent.cell
    cells[m, 1, agent.cell] = 1
    size = _reach(static, dynamic, cells, m, n, i64(NOBODY), i64(1))
    if cells[m, 1, agent.target]:
        return
    for other in range(static.order.shape[1]):
        if other == n or dynamic.agents[m, other].status == Status.ABSENT:
            continue
        grown = _reach(static, dynamic, cells, m, n, i64(other), size)
        if cells[m, 1, agent.target]:
            reward[m, other if fast.everyone else 0] -= fast.prices[Share.OTHERS, 1]
        for place in range(size, grown):
            cells[m, 1, cells[m, 0, place]] = 0


@compiled
def _reach(
    static: Static, dynamic: Dynamic, cells: Any, m: int, n: int, without: int, size: int
) -> int:
    """Adds the Gcells that agent n could reach from ``size`` in ``cells``, up to its target.

    The edges of agent ``without``, if it is not NOBODY, are free. Returns how many there are now.
    """
    at, target = 0, i64(dynamic.agents[m, n].target)
    while at < size and not cells[m, 1, target]:
        cell = as_index(cells[m, 0, at])
        at += 1
        for move in range(MOVES):
            ahead = i64(static.neighbour[cell, move])
            if not static.exits[cell] >> move & 1 or cells[m, 1, ahead]:
                continue
            if not _could_cross(static, dynamic, m, n, cell, move, without):
                continue
            cells[m, 0, size] = ahead
            cells[m, 1, ahead] = 1
            size += 1
    return size


@inlined
def _could_cross(
    static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int, without: int
) -> bool:
    """Whether a move of agent n crosses its edge, or would if another agent's edges were free."""
    if may_cross(static, dynamic, m, n, cell, move):
        return True
    edge = as_index(static.edge[cell, move])
    if without == NOBODY or not uses(dynamic.used, m, as_index(without), edge):
        return False
    layer = as_index(static.position[cell, VIA_AXIS])
    room = i64(dynamic.remaining[m, edge]) + i64(static.demand[m, as_index(without), layer])
    return room >= static.demand[m, n, layer]
