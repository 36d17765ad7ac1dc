"""Prices of edges, which rise round by round where demand exceeds capacity.

They need an engine with a :class:`Negotiation`, which only the generalist (policies/generalist)
uses. The first walk and some rip-up rounds (:mod:`marouting.batch.rounds`) are then **priced**. In
them an edge inside a layer costs a net

    (1 + price) · (1 + present · over / demand),

where ``price`` grows with the edge's past overflow; ``over`` is the overflow that the net would
cause, in tracks; and ``present`` begins with ``present_factor`` and grows from one priced round to
the next. So overflow is cheap at first, and nets with alternatives of nearly the same length leave
contested edges first. What overflow adds to a price grows along with ``present``, up to a limit. A
via costs 1. An edge that can never hold the net costs the maximum.

When priced rounds follow plain ones, ``present`` begins with ``present_factor`` again but grows
more slowly, and prices are lowered. With ``step_decay``, once there are routes without overflow,
prices change by less each time. Such diminishing steps are usual in
subgradient methods (Held, Wolfe and Crowder, "Validation of subgradient optimization", Mathematical
Programming 6, 1974).

This is negotiated congestion, after McMurchie and Ebeling, "PathFinder: a negotiation-based
performance-driven router for FPGAs", FPGA 1995, with agents that make moves. Costs are integers:
an edge without a price costs :data:`UNIT`. Prices have a finer unit, 1 / PRICE_SCALE.
"""

from dataclasses import dataclass
from typing import Any

from marouting.batch.bits import byte_of, copy_row, next_in
from marouting.batch.edges import use_edges
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import clear, grow_tree, is_on, keeps_tree
from marouting.checks import check_fields
from marouting.game import NOBODY, Status
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.rules import MOST_ROUNDS

UNIT = 16  # the cost of an edge without a price
MOST = 60 * UNIT  # the most that an edge costs
PRICE_SCALE = 1024  # ``GAME.present`` and prices count in parts of this

LEAST_PRESENT, MOST_PRESENT = 0.01, 2.0
"""The bounds of ``present``: rounding keeps a smaller one from growing, and a larger one outweighs
prices."""

LARGEST = int(MOST_PRESENT * PRICE_SCALE)  # the largest ``present``, in parts of ``PRICE_SCALE``
MOST_DECAY = 1000.0  # with the largest ``step_decay`` prices rise in one negotiation only

_RISE, MOST_RISE = 192, 640
"""What overflow adds to the price of an edge before a priced round, in parts of ``PRICE_SCALE``:
as long as ``present`` is as at first, and at most."""

NO_LIMIT = 1 << 55  # more overflow than there can be
_PRICED, _PLAIN = 10, 2
"""Rounds in a row without gain after which priced rounds end, and plain ones."""

_GROWTH, _LATER_GROWTH = 25, 15  # per cent by which present grows, at first and after plain rounds
_FALL = 10  # per cent by which prices fall after plain rounds


@dataclass(frozen=True, kw_only=True)
class Negotiation:
    """The rules beyond those of :class:`marouting.rules.Rules` in games of the generalist.

    Attributes:
        prices: whether nets negotiate by prices, if there are rip-up rounds; with ``overflow:
            allowed`` only.
        patience: number of rounds after which one more neighbour is ripped up with a net, starting
            with none; 0: ``rip_up.neighbours`` of them from the first round on.
        present_factor: initial factor of overflow in the cost of an edge, 0.01 to 2. A larger one
            removes overflow sooner and makes routes longer.
        step_decay: how fast price changes shrink once there are routes without overflow: the r-th
            negotiation after the first multiplies them by 1 / (1 + step_decay · r). 0 to 1000, in
            steps of 0.01.

    Raises:
        InputError: an option is out of range.
    """

    prices: bool = True
    patience: int = 0
    present_factor: float = 0.1
    step_decay: float = 0.0

    def __post_init__(self) -> None:
        bounds = {
            "patience": (0, MOST_ROUNDS),
            "present_factor": (LEAST_PRESENT, MOST_PRESENT),
            "step_decay": (0.0, MOST_DECAY),
        }
        check_fields(self, **bounds)


