"""The array player: plays M problems at once for the batch environment and for trainings.

With the paper's observation and a built-in reward, a whole step is one compiled call. With another
observation, the moves of a step are one compiled call, and the observation is called at most twice:
for the final observations of tasks and turns that end, and then for all rows. With a reward of your
own, moves are made one by one, and the reward is called after each of them.

:class:`StepBuffers` holds what a learner needs: which tasks ended in the step, and how; the final
observation of a task, from which to bootstrap; and, on request, only the row of the agent whose
turn it is. The transition of a row that ``acted`` leads from the ``obs`` before the step to
``final_obs`` if the task ended or the row now belongs to another agent, and otherwise to the
``obs`` after the step.
"""

import copy
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import copy_row
from marouting.batch.engine import Engine
from marouting.batch.observation import paper_reward, see_paper, write_paper
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
from marouting.config import check
from marouting.game import (
    ACTIVE,
    ANSWERED,
    GOES_ON,
    NOBODY,
    Crossing,
    Ending,
    Status,
)
from marouting.kernels import as_index, compiled, i64, inlined, specialised
from marouting.memory import check_memory
from marouting.observations import (
    Observation,
    PaperObservation,
    has_form,
    has_move_order,
    move_order_of,
    space_of,
    write_rows,
)
from marouting.options import FORMS
from marouting.problem.grid import MOVES
from marouting.registry import is_ours
from marouting.rewards import Prices, Reward, Share, paid_by, prices_of
from marouting.source import ProblemSampler

COMPILES = "the batch of games", 8

_STAYED = Crossing.NONE.value


class StepBuffers(NamedTuple):
    """The input and output of a step of M problems, with K rows each.

    There is a row for every agent (K = N), or one for the agent whose turn it is (K = 1).
    ``final_obs`` and ``final_mask`` are only written where ``obs`` no longer shows the result of
    the move: where the task ended, or where the row now belongs to another agent.
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
    """What the compiled step has to know about the pieces."""

    everyone: bool  # whether all agents have a row, or only the one whose turn it is
    observation: bool  # whether the observation is the paper's
    reward: bool  # whether the reward is nothing but the following prices
    shares: bool | None  # True: prices beside the table, which only pays the agent that moves.
    # None, not False: numba then compiles the check away
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
        """What the compiled step of M games on G Gcells (shape) has to know about these pieces."""
        paper = type(observation) is PaperObservation
        looks: Any = observation if paper else PaperObservation()
        prices = prices_of(reward)
        known = Prices.of() if prices is None else prices
        charges = known.shared[Share.OTHERS, 1] != 0
        return cls(
            everyone=everyone,
            observation=paper,
            reward=prices is not None,
            shares=True if known.shared.any() else None,
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


class Saved(NamedTuple):
    """A saved state of a player's games."""

    dynamic: Dynamic
    buffers: StepBuffers
    counts: NDArray[np.int64] | None = None  # (M,) see ProblemSampler; None where problems stay
    seeds: NDArray[np.object_] | None = None  # (M,) likewise


