"""The replay memory: a ring of transitions for each network, in one store.

A transition is a row of float32 numbers in a whole number of cache lines, so that a sample takes
two or three reads from memory and one gather on a GPU. Where agents see F numbers, a row holds:

====================  ==============================================================================
0 … F − 1             obs
F … 2F − 1            next_obs, in the same task
2F + MOVE             the move
2F + REWARD           its reward
2F + GOES_ON          weight of the value of next_obs, before the factor γ: 0 where the task was
                      joined, otherwise 1. A task that failed only ran out of steps, so its end is
                      bootstrapped like any other step, unless failures are final.
2F + MASK …           A numbers, the action mask of next_obs; with masking only
====================  ==============================================================================

What an agent is paid after its last move, when it is done, is added to that move's reward.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting.batch.step import StepBuffers
from marouting.game import Ending
from marouting.kernels import compiled
from marouting.memory import check_memory
from marouting.problem.grid import MOVES
from policies.learned.checkpoint import checked
from policies.learned.counter_rng import uniforms
from policies.learned.memory.pre_step import PreStep
from policies.learned.per_network import COUNT, PerNetworkState

MOVE, REWARD, GOES_ON, MASK = range(4)
"""Where these stand in a row after the two observations."""

_LINE = 16
"""Numbers in a cache line of 64 bytes."""


def width_of(features: int, masks: int) -> int:
    """Numbers of a row, whole cache lines, for masks of so many actions, or 0 for none."""
    return -(-(2 * features + MASK + masks) // _LINE) * _LINE


@dataclass
class Batch:
    """Transitions of a stack of L networks, B of each.

    Attributes:
        obs: (L, B, *S) float32.
        next_obs: (L, B, *S) float32, in the same task.
        move: (L, B, 1) int64.
        reward: (L, B, 1) float32.
        goes_on: (L, B, 1) float32, weight of the value of ``next_obs`` before the factor γ.
        mask: (L, B, A) float32, action mask of ``next_obs``, or None without masking.
    """

    obs: Tensor
    next_obs: Tensor
    move: Tensor
    reward: Tensor
    goes_on: Tensor
    mask: Tensor | None


class Replay(PerNetworkState):
    """A ring of transitions for each of L networks, sampled uniformly.

    Args:
        keys: (L,) uint64 keys of the samples' random numbers.
        capacity: transitions per network; the oldest goes first.
        obs_shape: of one observation.
        masks: whether to keep action masks.
        device: where the store is.
        agents: (games per network, agents) that may be paid late.
        actions: A.
        final_failures: whether a failed task is not bootstrapped from.
        late: whether agents that are done may be paid.

    Attributes:
        store: (L, capacity, width) float32.
        stored: (L,) int64, transitions ever stored for each network.
    """

    rows: ClassVar[tuple[str, ...]] = ("store", "stored", "keys", "last")

    def __init__(
        self,
        keys: NDArray[np.uint64],
        capacity: int,
        obs_shape: tuple[int, ...],
        masks: bool,
        device: torch.device,
        agents: tuple[int, int] = (0, 0),
        actions: int = MOVES,
        *,
        final_failures: bool = False,
        late: bool = False,
    ) -> None:
        self.final_failures, self.late = final_failures, late
        self.obs_shape, self.masks, self.device = obs_shape, masks, device
        self.actions = actions
        self.features = int(np.prod(obs_shape))
        networks, width = len(keys), width_of(self.features, actions * masks)
        what = "learner.buffer_size: {} transitions of {} numbers"
        check_memory(4 * networks * capacity * width, what, networks * capacity, width)
        # NumPy asks for huge pages where torch does not: samples from all over the store took a
        # third longer without.
        store = np.zeros((networks, capacity, width), np.float32)
        self.store = torch.from_numpy(store).to(device)
        self.stored = np.zeros(networks, np.int64)
        self.keys = torch.from_numpy(keys.view(np.int64)).to(device)
        # The number, from 1, of the transition that ended each agent's last task, or 0.
        self.last = np.zeros((networks, *agents) if late else (networks, 0, 0), np.int64)
        self._place = np.zeros(0, np.int64)
        self.bind()

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "stored": COUNT, "last": COUNT}

    def check(self, state: Mapping[str, Tensor]) -> None:
        """Raises InputError for moves or masks that are none in a checkpoint."""
        first = 2 * self.features
        columns = [(MOVE, "moves", self.actions - 1), (GOES_ON, "weights", 1)]
        if self.masks:
            columns += [(MASK + move, "masks", 1) for move in range(self.actions)]
        for column, what, most in columns:
            numbers = state["store"][..., first + column]
            _ = checked(numbers, numbers, f"store, {what}", (0, most))

    def bind(self) -> None:
        """Renews the device's counts, which on the processor are the same numbers."""
        self._stored = torch.from_numpy(self.stored).to(self.device)

    def add(self, before: PreStep, after: StepBuffers) -> None:
        """Stores the transitions of a step, those of agents that moved.

        Args:
            before: what they saw, of M games, M/L per network, one network's after another's.
            after: the player's buffers after the step.
        """
        _, capacity, width = self.store.shape
        most = after.acted.size
        if self._place.size < most:
            self._place = np.empty(most, np.int64)
        here = self.device.type == "cpu"
        if self.late:
            self._pay_late(before, after)
        rows = (
            self.store.numpy().reshape(-1, width) if here else np.zeros((most, width), np.float32)
        )
        games = len(after.acted)
        count = _add(
            before.agents, before.obs.reshape(games, -1, self.features),
            after.agents, after.obs.reshape(games, -1, self.features), after.mask,
            after.actions, after.acted, after.reward, after.ending,
            after.final_obs.reshape(games, -1, self.features), after.final_mask,
            self.masks, self.final_failures, self.late, self.last,
            capacity, self.stored, self._place, here, rows,
        )  # fmt: skip
        if self.late:  # nothing that is paid in the next episode is for this one
            self.last[after.over.reshape(len(self.last), -1)] = 0
        place = torch.from_numpy(self._place[:count])
        if not here:
            place = place.to(self.device)
            self.store.view(-1, width)[place] = torch.from_numpy(rows[:count]).to(self.device)
            self._stored.copy_(torch.from_numpy(self.stored))

    def _pay_late(self, before: PreStep, after: StepBuffers) -> None:
        """Adds what agents are paid that did not move to the reward of their last moves."""
        networks, capacity, width = self.store.shape
        m, k = np.nonzero(~after.acted & (after.reward != 0))
        games = len(after.acted) // networks
        network, paid = m // games, after.reward[m, k]
        numbers = self.last[network, m % games, before.agents[m, k]]
        kept = (numbers > 0) & (self.stored[network] - numbers < capacity)
        place = (network * capacity + (numbers - 1) % capacity)[kept]
        where = torch.from_numpy(place).to(self.device)
        reward = self.store.view(-1, width)[:, 2 * self.features + REWARD]
        reward.index_add_(0, where, torch.from_numpy(paid[kept]).to(self.device))

    def cut(self) -> None:
        """Pays nobody for tasks that have ended: the games have been started anew."""
        self.last[:] = 0

    def sample(self, size: int, counters: Tensor) -> Batch:
        """A sample with replacement for each network.

        Args:
            size: B, transitions per network.
            counters: (L,) int64 the number of the sample, on the device.
        """
        # A network with nothing stored yet is not updated; its sample only has to exist.
        there = self._stored.clamp(1, self.store.shape[1])
        draws = uniforms(self.keys, counters, torch.arange(size, device=self.device))
        return self._batch((draws * there[:, None]).long())

    def _batch(self, place: Tensor) -> Batch:
        """The transitions at places (L, B)."""
        networks, capacity, width = self.store.shape
        first = capacity * torch.arange(networks, device=self.device)[:, None]
        # One gather over the whole store is several times as quick as one per network.
        rows = self.store.view(-1, width).index_select(0, (place + first).view(-1))
        rows = rows.view(*place.shape, width)
        f, rest = self.features, 2 * self.features
        return Batch(
            obs=rows[..., :f].view(*place.shape, *self.obs_shape),
            next_obs=rows[..., f:rest].view(*place.shape, *self.obs_shape),
            move=rows[..., rest + MOVE, None].long(),
            reward=rows[..., rest + REWARD, None],
            goes_on=rows[..., rest + GOES_ON, None],
            mask=rows[..., rest + MASK : rest + MASK + self.actions] if self.masks else None,
        )


