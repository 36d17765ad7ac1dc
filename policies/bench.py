"""Speed, as ratios measured in one run: ``marouting bench``.

Every figure stands beside a comparator that ran in the same process at the same time, in turns with
it, because a figure alone says as much about the machine as about the code. Each is the median of
several repeats; the best is given too, since whatever else runs on a machine only makes it slower.
"""

import itertools
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from marouting import InputError, Problem, generate, global_routing_v0, sequential_astar
from marouting.decomposition import two_pin_tasks
from marouting.grid import MOVES, Grid
from marouting.vector import BatchEnv
from policies.config import Config, DQNOptions, TrainOptions, check
from policies.learned.dqn import Rule, backends
from policies.learned.replay import GOES_ON, MOVE, REWARD, Replay
from policies.learned.streams import keys
from policies.learned.trainer import Trainer
from policies.threads import use_threads

PAPER = (32, 64, 32)
"""Hidden layers of the paper's network."""


@dataclass(frozen=True)
class Row:
    """A figure and what it was compared with.

    Attributes:
        name: what was measured.
        value: the median of the repeats.
        best: the best of them.
        unit: of both.
        threads: that did it.
        comparator: what ran in turns with it; empty: nothing comparable.
        against: the comparator's median, in the same unit.
        ratio: how many times as fast, or as small, as the comparator.
        target: what the project set itself, of ``value``, in words.
    """

    name: str
    value: float
    best: float
    unit: str
    threads: int = 1
    comparator: str = ""
    against: float | None = None
    ratio: float | None = None
    target: str = ""


Work = Callable[[], float]
"""Does some work and returns how much: so many steps, problems, bytes."""


def rate(work: Work) -> float:
    """Work a second."""
    started = time.perf_counter()
    done = work()
    return done / (time.perf_counter() - started)


@dataclass(frozen=True)
class Bench:
    """How to measure.

    Attributes:
        repeats: of every measurement.
        threads: of the measurements with several.
        details: what rows were worked out from, filled by sections, plain data.
    """

    repeats: int = 7
    threads: int = 2
    details: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check("repeats", self.repeats >= 1, "a number from 1")
        check("threads", self.threads >= 1, "a number from 1")

    def rates(self, *works: Work) -> list[list[float]]:
        """The rates of pieces of work, done in turns after a first time that is not kept."""
        for work in works:
            work()
        turns = [[rate(work) for work in works] for _ in range(self.repeats)]
        return [list(column) for column in zip(*turns, strict=True)]

    def versus(
        self,
        name: str,
        unit: str,
        work: Work,
        comparator: str = "",
        other: Work | None = None,
        *,
        threads: int = 1,
        target: str = "",
    ) -> Row:
        """A row of work against other work, or of work alone."""
        measured = self.rates(work, *([] if other is None else [other]))
        mine = statistics.median(measured[0])
        theirs = None if other is None else statistics.median(measured[1])
        return Row(
            name,
            mine,
            max(measured[0]),
            unit,
            threads,
            comparator,
            theirs,
            None if theirs is None else mine / theirs,
            target,
        )


def _problem(nets: int = 50, seed: int = 0) -> Problem:
    return generate(1, nets=nets, seed=seed)[0]


# --- the environment ------------------------------------------------------------------------------


