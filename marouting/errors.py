"""The one exception for input that cannot be used, and the hint for a name that is misspelt."""

import difflib
from collections.abc import Iterable

LONGEST = 500  # the most characters of a message. Of a longer one, the middle is left out.


class InputError(ValueError):
    """A file, configuration, checkpoint or argument that cannot be used.

    The message is a single line that names the file, line or key and says what
    was expected. The command line prints it as it is and exits with status 2.

    Args:
        message: may quote anything. Line breaks become spaces, and what is not printable, which
            may control a terminal, becomes an escape sequence.
    """

    def __init__(self, message: str) -> None:
        line = printable(message.replace("\n", " "))
        if len(line) > LONGEST:
            line = f"{line[: LONGEST - 103]} … {line[-100:]}"
        super().__init__(line)


def printable(text: str) -> str:
    """A text in one line, with escape sequences for what is not printable."""
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in text)


class UnknownOption(InputError, TypeError):
    """A keyword argument that an environment does not have.

    It is also a TypeError, as Python raises, and is worded as Python words it: some libraries
    offer options of their own to every environment, and withdraw those that it refuses in this way.
    """


RENAMED = {
    "evolved": "pathfinder with schedule=tuned",
    "heuristic": "greedy",
    "learned": "generalist",
    "regions": "pathfinder with threads=2",
}
"""Former names of routers, and what takes their place."""


def nearest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """A hint for an unknown name: its new name or the most similar known one; may be empty."""
    known = list(known)
    new = RENAMED.get(name, "")
    if new.partition(" ")[0] in known:
        return f"it is now {new}; "
    close = difflib.get_close_matches(name, known, n=1, cutoff=cutoff)
    return f"did you mean {close[0]}? " if close else ""
