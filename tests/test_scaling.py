"""How time grows with size: what is measured, and how exponents are fitted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from marouting import evaluate, sequential_astar
from policies.bench import scaling
from policies.bench.measure import Bench


@given(st.integers(2, 12), st.integers(1, 30), st.integers(2, 12))
def test_problems_lie_in_their_windows(side: int, nets: int, window: int) -> None:
    window = min(window, side)
    problem = scaling.problem(side, nets, 3, window)
    assert problem == scaling.problem(side, nets, 3, window)
    assert (problem.grid, len(problem.nets)) == ((side, side, 2), nets)
    for net in problem.nets:
        (x1, y1, layer1), (x2, y2, layer2) = net.pins
        assert (x1, y1) != (x2, y2)
        assert layer1 == layer2 == 1
        assert max(abs(x1 - x2), abs(y1 - y2)) < window


def test_pins_are_all_over_window_and_grid() -> None:
    pins = [[pin[:2] for pin in net.pins] for net in scaling.problem(6, 3000, 3, 2).nets]
    assert {pin for both in pins for pin in both} == {(x, y) for x in range(6) for y in range(6)}
    steps = {(x2 - x1, y2 - y1) for (x1, y1), (x2, y2) in pins}
    assert steps == {(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)} - {(0, 0)}


def test_what_is_measured() -> None:
    bench = Bench(repeats=1)
    found = list(scaling.scaling(bench, (4, 6), (3, 9), 7))
    rows = bench.details["scaling"]
    works = ["step of the environment", "A*", "evaluation"]
    families = ["near pins", "uniform pins", "more nets"]
    assert [row.name.split(":")[0] for row in found] == [
        f"{work}, {family}" for family in families for work in works
    ]
    # As full as 50 nets and 5 tracks on 8×8: 5 · nets / 50 · 8 / side.
    problems = list(scaling.families((4, 6), (3, 9), 7))
    assert [(of.grid[0], len(of.nets), of.horizontal_capacity[0]) for _, of in problems] == [
        (4, 12, 5), (6, 28, 5), (4, 12, 2), (6, 28, 4), (7, 3, 1), (7, 9, 1)
    ]  # fmt: skip
    expected = [(family, work) for family, _ in problems for work in works]
    assert [(row["family"], row["work"]) for row in rows] == expected
    for row, problem in zip(rows, (of for _, of in problems for _ in works), strict=True):
        assert row["seconds"] > 0
        if row["work"] == works[0]:
            # Straight ways, which no other net is in: as long as pins are apart.
            pins = np.array([[pin[:2] for pin in net.pins] for net in problem.nets])
            assert row["edges"] == np.abs(pins[:, 0] - pins[:, 1]).sum()
        else:
            assert row["edges"] == evaluate(problem, sequential_astar(problem)).wirelength


def test_exponents_of_exact_powers() -> None:
    for power in (0.25, 1.0, 1.5):
        points = [(edges, 3e-6 * edges**power) for edges in (4000, 40, 400)]
        assert scaling.exponent(points) == pytest.approx(power)
