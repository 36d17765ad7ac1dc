"""What a move pays.

A reward is called after every single move, in all interfaces and in trainings, and it may pay any
agent of the problem. The metrics of routes (overflow,
wirelength, tasks joined) do not depend on it. You can also write your own; see
:func:`marouting.register`.

If several agents move in one step, their moves are carried out and paid one after the other, in
turn order. An agent's reward for the step is the sum of what all these moves paid it. In the AEC
environment, what the moves of others pay an agent accumulates until its turn, as PettingZoo
defines. In the Gymnasium environment, one player moves all nets and gets what all of them are paid.

A worked example: every net of a problem gets the change in the problem's wirelength and overflow::

    import numpy as np

    class TeamReward:
        def __init__(self, price: float = 10.0) -> None:
            self.price = price

        def __call__(self, games, before, movers):
            now, then = games.games, before.games  # figures (M,)
            change = then["wirelength"] - now["wirelength"]
            change = change + self.price * (then["overflow"] - now["overflow"])
            return np.broadcast_to(change[:, None], games.agents.shape)

    env = marouting.global_routing_v0.env(reward=TeamReward(price=5))

In YAML, with the class in ``my_rewards.py``: ``reward: {kind: "my_rewards:TeamReward", price: 5}``.

A reward that pays only the agent that moves has a simpler form, which works in the environments but
not in the batch or in trainings: a method ``pay(game, n)`` that returns what agent n gets for its
last move (:class:`marouting.game.Game`).

Cooperative rewards use the *cost* of a problem, the weighted sum of overflow, open tasks and
wirelength. ``team`` and ``difference`` pay the reduction of the cost by a move, so that rewards add
up to its reduction over the episode. ``potential`` pays for getting nearer to the target. ``mixed``
is a weighted sum::

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
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting.columns import Before, Games
from marouting.config import check, piece
from marouting.errors import InputError
from marouting.game import ACTIVE, NOBODY, WAITING, Crossing, Ending, Game
from marouting.registry import register

_MOST = 1e30
"""The largest reward: rewards are float32, and are added up."""


class Reward(Protocol):
    """What moves pay the agents."""

    def __call__(
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What one move in each of M problems pays the N agents of each problem.

        Args:
            games: the games after the moves. An agent whose task has ended stands where it arrived;
                its next task has not begun.
            before: the games before the moves.
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
        step: for any other move, blocked ones included. An answer to whether to rip up pays 0.
        own_edge: for a move along an edge that the net already used, unless it reaches the target.
            None: what any other move pays (the paper); 0 makes it free, as in wirelength.
        overflow_price: subtracted for every unit of overflow that the move adds. It only matters
            if overflow is allowed.
    """

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
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        del before
        moved = np.flatnonzero(movers != NOBODY)
        crossing, ending, added = (
            games.agents[name][moved, movers[moved]]
            for name in ("crossing", "ending", "added_overflow")
        )
        paid = np.zeros(games.agents.shape, np.float32)
        overflow = np.float32(self.overflow_price) * added.astype(np.float32)
        paid[moved, movers[moved]] = self.table[crossing, ending] - overflow
        return paid

    def pay(self, game: Game, n: int) -> float:
        """What the last move of agent n pays it, as a number that float32 can hold."""
        paid = self._rows[game.crossing[n]][game.ending[n]]
        if self.overflow_price:
            price = np.float32(self.overflow_price) * np.float32(game.added_overflow[n])
            paid = float(np.float32(paid) - price)
        return paid

    @functools.cached_property
    def _rows(self) -> list[list[float]]:
        rows: list[list[float]] = self.table.tolist()
        return rows


@dataclass(frozen=True)
class NormalisedReward(PaperReward):
    """The paper's reward in numbers of order 1: +1 for reaching the target pin, −0.01 otherwise.

    Learners whose settings expect such numbers, as those of most libraries do, need it.
    """

    reached: float = 1.0
    step: float = -0.01


KNOWN = (PaperReward, NormalisedReward)
"""The rewards that compiled steps know; subclasses may do anything."""


