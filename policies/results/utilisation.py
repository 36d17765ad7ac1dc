"""How much of each edge's capacity a solution uses: the numbers behind the paper's figures.

They take memory for the edges in use and for those with adjustments, not for every edge of the
grid.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution

MOST_FIELDS = 1024
"""The most fields of a map along x and y; on larger grids a field shows several Gcells."""


class UtilisationMaps(NamedTuple):
    """The utilisation of the edges in each direction, summed over all layers.

    A field shows one Gcell or edge; on grids longer than MOST_FIELDS, all those of a square.

    Attributes:
        via: (X, Y) int64, vias in use at each column of Gcells, counted once per net.
        vertical: (X, Y − 1) float64, demand / capacity in % of the edges from row y to y + 1; NaN
            where both are zero, infinite where there is demand without capacity.
        horizontal: (X − 1, Y) float64, the same from column x to x + 1.
        vertical_overflow: (X, Y − 1) int64, the overflow of these edges in tracks: each layer's
            demand above its capacity.
        horizontal_overflow: (X − 1, Y) int64, likewise.
        side: how many Gcells a field is wide and high. All shapes are divided by it, rounded up.
    """

    via: NDArray[np.int64]
    vertical: NDArray[np.float64]
    horizontal: NDArray[np.float64]
    vertical_overflow: NDArray[np.int64]
    horizontal_overflow: NDArray[np.int64]
    side: int


def utilisation_maps(problem: Problem, solution: Solution) -> UtilisationMaps:
    """The utilisation in each direction; raises InputError if the grids differ."""
    edge, demand = _used_edges(problem, solution)
    adjusted, adjusted_capacity = problem.adjusted
    unadjusted = problem.layer_capacity.astype(np.int64)
    columns, rows, layers = problem.grid
    side = -(-max(columns, rows) // MOST_FIELDS)

    def fields(edges: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        x, y = np.divmod(edges // (AXES * layers), rows)
        return x // side, y // side

    def counts(length: int) -> NDArray[np.int64]:
        """How many of so many edges in a row are in each field."""
        return np.diff(np.arange(0, length + side, side).clip(max=length))

    def direction(axis: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        offered = unadjusted[:, axis].sum() * np.outer(
            counts(columns - (axis == 0)), counts(rows - (axis == 1))
        )
        own = adjusted[adjusted % AXES == axis]
        more = adjusted_capacity[adjusted % AXES == axis] - unadjusted[own // AXES % layers, axis]
        np.add.at(offered, fields(own), more)
        taken, tracks = edge[edge % AXES == axis], demand[edge % AXES == axis]
        wanted, overflow = np.zeros_like(offered), np.zeros(offered.shape, np.int64)
        np.add.at(wanted, fields(taken), tracks)
        np.add.at(overflow, fields(taken), np.maximum(tracks - problem.capacity_of(taken), 0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return 100 * wanted / offered, overflow

    horizontal, horizontal_overflow = direction(0)
    vertical, vertical_overflow = direction(1)
    via = np.zeros((len(counts(columns)), len(counts(rows))), np.int64)
    _, used = solution.uses
    np.add.at(via, fields(used[used % AXES == VIA_AXIS]), 1)
    return UtilisationMaps(via, vertical, horizontal, vertical_overflow, horizontal_overflow, side)


class EdgeGroups(NamedTuple):
    """The edges inside layers: one by one where used or adjusted, the others by layer and axis.

    Attributes:
        edge: (k,) int64, the edge's number, ascending; -1 for several edges, which come last.
        axis: (k,) int64, 0 along x, 1 along y.
        capacity: (k,) int64, of each edge.
        demand: (k,) int64, on each edge.
        number: (k,) int64, how many edges they are.
    """

    edge: NDArray[np.int64]
    axis: NDArray[np.int64]
    capacity: NDArray[np.int64]
    demand: NDArray[np.int64]
    number: NDArray[np.int64]

    def where(self, chosen: NDArray[np.bool_]) -> "EdgeGroups":
        """Some of the groups."""
        return EdgeGroups._make(column[chosen] for column in self)


def edge_groups(problem: Problem, solution: Solution) -> EdgeGroups:
    """Capacity and demand of all edges inside layers; raises InputError if the grids differ."""
    used, tracks = _used_edges(problem, solution)
    single = np.union1d(used, problem.adjusted[0])
    single = single[single % AXES != VIA_AXIS]
    demand = np.zeros_like(single)
    demand[np.searchsorted(single, used[used % AXES != VIA_AXIS])] = tracks[used % AXES != VIA_AXIS]
    columns, rows, layers = problem.grid
    others = np.tile([(columns - 1) * rows, columns * (rows - 1)], (layers, 1))
    np.subtract.at(others, (single // AXES % layers, single % AXES), 1)
    nothing = np.zeros(others.size, np.int64)
    return EdgeGroups(
        np.concatenate((single, nothing - 1)),
        np.concatenate((single % AXES, np.tile([0, 1], layers))),
        np.concatenate((problem.capacity_of(single), problem.layer_capacity[:, :VIA_AXIS].ravel())),
        np.concatenate((demand, nothing)),
        np.concatenate((np.ones_like(single), others.ravel())),
    )


def routable_edges(problem: Problem, solution: Solution) -> EdgeGroups:
    """The :func:`edge_groups` with capacity."""
    groups = edge_groups(problem, solution)
    return groups.where((groups.capacity > 0) & (groups.number > 0))


def histogram_counts(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """Counts the edges by utilisation, without vias and edges that have no capacity.

    Returns:
        (2, 12) int64: horizontal and vertical edges with utilisation 0 to below 10 %, …, 90 to
        below 100 %, exactly 100 %, above 100 %.
    """
    _, axis, capacity, demand, number = routable_edges(problem, solution)
    counts = np.zeros((VIA_AXIS, 12), np.int64)
    # In integers: 29 of 100 tracks are exactly 29 %.
    np.add.at(counts, (axis, np.minimum(10 * demand // capacity, 10) + (demand > capacity)), number)
    return counts


def depleted_edges(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """The edges with capacity whose capacity the solution uses up or exceeds.

    Returns:
        Sorted edge numbers, int64.
    """
    groups = routable_edges(problem, solution)
    return groups.where(groups.demand >= groups.capacity).edge


def overflowed_edges(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """The edges whose demand exceeds their capacity: sorted edge numbers, int64."""
    groups = edge_groups(problem, solution)
    return groups.where(groups.demand > groups.capacity).edge


def problem_type(problem: Problem, solution: Solution) -> Literal["I", "II"]:
    """The type of a problem (paper, section "Conjoint Optimization").

    Args:
        problem: the problem.
        solution: sequential A*'s solution.

    Returns:
        ``II`` if the capacity of an edge is used up (partial edge depletion), otherwise ``I``.
    """
    return "II" if len(depleted_edges(problem, solution)) else "I"


def stray_edges(problem: Problem, solution: Solution) -> int:
    """The number of edges without capacity that are used: overflow that no percentage shows."""
    groups = edge_groups(problem, solution)
    return int(np.count_nonzero((groups.capacity == 0) & (groups.demand > 0)))


def _used_edges(
    problem: Problem, solution: Solution
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """:attr:`Solution.used_edges`; raises InputError unless the grids are the same."""
    if solution.problem.grid != problem.grid:
        raise InputError(
            f"solution: expected one for the grid {problem.grid}, found {solution.problem.grid}"
        )
    return solution.used_edges
