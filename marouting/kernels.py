"""How hot loops are compiled, and what their arrays are indexed with."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, typeof

compiled = njit(cache=True, nogil=True, _nrt=False)  # type: ignore[call-overload]
"""How kernels are compiled: to disk, and without counting references to arrays. No kernel
allocates; counting at every call of a rule of the game would take ten times as long as the rule."""

inlined = njit(  # type: ignore[call-overload]
    cache=True, _nrt=False, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True
)
"""For functions inside the loops of others: a call would hand over a dozen arrays. They have no
entry from Python, which takes as long to compile as they do."""


@inlined
def wide(index: Any) -> int:
    """An index out of an array as int64.

    Numba compiles a function anew for every combination of integer types that it is called with;
    widened where they come out of arrays, all indices have one type.
    """
    return np.int64(index)  # type: ignore[return-value]


@inlined
def place(index: Any) -> int:
    """An index that is not negative, as int64.

    Numba lets a negative index count from the end, and looking for one takes as long as the rest
    of an access.
    """
    return np.int64(np.uint32(index))  # type: ignore[return-value]


def bound(kernel: Any, *examples: Any) -> Callable[..., Any]:
    """The machine code of a compiled function, for arguments of the types of the examples.

    Numba looks up the types of all arguments at every call, which for the engine's tuples takes
    several times as long as a move. What is returned looks up nothing: it has to be called with
    the types, dimensions and memory layouts of the examples.
    """
    signature = tuple(map(typeof, examples))
    kernel.compile(signature)
    code: Callable[..., Any] = kernel.overloads[signature].entry_point
    return code
