"""What a training saves of its networks: those of the best evaluation, or of the last."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, nn

from marouting import InputError
from marouting.batch.engine import Metrics
from marouting.config import allowing_code_of, check, plain
from marouting.options import PLAYED
from policies.generalist import SHIPPED
from policies.learned.checkpoint import POLICY_FORMAT
from policies.learned.config import Config
from policies.learned.policy import TrainedPolicy, check_weights, policy_origin
from policies.results.run_folder import GreedyEvaluation, policy_file

_SHIPPED = "generalist"
"""What ``train.start`` calls the weights that are shipped."""


class SavedNetworks:
    """The networks that a training has saved so far, at first those that it begins with.

    Args:
        config: what to do.
        names: names of the networks.
        obs_shape: of what one agent sees.
        actions: how many actions an agent has.
        flat: (L, P) float32, their weights.

    Attributes:
        flat: (L, P) float32, the weights of the saved ones, on the processor.
        score: (L, 3) what the best evaluation of each found: less is better.
        episodes: (L,) int64, after how many the saved ones were evaluated.
    """

    def __init__(
        self,
        config: Config,
        names: Sequence[str],
        obs_shape: tuple[int, ...],
        actions: int,
        flat: Tensor,
    ) -> None:
        self._config, self._names = config, names
        self._obs_shape, self._actions = obs_shape, actions
        self.flat = flat.detach().cpu().clone()
        self.score = np.full((len(flat), 3), np.inf)
        self.episodes = np.zeros(len(flat), np.int64)

    def arrays(self) -> dict[str, Any]:
        """What changes, by its name in checkpoints; to copy from or into."""
        return {
            "policies": self.flat.numpy(),
            "policy_score": self.score,
            "policy_episode": self.episodes,
        }

    def judge(
        self,
        row: int,
        weights: Tensor,
        episodes: int,
        agent_steps: int,
        found: Mapping[str, tuple[int, Metrics]],
    ) -> list[GreedyEvaluation]:
        """Saves a network if it is to be; returns its evaluations.

        Args:
            row: which network.
            weights: (P,) its weights now.
            episodes: after how many it was evaluated.
            agent_steps: for how many it had been trained.
            found: by the problem's name, its episodes and how the network has played it.
        """
        scores = [routes_score(metrics) for _, metrics in found.values()]
        score = tuple(np.sum(scores, axis=0).tolist())
        best = score < tuple(self.score[row].tolist())
        if best:
            self.score[row] = score
        if best or self._config.train.policy == "last":
            self.episodes[row] = episodes
            self.flat[row] = weights.detach().cpu()
        return [
            GreedyEvaluation(name, played, agent_steps, best=best, **asdict(metrics))
            for name, (played, metrics) in found.items()
        ]

    def start(self) -> list[Mapping[str, Tensor]]:
        """The weights that the networks begin with; none if they are random.

        Raises:
            InputError: the file that holds them cannot be used.
        """
        config = self._config
        if config.train.start is None:
            return []
        start = config.train.start
        path = SHIPPED if start == _SHIPPED else policy_file(Path(start)) or start
        network = self._network()
        weights: list[Mapping[str, Tensor]] = []
        for name in self._names:
            with allowing_code_of(config):
                policy = TrainedPolicy.load(path, name)
            expected, found = plain(config.env.observation), plain(policy.env.observation)
            what = f"networks that see {expected}, found {found} in {path}"
            check("train.start", found == expected, what)
            expected = plain(getattr(config.learner.options, "network", None))
            what = f"networks {expected}, found {policy.network} in {path}"
            check("train.start", policy.network == expected, what)
            weights.append(policy.module.state_dict())
            try:
                check_weights(weights[-1], network)
            except InputError as error:
                raise InputError(f"train.start: {path}: {error}") from None
        return weights

    def policy(self, row: int) -> TrainedPolicy:
        """A saved network that plays."""
        config = self._config
        return TrainedPolicy(
            self.module(self.flat[row].clone()),
            config.learner.cls.masks(config.learner.options),
            self._obs_shape,
            config.env,
            policy_origin(int(self.episodes[row])),
            config.train.negotiation,
        )

    def state(self) -> dict[str, Any]:
        """What it takes to play with the saved networks: plain data and tensors."""
        env = plain(self._config.env)
        for name in PLAYED:
            del env[name]
        why = "finite weights, found others: see the observations, or lower learner.learning_rate"
        check("learner.network", all(bool(row.isfinite().all()) for row in self.flat), why)
        return {
            "format": POLICY_FORMAT,
            "names": list(self._names),
            "episodes": self.episodes.tolist(),
            "learner": plain(self._config.learner),
            "obs_shape": list(self._obs_shape),
            "env": env,
            "negotiation": plain(self._config.train.negotiation),
            "weights": [
                {name: tensor.detach() for name, tensor in self.module(row).state_dict().items()}
                for row in self.flat
            ],
        }

    def module(self, flat: Tensor) -> nn.Module:
        """A network with the weights (P,)."""
        module = self._network()
        nn.utils.vector_to_parameters(flat, module.parameters())
        return module

    def _network(self) -> nn.Module:
        learner = self._config.learner
        module: nn.Module = learner.cls.network(learner.options, self._obs_shape, self._actions)
        return module


def routes_score(metrics: Metrics) -> tuple[float, ...]:
    """What makes routes better: less is better."""
    return metrics.tasks - metrics.joined, metrics.overflow, metrics.wirelength
