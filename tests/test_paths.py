"""Paths that are none: wherever one may stand, one line says which it is."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import marouting
from marouting import InputError, Problem, Solution, global_routing_v0
from marouting.yaml_files import read_yaml
from policies.cli.main import status
from policies.experiment import Experiment, load_experiment
from policies.experiment.benchmark import from_text, load_entries
from policies.figures.plot import plot
from policies.learned.config import load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run
from policies.results.rows import read_rows
from policies.routers.registry import make_router

LONG = 300 * "x"

PATHS: dict[str, str] = {
    "long": LONG,
    "long folder": f"{LONG}/a",
    "very long": "d/" * 3000 + "a",
    "NUL": "a\0b",
    "below a file": "file/a",
    "circle": "circle",
    "below a circle": "circle/a",
}
"""Paths at which there is nothing to read, and where nothing can be written."""

MISSING = {**PATHS, "nowhere": "nowhere", "broken link": "broken"}
"""Paths at which there is nothing to read."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    problem = marouting.generate(1, grid=(4, 4, 2), nets=3, seed=1)[0]
    problem.write("p.gr")
    marouting.sequential_astar(problem).write("p.solution")
    Path("p.cap").write_text("2 2 2\n1 1\n1 1\n1\n1\nm1 0 0\n0 0\n0 0\nm2 1 0\n1 1\n1 1\n")
    Path("p.def").write_text("VERSION 5.8 ;\nEND DESIGN\n")
    Path("e.yaml").write_text(
        "out: e\njobs: 1\nproblems: {a: {grid: [4, 4, 2], nets: 3}}\n"
        "routers: {a: {router: astar}}\n"
    )
    Path("t.yaml").write_text("train: {episodes: 1}\n")
    Path("file").write_text("a file\n")
    Path("circle").symlink_to("circle")
    Path("broken").symlink_to("nothing")
    return tmp_path


READ: dict[str, tuple[str, ...]] = {
    "route": ("route", "PATH"),
    "route --config": ("route", "p.gr", "--config", "PATH"),
    "route dqn --config": ("route", "p.gr", "--router", "dqn", "--config", "PATH"),
    "route --checkpoint": ("route", "p.gr", "--router", "dqn", "--checkpoint", "PATH"),
    "route start=": ("route", "p.gr", "--router", "pathfinder", "start=PATH"),
    "route weights=": ("route", "p.gr", "--router", "generalist", "weights=PATH"),
    "route burn_in=": ("route", "p.gr", "--router", "dqn", "learner.burn_in=PATH"),
    "route --lef": ("route", "p.def", "--lef", "PATH"),
    "route --net": ("route", "p.cap", "--net", "PATH"),
    "evaluate problem": ("evaluate", "PATH", "p.solution"),
    "evaluate": ("evaluate", "p.gr", "PATH"),
    "evaluate --report": ("evaluate", "p.gr", "PATH", "--report"),
    "convert": ("convert", "PATH", "o.gr"),
    "convert --solution": ("convert", "p.gr", "o.solution", "--solution", "PATH"),
    "view": ("view", "p.gr", "PATH", "--out", "o.html"),
    "view, moving": ("view", "p.gr", "PATH", "--out", "o.svg"),
    "view --checkpoint": ("view", "p.gr", "--checkpoint", "PATH", "--out", "o.svg"),
    "config": ("config", "PATH"),
    "train": ("train", "PATH"),
    "train --resume": ("train", "--resume", "PATH"),
    "train problem=": ("train", "env.problem=PATH"),
    "train problems=": ("train", "env.problem=[p.gr, PATH]"),
    "train start=": ("train", "train.start=PATH"),
    "train reference=": ("train", "train.reference=PATH"),
    "train burn_in=": ("train", "env.problem=p.gr", "learner.burn_in=PATH"),
    "experiment": ("experiment", "PATH"),
    "experiment problems=": ("experiment", "e.yaml", "problems=PATH"),
    "experiment problems.a=": ("experiment", "e.yaml", "problems.a=PATH"),
    "experiment start=": ("experiment", "e.yaml", "routers.a={router: pathfinder, start: PATH}"),
    "experiment file=": ("experiment", "e.yaml", "routers.a={router: published, file: PATH}"),
    "experiment config=": ("experiment", "e.yaml", "routers.a={router: dqn, config: PATH}"),
    "experiment checkpoint=": ("experiment", "e.yaml", "routers.a={router: dqn, checkpoint: PATH}"),
    "plot": ("plot", "PATH"),
    "plot after a problem": ("plot", "p.gr", "PATH"),
    "benchmark --config": ("benchmark", "--scenario", "toy-4x4-v0", "--config", "PATH"),
    "benchmark --router": ("benchmark", "--scenario", "toy-4x4-v0", "--router", "./PATH"),
    "benchmark solutions": (
        "benchmark", "--scenario", "toy-4x4-v0", "--config", "e.yaml",
        "routers.a={router: solutions, folder: PATH}",
    ),
}  # fmt: skip

