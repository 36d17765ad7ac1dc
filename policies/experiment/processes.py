"""A pool of processes that ends with the process that started it, however that one ends."""

import contextlib
import multiprocessing
import os
import platform
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol, TypeVar

from marouting.errors import InputError
from marouting.registry import register, registered

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""The variables that numba, torch and the linear algebra libraries read when imported."""


class Work(Protocol):
    """Work for a process; it must be possible to pickle."""

    def work(self) -> Any:
        """Does the work."""
        ...


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


Some = TypeVar("Some", bound=Work)


def cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def work_on(parts: Sequence[Some], jobs: int, threads: int) -> Iterator[list[Some]]:
    """Works on parts in a pool of processes, in the given order.

    The processes import the main module, so a script that calls this needs the usual
    ``if __name__ == "__main__":``. They end at once when the iteration ends early, by an error or
    Ctrl-C, or when this process is killed.

    Args:
        parts: the work, one part or more.
        jobs: the largest number of processes.
        threads: the number of threads that each process may use.

    Yields:
        About every second, the parts that have been finished since.

    Raises:
        InputError: a process was killed.
        Exception: whatever a part raises.
    """
    context = multiprocessing.get_context("spawn")
    # Nothing is ever sent: the processes wait for the only writing end to be closed.
    lifeline, mine = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(min(jobs, len(parts)), context, _begin, (lifeline, registered()))
    try:
        with _starting(threads):
            running = {pool.submit(part.work): part for part in parts}
        while running:
            done, _ = wait(running, timeout=1, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            yield [running.pop(future) for future in done]
    except BrokenProcessPool:
        raise InputError(
            "a process was killed, perhaps because memory ran out: expected fewer jobs at once, or "
            "smaller problems"
        ) from None
    finally:
        mine.close()
        pool.shutdown(cancel_futures=True)
        lifeline.close()


@contextlib.contextmanager
def _starting(threads: int) -> Iterator[None]:
    """Sets the threads of processes that start meanwhile, and blocks Ctrl-C in their imports."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
    mask = getattr(signal, "pthread_sigmask", None)  # not on Windows
    allowed = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else None
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, allowed)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin(lifeline: Connection, pieces: Sequence[tuple[str, str, str]]) -> None:
    """Prepares a process; it knows the same pieces by name as the one that started it."""
    for piece in pieces:
        register(*piece)
    # Ctrl-C goes to all processes of a terminal; the one that started the others handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """Waits until the other end is closed and ends this process."""
    with contextlib.suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)
