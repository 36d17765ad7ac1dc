"""What an agent sees, and the global state.

The paper's observation is here; :mod:`marouting.batch.window` has one that fits every grid. You can
also write your own: any object with the methods of :class:`Observation`. It works in all interfaces
of the environment, in the batch and in training; see :func:`marouting.register`.

Optional methods:

* ``state(games, …)`` and ``state_space(…)`` define the global state; their arguments are those of
  :meth:`marouting.columns.Games.state` and :func:`state_space`.
* ``move_order``, for an observation that is mirrored like :mod:`marouting.batch.window`: learners
  then see masks and choose moves in the mirrored frame; see :func:`move_order_of`. Environments
  always use the moves of the grid.

An observation whose agents see no further than their surroundings says so by an attribute
``local_radius``, a whole number from 0; see :func:`local_radius_of`. Comparisons of decentralised
policies need such observations, and :func:`marouting.batch.locality.check_local` verifies them.

docs/own-components.md has a worked example. A simpler form works in the environments, but not in
the batch or in training: instead of ``write``, a method ``see(game, n)`` that returns what agent n
of a :class:`marouting.game.Game` sees.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from marouting.checks import check_fields
from marouting.columns import Games, check_rows
from marouting.config import check
from marouting.errors import InputError
from marouting.game import NOBODY, Game
from marouting.problem.grid import AXES, MOVES, OFF_GRID, VIA_AXIS, Grid, Rows
from marouting.problem.net import is_whole
from marouting.problem.problem import Problem
from marouting.registry import is_ours, register


class Observation(Protocol):
    """What an agent sees of the game."""

    def space(self, problems: Sequence[Problem], overflow: bool) -> Box:
        """The space of one agent's observation.

        Args:
            problems: the problems that will be played.
            overflow: whether a move may cross an edge without enough remaining capacity.

        Returns:
            A float32 box of any shape S, the same for all agents.
        """
        ...

    def write(
        self,
        games: Games,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Writes what K agents see.

        Args:
            games: the games, to be read by columns: ``games.agents["cell"][problems, agents]`` are
                the agents' Gcells, ``games.remaining[problems]`` (K, E) the remaining capacities.
            problems: (K,) int32, the problem of each agent.
            agents: (K,) int32, the agents' numbers; NOBODY (−1) for rows to be filled with zeros.
            out: (K, *S) float32 to be filled. When an agent's task has just ended, this method is
                also called while the agent still stands where it arrived.
        """
        ...


