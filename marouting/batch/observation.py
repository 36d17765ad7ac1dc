"""What an agent sees, and the global state.

The paper's observation is here; :mod:`marouting.batch.window` has one that fits every grid. You can
also write your own: any object with the two methods of :class:`Observation`. It works in all
interfaces of the environment, in the batch and in trainings; see :func:`marouting.register`. An
observation with a method ``state``, whose arguments are those of :func:`state`, and
``state_space``, with those of :func:`state_space`, also decides what the global state is. One that
turns what it shows, as :mod:`marouting.batch.window` does, may have a method ``move_order`` with
the arguments and result of :meth:`.window.WindowObservation.move_order`: learners then choose among
its moves, and their masks are of these; see :func:`move_order_of`. Environments take and show the
moves of the grid in any case.

A worked example: the paper's 12 numbers, and the number of agents that are still routing::

    import numpy as np
    from gymnasium.spaces import Box
    from marouting import PaperObservation

    class CountingObservation:
        def __init__(self) -> None:
            self.paper = PaperObservation()

        def space(self, problems, overflow):
            inner = self.paper.space(problems, overflow)
            most = np.float32(max(len(problem.nets) for problem in problems))
            return Box(np.append(inner.low, np.float32(0)), np.append(inner.high, most))

        def write(self, engine, problems, agents, out):
            self.paper.write(engine, problems, agents, out[:, :-1])
            out[:, -1] = np.where(agents < 0, 0, engine.games["active"][problems])

    env = marouting.global_routing_v0.env(observation=CountingObservation())

In YAML, with the class in ``my_pieces.py``::

    observation: {kind: "my_pieces:CountingObservation"}
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from marouting.batch.bits import byte_at, places
from marouting.batch.engine import Engine, check_rows
from marouting.batch.rules import is_agent
from marouting.batch.state import Dynamic, Static
from marouting.errors import InputError
from marouting.game import NOBODY, Status
from marouting.kernels import compiled, inlined, place, wide
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.problem.problem import Problem


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
        engine: Engine,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Writes what K agents see.

        Args:
            engine: the games, to be read; see :class:`marouting.batch.engine.Engine`. Its problems
                may change between episodes.
            problems: (K,) int32, the problem of each agent. ``engine.agents[problems, agents]`` are
                the agents' records, ``engine.dynamic.remaining[problems]`` (K, E) the remaining
                capacities.
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
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    via_capacity: float = 10.0

    def __post_init__(self) -> None:
        if not 0 <= self.via_capacity < np.inf:
            raise InputError(f"via_capacity: expected a number from 0, found {self.via_capacity}")

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
        engine: Engine,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Fills ``out`` (K, 12); see :class:`Observation`.

        Raises:
            ValueError: there are no such agents.
        """
        check_rows(problems, agents, out, AXES + AXES + MOVES)
        if not _paper(engine.static, engine.dynamic, self.via_capacity, problems, agents, out):
            raise ValueError(f"expected agents of the games, found {problems}, {agents}")


@inlined
def _room(static: Static, dynamic: Dynamic, m: int, cell: int, move: int) -> Any:
    """float32 remaining capacity of the edge that a move inside a layer crosses; 0 if none."""
    return np.float32(dynamic.remaining[m, place(static.edge[cell, move])])


@inlined
def write_paper(
    static: Static, dynamic: Dynamic, via_capacity: float, m: int, n: int, out: Any, row: int
) -> None:
    """Fills a row of ``out`` (K, 12) with what agent n of problem m sees; zeros for NOBODY."""
    if n == NOBODY:
        for f in range(out.shape[1]):
            out[row, f] = 0
    else:
        agent = dynamic.agents[m, place(n)]
        cell, target = place(agent.cell), place(agent.target)
        # Everything is read before anything is written. The compiler cannot know that ``out`` is
        # not part of the game; this way, one read serves both the observation and a mask made
        # beside it.
        x, y, z = static.position[cell, 0], static.position[cell, 1], static.position[cell, 2]
        to_x, to_y, to_z = (
            static.position[target, 0],
            static.position[target, 1],
            static.position[target, 2],
        )
        east = _room(static, dynamic, m, cell, wide(0))
        west = _room(static, dynamic, m, cell, wide(1))
        north = _room(static, dynamic, m, cell, wide(2))
        south = _room(static, dynamic, m, cell, wide(3))
        exits = static.exits[cell]
        out[row, 0], out[row, 1], out[row, 2] = np.float32(x), np.float32(y), np.float32(z)
        out[row, 3] = np.float32(np.int32(to_x - x))
        out[row, 4] = np.float32(np.int32(to_y - y))
        out[row, 5] = np.float32(np.int32(to_z - z))
        out[row, 6], out[row, 7], out[row, 8], out[row, 9] = east, west, north, south
        out[row, 10] = np.float32(via_capacity) * np.float32(exits >> 4 & 1)
        out[row, 11] = np.float32(via_capacity) * np.float32(exits >> 5 & 1)


