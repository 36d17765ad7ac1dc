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
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting import Net, Pin, Problem, evaluate, sequential_astar
from marouting.problem.grid import Move
from marouting.vector import BatchEnv
from policies.bench.measure import Bench, Measurement

SIDE, NETS, CAPACITY = 8, 50, 5
"""The paper's problems: columns and rows of Gcells, nets, capacity of an edge."""

SIDES = (8, 16, 32, 64, 128)
COUNTS = (50, 200, 1000, 3000, 10000)
LARGE = 64
"""Columns and rows of the grid that more and more nets are put on."""


def problem(side: int, nets: int, capacity: int, window: int) -> Problem:
    """A problem of two-pin nets on side × side × 2 Gcells, the same for the same arguments.

    Both pins of a net lie in a square of window × window Gcells, itself anywhere on the grid.
    """
    rng = np.random.default_rng((0, side, nets))
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


def families(
    sides: Sequence[int], counts: Sequence[int], large: int
) -> Iterator[tuple[str, Problem]]:
    """The problems of all families."""

    def nets_on(side: int) -> int:
        return NETS * side**2 // SIDE**2

    def capacity_for(nets: int, side: int) -> int:
        # Routes are as long as the sides, and there are edges as the area.
        return max(1, round(CAPACITY * nets / NETS * SIDE / side))

    for side in sides:
        yield "near pins", problem(side, nets_on(side), CAPACITY, min(SIDE, side))
    for side in sides:
        nets = nets_on(side)
        yield "uniform pins", problem(side, nets, capacity_for(nets, side), side)
    for nets in counts:
        yield "more nets", problem(large, nets, capacity_for(max(counts), large), large)


def _least(times: Iterator[float], budget: float) -> float:
    """The least of the times that repeats took: three of them, more within a budget of seconds."""
    found: list[float] = []
    while len(found) < 3 or sum(found) < budget:
        found.append(next(times))
    return min(found)


def _timed(work: Callable[[], object]) -> Iterator[float]:
    """The times that some work takes, without end."""
    while True:
        started = time.perf_counter()
        work()
        yield time.perf_counter() - started


def _straight(seen: NDArray[np.float32]) -> NDArray[np.int8]:
    """(M, N) moves of nets that walk straight to their targets, along x, then y, then z."""
    left = [seen[..., axis] for axis in (3, 4, 5)]
    ways = [far > 0 for far in left], [far < 0 for far in left]
    conditions = [way for both in zip(*ways, strict=True) for way in both]
    return np.select(conditions, [np.int8(move) for move in Move], np.int8(-1))


def _episodes(env: BatchEnv) -> Iterator[float]:
    """How long the steps of an episode take, without end."""
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


def times_of(on: Problem, budget: float) -> Iterator[tuple[str, int, float]]:
    """Each work on one problem, the edges routed with it, and its seconds."""
    # Nets that may overflow edges all get where they want, straight away.
    env = BatchEnv([on], overflow="allowed", autoreset=False)
    seconds = _least(_episodes(env), budget)
    yield "step of the environment", env.engine.metrics().wirelength, seconds
    solution = sequential_astar(on)
    edges = len(solution.uses[1])
    # A problem of which nothing has been worked out yet.
    yield "A*", edges, _least(_timed(lambda: sequential_astar(replace(on))), budget)
    yield "evaluation", edges, _least(_timed(lambda: evaluate(on, solution)), budget)


def exponent(points: Sequence[tuple[int, float]]) -> float:
    """The p with which time grows as edges to the power of p, by least squares of logarithms."""
    edges, seconds = np.log(np.array(points, np.float64).T)
    return float(np.polyfit(edges, seconds, 1)[0])


def scaling(
    bench: Bench,
    sides: Sequence[int] = SIDES,
    counts: Sequence[int] = COUNTS,
    large: int = LARGE,
) -> Iterator[Measurement]:
    """Exponents of time over routed edges, by family and work."""
    list(times_of(problem(2, 1, 1, 2), 0.0))  # everything is compiled then
    rows: list[dict[str, Any]] = []
    points: dict[tuple[str, str], list[tuple[int, float]]] = defaultdict(list)
    for family, on in families(sides, counts, large):
        for work, edges, seconds in times_of(on, 0.1 * bench.repeats):
            about = {"family": family, "work": work, "side": on.grid[0], "nets": len(on.nets)}
            rows.append({**about, "edges": edges, "seconds": seconds})
            points[family, work].append((edges, seconds))
    bench.details["scaling"] = rows
    for (family, work), found in points.items():
        name = f"{work}, {family}: exponent of time over routed edges"
        power = exponent(found)
        yield Measurement(name, power, power, "", target="1.2 at most")
