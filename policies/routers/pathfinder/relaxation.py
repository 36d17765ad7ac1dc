"""Prices from a linear program over all trees found so far.

A search keeps every tree that it has found for a net. If nets may use fractions of several trees,
least overflow is a linear program. Its dual values are prices between 0 and 1 for a track of every
edge. They measure scarcity better than counts of past overflow, and the cheapest trees at these
prices are the columns to add next: this is column generation (Dantzig
and Wolfe, "Decomposition principle for linear programs", Operations Research 8, 1960). The shares
and prices are found by the primal-dual hybrid gradient method (Chambolle and Pock, "A first-order
primal-dual algorithm for convex problems with applications to imaging", Journal of Mathematical
Imaging and Vision 40, 2011), in so few iterations that they are near the optimum, not at it.

Sizes: C columns (trees), P places (wires of trees), E edges, N nets.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, i64, mixed
from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.pathfinder.kernels import GOLDEN
from policies.routers.pathfinder.state import UNIT, ProblemArrays, Routing, widened

_ITERATIONS, _LATER = 60, 20
"""Iterations of the linear program whenever prices are set, in the first round and in later ones:
it goes on from where it stood."""

_FIRST_STEP, _RATIO = 0.01, 1.6
"""Step size to begin with, and how much larger it is for prices than for shares (and by how much
smaller for shares)."""

_LEAST = 0.5
"""With less overflow than this, in tracks, in the linear program, its prices tell nothing."""

_TREES = 16
"""Trees per net that there is room for at first."""

_PLACES_PER_LABEL = 64
"""Places that an iteration of the linear program handles while a search opens one label."""


class Columns(NamedTuple):
    """The trees that nets have had, all different."""

    filled: NDArray[np.int64]  # (2,) how many columns and places are in use
    held: NDArray[np.int32]  # (N,) the column of the net's present tree; -1: none
    latest: NDArray[np.int32]  # (N,) the net's latest column; -1: none
    before: NDArray[np.int32]  # (C,) the same net's column before this one; -1: none
    net: NDArray[np.int32]  # (C,)
    mark: NDArray[np.int64]  # (C,) a number that differs between different trees
    first: NDArray[np.int64]  # (C + 1,) a column's wires are edge[first[c] : first[c + 1]]
    share: NDArray[np.float64]  # (C,) of the net; those of a net sum to 1
    next_share: NDArray[np.float64]  # (C,) working memory
    edge: NDArray[np.int32]  # (P,)
    take: NDArray[np.int32]  # (P,) tracks that the net takes from that edge


class Dual(NamedTuple):
    """The prices of the linear program, and working memory."""

    capacity: NDArray[np.float64]  # (E,) in tracks
    price: NDArray[np.float64]  # (E,) from 0 to 1, per track
    total: NDArray[np.float64]  # (E,) sum of the prices of all iterations
    load: NDArray[np.float64]  # (E,) tracks in use by the shares
    next_load: NDArray[np.float64]  # (E,)
    values: NDArray[np.float64]  # (C,)
    step: NDArray[np.float64]  # (1,)


@compiled
def _collect(problem: ProblemArrays, routing: Routing, columns: Columns, begin: int) -> int:
    """Adds the nets' trees as columns from place ``begin`` on; returns the first without room."""
    for index in range(begin, len(routing.order)):
        net = routing.order[index]
        first = routing.start[net]
        last = first + routing.length[net]
        mark = i64(0)
        for i in range(first, last):
            edge = i64(routing.edge[i])
            if edge % AXES == VIA_AXIS:
                continue  # has no capacity
            mark += i64(mixed(np.uint64((edge + 1) * np.int64(GOLDEN))))
        column = i64(columns.latest[net])
        while column >= 0 and columns.mark[column] != mark:
            column = i64(columns.before[column])
        if column < 0:
            column, place = columns.filled[0], columns.filled[1]
            if column == len(columns.mark) or place + last - first > len(columns.edge):
                return index
            columns.net[column], columns.mark[column] = net, mark
            columns.before[column] = columns.latest[net]
            columns.share[column] = 1.0 if columns.latest[net] < 0 else 0.0
            columns.latest[net] = column
            for i in range(first, last):
                edge = i64(routing.edge[i])
                gcell = edge // AXES
                if edge - AXES * gcell == VIA_AXIS:
                    continue
                layer = problem.position[gcell, VIA_AXIS]
                columns.edge[place], columns.take[place] = edge, problem.demand[net, layer]
                place += 1
            columns.first[column + 1] = place
            columns.filled[0], columns.filled[1] = column + 1, place
        columns.held[net] = column
    return len(routing.order)