class Player:
    """Plays the games of an engine through arrays.

    Args:
        engine: the games.
        observation: what agents see.
        reward: what moves pay.
        everyone: whether all agents have a row, or only the one whose turn it is.
        buffers: the arrays to use; None: new ones.
        draws: draws the problem of every episode; None: problems are fixed.
        turned: whether actions and masks are in the observation's own order of moves, as for
            learners (:func:`marouting.observations.move_order_of`).

    Attributes:
        played: (M, K) the moves on the grid of the last step.
        fast: what the compiled step knows about the pieces.
    """

    def __init__(
        self,
        engine: Engine,
        observation: Observation,
        reward: Reward,
        *,
        everyone: bool = True,
        buffers: StepBuffers | None = None,
        draws: ProblemSampler | None = None,
        turned: bool = False,
    ) -> None:
        for name, piece in (("observation", observation), ("reward", reward)):
            columns, plain = FORMS[name][:2]
            what = f"an object with {columns}, which all but AEC, Parallel and gymnasium.make need"
            fits, found = has_form(piece, columns, plain), f"found {type(piece).__name__}"
            if hasattr(piece, columns) and not fits:
                found += f", which has a {plain} of its own and inherits {columns}"
            check(name, fits, f"{what}, {found}")
        self.engine, self.observation, self.reward = engine, observation, reward
        self.turned = turned and has_move_order(observation)
        # Those of the package write every number.
        self._clears = not is_ours(type(observation).__module__)
        self.everyone, self.draws = everyone, draws
        problems, agents = engine.nets.shape
        if buffers is None:
            bounds = draws.episodes.bounds if draws else engine.problems
            shape = space_of(observation, bounds, engine.static.overflow_allowed).shape
            rows = agents if everyone else 1
            buffers = StepBuffers.of(problems, rows, shape, engine.actions)
        self.buffers = buffers
        shape = len(engine.games), engine.grid.gcells
        self.fast = FastPath.of(shape, observation, reward, everyone=everyone)
        self._bind()

    @property
    def compiled(self) -> bool:
        """Whether a whole step is one compiled call.

        It is with the paper's observation and six actions, and a built-in reward.
        """
        return self.fast.observation and self.fast.reward and self.engine.actions == MOVES

    def _bind(self) -> None:
        """Prepares the calls after the arrays have been replaced."""
        engine, buffers = self.engine, self.buffers
        self.played = buffers.actions
        if self.everyone:
            buffers.agents[:] = engine.pairs(everyone=True)[1].reshape(engine.nets.shape)
        own_reward = not self.fast.reward
        self._before: Earlier | None = None
        self.kernel_buffers = buffers
        if self.compiled:  # masks are written in pairs of bytes, which is faster
            self.kernel_buffers = buffers._replace(
                mask=buffers.mask.view(np.int16), final_mask=buffers.final_mask.view(np.int16)
            )
        self._arguments = engine.static, engine.dynamic, self.kernel_buffers, self.fast
        if own_reward:
            now = engine.dynamic
            self._before = Earlier(now.agents.copy(), now.games.copy(), now.remaining.copy())
            # Where movers arrived, before their next tasks began.
            self._arrived = now._replace(agents=now.agents.copy(), sets=now.sets.copy())
            self._mirror_games()
        if self.compiled:
            self._step = specialised(_play, *self._arguments, True, True)
            return
        nobody, nowhere = np.zeros(len(buffers.over), np.bool_), engine.games["agent"].copy()
        self._settle = specialised(_settle_and_show, *self._arguments, nobody, nowhere, NOT)
        # Problems, agents and rows of those that have arrived.
        self._places = tuple(np.zeros(buffers.agents.size, np.int32) for _ in range(3))
        self._list_arrived = specialised(_list_arrived, *self._arguments, nowhere, *self._places)
        if not own_reward:
            self._move = specialised(_move_and_pay, *self._arguments, nobody)

    def reset(self, which: NDArray[np.bool_] | None = None) -> None:
        """Starts the episodes of all problems, or of those where ``which`` (M,) is true."""
        over = self.buffers.over
        if which is None:
            which = np.ones(len(over), np.bool_)
        if self.compiled:
            self._draw(which)
            were_over = over.copy()
            over[:] = which
            self._step(*self._arguments, False, True)
            over[~which] = were_over[~which]
            return
        which = np.ascontiguousarray(which)  # as bound code expects it
        self._start(which)
        nobody = np.full(len(over), NOBODY, np.int32)
        self._settle(*self._arguments, which, nobody, NOT)
        self._look(which)
        self._turn_masks()

    def step(self, restart: bool = False) -> None:
        """Makes the moves in ``buffers.actions``, in turn order, and fills the other arrays.

        Args:
            restart: whether a problem whose episode ended in the previous step starts its next
                episode instead.
        """
        if self.compiled:
            if restart:
                self._draw(self.buffers.over)
            self._step(*self._arguments, True, restart)
        elif self.turned:
            chosen = self.buffers.actions.copy()
            self.played = _picked(self._order(), chosen)
            self.buffers.actions[:] = self.played
            self._step_in_parts(restart)
            self.buffers.actions[:] = chosen  # learners remember what they chose
            self._turn_masks()
        else:
            self._step_in_parts(restart)

    def part(self, which: NDArray[np.integer]) -> "Player":
        """A player of some of the problems (indices), which continues from their present state."""
        part = copy.copy(self)
        part.engine = self.engine.part(which)
        part.buffers = StepBuffers._make(array[which] for array in self.buffers)
        part.draws = self.draws and self.draws.part(which)
        part.fast = self.fast._replace(cells=self.fast.cells[which])
        part._bind()
        return part

    def save(self) -> Saved:
        """A copy of the state of all games, for :meth:`restore`."""
        buffers = StepBuffers._make(array.copy() for array in self.buffers)
        saved = Saved(self.engine.save(), buffers)
        if self.draws is None:
            return saved
        return saved._replace(counts=self.draws.counts.copy(), seeds=self.draws.seeds.copy())

    def go_to(self, counts: NDArray[np.int64], seeds: NDArray[np.object_] | None = None) -> None:
        """Puts the problems in place that games play after ``counts`` (M,) episodes have begun."""
        if self.draws is None or counts.shape != self.draws.counts.shape:
            raise ValueError(f"counts: expected those of other games, found shape {counts.shape}")
        self._replace(self.draws.go_to(counts, seeds))

    def restore(self, saved: Saved) -> None:
        """Puts all games back into a saved state; raises ValueError if it is of other games."""
        if saved.counts is not None or self.draws is not None:
            counts = np.zeros(0, np.int64) if saved.counts is None else saved.counts
            self.go_to(counts, saved.seeds)
        agents, nets = saved.buffers.agents, self.engine.nets.shape[1]
        if not NOBODY <= agents.min() <= agents.max() < nets:
            raise ValueError(f"saved: expected {NOBODY} to {nets - 1} for agents")
        self.engine.restore(saved.dynamic)
        for name in StepBuffers._fields:
            getattr(self.buffers, name)[...] = getattr(saved.buffers, name)
        self._mirror(slice(None))

    @property
    def movers(self) -> NDArray[np.bool_]:
        """(M, K) rows whose agents move in the next step.

        These are all that are active, but where only one agent of a game may move, in sequential
        order or while one is asked whether to rip up its net, the row of that agent.
        """
        b, games = self.buffers, self.engine.games
        own_turn = b.agents == games["agent"][:, None]
        movers: NDArray[np.bool_] = b.active & (own_turn | ~self._alone[:, None])
        return movers

    @property
    def _alone(self) -> NDArray[np.bool_]:
        """(M,) games in which only the agent whose turn it is may move."""
        alone: NDArray[np.bool_] = (self.engine.games["asked"] != 0) | self.engine.static.sequential
        return alone

    # --- moves of the observation -------------------------------------------------------------

    def actions_of(self, moves: NDArray[np.integer]) -> NDArray[np.int16]:
        """The actions for ``buffers.actions`` that stand for moves on the grid, both (M, K)."""
        if not self.turned:
            return moves.astype(np.int16)
        return _picked(np.argsort(self._order(), axis=-1), moves)  # the other way round

    def _order(self) -> NDArray[np.int64]:
        """(M, K, A), see :func:`marouting.observations.move_order_of`."""
        b = self.buffers
        obs = b.obs.reshape(-1, *b.obs.shape[2:])
        return self._order_of(obs).reshape(b.mask.shape)

    def _order_of(self, obs: NDArray[np.float32]) -> NDArray[np.int64]:
        """(K, A), of K observations."""
        rules = self.engine.rules
        return move_order_of(self.observation, obs, rules.actions, rules.messages)

    def _turn_masks(self) -> None:
        """Puts masks that have just been written for all rows in the order of the observation."""
        if self.turned:
            self.buffers.mask[:] = np.take_along_axis(self.buffers.mask, self._order(), -1)

    # --- problems that change -----------------------------------------------------------------

    def _draw(self, which: NDArray[np.bool_]) -> None:
        """Before episodes begin, where ``which`` (M,) is true: puts their problems in place."""
        if self.draws is not None:
            self._replace(self.draws.begin_next(which))

    def _replace(self, games: list[int]) -> None:
        """Puts the drawn problems of some games in place of the others."""
        b = self.buffers
        for m in games:
            assert self.draws is not None
            self.engine.replace(m, self.draws.problems[m])
            if self.everyone:
                b.agents[m] = self.engine.agents_of(m)
            # Rows of agents that are no longer there.
            for seen, mask in ((b.obs, b.mask), (b.final_obs, b.final_mask)):
                seen[m], mask[m] = 0, 1

    # --- any pieces ---------------------------------------------------------------------------

    def _mirror(self, which: Any) -> None:
        """Copies the games of some problems to ``before``, which rewards are given."""
        if self._before is not None:
            self._before.agents[which] = self.engine.agents[which]
            self._before.remaining[which] = self.engine.remaining[which]
            self._mirror_games()

    def _mirror_games(self) -> None:
        """Copies the records of all games to ``before``."""
        if self._before is not None:
            self._before.games[...] = self.engine.games
            # Edges that nets have just given back are paid for with the next move.
            games = self._before.games
            ripped = np.flatnonzero(games["ripped"])
            for name in ("joined", "overflow", "wirelength"):
                games[name][ripped] = games[f"kept_{name}"][ripped]

    def _start(self, which: NDArray[np.bool_]) -> None:
        """Starts episodes, in which nobody has acted yet."""
        b = self.buffers
        self._draw(which)
        self.engine.reset(which)
        self._mirror(which)
        b.acted[which] = b.over[which] = b.terminated[which] = b.truncated[which] = False
        b.reward[which] = b.total[which] = b.ending[which] = 0

    def _step_in_parts(self, restart: bool) -> None:
        b, engine = self.buffers, self.engine
        begins = b.over & restart
        asked = engine.games["agent"].copy()
        if begins.any():
            self._start(begins)
        if self._before is None:
            self._move(*self._arguments, begins)
            self._look_back(asked)
            self._settle(*self._arguments, begins, asked, ALL)
        else:
            self._move_by_turns(self._before, begins, asked)
            self._look_back(asked)
            self._settle(*self._arguments, begins, asked, _TURNS)
            if engine.static.options[Option.ROUNDS]:
                self._mirror((engine.games["ripped"] | engine.games["asked"]) != 0)
            else:
                self._mirror_games()
        self._look(None)

    def _move_by_turns(
        self, before: Earlier, begins: NDArray[np.bool_], asked: NDArray[np.int32]
    ) -> None:
        """Makes the moves, each with a call of the reward, and writes what came of them."""
        b, engine = self.buffers, self.engine
        paid = np.zeros(engine.nets.shape, np.float32)
        for name in ("added_overflow", "crossing", "ending"):
            engine.agents[name] = 0
        before.agents[...] = engine.agents
        alone = self._alone
        known = engine.static, engine.dynamic
        for k in range(engine.nets.shape[1] if self.everyone else 1):
            movers, moves = np.empty(len(begins), np.int32), np.empty(len(begins), np.int16)
            if not _move_next(*known, self.everyone, k, b.actions, begins, alone, movers, moves):
                continue
            paid += paid_by(self.reward, engine, before, movers)
            _settle_movers(*known, before, movers, moves, self._arrived)
            if engine.static.extended:
                # More may have changed than one edge of one net.
                mover = engine.agents[np.arange(len(movers)), movers]
                changed = (mover["crossing"] == ANSWERED) | (mover["ending"] != GOES_ON)
                self._mirror(changed & (movers != NOBODY))
        if self.everyone:
            b.reward[:] = paid
            taken: Any = ...
        else:
            b.reward[:, 0] = paid.sum(axis=1)
            taken = np.arange(len(asked)), asked
        agents = engine.agents[taken].reshape(b.acted.shape)
        nobody = begins if self.everyone else begins | (asked == NOBODY)
        b.acted[:] = (agents["crossing"] != _STAYED) & ~nobody[:, None]
        b.ending[:] = np.where(b.acted, agents["ending"], GOES_ON)
        b.total[:] += b.reward.sum(axis=1, dtype=np.float64)

    def _look_back(self, asked: NDArray[np.int32]) -> None:
        """Writes what agents saw where they arrived, whose tasks ended or who pass the turn."""
        b, engine = self.buffers, self.engine
        count = self._list_arrived(*self._arguments, asked, *self._places)
        if not count:
            return
        problems, agents, rows = (array[:count] for array in self._places)
        if self._before is not None:  # those whose tasks have ended stand elsewhere by now
            active = engine.games["active"].copy()
            settled = engine.agents["status"][problems, agents]
            np.add.at(engine.games["active"], problems, settled != ACTIVE)
            self._swap_arrived(problems, agents)
        out = np.empty((count, *b.obs.shape[2:]), np.float32)
        self._see(problems, agents, out)
        b.final_obs.reshape(-1, *b.obs.shape[2:])[rows] = out
        masks = engine.masks(problems, agents)
        if self.turned:
            masks = np.take_along_axis(masks, self._order_of(out), -1)
        b.final_mask.reshape(-1, engine.actions)[rows] = masks
        if self._before is not None:
            self._swap_arrived(problems, agents)
            engine.games["active"] = active

    def _swap_arrived(self, problems: NDArray[Any], agents: NDArray[Any]) -> None:
        """Swaps what changes for agents (K,) when their next tasks begin, as far as it is seen."""
        now, arrived, at = self.engine.dynamic, self._arrived, (problems, agents)
        now.agents[at], arrived.agents[at] = arrived.agents[at], now.agents[at]
        for option in (Option.VISITED, Option.TRIED):
            if (begin := self.engine.static.options[option]) >= 0:
                rows = problems, begin + agents
                now.sets[rows], arrived.sets[rows] = arrived.sets[rows], now.sets[rows]

    def _see(
        self, problems: NDArray[np.integer], agents: NDArray[np.integer], out: NDArray[np.float32]
    ) -> None:
        """Writes what K agents see."""
        engine, fast = self.engine, self.fast
        if fast.observation:
            see_paper(engine.static, engine.dynamic, fast.via_capacity, problems, agents, out)
        else:
            if self._clears:
                out[...] = 0
            write_rows(self.observation, engine, problems, agents, out)

    def _look(self, which: NDArray[np.bool_] | None) -> None:
        """Writes what agents see now, in all problems or where ``which`` (M,) is true."""
        b, engine = self.buffers, self.engine
        problems, agents = engine.pairs(self.everyone)[0], b.agents.reshape(-1)
        obs = b.obs.reshape(-1, *b.obs.shape[2:])
        if which is None or which.all():
            self._see(problems, agents, obs)
            return
        rows = np.repeat(which, b.agents.shape[1])
        out = np.empty((int(rows.sum()), *obs.shape[1:]), np.float32)
        self._see(problems[rows], agents[rows], out)
        obs[rows] = out


