"""What all test processes have in common."""

import os
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

# Test processes run side by side: threads of one would be in the way of the others. Libraries read
# this when they are first imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Experiments and benchmarks work in this process: others take seconds to start."""
    monkeypatch.setattr("policies.experiment.experiment.work_on", in_this_process)


def in_this_process(parts: Sequence[Any], *_: Any) -> Iterator[list[Any]]:
    """In the place of :func:`policies.experiment.part.work_on`."""
    for part in parts:
        part.work()
        yield [part]
