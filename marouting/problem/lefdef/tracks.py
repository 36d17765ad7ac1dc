"""Tracks, what blocks them, and the capacity that is left."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import check_memory
from marouting.problem.lefdef.def_text import Tracks

_MOST = 2**20  # the most tracks of a layer, and lines between Gcells
_CELL = 24  # bytes for each track between two Gcells, while it is found out whether it is free


def places(tracks: Sequence[Tracks], low: int, high: int, file: str) -> NDArray[np.int64]:
    """Where tracks or lines are, ascending, each once; only those in ``low < place < high``."""
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
    halo: NDArray[np.int64],
) -> NDArray[np.int64]:
    """The capacity of every edge of a layer: the tracks that are free from middle to middle.

    Args:
        tracks: (tracks,) their places, ascending.
        along: (n + 1,) the lines between Gcells that wires cross.
        across: (m + 1,) the other lines.
        boxes: (k, 4) what wires must avoid: the low and high sides along the wires, then across.
        halo: (k,) twice the distance from each box that a wire's middle must keep.

    Returns:
        (n, m) of the edge from each Gcell to the next one along the wires; 0 for the last.
    """
    columns, rows = len(along) - 1, len(across) - 1
    capacity = np.zeros((columns, rows), np.int64)
    if columns < 2:
        return capacity
    # Twice all places, so that the middles of Gcells and wires are whole numbers.
    middle = along[:-1] + along[1:]
    low, high = 2 * boxes[:, [0, 2]].T - halo, 2 * boxes[:, [1, 3]].T + halo
    check_memory(_CELL * (columns - 1) * len(tracks), "{} tracks", len(tracks))
    # Every box raises a rectangle of edges and tracks; these are the corners of its steps.
    steps = np.zeros((columns, len(tracks) + 1), np.int32)
    first = (np.searchsorted(middle, low[0], "right") - 1).clip(0, columns - 1)
    last = np.searchsorted(middle, high[0], "left").clip(0, columns - 1)
    lowest = np.searchsorted(2 * tracks, low[1], "right")
    highest = np.searchsorted(2 * tracks, high[1], "left")
    real = (first < last) & (lowest < highest)
    first, last, lowest, highest = (at[real] for at in (first, last, lowest, highest))
    for edge, track, step in (
        (first, lowest, 1),
        (first, highest, -1),
        (last, lowest, -1),
        (last, highest, 1),
    ):
        np.add.at(steps, (edge, track), step)
    free = steps.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] == 0
    row = np.searchsorted(across, tracks, "right") - 1
    for edge in range(columns - 1):
        capacity[edge] = np.bincount(row[free[edge]], minlength=rows)
    return capacity
