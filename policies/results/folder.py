"""Whose folder it is: one process at a time works in a folder, and only in one of its own."""

import contextlib
import os
import re
import socket
from collections.abc import Collection, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from marouting import InputError
from marouting.files import unusable

LOCK = ".lock"
"""The file that a process at work in a folder holds; it says which process it is."""

_TEMPORARY = r"\.{}\.[a-z0-9_]{{8}}"
"""What :func:`marouting.files.writing` calls its temporary files."""


@contextlib.contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """Keeps other processes out of a folder, which is made if it is missing.

    The lock goes with the process, even one that is killed.

    Raises:
        InputError: another process works there, or the folder cannot be written to.
    """
    path = folder / LOCK
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, timeout=0)
        lock.acquire()
    except Timeout:
        with contextlib.suppress(OSError):
            holder = path.read_text(encoding="utf-8", errors="replace")
            raise InputError(f"{folder}: {holder or 'another process'} works there") from None
        raise InputError(f"{folder}: another process works there") from None
    except OSError as error:
        raise unusable(path, "cannot be written", error) from None
    try:
        path.write_text(f"process {os.getpid()} on {socket.gethostname()}", encoding="utf-8")
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: nobody can have taken it meanwhile
        lock.release()


def check_own(folder: Path, own: Collection[str]) -> None:
    """Raises InputError if a folder holds anything but these files, and what killed runs left."""
    if not folder.is_dir():
        return
    ours = {*own, LOCK}
    for name in sorted(path.name for path in folder.iterdir()):
        if name not in ours and not any(_is_temporary(name, of) for of in own):
            raise InputError(f"{folder}: expected a new or an empty folder, found {name} in it")


def remove_temporary(folder: Path, own: Collection[str]) -> None:
    """Removes what killed processes left behind when they wrote these files of a folder."""
    for path in folder.glob(".*"):
        if any(_is_temporary(path.name, of) for of in own):
            path.unlink(missing_ok=True)


def _is_temporary(name: str, of: str) -> bool:
    return re.fullmatch(_TEMPORARY.format(re.escape(of)), name) is not None
