"""A network walks whole games in one compiled loop, several side by side.

It plays in sequential turn order with the observation ``outlook``. While one net moves, the
predicted demand of the others and the cheapest paths do not change, so they are computed once a
task. This makes it many times as fast as the same policy through the player.

An agent may follow given routes of its net, as far as they lead to its target
(:mod:`marouting.search.guides`), for example those of another game. In games with prices an agent
whose net has few pins follows a cheapest tree (:mod:`policies.generalist.cheapest_tree`).

An agent that has not arrived after a quarter of its steps takes the cheapest path from there,
unless ``fallback_after`` is None.

With ``choose: agents``, an agent rips up its net if one of its tasks is open; if the net uses an
edge with overflow; or, in a problem without overflow, if an earlier route of the net was shorter
(reroutes that were undone count too, except for their last net). In the first round, and
the first of a series of priced ones, it does so if its edges cost more than shortest routes would
without prices; in the other priced rounds, only for overflow. Any other net is ripped up in one
round out of eight, unless only overflow counts.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import next_in
from marouting.batch.engine import Engine
from marouting.batch.expected import Maps, maps_of, refresh
from marouting.batch.prices import UNIT, first_present, is_priced, net_cost, put_best
from marouting.batch.rules import free_moves, move_player, pass_turn, settle_agent
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import is_on
from marouting.game import NOBODY, RIP_UP, Status
from marouting.kernels import allocating, as_index, compiled, i64, specialised
from marouting.problem.grid import MOVES, VIA_AXIS
from marouting.search.guides import move_along
from policies.generalist.cheapest_tree import Trees, is_planned, make_trees, move_on_tree, plan_tree
from policies.generalist.outlook import (
    DETOURS,
    OutlookObservation,
    Ways,
    find_ways,
    find_wires,
    note_move,
    ways_of,
    widened,
    write_outlook,
)
from policies.learned.compiled.gradient import forward
from policies.learned.counter_rng import uniform

_ANYWAY = 8
"""In one round out of these a net is ripped up without a reason."""

MOST_STEPS = 2**20
"""Moves of each game in one go, at most."""

_MARGIN = 1
"""Gcells around a net's pins within which its tree is looked for; more in priced rounds that gain
nothing. Wider boxes take longer; without any, nets with two pins in line cannot part in time."""

_RANDOM = 2.0**30
"""Trees of equal cost are drawn by a number below this."""

_COOLER = 0.5
"""Share of the temperature in priced rounds: prices drive nets apart as well."""


class WalkState(NamedTuple):
    """What a walk needs beside the games."""

    maps: Maps  # predicted demand of the games
    ways: Ways  # cheapest ways in them
    sizes: NDArray[np.int64]  # units of all layers, the inputs first
    weights: NDArray[np.float32]  # flat, as the parameters of the network lie one after another
    late: int  # steps of a task after which an agent goes on by the cheapest way
    temperature: NDArray[np.float32]  # (M,) at which moves are drawn; 0: the best move
    keys: NDArray[np.uint64]  # (M,) of random numbers
    counters: NDArray[np.int64]  # (M,)
    rows: NDArray[np.float32]  # (M, F) working
    scores: NDArray[np.float32]  # (M · units) working
    game: NDArray[np.int64]  # (M,) working: the game of each row
    playing: NDArray[np.bool_]  # (M,) which games are played
    shortest: NDArray[np.int64]  # (M, N) the fewest edges that have joined a whole net so far
    guided: NDArray[np.bool_]  # (M,) whether the agents follow the guide
    guide: NDArray[Any]  # (1, N, …) bits, the edges that each net uses in another engine's game
    searches: NDArray[np.int64]  # (1,) how many have been made along the guide
    seen: NDArray[np.int64]  # (G,) the last of them that reached a Gcell
    reached: NDArray[np.int32]  # (G,) working: the Gcells that it reached
    exact_pins: int  # the most pins of a net that walks along a cheapest tree if there are prices
    trees: Trees


class Walker:
    """Plays games with a network that moves all nets.

    Args:
        engine: the games, in turn order.
        observation: what agents see.
        sizes: units of the network's layers, the inputs first.
        weights: of the network, as its parameters lie one after another.
        temperature: (M,) see :class:`WalkState`; may be changed.
        keys: (M,) of random numbers.
        fallback_after: share of a task's steps after which an agent goes on by the cheapest way;
            None: never.
        exact_pins: the most pins of a net that walks along a cheapest tree in games with prices.

    Attributes:
        playing: (M,) which games are played; may be changed.
        counters: (M,) moves that agents have made in each game.
    """

    def __init__(
        self,
        engine: Engine,
        observation: OutlookObservation,
        sizes: tuple[int, ...],
        weights: NDArray[np.float32],
        temperature: NDArray[np.float32],
        keys: NDArray[np.uint64],
        *,
        fallback_after: float | None = 0.25,
        exact_pins: int = 0,
    ) -> None:
        self._engine = engine
        count, cells, most = len(engine.games), engine.grid.gcells, int(engine.static.max_steps)
        self._given = WalkState(
            maps=maps_of(engine),
            ways=ways_of(engine, observation),
            sizes=np.array(sizes, np.int64),
            weights=weights,
            late=most + 1 if fallback_after is None else math.ceil(most * fallback_after),
            temperature=temperature,
            keys=keys,
            counters=np.zeros(count, np.int64),
            rows=np.zeros((count, observation.size), np.float32),
            scores=np.zeros(count * sum(sizes[1:]), np.float32),
            game=np.zeros(count, np.int64),
            playing=np.ones(count, np.bool_),
            shortest=np.full(engine.nets.shape, np.iinfo(np.int64).max),
            guided=np.zeros(count, np.bool_),
            guide=engine.dynamic.used,
            searches=np.zeros(1, np.int64),
            seen=np.zeros(cells, np.int64),
            reached=np.zeros(cells, np.int32),
            exact_pins=exact_pins,
            trees=make_trees(engine, exact_pins),
        )
        self.playing, self.counters = self._given.playing, self._given.counters
        self._kernel = specialised(_walk, engine.static, engine.dynamic, self._given, 0, False)

    def follow(self, guide: Engine | None) -> None:
        """From now on the first game follows the routes of the only game of another engine.

        Both play the same problem. An agent that the routes do not lead to its target goes on by
        the network.

        Args:
            guide: the other engine; None: from now on no game follows another.
        """
        self._given.guided[0] = guide is not None
        used = self._engine.dynamic.used if guide is None else guide.dynamic.used
        self._given = self._given._replace(guide=used)

    def walk(self, steps: int, *, stops: bool = False) -> bool:
        """Plays on.

        Args:
            steps: of each game, at most.
            stops: whether a game stops when its nets have walked. Otherwise it goes on with the
                next rip-up, as do games that have stopped.

        Returns:
            Whether all games have stopped or are over.
        """
        engine = self._engine
        return bool(self._kernel(engine.static, engine.dynamic, self._given, steps, stops))

    def walk_out(self, *, stops: bool = False) -> None:
        """Plays on until all games have stopped or are over; see :meth:`walk`."""
        while not self.walk(MOST_STEPS, stops=stops):
            pass


@compiled
def take_best(static: Static, dynamic: Dynamic) -> None:
    """Nets of games with prices take the best routes so far."""
    for m in range(len(dynamic.games)):
        if dynamic.games[m].round > 0:
            put_best(static, dynamic, i64(m))


@compiled
def _in_frame(rows: Any, row: int, move: int) -> int:
    """A move of the grid as a move of the frame of a row, or the other way round."""
    axis = move // 2
    return move ^ i64(axis < VIA_AXIS and rows[row, min(axis, VIA_AXIS - 1)] < 0)


@compiled
def _choose(
    given: WalkState, m: int, row: int, free: int, at: int, late: bool, temperature: float
) -> int:
    """The move on the grid that a row takes, drawn by Gumbel noise; its scores begin at ``at``."""
    if late:
        cheapest = i64(0)
        for way in range(1, MOVES):
            if given.rows[row, DETOURS + way] < given.rows[row, DETOURS + cheapest]:
                cheapest = i64(way)
        return _in_frame(given.rows, row, cheapest)
    best, most = i64(0), np.float32(-np.inf)
    for way in range(MOVES):
        move = _in_frame(given.rows, row, i64(way))
        if free != 0 and not free >> move & 1:
            continue
        score = given.scores[at + way]
        if temperature > 0:
            u = uniform(given.keys[m], given.counters[m], way)
            noise = -np.log(-np.log(max(u, 1e-12)))
            score += np.float32(temperature * noise)
        if score > most:
            best, most = move, score
    return best


@allocating
def _walk(static: Static, dynamic: Dynamic, given: WalkState, steps: int, stops: bool) -> bool:
    """See :meth:`Walker.walk`."""
    if not stops:
        _go_on(static, dynamic, given)
    for _ in range(steps):
        count, answered = i64(0), False
        for m in range(len(given.game)):
            n = i64(dynamic.games[m].agent)
            if not given.playing[m] or n == NOBODY or dynamic.games[m].active == 0:
                continue
            move = i64(NOBODY)
            if dynamic.games[m].asked:
                move = i64(RIP_UP if _rips_up(static, dynamic, given, i64(m), n) else 0)
            elif given.guided[m]:
                given.searches[0] += 1
                move = move_along(
                    static,
                    dynamic,
                    i64(m),
                    i64(n),
                    given.guide,
                    i64(0),
                    given.reached,
                    given.seen,
                    i64(given.searches[0]),
                )
            if move == NOBODY:
                move = _on_tree(static, dynamic, given, i64(m), as_index(n))
                given.counters[m] += move != NOBODY
            if move != NOBODY:
                _step(static, dynamic, given, i64(m), as_index(n), move, stops)
                answered = True
                continue
            _look(static, dynamic, given, i64(m), as_index(n), count)
            given.game[count] = m
            count += 1
        if count == 0:
            if answered:
                continue
            return True
        at = forward(given.sizes, given.weights, given.rows.reshape(-1), count, given.scores)
        for row in range(count):
            m = as_index(given.game[row])
            n = as_index(dynamic.games[m].agent)
            free = free_moves(static, dynamic, m, n)
            late = i64(dynamic.agents[m, n].steps) >= given.late
            warm = given.temperature[m] * (_COOLER if is_priced(static, dynamic, m) else 1.0)
            move = _choose(given, m, i64(row), free, at + row * given.sizes[-1], late, warm)
            given.counters[m] += 1
            _step(static, dynamic, given, m, n, move, stops)
    return False


@compiled
def _go_on(static: Static, dynamic: Dynamic, given: WalkState) -> None:
    """Begins the next rip-up in games that have stopped."""
    for m in range(len(given.playing)):
        game = dynamic.games[m]
        if given.playing[m] and game.active == 0 and game.agent != NOBODY:
            pass_turn(static, dynamic, i64(m))


@compiled
def _on_tree(static: Static, dynamic: Dynamic, given: WalkState, m: int, n: int) -> int:
    """An agent's move along a cheapest tree if there are prices; NOBODY: the network is to move."""
    if given.exact_pins < 2 or not is_on(static, Option.PRICES):
        return i64(NOBODY)
    agent = dynamic.agents[m, n]
    if agent.steps == 0 and agent.joined == 0 and not is_planned(dynamic, given.trees, m, n):
        random = i64(uniform(given.keys[m], given.counters[m], MOVES) * _RANDOM)
        margin = widened(static, dynamic, m, i64(_MARGIN))
        plan_tree(static, dynamic, given.trees, m, n, given.exact_pins, margin, random)
    return move_on_tree(static, dynamic, given.trees, m, n)


