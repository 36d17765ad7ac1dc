"""The score of a solution: the share of the way from sequential A* to the reference.

Solutions compare by **open nets**, then **overflow**, then **wirelength**, less is better. A* as in
the paper has the score 0, the reference (the proven optimum, or the best solution known) has 1. The
score keeps the order of solutions: a better one never scores less.

The **level at stake** of a problem is the first of the three in which A* and the reference differ.
Where a solution has both's values on the levels above it, its score is its share of the way on this
level. On the level of overflow (or open nets) the next level breaks ties: all of wirelength is
worth less than one track of overflow, all of overflow less than one open net. For wirelength w and
the reference's r this part of a track is

    ½ + ½ q((w − r) / (r / 20)),   q(x) = x / (1 + |x|),

so ½ at the reference and ⅔ at 2.5 % more wirelength. Outside of 0…1 the share is bent by q, so that
no single problem can outweigh many: a solution worse than A* on the level at stake has a score
between −1 and 0, and one better than a reference that is not proven between 1 and 2. A solution
that is worse than A* above the level at stake scores less than −1 for overflow and less than −2 for
open nets, never less than −3; one that is better scores more than 2 and 3, never more than 4.

Where A* equals the reference there is no room: what equals them scores 1, A* too. Whatever is worse
scores less than 0, for wirelength by twentieths of the reference's, bent by q.
"""

from typing import NamedTuple

from marouting.errors import InputError
from marouting.problem.solution import Evaluation

OVERFLOW, WIRELENGTH = 1, 2  # places in Figures

TIE = 20
"""In breaking ties, wirelength counts in parts of the reference's: a twentieth, 5 %."""


class Figures(NamedTuple):
    """What solutions compare by, in this order; less is better."""

    open: int
    overflow: int
    wirelength: int

    @classmethod
    def of(cls, found: Evaluation) -> "Figures":
        """The figures of a solution that has been judged."""
        return cls(len(found.disconnected), found.overflow, found.wirelength)


def score(found: Figures, astar: Figures, reference: Figures) -> float:
    """The score of a solution, from −3 to 4: 0 for A*, 1 for the reference.

    Args:
        found: the solution's figures.
        astar: those of sequential A* as in the paper, on the same problem.
        reference: those of the proven optimum, or of the best solution known.

    Raises:
        InputError: the reference is worse than A*.
    """
    if reference > astar:
        raise InputError(
            f"reference: expected one at least as good as A* {tuple(astar)}, "
            f"found {tuple(reference)}"
        )
    if found == reference:
        return 1.0
    differ = [level for level in range(3) if astar[level] != reference[level]]
    stake = differ[0] if differ else WIRELENGTH
    for level in range(stake):
        if found[level] != reference[level]:
            beyond = _place(found, reference, level) - reference[level]
            bend = WIRELENGTH - level + abs(_bent(beyond))
            return -bend if beyond > 0 else 1 + bend
    here = _place(found, reference, stake)
    best = _place(reference, reference, stake)
    if not differ:
        share = (best - here) / _twentieth(reference)
        return 1 + _bent(share) if share > 0 else _bent(share)
    worst = _place(astar, reference, stake)
    share = (worst - here) / (worst - best)
    if share < 0:
        return _bent(share)
    return share if share <= 1 else 1 + _bent(share - 1)


def _place(found: Figures, reference: Figures, level: int) -> float:
    """A place on a level, with the levels below it breaking ties by less than one unit."""
    if level == WIRELENGTH:
        return found.wirelength
    if level == OVERFLOW:
        beyond = (found.wirelength - reference.wirelength) / _twentieth(reference)
        return found.overflow + (1 + _bent(beyond)) / 2
    return found.open + _bent(_place(found, reference, OVERFLOW))


def _twentieth(reference: Figures) -> float:
    return max(reference.wirelength / TIE, 1.0)


def _bent(x: float) -> float:
    """Between −1 and 1, in the order of x."""
    return x / (1 + abs(x))
