"""Learners as routers of problems."""

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from marouting import Problem, Solution
from policies.learned.config import Config
from policies.learned.policy import Routed, TrainedPolicy
from policies.learned.trainer import Trainer
from policies.results.run_folder import Episode


class LearnedRouter:
    """Routes a problem with a learner: a trained policy, or one trained on the problem (the paper).

    Args:
        config: what to train; its ``env.problem`` and ``out`` do not matter here.
        checkpoint: a trained policy to use; None: train on every problem.
        watch: called with the episodes of a training as they end.
        network: the problem whose network to take from a file that holds several.
    """

    def __init__(
        self,
        config: Config | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        watch: Callable[[list[Episode]], Any] | None = None,
        network: str | None = None,
    ) -> None:
        self.config = config or Config()
        self.policy = None if checkpoint is None else TrainedPolicy.load(checkpoint, network)
        self._watch = watch

    def route(self, problem: Problem) -> Solution:
        """The best routes of a training, or those that the trained policy walks."""
        return self.solve(problem).solution

    def warm_up(self, problem: Problem) -> None:
        """Gets ready for :meth:`route` at less cost; see :func:`policies.routers.base.warm_up`."""
        if self.policy is not None:
            self.policy.solve(problem)
            return
        train = replace(self.config.train, episodes=2)
        LearnedRouter(replace(self.config, train=train)).solve(problem)

    def solve(self, problem: Problem) -> Routed:
        """The same, and which episode or policy they are from."""
        if self.policy is not None:
            return self.policy.solve(problem)
        config = replace(self.config, train=replace(self.config.train, tensorboard=False))
        trainer = Trainer({"problem": problem}, config)
        for episodes in trainer.run():
            if episodes and self._watch is not None:
                self._watch(episodes)
        return Routed(trainer.solutions()["problem"], {"from": trainer.origin("problem")})
