"""Steiner points for the pins of one net, chosen on their Hanan grid.

By Hanan's theorem (1966; for any number of dimensions Snyder 1992) a shortest tree needs no Steiner
points other than those of the Hanan grid: an x, a y and a layer, each that of some pin.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES, MOVES
from marouting.trees.exact_tree import Search, exact_tree
from marouting.trees.heap import pop, push
from marouting.trees.lattice import CLOSED, Lattice, set_cost, set_size


class Web(NamedTuple):
    """The points of a net's tree, pins first, and their minimum spanning tree."""

    point: NDArray[np.int64]  # (points, 3)
    parent: NDArray[np.int64]  # (points,) the first pin is its own
    length: NDArray[np.int64]  # (points,) length of the edge to the parent
    degree: NDArray[np.int64]  # (points,)
    order: NDArray[np.int64]  # (points,) parents before their children
    near: NDArray[np.int64]  # (points,) working array


def make_web(pins: int) -> Web:
    """Room for nets of up to so many pins; there are fewer Steiner points than pins."""
    points = 2 * pins + 1
    return Web(np.empty((points, AXES), np.int64), *np.empty((5, points), np.int64))


@compiled
def _span(web: Web, points: int) -> None:
    """Makes the minimum spanning tree of the points (Prim)."""
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
def _settle(web: Web, pins: int, points: int) -> int:
    """Spans the points, dropping Steiner points of degree 2 or less; returns how many are left."""
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
def _gain(web: Web, points: int) -> int:
    """By how much one more point, at index ``points``, shortens the minimum spanning tree.

    From the leaves up, ``near`` is the shortest edge between the new point and a subtree. The
    shorter of this edge and the subtree's edge to its parent stays; the other is offered to the
    parent (Chin and Houck 1978).
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
def set_hanan_grid(lattice: Lattice, web: Web, pins: int) -> None:
    """Turns the lattice into the Hanan grid of the pins, with costs yet to be set."""
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
def exact_points(lattice: Lattice, s: Search, web: Web, pins: int) -> int:
    """Adds the points to ``web`` where a shortest tree of its pins branches; returns how many."""
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
    exact_tree(lattice, s, pins - 1, pins - 1, i64(0))
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
        # A pin is among the points already.
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
def _saves(lattice: Lattice, web: Web, points: int, hanan: int) -> int:
    """By how much a point of the Hanan grid, put at index ``points``, would shorten the tree."""
    ny, nz = lattice.size[1], lattice.size[2]
    web.point[points, 0] = lattice.line[0, hanan // (ny * nz)]
    web.point[points, 1] = lattice.line[1, hanan // nz % ny]
    web.point[points, 2] = lattice.line[2, hanan % nz]
    return _gain(web, points)


@compiled
def iterated_points(lattice: Lattice, s: Search, web: Web, pins: int) -> int:
    """Adds Hanan points by iterated 1-Steiner; returns how many points there are then.

    The point that saves most comes first. A heap holds what each would save, which is worked out
    again only when the point comes first, as other points hardly ever increase it.
    """
    points, before = pins, 0
    _span(web, points)
    candidates = lattice.size[0] * lattice.size[1] * lattice.size[2]
    while points > before:
        before = points
        size = i64(0)
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
