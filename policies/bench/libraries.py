"""Speed of what trainers of other libraries step: vectors, and what the integrations make."""

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np

from marouting import ENVIRONMENT_ID, Problem, global_routing_v0, scenarios
from marouting.problem.grid import MOVES
from policies.bench.measure import Bench, Measurement, Work

_OPTIONS: dict[str, Any] = {"reward": "normalised"}


def _moves(count: int, rows: int = 16) -> np.ndarray:
    """(rows, count) int64, random moves."""
    return np.random.default_rng(0).integers(MOVES, size=(rows, count))


def _single(problem: Problem, steps: int = 20_000) -> Work:
    env = gymnasium.make(ENVIRONMENT_ID, problem=problem, **_OPTIONS)
    env.reset(seed=0)
    moves = _moves(1, 256)[:, 0].tolist()

    def work() -> float:
        for step in range(steps):
            *_, terminated, truncated, _ = env.step(moves[step % len(moves)])
            if terminated or truncated:
                env.reset()
        return steps

    return work


def _vector(env: Any, steps: int) -> Work:
    """A vector of Gymnasium, SuperSuit or Stable-Baselines3."""
    env.reset()
    moves = _moves(env.num_envs)

    def work() -> float:
        for step in range(steps):
            env.step(moves[step % len(moves)])
        return steps * float(env.num_envs)

    return work


def _vec_env(problem: Problem, games: int, steps: int) -> Work:
    from policies.integrations.sb3 import RoutingVecEnv

    return _vector(RoutingVecEnv([problem] * games, **_OPTIONS), steps)


def _supersuit(problem: Problem, games: int, steps: int) -> Work:
    import supersuit

    nets = supersuit.pettingzoo_env_to_vec_env_v1(
        global_routing_v0.parallel_env(problem, agents_persist=True, **_OPTIONS)
    )
    env = supersuit.concat_vec_envs_v1(nets, games, num_cpus=0, base_class="gymnasium")
    return _vector(env, steps)


def _rollout(problem: Problem, games: int, steps: int) -> Work:
    from policies.integrations.torchrl import RoutingEnv

    env = RoutingEnv([problem] * games, **_OPTIONS)

    def work() -> float:
        return float(
            env.rollout(steps, break_when_any_done=False)["next", "nets", "reward"].numel()
        )

    return work


def libraries(bench: Bench) -> Iterator[Measurement]:
    """What trainers step, with random moves; what is not installed is left out."""
    problem = scenarios.get("two-pin-8x8-v0").test[0]
    many = {"problem": problem, **_OPTIONS}
    rows: dict[str, tuple[str, Any]] = {
        'gymnasium.make_vec(…, 64, vectorization_mode="sync")': (
            "gymnasium",
            lambda: _vector(
                gymnasium.make_vec(ENVIRONMENT_ID, 64, vectorization_mode="sync", **many), 200
            ),
        ),
        "gymnasium.make_vec(…, 64)": (
            "gymnasium",
            lambda: _vector(gymnasium.make_vec(ENVIRONMENT_ID, 64, **many), 2_000),
        ),
        "SuperSuit's vector, 8 games of 50 nets": (
            "supersuit",
            lambda: _supersuit(problem, 8, 150),
        ),
        "RoutingVecEnv of Stable-Baselines3, 8 games": (
            "stable_baselines3",
            lambda: _vec_env(problem, 8, 1_000),
        ),
        "RoutingVecEnv of Stable-Baselines3, 64 games": (
            "stable_baselines3",
            lambda: _vec_env(problem, 64, 200),
        ),
        "RoutingEnv of TorchRL, 64 games, in rollout": (
            "torchrl",
            lambda: _rollout(problem, 64, 200),
        ),
    }
    for name, (library, make) in rows.items():
        if find_spec(library) is not None:
            yield bench.versus(name, "agent-steps/s", make(), "gymnasium.make", _single(problem))
