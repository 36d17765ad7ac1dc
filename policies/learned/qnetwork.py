"""M independent Q-networks of one shape, stacked: one batched product a layer for all of them.

The paper's network is 12-32-64-32-6 with a ReLU after each hidden layer. All weights of a network
lie in one row of one tensor, so that an optimiser's step is a few operations over the whole stack.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

Initial = Literal["torch", "uniform"]

HALF_RANGE = 0.5
"""Weights of ``uniform``: the authors' code draws from (−0.5, 0.5) and starts biases at 0."""


@dataclass
class Layers:
    """Views of a (M, P) tensor as the weights and biases of every layer.

    Attributes:
        weights: for each layer (M, inputs, outputs).
        biases: for each layer (M, 1, outputs).
    """

    weights: list[Tensor] = field(default_factory=list)
    biases: list[Tensor] = field(default_factory=list)

    @staticmethod
    def of(flat: Tensor, sizes: Sequence[int]) -> "Layers":
        """The views of ``flat`` (M, P) for the layer sizes, inputs first."""
        layers, at = Layers(), 0
        for inputs, outputs in itertools.pairwise(sizes):
            end = at + inputs * outputs
            layers.weights.append(flat[:, at:end].view(-1, inputs, outputs))
            layers.biases.append(flat[:, end : end + outputs].view(-1, 1, outputs))
            at = end + outputs
        return layers


def count(sizes: Sequence[int]) -> int:
    """Number of weights and biases P of one network."""
    return sum((a + 1) * b for a, b in itertools.pairwise(sizes))


def initial(sizes: Sequence[int], seeds: Sequence[int], how: Initial = "torch") -> Tensor:
    """(M, P) float32 random weights, one row a seed.

    Args:
        sizes: numbers of units of the layers, inputs first.
        seeds: one for each network.
        how: ``torch``, uniform in ±1/√inputs as ``torch.nn.Linear``; ``uniform``, weights in
            ±0.5 and biases 0 as the authors' code.
    """
    flat = torch.empty(len(seeds), count(sizes))
    layers = Layers.of(flat, sizes)
    for row, seed in enumerate(seeds):
        generator = torch.Generator().manual_seed(seed)
        for weights, biases in zip(layers.weights, layers.biases, strict=True):
            bound = HALF_RANGE if how == "uniform" else weights.shape[1] ** -0.5
            weights[row].uniform_(-bound, bound, generator=generator)
            biases[row].uniform_(-bound, bound, generator=generator)
            if how == "uniform":
                biases[row].zero_()
    return flat


def forward(layers: Layers, x: Tensor) -> list[Tensor]:
    """All activations of the stack for (M, B, inputs): the input, hidden layers, Q (M, B, 6)."""
    activations = [x]
    last = len(layers.weights) - 1
    for i, (weights, biases) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        x = torch.baddbmm(biases, x, weights)
        if i < last:
            x.relu_()
        activations.append(x)
    return activations


def backward(layers: Layers, activations: list[Tensor], slope: Tensor, gradients: Layers) -> None:
    """Fills ``gradients`` with the derivatives of a loss; its slope at Q is (M, B, 6)."""
    for i in reversed(range(len(layers.weights))):
        torch.bmm(activations[i].transpose(1, 2), slope, out=gradients.weights[i])
        torch.sum(slope, dim=1, keepdim=True, out=gradients.biases[i])
        if i > 0:
            slope = torch.bmm(slope, layers.weights[i].transpose(1, 2))
            slope.mul_(activations[i] > 0)
