"""Capacities of single edges as a problem holds them: one number a layer, and adjustments."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.memory import ADJUSTMENT, check_memory
from marouting.problem.net import Adjustment


class Capacities(NamedTuple):
    """Fields of a problem."""

    vertical_capacity: tuple[int, ...]
    horizontal_capacity: tuple[int, ...]
    adjustments: tuple[Adjustment, ...]


def as_adjustments(
    capacity: NDArray[np.int64], axis: NDArray[np.int64], wires: NDArray[np.bool_]
) -> Capacities:
    """The fields for edges that each have a capacity of their own.

    A layer's number is the commonest of its edges' capacities; the edges that differ are adjusted.

    Args:
        capacity: (X, Y, Z) of the edge from each Gcell to the next one along its layer's axis.
        axis: (Z,) 0 or 1, the direction of each layer's wires.
        wires: (Z,) whether a layer has wires at all; the others have no capacity.
    """
    layers = capacity.shape[2]
    usual = np.zeros((2, layers), np.int64)
    rows: list[NDArray[np.int64]] = []
    for z in np.flatnonzero(wires).tolist():
        own = capacity[:-1, :, z] if axis[z] == 0 else capacity[:, :-1, z]
        if not own.size:
            continue
        values, counts = np.unique(own, return_counts=True)
        usual[axis[z], z] = values[counts.argmax()]
        x, y = np.nonzero(own != usual[axis[z], z])
        far = np.stack((x + (axis[z] == 0), y + (axis[z] == 1)), axis=1)
        layer = np.full(len(x), z + 1)
        rows.append(np.column_stack((x, y, layer, far, layer, own[x, y])))
    table = np.concatenate(rows) if rows else np.empty((0, 7), np.int64)
    check_memory(ADJUSTMENT * len(table), "{} edges with a capacity of their own", len(table))
    adjustments = tuple(map(Adjustment._make, table.tolist()))
    return Capacities(tuple(usual[1].tolist()), tuple(usual[0].tolist()), adjustments)
