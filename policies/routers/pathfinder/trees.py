"""Compiled code that gives nets their trees, and that keeps the best solution.

:func:`reroute` does the work of all passes.
"""

from typing import Any

from marouting.kernels import compiled, wide
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.exact_tree import Search
from marouting.trees.lattice import CLOSED, Lattice
from policies.routers.pathfinder.kernels import (
    NO_LIMIT,
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
    NEGOTIATED_LABELS,
    POOL_TOO_SMALL,
    RELAX,
    REPAIR,
    UNIT,
    NetBuffers,
    Parameters,
    ProblemArrays,
    Routing,
)


@compiled
def use_tree(problem: ProblemArrays, routing: Routing, via: int, net: int, sign: int) -> None:
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
def tree_length(routing: Routing, via: int, net: int) -> int:
    """The length of a net's tree, in units of cost."""
    length = wide(0)
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = wide(routing.edge[routing.progress[0].pool, i])
        length += via if edge % AXES == VIA_AXIS else UNIT
    return length


@compiled
def overflows(routing: Routing, net: int) -> bool:
    """Whether a net's tree uses an overflowed edge."""
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        if routing.remaining[routing.edge[routing.progress[0].pool, i]] < 0:
            return True
    return False


@compiled
def compact(routing: Routing) -> bool:
    """Copies the trees into the other pool, without gaps; returns whether there were any."""
    progress = routing.progress[0]
    used = 0
    for net in range(len(routing.length)):
        used += routing.length[net]
    if used == progress.top:
        return False
    old, progress.pool, progress.top = progress.pool, 1 - progress.pool, 0
    for net in range(len(routing.start)):
        for i in range(routing.length[net]):
            routing.edge[progress.pool, progress.top + i] = routing.edge[
                old, routing.start[net] + i
            ]
        routing.start[net] = progress.top
        progress.top += routing.length[net]
    return True


@compiled
def store_tree(
    problem: ProblemArrays, routing: Routing, lattice: Lattice, low: Any, net: int
) -> None:
    """Makes the lattice's tree the net's tree."""
    progress = routing.progress[0]
    routing.start[net] = progress.top
    point = 0
    for x in range(lattice.size[0]):
        for y in range(lattice.size[1]):
            gcell = ((low[0] + x) * problem.size[1] + low[1] + y) * problem.size[2]
            for z in range(lattice.size[2]):
                for axis in range(AXES):
                    if lattice.tree[point] >> 2 * axis & 1:
                        routing.edge[progress.pool, progress.top] = AXES * (gcell + z) + axis
                        progress.top += 1
                point += 1
    routing.length[net] = progress.top - routing.start[net]


@compiled
def reroute(
    problem: ProblemArrays,
    parameters: Parameters,
    routing: Routing,
    lattice: Lattice,
    search: Search,
    buffers: NetBuffers,
    net: int,
) -> int:
    """Rips a net up and routes it again, unless its tree is known to be a cheapest one.

    In a repairing pass the net is ripped up already, together with others, and gets a new tree in
    any case.

    Returns:
        DONE; or BOX_TOO_SMALL or POOL_TOO_SMALL, in which case the net is left as it was.
    """
    progress = routing.progress[0]
    pins = problem.first[net + 1] - problem.first[net]
    margin, limit = parameters.margin, wide(FULL)
    ripped = progress.kind == REPAIR
    if not ripped:
        use_tree(problem, routing, parameters.via, net, wide(-1))
    old = _tree_cost(problem, routing, parameters.via, net)
    routed = routing.ideal[net] >= 0
    as_short = not ripped and routed and old <= routing.ideal[net]
    if as_short and draw(progress) % (1 << 20) >= parameters.again:
        use_tree(problem, routing, parameters.via, net, wide(1))
        return DONE
    while True:
        points = set_box(problem, routing, net, margin, buffers.low, lattice.size)
        code = DONE
        if points > len(buffers.pin):
            code, progress.need = BOX_TOO_SMALL, points
        elif progress.top + points > routing.edge.shape[1]:
            code, progress.need = POOL_TOO_SMALL, progress.top + points
        if code != DONE:
            if not ripped:
                use_tree(problem, routing, parameters.via, net, wide(1))
            return code
        set_costs(problem, routing, lattice, buffers.low, parameters.via, net, limit)
        search.tally[1] += points
        exact = True
        labels = NEGOTIATED_LABELS if progress.kind == NEGOTIATE else EXACT_LABELS
        if pins == 2 or (pins <= parameters.exact_pins and points << (pins - 1) <= labels):
            cost = join_all(problem, progress, lattice, search, buffers.low, net)
        else:
            cost = grow(problem, progress, lattice, search, buffers, net)
            if cost != CLOSED:
                for i in range(problem.first[net], problem.first[net + 1]):
                    point = point_of(problem.position, buffers.low, lattice.size, problem.pin[i])
                    buffers.pin[point] = 1
                cost -= mend(progress, lattice, search, buffers, wide(point))
                exact = False
                for i in range(problem.first[net], problem.first[net + 1]):
                    point = point_of(problem.position, buffers.low, lattice.size, problem.pin[i])
                    buffers.pin[point] = 0
        if cost != CLOSED:
            break
        if lattice.size[0] == problem.size[0] and lattice.size[1] == problem.size[1]:
            limit = wide(NO_LIMIT)
        margin = 2 * margin + 1
    if ripped or cost <= old:
        store_tree(problem, routing, lattice, buffers.low, net)
    length = tree_length(routing, parameters.via, net)
    routing.ideal[net] = min(routing.ideal[net], length) if routed else length
    progress.unproven += not routed and not (exact and progress.kind == RELAX)
    use_tree(problem, routing, parameters.via, net, wide(1))
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
def load_best(problem: ProblemArrays, routing: Routing, via: int) -> None:
    """Makes the trees of the best solution so far the nets' trees."""
    progress = routing.progress[0]
    for net in range(len(routing.start)):
        use_tree(problem, routing, via, net, wide(-1))
    progress.top = 0
    for net in range(len(routing.start)):
        routing.start[net] = progress.top
        for i in range(routing.best_first[net], routing.best_first[net + 1]):
            routing.edge[progress.pool, progress.top] = routing.best[i]
            progress.top += 1
        routing.length[net] = progress.top - routing.start[net]
        use_tree(problem, routing, via, net, wide(1))
