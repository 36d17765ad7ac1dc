"""Progress bars on standard error for work that takes minutes or hours."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import TYPE_CHECKING

import click

from marouting import Solution
from policies.interrupts import ENDING, Held, holding
from policies.routers.base import Keeper, Router, Watched

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from policies.results.run_folder import Episode, GreedyEvaluation


@contextlib.contextmanager
def training_bar(
    done: int,
    total: int,
    unit: str = "episodes",
    best: "Sequence[Episode]" = (),
    reference: Mapping[str, tuple[int, int]] = MappingProxyType({}),
) -> "Iterator[Callable[..., None]]":
    """Shows the progress of a training: episodes, time, the best result so far, the last reward.

    Where games draw their problems, the last evaluation stands in place of the best result. If
    standard error is no terminal, that is a line of its own, every ten seconds at most.

    Args:
        done: episodes that have finished, or the steps of agents in them.
        total: how many there will be.
        unit: ``episodes`` or ``steps``, what they are.
        best: the best episode of each problem so far.
        reference: overflow and wirelength of the best known solutions, by the problem's name.

    Yields:
        A function to call with the episodes and evaluations that have finished since the last call.
    """
    from policies.results.validation import Validation

    last_line = time.monotonic()
    with _bar(unit) as (bar, task):
        kept = {episode.problem: episode for episode in best}
        shown = _best(kept) if kept else ""
        last = "training"
        bar.update(task, description=shown or last, total=total, completed=done)

        def watch(
            episodes: "Sequence[Episode]",
            evaluations: "Sequence[GreedyEvaluation]" = (),
            now: int | None = None,
        ) -> None:
            nonlocal done, last_line, shown, last
            done = done + len(episodes) if now is None else now
            kept.update((episode.problem, episode) for episode in episodes if episode.best)
            if kept:
                shown = _best(kept)
            elif evaluations:
                shown = str(Validation.of(map(asdict, evaluations), reference))
                if not bar.console.is_terminal and time.monotonic() - last_line >= _OFTEN:
                    last_line = time.monotonic()
                    click.echo(f"{min(done, total)}/{total} {unit}: {shown}", err=True)
            if episodes:
                last = f"last reward {episodes[-1].reward:.0f}"
            brief = f"{shown}; {last}" if shown else last
            bar.update(task, completed=done, description=brief)

        yield watch
        if shown:
            bar.update(task, description=shown)


def _best(kept: "Mapping[str, Episode]") -> str:
    """The best episodes of all problems, in sum; of a single problem, with which episode it was."""
    episodes = list(kept.values())
    joined, tasks, overflow, wirelength = (
        sum(getattr(episode, name) for episode in episodes)
        for name in ("joined", "tasks", "overflow", "wirelength")
    )
    where = episodes[0].problem if len(episodes) == 1 else f"{len(episodes)} problems"
    which = f" in episode {episodes[0].episode + 1}" if len(episodes) == 1 else ""
    return f"best of {where}: joined {joined}/{tasks}, OF {overflow}, WL {wirelength}{which}"


@contextlib.contextmanager
def problems_bar(name: str) -> Iterator[Callable[[float, int], None]]:
    """Shows the progress of work on one problem after another.

    Yields:
        A function to call with the number of problems done so far and the total.
    """
    with _bar("problems") as (bar, task):
        bar.update(task, description=name)
        yield lambda done, total: bar.update(task, completed=done, total=total)


SAVED_EVERY = 300.0
"""Seconds after which the best solution so far is saved again."""


@contextlib.contextmanager
def waiting(
    name: str, router: Router, save: Callable[[Solution], None] | None = None
) -> Iterator[Held]:
    """Shows that a router works, for how long, and how far it is if it tells.

    Where standard error is no terminal, a line says so after some seconds, and again every ten
    seconds if the router tells how far it is. Once it has begun to, Ctrl-C, SIGTERM or SIGHUP asks
    it to end with the best solution so far, and a second one ends everything.

    Args:
        name: what the router is called.
        router: the router, whose options may tell how long it may take.
        save: gets the best solution so far every five minutes, if the router can give it.

    Yields:
        The signals that ended the search.
    """
    options = getattr(router, "options", router)
    limits = (getattr(options, limit, None) for limit in ("seconds", "time_limit"))
    most = next((limit for limit in limits if isinstance(limit, int | float)), None)
    text = f"{name}: routing" if most is None else f"{name}: routing, for {most:g} s at most"
    held = Held()
    with contextlib.ExitStack() as stack:
        show = stack.enter_context(working(text))
        if isinstance(router, Watched):
            held = stack.enter_context(holding(*ENDING, tell=_tell_stopping))
            saved = time.monotonic()

            def watch(line: str) -> bool:
                nonlocal saved
                held.begun = True
                show(f"{name}: {line}")
                if save is not None and time.monotonic() - saved >= SAVED_EVERY:
                    best = router.best() if isinstance(router, Keeper) else None
                    if best is not None:
                        save(best)
                    saved = time.monotonic()
                return bool(held.numbers)

            router.watch = watch
            stack.callback(setattr, router, "watch", None)
        yield held


@contextlib.contextmanager
def working(text: str) -> Iterator[Callable[[str], None]]:
    """Says what is at work: at once on a terminal, elsewhere if it takes some seconds.

    Yields:
        A function to call with a new text.
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        spinner, elapsed = SpinnerColumn(), TimeElapsedColumn()
        column = TextColumn("{task.description}", markup=False)
        console = Console(stderr=True)
        with Progress(spinner, column, elapsed, console=console, transient=True) as bar:
            task = bar.add_task(text, total=None)
            yield lambda text: bar.update(task, description=text)
        return
    timer = threading.Timer(_QUIET, click.echo, (f"{text} ...",), {"err": True})
    timer.daemon = True
    timer.start()
    last = time.monotonic()

    def tell(text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= _OFTEN:
            last = time.monotonic()
            click.echo(text, err=True)

    try:
        yield tell
    finally:
        timer.cancel()


def _tell_stopping() -> None:
    click.echo("stopping with the best solution so far; a second signal discards it", err=True)


_QUIET = 3.0
"""Seconds after which a router that is at work says so."""

_OFTEN = 10.0
"""Seconds between lines about how far it is."""


@contextlib.contextmanager
def _bar(unit: str) -> "Iterator[tuple[Progress, TaskID]]":
    """A bar that shows what is done of how many, and the time, if standard error is a terminal."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}", markup=False),  # names may contain brackets
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
    # Told to be disabled, the bar of an older rich ends with an empty line all the same.
    with bar if console.is_terminal else contextlib.nullcontext():
        yield bar, bar.add_task("", total=None)