@compiled
def _relax(columns: Columns, dual: Dual, iterations: int) -> float:
    """Goes on with the linear program; returns the overflow of the shares, in tracks."""
    latest, before, first = columns.latest, columns.before, columns.first
    share, next_share = columns.share, columns.next_share
    edge_of, take, capacity = columns.edge, columns.take, dual.capacity
    price, total, load, next_load = dual.price, dual.total, dual.load, dual.next_load
    values, edges, count = dual.values, len(dual.price), columns.filled[0]
    for edge in range(edges):
        load[edge] = 0.0
    for column in range(count):
        if share[column] > 0:
            for i in range(first[column], first[column + 1]):
                load[edge_of[i]] += take[i] * share[column]
    step = dual.step[0]
    for _ in range(iterations):
        for edge in range(edges):
            next_load[edge] = 0.0
        share_change = 0.0
        for net in range(len(latest)):
            # A step down the prices, then to the nearest shares that sum to 1 (Held, Wolfe and
            # Crowder, "Validation of subgradient optimization", Mathematical Programming 6, 1974).
            size = 0
            column = i64(latest[net])
            while column >= 0:
                cost = 0.0
                for i in range(first[column], first[column + 1]):
                    cost += price[edge_of[i]] * take[i]
                value = share[column] - step / _RATIO * cost
                next_share[column] = value
                at = size
                while at > 0 and values[at - 1] < value:
                    values[at] = values[at - 1]
                    at -= 1
                values[at] = value
                size += 1
                column = i64(before[column])
            sum_of_largest, shift = 0.0, 0.0
            for k in range(size):
                sum_of_largest += values[k]
                if values[k] * (k + 1) <= sum_of_largest - 1.0:
                    break
                shift = (sum_of_largest - 1.0) / (k + 1)
            column = i64(latest[net])
            while column >= 0:
                value = max(next_share[column] - shift, 0.0)
                share_change += (value - share[column]) ** 2
                share[column] = value
                if value > 0:
                    for i in range(first[column], first[column + 1]):
                        next_load[edge_of[i]] += take[i] * value
                column = i64(before[column])
        price_change, cross = 0.0, 0.0
        for edge in range(edges):
            ahead = 2 * next_load[edge] - load[edge] - capacity[edge]
            value = min(max(price[edge] + step * _RATIO * ahead, 0.0), 1.0)
            change = value - price[edge]
            price_change += change * change
            cross += change * (next_load[edge] - load[edge])
            price[edge] = value
            total[edge] += value
            load[edge] = next_load[edge]
        # The step is as long as convergence allows (Applegate and others, "Practical large-scale
        # linear programming using primal-dual hybrid gradient", NeurIPS 2021).
        if cross != 0:
            limit = (_RATIO * share_change + price_change / _RATIO) / (2 * abs(cross))
            step = min(0.95 * limit, 1.05 * step)
    dual.step[0] = step
    overflow = 0.0
    for edge in range(edges):
        overflow += max(load[edge] - capacity[edge], 0.0)
    return overflow


