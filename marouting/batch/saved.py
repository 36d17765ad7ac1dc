"""What must hold for a saved state of the game before anything is indexed with it.

States that :meth:`marouting.Engine.save` returns are right. Those that come from a file are not to
be believed: the compiled rules use Gcells, tasks and agents as indices without looking.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import byte_of
from marouting.batch.edges import demand_of
from marouting.batch.prices import LARGEST, MOST_RISE
from marouting.batch.setup import more_of
from marouting.batch.state import Choice, Dynamic, Option, Static
from marouting.game import NOBODY, Crossing, Ending, Status
from marouting.kernels import compiled, wide
from marouting.problem.grid import AXES


def check_saved(static: Static, saved: Dynamic) -> None:
    """Raises ValueError unless a state can be one of the games.

    Args:
        static: the static state of the games.
        saved: the dynamic state, of the right shapes.
    """
    agents, games = saved.agents, saved.games
    first, end = static.first[:, :-1], static.first[:, 1:]
    there, active = first < end, agents["status"] == Status.ACTIVE
    waiting = agents["status"] == Status.WAITING
    done = there & ~active & ~waiting
    _expect("status of an agent", _within(agents["status"], 0, max(Status)))
    _expect("status of an agent", ~waiting | (static.options[Option.ROUNDS] > 0))
    _expect("status of an agent", (agents["status"] == Status.ABSENT) == ~there)
    _expect("Gcell", _within(agents["cell"], 0, len(static.position) - 1))
    _expect("task", _within(agents["task"], first, end - 1) | ~there)
    if static.options[Option.TREE_TARGET]:
        _expect("target", _within(agents["target"], 0, len(static.position) - 1))
    else:
        target = static.tasks[np.where(there, agents["task"], 0), 1]
        _expect("target", (agents["target"] == target) | ~there)
    _expect("steps of a task", _within(agents["steps"], 0, static.max_steps - active) | ~there)
    most = end - first if static.extended else agents["task"] - first + done
    _expect("tasks joined", _within(agents["joined"], 0, most) | ~there)
    all_joined = agents["joined"] == end - first
    _expect("status of an agent", (agents["status"] == Status.TERMINATED) == (done & all_joined))
    _expect("last move", _within(agents["crossing"], 0, max(Crossing)))
    _expect("ending of a task", _within(agents["ending"], 0, max(Ending)))
    _expect("added overflow", agents["added_overflow"] >= 0)

    _expect("active agents", games["active"] == active.sum(axis=1))
    _expect("tasks joined", games["joined"] == (agents["joined"] * there).sum(axis=1))
    _expect("steps", games["steps"] >= 0)
    _expect("turn", _within(games["turn"], 0, agents.shape[1] - 1))
    row = np.arange(len(games))
    mover = np.where(games["active"] > 0, static.order[row, games["turn"]], NOBODY)
    _expect("agent to move", games["agent"] == mover)
    _expect("agent to move", active[row, mover] | (mover == NOBODY))

    if static.extended:
        _check_extended(static, saved)
    for m, game in enumerate(games):
        uses, demand = checked_demand(static, saved.used[m : m + 1], m)
        _expect("wirelength", game["wirelength"] == uses)
        remaining = static.capacity[m] - demand
        _expect("remaining capacity", saved.remaining[m] == remaining)
        _expect("overflow", game["overflow"] == np.maximum(-remaining, 0).sum())


def _check_extended(static: Static, saved: Dynamic) -> None:
    """:func:`check_saved` for what the options need."""
    agents, games = saved.agents, saved.games
    more, rounds = more_of(static, saved), int(static.options[Option.ROUNDS])
    for m in range(len(games)):
        # Sets of Gcells are only looked things up in; edges are given back.
        if static.options[Option.RELEASE_FAILED]:
            _expect("edges of a task", not (more.taken[m] & ~saved.used[m]).any())
        if not rounds:
            continue
        game, again = games[m], more.again[m]
        agent_count = int((static.first[m, :-1] < static.first[m, 1:]).sum())
        _expect("round", 0 <= game["round"] <= rounds)
        _expect("place", 0 <= game["place"] <= agents.shape[1])
        _expect("picked", game["picked"] >= 0)
        if game["round"] > 0:
            line = np.sort(more.line[m][:agent_count])
            _expect("line", line == np.arange(agent_count))
            _expect("line", more.line[m][agent_count:] == NOBODY)
        _expect("nets that walk again", 0 <= game["again"] <= len(again))
        members, rest = again[: game["again"]], again[game["again"] :]
        _expect("nets that walk again", rest == NOBODY)
        _expect("nets that walk again", _within(members, 0, agents.shape[1] - 1))
        _expect("nets that walk again", len(set(members.tolist())) == len(members))
        _expect("answer", _within(np.array([game["ripped"], game["asked"]]), 0, 1))
        _expect("answer", not game["asked"] or static.options[Option.RIP_UP] == Choice.AGENTS)
        _expect("answer", not game["asked"] or (game["active"] == 1 and not len(members)))
        joined = agents["joined"][m] * (agents["status"][m] != Status.ABSENT)
        joined[members] = more.kept_joined[m, : len(members)]
        _expect("tasks joined", _within(joined, 0, np.diff(static.first[m])))
        if len(members):
            found = [game[f"kept_{name}"] for name in ("wirelength", "overflow", "joined")]
            before = _cost_with(static, saved, m, members, Option.KEPT)
            _expect("routes before", found == [*before, joined.sum()])
        _expect("congestion", _within(more.history[m], 0, rounds))
        _expect("rounds without gain", min(game["plain"], game["stuck"]) >= 0)
        _expect("negotiations", _within(game["negotiations"], 0, rounds))
        _expect("present", _within(game["present"], 0, LARGEST))
        _expect("prices", _within(more.prices[m], 0, rounds * MOST_RISE))
        if len(more.best_joined[m]) and game["best_joined"] != NOBODY:
            joined = more.best_joined[m]
            _expect("best routes", _within(joined, 0, np.diff(static.first[m])))
            found = [game[f"best_{name}"] for name in ("wirelength", "overflow", "joined")]
            best = _cost_with(static, saved, m, np.arange(agents.shape[1]), Option.BEST)
            _expect("best routes", found == [*best, joined.sum()])


def _cost_with(
    static: Static, saved: Dynamic, m: int, members: NDArray[np.integer], which: Option
) -> tuple[int, int]:
    """Wirelength and overflow of problem m if some nets (K,) had the edges of K sets of a kind."""
    used = saved.used[m : m + 1].copy()
    rows = int(static.options[which]) + np.arange(len(members))
    used[0, members] = saved.sets[m, rows]
    uses, demand = checked_demand(static, used, m)
    return uses, int(np.maximum(demand - static.capacity[m], 0).sum())


def checked_demand(
    static: Static, used: NDArray[np.uint8], m: int
) -> tuple[int, NDArray[np.int64]]:
    """How often edges of problem m are used, and (E,) the demand on them.

    Args:
        static: the static state of the games.
        used: its part of what :class:`marouting.batch.state.Dynamic` has, with an axis for it.
        m: the problem.

    Raises:
        ValueError: an edge does not exist, or its user does not.
    """
    demand = np.zeros(static.capacity.shape[1], np.int64)
    uses = _demand(static, used, m, demand)
    _expect("used edges", uses >= 0)
    return uses, demand


def _within(numbers: NDArray[Any], least: Any, most: Any) -> NDArray[np.bool_]:
    return np.asarray((least <= numbers) & (numbers <= most))


def _expect(name: str, holds: Any) -> None:
    if not np.all(holds):
        raise ValueError(f"{name}: expected that of a game of these problems, by these rules")


@compiled
def _demand(static: Static, used: Any, m: int, demand: Any) -> int:
    """Adds up the demand (E,) of all nets of a problem.

    Returns:
        The number of edges used, summed over the nets; -1 if one of them does not exist, or belongs
        to an absent agent.
    """
    uses = 0
    for n in range(static.order.shape[1]):
        for byte in range(used.shape[2]):
            bits = byte_of(used, wide(0), n, byte)
            for bit in range(8):
                if bits >> bit & 1 == 0:
                    continue
                edge = 8 * byte + bit
                cell, axis = edge // AXES, edge % AXES
                if edge >= len(demand) or static.exits[cell] >> 2 * axis & 1 == 0:
                    return -1
                if static.first[m, n] == static.first[m, n + 1]:
                    return -1
                demand[edge] += demand_of(static, m, n, cell, 2 * axis)
                uses += 1
    return uses
