"""Compiled code that gives nets their trees, and that keeps the best solution.

:func:`plan` finds a net's tree, :func:`assign_tree` gives it to the net; :func:`reroute` does both.
"""

from typing import Any

from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.lattice import CLOSED, FAR, Lattice
from policies.routers.pathfinder.kernels import (
    beside_via,
    draw,
    grow,
    improve_paths,
    is_stacked,
    join_all,
    load_tree,
    point_of,
    set_box,
    set_costs,
    tree_cost,
    use_cost,
    via_cost,
    wire_cost,
)
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DISPLACE,
    DONE,
    EXACT_LABELS,
    FULL,
    LAYERS,
    MENDED,
    NEGOTIATE,
    NEGOTIATED_LABELS,
    POOL_TOO_SMALL,
    RELAX,
    UNIT,
    Memory,
    NetBuffers,
    ProblemArrays,
    Routing,
)


@compiled
def use_tree(problem: ProblemArrays, routing: Routing, net: int, sign: int) -> None:
    """Adds the demand of a net's tree (sign 1) or removes it (sign -1)."""
    progress = routing.progress[0]
    if progress.linked:
        if sign > 0:
            link(routing, net)
        else:
            unlink(routing, net)
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = i64(routing.edge[i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            progress.length += sign * via_cost(problem, gcell)
            if problem.contest:
                _use_via(problem, routing, net, gcell, sign)
            continue
        layer = i64(problem.position[gcell, VIA_AXIS])
        progress.length += sign * wire_cost(problem, net, layer, edge)
        progress.length -= use_cost(problem, routing, edge, i64(0))
        over = max(-routing.remaining[edge], 0)
        routing.remaining[edge] -= sign * i64(problem.demand[net, layer])
        progress.length += use_cost(problem, routing, edge, i64(0))
        if not problem.contest:
            progress.overflow += max(-routing.remaining[edge], 0) - over


@compiled
def _use_via(problem: ProblemArrays, routing: Routing, net: int, gcell: int, sign: int) -> None:
    """Adds the tracks that a via of a net's tree takes beside its lower Gcell, or removes them."""
    progress, first = routing.progress[0], i64(routing.start[net])
    last = first + routing.length[net]
    if not is_stacked(problem, routing.edge, first, last, gcell):
        return
    for side in range(2):
        beside, halves = beside_via(problem, gcell, side)
        if halves > 0:
            progress.length -= use_cost(problem, routing, beside, i64(0))
            routing.vias[beside] += sign * halves / 2
            progress.length += use_cost(problem, routing, beside, i64(0))


@compiled
def link(routing: Routing, net: int) -> None:
    """Puts a net's edges into the lists that lead from an edge to all nets that use it."""
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = routing.edge[i]
        routing.owner[i], routing.after[i] = net, routing.head[edge]
        routing.head[edge] = i


@compiled
def unlink(routing: Routing, net: int) -> None:
    """Takes a net's edges out of these lists."""
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = routing.edge[i]
        if routing.head[edge] == i:
            routing.head[edge] = routing.after[i]
            continue
        before = i64(routing.head[edge])
        while routing.after[before] != i:
            before = i64(routing.after[before])
        routing.after[before] = routing.after[i]


@compiled
def link_all(routing: Routing) -> None:
    """Makes these lists."""
    routing.progress[0].linked = 1
    for edge in range(len(routing.head)):
        routing.head[edge] = -1
    for net in range(len(routing.length)):
        link(routing, net)


@compiled
def tree_length(problem: ProblemArrays, routing: Routing, net: int) -> int:
    """The length of a net's tree, in units of cost."""
    length = i64(0)
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = i64(routing.edge[i])
        gcell = edge // AXES
        if edge - AXES * gcell == VIA_AXIS:
            length += via_cost(problem, gcell)
        else:
            length += wire_cost(problem, net, i64(problem.position[gcell, VIA_AXIS]), edge)
    return length


@compiled
def overflows(routing: Routing, net: int) -> bool:
    """Whether a net's tree uses an overflowed edge."""
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        if routing.remaining[routing.edge[i]] < 0:
            return True
    return False


@compiled
def _copy_trees(routing: Routing, edges: Any, first: Any) -> int:
    """Copies all trees to ``edges``, without gaps, from ``first`` on; returns their edges."""
    size = i64(0)
    for net in range(len(routing.start)):
        begin = routing.start[net]
        first[net] = size
        for i in range(routing.length[net]):
            edges[size + i] = routing.edge[begin + i]
        size += routing.length[net]
    return size


@compiled
def compact(routing: Routing) -> bool:
    """Closes the gaps between the trees; returns whether there were any."""
    progress = routing.progress[0]
    used = 0
    for net in range(len(routing.length)):
        used += routing.length[net]
    if used == progress.top:
        return False
    edges = routing.after  # is made anew at the end
    progress.top = _copy_trees(routing, edges, routing.start)
    for i in range(progress.top):
        routing.edge[i] = edges[i]
    if progress.linked:
        link_all(routing)
    return True


@compiled
def list_tree(problem: ProblemArrays, lattice: Lattice, buffers: NetBuffers) -> int:
    """Lists the edges of the lattice's tree in ``buffers.tree``; returns how many there are."""
    low, size, point = buffers.low, i64(0), 0
    for x in range(lattice.size[0]):
        for y in range(lattice.size[1]):
            gcell = ((low[0] + x) * problem.size[1] + low[1] + y) * problem.size[2] + low[2]
            for z in range(lattice.size[2]):
                for axis in range(AXES):
                    if lattice.tree[point] >> 2 * axis & 1:
                        buffers.tree[size] = AXES * (gcell + z) + axis
                        size += 1
                point += 1
    return size


@compiled
def store_tree(routing: Routing, net: int, edges: Any, first: int, last: int) -> None:
    """Makes ``edges[first:last]`` the net's tree."""
    progress = routing.progress[0]
    routing.start[net] = progress.top
    for i in range(first, last):
        routing.edge[progress.top] = edges[i]
        progress.top += 1
    routing.length[net] = last - first


@compiled
def present_cost(problem: ProblemArrays, routing: Routing, net: int, own: int) -> int:
    """The cost of a net's tree to the net, which is in place (``own`` 1) or ripped up (0)."""
    first = i64(routing.start[net])
    last = first + routing.length[net]
    return tree_cost(problem, routing, net, routing.edge, first, last, own)


@compiled
def detours(problem: ProblemArrays, routing: Routing, net: int) -> bool:
    """Whether a net's tree is longer than its shortest one; ISPD 2024: dearer than when chosen."""
    if problem.contest:
        return present_cost(problem, routing, net, i64(1)) > routing.ideal[net]
    return tree_length(problem, routing, net) > routing.ideal[net]


@compiled
def is_settled(problem: ProblemArrays, routing: Routing, net: int) -> bool:
    """Whether a net keeps its tree without a search: none can be cheaper, and no lot fell on it."""
    if routing.ideal[net] < present_cost(problem, routing, net, i64(1)):
        return False
    return draw(routing.progress[0]) % (1 << 20) >= problem.reroute_fraction


@compiled
def _prefers(problem: ProblemArrays, net: int) -> bool:
    """Whether a net prefers some layers."""
    most = 0
    for layer in range(problem.size[VIA_AXIS]):
        most = max(most, problem.layer_cost[net, layer])
    return most > 0


@compiled
def plan(problem: ProblemArrays, routing: Routing, memory: Memory, net: int) -> tuple[int, bool]:
    """Looks for a cheapest tree for a net, with the trees of all others in place.

    The net's own tree stays in place, and its tracks are free for the new one. The edges of the new
    one are put in ``buffers.tree``.

    Returns:
        How many edges it has, or BOX_TOO_SMALL; and whether no tree in the box is cheaper.
    """
    lattice, search, buffers = memory
    progress = routing.progress[0]
    pins = problem.first[net + 1] - problem.first[net]
    prefers, whole = _prefers(problem, net), problem.size[VIA_AXIS]
    margin, layers, limit = problem.margin, whole if prefers else i64(LAYERS), i64(FULL)
    while True:
        points = set_box(problem, routing, memory, net, margin, layers)
        if points > len(buffers.pin):
            progress.need = points
            return i64(BOX_TOO_SMALL), False
        set_costs(problem, routing, memory, net, limit)
        search.tally[1] += points
        exact = True
        quick = progress.kind == NEGOTIATE or progress.kind == DISPLACE
        labels = NEGOTIATED_LABELS if quick else EXACT_LABELS
        if pins == 2 or (pins <= problem.exact_pins and points << (pins - 1) <= labels):
            cost = join_all(problem, routing, memory, net)
        else:
            overflowed_only = (
                progress.kind == NEGOTIATE
                and draw(progress) % 100 < MENDED
                and load_tree(problem, routing, memory, net)
            )
            cost = i64(0)
            if not overflowed_only:
                cost = grow(problem, routing, memory, net)
            if cost != CLOSED:
                for i in range(problem.first[net], problem.first[net + 1]):
                    point = point_of(problem.position, buffers.low, lattice.size, problem.pin[i])
                    buffers.pin[point] = 1
                improve_paths(problem, routing, memory, i64(point), overflowed_only)
                exact = False
                for i in range(problem.first[net], problem.first[net + 1]):
                    point = point_of(problem.position, buffers.low, lattice.size, problem.pin[i])
                    buffers.pin[point] = 0
        if cost != CLOSED:
            # What is cheapest is also shortest only where edges in use cost no more than others,
            # and where no layer is dearer: a way around its closed edges may leave any box.
            exact = exact and lattice.size[VIA_AXIS] == whole
            exact = exact and problem.crowding == 0 and not prefers and not problem.contest
            exact = exact and progress.kind == RELAX and routing.ideal[net] < 0
            enough = margin_for(problem, memory, net, cost) if exact else i64(0)
            if enough <= margin:
                break
            more = 2 * (enough - margin)
            points = (lattice.size[0] + more) * (lattice.size[1] + more) * whole
            if pins > 2 and points << (pins - 1) > labels:
                exact = False
                break
            margin = enough
            continue
        if lattice.size[0] == problem.size[0] and lattice.size[1] == problem.size[1]:
            limit = i64(FAR)
        margin, layers = 2 * margin + 1, whole
    return list_tree(problem, lattice, buffers), exact


@compiled
def margin_for(problem: ProblemArrays, memory: Memory, net: int, cost: int) -> int:
    """How wide a net's box must be for no tree that leaves it to cost less than ``cost``.

    Moved onto the box, a tree's parts beyond it get shorter, by ``2 * (margin + 1)`` edges at
    least. So no tree needs to leave a box whose edges are all open, and none that leaves another
    one costs less than half the perimeter of the pins, the vias between them, and these edges.
    """
    lattice = memory.lattice
    nx, ny, nz = lattice.size[0], lattice.size[1], lattice.size[2]
    if nx == problem.size[0] and ny == problem.size[1]:
        return i64(0)
    least = i64(0)
    for axis in range(AXES):
        first, last = problem.size[axis], i64(0)
        for i in range(problem.first[net], problem.first[net + 1]):
            at = i64(problem.position[problem.pin[i], axis])
            first, last = min(first, at), max(last, at)
        if axis == VIA_AXIS:
            least += problem.height[last] - problem.height[first]
        else:
            least += UNIT * (last - first)
    for z in range(nz):
        for axis in range(VIA_AXIS):
            if problem.widest[z, axis] < problem.demand[net, z]:
                continue  # no tree has wires along this axis in this layer
            for x in range(nx - (axis == 0)):
                for y in range(ny - (axis == 1)):
                    if lattice.cost[(x * ny + y) * nz + z, 2 * axis] == CLOSED:
                        return max(-((least - cost) // (2 * UNIT)) - 1, i64(0))
    return i64(0)


@compiled
def assign_tree(
    problem: ProblemArrays,
    routing: Routing,
    net: int,
    edges: Any,
    first: int,
    last: int,
    exact: bool,
) -> int:
    """Gives a net its new tree, ``edges[first:last]``, unless that costs more than the present one.

    Returns:
        DONE; or POOL_TOO_SMALL, in which case the net is left as it was.
    """
    progress = routing.progress[0]
    if progress.top + last - first > len(routing.edge):
        progress.need = progress.top + last - first
        return POOL_TOO_SMALL
    use_tree(problem, routing, net, i64(-1))
    cost = tree_cost(problem, routing, net, edges, first, last, i64(0))
    if cost <= present_cost(problem, routing, net, i64(0)):
        store_tree(routing, net, edges, first, last)
    ideal = i64(routing.ideal[net])
    progress.unproven += ideal < 0 and not (exact and progress.kind == RELAX)
    if problem.contest:
        routing.ideal[net] = present_cost(problem, routing, net, i64(0))
    else:
        length = tree_length(problem, routing, net)
        routing.ideal[net] = length if ideal < 0 else min(ideal, length)
    use_tree(problem, routing, net, i64(1))
    progress.routed += 1
    return DONE


@compiled
def reroute(problem: ProblemArrays, routing: Routing, memory: Memory, net: int) -> int:
    """Plans a net's tree and carries the plan out, unless the net is settled.

    Returns:
        DONE; or BOX_TOO_SMALL or POOL_TOO_SMALL, in which case the net is left as it was.
    """
    if is_settled(problem, routing, net):
        return DONE
    size, exact = plan(problem, routing, memory, net)
    if size == BOX_TOO_SMALL:
        return BOX_TOO_SMALL
    return assign_tree(problem, routing, net, memory.buffers.tree, i64(0), size, exact)


@compiled
def keep_best(routing: Routing) -> None:
    """Copies the trees to ``routing.best``."""
    size = _copy_trees(routing, routing.best, routing.best_first)
    routing.best_first[len(routing.start)] = size


@compiled
def load_best(problem: ProblemArrays, routing: Routing) -> None:
    """Makes the trees of the best solution so far the nets' trees."""
    progress = routing.progress[0]
    for net in range(len(routing.start)):
        use_tree(problem, routing, net, i64(-1))
    progress.top = 0
    for net in range(len(routing.start)):
        routing.start[net] = progress.top
        for i in range(routing.best_first[net], routing.best_first[net + 1]):
            routing.edge[progress.top] = routing.best[i]
            progress.top += 1
        routing.length[net] = progress.top - routing.start[net]
        use_tree(problem, routing, net, i64(1))
