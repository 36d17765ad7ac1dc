"""The rules of the game, all of them, for any number of problems at once.

Every net is an agent. Its pins are cut into two-pin tasks (:mod:`marouting.trees.decomposition`);
the agent walks them one after the other, a Gcell a move, from the task's start to its target.

* A move along an edge **crosses** it when the net already uses the edge (no new demand), when the
  edge is a via, or when its remaining capacity covers the net's demand; with
  ``overflow="allowed"`` always. Then the net uses the edge and its demand is taken.
* Any other move is **blocked**: the agent stays where it is. So is a move off the grid.
* Either way the step counts. A task ends **joined** on the target, or **failed** after
  ``max_steps`` steps; then the next task starts at its own start pin. What the net used, it keeps.
* An agent **terminates** when all its tasks are joined, and is **truncated** when its last task
  has ended and some task failed. The episode of a problem ends with its last agent.
* The nets take turns in ``net_order``: ``sequential``, a net routes to its end before the next
  starts (the paper), or ``round_robin``, one step each.

A step has two halves, :meth:`Engine.move` and :meth:`Engine.settle`, so that a learner can see
where a move arrived before the next task puts the agent on another pin. :meth:`Engine.step` does
both.

The state lives in plain arrays with the problem as the first axis (M problems, N agents, E edges);
the compiled functions below are the only code that changes it.
"""

import copy
import enum
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.kernels import bound, compiled, inlined, place, wide
from marouting.problem.grid import MOVES, OFF_GRID, VIA_AXIS, Grid, Move
from marouting.problem.problem import UNLIMITED, Problem, check_choice
from marouting.problem.solution import Solution
from marouting.trees.decomposition import Decomposition, two_pin_tasks

TurnOrder = Literal["sequential", "round_robin"]
NetOrder = Literal["half_perimeter", "half_perimeter_up", "file"]
Overflow = Literal["forbidden", "allowed"]

NOBODY = -1
"""Whose turn it is when the episode is over; also the action of a net that does not move."""


class Status(enum.IntEnum):
    """Where an agent stands in its episode."""

    ACTIVE = 0  #: still has a task to walk
    TERMINATED = 1  #: all tasks joined
    TRUNCATED = 2  #: all tasks ended, at least one of them failed
    ABSENT = 3  #: no net: fills up the row of a problem with fewer nets than its batch


class Crossing(enum.IntEnum):
    """What an agent's last move did."""

    NONE = 0  #: the agent did not move
    BLOCKED = 1  #: no capacity or off the grid: it stayed
    NEW = 2  #: crossed an edge that the net now uses
    OWN = 3  #: crossed an edge that the net used before


class Ending(enum.IntEnum):
    """What an agent's last move did to its task."""

    NONE = 0  #: the task goes on
    JOINED = 1  #: the target pin is reached
    FAILED = 2  #: the steps are used up


AGENT = np.dtype(
    [
        ("cell", np.int32),  # Gcell the agent stands in
        ("target", np.int32),  # Gcell of the task's target pin
        ("task", np.int32),  # row of the task in the table of tasks
        ("steps", np.int32),  # steps taken in this task
        ("joined", np.int32),  # tasks joined so far
        ("overflow", np.int32),  # overflow that the last move added
        ("status", np.int8),  # Status
        ("crossing", np.int8),  # Crossing of the last move
        ("ending", np.int8),  # Ending of the last move
    ],
    align=True,
)
"""One agent's state; the engine holds (M, N) of them."""

GAME = np.dtype(
    [
        ("turn", np.int32),  # place in the turn order of the agent to move
        ("agent", np.int32),  # the agent to move, or NOBODY
        ("active", np.int32),  # agents still active
        ("joined", np.int32),  # tasks joined
        ("steps", np.int32),  # moves made
        ("overflow", np.int64),  # overflow of all edges
        ("wirelength", np.int64),  # edges used, summed over the nets
    ],
    align=True,
)
"""One problem's state; the engine holds (M,) of them."""


