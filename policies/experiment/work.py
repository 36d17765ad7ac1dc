"""Work on parts, by whatever engine: here, or where nobody sees our files.

On other machines a part works in a folder of its own. Files that it reads go along, files that it
writes come back, and this process writes them, the one with the rows last: so nothing has to be
shared, and a part is finished when it is finished here. A training also sends what it would need to
go on, whenever it has written a checkpoint. When its process is lost, the next one goes on from
there; when all is killed, the training does so that is started again.
"""

import contextlib
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from marouting import InputError
from marouting.config import parse_yaml, yaml_text
from marouting.files import TEMPORARY, naming, writing
from policies.engines import Call, Engine, EngineName, Notes, opened
from policies.experiment.config import PUBLISHED
from policies.experiment.part import Part
from policies.results.folder import LOCK
from policies.results.run_folder import CHECKPOINT, CONFIG

Files = dict[str, bytes]
"""What files hold, by their names from a folder."""

_LOOK = 1.0
"""Seconds between two looks at whether a training has written a checkpoint."""

_REST = 20
"""How many times as long as it took to send a checkpoint it takes to the next at least."""

_SCRATCH = "marouting-"
"""How the names of the folders begin in which parts work elsewhere; the process follows."""


def work_on(
    parts: Sequence[Part], jobs: int, threads: int, engine: EngineName = "local"
) -> Iterator[list[Part]]:
    """Works on parts, in the given order as far as there is room.

    The processes of the local engine import the main module, so a script that calls this needs the
    usual ``if __name__ == "__main__":``. All work ends at once when the iteration ends early, by an
    error or Ctrl-C, or when this process is killed.

    Args:
        parts: the work, one part or more.
        jobs: the largest number of processes.
        threads: the number of threads that each process may use.
        engine: where the work is done.

    Yields:
        About every second, the parts that have been finished since.

    Raises:
        InputError: a process was killed.
        Exception: whatever a part raises.
    """
    with opened(engine, min(jobs, len(parts)), threads) as opened_engine:
        if opened_engine.notes is None:
            for done in opened_engine.run([Call(part.work, (), part.gpus) for part in parts]):
                yield [parts[number] for number in done]
        else:
            yield from _work_elsewhere(parts, opened_engine, opened_engine.notes)


def _work_elsewhere(parts: Sequence[Part], engine: Engine, notes: Notes) -> Iterator[list[Part]]:
    """Works on parts where nobody sees our files."""
    # What others report has only to be read, here.
    quoted = [part for part in parts if part.entry.router == PUBLISHED]
    for part in quoted:
        part.work()
    yield quoted
    left = [part for part in parts if part.entry.router != PUBLISHED]
    shared: dict[Path, Any] = {}
    calls = []
    for part in left:
        reads = part.reads()
        for path in reads:
            if path not in shared:
                shared[path] = engine.share(_content(path))
        written = notes if part.entry.trains else None
        sent = Sent(part, tuple(map(str, reads)), frozenset(part.named), written)
        begun = engine.share(_read(part.run)) if part.entry.trains else None
        calls.append(Call(sent.work, (begun, *(shared[path] for path in reads)), part.gpus))
    by_key = {str(part.rows): part for part in left}
    for done in engine.run(calls):
        for number, (written, gone) in done.items():
            part = left[number]
            # Of a part that is finished no news are of use any more.
            by_key.pop(str(part.rows))
            _write(part.folder, written, str(part.rows.relative_to(part.folder)))
            for name in gone:
                (part.folder / name).unlink(missing_ok=True)
        for rows, files in notes.news().items():
            if rows in by_key:
                _write(by_key[rows].run, files, CHECKPOINT)
        yield [left[number] for number in done]


