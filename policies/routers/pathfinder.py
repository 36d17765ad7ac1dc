"""Negotiated congestion: nets share edges at first and bargain for them until none overflows.

As in PathFinder (McMurchie and Ebeling 1995), an edge costs a net its length, a **history** of the
overflow that it has seen, and a factor for the overflow that it would have at **present**. Nets on
overflowed edges are ripped up and routed again, at growing prices, until they have found other
ways. A route goes in rounds, each of three kinds of passes over the nets:

* **relax**: every net is routed again, at the prices that the rounds before have left. In the first
  round there are none: every net gets what is shortest for it alone.
* **negotiate**: every net on an overflowed edge is routed again; prices grow from pass to pass.
* **squeeze**: every net is routed again for overflow first and length second. No net gets worse,
  and as soon as a pass gains little the next round begins.

The best solution of all passes counts. Nets of few pins get a cheapest tree of all there are
(:func:`marouting.trees.exact_tree.exact_tree`), in a box around their pins and their old tree.
Larger ones grow pin by pin, the nearest to the tree first, from another pin each time; then every
part between two branchings or pins is replaced by a cheapest way between what it leaves apart.
"""

import time
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import Problem, Solution
from marouting.config import MOST, check
from marouting.kernels import compiled, wide
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.trees.exact_tree import Search, exact_tree, make_search
from marouting.trees.lattice import CLOSED, Lattice, make_lattice, set_cost, set_size

UNIT = 256
"""Cost of an edge inside a layer: costs are whole numbers, prices are parts of an edge."""

FULL = 4096 * UNIT
"""Cost of a unit of overflow where none is to be had, more than any price."""

_NO_LIMIT = 1 << 31  # no edge costs as much
_MOST_OVERFLOW = 1000  # units of overflow that cost more than one less; costs fit into 32 bits
_EXACT_LABELS = 1 << 17  # the largest search for a cheapest tree: box · 2^(pins - 1)
_FIRST_BOX = 4096  # Gcells of the largest box that there is room for to begin with
_WORK = 1 << 18  # labels opened, some 50 ms, between looks at the clock
_CHUNK = 64  # passes between looks at the clock, at most