def _picked(order: NDArray[np.int64], moves: NDArray[np.integer]) -> NDArray[np.int16]:
    """(M, K) the entries of orders (M, K, A) at moves (M, K); no move stays none."""
    found = np.take_along_axis(order, np.maximum(moves, 0)[..., None].astype(np.int64), -1)
    return np.where(moves == NOBODY, NOBODY, found[..., 0]).astype(np.int16)


@inlined
def _ends(
    static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int, row: int
) -> Any:
    """Whether a row gets a final observation: a task has ended, or the turn passes to others."""
    if b.ending[m, row] != Ending.NONE:
        return True
    turns = not (fast.everyone or static.sequential) and dynamic.games[m].active > 1
    return turns and b.acted[m, row]


@compiled
def _list_arrived(
    static: Static,
    dynamic: Dynamic,
    b: StepBuffers,
    fast: FastPath,
    asked: Any,
    problems: Any,
    agents: Any,
    rows: Any,
) -> int:
    """Lists the agents that get a final observation; returns how many they are."""
    count = 0
    for m in range(len(asked)):
        for row in range(b.agents.shape[1]):
            if _ends(static, dynamic, b, fast, m, row):
                problems[count] = m
                agents[count] = row if fast.everyone else asked[m]
                rows[count] = m * b.agents.shape[1] + row
                count += 1
    return count


