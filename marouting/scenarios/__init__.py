"""The benchmark's problems: named, versioned scenarios of growing difficulty.

>>> from marouting import scenarios
>>> toy = scenarios.get("toy-4x4-v0")
>>> problem = toy.test[0]
>>> overflow, wirelength, proven = toy.reference(problem)
>>> new = next(toy.train(seed=0))

A scenario is a row of parameters (:data:`marouting.scenarios.levels.LEVELS`). Its problems are
generated from these and from seeds, the same on every machine; only the references, what is known
about the best solution of each validation and test problem, are stored. What a ``-v0`` gives never
changes: a changed scenario gets a new version. ``docs/scenarios.md`` compares them.
"""

import functools

from marouting.errors import InputError, nearest
from marouting.scenarios.digests import digest
from marouting.scenarios.levels import LEVELS, Level
from marouting.scenarios.references import Best, Reference
from marouting.scenarios.scenario import SPLITS, Scenario, Split

__all__ = [
    "SPLITS", "Best", "Level", "Reference", "Scenario", "Split", "digest", "get", "names",
]  # fmt: skip


def names() -> list[str]:
    """The names of all scenarios, easiest first."""
    return [level.name for level in LEVELS]


@functools.cache
def _scenario(level: Level) -> Scenario:
    return Scenario(level)


def get(name: str) -> Scenario:
    """The scenario of a name, the same object every time.

    Raises:
        InputError: there is no such scenario.
    """
    for level in LEVELS:
        if level.name == name:
            return _scenario(level)
    hint = nearest(str(name), names(), cutoff=0.4)
    raise InputError(f"scenario: {hint}expected one of {', '.join(names())}, found {name!r}")
