"""``python -m policies.bench.cuda``: measures the batch on a CUDA device.

It measures, one after the other: PPO, steps by the number of games with the paper's observation and
with windows, and Connector of Jumanji on the same card if jumanji and jax are installed. The whole
takes less than 8 minutes. ``pytest -m gpu`` compares games on the device with those on the
processor.
"""

import importlib
import json
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch

import marouting
from marouting.config import build, check
from marouting.cuda import games as device
from marouting.cuda.env import CudaBatchEnv
from marouting.files import check_writable, write_text
from marouting.kernels import compiled, i64
from marouting.options import game_options
from marouting.vector import BatchEnv
from policies.bench.measure import machine
from policies.cli.main import status
from policies.cli.options import FILE
from policies.learned.algorithms import ppo
from policies.learned.on_device import DevicePPO

SECTIONS = ("learning", "paper", "window", "connector")
"""What is measured, in this order."""

SCENARIO = "gates-8x7-v0"
"""Where trainings are measured."""

TRAININGS = (("ippo", 16384, 25, 32), ("mappo", 16384, 25, 32), ("ippo", 131072, 8, 16))
"""Learners, numbers of games, how long they train, and the steps of a rollout."""

MOST_CONNECTORS = 65536

GAMES = (4096, 16384, 65536, 262144)
"""Numbers of games."""

WINDOW = {"kind": "window", "radius": 3, "layers": 0, "channels": ["capacity", "own", "heads"]}

PPO = {
    "network": {"kind": "mlp", "hidden": [128, 128]},
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "final_failures": True,
}
"""The options of the learner: those of trainings on endless problems."""


@compiled
def random_move(mask: Any, m: int, row: int, counter: int) -> int:
    """A random move that the mask allows."""
    place = np.uint64(m * mask.shape[1] + row)
    z = device.mixed(
        np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15) + place * np.uint64(0x2545F4914F6CDD1D)
    )
    free = i64(0)
    for move in range(mask.shape[2]):
        free += mask[m, row, move]
    left = i64((z >> np.uint64(33)) % np.uint64(free))
    for move in range(mask.shape[2]):
        if mask[m, row, move]:
            if left == 0:
                return i64(move)
            left -= 1
    return i64(0)


class Random:
    """Chooses random moves on the device."""

    def __init__(self, env: CudaBatchEnv) -> None:
        self.env, self.counter = env, 0

        @env._device.jit
        def choose(mask: Any, actions: Any, counter: int) -> None:
            place = i64(device.cuda.grid(1))
            rows = i64(actions.shape[1])
            m = place // rows
            if m < len(actions):
                row = place - m * rows
                actions[m, row] = random_move(mask, m, row, counter)

        self.choose = choose

    def __call__(self, info: Mapping[str, Any]) -> Any:
        """Fills the environment's own array of actions."""
        self.counter += 1
        actions = self.env.actions
        self.env._run(self.choose, actions.size, info["action_mask"], actions, self.counter)
        return actions


def on_host(value: Any) -> np.ndarray:
    """A copy of an array of the device; an array of the processor as it is."""
    return value.copy_to_host() if hasattr(value, "copy_to_host") else np.asarray(value)


def timed(call: Callable[[], Any], seconds: float) -> float:
    """Seconds of a call, in about so many seconds of calls; the device has then done its work."""
    call()
    device.cuda.synchronize()
    count, begin = 1, time.perf_counter()
    while True:
        for _ in range(count):
            call()
        device.cuda.synchronize()
        passed = time.perf_counter() - begin
        if passed > seconds / 2:
            return passed / count
        count, begin = max(2 * count, int(count * seconds / passed)), time.perf_counter()


def speed(games: int, seconds: float, **options: Any) -> dict[str, Any]:
    """Agent-steps per second of so many games with random moves."""
    begin = time.perf_counter()
    problem = marouting.generate(64, nets=10, reduced_edges=0, seed=1)
    env: Any = BatchEnv(games, problem=problem, device="cuda", **options)
    free = device.cuda.current_context().get_memory_info()[0]
    policy = Random(env)
    _, info = env.reset()
    for _ in range(30):  # games are then at different stages
        env.step(policy(info))
    device.cuda.synchronize()
    ready = time.perf_counter() - begin
    moved = [on_host(env.step(policy(info))[-1]["acted"]).sum() for _ in range(5)]
    once = timed(lambda: env.step(policy(info)), seconds)
    acted = float(np.mean(moved))
    return {
        "games": games,
        "agents": env.num_agents,
        "us_per_step": once * 1e6,
        "agent_steps_per_s": acted / once,
        "rows_per_s": games * env.num_agents / once,
        "prepared_s": ready,
        "free_gib": free / 2**30,
    }


