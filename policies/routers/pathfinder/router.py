"""The router, and what it reports."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import Problem, Solution
from policies.routers.pathfinder.batches import Crew
from policies.routers.pathfinder.contest import with_contest
from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.relaxation import Relaxation
from policies.routers.pathfinder.schedule import scheduled
from policies.routers.pathfinder.state import (
    KINDS,
    UNIT,
    Kind,
    Routing,
    make_arrays,
    make_parameters,
    present_solution,
    solution_of,
    with_trees,
)

_LABELS = 5_000_000
"""Labels that a search opens in a second, about."""

_LEAST_WORK, _MOST_WORK = 1 << 10, 1 << 18
"""Labels between two looks at the clock: from a fifth of a millisecond to 50 ms."""

_WARM = 60
"""Passes of a search that is made to compile all that a search needs."""

_WINDOW, _SHARE = 4.0, 0.25
"""What a search has saved lately is what it saved in so many seconds, and in this share of it."""

Stop = Literal["optimal", "settled", "gain", "passes", "seconds", "asked"]
"""Why a search ended: no solution can be better; it finds nothing better any more; or too little
for the time; it had all the passes, or all the time, that it may take; or somebody asked it to
stop."""


class Pass(NamedTuple):
    """The state after a pass over the nets."""

    kind: Kind
    overflow: int  # in tracks
    wirelength: float  # in edges, with the costs that the options give to vias and crowded edges
    routed: int  # nets rerouted in this pass


@dataclass(frozen=True)
class Routed:
    """A solution and how it was found.

    Attributes:
        solution: the solution with the least overflow after any pass, and among those the least
            wirelength, vias weighted by ``via_weight``, and what crowded edges cost (with ``cost:
            ispd2024`` the least cost). More time gives no worse one with the same seed, unless
            ``least_gain`` ends the search.
        seconds: time taken.
        history: every pass, in order; the first is that of patterns.
        stop: why the search ended.
        prices: (E,) what past overflow adds to the cost of every edge in the end, in edges.
        present: factor by which one net too many raises the cost of an edge in the end.
    """

    solution: Solution
    seconds: float
    history: tuple[Pass, ...]
    stop: Stop
    prices: NDArray[np.float64]
    present: float

    @property
    def iterations(self) -> int:
        """Number of passes over the nets."""
        return len(self.history)

    @property
    def report(self) -> dict[str, Any]:
        """Figures for tables beyond those of the evaluator: ``iterations`` and ``stop``."""
        return {"iterations": self.iterations, "stop": self.stop}


class _Gain:
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
        self._best: Callable[[], Solution] | None = None

    def warm_up(self, problem: Problem) -> None:
        """Compiles what routing needs, by a problem to which ``start`` is no solution."""
        passes = min(self.options.passes, _WARM)
        options = replace(
            self.options,
            start=None,
            passes=passes,
            schedule="standard",
            cost="wirelength",
            via_weight=1.0,
        )
        PathfinderRouter(options).route(problem)
        if self.options.schedule == "tuned":  # which may use the linear program
            PathfinderRouter(replace(options, lp_passes=1)).route(problem)

    def best(self) -> Solution | None:
        """The best solution so far, for who watches; None if there is none yet."""
        return None if self._best is None else self._best()

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution in which every net is joined. It has overflow only where the router found
            no solution without.
        """
        return self.solve(problem).solution

    def solve(
        self,
        problem: Problem,
        start: Solution | None = None,
        prices: NDArray[np.float64] | None = None,
        present: float = 0.0,
        taken: NDArray[np.int64] | None = None,
    ) -> Routed:
        """Routes a problem like :meth:`route` and tells how the solution was found.

        Args:
            problem: the problem.
            start: a solution to begin with; None: the one of the option ``start``, if there is one.
            prices: (E,) prices to begin with, as in :class:`Routed`; None: 0 everywhere.
            present: factor to go on from, as in :class:`Routed`; 0: the option ``present_factor``.
                With another one negotiating begins with ``start``, however few nets there are.
            taken: (E,) tracks that others use of every edge; None: none. The overflow of a pass
                leaves out what they cause alone.
        """
        began, worked = time.perf_counter(), time.thread_time()
        options = scheduled(self.options, problem)
        limit = options.seconds
        parameters = make_parameters(options)
        arrays, routing = make_arrays(problem, options)
        if start is None and options.start is not None:
            start = Solution.read(options.start, problem)
        if start is not None:
            routing = with_trees(routing, start)
        if prices is not None:
            routing.price[:] = prices * UNIT
        if options.cost == "ispd2024":
            arrays, routing = with_contest(problem, arrays, routing)
        progress = routing.progress[0]
        progress["present"] = present
        progress["large"] |= present > 0
        if taken is not None:
            routing.remaining[:] -= taken
        if progress["most"] > 1:
            parameters = parameters._replace(lp_passes=0)
        relaxation = None
        if parameters.lp_passes > 0:
            relaxation = Relaxation(arrays, parameters, routing, options.lp_price_scale)
        passes: list[Pass] = []
        gain = _Gain()
        ended = len(routing.order) == 0
        stop: Stop = "optimal" if ended else "settled"
        with Crew(arrays, parameters, int(progress["most"]), options.threads) as crew:

            def spent() -> float:
                return time.thread_time() - worked + crew.waited

            def left() -> float:
                return np.inf if limit is None else limit - spent()

            while not ended:
                # Half of the time that is left, so that short searches end in time, too.
                labels = max(min(left() / 2 * _LABELS, _MOST_WORK), _LEAST_WORK)
                if relaxation is not None and relaxation.busy:
                    relaxation.advance(routing, int(labels))
                else:
                    progress["work"] = labels
                    ended, routing = crew.advance(routing)
                rows = routing.history[: progress["history"]].tolist()
                for kind, overflow, length, routed in rows:
                    passes.append(Pass(KINDS[kind], overflow, length / UNIT, routed))
                if relaxation is not None and rows:
                    relaxation.after_pass(routing)
                progress["history"] = 0
                asked = False
                if self.watch is not None:
                    # What the watcher does is none of the search's work.
                    told = time.thread_time()
                    self._best = partial(_best, problem, routing) if passes else None
                    asked = self.watch(_line(progress, len(passes)))
                    worked += time.thread_time() - told
                if ended:
                    stop = _reason(progress, parameters.passes)
                elif passes and (asked or left() <= 0):  # the first pass has made a whole solution
                    stop, ended = "asked" if asked else "seconds", True
                elif rows and options.by_the_clock and _round_over(progress):
                    length = float(progress["best_length"])
                    ended = gain.too_little(spent(), length, options.least_gain)
                    stop = "gain" if ended else stop
        self._best = None
        solution = _best(problem, routing)
        prices = routing.price / UNIT
        factor = float(progress["present"])
        return Routed(solution, time.perf_counter() - began, tuple(passes), stop, prices, factor)


