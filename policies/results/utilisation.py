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


def congestion(
    problem: Problem, solution: Solution, most: int = MOST_FIELDS
) -> tuple[NDArray[np.float64], int]:
    """Demand / capacity in %, of the fullest edge in each field of each layer.

    Args:
        problem: the problem, which gives the capacities.
        solution: the routes.
        most: the most fields along x and y; on longer grids a field is a square of Gcells.

    Returns:
        (Z, 2, X, Y) float64, of the edges from each Gcell towards +x and +y; NaN without capacity
        or demand, infinite for demand without capacity. Then how many Gcells a field is wide and
        high, by which X and Y are divided, rounded up.
    """
    columns, rows, layers = problem.grid
    side = -(-max(columns, rows) // most)
    found = np.full((layers, VIA_AXIS, -(-columns // side), -(-rows // side)), np.nan)

    def at(edges: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
        x, y = np.divmod(edges // (AXES * layers), rows)
        return edges // AXES % layers, edges % AXES, x // side, y // side

    # Where there is capacity and no demand; a layer's edges are alike but for adjustments.
    found[problem.layer_capacity[:, :VIA_AXIS] > 0] = 0
    adjusted, capacity = problem.adjusted
    inside = adjusted % AXES != VIA_AXIS
    if side == 1:
        found[at(adjusted[inside])] = np.where(capacity[inside] > 0, 0, np.nan)
    else:
        np.fmax.at(found, at(adjusted[inside]), np.where(capacity[inside] > 0, 0, np.nan))
    edge, demand = _used_edges(problem, solution)
    used = (edge % AXES != VIA_AXIS) & (demand > 0)
    edge, demand = edge[used], demand[used]
    with np.errstate(divide="ignore"):
        share = 100 * demand / problem.capacity_of(edge)
    np.fmax.at(found, at(edge), share)
    return found, side


def free_tracks(problem: Problem, most: int = MOST_FIELDS) -> NDArray[np.float64]:
    """Capacity in % of what most edges of a layer have, of the edge with the least in each field.

    Where it is below 100, shapes block tracks: cells, macros, stripes of power grids. It is not
    above 100: the last Gcells of a row may be larger than others.

    Args:
        problem: the problem.
        most: the most fields along x and y, as in :func:`congestion`.

    Returns:
        (Z, X, Y) float64; NaN in layers without capacity.
    """
    columns, rows, layers = problem.grid
    side = -(-max(columns, rows) // most)
    found = np.full((layers, VIA_AXIS, -(-columns // side), -(-rows // side)), np.nan)
    adjusted, capacity = problem.adjusted
    layer, axis = adjusted // AXES % layers, adjusted % AXES
    usual = problem.layer_capacity[:, :VIA_AXIS]
    largest = np.zeros(usual.shape)
    np.maximum.at(largest, (layer, axis), capacity)
    whole = np.where(usual > 0, usual, largest)
    whole[whole == 0] = np.nan
    found[:] = (100 * usual / whole)[..., None, None]
    x, y = np.divmod(adjusted // (AXES * layers), rows)
    place = (layer, axis, x // side, y // side)
    share = np.minimum(100 * capacity / whole[layer, axis], 100)
    if side > 1:
        np.fmin.at(found, place, share)
    else:  # the last edges of a row lead off the grid: their fields look as those before
        found[place] = share
        found[:, 0, -1] = found[:, 0, max(0, columns - 2)]
        found[:, 1, :, -1] = found[:, 1, :, max(0, rows - 2)]
    shown: NDArray[np.float64] = np.fmin.reduce(found, axis=1)
    return shown


def via_counts(solution: Solution, side: int) -> NDArray[np.int64]:
    """(X, Y) int64, the vias in use in every field of ``side`` Gcells, each once for every net."""
    columns, rows, layers = solution.problem.grid
    _, edge = solution.uses
    x, y = np.divmod(edge[edge % AXES == VIA_AXIS] // (AXES * layers), rows)
    found = np.zeros((-(-columns // side), -(-rows // side)), np.int64)
    np.add.at(found, (x // side, y // side), 1)
    return found


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
