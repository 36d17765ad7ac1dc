"""The generalist: one network for all nets and problems, and a search by rip-up rounds.

1. The network routes all nets with its best moves. If there is time for priced rounds, edges have
   prices (:mod:`marouting.batch.prices`): the more time, the cheaper is overflow at first.
2. A second game follows Steiner trees (:mod:`marouting.trees.steiner`), which are shorter if
   capacity allows. If its result is better, the first game continues from these routes.
3. Rip-up rounds (:mod:`marouting.batch.rounds`) with sampled moves: each agent decides whether to
   rip up its net, which is rerouted together with some nets that block it. Changes that make the
   solution worse are undone. In priced rounds nets are rerouted one by one and keep routes that
   cost them less. There, nets with few pins follow a computed cheapest tree, and the network moves
   the others.

The result is the best solution after any round. All moves and rounds are those of the environment,
compiled (:mod:`policies.generalist.walk`).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from torch import nn

from marouting import EnvOptions, Problem, Solution
from marouting.batch.engine import Engine
from marouting.batch.prices import MOST_PRESENT, Negotiation
from marouting.checks import check_fields
from marouting.config import check
from marouting.problem.grid import MOVES
from marouting.rules import MOST_NEIGHBOURS, MOST_ROUNDS, Mask, Nets, RipUp
from policies.generalist import SHIPPED
from policies.generalist.cheapest_tree import MOST_PINS
from policies.generalist.outlook import DETOURS, OutlookObservation
from policies.generalist.walk import MOST_STEPS, Walker, take_best
from policies.learned.counter_rng import keys
from policies.learned.networks.mlp import plain_sizes
from policies.learned.policy import Routed, TrainedPolicy

_SURE = 8.0
"""How much a Gcell of detour lowers a move's score where ``policy`` is ``greedy``."""

_STEPS = 64
"""Moves between two looks at the clock, unless there is time for less: a quarter of a
millisecond on small grids."""

_STEINER: dict[str, Any] = {"nets": Nets(decomposition="steiner"), "next_pin": "listed"}
"""What is different in the game in which nets walk along Steiner trees."""

_LEAST, _ROOM, _TIGHT = 0.01, 2, 8
"""That game is played if there are so many seconds, and if the first walk took at most half of them
where it left no overflow, at most an eighth elsewhere: on tight problems Steiner trees gain little,
and in a few milliseconds rip-ups gain more."""

_MOVE, _TREE_MOVE, _ROUND = 7e-6, 3.5e-6, 0.35
"""About the time of a walk of all nets, in seconds per edge of the half perimeters of their pins,
by the network and along trees; and how much of such a walk a round is."""

_FEW, _PRESENT, _POWER = 2.0, 2.8, 1.5
"""With time and rounds for fewer walks than the first number nets do not negotiate. Otherwise
``present`` is the second one, divided by their number, to the power of the third: with
little time nets share less, and have parted sooner."""

_DECAY = 0.3
"""``step_decay``: there are rounds enough for prices to come to rest."""

_COLD = np.zeros(1, np.float32)  # the temperature at which the best moves are made

_OFTEN = 0.1
"""Seconds between two lines to who watches."""


