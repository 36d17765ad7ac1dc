"""The grid of Gcells: how Gcells and edges are numbered, and which are neighbours.

The Gcells of an X×Y×Z grid are numbered ``(x * Y + y) * Z + z``. Every Gcell owns the three edges
towards its +x, +y and +z neighbours: edge ``3 * gcell + axis`` joins ``gcell`` to its neighbour
along ``axis`` (0 = x, 1 = y, 2 = z, a via). At the far border such edges would lead off the grid:
their numbers exist, the edges do not.
"""

import enum
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
MOVES = len(Move)


@dataclass(frozen=True, eq=False)
class Grid:
    """The topology of an X×Y×Z grid as lookup tables, shared by all problems of that shape.

    Attributes:
        shape: (X, Y, Z).
        gcells: number of Gcells, G = X·Y·Z.
        edges: number of edge numbers, E = 3·G, including those of edges off the grid.
        neighbour: (G, 6) int32, the Gcell that each move leads to, or OFF_GRID.
        edge: (G, 6) int32, the edge that each move crosses, or OFF_GRID.
        position: (G, 3) int32, x, y, z of each Gcell, from 0.
        exists: (E,) bool, whether the edge joins two Gcells.

    All arrays are read-only.
    """

    shape: tuple[int, int, int]
    gcells: int
    edges: int
    neighbour: NDArray[np.int32]
    edge: NDArray[np.int32]
    position: NDArray[np.int32]
    exists: NDArray[np.bool_]

    @staticmethod
    @functools.lru_cache(maxsize=64)
    def of(shape: tuple[int, int, int]) -> "Grid":
        """The grid of shape (X, Y, Z); equal shapes share one object."""
        gcells = int(np.prod(shape, dtype=np.int64))
        number = np.arange(gcells, dtype=np.int32)
        position = np.stack(np.unravel_index(number, shape), axis=1).astype(np.int32)
        stride = (shape[1] * shape[2], shape[2], 1)
        neighbour = np.full((gcells, MOVES), OFF_GRID, np.int32)
        edge = np.full((gcells, MOVES), OFF_GRID, np.int32)
        exists = np.zeros(gcells * AXES, np.bool_)
        for axis in range(AXES):
            inside = number[position[:, axis] + 1 < shape[axis]]
            crossing = AXES * inside + axis
            forward, backward = 2 * axis, 2 * axis + 1
            neighbour[inside, forward] = inside + stride[axis]
            neighbour[inside + stride[axis], backward] = inside
            edge[inside, forward] = crossing
            edge[inside + stride[axis], backward] = crossing
            exists[crossing] = True
        for table in (neighbour, edge, position, exists):
            table.setflags(write=False)
        return Grid(shape, gcells, gcells * AXES, neighbour, edge, position, exists)

    def number(self, x: int, y: int, z: int) -> int:
        """The number of the Gcell at (x, y, z), all from 0; it must be on the grid."""
        _, height, layers = self.shape
        return (x * height + y) * layers + z

    def ends(self, edges: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The two Gcells that each edge joins, lower number first; both shaped like ``edges``."""
        near, axis = np.divmod(np.asarray(edges, np.int64), AXES)
        stride = np.array([self.shape[1] * self.shape[2], self.shape[2], 1], np.int64)
        return near, near + stride[axis]
