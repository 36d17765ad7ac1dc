"""Speed of trainings, against eager torch."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import nn

from marouting import generate
from marouting.config import build
from marouting.problem.grid import MOVES
from policies.bench.measure import Bench, Measurement, Work
from policies.learned.config import Config
from policies.learned.machine import use_threads
from policies.learned.trainer import Trainer

PAPER = (32, 64, 32)
"""Hidden layers of the paper's network."""


def _eager() -> Work:
    """The gradient steps of a DQN written in torch as in any tutorial."""
    torch.manual_seed(0)
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise((12, *PAPER, MOVES)):
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
        for _ in range(150):
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
        return 150

    return work


def _trainer(problems: int, threads: int = 1, **raw: Any) -> Trainer:
    """A training on problems of the paper's Table 2."""
    made = {f"problem_{m}": problem for m, problem in enumerate(generate(problems))}
    use_threads(threads)
    return Trainer(made, build(Config, raw))


def _training(stack: int, threads: int, device: str = "cpu") -> Work:
    """The whole training loop of the paper's DQN: gradient steps, one per move."""
    run = {"threads": threads, "device": device, "episodes": 5000}
    trainer = _trainer(stack, threads, train=run)
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


def _ppo() -> Work:
    """Agent-steps of a PPO with every net an agent, learning included, on one core."""
    loop = _trainer(
        4,
        env={"agents": "multi"},
        learner={"kind": "ppo", "network": {"kind": "mlp", "hidden": [64, 64]}},
        train={"episodes": 10**6, "shared": True},
    ).run()

    def work() -> float:
        use_threads(1)
        done = 0
        while done < 60_000:
            done += sum(episode.steps for episode in next(loop))
        return done

    return work


def training(bench: Bench) -> Iterator[Measurement]:
    """Whole trainings, against eager torch."""
    unit, eager = "gradient steps/s", _eager()
    stacked = dict.fromkeys(((1, 1), (40, 1), (40, bench.threads)))
    for stack, threads in stacked:
        name = "one problem, whole training" if stack == 1 else f"{stack} stacked, whole training"
        work = _training(stack, threads)
        yield bench.versus(name, unit, work, "eager torch DQN", eager, threads=threads)
    yield bench.versus(
        "PPO, 4 problems sharing a network of two layers of 64",
        "agent-steps/s",
        _ppo(),
    )
    if torch.cuda.is_available():
        name = "320 stacked on a GPU, whole training"
        comparator = "eager torch DQN on the processor"
        yield bench.versus(name, unit, _training(320, 1, "cuda"), comparator, eager)
