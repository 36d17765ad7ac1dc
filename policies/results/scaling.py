"""How time grows with routed edges: curves and exponents of the rows that a benchmark stores.

The rows are those of :class:`policies.bench.scaling.Timing`, or have at least the columns of
:class:`TimingRow`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from marouting.config import Meets, between, build_json
from marouting.files import read_text
from policies.results.rows import LARGEST, MOST_BYTES, Count

Text = Annotated[str, Meets(lambda text: 0 < len(text) <= 200, "a text of 1 to 200 characters")]


class TimingRow(TypedDict):
    """How long some work took on a problem of a family, with as many routed edges."""

    family: Text
    work: Text
    edges: Annotated[Count, between(1, LARGEST)]
    seconds: Annotated[float, between(1e-12, LARGEST)]


class Machine(TypedDict):
    """What the rows were measured on."""

    date: Text


class ScalingReport(TypedDict):
    """What ``marouting bench scaling --out`` stores, as far as it is drawn."""

    machine: Machine
    scaling: Annotated[list[TimingRow], Meets(len, "at least one row")]


def read_scaling(bench: Path) -> ScalingReport:
    """Reads what ``marouting bench scaling --out`` stored; raises InputError naming the key."""
    where = f"{bench}: expected what marouting bench --out stores, with the section scaling"
    return build_json(ScalingReport, read_text(bench, MOST_BYTES), where)


def curves(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, NDArray[np.float64]]]:
    """By family and work, (2, sizes) float64 edges and seconds, edges ascending."""
    points: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for row in rows:
        family = points.setdefault(row["family"], {})
        family.setdefault(row["work"], []).append((row["edges"], row["seconds"]))
    return {
        family: {work: np.array(sorted(found), np.float64).T for work, found in works.items()}
        for family, works in points.items()
    }


def exponents(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """By family and work, the p with which time grows as edges to the power of p.

    It is the slope of a line through the logarithms of both, by least squares.
    """
    return {
        family: {work: exponent(points) for work, points in works.items()}
        for family, works in curves(rows).items()
    }


def exponent(points: NDArray[np.float64]) -> float:
    """The exponent of one curve, (2, sizes) edges and seconds; NaN unless the edges differ."""
    edges, seconds = np.log(points)
    if np.ptp(edges) == 0:
        return float("nan")
    return float(np.polyfit(edges, seconds, 1)[0])
