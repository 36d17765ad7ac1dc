"""The fused DQN: play and gradient steps of the paper's setting in one compiled loop.

It gives the same results as :class:`policies.learned.algorithms.dqn.DQN` up to rounding, many times
as fast. :func:`obstacle` says where it applies.
"""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from marouting.batch.state import Dynamic, Static
from marouting.batch.step import FastPath, StepBuffers, step_problem
from marouting.config import check
from marouting.game import Ending
from marouting.kernels import allocating, threaded
from marouting.player import Player
from marouting.problem.grid import MOVES
from policies.learned.algorithms.dqn import DQN, DQNOptions
from policies.learned.compiled.gradient import (
    Networks,
    StepRule,
    gradient_buffers,
    gradient_step,
    learn,
    q_values,
    units_of,
)
from policies.learned.exploration import choose
from policies.learned.learner import Learner, Setup
from policies.learned.memory.replay import GOES_ON, MASK, MOVE, REWARD
from policies.learned.networks.mlp import MLP


def obstacle(setup: Setup, options: DQNOptions) -> str | None:
    """Why the fused DQN does not apply, or None where it does."""
    network, fast = options.network, setup.player.fast
    given = network.options
    reasons = {
        f"device {setup.device}": setup.device.type != "cpu",
        "an observation other than the paper's": not fast.sees_paper,
        "a reward other than the paper's": not fast.pays_prices or fast.pays_others is not None,
        f"network {network.name}": network.cls is not MLP or network.given,
        "a dueling network": network.cls is MLP and given["dueling"],
        "an activation other than relu": network.cls is MLP and given["activation"] != "relu",
        "actions beyond the six moves": setup.player.engine.actions > MOVES,
        "double": options.double,
        "final_failures": options.final_failures,
    }
    return next((f"the fused DQN does not do {r}" for r, holds in reasons.items() if holds), None)


class Play(NamedTuple):
    """What is played beside the games."""

    values: NDArray[np.float32]  # (M, K, 6) what the networks expect of each move
    before: NDArray[np.float32]  # (M, K, F) what agents saw before the step
    keys: NDArray[np.uint64]  # (M,) of the random moves
    counters: NDArray[np.int64]  # (M,)
    epsilon: NDArray[np.float64]  # (M,)
    pending: NDArray[np.int64]  # (L,) moves not yet answered by a gradient step


@allocating
def _remember(
    b: StepBuffers, play: Play, nets: Networks, n: int, m: int, k: int, mover: int
) -> None:
    """Stores the transition of a row that acted."""
    rows, row, features = nets.store[n], nets.stored[n] % nets.store.shape[1], nets.sizes[0]
    ended = b.ending[m, k] != Ending.NONE or b.agents[m, k] != mover
    for f in range(features):
        rows[row, f] = play.before[m, k, f]
        rows[row, features + f] = b.final_obs[m, k, f] if ended else b.obs[m, k, f]
    rest = 2 * features
    rows[row, rest + MOVE] = b.actions[m, k]
    rows[row, rest + REWARD] = b.reward[m, k]
    rows[row, rest + GOES_ON] = b.ending[m, k] != Ending.JOINED
    if nets.masks:
        for move in range(MOVES):
            mask = b.final_mask[m, k, move] if ended else b.mask[m, k, move]
            rows[row, rest + MASK + move] = mask
    nets.stored[n] += 1


@allocating
def _step_network(
    n: int, static: Static, dynamic: Dynamic, b: StepBuffers, kernel_buffers: StepBuffers,
    fast: FastPath, play: Play, nets: Networks, rule: StepRule, steps_per_update: int,
) -> None:  # fmt: skip
    """One step of :meth:`FusedDQN.play` for network n and its games."""
    each = len(b.over) // len(nets.updates)
    first, end = n * each, (n + 1) * each
    rows = b.agents.shape[1]
    activations = np.empty(units_of(nets.sizes) * each * rows, np.float32)
    q_values(nets.sizes, nets.weights[n], b.obs[first:end], activations, play.values[first:end])
    for m in range(first, end):
        choose(
            play.keys, play.counters, play.epsilon, b.active, b.mask, play.values, nets.masks,
            b.actions, m,
        )  # fmt: skip
        mover = b.agents[m, 0]
        for k in range(rows):
            for f in range(b.obs.shape[2]):
                play.before[m, k, f] = b.obs[m, k, f]
        step_problem(static, dynamic, kernel_buffers, fast, m)
        for k in range(rows):
            if b.acted[m, k]:
                who = b.agents[m, k] if fast.everyone else mover
                _remember(b, play, nets, n, m, k, who)
                play.pending[n] += 1
    if play.pending[n] >= steps_per_update:
        buffers = gradient_buffers(nets, rule.batch)
        while play.pending[n] >= steps_per_update:
            play.pending[n] -= steps_per_update
            gradient_step(n, nets, rule, buffers)


