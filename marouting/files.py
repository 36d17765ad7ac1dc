"""Files are written whole or not at all, and read within bounds, compressed by gzip or not.

Errors of reading and writing become one-line messages.
"""

import contextlib
import gzip
import io
import os
import re
import stat
import tempfile
import zlib
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from marouting.errors import InputError

TEMPORARY = ".marouting-tmp"
"""How the names of temporary files end, so that what a killed process left can be told."""

LONGEST_LINE = 2**20  # the most bytes in a line of a file that is read line by line


_GZIP = b"\x1f\x8b"  # what data compressed by gzip begin with


@contextlib.contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Opens a text file or a pipe, such as ``/dev/stdin``, for reading.

    What gzip has compressed is read as if it were not, whatever the file is called; a byte order
    mark of UTF-8 is passed over.
    """
    try:
        try:
            mode = os.stat(path).st_mode  # noqa: PTH116 (PathLike without Path)
        except ValueError as error:
            raise OSError(0, str(error)) from None  # no path at all
        if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
            raise InputError(f"{os.fspath(path)}: expected a file, found a device")
        with open(path, "rb") as file:  # noqa: PTH123 (PathLike without Path)
            text: io.BufferedIOBase = file
            head = text.read(len(BOM_UTF8))
            if head.startswith(_GZIP):
                text = gzip.GzipFile(fileobj=_rejoined(head, text))
                head = text.read(len(BOM_UTF8))
            if head.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
                raise InputError(f"{os.fspath(path)}: expected UTF-8 text, found UTF-16")
            yield _rejoined(head.removeprefix(BOM_UTF8), text)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{os.fspath(path)}: expected gzip data: {reason}") from None
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None


class _Rejoined(io.RawIOBase):
    """A stream from its beginning: what was read of it already, and the rest."""

    def __init__(self, head: bytes, rest: io.BufferedIOBase) -> None:
        self._head, self._rest = head, rest

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        # A pipe cannot go back to its beginning, and need not have much to peek at.
        part = self._head[: len(buffer)] or self._rest.read1(len(buffer))
        self._head = self._head[len(part) :]
        buffer[: len(part)] = part
        return len(part)


def _rejoined(head: bytes, rest: io.BufferedIOBase) -> io.BufferedReader:
    return io.BufferedReader(_Rejoined(head, rest), 2**17)


def suffix_of(path: str | os.PathLike[str]) -> str:
    """The suffix of a name in small letters: ``.def`` of ``CHIP.DEF`` and of ``chip.def.gz``."""
    return Path(plain_name(path)).suffix.lower()


def stem_of(path: str | os.PathLike[str]) -> str:
    """The name of a file without its suffix: ``chip`` of ``chip.def`` and ``chip.def.gz``."""
    return Path(plain_name(path)).stem


def plain_name(path: str | os.PathLike[str]) -> str:
    """The name of a file without the ``.gz`` at its end, if it has one."""
    name = Path(path).name
    return name[: -len(".gz")] if is_zipped(path) else name


def is_zipped(path: str | os.PathLike[str]) -> bool:
    """Whether a file's name ends with ``.gz``."""
    return Path(path).suffix.lower() == ".gz"


def beside(path: str | os.PathLike[str], suffix: str) -> Path:
    """The file with a path's name but this suffix, also in capitals or with ``.gz`` after it."""
    folder, stem = Path(path).parent, stem_of(path)
    plain = folder / f"{stem}{suffix}"
    if not plain.exists():
        with contextlib.suppress(OSError):
            for file in sorted(folder.iterdir()):
                if (stem_of(file), suffix_of(file)) == (stem, suffix):
                    return file
    return plain


def read_text(path: str | os.PathLike[str], most: int) -> str:
    """The UTF-8 text in a file of at most so many bytes; raises InputError for any other."""
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

    Yields:
        The temporary file to write into.
    """
    target = Path(path)
    try:
        if "\0" in str(target):
            raise OSError(0, "it is not a path")
        if target.is_symlink():
            target = Path(os.path.realpath(target))
            if target.is_symlink():
                raise OSError(0, "its symbolic links form a circle")
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        if target.exists() and not target.is_file():
            raise OSError(0, "it is not a file")
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=".", suffix=TEMPORARY)
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


FILE_NAME = f"a name for files: not empty or too long, no dot at its start, no {os.sep} or controls"
"""What :func:`is_file_name` asks for, as error messages say it."""

_LONGEST = 255  # bytes in a file's name; no common file system takes more
_UNFIT = re.compile(rf"[/{re.escape(os.sep)}\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
"""What parts folders, controls terminals, breaks lines, or is no character in UTF-8."""


def is_file_name(name: str, suffix: str = "") -> bool:
    """Whether a file can have a name: it stays in its folder and is none of our hidden files."""
    if not name or name.startswith(".") or _UNFIT.search(name):
        return False
    return len((name + suffix).encode()) <= _LONGEST


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raises InputError if ``path`` cannot be written; call it before the work, not after it."""

    class Checked(Exception):
        """Leaves :func:`writing` without a file."""

    with contextlib.suppress(Checked), writing(path):
        raise Checked


def check_apart(out: str | os.PathLike[str], *read: str | os.PathLike[str]) -> None:
    """Raises InputError if a file to be written is one of those that are read."""

    def same(path: str | os.PathLike[str]) -> bool:
        # A path by a folder that does not exist yet leads nowhere until the folder is made.
        named = os.path.realpath(path) == os.path.realpath(out)
        return exists(path) and (named or (exists(out) and Path(path).samefile(out)))

    if any(map(same, read)):
        raise InputError(f"{os.fspath(out)}: expected another file: this one is read")


_ONLY_READ = (".def", ".lef", ".cap", ".net", ".segs")


def check_suffix(path: str | os.PathLike[str]) -> None:
    """Raises InputError for the suffix of a format that is only read."""
    if (suffix := suffix_of(path)) in _ONLY_READ:
        raise InputError(f"{os.fspath(path)}: expected another suffix: {suffix} is not written")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes ``text`` to ``path`` as UTF-8, whole or not at all; raises InputError if it cannot.

    A name that ends with ``.gz`` gets it compressed; equal texts give equal files.
    """
    content = text.encode()
    if is_zipped(path):
        content = gzip.compress(content, mtime=0)
    with writing(path) as temporary:
        temporary.write_bytes(content)


def exists(path: str | os.PathLike[str]) -> bool:
    """Whether there is something at a path; no where none can be, as :mod:`os.path` answers."""
    return os.path.exists(path)  # noqa: PTH110 (that of Path raises errors for names too long)


def is_file(path: str | os.PathLike[str]) -> bool:
    """Whether there is a file at a path; no where none can be."""
    return os.path.isfile(path)  # noqa: PTH113


def is_dir(path: str | os.PathLike[str]) -> bool:
    """Whether there is a folder at a path; no where none can be."""
    return os.path.isdir(path)  # noqa: PTH112


@contextlib.contextmanager
def naming(path: str | os.PathLike[str], what: str) -> Iterator[None]:
    """Turns an operating system's error into an InputError about ``path``."""
    try:
        yield
    except InputError:
        raise
    except (OSError, ValueError) as error:  # of no path at all
        raise unusable(path, what, error) from None


def unusable(path: str | os.PathLike[str], what: str, error: OSError | ValueError) -> InputError:
    """The InputError for an operating system's error about ``path``."""
    return InputError(f"{os.fspath(path)}: {what}: {getattr(error, 'strerror', None) or error}")
