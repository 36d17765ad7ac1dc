"""Capacities and pins of random designs against a plain rasteriser that knows no LEF or DEF."""

from pathlib import Path

import numpy as np
import pytest

from marouting import Problem

pytest.importorskip("klayout.db")

UNITS = 10
LAYERS = {"M1": (0, 2, 2), "M2": (1, 2, 3), "M3": (0, 4, 2)}  # axis, width, spacing
ORIENTS = ("N", "W", "S", "E", "FN", "FS", "FW", "FE")

Box = tuple[int, int, int, int]


def microns(number: int) -> str:
    return f"{number / UNITS:.1f}"


def placed(box: Box, side: tuple[int, int], orient: str, at: tuple[int, int]) -> Box:
    """A box of a macro of a size whose lower left corner, once it is turned, is at a place."""
    (x0, y0, x1, y1), (w, h) = box, side
    if orient.startswith("F"):  # mirrored left to right, then turned
        x0, x1 = w - x1, w - x0
        orient = {"FN": "N", "FS": "S", "FW": "E", "FE": "W"}[orient]
    if orient == "W":  # a quarter to the left
        x0, y0, x1, y1 = h - y1, x0, h - y0, x1
    elif orient == "S":
        x0, y0, x1, y1 = w - x1, h - y1, w - x0, h - y0
    elif orient == "E":
        x0, y0, x1, y1 = y0, w - x1, y1, w - x0
    return x0 + at[0], y0 + at[1], x1 + at[0], y1 + at[1]


