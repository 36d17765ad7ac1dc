"""Where Gcells lie, in compiled code."""

from marouting.batch.state import Static
from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES


@compiled
def position(static: Static, cell: int) -> tuple[int, int, int]:
    """x, y and z of a Gcell."""
    at = static.position[cell]
    return i64(at[0]), i64(at[1]), i64(at[2])


@compiled
def grid_of(static: Static) -> tuple[int, int, int]:
    """Columns, rows and layers of the grid."""
    x, y, z = position(static, len(static.position) - 1)
    return x + 1, y + 1, z + 1


@compiled
def distance(static: Static, a: int, b: int) -> int:
    """The distance of two Gcells over x, y and layers: the moves between them on an empty grid."""
    moves = i64(0)
    for axis in range(AXES):
        moves += abs(i64(static.position[a, axis]) - i64(static.position[b, axis]))
    return moves
