"""The text formats of the ISPD benchmarks: problems in three formats, and solutions.

==================== ====================== ===================== ================
..                   ``ispd2008``           ``ispd98``            ``ispd98-flat``
==================== ====================== ===================== ================
grid                 columns, rows, layers  the same              columns, rows
vertical capacity    one number a layer     the same              one number
horizontal capacity  one number a layer     the same              one number
minimum width        one number a layer     the same              none: 1
minimum spacing      one number a layer     as ``minimum width``  none: 0
via spacing          one number a layer     the same              none: 0
origin, tile         four numbers           the same              none: 0 0, 1 1
num net              their number           the same              the same
a net                name id pins width     name id pins          name id pins
a pin                x y layer              x y                   x y
adjustments          a count, then rows     none                  none
==================== ====================== ===================== ================

``ispd2008`` is the ``.gr`` file of the ISPD 2008 global routing contest
(http://www.ispd.cc/contests/08/ispd08rc.html). Adjustments give an edge a capacity of its own:
``x y layer x y layer capacity`` with columns and rows from 0 and layers from 1. The contest does
not say that an edge has one at most; its evaluator (``eval2008.pl``) lets the last one count.

``ispd98`` is what BoxRouter 2.0 (Cho et al., 2007) brings as ``ibm01.modified.txt``: the ISPD'98
benchmarks with two layers. Its header is that of the contest but for one wrong word, by which it is
recognised: the minimum spacing stands under ``minimum width``, a second time. Pins are in layer 1;
several pins of a net, or all of them, may lie in one Gcell. A wire takes width 1 + spacing 1, so
that capacities 24 and 28 are the twelve and fourteen tracks of the flat file.

``ispd98-flat`` is the same benchmarks in the plane, as Labyrinth (Kastner et al., 2000) and
BoxRouter have them: one layer with both capacities, in tracks. What the file does not say is
understood as in the reader of NTHU-Route 2.0 (Chang et al., 2008). A grid of two numbers tells it.

All are read line by line, as what the lines say: a header that promises more than follows costs
no memory. Tokens are separated by any white space, blank lines mean nothing, keywords are written
in any case. Whatever is wrong raises :class:`~marouting.errors.InputError` with one line that
names the file and the line. Written files have one form only, so that equal objects give equal
bytes.
"""

import contextlib
import itertools
import os
import re
import warnings
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.files import unusable, write_text
from marouting.problem.grid import AXES, OFF_GRID
from marouting.problem.problem import Adjustment, FieldError, Net, Pin, Problem
from marouting.problem.solution import Solution

# Eighteen digits fit into 64 bits; the problem's own limits are far below.
_NUMBER = "[+-]?[0-9]{1,18}"
_POINT = rf"\( ?({_NUMBER}) ?, ?({_NUMBER}) ?, ?({_NUMBER}) ?\)"
_is_number = re.compile(_NUMBER).fullmatch
_segment = re.compile(f"{_POINT} ?- ?{_POINT}").fullmatch

Format = Literal["ispd2008", "ispd98", "ispd98-flat"]
"""The formats of problems."""

FORMATS: tuple[Format, ...] = get_args(Format)


@dataclass(frozen=True)
class _Header:
    """A line of a header: a keyword and numbers.

    Attributes:
        keyword: one or more words, or none.
        fields: the fields of the Problem that the numbers are, each as many as the others.
        what: the numbers, for the messages of errors.
        count: how many they are; None: one or more, as many as the Problem wants.
    """

    keyword: str
    fields: tuple[str, ...]
    what: str
    count: int | None = None

    @property
    def expected(self) -> str:
        """What the line is, for the messages of errors."""
        return f"'{self.keyword}' and {self.what}" if self.keyword else self.what

    def numbers(self, tokens: list[str]) -> tuple[int, ...]:
        """The numbers of a line that is as this one says; none when it is not."""
        words = self.keyword.split()
        numbers = tokens[len(words) :]
        fits = (
            [token.lower() for token in tokens[: len(words)]] == words
            and all(map(_is_number, numbers))
            and self.count in (None, len(numbers))
        )
        return tuple(map(int, numbers)) if fits else ()


