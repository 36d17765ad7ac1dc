"""Rows of bits: sets of whole numbers from 0, such as the edges that each net uses.

M problems have R rows each, and a row has one bit for each of its numbers, eight to a byte. Rows
have one of two forms, which is decided once for a game (:func:`make_rows`). The functions of this
module work with either, and nothing else looks inside:

* **wide**, (M, R, bytes) uint8: every row has a place for every byte. This is the quickest.
* **hashed**, (M, S) int32: a row has a table of the bytes that are in use, found by hashing, so
  that rows take memory in proportion to the numbers in them. The tables of a problem lie in one
  array one after another: all of this can be copied, cut into parts of problems and saved.

Compiled code tells the forms apart by the number of dimensions, when it is compiled. Tables grow
as numbers are put in, as long as the array has room. Compiled code cannot make it longer:
:func:`longer` does, between calls. Bytes that have become zero leave a table when it grows.

Hashed rows of a problem are, in this order: a 0, which is what a row without a table finds; where
the free part begins; the number of rows; for each power of two, the first of the tables of this
size that are out of use, each of which begins with where the next one is; for every row where its
table is, the size of the table less 1, and the bytes in it; the tables. An entry of a table is
256 · (byte + 1) + its bits.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, inlined, inner, place, wide

_TOP, _ROWS, _FREE = 1, 2, 0  # the free tables of 2**k entries are found at _FREE + k, from k = 3
_DIRECTORY, _RECORD = 32, 3
SMALLEST = 8
"""Entries of a new table; at most half of them are in use."""

MOST_BYTES = 2**23 - 2
"""The largest byte of a hashed row."""


def make_rows(problems: int, rows: int, bytes_: int, *, hashed: bool) -> NDArray[Any]:
    """Empty rows of bits.

    Args:
        problems: M.
        rows: R.
        bytes_: of a row.
        hashed: the form, see above.
    """
    # Zeros take no memory until they are written to.
    if not hashed:
        return np.zeros((problems, rows, bytes_), np.uint8)
    bits = np.zeros((problems, begin_of(rows)), np.int32)
    bits[:, _TOP], bits[:, _ROWS] = bits.shape[1], rows
    return bits


def begin_of(rows: int) -> int:
    """Where the tables of hashed rows begin."""
    return _DIRECTORY + _RECORD * rows


def longer(bits: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """A copy of hashed rows (M, S) with at least so many numbers for each problem."""
    more = np.zeros((len(bits), max(size, bits.shape[1])), np.int32)
    adopt(more, bits)
    return more


def _end(bits: NDArray[np.int32]) -> int:
    """Where the free part of hashed rows begins in all problems."""
    return int(bits[:, _TOP].max(initial=0))


def copied(bits: NDArray[Any]) -> NDArray[Any]:
    """A copy of rows; what is free is not written to, and takes no memory."""
    return bits.copy() if bits.ndim == 3 else longer(bits, 0)


def chosen(bits: NDArray[Any], which: NDArray[np.integer]) -> NDArray[Any]:
    """The same of some problems only, by their indices."""
    if bits.ndim == 3:
        return np.asarray(bits[which])
    some = np.zeros((len(which), bits.shape[1]), np.int32)
    some[:, : _end(bits)] = bits[which, : _end(bits)]
    return some


def in_use(bits: NDArray[Any]) -> NDArray[Any]:
    """Rows without what is free, a view."""
    return bits if bits.ndim == 3 else bits[:, : _end(bits)]


def adopt(bits: NDArray[Any], others: NDArray[Any], which: Any = slice(None)) -> None:
    """Makes rows equal to others of the same form, in all problems or where ``which`` (M,) is true.

    Hashed rows have to be as long as what the others have in use.
    """
    if bits.ndim == 3:
        bits[which] = others[which]
    else:
        size, before = _end(others), _end(bits)
        bits[which, size:before] = 0
        bits[which, :size] = others[which, :size]


# --- what compiled code calls ---------------------------------------------------------------------


@inlined
def length(bits: Any, m: int) -> int:
    """How much of a problem's array is in use, free tables included; 0 for wide rows."""
    return wide(bits[m, _TOP]) if bits.ndim == 2 else wide(0)


@inlined
def _slot(bits: Any, m: int, row: int, byte: int) -> int:
    """The place of a byte of a hashed row, or the place where it would go."""
    at = _DIRECTORY + _RECORD * place(row)
    begin, mask = place(bits[m, at]), place(bits[m, at + 1])
    slot = (byte * 0x9E3779B1 >> 22) & mask
    while bits[m, begin + slot] != 0 and place(bits[m, begin + slot]) >> 8 != byte + 1:
        slot = (slot + 1) & mask
    return begin + slot


