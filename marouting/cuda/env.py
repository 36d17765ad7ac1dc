"""Many problems at once on a CUDA device; made by ``BatchEnv(…, device="cuda")``."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from marouting.batch.bits import numbers_of
from marouting.batch.engine import Metrics
from marouting.batch.expected import new_maps, track_of
from marouting.batch.setup import dynamic_state, static_state
from marouting.batch.state import AGENT, GAME, Option, Static
from marouting.batch.step import FastPath, StepBuffers
from marouting.batch.window import WindowObservation
from marouting.config import check
from marouting.cuda.games import (
    DEFAULT_STREAM,
    WARP,
    Device,
    Paper,
    Pool,
    Recorded,
    Step,
    Surroundings,
    launches,
    prepare_nothing,
    prepare_window,
    see_paper,
    see_window,
    tell_paper,
    tell_window,
)
from marouting.game import NOBODY
from marouting.kernels import mixed
from marouting.observations import Observation, PaperObservation, space_of, state_space_of
from marouting.problem.grid import AXES, VIA_AXIS, Grid
from marouting.problem.net import is_whole
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.rewards import prices_of
from marouting.source import OTHER_GAME, ProblemStream, Source, generated_name
from marouting.vector import (
    FIGURES,
    BatchEnv,
    Info,
    SavedBatch,
    batch_options,
    drawn_from,
    fixed_batch,
    info_of,
)

_CHANGING = ("capacity", "demand", "first", "order")
"""What a problem brings along: arrays of a :class:`Static` with the game as the first axis."""

_SEEN = ("obs", "mask", "final_obs", "final_mask")
"""What agents see, which follows from the state."""

_TOGETHER = ("capacity", "remaining", "used", "sets", "numbers", "cells")
"""Arrays in which what belongs to a game is side by side: an agent reads what is near it. In all
others, what belongs to neighbouring games is: neighbouring threads play them."""


class CudaBatchEnv(BatchEnv):
    """:class:`marouting.vector.BatchEnv` on a CUDA device.

    Observations, masks, rewards and the arrays of the info stay on the device. They have
    ``__cuda_array_interface__``: ``torch.as_tensor(array, device="cuda")`` and
    ``cupy.asarray(array)`` show them without a copy. They belong to the environment and are
    overwritten by the next call. Work is queued on the default stream, which torch uses as well
    unless it is told otherwise.

    The rows of a problem are in turn order, unlike on the processor, unless nets are ripped up with
    their neighbours: ``nets`` tells them apart.

    Args:
        pool: how many problems are drawn ahead and uploaded, where M games draw theirs; every
            episode plays one of them, and ``info["problem"]`` has their numbers. None: all that a
            source lists, 1024 of one without end.
        **arguments: those of :class:`marouting.vector.BatchEnv`; ``threads`` is for the processor.

    Attributes:
        actions: (M, K) int16 on the device; :meth:`step` takes this array without a copy.
        pool: the problems that are played, a list.
        names: their names, a list.

    There is no ``engine``: the games are on the device.

    Raises:
        InputError: no device can be used, it has too little memory, or an option is not supported
            there: observations and rewards of your own, and ``agents_persist``.
    """

    def __init__(
        self,
        problems: Sequence[Problem] | int | None = None,
        *,
        problem: Source = None,
        everyone: bool = True,
        autoreset: bool = True,
        threads: int = 1,
        seed: int = 0,
        play_once: bool = False,
        device: str = "cuda",
        pool: int | None = None,
        **options: Any,
    ) -> None:
        check("device", device == "cuda", f"cpu or cuda, found {device!r}")
        what = f"1: they are the processor's, found {threads!r}"
        check("threads", is_whole(threads) and threads == 1, what)
        _check_seed(seed)
        self._device = Device()
        checked = batch_options(options, everyone, autoreset, play_once)
        check("agents_persist", not checked.agents_persist, "false for device cuda")
        once = not play_once or not is_whole(problems)
        check("play_once", once, "false: these games draw their problems")
        observation, reward = checked.observation.make(), checked.reward.make()
        self.autoreset, self._everyone = autoreset and not play_once, everyone
        given: Any = problem
        if isinstance(given, ProblemStream):  # a training has one already
            episodes: ProblemStream | None = given
        else:
            episodes = drawn_from(problems, problem, checked)
        self._drawn = episodes is not None
        if episodes is not None:
            self.num_problems = cast(int, problems)
            check("number of games", self.num_problems >= 1, f"a number from 1, found {problems}")
            some = pool is None or (is_whole(pool) and pool >= 1)
            check("pool", some, f"a number from 1, found {pool!r}")
            ahead, bounds = episodes.ahead(pool, seed), episodes.bounds
            self.names, self.pool = (list(each) for each in zip(*ahead, strict=True))
            held = static_state(self.pool, checked, room=episodes.room)
        else:
            check("pool", pool is None, "none: these problems stay")
            self.pool = bounds = list(fixed_batch(problems, checked))
            self.names = [generated_name(m) for m in range(len(self.pool))]
            held = static_state(self.pool, checked)
            self.num_problems = len(self.pool)
        # Lots of rip-up depend on the numbers of agents.
        lots = checked.rip_up is not None and checked.rip_up.neighbours > 0
        static, self._nets = held if lots else _in_turn(*held)
        static = _without_vias(static)
        brought = (getattr(static, name) for name in _CHANGING)
        played = _digest(static.tasks, self._nets, *brought)
        self.num_envs, self.num_agents = self.num_problems, self._nets.shape[1]
        overflow = static.overflow_allowed
        self._observation = observation
        self.single_observation_space = space_of(observation, bounds, overflow)
        self.single_state_space = state_space_of(observation, bounds, overflow)
        self.single_action_space = Discrete(checked.actions)
        shape = self.num_problems, *self.single_observation_space.shape
        self._identity = (type(self).__name__, everyone, checked.rules, shape, played)
        for name, what in unsupported(observation, reward):
            check(name, False, what)
        with self._device.allocating():
            self._upload(static, seed)
            self._look, *looks = self._looks(observation, static)
            shape = self.num_problems, len(static.neighbour)
            fast = FastPath.of(shape, observation, reward, everyone=everyone, make=self._zeros)
            self._fast = FastPath._make(map(self._device.of, fast))
        self._launches = launches(*looks)
        self._recorded: dict[tuple[bool, bool], Recorded] = {}
        self._begun = False

    def _upload(self, static: Static, seed: int) -> None:
        """Makes the arrays on the device."""
        device, games, drawn = self._device, self.num_problems, self._drawn
        grid = Grid.of(self.pool[0].grid)
        rows = self.num_agents if self._everyone else 1
        kinds = _narrow(static)

        def make(name: str, shape: tuple[int, ...], dtype: Any) -> Any:
            return self._zeros(name, shape, kinds.get(name, dtype))

        arrays = {name: getattr(static, name) for name in _CHANGING}
        arrays = {name: a.astype(kinds.get(name, a.dtype)) for name, a in arrays.items()}
        pool = {name: array[: len(self.pool) * drawn] for name, array in arrays.items()}
        own = {
            name: make(name, (games, *a.shape[1:]), a.dtype)
            if drawn
            else device.of(np.asarray(a, order="C" if name in _TOGETHER else "F"))
            for name, a in arrays.items()
        }
        self._static: Any = Static._make(map(device.of, static._replace(**own)))
        self._dynamic: Any = dynamic_state(self._static, grid, self.num_agents, games, make)
        shape = self.single_observation_space.shape
        self._buffers: Any = StepBuffers.of(
            games, rows, shape, int(self.single_action_space.n), self._zeros
        )
        self.actions = self._buffers.actions
        if self._everyone and not drawn:
            there = np.diff(static.first, axis=1) > 0
            agents = np.where(there, np.arange(rows), NOBODY).astype(np.int32)
            b: Any = self._buffers
            b.agents.copy_to_device(agents)
        self._pool = Pool(
            **{name: device.of(array) for name, array in pool.items()},
            key=device.of(_keys(np.full(games, seed, np.uint64))),
            episode=device.zeros((games,), np.int64),
            number=device.of(np.arange(games, dtype=np.int32) * (not drawn)),
        )
        self._passed = Step(
            which=device.zeros((games,), np.bool_),
            begins=device.zeros((games,), np.bool_),
            on_turn=device.zeros((games,), np.int32),
        )
        self._refused = device.zeros((1,), np.int32)
        self._states: Any = None
        b, column = self._buffers, device.column
        self._infos: Info = {
            **info_of(b, partial(column, self._dynamic.games), partial(column, b.final)),
            **({"problem": self._pool.number} if drawn else {}),
        }

    def _zeros(self, name: str, shape: tuple[int, ...], dtype: Any) -> Any:
        return self._device.zeros(shape, dtype, "C" if name in _TOGETHER else "F")

    @property
    def observation(self) -> Observation:
        """What agents see: the options of what the device writes."""
        return self._observation

    @property
    def nets(self) -> NDArray[np.int32]:
        """(M, N) int32, on the processor: the net of every agent; NOBODY (−1) for none."""
        return self._nets[self._pool.number.copy_to_host()]

    @property
    def present(self) -> NDArray[np.bool_]:
        """(M, N) bool, on the processor: whether there is an agent."""
        return np.diff(self._static.first.copy_to_host(), axis=1) > 0

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Any, Info]:
        """See :meth:`marouting.vector.BatchEnv.reset`; what it returns is on the device."""
        self.check()
        which, seeds = self._chosen(seed, options)
        given = np.array([s is not None for s in seeds])
        if self._drawn and given.any():
            for fresh_seed in set(seeds) - {None}:
                _check_seed(fresh_seed)
            keys, episode = self._pool.key.copy_to_host(), self._pool.episode.copy_to_host()
            chosen = given & which
            fresh = np.array([0 if s is None else s for s in seeds], np.uint64)
            keys[chosen], episode[chosen] = _keys(fresh)[chosen], 0
            self._pool.key.copy_to_device(keys)
            self._pool.episode.copy_to_device(episode)
        self._passed.which.copy_to_device(which)
        self._play(steps=False, restarts=True)
        self._begun = True
        return self._buffers.obs, dict(self._infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Info]:
        """See :meth:`marouting.vector.BatchEnv.step`; what it returns is on the device.

        Args:
            actions: (M, K) integers, an array of the device (torch, cupy, numba) or of NumPy. On
                the device nobody waits for a check: an action out of range is no move, and the next
                call of :meth:`check` or :meth:`reset` raises ValueError.

        Raises:
            ResetNeeded: :meth:`reset` has not been called.
            ValueError: an array has a wrong shape, or an action of NumPy is out of range.
        """
        if not self._begun:
            raise ResetNeeded("step: expected a call of reset() before it")
        if actions is not self.actions:
            self._take(actions)
        self._play(steps=True, restarts=self.autoreset)
        b = self._buffers
        return b.obs, b.reward, b.terminated, b.truncated, dict(self._infos)

    def _take(self, actions: Any) -> None:
        """Takes actions from another array."""
        shape, most = self.actions.shape, int(self.single_action_space.n)
        there = ("__cuda_array_interface__", "copy_to_host")  # numba's simulator has the second
        on_device = any(hasattr(actions, name) for name in there)
        given = self._device.array(actions) if on_device else np.asarray(actions)
        if tuple(given.shape) != shape or given.dtype.kind not in "iu":
            found = f"{given.dtype} of shape {tuple(given.shape)}"
            raise ValueError(f"actions: expected integers of shape {shape}, found {found}")
        if not on_device:
            if not (given.min() >= NOBODY and given.max() < most):
                raise ValueError(f"actions: expected 0 to {most - 1}, or {NOBODY}, found {given}")
            given = self._device.of(given)
        self._run(self._launches.take, self.actions.size, given, self.actions, most, self._refused)

    def _run(self, kernel: Any, threads: int, *arguments: Any) -> None:
        self._device.launch(kernel, threads, DEFAULT_STREAM, *arguments)

    def _looks(self, observation: Any, static: Static) -> tuple[Any, Any, Any, Any]:
        """What an observation needs on the device, and its kernels, see :func:`.launches`."""
        if type(observation) is PaperObservation:
            return Paper(float(observation.via_capacity)), see_paper, prepare_nothing, tell_paper
        offsets = observation.offsets
        games, gcells = self.num_problems, len(self._static.neighbour)
        layers, device = self.pool[0].grid[2], self._device
        tracks = np.array([track_of(static, m) for m in range(len(self.pool))], np.float32)
        maps = new_maps(1, 1, layers, self._zeros)
        look = Surroundings(
            heads=device.zeros((games, gcells * (1 + (offsets.messages >= 0))), np.int16, "C"),
            offsets=offsets,
            maps=maps._replace(track=device.zeros((games, layers), np.float32)),
            tracks=device.of(tracks),
            number=self._pool.number,
        )
        return look, see_window, prepare_window, tell_window

    def _play(self, *, steps: bool, restarts: bool) -> None:
        """A step of all games, or the beginning of some."""

        def launch(stream: Any) -> None:
            self._launch(stream, steps=steps, restarts=restarts)

        key = steps, restarts
        if key in self._recorded:
            self._recorded[key]()
            return
        launch(DEFAULT_STREAM)
        if not self._device.simulated:
            self._recorded[key] = Recorded(launch)

    def _launch(self, stream: Any, *, steps: bool, restarts: bool) -> None:
        """The launches of a step."""
        run, step, games, rows = self._launches, self._passed, self.num_problems, self.actions.size
        static, dynamic, b, look, fast = (
            self._static, self._dynamic, self._buffers, self._look, self._fast,
        )  # fmt: skip
        call = self._device.launch
        pool = self._pool
        call(run.begin, WARP * games, stream, static, dynamic, b, pool, step, steps, restarts)
        call(run.move, games, stream, static, dynamic, b, fast, look, pool, step, steps)
        if steps:
            call(run.arrive, rows, stream, static, dynamic, b, look, step, self._everyone)
        call(run.settle, games, stream, static, dynamic, b, fast, look, step, steps)
        call(run.show, rows, stream, static, dynamic, b, look)

    def check(self) -> None:
        """Raises ValueError if an action has been out of range since the last call."""
        if self._refused.copy_to_host()[0]:
            self._refused.copy_to_device(np.zeros(1, np.int32))
            most = int(self.single_action_space.n) - 1
            raise ValueError(f"actions: expected 0 to {most}, or {NOBODY}, found others")

    def state(self) -> Any:
        """(M, *single_state_space.shape) float32 on the device: the global states."""
        games, shape = self.num_problems, self.single_state_space.shape
        if self._states is None:
            with self._device.allocating():
                self._states = self._device.zeros((games, *shape), np.float32, "C")
            gcells = len(self._static.neighbour)
            self._flat_states = self._states.reshape(games, gcells, -1)
        self._run(
            self._launches.state, games, self._static, self._dynamic, self._look, self._flat_states
        )
        return self._states

    def solution(self, m: int = 0) -> Solution:
        """The routes of game m at this moment."""
        used = self._dynamic.used[m : m + 1].copy_to_host()
        number = int(self._pool.number[m])
        agent, edge = numbers_of(used, 0)
        net = self._nets[number, agent].astype(np.int64)
        by_net = np.argsort(net, kind="stable")
        return Solution.of_uses(self.pool[number], net[by_net], edge[by_net])

    def ended(self, m: int) -> tuple[str, Metrics, float]:
        """Name of the problem, metrics and reward of game m, whose episode has just ended."""
        number, total = int(self._pool.number[m]), float(self._buffers.total[m])
        games, first = self._buffers.final[m : m + 1].copy_to_host()[0], self._static.first[m]
        figures = {figure: int(games[figure]) for figure in FIGURES}
        tasks = first.copy_to_host()
        return self.names[number], Metrics(**figures, tasks=int(tasks[-1] - tasks[0])), total

    def save(self) -> SavedBatch:
        """A copy of the state of all games, on the processor, for :meth:`restore`.

        ``final_obs`` and ``final_mask`` of the last step are not in it.
        """
        return SavedBatch(self._identity, [array.copy_to_host() for array in self._arrays()])

    def restore(self, saved: SavedBatch) -> None:
        """Puts all games back into a saved state; raises ValueError if it is of other games."""
        # A state has places in tables of problems, which kernels do not check.
        if not isinstance(saved, SavedBatch) or saved.identity != self._identity:
            raise ValueError(OTHER_GAME)
        for array, kept in zip(self._arrays(), saved.games, strict=True):
            if array.size:
                array.copy_to_device(kept)
        arguments = self._static, self._dynamic, self._buffers, self._look
        self._run(self._launches.look, self.num_problems, self._dynamic, self._look)
        self._run(self._launches.show, self.actions.size, *arguments)
        self._begun = True

    def _arrays(self) -> list[Any]:
        """What changes while games are played, and does not follow from the rest."""
        drawn = [getattr(self._static, name) for name in _CHANGING]
        buffers = [array for name, array in self._buffers._asdict().items() if name not in _SEEN]
        pool = self._pool
        return [*self._dynamic, *buffers, *drawn, pool.key, pool.episode, pool.number]

    def __getstate__(self) -> dict[str, Any]:
        """The constructor's arguments and the present state, from which a copy continues."""
        return {**EzPickle.__getstate__(self), "saved": self.save(), "begun": self._begun}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes the environment again and restores the state."""
        EzPickle.__setstate__(self, state)
        self.restore(state["saved"])
        self._begun = state["begun"]

    def close(self) -> None:
        """Waits for the device."""
        self._device.synchronize()


def unsupported(observation: Any, reward: Any) -> Iterator[tuple[str, str]]:
    """The names of the components that cannot be used on a device, and what was expected."""
    seen, paid = type(observation), type(reward).__name__
    if seen not in (PaperObservation, WindowObservation):
        yield "observation", f"paper or window for device cuda, found {seen.__name__}"
    elif seen is WindowObservation and observation.offsets.demand >= 0:
        yield "observation.channels", "no demand for device cuda"
    if prices_of(reward) is None:
        yield "reward", f"a built-in one for device cuda, found {paid}"


def _in_turn(static: Static, nets: NDArray[np.int32]) -> tuple[Static, NDArray[np.int32]]:
    """The same problems with their agents numbered in turn order, and the agents' nets."""
    tasks, first = static.tasks.copy(), static.first.copy()
    demand, nets = static.demand.copy(), nets.copy()
    for m, order in enumerate(static.order):
        turn = order[order != NOBODY]
        begins, ends = static.first[m, turn], static.first[m, turn + 1]
        first[m, 1 : len(turn) + 1] = first[m, 0] + np.cumsum(ends - begins)
        which = [np.arange(*pair) for pair in zip(begins, ends, strict=True)]
        tasks[first[m, 0] : first[m, len(turn)]] = static.tasks[np.concatenate(which)]
        demand[m, : len(turn)], nets[m, : len(turn)] = static.demand[m, turn], nets[m, turn]
    place = np.arange(static.order.shape[1], dtype=np.int32)
    order = np.where(static.order == NOBODY, np.int32(NOBODY), place)
    return static._replace(tasks=tasks, first=first, demand=demand, order=order), nets