@dataclass(frozen=True)
class PaperObservation:
    """The paper's state, 12 numbers (paper, section "Deep Q-networks Router Implementation").

    The x, y, z of the agent's Gcell; the signed distances to the target in x, y, z; the remaining
    capacity of the edges that the six moves would cross, in the order of
    :class:`marouting.problem.grid.Move`: 0 off the grid, negative for an overflowed edge.

    Attributes:
        via_capacity: the number shown for a via, whose real capacity is unlimited. The authors'
            code starts at 10 (there it runs out; here it does not).
        local_radius: 0, see :func:`local_radius_of`.
    """

    via_capacity: float = 10.0
    local_radius: ClassVar[int] = 0

    def __post_init__(self) -> None:
        check_fields(self, via_capacity=(0, np.inf))

    def space(self, problems: Sequence[Problem], overflow: bool) -> Box:
        """The box of the 12 numbers; see :class:`Observation`."""
        far = np.array(problems[0].grid, np.float32) - 1
        most = np.full(MOVES, max(*map(most_capacity, problems), self.via_capacity), np.float32)
        least = np.zeros(MOVES, np.float32)
        if overflow:
            least -= max(map(most_demand, problems))
        return Box(
            np.concatenate((np.zeros(3, np.float32), -far, least)),
            np.concatenate((far, far, most)),
            dtype=np.float32,
        )

    def write(
        self,
        games: Games,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Fills ``out`` (K, 12); see :class:`Observation`.

        Raises:
            ValueError: there are no such agents.
        """
        check_rows(games, problems, agents, out, AXES + AXES + MOVES)
        grid, who = games.grid, (problems, agents)
        cell, target = games.agents["cell"][who], games.agents["target"][who]
        here = grid.position.take(cell, axis=0)
        edges = grid.edge.take(cell, axis=0)[:, : 2 * VIA_AXIS]
        out[:, :AXES] = here
        out[:, AXES : 2 * AXES] = grid.position.take(target, axis=0) - here
        out[:, 2 * AXES : -2] = games.remaining[problems[:, None], edges]
        has_via = grid.neighbour.take(cell, axis=0)[:, 2 * VIA_AXIS :] != OFF_GRID
        out[:, -2:] = has_via * np.float32(self.via_capacity)
        out[agents == NOBODY] = 0

    def see(self, game: Game, n: int) -> NDArray[np.float32]:
        """(12,) what an agent sees: the same as by columns, and faster for a single agent."""
        left, near = game.remaining, _near(game.grid, self.via_capacity)
        x, y, z, east, west, north, south, up, down = near[game.cell[n]]
        to_x, to_y, to_z = game.grid.position_of[game.target[n]]
        return np.array(
            (
                x, y, z, to_x - x, to_y - y, to_z - z,
                left[east], left[west], left[north], left[south], up, down,
            ),
            np.float32,
        )  # fmt: skip


@functools.lru_cache(maxsize=16)
def _near(grid: Grid, via_capacity: float) -> Rows[tuple[Any, ...]]:
    """By Gcell: x, y, z; the edges of the moves 0 to 3; what is shown for those of 4 and 5."""

    def row_of(cell: int) -> tuple[Any, ...]:
        edges = [edge for edge, _ in grid.ways[cell][: 2 * VIA_AXIS]]
        vias = [via_capacity * (ahead != OFF_GRID) for _, ahead in grid.ways[cell][2 * VIA_AXIS :]]
        return (*grid.position_of[cell], *edges, *vias)

    return Rows(row_of)


CHANNELS = AXES + 2
"""Numbers per Gcell in the global state."""


def state_space(problems: Sequence[Problem], overflow: bool) -> Box:
    """The space of the global state of a problem (:meth:`marouting.columns.Games.state`).

    Returns:
        (X, Y, 5 Z) float32, five numbers per layer. For every Gcell: the remaining capacity of its
        edges towards +x and +y (0 off the grid), the number of nets that use its via towards +z,
        the number of active agents in it, and the number of active agents whose target it is.
    """
    columns, rows, layers = problems[0].grid
    high = np.full(
        (columns, rows, layers, CHANNELS), max(len(p.nets) for p in problems), np.float32
    )
    high[..., :VIA_AXIS] = max(most_capacity(problem) for problem in problems)
    low = np.zeros_like(high)
    if overflow:
        low[..., :VIA_AXIS] -= max(most_demand(problem) for problem in problems)
    shape = (columns, rows, layers * CHANNELS)
    return Box(low.reshape(shape), high.reshape(shape), dtype=np.float32)


def most_capacity(problem: Problem) -> float:
    """The largest capacity of an edge inside a layer."""
    return float(problem.capacity.reshape(-1, AXES)[:, :VIA_AXIS].max())


def most_demand(problem: Problem) -> float:
    """An upper bound for the demand on an edge: every net uses it, in its most demanding layer."""
    return float(problem.net_demand.max(axis=1).sum(dtype=np.int64))


def local_radius_of(observation: Observation) -> int | None:
    """How far the agents of an observation see, in Gcells along x and y, in all layers.

    An agent may see its own net (where it is, its pins, its tasks, its route), the Gcells within
    the radius and the active agents that stand there, and the capacity, remaining capacity and
    history of the edges that touch such a Gcell. It may not see where others are going.

    Returns:
        The observation's ``local_radius``; None if it has none, and agents may see everything.

    Raises:
        InputError: it is neither a whole number from 0 nor None.
    """
    radius: int | None = getattr(observation, "local_radius", None)
    if radius is not None and not (is_whole(radius) and radius >= 0):
        found = f"{type(observation).__name__}.local_radius"
        raise InputError(f"{found}: expected a whole number from 0, or None, found {radius!r}")
    return radius


def has_move_order(observation: Observation) -> bool:
    """Whether an observation has an order of moves of its own."""
    return callable(getattr(observation, "move_order", None))


def move_order_of(
    observation: Observation, obs: NDArray[np.float32], actions: int, messages: int = 1
) -> NDArray[np.int64]:
    """The action on the grid for each action in the frame of a mirrored observation.

    Args:
        observation: with a method ``move_order``.
        obs: (K, *S) float32, what agents saw.
        actions: A; actions that cross no edge, such as ripping up, stay the same.
        messages: how many messages there are to choose from; see :class:`marouting.rules.Rules`.

    Returns:
        (K, A) int64, each row the numbers from 0 to A − 1 in some order.
        ``numpy.take_along_axis(mask, order, -1)`` turns the grid's mask into the observation's.

    Raises:
        InputError: the observation's ``move_order`` gives anything else.
    """
    own: Any = observation
    order = own.move_order(obs)
    if not is_ours(type(observation).__module__):  # to check takes longer than the package's own
        try:
            order = np.asarray(order)
        except ValueError:  # rows of different lengths
            order = np.array(order, object)
        whole = order.shape == (len(obs), MOVES) and order.dtype.kind in "iu"
        if not whole or (np.sort(order) != np.arange(MOVES)).any():
            found = f"{type(observation).__name__}.move_order"
            raise InputError(
                f"{found}: expected the moves 0 to 5, each once, for {len(obs)} agents, "
                f"found {order}"
            )
    return all_actions(order.astype(np.int64), actions, messages)


def all_actions(order: NDArray[np.int64], actions: int, messages: int) -> NDArray[np.int64]:
    """(…, A) int64, an order of the six moves (…, 6) carried on to all actions and messages."""
    if actions == MOVES:
        return order
    moves = actions // messages
    rest = np.broadcast_to(np.arange(MOVES, moves), (*order.shape[:-1], moves - MOVES))
    one = np.concatenate((order, rest), axis=-1)
    return np.concatenate([one + moves * message for message in range(messages)], axis=-1)


def space_of(observation: Observation, problems: Sequence[Problem], overflow: bool) -> Box:
    """The space of what one agent sees; raises InputError if it is not a Box of float32."""
    space = observation.space(problems, overflow)
    fits = isinstance(space, Box) and space.dtype == np.float32 and 0 not in space.shape
    named = f"{type(observation).__name__}.space"
    check("observation", fits, f"a Box of float32 from {named}, found {space!r}")
    return space


def write_rows(
    observation: Observation,
    games: Games,
    problems: NDArray[np.integer],
    agents: NDArray[np.integer],
    out: NDArray[np.float32],
) -> None:
    """Has an observation fill rows; raises InputError if it returns rows of its own instead."""
    returned: Any = observation.write(games, problems, agents, out)  # type: ignore[func-returns-value]
    if returned is not None:
        name = type(observation).__name__
        raise InputError(
            f"observation: expected {name}.write to fill its argument out, and to return nothing"
        )


def seen_by(
    observation: Observation, shape: tuple[int, ...]
) -> Callable[[Game, int], NDArray[np.float32]]:
    """The ``see`` of an observation, which gives new float32 arrays of this shape or InputError."""
    own: Any = observation
    if type(observation) is PaperObservation:  # checks take as long as it does
        return PaperObservation.see.__get__(observation)
    name = f"{type(observation).__name__}.see"

    def see(game: Game, n: int) -> NDArray[np.float32]:
        seen = own.see(game, n)
        try:
            row = np.array(seen, np.float32)
        except (TypeError, ValueError):
            row = np.empty(0, np.float32)
        if row.shape != shape or seen is None:
            raise InputError(
                f"observation: expected numbers of shape {shape} from {name}, found {seen!r}"
            )
        return row

    return see


def state_space_of(observation: Observation, problems: Sequence[Problem], overflow: bool) -> Box:
    """The space of :func:`state_of`."""
    own: Any = observation if _has_state(observation) else None
    space: Callable[..., Box] = own.state_space if own else state_space
    return space(problems, overflow)


def state_of(
    observation: Observation, games: Games, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """The global states (M, …) that go with an observation: its own, or those of the games.

    Raises:
        InputError: its own are not of the shape that its ``state_space`` says.
    """
    if not _has_state(observation):
        return games.state(out)
    own: Any = observation
    states: NDArray[np.float32] = own.state(games, out)
    space = state_space_of(observation, games.problems, games.overflow_allowed)
    expected, found = (len(games.problems), *space.shape), getattr(states, "shape", None)
    named = type(observation).__name__
    what = f"{named}.state to return an array of shape {expected}, as {named}.state_space says"
    check("observation", found == expected, f"{what}, found {found}")
    return states


def _has_state(observation: Observation) -> bool:
    return all(callable(getattr(observation, name, None)) for name in ("state", "state_space"))


def has_form(component: object, form: str, *others: str) -> bool:
    """Whether a component is to be used by one of several methods that say the same.

    Args:
        component: an observation or a reward.
        form: the method in question, such as ``write``.
        others: its other forms, such as ``see``. If a class of a user's overrides one of them
            alone, the inherited ``form`` says something else; in the package all always agree.
    """
    if form in getattr(component, "__dict__", {}):
        return True
    for cls in type(component).__mro__:
        if form in vars(cls):
            return True
        if not (is_ours(cls.__module__) or vars(cls).keys().isdisjoint(others)):
            return False
    return False


register("observation", "paper", PaperObservation)
register("observation", "window", "marouting.batch.window:WindowObservation")
register("observation", "outlook", "policies.generalist.outlook:OutlookObservation")
