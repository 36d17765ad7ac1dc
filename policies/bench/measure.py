"""How speed is measured: repeats in turns with a comparator, medians, ratios."""

import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import torch

from marouting.config import check
from policies.engines import processor


@dataclass(frozen=True)
class Measurement:
    """A figure and what it was compared with.

    Attributes:
        name: what was measured.
        value: the median of the repeats.
        best: the best of them.
        unit: of both.
        threads: that did it.
        comparator: what ran in turns with it; empty: nothing comparable.
        against: the comparator's median, in the same unit.
        ratio: how many times as fast, or as small, as the comparator.
    """

    name: str
    value: float
    best: float
    unit: str
    threads: int = 1
    comparator: str = ""
    against: float | None = None
    ratio: float | None = None


def machine() -> dict[str, Any]:
    """What the figures were measured on; of packages that are not installed None."""
    packages = ["numpy", "numba", "numba-cuda", "torch", "pettingzoo", "gymnasium", "scipy"]
    packages += ["jax", "jumanji"]
    found: dict[str, str | None] = {}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return {
        "date": time.strftime("%Y-%m-%d"),
        "processor": processor(),
        "cores": os.cpu_count(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "python": platform.python_version(),
        **found,
    }


Work = Callable[[], float]
"""Does some work and returns how much: so many steps, problems, bytes."""


def rate(work: Work) -> float:
    """Work a second."""
    started = time.perf_counter()
    done = work()
    return done / (time.perf_counter() - started)


@dataclass(frozen=True)
class Bench:
    """How to measure.

    Attributes:
        repeats: of every measurement.
        threads: of the measurements with several.
    """

    repeats: int = 7
    threads: int = 2

    def __post_init__(self) -> None:
        check("repeats", self.repeats >= 1, "a number from 1")
        check("threads", self.threads >= 1, "a number from 1")

    def rates(self, *works: Work) -> list[list[float]]:
        """The rates of pieces of work, done in turns after a first time that is not kept."""
        for work in works:
            work()
        turns = [[rate(work) for work in works] for _ in range(self.repeats)]
        return [list(column) for column in zip(*turns, strict=True)]

    def versus(
        self,
        name: str,
        unit: str,
        work: Work,
        comparator: str = "",
        other: Work | None = None,
        *,
        threads: int = 1,
    ) -> Measurement:
        """A row of work against other work, or of work alone."""
        measured = self.rates(work, *([] if other is None else [other]))
        mine = statistics.median(measured[0])
        theirs = None if other is None else statistics.median(measured[1])
        return Measurement(
            name,
            mine,
            max(measured[0]),
            unit,
            threads,
            comparator,
            theirs,
            None if theirs is None else mine / theirs,
        )
