"""Games played to their end by the best moves of small networks, in one compiled loop."""

import numpy as np
from numpy.typing import NDArray
from torch import nn

from marouting.game.growth import lacks_room
from marouting.game.state import Dynamic, Static
from marouting.kernels import allocating, wide
from marouting.player import Known, Player, StepBuffers, step_problem
from marouting.problem.grid import MOVES
from policies.learned.compiled.gradient import q_values, units_of
from policies.learned.exploration import choose
from policies.learned.networks.mlp import MLP


def applies(player: Player, module: nn.Module) -> bool:
    """Whether :func:`play_out` does a network of this kind, in these games."""
    plain = isinstance(module, MLP) and module.activation == "relu" and not module.dueling
    known = player.known
    return plain and known.observation and known.reward and player.engine.actions == MOVES


def play_out(
    player: Player, sizes: tuple[int, ...], weights: NDArray[np.float32], *, masking: bool
) -> None:
    """Plays the games of a player to their end, always by the move that is rated highest.

    Args:
        player: of M games, whose episodes have begun.
        sizes: units of the layers, inputs first.
        weights: (R, P) of the networks that play M/R games each, one network's after another's.
        masking: whether only moves that cross an edge are chosen.
    """
    engine, layers = player.engine, np.array(sizes, np.int64)
    while player.buffers.active.any():
        player.make_room()
        _play_out(
            engine.static, engine.dynamic, player.buffers, player.kernel_buffers,
            player.known, layers, weights, masking,
        )  # fmt: skip


@allocating
def _play_out(
    static: Static, dynamic: Dynamic, b: StepBuffers, kernel_buffers: StepBuffers, known: Known,
    sizes: NDArray[np.int64], weights: NDArray[np.float32], masking: bool,
) -> None:  # fmt: skip
    """:func:`play_out`, as long as there is room."""
    each = len(b.over) // len(weights)
    values = np.empty((*b.agents.shape, MOVES), np.float32)
    activations = np.empty(units_of(sizes) * b.agents.size, np.float32)
    keys, counters = np.zeros(len(b.over), np.uint64), np.zeros(len(b.over), np.int64)
    never = np.zeros(len(b.over))  # a random move
    short = False
    while b.active.any() and not short:
        for n in range(len(weights)):
            games = slice(n * each, (n + 1) * each)
            q_values(sizes, weights[n], b.obs[games], activations, values[games])
        for m in range(len(b.over)):
            choose(keys, counters, never, b.active, b.mask, values, masking, b.actions, m)
            step_problem(static, dynamic, kernel_buffers, known, m)
            short |= lacks_room(static, dynamic, wide(m))
