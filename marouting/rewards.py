"""What a move pays.

A reward is called after every single move, in all interfaces and in training, and it may pay any
agent of the problem. The metrics of routes (overflow, wirelength, tasks joined) do not depend on
it. You can also write your own; see :func:`marouting.register`.

Agents that are done can be paid as well: the batch pays them until the episode is over, the
PettingZoo environments only with ``agents_persist``, because otherwise they have left.

If several agents move in one step, their moves are carried out and paid one after the other, in
turn order. An agent's reward for the step is the sum of what all these moves paid it. In the AEC
environment, what an agent is paid for the moves of others accumulates until its turn, as PettingZoo
defines. In the Gymnasium environment, one player moves all nets and gets what all of them are paid.

docs/own-components.md has a worked example. A reward that pays only the agent that moves has a
simpler form, which works in the environments but not in the batch or in training: a method
``pay(game, n)`` that returns what agent n gets for its last move (:class:`marouting.game.Game`).

Cooperative rewards use the *cost* of a problem, the weighted sum of overflow, open tasks and
wirelength. ``team`` and ``difference`` pay the reduction of the cost by a move, so that rewards add
up to its reduction over the episode; ``counterfactual`` pays each net for the cost that would not
be there without it. ``potential`` pays for getting nearer to the target. ``mixed`` is a weighted
sum. The batch and trainings pay all of these in compiled code. Mixtures::

    reward:
      kind: mixed
      parts:
        - {kind: paper, own_edge: 0}
        - {kind: team, weight: 0.1}
        - {kind: potential, weight: 0.5}
"""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting.checks import check_fields
from marouting.columns import Before, Games
from marouting.config import check, component, of_key
from marouting.errors import InputError
from marouting.game import NOBODY, Crossing, Ending, Game
from marouting.observations import has_form
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.registry import register

_MOST, _MOST_WEIGHT = 1e30, 1e6
"""The largest price, as rewards are float32 and are added up; and the largest weight of a part."""


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
            and where there is no agent. Agents that are done are paid as well.
        """
        ...


class Share(IntEnum):
    """Rows of :attr:`Prices.shared`."""

    MOVER = 0  #: paid to the net that moves, for the reduction of overflow, open tasks, wirelength
    TEAM = 1  #: the same, paid to every net
    OTHERS = 2  #: paid to each other net, for the overflow and failed tasks that it accounts for,
    #: see :class:`CounterfactualReward`
    NEARER = 3  #: paid to the net that moves, for its distance to the target before and after


class Prices(NamedTuple):
    """What one move pays, in numbers: the rewards that compiled steps of the batch can pay.

    Attributes:
        table: (5, 3), what the net that moves is paid by Crossing and Ending.
        added_overflow: subtracted from it for every unit of overflow that the move adds.
        shared: (4, 3), prices by :class:`Share`.
    """

    table: NDArray[np.floating]
    added_overflow: float
    shared: NDArray[np.float64]

    @classmethod
    def of(cls, **shares: tuple[float, float, float]) -> "Prices":
        """Prices without a table, from rows of ``shared`` by their names in lower case."""
        shared = np.zeros((len(Share), 3))
        for name, row in shares.items():
            shared[Share[name.upper()]] = row
        return cls(np.zeros((len(Crossing), len(Ending))), 0.0, shared)

    def plus(self, weight: float, other: "Prices") -> "Prices":
        """The sum of these prices and weighted others."""
        table = self.table + weight * other.table
        added = self.added_overflow + weight * other.added_overflow
        return Prices(table, added, self.shared + weight * other.shared)


class PricedReward(ABC):
    """A reward that its prices define completely."""

    @property
    @abstractmethod
    def prices(self) -> Prices:
        """What a move pays."""

    def __call__(
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        return pay_moves(self.prices, games, before, movers)


@dataclass(frozen=True)
class PaperReward(PricedReward):
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
        check_fields(self, PaperReward, **{f.name: (-_MOST, _MOST) for f in fields(PaperReward)})

    @functools.cached_property
    def table(self) -> NDArray[np.float32]:
        """(5, 3) float32, the reward by Crossing and Ending, without the price of overflow."""
        table = np.full((len(Crossing), len(Ending)), self.step, np.float32)
        table[Crossing.OWN] = self.step if self.own_edge is None else self.own_edge
        table[:, Ending.JOINED] = self.reached
        table[[Crossing.NONE, Crossing.ANSWERED]] = 0
        return table

    @property
    def prices(self) -> Prices:
        """What a move pays."""
        return Prices(self.table, self.overflow_price, np.zeros((len(Share), 3)))

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

    The default settings of most libraries' learners expect rewards of this size.
    """

    reached: float = 1.0
    step: float = -0.01


