"""A check by experiment that agents see no further than their observation says.

The game is changed wherever an agent cannot see (:func:`marouting.observations.local_radius_of`),
and what it sees must stay the same. It is a check and no proof: the more states of a game it is
made in, the more it says.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.state import Option
from marouting.errors import InputError
from marouting.game import ACTIVE, NOBODY, Status
from marouting.observations import Observation, local_radius_of, space_of
from marouting.problem.grid import VIA_AXIS
from marouting.problem.problem import Problem

_SETS = (Option.TREE, Option.VISITED, Option.TAKEN, Option.BEGUN)
_FIGURES = ("active", "joined", "steps", "overflow", "wirelength")


def check_local(
    observation: Observation,
    engine: Engine,
    most: int | None = None,
    *,
    agents: int = 100,
    seed: int = 0,
) -> None:
    """Checks in the present state of games that active agents see only their surroundings.

    Args:
        observation: what agents see, with a method ``write``.
        engine: the games, which are not changed.
        most: the largest ``local_radius`` that is allowed; None: any.
        agents: how many active agents are checked, if there are so many.
        seed: decides which ones, and what is changed beyond what they see.

    Raises:
        InputError: the observation has no ``local_radius`` or a larger one than ``most``, or agents
            see further than it says.
    """
    name, radius = type(observation).__name__, local_radius_of(observation)
    if radius is None or (most is not None and radius > most):
        expected = "a whole number" if most is None else f"at most {most}"
        found = "None: agents may see everything" if radius is None else radius
        raise InputError(f"{name}.local_radius: expected {expected}, found {found}")
    rng = np.random.default_rng(seed)
    shape = space_of(observation, engine.problems, engine.static.overflow_allowed).shape
    for m, n in rng.permutation(np.argwhere(engine.agents["status"] == ACTIVE))[:agents].tolist():
        rows = np.zeros((2, 1, *shape), np.float32)
        who, first = np.array([n], np.int32), np.zeros(1, np.int32)
        observation.write(engine, first + np.int32(m), who, rows[0])
        observation.write(_changed(engine, m, n, radius, rng), first, who, rows[1])
        if not np.array_equal(rows[0], rows[1], equal_nan=True):
            expected = f"expected agents to see no further than {radius} Gcells"
            raise InputError(f"{name}.local_radius: {expected}; agent {n} of problem {m} does")


def _changed(engine: Engine, m: int, n: int, radius: int, rng: np.random.Generator) -> Engine:
    """An engine of problem m alone, changed wherever agent n cannot see."""
    twin = engine.part(np.array([m]))
    static = twin.static = twin.static._replace(tasks=twin.static.tasks.copy())
    dynamic, agents = twin.dynamic, twin.agents[0]
    apart = np.abs(static.position - static.position[agents["cell"][n]])[:, :VIA_AXIS]
    near = (apart <= radius).all(axis=1)  # (G,)
    ahead = static.neighbour[:, ::2]  # (G, 3), or OFF_GRID, which is no place to see from
    far_edges = np.flatnonzero(~(near[:, None] | near[ahead]).reshape(-1) & engine.grid.exists)
    others = np.flatnonzero((engine.nets[m] != NOBODY) & (np.arange(len(agents)) != n))

    for edges in (dynamic.remaining, static.capacity):
        edges[0, far_edges] = rng.integers(-2, 9, len(far_edges))
    history = int(static.options[Option.HISTORY])
    if history >= 0:
        dynamic.numbers[0, history + far_edges] = rng.integers(0, 9, len(far_edges))
    for other in others.tolist():
        _change_agent(twin, other, near, far_edges, rng)
    static.demand[0, others] = rng.integers(0, 9, static.demand[0, others].shape)
    for figure in _FIGURES:
        twin.games[figure] = rng.integers(0, 99)
    twin._held[0] = _changed_problem(twin.problems[0], int(twin.nets[0, n]), rng)
    return twin


def _change_agent(
    twin: Engine,
    other: int,
    near: NDArray[np.bool_],
    far_edges: NDArray[np.int64],
    rng: np.random.Generator,
) -> None:
    """Changes another agent: where it is, unless that is seen, and all else about it."""
    static, dynamic, agent = twin.static, twin.dynamic, twin.agents[0, other]
    gcells = len(near)
    if not near[agent["cell"]] and not near.all():
        agent["cell"] = rng.choice(np.flatnonzero(~near))
        agent["status"] = rng.choice([ACTIVE, Status.TERMINATED, Status.TRUNCATED])
        agent["message"] = rng.integers(256)
    first, end = static.first[0, other : other + 2].tolist()
    static.tasks[first:end] = rng.integers(0, gcells, (end - first, 2))
    agent["target"], agent["task"] = rng.integers(gcells), rng.integers(first, end)
    for name in ("steps", "joined", "crossing", "ending", "added_overflow"):
        agent[name] = rng.integers(0, 3)
    row = np.unpackbits(dynamic.used[0, other], bitorder="little")
    row[far_edges] = rng.integers(0, 2, len(far_edges))
    dynamic.used[0, other] = np.packbits(row, bitorder="little")
    for option in _SETS:
        begin = int(static.options[option])
        if begin >= 0:
            dynamic.sets[0, begin + other] = rng.integers(0, 256, dynamic.sets.shape[2])


def _changed_problem(problem: Problem, net: int, rng: np.random.Generator) -> Problem:
    """The problem with all pins of other nets somewhere else."""
    columns, rows, _ = problem.grid
    nets = list(problem.nets)
    for k, other in enumerate(nets):
        if k != net:
            x, y = int(rng.integers(columns)), int(rng.integers(rows))
            at = (problem.origin[0] + x * problem.tile[0], problem.origin[1] + y * problem.tile[1])
            pins = tuple(pin._replace(x=at[0], y=at[1]) for pin in other.pins)
            nets[k] = replace(other, pins=pins)
    return replace(problem, nets=tuple(nets))
