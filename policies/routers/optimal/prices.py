"""Step 1: column generation. Prices for capacity, trees at these prices, and the bound they prove.

Geoffrion, "Lagrangean relaxation for integer programming", Mathematical Programming Study 2, 1974;
Dantzig and Wolfe, "Decomposition principle for linear programs", Operations Research 8, 1960.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.problem.grid import AXES
from policies.routers.optimal.candidates import Candidates
from policies.routers.optimal.priced_tree import NEVER, Window, cheapest_priced_tree
from policies.routers.optimal.programs import Deadline, Objective, Program, tree_columns

UNIT = 1 << 20
"""Prices and bounds are whole multiples of 1 / UNIT of an edge (or of a track of overflow)."""

EXCESS = 128.0
"""Cost of a track of forbidden overflow in the linear program, in edges: high enough to find trees
that avoid it, low enough to keep prices well scaled."""


class Proof(NamedTuple):
    """A lower bound and what proves it."""

    bound: float  # in UNITs, a whole number; infinite if a net cannot be routed
    dual: NDArray[np.int64]  # (W,) price per track of each wire, in UNITs
    least: list[int]  # cost of each net's cheapest tree at these prices, in UNITs


class Prices:
    """The best bound known for each objective, and the prices that prove it.

    Args:
        candidates: gets the trees found.
        deadline: when to stop.

    Attributes:
        proofs: the best proof for each objective.
    """

    def __init__(self, candidates: Candidates, deadline: Deadline) -> None:
        self.proofs: dict[Objective, Proof] = {}
        self._candidates = candidates
        self._deadline = deadline
        self._settled: set[Objective] = set()  # no prices can improve their bounds further
        self._shortest: dict[Objective, list[int]] = {}  # see window()

    def raise_bound(self, objective: Objective) -> float:
        """Raises an objective's bound as far as prices can.

        Returns:
            The bound in whole edges (or tracks), rounded up; infinite if a net cannot be routed.
        """
        if objective not in self.proofs:
            self._price_trees(objective, np.zeros(len(self._candidates.wires), np.int64))
        while (
            objective not in self._settled
            and self._bound(objective) < self._found(objective)
            and not self._deadline.passed
        ):
            relaxed = self._deadline.bounded(partial(self._relaxed, objective))
            # The value of the linear program proves nothing. It only tells when to stop.
            if (
                relaxed is None
                or self._bound(objective) >= math.ceil(relaxed[0] - 1e-6)
                or not self._price_trees(
                    objective, np.rint(relaxed[1] * UNIT).astype(np.int64).clip(0)
                )
            ):
                self._settled.add(objective)
        return self._bound(objective)

    def _relaxed(self, objective: Objective) -> tuple[float, NDArray[np.float64]] | None:
        """The linear program over all trees; see :meth:`Program.solve_relaxed`."""
        columns, capacity = tree_columns(self._candidates), self._candidates.capacity
        excess = EXCESS if objective.wirelength else 1
        return Program(columns, capacity, objective, excess).solve_relaxed(self._deadline)

    def edge_prices(
        self, objective: Objective, dual: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], int]:
        """The cost of every edge to each kind of net.

        When overflow is minimised, an edge with room costs next to nothing: a price too small to
        show in UNITs makes the search prefer the shorter of two otherwise equal trees.

        Args:
            objective: what is minimised.
            dual: (W,) price per track of each wire, in UNITs.

        Returns:
            (kinds, X, Y, Z, 3) int64, and how much one UNIT is in it.
        """
        candidates = self._candidates
        grid = candidates.problem.topology
        length, unit = (UNIT, 1) if objective.wirelength else (1, grid.gcells)
        most = NEVER // (4 * unit * grid.gcells)
        kinds = len(candidates.demand)
        there = grid.exists & ~candidates.problem.closed
        price = np.where(there, length, NEVER) + np.zeros((kinds, 1), np.int64)
        # Prices too high to be summed are lowered. The bound stays valid.
        capped = np.minimum(dual, most // candidates.demand.clip(1))
        price[:, candidates.wires] += unit * candidates.demand * capped
        if objective.wirelength:
            beyond = candidates.demand - candidates.capacity > objective.overflow
            kind, wire = np.nonzero(beyond)
            price[kind, candidates.wires[wire]] = NEVER
        return price.reshape(-1, *candidates.problem.grid, AXES), unit

    def window(self, objective: Objective, net: int, most: float) -> Window:
        """A part of the grid that contains all trees of a net that cost at most ``most`` UNITs.

        A tree that leaves the box around its pins has to return. Flattened against the side of the
        box it is still a tree, in a grid without differences between rows or columns. So it is
        longer than the shortest tree in that grid and box by at least twice as far as it goes.
        """
        problem, pins = self._candidates.problem, self._candidates.pins[net]
        if not objective.wirelength:
            return Window(problem.grid, (0, 0), problem.grid[:2])
        if objective not in self._shortest:
            self._shortest[objective] = self._shortest_in_boxes(objective)
        beyond = (most - self._shortest[objective][net]) // (2 * UNIT)
        margin = int(max(min(beyond, max(problem.grid)), 0))
        return Window.around(problem.grid, pins, margin)

    def _shortest_in_boxes(self, objective: Objective) -> list[int]:
        """For each net the length in UNITs of its shortest tree in the box around its pins.

        A move is open everywhere in a layer if it is open anywhere in that layer. When the time is
        up, the last nets get a length that is no more than that.
        """
        candidates = self._candidates
        grid = candidates.problem.grid
        price, _ = self.edge_prices(objective, np.zeros(len(candidates.wires), np.int64))
        price = np.where((price < NEVER).any(axis=(1, 2), keepdims=True), UNIT, NEVER)
        exists = candidates.problem.topology.exists.reshape(*grid, AXES)
        price = np.where(exists, price, NEVER)
        least: list[int] = []
        pairs = zip(candidates.kind, candidates.pins, strict=True)
        for kind, pins in self._deadline.while_left(pairs):
            box = Window.around(grid, pins, 0)
            least.append(cheapest_priced_tree(box.cut(price[kind]), box.gcells_in_window(pins))[0])
        return least + (UNIT * candidates.half_perimeters()[len(least) :]).tolist()

    def _price_trees(self, objective: Objective, dual: NDArray[np.int64]) -> bool:
        """Finds each net's cheapest tree at some prices, and the bound that they prove.

        When the time is up, the last nets of the first proof count with their half perimeters, and
        there is no other proof.
        """
        candidates = self._candidates
        if not objective.wirelength:
            dual = np.minimum(dual, UNIT)  # overflow is available at this price
        price, unit = self.edge_prices(objective, dual)
        net, length, edge = candidates.flat()
        known = price.reshape(len(price), -1)[np.repeat(candidates.kind[net], length), edge]
        most = np.full(len(candidates.pins), np.inf)
        starts = np.cumsum(length) - length
        np.minimum.at(most, net, np.add.reduceat(known.astype(float), starts) / unit)
        bound = -int(dual @ candidates.capacity) - objective.overflow * int(dual.max(initial=0))
        least, new = [], False
        for i, pins in self._deadline.while_left(enumerate(candidates.pins)):
            window = self.window(objective, i, most[i])
            own = window.cut(price[candidates.kind[i]])
            cost, tree = cheapest_priced_tree(own, window.gcells_in_window(pins))
            if cost >= NEVER:
                self.proofs[objective] = Proof(math.inf, dual, [])
                return False
            least.append(cost // unit)
            if candidates.complete(i):
                new |= candidates.add(i, window.edges_in_grid(tree))
        if len(least) < len(candidates.pins):
            if objective in self.proofs:
                return False
            length = UNIT * candidates.half_perimeters() * objective.wirelength
            least += length[len(least) :].tolist()
        bound += sum(least)
        if objective not in self.proofs or bound > self.proofs[objective].bound:
            self.proofs[objective] = Proof(bound, dual, least)
        return new

    def _bound(self, objective: Objective) -> float:
        """An objective's bound in whole edges or tracks."""
        bound = self.proofs[objective].bound
        return bound if bound == math.inf else -(-bound // UNIT)

    def _found(self, objective: Objective) -> float:
        """The best solution's figure for an objective; infinite if it has too much overflow."""
        overflow, wirelength = self._candidates.best
        if not objective.wirelength:
            return overflow
        return wirelength if overflow <= objective.overflow else math.inf