def connector(games: int, seconds: float) -> dict[str, Any]:
    """Agent-steps per second of Jumanji's Connector-v3 with random legal moves, in JAX."""
    import jax
    import jax.numpy as jnp

    jumanji, wrappers = map(importlib.import_module, ("jumanji", "jumanji.wrappers"))

    env: Any = wrappers.AutoResetWrapper(jumanji.make("Connector-v3"))
    agents, steps = env.unwrapped.num_agents, 16

    def play(state: Any, seen: Any, key: Any) -> Any:
        def one(carry: Any, _: None) -> Any:
            state, seen, key = carry
            mask = seen.action_mask
            key, now = jax.random.split(key)
            gumbel = jax.random.gumbel(now, mask.shape)
            action = jnp.argmax(jnp.where(mask, gumbel, -jnp.inf), axis=-1)
            state, step = jax.vmap(env.step)(state, action)
            return (state, step.observation, key), step.reward.sum()

        return jax.lax.scan(one, (state, seen, key), None, steps)

    key = jax.random.PRNGKey(0)
    state, first = jax.jit(jax.vmap(env.reset))(jax.random.split(key, games))
    run = jax.jit(play)
    begin = time.perf_counter()
    carry, _ = jax.block_until_ready(run(state, first.observation, key))
    compiling = time.perf_counter() - begin
    count, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        carry, _ = jax.block_until_ready(run(*carry))
        count += steps
    once = (time.perf_counter() - begin) / count
    return {
        "games": games,
        "agents": agents,
        "us_per_step": once * 1e6,
        "rows_per_s": games * agents / once,
        "first_call_s": compiling,
    }


def learning(learner: str, games: int, seconds: float, steps: int) -> Iterator[dict[str, Any]]:
    """PPO on SCENARIO: its speed, and what the policy is worth on test after so many seconds.

    Yields:
        Where the training is after 2, 4, 8, … rollouts; at last its result.
    """
    torch.set_float32_matmul_precision("high")
    options = {k: v for k, v in marouting.scenarios.get(SCENARIO).env.items() if k != "agents"}
    begin = time.perf_counter()
    env = BatchEnv(games, scenario=SCENARIO, device="cuda", pool=4096, **options)
    kind = {"ippo": ppo.IPPOOptions, "mappo": ppo.MAPPOOptions}[learner]
    observation = game_options(options).observation.make()
    trained = DevicePPO(env, observation, build(kind, PPO), steps=steps)
    what = {"scenario": SCENARIO, "learner": learner, "games": games, "agents": env.num_agents}
    what["prepared_s"] = time.perf_counter() - begin
    moves, rollouts, begin = 0, 0, time.perf_counter()
    first = (0, begin)
    while time.perf_counter() - begin < seconds:
        told = trained.iterate()
        moves, rollouts, now = moves + told.steps, rollouts + 1, time.perf_counter()
        if rollouts == 2:  # all is compiled
            first = moves, now
        if rollouts > 1 and rollouts & (rollouts - 1) == 0:
            yield {**what, "agent_steps": moves, "seconds": now - begin, "joined": told.joined}
    rate = (moves - first[0]) / max(now - first[1], 1e-9)
    result = marouting.evaluate_policy(trained, SCENARIO, "test")
    yield {
        **what,
        "agent_steps": moves,
        "seconds": now - begin,
        "agent_steps_per_s": rate,
        "test_cost": result.cost,
        "test_solved": result.solved,
    }


def card() -> dict[str, Any]:
    """The card and its driver."""
    cuda = device.cuda
    name = cuda.get_current_device().name
    kernel = Path("/proc/driver/nvidia/version")  # there on Linux
    driver = re.search(r"\d+(\.\d+)+", kernel.read_text() if kernel.exists() else "")
    return {
        "card": name.decode() if isinstance(name, bytes) else str(name),
        "driver": driver and driver[0],
        "cuda": ".".join(map(str, cuda.cudadrv.driver.driver.get_version())),
    }


@click.command()
@click.option("--out", type=FILE, help="JSON file for the results; without it, none is written.")
@click.option("--seconds", type=click.FloatRange(0), default=1.0, help="Of a measurement.")
@click.option("--sections", default=",".join(SECTIONS), show_default=True)
@click.option("--games", default=",".join(map(str, GAMES)), show_default=True)
def main(out: Path | None, seconds: float, sections: str, games: str) -> None:
    """Measure the batch on a CUDA device."""
    names, counts = sections.split(","), games.split(",")
    for name in names:
        check("--sections", name in SECTIONS, f"some of {', '.join(SECTIONS)}, found {name}")
    for count in counts:
        fits = count.isdecimal() and int(count) > 0
        check("--games", fits, f"numbers from 1 with commas between them, found {count}")
    numbers = tuple(map(int, counts))
    if out is not None:
        check_writable(out)
    device.Device()
    begin = time.perf_counter()
    report: dict[str, Any] = {"machine": machine() | card()}
    click.echo(json.dumps(report["machine"]))

    def done(what: str, row: Any) -> None:
        report.setdefault(what, []).append(row)
        click.echo(f"{time.perf_counter() - begin:.0f} s  {what}: {json.dumps(row)}")
        if out is not None:
            write_text(out, json.dumps(report, indent=1) + "\n")

    def measure(section: str) -> None:
        if section == "learning":
            for learner, count, share, steps in TRAININGS:
                for row in learning(learner, count, share * seconds, steps):
                    done(section, row)
        elif section == "connector":
            for count in numbers:
                if count <= MOST_CONNECTORS:
                    done(section, connector(count, seconds))
        else:
            options = {"observation": WINDOW} if section == "window" else {}
            for count in numbers:
                done(section, speed(count, seconds, **options))

    for name in names:
        try:
            measure(name)
        except Exception as error:  # the next sections are worth as much
            done("failed", f"{name}: {type(error).__name__}: {str(error)[-600:]}")
    sys.exit("failed" in report)


if __name__ == "__main__":
    sys.exit(status(None, main, "python -m policies.bench.cuda"))
