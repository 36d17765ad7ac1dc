"""Where Gcells lie, in compiled code."""

from marouting.batch.state import Static
from marouting.kernels import inlined, wide


@inlined
def position(static: Static, cell: int) -> tuple[int, int, int]:
    """x, y and z of a Gcell."""
    at = static.position[cell]
    return wide(at[0]), wide(at[1]), wide(at[2])


@inlined
def grid_of(static: Static) -> tuple[int, int, int]:
    """Columns, rows and layers of the grid."""
    x, y, z = position(static, len(static.position) - 1)
    return x + 1, y + 1, z + 1
