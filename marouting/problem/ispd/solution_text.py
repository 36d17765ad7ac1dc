"""Solutions as text: each net's route as straight segments."""

import os
import re
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
    """The segments of a solution file.

    Attributes:
        net: (n,) int64, the index of each segment's net.
        points: (n, 2, 3) int64, the two ends of each segment as written: x and y in chip
            coordinates, layer from 1. Nothing is known of where they lie.
        lines: for ``"segments"`` the line of each segment.
    """

    net: NDArray[np.int64]
    points: NDArray[np.int64]


def read_solution(
    path: str | os.PathLike[str], nets: Iterable[tuple[str, int]], layers: Sequence[str] = ()
) -> SolutionRecord | RoutesRecord:
    """Reads routes in any of the formats.

    A first line of one word is a net's name, with which the formats of
    :mod:`~marouting.problem.ispd.routes_text` begin; all others are ISPD solution text. A net
    without a block has no segments.

    Args:
        path: the file.
        nets: name and id of each of the problem's nets; names are unique.
        layers: names of the layers, lowest first.

    Returns:
        The segments or boxes in file order.

    Raises:
        InputError: the file cannot be read, is not of this format, or names a net twice, an
            unknown net, or a net with another id.
    """
    ids: list[int] = []
    known: dict[str, int] = {}
    for index, (name, id_) in enumerate(nets):
        known[name] = index
        ids.append(id_)
    net, numbers, points = array("q"), array("q"), array("q")
    with reading(path) as lines:
        header = lines.next()
        if len(header) == 1:
            return read_routes(lines, os.fspath(path), header, known, layers)
        while header:
            if len(header) not in (2, 3) or not all(map(is_number, header[1:])):
                raise unexpected("a net's name, id and (optional) number of segments", header)
            name, found = header[0], int(header[1])
            if name not in known:
                raise unexpected("a net of the problem that no earlier block is of", header)
            index = known.pop(name)
            if found != ids[index]:
                raise InputError(f"net {name}: expected id {ids[index]}, found {found}")
            while (tokens := lines.next()) != ["!"]:
                if not tokens:
                    raise InputError(f"file ends inside net {name}, expected '!'")
                match = _segment(" ".join(tokens))
                if match is None:
                    raise unexpected("a segment '(x,y,layer)-(x,y,layer)' or '!'", tokens)
                net.append(index)
                numbers.append(lines.number)
                points.extend(map(int, match.groups()))
            header = lines.next()
    return SolutionRecord(
        os.fspath(path),
        {"segments": numbers},
        np.frombuffer(net, np.int64),
        np.frombuffer(points, np.int64).reshape(-1, 2, 3),
    )


def write_solution(
    path: str | os.PathLike[str],
    nets: Sequence[tuple[str, int]],
    net: NDArray[np.int64],
    points: NDArray[np.int64],
) -> None:
    """Writes segments as ISPD solution text, whole or not at all.

    Args:
        path: the file.
        nets: name and id of each of the problem's nets; each gets a block, in this order.
        net: (n,) the index of each segment's net, ascending.
        points: (n, 2, 3) the two ends of each segment: x and y in chip coordinates, layer from 1.

    Raises:
        InputError: the file cannot be written.
    """
    texts = [
        f"({x1},{y1},{l1})-({x2},{y2},{l2})\n" for (x1, y1, l1), (x2, y2, l2) in points.tolist()
    ]
    bounds = np.searchsorted(net, np.arange(len(nets) + 1)).tolist()
    blocks = [
        f"{name} {id_} {end - start}\n{''.join(texts[start:end])}!\n"
        for (name, id_), start, end in zip(nets, bounds, bounds[1:], strict=False)
    ]
    write_text(path, "".join(blocks))
