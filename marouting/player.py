"""The array player: plays M problems at once for the batch environment and for trainings.

With the paper's observation and a built-in reward, a whole step is one compiled call. With another
observation, the moves of a step are one compiled call, and the observation is called at most twice:
for the final observations of tasks and turns that end, and then for all rows. With a reward of your
own, moves are made one by one, and the reward is called after each of them.
"""

import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.observation import see_paper
from marouting.batch.state import Dynamic, Option
from marouting.batch.step import (
    SETTLE_ALL,
    SETTLE_NOTHING,
    SETTLE_TURNS,
    Earlier,
    FastPath,
    StepBuffers,
    list_arrived,
    move_games,
    move_next,
    play,
    settle_games,
    settle_movers,
)
from marouting.config import check
from marouting.game import (
    ACTIVE,
    ANSWERED,
    GOES_ON,
    NOBODY,
    Crossing,
)
from marouting.kernels import specialised
from marouting.observations import (
    Observation,
    has_form,
    has_move_order,
    move_order_of,
    space_of,
    write_rows,
)
from marouting.options import FORMS
from marouting.problem.grid import MOVES
from marouting.registry import is_ours
from marouting.rewards import Reward, paid_by
from marouting.source import ProblemSampler

_STAYED = Crossing.NONE.value


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
        reorder_moves: whether actions and masks are in the observation's own order of moves, as for
            learners (:func:`marouting.observations.move_order_of`).

    Attributes:
        played: (M, K) the moves on the grid of the last step.
        fast: what the compiled step knows about the components.
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
        reorder_moves: bool = False,
    ) -> None:
        for name, component in (("observation", observation), ("reward", reward)):
            columns, plain = FORMS[name][:2]
            what = f"a method {columns}, which all but AEC, Parallel and gymnasium.make need"
            cls, fits = type(component).__name__, has_form(component, columns, plain)
            found = f"found none in {cls}"
            if hasattr(component, columns) and not fits:
                found = f"found an inherited one in {cls}, beside its own {plain}"
            check(name, fits, f"{what}, {found}")
        self.engine, self.observation, self.reward = engine, observation, reward
        self.reorders_moves = reorder_moves and has_move_order(observation)
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
        return self.fast.sees_paper and self.fast.pays_prices and self.engine.actions == MOVES

    def _bind(self) -> None:
        """Prepares the calls after the arrays have been replaced."""
        engine, buffers = self.engine, self.buffers
        self.played = buffers.actions
        if self.everyone:
            buffers.agents[:] = engine.pairs(everyone=True)[1].reshape(engine.nets.shape)
        own_reward = not self.fast.pays_prices
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
            self._update_figures_before()
        if self.compiled:
            self._step = specialised(play, *self._arguments, True, True)
            return
        begins, on_turn = np.zeros(len(buffers.over), np.bool_), engine.games["agent"].copy()
        self._settle = specialised(settle_games, *self._arguments, begins, on_turn, SETTLE_NOTHING)
        # Problems, agents and rows of those that have arrived.
        self._places = tuple(np.zeros(buffers.agents.size, np.int32) for _ in range(3))
        self._list_arrived = specialised(list_arrived, *self._arguments, on_turn, *self._places)
        if not own_reward:
            self._move = specialised(move_games, *self._arguments, begins)

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
        on_turn = np.full(len(over), NOBODY, np.int32)
        self._settle(*self._arguments, which, on_turn, SETTLE_NOTHING)
        self._look(which)
        self._reorder_masks()

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
        elif self.reorders_moves:
            chosen = self.buffers.actions.copy()
            self.played = _picked(self._order(), chosen)
            self.buffers.actions[:] = self.played
            self._step_in_parts(restart)
            self.buffers.actions[:] = chosen  # learners remember what they chose
            self._reorder_masks()
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
        self._update_before(slice(None))

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
        if not self.reorders_moves:
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

    def _reorder_masks(self) -> None:
        """Puts masks that have just been written for all rows in the order of the observation."""
        if self.reorders_moves:
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

    # --- any components ---------------------------------------------------------------------------

    def _update_before(self, which: Any) -> None:
        """Copies the games of some problems to ``before``, which rewards are given."""
        if self._before is not None:
            self._before.agents[which] = self.engine.agents[which]
            self._before.remaining[which] = self.engine.remaining[which]
            self._update_figures_before()

    def _update_figures_before(self) -> None:
        """Copies the records of all games to ``before``."""
        if self._before is not None:
            self._before.games[...] = self.engine.games
            # Edges that nets have just released are paid for with the next move.
            games = self._before.games
            ripped = np.flatnonzero(games["just_ripped"])
            for name in ("joined", "overflow", "wirelength"):
                games[name][ripped] = games[f"kept_{name}"][ripped]

    def _start(self, which: NDArray[np.bool_]) -> None:
        """Starts episodes, in which nobody has acted yet."""
        b = self.buffers
        self._draw(which)
        self.engine.reset(which)
        self._update_before(which)
        b.acted[which] = b.over[which] = b.terminated[which] = b.truncated[which] = False
        b.reward[which] = b.total[which] = b.ending[which] = 0

    def _step_in_parts(self, restart: bool) -> None:
        b, engine = self.buffers, self.engine
        begins = b.over & restart
        on_turn = engine.games["agent"].copy()
        if begins.any():
            self._start(begins)
        if self._before is None:
            self._move(*self._arguments, begins)
            self._look_back(on_turn)
            self._settle(*self._arguments, begins, on_turn, SETTLE_ALL)
        else:
            self._move_by_turns(self._before, begins, on_turn)
            self._look_back(on_turn)
            self._settle(*self._arguments, begins, on_turn, SETTLE_TURNS)
            if engine.static.options[Option.ROUNDS]:
                self._update_before((engine.games["just_ripped"] | engine.games["asked"]) != 0)
            else:
                self._update_figures_before()
        self._look(None)

    def _move_by_turns(
        self, before: Earlier, begins: NDArray[np.bool_], on_turn: NDArray[np.int32]
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
            if not move_next(*known, self.everyone, k, b.actions, begins, alone, movers, moves):
                continue
            paid += paid_by(self.reward, engine, before, movers)
            settle_movers(*known, before, movers, moves, self._arrived)
            if engine.static.extended:
                # More may have changed than one edge of one net.
                mover = engine.agents[np.arange(len(movers)), movers]
                changed = (mover["crossing"] == ANSWERED) | (mover["ending"] != GOES_ON)
                self._update_before(changed & (movers != NOBODY))
        if self.everyone:
            b.reward[:] = paid
            taken: Any = ...
        else:
            b.reward[:, 0] = paid.sum(axis=1)
            taken = np.arange(len(on_turn)), on_turn
        agents = engine.agents[taken].reshape(b.acted.shape)
        idle = begins if self.everyone else begins | (on_turn == NOBODY)
        b.acted[:] = (agents["crossing"] != _STAYED) & ~idle[:, None]
        b.ending[:] = np.where(b.acted, agents["ending"], GOES_ON)
        b.total[:] += b.reward.sum(axis=1, dtype=np.float64)

    def _look_back(self, on_turn: NDArray[np.int32]) -> None:
        """Writes what agents saw where they arrived, whose tasks ended or who pass the turn."""
        b, engine = self.buffers, self.engine
        count = self._list_arrived(*self._arguments, on_turn, *self._places)
        if not count:
            return
        problems, agents, rows = (array[:count] for array in self._places)
        if self._before is not None:
            # Those whose tasks have ended stand elsewhere by now, or are done. Observations see how
            # many agents are active: as many as before these were settled.
            active = engine.games["active"].copy()
            settled = engine.agents["status"][problems, agents]
            np.add.at(engine.games["active"], problems, settled != ACTIVE)
            self._swap_arrived(problems, agents)
        out = np.empty((count, *b.obs.shape[2:]), np.float32)
        self._see(problems, agents, out)
        b.final_obs.reshape(-1, *b.obs.shape[2:])[rows] = out
        masks = engine.masks(problems, agents)
        if self.reorders_moves:
            masks = np.take_along_axis(masks, self._order_of(out), -1)
        b.final_mask.reshape(-1, engine.actions)[rows] = masks
        if self._before is not None:
            self._swap_arrived(problems, agents)
            engine.games["active"] = active

    def _swap_arrived(self, problems: NDArray[Any], agents: NDArray[Any]) -> None:
        """Swaps what changes for agents (K,) when their next tasks begin, as far as it is seen."""
        now, arrived, at = self.engine.dynamic, self._arrived, (problems, agents)
        now.agents[at], arrived.agents[at] = arrived.agents[at], now.agents[at]
        for option in (Option.VISITED, Option.BEGUN):
            if (begin := self.engine.static.options[option]) >= 0:
                rows = problems, begin + agents
                now.sets[rows], arrived.sets[rows] = arrived.sets[rows], now.sets[rows]

    def _see(
        self, problems: NDArray[np.integer], agents: NDArray[np.integer], out: NDArray[np.float32]
    ) -> None:
        """Writes what K agents see."""
        engine, fast = self.engine, self.fast
        if fast.sees_paper:
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
