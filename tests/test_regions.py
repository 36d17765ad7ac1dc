"""Chips cut into regions: what is cut, what is joined again, and what the router makes of it."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from marouting import Problem, Solution, evaluate, generate
from marouting.problem.chip import Chip
from marouting.problem.grid import AXES
from policies.engines import Call
from policies.routers.astar import AStarRouter
from policies.routers.regions import RegionsOptions, RegionsRouter, router
from policies.routers.regions.cutting import (
    Box,
    Division,
    Piece,
    chip_edges,
    cut,
    figures,
    joined,
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


def division(solution: Solution, axis: int, regions: int, reach: int) -> Division:
    """One whose regions reach so far beyond their lines."""
    return Division.even(solution, axis, regions)._replace(reach=reach)


CUTS = (st.integers(0, 1000), st.sampled_from([0, 1]), st.sampled_from([2, 3]), st.integers(1, 9))
"""Seed, axis, regions, reach."""


@given(*CUTS)
def test_what_is_cut_joins_again(seed: int, axis: int, regions: int, reach: int) -> None:
    """The routes of a region solve its problem, and put back they are what they were."""
    problem = chip(seed, nets=12)
    solution = routed(problem)
    parts = division(solution, axis, regions, reach)
    prices = priced(problem)
    for region in range(len(parts.work)):
        box = parts.box(region, problem.grid[axis])
        piece, nets = cut(solution, prices, parts, region)
        assert set(parts.owner[nets].tolist()) <= {region}
        if not len(nets):
            continue
        own = piece.problem()
        edges = as_it_was(solution, box, piece, nets)
        there = Solution(own, [np.array(part, np.int64) for part in edges])
        assert evaluate(own, there).connected
        for edge in {e for net in nets.tolist() for e in solution.edges[net].tolist()}:
            if within(problem, box, edge):
                assert own.capacity[moved(problem, box, piece, edge)] == problem.capacity[edge]
        net, edge = there.uses
        assert joined(solution, parts, {region: (nets[net], edge.astype(np.int32))}) == solution
        # With the same prices of the same edges.
        paid = {edge: prices[edge] for edge in np.flatnonzero(prices) if within(problem, box, edge)}
        assert dict(zip(piece.priced.tolist(), piece.price, strict=True)) == {
            moved(problem, box, piece, edge): price for edge, price in paid.items()
        }
        assert chip_edges(problem, box, piece.priced).tolist() == list(paid)


def tracks_over(piece: Piece, solution: Solution) -> int:
    """The overflow of a region with what others have taken, beyond what they cause alone."""
    problem, taken = piece.problem(), {}
    taken = dict(zip(piece.shared.tolist(), piece.taken.tolist(), strict=True))
    over = 0
    for edge, use in zip(*(part.tolist() for part in solution.used_edges), strict=True):
        if edge % AXES < 2:
            over += max(use + taken.get(edge, 0) - int(problem.capacity[edge]), 0)
    return over


@given(*CUTS)
def test_what_regions_find_fits_together(seed: int, axis: int, regions: int, reach: int) -> None:
    """Each has its share of the tracks, so that all together overflow no more than each alone."""
    problem = chip(seed)
    solution = routed(problem)
    parts = division(solution, axis, regions, reach)
    found, now, then = {}, 0, 0
    for region in range(len(parts.work)):
        piece, nets = cut(solution, priced(problem), parts, region)
        own = piece.problem()
        now += tracks_over(
            piece, Solution.of_uses(own, piece.net.astype(np.int64), piece.edge.astype(np.int64))
        )
        routes = AStarRouter().route(own)
        then += tracks_over(piece, routes)
        net, edge = routes.uses
        found[region] = nets[net], edge.astype(np.int32)
        assert piece.taken.min(initial=1) > 0
        full = own.capacity[piece.shared]
        assert (piece.taken <= full).all()
    before, _ = figures(solution)
    after = joined(solution, parts, found)
    judged = evaluate(problem, after)
    assert judged.connected
    assert (judged.overflow, judged.wirelength) == figures(after)
    assert now <= before  # nets that nobody moves may overflow, too
    assert judged.overflow <= then + before - now


def test_a_line_parts_the_tracks_that_are_free() -> None:
    """Half of them at the line, all of them farther away than regions reach."""
    problem = generate(1, (32, 10, 2), nets=2, max_pins=2, capacity=8, reduced_edges=0)[0]
    nothing = Solution(problem, [np.empty(0, np.int64)] * 2)
    parts = Division(0, (16,), 4, np.array([0, 1]), np.ones(2))
    left = 8 * parts.share_upto(0, np.arange(32))
    assert left.tolist() == [8] * 12 + [7.5, 6.5, 5.5, 4.5, 3.5, 2.5, 1.5, 0.5] + [0] * 12
    may = np.zeros((2, 32), np.int64)
    for region, box in enumerate((Box(0, 0, 20), Box(0, 12, 32))):
        assert parts.box(region, 32) == box
        piece, _ = cut(nothing, np.zeros(problem.topology.edges, np.float32), parts, region)
        taken = np.zeros(np.prod(piece.grid) * AXES, np.int64)
        taken[piece.shared] = piece.taken
        along_x = taken.reshape(*piece.grid, AXES)[:-1, 3, 0, 0]  # the last one leaves the box
        may[region, box.low : box.high - 1] = 8 - along_x
    np.testing.assert_array_equal(may.sum(axis=0)[:-1], 8)
    np.testing.assert_array_equal(may[0], np.floor(left))


def test_lines_part_the_work() -> None:
    """Nets on full edges count fifty times, by a count of every use."""
    solution = routed(chip(2, nets=200))
    problem = solution.problem
    use: dict[int, int] = {}
    for own in solution.edges:
        for edge in own.tolist():
            use[edge] = use.get(edge, 0) + 1
    full = {e for e, n in use.items() if e % AXES < 2 and n > problem.capacity[e]}
    assert full
    parts = Division.even(solution, 1, 2)
    (line,) = parts.lines
    assert 8 <= line <= 16
    expected, upto = [0, 0], [0] * 24
    for pins, own in zip(problem.pin_gcells, solution.edges, strict=True):
        weight = len(own) * (50 if full & set(own.tolist()) else 1)
        rows = [int(np.unravel_index(pin, problem.grid)[1]) for pin in pins]
        middle = (min(rows) + max(rows)) // 2
        expected[int(middle >= line)] += weight
        upto[middle] += weight
    assert parts.work.tolist() == expected
    assert sum(upto[: line - 1]) < sum(expected) / 2 <= sum(upto[:line])
    assert len(Division.even(solution, 1, 99).lines) == 2


def test_a_layer_without_wires_stays_so() -> None:
    problem = chip()
    wires = np.array([[True, False], [False, True], [True, True]])
    lines_ = (np.arange(size + 1, dtype=np.int64) for size in problem.grid[:2])
    x, y = lines_
    object.__setattr__(problem, "chip", Chip(("a", "b", "c"), x, y, wires))
    solution = routed(problem)
    piece, _ = cut(solution, priced(problem), Division.even(solution, 0, 2), 0)
    found = piece.problem().chip
    assert found is not None
    np.testing.assert_array_equal(found.wires, wires)


def test_the_first_line_is_where_few_nets_on_full_edges_cross() -> None:
    """Of all lines near the middle of the chip, by a count of every use."""
    solution = routed(chip(2, nets=200))
    problem = solution.problem
    use = [e for own in solution.edges for e in own.tolist() if e % AXES < 2]
    full = {e for e in use if use.count(e) > problem.capacity[e]}
    crossing = {}
    for axis in (0, 1):
        size = problem.grid[axis]
        for line in range(round(size * 7 / 16), round(size * 9 / 16)):
            boxes = Box(axis, 0, line), Box(axis, line, size)
            uses = [e for own in solution.edges if full & set(own.tolist()) for e in own.tolist()]
            crossing[axis, line] = sum(
                not any(within(problem, box, edge) for box in boxes) for edge in uses
            )
    parts = Division.calm(solution, [0, 1], 2)
    assert crossing[parts.axis, parts.lines[0]] == min(crossing.values())
    assert Division.calm(solution, [1], 2).axis == 1
    assert len(Division.calm(solution, [0, 1], 99).lines) == 2
    assert len(parts.work) == 2


@pytest.mark.usefixtures("_here")
@pytest.mark.parametrize("regions", [2, 3])
def test_the_router_joins_all(regions: int) -> None:
    """Steps never make a solution worse, and what is reported is what `evaluate` finds."""
    problem = generate(1, (40, 30, 2), nets=150, max_pins=4, capacity=2, reduced_edges=0)[0]
    options = RegionsOptions(regions=regions, seconds=0.2)
    found = RegionsRouter(options).solve(problem)
    judged = evaluate(problem, found.solution)
    assert judged.connected
    kinds = [step.kind for step in found.history]
    assert kinds[0] == "patterns"
    assert kinds[1:3] == ["calm", "even"]
    assert {len(step.lines) for step in found.history[1:]} == {regions - 1}
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
    assert said[0].startswith("calm lines, 1 of 2 regions; best: overflow")
    assert len(said) == 1
    assert evaluate(chip(), found.solution).connected


def test_a_small_problem_is_routed_in_one_piece() -> None:
    problem = generate(1, nets=10)[0]
    found = RegionsRouter(RegionsOptions(seconds=0.1)).solve(problem)
    assert (found.stop, found.history[-1].lines) == ("small", ())
    assert evaluate(problem, found.solution).connected
