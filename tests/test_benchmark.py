"""The benchmark: the order of scores, result files, resuming, the leaderboard."""

import csv
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from conftest import examples, in_this_process
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from marouting import InputError, Problem, Solution, evaluate, scenarios, sequential_astar
from marouting.config import build, plain
from marouting.scenarios.score import Figures, score
from policies.cli.main import status
from policies.experiment import experiment
from policies.experiment.benchmark import from_text, load_entries
from policies.experiment.config import Budget
from policies.experiment.leaderboard import read_groups
from policies.experiment.result import Outcome, Result, Task, read_result, summarise
from policies.learned.config import Config, load_config
from policies.learned.trainer import Trainer
from policies.results.statistics import bootstrap_interval, interquartile_mean

SCENARIO = "toy-4x4-v0"

FIGURES = st.builds(
    Figures, st.integers(0, 3), st.integers(0, 4) | st.integers(0, 500), st.integers(0, 3000)
)
"""Small numbers often, so that levels agree."""


def sign(x: float) -> int:
    return (x > 0) - (x < 0)


@examples(100)
@given(FIGURES, FIGURES, FIGURES, FIGURES)
def test_scores_are_in_the_order_of_open_nets_overflow_and_wirelength(
    one: Figures, other: Figures, astar: Figures, reference: Figures
) -> None:
    reference, astar = min(reference, astar), max(reference, astar)
    mine, theirs = score(one, astar, reference), score(other, astar, reference)
    assert sign(theirs - mine) == sign((one > other) - (one < other))
    assert -3 < mine < 4


@given(FIGURES, FIGURES, FIGURES)
def test_a_score_is_the_share_of_the_way(
    found: Figures, astar: Figures, reference: Figures
) -> None:
    reference, astar = min(reference, astar), max(reference, astar)
    assert score(reference, astar, reference) == 1
    if reference < astar:
        assert score(astar, astar, reference) == 0
        assert sign(score(found, astar, reference)) == sign((found < astar) - (found > astar))
    mine = score(found, astar, reference)
    assert (mine > 1) == (found < reference)


def test_scores_worked_out_by_hand() -> None:
    astar, best = Figures(0, 0, 120), Figures(0, 0, 100)
    assert score(Figures(0, 0, 105), astar, best) == 0.75
    assert score(Figures(0, 0, 140), astar, best) == -0.5
    assert score(Figures(0, 0, 80), astar, best) == 1.5
    # One track too many, and as long as the reference: −1 − (1 + ½) / (2 + ½).
    assert score(Figures(0, 1, 100), astar, best) == pytest.approx(-1.6)
    assert -3 < score(Figures(1, 0, 50), astar, best) < -2
    # Overflow is at stake: the way leads from (5, 95) to (0, 100), ½ of a track for the wirelength.
    astar = Figures(0, 5, 95)
    assert score(Figures(0, 2, 100), astar, best) == pytest.approx((4.75 - 2) / 4.75, abs=1e-12)
    assert 0.9 < score(Figures(0, 0, 110), astar, best) < 1
    # No room: worse is below 0, and in twentieths of the reference.
    assert score(best, best, best) == 1
    assert score(Figures(0, 0, 105), best, best) == -0.5
    assert 1 < score(Figures(0, 0, 99), best, best) < 2


@given(FIGURES, FIGURES)
def test_the_reference_is_no_worse_than_astar(astar: Figures, reference: Figures) -> None:
    assume(reference > astar)
    with pytest.raises(InputError, match="at least as good as A"):
        score(astar, astar, reference)
    assert not math.isnan(score(astar, reference, reference))


# --- statistics -----------------------------------------------------------------------------------


def test_the_interquartile_mean_and_its_interval() -> None:
    assert interquartile_mean(np.array([-9.0, 1, 2, 3, 4, 99, 2, 4])) == 2.75
    scores = np.random.default_rng(1).normal(size=(60, 1))
    mine = bootstrap_interval(scores)
    theirs = stats.bootstrap(
        (scores.ravel(),),
        lambda x, axis: stats.trim_mean(x, 0.25, axis=axis),
        method="percentile",
        n_resamples=20_000,
        random_state=np.random.default_rng(2),  # called rng from SciPy 1.15 on
    ).confidence_interval
    assert mine == pytest.approx((theirs.low, theirs.high), abs=0.05)
    assert mine == bootstrap_interval(scores)
    # Seeds that all agree tell nothing new; seeds that differ widen the interval of a problem.
    assert bootstrap_interval(np.repeat(scores, 3, axis=1)) == pytest.approx(mine, abs=0.05)
    assert bootstrap_interval(np.full((5, 2), 0.5)) == (0.5, 0.5)
    low, high = bootstrap_interval(np.tile([0.0, 1.0], (1, 8)))
    assert low < high


