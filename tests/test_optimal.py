"""The proven optimum and its trees: enumeration, worked examples and published optima."""

import csv
import functools
import itertools
import math
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from conftest import examples, some_slow
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from reference import contested, steiner_length
from strategies import problems

from marouting import InputError, Net, Pin, Problem, evaluate, generate, sequential_astar
from marouting.config import build
from marouting.problem.grid import AXES, VIA_AXIS, Grid
from policies.routers.base import Router, solve, warm_up
from policies.routers.optimal import OptimalRouter, Optimum
from policies.routers.optimal.flows import MOST_TRACKS
from policies.routers.optimal.priced_tree import NEVER, TreesByEdge, Window, cheapest_priced_tree
from policies.routers.optimal.router import MOST_PINS
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

PUBLISHED = Path(__file__).resolve().parents[2] / "shared" / "data" / "liao2019"

Shape = tuple[int, int, int]
Costs = NDArray[np.int64]

# With at most 12 edges: few enough to enumerate all sets of edges.
TINY: tuple[Shape, ...] = ((3, 3, 1), (2, 2, 2), (4, 2, 1), (1, 4, 2), (3, 2, 1), (5, 1, 1))


# --- enumeration ----------------------------------------------------------------------------------


class Sets:
    """Every set of edges of a tiny grid.

    Attributes:
        edge: (m,) the edges.
        member: (2^m, m) which edges are in a set.
        part: (2^m, Gcells) the lowest Gcell connected to a Gcell.
        tree: (2^m,) whether the edges form one tree.
        leaf: (2^m, Gcells) whether one edge of the set ends at the Gcell.
    """

    def __init__(self, shape: Shape) -> None:
        grid = Grid.of(shape)
        self.edge = np.flatnonzero(grid.exists)
        near, far = grid.ends(self.edge)
        count = len(self.edge)
        self.member = (np.arange(2**count)[:, None] >> np.arange(count)) & 1 == 1
        self.part = np.tile(np.arange(grid.gcells), (2**count, 1))
        degree = np.zeros_like(self.part)
        for i in range(count):
            inside = np.flatnonzero(self.member[:, i])
            degree[inside, near[i]] += 1
            degree[inside, far[i]] += 1
            ends = self.part[inside][:, [near[i], far[i]]]
            parts = self.part[inside]
            merged = parts == ends.max(axis=1)[:, None]
            self.part[inside] = np.where(merged, ends.min(axis=1)[:, None], parts)
        touched = degree > 0
        split = np.array([len(set(row[on])) for row, on in zip(self.part, touched, strict=True)])
        self.tree = (split == 1) & (self.member.sum(axis=1) == touched.sum(axis=1) - 1)
        self.leaf = degree == 1

    def joins(self, pins: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which sets join the pins."""
        part = self.part[:, pins]
        return np.all(part == part[:, :1], axis=1)

    def trees(self, pins: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which sets are trees that join the pins and whose leaves are pins."""
        elsewhere = np.setdiff1d(np.arange(self.leaf.shape[1]), pins)
        return self.tree & self.joins(pins) & ~self.leaf[:, elsewhere].any(axis=1)

    def cost(self, price: Costs) -> NDArray[np.float64]:
        """The cost of every set; infinite if it contains an edge that must not be used."""
        own = price.reshape(-1)[self.edge].astype(float)
        own[own >= NEVER] = np.inf
        return np.where(self.member, own, 0.0).sum(axis=1)


@functools.cache
def sets(shape: Shape) -> Sets:
    return Sets(shape)


def least_cost(shape: Shape, price: Costs, pins: NDArray[np.int64]) -> int:
    """The cost of the cheapest set of edges that joins the pins."""
    least = sets(shape).cost(price)[sets(shape).joins(pins)].min()
    return NEVER if np.isinf(least) else int(least)


def best_of_all(problem: Problem) -> tuple[int, int]:
    """Overflow and wirelength of the best of all combinations of trees."""
    every = sets(problem.grid)
    wire = every.edge % AXES != VIA_AXIS
    edge = every.edge[wire]
    layer = edge // AXES % problem.grid[2]
    found = {(0,) * len(edge): 0}  # least length for each demand on the edges
    for net, pins in enumerate(problem.pin_gcells):
        if len(pins) == 1:
            continue
        trees = every.member[every.trees(pins)]
        taken = trees[:, wire] * problem.net_demand[net, layer].astype(np.int64)
        more: dict[tuple[int, ...], int] = {}
        for used, length in found.items():
            for key, own in zip((taken + used).tolist(), trees.sum(axis=1).tolist(), strict=True):
                total = length + own
                if total < more.get(tuple(key), total + 1):
                    more[tuple(key)] = total
        found = more
    capacity = problem.capacity[edge].astype(np.int64)
    used = np.array(list(found)).reshape(len(found), len(edge))
    overflow = np.maximum(used - capacity, 0).sum(axis=1)
    return min(zip(overflow.tolist(), found.values(), strict=True))


@st.composite
def priced(draw: st.DrawFn, cheapest: int = 0) -> tuple[Shape, Costs, NDArray[np.int64]]:
    """A tiny grid, the prices of its edges (some must not be used), and pins."""
    shape = draw(st.sampled_from(TINY))
    grid = Grid.of(shape)
    cost = st.one_of(st.integers(cheapest, 4), st.integers(cheapest, 10**9), st.just(NEVER))
    price = np.full(grid.edges, NEVER)
    for edge in np.flatnonzero(grid.exists):
        price[edge] = draw(cost)
    pins = draw(st.lists(st.integers(0, grid.gcells - 1), min_size=2, max_size=5, unique=True))
    return shape, price.reshape(*shape, AXES), np.array(pins)


def joined(shape: Shape, edges: NDArray[np.int64], pins: NDArray[np.int64]) -> nx.Graph:
    """The edges as a graph, checked to join the pins."""
    assert np.array_equal(edges, np.unique(edges))
    assert Grid.of(shape).exists[edges].all()
    near, far = Grid.of(shape).ends(edges)
    graph: nx.Graph = nx.Graph(zip(near.tolist(), far.tolist(), strict=True))
    assert set(pins.tolist()) <= nx.node_connected_component(graph, int(pins[0]))
    return graph


# --- trees ----------------------------------------------------------------------------------------


@given(priced())
def test_no_set_of_edges_is_cheaper(case: tuple[Shape, Costs, NDArray[np.int64]]) -> None:
    shape, price, pins = case
    cost, edges = cheapest_priced_tree(price, pins)
    assert cost == least_cost(shape, price, pins)
    if cost == NEVER:
        assert len(edges) == 0
    else:
        joined(shape, edges, pins)
        assert price.reshape(-1)[edges].sum() == cost


@given(priced(cheapest=1))
def test_the_result_is_a_tree_if_no_edge_is_free(
    case: tuple[Shape, Costs, NDArray[np.int64]],
) -> None:
    shape, price, pins = case
    cost, edges = cheapest_priced_tree(price, pins)
    if cost < NEVER:
        graph = joined(shape, edges, pins)
        assert nx.is_tree(graph)
        assert {cell for cell, degree in graph.degree if degree == 1} <= set(pins.tolist())


@pytest.mark.parametrize("seed", range(5))
def test_two_pins_are_joined_by_a_shortest_path(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (9, 7, 3)
    grid = Grid.of(shape)
    price = np.where(grid.exists, rng.integers(0, 50, grid.edges), NEVER)
    price[rng.random(grid.edges) < 0.3] = NEVER
    usable = np.flatnonzero(price < NEVER)
    graph = nx.Graph()
    graph.add_nodes_from(range(grid.gcells))
    for edge, near, far in zip(usable, *grid.ends(usable), strict=True):
        graph.add_edge(int(near), int(far), weight=int(price[edge]))
    for _ in range(20):
        pins = rng.choice(grid.gcells, 2, replace=False)
        cost, edges = cheapest_priced_tree(price.reshape(*shape, AXES), pins)
        if nx.has_path(graph, *pins):
            assert cost == nx.dijkstra_path_length(graph, *pins)
            assert price[edges].sum() == cost
        else:
            assert cost == NEVER


@examples(15)
@given(priced(cheapest=1))
def test_trees_across_every_edge(case: tuple[Shape, Costs, NDArray[np.int64]]) -> None:
    shape, price, pins = case
    every, flat = sets(shape), price.reshape(-1)
    across = TreesByEdge(price, pins)
    assert across.cost.shape == (price.size,)
    assert (across.cost[flat == NEVER] == NEVER).all()
    parts = [
        (pins[list(part)], np.setdiff1d(pins, pins[list(part)]))
        for size in range(1, len(pins))
        for part in itertools.combinations(range(len(pins)), size)
    ]
    trees, costs = every.trees(pins), every.cost(price)
    for place, edge in enumerate(every.edge.tolist()):
        if flat[edge] == NEVER:
            continue
        near, far = (int(end[0]) for end in Grid.of(shape).ends(np.array([edge])))
        expected = min(
            least_cost(shape, price, np.append(own, near))
            + int(flat[edge])
            + least_cost(shape, price, np.append(other, far))
            for own, other in parts
        )
        assert across.cost[edge] == min(expected, NEVER)
        # The property that the router relies on: no tree that uses the edge is cheaper.
        assert across.cost[edge] <= costs[trees & every.member[:, place]].min(initial=np.inf)
        if expected < NEVER:
            tree = across.tree(edge)
            joined(shape, tree, pins)
            assert edge in tree
            assert flat[tree].sum() <= expected


@given(st.data())
def test_windows(data: st.DataObject) -> None:
    shape: Shape = data.draw(st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 3)))
    grid = Grid.of(shape)
    cells = st.lists(st.integers(0, grid.gcells - 1), min_size=1, max_size=4, unique=True)
    pins = np.array(data.draw(cells))
    margin = data.draw(st.integers(0, 7))
    window = Window.around(shape, pins, margin)
    position = grid.position
    low, high = position[pins, :2].min(axis=0) - margin, position[pins, :2].max(axis=0) + margin
    within = np.all((position[:, :2] >= low) & (position[:, :2] <= high), axis=1)
    assert np.prod(window.shape) == np.count_nonzero(within)
    # Gcells and edges in the window keep their order; no edge leaves it.
    assert window.gcells_in_window(np.flatnonzero(within)).tolist() == list(
        range(np.count_nonzero(within))
    )
    price = np.where(grid.exists, np.arange(grid.edges), NEVER)
    cut = window.cut(price.reshape(*shape, AXES)).reshape(-1)
    own = np.flatnonzero(cut < NEVER)
    assert np.array_equal(window.edges_in_grid(own), cut[own])
    edges = np.flatnonzero(grid.exists)
    near, far = grid.ends(edges)
    assert np.array_equal(window.edges_in_grid(own), edges[within[near] & within[far]])


