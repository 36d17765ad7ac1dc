"""Networks of one architecture, run together by ``torch.func``.

For networks of a few thousand weights, an operation of torch costs more to start than to carry
out. So the weights of L networks lie in one tensor, a row each: ``vmap`` makes one batched product
of each layer for all of them, and an optimiser's step is a few operations over the whole stack.
"""

import copy
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.func import functional_call, stack_module_state, vmap

from policies.learned.per_network import PerNetworkState


class View:
    """The weights of R networks as what the module's code works with, and its derivatives.

    Args:
        module: the code; a copy of it is given the weights.
        flat: (R, P) float32, which they stay in: a change of it is a change of the networks.
        buffers: (R, …) what else the module holds, by name.
        stacked: whether the code takes the weights of several networks at once.
    """

    def __init__(
        self, module: nn.Module, flat: Tensor, buffers: dict[str, Tensor], stacked: bool
    ) -> None:
        self.alone = len(flat) == 1
        shapes = {name: weight.shape for name, weight in module.named_parameters()}
        parts = torch.split(flat.detach(), [shape.numel() for shape in shapes.values()], dim=1)
        self.weights = {
            name: nn.Parameter(part.view(shape if self.alone else (-1, *shape)))
            for part, (name, shape) in zip(parts, shapes.items(), strict=True)
        }
        self.buffers = {name: b[0] if self.alone else b for name, b in buffers.items()}
        self._module = copy.deepcopy(module)
        self._batched: Callable[..., Tensor] | None = None
        if self.alone or stacked:
            for name, tensor in (self.weights | self.buffers).items():
                owner, _, leaf = name.rpartition(".")
                setattr(self._module.get_submodule(owner), leaf, tensor)
        else:
            self._batched = vmap(self._one)

    def _one(self, weights: dict[str, Tensor], buffers: dict[str, Tensor], obs: Tensor) -> Tensor:
        output: Tensor = functional_call(self._module, (weights, buffers), (obs,))
        return output

    def __call__(self, obs: Tensor) -> Tensor:
        """What the networks give, (R, B, outputs) for (R, B, *S) float32."""
        if self._batched is not None:
            return self._batched(self.weights, self.buffers, obs)
        output: Tensor = self._module(obs[0] if self.alone else obs)
        return output[None] if self.alone else output

    def gradient(self, of: Tensor, out: Tensor, slope: Tensor | None = None) -> None:
        """Derivatives by the weights.

        Args:
            of: what is differentiated: a loss summed over the networks; or with ``slope`` anything.
            out: (R, P) filled.
            slope: derivatives of the loss by ``of``: to hand them over saves torch a few steps.
        """
        parts = torch.autograd.grad(of, tuple(self.weights.values()), slope)
        torch.cat([part.reshape(len(out), -1) for part in parts], dim=1, out=out)


class Stack(PerNetworkState):
    """L networks.

    Args:
        make: makes a network, with random weights from torch's global generator.
        seeds: one for each network's weights.
        device: where the weights are.

    Attributes:
        flat: (L, P) float32, all weights and biases; a row per network.
        view: the networks with these weights.
        module: the code of the networks, without weights.
    """

    rows = ("flat",)

    def __init__(
        self, make: Callable[[], nn.Module], seeds: Sequence[int], device: torch.device
    ) -> None:
        modules = []
        with torch.random.fork_rng(devices=[]):
            for seed in seeds:
                torch.manual_seed(seed)
                modules.append(make())
        self._stacked = bool(getattr(modules[0], "stacked", False))
        weights, buffers = stack_module_state(modules)
        self._buffers = {name: buffer.to(device) for name, buffer in buffers.items()}
        flat = [weight.detach().reshape(len(seeds), -1) for weight in weights.values()]
        self.flat = torch.cat(flat, dim=1).to(device)
        self.module = modules[0].to("meta")
        self.bind()

    def bind(self) -> None:
        """Renews the views."""
        self.view = self.view_of(self.flat)
        self._rows: dict[int, View] = {}

    def take(self, row: int, weights: Mapping[str, Tensor]) -> None:
        """Gives a network other weights.

        Args:
            row: which one.
            weights: its ``state_dict`` as an ordinary module.
        """
        view = self.row(row)
        for name, tensor in (view.weights | view.buffers).items():
            tensor.data.copy_(weights[name].view_as(tensor))

    def view_of(self, flat: Tensor, first: int = 0) -> View:
        """The networks with other weights.

        Args:
            flat: (R, P) float32.
            first: the row of the stack that the first of them belongs to.
        """
        buffers = {name: b[first : first + len(flat)] for name, b in self._buffers.items()}
        return View(self.module, flat, buffers, self._stacked)

    def part(self, which: NDArray[np.integer]) -> View:
        """Some of the networks, as they are now."""
        if len(which) == 1:
            return self.row(int(which[0]))
        rows = torch.from_numpy(which).to(self.flat.device)
        buffers = {name: buffer[rows] for name, buffer in self._buffers.items()}
        return View(self.module, self.flat[rows], buffers, self._stacked)

    def row(self, row: int) -> View:
        """One of the networks."""
        if row not in self._rows:
            self._rows[row] = self.view_of(self.flat[row : row + 1], row)
        return self._rows[row]
