"""The cost of the ISPD 2024 contest as what is minimised (``cost: ispd2024``).

Nets then pay for the length of their wires, for vias, and for what both add to the cost of overflow
(:func:`~policies.routers.pathfinder.kernels.use_cost`). Apart from rounding, and from what edges
without use cost, the length of a solution is its cost by the contest's rules
(:func:`marouting.problem.contest.contest_cost`); there is no overflow beside that.
"""

import numpy as np
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution
from marouting.problem.chip import Contest
from marouting.problem.contest import contest_of, usable, uses_of
from marouting.problem.grid import AXES, VIA_AXIS
from policies.routers.pathfinder.state import UNIT, ProblemArrays, Routing


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
    tracks, closed = _tracks(contest)
    overflow_cost = contest.overflow_cost * UNIT / usual
    overflow_cost[0] = 0.0
    capacity = np.where(closed, -1, arrays.capacity)
    capacity.setflags(write=False)
    routing.remaining[:] = capacity
    taken = np.zeros_like(tracks)
    if problem.kept is not None:
        uses = uses_of(Solution.of_uses(problem.kept.whole, *problem.kept.uses))
        for z, axis in enumerate(contest.axis):
            taken[..., z, axis] = uses.half_tracks[..., z] / 2
    return (
        arrays._replace(
            capacity=capacity,
            wire=wire,
            height=np.arange(problem.grid[VIA_AXIS]) * round(contest.via_cost * UNIT / usual),
            overflow_cost=overflow_cost,
            tracks=tracks.reshape(-1),
            along=contest.axis.astype(np.int64),
            contest=True,
            crowding=1.0,
        ),
        routing._replace(vias=taken.reshape(-1)),
    )


def _tracks(contest: Contest) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(X, Y, Z, 3) capacity of every edge, and (E,) the edges of layers without wires.

    Capacities are what controls leave, with their fractions of tracks. Layers that have lost all of
    it are closed, unless wires along their axis have no other; their vias are counted by the files'
    capacity.
    """
    before, left = usable(contest.capacity), usable(contest.left)
    had, has = (np.max(tracks, axis=(0, 1))[:, None] > 0 for tracks in (before, left))
    along = np.equal.outer(contest.axis, np.arange(AXES))  # (Z, 3)
    closed = along & had & ~has & np.max(along & has, axis=0)
    tracks = np.where(np.max(closed, axis=1), before, left)[..., None] * along
    return tracks, np.broadcast_to(closed, tracks.shape).reshape(-1)
