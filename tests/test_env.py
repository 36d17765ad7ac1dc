"""The faces of the environment: that they play one and the same game, and tell it truly.

What PettingZoo's, Gymnasium's and SuperSuit's own checks ask for is in test_env_api.py.
"""

import copy
import functools
import itertools
import pickle
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pettingzoo import AECEnv
from reference import Game, contested, random_moves

import marouting
from marouting import (
    ENVIRONMENT_ID,
    Engine,
    EnvOptions,
    InputError,
    Move,
    Net,
    PaperObservation,
    Pin,
    Problem,
    evaluate,
    generate,
    global_routing_v0,
)
from marouting.batch.state import Dynamic
from marouting.configured import KEYS
from marouting.game import NOBODY, Ending, Status
from marouting.player import Player
from marouting.rewards import NormalisedReward
from marouting.vector import BatchEnv
from policies.learned.config import Config

E, W, N, S, U, D = Move
seeds = st.integers(0, 2**32)
game_options = st.fixed_dictionaries(
    {
        "turn_order": st.sampled_from(["sequential", "round_robin"]),
        "nets": st.fixed_dictionaries(
            {"order": st.sampled_from(["half_perimeter", "half_perimeter_up", "file"])}
        ),
        "overflow": st.sampled_from(["forbidden", "allowed"]),
        "max_steps": st.sampled_from([1, 4, 12]),
    }
)
face_options = st.fixed_dictionaries(
    {
        "mask": st.fixed_dictionaries({"in_observation": st.booleans()}),
        "reward": st.sampled_from([{}, {"overflow_price": 0.25, "own_edge": 0.0}]),
    }
)


def single_env(problem: Any = None, **options: Any) -> gymnasium.Env[Any, Any]:
    """The Gymnasium face without Gymnasium's wrappers."""
    made = gymnasium.make(ENVIRONMENT_ID, problem=problem, disable_env_checker=True, **options)
    return made.unwrapped


def assert_same(found: Any, expected: Any) -> None:
    """Asserts that observations or infos are equal: arrays, or dicts of them."""
    if isinstance(expected, dict):
        assert set(found) == set(expected)
        for key, value in expected.items():
            assert_same(found[key], value)
    else:
        np.testing.assert_array_equal(found, expected)


# One game, whichever face ------------------------------------------------------------------------


def expected_rewards(engine: Engine, price: float = 0.0, own_edge: float = -1.0) -> list[float]:
    """The paper's rewards, with the two prices, worked out from what the engine says of moves."""
    rewards = []
    for record in engine.agents[0]:
        if record["crossing"] == 0:
            reward = 0.0
        elif record["ending"] == Ending.JOINED:
            reward = 100.0
        else:
            reward = own_edge if record["crossing"] == 3 else -1.0
        rewards.append(reward - price * float(record["added_overflow"]))
    return rewards


def expected_observation(engine: Engine, game: Game, n: int) -> list[float]:
    """The paper's 12 numbers by the plain model."""
    agent = game.agents[n]
    target = agent.tasks[agent.task][1]
    numbers: list[float] = [*agent.at, *(t - a for t, a in zip(target, agent.at, strict=True))]
    cell = engine.grid.number(*agent.at)
    for move in range(6):
        near, far = sorted((cell, int(engine.grid.neighbour[cell, move])))
        if near < 0:
            numbers.append(0)
            continue
        ends = (tuple(engine.grid.position[c].tolist()) for c in (near, far))
        remaining = game.remaining(tuple(ends))  # type: ignore[arg-type]
        numbers.append(10 if remaining is None else remaining)
    return numbers


def play_side_by_side(
    problem: Problem, options: dict[str, Any], seed: int, cycles: int = 10**6
) -> None:
    """Plays AEC, Parallel and the raw engine with the same moves, and compares all they say."""
    rng = np.random.default_rng(seed)
    shape = {"mask", "reward"}
    engine = Engine([problem], **{key: options[key] for key in options.keys() - shape})
    prices = options.get("reward", {})
    price, own_edge = prices.get("overflow_price", 0.0), prices.get("own_edge", -1.0)
    aec = global_routing_v0.env(problem, **options)
    parallel = global_routing_v0.parallel_env(problem, **options)
    aec.reset(seed=0)
    seen, infos = parallel.reset(seed=0)
    names = parallel.agents
    assert aec.agents == names == [f"net_{net}" for net in engine.nets[0]]
    assert aec.possible_agents == parallel.possible_agents == names

    while parallel.agents and cycles:
        cycles -= 1
        # Before the moves.
        masks = engine.masks(*engine.pairs(everyone=True))
        assert aec.agents == parallel.agents
        for agent in parallel.agents:
            n = names.index(agent)
            np.testing.assert_array_equal(infos[agent]["action_mask"], masks[n])
            assert "metrics" not in infos[agent]
            assert_same(aec.observe(agent), seen[agent])
        np.testing.assert_array_equal(aec.state(), parallel.state())

        moves = random_moves(engine, rng)
        actions = {agent: int(moves[0, names.index(agent)]) for agent in parallel.agents}
        turn = engine.games[0]["agent"]
        engine.step(moves)
        seen, rewards, terminations, truncations, infos = parallel.step(actions)

        # The same moves one after the other.
        in_turn = list(actions) if not engine.static.sequential else [names[turn]]
        paid, ended = dict.fromkeys(actions, 0.0), {}
        for _ in in_turn:
            agent = aec.agent_selection
            observation, _, termination, truncation, info = aec.last()
            assert not termination
            assert not truncation
            if options.get("mask", {}).get("in_observation"):
                np.testing.assert_array_equal(observation["action_mask"], info["action_mask"])
            aec.step(actions[agent])
            paid[agent] = aec.rewards[agent]
            assert all(aec.rewards[other] == 0 for other in aec.agents if other != agent)
            if aec.terminations[agent] or aec.truncations[agent]:
                ended[agent] = aec.terminations[agent], aec.truncations[agent]
                assert aec.agent_selection == agent
                assert aec.last()[1] == paid[agent]
                aec.step(None)

        status = engine.agents["status"][0].tolist()
        expected = expected_rewards(engine, price, own_edge)
        for agent in actions:
            n = names.index(agent)
            assert rewards[agent] == paid[agent] == expected[n]
            flags = status[n] == Status.TERMINATED, status[n] == Status.TRUNCATED
            assert (terminations[agent], truncations[agent]) == flags
            assert ended.get(agent, (False, False)) == flags
            assert ("metrics" in infos[agent]) == (not parallel.agents)
        assert set(actions) == set(seen) == set(rewards) == set(terminations) == set(infos)
        assert parallel.agents == [a for a in actions if not any(ended.get(a, ()))]
        assert aec.metrics() == parallel.metrics() == vars(engine.metrics())
        assert parallel.solution() == aec.unwrapped.solution() == engine.solution()
    if not parallel.agents:
        assert aec.agents == []
        judged = evaluate(problem, parallel.solution())
        for metrics in (aec.metrics(), parallel.metrics()):
            assert metrics["overflow"] == judged.overflow
            assert metrics["wirelength"] == judged.wirelength


