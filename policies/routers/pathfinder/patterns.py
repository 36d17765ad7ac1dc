"""Compiled code for the first pass: every net gets a tree of patterns, in a microsecond per pin.

A net grows pin by pin, always joining the pin nearest to the tree by an L: straight along x in one
layer, straight along y in another, and vias between them. Of both L's and all pairs of layers it
takes the one that adds the least overflow, and of these the one with the fewest vias. So there is a
whole solution before the first search begins, however large the problem.
"""

from typing import Any

import numpy as np

from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.lattice import Lattice, set_size
from policies.routers.pathfinder.kernels import edge_cost, point_of, set_box
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DONE,
    POOL_TOO_SMALL,
    UNIT,
    Memory,
    NetBuffers,
    ProblemArrays,
    Routing,
)
from policies.routers.pathfinder.trees import list_tree, store_tree, use_tree

_NEVER = 1 << 50  # more than any pattern costs


@compiled
def _straight(
    problem: ProblemArrays,
    routing: Routing,
    net: int,
    axis: int,
    begin: int,
    end: int,
    across: int,
    cost: Any,
) -> None:
    """What a straight wire costs a net in every layer; over :data:`_NEVER` if it must not be."""
    low, high = min(begin, end), max(begin, end)
    step = problem.size[2] * (problem.size[1] if axis == 0 else 1)
    x, y = (low, across) if axis == 0 else (across, low)
    for z in range(problem.size[2]):
        gcell = (x * problem.size[1] + y) * problem.size[2] + z
        total = i64(0)
        for _ in range(high - low):
            edge = AXES * gcell + axis
            if problem.capacity[edge] < 0:
                total += _NEVER
            total += edge_cost(problem, routing, net, i64(z), edge, i64(0))
            gcell += step
        cost[z] = total


@compiled
def _climb(height: Any, one: int, other: int) -> int:
    """What the vias from one layer to another cost; even free ones must not lead up and down."""
    return max(abs(height[one] - height[other]), abs(one - other))


@compiled
def _best_layers(
    along: Any, across: Any, first: int, last: int, height: Any
) -> tuple[int, int, int]:
    """The cost and both layers of the cheapest pair of layers of an L, with all its vias."""
    least, one, two = 4 * _NEVER, i64(0), i64(0)
    for a in range(len(along)):
        for b in range(len(across)):
            vias = _climb(height, first, a) + _climb(height, a, b) + _climb(height, b, last)
            cost = along[a] + across[b] + vias
            if cost < least:
                least, one, two = i64(cost), i64(a), i64(b)
    return least, one, two


@compiled
def _draw_line(
    lattice: Lattice, buffers: NetBuffers, point: int, axis: int, steps: int, size: int
) -> tuple[int, int]:
    """Adds a line, up to where it meets the tree; returns its end and the number of points."""
    move = 2 * axis + i64(steps < 0)
    for _ in range(abs(steps)):
        if buffers.inside[point] == 1:
            break
        lattice.tree[point] |= np.uint8(1 << move)
        point += lattice.stride[move]
        lattice.tree[point] |= np.uint8(1 << (move ^ 1))
        if buffers.inside[point] != 1:
            buffers.key[size] = point
            size += 1
    return point, size


