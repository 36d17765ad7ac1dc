"""Rewards for nets that share add up to what happened, in every interface and any mixture."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from marouting import InputError, generate, global_routing_v0
from marouting.env.single import GlobalRoutingSingle
from marouting.vector import BatchEnv
from policies.learned.config import load_config
from policies.learned.trainer import Trainer

plain = {
    "seed": st.integers(0, 1000),
    "overflow": st.sampled_from(["forbidden", "allowed"]),
    "turn_order": st.sampled_from(["sequential", "round_robin"]),
    "max_steps": st.sampled_from([3, 12]),
}
games = st.fixed_dictionaries(
    {
        **plain,
        "target": st.sampled_from(["pin", "tree"]),
        "release_failed": st.booleans(),
        "rip_up": st.none()
        | st.fixed_dictionaries(
            {
                "rounds": st.sampled_from([2]),
                "choose": st.sampled_from(["all", "conflicts", "history", "agents"]),
                "neighbours": st.sampled_from([0, 2]),
            }
        ),
    }
)
prices = st.fixed_dictionaries(
    {name: st.floats(0, 50, width=16) for name in ("overflow", "open", "wirelength")}
)


def play(game: dict[str, Any], reward: dict[str, Any]) -> tuple[Any, dict[str, float], set[str]]:
    """A random episode: the environment, what each net was paid, and who played to the end."""
    options = dict(game)
    problem = generate(1, grid=(4, 4, 2), nets=5, max_pins=3, capacity=1, seed=options.pop("seed"))
    env = global_routing_v0.parallel_env(problem[0], reward=reward, **options)
    rng = np.random.default_rng(game["seed"])
    env.reset()
    paid, last = dict.fromkeys(env.agents, 0.0), set()
    while env.agents:
        last = set(env.agents)
        moves = {agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents}
        _, rewards, *_ = env.step(moves)
        for agent, reward_now in rewards.items():
            paid[agent] += reward_now
    return env, paid, last


def gained(env: Any, prices: dict[str, float]) -> float:
    """By how much the cost of a problem fell during an episode."""
    end = env.metrics()
    return (
        prices["open"] * end["joined"]
        - prices["overflow"] * end["overflow"]
        - prices["wirelength"] * end["wirelength"]
    )


@given(games, prices)
def test_differences_add_up_to_the_change_of_the_metrics(game: Any, prices: Any) -> None:
    env, paid, _ = play(game, {"kind": "difference", **prices})
    assert sum(paid.values()) == pytest.approx(gained(env, prices), abs=0.05)


@given(games, prices)
def test_a_member_of_the_team_that_stays_is_paid_the_whole_change(game: Any, prices: Any) -> None:
    env, paid, last = play(game, {"kind": "team", **prices})
    # Within a step, those who are done no longer see what others do after them.
    played = env.unwrapped.game
    order = [f"net_{played.nets[n]}" for n in played.order]
    agent = next(agent for agent in reversed(order) if agent in last)
    assert paid[agent] == pytest.approx(gained(env, prices), abs=0.05)


@given(st.fixed_dictionaries(plain), st.sampled_from([0.25, 1.0, 3.0]))
def test_potentials_pay_the_way_from_start_to_target(game: Any, scale: float) -> None:
    env, paid, _ = play(game, {"kind": "potential", "scale": scale})
    played = env.unwrapped.game
    for n, tasks in enumerate(played.tasks):
        whole = scale * sum(played.grid.distance(start, target) for start, target in tasks)
        agent = f"net_{played.nets[n]}"
        if played.joined[n] == len(tasks):
            assert paid[agent] == pytest.approx(whole, abs=0.01)
        assert paid[agent] <= whole + 0.01


@given(games)
def test_a_mixture_is_the_weighted_sum(game: Any) -> None:
    parts = [{"kind": "paper"}, {"kind": "team", "open": 3.0}, {"kind": "potential", "gamma": 0.5}]
    weights = [1, -0.5, 2.0]
    mixed = [{**part, "weight": w} for part, w in zip(parts, weights, strict=True)]
    _, paid, _ = play(game, {"kind": "mixed", "parts": mixed})
    alone = [play(game, part)[1] for part in parts]
    for agent in paid:
        expected = sum(w * own[agent] for w, own in zip(weights, alone, strict=True))
        assert paid[agent] == pytest.approx(expected, abs=0.05)


def test_hand_worked() -> None:
    """One net from corner to corner of 2x1x2: a via, an edge, a via."""
    problem = generate(1, grid=(2, 1, 2), nets=1, capacity=1, reduced_edges=0)[0]
    env = GlobalRoutingSingle(problem, reward={"kind": "team", "open": 7, "wirelength": 2})
    env.reset()
    east = int(problem.pin_gcells[0][0] == 0)
    move = 0 if east else 1
    assert env.step(4)[1] == -2
    assert env.step(4)[1] == 0  # blocked
    assert env.step(5)[1] == 0  # the net has this edge already
    _, paid, joined, _, _ = env.step(move)
    assert paid == 7 - 2
    assert joined


def test_trainings_and_batches_take_them() -> None:
    reward = {"kind": "mixed", "parts": [{"kind": "difference"}, {"kind": "potential"}]}
    batch = BatchEnv(generate(2, nets=4), reward=reward)
    batch.reset()
    assert batch.step(np.full((2, 4), 4))[1].any()
    config = load_config(
        None,
        [
            "env.reward={kind: mixed, parts: [{kind: team, weight: 0.5}, {kind: paper}]}",
            "env.problem.nets=3",
            "train.episodes=3",
            "learner.burn_in_size=50",
        ],
    )
    trainer = Trainer({"p": generate(1, nets=3)[0]}, config)
    episodes = [episode for done in trainer.run() for episode in done]
    assert len(episodes) == 3


@pytest.mark.parametrize(
    ("reward", "message"),
    [
        ({"kind": "team", "opne": 1}, "reward.opne: unknown key; did you mean open"),
        ({"kind": "potential", "gamma": 2}, "gamma: expected a number from 0 to 1"),
        ({"kind": "mixed", "parts": []}, "parts: expected at least one reward"),
        ({"kind": "mixed", "parts": [{"kind": "tame"}]}, "parts.0: unknown reward 'tame'; did you"),
        ({"kind": "mixed", "parts": [{"weight": "much"}]}, "parts.0.weight: expected a finite"),
    ],
)
def test_rewards_that_cannot_be_used(reward: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        global_routing_v0.env(reward=reward)
