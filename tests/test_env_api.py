"""The environment passes the checks of PettingZoo, Gymnasium and SuperSuit.

What they miss is in test_env.py. Not used of PettingZoo's: ``bombardment_test``, which is broken in
itself, and ``test_save_obs``, whose import pytest would take for a test of ours.
"""

import importlib
import warnings
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
import supersuit
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
    state_test,
)
from pettingzoo.test.performance_benchmark import performance_benchmark
from pettingzoo.utils import aec_to_parallel

from marouting import ENVIRONMENT_ID, Net, Pin, Problem, global_routing_v0

FORMS: dict[str, dict[str, Any]] = {
    "default": {},
    "sequential": {"turn_order": "sequential"},
    "overflow": {"overflow": "allowed", "reward": {"overflow_price": 1.5, "own_edge": 0.0}},
    "multi-pin": {"problem": {"nets": 6, "max_pins": 5, "capacity": 2}, "max_steps": 12},
    "drawn": {"problem": {"nets": 5, "seed": None}},
    "one net": {"problem": {"nets": 1}},
}
WITH_MASK: dict[str, Any] = {"mask": {"in_observation": True}}

forms = pytest.mark.parametrize("options", FORMS.values(), ids=FORMS)


@pytest.fixture
def no_warnings() -> Iterator[None]:
    """Every warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows cannot be opened here."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


# PettingZoo -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_warnings")
@forms
@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.raw_env])
def test_aec_api(make: Callable[..., Any], options: dict[str, Any]) -> None:
    api_test(make(**options), num_cycles=150)


def test_aec_api_with_the_mask_in_the_observation() -> None:
    """The check knows dict observations by a list of PettingZoo's own environments: it warns."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        api_test(global_routing_v0.env(**WITH_MASK), num_cycles=150)
    assert {str(warning.message) for warning in caught} == {
        "Observation is not a NumPy array",
        "Observation space for each agent probably should be gymnasium.spaces.box "
        "or gymnasium.spaces.discrete",
    }


@pytest.mark.usefixtures("no_warnings")
@pytest.mark.parametrize("options", [*FORMS.values(), WITH_MASK], ids=[*FORMS, "mask"])
def test_parallel_api(options: dict[str, Any]) -> None:
    parallel_api_test(global_routing_v0.parallel_env(**options), num_cycles=600)


@pytest.mark.usefixtures("no_warnings")
@forms
def test_seeds(options: dict[str, Any]) -> None:
    seed_test(lambda: global_routing_v0.env(**options), num_cycles=60)
    parallel_seed_test(lambda: global_routing_v0.parallel_env(**options), num_cycles=60)


@pytest.mark.usefixtures("no_warnings")
@forms
def test_state(options: dict[str, Any]) -> None:
    state_test(global_routing_v0.env(**options), global_routing_v0.parallel_env(**options))


@pytest.mark.usefixtures("no_display")
def test_rendering() -> None:
    """Without a display ``human`` warns once an environment, and the game goes on."""
    with pytest.warns(UserWarning, match="cannot open a window") as caught:
        render_test(global_routing_v0.env)
    assert len(caught) == 1


@pytest.mark.usefixtures("no_warnings")
def test_performance_benchmark(monkeypatch: pytest.MonkeyPatch) -> None:
    """It plays for five seconds; here a second passes each time that it looks at the clock."""
    seconds = iter(range(100))
    module = importlib.import_module("pettingzoo.test.performance_benchmark")
    monkeypatch.setattr(module, "time", SimpleNamespace(time=lambda: next(seconds)))
    performance_benchmark(global_routing_v0.env())


