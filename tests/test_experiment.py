"""Experiments: what they find, that they go on after any stop, and what their figures say."""

import csv
import json
import math
import multiprocessing
import os
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import in_this_process
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from marouting import (
    InputError,
    Problem,
    Solution,
    evaluate,
    generate,
    register,
    scenarios,
    sequential_astar,
)
from policies import figures
from policies.bench.chips import write_contest
from policies.cli.main import status
from policies.experiment import Experiment, load_experiment, load_sets
from policies.experiment.part import work_on
from policies.figures import plot
from policies.learned.config import load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.trainer import Trainer
from policies.results.rows import COLUMNS
from policies.results.statistics import (
    add_gaps,
    by_router,
    by_set,
    mean_interval,
    mean_over_seeds,
    rank,
    share_interval,
    summarise,
)
from policies.routers.astar import AStarRouter
from policies.routers.random import RandomRouter
from policies.routers.registry import is_seeded, make_router, router_component

ROOT = Path(__file__).resolve().parents[1]
PNG = b"\x89PNG\r\n\x1a\n"
SMALL = {"count": 3, "grid": [4, 4, 2], "nets": 3, "capacity": 2, "seed": 1}
OTHER = {"count": 2, "grid": [5, 4, 2], "nets": 4, "capacity": 6, "seed": 2}
DQN: dict[str, Any] = {
    "router": "dqn",
    "stack": 2,
    "env": {"max_steps": 12},
    "learner": {
        "burn_in_size": 100,
        "buffer_size": 500,
        "network": {"hidden": [8]},
        "epsilon": 0.3,
    },
    "train": {"episodes": 5},
}
"""A training that takes a moment."""

OPTIMA = {("small", 0): 20, ("small", 1): 19, ("small", 2): 18, ("other", 0): 30, ("other", 1): 29}
"""What the tests take for published optima, of wirelength; overflow 0."""


def write_config(path: Path, **keys: Any) -> Path:
    """A configuration of A* on three small problems, but for some keys."""
    config = {
        "out": str(path.parent / "out"),
        "jobs": 2,
        "problems": {"small": SMALL},
        "routers": {"astar": {"router": "astar"}},
    }
    path.write_text(yaml.safe_dump({**config, **keys}, sort_keys=False))
    return path


