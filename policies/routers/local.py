"""Local rules: nets that move in turns, once, each by what it sees around it.

They are the heuristics of the decentralised scenarios (``docs/cooperation.md``). No net plans for
another one, and none is rerouted.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import Engine, Problem, Solution
from marouting.batch.edges import may_cross, uses
from marouting.batch.rules import free_moves, move_player, settle_player
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import holds, is_on
from marouting.config import MOST, check
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import MOVES, VIA_AXIS
from marouting.rules import Mask, NetOrder, Nets, Rules, Target, TurnOrder
from marouting.trees.heap import pop, push

COMPILES = "the local rules", 5

Rule = Literal["shortest", "greedy", "random"]

_SHORTEST, _GREEDY, _RANDOM = range(3)
_NUMBERS: dict[Rule, int] = {"shortest": _SHORTEST, "greedy": _GREEDY, "random": _RANDOM}

_EDGE = 1 << 10  # what an edge costs in a search
_FAR = np.iinfo(np.int64).max >> 2


@dataclass(frozen=True)
class LocalRouter:
    """Nets move in turns by a fixed rule, with what they see at that moment.

    Attributes:
        rule: ``shortest``: the first move of a shortest path, planned anew at every move;
            ``greedy``: the move to the neighbour nearest to the target in x and y, across the edge
            with the most remaining capacity; ``random``: any move that crosses an edge.
        radius: for ``shortest``, how many Gcells a net sees in each direction of x and y; None for
            the whole grid. Beyond, it expects free ways.
        price: for ``shortest``, what an edge costs beside its length: this, divided by its
            remaining capacity.
        seen: whether the price counts only while another net's head is within the radius.
        turn_order, max_steps, target, next_pin: see :class:`marouting.rules.Rules`.
        net_order: which nets come first, see :class:`marouting.rules.Nets`.
        seed: seed of the random moves.

    Raises:
        InputError: a number is out of range.
    """

    rule: Rule = "shortest"
    radius: int | None = 3
    price: float = 0.0
    seen: bool = False
    turn_order: TurnOrder = "round_robin"
    max_steps: int | None = None
    target: Target = "pin"
    next_pin: Literal["listed", "nearest"] = "listed"
    net_order: NetOrder = "half_perimeter"
    seed: int = 0

    def __post_init__(self) -> None:
        check("radius", self.radius is None or 1 <= self.radius <= MOST, f"1 to {MOST}, or null")
        check("price", 0 <= self.price <= 1000, "a number from 0 to 1000")
        check("price", not self.price or self.rule == "shortest", "0, without rule: shortest")
        check("seen", self.price > 0 or not self.seen, "false, without a price")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")
        _ = self.rules

    @property
    def seeded(self) -> bool:
        """Whether the router draws random numbers with these options."""
        return self.rule == "random"

    @property
    def rules(self) -> Rules:
        """The game that it plays as a router."""
        return Rules(
            turn_order=self.turn_order,
            max_steps=self.max_steps,
            target=self.target,
            next_pin=self.next_pin,
            nets=Nets(order=self.net_order),
            mask=Mask(visited=True),
            release_failed=True,
        )

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution without overflow, in which nets stay open where they found no way.
        """
        return self.play([problem], self.rules).solution()

    def play(self, problems: Sequence[Problem], rules: Rules) -> Engine:
        """Plays problems of one grid shape to their end, by any rules without rip-up."""
        engine = Engine(problems, rules)
        rng = np.random.default_rng(self.seed)
        _play(engine.static, engine.dynamic, *self._prepared(engine, rng))
        return engine

    def moves(self, engine: Engine, rng: np.random.Generator) -> NDArray[np.int16]:
        """(M, N) int16, what the agents of M games would do next in the present state.

        Args:
            engine: games of one grid shape, without rip-up.
            rng: what random moves are drawn from.

        Returns:
            The moves; -1 for agents that are done or absent.
        """
        moves = np.full(engine.agents.shape, NOBODY, np.int16)
        _choose(engine.static, engine.dynamic, *self._prepared(engine, rng), moves)
        return moves

    def _prepared(self, engine: Engine, rng: np.random.Generator) -> tuple["_Buffers", "_View"]:
        """What compiled code takes beside the games."""
        radius = max(engine.grid.shape) if self.radius is None else self.radius
        price, seen = int(self.price * _EDGE), i64(self.seen)
        view = _View(i64(_NUMBERS[self.rule]), i64(radius), i64(price), seen)
        return _buffers(engine.problems[0], int(rng.integers(1, 2**62))), view


