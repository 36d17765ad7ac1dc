"""The command line: what it prints and writes, and what it makes of bad input."""

import csv
import json
import os
import pickle
import shutil
import stat
import subprocess
import sys
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import jsonschema
import numpy as np
import pytest
import torch
import yaml
from conftest import examples
from hypothesis import example, given
from hypothesis import strategies as st
from test_bad_files import GR

import marouting
from marouting import EnvOptions, Field, InputError, Problem, Solution, evaluate, generate
from marouting.config import plain
from marouting.yaml_files import override, read_yaml
from policies.cli.main import cli, status
from policies.cli.tables import show, show_experiment
from policies.experiment import ExperimentConfig, load_experiment
from policies.experiment.benchmark import load_entries
from policies.learned.algorithms.dqn import DQNOptions
from policies.learned.config import Config, TrainOptions, load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.router import LearnedRouter
from policies.learned.run import write_config
from policies.routers.optimal import OptimalRouter
from policies.routers.registry import router_component, router_names

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = ROOT.parent / "shared" / "data" / "liao2019"
KEYS = {"router", "overflow", "max_overflow", "wirelength", "vias", "connected", "seconds"}
PNG = b"\x89PNG\r\n\x1a\n"

SMALL = {
    "env": {
        "problem": {"grid": [4, 4, 2], "nets": 3, "capacity": 2, "seed": 1},
        "max_steps": 12,
    },
    "learner": {
        "burn_in_size": 100,
        "buffer_size": 500,
        "network": {"hidden": [8]},
        "epsilon": 0.3,
    },
    "train": {"episodes": 5, "figures": False, "tensorboard": False},
}
"""A configuration whose training takes a moment."""

