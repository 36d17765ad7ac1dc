"""Games played to their end by the best moves of small networks, in compiled loops.

One loop plays games with the paper's observation and reward. Games in turn order with the
observation ``outlook`` are played by that of :mod:`policies.generalist.walk` if they have
many rip-up rounds: through the player, a move of one game takes a hundred times as long.
"""

import numpy as np
from numpy.typing import NDArray
from torch import nn

from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.step import FastPath, StepBuffers, step_problem
from marouting.kernels import allocating
from marouting.player import Player
from marouting.problem.grid import MOVES
from policies.generalist.outlook import OutlookObservation
from policies.generalist.walk import Walker
from policies.learned.compiled.gradient import q_values, units_of
from policies.learned.exploration import choose
from policies.learned.networks.mlp import plain_sizes

_MANY = 4
"""Rip-up rounds from which on the loop for ``outlook`` is worth being loaded or compiled."""


def layers_of(player: Player, module: nn.Module, *, masking: bool) -> tuple[int, ...] | None:
    """Units of a network's layers, inputs first, if :func:`play_out` does it in these games."""
    known = player.fast.sees_paper and player.fast.pays_prices and player.fast.pays_others is None
    fits = known or (masking and _looks_out(player))
    return plain_sizes(module) if fits and player.engine.actions == MOVES else None


def _looks_out(player: Player) -> bool:
    """Whether these are long games in turn order with the observation ``outlook``."""
    engine = player.engine
    many = engine.static.options[Option.ROUNDS] >= _MANY
    in_turn = engine.static.sequential and not player.everyone
    return bool(many and in_turn) and type(player.observation) is OutlookObservation


def play_out(
    player: Player, layers: tuple[int, ...], weights: NDArray[np.float32], *, masking: bool
) -> None:
    """Plays the games of a player to their end, always by the move that is rated highest.

    Args:
        player: of M games, whose episodes have begun. With the observation ``outlook`` its buffers
            stay as they are, but for ``active``.
        layers: see :func:`layers_of`.
        weights: (R, P) float32, of the networks that play M/R games each, one network's after
            another's.
        masking: whether only moves that cross an edge are chosen.
    """
    engine, sizes = player.engine, np.array(layers, np.int64)
    if not player.fast.sees_paper:
        _walk_out(player, layers, weights)
        return
    _play_out(
        engine.static, engine.dynamic, player.buffers, player.kernel_buffers,
        player.fast, sizes, weights, masking,
    )  # fmt: skip


def _walk_out(player: Player, layers: tuple[int, ...], weights: NDArray[np.float32]) -> None:
    """:func:`play_out` with the observation ``outlook``."""
    engine, observation = player.engine, player.observation
    assert isinstance(observation, OutlookObservation)
    games = len(engine.games)
    network_of = np.arange(games) * len(weights) // games
    cold, keys = np.zeros(games, np.float32), np.zeros(games, np.uint64)
    for row, row_weights in enumerate(weights):
        walker = Walker(engine, observation, layers, row_weights, cold, keys, fallback_after=None)
        walker.playing[:] = network_of == row
        walker.walk_out()
    player.buffers.active[:] = False


@allocating
def _play_out(
    static: Static, dynamic: Dynamic, b: StepBuffers, kernel_buffers: StepBuffers, fast: FastPath,
    sizes: NDArray[np.int64], weights: NDArray[np.float32], masking: bool,
) -> None:  # fmt: skip
    """:func:`play_out`."""
    each = len(b.over) // len(weights)
    values = np.empty((*b.agents.shape, MOVES), np.float32)
    activations = np.empty(units_of(sizes) * b.agents.size, np.float32)
    keys, counters = np.zeros(len(b.over), np.uint64), np.zeros(len(b.over), np.int64)
    never = np.zeros(len(b.over))  # a random move
    while b.active.any():
        for n in range(len(weights)):
            games = slice(n * each, (n + 1) * each)
            q_values(sizes, weights[n], b.obs[games], activations, values[games])
        for m in range(len(b.over)):
            choose(keys, counters, never, b.active, b.mask, values, masking, b.actions, m)
            step_problem(static, dynamic, kernel_buffers, fast, m)
