"""Where work is done: one way to run calls on processes of this machine and on many machines.

* :mod:`~policies.engines.base`: what a call and an engine are.
* :mod:`~policies.engines.local`: a pool of processes on this machine.
* :mod:`~policies.engines.cluster`: tasks of Ray, which does all the scheduling.
"""

import contextlib
import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

from marouting.errors import InputError
from policies.engines.base import Call, Engine, EngineName, cores, processor

__all__ = ["Call", "Engine", "EngineName", "check_engine", "cores", "opened", "processor"]


def check_engine(name: EngineName) -> None:
    """Raises InputError if an engine is not installed."""
    if name == "ray" and importlib.util.find_spec("ray") is None:
        raise InputError("engine: ray is missing: pip install 'marouting[ray]'")


@contextlib.contextmanager
def opened(name: EngineName, jobs: int, threads: int) -> Iterator[Engine]:
    """An engine that ends with the block, and with this process however that one ends.

    Args:
        name: which one.
        jobs: the largest number of processes on this machine. A Ray that runs already has its own.
        threads: the number of threads that each process may use.

    Raises:
        InputError: the engine is not installed, or there is no Ray where RAY_ADDRESS says.
    """
    check_engine(name)
    kind: Callable[[int, int], Any]
    if name == "local":
        from policies.engines.local import LocalEngine as kind
    else:
        from policies.engines.cluster import RayEngine as kind
    with contextlib.closing(kind(jobs, threads)) as engine:
        yield engine