@compiled
def _look(static: Static, dynamic: Dynamic, given: WalkState, m: int, n: int, row: int) -> None:
    """Writes what an agent sees; finds ways if its task begins."""
    if dynamic.agents[m, n].steps == 0:
        refresh(static, dynamic, given.maps, m, n)
        find_ways(static, dynamic, given.maps, given.ways, m, n)
        find_wires(static, dynamic, given.ways, m, n)
    else:
        note_move(static, dynamic, given.ways, m, n)
    write_outlook(static, dynamic, given.maps, given.ways, m, n, given.rows, row)


@compiled
def _step(
    static: Static, dynamic: Dynamic, given: WalkState, m: int, n: int, move: int, stops: bool
) -> None:
    """The move of an agent, and what follows from it."""
    move_player(static, dynamic, m, move)
    settle_agent(static, dynamic, m, n)
    if dynamic.agents[m, n].status != Status.ACTIVE and _is_whole(static, dynamic, m, n):
        given.shortest[m, n] = min(given.shortest[m, n], _length(dynamic, m, n))
    if not stops or dynamic.games[m].active > 0:
        pass_turn(static, dynamic, m)


@compiled
def _is_whole(static: Static, dynamic: Dynamic, m: int, n: int) -> bool:
    """Whether all tasks of an agent are joined."""
    return dynamic.agents[m, n].joined == static.first[m, n + 1] - static.first[m, n]


