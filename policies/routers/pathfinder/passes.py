"""Compiled code for passes over the nets and rounds of passes.

:func:`advance` carries the search on; :func:`_next_pass` holds the rules by which one kind of pass
follows another.
"""

from typing import Any

import numpy as np

from marouting.kernels import compiled, wide
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.exact_tree import Search
from marouting.trees.lattice import CLOSED, Lattice
from policies.routers.pathfinder.kernels import (
    draw,
    edge_cost,
    grow,
    join_all,
    mend,
    point_of,
    set_box,
    set_costs,
)
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DONE,
    EXACT_LABELS,
    FULL,
    NEGOTIATE,
    PAUSED,
    POOL_TOO_SMALL,
    RELAX,
    SQUEEZE,
    UNIT,
    NetBuffers,
    Parameters,
    ProblemArrays,
    Routing,
)

_NO_LIMIT = 1 << 31  # more than any edge costs
_WORK = 1 << 18  # labels opened per call, about 50 ms, so that the caller can look at the clock


@compiled
def _use_tree(problem: ProblemArrays, routing: Routing, via: int, net: int, sign: int) -> None:
    """Adds the demand of a net's tree (sign 1) or removes it (sign -1)."""
    progress = routing.progress[0]
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = wide(routing.edge[progress.pool, i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            progress.length += sign * via
            continue
        progress.length += sign * UNIT
        over = max(-routing.remaining[edge], 0)
        layer = problem.position[gcell, VIA_AXIS]
        routing.remaining[edge] -= sign * wide(problem.demand[net, layer])
        progress.overflow += max(-routing.remaining[edge], 0) - over


@compiled
def _tree_cost(problem: ProblemArrays, routing: Routing, via: int, net: int) -> int:
    """The current cost of a net's tree to the net, which is ripped up."""
    progress = routing.progress[0]
    cost = 0
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = wide(routing.edge[progress.pool, i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            cost += via
        else:
            cost += edge_cost(
                problem.capacity,
                routing.remaining,
                routing.price,
                edge,
                wide(problem.demand[net, problem.position[gcell, VIA_AXIS]]),
                progress.present,
                progress.kind,
            )
    return cost


@compiled
def _overflows(routing: Routing, net: int) -> bool:
    """Whether a net's tree uses an overflowed edge."""
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        if routing.remaining[routing.edge[routing.progress[0].pool, i]] < 0:
            return True
    return False


@compiled
def _compact(routing: Routing) -> None:
    """Copies the trees into the other pool, without gaps between them."""
    progress = routing.progress[0]
    old, progress.pool, progress.top = progress.pool, 1 - progress.pool, 0
    for net in range(len(routing.start)):
        for i in range(routing.length[net]):
            routing.edge[progress.pool, progress.top + i] = routing.edge[
                old, routing.start[net] + i
            ]
        routing.start[net] = progress.top
        progress.top += routing.length[net]


@compiled
def _store_tree(
    problem: ProblemArrays, routing: Routing, lattice: Lattice, low: Any, net: int
) -> int:
    """Makes the lattice's tree the net's tree; returns how many vias it has."""
    progress = routing.progress[0]
    routing.start[net] = progress.top
    vias = 0
    point = 0
    for x in range(lattice.size[0]):
        for y in range(lattice.size[1]):
            gcell = ((low[0] + x) * problem.size[1] + low[1] + y) * problem.size[2]
            for z in range(lattice.size[2]):
                for axis in range(AXES):
                    if lattice.tree[point] >> 2 * axis & 1:
                        routing.edge[progress.pool, progress.top] = AXES * (gcell + z) + axis
                        progress.top += 1
                        vias += axis == VIA_AXIS
                point += 1
    routing.length[net] = progress.top - routing.start[net]
    return vias


@compiled
def _reroute(
    problem: ProblemArrays,
    parameters: Parameters,
    routing: Routing,
    lattice: Lattice,
    search: Search,
    buffers: NetBuffers,
    net: int,
) -> int:
    """Rips a net up and routes it again, unless its tree is known to be a cheapest one.

    Returns:
        DONE; or BOX_TOO_SMALL or POOL_TOO_SMALL, in which case the net is left as it was.
    """
    progress = routing.progress[0]
    pins = problem.first[net + 1] - problem.first[net]
    margin, limit = routing.margin[net], wide(FULL)
    _use_tree(problem, routing, parameters.via, net, wide(-1))
    old = _tree_cost(problem, routing, parameters.via, net)
    routed = routing.ideal[net] >= 0
    if routed and old <= routing.ideal[net] and draw(progress) % (1 << 20) >= parameters.again:
        _use_tree(problem, routing, parameters.via, net, wide(1))
        return DONE
    while True:
        points = set_box(problem, routing, net, margin, buffers.low, lattice.size)
        code = DONE
        if points > len(buffers.pin):
            code, progress.need = BOX_TOO_SMALL, points
        elif progress.top + points > routing.edge.shape[1]:
            _compact(routing)
            if progress.top + points > routing.edge.shape[1]:
                code, progress.need = POOL_TOO_SMALL, progress.top + points
        if code != DONE:
            _use_tree(problem, routing, parameters.via, net, wide(1))
            return code
        set_costs(problem, routing, lattice, buffers.low, parameters.via, net, limit)
        search.tally[1] += points
        if pins == 2 or (pins <= parameters.exact_pins and points << (pins - 1) <= EXACT_LABELS):
            cost = join_all(problem, progress, lattice, search, buffers.low, net)
        else:
            cost = grow(problem, progress, lattice, search, buffers, net)
            if cost != CLOSED:
                for i in range(problem.first[net], problem.first[net + 1]):
                    point = point_of(problem.position, buffers.low, lattice.size, problem.pin[i])
                    buffers.pin[point] = 1
                cost -= mend(progress, lattice, search, buffers, wide(point))
                progress.unproven += not routed
                for i in range(problem.first[net], problem.first[net + 1]):
                    point = point_of(problem.position, buffers.low, lattice.size, problem.pin[i])
                    buffers.pin[point] = 0
        if cost != CLOSED:
            break
        if lattice.size[0] == problem.size[0] and lattice.size[1] == problem.size[1]:
            limit = wide(_NO_LIMIT)
        margin = 2 * margin + 1
    if not routed or cost <= old:
        vias = _store_tree(problem, routing, lattice, buffers.low, net)
        length = UNIT * (routing.length[net] - vias) + parameters.via * vias
        routing.ideal[net] = min(routing.ideal[net], length) if routed else cost
    _use_tree(problem, routing, parameters.via, net, wide(1))
    progress.routed += 1
    return DONE


@compiled
def keep_best(routing: Routing) -> bool:
    """Copies the trees to ``routing.best`` if they are the best so far; returns whether they are.

    Less overflow is better, then less length.
    """
    progress = routing.progress[0]
    if progress.overflow > progress.best_overflow or (
        progress.overflow == progress.best_overflow and progress.length >= progress.best_length
    ):
        return False
    progress.best_overflow, progress.best_length = progress.overflow, progress.length
    size = 0
    for net in range(len(routing.start)):
        routing.best_first[net] = size
        for i in range(routing.length[net]):
            routing.best[size + i] = routing.edge[progress.pool, routing.start[net] + i]
        size += routing.length[net]
    routing.best_first[len(routing.start)] = size
    return True


@compiled
def _next_pass(parameters: Parameters, routing: Routing) -> bool:
    """Ends a pass: records it, updates prices, and chooses the kind of the next pass.

    Returns:
        Whether there is a next pass.
    """
    progress = routing.progress[0]
    progress.better |= keep_best(routing)
    row = routing.history[progress.history]
    row[0], row[1] = progress.kind, progress.overflow
    row[2], row[3] = progress.length, progress.routed
    progress.history += 1
    progress.passes += 1
    first = progress.passes == 1
    progress.next = progress.routed = 0
    gained = progress.overflow < progress.last_overflow or (
        progress.overflow == progress.last_overflow
        and progress.last_length - progress.length > parameters.least_gain * progress.length
    )
    progress.last_overflow, progress.last_length = progress.overflow, progress.length
    if progress.overflow < progress.fewest:
        progress.fewest, progress.stuck = progress.overflow, 0
    else:
        progress.stuck += 1
    if progress.kind == SQUEEZE and not gained:
        # The next round begins.
        progress.since = 0 if progress.better else progress.since + 1
        progress.better = 0
        progress.kind = RELAX
        progress.present = parameters.present
        progress.fewest, progress.stuck = np.iinfo(np.int64).max, 0
        for edge in range(len(routing.price)):
            routing.price[edge] *= parameters.decay
        for net in range(len(routing.margin)):
            routing.margin[net] = parameters.margin
    elif progress.kind != SQUEEZE:
        progress.kind = SQUEEZE
        if progress.overflow > 0 and progress.stuck < parameters.stuck:
            progress.kind = NEGOTIATE
            progress.present = parameters.present if first else progress.present * parameters.growth
            for edge in range(len(routing.price)):
                if routing.remaining[edge] < 0:
                    routing.price[edge] += parameters.history * UNIT
    for i in range(len(routing.order) - 1, 0, -1):
        j = draw(progress) % (i + 1)
        routing.order[i], routing.order[j] = routing.order[j], routing.order[i]
    # No solution can be shorter than the shortest trees of all nets together.
    shortest = 0
    for net in range(len(routing.ideal)):
        shortest += routing.ideal[net]
    optimal = progress.overflow == 0 and progress.length == shortest and progress.unproven == 0
    more = progress.since < parameters.patience and progress.passes < parameters.passes
    return more and not optimal


@compiled
def advance(
    problem: ProblemArrays,
    parameters: Parameters,
    routing: Routing,
    lattice: Lattice,
    search: Search,
    buffers: NetBuffers,
) -> int:
    """Carries the search on for a while, from where the last call left it.

    Args:
        problem: the problem.
        parameters: the options.
        routing: where the search stands; changed.
        lattice: working memory, like the two that follow.
        search: likewise.
        buffers: likewise.

    Returns:
        Why it returned: DONE when the search has ended; PAUSED to let the caller look at the clock
        or empty ``routing.history``; BOX_TOO_SMALL or POOL_TOO_SMALL if ``lattice``, ``search``
        and ``buffers`` or the pools of ``routing`` have to be replaced by larger ones, for
        ``routing.progress["need"]`` points or edges.
    """
    progress = routing.progress[0]
    until = search.tally[1] + _WORK
    while True:
        while progress.next < len(routing.order):
            if search.tally[1] > until:
                return PAUSED
            net = routing.order[progress.next]
            if progress.kind != NEGOTIATE or _overflows(routing, net):
                code = _reroute(problem, parameters, routing, lattice, search, buffers, net)
                if code != DONE:
                    return code
                if progress.kind == NEGOTIATE:
                    routing.margin[net] += 1
            progress.next += 1
        if not _next_pass(parameters, routing):
            return DONE
        if progress.history == len(routing.history):
            return PAUSED
