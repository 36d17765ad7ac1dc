"""Policies that imitate a local rule."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marouting import Engine, scenarios
from marouting.game import NOBODY
from policies.experiment.anarchy import measure, rules_of
from policies.experiment.cloned import cloned, demonstrations
from policies.learned.config import load_config
from policies.learned.policy import TrainedPolicy
from policies.routers.local import LocalRouter

GATES = "gates-8x7-v0"


@pytest.mark.parametrize("name", [GATES, "online-8x8-v0"])
def test_a_rule_that_is_asked_plays_as_it_does_alone(name: str) -> None:
    rule, problems = LocalRouter(radius=3, price=2), scenarios.get(name).validation[:5]
    alone = rule.play(problems, rules_of(name))
    asked = Engine(problems, rules_of(name))
    rng = np.random.default_rng(0)
    while (turn := asked.games["agent"].astype(int)).max() != NOBODY:
        moves = rule.moves(asked, rng)
        playing = turn != NOBODY
        assert (moves[playing, turn[playing]] != NOBODY).all()
        asked.step(np.where(playing, moves[np.arange(len(problems)), turn], NOBODY))
    for m in range(len(problems)):
        assert asked.metrics(m) == alone.metrics(m)


def test_a_network_that_imitates_a_rule_costs_as_much(tmp_path: Path) -> None:
    rule = LocalRouter(radius=3)
    config = load_config(None, [f"env.scenario={GATES}", "learner.kind=ippo"])
    same = cloned(config, rule, tmp_path / "clone.pt", moves=20_000)
    assert same > 0.95
    scenario = scenarios.get(GATES)
    found = TrainedPolicy.load(tmp_path / "clone.pt").evaluate(GATES, "validation")
    assert found.cost == pytest.approx(measure(scenario, "validation", rule).cost, abs=0.08)


def test_demonstrations_are_choices() -> None:
    obs, masks, moves = demonstrations(GATES, LocalRouter(radius=3), 500, seed=1)
    assert len(obs) == len(masks) == len(moves) >= 500
    assert (masks.sum(-1) > 1).all()
    assert masks[np.arange(len(moves)), moves].all()


def test_demonstrations_are_of_nets_that_move() -> None:
    """Where nets arrive one by one, those that wait show nothing that was done."""
    steps: list[int] = []

    class Counting(LocalRouter):
        def moves(self, *given: Any) -> Any:
            steps.append(len(given[0].problems))
            return super().moves(*given)

    _, _, moves = demonstrations("online-8x8-v0", Counting(radius=3), 500, seed=1)
    assert 500 <= len(moves) <= sum(steps)