def test_cutting_does_not_change_the_prices() -> None:
    price = np.ones((3, 3, 1, AXES), np.int64)
    Window((3, 3, 1), (0, 0), (2, 2)).cut(price)
    assert (price == 1).all()


# --- worked examples ------------------------------------------------------------------------------


def plane(nets: dict[str, list[tuple[int, int]]], grid: tuple[int, int], **options: Any) -> Problem:
    """A problem of one layer with edges of capacity 1, each of which has room for one net."""
    made = tuple(
        Net(name, i, tuple(Pin(x, y, 1) for x, y in pins))
        for i, (name, pins) in enumerate(nets.items())
    )
    return replace(Problem((*grid, 1), (1,), (1,), made, (1,), (0,), (0,)), **options)


def proven(problem: Problem, router: OptimalRouter | None = None) -> Optimum:
    """The router's result, checked by the evaluator."""
    optimum = (router or OptimalRouter()).solve(problem)
    judged = evaluate(problem, optimum.solution)
    assert judged.connected
    assert (optimum.overflow, optimum.wirelength) == (judged.overflow, judged.wirelength)
    best, bound = (
        (optimum.overflow, optimum.wirelength),
        (optimum.bound_overflow, optimum.bound_wirelength),
    )
    assert bound <= best
    assert (optimum.status == "optimal") == (bound == best)
    if optimum.overflow > optimum.bound_overflow:
        assert optimum.gap == math.inf
    else:
        assert optimum.gap * max(best[1], 1) == pytest.approx(best[1] - bound[1])
    assert optimum.seconds >= 0
    return optimum


