import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import solved_problems

from marouting.errors import InputError
from marouting.problem.net import Adjustment, Net, Pin
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import USE

figures = pytest.importorskip("policies.figures", exc_type=ImportError)
plot = pytest.importorskip("policies.figures.plot", exc_type=ImportError)
routes = pytest.importorskip("policies.figures.routes", exc_type=ImportError)
utilisation = pytest.importorskip("policies.results.utilisation", exc_type=ImportError)


def edge(problem, axis, x, y, z):
    return 3 * problem.topology.number(x, y, z) + axis


def problem_of(shape, horizontal, vertical, pins, adjustments=()):
    layers = shape[2]
    nets = tuple(
        Net(f"n{i}", i, tuple(Pin(*pin) for pin in ends), 1) for i, ends in enumerate(pins)
    )
    return Problem(
        shape,
        vertical,
        horizontal,
        nets,
        (1,) * layers,
        (0,) * layers,
        (0,) * layers,
        adjustments=adjustments,
    )


@pytest.fixture(scope="module")
def worked():
    """Four nets on 3×3×2, worked out by hand.

    Layer 1 has capacity 2 along x, layer 2 along y, but 1 from (0, 1) to (0, 2). Three nets take
    (0, 0) to (1, 0), one of them goes on to (2, 0); the fourth goes from (0, 0) up to layer 2, to
    (0, 2) and down.
    """
    ends = [((0, 0, 1), (2, 0, 1)), *[((0, 0, 1), (1, 0, 1))] * 2, ((0, 0, 1), (0, 2, 1))]
    problem = problem_of((3, 3, 2), (2, 0), (0, 2), ends, (Adjustment(0, 1, 2, 0, 2, 2, 1),))
    east = [edge(problem, 0, x, 0, 0) for x in (0, 1)]
    north = [edge(problem, 1, 0, y, 1) for y in (0, 1)]
    vias = [edge(problem, 2, 0, y, 0) for y in (0, 2)]
    routes = (east, east[:1], east[:1], north + vias)
    return problem, Solution(problem, tuple(np.array(route, np.int64) for route in routes))


def crowd(nets=6):
    """Nets that all take the same way: (0, 0), (1, 0), (1, 1)."""
    problem = problem_of((2, 2, 1), (9,), (9,), [((0, 0, 1), (1, 1, 1))] * nets)
    route = np.array([edge(problem, 0, 0, 0, 0), edge(problem, 1, 1, 0, 0)], np.int64)
    return problem, Solution(problem, (route,) * nets)


def segments(axes, colour):
    """The lines drawn in a colour."""
    from matplotlib.colors import to_rgba

    return [
        segment
        for collection in axes.collections
        for segment in collection.get_segments()
        if to_rgba(colour) in map(tuple, collection.get_edgecolor())
    ]


def test_congestion_by_hand(worked):
    values, side = utilisation.congestion(*worked)
    assert side == 1
    assert values[0, 0].tolist() == [[150, 0, 0], [50, 0, 0], [0, 0, 0]]
    assert values[1, 1].tolist() == [[50, 100, 0], [0, 0, 0], [0, 0, 0]]
    assert np.isnan(values[0, 1]).all()
    assert np.isnan(values[1, 0]).all()
    vias = utilisation.via_counts(worked[1], 1)
    assert vias.tolist() == [[1, 0, 1], [0, 0, 0], [0, 0, 0]]


