"""Names are text wherever they are shown, and stay in their folder wherever they name a file."""

import csv
import json
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.text import Text

from marouting import Problem, generate, sequential_astar
from policies import figures
from policies.cli.main import main
from policies.cli.progress import problems_bar, training_bar
from policies.results.run_folder import Episode

NAMES = ["$\\frac$", "$x$ and $y$", "[b]", "[red]x[]", "=1+1", "_u", "a^b_c%d", "日本", "é"]
"""Names that mean something to matplotlib, rich or a spreadsheet, or that ASCII lacks."""

TRAINING: dict[str, Any] = {
    "out": "run",
    "env": {"problem": "problems", "max_steps": 10},
    "learner": {"burn_in_size": 100, "buffer_size": 500, "network": {"hidden": [8]}},
    "train": {"episodes": 2, "figures": False, "tensorboard": False},
}


def problem() -> Problem:
    return generate(1, grid=(4, 4, 2), nets=3, capacity=2, seed=1)[0]


pytestmark = pytest.mark.usefixtures("at_once")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with configurations of a training and of an experiment."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "training.yaml").write_text(yaml.safe_dump(TRAINING))
    experiment = {"out": "out", "jobs": 1, "problems": {"s": "problems"}}
    experiment["routers"] = {"astar": {"router": "astar"}}
    (tmp_path / "experiment.yaml").write_text(yaml.safe_dump(experiment))
    return tmp_path


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs a command: its exit status, and what it prints."""

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        return int(caught.value.code or 0), *capsys.readouterr()

    return run


# --- figures and bars -----------------------------------------------------------------------------


def texts(figure: Any) -> set[str]:
    """The texts that a figure shows, as it shows them, without what has no width."""
    figure.draw_without_rendering()
    shown = [text._preprocess_math(text.get_text()) for text in figure.findobj(Text)]
    assert not any(is_math for _, is_math in shown)
    return {text.replace("\N{ZERO WIDTH SPACE}", "") for text, _ in shown}


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.parametrize("name", [*NAMES, "\\$a$", "half a \udcff"])
def test_figures_show_names_as_they_are(name: str) -> None:
    values = {name: np.arange(3.0), "astar": np.arange(3.0)}
    shown = name.replace("\udcff", "\\udcff")
    order = np.arange(3)
    compared = texts(figures.by_problem(values, order, "WL", name, name))
    assert {shown, f"problems, sorted by {shown} [rank]"} <= compared
    less = texts(figures.decrease_histogram(values, name, name))
    assert f"{shown}: lower on 2 of 3 problems, equal on 1, mean decrease 1" in less
    assert f"decrease in wirelength = {shown}'s minus the router's [edges]" in less
    assert shown in texts(figures.reward_curves({name: [1.0, 2.0]}, title=name))
    routes = texts(figures.comparison({name: sequential_astar(problem())}))
    assert any(text.startswith(f"{shown}: WL") for text in routes)


def test_what_the_font_lacks_is_drawn_in_silence(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figures.save(figures.reward_curves({"日本": [1.0, 2.0]}), tmp_path / "rewards.png")
    assert (tmp_path / "rewards.png").exists()


@pytest.mark.parametrize("name", ["[b]", "[/]", "[red]x", "[bold]", ":smile:"])
def test_bars_show_names_as_they_are(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with problems_bar(f"runs/{name}") as watch:
        watch(1, 2)
    assert f"runs/{name}" in capsys.readouterr().err
    episode = Episode(name, 0, 1.0, 1, 1, 0, 1, 1, 0.0, None, 0, True)
    with training_bar(0, 2) as see:
        see([episode])
    assert f"best of {name}: joined 1/1, OF 0, WL 1 in episode 1" in capsys.readouterr().err


def test_the_bar_of_a_training_says_the_best_and_not_the_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    first = Episode("p", 3, 210.0, 2, 2, 0, 21, 30, 0.0, None, 0, True)
    worse = Episode("p", 4, -50.0, 1, 2, 0, 40, 60, 0.0, None, 0, False)
    with training_bar(0, 2) as see:
        see([first])
        see([worse])
    last = [line for line in capsys.readouterr().err.splitlines() if "best of" in line][-1]
    assert "best of p: joined 2/2, OF 0, WL 21 in episode 4 " in last
    assert "40" not in last
    # A resumed training knows what was best; of several problems it shows the sum.
    other = replace(first, problem="q", joined=1, overflow=3)
    with training_bar(1, 2, best=[first]) as see:
        see([other])
    assert "best of 2 problems: joined 3/4, OF 3, WL 42" in capsys.readouterr().err


# --- files ----------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:Glyph")
def test_a_training_on_problems_of_any_name(
    here: Path, run: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [NAMES[0], "[b]", "日本"]
    for name in names:
        problem().write(here / "problems" / f"{name}.gr")
    drawn: list[Path] = []

    def save(figure: Any, path: Path) -> None:
        drawn.append(path)
        if path.parent.name in (NAMES[0], "figures"):
            figure.draw_without_rendering()

    monkeypatch.setattr(figures, "save", save)
    monkeypatch.setenv("COLUMNS", "200")
    code, out, err = run("train", "training.yaml", "train.figures=true", "train.tensorboard=true")
    assert code == 0, err
    assert all(f" {name} " in out for name in names)
    assert {path.parent.name for path in drawn} == {*names, "figures"}
    assert {path.stem for path in (here / "run" / "problems").iterdir()} == set(names)


def test_an_experiment_on_problems_of_any_name(
    here: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    for name in NAMES:
        problem().write(here / "problems" / f"{name}.gr")
    assert run("experiment", "experiment.yaml")[0] == 0
    with (here / "out" / "results.csv").open(encoding="utf-8", newline="") as lines:
        found = [row["problem"] for row in csv.DictReader(lines)]
    assert found == ["'=1+1" if name == "=1+1" else name for name in sorted(NAMES)]
    # The table is a publication like any other.
    published = "routers={p: {router: published, file: out/results.csv}}"
    assert run("experiment", "experiment.yaml", "out=again", published)[0] == 0
    rows = json.loads((here / "again" / "results.json").read_text())
    assert [row["problem"] for row in rows] == sorted(NAMES)
    assert run("plot", "again")[0] == 0


@pytest.mark.parametrize(
    "name", ["..", ".", ".hidden", "a\nb", "a\x1bb", "x" * 256, os.fsdecode(b"\xff")], ids=ascii
)
def test_names_of_problems_that_name_no_files(
    name: str, here: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "problems").mkdir()
    try:
        problem().write(here / "p.gr")
        (here / "p.gr").rename(here / "problems" / f"{name}.gr")
    except OSError:
        pytest.skip("this file system has no such names")
    for command, config in (("train", "training.yaml"), ("experiment", "experiment.yaml")):
        code, out, err = run(command, config)
        assert (code, out) == (2, "")
        assert "expected a name for files" in err
        assert len(err.splitlines()) == 1
        assert err.rstrip("\n").isprintable()
    assert not (here / "run").exists()
    assert not (here / "out").exists()


@pytest.mark.parametrize(
    "name", ["..", ".", "", "a/b", "/tmp", "a\\b", ".lock", "é" * 120, "x" * 400, "a b"]
)
@pytest.mark.parametrize("key", ["problems", "routers"])
def test_names_in_configurations_that_name_no_files(
    key: str, name: str, here: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    config = yaml.safe_load((here / "experiment.yaml").read_text())
    config["problems"] = {"s": {"nets": 2, "grid": [4, 4, 2]}}
    config[key] = {name: next(iter(config[key].values()))}
    (here / "experiment.yaml").write_text(yaml.safe_dump(config))
    code, out, err = run("experiment", "experiment.yaml")
    assert (code, out) == (2, "")
    assert f"{key}." in err
    assert "expected a name of letters, digits" in err
    assert not (here / "out").exists()


def test_figures_stay_in_their_folder(here: Path, run: Callable[..., tuple[int, str, str]]) -> None:
    problem().write(here / "a" / "p.gr")
    (here / "a" / "p.gr").rename(here / "a" / "...gr")
    code, _, err = run("plot", "a/...gr")
    assert code == 2
    assert "a/...gr: expected another name" in err
    assert [path.name for path in (here / "a").iterdir()] == ["...gr"]


# --- terminals and paths --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "terminal",
    [
        pytest.param({"PYTHONIOENCODING": "ascii"}, marks=pytest.mark.slow),
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"},
    ],
    ids=["output", "everything"],
)
def test_a_terminal_with_ascii(terminal: dict[str, str], here: Path) -> None:
    problem().write(here / "日本.gr")
    problem().write(here / "problems" / "é.gr")
    # Without UTF-8 in names of files either, what stands in ours is refused.
    expected = {
        ("train", "training.yaml"): 0 if len(terminal) == 1 else 2,
        ("experiment", "experiment.yaml", "problems={s: {nets: 2}}"): 0,
        ("plot", "日本.gr"): 0,
        ("route", "é.gr"): 2,
    }
    script = """if True:
        import json, os, sys
        from policies.cli.main import main
        for words in json.loads(sys.argv[1]):
            try:
                main([os.fsdecode(word.encode()) for word in words])
            except SystemExit as end:
                print("status", end.code, file=sys.stderr)
    """
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps([list(words) for words in expected])],
        capture_output=True,
        timeout=300,
        check=True,
        env={**os.environ, **terminal},
    )
    assert b"Traceback" not in done.stderr
    assert b"Error" not in done.stderr
    parts = re.split(rb"^status (\d+)\n", done.stderr, flags=re.MULTILINE)
    said, codes = parts[:-1:2], [int(code) for code in parts[1::2]]
    assert codes == list(expected.values()), done.stderr
    for code, lines in zip(codes, said, strict=True):
        # Whatever takes long, as imports do on a busy machine, says so in a line of its own.
        errors = [line for line in lines.splitlines() if not line.endswith(b" ...")]
        assert code == 0 or len(errors) == 1, lines


@pytest.mark.slow
def test_paths_that_are_not_utf8(here: Path, run: Callable[..., tuple[int, str, str]]) -> None:
    bad = os.fsdecode(b"b\xff")
    try:
        problem().write(here / f"{bad}.gr")
    except (OSError, ValueError):
        pytest.skip("this file system has no such names")
    problem().write(here / "problems" / "p.gr")
    for works in (
        ["route", f"{bad}.gr", "--out", f"{bad}.solution", "--json"],
        ["evaluate", f"{bad}.gr", f"{bad}.solution"],
        ["plot", f"{bad}.gr", f"{bad}.solution", "--out", bad],
        ["convert", f"{bad}.gr", f"{bad}.2.gr"],
        ["generate", "--grid", "4", "4", "2", "--nets", "2", "--out", f"{bad}2"],
    ):
        code, out, err = run(*works)
        assert code == 0, err
        assert out
    assert run("train", "training.yaml")[0] == 0
    (here / "run").rename(here / f"{bad}.run")
    assert run("plot", f"{bad}.run")[0] == 0
    for refused in (
        ["train", "training.yaml", f"out={bad}.new"],
        ["train", "training.yaml", "--resume", f"{bad}.nothing"],
        ["train", f"{bad}.yaml"],
        ["experiment", "experiment.yaml", f"problems={{s: {bad}.gr}}"],
        ["quickstart", "--out", f"{bad}.run"],
    ):
        code, _, err = run(*refused)
        assert code == 2
        assert len(err.splitlines()) == 1
    assert run("train", "training.yaml", "--resume", f"{bad}.run")[0] == 0