def optimum_of(problem: Problem) -> tuple[int, int]:
    found = proven(problem)
    assert found.status == "optimal"
    assert found.gap == 0
    return found.overflow, found.wirelength


def test_least_overflow_comes_before_length() -> None:
    """Two nets take a detour of two edges each, one along the row above and one below."""
    problem = plane({name: [(0, 1), (3, 1)] for name in "abc"}, (4, 3))
    assert optimum_of(problem) == (0, 13)


def test_overflow_where_there_is_no_other_way() -> None:
    """Three nets share two edges of capacity 1: two too many on each."""
    assert optimum_of(plane({name: [(0, 0), (2, 0)] for name in "abc"}, (3, 1))) == (4, 6)


def test_nets_of_different_widths() -> None:
    """With spacing 1, width 2 takes 3 of 5 tracks and leaves room for width 1."""
    nets = {"wide": [(0, 0), (2, 0)], "wider": [(0, 0), (2, 0)], "thin": [(0, 0), (2, 0)]}
    problem = plane(
        nets, (3, 2), vertical_capacity=(5,), horizontal_capacity=(5,), min_spacing=(1,)
    )
    widths = zip(problem.nets, (2, 2, 1), strict=True)
    made = tuple(replace(net, min_width=width) for net, width in widths)
    assert optimum_of(replace(problem, nets=made)) == (0, 8)


