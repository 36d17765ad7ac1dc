"""Problems and solutions as ISPD 2008 text: what is written is read, what is read is meant."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import networkx
import numpy as np
import pytest
from hypothesis import given
from strategies import problems, solved_problems

from marouting import (
    Adjustment,
    InputError,
    Net,
    Pin,
    Problem,
    Solution,
    evaluate,
    sequential_astar,
)
from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

GR = """
GRID 3 2 2

Vertical  Capacity\t0 4
horizontal capacity 6 0
minimum width 1 2
minimum spacing 0 1
via spacing 0 0
-10 5 10 20\r
num NET 2
A 07 2 1
-10 5 1
  19 44 2
B_1 3 1 5
0 25 1
"""
ADJUSTMENTS = "2\n2 0 1   1 0 1   3\n0 0 2 0 1 2 0\n"


def problem_of(tmp_path: Path, text: str) -> Problem:
    file = tmp_path / "problem.gr"
    file.write_text(text, newline="")
    return Problem.read(file)


def solution_of(tmp_path: Path, problem: Problem, text: str) -> Solution:
    file = tmp_path / "problem.solution"
    file.write_text(text)
    return Solution.read(file, problem)


def small(tmp_path: Path) -> Problem:
    return problem_of(tmp_path, GR + ADJUSTMENTS)


def edge(problem: Problem, x: int, y: int, layer: int, axis: int) -> int:
    return AXES * problem.topology.number(x, y, layer - 1) + axis


def test_every_number_of_a_problem_is_where_it_belongs(tmp_path: Path) -> None:
    assert small(tmp_path) == Problem(
        grid=(3, 2, 2),
        vertical_capacity=(0, 4),
        horizontal_capacity=(6, 0),
        nets=(
            Net("A", 7, (Pin(-10, 5, 1), Pin(19, 44, 2)), 1),
            Net("B_1", 3, (Pin(0, 25, 1),), 5),
        ),
        min_width=(1, 2),
        min_spacing=(0, 1),
        via_spacing=(0, 0),
        origin=(-10, 5),
        tile=(10, 20),
        adjustments=(Adjustment(2, 0, 1, 1, 0, 1, 3), Adjustment(0, 0, 2, 0, 1, 2, 0)),
    )


def test_pins_and_adjustments_become_gcells_and_edges(tmp_path: Path) -> None:
    problem = small(tmp_path)
    number = problem.topology.number
    assert [gcells.tolist() for gcells in problem.pin_gcells] == [
        [number(0, 0, 0), number(2, 1, 1)],
        [number(1, 1, 0)],
    ]
    assert problem.capacity[edge(problem, 0, 0, 1, 0)] == 6
    assert problem.capacity[edge(problem, 1, 0, 1, 0)] == 3
    assert problem.capacity[edge(problem, 0, 0, 2, 1)] == 0
    assert problem.capacity[edge(problem, 1, 0, 2, 1)] == 4


def test_pins_in_one_gcell_count_once_in_pin_order(tmp_path: Path) -> None:
    text = GR.replace("A 07 2 1\n-10 5 1\n  19 44 2", "A 07 3 1\n19 44 2\n-9 6 1\n10 26 2")
    problem = problem_of(tmp_path, text)
    number = problem.topology.number
    assert problem.pin_gcells[0].tolist() == [number(2, 1, 1), number(0, 0, 0)]


def test_the_count_of_adjustments_may_be_missing(tmp_path: Path) -> None:
    assert problem_of(tmp_path, GR).adjustments == ()
    assert problem_of(tmp_path, GR + "0\n") == problem_of(tmp_path, GR)


def test_the_last_adjustment_of_an_edge_counts(tmp_path: Path) -> None:
    """As in the contest's evaluator, which sets the capacity of an edge line by line."""
    twice = "3\n2 0 1 1 0 1 3\n0 0 2 0 1 2 0\n1 0 1 2 0 1 5\n"
    problem = problem_of(tmp_path, GR + twice)
    assert problem.capacity[edge(problem, 1, 0, 1, 0)] == 5
    assert problem.capacity[edge(problem, 0, 0, 2, 1)] == 0
    assert len(problem.adjustments) == 3
    problem.write(tmp_path / "again.gr")
    assert Problem.read(tmp_path / "again.gr") == problem


