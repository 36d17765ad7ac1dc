"""OpenROAD's route segments and the files of the ISPD 2025 contest, whose output they are.

The small files follow what OpenROAD's ``GlobalRouter::writeSegments`` and the contest's fork of
OpenROAD, which made its ``.net`` files, write.
"""

import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_bad_files import GR

from marouting import InputError, Net, Pin, Problem, Solution, evaluate
from marouting.problem.contest import contest_cost
from marouting.problem.segments import longest_runs
from policies.cli.main import status

CAP = """\
3 4 3
0.5 2 1 3 10
4200 4200 4200
4200 4200
metal1 0 0
9 9 9 9
9 9 9 9
9 9 9 9
metal2 1 0
1 1.5 2 0
1 1 1 1
9 9 9 9
metal3 0 0
0.5 1 1 7
2 2 2 7
1 1 1 7
"""
NET = """\
a
(\x20
u1/Z, -0.485, [(0, 0, 0)]
u2/A1, 1e+30, [(0, 3, 0)]
)\x20
data_i[3]
(\x20
mem\\[7\\]/D, inf, [(2, 1, 1)]
data_i[3], 0, [(0, 1, 2)]
)\x20
"""
SEGMENTS = """\
a
(
2100 2100 metal1 2100 2100 metal2
2100 2100 metal2 2100 2100 metal3
2100 2100 metal3 14700 2100 metal3
14700 2100 metal3 14700 2100 metal2
14700 2100 metal2 14700 2100 metal1
)
data_i[3]
(
6300 6300 metal3 6300 6300 metal2
6300 6300 metal2 6300 10500 metal2
6300 10500 metal1 6300 10500 metal2
)
"""
FILES = (CAP.replace("3 10\n", "3 10 -10 -100 300 3e-7\n"), NET, SEGMENTS)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """The ``.cap`` file, with its ``.net`` file and routes beside it."""
    (tmp_path / "x.cap").write_text(CAP)
    (tmp_path / "x.net").write_text(NET)
    (tmp_path / "x.route").write_text(SEGMENTS)
    return tmp_path / "x.cap"


def test_a_problem_of_ispd_2025(files: Path) -> None:
    problem = Problem.read(files)
    assert [net.name for net in problem.nets] == ["a", "data_i[3]"]
    pins = [[tuple(pin) for pin in net.pins] for net in problem.nets]
    assert pins == [[(0, 0, 1), (3, 0, 1)], [(1, 1, 3), (1, 2, 1)]]
    # Without names and slacks it is a file of ISPD 2024, and the same problem.
    (files.parent / "y.net").write_text(re.sub(r"(?m)^.*, (?=\[\()", "", NET))
    assert "/" not in (files.parent / "y.net").read_text()
    assert Problem.read(files, net=files.parent / "y.net") == problem


def test_its_routes_and_their_cost(files: Path) -> None:
    problem = Problem.read(files)
    routes = Solution.read(files.with_suffix(".route"), problem)
    judged = evaluate(problem, routes)
    assert judged.connected
    assert (judged.wirelength, judged.vias) == (3 + 4 + 1 + 2, 6)
    cost = contest_cost(routes)
    assert cost.wirelength == 0.5 * 4 * 4200
    assert cost.vias == 2 * 6
    # In columns and rows they are the output of ISPD 2024.
    routes.write(files.parent / "x.PR_output")
    assert Solution.read(files.parent / "x.PR_output", problem) == routes