@compiled
def _nearest(
    problem: ProblemArrays,
    lattice: Lattice,
    buffers: NetBuffers,
    pin: int,
    begin: int,
    end: int,
) -> tuple[int, int]:
    """The point of a part of the tree's list that is nearest to a pin, and how far, in cost."""
    x, y = problem.position[pin, 0] - buffers.low[0], problem.position[pin, 1] - buffers.low[1]
    ny, nz = lattice.size[1], lattice.size[2]
    nearest, least = i64(0), _NEVER
    for i in range(begin, end):
        row = buffers.key[i] // nz
        z = buffers.key[i] - row * nz
        across = abs(row // ny - x) + abs(row % ny - y)
        far = UNIT * across + _climb(problem.height, z, i64(problem.position[pin, VIA_AXIS]))
        if far < least:
            nearest, least = i64(buffers.key[i]), far
    return nearest, least


@compiled
def route_pattern(problem: ProblemArrays, routing: Routing, memory: Memory, net: int) -> int:
    """Gives a net a tree of patterns, unless it has one to begin with; puts its tree in place.

    Returns:
        DONE; or BOX_TOO_SMALL or POOL_TOO_SMALL, in which case the net is left as it was.
    """
    lattice, buffers, progress = memory.lattice, memory.buffers, routing.progress[0]
    if routing.length[net] > 0:
        use_tree(problem, routing, net, i64(1))
        return DONE
    points = set_box(problem, routing, memory, net, i64(0), problem.size[VIA_AXIS])
    if points > len(buffers.pin):
        progress.need = points
        return BOX_TOO_SMALL
    if progress.top + points > len(routing.edge):
        progress.need = progress.top + points
        return POOL_TOO_SMALL
    set_size(lattice, lattice.size[0], lattice.size[1], lattice.size[2])
    first, pins = problem.first[net], problem.first[net + 1] - problem.first[net]
    start = point_of(problem.position, buffers.low, lattice.size, problem.pin[first])
    buffers.key[0], buffers.inside[start] = start, 1
    for i in range(pins):
        buffers.far[i] = _NEVER
    size, looked = i64(1), i64(0)
    for _ in range(1, pins):
        pin = i64(-1)
        for i in range(1, pins):
            if buffers.far[i] < 0:
                continue
            at = problem.pin[first + i]
            _, far = _nearest(problem, lattice, buffers, at, looked, size)
            buffers.far[i] = min(buffers.far[i], far)
            if pin < 0 or buffers.far[i] < buffers.far[pin]:
                pin = i64(i)
        looked = size
        size = _join(problem, routing, memory, net, problem.pin[first + pin], size)
        buffers.far[pin] = -1
    for i in range(size):
        buffers.inside[buffers.key[i]] = 0
    size = list_tree(problem, lattice, buffers)
    store_tree(routing, net, buffers.tree, i64(0), size)
    use_tree(problem, routing, net, i64(1))
    progress.routed += 1
    return DONE


@compiled
def _join(
    problem: ProblemArrays, routing: Routing, memory: Memory, net: int, pin: int, size: int
) -> int:
    """Joins a pin's Gcell to the tree by an L; returns the tree's number of points."""
    lattice, buffers = memory.lattice, memory.buffers
    point = point_of(problem.position, buffers.low, lattice.size, pin)
    if buffers.inside[point]:
        return size
    nearest, _ = _nearest(problem, lattice, buffers, pin, i64(0), size)
    nz = lattice.size[2]
    here = (i64(problem.position[pin, 0]), i64(problem.position[pin, 1]))
    row = nearest // nz
    there = (buffers.low[0] + row // lattice.size[1], buffers.low[1] + row % lattice.size[1])
    top, bottom = i64(problem.position[pin, VIA_AXIS]), nearest - row * nz
    one_wire, other_wire = buffers.layers[0], buffers.layers[1]
    least, turn, one, two = i64(8 * _NEVER), i64(0), i64(0), i64(0)
    for first in range(VIA_AXIS):  # the axis along which it begins
        then = 1 - first
        _straight(problem, routing, net, first, here[first], there[first], here[then], one_wire)
        _straight(problem, routing, net, then, here[then], there[then], there[first], other_wire)
        cost, a, b = _best_layers(one_wire, other_wire, top, bottom, problem.height)
        if cost < least:
            least, turn, one, two = cost, first, a, b
    end = size + 1
    buffers.key[size] = point
    legs = (
        (VIA_AXIS, one - top),
        (turn, there[turn] - here[turn]),
        (VIA_AXIS, two - one),
        (1 - turn, there[1 - turn] - here[1 - turn]),
        (VIA_AXIS, bottom - two),
    )
    for axis, steps in legs:
        point, end = _draw_line(lattice, buffers, point, axis, steps, end)
    for i in range(size, end):
        buffers.inside[buffers.key[i]] = 1
    return end
