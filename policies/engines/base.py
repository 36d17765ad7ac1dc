"""What runs calls on many processes, wherever these are."""

import contextlib
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

EngineName = Literal["local", "ray"]
"""Where work is done: in processes of this machine, or as tasks of Ray."""

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""The variables that numba, torch and the linear algebra libraries read when imported."""


@dataclass(frozen=True)
class Call:
    """A call that another process makes; it can be pickled.

    Attributes:
        function: what is called: of a module, so that the other process finds it by its name, or a
            method of an object.
        arguments: what it is called with.
        gpus: the number of GPUs that it needs.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    gpus: int = 0


class Engine(Protocol):
    """Runs calls."""

    def run(self, calls: Sequence[Call]) -> Iterator[dict[int, Any]]:
        """Makes calls, in order as far as there is room; they end with the engine.

        Yields:
            About every second what was returned since, by the call's number.

        Raises:
            InputError: a process was killed.
            Exception: whatever a call raises.
        """
        ...


@contextlib.contextmanager
def environment(**variables: str) -> Iterator[None]:
    """Sets variables for processes that start meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
