"""Predicted demand: what agents are expected to take of the edges that they have still to reach.

As in RUDY (Spindler and Johannes, "Fast and accurate routing demand estimation for efficient
routability-driven placement", DATE 2007) each open task is expected to take one edge across every
column and every row of the box around its two ends, with equal chances in all rows (columns) of the
box and in all layers that have capacity in that direction. An agent's present task counts from
where the agent is.

The maps follow from the state of the games and are brought up to date before they are read: only
agents that have moved are counted again.
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

_NO_COLUMN = 2**31 - 1


class Maps(NamedTuple):
    """What is known about M problems beyond their state, brought up to date before it is read."""

    lanes: NDArray[np.int32]  # (M, 2, Z) 1 for layers with capacity along x, along y
    lane_count: NDArray[np.int32]  # (M, 2) their number, at least 1
    track: NDArray[np.float32]  # (M, Z) mean demand of the agents on an edge, for the state
    counted: NDArray[np.int32]  # (M, N, 3) Gcell, target and task of agents in the maps, or NOBODY
    corner: NDArray[np.int64]  # (M, G, 2) what ``expected`` is the sum of, over lower x and y
    expected: NDArray[np.int64]  # (M, G, 2) expected demand on a Gcell's edges towards +x and +y
    later: NDArray[np.uint8]  # (M, T) tasks in the maps that agents have still to begin
    changed: NDArray[np.int32]  # (M, 2) first and last column with changes to be summed up


_maps: WeakKeyDictionary[Engine, tuple[Maps, NDArray[np.int64]]] = WeakKeyDictionary()
"""The maps of every engine that is observed, and (M,) which of the problems that have been in its
places they are of. They follow from its state, so nobody saves them."""


def new_maps(shape: tuple[int, int, int, int, int], make: Make = zeros) -> Maps:
    """Maps of M problems with N agents, G Gcells, Z layers and T tasks (shape), yet to begin."""
    m, n, gcells, layers, tasks = shape
    return Maps(
        lanes=make("lanes", (m, VIA_AXIS, layers), np.int32),
        lane_count=make("lane_count", (m, VIA_AXIS), np.int32),
        track=make("track", (m, layers), np.float32),
        counted=make("counted", (m, n, 3), np.int32),
        corner=make("corner", (m, gcells, 2), np.int64),
        expected=make("expected", (m, gcells, 2), np.int64),
        later=make("later", (m, tasks), np.uint8),
        changed=make("changed", (m, 2), np.int32),
    )


def maps_of(engine: Engine) -> Maps:
    """The maps of an engine, new ones if it has none yet."""
    found = _maps.get(engine)
    if found is None:
        grid = engine.grid
        m, n = engine.nets.shape
        layers = grid.shape[VIA_AXIS]
        check_memory(EXPECTED * m * grid.gcells, "expected demand of {} grids of {}", m, grid)
        maps = new_maps((m, n, grid.gcells, layers, engine.most_tasks))
        found = _maps[engine] = maps, np.full(m, NOBODY, np.int64)
    maps, of = found
    if (of != engine.replaced).any():
        for m in np.flatnonzero(of != engine.replaced).tolist():
            _begin_maps(engine.static, maps, m)
        of[:] = engine.replaced
    return maps


def _begin_maps(static: Static, maps: Maps, m: int) -> None:
    """Fills in the maps of a problem, in which nobody is counted yet."""
    layers = static.demand.shape[2]
    capacity = static.capacity[m].reshape(-1, layers, AXES)[..., :VIA_AXIS]
    lanes = (capacity > 0).any(axis=0).T
    lanes[~lanes.any(axis=1)] = True
    maps.lanes[m], maps.lane_count[m] = lanes, lanes.sum(axis=1)
    maps.track[m] = track_of(static, m)
    maps.counted[m] = NOBODY
    maps.changed[m] = _NO_COLUMN, NOBODY
    for array in (maps.corner, maps.expected, maps.later):
        array[m] = 0


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
def count_task(static: Static, maps: Maps, m: int, n: int, near: int, far: int, sign: int) -> None:
    """Adds a task from one Gcell to another to the corners (``sign`` 1), or takes it off (−1)."""
    columns, rows, layers = grid_of(static)
    x0, x1 = i64(static.position[near, 0]), i64(static.position[far, 0])
    y0, y1 = i64(static.position[near, 1]), i64(static.position[far, 1])
    x0, x1, y0, y1 = min(x0, x1), max(x0, x1), min(y0, y1), max(y0, y1)
    if x0 == x1 and y0 == y1:
        return
    maps.changed[m, 0] = min(maps.changed[m, 0], x0)
    maps.changed[m, 1] = max(maps.changed[m, 1], x1)
    for z in range(layers):
        if x0 < x1:
            share = sign * share_of(static, maps, m, n, 0, z, y1 - y0 + 1)
            maps.corner[m, as_index((x0 * rows + y0) * layers + z), 0] += share
            maps.corner[m, as_index((x1 * rows + y0) * layers + z), 0] -= share
            if y1 + 1 < rows:
                maps.corner[m, as_index((x0 * rows + y1 + 1) * layers + z), 0] -= share
                maps.corner[m, as_index((x1 * rows + y1 + 1) * layers + z), 0] += share
        if y0 < y1:
            share = sign * share_of(static, maps, m, n, 1, z, x1 - x0 + 1)
            maps.corner[m, as_index((x0 * rows + y0) * layers + z), 1] += share
            maps.corner[m, as_index((x0 * rows + y1) * layers + z), 1] -= share
            if x1 + 1 < columns:
                maps.corner[m, as_index(((x1 + 1) * rows + y0) * layers + z), 1] -= share
                maps.corner[m, as_index(((x1 + 1) * rows + y1) * layers + z), 1] += share


@compiled
def count_agent(static: Static, maps: Maps, m: int, n: int, later: bool, sign: int) -> None:
    """Adds an agent's present task and those noted as later to the maps, or takes them off."""
    cell, target = as_index(maps.counted[m, n, 0]), as_index(maps.counted[m, n, 1])
    count_task(static, maps, m, n, cell, target, sign)
    if later:
        for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
            if not maps.later[m, task - static.first[m, 0]]:
                continue
            near, far = as_index(static.tasks[task, 0]), as_index(static.tasks[task, 1])
            count_task(static, maps, m, n, near, far, sign)


