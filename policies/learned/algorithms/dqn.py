"""Deep Q-learning (Mnih et al., 2015) as in the paper, with the usual additions as switches.

Deviations from the paper's text, all of them options: a target network (``target_period``) and a
discount factor below 1, without which hardly a net is joined (docs/paper.md), and a chance of
random moves that falls to 0. The additions are off by default; each can be switched on without the
others.

* ``double``: the network chooses the next move, the target network values it (van Hasselt et al.,
  2016).
* dueling: ``network: {kind: mlp, dueling: true}`` (Wang et al., 2016).
* ``masking``: only moves that cross an edge are chosen, and bootstrapped from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting.checks import check_fields
from marouting.config import MOST, Component, check, component_field, take_components
from marouting.player import Player
from policies.learned.exploration import Exploration
from policies.learned.learner import Learner, Setup
from policies.learned.memory.pre_step import PreStep
from policies.learned.memory.replay import Replay
from policies.learned.networks.adam import Adam
from policies.learned.networks.graph import CudaGraph


@dataclass(frozen=True, kw_only=True)
class DQNOptions:
    """The options of a DQN.

    Attributes:
        network: gives the values of the six moves.
        gamma: discount factor.
        learning_rate: of Adam.
        batch_size: transitions of a gradient step.
        buffer_size: transitions that the replay memory of a network holds.
        burn_in: whose moves fill the memory first: ``astar``, ``random``, ``pathfinder``,
            ``optimal``, or a solution file, see :func:`policies.learned.burn_in.guide`.
        burn_in_size: how many of them.
        epsilon: chance of a random move.
        epsilon_final: what ``epsilon`` falls to, linearly, between the episodes
            ``epsilon_decay_from`` and the last; None: it stays.
        epsilon_decay_from: the episode from which it falls.
        target_period: gradient steps between copies of the network to its target; 0: the network
            is its own target, as the paper's Appendix B writes.
        steps_per_update: moves to each gradient step.
        masking: whether only moves that cross an edge are chosen and bootstrapped from.
        double: whether the network chooses the move that its target values.
        final_failures: whether a failed task is not bootstrapped from, as a joined one: for games
            in which the limit of steps is part of what is to be learned (Pardo et al., 2018).
        fused: whether the compiled learner does it, see
            :func:`policies.learned.algorithms.fused_dqn.obstacle`; None: where it applies.
    """

    network: Component = component_field("network", "mlp")
    gamma: float = 0.95
    learning_rate: float = 1e-4
    batch_size: int = 32
    buffer_size: int = 50_000
    burn_in: str = "astar"
    burn_in_size: int = 10_000
    epsilon: float = 0.05
    epsilon_final: float | None = 0.0
    epsilon_decay_from: int = 0
    target_period: int = 1000
    steps_per_update: int = 1
    masking: bool = False
    double: bool = False
    final_failures: bool = False
    fused: bool | None = None

    def __post_init__(self) -> None:
        take_components(self)
        shares = dict.fromkeys(("gamma", "epsilon", "epsilon_final"), (0, 1))
        counts = dict.fromkeys(("burn_in_size", "buffer_size", "steps_per_update"), (1, MOST))
        counts |= dict.fromkeys(("epsilon_decay_from", "target_period"), (0, MOST))
        check_fields(self, batch_size=(1, 65536), **shares, **counts)
        check("learning_rate", self.learning_rate > 0, "a number above 0")
        check("buffer_size", self.buffer_size >= self.burn_in_size, "at least burn_in_size")
        own = self.target_period > 0
        check("double", own or not self.double, "false, or target_period above 0")


class DQN(Learner):
    """DQN in torch, on any device, for any network, observation and reward."""

    Options = DQNOptions
    # The paper's options are for a training of hours on one problem.
    endless: ClassVar[Mapping[str, Any]] = {
        "masking": True, "steps_per_update": 8, "batch_size": 128, "learning_rate": 1e-3,
        "target_period": 200, "final_failures": True,
    }  # fmt: skip
    rows: ClassVar[tuple[str, ...]] = (*Learner.rows, "target", "pending_updates")
    parts: ClassVar[tuple[str, ...]] = ("networks", "adam", "memory", "explore")

    def __init__(self, setup: Setup, options: DQNOptions) -> None:
        super().__init__(setup, options)
        o, names, device = options, setup.names, setup.device
        check(
            "buffer_size",
            o.buffer_size >= setup.games // len(names) * setup.rows,
            f"at least {setup.games // len(names) * setup.rows}, the moves of one step",
        )
        self.learning_starts, self.burn_in = o.burn_in_size, o.burn_in
        self.backend = (
            "torch, CUDA graph" if device.type == "cuda" else f"torch, batched on {device}"
        )
        self.networks = self._stack("weights", setup.obs_shape, setup.actions)
        self.adam = Adam(self.networks.flat)
        self.memory = self._memory()
        self.explore = Exploration(setup.game_keys("explore"))
        # Moves that no gradient step has answered yet.
        self.pending_updates = np.zeros(len(names), np.int64)
        # Without a target network there are no weights to keep for it.
        self.target = self.networks.flat[:, : None if o.target_period else 0].clone()
        self._burning_in = False
        self.bind()

    def begin(self, weights: Sequence[Mapping[str, Tensor]]) -> None:
        """See :meth:`policies.learned.learner.Learner.begin`."""
        super().begin(weights)
        self.target.copy_(self.networks.flat[:, : self.target.shape[1]])

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "pending_updates": (0, self.options.steps_per_update - 1)}

    def _memory(self) -> Replay:
        o, setup = self.options, self.setup
        return Replay(
            setup.network_keys("sample"),
            o.buffer_size,
            setup.obs_shape,
            o.masking,
            self.device,
            agents=(setup.games // len(setup.names), setup.player.engine.nets.shape[1]),
            actions=setup.actions,
            final_failures=o.final_failures,
            late=setup.pays_late,
        )

    def bind(self) -> None:
        """Renews what refers to the rows."""
        own = self.options.target_period > 0
        self._target = self.networks.view_of(self.target) if own else self.networks.view
        self._gradient = torch.empty_like(self.networks.flat)
        self._due = torch.zeros(len(self.updates), 1, device=self.device)
        self._were_due = np.zeros(len(self.updates), np.bool_)
        self._step = CudaGraph(self._update) if self.device.type == "cuda" else self._update

    # --- play ---------------------------------------------------------------------------------

    def play(self, player: Player, steps: int) -> None:
        """See :meth:`policies.learned.learner.Learner.play`."""
        if self._burning_in:  # what was played then is not gone on with
            self.memory.cut()
            self._burning_in = False
        for _ in range(steps):
            before = PreStep.of(player)
            self.explore.epsilon_greedy(
                player.buffers, self._values(before.obs), self.options.masking
            )
            player.step()
            self.memory.add(before, player.buffers)
            self.pending_updates += self._games(player.buffers.acted).sum(axis=(1, 2))
            due = self.pending_updates // self.options.steps_per_update
            self.pending_updates -= due * self.options.steps_per_update
            self.learn(due)
            if player.buffers.over.any():
                return

    def observe(self, player: Player, before: PreStep) -> None:
        """See :meth:`policies.learned.learner.Learner.observe`."""
        self.memory.add(before, player.buffers)
        self._burning_in = True

    def _values(self, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, K, A) values of all actions for observations (M, K, *S)."""
        games, rows, *shape = obs.shape
        inputs = torch.from_numpy(obs).to(self.device).view(len(self.updates), -1, *shape)
        with torch.no_grad():
            return self.networks.view(inputs).cpu().numpy().reshape(games, rows, -1)

    # --- learning -----------------------------------------------------------------------------

    def learn(self, due: NDArray[np.int64]) -> None:
        """Takes ``due`` (L,) gradient steps, each network on samples of its own memory."""
        period, due = self.options.target_period, due.copy()
        while due.any():
            now = due > 0
            if not np.array_equal(now, self._were_due):
                self._were_due = now
                self._due.copy_(torch.from_numpy(now[:, None].astype(np.float32)))
            self._step()
            self.updates += now
            if period and (copied := now & (self.updates % period == 0)).any():
                rows = torch.from_numpy(np.flatnonzero(copied)).to(self.device)
                self.target[rows] = self.networks.flat[rows]
            due -= now

    def _update(self) -> None:
        """A gradient step of the networks that are due; nothing here looks at a number."""
        o = self.options
        batch = self.memory.sample(o.batch_size, self.adam.count)
        with torch.no_grad():
            value = self._target(batch.next_obs)
            chooser = self.networks.view(batch.next_obs) if o.double else value
            if batch.mask is not None:
                chooser = chooser.masked_fill(batch.mask == 0, -torch.inf)
            best = chooser.amax(dim=2, keepdim=True)
            if o.double:
                best = value.gather(2, chooser.argmax(dim=2, keepdim=True))
            wanted = batch.reward + o.gamma * batch.goes_on * best
        # The loss is the mean of error².
        value = self.networks.view(batch.obs).gather(2, batch.move)
        with torch.no_grad():
            error = value - wanted
            slope = error * (2 / o.batch_size)
            self.loss += ((error * error).mean(dim=(1, 2)) * self._due[:, 0]).double()
        self.networks.view.gradient(value, self._gradient, slope)
        self.adam.step(self.networks.flat, self._gradient, self._due, o.learning_rate)

    # --- schedules ----------------------------------------------------------------------------

    @property
    def stored(self) -> NDArray[np.int64]:
        """(L,) transitions ever stored."""
        return self.memory.stored

    def exploration(self, episode: int) -> float:
        """The chance of a random move in an episode (counted from 0)."""
        o = self.options
        if o.epsilon_final is None or episode <= o.epsilon_decay_from:
            return o.epsilon
        span = max(self.setup.episodes - 1 - o.epsilon_decay_from, 1)
        share = min((episode - o.epsilon_decay_from) / span, 1.0)
        return o.epsilon + share * (o.epsilon_final - o.epsilon)

    def set_episodes(self, episodes: NDArray[np.int64]) -> None:
        """See :meth:`policies.learned.learner.Learner.set_episodes`."""
        chances = [self.exploration(episode) for episode in episodes.tolist()]
        self.explore.epsilon[:] = self._games(np.array(chances))
