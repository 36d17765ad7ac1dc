"""DEF files: the die, tracks, Gcells, components, pins and nets, in the file's units.

Shapes are not read here. What holds them is copied for klayout, statement by statement.
"""

import os
import re
import warnings
from array import array
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import NamedTuple

from marouting.errors import InputError, nearest
from marouting.problem.ispd.lines import reading, unexpected
from marouting.problem.lefdef.lef_text import Library, Rule, is_keyword
from marouting.problem.lefdef.statements import (
    ENCODING_ERRORS,
    MOST_CUTS,
    Copy,
    Statements,
    number,
    whole,
)


class Tracks(NamedTuple):
    """Some tracks at equal distances."""

    axis: int  # 0 for tracks at places along x, which are vertical; 1 along y
    first: int  # the place of the first
    number: int  # how many
    step: int  # from one to the next
    layers: tuple[str, ...]  # the names of their layers; none for lines between Gcells
    line: int  # of the file


class Component(NamedTuple):
    """A macro of the design: the macro's name, and whether it has a place."""

    macro: str
    placed: bool


class PinVia(NamedTuple):
    """A via that is a shape of one of the design's own pins."""

    pin: str  # the pin's name
    via: str  # the via's name
    turn: int  # how the pin is turned (:data:`TURNS`)
    x: int  # where the via stands
    y: int  # where the via stands


@dataclass
class Design:
    """What a DEF file holds, in its units. Names of components and pins are without backslashes.

    Attributes:
        file: its name.
        units: how many make a micrometre.
        die: its corners, in order around it; a rectangle has four.
        tracks: the tracks.
        gcells: the lines between Gcells.
        vias: the names of its vias.
        components: by name.
        pins: for each pin of the design itself what it lacks, empty if nothing.
        ports: by pin the names and nets of its statements in PINS, which may be several.
        pin_vias: vias that are shapes of these pins.
        nets: their names.
        first: (nets + 1,) the connections of net i are ``first[i]`` to ``first[i + 1]``.
        connections: component (``PIN`` for a pin of the design) and pin of each.
        lines: of each net.
        rules: width and spacing by nondefault rule and layer, None: as usual.
        rule_of: the nondefault rule of the nets that have one.
        clocks: the names of clock nets.
    """

    file: str
    units: int = 0
    die: tuple[tuple[int, int], ...] = ()
    die_line: int = 1
    tracks: list[Tracks] = field(default_factory=list)
    gcells: list[Tracks] = field(default_factory=list)
    vias: set[str] = field(default_factory=set)
    components: dict[str, Component] = field(default_factory=dict)
    pins: dict[str, str] = field(default_factory=dict)
    ports: dict[str, dict[str, str]] = field(default_factory=dict)
    pin_vias: list[PinVia] = field(default_factory=list)
    nets: list[str] = field(default_factory=list)
    first: "array[int]" = field(default_factory=lambda: array("q", [0]))
    connections: list[tuple[str, str]] = field(default_factory=list)
    lines: "array[int]" = field(default_factory=lambda: array("q"))
    rules: dict[str, Rule] = field(default_factory=dict)
    rule_of: dict[str, str] = field(default_factory=dict)
    clocks: set[str] = field(default_factory=set)

    @property
    def box(self) -> tuple[int, int, int, int]:
        """The left, lower, right and upper side of the die."""
        x, y = zip(*self.die, strict=True)
        return min(x), min(y), max(x), max(y)

    def leave_out(self, nets: Container[int]) -> None:
        """Removes nets, given by their numbers, with their connections."""
        kept = [net for net in range(len(self.nets)) if net not in nets]
        bounds = [(self.first[net], self.first[net + 1]) for net in kept]
        self.nets = [self.nets[net] for net in kept]
        self.lines = array("q", [self.lines[net] for net in kept])
        self.connections = [c for low, high in bounds for c in self.connections[low:high]]
        self.first = array("q", accumulate((high - low for low, high in bounds), initial=0))


TURNS = {"N": 0, "W": 1, "S": 2, "E": 3, "FS": 4, "FW": 5, "FN": 6, "FE": 7}
"""Orientations as quarters of a turn, anticlockwise; from 4 on mirrored first, at the x axis."""

