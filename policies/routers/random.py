"""Random walks: the weakest baseline."""

from dataclasses import dataclass

import numpy as np

from marouting import InputError, Problem, Solution
from marouting.game import Game, mask_table
from marouting.memory import PLAYED, TABLES, check_memory
from marouting.problem.grid import MOVES
from marouting.rules import Rules


@dataclass(frozen=True)
class RandomRouter:
    """Lets the nets walk at random, one after another, until each task is joined or has failed.

    Each move is drawn uniformly from those that cross an edge.

    Attributes:
        seed: seed of the random numbers, from 0; equal seeds give equal routes.
        max_steps: steps after which a task fails; None for the default of
            :class:`marouting.rules.Rules`.

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
        grid = problem.topology
        check_memory(grid.gcells * (TABLES + PLAYED), "a game on a grid of {}", grid)
        game, rng = Game(problem, Rules(max_steps=self.max_steps)), np.random.default_rng(self.seed)
        masks = mask_table(MOVES)
        while game.active:
            game.step(int(rng.choice(np.flatnonzero(masks[game.free_moves(game.turn)]))))
        return game.solution()
