"""Products of small matrices, at the speed of the processor's vector units.

A BLAS is built for large matrices: on those of the paper's network (12 to 64 rows and columns) it
reaches half of what these do, the rest goes into packing and calls. Here a tile of the result, say
four rows of sixteen columns, stays in registers while the products that it sums run over it. What
numba cannot say in Python, vectors in registers, is said in LLVM's own language; LLVM makes of it
what the processor has (AVX, AVX-512, NEON).

Every number of a result is summed in the same order whatever the tile it falls into: the same
result on one thread and on many, for a row alone or among others.
"""

# ruff: noqa: ARG001 - an intrinsic gets types, and what they stand for only in `given`.

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from marouting.kernels import compiled

_WIDE, _NARROW = (4, 16), (8, 4)
"""Rows and columns of tiles: eight sums of a register or less in flight, as many as it takes for
none to wait for another, and half of the registers that AVX has."""

_LONG = 64
"""Columns of the tile of a single row: on it, reading B sets the pace."""

_FLOAT, _INDEX, _LANE = ir.FloatType(), ir.IntType(64), ir.IntType(32)


def _tile(rows: int, columns: int, listed: bool = False) -> Callable[..., None]:
    """The product of a tile: C[r, :] = max(floor, start + sum over k of A[r, k] · B[k, :]).

    The function takes, of each matrix, an array of one dimension, the place of its first number,
    and how far rows lie apart (those of C as those of B); for A also how far its columns do, so
    that it may be transposed. If ``listed`` it takes, instead of how far A's columns lie apart, an
    array of those k that it sums over, of which ``depth`` are.
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
            def data(i: int) -> Any:
                return context.make_array(signature.args[i])(context, builder, given[i]).data

            def vector_at(array: Any, at: Any) -> Any:
                return builder.bitcast(builder.gep(array, [at]), vector.as_pointer())

            _, a_at, a_row, a_column, _, b_at, b_row, _, start_at, _, c_at, depth, floor = given
            a, b, start, c = data(0), data(4), data(7), data(9)
            listing = data(3) if listed else None

            def everywhere(number: Any) -> Any:
                number = builder.insert_element(anything, number, ir.Constant(_LANE, 0))
                return builder.shuffle_vector(number, anything, first)

            alloca: Any = cgutils.alloca_once
            sums = [alloca(builder, vector) for _ in range(rows)]
            for total in sums:
                builder.store(builder.load(vector_at(start, start_at), align=4), total)
            with cgutils.for_range(builder, depth) as loop:
                k, column = loop.index, a_at
                if listing is None:
                    column = builder.add(a_at, builder.mul(k, a_column))
                else:
                    k = builder.load(builder.gep(listing, [k]))
                    column = builder.add(a_at, k)
                at = builder.add(b_at, builder.mul(k, b_row))
                right = builder.load(vector_at(b, at), align=4)
                for r, total in enumerate(sums):
                    at = builder.add(column, builder.mul(a_row, ir.Constant(_INDEX, r)))
                    left = everywhere(builder.load(builder.gep(a, [at])))
                    # "contract": a product and its sum may be one instruction, where there is one.
                    term = builder.fmul(left, right, flags=("contract",))
                    term = builder.fadd(builder.load(total), term, flags=("contract",))
                    builder.store(term, total)
            least = everywhere(floor)
            for r, total in enumerate(sums):
                at = builder.add(c_at, builder.mul(b_row, ir.Constant(_INDEX, r)))
                value = builder.load(total)
                value = builder.select(builder.fcmp_ordered("<", value, least), least, value)
                builder.store(value, vector_at(c, at), align=4)
            return context.get_dummy_value()

        index = types.int64
        return (
            types.void(
                a,
                index,
                index,
                a_column if listed else index,
                b,
                index,
                index,
                start,
                index,
                c,
                index,
                index,
                types.float32,
            ),
            generate,
        )

    return tile


_many_wide, _many_narrow = _tile(*_WIDE), _tile(*_NARROW)
_one_wide, _one_narrow, _one = _tile(1, _WIDE[1]), _tile(1, _NARROW[1]), _tile(1, 1)
_listed_long, _listed_wide = _tile(1, _LONG, listed=True), _tile(1, _WIDE[1], listed=True)
_listed_one = _tile(1, 1, listed=True)


@compiled
def small_gemm(
    a: Any,
    a_at: int,
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

    All arrays are float32, contiguous and of one dimension; B and C lie in them row after row.

    Args:
        a: holds A.
        a_at: the place of A's first number.
        a_row: how far A's rows lie apart: depth, or 1 for a transposed A.
        a_column: how far A's columns lie apart: 1, or rows for a transposed A.
        b: holds B.
        b_at: the place of B's first number.
        start: (columns,) numbers, from ``start_at``, that every row of C starts from.
        start_at: see there.
        c: filled with C.
        rows: see there.
        depth: see there.
        columns: see there.
        floor: float32, 0 for rectified linear units, −inf for any other product.
    """
    # The last tile of a row or column ends where C does and may overlap the one before it: what
    # they share comes out the same.
    wide = columns >= _WIDE[1]
    high, broad = _WIDE if wide else _NARROW
    if rows < high:
        high = 1
    if columns < broad:
        high = broad = 1
    for j in range(0, columns, broad):
        j = min(j, columns - broad)
        for i in range(0, rows, high):
            i = min(i, rows - high)
            x, w, s, y = a_at + i * a_row, b_at + j, start_at + j, i * columns + j
            n, k = columns, depth
            if high > 1 and wide:
                _many_wide(a, x, a_row, a_column, b, w, n, start, s, c, y, k, floor)
            elif high > 1:
                _many_narrow(a, x, a_row, a_column, b, w, n, start, s, c, y, k, floor)
            elif wide:
                _one_wide(a, x, a_row, a_column, b, w, n, start, s, c, y, k, floor)
            elif broad > 1:
                _one_narrow(a, x, a_row, a_column, b, w, n, start, s, c, y, k, floor)
            else:
                _one(a, x, a_row, a_column, b, w, n, start, s, c, y, k, floor)


@compiled
def sparse_row(
    a: Any, b: Any, b_at: int, start_at: int, c: Any, columns: int, floor: Any, places: Any
) -> None:
    """C = max(floor, A B + start) for a single row A with many zeros, which are passed over.

    The numbers are those of :func:`small_gemm`: a zero changes no sum.

    Args:
        a: (depth,) A.
        b: holds B, and start.
        b_at: the place of B's first number.
        start_at: the place of the numbers that C starts from.
        c: filled with C, (columns,).
        columns: see there.
        floor: as in :func:`small_gemm`.
        places: (depth,) int64 or more, working.
    """
    depth = 0
    for k in range(len(a)):
        places[depth] = k
        depth += a[k] != 0
    width = 1
    if columns >= _WIDE[1]:
        width = _LONG if columns >= _LONG else _WIDE[1]
    for j in range(0, columns, width):
        j = min(j, columns - width)
        w, s, n = b_at + j, start_at + j, columns
        if width == _LONG:
            _listed_long(a, 0, 0, places, b, w, n, b, s, c, j, depth, floor)
        elif width == _WIDE[1]:
            _listed_wide(a, 0, 0, places, b, w, n, b, s, c, j, depth, floor)
        else:
            _listed_one(a, 0, 0, places, b, w, n, b, s, c, j, depth, floor)
