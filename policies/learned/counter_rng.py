"""Random numbers without a state to keep: a number is a function of a key and a counter.

Every problem has its own keys, drawn from the seed and the problem's name, so that its random
numbers are the same whatever else is trained beside it, and a resumed run needs only its counters
to go on as if it had not stopped. The function is SplitMix64 (Steele, Lea, Flood, "Fast splittable
pseudorandom number generators", 2014).
"""

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from marouting.kernels import compiled, mixed


def keys(seed: int, names: Sequence[str], purpose: str) -> NDArray[np.uint64]:
    """(M,) uint64, a key for each name; other seeds and purposes give other keys."""
    return np.array(
        [
            np.random.SeedSequence(
                [seed, zlib.crc32(name.encode()), zlib.crc32(purpose.encode())]
            ).generate_state(1, np.uint64)[0]
            for name in names
        ],
        np.uint64,
    )


@compiled
def uniform(key: Any, counter: int, lane: int) -> float:
    """The number in [0, 1) of a key, a counter and a lane below 2¹⁶ (draws of one counter)."""
    number = np.uint64(counter) * np.uint64(65536) + np.uint64(lane) + np.uint64(1)
    bits = mixed(key + number * np.uint64(0x9E3779B97F4A7C15))
    return float(bits >> np.uint64(11)) * 2.0**-53


_STEP, _FIRST, _SECOND = (
    int(np.uint64(number).astype(np.int64))
    for number in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)


def uniforms(keys: Tensor, counters: Tensor, lanes: Tensor) -> Tensor:
    """:func:`uniform` of every key and its counter for all lanes, where the tensors are.

    Args:
        keys: (L,) int64, the bits of the uint64 keys.
        counters: (L,) int64.
        lanes: (B,) int64.

    Returns:
        (L, B) float64, the same numbers to the bit.
    """
    z = keys[:, None] + (counters[:, None] * 65536 + lanes + 1) * _STEP
    z = (z ^ _shifted(z, 30)) * _FIRST
    z = (z ^ _shifted(z, 27)) * _SECOND
    z = z ^ _shifted(z, 31)
    return _shifted(z, 11).double() * 2.0**-53


def _shifted(z: Tensor, bits: int) -> Tensor:
    """A shift to the right that fills up with zeros: torch's copies the sign."""
    return (z >> bits) & (1 << (64 - bits)) - 1
