"""The replay memory: a ring of transitions for each network, in one store.

A transition is a row of float32 numbers in a whole number of cache lines, so that a sample takes
two or three reads from memory and one gather on a GPU. In a row of an environment that shows F
numbers:

====================  ==============================================================================
0 … F − 1             observation before the move
F … 2F − 1            observation where the move arrived, in the same task
2F + MOVE             the move
2F + REWARD           its reward
2F + GOES_ON          1 where the task went on or failed: only a joined task ends the sum of
                      rewards, running out of steps does not
2F + MASK …           six numbers, the action mask where the move arrived; with masking only
====================  ==============================================================================
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from marouting.problem.grid import MOVES
from policies.learned.stack import Lanes
from policies.learned.streams import uniforms

MOVE, REWARD, GOES_ON, MASK = range(4)
"""Where these stand in a row after the two observations."""

_LINE = 16
"""Numbers in a cache line of 64 bytes."""

Rows = TypeVar("Rows", NDArray[Any], Tensor)


@dataclass
class Batch:
    """Transitions of a stack of L networks, B of each.

    Attributes:
        seen: (L, B, F) float32, observation before the move.
        arrived: (L, B, F) float32, observation where the move arrived, in the same task.
        move: (L, B, 1) int64.
        reward: (L, B, 1) float32.
        goes_on: (L, B, 1) float32, 1 where the task went on or failed, 0 where it was joined.
        mask: (L, B, 6) float32, action mask where the move arrived, or None without masking.
    """

    seen: Tensor
    arrived: Tensor
    move: Tensor
    reward: Tensor
    goes_on: Tensor
    mask: Tensor | None

    @staticmethod
    def of(rows: Tensor, features: int, masks: bool) -> "Batch":
        """The fields of rows (L, B, width)."""
        rest = 2 * features
        return Batch(
            seen=rows[..., :features],
            arrived=rows[..., features:rest],
            move=rows[..., rest + MOVE, None].long(),
            reward=rows[..., rest + REWARD, None],
            goes_on=rows[..., rest + GOES_ON, None],
            mask=rows[..., rest + MASK : rest + MASK + MOVES] if masks else None,
        )


class Replay:
    """A ring of transitions for each of L networks.

    Args:
        networks: L.
        capacity: transitions a network; the oldest goes first.
        features: F, numbers in an observation.
        masks: whether to keep action masks.
        device: where the store is.

    Attributes:
        rows: (L, capacity, width) float32, the store.
        stored: (L,) int64, transitions ever stored for each network.
    """

    def __init__(
        self,
        networks: int,
        capacity: int,
        features: int,
        masks: bool,
        device: torch.device | None = None,
    ) -> None:
        self.features, self.masks = features, masks
        used = 2 * features + MASK + (MOVES if masks else 0)
        width = -(-used // _LINE) * _LINE
        # NumPy asks for huge pages where torch does not: samples from all over the store took a
        # third longer without.
        rows = np.zeros((networks, capacity, width), np.float32)
        self.rows = torch.from_numpy(rows).to(device or torch.device("cpu"))
        self.stored = np.zeros(networks, np.int64)
        self._place = np.zeros(0, np.int64)

    def keep(self, which: NDArray[np.integer]) -> None:
        """Goes on with the networks of some rows alone (ascending)."""
        self.rows = kept(self.rows, which)
        self.stored = self.stored[which]

    def add(self, lanes: Lanes) -> None:
        """Stores the transitions of a step, those of agents that moved.

        Args:
            lanes: of M problems, M/L for each network, one network's after the other's.
        """
        networks, capacity, width = self.rows.shape
        if self.rows.device.type == "cpu":
            rows = self.rows.numpy().reshape(-1, width)
            _add(lanes, self.masks, capacity, self.stored, self._place, rows)
            return
        if self._place.size < lanes.moved.size:
            self._place = np.empty(lanes.moved.size, np.int64)
        packed = np.zeros((lanes.moved.size, width), np.float32)
        count = _add(lanes, self.masks, capacity, self.stored, self._place, packed)
        place = torch.from_numpy(self._place[:count]).to(self.rows.device)
        store = self.rows.view(networks * capacity, width)
        store[place] = torch.from_numpy(packed[:count]).to(self.rows.device)

    def sample(self, batch: int, keys: Tensor, counters: Tensor, stored: Tensor) -> Batch:
        """A uniform sample with replacement for each network.

        Args:
            batch: B, transitions a network.
            keys: (L,) int64 keys of :mod:`policies.learned.streams`, on the device.
            counters: (L,) int64 the number of the sample, on the device.
            stored: (L,) int64, :attr:`stored` on the device.
        """
        networks, capacity, width = self.rows.shape
        # A network with nothing stored yet is not updated; its sample only has to exist.
        size = stored.clamp(1, capacity)
        lanes = torch.arange(batch, device=keys.device)
        row = (uniforms(keys, counters, lanes) * size[:, None]).long()
        row += capacity * torch.arange(networks, device=keys.device)[:, None]
        taken = self.rows.view(-1, width)[row.view(-1)]
        return Batch.of(taken.view(networks, batch, width), self.features, self.masks)


def kept(store: Rows, which: NDArray[np.integer]) -> Rows:
    """Some rows of a store (ascending), moved up in place: no second store while they are."""
    for to, row in enumerate(which.tolist()):
        if to != row:
            store[to] = store[row]
    return store[: len(which)]


@njit(cache=True)
def pack(lanes: Lanes, masked: bool, m: int, k: int, rows: Any, row: int) -> None:
    """Makes a row of the transition of an agent that moved."""
    features = lanes.seen.shape[2]
    for f in range(features):
        rows[row, f] = lanes.seen[m, k, f]
        rows[row, features + f] = lanes.arrived[m, k, f]
    rows[row, 2 * features + MOVE] = lanes.moves[m, k]
    rows[row, 2 * features + REWARD] = lanes.reward[m, k]
    rows[row, 2 * features + GOES_ON] = lanes.goes_on[m, k]
    if masked:
        for i in range(MOVES):
            rows[row, 2 * features + MASK + i] = lanes.arrived_mask[m, k, i]


@njit(cache=True)
def _add(lanes: Lanes, masked: bool, capacity: int, stored: Any, place: Any, rows: Any) -> int:
    """Makes rows of the transitions of a step.

    Args:
        lanes: the step.
        masked: whether rows hold masks.
        capacity: of the store.
        stored: (L,) counts on.
        place: filled with the places in the store that the rows belong into; empty: then they are
            written there.
        rows: (places, width) float32, the store; or filled, from the first row, with what is to be
            put into it.

    Returns:
        How many rows there are.
    """
    each = len(lanes.over) // len(stored)
    count = 0
    for m in range(lanes.moved.shape[0]):
        for k in range(lanes.moved.shape[1]):
            if not lanes.moved[m, k]:
                continue
            network = m // each
            row = network * capacity + stored[network] % capacity
            if len(place) > 0:
                place[count] = row
                row = count
            pack(lanes, masked, m, k, rows, row)
            stored[network] += 1
            count += 1
    return count
