"""LEF files: layers' rules, and the names of vias, macros and their pins.

Shapes are not read here. Everything is in the units of the files, micrometres.
"""

import os
import re
from dataclasses import dataclass, field

from marouting.errors import InputError, nearest
from marouting.problem.ispd.lines import reading, unexpected
from marouting.problem.lefdef.statements import (
    ENCODING_ERRORS,
    MOST_CUTS,
    Copy,
    Statements,
    number,
    whole,
)


@dataclass
class Layer:
    """A routing layer's rules, in micrometres."""

    name: str  # its name
    at: str = ""  # the file and the line of its definition
    axis: int = -1  # 0 if it is for horizontal wires, 1 if for vertical ones; -1 until it is known
    width: float = 0  # of its wires; 0 until it is known
    spacing: float | None = None  # between wires; None: what the pitch leaves
    pitch: tuple[float, float] = (0, 0)  # between tracks along x and along y
    offset: tuple[float, float] | None = None  # of the first track along x, y; None: half a pitch


Rule = dict[str, tuple[float | None, float | None]]
"""Width and spacing by layer, in the units of the file; None: as usual."""


@dataclass
class Library:
    """What LEF files hold.

    Attributes:
        routing: the routing layers by name, lowest first.
        others: the names of the other layers.
        vias: the names of the vias.
        macros: the names of the pins of each macro, without backslashes.
        rules: width and spacing of each layer by nondefault rule and layer, None: as usual.
        pin_vias: vias that are shapes of macros' pins: macro, pin, via, and where it stands.
        used_vias: the vias of macros, with the file and the line that first names each.
        used_layers: the layers of nondefault rules, with the same.
        layers_at: for each layer of macros the file and the line that first names it.
        files: their names.
    """

    routing: dict[str, Layer] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    vias: set[str] = field(default_factory=set)
    macros: dict[str, set[str]] = field(default_factory=dict)
    rules: dict[str, Rule] = field(default_factory=dict)
    pin_vias: list[tuple[str, str, str, float, float]] = field(default_factory=list)
    used_vias: dict[str, str] = field(default_factory=dict)
    used_layers: dict[str, str] = field(default_factory=dict)
    layers_at: dict[str, str] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    @property
    def layers(self) -> list[Layer]:
        """The routing layers, lowest first."""
        return list(self.routing.values())

    def check(self) -> None:
        """Raises InputError if a layer lacks what routing takes, or a name is not defined."""
        for layer in self.layers:
            if layer.axis < 0:
                raise InputError(
                    f"{layer.at}: layer {layer.name}: expected DIRECTION HORIZONTAL or VERTICAL"
                )
            if not layer.width:
                raise InputError(f"{layer.at}: layer {layer.name}: expected a WIDTH")
        for via, at in self.used_vias.items():
            if via not in self.vias:
                raise InputError(f"{at}: expected a via of the LEF files, found {via}")
        for name, at in self.used_layers.items():
            try:
                self.check_layer(name)
            except InputError as error:
                raise InputError(f"{at}: {error}") from None

    def check_layer(self, name: str) -> None:
        """Raises InputError if no layer has a name."""
        if name not in self.routing and name not in self.others:
            hint = nearest(name, self.routing)
            raise InputError(f"layer {name}: {hint}expected a routing layer of the LEF files")


_END_WITH_NAME = {"VIARULE", "SITE", "ARRAY"}  # blocks that end with END and their name
_END_WITH_KEYWORD = {  # blocks that end with END and the keyword
    "UNITS", "SPACING", "IRDROP", "PROPERTYDEFINITIONS", "NOISETABLE", "CORRECTIONTABLE",
}  # fmt: skip
is_keyword = re.compile("[A-Za-z][A-Za-z0-9_]*").fullmatch