_SECTIONS = {
    "VIAS", "STYLES", "NONDEFAULTRULES", "REGIONS", "COMPONENTS", "PINS", "PINPROPERTIES",
    "BLOCKAGES", "SLOTS", "FILLS", "SPECIALNETS", "NETS", "SCANCHAINS", "GROUPS", "ASSERTIONS",
    "CONSTRAINTS", "IOTIMINGS", "FLOORPLANCONSTRAINTS", "DEFAULTCAP", "TIMINGDISABLES",
    "PARTITIONS",
}  # fmt: skip
_COPIED = {"VERSION", "NAMESCASESENSITIVE", "DIVIDERCHAR", "BUSBITCHARS", "DESIGN", "UNITS"}
_PLACED = ("PLACED", "FIXED", "COVER")


def read_def(path: str | os.PathLike[str], library: Library, copy: Copy) -> Design:
    """Reads a DEF file."""
    design = Design(os.fspath(path))
    with reading(path, errors=ENCODING_ERRORS) as lines:
        words = Statements(lines)
        while (word := words.keyword()) != "END":
            if not word:
                raise unexpected("'END DESIGN'", [])
            line = words.line
            if word in _SECTIONS:
                _read_section(words, word, design, library, copy)
            elif word == "PROPERTYDEFINITIONS":
                words.skip_to("END", word)
            elif word == "BEGINEXT":
                words.skip_to("ENDEXT")
            elif not is_keyword(word):
                raise unexpected("a statement of DEF", [word])
            else:
                rest = words.rest()
                _read_statement(word, rest, line, design, library)
                if word == "DESIGN":  # klayout wants a name that no macro has
                    while rest and rest[0] in library.macros:
                        rest[0] += "_"
                if word in _COPIED:
                    copy.write(line, " ".join([word, *rest, ";"]))
        if words.keyword() != "DESIGN":
            raise unexpected("'END DESIGN'", ["END"])
        if words.peek():
            warnings.warn(
                f"{design.file}:{words.line}: text after END DESIGN is ignored", stacklevel=2
            )
        if design.pin_vias:
            layer = next(iter(library.routing))
            copy.write(words.line, f"SPECIALNETS {len(design.pin_vias)} ;")
            for number, (_, via, turn, x, y) in enumerate(design.pin_vias):
                place = f"+ ROUTED {layer} 0 ( {x} {y} ) {via} {list(TURNS)[turn]} ;"
                copy.write(words.line, f"- via_of_pin_{number} {place}")
            copy.write(words.line, "END SPECIALNETS")
        copy.write(words.line, "END DESIGN")
        if not design.units:
            raise InputError("expected UNITS DISTANCE MICRONS before the end")
        if not design.die:
            raise InputError("expected a DIEAREA before the end")
        if not design.nets:
            raise InputError("expected at least one net with a pin")
    return design


def _read_statement(
    word: str, rest: list[str], line: int, design: Design, library: Library
) -> None:
    if word == "UNITS":
        if [part.upper() for part in rest[:2]] != ["DISTANCE", "MICRONS"] or len(rest) != 3:
            raise unexpected("'UNITS DISTANCE MICRONS' and a number", [word, *rest])
        design.units = whole(rest[2], "units", 1)
    elif word == "DIEAREA":
        design.die, design.die_line = _die(rest), line
    elif word in ("TRACKS", "GCELLGRID"):
        names = [part.upper() for part in rest]
        if len(rest) < 6 or names[0] not in ("X", "Y") or names[2:5:2] != ["DO", "STEP"]:
            raise unexpected(f"'{word} X|Y first DO count STEP step'", [word, *rest])
        first, count = whole(rest[1], "the first place"), whole(rest[3], "a count", 1)
        step = max(1, whole(rest[5], "a step", int(count > 1)))
        layers = tuple(rest[names.index("LAYER") + 1 :]) if "LAYER" in names else ()
        for name in layers:
            library.check_layer(name)
        tracks = Tracks(int(names[0] == "Y"), first, count, step, layers, line)
        (design.tracks if word == "TRACKS" else design.gcells).append(tracks)