def test_max_cycles() -> None:
    """PettingZoo's check of ``max_cycles``, which is not an option here.

    The steps of a task are limited (``max_steps``), an episode lasts as long as its tasks, and
    agents may arrive before: the check holds where each agent has one task, further than the
    limit, so that all are truncated by it.
    """
    far = [Net(f"n{i}", i, (Pin(0, i, 1), Pin(7, i, 1))) for i in range(6)]
    problem = Problem((8, 8, 1), (9,), (9,), tuple(far), (1,), (0,), (0,))

    def in_terms_of_max_steps(make: Callable[..., Any]) -> Callable[..., Any]:
        return lambda max_cycles: make(problem, max_steps=max_cycles)

    max_cycles_test(
        SimpleNamespace(
            env=in_terms_of_max_steps(global_routing_v0.env),
            parallel_env=in_terms_of_max_steps(global_routing_v0.parallel_env),
        )
    )


def test_observations_are_not_taken_for_pictures() -> None:
    """What ``test_save_obs`` is about: it saves observations that are boxes from 0 to 255."""
    env = global_routing_v0.env()
    env.reset()
    with pytest.raises(AssertionError, match="0 to 255"):
        importlib.import_module("pettingzoo.test.save_obs_test").check_save_obs(env)


@pytest.mark.parametrize("options", [{}, {"agents_persist": True}, {"turn_order": "sequential"}])
def test_what_is_said_about_parallel_is_true(options: dict[str, Any]) -> None:
    """PettingZoo's conversion fails, and the environment says so beforehand."""
    assert global_routing_v0.parallel_env(**options).metadata["is_parallelizable"]
    env = global_routing_v0.env(problem={"nets": 5}, **options)
    assert not env.metadata["is_parallelizable"]
    with pytest.raises(AssertionError, match="not generally safe"):
        aec_to_parallel(env)
    env.unwrapped.metadata = env.metadata | {"is_parallelizable": True}
    converted = aec_to_parallel(env)
    converted.reset()

    def play() -> None:
        for _ in range(60):
            converted.step(dict.fromkeys(converted.agents, 0))

    with pytest.raises((AssertionError, ValueError)):
        play()


# Gymnasium --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_display")
@pytest.mark.parametrize("options", [*FORMS.values(), WITH_MASK], ids=[*FORMS, "mask"])
def test_gymnasium_checker(options: dict[str, Any]) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make(ENVIRONMENT_ID, **options).unwrapped)
    # It renders in all modes, of which "human" finds no display.
    (warning,) = caught
    assert "cannot open a window" in str(warning.message)


@pytest.mark.usefixtures("no_warnings")
def test_gymnasium_vector() -> None:
    envs = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=3, problem={"nets": 3}, max_steps=5)
    observations, infos = envs.reset(seed=1)
    over = 0
    for _ in range(100):
        assert envs.observation_space.contains(observations)
        assert infos["action_mask"].shape == (3, 6)
        observations, _, terminations, truncations, infos = envs.step(envs.action_space.sample())
        over += int((terminations | truncations).sum())
    assert over >= 3 * 4
    envs.close()


# Registries -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_warnings")
def test_gymnasium_registry() -> None:
    env = gymnasium.make(ENVIRONMENT_ID, problem={"nets": 3}, turn_order="round_robin")
    env.reset(seed=0)
    assert env.spec is not None
    assert env.spec.id == "marouting/GlobalRouting-v0"
    nets = [env.step(env.action_space.sample())[4]["net"] for _ in range(3)]
    assert sorted(nets) == ["net_0", "net_1", "net_2"]


@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="this PettingZoo has no registry")
@pytest.mark.usefixtures("no_warnings")
def test_pettingzoo_registry() -> None:
    aec = pettingzoo.make("aec", ENVIRONMENT_ID, problem={"nets": 3})
    aec.reset(seed=0)
    assert isinstance(aec.unwrapped, global_routing_v0.raw_env)
    assert aec.agents == ["net_0", "net_1", "net_2"]
    parallel = pettingzoo.make("parallel", ENVIRONMENT_ID, problem={"nets": 3})
    parallel.reset(seed=0)
    assert isinstance(parallel.unwrapped, global_routing_v0.parallel_env)
    assert parallel.agents == ["net_0", "net_1", "net_2"]


# SuperSuit --------------------------------------------------------------------------------------

