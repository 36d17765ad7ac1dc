"""LEF and DEF files as words and statements."""

import contextlib
import os
import re
from collections.abc import Iterator
from typing import TextIO

from marouting.errors import InputError
from marouting.problem.ispd.lines import Lines, unexpected

ENCODING_ERRORS = "surrogateescape"  # for reading: comments may hold any bytes


class Copy:
    """A copy of statements for klayout, which keep their line numbers for its messages."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._line = 1

    def write(self, line: int, text: str) -> None:
        """Writes words in a line, or after what was written last if that stands further down."""
        try:
            self._file.write("\n" * (line - self._line) + text + " ")
        except UnicodeEncodeError:
            raise InputError("expected UTF-8 text outside of comments") from None
        self._line = max(line, self._line)


@contextlib.contextmanager
def copying(path: str | os.PathLike[str]) -> Iterator[Copy]:
    """Opens a file for a copy."""
    with open(path, "w", encoding="utf-8") as file:  # noqa: PTH123
        yield Copy(file)


class Statements:
    """The words of a file, without comments; ``copy`` gets the words of every line, once read.

    A text in quotes is one word. A semicolon or a parenthesis is a word of its own, also where no
    blank separates it from its neighbour.
    """

    def __init__(self, lines: Lines, copy: Copy | None = None) -> None:
        self._lines = lines
        self._copy = copy
        self._words: list[str] = []  # of the line last read that has any
        self._begun = 0  # where that line begins
        self._at = 0  # the next one

    @property
    def line(self) -> int:
        """The line last read, from 1."""
        return self._lines.number

    def word(self) -> str:
        """The next word; empty at the end of the file."""
        word = self.peek()
        self._at += 1
        return word

    def keyword(self) -> str:
        """The next word in capitals, also in the copy: keywords may be in any case."""
        word = self.peek().upper()
        if word:
            self._words[self._at] = word
        self._at += 1
        return word

    def peek(self) -> str:
        """The next word, which stays the next one."""
        if self._at >= len(self._words):
            self._fill()
        return self._words[self._at] if self._words else ""

    def rest(self) -> list[str]:
        """The words up to the next ``;``, which is passed over."""
        found: list[str] = []
        while self.peek():
            try:
                end = self._words.index(";", self._at)
            except ValueError:
                end = len(self._words)
            found += self._words[self._at : end]
            if len(found) > _MOST_WORDS:
                raise InputError(f"expected statements of at most {_MOST_WORDS} words")
            self._at = end + 1
            if end < len(self._words):
                return found
        raise InputError("file ends inside a statement, expected ';'")

    def expect(self, what: str) -> None:
        """Passes over one word; raises InputError if it is another one."""
        if (word := self.word()) != what:
            raise unexpected(f"'{what}'", [word] if word else [])

    def skip_to(self, *end: str) -> None:
        """Passes over everything up to and with these words in a row, the first a keyword."""
        begun = self.line
        matched = 0
        while matched < len(end):
            word = self.word()
            if not word:
                raise InputError(
                    f"file ends, expected '{' '.join(end)}' for what begins in line {begun}"
                )
            if word == end[matched] or (word.upper() == end[matched] and word.isalpha()):
                matched += 1
            else:
                matched = int(word.upper() == end[0])

    def _fill(self) -> None:
        """Takes the words of the next line that has any; none at the end of the file."""
        if self._words and self._copy is not None:
            self._copy.write(self._begun, " ".join(self._words))
        self._words, self._at = [], 0
        while not self._words and (text := self._lines.text()):
            self._begun = self.line
            text = text.removeprefix(_BOM).lstrip(" ")  # of a file that was joined to others
            if _unusual(text):
                self._words = self._parted(text.split(" "))
            elif text:
                self._words = text.split(" ")

    def _parted(self, tokens: list[str]) -> list[str]:
        """The words of a line with a comment, quotes, or words that no blanks part."""
        words: list[str] = []
        at = 0
        while at < len(tokens):
            token = tokens[at]
            at += 1
            if token[0] == "#":
                break
            if token[0] == '"':
                text, tokens = self._quoted(tokens[at - 1 :])
                at = 0
                words.append(text)
            elif len(token) > 1 and (";" in token or "(" in token or ")" in token):
                parts = _parts(token)
                glued = next((i for i, part in enumerate(parts) if part[0] == "#"), None)
                words += parts[:glued]
                if glued is not None:
                    break
            else:
                words.append(token)
        return words

    def _quoted(self, tokens: list[str]) -> tuple[str, list[str]]:
        """A text in quotes, with blanks for line ends, and the tokens after it in its line."""
        begun = self.line
        text: list[str] = []
        skipped = 1  # the quote at the beginning
        while tokens:
            for at, token in enumerate(tokens):
                end = token.find('"', skipped)
                skipped = 0
                if end >= 0:
                    glued = [token[end + 1 :]] if token[end + 1 :] else []
                    return " ".join([*text, token[: end + 1]]), glued + tokens[at + 1 :]
                text.append(token)
            tokens = self._lines.next()
        raise InputError(f"file ends inside a text in quotes, which begins in line {begun}")


_unusual = re.compile('[;()"#](?:(?<=[^ ][;()])|(?<=[;()])(?=[^ ])|(?<=^["#])|(?<= ["#]))').search
"""Whether a line has a comment, a quote, or a word with a semicolon or a parenthesis.

Regular expressions that begin with a set of characters are the fastest."""

_BOM = "\ufeff"
_MOST_WORDS = 2**22

MOST_CUTS = 10**6  # the most cuts of a via made by rule, and vias of an array: each becomes a shape


def _parts(token: str) -> list[str]:
    """The words of a token with semicolons or parentheses in it.

    Parentheses may be part of a name, such as that of a bus's bit: ``a(3)``.
    """
    words: list[str] = []
    for word in token.replace(";", " ; ").replace(")(", ") (").replace(")+", ") + ").split():
        name = word.lstrip("(")
        closing = min(len(name) - len(name.rstrip(")")), max(0, name.count(")") - name.count("(")))
        words += "(" * (len(word) - len(name))
        words += [name[: len(name) - closing]] if len(name) > closing else []
        words += ")" * closing
    return words


_number = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,9})?").fullmatch


def number(word: str, what: str) -> float:
    """A word as a number; raises InputError for another word."""
    if not _number(word):
        raise unexpected(f"{what}, a number", [word])
    value = float(word)
    if not abs(value) <= LARGEST:
        raise unexpected(f"{what}, a number from -{LARGEST:g} to {LARGEST:g}", [word])
    return value


LARGEST = 1e9  # the largest number accepted; in a DEF's units the side of a wafer is below it


def whole(word: str, what: str, least: int = -(10**9)) -> int:
    """A word as a whole number of at least ``least``; raises InputError for another word."""
    value = number(word, what)
    if value != int(value) or value < least:
        raise unexpected(f"{what}, a whole number from {least}", [word])
    return int(value)
