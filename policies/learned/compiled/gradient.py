"""A gradient step of one multilayer perceptron as one compiled call.

The same arithmetic as in :mod:`policies.learned.algorithms.dqn`, on the same memory. For a network
of five thousand weights, an operation of torch costs more to call than to compute. Here a whole
gradient step, sampling included, is one call, and its numbers stay in the processor's cache.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import allocating, compiled
from policies.learned.compiled.products import product, product_row
from policies.learned.counter_rng import uniform
from policies.learned.memory.replay import GOES_ON, MASK, MOVE, REWARD
from policies.learned.networks.adam import BETA1, BETA2

NO_FLOOR = np.float32(-np.inf)
"""The floor of a product that has none."""


class StepRule(NamedTuple):
    """How a gradient step is taken."""

    batch: int  # transitions of a sample
    gamma: float  # discount factor
    target_period: int  # steps between copies to the target network; 0: there is none
    learning_rate: float
    eps: float  # of Adam


class Networks(NamedTuple):
    """A stack of L networks of P weights, their optimisers and memories."""

    sizes: NDArray[np.int64]  # (layers + 1,) units, inputs first
    weights: NDArray[np.float32]  # (L, P) of each layer (inputs, outputs), then its biases
    target: NDArray[np.float32]  # (L, P); ``weights`` itself where there is no target network
    mean: NDArray[np.float32]  # (L, P) Adam's mean of the gradients
    square: NDArray[np.float32]  # (L, P) Adam's mean of their squares
    loss: NDArray[np.float64]  # (L,) summed over the gradient steps taken
    updates: NDArray[np.int64]  # (L,) gradient steps taken
    store: NDArray[np.float32]  # (L, capacity, width) see policies.learned.memory.replay
    stored: NDArray[np.int64]  # (L,) transitions ever stored
    masks: bool  # whether the store holds action masks
    keys: NDArray[np.uint64]  # (L,) of the samples' random numbers


class GradientBuffers(NamedTuple):
    """Working arrays of a gradient step: B transitions, U units in all layers but the inputs."""

    obs: NDArray[np.float32]  # (B F,)
    next_obs: NDArray[np.float32]  # (B F,)
    activations: NDArray[np.float32]  # (B U,)
    slopes: NDArray[np.float32]  # (B U,)
    turned: NDArray[np.float32]  # (P,) weights of a layer, columns as rows
    zeros: NDArray[np.float32]  # (U,)
    gradient: NDArray[np.float32]  # (P,)
    places: NDArray[np.int64]  # (B,) rows of the sample
    wanted: NDArray[np.float32]  # (B,) what the network should have expected


@compiled
def units_of(sizes: Any) -> int:
    """Units of all layers but the inputs."""
    units = 0
    for i in range(1, len(sizes)):
        units += sizes[i]
    return units


@allocating
def gradient_buffers(nets: Networks, batch: int) -> GradientBuffers:
    """Working arrays for samples of a size."""
    units, features, weights = units_of(nets.sizes), nets.sizes[0], nets.weights.shape[1]
    return GradientBuffers(
        np.empty(batch * features, np.float32),
        np.empty(batch * features, np.float32),
        np.empty(batch * units, np.float32),
        np.empty(batch * units, np.float32),
        np.empty(weights, np.float32),
        np.zeros(units, np.float32),
        np.empty(weights, np.float32),
        np.empty(batch, np.int64),
        np.empty(batch, np.float32),
    )


@compiled
def forward(sizes: Any, weights: Any, x: Any, batch: int, activations: Any) -> int:
    """Fills ``activations`` with the outputs of all layers; returns where the last are."""
    at, place = 0, 0
    last = len(sizes) - 2
    for i in range(last + 1):
        inputs, outputs = sizes[i], sizes[i + 1]
        y = activations[place : place + batch * outputs]
        bias = at + inputs * outputs
        floor = np.float32(0) if i < last else NO_FLOOR
        if batch == 1:  # many inputs and activations are zero
            product_row(x, 0, 1, inputs, weights, at, weights, bias, y, floor)
        else:
            product(x, inputs, 1, weights, at, weights, bias, y, batch, inputs, outputs, floor)
        if i < last:
            place += batch * outputs
        at += (inputs + 1) * outputs
        x = y
    return place


@compiled
def _backward(sizes: Any, weights: Any, batch: int, b: GradientBuffers) -> None:
    """Fills ``b.gradient`` by activations that :func:`forward` left and the last layer's slopes."""
    at = len(weights)
    place = batch * units_of(sizes)
    for i in range(len(sizes) - 2, -1, -1):
        inputs, outputs = sizes[i], sizes[i + 1]
        at -= (inputs + 1) * outputs
        place -= batch * outputs
        before = place - batch * inputs
        slope = b.slopes[place : place + batch * outputs]
        below = b.obs if i == 0 else b.activations[before:place]
        by_weights = b.gradient[at : at + inputs * outputs]
        product(
            below, 1, inputs, slope, 0, b.zeros, 0, by_weights, inputs, batch, outputs, NO_FLOOR
        )
        by_biases = b.gradient[at + inputs * outputs : at + (inputs + 1) * outputs]
        for o in range(outputs):
            by_biases[o] = 0
            for k in range(batch):
                by_biases[o] += slope[k * outputs + o]
        if i > 0:
            for o in range(outputs):
                for j in range(inputs):
                    b.turned[o * inputs + j] = weights[at + j * outputs + o]
            onward = b.slopes[before:place]
            product(
                slope, outputs, 1, b.turned, 0, b.zeros, 0, onward, batch, outputs, inputs, NO_FLOOR
            )
            for j in range(batch * inputs):
                onward[j] = onward[j] if below[j] > 0 else np.float32(0)


