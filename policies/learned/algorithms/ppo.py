"""Proximal policy optimisation (Schulman et al., 2017), with one actor for all agents.

With ``critic: local`` the critic sees what the agent sees; with ``critic: central`` it also sees
the game's global state. Where every net is an agent, the first is IPPO (de Witt et al., 2020), the
second MAPPO (Yu et al., 2022), both with one actor for all agents as in these papers.

Deviations from the papers and from CleanRL's implementation:

* A task is an agent's episode: the sum of rewards ends where a task is joined. A task that failed
  only ran out of steps, and is bootstrapped from, unless ``final_failures`` says otherwise.
* What an agent is paid once it is done counts as paid with its last move.
* Rollouts are counted in transitions, not in steps: agents finish at different times.
* Rewards are multiplied by ``reward_scale``, and no values are normalised or clipped.
* Actor and critic are two networks with an optimiser each; there is no annealing but the linear one
  of the learning rate.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting.checks import check_fields
from marouting.config import MOST, Component, check, component_field, take_components
from marouting.game import Ending
from marouting.observations import state_of
from marouting.player import Player
from policies.learned.exploration import Exploration
from policies.learned.learner import Learner, Setup, by_network
from policies.learned.memory.pre_step import PreStep
from policies.learned.memory.rollout import LONGEST, Rollout, shuffled
from policies.learned.networks.adam import Adam
from policies.learned.networks.stack import View


@dataclass(frozen=True, kw_only=True)
class PPOOptions:
    """The options of PPO.

    Attributes:
        network: of the actor, which has an output for each action; the critic is a second one with
            a single output. By default a multilayer perceptron with two layers of 64.
        critic: ``local``, it sees what the agent sees, or ``central``, the game's state as well.
        num_envs: games of every problem that are played side by side.
        gamma: discount factor.
        gae_lambda: λ of the advantage estimates; 0 uses only the critic, 1 only the rewards.
        learning_rate: of Adam.
        anneal: whether the learning rate falls to 0, linearly, with the last episode.
        rollout: transitions between updates.
        minibatch: transitions of a gradient step; a divisor of ``rollout``.
        epochs: how often each transition is learned from.
        clip: ε, how far the ratio of an action's new and old probability may be from 1 before it is
            clipped.
        entropy: weight of the policy's entropy in the loss, which keeps it from settling too soon.
        reward_scale: factor of all rewards: the critic learns numbers of the order of 1.
        max_gradient: length that longer gradients are cut to.
        masking: whether only moves that cross an edge are chosen.
        final_failures: whether a failed task ends the sum of rewards, as a joined one does: for
            games in which the limit of steps is part of what is to be learned (Pardo et al., 2018).
    """

    network: Component = component_field("network", "mlp", hidden=(64, 64))
    critic: Literal["local", "central"] = "local"
    num_envs: int = 32
    gamma: float = 0.95
    gae_lambda: float = 0.9
    learning_rate: float = 1e-3
    anneal: bool = True
    rollout: int = 16384
    minibatch: int = 2048
    epochs: int = 2
    clip: float = 0.2
    entropy: float = 0.01
    reward_scale: float = 0.05
    max_gradient: float = 0.5
    masking: bool = True
    final_failures: bool = False

    def __post_init__(self) -> None:
        take_components(self)
        bounds = dict.fromkeys(("gamma", "gae_lambda"), (0, 1))
        bounds |= {"num_envs": (1, 65536), "minibatch": (2, MOST), "epochs": (1, 1000)}
        check_fields(self, entropy=(0, math.inf), rollout=(1, LONGEST), **bounds)
        what = f"a multiple of minibatch, {self.minibatch}, found {self.rollout}"
        check("rollout", self.rollout % self.minibatch == 0, what)
        for name in ("learning_rate", "clip", "reward_scale", "max_gradient"):
            check(name, getattr(self, name) > 0, "a number above 0")


class PPO(Learner):
    """PPO in torch, on any device, for any network, observation and reward."""

    Options: ClassVar[type[PPOOptions]] = PPOOptions
    endless: ClassVar[Mapping[str, Any]] = {
        "network": {"kind": "mlp", "hidden": [128, 128]},
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "rollout": 8192,
        "minibatch": 1024,
        "epochs": 4,
        "entropy": 0.03,
        "final_failures": True,
    }
    rows: ClassVar[tuple[str, ...]] = (*Learner.rows, "keys", "progress")
    parts: ClassVar[tuple[str, ...]] = (
        "networks", "critic", "adam", "critic_adam", "rollout", "explore",
    )  # fmt: skip

    def __init__(self, setup: Setup, options: PPOOptions) -> None:
        super().__init__(setup, options)
        o, count, player = options, len(setup.names), setup.player
        check(
            "env.turn_order",
            player.everyone or player.engine.static.sequential,
            "sequential, for ppo with agents: single",
        )
        self.central = o.critic == "central"
        check(
            "learner.critic",
            not self.central or setup.state_shape,
            "local: there is no global state",
        )
        features = int(np.prod(setup.obs_shape)) + int(np.prod(setup.state_shape))
        sees = (features,) if self.central else setup.obs_shape
        self.backend = f"torch, batched on {setup.device}"
        self.networks = self._stack("weights", setup.obs_shape, setup.actions)
        self.critic = self._stack("critic", sees, 1)
        self.adam = Adam(self.networks.flat, eps=1e-5)
        self.critic_adam = Adam(self.critic.flat, eps=1e-5)
        self.rollout = Rollout(
            count, o.rollout, setup.games // count, setup.rows, player.engine.nets.shape[1],
            setup.actions, setup.obs_shape, setup.state_shape if self.central else (),
            o.reward_scale,
            late=setup.pays_late,
        )  # fmt: skip
        self.explore = Exploration(setup.game_keys("explore"))
        self.keys = setup.network_keys("sample")
        self.progress = np.zeros(count)  # episodes played, as a share of all

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "progress": (0.0, 1.0)}

    def set_episodes(self, episodes: NDArray[np.int64]) -> None:
        """See :meth:`policies.learned.learner.Learner.set_episodes`."""
        self.progress[:] = self._games(episodes).mean(axis=1) / self.setup.episodes

    # --- play ---------------------------------------------------------------------------------

    def play(self, player: Player, steps: int) -> None:
        """See :meth:`policies.learned.learner.Learner.play`."""
        now = player.buffers
        chance = np.zeros(now.acted.shape, np.float32)
        for _ in range(steps):
            before = PreStep.of(player)
            states = self._states(player)
            movers = player.movers
            scores, values = self._look(now.obs, movers, states)
            self.explore.sample(now, movers, scores, self.options.masking, chance)
            player.step()
            failed = now.acted & (now.ending == Ending.FAILED) & (not self.options.final_failures)
            states_after = self._states(player) if failed.any() else None
            final = self._values(now.final_obs, failed, states_after)
            self.rollout.add(before, now, chance, values, final, states)
            while len(full := self.rollout.full()):  # a step of many games may fill several
                self.learn(full, self._values_ahead(player))
            if now.over.any():
                return

    def _states(self, player: Player) -> NDArray[np.float32] | None:
        """(M, …) what the critic sees of the games beside what agents see, if it is central."""
        return state_of(player.observation, player.engine) if self.central else None

    def _look(
        self, obs: NDArray[np.float32], active: NDArray[np.bool_], states: Any
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, K, A) scores of moves and (M, K) values, where agents are active."""
        scores = np.zeros((*active.shape, self.setup.actions), np.float32)
        values = np.zeros(active.shape, np.float32)
        where, inputs, seen = self._gathered(obs, active, states)
        with torch.no_grad():
            scores[active] = self.networks.view(inputs).cpu().numpy()[where]
            values[active] = self.critic.view(seen).cpu().numpy()[where][:, 0]
        return scores, values

    def _values(
        self, obs: NDArray[np.float32], asked: NDArray[np.bool_], states: Any
    ) -> NDArray[np.float32]:
        """(M, K) values, where they are asked for."""
        values = np.zeros(asked.shape, np.float32)
        if asked.any():
            where, _, seen = self._gathered(obs, asked, states)
            with torch.no_grad():
                values[asked] = self.critic.view(seen).cpu().numpy()[where][:, 0]
        return values

    def _gathered(
        self, obs: NDArray[np.float32], asked: NDArray[np.bool_], states: Any
    ) -> tuple[NDArray[np.bool_], Tensor, Tensor]:
        """(L, B) where there is a row, (L, B, *S) what the actor sees, and what the critic does."""
        count = len(self.updates)
        where, inputs = by_network(count, obs, asked)
        actor = critic = torch.from_numpy(inputs).to(self.device)
        if states is not None:
            rows = np.broadcast_to(states[:, None], (*asked.shape, *states.shape[1:]))
            state = torch.from_numpy(by_network(count, rows, asked)[1]).to(self.device)
            critic = torch.cat((state.flatten(2), actor.flatten(2)), dim=2)
        return where, actor, critic

    def _values_ahead(self, player: Player) -> NDArray[np.float32]:
        """(L, streams) what the critic expects of every agent that goes on."""
        now = player.buffers
        values = self._values(now.obs, now.active, self._states(player))
        ahead = np.zeros((len(now.acted), self.rollout.agents), np.float32)
        games, rows = np.nonzero(now.active)
        ahead[games, now.agents[games, rows]] = values[games, rows]
        return self._games(ahead).reshape(len(self.updates), -1)

    # --- learning -----------------------------------------------------------------------------

    def learn(self, which: NDArray[np.int64], ahead: NDArray[np.float32]) -> None:
        """Learns from the rollouts of some networks.

        Args:
            which: (D,) networks.
            ahead: (L, streams) what the critic expects after the rollouts.
        """
        o, rollout = self.options, self.rollout
        advantages, returns = rollout.advantages(which, ahead, o.gamma, o.gae_lambda)
        for i, n in enumerate(which.tolist()):
            batch = {
                name: rollout.tensor(name, n, self.device)
                for name in ("obs", "mask", "action", "chance", "state_")
            }
            batch["advantage"], batch["returns"] = (
                torch.from_numpy(a[i]).to(self.device) for a in (advantages, returns)
            )
            self._learn_one(n, batch)
        rollout.drop(which)

    def _learn_one(self, n: int, batch: dict[str, Tensor]) -> None:
        """The gradient steps of network n on a rollout."""
        o = self.options
        left = max(1 - float(self.progress[n]), 0.0) if o.anneal else 1.0
        due, rate = torch.ones(1, 1, device=self.device), o.learning_rate * left
        actor, critic = (
            (stack.flat[n : n + 1], stack.row(n), adam.part(n))
            for stack, adam in ((self.networks, self.adam), (self.critic, self.critic_adam))
        )
        for _ in range(o.epochs):
            order = torch.from_numpy(shuffled(o.rollout, self.keys[n], self.updates[n]))
            for places in torch.split(order.to(self.device), o.minibatch):
                part = {name: tensor.index_select(0, places) for name, tensor in batch.items()}
                pair = losses(actor[1], critic[1], part, o)
                for loss, (weights, view, adam) in zip(pair, (actor, critic), strict=True):
                    gradient = torch.empty_like(weights)
                    view.gradient(loss, gradient)
                    length = gradient.norm().clamp(min=1e-12)
                    gradient *= (o.max_gradient / length).clamp(max=1)
                    adam.step(weights, gradient, due, rate)
                    self.loss[n] += loss.detach().double()
                self.updates[n] += 1


