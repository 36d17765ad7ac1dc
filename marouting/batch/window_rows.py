"""The rows of the observation ``window``, compiled: one kernel writes the row of one agent.

:mod:`marouting.batch.window` says what is in a row. Most numbers are 0, so a row is cleared
first and then only what is on the grid is written.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from marouting.batch.bits import byte_of
from marouting.batch.expected import Maps, slack_of, squashed
from marouting.batch.places import grid_of, position
from marouting.batch.rules import free_moves
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import is_later
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64, inlined
from marouting.problem.grid import AXES, VIA_AXIS

SCALARS = 16
"""Numbers at the beginning of a row."""

_NEAR = 256
_LOGARITHMS = np.array([math.log2(1 + d) / 8 for d in range(_NEAR)], np.float32)


class Offsets(NamedTuple):
    """Sizes of a window, and where its channels begin, for compiled code."""

    radius: int
    layers: int
    bits: int  # of messages
    capacity: int  # where the channel begins in a row; -1: it is not there
    demand: int
    history: int
    own: int
    pins: int
    heads: int
    messages: int


@inlined
def squashed_whole(number: int) -> Any:
    """float32, q / (1 + |q|) of a whole number."""
    return squashed(np.float32(number))


@inlined
def _logarithm(distance: int) -> Any:
    """float32, log2(1 + d) / 8 of a distance."""
    if distance < _NEAR:
        return _LOGARITHMS[as_index(distance)]
    return np.float32(math.log2(1.0 + distance) / 8)


@inlined
def _tracks(remaining: int, track: int) -> Any:
    """float32, s(how often a track fits into the remaining capacity, rounded down)."""
    if track == 1:
        return squashed_whole(remaining)
    return squashed(np.float32(math.floor(np.float32(remaining) / np.float32(track))))


# --- where the window lies on the grid ------------------------------------------------------------
# Along one direction of the grid: ``along`` is 1 for edges in that direction, of which there is one
# less on the grid and one more in the window than there are Gcells, and 0 otherwise.


@inlined
def low(here: int, reach: int, along: int) -> int:
    """The first place on the grid that is in the window."""
    return max(here - reach - along, i64(0))


@inlined
def high(here: int, reach: int, along: int, side: int) -> int:
    """The last place on the grid that is in the window, plus one."""
    return min(here + reach, side - 1 - along) + 1


@inlined
def place(at: int, here: int, reach: int, along: int, forward: int) -> int:
    """The place in the window of a place on the grid; ``forward`` 0: the window is mirrored."""
    return at - here + reach + along if forward else here - at + reach


MOST_RADIUS = 30
"""The largest radius. A column of the window then has 62 numbers, and :func:`_write_block` counts
them in the bits of one int64."""

# --- channels -------------------------------------------------------------------------------------


CAPACITY, DEMAND, HISTORY, HEADS, MESSAGES = range(5)
"""Channels whose numbers are looked up by edge or Gcell; bit k of messages is MESSAGES + k."""

At = tuple[int, int, int, int, int]
"""Where an agent is: x, y and z; then 1 if the window's +x and +y are those of the grid, else 0."""


