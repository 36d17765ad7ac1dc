"""Problems of the ISPD 2024 contest: what their files say, and the contest's cost of routes.

The oracle is the contest's evaluator once more, from its text: plain loops over Gcells.
"""

import json
import math
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from marouting import (
    Area,
    Controls,
    InputError,
    Net,
    Pin,
    Problem,
    Solution,
    adjusted,
    evaluate,
    sequential_astar,
)
from marouting.problem.chip import Chip
from marouting.problem.contest import contest_cost, with_pins_covered
from marouting.problem.grid import AXES, VIA_AXIS
from policies.cli.main import status
from policies.routers.optimal import OptimalRouter
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "ispd24"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="needs the toy cases in ../shared/data")

CAP = """\
3 4 3
0.5 2 1 3 10
100 200 300
50 60
m1 0 1
9 9 9 9
9 9 9 9
9 9 9 9
m2 1 1
1 1.5 2 0
1 1 1 1
9 9 9 9
m3 0 1
0.5 1 1 7
2 2 2 7
1 1 1 7
"""
NET = """\
a
(
[(0, 0, 0)]
[(0, 3, 0), (0, 3, 1)]
)
b
(
[(2, 1, 1)]
[(0, 1, 2)]
)
c
(
[(0, 2, 2)]
[(0, 2, 2)]
)
"""
ROUTES = """\
a
(
0 0 0 0 0 2
0 0 2 3 0 2
3 0 0 3 0 2
)
b
(
1 1 1 1 1 2
1 1 1 1 2 1
1 2 0 1 2 1
)
"""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """The ``.cap`` file, with the other two beside it."""
    (tmp_path / "p.cap").write_text(CAP)
    (tmp_path / "p.net").write_text(NET)
    (tmp_path / "p.PR_output").write_text(ROUTES)
    return tmp_path / "p.cap"


def test_what_a_problem_says(files: Path) -> None:
    problem = Problem.read(files)
    assert problem.grid == (4, 3, 3)
    # Capacities are cut to whole tracks; the lowest layer has no wires.
    capacity = problem.capacity.reshape(*problem.grid, 3)
    assert capacity[:3, :, 0, 0].max() == 0
    assert capacity[:, :2, 1, 1].T.tolist() == [[1, 1, 2, 0], [1, 1, 1, 1]]
    assert capacity[:3, :, 2, 0].T.tolist() == [[0, 1, 1], [2, 2, 2], [1, 1, 1]]
    assert capacity[..., 1, 0].max() == capacity[..., 2, 1].max() == 0
    assert [net.name for net in problem.nets] == ["a", "b", "c"]
    # Places of net a: columns 0 3 3, rows 0 0 1; (3, 0) is the median.
    assert [(pin.x, pin.y, pin.layer) for pin in problem.nets[0].pins] == [(0, 0, 1), (3, 0, 1)]
    assert problem.chip is not None
    assert problem.chip.layers == ("m1", "m2", "m3")
    assert Problem.read(files, net=files.with_suffix(".net")) == problem