@dataclass(frozen=True, kw_only=True)
class IPPOOptions(PPOOptions):
    """Those of PPO, with a local critic."""

    critic: Literal["local"] = "local"


class IPPO(PPO):
    """Independent PPO (de Witt et al., 2020): every net is an agent that learns for itself."""

    Options = IPPOOptions
    agents = "multi"


@dataclass(frozen=True, kw_only=True)
class MAPPOOptions(PPOOptions):
    """Those of PPO, with a central critic."""

    critic: Literal["central"] = "central"


class MAPPO(PPO):
    """Multi-agent PPO (Yu et al., 2022): the critic sees the state of the whole game."""

    Options = MAPPOOptions
    agents = "multi"


def losses(
    actor: View, critic: View, part: dict[str, Tensor], o: PPOOptions
) -> tuple[Tensor, Tensor]:
    """The losses of the policy and of the critic on a minibatch of B transitions.

    Args:
        actor: gives the scores of moves.
        critic: gives values.
        part: ``obs`` (B, *S), ``state_`` (B, …), ``mask`` (B, A), ``action`` (B,), the logarithm of
            its ``chance`` (B,) when it was chosen, ``advantage`` (B,) and ``returns`` (B,).
        o: the options.
    """
    scores = actor(part["obs"][None])[0]
    if o.masking:
        scores = scores.masked_fill(part["mask"] == 0, -1e9)
    # (6, B): torch does this several times as fast over the long axis.
    chances = torch.log_softmax(scores.t(), dim=0)
    advantage = part["advantage"]
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    ratio = (chances.gather(0, part["action"][None])[0] - part["chance"]).exp()
    clipped = ratio.clamp(1 - o.clip, 1 + o.clip)
    gain = torch.minimum(ratio * advantage, clipped * advantage).mean()
    entropy = -(chances.exp() * chances).sum(dim=0).mean()
    seen = part["obs"]
    if o.critic == "central":
        seen = torch.cat((part["state_"].flatten(1), seen.flatten(1)), dim=1)
    value = critic(seen[None])[0, :, 0]
    return -gain - o.entropy * entropy, (value - part["returns"]).square().mean() / 2
