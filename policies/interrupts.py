"""Ctrl-C, put off while it would be lost.

LLVM calls back into Python where it loads and stores compiled code, and goes on with what the
callback should have set: an exception raised there is printed and forgotten, and the process may
end with a segmentation fault. Python itself prints and forgets an exception that is raised while a
weak reference tells that an object is gone; numba has such references to its types.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_TYPE_IS_GONE = "_on_type_disposal"
"""The function of numba that is told by weak references."""

AGAIN = 0.02
"""Seconds after which an interrupt that has been put off is tried again."""


def interrupt(number: int, frame: FrameType | None) -> None:
    """Answers a signal as Python does, or later if an exception would be lost in the frame.

    Raises:
        KeyboardInterrupt: unless it is put off.
    """
    inner = frame
    while inner is not None:
        module = str(inner.f_globals.get("__name__")).partition(".")[0]
        if module == "llvmlite" or inner.f_code.co_name == _TYPE_IS_GONE:
            later = threading.Timer(AGAIN, _again, (number,))
            later.daemon = True
            later.start()
            return
        inner = inner.f_back
    signal.default_int_handler(number, frame)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Answers Ctrl-C by :func:`interrupt`, unless somebody else answers or ignores it already."""
    usual = signal.default_int_handler
    ours = threading.current_thread() is threading.main_thread()  # signals are not for others
    if not ours or signal.getsignal(signal.SIGINT) is not usual:
        yield
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


def _again(number: int) -> None:
    """Sends a signal to this process, where there is a way to the thread that may be asleep."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:  # Windows: os.kill would end the process
        signal.raise_signal(number)
