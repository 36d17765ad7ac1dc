"""Compiled code that finds a tree for one net, inside a box of the grid.

Points are the Gcells of the box, numbered as in :class:`marouting.trees.lattice.Lattice`. All
costs are in the units of :data:`~policies.routers.pathfinder.state.UNIT`.
"""

from typing import Any

import numpy as np

from marouting.kernels import compiled, i64, mixed
from marouting.problem.contest import SLOPE, WITHOUT
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.trees.exact_tree import Search, exact_tree
from marouting.trees.lattice import CLOSED, Lattice, begin_lines, set_cost, set_size, sum_lines
from policies.routers.pathfinder.state import (
    DISPLACE,
    FULL,
    SQUEEZE,
    UNIT,
    Memory,
    NetBuffers,
    ProblemArrays,
    Routing,
)

GOLDEN = -0x61C8864680B583EB  # odd: multiples of it are far apart
_HALF = float((np.exp(SLOPE / 2) - 1) / (np.exp(SLOPE) - 1))  # a half track's share of a whole's
_STEEPEST = 30.0  # exponent beyond which the cost of overflow no longer grows
_MOST_OVERFLOW = 1000  # tracks of overflow beyond which more cost the same: costs have 32 bits


@compiled
def draw(progress: Any) -> int:
    """A random number of 31 bits."""
    progress.random += np.int64(GOLDEN)
    return i64(mixed(np.uint64(progress.random)) >> np.uint64(33))


@compiled
def via_cost(problem: ProblemArrays, gcell: int) -> int:
    """The length of the via from a Gcell to the one above it."""
    layer = problem.position[gcell, VIA_AXIS]
    return i64(problem.height[layer + 1] - problem.height[layer])


@compiled
def wire_cost(problem: ProblemArrays, net: int, layer: int, edge: int) -> int:
    """The length of an edge inside a layer, and what the net pays if it prefers other layers."""
    if not problem.contest:
        return i64(UNIT + problem.layer_cost[net, layer])
    gcell = edge // AXES
    axis = edge - AXES * gcell
    return i64(problem.wire[axis, problem.position[gcell, axis]])


@compiled
def use_cost(problem: ProblemArrays, routing: Routing, edge: int, more: int) -> int:
    """What nets pay together for the use of an edge inside a layer, and ``more`` half tracks.

    By the rules of ISPD 2024 the overflow that it causes (:mod:`marouting.problem.contest`);
    otherwise a parabola, which begins where the edge begins to be crowded.
    """
    if problem.crowding == 0:
        return i64(0)
    capacity = problem.capacity[edge]
    used = capacity - routing.remaining[edge] + more / 2
    if problem.contest:
        gcell = edge // AXES
        tracks, used = problem.tracks[edge], used + routing.vias[edge]
        over = used - tracks if tracks > 0 else 2 * WITHOUT * used
        if tracks == 0 and used == 0:
            return i64(0)
        cost = problem.overflow_cost[problem.position[gcell, VIA_AXIS]]
        return i64(cost * np.exp(min(SLOPE * over, _STEEPEST)))
    free = problem.crowded_from * capacity
    if capacity <= 0 or used <= free:
        return i64(0)
    return i64(problem.crowding * UNIT / 2 * (used - free) ** 2 / (capacity - free))


