"""A step of the compiled game: moves, what they pay, and what agents see next.

With the paper's observation and a built-in reward, a whole step of all problems is one call,
:func:`play`. Otherwise :class:`marouting.player.Player` calls the parts of a step, and the
observation or the reward between them.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import copy_row
from marouting.batch.observation import paper_reward, write_paper
from marouting.batch.payment import move_and_pay
from marouting.batch.rules import (
    clear_problem,
    free_moves,
    may_move,
    move_agent,
    move_everyone,
    move_of,
    move_player,
    pass_turn,
    reset_problem,
    settle_agent,
    settle_turns,
    write_moves,
)
from marouting.batch.setup import Make, zeros
from marouting.batch.state import GAME, MASKS, Dynamic, Option, Static
from marouting.game import (
    NOBODY,
    Crossing,
    Ending,
    Status,
)
from marouting.kernels import as_index, compiled, i64, inlined
from marouting.memory import check_memory
from marouting.observations import (
    Observation,
    PaperObservation,
)
from marouting.problem.grid import MOVES
from marouting.rewards import Prices, Reward, Share, prices_of


class StepBuffers(NamedTuple):
    """The input and output of a step of M problems, with K rows each.

    There is a row for every agent (K = N), or one for the agent whose turn it is (K = 1).
    ``final_obs`` and ``final_mask`` are only written where ``obs`` no longer shows the result of
    the move: where the task ended, or where the row now belongs to another agent. So the transition
    of a row that ``acted`` leads from the ``obs`` before the step to ``final_obs`` in these cases,
    and otherwise to the ``obs`` after the step.
    """

    agents: NDArray[np.int32]  # (M, K) the agent of each row, or NOBODY
    obs: NDArray[np.float32]  # (M, K, *S) what it sees now; zeros for NOBODY
    mask: NDArray[np.int8]  # (M, K, A) its moves that cross an edge now; never all zero
    actions: NDArray[np.int16]  # (M, K) input: the moves to make; NOBODY: no move
    acted: NDArray[np.bool_]  # (M, K) whether the row's agent moved in the step
    reward: NDArray[np.float32]  # (M, K) what the step paid it; if K = 1, all agents together
    ending: NDArray[np.int8]  # (M, K) Ending of the agent's task in the step
    final_obs: NDArray[np.float32]  # (M, K, *S) what the agent saw where it arrived
    final_mask: NDArray[np.int8]  # (M, K, A) likewise
    terminated: NDArray[np.bool_]  # (M, K) all tasks of the agent are joined
    truncated: NDArray[np.bool_]  # (M, K) all tasks of the agent have ended, and some failed
    active: NDArray[np.bool_]  # (M, K) rows whose agent still routes, also if it waits for its turn
    over: NDArray[np.bool_]  # (M,) episodes that ended in the step
    total: NDArray[np.float64]  # (M,) rewards of all agents in the episode so far
    final: NDArray[Any]  # (M,) GAME at the end of the problem's last episode

    @classmethod
    def of(
        cls,
        problems: int,
        rows: int,
        shape: tuple[int, ...],
        actions: int = MOVES,
        make: Make | None = None,
    ) -> "StepBuffers":
        """New buffers, made by ``make``; None: on the processor.

        Raises:
            InputError: they would take too much memory.
        """
        if make is None:
            size = math.prod(shape)
            bytes_of_obs = 2 * np.dtype(np.float32).itemsize * problems * rows * size
            check_memory(bytes_of_obs, "{} observations of {} numbers", problems * rows, size)
            make = zeros
        each = problems, rows
        buffers = cls(
            agents=make("agents", each, np.int32),
            obs=make("obs", (*each, *shape), np.float32),
            mask=make("mask", (*each, actions), np.int8),
            actions=make("actions", each, np.int16),
            acted=make("acted", each, np.bool_),
            reward=make("reward", each, np.float32),
            ending=make("ending", each, np.int8),
            final_obs=make("final_obs", (*each, *shape), np.float32),
            final_mask=make("final_mask", (*each, actions), np.int8),
            terminated=make("terminated", each, np.bool_),
            truncated=make("truncated", each, np.bool_),
            active=make("active", each, np.bool_),
            over=make("over", (problems,), np.bool_),
            total=make("total", (problems,), np.float64),
            final=make("final", (problems,), GAME),
        )
        buffers.agents[:] = buffers.actions[:] = NOBODY
        buffers.mask[:] = buffers.final_mask[:] = 1
        return buffers


class FastPath(NamedTuple):
    """What the compiled step has to know about the components."""

    everyone: bool  # whether all agents have a row, or only the one whose turn it is
    sees_paper: bool  # whether the observation is the paper's
    pays_prices: bool  # whether the reward is nothing but the following prices
    # True: prices beside the table, which pays only the agent that moves. None, not False: numba
    # then compiles the check away.
    pays_others: bool | None
    via_capacity: float  # see PaperObservation
    table: NDArray[np.float32]  # (5, 3) see marouting.rewards.Prices
    overflow_price: float  # see Prices.added_overflow
    prices: NDArray[np.float64]  # (4, 3) see Prices.shared
    cells: NDArray[np.int32]  # (M, 2, G) to work with, if failed tasks are charged for; else G = 0

    @classmethod
    def of(
        cls,
        shape: tuple[int, int],
        observation: Observation,
        reward: Reward,
        *,
        everyone: bool,
        make: Make = zeros,
    ) -> "FastPath":
        """What the compiled step of M games on G Gcells (shape) has to know about components."""
        paper = type(observation) is PaperObservation
        looks: Any = observation if paper else PaperObservation()
        prices = prices_of(reward)
        known = Prices.of() if prices is None else prices
        charges = known.shared[Share.OTHERS, 1] != 0
        return cls(
            everyone=everyone,
            sees_paper=paper,
            pays_prices=prices is not None,
            pays_others=True if known.shared.any() else None,
            via_capacity=looks.via_capacity,
            table=known.table.astype(np.float32),
            overflow_price=float(known.added_overflow),
            prices=known.shared,
            cells=make("cells", (shape[0], 2, shape[1] * charges), np.int32),
        )


class Earlier(NamedTuple):
    """The games before a move, as rewards see them; see :class:`marouting.columns.Before`."""

    agents: NDArray[Any]  # (M, N) AGENT
    games: NDArray[Any]  # (M,) GAME
    remaining: NDArray[np.int32]  # (M, E)


# --- what a step writes ---------------------------------------------------------------------------

_MASKS = MASKS.view(np.int16)
"""(64, 3) int16, :data:`marouting.batch.state.MASKS` in pairs of bytes."""


@inlined
def write_mask(static: Static, dynamic: Dynamic, mask: Any, m: int, n: int, row: int) -> None:
    """Writes the moves of an agent that cross an edge, in bytes or in pairs; ones for NOBODY."""
    free = i64(0)
    if n != NOBODY:
        free = free_moves(static, dynamic, m, as_index(n))
    if mask.shape[2] >= MOVES:
        write_moves(static, free, mask[m], row)
        return
    for pair in range(_MASKS.shape[1]):
        mask[m, row, pair] = _MASKS[free, pair]


@inlined
def _write_obs(
    static: Static, dynamic: Dynamic, fast: FastPath, m: int, n: int, obs: Any, mask: Any, row: int
) -> None:
    """Writes what an agent sees, and its mask; zeros and ones for NOBODY."""
    write_paper(static, dynamic, fast.via_capacity, m, n, obs[m], row)
    write_mask(static, dynamic, mask, m, n, row)


@inlined
def _make_moves(static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int) -> None:
    """The moves of a step of one problem, before anybody settles."""
    if fast.pays_others is not None:
        move_and_pay(static, dynamic, fast, m, b.actions, b.reward)
    elif fast.everyone:
        move_everyone(static, dynamic, m, b.actions)
    else:
        move_player(static, dynamic, m, i64(b.actions[m, 0]))


@inlined
def _write_move(dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int, n: int, row: int) -> Any:
    """Writes the result of an agent's move; returns the reward."""
    agent = dynamic.agents[m, n]
    b.acted[m, row] = agent.crossing != Crossing.NONE
    b.ending[m, row] = agent.ending
    if fast.pays_others is None:
        b.reward[m, row] = paper_reward(fast.table, fast.overflow_price, agent)
    return b.reward[m, row]


