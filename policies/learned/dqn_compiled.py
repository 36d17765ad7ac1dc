"""The DQN compiled for the processor, one network after the other.

The same arithmetic as :mod:`policies.learned.dqn_torch`, on the same memory. For a network of five
thousand weights an operation of torch costs more in calling than in computing; here a whole
gradient step, sampling included, is one call, and its numbers stay in the processor's cache.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from marouting.game.state import Dynamic, Static
from policies.learned.compiled.small_gemm import product
from policies.learned.dqn import DQN, Rule
from policies.learned.replay import GOES_ON, MASK, MOVE, REWARD, pack
from policies.learned.stack import Lanes, Rules, Stack, look, move, pick
from policies.learned.streams import uniform

# Division as in NumPy: checking every divisor for zero would keep Adam from being vectorised.
compiled = njit(cache=True, error_model="numpy")


ANY = np.float32(-np.inf)
"""The floor of a product that has none."""


class Networks(NamedTuple):
    """A stack of M networks of P weights and their optimisers; see :mod:`policies.learned.dqn`."""

    sizes: NDArray[np.int64]  # (layers + 1,) units, inputs first
    weights: NDArray[np.float32]  # (M, P)
    target: NDArray[np.float32]  # (M, P); ``weights`` itself where there is no target network
    mean: NDArray[np.float32]  # (M, P) Adam's mean of the gradients
    square: NDArray[np.float32]  # (M, P) Adam's mean of their squares
    loss: NDArray[np.float64]  # (M,) summed over the gradient steps taken
    steps: NDArray[np.int64]  # (M,) gradient steps taken


@compiled
def _units(sizes: Any) -> int:
    """Units of all layers but the inputs."""
    units = 0
    for i in range(1, len(sizes)):
        units += sizes[i]
    return units


@compiled
def _forward(sizes: Any, weights: Any, x: Any, batch: int, activations: Any) -> int:
    """The network for a batch of inputs.

    Args:
        sizes: see :class:`Networks`.
        weights: (P,) one network's.
        x: (batch · F,) the inputs, row after row.
        batch: how many.
        activations: filled with what each layer puts out (batch rows each), one after the other.

    Returns:
        The place of the Q values in ``activations``.
    """
    at, place = 0, 0
    last = len(sizes) - 2
    for i in range(last + 1):
        inputs, outputs = sizes[i], sizes[i + 1]
        y = activations[place : place + batch * outputs]
        bias = at + inputs * outputs
        floor = np.float32(0) if i < last else ANY
        product(x, 0, inputs, 1, weights, at, weights, bias, y, batch, inputs, outputs, floor)
        if i < last:
            place += batch * outputs
        at += (inputs + 1) * outputs
        x = y
    return place


@compiled
def _backward(
    sizes: Any,
    weights: Any,
    x: Any,
    batch: int,
    activations: Any,
    slopes: Any,
    turned: Any,
    zeros: Any,
    ones: Any,
    gradient: Any,
) -> None:
    """The derivatives of a loss by the weights of a network.

    Args:
        sizes: see :class:`Networks`.
        weights: (P,) one network's.
        x: (batch · F,) the inputs.
        batch: how many.
        activations: as :func:`_forward` left them.
        slopes: like ``activations``: the derivatives by what each layer puts out. Those by the Q
            values are given, the others filled.
        turned: scratch for the weights of a layer.
        zeros: as many as a layer has units.
        ones: as many as the batch has rows.
        gradient: (P,) filled.
    """
    at = len(weights)
    place = batch * _units(sizes)
    for i in range(len(sizes) - 2, -1, -1):
        inputs, outputs = sizes[i], sizes[i + 1]
        at -= (inputs + 1) * outputs
        place -= batch * outputs
        before = place - batch * inputs
        slope = slopes[place : place + batch * outputs]
        below = x if i == 0 else activations[before:place]
        bias = at + inputs * outputs
        product(below, 0, 1, inputs, slope, 0, zeros, 0, gradient[at:], inputs, batch, outputs, ANY)
        product(ones, 0, 1, 1, slope, 0, zeros, 0, gradient[bias:], 1, batch, outputs, ANY)
        if i > 0:
            for o in range(outputs):
                for j in range(inputs):
                    turned[o * inputs + j] = weights[at + j * outputs + o]
            onward = slopes[before:place]
            product(slope, 0, outputs, 1, turned, 0, zeros, 0, onward, batch, outputs, inputs, ANY)
            for j in range(batch * inputs):
                onward[j] = onward[j] if below[j] > 0 else np.float32(0)


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


class Scratch(NamedTuple):
    """Working arrays of a gradient step; B transitions, U units in all layers but the inputs."""

    seen: NDArray[np.float32]  # (B F,)
    arrived: NDArray[np.float32]  # (B F,)
    activations: NDArray[np.float32]  # (B U,)
    slopes: NDArray[np.float32]  # (B U,)
    turned: NDArray[np.float32]  # (P,) weights of a layer, columns as rows
    zeros: NDArray[np.float32]  # (U,)
    ones: NDArray[np.float32]  # (B,)
    gradient: NDArray[np.float32]  # (P,)
    taken: NDArray[np.int64]  # (B,) rows of the sample
    wanted: NDArray[np.float32]  # (B,) what the network should have expected


@compiled
def _scratch(nets: Networks, batch: int) -> Scratch:
    units, features, weights = _units(nets.sizes), nets.sizes[0], nets.weights.shape[1]
    return Scratch(
        np.empty(batch * features, np.float32),
        np.empty(batch * features, np.float32),
        np.empty(batch * units, np.float32),
        np.empty(batch * units, np.float32),
        np.empty(weights, np.float32),
        np.zeros(units, np.float32),
        np.ones(batch, np.float32),
        np.empty(weights, np.float32),
        np.empty(batch, np.int64),
        np.empty(batch, np.float32),
    )


@compiled
def _gradient_step(
    n: int, nets: Networks, rows: Any, stored: int, masked: bool, key: Any, rule: Rule, s: Scratch
) -> None:
    """A gradient step of network n.

    Args:
        n: the network.
        nets: all of them; changed.
        rows: (capacity, width) its store, see :mod:`policies.learned.replay`.
        stored: transitions ever stored there.
        masked: whether they hold action masks.
        key: uint64 key of the samples' random numbers.
        rule: how the step is taken.
        s: working arrays.
    """
    sizes, weights, target = nets.sizes, nets.weights[n], nets.target[n]
    features, moves, batch = sizes[0], sizes[-1], rule.batch
    rest = 2 * features
    size = min(stored, len(rows))
    for b in range(batch):
        s.taken[b] = np.int64(uniform(key, nets.steps[n], b) * size)
    for b in range(batch):
        for f in range(features):
            s.seen[b * features + f] = rows[s.taken[b], f]
            s.arrived[b * features + f] = rows[s.taken[b], features + f]
    at = _forward(sizes, target, s.arrived, batch, s.activations)
    for b in range(batch):
        best = np.float32(-np.inf)
        for action in range(moves):
            q = s.activations[at + b * moves + action]
            if (not masked or rows[s.taken[b], rest + MASK + action] != 0) and q > best:
                best = q
        s.wanted[b] = rows[s.taken[b], rest + REWARD]
        if rows[s.taken[b], rest + GOES_ON] > 0:
            s.wanted[b] += np.float32(rule.gamma) * best
    at = _forward(sizes, weights, s.seen, batch, s.activations)
    total = np.float32(0)
    for j in range(at, at + batch * moves):
        s.slopes[j] = 0
    for b in range(batch):
        chosen = at + b * moves + np.int64(rows[s.taken[b], rest + MOVE])
        error = s.activations[chosen] - s.wanted[b]
        total += error * error
        s.slopes[chosen] = error * np.float32(2 / batch)
    nets.loss[n] += total / np.float32(batch)
    _backward(
        sizes, weights, s.seen, batch, s.activations, s.slopes, s.turned, s.zeros, s.ones,
        s.gradient,
    )  # fmt: skip
    nets.steps[n] += 1
    _adam(weights, s.gradient, nets.mean[n], nets.square[n], nets.steps[n], rule)
    if rule.target_period > 0 and nets.steps[n] % rule.target_period == 0:
        for p in range(len(weights)):
            target[p] = weights[p]


@compiled
def _learn(
    nets: Networks, rows: Any, stored: Any, masked: bool, keys: Any, due: Any, rule: Rule
) -> None:
    """The gradient steps that every network is due, ``due`` (L,) int64."""
    scratch = _scratch(nets, rule.batch)
    for n in range(len(due)):
        for _ in range(due[n]):
            _gradient_step(n, nets, rows[n], stored[n], masked, keys[n], rule, scratch)


@compiled
def _q_values(sizes: Any, weights: Any, seen: Any, activations: Any, out: Any) -> None:
    """Fills ``out`` (…, moves) with the Q values of ``seen`` (…, F) by one network's weights."""
    batch = seen.size // sizes[0]
    at = _forward(sizes, weights, seen.reshape(-1), batch, activations)
    flat = out.reshape(-1)
    for i in range(len(flat)):
        flat[i] = activations[at + i]


