"""Compiled code that improves a finished solution, a few nets at a time.

A net that takes a detour, or overflows, takes the place of others; these look for other places, and
may take those of further nets. Such chains of displaced nets are known as ejection chains (Glover,
"Ejection chains, reference structures and alternating path methods for traveling salesman
problems", Discrete Applied Mathematics 65, 1996). Nets keep their new trees unless all together are
worse.
"""

from marouting.kernels import compiled, i64
from policies.routers.pathfinder.kernels import draw
from policies.routers.pathfinder.state import (
    DISPLACE,
    DONE,
    MOST_TOGETHER,
    REPAIR,
    SQUEEZE,
    Memory,
    ProblemArrays,
    Routing,
)
from policies.routers.pathfinder.trees import detours, overflows, reroute, use_tree

_STEPS = 24
"""Nets are rerouted so often, at most, until no more overflows than before."""

_PRESENT, _GROWTH = 0.5, 1.3
"""Factor by which one net too many raises the cost of an edge to the first net, and by which this
grows from one net to the next."""


@compiled
def begin_repair_pass(problem: ProblemArrays, routing: Routing) -> None:
    """Begins a pass, which reroutes as many nets as overflow or take a detour."""
    progress, count = routing.progress[0], 0
    for net in routing.order:
        count += detours(problem, routing, net) or overflows(routing, net)
    progress.next = len(routing.order) - max(count, problem.least_repaired, 1)


@compiled
def _choose(problem: ProblemArrays, routing: Routing) -> int:
    """A net that overflows, or that takes a detour; any net if there is none."""
    progress, count = routing.progress[0], len(routing.order)
    shorten = progress.overflow == 0 or draw(progress) % 4 == 0
    begin = draw(progress) % count
    for i in range(count):
        net = routing.order[(begin + i) % count]
        if shorten:
            if detours(problem, routing, net):
                return net
        elif overflows(routing, net):
            return net
    return routing.order[begin]


@compiled
def _displaced(routing: Routing, together: int, last: int) -> int:
    """Another net than the last on an overflowed edge of those together; -1: none."""
    progress = routing.progress[0]
    ties, found, chosen = i64(0), i64(-1), i64(-1)
    for k in range(together):
        net = routing.together[k, 0]
        for i in range(routing.start[net], routing.start[net] + routing.length[net]):
            edge = i64(routing.edge[i])
            if routing.remaining[edge] < 0:
                ties += 1
                if draw(progress) % ties == 0:
                    found = edge
    if found < 0:
        return chosen
    ties, at = i64(0), i64(routing.head[found])
    while at >= 0:
        if routing.owner[at] != last:
            ties += 1
            if draw(progress) % ties == 0:
                chosen = i64(routing.owner[at])
        at = i64(routing.after[at])
    return chosen


@compiled
def repair(problem: ProblemArrays, routing: Routing, memory: Memory) -> tuple[int, int]:
    """Reroutes some nets that displace each other; no worse solution comes of it.

    They negotiate without prices: it is these that have made the first one take its detour. When
    nothing overflows beyond what did before, each is squeezed.

    Returns:
        How many were rerouted before they were squeezed; and DONE, or BOX_TOO_SMALL or
        POOL_TOO_SMALL, in which case all nets are left as they were.
    """
    progress = routing.progress[0]
    overflow, length, top = i64(progress.overflow), i64(progress.length), i64(progress.top)
    present = progress.present
    progress.kind, progress.present = DISPLACE, _PRESENT
    code, routed, together = DONE, i64(0), i64(0)
    net = i64(_choose(problem, routing))
    while code == DONE and net >= 0 and routed < _STEPS:
        known = False
        for k in range(together):
            known |= routing.together[k, 0] == net
        if not known:
            if together == MOST_TOGETHER:
                break
            routing.together[together, 0] = net
            routing.together[together, 1] = routing.start[net]
            routing.together[together, 2] = routing.length[net]
            together += 1
        code = reroute(problem, routing, memory, net)
        routed += 1
        progress.present *= _GROWTH
        if routed > 1 and progress.overflow <= overflow:
            break
        net = i64(_displaced(routing, together, net))
    progress.kind = SQUEEZE
    if progress.overflow <= overflow:
        for k in range(together):
            if code == DONE:
                net = routing.together[k, 0]
                code = reroute(problem, routing, memory, net)
    progress.kind, progress.present = REPAIR, present
    longer = progress.overflow == overflow and progress.length > length
    if code != DONE or progress.overflow > overflow or longer:
        for k in range(together):
            net = routing.together[k, 0]
            use_tree(problem, routing, net, i64(-1))
            routing.start[net] = routing.together[k, 1]
            routing.length[net] = routing.together[k, 2]
            use_tree(problem, routing, net, i64(1))
        progress.top = top
    return routed, code