@given(st.integers(0, 2**32 - 1))
def test_routers_lay_wires_only_along_their_layers(seed: int) -> None:
    """For a single net the optimum has the length of networkx's shortest path along such wires."""
    rng = np.random.default_rng(seed)
    wires = rng.permutation([[True, False], [False, True], [False, False], [True, False]])
    nets = [
        Net(
            f"n{i}",
            i,
            tuple(Pin(*map(int, pin)) for pin in rng.integers((0, 0, 1), (4, 4, 5), (2, 3))),
        )
        for i in range(rng.integers(1, 6))
    ]
    sides, one = np.arange(5) * 10, (1,) * 4
    vertical, horizontal = (tuple(map(int, wires[:, axis] * 1)) for axis in (1, 0))
    problem = Problem(
        (4, 4, 4), vertical, horizontal, tuple(nets), one, (0,) * 4, (0,) * 4,
        chip=Chip(("a", "b", "c", "d"), sides, sides, wires),
    )  # fmt: skip
    closed = problem.closed.reshape(-1, 4, AXES)
    assert (closed[:, :, :VIA_AXIS] == ~wires).all()
    assert not closed[:, :, VIA_AXIS].any()
    found = {
        "astar": sequential_astar(problem),
        "tree": sequential_astar(problem, target="tree"),
        "pathfinder": PathfinderRouter(PathfinderOptions(passes=20)).solve(problem).solution,
        "optimal": OptimalRouter().solve(problem).solution,
    }
    for name, solution in found.items():
        assert evaluate(problem, solution).connected, name
        assert not any(problem.closed[edges].any() for edges in solution.edges), name
    figures = {
        name: (evaluate(problem, solution).overflow, evaluate(problem, solution).wirelength)
        for name, solution in found.items()
    }
    assert figures["optimal"] == min(figures.values())
    # A start that has such wires does not stay.
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder, "start.solution"))
        sequential_astar(replace(problem, chip=None)).write(file)
        options = PathfinderOptions(passes=2, start=file)
        begun = PathfinderRouter(options).solve(problem).solution
    assert evaluate(problem, begun).connected
    assert not any(problem.closed[edges].any() for edges in begun.edges)
    if len(nets) == 1:
        grid, graph = problem.topology, networkx.Graph()
        edges = np.flatnonzero(grid.exists & ~problem.closed)
        graph.add_edges_from(zip(*(end.tolist() for end in grid.ends(edges)), strict=True))
        ends = problem.pin_gcells[0].tolist()
        length = networkx.shortest_path_length(graph, ends[0], ends[-1])
        assert figures["optimal"] == (0, length)


def test_wires_of_a_chip_are_booleans() -> None:
    sides = np.arange(3)
    chip = Chip(("a", "b"), sides, sides, np.array([[1, 0], [0, 1]]))
    assert chip.wires.dtype == bool
    for wrong in ([[1, 0]], [[2, 0], [0, 1]], [True, False]):
        with pytest.raises(InputError, match="wires: expected two booleans for each of 2 layers"):
            Chip(("a", "b"), sides, sides, np.array(wrong))


def test_the_cost_by_hand(files: Path) -> None:
    solution = Solution.read(files.with_suffix(".PR_output"), Problem.read(files))
    cost = contest_cost(solution)
    # Wires: net a 100 + 200 + 300 in m3; net b the second distance between rows in m2.
    assert cost.wirelength == 0.5 * (600 + 60)
    assert cost.vias == 2 * (2 + 2 + 1 + 1)
    # Net a's stacks pass m2 in column 0 and 3, row 0, at the border: a whole track each. Net b's
    # via starts at a wire of its own.
    m2 = [[1, 1.5, 2, 0], [1, 1, 1, 1], [9] * 4]
    over_m2 = {(x, y): -m2[y][x] for x in range(4) for y in range(3)}
    over_m2[0, 0] += 1
    over_m2[3, 0] = 1.5 * 2  # no capacity: 1.5 tracks for each half
    over_m2[1, 1] += 1
    m3 = [[0.5, 1, 1, 7], [2, 2, 2, 7], [1, 1, 1, 7]]
    over_m3 = {(x, y): -m3[y][x] for x in range(4) for y in range(3)}
    for x in range(3):
        over_m3[x, 0] += 1
    expected = 3 * sum(math.exp(0.5 * o) for o in over_m2.values())
    expected += 10 * sum(math.exp(0.5 * o) for o in over_m3.values())
    assert cost.overflow == pytest.approx(expected, rel=1e-12)
    assert cost.total == pytest.approx(cost.wirelength + cost.vias + expected, rel=1e-12)
    assert cost.open == ("c",)  # nothing of it reaches its pins


def test_nets_inside_one_gcell_get_a_via(files: Path) -> None:
    solution = Solution.read(files.with_suffix(".PR_output"), Problem.read(files))
    covered = with_pins_covered(solution)
    assert contest_cost(covered).open == ()
    assert contest_cost(covered).vias == contest_cost(solution).vias + 2
    assert with_pins_covered(covered) == covered


