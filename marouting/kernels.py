"""Kernels: functions that numba compiles, when they are first called.

Only then is numba imported (:mod:`marouting.compiling`). So whoever needs no kernel waits neither
for numba nor for a compiler: the plain game (:mod:`marouting.game`) and the interfaces on it.

A module or package may have a constant ``COMPILES``: what its kernels are together, and about how
many seconds of processor time it takes to compile them, as in ``COMPILES = "the router", 14``. A
line on standard error says so before it begins.
"""

import functools
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np


def simulated() -> bool:
    """Whether this thread belongs to numba's CUDA simulator."""
    return type(threading.current_thread()).__name__ == "BlockThread"


class Kernel:
    """A function that is compiled when it is first called.

    Attributes:
        py_func: the function as Python.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self._options = function, options

    @functools.cached_property
    def dispatcher(self) -> Any:
        """What numba makes of the function, to be called from Python."""
        from marouting.compiling import compile_with

        return compile_with(self.py_func, self._options, Kernel, part=False)

    @functools.cached_property
    def part(self) -> Any:
        """What numba makes of it, to be called by other kernels."""
        from marouting.compiling import compile_with

        return compile_with(self.py_func, self._options, Kernel, part=True)

    def __call__(self, *arguments: Any) -> Any:
        """Calls it; the first time it is compiled. In numba's CUDA simulator it stays Python."""
        if simulated():
            return self.py_func(*arguments)
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # whoever asks whether there is a protocol need not compile
            raise AttributeError(name)
        return getattr(self.dispatcher, name)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that makes a kernel with these options of numba's."""
    return lambda function: Kernel(function, options)


compiled = kernel(nogil=True, error_model="numpy", _nrt=False)
"""For kernels that allocate nothing: cached on disk, without the interpreter's lock, and without
reference counts of arrays. Counting references at every call of a rule would take ten times as long
as the rule itself."""

inlined = kernel(nogil=True, error_model="numpy", _nrt=False, forceinline=True)
"""Like ``compiled``, for what a move is made of: the compiler is told to put it where it is called.
A move of one agent then takes a fifth less time, and compiling takes longer."""

allocating = kernel(nogil=True, error_model="numpy")
"""For kernels that make arrays. They divide like NumPy, because checking every divisor for zero
would keep loops from being vectorised."""

threaded = kernel(error_model="numpy", parallel=True)
"""Like ``allocating``, with loops over ``numba.prange`` shared among numba's threads. Numba's cache
ignores options, so a threaded kernel has to be a separate function."""

if TYPE_CHECKING:

    def i64(index: Any) -> int:
        """An index from an array as int64.

        Numba compiles a function again for every combination of integer types that it is called
        with, and for every integer that is written out. Widened, all indices have the same type.
        """

else:
    i64 = np.int64


@compiled
def as_index(index: Any) -> int:
    """A non-negative index as int64: numba need not check whether it counts from the end."""
    return np.int64(np.uint32(index))  # type: ignore[return-value]


@compiled
def mixed(z: Any) -> Any:
    """64 pseudo-random bits, a function of a number, both uint64: the finisher of SplitMix64.

    Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
    """
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def specialised(kernel: Any, *examples: Any) -> Callable[..., Any]:
    """The machine code of a kernel, for arguments of the types of the examples.

    Numba looks up the types of all arguments at every call. For the engine's tuples, this takes
    several times as long as a move. Where numba offers no such code it is the kernel itself.
    """
    from marouting.compiling import specialised

    return specialised(kernel, *examples)
