"""What an agent gets for a move.

A reward is a piece to inject: any callable of this form can take the place of the paper's. What
routes are judged by (overflow, wirelength, tasks joined) does not depend on it.
"""

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting.engine import Crossing, Ending


class Reward(Protocol):
    """What agents get for their last moves."""

    def __call__(self, agents: Any) -> Any:
        """Rewards of the agents' last moves.

        Args:
            agents: AGENT records (:data:`marouting.engine.AGENT`) of any shape, or one of them,
                after the move and before or after it is settled.

        Returns:
            float32 of the same shape; 0 for an agent that did not move.
        """
        ...


@dataclass(frozen=True)
class PaperReward:
    """+100 for reaching the target pin, −1 for any other move (paper, equation for R(a, s')).

    Attributes:
        reached: for the move that reaches the task's target.
        step: for any other move, blocked ones included.
        own_edge: for a move that ends no task along an edge that the net used before. The paper's
            −1 charges it like any other; 0 makes it free, as it is in wirelength.
        overflow_price: taken off for every unit of overflow that the move adds; it matters only
            where overflow is allowed.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    reached: float = 100.0
    step: float = -1.0
    own_edge: float = -1.0
    overflow_price: float = 0.0

    @functools.cached_property
    def table(self) -> NDArray[np.float32]:
        """(4, 3) reward by Crossing and Ending."""
        table = np.full((len(Crossing), len(Ending)), self.step, np.float32)
        table[Crossing.OWN] = self.own_edge
        table[:, Ending.JOINED] = self.reached
        table[Crossing.NONE] = 0
        return table

    def __call__(self, agents: Any) -> Any:
        """Rewards of the agents' last moves; see :class:`Reward`."""
        reward = self.table[agents["crossing"], agents["ending"]]
        if self.overflow_price:
            reward = reward - np.float32(self.overflow_price) * agents["overflow"]
        return reward
