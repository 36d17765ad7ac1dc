"""Shapes of macros, pins, wires and blockages, read by klayout."""

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import check_memory

Boxes = NDArray[np.int64]
"""(n, 5) rows of a layer, from 0, and a box's left, lower, right and upper side."""

NO_BOXES: Boxes = np.empty((0, 5), np.int64)


class Place(NamedTuple):
    """Where a macro stands: its cell, how it is turned, and by how much it is moved."""

    cell: int
    turn: int
    x: int
    y: int


class Shapes(NamedTuple):
    """The shapes of a design, in its units.

    Attributes:
        pins: for each cell and each of its pins the boxes, where the cell's origin is at 0, 0.
            Those of the design's own pins are where they are in the design.
        places: for each component its place.
        top: the number of the design's own cell.
        all: every box on the chip that a wire has to avoid.
    """

    pins: Mapping[int, Mapping[str, Boxes]]
    places: Mapping[str, Place]
    top: int
    all: Boxes


def turned(boxes: Boxes, turn: int) -> Boxes:
    """Boxes after a turn by ``turn % 4`` quarters, anticlockwise, of the plane.

    From 4 on the plane is mirrored first, at the x axis.
    """
    layer, left, low, right, high = boxes.T
    if turn >= 4:
        low, high = -high, -low
    for _ in range(turn % 4):
        left, low, right, high = -high, left, -low, right
    return np.stack((layer, left, low, right, high), axis=1)


def read_shapes(
    path: str | os.PathLike[str],
    lef: Sequence[str | os.PathLike[str]],
    units: int,
    layers: Sequence[str],
) -> Shapes:
    """Reads the shapes in the routing layers.

    Args:
        path: the DEF file.
        lef: the LEF files.
        units: how many make a micrometre.
        layers: the names of the routing layers, lowest first.

    Raises:
        InputError: klayout is not installed or cannot read a file.
    """
    try:
        import klayout.db as db
    except ImportError:
        raise InputError(
            f"{os.fspath(path)}: designs need more packages: pip install 'marouting[lefdef]'"
        ) from None
    options = db.LoadLayoutOptions()
    options.warn_level = 0
    config = options.lefdef_config
    config.lef_files = [os.fspath(file) for file in lef]
    config.dbu = 1 / units
    config.read_lef_with_def = False
    config.macro_resolution_mode = 1  # the shapes of LEF, not those of a GDS file
    config.pin_property_name, config.instance_property_name = "pin", "instance"
    suffixes = {
        "lef_pins_suffix": ".LEFPIN",
        "pins_suffix": ".PIN",
        "obstructions_suffix": ".OBS",
        "blockages_suffix": ".BLK",
        "special_routing_suffix": ".NET",
        "via_geometry_suffix": ".VIA",
    }
    for name, suffix in suffixes.items():
        setattr(config, name, suffix)
    for name in ("labels", "lef_labels", "cell_outlines", "regions", "placement_blockages"):
        setattr(config, f"produce_{name}", False)
    config.produce_fills = config.produce_routing = False
    config.produce_lef_pins = config.produce_obstructions = True
    kinds = {
        f"{name}{suffix}": (z, suffix in (".LEFPIN", ".PIN"))
        for z, name in enumerate(layers)
        for suffix in suffixes.values()
    }
    layout = db.Layout()
    pins: dict[int, dict[str, Boxes]] = {}
    solid: dict[int, Boxes] = {}
    try:
        layout.read(os.fspath(path), options)
        top = layout.top_cell()
        known = [
            (index, *kinds[info.name])
            for index, info in zip(layout.layer_indexes(), layout.layer_infos(), strict=True)
            if info.name in kinds
        ]
        for cell in layout.each_cell():
            pins[cell.cell_index()], solid[cell.cell_index()] = _boxes_of(db, cell, known)
    except RuntimeError as error:  # klayout's only one; it names the file and the line
        raise InputError(f"{os.fspath(path)}: klayout: {error}") from None
    places: dict[str, Place] = {}
    alike: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for instance in top.each_inst():
        at, number, turn = instance.trans.disp, int(instance.cell_index), instance.trans.rot
        alike[number, turn] += [
            (at.x + instance.a.x * i + instance.b.x * j, at.y + instance.a.y * i + instance.b.y * j)
            for i in range(max(1, instance.na))
            for j in range(max(1, instance.nb))
        ]
        if (name := instance.property("instance")) is not None:
            places[str(name)] = Place(number, turn, at.x, at.y)
    parts = [solid[top.cell_index()]]
    count = sum(len(solid[number]) * len(moves) for (number, _), moves in alike.items())
    check_memory(_BOX * count, "{} shapes", count)
    for (number, turn), moves in alike.items():
        parts.append(_moved(turned(solid[number], turn), np.array(moves)).reshape(-1, 5))
    return Shapes(pins, places, top.cell_index(), np.concatenate(parts))


_BOX = 160
"""Bytes for each box while the places of all are found."""


def moved_pins(shapes: Shapes, cell: int, turn: int, pin: str, moves: NDArray[np.int64]) -> Boxes:
    """(places, boxes, 5) a macro's pin at several places, which are turned alike."""
    return _moved(turned(shapes.pins[cell].get(pin, NO_BOXES), turn), moves)


def _moved(boxes: Boxes, moves: NDArray[np.int64]) -> Boxes:
    """(moves, n, 5) boxes at each of the places (moves, 2)."""
    shift = np.concatenate((np.zeros((len(moves), 1), np.int64), moves, moves), axis=1)
    return boxes[None] + shift[:, None]


def _boxes_of(
    db: Any, cell: Any, known: Sequence[tuple[int, int, bool]]
) -> tuple[dict[str, Boxes], Boxes]:
    """The boxes of a cell's own shapes: those of each pin, and all."""
    pins: dict[str, list[tuple[int, ...]]] = defaultdict(list)
    solid: list[tuple[int, ...]] = []
    for index, z, is_pin in known:
        for shape in cell.shapes(index).each():
            if shape.is_box():
                boxes = [shape.box]
            elif shape.is_polygon() or shape.is_path():
                parts = db.Region(shape.polygon).decompose_trapezoids_to_region()
                boxes = [part.bbox() for part in parts.each()]
            else:
                continue
            rows = [(z, box.left, box.bottom, box.right, box.top) for box in boxes]
            solid += rows
            if is_pin and (name := shape.property("pin")) is not None:
                pins[str(name)] += rows
    tables = {name: np.array(rows, np.int64).reshape(-1, 5) for name, rows in pins.items()}
    return tables, np.array(solid, np.int64).reshape(-1, 5)
