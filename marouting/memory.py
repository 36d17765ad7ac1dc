"""What large problems take in memory, and the limit beyond which they are refused.

Files and options of a few lines can ask for more memory than there is, and the system then ends
some process without a word. So whatever takes memory by the Gcell, or by the net and edge, says
what it is going to take before it takes it. docs/performance.md has the measured figures.
"""

import contextlib
import functools
import math
import os
from pathlib import Path

from marouting.errors import InputError

VARIABLE = "MAROUTING_MAX_GIB"  # the environment variable that sets the limit, in GiB
SHARE = 0.75  # the limit without it, as a share of the memory that this process may use
SMALL = 2**24  # so many bytes are always there, and not worth a look at the limit

# Bytes per Gcell.
TABLES = 64  #: topology
PLAYED = 36  #: capacities of each problem that is played: as given, at the start, remaining
STATE = 105  #: bounds of the state space of an environment
EXPECTED = 24  #: expected demand and agents, of each problem that is seen through windows
SEARCH = 109  #: working arrays of A* (85), and room for a route (24)
NEGOTIATION = 87  #: topology, capacities, prices and users of edges in negotiated congestion
PROOF = 300  #: wires and prices of the proof of an optimum

# Bytes of each object.
NET = 300  #: without its pins
PIN = 120
ADJUSTMENT = 200
USED = 150  #: an edge of a route that is read and evaluated
DRAWN = 1300  #: an edge in a drawing of routes


def check_memory(size: float, what: str, *values: object) -> None:
    """Raises InputError if ``size`` bytes are more than the limit.

    Args:
        size: an estimate.
        what: the start of the message, a format string for the values.
        *values: what is only put into words if it is needed: small games are made by the thousand.
    """
    if size < SMALL:
        return
    most = limit()
    if size > most:
        raise InputError(
            f"{what.format(*values)}: expected to take at most {most / 2**30:.1f} GiB of memory, "
            f"found an estimate of {size / 2**30:.1f} GiB; "
            f"the environment variable {VARIABLE} sets the limit"
        )


def limit() -> float:
    """The limit in bytes; raises InputError if the environment variable is not a number above 0."""
    given = os.environ.get(VARIABLE)
    if given is None:
        return SHARE * _installed()
    try:
        most = float(given)
    except ValueError:
        most = math.nan
    if not most > 0:
        raise InputError(f"{VARIABLE}: expected a number of GiB above 0, found {given!r}")
    return most * 2**30


@functools.cache
def _installed() -> float:
    """The memory that this process may use, in bytes: the machine's or the container's."""
    most = [math.inf]
    with contextlib.suppress(AttributeError, ValueError, OSError):  # not every system tells
        most.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(ValueError, OSError):  # "max" stands for no limit
        most.append(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return min(most)
