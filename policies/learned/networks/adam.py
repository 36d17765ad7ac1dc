"""Adam (Kingma and Ba, 2015) for a stack of networks that take different numbers of steps."""

import copy

import torch
from torch import Tensor

from policies.learned.checkpoint import FINITE
from policies.learned.per_network import COUNT, PerNetworkState

BETA1, BETA2 = 0.9, 0.999
"""How much of the mean gradient, and of the mean square, remains with each step."""

_NOTHING = 1e-18
"""A gradient too small to matter."""


class Adam(PerNetworkState):
    """The optimiser's averages, a row per network.

    Networks that are not due stay exactly as they are. The arithmetic runs over the whole stack,
    without looking at a number, so that it can be recorded as a CUDA graph.

    Args:
        weights: (L, P), as those to be optimised.
        eps: added to the divisor.

    Attributes:
        mean: (L, P) mean of the gradients.
        square: (L, P) mean of their squares.
        count: (L,) int64 steps taken, on the device.
    """

    rows = ("mean", "square", "count")

    def __init__(self, weights: Tensor, eps: float = 1e-8) -> None:
        self.eps = eps
        self.mean, self.square = torch.zeros_like(weights), torch.zeros_like(weights)
        self.count = torch.zeros(len(weights), dtype=torch.int64, device=weights.device)
        self.bind()

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "square": (0.0, FINITE[1]), "count": COUNT}

    def bind(self) -> None:
        """Renews the working array."""
        self._work = torch.empty_like(self.mean)

    def part(self, row: int) -> "Adam":
        """The optimiser of one network of the stack; its steps are steps of the whole one's row."""
        part = copy.copy(self)
        for name in self.rows:
            setattr(part, name, getattr(self, name)[row : row + 1])
        part.bind()
        return part

    @torch.no_grad()
    def step(self, weights: Tensor, gradient: Tensor, due: Tensor, rate: float) -> None:
        """One step of the networks that are due.

        Args:
            weights: (L, P); changed.
            gradient: (L, P).
            due: (L, 1) float32, 1 for a network that takes the step, else 0.
            rate: the learning rate.
        """
        work = self._work
        self.count += due[:, 0].long()
        # The corrections for averages that start at 0 go into the rate and into eps.
        count = self.count.clamp(min=1).double()[:, None]
        second = (1 - BETA2**count).sqrt()
        rates = due * (rate * second / (1 - BETA1**count)).float()
        self.mean.lerp_(gradient, (1 - BETA1) * due)
        self.square.lerp_(torch.square(gradient, out=work), (1 - BETA2) * due)
        # The averages of a unit that is never active fade to numbers so small that the processor
        # takes a hundred times as long with them; MKL's root of 0 is slow too. Beside eps neither
        # makes a difference.
        torch.hardshrink(self.mean, _NOTHING, out=self.mean)
        self.square.clamp_(min=_NOTHING**2)
        torch.sqrt(self.square, out=work).add_((self.eps * second).float())
        weights.sub_(torch.div(self.mean, work, out=work).mul_(rates))