def _die(rest: list[str]) -> tuple[tuple[int, int], ...]:
    """The corners of a die, of which each differs from the next in one coordinate."""
    numbers = [whole(token, "a corner of the die") for token in rest if token not in "()"]
    x, y = numbers[::2], numbers[1::2]
    if len(x) < 2 or len(x) != len(y) or min(x) == max(x) or min(y) == max(y):
        raise unexpected("'DIEAREA' and two corners or more", ["DIEAREA", *rest])
    if len(x) == 2:
        x, y = [x[0], x[0], x[1], x[1]], [y[0], y[1], y[1], y[0]]
    corners = tuple(zip(x, y, strict=True))
    sides = zip(corners, corners[1:] + corners[:1], strict=True)
    if any(a != c and b != d for (a, b), (c, d) in sides):
        raise InputError("DIEAREA: expected sides along x or y only")
    return corners


def _read_section(
    words: Statements, section: str, design: Design, library: Library, copy: Copy
) -> None:
    begun = words.line
    rest = words.rest()
    count = whole(rest[0], f"the number of {section}", 0) if len(rest) == 1 else -1
    if count < 0:
        raise unexpected(f"'{section}' and their number", [section, *rest])
    found = 0
    known: set[str] = set()
    copied = section in ("VIAS", "STYLES", "COMPONENTS", "PINS", "BLOCKAGES", "SPECIALNETS")
    if copied:
        copy.write(begun, f"{section} {count} ;")
    while (word := words.word()).upper() != "END":
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
            rest = _component(rest, design, library)
        elif section == "PINS":
            rest = _pin(rest, design, library)
        elif section == "BLOCKAGES":
            rest = _blockage(rest)
        elif section == "VIAS":
            design.vias.add(rest[0])
            _check_arrays(rest)
        elif section == "NONDEFAULTRULES":
            design.rules[rest[0]] = _rule(rest, library)
        elif section == "SPECIALNETS":
            _check_arrays(rest)
            _check_vias(rest, design, library)
        elif section == "NETS" and rest[0].upper() != "MUSTJOIN":
            # A MUSTJOIN net has no name; it joins pins of one component, inside of it.
            if rest[0] in known:
                raise InputError(f"net {rest[0]}: expected a name no earlier net has")
            known.add(rest[0])
            _net(rest, line, design, library)
        if copied and rest:
            copy.write(line, f"- {' '.join(rest)} ;")
    if (end := words.word()).upper() != section:
        raise unexpected(f"'END {section}'", ["END", end])
    if copied:
        copy.write(words.line, f"END {section}")
    if found != count:
        warnings.warn(
            f"{design.file}:{words.line}: {section}: expected {count}, as line {begun} says, "
            f"found {found} before their end",
            stacklevel=2,
        )


def _rule(rest: list[str], library: Library) -> Rule:
    """Width and spacing by layer of ``name {+ LAYER layer WIDTH w … [SPACING s] …}``."""
    rule = Rule()
    for clause in _clauses(rest[1:]):
        if clause[0].upper() == "LAYER" and len(clause) > 1:
            library.check_layer(clause[1])
            sizes = dict(zip([word.upper() for word in clause[2::2]], clause[3::2], strict=False))
            what = f"a size of layer {clause[1]} in rule {rest[0]}"
            found: list[float | None] = []
            for name in ("WIDTH", "SPACING"):
                found.append(number(sizes[name], what) if name in sizes else None)
                if (found[-1] or 0) < 0:
                    raise unexpected(f"{what}, from 0", [sizes[name]])
            rule[clause[1]] = (found[0], found[1])
    return rule


def _component(rest: list[str], design: Design, library: Library) -> list[str]:
    """Adds a component to the design; returns its name, macro and place, nothing without one."""
    if len(rest) < 2:
        raise unexpected("a component's name and macro", rest)
    name, macro = rest[:2]
    if macro not in library.macros:
        hint = nearest(macro, library.macros) if len(library.macros) < 1000 else ""
        raise InputError(
            f"component {name}: {hint}expected a macro of the LEF files, found {macro}"
        )
    plain = name.replace("\\", "")
    if plain in design.components:
        raise InputError(f"component {name}: expected a name no earlier component has")
    place: list[str] = []
    for clause in _clauses(rest[2:]):
        if clause[0].upper() in _PLACED:
            place = ["+", *_place(clause, f"component {name}")]
    design.components[plain] = Component(macro, bool(place))
    return [name, macro, *place] if place else []


