"""Random walks: the weakest baseline."""

from dataclasses import dataclass

import numpy as np

from marouting import Engine, InputError, Problem, Solution
from marouting.game import NOBODY


class RandomPolicy:
    """Draws each move uniformly from those that cross an edge.

    Args:
        seed: seed of the random numbers, from 0.
    """

    def __init__(self, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: object, mask: np.ndarray) -> int:
        """Draws a move.

        Args:
            observation: ignored.
            mask: (6,) int8, nonzero for the moves that cross an edge; at least one is.

        Returns:
            The move, from 0 to 5.
        """
        del observation
        return int(self._rng.choice(np.flatnonzero(mask)))


@dataclass(frozen=True)
class RandomRouter:
    """Lets the nets walk at random, one after another, until each task is joined or has failed.

    Attributes:
        seed: seed of the random numbers; equal seeds give equal routes.
        max_steps: steps after which a task fails; None for the default of
            :class:`marouting.Engine`.

    Raises:
        InputError: ``seed`` is negative.
    """

    seed: int = 0
    max_steps: int | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed: expected a number from 0, found {self.seed}")

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution without overflow, in which usually few nets are joined.
        """
        engine = Engine([problem], max_steps=self.max_steps)
        policy = RandomPolicy(self.seed)
        move = np.empty(1, np.int8)
        while engine.games[0]["agent"] != NOBODY:
            move[0] = policy.act(None, engine.masks(*engine.pairs(everyone=False))[0])
            engine.step(move)
        return engine.solution()
