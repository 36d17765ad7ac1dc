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

from marouting.decomposition import Decomposition
from marouting.engine import (
    GAME,
    NOBODY,
    Engine,
    NetOrder,
    Overflow,
    Play,
    Status,
    TurnOrder,
    World,
    move_everyone,
    reset_problem,
    settle_everyone,
    write_mask,
)
from marouting.errors import InputError
from marouting.grid import MOVES
from marouting.kernels import bound, compiled
from marouting.observation import Observation, PaperObservation, state, state_space, writer
from marouting.problem import Problem
from marouting.reward import PaperReward, Reward, payer

# Plain numbers compare many times quicker than members of an IntEnum.
_ACTIVE, _TERMINATED, _TRUNCATED = map(int, (Status.ACTIVE, Status.TERMINATED, Status.TRUNCATED))

_FIGURES = ("overflow", "wirelength", "joined", "steps")

Info = dict[str, Any]


class Arrays(NamedTuple):
    """What goes into a step of M problems of N agents, and what comes out of it."""

    moves: NDArray[np.int8]  # (M, N)
    observation: NDArray[np.float32]  # (M, N, F)
    reward: NDArray[np.float32]  # (M, N)
    mask: NDArray[np.int8]  # (M, N, 6)
    status: NDArray[np.int8]  # (M, N) Status
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
            mask=np.zeros((*shape, MOVES), np.int8),
            status=np.zeros(shape, np.int8),
            terminated=np.zeros(shape, np.bool_),
            truncated=np.zeros(shape, np.bool_),
            active=np.zeros(shape, np.bool_),
            over=np.zeros(problems, np.bool_),
            final=np.zeros(problems, GAME),
        )


class Board:
    """An engine that is played through arrays.

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
        self._before = engine.world, engine.play, arrays.moves
        self._after = arrays.mask.reshape(-1, MOVES), arrays.status, arrays.over, arrays.final
        self._move = bound(_step, *self._before, True, *self._after)
        self._pay = payer(reward, engine)
        self._write = writer(observation, engine)
        problems, agents = engine.pairs(everyone=True)
        shape = arrays.moves.shape
        self._everyone = problems.reshape(shape)[:, 0].copy(), agents.reshape(shape)

    def reset(self) -> None:
        """Starts the episodes of all problems."""
        self.arrays.over[:] = True
        self.step(restart=True)

    def step(self, restart: bool) -> None:
        """Moves all agents by ``arrays.moves`` and fills the other arrays.

        Args:
            restart: whether a problem whose episode is over starts its next one instead.
        """
        a = self.arrays
        self._move(*self._before, restart, *self._after)
        np.equal(a.status, _TERMINATED, out=a.terminated)
        np.equal(a.status, _TRUNCATED, out=a.truncated)
        np.equal(a.status, _ACTIVE, out=a.active)
        self._pay(*self._everyone, a.reward.reshape(-1))
        self._write(*self._everyone, a.observation.reshape(a.moves.size, -1))


@compiled
def _step(
    world: World,
    play: Play,
    moves: Any,
    restart: bool,
    mask: Any,
    status: Any,
    over: Any,
    final: Any,
) -> None:
    for m in range(len(over)):
        game = play.games[m]
        if restart and over[m]:
            reset_problem(world, play, m)
            over[m] = False
        else:
            playing = game.active > 0
            move_everyone(world, play, m, moves)
            settle_everyone(world, play, m)
            over[m] = playing and game.active == 0
        if over[m]:
            final[m].overflow = game.overflow
            final[m].wirelength = game.wirelength
            final[m].joined = game.joined
            final[m].steps = game.steps
        agents = status.shape[1]
        for n in range(agents):
            status[m, n] = play.agents[m, n].status
            present = n if status[m, n] != Status.ABSENT else NOBODY
            write_mask(world, play, m, present, mask, m * agents + n)


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
        """(M, X, Y, 5 Z) float32, the global grids; see :func:`marouting.observation.state`."""
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
