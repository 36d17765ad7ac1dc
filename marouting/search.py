"""Sequential A* over the capacity grid (paper, section "Problem breakdown and A* Search Solver").

A step costs 1, or 1000 across an edge without remaining capacity, and the heuristic is the
Manhattan distance. An edge that the net already uses costs 1 however full it is: crossing it again
takes nothing. With that it makes no difference whether a net's demand is taken after each task or
after the whole net.

Ties are broken the same way everywhere: of the Gcells with the lowest f = g + h the one found last
is opened first, and neighbours are found in the order of :class:`marouting.grid.Move`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.engine import (
    NOBODY,
    Engine,
    NetOrder,
    Play,
    Status,
    World,
    compiled,
    has_room,
    move_agent,
    pass_turn,
    settle_agent,
    wide,
)
from marouting.grid import MOVES, OFF_GRID, Grid
from marouting.problem import Problem
from marouting.solution import Solution

STEP_COST = 1
FULL_COST = 1000
"""Cost of a step, and of one across an edge without remaining capacity (paper, section 3.3)."""

_FOUND_BITS = 27  # 6 · MAX_GCELLS entries fit; f < 1000 · MAX_GCELLS takes 35 bits more


class Scratch(NamedTuple):
    """Working arrays of a search, reused from one to the next without clearing."""

    cost: NDArray[np.int64]  # (G,) cheapest way found to a Gcell, where stamp is the search's
    came: NDArray[np.int8]  # (G,) the move that the cheapest way ends with
    stamp: NDArray[np.int64]  # (G,) the search that found the Gcell
    key: NDArray[np.int64]  # (6 G,) heap: f, then the last found first
    cell: NDArray[np.int32]  # (6 G,) heap: Gcell
    path: NDArray[np.int8]  # (G,) the moves of the path
    search: NDArray[np.int64]  # (1,) searches so far


def scratch(grid: Grid) -> Scratch:
    """Working arrays for one grid shape."""
    g = grid.gcells
    return Scratch(
        cost=np.empty(g, np.int64),
        came=np.empty(g, np.int8),
        stamp=np.zeros(g, np.int64),
        key=np.empty(MOVES * g + 1, np.int64),
        cell=np.empty(MOVES * g + 1, np.int32),
        path=np.empty(g, np.int8),
        search=np.zeros(1, np.int64),
    )


@compiled
def _push(s: Scratch, size: int, key: int, cell: int) -> None:
    """Puts an entry into the binary heap of ``size`` entries."""
    at = size
    while at > 0:
        above = (at - 1) >> 1
        if s.key[above] <= key:
            break
        s.key[at] = s.key[above]
        s.cell[at] = s.cell[above]
        at = above
    s.key[at] = key
    s.cell[at] = cell


@compiled
def _pop(s: Scratch, size: int) -> int:
    """Takes the first entry's Gcell from the heap of ``size`` entries."""
    first = s.cell[0]
    key, cell = s.key[size - 1], s.cell[size - 1]
    at, below = 0, 1
    while below < size - 1:
        if below + 1 < size - 1 and s.key[below + 1] < s.key[below]:
            below += 1
        if s.key[below] >= key:
            break
        s.key[at] = s.key[below]
        s.cell[at] = s.cell[below]
        at = below
        below = 2 * at + 1
    s.key[at] = key
    s.cell[at] = cell
    return first


@compiled
def _distance(position: Any, a: int, b: int) -> int:
    """Manhattan distance of two Gcells over x, y and layer."""
    return (
        abs(position[a, 0] - position[b, 0])
        + abs(position[a, 1] - position[b, 1])
        + abs(position[a, 2] - position[b, 2])
    )


