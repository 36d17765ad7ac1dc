"""Generated problem sets: reproducible, solvable, in the manner of the paper."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import Edge, between, edge_number, gcell_of, is_via, pin_gcells

from marouting import InputError, Problem, evaluate, generate, sequential_astar
from marouting.generator import Least
from marouting.problem.net import MAX_NUMBER

arguments = st.fixed_dictionaries(
    {
        "grid": st.sampled_from([(2, 1, 1), (1, 3, 2), (3, 3, 1), (4, 5, 3), (8, 8, 2)]),
        "nets": st.integers(1, 12),
        "max_pins": st.integers(2, 5),
        "capacity": st.integers(0, 4),
        "reduced_edges": st.sampled_from([0, 1, 3, 1000]),
        "reduced_capacity": st.none() | st.integers(0, 3),
        "reduced_per": st.sampled_from(["problem", "set"]),
        "seed": st.integers(0, 10**9),
    }
).filter(lambda chosen: (chosen["reduced_capacity"] or 0) <= chosen["capacity"])


def text(problem: Problem, folder: Path) -> bytes:
    """The bytes of a problem's file."""
    problem.write(folder / "problem.gr")
    return (folder / "problem.gr").read_bytes()


def adjusted(problem: Problem) -> dict[Edge, int]:
    """The edges with a capacity of their own."""
    return {
        between((a.x1, a.y1, a.layer1 - 1), (a.x2, a.y2, a.layer2 - 1)): a.capacity
        for a in problem.adjustments
    }


def traffic(problem: Problem) -> dict[Edge, int]:
    """How many nets use each edge (no via) in the sequential A* solution."""
    count: dict[Edge, int] = {}
    for edges in sequential_astar(problem).edges:
        for near, far in zip(*problem.topology.ends(edges), strict=True):
            edge = between(gcell_of(problem, int(near)), gcell_of(problem, int(far)))
            if not is_via(edge):
                count[edge] = count.get(edge, 0) + 1
    return count


def test_same_arguments_same_files_problem_by_problem(tmp_path: Path) -> None:
    ten = [text(p, tmp_path) for p in generate(10, nets=20, max_pins=4, seed=7)]
    assert [text(p, tmp_path) for p in generate(10, nets=20, max_pins=4, seed=7)] == ten
    # Problem i does not depend on the count.
    for count in (1, 4):
        assert [text(p, tmp_path) for p in generate(count, nets=20, max_pins=4, seed=7)] == (
            ten[:count]
        )
    assert len(set(ten)) == 10
    assert text(generate(1, nets=20, max_pins=4, seed=8)[0], tmp_path) not in ten


def test_a_seed_names_the_same_problems_for_good() -> None:
    """Published results name their problems by seed: what it draws must not change unnoticed."""
    assert [[net.pins for net in problem.nets] for problem in generate(2, nets=2, seed=0)] == [
        [((64, 75, 1), (0, 25, 1)), ((60, 57, 1), (16, 10, 1))],
        [((52, 54, 1), (28, 19, 1)), ((6, 48, 1), (1, 33, 1))],
    ]


def test_no_seed_gives_another_set_every_time() -> None:
    assert generate(1, seed=None) != generate(1, seed=None)


@given(arguments)
def test_what_every_problem_is_like(chosen: dict[str, Any]) -> None:
    (problem,) = generate(1, **chosen)
    assert problem.grid == chosen["grid"]
    assert [net.id for net in problem.nets] == list(range(1, chosen["nets"] + 1))
    for net in range(chosen["nets"]):
        assert len(pin_gcells(problem, net)) >= 2
        assert 2 <= len(problem.nets[net].pins) <= chosen["max_pins"]
    assert all(pin.layer == 1 for net in problem.nets for pin in net.pins)
    # Demand of a net on an edge is 1, as in the paper.
    assert (problem.net_demand == 1).all()

    capacity, layers = chosen["capacity"], chosen["grid"][2]
    if layers == 1:
        assert (problem.horizontal_capacity, problem.vertical_capacity) == (
            (capacity,),
            (capacity,),
        )
    else:
        for layer in range(layers):
            along_x = layer % 2 == 0
            assert problem.horizontal_capacity[layer] == (capacity if along_x else 0)
            assert problem.vertical_capacity[layer] == (0 if along_x else capacity)
    assert evaluate(problem, sequential_astar(problem)).connected


