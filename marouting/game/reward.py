"""What an agent gets for a move.

A reward is a piece to inject: any callable of this form can take the place of the paper's. What
routes are judged by (overflow, wirelength, tasks joined) does not depend on it.
"""

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting.game.engine import NOBODY, Crossing, Ending, Engine, Write
from marouting.kernels import bound, compiled, inlined, place


class Reward(Protocol):
    """What agents get for their last moves.

    One with a method ``bind(engine)`` that returns a :data:`marouting.game.engine.Write` is asked
    for that instead, wherever it is called over and over.
    """

    def __call__(self, agents: Any) -> Any:
        """Rewards of the agents' last moves.

        Args:
            agents: AGENT records (:data:`marouting.game.engine.AGENT`) of any shape, or one of
                them, after the move and before or after it is settled.

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
            price = np.float32(self.overflow_price)
            reward = reward - price * agents["overflow"].astype(np.float32)
        return reward

    def bind(self, engine: Engine) -> Write:
        """A quicker way to pay agents of one engine, see :func:`marouting.kernels.bound`."""
        records, table, price = engine.agents, self.table, self.overflow_price
        problems, agents = np.empty(0, np.int32), np.empty((0, 0), np.int32)
        out = np.empty(0, np.float32)
        code = bound(_paper, records, table, price, problems, agents, out)
        return functools.partial(code, records, table, price)


@inlined
def paper_reward(table: Any, overflow_price: float, agent: Any) -> Any:
    """:class:`PaperReward` of an AGENT record's last move, float32."""
    reward = table[place(agent.crossing), place(agent.ending)]
    return reward - np.float32(overflow_price) * np.float32(agent.overflow)


@compiled
def _paper(
    records: Any, table: Any, overflow_price: float, problems: Any, agents: Any, out: Any
) -> None:
    for i in range(agents.shape[0]):
        m = place(problems[i])
        for k in range(agents.shape[1]):
            row = i * agents.shape[1] + k
            if agents[i, k] == NOBODY:
                out[row] = 0
            else:
                out[row] = paper_reward(table, overflow_price, records[m, place(agents[i, k])])


def payer(reward: Reward, engine: Engine) -> Write:
    """What fills in rewards of an engine's agents quickest: 0 for one that did not move."""
    bind = getattr(reward, "bind", None)
    if bind is not None:
        return bind(engine)

    def pay(
        problems: NDArray[np.int32], agents: NDArray[np.int32], out: NDArray[np.float32]
    ) -> None:
        records = engine.agents[problems[:, None], agents]
        still = (agents == NOBODY) | (records["crossing"] == Crossing.NONE)
        out[:] = np.where(still, 0, reward(records)).ravel()

    return pay
