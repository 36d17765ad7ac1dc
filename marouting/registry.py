"""Components by name: finds the class that a configuration names.

Users can write five kinds of components: observations, rewards, routers, learners and networks.
Wherever a name is expected, ``module:Class`` is accepted as well.

A name comes from one of two places:

* :func:`register`, called by the package itself and by users;
* an entry point of an installed package, in the group ``marouting.KIND``::

      [project.entry-points."marouting.reward"]
      selfless = "my_package.rewards:Selfless"

``module:Class`` is code, which is imported. In Python and on the command line it comes from
the user. A file may come from somebody else, so :func:`marouting.config.check_code` refuses such
names in files unless :func:`allowing_code` is in force (``--allow-code``, ``allow_code=True``).
"""

import contextlib
import functools
import importlib
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from importlib import metadata
from typing import Any

from marouting.errors import InputError, nearest

KINDS = ("observation", "reward", "router", "network", "learner")
"""The kinds of components that can be registered."""

_allowed: ContextVar[bool | frozenset[str]] = ContextVar("allowed", default=False)

_folder: ContextVar[str | None] = ContextVar("folder", default=None)

_HOMES = {"observation": "marouting.observations", "reward": "marouting.rewards"}
"""The modules that register this package's own components."""

_PACKAGE = ("marouting.", "policies.")
"""How the paths of the package's own components begin."""

_registered: dict[str, dict[str, type[Any] | str]] = {kind: {} for kind in KINDS}


ENVIRONMENT_ID = "marouting/GlobalRouting-v0"
"""What Gymnasium and PettingZoo call the environment."""


@functools.cache
def register_environments() -> None:
    """Makes the environment known to Gymnasium and PettingZoo, which takes a tenth of a second."""
    import gymnasium

    gymnasium.register(
        ENVIRONMENT_ID,
        entry_point="marouting.env.single:GlobalRoutingSingle",
        vector_entry_point="marouting.gym_vector:GlobalRoutingVector",
    )
    try:  # PettingZoo has a registry from version 1.27 on
        from pettingzoo import register
    except ImportError:
        return
    register("aec", ENVIRONMENT_ID, "marouting.global_routing_v0:env")
    register("parallel", ENVIRONMENT_ID, "marouting.global_routing_v0:parallel_env")


def register(kind: str, name: str, cls: type[Any] | str) -> None:
    """Gives a class a name that configurations and commands can use.

    Args:
        kind: one of :data:`KINDS`.
        name: the name, which no component of the package has. A second registration replaces the
            first.
        cls: the class, or ``module:Class``, which is imported when it is first used.

    Raises:
        InputError: there is no such kind, the name contains a colon, or a component of the package
            has it.
    """
    _check_kind(kind)
    if not isinstance(name, str) or not name or ":" in name:
        raise InputError(f"{kind}: expected a name without a colon, found {name!r}")
    if not isinstance(cls, type | str):
        raise InputError(f"{kind}: expected a class or module:Class, found {cls!r}")
    # The package may register its own components after the user did.
    paths = {_path(cls), _path(_registered[kind].get(name, cls))}
    if len(paths) > 1 and any(path.startswith(_PACKAGE) for path in paths):
        raise InputError(
            f"{kind}: expected a name that no {kind} of the package has, found {name!r}"
        )
    _registered[kind][name] = cls


def names(kind: str) -> tuple[str, ...]:
    """All names of a kind: registered ones first, then those of installed packages."""
    _check_kind(kind)
    return tuple(dict.fromkeys((*_registered[kind], *_entry_points(kind))))


def registered() -> list[tuple[str, str, str]]:
    """What this process has registered, as arguments of :func:`register` for another process."""
    for kind in KINDS:
        _check_kind(kind)
    return [
        (kind, name, _path(cls))
        for kind, known in _registered.items()
        for name, cls in known.items()
    ]


def lookup(kind: str, name: str, where: str = "") -> type[Any]:
    """The class of a name or ``module:Class``; raises InputError, beginning with ``where``."""
    _check_kind(kind)
    prefix = f"{where}: " if where else ""
    found = _registered[kind].get(name)
    if found is None and name in (points := _entry_points(kind)):
        found = points[name]
    if found is None:
        if ":" not in name:
            raise InputError(
                f"{prefix}unknown {kind} {name!r}; {nearest(name, names(kind))}"
                f"expected module:Class or one of {', '.join(names(kind))}"
            )
        found, cls = name, imported(name, prefix)
    elif not isinstance(found, str):
        return found
    else:
        cls = _imported(found, prefix)
    if not isinstance(cls, type):
        module, _, qualified = found.partition(":")
        raise InputError(f"{prefix}{found}: there is no class {qualified} in {module}")
    return cls


@contextlib.contextmanager
def allowing_code(which: bool | Iterable[str] = True) -> Iterator[None]:
    """Within the block, lets files name any code (True), no more (False) or these classes too."""
    before = _allowed.get()
    if not isinstance(which, bool) and not isinstance(before, bool):
        which = before.union(which)
    wider = which if isinstance(which, bool) else frozenset(which)
    token = _allowed.set(True if before is True else wider or before)
    try:
        yield
    finally:
        _allowed.reset(token)


def code_allowed() -> bool | frozenset[str]:
    """Which classes files may name now, in the form that :func:`allowing_code` takes."""
    return _allowed.get()


@contextlib.contextmanager
def importing_from(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Within the block, imports of ``module:Class`` also search a folder, after all others.

    The folder is added to the search path at the first such import, so nothing else is imported
    from it before.
    """
    token = _folder.set(os.fspath(folder))
    try:
        yield
    finally:
        _folder.reset(token)


def name_of(kind: str, cls: type[Any]) -> str:
    """The registered name of a class, or else ``module:Class``."""
    path = _path(cls)
    for name, found in _registered[kind].items():
        if found is cls or found == path:
            return name
    return path


def _path(cls: type[Any] | str) -> str:
    """``module:Class``."""
    return cls if isinstance(cls, str) else f"{cls.__module__}:{cls.__qualname__}"


def _check_kind(kind: str) -> None:
    if kind not in KINDS:
        raise InputError(f"kind: expected one of {', '.join(KINDS)}, found {kind!r}")
    if (home := _HOMES.get(kind)) is not None:
        importlib.import_module(home)


@functools.cache
def _entry_points(kind: str) -> dict[str, str]:
    """``module:Class`` by name, from the packages installed when this is first called."""
    return {point.name: point.value for point in metadata.entry_points(group=f"marouting.{kind}")}


def imported(path: str, prefix: str = "") -> Any:
    """What a user has at ``module:Name``, or None; raises InputError if there is no such module."""
    if (folder := _folder.get()) is not None and folder not in sys.path:
        sys.path.append(folder)
        register_environments()  # which the user's code may make by name
    return _imported(path, prefix)


def is_ours(module: str) -> bool:
    """Whether a module, or ``module:Name``, is of this project, and not of a user."""
    return re.split("[.:]", module)[0] in ("marouting", "policies")


def _imported(path: str, prefix: str) -> Any:
    """The object at ``module:Name``, or None; raises InputError if there is no such module."""
    module, _, qualified = path.partition(":")
    try:
        found: Any = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise  # the module exists, but a module that it imports does not
        raise InputError(f"{prefix}{path}: there is no module {error.name}") from None
    except ValueError:
        raise InputError(f"{prefix}{path}: expected module:Class") from None
    for part in qualified.split("."):
        found = getattr(found, part, None)
    return found
