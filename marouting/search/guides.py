"""Guides: moves for agents of a running game, along A* paths or along the routes of solutions."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import next_in, put_numbers
from marouting.batch.edges import may_cross, uses
from marouting.batch.engine import Engine
from marouting.batch.state import Dynamic, Static
from marouting.columns import as_int32
from marouting.errors import InputError
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import MOVES, Grid
from marouting.problem.solution import Solution
from marouting.search.astar import (
    Capacities,
    Search,
    add_goal,
    clear_goals,
    make_search,
    path_to_goals,
)


class SearchBuffers(NamedTuple):
    """Working arrays of searches in a running game."""

    search: Search
    own: NDArray[np.int64]  # (E,) see Capacities
    net: NDArray[np.int64]  # (1,) likewise
    reached: NDArray[np.int32]  # (G,) Gcells from which a route leads to the target
    seen: NDArray[np.int64]  # (G,) the last search along a route that reached each Gcell


def search_buffers(grid: Grid) -> SearchBuffers:
    """Working arrays for games on grids of this shape."""
    return SearchBuffers(
        search=make_search(grid),
        own=np.zeros(grid.edges, np.int64),
        net=np.zeros(1, np.int64),
        reached=np.empty(grid.gcells, np.int32),
        seen=np.zeros(grid.gcells, np.int64),
    )


class AStar:
    """Moves along A* paths in a running game.

    Every move is the first of a cheapest path from where the agent is to its target, with the
    capacities as they are now (:mod:`marouting.search.astar`). An agent alone on the grid walks one
    A* path; among others it finds a new one whenever they take its capacity.

    Args:
        engine: the game to move in.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._buffers = search_buffers(engine.grid)
        self._route = np.zeros((*engine.nets.shape, 0), np.uint8)

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """The next moves of K agents, which the caller may make or not.

        Args:
            problems: (K,) integers, the problem of each agent.
            agents: (K,) integers, the agents; NOBODY for none.

        Returns:
            (K,) int8; NOBODY for an agent that is not active.
        """
        out = np.empty(len(problems), np.int8)
        known = self._engine.static, self._engine.dynamic, self._buffers, self._route
        _moves(*known, *as_int32(problems, agents), out)
        return out


class RouteFollower(AStar):
    """Moves along the routes of solutions in a running game.

    An agent takes the shortest way along its net's route to the target of its task. Where the route
    does not lead there across edges that it may cross, it moves as :class:`AStar` does. So a
    solution that joins every net is reproduced exactly, except for edges that lead to no pin,
    provided that it has no overflow or overflow is allowed, and that the game's tasks last long
    enough.

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
        super().__init__(engine)
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
            put_numbers(self._route, m, n, edge)


@compiled
def shortest_path(
    static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int, target: int
) -> int:
    """Finds a cheapest path between two Gcells, in ``s.search.path``; returns its moves."""
    s.net[0] += 1
    edge = next_in(dynamic.used, m, n, i64(0))
    while edge != NOBODY:
        s.own[edge] = s.net[0]
        edge = next_in(dynamic.used, m, n, edge + 1)
    w = Capacities(
        static.neighbour,
        static.edge,
        static.exits,
        static.position,
        dynamic.remaining[m],
        static.demand[m, n],
        s.own,
        s.net,
    )
    clear_goals(s.search)
    add_goal(w, s.search, target)
    return path_to_goals(w, s.search, source)


@compiled
def _moves(
    static: Static,
    dynamic: Dynamic,
    s: SearchBuffers,
    route: Any,
    problems: Any,
    agents: Any,
    out: Any,
) -> None:
    """Writes the moves of agents (K,); routes, if any, are rows of bits like ``dynamic.used``."""
    for i in range(len(problems)):
        m, n = i64(problems[i]), i64(agents[i])
        out[i] = NOBODY
        if n == NOBODY or dynamic.agents[m, n].status != Status.ACTIVE:
            continue
        agent = dynamic.agents[m, n]
        s.net[0] += 1
        if route.shape[2] > 0:
            out[i] = move_along(static, dynamic, m, n, route, m, s.reached, s.seen, s.net[0])
        if out[i] == NOBODY:
            cell, target = as_index(agent.cell), as_index(agent.target)
            _ = shortest_path(static, dynamic, s, m, n, cell, target)
            out[i] = s.search.path[0]


@compiled
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

    ``reached`` and ``seen`` (G,) are working arrays, ``search`` a number larger than in all earlier
    calls with them.
    """
    cell, target = as_index(dynamic.agents[m, n].cell), as_index(dynamic.agents[m, n].target)
    reached[0] = target
    seen[target] = search
    at, size = 0, 1
    while at < size:
        here = as_index(reached[at])
        at += 1
        for move in range(MOVES):
            if not static.exits[here] >> move & 1:
                continue
            beside = as_index(static.neighbour[here, move])
            if (
                seen[beside] != search
                and uses(route, row, n, as_index(static.edge[here, move]))
                and may_cross(static, dynamic, m, n, beside, move ^ 1)  # the opposite move
            ):
                if beside == cell:
                    return i64(move ^ 1)
                seen[beside] = search
                reached[size] = beside
                size += 1
    return i64(NOBODY)