@dataclass(frozen=True)
class CostReward(PricedReward):
    """Rewards that pay for a lower cost of the problem.

    Attributes:
        overflow: price of a unit of overflow, in tracks.
        open: price of a two-pin task that is not joined.
        wirelength: price of an edge that a net uses.
    """

    overflow: float = 10.0
    open: float = 100.0
    wirelength: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self, CostReward, **{f.name: (-_MOST, _MOST) for f in fields(CostReward)})

    @property
    def _cost(self) -> tuple[float, float, float]:
        return self.overflow, self.open, self.wirelength


@dataclass(frozen=True)
class TeamReward(CostReward):
    """Pays every net by how much a move reduces the cost of the problem.

    Over the episode every net is paid the whole reduction of the cost: a net that is done is still
    paid for the moves of the others. But in PettingZoo's interfaces an agent that is done leaves
    and is paid no more, unless ``agents_persist`` is on.
    """

    @property
    def prices(self) -> Prices:
        """What a move pays."""
        return Prices.of(team=self._cost)


@dataclass(frozen=True)
class DifferenceReward(CostReward):
    """Pays the net that moves by how much its move reduces the cost of the problem.

    The rewards of all nets add up to the reduction of the cost over an episode. A net is not
    charged for blocking others; see :class:`CounterfactualReward`.
    """

    @property
    def prices(self) -> Prices:
        """What a move pays."""
        return Prices.of(mover=self._cost)


@dataclass(frozen=True)
class CounterfactualReward(CostReward):
    """Pays every net for reducing its share: the cost of the problem minus that without the net.

    This is the difference reward of Wolpert and Tumer (2001) and Devlin et al. (2014). The cost
    that net i accounts for is the cost of the state minus that of the state without net i, where
    everything else is as it is:

    * the edges that net i uses, and its open tasks;
    * the overflow that would disappear without its edges. If two nets overflow an edge by one
      track, each of them accounts for it;
    * every task of another net that failed while net i alone was in its way: with the capacity that
      was left then, no path led from that agent to its target, but with net i's edges released one
      did.

    Every move pays each net the decrease of the cost that it accounts for, so that its rewards add
    up to the cost of its open tasks at the beginning minus the cost that it accounts for in the
    last state, which is exact. Before that, a task of another net that is still open counts as one
    that will be joined, and a net that stands in its way is only charged when the task fails, even
    if it is done itself by then. In rip-up rounds it pays what ``difference`` pays.
    """

    @property
    def prices(self) -> Prices:
        """What a move pays."""
        return Prices.of(mover=self._cost, others=(self.overflow, self.open, 0.0))


@dataclass(frozen=True)
class PotentialReward(PricedReward):
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
        check_fields(self, gamma=(0, 1), scale=(-_MOST, _MOST))

    @property
    def prices(self) -> Prices:
        """What a move pays."""
        return Prices.of(nearer=(self.scale, self.scale * self.gamma, 0.0))


