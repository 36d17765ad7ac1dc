"""The compiled parts of a training step that are neither game nor network."""

from typing import Any

import numpy as np

from marouting.engine import (
    NOBODY,
    Crossing,
    Ending,
    Play,
    Status,
    World,
    compiled,
    move_all,
    move_turn,
    settle_all,
    settle_turn,
)
from marouting.grid import MOVES
from policies.learned.streams import uniform


@compiled
def pick(
    play: Play,
    agents: Any,
    values: Any,
    mask: Any,
    masked: bool,
    epsilon: Any,
    keys: Any,
    counters: Any,
    moves: Any,
) -> None:
    """ε-greedy moves of the agents that may move, NOBODY for the others.

    Args:
        play: the games.
        agents: (M, K) int32 the agents asked, NOBODY for none.
        values: (M, K, 6) float32 Q values.
        mask: (M, K, 6) int8 action masks; looked at if ``masked``.
        masked: whether to pick among the moves that cross an edge only.
        epsilon: (M,) float64 chance of a random move.
        keys: (M,) uint64 keys of the random numbers.
        counters: (M,) int64; one further where an agent may move.
        moves: (M, K) int8; filled.
    """
    for m in range(agents.shape[0]):
        playing = False
        for k in range(agents.shape[1]):
            n = agents[m, k]
            if n == NOBODY or play.agents[m, n].status != Status.ACTIVE:
                moves[m, k] = NOBODY
                continue
            playing = True
            # Two draws a lane: whether to explore, and where to.
            if uniform(keys[m], counters[m], 2 * k) < epsilon[m]:
                allowed = MOVES
                if masked:
                    allowed = 0
                    for move in range(MOVES):
                        allowed += mask[m, k, move]
                left = np.int64(uniform(keys[m], counters[m], 2 * k + 1) * allowed)
                for move in range(MOVES):
                    if masked and mask[m, k, move] == 0:
                        continue
                    if left == 0:
                        moves[m, k] = move
                        break
                    left -= 1
                continue
            best = NOBODY
            for move in range(MOVES):
                if masked and mask[m, k, move] == 0:
                    continue
                if best == NOBODY or values[m, k, move] > values[m, k, best]:
                    best = move
            moves[m, k] = best
        counters[m] += playing


@compiled
def advance(
    world: World,
    play: Play,
    everyone: bool,
    agents: Any,
    moves: Any,
    crossing: Any,
    ending: Any,
    overflow: Any,
) -> None:
    """The first half of a step (:meth:`marouting.Engine.move`), and what it did to each agent.

    Args:
        world: the problems.
        play: the games; changed.
        everyone: whether all agents move, or those whose turn it is.
        agents: (M, K) int32 the agents that ``moves`` are for.
        moves: (M, K) int8.
        crossing: (M, K) int8 Crossing; filled, NONE where nobody moved.
        ending: (M, K) int8 Ending; filled.
        overflow: (M, K) int32; filled.
    """
    if everyone:
        move_all(world, play, moves)
    else:
        move_turn(world, play, moves[:, 0])
    for m in range(agents.shape[0]):
        for k in range(agents.shape[1]):
            n = agents[m, k]
            crossing[m, k] = Crossing.NONE
            ending[m, k] = Ending.NONE
            overflow[m, k] = 0
            if n != NOBODY:
                agent = play.agents[m, n]
                crossing[m, k] = agent.crossing
                ending[m, k] = agent.ending
                overflow[m, k] = agent.overflow


@compiled
def settle(world: World, play: Play, everyone: bool, over: Any) -> None:
    """The second half of a step; fills (M,) the problems whose episode ended with it."""
    for m in range(len(over)):
        over[m] = play.games[m].active > 0
    if everyone:
        settle_all(world, play)
    else:
        settle_turn(world, play)
    for m in range(len(over)):
        over[m] &= play.games[m].active == 0
