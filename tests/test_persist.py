"""Environments whose agents stay to the end, and environments that play several problems."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test

from marouting import (
    InputError,
    Net,
    Pin,
    Problem,
    generate,
    global_routing_v0,
    make,
    scenarios,
)
from marouting.env.single import GlobalRoutingSingle
from marouting.vector import BatchEnv


def with_idle_net(problem: Problem) -> Problem:
    """The problem and a net with nothing to route, in the middle."""
    idle = Net("idle", 99, (Pin(0, 0, 1), Pin(1, 1, 1)))
    return replace(problem, nets=(problem.nets[0], idle, *problem.nets[1:]))


PROBLEM = with_idle_net(generate(1, grid=(4, 4, 2), nets=4, max_pins=3, seed=3)[0])
NO_OP = [1, 0, 0, 0, 0, 0]


def moves(rng: np.random.Generator, infos: dict[str, dict[str, Any]]) -> dict[str, int]:
    return {a: int(rng.choice(np.flatnonzero(info["action_mask"]))) for a, info in infos.items()}


@pytest.mark.parametrize("reward", ["paper", "test_env:TeamReward"])
def test_agents_that_stay_play_the_same_game(reward: str) -> None:
    options: dict[str, Any] = {"max_steps": 9, "reward": reward}
    stays = global_routing_v0.parallel_env(PROBLEM, agents_persist=True, **options)
    leaves = global_routing_v0.parallel_env(PROBLEM, **options)
    rng = np.random.default_rng(1)
    seen, infos = stays.reset(seed=1)
    other_seen, other_infos = leaves.reset(seed=1)
    assert list(seen) == stays.agents == stays.possible_agents == leaves.agents
    assert leaves.agents == ["net_0", "net_2", "net_3", "net_4"]
    first = True
    while stays.agents:
        assert stays.agents == stays.possible_agents
        playing = set(leaves.agents)
        for agent in stays.agents:
            # In the first infos there is nothing but masks.
            assert infos[agent].get("active") == (None if first else agent in playing)
            if agent in playing:
                np.testing.assert_array_equal(seen[agent], other_seen[agent])
                np.testing.assert_array_equal(
                    infos[agent]["action_mask"], other_infos[agent]["action_mask"]
                )
            else:
                assert infos[agent]["action_mask"].tolist() == NO_OP
        actions, first = moves(rng, infos), False
        seen, rewards, ended, cut, infos = stays.step(actions)
        other_seen, other_rewards, other_ended, other_cut, other_infos = leaves.step(
            {agent: actions[agent] for agent in leaves.agents}
        )
        for agent, paid in other_rewards.items():  # those who leave miss the rest of the step
            assert rewards[agent] == paid if agent in leaves.agents else rewards[agent] >= paid
        late = [r for a, r in rewards.items() if a not in playing]
        # Those who are done are paid on, by a reward that pays all.
        assert all(late) if reward != "paper" else not any(late)
        if stays.agents:
            assert leaves.agents
            assert not any((*ended.values(), *cut.values()))
    assert not leaves.agents
    assert all(ended[agent] != cut[agent] for agent in stays.possible_agents)
    for agent in playing:
        assert (ended[agent], cut[agent]) == (other_ended[agent], other_cut[agent])
    assert all(info["metrics"] == stays.metrics() for info in infos.values())
    assert stays.metrics() == leaves.metrics()
    assert stays.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.parametrize("reward", ["paper", "test_env:TeamReward"])
def test_agents_that_stay_in_turns(reward: str) -> None:
    env = global_routing_v0.env(PROBLEM, agents_persist=True, max_steps=9, reward=reward)
    other = global_routing_v0.env(PROBLEM, max_steps=9, reward=reward)
    env.reset()
    other.reset()
    rng = np.random.default_rng(1)
    sums, other_sums = (dict.fromkeys(env.agents, 0.0) for _ in range(2))
    ends = []
    for agent in env.agent_iter():
        _, reward_now, terminated, truncated, info = env.last()
        sums[agent] += reward_now
        if terminated or truncated:
            ends.append(agent)
            assert terminated != truncated
            assert info["metrics"] == env.metrics()
            env.step(None)
            continue
        assert info.get("active", True)
        assert not ends
        assert env.agents == env.possible_agents
        while other.terminations[other.agent_selection] or other.truncations[other.agent_selection]:
            other_sums[other.agent_selection] += other.last()[1]
            other.step(None)
        assert other.agent_selection == agent
        other_sums[agent] += other.last()[1]
        move = int(rng.choice(np.flatnonzero(info["action_mask"])))
        env.step(move)
        other.step(move)
    assert ends == env.possible_agents
    while other.agents:
        other_sums[other.agent_selection] += other.last()[1]
        other.step(None)
    assert env.metrics() == other.metrics()
    if reward == "paper":
        assert sums == other_sums
    else:  # those who stay are paid on when they are done
        assert all(sums[agent] >= other_sums[agent] for agent in sums)
        assert sum(sums.values()) > sum(other_sums.values())


def test_pettingzoo_accepts_agents_that_stay() -> None:
    parallel_api_test(global_routing_v0.parallel_env(PROBLEM, agents_persist=True), 200)
    api_test(global_routing_v0.env(PROBLEM, agents_persist=True), 200)


def test_where_there_is_nobody_to_stay() -> None:
    with pytest.raises(InputError, match="agents_persist: expected false"):
        GlobalRoutingSingle(PROBLEM, agents_persist=True)
    with pytest.raises(InputError, match="agents_persist: expected false with everyone=False"):
        BatchEnv([PROBLEM], agents_persist=True, everyone=False)


def test_a_state_belongs_to_agents_that_stay_or_leave() -> None:
    stays, leaves = (
        global_routing_v0.parallel_env(PROBLEM, agents_persist=p) for p in (True, False)
    )
    for env in (stays, leaves):
        env.reset()
    for one, other in ((stays, leaves), (leaves, stays)):
        with pytest.raises(ValueError, match="expected the state of a game with this problem"):
            one.restore(other.save())


def test_rows_of_agents_that_stay_end_together() -> None:
    rng = np.random.default_rng(2)
    options: dict[str, Any] = {"max_steps": 9, "reward": "team", "play_once": True}
    smaller = generate(1, grid=(4, 4, 2), nets=2, seed=5)[0]
    stays, plain = (
        BatchEnv([PROBLEM, smaller], agents_persist=p, **options) for p in (True, False)
    )
    _, info = stays.reset()
    plain.reset()
    lasting = late = 0
    while info["active"].any():
        waiting = stays.present & ~info["active"]
        assert (info["action_mask"][waiting] == NO_OP).all()
        actions = (info["action_mask"] * rng.random(info["action_mask"].shape)).argmax(axis=-1)
        _, paid, ended, cut, info = stays.step(actions)
        _, plain_paid, plain_ended, plain_cut, plain_info = plain.step(actions)
        np.testing.assert_array_equal(paid, plain_paid)
        over = ~plain_info["active"].any(axis=1, keepdims=True)
        np.testing.assert_array_equal(ended, plain_ended & over)
        np.testing.assert_array_equal(cut, plain_cut & over)
        lasting += int((plain_ended & ~over).sum())
        late += np.count_nonzero(paid[waiting])
    assert lasting
    assert late
    assert ((ended ^ cut) == stays.present).all()


def test_problems_that_are_played_once() -> None:
    env = BatchEnv(scenario="toy-4x4-v0", split="validation", play_once=True, max_steps=8)
    _, info = env.reset()
    ends = np.zeros(env.num_problems, int)
    while info["active"].any():
        *_, info = env.step(info["action_mask"].argmax(axis=-1))
        ends += info["over"]
    assert (ends == 1).all()
    steps = info["final_info"]["steps"].copy()
    env.step(info["action_mask"].argmax(axis=-1))
    np.testing.assert_array_equal(info["final_info"]["steps"], steps)
    assert env.reset()[1]["active"].any()
    with pytest.raises(InputError, match="play_once: expected false: these games draw"):
        BatchEnv(3, scenario="toy-4x4-v0", play_once=True)


@pytest.mark.parametrize("persist", [False, True])
def test_masks_by_name_are_those_in_the_infos(persist: bool) -> None:
    env = global_routing_v0.parallel_env(PROBLEM, agents_persist=persist, max_steps=5)
    aec = global_routing_v0.env(PROBLEM, agents_persist=persist, max_steps=5)
    _, infos = env.reset()
    rng = np.random.default_rng(3)
    while env.agents:
        for agent in env.agents:
            assert env.action_mask(agent).tolist() == infos[agent]["action_mask"].tolist()
        *_, infos = env.step(moves(rng, {agent: infos[agent] for agent in env.agents}))
    aec.reset()
    for agent in aec.agent_iter():
        *_, terminated, truncated, info = aec.last()
        assert aec.action_mask(agent).tolist() == info["action_mask"].tolist()
        aec.step(None if terminated or truncated else int(rng.integers(6)))
    with pytest.raises(KeyError):
        env.action_mask("net_5")


def test_what_a_done_agent_observes_has_the_same_mask() -> None:
    env = global_routing_v0.env(
        PROBLEM, agents_persist=True, mask={"in_observation": True}, max_steps=3
    )
    env.reset()
    seen = set()
    for _ in env.agent_iter():
        for name in env.agents:
            observed = env.observe(name)["action_mask"].tolist()
            assert observed == env.action_mask(name).tolist()
            if not env.infos[name].get("active", True):
                assert observed == NO_OP
                seen.add(name)
        *_, terminated, truncated, info = env.last()
        env.step(None if terminated or truncated else int(info["action_mask"].argmax()))
    assert seen == set(env.possible_agents)


def test_masks_as_sb3_contrib_asks_for_them() -> None:
    env = GlobalRoutingSingle(PROBLEM, max_steps=5)
    _, info = env.reset()
    over = False
    while not over:
        masks = env.action_masks()
        assert masks.dtype == np.bool_
        assert masks.tolist() == info["action_mask"].astype(bool).tolist()
        _, _, terminated, truncated, info = env.step(int(np.flatnonzero(masks)[0]))
        over = terminated or truncated


# Several problems ---------------------------------------------------------------------------------

SET = [
    *generate(3, grid=(4, 4, 2), nets=3, seed=1),
    *generate(2, grid=(4, 4, 2), nets=6, capacity=9, max_pins=4, seed=2),
]
MAKERS: dict[str, Callable[..., Any]] = {
    "env": global_routing_v0.env,
    "parallel_env": global_routing_v0.parallel_env,
    "single": GlobalRoutingSingle,
}


def problems_of(env: Any, episodes: int, seed: int | None) -> list[int]:
    played = []
    for episode in range(episodes):
        env.reset(seed=seed if episode == 0 else None)
        played.append(SET.index(env.unwrapped.game.problem))
    return played


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_every_episode_plays_a_problem_of_the_set(make: Callable[..., Any]) -> None:
    env = make(SET)
    played = problems_of(env, 60, 7)
    assert set(played) == set(range(len(SET)))
    assert problems_of(env, 60, 7) == problems_of(make(SET), 60, 7) == played
    assert problems_of(env, 60, 8) != played


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_without_a_seed_every_environment_plays_its_own_problems(make: Callable[..., Any]) -> None:
    envs = [make({"nets": 2, "grid": [4, 4, 1], "seed": None}) for _ in range(2)]
    for env in envs:
        env.reset()
    assert envs[0].unwrapped.problem_name != envs[1].unwrapped.problem_name


def test_spaces_hold_for_all_problems_of_the_set() -> None:
    env = global_routing_v0.parallel_env(SET)
    assert env.possible_agents == [f"net_{n}" for n in range(6)]
    rng = np.random.default_rng(0)
    names = set()
    for episode in range(12):
        seen, infos = env.reset(seed=None if episode else 0)
        assert all(set(info) == {"action_mask"} for info in infos.values())
        names.add(env.problem_name)
        while env.agents:
            for agent in env.agents:
                assert env.observation_space(agent).contains(seen[agent])
            assert env.state_space.contains(env.state())
            seen, _, _, _, infos = env.step({a: int(rng.integers(6)) for a in env.agents})
    assert names == {f"problem_00{i}" for i in range(5)}


@pytest.mark.parametrize("persist", [False, True])
@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.parallel_env])
def test_the_first_infos_hold_masks_only(make: Callable[..., Any], persist: bool) -> None:
    env = make(SET, agents_persist=persist)
    _, infos = env.reset(seed=1) or (None, env.unwrapped.infos)
    assert infos.keys() == set(env.agents)
    assert all(set(info) == {"action_mask"} for info in infos.values())
    played = {agent for agent in env.agents if agent not in env.idle_nets}
    played &= {f"net_{net}" for net in range(len(env.unwrapped.game.problem.nets))}
    moves = {agent: int(info["action_mask"].argmax()) for agent, info in infos.items()}
    if make is global_routing_v0.env:
        env.step(moves[env.agent_selection])
        infos = env.unwrapped.infos
    else:
        *_, infos = env.step(moves)
    for agent, info in infos.items():
        assert info.get("active") == ((agent in played) if persist else None)


def test_a_set_in_all_its_forms(tmp_path: Path) -> None:
    for number, problem in enumerate(SET[:3]):
        problem.write(tmp_path / f"p{number}.gr")
    names = set()
    for source in (str(tmp_path), [str(tmp_path / f"p{i}.gr") for i in range(3)]):
        env = make({"env": {"problem": source}})
        for _ in range(30):
            names.add(env.reset()[1]["problem"])
            assert env.reset()[1]["problem"] == env.problem_name
    assert names == {"p0", "p1", "p2"}
    env = make({"env": {"problem": {"nets": 3, "count": 4}}})
    assert {env.reset()[1]["problem"] for _ in range(40)} == {f"problem_00{i}" for i in range(4)}


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ([SET[0], generate(1, grid=(5, 4, 2), nets=3)[0]], "problem: expected one grid shape"),
        ([SET[0], "a.gr"], "problem: expected only objects of class Problem"),
        (["a.gr", SET[0]], "problem: expected only objects of class Problem"),
        (scenarios.get("toy-4x4-v0"), "problem: expected scenario='toy-4x4-v0'"),
        (scenarios.get("toy-4x4-v0").train(0), "problem: expected a list.* found a generator"),
        ({"count": 2, "seed": None}, "problem.count: expected 1 without a seed, found 2"),
        ({"count": 10**6}, "problem.count: expected at most 10000, found 1000000"),
    ],
)
def test_sets_that_cannot_be_played(source: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        global_routing_v0.env(source)