@dataclass(frozen=True)
class MixedReward:
    """The weighted sum of other rewards.

    Attributes:
        parts: for each reward a mapping with ``kind``, its options, and its ``weight`` (1 unless
            it is given). If no parts are given, these are ``paper`` and ``potential``. A reward
            that has only ``pay`` cannot be a part.
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
            fits = isinstance(part, Mapping)
            check(f"parts.{number}", fits, f"a mapping with the key kind, found {part!r}")
            options = dict(part)
            key = f"parts.{number}.weight"
            weight = of_key(key, options.pop("weight", 1.0), float)
            fits = abs(weight) <= _MOST_WEIGHT
            check(key, fits, f"{-_MOST_WEIGHT:g} to {_MOST_WEIGHT:g}, found {weight!r}")
            reward = component("reward", options, where=f"parts.{number}").make()
            what = f"a reward that has __call__, not pay alone, found {type(reward).__name__}"
            check(f"parts.{number}", has_form(reward, "__call__", "pay"), what)
            made.append((float(weight), reward))
        return made

    def __call__(
        self, games: Games, before: Before, movers: NDArray[np.int32]
    ) -> NDArray[np.floating]:
        """What the moves pay; see :class:`Reward`."""
        paid = np.zeros(games.agents.shape)
        for weight, reward in self.rewards:
            paid += weight * _shaped(reward(games, before, movers), games, reward)
        return paid


def prices_of(reward: Reward) -> Prices | None:
    """The prices of a built-in reward, or of a mixture of them; None for any other.

    A subclass of a built-in reward gives None, because it may pay anything.
    """
    if isinstance(reward, PricedReward) and type(reward) in _BUILT_IN.values():
        return reward.prices
    if type(reward) is not MixedReward:
        return None
    whole = Prices.of()
    for weight, part in reward.rewards:
        prices = prices_of(part)
        if prices is None:
            return None
        whole = whole.plus(weight, prices)
    return whole


# --- by columns -----------------------------------------------------------------------------------


def pay_moves(
    prices: Prices, games: Games, before: Before, movers: NDArray[np.int32]
) -> NDArray[np.floating]:
    """(M, N) what moves pay at some prices; the arguments are those of :class:`Reward`."""
    paid = np.zeros(games.agents.shape)
    moved = np.flatnonzero(movers != NOBODY)
    who = movers[moved]
    crossing, ending, added = (
        games.agents[name][moved, who] for name in ("crossing", "ending", "added_overflow")
    )
    overflow = np.float32(prices.added_overflow) * added.astype(np.float32)
    paid[moved, who] = prices.table.astype(np.float32)[crossing, ending] - overflow
    if not prices.shared.any():
        return paid
    now, then = games.games, before.games
    saved = [then["overflow"] - now["overflow"], now["joined"] - then["joined"]]
    change = np.stack([*saved, then["wirelength"] - now["wirelength"]], axis=1)[moved]
    paid[moved, who] += change @ prices.shared[Share.MOVER]
    paid[moved] += (change @ prices.shared[Share.TEAM])[:, None]
    position, (leaving, arriving, _) = games.grid.position, prices.shared[Share.NEARER]
    target = position[before.agents["target"][moved, who]]
    for price, agents in ((leaving, before.agents), (-arriving, games.agents)):
        distance = np.abs(position[agents["cell"][moved, who]] - target).sum(axis=1)
        paid[moved, who] += price * np.where(crossing == Crossing.ANSWERED, 0, distance)
    if prices.shared[Share.OTHERS].any():
        for m, n in zip(moved.tolist(), who.tolist(), strict=True):
            if not before.games["round"][m]:
                _pay_others(prices.shared[Share.OTHERS], games, before, m, n, paid[m])
    return paid


class TeamPay:
    """:func:`pay_moves` of a plain game, with prices for the net that moves and for the team only.

    The columns' form copies all columns before every move: with it, a Parallel environment of 50
    nets makes a fifth as many moves a second.

    Args:
        prices: with no price for others and for distance.
    """

    def __init__(self, prices: Prices) -> None:
        self._table = prices.table.astype(np.float32)
        self._added = np.float32(prices.added_overflow)
        self._mover, self._team = prices.shared[Share.MOVER], prices.shared[Share.TEAM]

    @staticmethod
    def of(reward: Reward) -> "TeamPay | None":
        """That of a reward; None without prices, or with prices for other nets or for distance."""
        prices = prices_of(reward)
        if prices is None or prices.shared[[Share.OTHERS, Share.NEARER]].any():
            return None
        return TeamPay(prices)

    def __call__(
        self, game: Game, n: int, then: Mapping[str, int], now: Mapping[str, int]
    ) -> NDArray[np.float32]:
        """(N,) what agent n's last move pays, given the figures of the game before and after."""
        saved = [then["overflow"] - now["overflow"], now["joined"] - then["joined"]]
        change = np.array([*saved, then["wirelength"] - now["wirelength"]])
        added = self._added * np.float32(game.added_overflow[n])
        paid = np.full(len(game.nets), change @ self._team)
        own = self._table[game.crossing[n], game.ending[n]] - added
        paid[n] = float(own) + change @ self._mover + paid[n]
        return paid.astype(np.float32)