@compiled
def recount(static: Static, dynamic: Dynamic, maps: Maps, m: int, n: int, counts: bool) -> None:
    """Counts an agent again if it has moved; afterwards :func:`sum_up` has to be called."""
    agent = dynamic.agents[m, n]
    active = agent.status == Status.ACTIVE and counts
    cell = i64(agent.cell) if active else i64(NOBODY)
    target, task = i64(agent.target), i64(agent.task)
    before = i64(maps.counted[m, n, 0])
    same = task == maps.counted[m, n, 2]
    if static.extended is not None and active:
        for t in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
            noted = maps.later[m, t - static.first[m, 0]] != 0
            same &= noted == is_later(static, dynamic, m, n, i64(t))
    if cell == before and (cell == NOBODY or (same and target == maps.counted[m, n, 1])):
        return
    later = not (same and active and before != NOBODY)
    # Two turns instead of two calls, which would compile the counting twice.
    for sign in range(-1, 2, 2):
        if sign == 1:
            maps.counted[m, n, 0] = cell
            maps.counted[m, n, 1] = target
            maps.counted[m, n, 2] = task
            for t in range(later * static.first[m, n], later * static.first[m, n + 1]):
                noted = active and is_later(static, dynamic, m, n, i64(t))
                maps.later[m, t - static.first[m, 0]] = noted
        if maps.counted[m, n, 0] != NOBODY:
            count_agent(static, maps, m, n, later, sign)


@compiled
def sum_up(static: Static, maps: Maps, m: int) -> None:
    """Brings a problem's ``expected`` up to date with its ``corner``."""
    _, rows, layers = grid_of(static)
    # To the left of a box that has changed nothing changes, and to the right of it neither.
    column = rows * layers
    for x in range(i64(maps.changed[m, 0]), i64(maps.changed[m, 1]) + 1):
        for y in range(rows):
            for z in range(layers):
                cell = as_index(x * column + y * layers + z)
                for axis in range(VIA_AXIS):
                    total = maps.corner[m, cell, axis]
                    if x > 0:
                        total += maps.expected[m, as_index(cell - column), axis]
                    if y > 0:
                        total += maps.expected[m, as_index(cell - layers), axis]
                    if x > 0 and y > 0:
                        total -= maps.expected[m, as_index(cell - column - layers), axis]
                    maps.expected[m, cell, axis] = total
    maps.changed[m, 0], maps.changed[m, 1] = _NO_COLUMN, NOBODY


@compiled
def refresh(static: Static, dynamic: Dynamic, maps: Maps, m: int, without: int) -> None:
    """Brings the maps of a problem up to date: agents that have moved are counted again."""
    for n in range(dynamic.agents.shape[1]):
        # Most are done, and stand in no map: they are passed over without a call.
        if dynamic.agents[m, n].status == Status.ACTIVE or maps.counted[m, n, 0] != NOBODY:
            recount(static, dynamic, maps, m, i64(n), n != without)
    sum_up(static, maps, m)


@compiled
def squashed(number: Any) -> Any:
    """float32, q / (1 + |q|)."""
    return number / (np.float32(1) + abs(number))


@compiled
def slack_of(maps: Maps, m: int, cell: int, axis: int, remaining: int, track: Any) -> Any:
    """float32 remaining capacity less expected demand, in tracks."""
    expected = np.float32(maps.expected[m, cell, axis]) * np.float32(2.0**-_BITS)
    return (np.float32(remaining) - expected) / track