@dataclass(frozen=True)
class _Form:
    """What tells one format of problems from the others.

    Attributes:
        header: its lines, less ``num net``; the first that two formats have not in common tells
            them apart.
        net: what the line of a net holds: a Net's name and id, the number of pins, its width.
        pin: what the line of a pin holds of a Pin.
        fixed: fields of the Problem that the file cannot say, and what they are.
    """

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
_WIDTH = 1
"""The minimum width of a net where a format has none."""

_LAYER = 1
"""The layer of pins where a format has none, and the only layer of a flat grid."""


def read_problem(path: str | os.PathLike[str]) -> Problem:
    """Reads a problem in any of the formats; its header tells which.

    Args:
        path: the file. The count of adjustments at its end may be missing when there are none.

    Returns:
        The problem, in the units of the file.

    Raises:
        InputError: the file cannot be read, is of none of the formats, or contradicts itself.
    """
    with _reading(path) as lines:
        # The line of every row of every field: what rows may hold is judged by Problem alone.
        where: dict[str, array[int]] = {}

        form, values = _read_header(lines, where)
        nets = _read_nets(lines, where, form)
        if "adjustments" not in form.fixed:
            values["adjustments"] = _read_adjustments(lines, where)
        elif tokens := lines.next():
            raise _unexpected(f"the end of the file after {len(nets)} nets", tokens)
        try:
            return Problem(nets=nets, **values)
        except FieldError as error:
            lines.number = where[error.field][error.row]
            raise


def write_problem(
    problem: Problem, path: str | os.PathLike[str], format: Format = "ispd2008"
) -> None:
    """Writes a problem as text of a format, whole or not at all.

    What is written is read as a problem equal to this one.

    Args:
        problem: what is written.
        path: the file.
        format: one of FORMATS.

    Raises:
        InputError: there is no such format, it cannot hold the problem, or the file cannot be
            written.
    """
    if format not in FORMATS:
        raise InputError(f"format: expected one of {', '.join(FORMATS)}, found {format!r}")
    form = _FORMS[format]
    if unheld := next(_unheld(problem, form), None):
        raise InputError(f"{os.fspath(path)}: the format {format} cannot hold it: {unheld}")
    rows: list[tuple[object, ...]] = []
    for header in form.header:
        numbers = itertools.chain.from_iterable(getattr(problem, name) for name in header.fields)
        rows.append((*header.keyword.split(), *itertools.islice(numbers, header.count)))
    rows.append((_NUM_NET.keyword, len(problem.nets)))
    for net in problem.nets:
        rows.append((net.name, net.id, len(net.pins), net.min_width)[: len(form.net)])
        rows += [pin[: len(form.pin)] for pin in net.pins]
    if "adjustments" not in form.fixed:
        rows += [(len(problem.adjustments),), *problem.adjustments]
    write_text(path, "".join(" ".join(map(str, row)) + "\n" for row in rows))


def read_solution(path: str | os.PathLike[str], problem: Problem) -> Solution:
    """Reads ISPD solution text.

    A net without a block is routed with no edges. An edge that a net lists twice counts once, with
    one ``UserWarning`` for the file.

    Args:
        path: the file.
        problem: what it solves; points are mapped to Gcells with its origin and tile.

    Returns:
        The solution.

    Raises:
        InputError: the file cannot be read, is not of this format, or does not fit the problem.
    """
    with _reading(path) as lines:
        nets, numbers, ends = _read_segments(lines, problem)
        near, length, axis = _runs(lines, problem, numbers, ends)
        segment = np.repeat(np.arange(len(length)), length)
        step = np.arange(len(segment)) - np.repeat(np.cumsum(length) - length, length)
        edge = near[segment] + (AXES * problem.strides)[axis[segment]] * step
        size = AXES * int(np.prod(problem.grid))
        uses, first = np.unique(nets[segment] * size + edge, return_index=True)
    if len(uses) < len(edge):
        repeated = np.ones(len(edge), np.bool_)
        repeated[first] = False
        at = segment[repeated.argmax()]
        warnings.warn(
            f"{os.fspath(path)}:{numbers[at]}: net {problem.nets[nets[at]].name} lists an edge "
            f"again; {len(edge) - len(uses)} repetitions in this file count once",
            stacklevel=3,
        )
    net, edge = np.divmod(uses, size)
    return Solution(
        problem, tuple(np.split(edge, np.searchsorted(net, np.arange(1, len(problem.nets)))))
    )


