"""``python -m policies.bench.cuda``: checks the batch on a CUDA device, then measures it.

First, games on the device are compared with the same games on the processor, to the bit. Then it
measures, one after the other: steps by the number of games with the paper's observation and with
windows; Connector of Jumanji on the same card, with its own observation and with windows of about
the same size, if jumanji and jax are installed; and PPO. The whole takes less than 8 minutes.
"""

import importlib
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
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
from marouting.kernels import compiled, i64, mixed
from marouting.options import game_options
from marouting.vector import BatchEnv
from policies.bench.measure import machine
from policies.cli.main import status
from policies.cli.options import FILE
from policies.learned.algorithms import ppo
from policies.learned.on_device import DevicePPO

SECTIONS = ("equality", "paper", "window", "connector", "learning")
"""What is done, in this order: nothing else is on the card while something is measured."""

SCENARIO = "gates-8x7-v0"
"""Where trainings are measured."""

TRAININGS = (("ippo", 16384, 12, 32), ("mappo", 16384, 12, 32), ("ippo", 131072, 8, 16))
"""Learners, numbers of games, how long they train, and the steps of a rollout."""

CONNECTORS = ((16384, 0), (65536, 0), (262144, 0), (65536, 3), (262144, 3))
"""Numbers of games, and radii of the windows around agents; 0 for Connector's own observation."""

GAMES = (4096, 16384, 65536, 262144)
"""Numbers of games."""

WINDOW = {"kind": "window", "radius": 3, "layers": 0, "channels": ["capacity", "own", "heads"]}
"""387 numbers; a window of radius 3 in Connector has 392."""

WINDOW_ALL = {"kind": "window", "channels": ["capacity", "history", "own", "pins", "heads"]}

PPO = {
    "network": {"kind": "mlp", "hidden": [128, 128]},
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "final_failures": True,
}
"""The options of the learner: those of trainings on endless problems."""


# --- equality -------------------------------------------------------------------------------------

CASES: Sequence[Mapping[str, Any]] = (
    {},
    {"everyone": False},
    {"everyone": False, "turn_order": "round_robin"},
    {"turn_order": "sequential"},
    {"overflow": "allowed", "reward": {"kind": "normalised", "overflow_price": 2.0}},
    {"target": "tree", "nets": {"decomposition": "steiner"}},
    {"next_pin": "nearest"},
    {"mask": {"visited": True}, "release_failed": True, "max_steps": 20},
    {"rip_up": {"rounds": 2, "choose": "conflicts", "neighbours": 1}},
    {"rip_up": {"rounds": 1, "choose": "agents"}, "everyone": False},
    {"rip_up": {"rounds": 2, "choose": "history"}},
    {"observation": WINDOW, "reward": "team"},
    {"observation": WINDOW_ALL, "reward": "counterfactual", "everyone": False},
    {
        "observation": {**WINDOW, "channels": ["messages"], "message_bits": 3},
        "wait": True,
        "message_bits": 3,
    },
)
"""Options by which games are compared."""


def on_host(value: Any) -> np.ndarray:
    """A copy of an array of the device; an array of the processor as it is."""
    return value.copy_to_host() if hasattr(value, "copy_to_host") else np.asarray(value)


def difference(host: Mapping[str, Any], found: Mapping[str, Any]) -> str | None:
    """The name of the first array that differs; None if all are equal to the bit."""
    for name, value in host.items():
        if isinstance(value, Mapping):
            inner = difference(value, found[name])
            if inner is not None:
                return f"{name}.{inner}"
        elif not np.array_equal(on_host(value), on_host(found[name])):
            return name
    return None


def compare(
    problems: Sequence[marouting.Problem], steps: int, seed: int = 0, **options: Any
) -> str | None:
    """Plays the same random moves on the processor and on the device.

    Args:
        problems: what is played.
        steps: how many steps; episodes begin again as they end.
        seed: of the moves; one in twenty is no move.
        **options: of the environments.

    Returns:
        What differs first, with the number of the step; None if nothing does.
    """
    host = BatchEnv(problems, **options)
    other: Any = BatchEnv(problems, device="cuda", **options)
    rng = np.random.default_rng(seed)
    order, number = host.engine.order, np.arange(len(problems))[:, None]
    place = np.arange(order.shape[1])
    turned = np.where(order < 0, place, order)  # the agent on the processor of a row of the device
    if np.array_equal(other.nets, host.engine.nets):
        order = turned = np.broadcast_to(place, order.shape)

    def by_row(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: by_row(part) for name, part in value.items()}
        rows = options.get("everyone", True) and np.ndim(value) > 1
        return value[number, turned] if rows else value

    obs, info = host.reset()
    found, other_info = other.reset()
    for step in range(steps):
        agents, known = on_host(other_info["agents"]), by_row(info["agents"])
        if not np.array_equal(known, np.where(agents < 0, agents, order[number, agents])):
            return f"step {step}: agents"
        seen = {**by_row({"obs": obs, **info}), "agents": agents}
        differs = difference(seen, {"obs": found, **other_info})
        if differs is not None:
            return f"step {step}: {differs}"
        mask = info["action_mask"]
        moves = (mask * rng.random(mask.shape)).argmax(-1)
        moves[rng.random(moves.shape) < 0.05] = -1
        obs, *flags, info = host.step(moves)
        found, *others, other_info = other.step(by_row(moves).astype(np.int32))
        names = "reward", "terminated", "truncated"
        differs = difference(
            by_row(dict(zip(names, flags, strict=True))), dict(zip(names, others, strict=True))
        )
        if differs is not None:
            return f"step {step}: {differs}"
    if not np.array_equal(host.state(), on_host(other.state())):
        return "state"
    for m in range(len(problems)):
        if host.engine.solution(m) != other.solution(m):
            return f"routes of game {m}"
    return None