@pytest.mark.parametrize("width", [10**6, 10**7, 10**9])
def test_overflow_of_one_wide_net(width: int) -> None:
    """No edge is wide enough, so the net overflows on two edges at least."""
    problem = plane({"wide": [(0, 0), (2, 0)]}, (3, 2))
    [net] = problem.nets
    wide = replace(problem, nets=(replace(net, min_width=width),))
    if width <= MOST_TRACKS:
        assert optimum_of(wide) == (2 * (width - 1), 2)
        return
    found = proven(wide, OptimalRouter())
    assert (found.overflow, found.wirelength) == (2 * (width - 1), 2)
    assert found.bound_overflow <= found.overflow
    assert found.status == "solver limit"


def test_layers_that_take_vias_only() -> None:
    """Only the third layer has capacity, so every net has to climb to it at both ends."""
    problem = Problem(
        grid=(3, 2, 3),
        vertical_capacity=(0, 0, 1),
        horizontal_capacity=(0, 0, 1),
        nets=(
            Net("a", 0, (Pin(0, 0, 1), Pin(2, 0, 1))),
            Net("b", 1, (Pin(0, 0, 1), Pin(2, 0, 2))),
        ),
        min_width=(1, 1, 1),
        min_spacing=(0, 0, 0),
        via_spacing=(0, 0, 0),
    )
    assert optimum_of(problem) == (0, 2 + 4 + 4 + 3)


def test_nets_that_need_no_route() -> None:
    dot = {"dot": [(1, 1)], "twice": [(0, 0), (0, 0)]}
    for bound in ("optimum", "relaxation"):
        found = proven(plane(dot, (2, 2)), OptimalRouter(bound=bound))
        assert (found.overflow, found.wirelength, found.status) == (0, 0, "optimal")
    assert optimum_of(plane({**dot, "net": [(0, 0), (0, 1)]}, (2, 2))) == (0, 1)


