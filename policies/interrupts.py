"""Makes sure that Ctrl-C is never lost.

LLVM calls back into Python where it loads and stores compiled code, and goes on with what the
callback should have set: an exception raised there is printed and forgotten, and the process may
end with a segmentation fault. So an interrupt is put off there, and while numba
removes a type from its tables.

Elsewhere it is raised at once. But Python prints and forgets exceptions in destructors and where a
weak reference tells that an object is gone, and libraries have bare ``except:`` around what they
import. An :class:`Interrupt` that is forgotten before it has ended the work is raised again.
"""

import contextlib
import os
import signal
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from marouting.first import leave

_TYPE_IS_GONE = "_on_type_disposal"
"""The function of numba that is told by weak references."""

AGAIN = 0.02
"""Seconds after which an interrupt that has been put off or forgotten is tried again."""


class _Work:
    """The running job that an interrupt should end."""

    ended = False


class Interrupt(KeyboardInterrupt):
    """Ctrl-C in :func:`interruptible`; if it is forgotten there, it comes again."""

    def __init__(self, work: _Work | None) -> None:
        super().__init__()
        self.work = work

    def __del__(self) -> None:
        if self.work is not None and not self.work.ended:
            _later(signal.SIGINT)


_work: _Work | None = None
"""The work under way."""


def interrupt(number: int, frame: FrameType | None) -> None:
    """Answers a signal as Python does, or later where an exception must not be raised.

    Raises:
        Interrupt: unless it is put off.
    """
    inner = frame
    while inner is not None:
        module = str(inner.f_globals.get("__name__")).partition(".")[0]
        if module == "llvmlite" or inner.f_code.co_name == _TYPE_IS_GONE:
            _later(number)
            return
        inner = inner.f_back
    raise Interrupt(_work)  # without a name for it, by which it would keep itself alive


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Answers Ctrl-C by :func:`interrupt`, unless another handler is installed.

    The one of :mod:`marouting.first` is ours.
    """
    global _work
    before, hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
    ours = threading.current_thread() is threading.main_thread()  # signals are not for others
    if not ours or before not in (signal.default_int_handler, leave):
        yield
        return

    def tell(lost: "sys.UnraisableHookArgs") -> None:
        if not issubclass(lost.exc_type, Interrupt):  # which comes again
            hook(lost)

    _work = work = _Work()
    sys.unraisablehook = tell
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        work.ended = True
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook
        _work = None


ENDING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]  # Windows has no SIGHUP
"""The signals by which people, batch queues and terminals end a job."""


class Held:
    """Signals that have come and are held back.

    Attributes:
        numbers: which, in their order.
        begun: whether there is anything that an interrupt would lose; until then none is held.
    """

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self.begun = False

    def leave(self) -> None:
        """Ends the process, with a signal's usual status, if one has come that is not Ctrl-C."""
        for number in self.numbers:
            if number != signal.SIGINT:
                raise SystemExit(128 + number)


@contextlib.contextmanager
def holding(*numbers: int, tell: Callable[[], object] = bool) -> Iterator[Held]:
    """Holds signals back, for the work to end well; a second one ends it at once.

    Args:
        *numbers: the signals. One with another handler than the usual one is somebody else's.
        tell: called when one is held back.
    """
    held = Held()
    usual = (signal.default_int_handler, interrupt, signal.SIG_DFL)

    def hold(number: int, frame: FrameType | None) -> None:
        if held.numbers or (number == signal.SIGINT and not held.begun):
            interrupt(signal.SIGINT, frame)
        else:
            held.numbers.append(number)
            if number == getattr(signal, "SIGHUP", None):
                _leave_terminal()
            tell()

    ours = threading.current_thread() is threading.main_thread()  # signals are not for others
    before = {number: signal.getsignal(number) for number in numbers if ours}
    before = {number: handler for number, handler in before.items() if handler in usual}
    for number in before:
        signal.signal(number, hold)
    try:
        yield held
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave_terminal() -> None:
    """Discards further output if it goes to a terminal: that is gone, and writing would fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for out in (1, 2):
        with contextlib.suppress(OSError):  # it is closed
            if stat.S_ISCHR(os.fstat(out).st_mode):
                os.dup2(nowhere, out)
    os.close(nowhere)


def _later(number: int) -> None:
    """Sends a signal to this process after a moment."""
    later = threading.Timer(AGAIN, _again, (number,))
    later.daemon = True
    later.start()


def _again(number: int) -> None:
    """Sends a signal to this process, where there is a way to the thread that may be asleep."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:  # Windows: os.kill would end the process
        signal.raise_signal(number)