@inlined
def _write_block(
    static: Static, dynamic: Dynamic, heads: Any, maps: Maps, offsets: Offsets, m: int,
    n: int, at: At, what: int, kind: int, begin: int, out: Any, row: int,
) -> None:  # fmt: skip
    """Writes a block of a channel, of edges along an axis or (``kind`` is AXES) of Gcells."""
    columns, rows, layers = grid_of(static)
    x, y, z, right, up = at
    reach, deep = i64(offsets.radius), i64(offsets.layers)
    along_x, along_y = i64(kind == 0), i64(kind == 1)
    height, depth = 2 * reach + 1 + along_y, 2 * deep + 1
    low_y, high_y = low(y, reach, along_y), high(y, reach, along_y, rows)
    first = place(low_y, y, reach, along_y, up)
    step = depth if up else -depth
    history = i64(static.options[Option.HISTORY])
    first_x, end_x = low(x, reach, along_x), high(x, reach, along_x, columns)
    across = height * depth if right else -height * depth
    # The loops shift out a bit for each number. The compiler would turn loops over a range into
    # ones over vectors, which take twice as long for columns as short as these.
    many = (i64(1) << (high_y - low_y)) - 1
    for gz in range(low(z, deep, i64(0)), high(z, deep, i64(0), layers)):
        track = max(i64(static.demand[m, n, as_index(gz)]), 1)
        corner = begin + (place(first_x, x, reach, along_x, right) * height + first) * depth
        corner += gz - z + deep
        below = (first_x * rows + low_y) * layers + gz
        for _ in range(first_x, end_x):
            p, cell, edge, left = corner, below, AXES * below + kind, many
            corner, below = corner + across, below + rows * layers
            # The usual channels have loops of their own: no branch inside of them.
            while what == CAPACITY and left != 0:
                remaining = i64(dynamic.remaining[m, as_index(edge)])
                out[row, as_index(p)] = _tracks(remaining, track)
                edge, p, left = edge + AXES * layers, p + step, left >> 1
            while what == HEADS and left != 0:
                out[row, as_index(p)] = squashed_whole(i64(heads[m, as_index(cell)]))
                cell, p, left = cell + layers, p + step, left >> 1
            while left != 0:
                if what == HISTORY:
                    value = squashed_whole(i64(dynamic.numbers[m, as_index(history + edge)]))
                elif what == DEMAND:
                    left_over = dynamic.remaining[m, as_index(edge)]
                    wide = np.float32(track)
                    value = squashed(slack_of(maps, m, as_index(cell), kind, left_over, wide))
                else:
                    message = i64(heads[m, as_index(columns * rows * layers + cell)])
                    value = np.float32(message >> (what - MESSAGES) & 1)
                out[row, as_index(p)] = value
                cell, edge = cell + layers, edge + AXES * layers
                p, left = p + step, left >> 1


