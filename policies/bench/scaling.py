"""How time grows with the size of a problem: a step of the environment, A*, the evaluation.

Time is set against routed edges, the edges that all nets use. Three families of problems of two
layers and two-pin nets:

* ``near pins``: the grid grows from the paper's 8×8 Gcells with 50 nets, nets in proportion to its
  area, and the pins of a net lie in a window of 8×8 Gcells somewhere on it. Routes stay as long
  and edges as full as on 8×8.
* ``uniform pins``: the same with pins anywhere. Routes grow with the grid's sides, and with them
  the capacities, so that edges stay as full.
* ``more nets``: nets with pins anywhere on one large grid, whose capacities are those of the grid
  among the ``uniform pins`` with as many nets as this family has at most.

At the small end a good part of the time is that of a call, whatever it does, and exponents come out
below 1; at the large end tables outgrow the caches, and an edge takes longer.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting import InputError, Net, Pin, Problem, Solution, evaluate, sequential_astar
from marouting.problem.grid import Move
from marouting.vector import BatchEnv
from policies.results.scaling import exponents

SIDE, NETS, CAPACITY = 8, 50, 5
"""The paper's problems: columns and rows of Gcells, nets, capacity of an edge."""

SIDES = (8, 16, 32, 64, 128)
COUNTS = (50, 200, 1000, 3000, 10000)
LARGE = 64
"""Columns and rows of the grid that more and more nets are put on."""

STEP, ASTAR, EVALUATE = "step of the environment", "A*", "evaluation"


@dataclass(frozen=True)
class Timing:
    """One measurement: how long some work on one problem took.

    Attributes:
        family: of the problem, one of the three above.
        work: what was done.
        side: columns and rows of Gcells.
        nets: nets of the problem.
        capacity: of an edge along its layer's direction.
        edges: routed edges when it was done.
        seconds: the least time of all repeats.
    """

    family: str
    work: str
    side: int
    nets: int
    capacity: int
    edges: int
    seconds: float


def problem(
    side: int, nets: int, capacity: int, window: int | None = None, seed: int = 0
) -> Problem:
    """A problem of two-pin nets on side × side × 2 Gcells, the same for the same arguments.

    Args:
        side: columns and rows of Gcells, 2 or more.
        nets: nets, 1 or more.
        capacity: of edges along x in layer 1, and along y in layer 2.
        window: side of the square of Gcells that both pins of a net lie in, itself anywhere on the
            grid; None: the whole grid.
        seed: where the random numbers start.
    """
    rng = np.random.default_rng((seed, side, nets))
    window = min(window or side, side)
    corner = rng.integers(side - window + 1, size=(nets, 1, 2))
    # Two different ones of the window's Gcells, all such pairs equally likely.
    first = rng.integers(window**2, size=nets)
    second = (first + rng.integers(1, window**2, size=nets)) % window**2
    pins = corner + np.stack(np.divmod(np.stack((first, second), axis=1), window), axis=2)
    return Problem(
        grid=(side, side, 2),
        vertical_capacity=(0, capacity),
        horizontal_capacity=(capacity, 0),
        nets=tuple(
            Net(f"A{index}", index, tuple(Pin(x, y, 1) for x, y in both))
            for index, both in enumerate(pins.tolist(), 1)
        ),
        min_width=(1, 1),
        min_spacing=(0, 0),
        via_spacing=(0, 0),
    )


