"""Steiner trees against all trees there are on small grids, and against networkx."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import Gcell, contested, distance, gcell_of, pin_gcells, steiner_length
from strategies import problems

from marouting import Net, Pin, Problem
from marouting.trees.decomposition import two_pin_tasks
from marouting.trees.exact_tree import Search, exact_tree, make_search
from marouting.trees.lattice import CLOSED, Lattice, make_lattice, set_cost, set_size
from marouting.trees.steiner import EXACT_PINS, steiner_tasks

any_problem = st.one_of(problems(), contested(max_nets=8, max_pins=14))
seeds = st.integers(0, 2**32)


def problem_of(nets: Sequence[Sequence[Gcell]], grid: tuple[int, int, int]) -> Problem:
    """A problem with nets of such pins, given as Gcells."""
    pins = [tuple(Pin(x, y, z + 1) for x, y, z in net) for net in nets]
    layers = grid[2]
    return Problem(
        grid,
        (1,) * layers,
        (1,) * layers,
        tuple(Net(f"n{i}", i, net) for i, net in enumerate(pins)),
        (1,) * layers,
        (0,) * layers,
        (0,) * layers,
    )


def tasks_of(problem: Problem) -> list[list[tuple[Gcell, Gcell]]]:
    """For each net its tasks, in order."""
    tasks: list[list[tuple[Gcell, Gcell]]] = [[] for _ in problem.nets]
    for net, start, target in steiner_tasks(*problem.flat_pin_gcells, problem.grid).tolist():
        tasks[net].append((gcell_of(problem, start), gcell_of(problem, target)))
    return tasks


def spanning_length(points: Sequence[Any], far: Any = distance) -> int:
    """The length of a minimum spanning tree of a few points (Prim)."""
    near = {point: far(points[0], point) for point in points[1:]}
    total = 0
    while near:
        nearest = min(near, key=lambda point: near[point])
        total += near.pop(nearest)
        near = {point: min(d, far(nearest, point)) for point, d in near.items()}
    return total


def shortest_length(points: Sequence[Any], candidates: Iterable[Any], far: Any = distance) -> int:
    """The length of a shortest tree: with all sets of Steiner points that a tree can have."""
    others = [point for point in candidates if point not in points]
    return min(
        spanning_length([*points, *steiner], far)
        for count in range(max(len(points) - 1, 1))
        for steiner in itertools.combinations(others, count)
    )


def hanan(points: Sequence[Gcell]) -> list[Gcell]:
    """The points of the Hanan grid."""
    return list(itertools.product(*(sorted(set(axis)) for axis in zip(*points, strict=True))))


@given(any_problem)
def test_tasks_are_a_tree_that_can_be_walked(problem: Problem) -> None:
    table = steiner_tasks(*problem.flat_pin_gcells, problem.grid)
    assert table.dtype == np.int32
    assert table.shape[1:] == (3,)
    assert (np.diff(table[:, 0]) >= 0).all()
    assert ((table[:, 1:] >= 0) & (table[:, 1:] < problem.topology.gcells)).all()
    for net, tasks in enumerate(tasks_of(problem)):
        cells = pin_gcells(problem, net)
        reached = {cells[0]}
        for start, target in tasks:
            assert start in reached
            assert target not in reached
            reached.add(target)
        assert set(cells) <= reached
        ends = list(itertools.chain(*tasks))
        for point in reached - set(cells):
            assert point in hanan(cells)
            assert ends.count(point) >= 3  # or the net would not branch there


@given(any_problem)
def test_length_lies_between_the_bounds(problem: Problem) -> None:
    for net, length in enumerate(steiner_length(problem).tolist()):
        cells = pin_gcells(problem, net)
        assert length == sum(distance(a, b) for a, b in tasks_of(problem)[net])
        sides = [max(axis) - min(axis) for axis in zip(*cells, strict=True)]
        spanning = spanning_length(cells)
        assert sum(sides) <= length <= spanning
        if 0 in sides:  # in a plane (Hwang 1976)
            assert 3 * length >= 2 * spanning


points = st.tuples(st.integers(0, 6), st.integers(0, 6), st.integers(0, 2))
planar = st.tuples(st.integers(0, 9), st.integers(0, 9), st.just(1))


@given(
    st.one_of(
        st.lists(points, min_size=1, max_size=4, unique=True),
        st.lists(planar, min_size=4, max_size=5, unique=True),
    )
)
def test_few_pins_get_a_shortest_tree(pins: list[Gcell]) -> None:
    problem = problem_of([pins], (10, 10, 3))
    assert steiner_length(problem).tolist() == [shortest_length(pins, hanan(pins))]


@given(st.lists(planar, min_size=6, max_size=EXACT_PINS, unique=True))
def test_no_longer_than_networkx_finds(pins: list[Gcell]) -> None:
    grid = nx.Graph()
    for a, b in itertools.combinations(hanan(pins), 2):
        if sum(i != j for i, j in zip(a, b, strict=True)) == 1:
            grid.add_edge(a, b, weight=distance(a, b))
    if len(grid) == 0:
        return
    found = nx.algorithms.approximation.steiner_tree(grid, pins)
    length = steiner_length(problem_of([pins], (10, 10, 3)))[0]
    assert 2 * length >= found.size(weight="weight") >= length


@given(any_problem, st.randoms(use_true_random=False))
def test_tasks_of_a_net_depend_on_its_own_pins_alone(problem: Problem, random: Any) -> None:
    order = list(range(len(problem.nets)))
    random.shuffle(order)
    kept = order[: max(1, len(order) // 2)]
    few = replace(problem, nets=tuple(problem.nets[net] for net in kept))
    tasks = tasks_of(problem)
    assert tasks_of(few) == [tasks[net] for net in kept]


def test_by_hand() -> None:
    nets: list[list[Gcell]] = [
        [(4, 4, 0), (4, 4, 0)],
        [(0, 0, 0), (4, 2, 0)],
        # A cross: its centre is a Steiner point, which the first task reaches.
        [(2, 0, 1), (0, 2, 1), (4, 2, 1), (2, 4, 1)],
        # A pin in the middle of the way is no Steiner point, and takes no further task.
        [(0, 0, 0), (4, 0, 0), (2, 0, 0)],
        # The legs meet where they need the fewest vias: in the layer of two of the pins.
        [(0, 2, 0), (4, 2, 0), (2, 4, 2)],
    ]
    tasks = tasks_of(problem_of(nets, (5, 5, 3)))
    assert tasks[0] == []
    assert tasks[1] == [((0, 0, 0), (4, 2, 0))]
    assert tasks[2][0] == ((2, 0, 1), (2, 2, 1))
    assert sorted(tasks[2][1:]) == [((2, 2, 1), end) for end in ((0, 2, 1), (2, 4, 1), (4, 2, 1))]
    assert tasks[3] == [((0, 0, 0), (2, 0, 0)), ((2, 0, 0), (4, 0, 0))]
    assert tasks[4][0] == ((0, 2, 0), (2, 2, 0))
    assert sorted(tasks[4][1:]) == [((2, 2, 0), (2, 4, 2)), ((2, 2, 0), (4, 2, 0))]


def test_iterated_1_steiner_saves_what_it_is_known_to() -> None:
    """About 11 % of a minimum spanning tree (Kahng and Robins 1992, random points)."""
    rng = np.random.default_rng(5)
    nets = [rng.integers(0, 200, (20, 2)).tolist() for _ in range(60)]
    problem = problem_of([[(x, y, 0) for x, y in net] for net in nets], (200, 200, 1))
    position = problem.topology.position.astype(np.int64)
    spanning = two_pin_tasks(problem)
    length = np.abs(position[spanning[:, 1]] - position[spanning[:, 2]]).sum()
    assert 0.10 < 1 - steiner_length(problem).sum() / length < 0.125


def test_many_pins() -> None:
    rng = np.random.default_rng(6)
    pins: list[Gcell] = [(int(x), int(y), 0) for x, y in rng.integers(0, 40, (150, 2))]
    problem = problem_of([pins], (40, 40, 1))
    [length] = steiner_length(problem)
    assert length < 0.95 * spanning_length(list(dict.fromkeys(pins)))
    [tasks] = tasks_of(problem)
    assert nx.is_tree(nx.Graph(tasks))


def random_lattice(
    size: tuple[int, int, int], rng: np.random.Generator
) -> tuple[Lattice, nx.Graph]:
    """A lattice of random costs, some edges closed, and the same as a graph."""
    lattice = make_lattice(int(np.prod(size)), max(size))
    set_size(lattice, *size)
    lattice.cost[:] = CLOSED
    lattice.line[:] = 2 * np.arange(max(size))
    graph = nx.Graph()
    number = np.arange(np.prod(size)).reshape(size)
    graph.add_nodes_from(number.ravel().tolist())
    for axis in range(3):
        inside = np.delete(number, -1, axis=axis).ravel().tolist()
        for point in inside:
            cost = int(rng.choice([2, 2, 3, 7, CLOSED]))
            if cost != CLOSED:
                set_cost(lattice, point, axis, cost)
                graph.add_edge(point, point + int(lattice.stride[2 * axis]), weight=cost)
    return lattice, graph


def box(lattice: Lattice, s: Search, group: int, members: Sequence[int]) -> None:
    """Sets the box of a group, or of the goal."""
    at = np.stack(np.unravel_index(members, tuple(lattice.size)), axis=1) * 2
    s.low[group], s.high[group] = at.min(axis=0), at.max(axis=0)


def tree_of(lattice: Lattice) -> nx.Graph:
    """The tree that the lattice holds; both ends of an edge must have it."""
    graph = nx.Graph()
    for point, bits in enumerate(lattice.tree.tolist()):
        for move in range(6):
            if bits >> move & 1:
                beside = point + int(lattice.stride[move])
                assert lattice.tree[beside] >> (move ^ 1) & 1
                graph.add_edge(point, beside, weight=int(lattice.cost[point, move]))
    return graph


@given(
    st.sampled_from([(5, 5, 1), (3, 3, 2), (2, 4, 3), (1, 9, 2)]),
    st.integers(2, 4),
    seeds,
)
def test_exact_tree_is_a_cheapest_one(size: tuple[int, int, int], pins: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lattice, graph = random_lattice(size, rng)
    points = int(np.prod(size))
    s = make_search(points, points << 3, 3)
    terminals = rng.choice(points, pins, replace=False).tolist()
    far = dict(nx.all_pairs_dijkstra_path_length(graph))
    reachable = all(terminal in far[terminals[0]] for terminal in terminals)
    for again in range(2):  # the working arrays are used again as they are left
        for group, terminal in enumerate(terminals):
            box(lattice, s, group, [terminal])
        s.start[: pins - 1], s.group[: pins - 1] = terminals[:-1], range(pins - 1)
        s.goal[terminals[-1]] = 1
        set_size(lattice, *size)
        cost = exact_tree(lattice, s, pins - 1, pins - 1, int(rng.integers(2**31)))
        s.goal[terminals[-1]] = 0
        if not reachable:
            assert cost == CLOSED
            continue
        inside = [point for point in graph if point in far[terminals[0]]]
        assert cost == shortest_length(terminals, inside, lambda a, b: far[a][b])
        tree = tree_of(lattice)
        assert nx.is_tree(tree)
        assert set(terminals) <= set(tree)
        assert tree.size(weight="weight") == cost
        terminals = terminals[::-1] if not again else terminals


@given(st.integers(1, 6), st.integers(1, 6), seeds)
def test_one_group_is_joined_by_a_shortest_path(starts: int, goals: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = (5, 4, 2)
    lattice, graph = random_lattice(size, rng)
    s = make_search(40, 40, 1)
    chosen = rng.permutation(40)[: starts + goals].tolist()
    group, goal = chosen[:starts], chosen[starts:]
    s.start[:starts] = group
    s.goal[goal] = 1
    box(lattice, s, 1, goal)
    cost = exact_tree(lattice, s, starts, 1, int(rng.integers(2**31)))
    found = nx.multi_source_dijkstra_path_length(graph, set(group))
    assert cost == min((found[end] for end in goal if end in found), default=CLOSED)
    if cost != CLOSED:
        path = tree_of(lattice)
        assert path.size(weight="weight") == cost
        assert sorted(degree for _, degree in path.degree).count(1) == 2


@pytest.mark.parametrize("random", [0, 1, 12345])
def test_ties_are_broken_by_the_random_number(random: int) -> None:
    """The same number, the same tree; whatever the number, the same cost."""
    size = (6, 6, 1)
    trees = []
    for _ in range(2):
        lattice = make_lattice(36, 6)
        set_size(lattice, *size)
        lattice.cost[:] = CLOSED
        lattice.line[:] = np.arange(6)
        for point in range(36):
            for axis, inside in enumerate((point < 30, point % 6 < 5)):
                if inside:
                    set_cost(lattice, point, axis, 1)
        s = make_search(36, 36, 1)
        s.start[0], s.goal[35] = 0, 1
        box(lattice, s, 1, [35])
        assert exact_tree(lattice, s, 1, 1, random) == 10
        trees.append(lattice.tree)
    np.testing.assert_array_equal(*trees)
