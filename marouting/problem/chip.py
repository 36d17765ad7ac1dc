"""Data of a chip's files that the game does not use, but that routers and writing routes need.

A problem counts Gcells and layers. Routing guides name layers and give boxes in chip coordinates,
wires run along one axis in each layer, and the ISPD 2024 contest has a cost of its own.
:class:`Chip` keeps what is needed for these.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import ADJUSTMENT, check_memory
from marouting.problem.grid import VIA_AXIS
from marouting.problem.net import Adjustment


@dataclass(frozen=True, eq=False)
class Contest:
    """The costs of a problem of the ISPD 2024 contest, as its ``.cap`` and ``.net`` files say."""

    wire_cost: float  # of a wire one unit long
    via_cost: float  # of a via
    overflow_cost: NDArray[np.float64]  # (Z,) by which the overflow of each layer is weighted
    x_length: NDArray[np.float64]  # (X - 1,) length of the edges from each column to the next
    y_length: NDArray[np.float64]  # (Y - 1,) length of the edges from each row to the next
    capacity: NDArray[np.float64]  # (X, Y, Z) of every Gcell, in tracks, which need not be whole
    left: NDArray[np.float64]  # (X, Y, Z) what controls leave of it to routers
    axis: NDArray[np.int64]  # (Z,) 0 for a horizontal layer, 1 for a vertical one


class Places(NamedTuple):
    """The Gcells by which pins can be reached; a route needs one of each pin."""

    first_pin: NDArray[np.int64]  # (nets + 1,) net i has ``first_pin[i]`` to ``first_pin[i + 1]``
    first: NDArray[np.int64]  # (pins + 1,) likewise the places of each pin
    gcell: NDArray[np.int64]  # (places,) Gcell numbers

    def of_nets(self, nets: NDArray[np.int64]) -> "Places":
        """The places of the pins of some nets (k,), ascending."""
        owner = np.repeat(np.arange(len(self.first_pin) - 1), np.diff(self.first_pin))
        pins = np.flatnonzero(np.isin(owner, nets))
        pin = np.repeat(np.arange(len(owner)), np.diff(self.first))
        sizes = [np.diff(self.first_pin)[nets], np.diff(self.first)[pins]]
        first_pin, first = (np.concatenate(([0], np.cumsum(size))) for size in sizes)
        return Places(first_pin, first, self.gcell[np.isin(pin, pins)])


@dataclass(frozen=True, eq=False)
class Chip:
    """Names and places that a problem's Gcells and layers have in its files."""

    layers: tuple[str, ...]  # Z names, lowest layer first
    x: NDArray[np.int64]  # (X + 1,) int64, ascending: the lines between columns of Gcells
    y: NDArray[np.int64]  # (Y + 1,) int64, likewise between rows
    wires: NDArray[np.bool_]  # (Z, 2) bool, whether wires of each layer may go along x and along y
    places: Places | None = None  # where pins can be reached; None: only where the problem has them
    contest: Contest | None = None  # of a problem of the ISPD 2024 contest
    clock: NDArray[np.bool_] | None = None  # (nets,) whether the files call a net a clock; None: no
    only_pins: bool = False  # whether the tracks of the lowest layer were left out

    def __post_init__(self) -> None:
        wires = np.asarray(self.wires)
        if wires.shape != (len(self.layers), VIA_AXIS) or not np.isin(wires, (0, 1)).all():
            raise InputError(
                f"wires: expected two booleans for each of {len(self.layers)} layers, found {wires}"
            )
        object.__setattr__(self, "wires", wires.astype(np.bool_))

    def on_chip(self, box: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n, 4) int64, the parts of boxes that lie on the chip; empty boxes where none does.

        Args:
            box: (n, 4) int64, left, lower, right and upper sides in chip coordinates.
        """
        low, high = (np.array([self.x[end], self.y[end]] * 2) for end in (0, -1))
        return box.clip(low, high)


class Capacities(NamedTuple):
    """Fields of a problem: one number a layer, and the edges that differ."""

    vertical_capacity: tuple[int, ...]
    horizontal_capacity: tuple[int, ...]
    adjustments: tuple[Adjustment, ...]


def as_adjustments(
    capacity: NDArray[np.int64], axis: NDArray[np.int64], wires: NDArray[np.bool_]
) -> Capacities:
    """The fields for edges (X, Y, Z) along each layer's axis that have a capacity of their own.

    A layer's number is the commonest of its edges' capacities; the edges that differ are adjusted.
    Layers without wires have no capacity.
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
