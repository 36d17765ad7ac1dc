"""A search while it is under way: its trees, how far it is, and what carries its passes out."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from marouting import Problem, Solution
from marouting.kernels import specialised
from policies.routers.pathfinder.batches import MANY, Worker, advance_batch, make_batch
from policies.routers.pathfinder.contest import with_contest
from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.passes import go_on, shuffle
from policies.routers.pathfinder.relaxation import Relaxation
from policies.routers.pathfinder.routed import Pass, Stop
from policies.routers.pathfinder.schedule import scheduled
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DONE,
    KINDS,
    PATTERN,
    POOL_TOO_SMALL,
    PRICES,
    RELAX,
    REPAIR,
    RESTORE,
    SQUEEZE,
    UNIT,
    make_arrays,
    solution_of,
    with_larger_pool,
    with_trees,
)
from policies.routers.pathfinder.trees import keep_best

_LARGE = 5_000
"""With more nets than these, negotiating begins with patterns; otherwise with shortest trees."""

_NOTHING = (1 << 62, 0)
"""A rank that any solution is better than."""

_LABELS = 5_000_000
"""Labels that a search opens in a second, about."""

_LEAST_WORK, _MOST_WORK = 1 << 10, 1 << 18
"""Labels between two looks at the clock: from a fifth of a millisecond to 50 ms."""

_WINDOW, _SHARE = 4.0, 0.25
"""What a search has saved lately is what it saved in so many seconds, and in this share of it."""


class Gain:
    """How much of its length the best solution without overflow has lately lost."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()  # seconds and length at ends of rounds

    def too_little(self, seconds: float, length: float, least: float) -> bool:
        """Notes the best solution's length; whether the search has saved too little lately."""
        seen = self._seen
        seen.append((seconds, length))
        begin = seconds - max(_WINDOW, _SHARE * seconds)
        if seen[0][0] > begin:
            return False
        while seen[1][0] <= begin:
            seen.popleft()
        then, before = seen[0]
        return before - length < least * length * (seconds - then)


