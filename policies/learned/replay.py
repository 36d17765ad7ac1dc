"""The replay memory of M problems: a ring of transitions for each, in one store."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from marouting.grid import MOVES
from policies.learned.kernel import Memory
from policies.learned.streams import uniform


@dataclass
class Batch:
    """Transitions sampled for a stack of M networks.

    Attributes:
        seen: (M, B, F) float32, observation before the move.
        arrived: (M, B, F) float32, observation where the move arrived, in the same task.
        move: (M, B, 1) int64.
        reward: (M, B, 1) float32.
        goes_on: (M, B, 1) float32, 1 where the task went on or failed: only a joined task ends
            the sum of rewards, running out of steps does not.
        mask: (M, B, 6) int8, action mask where the move arrived, or None without masking.
    """

    seen: Tensor
    arrived: Tensor
    move: Tensor
    reward: Tensor
    goes_on: Tensor
    mask: Tensor | None


class Replay:
    """A ring of transitions for each of M problems.

    Args:
        problems: M.
        capacity: transitions a problem; the oldest goes first.
        features: F, numbers in an observation.
        masks: whether to keep action masks.
    """

    def __init__(self, problems: int, capacity: int, features: int, masks: bool) -> None:
        shape = (problems, capacity)
        self.memory = Memory(
            seen=np.zeros((*shape, features), np.float32),
            arrived=np.zeros((*shape, features), np.float32),
            move=np.zeros(shape, np.int8),
            reward=np.zeros(shape, np.float32),
            goes_on=np.zeros(shape, np.float32),
            mask=np.zeros((*shape, MOVES if masks else 0), np.int8),
            stored=np.zeros(problems, np.int64),
        )
        self._index = np.zeros((0, 0), np.int64)

    @property
    def stored(self) -> NDArray[np.int64]:
        """(M,) transitions ever stored for each problem."""
        return self.memory.stored

    def add(
        self,
        moved: NDArray[np.bool_],
        seen: NDArray[np.float32],
        move: NDArray[np.int8],
        reward: NDArray[np.float32],
        arrived: NDArray[np.float32],
        goes_on: NDArray[np.bool_],
        mask: NDArray[np.int8] | None,
    ) -> None:
        """Stores the transitions of a step.

        Args:
            moved: (M, K) which of the K agents made a move; the others store nothing.
            seen: (M, K, F) observations before the move.
            move: (M, K).
            reward: (M, K).
            arrived: (M, K, F) observations where the moves arrived.
            goes_on: (M, K) false where the move joined the task.
            mask: (M, K, 6) masks where the moves arrived; None without masking.
        """
        if mask is None:
            mask = np.empty((*moved.shape, 0), np.int8)
        _add(self.memory, moved, seen, move, reward, arrived, goes_on, mask)

    def sample(
        self,
        batch: int,
        keys: NDArray[np.uint64],
        counters: NDArray[np.int64],
        device: torch.device,
    ) -> Batch:
        """A uniform sample with replacement for each problem.

        Args:
            batch: B, transitions a problem.
            keys: (M,) keys of :mod:`policies.learned.streams`.
            counters: (M,) the number of the sample.
            device: where the batch is wanted.
        """
        memory = self.memory
        problems, capacity = memory.move.shape
        if self._index.shape != (problems, batch):
            self._index = np.empty((problems, batch), np.int64)
        _indices(keys, counters, np.minimum(memory.stored, capacity), capacity, self._index)

        def rows(store: NDArray[Any]) -> Tensor:
            taken = store.reshape(problems * capacity, -1)[self._index.reshape(-1)]
            return torch.from_numpy(taken).view(problems, batch, -1).to(device)

        return Batch(
            seen=rows(memory.seen),
            arrived=rows(memory.arrived),
            move=rows(memory.move).long(),
            reward=rows(memory.reward),
            goes_on=rows(memory.goes_on),
            mask=rows(memory.mask) if memory.mask.shape[2] else None,
        )


@njit(cache=True)
def _indices(keys: Any, counters: Any, sizes: Any, capacity: int, out: Any) -> None:
    for m in range(out.shape[0]):
        for b in range(out.shape[1]):
            # A problem with nothing stored yet is not updated; its sample only has to exist.
            size = max(sizes[m], 1)
            out[m, b] = m * capacity + np.int64(uniform(keys[m], counters[m], b) * size)


@njit(cache=True)
def _add(
    memory: Memory,
    moved: Any,
    seen: Any,
    move: Any,
    reward: Any,
    arrived: Any,
    goes_on: Any,
    mask: Any,
) -> None:
    capacity = memory.move.shape[1]
    for m in range(moved.shape[0]):
        for k in range(moved.shape[1]):
            if not moved[m, k]:
                continue
            at = memory.stored[m] % capacity
            for f in range(seen.shape[2]):
                memory.seen[m, at, f] = seen[m, k, f]
                memory.arrived[m, at, f] = arrived[m, k, f]
            memory.move[m, at] = move[m, k]
            memory.reward[m, at] = reward[m, k]
            memory.goes_on[m, at] = goes_on[m, k]
            for i in range(mask.shape[2]):
                memory.mask[m, at, i] = mask[m, k, i]
            memory.stored[m] += 1
