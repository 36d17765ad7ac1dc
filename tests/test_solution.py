"""Solutions and their judgement, against hand-worked figures, published ones and oracles."""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from conftest import examples
from hypothesis import given
from reference import Gcell, gcell_of, pin_gcells, plain_evaluation
from strategies import solved_problems

from marouting import (
    Adjustment,
    Evaluation,
    InputError,
    Net,
    Pin,
    Problem,
    Solution,
    evaluate,
    sequential_astar,
)
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.net import MAX_NUMBER

PUBLISHED = Path(__file__).resolve().parents[2] / "shared" / "data" / "liao2019"

# Three Gcells in a row, two layers. Net A takes max(1, 1) + 1 = 2 tracks of a layer 1 edge, net B
# max(3, 1) + 1 = 4 there and max(3, 2) + 1 = 4 in layer 2.
ROW = Problem(
    grid=(3, 1, 2),
    vertical_capacity=(0, 0),
    horizontal_capacity=(3, 1),
    nets=(
        Net("A", 0, (Pin(0, 0, 1), Pin(2, 0, 1)), 1),
        Net("B", 1, (Pin(0, 0, 1), Pin(2, 0, 1)), 3),
    ),
    min_width=(1, 2),
    min_spacing=(1, 1),
    via_spacing=(0, 0),
    adjustments=(Adjustment(1, 0, 1, 2, 0, 1, 1),),
)


def x_edge(x: int, z: int) -> int:
    return AXES * ROW.topology.number(x, 0, z)


def via(x: int) -> int:
    return AXES * ROW.topology.number(x, 0, 0) + VIA_AXIS


ROUTES = ((x_edge(0, 0), x_edge(1, 0)), (x_edge(0, 0), via(1), x_edge(1, 1), via(2)))


def solution_of(problem: Problem, *routes: tuple[int, ...]) -> Solution:
    return Solution(problem, tuple(np.array(route, np.int64) for route in routes))


def test_hand_worked_figures() -> None:
    # Layer 1: 2 + 4 tracks over capacity 3, 2 over the adjusted 1. Layer 2: 4 over 1.
    solution = solution_of(ROW, *ROUTES)
    assert evaluate(ROW, solution) == Evaluation(
        overflow=3 + 1 + 3,
        max_overflow=3,
        wirelength=6,
        vias=2,
        connected=True,
        joined=2,
        tasks=2,
        disconnected=(),
    )
    demand = np.zeros(ROW.topology.edges, np.int64)
    demand[[x_edge(0, 0), x_edge(1, 0), x_edge(1, 1)]] = 6, 2, 4
    np.testing.assert_array_equal(solution.edge_demand, demand)


def test_paths_are_no_problems(tmp_path: Path) -> None:
    solution = Solution.of_uses(ROW, np.empty(0, np.int64), np.empty(0, np.int64))
    solution.write(tmp_path / "row.solution")
    path: Any = "row.gr"
    for call in (
        lambda: evaluate(path, solution),
        lambda: Solution.read(tmp_path / "row.solution", path),
        lambda: sequential_astar(path),
    ):
        with pytest.raises(InputError, match=r"^problem: expected a Problem, .* found 'row.gr'$"):
            call()
    with pytest.raises(InputError, match=r"^solution: expected a Solution, .* found 'row.gr'$"):
        evaluate(ROW, path)


def test_a_missing_edge_disconnects_its_net() -> None:
    evaluation = evaluate(ROW, solution_of(ROW, ROUTES[0], ROUTES[1][1:]))
    assert not evaluation.connected
    assert evaluation.disconnected == ("B",)
    assert (evaluation.joined, evaluation.tasks) == (1, 2)
    # The nets' edges are not shared: A's alone do not join B's pins.
    assert evaluate(ROW, solution_of(ROW, ROUTES[0], ())).disconnected == ("B",)


def test_pins_in_one_gcell_need_no_edge() -> None:
    net = Net("A", 0, (Pin(1, 0, 1), Pin(1, 0, 1)))
    problem = dataclasses.replace(ROW, nets=(net,))
    assert evaluate(problem, solution_of(problem, ())).connected


def test_capacities_of_the_given_problem_count() -> None:
    wide = dataclasses.replace(ROW, horizontal_capacity=(9, 9), adjustments=())
    assert evaluate(wide, solution_of(ROW, *ROUTES)).overflow == 0


@pytest.mark.parametrize(
    "other",
    [
        dataclasses.replace(ROW, nets=ROW.nets[::-1]),
        dataclasses.replace(ROW, grid=(4, 1, 2)),
    ],
)
def test_a_solution_of_another_problem_is_refused(other: Problem) -> None:
    with pytest.raises(InputError, match="same grid and nets"):
        evaluate(other, solution_of(ROW, *ROUTES))


