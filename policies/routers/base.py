"""The interfaces of routers."""

import contextlib
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from marouting import InputError, Problem, Solution, generate

LEFT_ALONE = "left alone"
"""The name of threads that may be at work in a library when the process ends; it must not wait for
them, nor take apart what they use."""


class Router(Protocol):
    """Routes whole problems.

    This method is all that a router needs to be used by its registered name or as ``module:Class``.
    Its options are the fields of the class if it is a dataclass, those of its nested dataclass
    ``Options`` if it has one, and the keyword arguments of its constructor otherwise. An experiment
    runs a router with an option ``seed`` once for each seed, unless its options have an attribute
    ``seeded`` that is false.
    """

    def route(self, problem: Problem) -> Solution:
        """A solution of the problem, in which nets that could not be joined stay open."""
        ...


class Routed(Protocol):
    """A solution and the router's report on it."""

    @property
    def solution(self) -> Solution:
        """The solution."""
        ...

    @property
    def report(self) -> dict[str, Any]:
        """Figures by name that cannot be seen from the solution, as plain data for JSON.

        ``status`` is among them if the router proves something: ``optimal`` if the solution is.
        """
        ...


@runtime_checkable
class Reporter(Router, Protocol):
    """A router that reports more than the solution."""

    def solve(self, problem: Problem) -> Routed:
        """The solution of :meth:`route` with a report."""
        ...


@runtime_checkable
class Watched(Router, Protocol):
    """A router that tells how far it is, and that can be asked to stop.

    Attributes:
        watch: None, or a function that the router calls some times a second, with a line that tells
            how far it is. If it returns True, the router ends with the best solution so far.
    """

    watch: Callable[[str], bool] | None


@runtime_checkable
class Keeper(Watched, Protocol):
    """A watched router that can give the best solution so far."""

    def best(self) -> Solution | None:
        """The best solution so far, to be called by ``watch``; None if there is none yet."""
        ...


def warm_up(router: Router) -> None:
    """Routes a small problem, so that the router has compiled and loaded what it needs.

    A learner without a checkpoint trains for two short episodes. An ``InputError`` is ignored, and
    the router's ``watch`` is not called.
    """
    small = generate(1, (4, 4, 2), nets=8, max_pins=3, capacity=1, reduced_edges=0)[0]
    with contextlib.ExitStack() as stack:
        if isinstance(router, Watched):
            stack.callback(setattr, router, "watch", router.watch)
            router.watch = None
        stack.enter_context(contextlib.suppress(InputError))
        # For ``--prune``: nobody has a pin at both ends of edge 0, so there is something to remove.
        Solution(small, [np.zeros(1, np.int64)] * len(small.nets)).pruned()
        getattr(router, "warm_up", router.route)(small)


def solve(router: Router, problem: Problem) -> tuple[Solution, dict[str, Any]]:
    """A router's solution and its report, which is empty if the router makes none.

    A problem with nothing to route has an empty solution, the optimum, whatever the router.
    """
    if not problem.to_route.any():
        none = np.zeros(0, np.int64)
        return Solution.of_uses(problem, none, none), {"status": "optimal"}
    routed = router.solve(problem) if isinstance(router, Reporter) else None
    solution: Any = router.route(problem) if routed is None else routed.solution
    if not isinstance(solution, Solution):
        name = f"{type(router).__module__}:{type(router).__name__}"
        raise InputError(f"{name}: expected a marouting.Solution from route, found {solution!r}")
    if solution.problem is not problem and solution.problem != problem:
        name = f"{type(router).__module__}:{type(router).__name__}"
        raise InputError(f"{name}: expected a solution of the problem given, found one of another")
    return solution, {} if routed is None else routed.report