def _best(problem: Problem, routing: Routing) -> Solution:
    """The best solution of a search so far.

    It may be that in the middle of a pass that never makes a solution worse. What other passes have
    found in the middle could be lost with more time, and more time must not be worse than less.
    """
    progress = routing.progress[0]
    now, best = (
        [progress[f"{when}{what}"] for what in ("overflow", "length")] for when in ("", "best_")
    )
    if KINDS[progress["kind"]] in ("squeeze", "repair") and now < best:
        return present_solution(problem, routing)
    first = routing.best_first
    return solution_of(problem, routing.best, first[:-1], np.diff(first))


def _round_over(progress: Any) -> bool:
    """Whether a round without overflow has just ended: only then has it found its best solution."""
    return progress["best_overflow"] == 0 and KINDS[progress["kind"]] in ("relax", "repair")


def _reason(progress: Any, most: int) -> Stop:
    """Why a search has ended by itself."""
    if progress["proven"]:
        return "optimal"
    return "passes" if progress["passes"] >= most else "settled"


def _line(progress: Any, passes: int) -> str:
    """How far a search is."""
    kind = KINDS[progress["kind"]]
    line = f"pass {passes + 1} ({kind}), net {progress['next']}"
    if passes == 0:
        return line
    overflow, length = progress["best_overflow"], progress["best_length"] // UNIT
    return f"{line}; best: overflow {overflow}, wirelength {length}"
