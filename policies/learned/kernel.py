"""A gradient step of the DQN compiled for the processor, one network after the other.

The same arithmetic as the torch operations of :mod:`policies.learned.dqn`, on the same memory. For
a network of five thousand weights an operation of torch costs more in calling than in computing;
here a whole step, sampling included, is one call. The products go to BLAS.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from policies.learned.streams import uniform


class Memory(NamedTuple):
    """The stores of :class:`policies.learned.replay.Replay`."""

    seen: NDArray[np.float32]  # (M, C, F)
    arrived: NDArray[np.float32]  # (M, C, F)
    move: NDArray[np.int8]  # (M, C)
    reward: NDArray[np.float32]  # (M, C)
    goes_on: NDArray[np.float32]  # (M, C)
    mask: NDArray[np.int8]  # (M, C, 6), or (M, C, 0) without masking
    stored: NDArray[np.int64]  # (M,)


class Adam(NamedTuple):
    """The optimiser's parameters."""

    learning_rate: float
    beta1: float
    beta2: float
    tiny: float


@njit(cache=True)
def _forward(sizes: Any, flat: Any, x: Any, activations: Any) -> Any:
    """Q (B, moves) of x (B, F); hidden activations go into ``activations`` (units, B) rows."""
    at, row = 0, 0
    last = len(sizes) - 2
    batch = x.shape[0]
    for i in range(last + 1):
        inputs, outputs = sizes[i], sizes[i + 1]
        weights = flat[at : at + inputs * outputs].reshape(inputs, outputs)
        bias = flat[at + inputs * outputs : at + (inputs + 1) * outputs]
        y = activations[row : row + batch * outputs].reshape(batch, outputs)
        np.dot(x, weights, y)
        for b in range(batch):
            for o in range(outputs):
                value = y[b, o] + bias[o]
                y[b, o] = value if i == last or value > 0 else np.float32(0)
        at += (inputs + 1) * outputs
        row += batch * outputs
        x = y
    return x


@njit(cache=True)
def _backward(
    sizes: Any, flat: Any, x: Any, activations: Any, slope: Any, slopes: Any, gradient: Any
) -> None:
    """Fills ``gradient`` (P,) from the slope of the loss at Q (B, moves)."""
    batch = x.shape[0]
    layers = len(sizes) - 1
    at = len(flat)
    row = batch * (sizes[1:].sum())
    for i in range(layers - 1, -1, -1):
        inputs, outputs = sizes[i], sizes[i + 1]
        at -= (inputs + 1) * outputs
        row -= batch * outputs
        before = row - batch * inputs
        below = x if i == 0 else activations[before:row].reshape(batch, inputs)
        np.dot(below.T, slope, gradient[at : at + inputs * outputs].reshape(inputs, outputs))
        bias = gradient[at + inputs * outputs : at + (inputs + 1) * outputs]
        bias[:] = 0
        for b in range(batch):
            for o in range(outputs):
                bias[o] += slope[b, o]
        if i > 0:
            weights = flat[at : at + inputs * outputs].reshape(inputs, outputs)
            onward = slopes[before:row].reshape(batch, inputs)
            np.dot(slope, weights.T, onward)
            for b in range(batch):
                for o in range(inputs):
                    if below[b, o] <= 0:
                        onward[b, o] = 0
            slope = onward


@njit(cache=True)
def _adam(weights: Any, gradient: Any, mean: Any, square: Any, step: int, adam: Adam) -> None:
    second = np.sqrt(1 - adam.beta2**step)
    rate = np.float32(adam.learning_rate * second / (1 - adam.beta1**step))
    tiny = np.float32(adam.tiny * second)
    keep1, keep2 = np.float32(adam.beta1), np.float32(adam.beta2)
    take1, take2 = np.float32(1 - adam.beta1), np.float32(1 - adam.beta2)
    for p in range(len(weights)):
        g = gradient[p]
        mean[p] = keep1 * mean[p] + take1 * g
        square[p] = keep2 * square[p] + take2 * g * g
        weights[p] -= rate * mean[p] / (np.sqrt(square[p]) + tiny)


@njit(cache=True)
def learn(
    sizes: Any,
    weights: Any,
    target: Any,
    mean: Any,
    square: Any,
    steps: Any,
    memory: Memory,
    keys: Any,
    chosen: Any,
    batch: int,
    gamma: float,
    target_period: int,
    adam: Adam,
    loss: Any,
) -> None:
    """One gradient step of every chosen network on a sample of its own memory.

    Args:
        sizes: (layers + 1,) int64 units, inputs first.
        weights: (M, P) float32; changed.
        target: (M, P) float32; changed. ``weights`` itself where there is no target network.
        mean: (M, P) float32, Adam's mean of the gradients; changed.
        square: (M, P) float32, Adam's mean of their squares; changed.
        steps: (M,) int64 gradient steps taken; changed.
        memory: the replay stores.
        keys: (M,) uint64 keys of the samples' random numbers.
        chosen: (M,) bool.
        batch: transitions a sample.
        gamma: discount factor.
        target_period: see :class:`policies.learned.dqn.DQN`.
        adam: the optimiser's parameters.
        loss: (M,) float32, filled for the chosen ones.
    """
    capacity, features = memory.seen.shape[1], memory.seen.shape[2]
    moves = sizes[-1]
    units = sizes[1:].sum()
    seen = np.empty((batch, features), np.float32)
    arrived = np.empty((batch, features), np.float32)
    activations = np.empty(units * batch, np.float32)
    slopes = np.empty(units * batch, np.float32)
    gradient = np.empty(weights.shape[1], np.float32)
    rows = np.empty(batch, np.int64)
    wanted = np.empty(batch, np.float32)
    masked = memory.mask.shape[2] > 0
    for m in range(len(steps)):
        if not chosen[m]:
            continue
        size = min(memory.stored[m], capacity)
        for b in range(batch):
            rows[b] = np.int64(uniform(keys[m], steps[m], b) * size)
            seen[b] = memory.seen[m, rows[b]]
            arrived[b] = memory.arrived[m, rows[b]]
        q = _forward(sizes, target[m], arrived, activations)
        for b in range(batch):
            best = np.float32(-np.inf)
            for move in range(moves):
                if (not masked or memory.mask[m, rows[b], move] != 0) and q[b, move] > best:
                    best = q[b, move]
            wanted[b] = memory.reward[m, rows[b]]
            if memory.goes_on[m, rows[b]] > 0:
                wanted[b] += np.float32(gamma) * best
        q = _forward(sizes, weights[m], seen, activations)
        slope = np.zeros((batch, moves), np.float32)
        total = np.float32(0)
        for b in range(batch):
            move = memory.move[m, rows[b]]
            error = q[b, move] - wanted[b]
            total += error * error
            slope[b, move] = error * np.float32(2 / batch)
        loss[m] = total / np.float32(batch)
        _backward(sizes, weights[m], seen, activations, slope, slopes, gradient)
        steps[m] += 1
        _adam(weights[m], gradient, mean[m], square[m], steps[m], adam)
        if target_period > 0 and steps[m] % target_period == 0:
            target[m] = weights[m]


@njit(cache=True)
def values(sizes: Any, weights: Any, seen: Any, out: Any) -> None:
    """Fills ``out`` (M, K, moves) with the Q values of ``seen`` (M, K, F)."""
    scratch = np.empty(sizes[1:].sum() * seen.shape[1], np.float32)
    for m in range(len(weights)):
        out[m] = _forward(sizes, weights[m], seen[m], scratch)