def test_a_net_that_cannot_avoid_overflow() -> None:
    """There is no capacity between the columns: each net overflows once, in any row."""
    nets = {name: [(0, y), (1, y)] for y, name in enumerate("ab")}
    assert optimum_of(plane(nets, (2, 2), horizontal_capacity=(0,))) == (2, 2)


# --- all combinations of trees --------------------------------------------------------------------

tiny = st.sampled_from(TINY).flatmap(
    lambda shape: contested(shape, max_nets=3, max_pins=4, max_capacity=3)
)


@examples(15)
@given(tiny)
def test_no_combination_of_trees_is_better(problem: Problem) -> None:
    best = best_of_all(problem)
    assert optimum_of(problem) == best
    for options in ({"time_limit": 0.0}, {"bound": "relaxation"}):
        found = proven(problem, OptimalRouter(**options))
        assert (found.bound_overflow, found.bound_wirelength) <= best
        assert (found.overflow, found.wirelength) >= best


def crowded(seed: int) -> Problem:
    """Nets of very different widths on a tiny grid, which prices often cannot settle."""
    rng = np.random.default_rng(seed)
    grid = TINY[rng.integers(3)]
    capacity = (tuple(rng.integers(1, 6, grid[2]).tolist()) for _ in range(2))
    nets = [
        Net(
            f"n{i}",
            i,
            tuple(Pin(x, y, z + 1) for x, y, z in rng.integers(grid, size=(rng.integers(2, 5), 3))),
            int(rng.integers(1, 5)),
        )
        for i in range(3)
    ]
    layers = grid[2]
    return Problem(grid, *capacity, tuple(nets), (1,) * layers, (0,) * layers, (0,) * layers)


@pytest.mark.parametrize("seed", range(30))
def test_competing_nets_of_different_widths(seed: int) -> None:
    problem = crowded(seed)
    assert optimum_of(problem) == best_of_all(problem)


@pytest.mark.parametrize("factor", [1000, 10**6])
@pytest.mark.parametrize("seed", some_slow(range(6), range(2, 6)))
def test_large_numbers_do_not_lead_to_false_proofs(seed: int, factor: int) -> None:
    """With numbers this large the solver's tolerances amount to whole tracks."""
    small = crowded(seed)
    problem = replace(
        small,
        vertical_capacity=tuple(factor * tracks - 1 for tracks in small.vertical_capacity),
        horizontal_capacity=tuple(factor * tracks for tracks in small.horizontal_capacity),
        nets=tuple(replace(net, min_width=factor * net.min_width) for net in small.nets),
    )
    best = best_of_all(problem)
    found = proven(problem, OptimalRouter(time_limit=20.0))
    assert found.status in ("optimal", "solver limit")
    assert (found.bound_overflow, found.bound_wirelength) <= best
    assert best <= (found.overflow, found.wirelength)


NEAR_THE_PRECISION = """grid 2 3 1
vertical capacity 253332698
horizontal capacity 500000000
minimum width 0
minimum spacing 0
via spacing 0
0 0 1 1
num net 3
n0 0 2 102341140
0 2 1
0 2 1
n1 1 3 500000000
0 1 1
1 2 1
1 1 1
n2 2 2 1000000
1 2 1
1 1 1
4
0 1 1 1 1 1 372931281
0 1 1 1 1 1 2
0 1 1 1 1 1 999999
0 2 1 1 2 1 999999
"""


def test_numbers_near_the_solvers_precision(tmp_path: Path) -> None:
    """By rounding, HiGHS calls an integer program infeasible that is not: it proves nothing."""
    (tmp_path / "p.gr").write_text(NEAR_THE_PRECISION)
    problem = Problem.read(tmp_path / "p.gr")
    found = proven(problem, OptimalRouter())
    assert (found.bound_overflow, found.bound_wirelength) <= best_of_all(problem)
    assert found.status == "solver limit"


# --- bounds ---------------------------------------------------------------------------------------


