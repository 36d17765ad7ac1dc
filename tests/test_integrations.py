"""What is made for single libraries; each test runs where its library is installed."""

import csv
import importlib.util
import json
import pickle
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from conftest import in_this_process
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from marouting import ENVIRONMENT_ID, InputError, PaperObservation, generate, global_routing_v0
from marouting.game import NOBODY, Status
from marouting.vector import BatchEnv
from policies.cli.main import status
from policies.experiment import experiment


class Seen(PaperObservation):
    """Known to nobody, like any subclass: games are played in parts."""


PROBLEM = generate(1, grid=(4, 4, 2), nets=4, max_pins=3, seed=3)[0]
SET = [PROBLEM, generate(1, grid=(4, 4, 2), nets=3, seed=4)[0]]


# Gymnasium's vectors ------------------------------------------------------------------------------


def assert_same(mine: object, theirs: object) -> None:
    if isinstance(theirs, dict):
        assert isinstance(mine, dict)
        assert set(mine) == set(theirs)
        for key in theirs:
            assert_same(mine[key], theirs[key])
        return
    found, expected = np.asarray(mine), np.asarray(theirs)
    assert found.dtype == expected.dtype
    assert found.shape == expected.shape
    if expected.dtype == object and expected.ndim:
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other)
        return
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"mask": {"in_observation": True, "mask_key": "mask"}},
        {"turn_order": "round_robin"},
        {"overflow": "allowed", "reward": {"overflow_price": 2}},
        {"observation": Seen(), "reward": "team"},
        {"problem": None, "scenario": "toy-4x4-v0", "max_steps": 4},
    ],
)
def test_the_vector_is_that_of_single_environments(
    options: dict[str, object], mode: AutoresetMode
) -> None:
    """In all that it gives, down to the types."""
    options = {"problem": PROBLEM, "max_steps": 6, **options}
    quick = gymnasium.make_vec(ENVIRONMENT_ID, 3, autoreset_mode=mode, **options)
    plain = gymnasium.make_vec(
        ENVIRONMENT_ID,
        3,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **options,
    )
    assert type(quick).__name__ == "GlobalRoutingVector"
    assert quick.metadata["autoreset_mode"] == plain.metadata["autoreset_mode"] == mode
    assert quick.single_observation_space == plain.single_observation_space
    assert quick.action_space == plain.action_space
    rng = np.random.default_rng(0)
    ends = 0
    seeds: list[object] = [1, [5, 3, 5], [None, 4, None], None, 1]
    for seed in seeds:
        for mine, theirs in zip(quick.reset(seed=seed), plain.reset(seed=seed), strict=True):
            assert_same(mine, theirs)
        for _ in range(60):
            moves = rng.integers(6, size=3)
            found, expected = quick.step(moves), plain.step(moves)
            for mine, theirs in zip(found, expected, strict=True):
                assert_same(mine, theirs)
            assert quick.observation_space.contains(found[0])
            over = found[2] | found[3]
            ends += int(over.sum())
            if mode is AutoresetMode.DISABLED and over.any():
                both = [
                    vector.reset(options={"reset_mask": over.copy()}) for vector in (quick, plain)
                ]
                for mine, theirs in zip(*both, strict=True):
                    assert_same(mine, theirs)
    assert ends >= 12
    quick.close()
    plain.close()


def test_some_games_of_the_vector_begin_again_with_seeds_of_their_own() -> None:
    options = {"scenario": "toy-4x4-v0", "max_steps": 4}
    quick = gymnasium.make_vec(ENVIRONMENT_ID, 3, **options)
    plain = gymnasium.make_vec(ENVIRONMENT_ID, 3, vectorization_mode="sync", **options)
    for vector in (quick, plain):
        vector.reset(seed=[2, 2, 9])
    both = [
        vector.reset(seed=[7, 8, 9], options={"reset_mask": np.array([True, False, True])})
        for vector in (quick, plain)
    ]
    for mine, theirs in zip(*both, strict=True):
        assert_same(mine, theirs)
    assert both[0][1]["_net"].tolist() == [True, False, True]


def test_the_vector_draws_problems() -> None:
    env = gymnasium.make_vec(ENVIRONMENT_ID, 3, scenario="toy-4x4-v0", max_steps=4)
    _, first = env.reset()
    played = set(first["problem"])
    assert len(played) == 3
    for _ in range(200):
        *_, infos = env.step(np.zeros(3, np.int64))
        if "problem" in infos:
            found = infos["problem"][infos["_problem"]].tolist()
            assert not played & set(found)
            played |= set(found)
    assert len(played) > 6
    twin = pickle.loads(pickle.dumps(env))
    for _ in range(60):
        for mine, theirs in zip(
            *(vector.step(np.zeros(3, np.int64)) for vector in (twin, env)), strict=True
        ):
            assert_same(mine, theirs)
    seeds = [env.reset(seed=seed)[1]["problem"].tolist() for seed in (5, 5, [5, 6, 7], [7, 6, 5])]
    assert seeds[0] == seeds[1] == seeds[2] == seeds[3][::-1]


