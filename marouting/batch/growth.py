"""Room for the next step, where rows of bits are hashed (:mod:`marouting.batch.bits`).

Compiled code cannot make arrays longer, so before every step there has to be room for whatever may
come of it. It is easy to say what may come: a net crosses one edge at most.
"""

from marouting.batch.bits import length, longer
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import is_on
from marouting.kernels import compiled, inlined, wide
from marouting.memory import check_memory

_TIMES = 4
"""A step can double every table, and those that are doubled are still there."""

_PER_EDGE = 16
"""What an edge of a net can add to its tree and to its kept route: as many tables as there are
entries, a quarter in use, and the tables that they have grown out of."""


@inlined
def _needed(static: Static, dynamic: Dynamic, m: int) -> tuple[int, int]:
    """How long the arrays of a problem's used edges and of its sets have to be for a step."""
    agents, most = wide(dynamic.agents.shape[1]), wide(static.options[Option.AGAIN_MOST])
    used = _TIMES * length(dynamic.used, m)
    sets = length(dynamic.sets, m)
    if static.extended is not None:
        used *= 2  # a net may cross an edge, and get back those that it had, in the same step
        sets = _TIMES * sets + _PER_EDGE * (wide(dynamic.games[m].wirelength) + 2 * agents)
        if is_on(static, Option.PRICES):  # all routes may be noted, or taken from those noted
            best = _PER_EDGE * (wide(dynamic.games[m].best_wirelength) + 2 * agents)
            used += best
            sets += best + _PER_EDGE * wide(dynamic.games[m].wirelength)
        if most > 1:  # a row for all full edges
            sets += wide(static.capacity.shape[1])
    return used, sets


@inlined
def lacks_room(static: Static, dynamic: Dynamic, m: int) -> bool:
    """Whether a problem's arrays are too short for a step, of whoever moves in it."""
    if dynamic.used.ndim == 3:
        return False
    used, sets = _needed(static, dynamic, m)
    return used > dynamic.used.shape[1] or sets > dynamic.sets.shape[1]


@compiled
def _lack(static: Static, dynamic: Dynamic) -> tuple[int, int]:
    """How long the arrays have to be, if one of them is too short; otherwise 0."""
    most, most_sets = wide(0), wide(0)
    for m in range(len(dynamic.games)):
        used, sets = _needed(static, dynamic, wide(m))
        if used > dynamic.used.shape[1] or sets > dynamic.sets.shape[1]:
            most, most_sets = max(most, used), max(most_sets, sets)
    return most, most_sets


def needed_room(static: Static, dynamic: Dynamic) -> tuple[int, int]:
    """How long arrays should be so that there is room for steps; 0 if they are long enough.

    Returns:
        The length of ``used``, and that of ``sets``.

    Raises:
        InputError: they take too much memory.
    """
    used, sets = _lack(static, dynamic)
    games = len(dynamic.games)
    check_memory(4 * games * (used + sets), "routes of {} nets", games * dynamic.agents.shape[1])
    return 2 * used, 2 * sets  # so that it does not happen often; what is free takes no memory


def lengthened(dynamic: Dynamic, used: int, sets: int) -> Dynamic:
    """The state with arrays of these lengths, if they are not longer already."""
    if used > dynamic.used.shape[1]:
        dynamic = dynamic._replace(used=longer(dynamic.used, used))
    if sets > dynamic.sets.shape[1]:
        dynamic = dynamic._replace(sets=longer(dynamic.sets, sets))
    return dynamic
