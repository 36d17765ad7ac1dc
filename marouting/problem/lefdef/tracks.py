"""Tracks, what blocks them, and the capacity that is left."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import check_memory
from marouting.problem.lefdef.texts import Tracks

_MOST = 2**20
"""The most tracks of a layer, and lines between Gcells."""

_PIECE = 100
"""Bytes for each piece of a track that a box blocks, while all are merged."""


def places(tracks: Sequence[Tracks], low: int, high: int, file: str) -> NDArray[np.int64]:
    """Where tracks or lines are, ascending, each once; only those in ``low < place < high``.

    Raises:
        InputError: there are too many.
    """
    parts = [np.empty(0, np.int64)]
    for _, first, count, step, _, line in tracks:
        begin = max(0, (low - first) // step + 1)
        end = min(count, -((first - high) // step))
        if end - begin > _MOST:
            raise InputError(
                f"{file}:{line}: expected at most {_MOST} tracks or lines on the die, "
                f"found {end - begin}"
            )
        place = first + step * np.arange(begin, max(begin, end), dtype=np.int64)
        parts.append(place[(place > low) & (place < high)])
    return np.unique(np.concatenate(parts))


def capacity_of_layer(
    tracks: NDArray[np.int64],
    along: NDArray[np.int64],
    across: NDArray[np.int64],
    boxes: NDArray[np.int64],
    halo: int,
) -> NDArray[np.int64]:
    """The capacity of every edge of a layer, in whole tracks.

    Args:
        tracks: (tracks,) their places, ascending.
        along: (n + 1,) the lines between Gcells that wires cross.
        across: (m + 1,) the other lines.
        boxes: (k, 4) what wires must avoid: the low and high sides along the wires, then across.
        halo: twice the distance from a box that a wire's middle must keep, which is legal itself.

    Returns:
        (n, m) of the edge from each Gcell to the next one along the wires; 0 for the last.
    """
    columns, rows = len(along) - 1, len(across) - 1
    capacity = np.zeros((columns, rows), np.int64)
    if columns < 2:
        return capacity
    # Twice all places, so that the middles of Gcells and wires are whole numbers.
    middle = along[:-1] + along[1:]
    place = 2 * tracks
    row = np.searchsorted(across, tracks, "right") - 1
    low, high = (2 * boxes[:, [0, 2]] - halo).T, (2 * boxes[:, [1, 3]] + halo).T
    begin = low[0].clip(middle[0], middle[-1]) - middle[0]
    end = high[0].clip(middle[0], middle[-1]) - middle[0]
    first = np.searchsorted(place, low[1], "right")
    last = np.searchsorted(place, high[1], "left")
    count = np.where(end > begin, np.maximum(last - first, 0), 0)
    pieces = int(count.sum())
    check_memory(_PIECE * pieces, "{} blocked pieces of tracks", pieces)
    box = np.repeat(np.arange(len(boxes)), count)
    track = first[box] + np.arange(pieces) - np.repeat(np.cumsum(count) - count, count)
    # Pieces of one track that touch become one. All tracks lie on one line, one after another.
    span = int(middle[-1] - middle[0]) + 1
    begin, end = track * span + begin[box], track * span + end[box]
    order = np.argsort(begin, kind="stable")
    begin, end = begin[order], np.maximum.accumulate(end[order])
    new = np.ones(pieces, np.bool_)
    new[1:] = begin[1:] > end[:-1]
    begin, end = begin[new], end[np.roll(new, -1)]
    track = begin // span
    begin, end = begin - track * span + middle[0], end - track * span + middle[0]
    # And each is cut at the middles of Gcells.
    first = np.searchsorted(middle, begin, "right") - 1
    last = np.searchsorted(middle, end, "left") - 1
    count = last - first + 1
    piece = np.repeat(np.arange(len(begin)), count)
    edge = first[piece] + np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)
    length = np.minimum(end[piece], middle[edge + 1]) - np.maximum(begin[piece], middle[edge])
    blocked = np.zeros((columns - 1, rows), np.int64)
    np.add.at(blocked, (edge, row[track[piece]]), length)
    whole = np.bincount(row, minlength=rows)[None] * np.diff(middle)[:, None]
    capacity[:-1] = (whole - blocked) // np.diff(middle)[:, None]
    return capacity
