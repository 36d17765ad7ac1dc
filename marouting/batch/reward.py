"""What a move pays.

The paper's reward is here; :mod:`marouting.batch.team_rewards` has those for nets that share. You
can also write your own; see :func:`marouting.register`. A reward is called after every single move,
in all interfaces of the environment, in the batch and in trainings alike, and it may pay any agent
of the problem. The metrics of routes (overflow, wirelength, tasks joined) do not depend on it.

If several agents move in one step, their moves are carried out and paid one after the other, in
turn order. An agent's reward for the step is the sum of what all these moves paid it. In the AEC
environment, what the moves of others pay an agent accumulates until its turn, as PettingZoo
defines. In the Gymnasium environment, one player moves all nets and gets what all of them are paid.

A worked example: every net of a problem gets the change in the problem's wirelength and overflow::

    import numpy as np

    class TeamReward:
        def __init__(self, price: float = 10.0) -> None:
            self.price = price

        def __call__(self, game, before, movers):
            now, then = game.games, before.games  # (M,) records
            change = then["wirelength"] - now["wirelength"]
            change = change + self.price * (then["overflow"] - now["overflow"])
            return np.broadcast_to(change[:, None], game.agents.shape)

    env = marouting.global_routing_v0.env(reward=TeamReward(price=5))

In YAML, with the class in ``my_rewards.py``: ``reward: {kind: "my_rewards:TeamReward", price: 5}``.
"""

import functools
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.state import Dynamic
from marouting.config import check
from marouting.game import NOBODY, Crossing, Ending
from marouting.kernels import inlined, place

_MOST = 1e30
"""The largest reward: rewards are float32, and are added up."""


class Reward(Protocol):
    """What moves pay the agents."""

    def __call__(
        self, game: Engine, before: Dynamic, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What one move in each of M problems pays the N agents of each problem.

        Args:
            game: the games after the moves. ``game.agents`` (M, N) and ``game.games`` (M,) are
                records of the types :data:`marouting.batch.state.AGENT` and
                :data:`marouting.batch.state.GAME`; ``game.dynamic`` holds everything that changes,
                ``game.static`` everything that does not. An agent whose task has ended stands where
                it arrived; its next task has not begun.
            before: the arrays of ``game.dynamic`` as they were before the moves, to be read. Where
                nets had just given their edges back in a rip-up round, the tasks joined, overflow
                and wirelength in ``before.games`` are those before that: the next move is paid for
                it, and rewards add up.
            movers: (M,) int32, the agent that moved in each problem; NOBODY (−1) if none did.

        Returns:
            (M, N) rewards of any float dtype. They are ignored for problems in which nobody moved
            and for agents that were done before the move.
        """
        ...


@dataclass(frozen=True)
class PaperReward:
    """+100 for reaching the target pin, −1 for any other move (paper, equation for R(a, s')).

    Only the agent that moves is paid.

    Attributes:
        reached: for the move that reaches the task's target.
        step: for any other move, blocked ones included. An answer whether to give way pays 0.
        own_edge: for a move along an edge that the net already used, unless it reaches the target.
            None: what any other move pays (the paper); 0 makes it free, as in wirelength.
        overflow_price: subtracted for every unit of overflow that the move adds. It only matters
            if overflow is allowed.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    reached: float = 100.0
    step: float = -1.0
    own_edge: float | None = None
    overflow_price: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(PaperReward):
            value = getattr(self, f.name)
            value = 0 if value is None else value
            check(f.name, abs(value) <= _MOST, f"a number from {-_MOST:g} to {_MOST:g}")

    @functools.cached_property
    def table(self) -> NDArray[np.float32]:
        """(5, 3) float32, the reward by Crossing and Ending, without the price of overflow."""
        table = np.full((len(Crossing), len(Ending)), self.step, np.float32)
        table[Crossing.OWN] = self.step if self.own_edge is None else self.own_edge
        table[:, Ending.JOINED] = self.reached
        table[[Crossing.NONE, Crossing.ANSWERED]] = 0
        return table

    def __call__(
        self, game: Engine, before: Dynamic, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        del before
        paid = np.zeros(game.agents.shape, np.float32)
        moved = np.flatnonzero(movers != NOBODY)
        agent = game.agents[moved, movers[moved]]
        own = self.table[agent["crossing"], agent["ending"]]
        own = own - np.float32(self.overflow_price) * agent["added_overflow"].astype(np.float32)
        paid[moved, movers[moved]] = own
        return paid


@dataclass(frozen=True)
class NormalisedReward(PaperReward):
    """The paper's reward in numbers of order 1: +1 for reaching the target pin, −0.01 otherwise.

    Learners whose settings expect such numbers, as those of most libraries do, need it.
    """

    reached: float = 1.0
    step: float = -0.01


KNOWN = (PaperReward, NormalisedReward)
"""The rewards that compiled steps know; subclasses may do anything."""


@inlined
def paper_reward(table: Any, overflow_price: float, agent: Any) -> Any:
    """float32, the :class:`PaperReward` of an AGENT record's last move."""
    reward = table[place(agent.crossing), place(agent.ending)]
    return reward - np.float32(overflow_price) * np.float32(agent.added_overflow)
