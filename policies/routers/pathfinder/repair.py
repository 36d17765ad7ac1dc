"""Compiled code that improves a finished solution, a neighbourhood of nets at a time.

This is a large neighbourhood search (Shaw, "Using constraint programming and local search methods
to solve vehicle routing problems", CP 1998): nets that are close to each other are ripped up
together and routed again, each for least overflow and then for least length, in random order. They
keep their new trees unless all together are worse.
"""

from marouting.kernels import compiled, wide
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.exact_tree import Search
from marouting.trees.lattice import Lattice
from policies.routers.pathfinder.kernels import draw
from policies.routers.pathfinder.state import (
    DONE,
    MOST_TOGETHER,
    NetBuffers,
    Parameters,
    ProblemArrays,
    Routing,
)
from policies.routers.pathfinder.trees import overflows, reroute, tree_length, use_tree

_RADIUS = 2  # the centre is at most so many Gcells away from an edge of each other net


@compiled
def _has_detour(routing: Routing, via: int, net: int) -> bool:
    """Whether a net's tree is longer than its shortest."""
    return tree_length(routing, via, net) > routing.ideal[net]


@compiled
def _is_near(problem: ProblemArrays, routing: Routing, net: int, centre: int, radius: int) -> bool:
    """Whether a net's tree has an edge inside a layer within a radius of a Gcell, in x and y."""
    for i in range(routing.start[net], routing.start[net] + routing.length[net]):
        edge = wide(routing.edge[routing.progress[0].pool, i])
        gcell = edge // AXES
        if edge - AXES * gcell != VIA_AXIS:
            across = abs(wide(problem.position[gcell, 0]) - problem.position[centre, 0])
            along = abs(wide(problem.position[gcell, 1]) - problem.position[centre, 1])
            if max(across, along) <= radius:
                return True
    return False


@compiled
def choose(problem: ProblemArrays, parameters: Parameters, routing: Routing) -> int:
    """Chooses nets to rip up together, in random order, into ``routing.together``.

    The first one overflows, or has a detour. One of its edges (an overflowed one, if it overflows)
    is the centre, and the others have edges close to that.

    Returns:
        How many there are.
    """
    progress = routing.progress[0]
    count = len(routing.order)
    shorten = progress.overflow == 0 or draw(progress) % 4 == 0
    begin = draw(progress) % count
    for i in range(count):
        first = routing.order[(begin + i) % count]
        if _has_detour(routing, parameters.via, first) if shorten else overflows(routing, first):
            break
    centre, ties = problem.pin[problem.first[first]], wide(0)
    for i in range(routing.start[first], routing.start[first] + routing.length[first]):
        edge = wide(routing.edge[progress.pool, i])
        if shorten or routing.remaining[edge] < 0:
            ties += 1
            if draw(progress) % ties == 0:
                centre = edge // AXES
    radius = draw(progress) % (_RADIUS + 1)
    wanted = 2 + draw(progress) % (MOST_TOGETHER - 1)
    routing.together[0, 0] = first
    chosen = wide(1)
    begin = draw(progress) % count
    for i in range(count):
        if chosen == wanted:
            break
        net = routing.order[(begin + i) % count]
        if net != first and _is_near(problem, routing, net, centre, radius):
            # The new one swaps places with any.
            j = draw(progress) % (chosen + 1)
            routing.together[chosen, 0] = routing.together[j, 0]
            routing.together[j, 0] = net
            chosen += 1
    return chosen


@compiled
def repair(
    problem: ProblemArrays,
    parameters: Parameters,
    routing: Routing,
    lattice: Lattice,
    search: Search,
    buffers: NetBuffers,
    chosen: int,
) -> int:
    """Reroutes some nets that are close to each other; no worse solution comes of it.

    Args:
        problem: the problem.
        parameters: the options.
        routing: holds the nets in ``together``, and their trees.
        lattice: working memory, like the two that follow.
        search: likewise.
        buffers: likewise.
        chosen: how many nets there are in ``together``.

    Returns:
        DONE; or BOX_TOO_SMALL or POOL_TOO_SMALL, in which case all nets are left as they were.
    """
    progress = routing.progress[0]
    overflow, length = wide(progress.overflow), wide(progress.length)
    for i in range(chosen):
        net = routing.together[i, 0]
        routing.together[i, 1], routing.together[i, 2] = routing.start[net], routing.length[net]
        use_tree(problem, routing, parameters.via, net, wide(-1))
    code, routed = DONE, wide(0)
    while code == DONE and routed < chosen:
        net = routing.together[routed, 0]
        code = reroute(problem, parameters, routing, lattice, search, buffers, net)
        routed += code == DONE
    longer = progress.overflow == overflow and progress.length > length
    if code != DONE or progress.overflow > overflow or longer:
        for i in range(chosen):
            net = routing.together[i, 0]
            if i < routed:
                use_tree(problem, routing, parameters.via, net, wide(-1))
            routing.start[net], routing.length[net] = (
                routing.together[i, 1],
                routing.together[i, 2],
            )
            use_tree(problem, routing, parameters.via, net, wide(1))
    return code
