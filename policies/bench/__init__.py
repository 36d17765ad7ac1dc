"""Speed, as ratios measured in one run: ``marouting bench``.

Every figure stands beside a comparator that ran in the same process at the same time, in turns with
it, because a figure alone says as much about the machine as about the code. Each is the median of
several repeats; the best is given too, since whatever else runs on a machine only makes it slower.
"""

import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any

import torch

from marouting import InputError
from policies.bench.environment import batch, interfaces, jumanji, large, observation, start
from policies.bench.libraries import libraries
from policies.bench.measure import Bench, Measurement
from policies.bench.search import search, time_scaling
from policies.bench.training import training
from policies.engines.base import processor

__all__ = ["SECTIONS", "Bench", "Measurement", "machine", "run"]

SECTIONS: Mapping[str, Callable[[Bench], Iterator[Measurement]]] = {
    "start": start,
    "batch": batch,
    "observation": observation,
    "interfaces": interfaces,
    "libraries": libraries,
    "large": large,
    "search": search,
    "training": training,
    "scaling": time_scaling,
    "jumanji": jumanji,
}
"""What can be measured, by name."""


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    packages = ("numpy", "numba", "torch", "pettingzoo", "gymnasium", "scipy")
    return {
        "date": time.strftime("%Y-%m-%d"),
        "processor": processor(),
        "cores": os.cpu_count(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in packages},
    }


def run(
    sections: Sequence[str], bench: Bench, watch: Callable[[str, Measurement | None], None]
) -> dict[str, Any]:
    """Measures some sections.

    Args:
        sections: names of :data:`SECTIONS`.
        bench: how to measure.
        watch: called with the name of a section as it starts, and with every row as it is there.

    Returns:
        The machine, the rows and their details, plain data.

    Raises:
        InputError: there is no such section.
    """
    rows = []
    for name in sections:
        if name not in SECTIONS:
            raise InputError(f"{name}: expected one of {', '.join(SECTIONS)}")
    for name in sections:
        watch(name, None)
        for row in SECTIONS[name](bench):
            rows.append({"section": name, **asdict(row)})
            watch(name, row)
    return {"machine": machine(), "repeats": bench.repeats, "rows": rows, **bench.details}
