"""Where Gcells lie, in compiled code."""

from marouting.batch.state import Static
from marouting.kernels import compiled, i64


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
