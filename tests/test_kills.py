"""Commands that are killed at random moments, again and again, until they come to their end.

What they have made by then is, byte for byte, what they make undisturbed, and nothing else is left.
The moments are drawn from a seed, but what a process is doing then is chance: many kills find more
than a few do.
"""

import contextlib
import io
import multiprocessing
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import test_experiment
import test_run
import yaml

from marouting.config import plain
from marouting.files import TEMPORARY
from policies.cli.main import status
from policies.results.folder import LOCK

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="starting processes takes seconds")

SIGNALS = [signal.SIGKILL] * 4 + [signal.SIGTERM, signal.SIGINT]
ENDS = {
    signal.SIGKILL: {-signal.SIGKILL},
    signal.SIGTERM: {-signal.SIGTERM, 128 + signal.SIGTERM},
    signal.SIGINT: {128 + signal.SIGINT},
}
"""The exit statuses that a process may end with, unless it was at its end already."""


def training(folder: Path, **options: Any) -> list[str]:
    """A training with a checkpoint every now and then."""
    config = test_run.config_in(folder / "out", 40, checkpoint_seconds=0.05, **options)
    (folder / "c.yaml").write_text(yaml.safe_dump({**plain(config), "out": "out"}))
    # Where a run has begun, the command goes on with it.
    return ["train", "c.yaml"]


def comparison(folder: Path) -> list[str]:
    """An experiment in two processes."""
    dqn = {**test_experiment.DQN, "train": {"episodes": 60, "checkpoint_seconds": 0.1}}
    routers = {"astar": {"router": "astar"}, "random": {"router": "random"}, "dqn": dqn}
    test_experiment.write_config(folder / "c.yaml", out="out", routers=routers, seeds=[0, 1])
    return ["experiment", "c.yaml"]


def generation(_: Path) -> list[str]:
    """Problems that take a while."""
    return ["generate", "--count", "100", "--nets", "30", "--out", "out"]


def files(folder: Path) -> dict[str, bytes]:
    """The content of all files in a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.gr")}


@dataclass(frozen=True)
class Command:
    """A command that is disturbed.

    Attributes:
        prepare: writes what it needs into a folder; returns its arguments.
        outcome: what must be the same in the end.
        short: the number of kills in the short test.
        long: in the long one.
    """

    prepare: Callable[[Path], list[str]]
    outcome: Callable[[Path], dict[str, Any]]
    short: int
    long: int


COMMANDS = {
    "train, single": Command(training, test_run.outcome, 0, 25),
    "train, single, tensorboard": Command(
        lambda folder: training(folder, tensorboard=True), test_run.outcome, 0, 25
    ),
    "train, drawn": Command(
        lambda folder: training(folder, shared=True, games=3, problem=test_run.DRAWN),
        test_run.outcome,
        2,
        25,
    ),
    "train, multi": Command(
        lambda folder: training(folder, agents="multi", double=True), test_run.outcome, 0, 25
    ),
    "train, multi, tensorboard": Command(
        lambda folder: training(folder, agents="multi", kind="ppo", tensorboard=True),
        test_run.outcome,
        0,
        25,
    ),
    "generate": Command(generation, files, 2, 25),
    "experiment": Command(comparison, test_experiment.outcome, 0, 15),
}

processes = multiprocessing.get_context("forkserver" if hasattr(os, "fork") else None)
# One process imports what takes seconds; those that are killed are its copies.
PRELOADED = ["policies.learned.run", "policies.experiment", "torch.utils.tensorboard", __name__]


def process_of(arguments: list[str], folder: Path) -> Any:
    """A process that runs a command; it leads a group of its own."""
    processes.set_forkserver_preload(PRELOADED)
    if (folder / "out" / "config.yaml").exists() and arguments[0] == "train":
        arguments = [*arguments, "--resume", "out"]
    (folder / "said").unlink(missing_ok=True)
    process = processes.Process(target=run, args=(arguments, folder))
    process.start()
    while process.exitcode is None and not (folder / "said").exists():
        time.sleep(0.001)
    return process


def run(arguments: list[str], folder: Path) -> None:
    """Runs a command; what it says is in a file."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(folder)
    said = os.open("said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(said, stream)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(os.fdopen(n, "wb", 0), write_through=True) for n in (1, 2)
    )
    try:
        code = status(arguments)
    except KeyboardInterrupt:  # just before the command, or just after it
        code = 128 + signal.SIGINT
    os._exit(code)


def ended(process: Any) -> int:
    """Waits for a process and all that it has started; returns its exit status."""
    process.join(120)
    until = time.monotonic() + 30
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.killpg(process.pid, 0)
            time.sleep(0.01)
        raise AssertionError("processes are left")
    return int(process.exitcode)


def names(folder: Path) -> list[str]:
    """The files that a command has made; TensorBoard names its own by time and process."""
    found = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return sorted(str(path) for path in found if path.parts[0] != "tensorboard")


def check_killed(name: str, kills: int, tmp_path: Path) -> None:
    """Kills a command so many times; whenever it has come to its end, looks at what it made."""
    command, rng = COMMANDS[name], random.Random(name)
    whole = tmp_path / "whole"
    whole.mkdir()
    arguments = command.prepare(whole)
    process = process_of(arguments, whole)  # the first of all waits until the server has imported
    start = time.monotonic()
    assert ended(process) == 0, (whole / "said").read_text()
    seconds = time.monotonic() - start
    expected, made = command.outcome(whole / "out"), names(whole / "out")
    assert not [name for name in made if name.endswith((TEMPORARY, LOCK))]
    done = lives = 0
    while done < kills:
        folder = tmp_path / f"killed{lives}"
        folder.mkdir()
        lives += 1
        assert command.prepare(folder) == arguments
        code = None
        while code != 0:
            process, ends = process_of(arguments, folder), {0}
            if done < kills:
                process.join(rng.uniform(0, 0.8 * seconds))
                if process.exitcode is None:
                    sent = rng.choice(SIGNALS)
                    with contextlib.suppress(ProcessLookupError):  # it ended meanwhile
                        os.kill(process.pid, sent)
                    ends |= ENDS[sent]
                    done += 1
            code = ended(process)
            said = (folder / "said").read_text()
            assert code in ends, (code, said)
            assert "Traceback" not in said, said
        assert command.outcome(folder / "out") == expected
        assert names(folder / "out") == made
    print(f"{name}: {done} kills, {lives} times to its end")


@pytest.mark.parametrize("name", [name for name in COMMANDS if COMMANDS[name].short])
def test_a_few_kills(name: str, tmp_path: Path) -> None:
    check_killed(name, COMMANDS[name].short, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_many_kills(name: str, tmp_path: Path) -> None:
    check_killed(name, COMMANDS[name].long, tmp_path)
