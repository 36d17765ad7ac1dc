"""A gradient step of the DQN compiled for the processor, one network after the other.

The same arithmetic as the torch operations of :mod:`policies.learned.dqn`, on the same memory. For
a network of five thousand weights an operation of torch costs more in calling than in computing;
here a whole step, sampling included, is one call. The products go to BLAS.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from policies.learned.streams import uniform

# Division as in NumPy: checking every divisor for zero would keep Adam from being vectorised.
compiled = njit(cache=True, error_model="numpy")


class Memory(NamedTuple):
    """The stores of :class:`policies.learned.replay.Replay`."""

    seen: NDArray[np.float32]  # (M, C, F)
    arrived: NDArray[np.float32]  # (M, C, F)
    move: NDArray[np.int8]  # (M, C)
    reward: NDArray[np.float32]  # (M, C)
    goes_on: NDArray[np.float32]  # (M, C)
    mask: NDArray[np.int8]  # (M, C, 6), or (M, C, 0) without masking
    stored: NDArray[np.int64]  # (M,)


class Networks(NamedTuple):
    """A stack of M networks of P weights and their optimisers; see :mod:`policies.learned.dqn`."""

    sizes: NDArray[np.int64]  # (layers + 1,) units, inputs first
    weights: NDArray[np.float32]  # (M, P)
    target: NDArray[np.float32]  # (M, P); ``weights`` itself where there is no target network
    mean: NDArray[np.float32]  # (M, P) Adam's mean of the gradients
    square: NDArray[np.float32]  # (M, P) Adam's mean of their squares
    steps: NDArray[np.int64]  # (M,) gradient steps taken


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


@compiled
def _units(sizes: Any) -> int:
    """Units of all layers but the inputs."""
    units = 0
    for i in range(1, len(sizes)):
        units += sizes[i]
    return units


@compiled
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


@compiled
def _backward(
    sizes: Any, flat: Any, x: Any, activations: Any, slope: Any, slopes: Any, gradient: Any
) -> None:
    """Fills ``gradient`` (P,) from the slope of the loss at Q (B, moves)."""
    batch = x.shape[0]
    layers = len(sizes) - 1
    at = len(flat)
    row = batch * _units(sizes)
    for i in range(layers - 1, -1, -1):
        inputs, outputs = sizes[i], sizes[i + 1]
        at -= (inputs + 1) * outputs
        row -= batch * outputs
        before = row - batch * inputs
        below = x if i == 0 else activations[before:row].reshape(batch, inputs)
        np.dot(below.T, slope, gradient[at : at + inputs * outputs].reshape(inputs, outputs))
        bias = gradient[at + inputs * outputs : at + (inputs + 1) * outputs]
        for o in range(outputs):
            bias[o] = 0
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


@compiled
def _adam(weights: Any, gradient: Any, mean: Any, square: Any, step: int, rule: Rule) -> None:
    second = np.sqrt(1 - rule.beta2**step)
    rate = np.float32(rule.learning_rate * second / (1 - rule.beta1**step))
    tiny = np.float32(rule.tiny * second)
    keep1, keep2 = np.float32(rule.beta1), np.float32(rule.beta2)
    take1, take2 = np.float32(1 - rule.beta1), np.float32(1 - rule.beta2)
    for p in range(len(weights)):
        g = gradient[p]
        mean[p] = keep1 * mean[p] + take1 * g
        square[p] = keep2 * square[p] + take2 * g * g
        weights[p] -= rate * mean[p] / (np.sqrt(square[p]) + tiny)


@compiled
def _learn_one(
    m: int,
    nets: Networks,
    memory: Memory,
    keys: Any,
    due: Any,
    rule: Rule,
    loss: Any,
) -> None:
    """The gradient steps of network m, see :func:`learn`."""
    sizes, weights, target = nets.sizes, nets.weights, nets.target
    mean, square, steps = nets.mean, nets.square, nets.steps
    capacity, features = memory.seen.shape[1], memory.seen.shape[2]
    moves, units, batch = sizes[-1], _units(sizes), rule.batch
    masked = memory.mask.shape[2] > 0
    seen = np.empty((batch, features), np.float32)
    arrived = np.empty((batch, features), np.float32)
    activations = np.empty(units * batch, np.float32)
    slopes = np.empty(units * batch, np.float32)
    slope = np.empty((batch, moves), np.float32)
    gradient = np.empty(weights.shape[1], np.float32)
    rows = np.empty(batch, np.int64)
    wanted = np.empty(batch, np.float32)
    size = min(memory.stored[m], capacity)
    loss[m] = 0
    for _ in range(due[m]):
        for b in range(batch):
            row = np.int64(uniform(keys[m], steps[m], b) * size)
            rows[b] = row
            for f in range(features):
                seen[b, f] = memory.seen[m, row, f]
                arrived[b, f] = memory.arrived[m, row, f]
        q = _forward(sizes, target[m], arrived, activations)
        for b in range(batch):
            best = np.float32(-np.inf)
            for move in range(moves):
                if (not masked or memory.mask[m, rows[b], move] != 0) and q[b, move] > best:
                    best = q[b, move]
            wanted[b] = memory.reward[m, rows[b]]
            if memory.goes_on[m, rows[b]] > 0:
                wanted[b] += np.float32(rule.gamma) * best
        q = _forward(sizes, weights[m], seen, activations)
        total = np.float32(0)
        for b in range(batch):
            for move in range(moves):
                slope[b, move] = 0
            move = memory.move[m, rows[b]]
            error = q[b, move] - wanted[b]
            total += error * error
            slope[b, move] = error * np.float32(2 / batch)
        loss[m] += total / np.float32(batch)
        _backward(sizes, weights[m], seen, activations, slope, slopes, gradient)
        steps[m] += 1
        _adam(weights[m], gradient, mean[m], square[m], steps[m], rule)
        if rule.target_period > 0 and steps[m] % rule.target_period == 0:
            for p in range(weights.shape[1]):
                target[m, p] = weights[m, p]


@compiled
def learn(
    nets: Networks,
    memory: Memory,
    keys: Any,
    due: Any,
    rule: Rule,
    loss: Any,
) -> None:
    """The gradient steps that every network is due, each on a sample of its own memory.

    Args:
        nets: the networks; changed.
        memory: the replay stores.
        keys: (M,) uint64 keys of the samples' random numbers.
        due: (M,) int64, how many steps of each.
        rule: how a step is taken.
        loss: (M,) float64, filled with the sum of the steps' losses.
    """
    for m in range(len(nets.steps)):
        _learn_one(m, nets, memory, keys, due, rule, loss)


@njit(cache=True, error_model="numpy", parallel=True)
def learn_threaded(
    nets: Networks,
    memory: Memory,
    keys: Any,
    due: Any,
    rule: Rule,
    loss: Any,
) -> None:
    """:func:`learn`, with the networks shared out among numba's threads.

    Each network is learned by one thread: the results do not depend on how many there are. Numba's
    cache does not look at options, so this has to be a function of its own.
    """
    for m in prange(len(nets.steps)):
        _learn_one(m, nets, memory, keys, due, rule, loss)


@compiled
def values(sizes: Any, weights: Any, seen: Any, out: Any) -> None:
    """Fills ``out`` (M, K, moves) with the Q values of ``seen`` (M, K, F)."""
    scratch = np.empty(_units(sizes) * seen.shape[1], np.float32)
    for m in range(len(weights)):
        q = _forward(sizes, weights[m], seen[m], scratch)
        for k in range(out.shape[1]):
            for move in range(out.shape[2]):
                out[m, k, move] = q[k, move]
