"""Steiner trees: exact ones in any small grid graph, and nets cut into tasks along them.

The distance of two Gcells is the Manhattan distance over x, y and layer, as in
:mod:`marouting.trees.decomposition`; there a net's tasks join pins alone, along a minimum spanning
tree, here also **Steiner points**, Gcells without a pin where the net branches. By Hanan's theorem
(1966, for any number of dimensions Snyder 1992) a shortest tree needs no other points than those of
the Hanan grid: an x, a y and a layer, each that of some pin. A net in one layer stays in that
layer.

Nets of up to :data:`EXACT_PINS` pins get a shortest tree by :func:`cheapest_tree`, larger ones
iterated 1-Steiner (Kahng and Robins 1992), a few tenths of a percent longer.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, wide
from marouting.problem.grid import AXES, MOVES
from marouting.problem.problem import Problem

EXACT_PINS = 9
"""Up to so many pins a net's tree is a shortest one: the time for it grows as 3^pins."""

CLOSED = -1
"""The cost of a move that is not to be made; also of a tree that does not exist."""

_TIE_BITS = 12  # of equal f the entry nearest to the goal goes first, as far as these can tell
_TIE_SHIFT = 3


class Lattice(NamedTuple):
    """A box of a grid graph, any lines of it left out, in which trees are looked for.

    Its points are numbered like Gcells, ``(i * ny + j) * nz + k``.
    """

    size: NDArray[np.int64]  # (3,) points along x, y, z
    stride: NDArray[np.int64]  # (6,) how far a move leads in the numbers of points
    line: NDArray[np.int64]  # (3, side) coordinates; no move costs less than they differ
    cost: NDArray[np.int32]  # (points, 6) what a move costs, or CLOSED
    tree: NDArray[np.uint8]  # (points,) bit m: the tree has the edge that move m crosses


class Search(NamedTuple):
    """What a search works with, reused from one to the next without clearing.

    A label is a point and a set of groups: the tree that joins the groups to the point.
    """

    start: NDArray[np.int64]  # (points,) points that lie in the groups
    group: NDArray[np.int8]  # (points,) their groups
    goal: NDArray[np.uint8]  # (points,) whether a point is a goal; 0 between searches
    low: NDArray[np.int64]  # (groups + 1, 3) box around each group, the last around the goal
    high: NDArray[np.int64]  # (groups + 1, 3)
    least: NDArray[np.int64]  # (sets, 3) what is not in a set reaches down to here, at least
    most: NDArray[np.int64]  # (sets, 3) and up to here
    cost: NDArray[np.int64]  # (labels,) of the cheapest tree found, where mark is the search's
    mark: NDArray[np.int64]  # (labels,) the search that found a label; negative once it is opened
    came: NDArray[np.int16]  # (labels,) the move, or the set of groups, that it was found by
    heap: NDArray[np.int64]  # (entries,) f, then distance from the goal, then the label
    tally: NDArray[np.int64]  # (2,) searches and labels opened so far


def make_lattice(points: int, side: int) -> Lattice:
    """A lattice for boxes of so many points, ``side`` along an axis."""
    return Lattice(
        size=np.zeros(AXES, np.int64),
        stride=np.zeros(MOVES, np.int64),
        line=np.zeros((AXES, side), np.int64),
        cost=np.empty((points, MOVES), np.int32),
        tree=np.zeros(points, np.uint8),
    )


def make_search(points: int, labels: int, groups: int) -> Search:
    """Working arrays for lattices of so many points and for so many labels and groups."""
    # A label enters the heap once for each move that leads to it and each pair of sets that make
    # it up; the fewer groups, the fewer pairs.
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
    """How many low bits of a label tell the set; one group makes one set and needs none."""
    return groups if groups > 1 else 0


