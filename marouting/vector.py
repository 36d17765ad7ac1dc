"""Many problems at once, in arrays: the engine's own form, for learners that want it all.

For Gymnasium's ways with one player a problem there is ``gymnasium.make_vec``; here every net of
every problem moves in every step.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.game.engine import (
    GAME,
    MASKS,
    NOBODY,
    Dynamic,
    Engine,
    NetOrder,
    Overflow,
    Static,
    Status,
    TurnOrder,
    Write,
    free_moves,
    move_everyone,
    reset_problem,
    settle_agent,
    settle_turns,
)
from marouting.game.observation import (
    Observation,
    PaperObservation,
    state,
    state_space,
    write_paper,
    writer,
)
from marouting.game.reward import PaperReward, Reward, paper_reward, payer
from marouting.kernels import bound, compiled
from marouting.problem.grid import MOVES
from marouting.problem.problem import Problem
from marouting.trees.decomposition import Decomposition

_FIGURES = ("overflow", "wirelength", "joined", "steps")

Info = dict[str, Any]


class Arrays(NamedTuple):
    """What goes into a step of M problems of N agents, and what comes out of it."""

    moves: NDArray[np.int8]  # (M, N)
    observation: NDArray[np.float32]  # (M, N, F)
    reward: NDArray[np.float32]  # (M, N)
    mask: NDArray[np.int8]  # (M, N, 6)
    terminated: NDArray[np.bool_]  # (M, N)
    truncated: NDArray[np.bool_]  # (M, N)
    active: NDArray[np.bool_]  # (M, N) agents that can move next
    over: NDArray[np.bool_]  # (M,) episodes that ended with the step
    final: NDArray[Any]  # (M,) GAME as it was when the problem's last episode ended

    @classmethod
    def of(cls, problems: int, agents: int, features: int) -> "Arrays":
        """Arrays of that many."""
        shape = problems, agents
        return cls(
            moves=np.full(shape, NOBODY, np.int8),
            observation=np.zeros((*shape, features), np.float32),
            reward=np.zeros(shape, np.float32),
            mask=np.ones((*shape, MOVES), np.int8),
            terminated=np.zeros(shape, np.bool_),
            truncated=np.zeros(shape, np.bool_),
            active=np.zeros(shape, np.bool_),
            over=np.zeros(problems, np.bool_),
            final=np.zeros(problems, GAME),
        )


class Board:
    """An engine that is played through arrays.

    The paper's observation and reward are written as the agents move, problem by problem; others
    are asked for theirs afterwards.

    Args:
        engine: the game.
        observation: what an agent sees.
        reward: what an agent gets.
        arrays: of the engine's size.
    """

    def __init__(
        self, engine: Engine, observation: Observation, reward: Reward, arrays: Arrays
    ) -> None:
        self.engine, self.arrays = engine, arrays
        self._before = engine.static, engine.dynamic
        looks = observation if type(observation) is PaperObservation else None
        pays = reward if type(reward) is PaperReward else None
        plain = pays or PaperReward()
        self._after = (
            arrays._replace(mask=arrays.mask.view(np.int16)),
            plain.table,
            plain.overflow_price,
            (looks or PaperObservation()).via_capacity,
            pays is not None,
            looks is not None,
        )
        self._move = bound(_step, *self._before, True, *self._after)
        problems, agents = engine.pairs(everyone=True)
        shape = arrays.moves.shape
        self._everyone = problems.reshape(shape)[:, 0].copy(), agents.reshape(shape)
        self._others: list[tuple[Write, NDArray[np.float32]]] = []
        if pays is None:
            self._others.append((payer(reward, engine), arrays.reward.reshape(-1)))
        if looks is None:
            rows = arrays.observation.reshape(arrays.moves.size, -1)
            self._others.append((writer(observation, engine), rows))

    def reset(self) -> None:
        """Starts the episodes of all problems."""
        self.arrays.over[:] = True
        self.step(restart=True)

    def step(self, restart: bool) -> None:
        """Moves all agents by ``arrays.moves`` and fills the other arrays.

        Args:
            restart: whether a problem whose episode is over starts its next one instead.
        """
        self._move(*self._before, restart, *self._after)
        for write, out in self._others:
            write(*self._everyone, out)


_MASKS = MASKS.view(np.int16)
"""(64, 3) :data:`marouting.game.engine.MASKS` in pairs of bytes: that is quicker."""


@compiled
def _step(
    static: Static,
    dynamic: Dynamic,
    restart: bool,
    arrays: Arrays,
    prices: Any,
    overflow_price: float,
    via_capacity: float,
    pays: bool,
    looks: bool,
) -> None:
    """A step of all problems, or the start of an episode.

    Args:
        static: the game.
        dynamic: how it stands.
        restart: whether a problem whose episode is over starts its next one instead.
        arrays: what is filled; the mask in pairs of bytes, (M, N, 3) int16.
        prices: of the paper's reward, see :attr:`marouting.game.reward.PaperReward.table`.
        overflow_price: likewise.
        via_capacity: of the paper's observation.
        pays: whether the reward is the paper's.
        looks: whether the observation is.
    """
    agents = arrays.moves.shape[1]
    for m in range(len(arrays.over)):
        game = dynamic.games[m]
        begins = restart and arrays.over[m]
        playing = game.active > 0
        if begins:
            reset_problem(static, dynamic, m)
        else:
            move_everyone(static, dynamic, m, arrays.moves)
        for n in range(agents):
            # In one loop, and of one agent after the other: all of it is at hand then.
            if not begins:
                settle_agent(static, dynamic, m, n)
            agent = dynamic.agents[m, n]
            arrays.terminated[m, n] = agent.status == Status.TERMINATED
            arrays.truncated[m, n] = agent.status == Status.TRUNCATED
            arrays.active[m, n] = agent.status == Status.ACTIVE
            if agent.status == Status.ABSENT:
                continue
            free = free_moves(static, dynamic, m, n)
            if pays:
                arrays.reward[m, n] = paper_reward(prices, overflow_price, agent)
            if looks:
                write_paper(static, dynamic, via_capacity, m, n, arrays.observation[m], n)
            for pair in range(_MASKS.shape[1]):
                arrays.mask[m, n, pair] = _MASKS[free, pair]
        if not begins:
            settle_turns(static, dynamic, m)
        arrays.over[m] = not begins and playing and game.active == 0
        if arrays.over[m]:
            arrays.final[m].overflow = game.overflow
            arrays.final[m].wirelength = game.wirelength
            arrays.final[m].joined = game.joined
            arrays.final[m].steps = game.steps


class BatchEnv(EzPickle):
    """M problems of one grid shape, played side by side, all nets moving in every step.

    The rows of problems with fewer agents than the largest are filled up; ``present`` tells which
    agents there are. The arrays that :meth:`reset`, :meth:`step` and :meth:`state` return are the
    environment's own and are written over by the next call: copy what has to last.

    A problem whose episode is over starts its next one with the step after, in the manner of
    Gymnasium's ``AutoresetMode.NEXT_STEP``: that step ignores the problem's actions, its rewards
    are 0, and its observations are those of the new episode.

    Args:
        problems: the problems, all with the same grid shape.
        turn_order: ``round_robin``, or ``sequential``: the agents whose turn it is not wait.
        net_order: see :class:`marouting.Engine`.
        max_steps: see :class:`marouting.Engine`.
        overflow: see :class:`marouting.Engine`.
        decomposition: see :class:`marouting.Engine`.
        observation: what an agent sees; None: the paper's.
        reward: what an agent gets; None: the paper's.
        autoreset: whether an episode that is over is followed by the next.
        threads: among which the problems are divided; the results do not depend on it. Each asks
            ``observation`` and ``reward`` about its own problems, all at the same time.

    Attributes:
        num_problems: M.
        num_agents: N, agents of the largest problem.
        present: (M, N) bool, where there is an agent.
        single_observation_space: the space of one agent's observation, of F numbers.
        single_state_space: the space of one problem's global state, (X, Y, 5 Z).
        engine: the engine, to be read.

    Raises:
        InputError: the problems do not go together, or an option is out of its range.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        *,
        turn_order: TurnOrder = "round_robin",
        net_order: NetOrder = "half_perimeter",
        max_steps: int | None = None,
        overflow: Overflow = "forbidden",
        decomposition: Decomposition = "mst",
        observation: Observation | None = None,
        reward: Reward | None = None,
        autoreset: bool = True,
        threads: int = 1,
    ) -> None:
        EzPickle.__init__(
            self,
            problems,
            turn_order=turn_order,
            net_order=net_order,
            max_steps=max_steps,
            overflow=overflow,
            decomposition=decomposition,
            observation=observation,
            reward=reward,
            autoreset=autoreset,
            threads=threads,
        )
        if threads < 1:
            raise InputError(f"threads: expected at least 1, found {threads}")
        self.engine = engine = Engine(
            problems,
            turn_order=turn_order,
            net_order=net_order,
            max_steps=max_steps,
            overflow=overflow,
            decomposition=decomposition,
        )
        self.autoreset = autoreset
        observation, reward = observation or PaperObservation(), reward or PaperReward()
        self.single_observation_space = observation.space(engine.problems, overflow == "allowed")
        self.single_state_space = state_space(engine.problems, overflow == "allowed")
        self.num_problems, self.num_agents = engine.nets.shape
        self.present = engine.tasks > 0
        (features,) = self.single_observation_space.shape
        self._arrays = Arrays.of(self.num_problems, self.num_agents, features)
        self._state = np.empty((self.num_problems, *self.single_state_space.shape), np.float32)

        threads = min(threads, self.num_problems)
        cuts = [self.num_problems * thread // threads for thread in range(threads + 1)]
        self._boards = [
            Board(
                engine.part(part),
                observation,
                reward,
                Arrays._make(array[part] for array in self._arrays),
            )
            for part in map(slice, cuts, cuts[1:])
        ]
        self._threads = ThreadPoolExecutor(threads)  # starts them as they are needed

    def reset(self) -> tuple[NDArray[np.float32], Info]:
        """Starts the episodes of all problems.

        Returns:
            (M, N, F) float32 observations, and the info as of :meth:`step`.
        """
        self._arrays.over[:] = True
        self._step(restart=True)
        return self._arrays.observation, self._info()

    def step(
        self, actions: NDArray[np.integer]
    ) -> tuple[
        NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], Info
    ]:
        """Moves all agents, of each problem in turn order.

        Args:
            actions: (M, N) integers, 0 to 5, or −1 for no move. Those of agents that are done or
                absent do not matter.

        Returns:
            * (M, N, F) float32 observations,
            * (M, N) float32 rewards, 0 for agents that did not move,
            * (M, N) bool terminated: the agent's tasks are all joined,
            * (M, N) bool truncated: the agent's tasks have all ended and some failed,
            * an info with ``action_mask`` (M, N, 6) int8; ``active`` (M, N) bool, agents that can
              move next; ``over`` (M,) bool, episodes that ended with this step; ``overflow``,
              ``wirelength``, ``joined`` and ``steps`` (M,) integers, the metrics of the episodes as
              they stand; and ``final_info``, a dictionary of the same four as they were when the
              problem's last episode ended: 0 until one has, and kept until the next does.

            ``terminated`` and ``truncated`` stay true until the problem's next episode starts.

        Raises:
            ValueError: an array of another shape, or an action out of its range.
        """
        a, actions = self._arrays, np.asarray(actions)
        if actions.shape != a.moves.shape:
            raise ValueError(f"actions: expected shape {a.moves.shape}, found {actions.shape}")
        self.engine.check(actions)
        a.moves[:] = actions
        self._step(restart=self.autoreset)
        return a.observation, a.reward, a.terminated, a.truncated, self._info()

    def state(self) -> NDArray[np.float32]:
        """(M, X, Y, 5 Z) float32, the global grids; see :func:`state`."""
        return state(self.engine, self._state)

    def _step(self, restart: bool) -> None:
        """A step of all boards, a thread each."""
        first, *others = self._boards
        running = [self._threads.submit(board.step, restart) for board in others]
        first.step(restart)
        for other in running:
            other.result()

    def _info(self) -> Info:
        a, games = self._arrays, self.engine.games
        return {
            "action_mask": a.mask,
            "active": a.active,
            "over": a.over,
            **{figure: games[figure] for figure in _FIGURES},
            "final_info": {figure: a.final[figure] for figure in _FIGURES},
        }