def _batched(threads: int, steps: int = 60, problems: int = 1024) -> Work:
    """Random moves of all agents of a batch of the paper's problems."""
    env = BatchEnv(generate(16) * (problems // 16), threads=threads)
    env.reset()
    shape = (problems, env.num_agents)
    moves = np.random.default_rng(0).integers(MOVES, size=(8, *shape), dtype=np.int8)

    def work() -> float:
        for step in range(steps):
            env.step(moves[step % len(moves)])
        return steps * shape[0] * shape[1]

    return work


def batch(bench: Bench) -> Iterator[Row]:
    """The batched environment, with observations, masks and rewards."""
    unit = "agent-steps/s"
    one = _batched(1)
    yield bench.versus(
        "BatchEnv, 1024 problems of 50 nets",
        unit,
        one,
        "Parallel face, 50 nets",
        _parallel(global_routing_v0.parallel_env(_problem())),
        target="30 M",
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


def _parallel(env: Any, steps: int = 300) -> Work:
    """All agents of a Parallel environment, moving in circles."""
    env.reset(seed=0)
    moves = [
        {agent: (k + i) % MOVES for i, agent in enumerate(env.possible_agents)}
        for k in range(MOVES)
    ]

    def work() -> float:
        done = 0
        for step in range(steps):
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


def faces(bench: Bench) -> Iterator[Row]:
    """The faces of PettingZoo, against environments that do nothing."""
    from pettingzoo.utils import wrappers

    from policies.floor import EmptyAEC

    def wrapped(env: Any) -> Any:
        return wrappers.OrderEnforcingWrapper(wrappers.AssertOutOfBoundsWrapper(env))

    problem = _problem()
    yield bench.versus(
        "AEC face: last() and step()",
        "steps/s",
        _turns(global_routing_v0.env(problem)),
        "an empty AEC environment under the same wrappers",
        _turns(wrapped(EmptyAEC())),
        target="0.7 of the comparator",
    )
    yield bench.versus(
        "raw_env: step()",
        "steps/s",
        _turns(global_routing_v0.raw_env(problem), 10_000, last=False),
        "an empty AEC environment, bare",
        _turns(EmptyAEC(), 10_000, last=False),
        target="150 000",
    )
    yield bench.versus(
        "Parallel face, 50 nets",
        "agent-steps/s",
        _parallel(global_routing_v0.parallel_env(problem)),
        "raw_env: step()",
        _turns(global_routing_v0.raw_env(problem), 10_000, last=False),
        target="700 000",
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

_LARGE = """
import gc, json, os, sys, time
from marouting import generate, global_routing_v0

def megabytes():
    # What the process has in memory now.
    gc.collect()
    pages = int(open("/proc/self/statm").read().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

make = getattr(global_routing_v0, sys.argv[1])
make().reset(seed=0)  # compiled code is there, whoever plays
problem = generate(1, grid=(64, 64, 2), nets=10_000, capacity=60, reduced_edges=0)[0]
before = megabytes()
made = time.perf_counter()
env = make(problem)
env.reset(seed=0)
reset = time.perf_counter()
env.reset(seed=0)
done = time.perf_counter()
# An episode touches what has only been promised.
for step in range(60 if sys.argv[1] == "parallel_env" else 300_000):
    if not env.agents:
        break
    if sys.argv[1] == "parallel_env":
        env.step({agent: (step + i) % 6 for i, agent in enumerate(env.agents)})
    else:
        over = env.terminations[env.agent_selection] or env.truncations[env.agent_selection]
        env.step(None if over else step % 6)
print(json.dumps([megabytes() - before, reset - made, done - reset]))
"""


def _child(code: str, *arguments: str, **variables: str) -> list[float]:
    """The numbers that a Python program prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, **variables},
        capture_output=True,
        check=True,
        text=True,
    )
    numbers: list[float] = json.loads(done.stdout)
    return numbers


def start(bench: Bench) -> Iterator[Row]:
    """Import and first environment, with and without compiled code on disk."""
    with tempfile.TemporaryDirectory() as cache:
        cold = _child(_START, NUMBA_CACHE_DIR=cache)
        warm = [_child(_START, NUMBA_CACHE_DIR=cache) for _ in range(bench.repeats)]
    imports, first = (sorted(column) for column in zip(*warm, strict=True))
    middle = len(imports) // 2
    yield Row("import marouting", imports[middle], imports[0], "s", target="2 s")
    yield Row("env() and reset(), nothing compiled yet", cold[1], cold[1], "s", target="5 s")
    yield Row(
        "env() and reset(), compiled before",
        first[middle],
        first[0],
        "s",
        1,
        "nothing compiled yet",
        cold[1],
        cold[1] / first[middle],
        "0.5 s",
    )


def large(bench: Bench) -> Iterator[Row]:
    """Memory (on Linux alone) and reset of an environment of ten thousand nets."""
    del bench
    if sys.platform != "linux":
        return
    for face in ("raw_env", "parallel_env"):
        megabytes, made, reset = _child(_LARGE, face)
        name = f"{face}, 10 000 nets on 64×64×2"
        yield Row(f"{name}: memory", megabytes, megabytes, "MB", target="200 MB")
        yield Row(f"{name}: making it", made, made, "s")
        yield Row(f"{name}: reset()", reset, reset, "s", target="1 s")


# --- training -------------------------------------------------------------------------------------


def _sizes() -> tuple[int, ...]:
    return (12, *PAPER, MOVES)


def operations(sizes: Sequence[int], batch_size: int) -> int:
    """Multiplications and additions of matrix products in a gradient step.

    Two passes forward, the target's and the network's own; backward, the derivatives by all weights
    and by the inputs of all layers but the first.
    """
    weights = [a * b for a, b in itertools.pairwise(sizes)]
    return 2 * batch_size * (4 * sum(weights) - weights[0])


def _gemm(side: int = 768) -> Work:
    """One large product of matrices: as many operations a second as the processor can do."""
    a, b = torch.randn(side, side), torch.randn(side, side)

    def work() -> float:
        torch.set_num_threads(1)
        for _ in range(4):
            torch.mm(a, b)
        return 4 * 2 * side**3

    return work


def _eager(steps: int = 150) -> Work:
    """The gradient steps of a DQN written in torch as in any tutorial."""
    torch.manual_seed(0)
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(_sizes()):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    online = nn.Sequential(*layers[:-1])
    target = nn.Sequential(*layers[:-1])
    adam = torch.optim.Adam(online.parameters(), lr=1e-4, fused=True)
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(50_000, 12)).astype(np.float32)
    moves = rng.integers(MOVES, size=(50_000, 1))
    rewards = rng.normal(size=50_000).astype(np.float32)

    def work() -> float:
        torch.set_num_threads(1)  # more cost more than they save on a network this small
        for _ in range(steps):
            rows = rng.integers(50_000, size=32)
            with torch.no_grad():
                best = target(torch.from_numpy(seen[rows])).max(dim=1).values
                wanted = torch.from_numpy(rewards[rows]) + 0.95 * best
            chosen = online(torch.from_numpy(seen[rows]))
            chosen = chosen.gather(1, torch.from_numpy(moves[rows]))[:, 0]
            loss = nn.functional.mse_loss(chosen, wanted)
            adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            adam.step()
        return steps

    return work


def _steps(stack: int, backend: Any, threads: int, device: str = "cpu") -> Work:
    """Gradient steps of a stack of the paper's networks, apart from any game."""
    use_threads(threads)
    rng = np.random.default_rng(0)
    capacity, width = 50_000, 12
    replay = Replay(stack, capacity, width, masks=False, device=torch.device(device))
    rows = replay.rows.cpu().numpy()
    rows[..., : 2 * width] = rng.integers(8, size=(capacity, 2 * width))
    rows[..., 2 * width + MOVE] = rng.integers(MOVES, size=capacity)
    rows[..., 2 * width + REWARD] = -1
    rows[..., 2 * width + GOES_ON] = 1
    replay.rows.copy_(torch.from_numpy(rows))
    replay.stored[:] = capacity
    learner = backends()[backend](
        replay,
        PAPER,
        MOVES,
        seeds=range(stack),
        keys=keys(0, [str(m) for m in range(stack)], "sample"),
        rule=Rule(32, 0.95, 1000, 1e-4),
        threads=threads,
    )
    due = np.ones(stack, np.int64)
    rounds = max(1, 4000 // stack)

    def work() -> float:
        use_threads(threads)
        for _ in range(rounds):
            learner.learn(due)
        if device != "cpu":
            torch.cuda.synchronize()
        return rounds * stack

    return work


def _training(stack: int, threads: int, device: str = "cpu") -> Work:
    """The whole training loop of the paper's DQN: gradient steps, one a move."""
    problems = {f"problem_{m}": problem for m, problem in enumerate(generate(stack))}
    config = Config(
        dqn=DQNOptions(gamma=0.95, target_period=1000),
        train=TrainOptions(threads=threads, device=device),
    )
    trainer = Trainer(problems, config)
    trainer.burn_in()
    loop = trainer.run()
    rounds = 40 if stack == 1 else 2

    def work() -> float:
        use_threads(threads)
        before = trainer.learner.steps.sum()
        for _ in range(rounds):
            next(loop)
        return float(trainer.learner.steps.sum() - before)

    return work


def training(bench: Bench) -> Iterator[Row]:
    """Gradient steps and whole trainings, against eager torch and the bound by products."""
    unit = "gradient steps/s"
    eager, gemm = _eager(), _gemm()
    scale = operations(_sizes(), 32)

    def bound() -> float:
        return gemm() / scale

    yield bench.versus("one problem, whole training", unit, _training(1, 1), "eager torch DQN",
                       eager, target="4 000")  # fmt: skip
    yield bench.versus("40 stacked, torch's batched products", unit, _steps(40, "torch", 1),
                       "eager torch DQN", eager)  # fmt: skip
    yield bench.versus("40 stacked, gradient steps alone", unit, _steps(40, "compiled", 1),
                       "large matrix products (bound)", bound)  # fmt: skip
    for threads in dict.fromkeys((1, bench.threads)):
        yield bench.versus(
            "40 stacked, whole training",
            unit,
            _training(40, threads),
            "eager torch DQN",
            eager,
            threads=threads,
            target="50 000 on two threads" if threads > 1 else "",
        )
    if torch.cuda.is_available():
        yield bench.versus(
            "320 stacked on a GPU, whole training",
            unit,
            _training(320, 1, "cuda"),
            "eager torch DQN on the processor",
            eager,
            target="1 M",
        )


# --- A* and scaling -------------------------------------------------------------------------------


def _graph(problem: Problem) -> Any:
    """The grid as a graph of networkx."""
    import networkx

    grid = Grid.of(problem.grid)
    graph = networkx.Graph()
    edges = np.flatnonzero(grid.exists)
    graph.add_edges_from(zip(*(ends.tolist() for ends in grid.ends(edges)), strict=True), weight=1)
    return graph


def _networkx(problem: Problem, tasks: int | None = None) -> Work:
    """Tasks of a problem, all or so many, as shortest paths of networkx: less than A* does here."""
    import networkx

    graph = _graph(problem)
    pairs = two_pin_tasks(problem)[:tasks, 1:].tolist()
    position = Grid.of(problem.grid).position.tolist()

    def distance(a: int, b: int) -> int:
        return sum(abs(p - q) for p, q in zip(position[a], position[b], strict=True))

    def work() -> float:
        for source, target in pairs:
            networkx.astar_path(graph, source, target, heuristic=distance)
        return len(pairs)

    return work


def _fresh(problem: Problem) -> Problem:
    """The same problem, of which nothing has been worked out yet."""
    return Problem(**{name: getattr(problem, name) for name in problem.__dataclass_fields__})


def search(bench: Bench) -> Iterator[Row]:
    """Sequential A*, from a problem to its solution."""
    problems = generate(100)
    # Problems of which nothing has been worked out yet, for every repeat and the first time.
    stock = [[_fresh(problem) for problem in problems] for _ in range(bench.repeats + 1)]

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
        target="200 000 (0.25 ms a problem)",
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
        target=f"{tasks / 2:.0f} (2 s in all)",
    )


def growth(bench: Bench) -> Iterator[Row]:
    """How time grows with routed edges (:mod:`policies.scaling`)."""
    from policies.scaling import measure

    found = measure(budget=0.1 * bench.repeats)
    bench.details["growth"] = found["rows"]
    for family, works in found["exponents"].items():
        for work, exponent in works.items():
            name = f"{work}, {family}: exponent of time over routed edges"
            yield Row(name, exponent, exponent, "", target="1.2 at most")


def jumanji(bench: Bench) -> Iterator[Row]:
    """The batched environment against Jumanji's Connector, both on one core."""
    from policies.jumanji import Connector, one_core

    with one_core(), Connector(1024) as connector:
        yield bench.versus(
            "BatchEnv, 1024 problems of 50 nets, on one core",
            "agent-steps/s",
            _batched(1),
            "Jumanji's Connector-v3, 1024 games of 10 agents",
            connector,
            target="3 times the comparator",
        )


SECTIONS: Mapping[str, Callable[[Bench], Iterator[Row]]] = {
    "start": start,
    "batch": batch,
    "faces": faces,
    "large": large,
    "search": search,
    "training": training,
    "growth": growth,
    "jumanji": jumanji,
}
"""What can be measured, by name."""


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    packages = ("numpy", "numba", "torch", "pettingzoo", "gymnasium", "scipy")
    return {
        "date": time.strftime("%Y-%m-%d"),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in packages},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def run(
    sections: Sequence[str], bench: Bench, watch: Callable[[str, Row | None], None]
) -> dict[str, Any]:
    """Measures some sections.

    Args:
        sections: names of :data:`SECTIONS`.
        bench: how to measure.
        watch: called with the name of a section as it starts, and with every row as it is there.

    Returns:
        The machine, the rows and their details, plain data.

    Raises:
        InputError: there is no such section.
    """
    rows = []
    for name in sections:
        if name not in SECTIONS:
            raise InputError(f"{name}: expected one of {', '.join(SECTIONS)}")
    for name in sections:
        watch(name, None)
        for row in SECTIONS[name](bench):
            rows.append({"section": name, **asdict(row)})
            watch(name, row)
    return {"machine": machine(), "repeats": bench.repeats, "rows": rows, **bench.details}