@compiled
def _length(dynamic: Dynamic, m: int, n: int) -> int:
    """Edges that a net uses."""
    edges = i64(0)
    edge = next_in(dynamic.used, m, n, i64(0))
    while edge != NOBODY:
        edges += 1
        edge = next_in(dynamic.used, m, n, edge + 1)
    return edges


@compiled
def _is_over(dynamic: Dynamic, m: int, n: int) -> bool:
    """Whether a net uses an edge with overflow."""
    edge = next_in(dynamic.used, m, n, i64(0))
    while edge != NOBODY:
        if dynamic.remaining[m, edge] < 0:
            return True
        edge = next_in(dynamic.used, m, n, edge + 1)
    return False


@compiled
def _rips_up(static: Static, dynamic: Dynamic, given: WalkState, m: int, n: int) -> bool:
    """The answer of an agent that is asked; see the module's docstring."""
    game = dynamic.games[m]
    period = 1
    while period < min(_ANYWAY, static.order.shape[1]) and static.order[m, period] != NOBODY:
        period += 1
    if not _is_whole(static, dynamic, m, n):
        return True
    anyway = (i64(game.turn) + i64(game.round)) % period == 0
    begins = game.present == first_present(static) or game.round == 1
    if anyway and (begins or not is_priced(static, dynamic, m)):
        return True
    if is_priced(static, dynamic, m):
        if not begins:
            return _is_over(dynamic, m, n)
        cost = net_cost(static, dynamic, m, n, dynamic.used, n, i64(1))
        return cost > UNIT * given.shortest[m, n]
    if game.overflow > 0:
        return _is_over(dynamic, m, n)
    return _length(dynamic, m, n) > given.shortest[m, n]
