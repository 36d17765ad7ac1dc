"""Text files as lines of tokens, and errors that name the line."""

import contextlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import BinaryIO

from marouting import files
from marouting.errors import InputError
from marouting.problem.net import FieldError

NUMBER = "[+-]?[0-9]{1,18}"
"""Pattern of a number. Eighteen digits fit into 64 bits; a problem's own limits are far below."""

is_number = re.compile(NUMBER).fullmatch

is_decimal = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?").fullmatch
"""Whether a text is a decimal number. Python's float() takes more, such as ``1_0`` and digits of
other scripts."""


class Lines:
    """The lines of a text file as tokens; ``number`` is that last read, from 1."""

    def __init__(self, file: BinaryIO, errors: str = "strict") -> None:
        self.number = 0
        self._errors = errors
        self._readline = file.readline

    def text(self) -> str:
        """The tokens of the next line that has any, parted by blanks; "" at the end of the file."""
        # A file without line breaks must not be taken into memory as one line.
        while line := self._readline(files.LONGEST_LINE + 1):
            self.number += 1
            if len(line) > files.LONGEST_LINE:
                raise InputError(f"expected lines of at most {files.LONGEST_LINE} bytes")
            # Of bytes, so that only ASCII blanks part them, as in the contests' own programs.
            if tokens := b" ".join(line.split()):
                try:
                    return tokens.decode(errors=self._errors)
                except UnicodeDecodeError:
                    raise InputError("expected UTF-8 text") from None
        return ""

    def next(self) -> list[str]:
        """The tokens of the next line that has any; none at the end of the file."""
        text = self.text()
        return text.split(" ") if text else []


@dataclass(frozen=True)
class Record:
    """What was read from a file, and the line of each row of each field."""

    file: str
    lines: Mapping[str, Sequence[int]]

    def located(self, error: FieldError) -> InputError:
        """The error with the file and the line that its field and row came from."""
        return _at(self.file, self.lines[error.field][error.row], error)


@contextlib.contextmanager
def reading(path: str | os.PathLike[str], errors: str = "strict") -> Iterator[Lines]:
    """Yields the lines of a file; ``errors`` is for bytes that are not UTF-8."""
    with files.reading(path) as file:
        lines = Lines(file, errors)
        try:
            yield lines
        except InputError as error:
            raise _at(os.fspath(path), lines.number, error) from None


def unexpected(expected: str, tokens: list[str]) -> InputError:
    """The error for a line that is not what was expected; quotes the line, cut short."""
    if not tokens:
        return InputError(f"expected {expected}, found the end of the file")
    found = " ".join(tokens[:10])
    found = found if len(found) <= 60 else f"{found[:57]}..."
    return InputError(f"expected {expected}, found {found!r}")


def _at(file: str, line: int, error: InputError) -> InputError:
    return InputError(f"{file}:{max(1, line)}: {error}")
