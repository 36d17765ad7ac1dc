"""The same paths as plain A* with fewer Gcells opened: A* that looks for walls around its goals.

A goal that is walled in makes plain A* open the whole grid, in the vain hope of a way around that
is cheaper than a full edge. So a search that takes long pauses to look for walls. The walls it
finds become part of the heuristic until the cost of a cheapest path is known. Then A* with its
usual heuristic, and so its usual ties, finds the path; it leaves out Gcells from which the walls
make every path cost more. Neither these nor anything found from them lies on a cheapest path, so
the path is the one of plain A*.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.edges import has_room
from marouting.batch.state import Dynamic, Static
from marouting.kernels import compiled, inlined, inner, place, wide
from marouting.problem.grid import MOVES, Grid
from marouting.search.plain import (
    FULL_COST,
    NO_GAIN,
    STEP_COST,
    PlainBuffers,
    add_goal,
    astar,
    begin_search,
    cheaper_cost,
    clear_goals,
    distance_change,
    distance_left,
    is_goal,
    open_cell,
    plain_buffers,
    pop,
    push,
)

_WALL_COST = FULL_COST - STEP_COST
"""What crossing a wall adds to the cost of a path, at least."""

_UNKNOWN = -1  # cost of a cheapest path


class Walls(NamedTuple):
    """What a flood from the goals found. A wall: full edges that no path gets around."""

    depth: NDArray[np.int64]  # (G,) base[0] + walls between a Gcell and the goals; less: unknown
    base: NDArray[np.int64]  # (1,) rises from flood to flood, so that depth need not be cleared
    flood: NDArray[np.int32]  # (G,) the Gcells reached, in order


class SearchBuffers(NamedTuple):
    """Working arrays of searches, reused from one to the next without clearing."""

    plain: PlainBuffers
    walls: Walls
    path: NDArray[np.int8]  # (G,) the moves of the path found


def search_buffers(grid: Grid) -> SearchBuffers:
    """Working arrays for grids of this shape."""
    g = grid.gcells
    walls = Walls(np.zeros(g, np.int64), np.zeros(1, np.int64), np.empty(g, np.int32))
    return SearchBuffers(plain_buffers(grid), walls, np.empty(g, np.int8))


@inner
def _look_around(
    static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int, budget: int
) -> int:
    """Finds the walls around the goals.

    Floods the Gcells from which a goal can be reached by steps alone, then those behind one wall,
    and so on, until the source is reached or the budget is used up.

    Args:
        static: the game.
        dynamic: its state.
        s: a search and its goals; ``s.walls`` is filled.
        m: the problem.
        n: the agent.
        source: where the path is to begin.
        budget: how many Gcells to flood besides the goals.

    Returns:
        How many walls every path crosses that comes from a Gcell not flooded.
    """
    depth, flood = s.walls.depth, s.walls.flood
    s.walls.base[0] += len(depth) + 1
    base = s.walls.base[0]
    walls = 0
    size = s.plain.goal_count[0]
    budget += size
    for i in range(size):
        flood[i] = s.plain.goals[i]
        depth[flood[i]] = base
    # Each depth is gone through twice: first Gcells are added across edges with room, as far as
    # there are any, then those behind the next wall.
    first = last = at = 0  # the Gcells of the current depth begin with the first
    flooding = True
    while True:
        if at == (size if flooding else last):
            if flooding:
                walls += 1
                last = size
            else:
                first = last
            at = first
            flooding = not flooding
            continue
        if flooding and size > budget:
            return walls
        cell = place(flood[at])
        at += 1
        for move in range(MOVES):
            if not static.exits[cell] >> move & 1:
                continue
            beside = place(static.neighbour[cell, move])
            if depth[beside] >= base:
                continue
            if flooding and not has_room(static, dynamic, m, n, cell, move):
                continue
            if beside == source:
                return walls
            depth[beside] = base + walls
            flood[size] = beside
            size += 1


@inlined
def _walls_ahead(s: SearchBuffers, cell: int, walls: int) -> int:
    """How many walls lie between a Gcell and the goals, of so many that are known."""
    depth = s.walls.depth[cell] - s.walls.base[0]
    return depth if 0 <= depth < walls else walls


@inner
def _bounded_astar(
    static: Static,
    dynamic: Dynamic,
    s: SearchBuffers,
    m: int,
    n: int,
    cell: int,
    f: int,
    entries: int,
    opened: int,
    limit: int,
    walls: int,
    most: int,
) -> tuple[int, int, int, int]:
    """:func:`marouting.search.plain.astar` with what is known of walls; see there for the rest.

    ``walls`` is how many walls are known. They are part of the heuristic while the cost of a
    cheapest path, ``most``, is _UNKNOWN; after that, Gcells from which they make every path cost
    more are left out.
    """
    while opened < limit and not is_goal(s.plain, cell):
        open_cell(s.plain, cell)
        opened += 1
        so_far, left = s.plain.nodes[cell].cost, distance_left(static, s.plain, cell)
        for move in range(MOVES):
            cost = cheaper_cost(static, dynamic, s.plain, m, n, cell, so_far, move)
            if cost == NO_GAIN:
                continue
            f_beside = cost + left + distance_change(static, s.plain, cell, move)
            ahead = _walls_ahead(s, place(static.neighbour[cell, move]), walls)
            if most == _UNKNOWN:
                f_beside += _WALL_COST * ahead
            elif f_beside + _WALL_COST * ahead > most:
                continue
            entries = push(static, s.plain, entries, cell, move, cost, f_beside)
        cell, f = pop(s.plain, f)
    return cell, f, entries, opened


@inner
def path_to_goals(
    static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int
) -> int:
    """Finds a cheapest path of an agent from a Gcell to the nearest goal.

    Args:
        static: the game.
        dynamic: its state, whose remaining capacities count.
        s: working arrays with at least one goal; the moves go into ``s.path``.
        m: the problem.
        n: the agent, whose demands and used edges count.
        source: the Gcell to start from.

    Returns:
        The number of moves; 0 if the source is a goal.
    """
    plain = s.plain
    distance = distance_left(static, plain, source)
    limit = 16 * (distance + 8)  # Gcells to open before looking for walls
    walls, most = wide(0), wide(_UNKNOWN)
    cell, seen = source, wide(0)
    while True:  # one search after another, each knowing more
        begin_search(plain, source)
        cell, f, entries, opened = source, distance, wide(0), wide(0)
        if most == _UNKNOWN:
            f += _WALL_COST * walls  # the source lies behind all walls that are known
        while True:  # one search, with pauses
            if walls == 0:
                cell, f, entries, opened = astar(
                    static, dynamic, plain, m, n, cell, f, entries, opened, limit - 1
                )
            else:
                stop = limit - 1 if most == _UNKNOWN else len(plain.nodes)
                cell, f, entries, opened = _bounded_astar(
                    static, dynamic, s, m, n, cell, f, entries, opened, stop, walls, most
                )
            if is_goal(plain, cell):
                break
            seen = _look_around(static, dynamic, s, m, n, source, limit // 4)
            limit *= 4
            if seen > walls:
                break
        if not is_goal(plain, cell):
            walls = seen
        elif walls == 0 or most != _UNKNOWN:
            break
        else:
            most = wide(plain.nodes[cell].cost)
    length = 0
    while cell != source:
        came = plain.nodes[cell].came
        s.path[length] = came
        length += 1
        cell = wide(static.neighbour[cell, came ^ 1])  # the opposite move
    for i in range(length // 2):
        s.path[i], s.path[length - 1 - i] = s.path[length - 1 - i], s.path[i]
    return length


@compiled
def shortest_path(
    static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int, target: int
) -> int:
    """Finds a cheapest path of agent n in problem m between two Gcells, as things stand.

    Returns:
        The number of moves, which lie in ``s.path``; 0 if source and target are one Gcell.
    """
    clear_goals(s.plain)
    add_goal(static, s.plain, target)
    return path_to_goals(static, dynamic, s, m, n, source)
