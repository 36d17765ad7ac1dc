"""What a training logs: a line of JSON for every episode and evaluation, and for TensorBoard.

TensorBoard shows, for each problem and as means over all problems:

==========================  ======================================================================
``reward`` … ``loss``       the episodes, as ``metrics.jsonl`` has them
``best_open``, …            open tasks, overflow and wirelength of the best episode so far
``greedy_open``, …          those of the evaluations, which are played without exploration
``best_gap``, …             wirelength above the reference in %, where that is known
``speed``                   moves trained per second, over the moves of all problems
==========================  ======================================================================

Where every episode draws its problem, the episodes of all problems are one curve, ``train``, and
there is no best one.

A mean is over all problems, at the same episode; that of the gaps is over the problems that have
the reference's overflow and no open task. The speed is that of this process: a resumed training
shows it from there on.
"""

import contextlib
import functools
import json
import os
import shutil
import threading
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from marouting import InputError
from marouting.files import naming
from policies.results.run_folder import (
    EVALUATIONS,
    METRICS,
    Episode,
    GreedyEvaluation,
    read_episodes,
    read_evaluations,
)
from policies.results.statistics import gap

CURVES = ("reward", "joined", "overflow", "wirelength", "steps", "epsilon", "loss")
"""The fields of an episode that TensorBoard shows."""

DRAWN = "train"
"""TensorBoard's name of what episodes of drawn problems give."""

SPEED = "speed/steps_per_second"
"""TensorBoard's name of the speed."""

_SECONDS = 2.0
"""How long a speed is measured, at least."""


