"""The engine: M problems of one grid shape, played side by side.

All rules are in :mod:`marouting.batch.rules`, all state in :mod:`marouting.batch.state`.
"""

import copy
import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import numbers_of
from marouting.batch.observation import write_states
from marouting.batch.prices import Negotiation
from marouting.batch.rules import (
    clear_problem,
    free_moves,
    move_everyone,
    move_player,
    reset_problem,
    settle_everyone,
    settle_player,
    write_moves,
)
from marouting.batch.setup import Room, dynamic_state, replace_problem, static_state
from marouting.batch.state import Dynamic, Option, Static
from marouting.columns import as_int32, check_rows
from marouting.config import check
from marouting.game import NOBODY, Crossing, Ending
from marouting.kernels import as_index, compiled, i64
from marouting.observations import CHANNELS
from marouting.problem.grid import Grid
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.rules import Rules


@compiled
def _reset(static: Static, dynamic: Dynamic, which: Any) -> None:
    for m in range(len(which)):
        if which[m]:
            clear_problem(static, dynamic, m, i64(0), i64(1))
            reset_problem(static, dynamic, m)


@compiled
def _move(static: Static, dynamic: Dynamic, moves: Any, everyone: bool) -> None:
    """Makes moves (M, N) of all agents, or (M, 1) of those whose turn it is."""
    for m in range(len(moves)):
        if everyone:
            move_everyone(static, dynamic, m, moves)
        else:
            move_player(static, dynamic, m, i64(moves[m, 0]))


@compiled
def _settle(static: Static, dynamic: Dynamic, everyone: bool) -> None:
    """After the moves of :func:`_move`: next tasks start, and the turn passes."""
    for m in range(len(dynamic.games)):
        if everyone:
            settle_everyone(static, dynamic, m)
        else:
            settle_player(static, dynamic, m)


@compiled
def _masks(static: Static, dynamic: Dynamic, problems: Any, agents: Any, out: Any) -> None:
    """Fills ``out`` (K, A) with masks."""
    for i in range(len(problems)):
        m, n, free = as_index(problems[i]), i64(agents[i]), i64(0)
        if n != NOBODY:
            free = free_moves(static, dynamic, m, as_index(n))
        write_moves(static, free, out, i)


def _rows_of(nets: NDArray[np.int32]) -> NDArray[np.int32]:
    """(M, N) the agents of problems whose agents' nets are (M, N); NOBODY where there is none."""
    return np.where(nets == NOBODY, np.int32(NOBODY), np.arange(nets.shape[1], dtype=np.int32))


@dataclass(frozen=True)
class Metrics:
    """The metrics of an episode. They do not depend on the reward.

    Attributes:
        overflow: summed over all edges.
        wirelength: edges used, summed over the nets; a via counts 1.
        joined: two-pin tasks joined.
        tasks: number of two-pin tasks.
        steps: moves made by all agents.
    """

    overflow: int
    wirelength: int
    joined: int
    tasks: int
    steps: int


