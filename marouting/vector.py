"""Many problems at once, in arrays, for learners.

In a step all nets of every problem move, or only the one whose turn it is. ``gymnasium.make_vec``
(:mod:`marouting.gym_vector`) has the second of these in the interface of Gymnasium's vectors.
"""

import os
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.step import StepBuffers
from marouting.config import build, check
from marouting.errors import InputError
from marouting.observations import Observation, space_of, state_of, state_space_of
from marouting.options import GameOptions, game_options
from marouting.player import Player
from marouting.problem.net import is_whole
from marouting.problem.problem import Problem
from marouting.rules import Mask
from marouting.scenarios import get
from marouting.source import OTHER_GAME, ProblemSampler, ProblemStream, Source, checked_seed

FIGURES = ("overflow", "wirelength", "joined", "steps")

Info = dict[str, Any]


class SavedBatch(NamedTuple):
    """A saved state of a :class:`BatchEnv`."""

    identity: tuple[Any, ...]  # equal for games with the same problems and options
    games: list[Any]  # of the processor's games a Saved each, of a device's their arrays


_ON_CUDA = "marouting.cuda.env:CudaBatchEnv"
"""By name, because that class derives from :class:`BatchEnv`."""


class BatchEnv(EzPickle):
    """M problems of one grid shape, played side by side.

    Each problem has K rows, one for each of its N agents. With ``everyone=False`` it has one row
    (K = 1), for the agent whose turn it is; the reward is then the sum of what a move pays all
    agents. Problems with fewer agents than the largest one are padded; ``present`` tells which
    agents exist. The arrays that :meth:`reset`, :meth:`step` and :meth:`state` return belong to the
    environment and are overwritten by the next call, so copy what you want to keep.

    Rows of finished agents remain and still receive rewards until the episode ends. With
    ``agents_persist`` they are terminated or truncated only then, all together, and their masks
    allow a single action, which has no effect.

    A problem whose episode is over starts its next one in the following step, like Gymnasium's
    ``AutoresetMode.NEXT_STEP``: that step ignores the problem's actions, its rewards are 0, and its
    observations are those of the new episode.

    Problems are fixed, or every episode draws a new one::

        BatchEnv(marouting.generate(8))                           # 8 fixed problems
        BatchEnv(scenario="toy-4x4-v0", split="validation")       # all problems of a split
        BatchEnv(8, scenario="toy-4x4-v0")                        # drawn from the training split
        BatchEnv(8, problem={"nets": 10, "seed": None})           # drawn by the generator
        BatchEnv(8, problem="folder")                             # drawn from a set

    Args:
        problems: fixed problems, all with the same grid shape. Or a number M of games, each of
            which draws a problem for every episode, from ``problem`` or the scenario. None: all
            problems of a scenario's split ``validation`` or ``test``, fixed.
        problem: what M games draw their problems from: one problem, several problems of which
            every episode draws one, or a generator with ``seed=None``, which makes a new one for
            every episode; see :data:`marouting.source.Source`.
        everyone: whether all agents have a row. In round-robin order each of them moves in every
            step, in sequential order only the one whose turn it is; ``acted`` in the info tells.
        autoreset: whether the next episode starts when one is over.
        play_once: whether each of a list of problems, or of the problems of a split, is played only
            once after :meth:`reset`. Its rows then stay inactive, so that a loop ``while
            info["active"].any()`` ends. Not for games that draw their problems.
        threads: number of threads among which the problems are divided; the results do not depend
            on it. Several threads may call your own observation or reward at the same time, each
            for its own problems.
        seed: a whole number from 0 that decides which problems are drawn. What a game plays in an
            episode depends on the seed, on the game's place and on the number of the episode alone.
        device: ``cpu``, or ``cuda`` for a CUDA device (:mod:`marouting.cuda.env`), which
            takes another option, ``pool``.
        **options: the fields of :class:`marouting.options.GameOptions` about the rules, the
            observation, the reward and the scenario; unless given, ``turn_order`` is
            ``round_robin`` for all agents and ``sequential`` for one row.

    Attributes:
        num_problems: M.
        num_envs: M, under the name that Gymnasium's vectors have for it.
        num_agents: N, the number of agents of the largest problem.
        single_observation_space: the space of one agent's observation, of shape S.
        single_action_space: the space of one agent's actions.
        single_state_space: the space of one problem's global state; see :meth:`state`.
        engine: the engine; read it, but do not change it.

    Raises:
        InputError: the problems do not fit together, or an option is out of range.
    """

    _draws_of: ClassVar[type[ProblemSampler]] = ProblemSampler
    _identity: tuple[Any, ...]

    def __new__(cls, *problems: Any, **options: Any) -> "BatchEnv":
        """Makes a :class:`marouting.cuda.env.CudaBatchEnv` for another device."""
        other = cls is BatchEnv and options.get("device", "cpu") != "cpu"
        made: BatchEnv = super().__new__(pkgutil.resolve_name(_ON_CUDA) if other else cls)
        EzPickle.__init__(made, *problems, **options)  # for copies
        return made

    def __init__(
        self,
        problems: Sequence[Problem] | int | None = None,
        *,
        problem: Source = None,
        everyone: bool = True,
        autoreset: bool = True,
        play_once: bool = False,
        threads: int = 1,
        seed: int = 0,
        device: str = "cpu",
        **options: Any,
    ) -> None:
        kind = type(self).__name__
        check("device", device == "cpu", f"cpu for the class {kind}, found {device!r}")
        if not (is_whole(threads) and threads >= 1):
            raise InputError(f"threads: expected a whole number from 1, found {threads!r}")
        checked_seed(seed)
        checked = batch_options(options, everyone, autoreset, play_once)
        what = "false with everyone=False, because only one agent has a row"
        check("agents_persist", everyone or not checked.agents_persist, what)
        self._persists = checked.agents_persist
        once = not play_once or not is_whole(problems)
        check("play_once", once, "false: these games draw their problems")
        episodes = drawn_from(problems, problem, checked)
        draws = None
        if episodes is None:
            self.engine = engine = Engine(fixed_batch(problems, checked), checked)
        else:
            draws = self._draws_of(episodes, seed, cast(int, problems))
            self.engine = engine = Engine(draws.problems.tolist(), checked, room=episodes.room)
        self._draws = draws
        bounds = draws.episodes.bounds if draws else engine.problems
        self.autoreset, self._everyone = autoreset and not play_once, everyone
        observation, reward = checked.observation.make(), checked.reward.make()
        overflow = engine.static.overflow_allowed
        self.single_observation_space = space_of(observation, bounds, overflow)
        self.single_state_space = state_space_of(observation, bounds, overflow)
        self.single_action_space = Discrete(engine.actions)
        self.num_problems, self.num_agents = engine.nets.shape
        self.num_envs = self.num_problems
        self._buffers = StepBuffers.of(
            self.num_problems,
            self.num_agents if everyone else 1,
            self.single_observation_space.shape,
            engine.actions,
        )
        self._state = np.empty((self.num_problems, *self.single_state_space.shape), np.float32)

        threads = min(threads, self.num_problems)
        cuts = [self.num_problems * thread // threads for thread in range(threads + 1)]
        self._players = [
            Player(
                engine.part(part),
                observation,
                reward,
                everyone=everyone,
                buffers=StepBuffers._make(array[part] for array in self._buffers),
                draws=draws and draws.part(part),
            )
            for part in map(slice, cuts, cuts[1:])
        ]
        played = episodes.identity if episodes else (*engine.problems,)
        shape = self._buffers.obs.shape
        self._identity = (kind, everyone, self._persists, checked.rules, shape, cuts, played)
        self._begun = False
        self._start_threads()

    def _start_threads(self) -> None:
        """Prepares threads, which start as they are needed."""
        self._process = os.getpid()
        self._threads = ThreadPoolExecutor(len(self._players))

    @property
    def observation(self) -> Observation:
        """What agents see, the object that writes it."""
        return self._players[0].observation

    @property
    def present(self) -> NDArray[np.bool_]:
        """(M, N) bool, whether there is an agent."""
        return self.engine.tasks > 0

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Starts the episodes of all problems.

        Args:
            seed: if games draw their problems, a new seed for all, or a list with one for each
                game. A game with a new seed begins its sequence of problems again; with None it
                continues. Without effect on fixed problems.
            options: ``reset_mask``, (M,) bool, selects the problems whose episodes start, as in
                Gymnasium's vectors. Other keys are ignored.

        Returns:
            (M, K, *S) float32 observations, and an info like that of :meth:`step`.

        Raises:
            ValueError: ``reset_mask`` is not one boolean per problem, or there is not one seed per
                problem.
        """
        which, seeds = self._chosen(seed, options)
        if self._draws is not None:
            self._draws.begin(seeds, which)
        first = 0
        for player in self._players:
            some = which[first : first + len(player.buffers.over)]
            first += len(some)
            player.reset(some)
        self._begun = True
        return self._buffers.obs, self._info()

    def _chosen(
        self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
    ) -> tuple[NDArray[np.bool_], list[int | None]]:
        """The games that a reset starts, and a seed for each; see :meth:`reset`."""
        listed = isinstance(seed, Sequence | np.ndarray)
        seeds = list(cast(Sequence[int | None], seed if listed else [seed] * self.num_problems))
        if len(seeds) != self.num_problems:
            raise ValueError(f"seed: expected one, or {self.num_problems} of them, found {seed}")
        for one in seeds:
            checked_seed(0 if one is None else one)
        which = np.asarray((options or {}).get("reset_mask", np.ones(self.num_problems, np.bool_)))
        which = which if self._begun else np.ones_like(which)
        if which.shape != (self.num_problems,) or which.dtype != np.bool_:
            raise ValueError(f"reset_mask: expected {self.num_problems} booleans, found {which}")
        return which, seeds

    def step(
        self, actions: NDArray[np.integer]
    ) -> tuple[
        NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], Info
    ]:
        """Moves the agents of all rows, those of each problem in turn order.

        Args:
            actions: (M, K) integers, 0 to A − 1 (see :class:`marouting.rules.Rules`), or −1 for no
                move. Those of agents that are done or absent are ignored.

        Returns:
            * (M, K, *S) float32 observations,
            * (M, K) float32 rewards: what the moves of the step paid each agent,
            * (M, K) bool terminated: all tasks of the agent are joined,
            * (M, K) bool truncated: all tasks of the agent have ended and some failed; both wait
              for the end of the episode with ``agents_persist``,
            * an info, a dictionary of

              * ``agents`` (M, K) int32: the agent of each row, −1 for none;
              * ``action_mask`` (M, K, A) int8, for A actions;
              * ``active`` (M, K) bool: agents that still route. In sequential order only the one
                whose turn it is moves next; the actions of the others are ignored;
              * ``acted`` (M, K) bool: agents that moved in this step;
              * ``task_ended`` (M, K) int8: 1 where this step joined the agent's task, 2 where the
                task failed, otherwise 0;
              * ``final_obs`` (M, K, *S) float32 and ``final_mask`` (M, K, A) int8: where a task
                ended, or K = 1 and the turn passed, what the agent saw on arrival;
              * ``over`` (M,) bool: episodes that ended in this step;
              * ``overflow``, ``wirelength``, ``joined`` and ``steps`` (M,) integers: the present
                metrics;
              * ``final_info``: a dictionary of the same four metrics at the end of the problem's
                last episode, 0 before the first one has ended;
              * where problems are drawn, ``problem`` (M,) objects: the names of those that are
                played.

            ``terminated`` and ``truncated`` stay true until the problem's next episode starts. To
            bootstrap for an agent that acted, use ``final_obs`` where it is written, otherwise the
            observation. Do not bootstrap after a joined task; a failed task only ran out of steps.

        Raises:
            ResetNeeded: :meth:`reset` has not been called.
            ValueError: an array has a wrong shape, or an action is out of range.
        """
        if not self._begun:
            raise ResetNeeded("step: expected a call of reset() before it")
        b, actions = self._buffers, np.asarray(actions)
        if actions.shape != b.actions.shape:
            raise ValueError(f"actions: expected shape {b.actions.shape}, found {actions.shape}")
        self.engine.check(actions if self._everyone else actions[:, 0])
        b.actions[:] = actions
        first, *others = self._players
        if self._process != os.getpid():  # a fork: the threads have stayed behind
            self._start_threads()
        running = [self._threads.submit(player.step, self.autoreset) for player in others]
        first.step(self.autoreset)
        for other in running:
            other.result()
        if self._persists:
            self._end_together()
        return b.obs, b.reward, b.terminated, b.truncated, self._info()

    def _end_together(self) -> None:
        """Agents that are done stay to the end of the episode, with a single action."""
        b = self._buffers
        playing = self.engine.games["active"] > 0
        b.terminated[playing] = b.truncated[playing] = False
        b.mask[~b.active & self.present] = np.eye(1, self.engine.actions, dtype=np.int8)

    def state(self) -> NDArray[np.float32]:
        """(M, X, Y, 5 Z) float32, the global states; see :func:`.observations.state_space`.

        Observations can define their own state; see :func:`.observations.state_of`.
        """
        return state_of(self._players[0].observation, self.engine, self._state)

    def __getstate__(self) -> dict[str, Any]:
        """The constructor's arguments and the present state, from which a copy continues."""
        return {**super().__getstate__(), "saved": self.save().games, "begun": self._begun}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes the environment again and restores the state."""
        super().__setstate__(state)
        self.restore(SavedBatch(self._identity, state["saved"]))
        self._begun = state["begun"]

    def save(self) -> SavedBatch:
        """A copy of the state of all games, for :meth:`restore`."""
        return SavedBatch(self._identity, [player.save() for player in self._players])

    def restore(self, saved: SavedBatch) -> None:
        """Puts all games back into a saved state; raises ValueError if it is of other games."""
        if not isinstance(saved, SavedBatch) or saved.identity != self._identity:
            raise ValueError(OTHER_GAME)
        for player, kept in zip(self._players, saved.games, strict=True):
            player.restore(kept)
        self._begun = True

    def close(self) -> None:
        """Ends the threads. The environment plays on if it is used again."""
        self._threads.shutdown()
        self._start_threads()

    def _info(self) -> Info:
        b, games = self._buffers, self.engine.games
        drawn = {}
        if self._draws is not None and self._draws.episodes.many:
            drawn["problem"] = self._draws.names
        return {**drawn, **info_of(b, games.__getitem__, b.final.__getitem__)}


def info_of(b: StepBuffers, now: Callable[[str], Any], final: Callable[[str], Any]) -> Info:
    """The info of a step; ``now`` and ``final`` give a figure (M,) of the games by its name."""
    return {
        "agents": b.agents,
        "action_mask": b.mask,
        "active": b.active,
        "acted": b.acted,
        "task_ended": b.ending,
        "final_obs": b.final_obs,
        "final_mask": b.final_mask,
        "over": b.over,
        **{figure: now(figure) for figure in FIGURES},
        "final_info": {figure: final(figure) for figure in FIGURES},
    }


def batch_options(
    options: Mapping[str, Any], everyone: bool, autoreset: bool, play_once: bool
) -> GameOptions:
    """Checks the options of a batch, which has neither pictures nor keys of observations."""
    switches = {"everyone": everyone, "autoreset": autoreset, "play_once": play_once}
    for name, value in switches.items():
        check(name, isinstance(value, bool | np.bool_), f"true or false, found {value!r}")
    checked = game_options(options, "multi" if everyone else "single")
    check_plain_arrays(options)
    return checked


def check_plain_arrays(options: Mapping[str, Any]) -> None:
    """Raises InputError for options of pictures and of keys of observations."""
    check("render_mode", options.get("render_mode") is None, "null: a batch draws no pictures")
    given = options.get("mask") or {}  # what a scenario suggests for other interfaces may stay
    mask = given if isinstance(given, Mask) else build(Mask, given, "mask")
    what = 'no key but visited: a batch gives its masks as info["action_mask"]'
    check("mask", mask == Mask(visited=mask.visited), what)


def drawn_from(
    problems: Sequence[Problem] | int | None, source: Source, options: GameOptions
) -> ProblemStream | None:
    """What the games of a batch draw their problems from; None if they stay, see `BatchEnv`."""
    if not is_whole(problems):
        check("problem", source is None, "a number of games first, as in BatchEnv(8, problem=…)")
        return None
    if options.scenario is None:
        what = f"a list of problems, or a problem or scenario as well; found {problems}"
        check("problems", source is not None, what)
    return ProblemStream(source, options.scenario, options.split)


def fixed_batch(
    problems: Sequence[Problem] | int | None, options: GameOptions
) -> Sequence[Problem]:
    """The problems of a batch that stay; see :class:`BatchEnv`."""
    listed = isinstance(problems, Sequence) and not isinstance(problems, str)
    found = "a list" if listed else repr(problems)
    if options.scenario is None:
        what = f"a list of problems, or a scenario; found {found}"
        check("problems", problems is not None, what)
        what = "a list of Problem objects (problem= takes files, folders and generators)"
        for item in cast(Sequence[Problem], problems) if listed else (problems,):
            check("problems", listed and isinstance(item, Problem), f"{what}; found {item!r}")
        return cast(Sequence[Problem], problems)
    endless = options.split == "train"
    what = f"a number of games that draw from {options.scenario}, found {found}"
    check("problems", not endless, what)
    check("problems", problems is None, f"none, or a number, with a scenario; found {found}")
    return list(get(options.scenario).problems(options.split).values())
