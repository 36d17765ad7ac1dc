"""What a training logs: a line of JSON for every episode, and the same for TensorBoard."""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from marouting import InputError
from marouting.files import unusable
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
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._lines = path.open("a+", encoding="utf-8", newline="\n")
            if self._lines.tell() < logged:
                raise InputError(f"{path}: expected at least {logged} bytes, as when it was saved")
            self._lines.truncate(logged)
        except OSError as error:
            raise unusable(path, "cannot be written", error) from None
        self._events = None
        if tensorboard:
            from torch.utils.tensorboard import SummaryWriter

            # The lines hold all that was logged: a resumed run's events are made anew from them,
            # without those that a killed run wrote after its last checkpoint.
            shutil.rmtree(folder / "tensorboard", ignore_errors=True)
            self._events = SummaryWriter(str(folder / "tensorboard"))
            for episode in read_episodes(path):
                self._show(episode)

    def write(self, episodes: Sequence[Episode]) -> None:
        """Logs finished episodes."""
        for episode in episodes:
            self._lines.write(json.dumps(asdict(episode)) + "\n")
            self._show(episode)

    def _show(self, episode: Episode) -> None:
        """Hands an episode to TensorBoard, if it is wanted."""
        if self._events is not None:
            for curve in CURVES:
                value = getattr(episode, curve)
                if value is not None:
                    self._events.add_scalar(f"{curve}/{episode.problem}", value, episode.episode)

    def flush(self) -> int:
        """Puts everything on disk; returns the bytes of ``metrics.jsonl``."""
        self._lines.flush()
        os.fsync(self._lines.fileno())
        if self._events is not None:
            self._events.flush()
        return self._lines.seek(0, os.SEEK_END)

    def __enter__(self) -> Self:
        """The logs themselves."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Closes the files."""
        self._lines.close()
        if self._events is not None:
            self._events.close()
