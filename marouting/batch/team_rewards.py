"""Rewards for nets that share: what a move does to the whole problem, and who is paid for it.

They are named ``team``, ``difference``, ``potential`` and ``mixed`` in configurations.

The *cost* of a problem is what a router is judged by, as one number: overflow, tasks not joined and
wirelength, each with its price. ``team`` and ``difference`` pay what a move takes off the cost, so
that rewards add up to the change of the cost over an episode; ``potential`` pays for getting nearer
to the target. A mixture of several, with the paper's among them::

    reward:
      kind: mixed
      parts:
        - {kind: paper, own_edge: 0}
        - {kind: team, weight: 0.1}
        - {kind: potential, weight: 0.5}
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.reward import Reward
from marouting.batch.state import Dynamic
from marouting.config import check, piece
from marouting.game import NOBODY, Crossing


@dataclass(frozen=True)
class TeamReward:
    """Pays every net that still plays what the move took off the cost of the problem.

    The net that is done last is paid the whole change of the cost over the episode.

    Attributes:
        overflow: price of a unit of overflow, in tracks.
        open: price of a two-pin task that is not joined.
        wirelength: price of an edge that a net uses.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    overflow: float = 10.0
    open: float = 100.0
    wirelength: float = 1.0

    def saved(self, game: Engine, before: Dynamic) -> NDArray[np.float64]:
        """(M,) what moves took off the cost of each problem."""
        now, then = game.games, before.games
        saved = self.overflow * (then["overflow"] - now["overflow"])
        saved += self.open * (now["joined"] - then["joined"])
        saved += self.wirelength * (then["wirelength"] - now["wirelength"])
        return np.asarray(saved, np.float64)

    def __call__(
        self, game: Engine, before: Dynamic, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`marouting.batch.reward.Reward`."""
        del movers
        return np.broadcast_to(self.saved(game, before)[:, None], game.agents.shape)


@dataclass(frozen=True)
class DifferenceReward(TeamReward):
    """Pays the net that moves what its move took off the cost, with all others in place.

    This is the exact difference that the move makes (difference rewards: Wolpert and Tumer, 2001).
    The rewards of all nets add up to the change of the cost over an episode.

    Attributes:
        overflow: price of a unit of overflow, in tracks.
        open: price of a two-pin task that is not joined.
        wirelength: price of an edge that a net uses.
    """

    def __call__(
        self, game: Engine, before: Dynamic, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`marouting.batch.reward.Reward`."""
        return _to_movers(self.saved(game, before), movers, game)


@dataclass(frozen=True)
class PotentialReward:
    """Pays the net that moves for getting nearer to its target (Ng, Harada and Russell, 1999).

    The potential of an agent is minus its distance to the target in moves, capacities aside. A move
    is paid ``gamma`` · potential after − potential before; an answer whether to give way pays 0.
    With ``gamma=1`` a task that is joined pays the distance from its start to its target, whatever
    the way. With the discount factor of the learner, the best policies are those without this
    reward.

    Attributes:
        gamma: discount factor.
        scale: factor of all rewards.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    gamma: float = 1.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        check("gamma", 0 <= self.gamma <= 1, f"a number from 0 to 1, found {self.gamma}")

    def __call__(
        self, game: Engine, before: Dynamic, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`marouting.batch.reward.Reward`."""
        crossing = game.agents["crossing"][np.arange(len(movers)), movers]
        movers = np.where(crossing == Crossing.ANSWERED, np.int32(NOBODY), movers)
        after, then = (_distance(game, agents, movers) for agents in (game.agents, before.agents))
        return _to_movers(self.scale * (then - self.gamma * after), movers, game)


@dataclass(frozen=True)
class MixedReward:
    """The weighted sum of other rewards.

    Attributes:
        parts: for each reward a mapping with ``kind``, its options, and its ``weight`` (1 unless
            it is given).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    parts: tuple[Mapping[str, Any], ...] = ({"kind": "paper"}, {"kind": "potential"})

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        check("parts", len(self.parts) > 0, "at least one reward")
        _ = self.rewards  # raises an error now

    @functools.cached_property
    def rewards(self) -> list[tuple[float, Reward]]:
        """The parts, each with its weight."""
        made: list[tuple[float, Reward]] = []
        for number, part in enumerate(self.parts):
            options = dict(part)
            weight = options.pop("weight", 1.0)
            fits = isinstance(weight, int | float) and math.isfinite(weight)
            check(f"parts.{number}.weight", fits, f"a finite number, found {weight!r}")
            made.append((float(weight), piece("reward", options, where=f"parts.{number}").make()))
        return made

    def __call__(
        self, game: Engine, before: Dynamic, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`marouting.batch.reward.Reward`."""
        paid = np.zeros(game.agents.shape)
        for weight, reward in self.rewards:
            paid += weight * np.asarray(reward(game, before, movers))
        return paid


def _to_movers(
    gains: NDArray[np.float64], movers: NDArray[np.int32], game: Engine
) -> NDArray[np.float64]:
    """(M, N) rewards that pay the agents that moved what was gained in their problems (M,)."""
    paid = np.zeros(game.agents.shape)
    moved = np.flatnonzero(movers != NOBODY)
    paid[moved, movers[moved]] = gains[moved]
    return paid


def _distance(game: Engine, agents: NDArray[Any], movers: NDArray[np.int32]) -> NDArray[np.float64]:
    """(M,) moves between the agents that moved and their targets, on an empty grid."""
    own = agents[np.arange(len(movers)), movers]
    position = game.static.position
    return np.abs(position[own["cell"]] - position[own["target"]]).sum(axis=1).astype(np.float64)