@given(problem=problems())
def test_a_problem_is_read_as_it_was_written(
    problem: Problem, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.getbasetemp() / "roundtrip.gr"
    problem.write(file)
    written = file.read_bytes()
    again = Problem.read(file)
    assert again == problem
    again.write(file)
    assert file.read_bytes() == written


@given(solution=solved_problems())
def test_a_solution_is_read_as_it_was_written(
    solution: Solution, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.getbasetemp() / "roundtrip.solution"
    with warnings.catch_warnings():
        # What is written lists no edge twice.
        warnings.simplefilter("error")
        solution.write(file)
        written = file.read_bytes()
        again = Solution.read(file, solution.problem)
    assert again == solution
    again.write(file)
    assert file.read_bytes() == written


def test_published_problems_survive_writing(tmp_path: Path) -> None:
    files = sorted((DATA / "liao2019").glob("*/*.gr"))
    if not files:
        pytest.skip("the problems of Liao et al. are not beside the repository")
    for file in files:
        problem = Problem.read(file)
        problem.write(tmp_path / "again.gr")
        assert Problem.read(tmp_path / "again.gr") == problem


def test_a_segment_covers_all_gcells_between_its_ends(tmp_path: Path) -> None:
    problem = small(tmp_path)
    # Backwards along x, up, along y; points anywhere inside the Gcells.
    text = "A 7\n(19,24,1)-(-10,5,1)\n( 19, 5, 1 ) - (10,24,2)\n(15,15,2)-(15,44,2)\n!\n"
    assert solution_of(tmp_path, problem, text).edges[0].tolist() == sorted(
        [
            edge(problem, 0, 0, 1, 0),
            edge(problem, 1, 0, 1, 0),
            edge(problem, 2, 0, 1, 2),
            edge(problem, 2, 0, 2, 1),
        ]
    )


def test_a_segment_within_a_gcell_is_no_edge_and_a_missing_net_has_none(tmp_path: Path) -> None:
    problem = small(tmp_path)
    solution = solution_of(tmp_path, problem, "B_1 03 99\n(0,25,1)-(9,44,1)\n!\n")
    assert [edges.tolist() for edges in solution.edges] == [[], []]


def test_nets_may_come_in_any_order(tmp_path: Path) -> None:
    problem = small(tmp_path)
    text = "B_1 3 0\n(0,25,1)-(0,25,2)\n!\nA 7 0\n(-10,5,1)-(-10,5,2)\n!\n"
    solution = solution_of(tmp_path, problem, text)
    assert [edges.tolist() for edges in solution.edges] == [
        [edge(problem, 0, 0, 1, 2)],
        [edge(problem, 1, 1, 1, 2)],
    ]


def test_an_edge_listed_twice_counts_once_and_warns_once(tmp_path: Path) -> None:
    problem = small(tmp_path)
    text = "A 7 3\n(-5,5,1)-(15,5,1)\n(-5,5,1)-(5,5,1)\n(15,5,1)-(-5,5,1)\n!\nB_1 3 0\n!\n"
    with pytest.warns(UserWarning, match="lists an edge twice") as record:
        solution = solution_of(tmp_path, problem, text)
    assert len(record) == 1
    message = str(record[0].message)
    assert "problem.solution:3: net A" in message
    assert "3 repeated edges" in message
    assert solution.edges[0].tolist() == [edge(problem, 0, 0, 1, 0), edge(problem, 1, 0, 1, 0)]


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("A 7 2\n(-5,5,1)-(5,5,1)\n!\nB_1 3 0\n!\n", 1, "net A: expected 2 segments"),
        ("A 7 1\n(-5,5,1)-(5,5,1)\n!\nB_1 3 4\n!\n", 4, "net B_1: expected 4 segments"),
        ("A 7 0\n(-5,5,1)-(5,5,1)\n!\nB_1 3 4\n!\n", 1, "found 1 (2 such nets in this file)"),
        ("B_1 0 0\n!\nA 7 1\n(-5,5,1)-(5,5,1)\n!\n", 1, "net B_1: expected id 3, found 0"),
        ("B_1 7 0\n!\n\nA 3\n(-5,5,1)-(5,5,1)\n!\n", 1, "found 7 (2 such nets in this file)"),
    ],
)
def test_wrong_counts_and_ids_warn_once(tmp_path: Path, text: str, line: int, what: str) -> None:
    problem = small(tmp_path)
    with pytest.warns(UserWarning, match="net ") as record:
        solution = solution_of(tmp_path, problem, text)
    assert solution == solution_of(tmp_path, problem, "A 7 1\n(-5,5,1)-(5,5,1)\n!\nB_1 3 0\n!\n")
    assert [warning.filename for warning in record] == [__file__]
    message = str(record[0].message)
    assert message.startswith(f"{tmp_path / 'problem.solution'}:{line}: ")
    assert what in message


