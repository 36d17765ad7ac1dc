"""Compiled code for passes over the nets and rounds of passes.

:func:`advance` carries the search on; :func:`_next_pass` holds the rules by which one kind of pass
follows another.
"""

import numpy as np

from marouting.kernels import compiled, i64
from policies.routers.pathfinder.kernels import draw
from policies.routers.pathfinder.patterns import route_pattern
from policies.routers.pathfinder.repair import repair, repairable
from policies.routers.pathfinder.state import (
    DONE,
    EARLY,
    NEGOTIATE,
    PATTERN,
    PAUSED,
    POOL_TOO_SMALL,
    RELAX,
    REPAIR,
    SQUEEZE,
    UNIT,
    Memory,
    Parameters,
    ProblemArrays,
    Routing,
)
from policies.routers.pathfinder.trees import (
    compact,
    keep_best,
    link_all,
    load_best,
    overflows,
    reroute,
)


@compiled
def _next_pass(problem: ProblemArrays, parameters: Parameters, routing: Routing) -> bool:
    """Ends a pass, chooses the kind of the next pass, and returns whether there is one."""
    progress = routing.progress[0]
    row = routing.history[progress.history]
    row[0], row[1] = progress.kind, progress.overflow
    row[2], row[3] = progress.length, progress.routed
    progress.history += 1
    progress.passes += 1
    progress.next = progress.routed = 0
    better = keep_best(routing)
    if better:
        progress.found = progress.passes
    more = progress.passes < parameters.passes
    if progress.kind == PATTERN and not progress.large:
        progress.kind, progress.began = RELAX, progress.passes
        return more
    gained = progress.overflow < progress.last_overflow or (
        progress.overflow == progress.last_overflow == progress.best_overflow
        and progress.last_length - progress.length
        > parameters.min_wirelength_gain * progress.length
    )
    progress.last_overflow, progress.last_length = progress.overflow, progress.length
    if progress.overflow < progress.fewest * (1.0 - parameters.min_overflow_drop):
        progress.fewest, progress.stuck = progress.overflow, 0
    else:
        progress.stuck += 1
    step = 1.0 / (1.0 + parameters.step_decay * progress.rounds)
    round_over = progress.kind == SQUEEZE and not gained
    if progress.kind == REPAIR:
        progress.since = 0 if better else progress.since + 1
    elif round_over:
        counts = (
            parameters.overflow_stall_weight if progress.overflow > progress.best_overflow else 1
        )
        progress.since = 0 if progress.found > progress.began else progress.since + counts
    if round_over and progress.since >= parameters.repair_after:
        progress.kind, progress.since = REPAIR, 0
        load_best(problem, routing)
        link_all(routing)
    elif round_over or (
        progress.kind == REPAIR and progress.since >= parameters.repair_stall_passes
    ):
        if progress.kind == REPAIR:
            found = max(progress.found, EARLY)
            more = more and progress.passes < parameters.patience_factor * found
            progress.since = progress.linked = 0
        progress.kind, progress.began = RELAX, progress.passes
        progress.present = parameters.present_factor
        progress.fewest, progress.stuck = np.iinfo(np.int64).max, 0
        for edge in range(len(routing.price)):
            routing.price[edge] *= 1.0 - step * (1.0 - parameters.history_decay)
        progress.rounds += 1
        progress.pricing = parameters.lp_passes - 1 if progress.best_overflow > 0 else 0
    elif progress.kind == RELAX and progress.pricing > 0:
        progress.pricing -= 1
    elif (
        progress.kind == NEGOTIATE
        and progress.passes == parameters.lp_after_pass
        and progress.best_overflow > 0
        and parameters.lp_passes > 0
    ):
        progress.kind, progress.pricing = RELAX, parameters.lp_passes - 1
        progress.fewest, progress.stuck = np.iinfo(np.int64).max, 0
    elif progress.kind < SQUEEZE or progress.kind == PATTERN:
        progress.kind = SQUEEZE
        if progress.overflow > 0 and progress.stuck < parameters.stall_passes:
            progress.kind = NEGOTIATE
            first = progress.present == 0  # until then nets have shared edges freely
            progress.present = (
                parameters.present_factor if first else progress.present * parameters.present_growth
            )
            for edge in range(len(routing.price)):
                if routing.remaining[edge] < 0:
                    routing.price[edge] += step * parameters.history_increment * UNIT
    for i in range(len(routing.order) - 1, 0, -1):
        j = draw(progress) % (i + 1)
        routing.order[i], routing.order[j] = routing.order[j], routing.order[i]
    # No solution can be shorter than the shortest trees of all nets together.
    shortest = 0
    for net in range(len(routing.ideal)):
        shortest += routing.ideal[net]
    shortest_of_all = progress.length == shortest and progress.unproven == 0
    if progress.kind == REPAIR:
        least = i64(np.ceil(parameters.min_repair_fraction * len(routing.order)))
        progress.next = len(routing.order) - max(least, repairable(problem, routing))
    progress.proven = progress.overflow == 0 and shortest_of_all
    return more and not progress.proven


@compiled
def advance(
    problem: ProblemArrays, parameters: Parameters, routing: Routing, memory: Memory
) -> int:
    """Carries the search on for a while, from where the last call left it.

    Returns:
        Why it returned: DONE when the search has ended; PAUSED to let the caller look at the clock,
        after ``routing.progress["work"]`` labels, empty ``routing.history``, plan nets in batches
        or set prices; BOX_TOO_SMALL or POOL_TOO_SMALL if ``lattice``, ``search`` and ``buffers`` or
        the pools of ``routing`` have to be replaced by larger ones, for
        ``routing.progress["need"]`` points or edges.
    """
    lattice, search, buffers = memory
    progress = routing.progress[0]
    until = search.tally[1] + progress.work
    while True:
        while progress.next < len(routing.order):
            if search.tally[1] > until:
                return PAUSED
            net, code, routed = routing.order[progress.next], DONE, i64(1)
            if progress.kind == PATTERN:
                code = route_pattern(problem, routing, lattice, buffers, net)
                search.tally[1] += 64  # about the work of so many labels
            elif progress.kind == REPAIR:
                routed, code = repair(problem, parameters, routing, memory)
            elif progress.kind != NEGOTIATE or overflows(routing, net):
                code = reroute(problem, parameters, routing, memory, net)
            if code == POOL_TOO_SMALL and compact(routing):
                continue
            if code != DONE:
                return code
            progress.next += routed
        if not _next_pass(problem, parameters, routing):
            return DONE
        if (
            parameters.lp_passes > 0
            or progress.most > 1
            or progress.history == len(routing.history)
        ):
            return PAUSED
