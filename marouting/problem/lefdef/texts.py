"""What LEF and DEF files say in words: layers' rules, macros, tracks, Gcells, components and nets.

Shapes are not read here. Everything is in the units of the files: LEF in micrometres, DEF in parts
of one.
"""

import os
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from marouting.errors import InputError, nearest
from marouting.problem.ispd.lines import reading, unexpected
from marouting.problem.lefdef.statements import Statements, number, whole


@dataclass
class Layer:
    """A routing layer's rules, in micrometres.

    Attributes:
        name: its name.
        axis: 0 if it is for horizontal wires, 1 if for vertical ones.
        width: of its wires.
        spacing: between wires; None: what the pitch leaves.
        pitch: between tracks along x and along y.
        offset: of the first track along x and along y; None: half a pitch.
    """

    name: str
    axis: int = -1
    width: float = 0
    spacing: float | None = None
    pitch: tuple[float, float] = (0, 0)
    offset: tuple[float, float] | None = None


@dataclass
class Library:
    """What LEF files hold.

    Attributes:
        layers: the routing layers, lowest first.
        macros: the names of the macros.
    """

    layers: list[Layer] = field(default_factory=list)
    macros: set[str] = field(default_factory=set)


class Tracks(NamedTuple):
    """Some tracks at equal distances.

    Attributes:
        axis: 0 for tracks at places along x, which are vertical; 1 along y.
        first: the place of the first.
        number: how many.
        step: from one to the next.
        layers: the names of their layers; none for lines between Gcells.
        line: of the file.
    """

    axis: int
    first: int
    number: int
    step: int
    layers: tuple[str, ...]
    line: int


class Component(NamedTuple):
    """A macro of the design: the macro's name, and whether it has a place."""

    macro: str
    placed: bool


@dataclass
class Design:
    """What a DEF file holds, in its units.

    Attributes:
        file: its name.
        units: how many make a micrometre.
        die: lower left and upper right corner.
        tracks: the tracks.
        gcells: the lines between Gcells.
        components: by name.
        pins: the names of the pins of the design itself.
        nets: their names.
        first: (nets + 1,) the connections of net i are ``first[i]`` to ``first[i + 1]``.
        connections: component (``PIN`` for a pin of the design) and pin of each.
        lines: of each net.
    """

    file: str
    units: int = 0
    die: tuple[int, int, int, int] | None = None
    die_line: int = 1
    tracks: list[Tracks] = field(default_factory=list)
    gcells: list[Tracks] = field(default_factory=list)
    components: dict[str, Component] = field(default_factory=dict)
    pins: set[str] = field(default_factory=set)
    nets: list[str] = field(default_factory=list)
    first: "array[int]" = field(default_factory=lambda: array("q", [0]))
    connections: list[tuple[str, str]] = field(default_factory=list)
    lines: "array[int]" = field(default_factory=lambda: array("q"))


# --- LEF ------------------------------------------------------------------------------------------

_NAMED = {"VIA", "VIARULE", "SITE", "NONDEFAULTRULE", "ARRAY", "NOISETABLE", "CORRECTIONTABLE"}
_CLOSED = {"UNITS", "SPACING", "IRDROP", "PROPERTYDEFINITIONS"}


def read_library(path: str | os.PathLike[str], library: Library) -> None:
    """Adds what a LEF file holds to a library; raises InputError if it cannot be read."""
    with reading(path) as lines:
        words = Statements(lines)
        while True:
            word = words.word()
            if not word:
                raise unexpected("'END LIBRARY'", [])
            if word == "END":
                words.expect("LIBRARY")
                return
            if word == "LAYER":
                _read_layer(words, library)
            elif word == "MACRO":
                _read_macro(words, library)
            elif word in _NAMED:
                words.skip_to("END", words.word())
            elif word in _CLOSED:
                words.skip_to("END", word)
            elif word == "BEGINEXT":
                words.skip_to("ENDEXT")
            elif word.isupper() and word.isalpha():
                words.rest()
            else:
                raise unexpected("a statement of LEF", [word])


def _read_layer(words: Statements, library: Library) -> None:
    layer = Layer(words.word())
    routing = False
    while words.peek() != "END":
        keyword = words.word()
        rest = words.rest()
        first = rest[0] if rest else ""
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
        elif keyword == "SPACINGTABLE" and routing and "WIDTH" in rest:
            # The first row is that of the narrowest wires, its first number that of the shortest.
            at = rest.index("WIDTH") + 2
            what = f"the spacing of layer {layer.name}"
            layer.spacing = _size(rest[at : at + 1], what)[0]
    words.expect("END")
    words.expect(layer.name)
    if not routing:
        return
    if layer.axis < 0:
        raise InputError(f"layer {layer.name}: expected DIRECTION HORIZONTAL or VERTICAL")
    if not layer.width:
        raise InputError(f"layer {layer.name}: expected a WIDTH")
    if layer.name in (other.name for other in library.layers):
        raise InputError(f"layer {layer.name}: expected a name no earlier layer has")
    library.layers.append(layer)