@compiled
def set_size(lattice: Lattice, nx: int, ny: int, nz: int) -> None:
    """Makes the lattice nx×ny×nz points large and its tree empty."""
    lattice.size[0], lattice.size[1], lattice.size[2] = nx, ny, nz
    stride = ny * nz
    for axis in range(AXES):
        lattice.stride[2 * axis], lattice.stride[2 * axis + 1] = stride, -stride
        stride = nz if axis == 0 else 1
    for point in range(nx * ny * nz):
        lattice.tree[point] = 0


@compiled
def set_cost(lattice: Lattice, point: int, axis: int, cost: int) -> None:
    """Sets what the edge from a point towards its next along an axis costs, either way."""
    lattice.cost[point, 2 * axis] = cost
    lattice.cost[point + lattice.stride[2 * axis], 2 * axis + 1] = cost


@compiled
def push(heap: Any, size: int, key: int) -> None:
    """Puts a key into the binary heap of ``size`` keys."""
    at = size
    while at > 0:
        above = (at - 1) >> 1
        if heap[above] <= key:
            break
        heap[at] = heap[above]
        at = above
    heap[at] = key


@compiled
def pop(heap: Any, size: int) -> int:
    """Takes the smallest key from the heap of ``size`` keys."""
    first, key = heap[0], heap[size - 1]
    at, below = 0, 1
    while below < size - 1:
        if below + 1 < size - 1 and heap[below + 1] < heap[below]:
            below += 1
        if heap[below] >= key:
            break
        heap[at] = heap[below]
        at = below
        below = 2 * at + 1
    heap[at] = key
    return first


@compiled
def _box(least: Any, most: Any, joined: int, lines: Any, x: int, y: int, z: int) -> int:
    """The half-perimeter of the box around a point and all not yet joined, over three axes."""
    return (
        max(least[joined, 0], lines[0, x])
        - min(most[joined, 0], lines[0, x])
        + max(least[joined, 1], lines[1, y])
        - min(most[joined, 1], lines[1, y])
        + max(least[joined, 2], lines[2, z])
        - min(most[joined, 2], lines[2, z])
    )


@compiled
def _key(f: int, ahead: int, label: int, bits: int) -> int:
    """The place in the heap of a label of ``bits`` bits; too large an f only loses its place."""
    first = min(f, (1 << (62 - _TIE_BITS - bits)) - 1)
    tie = min(ahead >> _TIE_SHIFT, (1 << _TIE_BITS) - 1)
    return (first << _TIE_BITS | tie) << bits | label