@compiled
def _add(
    agents: Any, obs: Any, next_agents: Any, next_obs: Any, next_mask: Any, actions: Any,
    acted: Any, reward: Any, ending: Any, final_obs: Any, final_mask: Any, masks: bool,
    final_failures: bool, late: bool, last: Any, capacity: int, stored: Any, place: Any,
    here: bool, rows: Any,
) -> int:  # fmt: skip
    """Makes rows of a step's transitions; returns how many."""
    games, features = len(acted) // len(stored), obs.shape[2]
    rest = 2 * features
    count = 0
    for m in range(acted.shape[0]):
        network = m // games
        for k in range(acted.shape[1]):
            if not acted[m, k]:
                continue
            n = agents[m, k]
            ended = ending[m, k] != Ending.NONE
            over = ended or next_agents[m, k] != n
            final = ended and (final_failures or ending[m, k] == Ending.JOINED)
            place[count] = network * capacity + stored[network] % capacity
            row = rows[place[count] if here else count]
            for f in range(features):
                row[f] = obs[m, k, f]
                row[features + f] = final_obs[m, k, f] if over else next_obs[m, k, f]
            row[rest + MOVE] = actions[m, k]
            row[rest + REWARD] = reward[m, k]
            row[rest + GOES_ON] = not final
            if masks:
                for move in range(final_mask.shape[2]):
                    mask = final_mask[m, k, move] if over else next_mask[m, k, move]
                    row[rest + MASK + move] = mask
            stored[network] += 1
            count += 1
            if late:
                last[network, m % games, n] = stored[network] if ended else 0
    return count
