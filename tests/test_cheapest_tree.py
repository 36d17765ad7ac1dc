"""Cheapest trees where nets negotiate, held against Dreyfus and Wagner in plain Python."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import contested, edge_number
from seeing import cheapest_tree, edge_costs, gcell, is_priced

from marouting import Engine, Problem, evaluate, generate
from marouting.batch.prices import Negotiation
from marouting.config import InputError, build
from marouting.game import NOBODY
from policies.generalist.cheapest_tree import make_trees, move_on_tree, plan_tree
from policies.generalist.router import GeneralistOptions, GeneralistRouter

RULES: dict[str, Any] = {
    "turn_order": "sequential",
    "target": "tree",
    "mask": {"visited": True},
    "overflow": "allowed",
    "rip_up": {"rounds": 6, "choose": "conflicts"},
    "negotiation": Negotiation(),
    "max_steps": 1000,
}


@given(contested(max_nets=4), st.sampled_from(["listed", "nearest"]), st.integers(0, 2**30))
def test_agents_walk_along_cheapest_trees(problem: Problem, next_pin: str, seed: int) -> None:
    engine = Engine([problem], next_pin=next_pin, **RULES)
    trees, rng, walked = make_trees(engine, 5), np.random.default_rng(seed), 0
    while (n := int(engine.games["agent"][0])) != NOBODY:
        number, again = (engine.games[name][0] for name in ("round", "reroutes"))
        costs = edge_costs(engine, 0, n, None)
        if not is_priced(engine, 0):  # an edge where the net would overflow: as dear as can be
            costs = {edge: cost if cost == 1 else 60 for edge, cost in costs.items()}
        first, end = engine.static.first[0, n : n + 2].tolist()
        pins = {gcell(engine, int(pin)) for task in engine.static.tasks[first:end] for pin in task}
        assert not engine.dynamic.used[0, n].any()
        known = engine.static, engine.dynamic, trees
        assert plan_tree(*known, 0, n, 5, 100, int(rng.integers(2**30)))
        while True:
            move = move_on_tree(engine.static, engine.dynamic, trees, 0, n)
            assert move != NOBODY
            assert engine.masks(*engine.pairs(False))[0, move]
            engine.move(np.array([move]))
            used = np.unpackbits(engine.dynamic.used[0, n], bitorder="little")
            edges = [edge for edge in costs if used[edge_number(problem, edge)]]
            engine.settle(everyone=False)
            game = engine.games[0]
            if (game["agent"], game["round"], game["reroutes"]) != (n, number, again):
                break
        cost = sum(costs[edge] or 0 for edge in edges)
        assert cost == pytest.approx(cheapest_tree(costs, pins))
        walked += 1
    assert walked >= int((engine.tasks > 0).sum())


def test_too_many_pins_or_too_far_apart() -> None:
    """Then there is no tree, and nobody is moved."""
    few, far = generate(1, (5, 5, 2), nets=1, max_pins=5, seed=1)[0], (120, 120, 2)
    for problem, most, found in (
        (few, 9, True),
        (few, 2, len(few.nets[0].pins) <= 2),
        (generate(1, far, nets=1, max_pins=5, seed=3)[0], 9, False),
    ):
        engine = Engine([problem], **RULES)
        trees = make_trees(engine, most)
        assert plan_tree(engine.static, engine.dynamic, trees, 0, 0, most, 3, 0) == found
        move = move_on_tree(engine.static, engine.dynamic, trees, 0, 0)
        assert (move != NOBODY) == found


@pytest.mark.parametrize("exact_pins", [-1, 1, 10])
def test_options_out_of_range(exact_pins: int) -> None:
    with pytest.raises(InputError, match="exact_pins"):
        build(GeneralistOptions, {"exact_pins": exact_pins})


def test_the_search_gains_from_them() -> None:
    """After the same rounds the routes are shorter, even without a network."""
    problems = generate(6, (8, 8, 2), nets=40, max_pins=5, capacity=7, seed=11)
    total = {}
    for exact_pins in (0, 6):
        options = GeneralistOptions(policy="greedy", seconds=None, rounds=40, exact_pins=exact_pins)
        figures = [evaluate(p, GeneralistRouter(options).route(p)) for p in problems]
        assert all(each.connected for each in figures)
        total[exact_pins] = np.sum([(each.overflow, each.wirelength) for each in figures], axis=0)
    assert tuple(total[6]) < tuple(total[0])