class _View(NamedTuple):
    """What compiled code has to know of the options."""

    rule: int
    radius: int
    price: int  # in parts of _EDGE
    seen: int


class _Buffers(NamedTuple):
    """Working arrays of a search."""

    heap: NDArray[np.int64]  # cost · G + Gcell
    cost: NDArray[np.int64]  # (G,) the least cost of a path from the agent
    first: NDArray[np.int8]  # (G,) its first move
    vias: NDArray[np.int64]  # (2, 2, Z, Z) see _least_vias
    random: NDArray[np.uint64]  # (1,) state of the random numbers


def _buffers(problem: Problem, seed: int) -> _Buffers:
    grid = problem.topology
    return _Buffers(
        heap=np.empty(MOVES * grid.gcells + 1, np.int64),
        cost=np.empty(grid.gcells, np.int64),
        first=np.empty(grid.gcells, np.int8),
        vias=_least_vias(problem),
        random=np.array([seed], np.uint64),
    )


def _least_vias(problem: Problem) -> NDArray[np.int64]:
    """The least vias of a way: by whether it leads along x, along y, and its first and last layer.

    Layers without tracks in a direction are of no use for it.
    """
    layers = problem.grid[2]
    along = [np.flatnonzero(problem.layer_capacity[:, axis]).tolist() for axis in range(VIA_AXIS)]
    table = np.zeros((2, 2, layers, layers), np.int64)
    for x, y, first, last in np.ndindex(*table.shape):
        stops = [along[axis] or [first] for axis, needed in enumerate((x, y)) if needed]
        table[x, y, first, last] = min(
            sum(abs(a - b) for a, b in itertools.pairwise((first, *order, last)))
            for visited in itertools.product(*stops)
            for order in itertools.permutations(visited)
        )
    return table


@compiled
def _play(static: Static, dynamic: Dynamic, b: _Buffers, view: _View) -> None:
    """Plays all games to their end."""
    for m in range(len(dynamic.games)):
        while dynamic.games[m].agent != NOBODY:
            n = as_index(dynamic.games[m].agent)
            move_player(static, dynamic, m, _move(static, dynamic, b, view, m, n))
            settle_player(static, dynamic, m)


@compiled
def _choose(
    static: Static, dynamic: Dynamic, b: _Buffers, view: _View, moves: NDArray[np.int16]
) -> None:
    """Writes what every agent would do next."""
    for m in range(len(dynamic.games)):
        for n in range(dynamic.agents.shape[1]):
            if dynamic.agents[m, n].status == Status.ACTIVE:
                moves[m, n] = _move(static, dynamic, b, view, m, n)


@compiled
def _move(static: Static, dynamic: Dynamic, b: _Buffers, view: _View, m: int, n: int) -> int:
    """An agent's move by the rule; if all are blocked, the first."""
    free = free_moves(static, dynamic, m, n)
    if free & (free - 1) == 0:  # one or none
        move = i64(0)
        while free >> move > 1:
            move += 1
        return move
    if view.rule == _RANDOM:
        return _random(b, free)
    if view.rule == _SHORTEST:
        move = _shortest(static, dynamic, b, view, m, n, free)
        if move != NOBODY:
            return move
    return _greedy(static, dynamic, m, n, free)


@compiled
def _random(b: _Buffers, free: int) -> int:
    """One of the free moves, drawn uniformly (xorshift64*)."""
    while True:
        x = b.random[0]
        x ^= x >> np.uint64(12)
        x ^= x << np.uint64(25)
        x ^= x >> np.uint64(27)
        b.random[0] = x
        drawn = i64((x * np.uint64(2685821657736338717)) >> np.uint64(61))
        if drawn < MOVES and free >> drawn & 1:
            return drawn


