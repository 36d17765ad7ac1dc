"""How much of each edge's capacity a solution uses: the numbers behind the paper's figures."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution


class UtilisationMaps(NamedTuple):
    """The utilisation of the edges in each direction, summed over all layers.

    Attributes:
        via: (X, Y) int64, vias in use at each column of Gcells, counted once per net.
        vertical: (X, Y − 1) float64, demand / capacity in % of the edges from row y to y + 1; NaN
            where both are zero, infinite where there is demand without capacity.
        horizontal: (X − 1, Y) float64, the same from column x to x + 1.
        vertical_overflow: (X, Y − 1) bool, whether the edge overflows on any layer.
        horizontal_overflow: (X − 1, Y) bool, likewise.
    """

    via: NDArray[np.int64]
    vertical: NDArray[np.float64]
    horizontal: NDArray[np.float64]
    vertical_overflow: NDArray[np.bool_]
    horizontal_overflow: NDArray[np.bool_]


def utilisation_maps(problem: Problem, solution: Solution) -> UtilisationMaps:
    """The utilisation in each direction; raises InputError if the grids differ."""
    shape = (*problem.grid, AXES)
    demand = demand_on(problem, solution).reshape(shape)
    _, used = solution.uses
    uses = np.bincount(used, minlength=demand.size).reshape(shape)
    capacity = problem.capacity.astype(np.int64).reshape(shape)

    def direction(axis: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        part = (slice(-1), slice(None))[:: 1 if axis == 0 else -1]
        wanted, offered = demand[*part, :, axis], capacity[*part, :, axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            percent = 100 * wanted.sum(axis=2) / offered.sum(axis=2)
        return percent, np.any(wanted > offered, axis=2)

    horizontal, horizontal_overflow = direction(0)
    vertical, vertical_overflow = direction(1)
    return UtilisationMaps(
        uses[..., VIA_AXIS].sum(axis=2),
        vertical,
        horizontal,
        vertical_overflow,
        horizontal_overflow,
    )


def histogram_counts(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """Counts the edges by utilisation, without vias and edges that have no capacity.

    Returns:
        (2, 12) int64: horizontal and vertical edges with utilisation 0 to below 10 %, …, 90 to
        below 100 %, exactly 100 %, above 100 %.
    """
    edge = routable_edges(problem)
    demand, capacity = demand_on(problem, solution)[edge], problem.capacity[edge].astype(np.int64)
    # In integers: 29 of 100 tracks are exactly 29 %.
    tenth = np.minimum(10 * demand // capacity, 10) + (demand > capacity)
    return np.stack([np.bincount(tenth[edge % AXES == axis], minlength=12) for axis in (0, 1)])


def depleted_edges(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """The edges with capacity whose capacity the solution uses up or exceeds.

    Returns:
        Sorted edge numbers, int64.
    """
    edge = routable_edges(problem)
    return edge[demand_on(problem, solution)[edge] >= problem.capacity[edge]]


def problem_type(problem: Problem, solution: Solution) -> Literal["I", "II"]:
    """The type of a problem (paper, section "Conjoint Optimization").

    Args:
        problem: the problem.
        solution: sequential A*'s solution.

    Returns:
        ``II`` if the capacity of an edge is used up (partial edge depletion), otherwise ``I``.
    """
    return "II" if len(depleted_edges(problem, solution)) else "I"


def demand_on(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """(E,) the solution's demand in tracks; raises InputError unless the grids are the same."""
    if solution.problem.grid != problem.grid:
        raise InputError(
            f"solution: expected one for the grid {problem.grid}, found {solution.problem.grid}"
        )
    return solution.edge_demand


def stray_edges(problem: Problem, solution: Solution) -> int:
    """The number of edges without capacity that are used: overflow that no percentage shows."""
    return int(np.count_nonzero((problem.capacity == 0) & (demand_on(problem, solution) > 0)))


def routable_edges(problem: Problem) -> NDArray[np.int64]:
    """(k,) int64, the numbers of the edges along x and y that have capacity, ascending."""
    along = np.arange(len(problem.capacity)) % AXES != VIA_AXIS
    return np.flatnonzero(along & (problem.capacity > 0)).astype(np.int64)