@given(arguments, st.integers(1, 3))
def test_reduced_edges_are_the_most_used(chosen: dict[str, Any], count: int) -> None:
    problems = generate(count, **chosen)
    expected = chosen["reduced_capacity"]
    if expected is None:
        expected = max(chosen["capacity"] - 2, 0)
    # Only an edge along its layer's direction has a capacity to reduce.
    columns, rows, layers = chosen["grid"]
    along_x = (columns - 1) * rows * (1 if layers == 1 else (layers + 1) // 2)
    along_y = columns * (rows - 1) * (1 if layers == 1 else layers // 2)
    reducible = along_x + along_y if chosen["capacity"] else 0

    before = [replace(problem, adjustments=()) for problem in problems]
    assert before == generate(count, **{**chosen, "reduced_edges": 0})
    used = [traffic(problem) for problem in before]
    if chosen["reduced_per"] == "set":
        assert len({problem.adjustments for problem in problems}) == 1
        edges = {edge for own in used for edge in own}
        used = [{edge: sum(own.get(edge, 0) for own in used) for edge in edges}] * count

    for problem, own in zip(problems, used, strict=True):
        reduced = adjusted(problem)
        assert set(reduced.values()) <= {expected}
        assert len(reduced) == len(problem.adjustments) == min(chosen["reduced_edges"], reducible)
        if reduced:
            # Most used first, ties by the number of the edge.
            last = min((own.get(edge, 0), -edge_number(problem, edge)) for edge in reduced)
            for edge, times in own.items():
                has_capacity = before[0].capacity[edge_number(problem, edge)] > 0
                if edge not in reduced and has_capacity:
                    assert (times, -edge_number(problem, edge)) < last


def test_the_papers_problems() -> None:
    """5 and 3, as in the authors' files; pins all over layer 1; two pins a net unless told."""
    problems = generate(30)
    assert {p.grid for p in problems} == {(8, 8, 2)}
    assert {p.horizontal_capacity for p in problems} == {(5, 0)}
    assert {p.vertical_capacity for p in problems} == {(0, 5)}
    assert {len(p.adjustments) for p in problems} == {3}
    assert {a.capacity for p in problems for a in p.adjustments} == {3}
    assert {len(p.nets) for p in problems} == {50}
    nets = [net for p in problems for net in p.nets]
    assert {len(net.pins) for net in nets} == {2}
    assert {(pin.x, pin.y) for net in nets for pin in net.pins} <= set(np.ndindex(80, 80))
    cells = [gcell for p in problems for pair in p.pin_gcells for gcell in pair.tolist()]
    # 3000 pins over 64 Gcells: 47 each on the average, 6.8 the standard deviation.
    counts = np.bincount(cells, minlength=128)[::2]
    assert counts.min() > 47 - 5 * 7
    assert counts.max() < 47 + 5 * 7


def test_sizes_of_nets_are_uniform() -> None:
    sizes = [len(net.pins) for p in generate(20, max_pins=5) for net in p.nets]
    counts = np.bincount(sizes)[2:]
    assert len(counts) == 4
    assert abs(counts - 250).max() < 5 * np.sqrt(250)


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ({"count": 0}, "count: expected 1 to 1000000000, found 0"),
        ({"nets": 0}, "nets: expected 1 to 1000000000, found 0"),
        ({"max_pins": 1}, "max_pins: expected 2 to 1000000000, found 1"),
        ({"grid": (0, 8, 2)}, "grid"),
        ({"grid": (8, 8)}, "grid"),
        ({"grid": (1, 1, 2)}, "at least two Gcells in layer 1"),
        ({"grid": (10**5, 10**5, 2)}, "grid"),
        ({"capacity": -1}, "capacity: expected 0 to 1000000000"),
        ({"capacity": MAX_NUMBER + 1}, "capacity"),
        ({"reduced_edges": -1}, "reduced_edges: expected 0 to"),
        ({"reduced_capacity": -1}, "reduced_capacity: expected 0 to"),
        ({"reduced_per": "sets"}, "reduced_per: expected one of problem, set, found 'sets'"),
        ({"seed": -1}, "seed: expected a number from 0"),
        ({"reduced_capacity": 6}, "reduced_capacity: expected at most the capacity, 5, found 6"),
        (
            {"reduced_capacity": 4, "least": Least(capacity=3)},
            "least.reduced_capacity: expected at most the capacity, 3, found 4",
        ),
    ],
)
def test_arguments_out_of_range(bad: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected) as caught:
        generate(**bad)
    assert "\n" not in str(caught.value)


