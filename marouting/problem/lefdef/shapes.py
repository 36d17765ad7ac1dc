"""Shapes of macros, pins, wires and blockages, read by klayout."""

import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import check_memory
from marouting.problem.lefdef.def_text import Design
from marouting.problem.lefdef.lef_text import Library

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
    """The shapes of a design, in its units."""

    pins: Mapping[int, Mapping[str, Boxes]]  # by cell and pin the boxes, from the cell's origin
    places: Mapping[str, Place]  # for each component its place
    top: int  # the number of the design's own cell
    all: Boxes  # every box on the chip that a wire has to keep away from
    outside: NDArray[np.int64]  # (n, 4) the sides of boxes in no layer, in which there is no chip


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
    design: Design,
    library: Library,
) -> Shapes:
    """Reads the shapes in the routing layers."""
    try:
        import klayout.db as db
    except ImportError:
        raise InputError(
            f"{design.file}: designs need more packages: pip install 'marouting[lefdef]'"
        ) from None
    options = db.LoadLayoutOptions()
    options.warn_level = 0
    config = options.lefdef_config
    # klayout takes names as relative to the DEF file's folder, and a $ in them for a formula.
    config.lef_files = [Path(file).name for file in lef]
    config.dbu = 1 / design.units
    config.read_lef_with_def = False
    config.skip_duplicate_macros = True
    config.macro_resolution_mode = 1  # the shapes of LEF, not those of a GDS file
    config.pin_property_name, config.instance_property_name = "pin", "instance"
    config.via_cellname_prefix = _VIA
    for number, kind in enumerate(_KINDS):
        setattr(config, f"{kind}_suffix", f".{kind}")
        # Kinds with one datatype would share a layer, whose name joins theirs.
        setattr(config, f"{kind}_datatype", number)
    for name in ("labels", "lef_labels", "cell_outlines", "regions", "placement_blockages"):
        setattr(config, f"produce_{name}", False)
    config.produce_fills = config.produce_routing = False
    config.produce_lef_pins = config.produce_obstructions = True
    row = {name: z for z, name in enumerate(library.routing)}
    layout = db.Layout()
    pins: dict[int, dict[str, Boxes]] = {}
    solid: dict[int, Boxes] = {}
    try:
        layout.read(os.fspath(path), options)
        top = layout.top_cell()
        known = []
        for index, info in zip(layout.layer_indexes(), layout.layer_infos(), strict=True):
            name, _, kind = info.name.rpartition(".")
            if name in row and kind in _KINDS:
                known.append((index, row[name], kind in ("lef_pins", "pins")))
            elif name not in library.others or kind not in _KINDS:
                cells = [c.name for c in layout.each_cell() if not c.shapes(index).is_empty()]
                of_lef = kind in ("lef_pins", "obstructions")
                file = library.layers_at.get(name, design.file) if of_lef else design.file
                raise InputError(
                    f"{file}: layer {name or info} of {_KINDS.get(kind, 'a shape')}, "
                    f"in {cells[0] if cells else top.name}: expected a layer of the LEF files"
                )
        for index in layout.each_cell_bottom_up():
            pins[index], own = _boxes_of(db, layout.cell(index), known)
            solid[index] = _with_instances(layout.cell(index), own, solid)
    except RuntimeError as error:  # klayout's only one
        raise InputError(_located(str(error), path, lef, design, library)) from None
    placed_vias = [(top, *via) for via in design.pin_vias]
    for macro, pin, via, x, y in library.pin_vias:
        if (cell := layout.cell(macro)) is not None:  # the design has such a component
            at = (round(x * design.units), round(y * design.units))
            placed_vias.append((cell, pin, via, 0, *at))
    for cell, pin, via, turn, x, y in placed_vias:
        boxes = turned(solid[layout.cell(f"{_VIA}{via}").cell_index()], turn)
        of_pin = pins[cell.cell_index()].get(pin, NO_BOXES)
        moved = _moved(boxes, np.array([[x, y]]))[0]
        pins[cell.cell_index()][pin] = np.concatenate((of_pin, moved))
    places: dict[str, Place] = {}
    for instance in top.each_inst():
        if (name := instance.property("instance")) is not None:
            trans = instance.trans
            places[str(name)] = Place(
                int(instance.cell_index), trans.rot, trans.disp.x, trans.disp.y
            )
    index = top.cell_index()
    return Shapes(pins, places, index, solid[index], _outside(db, design))


def _with_instances(cell: Any, own: Boxes, solid: Mapping[int, Boxes]) -> Boxes:
    """A cell's own boxes and those of the cells placed in it, whose boxes are known."""
    alike: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for instance in cell.each_inst():
        at, number, turn = instance.trans.disp, int(instance.cell_index), instance.trans.rot
        alike[number, turn] += [
            (at.x + instance.a.x * i + instance.b.x * j, at.y + instance.a.y * i + instance.b.y * j)
            for i in range(max(1, instance.na))
            for j in range(max(1, instance.nb))
        ]
    count = sum(len(solid[number]) * len(moves) for (number, _), moves in alike.items())
    check_memory(_BOX * count, "{} shapes", count)
    parts = [own]
    for (number, turn), moves in alike.items():
        parts.append(_moved(turned(solid[number], turn), np.array(moves)).reshape(-1, 5))
    return np.concatenate(parts)


_KINDS = {
    "lef_pins": "a macro's pin",
    "pins": "a pin",
    "obstructions": "a macro's obstruction",
    "blockages": "a blockage",
    "special_routing": "a special net",
    "via_geometry": "a via",
}
"""klayout's kinds of shapes and what they are; klayout's name of a layer ends with ``.kind``."""

_VIA = "via "  # how klayout's cells of vias begin; no macro's name has a blank


def _located(
    message: str,
    path: str | os.PathLike[str],
    lef: Sequence[str | os.PathLike[str]],
    design: Design,
    library: Library,
) -> str:
    """Klayout's message about a copy as one about the file, in whose lines the copy is."""
    names = {Path(path).name: design.file}
    names |= {Path(copy).name: file for copy, file in zip(lef, library.files, strict=True)}
    match = re.fullmatch(r"(.*) \(line=([0-9]+), cell=.*, file=(.*?)\).*", message, re.DOTALL)
    if match is None or (file := names.get(Path(match[3]).name)) is None:
        return f"{design.file}: klayout: {message}"
    return f"{file}:{match[2]}: klayout: {match[1]}"


def _outside(db: Any, design: Design) -> NDArray[np.int64]:
    """(n, 4) boxes that cover what is not die of the box around the die."""
    corners = db.Region(db.Polygon([db.Point(x, y) for x, y in design.die]))
    outside = db.Region(db.Box(*design.box)) - corners
    boxes = [part.bbox() for part in outside.decompose_trapezoids_to_region().each()]
    sides = [(box.left, box.bottom, box.right, box.top) for box in boxes]
    return np.array(sides, np.int64).reshape(-1, 4)


_BOX = 160  # bytes for each box while the places of all are found


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