class Logs:
    """Appends episodes and evaluations to the logs of a run folder.

    Args:
        folder: the run folder.
        logged: bytes of ``metrics.jsonl`` and of ``evaluations.jsonl`` that stay; what a killed run
            wrote after its last checkpoint is cut off, since the resumed run writes it again.
        tensorboard: whether to write event files too.
        problems: the names of all problems.
        reference: overflow and wirelength of the best known solutions, by the problem's name.
        drawn: whether every episode draws its problem.
        wandb: the configuration, to log the same in Weights & Biases; None: it is not.

    Raises:
        InputError: the folder cannot be written to, or there is no package wandb.
    """

    def __init__(
        self,
        folder: Path,
        logged: tuple[int, int],
        tensorboard: bool,
        problems: Sequence[str],
        reference: Mapping[str, tuple[int, int]],
        *,
        drawn: bool = False,
        wandb: Mapping[str, Any] | None = None,
    ) -> None:
        self._wandb = None if wandb is None else _wandb_run(folder, wandb)
        self._events: Events | None = None
        with contextlib.ExitStack() as opened:
            self._episodes, self._evaluations = (
                opened.enter_context(contextlib.closing(_Lines(folder / name, size)))
                for name, size in zip((METRICS, EVALUATIONS), logged, strict=True)
            )
            if tensorboard:
                # The lines hold all that was logged: a resumed run's events are made anew from
                # them, without those that a killed run wrote after its last checkpoint.
                shutil.rmtree(folder / "tensorboard", ignore_errors=True)
                self._events = Events(folder / "tensorboard", problems, reference, drawn=drawn)
                opened.callback(self._events.close)
                for episode in read_episodes(folder / METRICS):
                    self._events.show(episode)
                for evaluation in read_evaluations(folder / EVALUATIONS):
                    self._events.show(evaluation)
                self._events.start_clock()
            self._opened = opened.pop_all()

    def write(
        self, episodes: Sequence[Episode], evaluations: Sequence[GreedyEvaluation] = ()
    ) -> None:
        """Logs finished episodes, and evaluations."""
        self._episodes.write(episodes)
        self._evaluations.write(evaluations)
        if self._events is not None:
            lines: list[Episode | GreedyEvaluation] = [*episodes, *evaluations]
            for line in lines:
                self._events.show(line)
            self._events.show_speed(_SECONDS)

    def flush(self) -> tuple[int, int]:
        """Puts everything on disk; returns the bytes of both files."""
        sizes = self._episodes.flush(), self._evaluations.flush()
        if self._events is not None:
            self._events.show_speed(0)
            self._events.flush()
        return sizes

    def __enter__(self) -> Self:
        """The logs themselves."""
        self._hook = threading.excepthook
        # An error in TensorBoard's thread is raised again by the next call.
        threading.excepthook = lambda args: (
            None if type(args.thread).__module__.startswith("tensorboard.") else self._hook(args)
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Closes the files."""
        threading.excepthook = self._hook
        self._opened.close()
        if self._wandb is not None:
            self._wandb.finish(exit_code=int(kind is not None))


def _wandb_run(folder: Path, config: Mapping[str, Any]) -> Any:
    """A run of Weights & Biases, which follows TensorBoard's events from now on."""
    try:
        import wandb
    except ImportError:
        raise InputError("train.wandb: expected the package wandb (pip install wandb)") from None
    with naming(folder, "cannot be written"):
        return wandb.init(
            project="marouting",
            name=folder.resolve().name,
            dir=folder,
            config=dict(config),
            sync_tensorboard=True,
        )


class _Lines:
    """A file of lines of JSON that grows; the arguments are those of :class:`Logs`."""

    def __init__(self, path: Path, logged: int) -> None:
        self._named = functools.partial(naming, path, "cannot be written")
        with self._named():
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("a+", encoding="utf-8", newline="\n")
            with contextlib.ExitStack() as opened:
                self._file = opened.enter_context(file)
                if file.tell() < logged:
                    what = f"at least {logged} bytes, as at the checkpoint"
                    raise InputError(f"{path}: expected {what}")
                file.truncate(logged)
                opened.pop_all()

    def write(self, lines: Sequence[Episode | GreedyEvaluation]) -> None:
        with self._named():
            self._file.writelines(json.dumps(asdict(line)) + "\n" for line in lines)

    def flush(self) -> int:
        """Puts everything on disk; returns the bytes."""
        with self._named():
            self._file.flush()
            os.fsync(self._file.fileno())
            return self._file.seek(0, os.SEEK_END)

    def close(self) -> None:
        with self._named():
            self._file.close()


class Events:
    """Writes TensorBoard's event files.

    Args:
        folder: the folder for them.
        problems: the names of all problems.
        reference: overflow and wirelength of the best known solutions, by the problem's name.
        drawn: whether every episode draws its problem.

    Raises:
        InputError: the folder cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        problems: Sequence[str],
        reference: Mapping[str, tuple[int, int]],
        *,
        drawn: bool = False,
    ) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._named = functools.partial(naming, folder, "cannot be written")
        with self._named():
            self._writer = SummaryWriter(str(folder))
        self._problems, self._reference, self._drawn = problems, reference, drawn
        self._best: dict[str, Episode] = {}
        # What waits for the other problems: by episode, and the latest evaluation of each problem.
        self._waiting: dict[int, list[dict[str, float]]] = defaultdict(list)
        self._evaluated: dict[str, tuple[int, dict[str, float]]] = {}
        self._moves = 0
        self.start_clock()

    def start_clock(self) -> None:
        """Measures speed from now on."""
        self._since = self._moves, time.monotonic()

    def show_speed(self, least: float) -> None:
        """Adds the speed, if it has been measured for so many seconds; raises InputError."""
        moves, started = self._since
        seconds = time.monotonic() - started
        if self._moves > moves and seconds > least:
            with self._named():
                speed = (self._moves - moves) / seconds
                self._writer.add_scalar(SPEED, speed, self._moves)
            self.start_clock()

    def show(self, line: Episode | GreedyEvaluation) -> None:
        """Adds an episode or an evaluation; raises InputError."""
        with self._named():
            if isinstance(line, Episode):
                self._show_episode(line)
            else:
                self._show_evaluation(line)

    def _show_episode(self, episode: Episode) -> None:
        name = episode.problem
        self._moves += episode.steps
        if episode.best:
            self._best[name] = episode
        fields = {curve: getattr(episode, curve) for curve in CURVES}
        values = {curve: value for curve, value in fields.items() if value is not None}
        if self._drawn:  # of problems of which most are seen once, there is one curve
            self._add(values, DRAWN, episode.episode)
            return
        values |= self._figures("best", self._best.get(name, episode))
        self._add(values, name, episode.episode)
        waiting = self._waiting[episode.episode]
        waiting.append(values)
        if len(waiting) == len(self._problems):
            self._add_means(self._waiting.pop(episode.episode), episode.episode)

    def _show_evaluation(self, evaluation: GreedyEvaluation) -> None:
        values = self._figures("greedy", evaluation)
        self._add(values, evaluation.problem, evaluation.episodes)
        self._evaluated[evaluation.problem] = evaluation.episodes, values
        if len(self._evaluated) == len(self._problems):
            episodes, figures = zip(*self._evaluated.values(), strict=True)
            self._add_means(figures, min(episodes))
            self._evaluated.clear()

    def _figures(self, prefix: str, played: Episode | GreedyEvaluation) -> dict[str, float]:
        """Open tasks, overflow, wirelength, and the gap where it is known."""
        found = (played.tasks - played.joined, played.overflow, played.wirelength)
        names = (f"{prefix}_open", f"{prefix}_overflow", f"{prefix}_wirelength")
        values: dict[str, float] = dict(zip(names, found, strict=True))
        if played.problem in self._reference:
            above = gap(found, (0, *self._reference[played.problem]))
            if above is not None:
                values[f"{prefix}_gap"] = above
        return values

    def _add(self, values: Mapping[str, float], problem: str, step: int) -> None:
        for curve, value in values.items():
            self._writer.add_scalar(f"{curve}/{problem}", value, step)

    def _add_means(self, figures: Sequence[Mapping[str, float]], step: int) -> None:
        """Adds the means over the problems, each over those that have a value."""
        together: dict[str, list[float]] = defaultdict(list)
        for values in figures:
            for curve, value in values.items():
                together[curve].append(value)
        for curve, known in together.items():
            self._writer.add_scalar(f"mean/{curve}", sum(known) / len(known), step)

    def flush(self) -> None:
        """Puts everything on disk; raises InputError."""
        with self._named():
            self._writer.flush()

    def close(self) -> None:
        """Closes the files; raises InputError."""
        with self._named():
            self._writer.close()