@inlined
def byte_of(bits: Any, m: int, row: int, byte: int) -> int:
    """The eight bits of a byte of a row."""
    if bits.ndim == 2:
        return wide(bits[m, _slot(bits, m, row, byte)]) & 255
    return wide(bits[m, row, byte])


@inlined
def has(bits: Any, m: int, row: int, number: int) -> int:
    """1 if a number is in a row, else 0."""
    if bits.ndim == 2:
        return wide(bits[m, _slot(bits, m, row, number >> 3)]) >> (number & 7) & 1
    return bits[m, row, number >> 3] >> (number & 7) & 1


@inlined
def put(bits: Any, m: int, row: int, number: int, puts: int) -> None:
    """Puts a number into a row if ``puts`` is 1; does nothing if it is 0."""
    if bits.ndim == 2:
        if puts:
            _write(
                bits, m, row, number >> 3, byte_of(bits, m, row, number >> 3) | 1 << (number & 7)
            )
    else:
        bits[m, row, number >> 3] |= np.uint8(puts << (number & 7))


@inlined
def set_byte(bits: Any, m: int, row: int, byte: int, value: int) -> None:
    """Sets the eight bits of a byte of a row."""
    if bits.ndim == 2:
        _write(bits, m, row, byte, value)
    else:
        bits[m, row, byte] = value


@compiled
def _write(bits: Any, m: int, row: int, byte: int, value: int) -> None:
    """:func:`set_byte` in hashed rows."""
    slot = _slot(bits, m, row, byte)
    if bits[m, slot] == 0:
        if value == 0:
            return
        at = _DIRECTORY + _RECORD * place(row)
        bits[m, at + 2] += 1
        if 2 * bits[m, at + 2] > bits[m, at + 1] + 1:
            _grow(bits, m, row)
            slot = _slot(bits, m, row, byte)
    bits[m, slot] = (byte + 1) << 8 | value


@inner
def _grow(bits: Any, m: int, row: int) -> None:
    """Gives a hashed row another table, with room for one more byte; bytes without bits go."""
    at = _DIRECTORY + _RECORD * place(row)
    begin, size = place(bits[m, at]), place(bits[m, at + 1]) + 1
    alive = wide(0)
    for i in range(begin, begin + size):
        alive += wide(bits[m, i]) & 255 != 0
    larger = 2 * size if 4 * (alive + 1) > size else size
    larger = max(larger, SMALLEST)
    power = wide(0)
    while 1 << power < larger:
        power += 1
    new = place(bits[m, _FREE + power])
    if new != 0:
        bits[m, _FREE + power] = bits[m, new]
        bits[m, new] = 0
    else:
        new = place(bits[m, _TOP])
        if new + larger > bits.shape[1]:
            raise MemoryError(
                "rows of bits without room: a step needs Engine.make_room() before it"
            )
        bits[m, _TOP] = new + larger
    bits[m, at], bits[m, at + 1] = new, larger - 1
    for i in range(begin, begin + size):
        entry = wide(bits[m, i])
        bits[m, i] = 0
        if entry & 255 != 0:
            bits[m, _slot(bits, m, row, (entry >> 8) - 1)] = entry
    bits[m, at + 2] = alive + 1
    if size > 1:
        power -= size < larger
        bits[m, begin] = bits[m, _FREE + power]
        bits[m, _FREE + power] = begin


@inlined
def places(bits: Any, m: int, row: int) -> int:
    """How many places a row has, to go through all its bytes with :func:`byte_at`."""
    if bits.ndim == 2:
        return place(bits[m, _DIRECTORY + _RECORD * place(row) + 1]) + 1
    return wide(bits.shape[2])


@inlined
def span(bits: Any, m: int, row: int, begin: int, end: int) -> tuple[int, int]:
    """The first place, and the one after the last, of a row's bytes from ``begin`` to ``end`` - 1.

    In hashed rows there may be others in between.
    """
    if bits.ndim == 2:
        return wide(0), places(bits, m, row)
    return begin, end


@inlined
def byte_at(bits: Any, m: int, row: int, at: int) -> tuple[int, int]:
    """The byte in one of a row's places, and its bits; the bits of a place that is empty are 0.

    In hashed rows the bytes come in no order. None moves as long as no byte is new in the row.
    """
    if bits.ndim == 2:
        entry = wide(bits[m, place(bits[m, _DIRECTORY + _RECORD * place(row)]) + at])
        return max((entry >> 8) - 1, wide(0)), entry & 255
    return wide(at), wide(bits[m, row, at])


