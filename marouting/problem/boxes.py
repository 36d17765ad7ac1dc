"""Routes as boxes of a chip's layers, which is how routing guides give them, and back."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.memory import USED
from marouting.problem.chip import Chip, Places
from marouting.problem.grid import AXES, VIA_AXIS, distinct, gcells_of_boxes, is_among, neighbours
from marouting.problem.net import FieldError
from marouting.problem.parts import joined_parts, lowest, mark_joins
from marouting.problem.problem import Problem
from marouting.problem.reached import pins_among
from marouting.problem.segments import longest_runs


class Boxes(NamedTuple):
    """Boxes that nets' routes cover."""

    net: NDArray[np.int64]  # (n,) int64, the index of each box's net, ascending
    box: NDArray[np.int64]  # (n, 4) int64, lower left and upper right corner in chip coordinates
    layer: NDArray[np.int64]  # (n,) int64, from 0


def edges_in_boxes(
    problem: Problem, boxes: Boxes
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The edges between Gcells that a net's boxes touch, and where they reach pins.

    A guide is only a region. Two Gcells of it that lie above each other are connected, and
    two neighbours of one box if the edge between them has capacity. Guides also count on neighbours
    in different boxes, and on short wires where there are no tracks. Where the pins of a net are
    joined in no other way, these join parts, no more than are needed: first neighbours in different
    boxes, then wires without tracks along their layer's direction, in one box and then between
    boxes, and at last wires across it.

    Returns:
        (k,) net and edge of each, ascending, and (pins,) the Gcell by which each pin is reached
        (:func:`marouting.problem.reached.pins_among`), before any of these joins.

    Raises:
        FieldError: a box is empty or lies off the chip; ``row`` tells which. Of a box that reaches
            off the chip, as GCELLGRIDs do that are wider than the die, the part on it counts.
        InputError: the Gcells would take too much memory.
    """
    chip = problem.chip_or_default
    net, box, layer = boxes
    box = chip.on_chip(box)
    wrong = (box[:, :2] >= box[:, 2:]).any(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        raise FieldError(
            f"expected a box on the chip, from {(int(chip.x[0]), int(chip.y[0]))} to "
            f"{(int(chip.x[-1]), int(chip.y[-1]))}, found {tuple(boxes.box[row].tolist())}",
            "segments",
            row,
        )
    index, x, y, behind = gcells_touched(chip, box)
    _, rows, layers = problem.grid
    size = int(np.prod(problem.grid))
    keys = net[index] * size + (x * rows + y) * layers + layer[index]
    covered = distinct(keys)
    inside = (
        x + 1 < behind[0][index],
        y + 1 < behind[1][index],
    )  # the next Gcell is of the same box
    ends, axes, costs = [], [], []
    for axis in range(AXES):
        at, other = neighbours(problem.grid, covered, axis)
        ends.append(np.stack((at, other)))
        axes.append(np.full(len(at), axis))
        cost = np.zeros(len(at), np.int64)
        if axis != VIA_AXIS:
            in_box = is_among(covered[at], distinct(keys[inside[axis]]))
            gcell = covered[at] % size
            usable = problem.capacity_of(AXES * gcell + axis) > 0
            along = chip.wires[gcell % problem.grid[2], axis]
            cost = np.where(usable, 1 - in_box, np.where(along, 3 - in_box, 4))
        costs.append(cost)
    near, far = np.concatenate(ends, axis=1)
    needed = np.concatenate(costs)
    kept = needed == 0
    part = joined_parts(near[kept], far[kept], len(covered))
    pins = pins_among(problem, covered, part)
    reached = problem.net_of_pins * size + pins
    for level in range(1, 5):
        is_open = _are_open(problem, covered, part, reached)
        apart = (needed == level) & (part[near] != part[far]) & is_open[covered[near] // size]
        mark_joins(near, far, np.flatnonzero(apart), part, kept)
        part = lowest(part)
    net, edge = np.divmod(
        np.sort(AXES * covered[near[kept]] + np.concatenate(axes)[kept]), AXES * size
    )
    return net, edge, pins


def gcells_touched(
    chip: Chip, box: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], list[NDArray[np.int64]]]:
    """The Gcells that boxes touch in their layers.

    Args:
        chip: with the lines between Gcells.
        box: (n, 4) boxes on the chip, none of them empty, in chip coordinates.

    Returns:
        (k,) three times: of each Gcell the box, the column and the row; and two arrays (n,), the
        column and the row behind each box.

    Raises:
        InputError: the Gcells would take too much memory.
    """
    lines = (chip.x, chip.y)
    first = [np.searchsorted(at, box[:, i], "right") - 1 for i, at in enumerate(lines)]
    behind = [np.searchsorted(at, box[:, i + 2], "left") for i, at in enumerate(lines)]
    return *gcells_of_boxes(first, behind, USED, "boxes of {} Gcells"), behind


def _are_open(
    problem: Problem,
    covered: NDArray[np.int64],
    part: NDArray[np.int64],
    reached: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """(nets,) whether a net's pins, nets · G + Gcell, are not all in one part of ``covered``."""
    there = is_among(reached, covered)
    at = np.where(there, part[np.searchsorted(covered, reached) * there], -1)
    net = problem.net_of_pins
    apart = (net[1:] == net[:-1]) & ((at[1:] != at[:-1]) | ~there[1:])
    found = np.zeros(len(problem.nets), np.bool_)
    found[net[1:][apart]] = True
    return found


def boxes_of(
    problem: Problem,
    net: NDArray[np.int64],
    edge: NDArray[np.int64],
    more: Sequence[tuple[NDArray[np.int64], NDArray[np.int64]]] = (),
) -> Boxes:
    """Boxes that cover routes, edges (k,) of nets (k,), and pins, connected where the routes are.

    Every longest straight segment is a box. Every via lies in a box of both layers. Every pin's
    Gcell is covered in its own layer and in the next higher one, so that the pin can be left by a
    via, and so is what the pin touches of Gcells beside it. ``more`` has net and Gcell, (n,) twice,
    of what is covered beyond that.
    """
    chip: Chip = problem.chip_or_default
    size, layers = int(np.prod(problem.grid)), problem.grid[2]
    wire = edge % AXES != VIA_AXIS
    run_net, ends = longest_runs(problem, net[wire], edge[wire])
    near = edge // AXES
    far = near + problem.strides[edge % AXES]
    in_wires = np.concatenate((net, net))[np.tile(wire, 2)] * size
    in_wires += np.concatenate((near[wire], far[wire]))
    first, pins = problem.flat_pin_gcells
    pin_net = np.repeat(np.arange(len(problem.nets)), np.diff(first))
    if chip.places is not None:
        beside_net, beside = _beside_pins(problem, chip.places)
        pin_net, pins = np.concatenate((pin_net, beside_net)), np.concatenate((pins, beside))
    below_top = pins % layers + 1 < layers
    beyond = [np.concatenate(own) for own in zip(*more, strict=True)] if more else [pins[:0]] * 2
    single_net = np.concatenate((net[~wire], net[~wire], pin_net, pin_net[below_top], beyond[0]))
    single = np.concatenate((near[~wire], far[~wire], pins, pins[below_top] + 1, beyond[1]))
    alone = distinct(single_net * size + single)
    alone = alone[~is_among(alone, distinct(in_wires))]
    box_net = np.concatenate((run_net, alone // size))
    corners = np.concatenate((ends, np.repeat((alone % size)[:, None], 2, axis=1)))
    x, y, z = np.unravel_index(corners, problem.grid)
    box = np.stack(
        (chip.x[x[:, 0]], chip.y[y[:, 0]], chip.x[x[:, 1] + 1], chip.y[y[:, 1] + 1]), axis=1
    )
    order = np.lexsort((y[:, 0], x[:, 0], z[:, 0], box_net))
    return Boxes(box_net[order], box[order], z[order, 0])


def _beside_pins(problem: Problem, places: Places) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(k,) twice: net and Gcell of a pin's places next to the one that the problem has it in."""
    pin = np.repeat(np.arange(len(places.first) - 1), np.diff(places.first))
    net = np.repeat(np.arange(len(problem.nets)), np.diff(places.first_pin))[pin]
    position = np.stack(np.unravel_index(places.gcell, problem.grid), axis=1)
    own = np.stack(np.unravel_index(problem.gcell_of_pins, problem.grid), axis=1)[pin]
    distance = np.abs(position - own)
    beside = (distance[:, VIA_AXIS] == 0) & (distance.sum(axis=1) == 1)
    return net[beside], places.gcell[beside]
