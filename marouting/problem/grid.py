"""The grid of Gcells: how Gcells and edges are numbered, and which are neighbours.

The Gcells of an X×Y×Z grid are numbered ``(x * Y + y) * Z + z``. Every Gcell owns the three edges
towards its +x, +y and +z neighbours: edge ``3 * gcell + axis`` joins ``gcell`` to its neighbour
along ``axis`` (0 = x, 1 = y, 2 = z, a via). At the far border such edges would lead off the grid:
their numbers exist, the edges do not.
"""

import enum
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from marouting.memory import check_memory

OFF_GRID = -1
"""Stands in the tables for a Gcell or edge that does not exist, as a move would leave the grid."""


class Move(enum.IntEnum):
    """The six moves, numbered as in the action space."""

    EAST = 0  #: +x
    WEST = 1  #: −x
    NORTH = 2  #: +y
    SOUTH = 3  #: −y
    UP = 4  #: +z, a via
    DOWN = 5  #: −z, a via


AXES = 3
VIA_AXIS = 2

MAX_GCELLS = 2**24  # the largest grid accepted, larger than any of the ISPD 2008 contest
MOVES = len(Move)


Row = TypeVar("Row")


class Rows(dict[int, Row], Generic[Row]):
    """Tables of single Gcells, as Python numbers, computed at the first access."""

    def __init__(self, row_of: Callable[[int], Row]) -> None:
        self._row_of = row_of

    def __missing__(self, gcell: int) -> Row:
        row = self[gcell] = self._row_of(gcell)
        return row


