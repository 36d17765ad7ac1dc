"""Solutions played as games: every net walks along its own route, move by move."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import make_rows, put_numbers
from marouting.batch.edges import may_cross, uses
from marouting.batch.engine import Engine
from marouting.batch.state import Dynamic, Static
from marouting.errors import InputError
from marouting.game import NOBODY, Status
from marouting.kernels import compiled, inner, place, wide
from marouting.problem.grid import MOVES
from marouting.problem.solution import Solution
from marouting.search.bounded import SearchBuffers, search_buffers, shortest_path


class RouteFollower:
    """Moves along the routes of solutions in a running game.

    An agent takes the shortest way along its net's route to the target of its task. Where the route
    does not lead there across edges that it may cross, it moves as A* does
    (:class:`marouting.search.astar.AStar`). So a solution that joins every net is reproduced
    exactly, except for edges that lead to no pin, provided that it has no overflow or overflow is
    allowed, and that the game's tasks last long enough.

    Args:
        engine: the game to move in.
        solutions: one for each of the engine's problems, in their order.

    Raises:
        InputError: there is not one solution per problem, or one belongs to another problem.
    """

    def __init__(self, engine: Engine, solutions: Sequence[Solution]) -> None:
        if len(solutions) != len(engine.problems):
            raise InputError(
                f"replay: expected {len(engine.problems)} solutions, found {len(solutions)}"
            )
        self._engine = engine
        self._buffers = search_buffers(engine.grid)
        self._reached = np.empty(engine.grid.gcells, np.int32)
        self._seen = np.zeros(engine.grid.gcells, np.int64)
        count, agents = engine.nets.shape
        bytes_ = -(-engine.static.capacity.shape[1] // 8)
        self._route = make_rows(count, agents, bytes_, hashed=engine.hashed)
        for m, (problem, solution) in enumerate(zip(engine.problems, solutions, strict=True)):
            own = solution.problem
            if (own.grid, own.nets) != (problem.grid, problem.nets):
                raise InputError(f"replay: solution {m}: expected one of a problem with its nets")
            agent = np.full(len(problem.nets), NOBODY)
            agents = np.flatnonzero(engine.nets[m] != NOBODY)
            agent[engine.nets[m, agents]] = agents
            net, edge = solution.uses
            edge, n = edge[agent[net] != NOBODY], agent[net][agent[net] != NOBODY]
            self._route = put_numbers(self._route, m, n, edge)

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """The next moves of K agents, which the caller may make or not.

        Args:
            problems: (K,) integers, the problem of each agent.
            agents: (K,) integers, the agents; NOBODY for none.

        Returns:
            (K,) int8; NOBODY for an agent that is not active.
        """
        out = np.empty(len(problems), np.int8)
        engine = self._engine
        _follow(
            engine.static,
            engine.dynamic,
            self._buffers,
            self._route,
            self._reached,
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
    reached: Any,
    seen: Any,
    problems: Any,
    agents: Any,
    out: Any,
) -> None:
    """Writes the moves of agents: a breadth-first search from the target along the route, or A*.

    Args:
        static: the game.
        dynamic: its state.
        s: working arrays of A*.
        route: the agents' routes, rows of bits like ``dynamic.used``.
        reached: (G,) int32, working array: Gcells from which the route leads to the target.
        seen: (G,) int64, working array: the last search that reached each Gcell.
        problems: (K,) the problem of each agent.
        agents: (K,) the agents, NOBODY for none.
        out: (K,) int8, receives the moves.
    """
    for i in range(len(problems)):
        m, n = wide(problems[i]), wide(agents[i])
        out[i] = NOBODY
        if n == NOBODY or dynamic.agents[m, n].status != Status.ACTIVE:
            continue
        s.plain.search[0] += 1
        out[i] = move_along(static, dynamic, m, n, route, m, reached, seen, s.plain.search[0])
        if out[i] == NOBODY:
            agent = dynamic.agents[m, n]
            shortest_path(static, dynamic, s, m, n, place(agent.cell), place(agent.target))
            out[i] = s.path[0]


@inner
def move_along(
    static: Static,
    dynamic: Dynamic,
    m: int,
    n: int,
    route: Any,
    row: int,
    reached: Any,
    seen: Any,
    search: int,
) -> int:
    """An agent's move on the shortest way along a route to its target; NOBODY if there is none.

    Args:
        static: the game.
        dynamic: its state.
        m: the problem.
        n: the agent, which is active.
        route: routes, rows of bits like ``dynamic.used``.
        row: the problem of ``route`` that is meant.
        reached: (G,) int32, working array: Gcells from which the route leads to the target.
        seen: (G,) int64, working array: the last search that reached each Gcell.
        search: number of this search, larger than all before.
    """
    cell, target = place(dynamic.agents[m, n].cell), place(dynamic.agents[m, n].target)
    reached[0] = target
    seen[target] = search
    at, size = 0, 1
    while at < size:
        here = place(reached[at])
        at += 1
        for move in range(MOVES):
            if not static.exits[here] >> move & 1:
                continue
            beside = place(static.neighbour[here, move])
            if (
                seen[beside] != search
                and uses(route, row, n, place(static.edge[here, move]))
                and may_cross(static, dynamic, m, n, beside, move ^ 1)  # the opposite move
            ):
                if beside == cell:
                    return wide(move ^ 1)
                seen[beside] = search
                reached[size] = beside
                size += 1
    return wide(NOBODY)
