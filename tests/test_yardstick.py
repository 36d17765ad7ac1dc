"""The strongest classical routers against the published optima, and against each other."""

import csv
from pathlib import Path

import pytest

from marouting import Problem, evaluate, generate, sequential_astar
from policies.routers.optimal import OptimalRouter
from policies.routers.pathfinder import PathfinderRouter

DATA = Path(__file__).parents[2] / "shared" / "data" / "liao2019"


def published() -> list[dict[str, str]]:
    """The rows of the published results, where they are at hand."""
    if not DATA.exists():
        return []
    with (DATA / "results.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def problem_of(row: dict[str, str]) -> Problem:
    return Problem.read(next((DATA / row["set"]).rglob(f"{row['problem']}.gr")))


@pytest.mark.skipif(not DATA.exists(), reason="needs the published problems")
@pytest.mark.parametrize("place", range(12, 120, 24))
def test_published_optima(place: int) -> None:
    row = published()[place]
    problem = problem_of(row)
    optimum = int(row["optimal_overflow"]), int(row["optimal_wirelength"])
    proven = OptimalRouter().solve(problem)
    assert proven.status == "optimal"
    judged = evaluate(problem, proven.solution)
    assert judged.connected
    assert (judged.overflow, judged.wirelength) == optimum
    negotiated = evaluate(problem, PathfinderRouter().route(problem))
    assert negotiated.connected
    assert negotiated.overflow == optimum[0]
    assert optimum[1] <= negotiated.wirelength <= 1.01 * optimum[1]


@pytest.mark.parametrize("seed", range(4))
def test_nobody_beats_the_optimum(seed: int) -> None:
    # Tight enough for overflow here and there.
    problem = generate(
        1, grid=(4, 4, 2), nets=12, max_pins=4, capacity=3, reduced_edges=2, seed=seed
    )[0]
    proven = OptimalRouter().solve(problem)
    assert proven.status == "optimal"
    best, negotiated, greedy = (
        evaluate(problem, solution)
        for solution in (
            proven.solution,
            PathfinderRouter().route(problem),
            sequential_astar(problem),
        )
    )
    assert best.connected
    assert negotiated.connected
    ranks = [(judged.overflow, judged.wirelength) for judged in (best, negotiated, greedy)]
    assert ranks == sorted(ranks)
