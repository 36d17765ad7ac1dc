"""What all test processes have in common."""

import gc
import os
import subprocess
import sys
from collections.abc import Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# Test processes run side by side: threads of one would be in the way of the others. Libraries read
# this when they are first imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")


LONGEST = "one_game docs pathfinder run faults training fuzz game scenarios window optimal kills"
"""Files of tests that take longest: they come first, so that none is left alone at the end."""

PER_COMMIT = 15
"""Examples of a test that does not say how many; with -m slow there are many times more."""


def examples(number: int) -> Any:
    """A test has so many examples; with -m slow more, in the same proportion as others."""
    return settings(max_examples=number * settings.default.max_examples // PER_COMMIT)


def some_slow(values: Iterable[Any], slow: Container[Any]) -> list[Any]:
    """Parameters of a test, of which some run only with -m slow."""
    return [pytest.param(v, marks=pytest.mark.slow if v in slow else []) for v in values]


def pytest_configure(config: pytest.Config) -> None:
    """Sets how many examples tests have; compiles what test processes share before they start."""
    for name, number in (("commit", PER_COMMIT), ("slow", 20 * PER_COMMIT)):
        settings.register_profile(
            name,
            deadline=None,
            max_examples=number,
            suppress_health_check=[*settings.default.suppress_health_check, HealthCheck.too_slow],
        )
    settings.load_profile("slow" if config.getoption("markexpr") == "slow" else "commit")
    warm_up(config)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first; a file's tests stay in their order."""
    rank = {f"test_{name}": place for place, name in enumerate(LONGEST.split())}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


def pytest_collection_finish() -> None:
    """All modules stay to the end: the collector need not look for garbage in them again."""
    gc.freeze()


def pytest_itemcollected(item: pytest.Item) -> None:
    """With -m slow, tests with examples run as well, and have more of them."""
    slow = item.config.getoption("markexpr") == "slow"
    if slow and hasattr(getattr(item, "obj", None), "hypothesis"):
        item.add_marker("slow")


def warm_up(config: pytest.Config) -> None:
    """Compiles what all tests share, if all of them are to run side by side."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if not whole or hasattr(config, "workerinput") or not config.getoption("numprocesses", 0):
        return
    print("compiling what the tests share, once per version: about 90 s", file=sys.stderr)
    command = [sys.executable, str(Path(__file__).with_name("warm_up.py"))]
    # These take about as long, and what one needs of the other is compiled by then.
    parts = ["rip_up", "trainings"], ["plain", "routers"]
    halves = [subprocess.Popen([*command, *half]) for half in parts]
    for half in halves:
        half.wait()  # should one fail, the tests compile the rest, and say what is wrong


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Experiments and benchmarks work in this process: others take seconds to start."""
    monkeypatch.setattr("policies.experiment.experiment.work_on", in_this_process)


def in_this_process(parts: Sequence[Any], *_: Any) -> Iterator[list[Any]]:
    """In the place of :func:`policies.experiment.part.work_on`."""
    for part in parts:
        part.work()
        yield [part]


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are not drawn, in tests of other things: one takes a third of a second."""

    def savefig(_figure: Any, path: Path, **_: Any) -> None:
        path.write_text("no picture")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", savefig)


@pytest.fixture(autouse=True)
def _coarse_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures have few dots, which take less time to draw and to compress."""
    if "policies.figures.style" in sys.modules:
        monkeypatch.setattr(sys.modules["policies.figures.style"], "DPI", 50)


@pytest.fixture(autouse=True)
def _no_solver_was_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line ends a process at once if a solver is at work: not that of the tests."""
    if "policies.cli.main" in sys.modules:
        monkeypatch.setattr(sys.modules["policies.cli.main"], "LEFT_ALONE", "by no test")
