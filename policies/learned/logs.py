"""What a training logs: a line of JSON for every episode, and the same for TensorBoard."""

import functools
import json
import os
import shutil
import threading
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from marouting import InputError
from marouting.files import naming
from policies.results.run_folder import METRICS, Episode, read_episodes

CURVES = ("reward", "joined", "overflow", "wirelength", "steps", "epsilon", "loss")
"""The fields of an episode that TensorBoard shows."""


class Logs:
    """Appends episodes to the logs of a run folder.

    Args:
        folder: the run folder.
        logged: bytes of ``metrics.jsonl`` that stay; what a killed run wrote after its last
            checkpoint is cut off, since the resumed run writes it again.
        tensorboard: whether to write event files too.

    Raises:
        InputError: the folder cannot be written to.
    """

    def __init__(self, folder: Path, logged: int, tensorboard: bool) -> None:
        path = folder / METRICS
        self._lines_named, self._events_named = (
            functools.partial(naming, named, "cannot be written")
            for named in (path, folder / "tensorboard")
        )
        with self._lines_named():
            folder.mkdir(parents=True, exist_ok=True)
            self._lines = path.open("a+", encoding="utf-8", newline="\n")
            if self._lines.tell() < logged:
                raise InputError(f"{path}: expected at least {logged} bytes, as when it was saved")
            self._lines.truncate(logged)
        self._events = None
        if tensorboard:
            from torch.utils.tensorboard import SummaryWriter

            # The lines hold all that was logged: a resumed run's events are made anew from them,
            # without those that a killed run wrote after its last checkpoint.
            shutil.rmtree(folder / "tensorboard", ignore_errors=True)
            with self._events_named():
                self._events = SummaryWriter(str(folder / "tensorboard"))
            for episode in read_episodes(path):
                self._show(episode)

    def write(self, episodes: Sequence[Episode]) -> None:
        """Logs finished episodes."""
        with self._lines_named():
            self._lines.writelines(json.dumps(asdict(episode)) + "\n" for episode in episodes)
        for episode in episodes:
            self._show(episode)

    def _show(self, episode: Episode) -> None:
        """Hands an episode to TensorBoard, if it is wanted."""
        if self._events is None:
            return
        with self._events_named():
            for curve in CURVES:
                value = getattr(episode, curve)
                if value is not None:
                    self._events.add_scalar(f"{curve}/{episode.problem}", value, episode.episode)

    def flush(self) -> int:
        """Puts everything on disk; returns the bytes of ``metrics.jsonl``."""
        with self._lines_named():
            self._lines.flush()
            os.fsync(self._lines.fileno())
            size = self._lines.seek(0, os.SEEK_END)
        if self._events is not None:
            with self._events_named():
                self._events.flush()
        return size

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
        with self._lines_named():
            self._lines.close()
        if self._events is not None:
            with self._events_named():
                self._events.close()
