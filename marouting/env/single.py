"""The Gymnasium environment: one player moves all nets in turn order (the paper's single agent)."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import logger
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from marouting.config import check
from marouting.env.base import METADATA, ONE_PLAYER, GameEnv, checked_move, result_of
from marouting.game import NOBODY
from marouting.source import Source


class GlobalRoutingSingle(GameEnv, gymnasium.Env[Any, Any]):
    """Global routing as a game for one player: every step moves the net whose turn it is.

    The observation is that of the net to move. The episode is terminated when all tasks of all nets
    are joined, and truncated when all tasks have ended and some failed. The reward is the sum of
    what a move pays all nets. ``info`` holds the ``action_mask`` and the name of the ``net`` to
    move, what ``task_ended`` with the move, and, at the end, the ``metrics``; the first one of an
    episode has the name of the ``problem``, if there are several.

    Args:
        problem: see :data:`marouting.source.Source`.
        render_mode: ``ansi``, ``rgb_array``, ``human`` or None.
        **options: the other fields of :class:`marouting.options.GameOptions`.
    """

    metadata = METADATA
    _saved_names = ("_net", "_np_random", "_np_random_seed")

    def __init__(
        self, problem: Source = None, render_mode: str | None = None, **options: Any
    ) -> None:
        EzPickle.__init__(self, problem, render_mode, **options)
        self._open(problem, "single", {**options, "render_mode": render_mode})
        check("agents_persist", not options.get("agents_persist"), ONE_PLAYER)
        self.observation_space = self._new_space()
        self.action_space = Discrete(self._actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: decides which problems this and later episodes play, if there are several.
            options: ignored; Gymnasium's interface has them.
        """
        del options
        super().reset(seed=seed)
        self._restart(seed)
        if self.render_mode == "human":
            self.render()
        seen, info = self._look()
        if self._stream.many:
            info["problem"] = self.problem_name
        return seen, info

    def action_masks(self) -> NDArray[np.bool_]:
        """(A,) bool, the moves of the net to move that cross an edge, as sb3-contrib asks."""
        return self._mask(self.game.turn).astype(np.bool_)

    def _look(self) -> tuple[Any, dict[str, Any]]:
        """Observation and info of the net to move."""
        n = self._net = self.game.turn
        mask = self._mask(n)
        info = {self._mask_key: mask, "net": self._names[n]}
        return self._with_mask(self._see(n), mask), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Moves the net whose turn it is.

        Once the episode is over, a step changes nothing, pays nothing and gives a warning.

        Raises:
            ResetNeeded: no episode has begun.
            ValueError: the action is not one of the actions.
        """
        self._check_begun()
        move, game = checked_move(action, self._actions), self.game
        reward, ended = 0.0, {}
        if (n := game.turn) == NOBODY:
            logger.warn("step(): the episode is over, and nothing changes before reset().")
        else:
            paid = self._move(n, move)
            reward = paid if self._pays_mover else paid.sum().item()
            ended = self._task_end(n)
            game.settle(n)
            game.pass_turn(n)
        if self.render_mode == "human":
            self.render()
        if game.turn != NOBODY:
            seen, info = self._look()
            return seen, reward, False, False, info | ended
        # At the end, the observation is that of the net that moved last.
        info = {self._mask_key: self._mask(self._net)} | result_of(self.game.metrics()) | ended
        info["net"] = self._names[self._net]
        joined = info["open"] == 0
        return self._shown(self._net), reward, joined, not joined, info
