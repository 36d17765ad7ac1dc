"""Speed of trainings, against eager torch and the bound by products."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import nn

from marouting import generate
from marouting.config import build
from marouting.problem.grid import MOVES
from policies.bench.measure import Bench, Measurement, Work
from policies.learned.config import Config
from policies.learned.memory.replay import GOES_ON, MOVE, REWARD
from policies.learned.threads import use_threads
from policies.learned.trainer import Trainer

PAPER = (32, 64, 32)
"""Hidden layers of the paper's network."""


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


def _trainer(stack: int, threads: int, device: str = "cpu", **learner: Any) -> Trainer:
    """A training of the paper's DQN on problems of its Table 2."""
    problems = {f"problem_{m}": problem for m, problem in enumerate(generate(stack))}
    use_threads(threads)
    raw = {"learner": learner, "train": {"threads": threads, "device": device, "episodes": 5000}}
    return Trainer(problems, build(Config, raw))


def _steps(stack: int, fused: bool, threads: int, device: str = "cpu") -> Work:
    """Gradient steps of a stack of the paper's networks, apart from any game."""
    learner: Any = _trainer(stack, threads, device, fused=fused).learner
    rng = np.random.default_rng(0)
    store = learner.memory.store
    capacity, width = store.shape[1], 12
    rows = store.cpu().numpy()
    rows[..., : 2 * width] = rng.integers(8, size=(capacity, 2 * width))
    rows[..., 2 * width + MOVE] = rng.integers(MOVES, size=capacity)
    rows[..., 2 * width + REWARD] = -1
    rows[..., 2 * width + GOES_ON] = 1
    store.copy_(torch.from_numpy(rows))
    learner.memory.stored[:] = capacity
    learner.memory.bind()
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
    """The whole training loop of the paper's DQN: gradient steps, one per move."""
    trainer = _trainer(stack, threads, device)
    trainer.burn_in()
    loop = trainer.run()
    rounds = 40 if stack == 1 else 2

    def work() -> float:
        use_threads(threads)
        before = trainer.learner.updates.sum()
        for _ in range(rounds):
            next(loop)
        return float(trainer.learner.updates.sum() - before)

    return work


def _samples(kind: str, problems: int = 4, **learner: Any) -> Work:
    """Agent-steps of a training with every net an agent, learning included, on one core."""
    use_threads(1)
    made = {f"problem_{m}": problem for m, problem in enumerate(generate(problems))}
    raw = {
        "env": {"agents": "multi"},
        "learner": {"kind": kind, **learner},
        "train": {"episodes": 10**6, "shared": True},
    }
    loop = Trainer(made, build(Config, raw)).run()

    def work() -> float:
        use_threads(1)
        done = 0
        while done < 60_000:
            done += sum(episode.steps for episode in next(loop))
        return done

    return work


def training(bench: Bench) -> Iterator[Measurement]:
    """Gradient steps and whole trainings, against eager torch and the bound by products."""
    unit = "gradient steps/s"
    eager, gemm = _eager(), _gemm()
    scale = operations(_sizes(), 32)

    def bound() -> float:
        return gemm() / scale

    yield bench.versus("one problem, whole training", unit, _training(1, 1), "eager torch DQN",
                       eager, target="4 000")  # fmt: skip
    yield bench.versus("40 stacked, torch's batched products", unit, _steps(40, False, 1),
                       "eager torch DQN", eager)  # fmt: skip
    yield bench.versus("40 stacked, gradient steps alone", unit, _steps(40, True, 1),
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
    yield bench.versus("PPO, 4 problems sharing a network of two layers of 64", "agent-steps/s",
                       _samples("ppo", network={"kind": "mlp", "hidden": [64, 64]}),
                       target="150 000")  # fmt: skip
    if torch.cuda.is_available():
        yield bench.versus(
            "320 stacked on a GPU, whole training",
            unit,
            _training(320, 1, "cuda"),
            "eager torch DQN on the processor",
            eager,
            target="1 M",
        )