@compiled
def _greedy(static: Static, dynamic: Dynamic, m: int, n: int, free: int) -> int:
    """The free move nearest to the target, then across the edge with the most tracks left."""
    agent = dynamic.agents[m, n]
    cell, target = as_index(agent.cell), as_index(agent.target)
    best, move = i64(-_FAR), i64(0)
    for candidate in range(MOVES):
        if not free >> candidate & 1:
            continue
        edge = as_index(static.edge[cell, candidate])
        room = i64(min(i64(dynamic.remaining[m, edge]), 1000))
        if candidate // 2 == VIA_AXIS:
            room = i64(0)
        if uses(dynamic.used, m, n, edge):
            room = i64(1001)
        ahead = as_index(static.neighbour[cell, candidate])
        across = i64(0)
        for axis in range(VIA_AXIS):
            across += abs(i64(static.position[ahead, axis]) - i64(static.position[target, axis]))
        up = abs(i64(static.position[ahead, VIA_AXIS]) - i64(static.position[target, VIA_AXIS]))
        # Layers count last: the way in x and y may need another one.
        value = -(across * 4096 + (up if across == 0 else 0) * 2048 - room)
        if value > best:
            best, move = value, i64(candidate)
    return move


@compiled
def _price(static: Static, dynamic: Dynamic, view: _View, m: int, n: int) -> int:
    """What the agent adds to the length of edges, in parts of an edge, for one track left."""
    if not view.seen:
        return view.price
    if static.sequential:  # the others have arrived, or are not there yet
        return i64(0)
    cell = as_index(dynamic.agents[m, n].cell)
    for other in range(dynamic.agents.shape[1]):
        agent = dynamic.agents[m, other]
        if other == n or agent.status != Status.ACTIVE:
            continue
        away = _away(static, cell, as_index(agent.cell))
        if away <= view.radius:
            return view.price
    return i64(0)


@compiled
def _away(static: Static, a: int, b: int) -> int:
    """The larger of two Gcells' distances in x and in y."""
    x = abs(i64(static.position[a, 0]) - i64(static.position[b, 0]))
    y = abs(i64(static.position[a, 1]) - i64(static.position[b, 1]))
    return max(x, y)


@compiled
def _shortest(
    static: Static, dynamic: Dynamic, b: _Buffers, view: _View, m: int, n: int, free: int
) -> int:
    """The first move of a cheapest path; NOBODY if none leads to the target or out of sight.

    Where the agent sees the border of what it sees, it expects the rest of the way to be free.
    """
    agent = dynamic.agents[m, n]
    start, target = as_index(agent.cell), as_index(agent.target)
    gcells = len(b.cost)
    price = _price(static, dynamic, view, m, n)
    visited = static.extended is not None and is_on(static, Option.MASK_VISITED)
    for cell in range(gcells):
        b.cost[cell] = _FAR
    b.cost[start] = 0
    push(b.heap, 0, i64(start))
    size = 1
    best, move = i64(_FAR), i64(NOBODY)
    while size > 0:
        key = i64(pop(b.heap, size))
        size -= 1
        cost, cell = key // gcells, as_index(key % gcells)
        if cost > b.cost[cell] or cost >= best:
            continue
        if cell == target:
            best, move = cost, i64(b.first[cell])
            continue
        for step in range(MOVES):
            if not static.exits[cell] >> step & 1:
                continue
            ahead = as_index(static.neighbour[cell, step])
            if _away(static, start, ahead) > view.radius:
                if cell != start:
                    left = cost + _EDGE * _distance(static, b, cell, target)
                    if left < best:
                        best, move = left, i64(b.first[cell])
                continue
            if cell == start:
                if not free >> step & 1:
                    continue
            elif not may_cross(static, dynamic, m, n, cell, step):
                continue
            if visited and cell != start and holds(static, dynamic, m, Option.VISITED, n, ahead):
                continue
            edge = as_index(static.edge[cell, step])
            length = i64(_EDGE)
            if uses(dynamic.used, m, n, edge):
                length = i64(1)  # no new wire
            elif step // 2 != VIA_AXIS:
                length += price // max(i64(dynamic.remaining[m, edge]), 1)
            if cost + length < b.cost[ahead]:
                b.cost[ahead] = cost + length
                b.first[ahead] = step if cell == start else b.first[cell]
                push(b.heap, size, (cost + length) * gcells + ahead)
                size += 1
    return move


@compiled
def _distance(static: Static, b: _Buffers, start: int, target: int) -> int:
    """The length of a way between two Gcells if all edges of their layers' directions are free."""
    here, there = static.position[start], static.position[target]
    x, y = abs(i64(here[0]) - i64(there[0])), abs(i64(here[1]) - i64(there[1]))
    vias = b.vias[i64(x > 0), i64(y > 0), here[VIA_AXIS], there[VIA_AXIS]]
    return x + y + i64(vias)
