"""Work as tasks of Ray: the same as in local processes, whatever is killed."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import ray_tasks as tasks
import test_experiment
import yaml
from conftest import in_this_process

from marouting import InputError
from policies import figures
from policies.cli.main import status
from policies.engines import Call, opened
from policies.experiment import Experiment, experiment, load_experiment

ray = pytest.importorskip("ray", reason="the extra ray is not installed")


@pytest.fixture(scope="module", autouse=True)
def _cluster() -> Iterator[None]:
    """One Ray for all tests here: its start takes seconds. Its processes work in this folder."""
    with opened("ray", 2, 1):
        yield


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray's processes do not find by its name what lies in the folder of a test."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(figures, "save", lambda _figure, _path: None)


def compared(folder: Path, **routers: Any) -> Path:
    """An experiment with routers that are quick."""
    (folder / "words.txt").write_text("words\n")
    (folder / "paper.csv").write_text(
        "set,problem,over,length\n" + "".join(f"small,problem_00{i},0,9\n" for i in range(3))
    )
    paper = {"router": "published", "file": "paper.csv", "overflow": "over"}
    killed = {"router": "ray_tasks:KilledOnce", "mark": str(folder / "mark"), "words": "words.txt"}
    chosen = routers or {
        "random": {"router": "random", "max_steps": 9},
        "killed": killed,
        "paper": {**paper, "wirelength": "length"},
    }
    astar = {"astar": {"router": "astar"}}
    keys = {"out": "out", "seeds": [0, 4], "routers": {**astar, **chosen}}
    return test_experiment.write_config(folder / "c.yaml", **keys)


def execute(config: Path, *overrides: str) -> dict[str, Any]:
    """The statistics of an experiment, without the times."""
    summary = Experiment(load_experiment(config, overrides, allow_code=True)).execute()
    return test_experiment.untimed(json.loads(json.dumps(summary["sets"])))


def files(folder: Path) -> list[str]:
    """The names of all files."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


# --- calls ----------------------------------------------------------------------------------------


def test_calls_return_what_they_return() -> None:
    with opened("ray", 2, 1) as engine:
        found: dict[int, int] = {}
        for done in engine.run([Call(tasks.total, (40, i)) for i in range(20)]):
            found |= done
    assert found == {i: 40 + i for i in range(20)}


def test_what_no_machine_has_is_refused() -> None:
    with opened("ray", 1, 1) as engine, pytest.raises(InputError, match="no GPU"):
        next(engine.run([Call(tasks.total, (), 1)]))
    with pytest.raises(InputError, match="threads: expected at most 2"), opened("ray", 1, 99):
        pass


# --- experiments and benchmarks -------------------------------------------------------------------