@compiled
def _values(sizes: Any, weights: Any, seen: Any, out: Any) -> None:
    """Fills ``out`` (L, K, moves) with the Q values of ``seen`` (L, K, F)."""
    activations = np.empty(_units(sizes) * seen.shape[1], np.float32)
    for n in range(len(weights)):
        _q_values(sizes, weights[n], seen[n], activations, out[n])


@compiled
def _play_one(
    n: int,
    steps: int,
    static: Static,
    dynamic: Dynamic,
    lanes: Lanes,
    rules: Rules,
    nets: Networks,
    rows: Any,
    stored: Any,
    keys: Any,
    owed: Any,
    steps_per_update: int,
    rule: Rule,
) -> None:
    """:meth:`policies.learned.dqn.DQN.play` for network n and its problems."""
    each = len(lanes.over) // len(nets.steps)
    first, end = n * each, (n + 1) * each
    agents = lanes.agents.shape[1]
    activations = np.empty(_units(nets.sizes) * each * agents, np.float32)
    scratch = _scratch(nets, rule.batch)
    for _ in range(steps):
        for m in range(first, end):
            look(static, dynamic, lanes, rules, m)
        _q_values(
            nets.sizes, nets.weights[n], lanes.seen[first:end], activations, lanes.values[first:end]
        )
        over = False
        for m in range(first, end):
            pick(dynamic, lanes, rules, m)
            move(static, dynamic, lanes, rules, m)
            over |= lanes.over[m]
            for k in range(agents):
                if lanes.moved[m, k]:
                    pack(lanes, rules.masked, m, k, rows[n], stored[n] % rows.shape[1])
                    stored[n] += 1
                    owed[n] += 1
        while owed[n] >= steps_per_update:
            owed[n] -= steps_per_update
            _gradient_step(n, nets, rows[n], stored[n], rules.masked, keys[n], rule, scratch)
        if over:
            return