class Engine:
    """M problems of one grid shape, played side by side by the same rules.

    Nets with all pins in one Gcell have nothing to route and are not agents; ``nets`` maps agents
    to nets. Problems with fewer agents than the largest one are padded with ABSENT agents.

    Args:
        problems: the problems, all with the same grid shape.
        rules: the options of the rules; None: those of the paper.
        room: sizes of the problems that may replace these, see :meth:`replace`; None: none.
        negotiation: prices of edges, for the generalist only; None: none.
        **changes: fields of :class:`marouting.rules.Rules` that differ from ``rules``.

    Attributes:
        rules, room, negotiation: as given.
        priced: whether there are priced rounds.
        grid: the grid that all problems share.
        nets: (M, N) int32, the net of every agent; NOBODY where there is no agent.
        static: the arrays that do not change during an episode.
        dynamic: the arrays that do.
        replaced: (M,) int64, how often a problem has taken the place of another.

    Raises:
        InputError: there is no problem, the grids differ, a problem has nothing to route, they take
            too much memory, or an option is out of range.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        rules: Rules | None = None,
        *,
        room: Room | None = None,
        negotiation: Negotiation | None = None,
        **changes: Any,
    ) -> None:
        rules = rules or Rules()
        # Options are checked whenever they are made, which takes as long as a dozen moves.
        self.rules, self.room = replace(rules, **changes) if changes else rules, room
        problems = tuple(problems)
        self.negotiation = negotiation
        prices = negotiation is not None and negotiation.prices
        allowed = not prices or self.rules.overflow == "allowed"
        check("negotiation.prices", allowed, "false, unless overflow is allowed")
        rip_up = self.rules.rip_up
        self.priced = prices and rip_up is not None and rip_up.rounds > 0
        self.static, self.nets = static_state(
            problems, self.rules, room=room, negotiation=negotiation
        )
        # An array, like all that parts of an engine share.
        self._held = np.empty(len(problems), object)
        self._held[:] = problems
        self.grid = Grid.of(problems[0].grid)
        self.dynamic = dynamic_state(self.static, self.grid, self.nets.shape[1])
        self.replaced = np.zeros(len(problems), np.int64)
        self._rows = _rows_of(self.nets)
        self.reset()

    @property
    def problems(self) -> tuple[Problem, ...]:
        """The problems, a tuple of M."""
        return tuple(self._held)

    @property
    def agents(self) -> NDArray[Any]:
        """(M, N) AGENT records; a view, to be read."""
        return self.dynamic.agents

    @property
    def games(self) -> NDArray[Any]:
        """(M,) GAME records; a view, to be read."""
        return self.dynamic.games

    @property
    def remaining(self) -> NDArray[np.int32]:
        """(M, E) remaining capacity of every edge; a view, not to be written."""
        return self.dynamic.remaining

    @property
    def order(self) -> NDArray[np.int32]:
        """(M, N) the agents in turn order, then NOBODY; a view, to be read."""
        return self.static.order

    def uses(
        self, problems: NDArray[np.integer], agents: NDArray[np.integer], edges: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """See :meth:`marouting.columns.Games.uses`."""
        uses = self.dynamic.used[problems, agents, edges >> 3] >> (edges & 7) & 1
        return uses.astype(np.bool_)

    def state(self, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """(M, X, Y, 5 Z), the global states; see :func:`marouting.observations.state_space`."""
        columns, rows, layers = self.grid.shape
        if out is None:
            out = np.empty((len(self.games), columns, rows, layers * CHANNELS), np.float32)
        write_states(self.dynamic, out.reshape(len(out), -1, CHANNELS))
        return out

    @property
    def max_steps(self) -> int:
        """Steps after which a task fails (the paper's T_max)."""
        return self.static.max_steps

    @property
    def overflow_allowed(self) -> bool:
        """Whether moves cross full edges."""
        return bool(self.static.overflow_allowed)

    @property
    def actions(self) -> int:
        """How many actions an agent has; see :class:`marouting.rules.Rules`."""
        return self.rules.actions

    @property
    def tasks(self) -> NDArray[np.int32]:
        """(M, N) int32, the number of two-pin tasks of every agent."""
        return np.diff(self.static.first, axis=1)

    def reset(self, which: NDArray[np.bool_] | None = None) -> None:
        """Starts the episodes of all problems, or of those where ``which`` (M,) is true.

        Raises:
            ValueError: ``which`` is not one boolean per problem.
        """
        which = np.asarray(np.ones(len(self.games), np.bool_) if which is None else which)
        if which.shape != self.games.shape or which.dtype != np.bool_:
            raise ValueError(f"which: expected {len(self.games)} booleans, found {which}")
        _reset(self.static, self.dynamic, which)

    def begin_plain(self, which: NDArray[np.bool_]) -> None:
        """Problems ``which`` (M,), all at the beginning, are first routed without prices."""
        if not self.priced or self.games["steps"][which].any():
            raise ValueError("which: expected problems at the beginning of a priced first walk")
        self.games["plain"][which] = 1

    def part(self, which: NDArray[np.integer] | slice) -> "Engine":
        """An engine of some of the problems, which continues from their present state.

        Args:
            which: their indices. With a slice, the two engines share their arrays.
        """
        part = copy.copy(self)
        for cached in ("_problems", "_each"):
            vars(part).pop(cached, None)
        for name in ("_held", "_rows", "nets", "replaced"):
            setattr(part, name, getattr(self, name)[which])
        static = self.static
        alone = self.room is not None and not isinstance(which, slice)
        part.static = static._replace(
            tasks=static.tasks.copy() if alone else static.tasks,
            capacity=static.capacity[which],
            demand=static.demand[which],
            first=static.first[which],
            order=static.order[which],
        )
        part.dynamic = Dynamic._make(array[which] for array in self.dynamic)
        return part

    def replace(self, m: int, problem: Problem) -> None:
        """Puts another problem in the place of one; its episode is to be started by :meth:`reset`.

        Engines that share arrays with this one, see :meth:`part`, play it as well.

        Args:
            m: the place.
            problem: the problem, with the same grid shape.

        Raises:
            ValueError: there is no room for other problems in this engine.
            InputError: the problem does not fit into it, or has nothing to route.
        """
        if self.room is None:
            raise ValueError("replace: expected an engine with room for other problems")
        replace_problem(self.static, self.nets, m, problem, self.rules, self.room)
        self._held[m] = problem
        self._rows[m] = _rows_of(self.nets[m : m + 1])
        self.replaced[m] += 1
        for array in self.dynamic:
            array[m] = np.zeros((), array.dtype)
        self.games["agent"][m] = NOBODY

    def move(self, moves: NDArray[np.integer]) -> None:
        """The first half of a step: agents move, tasks end.

        Args:
            moves: (M,), the moves of the agents whose turn it is, or (M, N), one for every agent,
                carried out in turn order. NOBODY (−1) means no move. Moves of agents that are not
                active, or that have to wait for their turn, are ignored.

        Raises:
            ValueError: a move is not −1 or an action, or the shape is wrong.
        """
        moves = np.asarray(moves)
        self.check(moves)
        everyone = moves.ndim == 2
        (rows,) = as_int32(moves if everyone else moves[:, None])
        _move(self.static, self.dynamic, rows, everyone)

    def settle(self, everyone: bool) -> None:
        """The second half of a step, of all agents or those whose turn it is: next tasks begin."""
        _settle(self.static, self.dynamic, everyone)

    def step(self, moves: NDArray[np.integer]) -> None:
        """Both halves of a step; arguments and errors are those of :meth:`move`."""
        self.move(moves)
        self.settle(everyone=np.ndim(moves) == 2)

    def save(self) -> Dynamic:
        """A copy of the state of all games, for :meth:`restore`."""
        return Dynamic._make(array.copy() for array in self.dynamic)

    def restore(self, saved: Dynamic) -> None:
        """Puts all games back into a state of :meth:`save`; ValueError if it is of other games."""
        for name, array in self.dynamic._asdict().items():
            kept = getattr(saved, name)
            if (kept.shape, kept.dtype) != (array.shape, array.dtype):
                raise ValueError(f"saved: expected shape {array.shape}, found {kept.shape}")
        self._check_indices(saved)
        for name, array in self.dynamic._asdict().items():
            array[...] = getattr(saved, name)

    def _check_indices(self, saved: Dynamic) -> None:
        """Raises ValueError for numbers that compiled code could not use as indices."""
        agents, games, options = saved.agents, saved.games, self.static.options
        nets, gcells, tasks = self.nets.shape[1], self.grid.gcells, len(self.static.tasks)
        line, first = options[Option.LINE], options[Option.RIPPED]
        most = max(int(options[Option.RIPPED_MOST]), 0)
        limits = {
            "cell": (agents["cell"], 0, gcells - 1),
            "target": (agents["target"], 0, gcells - 1),
            "task": (agents["task"], NOBODY, tasks),
            "crossing": (agents["crossing"], 0, int(max(Crossing))),
            "ending": (agents["ending"], 0, int(max(Ending))),
            "agent": (games["agent"], NOBODY, nets - 1),
            "turn": (games["turn"], 0, nets - 1),
            "place": (games["place"], 0, nets),
            "ripped": (games["ripped"], 0, most),
            "line": (saved.numbers[:, line : line + nets * (line >= 0)], NOBODY, nets - 1),
            "rerouted": (saved.numbers[:, first : first + most * (first >= 0)], NOBODY, nets - 1),
        }
        for name, (numbers, least, largest) in limits.items():
            if numbers.size and not least <= numbers.min() <= numbers.max() <= largest:
                raise ValueError(f"saved: expected {least} to {largest} for {name}")

    def check(self, moves: NDArray[np.integer]) -> None:
        """Raises ValueError for moves that :meth:`move` does not accept."""
        # The compiled functions use these as indices without checking them.
        if moves.shape not in (self.games.shape, self.agents.shape) or moves.dtype.kind not in "iu":
            raise ValueError(
                f"actions: expected integers of shape {self.games.shape} or {self.agents.shape}, "
                f"found {moves.dtype} of shape {moves.shape}"
            )
        if not (moves.min() >= NOBODY and moves.max() < self.actions):
            wrong = moves[(moves < NOBODY) | (moves >= self.actions)][0]
            expected = f"0 to {self.actions - 1}, or {NOBODY} for none"
            raise ValueError(f"actions: expected {expected}, found {wrong}")

    @functools.cached_property
    def _problems(self) -> NDArray[np.int32]:
        return np.arange(len(self.games), dtype=np.int32)

    @functools.cached_property
    def _each(self) -> NDArray[np.int32]:
        return np.repeat(self._problems, self.nets.shape[1])

    def pairs(self, everyone: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Indices (problem, agent) of all M·N agents, or of the M to move; NOBODY for none."""
        if everyone:
            return self._each, self._rows.reshape(-1)
        return self._problems, self.games["agent"]

    def agents_of(self, m: int) -> NDArray[np.int32]:
        """(N,) int32, the agents of a problem; NOBODY where one is absent."""
        agents: NDArray[np.int32] = self._rows[m]
        return agents

    def masks(
        self,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.int8] | None = None,
    ) -> NDArray[np.int8]:
        """(K, A) int8 action masks of K agents: 1 where a move would cross an edge.

        A mask is never all zero: if all moves of an agent are blocked, it gets all ones.

        Raises:
            ValueError: there are no such agents.
        """
        if out is None:
            out = np.empty((len(problems), self.actions), np.int8)
        check_rows(self, problems, agents, out, self.actions)
        _masks(self.static, self.dynamic, *as_int32(problems, agents), out)
        return out

    def metrics(self, m: int = 0) -> Metrics:
        """The metrics of problem ``m`` at this moment."""
        game = self.games[m]
        return Metrics(
            overflow=int(game["overflow"]),
            wirelength=int(game["wirelength"]),
            joined=int(game["joined"]),
            tasks=int(self.static.first[m, -1] - self.static.first[m, 0]),
            steps=int(game["steps"]),
        )

    def solution(self, m: int = 0) -> Solution:
        """The routes of problem m."""
        agent, edge = numbers_of(self.dynamic.used[m : m + 1], 0)
        return Solution.of_uses(self._held[m], self.nets[m, agent].astype(np.int64), edge)