def _without_vias(static: Static) -> Static:
    """The same problems with vias of capacity 0, which nobody asks for: edges fit smaller types."""
    capacity = static.capacity.copy()
    capacity[:, VIA_AXIS::AXES] = 0
    return static._replace(capacity=capacity)


def _narrow(static: Static) -> dict[str, Any]:
    """The smallest types that hold what games need, by the names of arrays.

    The fewer bytes a game takes, the more games fit into the device's cache.
    """
    demand = int(static.demand.max(axis=2).sum(axis=1, dtype=np.int64).max())
    # Where routes are put back after a round, they overflow until the last of them is.
    overflows = static.overflow_allowed or static.options[Option.ROUNDS] > 0
    edges = _holds(-demand * overflows, int(static.capacity.max()))
    small = {np.dtype(np.int32): np.dtype(np.int16)}
    fits = max(len(static.position), static.max_steps, demand) < 2**15
    agent = _fields(AGENT)
    if fits:
        agent = {n: small.get(k, k) if n != "task" else k for n, k in agent.items()}
        tasks = int(np.diff(static.first, axis=1).max())
        agent["joined"] = _holds(0, tasks)
    game = _fields(GAME)
    if demand * static.capacity.shape[1] < 2**31:
        game["overflow"] = game["wirelength"] = np.dtype(np.int32)
    return {
        "capacity": edges,
        "remaining": edges,
        "demand": _holds(0, int(static.demand.max())),
        "agents": np.dtype(list(agent.items()), align=True),
        "games": np.dtype(list(game.items()), align=True),
    }


def _fields(record: np.dtype[Any]) -> dict[str, np.dtype[Any]]:
    """The types of the fields of a record."""
    fields: Any = record.fields
    return {name: fields[name][0] for name in fields}


def _holds(least: int, most: int) -> Any:
    """The smallest type that holds whole numbers in a range."""
    kinds = (np.int8, np.int16, np.int32)
    fits = (k for k in kinds if np.iinfo(k).min <= least and most <= np.iinfo(k).max)
    return np.dtype(next(fits, np.int64))


def _check_seed(seed: Any) -> None:
    """Raises InputError for a seed that a device cannot draw by."""
    whole = is_whole(seed) and 0 <= seed < 2**64
    check("seed", whole, f"a whole number from 0 to 2**64 - 1, found {seed!r}")


def _digest(*arrays: NDArray[Any]) -> bytes:
    """A digest of what is in some arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def _keys(seeds: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """(M,) the keys of games with seeds (M,), different for every place."""
    place = np.arange(1, len(seeds) + 1, dtype=np.uint64)
    z = seeds * np.uint64(0xD1342543DE82EF95) + place * np.uint64(0x9E3779B97F4A7C15)
    keys: NDArray[np.uint64] = mixed.py_func(z)
    return keys
