"""Routes as text, a net's lines between parentheses: guides, segments, and ISPD 2024's output.

::

    net1                              net1                                 net1
    (                                 (                                    (
    330000 51300 336000 57000 met1    3600 205200 met3 9900 205200 met3    2 2 3 3 2 3
    )                                 )                                    )

The left one is the routing guide of the ISPD 2018 and 2019 contests: boxes ``xlo ylo xhi yhi`` in
chip coordinates and the name of their layer. The middle one is what OpenROAD's
``write_global_route_segments`` writes, which is also the output of the ISPD 2025 contest: segments
``x y layer x y layer`` in chip coordinates, anywhere inside their Gcells, with names of layers. The
right one is the output of the ISPD 2024 contest: the same in Gcells, counted from 0, with numbers
of layers. Its first form was that of guides, with columns and rows in place of coordinates.
"""

import os
import re
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError, nearest
from marouting.files import write_text
from marouting.problem.ispd.lines import NUMBER, Lines, Record, unexpected


@dataclass(frozen=True)
class RoutesRecord(Record):
    """Lines of one form, which ``lines`` has as ``"segments"``; the other two arrays are empty."""

    net: NDArray[np.int64]  # (n,) int64, the index of the net of each line
    boxes: NDArray[np.int64]  # (n, 5) int64, lower left and upper right corner, layer from 0
    points: NDArray[np.int64]  # (n, 2, 3) int64, OpenROAD's ends: x, y of the chip, layer from 0
    segments: NDArray[np.int64]  # (n, 2, 3) int64, ISPD 2024's ends: column, row, layer


def read_routes(
    lines: Lines, file: str, header: list[str], nets: Iterable[str], layers: Sequence[str]
) -> RoutesRecord:
    """Reads a file whose first line has been read already."""
    known = {name: index for index, name in enumerate(nets)}
    level = {name: str(index) for index, name in enumerate(layers)}
    net, numbers, values = array("q"), array("q"), array("q")
    form: _Form | None = None  # of all lines between parentheses, once the first is read
    while header:
        if len(header) != 1 or header[0] not in known:
            raise unexpected("a net of the problem that is not listed above", header)
        name = header[0]
        index = known.pop(name)
        if (tokens := lines.next()) != ["("]:
            raise unexpected(f"'(' after the name of net {name}", tokens)
        while (text := lines.text()) != ")":
            if not text:
                raise InputError(f"file ends inside net {name}, expected ')'")
            form = form or next((form for form in _FORMS if form.fits(text)), None)
            if form is None:
                raise unexpected(f"{', '.join(map(str, _FORMS))} or ')'", text.split(" "))
            if (match := form.fits(text)) is None:
                raise unexpected(f"{form} or ')'", text.split(" "))
            tokens = list(match.groups())
            for place in form.names:
                if (layer := tokens[place]) not in level:
                    raise InputError(
                        f"layer {layer}: {nearest(layer, level)}expected a layer of the "
                        f"problem: {', '.join(layers)}"
                    )
                tokens[place] = level[layer]
            values.extend(map(int, tokens))
            net.append(index)
            numbers.append(lines.number)
        header = lines.next()
    table = np.frombuffer(values, np.int64)
    boxes, points, segments = (
        table if form is own else table[:0] for own in (_BOX, _NAMED, _NUMBERED)
    )
    return RoutesRecord(
        file,
        {"segments": numbers},
        np.frombuffer(net, np.int64),
        boxes.reshape(-1, 5),
        points.reshape(-1, 2, 3),
        segments.reshape(-1, 2, 3),
    )


class _Form(NamedTuple):
    """What lines between parentheses hold."""

    what: str
    fits: Callable[[str], re.Match[str] | None]
    names: tuple[int, ...] = ()  # which tokens are names of layers; all others are numbers

    def __str__(self) -> str:
        return self.what


def _line(*tokens: str) -> Callable[[str], re.Match[str] | None]:
    return re.compile(" ".join(f"({token})" for token in tokens)).fullmatch


_N, _NAME = NUMBER, "[^ ]+"
_BOX = _Form("a box 'x y x y layer'", _line(_N, _N, _N, _N, _NAME), (4,))
_NUMBERED = _Form("a segment 'x y layer x y layer'", _line(_N, _N, _N, _N, _N, _N))
_NAMED = _Form(
    "a segment 'x y layer x y layer' with names of layers",
    _line(_N, _N, _NAME, _N, _N, _NAME),
    (2, 5),
)
_FORMS = (_BOX, _NUMBERED, _NAMED)
"""The forms; a line is of the first that it fits, since a layer may be called by a number."""


def write_routes(
    path: str | os.PathLike[str], nets: Sequence[str], net: NDArray[np.int64], rows: Sequence[str]
) -> None:
    """Writes such a file, with a block for each name of ``nets`` and a row for each of ``net``."""
    bounds = np.searchsorted(net, np.arange(len(nets) + 1)).tolist()
    blocks = [
        "".join(f"{line}\n" for line in (name, "(", *rows[start:end], ")"))
        for name, start, end in zip(nets, bounds, bounds[1:], strict=False)
    ]
    write_text(path, "".join(blocks))
