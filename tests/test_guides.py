"""Guides for detailed routers: the contests' rules, and patches."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marouting import (
    Area,
    InputError,
    Net,
    Pin,
    Problem,
    ProblemFile,
    Solution,
    evaluate,
    sequential_astar,
)
from marouting.problem.guides import CROWDED, GuideCheck, check_guide, read_record
from marouting.problem.net import Adjustment
from policies.cli.main import status
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

CHIP = Path(__file__).resolve().parents[1] / "docs" / "examples" / "problems" / "chip.def"
ISPD18 = Path(__file__).resolve().parents[2] / "shared" / "data" / "ispd18"
PROBLEM = ProblemFile(path=str(CHIP)).read()
GOOD = (0, 0, 0)


def found(path: Path) -> tuple[int, int, int]:
    checked = check_guide(read_record(path, PROBLEM), PROBLEM)
    assert checked is not None
    return checked.off_grid, checked.open_pins, checked.split_nets


def covered(path: Path) -> set[tuple[str, int, int, str]]:
    """Net, column, row and layer of all Gcells of a guide, whose boxes are on the grid of 2000."""
    cells, name = set(), ""
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 5:
            x0, y0, x1, y1 = (int(word) // 2000 for word in words[:4])
            cells |= {(name, x, y, words[4]) for x in range(x0, x1) for y in range(y0, y1)}
        elif words[0] not in "()":
            name = words[0]
    return cells


@pytest.fixture(scope="module")
def solution() -> Solution:
    return sequential_astar(PROBLEM)


@pytest.mark.parametrize("format", ["guide", "patched-guide"])
def test_our_guides_meet_the_contests_rules(
    tmp_path: Path, solution: Solution, format: Any
) -> None:
    solution.write(tmp_path / "a.guide", format)
    assert found(tmp_path / "a.guide") == GOOD
    # No wires lie in the layer of pins: its boxes are single Gcells at pins, or patches.
    cells = {cell for cell in covered(tmp_path / "a.guide") if cell[3] == "Metal1"}
    pins = {
        (net.name, pin.x // 2000, pin.y // 2000)
        for net in PROBLEM.nets
        for pin in net.pins
        if pin.layer == 1
    }
    reach = 1 if format == "patched-guide" else 0
    beside = {
        (name, x + dx, y + dy)
        for name, x, y in pins
        for dx in range(-1, 2)
        for dy in range(-1, 2)
        if abs(dx) + abs(dy) <= (2 if reach else 1)  # a pin's shapes may reach into the next one
    }
    assert pins <= {cell[:3] for cell in cells} <= beside
    judged = Solution.read(tmp_path / "a.guide", PROBLEM).at_reached_pins()
    assert evaluate(judged.problem, judged).connected


def test_wires_without_tracks_lie_along_their_layer(tmp_path: Path) -> None:
    """Where routes overflow a closed row, a guide reads back as the same routes."""
    closed = Area(columns=(0, 9), rows=(4, 4), factor=0)
    problem = ProblemFile(path=str(CHIP), areas=(closed,)).read()
    routed = PathfinderRouter(PathfinderOptions(seconds=None, passes=4)).route(problem)
    assert evaluate(problem, routed).overflow > 50
    routed.pruned().write(tmp_path / "a.guide")
    assert evaluate(problem, Solution.read(tmp_path / "a.guide", problem)) == evaluate(
        problem, routed.pruned()
    )


def test_patches_lie_around_pins_and_at_crowded_edges(tmp_path: Path) -> None:
    file = ProblemFile(path=str(CHIP), derate={"Metal3": 0.3})
    problem = file.read()
    solution = sequential_astar(problem)
    solution.write(tmp_path / "plain.guide")
    solution.write(tmp_path / "patched.guide", "patched-guide")
    plain, patched = covered(tmp_path / "plain.guide"), covered(tmp_path / "patched.guide")
    assert plain < patched
    layers, (columns, rows, _) = ("Metal1", "Metal2", "Metal3"), problem.grid
    expected = set()
    for index, net in enumerate(problem.nets):
        if len(problem.pin_gcells[index]) > 1:
            for pin in net.pins:
                x, y = pin.x // 2000, pin.y // 2000
                for i in range(max(0, x - 1), min(columns, x + 2)):
                    for j in range(max(0, y - 1), min(rows, y + 2)):
                        expected |= {(net.name, i, j, z) for z in layers[pin.layer - 1 :]}
    demand, some = solution.edge_demand, 0
    for index, edges in enumerate(solution.edges):
        for edge in edges[edges % 3 != 2].tolist():
            if demand[edge] >= CROWDED * problem.capacity[edge]:
                some += 1
                for gcell in np.array(problem.topology.ends(np.array([edge]))).reshape(-1):
                    x, y, z = np.unravel_index(gcell, problem.grid)
                    if z == 2:  # beside Metal2 only Metal3 has wires
                        expected.add((problem.nets[index].name, int(x), int(y), "Metal2"))
                    else:
                        expected.add((problem.nets[index].name, int(x), int(y), "Metal3"))
    assert some > 10
    assert patched == plain | expected


def test_what_is_wrong_with_a_guide(tmp_path: Path, solution: Solution) -> None:
    file = tmp_path / "a.guide"
    solution.write(file)
    good = file.read_text()
    assert check_guide(read_record(file, PROBLEM), PROBLEM) == GuideCheck(
        good.count(" Metal"), *GOOD
    )
    blocks = good.split(")\n")
    cells = {
        name: [line for line in block.splitlines() if " Metal" in line]
        for block in blocks
        if (name := block.partition("\n")[0])
    }
    wide = max(cells, key=lambda name: len(cells[name]))

    def with_lines(lines: list[str]) -> tuple[int, int, int]:
        old = "\n".join([wide, "(", *cells[wide], ")"])
        assert old in good
        file.write_text(good.replace(old, "\n".join([wide, "(", *lines, ")"])))
        return found(file)

    lines = cells[wide]
    x0, y0, x1, y1, layer = lines[0].split()
    assert with_lines([f"{x0} {y0} {x1} {int(y1) - 1} {layer}", *lines[1:]]) == (1, 0, 0)
    upper = [line for line in lines if "Metal1" not in line]
    net = next(net for net in PROBLEM.nets if net.name == wide)
    in_metal1 = [pin for pin in net.pins if pin.layer == 1]
    assert with_lines(upper) == (0, len(in_metal1), 0)
    assert with_lines([])[1] == len(net.pins)
    middle = [line for line in lines if "Metal2" not in line]
    assert with_lines(middle)[2] == 1
    solution.write(tmp_path / "a.solution")
    assert check_guide(read_record(tmp_path / "a.solution", PROBLEM), PROBLEM) is None


def test_evaluate_checks_guides(tmp_path: Path, solution: Solution, capsys: Any) -> None:
    solution.write(tmp_path / "a.guide")
    solution.write(tmp_path / "a.solution")
    for name in ("a.guide", "a.solution"):
        assert status(["evaluate", str(CHIP), str(tmp_path / name), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert ("guide_boxes" in told) == (name == "a.guide")
    out = str(tmp_path / "b.guide")
    given = ["--solution", str(tmp_path / "a.guide"), "--format", "patched-guide"]
    assert status(["convert", str(CHIP), out, *given]) == 0
    assert found(Path(out)) == GOOD


@pytest.mark.skipif(not ISPD18.exists(), reason="needs the design in ../shared/data")
def test_the_contests_own_guide_meets_its_rules() -> None:
    design = ProblemFile(path=str(ISPD18 / "ispd18_test1.input.def"), tile=(6000, 5700)).read()
    checked = check_guide(read_record(ISPD18 / "ispd18_test1.input.guide", design), design)
    assert checked == GuideCheck(26598, *GOOD)


def test_boxes_beyond_the_chip_count_as_far_as_they_lie_on_it(
    tmp_path: Path, solution: Solution
) -> None:
    ours, wide = tmp_path / "ours.guide", tmp_path / "wide.guide"
    solution.write(ours)
    assert PROBLEM.chip is not None
    right = int(PROBLEM.chip.x[-1])
    rows = [line.split() for line in ours.read_text().splitlines()]
    assert any(len(row) == 5 and int(row[0]) == 0 for row in rows)
    for row in rows:
        if len(row) == 5:
            row[0] = row[0] if int(row[0]) > 0 else "-700"
            row[2] = row[2] if int(row[2]) < right else str(right + 700)
    wide.write_text("\n".join(map(" ".join, rows)) + "\n")
    assert Solution.read(wide, PROBLEM) == Solution.read(ours, PROBLEM)
    assert found(wide) == GOOD
    wide.write_text(f"{PROBLEM.nets[0].name}\n(\n{right} 0 {right + 700} 700 Metal2\n)\n")
    with pytest.raises(InputError, match=r"wide.guide:3: expected a box on the chip, from"):
        Solution.read(wide, PROBLEM)
    checked = check_guide(read_record(wide, PROBLEM), PROBLEM)
    assert checked is not None
    assert (checked.boxes, checked.off_grid, checked.split_nets) == (1, 1, 0)


def test_a_guide_without_boxes_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "none.guide").write_text("")
    assert status(["evaluate", str(CHIP), str(tmp_path / "none.guide"), "--json"]) == 0
    shown = capsys.readouterr()
    assert "none.guide: no boxes, so it is not checked as a guide" in shown.err
    assert not any(key.startswith("guide_") for key in json.loads(shown.out))


def test_patches_count_what_controls_leave_also_beside_nets_that_stay(tmp_path: Path) -> None:
    solution = sequential_astar(PROBLEM)
    solution.write(tmp_path / "all.guide")
    some = tuple(net.name for net in PROBLEM.nets[:2])
    kept = {"keep": str(tmp_path / "all.guide"), "keep_nets": some}
    sizes = []
    for derate in (1.0, 0.3):
        for controls in ({}, kept):
            problem = ProblemFile(path=str(CHIP), derate={"Metal2": derate}, **controls).read()
            routes = Solution(problem, [solution.edges[i] for i in _numbers(problem)])
            routes.write(tmp_path / "a.guide", "patched-guide")
            sizes.append(len(covered(tmp_path / "a.guide")))
    assert sizes[0] == sizes[1] < sizes[2] == sizes[3]


def _numbers(problem: Problem) -> list[int]:
    """The numbers that a problem's nets have in PROBLEM."""
    number = {net.name: i for i, net in enumerate(PROBLEM.nets)}
    return [number[net.name] for net in problem.nets]


def test_layers_whose_capacity_lies_in_few_edges_have_wires(tmp_path: Path) -> None:
    """Of Metal3 one edge is open; a full edge in Metal2 gets room above it."""
    nets = (Net("a", 0, (Pin(5, 5, 2), Pin(5, 75, 2))), Net("b", 1, (Pin(35, 35, 1),)))
    problem = Problem(
        (4, 8, 3), (0, 1, 0), (0, 0, 0), nets, (1,) * 3, (0,) * 3, (0,) * 3, (0, 0), (10, 10),
        (Adjustment(0, 0, 3, 1, 0, 3, 4),),
    )  # fmt: skip
    assert problem.chip_or_default.wires.tolist() == [[False, False], [False, True], [True, False]]
    sequential_astar(problem).write(tmp_path / "a.guide", "patched-guide")
    text = (tmp_path / "a.guide").read_text()
    assert all(f"0 {10 * y} 10 {10 * y + 10} Metal3" in text for y in range(2, 6))
