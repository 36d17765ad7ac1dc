"""BenchMARL: the environment as a task, for every algorithm that takes discrete moves.

::

    from benchmarl.algorithms import IppoConfig
    from policies.integrations.benchmarl import RoutingTask

    task = RoutingTask.TOY_4X4.get_task({"scenario": "toy-4x4-v0", "reward": "normalised"})
    task = RoutingTask.TOY_4X4.get_from_yaml("configs/benchmarl/toy_4x4.yaml")

The configuration of a task holds the arguments of :class:`marouting.vector.BatchEnv`, and
``max_cycles``: after so many steps a game has ended.
"""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from benchmarl.environments.common import Task, TaskClass
from benchmarl.experiment import Experiment
from numpy.typing import NDArray
from tensordict import TensorDict
from torchrl.data import Composite
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from policies.integrations.torchrl import GROUP, RoutingEnv


class RoutingClass(TaskClass):
    """Global routing: every net is an agent of one group, and all share one capacity grid."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Makes so many games, side by side in one environment."""
        del continuous_actions
        config = copy.deepcopy(self.config)
        config.pop("max_cycles")
        if seed is not None:
            config["seed"] = seed
        return lambda: RoutingEnv(num_envs, state=True, device=device, **config)

    def supports_continuous_actions(self) -> bool:
        """Moves are discrete."""
        return False

    def supports_discrete_actions(self) -> bool:
        """Moves are discrete."""
        return True

    def has_render(self, env: EnvBase) -> bool:
        """There are no pictures of many games."""
        del env
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Steps after which a game has ended."""
        del env
        steps: int = self.config["max_cycles"]
        return steps

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """The agents of the group."""
        groups: dict[str, list[str]] = env.group_map
        return groups

    def observation_spec(self, env: EnvBase) -> Composite:
        """What agents see."""
        return _part(env, GROUP, "observation")

    def action_mask_spec(self, env: EnvBase) -> Composite:
        """Which moves cross an edge."""
        return _part(env, GROUP, "action_mask")

    def info_spec(self, env: EnvBase) -> Composite | None:
        """The figures in ``info`` are of the game, not of agents."""
        del env
        return None

    def state_spec(self, env: EnvBase) -> Composite:
        """The global state."""
        return Composite({"state": env.full_observation_spec_unbatched["state"].clone()})

    def action_spec(self, env: EnvBase) -> Composite:
        """The moves."""
        return env.full_action_spec_unbatched

    @staticmethod
    def env_name() -> str:
        """The name of the environment in results."""
        return "marouting"

    @staticmethod
    def log_info(batch: Any) -> dict[str, float]:
        """The share of the tasks that were joined in games that ended, for BenchMARL's loggers."""
        over = batch["next", "done"]
        if not over.any():
            return {}
        shown = {key: batch["next", "info", key][over] for key in ("joined", "overflow")}
        return {f"collection/info/{key}": value.mean().item() for key, value in shown.items()}


class RoutingTask(Task):
    """Tasks after the scenarios whose figures are known; any other configuration fits as well."""

    TOY_4X4 = None
    TWO_PIN_8X8 = None
    MULTI_PIN_8X8 = None
    COOPERATION = None

    @staticmethod
    def associated_class() -> type[RoutingClass]:
        """The class of these tasks."""
        return RoutingClass


def _part(env: EnvBase, group: str, key: str) -> Composite:
    """One key of what a group sees."""
    specs = env.full_observation_spec_unbatched[group]
    part = specs.clone()
    for other in list(specs.keys()):
        if other != key:
            del part[other]
    return Composite({group: part})


class Moves:
    """The moves of a trained policy without exploration, for :func:`marouting.evaluate_policy`.

    Args:
        experiment: what trained it.

    Attributes:
        parameters: of its network.
    """

    def __init__(self, experiment: Experiment) -> None:
        self._policy = experiment.algorithm.get_policy_for_collection()
        self._agents = len(experiment.group_map[GROUP])
        self.parameters = sum(one.numel() for one in self._policy.parameters())

    def __call__(self, observations: NDArray[np.float32], masks: NDArray[np.int8]) -> Any:
        """(B,) moves for (B, *S) observations and (B, A) masks, N of which are a game of its."""
        rows, n = len(observations), self._agents
        games = -(-rows // n)
        seen = np.zeros((games * n, *observations.shape[1:]), np.float32)
        free = np.ones((games * n, masks.shape[1]), np.bool_)
        seen[:rows], free[:rows] = observations, masks > 0
        group = {
            "observation": torch.from_numpy(seen).unflatten(0, (games, n)),
            "action_mask": torch.from_numpy(free).unflatten(0, (games, n)),
        }
        told = TensorDict({GROUP: TensorDict(group, [games, n])}, [games])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return self._policy(told)[GROUP, "action"].flatten()[:rows].numpy()