def _families(
    sides: Sequence[int], counts: Sequence[int], large: int, seed: int
) -> Iterator[tuple[str, Problem]]:
    """The problems of all families."""

    def nets_on(side: int) -> int:
        return max(1, NETS * side**2 // SIDE**2)

    def capacity_for(nets: int, side: int) -> int:
        # Routes are as long as the sides, and there are edges as the area.
        return max(1, round(CAPACITY * nets / NETS * SIDE / side))

    for side in sides:
        yield "near pins", problem(side, nets_on(side), CAPACITY, SIDE, seed)
    for side in sides:
        nets = nets_on(side)
        yield "uniform pins", problem(side, nets, capacity_for(nets, side), None, seed)
    for nets in counts:
        yield "more nets", problem(large, nets, capacity_for(max(counts), large), None, seed)


def _least(works: Iterable[float], budget: float) -> float:
    """The least of the times that repeats took: three of them, more within a budget of seconds."""
    found: list[float] = []
    for seconds in works:
        found.append(seconds)
        if len(found) >= 3 and sum(found) >= budget:
            break
    return min(found)


def _timed(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def _straight(seen: NDArray[np.float32]) -> NDArray[np.int8]:
    """(M, N) moves of nets that walk straight to their targets, along x, then y, then z."""
    left = [seen[..., axis] for axis in (3, 4, 5)]
    ways = [far > 0 for far in left], [far < 0 for far in left]
    conditions = [way for both in zip(*ways, strict=True) for way in both]
    return np.select(conditions, [np.int8(move) for move in Move], np.int8(-1))


def _episodes(env: BatchEnv) -> Iterator[float]:
    """Episodes without end, and how long the steps of each took."""
    while True:
        seen, info = env.reset()
        seconds, over = 0.0, False
        while not over:
            moves = _straight(seen)
            started = time.perf_counter()
            seen, _, _, _, info = env.step(moves)
            seconds += time.perf_counter() - started
            over = bool(info["over"].all())
        yield seconds


def _measured(on: Problem, budget: float) -> Iterator[tuple[str, int, float]]:
    """Each work on one problem, the edges routed with it, and its seconds."""
    # Nets that may overflow edges all get where they want, straight away.
    env = BatchEnv([on], overflow="allowed", autoreset=False)
    seconds = _least(_episodes(env), budget)
    yield STEP, env.engine.metrics().wirelength, seconds

    routed: list[Solution] = []

    def route() -> float:
        fresh = replace(on)  # of which nothing has been worked out yet
        return _timed(lambda: routed.append(sequential_astar(fresh)))

    seconds = _least(iter(route, None), budget)
    edges = len(routed[0].uses[1])
    yield ASTAR, edges, seconds
    solution = routed[0]
    del routed[:]
    yield (
        EVALUATE,
        edges,
        _least(iter(lambda: _timed(lambda: evaluate(on, solution)), None), budget),
    )


def measure(
    sides: Sequence[int] = SIDES,
    counts: Sequence[int] = COUNTS,
    large: int = LARGE,
    *,
    budget: float = 0.5,
    seed: int = 0,
    progress: Callable[[Timing], None] | None = None,
) -> dict[str, Any]:
    """Measures all families, on one core.

    Args:
        sides: of the grids of the first two families, two or more different ones.
        counts: of nets in the third family, likewise.
        large: side of the third family's grid.
        budget: seconds to spend on the repeats of each measurement, at least three.
        seed: where the random numbers of the problems start.
        progress: called with every row as it is there.

    Returns:
        Plain data: ``rows``, the fields of :class:`Timing` each, and ``exponents`` as of
        :func:`policies.results.scaling.exponents`.

    Raises:
        InputError: the sizes do not differ, or are too small.
    """
    for name, sizes, least in (("sides", sides, 2), ("counts", counts, 1)):
        if len(set(sizes)) < 2 or min(sizes) < least:
            raise InputError(f"{name}: expected different sizes from {least}, found {tuple(sizes)}")
    if large < 2:
        raise InputError(f"large: expected a side from 2, found {large}")
    _compile()
    rows = []
    for family, on in _families(sides, counts, large, seed):
        for work, edges, seconds in _measured(on, budget):
            capacity = on.horizontal_capacity[0]
            row = Timing(family, work, on.grid[0], len(on.nets), capacity, edges, seconds)
            rows.append(asdict(row))
            if progress is not None:
                progress(row)
    return {"rows": rows, "exponents": exponents(rows)}


def _compile() -> None:
    """Has everything compiled before anything is timed."""
    for _ in _measured(problem(2, 1, 1), 0.0):
        pass