@pytest.mark.parametrize(
    "missing",
    [
        -1,
        ROW.topology.edges,
        x_edge(2, 0),  # off the grid along x
        x_edge(0, 0) + 1,  # along y
        x_edge(0, 1) + 2,  # above the top layer
    ],
)
def test_an_edge_that_the_grid_has_not_is_refused(missing: int) -> None:
    with pytest.raises(InputError, match=rf"net B: expected edges of the grid, found {missing}$"):
        solution_of(ROW, (), (x_edge(0, 0), missing))


def test_one_array_a_net_is_needed() -> None:
    with pytest.raises(InputError, match="expected the edges of 2 nets, found 1"):
        solution_of(ROW, ())


def test_edges_are_kept_sorted_once_and_read_only() -> None:
    given_edges = np.array([via(1), x_edge(0, 0), via(1)])
    solution = Solution(ROW, (given_edges, np.array([], np.int64)))
    assert solution.edges[0].tolist() == [x_edge(0, 0), via(1)]
    with pytest.raises(ValueError, match="read-only"):
        solution.edges[0][0] = 1
    given_edges[:] = 0
    assert solution == solution_of(ROW, (via(1), x_edge(0, 0)), ())


@given(solution=solved_problems())
def test_uses_say_what_edges_say(solution: Solution) -> None:
    problem, (net, edge) = solution.problem, solution.uses
    pairs = [(n, e) for n, edges in enumerate(solution.edges) for e in edges.tolist()]
    assert list(zip(net.tolist(), edge.tolist(), strict=True)) == pairs == sorted(set(pairs))
    assert len(solution.edges) == len(problem.nets)
    again = Solution.of_uses(problem, net.copy(), edge.copy())
    assert again == solution
    assert [edges.tolist() for edges in again.edges] == [e.tolist() for e in solution.edges]
    for column in (*again.uses, *again.edges):
        assert column.dtype == np.int64
        assert not column.flags.writeable


def test_equal_means_same_problem_and_same_edges() -> None:
    solution = solution_of(ROW, *ROUTES)
    assert solution == solution_of(dataclasses.replace(ROW), *ROUTES)
    assert solution != solution_of(ROW, ROUTES[1], ROUTES[0])
    other = dataclasses.replace(ROW, horizontal_capacity=(9, 9))
    assert solution != solution_of(other, *ROUTES)
    with pytest.raises(TypeError, match="unhashable"):
        hash(solution)


@given(solution=solved_problems())
def test_evaluation_against_plain_definitions(solution: Solution) -> None:
    assert evaluate(solution.problem, solution) == plain_evaluation(solution)