def shortest(problem: Problem) -> int:
    """The least wirelength if every edge with room for one net had room for all."""
    total = 0
    for net, pins in enumerate(problem.pin_gcells):
        layer = np.arange(problem.topology.edges) // AXES % problem.grid[2]
        open_to = problem.topology.exists & (problem.net_demand[net, layer] <= problem.capacity)
        price = np.where(open_to, 1, NEVER).reshape(*problem.grid, AXES)
        total += cheapest_priced_tree(price, pins)[0] if len(pins) > 1 else 0
    return total


@examples(10)
@given(st.one_of(problems(max_side=4), contested(max_nets=8)))
def test_bounds_grow_towards_the_optimum(problem: Problem) -> None:
    """Shortest trees bound less than the relaxation, and that less than the optimum."""
    best = optimum_of(problem)
    first = proven(problem, OptimalRouter(time_limit=0.0))
    relaxed = proven(problem, OptimalRouter(bound="relaxation"))
    bounds = [(found.bound_overflow, found.bound_wirelength) for found in (first, relaxed)]
    assert bounds[0] <= bounds[1] <= best
    assert (first.overflow, first.wirelength) >= (relaxed.overflow, relaxed.wirelength) >= best
    astar = evaluate(problem, sequential_astar(problem))
    assert (first.overflow, first.wirelength) <= (astar.overflow, astar.wirelength)
    if best[0] == 0:
        assert bounds[0][1] >= shortest(problem)
    if relaxed.status != "optimal":
        assert relaxed.status == "relaxation"


@examples(10)
@given(contested(max_nets=4))
def test_without_congestion_the_bound_is_that_of_steiner_trees(problem: Problem) -> None:
    room = (1000,) * problem.grid[2]
    problem = replace(problem, vertical_capacity=room, horizontal_capacity=room, adjustments=())
    found = proven(problem, OptimalRouter(time_limit=0.0))
    assert (found.bound_overflow, found.bound_wirelength) == (0, steiner_length(problem).sum())
    assert optimum_of(problem) == (0, steiner_length(problem).sum())


def test_never_worse_than_the_first_pass_of_negotiated_congestion() -> None:
    """On a problem so congested that prices would take minutes to get as far."""
    problem = generate(1, (32, 32, 2), nets=640, max_pins=5, capacity=10, seed=1)[0]
    found = proven(problem, OptimalRouter(bound="relaxation", time_limit=3.0))
    first = PathfinderRouter(PathfinderOptions(seconds=0.0)).route(problem)
    figures = evaluate(problem, first)
    assert (found.overflow, found.wirelength) <= (figures.overflow, figures.wirelength)


