"""The DQN as batched operations of torch: one product a layer for the whole stack of networks.

On a GPU a gradient step is some fifty small operations, and starting them one by one takes longer
than carrying them out. So the step is recorded once as a CUDA graph and replayed; that is why it
takes everything from tensors that stay where they are, and never looks at a number.
"""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from policies.learned.dqn import DQN
from policies.learned.qnetwork import Layers, backward, forward

_WARM_UP = 3
"""Steps before recording: libraries set themselves up in the first ones."""


class TorchDQN(DQN):
    """:class:`policies.learned.dqn.DQN` in torch, on any of its devices."""

    def _bind(self) -> None:
        device = self.weights.device
        self._gradient = torch.zeros_like(self.weights)
        self._layers = Layers.of(self.weights, self.sizes)
        self._target_layers = Layers.of(self.target, self.sizes)
        self._gradients = Layers.of(self._gradient, self.sizes)
        # The device's own copies of what the step counts and draws with.
        self._keys = torch.from_numpy(self.keys.view(np.int64)).to(device)
        self._steps = torch.from_numpy(self.steps.copy()).to(device)
        self._stored = torch.from_numpy(self.replay.stored.copy()).to(device)
        self._chosen = torch.zeros((len(self.steps), 1), device=device)
        self._chosen_here = np.zeros(len(self.steps), np.bool_)
        self._step: Callable[[], None] = self._update
        self._eager = 0

    def values(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """(L, K, 6) float32 Q values of observations (L, K, F) float32."""
        with torch.no_grad():
            inputs = torch.from_numpy(seen).to(self.weights.device)
            return forward(self._layers, inputs)[-1].cpu().numpy()

    @torch.no_grad()
    def learn(self, due: NDArray[np.integer]) -> None:
        """See :meth:`policies.learned.dqn.DQN.learn`."""
        due = due.astype(np.int64)
        self._stored.copy_(torch.from_numpy(self.replay.stored))
        while due.any():
            chosen = due > 0
            if not np.array_equal(chosen, self._chosen_here):
                self._chosen_here = chosen
                self._chosen.copy_(torch.from_numpy(chosen.astype(np.float32)[:, None]))
            self._step()
            self.steps += chosen
            if self.rule.target_period:
                copied = chosen & (self.steps % self.rule.target_period == 0)
                if copied.any():
                    rows = torch.from_numpy(np.flatnonzero(copied)).to(self.weights.device)
                    self.target[rows] = self.weights[rows]
            if self.weights.is_cuda:
                self._record()
            due -= chosen

    def _record(self) -> None:
        """After the first steps, makes a graph of the step, to be replayed from then on."""
        self._eager += 1
        if self._eager != _WARM_UP:
            return
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._update()
        self._step = graph.replay

    def _update(self) -> None:
        """A gradient step of the chosen networks."""
        rule, replay = self.rule, self.replay
        batch = replay.sample(rule.batch, self._keys, self._steps, self._stored)
        following = forward(self._target_layers, batch.arrived)[-1]
        if batch.mask is not None:
            following.masked_fill_(batch.mask == 0, -torch.inf)
        best = following.amax(dim=2, keepdim=True)
        wanted = torch.where(batch.goes_on > 0, batch.reward + rule.gamma * best, batch.reward)
        activations = forward(self._layers, batch.seen)
        error = activations[-1].gather(2, batch.move).sub_(wanted)
        slope = torch.zeros_like(activations[-1])
        slope.scatter_(2, batch.move, error * (2 / rule.batch))
        backward(self._layers, activations, slope, self._gradients)

        # The corrections for the averages' start at 0 go into the rate and into epsilon, row by
        # row: networks may have taken different numbers of steps. One that is not chosen has a
        # rate of 0, and its averages stay.
        chosen = self._chosen
        self._steps += chosen[:, 0].long()
        count = self._steps.clamp(min=1).double()[:, None]
        second = (1 - rule.beta2**count).sqrt()
        rate = chosen * (rule.learning_rate * second / (1 - rule.beta1**count)).float()
        self.mean.lerp_(self._gradient, (1 - rule.beta1) * chosen)
        self.square.lerp_(self._gradient.square(), (1 - rule.beta2) * chosen)
        divisor = self.square.sqrt().add_((rule.tiny * second).float())
        self.weights.sub_(self.mean.div(divisor).mul_(rate))
        self.loss += (error.square_().mean(dim=(1, 2)) * chosen[:, 0]).double()
