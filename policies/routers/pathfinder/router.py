"""The router: the stages of a search."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from marouting import Problem, Solution
from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.routed import Routed, Stop
from policies.routers.pathfinder.search import Search
from policies.routers.pathfinder.state import (
    NEGOTIATE,
    PATTERN,
    PRICES,
    RELAX,
    REPAIR,
    RESTORE,
    SQUEEZE,
    UNIT,
)

_WARM = 60
"""Passes of a search that is made to compile all that a search needs."""

_EARLY = 20
"""A solution that is found in an earlier pass counts as found in this one when the search decides
whether to go on: passes over few nets take next to no time."""


class PathfinderRouter:
    """Negotiated congestion over Steiner trees, in all layers at once.

    After McMurchie and Ebeling, "PathFinder: a negotiation-based performance-driven router for
    FPGAs", FPGA 1995; see :mod:`policies.routers.pathfinder`.

    Args:
        options: the options; None for the defaults.

    Attributes:
        options: the options.
        watch: is called about twenty times a second of work with a line that tells how far the
            search is. If it returns True, the search stops with the best solution so far. None:
            nobody watches.
    """

    Options = PathfinderOptions

    def __init__(self, options: PathfinderOptions | None = None) -> None:
        self.options = PathfinderOptions() if options is None else options
        self.watch: Callable[[str], bool] | None = None
        self._search: Search | None = None

    def warm_up(self, problem: Problem) -> None:
        """Compiles what routing needs by routing a problem, of which ``start`` is no solution."""
        passes = min(self.options.passes, _WARM)
        options = replace(
            self.options,
            start=None,
            passes=passes,
            schedule="standard",
            cost="wirelength",
            via_weight=1.0,
            prefer_layers=None,
            prefer_from=None,
            prefer_weight=PathfinderOptions.prefer_weight,
        )
        PathfinderRouter(options).route(problem)
        if self.options.schedule == "tuned":  # which may use the linear program
            PathfinderRouter(replace(options, lp_passes=1)).route(problem)

    def best(self) -> Solution | None:
        """The best solution so far, for who watches; None if there is none yet."""
        search = self._search
        return None if search is None or not search.history else search.best()

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution in which every net is joined. It has overflow only where the router found
            no solution without.
        """
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Routed:
        """Routes a problem like :meth:`route` and tells how the solution was found."""
        began = time.perf_counter()
        self._search = search = Search(problem, self.options, self.watch)
        stop = _run(search)
        self._search = None
        solution, seconds = search.best(), time.perf_counter() - began
        return Routed(solution, seconds, tuple(search.history), stop)


def _run(search: Search) -> Stop:
    """Carries out one stage after another; returns why the search ended."""
    for stage in _Stages(search):
        stop = search.ended(stage) or search.carry_out(stage)
        if stop is not None:
            return stop
    return search.ended(None) or "settled"


class _Stages:
    """The stages of a search, mostly kinds of passes. Each is over when the next one is asked for.

    Args:
        search: the search, whose prices they set.
    """

    def __init__(self, search: Search) -> None:
        self._search, self._options = search, search.options
        self._rounds = 0  # completed ones

    def __iter__(self) -> Iterator[int]:
        """The whole search: patterns, then rounds."""
        search, options = self._search, self._options
        yield PATTERN
        stale = begun = 0  # rounds without a better solution; passes before this round
        if not search.from_patterns:
            begun = len(search.history)
            yield from self._relax(prices=0)
        while True:
            yield from self._negotiate()
            yield from self._squeeze()
            if search.best_pass > begun:
                stale = 0
            else:
                far = search.rank[0] > search.best_rank[0]
                stale += options.overflow_stall_weight if far else 1
            repaired = stale >= options.repair_after
            if repaired:
                yield from self._repair()
                stale = 0
            self._lower_prices()
            begun = len(search.history)
            if repaired and begun >= options.patience_factor * max(search.best_pass, _EARLY):
                return
            yield from self._relax(prices=options.lp_passes if search.best_rank[0] > 0 else 0)

    def _relax(self, prices: int) -> Iterator[int]:
        """Reroutes every net: once, or so many times at new prices of the linear program."""
        search = self._search
        search.clear_overflow()
        first = self._rounds == 0
        for _ in range(max(prices, 1)):
            if prices > 0 and search.best_rank[0] > 0 and search.relaxation is not None:
                search.relaxation.begin(first=first)
                yield PRICES
                if not search.relaxation.scarce:
                    yield NEGOTIATE if first else RELAX
                    return
                search.progress["present"] = self._options.present_factor
            yield RELAX

    def _negotiate(self) -> Iterator[int]:
        """Reroutes nets that overflow, at rising prices, as long as overflow falls."""
        search, options = self._search, self._options
        while search.rank[0] > 0 and search.stalled_passes < options.stall_passes:
            self._raise_prices()
            yield NEGOTIATE
            due = len(search.history) == options.lp_after_pass and options.lp_passes > 0
            # At the program's prices there is more overflow at first, and it takes passes to fall.
            if due and search.best_rank[0] > 0 and not search.is_late:
                yield from self._relax(options.lp_passes)

    def _squeeze(self) -> Iterator[int]:
        """Reroutes every net for least overflow, then for least length, while that gains enough."""
        search, gained = self._search, True
        while gained:
            overflow, length = search.rank
            yield SQUEEZE
            overflow_now, length_now = search.rank
            gained = overflow_now < overflow or (
                overflow_now == overflow == search.best_rank[0]
                and length - length_now > self._options.min_wirelength_gain * length_now
            )

    def _repair(self) -> Iterator[int]:
        """Lets nets displace each other, from the best solution on, while better ones are found."""
        search, stale = self._search, 0
        yield RESTORE
        while stale < self._options.repair_stall_passes:
            passes = len(search.history)
            yield REPAIR
            stale = 0 if search.best_pass > passes else stale + 1
        search.progress["linked"] = 0

    @property
    def _step(self) -> float:
        """By how much of the usual amounts prices change in this round."""
        return 1.0 / (1.0 + self._options.step_decay * self._rounds)

    def _raise_prices(self) -> None:
        """Before a negotiating pass: edges that overflow cost more, now and later."""
        options, progress, routing = self._options, self._search.progress, self._search.routing
        present = progress["present"] * options.present_growth
        progress["present"] = present or options.present_factor  # until then nets shared freely
        increment = self._step * options.history_increment * UNIT
        routing.price[routing.remaining < 0] += increment

    def _lower_prices(self) -> None:
        """After a round: prices lose some of what they have gained."""
        self._search.progress["present"] = self._options.present_factor
        self._search.routing.price[:] *= 1.0 - self._step * (1.0 - self._options.history_decay)
        self._rounds += 1