def _size(rest: list[str], what: str) -> tuple[float, float]:
    """One or two numbers above 0."""
    found = [number(word, what) for word in rest[:2]]
    if not found or not min(found) > 0:
        raise unexpected(f"{what}, above 0", rest)
    return found[0], found[-1]


def _read_macro(words: Statements, library: Library) -> None:
    name = words.word()
    begun = words.line
    before = ""
    while True:
        word = words.word()
        if not word:
            raise InputError(f"file ends inside macro {name}, which begins in line {begun}")
        if word == "END" and words.peek() == name:
            words.word()
            break
        if word == "SIZE" and before not in ("PIN", "END"):
            rest = words.rest()
            _size([rest[0], rest[-1]] if rest else [], f"the size of macro {name}")
        before = word
    library.macros.add(name)


# --- DEF ------------------------------------------------------------------------------------------

_SECTIONS = {
    "VIAS", "STYLES", "NONDEFAULTRULES", "REGIONS", "COMPONENTS", "PINS", "PINPROPERTIES",
    "BLOCKAGES", "SLOTS", "FILLS", "SPECIALNETS", "NETS", "SCANCHAINS", "GROUPS", "ASSERTIONS",
    "CONSTRAINTS", "IOTIMINGS", "FLOORPLANCONSTRAINTS", "DEFAULTCAP", "TIMINGDISABLES",
    "PARTITIONS",
}  # fmt: skip
_MOST_CUTS = 10**6
"""The most cuts of a via made by rule, and vias of an array: each becomes a shape."""


def read_def(path: str | os.PathLike[str], library: Library) -> Design:
    """Reads a DEF file.

    Args:
        path: the file.
        library: the macros and layers that it may name.

    Raises:
        InputError: it cannot be read, is not DEF, or names what the library does not have.
    """
    design = Design(os.fspath(path))
    layers = {layer.name for layer in library.layers}
    with reading(path) as lines:
        words = Statements(lines)
        while True:
            word = words.word()
            if not word:
                raise unexpected("'END DESIGN'", [])
            line = words.line
            if word == "END":
                words.expect("DESIGN")
                break
            if word in _SECTIONS:
                _read_section(words, word, design, library)
            elif word == "PROPERTYDEFINITIONS":
                words.skip_to("END", word)
            elif word == "BEGINEXT":
                words.skip_to("ENDEXT")
            elif not (word.isupper() and word.isalpha()):
                raise unexpected("a statement of DEF", [word])
            else:
                _read_statement(word, words.rest(), line, design, layers)
        if not design.units:
            raise InputError("expected UNITS DISTANCE MICRONS before the end")
        if design.die is None:
            raise InputError("expected a DIEAREA before the end")
        if not design.nets:
            raise InputError("expected at least one net with a pin")
    return design


def _read_statement(
    word: str, rest: list[str], line: int, design: Design, layers: set[str]
) -> None:
    if word == "UNITS":
        if rest[:2] != ["DISTANCE", "MICRONS"] or len(rest) != 3:
            raise unexpected("'UNITS DISTANCE MICRONS' and a number", [word, *rest])
        design.units = whole(rest[2], "units", 1)
    elif word == "DIEAREA":
        numbers = [whole(token, "a corner of the die") for token in rest if token not in "()"]
        x, y = numbers[::2], numbers[1::2]
        if len(x) < 2 or len(x) != len(y) or min(x) == max(x) or min(y) == max(y):
            raise unexpected("'DIEAREA' and two corners or more", [word, *rest])
        design.die, design.die_line = (min(x), min(y), max(x), max(y)), line
    elif word in ("TRACKS", "GCELLGRID"):
        if len(rest) < 6 or rest[0] not in "XY" or rest[2] != "DO" or rest[4] != "STEP":
            raise unexpected(f"'{word} X|Y first DO count STEP step'", [word, *rest])
        first, count = whole(rest[1], "the first place"), whole(rest[3], "a count", 1)
        step = whole(rest[5], "a step", 1)
        names = tuple(rest[rest.index("LAYER") + 1 :]) if "LAYER" in rest else ()
        for name in names:
            if name not in layers:
                hint = nearest(name, layers)
                raise InputError(f"layer {name}: {hint}expected a routing layer of the LEF files")
        tracks = Tracks(int(rest[0] == "Y"), first, count, step, names, line)
        (design.tracks if word == "TRACKS" else design.gcells).append(tracks)


