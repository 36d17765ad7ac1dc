"""Work in processes of their own, which end with the one that started them, however it ends."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Protocol, TypeVar

from marouting.errors import InputError

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What numba, torch and the libraries for linear algebra read when they are imported."""


class Work(Protocol):
    """What a process can do; it has to be such that it can be pickled."""

    def work(self) -> Any:
        """Does it."""
        ...


Some = TypeVar("Some", bound=Work)


def cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def work_on(parts: Sequence[Some], jobs: int, threads: int) -> Iterator[list[Some]]:
    """Works on parts in processes of their own, in this order.

    The processes import the main module: a script that calls this needs the usual
    ``if __name__ == "__main__":``. When the iteration ends early, by an error or Ctrl-C, or this
    process is killed, they end at once.

    Args:
        parts: the work, one part or more.
        jobs: processes at once, at most.
        threads: that each process may take.

    Yields:
        About every second the parts that have been done since.

    Raises:
        InputError: a process was killed.
        Exception: whatever a part raises.
    """
    context = multiprocessing.get_context("spawn")
    # Nothing is ever sent. That its one writing end is closed is what the processes wait for.
    lifeline, mine = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(min(jobs, len(parts)), context, _begin, (lifeline,))
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
            "a process at work was killed, perhaps for want of memory: expected fewer jobs at "
            "once, or smaller ones"
        ) from None
    finally:
        mine.close()
        pool.shutdown(cancel_futures=True)
        lifeline.close()


@contextlib.contextmanager
def _starting(threads: int) -> Iterator[None]:
    """While processes are started: how many threads each takes, and no Ctrl-C in its imports."""
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


def _begin(lifeline: Connection) -> None:
    """What a process does first."""
    # Ctrl-C goes to all processes of a terminal; only the one that started the others answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """Waits until the other end is closed and ends this process."""
    with contextlib.suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)
