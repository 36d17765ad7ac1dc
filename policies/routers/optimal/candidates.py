"""The trees to choose from, and the best solution so far."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from marouting import Problem, Solution
from marouting.memory import PROOF, check_memory
from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.optimal.priced_tree import NEVER, Window, cheapest_priced_tree

Score = tuple[int, int]
"""Overflow in tracks and wirelength in edges; the smaller tuple is better."""


class Candidates:
    """The trees found so far for each net, and the best solution among them.

    Nets are numbered among the N nets that have something to route, wires (edges with a capacity)
    from 0 to W - 1. Nets with equal demands are of one kind. Trees are arrays of edge numbers
    (:mod:`marouting.problem.grid`), int64 and ascending.

    Args:
        problem: the problem.
        most_pins: how many pins of a net count at most; None for all. Of a larger net, pins that
            are far apart are taken: joining them cannot take more than joining all.

    Attributes:
        problem: the problem.
        nets: (N,) the nets' numbers in the problem.
        pins: for each net (k,) int64, the Gcells of the pins that count.
        wires: (W,) int64, the wires' edge numbers.
        wire_of: (edges,) int64, an edge's wire, or -1.
        capacity: (W,) int64, in tracks.
        kind: (N,) int64, each net's kind.
        demand: (kinds, W) int64, tracks that a net takes from a wire.
        trees: every tree found so far, with its net.
        best: the best solution's score.
        routes: the best solution, a tree (or for nets some of whose pins do not count, a connected
            set of edges) for each net.
    """

    def __init__(self, problem: Problem, most_pins: int | None = None) -> None:
        grid = problem.topology
        check_memory(PROOF * grid.gcells, "a proof on a grid of {}", grid)
        self.problem = problem
        self.nets = [n for n, gcells in enumerate(problem.pin_gcells) if len(gcells) > 1]
        self.pins = [problem.pin_gcells[n] for n in self.nets]
        if most_pins is not None:
            self.pins = [_spread_out(problem.grid, pins, most_pins) for pins in self.pins]
        edges = np.flatnonzero(grid.exists & ~problem.closed)
        self.wires = edges[edges % AXES != VIA_AXIS]
        self.wire_of = np.full(grid.edges, -1)
        self.wire_of[self.wires] = np.arange(len(self.wires))
        self.capacity = problem.capacity[self.wires].astype(np.int64)
        kinds, kind = np.unique(problem.net_demand[self.nets], axis=0, return_inverse=True)
        self.kind = kind.reshape(-1)
        self.demand = kinds[:, self.wires // AXES % problem.grid[2]].astype(np.int64)
        self.trees: list[tuple[int, NDArray[np.int64]]] = []
        self.best: Score = (np.iinfo(np.int64).max, 0)
        self.routes: list[NDArray[np.int64]] = []
        self._known: set[tuple[int, bytes]] = set()

    def complete(self, net: int) -> bool:
        """Whether all pins of a net count."""
        return len(self.pins[net]) == len(self.problem.pin_gcells[self.nets[net]])

    def add(self, net: int, tree: NDArray[np.int64]) -> bool:
        """Adds a tree of a net; returns whether it is new."""
        key = (net, tree.tobytes())
        new = key not in self._known
        if new:
            self._known.add(key)
            self.trees.append((net, tree))
        return new

    def add_routes(self, routes: Sequence[NDArray[np.int64]]) -> None:
        """Adds the trees of a solution, one for each net, and keeps the solution if it is best."""
        used = np.zeros(len(self.wires), np.int64)
        for net, route in enumerate(routes):
            self.add(net, route)
            wires = self.wire_of[route[route % AXES != VIA_AXIS]]
            used[wires] += self.demand[self.kind[net], wires]
        overflow = int(np.maximum(used - self.capacity, 0).sum())
        score = (overflow, sum(map(len, routes)))
        if score < self.best:
            self.best, self.routes = score, list(routes)

    def add_solution(self, solution: Solution, pruned: Iterable[int] | None = None) -> None:
        """Adds another router's solution.

        Args:
            solution: the solution.
            pruned: the nets whose routes are pruned to their shortest trees; None: all.
        """
        routes = [solution.edges[n] for n in self.nets]
        for net in range(len(routes)) if pruned is None else pruned:
            routes[net] = self.prune(net, routes[net])
        self.add_routes(routes)

    def prune(self, net: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
        """The shortest tree of a net among ``edges``; all of them if not all its pins count."""
        if not self.complete(net):
            return edges
        grid, pins = self.problem.grid, self.pins[net]
        price = np.full((*grid, AXES), NEVER)
        price.reshape(-1)[edges] = 1
        window = Window.around(grid, np.concatenate(self.problem.topology.ends(edges)), 0)
        return window.edges_in_grid(
            cheapest_priced_tree(window.cut(price), window.gcells_in_window(pins))[1]
        )

    def half_perimeters(self) -> NDArray[np.int64]:
        """(N,) int64, a length that no tree of a net is below: that of half the box of its pins."""
        sizes = [np.ptp(np.unravel_index(pins, self.problem.grid), axis=1) for pins in self.pins]
        return np.array(sizes, np.int64).reshape(-1, 3).sum(axis=1)

    def flat(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """All T trees as arrays.

        Returns:
            The net of each tree (T,), its length (T,), and the edges of all trees, one tree after
            another; all int64.
        """
        net = np.array([net for net, _ in self.trees])
        length = np.array([len(tree) for _, tree in self.trees])
        return net, length, np.concatenate([tree for _, tree in self.trees])

    def solution(self) -> Solution:
        """The best solution."""
        edges = [np.empty(0, np.int64)] * len(self.problem.nets)
        for n, route in zip(self.nets, self.routes, strict=True):
            edges[n] = route
        return Solution(self.problem, tuple(edges))


def _spread_out(
    grid: tuple[int, int, int], pins: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """At most ``most`` of a net's pins: the first, then repeatedly the one farthest from them."""
    position = np.stack(np.unravel_index(pins, grid), axis=1)
    taken = [0]
    distance = np.full(len(pins), np.iinfo(np.int64).max)
    while len(taken) < min(most, len(pins)):
        distance = np.minimum(distance, np.abs(position - position[taken[-1]]).sum(axis=1))
        taken.append(int(distance.argmax()))
    return pins[taken]