class Design:
    """A random design: its texts, and by layer the boxes in them."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.side = (self.number(80, 160), self.number(80, 160))
        self.solid: dict[str, list[Box]] = {name: [] for name in LAYERS}
        self.pins: dict[str, list[tuple[str, Box]]] = {}
        self.lines: dict[str, list[str]] = {
            name: [] for name in ("VIAS", "COMPONENTS", "PINS", "BLOCKAGES", "SPECIALNETS", "NETS")
        }
        self.lef = ["UNITS DATABASE MICRONS 10 ; END UNITS"]
        for name, (axis, width, spacing) in LAYERS.items():
            self.lef.append(
                f"LAYER {name} TYPE ROUTING ; DIRECTION {('HORIZONTAL', 'VERTICAL')[axis]} ; "
                f"PITCH {microns(width + spacing)} ; WIDTH {microns(width)} ; "
                f"SPACING {microns(spacing)} ; END {name}\nLAYER V{name} TYPE CUT ; END V{name}"
            )
        self.vias: dict[str, dict[str, Box]] = {}
        self.add_vias()
        self.add_macros()
        self.add_pins()
        self.add_power()
        self.add_blockages()

    def number(self, low: int, high: int) -> int:
        return int(self.rng.integers(low, high))

    def layer(self) -> str:
        return str(self.rng.choice(list(LAYERS)))

    def box(self, width: int, height: int, largest: int = 12) -> Box:
        w, h = self.number(1, largest), self.number(1, largest)
        x, y = self.number(0, max(1, width - w)), self.number(0, max(1, height - h))
        return x, y, x + w, y + h

    def add_vias(self) -> None:
        for number, (low, high) in enumerate((("M1", "M2"), ("M2", "M3"), ("M1", "M2"))):
            a, b = (self.number(1, 6) for _ in range(2))
            shapes = {low: (-a, -b, a, b), f"V{low}": (-1, -1, 1, 1), high: (-b, -a, b, a)}
            self.vias[f"via{number}"] = shapes
            if number == 2:
                text = "".join(
                    f" LAYER {layer} ; RECT {' '.join(map(microns, box))} ;"
                    for layer, box in shapes.items()
                )
                self.lef.append(f"VIA via{number} DEFAULT{text} END via{number}")
            else:
                text = "".join(
                    f" + RECT {layer} ( {box[0]} {box[1]} ) ( {box[2]} {box[3]} )"
                    for layer, box in shapes.items()
                )
                self.lines["VIAS"].append(f"via{number}{text}")

    def via_at(self, via: str, x: int, y: int) -> list[tuple[str, Box]]:
        return [
            (layer, (box[0] + x, box[1] + y, box[2] + x, box[3] + y))
            for layer, box in self.vias[via].items()
            if layer in LAYERS
        ]

    def add(self, layer: str, box: Box) -> None:
        if layer in LAYERS:
            self.solid[layer].append(box)

    def add_macros(self) -> None:
        for macro in ("A", "B"):
            side = (self.number(14, 30), self.number(14, 30))
            pins = [(self.layer(), self.box(*side, 6)) for _ in range(self.number(1, 4))]
            walls = [(self.layer(), self.box(*side)) for _ in range(self.number(0, 3))]

            def rect(shape: tuple[str, Box]) -> str:
                return f"LAYER {shape[0]} ; RECT {' '.join(map(microns, shape[1]))} ;"

            text = "".join(
                f"PIN P{i} PORT {rect(pin)} END END P{i}\n" for i, pin in enumerate(pins)
            )
            self.lef.append(
                f"MACRO {macro} SIZE {microns(side[0])} BY {microns(side[1])} ;\n{text}"
                f"OBS {' '.join(map(rect, walls))} END\nEND {macro}"
            )
            for number in range(self.number(1, 4)):
                name, orient = f"{macro}{number}", str(self.rng.choice(ORIENTS))
                at = (self.number(0, self.side[0] - 30), self.number(0, self.side[1] - 30))
                self.lines["COMPONENTS"].append(
                    f"{name} {macro} + FIXED ( {at[0]} {at[1]} ) {orient}"
                )
                for i, (layer, box) in enumerate(pins):
                    on_chip = placed(box, side, orient, at)
                    self.pins[f"{name} P{i}"] = [(layer, on_chip)]
                    self.add(layer, on_chip)
                for layer, box in walls:
                    self.add(layer, placed(box, side, orient, at))

    def add_pins(self) -> None:
        """Pins of the design itself with one shape or port, or more, of layers and vias."""
        for number in range(self.number(1, 5)):
            ports, shapes = [], []
            several = bool(self.rng.random() < 0.3)
            for _ in range(1 + several):
                layer, box = self.layer(), self.box(20, 20, 8)
                x, y = self.number(30, self.side[0] - 30), self.number(30, self.side[1] - 30)
                orient = str(self.rng.choice(ORIENTS))
                text = f" + LAYER {layer} ( {box[0]} {box[1]} ) ( {box[2]} {box[3]} )"
                found = [(layer, box)]
                if self.rng.random() < 0.4:
                    via = str(self.rng.choice(list(self.vias)))
                    alone = self.rng.random() < 0.5
                    text = f"{'' if alone else text} + VIA {via} ( 3 4 )"
                    found = found * (not alone) + self.via_at(via, 3, 4)
                ports.append(f"{' + PORT' * several}{text} + PLACED ( {x} {y} ) {orient}")
                shapes += [(name, placed(box, (0, 0), orient, (x, y))) for name, box in found]
            self.lines["PINS"].append(f"io{number} + NET n + DIRECTION INPUT{''.join(ports)}")
            self.pins[f"PIN io{number}"] = shapes
            for layer, box in shapes:
                self.add(layer, box)

    def add_power(self) -> None:
        """A grid of stripes with vias where they cross, as the largest nets of chips are."""
        wires = []
        for _ in range(self.number(2, 7)):
            layer, via = self.layer(), str(self.rng.choice(list(self.vias)))
            half = self.number(1, 5)
            along = self.number(0, 2)  # also against the layer's direction
            at, low = self.number(0, self.side[1 - along]), self.number(0, self.side[along] // 2)
            high = self.number(low + 1, self.side[along])
            ends = ((low, at), (high, at)) if along == 0 else ((at, low), (at, high))
            wires.append(
                f"{layer} {2 * half} + SHAPE STRIPE "
                f"( {ends[0][0]} {ends[0][1]} ) ( {ends[1][0]} {ends[1][1]} )"
            )
            (x0, y0), (x1, y1) = ends
            self.add(
                layer,
                (x0, y0 - half, x1, y1 + half) if along == 0 else (x0 - half, y0, x1 + half, y1),
            )
            times, step = self.number(1, 4), self.number(5, 20)
            array = f" DO {times} BY 1 STEP {step} 0" if times > 1 else ""
            wires.append(f"M1 0 + SHAPE STRIPE ( {x0} {y0} ) {via}{array}")
            for k in range(times):
                for name, box in self.via_at(via, x0 + k * step, y0):
                    self.add(name, box)
        layer, box = self.layer(), self.box(*self.side)
        rect = f"+ RECT {layer} ( {box[0]} {box[1]} ) ( {box[2]} {box[3]} )"
        self.add(layer, box)
        self.lines["SPECIALNETS"].append(f"VDD ( * VDD ) {rect} + ROUTED {' NEW '.join(wires)}")

    def add_blockages(self) -> None:
        for _ in range(self.number(1, 4)):
            layer, box = self.layer(), self.box(*self.side, 20)
            kind = str(self.rng.choice(["", "", " + FILLS", " + SLOTS", " + EXCEPTPGNET"]))
            rect = f"RECT ( {box[0]} {box[1]} ) ( {box[2]} {box[3]} )"
            self.lines["BLOCKAGES"].append(f"LAYER {layer}{kind} {rect}")
            if kind not in (" + FILLS", " + SLOTS"):
                self.add(layer, box)
        self.lines["BLOCKAGES"].append(f"PLACEMENT RECT ( 0 0 ) ( {self.side[0]} {self.side[1]} )")

    def write(self, folder: Path) -> Path:
        for number, pin in enumerate(self.pins):
            self.lines["NETS"].append(f"net{number} ( {pin} )")
        sections = "".join(
            "\n".join(
                [f"{name} {len(items)} ;", *(f"- {item} ;" for item in items), f"END {name}\n"]
            )
            for name, items in self.lines.items()
        )
        (folder / "chip.lef").write_text("\n".join([*self.lef, "END LIBRARY\n"]))
        (folder / "chip.def").write_text(
            "VERSION 5.8 ;\nDESIGN chip ;\nUNITS DISTANCE MICRONS 10 ;\n"
            f"DIEAREA ( 0 0 ) ( {self.side[0]} {self.side[1]} ) ;\n{sections}END DESIGN\n"
        )
        return folder / "chip.def"


def painted(side: tuple[int, int], boxes: list[Box], halo: int) -> np.ndarray:
    """At every half unit, whether a wire's middle must not be there."""
    grid = np.zeros((2 * side[0] + 1, 2 * side[1] + 1), np.bool_)
    for x0, y0, x1, y1 in boxes:
        low_x, low_y = max(0, 2 * x0 - halo + 1), max(0, 2 * y0 - halo + 1)
        grid[low_x : max(0, 2 * x1 + halo), low_y : max(0, 2 * y1 + halo)] = True
    return grid


