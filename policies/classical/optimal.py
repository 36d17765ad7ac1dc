"""The proven optimum: the least overflow, and with it the least wirelength, with a proof.

To route a problem is to choose a tree for every net. Three steps meet from either side:

1. **Prices.** A linear program may mix the trees of a net; its dual values are prices of capacity.
   With prices every net has a cheapest tree of its own (:mod:`policies.classical.trees`): what
   these cost, less the price of all capacity, no solution can undercut (Lagrange). The trees join
   the linear program, which finds better prices, until the two agree: column generation
   (Dantzig and Wolfe, "Decomposition principle for linear programs", Operations Research 8, 1960).
   Prices are rounded to whole numbers, and the bound is worked out in these alone: it holds
   whatever the solver's tolerances are.
2. **Choice.** An integer program chooses one of the trees found for each net. On most problems its
   solution is as good as the bound: then it is optimal.
3. **Flows.** Otherwise the edges that matter are found: those for which the bound of all solutions
   that use them is low enough. (The others are proven to be of no use.) The cheapest tree across
   each of them is added to the choice; and if that does not do, an integer program over these
   edges decides, with a flow from a net's first pin to each of its other pins (Wong, "A dual
   ascent approach for Steiner tree problems on a directed graph", Mathematical Programming 28,
   1984).

Overflow is minimised first, by the same steps. The solver is HiGHS, as it comes with scipy.
"""

import math
import operator
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.optimize import Bounds, LinearConstraint
from scipy.sparse import block_diag, coo_array, csr_array, eye_array, vstack

from marouting import InputError, Problem, Solution, evaluate, sequential_astar
from marouting.grid import AXES, VIA_AXIS
from policies.classical.trees import NEVER, Across, Window, cheapest_tree

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
"""Pins of a net that count in a bound for problems of any size."""

MAX_COLUMNS = 4_000_000
"""The largest integer program of step 3, in variables."""

Status = Literal["optimal", "time limit", "size limit"]
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
        status: ``optimal`` if bound and solution agree; otherwise what ended the search.
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


