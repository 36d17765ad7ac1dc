"""Progress bars on standard error for work that takes minutes or hours."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

if TYPE_CHECKING:
    from policies.results.run_folder import Episode


@contextlib.contextmanager
def training_bar(done: int, total: int) -> "Iterator[Callable[[Sequence[Episode]], None]]":
    """Shows the progress of a training: episodes, time, and the last episode's result.

    Args:
        done: episodes finished before.
        total: episodes in all.

    Yields:
        A function to call with the episodes that have finished since the last call.
    """
    with _bar("episodes") as (bar, task):
        bar.update(task, description="burn-in", total=total, completed=done)

        def watch(episodes: "Sequence[Episode]") -> None:
            last = episodes[-1]
            brief = (
                f"{last.problem}: joined {last.joined}/{last.tasks}, "
                f"WL {last.wirelength}, reward {last.reward:.0f}"
            )
            bar.update(task, advance=len(episodes), description=brief)

        yield watch


@contextlib.contextmanager
def problems_bar(name: str) -> Iterator[Callable[[float, int], None]]:
    """Shows the progress of work on one problem after another.

    Args:
        name: what the bar is called.

    Yields:
        A function to call with the number of problems done so far, and their number in all.
    """
    with _bar("problems") as (bar, task):
        bar.update(task, description=name)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextlib.contextmanager
def _bar(unit: str) -> Iterator[tuple[Progress, TaskID]]:
    """A bar that shows what is done of how many, and the time, if standard error is a terminal."""
    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}", markup=False),  # names may contain brackets
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    ) as bar:
        yield bar, bar.add_task("", total=None)
