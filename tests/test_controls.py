"""Controls of problems: layers, less capacity, nets that stay; the same everywhere."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from marouting import (
    Area,
    Controls,
    InputError,
    Net,
    Pin,
    Problem,
    ProblemFile,
    Solution,
    adjusted,
    evaluate,
    generate,
    global_routing_v0,
    sequential_astar,
)
from marouting.config import plain
from marouting.game import Game
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.rules import Rules
from marouting.source import fixed_problems, load_problem
from marouting.yaml_files import yaml_text
from policies.cli.main import status
from policies.experiment.config import load_set
from policies.learned.config import load_config
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

CHIP = Path(__file__).resolve().parents[1] / "docs" / "examples" / "problems" / "chip.def"
FOUR = generate(1, (8, 8, 4), nets=40, max_pins=4, capacity=5, reduced_edges=12, seed=5)[0]


def wires(solution: Solution) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Net and layer, from 1, of every edge inside a layer that a solution uses."""
    net, edge = solution.uses
    inside = edge % AXES != VIA_AXIS
    return net[inside], edge[inside] // AXES % solution.problem.grid[2] + 1


def routed(problem: Problem) -> Solution:
    return PathfinderRouter(PathfinderOptions(seconds=1)).route(problem)


def test_no_controls_change_nothing() -> None:
    assert adjusted(FOUR, Controls()) is FOUR
    everything = Controls(layers="1..4", derate={"1..4": 1})
    assert np.array_equal(adjusted(FOUR, everything).capacity, FOUR.capacity)


def test_wires_keep_to_the_range_of_layers() -> None:
    problem = adjusted(FOUR, Controls(layers="3..4"))
    capacity = problem.capacity.reshape(*problem.grid, AXES)[..., :VIA_AXIS]
    own = FOUR.capacity.reshape(*problem.grid, AXES)[..., :VIA_AXIS]
    assert not capacity[:, :, :2].any()
    assert np.array_equal(capacity[:, :, 2:], own[:, :, 2:])
    for solution in (sequential_astar(problem), routed(problem)):
        judged = evaluate(problem, solution)
        assert judged.connected  # by vias from pins in layer 1
        net, layer = wires(solution)
        assert len(net)
        assert judged.overflow or set(layer.tolist()) <= {3, 4}
    assert set(wires(routed(problem))[1].tolist()) <= {3, 4}


@pytest.mark.parametrize("given", ["2..", "..2", "3..4", 2, "Metal2", "Metal2..Metal3", "4"])
def test_layers_by_number_and_name(given: Any) -> None:
    names = {"Metal2..Metal3": (1, 2), "Metal2": (1, 1), "2..": (1, 3), "..2": (0, 1)}
    first, last = names.get(given) or (int(str(given)[0]) - 1, int(str(given)[-1]) - 1)
    both = replace(FOUR, horizontal_capacity=(3,) * 4, vertical_capacity=(3,) * 4, adjustments=())
    kept = adjusted(both, Controls(layers=given)).layer_capacity[:, 0] > 0
    assert np.flatnonzero(kept).tolist() == list(range(first, last + 1))