def test_an_experiment_is_the_same_as_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that is killed in between, files that go along, and a part that was done before."""
    config = compared(tmp_path)
    whole = execute(config, "engine=ray")
    out = tmp_path / "out"
    assert (tmp_path / "mark").read_text() != str(os.getpid())
    first = out / "rows" / "small" / "astar" / "problem_000.json"
    written = first.stat().st_mtime_ns
    lost = [out / "rows" / "small" / "killed" / f"problem_00{i}.json" for i in (0, 2)]
    for path in lost:
        path.unlink()
    assert execute(config, "engine=ray") == whole
    assert first.stat().st_mtime_ns == written
    assert all(path.exists() for path in lost)

    there, names = test_experiment.outcome(out), files(out)
    monkeypatch.setattr(experiment, "work_on", in_this_process)
    assert execute(config, "out=here") == whole
    assert test_experiment.outcome(tmp_path / "here") == there
    assert files(tmp_path / "here") == names


def test_a_benchmark_is_the_same_as_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = ["benchmark", "--scenario", "toy-4x4-v0", "--seeds", "1", "--router", "random"]
    assert status([*command, "--router", "astar", "--out", "there", "engine=ray"]) == 0
    monkeypatch.setattr(experiment, "work_on", in_this_process)
    assert status([*command, "--router", "astar", "--out", "here"]) == 0
    for name in ("random", "astar"):
        file = f"toy-4x4-v0.{name}.json"
        there, here = (json.loads(Path(folder, file).read_text()) for folder in ("there", "here"))
        for found in (there, here):
            found.pop("seconds")
            for row in found["outcomes"]:
                assert row.pop("seconds") > 0
        assert there == here
    assert files(tmp_path / "there") == files(tmp_path / "here")


def test_the_benchmarks_engine_can_stand_in_its_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []

    def work(parts: Sequence[Any], *how: Any) -> Iterator[list[Any]]:
        asked.append(how[-1])
        return in_this_process(parts)

    monkeypatch.setattr(experiment, "work_on", work)
    Path("b.yaml").write_text(
        yaml.safe_dump({"engine": "ray", "routers": {"a": {"router": "astar"}}})
    )
    command = ["benchmark", "--scenario", "toy-4x4-v0", "--config", "b.yaml", "--out"]
    assert status([*command, "one"]) == 0
    assert status([*command, "two", "engine=local"]) == 0
    assert asked == ["ray", "local"]
    assert status([*command, "three", "engine=rai"]) == 2
    assert "engine: expected one of local, ray" in capsys.readouterr().err.splitlines()[-1]


def test_what_a_part_refuses_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the names of files as they are here."""
    words = str(tmp_path / "words.txt")
    config = compared(tmp_path, refuses={"router": "ray_tasks:Refuses", "words": words})
    assert status(["experiment", str(config), "engine=ray", "--allow-code"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    where = "marouting: small, refuses: "
    assert line == f"{where}{words}: expected numbers, for (4, 4, 2)"


def test_without_ray_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert status(["experiment", str(compared(tmp_path)), "engine=ray", "--allow-code"]) == 2
    expected = "marouting: engine: ray is missing: pip install 'marouting[ray]'"
    assert capsys.readouterr().err.splitlines() == [expected]
    assert not (tmp_path / "out").exists()


# --- what is killed -------------------------------------------------------------------------------


ONE = ["seeds=[0]", "problems.small.count=1"]
"""A single training."""


def trained(episodes: int, **env: Any) -> dict[str, Any]:
    """Two trainings, with a checkpoint every now and then."""
    train = {"episodes": episodes, "checkpoint_seconds": 0.2}
    env = {"max_steps": 12, **env}
    dqn = {**test_experiment.DQN, "stack": 1, "env": env, "train": train}
    return {"dqn": {**dqn, "only": ["small"]}}


@pytest.mark.slow
def test_a_training_goes_on_from_its_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In another process, and elsewhere: nobody sees the folder of the one that was killed."""
    mark, tally = tmp_path / "mark", tmp_path / "tally"
    reward = {"kind": "ray_tasks:LateReward", "mark": str(mark), "tally": str(tally)}
    routers = trained(300, reward={**reward, "moves": 5000})
    config = compared(tmp_path, **routers)
    execute(config, "engine=ray", *ONE)
    assert mark.read_text() != str(os.getpid())
    again = int(tally.read_text())
    monkeypatch.setattr(experiment, "work_on", in_this_process)
    execute(config, "out=here", *ONE)
    assert test_experiment.outcome(tmp_path / "here") == test_experiment.outcome(tmp_path / "out")
    assert files(tmp_path / "here") == files(tmp_path / "out")
    assert int(tally.read_text()) > 5000
    assert again <= int(tally.read_text()) - 4000


TOKEN = "MAROUTING_TEST_RAY"


def descendants(token: str) -> list[str]:
    """The processes that were started, directly or not, with a token in their environment."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if f"{TOKEN}={token}".encode() in (path / "environ").read_bytes():
                found.append((path / "cmdline").read_text())
        except OSError:
            continue
    return found


def begun(config: Path, token: str, *keys: str, **variables: str) -> "subprocess.Popen[str]":
    """The command in a process group of its own, with a Ray of its own."""
    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            "marouting",
            "experiment",
            str(config),
            "--allow-code",
            "engine=ray",
            *keys,
        ],
        env={**os.environ, TOKEN: token, **variables},
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        # What pytest was started by may have told its children to ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_killed_experiment_goes_on_where_it_was(
    sent: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = compared(tmp_path, **trained(6_000))
    process = begun(config, str(tmp_path), *ONE)
    runs, until = tmp_path / "out" / "runs", time.monotonic() + 300
    while not list(runs.rglob("checkpoint.pt")) and time.monotonic() < until:
        assert process.poll() is None, process.stderr and process.stderr.read()
        time.sleep(0.1)
    if sent == signal.SIGINT:
        os.killpg(process.pid, sent)  # as a terminal does
    else:
        process.send_signal(sent)
    _, said = process.communicate(timeout=60)
    ends = {signal.SIGINT: 130, signal.SIGTERM: -signal.SIGTERM, signal.SIGKILL: -signal.SIGKILL}
    assert process.returncode == ends[sent]
    assert said.strip() == ("marouting: interrupted" if sent == signal.SIGINT else "")
    until = time.monotonic() + 120  # Ray's agents look from time to time whether it still runs
    while descendants(str(tmp_path)) and time.monotonic() < until:
        time.sleep(0.1)
    assert descendants(str(tmp_path)) == []
    there = list(runs.rglob("checkpoint.pt"))
    assert there
    assert not list((tmp_path / "out" / "rows").rglob("dqn*/*.json"))

    execute(config, "engine=ray", *ONE)
    monkeypatch.setattr(experiment, "work_on", in_this_process)
    execute(config, "out=here", *ONE)
    assert test_experiment.outcome(tmp_path / "here") == test_experiment.outcome(tmp_path / "out")


@pytest.mark.slow
def test_a_ray_that_runs_is_joined(tmp_path: Path) -> None:
    where = ray.get_runtime_context().gcs_address
    config = compared(tmp_path, random={"router": "random"})
    process = begun(config, "joined", RAY_ADDRESS=where)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert test_experiment.results(tmp_path / "out")
    assert ray.is_initialized()
    assert [node["Alive"] for node in ray.nodes()] == [True]


@pytest.mark.slow
def test_where_no_ray_runs_is_said_in_one_line(tmp_path: Path) -> None:
    config = compared(tmp_path, random={"router": "random"})
    process = begun(config, "nowhere", RAY_ADDRESS="127.0.0.1:1")
    _, said = process.communicate(timeout=300)
    assert process.returncode == 2
    assert said.startswith("marouting: RAY_ADDRESS=127.0.0.1:1: expected a Ray: ")
    assert len(said.splitlines()) == 1
