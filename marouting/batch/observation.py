"""The paper's observation and reward, and the global state, for compiled steps of the batch."""

from typing import Any

import numpy as np

from marouting.batch.bits import next_in
from marouting.batch.state import Dynamic, Static
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64, inlined
from marouting.observations import CHANNELS
from marouting.problem.grid import AXES, VIA_AXIS


@inlined
def _room(static: Static, dynamic: Dynamic, m: int, cell: int, move: int) -> Any:
    """float32 remaining capacity of the edge that a move inside a layer crosses; 0 if none."""
    return np.float32(dynamic.remaining[m, as_index(static.edge[cell, move])])


@inlined
def write_paper(
    static: Static, dynamic: Dynamic, via_capacity: float, m: int, n: int, out: Any, row: int
) -> None:
    """Fills a row of ``out`` (K, 12) with what agent n of problem m sees; zeros for NOBODY."""
    if n == NOBODY:
        for f in range(out.shape[1]):
            out[row, f] = 0
    else:
        agent = dynamic.agents[m, as_index(n)]
        cell, target = as_index(agent.cell), as_index(agent.target)
        # Everything is read before anything is written. The compiler cannot know that ``out`` is
        # not part of the game; this way, one read serves both the observation and a mask made
        # beside it.
        x, y, z = static.position[cell, 0], static.position[cell, 1], static.position[cell, 2]
        to_x, to_y, to_z = (
            static.position[target, 0],
            static.position[target, 1],
            static.position[target, 2],
        )
        east = _room(static, dynamic, m, cell, i64(0))
        west = _room(static, dynamic, m, cell, i64(1))
        north = _room(static, dynamic, m, cell, i64(2))
        south = _room(static, dynamic, m, cell, i64(3))
        exits = static.exits[cell]
        out[row, 0], out[row, 1], out[row, 2] = np.float32(x), np.float32(y), np.float32(z)
        out[row, 3] = np.float32(np.int32(to_x - x))
        out[row, 4] = np.float32(np.int32(to_y - y))
        out[row, 5] = np.float32(np.int32(to_z - z))
        out[row, 6], out[row, 7], out[row, 8], out[row, 9] = east, west, north, south
        out[row, 10] = np.float32(via_capacity) * np.float32(exits >> 4 & 1)
        out[row, 11] = np.float32(via_capacity) * np.float32(exits >> 5 & 1)


@compiled
def see_paper(
    static: Static, dynamic: Dynamic, via_capacity: float, problems: Any, agents: Any, out: Any
) -> None:
    """Fills ``out`` (K, 12)."""
    for i in range(len(problems)):
        m, n = as_index(problems[i]), i64(agents[i])
        write_paper(static, dynamic, via_capacity, m, n, out, i)


@compiled
def write_state(dynamic: Dynamic, m: int, out: Any) -> None:
    """Fills ``out[m]`` (G, 5) with a global state; see :func:`.observations.state_space`."""
    for cell in range(out.shape[1]):
        for axis in range(VIA_AXIS):
            out[m, cell, axis] = dynamic.remaining[m, AXES * cell + axis]
        for channel in range(VIA_AXIS, CHANNELS):
            out[m, cell, channel] = 0
    for n in range(dynamic.agents.shape[1]):
        edge = next_in(dynamic.used, m, i64(n), i64(0))
        while edge != NOBODY:
            if edge % AXES == VIA_AXIS:
                out[m, edge // AXES, VIA_AXIS] += 1
            edge = next_in(dynamic.used, m, i64(n), edge + 1)
        agent = dynamic.agents[m, n]
        if agent.status == Status.ACTIVE:
            out[m, as_index(agent.cell), AXES] += 1
            out[m, as_index(agent.target), AXES + 1] += 1


@compiled
def write_states(dynamic: Dynamic, out: Any) -> None:
    """Fills ``out`` (M, G, 5) with global states."""
    for m in range(out.shape[0]):
        write_state(dynamic, m, out)


@inlined
def paper_reward(table: Any, overflow_price: float, agent: Any) -> Any:
    """float32, the :class:`marouting.rewards.PaperReward` of an AGENT record's last move."""
    reward = table[as_index(agent.crossing), as_index(agent.ending)]
    return reward - np.float32(overflow_price) * np.float32(agent.added_overflow)
