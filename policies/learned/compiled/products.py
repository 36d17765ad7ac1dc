"""Products of small matrices.

A BLAS is built for large matrices: on those of the paper's network (12 to 64 rows and columns) its
calls cost as much as the work, and a row's result depends on how many rows there are. Plain loops
take three times as long. So a tile of the result stays in registers while the products that it sums
run over it, which numba cannot say in Python: :func:`_tile` says it in LLVM's language.

Every number is summed in the same order, from its start on, by tiles and by plain loops.
"""

# ruff: noqa: ARG001 - an intrinsic gets types, and what they stand for only in `given`.

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from marouting.kernels import compiled, kernel

_WIDE, _NARROW = (4, 16), (8, 4)
"""Rows and columns of tiles: eight sums of a register or less in flight, as many as it takes for
none to wait for another, and half of the registers that AVX has."""

_FLOAT, _INDEX, _LANE = ir.FloatType(), ir.IntType(64), ir.IntType(32)
_FUSED = ("contract",)
"""A product and its sum may be one instruction, where there is one."""

fused = kernel(nogil=True, error_model="numpy", _nrt=False, fastmath={*_FUSED})
"""Like ``compiled``, for loops that round like the tiles."""


def _tile(rows: int, columns: int) -> Callable[..., None]:
    """C[r, :] = max(floor, start + sum over k of A[r, k] · B[k, :]) for a tile of C.

    The function takes, of each matrix, an array of one dimension, the place of its first number,
    and how far rows lie apart (those of C as those of B); for A also how far its columns do.
    """
    vector = ir.VectorType(_FLOAT, columns)
    anything = ir.Constant(vector, ir.Undefined)
    first = ir.Constant(ir.VectorType(_LANE, columns), [0] * columns)

    @intrinsic
    def tile(
        _: Any,
        a: Any,
        a_at: Any,
        a_row: Any,
        a_column: Any,
        b: Any,
        b_at: Any,
        b_row: Any,
        start: Any,
        start_at: Any,
        c: Any,
        c_at: Any,
        depth: Any,
        floor: Any,
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            a, b, start, c = (
                context.make_array(signature.args[i])(context, builder, given[i]).data
                for i in (0, 4, 7, 9)
            )
            _, a_at, a_row, a_column, _, b_at, b_row, _, start_at, _, c_at, depth, floor = given

            def vector_at(array: Any, at: Any) -> Any:
                return builder.bitcast(builder.gep(array, [at]), vector.as_pointer())

            def everywhere(number: Any) -> Any:
                number = builder.insert_element(anything, number, ir.Constant(_LANE, 0))
                return builder.shuffle_vector(number, anything, first)

            def row_at(at: Any, by: Any, row: int) -> Any:
                return builder.add(at, builder.mul(by, ir.Constant(_INDEX, row)))

            alloca: Any = cgutils.alloca_once
            sums = [alloca(builder, vector) for _ in range(rows)]
            for total in sums:
                builder.store(builder.load(vector_at(start, start_at), align=4), total)
            with cgutils.for_range(builder, depth) as loop:
                column = builder.add(a_at, builder.mul(loop.index, a_column))
                at = builder.add(b_at, builder.mul(loop.index, b_row))
                right = builder.load(vector_at(b, at), align=4)
                for r, total in enumerate(sums):
                    left = everywhere(builder.load(builder.gep(a, [row_at(column, a_row, r)])))
                    term = builder.fmul(left, right, flags=_FUSED)
                    builder.store(builder.fadd(builder.load(total), term, flags=_FUSED), total)
            least = everywhere(floor)
            for r, total in enumerate(sums):
                value = builder.load(total)
                value = builder.select(builder.fcmp_ordered("<", value, least), least, value)
                builder.store(value, vector_at(c, row_at(c_at, b_row, r)), align=4)

        index = types.intp
        matrices = a, index, index, index, b, index, index, start, index, c, index, index
        return types.void(*matrices, types.float32), generate

    return tile


_wide_tile, _narrow_tile = _tile(*_WIDE), _tile(*_NARROW)


@compiled
def product(
    a: Any,
    a_row: int,
    a_column: int,
    b: Any,
    b_at: int,
    start: Any,
    start_at: int,
    c: Any,
    rows: int,
    depth: int,
    columns: int,
    floor: Any,
) -> None:
    """C = max(floor, A B + start), for C (rows, columns), A (rows, depth), B (depth, columns).

    All arrays are float32, contiguous and of one dimension; B and C lie in them row after row. A's
    rows and columns lie ``a_row`` and ``a_column`` apart: it may be transposed.
    """
    wide = columns >= _WIDE[1]
    high, broad = _WIDE if wide else _NARROW
    if rows < high or columns < broad:
        for i in range(rows):
            row = c[i * columns : (i + 1) * columns]
            product_row(a, i * a_row, a_column, depth, b, b_at, start, start_at, row, floor)
        return
    # The last tile of a row or column ends where C does and may overlap the one before it: what
    # they share comes out the same.
    for j in range(0, columns, broad):
        j = min(j, columns - broad)
        for i in range(0, rows, high):
            i = min(i, rows - high)
            x, w, s, y = i * a_row, b_at + j, start_at + j, i * columns + j
            if wide:
                _wide_tile(a, x, a_row, a_column, b, w, columns, start, s, c, y, depth, floor)
            else:
                _narrow_tile(a, x, a_row, a_column, b, w, columns, start, s, c, y, depth, floor)


@fused
def product_row(
    a: Any, a_at: int, a_column: int, depth: int, b: Any, b_at: int, start: Any, start_at: int,
    c: Any, floor: Any,
) -> None:  # fmt: skip
    """:func:`product` for a row, whose zeros are passed over: they change no sum."""
    columns = len(c)
    for j in range(columns):
        c[j] = start[start_at + j]
    for k in range(depth):
        left = a[a_at + k * a_column]
        if left != 0:
            right = b[b_at + k * columns : b_at + (k + 1) * columns]
            for j in range(columns):
                c[j] += left * right[j]
    for j in range(columns):
        if c[j] < floor:  # NaN stays
            c[j] = floor