@given(solution=solved_problems())
def test_edges_in_use_against_tables_of_all_edges(solution: Solution) -> None:
    problem = solution.problem
    existing = np.flatnonzero(problem.topology.exists)
    capacity = problem.capacity_of(existing)
    assert capacity.dtype == problem.capacity.dtype
    np.testing.assert_array_equal(capacity, problem.capacity[existing])
    demand = np.zeros(problem.topology.edges, np.int64)
    for net, edges in enumerate(solution.edges):
        demand[edges] += problem.net_demand[net, edges // AXES % problem.grid[2]]
    demand[VIA_AXIS::AXES] = 0
    np.testing.assert_array_equal(solution.edge_demand, demand)
    edge, tracks = solution.used_edges
    np.testing.assert_array_equal(edge, np.unique(solution.uses[1]))
    np.testing.assert_array_equal(tracks, demand[edge])
    overflow = np.maximum(demand - problem.capacity, 0)
    evaluation = evaluate(problem, solution)
    assert (evaluation.overflow, evaluation.max_overflow) == (overflow.sum(), overflow.max())


def test_the_largest_demands_add_up() -> None:
    """Widths and spacings at their limits, on an edge at the end of a grid at its limit."""
    nets = tuple(Net(f"n{n}", n, (Pin(0, 0, 1), Pin(0, 1, 1)), MAX_NUMBER) for n in range(3))
    large = Problem((4096, 4096, 1), (7,), (7,), nets, (0,), (MAX_NUMBER,), (0,))
    last = AXES * (large.topology.gcells - 2) + 1
    solution = Solution(large, [np.array([last])] * 3)
    assert [column.tolist() for column in solution.used_edges] == [[last], [6 * MAX_NUMBER]]
    assert evaluate(large, solution).overflow == 6 * MAX_NUMBER - 7


def test_published_figures_of_all_published_solutions() -> None:
    if not PUBLISHED.is_dir():
        pytest.skip("the solutions of Liao et al. are not beside the repository")
    with (PUBLISHED / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    published, found = {}, {}
    for row in rows:
        stem = f"{row['set']}/{row['problem']}"
        problem = Problem.read(PUBLISHED / f"{stem}.gr")
        for router in ("drl", "astar"):
            name = f"{stem}.{router}.solution"
            published[name] = int(row[f"{router}_overflow"]), int(row[f"{router}_wirelength"]), True
            result = evaluate(problem, Solution.read(PUBLISHED / name, problem))
            found[name] = result.overflow, result.wirelength, result.connected
    assert len(published) == 242
    assert found == published


def test_joined_counts_connections_between_the_pins_of_a_net() -> None:
    """Three pins in a row need two connections, whichever pieces of route there are."""
    pins = (Pin(0, 0, 1), Pin(1, 0, 1), Pin(2, 0, 1), Pin(2, 0, 1))
    row = dataclasses.replace(ROW, nets=(Net("A", 0, pins),))
    for route, joined in (
        ((), 0),
        ((x_edge(0, 0),), 1),
        ((x_edge(1, 0), via(0)), 1),
        ((x_edge(0, 0), x_edge(1, 0)), 2),
        ((via(0), via(1)), 0),
    ):
        evaluation = evaluate(row, solution_of(row, route))
        assert (evaluation.joined, evaluation.tasks) == (joined, 2)
        assert evaluation.connected == (joined == 2)


# Pruned solutions ---------------------------------------------------------------------------------


def graphs_of(solution: Solution) -> list["nx.Graph[Gcell]"]:
    """The route of each net, with the Gcells of its pins."""
    graphs = []
    for net, edges in enumerate(solution.edges):
        graph: nx.Graph[Gcell] = nx.Graph()
        graph.add_nodes_from(pin_gcells(solution.problem, net))
        for edge in edges.tolist():
            near = gcell_of(solution.problem, edge // 3)
            graph.add_edge(near, tuple(a + (i == edge % 3) for i, a in enumerate(near)))
        graphs.append(graph)
    return graphs


@examples(100)
@given(solution=solved_problems())
def test_pruned_keeps_the_shortest_ways_from_the_first_pin_and_no_more(solution: Solution) -> None:
    problem, pruned = solution.problem, solution.pruned()
    for net, (whole, left) in enumerate(zip(graphs_of(solution), graphs_of(pruned), strict=True)):
        assert all(whole.has_edge(*edge) for edge in left.edges)
        pins = pin_gcells(problem, net)
        for part in nx.connected_components(whole):
            inside = [pin for pin in pins if pin in part]
            kept = left.subgraph(part)
            if len(inside) < 2:
                assert not kept.edges
                continue
            # Shortest ways, which a breadth-first tree has from all its leaves at once.
            for pin in inside:
                way = nx.shortest_path_length(whole, inside[0], pin)
                assert nx.shortest_path_length(kept, inside[0], pin) == way
            # And nothing besides: a tree whose ends are pins.
            tree = kept.edge_subgraph(kept.edges)
            assert nx.is_tree(tree)
            assert {cell for cell, degree in tree.degree if degree == 1} <= set(inside)


@examples(100)
@given(solution=solved_problems())
def test_pruned_is_never_worse_and_stays_as_it_is(solution: Solution) -> None:
    pruned = solution.pruned()
    before, after = (evaluate(solution.problem, each) for each in (solution, pruned))
    assert (after.joined, after.disconnected) == (before.joined, before.disconnected)
    assert after.overflow <= before.overflow
    assert after.max_overflow <= before.max_overflow
    assert after.wirelength <= before.wirelength
    assert after.vias <= before.vias
    assert pruned.pruned() == pruned
    assert pruned.problem is solution.problem


def test_pruned_by_hand() -> None:
    """A dead end, a loop to the side of the way, a longer way round, and an island."""
    pins = (Pin(0, 0, 1), Pin(3, 0, 1))
    problem = Problem(
        (4, 4, 1), (9,), (9,), (Net("A", 0, pins), Net("B", 1, pins)), (1,), (0,), (0,)
    )

    def east(x: int, y: int) -> int:
        return AXES * problem.topology.number(x, y, 0)

    def north(x: int, y: int) -> int:
        return east(x, y) + 1

    way = [east(x, 0) for x in range(3)]
    stub = [north(2, 0), north(2, 1)]
    loop = [north(0, 0), north(1, 0), east(0, 1)]
    island = [east(2, 3)]
    route = tuple(way + stub + loop + island)
    open_route = (way[0], way[2], *stub)
    pruned = solution_of(problem, route, open_route).pruned()
    assert [edges.tolist() for edges in pruned.edges] == [way, []]
    assert evaluate(problem, pruned).disconnected == ("B",)
    tidy = solution_of(problem, tuple(way), tuple(way))
    assert tidy.pruned() == tidy


def test_pruned_takes_long_dead_ends_at_once() -> None:
    net = Net("A", 0, (Pin(0, 0, 1), Pin(1, 0, 1)))
    long = Problem((4096, 1, 1), (1,), (1,), (net,), (1,), (0,), (0,))
    assert Solution(long, [AXES * np.arange(4095)]).pruned().edges[0].tolist() == [0]
