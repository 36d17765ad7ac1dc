"""Two-pin tasks against networkx's minimum spanning trees."""

import itertools
from dataclasses import replace

import networkx as nx
import numpy as np
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st
from reference import Gcell, contested, distance, gcell_of, pin_gcells
from strategies import problems

from marouting import Net, Pin, Problem
from marouting.trees.decomposition import two_pin_tasks

any_problem = st.one_of(problems(), contested(max_nets=10, max_pins=12))


def tasks_of(problem: Problem) -> list[list[tuple[Gcell, Gcell]]]:
    """For each net its tasks, in order."""
    tasks: list[list[tuple[Gcell, Gcell]]] = [[] for _ in problem.nets]
    for net, start, target in two_pin_tasks(problem).tolist():
        tasks[net].append((gcell_of(problem, start), gcell_of(problem, target)))
    return tasks


@examples(100)
@given(any_problem)
def test_tasks_are_a_minimum_spanning_tree_of_the_pins(problem: Problem) -> None:
    for net, tasks in enumerate(tasks_of(problem)):
        cells = pin_gcells(problem, net)
        assert len(tasks) == len(cells) - 1  # none where all pins lie in one Gcell
        tree = nx.Graph(tasks)
        tree.add_nodes_from(cells)
        assert set(tree) == set(cells)
        assert nx.is_tree(tree)
        graph = nx.Graph()
        graph.add_nodes_from(cells)
        graph.add_weighted_edges_from(
            (a, b, distance(a, b)) for a, b in itertools.combinations(cells, 2)
        )
        shortest = nx.minimum_spanning_tree(graph).size(weight="weight")
        assert sum(distance(a, b) for a, b in tasks) == shortest


@given(any_problem)
def test_which_tree_and_in_which_order(problem: Problem) -> None:
    """Of equally distant pairs the first one counts; branches to later pins come first."""
    for net, tasks in enumerate(tasks_of(problem)):
        cells = pin_gcells(problem, net)
        graph = nx.Graph()
        pairs = list(itertools.combinations(range(len(cells)), 2))
        for rank, (a, b) in enumerate(pairs):
            graph.add_edge(a, b, weight=distance(cells[a], cells[b]) * len(pairs) + rank)
        tree = nx.minimum_spanning_tree(graph)
        expected, queue, reached = [], [0], {0}
        for pin in queue:
            for branch in sorted(
                set(tree[pin]) - reached if pin in tree else (), key=lambda b: (b < pin, b)
            ):
                expected.append((cells[pin], cells[branch]))
                queue.append(branch)
                reached.add(branch)
        assert tasks == expected


@given(any_problem)
def test_every_task_starts_at_a_pin_already_reached(problem: Problem) -> None:
    for net, tasks in enumerate(tasks_of(problem)):
        reached = set(pin_gcells(problem, net)[:1])
        for start, target in tasks:
            assert start in reached
            assert target not in reached
            reached.add(target)


@given(any_problem)
def test_form_of_the_table(problem: Problem) -> None:
    table = two_pin_tasks(problem)
    assert table.dtype == np.int32
    assert table.shape[1:] == (3,)
    assert (np.diff(table[:, 0]) >= 0).all()
    np.testing.assert_array_equal(table, two_pin_tasks(replace(problem)))


@given(any_problem, st.randoms(use_true_random=False))
def test_tasks_of_a_net_depend_on_its_own_pins_alone(problem: Problem, random: object) -> None:
    """A net's tasks stay the same among other nets, in another order."""
    order = list(range(len(problem.nets)))
    random.shuffle(order)  # type: ignore[attr-defined]
    kept = order[: max(1, len(order) // 2)]
    few = replace(problem, nets=tuple(problem.nets[net] for net in kept))
    tasks = tasks_of(problem)
    assert tasks_of(few) == [tasks[net] for net in kept]


def test_by_hand() -> None:
    nets = (
        Net("dot", 0, (Pin(4, 4, 1), Pin(4, 4, 1))),
        # The second pin is far, the third lies between, the fourth repeats the first.
        Net("line", 1, (Pin(0, 0, 1), Pin(4, 0, 1), Pin(2, 0, 1), Pin(0, 0, 1))),
        # Straight above one another: a via is a step like any other.
        Net("stack", 2, (Pin(1, 1, 3), Pin(1, 1, 1), Pin(1, 3, 1))),
    )
    problem = Problem((5, 5, 3), (1,) * 3, (1,) * 3, nets, (1,) * 3, (0,) * 3, (0,) * 3)
    assert tasks_of(problem) == [
        [],
        [((0, 0, 0), (2, 0, 0)), ((2, 0, 0), (4, 0, 0))],
        [((1, 1, 2), (1, 1, 0)), ((1, 1, 0), (1, 3, 0))],
    ]