def made(name: str = "mine", **changes: Any) -> Result:
    """A result of two problems and two seeds."""
    tasks = (
        Task(problem="a", astar=(0, 0, 120), reference=(0, 0, 100), proven=True),
        Task(problem="b", astar=(0, 4, 90), reference=(0, 0, 100), proven=False),
    )
    found = {
        ("a", 0): (0, 0, 105),
        ("a", 1): (0, 0, 100),
        ("b", 0): (0, 4, 90),
        ("b", 1): (1, 0, 9),
    }
    by_name = {task.problem: task for task in tasks}
    fields: dict[str, Any] = {
        "scenario": "some-v0",
        "name": name,
        "router": "astar",
        "options": {"best_of": 2},
        "version": "0",
        "machine": "m",
        "command": "c",
        "date": "2026-01-01",
        "seconds": 10.0,
        "training_seconds": 0.0,
        "tasks": tasks,
        "outcomes": tuple(
            Outcome(
                problem=problem,
                seed=seed,
                open=own[0],
                overflow=own[1],
                wirelength=own[2],
                seconds=float(seed + 1),
                score=by_name[problem].score(Figures(*own)),
            )
            for (problem, seed), own in found.items()
        ),
    }
    return Result(**{**fields, **changes})


def test_a_summary_worked_out_by_hand() -> None:
    row = summarise(made())
    assert row["problems"] == row["seeds"] == 2
    assert row["open"] == 0.5
    assert row["overflow"] == 2
    assert (row["gap"], row["gap_problems"]) == (pytest.approx(2.5), 1)
    assert row["at_reference"] == 25
    assert row["proven"] == 50
    assert (row["wins"], row["ties"], row["losses"]) == (1, 0.5, 0.5)
    assert row["solution_seconds"] == 1.5
    # The middle half of 0.75, 1, 0 and one below −2.
    assert row["score"]["mean"] == pytest.approx(0.375)


# --- result files ---------------------------------------------------------------------------------


def unknown(result: Result, name: str) -> Result:
    """The same without routes, as results are published."""
    rows = tuple(replace(row, open=None, score=None, seconds=None) for row in result.outcomes)
    return replace(result, name=name, outcomes=rows, seconds=None, training_seconds=None)


def test_a_result_file_reads_back(tmp_path: Path) -> None:
    for result in (made(), unknown(made(), "published"), made(curve=((1, -0.5), (10, 1.0)))):
        path = result.write(tmp_path)
        assert path.name == f"some-v0.{result.name}.json"
        assert read_result(path) == result