@pytest.mark.parametrize(
    "line",
    [
        "0.5 2 1 3 10 -10 -100 300 3e-7",
        "-0.2 -2 100 0.0000004 0.5 2 1 3 10",
        "-10 -100 300 3e-7\n0.5 2 1 3 10",
    ],
)
def test_weights_of_timing_and_power(files: Path, line: str) -> None:
    own = files.parent / "w.cap"
    own.write_text(CAP.replace("0.5 2 1 3 10", line))
    plain, weighted = (Problem.read(file, net=files.with_suffix(".net")) for file in (files, own))
    assert weighted == plain
    costs = [
        contest_cost(Solution.read(files.with_suffix(".route"), problem))
        for problem in (plain, weighted)
    ]
    assert costs[0] == costs[1]


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("0.5 2 1 3 10", "-0.5 2 1 3 10", 2, "costs from 0, or with them the four weights"),
        ("0.5 2 1 3 10", "0.5 2 1 3 10 300 3 -1 -2", 2, "the four weights of ISPD 2025"),
        ("0.5 2 1 3 10", "0.5 2 1 3 10 -1 -2 3", 2, "the four weights of ISPD 2025"),
        ("0.5 2 1 3 10", "0.5 2 1 3 10 -1 -x 3 4", 2, "weights: numbers"),
    ],
)
def test_spoiled_weights(files: Path, old: str, new: str, line: int, what: str) -> None:
    files.write_text(CAP.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Problem.read(files)
    assert str(caught.value).startswith(f"{files}:{line}: ")
    assert what in str(caught.value)


@pytest.mark.parametrize(
    "pin",
    [
        "u1/Z, [(0, 0, 0)]",
        "u1/Z, slack, [(0, 0, 0)]",
        "u1/Z, -0.485 [(0, 0, 0)]",
        ", -0.485, [(0, 0, 0)]",
        "u1/Z, -0.485, [(0, 0)]",
        "u1/Z, -0.485, (0, 0, 0)",
        "u1/Z, -0.485, [(0, 0, 0)] more",
    ],
)
def test_spoiled_pins(files: Path, pin: str) -> None:
    net = files.with_suffix(".net")
    net.write_text(NET.replace("u1/Z, -0.485, [(0, 0, 0)]", pin))
    with pytest.raises(InputError) as caught:
        Problem.read(files)
    assert str(caught.value).startswith(f"{net}:3: expected a pin")
    assert "'name, slack, [(layer, x, y), …]' of net a" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("14700 2100 metal3\n", "14700 2100 metal4\n", 5, "layer metal4: did you mean metal"),
        ("14700 2100 metal3\n", "14700 6300 metal3\n", 5, "a segment along one axis"),
        ("14700 2100 metal3\n", "16800 2100 metal3\n", 5, "from (0, 0) to (16800, 12600), found"),
        ("14700 2100 metal3\n", "-1 2100 metal3\n", 5, "from (0, 0) to (16800, 12600), found"),
        ("14700 2100 metal3\n", "14700 2100\n", 5, "with names of layers or ')'"),
        ("14700 2100 metal3\n", "14700 2100.5 metal3\n", 5, "with names of layers or ')'"),
        ("2100 2100 metal1 ", "2100 metal1 2100 ", 3, "a segment 'x y layer x y layer' with names"),
        ("data_i[3]", "data_i[4]", 9, "a net of the problem"),
    ],
)
def test_spoiled_segments(files: Path, old: str, new: str, line: int, what: str) -> None:
    routes = files.with_suffix(".route")
    assert old in SEGMENTS
    routes.write_text(SEGMENTS.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Solution.read(routes, Problem.read(files))
    assert str(caught.value).startswith(f"{routes}:{line}: ")
    assert what in str(caught.value)


def test_coordinates_need_gcells_of_one_size(files: Path) -> None:
    files.write_text(CAP.replace("4200 4200\n", "4200 4300\n"))
    routes = files.with_suffix(".route")
    with pytest.raises(InputError) as caught:
        Solution.read(routes, Problem.read(files))
    assert str(caught.value).startswith(f"{routes}: expected segments in columns and rows")


def test_layers_called_by_numbers_stay_those_of_ispd_2024(files: Path) -> None:
    """A line of six numbers is in columns and rows, as it was before."""
    files.write_text(re.sub("metal", "", CAP))
    (files.parent / "n.PR_output").write_text("a\n(\n0 0 2 3 0 2\n)\n")
    routes = Solution.read(files.parent / "n.PR_output", Problem.read(files))
    assert evaluate(routes.problem, routes).wirelength == 3


def test_problems_in_ispd_text_have_layers_by_number(tmp_path: Path) -> None:
    (tmp_path / "p.gr").write_text(GR)
    problem = Problem.read(tmp_path / "p.gr")
    (tmp_path / "r").write_text("A\n(\n5 5 Metal1 29 9 Metal1\n25 5 Metal2 25 5 Metal1\n)\n")
    (tmp_path / "s").write_text("A 1 2\n(5,5,1)-(25,5,1)\n(25,5,1)-(25,5,2)\n!\n")
    routes = Solution.read(tmp_path / "r", problem)
    assert routes == Solution.read(tmp_path / "s", problem)


def test_routes_of_a_design(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("klayout.db")
    from test_lefdef import design

    monkeypatch.chdir(tmp_path)
    design(tmp_path)
    # Gcells are 400 wide and high, the last ones 200. Net n1 is from (900, 50) to (250, 150).
    Path("n1.segs").write_text(
        "n1\n(\n200 200 M1 200 200 M2\n200 200 M1 990 390 M1\n900 200 M2 900 200 M1\n)\n"
    )
    Path("n1.solution").write_text(
        "n1 0 3\n(200,200,1)-(200,200,2)\n(200,200,1)-(900,200,1)\n(900,200,1)-(900,200,2)\n!\n"
    )
    problem = Problem.read("chip.def")
    routes = Solution.read("n1.segs", problem)
    assert routes == Solution.read("n1.solution", problem)
    assert evaluate(problem, routes).wirelength == 2 + 1 + 1

    def judged(*arguments: str) -> dict[str, object]:
        assert status([*arguments, "--json"]) == 0, capsys.readouterr().err
        found: dict[str, object] = json.loads(capsys.readouterr().out)
        return {key: value for key, value in found.items() if key != "seconds"}

    own, same = (["chip.def", f"n1.{suffix}"] for suffix in ("segs", "solution"))
    assert judged("evaluate", *own) == judged("evaluate", *same)
    judged("evaluate", *own, "--report")
    judged("view", *own, "--out", "v.html")
    judged("convert", own[0], "own.guide", "--solution", own[1])
    judged("convert", same[0], "same.guide", "--solution", same[1])
    assert Path("own.guide").read_text() == Path("same.guide").read_text()
    judged("convert", "chip.def", "own.solution", "--solution", "n1.segs")
    assert Solution.read("own.solution", problem) == routes


def as_segments(solution: Solution, shift: int) -> str:
    """A solution as OpenROAD writes one: points in Gcells, ends in any order, nets with routes."""
    problem = solution.problem
    net, ends = longest_runs(problem, *solution.uses)
    text = ""
    for index, own in enumerate(problem.nets):
        rows = np.stack(np.unravel_index(ends[net == index], problem.grid), axis=-1)
        lines = []
        for number, row in enumerate(rows.tolist()):
            words = []
            for *place, layer in row:
                for axis in (0, 1):
                    size = problem.tile[axis]
                    words.append(str(problem.origin[axis] + place[axis] * size + shift % size))
                words.append(f"Metal{layer + 1}")
            lines.append(" ".join(words if number % 2 else words[3:] + words[:3]))
        if lines:
            text += "\n".join((own.name, "(", *lines, ")")) + "\n"
    return text


@given(data=st.data())
def test_round_trips(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    numbers = st.integers(1, 4)
    grid = (data.draw(numbers), data.draw(numbers), data.draw(numbers))
    size = (data.draw(st.integers(1, 9)), data.draw(st.integers(1, 9)))
    origin = (data.draw(st.integers(-20, 20)), data.draw(st.integers(-20, 20)))
    layers = (1,) * grid[2]
    nets = [Net(f"n{i}", i, (Pin(*origin, 1),)) for i in range(2)]
    problem = Problem(
        grid, layers, layers, tuple(nets), layers, layers, layers, origin=origin, tile=size
    )
    existing = np.flatnonzero(problem.topology.exists)
    uses = [data.draw(st.sets(st.sampled_from([-1, *existing.tolist()]))) - {-1} for _ in nets]
    solution = Solution(problem, [np.array(sorted(own), np.int64) for own in uses])
    file = tmp_path_factory.mktemp("segments") / "r.segs"
    file.write_text(as_segments(solution, data.draw(st.integers(0, 8))))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Solution.read(file, problem) == solution
