"""Files are written whole or not at all, and read within bounds.

Errors of reading and writing become one-line messages.
"""

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from marouting.errors import InputError

LONGEST_LINE = 2**20
"""The most bytes in a line of a file that is read line by line."""


@contextlib.contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Opens a file or a pipe, such as ``/dev/stdin``, for reading.

    Raises:
        InputError: it cannot be read, or it is a device, which may never end.
    """
    try:
        if stat.S_ISCHR(mode := os.stat(path).st_mode) or stat.S_ISBLK(mode):  # noqa: PTH116
            raise InputError(f"{os.fspath(path)}: expected a file, found a device")
        with open(path, "rb") as file:  # noqa: PTH123 (PathLike without Path)
            yield file
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None


def read_text(path: str | os.PathLike[str], most: int) -> str:
    """The UTF-8 text in a file.

    Args:
        path: the file.
        most: the largest size accepted, in bytes.

    Raises:
        InputError: it cannot be read, is larger, or is not UTF-8 text.
    """
    with reading(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise InputError(f"{os.fspath(path)}: expected at most {most / 2**20:g} MiB")
    try:
        return content.decode()
    except UnicodeDecodeError:
        raise InputError(f"{os.fspath(path)}: expected UTF-8 text") from None


@contextlib.contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path beside ``path`` and renames it to ``path`` if the block succeeds.

    A symbolic link stays one: the file that it leads to is written. Readers see the old file or the
    new one, never half a file, even if the process is killed.

    Args:
        path: the file to write; its folder is made if it is missing.

    Yields:
        The temporary file to write into.

    Raises:
        InputError: the folder cannot be made or written to, or ``path`` is a folder, a device or
            something else that is not a file.
    """
    target = Path(path)
    try:
        if target.is_symlink():
            target = target.resolve()
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        if target.exists() and not target.is_file():
            raise OSError(0, "it is not a file")
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        os.close(handle)
    except OSError as error:
        raise unusable(target, "cannot be written", error) from None
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp's file is private to its owner; the result has the permissions of the file that
        # it replaces, or the usual ones.
        umask = os.umask(0)
        os.umask(umask)
        mode = target.stat().st_mode & 0o7777 if target.exists() else 0o666 & ~umask
        temporary.chmod(mode)
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(target)
    except OSError as error:
        raise unusable(target, "cannot be written", error) from None
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raises InputError if ``path`` cannot be written; call it before the work, not after it."""

    class Checked(Exception):
        """Leaves :func:`writing` without a file."""

    with contextlib.suppress(Checked), writing(path):
        raise Checked


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes ``text`` to ``path`` as UTF-8, whole or not at all; raises InputError if it cannot."""
    with writing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def unusable(path: str | os.PathLike[str], what: str, error: OSError) -> InputError:
    """The InputError for an operating system's error about ``path``."""
    return InputError(f"{os.fspath(path)}: {what}: {error.strerror or error}")
