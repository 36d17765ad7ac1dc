"""Compiled code that carries out a stage of the search, mostly a pass over the nets."""

from marouting.kernels import compiled, i64
from policies.routers.pathfinder.kernels import draw
from policies.routers.pathfinder.patterns import route_pattern
from policies.routers.pathfinder.repair import begin_repair_pass, repair
from policies.routers.pathfinder.state import (
    DONE,
    NEGOTIATE,
    PATTERN,
    PAUSED,
    POOL_TOO_SMALL,
    REPAIR,
    RESTORE,
    Memory,
    ProblemArrays,
    Routing,
)
from policies.routers.pathfinder.trees import compact, link_all, load_best, overflows, reroute

_PATTERN_WORK = 64
"""A pattern is about the work of so many labels."""


@compiled
def go_on(problem: ProblemArrays, routing: Routing, memory: Memory) -> int:
    """Carries the present stage on, from where the last call left it.

    Returns:
        Why it returned: DONE at its end; PAUSED to let the caller look at the clock;
        BOX_TOO_SMALL or POOL_TOO_SMALL if ``memory`` or the pools of ``routing`` have to be
        replaced by larger ones, for ``routing.progress["need"]`` points or edges.
    """
    search, progress = memory.search, routing.progress[0]
    if progress.kind == RESTORE:
        load_best(problem, routing)
        link_all(routing)
        return DONE
    if progress.kind == REPAIR and progress.next == 0:
        begin_repair_pass(problem, routing)
    while progress.next < len(routing.order):
        if search.tally[1] > progress.until:
            return PAUSED
        net, code, routed = routing.order[progress.next], DONE, i64(1)
        if progress.kind == PATTERN:
            code = route_pattern(problem, routing, memory, net)
            search.tally[1] += _PATTERN_WORK
        elif progress.kind == REPAIR:
            routed, code = repair(problem, routing, memory)
        elif progress.kind != NEGOTIATE or overflows(routing, net):
            code = reroute(problem, routing, memory, net)
        if code == POOL_TOO_SMALL and compact(routing):
            continue
        if code != DONE:
            return code
        progress.next += routed
    return DONE


@compiled
def shuffle(routing: Routing) -> None:
    """Puts the nets into a random order."""
    progress = routing.progress[0]
    for i in range(len(routing.order) - 1, 0, -1):
        j = draw(progress) % (i + 1)
        routing.order[i], routing.order[j] = routing.order[j], routing.order[i]