@dataclass(frozen=True, kw_only=True)
class PathfinderOptions:
    """The router's parameters.

    Where no publication is named the value was tried out on ibm01 (ISPD'98), 20 s a trial: those
    from a half of it to twice as much change the wirelength by less than 1 %.

    Attributes:
        via_weight: what a via costs, in edges inside a layer. 1 as the ISPD 2008 evaluator counts;
            a little more than 0 to compare with wirelengths without vias, as those published for
            ISPD'98.
        exact_pins: nets of so many pins at most get a cheapest tree, as long as their box is small;
            5 is the most that the paper's problems have. Time triples with every pin.
        margin: by how many Gcells the box in which a net is routed is larger on each side than its
            pins and its old tree. It grows by one each time the net is told to leave an edge in a
            round, and twofold where there is no way at all.
        present: what one net too many adds to an edge's cost, as a factor, when a round begins to
            negotiate (PathFinder's p).
        growth: by what that grows from pass to pass. (PathFinder raises it, too.)
        history: what a pass with overflow adds to an edge's price, in edges (PathFinder's h).
        decay: what is left of the prices when the next round begins.
        stuck: passes without less overflow after which a round stops to negotiate; tried out on
            generated problems that cannot be routed without overflow.
        least_gain: the share of the wirelength that a pass to squeeze has to gain for another one.
        again: the share of nets that are routed again although no tree could be cheaper than
            theirs; they make room for others.
        patience: rounds without a better solution after which the route ends. With 5 the optimum
            is missed on one of 121 published problems of Liao et al. for some seeds, with 10 on
            none for four seeds.
        passes: passes after which it ends anyway.
        seconds: time after which it ends, but not before every net is joined; None: no limit. If
            the limit is reached the solution depends on the machine.
        seed: where the random numbers start.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    via_weight: float = 1.0
    exact_pins: int = 5
    margin: int = 2
    present: float = 0.3
    growth: float = 1.1
    history: float = 0.3
    decay: float = 0.8
    stuck: int = 10
    least_gain: float = 0.0005
    again: float = 0.1
    patience: int = 10
    passes: int = 100_000
    seconds: float | None = 50.0
    seed: int = 0

    def __post_init__(self) -> None:
        check("via_weight", 0 <= self.via_weight <= 1000, "a number from 0 to 1000")
        check("exact_pins", 2 <= self.exact_pins <= 9, "a number from 2 to 9")
        check("margin", 0 <= self.margin <= MOST, f"a number from 0 to {MOST}")
        check("present", 0 < self.present <= 1000, "a number above 0, up to 1000")
        check("growth", 1 <= self.growth <= 1000, "a number from 1 to 1000")
        check("history", 0 <= self.history <= 1000, "a number from 0 to 1000")
        check("decay", 0 <= self.decay <= 1, "a number from 0 to 1")
        check("stuck", 1 <= self.stuck <= MOST, f"a number from 1 to {MOST}")
        check("least_gain", 0 <= self.least_gain <= 1, "a number from 0 to 1")
        check("again", 0 <= self.again <= 1, "a number from 0 to 1")
        check("patience", 1 <= self.patience <= MOST, f"a number from 1 to {MOST}")
        check("passes", 1 <= self.passes <= MOST, f"a number from 1 to {MOST}")
        check("seconds", self.seconds is None or self.seconds >= 0, "a number from 0, or null")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")


Kind = Literal["relax", "negotiate", "squeeze"]
_KINDS: tuple[Kind, ...] = ("relax", "negotiate", "squeeze")
_RELAX, _NEGOTIATE, _SQUEEZE = range(len(_KINDS))


class Pass(NamedTuple):
    """What a pass over the nets led to."""

    kind: Kind
    overflow: int  # in tracks
    wirelength: float  # in edges, vias by their weight
    routed: int  # nets that were routed again


@dataclass(frozen=True)
class Routed:
    """A route and how it came about.

    Attributes:
        solution: the best of all passes, by overflow, then wirelength with vias by their weight.
        iterations: passes over the nets.
        seconds: the time it took.
        history: every pass.
    """

    solution: Solution
    iterations: int
    seconds: float
    history: tuple[Pass, ...]

    @property
    def report(self) -> dict[str, Any]:
        """What there is to say beside the solution's figures."""
        return {"iterations": self.iterations}


# Why a compiled call comes back.
_DONE, _LATER, _BOX, _POOL = range(4)

_RUN = np.dtype(
    [
        ("kind", np.int64),  # of the pass
        ("next", np.int64),  # place in the order of the net to look at next
        ("routed", np.int64),  # nets routed in this pass
        ("passes", np.int64),  # passes done
        ("stuck", np.int64),  # passes of this round without less overflow
        ("fewest", np.int64),  # overflow in this round, at least
        ("since", np.int64),  # rounds without a better solution
        ("better", np.int64),  # whether this round has brought one
        ("overflow", np.int64),  # of all edges
        ("length", np.int64),  # of all trees
        ("last_overflow", np.int64),  # before this pass
        ("last_length", np.int64),
        ("best_overflow", np.int64),
        ("best_length", np.int64),
        ("present", np.float64),  # factor for one net too many
        ("pool", np.int64),  # which of the two pools is in use
        ("top", np.int64),  # edges in it
        ("need", np.int64),  # the size that did not suffice
        ("random", np.int64),  # state of the random numbers
        ("unproven", np.int64),  # nets whose ideal is the shortest tree found, not that there is
        ("history", np.int64),  # rows of the history
    ],
    align=True,
)
"""Where a route stands."""


class _Chip(NamedTuple):
    """The problem."""

    size: NDArray[np.int64]  # (3,) columns, rows, layers
    position: NDArray[np.int32]  # (G, 3)
    capacity: NDArray[np.int32]  # (E,)
    demand: NDArray[np.int32]  # (nets, Z)
    first: NDArray[np.int64]  # (nets + 1,) first of a net's pins in pin
    pin: NDArray[np.int64]  # (pins,) Gcells


class _Rules(NamedTuple):
    """The options, in the units of the search."""

    via: int
    exact_pins: int
    margin: int
    present: float
    growth: float
    history: float
    decay: float
    stuck: int
    least_gain: float
    again: int  # of 2^20
    patience: int
    passes: int