DAMAGE = {
    "cut": lambda text: text[: len(text) // 2],
    "score": lambda text: text.replace('"score": 0.75', '"score": 0.8'),
    "no score": lambda text: text.replace('"score": 0.75', '"score": null'),
    "nan": lambda text: text.replace('"score": 0.75', '"score": NaN'),
    "negative": lambda text: text.replace('"wirelength": 105', '"wirelength": -105'),
    "problem": lambda text: text.replace('{"problem": "b", "seed"', '{"problem": "c", "seed"', 1),
    "twice": lambda text: text.replace('"seed": 1', '"seed": 0', 1),
    "key": lambda text: text.replace('"machine"', '"maschine"'),
    "format": lambda text: text.replace("benchmark-1", "benchmark-9"),
    "reference": lambda text: text.replace('"reference": [0, 0, 100]', '"reference": [0, 5, 1]'),
    "path": lambda text: text.replace('"name": "mine"', '"name": "../mine"'),
    "lines": lambda text: text.replace('"command": "c"', '"command": "c\\n# heading"'),
    "seeds": lambda text: text.replace('"seed": 0', '"seed": null', 1),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_file_is_one_line(
    damage: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made().write(tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(damage(text), encoding="utf-8")
    assert damage(text) != text
    page = tmp_path / "docs" / "leaderboard.md"
    command = ["benchmark", "--leaderboard", str(page), "--out", str(tmp_path)]
    assert status(command) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert path.name in error
    assert not page.exists()


# --- the leaderboard ------------------------------------------------------------------------------


def test_the_leaderboard_is_made_of_files_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    made("mine", curve=((1, -0.5), (10, 1.0))).write(results)
    unknown(made(), "published").write(results)
    best = tuple(
        replace(
            row,
            open=0,
            overflow=0,
            wirelength=100,
            score=1.0,
        )
        for row in made().outcomes
    )
    made("best", outcomes=best).write(results)
    page = tmp_path / "docs" / "leaderboard.md"
    command = ["benchmark", "--leaderboard", str(page), "--out", str(results)]
    assert status(command) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [path.name for path in written] == [
        "leaderboard.md",
        "some-v0-scores.png",
        "some-v0-curves.png",
    ]
    text = page.read_text(encoding="utf-8")
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line[:3] == "| `"]
    assert [line[0] for line in lines] == ["`best`", "`mine`", "`published`"]
    header = next(line for line in text.splitlines() if line.startswith("| router"))
    columns = header.strip("| ").split(" | ")
    shown = dict(zip(columns, lines[2], strict=True))
    for column in ("score", "open", "gap, %", "at reference, %", "W/T/L", "seconds", "rerun"):
        assert shown[column] == "?", column
    assert shown["overflow"] == "2"
    for path in written[1:]:
        assert f"pictures/leaderboard/{path.name}" in text
    assert "../scenarios.md" not in text  # this page is in no documentation that has it
    # Made again from the same files, it is the same.
    assert status([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(path) for path in written]
    assert page.read_text(encoding="utf-8") == text


def rescored(result: Result, *tasks: Task, **found: tuple[int, int, int]) -> Result:
    """A result with other tasks, and other figures of some problems."""
    by_name = {task.problem: task for task in tasks}
    rows = []
    for row in result.outcomes:
        own = Figures(*found.get(row.problem, row.figures or ()))
        figures = {"open": own.open, "overflow": own.overflow, "wirelength": own.wirelength}
        rows.append(replace(row, **figures, score=by_name[row.problem].score(own)))
    return replace(result, tasks=tasks, outcomes=tuple(rows))


def test_all_rows_are_scored_against_the_best_solution(tmp_path: Path) -> None:
    """That of a file, or one that a router has found; none is better than a proven optimum."""
    old, new = made("old"), made("new")
    a, b = (replace(task, proven=False) for task in old.tasks)
    known = replace(a, reference=(0, 0, 95), proven=True)
    rescored(old, a, b).write(tmp_path)
    rescored(new, known, b, b=(0, 0, 98)).write(tmp_path)
    ((group, found),) = read_groups(tmp_path).items()
    assert group == ("some-v0", "test")
    for result in found:
        assert result.tasks == (known, replace(b, reference=(0, 0, 98)))
        assert result.outcomes[0].score == pytest.approx(15 / 25)
    assert {row.score for row in found[0].outcomes if row.problem == "b"} == {1.0}
    better = rescored(old, a, b, a=(0, 0, 94))
    for wrong in (better, rescored(old, replace(a, reference=(0, 0, 94)), b)):
        wrong.write(tmp_path)
        what = r"old.json: (outcomes|tasks): a: expected none better than the proven optimum \(0, 0"
        with pytest.raises(InputError, match=what):
            read_groups(tmp_path)
    rescored(old, a, b).write(tmp_path)
    other = (replace(new.tasks[0], astar=(0, 0, 121)), new.tasks[1])
    rows = tuple(
        replace(row, score={t.problem: t for t in other}[row.problem].score(row.figures))
        for row in new.outcomes
        if row.figures
    )
    replace(new, name="another", tasks=other, outcomes=rows).write(tmp_path)
    with pytest.raises(InputError, match=r"astar: expected \[0, 0, 120\]|expected \[0, 0, 121\]"):
        read_groups(tmp_path)
    with pytest.raises(InputError, match="expected result files"):
        read_groups(tmp_path / "nothing")


def test_files_agree_with_the_references_of_the_package(tmp_path: Path) -> None:
    docs = Path(__file__).resolve().parents[1] / "docs"
    toy = docs / "results/benchmark/toy-4x4-v0.astar.json"
    text = toy.read_text(encoding="utf-8")
    first = read_result(toy).tasks[0]
    path = tmp_path / "a.json"
    for changed, said in (
        (text.replace('"toy-4x4-v0"', '"two-pin-8x8-v0"', 1), "none better than the proven opt"),
        (text.replace('"toy-4x4-v0"', '"tight-16x16-v0"', 1), "tasks: expected those of tight-16"),
    ):
        path.write_text(changed, encoding="utf-8")
        with pytest.raises(InputError, match=said):
            read_groups(tmp_path)
    path.write_text(text, encoding="utf-8")
    ((_, (found,)),) = read_groups(tmp_path).items()
    assert found.tasks[0] == first


# --- entries --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "budget"),
    [
        ("1s", Budget(seconds=1)),
        ("0.5 s", Budget(seconds=0.5)),
        ("2min", Budget(seconds=120)),
        ("16", Budget(samples=16)),
        ("500 episodes", Budget(samples=500)),
    ],
)
def test_budgets(text: str, budget: Budget) -> None:
    assert Budget.parse(text) == budget
    assert Budget.parse(budget.text) == budget


@pytest.mark.parametrize("text", ["", "s", "-1s", "0s", "1.5", "1h", "nan", "1e9s", "١s"])
def test_what_is_no_budget(text: str) -> None:
    with pytest.raises(InputError, match=r"^budget: expected"):
        Budget.parse(text)


def test_a_budget_fills_in_what_the_router_knows() -> None:
    second, tries = Budget(seconds=1), Budget(samples=7)

    def told(text: str, budget: Budget | None, *keys: str) -> list[Any]:
        entry = from_text(text, None, budget)
        return [entry.allowed, *(entry.options.get(key) for key in keys)]

    assert told("pathfinder", second, "seconds") == ["1 s", 1]
    assert told("pathfinder seconds=3", second, "seconds") == ["3 s", 3]
    assert told("optimal", second, "time_limit") == ["1 s", 1]
    assert told("optimal", None, "time_limit") == [None, None]
    assert told("astar", second, "seconds") == [None, None]
    assert told("astar best_of=5", second, "seconds") == ["best of 5, 1 s", 1]
    assert told("astar", tries, "best_of") == ["best of 7", 7]
    assert told("random", second) == [None]
    entry = from_text("dqn", None, tries)
    assert entry.allowed == "7 episodes"
    assert entry.options["train"]["episodes"] == 7
    assert from_text("astar best_of=16 target=tree", None, None).name == "astar-16-tree"


def test_the_rules_of_a_scenario_are_its_best_one_and_those_of_all() -> None:
    entries, _ = load_entries("configs/benchmark/rules.yaml", (), None)
    levels = [name for name in scenarios.names() if scenarios.get(name).has_local_rule("test")]
    best = [name for entry in entries for name in entry.only or ()]
    assert sorted(best) == sorted(levels)


@pytest.mark.parametrize("name", ["baselines", "learners"])
def test_the_configurations_that_travel_with_the_package(name: str) -> None:
    entries, config = load_entries(f"configs/benchmark/{name}.yaml", (), None)
    assert config.seeds == 3
    names = [entry.name for entry in entries]
    if name == "baselines":
        assert names == ["random", "greedy", "astar", "astar-16", "pathfinder", "optimal"]
        budgets = [entry.allowed for entry in entries]
        assert budgets == [None, None, None, "best of 16, 1 s", "1 s", "30 s"]
    else:
        one, many = ["dqn-single"], ["dqn-multi", "dqn-multi-rounds", "dqn-double-dueling"]
        assert names == [*one, *many, "ippo", "mappo"]
        assert {entry.allowed for entry in entries} == {"500 episodes"}


def test_the_ablation_adds_one_thing_at_a_time_and_has_the_grown_learner() -> None:
    entries, config = load_entries("configs/benchmark/ablation.yaml", (), None)
    assert config.seeds == 3
    rows = {entry.name: entry.options for entry in entries}
    assert list(rows) == sorted(rows)  # in the order in which things are added
    grown = plain(load_config("configs/grown.yaml"))
    options = rows["l-grown"]
    for part in ("env", "learner"):
        assert options[part] == {key: grown[part][key] for key in options[part]}
    assert options["train"]["episodes"] == grown["train"]["episodes"]


# --- runs -----------------------------------------------------------------------------------------

MINE = """
import marouting


class Mine:
    def __init__(self, order: str = "file"):
        self.order = order

    def route(self, problem):
        return marouting.sequential_astar(problem, self.order)
"""

ROUTERS = ("astar", "random max_steps=9", "mine:Mine order=half_perimeter", "solved", "policy.pt",
           "other.csv")  # fmt: skip
NAMES = ("astar", "random-9", "mine-Mine-half_perimeter", "solved", "policy", "other")


def problems() -> dict[str, Problem]:
    return scenarios.get(SCENARIO).problems("validation")


def command(*more: str) -> list[str]:
    split = ["--split", "validation", "--seeds", "2", "jobs=1", "--out", "out"]
    routers = [word for router in ROUTERS for word in ("--router", router)]
    return ["benchmark", "--scenario", SCENARIO, *split, *routers, *more]


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a benchmark of every form of entry has run."""
    folder = tmp_path_factory.mktemp("benchmark")
    (folder / "mine.py").write_text(MINE)
    for name, problem in problems().items():
        sequential_astar(problem).write(folder / "solved" / f"{name}.some.solution")
    (folder / "astar").mkdir()  # no folder stands for a router's name
    rows = [("set", "problem", "overflow", "wirelength")]
    rows += [(SCENARIO, name, "1", "20") for name in problems()]
    with (folder / "other.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    first = next(iter(problems().values()))
    raw = {"env": {"max_steps": 9}, "learner": {"burn_in_size": 40}, "train": {"episodes": 1}}
    trainer = Trainer({"p": first}, build(Config, raw))
    for _ in trainer.run():
        pass
    torch.save(trainer.saved.state(), folder / "policy.pt")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        patch.setattr(experiment, "work_on", in_this_process)
        assert status(command()) == 0
    return folder


@pytest.fixture
def here(there: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(there)
    return there


def of(name: str) -> Path:
    return Path("out") / f"{SCENARIO}.validation.{name}.json"


def test_results_are_those_of_the_solutions(here: Path) -> None:
    written = {path.name for path in (here / "out").glob("*.json")}
    assert written == {"results.json", *(of(name).name for name in NAMES)}
    ((_, found),) = read_groups(here / "out").items()
    assert {result.name for result in found} == set(NAMES)
    scenario = scenarios.get(SCENARIO)
    for name in NAMES[:-1]:
        result = read_result(of(name))
        seeds = [0, 1] if name == "random-9" else [None]
        assert [(row.problem, row.seed) for row in result.outcomes] == [
            (problem, seed) for problem in problems() for seed in seeds
        ]
        for row in result.outcomes:
            task, problem = result.by_name[row.problem], problems()[row.problem]
            best = scenario.reference(problem)
            assert (*task.reference[1:], task.proven) == tuple(best)
            if name in ("astar", "solved", "mine-Mine-half_perimeter"):
                found = evaluate(problem, sequential_astar(problem))
                assert row.figures == task.astar == (0, found.overflow, found.wirelength)
                assert row.score == (1 if task.astar == task.reference else 0)
    walked = [row.figures for row in read_result(of("random-9")).outcomes]
    assert {found.overflow for found in walked if found} == {0}
    assert max(found.open for found in walked if found) > 0
    assert walked[0::2] != walked[1::2]
    assert {row.figures for row in read_result(of("other")).outcomes} == {None}
    assert read_result(of("policy")).training_seconds is None
    assert read_result(of("astar")).training_seconds == 0
    # A folder's row is no time of ours.
    assert read_result(of("solved")).seconds is None


def test_a_run_that_is_finished_routes_nothing_again(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = {path: path.read_bytes() for path in (here / "out").rglob("*") if path.is_file()}
    assert status(command("--json")) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["files"] == [str(of(name)) for name in NAMES]
    assert [row["name"] for row in shown["rows"]] == list(NAMES)
    assert [row["open"] is None for row in shown["rows"]] == [False] * 5 + [True]
    for path, content in kept.items():
        if path.suffix == ".json" and path.parent == here / "out" and path.name != "results.json":
            continue  # written again, perhaps on another day
        assert path.read_bytes() == content
    assert status(command()) == 0
    table = capsys.readouterr().out
    assert "?" in table
    assert all(name[:20] in table for name in NAMES)


def without_times(path: Path) -> Any:
    result = json.loads(path.read_text(encoding="utf-8"))
    del result["seconds"], result["date"]
    for row in result["outcomes"]:
        del row["seconds"]
    return result


def test_a_run_goes_on(here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(here, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    expected = without_times(of("random-9"))
    rows = sorted(Path("out", "rows").rglob("random-9*/*.json"))
    assert len(rows) == 2 * len(problems())
    kept = {path: path.read_bytes() for path in rows[::2]}
    for path in rows[1::2]:
        path.unlink()
    of("random-9").unlink()
    assert status(command()) == 0
    assert without_times(of("random-9")) == expected
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert all(path.exists() for path in rows)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--router", "astar"], r"--scenario: expected one of toy-4x4-v0"),
        (
            ["--scenario", "toy-4x4-v1", "--router", "astar"],
            r"--scenario: unknown name .*; did you mean toy-4x4-v0",
        ),
        (["--scenario", SCENARIO, "--router", "astr"], r"did you mean astar"),
        (["--scenario", SCENARIO, "--router", "no/such.pt"], r"expected a file or a folder"),
        (
            ["--scenario", SCENARIO, "--router", "mine:Mine order=no.pt"],
            r"expected one of .*no\.pt",
        ),
        (["--scenario", SCENARIO, "--router", "no/such"], r"expected a file or a folder"),
        (["--scenario", SCENARIO, "--router", "astar best_off=2"], r"did you mean best_of"),
        (["--scenario", SCENARIO, "--router", "astar", "--budget", "x"], r"budget: expected"),
        (["--scenario", SCENARIO, "--router", "astar", "--router", "astar"], r"there are two"),
        (["--scenario", SCENARIO, "--router", "astar", "--seeds", "0"], r"seeds: expected"),
        (["--scenario", SCENARIO, "--router", "astar", "jobs=0"], r"jobs: expected"),
        (["--scenario", SCENARIO, "--router", "mine.py"], r"mine\.py"),
        (["--scenario", SCENARIO, "--router", "solved"], r"one solution test_000\.\*, found none"),
        (["--scenario", SCENARIO, "--router", "other.csv"], r"a row for toy-4x4-v0,test_000"),
        (
            ["--leaderboard", "l.md", "--router", "astar"],
            r"--leaderboard: expected only --out with it, found --router",
        ),
        (["--leaderboard", "l.md", "--seeds", "2", "jobs=3"], r"found jobs=3, --seeds"),
    ],
)
def test_wrong_input_is_one_line(
    words: list[str], message: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["benchmark", *words, "--out", str(here / "other")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(message, error), error


@pytest.mark.usefixtures("at_once")
def test_other_options_need_another_name(
    here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(here, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    words = ["benchmark", "--scenario", SCENARIO, "--split", "validation", "--out", "out"]
    assert status([*words, "--router", "astar target=tree", "--name", "astar"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "routers.astar.target: expected 'pin', as in out/config.yaml, found 'tree'" in error
    monkeypatch.setattr("policies.experiment.benchmark.__version__", "9")
    assert status([*words, "--router", "astar"]) == 2
    assert "routers.astar.version: expected " in capsys.readouterr().err
    # Of routers that are not asked for nothing is read, code that they name neither.
    several = ["--router", "astar target=tree", "--router", "greedy", "--name"]
    assert status([*words, *several, "tree"]) == 2
    assert "--name: expected one --router with it, or {name} in it" in capsys.readouterr().err
    assert status([*words, *several, "{name}-new"]) == 0
    for name in ("astar-tree-new", "greedy-new"):
        result = read_result(Path("out", f"{SCENARIO}.validation.{name}.json"))
        assert result.name == name
        assert "--name '{name}-new'" in result.command


def test_problems_of_another_version_are_not_mixed(
    here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(here, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    first, second = sorted(Path("out", "problems").rglob("*.gr"))[:2]
    shutil.copy(second, first)
    assert status(command()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert first.name in error


@pytest.mark.slow
def test_a_benchmark_that_is_killed_comes_to_the_same_end(here: Path, tmp_path: Path) -> None:
    for name in ("mine.py", "policy.pt", "other.csv"):
        shutil.copy(here / name, tmp_path)
    shutil.copytree(here / "solved", tmp_path / "solved")
    words = [sys.executable, "-m", "policies.cli.main", *command()]
    rng, kills = np.random.default_rng(7), 0
    whole = tmp_path / "whole"
    shutil.copytree(tmp_path, whole, ignore=shutil.ignore_patterns("whole"))
    began = time.monotonic()
    subprocess.run(words, cwd=whole, check=True)
    takes = time.monotonic() - began
    while True:
        process = subprocess.Popen(words, cwd=tmp_path, start_new_session=True)
        try:
            assert process.wait(timeout=takes * rng.uniform(0.3, 0.9) if kills < 6 else 300) == 0
            break
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
            time.sleep(0.1)
    assert kills > 0
    for name in NAMES:
        assert without_times(tmp_path / of(name)) == without_times(of(name))
    left = [path for path in (tmp_path / "out").rglob(".*") if path.is_file()]
    assert left == []
    one = next(iter(problems().items()))
    path = tmp_path / f"out/solutions/{SCENARIO}.validation/{one[0]}.astar.solution"
    assert Solution.read(path, one[1]) == sequential_astar(one[1])