@compiled
def shortest_path(
    world: World, play: Play, s: Scratch, m: int, n: int, source: int, target: int
) -> int:
    """A cheapest path of agent n in problem m as it stands.

    Returns:
        The number of moves, which lie in ``s.path``; 0 if source and target are one Gcell.
    """
    s.search[0] += 1
    found = s.search[0]  # the stamp of a Gcell with a way to it; negative once it is opened
    s.stamp[source] = found
    s.cost[source] = 0
    s.key[0] = 0
    s.cell[0] = source
    size = 1
    latest = (1 << _FOUND_BITS) - 1
    while size > 0:
        cell = _pop(s, size)
        size -= 1
        if cell == target:
            break
        if s.stamp[cell] == -found:
            continue
        s.stamp[cell] = -found  # the heuristic is consistent: this cost is final
        for move in range(MOVES):
            if world.edge[cell, move] == OFF_GRID:
                continue
            beside = world.neighbour[cell, move]
            cost = s.cost[cell] + (
                STEP_COST if has_room(world, play, m, n, cell, move) else FULL_COST
            )
            if s.stamp[beside] == -found or (s.stamp[beside] == found and s.cost[beside] <= cost):
                continue
            s.stamp[beside] = found
            s.cost[beside] = cost
            s.came[beside] = move
            latest -= 1
            f = cost + _distance(world.position, beside, target)
            _push(s, size, (f << _FOUND_BITS) | latest, beside)
            size += 1
    length = 0
    cell = target
    while cell != source:
        s.path[length] = s.came[cell]
        length += 1
        cell = world.neighbour[cell, s.came[cell] ^ 1]  # the opposite move
    for i in range(length // 2):
        s.path[i], s.path[length - 1 - i] = s.path[length - 1 - i], s.path[i]
    return length


@compiled
def _route(world: World, play: Play, s: Scratch) -> None:
    """All agents of all problems, one after the other in turn order, along cheapest paths."""
    for m in range(len(play.games)):
        while play.games[m].agent != NOBODY:
            n = wide(play.games[m].agent)
            agent = play.agents[m, n]
            length = shortest_path(world, play, s, m, n, agent.cell, agent.target)
            for i in range(length):
                move_agent(world, play, m, n, wide(s.path[i]))
            settle_agent(world, play, m, n)
            pass_turn(world, play, m)


@compiled
def _first_moves(
    world: World, play: Play, s: Scratch, problems: Any, agents: Any, out: Any
) -> None:
    for i in range(len(problems)):
        m, n = wide(problems[i]), wide(agents[i])
        out[i] = NOBODY
        if n != NOBODY and play.agents[m, n].status == Status.ACTIVE:
            agent = play.agents[m, n]
            shortest_path(world, play, s, m, n, agent.cell, agent.target)
            out[i] = s.path[0]


class AStar:
    """Moves along A* paths in a running game.

    Every move is the first of a cheapest path from where the agent stands to its target, with the
    capacities as they are: alone on the grid the agent walks an A* path, and among others it
    finds a new one whenever they take its capacity.

    Args:
        engine: the game to move in.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._scratch = scratch(engine.grid)

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """(K,) int8 moves of K agents; NOBODY for one that is not active."""
        out = np.empty(len(problems), np.int8)
        _first_moves(self._engine.world, self._engine.play, self._scratch, problems, agents, out)
        return out


def sequential_astar(problem: Problem, net_order: NetOrder = "half_perimeter") -> Solution:
    """The paper's benchmark router: nets one after the other, each task along a cheapest path.

    Args:
        problem: the problem to route.
        net_order: which nets come first, see :class:`marouting.engine.Engine`.

    Returns:
        A solution with every net joined, overflow where A* preferred it to no way at all.
    """
    if all(len(gcells) < 2 for gcells in problem.pin_gcells):
        return Solution(problem, tuple(np.empty(0, np.int64) for _ in problem.nets))
    engine = Engine(
        [problem],
        turn_order="sequential",
        net_order=net_order,
        overflow="allowed",
        max_steps=Grid.of(problem.grid).gcells,  # as long as a path without a loop can be
    )
    _route(engine.world, engine.play, scratch(engine.grid))
    return engine.solution()