@compiled
def _paper(
    static: Static, dynamic: Dynamic, via_capacity: float, problems: Any, agents: Any, out: Any
) -> bool:
    """Fills ``out`` (K, 12); returns whether there are such agents."""
    for i in range(len(problems)):
        m, n = wide(problems[i]), wide(agents[i])
        if not is_agent(dynamic, m, n):
            return False
        write_paper(static, dynamic, via_capacity, place(m), n, out, i)
    return True


CHANNELS = AXES + 2
"""Numbers per Gcell in the global state."""


def state_space(problems: Sequence[Problem], overflow: bool) -> Box:
    """The space of :func:`state`."""
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


def state(engine: Engine, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
    """The global states of all problems, for critics and mixers that see everything.

    Args:
        engine: the games.
        out: the array to fill and return; None: a new array.

    Returns:
        (M, X, Y, 5 Z) float32, five numbers per layer. For every Gcell: the remaining capacity of
        its edges towards +x and +y (0 off the grid), the number of nets that use its via towards
        +z, the number of active agents in it, and the number of active agents whose target it is.
    """
    columns, rows, layers = engine.grid.shape
    if out is None:
        out = np.empty((len(engine.games), columns, rows, layers * CHANNELS), np.float32)
    _state(engine.dynamic, out.reshape(len(out), -1, CHANNELS))
    return out


@compiled
def _state(dynamic: Dynamic, out: Any) -> None:
    for m in range(out.shape[0]):
        for cell in range(out.shape[1]):
            for axis in range(VIA_AXIS):
                out[m, cell, axis] = dynamic.remaining[m, AXES * cell + axis]
            for channel in range(VIA_AXIS, CHANNELS):
                out[m, cell, channel] = 0
        for n in range(dynamic.agents.shape[1]):
            for at in range(places(dynamic.used, m, n)):
                byte, bits = byte_at(dynamic.used, m, n, at)
                edge = 8 * byte
                while bits != 0:
                    if bits & 1 and edge % AXES == VIA_AXIS:
                        out[m, edge // AXES, VIA_AXIS] += 1
                    edge, bits = edge + 1, bits >> 1
            agent = dynamic.agents[m, n]
            if agent.status == Status.ACTIVE:
                out[m, place(agent.cell), AXES] += 1
                out[m, place(agent.target), AXES + 1] += 1


def has_move_order(observation: Observation) -> bool:
    """Whether an observation has an order of moves of its own."""
    return callable(getattr(observation, "move_order", None))


def move_order_of(
    observation: Observation, obs: NDArray[np.float32], actions: int
) -> NDArray[np.int64]:
    """The actions on the grid that the actions of an observation are.

    Args:
        observation: with a method ``move_order``.
        obs: (K, *S) float32, what agents saw.
        actions: A; an action that is no move, such as giving way, stays what it is.

    Returns:
        (K, A) int64, each row the numbers from 0 to A − 1 in some order.
        ``numpy.take_along_axis(mask, order, -1)`` turns the grid's mask into the observation's.

    Raises:
        InputError: the observation gives something else.
    """
    own: Any = observation
    order = np.asarray(own.move_order(obs))
    whole = order.shape == (len(obs), MOVES) and order.dtype.kind in "iu"
    # One bit per move: all six of them, each once.
    if not whole or (order.clip(0, 62) != order).any() or (_bits(order) != _bits(_MOVES)).any():
        found = f"{type(observation).__name__}.move_order"
        raise InputError(
            f"{found}: expected the moves 0 to 5, each once, for {len(obs)} agents, found {order}"
        )
    rest = np.broadcast_to(np.arange(MOVES, actions), (len(obs), actions - MOVES))
    return np.concatenate((order.astype(np.int64), rest), axis=1)


_MOVES = np.arange(MOVES)


def _bits(moves: NDArray[np.integer]) -> NDArray[np.int64]:
    return np.asarray(np.left_shift(1, moves.astype(np.int64)).sum(axis=-1))


def state_space_of(observation: Observation, problems: Sequence[Problem], overflow: bool) -> Box:
    """The space of :func:`state_of`."""
    own: Any = observation if _has_state(observation) else None
    space: Callable[..., Box] = own.state_space if own else state_space
    return space(problems, overflow)


def state_of(
    observation: Observation, engine: Engine, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """The global states (M, …) that go with an observation: its own, or else :func:`state`."""
    own: Any = observation if _has_state(observation) else None
    write: Callable[..., NDArray[np.float32]] = own.state if own else state
    return write(engine, out)


def _has_state(observation: Observation) -> bool:
    return all(callable(getattr(observation, name, None)) for name in ("state", "state_space"))