def _place(clause: list[str], what: str) -> list[str]:
    """A clause such as ``PLACED ( x y ) N``, in capitals; raises InputError for another one."""
    place = [clause[0].upper(), *clause[1:5], *(word.upper() for word in clause[5:6])]
    if len(place) != 6 or place[1] != "(" or place[4] != ")" or place[5] not in TURNS:
        raise unexpected(f"'( x y ) orientation' of {what}", clause[1:6])
    for coordinate in place[2:4]:
        whole(coordinate, f"the place of {what}")
    return place


def _clauses(words: list[str]) -> Iterator[list[str]]:
    """The parts of a statement that each follow a ``+``."""
    pluses = [at for at, word in enumerate(words) if word == "+"]
    for start, end in zip(pluses, [*pluses[1:], len(words)], strict=False):
        if start + 1 < end:
            yield words[start + 1 : end]


def _pin_name(name: str) -> str:
    """A pin's name; of a further port of pin x, which older files call ``x.extra1``, that is x."""
    return re.sub(r"\.extra[0-9]*$", "", name.replace("\\", ""))


def _net_of_pin(rest: list[str]) -> str:
    """The net of a pin of the design; empty without one."""
    nets = (clause[1] for clause in _clauses(rest) if clause[0].upper() == "NET" and clause[1:])
    return next(nets, "")


def _pin(rest: list[str], design: Design, library: Library) -> list[str]:
    """Adds a pin to the design; returns what klayout has to know of it, nothing without shapes.

    The shapes of a pin, or of each of its ports, are where PLACED, FIXED or COVER says.
    """
    name = rest[0]
    ports: list[list[list[str]]] = [[]]
    for clause in _clauses(rest[1:]):
        if clause[0].upper() == "PORT":
            ports.append([])
        else:
            ports[-1].append(clause)
    copied: list[str] = []
    shaped = placed = usable = False
    for port in ports:
        shapes = [clause for clause in port if clause[0].upper() in ("LAYER", "POLYGON")]
        vias = [clause for clause in port if clause[0].upper() == "VIA"]
        places = [clause for clause in port if clause[0].upper() in _PLACED]
        shaped |= bool(shapes or vias)
        placed |= bool(places)
        if not places or not (shapes or vias):
            continue
        usable = True
        place = _place(places[-1], f"pin {name}")
        if shapes:
            copied += ["+", "PORT"] * (len(ports) > 1)
            copied += [word for clause in (*shapes, place) for word in ("+", *clause)]
        design.pin_vias += _vias_of_pin(name, vias, place, design, library)
    plain, net = _pin_name(name), _net_of_pin(rest)
    ports_of = design.ports.setdefault(plain, {})
    if name in ports_of:
        raise InputError(f"pin {name}: expected a name no earlier pin has")
    if ports_of and net not in ports_of.values():
        raise InputError(f"pin {name}: expected the net of {next(iter(ports_of))}, found {net}")
    ports_of[name] = net
    lacks = "" if usable else _NO_SHAPE if placed and not shaped else _NO_PLACE
    design.pins[plain] = lacks and design.pins.get(plain, lacks)
    return [name, "+", "NET", name, *copied] if copied else []


_NO_SHAPE = "has no shape: expected LAYER, POLYGON or VIA"
_NO_PLACE = "is not placed: expected PLACED, FIXED or COVER"


def _vias_of_pin(
    pin: str, clauses: Sequence[list[str]], place: list[str], design: Design, library: Library
) -> Iterator[PinVia]:
    """The vias among a pin's shapes, as ``VIA name ( x y )`` from the pin's place."""
    for clause in clauses:
        if len(clause) < 6 or clause[-4] != "(" or clause[-1] != ")":
            raise unexpected(f"'VIA name ( x y )' of pin {pin}", clause)
        _check_via(clause[1], f"pin {pin}", design, library)
        x, y = (whole(word, f"a via of pin {pin}") for word in clause[-3:-1])
        turn = TURNS[place[5]]
        if turn >= 4:
            y = -y
        for _ in range(turn % 4):
            x, y = -y, x
        yield PinVia(_pin_name(pin), clause[1], turn, int(place[2]) + x, int(place[3]) + y)


