import subprocess
import sys
import time
import types
import warnings

import numpy as np
import pytest
from conftest import some_slow

import marouting
from marouting.problem.grid import AXES, Grid
from marouting.problem.problem import UNLIMITED
from marouting.render import PALETTE, USE, Scene, Window, ansi, rgb_array, scene_of

ORANGE = (226, 88, 12)
YELLOW = (255, 196, 61)


def scene(
    shape=(3, 3, 2), demand=(), capacity=2, heads=(), targets=(), turn=None,
    caption="step 3  overflow 1",
):  # fmt: skip
    """Capacity along x in layers 1, 3, … and along y in 2, 4, …; ``demand`` maps edges to nets."""
    grid = Grid.of(shape)
    axis, layer = np.arange(grid.edges) % AXES, np.arange(grid.edges) // AXES % shape[2]
    limits = np.where(axis == layer % 2, capacity, 0)
    limits[axis == 2] = UNLIMITED
    limits[~grid.exists] = 0
    used = np.zeros(grid.edges, np.int64)
    uses = []
    for edge, nets in sorted(dict(demand).items()):
        nets = range(nets) if isinstance(nets, int) else nets
        used[edge] = len(nets)
        uses += [(net, edge) for net in nets]
    net, edge = np.array(uses, np.int64).reshape(-1, 2).T
    remaining = limits - np.where(axis == 2, 0, used)
    return Scene(
        grid,
        limits.astype(np.int32),
        remaining.astype(np.int32),
        net,
        edge,
        np.arange(len(heads)),
        np.array(heads, np.int32),
        np.array(targets, np.int32),
        tuple(f"net_{i}" for i in range(len(heads))),
        turn,
        caption,
    )


def edge(axis, x, y, z, shape=(3, 3, 2)):
    return AXES * Grid.of(shape).number(x, y, z) + axis


def has(picture, colour):
    return (picture == np.array(colour)).all(axis=2).any()


def changed(before, after):
    """The columns and rows of the smallest box around all changed pixels."""
    rows, columns = np.nonzero((before != after).any(axis=2))
    return (columns.min(), columns.max() + 1), (rows.min(), rows.max() + 1)


def test_text_of_a_hand_drawn_scene():
    grid = Grid.of((3, 3, 2))
    picture = ansi(
        scene(
            demand={
                edge(0, 0, 0, 0): 1,
                edge(0, 1, 0, 0): 2,
                edge(0, 0, 2, 0): 3,
                edge(1, 2, 0, 1): 2,
                edge(1, 2, 1, 1): 1,
                edge(1, 0, 0, 0): 1,  # has no capacity
                edge(2, 2, 0, 0): 1,
            },
            heads=(grid.number(2, 2, 1), grid.number(1, 1, 0)),
            targets=(grid.number(0, 2, 0), grid.number(0, 1, 0)),
            turn=0,
        )
    )
    assert picture.splitlines() == [
        "step 3  overflow 1",
        "",
        "layer 1",
        "2 T××·╌╌·",
        "",
        "1 t╌╌h╌╌·",
        "  ×",
        "0 ·──·━━o",
        "  0  1  2",
        "",
        "layer 2",
        "2 ·  ·  H",
        "  ╎  ╎  │",
        "1 ·  ·  ·",
        "  ╎  ╎  ┃",
        "0 ·  ·  o",
        "  0  1  2",
        "",
        "H head and T target of net_0, to move; h heads and t targets of other nets; o via",
        "edges: ╌ free  ─ used  ━ full  × overflowed  (blank: no capacity)",
    ]


def test_text_names_no_mover_without_a_turn():
    picture = ansi(scene(heads=(0,), targets=(4,)))
    assert "to move" not in picture
    assert not set("HT") & set(picture)
    assert "h" in picture.split("layer 2")[0]


def test_text_rulers_stay_in_line_on_a_large_grid():
    lines = ansi(scene((105, 12, 1))).splitlines()
    ruler = next(line for line in lines if line.startswith("   0"))
    row = next(line for line in lines if line.startswith(" 9 "))
    assert row.index("·") == ruler.index("0")
    assert ruler.index("100") == ruler.index("0") + 300


@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (2, 2, 1), (1, 9, 2), (8, 8, 2), (32, 32, 2), (20, 10, 4), (90, 90, 6)]
)
def test_rgb_sizes(shape):
    gcells = int(np.prod(shape))
    empty = rgb_array(scene(shape))
    busy = rgb_array(
        scene(shape, demand={2: 1} if shape[2] > 1 else {}, heads=(0,), targets=(gcells - 1,))
    )
    assert empty.dtype == np.uint8
    assert empty.shape == busy.shape
    assert empty.shape[2] == 3
    assert empty.shape[0] % 2 == empty.shape[1] % 2 == 0
    assert 190 <= max(empty.shape) <= 1210


