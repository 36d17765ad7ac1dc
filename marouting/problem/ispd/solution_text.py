"""Solutions as text: each net's route as straight segments."""

import os
import re
import warnings
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.files import write_text
from marouting.problem.ispd.lines import NUMBER, Record, is_number, reading, unexpected
from marouting.problem.ispd.routes_text import RoutesRecord, read_routes

_POINT = rf"\( ?({NUMBER}) ?, ?({NUMBER}) ?, ?({NUMBER}) ?\)"
_segment = re.compile(f"{_POINT} ?- ?{_POINT}").fullmatch


@dataclass(frozen=True)
class SolutionRecord(Record):
    """The segments of a solution file, which ``lines`` has as ``"segments"``, as written."""

    net: NDArray[np.int64]  # (n,) int64, the index of each segment's net
    points: NDArray[np.int64]  # (n, 2, 3) int64, both ends: x, y of the chip, layer from 1


def read_solution(
    path: str | os.PathLike[str], nets: Iterable[tuple[str, int]], layers: Sequence[str] = ()
) -> SolutionRecord | RoutesRecord:
    """Reads routes in any of the formats, for nets by name and id, in file order.

    A first line of one word is a net's name, with which the formats of
    :mod:`~marouting.problem.ispd.routes_text` begin; all others are ISPD solution text. A net
    without a block has no segments.

    As in the contest's evaluator, nets are told by their names. An id that is not the problem's
    (NTHU-Route numbers the nets anew) and a number of segments that is not that of the block are
    no errors: some routers do not count, and the solutions that Liao et al. published have wrong
    numbers in most of their blocks. But a number can show that a line is lost, so there is one
    ``UserWarning`` for all wrong ids of a file and one for all wrong numbers.
    """
    ids: list[int] = []
    known: dict[str, int] = {}
    for index, (name, id_) in enumerate(nets):
        known[name] = index
        ids.append(id_)
    net, numbers, points = array("q"), array("q"), array("q")
    other_ids, other_counts = _Differences(path), _Differences(path)
    with reading(path) as lines:
        header = lines.next()
        if len(header) == 1:
            return read_routes(lines, os.fspath(path), header, known, layers)
        while header:
            if len(header) not in (2, 3) or not all(map(is_number, header[1:])):
                raise unexpected("a net's name, id and (optional) number of segments", header)
            name, (found, *count), at = header[0], map(int, header[1:]), lines.number
            if name not in known:
                raise unexpected("a net of the problem that is not listed above", header)
            index = known.pop(name)
            if found != ids[index]:
                other_ids.add(at, f"net {name}: expected id {ids[index]}, found {found}")
            before = len(net)
            while (text := lines.text()) != "!":
                if not text:
                    raise InputError(f"file ends inside net {name}, expected '!'")
                match = _segment(text)
                if match is None:
                    raise unexpected("a segment '(x,y,layer)-(x,y,layer)' or '!'", text.split(" "))
                net.append(index)
                numbers.append(lines.number)
                points.extend(map(int, match.groups()))
            listed = len(net) - before
            if count and count[0] != listed:
                what = f"expected {count[0]} segments, as this line says, found {listed}"
                other_counts.add(at, f"net {name}: {what}")
            header = lines.next()
    other_ids.warn("the id is ignored; the name decides")
    other_counts.warn("the listed segments are used; the file may be incomplete")
    return SolutionRecord(
        os.fspath(path),
        {"segments": numbers},
        np.frombuffer(net, np.int64),
        np.frombuffer(points, np.int64).reshape(-1, 2, 3),
    )


class _Differences:
    """Inconsistencies in the file at a path, reported in one warning."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path, self._first, self._count = os.fspath(path), "", 0

    def add(self, line: int, what: str) -> None:
        """Notes a difference in a line."""
        self._first = self._first or f"{self._path}:{line}: {what}"
        self._count += 1

    def warn(self, outcome: str) -> None:
        """Warns of all of them, if there are any: of the first one, and how many there are."""
        if self._count:
            more = f" ({self._count} such nets in this file)" if self._count > 1 else ""
            warnings.warn(f"{self._first}{more}: {outcome}", stacklevel=5)


def write_solution(
    path: str | os.PathLike[str],
    nets: Sequence[tuple[str, int]],
    net: NDArray[np.int64],
    points: NDArray[np.int64],
) -> None:
    """Writes the segments (n, 2, 3) of nets (n,), ascending, as ISPD solution text."""
    texts = [
        f"({x1},{y1},{l1})-({x2},{y2},{l2})\n"
        for x1, y1, l1, x2, y2, l2 in zip(*points.reshape(-1, 6).T.tolist(), strict=True)
    ]
    bounds = np.searchsorted(net, np.arange(len(nets) + 1)).tolist()
    blocks = [
        f"{name} {id_} {end - start}\n{''.join(texts[start:end])}!\n"
        for (name, id_), start, end in zip(nets, bounds, bounds[1:], strict=False)
    ]
    write_text(path, "".join(blocks))