def test_a_map_shows_the_fullest_layer():
    problem = problem_of((2, 1, 2), (1, 3), (0, 0), [((0, 0, 1), (1, 0, 1))] * 2)
    route = np.array([edge(problem, 0, 0, 0, 0)], np.int64)
    figure = figures.heat_maps(problem, Solution(problem, (route, route)))
    (_, horizontal) = (axes for axes in figure.axes if axes.images)
    assert horizontal.images[0].get_array().tolist() == [[200]]
    assert "no such edges" in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_congestion_without_capacity():
    problem = problem_of((2, 2, 1), (0,), (4,), [((0, 0, 1), (1, 0, 1))])
    route = np.array([edge(problem, 0, 0, 0, 0)], np.int64)
    solution = Solution(problem, (route,))
    values, _ = utilisation.congestion(problem, solution)
    assert values[0, 0, 0, 0] == np.inf
    assert np.isnan(values[0, 0, 0, 1])
    figure = figures.heat_maps(problem, solution)
    assert "no capacity" in [text.get_text() for text in figure.legends[0].get_texts()]
    bars = [bar for axes in figure.axes for bar in axes.child_axes]
    assert any("(arrow: no capacity)" in bar.get_ylabel() for bar in bars)


@given(solved_problems(), st.sampled_from([1, 2, 3, 1024]))
def test_utilisation_against_tables_of_all_edges(solution, most):
    problem = solution.problem
    side = -(-max(problem.grid[:2]) // most)
    uses = np.bincount(solution.uses[1], minlength=3 * problem.topology.gcells)
    vias = uses.reshape(*problem.grid, 3)[..., 2].sum(axis=2)
    for axis in (0, 1):
        vias = np.add.reduceat(vias, np.arange(0, vias.shape[axis], side), axis=axis)
    np.testing.assert_array_equal(utilisation.via_counts(solution, side), vias)

    flat, offered = solution.edge_demand, problem.capacity.astype(np.int64)
    inside = np.arange(len(flat)) % 3 < 2
    routable = np.flatnonzero(inside & (offered > 0))
    tenth = np.minimum(10 * flat[routable] // offered[routable], 10)
    tenth += flat[routable] > offered[routable]
    counts = [np.bincount(tenth[routable % 3 == axis], minlength=12) for axis in (0, 1)]
    assert utilisation.histogram_counts(problem, solution).tolist() == np.array(counts).tolist()
    full = routable[flat[routable] >= offered[routable]]
    assert utilisation.depleted_edges(problem, solution).tolist() == full.tolist()
    over = np.flatnonzero(flat > offered)
    assert utilisation.overflowed_edges(problem, solution).tolist() == over.tolist()
    stray = np.count_nonzero((flat > 0) & (offered == 0))
    assert utilisation.stray_edges(problem, solution) == stray


def test_a_field_of_several_gcells_is_named(worked, monkeypatch):
    monkeypatch.setattr(routes, "MOST_FIELDS", 2)
    figure = figures.heat_maps(*worked)
    via, vertical, _ = (axes for axes in figure.axes if axes.images)
    assert via.images[0].get_extent() == [-0.5, 3.5, -0.5, 3.5]
    assert (via.get_xlim(), via.get_ylim()) == ((-0.5, 2.5), (-0.5, 2.5))
    assert vertical.images[0].get_array().shape == (1, 2)
    notes = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "a field shows 2x2 Gcells" in notes


def test_heat_maps_draw_the_numbers_between_the_gcells(worked):
    figure = figures.heat_maps(*worked, title="A*")
    via, vertical, horizontal = (axes for axes in figure.axes if axes.images)
    for axes, values in (
        (via, [[1, 0, 1], [0, 0, 0], [0, 0, 0]]),
        (vertical, [[50, 100], [0, 0], [0, 0]]),
        (horizontal, [[150, 0, 0], [50, 0, 0]]),
    ):
        assert np.array_equal(axes.images[0].get_array(), np.transpose(values))
        assert axes.images[0].origin == "lower"
        assert axes.get_xlabel() == "x [Gcell]"
    assert vertical.images[0].get_extent() == [-0.5, 2.5, 0, 2]
    assert horizontal.images[0].get_extent() == [0, 2, -0.5, 2.5]
    assert "row y and y + 1" in vertical.get_title()
    # WL 2 + 1 + 1 + 4, OF 3 nets on 2 tracks.
    assert figure.get_suptitle() == "A*: WL 8, OF 1"


def test_full_is_blue_and_overflow_is_orange_on_one_scale(worked):
    """The same colours in heat maps, congestion maps and pictures of a running game."""
    solution = worked[1]
    *_, last = (axes for axes in figures.heat_maps(*worked).axes if axes.images)
    maps = [last.images[0]]
    maps += [axes.images[0] for axes in figures.congestion_map(*worked, "A*").axes if axes.images]
    assert np.nanmax([image.get_array().max() for image in maps]) == 150
    for image in maps:
        assert image.norm.vmax == 150
        colours = image.cmap(image.norm(np.array([0, 50, 100, 100.2, 150])))[:, :3] * 255
        expected = [ink for _, ink in USE]
        np.testing.assert_allclose(colours, expected, atol=6)
    assert solution.problem.grid == (3, 3, 2)


def test_a_single_gcell_does_not_spoil_the_colours_of_vias():
    problem = problem_of((6, 6, 2), (9, 9), (9, 9), [((0, 0, 1), (0, 0, 2))] * 50)
    everywhere = [edge(problem, 2, x, y, 0) for x in range(6) for y in range(6)]
    nets = [everywhere] * 2 + [everywhere[:1]] * 48
    figure = figures.heat_maps(problem, Solution(problem, [np.array(own) for own in nets]))
    image = figure.axes[0].images[0]
    assert image.get_array().max() == 50
    assert image.norm.vmax < 10
    (bar,) = figure.axes[0].child_axes
    assert bar.get_ylabel() == "vias [count], at most 50"
    assert figures.heat_maps(*crowd(3)).axes[0].images[0].norm.vmax == 1


def test_histogram_counts_by_hand(worked):
    counts = utilisation.histogram_counts(*worked)
    assert counts.shape == (2, 12)
    assert dict(enumerate(counts[0][counts[0] > 0])) == {0: 4, 1: 1, 2: 1}
    assert np.flatnonzero(counts[0]).tolist() == [0, 5, 11]
    assert np.flatnonzero(counts[1]).tolist() == [0, 5, 10]
    assert counts[1].sum() == 6
    figure = figures.utilisation_histogram(*worked)
    (axes,) = figure.axes
    heights = [bar.get_height() for container in axes.containers for bar in container]
    assert heights == counts.ravel().tolist()
    assert any(text.get_text() == "2 of 12 edges\nat or above 100 %" for text in axes.texts)


def test_histogram_bins_are_exact_in_integers():
    # 0.29 · 100 is less than 29 in floating point; here 7 of 10 must count as 70 %, not less.
    problem = problem_of((2, 1, 1), (10,), (0,), [((0, 0, 1), (1, 0, 1))] * 7)
    route = np.array([0], np.int64)
    counts = utilisation.histogram_counts(problem, Solution(problem, (route,) * 7))
    assert np.flatnonzero(counts[0]).tolist() == [7]


def test_used_edges_without_capacity_are_mentioned():
    problem = problem_of((2, 2, 1), (0,), (4,), [((0, 0, 1), (1, 0, 1))])
    solution = Solution(problem, (np.array([0], np.int64),))
    texts = figures.utilisation_histogram(problem, solution).axes[0].texts
    assert any("1 edge used" in text.get_text() for text in texts)
    assert "1 edge used" in figures.edges_before_after(problem, solution).axes[0].get_title()


def test_a_problem_without_any_capacity_is_drawn():
    problem = problem_of((2, 2, 1), (0,), (0,), [((0, 0, 1), (1, 0, 1))])
    solution = Solution(problem, (np.array([0], np.int64),))
    (axes,) = figures.edges_before_after(problem, solution).axes
    assert axes.get_title() == "no edge fully used (and 1 edge used without capacity)"


def test_depleted_edges_and_type(worked):
    problem, solution = worked
    expected = sorted([edge(problem, 0, 0, 0, 0), edge(problem, 1, 0, 1, 1)])
    assert utilisation.depleted_edges(problem, solution).tolist() == expected
    (axes,) = figures.edges_before_after(problem, solution, "A*").axes
    assert axes.get_title() == "A*: 2 edges fully used"
    assert any("2 of 12 fully used" in text.get_text() for text in axes.texts)
    assert "overflowed (1 edge)" in [text.get_text() for text in axes.get_legend().get_texts()]

    calm = crowd(3)
    assert not utilisation.depleted_edges(*calm).size
    assert [utilisation.problem_type(*routed) for routed in (worked, calm)] == ["II", "I"]
    (axes,) = figures.edges_before_after(*calm).axes
    assert axes.get_title() == "no edge fully used"


def test_edges_before_and_after_are_in_order(worked):
    from matplotlib.patches import StepPatch

    (axes,) = figures.edges_before_after(*worked).axes
    lines = {
        patch.get_label(): np.repeat(
            patch.get_data().values, np.diff(patch.get_data().edges).astype(int)
        )
        for patch in axes.patches
        if isinstance(patch, StepPatch) and not patch.get_label().startswith("_")
    }
    assert lines["after routing"].tolist() == [2] * 8 + [1, 1, 0, -1]
    assert lines["before routing"].tolist() == [2] * 11 + [1]  # no saw: it falls, too


def test_solution_2d_draws_every_edge_pin_and_via(worked):
    (axes,) = figures.solution_2d(*worked, title="A*").axes
    assert axes.get_title() == "A*: WL 8, OF 1"
    assert len(segments(axes, "#0077BB")) == 4
    assert len(segments(axes, "#CC3311")) == 2
    pins, vias = (line for line in axes.lines if line.get_linestyle() == "None")
    assert len(pins.get_xdata()) == 8
    assert len(vias.get_xdata()) == 2
    (overflowed,) = segments(axes, "#FFD24D")
    assert overflowed.tolist() == [[0, 0], [1, 0]]


def test_nets_on_the_same_way_lie_side_by_side():
    problem, solution = crowd()
    (axes,) = figures.solution_2d(problem, solution).axes
    drawn = segments(axes, "#0077BB")
    assert len({tuple(segment.ravel()) for segment in drawn}) == 12
    # A route stays in one piece: from its pin to the bend, and on from there.
    heads, tails = ({tuple(segment[end]) for segment in drawn} for end in (0, 1))
    assert len(heads & tails) == 6
    # Every point stays in its Gcell.
    points = np.concatenate(drawn)
    assert np.abs(points - points.round()).max() < 0.5
    again = figures.solution_2d(problem, solution).axes[0]
    assert np.array_equal(segments(again, "#0077BB"), drawn)


def test_nets_that_touch_in_a_gcell_have_different_tracks():
    rng = np.random.default_rng(0)
    pins = [((*rng.integers(0, 6, 2), 1), (*rng.integers(0, 6, 2), 1)) for _ in range(40)]
    problem = problem_of((6, 6, 1), (9,), (9,), pins)
    routes = []
    for (x1, y1, _), (x2, y2, _) in pins:
        across = [edge(problem, 0, x, y1, 0) for x in range(min(x1, x2), max(x1, x2))]
        up = [edge(problem, 1, x2, y, 0) for y in range(min(y1, y2), max(y1, y2))]
        routes.append(np.array(across + up, np.int64))
    (axes,) = figures.solution_2d(problem, Solution(problem, tuple(routes))).axes
    pins_drawn = next(line for line in axes.lines if line.get_linestyle() == "None")
    owners = [gcells for gcells in problem.pin_gcells for _ in gcells]
    assert len(np.unique(pins_drawn.get_xydata(), axis=0)) == len(owners)


def test_disconnected_nets_show_in_the_title(worked):
    problem, _ = worked
    solution = Solution(problem, (np.zeros(0, np.int64),) * 4)
    (axes,) = figures.solution_2d(problem, solution).axes
    assert axes.get_title() == "WL 0, OF 0, 4 of 4 nets not joined"


def test_solution_3d_puts_layers_above_one_another(worked):
    (axes,) = figures.solution_3d(*worked).axes
    heights = {
        line.get_color(): sorted({z for z in line.get_data_3d()[2] if np.isfinite(z)})
        for line in axes.lines
    }
    assert heights["#0077BB"] == [1]
    assert heights["#CC3311"] == [2]
    assert heights["#808080"] == [1, 2]
    assert axes.get_title() == "WL 8, OF 1"


def test_many_layers_have_different_colours():
    problem = problem_of((2, 2, 9), (1,) * 9, (1,) * 9, [((0, 0, 1), (1, 0, 1))])
    solution = Solution(problem, (np.array([0], np.int64),))
    legend = figures.solution_2d(problem, solution).legends[0]
    colours = [line.get_color() for line in legend.get_lines()[:9]]
    assert len(set(colours)) == 9


def test_comparison_has_a_titled_drawing_for_each_router(worked):
    problem, solution = worked
    other = Solution(problem, (*solution.edges[:3], np.zeros(0, np.int64)))
    figure = figures.comparison({"A*": solution, "DQN": other})
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["A*: WL 8, OF 1", "DQN: WL 4, OF 1, 1 of 4 nets not joined"]
    with pytest.raises(InputError, match="at least one"):
        figures.comparison({})
    with pytest.raises(InputError):
        figures.comparison({"A*": solution, "other": crowd()[1]})


def pins_of(axes):
    line = next(line for line in axes.lines if line.get_linestyle() == "None")
    return sorted(map(tuple, line.get_xydata().tolist()))


def test_pins_lie_at_the_same_places_in_panels_to_be_compared(worked):
    problem, solution = worked
    # The long routes choose their tracks first: these here would have others by themselves.
    detour = [edge(problem, 2, 0, 0, 0), edge(problem, 0, 0, 0, 1), edge(problem, 0, 1, 0, 1)]
    other = Solution(problem, [solution.edges[0], np.array(detour), *solution.edges[2:]])
    alone = [figures.solution_2d(problem, each).axes[0] for each in (solution, other)]
    assert pins_of(alone[0]) != pins_of(alone[1])
    panels = figures.comparison({"A*": solution, "DQN": other}).axes
    assert pins_of(panels[0]) == pins_of(panels[1])


def test_dead_ends_show_in_the_title(worked):
    problem, solution = worked
    stub = edge(problem, 1, 2, 0, 0)
    longer = Solution(problem, [np.append(solution.edges[0], stub), *solution.edges[1:]])
    title = figures.solution_2d(problem, longer).axes[0].get_title()
    assert title.replace("\N{NO-BREAK SPACE}", " ") == "WL 9 (8 pruned), OF 2"


def widths(figure):
    """The width of each panel's title and of the panel itself, in pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    return [
        (axes.title.get_window_extent(renderer).width, axes.get_window_extent(renderer).width)
        for axes in figure.axes
        if axes.get_title()
    ]


def test_long_titles_stay_above_their_panels(worked):
    _, solution = worked
    name = "a router with a name that is longer than any panel is wide, of three panels"
    figure = figures.comparison({f"{name} {i}": solution for i in range(3)})
    found = widths(figure)
    assert len(found) == 3
    assert all(title < 1.1 * panel for title, panel in found)
    words = " ".join(figure.axes[0].get_title().split())
    assert words == f"{name} 0: WL 8, OF 1"


@pytest.mark.parametrize(
    "look",
    [
        figures.heat_maps,
        figures.utilisation_histogram,
        figures.edges_before_after,
        utilisation.depleted_edges,
    ],
)
def test_a_solution_of_another_problem_is_refused(worked, look):
    with pytest.raises(InputError, match="grid"):
        look(worked[0], crowd()[1])


def mean_line(figure, name):
    return next(line for line in figure.axes[0].lines if line.get_label() == name)


def test_reward_curves_smooth_by_the_last_episodes():
    figure = figures.reward_curves({"a": [0, 10, 20, 60]}, smoothing=2, title="DQN")
    assert mean_line(figure, "a").get_ydata().tolist() == [0, 5, 15, 40]
    assert mean_line(figure, "a").get_xdata().tolist() == [1, 2, 3, 4]
    assert any(line.get_ydata().tolist() == [0, 10, 20, 60] for line in figure.axes[0].lines)
    assert "DQN" in figure.axes[0].get_title()
    assert "last 2 episodes" in figure.axes[0].get_title()
    (only,) = figures.reward_curves({"a": [3, 1]}, smoothing=1).axes[0].lines
    assert only.get_ydata().tolist() == [3, 1]


def test_reward_curves_on_a_log_axis_keep_the_order_of_all_values():
    rewards = np.array([-2500, -500, -100, -1, 0, 1, 100, 1000, 4800])
    (axes,) = figures.reward_curves({"a": rewards}, log=True).axes
    drawn = axes.yaxis.get_transform().transform(rewards.astype(float))
    assert np.isfinite(drawn).all()
    assert (np.diff(drawn) > 0).all()
    # From 1000 to 4800 takes less room than from 100 to 1000.
    assert drawn[-1] - drawn[-2] < drawn[-2] - drawn[-3]
    assert "logarithm" in axes.get_ylabel()
    assert "logarithm" not in figures.reward_curves({"a": rewards}).axes[0].get_ylabel()


def legend_of(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_reward_curves_have_a_title_and_a_legend():
    curves = {str(i): [i, i + 1] for i in range(12)}
    figure = figures.reward_curves(curves)
    assert legend_of(figure) == list(curves)
    (axes,) = figure.axes
    assert axes.get_title().startswith("Rewards of a training")
    lines = [line for line in axes.lines if line.get_label() in curves]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 12


def test_the_legend_of_rewards_is_no_wider_than_the_picture():
    curves = {f"test_benchmark_{number}": [1.0, 2.0] for number in range(11)}
    figure = figures.reward_curves(curves)
    figure.canvas.draw()
    (legend,) = figure.legends
    assert legend.get_window_extent().width <= figure.bbox.width


def test_very_many_reward_curves_are_drawn_with_their_mean():
    curves = {str(i): [i, i + 1, i + 4] for i in range(13)}
    curves["12"].pop()  # a training that is not finished
    figure = figures.reward_curves(curves, smoothing=1)
    assert legend_of(figure) == ["each of 13", "mean of all 13"]
    assert mean_line(figure, "mean of all 13").get_ydata().tolist() == [6, 7]
    assert len(figure.axes[0].lines) == 14


@pytest.mark.parametrize(("curves", "smoothing"), [({}, 50), ({"a": [1]}, 0)])
def test_reward_curves_refuse(curves, smoothing):
    with pytest.raises(InputError, match="expected"):
        figures.reward_curves(curves, smoothing=smoothing)


def test_routers_with_open_nets_are_counted_in_the_legend():
    nan = np.nan
    values = {
        "astar": np.array([10.0, 20, 30]),
        "dqn": np.array([9.0, nan, nan]),
        "random": np.full(3, nan),
    }
    figure = figures.by_problem(values, np.array([2, 0, 1]), "wirelength", "A*'s")
    assert legend_of(figure) == [
        "astar",
        "dqn (open nets on 2 of 3 problems)",
        "random (open nets on 3 of 3 problems)",
    ]
    astar, dqn, random = figure.axes[0].lines
    assert {line.get_linestyle() for line in (astar, dqn, random)} == {"None"}
    np.testing.assert_array_equal(astar.get_ydata(), [30, 10, 20])
    np.testing.assert_array_equal(dqn.get_ydata(), [nan, 9, nan])


def test_gaps_say_how_many_problems_are_missing():
    gaps = {"dqn": np.array([0.0, 3, np.nan]), "random": np.full(3, np.nan)}
    (axes,) = figures.gaps_by_router(gaps, "the title").axes
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == ["dqn\nmean 1.50 %, 1 without a gap", "random\n3 without a gap"]
    dots, mean = (line.get_xdata() for line in axes.lines[:2])
    assert (list(dots), list(mean)) == ([0, 3], [1.5])
    with pytest.raises(InputError, match="at least one router"):
        figures.gaps_by_router({})


def test_decreases_say_how_many_problems_are_missing():
    decreases = {"dqn": np.array([3.0, np.nan, -1]), "random": np.full(3, np.nan)}
    figure = figures.decrease_histogram(decreases, "A*", "the title")
    assert figure.get_suptitle() == "the title"
    titles = [axes.get_title() for axes in figure.axes]
    assert "lower on 1 of 2 problems" in titles[0]
    assert titles[0].endswith("1 with open nets not shown")
    assert titles[1] == "random: no problem; 3 with open nets not shown"


@pytest.mark.parametrize("value", [0, 7])
def test_the_same_count_on_all_problems_is_drawn_between_whole_numbers(value):
    values = {"astar": np.full(3, float(value)), "dqn": np.full(3, float(value))}
    figure = figures.by_problem(values, np.arange(3), "overflow [tracks]", "A*'s wirelength")
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert [tick for tick in axes.get_yticks() if low <= tick <= high] == [value, value + 1]


def test_means_that_hardly_differ_are_all_on_the_axis():
    values = {"astar": np.array([0.4, 1.0, 1.0])}
    (axes,) = figures.by_problem(values, np.arange(3), "overflow [tracks]", "A*'s").axes
    low, high = axes.get_ylim()
    assert low < 0.4
    assert high > 1


@pytest.mark.parametrize(
    ("name", "magic"),
    [("a/b.png", b"\x89PNG"), ("plain", b"\x89PNG"), ("b.PDF", b"%PDF"), ("c.svg", b"<?xml")],
)
def test_save_writes_the_suffix_format(tmp_path, name, magic):
    figures.save(figures.reward_curves({"a": [1, 2]}), tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(magic)


def test_save_is_whole_or_not_at_all(tmp_path, monkeypatch):
    figure = figures.reward_curves({"a": [1, 2]})
    path = tmp_path / "old.png"
    path.write_text("old")

    def half(target, **_):
        target.write_text("half")
        raise MemoryError

    monkeypatch.setattr(figure, "savefig", half)
    with pytest.raises(MemoryError):
        figures.save(figure, path)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("old.png", "old")]


def test_save_says_where_it_cannot_write(tmp_path):
    figure = figures.reward_curves({"a": [1, 2]})
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        figures.save(figure, tmp_path / "file" / "a.png")
    with pytest.raises(InputError, match="suffix"):
        figures.save(figure, tmp_path / "a.docx")
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


KINDS = ("heat_maps", "histogram", "edges", "solution_2d", "solution_3d")


def test_problem_figures_writes_all(worked, tmp_path):
    problem, solution = worked
    written = plot.problem_figures(problem, {"A*": solution}, tmp_path / "out")
    assert [path.name for path in written] == [f"A_{kind}.png" for kind in KINDS]
    assert set(written) == set((tmp_path / "out").iterdir())


def test_problem_figures_of_two_routers_are_compared_and_kept_apart(worked, tmp_path, monkeypatch):
    problem, solution = worked
    monkeypatch.setattr(figures, "save", lambda _, path: path.touch())
    written = plot.problem_figures(problem, {"A*": solution, "A!": solution}, tmp_path)
    expected = {f"{router}_{kind}.png" for router in ("A", "A_1") for kind in KINDS}
    assert {path.name for path in tmp_path.iterdir()} == expected | {"comparison.png"}
    assert len(written) == 11


def test_figures_leave_pyplot_alone():
    code = "import sys, policies.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
