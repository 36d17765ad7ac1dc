"""The cost of the ISPD 2024 contest as what is minimised (``cost: ispd2024``).

Nets then pay for the length of their wires, for vias, and for what their wires add to the cost of
overflow (:func:`~policies.routers.pathfinder.kernels.use_cost`). The tracks that vias take are
counted after every pass and stay the same during the next one. The result is the best solution
after any pass by the contest's own cost (:func:`marouting.problem.contest.contest_cost`).
"""

import numpy as np

from marouting import InputError, Problem, Solution
from marouting.kernels import compiled, i64
from marouting.problem.contest import contest_cost, contest_of, tracks_of_vias, usable
from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.pathfinder.kernels import use_cost
from policies.routers.pathfinder.state import UNIT, ProblemArrays, Routing, present_solution
from policies.routers.pathfinder.trees import tree_length


def with_contest(
    problem: Problem, arrays: ProblemArrays, routing: Routing
) -> tuple[ProblemArrays, Routing]:
    """The arrays with the contest's costs, of which a wire's usual one is UNIT.

    Raises:
        InputError: the problem is none of the contest.
    """
    try:
        contest = contest_of(problem)
    except InputError as error:
        raise InputError(f"cost: ispd2024: {error}") from None
    lengths = [contest.wire_cost * length for length in (contest.x_length, contest.y_length)]
    usual = float(np.median(np.concatenate(lengths))) or contest.via_cost or 1.0
    wire = np.zeros((2, max(problem.grid[:2])), np.int64)
    for axis, length in enumerate(lengths):
        wire[axis, : len(length)] = np.rint(length * UNIT / usual)
    tracks = np.zeros((*problem.grid, AXES))
    for z, axis in enumerate(contest.axis):
        tracks[..., z, axis] = usable(contest.capacity[..., z])
    overflow_cost = contest.overflow_cost * UNIT / usual
    overflow_cost[0] = 0.0
    routing.progress["contest"], routing.progress["crowding"] = 1, 1.0
    return (
        arrays._replace(
            wire=wire,
            height=np.arange(problem.grid[VIA_AXIS]) * round(contest.via_cost * UNIT / usual),
            overflow_cost=overflow_cost,
            tracks=tracks.reshape(-1),
        ),
        routing._replace(vias=np.zeros(len(routing.price))),
    )


class Judge:
    """Keeps the best solution by the contest's cost.

    Attributes:
        solution: that solution; None before the first pass has ended.
        cost: its cost.
    """

    def __init__(self, problem: Problem, arrays: ProblemArrays) -> None:
        self._problem, self._arrays = problem, arrays
        self.solution: Solution | None = None
        self.cost = np.inf

    def look(self, routing: Routing) -> None:
        """Judges the present trees, and counts the tracks that their vias take."""
        solution = present_solution(self._problem, routing)
        cost = contest_cost(solution).total
        if cost < self.cost:
            self.solution, self.cost = solution, cost
        axis = contest_of(self._problem).axis
        vias = np.zeros((*self._problem.grid, AXES))
        for z, halves in enumerate(np.moveaxis(tracks_of_vias(solution), 2, 0)):
            vias[..., z, axis[z]] = halves / 2
        routing.vias[:] = vias.reshape(-1)
        length = _whole_length(self._arrays, routing)
        for name in ("length", "last_length", "best_length"):
            routing.progress[name] = length


@compiled
def _whole_length(problem: ProblemArrays, routing: Routing) -> int:
    """The length of all trees and what all edges' use costs."""
    length = i64(0)
    for net in range(len(routing.length)):
        length += tree_length(problem, routing, i64(net))
    for edge in range(len(problem.capacity)):
        if problem.capacity[edge] >= 0 and edge % AXES != VIA_AXIS:
            length += use_cost(problem, routing, i64(edge), i64(0))
    return length
