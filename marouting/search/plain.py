"""Plain A* on a problem's capacity grid, from one Gcell to the nearest of its goals.

A step costs 1, or 1000 across an edge without remaining capacity. An edge that the net already
uses costs 1 however full it is, because crossing it again takes no capacity.

The heuristic is the Manhattan distance, over x, y and layer, to the box around the goals. Along a
step it falls by no more than the step costs, so f = g + h never falls along a path, and the cost of
a Gcell is final once the Gcell is opened.

Ties are broken in one way everywhere: of the Gcells with the lowest f the one found last is opened
first, and the neighbours of a Gcell are found in the order of
:class:`marouting.problem.grid.Move`.

The **open list** is a stack of entries for each f, so the entry found last is on top. A Gcell that
is found again by a cheaper path gets a second entry; the entry left behind is skipped when its turn
comes. As all f in the list lie close together, the stacks are kept in a ring, f modulo LEVELS.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.edges import has_room
from marouting.batch.state import Dynamic, Static
from marouting.kernels import inlined, place, wide
from marouting.problem.grid import AXES, MOVES, Grid

STEP_COST = 1
FULL_COST = 1000
"""Cost of a step, and of one across an edge without remaining capacity (paper, section 3.3)."""

LEVELS = 1 << (2 * FULL_COST).bit_length()
"""Stacks of the open list. Along a step f grows by FULL_COST + 1 at most, and by up to another
FULL_COST − 1 in :mod:`marouting.search.bounded`; no two f in the list are farther apart."""

_RING = LEVELS - 1
_EMPTY = -1
NO_GAIN = -1
"""What :func:`cheaper_cost` gives for a move that is not worth an entry in the open list."""

NODE = np.dtype(
    [
        ("stamp", np.int64),  # the search that found the Gcell; negative once it is opened
        ("cost", np.int64),  # g: cost of the cheapest path found, where stamp is the search's
        ("came", np.int8),  # the last move of that path
    ],
    align=True,
)
"""A Gcell in a search."""


class PlainBuffers(NamedTuple):
    """Working arrays of searches, reused from one to the next without clearing."""

    search: NDArray[np.int64]  # (1,) searches so far; the number of the current one
    nodes: NDArray[Any]  # (G,) NODE
    head: NDArray[np.int32]  # (LEVELS,) top entry of each stack, or _EMPTY
    below: NDArray[np.int32]  # (6 G,) the entry below each entry, or _EMPTY
    cell: NDArray[np.int32]  # (6 G,) the Gcell of each entry
    goal_set: NDArray[np.int64]  # (1,) sets of goals so far; the number of the current one
    goal_mark: NDArray[np.int64]  # (G,) the latest set of goals that a Gcell was in
    goals: NDArray[np.int32]  # (G,) the current goals, goal_count[0] of them
    goal_count: NDArray[np.int64]  # (1,)
    box: NDArray[np.int64]  # (3, 2) lowest and highest x, y, z of a goal


def plain_buffers(grid: Grid) -> PlainBuffers:
    """Working arrays for grids of this shape."""
    g = grid.gcells
    return PlainBuffers(
        search=np.zeros(1, np.int64),
        nodes=np.zeros(g, NODE),
        head=np.empty(LEVELS, np.int32),
        below=np.empty(MOVES * g, np.int32),
        cell=np.empty(MOVES * g, np.int32),
        goal_set=np.zeros(1, np.int64),
        goal_mark=np.zeros(g, np.int64),
        goals=np.empty(g, np.int32),
        goal_count=np.zeros(1, np.int64),
        box=np.empty((AXES, 2), np.int64),
    )


@inlined
def clear_goals(s: PlainBuffers) -> None:
    """Starts a new, empty set of goals."""
    s.goal_set[0] += 1
    s.goal_count[0] = 0


@inlined
def add_goal(static: Static, s: PlainBuffers, cell: int) -> None:
    """Makes a Gcell a goal, unless it is one already."""
    if is_goal(s, cell):
        return
    count = s.goal_count[0]
    s.goal_mark[cell] = s.goal_set[0]
    s.goals[count] = cell
    s.goal_count[0] = count + 1
    for axis in range(AXES):
        at = wide(static.position[cell, axis])
        s.box[axis, 0] = at if count == 0 else min(s.box[axis, 0], at)
        s.box[axis, 1] = at if count == 0 else max(s.box[axis, 1], at)


@inlined
def is_goal(s: PlainBuffers, cell: int) -> bool:
    """Whether a Gcell is one of the current goals."""
    return s.goal_mark[cell] == s.goal_set[0]


@inlined
def distance_left(static: Static, s: PlainBuffers, cell: int) -> int:
    """The heuristic h: distance of a Gcell from the box around the goals."""
    distance = wide(0)
    for axis in range(AXES):
        at = static.position[cell, axis]
        distance += max(s.box[axis, 0] - at, 0) + max(at - s.box[axis, 1], 0)
    return distance


@inlined
def distance_change(static: Static, s: PlainBuffers, cell: int, move: int) -> int:
    """By how much a move from a Gcell changes the heuristic: −1, 0 or 1."""
    at = static.position[cell, move >> 1]
    low, high = s.box[move >> 1, 0], s.box[move >> 1, 1]
    # Even moves go up their axis, odd ones down.
    nearer = at > high if move & 1 else at < low
    farther = at <= low if move & 1 else at >= high
    return farther - nearer


@inlined
def begin_search(s: PlainBuffers, source: int) -> None:
    """Starts a search at a Gcell, with an empty open list."""
    s.search[0] += 1
    for level in range(LEVELS):
        s.head[level] = _EMPTY
    s.nodes[source].cost = 0


@inlined
def open_cell(s: PlainBuffers, cell: int) -> None:
    """Makes the cost of a Gcell final."""
    s.nodes[cell].stamp = -s.search[0]


@inlined
def cheaper_cost(
    static: Static,
    dynamic: Dynamic,
    s: PlainBuffers,
    m: int,
    n: int,
    cell: int,
    cost: int,
    move: int,
) -> int:
    """Cost of a path that goes on from an open Gcell by one more move.

    Args:
        static: the game.
        dynamic: its state.
        s: the search.
        m: the problem.
        n: the agent.
        cell: the open Gcell.
        cost: its cost.
        move: the move from it.

    Returns:
        The cost; NO_GAIN if the move leads off the grid, to an open Gcell, or to one that was
        already found at this cost or less.
    """
    if not static.exits[cell] >> move & 1:
        return wide(NO_GAIN)
    beside = s.nodes[place(static.neighbour[cell, move])]
    if beside.stamp == -s.search[0]:
        return wide(NO_GAIN)
    free = has_room(static, dynamic, m, n, cell, move)
    cost += STEP_COST if free else FULL_COST
    if beside.stamp == s.search[0] and beside.cost <= cost:
        return wide(NO_GAIN)
    return cost


@inlined
def push(
    static: Static, s: PlainBuffers, entries: int, cell: int, move: int, cost: int, f: int
) -> int:
    """Adds the Gcell that a move leads to to the open list; returns the new number of entries."""
    beside = place(static.neighbour[cell, move])
    node = s.nodes[beside]
    node.stamp = s.search[0]
    node.cost = cost
    node.came = move
    s.cell[entries] = beside
    s.below[entries] = s.head[f & _RING]
    s.head[f & _RING] = entries
    return entries + 1


@inlined
def pop(s: PlainBuffers, f: int) -> tuple[int, int]:
    """Takes the next Gcell to open from the open list; returns it and its f.

    Args:
        s: the search; every Gcell can be reached, so the list does not run empty before a goal.
        f: the f of the Gcell opened last; none in the list is lower.
    """
    while True:
        while s.head[f & _RING] == _EMPTY:
            f += 1
        entry = place(s.head[f & _RING])
        s.head[f & _RING] = s.below[entry]
        cell = place(s.cell[entry])
        if s.nodes[cell].stamp == s.search[0]:  # not opened yet
            return cell, f


@inlined
def astar(
    static: Static,
    dynamic: Dynamic,
    s: PlainBuffers,
    m: int,
    n: int,
    cell: int,
    f: int,
    entries: int,
    opened: int,
    limit: int,
) -> tuple[int, int, int, int]:
    """A*: opens Gcells until the next one is a goal, or until a limit is reached.

    Args:
        static: the game.
        dynamic: its state, whose remaining capacities count.
        s: a search that has begun, and its goals.
        m: the problem.
        n: the agent, whose demands and used edges count.
        cell: the Gcell to open next; at first the source.
        f: its cost plus heuristic.
        entries: entries made in the open list so far; at first 0.
        opened: Gcells opened so far; at first 0.
        limit: how many Gcells to open in all.

    Returns:
        ``cell``, ``f``, ``entries`` and ``opened`` as they are now, to go on with.
    """
    while opened < limit and not is_goal(s, cell):
        open_cell(s, cell)
        opened += 1
        so_far, left = s.nodes[cell].cost, distance_left(static, s, cell)
        for move in range(MOVES):
            cost = cheaper_cost(static, dynamic, s, m, n, cell, so_far, move)
            if cost != NO_GAIN:
                f_beside = cost + left + distance_change(static, s, cell, move)
                entries = push(static, s, entries, cell, move, cost, f_beside)
        cell, f = pop(s, f)
    return cell, f, entries, opened
