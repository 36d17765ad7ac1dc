"""The multilayer perceptron; the paper's network is one of 12-32-64-32-6 units with ReLUs."""

import itertools
import math
from typing import Literal

import torch
from torch import Tensor, nn

from marouting.errors import InputError

Initial = Literal["torch", "uniform"]
Activation = Literal["relu", "tanh"]

HALF_RANGE = 0.5
"""Weights of ``uniform``: the authors' code draws from (−0.5, 0.5) and starts biases at 0."""


class MLP(nn.Module):
    """Fully connected layers.

    Args:
        obs_shape: of one observation, which is flattened.
        outputs: how many numbers the network gives.
        hidden: units of the hidden layers.
        init: initial weights, ``torch`` (uniform in ±1/√inputs as ``torch.nn.Linear``) or
            ``uniform`` (±0.5, biases 0, as the authors' code).
        activation: after each hidden layer.
        dueling: whether the last layer gives the value of the state and the advantages of the
            moves over their mean, whose sum the network gives (Wang et al., 2016).
    """

    stacked = True

    def __init__(
        self,
        obs_shape: tuple[int, ...],
        outputs: int,
        *,
        hidden: tuple[int, ...] = (32, 64, 32),
        init: Initial = "torch",
        activation: Activation = "relu",
        dueling: bool = False,
    ) -> None:
        super().__init__()
        if not all(1 <= units <= 4096 for units in hidden):
            raise InputError(
                f"learner.network.hidden: expected numbers from 1 to 4096, found {hidden}"
            )
        self.obs_shape, self.dueling, self.activation = obs_shape, dueling, activation
        self.sizes = (math.prod(obs_shape), *hidden, outputs + dueling)
        self.layers = nn.ModuleList(Affine(a, b, init) for a, b in itertools.pairwise(self.sizes))

    def forward(self, obs: Tensor) -> Tensor:
        """(…, B, outputs) for observations (…, B, *obs_shape)."""
        x = obs.flatten(obs.dim() - len(self.obs_shape))
        for layer in self.layers[:-1]:
            x = layer(x)
            # In place, because nothing else needs the sums.
            x = torch.relu_(x) if self.activation == "relu" else torch.tanh_(x)
        x = self.layers[-1](x)
        return duel(x) if self.dueling else x


def plain_sizes(module: nn.Module) -> tuple[int, ...] | None:
    """Units of the layers of a network that compiled code can play, inputs first; None: it cannot.

    That is an :class:`MLP` with ReLUs that is not dueling.
    """
    if not isinstance(module, MLP) or module.activation != "relu" or module.dueling:
        return None
    return module.sizes


class Affine(nn.Module):
    """A fully connected layer, x W + b, with initial weights from torch's global random numbers.

    Unlike ``torch.nn.Linear`` it holds W as (inputs, outputs), in which form its gradient comes
    out, and it also takes weights of several networks at once.

    Args:
        inputs: numbers of a row.
        outputs: likewise.
        init: see :class:`MLP`.
    """

    def __init__(self, inputs: int, outputs: int, init: Initial = "torch") -> None:
        super().__init__()
        bound = HALF_RANGE if init == "uniform" else inputs**-0.5
        # In this order since the first release: a seed gives the same network ever after.
        self.weight = nn.Parameter(torch.empty(inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(outputs).uniform_(-bound, bound))
        if init == "uniform":
            nn.init.zeros_(self.bias)

    def forward(self, x: Tensor) -> Tensor:
        """(B, outputs) for (B, inputs); with weights of L networks (L, B, outputs)."""
        if self.weight.dim() == 3:
            return torch.baddbmm(self.bias[:, None], x, self.weight)
        return torch.addmm(self.bias, x, self.weight)


def duel(x: Tensor) -> Tensor:
    """(…, outputs) values of moves, from (…, 1 + outputs): the state's value, and advantages."""
    value, advantage = x[..., :1], x[..., 1:]
    return value + advantage - advantage.mean(dim=-1, keepdim=True)
