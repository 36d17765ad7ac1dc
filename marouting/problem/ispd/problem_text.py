"""Problems as text: what tells the three formats apart, one reader and one writer for all."""

import itertools
import os
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from marouting.errors import InputError
from marouting.files import write_text
from marouting.problem.ispd.lines import Lines, Record, is_number, reading, unexpected
from marouting.problem.net import Adjustment, Net, Pin

Format = Literal["ispd2008", "ispd98", "ispd98-flat"]  # the formats of problems
FORMATS: tuple[Format, ...] = get_args(Format)


@dataclass(frozen=True)
class _Header:
    """A line of a header: a keyword and numbers."""

    keyword: str  # one or more words, or none
    fields: tuple[str, ...]  # the fields of the Problem that the numbers fill, in equal shares
    what: str  # the numbers in words, for error messages
    count: int | None = None  # how many numbers there are; None: at least one, for Problem to check

    @property
    def expected(self) -> str:
        """What the line should be, for error messages."""
        return f"'{self.keyword}' and {self.what}" if self.keyword else self.what

    def numbers(self, tokens: list[str]) -> tuple[int, ...]:
        """The numbers of a line; none if it is not such a header line."""
        words = self.keyword.split()
        numbers = tokens[len(words) :]
        fits = (
            [token.lower() for token in tokens[: len(words)]] == words
            and all(map(is_number, numbers))
            and self.count in (None, len(numbers))
        )
        return tuple(map(int, numbers)) if fits else ()


@dataclass(frozen=True)
class _Form:
    """What one format looks like: the first header line in which two differ tells them apart."""

    header: tuple[_Header, ...]
    net: tuple[str, ...] = ("name", "id", "number of pins")
    pin: tuple[str, ...] = ("x", "y")
    fixed: dict[str, tuple[int, ...]] = field(default_factory=lambda: {"adjustments": ()})


def _by_layer(keyword: str, name: str) -> _Header:
    return _Header(keyword, (name,), "a number for each layer")


_LAYERED = (
    _Header("grid", ("grid",), "columns, rows and layers", 3),
    _by_layer("vertical capacity", "vertical_capacity"),
    _by_layer("horizontal capacity", "horizontal_capacity"),
    _by_layer("minimum width", "min_width"),
)
_PLACED = (
    _by_layer("via spacing", "via_spacing"),
    _Header("", ("origin", "tile"), "origin x and y, tile width and height", 4),
)
_NUM_NET = _Header("num net", (), "their number", 1)
_FORMS: dict[Format, _Form] = {
    "ispd2008": _Form(
        (*_LAYERED, _by_layer("minimum spacing", "min_spacing"), *_PLACED),
        ("name", "id", "number of pins", "minimum width"),
        ("x", "y", "layer"),
        {},
    ),
    "ispd98": _Form((*_LAYERED, _by_layer("minimum width", "min_spacing"), *_PLACED)),
    "ispd98-flat": _Form(
        (
            _Header("grid", ("grid",), "columns and rows", 2),
            _Header("vertical capacity", ("vertical_capacity",), "a number", 1),
            _Header("horizontal capacity", ("horizontal_capacity",), "a number", 1),
        ),
        fixed={
            "min_width": (1,),
            "min_spacing": (0,),
            "via_spacing": (0,),
            "origin": (0, 0),
            "tile": (1, 1),
            "adjustments": (),
        },
    ),
}
_WIDTH = 1  # the minimum width of nets in formats without one
_LAYER = 1  # the layer of pins in formats without one, and the only layer of a flat grid


@dataclass(frozen=True)
class ProblemRecord(Record):
    """A problem file, as yet unchecked; ``lines`` has all nets' pins as ``"pins"``."""

    fields: Mapping[str, Any]  # the values of all fields of a Problem, by name


def read_problem(path: str | os.PathLike[str]) -> ProblemRecord:
    """Reads a problem in any of the formats; its header tells which.

    Only the form of the file is checked. Whether the numbers make sense is for Problem to say,
    and :meth:`ProblemRecord.located` then adds the line. The count of adjustments at the end may
    be missing when there are none.
    """
    where: dict[str, array[int]] = {}
    with reading(path) as lines:
        form, values = _read_header(lines, where)
        nets = _read_nets(lines, where, form, values["grid"][2])
        if "adjustments" not in form.fixed:
            values["adjustments"] = _read_adjustments(lines, where)
        elif tokens := lines.next():
            raise unexpected(f"the end of the file after {len(nets)} nets", tokens)
    return ProblemRecord(os.fspath(path), where, {"nets": nets, **values})


def write_problem(
    path: str | os.PathLike[str], fields: Mapping[str, Any], format: Format = "ispd2008"
) -> None:
    """Writes the fields of a valid Problem as text, for :func:`read_problem` to give back."""
    if format not in FORMATS:
        raise InputError(f"format: expected one of {', '.join(FORMATS)}, found {format!r}")
    form = _FORMS[format]
    if obstacle := next(_obstacles(fields, form), None):
        raise InputError(f"{os.fspath(path)}: the format {format} cannot hold it: {obstacle}")
    nets, adjustments = fields["nets"], fields["adjustments"]
    rows: list[tuple[object, ...]] = []
    for header in form.header:
        numbers = itertools.chain.from_iterable(fields[name] for name in header.fields)
        rows.append((*header.keyword.split(), *itertools.islice(numbers, header.count)))
    rows.append((_NUM_NET.keyword, len(nets)))
    for net in nets:
        widths = net.min_width if isinstance(net.min_width, tuple) else (net.min_width,)
        widths = widths if len(form.net) == 4 else ()
        rows.append((net.name, net.id, len(net.pins), *widths))
        rows += [pin[: len(form.pin)] for pin in net.pins]
    if "adjustments" not in form.fixed:
        rows += [(len(adjustments),), *adjustments]
    write_text(path, "".join(" ".join(map(str, row)) + "\n" for row in rows))


