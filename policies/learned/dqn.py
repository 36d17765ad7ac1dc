"""Deep Q-learning for M problems at once (paper, Appendix B).

M independent learners, one a problem, take their gradient steps together: see
:mod:`policies.learned.qnetwork`. Where the networks live decides how: on a processor one network
after the other in compiled code (:mod:`policies.learned.kernel`), on other devices as batched
operations of torch over the whole stack. The weights, and the results up to rounding, are the same.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from policies.learned import kernel
from policies.learned.qnetwork import Initial, Layers, backward, forward, initial
from policies.learned.replay import Batch, Replay

ADAM = kernel.Adam(learning_rate=1e-4, beta1=0.9, beta2=0.999, tiny=1e-8)
"""Adam with the defaults of torch and TensorFlow (Kingma and Ba, 2015) and the paper's rate."""

Backend = Literal["compiled", "torch"]


class DQN:
    """M Q-networks, their target networks and their Adam states.

    Args:
        sizes: units of the layers, inputs first and the six moves last.
        seeds: one for the initial weights of each network.
        gamma: discount factor.
        learning_rate: Adam's.
        batch_size: transitions a gradient step.
        target_period: gradient steps between copies to the target network; 0 bootstraps from the
            network itself, as the paper's Appendix B writes.
        init: how weights start, see :func:`policies.learned.qnetwork.initial`.
        device: where the networks live.
        backend: ``compiled`` or ``torch``; None: compiled on the processor.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        seeds: Sequence[int],
        *,
        gamma: float,
        learning_rate: float,
        batch_size: int,
        target_period: int,
        init: Initial = "torch",
        device: torch.device | None = None,
        backend: Backend | None = None,
    ) -> None:
        self.device = device or torch.device("cpu")
        self.backend = backend or ("compiled" if self.device.type == "cpu" else "torch")
        self.sizes = tuple(sizes)
        self.gamma = gamma
        self.adam = ADAM._replace(learning_rate=learning_rate)
        self.batch_size = batch_size
        self.target_period = target_period
        self.weights = initial(sizes, seeds, init).to(self.device)
        self.target = self.weights.clone() if target_period else self.weights
        self.mean = torch.zeros_like(self.weights)
        self.square = torch.zeros_like(self.weights)
        self.steps = np.zeros(len(seeds), np.int64)  # gradient steps taken
        self._loss = np.zeros(len(seeds), np.float32)
        if self.backend == "compiled":
            self._sizes = np.array(sizes, np.int64)
            self._flat = tuple(
                t.numpy() for t in (self.weights, self.target, self.mean, self.square)
            )
        else:
            self._gradient = torch.zeros_like(self.weights)
            self._layers = Layers.of(self.weights, sizes)
            self._target_layers = Layers.of(self.target, sizes)
            self._gradients = Layers.of(self._gradient, sizes)

    def tensors(self) -> dict[str, Tensor]:
        """What a checkpoint keeps; the tensors themselves."""
        tensors = {name: getattr(self, name) for name in ("weights", "target", "mean", "square")}
        return {**tensors, "steps": torch.from_numpy(self.steps)}

    def values(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, K, 6) float32 Q values of observations (M, K, F) float32."""
        if self.backend == "compiled":
            out = np.empty((*seen.shape[:2], self.sizes[-1]), np.float32)
            kernel.values(self._sizes, self._flat[0], seen, out)
            return out
        with torch.no_grad():
            return forward(self._layers, torch.from_numpy(seen).to(self.device))[-1].cpu().numpy()

    def learn(
        self, replay: Replay, keys: NDArray[np.uint64], chosen: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """One gradient step of the chosen networks, each on a sample of its own memory.

        Args:
            replay: the memories.
            keys: (M,) uint64 keys of the samples' random numbers; the counter is ``steps``.
            chosen: (M,) bool.

        Returns:
            (M,) float32 mean squared Bellman error of the chosen networks before the step.
        """
        if self.backend == "compiled":
            weights, target, mean, square = self._flat
            kernel.learn(
                self._sizes,
                weights,
                target,
                mean,
                square,
                self.steps,
                replay.memory,
                keys,
                chosen,
                self.batch_size,
                self.gamma,
                self.target_period,
                self.adam,
                self._loss,
            )
        else:
            batch = replay.sample(self.batch_size, keys, self.steps, self.device)
            self._loss = self._update(batch, chosen).cpu().numpy()
        return self._loss

    @torch.no_grad()
    def _update(self, batch: Batch, chosen: NDArray[np.bool_]) -> Tensor:
        """The gradient step in torch; returns (M,) losses."""
        following = forward(self._target_layers, batch.arrived)[-1]
        if batch.mask is not None:
            following.masked_fill_(batch.mask == 0, -torch.inf)
        best = following.amax(dim=2, keepdim=True)
        wanted = torch.addcmul(batch.reward, batch.goes_on, best, value=self.gamma)
        activations = forward(self._layers, batch.seen)
        error = activations[-1].gather(2, batch.move).sub_(wanted)
        slope = torch.zeros_like(activations[-1])
        slope.scatter_(2, batch.move, error * (2 / self.batch_size))
        backward(self._layers, activations, slope, self._gradients)

        # The corrections for the averages' start at 0 go into the rate and into epsilon, row by
        # row: networks may have taken different numbers of steps.
        adam = self.adam
        self.steps += chosen
        steps = np.maximum(self.steps, 1)
        second = np.sqrt(1 - adam.beta2**steps)
        rate = self._column(chosen * adam.learning_rate * second / (1 - adam.beta1**steps))
        share = self._column(chosen)
        self.mean.lerp_(self._gradient, (1 - adam.beta1) * share)
        self.square.lerp_(self._gradient.square(), (1 - adam.beta2) * share)
        divisor = self.square.sqrt().add_(self._column(adam.tiny * second))
        self.weights.sub_(self.mean.div(divisor).mul_(rate))
        if self.target_period:
            due = chosen & (self.steps % self.target_period == 0)
            if due.any():
                self.target.lerp_(self.weights, self._column(due))
        return error.square_().mean(dim=(1, 2))

    def _column(self, values: NDArray[Any]) -> Tensor:
        """(M, 1) float32 on the device, to scale rows of (M, P) with."""
        return torch.from_numpy(values.astype(np.float32).reshape(-1, 1)).to(self.device)