def test_local_nets_are_as_long_as_rent_says() -> None:
    """The distances of two pins are as likely as l^(2 rent − 3), but for those off the grid."""
    [problem] = generate(1, (60, 60, 2), nets=4000, rent=0.6, reduced_edges=0, seed=4)
    pins = [np.array([pin_gcells(problem, n)]).reshape(2, 3) for n in range(4000)]
    far = np.array([np.abs(a - b).sum() for a, b in pins])
    count = np.bincount(far)
    for near in (1, 2, 4):
        likely = 2.0 ** (2 * 0.6 - 3)
        assert count[2 * near] / count[near] == pytest.approx(likely, rel=0.25)
    assert far.max() > 20


def test_macros_close_all_but_the_two_highest_layers() -> None:
    [problem] = generate(1, (30, 20, 4), nets=300, macros=3, reduced_edges=0, seed=5)
    closed = {edge for edge, capacity in adjusted(problem).items() if capacity == 0}
    gcells = {gcell[:2] for edge in closed for gcell in edge}
    assert closed
    assert {gcell[2] for edge in closed for gcell in edge} == {0, 1}
    # Whole rectangles: what is closed towards both sides has no pins.
    inside = {
        (x, y)
        for x, y in gcells
        if between((x, y, 0), (x + 1, y, 0)) in closed
        and between((x - 1, y, 0), (x, y, 0)) in closed
        and between((x, y - 1, 1), (x, y, 1)) in closed
        and between((x, y, 1), (x, y + 1, 1)) in closed
    }
    pins = {gcell[:2] for net in range(300) for gcell in pin_gcells(problem, net)}
    assert inside
    assert not inside & pins


def test_half_of_the_nets_begin_at_hot_spots() -> None:
    [problem] = generate(1, (64, 64, 2), nets=2000, hot_spots=1, rent=0.2, reduced_edges=0, seed=6)
    begin = np.array([pin_gcells(problem, net)[0][:2] for net in range(2000)])
    spot = np.median(begin, axis=0)
    near = (np.abs(begin - spot) <= 8).all(axis=1).mean()
    assert 0.4 < near < 0.65


@pytest.mark.parametrize(
    ("given_", "named"),
    [({"rent": 1.5}, "rent"), ({"macros": -1}, "macros"), ({"macros": 1}, "macros"),
     ({"hot_spots": -2}, "hot_spots")],
)  # fmt: skip
def test_options_of_chips_out_of_range(given_: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        generate(1, **given_)


def test_no_room_outside_of_macros() -> None:
    with pytest.raises(
        InputError, match="macros: expected Gcells on the grid and outside of macros"
    ):
        generate(1, (10, 10, 3), nets=5, macros=1000)


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_nets_that_begin_too_far_off_the_grid_are_drawn_again(seed: int) -> None:
    problem = generate(1, (1, 2, 1), nets=50, rent=0.6, hot_spots=1, seed=seed)[0]
    assert problem.to_route.all()