@compiled
def is_priced(static: Static, dynamic: Dynamic, m: int) -> bool:
    """Whether the first walk or present round is priced; see :mod:`marouting.batch.rounds`."""
    return is_on(static, Option.PRICES) and dynamic.games[m].plain == 0


@compiled
def first_present(static: Static) -> int:
    """``present`` in the first walk, and in the first priced round after plain ones."""
    return i64(static.options[Option.PRESENT])


@compiled
def price_of(static: Static, dynamic: Dynamic, m: int, edge: int) -> int:
    """The price of an edge, in parts of UNIT."""
    price = i64(dynamic.numbers[m, static.options[Option.PRICES] + edge])
    return (UNIT * price + PRICE_SCALE // 2) // PRICE_SCALE


@compiled
def edge_cost(static: Static, dynamic: Dynamic, m: int, edge: int, demand: int, room: int) -> int:
    """What an edge inside a layer costs a net in a priced round."""
    if demand > static.capacity[m, edge]:
        return i64(MOST)
    cost = UNIT + price_of(static, dynamic, m, edge)
    if room < demand and demand > 0:
        parts = i64(dynamic.games[m].present) * (demand - room) // demand
        cost = cost * (PRICE_SCALE + parts) // PRICE_SCALE
    return min(cost, i64(MOST))


@compiled
def net_cost(
    static: Static, dynamic: Dynamic, m: int, n: int, rows: Any, row: int, own: int
) -> int:
    """What a net's edges cost it in a priced round."""
    cost = i64(0)
    edge = next_in(rows, m, row, i64(0))
    while edge != NOBODY:
        axis, cell = edge % AXES, as_index(edge // AXES)
        if axis == VIA_AXIS:
            cost += UNIT
        else:
            demand = i64(static.demand[m, n, static.position[cell, VIA_AXIS]])
            room = i64(dynamic.remaining[m, edge]) + own * demand
            cost += edge_cost(static, dynamic, m, edge, demand, room)
        edge = next_in(rows, m, row, edge + 1)
    return cost


@compiled
def _decayed(static: Static, dynamic: Dynamic, m: int, step: int) -> int:
    """What is left of a step of the prices, after so many negotiations."""
    game = dynamic.games[m]
    if game.best_overflow > 0:
        return i64(step)  # prices that rest would never part the nets that still overflow
    return 100 * step // (100 + static.options[Option.STEP_DECAY] * i64(game.negotiations))


@compiled
def _raise_prices(static: Static, dynamic: Dynamic, m: int) -> None:
    """Before a priced round: edges with overflow get more expensive, and ``present`` grows."""
    game, first = dynamic.games[m], first_present(static)
    rise = min(_RISE * max(i64(game.present), first) // first, i64(MOST_RISE))
    prices, rise = as_index(static.options[Option.PRICES]), _decayed(static, dynamic, m, rise)
    for edge in range(static.capacity.shape[1]):
        if dynamic.remaining[m, edge] < 0:
            dynamic.numbers[m, prices + edge] += rise
    growth = _GROWTH if game.negotiations == 0 else _LATER_GROWTH
    present = game.present + game.present * growth // 100
    game.present = min(max(present, first), LARGEST)


@compiled
def _lower_prices(static: Static, dynamic: Dynamic, m: int) -> None:
    """Before priced rounds that follow plain ones: prices fall, and nets share cheaply again."""
    prices = as_index(static.options[Option.PRICES])
    for edge in range(static.capacity.shape[1]):
        price = i64(dynamic.numbers[m, prices + edge])
        if price == 0:
            continue
        price -= _decayed(static, dynamic, m, price * _FALL // 100)
        dynamic.numbers[m, prices + edge] = price - price % (PRICE_SCALE // UNIT)
    dynamic.games[m].present = 0
    dynamic.games[m].negotiations += 1


@compiled
def note_best(static: Static, dynamic: Dynamic, m: int) -> None:
    """Notes the present routes if they are better than the best so far."""
    game = dynamic.games[m]
    # More tasks joined, then less overflow, then less wirelength.
    now = -game.joined, game.overflow, game.wirelength
    if now >= (-game.best_joined, game.best_overflow, game.best_wirelength):
        return
    game.best_joined, game.best_overflow = game.joined, game.overflow
    game.best_wirelength = game.wirelength
    for n in range(dynamic.agents.shape[1]):
        row = i64(static.options[Option.BEST] + n)
        copy_row(dynamic.sets, m, row, dynamic.used, m, i64(n))
        joined = dynamic.agents[m, n].joined
        dynamic.numbers[m, static.options[Option.BEST_JOINED] + n] = joined


@compiled
def put_best(static: Static, dynamic: Dynamic, m: int) -> None:
    """Nets take the best routes so far."""
    note_best(static, dynamic, m)
    for n in range(dynamic.agents.shape[1]):
        if dynamic.agents[m, n].status == Status.ABSENT:  # it has no tasks, nor a first pin
            continue
        row = as_index(static.options[Option.BEST] + n)
        joined = dynamic.numbers[m, static.options[Option.BEST_JOINED] + n]
        take_routes(static, dynamic, m, n, row, joined)
    dynamic.games[m].joined = dynamic.games[m].best_joined


@compiled
def take_routes(static: Static, dynamic: Dynamic, m: int, n: int, row: int, joined: int) -> None:
    """A net uses just the edges in a row of ``dynamic.sets``, which join so many of its tasks."""
    changed = False
    for byte in range(dynamic.used.shape[2]):
        bits = byte_of(dynamic.used, m, n, byte)
        if bits != 0:
            taken = byte_of(dynamic.sets, m, row, byte)
            changed |= taken != bits
            use_edges(static, dynamic, m, n, byte, taken)
    for byte in range(dynamic.sets.shape[2]):
        bits = byte_of(dynamic.sets, m, row, byte)
        if bits != 0:
            changed |= byte_of(dynamic.used, m, n, byte) != bits
            use_edges(static, dynamic, m, n, byte, bits)
    dynamic.agents[m, n].joined = joined
    if is_on(static, Option.RELEASE_FAILED):
        clear(static, dynamic, m, Option.TAKEN, n)
    if changed and keeps_tree(static):
        grow_tree(static, dynamic, m, n)


@compiled
def begin_priced_or_plain(static: Static, dynamic: Dynamic, m: int) -> None:
    """Before a round: whether it is priced, and what prices are then."""
    game = dynamic.games[m]
    if not is_on(static, Option.PRICES):
        game.plain += 1
        return
    note_best(static, dynamic, m)
    if game.plain > 0:
        gained = game.joined > game.began_joined
        gained |= 100 * game.overflow < 99 * game.began_overflow
        gained |= 2000 * game.wirelength < 1999 * game.began_wirelength
        game.stuck = 0 if gained else game.stuck + 1
        if game.stuck < _PLAIN:
            game.plain += 1
            return
        _lower_prices(static, dynamic, m)
        _raise_prices(static, dynamic, m)
        game.plain = game.stuck = 0
        game.fewest = NO_LIMIT
        return
    game.stuck += 1
    if 100 * game.overflow < 99 * game.fewest:
        game.fewest, game.stuck = game.overflow, 0
    if game.overflow > 0 and game.stuck < _PRICED:
        _raise_prices(static, dynamic, m)
    else:
        game.plain, game.stuck = 1, 0
        if game.best_joined > game.joined or game.best_overflow < game.overflow:
            put_best(static, dynamic, m)
