"""Whose folder it is: one process at a time works in a folder, and only in one of its own."""

import contextlib
import os
import socket
from collections.abc import Collection, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from marouting import InputError
from marouting.files import TEMPORARY, is_dir, naming

LOCK = ".lock"
"""The file that a process at work in a folder holds; it says which process it is."""


@contextlib.contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """Keeps other processes out of a folder, which is made if it is missing.

    The lock ends with the process, even if it is killed. The temporary files that killed
    processes have left in the folder are removed.

    Raises:
        InputError: another process works there, or the folder cannot be written to.
    """
    path = folder / LOCK
    lock = FileLock(path, timeout=0)
    with naming(path, "cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire()
        except Timeout:
            holder = ""
            with contextlib.suppress(OSError):
                holder = path.read_text(encoding="utf-8", errors="replace")
            raise InputError(f"{folder}: in use by {holder or 'another process'}") from None
    try:
        with naming(path, "cannot be written"):
            path.write_text(f"process {os.getpid()} on {socket.gethostname()}", encoding="utf-8")
            for left in folder.rglob(f".*{TEMPORARY}"):
                left.unlink(missing_ok=True)
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: nobody can have taken it meanwhile
        lock.release()


def check_own(folder: Path, own: Collection[str]) -> None:
    """Raises InputError if a folder holds anything but these files, and what killed runs left."""
    if not is_dir(folder):
        return
    with naming(folder, "cannot be read"):
        names = sorted(path.name for path in folder.iterdir())
    for name in names:
        if name not in (*own, LOCK) and not name.endswith(TEMPORARY):
            raise InputError(f"{folder}: expected a new or an empty folder, found {name} in it")
