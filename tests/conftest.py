"""What all test processes have in common."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

# Test processes run side by side: threads of one would be in the way of the others. Libraries read
# this when they are first imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Before test processes start: compiles what they share, if all tests are to run."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if not whole or hasattr(config, "workerinput") or not config.getoption("numprocesses", 0):
        return
    print("compiling what the tests share, once per version: about 90 s", file=sys.stderr)
    command = [sys.executable, str(Path(__file__).with_name("warm_up.py"))]
    parts = [subprocess.Popen([*command, part]) for part in ("games", "routers")]
    for part in parts:
        part.wait()  # should one fail, the tests compile the rest, and say what is wrong


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Experiments and benchmarks work in this process: others take seconds to start."""
    monkeypatch.setattr("policies.experiment.experiment.work_on", in_this_process)


def in_this_process(parts: Sequence[Any], *_: Any) -> Iterator[list[Any]]:
    """In the place of :func:`policies.experiment.part.work_on`."""
    for part in parts:
        part.work()
        yield [part]


@pytest.fixture(autouse=True)
def _no_solver_was_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line ends a process at once if a solver is at work: not that of the tests."""
    if "policies.cli.main" in sys.modules:
        monkeypatch.setattr(sys.modules["policies.cli.main"], "LEFT_ALONE", "by no test")
