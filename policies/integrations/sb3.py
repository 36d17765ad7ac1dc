"""Stable-Baselines3 and sb3-contrib: a ``VecEnv`` on :class:`marouting.vector.BatchEnv`.

It steps many games in arrays, twenty times as quick as SuperSuit's vectors of single
environments::

    from sb3_contrib import MaskablePPO
    from policies.integrations.sb3 import RoutingVecEnv

    env = RoutingVecEnv(marouting.generate(16, nets=10), reward="normalised")
    MaskablePPO("MlpPolicy", env).learn(100_000)
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from marouting.vector import BatchEnv, Info


class RoutingVecEnv(VecEnv):
    """All nets of M games, each as an environment of its own: M·N of them, for one shared policy.

    An agent's episode ends when all its tasks have ended. It then waits for the end of its game: it
    sees zeros, its mask has a single move, which does nothing, and it is paid nothing. When the
    game is over, all its agents begin again. With ``everyone=False`` a game is one environment,
    whose episode ends with the game.

    What SB3 logs needs no ``VecMonitor``: at the end of an episode its info has ``episode``
    (rewards, moves), ``is_success`` (all tasks joined; of a whole game, also without overflow),
    ``terminal_observation`` and ``TimeLimit.truncated`` (a task failed).

    SB3's ``success_rate`` is the mean of the last ``stats_window_size`` episodes, 100 unless given.
    Of a game's nets those that are joined end first: give a learner several times ``num_envs``.

    Args:
        problems: see :class:`marouting.vector.BatchEnv`.
        everyone: whether all nets of a game have an environment of their own.
        **options: the other arguments of :class:`marouting.vector.BatchEnv`.

    Attributes:
        batch: the games, to be read.

    Raises:
        InputError: an option or a problem cannot be used.
    """

    def __init__(self, problems: Any = None, *, everyone: bool = True, **options: Any) -> None:
        self.batch = BatchEnv(problems, everyone=everyone, autoreset=False, **options)
        self._everyone = everyone
        self._rows = self.batch.num_agents if everyone else 1
        count = self.batch.num_problems * self._rows
        self._return, self._length = np.zeros(count), np.zeros(count, np.int64)
        self._done = np.zeros(count, np.bool_)
        self._began = time.time()
        super().__init__(count, self.batch.single_observation_space, self.batch.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Starts all games."""
        obs, info = self.batch.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self._return[:] = self._length[:] = self._done[:] = 0
        return self._seen(obs, info)

    def step_async(self, actions: NDArray[np.integer]) -> None:
        """Takes an action for each environment."""
        self._actions = np.asarray(actions).reshape(-1, self._rows)

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Makes the moves; (M·N, *S) observations, (M·N,) rewards and ends, and M·N infos."""
        obs, paid, terminated, truncated, info = self.batch.step(self._actions)
        over = info["over"].copy()
        reward = paid.ravel().copy()
        self._return += reward
        self._length += info["acted"].ravel()
        if self._everyone:
            joined, ended = terminated.ravel().copy(), (terminated | truncated).ravel()
            success = joined
        else:
            tasks = self.batch.engine.tasks.sum(axis=1)
            joined, ended = info["joined"] == tasks, over
            success = joined & (info["overflow"] == 0)
        done = ended & ~self._done
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        last = info["final_obs"].reshape(obs.shape[0] * self._rows, *obs.shape[2:])
        now = round(time.time() - self._began, 6)
        for i in np.flatnonzero(done).tolist():
            figures = {"r": float(self._return[i]), "l": int(self._length[i]), "t": now}
            infos[i] = {
                "episode": figures,
                "is_success": bool(success[i]),
                "terminal_observation": last[i].copy(),
                "TimeLimit.truncated": not joined[i],
            }
        self._done |= ended
        if over.any():
            obs, info = self.batch.reset(options={"reset_mask": over})
            self._done[np.repeat(over, self._rows)] = False
        begun = done if not self._everyone else np.repeat(over, self._rows)
        self._return[begun] = self._length[begun] = 0
        return self._seen(obs, info), reward, done, infos

    def _seen(self, obs: NDArray[np.float32], info: Info) -> NDArray[np.float32]:
        """Observations, zeros for agents that wait for the end of their game."""
        active = info["active"].ravel()
        seen = obs.reshape(self.num_envs, *obs.shape[2:]).copy()
        seen[~active] = 0
        self._masks = info["action_mask"].reshape(self.num_envs, -1).astype(np.bool_)
        self._masks[~active] = np.arange(self._masks.shape[1]) == 0
        return seen

    def action_masks(self) -> NDArray[np.bool_]:
        """(M·N, A) bool, the moves that cross an edge."""
        return self._masks

    def close(self) -> None:
        """Ends the threads of the games."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute, the same for all environments."""
        value = None if attr_name == "render_mode" else getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: environments of one game have no attributes of their own."""
        del value, indices
        raise AttributeError(f"{attr_name}: cannot be set: the environments share their games")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> Sequence[Any]:
        """``action_masks`` of some environments, as sb3-contrib asks; there is no other method."""
        if method_name != "action_masks" or method_args or method_kwargs:
            raise AttributeError(f"{method_name}: expected action_masks, without arguments")
        masks: Sequence[Any] = self._masks if indices is None else self._masks[indices]
        return masks

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """False for all: there are no wrappers inside."""
        del wrapper_class
        return [False for _ in self._get_indices(indices)]