class Search:
    """A search while it is under way.

    Args:
        problem: the problem.
        options: the options.
        watch: as in :class:`~policies.routers.pathfinder.router.PathfinderRouter`.

    Attributes:
        options: the options, as the schedule has them; without a linear program for many nets.
        routing: the trees and prices now.
        progress: a view of ``routing.progress[0]``.
        history: the passes so far.
        rank: overflow in tracks and length in units of cost after the last pass.
        best_rank: that of the best solution so far.
        best_pass: how many passes there were when it was found.
        stalled_passes: how many passes there have been since the overflow last fell in this round.
        relaxation: the linear program; None: there is none.
        from_patterns: whether negotiating begins with the patterns.
    """

    def __init__(
        self,
        problem: Problem,
        options: PathfinderOptions,
        watch: Callable[[str], bool] | None,
    ) -> None:
        self._began = time.thread_time()  # later moved by what was not the search's work
        options = scheduled(options, problem)
        self._problem, self._watch, self._gain = problem, watch, Gain()
        self._arrays, self.routing = make_arrays(problem, options)
        if options.start is not None:
            self.routing = with_trees(self.routing, Solution.read(options.start, problem))
        if options.cost == "ispd2024":
            self._arrays, self.routing = with_contest(problem, self._arrays, self.routing)
        self.progress = self.routing.progress[0]
        nets = len(self.routing.order)
        self.from_patterns = nets > _LARGE
        self._batch = make_batch(nets) if nets > MANY else None
        if self._batch is not None:
            options = replace(options, lp_passes=0)
        workers = 1 if self._batch is None else options.threads
        self._workers = [Worker(number, self._arrays) for number in range(workers)]
        self.relaxation: Relaxation | None = None
        if options.lp_passes > 0:
            self.relaxation = Relaxation(self._arrays, self.routing, options.lp_price_scale)
        self._go_on = specialised(go_on, self._arrays, self.routing, self._workers[0].memory)
        self._shuffle = specialised(shuffle, self.routing)
        self.options = options
        self.history: list[Pass] = []
        self.rank, self.best_rank = (0, 0), _NOTHING
        self.best_pass, self._proven = 0, nets == 0
        self.clear_overflow()
        self._set_work(self._left())

    def best(self) -> Solution:
        """The best solution so far.

        It may be that in the middle of a pass that never makes a solution worse. What other passes
        have found in the middle could be lost with more time, and more time must not be worse than
        less.
        """
        now = self.progress["overflow"], self.progress["length"]
        if self.progress["kind"] in (SQUEEZE, REPAIR) and now < self.best_rank:
            edges, first, length = self.routing.edge, self.routing.start, self.routing.length
        else:
            edges, first = self.routing.best, self.routing.best_first[:-1]
            length = np.diff(self.routing.best_first)
        return solution_of(self._problem, edges, first, length)

    def clear_overflow(self) -> None:
        """Forgets how much overflow there was."""
        self._fewest, self.stalled_passes = np.inf, 0

    def ended(self, stage: int | None) -> Stop | None:
        """Why the search ends before a stage; None if it does not."""
        options = self.options
        if self._proven:
            return "optimal"
        if len(self.history) >= options.passes:
            return "passes"
        # Only at the end of a round a search has found its best solution.
        over = stage in (RELAX, REPAIR) and self.best_rank[0] == 0 and options.by_the_clock
        length, least = self.best_rank[1], options.least_gain
        return "gain" if over and self._gain.too_little(self._spent(), length, least) else None

    def carry_out(self, stage: int) -> Stop | None:
        """Carries out a stage; returns why the search ends meanwhile, if it does."""
        if self.relaxation is not None and stage not in (PATTERN, RESTORE):
            self.relaxation.collect(self.routing)
        if stage != PRICES:
            self.progress["kind"], self.progress["routed"] = stage, 0
        while not self._advance(stage):
            stop = self._look()
            if stop is not None:
                return stop
        if stage >= 0:
            self._end_pass(stage)
        return None

    def _advance(self, stage: int) -> bool:
        """Carries a stage on for a while; returns whether it is over."""
        first, progress = self._workers[0], self.progress
        if stage == PRICES and self.relaxation is not None:
            return self.relaxation.advance(self.routing, self._labels)
        if self._batch is not None and 0 <= stage <= SQUEEZE:
            self.routing = advance_batch(self._arrays, self.routing, self._batch, self._workers)
            self._began -= max(worker.seconds for worker in self._workers) - first.seconds
            return bool(progress["next"] == len(self.routing.order))
        code = self._go_on(self._arrays, self.routing, first.memory)
        if code == BOX_TOO_SMALL:
            first.make_room(2 * int(progress["need"]))
        elif code == POOL_TOO_SMALL:
            self.routing = with_larger_pool(self.routing, 2 * int(progress["need"]))
        return bool(code == DONE)

    def _end_pass(self, kind: int) -> None:
        """Notes what came of a pass."""
        progress = self.progress
        progress["next"] = 0
        overflow, length = self.rank = int(progress["overflow"]), int(progress["length"])
        if kind != PATTERN or self.from_patterns:  # the first searches are those for short nets
            self._shuffle(self.routing)
        self.history.append(Pass(KINDS[kind], overflow, length / UNIT, int(progress["routed"])))
        if self.rank < self.best_rank:
            self.best_rank, self.best_pass = self.rank, len(self.history)
            keep_best(self.routing)
        if overflow == 0 and self.rank == self.best_rank and progress["unproven"] == 0:
            # No solution can be shorter than the shortest trees of all nets together.
            self._proven = bool(length == self.routing.ideal.sum())
        if overflow < self._fewest * (1.0 - self.options.min_overflow_drop):
            self._fewest, self.stalled_passes = overflow, 0
        else:
            self.stalled_passes += 1

    def _spent(self) -> float:
        """Processor seconds of the thread that has worked longest."""
        return time.thread_time() - self._began

    def _left(self) -> float:
        """Processor seconds until the limit."""
        limit = self.options.seconds
        return np.inf if limit is None else limit - self._spent()

    @property
    def is_late(self) -> bool:
        """Whether more than a quarter of the processor time is spent."""
        return self._left() < 3 * self._spent()

    def _set_work(self, left: float) -> None:
        """Sets how many labels are opened until the next look at the clock."""
        # Half of the time that is left, so that short searches end in time, too.
        self._labels = int(max(min(left / 2 * _LABELS, _MOST_WORK), _LEAST_WORK))
        opened = self._workers[0].memory.search.tally[1]
        self.progress["until"] = opened + self._labels

    def _look(self) -> Stop | None:
        """Looks at the clock, and tells who watches; returns why the search ends, if it does."""
        asked = False
        if self._watch is not None:
            before = time.thread_time()
            asked = self._watch(self._line())
            self._began += time.thread_time() - before
        left = self._left()
        self._set_work(left)
        if not self.history:  # the first pass makes a whole solution
            return None
        return "asked" if asked else "seconds" if left <= 0 else None

    def _line(self) -> str:
        """How far the search is."""
        kind, net = KINDS[self.progress["kind"]], self.progress["next"]
        line = f"pass {len(self.history) + 1} ({kind}), net {net}"
        if not self.history:
            return line
        overflow, length = self.best_rank
        return f"{line}; best: overflow {overflow}, wirelength {length // UNIT}"