class Static(NamedTuple):
    """What does not change during an episode."""

    neighbour: NDArray[np.int32]  # (G, 6) Gcell that a move leads to, or OFF_GRID
    edge: NDArray[np.int32]  # (G, 6) edge that a move crosses; off the grid E - 1, which is none
    exits: NDArray[np.uint8]  # (G,) bit per move: it stays on the grid
    position: NDArray[np.int32]  # (G, 3) x, y, z of a Gcell
    capacity: NDArray[np.int32]  # (M, E) capacity of every edge
    demand: NDArray[np.int32]  # (M, N, Z) demand of an agent on an edge of a layer
    tasks: NDArray[np.int32]  # (K, 2) start and target Gcell of every task
    first: NDArray[np.int32]  # (M, N + 1) first task of an agent; the next agent's ends it
    order: NDArray[np.int32]  # (M, N) agents in turn order, NOBODY after the last
    sequential: bool
    overflow: bool  # may an edge without remaining capacity be crossed
    max_steps: int  # steps after which a task fails


class Dynamic(NamedTuple):
    """What changes during an episode."""

    remaining: NDArray[np.int32]  # (M, E) capacity less demand
    used: NDArray[np.uint8]  # (M, N, ceil(E / 8)) bit e % 8 of byte e // 8: the net uses edge e
    agents: NDArray[Any]  # (M, N) AGENT
    games: NDArray[Any]  # (M,) GAME


# Without branches as far as can be: what an agent meets is as good as random, and a branch that the
# processor guesses wrong takes as long as a whole move.


@inlined
def uses(used: Any, m: int, n: int, edge: int) -> int:
    """1 if agent n of problem m uses an edge, else 0."""
    return used[m, n, edge >> 3] >> (edge & 7) & 1


