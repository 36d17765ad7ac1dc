"""What tests/test_cuda.py runs in numba's CUDA simulator, which has to be on before numba is."""

import sys
from typing import Any

import numpy as np
import torch

import marouting
from marouting.vector import BatchEnv
from policies.bench.cuda import CASES, compare, difference
from policies.learned.config import load_config
from policies.learned.device_trainer import DeviceTrainer
from policies.learned.run import problems_of


def play(first: int, last: int) -> None:
    """Compares games by some cases of options; prints one line for each."""
    problems = marouting.generate(2, nets=4, max_pins=3, grid=(4, 4, 2), capacity=1, seed=1)
    for options in CASES[first:last]:
        print(compare(problems, 16, **options))


def check() -> None:
    """Prints what the environment says of an action that is out of range."""
    env: Any = BatchEnv(marouting.generate(1, nets=3, grid=(4, 4, 2), capacity=1), device="cuda")
    env.reset()
    env.step(env._device.of(np.full((1, env.num_agents), 9, np.int32)))
    try:
        env.reset()
    except ValueError as error:
        print(error)


def trainer() -> DeviceTrainer:
    """A small training on the device."""
    changes = [
        "learner.kind=mappo", "env.scenario=gates-8x7-v0", "train.device=cuda", "train.games=2",
        "train.problems=3", "train.validation=1", "train.steps=100000",
        "train.evaluate_every=100000", "learner.network.hidden=[8]", "learner.rollout=16",
        "learner.minibatch=16",
    ]  # fmt: skip
    config = load_config(None, changes)
    problems, episodes = problems_of(config)
    assert episodes is not None
    return DeviceTrainer(problems, config, episodes)


def resume() -> None:
    """Trains in one go and in two; prints whether the results are the same."""

    def some(training: Any, rollouts: int) -> Any:
        for _ in zip(range(rollouts), training.run(), strict=False):
            pass
        return training.state()

    whole, first = trainer(), trainer()
    expected, kept = some(whole, 3), some(first, 2)
    again = trainer()
    again.load_state(kept, "checkpoint")
    found = some(again, 1)
    for part in ("actor", "critic"):
        print(torch.equal(expected["training"][part], found["training"][part]))
    told = [{"obs": of.ppo.now, "active": of.ppo.info["active"]} for of in (whole, again)]
    seen = difference(*told)
    print(seen is None)
    print(int(found["trainer"]["steps"]), int(expected["trainer"]["steps"]))


if __name__ == "__main__":
    torch.set_num_threads(1)
    if sys.argv[1] == "play":
        play(*map(int, sys.argv[2:]))
    elif sys.argv[1] == "check":
        check()
    else:
        resume()
