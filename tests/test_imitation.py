"""Imitation and the generalist: a network learns from regrets, and routes what it never saw."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from marouting import InputError, evaluate, generate
from marouting.config import build
from policies.generalist import SHIPPED
from policies.generalist.imitation import imitation_loss
from policies.generalist.router import GeneralistOptions, GeneralistRouter
from policies.learned.config import Config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run, problems_of, trainer_of
from policies.learned.trainer import Trainer
from policies.results.run_folder import POLICY
from policies.routers.pathfinder import PathfinderRouter

ENV: dict[str, Any] = {
    "agents": "single",
    "observation": {"kind": "outlook", "radius": 1},
    "overflow": "allowed",
    "target": "tree",
    "next_pin": "nearest",
    "mask": {"visited": True},
    "rip_up": {"rounds": 1},
}
SOURCE: dict[str, Any] = {
    "grid": [6, 6, 2],
    "nets": 12,
    "max_pins": 4,
    "capacity": 4,
    "reduced_edges": 0,
    "seed": None,
    "least": {"grid": [4, 4, 2], "nets": 6, "max_pins": 2, "capacity": 2},
}
LEARNER: dict[str, Any] = {
    "kind": "imitation",
    "network": {"hidden": [32, 32]},
    "memory": 8000,
    "batch": 256,
}


def config(**changed: Any) -> Config:
    train = {"shared": True, "games": 4, "episodes": 40, "validation": 3, "evaluate_every": 20}
    return build(
        Config,
        {
            "env": {**ENV, "problem": SOURCE, **changed.get("env", {})},
            "learner": {**LEARNER, **changed.get("learner", {})},
            "train": {**train, **changed.get("train", {})},
        },
    )


def trainer(given: Config) -> Trainer:
    training = trainer_of(*problems_of(given), given)
    assert isinstance(training, Trainer)
    return training


def finish(training: Trainer) -> list[Any]:
    return [episode for episodes in training.run() for episode in episodes]


PRICED: dict[str, Any] = {
    "env": {"rip_up": {"rounds": 3, "choose": "conflicts"}},
    "train": {"negotiation": {}},
}


@pytest.mark.parametrize("more", [pytest.param({}, marks=pytest.mark.slow), PRICED])
def test_it_goes_on_from_a_state(more: dict[str, Any]) -> None:
    whole = trainer(config(**more))
    expected = finish(whole)
    first, found = trainer(config(**more)), []
    for episodes in first.run():
        found += episodes
        if len(found) >= 17:
            break
    state = first.state()
    for part in ("training", "trainer"):
        state[part] = {name: tensor.clone() for name, tensor in state[part].items()}
    second = trainer(config(**more))
    second.load_state(state, "memory")
    assert found + finish(second) == expected
    assert torch.equal(second.learner.networks.flat, whole.learner.networks.flat)
    assert whole.learner.updates[0] > 50


@pytest.mark.slow
def test_what_it_learns_routes_larger_problems(tmp_path: Path) -> None:
    """Better than without learning, on problems of another size than it was trained on."""
    train = {"episodes": 240, "evaluate_every": 80, "figures": False, "tensorboard": False}
    learner = {"reuse": 12, "learning_rate": 0.003}
    given = replace(config(train=train, learner=learner), out=str(tmp_path / "run"))
    Run(given).execute()
    weights = str(tmp_path / "run" / POLICY)
    problems = generate(4, (8, 8, 2), nets=20, max_pins=4, seed=5)
    total = {}
    for policy in ("network", "greedy"):
        # In no time, so that nobody walks along Steiner trees.
        given_ = {"weights": weights, "policy": policy, "rounds": 0, "seconds": 0}
        options = build(GeneralistOptions, given_)
        figures = [evaluate(p, GeneralistRouter(options).route(p)) for p in problems]
        assert all(each.connected for each in figures)
        total[policy] = np.sum([(each.overflow, each.wirelength) for each in figures], axis=0)
    assert tuple(total["network"]) < tuple(total["greedy"])


@pytest.mark.parametrize("plain", [0.0, 0.5, 1.0])
def test_a_share_of_the_episodes_begins_plain(plain: float) -> None:
    """The others begin at prices."""
    train = {"games": 64, "episodes": 64, **PRICED["train"]}
    training = trainer(config(env=PRICED["env"], learner={"plain": plain}, train=train))
    next(training.run())
    games = training.player.engine.games
    first = (games["round"] == 0) & (games["steps"] > 0)
    assert first.sum() > 32
    assert np.mean(games["plain"][first] == 1) == pytest.approx(plain, abs=0.2 * (plain % 1 > 0))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {
                "train": {"shared": False, "games": None, "validation": None},
                "env": {"problem": {"nets": 5, "count": 2, "seed": 0}},
            },
            "train.shared",
        ),
        ({"env": {"agents": "multi"}}, "single"),
        ({"env": {"target": "pin"}}, "target"),
        ({"env": {"rip_up": {"choose": "agents"}}}, "rip_up.choose"),
        ({"learner": {"masking": False}}, "masking"),
        ({"learner": {"batch": 10_000}}, "batch"),
        ({"learner": {"reuse": 1e300}}, "reuse: expected 0 to 1000"),
        ({"learner": {"memory": 10**9}}, "learner.memory: 1000000000 states of"),
        ({"learner": {"expert_fraction": 2}}, "expert_fraction"),
        ({"learner": {"plain": 2}}, "plain"),
    ],
)
def test_other_games_are_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        trainer(config(**changed))


def test_the_loss_by_hand() -> None:
    """Two best moves among three; the others are masked."""

    def scores(obs: torch.Tensor) -> torch.Tensor:
        return obs

    obs = torch.tensor([[0.0, 0.0, 0.0, 9.0, 9.0, 9.0]])
    regrets = torch.tensor([[0.0, 0.0, 7.0, -1.0, -1.0, -1.0]])
    view: Any = scores
    loss = imitation_loss(view, obs, regrets, 0.5)
    assert loss.item() == pytest.approx(-np.log(2 / 3) + 0.5 * 4 / 3)


@pytest.mark.parametrize("policy", ["greedy", "random"])
def test_the_search_without_learning(policy: str) -> None:
    problem = generate(1, nets=40, max_pins=4, seed=5)[0]
    single = GeneralistOptions(policy=policy, rounds=0)  # type: ignore[arg-type]
    longer = GeneralistOptions(policy=policy, rounds=40, seconds=None)  # type: ignore[arg-type]
    first, more, again = (
        GeneralistRouter(options).solve(problem) for options in (single, longer, longer)
    )
    figures = [evaluate(problem, routed.solution) for routed in (first, more, again)]
    assert all(each.connected for each in figures)
    assert figures[1] == figures[2]
    assert more.report["rounds"] == 40
    worst, best = ((each.overflow, each.wirelength) for each in figures[:2])
    assert best < worst
    best_known = evaluate(problem, PathfinderRouter().route(problem))
    assert best >= (best_known.overflow, best_known.wirelength)


@pytest.mark.parametrize(
    "given",
    [
        {"rounds": -1},
        {"exact_pins": 1},
        {"seconds": -1},
        {"temperature": -1},
        {"neighbours": -1},
        {"patience": -1},
    ],
)
def test_options_out_of_range(given: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        GeneralistOptions(**given)


# --- the weights that are shipped -----------------------------------------------------------------


def test_who_watches_may_end_the_rip_ups() -> None:
    problem = generate(1, nets=30, max_pins=5, seed=3)[0]
    router = GeneralistRouter(GeneralistOptions(policy="greedy", seconds=60.0))
    lines: list[str] = []

    def watch(line: str) -> bool:
        lines.append(line)
        return len(lines) == 2

    router.watch = watch
    found = evaluate(problem, router.route(problem))
    assert found.connected
    assert len(lines) == 2
    shown = re.fullmatch(r"round \d+; overflow (\d+), wirelength (\d+)", lines[1])
    assert shown is not None
    assert (found.overflow, found.wirelength) <= (int(shown[1]), int(shown[2]))


def test_the_shipped_weights_route_what_they_never_saw() -> None:
    """On grids of other shapes: all nets joined, no overflow, within a per cent of negotiation."""
    router = GeneralistRouter(GeneralistOptions(seconds=None, rounds=2))
    total = np.zeros(2)
    for grid, capacity in (((9, 7, 2), 6), ((20, 5, 2), 9), ((13, 13, 4), 5)):
        for problem in generate(2, grid, nets=25, max_pins=5, capacity=capacity, seed=77):
            mine, best = (
                evaluate(problem, each.route(problem)) for each in (router, PathfinderRouter())
            )
            assert mine.connected
            assert (mine.overflow, best.overflow) == (0, 0)
            total += mine.wirelength, best.wirelength
    assert total[0] < 1.01 * total[1]


def test_the_card_of_the_shipped_weights_is_theirs() -> None:
    assert SHIPPED.stat().st_size < 2_000_000
    card = SHIPPED.with_name("README.md").read_text(encoding="utf-8")
    assert hashlib.sha256(SHIPPED.read_bytes()).hexdigest() in card
    assert TrainedPolicy.load(SHIPPED).origin.split()[2] in card  # after so many episodes
