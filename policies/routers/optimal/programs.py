"""Linear and integer programs over candidate columns, as scipy's HiGHS takes them."""

import math
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.optimize import Bounds, LinearConstraint
from scipy.sparse import coo_array, csr_array, eye_array, vstack

from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.optimal.candidates import Candidates

# scipy's stubs accept less than these functions do.
hstack: Any = sparse.hstack
linprog: Any = optimize.linprog
milp: Any = optimize.milp


class Deadline:
    """The moment when the time is up.

    Args:
        seconds: from now; None for no limit.
    """

    def __init__(self, seconds: float | None) -> None:
        self._at = math.inf if seconds is None else time.monotonic() + seconds

    @property
    def left(self) -> float:
        """Seconds left, negative when the time is up; infinite without a limit."""
        return self._at - time.monotonic()

    @property
    def passed(self) -> bool:
        """Whether the time is up."""
        return self.left <= 0

    @property
    def solver_options(self) -> dict[str, float]:
        """The time left, as an option for scipy's solvers."""
        return {} if self.left == math.inf else {"time_limit": max(self.left, 0.0)}


class Objective(NamedTuple):
    """What is minimised: overflow, or the wirelength of solutions with at most some overflow.

    Its ``wirelength`` is also the index of the minimised figure in a score.
    """

    wirelength: bool
    overflow: int  # in tracks; 0 if overflow is minimised


OVERFLOW = Objective(wirelength=False, overflow=0)


class Columns(NamedTuple):
    """What a program chooses from: C columns x from 0 to 1 over W wires.

    They have to satisfy ``equal @ x == right`` and ``below @ x <= limit``.
    """

    length: NDArray[np.float64]  # (C,) wirelength
    tracks: csr_array  # (W, C) tracks taken from each wire
    whole: NDArray[np.float64]  # (C,) 1 where x has to be a whole number, otherwise 0
    equal: csr_array  # (equations, C)
    right: NDArray[np.float64]  # (equations,)
    below: csr_array  # (inequalities, C)
    limit: NDArray[np.float64]  # (inequalities,)


def tree_columns(candidates: Candidates) -> Columns:
    """A column for every candidate tree; the columns of a net add up to 1."""
    net, length, edge = candidates.flat()
    trees, nets = len(net), len(candidates.nets)
    column = np.repeat(np.arange(trees), length)
    wired = edge % AXES != VIA_AXIS
    wire, column = candidates.wire_of[edge[wired]], column[wired]
    taken = candidates.demand[candidates.kind[net[column]], wire]
    return Columns(
        length=length.astype(float),
        tracks=sparse_matrix(taken, wire, column, len(candidates.wires), trees),
        whole=np.ones(trees),
        equal=sparse_matrix(np.ones(trees), net, np.arange(trees), nets, trees),
        right=np.ones(nets),
        below=csr_array((0, trees)),
        limit=np.empty(0),
    )


def solve_relaxed(
    columns: Columns,
    capacity: NDArray[np.int64],
    objective: Objective,
    excess: float,
    deadline: Deadline,
) -> tuple[float, NDArray[np.float64]] | None:
    """Solves the linear relaxation of a program.

    Args:
        columns: what there is to choose from.
        capacity: (W,) of the wires, in tracks.
        objective: what is minimised.
        excess: cost of a track of overflow beyond the objective's.
        deadline: when to stop.

    Returns:
        The least cost, and (W,) by how much one more track of a wire would reduce it; None if the
        solver did not finish.
    """
    cost, _, below, limit = _program(columns, capacity, objective, excess)
    result = linprog(
        cost,
        A_ub=below,
        b_ub=limit,
        A_eq=widened(columns.equal, len(cost)),
        b_eq=columns.right,
        options=deadline.solver_options,
    )
    if result.status != 0:
        return None
    return result.fun, -result.ineqlin.marginals[: len(capacity)]


def solve_whole(
    columns: Columns,
    capacity: NDArray[np.int64],
    objective: Objective,
    excess: float | None,
    deadline: Deadline,
    **options: float,
) -> Any:
    """Solves a program in whole numbers.

    Args:
        columns: what there is to choose from.
        capacity: (W,) of the wires, in tracks.
        objective: what is minimised.
        excess: cost of a track of overflow beyond the objective's; None to forbid it.
        deadline: when to stop.
        **options: further options of the solver.

    Returns:
        A result of :func:`scipy.optimize.milp`; its ``x`` starts with the columns.
    """
    cost, upper, below, limit = _program(columns, capacity, objective, excess)
    equal = widened(columns.equal, len(cost))
    return milp(
        cost,
        integrality=np.concatenate((columns.whole, np.zeros(len(cost) - len(columns.whole)))),
        bounds=Bounds(0, upper),
        constraints=[
            LinearConstraint(below, -np.inf, limit),
            LinearConstraint(equal, columns.right, columns.right),
        ],
        options={"mip_rel_gap": 0.0, **deadline.solver_options, **options},
    )


def _program(
    columns: Columns, capacity: NDArray[np.int64], objective: Objective, excess: float | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], csr_array, NDArray[np.float64]]:
    """Adds a column for each wire's overflow and one for the overflow beyond the objective's.

    Returns:
        The cost and the upper bound of each column, and the inequalities as a matrix and its
        limits. The first W inequalities are the capacities.
    """
    wires, own = len(capacity), len(columns.length)
    cost = np.concatenate((columns.length * objective.wirelength, np.zeros(wires), [excess or 0]))
    upper = np.full(own + wires + 1, np.inf)
    upper[:own] = 1
    upper[-1] = 0 if excess is None else np.inf
    rows = (
        hstack((columns.tracks, -eye_array(wires), csr_array((wires, 1)))),
        hstack((csr_array((1, own)), csr_array(np.ones((1, wires))), csr_array([[-1.0]]))),
        widened(columns.below, len(cost)),
    )
    limit = np.concatenate((capacity, [objective.overflow], columns.limit))
    return cost, upper, csr_array(vstack(rows)), limit


def sparse_matrix(values: Any, rows: Any, columns: Any, height: int, width: int) -> csr_array:
    """A (height, width) float64 matrix from its entries; equal positions add up."""
    return csr_array(coo_array((values, (rows, columns)), shape=(height, width), dtype=float))


def widened(matrix: Any, width: int) -> csr_array:
    """A sparse matrix extended to ``width`` columns by zeros."""
    more = csr_array((matrix.shape[0], width - matrix.shape[1]))
    return csr_array(hstack((matrix, more)))