@inlined
def demand_of(static: Static, m: int, n: int, cell: int, move: int) -> int:
    """What the edge that a move crosses would cost the net: nothing for a via."""
    demand = static.demand[m, n, place(static.position[cell, VIA_AXIS])]
    return demand * (move // 2 != VIA_AXIS)


@inlined
def has_room(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int) -> int:
    """1 if a move from a Gcell crosses an edge that the net uses or whose demand it can pay."""
    edge = place(static.edge[cell, move])
    via = move // 2 == VIA_AXIS
    room = dynamic.remaining[m, edge] >= demand_of(static, m, n, cell, move)
    return (via | room | uses(dynamic.used, m, n, edge)) & (static.exits[cell] >> move)


@inlined
def may_cross(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int) -> int:
    """1 if a move from a Gcell crosses its edge, 0 if it is blocked."""
    anyway = static.overflow & (static.exits[cell] >> move)
    return has_room(static, dynamic, m, n, cell, move) | anyway


@inlined
def move_agent(static: Static, dynamic: Dynamic, m: int, n: int, move: int) -> None:
    """One step of one agent: the edge is crossed or not, the task ends or not."""
    agent = dynamic.agents[m, n]
    game = dynamic.games[m]
    cell = place(agent.cell)
    edge = place(static.edge[cell, move])
    crosses = may_cross(static, dynamic, m, n, cell, move)
    own = crosses & uses(dynamic.used, m, n, edge)
    new = crosses ^ own
    demand = new * demand_of(static, m, n, cell, move)
    remaining = dynamic.remaining[m, edge]
    agent.crossing = Crossing.BLOCKED + new + 2 * own  # NEW and OWN are the two that follow
    agent.overflow = 0
    if remaining < demand:
        # Only the part of the demand that the remaining capacity does not cover overflows.
        agent.overflow = demand - max(remaining, 0)
        game.overflow += agent.overflow
    dynamic.remaining[m, edge] = remaining - demand
    dynamic.used[m, n, edge >> 3] |= np.uint8(new << (edge & 7))
    game.wirelength += new
    ahead = static.neighbour[cell, move]
    agent.cell = ahead if crosses else agent.cell
    agent.steps += 1
    game.steps += 1
    agent.ending = Ending.NONE
    if agent.cell == agent.target:
        agent.ending = Ending.JOINED
        agent.joined += 1
        game.joined += 1
    elif agent.steps >= static.max_steps:
        agent.ending = Ending.FAILED


@inlined
def wait(dynamic: Dynamic, m: int, n: int) -> None:
    """No step: what the agent's last move did is forgotten."""
    agent = dynamic.agents[m, n]
    agent.overflow = 0
    agent.crossing = Crossing.NONE
    agent.ending = Ending.NONE


@inlined
def begin_task(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> None:
    """Puts an agent on the start pin of a task."""
    agent = dynamic.agents[m, n]
    agent.task = task
    agent.cell = static.tasks[task, 0]
    agent.target = static.tasks[task, 1]
    agent.steps = 0


@inlined
def settle_agent(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """After a move: an agent whose task has ended starts its next one, or is done."""
    agent = dynamic.agents[m, n]
    if agent.ending == Ending.NONE or agent.status != Status.ACTIVE:
        return
    if agent.task + 1 < static.first[m, n + 1]:
        begin_task(static, dynamic, m, n, wide(agent.task + 1))
        return
    tasks = static.first[m, n + 1] - static.first[m, n]
    agent.status = Status.TERMINATED if agent.joined == tasks else Status.TRUNCATED
    dynamic.games[m].active -= 1


@inlined
def pass_turn(static: Static, dynamic: Dynamic, m: int) -> None:
    """The turn goes to the next agent: the same one while it routes, if the order is sequential."""
    game = dynamic.games[m]
    if game.active == 0:
        game.agent = NOBODY
        return
    agents = static.order.shape[1]
    turn = game.turn if static.sequential else (game.turn + 1) % agents
    while True:
        n = static.order[m, turn]
        if n != NOBODY and dynamic.agents[m, n].status == Status.ACTIVE:
            break
        turn = (turn + 1) % agents
    game.turn = turn
    game.agent = n


@inlined
def reset_problem(static: Static, dynamic: Dynamic, m: int) -> None:
    """All agents of a problem back to their first pin, all capacity free."""
    # Loops instead of slices: they compile in a tenth of the time.
    for edge in range(static.capacity.shape[1]):
        dynamic.remaining[m, edge] = static.capacity[m, edge]
    game = dynamic.games[m]
    if game.steps != 0:
        for n in range(static.order.shape[1]):
            for byte in range(dynamic.used.shape[2]):
                dynamic.used[m, n, byte] = 0
    game.turn = game.active = game.joined = game.steps = 0
    game.overflow = game.wirelength = 0
    for n in range(static.order.shape[1]):
        agent = dynamic.agents[m, n]
        agent.joined = 0
        wait(dynamic, m, n)
        if static.first[m, n] < static.first[m, n + 1]:
            agent.status = Status.ACTIVE
            game.active += 1
            begin_task(static, dynamic, m, n, wide(static.first[m, n]))
        else:
            agent.status = Status.ABSENT
    game.agent = static.order[m, 0]


@compiled
def _reset(static: Static, dynamic: Dynamic, which: Any) -> None:
    for m in range(len(which)):
        if which[m]:
            reset_problem(static, dynamic, m)


@inlined
def move_player(static: Static, dynamic: Dynamic, m: int, move: int) -> None:
    """In one problem, the agent whose turn it is moves, unless it is told not to."""
    n = wide(dynamic.games[m].agent)
    if n == NOBODY:
        return
    if move == NOBODY:
        wait(dynamic, m, n)
    else:
        move_agent(static, dynamic, m, n, move)


@inlined
def settle_player(static: Static, dynamic: Dynamic, m: int) -> None:
    """After the move of :func:`move_player`: the next task starts, and the turn passes."""
    n = wide(dynamic.games[m].agent)
    if n != NOBODY:
        settle_agent(static, dynamic, m, n)
        pass_turn(static, dynamic, m)


@inlined
def move_everyone(static: Static, dynamic: Dynamic, m: int, moves: Any) -> None:
    """In one problem, all agents move once by ``moves`` (M, N), in turn order.

    If the order is sequential, the one whose turn it is moves alone.
    """
    playing = dynamic.games[m].agent
    for k in range(static.order.shape[1]):
        if static.order[m, k] == NOBODY:
            break
        n = place(static.order[m, k])
        if (
            dynamic.agents[m, n].status == Status.ACTIVE
            and moves[m, n] != NOBODY
            and (n == playing or not static.sequential)
        ):
            move_agent(static, dynamic, m, n, place(moves[m, n]))
        else:
            wait(dynamic, m, n)


@inlined
def settle_turns(static: Static, dynamic: Dynamic, m: int) -> None:
    """After all agents of a problem have settled: the turn passes where it has to."""
    playing = wide(dynamic.games[m].agent)
    if playing != NOBODY and (
        static.sequential or dynamic.agents[m, playing].status != Status.ACTIVE
    ):
        pass_turn(static, dynamic, m)


@inlined
def settle_everyone(static: Static, dynamic: Dynamic, m: int) -> None:
    """After the moves of :func:`move_everyone`: next tasks start, and the turn passes."""
    for n in range(static.order.shape[1]):
        settle_agent(static, dynamic, m, n)
    settle_turns(static, dynamic, m)


@compiled
def move_turn(static: Static, dynamic: Dynamic, moves: Any) -> None:
    """Moves (M,): in every problem the agent whose turn it is moves."""
    for m in range(len(moves)):
        move_player(static, dynamic, m, wide(moves[m]))


@compiled
def settle_turn(static: Static, dynamic: Dynamic) -> None:
    """After the moves of :func:`move_turn`: next tasks start, and the turn passes."""
    for m in range(len(dynamic.games)):
        settle_player(static, dynamic, m)


@compiled
def move_all(static: Static, dynamic: Dynamic, moves: Any) -> None:
    """Moves (M, N): all agents of all problems move once, see :func:`move_everyone`."""
    for m in range(len(moves)):
        move_everyone(static, dynamic, m, moves)


@compiled
def settle_all(static: Static, dynamic: Dynamic) -> None:
    """After the moves of :func:`move_all`: next tasks start, and the turn passes."""
    for m in range(len(dynamic.games)):
        settle_everyone(static, dynamic, m)


@compiled
def _step_turn(static: Static, dynamic: Dynamic, moves: Any) -> None:
    for m in range(len(moves)):
        move_player(static, dynamic, m, wide(moves[m]))
        settle_player(static, dynamic, m)


@compiled
def _step_all(static: Static, dynamic: Dynamic, moves: Any) -> None:
    for m in range(len(moves)):
        move_everyone(static, dynamic, m, moves)
        settle_everyone(static, dynamic, m)


MASKS = np.array(
    [
        [free >> move & 1 for move in range(MOVES)] if free else [1] * MOVES
        for free in range(1 << MOVES)
    ],
    np.int8,
)
"""(64, 6) the action masks of all sets of free moves, a bit each. An agent that is boxed in gets
all ones, every move being blocked: a mask is never all zero."""


@inlined
def free_moves(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The moves of an agent that cross an edge, a bit each."""
    cell = place(dynamic.agents[m, n].cell)
    free = wide(0)
    for move in range(MOVES):
        free |= wide(may_cross(static, dynamic, m, n, cell, move)) << move
    return free


@inlined
def write_mask(static: Static, dynamic: Dynamic, m: int, n: int, out: Any, row: int) -> None:
    """Fills a row of ``out`` (K, 6) with the moves of an agent that cross an edge; all if none."""
    free = wide(0)
    if n != NOBODY:
        free = free_moves(static, dynamic, m, place(n))
    for move in range(MOVES):
        out[row, move] = MASKS[free, move]


@compiled
def _masks(static: Static, dynamic: Dynamic, problems: Any, agents: Any, out: Any) -> None:
    for i in range(len(problems)):
        write_mask(static, dynamic, place(problems[i]), wide(agents[i]), out, i)


@compiled
def _play_turn(static: Static, dynamic: Dynamic, move: int, mask: Any) -> tuple[int, int]:
    m, n = wide(0), wide(dynamic.games[0].agent)
    move_agent(static, dynamic, m, n, move)
    settle_agent(static, dynamic, m, n)
    pass_turn(static, dynamic, m)
    status = dynamic.agents[m, n].status
    following = wide(dynamic.games[m].agent)
    write_mask(static, dynamic, m, following if status == Status.ACTIVE else n, mask, m)
    return following, status


@compiled
def _uses(used: Any, nets: Any, net: Any, edge: Any) -> int:
    """Lists the net and the edge of every use, as far as there is room; returns how many."""
    size = 0
    for n in range(used.shape[0]):
        for byte in range(used.shape[1]):
            bits = wide(used[n, byte])
            bit = 0
            while bits != 0:
                if bits & 1:
                    if size < len(net):
                        net[size] = nets[n]
                        edge[size] = 8 * byte + bit
                    size += 1
                bits >>= 1
                bit += 1
    return size


Write = Callable[[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]], None]
"""What fills in something of agents, given (P,) int32 problems, (P, K) int32 agents of each, NOBODY
for none, and an array of P · K rows to fill; all contiguous."""


@dataclass(frozen=True)
class Metrics:
    """An episode in the figures that routes are judged by, apart from any reward.

    Attributes:
        overflow: summed over all edges.
        wirelength: edges used, summed over the nets; a via counts 1.
        joined: two-pin tasks joined.
        tasks: two-pin tasks in all.
        steps: moves made by all agents.
    """

    overflow: int
    wirelength: int
    joined: int
    tasks: int
    steps: int


class Engine:
    """M problems of one grid shape, played side by side by the same rules.

    Nets whose pins all lie in one Gcell have nothing to route and are no agents; ``nets`` maps
    agents to nets. A problem with fewer agents than the largest is filled up with ABSENT ones.

    Args:
        problems: the problems, all with the same grid shape.
        turn_order: ``sequential`` (paper) or ``round_robin``.
        net_order: ``half_perimeter``, largest bounding box first (the paper's code), ties in file
            order; ``half_perimeter_up``, smallest first; or ``file``.
        max_steps: steps after which a task fails (the paper's T_max). None: 50 as in the paper,
            or twice X + Y where that is more: 50 steps do not cross a large grid.
        overflow: ``forbidden`` or ``allowed``.
        decomposition: of nets into tasks, ``mst`` (paper) or ``steiner``, see
            :func:`marouting.trees.decomposition.two_pin_tasks`.

    Raises:
        InputError: no problem, unequal grids, a problem without anything to route, or an option
            out of its range.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        *,
        turn_order: TurnOrder = "sequential",
        net_order: NetOrder = "half_perimeter",
        max_steps: int | None = None,
        overflow: Overflow = "forbidden",
        decomposition: Decomposition = "mst",
    ) -> None:
        if not problems:
            raise InputError("problems: expected at least one")
        if any(problem.grid != problems[0].grid for problem in problems):
            shapes = sorted({problem.grid for problem in problems})
            raise InputError(f"problems: expected one grid shape, found {shapes}")
        check_choice("turn_order", turn_order, TurnOrder)
        check_choice("overflow", overflow, Overflow)
        width, height, _ = problems[0].grid
        if max_steps is None:
            max_steps = max(50, 2 * (width + height))
        if not 1 <= max_steps <= UNLIMITED:
            raise InputError(f"max_steps: expected 1 to {UNLIMITED}, found {max_steps}")
        self.problems = tuple(problems)
        self.grid = Grid.of(problems[0].grid)
        self.turn_order: TurnOrder = turn_order
        self.static, self.nets = static_state(
            self.problems,
            self.grid,
            net_order,
            decomposition,
            sequential=turn_order == "sequential",
            overflow=overflow == "allowed",
            max_steps=max_steps,
        )
        m, n = self.nets.shape
        self.dynamic = Dynamic(
            remaining=np.empty((m, self.grid.edges), np.int32),
            # Zeros that nobody has touched yet take no memory, and _reset leaves them alone.
            used=np.zeros((m, n, (self.grid.edges + 7) // 8), np.uint8),
            agents=np.zeros((m, n), AGENT),
            games=np.zeros(m, GAME),
        )
        self.reset()

    @property
    def agents(self) -> NDArray[Any]:
        """(M, N) AGENT records; a view, to be read."""
        return self.dynamic.agents

    @property
    def games(self) -> NDArray[Any]:
        """(M,) GAME records; a view, to be read."""
        return self.dynamic.games

    @property
    def max_steps(self) -> int:
        """Steps after which a task fails (the paper's T_max)."""
        return self.static.max_steps

    @property
    def tasks(self) -> NDArray[np.int32]:
        """(M, N) number of two-pin tasks of every agent."""
        return np.diff(self.static.first, axis=1)

    def reset(self, which: NDArray[np.bool_] | None = None) -> None:
        """Starts the episodes of all problems, or of those where ``which`` (M,) is true.

        Raises:
            ValueError: ``which`` is not one boolean a problem.
        """
        if which is None:
            which = np.ones(len(self.problems), np.bool_)
        if which.shape != self.games.shape or which.dtype != np.bool_:
            raise ValueError(f"which: expected {len(self.problems)} booleans, found {which}")
        _reset(self.static, self.dynamic, which)

    def part(self, which: NDArray[np.integer] | slice) -> "Engine":
        """An engine of some of the problems, which goes on from how they stand.

        Args:
            which: their indices; or a slice of them, and the two engines play one game.
        """
        part = copy.copy(self)
        for cached in ("play_turn", "_problems", "_all"):
            vars(part).pop(cached, None)
        part.problems = tuple(self.problems[m] for m in np.arange(len(self.problems))[which])
        part.nets = self.nets[which]
        static = self.static
        part.static = static._replace(
            capacity=static.capacity[which],
            demand=static.demand[which],
            first=static.first[which],
            order=static.order[which],
        )
        part.dynamic = Dynamic._make(array[which] for array in self.dynamic)
        return part

    def move(self, moves: NDArray[np.integer]) -> None:
        """The first half of a step: agents move, tasks end.

        Args:
            moves: (M,), the moves of the agents whose turn it is, or (M, N), one for every agent,
                carried out in turn order. NOBODY (−1) moves nobody; so does any move of an agent
                that is not active, or that has to wait for its turn.

        Raises:
            ValueError: a move outside −1…5, or another shape.
        """
        self.check(moves)
        (move_turn if moves.ndim == 1 else move_all)(self.static, self.dynamic, moves)

    def settle(self, everyone: bool) -> None:
        """The second half of a step: next tasks start, agents finish, the turn passes.

        Args:
            everyone: whether the moves were (M, N), of all agents, rather than (M,).
        """
        (settle_all if everyone else settle_turn)(self.static, self.dynamic)

    def step(self, moves: NDArray[np.integer]) -> None:
        """Both halves of a step at once; arguments and errors as of :meth:`move`."""
        self.check(moves)
        (_step_turn if moves.ndim == 1 else _step_all)(self.static, self.dynamic, moves)

    @functools.cached_property
    def play_turn(self) -> Callable[[int, NDArray[np.int8]], tuple[int, int]]:
        """:meth:`step` for the only problem of an engine, without checks or arrays: quick.

        Called with

        * a move, 0 to 5, for the agent whose turn it is; there has to be one;
        * a mask, (1, 6) int8, contiguous; filled with the mask of the agent to look at next: the
          one whose turn it is now, or the one that moved if it is done.

        It returns the agent whose turn it is now, or NOBODY, and the status of the one that moved.
        """
        static, dynamic = self.static, self.dynamic
        code = bound(_play_turn, static, dynamic, 0, np.empty((1, MOVES), np.int8))
        return functools.partial(code, static, dynamic)

    def check(self, moves: NDArray[np.integer]) -> None:
        """Raises ValueError for moves that :meth:`move` does not take."""
        # The compiled functions index by these without looking.
        if moves.shape not in (self.games.shape, self.agents.shape) or moves.dtype.kind not in "iu":
            raise ValueError(
                f"moves: expected integers of shape {self.games.shape} or {self.agents.shape}, "
                f"found {moves.dtype} of shape {moves.shape}"
            )
        if not (moves.min() >= NOBODY and moves.max() < MOVES):
            raise ValueError(f"moves: expected {list(Move)} or {NOBODY}, found {moves}")

    @functools.cached_property
    def _problems(self) -> NDArray[np.int32]:
        return np.arange(len(self.problems), dtype=np.int32)

    @functools.cached_property
    def _all(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        _, n = self.nets.shape
        agents = np.where(self.nets == NOBODY, NOBODY, np.arange(n, dtype=np.int32))
        return np.repeat(self._problems, n), agents.ravel()

    def pairs(self, everyone: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Indices (problem, agent) of all M·N agents, or of the M agents whose turn it is.

        What observations and masks are asked for with; NOBODY stands for an absent agent, and for
        that of a problem that is over.
        """
        if everyone:
            return self._all
        return self._problems, self.games["agent"]

    def masks(
        self,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.int8] | None = None,
    ) -> NDArray[np.int8]:
        """(K, 6) int8 action masks of K agents: 1 where a move would cross its edge.

        A mask is never all zero: an agent that is boxed in gets all ones, every move being
        blocked.
        """
        if out is None:
            out = np.empty((len(problems), MOVES), np.int8)
        _masks(self.static, self.dynamic, problems, agents, out)
        return out

    def metrics(self, m: int = 0) -> Metrics:
        """The figures of problem ``m`` as it stands."""
        game = self.games[m]
        return Metrics(
            overflow=int(game["overflow"]),
            wirelength=int(game["wirelength"]),
            joined=int(game["joined"]),
            tasks=int(self.static.first[m, -1] - self.static.first[m, 0]),
            steps=int(game["steps"]),
        )

    def solution(self, m: int = 0, used: NDArray[np.uint8] | None = None) -> Solution:
        """The routes of problem ``m``.

        Args:
            m: the problem.
            used: (N, ceil(E / 8)) uint8 copy of ``dynamic.used[m]`` from earlier; None: the
            present.
        """
        used = self.dynamic.used[m] if used is None else used
        nothing = np.empty(0, np.int64)
        net, edge = np.empty((2, _uses(used, self.nets[m], nothing, nothing)), np.int64)
        _uses(used, self.nets[m], net, edge)
        return Solution.of_uses(self.problems[m], net, edge)


def static_state(
    problems: tuple[Problem, ...],
    grid: Grid,
    net_order: NetOrder | NDArray[np.integer],
    decomposition: Decomposition,
    *,
    sequential: bool,
    overflow: bool,
    max_steps: int,
) -> tuple[Static, NDArray[np.int32]]:
    """The constant arrays of a batch, and (M, N) the net of every agent (NOBODY where absent).

    The arguments are those of :class:`Engine`, whose checks of grid and steps have been made. The
    order may also be (nets,) numbers: the net with the least comes first.

    Raises:
        InputError: a problem that cannot be played, or no such order or decomposition.
    """
    if isinstance(net_order, str):
        check_choice("net_order", net_order, NetOrder)
    elif any(np.shape(net_order) != (len(problem.nets),) for problem in problems):
        raise InputError(f"net_order: expected a number a net, found shape {np.shape(net_order)}")
    check_choice("decomposition", decomposition, Decomposition)
    pins = [problem.flat_pin_gcells for problem in problems]
    counts = [np.count_nonzero(first[1:] - first[:-1] > 1) for first, _ in pins]
    for m, count in enumerate(counts):
        if not count:
            raise InputError(f"problem {m}: expected a net with pins in two Gcells or more")
    shape = len(problems), max(counts)
    agent_net, order = np.empty((2, *shape), np.int32)
    first = np.zeros((shape[0], shape[1] + 1), np.int32)
    demand = np.zeros((*shape, grid.shape[2]), np.int32)
    size = np.empty(shape[1], np.int32)
    tasks = [two_pin_tasks(problem, decomposition) for problem in problems]
    for m, (problem, count) in enumerate(zip(problems, counts, strict=True)):
        first[m, 0] = first[m - 1, -1]  # 0 for the first problem
        most = _agents(
            *pins[m],
            tasks[m],
            grid.position,
            problem.net_demand,
            agent_net[m],
            first[m],
            demand[m],
            size,
        )
        if overflow and most > UNLIMITED:
            raise InputError(f"problem {m}: expected demands that add up to at most {UNLIMITED}")
        order[m, :count] = _turns(size[:count], agent_net[m, :count], net_order)
        order[m, count:] = NOBODY
    static = Static(
        neighbour=grid.neighbour,
        edge=np.where(grid.edge == OFF_GRID, np.int32(grid.edges - 1), grid.edge),
        exits=np.packbits(grid.edge != OFF_GRID, axis=1, bitorder="little")[:, 0],
        position=grid.position,
        capacity=np.array([problem.capacity for problem in problems]),
        demand=demand,
        tasks=np.concatenate([table[:, 1:] for table in tasks]),
        first=first,
        order=order,
        sequential=sequential,
        overflow=overflow,
        max_steps=max_steps,
    )
    return static, agent_net


@compiled
def _agents(
    pins: Any,
    gcells: Any,
    tasks: Any,
    position: Any,
    net_demand: Any,
    nets: Any,
    first: Any,
    demand: Any,
    half_perimeter: Any,
) -> int:
    """The agents of a problem: the nets with pins in two Gcells or more.

    Args:
        pins: (nets + 1,) and
        gcells: (Gcells,), see :attr:`marouting.problem.problem.Problem.flat_pin_gcells`.
        tasks: (K, 3), see :func:`marouting.trees.decomposition.two_pin_tasks`.
        position: (G, 3).
        net_demand: (nets, Z).
        nets: (N,) filled with the net of every agent, NOBODY where there is none.
        first: (N + 1,) filled as in :class:`Static`; the first entry is there.
        demand: (N, Z) filled as in :class:`Static`.
        half_perimeter: (N,) filled with width and height of the box around every agent's pins.

    Returns:
        The demand on an edge that every agent uses, in its most demanding layer at most.
    """
    n = most = task = 0
    for net in range(len(pins) - 1):
        if pins[net + 1] - pins[net] < 2:
            continue
        nets[n] = net
        before = task
        while task < len(tasks) and tasks[task, 0] == net:
            task += 1
        first[n + 1] = first[n] + task - before
        half_perimeter[n] = 0
        for axis in range(VIA_AXIS):
            least = largest = position[gcells[pins[net]], axis]
            for pin in range(pins[net] + 1, pins[net + 1]):
                at = position[gcells[pin], axis]
                if at < least:
                    least = at
                elif at > largest:
                    largest = at
            half_perimeter[n] += largest - least
        worst = wide(0)
        for layer in range(demand.shape[1]):
            demand[n, layer] = net_demand[net, layer]
            if demand[n, layer] > worst:
                worst = wide(demand[n, layer])
        most += worst
        n += 1
    for absent in range(n, len(nets)):
        nets[absent] = NOBODY
        first[absent + 1] = first[n]
    return most


def _turns(
    half_perimeter: NDArray[np.int32],
    nets: NDArray[np.int32],
    net_order: NetOrder | NDArray[np.integer],
) -> NDArray[np.int64]:
    """Agents in turn order, given (N,) the half-perimeters of their nets, and the nets."""
    if not isinstance(net_order, str):
        return np.argsort(net_order[nets], kind="stable")
    if net_order == "file":
        return np.arange(len(half_perimeter))
    if net_order == "half_perimeter":
        half_perimeter = -half_perimeter
    return np.argsort(half_perimeter, kind="stable")
