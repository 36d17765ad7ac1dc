"""What a learner keeps of a player's buffers before a step writes over them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.player import Player


class Before(NamedTuple):
    """Copies of a player's buffers from before a step."""

    agents: NDArray[np.int32]  # (M, K)
    obs: NDArray[np.float32]  # (M, K, *S)
    mask: NDArray[np.int8]  # (M, K, 6)

    @classmethod
    def of(cls, player: Player) -> "Before":
        """Copies of what the player's agents see now."""
        now = player.buffers
        return cls(now.agents.copy(), now.obs.copy(), now.mask.copy())


def look_after(player: Player, before: Before) -> None:
    """Fills in what agents saw where they arrived if the turn then passed to another's row.

    A player of one row shows the next agent there, and keeps what the last one saw only at the
    end of a task.
    """
    now = player.buffers
    if player.everyone or player.engine.static.sequential:
        return
    passed = now.acted & (now.ending == Ending.NONE) & (now.agents != before.agents)
    problems = np.flatnonzero(passed[:, 0]).astype(np.int32)
    if len(problems):
        agents = before.agents[problems, 0]
        seen = np.empty((len(problems), *now.obs.shape[2:]), np.float32)
        player.observation.write(player.engine, problems, agents, seen)
        now.final_obs[problems, 0] = seen
        now.final_mask[problems, 0] = player.engine.masks(problems, agents)