class Relaxation:
    """The linear program over the trees of a search.

    Args:
        problem: the problem.
        routing: the search, as it begins.
        price_scale: what the highest price adds to the cost of an edge, in edges.

    Attributes:
        scarce: whether the last prices tell where tracks are scarce.
    """

    def __init__(self, problem: ProblemArrays, routing: Routing, price_scale: float) -> None:
        nets, edges = len(problem.first) - 1, len(problem.capacity)
        columns, places = _TREES * len(routing.order), _TREES * len(routing.edge) // 4
        self._problem, self._price_scale = problem, price_scale
        self.scarce = True
        self._columns = Columns(
            filled=np.zeros(2, np.int64),
            held=np.full(nets, -1, np.int32),
            latest=np.full(nets, -1, np.int32),
            before=np.empty(columns, np.int32),
            net=np.empty(columns, np.int32),
            mark=np.empty(columns, np.int64),
            first=np.zeros(columns + 1, np.int64),
            share=np.empty(columns),
            next_share=np.empty(columns),
            edge=np.empty(places, np.int32),
            take=np.empty(places, np.int32),
        )
        self._dual = Dual(
            capacity=np.maximum(routing.remaining, 0.0),
            price=np.zeros(edges),
            total=np.zeros(edges),
            load=np.empty(edges),
            next_load=np.empty(edges),
            values=np.empty(columns),
            step=np.array([_FIRST_STEP]),
        )
        self._iterations = self._averaged = 0  # still to do; and in all, until prices are set
        _relax(self._columns, self._dual, 0)  # compiles

    def begin(self, *, first: bool) -> None:
        """Begins to set prices, in the first round or in a later one."""
        self._iterations = self._averaged = _ITERATIONS if first else _LATER
        self._dual.total[:] = 0

    def advance(self, routing: Routing, labels: int) -> bool:
        """Goes on setting prices, about as long as a search that opens so many labels.

        Returns:
            Whether prices are set, or stay what they were if tracks are not scarce.
        """
        columns = self._columns
        work = max(int(columns.filled[1]), 1)
        count = min(max(labels * _PLACES_PER_LABEL // work, 1), self._iterations)
        overflow = _relax(columns, self._dual, count)
        self._iterations -= count
        if self._iterations > 0:
            return False
        self.scarce = overflow >= _LEAST
        if self.scarce:
            routing.price[:] = self._dual.total * (self._price_scale * UNIT / self._averaged)
        return True

    def collect(self, routing: Routing) -> None:
        """Adds the nets' present trees."""
        begin = 0
        while begin < len(routing.order):
            begin = _collect(self._problem, routing, self._columns, begin)
            if begin < len(routing.order):
                self._make_room()

    def _make_room(self) -> None:
        """Drops trees without a share that no net has now; makes more room if many are left."""
        old = self._columns
        count = int(old.filled[0])
        keep = old.share[:count] > 0
        keep[old.held[old.held >= 0]] = True
        kept = np.flatnonzero(keep)
        number = np.cumsum(keep, dtype=np.int32) - 1  # in place of the old one
        length = np.diff(old.first[: count + 1])
        places = np.repeat(keep, length)
        columns, size = len(old.mark), len(old.edge)
        if 2 * len(kept) > columns or 2 * np.count_nonzero(places) > size:
            columns, size = 2 * columns, 2 * size

        net = old.net[kept]
        latest, before = np.full_like(old.latest, -1), np.full(len(kept), -1, np.int32)
        by_net = np.argsort(net, kind="stable")
        same = net[by_net][1:] == net[by_net][:-1]
        before[by_net[1:][same]] = by_net[:-1][same]
        latest[net] = np.arange(len(kept))  # the last one of a net wins
        first = np.append(0, np.cumsum(length[kept]))
        self._columns = Columns(
            filled=np.array([len(kept), first[-1]]),
            held=np.where(old.held >= 0, number[old.held], -1).astype(np.int32),
            latest=latest,
            before=widened(before, columns),
            net=widened(net, columns),
            mark=widened(old.mark[kept], columns),
            first=widened(first, columns + 1),
            share=widened(old.share[kept], columns),
            next_share=np.empty(columns),
            edge=widened(old.edge[: len(places)][places], size),
            take=widened(old.take[: len(places)][places], size),
        )
        self._dual = self._dual._replace(values=np.empty(columns))
