"""What happens when writing fails: every opening, renaming and so on of a file, one at a time.

Python tells an audit hook before it opens a file for writing, renames one or makes a folder; the
hook lets one of these operations fail, as on a full disk. Limits on the size of files do the same
for the writing itself, also by code that is not Python.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from conftest import some_slow

from marouting import generate
from marouting.files import TEMPORARY
from policies.cli.main import status
from policies.results.folder import LOCK

TRAINING = {
    "seed": 1,
    "env": {"problem": {"grid": [4, 4, 2], "nets": 3, "reduced_edges": 0}},
    "learner": {"kind": "dqn", "burn_in_size": 20, "buffer_size": 40, "batch_size": 4},
    "train": {"episodes": 2, "checkpoint_seconds": 0, "tensorboard": False, "figures": False},
}
EXPERIMENT = {
    "problems": {"a": {"grid": [4, 4, 2], "nets": 3, "count": 2, "reduced_edges": 0}},
    "routers": {"astar": {"router": "astar"}, "pathfinder": {"router": "pathfinder"}},
    "jobs": 1,
}
COMMANDS = {
    "generate": ["generate", "--nets", "3", "--count", "2", "--out", "out"],
    "route": ["route", "../problem.gr", "--out", "out/a.solution"],
    "convert": ["convert", "../problem.gr", "out/a.gr"],
    "plot": ["plot", "../problem.gr", "--out", "out"],
    "train": ["train", "../training.yaml", "out=out"],
    "experiment": ["experiment", "../experiment.yaml", "out=out"],
}
_LONG = {"plot", "train", "experiment"}

_SCRIPT = """
import contextlib, errno, io, json, os, shutil, sys
from pathlib import Path
from policies.cli.main import status

folder = Path(sys.argv[1])
left = [-1]  # operations until one fails
failed = []

def hook(event, arguments):
    if left[0] < 0 or event not in ("open", "os.rename", "os.mkdir", "os.chmod"):
        return
    if event == "open":
        path, mode, flags = arguments
        writes = any(c in mode for c in "wax+") if mode else flags & (os.O_WRONLY | os.O_RDWR)
    else:
        path, writes = arguments[0], True
    if not writes or not isinstance(path, str | os.PathLike):
        return
    if not str(Path(path).resolve()).startswith(str(folder)):
        return
    left[0] -= 1
    if left[0] < 0:
        failed.append(event)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

sys.addaudithook(hook)

def run(arguments, fault=-1):
    errors = io.StringIO()
    failed.clear()
    left[0] = fault
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        code = status(arguments)
    left[0] = -1
    return code, errors.getvalue()

def files():
    return {
        str(path.relative_to(folder)): path.read_bytes().hex()
        for path in sorted((folder / "out").rglob("*")) if path.is_file()
    }

def report(command, resume):
    run(command)
    whole, faults = files(), []
    for fault in range(500):
        shutil.rmtree("out")
        code, errors = run(command, fault)
        if not failed:
            break
        event = failed[0]
        left_behind = sorted(files()) if Path("out").exists() else []
        after = run(resume if Path("out/metrics.jsonl").exists() else command)
        faults.append([event, code, errors, left_behind, *after, files()])
    shutil.rmtree("out")
    return whole, faults

os.chdir(folder)
commands = json.loads(sys.argv[2])
resume = [*commands["train"], "--resume", "out"] if "train" in commands else None
print(json.dumps({name: report(command, resume) for name, command in commands.items()}))
"""


def faults_of(names: Sequence[str], folder: Path) -> dict[str, Any]:
    """What comes of commands and their faults, in a process whose files the hook sees."""
    (folder / "training.yaml").write_text(json.dumps(TRAINING))
    (folder / "experiment.yaml").write_text(json.dumps(EXPERIMENT))
    generate(1, (4, 4, 2), nets=3)[0].write(folder / "problem.gr")
    work = folder / "folder"
    work.mkdir()
    commands = json.dumps({name: COMMANDS[name] for name in names})
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(work), commands],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Faults of the commands that are soon at their end."""
    return faults_of([name for name in COMMANDS if name not in _LONG], tmp_path_factory.mktemp("f"))


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in _LONG])
def test_every_operation_on_a_file_fails_once(command: str, few: dict[str, Any]) -> None:
    """One line names the file; nothing half-written stays; the same command then succeeds."""
    check_faults(command, *few[command])


@pytest.mark.slow
@pytest.mark.parametrize("command", sorted(_LONG))
def test_every_operation_of_a_longer_command_fails_once(command: str, tmp_path: Path) -> None:
    check_faults(command, *faults_of([command], tmp_path)[command])


def check_faults(command: str, whole: dict[str, str], faults: list[Any]) -> None:
    assert len(faults) >= 2
    print(f"{command}: {len(faults)} faults")
    for event, code, errors, left, again, complaints, files in faults:
        if event == "os.mkdir" and code == 0:
            continue  # the folder was there already
        assert code == 2, (event, errors)
        line = errors.splitlines()[-1]
        assert line.startswith("marouting: "), (event, errors)
        assert "out" in line, (event, line)
        assert "No space left on device" in line, (event, line)
        assert "Traceback" not in errors
        assert not [name for name in left if name.endswith((TEMPORARY, LOCK))], (event, left)
        assert again == 0, (event, complaints)
        assert files.keys() == whole.keys(), event
        for name, content in files.items():
            if not name.endswith((".json", ".csv", ".pt")):  # with times
                assert content == whole[name], (event, name)


_FULL = """
import os, resource, sys
from policies.cli.main import status

sys.dont_write_bytecode = True  # Python leaves half of what it compiles, and later trips over it

for size in map(int, sys.argv[1:]):
    if not os.fork():
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        os._exit(status(["train", "training.yaml", f"out=out{size}"]))
    print("status", os.waitstatus_to_exitcode(os.wait()[1]), file=sys.stderr)
"""


@pytest.mark.parametrize("sizes", some_slow([(1000, 20000), (40, 3000)], [(40, 3000)]))
def test_a_training_on_a_disk_that_fills_up(
    sizes: tuple[int, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    training = {**TRAINING, "train": {**TRAINING["train"], "tensorboard": True}}  # type: ignore[dict-item]
    Path("training.yaml").write_text(json.dumps(training))
    done = subprocess.run(
        [sys.executable, "-c", _FULL, *map(str, sizes)],
        capture_output=True, text=True, timeout=100, check=True,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    for size, errors in zip(sizes, done.stderr.split("status 2\n"), strict=False):
        out, line = Path(f"out{size}"), errors.splitlines()[-1]
        assert line.startswith(f"marouting: {out}{os.sep}"), line
        assert "cannot be written: " in line
        resumed = ("--resume", str(out)) if (out / "metrics.jsonl").exists() else ()
        assert status(["train", "training.yaml", f"out={out}", *resumed]) == 0
        assert not list(out.rglob(f"*{TEMPORARY}"))
