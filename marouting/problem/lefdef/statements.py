"""LEF and DEF files as words and statements."""

from marouting.errors import InputError
from marouting.problem.ispd.lines import Lines, unexpected


class Statements:
    """The words of a file, without comments; a text in quotes is one word.

    Args:
        lines: the file.
    """

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._words: list[str] = []

    @property
    def line(self) -> int:
        """The line last read, from 1."""
        return self._lines.number

    def word(self) -> str:
        """The next word; empty at the end of the file."""
        if not self._words:
            self._fill()
        return self._words.pop() if self._words else ""

    def peek(self) -> str:
        """The next word, which stays the next one."""
        if not self._words:
            self._fill()
        return self._words[-1] if self._words else ""

    def rest(self) -> list[str]:
        """The words up to the next ``;``, which is passed over."""
        found: list[str] = []
        while (word := self.word()) != ";":
            if not word:
                raise InputError("file ends inside a statement, expected ';'")
            if len(found) == _MOST_WORDS:
                raise InputError(f"expected statements of at most {_MOST_WORDS} words")
            found.append(word)
        return found

    def expect(self, what: str) -> None:
        """Passes over one word; raises InputError if it is another one."""
        if (word := self.word()) != what:
            raise unexpected(f"'{what}'", [word] if word else [])

    def skip_to(self, *end: str) -> None:
        """Passes over everything up to and with these words in a row."""
        begun = self.line
        matched = 0
        while matched < len(end):
            word = self.word()
            if not word:
                raise InputError(
                    f"file ends, expected '{' '.join(end)}' for what begins in line {begun}"
                )
            matched = matched + 1 if word == end[matched] else int(word == end[0])

    def _fill(self) -> None:
        """Takes the words of the next line that has any, last word first."""
        while tokens := self._lines.next():
            words: list[str] = []
            at = 0
            while at < len(tokens):
                token = tokens[at]
                at += 1
                if token.startswith("#"):
                    break
                if token.startswith('"') and (len(token) == 1 or not token.endswith('"')):
                    tokens, at = self._quoted(tokens[at:]), 0
                words.append(token)
            if words:
                words.reverse()
                self._words = words
                return

    def _quoted(self, tokens: list[str]) -> list[str]:
        """Passes over the rest of a text in quotes; returns what follows in its last line."""
        begun = self.line
        while True:
            for at, token in enumerate(tokens):
                if token.endswith('"'):
                    return tokens[at + 1 :]
            tokens = self._lines.next()
            if not tokens:
                raise InputError(f"file ends inside a text in quotes, which begins in line {begun}")


_MOST_WORDS = 2**22


def number(word: str, what: str) -> float:
    """A word as a number; raises InputError for another word."""
    try:
        value = float(word)
    except ValueError:
        raise unexpected(f"{what}, a number", [word]) from None
    if not abs(value) <= LARGEST:
        raise unexpected(f"{what}, a number from -{LARGEST:g} to {LARGEST:g}", [word])
    return value


LARGEST = 1e9
"""The largest number accepted; in a DEF's units the side of a wafer is below it."""


def whole(word: str, what: str, least: int = -(10**9)) -> int:
    """A word as a whole number of at least ``least``; raises InputError for another word."""
    value = number(word, what)
    if value != int(value) or value < least:
        raise unexpected(f"{what}, a whole number from {least}", [word])
    return int(value)
