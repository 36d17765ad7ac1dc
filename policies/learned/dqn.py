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
        threads: threads that share the networks of the backend ``compiled``.
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
        threads: int = 1,
    ) -> None:
        self.threads = threads
        self.device = device or torch.device("cpu")
        self.backend = backend or ("compiled" if self.device.type == "cpu" else "torch")
        self.sizes = tuple(sizes)
        self.rule = kernel.Rule(batch_size, gamma, target_period, learning_rate)
        self.weights = initial(sizes, seeds, init).to(self.device)
        self.target = self.weights.clone() if target_period else self.weights
        self.mean = torch.zeros_like(self.weights)
        self.square = torch.zeros_like(self.weights)
        self.steps = np.zeros(len(seeds), np.int64)  # gradient steps taken
        if self.backend == "compiled":
            self._nets = kernel.Networks(
                sizes=np.array(sizes, np.int64),
                weights=self.weights.numpy(),
                target=self.target.numpy(),
                mean=self.mean.numpy(),
                square=self.square.numpy(),
                steps=self.steps,
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
            kernel.values(self._nets.sizes, self._nets.weights, seen, out)
            return out
        with torch.no_grad():
            return forward(self._layers, torch.from_numpy(seen).to(self.device))[-1].cpu().numpy()

    def learn(
        self, replay: Replay, keys: NDArray[np.uint64], due: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """Takes gradient steps, each network on samples of its own memory.

        Args:
            replay: the memories.
            keys: (M,) uint64 keys of the samples' random numbers; the counter is ``steps``.
            due: (M,) how many steps each network takes.

        Returns:
            (M,) float64 mean squared Bellman errors before the steps, summed over them.
        """
        due = due.astype(np.int64)
        loss = np.zeros(len(due))
        if self.backend == "compiled":
            learn = kernel.learn_threaded if self.threads > 1 else kernel.learn
            learn(self._nets, replay.memory, keys, due, self.rule, loss)
            return loss
        while due.any():
            chosen = due > 0
            batch = replay.sample(self.rule.batch, keys, self.steps, self.device)
            loss += np.where(chosen, self._update(batch, chosen).cpu().numpy(), 0)
            due -= chosen
        return loss

    @torch.no_grad()
    def _update(self, batch: Batch, chosen: NDArray[np.bool_]) -> Tensor:
        """The gradient step in torch; returns (M,) losses."""
        following = forward(self._target_layers, batch.arrived)[-1]
        if batch.mask is not None:
            following.masked_fill_(batch.mask == 0, -torch.inf)
        best = following.amax(dim=2, keepdim=True)
        wanted = torch.addcmul(batch.reward, batch.goes_on, best, value=self.rule.gamma)
        activations = forward(self._layers, batch.seen)
        error = activations[-1].gather(2, batch.move).sub_(wanted)
        slope = torch.zeros_like(activations[-1])
        slope.scatter_(2, batch.move, error * (2 / self.rule.batch))
        backward(self._layers, activations, slope, self._gradients)

        # The corrections for the averages' start at 0 go into the rate and into epsilon, row by
        # row: networks may have taken different numbers of steps.
        adam = self.rule
        self.steps += chosen
        steps = np.maximum(self.steps, 1)
        second = np.sqrt(1 - adam.beta2**steps)
        rate = self._column(chosen * adam.learning_rate * second / (1 - adam.beta1**steps))
        share = self._column(chosen)
        self.mean.lerp_(self._gradient, (1 - adam.beta1) * share)
        self.square.lerp_(self._gradient.square(), (1 - adam.beta2) * share)
        divisor = self.square.sqrt().add_(self._column(adam.tiny * second))
        self.weights.sub_(self.mean.div(divisor).mul_(rate))
        if self.rule.target_period:
            due = chosen & (self.steps % self.rule.target_period == 0)
            if due.any():
                self.target.lerp_(self.weights, self._column(due))
        return error.square_().mean(dim=(1, 2))

    def _column(self, values: NDArray[Any]) -> Tensor:
        """(M, 1) float32 on the device, to scale rows of (M, P) with."""
        return torch.from_numpy(values.astype(np.float32).reshape(-1, 1)).to(self.device)