@pytest.mark.parametrize("shape", [(1, 5, 1), (1, 155, 1), (1, 400, 1), (2, 274, 1), (3, 365, 1)])
def test_rgb_narrow_grids_have_room_for_the_legend(shape):
    """Its words, and the last of them: nothing is drawn at the right border."""
    picture = rgb_array(scene(shape, heads=(0,), targets=(1,)))
    assert picture.shape[1] >= 160
    assert max(picture.shape) <= 1350
    assert (picture[:, -4:] == 255).all()
    assert has(picture, PALETTE[0])


def test_rgb_two_layers_lie_side_by_side_and_four_in_a_square():
    height, width, _ = rgb_array(scene((8, 8, 2))).shape
    assert width > 1.5 * height
    height, width, _ = rgb_array(scene((8, 8, 4))).shape
    assert 0.8 < width / height < 1.1


def test_rgb_a_used_edge_changes_only_the_bar_between_its_gcells():
    before = rgb_array(scene())
    along_x, above = changed(before, rgb_array(scene(demand={edge(0, 0, 0, 0): 1})))
    next_x, same_row = changed(before, rgb_array(scene(demand={edge(0, 1, 0, 0): 1})))
    upper_x, upper = changed(before, rgb_array(scene(demand={edge(0, 0, 2, 0): 1})))
    assert above == same_row
    assert along_x == upper_x
    assert upper[1] < above[0]  # y runs upwards
    assert along_x[1] <= next_x[0]
    other_layer, _ = changed(before, rgb_array(scene(demand={edge(1, 0, 0, 1): 1})))
    assert other_layer[0] > before.shape[1] / 2


