"""LEF files: layers' rules, and the names of vias, macros and their pins.

Shapes are not read here. Everything is in the units of the files, micrometres.
"""

import os
import re
from dataclasses import dataclass, field

from marouting.errors import InputError
from marouting.problem.ispd.lines import reading, unexpected
from marouting.problem.lefdef.statements import (
    ENCODING_ERRORS,
    Copy,
    Statements,
    number,
)


@dataclass
class Layer:
    """A routing layer's rules, in micrometres.

    Attributes:
        name: its name.
        at: the file and the line of its definition.
        axis: 0 if it is for horizontal wires, 1 if for vertical ones; -1 until it is known.
        width: of its wires; 0 until it is known.
        spacing: between wires; None: what the pitch leaves.
        pitch: between tracks along x and along y.
        offset: of the first track along x and along y; None: half a pitch.
    """

    name: str
    at: str = ""
    axis: int = -1
    width: float = 0
    spacing: float | None = None
    pitch: tuple[float, float] = (0, 0)
    offset: tuple[float, float] | None = None


@dataclass
class Library:
    """What LEF files hold.

    Attributes:
        routing: the routing layers by name, lowest first.
        others: the names of the other layers.
        vias: the names of the vias.
        macros: the names of the pins of each macro, without backslashes.
        files: their names.
    """

    routing: dict[str, Layer] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    vias: set[str] = field(default_factory=set)
    macros: dict[str, set[str]] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    @property
    def layers(self) -> list[Layer]:
        """The routing layers, lowest first."""
        return list(self.routing.values())

    def check(self) -> None:
        """Raises InputError if a routing layer lacks what routing takes."""
        for layer in self.layers:
            if layer.axis < 0:
                raise InputError(
                    f"{layer.at}: layer {layer.name}: expected DIRECTION HORIZONTAL or VERTICAL"
                )
            if not layer.width:
                raise InputError(f"{layer.at}: layer {layer.name}: expected a WIDTH")


_NAMED = {"VIARULE", "SITE", "NONDEFAULTRULE", "ARRAY", "NOISETABLE", "CORRECTIONTABLE"}
_CLOSED = {"UNITS", "SPACING", "IRDROP", "PROPERTYDEFINITIONS"}
is_keyword = re.compile("[A-Za-z][A-Za-z0-9_]*").fullmatch


def read_library(path: str | os.PathLike[str], library: Library, copy: Copy) -> None:
    """Adds what a LEF file holds to a library.

    A file may lack ``END LIBRARY``, or go on after it: LEF files that were joined are one file.

    Args:
        path: the file.
        library: is added to. Of a macro or a rule that is given twice, the first counts.
        copy: gets all words of the file.

    Raises:
        InputError: it cannot be read or is not LEF.
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
            elif word in _NAMED:
                words.skip_to("END", words.word())
            elif word in _CLOSED:
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
        rest = words.rest()
        first = rest[0].upper() if rest else ""
        if keyword == "TYPE":
            routing = first == "ROUTING"
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
    while (keyword := _keyword_of(words, name, begun)) != "END":
        if keyword == "PIN":
            pin = words.word()
            pins.add(pin.replace("\\", ""))
            while (inside := _keyword_of(words, name, begun)) != "END":
                if inside == "PORT":
                    _skip_block(words, name, begun)
                else:
                    words.rest()
            words.expect(pin)
        elif keyword in ("OBS", "DENSITY"):
            _skip_block(words, name, begun)
        elif keyword == "TIMING":
            words.skip_to("END", "TIMING")
        elif keyword == "SIZE":
            rest = words.rest()
            _size([rest[0], rest[-1]] if rest else [], f"the size of macro {name}")
        else:
            words.rest()
    words.expect(name)
    library.macros.setdefault(name, pins)


def _skip_block(words: Statements, macro: str, begun: int) -> None:
    """Passes over statements up to an ``END`` without a name."""
    while _keyword_of(words, macro, begun) != "END":
        words.rest()


def _keyword_of(words: Statements, macro: str, begun: int) -> str:
    """The next keyword inside a macro, which begins in a line of the file."""
    if keyword := words.keyword():
        return keyword
    raise InputError(f"file ends inside macro {macro}, which begins in line {begun}")