@inlined
def start_game(static: Static, dynamic: Dynamic, b: StepBuffers, m: int) -> None:
    """Starts an episode of a problem that is cleared, in which nobody has acted yet."""
    reset_problem(static, dynamic, m)
    b.over[m] = False
    b.total[m] = 0
    for row in range(b.agents.shape[1]):
        b.acted[m, row] = b.terminated[m, row] = b.truncated[m, row] = False
        b.reward[m, row] = 0
        b.ending[m, row] = Ending.NONE


@inlined
def _write_over(b: StepBuffers, m: int, playing: bool, game: Any) -> None:
    """After a step: records whether the episode has ended with it, and how."""
    b.over[m] = playing and game.active == 0
    if b.over[m]:
        b.final[m].overflow = game.overflow
        b.final[m].wirelength = game.wirelength
        b.final[m].joined = game.joined
        b.final[m].steps = game.steps


# --- with any observation, the parts of a step ----------------------------------------------------


@inlined
def _has_final_obs(
    static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int, row: int
) -> Any:
    """Whether a row gets a final observation: a task has ended, or the turn passes to others."""
    if b.ending[m, row] != Ending.NONE:
        return True
    turns = not (fast.everyone or static.sequential) and dynamic.games[m].active > 1
    return turns and b.acted[m, row]


