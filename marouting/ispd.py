"""The text formats of the ISPD 2008 global routing contest: problems (``.gr``) and solutions.

Both are read line by line, as what the lines say: a header that promises more than follows costs
no memory. Tokens are separated by any white space, blank lines mean nothing, keywords are written
in any case. Whatever is wrong raises :class:`~marouting.errors.InputError` with one line that
names the file and the line. Written files have one form only, so that equal objects give equal
bytes.
"""

import contextlib
import os
import re
import warnings
from array import array
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.files import unusable, write_text
from marouting.grid import AXES, OFF_GRID
from marouting.problem import Adjustment, FieldError, Net, Pin, Problem
from marouting.solution import Solution

# Eighteen digits fit into 64 bits; the problem's own limits are far below.
_NUMBER = "[+-]?[0-9]{1,18}"
_POINT = rf"\( ?({_NUMBER}) ?, ?({_NUMBER}) ?, ?({_NUMBER}) ?\)"
_is_number = re.compile(_NUMBER).fullmatch
_segment = re.compile(f"{_POINT} ?- ?{_POINT}").fullmatch

_LAYER_HEADERS = {
    "vertical capacity": "vertical_capacity",
    "horizontal capacity": "horizontal_capacity",
    "minimum width": "min_width",
    "minimum spacing": "min_spacing",
    "via spacing": "via_spacing",
}


def read_problem(path: str | os.PathLike[str]) -> Problem:
    """Reads an ISPD 2008 ``.gr`` file.

    Args:
        path: the file. The count of adjustments at its end may be missing when there are none.

    Returns:
        The problem, in the units of the file.

    Raises:
        InputError: the file cannot be read, is not of this format, or contradicts itself.
    """
    with _reading(path) as lines:
        # The line of every row of every field: what rows may hold is judged by Problem alone.
        where: dict[str, array[int]] = {}

        grid = tuple(lines.keyed("grid", "columns, rows and layers", 3))
        where["grid"] = array("q", [lines.number])
        layers: dict[str, tuple[int, ...]] = {}
        for keyword, field in _LAYER_HEADERS.items():
            layers[field] = tuple(lines.keyed(keyword, "a number for each layer"))
            where[field] = array("q", [lines.number])
        x, y, *tile = lines.keyed("", "origin x and y, tile width and height", 4)
        where["origin"] = where["tile"] = array("q", [lines.number])
        nets = _read_nets(lines, where)
        adjustments = _read_adjustments(lines, where)
        try:
            return Problem(
                grid=(grid[0], grid[1], grid[2]),
                nets=nets,
                origin=(x, y),
                tile=(tile[0], tile[1]),
                adjustments=adjustments,
                **layers,
            )
        except FieldError as error:
            lines.number = where[error.field][error.row]
            raise


def write_problem(problem: Problem, path: str | os.PathLike[str]) -> None:
    """Writes a problem as ISPD 2008 ``.gr`` text, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    rows: list[tuple[object, ...]] = [("grid", *problem.grid)]
    rows += [(keyword, *getattr(problem, field)) for keyword, field in _LAYER_HEADERS.items()]
    rows += [(*problem.origin, *problem.tile), ("num net", len(problem.nets))]
    for net in problem.nets:
        rows.append((net.name, net.id, len(net.pins), net.min_width))
        rows += net.pins
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

    def keyed(self, keyword: str, what: str, count: int | None = None) -> list[int]:
        """The numbers of the next line: ``count`` of them, or one or more, after ``keyword``."""
        tokens = self.next()
        words = keyword.split()
        numbers = tokens[len(words) :]
        if (
            [token.lower() for token in tokens[: len(words)]] == words
            and all(map(_is_number, numbers))
            and (len(numbers) == count if count else numbers)
        ):
            return list(map(int, numbers))
        raise _unexpected(f"'{keyword}' and {what}" if keyword else what, tokens)


@contextlib.contextmanager
def _reading(path: str | os.PathLike[str]) -> Iterator[_Lines]:
    """Opens a file; an InputError raised in the block gets the file and the current line."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 (PathLike without Path)
            lines = _Lines(file)
            try:
                yield lines
            except InputError as error:
                raise InputError(f"{os.fspath(path)}:{max(1, lines.number)}: {error}") from None
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None


def _unexpected(expected: str, tokens: list[str]) -> InputError:
    """The error for a line that is not what was expected; quotes the line, cut short."""
    if not tokens:
        return InputError(f"expected {expected}, found the end of the file")
    found = " ".join(tokens[:10])
    found = found if len(found) <= 60 else f"{found[:57]}..."
    return InputError(f"expected {expected}, found {found!r}")


def _read_nets(lines: _Lines, where: dict[str, "array[int]"]) -> tuple[Net, ...]:
    """Reads ``num net`` and the nets; notes the lines of nets and pins."""
    (count,) = lines.keyed("num net", "their number", 1)
    if count < 1:
        raise InputError(f"expected at least one net, found {count}")
    where["nets"], where["pins"] = array("q"), array("q")
    nets: list[Net] = []
    while len(nets) < count:
        tokens = lines.next()
        if not tokens:
            raise InputError(f"file ends after {len(nets)} of {count} nets")
        if len(tokens) != 4 or not all(map(_is_number, tokens[1:])):
            raise _unexpected(
                f"net {len(nets) + 1} of {count} (name, id, number of pins, minimum width)", tokens
            )
        name, id_, pin_count, width = tokens[0], *map(int, tokens[1:])
        where["nets"].append(lines.number)
        pins: list[Pin] = []
        while len(pins) < pin_count:
            tokens = lines.next()
            if not tokens:
                raise InputError(f"file ends after {len(pins)} of {pin_count} pins of net {name}")
            if len(tokens) != 3 or not all(map(_is_number, tokens)):
                raise _unexpected(
                    f"pin {len(pins) + 1} of {pin_count} of net {name} (x, y, layer)", tokens
                )
            pins.append(Pin(*map(int, tokens)))
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
