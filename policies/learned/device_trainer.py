"""A training whose games, rollouts, networks and updates are all on a CUDA device.

It stands in for :class:`policies.learned.trainer.Trainer` where ``train.device`` is ``cuda`` and
games draw their problems for a learner of the PPO family. The configuration is the same; rollouts
are at least :data:`STEPS` steps of all games (:mod:`policies.learned.on_device`). Of every rollout
one episode is logged, since there may be thousands.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from marouting import InputError, Problem, Solution
from marouting.config import allowing_code_of, check, plain
from marouting.cuda.env import CudaBatchEnv, unsupported
from marouting.options import ORDERS, PLAYED
from marouting.source import ProblemStream
from marouting.vector import BatchEnv
from policies.learned.algorithms.ppo import IPPO, MAPPO, PPO
from policies.learned.checkpoint import ANY, FINITE, TRAINING_FORMAT, checked
from policies.learned.config import Config
from policies.learned.learner import play_steps
from policies.learned.on_device import DevicePPO
from policies.learned.policy import TrainedPolicy, player_of
from policies.learned.saved import SavedNetworks
from policies.results.run_folder import Episode, GreedyEvaluation

STEPS = 32
"""The fewest steps of all games between updates."""


def on_device(config: Config) -> bool:
    """Whether the whole training is on the device, and not just the networks."""
    train, env = config.train, config.env
    # A learner derived from these may do anything.
    known = config.learner.cls in (PPO, IPPO, MAPPO) and env.agents == "multi"
    known &= train.games is not None and env.message_bits == 0
    if not (known and train.device.startswith("cuda")):
        return False
    return not any(unsupported(env.observation.make(), env.reward.make()))


class DeviceTrainer:
    """Trains one network on problems that games draw; see :class:`.trainer.Trainer`.

    Args:
        problems: those that the network is evaluated on, by name.
        config: what to do.
        episodes: what the games draw theirs from.

    Attributes:
        names: the names of ``problems``.
        episodes: (1,) int64, episodes finished.
        steps: (1,) int64, moves of agents that have been learned from.
        evaluations: the evaluations made since :meth:`run` last yielded.
        saved: the network that is saved.
        backend: what computes the training, in words.

    Raises:
        InputError: there is no device, or an option is not supported on it.
    """

    drawn = True
    replayed: tuple[()] = ()

    def __init__(
        self, problems: Mapping[str, Problem], config: Config, episodes: ProblemStream
    ) -> None:
        self.config, self.problems, self.names = config, dict(problems), tuple(problems)
        train, options = config.train, config.learner.options
        one = "cuda, where games are on it too: CUDA_VISIBLE_DEVICES says which"
        check("train.device", train.device == "cuda", f"{one}, found {train.device}")
        check("train.negotiation", train.negotiation is None, "null on a device")
        env = plain(config.env)
        for name in (*PLAYED, "agents", "agents_persist", "render_mode"):
            del env[name]
        env["turn_order"] = config.env.turn_order or ORDERS["multi"]
        env["mask"] = {"visited": config.env.mask.visited}
        source: Any = episodes
        with allowing_code_of(config):
            self.env = BatchEnv(
                train.games or 1, problem=source, device="cuda", seed=config.seed, **env
            )
        assert isinstance(self.env, CudaBatchEnv)
        self.backend = f"torch and games on {train.device}"
        rows = self.env.num_problems * self.env.num_agents
        observation = config.env.observation.make()
        steps = max(STEPS, round(options.rollout / rows))
        with _computing():
            self.ppo = DevicePPO(self.env, observation, options, steps=steps, seed=config.seed)
        self.episodes, self.steps, self._evaluated = np.zeros((3, 1), np.int64)
        self.spent = 0.0  # share of train.seconds that has passed, by the clock of a run
        self.clock: Callable[[], float] = float
        self.best_episode = np.zeros(0, np.int64)
        self.evaluations: list[GreedyEvaluation] = []
        shape, actions = self.env.single_observation_space.shape, self.env.single_action_space.n
        flat = self._weights()[None]
        self.saved = SavedNetworks(config, ("all",), shape or (), int(actions), flat)

    # --- what is to be done -------------------------------------------------------------------

    @property
    def running(self) -> NDArray[np.bool_]:
        """(1,) whether there is more to train."""
        return np.array([self._share() < 1])

    def _share(self) -> float:
        """The share of the training that is done."""
        train = self.config.train
        share = int(self.episodes[0]) / train.episodes
        made = int(self.steps[0]) / train.steps if train.steps else 0.0
        return max(share, made, self.spent)

    @property
    def updates(self) -> NDArray[np.int64]:
        """(1,) updates of the network so far."""
        return np.array([self.ppo.updates], np.int64)

    def run(self) -> Iterator[list[Episode]]:
        """Trains to the end; after every rollout, yields one of the episodes that ended."""
        if not self.steps[0]:
            for weights in self.saved.start():
                self.ppo.actor.load_state_dict(weights)
            self.saved.flat[0] = self._weights()
        while self.running[0]:
            self.ppo.progress = self._share()
            with _computing():
                progress = self.ppo.iterate()
            self.steps += progress.steps
            self.episodes += progress.episodes
            episode = self._sample(progress.loss)
            self.spent = self.clock()
            self._evaluate()
            yield episode

    def _sample(self, loss: float) -> list[Episode]:
        """An episode that has ended in the last step; none if none has."""
        over = np.flatnonzero(self.ppo.over[-1].cpu().numpy())
        if not len(over):
            return []
        m = int(over[0])
        env: Any = self.env
        name, metrics, reward = env.ended(m)
        return [
            Episode(
                problem=name, episode=max(int(self.episodes[0]) - 1, 0), reward=reward, epsilon=0.0,
                loss=loss, updates=self.ppo.updates, best=False, **asdict(metrics),
            )
        ]  # fmt: skip

    # --- evaluation ---------------------------------------------------------------------------

    def _evaluate(self) -> None:
        """Has the network play the validation problems, if that is due, and keeps the best."""
        self.evaluations = []
        due = self.episodes[0] >= self._evaluated[0] + self._every or not self.running[0]
        if not due:
            return
        self._evaluated[:] = self.episodes
        weights = self._weights()
        module = self.saved.module(weights)
        player = player_of(self.config.env, list(self.problems.values()))
        player.reset()
        masking = self.config.learner.options.masking
        for _ in play_steps(player, lambda seen: module(seen[0])[None], masking=masking):
            pass
        played = int(self.episodes[0])
        found = {name: (played, player.engine.metrics(m)) for m, name in enumerate(self.names)}
        self.evaluations = self.saved.judge(0, weights, played, int(self.steps[0]), found)

    @property
    def _every(self) -> int:
        """Episodes between evaluations; there are about 50 at most, since they take a while."""
        train, done = self.config.train, self._share()
        whole = int(self.episodes[0]) / done if done else 0
        return max(train.evaluate_every, round(whole / 50))

    def _weights(self) -> Tensor:
        """The actor's weights, a copy on the processor."""
        flat = nn.utils.parameters_to_vector(self.ppo.actor.parameters())
        return flat.detach().cpu().clone()

    # --- results ------------------------------------------------------------------------------

    def origin(self, problem: str) -> str:
        """Which episode a problem's solution is from: there are no solutions."""
        raise KeyError(problem)

    def solutions(self) -> dict[str, Solution]:
        """None: every episode plays another problem."""
        return {}

    def policy_of(self, problem: str) -> TrainedPolicy:
        """The saved network: that of the best evaluation, or of the last."""
        del problem
        return self.saved.policy(0)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """What changes in training but the learner and the games; to copy from or into."""
        own = {name: getattr(self, name) for name in ("episodes", "steps", "_evaluated")}
        return {**own, **self.saved.arrays()}

    def state(self) -> dict[str, Any]:
        """Everything that it takes to go on."""
        return {
            **self.saved.state(),
            "format": TRAINING_FORMAT,
            "problems": list(self.names),
            "in_all": self.config.train.episodes,
            "trainer": {name: torch.from_numpy(a.copy()) for name, a in self._arrays().items()},
            "training": self.ppo.state(),
            "device": True,
        }

    def load_state(self, state: Mapping[str, Any], where: str) -> None:
        """Goes back to what :meth:`state` gave; raises InputError if it is of another training."""
        fits = state.get("device") is True and state["problems"] == list(self.names)
        if not fits:
            raise InputError(f"{where}: expected a training on a device, of these problems")
        kept = state["trainer"]
        for name, own in self._arrays().items():
            now, limits = torch.from_numpy(own), ANY if name == "policy_score" else FINITE
            now.copy_(checked(kept[name], now, f"{where}: {name}", limits))
        self.ppo.load_state(state["training"], where)


@contextlib.contextmanager
def _computing() -> Iterator[None]:
    """Multiplies matrices in TensorFloat-32, at several times the speed.

    Raises:
        InputError: torch finds too little memory on the device.
    """
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high")
    try:
        yield
    except torch.OutOfMemoryError as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"device: expected more memory for these games: {reason}") from None
    finally:
        torch.set_float32_matmul_precision(precision)