def test_a_vector_that_nobody_resets_goes_no_further() -> None:
    env = gymnasium.make_vec(
        ENVIRONMENT_ID, 2, problem=PROBLEM, max_steps=1, autoreset_mode="Disabled"
    )
    env.reset()
    over = np.zeros(2, np.bool_)
    while not over.any():
        *_, terminated, truncated, _ = env.step(np.zeros(2, np.int64))
        over = terminated | truncated
    with pytest.raises(ResetNeeded, match=r"expected a call of reset\(\) for games \[0, 1\]"):
        env.step(np.zeros(2, np.int64))


def test_the_vector_says_what_it_cannot_use() -> None:
    for options, message in (
        ({"render_mode": "human"}, "render_mode: expected ansi, rgb_array or None"),
        ({"agents_persist": True}, "agents_persist: expected false"),
        ({"frameskip": 4}, "frameskip: unknown key"),
        ({"max_episode_steps": 4}, "max_episode_steps: expected nothing: .*sync"),
        ({"autoreset_mode": "Later"}, "autoreset_mode: expected one of NEXT_STEP, SAME_STEP"),
    ):
        with pytest.raises(InputError, match=message):
            gymnasium.make_vec(ENVIRONMENT_ID, 2, **options)
    env = gymnasium.make_vec(ENVIRONMENT_ID, 2, problem=PROBLEM, render_mode="ansi")
    env.reset()
    for actions, found in (([0, -1], "-1"), ([6, 0], "6")):
        with pytest.raises(ValueError, match=f"actions: expected 0 to 5, found {found}$"):
            env.step(np.array(actions))
    for wrong in (None, [None, 1], "ab", [0.0, 0.0], [0], [[0, 1]]):
        with pytest.raises(ValueError, match=r"actions: expected integers of shape \(2,\), found"):
            env.step(wrong)
    with pytest.raises(ValueError, match="seed: expected one, or 2 of them"):
        env.reset(seed=[1, 2, 3])
    pictures = env.render()
    assert pictures is not None
    assert len(pictures) == 2


def test_some_games_of_a_batch_begin_again() -> None:
    env = BatchEnv([PROBLEM] * 3, threads=2, max_steps=5)
    assert env.num_envs == 3
    assert env.single_action_space == gymnasium.spaces.Discrete(6)
    first, info = env.reset(seed=1)
    first, start = first.copy(), info["action_mask"].copy()
    rng = np.random.default_rng(0)
    for _ in range(3):
        obs, _, _, _, info = env.step(rng.integers(6, size=(3, env.num_agents)))
    kept = obs.copy()
    obs, info = env.reset(options={"reset_mask": np.array([True, False, True])})
    np.testing.assert_array_equal(obs[[0, 2]], first[[0, 2]])
    np.testing.assert_array_equal(info["action_mask"][[0, 2]], start[[0, 2]])
    np.testing.assert_array_equal(obs[1], kept[1])
    assert info["steps"][1] > 0 == info["steps"][0]
    with pytest.raises(ValueError, match="reset_mask: expected 3 booleans"):
        env.reset(options={"reset_mask": [True]})
    env.close()
    env.step(rng.integers(6, size=(3, env.num_agents)))
    env.close()


# Stable-Baselines3 --------------------------------------------------------------------------------


