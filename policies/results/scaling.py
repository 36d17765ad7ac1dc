"""How time grows with routed edges: curves and exponents of the rows that a benchmark stores.

A row has at least ``family`` (of problems), ``work`` (what was done), ``edges`` (routed edges) and
``seconds``; see :class:`policies.bench.scaling.Timing`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
    """The exponent of one curve, (2, sizes) edges and seconds."""
    edges, seconds = np.log(points)
    return float(np.polyfit(edges, seconds, 1)[0])