def write_solution(solution: Solution, path: str | os.PathLike[str]) -> None:
    """Writes a solution as ISPD solution text, whole or not at all.

    Nets come in the problem's order, each as its longest straight segments, ordered by their lower
    end; points are the centres of Gcells.

    Raises:
        InputError: the file cannot be written.
    """
    problem = solution.problem
    net, near, far = _segments(solution)
    points = [_centres(problem, gcells).tolist() for gcells in (near, far)]
    texts = [
        f"({x1},{y1},{l1})-({x2},{y2},{l2})\n"
        for (x1, y1, l1), (x2, y2, l2) in zip(*points, strict=True)
    ]
    bounds = np.searchsorted(net, np.arange(len(problem.nets) + 1)).tolist()
    blocks = [
        f"{net.name} {net.id} {end - start}\n{''.join(texts[start:end])}!\n"
        for net, start, end in zip(problem.nets, bounds, bounds[1:], strict=False)
    ]
    write_text(path, "".join(blocks))


class _Lines:
    """The lines of a text file as tokens; ``number`` is the line last read, from 1."""

    def __init__(self, file: BinaryIO) -> None:
        self.number = 0
        self._file = file

    def next(self) -> list[str]:
        """The tokens of the next line that has any; none at the end of the file."""
        for line in self._file:
            self.number += 1
            try:
                tokens = line.decode().split()
            except UnicodeDecodeError:
                raise InputError("expected UTF-8 text") from None
            if tokens:
                return tokens
        return []