def _blockage(rest: list[str]) -> list[str]:
    """A blockage, or nothing if wires need not avoid it: one of placement, fill or slots."""
    kinds = {clause[0].upper() for clause in _clauses(rest)}
    return rest if rest[0].upper() == "LAYER" and not kinds & {"FILLS", "SLOTS"} else []


def _check_vias(rest: list[str], design: Design, library: Library) -> None:
    """Raises InputError for a via in a special net's wires that nobody defines.

    Between the points of a wire, in parentheses, stand vias and few other words.
    """
    what, inside, at, skip = f"net {rest[0]}", False, 1, True
    while at < len(rest):
        word = rest[at].upper()
        if word in "()":
            inside, skip = word == "(", False
        elif word in ("+", "NEW"):  # up to the next point stand keywords, a layer and a width
            skip = True
            if [part.upper() for part in rest[at : at + 2]] == ["+", "VIA"]:
                if at + 2 == len(rest):
                    raise unexpected(f"'VIA name' of {what}", rest[at:])
                _check_via(rest[at + 2], what, design, library)
        elif not inside and not skip:
            if word == "DO":
                at += 6  # DO count BY count STEP x y
            elif word == "MASK":
                at += 1
            elif word == "RECT":  # ( dx dy dx dy )
                pass
            elif word != "VIRTUAL" and word not in TURNS:
                _check_via(rest[at], what, design, library)
        at += 1


def _check_via(name: str, what: str, design: Design, library: Library) -> None:
    if name not in design.vias and name not in library.vias:
        hint = nearest(name, [*design.vias, *library.vias])
        raise InputError(f"{what}: {hint}expected a via of VIAS or of the LEF files, found {name}")


def _net(rest: list[str], line: int, design: Design, library: Library) -> None:
    """Adds a net with its connections, if it has any, to the design."""
    connections: list[tuple[str, str]] = []
    for names in _connections(rest[1:], rest[0]):
        component, pin = (name.replace("\\", "") for name in names)
        of_chip = component.upper() == "PIN" and component not in design.components
        connection = ("PIN", _pin_name(pin)) if of_chip else (component, pin)
        if not of_chip or connection not in connections:
            connections.append(connection)
    for component, pin in connections:
        if component == "PIN":
            if pin not in design.pins:
                raise InputError(f"net {rest[0]}: expected a pin of PINS, found {pin}")
            what, lacks = f"pin {pin} of PIN", design.pins[pin]
        elif component not in design.components:
            raise InputError(f"net {rest[0]}: expected a component, found {component}")
        else:
            macro, is_placed = design.components[component]
            if pin not in library.macros[macro]:
                raise InputError(
                    f"net {rest[0]}: expected a pin of {component}'s macro {macro}, found {pin}"
                )
            what, lacks = f"component {component}", "" if is_placed else _NO_PLACE
        if lacks and len(connections) > 1:  # one pin alone needs no place: nothing is routed to it
            raise InputError(f"net {rest[0]}: {what} {lacks}")
    for clause in _clauses(rest):
        keyword = clause[0].upper()
        if keyword == "USE" and clause[1:2] and clause[1].upper() == "CLOCK":
            design.clocks.add(rest[0])
        elif keyword == "NONDEFAULTRULE" and clause[1:2]:
            rule = clause[1]
            if rule not in design.rules and rule not in library.rules:
                hint = nearest(rule, [*design.rules, *library.rules])
                raise InputError(
                    f"net {rest[0]}: {hint}expected a rule of NONDEFAULTRULES or of the LEF files, "
                    f"found {rule}"
                )
            design.rule_of[rest[0]] = rule
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
            if len(sides) != 2 or sides[0] * sides[1] > MOST_CUTS:
                raise InputError(f"expected at most {MOST_CUTS} in an array, found {pair}")
