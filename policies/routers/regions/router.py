"""The router, its options and what it reports."""

import functools
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import Problem, Solution
from marouting.config import MOST, check
from policies.engines import Call, Engine, EngineName, cores, opened
from policies.routers.base import small_problem
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter
from policies.routers.regions.cutting import (
    Box,
    Piece,
    chip_edges,
    cut,
    figures,
    joined,
    lines,
    work_inside,
)

Stop = Literal["done", "asked", "small"]
"""Why a search ended: everything was negotiated; somebody asked it to stop; or the chip was so
small that it was routed in one piece."""

_DONE: Stop = "done"

Kind = Literal["regions", "strips"]

_STEPS: tuple[tuple[Kind, float], ...] = (
    ("regions", 0.5),
    ("strips", 0.2),
    ("regions", 0.2),
    ("strips", 0.1),
)
"""What is negotiated one after another, with the share of the time."""

_WIDTH = 0.25
"""How far strips reach into each region beside their line, as a share of the region."""


@dataclass(frozen=True, kw_only=True)
class RegionsOptions:
    """Options of routing in regions.

    Attributes:
        regions: into how many regions the chip is cut, at most.
        seconds: limit of processor time of all negotiations together, in all processes; None: each
            goes on until it finds nothing better. Patterns, cutting and joining come on top.
        seed: seed of the random numbers.
        engine: who negotiates: ``local``, processes of this machine, or ``ray``, tasks of Ray.

    Raises:
        InputError: an option is out of range; the message names it and the range.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    regions: int = 2
    seconds: float | None = 50.0
    seed: int = 0
    engine: EngineName = "local"

    def __post_init__(self) -> None:
        check("regions", 1 <= self.regions <= 1024, "a number from 1 to 1024")
        check("seconds", self.seconds is None or self.seconds >= 0, "a number from 0, or null")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")


class Congestion(NamedTuple):
    """What negotiation goes on from, beside the routes.

    Attributes:
        prices: (E,) what past overflow adds to the cost of every edge, in edges.
        present: factor by which one net too many raises the cost of an edge; 0: none so far.
    """

    prices: NDArray[np.float32]
    present: float


class Step(NamedTuple):
    """The state after a step."""

    kind: str
    overflow: int  # in tracks
    wirelength: int  # in edges
    processor_seconds: float  # of all tasks of the step
    sent: int  # bytes of the problems of all tasks
    returned: int  # bytes of their routes


@dataclass(frozen=True)
class Routed:
    """A solution and how it was found.

    Attributes:
        solution: the solution.
        history: the steps, the patterns first.
        axis: of the wires that were cut, 0 for x.
        lines: the columns or rows behind the lines.
        stop: why the search ended.
    """

    solution: Solution
    history: tuple[Step, ...]
    axis: int
    lines: tuple[int, ...]
    stop: Stop

    @property
    def report(self) -> dict[str, Any]:
        """Figures for tables beyond those of the evaluator."""
        spent = sum(step.processor_seconds for step in self.history)
        return {
            "stop": self.stop,
            "axis": "xy"[self.axis],
            "lines": list(self.lines),
            "processor_seconds": round(spent, 3),
            "sent_bytes": sum(step.sent for step in self.history),
            "returned_bytes": sum(step.returned for step in self.history),
            "steps": [dict(step._asdict()) for step in self.history],
        }


class RegionsRouter:
    """Negotiated congestion in regions, see :mod:`policies.routers.regions`.

    Args:
        options: the options; None for the defaults.

    Attributes:
        options: the options.
        watch: is called about every second; see :class:`policies.routers.base.Watched`.
    """

    Options = RegionsOptions

    def __init__(self, options: RegionsOptions | None = None) -> None:
        self.options = RegionsOptions() if options is None else options
        self.watch: Callable[[str], bool] | None = None

    def warm_up(self, problem: Problem) -> None:
        """Gets ready what is done in this process."""
        PathfinderRouter().route(problem)

    def route(self, problem: Problem) -> Solution:
        """Routes a problem: a solution in which every net is joined."""
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Routed:
        """Routes a problem like :meth:`route` and tells how the solution was found."""
        options = self.options
        began = time.thread_time()
        patterns = PathfinderOptions(passes=1, seconds=None, seed=options.seed)
        solution = PathfinderRouter(patterns).route(problem)
        first = Step("patterns", *figures(solution), time.thread_time() - began, 0, 0)
        axis, at = lines(solution, options.regions)
        if not at:
            whole = PathfinderRouter(PathfinderOptions(seconds=options.seconds, seed=options.seed))
            whole.watch = self.watch
            began = time.thread_time()
            solution = whole.route(problem)
            spent = time.thread_time() - began
            last = Step("one piece", *figures(solution), spent, 0, 0)
            return Routed(solution, (first, last), axis, (), "small")
        history, stop = [first], _DONE
        congestion = Congestion(np.zeros(problem.topology.edges, np.float32), 0.0)
        with opened(options.engine, min(len(at) + 1, cores()), 1) as engine:
            for number, (kind, share) in enumerate(_STEPS):
                seconds = None if options.seconds is None else share * options.seconds
                boxes = _boxes(kind, axis, at, problem.grid[axis])
                seed = (options.seed + number * options.regions) % MOST
                solution, congestion, step, asked = self._negotiated(
                    engine, solution, congestion, kind, boxes, seconds, seed
                )
                history.append(step)
                if asked:
                    stop = "asked"
                    break
        return Routed(solution.pruned(), tuple(history), axis, tuple(at), stop)

    def _negotiated(
        self,
        engine: Engine,
        solution: Solution,
        congestion: Congestion,
        kind: Kind,
        boxes: Sequence[Box],
        seconds: float | None,
        seed: int,
    ) -> tuple[Solution, Congestion, Step, bool]:
        """A step: what is there after it, what it took, and whether somebody asked to stop."""
        pieces = [cut(solution, congestion.prices, box) for box in boxes]
        parts = [number for number, (piece, _) in enumerate(pieces) if len(piece.pin)]
        work = work_inside(solution, boxes)
        calls = []
        for number in parts:
            own = None if seconds is None else seconds * work[number] / work[parts].sum()
            task = (pieces[number][0], congestion.present, own, (seed + number) % MOST)
            calls.append(Call(negotiate, task))
        spent, returned, done, asked = 0.0, 0, 0, False
        best, prices, present = figures(solution), congestion.prices.copy(), congestion.present
        hardest = work[parts].argmax() if parts else 0
        for found in engine.run(calls):
            for number, part in found.items():
                box, (piece, nets) = boxes[parts[number]], pieces[parts[number]]
                other = joined(solution, box, nets[part.net], part.edge)
                if (new := figures(other)) <= best:
                    solution, best = other, new
                prices[chip_edges(solution.problem, box, piece.priced)] = 0
                prices[chip_edges(solution.problem, box, part.priced)] = part.price
                if number == hardest:
                    present = part.present
                spent, returned, done = spent + part.seconds, returned + part.size, done + 1
            line = f"{kind}, {done} of {len(calls)}; best: overflow {best[0]}, wirelength {best[1]}"
            if self.watch is not None and self.watch(line):
                asked = True
                break
        sent = sum(pieces[number][0].size for number in parts)
        return (
            solution,
            Congestion(prices, present),
            Step(kind, *best, spent, sent, returned),
            asked,
        )


class Part(NamedTuple):
    """What comes back from a task.

    Attributes:
        net: (uses,) the net of every use of an edge.
        edge: (uses,) the edge.
        priced: (m,) edges with a price.
        price: (m,) theirs.
        present: factor for one net too many.
        seconds: processor seconds that it took.
    """

    net: NDArray[np.int32]
    edge: NDArray[np.int32]
    priced: NDArray[np.int32]
    price: NDArray[np.float32]
    present: float
    seconds: float

    @property
    def size(self) -> int:
        """The bytes of its arrays."""
        return sum(part.nbytes for part in self if isinstance(part, np.ndarray))


def negotiate(piece: Piece, present: float, seconds: float | None, seed: int) -> Part:
    """A task: routes a piece.

    Args:
        piece: the problem.
        present: factor for one net too many, to go on from; 0 to begin.
        seconds: limit of processor time; None for no limit.
        seed: seed of the random numbers.
    """
    _warm()
    began = time.thread_time()
    options = PathfinderOptions(seconds=seconds, seed=seed)
    problem = piece.problem()
    now = Solution.of_uses(problem, piece.net.astype(np.int64), piece.edge.astype(np.int64))
    prices = np.zeros(problem.topology.edges)
    prices[piece.priced] = piece.price
    found = PathfinderRouter(options).solve(problem, now, prices, present)
    net, edge = (part.astype(np.int32) for part in found.solution.uses)
    priced = np.flatnonzero(found.prices)
    price = found.prices[priced].astype(np.float32)
    spent = time.thread_time() - began
    return Part(net, edge, priced.astype(np.int32), price, found.present, spent)


@functools.cache
def _warm() -> None:
    """Compiles once per process, so that the limit is that of routing."""
    PathfinderRouter().route(small_problem())


def _boxes(kind: Kind, axis: int, at: Sequence[int], size: int) -> list[Box]:
    """The regions between lines, or the strips along them."""
    ends = (0, *at, size)
    if kind == "regions":
        return [Box(axis, low, high) for low, high in itertools.pairwise(ends)]
    reach = [round(_WIDTH * (high - low)) for low, high in itertools.pairwise(ends)]
    return [
        Box(axis, line - before, line + behind)
        for line, before, behind in zip(at, reach[:-1], reach[1:], strict=True)
    ]