def raster_capacity(design: Design, problem: Problem, layer: str) -> np.ndarray:
    """(X, Y) free tracks from the middle of each Gcell to that of the next one."""
    assert problem.chip is not None
    axis, width, spacing = LAYERS[layer]
    lines = (problem.chip.x.tolist(), problem.chip.y.tolist())
    grid = painted(design.side, design.solid[layer], width + 2 * spacing)
    if axis == 1:
        grid, lines = grid.T, lines[::-1]
    along, across = lines
    pitch = width + spacing
    tracks = [t for t in range(round(pitch / 2), across[-1], pitch) if 0 < t < across[-1]]
    count = np.zeros((len(along) - 1, len(across) - 1), np.int64)
    for i in range(len(along) - 2):
        start, end = along[i] + along[i + 1], along[i + 1] + along[i + 2]
        for track in tracks:
            row = max(j for j in range(len(across) - 1) if across[j] <= track)
            count[i, row] += not grid[start : end + 1, 2 * track].any()
    return count if axis == 0 else count.T


@pytest.mark.parametrize("seed", range(40))
def test_capacities_and_pins_of_random_designs(tmp_path: Path, seed: int) -> None:
    design = Design(seed)
    problem = Problem.read(design.write(tmp_path), tile=(17, 19), pin_layer_wires=True)
    assert problem.chip is not None
    capacity = problem.capacity.reshape(*problem.grid, 3)
    for z, layer in enumerate(LAYERS):
        expected = raster_capacity(design, problem, layer)
        assert capacity[:, :, z, LAYERS[layer][0]].tolist() == expected.tolist(), layer
    # Every unit square of a pin lies in one Gcell; the pin is in the one that has most of them.
    names = {net.name: net for net in problem.nets}
    x, y = problem.chip.x, problem.chip.y
    for number, shapes in enumerate(design.pins.values()):
        squares: dict[tuple[int, int, int], int] = {}
        for layer, (x0, y0, x1, y1) in shapes:
            for i, j in np.ndindex(x1 - x0, y1 - y0):
                column = int(np.searchsorted(x, x0 + i, "right")) - 1
                row = int(np.searchsorted(y, y0 + j, "right")) - 1
                cell = (column, row, list(LAYERS).index(layer))
                squares[cell] = squares.get(cell, 0) + 1
        most = max(squares.values())
        expected_cells = [cell for cell, count in squares.items() if count == most]
        pin = names[f"net{number}"].pins[0]
        found = ((pin.x - x[0]) // 17, (pin.y - y[0]) // 19, pin.layer - 1)
        assert found in expected_cells
