"""Rollouts: the transitions since the last update, each used for one update.

A network's transitions lie one after another in the order of play. Those of one agent are found by
its *stream*, a number of its own, so that agents may move at different times, or stop. As soon as
a network has a rollout's worth of transitions they are learned from; what has come in beyond that
with the same step is the start of the next rollout.

Rewards may pay agents that are done. Then the last transition of an agent waits until its game is
over, or the agent is ripped up and moves again. Everything that the agent is paid until then is
part of that transition's reward.
"""

import math
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting.batch.step import StepBuffers
from marouting.game import Ending
from marouting.kernels import compiled
from marouting.memory import check_memory
from policies.learned.counter_rng import uniform
from policies.learned.memory.pre_step import PreStep
from policies.learned.per_network import PerNetworkState

LONGEST = 65536
"""The most transitions of a rollout: as many random numbers belong to one counter."""


_OF_TRANSITION = (
    "obs", "mask", "action", "chance", "value", "reward", "ending", "after", "stream", "state_",
)  # fmt: skip
"""Arrays of a rollout with a row for each transition."""


class Rollout(PerNetworkState):
    """The rollouts of L networks.

    Args:
        networks: L.
        size: transitions of a rollout.
        games: games per network.
        rows: K, rows per game.
        agents: agents per game.
        actions: A.
        obs_shape: of one observation.
        state_shape: of what else the critic sees; () for nothing.
        scale: factor of all rewards.
        late: whether agents that are done may be paid.

    Attributes:
        obs: (L, C, *S) float32.
        mask: (L, C, A) int8.
        action: (L, C) int64.
        chance: (L, C) float32, logarithm of the action's chance when it was chosen.
        value: (L, C) float32, what the critic expected.
        reward: (L, C) float32.
        ending: (L, C) int8 Ending of the task with the transition.
        after: (L, C) float32, what the critic expected where a task failed.
        stream: (L, C) int64.
        state_: (L, C, *state_shape) float32.
        count: (L,) int64, transitions there are.
        waits: (L, streams) bool, whether the last transition of an agent waits, in the place of its
            stream behind all others.
    """

    rows: ClassVar[tuple[str, ...]] = (*_OF_TRANSITION, "count", "waits")

    def __init__(
        self,
        networks: int,
        size: int,
        games: int,
        rows: int,
        agents: int,
        actions: int,
        obs_shape: tuple[int, ...],
        state_shape: tuple[int, ...] = (),
        scale: float = 1.0,
        *,
        late: bool = False,
    ) -> None:
        self.size, self.agents, self.scale, self.late = size, agents, scale, late
        self.streams = games * agents
        # A step brings transitions, and ends the waiting of others.
        self._waiting = size + games * rows + self.streams * late
        each = networks, self._waiting + self.streams * late
        numbers = math.prod(obs_shape) + math.prod(state_shape) * bool(state_shape) + actions
        what = "learner.rollout: {} transitions of {} numbers"
        check_memory(4 * math.prod(each) * numbers, what, math.prod(each), numbers)
        self.waits = np.zeros((networks, self.streams * late), np.bool_)
        self.obs = np.zeros((*each, *obs_shape), np.float32)
        self.mask = np.ones((*each, actions), np.int8)
        self.action, self.stream = np.zeros((2, *each), np.int64)
        self.chance, self.value, self.reward, self.after = np.zeros((4, *each), np.float32)
        self.ending = np.zeros(each, np.int8)
        self.state_ = np.zeros((*each, *state_shape) if state_shape else (*each, 0), np.float32)
        self.count = np.zeros(networks, np.int64)

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {
            **super().limits(),
            "mask": (0, 1),
            "action": (0, self.mask.shape[2] - 1),
            "ending": (0, max(Ending)),
            "stream": (0, self.streams - 1),
            "count": (0, self.size - 1),
        }

    def add(
        self,
        before: PreStep,
        after: StepBuffers,
        chance: NDArray[np.float32],
        value: NDArray[np.float32],
        final_value: NDArray[np.float32],
        states: NDArray[np.float32] | None,
    ) -> None:
        """Takes in a step.

        Args:
            before: what the agents saw.
            after: the player's buffers after the step.
            chance: (M, K) logarithms of the chances of the actions.
            value: (M, K) what the critic expected before the step.
            final_value: (M, K) what it expects where a task failed.
            states: (M, *state_shape) what else the critic saw, or None.
        """
        m, k = np.nonzero(after.acted)
        games = len(after.acted) // len(self.count)
        n, stream = m // games, m % games * self.agents + before.agents[m, k]
        waits = np.zeros(len(m), np.bool_)
        if self.late:
            waits = (~after.active & ~after.over[:, None])[m, k]
            self._pay_late(after, n, stream)
        at = np.empty(len(m), np.int64)
        at[waits], at[~waits] = self._waiting + stream[waits], self._places(n[~waits])
        self.obs[n, at], self.mask[n, at] = before.obs[m, k], before.mask[m, k]
        self.action[n, at], self.ending[n, at] = after.actions[m, k], after.ending[m, k]
        self.reward[n, at] = self.scale * after.reward[m, k].astype(np.float64)
        self.chance[n, at], self.value[n, at] = chance[m, k], value[m, k]
        self.after[n, at] = final_value[m, k]
        self.stream[n, at] = stream
        if states is not None:
            self.state_[n, at] = states[m]
        if self.late:
            self.waits[n[waits], stream[waits]] = True

    def _places(self, n: NDArray[np.int64]) -> NDArray[np.int64]:
        """(B,) places for further transitions of networks (B,), which are in ascending order."""
        at = self.count[n] + np.arange(len(n)) - np.searchsorted(n, n)
        self.count += np.bincount(n, minlength=len(self.count))
        return at

    def _pay_late(
        self, after: StepBuffers, moved: NDArray[np.int64], streams: NDArray[np.int64]
    ) -> None:
        """Pays the transitions that wait; those of games that are over wait no longer.

        Nor do those of agents that have moved again: of networks ``moved`` (B,) and ``streams``
        (B,).
        """
        networks = len(self.count)
        again = np.zeros_like(self.waits)
        again[moved, streams] = True
        paid = self.scale * after.reward.astype(np.float64).reshape(networks, -1)
        self.reward[:, self._waiting :] += np.where(self.waits & ~again, paid, 0)
        over = np.repeat(after.over, self.agents).reshape(networks, -1)
        over = (over | again) & self.waits
        n, stream = np.nonzero(over)
        at = self._places(n)
        for name in _OF_TRANSITION:
            row = getattr(self, name)
            row[n, at] = row[n, self._waiting + stream]
        self.waits &= ~over

    def full(self) -> NDArray[np.int64]:
        """(D,) the networks that have a rollout's worth."""
        return np.flatnonzero(self.count >= self.size)

    def advantages(
        self, which: NDArray[np.int64], last: NDArray[np.float32], gamma: float, lam: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Generalised advantage estimates (Schulman et al., 2016), and returns.

        Args:
            which: (D,) networks.
            last: (L, streams) what the critic expects of every agent now.
            gamma: discount factor.
            lam: λ, the weight of longer sums of rewards.

        Returns:
            (D, size) float32 advantages and (D, size) float32 returns, advantage plus value.
        """
        if self.late:  # what comes next for those whose last transition waits
            last = np.where(self.waits, self.value[:, self._waiting :], last)
        advantage = np.empty((len(which), self.action.shape[1]), np.float32)
        ahead, gain = np.empty((2, self.streams), np.float32)
        for i, n in enumerate(which.tolist()):
            _advantages(
                self.stream[n], self.ending[n], self.reward[n], self.value[n], self.after[n],
                self.count[n], last[n], gamma, lam, ahead, gain, advantage[i],
            )  # fmt: skip
        advantage = advantage[:, : self.size]
        return advantage, advantage + self.value[which, : self.size]

    def tensor(self, name: str, n: int, device: torch.device) -> Tensor:
        """(size, …) what network n's rollout holds under a name, on a device."""
        return torch.from_numpy(getattr(self, name)[n, : self.size]).to(device)

    def drop(self, which: NDArray[np.int64]) -> None:
        """Forgets the rollouts of networks; what came in beyond them moves to the front."""
        for n in which.tolist():
            left = self.count[n] - self.size
            for name in _OF_TRANSITION:
                row = getattr(self, name)[n]
                row[:left] = row[self.size : self.size + left]
            self.count[n] = left


def shuffled(size: int, key: np.uint64, counter: np.int64) -> NDArray[np.int64]:
    """(size,) the numbers from 0 in an order that the key and counter decide."""
    order = np.arange(size)
    _shuffle(order, key, counter)
    return order


@compiled
def _shuffle(order: Any, key: Any, counter: int) -> None:
    for i in range(len(order) - 1, 0, -1):
        j = np.int64(uniform(key, counter, i) * (i + 1))
        order[i], order[j] = order[j], order[i]


@compiled
def _advantages(
    stream: Any, ending: Any, reward: Any, value: Any, after: Any, count: int, last: Any,
    gamma: float, lam: float, ahead: Any, gain: Any, advantage: Any,
) -> None:  # fmt: skip
    """Advantages of one network's transitions, from the last to the first."""
    for s in range(len(ahead)):
        ahead[s], gain[s] = last[s], 0
    for i in range(count - 1, -1, -1):
        s = stream[i]
        # The next task of an agent is no consequence of this one, however it ended.
        if ending[i] == Ending.JOINED:
            ahead[s], gain[s] = 0, 0
        elif ending[i] == Ending.FAILED:
            ahead[s], gain[s] = after[i], 0
        gain[s] = reward[i] + gamma * ahead[s] - value[i] + gamma * lam * gain[s]
        ahead[s] = value[i]
        advantage[i] = gain[s]
