"""The proven optimum: the least overflow, and with it the least wirelength, with a proof.

To route a problem is to choose a tree for every net. Three steps meet from either side:

1. **Prices.** A linear program may mix the trees of a net; its dual values are prices of capacity.
   With prices every net has a cheapest tree of its own (:mod:`policies.routers.priced_tree`): what
   these cost, less the price of all capacity, no solution can undercut (Lagrange). The trees join
   the linear program, which finds better prices, until the two agree: column generation
   (Dantzig and Wolfe, "Decomposition principle for linear programs", Operations Research 8, 1960).
   Prices are rounded to whole numbers, and the bound is worked out in these alone: it holds
   whatever the solver's tolerances are. It is that of the linear relaxation of step 3.
2. **Choice.** An integer program chooses one of the trees found for each net. On most problems its
   solution is as good as the bound: then it is optimal.
3. **Flows.** Otherwise the edges that matter are found: those for which the bound of all solutions
   that use them is low enough. (The others are proven to be of no use.) The cheapest tree across
   each of them is added to the choice; and if that does not do, an integer program over these
   edges decides, with a flow from a net's first pin to each of its other pins (Wong, "A dual
   ascent approach for Steiner tree problems on a directed graph", Mathematical Programming 28,
   1984). Here alone a proof rests on the solver's own: its bound counts less SLIP.

Overflow is minimised first, by the same steps. The solver is HiGHS, as it comes with scipy.

The trees to begin with are those of sequential A* and of negotiated congestion
(:mod:`policies.routers.pathfinder`), whose solution is near the optimum, or is it: what has no
overflow leaves none to be disproved, and the linear program has trees that get on with one another.
"""

import math
import operator
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.optimize import Bounds, LinearConstraint
from scipy.sparse import block_diag, coo_array, csr_array, eye_array, vstack

from marouting import InputError, Problem, Solution, evaluate, sequential_astar
from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter
from policies.routers.priced_tree import NEVER, Across, Window, cheapest_priced_tree

# What scipy's stubs take is narrower than what these do.
hstack: Any = sparse.hstack
linprog: Any = optimize.linprog
milp: Any = optimize.milp

UNIT = 1 << 20
"""Prices and bounds are whole multiples of this part of an edge's length."""

EXCESS = 128.0
"""What the linear program pays, in wirelength, for overflow beyond what is allowed: enough to find
trees that need none, little enough to keep prices apart."""

MAX_WORK = 2**36
"""The largest problem accepted, in steps of the search for the cheapest trees of all nets."""

MOST_PINS = 9
"""Pins of a net that count in a relaxation's bound, so that it takes problems of any size."""

MAX_COLUMNS = 4_000_000
"""The largest integer program of step 3, in variables."""

HEAD_START = 0.1
"""The part of the time that negotiated congestion has to find a first solution, at most."""

SLIP = 0.01
"""By how much the solver's bound of an integer program may be wrong: far more than its tolerances
come to, little enough to be rounded up."""

Bound = Literal["optimum", "relaxation"]
Status = Literal["optimal", "relaxation", "time limit", "solver limit"]
Pair = tuple[int, int]


@dataclass(frozen=True)
class Optimum:
    """What is known of a problem's best solution.

    Attributes:
        solution: the best one found; every net is joined.
        overflow: its overflow.
        wirelength: its wirelength.
        bound_overflow: no solution has less overflow.
        bound_wirelength: no solution with that overflow has less wirelength.
        seconds: how long it took.
        status: ``optimal`` if bound and solution agree; otherwise what ended the search:
            ``relaxation``, no more was asked for, ``time limit``, or ``solver limit``, an integer
            program too large to be solved or with numbers too large for the solver's tolerances.
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
        """By what part of it the wirelength may be too long; infinite if the overflow may be."""
        if self.overflow > self.bound_overflow:
            return math.inf
        return (self.wirelength - self.bound_wirelength) / max(self.wirelength, 1)

    @property
    def report(self) -> dict[str, Any]:
        """What there is to say beside the solution's figures; an infinite gap is None."""
        return {
            "bound_overflow": self.bound_overflow,
            "bound_wirelength": self.bound_wirelength,
            "gap": self.gap if self.gap < math.inf else None,
            "status": self.status,
        }


