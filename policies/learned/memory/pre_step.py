"""What a learner keeps of a player's buffers before a step writes over them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.player import Player


class PreStep(NamedTuple):
    """Copies of a player's buffers from before a step."""

    agents: NDArray[np.int32]  # (M, K)
    obs: NDArray[np.float32]  # (M, K, *S)
    mask: NDArray[np.int8]  # (M, K, A)

    @classmethod
    def of(cls, player: Player) -> "PreStep":
        """Copies of what the player's agents see now."""
        now = player.buffers
        return cls(now.agents.copy(), now.obs.copy(), now.mask.copy())
