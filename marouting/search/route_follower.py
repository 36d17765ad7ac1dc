"""Solutions played as games: every net walks its own route, move by move."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.game.engine import Engine
from marouting.game.rules import may_cross, uses
from marouting.game.state import NOBODY, Dynamic, Static, Status
from marouting.kernels import compiled, place, wide
from marouting.problem.grid import MOVES
from marouting.problem.solution import Solution
from marouting.search.astar import SearchBuffers, search_buffers, shortest_path


class RouteFollower:
    """Moves along the routes of solutions in a running game.

    A task is walked along the net's route, the shortest way in it. Where the route does not lead
    from the agent to its target, or not across edges that may be crossed, the move is that of A*
    (:class:`marouting.search.astar.AStar`). So a solution that joins every net is replayed to the
    edge if it has no overflow, or if overflow is allowed, in a game that leaves its tasks enough
    steps; edges that lead to no pin are left out.

    Args:
        engine: the game to move in.
        solutions: one for each of the engine's problems.

    Raises:
        InputError: not one solution a problem, or one of another problem.
    """

    def __init__(self, engine: Engine, solutions: Sequence[Solution]) -> None:
        if len(solutions) != len(engine.problems):
            raise InputError(
                f"replay: expected {len(engine.problems)} solutions, found {len(solutions)}"
            )
        self._engine = engine
        self._scratch = search_buffers(engine.grid)
        self._ring = np.empty(engine.grid.gcells, np.int32)
        self._seen = np.zeros(engine.grid.gcells, np.int64)
        self._route = np.zeros_like(engine.dynamic.used)
        for m, (problem, solution) in enumerate(zip(engine.problems, solutions, strict=True)):
            own = solution.problem
            if (own.grid, own.nets) != (problem.grid, problem.nets):
                raise InputError(f"replay: solution {m}: expected one of a problem with its nets")
            agent = np.full(len(problem.nets), NOBODY)
            agents = np.flatnonzero(engine.nets[m] != NOBODY)
            agent[engine.nets[m, agents]] = agents
            net, edge = solution.uses
            edge, n = edge[agent[net] != NOBODY], agent[net][agent[net] != NOBODY]
            bits = np.left_shift(1, edge & 7).astype(np.uint8)
            np.bitwise_or.at(self._route[m], (n, edge >> 3), bits)

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """(K,) int8 moves of K agents; NOBODY for one that is not active."""
        out = np.empty(len(problems), np.int8)
        engine = self._engine
        _follow(
            engine.static,
            engine.dynamic,
            self._scratch,
            self._route,
            self._ring,
            self._seen,
            problems,
            agents,
            out,
        )
        return out


@compiled
def _follow(
    static: Static,
    dynamic: Dynamic,
    s: SearchBuffers,
    route: Any,
    ring: Any,
    seen: Any,
    problems: Any,
    agents: Any,
    out: Any,
) -> None:
    """Writes the moves of agents.

    Args:
        static: the game.
        dynamic: how it stands.
        s: working arrays of A*.
        route: (M, N, ceil(E / 8)) the agents' routes, as ``dynamic.used``.
        ring: (G,) working array: Gcells from which the route leads to the target.
        seen: (G,) working array: the last search that reached a Gcell.
        problems: (K,).
        agents: (K,).
        out: (K,) int8.
    """
    for i in range(len(problems)):
        m, n = wide(problems[i]), wide(agents[i])
        out[i] = NOBODY
        if n == NOBODY or dynamic.agents[m, n].status != Status.ACTIVE:
            continue
        cell, target = place(dynamic.agents[m, n].cell), place(dynamic.agents[m, n].target)
        s.search[0] += 1
        search = s.search[0]
        ring[0] = target
        seen[target] = search
        at, size = 0, 1
        while at < size and seen[cell] != search:
            here = place(ring[at])
            at += 1
            for move in range(MOVES):
                if not static.exits[here] >> move & 1:
                    continue
                beside = place(static.neighbour[here, move])
                if (
                    seen[beside] != search
                    and uses(route, m, n, place(static.edge[here, move]))
                    and may_cross(static, dynamic, m, n, beside, move ^ 1)  # the opposite move
                ):
                    seen[beside] = search
                    ring[size] = beside
                    size += 1
                    if beside == cell:
                        out[i] = move ^ 1
        if out[i] == NOBODY:
            shortest_path(static, dynamic, s, m, n, cell, target)
            out[i] = s.path[0]
