"""The routers by name, made from plain options: for the command line and for experiments.

A router's module is imported when the router is asked for; torch comes with ``dqn`` alone.
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pkgutil import resolve_name
from typing import Any

from marouting.config import build
from marouting.errors import InputError
from policies.routers.base import Router


@dataclass(frozen=True)
class _Kind:
    """Where a router is found, as ``module:name``.

    Attributes:
        router: its class.
        options: the dataclass of its options, the one argument of the router; None: the router is
            a dataclass of options itself.
    """

    router: str
    options: str | None = None


_ROOM = "policies.routers"
_KINDS = {
    "astar": _Kind(f"{_ROOM}.astar:AStarRouter"),
    "random": _Kind(f"{_ROOM}.random:RandomRouter"),
    "pathfinder": _Kind(
        f"{_ROOM}.pathfinder:PathfinderRouter", f"{_ROOM}.pathfinder:PathfinderOptions"
    ),
    "optimal": _Kind(f"{_ROOM}.optimal:OptimalRouter"),
    "dqn": _Kind("policies.learned.router:DQNRouter", "policies.learned.config:Config"),
}

ROUTERS = tuple(_KINDS)
"""The names."""


def unknown(what: str, found: str, known: tuple[str, ...]) -> InputError:
    """The InputError for a name that is none of those known: it suggests the nearest."""
    close = difflib.get_close_matches(found, known, n=1)
    expected = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(known)}"
    return InputError(f"{what}: unknown name {found!r}; {expected}")


def schema(name: str) -> type[Any]:
    """The dataclass of a router's options; raises InputError for an unknown name."""
    if name not in _KINDS:
        raise unknown("router", name, ROUTERS)
    kind = _KINDS[name]
    found: type[Any] = resolve_name(kind.options or kind.router)
    return found


def has_seed(name: str) -> bool:
    """Whether ``seed`` is one of a router's options."""
    return any(field.name == "seed" for field in fields(schema(name)))


def is_seeded(name: str, options: Mapping[str, Any]) -> bool:
    """Whether a router draws random numbers, with these of its options.

    One that does with some options alone has a property ``seeded``.
    """
    return has_seed(name) and getattr(build(schema(name), options), "seeded", True)


def make_router(name: str, options: Mapping[str, Any], where: str = "") -> Router:
    """A router from plain options, as from YAML.

    Args:
        name: one of ``ROUTERS``.
        options: fields of its :func:`schema`; what is left out has the default there.
        where: what the message of an error starts with.

    Raises:
        InputError: an unknown router or option, or a value that the option does not take.
    """
    built = build(schema(name), options, where)
    kind = _KINDS[name]
    if kind.options is not None:
        built = resolve_name(kind.router)(built)
    router: Router = built
    return router