@compiled
def list_arrived(
    static: Static,
    dynamic: Dynamic,
    b: StepBuffers,
    fast: FastPath,
    on_turn: Any,
    problems: Any,
    agents: Any,
    rows: Any,
) -> int:
    """Lists the agents that get a final observation; returns how many they are."""
    count = 0
    for m in range(len(on_turn)):
        for row in range(b.agents.shape[1]):
            if _has_final_obs(static, dynamic, b, fast, m, row):
                problems[count] = m
                agents[count] = row if fast.everyone else on_turn[m]
                rows[count] = m * b.agents.shape[1] + row
                count += 1
    return count


@inlined
def move_game(static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int) -> None:
    """The moves of a step of one problem and what is paid for them, before anybody settles."""
    _make_moves(static, dynamic, b, fast, m)
    for row in range(b.agents.shape[1]):
        n = i64(row) if fast.everyone else i64(dynamic.games[m].agent)
        if n == NOBODY or dynamic.agents[m, as_index(n)].status == Status.ABSENT:
            b.acted[m, row] = False
            b.reward[m, row] = 0
            b.ending[m, row] = Ending.NONE
        else:
            b.total[m] += _write_move(dynamic, b, fast, m, as_index(n), row)


@compiled
def move_games(
    static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, begins: Any
) -> None:
    """:func:`move_game` in all problems whose episode does not begin."""
    for m in range(len(begins)):
        if not begins[m]:
            move_game(static, dynamic, b, fast, m)


SETTLE_NOTHING, SETTLE_TURNS, SETTLE_ALL = 0, 1, 2
"""What is to be settled at the end of a step: nothing, whose turn it is, or all that agents do."""


@inlined
def settle_game(
    static: Static,
    dynamic: Dynamic,
    b: StepBuffers,
    fast: FastPath,
    m: int,
    on_turn: int,
    settling: int,
) -> None:
    """The end of a step of one problem, whose turn was that of ``on_turn``."""
    game = dynamic.games[m]
    if settling != SETTLE_NOTHING:
        if fast.everyone:
            if settling == SETTLE_ALL:
                for n in range(b.agents.shape[1]):
                    settle_agent(static, dynamic, m, n)
            settle_turns(static, dynamic, m)
        elif on_turn != NOBODY:
            if settling == SETTLE_ALL:
                settle_agent(static, dynamic, m, as_index(on_turn))
            pass_turn(static, dynamic, m)
        acted = False
        for row in range(b.agents.shape[1]):
            acted |= b.acted[m, row]
        _write_over(b, m, acted, game)
    if not fast.everyone:
        b.agents[m, 0] = game.agent
    for row in range(b.agents.shape[1]):
        n = i64(row) if fast.everyone else i64(on_turn)
        if n != NOBODY:  # once a game is over, these stay as its last move left them
            status = dynamic.agents[m, as_index(n)].status
            b.terminated[m, row] = status == Status.TERMINATED
            b.truncated[m, row] = status == Status.TRUNCATED
        n = i64(b.agents[m, row])
        b.active[m, row] = n != NOBODY and dynamic.agents[m, as_index(n)].status == Status.ACTIVE


