"""From a design's shapes, tracks and nets to a global routing problem."""

import math
import os
import tempfile
from array import array
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import files
from marouting.errors import InputError
from marouting.memory import NET, PIN, check_memory
from marouting.problem.chip import Chip, Places, as_adjustments
from marouting.problem.grid import MAX_GCELLS, gcells_of_boxes
from marouting.problem.ispd.problem_text import ProblemRecord
from marouting.problem.lefdef.def_text import Design, Tracks, read_def
from marouting.problem.lefdef.lef_text import Layer, Library, Rule, read_library
from marouting.problem.lefdef.shapes import Shapes, moved_pins, read_shapes
from marouting.problem.lefdef.statements import copying
from marouting.problem.lefdef.tracks import capacity_of_layer, places
from marouting.problem.net import MAX_NUMBER, Net, Pin

TRACKS_PER_GCELL = 15
"""The side of a Gcell in tracks, where neither a GCELLGRID nor a tile says another."""

LAYER_OF_GCELLS = 3
"""The layer, from 1, whose tracks these are (as in OpenROAD); of fewer layers the highest."""


def read_design(
    path: str | os.PathLike[str],
    lef: Sequence[str | os.PathLike[str]],
    tile: tuple[int, int] | None = None,
    pin_layer_wires: bool = False,
) -> ProblemRecord:
    """The fields of a problem from a DEF file and its LEF files, technology first.

    ``tile`` is the size of a Gcell in the DEF's units; None: as the DEF says, or 15 tracks.
    ``pin_layer_wires`` says whether a layer of pins (:func:`_is_pin_layer`) has capacity.
    """
    library = Library()
    with (
        files.naming(tempfile.gettempdir(), "cannot be written"),
        tempfile.TemporaryDirectory(prefix="marouting-") as folder,
    ):
        # klayout gets copies: its reader is stricter than others with blanks, takes names of files
        # as formulas and relative to one another, and reads statements that mean nothing here.
        copies = [Path(folder) / f"{number}.lef" for number in range(len(lef))]
        for file, name in zip(lef, copies, strict=True):
            with copying(name) as copy:
                read_library(file, library, copy)
        library.check()
        layers = library.layers
        if not layers:
            raise InputError(f"{', '.join(library.files)}: expected at least one routing layer")
        with copying(Path(folder) / "chip.def") as copy:
            design = read_def(path, library, copy)
        x, y = _lines(design, layers, tile)
        grid = (len(x) - 1, len(y) - 1, len(layers))
        if math.prod(grid) > MAX_GCELLS:
            raise InputError(
                f"{design.file}: expected at most {MAX_GCELLS} Gcells in all, "
                f"found {'x'.join(map(str, grid))}"
            )
        check_memory(NET * len(design.nets) + PIN * len(design.connections), "{}", design.file)
        shapes = read_shapes(Path(folder) / "chip.def", copies, design, library)
    capacity = np.zeros(grid, np.int64)
    for z, layer in enumerate(layers):
        boxes = shapes.all[shapes.all[:, 0] == z, 1:]
        capacity[..., z] = _capacity(design, layer, boxes, shapes.outside, x, y)
    axis = np.array([layer.axis for layer in layers])
    owner, pin_boxes = _located_pins(design, shapes)
    pins = _pin_gcells(design, owner, pin_boxes, x, y, len(layers))
    only_pins = not pin_layer_wires and bool(_is_pin_layer(design, pins.gcell[:, 2], axis))
    if only_pins:
        capacity[..., 0] = 0
    fields = as_adjustments(capacity, axis, np.ones(len(layers), np.bool_))
    origin = (int(x[0]), int(y[0]))
    side = (_usual(np.diff(x)), _usual(np.diff(y)))
    at = np.array(origin) + pins.gcell[:, :2] * np.array(side) + np.array(side) // 2
    located = [Pin(*row) for row in np.column_stack((at, pins.gcell[:, 2] + 1)).tolist()]
    bounds = design.first.tolist()
    scale = 1 / design.units
    rules = library.rules | {name: _scaled(rule, scale) for name, rule in design.rules.items()}
    chip = Chip(
        tuple(layer.name for layer in layers),
        x,
        y,
        np.stack((axis == 0, axis == 1), axis=1),
        pins.places,
        clock=np.array([name in design.clocks for name in design.nets]) if design.clocks else None,
        only_pins=only_pins,
    )
    widths = {name: _rule_tracks(design, layers, rule) for name, rule in rules.items()}
    where = {
        name: array("q", [design.die_line])
        for name in ("grid", "origin", "tile", "vertical_capacity", "horizontal_capacity")
    }
    return ProblemRecord(
        design.file,
        {
            **where,
            "nets": design.lines,
            "pins": np.repeat(np.array(design.lines), np.diff(bounds)).tolist(),
        },
        {
            "grid": grid,
            "origin": origin,
            "tile": side,
            "nets": tuple(
                Net(
                    name,
                    number,
                    tuple(located[bounds[number] : bounds[number + 1]]),
                    widths[design.rule_of[name]] if name in design.rule_of else 1,
                )
                for number, name in enumerate(design.nets)
            ),
            "min_width": (1,) * len(layers),
            "min_spacing": (0,) * len(layers),
            "via_spacing": (0,) * len(layers),
            "chip": chip,
            **fields._asdict(),
        },
    )