@dataclass(frozen=True, eq=False)
class Grid:
    """The topology of an X×Y×Z grid as lookup tables, shared by all problems of that shape.

    A table is made when it is first asked for, because it takes memory for every Gcell: judging a
    few routes on a large grid needs none. All are read-only.

    The same is there for plain Python, which reads its own numbers faster than those of arrays:
    ``ways``, ``exits_of`` and ``position_of``, by Gcell.
    """

    shape: tuple[int, int, int]  # (X, Y, Z)

    @staticmethod
    @functools.lru_cache(maxsize=64)
    def of(shape: tuple[int, int, int]) -> "Grid":
        """The grid of shape (X, Y, Z); equal shapes share one object."""
        return Grid(shape)

    def __str__(self) -> str:
        """``8x8x2``."""
        return "x".join(map(str, self.shape))

    @functools.cached_property
    def gcells(self) -> int:
        """The number of Gcells, G = X·Y·Z."""
        return math.prod(self.shape)

    @functools.cached_property
    def edges(self) -> int:
        """The number of edge numbers, E = 3·G, including those of edges off the grid."""
        return AXES * self.gcells

    @functools.cached_property
    def neighbour(self) -> NDArray[np.int32]:
        """(G, 6) int32, the Gcell that each move leads to, or OFF_GRID."""
        number = np.arange(self.gcells, dtype=np.int32).reshape(self.shape)
        table = np.full((*self.shape, MOVES), OFF_GRID, np.int32)
        for axis, (near, far) in enumerate(_BESIDE):
            table[*near, 2 * axis] = number[far]
            table[*far, 2 * axis + 1] = number[near]
        return _read_only(table.reshape(-1, MOVES))

    @functools.cached_property
    def edge(self) -> NDArray[np.int32]:
        """(G, 6) int32, the edge that each move crosses; off the grid E - 1, which is none."""
        number = np.arange(0, self.edges, AXES, dtype=np.int32).reshape(self.shape)
        table = np.full((*self.shape, MOVES), self.edges - 1, np.int32)
        for axis, (near, far) in enumerate(_BESIDE):
            table[*near, 2 * axis] = table[*far, 2 * axis + 1] = number[near] + axis
        return _read_only(table.reshape(-1, MOVES))

    @functools.cached_property
    def exits(self) -> NDArray[np.uint8]:
        """(G,) uint8, one bit per move: whether it stays on the grid."""
        stays = self.neighbour != OFF_GRID
        return _read_only(np.packbits(stays, axis=1, bitorder="little")[:, 0].copy())

    @functools.cached_property
    def position(self) -> NDArray[np.int32]:
        """(G, 3) int32, x, y, z of each Gcell, from 0."""
        table = np.empty((*self.shape, AXES), np.int32)
        for axis, at in enumerate(np.ogrid[*map(slice, self.shape)]):
            table[..., axis] = at
        return _read_only(table.reshape(-1, AXES))

    @functools.cached_property
    def exists(self) -> NDArray[np.bool_]:
        """(E,) bool, whether the edge joins two Gcells."""
        table = np.zeros((*self.shape, AXES), np.bool_)
        for axis, (near, _) in enumerate(_BESIDE):
            table[*near, axis] = True
        return _read_only(table.reshape(-1))

    @functools.cached_property
    def ways(self) -> Rows[tuple[tuple[int, int], ...]]:
        """For a Gcell and each of the six moves: the edge, and the Gcell ahead or OFF_GRID."""
        edge, neighbour = self.edge, self.neighbour
        return Rows(lambda g: tuple(zip(edge[g].tolist(), neighbour[g].tolist(), strict=True)))

    @functools.cached_property
    def exits_of(self) -> Rows[tuple[tuple[int, int, int], ...]]:
        """For a Gcell the moves that stay on the grid: bit of the move, edge and Gcell ahead."""
        ways = self.ways
        return Rows(
            lambda g: tuple((1 << m, *way) for m, way in enumerate(ways[g]) if way[1] != OFF_GRID)
        )

    @functools.cached_property
    def position_of(self) -> Rows[tuple[int, int, int]]:
        """x, y and z of a Gcell."""
        position = self.position
        return Rows(lambda g: tuple(position[g].tolist()))

    def distance(self, a: int, b: int) -> int:
        """The Manhattan distance of two Gcells, over x, y and layer."""
        (ax, ay, az), (bx, by, bz) = self.position_of[a], self.position_of[b]
        return abs(ax - bx) + abs(ay - by) + abs(az - bz)

    def __reduce__(self) -> Any:
        return Grid.of, (self.shape,)

    def number(self, x: int, y: int, z: int) -> int:
        """The number of the Gcell at (x, y, z), all from 0; it must be on the grid."""
        _, height, layers = self.shape
        return (x * height + y) * layers + z

    def ends(self, edges: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The two Gcells that each edge joins, lower number first; both shaped like ``edges``."""
        edge: NDArray[np.int64] = np.asarray(edges, np.int64)
        near = edge // AXES  # takes a third of the time of np.divmod
        stride = np.array([self.shape[1] * self.shape[2], self.shape[2], 1], np.int64)
        return near, near + stride[edge - AXES * near]


_ALL, _NEAR, _FAR = slice(None), slice(None, -1), slice(1, None)
_BESIDE = (
    ((_NEAR, _ALL, _ALL), (_FAR, _ALL, _ALL)),
    ((_ALL, _NEAR, _ALL), (_ALL, _FAR, _ALL)),
    ((_ALL, _ALL, _NEAR), (_ALL, _ALL, _FAR)),
)
"""For each axis what cuts the Gcells that have a neighbour along it out of a table, and these
neighbours."""


def _read_only(table: Any) -> Any:
    table.setflags(write=False)
    return table


def counted(sizes: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of ``sizes[i]`` things for every i: the i of each thing, and its place among those of i."""
    index = np.repeat(np.arange(len(sizes)), sizes)
    return index, np.arange(len(index)) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def distinct(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """The values, ascending, each once: by sorting, a tenth of the time of NumPy's ``unique``."""
    ascending = np.sort(values)
    first = np.ones(len(ascending), np.bool_)
    first[1:] = ascending[1:] != ascending[:-1]
    return ascending[first]


def is_among(values: NDArray[np.int64], ascending: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which values are among some that ascend."""
    if not len(ascending):
        return np.zeros(len(values), np.bool_)
    at = np.minimum(np.searchsorted(ascending, values), len(ascending) - 1)
    found: NDArray[np.bool_] = ascending[at] == values
    return found


def gcells_of_boxes(
    first: Sequence[NDArray[np.int64]], last: Sequence[NDArray[np.int64]], each: int, what: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """(k,) thrice: for every Gcell of boxes from ``first`` to before ``last`` the box, x and y."""
    high = last[1] - first[1]
    sizes = (last[0] - first[0]) * high
    count = int(sizes.sum())
    check_memory(each * count, what, count)
    index, place = counted(sizes)
    return index, first[0][index] + place // high[index], first[1][index] + place % high[index]


def neighbours(
    shape: tuple[int, int, int], keys: NDArray[np.int64], axis: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(k,) twice: which of net · G + Gcell, ascending, have the next Gcell along an axis."""
    stride = (shape[1] * shape[2], shape[2], 1)[axis]
    at = np.flatnonzero(keys // stride % shape[axis] + 1 < shape[axis])
    other = np.minimum(np.searchsorted(keys, keys[at] + stride), len(keys) - 1)
    both = keys[other] == keys[at] + stride
    return at[both], other[both]
