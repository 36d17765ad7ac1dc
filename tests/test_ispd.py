"""Problems and solutions as ISPD 2008 text: what is written is read, what is read is meant."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import problems, solved_problems

from marouting import Adjustment, Net, Pin, Problem, Solution
from marouting.grid import AXES

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


@settings(deadline=None)
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


@settings(deadline=None)
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
    with pytest.warns(UserWarning, match="lists an edge again") as record:
        solution = solution_of(tmp_path, problem, text)
    assert len(record) == 1
    message = str(record[0].message)
    assert "problem.solution:3: net A" in message
    assert "3 repetitions" in message
    assert solution.edges[0].tolist() == [edge(problem, 0, 0, 1, 0), edge(problem, 1, 0, 1, 0)]


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