def _read_section(words: Statements, section: str, design: Design, library: Library) -> None:
    begun = words.line
    rest = words.rest()
    count = whole(rest[0], f"the number of {section}", 0) if len(rest) == 1 else -1
    if count < 0:
        raise unexpected(f"'{section}' and their number", [section, *rest])
    found = 0
    known: set[str] = set()
    while (word := words.word()) != "END":
        if word != "-":
            if not word:
                raise InputError(
                    f"file ends inside {section}, which begins in line {begun}, "
                    f"after {found} of {count}, expected 'END {section}'"
                )
            raise unexpected(f"'-' or 'END {section}'", [word])
        line = words.line
        rest = words.rest()
        found += 1
        if not rest:
            raise unexpected(f"a name in {section}", [";"])
        if section == "COMPONENTS":
            _component(rest, design, library)
        elif section == "PINS":
            design.pins.add(rest[0])
        elif section == "NETS":
            if rest[0] in known:
                raise InputError(f"net {rest[0]}: expected a name no earlier net has")
            known.add(rest[0])
            _net(rest, line, design)
        elif section in ("VIAS", "SPECIALNETS"):
            _check_arrays(rest)
    if (end := words.word()) != section:
        raise unexpected(f"'END {section}'", ["END", end])
    if section in ("COMPONENTS", "PINS", "NETS") and found != count:
        raise InputError(
            f"{section}: expected {count}, as line {begun} says, found {found} before their end"
        )


def _component(rest: list[str], design: Design, library: Library) -> None:
    if len(rest) < 2:
        raise unexpected("a component's name and macro", rest)
    name, macro = rest[:2]
    if macro not in library.macros:
        hint = nearest(macro, library.macros) if len(library.macros) < 1000 else ""
        raise InputError(
            f"component {name}: {hint}expected a macro of the LEF files, found {macro}"
        )
    if name in design.components:
        raise InputError(f"component {name}: expected a name no earlier component has")
    placed = False
    for at, word in enumerate(rest):
        if word in ("PLACED", "FIXED", "COVER") and rest[at - 1] == "+":
            place = rest[at + 1 : at + 6]
            if len(place) != 5 or place[0] != "(" or place[3] != ")" or place[4] not in ORIENTS:
                raise unexpected(f"'( x y ) orientation' of component {name}", place)
            for coordinate in place[1:3]:
                whole(coordinate, f"the place of component {name}")
            placed = True
    design.components[name] = Component(macro, placed)


ORIENTS = ("N", "S", "E", "W", "FN", "FS", "FE", "FW")


def _net(rest: list[str], line: int, design: Design) -> None:
    connections = list(_connections(rest[1:], rest[0]))
    for component, pin in connections:
        if component == "PIN":
            if pin not in design.pins:
                raise InputError(f"net {rest[0]}: expected a pin of PINS, found {pin}")
        elif component not in design.components:
            raise InputError(f"net {rest[0]}: expected a component, found {component}")
        elif not design.components[component].placed:
            raise InputError(f"net {rest[0]}: expected component {component} to have a place")
    if connections:
        design.nets.append(rest[0])
        design.lines.append(line)
        design.connections += connections
        design.first.append(len(design.connections))


def _connections(words: list[str], net: str) -> Iterator[tuple[str, str]]:
    at = 0
    while at < len(words) and words[at] == "(":
        # ( component pin [+ SYNTHESIZED] )
        if ")" not in words[at : at + 6] or words[at + 3 : at + 4] not in ([")"], ["+"]):
            raise unexpected(f"'( component pin )' of net {net}", words[at : at + 6])
        yield words[at + 1], words[at + 2]
        at = words.index(")", at) + 1
    if at < len(words) and words[at] != "+":
        raise unexpected(f"'( component pin )' or '+' of net {net}", words[at : at + 4])


def _check_arrays(rest: list[str]) -> None:
    """Refuses arrays of cuts or vias that would take all memory as shapes."""
    for at, word in enumerate(rest):
        pair = []
        if word == "ROWCOL":
            pair = rest[at + 1 : at + 3]
        elif word == "DO" and rest[at + 2 : at + 3] == ["BY"]:
            pair = [rest[at + 1], *rest[at + 3 : at + 4]]
        if pair:
            sides = [whole(side, "the sides of an array", 0) for side in pair]
            if len(sides) != 2 or sides[0] * sides[1] > _MOST_CUTS:
                raise InputError(f"expected at most {_MOST_CUTS} in an array, found {pair}")