OPTIONS: dict[str, Any] = {
    "problem": {"nets": 8, "max_pins": 3, "capacity": 2},
    "max_steps": 10,
    "overflow": "allowed",
    "reward": {"overflow_price": 0.5},
}


@pytest.mark.usefixtures("no_warnings")
def test_supersuit_vector_rollout() -> None:
    """The form that SuperSuit supports: ``black_death_v3`` keeps the dead in the game, as zeros.

    It ends an episode one step after the last death, with a step that nobody moves in: every
    agent that ends is either terminated or truncated, and it waits for both.
    """
    form = supersuit.black_death_v3(global_routing_v0.parallel_env(**OPTIONS))
    envs = supersuit.concat_vec_envs_v1(supersuit.pettingzoo_env_to_vec_env_v1(form), 2, num_cpus=0)
    plain = [global_routing_v0.parallel_env(**OPTIONS) for _ in range(2)]
    names = plain[0].possible_agents
    observations, _ = envs.reset(seed=0)
    seen = [env.reset()[0] for env in plain]
    rng = np.random.default_rng(0)
    episodes = 0
    for _ in range(400):
        for row, found in enumerate(observations):
            env, agent = divmod(row, len(names))
            expected = seen[env].get(names[agent], np.zeros(12))
            np.testing.assert_array_equal(found, expected)
        actions = rng.integers(6, size=envs.num_envs)
        observations, rewards, terminations, _, _ = envs.step(actions)
        for index, env in enumerate(plain):
            rows = slice(index * len(names), (index + 1) * len(names))
            own = dict(zip(names, actions[rows].tolist(), strict=True))
            over = not env.agents
            seen[index], paid, *_ = env.step({agent: own[agent] for agent in env.agents})
            assert rewards[rows].tolist() == [paid.get(agent, 0.0) for agent in names]
            assert terminations[rows].tolist() == [over] * len(names)
            if over:
                episodes += 1
                seen[index], _ = env.reset()
    assert episodes >= 20
    envs.close()


@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.parallel_env])
def test_supersuit_skips_frames(make: Callable[..., Any]) -> None:
    """It asks environments for their random numbers."""
    env = supersuit.frame_skip_v0(make(**OPTIONS), 3)
    env.reset(seed=1)
    parallel = env.unwrapped.metadata["is_parallelizable"]
    for _ in range(3 * len(env.possible_agents)):
        env.step(dict.fromkeys(env.agents, 0) if parallel else 0)
    assert env.unwrapped.metrics()["steps"] > 3 * len(env.possible_agents)
    draws = []
    for _ in range(2):
        env.reset(seed=1)
        draws.append(env.unwrapped.np_random.random())
    assert draws[0] == draws[1]


def test_supersuit_takes_agents_that_stay() -> None:
    """Without black_death_v3: agents end one by one for themselves, and together for it."""
    env = global_routing_v0.parallel_env(**OPTIONS, agents_persist=True)
    envs = supersuit.concat_vec_envs_v1(supersuit.pettingzoo_env_to_vec_env_v1(env), 2, num_cpus=0)
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(200):
        _, _, terminated, truncated, _ = envs.step(rng.integers(6, size=envs.num_envs))
        over = (terminated | truncated).reshape(2, -1)
        assert (over.all(axis=1) == over.any(axis=1)).all()
        ends += int(over.all(axis=1).sum())
    assert ends >= 4
    envs.close()


def test_supersuit_refuses_agents_that_die_without_black_death() -> None:
    """The wrapper above is needed: nets arrive at different times."""
    envs = supersuit.pettingzoo_env_to_vec_env_v1(global_routing_v0.parallel_env(**OPTIONS))
    envs.reset(seed=0)

    def play() -> None:
        for _ in range(100):
            envs.step(np.array([envs.action_space.sample() for _ in range(envs.num_envs)]))

    with pytest.raises(AssertionError, match=r"black_death|agent death"):
        play()


def test_an_action_that_is_missing_is_named() -> None:
    env = global_routing_v0.parallel_env()
    env.reset(seed=0)
    with pytest.raises(KeyError, match="step: expected an action for net_0"):
        env.step({})
