"""Step 3: integer programs with flows over the edges that a better solution could use.

Wong, "A dual ascent approach for Steiner tree problems on a directed graph", Mathematical
Programming 28, 1984.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array, eye_array, vstack

from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.optimal.candidates import Candidates, Score
from policies.routers.optimal.priced_tree import TreesByEdge
from policies.routers.optimal.prices import UNIT, Prices
from policies.routers.optimal.programs import (
    Columns,
    Deadline,
    Objective,
    Program,
    choose,
    hstack,
    sparse_matrix,
    widened,
)

MAX_COLUMNS = 4_000_000
"""The largest integer program attempted, in variables."""

SLIP = 0.01
"""How far the solver's bound of an integer program is distrusted: much more than its tolerances
amount to, yet too little to matter once the bound is rounded up."""

MOST_TRACKS = 2**24
"""The most tracks that all nets together may take of an edge. With larger sums, rounding comes near
to the solver's tolerances, and it may call infeasible what is not."""

Stop = Literal["time limit", "solver limit"]


class Flows:
    """Decides by integer programs what prices leave open.

    Args:
        candidates: gets the trees found.
        prices: tell which edges matter.
        deadline: when to stop.
    """

    def __init__(self, candidates: Candidates, prices: Prices, deadline: Deadline) -> None:
        self._candidates = candidates
        self._prices = prices
        self._deadline = deadline
        self._reach: dict[Objective, int] = defaultdict(int)  # how far above the bound to look

    def decide(self, objective: Objective, lower: Score) -> tuple[Score, Stop | None]:
        """Finds an objective's best solution if it is close to the bound, or raises the bound.

        Each call for the same objective looks farther above the bound.

        Returns:
            The bound, raised if possible, and what prevents further progress, if anything.
        """
        candidates, figure = self._candidates, objective.wirelength
        known = lower, candidates.best
        bound, most = lower[figure], candidates.best[figure] - 1
        target = min(bound + self._reach[objective], most)
        self._reach[objective] = 2 * self._reach[objective] + 1
        edges = self._useful_edges(objective, target, bound)
        if self._deadline.passed:
            return lower, "time limit"
        choose(candidates, objective, self._deadline)
        if self._deadline.left <= 0:
            return lower, "time limit"
        if candidates.best[figure] == bound:
            return lower, None
        pairs = zip(edges, candidates.pins, strict=True)
        size = [2 * len(own) * _flows(pins) for own, pins in pairs]
        tracks = candidates.demand.max(axis=1, initial=0)[candidates.kind].sum()
        if sum(size) > MAX_COLUMNS or tracks > MOST_TRACKS:
            return lower, "solver limit"
        excess = None if objective.wirelength else 1

        def solved() -> Any:
            program = Program(self._arc_columns(edges), candidates.capacity, objective, excess)
            return program.solve_whole(self._deadline)

        result = self._deadline.bounded(solved)
        if result is None:
            return lower, "time limit"
        if result.x is not None:
            first = np.cumsum(size) - size
            arcs = [result.x[a : a + 2 * len(own)] for a, own in zip(first, edges, strict=True)]
            used = [(arc.reshape(2, -1) > 0.5).any(axis=0) for arc in arcs]
            candidates.add_routes(
                [candidates.prune(net, own[used[net]]) for net, own in enumerate(edges)]
            )
        # Every solution within the target uses only these edges.
        least = target + 1 if result.status == 2 else result.mip_dual_bound
        if least is not None and least - SLIP > bound:
            proven = math.ceil(min(least, target + 1) - SLIP)
            lower = (objective.overflow, proven) if objective.wirelength else (proven, 0)
        if result.status == 1:
            return lower, "time limit"
        stuck = target == most and known == (lower, candidates.best)
        return lower, "solver limit" if stuck else None

    def _useful_edges(
        self, objective: Objective, target: int, bound: int
    ) -> list[NDArray[np.int64]]:
        """For each net the edges that it may use in a solution within a target.

        If the target is the bound, the cheapest trees through these edges become candidates. When
        the time is up, the last nets are left out.
        """
        candidates, edges = self._candidates, []
        proof = self._prices.proofs[objective]
        price, unit = self._prices.edge_prices(objective, proof.dual)
        for i, pins in enumerate(candidates.pins):
            if self._deadline.passed:
                break
            most = proof.least[i] + target * UNIT - proof.bound
            window = self._prices.window(objective, i, most)
            across = TreesByEdge(
                window.cut(price[candidates.kind[i]]), window.gcells_in_window(pins)
            )
            low = np.flatnonzero(across.cost // unit <= most)
            edges.append(window.edges_in_grid(low))
            if target == bound:
                for edge in self._deadline.while_left(low):
                    tree = window.edges_in_grid(across.tree(int(edge)))
                    candidates.add(i, candidates.prune(i, tree))
        return edges

    def _arc_columns(self, useful: Sequence[NDArray[np.int64]]) -> Columns:
        """Columns for both directions of each net's edges and for the flows along them.

        A net's columns are its edges forward, then backward. If it has more than two pins, as many
        columns follow for the flow to each pin but the first, and the net's route has to contain
        every flow. With two pins the route is the flow.
        """
        candidates = self._candidates
        first = 0
        length, right, equal, below, limit, tracks = [], [], [], [], [np.empty(0)], []
        for i, (edges, pins) in enumerate(zip(useful, candidates.pins, strict=True)):
            ends = np.concatenate(candidates.problem.topology.ends(edges))
            gcells, at = np.unique(np.concatenate((ends, pins)), return_inverse=True)
            tail, at = at[: len(ends)], at[len(ends) :]
            arcs, sinks = len(ends), len(pins) - 1
            every = np.arange(arcs)
            one = np.ones(arcs)
            height = len(gcells)
            leaving = sparse_matrix(one, tail, every, height, arcs)
            entering = sparse_matrix(one, np.roll(tail, len(edges)), every, height, arcs)
            balance = leaving - entering
            supply = np.zeros((sinks, height))
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
                once = widened(hstack([eye_array(len(edges))] * 2), len(routed))
                below.append(vstack((within, once)))
                limit += [np.zeros(arcs * sinks), np.ones(len(edges))]
            column = np.flatnonzero(np.tile(edges % AXES != VIA_AXIS, 2))
            wire = candidates.wire_of[np.tile(edges, 2)[column]]
            tracks.append((candidates.demand[candidates.kind[i], wire], wire, first + column))
            first += len(routed)
        taken, wire, column = map(np.concatenate, zip(*tracks, strict=True))
        return Columns(
            length=np.concatenate(length),
            tracks=sparse_matrix(taken, wire, column, len(candidates.wires), first),
            whole=np.concatenate(length),
            equal=csr_array(block_diag(equal)),
            right=np.concatenate(right),
            below=csr_array(block_diag(below)),
            limit=np.concatenate(limit),
        )


def _flows(pins: NDArray[np.int64]) -> int:
    """Columns for each direction of an edge of a net with these pins."""
    return len(pins) if len(pins) > 2 else 1