@inlined
def _write_own(
    static: Static, dynamic: Dynamic, offsets: Offsets, m: int, n: int, at: At, out: Any, row: int
) -> None:
    """Writes ``own``: the bits of a column of the grid that touches the window are side by side."""
    columns, rows, layers = grid_of(static)
    x, y, z, right, up = at
    reach, deep = i64(offsets.radius), i64(offsets.layers)
    side, depth = 2 * reach + 1, 2 * deep + 1
    block = side * (side + 1) * depth
    low_y, high_y = low(y, reach, i64(1)), high(y, reach, i64(0), rows)
    for gx in range(low(x, reach, i64(1)), high(x, reach, i64(0), columns)):
        first = AXES * layers * (gx * rows + low_y)
        last = AXES * layers * (gx * rows + high_y) - 1
        for byte in range(first >> 3, (last >> 3) + 1):
            bits = byte_of(dynamic.used, m, n, byte)
            edge = 8 * byte
            while bits != 0:
                if bits & 1 and first <= edge <= last:
                    cell, axis = as_index(edge // AXES), edge % AXES
                    along_x, along_y, along_z = i64(axis == 0), i64(axis == 1), i64(axis == 2)
                    i = place(i64(gx), x, reach, along_x, right)
                    j = place(i64(static.position[cell, 1]), y, reach, along_y, up)
                    k = i64(static.position[cell, VIA_AXIS]) - z + deep + along_z
                    inside = 0 <= i < side + along_x and 0 <= j < side + along_y
                    if inside and 0 <= k < depth + along_z:
                        p = (i * (side + along_y) + j) * (depth + along_z) + k
                        out[row, as_index(offsets.own + block * axis + p)] = 1
                bits, edge = bits >> 1, edge + 1


@inlined
def _write_pins(
    static: Static, dynamic: Dynamic, offsets: Offsets, m: int, n: int, at: At, out: Any, row: int
) -> None:
    """Writes ``pins`` of an active agent."""
    x, y, z, right, up = at
    reach, deep = i64(offsets.radius), i64(offsets.layers)
    side, depth = 2 * reach + 1, 2 * deep + 1
    agent = dynamic.agents[m, n]
    for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
        pin = as_index(agent.target)
        if task != agent.task:
            if not is_later(static, dynamic, m, n, i64(task)):
                continue
            pin = as_index(static.tasks[task, 1])
        i = place(i64(static.position[pin, 0]), x, reach, i64(0), right)
        j = place(i64(static.position[pin, 1]), y, reach, i64(0), up)
        k = i64(static.position[pin, 2]) - z + deep
        if 0 <= i < side and 0 <= j < side and 0 <= k < depth:
            out[row, as_index(offsets.pins + (i * side + j) * depth + k)] = 1


@inlined
def write_numbers(static: Static, dynamic: Dynamic, m: int, n: int, out: Any, row: int) -> None:
    """Writes the first 16 numbers of a row."""
    agent = dynamic.agents[m, n]
    cell, target = as_index(agent.cell), as_index(agent.target)
    free = free_moves(static, dynamic, m, n)
    for axis in range(AXES):
        far = i64(static.position[target, axis]) - i64(static.position[cell, axis])
        back = i64(0)
        if axis != VIA_AXIS:
            back = i64(far < 0)
            out[row, axis] = 1 - 2 * back
            far = abs(far)
        out[row, 2 + axis] = squashed_whole(far)
        out[row, 5 + axis] = _logarithm(far) if far >= 0 else -_logarithm(-far)
        for way in range(2):
            out[row, 8 + 2 * axis + way] = free >> (2 * axis + (way ^ back)) & 1
    left = np.float32(static.max_steps - agent.steps) / np.float32(static.max_steps)
    out[row, 14] = max(left, np.float32(0))
    tasks = i64(0)
    if agent.status == Status.ACTIVE:
        tasks += 1
        for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
            tasks += is_later(static, dynamic, m, n, i64(task))
    out[row, 15] = squashed_whole(tasks)


@inlined
def write_window(
    static: Static, dynamic: Dynamic, heads: Any, maps: Maps, offsets: Offsets, m: int,
    n: int, out: Any, row: int,
) -> None:  # fmt: skip
    """Fills a row of ``out`` (K, size) with what an agent sees; zeros for NOBODY.

    ``heads`` is as :func:`count_heads` leaves it, ``maps`` without what the agent itself is
    expected to take; they are read only for their channels.
    """
    for f in range(out.shape[1]):
        out[row, f] = 0
    if n == NOBODY:
        return
    n = as_index(n)
    write_numbers(static, dynamic, m, n, out, row)
    agent = dynamic.agents[m, n]
    cell, target, active = as_index(agent.cell), as_index(agent.target), i64(0)
    active += agent.status == Status.ACTIVE
    x, y, z = position(static, cell)
    right = i64(static.position[target, 0] >= x)
    up = i64(static.position[target, 1] >= y)
    at = x, y, z, right, up
    side, depth = 2 * i64(offsets.radius) + 1, 2 * i64(offsets.layers) + 1
    # One loop over the blocks instead of many calls, each of which would compile everything again.
    bits = i64(offsets.bits) if offsets.messages >= 0 else i64(0)
    for turn in range(2 * HEADS + 1 + bits):
        what, kind, begin = i64(turn >> 1), i64(turn & 1), i64(offsets.capacity)
        size = side * (side + 1) * depth * kind
        if turn >= 2 * HEADS:  # a block of Gcells
            what, kind = i64(turn - HEADS), i64(AXES)
            begin, size = i64(offsets.heads), i64(0)
        if what == DEMAND:
            begin = i64(offsets.demand)
        elif what == HISTORY:
            begin = i64(offsets.history if static.options[Option.HISTORY] >= 0 else NOBODY)
        elif what >= MESSAGES:
            begin, size = i64(offsets.messages), side * side * depth * (what - MESSAGES)
        if begin >= 0:
            _write_block(
                static, dynamic, heads, maps, offsets, m, n, at, what, kind, begin + size, out, row
            )
    if offsets.heads >= 0:
        middle = offsets.heads + (side * side // 2) * depth + offsets.layers
        out[row, as_index(middle)] = squashed_whole(i64(heads[m, cell]) - active)
    if offsets.own >= 0:
        _write_own(static, dynamic, offsets, m, n, at, out, row)
    if offsets.pins >= 0 and active:
        _write_pins(static, dynamic, offsets, m, n, at, out, row)


@compiled
def count_heads(dynamic: Dynamic, heads: Any, m: int) -> None:
    """Counts the active agents of a problem in each Gcell, and joins the bits of their messages.

    ``heads`` (M, 2 G) holds the numbers of agents of all Gcells, then their messages. Without
    messages (M, G) are enough.
    """
    gcells = dynamic.remaining.shape[1] // AXES
    for cell in range(heads.shape[1]):
        heads[m, cell] = 0
    for n in range(dynamic.agents.shape[1]):
        agent = dynamic.agents[m, n]
        if agent.status == Status.ACTIVE:
            heads[m, as_index(agent.cell)] += 1
            if heads.shape[1] > gcells:
                heads[m, as_index(gcells + agent.cell)] |= agent.message
