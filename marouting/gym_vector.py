"""Many games at once with the interface of Gymnasium's vectors: what ``gymnasium.make_vec`` gives.

Each game is that of :class:`marouting.env.single.GlobalRoutingSingle`, played through arrays.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from marouting.config import check
from marouting.env.base import METADATA, ONE_PLAYER, result_of
from marouting.game import NOBODY
from marouting.options import game_options
from marouting.problem.net import is_whole
from marouting.render import ansi, rgb_array, scene_of
from marouting.source import MOST_PROBLEMS, OwnProblemSampler, Source
from marouting.vector import BatchEnv, Info


class _Games(BatchEnv):
    """Games with seeds of their own."""

    _draws_of = OwnProblemSampler


class GlobalRoutingVector(VectorEnv[Any, Any, Any]):
    """Many Gymnasium environments at once; returned arrays are not overwritten later.

    The results are those of ``gymnasium.vector.SyncVectorEnv`` with the same seeds.

    Args:
        num_envs: how many games.
        problem: what each of them plays, see :data:`marouting.source.Source`.
        render_mode: ``ansi``, ``rgb_array`` or None.
        autoreset_mode: when a game that is over starts its next episode. ``NEXT_STEP``: in the
            following step, which ignores its action. ``SAME_STEP``: at once; the infos hold the
            last observation and info as ``final_obs`` and ``final_info``. ``DISABLED``: when
            :meth:`reset` is called for it, with ``reset_mask``.
        **options: the other fields of :class:`marouting.options.GameOptions`, ``threads`` of
            :class:`marouting.vector.BatchEnv`, and ``seed``: unless :meth:`reset` is given others,
            game m has the seed ``seed + m``.

    Raises:
        InputError: an option or the problem cannot be used.
    """

    def __init__(
        self,
        num_envs: int = 1,
        problem: Source = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        what = "nothing: gymnasium.make_vec has it with vectorization_mode='sync'"
        check("max_episode_steps", "max_episode_steps" not in options, what)
        modes = {name: mode for mode in AutoresetMode for name in (mode, mode.name, mode.value)}
        what = f"one of {', '.join(mode.name for mode in AutoresetMode)}, found {autoreset_mode!r}"
        check("autoreset_mode", autoreset_mode in modes, what)
        self._mode = modes[autoreset_mode]
        rules = {key: value for key, value in options.items() if key not in ("threads", "seed")}
        self._options = game_options({**rules, "render_mode": render_mode}, "single")
        self._mask = self._options.mask
        check("agents_persist", not self._options.agents_persist, ONE_PLAYER)
        whole = is_whole(num_envs) and 1 <= num_envs <= MOST_PROBLEMS
        check("num_envs", whole, f"a whole number from 1 to {MOST_PROBLEMS}, found {num_envs!r}")
        check("render_mode", render_mode != "human", "ansi, rgb_array or None, for many games")
        problem = self._options.problem if problem is None else problem
        self._observation = self._options.observation.make()
        options["observation"] = self._observation
        options["mask"] = {"visited": self._mask.visited}
        restarts = self._mode is AutoresetMode.NEXT_STEP
        self._batch = _Games(
            num_envs, problem=problem, everyone=False, autoreset=restarts, **options
        )
        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = METADATA | {"autoreset_mode": self._mode}
        space: Space[Any] = self._batch.single_observation_space
        if self._mask.in_observation:
            mask = Box(0, 1, (self._options.actions,), np.int8)
            space = Dict({self._mask.observation_key: space, self._mask.mask_key: mask})
        self.single_observation_space = space
        self.single_action_space = self._batch.single_action_space
        self.observation_space = batch_space(space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._games = np.arange(num_envs)
        self._movers = np.zeros(num_envs, np.int32)
        self._over = np.zeros(num_envs, np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Info]:
        """Starts the episodes of all games, or of those in ``options["reset_mask"]``.

        Args:
            seed: of the problems drawn, if there are several: game m has the seed ``seed + m``. Or
                a list with one for each game; a game with None continues its sequence.
            options: see :meth:`marouting.vector.BatchEnv.reset`.

        Raises:
            ValueError: there is not one seed, or not one boolean, for each game.
        """
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            seed = [int(seed) + m for m in range(self.num_envs)]
        obs, batch = self._batch.reset(seed=seed, options=options)
        self._over = batch["over"].copy()
        begun = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_)))
        seen, infos = self._seen(obs, batch, begun)
        return seen, self._named(infos, batch, begun)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Moves the net whose turn it is in every game.

        Args:
            actions: (M,) integers.

        Returns:
            (M, *S) observations, (M,) rewards, terminations and truncations, and infos in the form
            of Gymnasium's vectors: of each key of a game's info an array, and ``_key``, (M,) bool,
            which games have it.

        Raises:
            ResetNeeded: :meth:`reset` has not been called, or, with ``DISABLED``, not for a game
                that is over.
            ValueError: there is not one action for each game, or one is none.
        """
        moves, count = np.asarray(actions), self._options.actions
        fits = moves.shape in ((self.num_envs,), (self.num_envs, 1)) and moves.dtype.kind in "iu"
        if not fits:
            what = f"expected integers of shape ({self.num_envs},)"
            raise ValueError(f"actions: {what}, found {moves.dtype} of shape {moves.shape}")
        moves = moves.reshape(-1, 1)
        if not 0 <= moves.min() <= moves.max() < count:
            wrong = moves[(moves < 0) | (moves >= count)][0]
            raise ValueError(f"actions: expected 0 to {count - 1}, found {wrong}")
        if self._mode is AutoresetMode.DISABLED and self._over.any():
            games = np.flatnonzero(self._over).tolist()
            raise ResetNeeded(f"step: expected a call of reset() for games {games}, which are over")
        obs, reward, _, _, batch = self._batch.step(moves)
        begun, self._over = self._over, batch["over"].copy()
        over, paid = self._over, reward[:, 0].astype(np.float64)
        everywhere = np.ones(self.num_envs, np.bool_)
        seen, infos = self._seen(obs, batch, everywhere)
        ended = np.flatnonzero(batch["task_ended"][:, 0]).tolist()
        task_ends = {m: self._task_end(batch, m) for m in ended}
        joined = np.zeros(self.num_envs, np.bool_)
        for m in np.flatnonzero(over).tolist():
            result = result_of(vars(self._batch.engine.metrics(m)))
            joined[m] = result["open"] == 0
            task_ends.setdefault(m, {}).update(result)
        if self._mode is AutoresetMode.SAME_STEP and over.any():
            for m in np.flatnonzero(over).tolist():
                last = {name: infos[name][m] for name in (self._mask.mask_key, "net")} | task_ends[
                    m
                ]
                obs_ = {k: v[m] for k, v in seen.items()} if isinstance(seen, dict) else seen[m]
                task_ends[m] = {"final_obs": obs_, "final_info": last}
            obs, batch = self._batch.reset(options={"reset_mask": over})
            begun, self._over = over, batch["over"].copy()
            seen, infos = self._seen(obs, batch, everywhere)
        infos = self._named(infos, batch, begun)
        for m, info in task_ends.items():
            infos = self._add_info(infos, info, m)
        return seen, paid, over & joined, over & ~joined, infos

    def _seen(
        self, obs: NDArray[np.float32], batch: Info, with_info: NDArray[np.bool_]
    ) -> tuple[Any, Info]:
        """What nets see that are to move, or moved last where games are over; some with infos."""
        now, mask, seen = batch["agents"][:, 0], batch["action_mask"][:, 0].copy(), obs[:, 0].copy()
        self._movers = np.where(now == NOBODY, self._movers, now)
        if self._over.any():  # nobody is to move: shown is the net that moved last
            games = np.flatnonzero(self._over)
            out, which = seen[games], (games, self._movers[games])
            self._observation.write(self._batch.engine, *which, out)
            seen[games], mask[games] = out, self._batch.engine.masks(*which)
        shown: Any = seen
        if self._mask.in_observation:
            keys = self._mask.observation_key, self._mask.mask_key
            shown = dict(zip(keys, (seen, mask.copy()), strict=True))
        if not with_info.any():
            return shown, {}
        nets = self._batch.engine.nets[self._games, self._movers]
        names = np.array([f"net_{net}" for net in nets.tolist()], object)
        mask[~with_info], names[~with_info] = 0, None
        key = self._mask.mask_key
        return shown, {
            key: mask,
            f"_{key}": with_info.copy(),
            "net": names,
            "_net": with_info.copy(),
        }

    def _task_end(self, batch: Info, m: int) -> Info:
        """What the info of a game says of the task that has ended with the move."""
        seen: Any = batch["final_obs"][m, 0].copy()
        mask = batch["final_mask"][m, 0].copy()
        if self._mask.in_observation:
            seen = {self._mask.observation_key: seen, self._mask.mask_key: mask.copy()}
        return {"task_ended": int(batch["task_ended"][m, 0]), "task_obs": seen, "task_mask": mask}

    def _named(self, infos: Info, batch: Info, begun: NDArray[np.bool_]) -> Info:
        """Infos that name the problems of episodes that have just begun, if these are drawn."""
        for m in np.flatnonzero(begun).tolist() if "problem" in batch else ():
            infos = self._add_info(infos, {"problem": batch["problem"][m]}, m)
        return infos

    def action_masks(self) -> NDArray[np.bool_]:
        """(M, A) bool, the moves of the nets to move that cross an edge."""
        return self._batch.engine.masks(*self._batch.engine.pairs(everyone=False)).astype(np.bool_)

    def render(self) -> Any:
        """A picture of every game according to ``render_mode``, in a tuple."""
        if self.render_mode is None:
            return None
        draw = ansi if self.render_mode == "ansi" else rgb_array
        return tuple(draw(scene_of(self._batch.engine, m)) for m in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the threads."""
        del kwargs
        self._batch.close()