@compiled
def settle_games(
    static: Static,
    dynamic: Dynamic,
    b: StepBuffers,
    fast: FastPath,
    begins: Any,
    on_turn: Any,
    settling: int,
) -> None:
    """:func:`settle_game` in all problems, and the masks."""
    for m in range(len(begins)):
        end = i64(SETTLE_NOTHING) if begins[m] else i64(settling)
        settle_game(static, dynamic, b, fast, m, i64(on_turn[m]), end)
        for row in range(b.agents.shape[1]):
            write_mask(static, dynamic, b.mask, m, i64(b.agents[m, row]), i64(row))


# --- with a reward of the user's own, moves one after another -----------------------------------


@compiled
def move_next(
    static: Static,
    dynamic: Dynamic,
    everyone: bool,
    k: int,
    actions: Any,
    begins: Any,
    alone: Any,
    movers: Any,
    moves: Any,
) -> bool:
    """The k-th moves of a step: fills in who moves, or NOBODY, and how; whether anybody does."""
    found = False
    for m in range(len(begins)):
        n = i64(static.order[m, k] if everyone else dynamic.games[m].agent)
        movers[m] = moves[m] = NOBODY
        if n == NOBODY or begins[m]:
            continue
        move = i64(actions[m, n if everyone else 0])
        if may_move(dynamic, m, as_index(n), alone[m], move):
            movers[m], moves[m], found = n, move, True
            move_agent(static, dynamic, m, as_index(n), as_index(move))
    return found


@compiled
def settle_movers(
    static: Static, dynamic: Dynamic, before: Earlier, movers: Any, moves: Any, arrived: Dynamic
) -> None:
    """Settles the agents that moved, records where they arrived, and updates ``before``."""
    for m in range(len(movers)):
        if movers[m] == NOBODY:
            continue
        n = as_index(movers[m])
        move = min(move_of(static, i64(moves[m])), MOVES - 1)
        edge = as_index(static.edge[as_index(before.agents[m, n].cell), as_index(move)])
        arrived.agents[m, n] = dynamic.agents[m, n]
        for option in range(Option.VISITED, Option.BEGUN + 1):
            if static.options[option] >= 0 and option != Option.KEPT:
                row = as_index(static.options[option] + n)
                copy_row(arrived.sets, m, row, dynamic.sets, m, row)
        settle_agent(static, dynamic, m, n)
        before.remaining[m, edge] = dynamic.remaining[m, edge]
        before.agents[m, n] = dynamic.agents[m, n]
        before.games[m] = dynamic.games[m]


# --- the paper's observation and a built-in reward ------------------------------------------------


@inlined
def step_problem(static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int) -> None:
    """A whole step of one problem."""
    on_turn = i64(dynamic.games[m].agent)
    move_game(static, dynamic, b, fast, m)
    for row in range(b.agents.shape[1]):
        if _has_final_obs(static, dynamic, b, fast, m, row):
            n = i64(row) if fast.everyone else on_turn
            _write_obs(static, dynamic, fast, m, n, b.final_obs, b.final_mask, i64(row))
    settle_game(static, dynamic, b, fast, m, on_turn, i64(SETTLE_ALL))
    for row in range(b.agents.shape[1]):
        _write_obs(static, dynamic, fast, m, i64(b.agents[m, row]), b.obs, b.mask, i64(row))


@compiled
def play(
    static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, steps: bool, restarts: bool
) -> None:
    """Steps and restarts of all problems."""
    for m in range(len(b.over)):
        if restarts and b.over[m]:
            clear_problem(static, dynamic, m, i64(0), i64(1))
            start_game(static, dynamic, b, m)
            settle_game(static, dynamic, b, fast, m, i64(NOBODY), i64(SETTLE_NOTHING))
            for row in range(b.agents.shape[1]):
                _write_obs(static, dynamic, fast, m, i64(b.agents[m, row]), b.obs, b.mask, i64(row))
        elif steps:
            step_problem(static, dynamic, b, fast, m)
