"""The benchmark's problems: named, versioned scenarios.

>>> from marouting import scenarios
>>> toy = scenarios.get("toy-4x4-v0")
>>> problem = toy.test[0]
>>> overflow, wirelength, proven = toy.reference(problem)
>>> new = next(toy.train(seed=0))

Problems are drawn by a generator from seeds, the same on every machine; only the references, what
is known about the best solution of each validation and test problem, are stored. What a ``-v0``
gives never changes: a changed scenario gets a new version. ``docs/scenarios.md`` compares them.

Your own generator becomes a scenario by :func:`register`; docs/scenarios.md has an example.
Where options or commands name a scenario, ``module:NAME`` stands for one in a module of yours.
"""

from typing import Any

from marouting.config import check
from marouting.errors import InputError, nearest
from marouting.registry import imported
from marouting.scenarios.cooperation import COOPERATION
from marouting.scenarios.digests import digest, mirror_digest
from marouting.scenarios.planning import PLANNING, RandomNets
from marouting.scenarios.references import Best, Reference
from marouting.scenarios.scenario import SPLITS, Generator, Scenario, Split, routable

__all__ = [
    "COOPERATION", "PLANNING", "SHIPPED", "SPLITS", "Best", "Generator", "RandomNets", "Reference",
    "Scenario", "Split", "digest", "get", "load", "loaded", "mirror_digest", "names", "register",
    "routable",
]  # fmt: skip

SHIPPED = {scenario.name: scenario for scenario in (*PLANNING, *COOPERATION)}
"""The scenarios of the package by name."""

_known = dict(SHIPPED)
_imported: dict[str, Scenario] = {}  # by module:NAME


def names() -> list[str]:
    """The names of all scenarios: those for planners, those for policies, registered ones."""
    return list(_known)


def get(name: str) -> Scenario:
    """The scenario of a name, the same object every time.

    Raises:
        InputError: there is no such scenario.
    """
    check("scenario", not isinstance(name, Scenario), f"a name, found the object {name!r}")
    found = {**_known, **_imported}.get(name) if isinstance(name, str) else None
    if found is None:
        hint = nearest(str(name), names(), cutoff=0.4)
        raise InputError(f"scenario: {hint}expected one of {', '.join(names())}, found {name!r}")
    return found


def load(name: str) -> Scenario:
    """:func:`get`, which also takes ``module:NAME`` and imports the module, which is code.

    From then on the scenario is known by its own name as well.

    Raises:
        InputError: there is no such scenario, or another one has its name.
    """
    if isinstance(name, str) and ":" in name and name not in _imported:
        found = imported(name, "scenario: ")
        if not isinstance(found, Scenario):
            module, _, own = name.partition(":")
            raise InputError(f"scenario: {name}: there is no scenario {own} in {module}")
        what = f"a name that no other scenario has, found {found.name}"
        check(f"scenario: {name}", _known.setdefault(found.name, found) is found, what)
        _imported[name] = found
    return get(name)


def loaded() -> list[str]:
    """Each ``module:NAME`` that :func:`load` has imported, for another process to load."""
    return list(_imported)


def register(name: str, generator: Generator, **options: Any) -> Scenario:
    """Makes the problems of a generator a scenario, which all interfaces then find by its name.

    Args:
        name: the name; registering it again replaces the scenario. End it with a version, such as
            ``-v0``, and give it a new one when the problems change: they depend on the name.
        generator: a function that draws a problem with the random numbers of a NumPy
            ``Generator``, and with nothing else.
        options: further arguments of :class:`Scenario`, such as ``validation``, ``test``, ``env``
            and ``accept``.

    Returns:
        The scenario.

    Raises:
        InputError: a scenario of the package has this name, or an argument cannot be used.
    """
    scenario = Scenario(name, generator, **options)
    check("name", name not in SHIPPED, f"another one: the package has a scenario {name}")
    _known[name] = scenario
    return scenario
