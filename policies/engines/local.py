"""A pool of processes that ends with the process that started it, however that one ends."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any

from marouting.errors import InputError
from marouting.registry import allowing_code, code_allowed, register, registered
from marouting.scenarios import load, loaded
from policies.engines.base import THREADS, Call, environment


class LocalEngine:
    """Runs calls in up to so many processes of this machine, each with so many threads.

    The processes import the main module, so a script that uses this needs the usual
    ``if __name__ == "__main__":``.
    """

    def __init__(self, jobs: int, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        # Nothing is ever sent: the processes wait for the only writing end to be closed.
        self._lifeline, self._writer = context.Pipe(duplex=False)
        self._threads = threads
        self._pool = ProcessPoolExecutor(
            jobs, context, _init_process, (self._lifeline, registered(), loaded(), code_allowed())
        )

    def run(self, calls: Sequence[Call]) -> Iterator[dict[int, Any]]:
        """Makes calls; see :meth:`policies.engines.base.Engine.run`."""
        try:
            with _starting(self._threads):
                running = {
                    self._pool.submit(call.function, *call.arguments): number
                    for number, call in enumerate(calls)
                }
            while running:
                done, _ = wait(running, timeout=1, return_when=FIRST_COMPLETED)
                yield {running.pop(future): future.result() for future in done}
        except BrokenProcessPool:
            raise InputError(
                "a process was killed, perhaps because memory ran out: expected fewer jobs at "
                "once, or smaller problems"
            ) from None

    def close(self) -> None:
        """Ends the processes at once."""
        self._writer.close()
        self._pool.shutdown(cancel_futures=True)
        self._lifeline.close()


@contextlib.contextmanager
def _starting(threads: int) -> Iterator[None]:
    """Sets the threads of processes that start meanwhile, and blocks Ctrl-C in their imports."""
    mask = getattr(signal, "pthread_sigmask", None)  # not on Windows
    allowed = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else None
    try:
        with environment(**dict.fromkeys(THREADS, str(threads))):
            yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, allowed)


_for_life = contextlib.ExitStack()
"""What is in force as long as a process lives."""


def _init_process(
    lifeline: Connection,
    components: Sequence[tuple[str, str, str]],
    scenarios: Sequence[str],
    allowed: bool | frozenset[str],
) -> None:
    """Prepares a process; it knows the same components and scenarios as the one that started it.

    Files may name the same code.
    """
    _for_life.enter_context(allowing_code(allowed))
    for component in components:
        register(*component)
    for name in scenarios:
        load(name)
    # Ctrl-C goes to all processes of a terminal; the one that started the others handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_when_closed, args=(lifeline,), daemon=True).start()


def _exit_when_closed(lifeline: Connection) -> None:
    """Waits until the other end is closed and ends this process."""
    with contextlib.suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)