def test_right_counts_and_ids_are_taken_in_silence(tmp_path: Path) -> None:
    problem = small(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution_of(tmp_path, problem, "A 07 +1\n(-5,5,1)-(5,5,1)\n!\nB_1 3 0\n!\n")
        sequential_astar(problem).write(tmp_path / "astar.solution")
        Solution.read(tmp_path / "astar.solution", problem)


def test_two_nets_may_share_an_edge_without_a_warning(tmp_path: Path) -> None:
    problem = small(tmp_path)
    text = "A 7\n(-5,5,1)-(5,5,1)\n!\nB_1 3\n(-5,5,1)-(5,5,1)\n!\n"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = solution_of(tmp_path, problem, text)
    assert [len(edges) for edges in solution.edges] == [1, 1]


def test_the_form_of_a_written_solution(tmp_path: Path) -> None:
    problem = small(tmp_path)
    used = [
        edge(problem, 1, 0, 1, 0),
        edge(problem, 0, 0, 1, 0),
        edge(problem, 0, 0, 1, 2),
        edge(problem, 0, 1, 1, 0),
    ]
    Solution(problem, (np.array(used), np.array([], np.int64))).write(tmp_path / "out")
    # Maximal segments ordered by their lower end, centres of Gcells, id, number of segments.
    assert (tmp_path / "out").read_text() == (
        "A 7 3\n(-5,15,1)-(15,15,1)\n(-5,15,1)-(-5,15,2)\n(-5,35,1)-(5,35,1)\n!\nB_1 3 0\n!\n"
    )


def test_a_segment_ends_where_the_next_row_begins(tmp_path: Path) -> None:
    problem = small(tmp_path)
    used = np.array([edge(problem, 0, 0, 1, 0), edge(problem, 1, 1, 1, 0)])
    Solution(problem, (used, used[:0])).write(tmp_path / "out")
    assert (tmp_path / "out").read_text() == (
        "A 7 2\n(-5,15,1)-(5,15,1)\n(5,35,1)-(15,35,1)\n!\nB_1 3 0\n!\n"
    )


# --- many layers, as in the files of the contest --------------------------------------------------

# Pins in layer 1, which like layer 2 has no room; above, a direction a layer, wires wider at the
# top. Coordinates count from the corner of the chip, columns and rows of adjustments from 0.
CONTEST = """\
grid 6 5 6
vertical capacity 0 0 0 4 0 8
horizontal capacity 0 0 4 0 8 0
minimum width 1 1 1 1 2 2
minimum spacing 1 1 1 1 2 2
via spacing 1 1 1 1 2 2
35 70 35 40

num net 6
n0 0 2 1
40 80 1
240 80 1
n1 1 3 1
40 75 1
239 264 1
130 180 1
n2 2 2 3
41 229 1
239 71 1
n3 3 4 1
36 71 1
36 269 1
244 71 1
244 269 1
inside 4 2 1
100 100 1
101 101 1
n5 5 2 1
110 150 1
180 230 3

7
1 2 3   2 2 3   0
2 2 3   3 2 3   0
3 2 3   2 2 3   0
2 1 4   2 2 4   2
2 2 4   2 3 4   0
0 0 5   1 0 5   4
0 0 6   0 1 6   0
"""

ROUTERS: dict[str, Callable[[Problem], Solution]] = {
    "astar": sequential_astar,
    "pathfinder": PathfinderRouter(PathfinderOptions(seconds=None, passes=3)).route,
}


def check_contest(problem: Problem, solution: Solution) -> None:
    """Joined as networkx sees it, no edge over its capacity, none used that has none."""
    judged = evaluate(problem, solution)
    assert judged.connected
    assert (judged.overflow, judged.max_overflow) == (0, 0)
    assert judged.wirelength == sum(map(len, solution.edges))
    inside = np.arange(problem.capacity.size) % AXES != VIA_AXIS
    assert np.all(solution.edge_demand[inside] <= problem.capacity[inside])
    used = np.concatenate(solution.edges)
    flat = used[used % AXES != VIA_AXIS]
    assert len(flat)
    assert np.all(problem.capacity[flat] > 0)
    layer, axis = flat // AXES % problem.grid[2], flat % AXES
    by_axis = np.array((problem.horizontal_capacity, problem.vertical_capacity))
    assert np.all(by_axis[axis, layer] > 0)
    for pins, edges in zip(problem.pin_gcells, solution.edges, strict=True):
        graph = networkx.Graph()
        graph.add_nodes_from(pins.tolist())
        near = edges // AXES
        graph.add_edges_from(
            zip(near.tolist(), (near + problem.strides[edges % AXES]).tolist(), strict=True)
        )
        assert networkx.is_connected(graph)


def test_a_file_of_many_layers_is_as_written(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, CONTEST)
    number = problem.topology.number
    assert problem.grid == (6, 5, 6)
    assert [gcells.tolist() for gcells in problem.pin_gcells] == [
        [number(0, 0, 0), number(5, 0, 0)],
        [number(0, 0, 0), number(5, 4, 0), number(2, 2, 0)],
        [number(0, 3, 0), number(5, 0, 0)],
        [number(0, 0, 0), number(0, 4, 0), number(5, 0, 0), number(5, 4, 0)],
        [number(1, 0, 0)],
        [number(2, 2, 0), number(4, 4, 2)],
    ]
    # Width of the net or the layer, and the layer's spacing.
    assert problem.net_demand[0].tolist() == [2, 2, 2, 2, 4, 4]
    assert problem.net_demand[2].tolist() == [4, 4, 4, 4, 5, 5]
    for x, y, layer, axis, capacity in (
        (0, 0, 1, 0, 0),
        (0, 0, 2, 1, 0),
        (0, 2, 3, 0, 4),
        (1, 2, 3, 0, 0),
        (2, 2, 3, 0, 0),
        (1, 2, 3, 1, 0),
        (2, 1, 4, 1, 2),
        (2, 2, 4, 1, 0),
        (2, 3, 4, 1, 4),
        (0, 0, 5, 0, 4),
        (1, 0, 5, 0, 8),
        (0, 0, 6, 1, 0),
        (0, 1, 6, 1, 8),
    ):
        assert problem.capacity[edge(problem, x, y, layer, axis)] == capacity
    problem.write(tmp_path / "again.gr")
    # Of the white space nothing is kept, of the rest all.
    assert (tmp_path / "again.gr").read_text().split() == CONTEST.split()


@pytest.mark.parametrize("router", ROUTERS.values(), ids=ROUTERS)
def test_many_layers_are_routed(tmp_path: Path, router: Callable[[Problem], Solution]) -> None:
    problem = problem_of(tmp_path, CONTEST)
    solution = router(problem)
    check_contest(problem, solution)
    assert len(solution.edges[4]) == 0  # a net inside a Gcell
    # n0, alone, runs straight in layer 3: five edges and twice two vias.
    assert len(solution.edges[0]) >= 9
    solution.write(tmp_path / "out.solution")
    assert Solution.read(tmp_path / "out.solution", problem) == solution


def contest_text(seed: int, side: int, layers: int, pins: list[int]) -> str:
    """A file as the contest's: layers 1 and 2 without room, a wall in every other one."""
    rng = np.random.default_rng(seed)
    room = [0, 0, *(200 if z % 2 else 0 for z in range(2, layers))]
    other = [0, 0, *(0 if z % 2 else 200 for z in range(2, layers))]
    rows = [
        f"grid {side} {side} {layers}",
        f"vertical capacity {' '.join(map(str, room))}",
        f"horizontal capacity {' '.join(map(str, other))}",
        *(f"{what} {'1 ' * layers}" for what in ("minimum width", "minimum spacing")),
        f"via spacing {'1 ' * layers}",
        "0 0 35 35",
        "",
        f"num net {len(pins)}",
    ]
    for net, count in enumerate(pins):
        rows.append(f"n{net} {net} {count} 1")
        rows += [f"{x} {y} 1" for x, y in rng.integers(0, 35 * side, (count, 2)).tolist()]
    middle = side // 2
    walls = [(middle, y, z, middle + 1, y, z) for z in (3, 5) for y in range(side - 2)]
    walls += [(x, middle, z, x, middle + 1, z) for z in (4, 6) for x in range(2, side - 2)]
    rows += [str(len(walls)), *(" ".join(map(str, (*wall, 0))) for wall in walls)]
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize("router", ROUTERS.values(), ids=ROUTERS)
def test_nets_of_thousands_of_pins_find_the_gaps(
    tmp_path: Path, router: Callable[[Problem], Solution]
) -> None:
    problem = problem_of(tmp_path, contest_text(1, 30, 6, [3000, 1001, *[2, 3, 5] * 15]))
    assert [len(net.pins) for net in problem.nets[:2]] == [3000, 1001]
    solution = router(problem)
    check_contest(problem, solution)
    # All cross the wall between columns 15 and 16 where it leaves two rows open.
    wall = edge(problem, 15, 0, 1, 0), edge(problem, 16, 0, 1, 0)
    used = np.concatenate(solution.edges)
    crossing = used[(used >= wall[0]) & (used < wall[1]) & (used % AXES == 0)] // AXES
    assert set((crossing // problem.strides[1] % problem.grid[1]).tolist()) <= {28, 29}
    assert len(crossing)


def test_a_net_may_have_a_width_for_each_layer(tmp_path: Path) -> None:
    pins = (Pin(0, 0, 1), Pin(2, 2, 1))
    nets = Net("wide", 1, pins, (1, 3)), Net("plain", 2, pins), Net("equal", 3, pins, (2, 2))
    problem = Problem((3, 3, 2), (0, 5), (5, 0), nets, (1, 2), (0, 1), (0, 0))
    assert [net.min_width for net in problem.nets] == [(1, 3), 1, 2]
    assert problem.net_demand.tolist() == [[1, 4], [1, 3], [2, 3]]
    problem.write(tmp_path / "p.gr")
    assert "wide 1 2 1 3\n" in (tmp_path / "p.gr").read_text()
    assert Problem.read(tmp_path / "p.gr") == problem
    with pytest.raises(InputError, match="ispd98 cannot hold it: net wide: expected minimum width"):
        problem.write(tmp_path / "p.gr", "ispd98")
    (tmp_path / "p.gr").write_text(
        (tmp_path / "p.gr").read_text().replace("wide 1 2 1 3", "wide 1 2 1 3 4")
    )
    with pytest.raises(InputError, match=r"p.gr:9: expected net 1 of 3 \(name, id"):
        Problem.read(tmp_path / "p.gr")
    with pytest.raises(
        InputError, match="net wide: expected one minimum width or 2, one per layer"
    ):
        replace(problem, nets=(replace(nets[0], min_width=(1, 2, 3)),))
