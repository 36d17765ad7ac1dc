"""Cheapest trees in a lattice, which join groups of points to a goal.

The algorithm is that of Hougardy, Silvanus and Vygen, "Dijkstra meets Steiner: a fast exact
goal-oriented Steiner tree algorithm", Mathematical Programming Computation 9, 2017. Its time grows
as 3^groups, its memory as 2^groups.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES, MOVES
from marouting.trees.heap import pop, push
from marouting.trees.lattice import CLOSED, Lattice

_TIE_BITS = 12  # among equal f the entry nearest to the goal goes first, as far as these can tell
_TIE_SHIFT = 3


class Search(NamedTuple):
    """Input and working arrays; a label stands for a tree that joins groups to a point."""

    start: NDArray[np.int64]  # (points,) the points of all groups
    group: NDArray[np.int8]  # (points,) the group of each
    goal: NDArray[np.uint8]  # (points,) whether a point is a goal; 0 between searches
    low: NDArray[np.int64]  # (groups + 1, 3) box around each group, then around the goal
    high: NDArray[np.int64]  # (groups + 1, 3)
    least: NDArray[np.int64]  # (sets, 3) what is not in a set reaches at least down to here
    most: NDArray[np.int64]  # (sets, 3) and at least up to here
    cost: NDArray[np.int64]  # (labels,) cost of the cheapest tree found, if mark is current
    mark: NDArray[np.int64]  # (labels,) the search that found it; negative once it is opened
    came: NDArray[np.int16]  # (labels,) the move or the set of groups that it was found by
    heap: NDArray[np.int64]  # (entries,) f, then distance from the goal, then the label
    tally: NDArray[np.int64]  # (2,) searches and labels opened so far


def make_search(points: int, labels: int, groups: int) -> Search:
    """Room for searches; ``labels`` is points · 2^groups, or with one group just points."""
    # A label enters the heap once for each move that leads to it and for each pair of sets that
    # it consists of.
    pairs = (3**groups - 2 ** (groups + 1) + 1) // 2
    return Search(
        start=np.empty(points, np.int64),
        group=np.zeros(points, np.int8),
        goal=np.zeros(points, np.uint8),
        low=np.empty((groups + 1, AXES), np.int64),
        high=np.empty((groups + 1, AXES), np.int64),
        least=np.empty((1 << groups, AXES), np.int64),
        most=np.empty((1 << groups, AXES), np.int64),
        cost=np.empty(labels, np.int64),
        mark=np.zeros(labels, np.int64),
        came=np.empty(labels, np.int16),
        heap=np.empty((MOVES + 1 + pairs // 2**groups) * labels + points, np.int64),
        tally=np.zeros(2, np.int64),
    )


@compiled
def _shift(groups: int) -> int:
    """How many low bits of a label hold the set; with one group there is one set, and none."""
    return groups if groups > 1 else 0


@compiled
def _span(least: Any, most: Any, joined: int, lines: Any, axis: int, at: int) -> int:
    """How far a place on an axis and all not yet joined lie apart along this axis."""
    line = lines[axis, at]
    return max(least[joined, axis], line) - min(most[joined, axis], line)


@compiled
def _box(least: Any, most: Any, joined: int, lines: Any, x: int, y: int, z: int) -> int:
    """The half-perimeter, over three axes, of the box around a point and all not yet joined."""
    return (
        _span(least, most, joined, lines, i64(0), x)
        + _span(least, most, joined, lines, i64(1), y)
        + _span(least, most, joined, lines, i64(2), z)
    )


@compiled
def _key(f: int, ahead: int, label: int, bits: int) -> int:
    """The key in the heap of a label of ``bits`` bits; an f too large for it only loses order."""
    first = min(f, (1 << (62 - _TIE_BITS - bits)) - 1)
    tie = min(ahead >> _TIE_SHIFT, (1 << _TIE_BITS) - 1)
    return (first << _TIE_BITS | tie) << bits | label


@compiled
def exact_tree(lattice: Lattice, s: Search, starts: int, groups: int, random: int) -> int:
    """Joins groups of points and a goal by a cheapest tree, which is added to ``lattice.tree``.

    Labels are opened in the order of the cost of their tree plus the half-perimeter of the box
    around their point and all that the tree has yet to join, which is a lower bound. With one group
    this is A* from one set of points to another. With more, every group and the goal must be a
    single point, or the bound would be too high. ``s.start``, ``group``, ``goal``, ``low`` and
    ``high`` say what to join; ``random`` decides between trees of equal cost.

    Returns:
        The cost of the tree, or CLOSED if there is none.
    """
    # Fields are read once: every access makes the compiler handle the whole tuple.
    lines, moves, strides = lattice.line, lattice.cost, lattice.stride
    ny, nz = lattice.size[1], lattice.size[2]
    least, most, heap, tally = s.least, s.most, s.heap, s.tally
    costs, mark, came = s.cost, s.mark, s.came
    low, high, start, group, goal = s.low, s.high, s.start, s.group, s.goal
    every = (1 << groups) - 1
    for joined in range(every + 1):
        for axis in range(AXES):
            least[joined, axis], most[joined, axis] = low[groups, axis], high[groups, axis]
            for g in range(groups):
                if not joined >> g & 1:
                    least[joined, axis] = max(least[joined, axis], low[g, axis])
                    most[joined, axis] = min(most[joined, axis], high[g, axis])
    shift = _shift(groups)
    bits = 1
    while lattice.size[0] * ny * nz << shift >> bits > 0:
        bits += 1
    salt = random & ((1 << bits) - 1)
    tally[0] += 1
    found = tally[0]
    size = i64(0)
    for i in range(starts):
        point, joined = start[i], 1 << i64(group[i])
        row = point // nz
        ahead = _box(least, most, joined, lines, row // ny, row % ny, point - row * nz)
        label = (point << shift) + joined - 1
        mark[label], costs[label], came[label] = found, 0, MOVES
        push(heap, size, _key(ahead, ahead, label ^ salt, bits))
        size += 1
    while size > 0:
        key = pop(heap, size)
        size -= 1
        label = (key & ((1 << bits) - 1)) ^ salt
        if mark[label] == -found:
            continue
        mark[label] = -found  # the bound is consistent, so this tree is a cheapest one
        tally[1] += 1
        point = label >> shift
        joined = label - (point << shift) + 1
        if joined == every and goal[point]:
            _trace(came, heap, strides, lattice.tree, label, shift)
            return costs[label]
        row = point // nz
        x = row // ny
        y, z = row - x * ny, point - row * nz
        below = costs[label]
        wide_x = _span(least, most, joined, lines, i64(0), x)
        wide_y = _span(least, most, joined, lines, i64(1), y)
        wide_z = _span(least, most, joined, lines, i64(2), z)
        for how in range(MOVES):
            step = i64(moves[point, how])
            if step == CLOSED:
                continue
            there, cost = label + (strides[how] << shift), below + step
            if mark[there] == -found or (mark[there] == found and costs[there] <= cost):
                continue
            axis, forward = i64(how >> 1), 1 - 2 * (how & 1)
            at = (x if axis == 0 else y if axis == 1 else z) + forward
            ahead = wide_x + wide_y + wide_z
            ahead -= wide_x if axis == 0 else wide_y if axis == 1 else wide_z
            ahead += _span(least, most, joined, lines, axis, at)
            mark[there], costs[there], came[there] = found, cost, how
            push(heap, size, _key(cost + ahead, ahead, there ^ salt, bits))
            size += 1
        # All sets whose trees could be merged in here.
        others = every & ~joined
        part = others
        while part > 0:
            there, partner = label + part, (point << shift) + part - 1
            how, merged = MOVES + part, joined | part
            part = (part - 1) & others
            if mark[partner] != -found:
                continue
            cost = below + costs[partner]
            if mark[there] == -found or (mark[there] == found and costs[there] <= cost):
                continue
            ahead = _box(least, most, merged, lines, x, y, z)
            mark[there], costs[there], came[there] = found, cost, how
            push(heap, size, _key(cost + ahead, ahead, there ^ salt, bits))
            size += 1
    return CLOSED


@compiled
def _trace(came: Any, heap: Any, strides: Any, tree: Any, label: int, shift: int) -> None:
    """Adds the edges of a label's tree to ``tree``; uses the heap as a stack of labels."""
    heap[0] = label
    size = 1
    while size > 0:
        size -= 1
        label = heap[size]
        how = i64(came[label])
        while how != MOVES:
            if how > MOVES:  # two trees meet here: one waits on the stack
                heap[size] = (label >> shift << shift) + how - MOVES - 1
                size += 1
                label -= how - MOVES
            else:
                point = label >> shift
                tree[point] |= np.uint8(1 << (how ^ 1))
                tree[point - strides[how]] |= np.uint8(1 << how)
                label -= strides[how] << shift
            how = i64(came[label])
