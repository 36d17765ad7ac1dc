"""What happens when writing fails: every opening, renaming and so on of a file, one at a time.

Python tells an audit hook before it opens a file for writing, renames one or makes a folder; the
hook lets one of these operations fail, as on a full disk. Limits on the size of files do the same
for the writing itself, also by code that is not Python.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from marouting.files import TEMPORARY
from policies.results.folder import LOCK

TRAINING = {
    "seed": 1,
    "env": {"problem": {"grid": [4, 4, 2], "nets": 3, "reduced_edges": 0}},
    "learner": {"kind": "dqn", "burn_in_size": 20, "buffer_size": 40, "batch_size": 4},
    "train": {"episodes": 4, "checkpoint_seconds": 0, "tensorboard": False, "figures": False},
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
_LONG = {"plot", "experiment"}

_SCRIPT = """
import contextlib, errno, io, json, os, shutil, sys
from pathlib import Path
from policies.cli.main import status

folder, commands = Path(sys.argv[1]), json.loads(sys.argv[2])
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

os.chdir(folder)
run(commands[0])
report = {"whole": files(), "faults": []}
for fault in range(500):
    shutil.rmtree("out")
    code, errors = run(commands[0], fault)
    if not failed:
        break
    event = failed[0]
    left_behind = sorted(files()) if Path("out").exists() else []
    again = commands[-1] if Path("out/metrics.jsonl").exists() else commands[0]
    after = run(again)
    report["faults"].append([event, code, errors, left_behind, *after, files()])
print(json.dumps(report))
"""


@pytest.mark.parametrize(
    "command",
    [pytest.param(name, marks=pytest.mark.slow) if name in _LONG else name for name in COMMANDS],
)
def test_every_operation_on_a_file_fails_once(command: str, tmp_path: Path) -> None:
    """One line names the file; nothing half-written stays; the same command then succeeds."""
    (tmp_path / "training.yaml").write_text(json.dumps(TRAINING))
    (tmp_path / "experiment.yaml").write_text(json.dumps(EXPERIMENT))
    marouting("generate", "--grid", "4", "4", "2", "--nets", "3", "--out", ".", cwd=tmp_path)
    (tmp_path / "problem_000.gr").rename(tmp_path / "problem.gr")
    folder = tmp_path / "folder"
    folder.mkdir()
    commands = [COMMANDS[command]]
    if command == "train":
        commands.append(["train", "../training.yaml", "out=out", "--resume", "out"])
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(folder), json.dumps(commands)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert len(report["faults"]) >= 2
    print(f"{command}: {len(report['faults'])} faults")
    for event, code, errors, left, again, complaints, files in report["faults"]:
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
        assert files.keys() == report["whole"].keys(), event
        for name, content in files.items():
            if not name.endswith((".json", ".csv", ".pt")):  # with times
                assert content == report["whole"][name], (event, name)


def marouting(*arguments: str, cwd: Path, before: str = "") -> subprocess.CompletedProcess[str]:
    """Runs a command."""
    code = f"{before}\nimport sys; from policies.cli.main import main; main(sys.argv[1:])"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


_FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({}, resource.RLIM_INFINITY))"


@pytest.mark.parametrize("size", [40, 1000, 3000, 20000])
def test_a_training_on_a_disk_that_fills_up(tmp_path: Path, size: int) -> None:
    training = {**TRAINING, "train": {**TRAINING["train"], "tensorboard": True}}  # type: ignore[dict-item]
    (tmp_path / "training.yaml").write_text(json.dumps(training))
    command = "train", "training.yaml", "out=out"
    done = marouting(*command, cwd=tmp_path, before=_FULL.format(size))
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    line = done.stderr.splitlines()[-1]
    assert line.startswith(f"marouting: out{os.sep}"), line
    assert "cannot be written: " in line
    resumed = ("--resume", "out") if (tmp_path / "out" / "metrics.jsonl").exists() else ()
    done = marouting(*command, *resumed, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not list((tmp_path / "out").rglob(f"*{TEMPORARY}"))
