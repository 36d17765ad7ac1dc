"""The Gymnasium environment: one player moves all nets in turn order (the paper's single agent)."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import logger
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from marouting.config import check
from marouting.env.base import METADATA, BaseGame, GameMethods, checked_move
from marouting.game import NOBODY
from marouting.options import ORDERS
from marouting.source import Source


class GlobalRoutingSingle(GameMethods, gymnasium.Env[Any, Any]):
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
    _episode = ("_net", "_np_random", "_np_random_seed")

    def __init__(
        self, problem: Source = None, render_mode: str | None = None, **options: Any
    ) -> None:
        EzPickle.__init__(self, problem, render_mode, **options)
        self._game = BaseGame(problem, ORDERS["single"], {**options, "render_mode": render_mode})
        check("agents_persist", not options.get("agents_persist"), "false: only one player")
        self.render_mode = render_mode
        self.observation_space = self._game.new_observation_space()
        self.action_space = Discrete(self._game.actions)

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
        self._game.restart(seed)
        if self.render_mode == "human":
            self.render()
        seen, info = self._look()
        if self._game.many:
            info["problem"] = self._game.name
        return seen, info

    def action_masks(self) -> NDArray[np.bool_]:
        """(A,) bool, the moves of the net to move that cross an edge, as sb3-contrib asks."""
        return self._game.player.buffers.mask[0, 0].astype(np.bool_)

    def _look(self) -> tuple[Any, dict[str, Any]]:
        """Observation and info of the net to move."""
        game = self._game
        buffers = game.player.buffers
        self._net = buffers.agents.item()
        mask = buffers.mask[0, 0].copy()
        info = game.info(mask, over=False) | {"net": game.names[self._net]}
        return game.seen(buffers.obs[0, 0].copy(), mask), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Moves the net whose turn it is.

        Once the episode is over, a step changes nothing, pays nothing and gives a warning.

        Raises:
            ResetNeeded: no episode has begun.
            ValueError: the action is not one of the actions.
        """
        game = self._game
        buffers = game.player.buffers
        game.check_begun()
        if buffers.agents.item() == NOBODY:
            logger.warn("step(): the episode is over, and nothing changes before reset().")
        buffers.actions[0, 0] = checked_move(action, game.actions)
        game.player.step()
        reward = buffers.reward.item()
        over = buffers.agents.item() == NOBODY
        if self.render_mode == "human":
            self.render()
        ended = game.task_end()
        if not over:
            seen, info = self._look()
            return seen, reward, False, False, info | ended
        # At the end, the observation is that of the net that moved last.
        info = game.info(game.mask(self._net), over=True) | ended
        info["net"] = game.names[self._net]
        now = game.engine.metrics()
        joined = now.joined == now.tasks
        return game.observation(self._net), reward, joined, not joined, info
