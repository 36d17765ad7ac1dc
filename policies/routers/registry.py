"""Routers by name with plain options, as the command line and experiments give them.

A problem is routed by a registered router, by a registered learner, which is trained for it, or by
``module:Class``, which names either.
"""

import inspect
from collections.abc import Mapping
from typing import Any, TypeVar

from marouting.config import Component, component
from marouting.errors import InputError, nearest
from marouting.registry import lookup, names
from policies.routers.base import Router

Found = TypeVar("Found")


def router_names() -> tuple[str, ...]:
    """The names of routers and learners, which are trained to route."""
    return tuple(dict.fromkeys((*names("router"), *names("learner"))))


_LABELS = {
    "astar": "A*",
    "pathfinder": "negotiated congestion",
    "optimal": "optimum",
    "random": "random walks",
}


def router_label(name: str) -> str:
    """What figures call a router: the field's name for ours, and any other name as it is.

    A learner's name is an abbreviation. With ``_policy`` after it, it is the saved policy of a
    training, walked without exploration.
    """
    learner = name.removesuffix("_policy")
    if learner in names("learner"):
        return learner.upper() + (", saved policy" if learner != name else "")
    return _LABELS.get(name, name)


def by_label(items: Mapping[str, Found]) -> dict[str, Found]:
    """Things of routers by what figures call these; by their names if two were called alike."""
    called = {router_label(name): thing for name, thing in items.items()}
    return dict(items) if len(called) < len(items) else called


def unknown(what: str, found: str, known: tuple[str, ...]) -> InputError:
    """The InputError for an unknown name: it suggests the nearest and lists what there is."""
    hint = nearest(found, known)
    return InputError(f"{what}: unknown name {found!r}; {hint}expected one of {', '.join(known)}")


def is_learner(name: str, where: str = "router") -> bool:
    """Whether a name stands for a learner and not for a router.

    Raises:
        InputError: it stands for neither; the message starts with ``where``.
    """
    if name in names("learner"):
        return True
    if name not in names("router") and ":" not in name:
        raise unknown(where, name, (*router_names(), "module:Class"))
    cls = lookup("router", name, where)
    if not any(hasattr(cls, method) for method in ("route", "moves", "start")):
        expected = "a class with a method route or moves, or a learner"
        raise InputError(f"{where}: {name}: expected {expected}")
    return hasattr(cls, "start") and not (hasattr(cls, "route") or hasattr(cls, "moves"))


def has_seed(name: str) -> bool:
    """Whether a router has an option ``seed``."""
    cls = lookup("router", name)
    return "seed" in inspect.signature(getattr(cls, "Options", cls)).parameters


def is_seeded(router: Component) -> bool:
    """Whether a router with these options draws random numbers."""
    return has_seed(router.name) and bool(getattr(router.options, "seeded", True))


def router_component(name: str, options: Mapping[str, Any], where: str = "") -> Component:
    """A router with its options checked, before it is made.

    Args:
        name: a name of a router, or ``module:Class``.
        options: the router's options as plain data; the others have their defaults.
        where: what an error message starts with.

    Raises:
        InputError: an unknown router or option, or a value that the option does not take.
    """
    try:
        return component("router", {**options, "kind": name})
    except InputError as error:
        raise InputError(f"{where}: {error}" if where else str(error)) from None


def make_router(name: str, options: Mapping[str, Any], where: str = "") -> Router:
    """A router from plain options; see :func:`router_component`."""
    router: Router = router_component(name, options, where).make()
    return router