@dataclass(frozen=True)
class OptimalRouter:
    """Routes with the least overflow and then the least wirelength, as far as time allows.

    Attributes:
        time_limit: seconds after which the best solution so far is taken; None: no limit. With 0
            it is that of sequential A*, and the bound the sum of the nets' shortest trees. Only
            negotiated congestion, after a tenth of it, and the solver are broken off.
        bound: ``optimum``, what is proven is the optimum; ``relaxation``, only what prices prove,
            with the best choice of the trees found: for problems too large for more. Nets with more
            than MOST_PINS pins count in it with so many of them, spread out.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    name: ClassVar[str] = "optimal"
    time_limit: float | None = None
    bound: Bound = "optimum"

    def __post_init__(self) -> None:
        if self.time_limit is not None and not self.time_limit >= 0:
            raise InputError(f"time_limit: expected seconds from 0, found {self.time_limit}")

    def route(self, problem: Problem) -> Solution:
        """The solution of :meth:`solve`."""
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Optimum:
        """The best solution and what is proven of it.

        Raises:
            InputError: the problem is too large; the message says by what.
            RuntimeError: the evaluator disagrees with the solver (a fault in one of them).
        """
        started = time.monotonic()
        limit = math.inf if self.time_limit is None else self.time_limit
        search = _Search(problem, started + limit, self.bound)
        status = search.run()
        solution = search.solution()
        figures = evaluate(problem, solution)
        found = (figures.overflow, figures.wirelength)
        if not figures.connected or found != search.best or found < search.lower:
            raise RuntimeError(f"claimed {search.best} from {search.lower}, found {figures}")
        seconds = time.monotonic() - started
        return Optimum(solution, *search.best, *search.lower, seconds, status)


class _Aim(NamedTuple):
    """What is minimised: overflow, or the wirelength of solutions with no more than so much."""

    wirelength: bool
    overflow: int


OVERFLOW = _Aim(wirelength=False, overflow=0)


class _Proof(NamedTuple):
    """A lower bound, and what proves it."""

    bound: float  # in UNITs, a whole number, or infinite where nothing can be routed
    dual: NDArray[np.int64]  # (W,) price of a track of every edge, in UNITs
    least: list[int]  # what the cheapest tree of each net costs, in UNITs


class _Columns(NamedTuple):
    """What a program chooses from: columns x with ``equal @ x == right``, ``below @ x <= limit``.

    C columns, W edges with a capacity.
    """

    length: NDArray[np.float64]  # (C,) wirelength of a column
    tracks: csr_array  # (W, C) what it takes of every capacity
    whole: NDArray[np.float64]  # (C,) 1 where it is chosen whole or not at all, or 0
    equal: csr_array
    right: NDArray[np.float64]
    below: csr_array
    limit: NDArray[np.float64]


class _Search:
    """Bounds from below, and trees and the best choice among them from above.

    Nets are numbered among those with something to route, edges among those with a capacity.

    Args:
        problem: what is routed.
        deadline: when time is up, by the monotonic clock.
        asked: what is to be proven. For a relaxation not all pins of a net count: that takes no
            more than joining all of them.
    """

    def __init__(self, problem: Problem, deadline: float, asked: Bound) -> None:
        grid = problem.topology
        self.problem = problem
        self.deadline = deadline
        self.asked = asked
        self.nets = [n for n, gcells in enumerate(problem.pin_gcells) if len(gcells) > 1]
        self.pins = [problem.pin_gcells[n] for n in self.nets]
        if asked == "optimum":
            self.check_size()
        else:
            self.pins = [_spread_out(problem.grid, pins, MOST_PINS) for pins in self.pins]
        edges = np.flatnonzero(grid.exists)
        self.wires = edges[edges % AXES != VIA_AXIS]
        self.row = np.full(grid.edges, -1)
        self.row[self.wires] = np.arange(len(self.wires))
        self.capacity = problem.capacity[self.wires].astype(np.int64)
        kinds, kind = np.unique(problem.net_demand[self.nets], axis=0, return_inverse=True)
        self.kind = kind.reshape(-1)
        self.demand = kinds[:, self.wires // AXES % problem.grid[2]].astype(np.int64)  # (kinds, W)

        self.trees: list[tuple[int, NDArray[np.int64]]] = []  # net and edges of every tree found
        self.known: set[tuple[int, bytes]] = set()
        self.proofs: dict[_Aim, _Proof] = {}
        self.settled: set[_Aim] = set()  # aims that no further prices help
        self.plain: dict[_Aim, list[int]] = {}  # see window()
        self.chosen: set[_Aim] = set()  # aims that step 2 has been through
        self.reach: dict[_Aim, int] = defaultdict(int)  # how far beyond the bound step 3 looks
        self.lower: Pair = (0, 0)
        self.best: Pair = (np.iinfo(np.int64).max, 0)
        self.routes: list[NDArray[np.int64]] = []
        self.learn_from(sequential_astar(problem))
        if not self.late():
            self.learn_from(self.negotiated())

    def check_size(self) -> None:
        """Raises InputError if finding the cheapest trees of all nets once would take too long."""
        gcells = self.problem.topology.gcells
        pins = [len(pins) for pins in self.pins]
        work = sum((3**n + 32 * 2**n) * gcells for n in pins)
        if work > MAX_WORK:
            raise InputError(
                "problem: too large to prove an optimum: expected at most "
                f"10^{math.log10(MAX_WORK):.1f} steps to find the cheapest trees once, found "
                f"10^{math.log10(work):.1f} for {len(pins)} nets with up to {max(pins)} pins on "
                f"{gcells} Gcells; for a bound ask for bound=relaxation"
            )

    def run(self) -> Status:
        """Searches until bound and solution agree or something ends it; says what."""
        ended: Status | None = None
        while ended is None and self.lower < self.best:
            ended = self.advance()
        return "optimal" if ended is None or self.lower == self.best else ended

    def advance(self) -> Status | None:
        """Takes the next step, as far as it goes; returns what keeps the search from going on."""
        overflow = self.lower[0]
        found = self.best[0] == overflow
        if not found and (least := self.relax(OVERFLOW)) > overflow:
            self.lower = (int(least), 0)
            return None
        aim = _Aim(wirelength=True, overflow=overflow)
        least = self.relax(aim)
        if least == math.inf:  # a net has no way, nor with a little more overflow
            beyond = self.demand - self.capacity
            self.lower = (int(beyond[beyond > overflow].min()), 0)
        else:
            self.lower = max(self.lower, (overflow, int(least)))
        if self.late():
            return "time limit"
        if least == math.inf or self.lower >= self.best:
            return None
        if aim not in self.chosen:
            self.chosen.add(aim)
            self.choose(aim)
            return None
        if self.asked == "relaxation":
            return "relaxation"
        return self.decide(aim if found else OVERFLOW)

    def late(self) -> bool:
        """Whether time is up."""
        return time.monotonic() >= self.deadline

    def solution(self) -> Solution:
        """The best solution."""
        edges = [np.empty(0, np.int64)] * len(self.problem.nets)
        for n, route in zip(self.nets, self.routes, strict=True):
            edges[n] = route
        return Solution(self.problem, tuple(edges))

    # Trees and solutions

    def add(self, net: int, tree: NDArray[np.int64]) -> bool:
        """Keeps a tree (its edges, ascending) to choose from; returns whether it is new."""
        key = (net, tree.tobytes())
        new = key not in self.known
        if new:
            self.known.add(key)
            self.trees.append((net, tree))
        return new

    def take(self, routes: Sequence[NDArray[np.int64]]) -> None:
        """Keeps the trees of a solution, and the solution if it is the best."""
        used = np.zeros(len(self.wires), np.int64)
        for net, route in enumerate(routes):
            self.add(net, route)
            rows = self.row[route[route % AXES != VIA_AXIS]]
            used[rows] += self.demand[self.kind[net], rows]
        overflow = int(np.maximum(used - self.capacity, 0).sum())
        found = (overflow, sum(map(len, routes)))
        if found < self.best:
            self.best, self.routes = found, list(routes)

    def learn_from(self, solution: Solution) -> None:
        """Takes a solution of another router, as short as its routes allow."""
        self.take([self.prune(net, solution.edges[n]) for net, n in enumerate(self.nets)])

    def negotiated(self) -> Solution:
        """A solution by negotiated congestion: mostly near the optimum, and soon there."""
        left = HEAD_START * (self.deadline - time.monotonic())
        options = PathfinderOptions()
        if options.seconds is None or left < options.seconds:
            options = replace(options, seconds=max(left, 0.0))
        return PathfinderRouter(options).route(self.problem)

    def prune(self, net: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
        """The shortest tree of a net within a route; all of it if not all pins count."""
        if not self.complete(net):
            return edges
        grid, pins = self.problem.grid, self.pins[net]
        price = np.full((*grid, AXES), NEVER)
        price.reshape(-1)[edges] = 1
        window = Window.around(grid, np.concatenate(self.problem.topology.ends(edges)), 0)
        return window.outside(cheapest_priced_tree(window.cut(price), window.inside(pins))[1])

    def complete(self, net: int) -> bool:
        """Whether all pins of a net count."""
        return len(self.pins[net]) == len(self.problem.pin_gcells[self.nets[net]])

    def flat(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The net and the length of every tree, and the edges of all, one tree after the other."""
        net = np.array([net for net, _ in self.trees])
        length = np.array([len(tree) for _, tree in self.trees])
        return net, length, np.concatenate([tree for _, tree in self.trees])

    # Step 1: prices

    def price(self, aim: _Aim, dual: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
        """What every edge costs each kind of net (kinds, X, Y, Z, 3), and what a UNIT is there.

        Overflow alone costs nothing where there is room: there the shorter of equal trees is
        taken, by a price too low to tell in UNITs.
        """
        grid = self.problem.topology
        length, unit = (UNIT, 1) if aim.wirelength else (1, grid.gcells)
        most = NEVER // (4 * unit * grid.gcells)
        price = np.where(grid.exists, length, NEVER) + np.zeros((len(self.demand), 1), np.int64)
        # A price too high to be added up may be lowered: the bound stays one.
        price[:, self.wires] += unit * self.demand * np.minimum(dual, most // self.demand.clip(1))
        if aim.wirelength:
            kind, wire = np.nonzero(self.demand - self.capacity > aim.overflow)
            price[kind, self.wires[wire]] = NEVER
        return price.reshape(-1, *self.problem.grid, AXES), unit

    def bid(self, aim: _Aim, dual: NDArray[np.int64]) -> bool:
        """Finds the cheapest trees at prices, and their bound; returns whether any tree is new."""
        if not aim.wirelength:
            dual = np.minimum(dual, UNIT)  # overflow is there for this price
        price, unit = self.price(aim, dual)
        net, length, edge = self.flat()
        known = price.reshape(len(price), -1)[np.repeat(self.kind[net], length), edge]
        most = np.full(len(self.pins), np.inf)
        starts = np.cumsum(length) - length
        np.minimum.at(most, net, np.add.reduceat(known.astype(float), starts) / unit)
        bound = -int(dual @ self.capacity) - aim.overflow * int(dual.max(initial=0))
        least, new = [], False
        for i, pins in enumerate(self.pins):
            window = self.window(aim, i, most[i])
            cost, tree = cheapest_priced_tree(window.cut(price[self.kind[i]]), window.inside(pins))
            if cost >= NEVER:
                self.proofs[aim] = _Proof(math.inf, dual, [])
                return False
            least.append(cost // unit)
            if self.complete(i):
                new |= self.add(i, window.outside(tree))
        bound += sum(least)
        if aim not in self.proofs or bound > self.proofs[aim].bound:
            self.proofs[aim] = _Proof(bound, dual, least)
        return new

    def window(self, aim: _Aim, net: int, most: float) -> Window:
        """Where a net's trees lie that cost at most so much, in UNITs.

        A tree that leaves the box around its pins does so there and back. Flattened against the
        side of the box it stays a tree, in a grid that is the same everywhere: so it is longer
        than the shortest one in that grid and that box, by twice as far as it goes.
        """
        pins = self.pins[net]
        if not aim.wirelength:
            return Window(self.problem.grid, (0, 0), self.problem.grid[:2])
        if aim not in self.plain:
            price, _ = self.price(aim, np.zeros(len(self.wires), np.int64))
            price = np.where((price < NEVER).any(axis=(1, 2), keepdims=True), UNIT, NEVER)
            exists = self.problem.topology.exists.reshape(*self.problem.grid, AXES)
            price = np.where(exists, price, NEVER)
            boxes = [Window.around(self.problem.grid, pins, 0) for pins in self.pins]
            self.plain[aim] = [
                cheapest_priced_tree(box.cut(price[kind]), box.inside(pins))[0]
                for box, kind, pins in zip(boxes, self.kind, self.pins, strict=True)
            ]
        margin = min((most - self.plain[aim][net]) // (2 * UNIT), max(self.problem.grid))
        return Window.around(self.problem.grid, pins, int(max(margin, 0)))

    def relax(self, aim: _Aim) -> float:
        """Raises the bound of an aim as far as prices can; returns it, rounded up."""
        if aim not in self.proofs:
            self.bid(aim, np.zeros(len(self.wires), np.int64))
        while aim not in self.settled and self.bound(aim) < self.reached(aim) and not self.late():
            mixed = self.mix(aim)
            # Nothing is proven by the value of the mixture: it tells when to stop.
            if (
                mixed is None
                or self.bound(aim) >= math.ceil(mixed[0] - 1e-6)
                or not self.bid(aim, mixed[1])
            ):
                self.settled.add(aim)
        return self.bound(aim)

    def bound(self, aim: _Aim) -> float:
        """The bound of an aim in whole edges or tracks."""
        bound = self.proofs[aim].bound
        return bound if bound == math.inf else -(-bound // UNIT)

    def reached(self, aim: _Aim) -> float:
        """What the best solution has of an aim; infinite if it does not keep to its overflow."""
        if not aim.wirelength:
            return self.best[0]
        return self.best[1] if self.best[0] <= aim.overflow else math.inf

    def mix(self, aim: _Aim) -> tuple[float, NDArray[np.int64]] | None:
        """The best mixture of trees: its value and the prices (W,); None if the solver has none."""
        columns = self.choices()
        cost, _, below, limit = self.program(columns, aim, EXCESS if aim.wirelength else 1)
        result = linprog(
            cost,
            A_ub=below,
            b_ub=limit,
            A_eq=_widened(columns.equal, len(cost)),
            b_eq=columns.right,
            options=self.options(),
        )
        if result.status != 0:
            return None
        marginals = result.ineqlin.marginals[: len(self.wires)]
        return result.fun, np.rint(-marginals * UNIT).astype(np.int64).clip(0)

    # Step 2: choice

    def choices(self) -> _Columns:
        """A column for every tree; each net takes one."""
        net, length, edge = self.flat()
        column = np.repeat(np.arange(len(net)), length)
        wire = edge % AXES != VIA_AXIS
        row, column = self.row[edge[wire]], column[wire]
        taken = self.demand[self.kind[net[column]], row]
        return _Columns(
            length=length.astype(float),
            tracks=_sparse(taken, row, column, len(self.wires), len(net)),
            whole=np.ones(len(net)),
            equal=_sparse(np.ones(len(net)), net, np.arange(len(net)), len(self.nets), len(net)),
            right=np.ones(len(self.nets)),
            below=csr_array((0, len(net))),
            limit=np.empty(0),
        )

    def choose(self, aim: _Aim) -> None:
        """Chooses trees: least overflow beyond the aim's first, then least length.

        Only as far as the solver gets without branching: what is hard is left to step 3.
        """
        columns = self.choices()
        longest = np.zeros(len(self.nets))
        np.maximum.at(longest, [net for net, _ in self.trees], columns.length)
        result = self.solve(columns, aim, 1 + longest.sum(), node_limit=1)
        if result.x is not None:
            chosen = (self.trees[i] for i in np.flatnonzero(result.x[: len(self.trees)] > 0.5))
            self.take([tree for _, tree in sorted(chosen, key=operator.itemgetter(0))])

    # Step 3: flows

    def decide(self, aim: _Aim) -> Status | None:
        """Finds the best solution of an aim, if it is little above the bound, or raises the bound.

        Returns:
            What keeps the search from going on.
        """
        known = self.lower, self.best
        bound, most = self.lower[aim.wirelength], self.best[aim.wirelength] - 1
        target = min(bound + self.reach[aim], most)
        self.reach[aim] = 2 * self.reach[aim] + 1
        edges = self.useful(aim, target)
        self.choose(aim)
        if self.late():
            return "time limit"
        if self.best[aim.wirelength] == bound:
            return None
        size = [2 * len(own) * _flows(pins) for own, pins in zip(edges, self.pins, strict=True)]
        if sum(size) > MAX_COLUMNS:
            return "solver limit"
        result = self.solve(self.arcs(edges), aim, None if aim.wirelength else 1)
        if result.x is not None:
            first = np.cumsum(size) - size
            arcs = [result.x[a : a + 2 * len(own)] for a, own in zip(first, edges, strict=True)]
            used = [(arc.reshape(2, -1) > 0.5).any(axis=0) for arc in arcs]
            self.take([self.prune(net, own[used[net]]) for net, own in enumerate(edges)])
        # Whatever is within the target keeps to the useful edges.
        least = target + 1 if result.status == 2 else result.mip_dual_bound
        if least is not None and least - SLIP > bound:
            proven = math.ceil(min(least, target + 1) - SLIP)
            self.lower = (aim.overflow, proven) if aim.wirelength else (proven, 0)
        if result.status == 1:
            return "time limit"
        stuck = target == most and known == (self.lower, self.best)
        return "solver limit" if stuck else None

    def useful(self, aim: _Aim, target: int) -> list[NDArray[np.int64]]:
        """The edges of each net that solutions of an aim within a target can use.

        Those of the first nets alone, if time is up. Where the target is the bound, the cheapest
        trees across these edges are added.
        """
        edges = []
        proof = self.proofs[aim]
        price, unit = self.price(aim, proof.dual)
        for i, pins in enumerate(self.pins):
            if self.late():
                break
            most = proof.least[i] + target * UNIT - proof.bound
            window = self.window(aim, i, most)
            across = Across(window.cut(price[self.kind[i]]), window.inside(pins))
            low = np.flatnonzero(across.cost // unit <= most)
            edges.append(window.outside(low))
            if target == self.lower[aim.wirelength]:
                for edge in low:
                    self.add(i, self.prune(i, window.outside(across.tree(int(edge)))))
        return edges

    def arcs(self, useful: Sequence[NDArray[np.int64]]) -> _Columns:
        """A column for either direction of every edge of a net, and for the flows along it.

        The columns of a net are those of its edges, forward, then backward, and after them, if it
        has more than two pins, as many for the flow to each pin but the first. A net's route
        contains the way of every flow; that of a net with two pins is one.
        """
        first = 0
        length, right, equal, below, limit, tracks = [], [], [], [], [np.empty(0)], []
        for i, (edges, pins) in enumerate(zip(useful, self.pins, strict=True)):
            ends = np.concatenate(self.problem.topology.ends(edges))
            gcells, at = np.unique(np.concatenate((ends, pins)), return_inverse=True)
            tail, at = at[: len(ends)], at[len(ends) :]
            arcs, sinks = len(ends), len(pins) - 1
            every = np.arange(arcs)
            one = np.ones(arcs)
            leaving = _sparse(one, tail, every, len(gcells), arcs)
            balance = leaving - _sparse(one, np.roll(tail, len(edges)), every, len(gcells), arcs)
            supply = np.zeros((sinks, len(gcells)))
            supply[:, at[0]] = 1
            supply[np.arange(sinks), at[1:]] = -1
            right.append(supply.reshape(-1))
            routed = np.arange(arcs * _flows(pins)) < arcs
            length.append(routed.astype(float))
            if sinks == 1:
                equal.append(balance)
                below.append(csr_array((0, arcs)))
            else:
                flows = block_diag([balance] * sinks)
                equal.append(hstack((csr_array((flows.shape[0], arcs)), flows)))
                within = hstack((-vstack([eye_array(arcs)] * sinks), eye_array(arcs * sinks)))
                once = _widened(hstack([eye_array(len(edges))] * 2), len(routed))
                below.append(vstack((within, once)))
                limit += [np.zeros(arcs * sinks), np.ones(len(edges))]
            column = np.flatnonzero(np.tile(edges % AXES != VIA_AXIS, 2))
            row = self.row[np.tile(edges, 2)[column]]
            tracks.append((self.demand[self.kind[i], row], row, first + column))
            first += len(routed)
        taken, row, column = map(np.concatenate, zip(*tracks, strict=True))
        return _Columns(
            length=np.concatenate(length),
            tracks=_sparse(taken, row, column, len(self.wires), first),
            whole=np.concatenate(length),
            equal=csr_array(block_diag(equal)),
            right=np.concatenate(right),
            below=csr_array(block_diag(below)),
            limit=np.concatenate(limit),
        )

    # The programs

    def program(
        self, columns: _Columns, aim: _Aim, excess: float | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], csr_array, NDArray[np.float64]]:
        """Adds to columns one for the overflow of every edge, and one for its sum beyond the aim's.

        Args:
            columns: what there is to choose from.
            aim: what is minimised.
            excess: the cost of a track of overflow beyond the aim's; None: there must be none.

        Returns:
            Costs and upper bounds of all columns; a matrix and what its product with them must not
            exceed: the capacities first.
        """
        wires, own = len(self.wires), len(columns.length)
        cost = np.concatenate((columns.length * aim.wirelength, np.zeros(wires), [excess or 0]))
        upper = np.full(own + wires + 1, np.inf)
        upper[:own] = 1
        upper[-1] = 0 if excess is None else np.inf
        rows = (
            hstack((columns.tracks, -eye_array(wires), csr_array((wires, 1)))),
            hstack((csr_array((1, own)), csr_array(np.ones((1, wires))), csr_array([[-1.0]]))),
            _widened(columns.below, len(cost)),
        )
        limit = np.concatenate((self.capacity, [aim.overflow], columns.limit))
        return cost, upper, csr_array(vstack(rows)), limit

    def solve(self, columns: _Columns, aim: _Aim, excess: float | None, **options: float) -> Any:
        """The best choice of columns, a result of scipy's; arguments as of :meth:`program`."""
        cost, upper, below, limit = self.program(columns, aim, excess)
        equal = _widened(columns.equal, len(cost))
        return milp(
            cost,
            integrality=np.concatenate((columns.whole, np.zeros(len(cost) - len(columns.whole)))),
            bounds=Bounds(0, upper),
            constraints=[
                LinearConstraint(below, -np.inf, limit),
                LinearConstraint(equal, columns.right, columns.right),
            ],
            options={"mip_rel_gap": 0.0, **self.options(), **options},
        )

    def options(self) -> dict[str, float]:
        """The options of a solver that tell it the time left."""
        left = self.deadline - time.monotonic()
        return {} if left == math.inf else {"time_limit": max(left, 0.0)}


def _flows(pins: NDArray[np.int64]) -> int:
    """How many columns step 3 has for either direction of an edge of a net with these pins."""
    return len(pins) if len(pins) > 2 else 1


def _spread_out(
    grid: tuple[int, int, int], pins: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """So many of a net's pins at most: the first, then again and again the farthest from them."""
    position = np.stack(np.unravel_index(pins, grid), axis=1)
    taken = [0]
    distance = np.full(len(pins), np.iinfo(np.int64).max)
    while len(taken) < min(most, len(pins)):
        distance = np.minimum(distance, np.abs(position - position[taken[-1]]).sum(axis=1))
        taken.append(int(distance.argmax()))
    return pins[taken]


def _sparse(values: Any, rows: Any, columns: Any, height: int, width: int) -> csr_array:
    """A matrix from its entries."""
    return csr_array(coo_array((values, (rows, columns)), shape=(height, width), dtype=float))


def _widened(matrix: Any, width: int) -> csr_array:
    """The matrix with so many columns, zeros in the new ones."""
    more = csr_array((matrix.shape[0], width - matrix.shape[1]))
    return csr_array(hstack((matrix, more)))
