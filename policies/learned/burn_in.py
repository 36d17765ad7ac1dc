"""Whose moves fill the replay memory before the first gradient step (paper, section 3.5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution
from marouting.game.engine import Engine
from marouting.search.astar import AStar
from marouting.search.route_follower import RouteFollower
from policies.routers.registry import has_seed, make_router

GUIDES = ("astar", "random", "pathfinder", "optimal")
"""What ``burn_in`` can be by name; anything else is a file or a folder."""


class Guide(Protocol):
    """Moves agents of a running game."""

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """(K,) int8 moves of K agents; NOBODY for one that is not active."""
        ...


def guide(burn_in: str, problems: Mapping[str, Problem], engine: Engine, seed: int) -> Guide | None:
    """Who moves the agents in the burn-in.

    Args:
        burn_in: ``astar``: every move is A*'s, with the capacities as they are; ``random``; another
            router's name: its solution is replayed
            (:class:`marouting.search.route_follower.RouteFollower`); or a solution file, or a
            folder with a file ``NAME.solution`` or ``NAME.*.solution`` for every problem.
        problems: the engine's problems by name.
        engine: the game.
        seed: where the router's random numbers start.

    Returns:
        Who moves them; None for random moves.

    Raises:
        InputError: there is no such guide, or a solution cannot be read or does not fit.
    """
    if burn_in == "random":
        return None
    if burn_in == "astar":
        return AStar(engine)
    if burn_in in GUIDES:
        router = make_router(burn_in, {"seed": seed} if has_seed(burn_in) else {})
        return RouteFollower(engine, [router.route(problem) for problem in problems.values()])
    paths = solution_files(burn_in, tuple(problems))
    return RouteFollower(engine, list(map(Solution.read, paths, problems.values())))


def solution_files(burn_in: str, names: Sequence[str]) -> list[Path]:
    """The files that a burn-in replays, one for each problem; none if it replays no files.

    Raises:
        InputError: there are no such files.
    """
    if burn_in in GUIDES:
        return []
    path = Path(burn_in)
    if not path.exists():
        raise InputError(
            f"burn_in: expected one of {', '.join(GUIDES)}, or a solution file or a folder of "
            f"them, found {burn_in!r}"
        )
    if path.is_dir():
        return [_file(path, name) for name in names]
    if len(names) > 1:
        raise InputError(f"burn_in: {path}: expected a folder, with a solution for each problem")
    return [path]


def _file(folder: Path, name: str) -> Path:
    """The one solution file of a problem in a folder."""
    found = sorted({*folder.glob(f"{name}.solution"), *folder.glob(f"{name}.*.solution")})
    if len(found) != 1:
        raise InputError(
            f"burn_in: {folder}: expected one file {name}.solution or {name}.*.solution, "
            f"found {len(found)}"
        )
    return found[0]