@dataclass(frozen=True, kw_only=True)
class GeneralistOptions:
    """The options of the generalist.

    Attributes:
        weights: a file of a trained policy with the observation ``outlook``, such as
            ``configs/generalist.yaml`` trains; None: the one that is shipped with the package, see
            ``README.md`` beside it.
        seconds: limit of processor time. It may be exceeded until all nets have routed for the
            first time. In a process's first route it counts loading compiled code, unless
            :func:`policies.routers.base.warm_up` has been called, as commands do. None: no limit.
        rounds: the most rip-up rounds; 0 for a single shot.
        temperature: of the softmax from which moves are sampled.
        neighbours: the most blocking nets that are rerouted together with a net.
        patience: number of consecutive plain rounds after which one more blocking net is rerouted,
            starting with none; 0: ``neighbours`` of them from the first round on.
        prices: whether there are priced rounds (:mod:`marouting.batch.prices`), if time allows.
            They need weights trained with ``overflow: allowed``.
        exact_pins: in priced rounds, nets with at most this many pins follow a computed cheapest
            tree (:mod:`policies.generalist.cheapest_tree`) instead of the network; 0: none.
        seed: seed of the random numbers.
        policy: what chooses the moves: ``network``; or, as baselines without learning, ``greedy``,
            the shortest paths at current costs, or ``random``.

    Raises:
        InputError: a value is out of range.
    """

    weights: str | None = None
    seconds: float | None = 1.0
    rounds: int = MOST_ROUNDS
    temperature: float = 1.0
    neighbours: int = 3
    patience: int = 2
    prices: bool = True
    exact_pins: int = 6
    seed: int = 0
    policy: Literal["network", "greedy", "random"] = "network"

    def __post_init__(self) -> None:
        counted = dict.fromkeys(("rounds", "patience"), (0, MOST_ROUNDS))
        counted |= {"neighbours": (0, MOST_NEIGHBOURS), "seed": (0, 2**63 - 1)}
        check_fields(self, seconds=(0, np.inf), temperature=(0, np.inf), **counted)
        exact = self.exact_pins == 0 or 2 <= self.exact_pins <= MOST_PINS
        check("exact_pins", exact, f"0, or a number from 2 to {MOST_PINS}")
        network = self.policy == "network" or self.weights is None
        check("weights", network, f"null with policy={self.policy}, which has no network")


