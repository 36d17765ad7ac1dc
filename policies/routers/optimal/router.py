"""The router, and how its three steps follow one another."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from numpy.typing import NDArray

from marouting import InputError, Problem, Solution, evaluate, sequential_astar
from policies.routers.optimal.candidates import Candidates, Score
from policies.routers.optimal.flows import Flows, Stop
from policies.routers.optimal.prices import Prices
from policies.routers.optimal.programs import OVERFLOW, Deadline, Objective, choose
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

MAX_WORK = 2**36
"""The largest problem accepted for ``bound=optimum``, in steps of one search for the cheapest trees
of all nets."""

MOST_PINS = 9
"""Pins of a net that count at most for ``bound=relaxation``, so that no problem is too large."""

HEAD_START = 0.1
"""The share of the time that negotiated congestion may take to find a first solution."""

Bound = Literal["optimum", "relaxation"]
Status = Literal["optimal", "relaxation", "time limit", "solver limit"]


@dataclass(frozen=True)
class Optimum:
    """The best solution found, and what is proven about a problem's solutions.

    Attributes:
        solution: the best solution found; every net is joined.
        overflow: its overflow, in tracks.
        wirelength: its wirelength, in edges.
        bound_overflow: no solution has less overflow.
        bound_wirelength: no solution with that overflow has less wirelength.
        seconds: time taken.
        status: ``optimal`` if the bound and the solution agree. Otherwise the reason why the
            search ended: ``relaxation`` if no more was asked for, ``time limit``, or ``solver
            limit`` if an integer program was too large or its numbers too large for the solver's
            tolerances.
    """

    solution: Solution
    overflow: int
    wirelength: int
    bound_overflow: int
    bound_wirelength: int
    seconds: float
    status: Status

    @property
    def gap(self) -> float:
        """The share of the wirelength that might be saved; infinite if overflow might be saved."""
        if self.overflow > self.bound_overflow:
            return math.inf
        return (self.wirelength - self.bound_wirelength) / max(self.wirelength, 1)

    @property
    def report(self) -> dict[str, Any]:
        """Figures for tables beyond those of the evaluator; ``gap`` is None if infinite."""
        return {
            "bound_overflow": self.bound_overflow,
            "bound_wirelength": self.bound_wirelength,
            "gap": self.gap if self.gap < math.inf else None,
            "status": self.status,
        }


@dataclass(frozen=True)
class OptimalRouter:
    """Finds the least overflow and then the least wirelength, with a proof if time allows.

    The method and its publications are described in :mod:`policies.routers.optimal`.

    Attributes:
        time_limit: seconds after which the best solution so far is returned; None for no limit.
            With 0 this is the solution of sequential A*, and the bound is the sum of the nets'
            shortest trees. Negotiated congestion may take a tenth of the time. The limit holds for
            all steps but A*; the sum has half the box of a net's pins for the nets that are left.
        bound: ``optimum`` to prove the optimum; ``relaxation`` to stop at the bound that prices
            prove, with the best choice of the trees found, for problems too large for a full
            proof. The relaxation counts at most MOST_PINS pins per net, spread far apart.

    Raises:
        InputError: ``time_limit`` is negative or not a number.
    """

    time_limit: float | None = None
    bound: Bound = "optimum"

    def __post_init__(self) -> None:
        if self.time_limit is not None and not self.time_limit >= 0:
            raise InputError(f"time_limit: expected seconds from 0, found {self.time_limit}")

    def route(self, problem: Problem) -> Solution:
        """Routes a problem; see :meth:`solve`."""
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Optimum:
        """Routes a problem and proves how good the solution is.

        Raises:
            InputError: the problem is too large for ``bound=optimum``; the message gives sizes.
            RuntimeError: evaluator and solver disagree, which means that one of them has a bug.
        """
        started = time.monotonic()
        search = _Search(problem, Deadline(self.time_limit), self.bound)
        status = search.run()
        solution, best = search.candidates.solution(), search.candidates.best
        figures = evaluate(problem, solution)
        found = (figures.overflow, figures.wirelength)
        if not figures.connected or found != best or found < search.lower:
            raise RuntimeError(f"claimed {best} with bound {search.lower}, found {figures}")
        seconds = time.monotonic() - started
        return Optimum(solution, *best, *search.lower, seconds, status)


class _Search:
    """Raises the bound and improves the best solution until they meet.

    Args:
        problem: the problem.
        deadline: when to stop.
        asked: what to prove.

    Attributes:
        candidates: the trees found and the best solution.
        lower: no solution has a better score.
    """

    def __init__(self, problem: Problem, deadline: Deadline, asked: Bound) -> None:
        self.candidates = Candidates(problem, None if asked == "optimum" else MOST_PINS)
        if asked == "optimum":
            _check_size(problem, self.candidates.pins)
        self.lower: Score = (0, 0)
        self._asked = asked
        self._deadline = deadline
        self._prices = Prices(self.candidates, deadline)
        self._flows = Flows(self.candidates, self._prices, deadline)
        self._chosen: set[Objective] = set()  # objectives for which step 2 is done
        self._add(sequential_astar(problem))
        if not deadline.passed:
            options = PathfinderOptions()
            seconds = HEAD_START * deadline.left
            if options.seconds is None or seconds < options.seconds:
                options = replace(options, seconds=max(seconds, 0.0))
            self._add(PathfinderRouter(options).route(problem))

    def _add(self, solution: Solution) -> None:
        """Adds a solution, pruned as far as there is time."""
        nets = range(len(self.candidates.nets))
        self.candidates.add_solution(solution, self._deadline.while_left(nets))

    def run(self) -> Status:
        """Searches until the bound and the best solution agree or something prevents progress."""
        ended: Status | None = None
        while ended is None and self.lower < self.candidates.best:
            ended = self._advance()
        return "optimal" if ended is None or self.lower == self.candidates.best else ended

    def _advance(self) -> Stop | Literal["relaxation"] | None:
        """Takes the next step; returns what prevents further progress, if anything."""
        candidates = self.candidates
        overflow = self.lower[0]
        found = candidates.best[0] == overflow
        if not found and (least := self._prices.raise_bound(OVERFLOW)) > overflow:
            self.lower = (int(least), 0)
            return None
        objective = Objective(wirelength=True, overflow=overflow)
        least = self._prices.raise_bound(objective)
        if least == math.inf:  # some net cannot be routed with so little overflow
            beyond = candidates.demand - candidates.capacity
            self.lower = (int(beyond[beyond > overflow].min()), 0)
        else:
            self.lower = max(self.lower, (overflow, int(least)))
        if self._deadline.passed:
            return "time limit"
        if least == math.inf or self.lower >= candidates.best:
            return None
        if objective not in self._chosen:
            self._chosen.add(objective)
            choose(candidates, objective, self._deadline)
            return None
        if self._asked == "relaxation":
            return "relaxation"
        self.lower, stop = self._flows.decide(objective if found else OVERFLOW, self.lower)
        return stop


def _check_size(problem: Problem, pins: Sequence[NDArray[Any]]) -> None:
    """Raises InputError if one search for the cheapest trees of all nets would take too long."""
    gcells = problem.topology.gcells
    counts = [len(own) for own in pins]
    work = sum((3**count + 32 * 2**count) * gcells for count in counts)
    if work > MAX_WORK:
        raise InputError(
            "problem: too large to prove an optimum: expected at most "
            f"10^{math.log10(MAX_WORK):.1f} steps to find the cheapest trees once, found "
            f"10^{math.log10(work):.1f} for {len(pins)} nets with up to {max(counts)} pins on "
            f"{gcells} Gcells; use bound=relaxation to get a bound only"
        )