WRITTEN: dict[str, tuple[str, ...]] = {
    "generate": ("generate", "--grid", "4", "4", "2", "--nets", "3", "--out", "PATH"),
    "route": ("route", "p.gr", "--out", "PATH"),
    "convert": ("convert", "p.gr", "PATH"),
    "convert --solution": ("convert", "p.gr", "PATH", "--solution", "p.solution"),
    "evaluate --map": ("evaluate", "p.gr", "p.solution", "--map", "PATH/a.png"),
    "view": ("view", "p.gr", "p.solution", "--out", "PATH/a.html"),
    "view, moving": ("view", "p.gr", "--out", "PATH/a.svg"),
    "train out=": ("train", "t.yaml", "out=PATH"),
    "experiment out=": ("experiment", "e.yaml", "out=PATH"),
    "plot": ("plot", "p.gr", "--out", "PATH"),
    "benchmark": ("benchmark", "--scenario", "toy-4x4-v0", "--router", "astar", "--out", "PATH"),
    "leaderboard": ("benchmark", "--leaderboard", "l.md", "--out", "PATH"),
    "quickstart": ("quickstart", "--out", "PATH"),
}


def refused(capsys: pytest.CaptureFixture[str], words: tuple[str, ...], path: str) -> str:
    """The one line by which a command refuses a path."""
    given = [word.replace("PATH", path) for word in words]
    before = sorted(Path().rglob("*"))
    assert status(given) == 2, given
    out, err = capsys.readouterr()
    assert not out
    lines = [line for line in err.splitlines() if line.startswith("marouting: ")]
    assert len(lines) == 1, err
    assert "Traceback" not in err
    # An experiment can only tell when a router reads its options' files; it goes on there later.
    assert sorted(Path().rglob("*")) == before or words[0] == "experiment"
    return lines[0]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("words", READ.values(), ids=READ)
def test_a_command_refuses_what_cannot_be_read(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    for path in MISSING.values():
        if "\0" not in path:  # no shell passes it
            refused(capsys, words, path)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("words", WRITTEN.values(), ids=WRITTEN)
def test_a_command_refuses_where_it_cannot_write(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    for path in PATHS.values():
        if "\0" not in path:
            refused(capsys, words, path)


FROM_PYTHON: dict[str, Callable[[str], Any]] = {
    "Problem.read": Problem.read,
    "Problem.read lef": lambda path: Problem.read("p.def", lef=[path]),
    "Problem.read net": lambda path: Problem.read("p.cap", net=path),
    "Solution.read": lambda path: Solution.read(path, Problem.read("p.gr")),
    "make": marouting.make,
    "env": lambda path: global_routing_v0.env(problem=path),
    "env of several": lambda path: global_routing_v0.env(problem=["p.gr", path]),
    "read_yaml": read_yaml,
    "load_config": load_config,
    "load_experiment": load_experiment,
    "load_entries": lambda path: load_entries(path, (), None),
    "entry": lambda path: from_text(f"./{path}", None, None),
    "TrainedPolicy": TrainedPolicy.load,
    "read_rows": lambda path: read_rows(Path(path)),
    "plot": lambda path: plot([path]),
    "start": lambda path: make_router("pathfinder", {"start": path}).route(Problem.read("p.gr")),
    "weights": lambda path: make_router("generalist", {"weights": path}),
    "burn_in": lambda path: Run(load_config(None, ["env.problem=p.gr", f"learner.burn_in={path}"])),
    "experiment": lambda path: Experiment(load_experiment("e.yaml", [f"problems.a={path}"])),
}

TO_PYTHON: dict[str, Callable[[str], Any]] = {
    "Problem.write": lambda path: Problem.read("p.gr").write(path),
    "Solution.write": lambda path: Solution.read("p.solution", Problem.read("p.gr")).write(path),
    "Run": lambda path: Run(load_config(None, [f"out={path}"])),
    "Experiment": lambda path: Experiment(load_experiment("e.yaml", [f"out={path}"])),
}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("read", FROM_PYTHON.values(), ids=FROM_PYTHON)
def test_python_refuses_what_cannot_be_read(read: Callable[[str], Any]) -> None:
    for path in MISSING.values():
        with pytest.raises(InputError):
            read(path)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("write", TO_PYTHON.values(), ids=TO_PYTHON)
def test_python_refuses_where_it_cannot_write(write: Callable[[str], Any]) -> None:
    for path in PATHS.values():
        with pytest.raises(InputError):
            write(path)


@pytest.mark.parametrize("path", [path for path in MISSING.values() if "\0" not in path])
def test_an_include_that_cannot_be_read(here: Path, path: str) -> None:
    for included in (path, f"configs/{path}", f"[t.yaml, {path}]"):
        (here / "own.yaml").write_text(f"seed: 1\ninclude: {included}\n")
        with pytest.raises(
            InputError, match=r"own.yaml:2: include: expected a file, found none at"
        ):
            read_yaml("own.yaml")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="nothing is forbidden")
def test_a_folder_that_may_not_be_entered(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "closed").mkdir(mode=0)
    for words in (*READ.values(), *WRITTEN.values()):
        refused(capsys, words, "closed/a")
    for read in (*FROM_PYTHON.values(), *TO_PYTHON.values()):
        with pytest.raises(InputError):
            read("closed/a")