@compiled
def _move_next(
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
def _settle_movers(
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
        for option in range(Option.VISITED, Option.TRIED + 1):
            if static.options[option] >= 0 and option != Option.KEPT:
                row = as_index(static.options[option] + n)
                copy_row(arrived.sets, m, row, dynamic.sets, m, row)
        settle_agent(static, dynamic, m, n)
        before.remaining[m, edge] = dynamic.remaining[m, edge]
        before.agents[m, n] = dynamic.agents[m, n]
        before.games[m] = dynamic.games[m]


# --- what a step writes ---------------------------------------------------------------------------

_MASKS = MASKS.view(np.int16)
"""(64, 3) int16, :data:`marouting.batch.state.MASKS` in pairs of bytes."""


@inlined
def _free(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The moves of an agent that cross an edge, one bit per move; none for NOBODY."""
    free = i64(0)
    if n != NOBODY:
        free = free_moves(static, dynamic, m, as_index(n))
    return free


@inlined
def _write_mask(static: Static, mask: Any, m: int, row: int, free: int) -> None:
    """Writes a mask, in bytes or in pairs of bytes."""
    if mask.shape[2] >= MOVES:
        write_moves(static, free, mask[m], row)
        return
    for pair in range(_MASKS.shape[1]):
        mask[m, row, pair] = _MASKS[free, pair]


@inlined
def _look(
    static: Static, dynamic: Dynamic, fast: FastPath, m: int, n: int, obs: Any, mask: Any, row: int
) -> None:
    """Writes what an agent sees; zeros and a mask of ones for NOBODY."""
    free = _free(static, dynamic, m, n)
    write_paper(static, dynamic, fast.via_capacity, m, n, obs[m], row)
    _write_mask(static, mask, m, row, free)


@inlined
def _make_moves(static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int) -> None:
    """The moves of a step of one problem, before anybody settles."""
    if fast.shares is not None:
        move_and_pay(static, dynamic, fast, m, b.actions, b.reward)
    elif fast.everyone:
        move_everyone(static, dynamic, m, b.actions)
    else:
        move_player(static, dynamic, m, i64(b.actions[m, 0]))


@inlined
def _take_stock(dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int, n: int, row: int) -> Any:
    """Writes the result of an agent's move; returns the reward."""
    agent = dynamic.agents[m, n]
    b.acted[m, row] = agent.crossing != Crossing.NONE
    b.ending[m, row] = agent.ending
    if fast.shares is None:
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
def _finish(b: StepBuffers, m: int, playing: bool, game: Any) -> None:
    """After a step: records whether the episode has ended with it, and how."""
    b.over[m] = playing and game.active == 0
    if b.over[m]:
        b.final[m].overflow = game.overflow
        b.final[m].wirelength = game.wirelength
        b.final[m].joined = game.joined
        b.final[m].steps = game.steps


# --- with any observation, the parts of a step ----------------------------------------------------


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
            b.total[m] += _take_stock(dynamic, b, fast, m, as_index(n), row)


@compiled
def _move_and_pay(
    static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, begins: Any
) -> None:
    """:func:`move_game` in all problems whose episode does not begin."""
    for m in range(len(begins)):
        if not begins[m]:
            move_game(static, dynamic, b, fast, m)


NOT, _TURNS, ALL = 0, 1, 2
"""What is to be settled at the end of a step: nothing, whose turn it is, or all that agents do."""


@inlined
def settle_game(
    static: Static,
    dynamic: Dynamic,
    b: StepBuffers,
    fast: FastPath,
    m: int,
    asked: int,
    what: int,
) -> None:
    """The end of a step of one problem, whose turn was that of ``asked``."""
    game = dynamic.games[m]
    if what != NOT:
        if fast.everyone:
            if what == ALL:
                for n in range(b.agents.shape[1]):
                    settle_agent(static, dynamic, m, n)
            settle_turns(static, dynamic, m)
        elif asked != NOBODY:
            if what == ALL:
                settle_agent(static, dynamic, m, as_index(asked))
            pass_turn(static, dynamic, m)
        acted = False
        for row in range(b.agents.shape[1]):
            acted |= b.acted[m, row]
        _finish(b, m, acted, game)
    if not fast.everyone:
        b.agents[m, 0] = game.agent
    for row in range(b.agents.shape[1]):
        n = i64(row) if fast.everyone else i64(asked)
        if n != NOBODY:  # once a game is over, these stay as its last move left them
            status = dynamic.agents[m, as_index(n)].status
            b.terminated[m, row] = status == Status.TERMINATED
            b.truncated[m, row] = status == Status.TRUNCATED
        n = i64(b.agents[m, row])
        b.active[m, row] = n != NOBODY and dynamic.agents[m, as_index(n)].status == Status.ACTIVE


@inlined
def write_mask(static: Static, dynamic: Dynamic, mask: Any, m: int, n: int, row: int) -> None:
    """Writes the moves of an agent that cross an edge; ones for NOBODY."""
    _write_mask(static, mask, m, row, _free(static, dynamic, m, n))


@compiled
def _settle_and_show(
    static: Static,
    dynamic: Dynamic,
    b: StepBuffers,
    fast: FastPath,
    begins: Any,
    asked: Any,
    what: int,
) -> None:
    """:func:`settle_game` in all problems, and the masks."""
    for m in range(len(begins)):
        settle_game(
            static, dynamic, b, fast, m, i64(asked[m]), i64(NOT) if begins[m] else i64(what)
        )
        for row in range(b.agents.shape[1]):
            write_mask(static, dynamic, b.mask, m, i64(b.agents[m, row]), i64(row))


# --- the paper's observation and a built-in reward ------------------------------------------------


@inlined
def step_problem(static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, m: int) -> None:
    """A whole step of one problem."""
    asked = i64(dynamic.games[m].agent)
    move_game(static, dynamic, b, fast, m)
    for row in range(b.agents.shape[1]):
        if _ends(static, dynamic, b, fast, m, row):
            n = i64(row) if fast.everyone else asked
            _look(static, dynamic, fast, m, n, b.final_obs, b.final_mask, i64(row))
    settle_game(static, dynamic, b, fast, m, asked, i64(ALL))
    for row in range(b.agents.shape[1]):
        _look(static, dynamic, fast, m, i64(b.agents[m, row]), b.obs, b.mask, i64(row))


@compiled
def _play(
    static: Static, dynamic: Dynamic, b: StepBuffers, fast: FastPath, steps: bool, restarts: bool
) -> None:
    """Steps and restarts of all problems."""
    for m in range(len(b.over)):
        if restarts and b.over[m]:
            clear_problem(static, dynamic, m, i64(0), i64(1))
            start_game(static, dynamic, b, m)
            settle_game(static, dynamic, b, fast, m, i64(NOBODY), i64(NOT))
            for row in range(b.agents.shape[1]):
                _look(static, dynamic, fast, m, i64(b.agents[m, row]), b.obs, b.mask, i64(row))
        elif steps:
            step_problem(static, dynamic, b, fast, m)
