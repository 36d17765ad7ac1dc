"""The rows of trained policies, and policies that imitate a local rule."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from marouting import Engine, scenarios
from marouting.game import NOBODY
from policies.experiment import trained
from policies.experiment.anarchy import measure, rules_of
from policies.experiment.cloned import cloned, demonstrations
from policies.learned.config import load_config
from policies.learned.policy import TrainedPolicy
from policies.routers.local import LocalRouter

GATES = "gates-8x7-v0"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder in which everything happens; trainings are tiny."""
    monkeypatch.chdir(tmp_path)
    small = ("learner.rollout=1024", "learner.minibatch=512", "train.games=8")
    rows = {
        "ippo-team": (*trained.ROWS["ippo-team"], *small),
        "ippo-team-cloned": (*trained.ROWS["ippo-team-cloned"], *small),
    }
    monkeypatch.setattr(trained, "ROWS", rows)
    return tmp_path


def run(*arguments: str) -> Any:
    return CliRunner().invoke(trained.main, [*arguments, "--steps", "2000", "--seeds", "1"])


@pytest.mark.usefixtures("here")
def test_rows_are_those_of_the_saved_policy() -> None:
    outcome = run(GATES)
    assert outcome.exit_code == 0, outcome.output
    rows = trained.read_rows("trained.csv")
    assert [(row["row"], row["split"]) for row in rows] == [
        (name, split) for name in trained.ROWS for split in ("validation", "test")
    ]
    for row in rows:
        assert 2000 <= int(row["agent_steps"]) < 4000
        policy = TrainedPolicy.load(f"runs/cooperation/{GATES}.{row['row']}.2000.0/policy.pt")
        result = policy.evaluate(GATES, row["split"])  # type: ignore[arg-type]
        assert float(row["cost"]) == round(result.cost, 4)
        assert float(row["solved"]) == round(result.solved, 4)
    curves = trained.read_rows("curves.csv")
    assert {row["row"] for row in curves} == set(trained.ROWS)
    assert float(curves[-1]["validation_cost"]) > 1

    # A cloned start shows: after so few steps it is what tells the two.
    costs = {row["row"]: float(row["cost"]) for row in rows if row["split"] == "test"}
    assert costs["ippo-team-cloned"] < costs["ippo-team"] - 0.3

    again = run(GATES)
    assert again.exit_code == 0
    assert trained.read_rows("trained.csv") == rows  # nothing is trained twice
    table = run("--table").output
    assert f"| `{GATES}` | `ippo-team` |" in table
    assert f"{costs['ippo-team']:.3f}" in table


def test_what_the_command_refuses(here: Path) -> None:
    for arguments, said in (
        (["nowhere-v0"], "scenario: expected one of"),
        ([GATES, "--row", "vdn"], "--row: expected one of ippo-team, ippo-team-cloned"),
    ):
        outcome = run(*arguments)
        assert outcome.exit_code == 2
        assert said in outcome.output
        assert not (here / "docs").exists()


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
