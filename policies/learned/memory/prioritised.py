"""Prioritised replay (Schaul et al., "Prioritized experience replay", 2016), proportional."""

from typing import Any, ClassVar

import torch
from torch import Tensor

from policies.learned.checkpoint import FINITE
from policies.learned.counter_rng import uniforms
from policies.learned.memory.replay import Batch, Replay
from policies.learned.per_network import PerNetworkState

_TINY = 1e-3
"""Added to errors, so that a transition without any can be drawn again."""


class SumTree(PerNetworkState):
    """Numbers of which one is drawn with a chance in proportion to it, for each of L networks.

    The tree has three levels below its root, each node with as many children as the cube root of
    the capacity: a few wide operations in place of many narrow ones.

    Args:
        networks: L.
        capacity: numbers per network.
        device: where they are.
    """

    rows = ("tops", "middles", "leaves")

    def __init__(self, networks: int, capacity: int, device: torch.device) -> None:
        width = 2
        while width**3 < capacity:
            width += 1
        self.width, self.capacity = width, capacity
        self.tops, self.middles, self.leaves = (
            torch.zeros(networks, width**level, device=device) for level in (1, 2, 3)
        )

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), **dict.fromkeys(self.rows, (0.0, FINITE[1]))}

    def set(self, place: Tensor, number: Tensor) -> None:
        """Changes numbers.

        Args:
            place: (C,) int64 counted through all networks, ``capacity`` to each.
            number: (C,) float32; equal for equal places.
        """
        network = place // self.capacity
        at = network * self.leaves.shape[1] + place % self.capacity
        self.leaves.view(-1)[at] = number
        for below, above in ((self.leaves, self.middles), (self.middles, self.tops)):
            at = at // self.width
            # Summed anew, not changed by a difference: rounding errors do not add up.
            above.view(-1)[at] = below.view(-1, self.width)[at].sum(dim=1)

    def find(self, share: Tensor) -> tuple[Tensor, Tensor]:
        """Draws places.

        Args:
            share: (L, B) float32 in [0, 1), of the sum of a network's numbers.

        Returns:
            (L, B) int64 places, each network's own, and (L, B) float32 their numbers' shares.
        """
        total = self.tops.sum(dim=1, keepdim=True)
        left = share * total
        node = torch.zeros_like(left, dtype=torch.int64)
        for level in (self.tops, self.middles, self.leaves):
            children = level.view(len(level), -1, self.width)
            picked = node[..., None].expand(-1, -1, self.width)
            numbers = children.gather(1, picked)
            ends = numbers.cumsum(dim=2)
            # The first child whose end lies beyond; rounding must not lead to one that is 0.
            child = (ends <= left[..., None]).sum(dim=2)
            last = self.width - 1 - (numbers > 0).flip(2).int().argmax(dim=2)
            child = torch.minimum(child, last)[..., None]
            number = numbers.gather(2, child)[..., 0]
            left = left - (ends.gather(2, child)[..., 0] - number)
            node = node * self.width + child[..., 0]
        return node.clamp(max=self.capacity - 1), number / total.clamp(min=1e-30)


class Prioritised(Replay):
    """A replay memory that draws transitions of large errors more often.

    Args:
        *given: see :class:`policies.learned.memory.replay.Replay`.
        alpha: power of the errors that the chances are in proportion to; 0: uniform.
        beta: power of the weights that make up for it in the loss, at the start; 1: in full.
        **named: see :class:`policies.learned.memory.replay.Replay`.

    Attributes:
        beta: (L, 1) float32 as it stands; the learner anneals it to 1.
    """

    rows: ClassVar[tuple[str, ...]] = (*Replay.rows, "most", "beta")
    parts = ("tree",)

    def __init__(self, *given: Any, alpha: float, beta: float, **named: Any) -> None:
        super().__init__(*given, **named)
        self.alpha = alpha
        networks, capacity, _ = self.store.shape
        self.tree = SumTree(networks, capacity, self.device)
        # The largest priority so far: what is new gets it, to be drawn at least once or so.
        self.most = torch.ones(networks, 1, device=self.device)
        self.beta = torch.full((networks, 1), beta, device=self.device)

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "most": (0.0, FINITE[1]), "beta": (0.0, 1.0)}

    def _added(self, place: Tensor) -> None:
        if len(place):
            self.tree.set(place, self.most[place // self.store.shape[1], 0])

    def sample(self, size: int, counters: Tensor) -> Batch:
        """A sample with a transition from each of B equal parts of the sum of priorities."""
        stratum = torch.arange(size, device=self.device)
        draws = (uniforms(self.keys, counters, stratum) + stratum) / size
        place, chance = self.tree.find(draws.float())
        batch = self._batch(place)
        there = self._stored.clamp(1, self.store.shape[1])[:, None]
        weight = (there * chance).clamp(min=1e-30) ** -self.beta
        batch.weight = (weight / weight.amax(dim=1, keepdim=True))[..., None]
        return batch

    def learned(self, batch: Batch, error: Tensor, due: Tensor) -> None:
        """Gives the transitions of a sample the priorities of their errors."""
        networks, capacity, _ = self.store.shape
        priority = (error[..., 0].abs() + _TINY) ** self.alpha
        first = torch.arange(networks, device=self.device)[:, None]
        before = self.tree.leaves.gather(1, batch.place)
        number = torch.where(due > 0, priority, before)
        self.tree.set((batch.place + capacity * first).view(-1), number.view(-1))
        largest = torch.maximum(self.most, number.amax(dim=1, keepdim=True))
        self.most.copy_(torch.where(due > 0, largest, self.most))
