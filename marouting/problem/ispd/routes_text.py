"""Routes as text, a net's lines between parentheses: routing guides and ISPD 2024's output.

::

    net1                                net1
    (                                   (
    330000 51300 336000 57000 Metal1    2 2 3 3 2 3
    )                                   )

The left one is the routing guide of the ISPD 2018 and 2019 contests: boxes ``xlo ylo xhi yhi`` in
chip coordinates and the name of their layer. The right one is the output of the ISPD 2024 contest:
segments ``x y layer x y layer`` in Gcells, counted from 0. Its first form was that of guides, with
columns and rows in place of coordinates.
"""

import os
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError, nearest
from marouting.files import write_text
from marouting.problem.ispd.lines import Lines, Record, is_number, unexpected


@dataclass(frozen=True)
class RoutesRecord(Record):
    """The lines of such a file, either boxes or segments.

    Attributes:
        net: (n,) int64, the index of the net of each line.
        boxes: (n, 5) int64, lower left and upper right corner and the layer, from 0; none in a
            file of segments.
        segments: (n, 2, 3) int64, the ends of each segment: column, row, layer; none in a file of
            boxes.
        lines: for ``"segments"`` the line of each box or segment.
    """

    net: NDArray[np.int64]
    boxes: NDArray[np.int64]
    segments: NDArray[np.int64]


def read_routes(
    lines: Lines,
    file: str,
    header: list[str],
    nets: Iterable[str],
    layers: Sequence[str],
) -> RoutesRecord:
    """Reads a file whose first line has been read already.

    Args:
        lines: the rest of the file.
        file: its name.
        header: its first line.
        nets: the names of the problem's nets, in order.
        layers: the names of its layers, lowest first.

    Raises:
        InputError: the file is not of this form, has a net twice, or names an unknown net or layer.
    """
    known = {name: index for index, name in enumerate(nets)}
    level = {name: index for index, name in enumerate(layers)}
    net, numbers, values = array("q"), array("q"), array("q")
    width = 0  # of all lines between parentheses, once the first is read
    while header:
        if len(header) != 1 or header[0] not in known:
            raise unexpected("a net of the problem that no earlier block is of", header)
        name = header[0]
        index = known.pop(name)
        if (tokens := lines.next()) != ["("]:
            raise unexpected(f"'(' after the name of net {name}", tokens)
        while (tokens := lines.next()) != [")"]:
            if not tokens:
                raise InputError(f"file ends inside net {name}, expected ')'")
            width = width or len(tokens)
            box = width == 5
            if width not in (5, 6) or len(tokens) != width:
                raise unexpected(_EXPECTED[width if width in (5, 6) else 0], tokens)
            if not all(map(is_number, tokens[: width - box])):
                raise unexpected(_EXPECTED[width], tokens)
            values.extend(map(int, tokens[: width - box]))
            if box:
                if tokens[4] not in level:
                    raise InputError(
                        f"layer {tokens[4]}: {nearest(tokens[4], level)}expected a layer of the "
                        f"problem: {', '.join(layers)}"
                    )
                values.append(level[tokens[4]])
            net.append(index)
            numbers.append(lines.number)
        header = lines.next()
    table = np.frombuffer(values, np.int64)
    return RoutesRecord(
        file,
        {"segments": numbers},
        np.frombuffer(net, np.int64),
        table[: len(table) * (width == 5)].reshape(-1, 5),
        table[: len(table) * (width != 5)].reshape(-1, 2, 3),
    )


_EXPECTED = {
    0: "a box 'x y x y layer', a segment 'x y layer x y layer' or ')'",
    5: "a box 'x y x y layer' or ')'",
    6: "a segment 'x y layer x y layer' or ')'",
}


def write_routes(
    path: str | os.PathLike[str],
    nets: Sequence[str],
    net: NDArray[np.int64],
    rows: Sequence[str],
) -> None:
    """Writes such a file, whole or not at all.

    Args:
        path: the file.
        nets: names; each gets a block, in this order.
        net: (n,) the index of each row's net, ascending.
        rows: n lines without their ends.

    Raises:
        InputError: the file cannot be written.
    """
    bounds = np.searchsorted(net, np.arange(len(nets) + 1)).tolist()
    blocks = [
        "".join(f"{line}\n" for line in (name, "(", *rows[start:end], ")"))
        for name, start, end in zip(nets, bounds, bounds[1:], strict=False)
    ]
    write_text(path, "".join(blocks))
