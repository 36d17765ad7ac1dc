"""Reports on solutions, and routing guides of any of them."""

import itertools
import json
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from reference import distance, gcell_of, pin_gcells
from strategies import problems, solved_problems

from marouting import Adjustment, Net, Pin, Problem, Solution, evaluate, generate, sequential_astar
from policies.cli.main import status
from policies.figures import congestion_map
from policies.results.report import report, steiner_bounds

# --- guides ---------------------------------------------------------------------------------------


@given(solution=solved_problems())
def test_a_guide_is_connected_and_covers_every_pin(
    solution: Solution, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """By the contest's rules: boxes touch in one layer, or overlap in two that are neighbours."""
    problem = solution.problem
    file = tmp_path_factory.mktemp("guide") / "p.guide"
    solution.write(file)
    blocks = file.read_text().split("\n)\n")[:-1]
    assert len(blocks) == len(problem.nets)
    open_nets = evaluate(problem, solution).disconnected
    (left, low), (width, height) = problem.origin, problem.tile
    for number, block in enumerate(blocks):
        name, bracket, *lines = block.split("\n")
        assert (name, bracket) == (problem.nets[number].name, "(")
        boxes = []
        for line in lines:
            *corners, layer = line.split()
            boxes.append((*map(int, corners), int(layer.removeprefix("Metal")) - 1))
        for x, y, z in pin_gcells(problem, number):
            around = (left + x * width, low + y * height)
            assert any(
                box[0] <= around[0]
                and box[1] <= around[1]
                and box[2] >= around[0] + width
                and box[3] >= around[1] + height
                and box[4] == z
                for box in boxes
            )
        graph = nx.Graph()
        graph.add_nodes_from(range(len(boxes)))
        for (i, a), (j, b) in itertools.combinations(enumerate(boxes), 2):
            wide = min(a[2], b[2]) - max(a[0], b[0])
            high = min(a[3], b[3]) - max(a[1], b[1])
            touch = min(wide, high) >= 0 and max(wide, high) > 0
            if (a[4] == b[4] and touch) or (abs(a[4] - b[4]) == 1 and min(wide, high) > 0):
                graph.add_edge(i, j)
        if name not in open_nets and not solution.edges[number].size:
            assert nx.is_connected(graph)
        elif name not in open_nets:
            # Parts of a route without pins may lie apart; those with pins are one part.
            with_pins = {
                i
                for i, box in enumerate(boxes)
                for x, y, z in pin_gcells(problem, number)
                if box[4] == z
                and box[0] <= left + x * width < box[2]
                and box[1] <= low + y * height < box[3]
            }
            assert with_pins <= nx.node_connected_component(graph, min(with_pins))
    again = Solution.read(file, problem)
    assert evaluate(problem, again).joined >= evaluate(problem, solution).joined
    assert again == again.pruned()


# --- reports --------------------------------------------------------------------------------------


@given(solution=solved_problems())
def test_the_figures_of_a_report(solution: Solution) -> None:
    problem = solution.problem
    found = report(solution)
    judged = evaluate(problem, solution)
    assert [found[key] for key in ("overflow", "max_overflow", "wirelength", "vias")] == [
        judged.overflow,
        judged.max_overflow,
        judged.wirelength,
        judged.vias,
    ]
    assert found["open_nets"] == list(judged.disconnected)
    assert found["wires"] + found["vias"] == found["wirelength"]
    layers = found["layers"]
    assert [row["layer"] for row in layers] == [f"Metal{z + 1}" for z in range(problem.grid[2])]
    assert sum(row["overflow"] for row in layers) == judged.overflow
    assert sum(row["vias_up"] for row in layers) == judged.vias
    demand, over = {}, 0
    for number, edges in enumerate(solution.edges):
        for edge in edges.tolist():
            x, y, z = gcell_of(problem, edge // 3)
            if edge % 3 < 2:
                names = demand.setdefault((x, y, z, edge % 3), [])
                names.append((problem.nets[number].name, int(problem.net_demand[number, z])))
    for z, row in enumerate(layers):
        own = {key: names for key, names in demand.items() if key[2] == z}
        assert row["wires"] == sum(map(len, own.values()))
        assert row["demand"] == sum(d for names in own.values() for _, d in names)
        edges = problem.topology.exists.reshape(*problem.grid, 3)[:, :, z, :2]
        capacity = problem.capacity.reshape(*problem.grid, 3)[:, :, z, :2]
        assert row["capacity"] == int(capacity[edges].astype(np.int64).sum())
    spots = {}
    for (x, y, z, axis), names in demand.items():
        used = sum(d for _, d in names)
        capacity = int(problem.capacity[3 * problem.topology.number(x, y, z) + axis])
        over += used > capacity
        key = (f"Metal{z + 1}", (x, y), (x + (axis == 0), y + (axis == 1)))
        spots[key] = (used, capacity, [name for name, _ in names])
    assert found["overflowed_edges"] == over
    assert len(found["hot_spots"]) == min(10, len(spots))
    for spot in found["hot_spots"]:
        key = (spot["layer"], tuple(spot["from"]), tuple(spot["to"]))
        used, capacity, names = spots.pop(key)
        assert (spot["demand"], spot["capacity"], spot["names"]) == (used, capacity, names)
        assert spot["overflow"] == max(0, used - capacity)
    if spots:  # none that is left out is worse
        least = min(spot["overflow"] for spot in found["hot_spots"])
        assert max(used - capacity for used, capacity, _ in spots.values()) <= max(least, 0)
    json.dumps(found)


@given(problem=problems())
def test_bounds_of_wires(problem: Problem) -> None:
    """Of nets of up to three pins it is half the perimeter; never more than a spanning tree."""
    for number, (bound, exact) in enumerate(zip(*steiner_bounds(problem), strict=True)):
        pins = list({(x, y, 0) for x, y, _ in pin_gcells(problem, number)})
        half = sum(max(p[i] for p in pins) - min(p[i] for p in pins) for i in (0, 1))
        graph = nx.Graph()
        graph.add_nodes_from(pins)
        graph.add_weighted_edges_from(
            (a, b, distance(a, b)) for a, b in itertools.combinations(pins, 2)
        )
        spanning = nx.minimum_spanning_tree(graph).size("weight")
        assert half <= bound <= spanning
        assert 3 * bound >= 2 * spanning
        assert exact  # of five pins at most
        if len(pins) <= 3:
            assert bound == half


def test_a_bound_for_many_pins() -> None:
    """Of a full grid of pins two thirds of the spanning tree, which has 24 edges here."""
    pins = tuple(Pin(x, y, 1) for x in range(5) for y in range(5))
    ones = (1, 1)
    problem = Problem((5, 5, 2), ones, ones, (Net("n", 0, pins),), ones, ones, ones)
    assert [column.tolist() for column in steiner_bounds(problem)] == [[16], [False]]


@pytest.fixture
def crowded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Solution:
    """Two nets over one track, one net with wire to spare, one open; also as files."""
    nets = (
        Net("a", 0, (Pin(0, 0, 1), Pin(2, 0, 1))),
        Net("b", 1, (Pin(0, 0, 1), Pin(1, 0, 1))),
        Net("c", 2, (Pin(0, 1, 1), Pin(1, 1, 1))),
        Net("d", 3, (Pin(0, 1, 1), Pin(2, 1, 1))),
    )
    two = (2, 2)
    reduced = (Adjustment(0, 0, 1, 1, 0, 1, 1),)
    problem = Problem((3, 2, 2), two, two, nets, (1, 1), (0, 0), (0, 0), adjustments=reduced)
    n = problem.topology.number
    row = [3 * n(0, 0, 0), 3 * n(1, 0, 0)]
    around = [3 * n(0, 0, 0) + 1, 3 * n(0, 1, 0), 3 * n(1, 0, 0) + 1]
    solution = Solution(problem, [np.array(e, np.int64) for e in (row, [row[0]], around, [])])
    problem.write(tmp_path / "p.gr")
    solution.write(tmp_path / "p.solution")
    monkeypatch.chdir(tmp_path)
    return solution


def test_a_report_by_hand(crowded: Solution) -> None:
    found = report(crowded)
    assert (found["overflow"], found["overflowed_edges"], found["wires"]) == (1, 1, 6)
    assert found["open_nets"] == ["d"]
    assert found["detours"] == {
        "wires": 6,
        "bound": 4,
        "nets_with": 1,
        "worst": [{"net": "c", "wires": 3, "bound": 1, "detour": 2, "exact": True}],
    }
    assert found["hot_spots"][0] == {
        "layer": "Metal1",
        "from": [0, 0],
        "to": [1, 0],
        "at": [1, 0],
        "demand": 2,
        "capacity": 1,
        "overflow": 1,
        "nets": 2,
        "names": ["a", "b"],
    }
    assert found["histogram"][-1] == {"from": 100, "to": None, "horizontal": 1, "vertical": 0}
    assert sum(row["horizontal"] + row["vertical"] for row in found["histogram"]) == 2 * 7


@pytest.mark.filterwarnings("error")
def test_a_net_without_width_on_an_edge_without_capacity() -> None:
    net = Net("n", 0, (Pin(0, 0, 1), Pin(1, 0, 1)), 0)
    problem = Problem((2, 1, 1), (0,), (0,), (net,), (0,), (0,), (0,))
    assert report(sequential_astar(problem))["overflow"] == 0


def test_the_command(crowded: Solution, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["evaluate", "p.gr", "p.solution", "--report", "--json", "--map", "map.png"]) == 0
    assert json.loads(capsys.readouterr().out) == report(crowded)
    assert Path("map.png").read_bytes().startswith(b"\x89PNG")
    assert status(["evaluate", "p.gr", "p.solution", "--report"]) == 0
    text = capsys.readouterr().out
    for line in ("overflow 1 on 1 edges, at most 1", "open nets: 1", "  d", "Fullest edges"):
        assert line in text
    assert status(["evaluate", "p.gr", "p.solution", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["open_nets"] == ["d"]
    assert status(["convert", "p.gr", "g", "--solution", "p.solution", "--format", "guide"]) == 0
    said = capsys.readouterr()
    assert "4 nets in g" in said.out
    assert "1 open nets, whose routes are not connected" in said.err
    assert Path("g").read_text().startswith("a\n(\n0 0 3 1 Metal1\n")
    assert status(["convert", "p.gr", "g.guide", "--solution", "p.solution"]) == 0
    assert status(["evaluate", "p.gr", "g.guide", "--json"]) == 0
    checked = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert status(["evaluate", "p.gr", "g.guide", "--report", "--json"]) == 0
    of_guide = {name: value for name, value in checked.items() if name.startswith("guide_")}
    assert of_guide["guide_split_nets"] == 1
    assert of_guide.items() <= json.loads(capsys.readouterr().out).items()
    assert status(["evaluate", "p.gr", "g.guide", "--report"]) == 0
    assert "guide_split_nets 1\n" in capsys.readouterr().out
    assert status(["evaluate", "p.gr", "p.solution", "--map", "map.xyz"]) == 2
    assert "expected a picture's suffix" in capsys.readouterr().err


def test_a_map_has_a_panel_for_every_layer_with_routes() -> None:
    (problem,) = generate(1, grid=(6, 5, 3), nets=8)
    nothing = [np.empty(0, np.int64)] * 8
    for routes, layers in (
        (sequential_astar(problem), ["Metal1", "Metal2"]),
        (Solution(problem, nothing), []),
    ):
        figure = congestion_map(problem, routes, "x_$1")
        titles = [axes.get_title() for axes in figure.axes]
        assert [title for title in titles if title] == ["all layers", *layers]
        missing = [name for name in ("Metal1", "Metal2", "Metal3") if name not in layers]
        assert f"no routes in {', '.join(missing)}" in figure.get_suptitle()
