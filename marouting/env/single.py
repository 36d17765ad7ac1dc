"""The Gymnasium face: one player moves all nets, in turn order (the paper's single agent)."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from marouting.config import ORDERS
from marouting.env.base import METADATA, BaseGame, GameMethods, checked_move
from marouting.game.engine import NOBODY
from marouting.problem.grid import MOVES
from marouting.source import Source


class GlobalRoutingSingle(GameMethods, gymnasium.Env[Any, Any], EzPickle):
    """Global routing as one agent's game: every step moves the net whose turn it is.

    The observation is that of the net to move. The episode terminates when all tasks of all nets
    are joined, and is truncated when all have ended and some failed. ``info`` holds the net's
    ``action_mask`` and ``net``, and at the end the ``metrics``.

    Args:
        problem: see :data:`marouting.source.Source`.
        render_mode: ``ansi``, ``rgb_array``, ``human`` or None.
        **options: the other fields of :class:`marouting.config.GameOptions`.
    """

    metadata = METADATA

    def __init__(
        self, problem: Source = None, render_mode: str | None = None, **options: Any
    ) -> None:
        EzPickle.__init__(self, problem, render_mode, **options)
        self._game = BaseGame(problem, ORDERS["single"], {**options, "render_mode": render_mode})
        self.render_mode = render_mode
        self.observation_space = self._game.new_observation_space()
        self.action_space = Discrete(MOVES)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: matters where a new problem is drawn for each episode, and then decides it.
            options: accepted for the interface's sake; there are none.
        """
        del options
        super().reset(seed=seed)
        self._game.restart(seed)
        self._net = int(self._game.engine.games[0]["agent"])
        if self.render_mode == "human":
            self.render()
        return self._look(self._game.mask(self._net), over=False)

    def _look(self, mask: NDArray[np.int8], over: bool) -> tuple[Any, dict[str, Any]]:
        """Observation and info of the net to move; at the end, of the one that moved last."""
        game = self._game
        info = game.info(mask, over)
        info["net"] = game.names[self._net]
        return game.observation(self._net), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Moves the net whose turn it is.

        Raises:
            ValueError: the action is none of the six moves.
        """
        engine = self._game.engine
        masks = np.empty((1, MOVES), np.int8)
        following, _ = engine.play_turn(checked_move(action), masks)
        mask = masks[0]
        reward = self._game.reward(self._net)
        over = following == NOBODY
        if not over and following != self._net:
            self._net = following
            mask = self._game.mask(following)  # what came back may be that of a net that is done
        now = engine.metrics()
        joined = over and now.joined == now.tasks
        if self.render_mode == "human":
            self.render()
        seen, info = self._look(mask, over)
        return seen, reward, joined, over and not joined, info