def read_library(path: str | os.PathLike[str], library: Library, copy: Copy) -> None:
    """Adds what a LEF file holds to a library; ``copy`` gets all words of the file.

    A file may lack ``END LIBRARY``, or go on after it: LEF files that were joined are one file.
    Of a macro or a rule that is given twice, the first counts.
    """
    library.files.append(os.fspath(path))
    with reading(path, errors=ENCODING_ERRORS) as lines:
        words = Statements(lines, copy)
        while word := words.keyword():
            if word == "END":
                if (end := words.word()).upper() != "LIBRARY":
                    raise unexpected("'END LIBRARY'", [word, end])
            elif word == "LAYER":
                _read_layer(words, library, os.fspath(path))
            elif word == "MACRO":
                _read_macro(words, library)
            elif word == "VIA":
                library.vias.add(name := words.word())
                words.skip_to("END", name)
            elif word == "NONDEFAULTRULE":
                _read_rule(words, library, os.fspath(path))
            elif word in _END_WITH_NAME:
                words.skip_to("END", words.word())
            elif word in _END_WITH_KEYWORD:
                words.skip_to("END", word)
            elif word == "BEGINEXT":
                words.skip_to("ENDEXT")
            elif is_keyword(word):
                words.rest()
            else:
                raise unexpected("a statement of LEF", [word])


def _read_layer(words: Statements, library: Library, file: str) -> None:
    layer = Layer(words.word())
    layer.at = f"{file}:{words.line}"
    routing = False
    while words.peek().upper() != "END":
        keyword = words.keyword()
        if keyword == "TYPE":  # klayout takes no other layers for routing than those in capitals
            routing = words.keyword() == "ROUTING"
        rest = words.rest()
        first = rest[0].upper() if rest else ""
        if keyword.endswith("CURRENTDENSITY"):
            # A table has statements of its own, WIDTH among them, the last of which is this:
            if len(rest) > 1 and rest[1].upper() in ("FREQUENCY", "WIDTH", "CUTAREA"):
                while words.keyword() != "TABLEENTRIES":
                    words.rest()
                words.rest()
        elif keyword == "DIRECTION" and first in ("HORIZONTAL", "VERTICAL"):
            layer.axis = int(first == "VERTICAL")
        elif keyword == "WIDTH" and routing:
            layer.width = _size(rest, f"the width of layer {layer.name}")[0]
        elif keyword == "PITCH":
            layer.pitch = _size(rest, f"the pitch of layer {layer.name}")
        elif keyword == "OFFSET":
            offset = [number(word, f"the offset of layer {layer.name}") for word in rest[:2]]
            layer.offset = (offset[0], offset[-1]) if offset else None
        elif keyword == "SPACING" and len(rest) == 1 and routing:
            layer.spacing = _size(rest, f"the spacing of layer {layer.name}")[0]
        elif keyword == "SPACINGTABLE" and routing:
            layer.spacing = _first_spacing(rest, layer) or layer.spacing
    words.word()  # END
    words.expect(layer.name)
    if not routing:
        if layer.name not in library.routing:
            library.others.add(layer.name)
        return
    library.others.discard(layer.name)
    known = library.routing.setdefault(layer.name, layer)
    # A file of macros may name a layer again, with fewer rules or more.
    known.axis = layer.axis if known.axis < 0 else known.axis
    known.width = known.width or layer.width
    known.spacing = layer.spacing if known.spacing is None else known.spacing
    known.pitch = known.pitch if any(known.pitch) else layer.pitch
    known.offset = layer.offset if known.offset is None else known.offset


def _first_spacing(rest: list[str], layer: Layer) -> float | None:
    """The spacing of the narrowest and shortest wires in a SPACINGTABLE; None if it has none.

    That is the first number after ``WIDTH width [PRL length]`` of the first row. The table
    ``INFLUENCE`` is of the surroundings of wide wires only.
    """
    table = [word.upper() for word in rest]
    if "WIDTH" not in table or table[0] == "INFLUENCE":
        return None
    at = table.index("WIDTH") + 2
    if table[at : at + 1] == ["PRL"]:
        at += 2
    return _size(rest[at : at + 1], f"the spacing of layer {layer.name}")[0]


