"""BenchMARL: the environment as a task, for every algorithm that takes discrete moves.

::

    from benchmarl.algorithms import IppoConfig
    from policies.integrations.benchmarl import RoutingTask

    task = RoutingTask.TOY_4X4.get_task({"scenario": "toy-4x4-v0", "max_cycles": 50})
    task = RoutingTask.TOY_4X4.get_from_yaml("configs/benchmarl/toy_4x4.yaml")

The configuration of a task holds the arguments of :class:`marouting.vector.BatchEnv`, the scenario
or problem among them, and ``max_cycles``: after so many steps every game has ended. The name of the
task only names its results.

A checkpoint is scored by ``marouting benchmark --router 'policies.integrations.benchmarl:Policy
file=…/checkpoints/checkpoint_N.pt'``. To load one runs the code that it holds.
"""

import contextlib
import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarl.environments.common import Task, TaskClass
from benchmarl.experiment import Experiment
from torchrl.data import Composite
from torchrl.envs import EnvBase

from marouting.config import build_json, check
from marouting.files import naming, read_text
from policies.integrations.saved import Training, another
from policies.integrations.torchrl import GROUP, GroupMoves, RoutingEnv

ROW = "row.json"
"""In the run folder of :mod:`.value_decomposition`: what its training took."""

_MOST_BYTES = 2**24

_OF_THE_TASK = ("max_cycles", "shared")
"""Keys of a task that are no options of its environment."""


class RoutingClass(TaskClass):
    """Global routing: every net is an agent of one group, and all share one capacity grid."""

    @staticmethod
    def of(config: dict[str, Any]) -> "RoutingClass":
        """A task of a scenario, named after it."""
        return RoutingClass(name=config["scenario"].replace("-", "_").upper(), config=config)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Makes so many games, side by side in one environment."""
        del continuous_actions
        config = copy.deepcopy(self.config)
        what = "the number of steps after which every game has ended"
        check("max_cycles", config.pop("max_cycles", None), what)
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


class Moves(GroupMoves):
    """The moves of the policy of an experiment, without exploration."""

    def __init__(self, experiment: Experiment) -> None:
        policy = experiment.algorithm.get_policy_for_collection()
        super().__init__(policy, len(experiment.group_map[GROUP]))


class Policy(Moves):
    """The policy in a checkpoint of BenchMARL, with the options of its task.

    Args:
        file: the checkpoint, as BenchMARL lays it down: in ``checkpoints`` of its run folder.
        agent_steps, processor_seconds: what its training took; None: what
            :mod:`.value_decomposition` has written in the run folder, or not known.
        teacher: whether it learned from something with sight of the whole problem; None: not known.

    Attributes:
        options, training, obs_shape: see :mod:`policies.experiment.played`.

    Raises:
        InputError: it cannot be read, or is of another task.
    """

    def __init__(
        self,
        file: str,
        agent_steps: int | None = None,
        processor_seconds: float | None = None,
        teacher: bool | None = None,
    ) -> None:
        known = Path(file).parent.parent / "config.pkl"
        for one in (file, known):
            with naming(one, "cannot be read"):
                Path(one).open("rb").close()
        # Without ``save_folder`` the file's own folder counts, wherever it has been moved to.
        changes = {"loggers": [], "evaluation": False, "save_folder": None}
        try:
            with contextlib.redirect_stdout(None):
                experiment = Experiment.reload_from_file(file, changes)
        except Exception as error:  # other files fail in the archive, in the unpickler or later
            raise another(file, f"a checkpoint of BenchMARL, as {known} has it", error) from None
        experiment.close()
        fits = isinstance(experiment.task, RoutingClass)
        check(file, fits, f"a checkpoint of a task of {__name__}")
        super().__init__(experiment)
        config = experiment.task.config
        task = {key: value for key, value in config.items() if key not in _OF_THE_TASK}
        self.options = Training(task).options
        took = {"agent_steps": agent_steps, "processor_seconds": processor_seconds}
        if (row := known.with_name(ROW)).exists():  # without a teacher
            known_row = build_json(dict[str, Any], read_text(row, _MOST_BYTES), str(row))
            took = {key: known_row.get(key) if n is None else n for key, n in took.items()}
            teacher = bool(teacher)
        self.training = {**took, "teacher": teacher}
        self.obs_shape = tuple(experiment.observation_spec[GROUP, "observation"].shape[1:])
