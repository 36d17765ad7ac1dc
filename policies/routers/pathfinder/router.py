"""The router, and what it reports."""

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from marouting import Problem, Solution
from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.passes import advance
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DONE,
    FIRST_BOX,
    KINDS,
    PAUSED,
    POOL_TOO_SMALL,
    UNIT,
    Kind,
    make_arrays,
    make_buffers,
    make_parameters,
    with_larger_pool,
)
from policies.routers.pathfinder.trees import keep_best


class Pass(NamedTuple):
    """The state after a pass over the nets."""

    kind: Kind
    overflow: int  # in tracks
    wirelength: float  # in edges, vias weighted by ``via_weight``
    routed: int  # nets rerouted in this pass


@dataclass(frozen=True)
class Routed:
    """A solution and how it was found.

    Attributes:
        solution: the solution with the least overflow after any pass, and among those the least
            wirelength, vias weighted by ``via_weight``. More time gives no worse one with the same
            seed.
        iterations: number of passes over the nets.
        seconds: time taken.
        history: every pass, in order.
    """

    solution: Solution
    iterations: int
    seconds: float
    history: tuple[Pass, ...]

    @property
    def report(self) -> dict[str, Any]:
        """Figures for tables beyond those of the evaluator: ``iterations``."""
        return {"iterations": self.iterations}


class PathfinderRouter:
    """Negotiated congestion over Steiner trees, in all layers at once.

    After McMurchie and Ebeling, "PathFinder: a negotiation-based performance-driven router for
    FPGAs", FPGA 1995; see :mod:`policies.routers.pathfinder`.

    Args:
        options: the options; None for the defaults.

    Attributes:
        options: the options.
    """

    Options = PathfinderOptions

    def __init__(self, options: PathfinderOptions | None = None) -> None:
        self.options = PathfinderOptions() if options is None else options

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution in which every net is joined. It has overflow only where the router found
            no solution without.
        """
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Routed:
        """Routes a problem like :meth:`route` and tells how the solution was found."""
        began, worked = time.perf_counter(), time.thread_time()
        limit = self.options.seconds
        parameters = make_parameters(self.options)
        arrays, routing = make_arrays(problem, self.options)
        exact_pins = self.options.exact_pins
        buffers = make_buffers(arrays, exact_pins, min(FIRST_BOX, problem.topology.gcells))
        passes: list[Pass] = []
        code = PAUSED if len(routing.order) else DONE
        progress = routing.progress[0]
        while code != DONE:
            code = advance(arrays, parameters, routing, *buffers)
            for kind, overflow, length, routed in routing.history[: progress["history"]].tolist():
                passes.append(Pass(KINDS[kind], overflow, length / UNIT, routed))
            progress["history"] = 0
            if code == BOX_TOO_SMALL:
                buffers = make_buffers(arrays, exact_pins, 2 * int(progress["need"]))
            elif code == POOL_TOO_SMALL:
                routing = with_larger_pool(routing, 2 * int(progress["need"]))
            if limit is not None and passes and time.thread_time() - worked >= limit:
                # These passes never make a solution worse. What others have found in mid-pass could
                # be lost with more time, and more time must not be worse than less.
                if KINDS[progress["kind"]] in ("squeeze", "repair"):
                    keep_best(routing)
                break
        net = np.repeat(np.arange(len(problem.nets)), np.diff(routing.best_first))
        solution = Solution.of_uses(problem, net, routing.best[: len(net)].astype(np.int64))
        return Routed(solution, len(passes), time.perf_counter() - began, tuple(passes))
