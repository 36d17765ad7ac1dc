"""A player that remembers the moves of its episodes, so that a checkpoint need not hold its games.

Games follow from their moves. A checkpoint holds those of the episodes under way; whoever goes on
from it plays them again.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.game import NOBODY, Status
from marouting.player import Player


class LoggedPlayer(Player):
    """Games of which every move since their last reset is known.

    Attributes:
        moves: (M, S, K) int16, the moves on the grid, as far as they have been made.
        made: (M,) int64, the steps of each game since its last reset.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        games, rows = self.buffers.actions.shape
        self.moves = np.empty((games, 0, rows), np.int16)
        self.made = np.zeros(games, np.int64)

    def make_log(self, steps: int) -> None:
        """Makes room for the moves of so many steps."""
        games, size, rows = self.moves.shape
        needed = int(self.made.max()) + steps
        if needed > size:
            more = np.empty((games, max(needed, 2 * size) - size, rows), np.int16)
            self.moves = np.concatenate([self.moves, more], axis=1)

    def reset(self, which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`marouting.player.Player.reset`."""
        super().reset(which)
        self.made[... if which is None else which] = 0

    def step(self, restart: bool = False) -> None:
        """See :meth:`marouting.player.Player.step`; trainings start episodes by :meth:`reset`."""
        if restart:
            raise ValueError("restart: expected false where moves are remembered")
        playing = np.flatnonzero(self.engine.games["active"] > 0)
        super().step()
        self.make_log(1)
        self.moves[playing, self.made[playing]] = self.played[playing]
        self.made[playing] += 1

    def part(self, which: NDArray[np.integer]) -> "LoggedPlayer":
        """See :meth:`marouting.player.Player.part`."""
        part = super().part(which)
        assert isinstance(part, LoggedPlayer)
        part.moves, part.made = self.moves[which], self.made[which]
        return part

    def replay(
        self,
        moves: NDArray[np.int16],
        made: NDArray[np.int64],
        begun: Callable[[NDArray[np.bool_]], None],
    ) -> None:
        """Plays the episodes under way in another player's games again, from their first moves.

        What the last step paid, and how it ended, is not restored.

        Args:
            moves: as that player has them.
            made: likewise.
            begun: called with (M,) games whose episodes have begun, before their first moves.
        """
        engine, games = self.engine, np.arange(len(made))
        engine.reset()
        longest = int(made.max())
        for step in range(longest):
            at = step - (longest - made)  # of each game; all make their last moves together
            if (at == 0).any():
                engine.reset(at == 0)
                begun(at == 0)
            now = np.where((at >= 0)[:, None], moves[games, np.maximum(at, 0)], NOBODY)
            engine.step(now if self.everyone else now[:, 0])
        engine.reset(made == 0)
        self.moves, self.made = moves.copy(), made.copy()
        b = self.buffers
        problems, agents = engine.pairs(self.everyone)
        b.agents[:] = agents.reshape(b.agents.shape)
        active = engine.agents["status"][problems, agents] == Status.ACTIVE
        b.active[:] = (active & (agents != NOBODY)).reshape(b.active.shape)
        b.over[:] = engine.games["active"] == 0
        self.show()