@dataclass(frozen=True)
class Sent:
    """A part that works in another folder than its own, perhaps on another machine.

    Attributes:
        part: the part, as it is at home.
        reads: the files that it reads, as they are called at home.
        named: the options that name some of them.
        notes: where a training writes down how far it is; None for what does not train.
    """

    part: Part
    reads: tuple[str, ...]
    named: frozenset[str]
    notes: Notes | None

    def work(self, begun: Files | None, *contents: bytes) -> tuple[Files, list[str]]:
        """Does the work.

        Args:
            begun: the run folder of a training that had begun at home; None for what does not
                train.
            contents: what the files hold.

        Returns:
            The files that are written, by their names from the part's folder, and the names of
            those that are gone.
        """
        _remove_left()
        with tempfile.TemporaryDirectory(prefix=f"{_SCRATCH}{os.getpid()}-") as name:
            here = Path(name).resolve()
            for path, content in zip(self.reads, contents, strict=True):
                _put(_moved(path, here), content)
            part = self._at(here)
            brought: Files = {}
            if self.notes is not None:
                brought = self.notes.read(str(self.part.rows)) or begun or {}
                for path, content in self._sent(brought, here).items():
                    _put(part.run / path, content)
            try:
                with self._noting(part, here):
                    part.work()
            except InputError as error:
                raise InputError(_home(str(error), here)) from None
            run = str(part.run.relative_to(part.folder))
            known = {str(Path(run, path)): content for path, content in brought.items()}
            known |= {
                str(Path(path).relative_to(self.part.folder)): content
                for path, content in zip(self.reads, contents, strict=True)
                if Path(path).is_relative_to(self.part.folder)
            }
            found = _brought_home(_read(part.folder), here)
            written = {path: own for path, own in found.items() if known.get(path) != own}
            return written, sorted(known.keys() - found.keys())

    def _at(self, here: Path) -> Part:
        """The part in another folder, with options that name the files there."""

        def moved(value: Any) -> Any:
            if isinstance(value, Mapping):
                return {key: moved(one) for key, one in value.items()}
            named = isinstance(value, str) and value in self.named
            return str(_moved(value, here)) if named else value

        entry = replace(self.part.entry, options=moved(self.part.entry.options))
        return replace(self.part, folder=_moved(self.part.folder, here), entry=entry)

    def _sent(self, files: Files, here: Path) -> Files:
        """Files as they are, but configurations with the names of files as they are here."""

        def moved(value: str) -> str:
            return str(_moved(value, here)) if value in self.named else value

        return {path: _renamed(path, content, moved) for path, content in files.items()}

    @contextlib.contextmanager
    def _noting(self, part: Part, here: Path) -> Iterator[None]:
        """Meanwhile writes down every checkpoint of a training."""
        if self.notes is None:
            yield
            return
        notes, ended = self.notes, threading.Event()
        checkpoint = part.run / CHECKPOINT
        key = str(self.part.rows)

        def watch() -> None:
            seen, pause = _written(checkpoint), _LOOK
            while not ended.wait(pause):
                if (now := _written(checkpoint)) == seen:
                    continue
                seen, began = now, time.monotonic()
                # First the checkpoint: logs that have grown meanwhile are cut off by it.
                first = _content(checkpoint)
                files = {**_read(part.run), CHECKPOINT: first}
                notes.write(key, _brought_home(files, here))
                # Logs grow: sending them never takes more than a small part of the time.
                pause = max(_LOOK, _REST * (time.monotonic() - began))

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            ended.set()
            watcher.join()


def _remove_left() -> None:
    """Removes the folders that processes of this machine have left which were killed."""
    for path in Path(tempfile.gettempdir()).glob(f"{_SCRATCH}[0-9]*-*"):
        try:
            os.kill(int(path.name.removeprefix(_SCRATCH).partition("-")[0]), 0)
        except ProcessLookupError:
            shutil.rmtree(path, ignore_errors=True)
        except (ValueError, OSError):
            continue


def _moved(path: str | Path, here: Path) -> Path:
    """Where a file or folder of home is in another folder."""
    plain = Path(path)
    if not plain.is_absolute() and ".." not in plain.parts:
        return here / _NEAR / plain
    return Path(f"{here}{os.sep}{_FAR}{os.path.normpath(plain.absolute())}")


def _home(text: str, here: Path) -> str:
    """A text with files named as they are at home."""
    return text.replace(f"{here}{os.sep}{_NEAR}{os.sep}", "").replace(f"{here}{os.sep}{_FAR}", "")


def _brought_home(files: Files, here: Path) -> Files:
    """Files as they are, but configurations with the names of files as they are at home."""
    return {
        path: _renamed(path, content, lambda value: _home(value, here))
        for path, content in files.items()
    }


def _renamed(path: str, content: bytes, rename: Callable[[str], str]) -> bytes:
    """A file as it is, but of a configuration with every text renamed."""
    if Path(path).name != CONFIG:
        return content

    def renamed(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: renamed(one) for key, one in value.items()}
        if isinstance(value, list):
            return [renamed(one) for one in value]
        return rename(value) if isinstance(value, str) else value

    return yaml_text(renamed(parse_yaml(content.decode(), path))).encode()


_NEAR, _FAR = "near", "far"
"""What is named from the working folder, and what is not."""


def _content(path: Path) -> bytes:
    with naming(path, "cannot be read"):
        return path.read_bytes()


def _written(path: Path) -> int:
    """When a file was written; 0 if there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _read(folder: Path) -> Files:
    """All files in a folder, but locks and temporary ones."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.name == LOCK or path.name.endswith(TEMPORARY) or not path.is_file():
            continue
        with contextlib.suppress(FileNotFoundError):
            found[str(path.relative_to(folder))] = path.read_bytes()
    return found


def _put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _write(folder: Path, files: Files, last: str) -> None:
    """Writes files into a folder, each whole; the one that makes the others count comes last."""
    for name in sorted(files, key=lambda name: name == last):
        with writing(folder / name) as temporary:
            temporary.write_bytes(files[name])