@compiled
def cheapest_tree(lattice: Lattice, s: Search, starts: int, groups: int, random: int) -> int:
    """Joins groups of points and a goal by a cheapest tree.

    Dijkstra meets Steiner (Hougardy, Silvanus and Vygen 2017): labels are opened in the order of
    the cost of their tree and the extent of the box around their point and all that the tree has
    still to join. With one group it is A* from a set of points to another. With more, every group
    and the goal must be one point, or the box would say too much.

    Args:
        lattice: where; the edges of the tree are added to ``lattice.tree``.
        s: the groups are in ``start`` and ``group``, the goal in ``goal``, their boxes in ``low``
            and ``high`` (in the units of ``lattice.line``); ``goal`` stays as it is.
        starts: points that lie in the groups.
        groups: how many groups.
        random: any number from 0; decides between trees of the same cost.

    Returns:
        What the tree costs, or CLOSED if there is none.
    """
    # Every field is taken once: each time costs the compiler the whole tuple.
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
    size = wide(0)
    for i in range(starts):
        point, joined = start[i], 1 << wide(group[i])
        row = point // nz
        ahead = _box(least, most, joined, lines, row // ny, row % ny, point - row * nz)
        label = (point << shift) + joined - 1
        mark[label], costs[label], came[label] = found, 0, MOVES
        push(heap, size, _key(ahead, ahead, label ^ salt, bits))
        size += 1
    while size > 0:
        label = (pop(heap, size) & ((1 << bits) - 1)) ^ salt
        size -= 1
        if mark[label] == -found:
            continue
        mark[label] = -found  # the bound is consistent: this tree is a cheapest one
        tally[1] += 1
        point = label >> shift
        joined = label - (point << shift) + 1
        if joined == every and goal[point]:
            _trace(came, heap, strides, lattice.tree, label, shift)
            return costs[label]
        row = point // nz
        x, y, z = row // ny, row % ny, point - row * nz
        # Six moves to the points beside, then all sets that the tree could be joined with here.
        others = every & ~joined
        way, part = 0, others
        while way < MOVES or part > 0:
            if way < MOVES:
                how, step = way, wide(moves[point, way])
                way += 1
                if step == CLOSED:
                    continue
                there = label + (strides[how] << shift)
                forward = 1 - 2 * (how & 1)
                i = x + forward if how < 2 else x
                j = y + forward if how >> 1 == 1 else y
                k = z + forward if how > 3 else z
                ahead = _box(least, most, joined, lines, i, j, k)
            else:
                how, there, partner = MOVES + part, label + part, (point << shift) + part - 1
                merged = joined | part
                part = (part - 1) & others
                if mark[partner] != -found:
                    continue
                step = costs[partner]
                ahead = _box(least, most, merged, lines, x, y, z)
            cost = costs[label] + step
            if mark[there] == -found or (mark[there] == found and costs[there] <= cost):
                continue
            mark[there], costs[there], came[there] = found, cost, how
            push(heap, size, _key(cost + ahead, ahead, there ^ salt, bits))
            size += 1
    return CLOSED


@compiled
def _trace(came: Any, heap: Any, strides: Any, tree: Any, label: int, shift: int) -> None:
    """Adds the edges of a label's tree to ``tree``; the heap becomes a stack of labels."""
    heap[0] = label
    size = 1
    while size > 0:
        size -= 1
        label = heap[size]
        how = wide(came[label])
        while how != MOVES:
            if how > MOVES:  # two trees meet: one is kept for later
                heap[size] = (label >> shift << shift) + how - MOVES - 1
                size += 1
                label -= how - MOVES
            else:
                point = label >> shift
                tree[point] |= np.uint8(1 << (how ^ 1))
                tree[point - strides[how]] |= np.uint8(1 << how)
                label -= strides[how] << shift
            how = wide(came[label])


class _Web(NamedTuple):
    """The points of a net's tree, pins first, and their minimum spanning tree."""

    point: NDArray[np.int64]  # (points, 3)
    parent: NDArray[np.int64]  # (points,) the first pin's is itself
    length: NDArray[np.int64]  # (points,) of the edge to the parent
    degree: NDArray[np.int64]  # (points,)
    order: NDArray[np.int64]  # (points,) parents before their children
    near: NDArray[np.int64]  # (points,) working array


@compiled
def _span(web: _Web, points: int) -> None:
    """The minimum spanning tree of the points (Prim)."""
    for p in range(points):
        web.near[p] = np.iinfo(np.int64).max
        web.degree[p] = 0
    web.near[0] = web.parent[0] = 0
    for i in range(points):
        nearest = -1
        for p in range(points):
            if web.near[p] >= 0 and (nearest < 0 or web.near[p] < web.near[nearest]):
                nearest = p
        web.order[i] = nearest
        web.length[nearest] = web.near[nearest]
        web.near[nearest] = -1
        if i > 0:
            web.degree[nearest] += 1
            web.degree[web.parent[nearest]] += 1
        for p in range(points):
            if web.near[p] >= 0:
                distance = 0
                for axis in range(AXES):
                    distance += abs(web.point[p, axis] - web.point[nearest, axis])
                if distance < web.near[p]:
                    web.near[p] = distance
                    web.parent[p] = nearest


@compiled
def _settle(web: _Web, pins: int, points: int) -> int:
    """Spans the points less those Steiner points that save nothing; returns how many are left."""
    _span(web, points)
    p = pins
    while p < points:
        if web.degree[p] >= 3:
            p += 1
            continue
        points -= 1
        for axis in range(AXES):
            web.point[p, axis] = web.point[points, axis]
        _span(web, points)
        p = pins
    return points


@compiled
def _gain(web: _Web, points: int) -> int:
    """By how much one more point, the one behind the last, shortens the minimum spanning tree.

    From the leaves up, ``near`` is the shortest edge between the new point and a subtree. Of it and
    the subtree's edge to its parent the shorter one stays, the other is offered to the parent (Chin
    and Houck 1978).
    """
    for p in range(points):
        web.near[p] = 0
        for axis in range(AXES):
            web.near[p] += abs(web.point[p, axis] - web.point[points, axis])
    gain = 0
    for i in range(points - 1, 0, -1):
        p = web.order[i]
        above = web.parent[p]
        gain += web.length[p] - min(web.near[p], web.length[p])
        web.near[above] = min(web.near[above], max(web.near[p], web.length[p]))
    return gain - web.near[0]


@compiled
def _hanan(lattice: Lattice, web: _Web, pins: int) -> None:
    """Makes the lattice the Hanan grid of the pins, without costs."""
    for axis in range(AXES):
        lines = 0
        for p in range(pins):
            line = web.point[p, axis]
            at = lines
            while at > 0 and lattice.line[axis, at - 1] >= line:
                at -= 1
            if at == lines or lattice.line[axis, at] != line:
                for i in range(lines, at, -1):
                    lattice.line[axis, i] = lattice.line[axis, i - 1]
                lattice.line[axis, at] = line
                lines += 1
        web.near[axis] = lines
    set_size(lattice, web.near[0], web.near[1], web.near[2])


@compiled
def _branch(lattice: Lattice, s: Search, web: _Web, pins: int) -> int:
    """Adds to the pins the points where a shortest tree branches; returns the number of points."""
    ny, nz = lattice.size[1], lattice.size[2]
    count = lattice.size[0] * ny * nz
    for point in range(count):
        for axis in range(AXES):
            at = point % nz
            if axis < 2:
                at = point // nz % ny if axis else point // (ny * nz)
            if at == 0:
                lattice.cost[point, 2 * axis + 1] = CLOSED
            if at + 1 == lattice.size[axis]:
                lattice.cost[point, 2 * axis] = CLOSED
            else:
                cost = lattice.line[axis, at + 1] - lattice.line[axis, at]
                set_cost(lattice, point, axis, cost)
    goal = 0
    for pin in range(pins):
        point = 0
        for axis in range(AXES):
            at = 0
            while lattice.line[axis, at] < web.point[pin, axis]:
                at += 1
            point = point * lattice.size[axis] + at
            s.low[pin, axis] = s.high[pin, axis] = web.point[pin, axis]
        if pin + 1 < pins:
            s.start[pin], s.group[pin] = point, pin
        else:
            goal = point
    s.goal[goal] = 1
    cheapest_tree(lattice, s, pins - 1, pins - 1, wide(0))
    s.goal[goal] = 0
    points = pins
    for point in range(count):
        degree = 0
        for move in range(MOVES):
            degree += lattice.tree[point] >> move & 1
        if degree < 3:
            continue
        web.point[points, 0] = lattice.line[0, point // (ny * nz)]
        web.point[points, 1] = lattice.line[1, point // nz % ny]
        web.point[points, 2] = lattice.line[2, point % nz]
        # A pin has its place already; the points of a tree are that few.
        known = False
        for pin in range(pins):
            same = True
            for axis in range(AXES):
                same = same and web.point[pin, axis] == web.point[points, axis]
            known = known or same
        if not known:
            points += 1
    return _settle(web, pins, points)


@compiled
def _saves(lattice: Lattice, web: _Web, points: int, hanan: int) -> int:
    """By how much a point of the Hanan grid, one behind the web's last, would shorten its tree."""
    ny, nz = lattice.size[1], lattice.size[2]
    web.point[points, 0] = lattice.line[0, hanan // (ny * nz)]
    web.point[points, 1] = lattice.line[1, hanan // nz % ny]
    web.point[points, 2] = lattice.line[2, hanan % nz]
    return _gain(web, points)


@compiled
def _iterate(lattice: Lattice, s: Search, web: _Web, pins: int) -> int:
    """Adds Hanan points to the pins, the one that saves most first; returns the number of points.

    What each would save waits in a heap, and is worked out anew only when it comes first: other
    points hardly ever make it more. That goes on until no point at all saves anything.
    """
    points, before = pins, 0
    _span(web, points)
    candidates = lattice.size[0] * lattice.size[1] * lattice.size[2]
    while points > before:
        before = points
        size = wide(0)
        for hanan in range(candidates):
            saved = _saves(lattice, web, points, hanan)
            if saved > 0:
                push(s.heap, size, hanan - saved * candidates)
                size += 1
        while size > 0:
            key = pop(s.heap, size)
            size -= 1
            hanan = key % candidates
            saved = _saves(lattice, web, points, hanan)
            if hanan - saved * candidates == key:
                points = _settle(web, pins, points + 1)
            elif saved > 0:
                push(s.heap, size, hanan - saved * candidates)
                size += 1
    return points


@compiled
def _cut(
    first: Any,
    gcells: Any,
    position: Any,
    grid: Any,
    lattice: Lattice,
    s: Search,
    web: _Web,
    tasks: Any,
) -> int:
    """Writes the tasks of all nets; returns how many there are."""
    row = 0
    for net in range(len(first) - 1):
        pins = first[net + 1] - first[net]
        if pins < 2:
            continue
        for pin in range(pins):
            for axis in range(AXES):
                web.point[pin, axis] = position[gcells[first[net] + pin], axis]
        _hanan(lattice, web, pins)
        if pins <= EXACT_PINS:
            points = _branch(lattice, s, web, pins)
        else:
            points = _iterate(lattice, s, web, pins)
        for i in range(1, points):
            tasks[row, 0] = net
            for end in range(2):
                p = web.order[i]
                if end == 0:
                    p = web.parent[p]
                gcell = web.point[p, 0] * grid[1] + web.point[p, 1]
                tasks[row, 1 + end] = gcell * grid[2] + web.point[p, 2]
            row += 1
    return row


def steiner_tasks(problem: Problem) -> NDArray[np.int32]:
    """Cuts every net into two-pin tasks between its pins and Steiner points.

    Every task starts at a Gcell that an earlier task of the net has reached, or at its first pin.
    The result depends on the order of a net's pins and on no other net. The time for a net beyond
    EXACT_PINS grows with the third power of its pins, that for the points of its Hanan grid being
    at most as many as the box around the net has Gcells.

    Returns:
        (K, 3) int32: net, start Gcell and target Gcell of each task, nets in file order.
    """
    first, gcells = problem.flat_pin_gcells
    pins = np.diff(first)
    hanan = np.minimum(pins[:, None], problem.grid).prod(axis=1)
    small = hanan * (pins <= EXACT_PINS)
    most = int(pins.max())
    lattice = make_lattice(int(hanan.max()), most)
    labels = int((small << np.clip(pins - 1, 0, EXACT_PINS - 1)).max())
    search = make_search(int(hanan.max()), labels, EXACT_PINS - 1)
    web = _Web(np.empty((2 * most + 1, AXES), np.int64), *np.empty((5, 2 * most + 1), np.int64))
    tasks = np.empty((2 * int(pins.sum()), 3), np.int32)
    grid = np.array(problem.grid, np.int64)
    rows = _cut(first, gcells, problem.topology.position, grid, lattice, search, web, tasks)
    return tasks[:rows].copy()


def steiner_length(problem: Problem) -> NDArray[np.int64]:
    """(nets,) the length of each net's tree: the distances that its Steiner tasks cover."""
    net, start, target = steiner_tasks(problem).T
    position = problem.topology.position
    length = np.zeros(len(problem.nets), np.int64)
    np.add.at(length, net, np.abs(position[start] - position[target]).sum(axis=1))
    return length
