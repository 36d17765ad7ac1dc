"""What a training is told: the schema of a configuration, and the one place of its defaults.

``configs/paper/default.yaml`` holds every key with a comment. The defaults are the paper's.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from marouting.config import MOST, build, check, override, read_yaml
from marouting.options import EnvOptions


@dataclass(frozen=True, kw_only=True)
class DQNOptions:
    """The learner (paper, Table 1 and Appendix B).

    Attributes:
        hidden: units of the hidden layers.
        init: initial weights, ``torch`` (uniform in ±1/√inputs) or ``uniform`` (±0.5, biases 0,
            as the authors' code).
        gamma: discount factor.
        learning_rate: Adam's.
        batch_size: transitions a gradient step.
        buffer_size: transitions that the replay memory of a network holds.
        burn_in: whose moves fill the memory first: ``astar``, ``random``, ``pathfinder``,
            ``optimal``, or a solution file, see :func:`policies.learned.burn_in.guide`.
        burn_in_size: how many of them.
        epsilon: chance of a random move.
        epsilon_final: what ``epsilon`` falls to, linearly, between the episodes
            ``epsilon_decay_from`` and the last; None: it stays.
        epsilon_decay_from: the episode from which it falls.
        target_period: gradient steps between copies of the network to its target; 0: the network
            is its own target.
        masking: whether only moves that cross an edge are chosen and bootstrapped from.
        steps_per_update: moves to each gradient step.
        shared: whether one network, with one memory, learns all problems; otherwise each has its
            own.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    hidden: tuple[int, ...] = (32, 64, 32)
    init: Literal["torch", "uniform"] = "torch"
    gamma: float = 1.0
    learning_rate: float = 1e-4
    batch_size: int = 32
    buffer_size: int = 50_000
    burn_in: str = "astar"
    burn_in_size: int = 10_000
    epsilon: float = 0.05
    epsilon_final: float | None = None
    epsilon_decay_from: int = 0
    target_period: int = 0
    masking: bool = False
    steps_per_update: int = 1
    shared: bool = False

    def __post_init__(self) -> None:
        check("hidden", all(1 <= units <= 4096 for units in self.hidden), "numbers from 1 to 4096")
        check("gamma", 0 <= self.gamma <= 1, "a number from 0 to 1")
        check("learning_rate", self.learning_rate > 0, "a number above 0")
        check("batch_size", 1 <= self.batch_size <= 65536, "a number from 1 to 65536")
        check("burn_in_size", self.burn_in_size >= 1, "a number from 1")
        check("buffer_size", self.buffer_size >= self.burn_in_size, "at least burn_in_size")
        check("buffer_size", self.buffer_size <= MOST, f"a number up to {MOST}")
        check("epsilon", 0 <= self.epsilon <= 1, "a number from 0 to 1")
        final = self.epsilon if self.epsilon_final is None else self.epsilon_final
        check("epsilon_final", 0 <= final <= 1, "a number from 0 to 1")
        check("epsilon_decay_from", self.epsilon_decay_from >= 0, "a number from 0")
        check("target_period", 0 <= self.target_period <= MOST, f"a number from 0 to {MOST}")
        check("steps_per_update", 1 <= self.steps_per_update <= MOST, f"a number from 1 to {MOST}")

    def epsilon_at(self, episode: int, episodes: int) -> float:
        """The chance of a random move in an episode (counted from 0) of a training."""
        if self.epsilon_final is None or episode <= self.epsilon_decay_from:
            return self.epsilon
        span = max(episodes - 1 - self.epsilon_decay_from, 1)
        share = min((episode - self.epsilon_decay_from) / span, 1.0)
        return self.epsilon + share * (self.epsilon_final - self.epsilon)


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """How a training runs.

    Attributes:
        episodes: episodes a problem; one is a walk through all two-pin tasks of all nets.
        device: ``cpu``, or ``cuda`` for the networks.
        backend: ``compiled`` (one network after the other, for the processor) or ``torch``
            (batched over the stack); None: the one that suits the device.
        threads: threads that share the networks of a stack (and torch's products).
        best: which episode's routes are the solution, the earliest of the best: ``routes``, by
            tasks joined, then overflow, then wirelength; or ``reward``, by tasks joined, then
            reward (the authors' code).
        checkpoint_seconds: time between checkpoints.
        tensorboard: whether to write TensorBoard's event files beside ``metrics.jsonl``.
        figures: whether to draw the figures at the end.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    episodes: int = 5000
    device: str = "cpu"
    backend: Literal["compiled", "torch"] | None = None
    threads: int = 1
    best: Literal["routes", "reward"] = "routes"
    checkpoint_seconds: float = 60.0
    tensorboard: bool = True
    figures: bool = True

    def __post_init__(self) -> None:
        check("episodes", 1 <= self.episodes <= MOST, f"a number from 1 to {MOST}")
        check(
            "backend", self.backend != "compiled" or self.device == "cpu", "torch for this device"
        )
        check("threads", 1 <= self.threads <= 1024, "a number from 1")
        check("checkpoint_seconds", self.checkpoint_seconds >= 0, "a number from 0")


@dataclass(frozen=True, kw_only=True)
class Config:
    """A training: the game, the learner, the run.

    Attributes:
        seed: where all random numbers of the training start.
        out: the run folder; it must not hold another run.
        env: the game, and ``agents: single | multi``.
        dqn: the learner.
        train: the run.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    seed: int = 0
    out: str = "runs/dqn"
    env: EnvOptions = field(default_factory=EnvOptions)
    dqn: DQNOptions = field(default_factory=DQNOptions)
    train: TrainOptions = field(default_factory=TrainOptions)

    def __post_init__(self) -> None:
        check("seed", 0 <= self.seed < 2**63, "a number from 0")


def load_config(path: str | os.PathLike[str] | None, overrides: Sequence[str] = ()) -> Config:
    """Reads a configuration and changes single keys of it.

    Args:
        path: a YAML file; None for the defaults.
        overrides: ``key=value`` with dots between the parts of a key, the value as in YAML.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    raw = {} if path is None else read_yaml(path)
    return build(Config, override(raw, overrides), "" if path is None else os.fspath(path))
