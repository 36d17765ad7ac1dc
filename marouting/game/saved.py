"""What must hold for a saved state of the game before anything is indexed with it.

States that :meth:`marouting.Engine.save` returns are right. Those that come from a file are not to
be believed: the compiled rules use Gcells, tasks and agents as indices without looking.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.game.rules import demand_of
from marouting.game.state import NOBODY, Crossing, Dynamic, Ending, Static, Status
from marouting.kernels import compiled
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
    done = there & ~active
    _expect("status of an agent", _within(agents["status"], 0, max(Status)))
    _expect("status of an agent", (agents["status"] == Status.ABSENT) == ~there)
    _expect("Gcell", _within(agents["cell"], 0, len(static.position) - 1))
    _expect("task", _within(agents["task"], first, end - 1) | ~there)
    target = static.tasks[np.where(there, agents["task"], 0), 1]
    _expect("target", (agents["target"] == target) | ~there)
    _expect("steps of a task", _within(agents["steps"], 0, static.max_steps - active) | ~there)
    _expect("tasks joined", _within(agents["joined"], 0, agents["task"] - first + done) | ~there)
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

    for m, game in enumerate(games):
        uses, demand = checked_demand(static, saved.used, m)
        _expect("wirelength", game["wirelength"] == uses)
        remaining = static.capacity[m] - demand
        _expect("remaining capacity", saved.remaining[m] == remaining)
        _expect("overflow", game["overflow"] == np.maximum(-remaining, 0).sum())


def checked_demand(
    static: Static, used: NDArray[np.uint8], m: int
) -> tuple[int, NDArray[np.int64]]:
    """How often edges of problem m are used, and (E,) the demand on them.

    Args:
        static: the static state of the games.
        used: (M, N, ceil(E / 8)), see :class:`marouting.game.state.Dynamic`.
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
    for n in range(used.shape[1]):
        for byte in range(used.shape[2]):
            for bit in range(8):
                if used[m, n, byte] >> bit & 1 == 0:
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