@compiled
def _adam(weights: Any, gradient: Any, mean: Any, square: Any, step: int, rule: StepRule) -> None:
    second = np.sqrt(1 - BETA2**step)
    rate = np.float32(rule.learning_rate * second / (1 - BETA1**step))
    eps = np.float32(rule.eps * second)
    keep1, keep2 = np.float32(BETA1), np.float32(BETA2)
    take1, take2 = np.float32(1 - BETA1), np.float32(1 - BETA2)
    for p in range(len(weights)):
        g = gradient[p]
        mean[p] = keep1 * mean[p] + take1 * g
        square[p] = keep2 * square[p] + take2 * g * g
        weights[p] -= rate * mean[p] / (np.sqrt(square[p]) + eps)


@compiled
def gradient_step(n: int, nets: Networks, rule: StepRule, b: GradientBuffers) -> None:
    """A gradient step of network n on a sample of its memory."""
    sizes, weights, target, rows = nets.sizes, nets.weights[n], nets.target[n], nets.store[n]
    features, moves, batch = sizes[0], sizes[-1], rule.batch
    rest = 2 * features
    size = min(nets.stored[n], len(rows))
    for i in range(batch):
        b.places[i] = np.int64(uniform(nets.keys[n], nets.updates[n], i) * size)
    for i in range(batch):
        for f in range(features):
            b.obs[i * features + f] = rows[b.places[i], f]
            b.next_obs[i * features + f] = rows[b.places[i], features + f]
    at = forward(sizes, target, b.next_obs, batch, b.activations)
    for i in range(batch):
        best = np.float32(-np.inf)
        for action in range(moves):
            q = b.activations[at + i * moves + action]
            if (not nets.masks or rows[b.places[i], rest + MASK + action] != 0) and q > best:
                best = q
        b.wanted[i] = rows[b.places[i], rest + REWARD]
        if rows[b.places[i], rest + GOES_ON] > 0:
            b.wanted[i] += np.float32(rule.gamma) * best
    at = forward(sizes, weights, b.obs, batch, b.activations)
    total = np.float32(0)
    for j in range(at, at + batch * moves):
        b.slopes[j] = 0
    for i in range(batch):
        chosen = at + i * moves + np.int64(rows[b.places[i], rest + MOVE])
        error = b.activations[chosen] - b.wanted[i]
        total += error * error
        b.slopes[chosen] = error * np.float32(2 / batch)
    nets.loss[n] += total / np.float32(batch)
    _backward(sizes, weights, batch, b)
    nets.updates[n] += 1
    _adam(weights, b.gradient, nets.mean[n], nets.square[n], nets.updates[n], rule)
    if rule.target_period > 0 and nets.updates[n] % rule.target_period == 0:
        for p in range(len(weights)):
            target[p] = weights[p]


@allocating
def learn(nets: Networks, due: Any, rule: StepRule) -> None:
    """The ``due`` (L,) gradient steps of every network, one network after the other."""
    buffers = gradient_buffers(nets, rule.batch)
    for n in range(len(due)):
        for _ in range(due[n]):
            gradient_step(n, nets, rule, buffers)


@compiled
def q_values(sizes: Any, weights: Any, obs: Any, activations: Any, out: Any) -> None:
    """Fills ``out`` (…, moves) with the Q values of ``obs`` (…, F) by one network's weights."""
    batch = obs.size // sizes[0]
    at = forward(sizes, weights, obs.reshape(-1), batch, activations)
    flat = out.reshape(-1)
    for i in range(len(flat)):
        flat[i] = activations[at + i]