# --- speed ----------------------------------------------------------------------------------------


@compiled
def random_move(mask: Any, m: int, row: int, counter: int) -> int:
    """A random move that the mask allows."""
    place = np.uint64(m * mask.shape[1] + row)
    z = mixed(
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


def connector(games: int, radius: int, seconds: float) -> dict[str, Any]:
    """Agent-steps per second of Jumanji's Connector-v3 with random legal moves, in JAX.

    Args:
        games: how many are played at once.
        radius: of the window that every agent gets; 0: agents get the whole grid, as Connector
            has it.
        seconds: of the measurement.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # other sections need memory
    import jax
    import jax.numpy as jnp

    jumanji, wrappers = map(importlib.import_module, ("jumanji", "jumanji.wrappers"))

    env: Any = wrappers.AutoResetWrapper(jumanji.make("Connector-v3"))
    agents, steps, width = env.unwrapped.num_agents, 16, 2 * radius + 1

    def window(grid: Any, agent: Any, place: Any) -> Any:
        """(8 W²,) what is around an agent: free, outside; its own path, head, target; others'."""
        near = jax.lax.dynamic_slice(jnp.pad(grid, radius, constant_values=-1), place, (width,) * 2)
        own, part = (near - 1) // 3 == agent, (near - 1) % 3  # 1 + 3 · agent + part
        taken = [(near > 0) & whose & (part == k) for whose in (own, ~own) for k in range(3)]
        return jnp.stack([near == 0, near < 0, *taken]).astype(jnp.float32).ravel()

    def look(state: Any, observation: Any) -> Any:
        """What the agents of a game see."""
        if not radius:
            return observation.grid
        places = state.agents.position
        return jax.vmap(window, (None, 0, 0))(state.grid, jnp.arange(agents), places)

    def play(state: Any, mask: Any, key: Any, seen: Any) -> Any:
        def one(carry: Any, _: None) -> Any:
            state, mask, key, _ = carry
            key, now = jax.random.split(key)
            gumbel = jax.random.gumbel(now, mask.shape)
            action = jnp.argmax(jnp.where(mask, gumbel, -jnp.inf), axis=-1)
            state, step = jax.vmap(env.step)(state, action)
            seen = jax.vmap(look)(state, step.observation)
            return (state, step.observation.action_mask, key, seen), step.reward.sum()

        return jax.lax.scan(one, (state, mask, key, seen), None, steps)

    key = jax.random.PRNGKey(0)
    state, first = jax.jit(jax.vmap(env.reset))(jax.random.split(key, games))
    seen = jax.jit(jax.vmap(look))(state, first.observation)
    run = jax.jit(play, donate_argnums=(0, 1, 2, 3))
    begin = time.perf_counter()
    carry = state, first.observation.action_mask, key, seen
    carry, _ = jax.block_until_ready(run(*carry))
    compiling = time.perf_counter() - begin
    count, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        carry, _ = jax.block_until_ready(run(*carry))
        count += steps
    once = (time.perf_counter() - begin) / count
    return {
        "games": games,
        "agents": agents,
        "radius": radius,
        "seen": int(np.prod(carry[3].shape[1:])),
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
    options = marouting.scenarios.get(SCENARIO).env
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
        progress = trained.iterate()
        moves, rollouts, now = moves + progress.steps, rollouts + 1, time.perf_counter()
        if rollouts == 2:  # all is compiled
            first = moves, now
        if rollouts > 1 and rollouts & (rollouts - 1) == 0:
            yield {**what, "agent_steps": moves, "seconds": now - begin, "joined": progress.joined}
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
    """Check the batch on a CUDA device, and measure it."""
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
        if section == "equality":
            problems = marouting.generate(64, nets=8, max_pins=3, grid=(6, 6, 2), capacity=2)
            # Each compiles for a minute.
            with ProcessPoolExecutor(len(CASES), get_context("spawn")) as pool:
                found = [pool.submit(compare, problems, 100, **options) for options in CASES]
                for options, differs in zip(CASES, found, strict=True):
                    done(section, {"options": dict(options), "differs": differs.result()})
        elif section == "learning":
            for learner, count, share, steps in TRAININGS:
                for row in learning(learner, count, share * seconds, steps):
                    done(section, row)
        elif section == "connector":
            for count, radius in CONNECTORS:
                done(section, connector(count, radius, seconds))
        else:
            options = {"observation": WINDOW} if section == "window" else {}
            for count in numbers:
                done(section, speed(count, seconds, **options))

    for name in names:
        try:
            measure(name)
        except Exception as error:  # the next sections are worth as much
            done("failed", f"{name}: {type(error).__name__}: {str(error)[-600:]}")
    wrong = [row for row in report.get("equality", ()) if row["differs"]]
    sys.exit(1 if wrong or "failed" in report else 0)


if __name__ == "__main__":
    sys.exit(status(None, main, "python -m policies.bench.cuda"))