@given(contested(), game_options, face_options, seeds)
def test_aec_and_parallel_play_the_engines_game(
    problem: Problem, rules: dict[str, Any], form: dict[str, Any], seed: int
) -> None:
    play_side_by_side(problem, {**rules, **form}, seed)


@pytest.mark.parametrize("turn_order", ["round_robin", "sequential"])
@pytest.mark.parametrize(("nets", "cycles"), [(1, 100), (2, 100), (200, 40)])
def test_any_number_of_nets(nets: int, cycles: int, turn_order: str) -> None:
    (problem,) = generate(1, grid=(12, 10, 2), nets=nets, max_pins=3)
    options = {"turn_order": turn_order, "max_steps": 10}
    play_side_by_side(problem, options, seed=nets, cycles=cycles)


@given(contested(), game_options, seeds)
def test_observations_are_those_of_the_model(
    problem: Problem, rules: dict[str, Any], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    engine, game = Engine([problem], **rules), Game(problem, **rules)
    env = global_routing_v0.raw_env(problem, **rules)
    env.reset()
    for _ in range(40):
        if game.turn is None:
            break
        for n in game.active():
            observation = env.observe(f"net_{engine.nets[0, n]}")
            assert observation.dtype == np.float32
            assert observation.tolist() == expected_observation(engine, game, n)
        assert env.infos[env.agent_selection]["action_mask"].tolist() == game.action_mask(game.turn)
        move = int(random_moves(engine, rng)[0, game.turn])
        mover = env.agent_selection
        env.step(move)
        game.step(move)
        engine.step(np.array([move]))
        if env.terminations[mover] or env.truncations[mover]:
            env.step(None)


@given(contested(), game_options, face_options, seeds)
def test_single_plays_the_aec_game(
    problem: Problem, rules: dict[str, Any], form: dict[str, Any], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    aec = global_routing_v0.env(problem, **rules, **form)
    single = single_env(problem, **rules, **form)
    aec.reset()
    observation, info = single.reset()
    terminated = truncated = False
    while aec.agents:
        assert not terminated
        assert not truncated
        agent = aec.agent_selection
        expected, *_, expected_info = aec.last()
        assert_same(observation, expected)
        assert info["net"] == agent
        np.testing.assert_array_equal(info["action_mask"], expected_info["action_mask"])
        assert "metrics" not in info
        action = int(rng.integers(6))
        observation, reward, terminated, truncated, info = single.step(action)
        aec.step(action)
        assert isinstance(reward, float)
        assert reward == aec.rewards[agent]
        if terminated or truncated:  # the last to be seen is the net that moved last
            assert info["net"] == agent
            assert_same(observation, aec.observe(agent))
        if aec.terminations[agent] or aec.truncations[agent]:
            aec.step(None)
        np.testing.assert_array_equal(single.state(), aec.state())  # type: ignore[attr-defined]
    metrics = aec.metrics()
    assert info["metrics"] == metrics
    assert terminated == (metrics["joined"] == metrics["tasks"])
    assert truncated != terminated


# Spaces ------------------------------------------------------------------------------------------


@given(contested(max_nets=10), game_options, face_options, seeds)
def test_spaces_hold_every_observation_and_state(
    problem: Problem, rules: dict[str, Any], form: dict[str, Any], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    env = global_routing_v0.parallel_env(problem, **rules, **form)
    single = single_env(problem, **rules, **form)
    assert single.observation_space == env.observation_space(env.possible_agents[0])
    seen, _ = env.reset()
    for _ in range(25):
        assert env.state_space.contains(env.state())
        for agent, observation in seen.items():
            assert env.observation_space(agent).contains(observation)
        if not env.agents:
            break
        seen, *_ = env.step({agent: int(rng.integers(6)) for agent in env.agents})


def test_spaces_are_the_same_object_every_time_and_each_agents_own() -> None:
    for make in (global_routing_v0.raw_env, global_routing_v0.parallel_env):
        env = make()
        first, second = env.possible_agents[:2]
        for space in (env.observation_space, env.action_space):
            assert space(first) is space(first)
            assert space(first) is not space(second)
            assert space(first) == space(second)


def test_state_by_hand() -> None:
    """(X, Y, 5 Z): remaining along +x and +y, nets on the via, agents that stand, targets."""
    env = global_routing_v0.parallel_env(ROW, turn_order="round_robin")
    env.reset()
    state = env.state().reshape(4, 1, 2, 5)
    assert state[:, 0, :, 0].tolist() == [[1, 1], [1, 1], [1, 1], [0, 0]]
    assert not state[..., 1].any()
    assert state[:, 0, 0, 3].tolist() == [0, 2, 0, 0]
    assert state[:, 0, 0, 4].tolist() == [1, 0, 1, 0]
    env.step({"net_0": U, "net_2": W})
    state = env.state().reshape(4, 1, 2, 5)
    assert state[:, 0, 0, 0].tolist() == [0, 1, 1, 0]
    assert state[:, 0, 0, 2].tolist() == [0, 1, 0, 0]
    assert state[:, 0, :, 3].tolist() == [[0, 0], [1, 1], [0, 0], [0, 0]]


@pytest.mark.parametrize("form", [{}, {"mask": {"in_observation": True}}])
def test_masks(form: dict[str, Any]) -> None:
    env = global_routing_v0.env({"nets": 20, "capacity": 1}, max_steps=15, **form)
    env.reset(seed=3)
    blocked = 0
    for agent in env.agent_iter():
        observation, _, termination, truncation, info = env.last()
        mask = info["action_mask"]
        assert mask.dtype == np.int8
        assert mask.shape == (6,)
        assert mask.any()
        if form:
            np.testing.assert_array_equal(observation["action_mask"], mask)
            observation = observation["observation"]
        if termination or truncation:
            env.step(None)
            continue
        # Fresh, and true: the remaining capacity of each way says the same, if none is the
        # net's own edge.
        blocked += 6 - int(mask.sum())
        if not mask.all():
            assert mask[(observation[6:] >= 1)].all()
        action = env.action_space(agent).sample(mask)
        assert mask[action]
        env.step(action)
    assert blocked


def test_masks_handed_out_do_not_change_later() -> None:
    for env in (global_routing_v0.raw_env(), global_routing_v0.parallel_env()):
        env.reset()
        if isinstance(env, AECEnv):
            observation, *_, info = env.last()
            kept = observation.copy(), info["action_mask"].copy()
            env.step(int(np.flatnonzero(info["action_mask"])[0]))
        else:
            seen, infos = env.reset()
            observation, info = seen["net_0"], infos["net_0"]
            kept = observation.copy(), info["action_mask"].copy()
            env.step(dict.fromkeys(env.agents, 0))
        np.testing.assert_array_equal(observation, kept[0])
        np.testing.assert_array_equal(info["action_mask"], kept[1])


NAMES = {"observation_key": "observations", "mask_key": "mask"}


def one_view(env: Any) -> tuple[Any, dict[str, Any]]:
    """The observation and the info of one agent of an environment of any face."""
    if hasattr(env, "agent_iter"):
        env.reset(seed=0)
        observation, *_, info = env.last()
        return observation, info
    seen, info = env.reset(seed=0)
    return (seen["net_0"], info["net_0"]) if hasattr(env, "possible_agents") else (seen, info)


@pytest.mark.parametrize("persist", [False, True])
def test_masks_under_other_names(persist: bool) -> None:
    options: dict[str, Any] = {"problem": {"nets": 3}, "mask": {"in_observation": True, **NAMES}}
    makers: list[Any] = [global_routing_v0.env, global_routing_v0.parallel_env]
    makers += [] if persist else [single_env, functools.partial(gymnasium.make, ENVIRONMENT_ID)]
    for make in makers:
        env = make(**options, **({"agents_persist": True} if persist else {}))
        observation, info = one_view(env)
        assert set(observation) == {"observations", "mask"}
        np.testing.assert_array_equal(observation["mask"], info["mask"])
        assert "action_mask" not in info
        nets = hasattr(env, "possible_agents")
        space = env.observation_space("net_0") if nets else env.observation_space
        assert space["mask"] == Box(0, 1, (6,), np.int8)
        assert space.contains(observation)


def test_masks_in_all_infos_have_their_name() -> None:
    env = global_routing_v0.parallel_env({"nets": 3}, max_steps=3, mask={"mask_key": "mask"})
    _, infos = env.reset()
    aec = global_routing_v0.env({"nets": 3}, max_steps=3, mask={"mask_key": "mask"})
    aec.reset()
    found = list(infos.values())
    while env.agents:
        found += env.step(dict.fromkeys(env.agents, 0))[4].values()
    for _ in aec.agent_iter():
        *_, terminated, truncated, info = aec.last()
        found.append(info)
        aec.step(None if terminated or truncated else 0)
    assert all(info["mask"].shape == (6,) and "action_mask" not in info for info in found)


# Seeds and copies --------------------------------------------------------------------------------

MAKERS: dict[str, Callable[..., Any]] = {
    "env": global_routing_v0.env,
    "raw_env": global_routing_v0.raw_env,
    "parallel_env": global_routing_v0.parallel_env,
    "single": single_env,
    "gymnasium.make": lambda problem=None, **options: gymnasium.make(
        ENVIRONMENT_ID, problem=problem, **options
    ),
}
makers = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
DRAWN = {"nets": 5, "seed": None}


def pins_after_reset(env: Any, seed: int | None = None) -> list[Any]:
    """What the observations show of the problem right after a reset."""
    result = env.reset(seed=seed)
    if hasattr(env, "observe"):
        return [env.observe(agent).tolist() for agent in env.agents]
    observations = result[0]
    if isinstance(observations, dict):
        return [observation.tolist() for observation in observations.values()]
    return [observations.tolist(), env.unwrapped.state().tolist()]


@makers
def test_a_new_problem_every_episode(make: Callable[..., Any]) -> None:
    env, other = make(problem=DRAWN), make(problem=DRAWN)
    first = pins_after_reset(env, 1)
    following = [pins_after_reset(env) for _ in range(5)]
    assert pins_after_reset(other, 1) == first
    assert [pins_after_reset(other) for _ in range(5)] == following
    # Two seeds differ, and so do the episodes.
    assert pins_after_reset(other, 2) != first
    assert all(one != two for one, two in zip([first, *following], following, strict=False))
    assert pins_after_reset(env, 1) == first


@makers
def test_without_drawing_every_episode_is_the_same_problem(make: Callable[..., Any]) -> None:
    env = make()
    assert pins_after_reset(env, 1) == pins_after_reset(env, 2) == pins_after_reset(env)


def test_a_drawn_problem_is_generated_from_what_was_asked_for() -> None:
    env = global_routing_v0.parallel_env({**DRAWN, "grid": (5, 4, 3), "max_pins": 3})
    for seed in range(20):
        env.reset(seed=seed)
        problem = env.solution().problem
        assert problem.grid == (5, 4, 3)
        assert env.possible_agents == [f"net_{n}" for n in range(5)]
        assert env.state_space.contains(env.state())


def transcript(env: Any, seed: int) -> list[Any]:
    """A seeded episode of an environment of any face."""
    return [pins_after_reset(env, seed), *rest_of_episode(env, seed)]


def rest_of_episode(env: Any, seed: int, most: int = 10**6) -> list[Any]:
    """What comes of random moves, at most a number of them, to the end of an episode."""
    rng = np.random.default_rng(seed)
    kept: list[Any] = []
    if hasattr(env, "agent_iter"):
        for agent in env.agent_iter(most):
            observation, reward, termination, truncation, info = env.last()
            dead = termination or truncation
            kept.append((agent, observation.tolist(), reward, termination, truncation, str(info)))
            env.step(None if dead else int(rng.integers(6)))
    elif hasattr(env, "possible_agents"):
        while env.agents and len(kept) < most:
            kept.append(str(env.step({agent: int(rng.integers(6)) for agent in env.agents})))
    else:
        over = False
        while not over and len(kept) < most:
            observation, reward, terminated, truncated, info = env.step(int(rng.integers(6)))
            over = terminated or truncated
            kept.append((observation.tolist(), reward, terminated, truncated, str(info)))
    return [*kept, env.unwrapped.metrics()]


@makers
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("source", [DRAWN, generate(1, nets=4, max_pins=3, seed=5)[0]])
def test_copies_play_alike(
    make: Callable[..., Any], copied: Callable[[Any], Any], source: Any
) -> None:
    options = {"max_steps": 9, "overflow": "allowed", "reward": {"overflow_price": 2.0}}
    env = make(problem=source, **options)
    env.reset(seed=4)
    twin = copied(env)
    assert type(twin) is type(env)
    expected = transcript(env, 11)
    assert transcript(twin, 11) == expected
    # Neither has a hold on the other.
    assert transcript(copied(twin), 11) == expected
    assert transcript(env, 11) == expected
    assert transcript(env, 12) != expected


class TeamReward:
    """Pays everybody for every move."""

    def __call__(self, game: Engine, before: Dynamic, movers: NDArray[np.int32]) -> Any:
        del before, movers
        return np.full(game.nets.shape, game.games["wirelength"][:, None], np.float32)


@makers
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("source", [DRAWN, generate(1, nets=4, max_pins=3, seed=5)[0]])
@pytest.mark.parametrize("reward", ["paper", f"{__name__}:TeamReward"])
def test_copies_in_mid_episode_go_on(
    make: Callable[..., Any], copied: Callable[[Any], Any], source: Any, reward: str
) -> None:
    env = make(problem=source, max_steps=9, reward=reward)
    env.reset(seed=4)
    rest_of_episode(env, 1, 12)
    twin, saved = copied(env), env.unwrapped.save()
    expected = rest_of_episode(env, 2)
    assert rest_of_episode(twin, 2) == expected
    assert transcript(twin, 11) == transcript(env, 11)
    env.unwrapped.restore(saved)
    assert rest_of_episode(env, 2) == expected


def test_states_of_other_games_are_refused() -> None:
    problem, other = generate(2, nets=3)
    env = global_routing_v0.env(problem=problem).unwrapped
    parallel = global_routing_v0.parallel_env(problem=problem)
    for one in (env, parallel):
        one.reset()
    for saved in (
        parallel.save(),
        global_routing_v0.env(problem=other).unwrapped.save(),
        global_routing_v0.env(problem=problem, max_steps=9).unwrapped.save(),
        [1],
    ):
        with pytest.raises(ValueError, match="saved: expected the state of a game with this prob"):
            env.restore(saved)


# Rewards and other components ---------------------------------------------------------------------

# Four Gcells in a row, two layers, capacity 1. Net A has three pins, net B two, "dot" nothing.
ROW = Problem(
    grid=(4, 1, 2),
    vertical_capacity=(0, 0),
    horizontal_capacity=(1, 1),
    nets=(
        Net("B", 0, (Pin(1, 0, 1), Pin(2, 0, 1))),
        Net("dot", 1, (Pin(0, 0, 1), Pin(0, 0, 1))),
        Net("A", 2, (Pin(1, 0, 1), Pin(0, 0, 1), Pin(3, 0, 1))),
    ),
    min_width=(1, 1),
    min_spacing=(0, 0),
    via_spacing=(0, 0),
)


def rewards_of(env: Any, moves: Sequence[int]) -> list[float]:
    """The rewards of moves in the Gymnasium face."""
    env.reset()
    return [env.step(move)[1] for move in moves]


# A: into the wall, there; back over its own edge, west and east; on, there. B: blocked, round.
EPISODE = (N, W, W, E, E, E, E, U, E, D)


def test_the_papers_reward() -> None:
    assert rewards_of(single_env(ROW), EPISODE) == [-1, 100, -1, -1, -1, 100, -1, -1, -1, 100]


def test_own_edges_can_be_free() -> None:
    env = single_env(ROW, reward={"own_edge": 0.0})
    assert rewards_of(env, EPISODE) == [-1, 100, 0, 0, -1, 100, -1, -1, -1, 100]


def test_reached_and_step() -> None:
    env = single_env(ROW, reward={"reached": 7.5, "step": -0.5})
    # Own edges cost what other moves cost.
    assert rewards_of(env, EPISODE)[:5] == [-0.5, 7.5, -0.5, -0.5, -0.5]


def test_the_normalised_reward() -> None:
    """The paper's, in numbers of order 1, and as quick."""
    env = single_env(ROW, reward="normalised")
    paper = rewards_of(single_env(ROW), EPISODE)
    assert rewards_of(env, EPISODE) == pytest.approx([r / 100 for r in paper])
    assert Player(Engine([ROW]), PaperObservation(), NormalisedReward()).compiled


def test_overflow_has_a_price() -> None:
    env = single_env(ROW, overflow="allowed", reward={"overflow_price": 30.0})
    # A takes both edges; B then overflows the one between its pins by 1, and reaches its target.
    assert rewards_of(env, (W, E, E, E)) == [100, -1, 100, 70]
    assert env.metrics()["overflow"] == 1  # type: ignore[attr-defined]


def test_reward_of_an_agent_that_waits_is_zero() -> None:
    env = global_routing_v0.parallel_env(ROW, turn_order="sequential")
    env.reset()
    _, rewards, *_ = env.step({"net_0": E, "net_2": W})
    assert rewards == {"net_0": 0.0, "net_2": 100.0}
    assert env.metrics()["steps"] == 1


class Two:
    """An observation of two numbers: the net's number and the joined tasks."""

    def space(self, problems: Sequence[Problem], overflow: bool) -> Box:
        assert not overflow
        return Box(0, len(problems[0].nets), (2,), np.float32)

    def write(
        self,
        engine: Engine,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        out[:, 0] = agents
        out[:, 1] = engine.agents["joined"][problems, agents]


def doubled(game: Engine, before: Dynamic, movers: NDArray[np.int32]) -> Any:
    """A reward: twice the steps of the mover's task."""
    del before
    mine = np.arange(game.nets.shape[1]) == movers[:, None]
    return np.where(mine, 2.0 * game.agents["steps"], 0.0)


def test_own_observation_and_reward() -> None:
    options: dict[str, Any] = {"observation": Two(), "reward": doubled}
    single = single_env(ROW, **options)
    assert single.observation_space == Box(0, 3, (2,), np.float32)
    observation, _ = single.reset()
    assert observation.tolist() == [1, 0]
    assert rewards_of(single, (E, U, D)) == [2, 4, 6]

    parallel = global_routing_v0.parallel_env(ROW, mask={"in_observation": True}, **options)
    parallel.reset()
    seen, rewards, *_ = parallel.step({"net_0": U, "net_2": W})
    assert seen["net_2"]["observation"].tolist() == [1, 1]
    assert rewards["net_0"] == 2

    aec = global_routing_v0.env(ROW, **options)
    aec.reset()
    assert aec.observe("net_2").tolist() == [1, 0]
    copied = pickle.loads(pickle.dumps(aec))
    copied.reset()
    assert copied.observe("net_2").tolist() == [1, 0]


def test_via_capacity_shown() -> None:
    env = global_routing_v0.raw_env(ROW, observation={"via_capacity": 3.0})
    env.reset()
    assert env.observe("net_0").tolist() == [1, 0, 0, 1, 0, 0, 1, 1, 0, 0, 3, 0]


# Course of an episode ----------------------------------------------------------------------------


@pytest.mark.parametrize("persist", [False, True])
@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.parallel_env])
def test_nets_of_one_gcell_are_no_agents(make: Callable[..., Any], persist: bool) -> None:
    env = make(ROW, agents_persist=persist, max_steps=1)
    assert env.possible_agents == ["net_0", "net_2"]
    env.reset(seed=0)
    assert env.agents == ["net_0", "net_2"]
    assert env.unwrapped.idle_nets == ["net_1"]
    with pytest.raises(KeyError):
        env.unwrapped.action_mask("net_1")
    rest_of_episode(env, 1)
    judged = evaluate(ROW, env.unwrapped.solution())
    assert "dot" not in judged.disconnected  # it is joined, whatever the others do
    assert judged.tasks == env.unwrapped.metrics()["tasks"] == 3


def test_nets_of_one_gcell_elsewhere() -> None:
    assert single_env(ROW).idle_nets == ["net_1"]  # type: ignore[attr-defined]
    more = replace(ROW, nets=(*ROW.nets, Net("C", 3, ROW.nets[0].pins)))
    env = BatchEnv([ROW, more])
    assert env.num_agents == 3
    assert env.present.tolist() == [[True, True, False], [True] * 3]


def test_a_net_that_plays_in_some_problems_only() -> None:
    moved = Net("dot", 1, (Pin(0, 0, 1), Pin(1, 0, 1)))
    problems = [ROW, replace(ROW, nets=(ROW.nets[0], moved, ROW.nets[2]))]
    for persist in (False, True):
        env = global_routing_v0.parallel_env(problems, agents_persist=persist)
        assert env.possible_agents == ["net_0", "net_1", "net_2"]
        found = set()
        for _ in range(20):
            seen, infos = env.reset()
            idle = env.idle_nets
            found.add(tuple(idle))
            assert env.agents == [a for a in env.possible_agents if persist or a not in idle]
            for agent in env.agents:
                assert list(infos[agent]) == ["action_mask"]
                assert seen[agent].any() == (agent not in idle)
            *_, infos = env.step(dict.fromkeys(env.agents, 0))
            for agent, info in infos.items():
                assert info.get("active", True) == (agent not in idle) or "task_ended" in info
        assert found == {(), ("net_1",)}


@pytest.mark.parametrize("turn_order", ["round_robin", "sequential"])
def test_an_episode_of_random_moves_ends(turn_order: str) -> None:
    env = global_routing_v0.env(turn_order=turn_order, max_steps=7)
    env.reset(seed=0)
    ends = dict.fromkeys(env.possible_agents, 0)
    for agent in env.agent_iter():
        _, _, termination, truncation, info = env.last()
        if termination or truncation:
            assert termination != truncation
            ends[agent] += 1
            last = info.get("metrics")
            assert (last is not None) == (len(env.agents) == 1)
            env.step(None)
        else:
            env.step(env.action_space(agent).sample())
    assert env.agents == []
    assert set(ends.values()) == {1}
    # Only the last to end is told metrics: those of the whole episode.
    assert last == env.metrics()
    judged = evaluate(env.unwrapped.solution().problem, env.unwrapped.solution())
    assert (judged.overflow, judged.wirelength) == (last["overflow"], last["wirelength"])


@pytest.mark.parametrize("options", [{}, {"target": "tree", "next_pin": "nearest"}])
def test_edges_join_no_less_than_the_game_counts(options: dict[str, Any]) -> None:
    """More with several pins, where edges of one task may join the pins of another."""
    more = {2: 0, 5: 0}
    for pins, seed in itertools.product(more, range(8)):
        (problem,) = marouting.generate(1, nets=6, max_pins=pins, grid=(5, 5, 2), seed=seed)
        env = global_routing_v0.parallel_env(problem=problem, max_steps=12, **options)
        _, infos = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        while env.agents:
            masks = {agent: infos[agent]["action_mask"] for agent in env.agents}
            moves = {agent: int(rng.choice(np.flatnonzero(mask))) for agent, mask in masks.items()}
            *_, infos = env.step(moves)
        joined = marouting.evaluate(problem, env.solution()).joined
        assert joined >= env.metrics()["joined"]
        more[pins] += joined > env.metrics()["joined"]
    assert more[2] == 0 < more[5]


def test_an_agent_terminates_when_all_is_joined_and_is_truncated_else() -> None:
    env = global_routing_v0.env(ROW, turn_order="sequential", max_steps=3)
    env.reset()
    for action in (W, E, E):
        env.step(action)
    assert (env.terminations["net_2"], env.truncations["net_2"]) == (True, False)
    env.step(None)
    assert env.agents == ["net_0"]
    for action in (E, E, E):
        env.step(action)
    assert (env.terminations["net_0"], env.truncations["net_0"]) == (False, True)
    assert env.infos["net_0"]["metrics"] == {
        "overflow": 0,
        "wirelength": 3,
        "joined": 2,
        "tasks": 3,
        "steps": 6,
    }


def test_a_dead_agent_takes_none_and_leaves() -> None:
    env = global_routing_v0.raw_env(ROW, turn_order="round_robin", max_steps=1)
    env.reset()
    env.step(W)  # A joins its first task
    env.step(E)  # B its only one
    assert env.agent_selection == "net_0"
    with pytest.raises(ValueError, match="only valid action is None"):
        env.step(E)
    env.step(None)
    assert env.agents == ["net_2"] == list(env.rewards) == list(env.infos)
    assert env.agent_selection == "net_2"
    with pytest.raises(ValueError, match="action: expected 0 to 5, found None"):
        env.step(None)
    env.step(U)
    assert env.last()[1:4] == (-1, False, True)
    env.step(None)
    assert env.agents == []
    # And again from the beginning.
    env.reset()
    assert env.agents == ["net_0", "net_2"]
    assert env.metrics()["steps"] == 0


def test_all_agents_of_a_cycle_may_die_at_once() -> None:
    env = global_routing_v0.parallel_env(turn_order="round_robin", max_steps=1)
    env.reset()
    _, _, _, truncations, infos = env.step(dict.fromkeys(env.agents, int(U)))
    assert all(truncations.values())
    assert env.agents == []
    assert all(info["metrics"] == env.metrics() for info in infos.values())
    assert env.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.parametrize("action", [6, NOBODY, 100])
def test_bad_actions(action: int) -> None:
    raw, parallel = global_routing_v0.raw_env(ROW), global_routing_v0.parallel_env(ROW)
    single = single_env(ROW)
    for env in (raw, parallel, single):
        env.reset()
    with pytest.raises(ValueError, match=f"action: expected 0 to 5, found {action}"):
        raw.step(action)
    with pytest.raises(ValueError, match=f"action of net_2: expected 0 to 5, found {action}"):
        parallel.step({"net_0": 0, "net_2": action})
    with pytest.raises(ValueError, match=f"action: expected 0 to 5, found {action}"):
        single.step(action)
    for env in (raw, parallel, single):
        assert env.metrics()["steps"] == 0  # type: ignore[attr-defined]


def test_a_missing_action_is_an_error() -> None:
    env = global_routing_v0.parallel_env(ROW)
    env.reset()
    with pytest.raises(KeyError, match="net_2"):
        env.step({"net_0": 0})
    for actions in (None, [0, 0], np.zeros(2, int)):
        with pytest.raises(ValueError, match="step: expected a mapping from agents to actions"):
            env.step(actions)  # type: ignore[arg-type]
    assert env.metrics()["steps"] == 0


def test_unknown_reset_options_are_accepted() -> None:
    for make in MAKERS.values():
        make().reset(seed=1, options={"anything": 1})


@makers
def test_rendering(make: Callable[..., Any]) -> None:
    env = make(render_mode="ansi")
    env.reset()
    text = env.render()
    assert isinstance(text, str)
    assert "joined 0/10" in text
    env = make(render_mode="rgb_array")
    env.reset()
    before = env.render()
    assert before.dtype == np.uint8
    assert before.shape[2:] == (3,)
    action = int(U)
    env.step(dict.fromkeys(env.agents, action) if make is MAKERS["parallel_env"] else action)
    assert (env.render() != before).any()
    env.close()


# Making ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "kind"),
    [
        ({}, gymnasium.Env),
        ({"env": None}, gymnasium.Env),
        ({"env": {"agents": "single"}}, gymnasium.Env),
        ({"env": {"agents": "multi"}}, AECEnv),
        ({"env": {"agents": "multi"}, "train": {"not": "read here"}}, AECEnv),
        (EnvOptions(), gymnasium.Env),
        (EnvOptions(agents="multi"), AECEnv),
        (SimpleNamespace(env=EnvOptions(agents="multi")), AECEnv),
    ],
)
def test_make(config: Any, kind: type) -> None:
    env = marouting.make(config)
    assert isinstance(env, kind)
    env.reset(seed=0)
    # Left open, one player takes net after net, and many move in turns.
    order = env.unwrapped.game.rules.turn_order
    assert order == ("sequential" if kind is gymnasium.Env else "round_robin")


def test_make_from_a_file(tmp_path: Path) -> None:
    ROW.write(tmp_path / "row.gr")
    config = tmp_path / "config.yaml"
    config.write_text(
        "env:\n"
        f"  problem: {tmp_path / 'row.gr'}\n"
        "  agents: multi\n"
        "  turn_order: sequential\n"
        "  max_steps: 2\n"
        "  reward: {own_edge: 0.0}\n"
        "  mask: {in_observation: true}\n"
        "learner: {kind: dqn}\n"
    )
    for path in (config, str(config)):
        env = marouting.make(path)
        env.reset()
        assert env.agent_selection == "net_2"
        assert set(env.observe("net_2")) == {"observation", "action_mask"}
        env.step(U)
        env.step(D)
        assert env.rewards["net_2"] == 0.0
        assert env.unwrapped.solution().problem.grid == ROW.grid


def test_make_knows_the_keys_of_a_training() -> None:
    assert set(KEYS) == {field.name for field in fields(Config)}


def test_make_takes_problems_as_objects() -> None:
    for agents in ("single", "multi"):
        env = marouting.make({"env": {"agents": agents, "problem": ROW}})
        assert env.unwrapped.game.problem is ROW
        env = marouting.make({"env": {"agents": agents, "problem": [ROW, ROW]}})
        env.reset(seed=0)
        assert env.unwrapped.game.problem is ROW
        with pytest.raises(InputError, match="problem: expected none beside a scenario"):
            marouting.make({"env": {"problem": ROW, "scenario": "toy-4x4-v0"}})
        with pytest.raises(InputError, match="config: env: problem: expected only objects of cl"):
            marouting.make({"env": {"problem": [ROW, "p.gr"]}})


@pytest.mark.filterwarnings("ignore:.*render_mode='svg'")  # Gymnasium, before it asks us
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"turn_ordr": "sequential"}, "turn_ordr: unknown key; did you mean turn_order?"),
        ({"zzz": 1}, "zzz: unknown key; expected one of turn_order, max_steps,"),
        ({"problem": {"netz": 3}}, "problem.netz: unknown key; did you mean nets?"),
        ({"reward": {"reachd": 1.0}}, "reward.reachd: unknown key; did you mean reached?"),
        ({"observation": {"via": 1}}, "observation.via: unknown key; "),
        ({"max_steps": "ten"}, "max_steps: expected a whole number or null, found 'ten'"),
        ({"max_steps": True}, "max_steps: expected a whole number or null, found True"),
        ({"max_steps": 0}, "max_steps: expected 1 to 1000000, found 0"),
        (
            {"turn_order": "sequentiel"},
            "turn_order: expected one of sequential, round_robin or null",
        ),
        ({"net_order": "file"}, "net_order: unknown key; it is now nets: {order: …}"),
        (
            {"decomposition": "mst"},
            "decomposition: unknown key; it is now nets: {decomposition: …}",
        ),
        ({"mask_visited": True}, "mask_visited: unknown key; it is now mask: {visited: …}"),
        ({"mask_key": "m"}, "mask_key: unknown key; it is now mask: {mask_key: …}"),
        ({"mask": {"in_observation": "yes"}}, "mask.in_observation: expected true or false"),
        ({"mask": {"mask_key": "observation"}}, "mask.mask_key: expected none of "),
        ({"mask": {"mask_key": "metrics"}}, "mask.mask_key: expected none of "),
        ({"mask": {"mask_key": "final_obs"}}, "mask.mask_key: expected none of "),
        ({"mask": {"mask_key": "_net"}}, "mask.mask_key: expected a name that does not begin with"),
        ({"mask": {"mask_key": 1}}, "mask.mask_key: expected a text, found 1"),
        ({"render_mode": "svg"}, "render_mode: expected one of ansi, rgb_array, human or null"),
        ({"problem": {"nets": 0}}, "nets: expected 1 to 1000000000, found 0"),
        ({"problem": {"count": 2, "seed": None}}, "problem.count: expected 1 without a seed"),
        ({"problem": "missing.gr"}, "missing.gr: cannot be read"),
        ({"problem": 5}, "problem: "),
    ],
)
def test_options_that_cannot_be_used(options: dict[str, Any], expected: str) -> None:
    for call in (
        lambda: marouting.make({"env": options}),
        lambda: marouting.make({"env": {**options, "agents": "multi"}}),
        lambda: global_routing_v0.env(**options),
        lambda: global_routing_v0.parallel_env(**options),
        lambda: gymnasium.make(ENVIRONMENT_ID, **options),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert expected in str(caught.value)
        assert "\n" not in str(caught.value)


def test_an_unknown_option_is_a_type_error_too() -> None:
    """Some libraries offer options of their own, and look for Python's words."""
    for call in (
        global_routing_v0.env,
        global_routing_v0.parallel_env,
        functools.partial(gymnasium.make, ENVIRONMENT_ID),
        functools.partial(BatchEnv, [ROW]),
    ):
        with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'") as e:
            call(frameskip=4)
        assert isinstance(e.value, InputError)
        assert str(e.value).startswith("frameskip: unknown key; expected one of turn_order, ")
        assert "\n" not in str(e.value)
        assert str(pickle.loads(pickle.dumps(e.value))) == str(e.value)


def test_bad_agents() -> None:
    with pytest.raises(InputError, match="agents: expected one of single, multi, found 'many'"):
        marouting.make({"env": {"agents": "many"}})


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({"env": [1]}, "env: expected a mapping"),
        ({"agents": "multi"}, "config: agents: unknown key; expected one of seed, out, env, "),
        ({"evn": {"agents": "multi"}}, "config: evn: unknown key; did you mean env?"),
        ({"env": {}, "env.wait": True}, "config: env.wait: unknown key; "),
        ({3: {}}, "config: 3: unknown key; "),
        (None, "expected a path, a mapping or a Config"),
        (5, "expected a path, a mapping or a Config"),
        (SimpleNamespace(env=3), "expected a path, a mapping or a Config"),
        ("no/such/file.yaml", "no/such/file.yaml: cannot be read"),
    ],
)
def test_configs_that_cannot_be_used(config: Any, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        marouting.make(config)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("env: {turn_ordr: x}\n", "config.yaml: env: turn_ordr: unknown key; did you mean"),
        ("evn:\n  agents: multi\n", "config.yaml: evn: unknown key; did you mean env"),
        ("env:\n  - [\n", r"config.yaml:\d+: expected YAML"),
        ("- 1\n", "config.yaml: expected a mapping"),
        ("env: !!python/object:os.system {}\n", "config.yaml:1: expected YAML"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        marouting.make(tmp_path / "config.yaml")
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)


def test_a_problem_with_nothing_to_route() -> None:
    dot = Problem((2, 1, 1), (1,), (1,), (Net("A", 0, (Pin(0, 0, 1),)),), (1,), (0,), (0,))
    for make in MAKERS.values():
        with pytest.raises(InputError, match="expected a net with pins in two Gcells"):
            make(problem=dot)


# --- steps that cannot be made --------------------------------------------------------------------


def aec_steps(problem: Problem) -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    env = global_routing_v0.raw_env(problem)
    return env.reset, env.step


def wrapped_steps(problem: Problem) -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    env = global_routing_v0.env(problem)
    return env.reset, env.step


def parallel_steps(problem: Problem) -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    env = global_routing_v0.parallel_env(problem)
    return env.reset, lambda action: env.step(dict.fromkeys(env.agents, action))


def single_steps(problem: Problem) -> tuple[Callable[[], Any], Callable[[Any], Any]]:
    env = single_env(problem)
    return env.reset, env.step


STEPS = {
    "raw_env": aec_steps,
    "env": wrapped_steps,
    "parallel": parallel_steps,
    "single": single_steps,
}


@pytest.mark.parametrize("face", STEPS)
def test_the_same_actions_are_accepted_everywhere(face: str) -> None:
    reset, step = STEPS[face](generate(1, nets=2)[0])
    for action in (4, np.int8(4), np.int64(4), np.array(4), True):
        reset()
        step(action)
    wrong: list[Any] = [
        6, -1, 1.0, 1.5, np.float32(1), np.array([1]), np.array(1.0), "1", None,
        # Before 2.3, NumPy itself takes its True for an integer.
        *([np.bool_(True)] if np.lib.NumpyVersion(np.__version__) >= "2.3.0" else []),
    ]  # fmt: skip
    for action in wrong:
        reset()
        # PettingZoo's wrappers of `env` assert.
        with pytest.raises(AssertionError if face == "env" else ValueError, match=r"action"):
            step(action)


@pytest.mark.parametrize("face", ["raw_env", "parallel", "single"])
def test_a_step_needs_an_episode(face: str) -> None:
    _, step = STEPS[face](generate(1, nets=2)[0])
    with pytest.raises(ResetNeeded, match=r"expected a call of reset\(\)"):
        step(0)
    if face == "raw_env":
        with pytest.raises(ResetNeeded, match=r"expected a call of reset\(\)"):
            global_routing_v0.raw_env({"nets": 2}).observe("net_0")


def test_an_episode_that_is_over_changes_no_more() -> None:
    problem = generate(1, nets=2)[0]

    def figures(env: Any) -> Any:
        return env.metrics(), env.solution()

    aec = global_routing_v0.raw_env(problem, max_steps=3)
    aec.reset()
    while aec.agents:
        agent = aec.agent_selection
        aec.step(None if aec.terminations[agent] or aec.truncations[agent] else U)
    last = figures(aec)
    for action in (U, None):
        with pytest.raises(ResetNeeded):
            aec.step(action)
    assert figures(aec) == last

    parallel = global_routing_v0.parallel_env(problem, max_steps=3)
    parallel.reset()
    while parallel.agents:
        parallel.step(dict.fromkeys(parallel.agents, U))
    last = figures(parallel)
    assert parallel.step({}) == parallel.step({"net_0": U}) == ({}, {}, {}, {}, {})
    assert figures(parallel) == last

    single: Any = single_env(problem, max_steps=3)
    single.reset()
    while not any(single.step(U)[2:4]):
        pass
    last = figures(single)
    with pytest.warns(UserWarning, match="the episode is over"):
        _, reward, terminated, truncated, _ = single.step(U)
    assert (reward, terminated, truncated) == (0, False, True)
    assert figures(single) == last


# --- the end of a task ----------------------------------------------------------------------------


def check_task_end(info: dict[str, Any], reward: float) -> bool:
    """Whether the info after a move tells that a task ended; the reward says which were joined."""
    if "task_ended" not in info:
        assert reward == -1
        assert "task_obs" not in info
        return False
    joined = info["task_ended"] == 1
    assert reward == (100 if joined else -1)
    assert info["task_obs"][3:6].any() != joined  # the way to the target
    assert info["task_mask"].shape == (6,)
    return True


MULTI = generate(1, grid=(4, 4, 2), nets=5, max_pins=4, capacity=2, seed=3)[0]


@pytest.mark.parametrize("turn_order", ["sequential", "round_robin"])
def test_the_end_of_a_task_shows_in_the_info(turn_order: str) -> None:
    options = {"turn_order": turn_order, "max_steps": 15}
    single = gymnasium.make(marouting.ENVIRONMENT_ID, problem=MULTI, **options)
    rng = np.random.default_rng(1)
    _, info = single.reset(seed=0)
    ends, over = 0, False
    while not over:
        move = rng.choice(np.flatnonzero(info["action_mask"]))
        _, reward, terminated, truncated, info = single.step(int(move))
        ends += check_task_end(info, float(reward))
        over = terminated or truncated
    assert ends == info["tasks"]
    for persists in (False, True):
        env = global_routing_v0.env(MULTI, agents_persist=persists, **options)
        env.reset(seed=0)
        ends = 0
        first = set(env.agents)
        for agent in env.agent_iter():
            _, reward, terminated, truncated, info = env.last()
            done = terminated or truncated
            if agent in first:  # has not moved yet
                first.remove(agent)
            else:
                ends += check_task_end(info, reward)
            mask = info["action_mask"]
            env.step(None if done else int(rng.choice(np.flatnonzero(mask))))
        assert ends == info["tasks"]
