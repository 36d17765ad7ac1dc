"""How kernels are compiled: the only place for numba's options and its disk cache.

It is imported when the first kernel is called (:mod:`marouting.kernels`).

Compiled code is kept on disk. Numba considers it fresh as long as the function's own source file
has not changed, although functions of other files are compiled into it. Here it is fresh as long as
nothing that is compiled into it has changed: the files of all functions that it calls, and the
constants that they use (:func:`stamp`). After an upgrade, or an edit of a rule, every loop that
contains the rule is compiled again; an edit of any other file compiles nothing. So is a function
whose file on disk is damaged. Where nothing can be kept on disk, functions are compiled in every
process, and one warning says why.

Some of numba's options and attributes used here are private. If a release of numba lacks them, the
functions are compiled without them: they are slower and give the same results.
"""

import enum
import functools
import hashlib
import os
import pickle
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
from numba import njit, typeof
from numba.extending import typeof_impl

_caching: Any = sys.modules.get("numba.core.caching")
"""Private to numba. Without it, nothing is kept on disk."""

_PRIVATE = {"forceinline", "no_cpython_wrapper", "no_cfunc_wrapper", "_nrt"}
"""Options that numba does not document."""


def _known(options: dict[str, Any]) -> dict[str, Any]:
    """The options, without the private ones if numba does not know all of them."""
    try:
        from numba.core.compiler import Flags
        from numba.core.cpu import CPUTargetOptions

        CPUTargetOptions.parse_as_flags(Flags(), options)  # type: ignore[no-untyped-call]
    except (ImportError, AttributeError, KeyError):
        return {name: value for name, value in options.items() if name not in _PRIVATE}
    return options


def compile_with(function: Callable[..., Any], options: dict[str, Any], kind: Any = None) -> Any:
    """A function compiled by numba, with the result kept on disk.

    Args:
        function: as Python.
        options: numba's.
        kind: the class of the kernels that it may call, see :class:`marouting.kernels.Kernel`.
    """
    if kind is not None:
        _make_known(kind)
    dispatcher = njit(**_known(options))(function)
    try:
        dispatcher._cache = _cache_of(function)
    except (RuntimeError, AttributeError, TypeError, OSError) as error:
        # Either there is nowhere to write, or numba's cache has changed, and stale code could
        # no longer be recognised.
        _not_kept(error)
    return dispatcher


@functools.cache
def _make_known(kind: Any) -> None:
    """In other kernels, a kernel of this class stands for what numba makes of it."""
    register: Any = typeof_impl.register(kind)
    register(lambda kernel, context: typeof_impl(kernel.dispatcher, context))


def _cache_of(function: Callable[..., Any]) -> Any:
    """What keeps the compiled code of a function on disk."""
    cache = _Cache(function)
    files = cache._cache_file
    cache._cache_file = _Files(files._cache_path, cache._impl.filename_base, function)
    return cache


class _Cache(getattr(_caching, "FunctionCache", object)):  # type: ignore[misc]
    """Numba's cache of a function; a file that cannot be written is done without."""

    def save_overload(self, signature: Any, data: Any) -> None:
        try:
            super().save_overload(signature, data)
        except OSError as error:
            _not_kept(error)