def test_sb3_steps_the_games_of_the_parallel_environment() -> None:
    """Two games side by side, each against one of its own: rewards, ends, observations, masks."""
    pytest.importorskip("stable_baselines3")
    from policies.integrations.sb3 import RoutingVecEnv

    env = RoutingVecEnv([PROBLEM] * 2, max_steps=6, reward="normalised")
    plain = [
        global_routing_v0.parallel_env(
            PROBLEM, max_steps=6, reward="normalised", agents_persist=True
        )
        for _ in range(2)
    ]
    names = plain[0].possible_agents
    assert env.num_envs == 2 * len(names)
    obs = env.reset()
    seen = [game.reset() for game in plain]
    rng = np.random.default_rng(0)
    paid, moves_made = np.zeros(env.num_envs), np.zeros(env.num_envs)
    ends = 0
    for _ in range(120):
        masks = np.stack(env.env_method("action_masks"))
        for row in range(env.num_envs):
            game, agent = divmod(row, len(names))
            there, infos = seen[game]
            active = infos[names[agent]].get("active", True)
            np.testing.assert_array_equal(obs[row], there[names[agent]] if active else np.zeros(12))
            assert masks[row].tolist() == infos[names[agent]]["action_mask"].astype(bool).tolist()
        moves = rng.integers(6, size=env.num_envs)
        was_active = [
            seen[r // len(names)][1][names[r % len(names)]].get("active", True) for r in range(8)
        ]
        obs, rewards, dones, infos = env.step(moves)
        for game, one in enumerate(plain):
            rows = range(game * len(names), (game + 1) * len(names))
            there, pay, ended, _, told = one.step(
                dict(zip(names, moves[list(rows)].tolist(), strict=True))
            )
            for row, name in zip(rows, names, strict=True):
                assert rewards[row] == np.float32(pay[name])
                paid[row] += pay[name]
                moves_made[row] += was_active[row]
                over = was_active[row] and not (one.agents and told[name]["active"])
                assert dones[row] == (over or not one.agents)  # a wait ends with the game
                if not over:
                    assert infos[row] == {}
                    continue
                ends += 1
                episode = infos[row]["episode"]
                assert episode["r"] == pytest.approx(paid[row], abs=1e-5)
                assert episode["l"] == moves_made[row]
                if not one.agents:
                    joined = bool(ended[name])
                    assert infos[row]["is_success"] == joined
                    assert infos[row]["TimeLimit.truncated"] == (not joined)
                np.testing.assert_array_equal(
                    infos[row]["terminal_observation"][:3], there[name][:3]
                )
            if not one.agents:
                paid[list(rows)] = moves_made[list(rows)] = 0
                seen[game] = one.reset()
            else:
                seen[game] = there, told
    assert ends >= 20
    env.close()


@pytest.mark.parametrize("persists", [False, True])
def test_sb3_pays_agents_that_wait_only_if_they_stay(persists: bool) -> None:
    pytest.importorskip("stable_baselines3")
    from policies.integrations.sb3 import RoutingVecEnv

    env = RoutingVecEnv([PROBLEM] * 2, max_steps=6, reward="team", agents_persist=persists)
    env.reset()
    rng = np.random.default_rng(0)
    paid = ends = silent = 0
    for _ in range(60):
        waits = env.batch.engine.agents["status"].ravel() != Status.ACTIVE
        _, rewards, dones, infos = env.step(rng.integers(6, size=env.num_envs))
        for row in np.flatnonzero(dones):
            if infos[row]:  # as it waited, it saw zeros
                assert infos[row]["terminal_observation"].any() == (not waits[row])
        paid += np.abs(rewards[waits]).sum()
        ends += dones.sum()
        silent += sum(not info for done, info in zip(dones, infos, strict=True) if done)
    assert ends > silent
    assert (paid > 0) == persists == (silent == 0)
    env.close()


def test_sb3_with_one_player_for_a_game() -> None:
    pytest.importorskip("stable_baselines3")
    from policies.integrations.sb3 import RoutingVecEnv

    env = RoutingVecEnv([PROBLEM] * 2, max_steps=6, everyone=False)
    plain = [gymnasium.make(ENVIRONMENT_ID, problem=PROBLEM, max_steps=6) for _ in range(2)]
    obs = env.reset()
    seen = [one.reset() for one in plain]
    rng = np.random.default_rng(0)
    for _ in range(200):
        np.testing.assert_array_equal(obs, [there for there, _ in seen])
        masks = [info["action_mask"].astype(bool) for _, info in seen]
        np.testing.assert_array_equal(env.env_method("action_masks"), masks)
        moves = rng.integers(6, size=2)
        obs, rewards, dones, infos = env.step(moves)
        for m, one in enumerate(plain):
            there, pay, terminated, truncated, told = one.step(int(moves[m]))
            assert rewards[m] == np.float32(pay)
            assert dones[m] == (terminated or truncated)
            if dones[m]:
                assert infos[m]["TimeLimit.truncated"] == truncated
                assert infos[m]["is_success"] == told["is_success"]
                np.testing.assert_array_equal(infos[m]["terminal_observation"], there)
                seen[m] = one.reset()
            else:
                seen[m] = there, told


def test_sb3_adds_up_what_trainings_took(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    from policies.integrations.sb3 import Policy, RoutingVecEnv, save

    def steps(model: PPO, name: str) -> int:
        save(model, tmp_path / name)
        taken: int = Policy(str(tmp_path / name)).training["agent_steps"]
        return taken

    envs = [RoutingVecEnv([PROBLEM], max_steps=6) for _ in range(2)]
    model = PPO("MlpPolicy", envs[0], n_steps=8, batch_size=8, n_epochs=1, device="cpu").learn(64)
    first = envs[0].taken.agent_steps
    assert steps(model, "a.zip") == steps(model, "a.zip") == first > 0
    later = PPO.load(tmp_path / "a.zip", env=envs[1], device="cpu").learn(96)
    own = envs[1].taken.agent_steps
    assert steps(later, "b.zip") == steps(later, "b.zip") == first + own > first
    later.learn(64)
    assert steps(later, "b.zip") == envs[1].taken.agent_steps > first + own
    with pytest.raises(InputError, match=r"^autoreset: expected none: games that are over begin"):
        RoutingVecEnv([PROBLEM], autoreset=True)
    with pytest.raises(InputError, match=r"^play_once: expected none: games that are over begin"):
        RoutingVecEnv([PROBLEM], play_once=True)
    plain = PPO("MlpPolicy", gymnasium.make(ENVIRONMENT_ID, problem=PROBLEM), n_steps=8)
    with pytest.raises(InputError, match="model: expected one with a RoutingVecEnv"):
        save(plain, tmp_path / "c.zip")


def test_sb3_draws_from_problems_given_as_objects() -> None:
    pytest.importorskip("stable_baselines3")
    from policies.integrations.sb3 import RoutingVecEnv

    for problem in (PROBLEM, [PROBLEM, PROBLEM]):
        env = RoutingVecEnv(2, problem=problem, max_steps=6)
        assert env.reset().shape == (2 * len(PROBLEM.nets), 12)
        assert env.taken.options["max_steps"] == 6
        assert "problem" not in env.taken.options


@pytest.mark.parametrize("everyone", [True, False])
def test_sb3_learners_take_it(everyone: bool) -> None:
    pytest.importorskip("sb3_contrib")
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.utils import is_masking_supported
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor

    from policies.integrations.sb3 import RoutingVecEnv

    for learner in (PPO, MaskablePPO):
        env = RoutingVecEnv([PROBLEM] * 2, everyone=everyone, reward="normalised", max_steps=6)
        assert is_masking_supported(env)
        model = learner("MlpPolicy", env, n_steps=64, batch_size=64, device="cpu").learn(600)
        assert len(model.ep_info_buffer) > 5
        assert len(model.ep_success_buffer) > 5
    learner("MlpPolicy", VecMonitor(env), n_steps=64, batch_size=64, device="cpu").learn(200)


# TorchRL and BenchMARL ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "options", "wrapped"),
    [
        (global_routing_v0.parallel_env, {"agents_persist": True}, {}),
        (global_routing_v0.parallel_env, {"agents_persist": True}, {"return_state": True}),
        (global_routing_v0.parallel_env, {"rip_up": {"choose": "agents"}}, {}),
        (
            global_routing_v0.parallel_env,
            {"mask": {"in_observation": True}, "rip_up": {"rounds": 1}},
            {},
        ),
        (global_routing_v0.parallel_env, {"problem": SET, "agents_persist": True}, {}),
        (global_routing_v0.parallel_env, {}, {"use_mask": True}),
        (global_routing_v0.env, {"agents_persist": True}, {"use_mask": True}),
        (global_routing_v0.env, {"problem": SET, "agents_persist": True}, {"use_mask": True}),
    ],
)
@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrl_wraps_the_pettingzoo_environments(
    make: Callable[..., Any], options: dict[str, Any], wrapped: dict[str, Any]
) -> None:
    pytest.importorskip("torchrl")
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    inner = make(**{"problem": PROBLEM, "max_steps": 6, **options})
    env = PettingZooWrapper(inner, **wrapped)
    check_env_specs(env)
    stays = "agents_persist" in options or "rip_up" in options
    for _ in range(4):
        td = env.rollout(500)
        assert td["next", "done"].squeeze(-1).tolist() == [False] * (len(td) - 1) + [True]
        assert inner.unwrapped.metrics()["steps"] > 0
        assert not stays or inner.unwrapped.game.turn == NOBODY


def test_torchrl_steps_the_games_of_the_parallel_environment() -> None:
    pytest.importorskip("torchrl")
    import torch
    from torchrl.envs.utils import check_env_specs

    from policies.integrations.torchrl import RoutingEnv

    options = {"max_steps": 6, "reward": "normalised"}
    env = RoutingEnv([PROBLEM] * 2, state=True, **options)
    check_env_specs(env)
    plain = [global_routing_v0.parallel_env(PROBLEM, agents_persist=True, **options) for _ in "ab"]
    names = plain[0].possible_agents
    td = env.reset()
    seen = [one.reset() for one in plain]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(60):
        for m, (one, (there, infos)) in enumerate(zip(plain, seen, strict=True)):
            for n, name in enumerate(names):
                active = infos[name].get("active", True)
                expected = there[name] if active else np.zeros(12)
                np.testing.assert_array_equal(td["nets", "observation"][m, n], expected)
                mask = td["nets", "action_mask"][m, n].tolist()
                assert mask == infos[name]["action_mask"].astype(bool).tolist()
            np.testing.assert_array_equal(td["state"][m], one.state())
        moves = rng.integers(6, size=(2, len(names)))
        td["nets", "action"] = torch.from_numpy(moves)
        td = env.step(td)["next"]
        over = []
        for m, one in enumerate(plain):
            there, pay, *_, infos = one.step(dict(zip(names, moves[m].tolist(), strict=True)))
            assert td["nets", "reward"][m, :, 0].tolist() == np.float32(list(pay.values())).tolist()
            metrics = one.metrics()
            assert td["info", "joined"][m].item() == np.float32(
                metrics["joined"] / metrics["tasks"]
            )
            assert td["info", "wirelength"][m].item() == metrics["wirelength"]
            over.append(not one.agents)
            seen[m] = there, infos
        assert td["done"].flatten().tolist() == td["terminated"].flatten().tolist() == over
        if any(over):
            ends += 1
            td["_reset"] = td["done"].clone()
            td = env.reset(td)
            seen = [one.reset() if o else s for one, o, s in zip(plain, over, seen, strict=True)]
    assert ends >= 4


def test_torchrl_draws_from_problems_given_as_objects() -> None:
    pytest.importorskip("torchrl")
    from policies.integrations.torchrl import RoutingEnv

    for problem in (PROBLEM, [PROBLEM, PROBLEM]):
        env = RoutingEnv(2, problem=problem, max_steps=6)
        assert env.rollout(3)["nets", "observation"].shape == (2, 3, len(PROBLEM.nets), 12)
        assert "problem" not in env.taken.saved()["options"]
    with pytest.raises(InputError, match=r"^autoreset: expected none: TorchRL resets"):
        RoutingEnv(2, problem=PROBLEM, autoreset=True)
    with pytest.raises(InputError, match=r"^play_once: expected none: TorchRL resets"):
        RoutingEnv(2, problem=PROBLEM, play_once=True)
    with pytest.raises(InputError, match=r"^everyone: expected true: every net has a row"):
        RoutingEnv(2, problem=PROBLEM, everyone=False)


def test_torchrl_files_that_hold_no_policy_are_refused(tmp_path: Path) -> None:
    """Other archives, such as models of Stable-Baselines3, text, and objects of another kind."""
    pytest.importorskip("torchrl")
    from policies.integrations.torchrl import Policy

    with zipfile.ZipFile(tmp_path / "archive", "w") as archive:
        archive.writestr("data", "{}")
    (tmp_path / "text").write_text("hello")
    (tmp_path / "empty").write_bytes(b"")
    torch.save({"policy": 1}, tmp_path / "other")
    saved = "expected a policy that policies.integrations.torchrl.save has saved"
    for name in ("archive", "text", "empty", "other"):
        with pytest.raises(InputError, match=rf"{name}: {saved}$"):
            Policy(str(tmp_path / name))
    with pytest.raises(InputError, match=r"missing: cannot be read: No such file"):
        Policy(str(tmp_path / "missing"))


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
@pytest.mark.parametrize("interface", ["parallel_env", "env"])
def test_torchrl_wraps_pettingzoo_only_with_agents_that_persist(interface: str) -> None:
    """As docs/libraries.md says: which options are needed, and what happens without them."""
    pytest.importorskip("torchrl")
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    def wrapped(**options: object) -> PettingZooWrapper:
        known = {name: options.pop(name) for name in ("done_on_any",) if name in options}
        game = getattr(global_routing_v0, interface)(PROBLEM, max_steps=6, **options)
        return PettingZooWrapper(game, use_mask=interface == "env", seed=0, **known)

    def ended(env: PettingZooWrapper) -> list[bool]:
        """Of each net, whether it has ended at the end of the game that TorchRL plays."""
        last = env.rollout(500)[-1]["next"]
        assert last["done"].item()
        return [done for group in env.group_map for done in last[group, "done"].flatten().tolist()]

    if interface == "parallel_env":
        assert sorted(set(ended(wrapped()))) == [False, True]  # the first net has left
        with pytest.raises(KeyError, match="net_"):
            wrapped(done_on_any=False).rollout(500)
    else:
        with pytest.raises(ValueError, match="the only valid action is None"):
            wrapped().rollout(500)
    env = wrapped(agents_persist=True)
    check_env_specs(env)
    assert ended(env) == [True] * len(PROBLEM.nets)


def test_benchmarl_takes_the_task() -> None:
    pytest.importorskip("benchmarl")
    from marouting.yaml_files import config_file
    from policies.integrations.benchmarl import RoutingTask

    given = {"problem": PROBLEM, "max_steps": 6, "max_cycles": 6}  # an object, as in the recipe
    env = RoutingTask.TOY_4X4.get_task(given).get_env_fun(2, False, 0, "cpu")()
    assert env.rollout(3).batch_size == (2, 3)
    del given["max_cycles"]
    with pytest.raises(InputError, match="max_cycles: expected the number of steps after which"):
        RoutingTask.TOY_4X4.get_task(given).get_env_fun(2, False, 0, "cpu")
    task = RoutingTask.TOY_4X4.get_from_yaml(str(config_file("configs/benchmarl/toy_4x4.yaml")))
    env = task.get_env_fun(3, continuous_actions=False, seed=0, device="cpu")()
    assert env.batch_size == (3,)
    assert set(task.observation_spec(env).keys(True, True)) == {("nets", "observation")}
    assert set(task.action_mask_spec(env).keys(True, True)) == {("nets", "action_mask")}
    assert set(task.state_spec(env).keys()) == {"state"}
    assert task.group_map(env) == {"nets": [f"agent_{n}" for n in range(5)]}
    steps = env.rollout(100, break_when_all_done=True)
    assert steps.shape[1] <= task.max_steps(env)
    assert set(task.log_info(steps)) == {"collection/info/joined", "collection/info/overflow"}


def test_benchmarl_files_that_hold_no_policy_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("benchmarl")
    from policies.integrations.benchmarl import Policy
    from policies.integrations.value_decomposition import train

    own, known = tmp_path / "run", tmp_path / "run/config.pkl"
    file = Path(train("vdn", "gates-8x7-v0", 500, 0, own)["file"])
    assert Policy(str(file)).training["agent_steps"] >= 500
    what = rf"^{re.escape(str(file))}: expected a checkpoint of BenchMARL, as .*config\.pkl has it$"
    for one in (file, known):
        kept = one.read_bytes()
        for junk in (b"junk", b"", kept[:100]):
            one.write_bytes(junk)
            with pytest.raises(InputError, match=what):
                Policy(str(file))
        one.unlink()
        with pytest.raises(InputError, match=rf"^{re.escape(str(one))}: cannot be read: No such"):
            Policy(str(file))
        one.write_bytes(kept)


def test_rllib_folders_that_hold_no_policy_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("ray.rllib")
    from policies.integrations.rllib import Policy
    from policies.integrations.saved import Training

    right = Training({"scenario": "gates-8x7-v0"}).options
    for options, said in (
        ({"mask": {}, "bogus": 1}, "routing.json: bogus: unknown key"),
        ({**right, "mask": {"visited": 3}}, "routing.json: mask.visited: expected true or false"),
        (right, "module: expected the folder of a module that RLlib has saved"),
    ):
        (tmp_path / "routing.json").write_text(json.dumps(options))
        with pytest.raises(InputError, match=re.escape(said)):
            Policy(str(tmp_path))
    (tmp_path / "module").mkdir()
    with pytest.raises(InputError, match="module: expected the folder of a module that RLlib has"):
        Policy(str(tmp_path))


def test_torchrl_shares_the_mean_of_what_present_nets_are_paid() -> None:
    pytest.importorskip("torchrl")
    from policies.integrations.torchrl import RoutingEnv

    options = {"scenario": "gates-8x7-v0", "split": "validation"}
    own, shared = RoutingEnv(**options), RoutingEnv(shared=True, **options)
    present = torch.from_numpy(own.batch.present)[:, None, :, None]
    assert 0 < present.float().mean() < 1
    torch.manual_seed(0)
    steps = own.rollout(30, break_when_all_done=True)
    actions = iter(steps["nets", "action"].unbind(1))
    again = shared.rollout(
        30,
        lambda td: td.set(("nets", "action"), next(actions)),
        break_when_all_done=True,
    )
    mean = (steps["next", "nets", "reward"] * present).sum(2) / present.sum(2)
    assert torch.allclose(again["next", "reward"], mean)
    # Agent-steps are the moves of agents, as a figure of the games counts them.
    moves = steps["next", "info", "acted"].sum(dim=(1, 2))
    assert moves.tolist() == own.batch.engine.games["steps"].tolist()
    assert moves.max() > steps.shape[1]


@pytest.mark.parametrize("algorithm", ["vdn", "qmix"])
def test_value_decomposition_makes_a_row(algorithm: str, tmp_path: Path) -> None:
    pytest.importorskip("benchmarl")
    from marouting import evaluate_policy
    from policies.integrations.value_decomposition import train

    steps = 12_000
    out, more = tmp_path / "run", {"off_policy_n_optimizer_steps": 60}
    row = train(algorithm, "gates-8x7-v0", steps, 0, out, **more)
    again = train(algorithm, "gates-8x7-v0", steps, 0, out, **more)  # is not trained again
    assert json.loads(json.dumps(again)) == json.loads(json.dumps(row))
    other = "qmix" if algorithm == "vdn" else "vdn"
    for asked, changes in (
        ((other, "gates-8x7-v0", steps, 0), more),
        ((algorithm, "gates-mixed-v0", steps, 0), more),
        ((algorithm, "gates-8x7-v0", 2 * steps, 0), more),
        ((algorithm, "gates-8x7-v0", steps, 1), more),
        ((algorithm, "gates-8x7-v0", steps, 0), {}),
    ):
        with pytest.raises(InputError, match=r"^out: expected a new folder: .* another training"):
            train(*asked, out, **changes)
    assert steps <= row["agent_steps"] < steps + 64 * 4 * 20
    assert row["curve"][-1][0] == row["agent_steps"]
    assert Path(row["file"]).exists()

    def at_random(_: object, masks: np.ndarray) -> np.ndarray:
        return (np.random.default_rng(0).random(masks.shape) * masks).argmax(axis=1)

    for split in ("validation", "test"):
        found = row[split]
        assert (found["scenario"], found["split"]) == ("gates-8x7-v0", split)
        assert found["cost"] < evaluate_policy(at_random, "gates-8x7-v0", split).cost - 0.5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "gama=0.9"], r"gama"),
        (["--set", "gamma=2"], r"gamma: expected a number from 0 to 1"),
        (["--set", "lr=high"], r"lr: expected a number"),
        (["--set", "lr"], r"lr: expected key=value"),
        (["--seed", "-1"], r"seed: expected a number from 0"),
        (["--steps", "0"], r"steps: expected a number from 1"),
        (["--scenario", "gates"], r"gates"),
    ],
)
def test_value_decomposition_refuses_in_one_line(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("benchmarl")
    from policies.cli.main import status
    from policies.integrations.value_decomposition import main

    asked = ["vdn", "--scenario", "gates-8x7-v0", "--out", str(tmp_path / "new" / "run"), *words]
    assert status(asked, main, "value_decomposition") == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert re.search(said, error), error
    assert not list(tmp_path.iterdir())


def test_value_decomposition_goes_on_from_its_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("benchmarl")
    from policies.integrations import value_decomposition

    steps = 20_000
    more = {"off_policy_n_optimizer_steps": 3}
    whole = value_decomposition.train("qmix", "gates-8x7-v0", steps, 0, tmp_path / "whole", **more)
    count = value_decomposition._Steps.on_batch_collected
    left = 4

    def killed(self: Any, batch: Any) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise RuntimeError("killed")
        count(self, batch)

    again = tmp_path / "again"
    monkeypatch.setattr(value_decomposition._Steps, "on_batch_collected", killed)
    with pytest.raises(RuntimeError, match="killed"):
        value_decomposition.train("qmix", "gates-8x7-v0", steps, 0, again, every=0, **more)
    monkeypatch.undo()
    state = tmp_path / "again.state.pt"
    kept = state.read_bytes()
    state.write_bytes(kept[:1000])
    with pytest.raises(InputError, match=r"again.state.pt: expected the state of .*qmix"):
        value_decomposition.train("qmix", "gates-8x7-v0", steps, 0, again, **more)
    state.write_bytes(kept)
    with pytest.raises(InputError, match=r"again.state.pt: expected the state of .*vdn"):
        value_decomposition.train("vdn", "gates-8x7-v0", steps, 0, again, **more)
    row = value_decomposition.train("qmix", "gates-8x7-v0", steps, 0, again, **more)
    assert not state.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"whole", "again"}
    for key in ("agent_steps", "curve", "validation", "test"):
        assert row[key] == whole[key]


