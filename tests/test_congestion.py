"""Congestion maps, which stand for drawings of too many nets."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import solved_problems

from marouting import Adjustment, Problem, generate, sequential_astar

figures = pytest.importorskip("policies.figures", exc_type=ImportError)
congestion = pytest.importorskip("policies.figures.congestion", exc_type=ImportError)
utilisation = pytest.importorskip("policies.results.utilisation", exc_type=ImportError)


@given(solved_problems(), st.sampled_from([1, 2, 3, 1024]))
def test_the_fullest_edge_of_every_field(solution, most):
    problem = solution.problem
    found, side = congestion.congestion(problem, solution, most)
    columns, rows, layers = problem.grid
    assert side == -(-max(columns, rows) // most)
    assert found.shape == (layers, 2, -(-columns // side), -(-rows // side))
    expected = np.full(found.shape, np.nan)
    for x, y, z in np.ndindex(*problem.grid):
        for axis, offered in enumerate((problem.horizontal_capacity, problem.vertical_capacity)):
            edge = 3 * problem.topology.number(x, y, z) + axis
            demand, capacity = int(solution.edge_demand[edge]), int(problem.capacity[edge])
            at = (z, axis, x // side, y // side)
            # A layer with capacity has it everywhere, also where edges would lead off the grid; an
            # edge that has lost it shows only if it is alone in its field.
            exists = bool(problem.topology.exists[edge])
            if offered[z] and (side > 1 or capacity or not exists):
                expected[at] = np.fmax(expected[at], 0)
            if demand or capacity:
                share = 100 * demand / capacity if capacity else np.inf
                expected[at] = np.fmax(expected[at], share)
    np.testing.assert_allclose(found, expected)


@pytest.fixture
def busy(monkeypatch):
    monkeypatch.setattr(congestion, "MOST_NETS", 40)
    (problem,) = generate(1, grid=(10, 6, 2), nets=41, capacity=1, seed=1)
    return problem, sequential_astar(problem)


def titles(figure):
    """The titles of the panels, each on one line."""
    return [" ".join(axes.get_title().split()) for axes in figure.axes if axes.get_title()]


def test_too_many_nets_give_a_map_and_the_title_says_so(busy):
    problem, solution = busy
    for figure in (
        figures.solution_2d(problem, solution, "astar"),
        figures.comparison({"one": solution, "two": solution}),
    ):
        assert all("41 nets are too many to draw: congestion map" in t for t in titles(figure))
        assert not figure.legends  # there are no lines to explain
        bars = [*figure.axes, *(child for axes in figure.axes for child in axes.child_axes)]
        assert any("demand / capacity [%]" in axes.get_ylabel() for axes in bars)
    layers = figures.solution_3d(problem, solution, "astar")
    assert "41 nets are too many to draw" in layers.get_suptitle()
    (image,) = figures.solution_2d(problem, solution).axes[0].images
    values, _ = congestion.congestion(problem, solution)
    shown = np.asarray(image.get_array())
    fullest = np.fmax.reduce(values, axis=(0, 1)).T
    finite = np.isfinite(fullest)
    assert np.array_equal(shown[finite], fullest[finite])
    assert values[np.isfinite(values)].max() > 100
    assert image.get_clim()[1] == values[np.isfinite(values)].max()


def test_full_and_overflowed_have_colours_of_their_own(busy):
    (image,) = figures.solution_2d(*busy).axes[0].images
    most = image.get_clim()[1]
    assert most > 102
    colours = image.to_rgba(np.array([100.0, 102, most, 1e9])).tolist()
    full, above, most, endless = ([round(part, 1) for part in colour[:3]] for colour in colours)
    assert full[2] > full[0]  # blue
    assert above[0] > above[2]  # orange
    assert most[0] > most[2]
    assert len({tuple(colour) for colour in (full, above, most, endless)}) == 4


def test_one_net_less_is_drawn(busy, monkeypatch):
    monkeypatch.setattr(congestion, "MOST_NETS", 41)
    figure = figures.solution_2d(*busy)
    assert "congestion" not in titles(figure)[0]
    assert figure.legends


@pytest.mark.parametrize("most", [100.5, 133.3, 266.7, 599, 4321])
def test_exactly_full_is_blue_whatever_the_scale(most):
    scale = congestion.scale_of_use(np.array([[3.0, most]]))
    full, above = scale.to_rgba(np.array([100.0, most])).tolist()
    assert full[2] > full[0] + 0.3
    assert above[0] > above[2] + 0.3


def test_maps_of_designs_show_the_tracks_that_are_free() -> None:
    problem = generate(1, (6, 5, 2), nets=4, capacity=4, reduced_edges=0, seed=1)[0]
    less = Adjustment(1, 2, 1, 2, 2, 1, 1), Adjustment(3, 0, 2, 3, 1, 2, 0)
    chip = replace(problem, adjustments=less, chip=problem.chip_or_default)
    expected = np.full((2, 6, 5), 100.0)
    expected[0, 1, 2], expected[1, 3, 0] = 25, 0
    assert utilisation.free_tracks(chip).tolist() == expected.tolist()
    coarse = utilisation.free_tracks(chip, 3)
    assert coarse.shape == (2, 3, 3)
    assert (coarse[0, 0, 1], coarse[1, 1, 0], np.count_nonzero(coarse < 100)) == (25, 0, 2)

    flat = generate(1, (1, 5, 1), nets=2, capacity=4, reduced_edges=0, seed=1)[0]
    assert utilisation.free_tracks(flat).tolist() == [[[100.0] * 5]]

    def titles(problem: Problem) -> list[str]:
        figure = congestion.congestion_map(problem, sequential_astar(problem), "p")
        return [axes.get_title() for axes in figure.axes if axes.get_title()]

    assert titles(chip)[-2:] == ["tracks of Metal1", "tracks of Metal2"]
    assert not any("tracks" in title for title in titles(problem))
