"""Exploration: epsilon-greedy moves, or moves sampled from a softmax.

The random numbers of a game are functions of its key and the number of the step
(:mod:`policies.learned.counter_rng`), so its moves do not depend on other games.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.step import StepBuffers
from marouting.game import NOBODY
from marouting.kernels import compiled
from policies.learned.counter_rng import uniform
from policies.learned.per_network import COUNT, PerNetworkState


class Exploration(PerNetworkState):
    """The random numbers of all games.

    Args:
        keys: (L, games / L) uint64, of each network's games.

    Attributes:
        counters: (L, games / L) int64, steps in which an agent was active.
        epsilon: (L, games / L) float64, chance of a random move; 1 until it is set.
    """

    rows = ("keys", "counters", "epsilon")

    def __init__(self, keys: NDArray[np.uint64]) -> None:
        self.keys = keys.copy()
        self.counters = np.zeros(keys.shape, np.int64)
        self.epsilon = np.ones(keys.shape)

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "counters": COUNT, "epsilon": (0.0, 1.0)}

    def epsilon_greedy(self, now: StepBuffers, values: NDArray[np.float32], masking: bool) -> None:
        """Writes the best moves, or with probability ε random ones, into a player's buffers.

        Args:
            now: the player's buffers, of M games of K rows.
            values: (M, K, A) the networks' values of the moves.
            masking: whether only moves that cross an edge are chosen.
        """
        _epsilon_greedy(
            self.keys.reshape(-1), self.counters.reshape(-1), self.epsilon.reshape(-1),
            now.active, now.mask, values, masking, now.actions,
        )  # fmt: skip

    def sample(
        self,
        now: StepBuffers,
        movers: NDArray[np.bool_],
        scores: NDArray[np.float32],
        masking: bool,
        chance: NDArray[np.float32],
    ) -> None:
        """Samples moves from the softmax of their scores and writes them into a player's buffers.

        Args:
            now: the player's buffers, of M games of K rows.
            movers: (M, K) rows whose agents move in the next step, see :attr:`.Player.movers`.
            scores: (M, K, A) logits of the moves.
            masking: whether only moves that cross an edge are chosen.
            chance: (M, K) filled with the log-probabilities of the chosen moves.
        """
        _sample(
            self.keys.reshape(-1), self.counters.reshape(-1), movers, now.mask, scores,
            masking, now.actions, chance,
        )  # fmt: skip


@compiled
def _epsilon_greedy(
    keys: Any, counters: Any, epsilon: Any, active: Any, masks: Any, values: Any, masking: bool,
    actions: Any,
) -> None:  # fmt: skip
    for m in range(len(keys)):
        choose(keys, counters, epsilon, active, masks, values, masking, actions, m)


@compiled
def choose(
    keys: Any, counters: Any, epsilon: Any, active: Any, masks: Any, values: Any, masking: bool,
    actions: Any, m: int,
) -> None:  # fmt: skip
    """ε-greedy moves of game m; the arrays are those of all M games."""
    asked = False
    for k in range(active.shape[1]):
        actions[m, k] = NOBODY
        if not active[m, k]:
            continue
        asked = True
        # Two numbers per row: whether to explore, and where to.
        if uniform(keys[m], counters[m], 2 * k) < epsilon[m]:
            allowed = masks.shape[2]
            if masking:
                allowed = 0
                for move in range(masks.shape[2]):
                    allowed += masks[m, k, move]
            left = np.int64(uniform(keys[m], counters[m], 2 * k + 1) * allowed)
            for move in range(masks.shape[2]):
                if masking and masks[m, k, move] == 0:
                    continue
                if left == 0:
                    actions[m, k] = move
                    break
                left -= 1
            continue
        best = NOBODY
        for move in range(masks.shape[2]):
            if masking and masks[m, k, move] == 0:
                continue
            if best == NOBODY or values[m, k, move] > values[m, k, best]:
                best = move
        actions[m, k] = best
    counters[m] += asked


@compiled
def _sample(
    keys: Any, counters: Any, movers: Any, masks: Any, scores: Any, masking: bool, actions: Any,
    chance: Any,
) -> None:  # fmt: skip
    for m in range(len(keys)):
        asked = False
        for k in range(movers.shape[1]):
            actions[m, k] = NOBODY
            if not movers[m, k]:
                continue
            asked = True
            most = np.float32(-np.inf)
            for move in range(masks.shape[2]):
                if (not masking or masks[m, k, move] != 0) and scores[m, k, move] > most:
                    most = scores[m, k, move]
            total = 0.0
            for move in range(masks.shape[2]):
                if not masking or masks[m, k, move] != 0:
                    total += np.exp(scores[m, k, move] - most)
            left = uniform(keys[m], counters[m], k) * total
            for move in range(masks.shape[2]):
                if not masking or masks[m, k, move] != 0:
                    # Should rounding leave something over, the last of them is chosen.
                    actions[m, k] = move
                    left -= np.exp(scores[m, k, move] - most)
                    if left < 0:
                        break
            chance[m, k] = scores[m, k, actions[m, k]] - most - np.log(total)
        counters[m] += asked