@inlined
def empty(bits: Any, m: int, row: int) -> None:
    """Takes all numbers out of a row."""
    if bits.ndim == 2:
        begin = place(bits[m, _DIRECTORY + _RECORD * place(row)])
        for i in range(begin, begin + places(bits, m, row)):
            bits[m, i] &= -256
    else:
        for byte in range(bits.shape[2]):
            bits[m, row, byte] = 0


@inlined
def forget(bits: Any, m: int) -> None:
    """Takes all numbers out of all rows of a problem."""
    if bits.ndim == 2:
        rows, top = wide(bits[m, _ROWS]), wide(bits[m, _TOP])
        for i in range(top):
            bits[m, i] = 0
        bits[m, _ROWS], bits[m, _TOP] = rows, _DIRECTORY + _RECORD * rows
    else:
        for row in range(bits.shape[1]):
            for byte in range(bits.shape[2]):
                bits[m, row, byte] = 0


@inlined
def copy_row(bits: Any, m: int, row: int, others: Any, k: int, other: int) -> None:
    """Makes a row hold what another row of problem k holds, of rows of the same form."""
    empty(bits, m, row)
    for at in range(places(others, k, other)):
        byte, value = byte_at(others, k, other, at)
        if value != 0:
            set_byte(bits, m, row, byte, value)


@inlined
def swap_rows(bits: Any, others: Any, m: int, row: int) -> None:
    """Swaps a row of problem m with the same row of others."""
    if bits.ndim == 2:
        # A table that grows loses its zeros, so none is written to while it is gone through.
        _flip(bits, others, m, row)
        _flip(others, bits, m, row)
        _flip(bits, others, m, row)
    else:
        for byte in range(bits.shape[2]):
            value = bits[m, row, byte]
            bits[m, row, byte] = others[m, row, byte]
            others[m, row, byte] = value


@inner
def _flip(bits: Any, others: Any, m: int, row: int) -> None:
    """Of every number in a row of others: takes it out of the same row of bits, or puts it in."""
    for at in range(places(others, m, row)):
        byte, value = byte_at(others, m, row, at)
        if value != 0:
            set_byte(bits, m, row, byte, byte_of(bits, m, row, byte) ^ value)


# --- whole arrays ---------------------------------------------------------------------------------


@compiled
def _list(bits: Any, m: int, rows: int, row: Any, number: Any) -> int:
    """Lists the rows and numbers of a problem, as far as there is room; returns how many."""
    size = 0
    for r in range(rows):
        for at in range(places(bits, m, r)):
            byte, value = byte_at(bits, m, r, at)
            first = 8 * byte
            while value != 0:
                if value & 1:
                    if size < len(row):
                        row[size] = r
                        number[size] = first
                    size += 1
                value >>= 1
                first += 1
    return size


def numbers_of(bits: NDArray[Any], m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The rows of a problem and the numbers in them, both (K,) int64, in ascending order."""
    rows = bits.shape[1] if bits.ndim == 3 else int(bits[m, _ROWS])
    nothing = np.empty(0, np.int64)
    row, number = np.empty((2, _list(bits, m, rows, nothing, nothing)), np.int64)
    _list(bits, m, rows, row, number)
    if bits.ndim == 2:
        number = number[np.lexsort((number, row))]  # rows are in order
    return row, number


@compiled
def _put(bits: Any, m: int, row: Any, number: Any) -> None:
    for k in range(len(row)):
        put(bits, m, wide(row[k]), wide(number[k]), wide(1))


def put_numbers(
    bits: NDArray[Any], m: int, row: NDArray[np.integer], number: NDArray[np.integer]
) -> NDArray[Any]:
    """Puts numbers (K,) into rows (K,) of a problem; returns the rows, longer ones if need be."""
    if bits.ndim == 2:
        bits = longer(bits, _end(bits) + _PER_NUMBER * len(row))
    _put(bits, m, row, number)
    return bits


@compiled
def _replace(bits: Any, m: int, row: int, number: Any) -> None:
    empty(bits, m, place(row))
    for k in range(len(number)):
        put(bits, m, place(row), wide(number[k]), wide(1))


def with_row(bits: NDArray[Any], m: int, row: int, number: NDArray[np.int64]) -> NDArray[Any]:
    """Makes a row of a problem hold just these numbers; returns the rows, longer if need be."""
    if bits.ndim == 2:
        bits = longer(bits, _end(bits) + _PER_NUMBER * len(number))
    _replace(bits, m, row, number)
    return bits


_PER_NUMBER = 2 * SMALLEST
"""Entries that a number takes at most: a table has at least a quarter of its entries in use, or is
one of the smallest, and the tables that it has grown out of are together as large."""