def _usual(sizes: NDArray[np.int64]) -> int:
    """The commonest of some sizes, and of equally common ones the least."""
    values, counts = np.unique(sizes, return_counts=True)
    return int(values[counts.argmax()])


def _lines(
    design: Design, layers: Sequence[Layer], tile: tuple[int, int] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The lines between Gcells along x and along y, with the borders of the die."""
    found = []
    for axis in (0, 1):
        low, high = design.box[axis], design.box[axis + 2]
        own = [line for line in design.gcells if line.axis == axis]
        if tile is None and own:
            inner = places(own, low, high, design.file)
        else:
            layer = layers[min(LAYER_OF_GCELLS, len(layers)) - 1]
            side = tile[axis] if tile else TRACKS_PER_GCELL * _step(design, layer)
            if not 1 <= side <= MAX_NUMBER:
                raise InputError(f"tile: expected sides from 1 to {MAX_NUMBER}, found {tile}")
            count = max(1, (high - low) // side)
            if count > MAX_GCELLS:
                raise InputError(f"tile: expected at most {MAX_GCELLS} Gcells, found {count}")
            inner = low + side * np.arange(1, count, dtype=np.int64)
        found.append(np.array([low, *inner.tolist(), high]))
    return found[0], found[1]


def _step(design: Design, layer: Layer) -> int:
    """The commonest distance between tracks of a layer, in the design's units.

    Several statements may give tracks in turn, each with a step of several tracks.
    """
    tracks, across = _tracks(design, layer), 1 - layer.axis
    at = places(tracks, design.box[across], design.box[across + 2], design.file)
    return _usual(np.diff(at)) if len(at) > 1 else min(own.step for own in tracks)


def _is_pin_layer(
    design: Design, layer: NDArray[np.int64], axis: NDArray[np.int64]
) -> np.bool_ | bool:
    """Whether the lowest layer has most pins of cells, and those above have wires both ways."""
    of_cells = np.array([component != "PIN" for component, _ in design.connections])
    return len(np.unique(axis[1:])) == 2 and 2 * (layer[of_cells] == 0).sum() > of_cells.sum()


def _scaled(rule: Rule, scale: float) -> Rule:
    """A rule in another unit."""
    return {
        layer: (width and width * scale, spacing and spacing * scale)
        for layer, (width, spacing) in rule.items()
    }


def _rule_tracks(design: Design, layers: Sequence[Layer], rule: Rule) -> tuple[int, ...]:
    """The tracks that a net takes in each layer by a nondefault rule: its width plus its spacing.

    Wires of usual width and spacing take one, however far apart tracks are.
    """
    tracks = []
    for layer in layers:
        width, spacing = rule.get(layer.name, (None, None))
        usual = _spacing(layer)
        pitch = max(layer.width + usual, _step(design, layer) / design.units)
        wide = (width or layer.width) + max(spacing or 0, usual)
        tracks.append(max(1, math.ceil(wide / pitch - 1e-6)))
    return tuple(tracks)


def _spacing(layer: Layer) -> float:
    """What wires of a layer keep from each other, in micrometres."""
    if layer.spacing is not None:
        return layer.spacing
    return max(0.0, layer.pitch[1 - layer.axis] - layer.width)


def _pitch(design: Design, layer: Layer, axis: int) -> int:
    """A layer's pitch in the design's units; raises InputError if it has none."""
    pitch = round(layer.pitch[axis] * design.units)
    if pitch < 1:
        raise InputError(f"{design.file}: expected TRACKS or a PITCH of layer {layer.name}")
    return pitch


def _tracks(design: Design, layer: Layer) -> list[Tracks]:
    """The tracks of a layer: those of the DEF, or by the layer's pitch."""
    across = 1 - layer.axis  # the axis along which tracks have their places
    low, high = design.box[across], design.box[across + 2]
    own = [
        t
        for t in design.tracks  # those that name no layer are of all layers
        if t.axis == across and (layer.name in t.layers or not t.layers)
    ]
    if own:
        return own
    pitch = _pitch(design, layer, across)
    offset = layer.offset[across] * design.units if layer.offset else pitch / 2
    first = low + round(offset) % pitch
    return [Tracks(across, first, (high - low) // pitch + 1, pitch, (), 1)]


def _capacity(
    design: Design,
    layer: Layer,
    boxes: NDArray[np.int64],
    outside: NDArray[np.int64],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
) -> NDArray[np.int64]:
    """(X, Y) the capacity of a layer's edges."""
    across = 1 - layer.axis
    tracks = places(_tracks(design, layer), design.box[across], design.box[across + 2], design.file)
    distance = round((layer.width + 2 * _spacing(layer)) * design.units)
    halo = np.repeat(np.array([distance, 0]), (len(boxes), len(outside)))
    left, lowest, right, highest = np.concatenate((boxes, outside)).T
    if layer.axis == 0:
        return capacity_of_layer(tracks, x, y, np.stack((left, right, lowest, highest), 1), halo)
    return capacity_of_layer(tracks, y, x, np.stack((lowest, highest, left, right), 1), halo).T


class _Pins(NamedTuple):
    gcell: NDArray[np.int64]  # (connections, 3) column, row, layer
    places: Places


def _located_pins(design: Design, shapes: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The boxes of all connections, as far as they are on the die.

    Nets with one pin that is nowhere on the die leave the design: there is nothing to route.
    """
    if not design.nets:
        raise InputError(f"{design.file}: expected at least one net with a pin")
    owner, boxes = _pin_boxes(design, shapes)
    left, low, right, high = design.box
    placed, on_die = owner, (boxes[:, 1] < right) & (boxes[:, 3] > left)
    on_die &= (boxes[:, 2] < high) & (boxes[:, 4] > low)
    owner, boxes = owner[on_die], boxes[on_die]
    boxes[:, 1:3] = np.maximum(boxes[:, 1:3], (left, low))
    boxes[:, 3:5] = np.minimum(boxes[:, 3:5], (right, high))
    for notch in shapes.outside:  # of a die that is no rectangle
        owner, boxes = _without(owner, boxes, notch)
    missing = np.setdiff1d(np.arange(len(design.connections)), owner)
    if not len(missing):
        return owner, boxes
    nets = np.searchsorted(design.first, missing, "right") - 1
    several = np.flatnonzero(np.diff(design.first)[nets] > 1)
    if len(several):
        net, connection = nets[several[0]], missing[several[0]]
        component, name = design.connections[connection]
        lacks = (
            "lies outside the die" if connection in placed else "has no shape in a routing layer"
        )
        raise InputError(
            f"{design.file}:{design.lines[net]}: net {design.nets[net]}: "
            f"pin {name} of {component} {lacks}"
        )
    design.leave_out(set(nets.tolist()))
    return _located_pins(design, shapes)


def _without(
    owner: NDArray[np.int64], boxes: NDArray[np.int64], notch: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Boxes without the part of them that lies in a notch (4,), as up to four boxes around it."""
    left, low, right, high = notch
    _, x0, y0, x1, y1 = boxes.T
    within = (x0 < right) & (x1 > left) & (y0 < high) & (y1 > low)
    parts = np.repeat(boxes[None], 4, axis=0)  # below it, above it, left of it, right of it
    parts[0, :, 4] = parts[2:, :, 2] = np.maximum(y0, low)
    parts[1, :, 2] = parts[2:, :, 4] = np.minimum(y1, high)
    parts[2, :, 3] = left
    parts[3, :, 1] = right
    part, index = np.nonzero(within & np.array([y0 < low, y1 > high, x0 < left, x1 > right]))
    owners = np.concatenate((owner[~within], owner[index]))
    return owners, np.concatenate((boxes[~within], parts[part, index]))


def _pin_gcells(
    design: Design,
    owner: NDArray[np.int64],
    boxes: NDArray[np.int64],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    layers: int,
) -> _Pins:
    """The Gcell of every connection, and all that the pin lies in; ``boxes`` as located."""
    first = [np.searchsorted(at, boxes[:, 1 + i], "right") - 1 for i, at in enumerate((x, y))]
    last = [np.searchsorted(at, boxes[:, 3 + i], "left") - 1 for i, at in enumerate((x, y))]
    first = [at.clip(0) for at in first]
    behind = [
        np.minimum(np.maximum(b, a), len(at) - 2) + 1
        for a, b, at in zip(first, last, (x, y), strict=True)
    ]
    index, column, row = gcells_of_boxes(first, behind, PIN, "pins in {} Gcells")
    sides = np.minimum(boxes[index, 3], x[column + 1]) - np.maximum(boxes[index, 1], x[column])
    area = sides * (np.minimum(boxes[index, 4], y[row + 1]) - np.maximum(boxes[index, 2], y[row]))
    rows = len(y) - 1
    size = (len(x) - 1) * rows * layers
    keys, same = np.unique(
        owner[index] * size + (column * rows + row) * layers + boxes[index, 0], return_inverse=True
    )
    total = np.zeros(len(keys), np.int64)
    np.add.at(total, same, area)
    pin, gcell = np.divmod(keys, size)
    connections = np.arange(len(design.connections))
    order = np.lexsort((gcell, -total, pin))  # of equal areas the lowest Gcell counts
    best = order[np.searchsorted(pin[order], connections)]
    position = np.stack((gcell // layers // rows, gcell // layers % rows, gcell % layers), axis=1)
    bounds = np.searchsorted(pin, np.arange(len(connections) + 1))
    return _Pins(position[best], Places(np.array(design.first), bounds, gcell))


def _pin_boxes(design: Design, shapes: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(boxes,) the connection that each box belongs to, and (boxes, 5) the boxes on the chip."""
    alike: dict[tuple[int, int, str], list[tuple[int, int, int]]] = defaultdict(list)
    for number, (component, pin) in enumerate(design.connections):
        if component == "PIN":
            alike[shapes.top, 0, pin].append((number, 0, 0))
        elif component in shapes.places:
            cell, turn, x, y = shapes.places[component]
            alike[cell, turn, pin].append((number, x, y))
    owners, boxes = [np.empty(0, np.int64)], [np.empty((0, 5), np.int64)]
    for (cell, turn, pin), rows in alike.items():
        table = np.array(rows)
        moved = moved_pins(shapes, cell, turn, pin, table[:, 1:])
        owners.append(np.repeat(table[:, 0], moved.shape[1]))
        boxes.append(moved.reshape(-1, 5))
    return np.concatenate(owners), np.concatenate(boxes)