def test_routes_are_read_back_equal(files: Path, tmp_path: Path) -> None:
    problem = Problem.read(files)
    solution = Solution.read(files.with_suffix(".PR_output"), problem)
    for name in ("again.PR_output", "text.solution"):
        solution.write(tmp_path / name)
        assert Solution.read(tmp_path / name, problem) == solution
    assert (tmp_path / "again.PR_output").read_text() == (
        "a\n(\n0 0 0 0 0 2\n0 0 2 3 0 2\n3 0 0 3 0 2\n)\n"
        "b\n(\n1 1 1 1 2 1\n1 1 1 1 1 2\n1 2 0 1 2 1\n)\nc\n(\n)\n"
    )


def test_a_report_has_the_contests_cost(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["evaluate", str(files), str(files.with_suffix(".PR_output")), "--json"]
    assert status(command) == status([*command, "--report"]) == 0
    figures, report = map(json.loads, capsys.readouterr().out.splitlines())
    costs = {name: value for name, value in figures.items() if name.startswith("ispd2024_")}
    assert costs
    assert costs.items() <= report.items()


def test_the_contests_first_form_of_routes(files: Path, tmp_path: Path) -> None:
    """Boxes of Gcells with the names of layers, as in the toy case Chess."""
    boxes = "a\n(\n0 0 4 1 m3\n0 0 1 1 m1\n0 0 1 1 m2\n3 0 4 1 m1\n3 0 4 1 m2\n)\n"
    (tmp_path / "first.PR_output").write_text(boxes)
    problem = Problem.read(files)
    found = Solution.read(tmp_path / "first.PR_output", problem)
    same = Solution.read(files.with_suffix(".PR_output"), problem)
    assert found.edges[0].tolist() == same.edges[0].tolist()


@pytest.mark.parametrize(
    ("old", "new", "line", "count"),
    [
        ("0 0 2 3 0 2", "3 0 2 0 0 2", 4, 1),  # a wire the other way
        ("3 0 0 3 0 2", "3 0 2 3 0 0", 5, 1),  # a via
        ("1 1 1 1 2 1", "1 2 1 1 1 1\n1 1 1 1 1 1", 10, 2),  # a point as well
    ],
)
def test_segments_whose_ends_are_turned_warn(
    files: Path, tmp_path: Path, old: str, new: str, line: int, count: int
) -> None:
    """The contest's evaluator does not take them."""
    problem = Problem.read(files)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same = Solution.read(files.with_suffix(".PR_output"), problem)
    assert old in ROUTES
    (tmp_path / "turned.PR_output").write_text(ROUTES.replace(old, new))
    with pytest.warns(UserWarning, match="expected a segment from its lower to its") as record:
        assert Solution.read(tmp_path / "turned.PR_output", problem) == same
    assert len(record) == 1
    message = str(record[0].message)
    assert f"turned.PR_output:{line}: net {'a' if line < 8 else 'b'}: " in message
    assert f"such segments, {count} in this file" in message


def test_wires_that_a_layer_cannot_have(files: Path, tmp_path: Path) -> None:
    problem = Problem.read(files)
    for line, way in (("0 0 0 1 0 0", "horizontal wires in layer m1"), ("0 0 2 0 1 2", "vertical")):
        (tmp_path / "wrong.PR_output").write_text(f"a\n(\n{line}\n)\n")
        wrong = Solution.read(tmp_path / "wrong.PR_output", problem)
        assert "a" in contest_cost(wrong).open
        assert contest_cost(wrong).wirelength == 0
        with pytest.raises(InputError, match=way):
            wrong.write(tmp_path / "again.PR_output")
        wrong.write(tmp_path / "again.solution")  # which can hold them


# --- the contest's evaluator once more ------------------------------------------------------------


def plain_cost(cap: str, net: str, routes: str) -> tuple[float, float, float, set[str]]:
    """Costs of wirelength, vias and overflow, and open nets, by the evaluator's own steps."""
    stream = cap.split("\n")
    layers, columns, rows = map(int, stream[0].split())
    tokens = " ".join(stream[1:]).split()
    wire_cost, via_cost, *over_cost = map(float, tokens[: 2 + layers])
    lengths = [float(t) for t in tokens[2 + layers : 2 + layers + columns + rows - 2]]
    dx, dy = lengths[: columns - 1], lengths[columns - 1 :]
    lines = [line.split() for line in stream]
    at = next(i for i, words in enumerate(lines) if words and words[0][0].isalpha())
    direction, capacity = [], []
    for z in range(layers):
        head, *table = lines[at + z * (rows + 1) : at + (z + 1) * (rows + 1)]
        direction.append(int(head[1]))
        capacity.append([[float(table[y][x]) for y in range(rows)] for x in range(columns)])
    pins: dict[str, list[list[tuple[int, ...]]]] = {}
    name = ""
    for line in net.split("\n"):
        if "(" not in line and ")" not in line and line.strip():
            name = line.strip()
            pins[name] = []
        elif "[" in line:
            numbers = [int(n) for n in "".join(c if c.isdigit() else " " for c in line).split()]
            pins[name].append([tuple(numbers[i : i + 3]) for i in range(0, len(numbers), 3)])
    half = {}  # half tracks
    wire, vias, length = {}, 0, 0.0
    opened = set()
    for text in routes.split("\n)")[:-1]:
        name, block = text.strip().split("\n(", 1)
        flags, vias_at = set(), []
        for line in block.strip().split("\n"):
            if not line.strip():
                continue
            xl, yl, zl, xh, yh, zh = map(int, line.split())
            if zl != zh:
                vias += zh - zl
                vias_at += [(z, xl, yl) for z in range(zl, zh)]
                continue
            cells = [(zl, x, y) for x in range(xl, xh + 1) for y in range(yl, yh + 1)]
            flags |= set(cells)
            for cell in cells[:-1]:
                wire[cell] = wire.get(cell, 0) + 1
                length += dx[cell[1]] if direction[zl] == 0 else dy[cell[2]]
        for z, x, y in vias_at:
            if (z, x, y) in flags:
                continue
            flags.add((z, x, y))
            place, size = (x, columns) if direction[z] == 0 else (y, rows)
            for step in (-1, 0):
                if 0 <= place + step < size - 1:
                    key = (z, x + step, y) if direction[z] == 0 else (z, x, y + step)
                    amount = 1 if 0 < place < size - 1 else 2
                    half[key] = half.get(key, 0) + amount
        flags |= set(vias_at) | {(z + 1, x, y) for z, x, y in vias_at}
        seen = [place for place in pins[name][0] if place in flags]
        done = set(seen)
        while seen:
            z, x, y = seen.pop()
            around = [(z + 1, x, y), (z - 1, x, y)]
            if z > 0:
                h = direction[z] == 0
                around += [(z, x + s * h, y + s * (not h)) for s in (1, -1)]
            for other in around:
                if other in flags and other not in done:
                    done.add(other)
                    seen.append(other)
        if any(not done & set(places) for places in pins[name][1:]):
            opened.add(name)
    overflow = 0.0
    for z in range(1, layers):
        for x in range(columns):
            for y in range(rows):
                demand = 2 * wire.get((z, x, y), 0) + half.get((z, x, y), 0)
                own = capacity[z][x][y]
                if own > 0.001:
                    overflow += over_cost[z] * math.exp((demand - 2 * own) / 2 * 0.5)
                elif demand > 0:
                    overflow += over_cost[z] * math.exp(1.5 * demand * 0.5)
    return length * wire_cost, vias * via_cost, overflow, opened


@needs_data
def test_the_toy_case_of_the_contest() -> None:
    problem = Problem.read(DATA / "tst_5.cap")
    solution = Solution.read(DATA / "tst_5.PR_output", problem)
    texts = [(DATA / f"tst_5.{s}").read_text() for s in ("cap", "net", "PR_output")]
    wirelength, vias, overflow, opened = plain_cost(*texts)
    cost = contest_cost(solution)
    assert (cost.wirelength, cost.vias) == pytest.approx((wirelength, vias), rel=1e-12)
    assert cost.overflow == pytest.approx(overflow, rel=1e-12)
    assert set(cost.open) == opened == set()
    # As the contest's own evaluator prints it, compiled from its source. It prints two open nets as
    # well: it takes "(1,3,4)" for the number 134, and has none once blanks follow the commas.
    assert f"{cost.total:.4f}" == "706.6630"
    # By hand: five edges from column to column, 3300 each, and six from row to row: five of 3000,
    # and one between the first two rows, which are 3300 apart, since the file gives five distances
    # between columns where the grid has four.
    assert wirelength == pytest.approx(0.014 * (5 * 3300 + 5 * 3000 + 3300))
    judged = solution.at_reached_pins()
    assert evaluate(judged.problem, judged).connected


@needs_data
def test_a_toy_case_with_a_pin_off_the_grid() -> None:
    with pytest.raises(InputError, match=r"Chess.net:14: net Net3: .* 8x8 grid .*\(0, 8, 1\)"):
        Problem.read(DATA / "Chess.cap")


@st.composite
def cases(draw: st.DrawFn) -> tuple[str, str, str]:
    """A problem and routes of it, which may be open: any right segments, each once for a net."""
    layers, columns, rows = draw(st.tuples(*[st.integers(1, 4)] * 3))
    number = st.sampled_from(["0", "0.0005", "1", "2.5", "3"])
    lines = [f"{layers} {columns} {rows}"]
    lines.append(" ".join(draw(number) for _ in range(2 + layers)))
    extra = draw(st.integers(0, int(rows > 2)))  # as in the toy cases
    lines.append(" ".join(str(draw(st.integers(1, 9))) for _ in range(columns - 1 + extra)))
    lines.append(" ".join(str(draw(st.integers(1, 9))) for _ in range(rows - 1 + extra)))
    ways = draw(st.lists(st.integers(0, 1), min_size=layers, max_size=layers))
    for z in range(layers):
        lines.append(f"M{z} {ways[z]} 1")
        lines += [" ".join(draw(number) for _ in range(columns)) for _ in range(rows)]
    cell = st.tuples(
        st.integers(0, layers - 1), st.integers(0, columns - 1), st.integers(0, rows - 1)
    )
    nets, routes = "", ""
    for name in "abc"[: draw(st.integers(1, 3))]:
        pins = draw(st.lists(st.lists(cell, min_size=1, max_size=3), min_size=1, max_size=3))
        nets += f"{name}\n(\n" + "".join(f"{places}\n" for places in pins) + ")\n"
        segments = set()
        for z, x, y in draw(st.lists(cell, max_size=8)):
            if z + 1 < layers and draw(st.booleans()):
                segments.add((x, y, z, x, y, z + 1))
            elif z > 0 and ways[z] == 0 and x + 1 < columns:
                segments.add((x, y, z, x + 1, y, z))
            elif z > 0 and ways[z] == 1 and y + 1 < rows:
                segments.add((x, y, z, x, y + 1, z))
        routes += f"{name}\n(\n" + "".join(f"{' '.join(map(str, s))}\n" for s in segments) + ")\n"
    return "\n".join(lines) + "\n", nets, routes


@given(case=cases())
def test_any_routes_cost_what_the_evaluator_says(
    case: tuple[str, str, str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("case")
    for suffix, text in zip(("cap", "net", "PR_output"), case, strict=True):
        (folder / f"p.{suffix}").write_text(text)
    solution = Solution.read(folder / "p.PR_output", Problem.read(folder / "p.cap"))
    cost = contest_cost(solution)
    wirelength, vias, overflow, opened = plain_cost(*case)
    found = (cost.wirelength, cost.vias, cost.overflow)
    assert found == pytest.approx((wirelength, vias, overflow), rel=1e-9)
    assert set(cost.open) == opened
    # Pins that the contest takes for joined are so in the moved problem, edges permitting.
    moved = solution.at_reached_pins()
    assert np.array_equal(moved.uses[1], solution.uses[1])


@given(case=cases())
def test_negotiated_congestion_keeps_to_the_directions_of_layers(
    case: tuple[str, str, str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Also where there is not enough capacity, so that its routes can be written."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "p.cap").write_text(case[0])
    (folder / "p.net").write_text(case[1])
    problem = Problem.read(folder / "p.cap")
    assert problem.chip is not None
    if not problem.chip.wires.any(axis=0).all():
        return  # its layers do not lead everywhere
    solution = with_pins_covered(PathfinderRouter(PathfinderOptions(passes=5)).route(problem))
    assert evaluate(problem, solution).connected
    assert contest_cost(solution).open == ()
    solution.write(folder / "p.PR_output")
    assert Solution.read(folder / "p.PR_output", problem) == solution


# --- files that cannot be used --------------------------------------------------------------------


# What NumPy takes for numbers.
NO_NUMBERS = ("1_0", "1_0.5", "١", "０.5", "infinity", "Nan", "1e1_0")


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("3 4 3\n", "3 4\n", 1, "numbers of layers, columns and rows, 3 whole numbers"),
        ("3 4 3\n", "99999 99999 99999\n", 1, "at most 16777216 Gcells"),
        ("3 4 3\n", "3 0 3\n", 1, "from 1"),
        ("0.5 2 1 3 10", "0.5 2 1 3 x", 2, "the cost of overflow in each layer: numbers"),
        ("0.5 2 1 3 10", "0.5 2 1 3 -1", 2, "from 0"),
        ("0.5 2 1 3 10", "0.5 2 nan 3 1", 2, "from 0"),
        *(("0.5 2 1", f"{number} 2 1", 2, "the costs of wire and via") for number in NO_NUMBERS),
        *(("1 1.5 2 0", f"1 1.5 {number} 0", 10, "capacities: numbers") for number in NO_NUMBERS),
        ("3 4 3\n", "3 ４ 3\n", 1, "3 whole numbers"),
        ("m2 1 1", "m2 1 1_0", 9, "a minimum length: numbers"),
        ("m2 1 1", "m2 １ 1", 9, "direction 0 or 1"),
        ("m2 1 1", "m2 1\xa01", 9, "direction 0 or 1"),
        ("m2 1 1", "m2 2 1", 9, "layer 2 of 3 (name, direction 0 or 1, minimum length)"),
        ("m2 1 1", "m1 1 1", 9, "layer m1: expected a name no earlier layer has"),
        ("1 1.5 2 0", "1 1.5 2", 10, "row 1 of 3 of layer m2, 4 capacities"),
        ("1 1.5 2 0", "1 1.5 2 inf", 10, "numbers from 0"),
        (CAP, CAP + "x\n", 17, "the end of the file after 3 layers"),
        (CAP, CAP[:-8], 15, "row 3 of 3 of layer m3, 4 capacities, found the end"),
        (CAP, "", 1, "found the end of the file"),
    ],
)
def test_spoiled_resources(files: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in CAP
    files.write_text(CAP.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Problem.read(files)
    assert str(caught.value).startswith(f"{files}:{line}: ")
    assert what in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("[(2, 1, 1)]", "[(2, 4, 1)]", 8, "net b: expected places (layer, x, y) on the 4x3 grid"),
        ("[(2, 1, 1)]", "[(3, 1, 1)]", 8, "found (3, 1, 1)"),
        ("[(2, 1, 1)]", "[(2, 1)]", 8, "(layer, x, y), …]' of net b, or ')'"),
        ("[(2, 1, 1)]", "[(-2, 1, 1)]", 8, "a pin"),
        ("[(2, 1, 1)]\n[(0, 1, 2)]\n", "", 8, "net b: expected at least one pin"),
        ("b\n(", "b c\n(", 6, "a net's name"),
        ("b\n(", "a\n(", 6, "net a: expected a name no earlier net has"),
        ("b\n(", "b\n", 8, "'(' after the name of net b"),
        (NET, NET[:-2], 14, "file ends inside net c, expected ')'"),
        (NET, "", 1, "expected at least one net"),
    ],
)
def test_spoiled_nets(files: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in NET
    nets = files.with_suffix(".net")
    nets.write_text(NET.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Problem.read(files)
    assert str(caught.value).startswith(f"{nets}:{line}: ")
    assert what in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("0 0 2 3 0 2", "0 0 2 4 0 2", 4, "a Gcell of the 4x3x3 grid, counted from 0"),
        ("0 0 2 3 0 2", "0 0 2 3 1 2", 4, "a segment along one axis"),
        ("0 0 2 3 0 2", "0 0 2 3 0", 4, "a segment 'x y layer x y layer' or ')'"),
        ("0 0 2 3 0 2", "0 0 2 3 0 m3", 4, "a segment"),
        ("b\n(", "d\n(", 7, "a net of the problem that is not listed above"),
        ("b\n(", "a\n(", 7, "a net of the problem that is not listed above"),
        ("b\n(", "b\n", 9, "'(' after the name of net b"),
        (ROUTES, ROUTES[:-2], 11, "file ends inside net b, expected ')'"),
        (
            ROUTES,
            "a\n(\n0 0 1 1 m4\n)\n",
            3,
            "layer m4: expected a layer of the problem: m1, m2",
        ),
        (ROUTES, "a\n(\n4 0 5 1 m3\n)\n", 3, "a box on the chip, from (0, 0) to (4, 3)"),
        (ROUTES, "a\n(\n1 0 1 1 m3\n)\n", 3, "a box on the chip"),
        (ROUTES, "a\n(\n1 0 2\n)\n", 3, "a box 'x y x y layer', a segment"),
    ],
)
def test_spoiled_routes(files: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in ROUTES
    routes = files.with_suffix(".PR_output")
    routes.write_text(ROUTES.replace(old, new, 1))
    problem = Problem.read(files)
    with pytest.raises(InputError) as caught:
        Solution.read(routes, problem)
    assert str(caught.value).startswith(f"{routes}:{line}: ")
    assert what in str(caught.value)


def test_the_other_file_is_missing(files: Path) -> None:
    files.with_suffix(".net").unlink()
    with pytest.raises(InputError, match=r"p\.net: cannot be read"):
        Problem.read(files)
    with pytest.raises(InputError, match=r"expected no lef: only \.def files take it"):
        Problem.read(files, lef=["a.lef"])


def parallel(tmp_path: Path, tracks: float) -> Path:
    """Two nets side by side in x, and two layers for each direction above those of the pins."""
    text = "5 7 7\n0.001 0.05 10 10 10 10 10\n" + ("100 " * 6 + "\n") * 2
    for layer, direction in enumerate("10101"):
        row = f"{tracks if layer else 0} " * 7 + "\n"
        text += f"m{layer + 1} {direction} 0\n" + row * 7
    (tmp_path / "p.cap").write_text(text)
    nets = [f"{name}\n(\n[(0, 0, {y})]\n[(0, 6, {y})]\n)\n" for name, y in (("a", 2), ("b", 5))]
    (tmp_path / "p.net").write_text("".join(nets))
    return tmp_path / "p.cap"


@pytest.mark.parametrize("tracks", [0.9, 1.0, 2.5])
def test_controls_count_also_where_there_is_less_than_a_track(
    tmp_path: Path, tracks: float
) -> None:
    """What is closed stays free of wires if the contest's cost is minimised."""
    problem = Problem.read(parallel(tmp_path, tracks))
    router = PathfinderRouter(PathfinderOptions(passes=10, seconds=None, cost="ispd2024"))

    def used(controls: Controls) -> set[tuple[int, int, int]]:
        """Column, row and layer, from 1, of all wires."""
        solution = router.route(adjusted(problem, controls))
        assert contest_cost(solution).open == ()
        edge = solution.uses[1]
        wires = edge[edge % AXES != VIA_AXIS] // AXES
        x, y, z = np.unravel_index(wires, problem.grid)
        return {*zip(x.tolist(), y.tolist(), (z + 1).tolist(), strict=True)}

    assert {z for _, _, z in used(Controls())} == {2}
    assert {z for _, _, z in used(Controls(layers="3..5"))} == {4}
    assert {z for _, _, z in used(Controls(derate={"m2": 0}))} == {4}
    closed = Area(columns=(2, 4), rows=(1, 3), factor=0)
    around = used(Controls(areas=(closed,)))
    assert not {(x, y) for x, y, _ in around} & {(x, y) for x in range(2, 5) for y in range(1, 4)}


def test_reduced_capacities_are_cut_to_whole_tracks_once(tmp_path: Path) -> None:
    problem = Problem.read(parallel(tmp_path, 1.9))
    reduced = adjusted(problem, Controls(derate={"2..": 0.9}))  # 1.71
    assert np.array_equal(reduced.capacity, problem.capacity)
    again = adjusted(reduced, Controls(derate={"2..": 0.5}))  # 0.855
    assert again.layer_capacity[:, :2].max() == 0
