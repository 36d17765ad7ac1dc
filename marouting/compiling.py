"""How kernels are compiled: the only place for numba's options and its disk cache.

It is imported when the first kernel is called (:mod:`marouting.kernels`).

Compiled code is cached on disk. Numba's own cache only checks the function's own source file,
although functions of other files are compiled into it. Here an entry is valid as long as the files
of all functions that it calls, and the constants that they use, have not changed (:func:`stamp`).
An edit of a rule recompiles every loop that contains the rule and nothing else. A damaged entry is
compiled again. If the cache cannot be written, functions are compiled in every process, and one
warning says why.

Numba compiles every function to machine code, together with all functions that it calls. For
functions that only kernels call, LLVM's code is kept instead and optimised once, as a part of the
kernel that Python calls.

This uses private parts of numba, so pyproject.toml pins its release.
"""

import enum
import functools
import gc
import hashlib
import importlib
import os
import pickle
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite.binding
import numba
from numba import njit, typeof
from numba._dispatcher import compute_fingerprint
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.extending import typeof_impl
from numba.np import linalg

# Numba imports SciPy, which takes as long as all kernels, only to see whether there is a BLAS.
_ensure_blas, linalg.ensure_blas = linalg.ensure_blas, lambda: None
importlib.import_module("numba.np.arraymath")
linalg.ensure_blas = _ensure_blas


def compile_with(
    function: Callable[..., Any], options: dict[str, Any], kind: Any, *, part: bool
) -> Any:
    """A function compiled by numba and kept on disk; a ``part`` is for kernels that call it."""
    _make_known(kind)
    options = options | {"no_cfunc_wrapper": True, "no_cpython_wrapper": part}
    pipeline = _PartCompiler if part else _WholeCompiler
    dispatcher: Any = njit(**options, pipeline_class=pipeline)(function)
    try:
        dispatcher._cache = _cache_of(function, part)
    except (RuntimeError, OSError) as error:  # there is nowhere to write
        _not_kept(error)
    return dispatcher


class _Part(JITCodeLibrary):
    """The code of a function that kernels call: LLVM's, made machine code only within theirs."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True
        self._get_module_for_linking()
        module = self._final_module
        environments = (
            str(one) for one in module.global_variables if one.name.startswith("_ZN08NumbaEnv")
        )
        self._final_module = llvmlite.binding.parse_assembly("\n".join(environments))
        self._final_module.name, self._final_module.triple = module.name, module.triple
        super()._finalize_final_module()


class _PartCompiler(Compiler):
    """Compiles a function that kernels call."""

    def __init__(self, typing: Any, target: Any, library: Any, *arguments: Any) -> None:
        library = _Part(target.codegen(), "part")
        library.enable_object_caching()
        super().__init__(typing, target, library, *arguments)


class _WholeCompiler(Compiler):
    """Compiles a function that Python calls, with all that it calls; says so before."""

    def compile_extra(self, function: Callable[..., Any]) -> Any:
        _announce(function.__module__)
        collecting = gc.isenabled()
        gc.disable()  # looking for garbage would take a tenth of the time, and there is little
        try:
            return super().compile_extra(function)
        finally:
            if collecting:
                gc.enable()


def _announce(module: str) -> None:
    """Says, once in a process, what a module or its package compiles, and for how long."""
    while module:
        compiles = getattr(sys.modules.get(module), "COMPILES", None)
        if compiles is not None and compiles not in _said:
            _said.add(compiles)
            what, seconds = compiles
            text = f"compiling {what}, each variant once per version: about {seconds} s"
            print(text, file=sys.stderr, flush=True)
        module = "" if compiles else module.rpartition(".")[0]


_said: set[tuple[str, int]] = set()


@functools.cache
def _make_known(kind: Any) -> None:
    """Lets one kernel call another: numba sees the callee's dispatcher."""
    register: Any = typeof_impl.register(kind)
    register(lambda kernel, context: typeof_impl(kernel.part, context))


def _cache_of(function: Callable[..., Any], part: bool) -> Any:
    """What keeps the compiled code of a function on disk."""
    cache = _Cache(function)
    name = cache._impl.filename_base + (".part" if part else "")
    cache._cache_file = _Files(cache._cache_file._cache_path, name, function)
    return cache


class _Cache(FunctionCache):
    """Numba's cache of a function; a file that cannot be written is done without."""

    def save_overload(self, signature: Any, data: Any) -> None:
        try:
            super().save_overload(signature, data)
        except OSError as error:
            _not_kept(error)


class _Files(IndexDataCacheFile):
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


def specialised(kernel: Any, *examples: Any) -> Callable[..., Any]:
    """See :func:`marouting.kernels.specialised`."""
    # A fingerprint takes microseconds, numba's type of a tuple of arrays a millisecond.
    key = kernel, *map(compute_fingerprint, examples)
    code = _bound.get(key)
    if code is None:
        signature = tuple(map(typeof, examples))
        kernel.compile(signature)
        code = _bound[key] = kernel.overloads[signature].entry_point
    return code


_bound: dict[tuple[Any, ...], Callable[..., Any]] = {}
