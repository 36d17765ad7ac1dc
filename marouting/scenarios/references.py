"""What is known about the best solutions of a scenario's problems, read from the package.

``python -m policies.experiment.references`` computes and writes these files, one per scenario.
"""

import functools
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from marouting.config import build_json
from marouting.errors import InputError
from marouting.files import read_text

FOLDER = Path(__file__).parent / "data"  # where the files are
MOST_BYTES = 2**24  # the largest file that is read


class Reference(NamedTuple):
    """The best known score of a problem."""

    overflow: int
    wirelength: int
    proven: bool  # whether no solution is better


@dataclass(frozen=True, kw_only=True)
class Best:
    """What is known about the best solution of a problem.

    Attributes:
        problem: the name of the problem in its scenario, for readers.
        overflow: overflow of the best solution known, in tracks.
        wirelength: its wirelength, in edges.
        bound_overflow: no solution has less overflow.
        bound_wirelength: no solution with ``bound_overflow`` has less wirelength.
        how: the routers that found the solution and the bound.
        seconds: the time that they took, in all.
    """

    problem: str
    overflow: int
    wirelength: int
    bound_overflow: int
    bound_wirelength: int
    how: str
    seconds: float

    def __post_init__(self) -> None:
        found = self.overflow, self.wirelength
        if not (0, 0) <= self.bound <= found or min(*found, *self.bound, self.seconds) < 0:
            raise InputError(f"expected numbers from 0 and a bound of at most {found}")

    @property
    def bound(self) -> tuple[int, int]:
        """No solution has a lower score (overflow, then wirelength)."""
        return self.bound_overflow, self.bound_wirelength

    @property
    def proven(self) -> bool:
        """Whether the solution is proven to be optimal."""
        return self.bound == (self.overflow, self.wirelength)


@dataclass(frozen=True, kw_only=True)
class References:
    """The content of a file.

    Attributes:
        references: by the digest of the problem.
        heuristic: the cost of the best local rule on each split, for the scenarios of policies;
            ``python -m policies.experiment.anarchy`` writes it.
    """

    references: dict[str, Best]
    heuristic: dict[str, float] = field(default_factory=dict)


def path_of(scenario: str) -> Path:
    """The file with the references of a scenario."""
    return FOLDER / f"{scenario}.json"


def read_references(path: Path) -> References:
    """The references in a file, if there is one; raises InputError."""
    if not path.exists():
        return References(references={})
    return build_json(References, read_text(path, MOST_BYTES), str(path))


@functools.cache
def references_in(path: Path) -> References:
    """:func:`read_references`, once for each file."""
    return read_references(path)
