"""Routing guides for detailed routers: a check of them, and patches that give more room.

The rules are those by which the routers of the ISPD 2018 and 2019 contests read guides (Kahng, Wang
and Xu, "TritonRoute: an initial detailed router for advanced VLSI technologies", ICCAD 2018).
"""

import os
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from marouting.problem import ispd
from marouting.problem.boxes import gcells_touched
from marouting.problem.grid import AXES, VIA_AXIS, distinct, is_among, neighbours
from marouting.problem.parts import joined_parts
from marouting.problem.problem import Problem

CROWDED = 0.9
"""From which share of an edge's capacity on patched guides give its nets more room."""


@dataclass(frozen=True)
class GuideCheck:
    """What is wrong with a guide, by the contests' rules.

    Attributes:
        boxes: how many boxes it has.
        off_grid: boxes whose sides are not all on lines between Gcells.
        open_pins: pins, of nets with several, in none of whose Gcells and layers a box lies.
        split_nets: nets whose boxes are in several parts. Boxes are joined if they touch along a
            side or overlap in one layer, or overlap in two layers above each other.
    """

    boxes: int
    off_grid: int
    open_pins: int
    split_nets: int


Record = ispd.SolutionRecord | ispd.RoutesRecord
"""A file of routes, as it was read."""


def read_record(path: str | os.PathLike[str], problem: Problem) -> Record:
    """Reads a file of routes of a problem, and of nets that it keeps, in any format.

    Raises:
        InputError: the file cannot be read or is of none of the formats.
    """
    problem = problem if problem.kept is None else problem.kept.whole
    nets = ((net.name, net.id) for net in problem.nets)
    return ispd.read_solution(path, nets, problem.chip_or_default.layers)


def check_guide(record: Record, problem: Problem) -> GuideCheck | None:
    """Checks a guide.

    Pins and boxes are compared by the Gcells that they touch, which is exact if no box is off the
    grid.

    Args:
        record: what :func:`read_record` read.
        problem: what it is a guide for.

    Returns:
        What is wrong with it; None if the file holds routes and no boxes.

    Raises:
        InputError: the boxes would take too much memory.
    """
    problem = problem if problem.kept is None else problem.kept.whole
    chip = problem.chip_or_default
    if not has_boxes(record):
        return None
    box, lines = chip.on_chip(record.boxes[:, :4]), (chip.x, chip.y)
    there = (box[:, :2] < box[:, 2:]).all(axis=1)
    on_grid = np.all([is_among(box[there, i], lines[i % 2]) for i in range(4)], axis=0)
    covered, size = gcells_in_boxes(record, problem), int(np.prod(problem.grid))
    near, far = np.concatenate(
        [np.stack(neighbours(problem.grid, covered, axis)) for axis in range(AXES)], axis=1
    )
    parts = distinct(joined_parts(near, far, len(covered)))
    parts_of_net = np.bincount(covered[parts] // size, minlength=len(problem.nets))
    return GuideCheck(
        boxes=len(record.boxes),
        off_grid=len(record.boxes) - int(np.count_nonzero(on_grid)),
        open_pins=_open_pins(problem, covered),
        split_nets=int(np.count_nonzero(parts_of_net > 1)),
    )


def has_boxes(record: Record) -> TypeGuard[ispd.RoutesRecord]:
    """Whether a file of routes is a guide: whether it holds boxes."""
    return not isinstance(record, ispd.SolutionRecord) and len(record.boxes) > 0


def gcells_in_boxes(record: ispd.RoutesRecord, problem: Problem) -> NDArray[np.int64]:
    """(k,) int64, the Gcells that a guide's boxes touch, as net · G + Gcell, ascending.

    Raises:
        InputError: they would take too much memory.
    """
    chip = problem.chip_or_default
    box = chip.on_chip(record.boxes[:, :4])
    there = (box[:, :2] < box[:, 2:]).all(axis=1)
    net, layer = record.net[there], record.boxes[there, 4]
    index, x, y, _ = gcells_touched(chip, box[there])
    gcell = np.stack((x, y, layer[index]), axis=1) @ problem.strides
    return distinct(net[index] * int(np.prod(problem.grid)) + gcell)


def _open_pins(problem: Problem, covered: NDArray[np.int64]) -> int:
    """How many pins have no shape in ``covered``, nets · G + Gcell, ascending."""
    size = int(np.prod(problem.grid))
    pins = np.array([len(net.pins) for net in problem.nets])
    owner = np.repeat(np.arange(len(pins)), pins)
    place, gcell = np.arange(len(owner)), problem.gcell_of_pins
    if problem.chip is not None and problem.chip.places is not None:
        places = problem.chip.places
        place, gcell = np.repeat(place, np.diff(places.first)), places.gcell
    touched = is_among(owner[place] * size + gcell, covered)
    reached = np.zeros(len(owner), np.bool_)
    reached[place[touched]] = True
    return int(np.count_nonzero(~reached & (pins[owner] > 1)))


def patches(
    problem: Problem,
    uses: tuple[NDArray[np.int64], NDArray[np.int64]],
    demand: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Gcells beyond routes and pins that give a detailed router more room.

    Around every pin they are the Gcells of the eight neighbouring columns, in the pin's layer and
    in the next two. Where an edge is crowded, they are its Gcells in the layers above and below
    that have wires.

    Args:
        problem: what is routed.
        uses: net and edge of every use of an edge by a net.
        demand: edges in use, ascending, and the tracks taken of each.

    Returns:
        (k,) twice: net and Gcell, perhaps several times.
    """
    first, pins = problem.flat_pin_gcells
    owner = np.repeat(np.arange(len(problem.nets)), np.diff(first))
    several = np.diff(first)[owner] > 1
    owner, at = owner[several], np.stack(np.unravel_index(pins[several], problem.grid), axis=1)
    found = [
        (owner, at + np.array([dx, dy, dz]))
        for dx in (-1, 0, 1)
        for dy in (-1, 0, 1)
        for dz in (0, 1, 2)
    ]
    net, edge = uses
    used, tracks = demand
    crowded = used[(tracks > 0) & (tracks >= CROWDED * problem.capacity_of(used))]
    concerned = (edge % AXES != VIA_AXIS) & is_among(edge, crowded)
    near = edge[concerned] // AXES
    wired = np.max(problem.wired, axis=1)
    for gcell in (near, near + problem.strides[edge[concerned] % AXES]):
        position = np.stack(np.unravel_index(gcell, problem.grid), axis=1)
        for step in (-1, 1):
            layer = position[:, 2] + step
            there = (layer >= 0) & (layer < problem.grid[2])
            there[there] = wired[layer[there]]
            found.append((net[concerned][there], position[there] + np.array([0, 0, step])))
    nets = np.concatenate([own for own, _ in found])
    cells = np.concatenate([cell for _, cell in found])
    inside = ((cells >= 0) & (cells < np.array(problem.grid))).all(axis=1)
    return nets[inside], cells[inside] @ problem.strides