def test_each_net_keeps_to_its_own_layers() -> None:
    clocks = tuple(net.name for net in FOUR.nets[:6])
    controls = Controls(layers="1..2", clock_layers="3..4", clock_nets=clocks)
    problem = adjusted(replace(FOUR, adjustments=()), controls)
    assert [net.name for net in problem.nets] == [net.name for net in FOUR.nets]
    solution = routed(problem)
    judged = evaluate(problem, solution)
    assert judged.connected
    net, layer = wires(solution)
    out_of_range = (net < 6) == (layer <= 2)
    # Every wire out of its range is overflow, and pathfinder makes none of it needlessly.
    assert judged.overflow >= np.count_nonzero(out_of_range)
    assert np.count_nonzero(out_of_range) <= judged.overflow <= 10
    assert {1, 2} >= set(layer[(net >= 6) & ~out_of_range].tolist())
    # The whole route of one signal net in the clocks' layers: each edge overflows.
    signal = np.flatnonzero(np.bincount(net, minlength=40) > 0)
    signal = signal[signal >= 6][:1]
    edges = [np.empty(0, np.int64)] * 40
    own = solution.edges[signal[0]]
    lifted = np.where((own % AXES != VIA_AXIS) & (own // AXES % 4 < 2), own + 2 * AXES, own)
    edges[signal[0]] = lifted
    inside = np.count_nonzero(lifted % AXES != VIA_AXIS)
    assert evaluate(problem, Solution(problem, edges)).overflow >= inside > 0
    # So the game blocks it, where overflow is not allowed.
    game = Game(problem, Rules())
    for n, number in enumerate(game.nets):
        needed = game.needed[n]
        for z in range(4):
            most = problem.layer_capacity[z, :VIA_AXIS].max()
            assert (needed[z] > most) == ((z < 2) == (number < 6))


def test_long_nets_go_in_higher_layers() -> None:
    problem = adjusted(replace(FOUR, adjustments=()), Controls(long_layers="3..4", long_nets=9))
    low, high = FOUR.pin_boxes()
    long = (high - low)[:, :2].sum(axis=1) >= 9
    assert 0 < long.sum() < len(long)
    closed = problem.net_demand[:, :2] > 5
    assert np.array_equal(closed.all(axis=1), long)
    assert np.array_equal(closed.any(axis=1), long)


def test_derating_by_layer_and_in_areas() -> None:
    ten = replace(FOUR, horizontal_capacity=(10, 0, 10, 0), vertical_capacity=(0, 10, 0, 10))
    area = Area(columns=(2, 3), rows=(5, 5), factor=0.5, layers="3..4")
    problem = adjusted(ten, Controls(derate={"Metal3": 0.7, "1..2": 0.8}, areas=(area,)))
    table = problem.capacity.reshape(*problem.grid, AXES)
    own = ten.capacity.reshape(*problem.grid, AXES)
    expected = own.astype(np.float64)
    expected[:, :, :2, :2] *= 0.8
    expected[:, :, 2, :2] *= 0.7
    for x in range(8):
        for y in range(8):
            inside = [(2 <= i <= 3 and j == 5) for i, j in ((x, y), (x + 1, y), (x, y + 1))]
            expected[x, y, 2:, 0] *= 0.5 if inside[0] or inside[1] else 1
            expected[x, y, 2:, 1] *= 0.5 if inside[0] or inside[2] else 1
    assert np.array_equal(table[..., :2], np.floor(expected[..., :2] + 1e-6))
    assert table[0, 0, 2, 0] == 7  # and not 6, as 0.7 · 10 is just below 7 in floating point
    assert table[2, 5, 2, 0] == 3


@pytest.mark.parametrize("format", ["solution", "guide"])
def test_nets_that_are_kept(tmp_path: Path, format: str) -> None:
    before = routed(FOUR)
    file = tmp_path / f"before.{format}"
    before.write(file)
    named = ("A1?", "A7")
    problem = adjusted(FOUR, Controls(keep=str(file), keep_nets=named))
    kept = [i for i, net in enumerate(FOUR.nets) if net.name[:-1] == "A1" or net.name == "A7"]
    assert len(kept) == 11
    free = [i for i in range(40) if i not in kept]
    assert [net.name for net in problem.nets] == [FOUR.nets[i].name for i in free]
    # What they take is off the capacities, all of it.
    read = Solution.read(file, FOUR)
    edges = [own if i in kept else np.empty(0, np.int64) for i, own in enumerate(read.edges)]
    taken = Solution(FOUR, edges).edge_demand
    inside = np.arange(len(taken)) % AXES != VIA_AXIS
    expected = np.maximum(FOUR.capacity - taken, 0)
    assert np.array_equal(problem.capacity[inside], expected[inside])
    # The others are routed; files have all nets; those that are kept are as they were.
    after = routed(problem)
    for name in ("after.solution", "after.guide"):
        after.write(tmp_path / name)
        everything = Solution.read(tmp_path / name, FOUR)
        assert evaluate(FOUR, everything).connected
        for i in kept:
            assert np.array_equal(everything.edges[i], read.edges[i])
    again = Solution.read(tmp_path / "after.solution", problem)
    assert again == after
    whole = evaluate(FOUR, Solution.read(tmp_path / "after.solution", FOUR))
    assert whole.overflow == 0 == evaluate(problem, after).overflow
    assert evaluate(problem, after).wirelength < whole.wirelength


def boxes_in(guide: Path) -> dict[str, list[str]]:
    """The lines of a guide, by net."""
    found: dict[str, list[str]] = {}
    for entry in guide.read_text().split(")\n")[:-1]:
        name, _, *lines = entry.splitlines()
        found[name] = lines
    return found


def test_places_of_kept_pins_leave_as_well(tmp_path: Path) -> None:
    file = ProblemFile(path=str(CHIP))
    problem = file.read()
    routed(problem).write(tmp_path / "all.guide")
    names = tuple(net.name for net in problem.nets[::3])
    some = adjusted(problem, Controls(keep=str(tmp_path / "all.guide"), keep_nets=names))
    assert problem.chip is not None
    assert some.chip is not None
    assert problem.chip.places is not None
    assert some.chip.places is not None
    left = [i for i, net in enumerate(problem.nets) if net.name not in names]
    assert len(some.nets) == len(left)

    def places_of(chip: Any, net: int) -> list[list[int]]:
        pins = range(*chip.places.first_pin[net : net + 2])
        return [chip.places.gcell[slice(*chip.places.first[p : p + 2])].tolist() for p in pins]

    for at, net in enumerate(left):
        assert places_of(some.chip, at) == places_of(problem.chip, net)
    routed(some).write(tmp_path / "new.guide")

    # The nets that stay have the boxes that they had, also where these are more than routes need.
    room = routed(problem)
    room.write(tmp_path / "room.guide", "patched-guide")
    more = adjusted(problem, Controls(keep=str(tmp_path / "room.guide"), keep_nets=names))
    routed(more).write(tmp_path / "newer.guide")
    boxes = boxes_in(tmp_path / "room.guide"), boxes_in(tmp_path / "newer.guide")
    assert all(sorted(boxes[0][name]) == sorted(boxes[1][name]) for name in names)
    assert sum(map(len, boxes[1].values())) < sum(map(len, boxes[0].values()))
    judged = Solution.read(tmp_path / "new.guide", problem).at_reached_pins()
    assert evaluate(judged.problem, judged).connected


def test_the_environment_plays_the_adjusted_problem() -> None:
    given = {"path": str(CHIP), "layers": "2..3", "derate": {"Metal3": 0.5}}
    expected = ProblemFile(**given).read()
    env = global_routing_v0.raw_env(problem=given)
    env.reset()
    assert env.state().shape == global_routing_v0.raw_env(problem=expected).state_space.shape
    assert [*env.possible_agents] == [*global_routing_v0.raw_env(problem=expected).possible_agents]
    assert env.metrics()["tasks"] > 100
    assert load_problem(ProblemFile(**given)) == expected
    assert len(global_routing_v0.raw_env(problem={"nets": 4}).possible_agents) == 4


def test_configurations_take_controls(tmp_path: Path) -> None:
    given = {"path": str(CHIP), "layers": "2..3", "derate": {"Metal3": 0.5}}
    expected = ProblemFile(**given).read()
    assert load_set("chips", given) == {"chip": expected}
    words = [f"env.problem.path={CHIP}", "env.problem.layers=2..3", "env.problem.derate.Metal3=0.5"]
    config = load_config(None, words)
    assert fixed_problems(config.env) == {"chip": expected}
    (tmp_path / "c.yaml").write_text(yaml_text(plain(config)))
    assert load_config(tmp_path / "c.yaml") == config
    with pytest.raises(InputError, match=r"env.problem.layrs: unknown key; did you mean layers"):
        load_config(None, [*words, "env.problem.layrs=2"])


def test_commands_take_controls(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "chip.lef").write_text(CHIP.with_suffix(".lef").read_text())
    (tmp_path / "chip.def").write_text(CHIP.read_text())
    controls = ["--control", "layers=Metal2..Metal3", "--control", "derate.Metal2=0.9"]
    assert status(["route", "chip.def", "--out", "r.guide", "--json", *controls]) == 0
    adjusted_one = ProblemFile(
        path="chip.def", layers="Metal2..Metal3", derate={"Metal2": 0.9}
    ).read()
    expected = evaluate(adjusted_one, sequential_astar(adjusted_one))
    assert f'"wirelength": {expected.wirelength},' in capsys.readouterr().out
    keep = ["--control", "keep=r.guide", "--control", "keep_nets=[n1*]"]
    assert status(["route", "chip.def", "--out", "s.solution", *controls, *keep]) == 0
    assert status(["evaluate", "chip.def", "s.solution", *controls, *keep]) == 0
    assert status(["view", "chip.def", "s.solution", "--out", "p.html", *controls, *keep]) == 0
    for key, section in (("env.problem", "train"), ("problems.small", "experiment")):
        problem = {"path": "chip.def", "keep": "r.guide", "keep_nets": ["n1*"]}
        raw: dict[str, Any] = {"env": {"problem": problem}, "out": "kept"}
        if section == "experiment":
            raw = {
                "problems": {"small": problem},
                "routers": {"a": {"router": "astar"}},
                "out": "kept",
            }
        (tmp_path / "kept.yaml").write_text(json.dumps(raw))
        assert status([section, "kept.yaml"]) == 2
        assert f"{key}.keep: expected none" in capsys.readouterr().err
        assert not (tmp_path / "kept").exists()
    assert status(["convert", "chip.def", "p.gr", *controls]) == 0
    assert Problem.read("p.gr") == adjusted_one
    assert "open nets" not in capsys.readouterr().out
    assert status(["convert", "chip.def", "p.guide"]) == 2
    assert "p.guide: expected another suffix: .guide is for" in capsys.readouterr().err
    (tmp_path / "lonely.def").write_text(CHIP.read_text())
    for name, said in (("lonely.def", "lonely.lef beside it, or its LEF"), ("chip.lef", "a .def")):
        assert status(["route", name]) == 2
        assert said in capsys.readouterr().err
    assert status(["route", "chip.def", "--control", "layer=2"]) == 2
    assert "--control: layer: unknown key; did you mean layers?" in capsys.readouterr().err


def test_problems_with_ranges_by_net_are_written_as_text(tmp_path: Path) -> None:
    controls = Controls(clock_layers="3..4", clock_nets=("A1",))
    problem = adjusted(FOUR, controls)
    problem.write(tmp_path / "p.gr")
    assert Problem.read(tmp_path / "p.gr") == problem
    assert adjusted(FOUR, Controls(clock_layers="3..4", clock_nets="A1")) == problem


@pytest.mark.parametrize(
    ("controls", "message"),
    [
        ({"layers": "2..9"}, "layers: expected a layer from 1 to 4 or by its name, Metal1, Metal2"),
        ({"layers": "Metal5"}, "layers: did you mean Metal4"),
        ({"layers": "0..2"}, "layers: expected a layer from 1 to 4"),
        ({"layers": "3..2"}, "layers: expected a range from a lower to a higher layer"),
        ({"layers": "2"}, "layers: expected a layer for horizontal wires among them, found none"),
        ({"clock_layers": "3..4"}, "clock_layers: expected clock nets: clock_nets=NAMES, or USE"),
        ({"clock_layers": 1, "clock_nets": ["x*"]}, "clock_nets: expected names of nets, found"),
        ({"clock_nets": ["A1"]}, "clock_nets: expected clock_layers beside them"),
        ({"long_layers": 2}, "long_layers: expected long_nets beside it"),
        ({"derate": {"Metal1": 1.5}}, "derate.Metal1: expected a number from 0 to 1, found 1.5"),
        ({"derate": {"met1": 0.5}}, "derate.met1: did you mean Metal1? expected a layer"),
        ({"derate": 0.5}, "derate: expected a mapping"),
        (
            {"areas": [{"columns": [0, 8], "rows": [0, 1], "factor": 0.5}]},
            "areas.0.columns: expected a first and a last one from 0 to 7",
        ),
        ({"keep_nets": ["A1"]}, "keep_nets: expected keep beside them"),
        ({"keep": "none.guide"}, "none.guide: "),
    ],
)
def test_controls_that_cannot_be(
    tmp_path: Path, monkeypatch: Any, controls: Any, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    FOUR.write("p.gr")
    with pytest.raises(InputError) as caught:
        load_problem({"path": "p.gr", **controls})
    assert message in str(caught.value)


def test_what_is_no_problem_or_no_controls() -> None:
    with pytest.raises(InputError, match="problem: expected a Problem, "):
        adjusted("p.gr", Controls())  # type: ignore[arg-type]
    for wrong in (None, {"layers": 1}):
        with pytest.raises(InputError, match="controls: expected Controls, found"):
            adjusted(FOUR, wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("tile", [(2000,), 2000, ("2000", "2000"), (2000.5, 2000), (1, 2, 3)])
def test_a_tile_has_two_whole_sides(tile: Any) -> None:
    with pytest.raises(InputError, match="tile: expected a width and a height, found"):
        Problem.read("chip.def", tile=tile)


def test_kept_routes_that_cannot_be(tmp_path: Path) -> None:
    nets = Net("a", 1, (Pin(0, 0, 1), Pin(2, 0, 1))), Net("b", 2, (Pin(0, 0, 1), Pin(2, 0, 1)))
    problem = Problem((3, 1, 1), (0,), (2,), nets, (1,), (0,), (0,))
    file = tmp_path / "r.solution"
    Solution(problem, [np.array([0]), np.array([0, 3])]).write(file)
    with pytest.raises(InputError, match="net a: expected a route that joins all pins; keep_nets"):
        adjusted(problem, Controls(keep=str(file)))
    one = adjusted(problem, Controls(keep=str(file), keep_nets=("b",)))
    with pytest.raises(InputError, match=r"p\.gr: expected a problem without nets that stay"):
        one.write(tmp_path / "p.gr")
    assert one.horizontal_capacity == (2,)
    assert one.capacity_of(np.array([0, 3])).tolist() == [1, 1]
    with pytest.raises(InputError, match="problem: expected a problem without nets that stay"):
        adjusted(one, Controls(derate={"1": 0.5}))
    assert adjusted(one, Controls()) is one
    sequential_astar(problem).write(file)
    with pytest.raises(InputError, match="keep: expected at least one net that does not stay"):
        adjusted(problem, Controls(keep=str(file)))


def test_the_layer_of_the_pins_is_read_with_wires_or_refused() -> None:
    with pytest.raises(InputError, match=r"layers: expected layers above Metal1.* found '1\.\.'"):
        adjusted(Problem.read(CHIP), Controls(layers="1.."))
    read = Problem.read(CHIP, pin_layer_wires=True)
    assert (
        adjusted(read, Controls(layers="1..")) == ProblemFile(path=str(CHIP), layers="1..").read()
    )
    with pytest.raises(InputError, match="clock_layers: expected layers above Metal1"):
        ProblemFile(path=str(CHIP), clock_layers="1..2", clock_nets="*").read()
