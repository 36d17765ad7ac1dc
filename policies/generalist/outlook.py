"""The generalist's observation: extra path cost of every move, open pins, a window in one layer.

Like the window of :mod:`marouting.batch.window`, it is mirrored in x and in y so that the target
lies towards +x and +y, and has the same shape for every grid, number of layers and capacity. It is
much smaller but takes longer to compute: all layers are combined into one, and two searches find
the extra cost of every move over the best one.

A row consists of these blocks; s(q) = q / (1 + |q|), far(d) is d in eighths up to 8 Gcells and then
grows as the logarithm, 1 + ln(d / 8), up to 4; and a net's track is its demand on an edge of the
layer, at least 1.

=======  ===  =====================================================================================
numbers  16   as in :mod:`marouting.batch.window`
detour   12   for +x, −x, +y, −y of the frame, up and down: s(d), where d is the extra cost of
              the cheapest path to the end that begins with the move; 1 where there is none. First
              with the remaining capacity, then with the predicted slack
span     6    for the same moves: s(d), where d is the number of edges that the rest of the net, by
              its spanning tree, needs beyond those after the best move; 1 where the agent cannot
              go
crossed  8    of the edges towards +x, −x, +y, −y: s(tracks of remaining capacity, rounded down) of
              the four, then s(predicted slack in tracks) of the four; −1 off the grid
pins     40   of the target, then of up to four other open pins, the nearest to the agent first:
              1; far(its distance) in x and y of the frame and in z; far(cost of the cheapest way
              from there to the end), 4 if there is none; far(the distance of where that way ends)
              in x and y of the frame; far(distance to the nearest Gcell at an edge of the net or
              with the agent). 0 for missing pins
room_x        s(tracks of remaining capacity) of the edges along x that touch the window, the
              largest in all layers; 0 off the grid
room_y        the same along y
slack_x       s(predicted slack in tracks), likewise
slack_y       the same along y
own           1 for Gcells of the window where, in any layer, the net uses an edge
open          1 for Gcells of the window where, in any layer, an open task has its target
=======  ===  =====================================================================================

**The spanning tree** joins, with as few edges as possible, the Gcell that the move leads to, the
net's edges so far, the end of the task, and the other open pins that are seen. A connection of the
move's Gcell, or of a pin, to the end costs the cheapest path with the remaining capacity; one
between pins, or from a pin to the net's edges, costs the distance. The move's own edge counts as
well. A move towards two pins at once is best where the tree has branches to both.

**The cheapest path** leads from a Gcell to one that ends the task: with ``target: tree`` any Gcell
of the net's tree, otherwise the target. Every edge costs 1, including those of the present task.
One without room for the net costs 32 more if overflow is allowed, and cannot be crossed otherwise.
With the predicted slack, an edge whose slack would become negative costs 1 more per track, up to 4.
In a priced round (:mod:`marouting.batch.rounds`) the costs are those of
:mod:`marouting.batch.prices`. Paths stay within ``margin`` Gcells of the box around the task's ends
and the net's other open pins; in a priced round the box grows by two more Gcells on each side for
every consecutive round without gain.

Predicted demand is explained in :mod:`marouting.batch.expected`; that of the agent itself is left
out. Moves are those of the grid; :func:`marouting.batch.window.mirrored` translates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from marouting.batch.bits import next_in
from marouting.batch.edges import demand_of, uses
from marouting.batch.engine import Engine
from marouting.batch.expected import Maps, maps_of, refresh, slack_of, squashed
from marouting.batch.mirror import engine_of
from marouting.batch.places import distance, grid_of, position
from marouting.batch.prices import UNIT, edge_cost, is_priced, price_of
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import holds, is_later, is_on, next_nearest
from marouting.batch.window import move_order
from marouting.batch.window_rows import MOST_RADIUS, write_numbers
from marouting.checks import check_fields
from marouting.columns import Games, check_rows
from marouting.game import NOBODY, Crossing
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.problem.problem import Problem

_NUMBERS, _DETOURS, _CROSSED, _PIN, _PINS = 16, 12, 8, 8, 5
_SPANS = _NUMBERS + _DETOURS
_EDGES = _SPANS + MOVES
_FIRST_PIN = _EDGES + _CROSSED
_FIXED = _FIRST_PIN + _PIN * _PINS
DETOURS = _NUMBERS
"""Where the block ``detour`` begins in a row."""

_UNIT = UNIT  # the cost of an edge
_OVERFLOW = 32 * _UNIT
_STEP = _UNIT // 4  # of the cost of scarcity
_SCARCE = 16  # such steps at most
_BUCKETS = 1024  # more than any edge costs
_FARTHEST = 2**30
_KEY, _SIZE, _WAITING = range(3)  # the cost that comes next; entries made; of these, in buckets
_MOST_FAR = np.float32(4)
_FACTOR = -0x61C8864680B583EB  # of the digest: the golden ratio, in 64 bits


class Ways(NamedTuple):
    """Working arrays of the searches, and what the last ones have found."""

    radius: int  # see OutlookObservation
    margin: int
    cost: NDArray[np.int32]  # (M, 2, G) of the cheapest way to the end, in parts of _UNIT
    end: NDArray[np.int32]  # (M, G) the Gcell that it ends in, with the capacity there is
    low: NDArray[np.int32]  # (M, 2) the box that is searched, in x and y
    high: NDArray[np.int32]  # (M, 2)
    found: NDArray[np.int64]  # (M,) the digest of what this was found from; 0: unknown
    kinds: NDArray[np.int32]  # (M,) how many searches there are: 1 if nothing is scarce
    front: NDArray[np.int64]  # (M, 2, 3) how far they are: _KEY, _SIZE, _WAITING
    head: NDArray[np.int32]  # (M, 2, 1024) the first entry of each bucket
    after: NDArray[np.int32]  # (M, 2, entries) the next entry of the bucket
    entry: NDArray[np.int32]  # (M, 2, entries) the Gcell of an entry
    touched: NDArray[np.int64]  # (M, X·Y) the last count in ``counts`` of which an edge of the net
    # of that time touches the column, in any layer
    counts: NDArray[np.int64]  # (M,) how often wires have been found
    start: NDArray[np.int32]  # (M,) where the agent was then
    wired: NDArray[np.int32]  # (K,) distance of a task's pin to what its net has wired
    seen: NDArray[np.int32]  # (4,) tasks of the other open pins that are seen
    span: NDArray[np.int64]  # (5,) working: of the end and the pins, their distance to the tree
    total: NDArray[np.int64]  # (6,) working: edges of the spanning tree after each move


_ways: WeakKeyDictionary[Engine, tuple[Ways, NDArray[np.int64]]] = WeakKeyDictionary()
"""The arrays of every engine that is observed, and (M,) which of the problems that have been in its
places they are of."""


def ways_of(engine: Engine, observation: "OutlookObservation") -> Ways:
    """The working arrays for an engine, new ones if it has none yet."""
    known = _ways.get(engine)
    if known is None:
        m, cells = len(engine.games), engine.grid.gcells
        entries = (MOVES + 1) * cells
        ways = Ways(
            radius=0,
            margin=0,
            cost=np.full((m, 2, cells), _FARTHEST, np.int32),
            end=np.zeros((m, cells), np.int32),
            low=np.zeros((m, 2), np.int32),
            high=np.zeros((m, 2), np.int32),
            found=np.zeros(m, np.int64),
            kinds=np.zeros(m, np.int32),
            front=np.zeros((m, 2, 3), np.int64),
            head=np.full((m, 2, _BUCKETS), NOBODY, np.int32),
            after=np.zeros((m, 2, entries), np.int32),
            entry=np.zeros((m, 2, entries), np.int32),
            touched=np.zeros((m, cells // engine.grid.shape[VIA_AXIS]), np.int64),
            counts=np.zeros(m, np.int64),
            start=np.zeros(m, np.int32),
            wired=np.zeros(len(engine.static.tasks), np.int32),
            seen=np.zeros(_PINS - 1, np.int32),
            span=np.zeros(_PINS, np.int64),
            total=np.zeros(MOVES, np.int64),
        )
        known = _ways[engine] = ways, np.full(m, NOBODY, np.int64)
    ways, replaced = known
    if (replaced != engine.replaced).any():
        ways.found[replaced != engine.replaced] = 0
        replaced[:] = engine.replaced
    return ways._replace(radius=observation.radius, margin=observation.margin)


@dataclass(frozen=True)
class OutlookObservation:
    """The generalist's observation; see :mod:`policies.generalist.outlook`.

    Attributes:
        radius: Gcells that are seen in each direction of x and y, 0 to 30.
        margin: Gcells by which ways may leave the box around the open pins, from 1.
    """

    radius: int = 2
    margin: int = 3

    def __post_init__(self) -> None:
        check_fields(self, radius=(0, MOST_RADIUS), margin=(1, 2**16))

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Where each block of a row is."""
        side = 2 * self.radius + 1
        sizes = {
            "numbers": _NUMBERS,
            "detour": _DETOURS,
            "span": MOVES,
            "crossed": _CROSSED,
            "pins": _PIN * _PINS,
            **dict.fromkeys(("room_x", "room_y", "slack_x", "slack_y"), (side + 1) * side),
            "own": side * side,
            "open": side * side,
        }
        ends = np.cumsum(list(sizes.values())).tolist()
        return {
            name: slice(end - size, end)
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        }

    @property
    def size(self) -> int:
        """Numbers in a row."""
        return self.layout["open"].stop

    def space(self, problems: Sequence[Problem], overflow: bool) -> Box:
        """The box of a row, the same for all problems; see :class:`.observations.Observation`."""
        del problems, overflow
        low, high = np.full(self.size, -1, np.float32), np.ones(self.size, np.float32)
        low[5:8], high[5:8] = -4, 4
        low[self.layout["pins"]], high[self.layout["pins"]] = -_MOST_FAR, _MOST_FAR
        for name in ("detour", "span", "own", "open"):
            low[self.layout[name]] = 0
        return Box(low, high, dtype=np.float32)

    def write(
        self,
        games: Games,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Fills ``out`` (K, ``size``); see :class:`marouting.observations.Observation`.

        Raises:
            ValueError: there are no such agents.
        """
        check_rows(games, problems, agents, out, self.size)
        engine = engine_of(games)
        known = engine.static, engine.dynamic, maps_of(engine), ways_of(engine, self)
        _write(*known, problems, agents, out)

    def move_order(self, obs: NDArray[np.float32]) -> NDArray[np.int64]:
        """The moves on the grid that the moves of the frame are, for what learns in the frame.

        Args:
            obs: (K, size) float32, what agents saw.

        Returns:
            (K, 6) int64; see :func:`marouting.batch.window.move_order`.
        """
        return move_order(obs)


# --- the cheapest ways ----------------------------------------------------------------------------


@compiled
def _edge_cost(
    static: Static, dynamic: Dynamic, maps: Maps, m: int, n: int, cell: int, move: int, slack: bool
) -> int:
    """What the edge that a move crosses costs a net; ``slack``: whether predicted slack counts."""
    axis = move // 2
    if axis == VIA_AXIS:
        return i64(_UNIT)
    edge = as_index(static.edge[cell, move])
    demand = i64(demand_of(static, m, n, cell, move))
    # As if the net did not use the edge yet: so nothing changes while the agent walks.
    remaining = i64(dynamic.remaining[m, edge]) + demand * uses(dynamic.used, m, n, edge)
    cost = i64(_UNIT)
    if is_priced(static, dynamic, m):
        cost = edge_cost(static, dynamic, m, i64(edge), demand, remaining)
    elif remaining < demand:
        cost = i64(_UNIT + _OVERFLOW) if static.overflow_allowed else i64(_FARTHEST)
    elif slack:
        at = as_index(edge // AXES)
        track = np.float32(max(demand, 1))
        left = slack_of(maps, m, at, axis, remaining, track) - np.float32(1)
        if left < 0:
            cost += _STEP * min(i64(np.float32(-4) * left), i64(_SCARCE))
    return cost


@compiled
def _put(ways: Ways, m: int, kind: int, key: int, cell: int) -> None:
    """Puts a Gcell into the bucket of a cost."""
    bucket, size = key & (_BUCKETS - 1), ways.front[m, kind, _SIZE]
    ways.entry[m, kind, size] = cell
    ways.after[m, kind, size] = ways.head[m, kind, bucket]
    ways.head[m, kind, bucket] = size
    ways.front[m, kind, _SIZE] += 1
    ways.front[m, kind, _WAITING] += 1


@compiled
def _set_box(static: Static, dynamic: Dynamic, ways: Ways, m: int, n: int) -> None:
    """Lays the box around an agent's target and its net's open pins, within the grid."""
    agent = dynamic.agents[m, n]
    columns, rows, _ = grid_of(static)
    margin = widened(static, dynamic, m, i64(ways.margin))
    for axis in range(VIA_AXIS):
        low = high = i64(static.position[agent.target, axis])
        for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
            if task != agent.task and not is_later(static, dynamic, m, n, i64(task)):
                continue
            for end in range(task != agent.task, 2):
                at = i64(static.position[static.tasks[task, end], axis])
                low, high = min(low, at), max(high, at)
        ways.low[m, axis] = max(low - margin, 0)
        ways.high[m, axis] = min(high + margin, (rows if axis else columns) - 1)


@compiled
def _room(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, axis: int) -> int:
    """Capacity that the edge of a Gcell towards +x or +y has for a net, as if it did not use it."""
    edge = as_index(AXES * cell + axis)
    demand = i64(static.demand[m, n, static.position[cell, VIA_AXIS]])
    return i64(dynamic.remaining[m, edge]) + demand * uses(dynamic.used, m, n, edge)


@compiled
def widened(static: Static, dynamic: Dynamic, m: int, margin: int) -> int:
    """A margin in the present round: the longer priced rounds gain nothing, the wider it is."""
    return margin + 2 * i64(dynamic.games[m].stuck) * is_priced(static, dynamic, m)


@compiled
def _is_end(static: Static, dynamic: Dynamic, m: int, n: int, cell: int) -> bool:
    """Whether an agent's task ends in a Gcell."""
    if is_on(static, Option.TREE_TARGET):
        return holds(static, dynamic, m, Option.TREE, n, cell) != 0
    return cell == dynamic.agents[m, n].target


@compiled
def _mixed(known: int, number: int) -> int:
    """A digest of numbers, with one more."""
    known = (known ^ number) * _FACTOR
    return known ^ known >> 32


@compiled
def _digest(static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int) -> int:
    """A digest of all that the cheapest ways of an agent follow from, never 0."""
    _, rows, layers = grid_of(static)
    priced = is_priced(static, dynamic, m)
    known = _mixed(i64(n), i64(dynamic.agents[m, n].task))
    known = _mixed(known, i64(dynamic.games[m].present) if priced else i64(NOBODY))
    for x in range(ways.low[m, 0], ways.high[m, 0] + 1):
        for y in range(ways.low[m, 1], ways.high[m, 1] + 1):
            for z in range(layers):
                cell = as_index((x * rows + y) * layers + z)
                known = _mixed(known, 2 * cell + _is_end(static, dynamic, m, n, cell))
                for axis in range(VIA_AXIS):
                    known = _mixed(known, _room(static, dynamic, m, n, cell, i64(axis)))
                    known = _mixed(known, i64(maps.expected[m, cell, axis]))
                    if priced:
                        price = price_of(static, dynamic, m, i64(AXES * cell + axis))
                        known = _mixed(known, price)
    return known | 1


@compiled
def find_ways(static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int) -> None:
    """Begins the searches for a task's cheapest ways, which :func:`_reach` carries on."""
    _, rows, layers = grid_of(static)
    ways.found[m] = 0
    _set_box(static, dynamic, ways, m, n)
    for kind in range(2):
        ways.head[m, kind, :] = NOBODY
        ways.front[m, kind, :] = 0
    # Where nobody else is expected, and room for the net is a track at least, nothing is scarce.
    scarce = False
    for z in range(layers):
        scarce |= static.demand[m, n, z] < 1
    for x in range(ways.low[m, 0], ways.high[m, 0] + 1):
        for y in range(ways.low[m, 1], ways.high[m, 1] + 1):
            for z in range(layers):
                cell = as_index((x * rows + y) * layers + z)
                for axis in range(VIA_AXIS):
                    scarce |= maps.expected[m, cell, axis] != 0
                ends = _is_end(static, dynamic, m, n, cell)
                for kind in range(2):
                    ways.cost[m, kind, cell] = 0 if ends else _FARTHEST
                    if ends:
                        ways.end[m, cell] = cell
                        _put(ways, m, i64(kind), i64(0), cell)
    ways.kinds[m] = 1 + scarce


@compiled
def _reach(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int, kind: int, cell: int
) -> int:
    """The cost of the cheapest way from a Gcell to a task's end; ``kind`` 1: with slack."""
    kind = min(kind, i64(ways.kinds[m]) - 1)
    front = ways.front[m, kind]
    x0, x1 = i64(ways.low[m, 0]), i64(ways.high[m, 0])
    y0, y1 = i64(ways.low[m, 1]), i64(ways.high[m, 1])
    while front[_WAITING] > 0 and ways.cost[m, kind, cell] > front[_KEY]:
        key = i64(front[_KEY])
        bucket = key & (_BUCKETS - 1)
        while ways.head[m, kind, bucket] != NOBODY:
            first = as_index(ways.head[m, kind, bucket])
            ways.head[m, kind, bucket] = ways.after[m, kind, first]
            front[_WAITING] -= 1
            here = as_index(ways.entry[m, kind, first])
            if ways.cost[m, kind, here] != key:
                continue  # a cheaper way has come first
            for move in range(MOVES):
                if not static.exits[here] >> move & 1:
                    continue
                ahead = as_index(static.neighbour[here, move])
                x, y, _ = position(static, ahead)
                if not (x0 <= x <= x1 and y0 <= y <= y1):
                    continue
                cost = key + _edge_cost(static, dynamic, maps, m, n, here, i64(move), kind == 1)
                if cost < ways.cost[m, kind, ahead]:
                    ways.cost[m, kind, ahead] = cost
                    if kind == 0:
                        ways.end[m, ahead] = ways.end[m, here]
                    _put(ways, m, kind, cost, ahead)
        front[_KEY] += 1
    return i64(ways.cost[m, kind, cell])


# --- rows -----------------------------------------------------------------------------------------


@compiled
def _far(distance: Any) -> Any:
    """float32, a distance; see far(d) in the module's docstring."""
    eighths = np.float32(abs(distance)) / np.float32(8)
    if eighths > 1:
        eighths = min(np.float32(1) + np.log(eighths), _MOST_FAR)
    return eighths if distance >= 0 else -eighths


@compiled
def _pin_of(static: Static, dynamic: Dynamic, m: int, n: int, task: int) -> int:
    """The Gcell that is seen as the pin of an open task."""
    agent = dynamic.agents[m, n]
    return as_index(agent.target) if task == agent.task else as_index(static.tasks[task, 1])


@compiled
def _touch(static: Static, ways: Ways, m: int, cell: int) -> None:
    """Notes that an edge of the net touches a Gcell."""
    layers = grid_of(static)[VIA_AXIS]
    ways.touched[m, as_index(cell // layers)] = ways.counts[m]


@compiled
def _note_wire(static: Static, dynamic: Dynamic, ways: Ways, m: int, n: int, cell: int) -> None:
    """Takes a Gcell into what an agent's net has wired."""
    agent = dynamic.agents[m, n]
    for task in range(i64(static.first[m, n]), i64(static.first[m, n + 1])):
        if task == agent.task or is_later(static, dynamic, m, n, i64(task)):
            apart = distance(static, _pin_of(static, dynamic, m, n, i64(task)), cell)
            ways.wired[task] = min(i64(ways.wired[task]), apart)


@compiled
def note_move(static: Static, dynamic: Dynamic, ways: Ways, m: int, n: int) -> None:
    """Takes the Gcell that an agent has got to into what its net has wired."""
    agent = dynamic.agents[m, n]
    _note_wire(static, dynamic, ways, m, n, as_index(agent.cell))
    if agent.crossing == Crossing.NEW or agent.crossing == Crossing.OWN:
        _touch(static, ways, m, as_index(agent.cell))
        _touch(static, ways, m, as_index(ways.start[m]))


@compiled
def find_wires(static: Static, dynamic: Dynamic, ways: Ways, m: int, n: int) -> None:
    """Finds how far open pins are from what the net has wired; :func:`note_move` keeps it right."""
    ways.counts[m] += 1
    ways.start[m] = dynamic.agents[m, n].cell
    ways.wired[static.first[m, n] : static.first[m, n + 1]] = _FARTHEST
    _note_wire(static, dynamic, ways, m, n, as_index(dynamic.agents[m, n].cell))
    edge = next_in(dynamic.used, m, n, i64(0))
    while edge != NOBODY:
        cell = as_index(edge // AXES)
        ahead = as_index(static.neighbour[cell, 2 * (edge % AXES)])
        for end in (cell, ahead):
            _note_wire(static, dynamic, ways, m, n, end)
            _touch(static, ways, m, end)
        edge = next_in(dynamic.used, m, n, edge + 1)


@compiled
def _move_of(static: Static, cell: int, target: int, way: int) -> int:
    """The move on the grid that a move of the frame is."""
    axis = way // 2
    if axis == VIA_AXIS:
        return way
    return way ^ i64(static.position[target, axis] < static.position[cell, axis])


@compiled
def _ahead(static: Static, ways: Ways, m: int, cell: int, move: int) -> int:
    """The Gcell that a move leads to; NOBODY off the grid or outside the box of the ways."""
    if not static.exits[cell] >> move & 1:
        return i64(NOBODY)
    ahead = as_index(static.neighbour[cell, move])
    x, y, _ = position(static, ahead)
    inside = ways.low[m, 0] <= x <= ways.high[m, 0] and ways.low[m, 1] <= y <= ways.high[m, 1]
    return i64(ahead) if inside else i64(NOBODY)


@compiled
def _write_moves(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int, out: Any, row: int
) -> None:
    """Writes the blocks ``detour`` and ``crossed``."""
    agent = dynamic.agents[m, n]
    cell, target = as_index(agent.cell), as_index(agent.target)
    layer = as_index(static.position[cell, VIA_AXIS])
    for kind in range(2):
        least = i64(_FARTHEST)
        for turn in range(2):
            for way in range(MOVES):
                move = _move_of(static, cell, target, i64(way))
                ahead, whole = _ahead(static, ways, m, cell, move), i64(_FARTHEST)
                if ahead != NOBODY:
                    cost = _edge_cost(static, dynamic, maps, m, n, cell, move, kind == 1)
                    on = _reach(static, dynamic, maps, ways, m, n, i64(kind), as_index(ahead))
                    whole = min(cost + on, whole)
                if turn == 0:
                    least = min(least, whole)
                elif whole == _FARTHEST:
                    out[row, _NUMBERS + MOVES * kind + way] = 1
                else:
                    dearer = np.float32(whole - least) / np.float32(_UNIT)
                    out[row, _NUMBERS + MOVES * kind + way] = squashed(dearer)
    for way in range(2 * VIA_AXIS):
        axis, move = way // 2, _move_of(static, cell, target, i64(way))
        room = left = np.float32(-1)
        if static.exits[cell] >> move & 1:
            edge = as_index(static.edge[cell, move])
            track = np.float32(max(static.demand[m, n, layer], 1))
            remaining = i64(dynamic.remaining[m, edge])
            room = squashed(np.floor(np.float32(remaining) / track))
            left = squashed(slack_of(maps, m, as_index(edge // AXES), axis, remaining, track))
        out[row, _EDGES + way] = room
        out[row, _EDGES + 2 * VIA_AXIS + way] = left


@compiled
def _find_pins(static: Static, dynamic: Dynamic, ways: Ways, m: int, n: int) -> None:
    """Finds which open pins are seen beside the target, the nearest to the agent first."""
    task, far = i64(NOBODY), i64(-1)
    for k in range(_PINS - 1):
        if k == 0 or task != NOBODY:
            task, far = next_nearest(static, dynamic, m, n, far, task)
        ways.seen[k] = task


@compiled
def _span(static: Static, ways: Ways, m: int, pins: int, cell: int) -> int:
    """Edges of the spanning tree from a Gcell, times _UNIT, by Prim's algorithm.

    Nodes are the end of the task (0) and the open pins that are seen (from 1).
    """
    ways.span[0] = ways.cost[m, 0, cell]
    for k in range(pins):
        task = as_index(ways.seen[k])
        near = min(distance(static, as_index(static.tasks[task, 1]), cell), i64(ways.wired[task]))
        ways.span[k + 1] = _UNIT * near
    total = i64(0)
    for _ in range(pins + 1):
        nearest = i64(NOBODY)
        for k in range(pins + 1):
            open_ = ways.span[k] >= 0
            if open_ and (nearest == NOBODY or ways.span[k] < ways.span[nearest]):
                nearest = i64(k)
        total += i64(ways.span[nearest])
        ways.span[nearest] = -1
        for k in range(pins + 1):
            if ways.span[k] < 0:
                continue
            if nearest == 0 or k == 0:
                pin = as_index(static.tasks[as_index(ways.seen[nearest + k - 1]), 1])
                apart = i64(ways.cost[m, 0, pin])
            else:
                a, b = as_index(ways.seen[nearest - 1]), as_index(ways.seen[k - 1])
                pin = as_index(static.tasks[a, 1])
                apart = _UNIT * distance(static, pin, as_index(static.tasks[b, 1]))
            ways.span[k] = min(i64(ways.span[k]), apart)
    return total


@compiled
def _write_spans(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int, out: Any, row: int
) -> None:
    """Writes the block ``span``."""
    agent = dynamic.agents[m, n]
    cell, target = as_index(agent.cell), as_index(agent.target)
    pins, least = i64(0), i64(1 << 62)
    while pins < _PINS - 1 and ways.seen[pins] != NOBODY:
        pin = as_index(static.tasks[as_index(ways.seen[pins]), 1])
        _ = _reach(static, dynamic, maps, ways, m, n, i64(0), pin)
        pins += 1
    for way in range(MOVES):
        ways.total[way] = NOBODY
        move = _move_of(static, cell, target, i64(way))
        ahead = _ahead(static, ways, m, cell, move)
        # Where the detour is unknown the agent cannot go.
        if ahead == NOBODY or out[row, _NUMBERS + way] == 1:
            continue
        total = _span(static, ways, m, pins, as_index(ahead))
        ways.total[way] = total + _edge_cost(static, dynamic, maps, m, n, cell, move, False)
        least = min(least, i64(ways.total[way]))
    for way in range(MOVES):
        more = np.float32(1)
        if ways.total[way] != NOBODY:
            more = squashed(np.float32(ways.total[way] - least) / np.float32(_UNIT))
        out[row, _SPANS + way] = more


@compiled
def _write_pins(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int, out: Any, row: int
) -> None:
    """Writes the block ``pins``, and sets what is 1 in the block ``open``."""
    agent = dynamic.agents[m, n]
    cell, target = as_index(agent.cell), as_index(agent.target)
    x, y, z = position(static, cell)
    sign_x = 1 if static.position[target, 0] >= x else -1
    sign_y = 1 if static.position[target, 1] >= y else -1
    radius = i64(ways.radius)
    first, side = _FIRST_PIN, 2 * radius + 1
    opened = out.shape[1] - side * side
    for k in range(_PIN * _PINS):
        out[row, first + k] = 0
    begin, end = i64(static.first[m, n]), i64(static.first[m, n + 1])
    for count in range(_PINS):
        task = i64(agent.task)
        if count > 0:
            task = i64(ways.seen[count - 1])
            if task == NOBODY:
                break
        pin = _pin_of(static, dynamic, m, n, task)
        px, py, pz = position(static, pin)
        at = first + _PIN * count
        out[row, at] = 1
        out[row, at + 1] = _far(sign_x * (px - x))
        out[row, at + 2] = _far(sign_y * (py - y))
        out[row, at + 3] = _far(pz - z)
        cost = _reach(static, dynamic, maps, ways, m, n, i64(0), pin)
        out[row, at + 4] = _far(np.float32(cost) / np.float32(_UNIT))
        if cost < _FARTHEST:
            px, py, _ = position(static, as_index(ways.end[m, pin]))
        out[row, at + 5] = _far(sign_x * (px - x))
        out[row, at + 6] = _far(sign_y * (py - y))
        out[row, at + 7] = _far(i64(ways.wired[task]))
    for other in range(begin, end):
        if other == agent.task or is_later(static, dynamic, m, n, i64(other)):
            pin = target if other == agent.task else as_index(static.tasks[other, 1])
            px, py, _ = position(static, pin)
            i, j = sign_x * (px - x) + radius, sign_y * (py - y) + radius
            if 0 <= i < side and 0 <= j < side:
                out[row, opened + i * side + j] = 1


@compiled
def _write_folded(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int, out: Any, row: int
) -> None:
    """Writes the blocks of the folded window; in ``open`` zeros."""
    columns, rows, layers = grid_of(static)
    agent = dynamic.agents[m, n]
    cell, target = as_index(agent.cell), as_index(agent.target)
    x, y, _ = position(static, cell)
    right, up = static.position[target, 0] >= x, static.position[target, 1] >= y
    radius = i64(ways.radius)
    side = 2 * radius + 1
    edges = side * (side + 1)
    for axis in range(VIA_AXIS):
        along_x, along_y = i64(axis == 0), i64(axis == 1)
        p = i64(_FIXED + axis * edges)
        for i in range(-radius - along_x, radius + 1):
            gx = x + i if right else x - i - along_x
            in_x = 0 <= gx < columns - along_x
            for j in range(-radius - along_y, radius + 1):
                gy = y + j if up else y - j - along_y
                room = left = np.float32(0)
                if in_x and 0 <= gy < rows - along_y:
                    room = left = np.float32(-1)
                    for z in range(layers):
                        at = as_index((gx * rows + gy) * layers + z)
                        remaining = dynamic.remaining[m, AXES * at + axis]
                        track = np.float32(max(static.demand[m, n, z], 1))
                        here = squashed(np.floor(np.float32(remaining) / track))
                        room = max(room, here)
                        here = squashed(slack_of(maps, m, at, axis, remaining, track))
                        left = max(left, here)
                out[row, p] = room
                out[row, p + 2 * edges] = left
                p += 1
    p = i64(_FIXED + 4 * edges)
    for i in range(-radius, radius + 1):
        gx = x + i if right else x - i
        for j in range(-radius, radius + 1):
            gy = y + j if up else y - j
            own = 0 <= gx < columns and 0 <= gy < rows
            out[row, p] = own and ways.touched[m, as_index(gx * rows + gy)] == ways.counts[m]
            out[row, p + side * side] = 0
            p += 1


@compiled
def write_outlook(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, m: int, n: int, out: Any, row: int
) -> None:
    """Fills a row of ``out`` (K, size); ``maps`` and ``ways`` have been brought up to date."""
    write_numbers(static, dynamic, m, n, out, row)
    _write_moves(static, dynamic, maps, ways, m, n, out, row)
    _write_folded(static, dynamic, maps, ways, m, n, out, row)
    _find_pins(static, dynamic, ways, m, n)
    _write_spans(static, dynamic, maps, ways, m, n, out, row)
    _write_pins(static, dynamic, maps, ways, m, n, out, row)


@compiled
def _write(
    static: Static, dynamic: Dynamic, maps: Maps, ways: Ways, problems: Any, agents: Any, out: Any
) -> None:
    """Fills ``out`` (K, size)."""
    for i in range(len(problems)):
        m, n = i64(problems[i]), i64(agents[i])
        if n == NOBODY:
            for f in range(out.shape[1]):
                out[i, f] = 0
            continue
        m, n = as_index(m), as_index(n)
        refresh(static, dynamic, maps, m, n)
        _set_box(static, dynamic, ways, m, n)
        known = _digest(static, dynamic, maps, ways, m, n)
        if ways.found[m] != known:
            find_ways(static, dynamic, maps, ways, m, n)
            ways.found[m] = known
        find_wires(static, dynamic, ways, m, n)
        write_outlook(static, dynamic, maps, ways, m, n, out, i)