# Tianshou -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("persist", [False, True])
@pytest.mark.parametrize("masks", [False, True])
def test_tianshou_wraps_pettingzoo_only_with_agents_that_persist(
    persist: bool, masks: bool
) -> None:
    """As docs/libraries.md says: which options are needed, and what happens without them."""
    pytest.importorskip("tianshou")
    from tianshou.env import PettingZooEnv

    options = {"agents_persist": persist, "mask": {"in_observation": masks}}
    env = PettingZooEnv(global_routing_v0.env(PROBLEM, max_steps=6, **options))
    seen, _ = env.reset(seed=0)
    rng, over, masked = np.random.default_rng(0), False, False
    while not over:
        masked |= not all(seen["mask"])
        seen, _, terminated, truncated, _ = env.step(int(rng.choice(np.flatnonzero(seen["mask"]))))
        over = terminated or truncated
    game = env.env.unwrapped
    ended = [game.terminations[agent] or game.truncations[agent] for agent in game.agents]
    assert ended == [persist or agent == game.agent_selection for agent in game.agents]
    assert len(ended) == len(PROBLEM.nets)
    assert masked == masks


# Recipes ------------------------------------------------------------------------------------------

RECIPES = Path(__file__).resolve().parents[1] / "docs" / "examples" / "libraries"
RUNS = {
    "sb3_gymnasium ppo": "stable_baselines3",
    "sb3_gymnasium dqn": "stable_baselines3",
    "sb3_supersuit": "stable_baselines3",
    "sb3_masked": "sb3_contrib",
    "torchrl_ippo": "torchrl",
    "torchrl_ippo mappo": "torchrl",
    "benchmarl_task ippo": "benchmarl",
    "benchmarl_task iql": "benchmarl",
    "benchmarl_task qmix": "benchmarl",
    "rllib_ppo": "ray",
    "rllib_ppo masked": "ray",
    "tianshou_dqn": "tianshou",
    "agilerl_ippo": "agilerl",
    "skrl_ippo": "skrl",
    "pufferlib_emulation": "pufferlib",
    "batch_ppo": "torch",
}


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_a_recipe_joins_the_nets(run: str) -> None:
    if importlib.util.find_spec(RUNS[run]) is None:
        pytest.skip(f"{RUNS[run]} is not installed")
    name, *words = run.split()
    done = subprocess.run(
        [sys.executable, RECIPES / f"{name}.py", *words],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    *_, (_, seconds, joined) = re.findall(r"^(\d+) ([\d.]+) ([\d.]+)$", done.stdout, re.MULTILINE)
    assert float(joined) >= 0.95
    assert float(seconds) <= 180


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_a_recipe_fails_where_too_few_nets_are_joined(run: str) -> None:
    if importlib.util.find_spec(RUNS[run]) is None:
        pytest.skip(f"{RUNS[run]} is not installed")
    name, *words = run.split()
    done = subprocess.run(
        [sys.executable, RECIPES / f"{name}.py", *words, "--steps", "1"],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    said = r"^joined 0\.[0-8]\d+ of the nets, expected 0\.95 or more$"
    assert re.search(said, done.stderr, re.MULTILINE), done.stderr


SCORED = {
    "score_sb3": ("sb3_contrib", "sb3", "file=model.zip"),
    "score_torchrl": ("torchrl", "torchrl", "file=policy.pt"),
    "score_benchmarl": ("benchmarl", "benchmarl", "file={file}"),
    "score_rllib": ("ray.rllib", "rllib", "folder=folder"),
}
"""Examples that train a policy and score it: what they need, and the router that they name."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) for n in SCORED])
def test_a_policy_that_was_trained_in_a_library_is_a_row(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its figures are those that the example prints; another scenario's game is refused."""
    needed, module, option = SCORED[name]
    try:
        importlib.import_module(needed)
    except ImportError:
        pytest.skip(f"{needed} is not installed")
    example = RECIPES / f"{name}.py"
    target = option.partition("=")[2].replace("{file}", "runs")
    done = subprocess.run(
        [sys.executable, example, target, "--steps", "3000"],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.strip().splitlines()
    printed = re.search(r"test: cost ([\d.]+), score (-?[\d.]+)", lines[-1])
    assert printed, done.stdout
    monkeypatch.chdir(tmp_path)
    router = f"policies.integrations.{module}:Policy {option.format(file=lines[0])} teacher=false"
    monkeypatch.setattr(experiment, "work_on", in_this_process)
    command = ["benchmark", "--router", router, "--name", "row", "jobs=1", "--json", "--scenario"]
    assert status([*command, "gates-8x7-v0"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert f"{row['cost']:.4f}" == printed[1]
    assert f"{row['score']['mean']:.3f}" == printed[2]
    assert (row["sight"], row["teacher"]) == ("radius 3", False)
    assert row["parameters"] > 50_000
    if module != "rllib":
        assert 3000 <= row["agent_steps"] < 20_000
    # The options are those of the training: the game of another scenario is refused.
    assert status([*command, "online-8x8-v0"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "turn_order: expected sequential, as online-8x8-v0 is played, found round_robin" in error


def test_every_recipe_is_listed_and_short() -> None:
    page = (RECIPES.parents[1] / "libraries.md").read_text(encoding="utf-8")
    files = {file.stem: file for file in RECIPES.glob("*.py") if file.stem != "curve"}
    assert set(files) == {run.split()[0] for run in (*RUNS, *SCORED)}
    for name, file in files.items():
        assert f"(examples/libraries/{name}.py)" in page
        most = 75 if name in SCORED else 60
        assert len(file.read_text(encoding="utf-8").splitlines()) <= most, name
    for link in re.findall(r"\]\(([^)#]+)\)", page):
        assert link.startswith("https://") or (RECIPES.parents[1] / link).exists(), link


def test_the_page_says_what_the_curves_do() -> None:
    """Of every run its end, and its speed from the first row of its curve to the last."""
    page = (RECIPES.parents[1] / "libraries.md").read_text(encoding="utf-8")
    curves: dict[str, list[tuple[int, float, float]]] = {}
    with (RECIPES.parents[1] / "results" / "libraries.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            figures = int(row["steps"]), float(row["processor_seconds"]), float(row["joined"])
            curves.setdefault(row["recipe"], []).append(figures)
    assert set(curves) == set(RUNS)
    for run, curve in curves.items():
        name, *words = run.split()
        link = f"[`{' '.join([f'{name}.py', *words])}`](examples/libraries/{name}.py)"
        (line,) = (line for line in page.splitlines() if link in line)
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        (begun, before, _), (steps, seconds, joined) = curve[0], curve[-1]
        assert joined >= 0.95
        assert seconds <= 180
        after = f"{steps:,}".replace(",", " ")
        assert cells[-2] == f"{joined} after {after} steps, {seconds:.0f} s"
        speed = float(f"{(steps - begun) / (seconds - before):.2g}")
        assert cells[-1] == f"{speed:,.0f}".replace(",", " ")
