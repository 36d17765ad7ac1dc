"""Cheapest trees where nets negotiate, for agents to walk along.

In games with prices (:mod:`marouting.batch.prices`) one net walks at a time, so what its edges cost
stays as it is until it has walked: in priced rounds what prices say, in others 1, and the most
where it would overflow. If it has few pins, a tree that costs it the least can be found by the
search of :mod:`marouting.trees.exact_tree`, inside a box around its pins. Its agent then walks
along the tree by ordinary moves, from task to task.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.places import grid_of, position
from marouting.batch.prices import MOST, UNIT, edge_cost, is_priced
from marouting.batch.state import Dynamic, Static
from marouting.game import NOBODY
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.trees.exact_tree import Search, exact_tree, make_search
from marouting.trees.lattice import CLOSED, Lattice, begin_lines, make_lattice, set_size, sum_lines

MOST_PINS = 9
"""The most pins of a net whose trees can be looked for."""

_FIRST_LABELS, _LABELS = 1 << 12, 1 << 14
"""A box of so many points is searched for a net of two pins, of half as many for one of three, and
so on: larger boxes take too long. In the first walk, with hardly any prices to see, they are worth
less time."""


class Trees(NamedTuple):
    """The trees that the agents of M games walk along, and the working arrays of the search.

    Each game holds one tree, that of the net which walks.
    """

    lattice: Lattice
    search: Search
    low: NDArray[np.int64]  # (3,) the first point of the box
    pins: NDArray[np.int64]  # (MOST_PINS,) Gcells of the net's pins
    of: NDArray[np.int64]  # (M, 3) whose tree it is: the agent, the round, and the rip-up in it
    found: NDArray[np.bool_]  # (M,) whether there is one
    task: NDArray[np.int64]  # (M,) the task that ``toward`` is of
    made: NDArray[np.int64]  # (M,) trees so far
    known: NDArray[np.int64]  # (M, G) the last tree that touches a Gcell
    edges: NDArray[np.uint8]  # (M, G) bit m: it has the edge that move m crosses
    toward: NDArray[np.int8]  # (M, G) the move along it towards the end of the task
    queue: NDArray[np.int32]  # (G,) working


def make_trees(engine: Engine, pins: int) -> Trees:
    """Room for the trees of nets with at most so many pins; below 2 there is no room for any."""
    games, cells, labels = len(engine.games), engine.grid.gcells, _LABELS
    if pins < 2:
        pins, cells, labels = 2, 0, 0
    points = min(cells, labels >> 1)
    return Trees(
        lattice=make_lattice(points, max(engine.grid.shape)),
        search=make_search(points, labels, pins - 1),
        low=np.zeros(AXES, np.int64),
        pins=np.zeros(MOST_PINS, np.int64),
        of=np.full((games, 3), NOBODY, np.int64),
        found=np.zeros(games, np.bool_),
        task=np.full(games, NOBODY, np.int64),
        made=np.zeros(games, np.int64),
        known=np.zeros((games, cells), np.int64),
        edges=np.zeros((games, cells), np.uint8),
        toward=np.zeros((games, cells), np.int8),
        queue=np.zeros(cells, np.int32),
    )


@compiled
def _find_pins(static: Static, t: Trees, m: int, n: int, most: int) -> int:
    """Finds the different Gcells of a net's pins; returns how many, or NOBODY for too many."""
    pins = i64(0)
    for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
        for end in range(2):
            cell, known = i64(static.tasks[task, end]), False
            for k in range(pins):
                known |= t.pins[k] == cell
            if known:
                continue
            if pins == most:
                return i64(NOBODY)
            t.pins[pins] = cell
            pins += 1
    return pins


@compiled
def _set_box(static: Static, t: Trees, pins: int, margin: int) -> int:
    """Lays the box around the pins; returns how many points it has."""
    size, points = t.lattice.size, i64(1)
    columns, rows, layers = grid_of(static)
    for axis in range(AXES):
        side = columns if axis == 0 else rows if axis == 1 else layers
        low, high = i64(0), side - 1
        if axis < VIA_AXIS:
            low, high = high, low
            for k in range(pins):
                at = i64(static.position[as_index(t.pins[k]), axis])
                low, high = min(low, at), max(high, at)
            low, high = max(low - margin, 0), min(high + margin, side - 1)
        t.low[axis], size[axis] = low, high - low + 1
        points *= high - low + 1
    return points


@compiled
def _gcell(static: Static, t: Trees, point: int) -> int:
    """The Gcell that a point of the box is."""
    size = t.lattice.size
    row = point // size[2]
    x, y, z = row // size[1] + t.low[0], row % size[1] + t.low[1], point % size[2]
    _, rows, layers = grid_of(static)
    return i64((x * rows + y) * layers + z)


@compiled
def _edge_cost(static: Static, dynamic: Dynamic, m: int, edge: int, demand: int) -> int:
    """What an edge inside a layer costs a net that does not use it."""
    room = i64(dynamic.remaining[m, edge])
    if is_priced(static, dynamic, m):
        return edge_cost(static, dynamic, m, edge, demand, room)
    return i64(MOST if room < demand else UNIT)


