"""Whose moves fill the replay memory before the first gradient step (paper, section 3.5)."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution
from marouting.batch.engine import Engine
from marouting.config import component
from marouting.files import exists, is_dir, stem_of, suffix_of
from marouting.registry import names
from marouting.search.guides import AStar, RouteFollower

GUIDES = ("astar", "random")
"""Guides that compute moves one by one; of other routers the solution is replayed."""


class Guide(Protocol):
    """Moves agents of a running game."""

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """(K,) int8 moves of K agents; NOBODY for one that is not active."""
        ...


def guide(
    burn_in: str,
    problems: Mapping[str, Problem],
    engine: Engine,
    seed: int,
    replayed: Sequence[Solution] = (),
) -> Guide | None:
    """The guide that moves the agents in the burn-in.

    Args:
        burn_in: ``astar``: A* computes every move at the present capacities; ``random``; the
            name of another router, whose solution is replayed
            (:class:`marouting.search.guides.RouteFollower`); or a solution file, or a
            folder with a file ``NAME.solution`` or ``NAME.*.solution`` for every problem.
        problems: by name; the engine has the same number of games of each, in this order.
        engine: the games.
        seed: where the router's random numbers start.
        replayed: the solutions in the files, see :func:`read_solutions`.

    Returns:
        The guide; None for random moves.

    Raises:
        InputError: a router cannot route a problem.
    """
    if burn_in == "random":
        return None
    if burn_in == "astar":
        return AStar(engine)
    if burn_in in names("router"):
        chosen: dict[str, Any] = {"kind": burn_in}
        if any(f.name == "seed" for f in fields(component("router", chosen).options)):
            chosen["seed"] = seed
        router = component("router", chosen).make()
        replayed = [router.route(problem) for problem in problems.values()]
    copies = len(engine.problems) // len(problems)
    return RouteFollower(engine, [solution for solution in replayed for _ in range(copies)])


def read_solutions(burn_in: str, problems: Mapping[str, Problem]) -> list[Solution]:
    """The solutions that a burn-in replays from files, one for each problem; none for a router.

    Raises:
        InputError: there is no such guide, or a solution cannot be read or does not fit.
    """
    if burn_in in (*GUIDES, *names("router")):
        return []
    path = Path(burn_in)
    if not exists(path):
        raise InputError(
            f"burn_in: expected one of {', '.join(dict.fromkeys((*GUIDES, *names('router'))))}, "
            f"or a solution file or a folder of them, found {burn_in!r}"
        )
    if is_dir(path):
        return [Solution.read(_file(path, name), problem) for name, problem in problems.items()]
    if len(problems) > 1:
        raise InputError(f"burn_in: {path}: expected a folder, with a solution for each problem")
    return [Solution.read(path, problem) for problem in problems.values()]


def _file(folder: Path, name: str) -> Path:
    """The one solution file of a problem in a folder."""
    found = [
        file
        for file in folder.glob("*")
        if suffix_of(file) == ".solution" and f"{stem_of(file)}.".startswith(f"{name}.")
    ]
    if len(found) != 1:
        raise InputError(
            f"burn_in: {folder}: expected one file {name}.solution or {name}.*.solution, "
            f"found {len(found)}"
        )
    return found[0]
