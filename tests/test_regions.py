"""Chips cut into regions: what is cut, what is joined again, and what the router makes of it."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marouting import Problem, Solution, evaluate, generate
from marouting.problem.chip import Chip
from marouting.problem.grid import AXES
from policies.engines import Call
from policies.routers.astar import AStarRouter
from policies.routers.regions import RegionsOptions, RegionsRouter, router
from policies.routers.regions.cutting import (
    Box,
    Piece,
    chip_edges,
    cut,
    figures,
    joined,
    lines,
    work_inside,
)


class Here:
    """Makes calls in this process."""

    notes = None

    def share(self, value: Any) -> Any:
        return value

    def run(self, calls: Sequence[Call]) -> Iterator[dict[int, Any]]:
        for number, call in enumerate(calls):
            yield {number: call.function(*call.arguments)}


@pytest.fixture
def _here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts no processes."""
    monkeypatch.setattr(router, "opened", lambda *_: contextlib.nullcontext(Here()))


def chip(seed: int = 1, nets: int = 60) -> Problem:
    """Room for two regions, and edges with capacities of their own."""
    return generate(1, (20, 24, 3), nets=nets, max_pins=4, capacity=2, reduced_edges=9, seed=seed)[
        0
    ]


def routed(problem: Problem) -> Solution:
    """Every net joined, with nothing that joins nothing."""
    return AStarRouter().route(problem).pruned()


def priced(problem: Problem, seed: int = 0) -> np.ndarray:
    """A price for about half of the edges."""
    rng = np.random.default_rng(seed)
    price = np.maximum(rng.uniform(-1, 1, (*problem.grid, AXES)), 0).astype(np.float32)
    for axis in range(AXES):  # no edge leaves the chip
        price[(slice(None),) * axis + (-1, ..., axis)] = 0
    return price.reshape(-1)