@compiled
def _set_costs(static: Static, dynamic: Dynamic, t: Trees, m: int, n: int) -> None:
    """Gives the edges of the box their costs, and lines of columns and rows the least of them."""
    nx, ny, nz = t.lattice.size[0], t.lattice.size[1], t.lattice.size[2]
    set_size(t.lattice, nx, ny, nz)
    begin_lines(t.lattice, i64(UNIT))
    cost, line = t.lattice.cost, t.lattice.line
    _, rows, layers = grid_of(static)
    point = i64(0)
    for x in range(nx):
        for y in range(ny):
            cell = ((t.low[0] + x) * rows + t.low[1] + y) * layers
            for z in range(nz):
                demand = i64(static.demand[m, n, z])
                for axis in range(AXES):
                    at, last, beside = x, nx - 1, ny * nz
                    if axis == 1:
                        at, last, beside = y, ny - 1, nz
                    elif axis == VIA_AXIS:
                        at, last, beside = z, nz - 1, i64(1)
                    if at == 0:
                        cost[point, 2 * axis + 1] = CLOSED
                    if at == last:
                        cost[point, 2 * axis] = CLOSED
                        continue
                    one = i64(UNIT)
                    if axis < VIA_AXIS:
                        edge = i64(AXES * (cell + z) + axis)
                        one = _edge_cost(static, dynamic, m, edge, demand)
                        line[axis, at + 1] = min(line[axis, at + 1], one)
                    cost[point, 2 * axis] = one
                    cost[point + beside, 2 * axis + 1] = one
                point += 1
    sum_lines(t.lattice)


@compiled
def _find(static: Static, t: Trees, pins: int, random: int) -> None:
    """Finds a cheapest tree of the pins in the box, in ``lattice.tree``."""
    size, line, s = t.lattice.size, t.lattice.line, t.search
    goal, root = i64(0), random % pins
    group = i64(0)
    for k in range(pins):
        x, y, z = position(static, as_index(t.pins[k]))
        x, y = x - t.low[0], y - t.low[1]
        point, row = (x * size[1] + y) * size[2] + z, pins - 1
        if k == root:
            goal = point
        else:
            s.start[group], s.group[group] = point, group
            row, group = group, group + 1
        for axis in range(AXES):
            at = line[axis, x if axis == 0 else y if axis == 1 else z]
            s.low[row, axis] = s.high[row, axis] = at
    s.goal[goal] = 1
    exact_tree(t.lattice, s, group, group, random)
    s.goal[goal] = 0
    for k in range(group):
        s.group[k] = 0


@compiled
def plan_tree(
    static: Static, dynamic: Dynamic, t: Trees, m: int, n: int, most: int, margin: int, random: int
) -> bool:
    """Finds a cheapest tree for a net that uses no edge; whether its pins are few and near."""
    t.of[m, 0], t.of[m, 1], t.of[m, 2] = n, dynamic.games[m].round, dynamic.games[m].reroutes
    t.found[m] = False
    pins = _find_pins(static, t, m, n, most)
    if pins < 2:
        return False
    labels = _FIRST_LABELS if dynamic.games[m].round == 0 else _LABELS
    points = _set_box(static, t, pins, margin)
    while points << (pins - 1) > labels and margin > 0:
        margin //= 2
        points = _set_box(static, t, pins, margin)
    if points << (pins - 1) > labels:
        return False
    _set_costs(static, dynamic, t, m, n)
    _find(static, t, pins, random)
    t.task[m] = NOBODY
    t.made[m] += 1
    t.found[m] = True
    for point in range(points):
        if t.lattice.tree[point] != 0:
            cell = as_index(_gcell(static, t, point))
            t.known[m, cell], t.edges[m, cell] = t.made[m], t.lattice.tree[point]
    return True


@compiled
def is_planned(dynamic: Dynamic, t: Trees, m: int, n: int) -> bool:
    """Whether a tree has been looked for in this walk of the agent."""
    game = dynamic.games[m]
    return t.of[m, 0] == n and t.of[m, 1] == game.round and t.of[m, 2] == game.reroutes


@compiled
def move_on_tree(static: Static, dynamic: Dynamic, t: Trees, m: int, n: int) -> int:
    """An agent's move along its net's tree towards the end of its task; NOBODY if it has none."""
    agent = dynamic.agents[m, n]
    if not t.found[m] or not is_planned(dynamic, t, m, n):
        return i64(NOBODY)
    cell, target = as_index(agent.cell), as_index(agent.target)
    if t.known[m, cell] != t.made[m] or t.known[m, target] != t.made[m]:
        return i64(NOBODY)
    if t.task[m] != agent.task:
        t.task[m] = agent.task
        t.toward[m, target] = NOBODY
        t.queue[0] = target
        at, size = 0, 1
        while at < size:
            here = as_index(t.queue[at])
            at += 1
            for move in range(MOVES):
                if t.edges[m, here] >> move & 1 and move != t.toward[m, here]:
                    there = as_index(static.neighbour[here, move])
                    t.toward[m, there] = move ^ 1
                    t.queue[size] = there
                    size += 1
    return i64(t.toward[m, cell])
