"""Regrets of moves: who makes only moves without regret routes as well as can be."""

from typing import Any

import numpy as np
import pytest
from conftest import examples
from hypothesis import assume, given
from hypothesis import strategies as st
from reference import contested, edge_number
from seeing import cheapest_tree, edge_costs, gcell, is_priced

from marouting import Engine, InputError, Net, Pin, Problem, Solution, evaluate
from marouting.batch.prices import UNIT, Negotiation
from marouting.game import NOBODY
from policies.generalist.regrets import MASKED, Regrets
from policies.routers.optimal import OptimalRouter

RULES: dict[str, Any] = {
    "turn_order": "sequential",
    "target": "tree",
    "next_pin": "nearest",
    "mask": {"visited": True},
}


def one_net(grid: tuple[int, int, int], *pins: tuple[int, int, int]) -> Problem:
    """A problem of one net, with room everywhere."""
    layers, net = grid[2], Net("n", 0, tuple(Pin(*pin) for pin in pins))
    room, ones, none = (9,) * layers, (1,) * layers, (0,) * layers
    return Problem(grid, room, room, (net,), ones, none, none)


def play(engine: Engine, solution: Solution | None, rng: np.random.Generator) -> Solution:
    """Plays a problem by moves without regret, drawn at random, leaving room for a solution."""
    regrets, out = Regrets(engine, margin=100), np.zeros((1, 6), np.int32)
    waiting = {n for n in range(engine.nets.shape[1]) if engine.tasks[0, n]}
    if solution is not None:
        regrets.expect(0, np.array(sorted(waiting)), solution, 1)
    while (n := int(engine.games["agent"][0])) != NOBODY:
        if n in waiting:
            waiting.remove(n)
            if solution is not None:
                regrets.expect(0, np.array([n]), solution, -1)
        who = np.array([0], np.int32), np.array([n], np.int32)
        regrets.write(*who, out)
        mask = engine.masks(*who)[0]
        best = np.flatnonzero(out[0] == 0)
        assert len(best)
        if (out[0] < MASKED).any():
            assert ((out[0] == MASKED) == (mask == 0)).all()
        engine.step(rng.choice(best, 1))
    assert not regrets.lessons.coming.any()
    return engine.solution()


@given(contested(max_nets=5), st.sampled_from(["forbidden", "allowed"]), st.integers(0, 1000))
def test_moves_without_regret_are_as_good_as_the_optimum(
    problem: Problem, overflow: str, seed: int
) -> None:
    """Whatever the order of the nets: each leaves the others the room that they need."""
    best = OptimalRouter().solve(problem)
    figures = evaluate(problem, best.solution)
    assume(best.report["status"] == "optimal" and figures.overflow == 0)
    assume(figures.connected)
    engine = Engine([problem], overflow=overflow, max_steps=1000, **RULES)
    played = evaluate(problem, play(engine, best.solution, np.random.default_rng(seed)))
    assert played.connected
    assert (played.overflow, played.wirelength) == (0, figures.wirelength)


@examples(15)
@given(contested(max_nets=4), st.integers(0, 1000))
def test_in_priced_rounds_a_net_gets_its_cheapest_tree(problem: Problem, seed: int) -> None:
    rules = RULES | {"rip_up": {"rounds": 6, "choose": "conflicts"}, "negotiation": Negotiation()}
    engine = Engine([problem], overflow="allowed", max_steps=1000, **rules)
    regrets, out = Regrets(engine, margin=100), np.zeros((1, 6), np.int32)
    rng, priced = np.random.default_rng(seed), 0
    while (n := int(engine.games["agent"][0])) != NOBODY:
        number, costs = engine.games["round"][0], edge_costs(engine, 0, n, None)
        first, end = engine.static.first[0, n : n + 2].tolist()
        pins = {gcell(engine, int(pin)) for task in engine.static.tasks[first:end] for pin in task}
        least = cheapest_tree(costs, pins) if is_priced(engine, 0) else None
        assert not engine.dynamic.used[0, n].any()  # with these rules nets walk one by one
        while True:
            regrets.write(np.array([0]), np.array([n]), out)
            engine.move(rng.choice(np.flatnonzero(out[0] == 0), 1))
            used = np.unpackbits(engine.dynamic.used[0, n], bitorder="little")
            edges = [edge for edge in costs if used[edge_number(problem, edge)]]
            engine.settle(everyone=False)
            games = engine.games
            if games["agent"][0] != n or games["round"][0] != number or games["just_ripped"][0]:
                break
        if least is not None:
            assert sum(costs[edge] or 0 for edge in edges) == pytest.approx(least)
            priced += 1
    assert priced >= int((engine.tasks > 0).sum())


@examples(15)
@given(
    st.lists(st.tuples(*[st.integers(0, 5)] * 2, st.integers(1, 2)), min_size=2, max_size=5),
    st.integers(0, 1000),
)
def test_a_net_alone_gets_its_cheapest_tree(pins: list[tuple[int, int, int]], seed: int) -> None:
    assume(len(set(pins)) > 1)
    problem = one_net((6, 6, 2), *pins)
    engine = Engine([problem], max_steps=1000, **RULES)
    solution = play(engine, None, np.random.default_rng(seed))
    best = OptimalRouter().route(problem)
    assert evaluate(problem, solution).wirelength == evaluate(problem, best).wirelength


def test_a_small_example_by_hand() -> None:
    """Two ways round a corner; on one of them the third pin is met."""
    problem = one_net((3, 3, 1), (0, 0, 1), (2, 0, 1), (2, 2, 1))
    engine = Engine([problem], **RULES | {"next_pin": "listed"})
    regrets, out = Regrets(engine), np.zeros((1, 6), np.int32)
    regrets.write(np.array([0]), np.array([0]), out)
    # From (2, 0) to (0, 0): straight it takes 2 edges and 2 for the third pin. By (2, 1) it takes 4
    # and 1.
    assert out[0].tolist() == [MASKED, 0, UNIT, MASKED, MASKED, MASKED]
    regrets.write(np.array([0]), np.array([NOBODY]), out)
    assert (out == MASKED).all()


@pytest.mark.parametrize("rules", [{"target": "pin"}, {"turn_order": "round_robin"}])
def test_other_games_are_refused(rules: dict[str, str]) -> None:
    problem = one_net((3, 3, 1), (0, 0, 1), (2, 0, 1))
    with pytest.raises(InputError, match=next(iter(rules))):
        Regrets(Engine([problem], **RULES | rules))
