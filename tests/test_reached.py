"""Pins that can be reached in several Gcells: which one a route, or a guide, reaches.

The oracle is networkx: routes as graphs of Gcells.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import networkx as nx
import numpy as np
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st

from marouting import Problem, Solution, evaluate, generate
from marouting.problem.chip import Places
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.segments import with_pins_at


def with_places(seed: int, pins: int) -> tuple[Problem, list[list[int]]]:
    """A problem of one net, each of whose pins has shapes in one to three Gcells of layer 1."""
    rng = np.random.default_rng(seed)
    (problem,) = generate(1, (4, 4, 2), 1, max_pins=pins, capacity=1, reduced_edges=6, seed=seed)
    net = problem.nets[0]
    cells = rng.permutation(16)[: len(net.pins)] * 2
    places = [[int(own)] for own in cells]
    for own in places:
        own += (2 * rng.permutation(16)[: rng.integers(3)]).tolist()
    counts = np.cumsum([0, *map(len, places)])
    table = Places(np.array([0, len(places)]), counts, np.concatenate(places))
    chip = replace(problem.chip_or_default, places=table)
    return replace(with_pins_at(problem, cells), chip=chip), places


def graph_of(problem: Problem, edges: list[int]) -> "nx.Graph[int]":
    return nx.Graph(zip(*np.stack(problem.topology.ends(np.array(edges))).tolist(), strict=True))


@examples(60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(0, 2**32 - 1))
def test_pins_are_joined_if_one_part_touches_all(seed: int, pins: int, drawn: int) -> None:
    problem, places = with_places(seed, pins)
    edges = np.flatnonzero(problem.topology.exists.reshape(-1))
    rng = np.random.default_rng(drawn)
    used = np.sort(rng.permutation(edges)[: rng.integers(1, len(edges))]).tolist()
    solution = Solution(problem, [used])
    judged = evaluate(problem, solution)
    parts = list(nx.connected_components(graph_of(problem, used)))
    parts += [{cell} for cell in set.intersection(*map(set, places))]  # no edge is needed
    assert judged.connected == any(all(part & {*own} for own in places) for part in parts)
    moved = solution.at_reached_pins()
    again = evaluate(moved.problem, moved)
    assert again == judged
    pruned = evaluate(moved.problem, moved.pruned())
    assert (pruned.connected, pruned.joined) == (judged.connected, judged.joined)


@examples(60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
def test_a_guide_reads_back_without_edges_that_its_routes_did_not_need(
    seed: int, pins: int
) -> None:
    problem, places = with_places(seed, pins)
    edges = np.flatnonzero(problem.topology.exists.reshape(-1))
    edges = edges[(edges % AXES == VIA_AXIS) | (problem.capacity[edges] > 0)]
    graph = graph_of(problem, edges.tolist())
    rng = np.random.default_rng(seed)
    # Each pin is reached in any of its Gcells.
    ends = [int(rng.choice(own)) for own in places]
    cells = set(ends[:1])
    for end in ends[1:]:
        if not nx.has_path(graph, ends[0], end):
            return
        cells |= {*nx.shortest_path(graph, ends[0], end)}
    near, far = problem.topology.ends(edges)
    number = dict(zip(zip(near.tolist(), far.tolist(), strict=True), edges.tolist(), strict=True))
    tree = nx.minimum_spanning_edges(graph.subgraph(cells), data=False)
    used = sorted(number[min(pair), max(pair)] for pair in tree)
    solution = Solution(problem, [used])
    with TemporaryDirectory() as folder:
        file = Path(folder) / "a.guide"
        solution.write(file)
        read = Solution.read(file, problem)
    judged = evaluate(problem, read)
    assert judged.connected
    inside = read.uses[1][read.uses[1] % AXES != VIA_AXIS]
    assert (problem.capacity[inside] > 0).all()
