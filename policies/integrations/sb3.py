"""Stable-Baselines3 and sb3-contrib: a ``VecEnv`` on :class:`marouting.vector.BatchEnv`.

It steps many games in arrays, twenty times as quick as SuperSuit's vectors of single
environments::

    from sb3_contrib import MaskablePPO
    from policies.integrations.sb3 import RoutingVecEnv

    env = RoutingVecEnv(marouting.generate(16, nets=10), reward="normalised")
    model = MaskablePPO("MlpPolicy", env).learn(100_000)

A model that :func:`save` has saved is scored by ``marouting benchmark --router
'policies.integrations.sb3:Policy file=model.zip'``, or in Python
(:func:`marouting.evaluate_policy`). To load one runs the code that it holds.
"""

import inspect
import os
import pkgutil
import time
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.vec_env import VecEnv

from marouting.config import check
from marouting.files import naming
from marouting.vector import BatchEnv, Info
from policies.integrations.saved import Training


class RoutingVecEnv(VecEnv):
    """All nets of M games, each as an environment of its own: M·N of them, for one shared policy.

    An agent's episode ends when all its tasks have ended. It then waits for the end of its game: it
    sees zeros, its mask has a single move, which does nothing, and it is paid nothing. This wait is
    an episode of its own, with nothing in its info. When the game is over, all its agents begin
    again. With ``agents_persist=True`` an agent's episode ends with the game, and while it waits it
    is paid by rewards that pay nets for what others do, such as ``team``. With ``everyone=False`` a
    game is one environment, whose episode ends with the game.

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
        taken: what it has been used for.

    Raises:
        InputError: an option or a problem cannot be used.
    """

    def __init__(self, problems: Any = None, *, everyone: bool = True, **options: Any) -> None:
        for name in ("autoreset", "play_once"):
            check(name, name not in options, "none: games that are over begin again")
        self.batch = BatchEnv(problems, everyone=everyone, autoreset=False, **options)
        self.taken = Training(options, everyone=everyone)
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
        reward = np.where(self._done, np.float32(0), paid.ravel())
        self._return += reward
        self._length += info["acted"].ravel()
        self.taken.agent_steps += int(info["acted"].sum())
        if self._everyone:
            joined, ended = terminated.ravel().copy(), (terminated | truncated).ravel()
            success = joined
        else:
            tasks = self.batch.engine.tasks.sum(axis=1)
            joined, ended = info["joined"] == tasks, over
            success = joined & (info["overflow"] == 0)
        done = ended & ~self._done
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        # Agents that waited for the end of their game see the zeros that they saw as they waited.
        last = info["final_obs"] * info["acted"].reshape(
            info["acted"].shape + (1,) * (obs.ndim - 2)
        )
        last = last.reshape(obs.shape[0] * self._rows, *obs.shape[2:])
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
        return self._seen(obs, info), reward, done | begun, infos

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


def save(model: BaseAlgorithm, file: str | os.PathLike[str]) -> None:
    """Saves a model with the options of its :class:`RoutingVecEnv`, for :class:`Policy`.

    If the environment is wrapped in SB3's ``VecNormalize``, its statistics are saved as well. What
    the training took includes what a loaded model had taken before.

    Raises:
        InputError: it has another environment, or none.
    """
    env = model.get_env()
    routing = env is not None and isinstance(env.unwrapped, RoutingVecEnv)
    check("model", routing, "one with a RoutingVecEnv")
    taken: Training = cast(VecEnv, env).get_attr("taken")[0]
    kind = type(model)
    normalise = model.get_vec_normalize_env()
    taken.continues(vars(model).get("routing", {}).get("training", {}))
    vars(model)["routing"] = {
        **taken.saved(),
        "kind": f"{kind.__module__}:{kind.__qualname__}",
        "normalise": normalise,
    }
    model.save(file)


class Policy:
    """A model that :func:`save` has saved, without exploration.

    Args:
        file: the model.
        teacher: whether it learned from something with sight of the whole problem; None: not known.

    Attributes:
        options, training, parameters, obs_shape: see :mod:`policies.experiment.played`.

    Raises:
        InputError: the file cannot be read, or is another one.
    """

    def __init__(self, file: str, teacher: bool | None = None) -> None:
        with naming(file, "cannot be read"):
            data, _, _ = load_from_zip_file(file, device="cpu")
        known = None if data is None else data.get("routing")
        check(file, known is not None, "a model that policies.integrations.sb3.save has saved")
        kept: dict[str, Any] = known or {}
        self._model = pkgutil.resolve_name(kept["kind"]).load(file, device="cpu")
        self._normalise = kept["normalise"]
        self._masks = "action_masks" in inspect.signature(self._model.predict).parameters
        self.options, self.training = kept["options"], {**kept["training"], "teacher": teacher}
        self.parameters = sum(one.numel() for one in self._model.policy.parameters())
        self.obs_shape = self._model.observation_space.shape

    def moves(
        self, observations: NDArray[np.float32], masks: NDArray[np.int8]
    ) -> NDArray[np.integer]:
        """(B,) moves for observations (B, *S) and masks (B, A)."""
        if self._normalise is not None:
            observations = self._normalise.normalize_obs(observations)
        masked = {"action_masks": masks > 0} if self._masks else {}
        moves, _ = self._model.predict(observations, deterministic=True, **masked)
        return np.asarray(moves)
