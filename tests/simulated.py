"""What tests/test_cuda.py runs in numba's CUDA simulator, which has to be on before numba is."""

import os
import pickle
import sys
from typing import Any

import numpy as np
import torch

import marouting
from marouting.cuda import env, games
from marouting.vector import BatchEnv
from policies.bench.cuda import CASES, WINDOW, compare, difference, on_host
from policies.learned import device_trainer
from policies.learned.config import load_config
from policies.learned.device_trainer import DeviceTrainer
from policies.learned.run import problems_of


def play() -> None:
    """Compares games by all cases of options; prints one line for each."""
    problems = marouting.generate(2, nets=4, max_pins=3, grid=(4, 4, 2), capacity=1, seed=1)
    for options in CASES:
        print(compare(problems, 16, **options))


class Follower:
    """Plays on the processor what a game of the device plays, whose rows are in turn order."""

    def __init__(self, problem: marouting.Problem, options: Any) -> None:
        self.env: Any = BatchEnv([problem], **options)
        self.order = self.env.engine.order[0]
        self.obs, self.info = self.env.reset()

    def step(self, moves: np.ndarray) -> None:
        """Makes the moves (N,) of the rows of the device."""
        actions = np.empty((1, len(self.order)), np.int32)
        actions[0, self.order] = moves[: len(self.order)]
        self.obs, *_, self.info = self.env.step(actions)

    def differs(self, obs: Any, info: Any, nets: np.ndarray, m: int) -> str | None:
        """The name of the first array that game m of the device has otherwise."""
        here = {"obs": self.obs, **self.info, "nets": self.env.engine.nets}
        there = {"obs": obs, **info, "nets": nets}
        rows = len(self.order)
        for name in ("nets", "obs", "action_mask", "active", "acted", "task_ended"):
            found = on_host(there[name])[m]
            if not np.array_equal(here[name][0, self.order], found[:rows]):
                return name
            if not (found[rows:] == (1 if name == "action_mask" else -(name == "nets"))).all():
                return f"{name} of rows without agents"
        ended = self.info["task_ended"][0, self.order] != 0
        for name in ("final_obs", "final_mask"):
            found = on_host(there[name])[m, :rows]
            if not np.array_equal(here[name][0, self.order][ended], found[ended]):
                return name
        figures = ("over", "overflow", "wirelength", "joined", "steps")
        return difference(
            {name: here[name] for name in figures},
            {name: on_host(there[name])[m : m + 1] for name in figures},
        )


def draw() -> None:
    """Compares games that draw their problems with the same problems on the processor.

    Problems have different numbers of nets. Once, one of the games begins before its time, and from
    the middle on, a copy of the environment plays. Prints what differs first, then how many
    episodes were played and how many different problems the games drew.
    """
    options: dict[str, Any] = {
        "observation": {**WINDOW, "radius": 1}, "reward": "team", "max_steps": 5,
    }  # fmt: skip
    problems = [
        marouting.generate(1, nets=nets, grid=(4, 4, 2), capacity=1, reduced_edges=0)[0]
        for nets in (2, 4, 3)
    ]
    env: Any = BatchEnv(2, problem=problems, device="cuda", **options)
    rng = np.random.default_rng(0)
    followers: dict[int, Follower] = {}
    drawn: list[tuple[int, int]] = []
    differs: str | None = None
    obs, info = env.reset(seed=3)
    begins = np.ones(2, np.bool_)
    for step in range(30):
        for m in np.flatnonzero(begins).tolist():
            drawn.append((m, int(on_host(info["problem"])[m])))
            followers[m] = Follower(env.pool[drawn[-1][1]], options)
        for m, follower in followers.items():
            differs = differs or follower.differs(obs, info, env.nets, m)
        mask, begins = on_host(info["action_mask"]), on_host(info["over"])
        if differs is not None:
            break
        if step == 5:
            begins = np.array([True, False])
            obs, info = env.reset(options={"reset_mask": begins})
            continue
        if step == 15:
            env = pickle.loads(pickle.dumps(env))
        moves = (mask * rng.random(mask.shape)).argmax(-1)
        obs, *_, info = env.step(moves)
        for m in np.flatnonzero(~begins).tolist():
            followers[m].step(moves[m])
    print(differs)
    print(len(drawn), len(set(drawn)))


def check() -> None:
    """Prints what the environment says of what it cannot use, and how scenarios order turns."""
    problems = marouting.generate(2, nets=3, grid=(4, 4, 2), capacity=1, reduced_edges=0)
    env: Any = BatchEnv(problems[:1], device="cuda")
    env.reset()
    env.step(env._device.of(np.full((1, env.num_agents), 9, np.int32)))
    drawing: Any = BatchEnv(1, problem=problems, device="cuda")
    wider = marouting.generate(1, nets=3, grid=(4, 4, 2), capacity=3, reduced_edges=0)[0]
    assert wider.nets == problems[0].nets
    floats = np.zeros((1, env.num_agents))
    for call in (
        env.reset,
        lambda: env.step(floats),
        lambda: env.step(env._device.of(floats)),
        lambda: drawing.reset(seed=-1),
        lambda: BatchEnv(problems[1:], device="cuda").restore(env.save()),
        lambda: BatchEnv([wider], device="cuda").restore(env.save()),
        lambda: BatchEnv(problems[:1], device="cuda", max_steps=3).restore(env.save()),
        lambda: env.restore([]),
        lambda: BatchEnv(1, device="cuda", threads=True),
        lambda: BatchEnv(1, device="cuda"),
        lambda: BatchEnv(1, problem=problems, device="cuda", pool=0.5),
    ):
        try:
            call()
        except ValueError as error:
            print(error)
    env.reset(seed=1)  # without effect, as on the processor
    for options in ({"scenario": "online-8x8-v0"}, {"problem": problems, "turn_order": None}):
        env = BatchEnv(1, device="cuda", pool=1, **options)
        print(env._static.sequential, type(env.observation).__name__)


def trainer() -> DeviceTrainer:
    """A small training on the device."""
    changes = [
        "learner.kind=mappo", "env.scenario=toy-4x4-v0", "env.agents=multi", "env.reward=team",
        "env.observation.kind=window", "env.observation.channels=[capacity,own,heads]",
        "env.observation.radius=1", "env.max_steps=4", "train.device=cuda", "train.games=2",
        "train.problems=3", "train.validation=1", "train.steps=100000",
        "train.evaluate_every=100000", "learner.network.hidden=[8]", "learner.rollout=16",
        "learner.minibatch=16",
    ]  # fmt: skip
    device_trainer.STEPS = 8
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
    print(int(found["trainer"]["episodes"]), int(expected["trainer"]["episodes"]))


if __name__ == "__main__":
    torch.set_num_threads(1)
    if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1":
        # So many threads clear a game together; in the simulator each is a thread of Python's.
        games.WARP = env.WARP = 3  # type: ignore[attr-defined]
    for name in sys.argv[1:]:
        print(f"== {name}")
        {"play": play, "check": check, "draw": draw, "resume": resume}[name]()