class _Files(getattr(_caching, "IndexDataCacheFile", object)):  # type: ignore[misc]
    """The files of a function's cache, with a digest of their content and of the sources."""

    def __init__(self, cache_path: str, filename_base: str, function: Callable[..., Any]) -> None:
        self._function = function
        super().__init__(cache_path, filename_base, None)

    @property
    def _source_stamp(self) -> str:
        """Made when first asked for, since its file may define what the function calls later."""
        return stamp(self._function)

    @_source_stamp.setter
    def _source_stamp(self, value: Any) -> None:
        """Numba sets what it was given."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except Exception:  # damaged files fail in many ways
            return {}

    def _digest(self, code: bytes) -> bytes:
        return hashlib.sha256(self._source_stamp.encode() + code).digest()

    def save(self, key: Any, data: Any) -> None:
        code = self._dump(data)
        super().save(key, (self._digest(code), code))

    def load(self, key: Any) -> Any:
        try:
            digest, code = super().load(key)
            # A process that was killed may have left older code under the name of newer code.
            return pickle.loads(code) if digest == self._digest(code) else None
        except Exception:  # damaged, or not there
            return None


def _not_kept(error: Exception) -> None:
    """Warns, once in a process, that compiled code is not kept on disk."""
    if not _reasons:
        text = f"compiled code is not kept on disk: {' '.join(str(error).split())}"
        warnings.warn_explicit(text, RuntimeWarning, __name__, 1)  # without a line of the source
    _reasons.append(str(error))


_reasons: list[str] = []


@functools.cache
def stamp(function: Callable[..., Any]) -> str:
    """A stamp that tells compiled code of different versions of the sources apart.

    Args:
        function: what is compiled, as Python.

    Returns:
        A digest of the source files of the function, of the functions that it calls and of the
        classes that they use, of the constants that they use, and of the versions of numba and
        llvmlite.
    """
    files = {__file__, function.__code__.co_filename}
    constants = {f"{numba.__version__} {llvmlite.__version__}"}
    packages = {__name__.partition(".")[0], function.__module__.partition(".")[0]}
    seen: set[int] = set()
    todo: list[tuple[str, Any]] = [(function.__name__, function)]
    while todo:
        name, value = todo.pop()
        value = getattr(value, "py_func", getattr(value, "_defn", value))  # as Python
        if isinstance(value, type) and issubclass(value, enum.Enum):
            constants.add(f"{name} {[(member.name, member.value) for member in value]}")
            continue
        module = getattr(value, "__module__", None)
        if isinstance(value, ModuleType) or id(value) in seen:
            continue
        if isinstance(module, str) and module.partition(".")[0] in packages:
            seen.add(id(value))  # a constant may have many names, all of which count
            files.add(getattr(sys.modules.get(module), "__file__", None) or "")
            todo += _used(value)
        elif not callable(value):  # what belongs to other libraries changes with their versions
            text = f"{name} {getattr(value, 'tolist', value.__repr__)()}"
            constants.add(re.sub(r" at 0x[0-9a-f]+", "", text))  # addresses differ by process
    digest = hashlib.sha256("\n".join(sorted(constants)).encode())
    for file in sorted(filter(os.path.isfile, files)):
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()


def _used(value: Any) -> Iterator[tuple[str, Any]]:
    """What a function or a class uses, with its names: a call, a constant, the type of a field."""
    yield from getattr(value, "__annotations__", {}).items()
    if not isinstance(value, FunctionType):
        return
    codes = [value.__code__]
    for code in codes:
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    names = {name for code in codes for name in code.co_names}
    used = {name: value.__globals__[name] for name in names if name in value.__globals__}
    yield from used.items()
    for module in used.values():
        if isinstance(module, ModuleType):
            yield from ((name, getattr(module, name)) for name in names if hasattr(module, name))
    for name, cell in zip(value.__code__.co_freevars, value.__closure__ or (), strict=True):
        yield name, cell.cell_contents


def bound(kernel: Any, *examples: Any) -> Callable[..., Any]:
    """See :func:`marouting.kernels.bound`."""
    key = _key_of(kernel, examples)
    code = _bound.get(key)
    if code is None:
        signature = tuple(map(typeof, examples))
        kernel.compile(signature)
        code = _bound[key] = getattr(kernel.overloads[signature], "entry_point", kernel)
    return code


_bound: dict[tuple[Any, ...], Callable[..., Any]] = {}


def _key_of(kernel: Any, examples: tuple[Any, ...]) -> tuple[Any, ...]:
    """What is the same for arguments of the same types.

    A fingerprint takes microseconds, numba's type of a tuple of arrays a millisecond.
    """
    fingerprint = getattr(sys.modules.get("numba._dispatcher"), "compute_fingerprint", typeof)
    return kernel, *map(fingerprint, examples)