def _pay_others(
    prices: NDArray[np.float64], games: Games, before: Before, m: int, n: int, paid: Any
) -> None:
    """Pays the other nets of problem m by the counterfactual reward for a move of agent n."""
    edges = np.arange(games.remaining.shape[1])
    now, then = games.remaining[m], before.remaining[m]
    changed = edges[(now != then) & (np.minimum(now, then) < 0)]
    failed = games.agents["ending"][m, n] == Ending.FAILED
    shut_in = failed and not games.overflow_allowed and not _reaches(games, m, n, now)
    if not (len(changed) or shut_in):
        return
    for other in np.flatnonzero(games.nets[m] != NOBODY).tolist():
        if other == n:
            continue
        demand = _demand(games, m, other)
        used = games.uses(np.full_like(edges, m), np.full_like(edges, other), edges)
        own = changed[used[changed]]
        due_now, due_then = (_due(left[own], demand[own]).sum() for left in (now, then))
        paid[other] += prices[0] * (due_then - due_now)
        if shut_in and _reaches(games, m, n, now + used * demand):
            paid[other] -= prices[1]


def _due(remaining: NDArray[np.integer], demand: NDArray[np.integer]) -> NDArray[np.integer]:
    """The overflow that would disappear if a net released edges."""
    return np.maximum(-remaining, 0) - np.maximum(-remaining - demand, 0)


def _demand(games: Games, m: int, n: int) -> NDArray[np.int64]:
    """(E,) the demand of an agent's net on every edge; 0 on vias."""
    by_layer = games.problems[m].net_demand[games.nets[m, n]].astype(np.int64)
    edges = np.arange(games.remaining.shape[1])
    return np.where(edges % AXES == VIA_AXIS, 0, by_layer[edges // AXES % len(by_layer)])


def _reaches(games: Games, m: int, n: int, remaining: NDArray[np.integer]) -> bool:
    """Whether an agent could walk to its target, if so much were left of every edge (E,)."""
    edges = np.arange(len(remaining))
    used = games.uses(np.full_like(edges, m), np.full_like(edges, n), edges)
    room = used | (edges % AXES == VIA_AXIS) | (remaining >= _demand(games, m, n))
    grid, target = games.grid, games.agents["target"][m, n]
    queue = [int(games.agents["cell"][m, n])]
    reached = set(queue)
    for cell in queue:
        for _, edge, ahead in grid.exits_of[cell]:
            if room[edge] and ahead not in reached:
                reached.add(ahead)
                queue.append(ahead)
    return target in reached


def _shaped(paid: Any, games: Games, reward: Reward) -> NDArray[Any]:
    """(M, N) numbers that a reward has returned; raises InputError for anything else."""
    numbers = np.asarray(paid)
    if numbers.shape != games.nets.shape or numbers.dtype.kind not in "fiub":
        found = numbers.shape if numbers.dtype.kind in "fiub" else type(paid).__name__
        expected = f"expected shape {games.nets.shape}, found {found}"
        raise InputError(f"reward: {expected} from {type(reward).__name__}")
    return numbers


def paid_by(
    reward: Reward, games: Games, before: Before, movers: NDArray[np.int32]
) -> NDArray[np.float32]:
    """(M, N) what a reward pays for moves; raises InputError for a wrong shape, NaN or infinity."""
    paid = _shaped(reward(games, before, movers), games, reward).astype(np.float32)
    name = type(reward).__name__
    if not np.isfinite(paid).all():
        found = paid[~np.isfinite(paid)][0]
        raise InputError(f"reward: expected finite numbers, found {found} from {name}")
    return np.where((games.nets != NOBODY) & (movers != NOBODY)[:, None], paid, np.float32(0))


def payer_of(reward: Any) -> Callable[[Game, int], float]:
    """The ``pay`` of a reward, which gives finite numbers that float32 can hold or InputError."""
    pay: Callable[[Game, int], float] = reward.pay
    if type(reward) in _BUILT_IN.values():
        return pay
    name = f"{type(reward).__name__}.pay"

    def checked(game: Game, n: int) -> float:
        paid = pay(game, n)
        fits = isinstance(paid, int | float | np.integer | np.floating)
        number = float(paid) if fits else math.nan
        if not abs(number) <= _LARGEST:
            raise InputError(f"reward: expected a finite number from {name}, found {paid!r}")
        return float(np.float32(number))

    return checked


_LARGEST = float(np.finfo(np.float32).max)

_BUILT_IN: dict[str, type[Any]] = {
    "paper": PaperReward,
    "normalised": NormalisedReward,
    "team": TeamReward,
    "difference": DifferenceReward,
    "counterfactual": CounterfactualReward,
    "potential": PotentialReward,
    "mixed": MixedReward,
}

for _name, _kind in _BUILT_IN.items():
    register("reward", _name, _kind)