@compiled
def edge_cost(
    problem: ProblemArrays, routing: Routing, net: int, layer: int, edge: int, own: int
) -> int:
    """The cost of an edge inside a layer to a net, FULL or more if it should avoid it at all costs.

    ``own`` is 1 if it is an edge of the net's tree at the moment, otherwise 0.
    """
    kind, demand = routing.progress[0].kind, i64(problem.demand[net, layer])
    length, own = wire_cost(problem, net, layer, edge), own * demand
    if problem.crowding > 0:
        more = use_cost(problem, routing, edge, 2 * (demand - own))
        length += min(more - use_cost(problem, routing, edge, -2 * own), i64(FULL // 2))
        if problem.contest:  # only by controls nets take more than a track
            return length + (FULL if demand > 1 else 0)
    over = demand - own - routing.remaining[edge]
    if kind >= SQUEEZE:
        return length + FULL * min(max(over, 0), min(demand, _MOST_OVERFLOW))
    cost = length + (0.0 if kind == DISPLACE else routing.price[edge])
    if over > 0 and demand > 0:
        cost *= 1.0 + routing.progress[0].present * over / demand
    blocked = demand > problem.capacity[edge]
    return i64(min(cost, FULL - 1.0)) + (FULL if blocked else 0)


@compiled
def tree_cost(
    problem: ProblemArrays,
    routing: Routing,
    net: int,
    edges: Any,
    first: int,
    last: int,
    own: int,
) -> int:
    """The present cost of a tree, ``edges[first:last]``, to a net.

    ``own`` is 1 if it is the net's tree at the moment, 0 if the net is ripped up.
    """
    cost = i64(0)
    own = i64(own)
    for i in range(first, last):
        edge = i64(edges[i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            cost += via_cost(problem, gcell)
            if problem.contest and is_stacked(problem, edges, first, last, gcell):
                for side in range(2):
                    beside, halves = beside_via(problem, gcell, side)
                    if halves > 0:
                        cost += use_cost(problem, routing, beside, (1 - own) * halves)
                        cost -= use_cost(problem, routing, beside, -own * halves)
        else:
            layer = i64(problem.position[gcell, VIA_AXIS])
            cost += edge_cost(problem, routing, net, layer, edge, own)
    return cost


@compiled
def beside_via(problem: ProblemArrays, gcell: int, side: int) -> tuple[int, int]:
    """An edge that a via above a Gcell takes by the rules of ISPD 2024, and how much of it.

    Returns:
        One of both edges beside the Gcell along its layer, and half tracks: 2 if it is the only
        one, 0 if there is none on this side.
    """
    axis = i64(problem.along[problem.position[gcell, VIA_AXIS]])
    at, last = i64(problem.position[gcell, axis]), problem.size[axis] - 1
    before = problem.size[2] * (problem.size[1] if axis == 0 else 1)
    if last == 0 or at == (0 if side == 0 else last):
        return i64(0), i64(0)
    edge = i64(AXES * (gcell - before if side == 0 else gcell) + axis)
    return edge, i64(2 if at == (last if side == 0 else 0) else 1)


@compiled
def is_stacked(problem: ProblemArrays, edges: Any, first: int, last: int, gcell: int) -> bool:
    """Whether no wire of a tree ends in or passes through a Gcell, along the Gcell's layer."""
    for side in range(2):
        beside, halves = beside_via(problem, gcell, side)
        low, high = i64(first), i64(last)
        while low < high:  # edges are in order
            middle = (low + high) // 2
            if edges[middle] < beside:
                low = middle + 1
            else:
                high = middle
        if halves > 0 and low < last and edges[low] == beside:
            return False
    return True


@compiled
def _add_stacks(problem: ProblemArrays, lattice: Lattice, low: Any) -> None:
    """Adds to the costs of vias what half a track of both edges beside their lower Gcell costs.

    Where a wire of the net ends there, the contest does not count it; a search cannot know that.
    """
    nx, ny, nz = lattice.size[0], lattice.size[1], lattice.size[2]
    for point in range(nx * ny * nz):
        row = point // nz
        z = low[2] + point - row * nz
        axis = i64(problem.along[z])
        at = low[axis] + (row // ny if axis == 0 else row % ny)
        ahead, back = i64(lattice.cost[point, 2 * axis]), i64(lattice.cost[point, 2 * axis + 1])
        if lattice.cost[point, 2 * VIA_AXIS] == CLOSED or ahead == back == CLOSED:
            continue
        more = i64(0)
        if ahead != CLOSED:
            more += ahead - problem.wire[axis, at]
        if back != CLOSED:
            more += back - problem.wire[axis, at - 1]
        if ahead == CLOSED or back == CLOSED:
            more *= 2
        cost = lattice.cost[point, 2 * VIA_AXIS] + i64(_HALF * max(more, 0))
        set_cost(lattice, i64(point), i64(VIA_AXIS), cost)


@compiled
def set_box(
    problem: ProblemArrays,
    routing: Routing,
    memory: Memory,
    net: int,
    margin: int,
    layers: int,
) -> int:
    """Puts a box around a net's pins and its tree, some Gcells wider; returns its points."""
    low, size, points = memory.buffers.low, memory.lattice.size, 1
    for axis in range(AXES):
        least, most = problem.size[axis] - 1, i64(0)
        for i in range(problem.first[net], problem.first[net + 1]):
            at = i64(problem.position[problem.pin[i], axis])
            least, most = min(least, at), max(most, at)
        for i in range(routing.start[net], routing.start[net] + routing.length[net]):
            edge = i64(routing.edge[i])
            at = i64(problem.position[edge // AXES, axis])
            least, most = min(least, at), max(most, at)
            if edge % AXES == axis:
                most = max(most, at + 1)
        beyond = layers if axis == VIA_AXIS else margin
        least, most = max(least - beyond, 0), min(most + beyond, problem.size[axis] - 1)
        low[axis], size[axis] = least, most - least + 1
        points *= most - least + 1
    return points


@compiled
def point_of(position: Any, low: Any, size: Any, gcell: int) -> int:
    """The point of a box that a Gcell is."""
    x, y = position[gcell, 0] - low[0], position[gcell, 1] - low[1]
    return (x * size[1] + y) * size[2] + position[gcell, 2] - low[2]


@compiled
def set_costs(
    problem: ProblemArrays, routing: Routing, memory: Memory, net: int, limit: int
) -> None:
    """Gives the moves in a net's box their costs and clears the lattice's tree.

    Two neighbouring columns of the box (or two rows) are as far apart as the cheapest of the edges
    between them costs. Searches know by that how much a tree must still cost at least. Where
    everything overflows, that is far more than the number of edges, and searches stay short. The
    tracks of the net's present tree are free for a new one.
    """
    lattice, low = memory.lattice, memory.buffers.low
    nx, ny, nz = lattice.size[0], lattice.size[1], lattice.size[2]
    set_size(lattice, nx, ny, nz)
    begin_lines(lattice, i64(0))
    for z in range(nz):
        lattice.line[VIA_AXIS, z] = problem.height[low[2] + z] - problem.height[low[2]]
    # Fields are read once: every access makes the compiler handle the whole tuple.
    costs, line, layers = lattice.cost, lattice.line, problem.size[2]
    point = i64(0)
    for x in range(nx):
        for y in range(ny):
            gcell = ((low[0] + x) * problem.size[1] + low[1] + y) * layers + low[2]
            for z in range(nz):
                beside = ny * nz
                for axis in range(AXES):
                    at, last = x, nx - 1
                    if axis == 1:
                        at, last, beside = y, ny - 1, nz
                    elif axis == VIA_AXIS:
                        at, last, beside = z, nz - 1, i64(1)
                    if at == 0:
                        costs[point, 2 * axis + 1] = CLOSED
                    if at == last:
                        costs[point, 2 * axis] = CLOSED
                        continue
                    if axis == VIA_AXIS:
                        cost = i64(problem.height[low[2] + z + 1] - problem.height[low[2] + z])
                    else:
                        edge = AXES * (gcell + z) + axis
                        cost = edge_cost(problem, routing, net, low[2] + z, edge, i64(0))
                        if cost >= limit or problem.capacity[edge] < 0:
                            cost = i64(CLOSED)
                        else:
                            line[axis, at + 1] = min(line[axis, at + 1], cost)
                    costs[point, 2 * axis] = cost
                    costs[point + beside, 2 * axis + 1] = cost
                point += 1
    first = i64(routing.start[net])
    for i in range(first, first + routing.length[net]):
        edge = i64(routing.edge[i])
        gcell = edge // AXES
        axis = edge - AXES * gcell
        if axis == VIA_AXIS:
            continue
        layer = i64(problem.position[gcell, VIA_AXIS])
        cost = edge_cost(problem, routing, net, layer, edge, i64(1))
        if cost < limit:
            at = problem.position[gcell, axis] - low[axis] + 1
            lattice.line[axis, at] = min(lattice.line[axis, at], cost)
            set_cost(lattice, point_of(problem.position, low, lattice.size, gcell), axis, cost)
    if problem.contest:
        _add_stacks(problem, lattice, low)
    sum_lines(lattice)


@compiled
def _extend_bounds(lattice: Lattice, search: Search, group: int, point: int, size: int) -> None:
    """Extends the bounding box of a group (or of the goal) of ``size`` points by one point."""
    ny, nz = lattice.size[1], lattice.size[2]
    row = point // nz
    x = row // ny
    for axis in range(AXES):
        at = x if axis == 0 else row - x * ny if axis == 1 else point - row * nz
        line = lattice.line[axis, at]
        if size == 0 or line < search.low[group, axis]:
            search.low[group, axis] = line
        if size == 0 or line > search.high[group, axis]:
            search.high[group, axis] = line


@compiled
def join_all(problem: ProblemArrays, routing: Routing, memory: Memory, net: int) -> int:
    """Finds a cheapest tree for a net, in ``lattice.tree``; returns its cost, or CLOSED."""
    lattice, search, buffers = memory
    progress, low = routing.progress[0], buffers.low
    first, pins = problem.first[net], problem.first[net + 1] - problem.first[net]
    root = draw(progress) % pins
    goal, group = i64(0), i64(0)
    for i in range(pins):
        point = i64(point_of(problem.position, low, lattice.size, problem.pin[first + i]))
        _extend_bounds(lattice, search, pins - 1 if i == root else group, point, i64(0))
        if i == root:
            goal = point
        else:
            search.start[group], search.group[group] = point, group
            group += 1
    search.goal[goal] = 1
    cost = exact_tree(lattice, search, group, group, draw(progress))
    search.goal[goal] = 0
    for i in range(group):
        search.group[i] = 0
    return cost


@compiled
def grow(problem: ProblemArrays, routing: Routing, memory: Memory, net: int) -> int:
    """Grows a tree pin by pin, always joining the nearest one; returns its cost, or CLOSED."""
    lattice, search, buffers = memory
    progress = routing.progress[0]
    first, pins = problem.first[net], problem.first[net + 1] - problem.first[net]
    ny, nz = lattice.size[1], lattice.size[2]
    for i in range(pins):
        buffers.far[i] = np.iinfo(np.int64).max
    pin = draw(progress) % pins
    size = looked = total = cost = i64(0)
    for joined in range(pins):
        point = i64(point_of(problem.position, buffers.low, lattice.size, problem.pin[first + pin]))
        if not buffers.inside[point]:
            if joined > 0:
                search.goal[point] = 1
                _extend_bounds(lattice, search, i64(1), point, i64(0))
                cost = exact_tree(lattice, search, size, i64(1), draw(progress))
                search.goal[point] = 0
                if cost == CLOSED:
                    break
                total += cost
            # Follow the new path from the pin back into the tree.
            back = CLOSED
            while not buffers.inside[point]:
                buffers.inside[point] = 1
                search.start[size] = point
                size += 1
                for move in range(MOVES):
                    if move != back and lattice.tree[point] >> move & 1:
                        back = move ^ 1
                        point += lattice.stride[move]
                        break
        buffers.far[pin] = -1
        nearest, ties = pin, 0
        for i in range(pins):
            if buffers.far[i] < 0:
                continue
            point = i64(
                point_of(problem.position, buffers.low, lattice.size, problem.pin[first + i])
            )
            x, y, z = point // nz // ny, point // nz % ny, lattice.line[VIA_AXIS, point % nz]
            for j in range(looked, size):
                other = search.start[j]
                across = abs(other // nz // ny - x) + abs(other // nz % ny - y)
                far = UNIT * across + abs(lattice.line[VIA_AXIS, other % nz] - z)
                buffers.far[i] = min(buffers.far[i], far)
            if ties == 0 or buffers.far[i] < buffers.far[nearest]:
                nearest, ties = i, 1
            elif buffers.far[i] == buffers.far[nearest]:
                ties += 1
                if draw(progress) % ties == 0:
                    nearest = i
        looked = size
        pin = nearest
    for i in range(size):
        buffers.inside[search.start[i]] = 0
    return total if cost != CLOSED else i64(CLOSED)


@compiled
def _degree(moves: int) -> int:
    """The number of tree edges at a point, from the bits of ``lattice.tree``."""
    degree = 0
    for move in range(MOVES):
        degree += moves >> move & 1
    return degree


@compiled
def _list_part(
    lattice: Lattice, search: Search, buffers: NetBuffers, point: int, first: int
) -> int:
    """Lists, marks and bounds the points connected to a point; returns the list's end."""
    search.start[first] = point
    buffers.inside[point] = 1
    size = first + 1
    for i in range(first, len(search.start)):
        if i == size:
            break
        point = search.start[i]
        _extend_bounds(lattice, search, i64(1), point, i - first)
        for move in range(MOVES):
            if lattice.tree[point] >> move & 1:
                beside = point + lattice.stride[move]
                if not buffers.inside[beside]:
                    buffers.inside[beside] = 1
                    search.start[size] = beside
                    size += 1
    return size


@compiled
def _other_end(
    problem: ProblemArrays,
    remaining: Any,
    lattice: Lattice,
    buffers: NetBuffers,
    key: int,
    move: int,
    overflowed_only: bool,
) -> int:
    """The key to which a path leads that leaves another by a move; -1 if it does not count."""
    tree, stride, pin, low = lattice.tree, lattice.stride, buffers.pin, buffers.low
    ny, nz = lattice.size[1], lattice.size[2]
    row = key // nz
    gcell = (low[0] + row // ny) * problem.size[1] + low[1] + row % ny
    gcell = gcell * problem.size[2] + low[2] + key - row * nz
    point, counts = key, not overflowed_only
    while True:
        beside, step = point + stride[move], 1 - 2 * (move & 1)
        if move < 2:
            step *= problem.size[1] * problem.size[2]
        elif move < 2 * VIA_AXIS:
            step *= problem.size[2]
        edge = AXES * (gcell + min(step, 0)) + (move >> 1)
        counts |= move < 2 * VIA_AXIS and remaining[edge] < 0
        gcell += step
        point = beside
        if pin[point] or _degree(tree[point]) != 2:
            return point if counts else i64(-1)
        back, move = move ^ 1, i64(0)
        while move == back or not tree[point] >> move & 1:
            move += 1


@compiled
def load_tree(problem: ProblemArrays, routing: Routing, memory: Memory, net: int) -> bool:
    """Makes a net's tree that of the lattice, and returns whether it could.

    It cannot if the tree uses an edge that is closed; the lattice's tree then is empty as before.
    """
    lattice, low = memory.lattice, memory.buffers.low
    is_open = True
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = i64(routing.edge[i])
        gcell = edge // AXES
        move = 2 * (edge - AXES * gcell)
        point = point_of(problem.position, low, lattice.size, gcell)
        is_open &= lattice.cost[point, move] != CLOSED
        lattice.tree[point] |= np.uint8(1 << move)
        lattice.tree[point + lattice.stride[move]] |= np.uint8(2 << move)
    if not is_open:
        for point in range(lattice.size[0] * lattice.size[1] * lattice.size[2]):
            lattice.tree[point] = 0
    return is_open


@compiled
def _is_listed(points: Any, end: int, point: int) -> bool:
    """Whether a point is among the first ``end`` of a list."""
    listed = False
    for i in range(end):
        listed |= points[i] == point
    return listed


@compiled
def _cut(lattice: Lattice, buffers: NetBuffers, key: int, move: int) -> int:
    """Removes the path that leaves a key by a move; returns the key where it ends."""
    point = key
    while True:
        lattice.tree[point] ^= np.uint8(1 << move)
        point += lattice.stride[move]
        lattice.tree[point] ^= np.uint8(1 << (move ^ 1))
        if buffers.pin[point] or _degree(lattice.tree[point]) != 1:
            return point
        move = i64(0)
        while not lattice.tree[point] >> move & 1:
            move += 1


@compiled
def _rejoin(routing: Routing, memory: Memory, one: int, other: int, keys: int) -> None:
    """Joins both parts of a tree, at two of its points, by a cheapest path; ``keys`` are listed."""
    lattice, search, buffers = memory
    starts = _list_part(lattice, search, buffers, one, i64(0))
    both = starts
    if not buffers.inside[other]:
        both = _list_part(lattice, search, buffers, other, starts)
    for i in range(both):
        buffers.inside[search.start[i]] = 0
    if both == starts:
        return  # there was a loop
    # The goal is the smaller part, whose box is smaller, too, and is listed last.
    if 2 * starts < both:
        for i in range(starts):
            _extend_bounds(lattice, search, i64(1), search.start[i], i)
            buffers.key[keys + i] = search.start[i]
        for i in range(both - starts):
            search.start[i] = search.start[starts + i]
        for i in range(starts):
            search.start[both - starts + i] = buffers.key[keys + i]
        starts = both - starts
    for i in range(starts, both):
        search.goal[search.start[i]] = 1
    exact_tree(lattice, search, starts, i64(1), draw(routing.progress[0]))
    for i in range(starts, both):
        search.goal[search.start[i]] = 0


@compiled
def improve_paths(
    problem: ProblemArrays, routing: Routing, memory: Memory, root: int, overflowed_only: bool
) -> None:
    """Replaces each path between two keys of a tree, once, by a cheapest one.

    Keys are pins and the points where the tree branches. With ``overflowed_only``, only paths that
    overflow are replaced.
    """
    lattice, search, buffers = memory
    size = _list_part(lattice, search, buffers, root, i64(0))
    keys = i64(0)
    for i in range(size):
        point = search.start[i]
        buffers.inside[point] = 0
        if buffers.pin[point] or _degree(lattice.tree[point]) > 2:
            buffers.key[keys] = point
            keys += 1
    for place in range(keys * MOVES):
        key, move = buffers.key[place // MOVES], place % MOVES
        if not lattice.tree[key] >> move & 1:
            continue
        if not buffers.pin[key] and _degree(lattice.tree[key]) < 3:
            continue  # no longer a branching point
        end = _other_end(
            problem, routing.remaining, lattice, buffers, key, i64(move), overflowed_only
        )
        if end < 0 or _is_listed(buffers.key, place // MOVES, end):
            continue
        point = _cut(lattice, buffers, key, i64(move))
        _rejoin(routing, memory, key, point, keys)
