"""Linear and integer programs over candidate columns, as scipy's HiGHS takes them; step 2."""

import math
import operator
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.optimize import Bounds, LinearConstraint
from scipy.sparse import coo_array, csr_array, eye_array, vstack

from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.base import LEFT_ALONE
from policies.routers.optimal.candidates import Candidates

# scipy's stubs accept less than these functions do.
hstack: Any = sparse.hstack
linprog: Any = optimize.linprog
milp: Any = optimize.milp


Item = TypeVar("Item")
Found = TypeVar("Found")


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

    def while_left(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items until the time is up; it is looked at once for every _FEW of them."""
        for number, item in enumerate(items, 1):
            yield item
            if number % _FEW == 0 and self.passed:
                return

    def bounded(self, call: Callable[[], Found]) -> Found | None:
        """What a call returns, or None if the time is up before it does.

        HiGHS looks at the clock, but not in all that it does, and large programs take long to be
        built. So the call is made in a thread, which is left alone when the time is up. While it
        is under way, Ctrl-C is answered.
        """
        answers: queue.SimpleQueue[Found | BaseException] = queue.SimpleQueue()

        def work() -> None:
            try:
                answers.put(call())
            except BaseException as error:
                answers.put(error)

        threading.Thread(target=work, name=LEFT_ALONE, daemon=True).start()
        try:
            left = min(max(self.left, 0.0) + _PATIENCE, threading.TIMEOUT_MAX)
            answer = answers.get(timeout=left)
        except queue.Empty:
            return None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    @property
    def solver_options(self) -> dict[str, float]:
        """The time left, as an option for scipy's solvers."""
        return {} if self.left == math.inf else {"time_limit": max(self.left, 0.0)}


_FEW = 64
"""Items between two looks at the clock; so many never take long."""

_PATIENCE = 0.2
"""Seconds that a solver gets to return what it has when the time is up."""


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


class Program:
    """Least cost for columns, with overflow at a price.

    To the columns it adds one for the overflow of every wire, and one for the overflow beyond the
    objective's. The first W inequalities are the capacities.

    Args:
        columns: what there is to choose from.
        capacity: (W,) int64, of the wires, in tracks.
        objective: what is minimised.
        excess: cost of a track of overflow beyond the objective's; None to forbid it.
    """

    def __init__(
        self,
        columns: Columns,
        capacity: NDArray[np.int64],
        objective: Objective,
        excess: float | None,
    ) -> None:
        wires, own = len(capacity), len(columns.length)
        overflow = np.append(np.zeros(wires), excess or 0)
        self._cost = np.concatenate((columns.length * objective.wirelength, overflow))
        width = len(self._cost)
        self._upper = np.full(width, np.inf)
        self._upper[:own] = 1
        self._upper[-1] = 0 if excess is None else np.inf
        self._whole = np.append(columns.whole, np.zeros(wires + 1))
        rows = (
            hstack((columns.tracks, -eye_array(wires), csr_array((wires, 1)))),
            hstack((csr_array((1, own)), csr_array(np.ones((1, wires))), csr_array([[-1.0]]))),
            widened(columns.below, width),
        )
        self._below = csr_array(vstack(rows))
        self._limit = np.concatenate((capacity, [objective.overflow], columns.limit))
        self._equal, self._right = widened(columns.equal, width), columns.right
        self._wires = wires

    def solve_relaxed(self, deadline: Deadline) -> tuple[float, NDArray[np.float64]] | None:
        """Solves the linear relaxation.

        Returns:
            The least cost, and (W,) by how much one more track of a wire would reduce it; None if
            the solver did not finish.
        """
        result = linprog(
            self._cost,
            A_ub=self._below,
            b_ub=self._limit,
            A_eq=self._equal,
            b_eq=self._right,
            options=deadline.solver_options,
        )
        if result.status != 0:
            return None
        return result.fun, -result.ineqlin.marginals[: self._wires]

    def solve_whole(self, deadline: Deadline, **options: float) -> Any:
        """Solves the program in whole numbers where ``Columns.whole`` asks for them.

        Returns:
            A result of :func:`scipy.optimize.milp`; its ``x`` starts with the columns.
        """
        return milp(
            self._cost,
            integrality=self._whole,
            bounds=Bounds(0, self._upper),
            constraints=[
                LinearConstraint(self._below, -np.inf, self._limit),
                LinearConstraint(self._equal, self._right, self._right),
            ],
            options={"mip_rel_gap": 0.0, **deadline.solver_options, **options},
        )


def sparse_matrix(values: Any, rows: Any, columns: Any, height: int, width: int) -> csr_array:
    """A (height, width) float64 matrix from its entries; equal positions add up."""
    return csr_array(coo_array((values, (rows, columns)), shape=(height, width), dtype=float))


def widened(matrix: Any, width: int) -> csr_array:
    """A sparse matrix extended to ``width`` columns by zeros."""
    more = csr_array((matrix.shape[0], width - matrix.shape[1]))
    return csr_array(hstack((matrix, more)))


def choose(candidates: Candidates, objective: Objective, deadline: Deadline) -> None:
    """Chooses trees for least overflow beyond the objective's, then for least length.

    The solver stops at the first node of its search tree: hard cases are left to step 3. What it
    finds is added to the candidates.
    """

    def solved() -> Any:
        columns = tree_columns(candidates)
        longest = np.zeros(len(candidates.nets))
        np.maximum.at(longest, [net for net, _ in candidates.trees], columns.length)
        excess = 1 + longest.sum()
        program = Program(columns, candidates.capacity, objective, excess)
        return program.solve_whole(deadline, node_limit=1)

    result = deadline.bounded(solved)
    if result is not None and result.x is not None:
        trees = candidates.trees
        chosen = (trees[i] for i in np.flatnonzero(result.x[: len(trees)] > 0.5))
        candidates.add_routes([tree for _, tree in sorted(chosen, key=operator.itemgetter(0))])
