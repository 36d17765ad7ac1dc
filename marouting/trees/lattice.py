"""A box of a grid graph with a cost for every edge, in which trees are looked for."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled
from marouting.problem.grid import AXES, MOVES, VIA_AXIS

CLOSED = -1  # the cost of a move that must not be made; also of a tree that does not exist


FAR = 1 << 40  # more than any edge costs


class Lattice(NamedTuple):
    """Some lines of a grid graph along each axis, and the points where they cross.

    Points are numbered like Gcells, ``(i * ny + j) * nz + k``.
    """

    size: NDArray[np.int64]  # (3,) points along x, y, z
    stride: NDArray[np.int64]  # (6,) by how much a move changes the number of the point
    line: NDArray[np.int64]  # (3, side) coordinates; a move costs no less than they differ
    cost: NDArray[np.int32]  # (points, 6) cost of each move, or CLOSED
    tree: NDArray[np.uint8]  # (points,) bit m: the tree has the edge that move m crosses


def make_lattice(points: int, side: int) -> Lattice:
    """Room for lattices of up to so many points, and up to ``side`` along any axis."""
    return Lattice(
        size=np.zeros(AXES, np.int64),
        stride=np.zeros(MOVES, np.int64),
        line=np.zeros((AXES, side), np.int64),
        cost=np.empty((points, MOVES), np.int32),
        tree=np.zeros(points, np.uint8),
    )


@compiled
def set_size(lattice: Lattice, nx: int, ny: int, nz: int) -> None:
    """Gives the lattice nx×ny×nz points and an empty tree; costs and lines are left to be set."""
    lattice.size[0], lattice.size[1], lattice.size[2] = nx, ny, nz
    stride = ny * nz
    for axis in range(AXES):
        lattice.stride[2 * axis], lattice.stride[2 * axis + 1] = stride, -stride
        stride = nz if axis == 0 else 1
    for point in range(nx * ny * nz):
        lattice.tree[point] = 0


@compiled
def begin_lines(lattice: Lattice, via: int) -> None:
    """Before costs are set: columns and rows are as far apart as nothing, layers by ``via``."""
    for axis in range(AXES):
        for i in range(lattice.size[axis]):
            lattice.line[axis, i] = i * via if axis == VIA_AXIS else FAR


@compiled
def sum_lines(lattice: Lattice) -> None:
    """Once ``line`` says how far columns (and rows) are from those before: gives them places."""
    for axis in range(VIA_AXIS):
        lattice.line[axis, 0] = 0
        for i in range(1, lattice.size[axis]):
            lattice.line[axis, i] += lattice.line[axis, i - 1]


@compiled
def set_cost(lattice: Lattice, point: int, axis: int, cost: int) -> None:
    """Sets the cost, in both directions, of the edge from a point to the next one along an axis."""
    lattice.cost[point, 2 * axis] = cost
    lattice.cost[point + lattice.stride[2 * axis], 2 * axis + 1] = cost