class _Trees(NamedTuple):
    """The nets' trees and what they cost."""

    run: NDArray[Any]  # (1,) _RUN
    order: NDArray[np.int64]  # (routable nets,) in which nets are looked at
    remaining: NDArray[np.int64]  # (E,) capacity less demand
    price: NDArray[np.float64]  # (E,) history, in units of cost
    margin: NDArray[np.int64]  # (nets,)
    ideal: NDArray[np.int64]  # (nets,) length of the shortest tree known; -1: none yet
    edge: NDArray[np.int32]  # (2, pool) the edges of trees; in the pool in use
    start: NDArray[np.int64]  # (nets,) those of a net are edge[start : start + length]
    length: NDArray[np.int64]  # (nets,)
    best: NDArray[np.int32]  # (pool,) the edges of the best solution
    best_first: NDArray[np.int64]  # (nets + 1,)
    history: NDArray[np.int64]  # (_CHUNK, 4)


class _Draft(NamedTuple):
    """What routing one net works with, in points of its box."""

    low: NDArray[np.int64]  # (3,) Gcell of the box's first point
    far: NDArray[np.int64]  # (pins,) distance of a pin from the tree; -1: in the tree
    pin: NDArray[np.uint8]  # (points,) whether a pin lies there; 0 between nets
    inside: NDArray[np.uint8]  # (points,) whether it has been visited; 0 between visits
    key: NDArray[np.int64]  # (points,) pins and branchings


@compiled
def _draw(run: Any) -> int:
    """A random number of 31 bits (SplitMix64, Steele, Lea and Flood 2014)."""
    run.random += np.int64(-0x61C8864680B583EB)
    bits = np.uint64(run.random)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return wide((bits ^ (bits >> np.uint64(31))) >> np.uint64(33))


@compiled
def _cost(
    capacity: Any, remaining: Any, price: Any, edge: int, demand: int, present: float, kind: int
) -> int:
    """What an edge inside a layer costs a net; FULL or more if it should not be used at all."""
    over = demand - remaining[edge]
    if kind == _SQUEEZE:
        return UNIT + FULL * min(max(over, 0), min(demand, _MOST_OVERFLOW))
    cost = UNIT + price[edge]
    if over > 0 and demand > 0:
        cost *= 1.0 + present * over / demand
    blocked = demand > capacity[edge]
    return wide(min(cost, FULL - 1.0)) + (FULL if blocked else 0)


