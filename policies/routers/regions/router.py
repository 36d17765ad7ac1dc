"""The router, its options and what it reports."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import Problem, Solution
from marouting.config import MOST, check
from marouting.problem.grid import VIA_AXIS
from policies.engines import Call, Engine, EngineName, cores, opened
from policies.routers.base import small_problem
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter
from policies.routers.regions.cutting import (
    LEAST,
    Division,
    Piece,
    chip_edges,
    cut,
    figures,
    joined,
    size_of,
)

Stop = Literal["done", "asked", "small"]
"""Why a search ended: everything was negotiated; somebody asked it to stop; or the chip was so
small that it was routed in one piece."""

_PASSES = 6
"""Passes that every region makes in the first steps."""

_ENOUGH = 1.5
"""With less time than so many times that of the last step, the next step is the last one."""

_LEAST_FALL = 0.01
"""Share by which a step has to lower the overflow, or the next one has twice as many passes."""


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

    regions: int = 2
    seconds: float | None = 50.0
    seed: int = 0
    engine: EngineName = "local"

    def __post_init__(self) -> None:
        check("regions", 1 <= self.regions <= 1024, "a number from 1 to 1024")
        check("seconds", self.seconds is None or self.seconds >= 0, "a number from 0, or null")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")


class State(NamedTuple):
    """What a step goes on from.

    Attributes:
        solution: the routes.
        prices: (E,) what past overflow adds to the cost of every edge, in edges.
        present: factor by which one net too many raises the cost of an edge; 0: none so far.
    """

    solution: Solution
    prices: NDArray[np.float32]
    present: float


class Step(NamedTuple):
    """The state after a step."""

    kind: str  # patterns, calm or even after the lines, or one piece
    overflow: int  # in tracks
    wirelength: int  # in edges
    axis: str  # x if the lines parted columns, y if rows
    lines: tuple[int, ...]  # the columns or rows behind them
    processor_seconds: float  # of all tasks of the step
    longest_seconds: float  # of the longest one
    sent: int  # bytes of the problems of all tasks
    returned: int  # bytes of their routes


@dataclass(frozen=True)
class Routed:
    """A solution and how it was found.

    Attributes:
        solution: the solution.
        history: the steps, the patterns first.
        stop: why the search ended.
    """

    solution: Solution
    history: tuple[Step, ...]
    stop: Stop

    @property
    def report(self) -> dict[str, Any]:
        """Figures for tables beyond those of the evaluator."""
        spent = sum(step.processor_seconds for step in self.history)
        return {
            "stop": self.stop,
            "processor_seconds": round(spent, 3),
            "longest_seconds": round(sum(step.longest_seconds for step in self.history), 3),
            "sent_bytes": sum(step.sent for step in self.history),
            "returned_bytes": sum(step.returned for step in self.history),
            "steps": [step._asdict() | {"lines": list(step.lines)} for step in self.history],
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
        PathfinderRouter().warm_up(problem)

    def route(self, problem: Problem) -> Solution:
        """Routes a problem: a solution in which every net is joined."""
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Routed:
        """Routes a problem like :meth:`route` and tells how the solution was found."""
        options = self.options
        patterns = PathfinderOptions(passes=1, seconds=None, seed=options.seed)
        solution, step = self._in_one_piece(problem, "patterns", patterns)
        history = [step]
        axes = [axis for axis in range(VIA_AXIS) if problem.grid[axis] >= 2 * LEAST]
        if options.regions == 1 or not axes:
            whole = PathfinderOptions(seconds=options.seconds, seed=options.seed)
            solution, step = self._in_one_piece(problem, "one piece", whole)
            return Routed(solution, (*history, step), "small")
        state = State(solution, np.zeros(problem.topology.edges, np.float32), 0.0)
        rest = options.seconds
        passes, settled, calm = _PASSES, 0, True
        stop: Stop = "done"
        with opened(options.engine, min(options.regions, cores()), 1) as engine:
            # At calm lines every net can spread. Even lines keep all regions at work.
            while settled < len(axes) and (rest is None or rest > 0):
                last = history[-1]
                enough = _ENOUGH * last.processor_seconds
                if rest is not None and len(history) > 1 and rest < enough:
                    passes, calm = MOST, True  # this step takes what is left
                if calm:
                    division = Division.calm(state.solution, axes, options.regions)
                else:
                    axis = axes[len(history) // 2 % len(axes)]
                    division = Division.even(state.solution, axis, options.regions)
                kind, calm = "calm" if calm else "even", not calm
                seed = (options.seed + len(history) * options.regions) % MOST
                best = f"best: overflow {last.overflow}, wirelength {last.wirelength}"
                state, step, ended = self._negotiated(
                    engine, state, division, kind, passes, rest, seed, best
                )
                history.append(step)
                if ended is None:
                    stop = "asked"
                    break
                settled = settled + 1 if ended else 0
                if step.overflow >= last.overflow * (1 - _LEAST_FALL):
                    passes = min(2 * passes, MOST)
                if rest is not None:
                    rest -= step.processor_seconds
        return Routed(state.solution.pruned(), tuple(history), stop)

    def _in_one_piece(
        self, problem: Problem, kind: str, options: PathfinderOptions
    ) -> tuple[Solution, Step]:
        """Routes the whole chip in this process."""
        router = PathfinderRouter(options)
        router.watch = self.watch
        began = time.thread_time()
        solution = router.route(problem)
        spent = time.thread_time() - began
        return solution, Step(kind, *figures(solution), "", (), spent, spent, 0, 0)

    def _negotiated(
        self,
        engine: Engine,
        state: State,
        division: Division,
        kind: str,
        passes: int,
        seconds: float | None,
        seed: int,
        best: str,
    ) -> tuple[State, Step, bool | None]:
        """What comes of a step, and whether no region found better; None if asked to stop."""
        problem = state.solution.problem
        pieces = [
            cut(state.solution, state.prices, division, region)
            for region in range(len(division.work))
        ]
        regions = [region for region, (piece, _) in enumerate(pieces) if len(piece.pin)]
        calls = []
        for region in regions:
            share = division.work[region] / division.work[regions].sum()
            own = None if seconds is None else float(share * seconds)
            task = (pieces[region][0], state.present, passes, own, (seed + region) % MOST)
            calls.append(Call(negotiate, task))
        parts: dict[int, Part] = {}
        asked = False
        for found in engine.run(calls):
            parts |= {regions[number]: part for number, part in found.items()}
            line = f"{kind} lines, {len(parts)} of {len(calls)} regions; {best}"
            if self.watch is not None and self.watch(line):
                asked = True
                break
        prices, present = np.zeros_like(state.prices), state.present
        for region, (piece, _) in enumerate(pieces):
            box = division.box(region, problem.grid[division.axis])
            priced = parts.get(region, piece)
            edge = chip_edges(problem, box, priced.priced)
            prices[edge] = np.maximum(prices[edge], priced.price)
        routes = {
            region: (pieces[region][1][part.net], part.edge) for region, part in parts.items()
        }
        if parts:
            present = max(parts.values(), key=lambda part: part.overflow).present
        solution = joined(state.solution, division, routes)
        spent = [part.seconds for part in parts.values()]
        step = Step(
            kind,
            *figures(solution),
            "xy"[division.axis],
            division.lines,
            sum(spent),
            max(spent, default=0.0),
            size_of(pieces[region][0] for region in regions),
            size_of(parts.values()),
        )
        ended = all(part.ended for part in parts.values())
        return State(solution, prices, present), step, None if asked else ended


class Part(NamedTuple):
    """What comes back from a task.

    Attributes:
        net: (uses,) the net of every use of an edge.
        edge: (uses,) the edge.
        priced: (m,) edges with a price.
        price: (m,) theirs.
        present: factor for one net too many.
        overflow: of the region, in tracks.
        ended: whether nothing better was found any more, with passes and time left.
        seconds: processor seconds that it took.
    """

    net: NDArray[np.int32]
    edge: NDArray[np.int32]
    priced: NDArray[np.int32]
    price: NDArray[np.float32]
    present: float
    overflow: int
    ended: bool
    seconds: float


def negotiate(piece: Piece, present: float, passes: int, seconds: float | None, seed: int) -> Part:
    """A task: routes a piece.

    Args:
        piece: the problem.
        present: factor for one net too many, to go on from; 0 to begin.
        passes: how many passes over the nets, at most.
        seconds: limit of processor time; None for no limit.
        seed: seed of the random numbers.
    """
    _warm()
    began = time.thread_time()
    problem = piece.problem()
    now = Solution.of_uses(problem, piece.net.astype(np.int64), piece.edge.astype(np.int64))
    prices = np.zeros(problem.topology.edges)
    prices[piece.priced] = piece.price
    taken = np.zeros(problem.topology.edges, np.int64)
    taken[piece.shared] = piece.taken
    if seconds is not None:
        seconds = max(seconds - (time.thread_time() - began), 0.0)
    # The first pass puts in place what is there, and the factor grows behind it.
    options = PathfinderOptions(passes=min(passes + 1, MOST), seconds=seconds, seed=seed)
    present /= options.present_growth
    found = PathfinderRouter(options).solve(problem, now, prices, present, taken)
    net, edge = (part.astype(np.int32) for part in found.solution.uses)
    priced = np.flatnonzero(found.prices)
    price = found.prices[priced].astype(np.float32)
    overflow = min((each.overflow for each in found.history), default=0)
    ended = found.stop in ("optimal", "settled")
    spent = time.thread_time() - began
    return Part(net, edge, priced.astype(np.int32), price, found.present, overflow, ended, spent)


@functools.cache
def _warm() -> None:
    """Compiles once per process, so that the limit is that of routing."""
    PathfinderRouter().route(small_problem())