def _read_header(
    lines: Lines, where: dict[str, "array[int]"]
) -> tuple[_Form, dict[str, tuple[Any, ...]]]:
    """Reads the lines before ``num net``; records the line of each field in ``where``."""
    forms = list(_FORMS.values())
    values: dict[str, tuple[Any, ...]] = {}
    row = 0
    # The formats that remain after the first row have headers of equal length.
    while row < len(forms[0].header):
        tokens = lines.next()
        fitting = [form for form in forms if form.header[row].numbers(tokens)]
        if not fitting:
            expected = dict.fromkeys(form.header[row].expected for form in forms)
            raise unexpected(", or ".join(expected), tokens)
        forms = fitting
        header = forms[0].header[row]
        numbers = header.numbers(tokens)
        size = len(numbers) // len(header.fields)
        for i, name in enumerate(header.fields):
            values[name] = numbers[i * size : (i + 1) * size]
            where[name] = array("q", [lines.number])
        row += 1
    values["grid"] = (*values["grid"], _LAYER)[:3]
    return forms[0], values | forms[0].fixed


def _obstacles(fields: Mapping[str, Any], form: _Form) -> Iterator[str]:
    """What a problem has that a format has no place for."""
    layers, adjustments = fields["grid"][2], fields["adjustments"]
    if form.header[0].count == 2 and layers != _LAYER:
        yield f"expected one layer, found {layers}"
    if "adjustments" in form.fixed and adjustments:
        yield f"expected no adjustments, found {len(adjustments)}"
    for name, value in form.fixed.items():
        if fields[name] != value:
            yield f"expected {name} {value}, found {fields[name]}"
    for net in fields["nets"]:
        if len(form.net) < 4 and net.min_width != _WIDTH:
            yield f"net {net.name}: expected minimum width {_WIDTH}, found {net.min_width}"
        for pin in net.pins:
            if len(form.pin) < 3 and pin.layer != _LAYER:
                yield f"net {net.name}: expected pins in layer {_LAYER}, found {tuple(pin)}"


class _Numbers(dict[str, int]):
    """Numbers by their text. Coordinates recur: each is parsed once and takes memory once."""

    def __missing__(self, text: str) -> int:
        if not is_number(text):
            raise ValueError(text)
        number = int(text)
        if len(self) < _RECURRING:
            self[text] = number
        return number


_RECURRING = 2**16


def _read_nets(
    lines: Lines, where: dict[str, "array[int]"], form: _Form, layers: int
) -> tuple[Net, ...]:
    """Reads ``num net`` and the nets; records the lines of nets and pins in ``where``."""
    tokens = lines.next()
    if not (numbers := _NUM_NET.numbers(tokens)):
        raise unexpected(_NUM_NET.expected, tokens)
    (count,) = numbers
    if count < 1:
        raise InputError(f"expected at least one net, found {count}")
    where["nets"], where["pins"] = array("q"), array("q")
    nets: list[Net] = []
    number = _Numbers().__getitem__
    while len(nets) < count:
        tokens = lines.next()
        if not tokens:
            raise InputError(f"file ends after {len(nets)} of {count} nets")
        one_width = len(tokens) == len(form.net)
        by_layer = len(form.net) == 4 and len(tokens) == 3 + layers
        if not (one_width or by_layer) or not all(map(is_number, tokens[1:])):
            raise unexpected(f"net {len(nets) + 1} of {count} ({', '.join(form.net)})", tokens)
        name, (id_, pin_count, *widths) = tokens[0], map(int, tokens[1:])
        width = tuple(widths) if len(widths) > 1 else (*widths, _WIDTH)[0]
        where["nets"].append(lines.number)
        pins: list[Pin] = []
        while len(pins) < pin_count:
            tokens = lines.next()
            if not tokens:
                raise InputError(f"file ends after {len(pins)} of {pin_count} pins of net {name}")
            try:
                pin = tuple(map(number, tokens))
            except ValueError:
                pin = ()
            if len(pin) != len(form.pin):
                raise unexpected(
                    f"pin {len(pins) + 1} of {pin_count} of net {name} ({', '.join(form.pin)})",
                    tokens,
                )
            pins.append(Pin._make((*pin, _LAYER)[:3]))
            where["pins"].append(lines.number)
        nets.append(Net(name, id_, tuple(pins), width))
    return tuple(nets)


def _read_adjustments(lines: Lines, where: dict[str, "array[int]"]) -> tuple[Adjustment, ...]:
    """Reads the adjustments up to the end of the file; records their lines in ``where``."""
    where["adjustments"] = array("q")
    adjustments: list[Adjustment] = []
    tokens = lines.next()
    if not tokens:
        return ()
    if len(tokens) != 1 or not is_number(tokens[0]) or int(tokens[0]) < 0:
        raise unexpected("the number of adjusted capacities", tokens)
    count = int(tokens[0])
    while tokens := lines.next():
        if len(adjustments) == count:
            raise unexpected(f"the end of the file after {count} adjustments", tokens)
        if len(tokens) != 7 or not all(map(is_number, tokens)):
            raise unexpected(
                f"adjustment {len(adjustments) + 1} of {count} "
                "(x, y, layer, x, y, layer, capacity)",
                tokens,
            )
        adjustments.append(Adjustment(*map(int, tokens)))
        where["adjustments"].append(lines.number)
    if len(adjustments) < count:
        raise InputError(f"file ends after {len(adjustments)} of {count} adjustments")
    return tuple(adjustments)