def test_rgb_draws_every_net_of_an_edge_in_its_colour():
    name = edge(0, 0, 0, 0)
    free = rgb_array(scene(capacity=3))
    for nets in ([7], [1, 7], [7, 49, 2]):
        picture = rgb_array(scene(demand={name: nets}, capacity=3))
        (left, right), (top, bottom) = changed(free, picture)
        found = [tuple(picture[row, (left + right) // 2].tolist()) for row in range(top, bottom)]
        lines = [colour for n, colour in enumerate(found) if colour not in found[:n]]
        expected = [tuple(PALETTE[net % len(PALETTE)].tolist()) for net in nets]
        if len(nets) == 3:  # full: a border around them
            assert found[0] == found[-1] == lines[0]
            lines = lines[1:]
        assert lines == expected
    assert len({tuple(colour) for colour in PALETTE.tolist()}) == len(PALETTE)


@pytest.mark.parametrize("capacity", [1, 2, 5])
def test_rgb_draws_every_net_of_an_overflowed_edge(capacity):
    """Also those beyond the most tracks that an edge has."""
    nets = list(range(7))
    picture = rgb_array(scene(demand={edge(0, 0, 0, 0): nets}, capacity=capacity))
    above = picture[: picture.shape[0] * 3 // 4]  # without the legend
    assert [has(above, PALETTE[net]) for net in nets] == [True] * 7
    assert has(above, ORANGE)


def test_rgb_full_edges_have_dark_borders_and_overflowed_ones_wide_orange_borders():
    name = edge(0, 0, 0, 0)
    pictures = [rgb_array(scene(demand={name: nets}, capacity=3)) for nets in range(5)]
    above = [p[: p.shape[0] * 3 // 4] for p in pictures]  # without the legend
    assert [has(p, ORANGE) for p in above] == [False] * 4 + [True]
    heights = []
    for picture in pictures[1:]:
        _, (top, bottom) = changed(pictures[0], picture)
        heights.append(bottom - top)
    assert heights[0] < heights[1] < heights[2] < heights[3]


def test_rgb_of_a_fine_grid_darkens_with_use_and_turns_orange_with_overflow():
    shape = (100, 100, 1)
    name = edge(0, 0, 0, 0, shape)
    pictures = [rgb_array(scene(shape, {name: nets}, capacity=3)) for nets in range(5)]
    (left, right), (top, bottom) = changed(pictures[0], pictures[1])
    fields = [p[(top + bottom) // 2, (left + right) // 2].astype(int) for p in pictures]
    sums = [field.sum() for field in fields]
    assert sums[0] > sums[1] > sums[2] > sums[3]
    assert fields[3].tolist() == list(USE[2][1])
    red, green, blue = fields[4].tolist()
    assert red > green > blue


@pytest.mark.parametrize("side", some_slow((100, 250, 404, 700), (250, 700)))
def test_rgb_of_a_large_grid_has_no_pattern(side):
    """All edges of a layer alike: so are all pixels of its panel, whatever the picture's size."""
    shape = (side, side, 2)
    along_x = [edge(0, x, y, 0, shape) for x in range(side - 1) for y in range(side)]
    picture = rgb_array(scene(shape, dict.fromkeys(along_x, 1)))
    high, wide, _ = picture.shape
    panel = picture[high // 4 : high // 2, wide // 8 : wide // 3]
    assert (panel == panel[0, 0]).all()
    assert max(high, wide) <= 1210


def test_rgb_says_step_and_score():
    before = rgb_array(scene((8, 8, 2), caption="step 3  overflow 1"))
    after = rgb_array(scene((8, 8, 2), caption="step 4  overflow 1"))
    (left, right), (_, bottom) = changed(before, after)
    assert bottom < before.shape[0] / 10  # above the panels
    assert right < before.shape[1] / 4  # only the step's digit
    assert right - left < 20
    longer = rgb_array(scene((8, 8, 2), caption="step 3  overflow 12"))
    _, (_, bottom) = changed(before, longer)
    assert bottom < before.shape[0] / 10


def test_rgb_has_a_legend():
    """Below the panels: every sign that can occur, orange for overflow as well."""
    small, fine = rgb_array(scene((8, 8, 2))), rgb_array(scene((150, 150, 2)))
    for picture in (small, fine):
        below = picture[-picture.shape[0] // 8 :]
        assert has(below, ORANGE) or has(below, USE[3][1])
        assert has(below, YELLOW)
        assert has(below, PALETTE[0])
    # The same in every moment.
    busy = rgb_array(scene((8, 8, 2), {0: 2}, heads=(5,), targets=(60,), turn=0))
    _, (_, bottom) = changed(small, busy)
    assert bottom < small.shape[0] - 40


def test_rgb_edges_without_capacity_are_not_drawn_until_they_overflow():
    free = rgb_array(scene())
    none = rgb_array(scene(capacity=0))
    assert (none != free).any()
    # Layer 1 has no capacity along y: no bar there in either picture.
    used = rgb_array(scene(demand={edge(1, 0, 0, 0): 1}))
    (left, right), (top, bottom) = changed(free, used)
    middle = np.s_[(2 * top + bottom) // 3 : (top + 2 * bottom) // 3, left:right]  # of the edge
    assert (free[middle] == 255).all()
    over = rgb_array(scene(capacity=0, demand={edge(1, 0, 0, 0): 1}))
    (left, right), (top, bottom) = changed(none, over)
    assert has(over[top:bottom, left:right], ORANGE)


def test_rgb_a_via_marks_both_layers():
    before, after = rgb_array(scene()), rgb_array(scene(demand={edge(2, 1, 1, 0): 1}))
    half = before.shape[1] // 2
    for side in (slice(half), slice(half, None)):
        assert (before[:, side] != after[:, side]).any()


def test_rgb_marks_the_net_to_move():
    grid = Grid.of((3, 3, 2))
    heads, targets = (grid.number(0, 0, 0), grid.number(2, 2, 0)), (1, 3)
    nobody, first, second = (
        rgb_array(scene(heads=heads, targets=targets, turn=turn)) for turn in (None, 0, 1)
    )
    panels = slice(nobody.shape[0] * 3 // 4)  # without the legend
    assert not has(nobody[panels], YELLOW)
    assert has(first[panels], YELLOW)
    assert not np.array_equal(first, second)
    # The first net's head lies lower left in layer 1, the second's upper right.
    (left, right), (top, bottom) = changed(first, second)
    lower_left = np.s_[(top + bottom) // 2 : bottom, left : (3 * left + right) // 4]
    assert has(first[lower_left], YELLOW)
    assert not has(second[lower_left], YELLOW)
    assert not np.array_equal(nobody, rgb_array(scene()))


def test_rgb_heads_have_the_colours_of_their_nets():
    grid = Grid.of((3, 3, 2))
    picture = rgb_array(scene(heads=(grid.number(0, 0, 1), grid.number(2, 2, 1)), targets=(0, 0)))
    half = picture[:, picture.shape[1] // 2 :]
    assert has(half[: half.shape[0] // 2], PALETTE[1])
    assert has(half[half.shape[0] // 2 :], PALETTE[0])


def test_a_scene_is_what_the_engine_holds():
    problem = marouting.generate(1, nets=12, max_pins=3, capacity=3, seed=3)[0]
    engine = marouting.Engine([problem], turn_order="round_robin", overflow="allowed")
    rng = np.random.default_rng(0)
    for _ in range(40):
        engine.step(rng.integers(0, 6, engine.nets.shape))
    drawn, solution, now = scene_of(engine), engine.solution(), engine.metrics()
    assert sorted(zip(drawn.nets, drawn.edges, strict=True)) == list(
        zip(*solution.uses, strict=True)
    )
    assert (np.diff(drawn.edges) >= 0).all()
    assert np.array_equal(drawn.capacity - drawn.remaining, solution.edge_demand)
    turns = {net: turn for turn, net in enumerate(engine.nets[0, engine.static.order[0]])}
    for name in np.unique(drawn.edges):
        users = [turns[net] for net in drawn.nets[drawn.edges == name]]
        assert users == sorted(users)
    assert drawn.labels == tuple(f"net_{net}" for net in drawn.active)
    assert drawn.labels[drawn.turn] == f"net_{engine.nets[0, engine.games[0]['agent']]}"
    assert drawn.caption.split() == [
        "step", str(now.steps), "joined", f"{now.joined}/{now.tasks}",
        "overflow", str(now.overflow), "wirelength", str(now.wirelength),
    ]  # fmt: skip


def test_pictures_need_no_matplotlib():
    code = "import sys, marouting.render; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


FRAME = np.zeros((20, 30, 3), np.uint8)


def shows_nothing_and_warns_once(match):
    window = Window()
    with pytest.warns(UserWarning, match=match) as caught:
        window.show(FRAME, 1)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert "rgb_array" in str(caught[0].message)
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        window.show(FRAME, 0.01)
        window.close()
        window.close()
    assert time.perf_counter() - start < 1


def test_window_without_a_display(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    shows_nothing_and_warns_once("no display")


def test_window_without_matplotlib(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    shows_nothing_and_warns_once("matplotlib")


@pytest.fixture
def backend(monkeypatch):
    """Switches to a backend that keeps its windows to itself; gives its canvas class."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    from matplotlib.backend_bases import FigureManagerBase
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    class Manager(FigureManagerBase):
        def show(self):
            pass

    class Canvas(FigureCanvasAgg):
        manager_class = Manager
        required_interactive_framework = "headless"

    module = types.ModuleType("quiet_backend")
    module.FigureCanvas = Canvas
    monkeypatch.setitem(sys.modules, "quiet_backend", module)
    monkeypatch.setenv("DISPLAY", ":4711")
    pyplot.switch_backend("module://quiet_backend")
    yield Canvas
    pyplot.close("all")
    pyplot.switch_backend("agg")


@pytest.mark.usefixtures("backend")
def test_window_shows_frames_in_one_window_until_it_is_closed():
    from matplotlib import pyplot

    window = Window()
    for level in (0, 200):
        window.show(FRAME + np.uint8(level), 0)
        (number,) = pyplot.get_fignums()
        (axes,) = pyplot.figure(number).axes
        assert (axes.images[0].get_array() == level).all()
    window.close()
    assert not pyplot.get_fignums()
    window.show(FRAME, 0)
    assert len(pyplot.get_fignums()) == 1


@pytest.mark.usefixtures("backend")
def test_window_closed_by_its_user_stays_closed():
    from matplotlib import pyplot

    window = Window()
    window.show(FRAME, 0)
    pyplot.close("all")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        window.show(FRAME, 0)
    assert not pyplot.get_fignums()


@pytest.mark.usefixtures("backend")
def test_window_waits_for_the_next_frame_and_no_longer():
    window = Window()
    window.show(FRAME, 0)
    start = time.perf_counter()
    window.show(FRAME, 5)
    assert 0.1 < time.perf_counter() - start < 2


def test_window_survives_what_a_toolkit_raises(backend, monkeypatch):
    def fail(*_):
        raise RuntimeError("lost connection to the display")

    monkeypatch.setattr(backend, "draw_idle", fail)
    shows_nothing_and_warns_once("lost connection")


def test_window_with_a_backend_that_opens_none(backend, monkeypatch):
    monkeypatch.setattr(backend, "required_interactive_framework", None)
    shows_nothing_and_warns_once("opens no windows")
