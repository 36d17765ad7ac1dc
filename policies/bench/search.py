"""Speed of A*."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from marouting import Problem, generate, sequential_astar
from marouting.problem.grid import Grid
from marouting.trees.decomposition import two_pin_tasks
from policies.bench.measure import Bench, Measurement, Work


def _graph(problem: Problem) -> Any:
    """The grid as a graph of networkx."""
    import networkx

    grid = Grid.of(problem.grid)
    graph = networkx.Graph()
    edges = np.flatnonzero(grid.exists)
    graph.add_edges_from(zip(*(ends.tolist() for ends in grid.ends(edges)), strict=True), weight=1)
    return graph


def _networkx(problem: Problem, tasks: int | None = None) -> Work:
    """Tasks of a problem, all or so many, as shortest paths of networkx: less than A* does here."""
    import networkx

    graph = _graph(problem)
    pairs = two_pin_tasks(problem)[:tasks, 1:].tolist()
    position = Grid.of(problem.grid).position.tolist()

    def distance(a: int, b: int) -> int:
        return sum(abs(p - q) for p, q in zip(position[a], position[b], strict=True))

    def work() -> float:
        for source, target in pairs:
            networkx.astar_path(graph, source, target, heuristic=distance)
        return len(pairs)

    return work


def _fresh(problem: Problem) -> Problem:
    """The same problem, of which nothing has been worked out yet."""
    return Problem(**{name: getattr(problem, name) for name in problem.__dataclass_fields__})


def search(bench: Bench) -> Iterator[Measurement]:
    """Sequential A*, from a problem to its solution."""
    problems = generate(100)
    # Problems of which nothing has been worked out yet, for every repeat and the first time.
    stock = [[_fresh(problem) for problem in problems] for _ in range(bench.repeats + 1)]

    def fresh() -> float:
        for problem in stock.pop():
            sequential_astar(problem)
        return 50 * len(problems)

    yield bench.versus(
        "sequential A*, problems of 50 two-pin nets on 8×8×2",
        "tasks/s",
        fresh,
        "networkx's astar_path, capacities left out",
        _networkx(problems[0]),
        target="200 000 (0.25 ms a problem)",
    )
    (chip,) = generate(1, (64, 64, 2), 11_507, max_pins=4, capacity=150, reduced_edges=0)
    tasks = len(two_pin_tasks(chip))

    def whole() -> float:
        sequential_astar(chip)
        return tasks

    yield bench.versus(
        f"sequential A*, 11 507 nets of {tasks} tasks on 64×64×2",
        "tasks/s",
        whole,
        "networkx's astar_path, capacities left out",
        _networkx(chip, 30),
        target=f"{tasks / 2:.0f} (2 s in all)",
    )