@compiled
def _play(
    steps: int,
    static: Static,
    dynamic: Dynamic,
    lanes: Lanes,
    rules: Rules,
    nets: Networks,
    rows: Any,
    stored: Any,
    keys: Any,
    owed: Any,
    steps_per_update: int,
    rule: Rule,
) -> None:
    """One network after the other, each with as many steps as it makes."""
    for n in range(len(nets.steps)):
        _play_one(
            n, steps, static, dynamic, lanes, rules, nets, rows, stored, keys, owed,
            steps_per_update, rule,
        )  # fmt: skip


@njit(cache=True, error_model="numpy", parallel=True)
def _play_threaded(
    steps: int,
    static: Static,
    dynamic: Dynamic,
    lanes: Lanes,
    rules: Rules,
    nets: Networks,
    rows: Any,
    stored: Any,
    keys: Any,
    owed: Any,
    steps_per_update: int,
    rule: Rule,
) -> None:
    """:func:`_play`, with the networks shared out among numba's threads.

    Each network and its problems belong to one thread: the results do not depend on how many there
    are. Numba's cache does not look at options, so this has to be a function of its own.
    """
    for n in prange(len(nets.steps)):
        _play_one(
            n, steps, static, dynamic, lanes, rules, nets, rows, stored, keys, owed,
            steps_per_update, rule,
        )  # fmt: skip


class CompiledDQN(DQN):
    """:class:`policies.learned.dqn.DQN` on the processor, one network after the other."""

    def _bind(self) -> None:
        self._nets = Networks(
            sizes=np.array(self.sizes, np.int64),
            weights=self.weights.numpy(),
            target=self.target.numpy(),
            mean=self.mean.numpy(),
            square=self.square.numpy(),
            loss=self.loss.numpy(),
            steps=self.steps,
        )

    def values(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """(L, K, 6) float32 Q values of observations (L, K, F) float32."""
        out = np.empty((*seen.shape[:2], self.sizes[-1]), np.float32)
        _values(self._nets.sizes, self._nets.weights, seen, out)
        return out

    def learn(self, due: NDArray[np.integer]) -> None:
        """See :meth:`policies.learned.dqn.DQN.learn`."""
        replay = self.replay
        rows = replay.rows.numpy()
        due = due.astype(np.int64)
        _learn(self._nets, rows, replay.stored, replay.masks, self.keys, due, self.rule)

    def play(self, stack: Stack, steps: int) -> None:
        """See :meth:`policies.learned.dqn.DQN.play`; whole steps, one network after the other."""
        replay, engine = self.replay, stack.engine
        (_play_threaded if self.threads > 1 else _play)(
            steps,
            engine.static,
            engine.dynamic,
            stack.lanes,
            stack.rules,
            self._nets,
            replay.rows.numpy(),
            replay.stored,
            self.keys,
            self.owed,
            self.steps_per_update,
            self.rule,
        )