def within(problem: Problem, box: Box, edge: int) -> bool:
    """Whether both ends of an edge are in a box, from coordinates alone."""
    at = [int(place) for place in np.unravel_index(edge // AXES, problem.grid)]
    there = list(at)
    there[edge % AXES] += 1
    return all(box.low <= end[box.axis] < box.high for end in (at, there))


def moved(problem: Problem, box: Box, piece: Piece, edge: int) -> int:
    """The number that an edge of the chip has in a piece."""
    at = [int(place) for place in np.unravel_index(edge // AXES, problem.grid)]
    at[box.axis] -= box.low
    return AXES * int(np.ravel_multi_index(at, piece.grid)) + edge % AXES


def as_it_was(solution: Solution, box: Box, piece: Piece, nets: np.ndarray) -> list[list[int]]:
    """Of every net of a piece the edges that join its pins in the solution, in its numbers.

    Looked for by walking along edges, one after another.
    """
    problem, found = piece.problem(), []
    for part, net in enumerate(nets.tolist()):
        own = [e for e in solution.edges[net].tolist() if within(solution.problem, box, e)]
        here = [moved(solution.problem, box, piece, edge) for edge in own]
        reached, grown, used = {int(problem.pin_gcells[part][0])}, True, set()
        while grown:
            grown = False
            for edge in here:
                ends = {edge // AXES, edge // AXES + int(problem.strides[edge % AXES])}
                if edge not in used and ends & reached:
                    used.add(edge)
                    reached |= ends
                    grown = True
        found.append(sorted(used))
    return found


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0, 1]), st.data())
def test_what_is_cut_joins_again(seed: int, axis: int, data: st.DataObject) -> None:
    """The routes in a box solve its problem, and put back they are what they were."""
    problem = chip(seed, nets=12)
    solution = routed(problem)
    low = data.draw(st.integers(0, problem.grid[axis] - 2))
    box = Box(axis, low, data.draw(st.integers(low + 2, problem.grid[axis])))
    piece, nets = cut(solution, priced(problem), box)
    if not len(nets):
        return
    own = piece.problem()
    edges = as_it_was(solution, box, piece, nets)
    there = Solution(own, [np.array(part, np.int64) for part in edges])
    assert evaluate(own, there).connected
    # With the same room: overflow of the same edges, counted in the whole and in the piece.
    for edge in {e for net in nets.tolist() for e in solution.edges[net].tolist()}:
        if within(problem, box, edge):
            assert own.capacity[moved(problem, box, piece, edge)] == problem.capacity[edge]
    net, edge = there.uses
    assert joined(solution, box, nets[net], edge.astype(np.int32)) == solution
    # With the same prices of the same edges.
    prices = priced(problem)
    paid = {edge: prices[edge] for edge in np.flatnonzero(prices) if within(problem, box, edge)}
    assert dict(zip(piece.priced.tolist(), piece.price, strict=True)) == {
        moved(problem, box, piece, edge): price for edge, price in paid.items()
    }
    assert chip_edges(problem, box, piece.priced).tolist() == list(paid)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_a_box_that_is_routed_anew_joins_all(seed: int) -> None:
    problem = chip(seed, nets=12)
    solution = routed(problem)
    axis, at = lines(solution, 2)
    box = Box(axis, 0, at[0])
    piece, nets = cut(solution, priced(problem), box)
    net, edge = AStarRouter().route(piece.problem()).uses
    other = joined(solution, box, nets[net], edge.astype(np.int32))
    found = evaluate(problem, other)
    assert found.connected
    assert (found.overflow, found.wirelength) == figures(other)
    outside = [[e for e in own.tolist() if not within(problem, box, e)] for own in solution.edges]
    assert outside == [
        [e for e in own.tolist() if not within(problem, box, e)] for own in other.edges
    ]


def test_lines_are_where_few_wires_cross() -> None:
    solution = routed(chip(2))
    problem = solution.problem
    axis, at = lines(solution, 2)
    assert 8 <= at[0] <= problem.grid[axis] - 8
    crossing = {}
    for line in range(1, problem.grid[axis]):
        boxes = Box(axis, 0, line), Box(axis, line, problem.grid[axis])
        uses = [edge for own in solution.edges for edge in own.tolist()]
        crossing[line] = sum(not any(within(problem, box, edge) for box in boxes) for edge in uses)
    near = [crossing[line] for line in (at[0] - 1, at[0] + 1)]
    assert crossing[at[0]] <= max(near)
    assert lines(solution, 99)[1] == lines(solution, 99)[1]
    assert len(lines(solution, 99)[1]) <= 2


def test_work_is_where_nets_meet() -> None:
    """Nets on full edges count ten times, by a count of every use."""
    solution = routed(chip(2, nets=200))
    problem = solution.problem
    use: dict[int, int] = {}
    for own in solution.edges:
        for edge in own.tolist():
            use[edge] = use.get(edge, 0) + 1
    full = {e for e, n in use.items() if e % AXES < 2 and n > problem.capacity[e]}
    assert full
    expected = [0, 0]
    for own in solution.edges:
        weight = 10 if full & set(own.tolist()) else 1
        for edge in own.tolist():
            expected[int(np.unravel_index(edge // AXES, problem.grid)[1] >= 7)] += weight
    assert work_inside(solution, [Box(1, 0, 7), Box(1, 7, 24)]).tolist() == expected


def test_a_layer_without_wires_stays_so() -> None:
    problem = chip()
    wires = np.array([[True, False], [False, True], [True, True]])
    lines_ = (np.arange(size + 1, dtype=np.int64) for size in problem.grid[:2])
    x, y = lines_
    object.__setattr__(problem, "chip", Chip(("a", "b", "c"), x, y, wires))
    piece, _ = cut(routed(problem), priced(problem), Box(0, 0, 10))
    found = piece.problem().chip
    assert found is not None
    np.testing.assert_array_equal(found.wires, wires)


@pytest.mark.usefixtures("_here")
@pytest.mark.parametrize("regions", [2, 3])
def test_the_router_joins_all(regions: int) -> None:
    """Steps never make a solution worse, and what is reported is what `evaluate` finds."""
    problem = generate(1, (40, 30, 2), nets=150, max_pins=4, capacity=2, reduced_edges=0)[0]
    options = RegionsOptions(regions=regions, seconds=0.2)
    found = RegionsRouter(options).solve(problem)
    judged = evaluate(problem, found.solution)
    assert judged.connected
    assert len(found.lines) == regions - 1
    kinds = [step.kind for step in found.history]
    assert kinds == ["patterns", *["regions", "strips"] * 2]
    steps = [(step.overflow, step.wirelength) for step in found.history]
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] < steps[0]
    assert (judged.overflow, judged.wirelength) <= steps[-1]
    assert found.report["sent_bytes"] > 0
    assert found.stop == "done"


@pytest.mark.usefixtures("_here")
def test_the_router_can_be_watched_and_stopped() -> None:
    router_of = RegionsRouter(RegionsOptions(seconds=0.1))
    said: list[str] = []

    def watch(line: str) -> bool:
        said.append(line)
        return True

    router_of.watch = watch
    found = router_of.solve(chip())
    assert found.stop == "asked"
    assert said[0].startswith("regions, 1 of 2; best: overflow")
    assert len(said) == 1
    assert evaluate(chip(), found.solution).connected


def test_a_small_problem_is_routed_in_one_piece() -> None:
    problem = generate(1, nets=10)[0]
    found = RegionsRouter(RegionsOptions(seconds=0.1)).solve(problem)
    assert (found.stop, found.lines) == ("small", ())
    assert evaluate(problem, found.solution).connected
