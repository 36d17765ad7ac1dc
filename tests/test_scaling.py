"""How time grows with size: what is measured, how exponents are fitted, the figure."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marouting import InputError, evaluate, sequential_astar
from policies import figures
from policies.bench import scaling
from policies.figures.plot import plot
from policies.results.scaling import exponents

WORKS = [scaling.STEP, scaling.ASTAR, scaling.EVALUATE]


@settings(deadline=None, max_examples=40)
@given(
    st.integers(2, 12), st.integers(1, 30), st.none() | st.integers(2, 5), st.integers(0, 2**31 - 1)
)
def test_problems_lie_in_their_windows(side: int, nets: int, window: int | None, seed: int) -> None:
    problem = scaling.problem(side, nets, 3, window, seed)
    assert problem == scaling.problem(side, nets, 3, window, seed)
    assert (problem.grid, len(problem.nets)) == ((side, side, 2), nets)
    for net in problem.nets:
        (x1, y1, layer1), (x2, y2, layer2) = net.pins
        assert (x1, y1) != (x2, y2)
        assert layer1 == layer2 == 1
        assert max(abs(x1 - x2), abs(y1 - y2)) < (window or side)


def test_pins_are_all_over_window_and_grid() -> None:
    pins = [[pin[:2] for pin in net.pins] for net in scaling.problem(6, 3000, 3, 2).nets]
    assert {pin for both in pins for pin in both} == {(x, y) for x in range(6) for y in range(6)}
    steps = {(x2 - x1, y2 - y1) for (x1, y1), (x2, y2) in pins}
    assert steps == {(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)} - {(0, 0)}


def test_what_is_measured() -> None:
    seen: list[scaling.Timing] = []
    report = scaling.measure((4, 6), (3, 9), 7, budget=0.0, seed=5, progress=seen.append)
    rows = [scaling.Timing(**row) for row in report["rows"]]
    assert rows == seen
    assert json.loads(json.dumps(report)) == report
    expected = [("near pins", 4, 12, 5), ("near pins", 6, 28, 5)]
    # As full as 50 nets and 5 tracks on 8×8: 5 · nets / 50 · 8 / side.
    expected += [("uniform pins", 4, 12, 2), ("uniform pins", 6, 28, 4)]
    expected += [("more nets", 7, 3, 1), ("more nets", 7, 9, 1)]
    found = [(row.family, row.side, row.nets, row.capacity) for row in rows]
    assert found == [of for of in expected for _ in WORKS]
    assert [row.work for row in rows] == WORKS * len(expected)
    for row in rows:
        window = 8 if row.family == "near pins" else None
        problem = scaling.problem(row.side, row.nets, row.capacity, window, seed=5)
        assert row.seconds > 0
        if row.work == scaling.STEP:
            # Straight ways, which no other net is in: as long as pins are apart.
            pins = np.array([[pin[:2] for pin in net.pins] for net in problem.nets])
            assert row.edges == np.abs(pins[:, 0] - pins[:, 1]).sum()
        else:
            assert row.edges == evaluate(problem, sequential_astar(problem)).wirelength
    assert report["exponents"] == exponents(report["rows"])


def rows_of(powers: dict[tuple[str, str], float]) -> list[dict[str, Any]]:
    """Rows whose times grow as exact powers of their edges."""
    return [
        {"family": family, "work": work, "edges": edges, "seconds": 3e-6 * edges**power}
        for (family, work), power in powers.items()
        for edges in (4000, 40, 400)
    ]


def test_exponents_of_exact_powers() -> None:
    powers = {("a", "A*"): 1.0, ("a", "other"): 1.5, ("b", "A*"): 0.25}
    found = exponents(rows_of(powers))
    assert {(f, w): p for f, works in found.items() for w, p in works.items()} == pytest.approx(
        powers
    )


def test_figure() -> None:
    rows = rows_of({("a", "A*"): 1.0, ("a", "other"): 1.5, ("b", "A*"): 0.25})
    figure = figures.scaling(rows, "title")
    assert [axes.get_title() for axes in figure.axes] == ["a", "b"]
    for axes in figure.axes:
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert axes.get_xlabel() == "routed edges"
        assert axes.get_ylabel() == "time [s]"
    labels = [[str(line.get_label()) for line in axes.get_lines()] for axes in figure.axes]
    assert labels == [
        ["A*: exponent 1.00", "other: exponent 1.50", "in proportion"],
        ["A*: exponent 0.25", "in proportion"],
    ]
    curve = figure.axes[0].get_lines()[1]
    assert np.asarray(curve.get_xdata()).tolist() == [40, 400, 4000]
    np.testing.assert_allclose(
        np.asarray(curve.get_ydata(), float), [3e-6 * e**1.5 for e in (40, 400, 4000)]
    )
    x, y = (np.asarray(of, float) for of in figure.axes[0].get_lines()[2].get_data())
    assert y[1] / y[0] == pytest.approx(x[1] / x[0])


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ({"sides": (8,)}, "sides: expected different sizes from 2, found"),
        ({"sides": (8, 8)}, "sides: expected different"),
        ({"sides": (1, 8)}, "sides: expected different"),
        ({"counts": ()}, "counts: expected different sizes from 1, found"),
        ({"counts": (0, 5)}, "counts: expected different"),
        ({"large": 1}, "large: expected a side from 2, found 1"),
    ],
)
def test_sizes_that_do_not_differ_are_refused(bad: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        scaling.measure(**bad)


def test_no_figure_of_nothing() -> None:
    with pytest.raises(InputError, match="expected at least one row"):
        figures.scaling([])


def test_the_figure_of_a_bench_file(tmp_path: Path) -> None:
    rows = scaling.measure((2, 4), (2, 6), 4, budget=0.0)["rows"]
    report = {"machine": {"date": "2026-11-21"}, "scaling": rows}
    (tmp_path / "speed.json").write_text(json.dumps(report))
    (picture,) = plot([tmp_path / "speed.json"])
    assert picture == tmp_path / "figures" / "scaling.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    for bad in ("{}", "[1]", "scaling"):
        (tmp_path / "bad.json").write_text(bad)
        with pytest.raises(InputError, match=r"bad\.json: expected what marouting bench"):
            plot([tmp_path / "bad.json"])
