"""The observation ``window``: the agent's surroundings, mirrored towards its target.

The window shows the Gcells within ``radius`` of the agent in x and in y, in its own layer and in
``layers`` layers above and below. It is **mirrored** in x and in y so that the target lies towards
+x and +y; layers are not mirrored. All numbers are of order 1 and the shape depends on the options
alone: not on the size of the grid, its layers or its capacities. So one network fits every problem.

A row starts with 16 numbers. d is the distance to the target along an axis, in Gcells.

===== ============================================================================================
0–1   +1 or −1: the direction on the grid of the window's +x and +y (+1 where d is 0)
2–4   d / (1 + |d|) in x, y and z; in x and y never negative
5–7   log2(1 + |d|) / 8 in x, y and z, with the sign of d
8–13  1 if the move crosses an edge now: +x, −x, +y, −y of the window, up, down
14    steps left in the task, as a share of ``max_steps``
15    k / (1 + k) for k open tasks, the present one among them
===== ============================================================================================

Then the channels follow, those that ``channels`` names, in this order. Here s(q) = q / (1 + |q|),
and a net's track is its demand on an edge of the layer, at least 1.

========  =====  =================================================================================
capacity  x y    s(how often the net would fit into the remaining capacity, rounded down): 0 and
                 less where there is no room, 1/2 and more where there is
demand    x y    s(predicted slack in the net's tracks): the remaining capacity less what all other
                 active nets are expected to take
history   x y    s(congestion that the edge has seen in earlier rounds); 0 in games without rounds
own       x y z  1 for an edge that the net uses
pins      Gcell  1 for a target of a task of the net that is still open, the present one included
heads     Gcell  s(number of other active agents there)
messages  Gcell  a block for each of ``message_bits``: 1 if an active agent there, perhaps the agent
                 itself, has set this bit in its last message; see :class:`marouting.rules.Rules`
========  =====  =================================================================================

``x``, ``y`` and ``z`` are blocks of numbers for all edges in that direction that touch a Gcell of
the window, one more in their direction than there are Gcells; ``Gcell`` is a block for the Gcells.
A block has the shape (columns, rows, layers), in the window's directions, the last index fastest.
:attr:`WindowObservation.layout` tells where each block is. Off the grid all is 0. Agents that are
done have no open tasks and no share in the predicted demand.

Predicted demand is explained in :mod:`marouting.batch.expected`. The agent's own is not counted.

The moves of environments are those of the grid, whatever the window's directions. :func:`mirrored`
turns moves of the window into moves of the grid and back; :func:`move_order` does it for masks and
values. Trainings and trained policies do so by themselves: their networks choose among the moves of
the window and need not learn the mirror (:meth:`WindowObservation.move_order`).

The **global state** (``state()`` of the environments and of the batch) has the same channels, for
the whole grid, without a mirror; see :meth:`WindowObservation.state`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args
from weakref import WeakKeyDictionary

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from marouting.batch.bits import next_in
from marouting.batch.engine import Engine
from marouting.batch.expected import (
    Maps,
    maps_of,
    new_maps,
    refresh,
    share_of,
    slack_of,
    squashed,
)
from marouting.batch.mirror import engine_of
from marouting.batch.places import grid_of, position
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import is_later
from marouting.batch.window_rows import (
    MOST_RADIUS,
    SCALARS,
    Offsets,
    count_heads,
    write_window,
)
from marouting.checks import check_fields
from marouting.columns import Games, as_int32, check_shapes
from marouting.config import check
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64, specialised
from marouting.observations import all_actions
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.problem.problem import Problem
from marouting.rules import MOST_BITS

Channel = Literal["capacity", "demand", "history", "own", "pins", "heads", "messages"]

CHANNELS: tuple[Channel, ...] = get_args(Channel)
"""All channels, in the order in which they follow in a row."""

MOST_LAYERS = 16

_X, _Y, _Z, _GCELLS = 0, 1, VIA_AXIS, AXES
_BLOCKS: dict[str, tuple[int, ...]] = {
    "capacity": (_X, _Y),
    "demand": (_X, _Y),
    "history": (_X, _Y),
    "own": (_X, _Y, _Z),
    "pins": (_GCELLS,),
    "heads": (_GCELLS,),
    "messages": (_GCELLS,),
}
"""The blocks of every channel: edges along an axis, or Gcells; one for every bit of messages."""

_NAMES = ("_x", "_y", "_z", "")
_FAR = 4.0
"""log2(1 + d) / 8 for the largest d of a grid."""


@dataclass(frozen=True)
class WindowObservation:
    """The surroundings of an agent, mirrored towards its target; see :mod:`marouting.batch.window`.

    Attributes:
        radius: Gcells that are seen in each direction of x and y, 0 to 30.
        layers: layers that are seen above and below the agent's own, 0 to 16.
        channels: the quantities shown, some of ``capacity``, ``demand``, ``history``, ``own``,
            ``pins``, ``heads`` and ``messages``.
        message_bits: how many bits of messages are shown in that channel, 1 to 8, the lowest first.
            Environments refuse another number than that of their rules.
    """

    radius: int = 2
    layers: int = 1
    channels: tuple[Channel, ...] = ("capacity", "demand", "own", "pins", "heads")
    message_bits: int = 1

    def __post_init__(self) -> None:
        limits = {"radius": (0, MOST_RADIUS), "layers": (0, MOST_LAYERS)}
        check_fields(self, message_bits=(1, MOST_BITS), **limits)
        given = self.channels
        once = len(set(given)) == len(given) > 0
        check("channels", once, f"some of {', '.join(CHANNELS)}, each once, found {given}")

    @property
    def local_radius(self) -> int | None:
        """``radius``; None with ``demand``, which is made of where all other nets are going."""
        return None if "demand" in self.channels else self.radius

    @property
    def shown_bits(self) -> int:
        """Bits of messages in a row: ``message_bits``, or 0 without the channel ``messages``."""
        return self.message_bits if "messages" in self.channels else 0

    @property
    def _blocks(self) -> list[tuple[Channel, str, int]]:
        """Channel, name and kind of all blocks, in their order."""
        found: list[tuple[Channel, str, int]] = []
        for channel in CHANNELS:
            if channel == "messages":
                found += [(channel, f"messages_{bit}", _GCELLS) for bit in range(self.shown_bits)]
            elif channel in self.channels:
                found += [(channel, channel + _NAMES[kind], kind) for kind in _BLOCKS[channel]]
        return found

    @cached_property
    def layout(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Where each block of a row is, and the shape to give it: (columns, rows, layers).

        The names are ``numbers`` for the first 16, then ``capacity_x``, ``capacity_y``, …,
        ``own_z``, ``pins``, ``heads`` and ``messages_0``, ``messages_1``, ….
        """
        found: dict[str, tuple[slice, tuple[int, ...]]] = {
            "numbers": (slice(0, SCALARS), (SCALARS,))
        }
        begin, side = SCALARS, 2 * self.radius + 1
        for _, name, kind in self._blocks:
            shape = [side, side, 2 * self.layers + 1]
            if kind != _GCELLS:
                shape[kind] += 1
            end = begin + math.prod(shape)
            found[name] = slice(begin, end), tuple(shape)
            begin = end
        return found

    @cached_property
    def size(self) -> int:
        """Numbers in a row."""
        return next(reversed(self.layout.values()))[0].stop

    @cached_property
    def offsets(self) -> Offsets:
        """The options, for compiled code."""
        begins: dict[str, int] = {}
        for channel, name, _ in self._blocks:
            begins.setdefault(channel, self.layout[name][0].start)
        known = self.radius, self.layers, self.message_bits
        return Offsets(*known, *(begins.get(channel, NOBODY) for channel in CHANNELS))

    def space(self, problems: Sequence[Problem], overflow: bool) -> Box:
        """The box of a row, the same for all problems; see :class:`.observations.Observation`."""
        del problems, overflow
        low, high = np.zeros(self.size, np.float32), np.ones(self.size, np.float32)
        low[[0, 1, 4]], low[7] = -1, -_FAR
        high[5:8] = _FAR
        for name, (where, _) in self.layout.items():
            if name.startswith(("capacity", "demand")):
                low[where] = -1
        return Box(low, high, dtype=np.float32)

    def write(
        self,
        games: Games,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Fills ``out`` (K, ``size``); see :class:`marouting.observations.Observation`.

        It is fastest if the rows of a problem follow one another.

        Raises:
            ValueError: there are no such agents.
        """
        check_shapes(problems, agents, out, self.size)
        engine = engine_of(games)
        maps = maps_of(engine) if "demand" in self.channels else _NO_MAPS
        known = engine.static, engine.dynamic, _heads_of(engine), maps, self.offsets
        rows = np.ascontiguousarray(out, np.float32)
        arguments = *known, *as_int32(problems, agents), rows
        if not _bound_to(engine, arguments)(*arguments):
            raise ValueError(f"expected agents of the games, found {problems}, {agents}")
        if rows is not out:
            out[...] = rows

    def move_order(self, obs: NDArray[np.float32]) -> NDArray[np.int64]:
        """The moves on the grid that the moves of the window are, for what learns in the window.

        Args:
            obs: (K, size) float32, what agents saw.

        Returns:
            (K, 6) int64; see :func:`move_order`.
        """
        return move_order(obs)

    def state_space(self, problems: Sequence[Problem], overflow: bool) -> Box:
        """The space of :meth:`state`."""
        del overflow
        columns, rows, layers = problems[0].grid
        low = [-1 if channel in ("capacity", "demand") else 0 for channel, _, _ in self._blocks]
        return Box(np.tile(np.array(low, np.float32), (columns, rows, layers)), np.float32(1))

    def state(self, games: Games, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """The global states of all problems, with the channels of the observation.

        Args:
            games: the games.
            out: the array to fill and return; None: a new array.

        Returns:
            (M, X, Y, C Z) float32, C numbers per Gcell and layer, those of the channels in their
            order. For the Gcell's edges towards +x and +y: ``capacity``, the remaining capacity,
            and ``demand``, the predicted slack when all active nets have routed, as s(tracks) of
            the mean demand of the problem's nets in the layer; ``history`` as in the window. For
            its edges towards +x, +y and +z: ``own``, s(number of nets that use it). For the
            Gcell: ``pins``, s(number of open tasks that end there), ``heads``, s(number of
            active agents there), and the bits of ``messages``.
        """
        engine = engine_of(games)
        columns, rows, layers = engine.grid.shape
        channels = len(self._blocks)
        if out is None:
            out = np.empty((len(engine.games), columns, rows, layers * channels), np.float32)
        flat = out.reshape(len(out), -1, channels)
        heads = _heads_of(engine)
        _state(engine.static, engine.dynamic, maps_of(engine), heads, self.offsets, flat)
        return out


_heads: WeakKeyDictionary[Engine, NDArray[np.int32]] = WeakKeyDictionary()


def _heads_of(engine: Engine) -> NDArray[np.int32]:
    """(M, 2 G) int32 to count in; see :func:`.window_rows.count_heads`."""
    found = _heads.get(engine)
    if found is None:
        found = _heads[engine] = np.zeros((len(engine.games), 2 * engine.grid.gcells), np.int32)
    return found


_NO_MAPS = new_maps(1, 1, 1)
"""What is given where no predicted demand is shown."""

_bound: WeakKeyDictionary[Engine, Callable[..., bool]] = WeakKeyDictionary()


def _bound_to(engine: Engine, arguments: tuple[Any, ...]) -> Callable[..., bool]:
    """:func:`_write_rows` for an engine and contiguous int32 and float32: saves 6 µs a call."""
    found = _bound.get(engine)
    if found is None:
        found = _bound[engine] = specialised(_write_rows, *arguments)
    return found


def move_order(
    obs: NDArray[np.float32], actions: int = MOVES, messages: int = 1
) -> NDArray[np.int64]:
    """The actions on the grid in the order of a window's actions.

    Args:
        obs: (…, size) float32, observations of the kind ``window``.
        actions: A, the number of actions; those beyond the six moves stay what they are.
        messages: how many messages there are to choose from, ``2**message_bits``.

    Returns:
        (…, A) int64: the action on the grid that each of the window's actions is. It is its own
        inverse, so ``numpy.take_along_axis(values, move_order(obs), -1)`` turns masks and values
        (…, A) of the grid into those of the window, and back.
    """
    turned = obs[..., :VIA_AXIS] < 0
    order = _ORDERS.take(turned[..., 0] + 2 * turned[..., 1], axis=0)
    return all_actions(order, actions, messages)


_ORDERS = np.arange(MOVES) ^ [
    [swaps_x, swaps_x, swaps_y, swaps_y, 0, 0] for swaps_y in range(2) for swaps_x in range(2)
]
"""(4, 6) int64, the moves where the window is turned in neither direction, in x, in y, in both."""


def mirrored(
    moves: NDArray[np.integer],
    obs: NDArray[np.float32],
    actions: int = MOVES,
    messages: int = 1,
) -> NDArray[np.int64]:
    """Turns actions of the window into those of the grid, or those of the grid into the window's.

    Args:
        moves: (…,) 0 to A − 1, or −1 for none, which stays −1.
        obs: (…, size) float32, what the agents saw, of the kind ``window``.
        actions: as in :func:`move_order`.
        messages: as in :func:`move_order`.

    Returns:
        (…,) int64.
    """
    moves = np.asarray(moves)
    swapped = np.take_along_axis(move_order(obs, actions, messages), moves[..., None], -1)[..., 0]
    return np.where(moves == NOBODY, NOBODY, swapped)


# --- rows -----------------------------------------------------------------------------------------


@compiled
def _write_rows(
    static: Static, dynamic: Dynamic, heads: Any, maps: Maps, offsets: Offsets, problems: Any,
    agents: Any, out: Any,
) -> bool:  # fmt: skip
    """Fills ``out`` (K, size); returns whether there are such agents."""
    counted = i64(NOBODY)
    for i in range(len(problems)):
        m, n = i64(problems[i]), i64(agents[i])
        if not (0 <= m < len(dynamic.games) and NOBODY <= n < dynamic.agents.shape[1]):
            return False
        m = as_index(m)
        if m != counted:
            _prepare(static, dynamic, heads, maps, offsets, m)
            counted = m
        own = offsets.demand >= 0 and n != NOBODY and dynamic.agents[m, n].status == Status.ACTIVE
        # A loop over two signs instead of two calls, which would compile it twice.
        for sign in range(-1, 2, 2):
            if own:
                _add_own_demand(static, dynamic, maps, offsets, m, n, sign)
            if sign < 0:
                write_window(static, dynamic, heads, maps, offsets, m, n, out, i)
    return True


@compiled
def _prepare(
    static: Static, dynamic: Dynamic, heads: Any, maps: Maps, offsets: Offsets, m: int
) -> None:
    """Brings up to date what the channels need of a problem."""
    if offsets.demand >= 0:
        refresh(static, dynamic, maps, m, i64(NOBODY))
    if max(offsets.heads, offsets.messages) >= 0:
        count_heads(dynamic, heads, m)


@compiled
def _add_own_demand(
    static: Static, dynamic: Dynamic, maps: Maps, offsets: Offsets, m: int, n: int, sign: int
) -> None:
    """Adds a net's own expected demand to the edges of its window (1), or subtracts it (−1)."""
    _, rows, layers = grid_of(static)
    reach = i64(offsets.radius)
    agent = dynamic.agents[m, n]
    x, y, z = position(static, as_index(agent.cell))
    for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
        if task != agent.task and not is_later(static, dynamic, m, n, i64(task)):
            continue
        near, far = as_index(static.tasks[task, 0]), as_index(static.tasks[task, 1])
        if task == agent.task:
            near, far = as_index(agent.cell), as_index(agent.target)
        x0, x1 = i64(static.position[near, 0]), i64(static.position[far, 0])
        y0, y1 = i64(static.position[near, 1]), i64(static.position[far, 1])
        x0, x1, y0, y1 = min(x0, x1), max(x0, x1), min(y0, y1), max(y0, y1)
        for layer in range(max(z - offsets.layers, 0), min(z + offsets.layers, layers - 1) + 1):
            for axis in range(VIA_AXIS):
                across = (y1 - y0 if axis == 0 else x1 - x0) + 1
                share = sign * share_of(static, maps, m, n, axis, layer, across)
                right, up = x1 - (axis == 0), y1 - (axis == 1)
                for column in range(max(x0, x - reach - 1), min(right, x + reach) + 1):
                    for row in range(max(y0, y - reach - 1), min(up, y + reach) + 1):
                        at = as_index((column * rows + row) * layers + layer)
                        maps.expected[m, at, axis] += share


# --- the global state -----------------------------------------------------------------------------


@compiled
def _state(
    static: Static, dynamic: Dynamic, maps: Maps, heads: Any, offsets: Offsets, out: Any
) -> None:
    """Fills ``out`` (M, G, C)."""
    for m in range(out.shape[0]):
        write_window_state(static, dynamic, maps, heads, offsets, m, out)


@compiled
def write_window_state(
    static: Static, dynamic: Dynamic, maps: Maps, heads: Any, offsets: Offsets, m: int, out: Any
) -> None:
    """Fills ``out[m]`` (G, C)."""
    layers = maps.track.shape[1]
    _prepare(static, dynamic, heads, maps, offsets, m)
    demand = VIA_AXIS * i64(offsets.capacity >= 0)
    history = demand + VIA_AXIS * i64(offsets.demand >= 0)
    begin = history + VIA_AXIS * i64(offsets.history >= 0)
    for cell in range(out.shape[1]):
        track = maps.track[m, cell % layers]
        for channel in range(out.shape[2]):
            out[m, cell, channel] = 0
        for axis in range(VIA_AXIS):
            edge = as_index(AXES * cell + axis)
            remaining = dynamic.remaining[m, edge]
            if offsets.capacity >= 0:
                out[m, cell, axis] = squashed(np.float32(remaining) / track)
            if offsets.demand >= 0:
                slack = slack_of(maps, m, cell, axis, remaining, track)
                out[m, cell, demand + axis] = squashed(slack)
            if offsets.history >= 0 and static.options[Option.HISTORY] >= 0:
                rounds = dynamic.numbers[m, as_index(static.options[Option.HISTORY] + edge)]
                out[m, cell, history + axis] = squashed(np.float32(rounds))
    pins = begin + AXES * i64(offsets.own >= 0)
    for n in range(dynamic.agents.shape[1]):
        if offsets.own >= 0:
            edge = next_in(dynamic.used, m, i64(n), i64(0))
            while edge != NOBODY:
                out[m, edge // AXES, begin + edge % AXES] += 1
                edge = next_in(dynamic.used, m, i64(n), edge + 1)
        agent = dynamic.agents[m, n]
        if offsets.pins >= 0 and agent.status == Status.ACTIVE:
            out[m, as_index(agent.target), pins] += 1
            for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
                if not is_later(static, dynamic, m, n, i64(task)):
                    continue
                out[m, as_index(static.tasks[task, 1]), pins] += 1
    bits = i64(offsets.bits) if offsets.messages >= 0 else i64(0)
    end = out.shape[2] - bits
    for cell in range(out.shape[1]):
        if offsets.heads >= 0:
            out[m, cell, end - 1] = heads[m, cell]
        for channel in range(begin, end):
            out[m, cell, channel] = squashed(out[m, cell, channel])
        for bit in range(bits):
            out[m, cell, end + bit] = heads[m, out.shape[1] + cell] >> bit & 1