FAST = [
    "env.max_steps=12",
    "learner.burn_in_size=100",
    "learner.network.hidden=[8]",
    "train.episodes=5",
]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run on two problems, made by the command line."""
    folder = tmp_path_factory.mktemp("trained")
    (folder / "small.yaml").write_text(yaml.safe_dump(SMALL))
    run = folder / "run"
    arguments = ["train", str(folder / "small.yaml"), f"out={run}", "env.problem.count=2"]
    assert status([*arguments, "train.tensorboard=true"]) == 0
    return run


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder with a problem, a solution of it and a configuration."""
    problem = generate(1, grid=(4, 4, 2), nets=3, capacity=2, seed=1)[0]
    problem.write(tmp_path / "p.gr")
    marouting.sequential_astar(problem).write(tmp_path / "p.solution")
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(SMALL))
    (tmp_path / "file").write_text("a file")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What a command that works prints to standard output."""
    assert status(arguments) == 0
    return capsys.readouterr().out


def only_object(text: str) -> dict[str, Any]:
    """The one JSON object that a text consists of."""
    found = json.loads(text)
    assert isinstance(found, dict)
    return found


def pictures(text: str) -> list[Path]:
    """The pictures whose paths were printed, one a line."""
    paths = [Path(line) for line in text.splitlines()]
    assert paths
    assert len(set(paths)) == len(paths)
    assert all(path.read_bytes().startswith(PNG) for path in paths)
    return paths


# --- generate, route, evaluate --------------------------------------------------------------------


def test_generate_writes_what_the_library_generates(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "--count 3 --grid 5 4 3 --nets 7 --max-pins 3 --capacity 4 --reduced-edges 2 --seed 9"
    printed(capsys, "generate", *text.split(), "--out", "deep/set")
    expected = generate(3, grid=(5, 4, 3), nets=7, max_pins=3, capacity=4, reduced_edges=2, seed=9)
    written = sorted((here / "deep" / "set").iterdir())
    assert [path.name for path in written] == [f"problem_00{i}.gr" for i in range(3)]
    assert [Problem.read(path) for path in written] == expected
    printed(capsys, "generate", "--out", "set")
    assert [Problem.read(path) for path in Path("set").iterdir()] == generate()


ROUTERS: dict[str, list[str]] = {
    "astar": [],
    "random": ["seed=3"],
    "greedy": [],
    "pathfinder": ["seed=3"],
    "optimal": [],
    "dqn": ["seed=3", *FAST],
    "ppo": ["seed=3", "env.max_steps=12", "train.episodes=5"],
}


@pytest.mark.parametrize(("router", "options"), ROUTERS.items(), ids=ROUTERS)
def test_route_prints_the_figures_of_the_solution(
    router: str, options: list[str], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["route", "p.gr", "--router", router, *options]
    shown = only_object(printed(capsys, *command, "--json", "--out", "a/b.solution"))
    assert set(shown) >= KEYS
    assert shown["router"] == router
    assert shown["seconds"] >= 0
    problem = Problem.read("p.gr")
    figures = asdict(evaluate(problem, Solution.read("a/b.solution", problem)))
    assert {name: shown[name] for name in figures if name != "disconnected"} == {
        name: figures[name] for name in figures if name != "disconnected"
    }
    assert type(shown["connected"]) is bool
    # In words the same, and the same again.
    words = dict(line.split(maxsplit=1) for line in printed(capsys, *command).splitlines())
    assert {name: str(shown[name]) for name in KEYS - {"seconds"}} == {
        name: words[name] for name in KEYS - {"seconds"}
    }
    assert sorted(path.name for path in here.iterdir()) == [
        "a",
        "file",
        "p.gr",
        "p.solution",
        "small.yaml",
    ]


@pytest.mark.usefixtures("here")
def test_route_says_what_the_router_reports(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["route", "p.gr", "--router", "optimal"]
    shown = only_object(printed(capsys, *command, "--json"))
    proven = OptimalRouter().solve(Problem.read("p.gr"))
    assert shown["status"] == "optimal"
    assert shown["gap"] == 0
    bound = shown["bound_overflow"], shown["bound_wirelength"]
    assert bound == (proven.bound_overflow, proven.bound_wirelength)
    assert bound == (shown["overflow"], shown["wirelength"])
    assert "bound_wirelength" in printed(capsys, *command)
    cut = only_object(printed(capsys, *command, "time_limit=0", "bound=relaxation", "--json"))
    assert set(cut) == set(shown)
    assert cut["status"] in ("optimal", "time limit")
    assert (cut["bound_overflow"], cut["bound_wirelength"]) <= bound
    passes = only_object(printed(capsys, "route", "p.gr", "--router", "pathfinder", "--json"))
    assert passes["iterations"] >= 1
    assert "status" not in passes


@pytest.mark.usefixtures("here")
def test_a_gap_that_is_infinite_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    """Overflow of which nothing is proven yet: JSON has no infinity."""
    printed(capsys, "generate", "--capacity", "1", "--out", "tight")
    command = ["route", "tight/problem_000.gr", "--router", "optimal", "time_limit=0"]
    text = printed(capsys, *command, "--json")
    assert "Infinity" not in text
    shown = only_object(text)
    assert shown["overflow"] > shown["bound_overflow"]
    assert shown["gap"] is None
    words = dict(line.split(maxsplit=1) for line in printed(capsys, *command).splitlines())
    assert words["status"] == "time limit"
    assert "gap" not in words


def test_astar_is_the_default_router(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = only_object(printed(capsys, "route", "p.gr", "--json", "--out", "mine.solution"))
    assert shown["router"] == "astar"
    assert (here / "mine.solution").read_bytes() == (here / "p.solution").read_bytes()


@pytest.mark.usefixtures("here")
def test_route_trains_what_the_configuration_says(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["route", "p.gr", "--router", "dqn", "--config", "small.yaml", "seed=4"]
    printed(capsys, *command, "--out", "a.solution", "learner.masking=true")
    problem = Problem.read("p.gr")
    expected = LearnedRouter(load_config("small.yaml", ["seed=4", "learner.masking=true"])).route(
        problem
    )
    assert Solution.read("a.solution", problem) == expected
    other = LearnedRouter(load_config("small.yaml", ["seed=5"])).route(problem)
    assert expected != other
    Path("five.yaml").write_text(yaml.safe_dump({**SMALL, "seed": 5}))
    printed(capsys, *command[:4], "--config", "five.yaml", "--out", "b.solution")
    assert Solution.read("b.solution", problem) == other


@pytest.mark.parametrize("name", ["policy.pt", "checkpoint.pt"])
def test_route_with_a_checkpoint(
    name: str, trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for stem in ("problem_000", "problem_001"):  # each with its own network
        path = trained / "problems" / f"{stem}.gr"
        command = ["route", str(path), "--router", "dqn", "--checkpoint", str(trained / name)]
        shown = only_object(printed(capsys, *command, "--json", "--out", "a.solution"))
        problem = Problem.read(path)
        walked = TrainedPolicy.load(trained / name, stem).solve(problem).solution
        assert Solution.read("a.solution", problem) == walked
        for router in ([trained / name], [trained], ["dqn", "--checkpoint", trained]):
            again = ["route", path, "--router", *router, "--json", "--out", "b.solution"]
            assert only_object(printed(capsys, *map(str, again)))["router"] == "dqn"
            if trained / name in router or name == "policy.pt":  # the one that a folder stands for
                assert Solution.read("b.solution", problem) == walked
        assert shown["wirelength"] == evaluate(problem, walked).wirelength
    assert (here / "a.solution").exists()


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("env.problem.nets=3", "env.problem.nets: expected no such key: PROBLEM is routed"),
        ("env.scenario=toy-4x4-v0", "env.scenario: expected no such key: PROBLEM is routed"),
        ("out=x", "out: expected no such key: nothing but --out is written"),
        ("train.figures=true", "train.figures: expected no such key: nothing but --out"),
    ],
)
@pytest.mark.usefixtures("here")
def test_keys_without_an_effect_on_a_route_are_refused(
    key: str, said: str, refused: Callable[..., str]
) -> None:
    assert said in refused("route", "p.gr", "--router", "dqn", key)


def test_a_checkpoint_of_another_learner_is_refused(
    trained: Path, refused: Callable[..., str]
) -> None:
    problem, policy = trained / "problems/problem_000.gr", trained / "policy.pt"
    command = ["route", str(problem), "--router", "ppo", "--checkpoint", str(policy)]
    assert "--router: expected dqn, as in" in refused(*command)


def test_convert_writes_the_same_problem(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = replace(Problem.read("p.gr"), adjustments=())
    problem.write("plain.gr")
    assert "4x4x2, 3 nets" in printed(
        capsys, "convert", "plain.gr", "deep/p.txt", "--format", "ispd98"
    )
    assert Problem.read("deep/p.txt") == problem
    assert (here / "deep" / "p.txt").read_text().count("minimum width") == 2
    printed(capsys, "convert", "deep/p.txt", "again.gr")
    assert Path("again.gr").read_bytes() == Path("plain.gr").read_bytes()
    # Whatever reads problems reads them all.
    routed = [
        only_object(printed(capsys, "route", name, "--json")) for name in ("plain.gr", "deep/p.txt")
    ]
    assert len({(row["overflow"], row["wirelength"]) for row in routed}) == 1


def test_convert_refuses_what_the_format_cannot_hold(refused: Callable[..., str]) -> None:
    shown = refused("convert", "p.gr", "out.txt", "--format", "ispd98", out="out.txt")
    assert shown.startswith("out.txt: the format ispd98 cannot hold it: expected no adjustments")
    shown = refused("convert", "p.gr", "out.txt", "--format", "ispd98-flat", out="out.txt")
    assert "expected one layer, found 2" in shown
    assert "ispd98-flat" in refused("convert", "p.gr", "out.txt", "--format", "ispd99")
    assert "p.solution:1" in refused("convert", "p.solution", "out.txt")
    assert "missing.gr" in refused("convert", "missing.gr", "out.txt")


@pytest.mark.usefixtures("here")
def test_evaluate_prints_the_figures(capsys: pytest.CaptureFixture[str]) -> None:
    shown = only_object(printed(capsys, "evaluate", "p.gr", "p.solution", "--json"))
    problem = Problem.read("p.gr")
    figures = evaluate(problem, Solution.read("p.solution", problem))
    assert set(shown) >= KEYS
    assert shown["wirelength"] == figures.wirelength > 0
    assert shown["connected"] is True
    nothing = Solution(problem, tuple(np.empty(0, np.int64) for _ in problem.nets))
    nothing.write("nothing.solution")
    text = printed(capsys, "evaluate", "p.gr", "nothing.solution")
    assert "False" in text
    assert all(net.name in text.splitlines()[-1] for net in problem.nets)


@pytest.mark.usefixtures("here")
def test_what_joins_nothing_is_told_and_pruned_when_asked(
    capsys: pytest.CaptureFixture[str],
) -> None:
    walks = ["route", "p.gr", "--router", "random", "--json"]
    whole = only_object(printed(capsys, *walks, "--out", "whole.solution"))
    assert whole["pruned_wirelength"] < whole["wirelength"]
    pruned = only_object(printed(capsys, *walks, "--prune", "--out", "pruned.solution"))
    for key in ("overflow", "wirelength"):
        assert pruned[key] == pruned[f"pruned_{key}"] == whole[f"pruned_{key}"]
    assert (pruned["joined"], pruned["connected"]) == (whole["joined"], whole["connected"])
    problem = Problem.read("p.gr")
    routed = {name: Solution.read(f"{name}.solution", problem) for name in ("whole", "pruned")}
    assert routed["whole"].pruned() == routed["pruned"]
    assert evaluate(problem, routed["whole"]).wirelength == whole["wirelength"]
    shown = only_object(printed(capsys, "evaluate", "p.gr", "whole.solution", "--json"))
    assert {key: shown[key] for key in shown if "wirelength" in key} == {
        key: whole[key] for key in whole if "wirelength" in key
    }


def test_tables_show_the_pruned_wirelength_where_it_is_less(
    capsys: pytest.CaptureFixture[str],
) -> None:
    row = {"overflow": 0, "wirelength": 20, "joined": 2, "tasks": 2, "seconds": 0.1}
    show([{**row, "router": "a", "pruned_wirelength": 20}], "t")
    assert "pruned" not in capsys.readouterr().out
    show([{**row, "router": "a", "pruned_wirelength": 18}], "t")
    head, _, line = capsys.readouterr().out.splitlines()[2:5]
    assert head.split()[:4] == ["router", "overflow", "wirelength", "pruned"]
    assert line.split()[:4] == ["a", "0", "20", "18"]


@pytest.mark.skipif(not PUBLISHED.exists(), reason="needs the published problems in ../shared/data")
def test_published_solutions_have_the_published_figures(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with (PUBLISHED / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    seen = set()
    for row in rows:
        if row["set"] in seen:
            continue  # one of every set
        seen.add(row["set"])
        stem = PUBLISHED / row["set"] / row["problem"]
        for router in ("drl", "astar"):
            shown = only_object(
                printed(capsys, "evaluate", f"{stem}.gr", f"{stem}.{router}.solution", "--json")
            )
            assert shown["overflow"] == int(row[f"{router}_overflow"])
            assert shown["wirelength"] == int(row[f"{router}_wirelength"])
    assert len(seen) == 10


# --- train, plot ----------------------------------------------------------------------------------


def test_train_writes_a_run_and_prints_a_table(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    overrides = [
        "out=runs/a",
        "seed=7",
        "train.episodes=4",
        "learner.network.hidden=[6, 5]",
        "env.agents=multi",
    ]
    text = printed(capsys, "train", "small.yaml", *overrides)
    config = load_config("runs/a/config.yaml")
    assert (config.seed, config.train.episodes, config.env.agents) == (7, 4, "multi")
    assert config.learner.options.network.options["hidden"] == (6, 5)
    assert config.learner.options.burn_in_size == 100  # the file's
    assert config.learner.options.learning_rate == 1e-4  # the default
    rows = json.loads((here / "runs" / "a" / "result.json").read_text())
    for row in rows:
        line, *_ = [line for line in text.splitlines() if f" {row['router']} " in line]
        assert str(row["wirelength"]) in line.split()
        assert f"{row['joined']}/{row['tasks']}" in line.split()
        assert row.get("from", "") in text
    assert len((here / "runs" / "a" / "metrics.jsonl").read_text().splitlines()) == 4
    assert not (here / "runs" / "a" / "figures").exists()
    assert not (here / "runs" / "a" / "tensorboard").exists()


def test_train_takes_problem_files(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed(
        capsys, "generate", "--count", "2", "--grid", "4", "4", "2", "--nets", "3", "--out", "s"
    )
    for out, source, names in (
        ("a", "p.gr", ["p"]),
        ("b", "s", ["problem_000", "problem_001"]),
        ("c", "[s, p.gr]", ["p", "problem_000", "problem_001"]),
    ):
        printed(capsys, "train", "small.yaml", f"out={out}", f"env.problem={source}")
        assert sorted(path.stem for path in (here / out / "problems").iterdir()) == names
        before = (here / out / "metrics.jsonl").read_bytes()
        printed(capsys, "train", "small.yaml", f"env.problem={source}", "--resume", out)
        assert (here / out / "metrics.jsonl").read_bytes() == before


def test_resume_needs_no_configuration_and_leaves_a_finished_run_alone(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = printed(capsys, "train", "small.yaml", "out=run")
    files = {path: path.read_bytes() for path in (here / "run").rglob("*") if path.is_file()}
    assert status(["train", "--resume", "run"]) == 0
    found = capsys.readouterr()
    assert found.err == "run: already finished; train.episodes=N adds episodes\n"
    assert found.out == first
    assert files == {p: p.read_bytes() for p in (here / "run").rglob("*") if p.is_file()}
    (here / "run" / "result.json").unlink()
    assert status(["train", "--resume", "run"]) == 0
    assert (here / "run" / "result.json").exists()


@pytest.mark.usefixtures("here")
def test_a_configuration_is_shown_whole(capsys: pytest.CaptureFixture[str]) -> None:
    """As a training reads it, with the line of every value."""
    Path("own.yaml").write_text(
        "env:\n  agents: multi\n  reward: team\n  problem:\n    <<: &all {nets: 7}\n    count: 2\n"
        "learner: {kind: dqn, network: {hidden: [8]}}\n"
    )
    given = ("learner.gamma=0.5", "env.observation={kind: window, radius: 1}")
    text = printed(capsys, "config", "own.yaml", *given)
    Path("shown.yaml").write_text(text)
    assert load_config("shown.yaml") == load_config("own.yaml", given)
    words = [line.split() for line in text.splitlines()]
    from_file = {line[0]: line[-1] for line in words if line[-1].startswith("own.yaml")}
    assert from_file == {
        "agents:": "own.yaml:2", "kind:": "own.yaml:7", "nets:": "own.yaml:5",
        "count:": "own.yaml:6", "hidden:": "own.yaml:7",
    }  # fmt: skip
    assert sum(line[-2:] == ["command", "line"] for line in words) == 3
    whole = only_object(printed(capsys, "config", "own.yaml", *given, "--json"))
    assert whole["config"] == yaml.safe_load(text)
    assert whole["origins"]["env.reward.kind"] == "own.yaml:3"
    assert whole["origins"]["env.observation.radius"] == "command line"
    assert whole["origins"]["seed"] == "default"


@pytest.mark.parametrize("command", ["train", "experiment", "benchmark"])
def test_the_schema_takes_what_a_command_takes(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    schema = only_object(printed(capsys, "config", "--schema", command))
    file = {
        "train": "configs/generalist.yaml",
        "experiment": "configs/learned.yaml",
        "benchmark": "configs/benchmark/baselines.yaml",
    }[command]
    data = read_yaml(file)
    jsonschema.validate(data, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**data, "sede": 1}, schema)


def test_a_configuration_of_another_command_is_named(refused: Callable[..., str]) -> None:
    for command, file, other in (
        ("train", "configs/learned.yaml", "experiment"),
        ("train", "configs/benchmark/baselines.yaml", "benchmark"),
        ("experiment", "configs/generalist.yaml", "train"),
        ("benchmark", "configs/learned.yaml", "experiment"),
    ):
        more = ["--scenario", "toy-4x4-v0", "--config"] if command == "benchmark" else []
        line = refused(command, *more, file)
        assert f"{file}: expected a configuration for `marouting {command}`" in line
        assert line.endswith(f"found one for `marouting {other}`")


def test_a_configuration_without_a_file(
    capsys: pytest.CaptureFixture[str], refused: Callable[..., str]
) -> None:
    assert "--schema: expected no configuration" in refused("config", "--schema", "train", "seed=1")
    text = printed(capsys, "config", "learner.kind=ppo", "seed=5")
    assert text == printed(capsys, "config", "learner.kind=ppo", "seed=5")
    assert yaml.safe_load(text)["learner"]["kind"] == "ppo"
    assert text.startswith("seed: 5 ")
    assert text.splitlines()[0].endswith("# command line")


def test_resume_goes_by_the_folder_whatever_its_name(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("2024", "1e5", "null", "a: b", "[x"):
        printed(capsys, "train", "small.yaml", "out=run")
        Path("run").rename(name)
        (here / name / "result.json").unlink()
        printed(capsys, "train", "small.yaml", "--resume", name)
        assert (here / name / "result.json").exists()


def test_plot_of_a_run(trained: Path, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = here / "run"
    shutil.copytree(trained, copy)
    inside = pictures(printed(capsys, "plot", str(copy)))
    assert {path.relative_to(copy).parts[0] for path in inside} == {"figures"}
    kinds = ("heat_maps", "histogram", "edges", "solution_2d", "solution_3d")
    assert {str(path.relative_to(copy / "figures")) for path in inside} == {
        "reward.png",
        "reward_log.png",
        *(
            f"problem_00{number}/{name}_{kind}.png"
            for number in range(2)
            for name in ("astar", "dqn", "dqn_policy")
            for kind in kinds
        ),
        "problem_000/comparison.png",
        "problem_001/comparison.png",
    }
    curves = pictures(printed(capsys, "plot", str(copy / "metrics.jsonl"), "--out", "curves"))
    assert {path.name for path in curves} == {"reward.png", "reward_log.png"}
    beside = pictures(printed(capsys, "plot", str(copy / "metrics.jsonl")))
    assert {path.parent for path in beside} == {copy / "figures"}


@pytest.mark.parametrize(
    "lost", ["problems/problem_001.gr", "solutions/problem_000.astar.solution"]
)
def test_plot_of_a_run_that_has_lost_a_file(
    lost: str, trained: Path, here: Path, refused: Callable[..., str]
) -> None:
    shutil.copytree(trained, here / "run")
    (here / "run" / lost).unlink()
    assert f"run/{lost}: cannot be read" in refused("plot", "run")


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    "router", ["random", pytest.param("astar", marks=pytest.mark.slow)], ids=["given", "none given"]
)
def test_plot_of_a_problem(router: str, capsys: pytest.CaptureFixture[str]) -> None:
    files = ["p.gr"]
    if router == "random":
        printed(capsys, "route", "p.gr", "--router", "random", "--out", "p.random.solution")
        Path("p.txt").write_bytes(Path("p.gr").read_bytes())  # known by its header
        files = ["p.txt", "p.random.solution"]
    drawn = pictures(printed(capsys, "plot", *files))
    assert {path.parent for path in drawn} == {Path("figures/p")}
    assert len(drawn) == 5
    assert all(path.name.startswith(f"{router}_") for path in drawn)


@pytest.mark.usefixtures("here")
def test_plot_draws_all_that_it_is_given(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also runs, problems and solutions of the same name."""
    for folder in ("s1", "s2"):
        Path(folder).mkdir()
        printed(capsys, "route", "p.gr", "--router", "random", "--out", f"{folder}/p.x.solution")
    files = ["p.gr", "s1/p.x.solution", "s2/p.x.solution"]
    drawn = pictures(printed(capsys, "plot", *files, "--out", "both"))
    assert len(drawn) == len(set(drawn)) == 11
    assert Path("both/p/comparison.png") in drawn
    Path("other").mkdir()
    shutil.copy("p.gr", "other/p.gr")
    solution = "s1/p.x.solution"
    drawn = pictures(
        printed(capsys, "plot", "p.gr", solution, "other/p.gr", solution, "--out", "o")
    )
    assert len(set(drawn)) == 10
    assert {str(path.parent) for path in drawn} == {"o/p", "o/p_2"}
    for run in ("run1", "run2", "more/run1"):
        Path(run).mkdir(parents=True)
        shutil.copy(trained / "metrics.jsonl", run)
        shutil.copy(trained / "config.yaml", run)
    drawn = pictures(printed(capsys, "plot", "run1", "run2", "more/run1", "--out", "runs"))
    assert len(set(drawn)) == 6
    assert {path.parts[1] for path in drawn} == {"run1", "run2", "run1_2"}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--frames", "1"], "marouting: --frames: expected a number from 2, found 1\n"),
        ([], "marouting: one.gr: expected a net with pins in two Gcells or more, for an animat"),
    ],
)
def test_view_names_what_it_cannot_animate(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Field(2, 2).net((0, 0), (0, 0)).problem().write("one.gr")
    assert status(["view", "one.gr", "--out", "one.gif", *words]) == 2
    assert capsys.readouterr().err.startswith(said)


@pytest.mark.slow
def test_quickstart(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(capsys, "quickstart", "--out", "q")
    assert "astar" in text
    assert "dqn" in text
    assert (here / "q" / "solutions.png").read_bytes().startswith(PNG)
    # Once more into the same folder: it starts again.
    again = printed(capsys, "quickstart", "--out", "q")
    assert len(again.splitlines()) == len(text.splitlines())


# --- exit status, as a process --------------------------------------------------------------------


def process(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "policies.cli.main", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


TALKATIVE = """grid 1 4 2
vertical capacity 2 1
horizontal capacity 1 1000000
minimum width 1 1
minimum spacing 0 1
via spacing 0 0
0 0 1 1
num net 3
n0 0 2 500000
0 2 1
0 3 2
n1 1 2 962502
0 1 2
0 3 2
n2 2 2 999999
0 3 1
0 1 2
0
"""


@pytest.mark.usefixtures("here")
def test_what_a_solver_prints_is_no_result() -> None:
    Path("talkative.gr").write_text(TALKATIVE)
    done = process("route", "talkative.gr", "--router", "optimal", "--json")
    assert "HighsMipSolverData" in done.stderr  # without it, the test tells nothing
    assert set(only_object(done.stdout)) >= KEYS


@pytest.mark.usefixtures("here")
def test_as_a_process() -> None:
    done = process("route", "p.gr", "--json")
    assert done.returncode == 0
    assert done.stderr in ("", "astar: routing ...\n")  # where loading takes seconds, it says so
    assert set(only_object(done.stdout)) >= KEYS
    refused = process("route", "q.gr", "--json")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert len(refused.stderr.splitlines()) == 1
    assert "q.gr" in refused.stderr


def test_a_router_of_an_installed_package(here: Path) -> None:
    (here / "my_package.py").write_text(
        "import marouting\n"
        "class Mine:\n"
        "    def __init__(self, order: str = 'file') -> None:\n"
        "        self.order = order\n"
        "    def route(self, problem):\n"
        "        return marouting.sequential_astar(problem, self.order)\n"
    )
    folder = here / "my_package-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1\n")
    (folder / "entry_points.txt").write_text("[marouting.router]\nmine = my_package:Mine\n")
    problem = Problem.read("p.gr")
    for name in ("mine", "my_package:Mine"):
        order = "half_perimeter_up"
        done = process("route", "p.gr", f"order={order}", "--router", name, "--out", "o", "--json")
        assert done.returncode == 0, done.stderr
        assert only_object(done.stdout)["router"] == name
        assert Solution.read("o", problem) == marouting.sequential_astar(problem, order)
    done = process("route", "p.gr", "--router", "mien")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "--router: unknown name 'mien'; did you mean mine? expected one of astar, " in line
    assert line.endswith("module:Class")


@pytest.mark.usefixtures("here")
def test_interrupted(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("policies.routers.astar.AStarRouter.route", interrupted)
    assert status(["route", "p.gr"]) == 130
    shown = capsys.readouterr()
    assert shown.out == ""
    assert [line for line in shown.err.splitlines() if line] == ["marouting: interrupted"]


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert marouting.__version__ in printed(capsys, "--version")
    text = printed(capsys, "--help")
    for name in ("generate", "route", "evaluate", "train", "plot", "quickstart"):
        assert name in text
        assert name in printed(capsys, name, "-h")


def test_every_option_has_a_meaning_and_a_default(capsys: pytest.CaptureFixture[str]) -> None:
    for name, command in cli.commands.items():
        text = printed(capsys, name, "--help")
        assert max(map(len, text.splitlines())) <= 80
        assert command.help
        for option in command.params:
            if not isinstance(option, click.Option):
                continue
            assert option.help, f"{name} {option.opts}"
            told = option.is_flag or option.required or option.show_default
            assert told or "[default: " in option.help or "without it" in option.help.lower(), (
                f"{name} {option.opts}"
            )


# --- tables ---------------------------------------------------------------------------------------


def long_summary() -> dict[str, Any]:
    """A summary whose figures and names are as long as they come."""

    def interval(mean: float, half: float) -> dict[str, float]:
        return {"mean": mean, "low": mean - half, "high": mean + half}

    record = {"wins": 123456, "ties": 23456, "losses": 345678}
    row = {
        "kind": "astar",
        "problems": 500000,
        "seeds": 10,
        "overflow": 987654,
        "zero_overflow": 5019,
        "open": 765432,
        "wirelength": interval(12345678.9, 98765.4),
        "pruned_wirelength": interval(12345670.1, 98765.4),
        "gap": {**interval(123.45, 67.89), "problems": 432109},
        "lower_wirelength": {"percent": 99.9, "low": 98.0, "high": 100.0},
        "paper_wins": {"percent": 100.0, "low": 99.0, "high": 100.0},
        "against_astar": record,
        "against_reference": record,
        "seconds": 98700.0,
        "spread": None,
    }
    names = ("astar", "a_router_with_a_name_that_is_longer_than_any_table_should_be_asked_to_print")
    rows = [{**row, "router": name} for name in names]
    return {"reference": names[1], "types": {"s" * 90: {"I": 1, "II": 2}}, "sets": {"s" * 90: rows}}


@pytest.mark.parametrize("width", [80, 230])
def test_tables_of_experiments_fit(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    show_experiment(long_summary())
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    for figure in (
        "987654",
        "5019",
        "765432",
        "12345678.9 ± 98765.4",
        "12345670.1 ± 98765.4",
        "123.45 ± 67.89 (432109)",
        "99.9 [98, 100]",
        "123456/23456/345678",
        "9.87e+04",
    ):
        assert text.count(figure) in (2, 4)  # two routers; the records stand against two others
    assert text.count(" astar ") == (5 if width == 80 else 1)


def test_tables_of_trainings_fit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    figures = {"overflow": 123456789, "wirelength": 1234567890, "joined": 123456, "tasks": 234567}
    row = {"problem": "p" * 50, "router": "[r]" * 20, **figures, "seconds": 1234567.891}
    show([row], "title " * 30)
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    assert {"123456789", "1234567890", "123456/234567", "1234567.89"} <= set(text.split())
    assert text.count("p") >= 50
    assert text.count("[r") >= 18  # names wrap, and are whole


# --- bad input ------------------------------------------------------------------------------------


def tree(folder: Path) -> dict[str, bytes | None]:
    """Everything in a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


@pytest.fixture
def refused(here: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that must be refused in one line, with nothing left behind."""

    def run(*arguments: str, out: str | None = None) -> str:
        before = tree(here)
        capsys.readouterr()
        code = status(arguments)
        shown = capsys.readouterr()
        assert code == 2, shown
        assert shown.out == ""
        (line,) = shown.err.splitlines()
        assert line.startswith("marouting: ")
        assert "Traceback" not in line
        assert len(line) > len("marouting: ")
        assert tree(here) == before
        assert out is None or not Path(out).exists()
        return line.removeprefix("marouting: ")

    return run


USAGE: dict[str, tuple[list[str], str]] = {
    "unknown command": (["rout"], "rout"),
    "unknown option": (["route", "p.gr", "--rooter", "astar"], "--rooter"),
    "unknown router": (["route", "p.gr", "--router", "dijkstra"], "dijkstra"),
    "missing argument": (["evaluate", "p.gr"], "SOLUTION"),
    "too many arguments": (["evaluate", "p.gr", "p.solution", "x"], "x"),
    "missing value": (["generate", "--out", "g", "--seed"], "--seed"),
    "ill-typed value": (["generate", "--out", "g", "--seed", "one"], "one"),
    "generate without out": (["generate"], "--out"),
    "half a grid": (["generate", "--out", "g", "--grid", "4", "4"], "--grid"),
    "checkpoint without a learner": (["route", "p.gr", "--checkpoint", "c.pt"], "--checkpoint"),
    "config of another router": (["route", "p.gr", "--config", "small.yaml"], "small.yaml: "),
    "option of another router": (["route", "p.gr", "train.episodes=1"], "train: unknown key"),
    "checkpoint and override": (
        ["route", "p.gr", "--router", "dqn", "--checkpoint", "c.pt", "seed=1"],
        "--checkpoint",
    ),
    "plot nothing": (["plot"], "RUN_OR_FILE"),
    "count": (["generate", "--out", "g", "--count", "0"], "count"),
    "grid": (["generate", "--out", "g", "--grid", "0", "4", "2"], "grid"),
    "one Gcell": (["generate", "--out", "g", "--grid", "1", "1", "2"], "grid"),
    "huge grid": (["generate", "--out", "g", "--grid", "99999", "99999", "99"], "grid"),
    "max pins": (["generate", "--out", "g", "--max-pins", "1"], "max_pins"),
    "capacity": (["generate", "--out", "g", "--capacity", "-1"], "capacity"),
    "negative seed": (["generate", "--out", "g", "--seed", "-1"], "seed"),
    "negative route seed": (["route", "p.gr", "--router", "dqn", "seed=-1"], "seed"),
}


def test_without_a_command_all_of_them_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(capsys)
    assert all(f"  {name} " in text for name in ("benchmark", "route", "train", "view"))


@pytest.mark.parametrize(("arguments", "named"), USAGE.values(), ids=USAGE)
def test_wrong_usage(arguments: list[str], named: str, refused: Callable[..., str]) -> None:
    assert named.lower() in refused(*arguments).lower()


UNREADABLE: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "No such file"),
    "empty": (b"", "expected"),
    "binary": (bytes(range(256)) * 20, "expected"),
    "zeros": (b"\0" * 4096, "expected"),
    "prose": (b"This is no file of ours.\n", ":1"),
}


@pytest.mark.parametrize(("content", "said"), UNREADABLE.values(), ids=UNREADABLE)
def test_unreadable_files(content: bytes | None, said: str, refused: Callable[..., str]) -> None:
    for name, commands in {
        "bad.gr": (
            ["route", "bad.gr", "--out", "o.solution", "--json"],
            ["route", "bad.gr", "--router", "dqn", *FAST],
            ["evaluate", "bad.gr", "p.solution"],
            ["plot", "bad.gr"],
            ["train", "small.yaml", "env.problem=bad.gr", "out=o"],
        ),
        "bad.solution": (
            ["evaluate", "p.gr", "bad.solution", "--json"],
            ["plot", "p.gr", "bad.solution"],
        ),
    }.items():
        if content == b"" and name == "bad.solution":
            continue  # a solution that routes nothing
        if content is not None:
            Path(name).write_bytes(content)
        for command in commands:
            line = refused(*command)
            assert name in line
            if command[0] != "plot" or content is not None:
                assert said in line


def test_damaged_problem_names_the_line(refused: Callable[..., str]) -> None:
    lines = Path("p.gr").read_text().splitlines()
    Path("bad.gr").write_text("\n".join(lines[:-3]))
    assert f"bad.gr:{len(lines) - 2}" in refused("route", "bad.gr") or "bad.gr" in refused(
        "route", "bad.gr"
    )
    Path("bad.gr").write_text("\n".join([lines[0], "vertical capacity 1 many", *lines[2:]]))
    assert "bad.gr:2" in refused("route", "bad.gr")


def test_solution_of_another_problem(refused: Callable[..., str]) -> None:
    # Its routes leave the other problem's grid.
    generate(1, grid=(2, 2, 2), nets=4, seed=8)[0].write("other.gr")
    assert "p.solution" in refused("evaluate", "other.gr", "p.solution")
    assert "p.solution" in refused("plot", "other.gr", "p.solution")


@pytest.mark.parametrize("target", ["file/inside", "file/in/side"])
def test_output_that_cannot_be_written(
    target: str, trained: Path, refused: Callable[..., str]
) -> None:
    for command in (
        ["generate", "--grid", "4", "4", "2", "--nets", "2", "--out", target],
        ["route", "p.gr", "--out", target],
        ["convert", "p.gr", target],
        # Found out before the training, not after it.
        ["route", "p.gr", "--router", "dqn", "train.episodes=1000000", "--out", target],
        ["train", "small.yaml", f"out={target}"],
        ["plot", "p.gr", "--out", target],
        ["plot", str(trained), "--out", target],
        ["plot", str(trained / "metrics.jsonl"), "--out", target],
        ["quickstart", "--out", target],
    ):
        line = refused(*command)
        assert target in line
        assert "cannot be written" in line


def test_folder_in_place_of_a_file_and_back(refused: Callable[..., str]) -> None:
    Path("folder").mkdir()
    assert "folder" in refused("route", "p.gr", "--out", "folder")
    assert "folder" in refused("route", "folder")
    assert "folder" in refused("train", "folder")
    assert "folder" in refused("evaluate", "p.gr", "folder")
    assert "folder" in refused("route", "p.gr", "--router", "dqn", "--checkpoint", "folder")
    line = refused("route", "p.gr", "--router", "no.pt")
    assert "--router no.pt: expected a file or a folder, found none there" in line
    assert "expected a run folder" in refused("plot", "folder")
    assert "expected a .gr file" in refused("train", "small.yaml", "env.problem=folder", "out=o")
    for command in (
        ["generate", "--grid", "4", "4", "2", "--nets", "2", "--out", "file"],
        ["train", "small.yaml", "out=file"],
    ):
        assert "file" in refused(*command)


def test_plot_of_what_cannot_be_plotted(refused: Callable[..., str]) -> None:
    assert "nowhere" in refused("plot", "nowhere")
    assert "p.solution" in refused("plot", "p.solution")
    for text in (
        "",
        "{",
        "[]\n",
        "{}\n",
        '{"problem": "p"}\n',
        '{"problem": "p", "reward": "much"}\n',
        '{"problem": "p", "reward": 1' + 400 * "0" + "}\n",
        50_000 * "[" + "\n",
        '{"problem": "p", "reward": 1}\n{"problem": "p", "rew',
    ):
        Path("m.jsonl").write_text(text)
        assert "m.jsonl" in refused("plot", "m.jsonl")
    Path("m.jsonl").write_bytes(b"\xff\xfe")
    assert "m.jsonl" in refused("plot", "m.jsonl")
    assert "expected a path, found an empty one" in refused("plot", "")


def test_rewards_are_those_of_all_episodes(trained: Path, refused: Callable[..., str]) -> None:
    lines = (trained / "metrics.jsonl").read_text().splitlines(keepends=True)
    for wrong, said in (
        (lines[2:], "1: episode: expected 0, found 1"),
        (lines[:2] + lines[4:], "3: episode: expected 1, found 2"),
        (lines + lines, f"{len(lines) + 1}: episode: expected {len(lines) // 2}, found 0"),
    ):
        Path("m.jsonl").write_text("".join(wrong))
        assert f"m.jsonl:{said}" in refused("plot", "m.jsonl")


BAD_CONFIGS: dict[str, tuple[str, str]] = {
    "a list": ("[1, 2]", "expected a mapping"),
    "a word": ("word", "expected a mapping"),
    "a number": ("3", "expected a mapping"),
    "broken": ("env:\n  agents: [single\n", "bad.yaml:"),
    "a tab": ("env:\n\tagents: single\n", "bad.yaml:2"),
    "an object": ("out: !!python/object/apply:os.getcwd []", "bad.yaml:1"),
    "a tag": ("out: !!bool perhaps", "bad.yaml"),
    "a date": ("seed: 2020-01-01", "seed"),
    "a circle": ("&a\nenv: *a", "bad.yaml"),
    "deep": (500 * "[", "bad.yaml"),
    "control": ("seed: \x01", "bad.yaml"),
    "a key of a list": ("{[1]: 2}", "bad.yaml"),
    "a line break in a key": ('"a\\nb": 1', "bad.yaml"),
    "half a character": ('out: "\\ud800"', "bad.yaml"),
}


@pytest.mark.parametrize(("text", "said"), BAD_CONFIGS.values(), ids=BAD_CONFIGS)
def test_malformed_configurations(text: str, said: str, refused: Callable[..., str]) -> None:
    Path("bad.yaml").write_text(text)
    assert said in refused("train", "bad.yaml", out="runs")
    assert said in refused("route", "p.gr", "--router", "dqn", "--config", "bad.yaml")


def test_configuration_that_is_no_text(refused: Callable[..., str]) -> None:
    Path("bad.yaml").write_bytes(b"seed: \xff\xfe")
    assert "bad.yaml: expected UTF-8" in refused("train", "bad.yaml")
    assert "none.yaml" in refused("train", "none.yaml")


UNKNOWN = {
    "sede": "did you mean seed?",
    "learner.gama": "did you mean gamma?",
    "train.episode": "did you mean episodes?",
    "env.agent": "did you mean agents?",
    "env.problem.net": "did you mean nets?",
    "env.reward.reach": "did you mean reached?",
    "env.observation.via_capacty": "did you mean via_capacity?",
    "trian": "did you mean train?",
    "learner.zzz": "expected one of network, gamma, ",
    "zzz": "expected one of seed, out, env, learner, train",
    # The names that the parser has for the kinds of a problem are no keys either.
    "file": "expected one of seed, out, env, learner, train",
    "learner.files": "unknown key; ",
    "env.generator": "unknown key; ",
}


@pytest.mark.parametrize(("key", "said"), UNKNOWN.items(), ids=UNKNOWN)
def test_unknown_keys(key: str, said: str, refused: Callable[..., str]) -> None:
    # The key that a component stands under ends with a colon and not with a dot.
    line = refused("train", "small.yaml", f"{key}=1", out="runs").replace("env: ", "env.")
    assert f"{key}: unknown key; " in line
    assert said in line
    nested: Any = 1
    for part in reversed(key.split(".")):
        nested = {part: nested}
    Path("bad.yaml").write_text(yaml.safe_dump(nested))
    line = refused("train", "bad.yaml", out="runs").replace("env: ", "env.")
    assert line.startswith(f"bad.yaml: {key}: unknown key; ")
    assert said in line


ILL_TYPED = [
    "train.episodes=ten",
    "train.episodes=true",
    "train.episodes=1.5",
    "train.episodes='3'",
    "train.episodes=[3]",
    "train.episodes={a: 1}",
    "train.episodes=null",
    "train.episodes=",
    "train.episodes=0",
    "train.episodes=-1",
    f"train.episodes={10**30}",
    "train.device=tpu",
    "train.device=meta",
    "train.device=''",
    "train.device=3",
    "learner=3",
    "learner=qdn",
    "learner.kind=3",
    "train.threads=0",
    "train.checkpoint_seconds=-1",
    "train.checkpoint_seconds=soon",
    "train.checkpoint_seconds=.nan",
    "train.checkpoint_seconds=true",
    "train.tensorboard=1",
    "train.figures=maybe",
    "train=5",
    "train=[episodes]",
    "seed=-1",
    "seed=1.0",
    "seed=one",
    f"seed={2**63}",
    "out=5",
    "out=[a]",
    "learner.network.hidden=32",
    "learner.network.hidden=[a]",
    "learner.network.hidden=[0]",
    "learner.network.hidden=[32.5]",
    "learner.network.hidden=[65536, 65536]",
    "learner.network.init=zeros",
    "learner.network=pathlib:Path",
    "train.device=gpu",
    "learner.gamma=1.5",
    "learner.gamma=high",
    "learner.gamma=.nan",
    "learner.learning_rate=0",
    "learner.learning_rate=.inf",
    "learner.batch_size=0",
    "learner.buffer_size=50",  # less than burn_in_size
    f"learner.buffer_size={10**30}",
    "learner.burn_in=a*",
    "learner.burn_in_size=0",
    "learner.epsilon=2",
    "learner.epsilon_final=-0.1",
    "learner.epsilon_decay_from=-1",
    "learner.target_period=-1",
    f"learner.target_period={10**30}",
    "learner.masking=1",
    "learner.steps_per_update=0",
    "env=3",
    "env.agents=many",
    "env.agents=[single]",
    "env.turn_order=alphabetical",
    "env.nets.order=largest",
    "env.max_steps=0",
    "env.max_steps=1000000000000000000000000000000",
    "env.reward.reached=.nan",
    "env.reward.step=.inf",
    "env.observation.via_capacity=.inf",
    "env.max_steps=ten",
    "env.overflow=true",
    "env.problem=3",
    "env.problem=[]",
    "env.problem.grid=[4, 4]",
    "env.problem.grid=[4, 4, 0]",
    "env.problem.nets=0",
    "env.problem.nets=three",
    "env.problem.seed=-1",
    "env.reward.reached=lots",
    "env.observation=12",
    "env.observation=null",
    "learner=",
    "learner.kind=",
]


@pytest.mark.parametrize("override", ILL_TYPED)
def test_ill_typed_values(override: str, refused: Callable[..., str]) -> None:
    line = refused("train", "small.yaml", override, out="runs")
    assert override.partition("=")[0].split(".")[-1] in line


@pytest.mark.parametrize("override", ["=", "=3", "episodes", "a b", "", "train.episodes"])
def test_overrides_without_key_or_value(override: str, refused: Callable[..., str]) -> None:
    assert "key=value" in refused("train", "small.yaml", override, out="runs")


@pytest.mark.parametrize(
    "override", ["seed=[1", "seed=!!bool x", 'seed=!!int ""', "seed=!!int [1]", "seed=&a [*a]"]
)
def test_overrides_that_are_no_yaml(override: str, refused: Callable[..., str]) -> None:
    refused("train", "small.yaml", override, out="runs")


@pytest.mark.parametrize("key", [".", ".seed", "seed.", "train..episodes"])
def test_keys_of_nothing(key: str, refused: Callable[..., str]) -> None:
    refused("train", "small.yaml", f"{key}=1", out="runs")


def test_problems_that_do_not_go_together(refused: Callable[..., str]) -> None:
    generate(1, grid=(5, 5, 2), nets=2)[0].write("other.gr")
    line = refused("train", "small.yaml", "env.problem=[p.gr, other.gr]", "out=o")
    assert "one grid shape" in line
    assert "differ" in refused("train", "small.yaml", "env.problem=[p.gr, p.gr]", "out=o")


def test_too_much_memory_to_ask_for(refused: Callable[..., str]) -> None:
    size = 2**31 - 1
    line = refused(
        "train", "small.yaml", f"learner.buffer_size={size}", "env.problem.count=90", "out=o"
    )
    assert "memory" in line


def test_resume_of_nothing(refused: Callable[..., str]) -> None:
    assert "--resume nowhere" in refused("train", "small.yaml", "--resume", "nowhere")
    assert "--resume file" in refused("train", "small.yaml", "--resume", "file")
    assert "environment: unknown key" in refused("train", "environment.problem=p")


@pytest.mark.usefixtures("undrawn")
def test_every_key_of_a_training_has_a_default(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ["env.problem={nets: 3, grid: [4, 4, 2]}", "train.episodes=2", "learner.burn_in_size=100"]
    assert "policy after 2 episodes" in printed(capsys, "train", *few, "out=bare")
    assert (here / "bare" / "policy.pt").exists()


# --- checkpoints ----------------------------------------------------------------------------------


class Exploit:
    """Runs code when it is unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("exploited"),)


def whole(path: Path) -> dict[str, Any]:
    """A policy file's content, of one problem."""
    state: dict[str, Any] = torch.load(path, weights_only=True)
    one = {key: state[key][:1] for key in ("weights", "episodes")}
    return {**state, **one, "names": ["p"]}


def first_layer(state: dict[str, Any]) -> tuple[str, torch.Tensor]:
    """The weights that take the 12 numbers of an observation, and their name."""
    return next((k, v) for k, v in state["weights"][0].items() if 12 in v.shape)


def thirteen_inputs(state: dict[str, Any]) -> None:
    name, weights = first_layer(state)
    state["weights"][0][name] = torch.zeros([13 if n == 12 else n for n in weights.shape])
    state["obs_shape"] = [13]


def weights(state: dict[str, Any], change: Callable[[torch.Tensor], torch.Tensor]) -> None:
    name, tensor = first_layer(state)
    state["weights"][0][name] = change(tensor)


def quantised(tensor: torch.Tensor) -> torch.Tensor:
    return torch.quantize_per_tensor(tensor, 0.1, 0, torch.qint8)


Damage = Callable[[Path, Path], None]


def resaved(change: Callable[[dict[str, Any]], Any]) -> Damage:
    """Something changed in the content, and saved in order."""

    def damage(good: Path, bad: Path) -> None:
        state = whole(good)
        change(state)
        torch.save(state, bad)

    return damage


def cut(share: float) -> Damage:
    def damage(good: Path, bad: Path) -> None:
        bad.write_bytes(good.read_bytes()[: int(share * good.stat().st_size)])

    return damage


def flipped(good: Path, bad: Path) -> None:
    """One bit of the weights is another."""
    state = whole(good)
    torch.save(state, bad)
    data = bytearray(bad.read_bytes())
    at = data.index(first_layer(state)[1].numpy().tobytes()[:40])
    data[at + 20] ^= 64
    bad.write_bytes(data)


def archived(_: Path, bad: Path) -> None:
    with zipfile.ZipFile(bad, "w") as archive:
        archive.writestr("hello.txt", "hello")


def older(good: Path, bad: Path) -> None:
    """In the format of torch before its archives."""
    torch.save(whole(good), bad, _use_new_zipfile_serialization=False)


DAMAGES: dict[str, tuple[Damage, str]] = {
    "missing": (lambda _good, _bad: None, "No such file"),
    "empty": (cut(0), "undamaged"),
    "truncated": (cut(0.5), "undamaged"),
    "nearly whole": (cut(0.98), "undamaged"),
    "flipped": (flipped, "undamaged"),
    "random": (
        lambda _, bad: void(bad.write_bytes(np.random.default_rng(0).bytes(9999))),
        "undamaged",
    ),
    "text": (lambda _, bad: void(bad.write_text("not a checkpoint")), "undamaged"),
    "another pickle": (
        lambda _, bad: void(bad.write_bytes(pickle.dumps({"format": 1}))),
        "undamaged",
    ),
    "code in a pickle": (
        lambda _, bad: void(bad.write_bytes(pickle.dumps(Exploit()))),
        "undamaged",
    ),
    "code in an archive": (lambda _, bad: torch.save({"format": Exploit()}, bad), "undamaged"),
    "another archive": (archived, "undamaged"),
    "older": (older, "undamaged"),
    "a tensor": (lambda _, bad: torch.save(torch.zeros(3), bad), "format"),
    "a list": (lambda _, bad: torch.save([1, 2], bad), "format"),
    "no format": (resaved(lambda state: state.pop("format")), "format"),
    "another format": (resaved(lambda state: state.update(format="marouting-dqn-0")), "format"),
    "a format of tensors": (resaved(lambda s: s.update(format=torch.zeros(2))), "format"),
    "no weights": (resaved(lambda state: state.pop("weights")), "weights"),
    "no tensor": (resaved(lambda state: state.update(weights=[1.0])), "weights"),
    "another shape": (
        resaved(lambda s: s["weights"][0].update({first_layer(s)[0]: torch.zeros(3, 2)})),
        "weights do not fit",
    ),
    "a layer less": (
        resaved(lambda s: void(s["weights"][0].pop(first_layer(s)[0]))),
        "weights do not fit",
    ),
    "another network": (
        resaved(lambda state: state["learner"]["network"].update(hidden=[9])),
        "weights do not fit",
    ),
    "other inputs": (resaved(thirteen_inputs), "(13,)"),
    "empty layers": (resaved(lambda s: s["learner"]["network"].update(hidden=[0])), "hidden"),
    "a shape of words": (resaved(lambda state: state.update(obs_shape=["a"])), "obs_shape.0"),
    "no learner": (resaved(lambda state: state.pop("learner")), "learner: "),
    "another learner": (resaved(lambda s: s["learner"].update(kind="qdn")), "learner 'qdn'"),
    "no networks": (resaved(lambda s: s.update(names=[], weights=[], episodes=[])), "weights: "),
    "names of none": (resaved(lambda state: state.update(names=3)), "names: "),
    "another game": (resaved(lambda state: state.update(env={"agents": "many"})), "agents"),
    "unknown option": (resaved(lambda state: state.update(env={"gravity": 1})), "gravity"),
    "no game": (resaved(lambda state: state.pop("env")), "env: "),
    "a parameter": (resaved(lambda s: weights(s, torch.nn.Parameter)), "Parameter"),
    "gradients": (resaved(lambda s: weights(s, lambda w: w.requires_grad_())), "gradients"),
    "sparse": (resaved(lambda s: weights(s, torch.Tensor.to_sparse)), "dense"),
    "quantised": (resaved(lambda s: weights(s, quantised)), "dense"),
    "without numbers": (resaved(lambda s: weights(s, lambda w: w.to("meta"))), "dense"),
    "an ordered mapping": (
        resaved(lambda s: s.update(weights=[OrderedDict(s["weights"][0])])),
        "OrderedDict",
    ),
    "a type": (resaved(lambda state: state["env"].update(agents=torch.float32)), "dtype"),
    "a set": (resaved(lambda state: state.update(names={"p"})), "found set"),
    "keys of numbers": (resaved(lambda state: state["env"].update({1: 2})), "keys"),
    "another problem": (
        lambda good, bad: torch.save(torch.load(good, weights_only=True), bad),
        "problem_000",
    ),
}


def void(_: Any) -> None:
    """Makes a statement of an expression."""


@pytest.mark.parametrize(("damage", "said"), DAMAGES.values(), ids=DAMAGES)
def test_bad_checkpoints(
    damage: Damage, said: str, trained: Path, refused: Callable[..., str]
) -> None:
    damage(trained / "policy.pt", Path("c.pt"))
    line = refused(
        "route", "p.gr", "--router", "dqn", "--checkpoint", "c.pt", "--out", "o.solution"
    )
    assert said in line
    assert "c.pt" in line or said in ("(13,)", "hidden")
    assert not Path("exploited").exists()


@pytest.mark.usefixtures("here")
def test_the_checkpoint_that_is_damaged_above_is_good(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    resaved(lambda _: None)(trained / "policy.pt", Path("c.pt"))
    printed(capsys, "route", "p.gr", "--router", "dqn", "--checkpoint", "c.pt")


# --- configurations, whatever is in them ----------------------------------------------------------


def test_shipped_configurations_are_valid() -> None:
    paths = sorted((ROOT / "configs").rglob("*.yaml"))
    assert paths
    for path in paths:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
        if path.parent.name == "benchmarl":
            continue  # of a library; tests/test_integrations.py reads it
        if path.parent.name == "benchmark":
            entries, _ = load_entries(path, [], None)
            assert entries
        elif "routers" in raw:
            assert isinstance(load_experiment(path), ExperimentConfig)
        elif path.stem in router_names() and "train" not in raw:
            assert router_component(path.stem, raw) == router_component(path.stem, {})
        else:
            assert isinstance(load_config(path), Config)


TOKENS = st.sampled_from(
    [
        *"[]{},:&*!|>'\"%@`#-?= \n\t.~",
        *(
            "null",
            "true",
            "no",
            ".nan",
            "-.inf",
            "1e400",
            "-1",
            "0x1F",
            "0o17",
            "1_000",
            "12:30:45",
        ),
        *(
            "2020-01-01",
            "!!bool x",
            '!!int ""',
            "!!timestamp x",
            "!!float y",
            "!!binary =",
            "!!set",
        ),
        *("!!python/name:os.system", "&a [*a]", "*b", "<<: 3", "<<: {a: 1}", "---", "...", "--- 1"),
        *("file", "files", "generator", "seed", "problem", "env.", "\ud7ff", "\x00", "\x85", "é"),
        "9" * 5000,
    ]
)
CONFIG_TEXT = yaml.safe_dump(plain(Config()), sort_keys=False)
NAMES = [
    f"{part}{name}"
    for part, schema in (
        ("", Config),
        ("env.", EnvOptions),
        ("dqn.", DQNOptions),
        ("train.", TrainOptions),
    )
    for name in schema.__dataclass_fields__
]


def loads_or_is_refused(path: Path | None, overrides: list[str]) -> None:
    """A Config comes of it, or an InputError of one line."""
    try:
        result: Config | InputError = load_config(path, overrides)
    except InputError as error:
        result = error
    assert isinstance(result, Config) or len(str(result).splitlines()) == 1


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scratch") / "config.yaml"


@examples(100)
@given(
    edits=st.lists(
        st.tuples(
            st.integers(0, len(CONFIG_TEXT)),
            st.integers(0, 30),
            TOKENS | st.text(max_size=4),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_mutated_configurations(scratch: Path, edits: list[tuple[int, int, str]]) -> None:
    text = CONFIG_TEXT
    for start, length, inserted in edits:
        text = text[:start] + inserted + text[start + length :]
    scratch.write_text(text, encoding="utf-8", errors="surrogatepass")
    loads_or_is_refused(scratch, [])


KEY_TEXT = (
    st.sampled_from(NAMES)
    | st.text(max_size=8)
    | st.builds("{}.{}".format, st.sampled_from(NAMES), TOKENS)
)


@examples(100)
@given(
    st.lists(
        st.builds(
            "{}={}".format,
            KEY_TEXT,
            TOKENS | st.text(max_size=6) | st.integers().map(str) | st.floats().map(str),
        )
        | st.text(max_size=10),
        max_size=4,
    )
)
@example(["file=1"])
@example(["env.problem.file=1"])
@example(["a\nb=1"])
@example(["a\u2028b=1"])
@example(["\ud800=1"])
@example(["seed=\ud800"])
@example(["env.problem=x", "env.problem.nets=3"])
def test_any_overrides(overrides: list[str]) -> None:
    loads_or_is_refused(None, overrides)


def test_an_override_changes_one_place() -> None:
    """By YAML's anchors one mapping can stand in two."""
    raw = yaml.safe_load("a: &same {k: 1, l: {m: 2}}\nb: *same")
    expected = {"a": {"k": 3, "l": {"m": 4}}, "b": {"k": 1, "l": {"m": 2}}}
    assert override(raw, ["a.k=3", "a.l.m=4"]) == expected
    assert raw["a"] == expected["b"]


@pytest.mark.parametrize(
    "overrides", [["reward=team", "reward.step=2"], ["reward.step=2", "reward=team"]]
)
def test_a_name_and_its_keys_go_together(overrides: list[str]) -> None:
    expected = {"env": {"reward": {"kind": "team", "step": 2}}}
    assert override({}, [f"env.{text}" for text in overrides]) == expected
    for kind in ("paper", "team"):  # a name replaces all options, also of the same component
        raw = {"env": {"reward": {"kind": kind, "reached": 1}}}
        assert override(raw, [f"env.{text}" for text in overrides]) == expected


def test_the_last_value_of_a_key_counts() -> None:
    for values in (["{nets: 3}", "p.gr"], ["p.gr", "{nets: 3}"], ["p.gr", "q.gr"]):
        last = {"problem": yaml.safe_load(values[-1])}
        assert override({}, [f"problem={value}" for value in values]) == last


@pytest.mark.parametrize(
    "overrides", [["seed=3", "seed.x=4"], ["env.problem.nets=3", "env.problem=p"]]
)
def test_a_key_has_a_value_or_keys(overrides: list[str]) -> None:
    deeper = max(overrides, key=lambda text: text.count("."))
    for texts in (overrides, overrides[::-1]):
        with pytest.raises(InputError, match=rf"^{deeper}: expected \w+ to have keys, found "):
            override({}, texts)


# A file holds no NUL. Numbers as text have to stay text.
TEXT = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=8)
TEXT |= st.sampled_from(["0E0", "1e5", "1:30", "010", "0x1f", "1_0", "true", "null", ".inf"])


@given(
    config=st.builds(
        Config,
        seed=st.integers(0, 2**63 - 1),
        out=TEXT,
        env=st.builds(
            EnvOptions,
            problem=TEXT | st.tuples(st.just("a.gr"), st.just("1")),
            agents=st.sampled_from(["single", "multi"]),
            max_steps=st.none() | st.integers(1, 1000),
        ),
        learner=st.fixed_dictionaries(
            {
                "kind": st.just("dqn"),
                "network": st.builds(dict, hidden=st.lists(st.integers(1, 99), max_size=4)),
                "gamma": st.floats(0, 1),
                "learning_rate": st.floats(1e-12, 1e6),
                "epsilon_final": st.none() | st.floats(0, 1),
                "masking": st.booleans(),
            }
        ),
        train=st.builds(TrainOptions, checkpoint_seconds=st.floats(0, 1e9)),
    )
)
def test_configurations_survive_their_files(scratch: Path, config: Config) -> None:
    write_config(config, scratch)
    assert load_config(scratch) == config


# --- whose files they are -------------------------------------------------------------------------


def test_generate_removes_what_killed_runs_left(here: Path) -> None:
    (here / "out").mkdir()
    for name in (".lock", ".ab12_xyz.marouting-tmp", "mine.marouting-tmp"):
        (here / "out" / name).write_text("")
    assert status(["generate", "--nets", "3", "--out", "out"]) == 0
    left = sorted(path.name for path in (here / "out").iterdir())
    assert left == ["mine.marouting-tmp", "problem_000.gr"]


def test_generate_does_not_mix_sets(here: Path, refused: Callable[..., str]) -> None:
    assert status(["generate", "--count", "3", "--nets", "2", "--out", "set"]) == 0
    said = refused("generate", "--count", "2", "--nets", "2", "--out", "set")
    assert said.endswith("expected no other problems, found problem_002.gr")
    assert status(["generate", "--count", "4", "--nets", "2", "--out", "set"]) == 0
    assert len(list((here / "set").iterdir())) == 4


def test_quickstart_takes_no_folder_of_others(here: Path, refused: Callable[..., str]) -> None:
    assert "found file in it" in refused("quickstart", "--out", ".")
    assert status(["train", "small.yaml", "out=q/single"]) == 0
    assert "or one of quickstart's" in refused("quickstart", "--out", "q")
    (here / "q" / "problem.gr").write_bytes((here / "p.gr").read_bytes())
    assert "or one of quickstart's" in refused("quickstart", "--out", "q")


def test_an_experiment_takes_no_folder_of_others(here: Path, refused: Callable[..., str]) -> None:
    config = {"problems": "p.gr", "routers": {"a": {"router": "astar"}}, "out": "."}
    (here / "e.yaml").write_text(yaml.safe_dump(config))
    assert "expected a new or an empty folder, found e.yaml" in refused("experiment", "e.yaml")


def test_a_link_is_written_through_and_modes_stay(here: Path) -> None:
    (here / "far").mkdir()
    real, link = here / "far" / "real.solution", here / "link.solution"
    real.write_text("old")
    real.chmod(0o600)
    link.symlink_to(real)
    assert status(["route", "p.gr", "--router", "astar", "--out", "link.solution"]) == 0
    assert link.is_symlink()
    assert real.read_text() == (here / "p.solution").read_text()
    assert real.stat().st_mode & 0o777 == 0o600
    assert [path.name for path in (here / "far").iterdir()] == ["real.solution"]


def test_what_is_no_file_is_not_written(here: Path, refused: Callable[..., str]) -> None:
    os.mkfifo(here / "pipe")
    for target in ("pipe", "/dev/null"):
        said = refused("route", "p.gr", "--router", "astar", "--out", target)
        assert said.endswith(f"{target}: cannot be written: it is not a file")
    assert stat.S_ISFIFO((here / "pipe").stat().st_mode)


NOTHING = GR.partition("num net")[0] + "num net 1\nA 1 2 1\n5 5 1\n6 6 1\n"
"""A problem whose only net lies in one Gcell."""


@pytest.mark.usefixtures("at_once")
def test_a_problem_with_nothing_to_route(
    here: Path, capsys: pytest.CaptureFixture[str], refused: Callable[..., str]
) -> None:
    Path("p.gr").write_text(NOTHING)
    for router in ("astar", "pathfinder", "optimal", "greedy", "random", "generalist", "dqn"):
        done = ["route", "p.gr", "--router", router, "--out", "p.solution", "--json"]
        for command in (done, ["evaluate", "p.gr", "p.solution", "--json"]):
            found = only_object(printed(capsys, *command))
            assert (found["overflow"], found["wirelength"], found["tasks"]) == (0, 0, 0)
            assert found["connected"]
    assert len(pictures(printed(capsys, "plot", "p.gr", "p.solution"))) == 5
    routers = {name: {"router": name} for name in ("astar", "pathfinder", "optimal", "random")}
    config = {"out": "out", "jobs": 1, "reference": "astar", "problems": {"s": "p.gr"}}
    Path("e.yaml").write_text(yaml.safe_dump({**config, "routers": routers}))
    summary = only_object(printed(capsys, "experiment", "e.yaml", "--json"))
    for row in summary["sets"]["s"]:
        assert (row["overflow"], row["wirelength"]["mean"], row["gap"]["mean"]) == (0, 0, 0)
        if row["router"] != "astar":
            assert row["against_astar"] == {"wins": 0, "ties": 1, "losses": 0}
            assert row["lower_wirelength"]["percent"] == 0
    assert len(pictures(printed(capsys, "plot", "out"))) == 3
    said = "expected a net with pins in two Gcells or more"
    assert said in refused("train", "small.yaml", "env.problem=p.gr", "out=r")
    assert not (here / "r").exists()
    with pytest.raises(InputError, match=said):
        marouting.make({"env": {"problem": "p.gr"}})