def _read_rule(words: Statements, library: Library, file: str) -> None:
    """Reads a nondefault rule, whose layers and vias are blocks that end with their name."""
    name = words.word()
    begun, rule = words.line, Rule()
    while (keyword := words.keyword()) != "END":
        if not keyword:
            raise InputError(f"file ends inside rule {name}, which begins in line {begun}")
        if keyword == "LAYER":
            layer = words.word()
            library.used_layers.setdefault(layer, f"{file}:{words.line}")
            size: dict[str, float] = {}
            while (inside := words.keyword()) != "END":
                rest = words.rest()
                if inside in ("WIDTH", "SPACING"):
                    size[inside] = _size(rest, f"a size of layer {layer} in rule {name}")[0]
            words.expect(layer)
            rule[layer] = (size.get("WIDTH"), size.get("SPACING"))
        elif keyword == "VIA":
            words.skip_to("END", words.word())
        elif keyword == "SPACING":
            words.skip_to("END", keyword)
        else:
            words.rest()
    words.expect(name)
    library.rules.setdefault(name, rule)


def _size(rest: list[str], what: str) -> tuple[float, float]:
    """One or two numbers above 0."""
    found = [number(word, what) for word in rest[:2]]
    if not found or not min(found) > 0:
        raise unexpected(f"{what}, above 0", rest)
    return found[0], found[-1]


def _read_macro(words: Statements, library: Library) -> None:
    name = words.word()
    begun = words.line
    pins: set[str] = set()
    vias = len(library.pin_vias)
    while (keyword := _keyword_of(words, name, begun)) != "END":
        if keyword == "PIN":
            pin = words.word()
            pins.add(pin.replace("\\", ""))
            while (inside := _keyword_of(words, name, begun)) != "END":
                if inside == "PORT":
                    _read_geometries(words, library, name, begun, pin.replace("\\", ""))
                else:
                    words.rest()
            words.expect(pin)
        elif keyword in ("OBS", "DENSITY"):
            _read_geometries(words, library, name, begun)
        elif keyword == "TIMING":
            words.skip_to("END", "TIMING")
        elif keyword == "SIZE":
            rest = words.rest()
            _size([rest[0], rest[-1]] if rest else [], f"the size of macro {name}")
        else:
            words.rest()
    words.expect(name)
    if name not in library.macros:
        library.macros[name] = pins
    else:  # klayout takes the first as well
        del library.pin_vias[vias:]


def _read_geometries(
    words: Statements, library: Library, macro: str, begun: int, pin: str | None = None
) -> None:
    """Passes over shapes up to an ``END`` without a name; notes the vias among them.

    A via is ``VIA [MASK n] x y name`` or ``VIA ITERATE [MASK n] x y name DO a BY b STEP c d``.
    """
    while (keyword := _keyword_of(words, macro, begun)) != "END":
        line, rest = words.line, words.rest()
        if keyword == "LAYER" and rest:
            library.layers_at.setdefault(rest[0], f"{library.files[-1]}:{line}")
        if keyword != "VIA":
            continue
        times = [(0.0, 0.0)]
        if rest[:1] and rest[0].upper() == "ITERATE":
            if len(rest) < 8 or [rest[i].upper() for i in (-7, -5, -3)] != ["DO", "BY", "STEP"]:
                raise unexpected(f"'DO a BY b STEP x y' of a via of macro {macro}", rest)
            columns, rows = (whole(rest[i], "the sides of an array", 1) for i in (-6, -4))
            if columns * rows > MOST_CUTS:
                raise InputError(f"expected at most {MOST_CUTS} in an array")
            step = [number(word, "the step of an array") for word in rest[-2:]]
            times = [(i * step[0], j * step[1]) for i in range(columns) for j in range(rows)]
            rest = rest[1:-7]
        rest = rest[2:] if rest[:1] and rest[0].upper() == "MASK" else rest
        if len(rest) != 3:
            raise unexpected(f"'VIA x y name' of macro {macro}", ["VIA", *rest])
        x, y = (number(word, f"the place of a via of macro {macro}") for word in rest[:2])
        library.used_vias.setdefault(rest[2], f"{library.files[-1]}:{line}: macro {macro}")
        if pin is not None:
            library.pin_vias += [(macro, pin, rest[2], x + i, y + j) for i, j in times]


def _keyword_of(words: Statements, macro: str, begun: int) -> str:
    """The next keyword inside a macro, which begins in a line of the file."""
    if keyword := words.keyword():
        return keyword
    raise InputError(f"file ends inside macro {macro}, which begins in line {begun}")