@pytest.mark.parametrize("solver", ["linprog", "milp"])
def test_a_limit_holds_whatever_the_solver_does(
    solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may look at the clock too late, or never."""
    problem = generate(1, (8, 8, 2), nets=60, max_pins=3, capacity=2, seed=5)[0]
    warm_up(OptimalRouter())
    asked = threading.Event()

    def never(*_: Any, **__: Any) -> Any:
        asked.set()
        time.sleep(30)
        raise AssertionError

    monkeypatch.setattr(f"policies.routers.optimal.programs.{solver}", never)
    for limit in (1.0, 4.0, 16.0):  # on a busy machine the solver's turn comes late
        began = time.monotonic()
        found = proven(problem, OptimalRouter(time_limit=limit))
        if asked.is_set():
            break
    assert asked.is_set()
    assert time.monotonic() - began < limit + 18  # the solver would take 30
    assert found.status == "time limit"


@pytest.mark.slow
@pytest.mark.parametrize("limit", [1.0, 5.0])
def test_a_limit_holds_on_a_large_problem(limit: float) -> None:
    problem = generate(1, (64, 64, 4), nets=3000, capacity=8)[0]
    router = OptimalRouter(time_limit=limit)
    warm_up(router)
    began, worked = time.monotonic(), time.process_time()
    found = proven(problem, router)
    assert found.status == "time limit"
    # A shared processor can be elsewhere for as long as it likes.
    spent = min(time.monotonic() - began, time.process_time() - worked)
    assert spent <= limit + max(1.0, limit / 10)


def test_a_time_limit_may_be_longer_than_the_clock_counts() -> None:
    problem = generate(1, (4, 4, 2), nets=4)[0]
    assert proven(problem, OptimalRouter(time_limit=1e18)).report["status"] == "optimal"


def test_a_time_limit_of_zero_leaves_a_gap() -> None:
    problem = generate(1, capacity=1, seed=0)[0]  # far too little capacity
    found = proven(problem, OptimalRouter(time_limit=0.0))
    assert (found.status, found.gap) == ("time limit", math.inf)
    assert found.report["gap"] is None
    problem = generate(1, capacity=4, max_pins=5, nets=25, seed=0)[0]
    found = proven(problem, OptimalRouter(time_limit=0.0))
    assert found.bound_wirelength < proven(problem).wirelength <= found.wirelength


def test_the_relaxation_counts_only_some_pins_of_large_nets() -> None:
    """40 pins are too many for a full proof, but the bound is valid and there is a solution."""
    rng = np.random.default_rng(0)
    pins = tuple(Pin(int(x), int(y), 1) for x, y in rng.integers(0, 12, (40, 2)))
    problem = plane({"small": [(0, 0), (5, 5)]}, (12, 12))
    problem = replace(problem, nets=(*problem.nets, Net("large", 9, pins)))
    with pytest.raises(InputError, match="too large to prove an optimum"):
        OptimalRouter().route(problem)
    found = proven(problem, OptimalRouter(bound="relaxation"))
    assert found.status == "relaxation"
    spread = [len(cells) for cells in problem.pin_gcells]
    assert max(spread) > MOST_PINS
    # MOST_PINS pins far apart, and the ten edges of the small net.
    assert 10 + 22 < found.bound_wirelength < found.wirelength


# --- the router -----------------------------------------------------------------------------------


@pytest.mark.parametrize("pins", [25, 900])
def test_too_large_is_reported_in_one_line(pins: int) -> None:
    problem = plane({"large": [(i % 40, i // 40) for i in range(pins)]}, (40, 40))
    with pytest.raises(InputError) as raised:
        OptimalRouter(time_limit=0.0).solve(problem)
    message = str(raised.value)
    assert message.startswith("problem: too large to prove an optimum: expected at most 10^")
    assert f"1 nets with up to {pins} pins on 1600 Gcells" in message
    assert message.endswith("use bound=relaxation to get a bound only")
    assert "\n" not in message


def test_is_a_router_that_reports() -> None:
    router: Router = OptimalRouter()
    problem = generate(1, grid=(4, 4, 2), nets=8, max_pins=3, capacity=2, seed=0)[0]
    found = proven(problem)
    solution, report = solve(router, problem)
    assert router.route(problem) == solution == found.solution
    assert report == {
        "bound_overflow": found.overflow,
        "bound_wirelength": found.wirelength,
        "gap": 0,
        "status": "optimal",
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time_limit": -1.0}, "time_limit: expected seconds from 0, found -1"),
        ({"time_limit": math.nan}, "time_limit: expected a number or null, found nan"),
        ({"bound": "best"}, "bound: expected one of optimum, relaxation, found 'best'"),
        ({"bond": "optimum"}, "bond: unknown key; did you mean bound?"),
    ],
)
def test_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as raised:
        build(OptimalRouter, options)
    assert message in str(raised.value)


# --- published problems ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not PUBLISHED.exists(), reason="needs the problems in ../shared/data")
def test_all_published_optima() -> None:
    with (PUBLISHED / "results.csv").open(encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == 121
    for row in rows:
        problem = Problem.read(PUBLISHED / row["set"] / f"{row['problem']}.gr")
        optimum = int(row["optimal_overflow"]), int(row["optimal_wirelength"])
        assert optimum_of(problem) == optimum, row
