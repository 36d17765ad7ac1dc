"""Deep Q-learning for a stack of networks at once (paper, Appendix B).

L learners take their gradient steps together, each on samples of its own replay memory. The paper
has one for each problem; with shared parameters there is one for all. Where the networks live
decides how: on a processor one network after the other in compiled code
(:mod:`policies.learned.dqn_compiled`), on other devices as batched operations of torch over the
whole stack (:mod:`policies.learned.dqn_torch`). The weights, and the results up to rounding, are
the same.
"""

import abc
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from policies.learned.qnetwork import Initial, initial
from policies.learned.replay import Replay, kept
from policies.learned.stack import Stack

Backend = Literal["compiled", "torch"]


class Rule(NamedTuple):
    """How a gradient step is taken."""

    batch: int  # transitions a sample
    gamma: float  # discount factor
    target_period: int  # steps between copies to the target network; 0: there is none
    learning_rate: float
    # Adam with the defaults of torch and TensorFlow (Kingma and Ba, 2015).
    beta1: float = 0.9
    beta2: float = 0.999
    tiny: float = 1e-8


class DQN(abc.ABC):
    """L Q-networks, their target networks and their Adam states.

    Args:
        replay: the memories, on the device where the networks are to live.
        hidden: units of the hidden layers.
        moves: number of Q values.
        seeds: one for the initial weights of each network.
        keys: (L,) uint64 keys of the samples' random numbers; the counter is ``steps``.
        rule: how a gradient step is taken; without a target network it bootstraps from the
            network itself, as the paper's Appendix B writes.
        steps_per_update: moves to each gradient step.
        init: how weights start, see :func:`policies.learned.qnetwork.initial`.
        threads: threads that share the networks of the backend ``compiled``.

    Attributes:
        steps: (L,) int64 gradient steps taken.
        owed: (L,) int64 moves not yet answered by a gradient step.
        loss: (L,) float64 mean squared Bellman errors before the steps, summed over all of them.
    """

    def __init__(
        self,
        replay: Replay,
        hidden: Sequence[int],
        moves: int,
        *,
        seeds: Sequence[int],
        keys: NDArray[np.uint64],
        rule: Rule,
        steps_per_update: int = 1,
        init: Initial = "torch",
        threads: int = 1,
    ) -> None:
        self.replay = replay
        self.sizes = (replay.features, *hidden, moves)
        self.keys, self.rule, self.threads = keys, rule, threads
        self.steps_per_update = steps_per_update
        device = replay.rows.device
        self.weights = initial(self.sizes, seeds, init).to(device)
        self.target = self.weights.clone() if rule.target_period else self.weights
        self.mean = torch.zeros_like(self.weights)
        self.square = torch.zeros_like(self.weights)
        self.loss = torch.zeros(len(seeds), dtype=torch.float64, device=device)
        self.steps = np.zeros(len(seeds), np.int64)
        self.owed = np.zeros(len(seeds), np.int64)
        self._bind()

    @abc.abstractmethod
    def _bind(self) -> None:
        """Makes what holds on to the tensors: they are others now."""

    @abc.abstractmethod
    def values(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """(L, K, 6) float32 Q values of observations (L, K, F) float32."""

    @abc.abstractmethod
    def learn(self, due: NDArray[np.integer]) -> None:
        """Takes gradient steps, each network on samples of its own memory.

        Args:
            due: (L,) how many steps each network takes.
        """

    def play(self, stack: Stack, steps: int) -> None:
        """Plays a stack of problems, and takes the gradient steps that their moves ask for.

        The problems are shared out among the networks, as many to each. Those of one network make
        their steps together; it stops, and learns no further, when one of their episodes is over.

        Args:
            stack: the problems; changed.
            steps: how many each of them makes at most.
        """
        lanes, networks = stack.lanes, len(self.steps)
        for _ in range(steps):
            stack.look()
            seen = lanes.seen.reshape(networks, -1, lanes.seen.shape[2])
            lanes.values[:] = self.values(seen).reshape(lanes.values.shape)
            stack.pick()
            stack.move()
            self.replay.add(lanes)
            self.owed += lanes.moved.reshape(networks, -1).sum(axis=1)
            due = self.owed // self.steps_per_update
            self.owed -= due * self.steps_per_update
            self.learn(due)
            if lanes.over.any():
                return

    def keep(self, which: NDArray[np.integer]) -> None:
        """Goes on with some of the networks and their memories alone (rows, ascending)."""
        self.replay.keep(which)
        own_target = self.target is not self.weights
        for name in ("weights", "mean", "square", "loss", *(["target"] if own_target else [])):
            setattr(self, name, kept(getattr(self, name), which))
        if not own_target:
            self.target = self.weights
        self.steps, self.owed, self.keys = self.steps[which], self.owed[which], self.keys[which]
        self._bind()

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint keeps, memories included; on the processor the tensors themselves."""
        names = ("weights", "target", "mean", "square", "loss")
        return {
            **{name: getattr(self, name).cpu() for name in names},
            "steps": torch.from_numpy(self.steps),
            "owed": torch.from_numpy(self.owed),
            "rows": self.replay.rows.cpu(),
            "stored": torch.from_numpy(self.replay.stored),
        }

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes back to what :meth:`state` gave, of the same shapes."""
        for name in ("weights", "target", "mean", "square", "loss"):
            getattr(self, name).copy_(state[name])
        self.replay.rows.copy_(state["rows"])
        self.steps[:] = state["steps"].numpy()
        self.owed[:] = state["owed"].numpy()
        self.replay.stored[:] = state["stored"].numpy()
        self._bind()


def backend_for(device: torch.device) -> Backend:
    """The backend that suits a device."""
    return "compiled" if device.type == "cpu" else "torch"


def backends() -> dict[Backend, type[DQN]]:
    """The classes of the backends by name."""
    from policies.learned.dqn_compiled import CompiledDQN
    from policies.learned.dqn_torch import TorchDQN

    return {"compiled": CompiledDQN, "torch": TorchDQN}
