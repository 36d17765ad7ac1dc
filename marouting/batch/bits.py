"""Rows of bits: sets of whole numbers from 0, such as the edges that each net uses.

Rows are (M, R, bytes) uint8: M problems have R rows each, and number k is bit k % 8 of byte k // 8.
A bit for each net and edge takes memory, but no kernel has to make room, and copying, saving and
cutting a batch into parts are those of arrays. Games of many nets on large grids, for which that is
too much, are for the plain game (:mod:`marouting.game`), whose sets grow with what is in them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.game import NOBODY
from marouting.kernels import compiled, i64


@compiled
def byte_of(bits: Any, m: int, row: int, byte: int) -> int:
    """The eight bits of a byte of a row."""
    return i64(bits[m, row, byte])


@compiled
def next_in(bits: Any, m: int, row: int, number: int) -> int:
    """The first number from ``number`` on that is in a row, or NOBODY."""
    byte = number >> 3
    if byte >= bits.shape[2]:
        return i64(NOBODY)
    rest = i64(byte_of(bits, m, row, byte)) >> (number & 7)
    while rest == 0:
        byte += 1
        if byte >= bits.shape[2]:
            return i64(NOBODY)
        number, rest = 8 * byte, i64(byte_of(bits, m, row, byte))
    while not rest & 1:
        number, rest = number + 1, rest >> 1
    return number


@compiled
def has(bits: Any, m: int, row: int, number: int) -> int:
    """1 if a number is in a row, else 0."""
    return bits[m, row, number >> 3] >> (number & 7) & 1


@compiled
def put(bits: Any, m: int, row: int, number: int, bit: int) -> None:
    """Puts a number into a row if ``bit`` is 1; does nothing if it is 0."""
    bits[m, row, number >> 3] |= np.uint8(bit << (number & 7))


@compiled
def set_byte(bits: Any, m: int, row: int, byte: int, value: int) -> None:
    """Sets the eight bits of a byte of a row."""
    bits[m, row, byte] = value


@compiled
def empty(bits: Any, m: int, row: int) -> None:
    """Takes all numbers out of a row."""
    for byte in range(bits.shape[2]):
        bits[m, row, byte] = 0


@compiled
def clear(bits: Any, m: int, first: int, step: int) -> None:
    """Takes all numbers out of the rows of a problem; one thread of ``step`` does its share."""
    for row in range(bits.shape[1]):
        for byte in range(first, bits.shape[2], step):
            bits[m, row, byte] = 0


@compiled
def copy_row(bits: Any, m: int, row: int, others: Any, k: int, other: int) -> None:
    """Makes a row hold what another row of problem k holds."""
    for byte in range(bits.shape[2]):
        bits[m, row, byte] = others[k, other, byte]


def put_numbers(
    bits: NDArray[np.uint8], m: int, row: NDArray[np.integer], number: NDArray[np.integer]
) -> None:
    """Puts numbers (K,) into rows (K,) of a problem."""
    np.bitwise_or.at(bits[m], (row, number >> 3), np.left_shift(1, number & 7).astype(np.uint8))


def numbers_of(bits: NDArray[np.uint8], m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The rows of a problem and the numbers in them, both (K,) int64, in ascending order."""
    row, byte = np.nonzero(bits[m])
    at, bit = np.nonzero(np.unpackbits(bits[m, row, byte][:, None], axis=1, bitorder="little"))
    return row[at], 8 * byte[at] + bit