@compiled
def _take(chip: _Chip, trees: _Trees, via: int, net: int, sign: int) -> None:
    """Takes the demand of a net's tree (sign 1), or gives it back (-1)."""
    run = trees.run[0]
    for i in range(trees.start[net], trees.start[net] + trees.length[net]):
        edge = wide(trees.edge[run.pool, i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            run.length += sign * via
            continue
        run.length += sign * UNIT
        over = max(-trees.remaining[edge], 0)
        trees.remaining[edge] -= sign * wide(chip.demand[net, chip.position[gcell, VIA_AXIS]])
        run.overflow += max(-trees.remaining[edge], 0) - over


@compiled
def _tree_cost(chip: _Chip, trees: _Trees, via: int, net: int) -> int:
    """What a net's tree costs at present, while it is ripped up."""
    run = trees.run[0]
    cost = 0
    for i in range(trees.start[net], trees.start[net] + trees.length[net]):
        edge = wide(trees.edge[run.pool, i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            cost += via
        else:
            demand = wide(chip.demand[net, chip.position[gcell, VIA_AXIS]])
            cost += _cost(
                chip.capacity, trees.remaining, trees.price, edge, demand, run.present, run.kind
            )
    return cost


@compiled
def _overflows(trees: _Trees, net: int) -> bool:
    """Whether a net's tree has an overflowed edge."""
    for i in range(trees.start[net], trees.start[net] + trees.length[net]):
        if trees.remaining[trees.edge[trees.run[0].pool, i]] < 0:
            return True
    return False


@compiled
def _box(chip: _Chip, trees: _Trees, net: int, margin: int, low: Any, size: Any) -> int:
    """The box around a net's pins and tree, all layers high; returns how many points it has."""
    points = 1
    for axis in range(AXES):
        least, most = chip.size[axis] - 1, wide(0)
        if axis == VIA_AXIS:
            least, most = most, least
        else:
            for i in range(chip.first[net], chip.first[net + 1]):
                at = wide(chip.position[chip.pin[i], axis])
                least, most = min(least, at), max(most, at)
            for i in range(trees.start[net], trees.start[net] + trees.length[net]):
                edge = wide(trees.edge[trees.run[0].pool, i])
                at = wide(chip.position[edge // AXES, axis])
                least, most = min(least, at), max(most, at)
                if edge % AXES == axis:
                    most = max(most, at + 1)
            least, most = max(least - margin, 0), min(most + margin, chip.size[axis] - 1)
        low[axis], size[axis] = least, most - least + 1
        points *= most - least + 1
    return points


@compiled
def _survey(
    chip: _Chip, trees: _Trees, lattice: Lattice, low: Any, via: int, net: int, limit: int
) -> None:
    """What the moves in a net's box cost; those that cost ``limit`` or more are closed."""
    nx, ny, nz = lattice.size[0], lattice.size[1], lattice.size[2]
    set_size(lattice, nx, ny, nz)
    for axis in range(AXES):
        for i in range(lattice.size[axis]):
            lattice.line[axis, i] = i * (via if axis == VIA_AXIS else UNIT)
    present, kind = trees.run[0].present, trees.run[0].kind
    point = wide(0)
    for x in range(nx):
        for y in range(ny):
            gcell = ((low[0] + x) * chip.size[1] + low[1] + y) * chip.size[2]
            for z in range(nz):
                demand = wide(chip.demand[net, z])
                for axis in range(AXES):
                    at = z
                    if axis < VIA_AXIS:
                        at = y if axis else x
                    if at == 0:
                        lattice.cost[point, 2 * axis + 1] = CLOSED
                    if at + 1 == lattice.size[axis]:
                        lattice.cost[point, 2 * axis] = CLOSED
                        continue
                    cost = wide(via)
                    if axis < VIA_AXIS:
                        edge = AXES * (gcell + z) + axis
                        cost = _cost(
                            chip.capacity, trees.remaining, trees.price, edge, demand, present, kind
                        )
                        if cost >= limit:
                            cost = wide(CLOSED)
                    set_cost(lattice, point, axis, cost)
                point += 1


@compiled
def _point(position: Any, low: Any, size: Any, gcell: int) -> int:
    """The point of a Gcell in a box."""
    x, y = position[gcell, 0] - low[0], position[gcell, 1] - low[1]
    return (x * size[1] + y) * size[2] + position[gcell, 2] - low[2]


@compiled
def _bound(lattice: Lattice, s: Search, group: int, point: int, size: int) -> None:
    """Makes the box of a group, or of the goal, which has ``size`` points, hold one more."""
    nz = lattice.size[2]
    row = point // nz
    for axis in range(AXES):
        at = point - row * nz
        if axis < VIA_AXIS:
            at = row % lattice.size[1] if axis else row // lattice.size[1]
        line = lattice.line[axis, at]
        if size == 0 or line < s.low[group, axis]:
            s.low[group, axis] = line
        if size == 0 or line > s.high[group, axis]:
            s.high[group, axis] = line


@compiled
def _join_all(chip: _Chip, run: Any, lattice: Lattice, s: Search, low: Any, net: int) -> int:
    """A cheapest tree of a net; returns what it costs, or CLOSED if there is none."""
    first, pins = chip.first[net], chip.first[net + 1] - chip.first[net]
    root = _draw(run) % pins
    goal, group = wide(0), wide(0)
    for i in range(pins):
        point = wide(_point(chip.position, low, lattice.size, chip.pin[first + i]))
        _bound(lattice, s, pins - 1 if i == root else group, point, wide(0))
        if i == root:
            goal = point
        else:
            s.start[group], s.group[group] = point, group
            group += 1
    s.goal[goal] = 1
    cost = exact_tree(lattice, s, group, group, _draw(run))
    s.goal[goal] = 0
    for i in range(group):
        s.group[i] = 0
    return cost


@compiled
def _grow(chip: _Chip, run: Any, lattice: Lattice, s: Search, draft: _Draft, net: int) -> int:
    """A tree of a net, pin by pin; returns what it costs, or CLOSED if there is none."""
    first, pins = chip.first[net], chip.first[net + 1] - chip.first[net]
    ny, nz = lattice.size[1], lattice.size[2]
    for i in range(pins):
        draft.far[i] = np.iinfo(np.int64).max
    pin = _draw(run) % pins
    size = looked = total = cost = wide(0)
    for joined in range(pins):
        point = wide(_point(chip.position, draft.low, lattice.size, chip.pin[first + pin]))
        if not draft.inside[point]:
            if joined > 0:
                s.goal[point] = 1
                _bound(lattice, s, wide(1), point, wide(0))
                cost = exact_tree(lattice, s, size, wide(1), _draw(run))
                s.goal[point] = 0
                if cost == CLOSED:
                    break
                total += cost
            # From the pin along its way into the tree.
            back = CLOSED
            while not draft.inside[point]:
                draft.inside[point] = 1
                s.start[size] = point
                size += 1
                for move in range(MOVES):
                    if move != back and lattice.tree[point] >> move & 1:
                        back = move ^ 1
                        point += lattice.stride[move]
                        break
        draft.far[pin] = -1
        nearest, ties = pin, 0
        for i in range(pins):
            if draft.far[i] < 0:
                continue
            point = wide(_point(chip.position, draft.low, lattice.size, chip.pin[first + i]))
            x, y, z = point // nz // ny, point // nz % ny, lattice.line[VIA_AXIS, point % nz]
            for j in range(looked, size):
                other = s.start[j]
                across = abs(other // nz // ny - x) + abs(other // nz % ny - y)
                far = UNIT * across + abs(lattice.line[VIA_AXIS, other % nz] - z)
                draft.far[i] = min(draft.far[i], far)
            if ties == 0 or draft.far[i] < draft.far[nearest]:
                nearest, ties = i, 1
            elif draft.far[i] == draft.far[nearest]:
                ties += 1
                if _draw(run) % ties == 0:
                    nearest = i
        looked = size
        pin = nearest
    for i in range(size):
        draft.inside[s.start[i]] = 0
    return total if cost != CLOSED else wide(CLOSED)


@compiled
def _ways(bits: int) -> int:
    """How many edges a tree has at a point."""
    ways = 0
    for move in range(MOVES):
        ways += bits >> move & 1
    return ways


@compiled
def _part(lattice: Lattice, s: Search, draft: _Draft, point: int, first: int) -> int:
    """Lists the points of a tree from one on, their box as the goal's; returns the list's end."""
    s.start[first] = point
    draft.inside[point] = 1
    size = first + 1
    for i in range(first, len(s.start)):
        if i == size:
            break
        point = s.start[i]
        _bound(lattice, s, wide(1), point, i - first)
        for move in range(MOVES):
            if lattice.tree[point] >> move & 1:
                beside = point + lattice.stride[move]
                if not draft.inside[beside]:
                    draft.inside[beside] = 1
                    s.start[size] = beside
                    size += 1
    return size


@compiled
def _mend(run: Any, lattice: Lattice, s: Search, draft: _Draft, root: int) -> int:
    """Replaces every part of a tree between two keys by a cheapest way; returns what that saves.

    Keys are pins and the points where the tree branches.
    """
    size = _part(lattice, s, draft, root, wide(0))
    keys = wide(0)
    for i in range(size):
        point = s.start[i]
        draft.inside[point] = 0
        if draft.pin[point] or _ways(lattice.tree[point]) > 2:
            draft.key[keys] = point
            keys += 1
    saved = wide(0)
    for place in range(keys * MOVES):
        key, move = draft.key[place // MOVES], place % MOVES
        if not lattice.tree[key] >> move & 1:
            continue
        if not draft.pin[key] and _ways(lattice.tree[key]) < 3:
            continue  # it was one when it was listed
        point = key
        while True:
            saved += wide(lattice.cost[point, move])
            lattice.tree[point] ^= np.uint8(1 << move)
            point += lattice.stride[move]
            lattice.tree[point] ^= np.uint8(1 << (move ^ 1))
            if draft.pin[point] or _ways(lattice.tree[point]) != 1:
                break
            move = 0
            while not lattice.tree[point] >> move & 1:
                move += 1
        # From the larger of the two sides to the other, whose box is then the smaller.
        near = _part(lattice, s, draft, key, wide(0))
        both = near
        if not draft.inside[point]:
            both = _part(lattice, s, draft, point, near)
        if both > near:
            first, last = near, both
            if both - near > near:
                for i in range(near):
                    _bound(lattice, s, wide(1), s.start[i], i)
                first, last = 0, near
            for i in range(first, last):
                s.goal[s.start[i]] = 1
            for i in range(both):
                draft.inside[s.start[i]] = 0
            starts = near
            if first == 0:
                # The goal's points come first: those that follow change places with them.
                starts = both - near
                for i in range(near):
                    draft.key[keys + i] = s.start[i]
                for i in range(starts):
                    s.start[i] = s.start[near + i]
                for i in range(near):
                    s.start[starts + i] = draft.key[keys + i]
            saved -= exact_tree(lattice, s, starts, wide(1), _draw(run))
            for i in range(starts, both):
                s.goal[s.start[i]] = 0
        else:
            for i in range(both):
                draft.inside[s.start[i]] = 0
    return saved


@compiled
def _compact(trees: _Trees) -> None:
    """Copies the trees into the other pool, one after the other."""
    run = trees.run[0]
    old, run.pool, run.top = run.pool, 1 - run.pool, 0
    for net in range(len(trees.start)):
        for i in range(trees.length[net]):
            trees.edge[run.pool, run.top + i] = trees.edge[old, trees.start[net] + i]
        trees.start[net] = run.top
        run.top += trees.length[net]


@compiled
def _write(chip: _Chip, trees: _Trees, lattice: Lattice, low: Any, net: int) -> int:
    """Makes the lattice's tree the net's; returns how many vias it has."""
    run = trees.run[0]
    trees.start[net] = run.top
    vias = 0
    point = 0
    for x in range(lattice.size[0]):
        for y in range(lattice.size[1]):
            gcell = ((low[0] + x) * chip.size[1] + low[1] + y) * chip.size[2]
            for z in range(lattice.size[2]):
                for axis in range(AXES):
                    if lattice.tree[point] >> 2 * axis & 1:
                        trees.edge[run.pool, run.top] = AXES * (gcell + z) + axis
                        run.top += 1
                        vias += axis == VIA_AXIS
                point += 1
    trees.length[net] = run.top - trees.start[net]
    return vias


@compiled
def _reroute(
    chip: _Chip, rules: _Rules, trees: _Trees, lattice: Lattice, s: Search, draft: _Draft, net: int
) -> int:
    """Rips a net up and routes it again, unless its tree is a cheapest one already.

    Returns:
        _DONE, or what there is too little room for; then the net is as it was.
    """
    run = trees.run[0]
    pins = chip.first[net + 1] - chip.first[net]
    margin, limit = trees.margin[net], wide(FULL)
    _take(chip, trees, rules.via, net, wide(-1))
    old = _tree_cost(chip, trees, rules.via, net)
    routed = trees.ideal[net] >= 0
    if routed and old <= trees.ideal[net] and _draw(run) % (1 << 20) >= rules.again:
        _take(chip, trees, rules.via, net, wide(1))
        return _DONE
    while True:
        points = _box(chip, trees, net, margin, draft.low, lattice.size)
        code = _DONE
        if points > len(draft.pin):
            code, run.need = _BOX, points
        elif run.top + points > trees.edge.shape[1]:
            _compact(trees)
            if run.top + points > trees.edge.shape[1]:
                code, run.need = _POOL, run.top + points
        if code != _DONE:
            _take(chip, trees, rules.via, net, wide(1))
            return code
        _survey(chip, trees, lattice, draft.low, rules.via, net, limit)
        s.tally[1] += points
        if pins == 2 or (pins <= rules.exact_pins and points << (pins - 1) <= _EXACT_LABELS):
            cost = _join_all(chip, run, lattice, s, draft.low, net)
        else:
            cost = _grow(chip, run, lattice, s, draft, net)
            if cost != CLOSED:
                for i in range(chip.first[net], chip.first[net + 1]):
                    point = _point(chip.position, draft.low, lattice.size, chip.pin[i])
                    draft.pin[point] = 1
                cost -= _mend(run, lattice, s, draft, wide(point))
                run.unproven += not routed
                for i in range(chip.first[net], chip.first[net + 1]):
                    point = _point(chip.position, draft.low, lattice.size, chip.pin[i])
                    draft.pin[point] = 0
        if cost != CLOSED:
            break
        if lattice.size[0] == chip.size[0] and lattice.size[1] == chip.size[1]:
            limit = wide(_NO_LIMIT)
        margin = 2 * margin + 1
    if not routed or cost <= old:
        vias = _write(chip, trees, lattice, draft.low, net)
        length = UNIT * (trees.length[net] - vias) + rules.via * vias
        trees.ideal[net] = min(trees.ideal[net], length) if routed else cost
    _take(chip, trees, rules.via, net, wide(1))
    run.routed += 1
    return _DONE


@compiled
def _keep(trees: _Trees) -> bool:
    """Keeps the trees if they are the best so far; returns whether they are."""
    run = trees.run[0]
    if run.overflow > run.best_overflow or (
        run.overflow == run.best_overflow and run.length >= run.best_length
    ):
        return False
    run.best_overflow, run.best_length = run.overflow, run.length
    size = 0
    for net in range(len(trees.start)):
        trees.best_first[net] = size
        for i in range(trees.length[net]):
            trees.best[size + i] = trees.edge[run.pool, trees.start[net] + i]
        size += trees.length[net]
    trees.best_first[len(trees.start)] = size
    return True


@compiled
def _next_pass(rules: _Rules, trees: _Trees) -> bool:
    """After a pass: prices, and what kind of pass comes next; returns whether one does."""
    run = trees.run[0]
    run.better |= _keep(trees)
    row = trees.history[run.history]
    row[0], row[1], row[2], row[3] = run.kind, run.overflow, run.length, run.routed
    run.history += 1
    run.passes += 1
    first = run.passes == 1
    run.next = run.routed = 0
    gained = run.overflow < run.last_overflow or (
        run.overflow == run.last_overflow
        and run.last_length - run.length > rules.least_gain * run.length
    )
    run.last_overflow, run.last_length = run.overflow, run.length
    if run.overflow < run.fewest:
        run.fewest, run.stuck = run.overflow, 0
    else:
        run.stuck += 1
    if run.kind == _SQUEEZE and not gained:
        run.since = 0 if run.better else run.since + 1
        run.better = 0
        run.kind = _RELAX
        run.present = rules.present
        run.fewest, run.stuck = np.iinfo(np.int64).max, 0
        for edge in range(len(trees.price)):
            trees.price[edge] *= rules.decay
        for net in range(len(trees.margin)):
            trees.margin[net] = rules.margin
    elif run.kind != _SQUEEZE:
        run.kind = _SQUEEZE
        if run.overflow > 0 and run.stuck < rules.stuck:
            run.kind = _NEGOTIATE
            run.present = rules.present if first else run.present * rules.growth
            for edge in range(len(trees.price)):
                if trees.remaining[edge] < 0:
                    trees.price[edge] += rules.history * UNIT
    for i in range(len(trees.order) - 1, 0, -1):
        j = _draw(run) % (i + 1)
        trees.order[i], trees.order[j] = trees.order[j], trees.order[i]
    # Nothing is shorter than every net's shortest tree.
    shortest = 0
    for net in range(len(trees.ideal)):
        shortest += trees.ideal[net]
    optimal = run.overflow == 0 and run.length == shortest and run.unproven == 0
    return run.since < rules.patience and run.passes < rules.passes and not optimal


@compiled
def _advance(
    chip: _Chip, rules: _Rules, trees: _Trees, lattice: Lattice, s: Search, draft: _Draft
) -> int:
    """Goes on with a route for a while; returns why no longer."""
    run = trees.run[0]
    until = s.tally[1] + _WORK
    while True:
        while run.next < len(trees.order):
            if s.tally[1] > until:
                return _LATER
            net = trees.order[run.next]
            if run.kind != _NEGOTIATE or _overflows(trees, net):
                code = _reroute(chip, rules, trees, lattice, s, draft, net)
                if code != _DONE:
                    return code
                if run.kind == _NEGOTIATE:
                    trees.margin[net] += 1
            run.next += 1
        if not _next_pass(rules, trees):
            return _DONE
        if run.history == len(trees.history):
            return _LATER


@dataclass(frozen=True)
class PathfinderRouter:
    """Negotiated congestion over Steiner trees, in all layers at once.

    Attributes:
        options: the parameters.
    """

    options: PathfinderOptions = field(default_factory=PathfinderOptions)
    name: str = "pathfinder"

    def route(self, problem: Problem) -> Solution:
        """A solution with every net joined, with overflow where no better was found."""
        return self.solve(problem).solution

    def solve(self, problem: Problem) -> Routed:
        """A solution as :meth:`route` makes it, and how it came about."""
        began = time.perf_counter()
        limit = self.options.seconds
        chip, trees = self._set_up(problem)
        work = self._room(chip, min(_FIRST_BOX, problem.topology.gcells))
        passes: list[Pass] = []
        code = _LATER if len(trees.order) else _DONE
        run = trees.run[0]
        while code != _DONE:
            code = _advance(chip, self._rules(), trees, *work)
            for kind, overflow, length, routed in trees.history[: run["history"]].tolist():
                passes.append(Pass(_KINDS[kind], overflow, length / UNIT, routed))
            run["history"] = 0
            if code == _BOX:
                work = self._room(chip, 2 * int(run["need"]))
            elif code == _POOL:
                more = 2 * int(run["need"])
                trees = trees._replace(
                    edge=_enlarged(trees.edge, more), best=_enlarged(trees.best, more)
                )
            if limit is not None and passes and time.perf_counter() - began >= limit:
                _keep(trees)
                break
        net = np.repeat(np.arange(len(problem.nets)), np.diff(trees.best_first))
        solution = Solution.of_uses(problem, net, trees.best[: len(net)].astype(np.int64))
        return Routed(solution, len(passes), time.perf_counter() - began, tuple(passes))

    def _rules(self) -> _Rules:
        options = self.options
        return _Rules(
            via=round(options.via_weight * UNIT),
            exact_pins=options.exact_pins,
            margin=options.margin,
            present=options.present,
            growth=options.growth,
            history=options.history,
            decay=options.decay,
            stuck=options.stuck,
            least_gain=options.least_gain,
            again=round(options.again * (1 << 20)),
            patience=options.patience,
            passes=options.passes,
        )

    def _set_up(self, problem: Problem) -> tuple[_Chip, _Trees]:
        """The problem for compiled code, and no trees yet."""
        first, pin = problem.flat_pin_gcells
        grid = problem.topology
        nets = len(problem.nets)
        chip = _Chip(
            size=np.array(problem.grid, np.int64),
            position=grid.position,
            capacity=problem.capacity,
            demand=problem.net_demand,
            first=first,
            pin=pin,
        )
        routable = np.flatnonzero(np.diff(first) > 1)
        # Short nets first, which have fewer ways.
        extent = np.zeros(nets, np.int64)
        for axis in range(VIA_AXIS):
            at = grid.position[pin, axis]
            extent += np.maximum.reduceat(at, first[:-1]) - np.minimum.reduceat(at, first[:-1])
        run = np.zeros(1, _RUN)
        run["random"] = self.options.seed
        run["best_overflow"] = run["fewest"] = np.iinfo(np.int64).max
        pool = 4 * int(extent.sum()) + 4 * len(pin) + 1
        ideal = np.zeros(nets, np.int64)
        ideal[routable] = -1
        trees = _Trees(
            run=run,
            order=routable[np.argsort(extent[routable], kind="stable")],
            remaining=problem.capacity.astype(np.int64),
            price=np.zeros(grid.edges),
            margin=np.full(nets, self.options.margin, np.int64),
            ideal=ideal,
            edge=np.empty((2, pool), np.int32),
            start=np.zeros(nets, np.int64),
            length=np.zeros(nets, np.int64),
            best=np.empty(pool, np.int32),
            best_first=np.zeros(nets + 1, np.int64),
            history=np.empty((_CHUNK, 4), np.int64),
        )
        return chip, trees

    def _room(self, chip: _Chip, points: int) -> tuple[Lattice, Search, _Draft]:
        """Working arrays for boxes of so many points."""
        groups = self.options.exact_pins - 1
        draft = _Draft(
            low=np.zeros(AXES, np.int64),
            far=np.empty(int(np.diff(chip.first).max()), np.int64),
            pin=np.zeros(points, np.uint8),
            inside=np.zeros(points, np.uint8),
            key=np.empty(2 * points, np.int64),
        )
        lattice = make_lattice(points, int(chip.size.max()))
        return lattice, make_search(points, max(points, _EXACT_LABELS), groups), draft


def _enlarged(array: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """The array with its last axis as long as ``size``."""
    larger = np.empty((*array.shape[:-1], size), array.dtype)
    larger[..., : array.shape[-1]] = array
    return larger