def everything(folder: Path, **keys: Any) -> Path:
    """A configuration with all kinds of routers but those that take long to compile."""
    published = folder / "published.csv"
    lines = [f"{name},problem_{i:03d},0,{length}\n" for (name, i), length in OPTIMA.items()]
    published.write_text("set,problem,over,length\n" + "".join(lines))
    quoted = {"router": "published", "file": str(published), "overflow": "over"}
    routers = {
        "random": {"router": "random", "max_steps": 9},
        "astar": {"router": "astar"},
        "up": {
            "router": "astar",
            "net_order": "half_perimeter_up",
            "only": ["small"],
            "label": "smallest first",
        },
        "dqn": DQN,
        "best": {**quoted, "wirelength": "length", "optimal": True},
    }
    sets = {"small": SMALL, "other": OTHER}
    config = {"seeds": [0, 4], "reference": "random", "problems": sets, "routers": routers}
    return write_config(folder / "all.yaml", **{**config, **keys})


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole experiment, made with two processes."""
    config = load_experiment(everything(tmp_path_factory.mktemp("experiment")))
    Experiment(config).execute()
    return Path(config.out)


def results(folder: Path) -> list[dict[str, Any]]:
    """The rows without the times, which differ."""
    rows: list[dict[str, Any]] = json.loads((folder / "results.json").read_text())
    for row in rows:
        seconds = row.pop("seconds")
        assert (seconds is None) == (row["kind"] == "published")
        assert seconds is None or seconds > 0
    return rows


def outcome(folder: Path) -> dict[str, Any]:
    """What has to be the same however an experiment came to its end."""
    solutions = sorted((folder / "solutions").rglob("*.solution"))
    logs = sorted((folder / "runs").rglob("metrics.jsonl"))
    return {
        "rows": results(folder),
        **{str(p.relative_to(folder)): p.read_bytes() for p in (*solutions, *logs)},
    }


def untimed(sets: dict[str, Any]) -> dict[str, Any]:
    """Summaries without the times."""
    return {
        name: [{key: value for key, value in row.items() if key != "seconds"} for row in rows]
        for name, rows in sets.items()
    }


@pytest.fixture
def _undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that look at no picture: they take a second each."""
    monkeypatch.setattr(figures, "save", lambda _figure, _path: None)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The figures that the test has drawn, by file name without the ending; none is written."""
    found: dict[str, Any] = {}
    monkeypatch.setattr(figures, "save", lambda figure, path: found.update({path.stem: figure}))
    return found


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that is refused, and gives the one line that says why."""

    def run(*arguments: str | Path) -> str:
        assert status([str(argument) for argument in arguments]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        *_, line = err.splitlines()
        assert line.startswith("marouting: ")
        assert "Traceback" not in err
        return line

    return run


# --- what an experiment finds ---------------------------------------------------------------------


def test_rows_are_those_of_the_solutions(finished: Path) -> None:
    rows = results(finished)
    sizes = {"small": 3, "other": 2}
    routers = [("random", 0), ("random", 4), ("astar", None), ("up", None), ("dqn", 0), ("dqn", 4)]
    assert [(row["set"], row["problem"], row["router"], row["seed"]) for row in rows] == [
        (name, f"problem_{i:03d}", router, seed)
        for name, size in sizes.items()
        for i in range(size)
        for router, seed in [*routers, ("best", None)]
        if router != "up" or name == "small"
    ]
    for row in rows:
        if row["kind"] == "published":
            continue
        problem = Problem.read(finished / "problems" / row["set"] / f"{row['problem']}.gr")
        seed = "" if row["seed"] is None else f".seed{row['seed']}"
        file = f"{row['problem']}.{row['router']}{seed}.solution"
        solution = Solution.read(finished / "solutions" / row["set"] / file, problem)
        judged = asdict(evaluate(problem, solution))
        del judged["disconnected"]
        assert {name: row[name] for name in judged} == judged
        if row["router"] == "random":
            assert solution == RandomRouter(row["seed"], max_steps=9).route(problem)
        elif row["kind"] == "astar":
            order = "half_perimeter_up" if row["router"] == "up" else "half_perimeter"
            assert solution == AStarRouter(net_order=order).route(problem)
    problems = [
        Problem.read(finished / "problems" / "small" / f"problem_{i:03d}.gr") for i in range(3)
    ]
    assert problems == generate(3, grid=(4, 4, 2), nets=3, capacity=2, seed=1)


def test_a_network_learns_the_same_in_any_stack(finished: Path) -> None:
    folder = finished / "runs" / "small" / "dqn.seed4"
    assert sorted(path.name for path in folder.iterdir()) == ["problem_000", "problem_002"]
    names = [f"problem_{i:03d}" for i in range(3)]
    files = [finished / "problems" / "small" / f"{name}.gr" for name in names]
    config = load_config(folder / "problem_000" / "config.yaml")
    assert (config.seed, config.train.figures, config.env.max_steps) == (4, False, 12)
    assert config.env.problem == tuple(map(str, files[:2]))
    together = Trainer({path.stem: Problem.read(path) for path in files}, config)
    for _ in together.run():
        pass
    for name, solution in together.solutions().items():
        path = finished / "solutions" / "small" / f"{name}.dqn.seed4.solution"
        assert Solution.read(path, solution.problem) == solution


def test_published_rows_are_quoted(finished: Path) -> None:
    quoted = [row for row in results(finished) if row["router"] == "best"]
    assert {(row["set"], int(row["problem"][-3:])): row["wirelength"] for row in quoted} == OPTIMA
    empty = ("seed", "max_overflow", "vias", "connected", "joined", "tasks")
    for row in quoted:
        assert (row["kind"], row["proven"], row["overflow"], row["gap"]) == (
            "published",
            True,
            0,
            0,
        )
        assert all(row[name] is None for name in empty)
    assert not list((finished / "solutions").rglob("*best*"))


def test_gaps_are_to_the_optimum(finished: Path) -> None:
    seen = set()
    for row in results(finished):
        best = OPTIMA[row["set"], int(row["problem"][-3:])]
        whole = row["kind"] == "published" or row["joined"] == row["tasks"]
        known = whole and row["overflow"] == 0
        seen.add(known)
        assert row["gap"] == (
            pytest.approx(100 * (row["wirelength"] - best) / best) if known else None
        )
    assert seen == {True, False}


def test_results_are_written_in_both_forms(finished: Path) -> None:
    rows = json.loads((finished / "results.json").read_text())
    assert all(list(row) == list(COLUMNS) for row in rows)
    with (finished / "results.csv").open(newline="") as file:
        written = list(csv.DictReader(file))
    expected = [
        {name: "" if value is None else str(value) for name, value in row.items()} for row in rows
    ]
    assert written == expected


def test_summary_is_that_of_the_rows(finished: Path) -> None:
    rows = json.loads((finished / "results.json").read_text())
    summary = json.loads((finished / "summary.json").read_text())
    assert summary["reference"] == "random"
    assert list(summary["sets"]) == ["small", "other", "all"]
    for name, own in by_set(rows).items():
        assert summary["sets"][name] == json.loads(json.dumps(summarise(own, "random")))
    of_all = summary["sets"]["all"]
    assert [row["router"] for row in of_all] == ["random", "astar", "dqn", "best"]
    assert {row["problems"] for row in of_all} == {5}
    small = {row["router"]: row for row in summary["sets"]["small"]}
    assert small["astar"]["against_astar"] is None
    assert small["random"]["against_reference"] is None
    assert sum(small["up"]["against_astar"].values()) == 3
    assert small["dqn"]["seeds"] == 2
    assert set(small["dqn"]["spread"]) >= {"overflow", "wirelength", "lower_wirelength"}
    assert small["astar"]["spread"] is None


def test_types_are_those_of_astars_solutions(finished: Path) -> None:
    expected = {}
    for name, count in (("small", 3), ("other", 2)):
        full = 0
        for path in sorted((finished / "problems" / name).glob("*.gr")):
            problem = Problem.read(path)
            demand = AStarRouter().route(problem).edge_demand.reshape(-1, 3)[:, :2]
            capacity = problem.capacity.reshape(-1, 3)[:, :2]
            full += bool(((capacity > 0) & (demand >= capacity)).any())
        expected[name] = {"I": count - full, "II": full}
    assert json.loads((finished / "summary.json").read_text())["types"] == expected
    # Both there, for the test's sake.
    assert all(sum(of[kind] for of in expected.values()) for kind in ("I", "II"))


@pytest.mark.usefixtures("_undrawn")
def test_results_are_there_of_the_routers_that_are_done(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An experiment that is broken off in its trainings: all others can be read, as in the end."""
    config = load_experiment(everything(tmp_path, jobs=1))

    def without_trainings(parts: Sequence[Any], *how: Any) -> Iterator[list[Any]]:
        for done in in_this_process(parts, *how):
            if any(part.entry.trains for part in done):
                raise KeyboardInterrupt
            yield done

    monkeypatch.setattr("policies.experiment.experiment.work_on", without_trainings)
    with pytest.raises(KeyboardInterrupt):
        Experiment(config).execute()
    there = results(Path(config.out))
    assert there == [row for row in results(finished) if row["kind"] != "dqn"]
    summary = json.loads((Path(config.out) / "summary.json").read_text())
    assert [row["router"] for row in summary["sets"]["all"]] == ["random", "astar", "best"]


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_one_process_finds_the_same_as_two(finished: Path, tmp_path: Path) -> None:
    config = load_experiment(everything(tmp_path))
    summary = Experiment(config).execute()
    assert outcome(tmp_path / "out") == outcome(finished)
    kept = json.loads((finished / "summary.json").read_text())
    assert untimed(json.loads(json.dumps(summary["sets"]))) == untimed(kept["sets"])


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_a_trained_policy_can_take_part(finished: Path, tmp_path: Path) -> None:
    """Of several networks in a file each problem is walked by its own; nothing is trained."""
    trained = finished / "runs" / "small" / "dqn.seed0" / "problem_000"
    problems = [str(trained / "problems")]
    routers = {"walk": {"router": "dqn", "checkpoint": str(trained / "policy.pt")}}
    config = write_config(tmp_path / "c.yaml", problems={"two": problems}, routers=routers)
    summary = Experiment(load_experiment(config, ["seeds=[0, 1]"])).execute()
    assert [row["seeds"] for row in summary["sets"]["two"]] == [1]
    for path in sorted((trained / "problems").iterdir()):
        problem = Problem.read(path)
        walked = TrainedPolicy.load(trained / "policy.pt", path.stem).solve(problem).solution
        file = tmp_path / "out" / "solutions" / "two" / f"{path.stem}.walk.solution"
        assert Solution.read(file, problem) == walked


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"checkpoint": "nope.pt"}, "nope.pt: cannot be read"),
        ({"checkpoint": "garbage.solution"}, "garbage.solution: expected a checkpoint"),
        ({**DQN, "learner": {"burn_in": "garbage.solution"}}, "expected a folder"),
        ({**DQN, "train": {"device": "cuda:99"}}, "device: expected cpu"),
    ],
)
def test_what_is_wrong_is_said_before_there_is_a_folder(
    options: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("garbage.solution").write_text("garbage\n")
    routers = {"late": {"router": "dqn", **options}}
    config = write_config(tmp_path / "c.yaml", problems={"small": SMALL}, routers=routers)
    with pytest.raises(InputError, match=message):
        Experiment(load_experiment(config))
    assert not (tmp_path / "out").exists()


# --- going on -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_nothing_is_done_twice(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    (folder / "results.json").unlink()
    config = load_experiment(folder / "config.yaml", [f"out={folder}", "jobs=1"])
    with monkeypatch.context() as patch:
        patch.setattr("policies.experiment.experiment.work_on", None)
        Experiment(config).execute()
    assert outcome(folder) == outcome(finished)
    # And when some of it is missing, that is done, and no more.
    lost = ["small/astar/problem_001.json", "small/dqn.seed0/problem_000.json"]
    before = {path: path.stat().st_mtime_ns for path in (folder / "rows").rglob("*.json")}
    for name in lost:
        (folder / "rows" / name).unlink()
    Experiment(config).execute()
    assert outcome(folder) == outcome(finished)
    after = {path: path.stat().st_mtime_ns for path in (folder / "rows").rglob("*.json")}
    changed = {
        str(path.relative_to(folder / "rows")) for path in after if after[path] != before[path]
    }
    quoted = {f"{name}/best/problem_000.json" for name in ("small", "other")}
    assert changed == {*lost, *quoted}  # what others published is read again


def test_problems_are_those_it_started_with(tmp_path: Path) -> None:
    """Even if they were random ones, or their files are gone."""
    config = write_config(tmp_path / "c.yaml", problems={"any": {**SMALL, "seed": None}})
    Experiment(load_experiment(config))
    kept = {path.name: path.read_text() for path in (tmp_path / "out/problems/any").iterdir()}
    again = Experiment(load_experiment(config))
    assert again.sets["any"] == {
        f"problem_{i:03d}": Problem.read(tmp_path / f"out/problems/any/problem_{i:03d}.gr")
        for i in range(3)
    }
    assert kept == {
        path.name: path.read_text() for path in (tmp_path / "out/problems/any").iterdir()
    }


@pytest.mark.parametrize("seed", [1, None])
def test_drawn_problems_that_are_lost_or_others_are_refused(
    tmp_path: Path, seed: int | None
) -> None:
    config = write_config(tmp_path / "c.yaml", problems={"s": {**SMALL, "seed": seed}})
    Experiment(load_experiment(config))
    kept = tmp_path / "out/problems/s"
    first, second = kept / "problem_000.gr", kept / "problem_001.gr"
    text = first.read_text()
    shutil.copy(second, kept / "problem_007.gr")
    with pytest.raises(InputError, match=r"problem_007\.gr: expected the problem of s, found an"):
        Experiment(load_experiment(config))
    (kept / "problem_007.gr").unlink()
    first.unlink()
    with pytest.raises(InputError, match=r"problem_000\.gr: expected the problem of s, found none"):
        Experiment(load_experiment(config))
    if seed is not None:
        shutil.copy(second, first)
        with pytest.raises(InputError, match=r"problem_000\.gr: expected the problem of s, found "):
            Experiment(load_experiment(config))
    first.write_text(text)
    Experiment(load_experiment(config))


def test_solutions_and_figures_follow_the_rows(tmp_path: Path) -> None:
    """A solution that is lost is made again; figures of an earlier state are removed."""
    config = write_config(tmp_path / "c.yaml", routers=ASTAR)
    Experiment(load_experiment(config)).execute()
    out = tmp_path / "out"
    solution = out / "solutions/small/problem_001.a.solution"
    text = solution.read_text()
    solution.unlink()
    earlier = out / "figures/small_gap.png"
    earlier.write_bytes(PNG)
    Experiment(load_experiment(config)).execute()
    assert solution.read_text() == text
    assert {path.name for path in earlier.parent.iterdir()} == {
        "small_overflow.png", "small_wirelength.png",
    }  # fmt: skip


def test_problems_that_have_changed_are_refused(tmp_path: Path) -> None:
    problems = generate(2, (4, 4, 2), nets=4, reduced_edges=0)
    for form in ("files", "one", "folders"):
        here = tmp_path / form
        file = here / "set/a.gr"
        problems[0].write(file)
        source = {"files": {"s": str(file.parent)}, "one": {"s": [str(file)]}, "folders": str(here)}
        config = write_config(here / "c.yaml", problems=source[form])
        Experiment(load_experiment(config)).execute()
        Experiment(load_experiment(config))
        problems[1].write(file)
        with pytest.raises(InputError, match=r"a\.gr: expected the problem of .*, found another"):
            Experiment(load_experiment(config))
        problems[0].write(file)
        if form != "one":
            problems[1].write(file.with_name("b.gr"))
            with pytest.raises(InputError, match=r"b\.gr: expected the problem of"):
                Experiment(load_experiment(config))
        shutil.rmtree(file.parent)
        Experiment(load_experiment(config))  # its copies are enough


def test_what_is_lost_of_a_chip_is_said(tmp_path: Path) -> None:
    write_contest(tmp_path / "contest", 20)
    config = write_config(tmp_path / "c.yaml", problems={"s": [str(tmp_path / "contest.cap")]})
    with pytest.warns(
        UserWarning, match=r"problems\.s: routed and judged as ISPD text, which does"
    ):
        Experiment(load_experiment(config))


def test_seeds_that_a_router_cannot_take_are_refused_first(tmp_path: Path) -> None:
    routers = {"a": {"router": "astar", "net_order": "random"}}
    config = write_config(tmp_path / "c.yaml", routers=routers, seeds=[2**40, 1])
    with pytest.raises(InputError, match="seed: expected a number from 0 to 2147483647"):
        Experiment(load_experiment(config))
    assert not (tmp_path / "out").exists()


LONG = {
    **DQN,
    "env": {},
    "stack": 1,
    "train": {"episodes": 10**6, "checkpoint_seconds": 0},
}


def test_processes_end_with_the_experiment(tmp_path: Path) -> None:
    config = write_config(tmp_path / "c.yaml", routers={"dqn": LONG})
    whole = Experiment(load_experiment(config))
    others = set(multiprocessing.active_children())
    work = work_on(whole.parts, 2, 1)
    assert next(work) == []
    assert len(set(multiprocessing.active_children()) - others) == 2
    work.close()
    assert not set(multiprocessing.active_children()) - others
    work = work_on(whole.parts, 1, 1)
    next(work)
    for process in set(multiprocessing.active_children()) - others:
        process.kill()
    with pytest.raises(InputError, match="a process was killed"):
        next(work)
    assert not set(multiprocessing.active_children()) - others


def test_threads_of_the_processes_are_set_for_them_alone(tmp_path: Path) -> None:
    before = dict(os.environ)
    experiment_of = Experiment(load_experiment(write_config(tmp_path / "c.yaml")))
    assert sum(map(len, work_on(experiment_of.parts, 1, 3))) == 3
    assert dict(os.environ) == before
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == set()


# --- what is refused ------------------------------------------------------------------------------

SET = {"small": SMALL}
ASTAR = {"a": {"router": "astar"}}
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "unknown key": ({"router": ASTAR}, "router: unknown key; did you mean routers?"),
    "no routers": ({"routers": {}}, "routers: expected at least one"),
    "no router": ({"routers": {"a": {}}}, "routers.a: expected a router"),
    "unknown router": ({"routers": {"a": {"router": "astr"}}}, "did you mean astar?"),
    "unknown option": ({"routers": {"a": {"router": "astar", "order": 1}}}, "order: unknown key"),
    "wrong option": (
        {"routers": {"a": {"router": "random", "max_steps": "x"}}},
        "routers.a: max_steps: ",
    ),
    "seed of a router": ({"routers": {"a": {"router": "random", "seed": 1}}}, "a: seed: expected"),
    "router's name": ({"routers": {"a.b": {"router": "astar"}}}, "routers.a.b: expected a name"),
    "set's name": ({"problems": {"a/b": SMALL}}, "problems.a/b: expected a name"),
    "set called all": ({"problems": {"all": SMALL}}, "problems.all: expected another name"),
    "unknown reference": ({"reference": "astar"}, "reference: unknown name 'astar'"),
    "only a text": ({"routers": {"a": {"router": "astar", "only": "small"}}}, "only: expected"),
    "only elsewhere": (
        {"routers": {"a": {"router": "astar", "only": ["smal"]}}},
        "routers.a.only: unknown name 'smal'; did you mean small?",
    ),
    "no problems": ({"problems": {}}, "problems: expected at least one set"),
    "problems a number": ({"problems": 3}, "problems: expected a folder or sets"),
    "wrong problems": ({"problems": {"s": {"nets": 0}}}, "problems.s: "),
    "no such folder": ({"problems": "nowhere"}, "problems: nowhere: expected .gr files"),
    "no such file": ({"problems": {"s": "nowhere.gr"}}, "problems.s: nowhere.gr: "),
    "no seeds": ({"seeds": []}, "seeds: expected at least one"),
    "seeds twice": ({"seeds": [1, 1]}, "seeds: expected every seed once"),
    "negative seed": ({"seeds": [-1]}, "seeds: expected numbers from 0"),
    "no jobs": ({"jobs": 0}, "jobs: expected a number from 1"),
    "unknown key of a training": (
        {"routers": {"d": {"router": "dqn", "learner": {"gama": 1}}}},
        "learner.gama: unknown key; did you mean gamma?",
    ),
    "problem of a training": (
        {"routers": {"d": {"router": "dqn", "env": {"problem": "p.gr"}}}},
        "env.problem: expected none",
    ),
    "no such training": (
        {"routers": {"d": {"router": "dqn", "config": "nowhere.yaml"}}},
        "nowhere.yaml: cannot be read",
    ),
    "checkpoint and training": (
        {"routers": {"d": {"router": "dqn", "checkpoint": "c.pt", "learner": {"gamma": 1.0}}}},
        "checkpoint: expected no keys of a training",
    ),
    "no such scenario": (
        {"problems": {"s": {"scenario": "toy-4x4-v9"}}},
        "problems.s: scenario: did you mean toy-4x4-v0? expected one of toy-4x4-v0",
    ),
    "the training problems of a scenario": (
        {"problems": {"s": {"scenario": "toy-4x4-v0", "split": "train"}}},
        "problems.s: split: expected one of test, validation, found 'train'",
    ),
    "no budget": ({"routers": {"a": {"router": "astar", "budget": "x"}}}, "budget: expected"),
    "no solutions": (
        {"routers": {"a": {"router": "solutions", "folder": "."}}},
        ".: expected one solution problem_000.*, found none",
    ),
    "training without a number": (
        {"routers": {"a": {"router": "astar", "training_seconds": "1"}}},
        "routers.a: training_seconds: expected a number from 0",
    ),
    "only nothing": (
        {"routers": {"a": {"router": "astar", "only": []}}},
        "only: expected a list of sets, found []",
    ),
    "empty stack": ({"routers": {"d": {"router": "dqn", "stack": 0}}}, "stack: expected"),
    "shared by two grids": (
        {
            "problems": {"s": ["4.gr", "5.gr"]},
            "routers": {"d": {"router": "dqn", "train": {"shared": True}}},
        },
        "routers.d.train.shared: expected a set of one grid shape",
    ),
    "no such publication": (
        {"routers": {"p": {"router": "published", "file": "nowhere.csv"}}},
        "nowhere.csv: cannot be read",
    ),
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder but for two problems of different grids."""
    monkeypatch.chdir(tmp_path)
    generate(1, grid=(4, 4, 2), nets=3)[0].write("4.gr")
    generate(1, grid=(5, 4, 2), nets=3)[0].write("5.gr")
    return tmp_path


@pytest.mark.parametrize(("keys", "said"), REFUSED.values(), ids=REFUSED)
def test_bad_configurations(
    keys: dict[str, Any], said: str, here: Path, refused: Callable[..., str]
) -> None:
    config = write_config(here / "c.yaml", **{"routers": ASTAR, **keys})
    assert said in refused("experiment", config)
    assert not (here / "out" / "config.yaml").exists()
    assert not (here / "out" / "rows").exists()


def test_a_name_stands_once(here: Path, refused: Callable[..., str]) -> None:
    text = "routers:\n  a: {router: astar}\n  a: {router: random}\nproblems: {s: {nets: 3}}\n"
    (here / "c.yaml").write_text(text)
    assert "c.yaml:3: expected YAML: the key a occurs twice" in refused("experiment", "c.yaml")


PUBLICATIONS: dict[str, tuple[str, str]] = {
    "empty": ("", "p.csv:1: expected a column set"),
    "a column less": ("set,problem,overflow\n", "p.csv:1: expected a column wirelength"),
    "a row less": (
        "set,problem,overflow,wirelength\nsmall,problem_000,0,9\n",
        "p.csv: expected a row for small,problem_001",
    ),
    "no number": (
        "set,problem,overflow,wirelength\nsmall,problem_000,0,x\n",
        "p.csv:2: wirelength: expected a whole number, found 'x'",
    ),
    "half a row": (
        "set,problem,overflow,wirelength\nsmall\n",
        "p.csv:2: expected 4 cells as in line 1, found 1",
    ),
    "a cell too many": (
        "set,problem,overflow,wirelength\nsmall,problem_000,0,9,\n",
        "p.csv:2: expected 4 cells as in line 1, found 5",
    ),
    "a column twice": (
        "set,problem,overflow,wirelength,overflow\n",
        "p.csv:1: expected a column overflow, and only one",
    ),
    "a negative number": (
        "set,problem,overflow,wirelength\nsmall,problem_000,0,-9\n",
        "p.csv:2: wirelength: expected a whole number, found '-9'",
    ),
    "digits of another kind": (
        "set,problem,overflow,wirelength\nsmall,problem_000,0,１２\n",
        "p.csv:2: wirelength: expected a whole number, found '１２'",
    ),
    "too large a number": (
        "set,problem,overflow,wirelength\nsmall,problem_000,0,9999999999999999999\n",
        "p.csv:2: wirelength: expected a number from 0 to 9.22337e+18",
    ),
    "no name": (
        "set,problem,overflow,wirelength\nsmall,,0,9\n",
        "p.csv:2: problem: expected a name for files",
    ),
    "a NUL": (
        "set,problem,overflow,wirelength\nsmall,problem\0,0,9\n",
        "p.csv:2: problem: expected a name for files",
    ),
    "an open quote": (
        'set,problem,overflow,wirelength\nsmall,"problem_000,0,9\n',
        "p.csv:2: expected CSV: unexpected end of data",
    ),
    "a huge field": (
        "set,problem,overflow,wirelength\nsmall," + 200_000 * "x" + ",0,9\n",
        "p.csv:2: expected CSV: field larger than field limit",
    ),
    "a row twice": (
        "set,problem,overflow,wirelength\n" + 2 * "small,problem_000,0,9\n",
        "p.csv:3: expected small/problem_000 once",
    ),
    "no text": ("\udcff", "p.csv: expected UTF-8 text"),
}


@pytest.mark.parametrize(("text", "said"), PUBLICATIONS.values(), ids=PUBLICATIONS)
def test_bad_publications(text: str, said: str, here: Path, refused: Callable[..., str]) -> None:
    (here / "p.csv").write_bytes(text.encode("utf-8", "surrogateescape"))
    routers = {"p": {"router": "published", "file": "p.csv"}}
    assert said in refused("experiment", write_config(here / "c.yaml", routers=routers))


CHANGED: dict[str, tuple[str, str]] = {
    "option": ("routers.dqn.learner.gamma=0.5", "routers.dqn.learner.gamma: expected 0.95"),
    "problems": ("problems.small.nets=4", "problems.small.nets: expected 3"),
    "another router of that name": ("routers.up={router: random}", "routers.up.router: expected"),
    "sets of another kind": ("problems=4.gr", "problems.small.count: expected 3"),
}


@pytest.mark.parametrize(("change", "said"), CHANGED.values(), ids=CHANGED)
def test_an_experiment_goes_on_as_it_started(
    change: str, said: str, finished: Path, refused: Callable[..., str]
) -> None:
    before = (finished / "results.json").read_bytes()
    assert said in refused("experiment", finished / "config.yaml", change)
    assert (finished / "results.json").read_bytes() == before


def names_and_seeds(folder: Path) -> set[tuple[Any, ...]]:
    """Whose rows the results hold."""
    rows = json.loads((folder / "results.json").read_text())
    return {(row["set"], row["router"], row["seed"]) for row in rows}


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_routers_seeds_and_sets_come_and_go(here: Path, refused: Callable[..., str]) -> None:
    routers = {"a": {"router": "astar"}, "r": {"router": "random", "max_steps": 9}}
    config = write_config(here / "c.yaml", routers=routers, seeds=[3])

    def run(*changes: str) -> set[tuple[Any, ...]]:
        Experiment(load_experiment(config, changes)).execute()
        return names_and_seeds(here / "out")

    small = {("small", "a", None), ("small", "r", 3)}
    assert run("routers.r=null") == {("small", "a", None)}
    rows = {path: path.stat().st_mtime_ns for path in (here / "out" / "rows").rglob("*.json")}
    assert run() == small
    alone = {("small", "r", 3)}
    assert run("routers.a=null", "reference=r") == alone
    # What is left out is kept, and must still be the same when it comes back.
    changed = "routers.a.net_order=file"
    assert "routers.a.net_order: expected 'half_" in refused("experiment", config, changed)
    assert run("seeds=[3, 5]") == small | {("small", "r", 5)}
    other = f"problems.other={json.dumps(OTHER)}"
    both = small | {("other", "a", None), ("other", "r", 3)}
    assert run(other) == both
    assert run(other, "routers.r.only=[other]") == both - alone
    assert "problems.other.nets: expected 4" in refused(
        "experiment", config, other, "problems.other.nets=3"
    )
    assert run() == small
    assert run(other) == both
    assert {path: path.stat().st_mtime_ns for path in rows} == rows
    everything_so_far = Experiment(load_experiment(here / "out" / "config.yaml"))
    assert set(everything_so_far.sets) == {"small", "other"}


def test_a_folder_that_holds_problems_of_a_new_set(here: Path, refused: Callable[..., str]) -> None:
    config = write_config(here / "c.yaml", routers=ASTAR)
    Experiment(load_experiment(config))
    (here / "out" / "problems" / "other").mkdir()
    shutil.copy("4.gr", here / "out" / "problems" / "other" / "4.gr")
    said = refused("experiment", config, "problems.other={nets: 2}")
    assert "4.gr: expected only problems of this experiment" in said


def test_folders_that_hold_something_else(
    finished: Path, here: Path, refused: Callable[..., str]
) -> None:
    config = write_config(here / "c.yaml")
    (here / "r" / "rows").mkdir(parents=True)
    assert "r: expected a new or an empty folder, found rows in it" in refused(
        "experiment", config, f"out={here / 'r'}"
    )
    run = finished / "runs" / "small" / "dqn.seed0" / "problem_000"
    assert "holds a training" in refused("experiment", config, f"out={run}")
    (here / "e").mkdir()
    (here / "e" / "config.yaml").touch()
    assert "holds config.yaml without routers" in refused("experiment", config, f"out={here / 'e'}")
    (here / "a" / "problems" / "small").mkdir(parents=True)
    shutil.copy("4.gr", here / "a" / "problems" / "small" / "4.gr")
    assert "4.gr: expected only problems of" in refused("experiment", config, f"out={here / 'a'}")


def test_rows_that_are_none(finished: Path, here: Path, refused: Callable[..., str]) -> None:
    shutil.copytree(finished, here / "copy")
    damaged = here / "copy" / "rows" / "small" / "astar" / "problem_000.json"
    (row,) = json.loads(damaged.read_text())
    for text, said in (
        ("", ": expected rows in JSON: "),
        ("{}", ": expected rows in JSON: "),
        ("[1]", ": row 1: expected a mapping, found 1"),
        ("[{}]", ": row 1: set: expected a value, found none"),
        (json.dumps([row, row]), ": row 2: expected every router once for each problem and seed"),
        (json.dumps([{**row, "overflow": -5}]), ": row 1: overflow: expected a number from 0 to "),
        (json.dumps([{**row, "overflow": True}]), ": row 1: overflow: expected a whole number"),
        (json.dumps([{**row, "seconds": math.nan}]), ": row 1: seconds: expected a number or null"),
        (json.dumps([{**row, "joined": 99}]), ": row 1: joined: expected at most the tasks"),
        (json.dumps([{**row, "joined": None}]), ": row 1: joined: expected at most the tasks"),
        (json.dumps([{**row, "vias": 10**6}]), ": row 1: vias: expected at most the wirelength"),
        (json.dumps([{**row, "set": "../x"}]), ": row 1: set: expected a name for files"),
    ):
        damaged.write_text(text)
        line = refused("experiment", here / "copy" / "config.yaml", f"out={here / 'copy'}")
        assert f"{damaged}{said}" in line
        (here / "copy" / "results.json").write_text(text)
        assert f"results.json{said}" in refused("plot", here / "copy")
    damaged.write_text(json.dumps([{**row, "router": "random"}]))
    line = refused("experiment", here / "copy" / "config.yaml", f"out={here / 'copy'}")
    assert f"{damaged}: expected rows of small, astar, problem_000" in line


def test_an_error_at_work_is_one_line(here: Path, refused: Callable[..., str]) -> None:
    routers = {"walk": {"router": "random", "max_steps": 0}, **ASTAR}
    config = write_config(here / "c.yaml", routers=routers, jobs=1)
    assert "small, walk.seed0: max_steps: expected 1 to" in refused("experiment", config)
    assert not (here / "out" / "results.json").exists()


# --- the command line, the figures ----------------------------------------------------------------


@pytest.mark.usefixtures("_undrawn")
def test_the_command_prints_a_table_or_one_object(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["experiment", str(finished / "config.yaml")]) == 0
    text = capsys.readouterr().out
    summary = json.loads((finished / "summary.json").read_text())
    for name, size in (("small", 3), ("other", 2), ("all", 5)):
        assert f"{name}: {size} problems" in text
        for kind, count in summary["types"].get(name, {}).items():
            assert f"{count} of Type {kind}" in text
        for row in summary["sets"][name]:
            cells = [f"{row['overflow']:.6g}", f"{row['wirelength']['mean']:.1f}"]
            lines = [line for line in text.splitlines() if line.split()[:1] == [row["router"]]]
            assert any(set(cells) <= set(line.split()) for line in lines)
    assert status(["experiment", str(finished / "config.yaml"), "--json"]) == 0
    out, _ = capsys.readouterr()
    assert json.loads(out) == summary


def test_plot_draws_an_experiment(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kinds = ("gap", "overflow", "decrease")
    names = {f"{name}_{kind}.png" for name in ("small", "other", "all") for kind in kinds}
    assert {path.name for path in (finished / "figures").iterdir()} == names
    assert status(["plot", str(finished), "--out", str(tmp_path / "f")]) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert {path.name for path in written} == names
    assert set(written) == set((tmp_path / "f").iterdir())
    assert all(path.read_bytes().startswith(PNG) for path in written)


CALLED = {"random": "random walks", "dqn": "DQN", "astar": "A*", "up": "smallest first"}
"""What figures call the routers of the finished experiment."""


def marks(axes: Any) -> dict[str, Any]:
    """What a plot by problem shows of each router: NaN where it shows nothing."""
    return {line.get_label().split(" (")[0]: line.get_ydata() for line in axes.get_lines()}


def test_figures_show_the_rows(finished: Path, tmp_path: Path, drawn: dict[str, Any]) -> None:
    plot.experiment_figures(finished, tmp_path)
    rows = [row for row in results(finished) if row["set"] == "small"]

    def means(router: str, quantity: str) -> list[float]:
        """By problem; NaN where connections are open."""
        found = []
        for problem in sorted({row["problem"] for row in rows}):
            own = [row for row in rows if (row["router"], row["problem"]) == (router, problem)]
            whole = [row[quantity] for row in own if row["joined"] == row["tasks"]]
            if quantity == "overflow":
                whole = [row[quantity] for row in own]
            found.append(sum(whole) / len(whole) if whole else math.nan)
        return found

    astar = means("astar", "wirelength")
    order = np.argsort(astar, kind="stable")
    (axes,) = drawn["small_overflow"].axes
    shown = marks(axes)
    assert list(shown) == ["A*", "random walks", "smallest first", "DQN", "best"]
    assert "overflow" in axes.get_ylabel()
    assert axes.get_xlabel() == "problems, sorted by A*'s wirelength [rank]"
    for line in axes.get_lines():
        np.testing.assert_array_equal(line.get_xdata(), [1, 2, 3])
    for name, label in CALLED.items():
        expected = np.array(means(name, "overflow"))[order]
        expected[np.isnan(np.array(means(name, "wirelength"))[order])] = np.nan
        np.testing.assert_allclose(shown[label], expected)
    (axes,) = drawn["small_gap"].axes
    labels = [label.get_text().split("\n")[0] for label in axes.get_yticklabels()]
    assert labels == list(shown)
    gaps: dict[str, dict[str, list[float]]] = {label: {} for label in labels}
    for row in rows:
        if row["gap"] is not None:
            own = gaps[CALLED.get(row["router"], row["router"])]
            own.setdefault(row["problem"], []).append(row["gap"])
    dots = [line.get_xdata() for line in axes.get_lines() if line.get_marker() == "o"]
    for (label, own), found in zip(gaps.items(), dots, strict=True):
        expected = sorted(sum(values) / len(values) for values in own.values())
        np.testing.assert_allclose(found, expected, err_msg=label)
    panels = drawn["small_decrease"].axes
    titles = {label: name for name, label in {**CALLED, "best": "best"}.items() if name != "astar"}
    assert {axes.get_title().split(":")[0] for axes in panels} == set(titles)
    for axes in panels:
        name = titles[axes.get_title().split(":")[0]]
        decrease = np.array(astar) - means(name, "wirelength")
        assert sum(bar.get_height() for bar in axes.patches) == np.count_nonzero(
            ~np.isnan(decrease)
        )
        lower = f"lower on {np.count_nonzero(decrease > 0)} of"
        assert lower in axes.get_title() or np.isnan(decrease).all()


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_scenarios_budgets_and_solutions_from_elsewhere(here: Path) -> None:
    problems = scenarios.get("toy-4x4-v0").problems("validation")
    for name, problem in problems.items():
        sequential_astar(problem, "file").write(here / "made" / f"{name}.solution")
    routers = {
        **ASTAR,
        "tries": {"router": "astar", "budget": 3},
        "made": {"router": "solutions", "folder": "made"},
    }
    sets = {"toys": {"scenario": "toy-4x4-v0", "split": "validation"}}
    config = load_experiment(write_config(here / "c.yaml", problems=sets, routers=routers))
    assert config.routers["tries"]["best_of"] == 3
    for _ in range(2):  # the second time the folder is read again
        Experiment(config).execute()
        rows = json.loads((here / "out" / "results.json").read_text())
        found = {(row["router"], row["problem"]): row for row in rows}
        assert [name for router, name in found if router == "made"] == sorted(problems)
        for name, problem in problems.items():
            row, judged = found["made", name], evaluate(problem, sequential_astar(problem, "file"))
            assert (row["wirelength"], row["seconds"]) == (judged.wirelength, None)
            assert row["open_nets"] == len(judged.disconnected)


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_solutions_are_pruned_where_an_entry_says_so(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of routers and of trainings: what joins nothing goes, and the rest stays as it was."""
    routers = {
        **ASTAR,
        "walks": {"router": "random"},
        "pruned-walks": {"router": "random", "prune": True},
        "dqn": DQN,
        "pruned-dqn": {**DQN, "prune": True},
    }
    config = write_config(here / "c.yaml", routers=routers)
    assert status(["experiment", str(config)]) == 0
    shown = capsys.readouterr().out
    rows = {(row["router"], row["problem"]): row for row in results(here / "out")}
    less = 0
    for (router, problem), row in rows.items():
        if not router.startswith("pruned-"):
            continue
        plain = rows[router.removeprefix("pruned-"), problem]
        assert row["wirelength"] == row["pruned_wirelength"] == plain["pruned_wirelength"]
        assert row["overflow"] == row["pruned_overflow"] == plain["pruned_overflow"]
        assert row["joined"] == plain["joined"]
        less += plain["wirelength"] - row["wirelength"]
        file = here / "out" / "solutions" / "small" / f"{problem}.{router}.seed0.solution"
        routed = Problem.read(here / "out" / "problems" / "small" / f"{problem}.gr")
        assert evaluate(routed, Solution.read(file, routed)).wirelength == row["wirelength"]
    assert less > 0
    summary = json.loads((here / "out" / "summary.json").read_text())["sets"]["small"]
    walks = next(row for row in summary if row["router"] == "walks")
    assert walks["pruned_wirelength"]["mean"] < walks["wirelength"]["mean"]
    assert "pruned: the mean wirelength without dangling branches and loops" in " ".join(
        shown.split()
    )
    assert f"{walks['pruned_wirelength']['mean']:.1f}" in shown


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"prune": 1}, "prune: expected true or false"),
        ({"label": ""}, "label: expected a text of at most 80 characters"),
        ({"label": "x" * 81}, "label: expected a text of at most 80 characters"),
        ({"label": 3}, "label: expected a text of at most 80 characters"),
    ],
)
def test_what_an_entry_may_not_say(
    entry: dict[str, Any], said: str, here: Path, refused: Callable[..., str]
) -> None:
    config = write_config(here / "c.yaml", routers={"a": {"router": "astar", **entry}})
    assert f"routers.a: {said}" in refused("experiment", config)


def test_labels_of_entries(here: Path) -> None:
    """Its own, or that of its kind if no other is of this kind; two that are alike differ."""
    routers = {
        "baseline": {"router": "astar"},
        "p": {"router": "pathfinder"},
        "pathfinder": {"router": "pathfinder"},
        "rate1e-3": {**DQN, "label": "learning rate 1e-3"},
        "rate1e-5": DQN,
        "x": {"router": "random", "label": "walks"},
        "y": {"router": "optimal", "label": "walks"},
    }
    path = write_config(here / "c.yaml", routers=routers)
    labels = plot.read_labels(path)
    assert [labels[name] for name in routers] == [
        "A*", "p", "negotiated congestion", "learning rate 1e-3", "rate1e-5", "walks (x)",
        "walks (y)",
    ]  # fmt: skip
    # A label may change: no result depends on it.
    keys = {"out": str(here / "o"), "routers": {"a": {"router": "astar", "label": "first"}}}
    Experiment(load_experiment(write_config(here / "d.yaml", **keys)))
    keys["routers"]["a"]["label"] = "second"
    Experiment(load_experiment(write_config(here / "d.yaml", **keys)))
    assert plot.read_labels(here / "o" / "config.yaml")["a"] == "second"


@pytest.mark.usefixtures("_undrawn")
def test_keys_of_the_run_reach_every_training(here: Path) -> None:
    routers = {**ASTAR, "wide": DQN, "slim": {**DQN, "train": {"episodes": 9, "best": "reward"}}}
    config = write_config(here / "c.yaml", routers=routers, train={"evaluate_every": 2})
    asked = load_experiment(config, ["train.episodes=2"])
    kept = {name: asked.routers[name]["train"] for name in ("wide", "slim")}
    for name, best in (("wide", "routes"), ("slim", "reward")):
        assert {**kept[name], "episodes": 2, "evaluate_every": 2, "best": best} == kept[name]
    assert asked.train == {}
    assert asked.routers["a"] == load_experiment(config).routers["a"]
    Experiment(asked)
    assert load_experiment(here / "out" / "config.yaml") == asked
    with pytest.raises(InputError, match=r"routers\.wide: train\.episode: unknown key"):
        load_experiment(config, ["train.episode=2"])
    with pytest.raises(InputError, match="train: expected none: no router of this experiment"):
        load_experiment(write_config(here / "d.yaml"), ["train.episodes=2"])


def test_decreases_fall_into_their_bars() -> None:
    decreases = {
        "a": np.array([0.0, 0.0, 3.0, -2.0, math.nan]),
        "b": np.array([0.0, 1.0, 1.0, 1.0, 1.0]),
    }
    figure = figures.decrease_histogram(decreases, "astar", "title")
    for axes, expected in zip(figure.axes, ({0: 2, 3: 1, -2: 1}, {0: 1, 1: 4}), strict=True):
        shown = {
            round(bar.get_x() + bar.get_width() / 2): int(bar.get_height())
            for bar in axes.patches
            if bar.get_height()
        }
        assert shown == expected
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim()
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    assert "lower on 1 of 4 problems, equal on 2, mean decrease 0.25" in figure.axes[0].get_title()
    with pytest.raises(InputError, match="at least one"):
        figures.decrease_histogram({"a": np.array([math.nan])}, "astar")
    with pytest.raises(InputError, match="at least one"):
        figures.by_problem({}, np.arange(2), "wirelength", "astar")


@given(st.lists(st.integers(-500, 500), min_size=1, max_size=30))
def test_every_decrease_is_in_a_bar(values: list[int]) -> None:
    figure = figures.decrease_histogram({"a": np.array(values, np.float64)}, "astar")
    (axes,) = figure.axes
    for value in values:
        inside = [
            bar for bar in axes.patches if bar.get_x() <= value < bar.get_x() + bar.get_width()
        ]
        assert len(inside) == 1
        assert inside[0].get_height() >= 1
        # A bar never mixes gains with losses, unless it is that of small ones around 0.
        low, high = inside[0].get_x(), inside[0].get_x() + inside[0].get_width()
        assert not low < 0 < high or math.isclose(low, -high)
    assert sum(bar.get_height() for bar in axes.patches) == len(values)


# --- sets and routers by name ---------------------------------------------------------------------


def test_a_folder_of_folders_is_a_set_each(here: Path) -> None:
    for name in ("a", "b"):
        for problem, count in (("x", 1), ("y", 2)):
            generate(1, grid=(4, 4, 2), nets=count)[0].write(
                here / "all_of" / name / f"{problem}.gr"
            )
    (here / "all_of" / "empty").mkdir()
    sets = load_sets("all_of")
    assert {name: list(problems) for name, problems in sets.items()} == {
        "a": ["x", "y"],
        "b": ["x", "y"],
    }
    assert sets["b"]["y"] == Problem.read("all_of/b/y.gr")
    shutil.copy("4.gr", "all_of/z.gr")
    assert list(load_sets("all_of")) == ["all_of", "a", "b"]
    config = load_experiment(write_config(here / "c.yaml"), ["problems=all_of", "out=o"])
    assert list(Experiment(config).sets) == ["all_of", "a", "b"]
    assert set(Experiment(config).sets) == {"all_of", "a", "b"}  # the same as when it goes on


def test_mixed_grids_are_trained_apart(here: Path) -> None:
    shutil.copy("4.gr", "6.gr")
    config = write_config(
        here / "c.yaml", problems={"s": ["4.gr", "5.gr", "6.gr"]}, routers={"dqn": DQN}
    )
    parts = Experiment(load_experiment(config)).parts
    assert [part.problems for part in parts] == [("4", "6"), ("5",)]


def test_a_training_is_that_of_its_file_but_for_what_stands_here(here: Path) -> None:
    (here / "t.yaml").write_text(
        "seed: 5\nout: elsewhere\nenv: {max_steps: 9, reward: {step: -2.0}, problem: p.gr}\n"
        "learner: {gamma: 0.5}\ntrain: {figures: true, tensorboard: true, episodes: 7}\n"
    )
    entry = {"router": "dqn", "config": "t.yaml", "learner": {"masking": True}}
    entry["env"] = {"reward": {"own_edge": 0.0}}
    config = load_experiment(write_config(here / "c.yaml", routers={"dqn": entry}))
    told = config.routers["dqn"]
    assert told["env"]["max_steps"] == 9
    assert told["env"]["reward"] == {
        "kind": "paper", "reached": 100.0, "step": -2.0, "own_edge": 0.0, "overflow_price": 0.0
    }  # fmt: skip
    assert "problem" not in told["env"]
    assert (told["learner"]["gamma"], told["learner"]["masking"]) == (0.5, True)
    assert (told["train"]["episodes"], told["train"]["figures"]) == (7, False)
    assert told["stack"] == 1


def test_routers_are_made_from_plain_options() -> None:
    assert make_router("astar", {"net_order": "file"}) == AStarRouter(net_order="file")
    assert make_router("random", {"seed": 3}) == RandomRouter(3)
    with pytest.raises(
        InputError, match=r"^there: net_ordr: unknown key; did you mean net_order\?"
    ):
        make_router("astar", {"net_ordr": "file"}, "there")
    with pytest.raises(InputError, match="did you mean pathfinder"):
        make_router("pathfindr", {})
    own = ("astar", "random", "greedy", "pathfinder", "optimal")
    seeded = [name for name in own if is_seeded(router_component(name, {}))]
    assert seeded == ["random", "pathfinder"]
    assert is_seeded(router_component("astar", {"best_of": 2}))


MINE = """
import marouting

class Mine:
    def __init__(self, *, order: str, again: int = 1, seed: int = 0) -> None:
        self.order, self.again, self.seed = order, again, seed

    def route(self, problem):
        assert (self.again, self.seed in (0, 3)) == (2, True)
        return marouting.sequential_astar(problem, self.order)

class Elsewhere:
    def route(self, problem):
        return marouting.sequential_astar(problem, "half_perimeter_up")

class Neither:
    pass
"""
"""A module with routers, as a user writes one."""


@pytest.mark.usefixtures("_undrawn", "at_once")
def test_an_error_of_an_own_router_says_where_it_was(here: Path) -> None:
    (here / "my_routers.py").write_text(MINE)
    routers = {"mine": {"router": "my_routers:Mine", "order": "file"}}  # it asserts again=2
    config = write_config(here / "c.yaml", routers=routers, problems={"s": SMALL}, seeds=[3])
    with pytest.raises(AssertionError) as caught:
        status(["experiment", str(config), "--allow-code"])
    assert caught.value.__notes__ == ["while mine.seed3 worked on s"]


@pytest.mark.usefixtures("_undrawn")
def test_own_routers_stand_in_an_experiment(
    here: Path, refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    """As module:Class and by registered names; other processes find them too."""
    (here / "my_routers.py").write_text(MINE)
    register("router", "elsewhere-of-this-test", "my_routers:Elsewhere")
    routers = {
        **ASTAR,
        "mine": {"router": "my_routers:Mine", "order": "file", "again": 2},
        "named": {"router": "elsewhere-of-this-test"},
    }
    problems = {"s": {**SMALL, "nets": 9}}
    sets = {"problems": problems, "seeds": [0, 3], "jobs": 1}
    config = write_config(here / "c.yaml", routers=routers, **sets)
    assert status(["experiment", str(config), "--allow-code"]) == 0
    kept = yaml.safe_load((here / "out" / "config.yaml").read_text())["routers"]
    assert kept["mine"] == {
        "router": "my_routers:Mine", "only": None, "prune": False, "label": None,
        "order": "file", "again": 2,
    }  # fmt: skip
    rows = json.loads((here / "out" / "results.json").read_text())
    assert len(rows) == 3 * (1 + 2 + 1)
    for path in (here / "out" / "problems" / "s").iterdir():
        problem = Problem.read(path)
        for name, order in (("mine.seed3", "file"), ("named", "half_perimeter_up")):
            file = here / "out" / "solutions" / "s" / f"{path.stem}.{name}.solution"
            assert Solution.read(file, problem) == sequential_astar(problem, order)
    capsys.readouterr()
    for router, said in (
        ({"router": "my_routers:Mine"}, "routers.mine: order: "),
        ({"router": "my_routers:Mine", "order": 3}, "routers.mine: order: "),
        ({"router": "my_routers:Mine", "order": "x", "agian": 1}, "did you mean again?"),
        (
            {"router": "my_routers:Neither"},
            "expected a class with a method route or moves, or a learner",
        ),
        ({"router": "my_routers:Nowhere"}, "there is no class Nowhere in my_routers"),
        ({"router": "no_module:Mine"}, "there is no module no_module"),
        (
            {"router": "elsewhere-of-test"},
            "did you mean elsewhere-of-this-test? expected one of astar, ",
        ),
    ):
        write_config(config, routers={"mine": router}, out="another")
        assert said in refused("experiment", config, "--allow-code")


def test_route_takes_options_of_any_router(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = generate(1, nets=40, seed=3)[0]
    problem.write(here / "p.gr")
    assert status(["route", "p.gr", "net_order=half_perimeter_up", "--out", "s", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["router"] == "astar"
    expected = AStarRouter(net_order="half_perimeter_up").route(problem)
    assert expected != AStarRouter().route(problem)
    assert Solution.read("s", problem) == expected


# --- statistics -----------------------------------------------------------------------------------


def row(router: str, problem: int, wirelength: int, **more: Any) -> dict[str, Any]:
    """A row of a set with four connections a problem."""
    base = dict.fromkeys(COLUMNS)
    figures = {"overflow": 0, "wirelength": wirelength, "joined": 4, "tasks": 4, "seconds": 1.0}
    return {
        **base,
        "set": "s",
        "problem": f"p{problem}",
        "router": router,
        **figures,
        "kind": router,
        **more,
    }


@pytest.fixture
def worked() -> list[dict[str, Any]]:
    """Three problems worked out by hand: A*, an optimum, a learner with two seeds."""
    rows = [
        row("astar", 0, 100, seconds=0.5),
        row("astar", 1, 90, overflow=2, seconds=0.1),
        row("astar", 2, 80, seconds=0.2),
        row("best", 0, 100, proven=True),
        row("best", 1, 95, proven=True),
        row("best", 2, 75, proven=True),
        row("dqn", 0, 102, seed=0), row("dqn", 0, 98, seed=1, joined=3),
        row("dqn", 1, 95, seed=0), row("dqn", 1, 89, seed=1, overflow=1),
        row("dqn", 2, 78, seed=0), row("dqn", 2, 80, seed=1),
    ]  # fmt: skip
    add_gaps(rows)
    return rows


def test_rows_by_hand(worked: list[dict[str, Any]]) -> None:
    gaps = [r["gap"] for r in worked]
    expected = [0, None, 100 / 15, 0, 0, 0, 2, None, 0, None, 4, 100 / 15]
    assert [None if g is None else round(g, 9) for g in gaps] == [
        None if g is None else round(g, 9) for g in expected
    ]
    assert rank(worked[1]) == (0, 2, 90)
    assert rank(worked[7]) == (1, 0, 98)
    assert rank(row("p", 0, 7, joined=None, tasks=None)) == (0, 0, 7)


def test_summary_by_hand(worked: list[dict[str, Any]]) -> None:
    astar, best, dqn = summarise(worked, "best")
    assert [r["router"] for r in (astar, best, dqn)] == ["astar", "best", "dqn"]
    assert (astar["problems"], astar["seeds"], dqn["seeds"]) == (3, 1, 2)
    assert (astar["overflow"], best["overflow"], dqn["overflow"]) == (2, 0, 0.5)
    # Without overflow and open connections: of the six rows of the learner four.
    assert (astar["zero_overflow"], best["zero_overflow"], dqn["zero_overflow"]) == (2, 3, 2)
    assert (astar["open"], dqn["open"]) == (0, 0.5)
    assert astar["seconds"] == 0.2
    assert astar["wirelength"]["mean"] == 90
    # The problems' means are 100, 92, 79: mean 271 / 3, t of 2 degrees of freedom 4.3027.
    half = 4.302653 * math.sqrt(
        ((100 - 271 / 3) ** 2 + (92 - 271 / 3) ** 2 + (79 - 271 / 3) ** 2) / 6
    )
    assert dqn["wirelength"] == {
        "mean": pytest.approx(271 / 3),
        "low": pytest.approx(271 / 3 - half),
        "high": pytest.approx(271 / 3 + half),
    }
    # 2, 0 and the mean of 4 and 6.67, where they are known.
    assert dqn["gap"]["mean"] == pytest.approx((2 + 0 + 16 / 3) / 3)
    assert (dqn["gap"]["problems"], astar["gap"]["problems"]) == (3, 2)
    # Less than A*: 102 no, 98 with an open connection no; 95 no, 89 yes; 78 yes, 80 no.
    assert dqn["lower_wirelength"]["percent"] == pytest.approx(100 * (0 + 0.5 + 0.5) / 3)
    assert best["lower_wirelength"]["percent"] == pytest.approx(100 / 3)
    # By open connections, overflow, wirelength: loss, loss; win, win; win, tie.
    assert dqn["against_astar"] == {"wins": 1.5, "ties": 0.5, "losses": 1}
    assert best["against_astar"] == {"wins": 2, "ties": 1, "losses": 0}
    assert dqn["against_reference"] == {"wins": 0, "ties": 0.5, "losses": 2.5}
    assert astar["against_reference"] == {"wins": 0, "ties": 1, "losses": 2}
    assert best["against_reference"] is None
    assert astar["against_astar"] is astar["lower_wirelength"] is astar["spread"] is None
    # Over the seeds: wirelength 275 / 3 and 89, overflow 0 and 1, two values half of √2 apart.
    spread = dqn["spread"]
    assert spread["wirelength"] == pytest.approx((275 / 3 - 89) / math.sqrt(2))
    assert spread["overflow"] == pytest.approx(1 / math.sqrt(2))
    assert spread["zero_overflow"] == pytest.approx(2 / math.sqrt(2))
    assert spread["lower_wirelength"] == pytest.approx(0)
    assert spread["gap"] == pytest.approx((100 / 15 - 2) / math.sqrt(2))


def test_a_reference_with_seeds_meets_every_seed(worked: list[dict[str, Any]]) -> None:
    astar, _, dqn = summarise(worked, "dqn")
    assert astar["against_reference"] == {"wins": 1, "ties": 0.5, "losses": 1.5}
    assert dqn["against_reference"] is None
    _, _, without = summarise(worked, None)
    assert without["against_reference"] is None
    (alone,) = summarise([r for r in worked if r["router"] == "dqn"], "best")
    assert alone["against_astar"] is alone["lower_wirelength"] is alone["against_reference"] is None


def test_what_nobody_joins_has_no_wirelength(worked: list[dict[str, Any]]) -> None:
    lengths = {name: mean_over_seeds(own, "wirelength") for name, own in by_router(worked).items()}
    np.testing.assert_array_equal(lengths["dqn"], [102, 92, 79])
    for own in worked:
        own["joined"] = 0
    assert np.isnan(mean_over_seeds(by_router(worked)["astar"], "wirelength")).all()


def test_sets_are_taken_together_for_routers_that_are_for_all(
    worked: list[dict[str, Any]],
) -> None:
    assert list(by_set(worked)) == ["s"]
    both = [*worked, row("astar", 0, 50, set="t")]
    sets = by_set(both)
    assert list(sets) == ["s", "t", "all"]
    assert sets["all"] == [r for r in both if r["router"] == "astar"]
    (summary,) = summarise(sets["all"])
    assert (summary["problems"], summary["wirelength"]["mean"]) == (4, 80)
    assert list(by_set([*worked, row("z", 0, 5, set="t")])) == ["s", "t"]


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=40))
def test_mean_interval_is_that_of_the_t_test(values: list[float]) -> None:
    found = mean_interval(np.array(values))
    if np.ptp(values) < 1e-6:
        return
    low, high = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    scale = 1e-9 * max(map(abs, values))
    assert found["mean"] == pytest.approx(np.mean(values), abs=scale)
    assert found["low"] == pytest.approx(low, abs=scale)
    assert found["high"] == pytest.approx(high, abs=scale)


def test_mean_interval_of_few() -> None:
    assert mean_interval(np.array([])) == {"mean": None, "low": None, "high": None}
    assert mean_interval(np.array([3.0])) == {"mean": 3.0, "low": None, "high": None}


@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_share_interval_is_wilsons(of: tuple[int, int]) -> None:
    hits, count = of
    expected = stats.binomtest(hits, count).proportion_ci(method="wilson")
    low, high = share_interval(hits / count, count)
    assert (low, high) == pytest.approx((expected.low, expected.high))
    assert (low == 0) == (hits == 0)  # exactly: no 5.55e-15
    assert (high == 1) == (hits == count)


# --- the yardstick --------------------------------------------------------------------------------


def test_the_yardstick_takes_other_problems(here: Path) -> None:
    for name in ("x", "y"):
        (here / "mine" / name).mkdir(parents=True)
        shutil.copy("4.gr", here / "mine" / name)
    config = ROOT / "configs" / "yardstick.yaml"
    experiment = Experiment(load_experiment(config, ["problems=mine", "out=o"]))
    assert list(experiment.sets) == ["x", "y"]


@pytest.mark.slow
def test_the_yardstick_runs_as_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = str(ROOT / "configs" / "yardstick.yaml")
    small = "problems.generated={count: 3, grid: [6, 6, 2], nets: 12, capacity: 2}"
    assert status(["experiment", config, f"out={tmp_path / 'y'}", small, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    found = {row["router"]: row for row in summary["sets"]["generated"]}
    assert list(found) == ["astar", "astar-best", "pathfinder", "optimal", "random"]
    assert found["optimal"]["gap"] == {"mean": 0, "low": 0, "high": 0, "problems": 3}
    for name in ("astar", "astar-best", "pathfinder", "random"):
        assert found[name]["against_reference"]["wins"] == 0
        assert (
            found[name]["gap"] is None or found[name]["gap"]["low"] >= 0 or name.startswith("astar")
        )
    assert found["optimal"]["against_astar"]["losses"] == 0
    assert found["random"]["open"] > 0
    proven = [row["proven"] for row in results(tmp_path / "y") if row["kind"] == "optimal"]
    assert proven == [True] * 3
    cut = ["routers.optimal.time_limit=0", f"out={tmp_path / 'z'}", small, "--json"]
    assert status(["experiment", config, *cut]) == 0
    cut_short = results(tmp_path / "z")
    for row in cut_short:
        if row["kind"] == "optimal" and not row["proven"]:
            assert not any(r["gap"] for r in cut_short if r["problem"] == row["problem"])
