"""An own algorithm in one file: expected SARSA, on line, without a memory or a target network.

A learner is a subclass of ``policies.learned.learner.Learner``. It has a stack of networks, one per
problem, plays the player that it is given, and learns from the player's step buffers; trainings,
checkpoints, evaluation and tables come with it. In a training's YAML::

    learner: {kind: "own_algorithm:ExpectedSarsa", gamma: 0.9}
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch

import marouting
from marouting.config import Component, build, check, component_field, take_components
from marouting.game import Ending
from policies.cli.tables import show
from policies.learned.config import Config
from policies.learned.exploration import Exploration
from policies.learned.learner import Learner
from policies.learned.memory.pre_step import PreStep
from policies.learned.networks.adam import Adam
from policies.learned.networks.stack import Stack
from policies.learned.run import Run


@dataclass(frozen=True, kw_only=True)
class SarsaOptions:
    """What expected SARSA is told."""

    # The trainer knows these three names.
    network: Component = component_field("network", "mlp")
    masking: bool = True  # whether only moves that cross an edge are chosen
    num_envs: int = 8  # games of every problem that are played side by side
    gamma: float = 0.95
    epsilon: float = 0.05  # the chance of a random move
    learning_rate: float = 1e-3

    def __post_init__(self) -> None:
        take_components(self)
        check("gamma", 0 <= self.gamma <= 1, "a number from 0 to 1")


class ExpectedSarsa(Learner):
    """Every step of all games of a network is one gradient step."""

    Options = SarsaOptions
    # What has a row per network: checkpoints keep it, and it leaves with a network that is done.
    parts: ClassVar[tuple[str, ...]] = ("networks", "adam", "explore")
    path = "expected SARSA in torch"

    def __init__(self, setup, options):
        super().__init__(setup, options)
        seeds = setup.network_keys("weights").astype(np.int64).tolist()
        self.networks = Stack(lambda: self.network(options, setup.obs_shape), seeds, self.device)
        self.adam = Adam(self.networks.flat)
        self.explore = Exploration(setup.game_keys("explore"))
        self.explore.epsilon[:] = options.epsilon

    def exploration(self, episode):  # noqa: ARG002
        """The chance of a random move, for logs."""
        return self.options.epsilon

    def play(self, player, steps):
        """Acts and learns for some steps, or until an episode ends."""
        now = player.buffers  # (M, K, …): M games, K rows each
        for _ in range(steps):
            before = PreStep.of(player)
            with torch.no_grad():
                values = self.networks.view(self._stacked(before.obs)).cpu().numpy()
            values = values.reshape(now.mask.shape)
            self.explore.epsilon_greedy(now, values, self.options.masking)
            player.step()
            self._learn(before, now)
            if now.over.any():
                return

    def _stacked(self, array):
        """(L, B, …) the rows of each network's games, from (M, K, …)."""
        rows = array.reshape(len(self.updates), -1, *array.shape[2:])
        return torch.from_numpy(rows).to(self.device)

    def _learn(self, before, now):
        """One gradient step of every network in whose games somebody moved."""
        o = self.options
        seen, mask = now.obs.copy(), now.mask.copy()
        # Where a task has ended, or the turn has passed, the row shows something else by now.
        past = (now.ending != Ending.NONE) | (now.agents != before.agents)
        seen[past], mask[past] = now.final_obs[past], now.final_mask[past]
        if not o.masking:
            mask[:] = 1
        # A task that was joined is over; one that failed only ran out of steps.
        goes_on, acted = self._stacked(now.ending != Ending.JOINED), self._stacked(now.acted)
        with torch.no_grad():
            values, mask = self.networks.view(self._stacked(seen)), self._stacked(mask)
            best = values.masked_fill(mask == 0, -torch.inf).amax(dim=2)
            mean = (values * mask).sum(dim=2) / mask.sum(dim=2)
            expected = (1 - o.epsilon) * best + o.epsilon * mean
            wanted = self._stacked(now.reward) + o.gamma * goes_on * expected
        actions = self._stacked(now.actions.clip(0)).long()
        value = self.networks.view(self._stacked(before.obs)).gather(2, actions[..., None])[..., 0]
        moves = acted.sum(dim=1)
        loss = ((value - wanted).square() * acted).sum(dim=1) / moves.clamp(min=1)  # (L,)
        gradient = torch.empty_like(self.networks.flat)
        self.networks.view.gradient(loss.sum(), gradient)
        due = (moves > 0).float()[:, None]
        self.adam.step(self.networks.flat, gradient, due, o.learning_rate)
        self.updates += due[:, 0].long().cpu().numpy()
        self.loss += loss.detach().double()


if __name__ == "__main__":
    marouting.register("learner", "sarsa", ExpectedSarsa)  # or "own_algorithm:ExpectedSarsa"
    config = build(
        Config,
        {
            "out": "own_algorithm",
            "env": {
                "agents": "multi",
                "problem": {"count": 2, "nets": 8, "seed": 1, "reduced_edges": 0},
            },
            "learner": {"kind": "sarsa"},
            "train": {"episodes": 600, "figures": False, "tensorboard": False},
        },
    )
    run = Run(config)
    print("learner:", run.trainer.learner.backend)
    joined = []
    rows = run.execute(lambda episodes: joined.extend(e.joined / e.tasks for e in episodes))
    first, last = np.mean(joined[:100]), np.mean(joined[-100:])
    print(f"joined: {first:.2f} in the first 100 episodes, {last:.2f} in the last 100")
    show(rows, "own_algorithm")