@contextlib.contextmanager
def _reading(path: str | os.PathLike[str]) -> Iterator[_Lines]:
    """Opens a file; an InputError raised in the block gets the file and the current line."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 (PathLike without Path)
            lines = _Lines(file)
            try:
                yield lines
            except InputError as error:
                # Names of nets go into messages before anybody has looked at them.
                text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(error))
                raise InputError(f"{os.fspath(path)}:{max(1, lines.number)}: {text}") from None
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None


def _unexpected(expected: str, tokens: list[str]) -> InputError:
    """The error for a line that is not what was expected; quotes the line, cut short."""
    if not tokens:
        return InputError(f"expected {expected}, found the end of the file")
    found = " ".join(tokens[:10])
    found = found if len(found) <= 60 else f"{found[:57]}..."
    return InputError(f"expected {expected}, found {found!r}")


def _read_header(
    lines: _Lines, where: dict[str, "array[int]"]
) -> tuple[_Form, dict[str, tuple[Any, ...]]]:
    """Reads the lines before ``num net``; notes those of the fields.

    Returns:
        The format, and the fields of the Problem that it has in the header or not at all.
    """
    forms = list(_FORMS.values())
    values: dict[str, tuple[Any, ...]] = {}
    row = 0
    # After the first row the formats that are left have headers of one length.
    while row < len(forms[0].header):
        tokens = lines.next()
        fitting = [form for form in forms if form.header[row].numbers(tokens)]
        if not fitting:
            expected = dict.fromkeys(form.header[row].expected for form in forms)
            raise _unexpected(", or ".join(expected), tokens)
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


def _unheld(problem: Problem, form: _Form) -> Iterator[str]:
    """What a format cannot say of a problem: what it would be read as, and what it is."""
    layers = problem.grid[2]
    if form.header[0].count == 2 and layers != _LAYER:
        yield f"expected one layer, found {layers}"
    if "adjustments" in form.fixed and problem.adjustments:
        yield f"expected no adjustments, found {len(problem.adjustments)}"
    for name, value in form.fixed.items():
        if (found := getattr(problem, name)) != value:
            yield f"expected {name} {value}, found {found}"
    for net in problem.nets:
        if len(form.net) < 4 and net.min_width != _WIDTH:
            yield f"net {net.name}: expected minimum width {_WIDTH}, found {net.min_width}"
        for pin in net.pins:
            if len(form.pin) < 3 and pin.layer != _LAYER:
                yield f"net {net.name}: expected pins in layer {_LAYER}, found {tuple(pin)}"


def _read_nets(lines: _Lines, where: dict[str, "array[int]"], form: _Form) -> tuple[Net, ...]:
    """Reads ``num net`` and the nets; notes the lines of nets and pins."""
    tokens = lines.next()
    if not (numbers := _NUM_NET.numbers(tokens)):
        raise _unexpected(_NUM_NET.expected, tokens)
    (count,) = numbers
    if count < 1:
        raise InputError(f"expected at least one net, found {count}")
    where["nets"], where["pins"] = array("q"), array("q")
    nets: list[Net] = []
    while len(nets) < count:
        tokens = lines.next()
        if not tokens:
            raise InputError(f"file ends after {len(nets)} of {count} nets")
        if len(tokens) != len(form.net) or not all(map(_is_number, tokens[1:])):
            raise _unexpected(f"net {len(nets) + 1} of {count} ({', '.join(form.net)})", tokens)
        name, (id_, pin_count, width) = tokens[0], [*map(int, tokens[1:]), _WIDTH][:3]
        where["nets"].append(lines.number)
        pins: list[Pin] = []
        while len(pins) < pin_count:
            tokens = lines.next()
            if not tokens:
                raise InputError(f"file ends after {len(pins)} of {pin_count} pins of net {name}")
            if len(tokens) != len(form.pin) or not all(map(_is_number, tokens)):
                raise _unexpected(
                    f"pin {len(pins) + 1} of {pin_count} of net {name} ({', '.join(form.pin)})",
                    tokens,
                )
            pins.append(Pin(*[*map(int, tokens), _LAYER][:3]))
            where["pins"].append(lines.number)
        nets.append(Net(name, id_, tuple(pins), width))
    return tuple(nets)


def _read_adjustments(lines: _Lines, where: dict[str, "array[int]"]) -> tuple[Adjustment, ...]:
    """Reads the adjustments up to the end of the file; notes their lines."""
    where["adjustments"] = array("q")
    adjustments: list[Adjustment] = []
    tokens = lines.next()
    if not tokens:
        return ()
    if len(tokens) != 1 or not _is_number(tokens[0]) or int(tokens[0]) < 0:
        raise _unexpected("the number of adjusted capacities", tokens)
    count = int(tokens[0])
    while tokens := lines.next():
        if len(adjustments) == count:
            raise _unexpected(f"the end of the file after {count} adjustments", tokens)
        if len(tokens) != 7 or not all(map(_is_number, tokens)):
            raise _unexpected(
                f"adjustment {len(adjustments) + 1} of {count} "
                "(x, y, layer, x, y, layer, capacity)",
                tokens,
            )
        adjustments.append(Adjustment(*map(int, tokens)))
        where["adjustments"].append(lines.number)
    if len(adjustments) < count:
        raise InputError(f"file ends after {len(adjustments)} of {count} adjustments")
    return tuple(adjustments)


def _read_segments(
    lines: _Lines, problem: Problem
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Reads the blocks of a solution.

    Returns:
        For each segment its net (n,), its line (n,) and its two points (n, 2, 3) as written.
    """
    index = {net.name: i for i, net in enumerate(problem.nets)}
    nets, numbers, points = array("q"), array("q"), array("q")
    while header := lines.next():
        if len(header) not in (2, 3) or not all(map(_is_number, header[1:])):
            raise _unexpected("a net's name, id and (optional) number of segments", header)
        name, id_ = header[0], int(header[1])
        if name not in index:
            raise _unexpected("a net of the problem that no earlier block is of", header)
        net = index.pop(name)
        if id_ != problem.nets[net].id:
            raise InputError(f"net {name}: expected id {problem.nets[net].id}, found {id_}")
        while (tokens := lines.next()) != ["!"]:
            if not tokens:
                raise InputError(f"file ends inside net {name}, expected '!'")
            match = _segment(" ".join(tokens))
            if match is None:
                raise _unexpected("a segment '(x,y,layer)-(x,y,layer)' or '!'", tokens)
            nets.append(net)
            numbers.append(lines.number)
            points.extend(map(int, match.groups()))
    return (
        np.array(nets, np.int64),
        np.array(numbers, np.int64),
        np.array(points, np.int64).reshape(-1, 2, 3),
    )


