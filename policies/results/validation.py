"""How good a network is on a set of problems: means over them, and how far from the reference."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from policies.results.statistics import gap


@dataclass(frozen=True)
class Validation:
    """Means over problems.

    Attributes:
        problems: the number of problems.
        connected: those in which every task is connected.
        overflow: mean overflow, in tracks.
        wirelength: mean wirelength, in edges, of the routes as they are.
        gap: mean wirelength above the reference in %, over the problems with its overflow and no
            open task; None if there is none.
        compared: the number of these problems.
    """

    problems: int
    connected: int
    overflow: float
    wirelength: float
    gap: float | None
    compared: int

    @staticmethod
    def of(
        rows: Iterable[Mapping[str, Any]], reference: Mapping[str, tuple[int, int]]
    ) -> "Validation":
        """The means of some rows, one for each problem.

        Args:
            rows: each with ``problem``, ``joined``, ``tasks``, ``overflow`` and ``wirelength``.
            reference: overflow and wirelength of the best known solution by the problem's name.
        """
        rows = list(rows)
        gaps = [
            gap((row["tasks"] - row["joined"], row["overflow"], row["wirelength"]), (0, *best))
            for row in rows
            if (best := reference.get(row["problem"])) is not None
        ]
        known = [one for one in gaps if one is not None]
        return Validation(
            problems=len(rows),
            connected=sum(row["joined"] == row["tasks"] for row in rows),
            overflow=sum(row["overflow"] for row in rows) / len(rows),
            wirelength=sum(row["wirelength"] for row in rows) / len(rows),
            gap=sum(known) / len(known) if known else None,
            compared=len(known),
        )

    def __str__(self) -> str:
        """In one line."""
        text = (
            f"{self.connected} of {self.problems} problems connected, overflow {self.overflow:.2f},"
            f" wirelength {self.wirelength:.1f}"
        )
        if self.gap is None:
            return text
        return f"{text}, {self.gap:.2f} % above the reference on {self.compared}"
