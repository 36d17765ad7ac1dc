"""Random walks: what a router has to beat."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from marouting import Engine, InputError, Problem, Solution
from marouting.game.state import NOBODY


class RandomPolicy:
    """A move drawn uniformly from those that cross an edge.

    Args:
        seed: where the random numbers start.
    """

    def __init__(self, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: object, mask: np.ndarray) -> int:
        """A random move; the observation does not matter."""
        del observation
        return int(self._rng.choice(np.flatnonzero(mask)))


@dataclass(frozen=True)
class RandomRouter:
    """Every net walks at random, sequentially, until its tasks are joined or have failed.

    Attributes:
        seed: where the random numbers start; the same for the same routes.
        max_steps: steps after which a task fails; None as in :class:`marouting.Engine`.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    name: ClassVar[str] = "random"
    seed: int = 0
    max_steps: int | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed: expected a number from 0, found {self.seed}")

    def route(self, problem: Problem) -> Solution:
        """A solution in which few nets are joined, without overflow."""
        engine = Engine([problem], max_steps=self.max_steps)
        policy = RandomPolicy(self.seed)
        move = np.empty(1, np.int8)
        while engine.games[0]["agent"] != NOBODY:
            move[0] = policy.act(None, engine.masks(*engine.pairs(everyone=False))[0])
            engine.step(move)
        return engine.solution()
