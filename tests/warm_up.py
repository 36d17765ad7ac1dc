"""Compiles what many tests use, so that test processes side by side do not each compile it.

python tests/warm_up.py plain|rip_up|routers|trainings …
"""

import sys
import tempfile
from typing import Any

from marouting import generate
from marouting.config import build
from marouting.vector import BatchEnv

ROUTERS: dict[str, dict[str, Any]] = {
    "pathfinder": {},
    "optimal": {},
    "greedy": {},
    "generalist": {"seconds": 0.05},  # the last: by then the other process has compiled the rip-up
}
PLAIN: list[dict[str, Any]] = [
    {},
    {"reward": "team"},
    {"observation": "window"},
]
RIP_UP: list[dict[str, Any]] = [
    {"rip_up": {"rounds": 1}, "reward": "team"},
    {"rip_up": {"rounds": 1}, "target": "tree", "next_pin": "nearest", "mask": {"visited": True}},
    {"rip_up": {"rounds": 1}, "reward": "team", "observation": "window"},
    {"rip_up": {"rounds": 1}, "observation": "window"},
]
TRAININGS: list[dict[str, Any]] = [
    {"env": {"agents": "single"}},
    {"env": {"agents": "multi"}},
    {"env": {"agents": "multi"}, "learner": {"kind": "ppo"}},
]


def play(games: list[dict[str, Any]]) -> None:
    """Plays a few steps of batches."""
    problems = generate(2, (6, 6, 2), 8, max_pins=3, capacity=2, seed=1)
    for options in games:
        for everyone in (True, False):
            env = BatchEnv(problems, everyone=everyone, **options)
            _, info = env.reset()
            for _ in range(3):
                *_, info = env.step(info["action_mask"].argmax(axis=-1))


def routers() -> None:
    """Routes a small problem by every router that compiles much."""
    from policies.routers.registry import make_router

    # Without A*, which the other process compiles.
    (problem,) = generate(1, (6, 6, 2), 12, max_pins=5, capacity=2, reduced_edges=0, seed=1)
    for name, options in ROUTERS.items():
        make_router(name, options).route(problem)


def trainings() -> None:
    """Trains for two episodes."""
    from policies.learned.config import Config
    from policies.learned.run import Run

    quiet = {"episodes": 2, "figures": False, "tensorboard": False}
    for options in TRAININGS:
        options["env"]["problem"] = {"grid": [4, 4, 2], "nets": 3}
        with tempfile.TemporaryDirectory() as folder:
            raw = {"out": f"{folder}/run", "train": quiet, **options}
            Run(build(Config, raw)).execute()


if __name__ == "__main__":
    for part in sys.argv[1:]:
        {
            "plain": lambda: play(PLAIN),
            "rip_up": lambda: play(RIP_UP),
            "routers": routers,
            "trainings": trainings,
        }[part]()
