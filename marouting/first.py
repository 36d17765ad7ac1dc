"""The first thing that ``import marouting`` does where that is the command ``marouting``.

What the command imports takes seconds. Ctrl-C would end them with Python's traceback, or be lost in
one of the libraries. There is nothing to finish yet, so the process ends at once, as the command
does later on: with a line and the status 130. In other programs nothing is changed.
"""

import gc
import os
import signal
import sys
import threading
from types import FrameType


def leave(number: int, frame: FrameType | None) -> None:
    """Ends the process."""
    del number, frame
    os.write(2, b"marouting: interrupted\n")
    os._exit(130)


def _is_the_command() -> bool:
    """Whether this process is the script ``marouting`` or ``python -m marouting``."""
    given = sys.orig_argv
    if sys.argv[:1] == ["-m"]:  # as long as Python looks for the module
        return "-mmarouting" in given or given[given.index("-m") + 1 :][:1] == ["marouting"]
    script = os.path.basename(sys.argv[0]) if sys.argv else ""  # noqa: PTH119 (pathlib takes time)
    child = "--multiprocessing-fork" in given
    return script.partition(".")[0] == "marouting" and not child


IS_THE_COMMAND = _is_the_command()

if (
    IS_THE_COMMAND
    and threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, leave)

if IS_THE_COMMAND:
    gc.set_threshold(200_000, 20, 100)  # looking for garbage takes a tenth of a command's time
