"""What a chip's files say that the game has no use for, and that routes are written back with.

A problem counts Gcells and layers. Routing guides name layers and give boxes in chip coordinates;
the ISPD 2024 contest has a cost of its own. :class:`Chip` keeps what is needed for these.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.memory import ADJUSTMENT, check_memory
from marouting.problem.net import Adjustment


@dataclass(frozen=True, eq=False)
class Contest:
    """The costs of a problem of the ISPD 2024 contest, as its ``.cap`` and ``.net`` files say.

    Attributes:
        wire_cost: of a wire one unit long.
        via_cost: of a via.
        overflow_cost: (Z,) by which the overflow of each layer is weighted.
        x_length: (X - 1,) length of the edges from each column to the next.
        y_length: (Y - 1,) length of the edges from each row to the next.
        capacity: (X, Y, Z) of every Gcell, in tracks, which need not be whole.
        axis: (Z,) 0 for a horizontal layer, 1 for a vertical one.
    """

    wire_cost: float
    via_cost: float
    overflow_cost: NDArray[np.float64]
    x_length: NDArray[np.float64]
    y_length: NDArray[np.float64]
    capacity: NDArray[np.float64]
    axis: NDArray[np.int64]


class Places(NamedTuple):
    """The Gcells by which pins can be reached; a route needs one of each pin.

    Attributes:
        first_pin: (nets + 1,) the pins of net i are ``first_pin[i]`` to ``first_pin[i + 1]``.
        first: (pins + 1,) likewise the places of each pin.
        gcell: (places,) Gcell numbers.
    """

    first_pin: NDArray[np.int64]
    first: NDArray[np.int64]
    gcell: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Chip:
    """Names and places that a problem's Gcells and layers have in its files.

    Attributes:
        layers: Z names, lowest layer first.
        x: (X + 1,) int64, ascending: column i of Gcells lies between ``x[i]`` and ``x[i + 1]``.
        y: (Y + 1,) int64, likewise for rows.
        wires: (Z, 2) bool, whether wires of each layer may go along x and along y.
        places: where pins can be reached; None: in the Gcell that the problem has them in.
        contest: the costs of the ISPD 2024 contest, if the problem is one of its.
    """

    layers: tuple[str, ...]
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    wires: NDArray[np.bool_]
    places: Places | None = None
    contest: Contest | None = None


class Capacities(NamedTuple):
    """Fields of a problem: one number a layer, and the edges that differ."""

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
