"""What large problems take in memory, and the limit beyond which they are refused.

Files and options of a few lines can ask for more memory than there is, and the system then ends
some process without a word. So whatever takes memory by the Gcell, or by the net and edge, says
what it is going to take before it takes it. docs/performance.md has the measured figures.
"""

import contextlib
import math
import os
from pathlib import Path

from marouting.errors import InputError

VARIABLE = "MAROUTING_MAX_GIB"
"""The environment variable that sets the limit, in GiB."""

SHARE = 0.75
"""The limit without it, as a share of the memory that this process may use."""

# Bytes per Gcell.
TABLES = 88  #: topology (63) and what the game makes of it (25)
PLAYED = 36  #: capacities of each problem that is played: as given, at the start, remaining
SEARCH = 121  #: working arrays of A* (97), and room for a route (24)
NEGOTIATION = 75  #: topology, capacities and prices of negotiated congestion
PROOF = 240  #: wires and prices of the proof of an optimum

# Bytes of each object.
NET = 300  #: without its pins
PIN = 120
ADJUSTMENT = 200
DRAWN = 1500  #: an edge in a drawing of routes


def check_memory(what: str, size: float) -> None:
    """Raises InputError, starting with ``what``, if ``size`` bytes are more than the limit."""
    most = limit()
    if size > most:
        raise InputError(
            f"{what}: expected to take at most {most / 2**30:.1f} GiB of memory, found an estimate "
            f"of {size / 2**30:.1f} GiB; the environment variable {VARIABLE} sets the limit"
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


def _installed() -> float:
    """The memory that this process may use, in bytes: the machine's or the container's."""
    most = [math.inf]
    with contextlib.suppress(AttributeError, ValueError, OSError):  # not every system tells
        most.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(ValueError, OSError):  # "max" stands for no limit
        most.append(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return min(most)