class GeneralistRouter:
    """Routes a problem by a trained network and rip-up rounds.

    Args:
        options: the options; None for the defaults.

    Attributes:
        options: the options.
        watch: is told how far rip-ups are, and can end them; see
            :class:`policies.routers.base.Watched`.

    Raises:
        InputError: the weights cannot be used.
    """

    Options = GeneralistOptions

    def __init__(self, options: GeneralistOptions | None = None) -> None:
        self.options = options = GeneralistOptions() if options is None else options
        self.watch: Callable[[str], bool] | None = None
        self._observation = OutlookObservation()
        env = EnvOptions(
            overflow="allowed", target="tree", next_pin="nearest", mask=Mask(visited=True)
        )
        self._sizes: tuple[int, ...] = (self._observation.size, MOVES)
        self._weights = np.zeros((self._sizes[0] + 1) * MOVES, np.float32)
        if options.policy == "greedy":
            first = np.arange(MOVES)
            self._weights[(DETOURS + first) * MOVES + first] = -_SURE
        if options.policy == "network":
            weights = str(SHIPPED) if options.weights is None else options.weights
            trained = TrainedPolicy.load(weights)
            self._observation, self._sizes, self._weights = _read(trained, weights)
            env = trained.env
        self._keys = keys(options.seed, ["0"], "walk")
        rounds = _rounds(options.rounds, options.neighbours)
        self._rules = replace(env.rules, turn_order="sequential", rip_up=rounds)
        prices = options.prices and options.rounds > 0 and env.overflow == "allowed"
        self._negotiation = Negotiation(prices=prices, patience=options.patience, step_decay=_DECAY)

    def warm_up(self, problem: Problem) -> None:
        """Compiles what routing needs, in a round at most."""
        options = replace(self.options, rounds=min(1, self.options.rounds), seconds=None)
        GeneralistRouter(options)._play(problem, self._negotiation_for(problem), time.thread_time())

    def route(self, problem: Problem) -> Solution:
        """Routes a problem; in the solution every net is joined whose pins any way joins."""
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Routed:
        """Routes a problem like :meth:`route`, and tells how.

        The report has ``moves``, all that agents have made, and ``rounds``.
        """
        began = time.thread_time()
        return self._play(problem, self._negotiation_for(problem), began)

    def _play(self, problem: Problem, negotiation: Negotiation, began: float) -> Routed:
        """:meth:`solve`, which began at that processor time."""
        o, rules = self.options, self._rules
        engine, temperature = Engine([problem], rules, negotiation=negotiation), _COLD.copy()
        seen = self._observation, self._sizes, self._weights
        walker = Walker(engine, *seen, temperature, self._keys, exact_pins=o.exact_pins)

        guide, seconds = None, np.inf if o.seconds is None else o.seconds
        walker.walk_out(stops=True)
        share = _TIGHT if any(_cost(engine)[:-1]) else _ROOM
        if seconds >= max(_LEAST, share * (time.thread_time() - began)):
            alone_rules = replace(rules, **_STEINER, rip_up=_rounds(o.rounds, 0))
            guide = Engine([problem], alone_rules, negotiation=negotiation)
            alone = Walker(guide, *seen, _COLD, self._keys, exact_pins=o.exact_pins)
            alone.walk_out(stops=True)
            walker.counters += alone.counters
            if rules.target == "tree" and _walked(guide) < _walked(engine):
                engine.reset()
                walker.follow(guide)
                walker.walk_out(stops=True)
                walker.follow(None)
        temperature[:] = o.temperature
        self._rip_up(engine, walker, began)
        report = {"moves": int(walker.counters[0]), "rounds": int(engine.games["round"][0])}
        if guide is not None and _cost(guide) < _cost(engine):
            engine = guide  # a net could not follow its routes, whose tasks were shorter
        return Routed(engine.solution(), report)

    def _negotiation_for(self, problem: Problem) -> Negotiation:
        """Whether nets negotiate, and how cheaply they share edges at first."""
        o, walks = self.options, 1 + _ROUND * self.options.rounds
        if o.seconds is not None:
            low, high = problem.pin_boxes()
            on_trees = np.diff(problem.flat_pin_gcells[0]) <= o.exact_pins
            times = np.where(on_trees, _TREE_MOVE, _MOVE) * (high - low).sum(axis=1)
            walks = min(walks, o.seconds / max(float(times.sum()), 1e-9))
        if walks < _FEW:
            return replace(self._negotiation, prices=False)
        usual = self._negotiation.present_factor
        present = min(max(usual, (_PRESENT / walks) ** _POWER), MOST_PRESENT)
        return replace(self._negotiation, present_factor=present)

    def _rip_up(self, engine: Engine, walker: Walker, began: float) -> None:
        """Rip-up rounds, until the time is over."""
        o, said = self.options, time.perf_counter()

        def in_time() -> bool:
            nonlocal said
            if self.watch is not None and time.perf_counter() - said >= _OFTEN:
                said = time.perf_counter()
                game = engine.games[0]
                which = "best" if engine.priced else "kept"
                overflow, wirelength = (game[f"{which}_{n}"] for n in ("overflow", "wirelength"))
                line = f"round {game['round']}; overflow {overflow}, wirelength {wirelength}"
                if self.watch(line):
                    return False
            return left() > 0

        def left() -> float:
            return np.inf if o.seconds is None else o.seconds - (time.thread_time() - began)

        def steps() -> int:
            """So many that a call costs little beside them, and half the time at most."""
            made = int(walker.counters[0]) / max(time.thread_time() - began, 1e-6)
            most = int(made * min(left(), _OFTEN))
            return max(min(most // 2, MOST_STEPS), min(most, _STEPS), 1)

        if o.rounds and in_time():
            over = False
            while not over and in_time():
                over = walker.walk(steps())
            walker.walk_out(stops=True)
            if engine.priced:
                take_best(engine.static, engine.dynamic)


def _read(
    policy: TrainedPolicy, where: str
) -> tuple[OutlookObservation, tuple[int, ...], NDArray[np.float32]]:
    """A policy's observation, and its network's layers and weights; raises InputError."""
    seen, module = policy.env.observation.make(), policy.module
    check(f"{where}: observation", isinstance(seen, OutlookObservation), "outlook")
    sizes = plain_sizes(module)
    check(f"{where}: network", sizes is not None, "an mlp with activation relu, not dueling")
    assert isinstance(seen, OutlookObservation)
    assert sizes is not None
    return seen, sizes, nn.utils.parameters_to_vector(module.parameters()).detach().numpy()


def _cost(engine: Engine) -> tuple[int, int, int]:
    """What the game is judged by: open tasks, overflow and wirelength."""
    metrics = engine.metrics()
    return metrics.tasks - metrics.joined, metrics.overflow, metrics.wirelength


def _walked(engine: Engine) -> tuple[int, ...]:
    """What its first walk is judged by; at prices overflow can still go away."""
    still_open, overflow, wirelength = _cost(engine)
    if engine.priced:
        return still_open, overflow + wirelength
    return still_open, overflow, wirelength


def _rounds(rounds: int, neighbours: int) -> RipUp | None:
    """Rip-up rounds in which agents are asked, if there are any."""
    return RipUp(rounds=rounds, choose="agents", neighbours=neighbours) if rounds else None