@dataclass(frozen=True)
class OptimalRouter:
    """Routes with the least overflow and then the least wirelength, as far as time allows.

    Attributes:
        time_limit: seconds after which the best solution so far is taken; None: no limit. With 0
            it is that of sequential A*, and the bound the sum of the nets' shortest trees.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    name: ClassVar[str] = "optimal"
    time_limit: float | None = None

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
        search = _Search(problem, started + limit)
        status = search.run()
        solution = search.solution()
        figures = evaluate(problem, solution)
        found = (figures.overflow, figures.wirelength)
        if not figures.connected or found != search.best or found < search.lower:
            raise RuntimeError(f"claimed {search.best} from {search.lower}, found {figures}")
        seconds = time.monotonic() - started
        return Optimum(solution, *search.best, *search.lower, seconds, status)


def relaxation_bound(problem: Problem, time_limit: float | None = None) -> float:
    """A lower bound of the wirelength of every solution without overflow.

    It is that of step 1 alone, rounded up, also on problems that are too large for the router.
    Nets with more than MOST_PINS pins count with so many of them, spread out.

    Args:
        problem: what is routed.
        time_limit: seconds after which the best bound so far is taken; None: no limit. With 0 it
            is the sum of the nets' shortest trees.

    Returns:
        The bound, a whole number; infinite if a net cannot be routed without overflow.
    """
    limit = math.inf if time_limit is None else time_limit
    search = _Search(problem, time.monotonic() + limit, MOST_PINS)
    return search.relax(_Aim(wirelength=True, overflow=0)) if search.nets else 0


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
        most_pins: a net with more counts with so many of its pins, which takes no more than with
            all; then there is no best solution, only a bound. None: all pins count.
    """

    def __init__(self, problem: Problem, deadline: float, most_pins: int | None = None) -> None:
        grid = problem.topology
        self.problem = problem
        self.deadline = deadline
        self.nets = [n for n, gcells in enumerate(problem.pin_gcells) if len(gcells) > 1]
        self.pins = [problem.pin_gcells[n] for n in self.nets]
        if most_pins is None:
            self.check_size()
        else:
            self.pins = [_spread_out(problem.grid, pins, most_pins) for pins in self.pins]
        edges = np.flatnonzero(grid.exists)
        self.wires = edges[edges % AXES != VIA_AXIS]
        self.row = np.full(grid.edges, -1)
        self.row[self.wires] = np.arange(len(self.wires))
        self.capacity = problem.capacity[self.wires].astype(np.int64)
        kinds, kind = np.unique(problem.demand[self.nets], axis=0, return_inverse=True)
        self.kind = kind.reshape(-1)
        self.demand = kinds[:, self.wires // AXES % problem.grid[2]].astype(np.int64)  # (kinds, W)

        self.trees: list[tuple[int, NDArray[np.int64]]] = []  # net and edges of every tree found
        self.known: set[tuple[int, bytes]] = set()
        self.proofs: dict[_Aim, _Proof] = {}
        self.settled: set[_Aim] = set()  # aims that no further prices help
        self.plain: dict[_Aim, list[int]] = {}  # see window()
        self.lower: Pair = (0, 0)
        self.best: Pair = (np.iinfo(np.int64).max, 0)
        self.routes: list[NDArray[np.int64]] = []
        astar = sequential_astar(problem).edges
        routes = [astar[n] for n in self.nets]
        if most_pins is None:
            self.take([self.prune(net, route) for net, route in enumerate(routes)])
        else:
            for net, route in enumerate(routes):
                self.add(net, route)

    def check_size(self) -> None:
        """Raises InputError if finding the cheapest trees of all nets once would take too long."""
        gcells = self.problem.topology.gcells
        work = sum((3 ** len(pins) + 32 * 2 ** len(pins)) * gcells for pins in self.pins)
        if work > MAX_WORK:
            raise InputError(
                "problem: too large to prove an optimum: expected at most "
                f"{MAX_WORK:.0e} steps to find the cheapest trees, found {work:.0e} for "
                f"{len(self.pins)} nets with up to {max(map(len, self.pins))} pins on "
                f"{gcells} Gcells"
            )

    def run(self) -> Status:
        """Searches until bound and solution agree or something ends it; says what."""
        chosen: set[_Aim] = set()
        reach = 0  # by how much step 3 looks beyond the bound
        while self.lower < self.best:
            overflow = self.lower[0]
            if self.best[0] > overflow and (least := self.relax(OVERFLOW)) > overflow:
                self.lower = (int(least), 0)
                continue
            aim = _Aim(wirelength=True, overflow=overflow)
            least = self.relax(aim)
            if least == math.inf:
                self.lower = (overflow + 1, 0)
                continue
            self.lower = max(self.lower, (overflow, int(least)))
            if self.lower == self.best:
                break
            if self.late():
                return "time limit"
            if aim not in chosen:
                chosen.add(aim)
                self.choose(aim)
            elif self.decide(aim, self.lower[1] + reach):
                reach = 2 * reach + 1
            else:
                return "size limit"
        return "optimal"

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

    def prune(self, net: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
        """The shortest tree of a net within a route."""
        price = np.full(self.problem.topology.edges, NEVER)
        price[edges] = 1
        return cheapest_tree(price.reshape(*self.problem.grid, AXES), self.pins[net])[1]

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
            cost, tree = cheapest_tree(window.cut(price[self.kind[i]]), window.inside(pins))
            if cost >= NEVER:
                self.proofs[aim] = _Proof(math.inf, dual, [])
                return False
            least.append(cost // unit)
            if len(pins) == len(self.problem.pin_gcells[self.nets[i]]):
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
                cheapest_tree(box.cut(price[kind]), box.inside(pins))[0]
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
            if mixed is not None:
                value, dual = mixed
                if self.bound(aim) >= math.ceil(value - 1e-6) or not self.bid(aim, dual):
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
        """The best mixture of trees: its value and the prices (W,); None if time was up first."""
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

    def decide(self, aim: _Aim, target: int) -> bool:
        """Finds the best solution of an aim, if it is not longer than the target, or proves more.

        Returns:
            Whether the program was small enough to be built.
        """
        if self.reached(aim) < math.inf:
            target = min(target, self.best[1] - 1)
        edges, everything = self.useful(aim, target)
        self.choose(aim)
        if self.lower == self.best:
            return True
        size = [2 * len(own) * _flows(pins) for own, pins in zip(edges, self.pins, strict=True)]
        if sum(size) > MAX_COLUMNS:
            return False
        result = self.solve(self.arcs(edges), aim, None)
        if result.x is not None:
            first = np.cumsum(size) - size
            arcs = [result.x[a : a + 2 * len(own)] for a, own in zip(first, edges, strict=True)]
            used = [(arc.reshape(2, -1) > 0.5).any(axis=0) for arc in arcs]
            self.take([self.prune(net, own[used[net]]) for net, own in enumerate(edges)])
        proven = math.inf if result.status == 2 else -math.inf
        if result.status in (0, 1) and result.mip_dual_bound is not None:
            proven = math.ceil(result.mip_dual_bound - 1e-6)
        if not everything:
            proven = min(proven, target + 1)
        if proven == math.inf:
            self.lower = (aim.overflow + 1, 0)
        elif proven > self.lower[1]:
            self.lower = (aim.overflow, int(proven))
        return True

    def useful(self, aim: _Aim, target: int) -> tuple[list[NDArray[np.int64]], bool]:
        """The edges that matter to solutions not longer than a target; adds the trees across them.

        Returns:
            The edges of each net, and whether these are all that any solution of the aim can use.
        """
        edges, everything = [], True
        bounds = [(aim, target)] + [(OVERFLOW, aim.overflow)] * (self.best[0] > aim.overflow)
        prices = [self.price(which, self.proofs[which].dual) for which, _ in bounds]
        for i, pins in enumerate(self.pins):
            keep = np.ones(self.problem.topology.edges, np.bool_)
            for (which, most), (price, unit) in zip(bounds, prices, strict=True):
                proof = self.proofs[which]
                slack = most * UNIT - proof.bound
                window = self.window(which, i, proof.least[i] + slack)
                across = Across(window.cut(price[self.kind[i]]), window.inside(pins))
                low = np.flatnonzero(across.cost // unit <= proof.least[i] + slack)
                inside = np.zeros_like(keep)
                inside[window.outside(low)] = True
                keep &= inside
                if which is aim:
                    everything &= window.shape == self.problem.grid
                    everything &= len(low) == np.count_nonzero(across.cost < NEVER)
                    if target == self.lower[1]:
                        for edge in low:
                            self.add(i, self.prune(i, window.outside(across.tree(int(edge)))))
            edges.append(np.flatnonzero(keep))
        return edges, everything

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
