"""Predicted demand: what agents are expected to take of the edges that they have still to reach.

As in RUDY (Spindler and Johannes, "Fast and accurate routing demand estimation for efficient
routability-driven placement", DATE 2007) each open task is expected to take one edge across every
column and every row of the box around its two ends, with equal chances in all rows (columns) of the
box and in all layers that have capacity in that direction. An agent's present task counts from
where the agent is.

The maps follow from the state of the games and are worked out before they are read.
"""

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.places import grid_of
from marouting.batch.setup import Make, zeros
from marouting.batch.state import Dynamic, Static
from marouting.batch.tasks import is_later
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64
from marouting.memory import EXPECTED, check_memory
from marouting.problem.grid import AXES, VIA_AXIS

_BITS = 20
"""Expected demand is counted in parts of 2**-20. Sums of integers are the same in any order, so it
makes no difference how a state has come about."""


class Maps(NamedTuple):
    """What is known about M problems beyond their state, brought up to date before it is read."""

    lanes: NDArray[np.int32]  # (M, 2, Z) 1 for layers with capacity along x, along y
    lane_count: NDArray[np.int32]  # (M, 2) their number, at least 1
    track: NDArray[np.float32]  # (M, Z) mean demand of the agents on an edge, for the state
    expected: NDArray[np.int64]  # (M, G, 2) expected demand on a Gcell's edges towards +x and +y


_maps: WeakKeyDictionary[Engine, tuple[Maps, NDArray[np.int64]]] = WeakKeyDictionary()
"""The maps of every engine that is observed, and (M,) which of the problems that have been in its
places they are of. They follow from its state, so nobody saves them."""


def new_maps(m: int, gcells: int, layers: int, make: Make = zeros) -> Maps:
    """Maps of M problems with G Gcells and Z layers, yet to begin."""
    return Maps(
        lanes=make("lanes", (m, VIA_AXIS, layers), np.int32),
        lane_count=make("lane_count", (m, VIA_AXIS), np.int32),
        track=make("track", (m, layers), np.float32),
        expected=make("expected", (m, gcells, 2), np.int64),
    )


def maps_of(engine: Engine) -> Maps:
    """The maps of an engine, new ones if it has none yet."""
    found = _maps.get(engine)
    if found is None:
        grid = engine.grid
        m = len(engine.games)
        check_memory(EXPECTED * m * grid.gcells, "expected demand of {} grids of {}", m, grid)
        maps = new_maps(m, grid.gcells, grid.shape[VIA_AXIS])
        found = _maps[engine] = maps, np.full(m, NOBODY, np.int64)
    maps, replaced = found
    if (replaced != engine.replaced).any():
        for m in np.flatnonzero(replaced != engine.replaced).tolist():
            _begin_maps(engine.static, maps, m)
        replaced[:] = engine.replaced
    return maps


def _begin_maps(static: Static, maps: Maps, m: int) -> None:
    """Fills in the maps of a problem, in which nobody is counted yet."""
    layers = static.demand.shape[2]
    capacity = static.capacity[m].reshape(-1, layers, AXES)[..., :VIA_AXIS]
    lanes = (capacity > 0).any(axis=0).T
    lanes[~lanes.any(axis=1)] = True
    maps.lanes[m], maps.lane_count[m] = lanes, lanes.sum(axis=1)
    maps.track[m] = track_of(static, m)


def track_of(static: Static, m: int) -> NDArray[np.float64]:
    """(Z,) the mean demand of a problem's agents on an edge of each layer, 1 where it is 0."""
    playing = np.count_nonzero(np.diff(static.first[m]))
    tracks = static.demand[m].sum(axis=0)
    return np.where(tracks > 0, tracks / playing, 1)


@compiled
def share_of(static: Static, maps: Maps, m: int, n: int, axis: int, z: int, across: int) -> int:
    """What a net is expected to take of each edge along an axis in a layer of a task's box."""
    demand = i64(maps.lanes[m, axis, z]) * i64(static.demand[m, n, z])
    return (demand << _BITS) // (across * i64(maps.lane_count[m, axis]))


@compiled
def count_task(static: Static, maps: Maps, m: int, n: int, near: int, far: int) -> None:
    """Adds a task from one Gcell to another to the corners of ``expected``."""
    columns, rows, layers = grid_of(static)
    x0, x1 = i64(static.position[near, 0]), i64(static.position[far, 0])
    y0, y1 = i64(static.position[near, 1]), i64(static.position[far, 1])
    x0, x1, y0, y1 = min(x0, x1), max(x0, x1), min(y0, y1), max(y0, y1)
    if x0 == x1 and y0 == y1:
        return
    for z in range(layers):
        if x0 < x1:
            share = share_of(static, maps, m, n, 0, z, y1 - y0 + 1)
            maps.expected[m, as_index((x0 * rows + y0) * layers + z), 0] += share
            maps.expected[m, as_index((x1 * rows + y0) * layers + z), 0] -= share
            if y1 + 1 < rows:
                maps.expected[m, as_index((x0 * rows + y1 + 1) * layers + z), 0] -= share
                maps.expected[m, as_index((x1 * rows + y1 + 1) * layers + z), 0] += share
        if y0 < y1:
            share = share_of(static, maps, m, n, 1, z, x1 - x0 + 1)
            maps.expected[m, as_index((x0 * rows + y0) * layers + z), 1] += share
            maps.expected[m, as_index((x0 * rows + y1) * layers + z), 1] -= share
            if x1 + 1 < columns:
                maps.expected[m, as_index(((x1 + 1) * rows + y0) * layers + z), 1] -= share
                maps.expected[m, as_index(((x1 + 1) * rows + y1) * layers + z), 1] += share


@compiled
def refresh(static: Static, dynamic: Dynamic, maps: Maps, m: int, without: int) -> None:
    """Works out the maps of a problem, without what one agent is expected to take."""
    _, rows, layers = grid_of(static)
    expected, column = maps.expected, rows * layers
    for cell in range(expected.shape[1]):
        expected[m, cell, 0] = expected[m, cell, 1] = 0
    for n in range(dynamic.agents.shape[1]):
        agent = dynamic.agents[m, n]
        if agent.status != Status.ACTIVE or n == without:
            continue
        count_task(static, maps, m, i64(n), as_index(agent.cell), as_index(agent.target))
        for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
            if is_later(static, dynamic, m, i64(n), i64(task)):
                near, far = as_index(static.tasks[task, 0]), as_index(static.tasks[task, 1])
                count_task(static, maps, m, i64(n), near, far)
    for cell in range(expected.shape[1]):  # sums over lower x and y
        x, y = cell // column, cell // layers % rows
        for axis in range(VIA_AXIS):
            if x > 0:
                expected[m, cell, axis] += expected[m, as_index(cell - column), axis]
            if y > 0:
                expected[m, cell, axis] += expected[m, as_index(cell - layers), axis]
            if x > 0 and y > 0:
                expected[m, cell, axis] -= expected[m, as_index(cell - column - layers), axis]


@compiled
def squashed(number: Any) -> Any:
    """float32, q / (1 + |q|)."""
    return number / (np.float32(1) + abs(number))


@compiled
def slack_of(maps: Maps, m: int, cell: int, axis: int, remaining: int, track: Any) -> Any:
    """float32 remaining capacity less expected demand, in tracks."""
    expected = np.float32(maps.expected[m, cell, axis]) * np.float32(2.0**-_BITS)
    return (np.float32(remaining) - expected) / track