@dataclass(frozen=True)
class TeamReward:
    """Pays every active net by how much a move reduces the cost of the problem.

    The net that is done last gets the whole reduction of the cost over the episode.

    Attributes:
        overflow: price of a unit of overflow, in tracks.
        open: price of a two-pin task that is not joined.
        wirelength: price of an edge that a net uses.
    """

    overflow: float = 10.0
    open: float = 100.0
    wirelength: float = 1.0

    def saved(self, games: Games, before: Before) -> NDArray[np.float64]:
        """(M,) what moves took off the cost of each problem."""
        now, then = games.games, before.games
        saved = self.overflow * (then["overflow"] - now["overflow"])
        saved += self.open * (now["joined"] - then["joined"])
        saved += self.wirelength * (then["wirelength"] - now["wirelength"])
        return np.asarray(saved, np.float64)

    def __call__(
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        del movers
        return np.broadcast_to(self.saved(games, before)[:, None], games.agents.shape)


@dataclass(frozen=True)
class DifferenceReward(TeamReward):
    """Pays the net that moves by how much its move reduces the cost of the problem.

    This is the difference reward of Wolpert and Tumer (2001), exact because the other nets do not
    change. The rewards of all nets add up to the reduction of the cost over an episode.

    Attributes:
        overflow: price of a unit of overflow, in tracks.
        open: price of a two-pin task that is not joined.
        wirelength: price of an edge that a net uses.
    """

    def __call__(
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        return _to_movers(self.saved(games, before), movers, games)


@dataclass(frozen=True)
class PotentialReward:
    """Pays the net that moves for getting nearer to its target (Ng, Harada and Russell, 1999).

    The potential of an agent is minus its distance to the target in moves, ignoring capacity. A
    move pays ``gamma`` · potential after − potential before; a decision about rip-up pays 0. With
    ``gamma=1`` a joined task pays the distance from its start to its target on any route. If
    ``gamma`` is the learner's discount factor, adding this reward does not change the best
    policies.

    Attributes:
        gamma: discount factor.
        scale: factor of all rewards.
    """

    gamma: float = 1.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        check("gamma", 0 <= self.gamma <= 1, f"a number from 0 to 1, found {self.gamma}")

    def __call__(
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        crossing = games.agents["crossing"][np.arange(len(movers)), movers]
        movers = np.where(crossing == Crossing.ANSWERED, np.int32(NOBODY), movers)
        after, then = (_distance(games, agents, movers) for agents in (games.agents, before.agents))
        return _to_movers(self.scale * (then - self.gamma * after), movers, games)


@dataclass(frozen=True)
class MixedReward:
    """The weighted sum of other rewards.

    Attributes:
        parts: for each reward a mapping with ``kind``, its options, and its ``weight`` (1 unless
            it is given).
    """

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
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        paid = np.zeros(games.agents.shape)
        for weight, reward in self.rewards:
            paid += weight * np.asarray(reward(games, before, movers))
        return paid


def paid_by(
    reward: Reward, games: Games, before: Before, movers: NDArray[np.int32]
) -> NDArray[np.float32]:
    """(M, N) what a reward pays for moves; raises InputError for a wrong shape, NaN or infinity."""
    paid = np.asarray(reward(games, before, movers), np.float32)
    name = type(reward).__name__
    if paid.shape != games.nets.shape:
        expected = f"expected shape {games.nets.shape}, found {paid.shape}"
        raise InputError(f"reward: {expected} from {name}")
    if not np.isfinite(paid).all():
        found = paid[~np.isfinite(paid)][0]
        raise InputError(f"reward: expected finite numbers, found {found} from {name}")
    status = before.agents["status"]
    playing = (status == ACTIVE) | (status == WAITING)
    return np.where(playing & (movers != NOBODY)[:, None], paid, np.float32(0))


def _to_movers(
    gains: NDArray[np.float64], movers: NDArray[np.int32], games: Games
) -> NDArray[np.float64]:
    """(M, N) rewards that pay the agents that moved what was gained in their problems (M,)."""
    paid = np.zeros(games.agents.shape)
    moved = np.flatnonzero(movers != NOBODY)
    paid[moved, movers[moved]] = gains[moved]
    return paid


def _distance(games: Games, agents: Any, movers: NDArray[np.int32]) -> NDArray[np.float64]:
    """(M,) moves between the agents that moved and their targets, on an empty grid."""
    position, every = games.grid.position, np.arange(len(movers))
    cell, target = agents["cell"][every, movers], agents["target"][every, movers]
    return np.abs(position[cell] - position[target]).sum(axis=1).astype(np.float64)


for _name, _kind in (
    ("paper", PaperReward),
    ("normalised", NormalisedReward),
    ("team", TeamReward),
    ("difference", DifferenceReward),
    ("potential", PotentialReward),
    ("mixed", MixedReward),
):
    register("reward", _name, _kind)
