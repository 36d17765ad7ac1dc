"""Speed of the environment: its interfaces and its start; and of A*."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from marouting import Problem, generate, global_routing_v0, sequential_astar
from marouting.problem.grid import MOVES, Grid
from marouting.trees.decomposition import two_pin_tasks
from marouting.vector import BatchEnv
from policies.bench.measure import Bench, Measurement, Work


def _problem() -> Problem:
    return generate(1)[0]


def _batched(threads: int, steps: int = 60, problems: int = 1024, **options: Any) -> Work:
    """Random moves of all agents of a batch of the paper's problems."""
    env = BatchEnv(generate(16) * (problems // 16), threads=threads, **options)
    env.reset()
    shape = (problems, env.num_agents)
    moves = np.random.default_rng(0).integers(MOVES, size=(8, *shape), dtype=np.int8)

    def work() -> float:
        for step in range(steps):
            env.step(moves[step % len(moves)])
        return steps * shape[0] * shape[1]

    return work


def batch(bench: Bench) -> Iterator[Measurement]:
    """The batched environment, with observations, masks and rewards."""
    unit = "agent-steps/s"
    one = _batched(1)
    yield bench.versus(
        "BatchEnv, 1024 problems of 50 nets",
        unit,
        one,
        "Parallel environment, 50 nets",
        _parallel(global_routing_v0.parallel_env(_problem())),
    )
    if bench.threads > 1:
        yield bench.versus(
            "BatchEnv, the same",
            unit,
            _batched(bench.threads),
            "one thread",
            one,
            threads=bench.threads,
        )


def observation(bench: Bench) -> Iterator[Measurement]:
    """Steps with the window and the outlook, beside those with the paper's 12 numbers."""
    for name, options in (
        ("window, radius 2", {"kind": "window", "radius": 2}),
        ("outlook", {"kind": "outlook"}),
    ):
        yield bench.versus(
            f"BatchEnv with {name}, 128 problems of 50 nets",
            "agent-steps/s",
            _batched(1, 10, 128, observation=options),
            "the same with the paper's observation",
            _batched(1, 60, 128),
        )
        yield bench.versus(
            f"AEC environment with {name}: last() and step()",
            "steps/s",
            _turns(global_routing_v0.env(_problem(), observation=options)),
            "the same with the paper's observation",
            _turns(global_routing_v0.env(_problem())),
        )


def _parallel(env: Any) -> Work:
    """All agents of a Parallel environment, moving in circles."""
    env.reset(seed=0)
    moves = [
        {agent: (k + i) % MOVES for i, agent in enumerate(env.possible_agents)}
        for k in range(MOVES)
    ]

    def work() -> float:
        done = 0
        for step in range(300):
            if not env.agents:
                env.reset()
            everybody = moves[step % MOVES]
            agents = env.agents
            if len(agents) != len(everybody):
                everybody = {agent: everybody[agent] for agent in agents}
            done += len(agents)
            env.step(everybody)
        return done

    return work


def _turns(env: Any, steps: int = 3000, *, last: bool = True) -> Work:
    """An AEC loop, with ``last()`` before every step or without."""
    env.reset(seed=0)

    def work() -> float:
        for step in range(steps):
            if not env.agents:
                env.reset()
            if last:
                _, _, terminated, truncated, _ = env.last()
                over = terminated or truncated
            else:
                agent = env.agent_selection
                over = env.terminations[agent] or env.truncations[agent]
            env.step(None if over else step % MOVES)
        return steps

    return work


def interfaces(bench: Bench) -> Iterator[Measurement]:
    """The interfaces of PettingZoo, against environments that do nothing."""
    from pettingzoo.utils import wrappers

    from policies.bench.floor import EmptyAEC

    def wrapped(env: Any) -> Any:
        return wrappers.OrderEnforcingWrapper(wrappers.AssertOutOfBoundsWrapper(env))

    problem = _problem()
    yield bench.versus(
        "AEC environment: last() and step()",
        "steps/s",
        _turns(global_routing_v0.env(problem)),
        "an empty AEC environment under the same wrappers",
        _turns(wrapped(EmptyAEC())),
    )
    yield bench.versus(
        "raw_env: step()",
        "steps/s",
        _turns(global_routing_v0.raw_env(problem), 10_000, last=False),
        "an empty AEC environment, bare",
        _turns(EmptyAEC(), 10_000, last=False),
    )
    yield bench.versus(
        "Parallel environment, 50 nets",
        "agent-steps/s",
        _parallel(global_routing_v0.parallel_env(problem)),
        "raw_env: step()",
        _turns(global_routing_v0.raw_env(problem), 10_000, last=False),
    )


# --- A* -------------------------------------------------------------------------------------------


def _networkx(problem: Problem, tasks: int | None = None) -> Work:
    """Tasks of a problem, all or so many, as shortest paths of networkx: less than A* does here."""
    import networkx

    grid = Grid.of(problem.grid)
    graph = networkx.Graph()
    edges = np.flatnonzero(grid.exists)
    graph.add_edges_from(zip(*(ends.tolist() for ends in grid.ends(edges)), strict=True), weight=1)
    pairs = two_pin_tasks(problem)[:tasks, 1:].tolist()
    position = grid.position.tolist()

    def distance(a: int, b: int) -> int:
        return sum(abs(p - q) for p, q in zip(position[a], position[b], strict=True))

    def work() -> float:
        for source, target in pairs:
            networkx.astar_path(graph, source, target, heuristic=distance)
        return len(pairs)

    return work


def search(bench: Bench) -> Iterator[Measurement]:
    """Sequential A*, from a problem to its solution."""
    problems = generate(100)
    # Problems of which nothing has been worked out yet, for every repeat and the first time.
    stock = [[replace(problem) for problem in problems] for _ in range(bench.repeats + 1)]

    def fresh() -> float:
        for problem in stock.pop():
            sequential_astar(problem)
        return 50 * len(problems)

    yield bench.versus(
        "sequential A*, problems of 50 two-pin nets on 8×8×2",
        "tasks/s",
        fresh,
        "networkx's astar_path, capacities left out",
        _networkx(problems[0]),
    )
    (chip,) = generate(1, (64, 64, 2), 11_507, max_pins=4, capacity=150, reduced_edges=0)
    tasks = len(two_pin_tasks(chip))

    def whole() -> float:
        sequential_astar(chip)
        return tasks

    yield bench.versus(
        f"sequential A*, 11 507 nets of {tasks} tasks on 64×64×2",
        "tasks/s",
        whole,
        "networkx's astar_path, capacities left out",
        _networkx(chip, 30),
    )


# --- in processes of their own --------------------------------------------------------------------

_START = """
import json, sys, time
started = time.perf_counter()
from marouting import global_routing_v0
imported = time.perf_counter()
env = global_routing_v0.env()
env.reset(seed=0)
env.last()
print(json.dumps([imported - started, time.perf_counter() - imported]))
"""


def _started(cache: str) -> list[float]:
    """Seconds of the import and of the first environment, in a process with a cache."""
    done = subprocess.run(
        [sys.executable, "-c", _START],
        env={**os.environ, "NUMBA_CACHE_DIR": cache},
        capture_output=True,
        check=True,
        text=True,
    )
    numbers: list[float] = json.loads(done.stdout)
    return numbers


def start(bench: Bench) -> Iterator[Measurement]:
    """Import and first environment, with and without compiled code on disk."""
    with tempfile.TemporaryDirectory() as cache:
        cold = _started(cache)
        warm = [_started(cache) for _ in range(bench.repeats)]
    imports, first = (sorted(column) for column in zip(*warm, strict=True))
    middle = len(imports) // 2
    yield Measurement("import marouting", imports[middle], imports[0], "s")
    yield Measurement("env() and reset(), nothing compiled yet", cold[1], cold[1], "s")
    yield Measurement(
        "env() and reset(), compiled before",
        first[middle],
        first[0],
        "s",
        1,
        "nothing compiled yet",
        cold[1],
        cold[1] / first[middle],
    )