def _runs(
    lines: _Lines, problem: Problem, numbers: NDArray[np.int64], ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """What the segments that end in ``ends`` (n, 2, 3) cover of the grid.

    Returns:
        For each segment the number of its first edge, the number of its edges, and its axis; (n,).

    Raises:
        InputError: an end is off the grid, or a segment is not straight.
    """
    gcells = problem.gcells(ends.reshape(-1, 3)).reshape(-1, 2)
    position = np.stack(np.unravel_index(gcells.clip(0), problem.grid), axis=-1)
    span = np.abs(position[:, 1] - position[:, 0])
    wrong = (gcells == OFF_GRID).any(axis=1) | (np.count_nonzero(span, axis=1) > 1)
    if wrong.any():
        row = int(wrong.argmax())
        lines.number = int(numbers[row])
        for point, gcell in zip(ends[row].tolist(), gcells[row], strict=True):
            if gcell == OFF_GRID:
                raise InputError(f"expected {problem.extent}, found {tuple(point)}")
        raise InputError("expected a segment along one axis, found a diagonal one")
    axis = span.argmax(axis=1)
    return AXES * gcells.min(axis=1) + axis, span.sum(axis=1), axis


def _segments(
    solution: Solution,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Joins the edges of each net into its longest straight segments.

    Returns:
        For each segment its net and the Gcells of its two ends, the lower one first; (n,),
        ordered by net, lower end and axis.
    """
    problem = solution.problem
    net, edge = solution.uses
    near, axis = np.divmod(edge, AXES)
    stride = problem.strides[axis]
    # Within a line of Gcells along the axis, edges that follow one another are neighbours. The
    # line is told by the Gcell at its start.
    position = np.stack(np.unravel_index(near, problem.grid), axis=1)
    along = position[np.arange(len(near)), axis]
    start = near - along * stride
    order = np.lexsort((along, start, axis, net))
    net, axis, near, start, along, stride = (
        column[order] for column in (net, axis, near, start, along, stride)
    )
    begins = np.ones(len(near), np.bool_)
    begins[1:] = (
        (np.diff(net) != 0) | (np.diff(axis) != 0) | (np.diff(start) != 0) | (np.diff(along) != 1)
    )
    ends = np.roll(begins, -1)
    first, last = np.flatnonzero(begins), np.flatnonzero(ends)
    canonical = np.lexsort((axis[first], near[first], net[first]))
    first, last = first[canonical], last[canonical]
    return net[first], near[first], near[last] + stride[last]


def _centres(problem: Problem, gcells: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 3) the points in the middle of Gcells (n,): chip coordinates, layer from 1."""
    points = np.stack(np.unravel_index(gcells, problem.grid), axis=1).astype(np.int64)
    tile = np.array(problem.tile)
    points[:, :2] = np.array(problem.origin) + points[:, :2] * tile + tile // 2
    points[:, 2] += 1
    return points