@allocating
def _play(
    steps: int, static: Static, dynamic: Dynamic, b: StepBuffers, kernel_buffers: StepBuffers,
    fast: FastPath, play: Play, nets: Networks, rule: StepRule, steps_per_update: int,
) -> None:  # fmt: skip
    """One network after the other in every step."""
    for _ in range(steps):
        for n in range(len(nets.updates)):
            _step_network(
                n, static, dynamic, b, kernel_buffers, fast, play, nets, rule, steps_per_update
            )
        if b.over.any():
            return


@threaded
def _play_threaded(
    steps: int, static: Static, dynamic: Dynamic, b: StepBuffers, kernel_buffers: StepBuffers,
    fast: FastPath, play: Play, nets: Networks, rule: StepRule, steps_per_update: int,
) -> None:  # fmt: skip
    """:func:`_play`, with the networks shared out among threads."""
    # A function of its own: numba's cache does not look at options.
    for _ in range(steps):
        for n in prange(len(nets.updates)):
            _step_network(
                n, static, dynamic, b, kernel_buffers, fast, play, nets, rule, steps_per_update
            )
        if b.over.any():
            return


class FusedDQN(DQN):
    """:class:`policies.learned.algorithms.dqn.DQN`, one network after the other in compiled code.

    It keeps the same things in the same form: each can go on from the other's checkpoint.
    """

    def __init__(self, setup: Setup, options: DQNOptions) -> None:
        super().__init__(setup, options)
        self.backend = "fused"

    @classmethod
    def start(cls, setup: Setup, options: DQNOptions) -> Learner:
        """This learner where it applies, else the one in torch.

        Raises:
            InputError: ``fused`` is true and :func:`obstacle` says why it does not apply.
        """
        reason = obstacle(setup, options)
        check("learner.fused", not options.fused or reason is None, f"false: {reason}")
        plain = reason is not None or options.fused is False
        return DQN(setup, options) if plain else cls(setup, options)

    def bind(self) -> None:
        """Renews what refers to the rows."""
        super().bind()
        o, flat = self.options, self.networks.flat.numpy()
        adam = self.adam
        self._rule = StepRule(o.batch_size, o.gamma, o.target_period, o.learning_rate, adam.eps)
        self._nets = Networks(
            sizes=np.array(self.networks.module.sizes, np.int64),
            weights=flat,
            target=self.target.numpy() if o.target_period else flat,
            mean=adam.mean.numpy(),
            square=adam.square.numpy(),
            loss=self.loss.numpy(),
            updates=self.updates,
            store=self.memory.store.numpy(),
            stored=self.memory.stored,
            masks=o.masking,
            keys=self.memory.keys.numpy().view(np.uint64),
        )

    def play(self, player: Player, steps: int) -> None:
        """See :meth:`policies.learned.learner.Learner.play`."""
        b, explore, engine = player.buffers, self.explore, player.engine
        play = Play(
            np.empty((*b.agents.shape, MOVES), np.float32),
            np.empty(b.obs.shape, np.float32),
            explore.keys.reshape(-1),
            explore.counters.reshape(-1),
            explore.epsilon.reshape(-1),
            self.pending_updates,
        )
        run = _play_threaded if self.setup.threads > 1 else _play
        run(
            steps, engine.static, engine.dynamic, b, player.kernel_buffers, player.fast, play,
            self._nets, self._rule, self.options.steps_per_update,
        )  # fmt: skip

    def learn(self, due: NDArray[np.int64]) -> None:
        """See :meth:`policies.learned.algorithms.dqn.DQN.learn`."""
        learn(self._nets, due, self._rule)

    def state(self) -> dict[str, Tensor]:
        """See :meth:`.PerNetworkState.state`; with the counts that torch works with."""
        self.adam.count.numpy()[:] = self.updates
        return super().state()


class IQL(FusedDQN):
    """Independent Q-learning (Tan, 1993): every net is an agent, and all share one DQN."""

    agents = "multi"
