"""A route's edges as straight segments between points on the chip, and back.

Points are given as in ISPD files: x and y in chip coordinates, layer from 1.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from marouting.memory import USED, check_memory
from marouting.problem.grid import AXES, OFF_GRID, VIA_AXIS, counted
from marouting.problem.net import FieldError, Pin
from marouting.problem.problem import Problem


def covered_edges(
    problem: Problem, points: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges that segments with ends ``points`` (n, 2, 3) cover; none if within one Gcell.

    Returns:
        (k,) twice: for each edge covered the index of its segment, ascending, and its number.

    Raises:
        FieldError: an end is off the grid, or a segment is not straight; ``row`` tells which.
        InputError: the edges would take too much memory.
    """
    gcells = problem.gcells(points.reshape(-1, 3)).reshape(-1, 2)
    return edges_between(problem, gcells, points, problem.extent)


def edges_between(
    problem: Problem, gcells: NDArray[np.int64], points: NDArray[np.int64], extent: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges that segments between Gcells (n, 2) cover, as :func:`covered_edges` returns them.

    ``gcells`` are OFF_GRID for ends off the grid; ``points``, the ends as given, and ``extent``,
    what ends have to be, are for error messages.
    """
    position = np.stack(np.unravel_index(gcells.clip(0), problem.grid), axis=-1)
    span = np.abs(position[:, 1] - position[:, 0])
    wrong = (gcells == OFF_GRID).any(axis=1) | (np.count_nonzero(span, axis=1) > 1)
    if wrong.any():
        row = int(wrong.argmax())
        expected = "a segment along one axis, found a diagonal one"
        for point, gcell in zip(points[row].tolist(), gcells[row], strict=True):
            if gcell == OFF_GRID:
                expected = f"{extent}, found {tuple(point)}"
                break
        raise FieldError(f"expected {expected}", "segments", row)
    axis, length = span.argmax(axis=1), span.sum(axis=1)
    edges = int(length.sum())  # a line of text may cover millions
    check_memory(USED * edges, "a solution of {} edges", edges)
    segment, step = counted(length)
    first = AXES * gcells.min(axis=1) + axis
    return segment, first[segment] + AXES * problem.strides[axis[segment]] * step


def longest_segments(
    problem: Problem, net: NDArray[np.int64], edge: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Joins edges (k,) of nets (k,) into the longest straight segments of each net.

    Returns:
        (n,) the net of each segment and (n, 2, 3) the centres of its two end Gcells, the lower
        Gcell first; ordered by net, lower end and axis.
    """
    owner, ends = longest_runs(problem, net, edge)
    return owner, _centres(problem, ends)


def longest_runs(
    problem: Problem, net: NDArray[np.int64], edge: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """As :func:`longest_segments`, but with (n, 2) the numbers of the end Gcells."""
    columns, rows, layers = problem.grid
    size = columns * rows * layers
    gcell, axis = edge // AXES, edge % AXES
    x, y, z = np.unravel_index(gcell, problem.grid)
    # Numbered along their own axis, neighbouring edges follow each other; those of different rows
    # never do, as no edge begins at the end of a row.
    along = np.where(axis == 0, (y * layers + z) * columns + x, (x * layers + z) * rows + y)
    along = np.where(axis == VIA_AXIS, gcell, along)
    key = np.sort((net * AXES + axis) * size + along)
    breaks = np.flatnonzero(np.diff(key) != 1)
    first = key[np.append(0, breaks + 1)[: len(key)]]
    length = key[np.append(breaks, len(key) - 1)[: len(key)]] - first + 1
    net, axis, along = first // size // AXES, first // size % AXES, first % size
    x = np.where(axis == 0, along % columns, along // layers // rows)
    y = np.where(axis == 0, along // columns // layers, along % rows)
    z = np.where(axis == 0, along // columns % layers, along // rows % layers)
    gcell = np.where(axis == VIA_AXIS, along, (x * rows + y) * layers + z)
    order = np.argsort((net * size + gcell) * AXES + axis)
    net, gcell, last = net[order], gcell[order], (gcell + length * problem.strides[axis])[order]
    return net, np.stack((gcell, last), axis=1)


def with_pins_at(problem: Problem, gcells: NDArray[np.int64]) -> Problem:
    """The problem with pins in other Gcells (pins,), one net after another, in their middle."""
    moved = np.flatnonzero(gcells != problem.gcell_of_pins)
    nets, pins = list(problem.nets), problem.net_of_pins
    first = np.searchsorted(pins, np.arange(len(nets)))
    points = _centres(problem, gcells[moved]).tolist()
    for net, pin, point in zip(pins[moved], moved - first[pins[moved]], points, strict=True):
        own = list(nets[net].pins)
        own[pin] = Pin(*point)
        nets[net] = replace(nets[net], pins=tuple(own))
    return replace(problem, nets=tuple(nets))


def _centres(problem: Problem, gcells: NDArray[np.int64]) -> NDArray[np.int64]:
    """The points in the middle of Gcells (…): an array (…, 3)."""
    points = np.stack(np.unravel_index(gcells, problem.grid), axis=-1).astype(np.int64)
    tile = np.array(problem.tile)
    points[..., :2] = np.array(problem.origin) + points[..., :2] * tile + tile // 2
    points[..., 2] += 1
    return points
