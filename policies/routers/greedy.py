"""The greedy router plays the game without planning: nearer to the target, where most is free."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from marouting import Engine, Problem, Solution
from marouting.batch.edges import has_room, uses
from marouting.batch.places import distance
from marouting.batch.rules import move_player, settle_player
from marouting.batch.state import Dynamic, Static
from marouting.game import NOBODY
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import MOVES, VIA_AXIS
from marouting.rules import NetOrder, Nets
from marouting.search.guides import SearchBuffers, search_buffers, shortest_path
from marouting.trees.decomposition import Decomposition


@dataclass(frozen=True)
class GreedyRouter:
    """Every net walks to the neighbour nearer to its target with the most remaining capacity.

    Distances are Manhattan distances over x, y and layer. Of the moves that lead nearer than the
    agent has been in this task, it makes the one across the edge with the most remaining capacity.
    The net's own edges come first. Vias come last: their capacity is unlimited, so otherwise agents
    would change layers at every step. Ties go to the first in the order of
    :class:`marouting.problem.grid.Move`. If there is no such move, the agent follows a shortest
    detour, found by A*, until there is one. If no path is left, it stays until the task fails.

    Attributes:
        net_order: which nets come first, see :class:`marouting.rules.Nets`.
        decomposition: how nets are cut into two-pin tasks, see there.
        max_steps: steps after which a task fails; None for the default of
            :class:`marouting.Engine`.
    """

    net_order: NetOrder = "half_perimeter"
    decomposition: Decomposition = "mst"
    max_steps: int | None = None

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution without overflow, in which nets stay open where all ways were full.
        """
        engine = Engine(
            [problem],
            turn_order="sequential",
            nets=Nets(order=self.net_order, decomposition=self.decomposition),
            max_steps=self.max_steps,
        )
        buffers, nearest = search_buffers(engine.grid), np.zeros(1, np.int64)
        _play(engine.static, engine.dynamic, buffers, nearest)
        return engine.solution()


@compiled
def _play(static: Static, dynamic: Dynamic, s: SearchBuffers, nearest: Any) -> None:
    """Plays the game of the first problem.

    Args:
        static: the game.
        dynamic: its state.
        s: working arrays.
        nearest: (1,) the least distance from the target so far in the present task.
    """
    m = i64(0)
    while dynamic.games[m].agent != NOBODY:
        n = as_index(dynamic.games[m].agent)
        agent = dynamic.agents[m, n]
        here = distance(static, i64(agent.cell), i64(agent.target))
        nearest[0] = here if agent.steps == 0 else min(nearest[0], here)
        move = _nearer(static, dynamic, m, n, i64(nearest[0]))
        if move == NOBODY:
            shortest_path(static, dynamic, s, m, n, i64(agent.cell), i64(agent.target))
            move = i64(s.search.path[0])
        move_player(static, dynamic, m, move)
        settle_player(static, dynamic, m)


@compiled
def _nearer(static: Static, dynamic: Dynamic, m: int, n: int, nearest: int) -> int:
    """The move nearer to the target than ``nearest`` with the most capacity; NOBODY for none."""
    agent = dynamic.agents[m, n]
    cell = as_index(agent.cell)
    best, most = i64(NOBODY), i64(-1)
    for move in range(MOVES):
        if not has_room(static, dynamic, m, n, cell, move):
            continue
        if distance(static, i64(static.neighbour[cell, move]), i64(agent.target)) >= nearest:
            continue
        edge = as_index(static.edge[cell, move])
        room = i64(dynamic.remaining[m, edge])
        if move // 2 == VIA_AXIS:
            room = i64(0)
        if uses(dynamic.used, m, n, edge):
            room = i64(2**62)
        if room > most:
            best, most = i64(move), room
    return best
