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
3. **Flows.** Otherwise an integer program over the grid decides, with a flow from a net's first
   pin to each of its other pins (Wong, "A dual ascent approach for Steiner tree problems on a
   directed graph", Mathematical Programming 28, 1984). A net gets only those edges for which the
   bound of all solutions that use them is low enough: the others are proven to be of no use.

Overflow is minimised first, by the same steps. The solver is HiGHS, as it comes with scipy.
"""

import math
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
from policies.classical.trees import NEVER, cheapest_tree, cost_across

# What scipy's stubs take is narrower than what these do.
hstack: Any = sparse.hstack
linprog: Any = optimize.linprog
milp: Any = optimize.milp

UNIT = 1 << 20
"""Prices and bounds are whole multiples of this part of an edge's length."""

EXCESS = 128.0
"""What the linear program pays, in wirelength, for overflow beyond what is allowed: enough to find
trees that need none, little enough to keep prices apart."""

NODES = 200
"""Nodes of its search tree after which step 2 leaves the rest to step 3."""

MAX_WORK = 2**36
"""The largest problem accepted, in steps of the search for the cheapest trees of all nets."""

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
    """

    def __init__(self, problem: Problem, deadline: float) -> None:
        grid = problem.topology
        self.problem = problem
        self.deadline = deadline
        self.nets = [n for n, gcells in enumerate(problem.pin_gcells) if len(gcells) > 1]
        self.pins = [problem.pin_gcells[n] for n in self.nets]
        work = sum((3 ** len(pins) + 32 * 2 ** len(pins)) * grid.gcells for pins in self.pins)
        if work > MAX_WORK:
            raise InputError(
                "problem: too large to prove an optimum: expected at most "
                f"{MAX_WORK:.0e} steps to find the cheapest trees, found {work:.0e} for "
                f"{len(self.pins)} nets with up to {max(map(len, self.pins))} pins on "
                f"{grid.gcells} Gcells"
            )
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
        self.tried = 0  # trees that step 2 has chosen from
        self.proofs: dict[_Aim, _Proof] = {}
        self.settled: set[_Aim] = set()  # aims that no further prices help
        self.lower: Pair = (0, 0)
        self.best: Pair = (np.iinfo(np.int64).max, 0)
        routes = sequential_astar(problem).edges
        self.take([self.prune(net, routes[n]) for net, n in enumerate(self.nets)])

    def run(self) -> Status:
        """Searches until bound and solution agree or something ends it; says what."""
        reach = 0
        while True:
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
            if self.lower < self.best and self.tried < len(self.trees) and not self.late():
                self.choose(aim)
            if self.lower >= self.best:
                return "optimal"
            if self.late():
                return "time limit"
            if not self.decide(aim, self.lower[1] + reach):
                return "size limit"
            reach = 2 * reach + 1

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

    # Step 1: prices

    def price(self, aim: _Aim, dual: NDArray[np.int64]) -> list[tuple[NDArray[np.int64], int]]:
        """For each kind of net the prices (X, Y, Z, 3) of all edges, and what one UNIT is there.

        Overflow alone costs nothing where there is room: there the shorter of equal trees is
        taken, by a price too low to tell in UNITs.
        """
        grid = self.problem.topology
        length, unit = (UNIT, 1) if aim.wirelength else (1, grid.gcells)
        most = NEVER // (4 * unit * grid.gcells)
        found = []
        for demand in self.demand:
            price = np.where(grid.exists, length, NEVER)
            # A price too high to be added up may be lowered: the bound stays one.
            price[self.wires] += np.minimum(dual, most // np.maximum(demand, 1)) * demand * unit
            if aim.wirelength:
                price[self.wires[demand - self.capacity > aim.overflow]] = NEVER
            found.append((price.reshape(*self.problem.grid, AXES), unit))
        return found

    def bid(self, aim: _Aim, dual: NDArray[np.int64]) -> bool:
        """Finds the cheapest trees at prices, and their bound; returns whether any tree is new."""
        if not aim.wirelength:
            dual = np.minimum(dual, UNIT)  # overflow is there for this price
        prices = self.price(aim, dual)
        bound = -int(dual @ self.capacity) - aim.overflow * int(dual.max(initial=0))
        least, new = [], False
        for net, pins in enumerate(self.pins):
            price, unit = prices[self.kind[net]]
            cost, tree = cheapest_tree(price, pins)
            if cost >= NEVER:
                self.proofs[aim] = _Proof(math.inf, dual, [])
                return False
            least.append(cost // unit)
            new |= self.add(net, tree)
        bound += sum(least)
        if aim not in self.proofs or bound > self.proofs[aim].bound:
            self.proofs[aim] = _Proof(bound, dual, least)
        return new

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
        cost, _, capacity, limit = self.program(columns, aim, EXCESS if aim.wirelength else 1)
        size = len(cost) - len(columns.length)
        result = linprog(
            cost,
            A_ub=capacity,
            b_ub=limit,
            A_eq=hstack((columns.equal, csr_array((columns.equal.shape[0], size)))),
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
        net = np.array([net for net, _ in self.trees])
        length = np.array([len(tree) for _, tree in self.trees])
        column = np.repeat(np.arange(len(net)), length)
        edge = np.concatenate([tree for _, tree in self.trees])
        wire = edge % AXES != VIA_AXIS
        row, column = self.row[edge[wire]], column[wire]
        taken = self.demand[self.kind[net[column]], row]
        every = np.arange(len(net))
        return _Columns(
            length=length.astype(float),
            tracks=_sparse(taken, row, column, len(self.wires), len(net)),
            whole=np.ones(len(net)),
            equal=_sparse(np.ones(len(net)), net, every, len(self.nets), len(net)),
            right=np.ones(len(self.nets)),
            below=csr_array((0, len(net))),
            limit=np.empty(0),
        )

    def choose(self, aim: _Aim) -> None:
        """Chooses the best trees found: least overflow beyond the aim's, then least length."""
        columns = self.choices()
        self.tried = len(self.trees)
        most = np.zeros(len(self.nets))
        np.maximum.at(most, [net for net, _ in self.trees], columns.length)
        result = self.solve(columns, aim, 1 + most.sum(), node_limit=NODES)
        if result.x is not None:
            chosen = np.flatnonzero(result.x[: self.tried] > 0.5)
            self.take([tree for _, tree in sorted((self.trees[i] for i in chosen), key=_net)])

    # Step 3: flows

    def decide(self, aim: _Aim, target: int) -> bool:
        """Finds the best solution of an aim, if it is not longer than the target, or proves more.

        Returns:
            Whether the program was small enough to be built.
        """
        if self.reached(aim) < math.inf:
            target = min(target, self.best[1] - 1)
        useful, everything = self.useful(aim, target)
        size = sum(
            2 * len(edges) * _flows(pins) for edges, pins in zip(useful, self.pins, strict=True)
        )
        if size > MAX_COLUMNS:
            return False
        columns = self.arcs(useful)
        result = self.solve(columns, aim, None)
        overflow = aim.overflow
        if result.x is not None:
            self.take(self.routes_of(useful, result.x))
        proven = math.inf if result.status == 2 else -math.inf
        if result.status in (0, 1) and result.mip_dual_bound is not None:
            proven = math.ceil(result.mip_dual_bound - 1e-6)
        if not everything:
            proven = min(proven, target + 1)
        if proven == math.inf:
            self.lower = (overflow + 1, 0)
        elif proven > self.lower[1]:
            self.lower = (overflow, int(proven))
        return True

    def useful(self, aim: _Aim, target: int) -> tuple[list[NDArray[np.int64]], bool]:
        """For each net the edges that a solution not longer than the target can use.

        Returns:
            The edges of each net, and whether these are all that any solution can use.
        """
        aims = [(aim, target)]
        if self.best[0] > aim.overflow:
            aims.append((OVERFLOW, aim.overflow))
        keep = [np.ones(self.problem.topology.edges, np.bool_) for _ in self.nets]
        everything = True
        for which, most in aims:
            proof = self.proofs[which]
            prices = self.price(which, proof.dual)
            slack = most * UNIT - proof.bound
            for net, pins in enumerate(self.pins):
                price, unit = prices[self.kind[net]]
                across = cost_across(price, pins).reshape(-1)
                low = (across // unit - proof.least[net] <= slack) & (across < NEVER)
                everything &= which is not aim or bool((low == (across < NEVER)).all())
                keep[net] &= low
        return [np.flatnonzero(edges) for edges in keep], everything

    def arcs(self, useful: Sequence[NDArray[np.int64]]) -> _Columns:
        """A column for either direction of every edge of a net, and for each flow along it.

        The columns of a net are those of its edges, forward, then backward, and after them, if it
        has more than two pins, as many for the flow to each pin but the first. A net's route
        contains the way of every flow; that of a net with two pins is one.
        """
        length, whole, equal, right, below, limit, first = [], [], [], [], [], [], 0
        rows: list[NDArray[np.int64]] = []
        places: list[NDArray[np.int64]] = []
        taken: list[NDArray[np.int64]] = []
        for net, (edges, pins) in enumerate(zip(useful, self.pins, strict=True)):
            ends = np.concatenate(self.problem.topology.ends(edges))
            gcells, tail = np.unique(np.concatenate((ends, pins)), return_inverse=True)
            at, tail = tail[len(ends) :], tail[: len(ends)]
            head = np.roll(tail, len(edges))
            arcs = np.arange(len(tail))
            one = np.ones(len(arcs))
            leaving = _sparse(one, tail, arcs, len(gcells), len(arcs))
            balance = leaving - _sparse(one, head, arcs, len(gcells), len(arcs))
            flows = _flows(pins)
            used = np.arange(flows * len(arcs)) < len(arcs)
            length.append(used.astype(float))
            whole.append(used.astype(float))
            demand = np.zeros((len(pins) - 1, len(gcells)))
            demand[:, at[0]] = 1
            demand[np.arange(len(pins) - 1), at[1:]] = -1
            right.append(demand.reshape(-1))
            if flows == 1:
                equal.append(balance)
                below.append(csr_array((0, len(arcs))))
            else:
                within = eye_array(len(arcs))
                sinks = [balance] * (flows - 1)
                equal.append(
                    hstack((csr_array((len(gcells) * (flows - 1), len(arcs))), block_diag(sinks)))
                )
                either = eye_array(len(edges))
                below.append(
                    vstack(
                        (
                            hstack(
                                (
                                    vstack([-within] * (flows - 1)),
                                    eye_array(len(arcs) * (flows - 1)),
                                )
                            ),
                            hstack(
                                (either, either, csr_array((len(edges), len(arcs) * (flows - 1))))
                            ),
                        )
                    )
                )
                limit.append(np.zeros(len(arcs) * (flows - 1)))
                limit.append(np.ones(len(edges)))
            wire = np.flatnonzero(edges % AXES != VIA_AXIS)
            row = self.row[edges[wire]]
            for side in (0, len(edges)):
                rows.append(row)
                places.append(first + side + wire)
                taken.append(self.demand[self.kind[net], row])
            first += flows * len(arcs)
        return _Columns(
            length=np.concatenate(length),
            tracks=_sparse(
                np.concatenate(taken),
                np.concatenate(rows),
                np.concatenate(places),
                len(self.wires),
                first,
            ),
            whole=np.concatenate(whole),
            equal=csr_array(block_diag(equal)),
            right=np.concatenate(right),
            below=csr_array(block_diag(below)),
            limit=np.concatenate((*limit, np.empty(0))),
        )

    def routes_of(
        self, useful: Sequence[NDArray[np.int64]], x: NDArray[np.float64]
    ) -> list[NDArray[np.int64]]:
        """The trees that a choice of :meth:`arcs` makes."""
        routes, first = [], 0
        for net, (edges, pins) in enumerate(zip(useful, self.pins, strict=True)):
            arcs = x[first : first + 2 * len(edges)].reshape(2, -1) > 0.5
            routes.append(self.prune(net, edges[arcs.any(axis=0)]))
            first += 2 * len(edges) * _flows(pins)
        return routes

    # The programs

    def program(
        self, columns: _Columns, aim: _Aim, excess: float | None
    ) -> tuple[Any, Any, Any, Any]:
        """Adds the overflow of every edge, and what all of it exceeds the aim's by, to columns.

        Args:
            columns: what there is to choose from.
            aim: what is minimised.
            excess: the cost of a track of overflow beyond the aim's; None: there must be none.

        Returns:
            Costs and upper bounds of the columns; a matrix whose product with them has upper
            limits, and these: capacities first.
        """
        wires = len(self.wires)
        cost = np.concatenate((columns.length * aim.wirelength, np.zeros(wires), [excess or 0]))
        upper = np.concatenate(
            (
                np.ones(len(columns.length)),
                np.full(wires, np.inf),
                [0 if excess is None else np.inf],
            )
        )
        rows = (
            hstack((columns.tracks, -eye_array(wires), csr_array((wires, 1)))),
            hstack((csr_array((1, len(columns.length))), np.ones((1, wires)), [[-1.0]])),
            hstack((columns.below, csr_array((len(columns.limit), wires + 1)))),
        )
        limit = np.concatenate((self.capacity, [aim.overflow], columns.limit))
        return cost, upper, csr_array(vstack(rows)), limit

    def solve(self, columns: _Columns, aim: _Aim, excess: float | None, **options: float) -> Any:
        """The best choice of columns, a result of scipy's; arguments as of :meth:`program`."""
        cost, upper, below, limit = self.program(columns, aim, excess)
        more = len(cost) - len(columns.length)
        equal = hstack((columns.equal, csr_array((len(columns.right), more))))
        return milp(
            cost,
            integrality=np.concatenate((columns.whole, np.zeros(more))),
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


def _net(tree: tuple[int, NDArray[np.int64]]) -> int:
    return tree[0]


def _flows(pins: NDArray[np.int64]) -> int:
    """How many columns step 3 has for an arc of a net with these pins."""
    return len(pins) if len(pins) > 2 else 1


def _sparse(values: Any, rows: Any, columns: Any, height: int, width: int) -> csr_array:
    return csr_array(coo_array((values, (rows, columns)), shape=(height, width), dtype=float))
