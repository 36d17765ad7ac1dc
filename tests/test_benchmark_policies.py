"""The benchmark on the scenarios of policies: one mechanism with `train` and `evaluate_policy`."""

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from conftest import in_this_process, some_slow
from scipy import stats

from marouting import InputError, evaluate_policy, scenarios
from policies.cli.main import status
from policies.experiment import experiment
from policies.experiment.anarchy import FOLDER, RULES, best_local, read_rows
from policies.experiment.benchmark import from_text
from policies.experiment.leaderboard import read_groups
from policies.experiment.played import About
from policies.experiment.result import Outcome, Result, Scale, Task, read_result, summarise
from policies.learned.config import load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run
from policies.routers.local import LocalRouter

ROOT = Path(__file__).resolve().parents[1]
GATES = "gates-8x7-v0"

OWN = """
import numpy as np

from marouting.batch.window import WindowObservation


class First:
    parameters = 0
    training = {"agent_steps": 7, "processor_seconds": 1.5, "teacher": True}

    def __init__(self, reverse: bool = False):
        self.reverse = reverse

    def moves(self, observations, masks):
        if self.reverse:
            return masks.shape[1] - 1 - masks[:, ::-1].argmax(axis=1)
        return masks.argmax(axis=1)


class Sees(WindowObservation):
    pass


class Liar(WindowObservation):
    local_radius = 1


class Far(First):
    options = {"observation": {"kind": "window", "radius": 2, "channels": ["capacity", "demand"]}}


class Lies(First):
    options = {"observation": {"kind": "own:Liar", "radius": 3}}


class Later(First):
    options = {"turn_order": "sequential"}


class Few(First):
    def moves(self, observations, masks):
        return masks.argmax(axis=1)[1:]


class Listed(First):
    options = ["turn_order"]


class Many(First):
    parameters = "many"


class Shaped(First):
    obs_shape = 5


class Loads(First):
    def __init__(self, file: str = "", folder: str = ""):
        self.reverse = False


class Trained(First):
    def __init__(self, file: str):
        self.reverse = False
        steps, seconds = map(float, open(file).read().split())
        self.training = {"agent_steps": int(steps), "processor_seconds": seconds}
"""


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with trainings of two seeds, and what the first of them printed."""
    folder = tmp_path_factory.mktemp("policies")
    (folder / "own.py").write_text(OWN)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        patch.setattr(experiment, "work_on", in_this_process)
        yield folder


@pytest.fixture(autouse=True)
def here(there: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(there)
    return there


def benchmark(*words: str, split: str = "test", out: str = "out") -> list[str]:
    return ["benchmark", "--scenario", GATES, "--split", split, "--out", out, "jobs=1", *words]


def row_of(capsys: pytest.CaptureFixture[str], *words: str, **options: str) -> dict[str, Any]:
    capsys.readouterr()
    assert status([*benchmark(*words, **options), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert isinstance(row, dict)
    return row


TRAIN = ["learner.kind=ppo", f"env.scenario={GATES}", "train.steps=2500", "train.figures=false",
         "train.tensorboard=false", "train.problems=64"]  # fmt: skip


def test_figures_are_those_of_train_and_of_evaluate_policy(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = []
    for seed in (0, 1):
        words = ["train", *TRAIN, f"seed={seed}", f"out=runs/ppo-{seed}", "--json"]
        capsys.readouterr()
        assert status(words) == 0
        told.append(json.loads(capsys.readouterr().out))
    for split in ("validation", "test"):
        row = row_of(capsys, "--router", "runs/ppo-0", "--name", "one", split=split)
        printed = told[0][split]
        policy = TrainedPolicy.load(here / "runs/ppo-0/policy.pt")
        found = evaluate_policy(policy.moves, GATES, split, **policy.options)  # type: ignore[arg-type]
        for key in ("cost", "solved", "connected", "gap", "overflow"):
            assert row[key] == pytest.approx(printed[key]), key
            assert row[key] == pytest.approx(getattr(found, key)), key
        assert row["score"]["mean"] == pytest.approx(printed["score"])
        assert row["score"]["mean"] == pytest.approx(found.score)
        assert row["score"]["low"] == row["score"]["high"] == row["score"]["mean"]
    assert (row["sight"], row["teacher"], row["parameters"]) == ("radius 3", False, 66_950)
    assert 2500 <= row["agent_steps"] < 2500 + 128 * 50 * 4
    assert 0 < row["training_seconds"] < 600
    # One row of two files, with the seed in their names.
    both = row_of(capsys, "--router", "runs/ppo-{seed}", "--seeds", "2")
    assert (both["name"], both["seeds"]) == ("ppo", 2)
    assert both["costs"] == pytest.approx([one["test"]["cost"] for one in told])
    scores = [one["test"]["score"] for one in told]
    assert both["score"]["mean"] == pytest.approx(sum(scores) / 2)
    assert [both["score"]["low"], both["score"]["high"]] == pytest.approx(sorted(scores))
    # Trained by the benchmark itself, it is the same.
    options = ["train.problems=64", "train.figures=false", "--training-steps", "2500"]
    again = row_of(capsys, "--router", "ppo", "--name", "again", "--seeds", "2", *options)
    assert again["costs"] == both["costs"]
    result = read_result(Path("out", f"{GATES}.again.json"))
    assert result.budget == "2500 agent-steps"
    assert "--name again --training-steps 2500 --seeds 2" in result.command


OTHERS = ("braess-v0", "online-8x8-v0", "multi-pin-once-8x8-v0")


@pytest.mark.parametrize("name", some_slow((GATES, *OTHERS), OTHERS))
def test_rules_have_the_costs_of_the_price_of_anarchy(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = read_rows(ROOT / FOLDER / f"{name}.csv")
    best = best_local(stored)["test"]
    command = ["benchmark", "--scenario", name, "--out", f"rules-{name}", "jobs=1", "--json"]
    capsys.readouterr()
    assert status([*command, "routers.pathfinder=null"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert {"random", "greedy", "shortest", "selfish", "always-detour", "astar"} < set(rows)
    (row,) = (row for of, row in rows.items() if of.startswith("price-"))
    assert row["cost"] == pytest.approx(best.cost, abs=1e-4)
    assert row["score"]["mean"] == pytest.approx(0, abs=2e-3)
    assert row["sight"] == f"radius {best.radius}"
    assert (row["teacher"], row["parameters"], row["agent_steps"]) == (False, 0, 0)
    selfish = LocalRouter(radius=None)
    expected = next(of for of in stored if of.split == "test" and of.router == selfish)
    assert rows["selfish"]["cost"] == pytest.approx(expected.cost, abs=1e-4)
    if name == GATES:
        for rule, sight in ((RULES[1], "radius 0"), (LocalRouter(radius=None), "full sight")):
            options = f"local rule={rule.rule} radius=null"
            shown = row_of(capsys, "--router", options, "--name", rule.rule)
            expected = next(of for of in stored if of.split == "test" and of.router == rule)
            assert shown["cost"] == pytest.approx(expected.cost, abs=1e-4)
            assert shown["sight"] == sight
        planner = row_of(capsys, "--router", "optimal", "--name", "optimal")
        assert planner["sight"] == "planner"
        assert planner["cost"] == planner["score"]["mean"] == 1
        # Overflow costs as much as an open task: A* crosses full edges.
        astar = row_of(capsys, "--router", "astar")
        assert astar["overflow"] > 0
        assert astar["cost"] > 1


def test_own_policies_are_rows(capsys: pytest.CaptureFixture[str]) -> None:
    row = row_of(capsys, "--router", "own:First reverse=true", "--name", "last")
    last = evaluate_policy(lambda _, masks: 5 - masks[:, ::-1].argmax(axis=1), GATES)
    assert row["cost"] == pytest.approx(last.cost)
    assert (row["sight"], row["teacher"]) == ("radius 3", True)
    assert (row["agent_steps"], row["training_seconds"]) == (7, 1.5)
    row = row_of(capsys, "--router", "own:Far", "--name", "far")
    assert row["sight"] == "whole board"


def test_rows_of_what_has_changed_since_are_refused(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "changing_policy.py").write_text(OWN)
    (here / "kept").mkdir()
    files = [here / name for name in ("changing_policy.py", "weights.txt", "kept/weights.txt")]
    for file in files[1:]:
        file.write_text("1")
    words = "--router", "changing_policy:Loads file=weights.txt folder=kept", "--name", "loads"
    for file, named in zip(files, ("changing_policy:Loads", "weights.txt", "kept"), strict=True):
        out = f"changed-{file.parent.name}-{file.stem}"
        assert status(benchmark(*words, out=out)) == 0
        before = file.read_text()
        file.write_text(f"{before}\n")
        assert status(benchmark(*words, out=out)) == 2
        error = capsys.readouterr().err.splitlines()[-1]
        said = f"{named}: changed since the rows in {out} were made"
        assert error == f"marouting: {said}: expected another folder for out"
        file.write_text(before)
        assert status(benchmark(*words, out=out)) == 0
        # Without rows there is nothing that could be of another content.
        file.write_text(f"{before}\n")
        shutil.rmtree(here / out / "rows")
        assert status(benchmark(*words, out=out)) == 0
        file.write_text(before)
    assert status(benchmark(*words, out="changed-last")) == 0
    (here / "weights.txt").unlink()  # rows are enough
    assert status(benchmark(*words, out="changed-last")) == 0


def test_seeds_of_different_budgets_are_no_row(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--router", "own:Trained file=took-{seed}.txt", "--name", "took", "--seeds", "2"]
    budgets = {"same": (1000, 5.0), "time": (3000, 4.0), "other": (9000, 50.0)}
    (here / "took-0.txt").write_text("1000 4.5")
    for out, (steps, seconds) in budgets.items():
        (here / "took-1.txt").write_text(f"{steps} {seconds}")
        assert status(benchmark(*words, out=f"budgets-{out}")) == (2 if out == "other" else 0)
    error = capsys.readouterr().err.splitlines()[-1]
    what = "expected trainings of one length, found agent-steps of [1000, 9000]"
    assert error == f"marouting: routers.took: seeds: {what}"


REFUSED = {
    "own:Lies": r"Liar.local_radius: expected agents to see no further than 1 Gcells",
    "own:Later": r"turn_order: expected round_robin, as gates-8x7-v0 is played, found sequential",
    "own:Sees": r"own:Sees: expected a class with a method route or moves, or a learner",
    "own:First other=1": "other",
    "own:Few": r"policy: expected \(249,\) integers, one for each observation, found int64 \(248,",
    "own:Listed": r"options: expected a mapping, found \['turn_order'\]",
    "own:Shaped": r"obs_shape: expected a shape, found 5",
    "own:Many": r"parameters: expected a whole number or null, found 'many'",
}


@pytest.mark.parametrize("router", REFUSED)
def test_what_is_refused(router: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(benchmark("--router", router, out="refused")) == 2
    told = capsys.readouterr().err.splitlines()
    (error,) = (line for line in told if not line.startswith("compiling "))
    assert re.search(REFUSED[router], error), error


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--scenario", GATES, "--router", "astar", "--training-steps", "5"],
            r"^marouting: --training-steps: expected a learner to train, and one scenario",
        ),
        (
            ["--scenario", "toy-4x4-v0", "--router", "ppo", "--training-seconds", "5"],
            r"^marouting: --training-seconds: expected a learner to train",
        ),
        (
            ["--scenario", GATES, "--router", "ppo", "--budget", "16"],
            r"^marouting: --budget: expected --training-steps or --training-seconds: ppo is",
        ),
        (
            ["--scenario", GATES, "--router", "ppo train.steps=3", "--training-steps", "5"],
            r"train.steps: expected none beside --training-steps",
        ),
        (
            ["--scenario", GATES, "--scenario", "braess-v0", "--router", "ppo"],
            r"^marouting: --scenario: expected gates-8x7-v0 alone with ppo, which is",
        ),
        (
            ["--scenario", "toy-4x4-v0", "--router", "own:First"],
            r"own-First.router: expected a class with a method route: one with moves alone plays ",
        ),
    ],
)
def test_contradictions_are_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["benchmark", *words, "--out", "contradictions"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(said, error), error


def test_a_training_ends_with_its_time(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["train.problems=64", "train.figures=false", "train.seconds=1.5", "jobs=1"]
    words = ["--split", "validation", "--router", "ppo", "--name", "ppo", "--seeds", "1", "--json"]
    capsys.readouterr()
    assert status(["benchmark", "--scenario", GATES, *words, *options]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert 1.5 <= row["training_seconds"] < 15
    assert 0 < row["agent_steps"] < 1_000_000
    # A folder of its own: for another scenario the same learner is another router.
    result = read_result(Path(f"runs/benchmark-{GATES}", f"{GATES}.validation.ppo.json"))
    assert result.budget == "1500000 agent-steps, 1.5 s of training"
    entry = from_text("ppo train.seconds=2.5", None, None, GATES)
    assert entry.options["train"]["seconds"] == 2.5


def test_weights_to_start_from_hand_on_their_teacher(tmp_path: Path) -> None:
    def teacher(*words: str) -> bool | None:
        config = load_config(None, [*TRAIN, "train.steps=300", f"out={tmp_path / 'run'}", *words])
        return Run(config).figures.teacher

    first = Run(load_config(None, [*TRAIN, "train.steps=300", f"out={tmp_path / 'first'}"]))
    first.execute()
    saved = tmp_path / "first" / "policy.pt"
    state = torch.load(saved, weights_only=True)
    assert state["figures"]["teacher"] is False
    for told in (False, True, None):
        state["figures"]["teacher"] = told
        torch.save(state, saved)
        assert teacher(f"train.start={saved}") is told
        shutil.rmtree(tmp_path / "run")
    assert teacher("learner.kind=iql") is True  # A* fills its memory
    shutil.rmtree(tmp_path / "run")
    assert teacher("learner.kind=iql", "learner.burn_in=random") is False


# The table ----------------------------------------------------------------------------------------


def made(name: str = "mine", costs: tuple[int, ...] = (105, 110, 130), **changes: Any) -> Result:
    """A result on one problem, of a seed for each cost."""
    task = Task(problem="a", astar=(0, 4, 120), reference=(0, 0, 100), proven=True, tasks=4)
    fields: dict[str, Any] = {
        "scenario": GATES,
        "name": name,
        "router": "ppo",
        "options": {},
        "version": "0",
        "machine": "m",
        "command": "c",
        "date": "2026-01-01",
        "seconds": 10.0,
        "training_seconds": 4.0,
        "scale": Scale(local_rule=1.2, open_cost=20),
        "policy": About(sight="radius 3", teacher=False, parameters=1234, agent_steps=10**6),
        "tasks": (task,),
        "outcomes": tuple(
            Outcome(
                problem="a",
                seed=seed,
                open=cost // 130,
                overflow=0,
                wirelength=cost - 20 * (cost // 130),
                seconds=1.0,
                score=None,
                open_tasks=cost // 130,
            )
            for seed, cost in enumerate(costs)
        ),
    }
    return Result(**{**fields, **changes})


def test_a_summary_worked_out_by_hand(tmp_path: Path) -> None:
    row = summarise(made())
    assert row["costs"] == pytest.approx([1.05, 1.1, 1.3])
    # A cost of open tasks need not be a whole number.
    file = made(scale=Scale(local_rule=1.2, open_cost=20.5)).write(tmp_path / "half")
    assert summarise(read_result(file))["costs"] == pytest.approx([1.05, 1.1, 1.305])
    scores = [0.75, 0.5, -0.5]
    assert row["score"]["mean"] == pytest.approx(stats.trim_mean(scores, 0.25))
    assert -0.501 < row["score"]["low"] < row["score"]["mean"] < row["score"]["high"] < 0.751
    assert row["solved"] == pytest.approx(2 / 3)
    assert row["connected"] == pytest.approx(11 / 12)
    assert row["gap"] == pytest.approx(7.5)
    five = summarise(made(costs=(101, 102, 103, 104, 129)))
    assert five["score"]["mean"] == pytest.approx(0.85)  # the middle three
    path = made().write(tmp_path)
    assert read_result(path) == made()
    bare = replace(made().tasks[0], reference=None, proven=False)
    with pytest.raises(InputError, match=r"^tasks: expected the reference of each"):
        made(tasks=(bare,))
    for damage in ({"scale": None}, {"policy": None}):
        with pytest.raises(InputError, match=r"policy: expected one with a scale|score: expected"):
            made(**damage)
    low = replace(made().outcomes[0], open_tasks=5)
    with pytest.raises(InputError, match="row 1: open_tasks: expected at most the tasks"):
        made(outcomes=(low,))


MADE_UP = "own-gates"
"""Results of the package's own scenarios have to agree with its references."""


def test_policies_have_a_table_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    made("mine", scenario=MADE_UP, curve=((100, -0.5), (1000, 0.9))).write(results)
    made("bound", scenario=MADE_UP, policy=About(sight="planner"), costs=(100,)).write(results)
    task = Task(problem="a", astar=(0, 0, 120), reference=(0, 0, 100), proven=True)
    row = Outcome(problem="a", seed=None, open=0, overflow=0, wirelength=110, score=0.5)
    plain = made(scenario="a-toy", scale=None, policy=None, tasks=(task,), outcomes=(row,))
    plain.write(results)
    page = tmp_path / "page.md"
    assert status(["benchmark", "--leaderboard", str(page), "--out", str(results)]) == 0
    names = [Path(line).name for line in capsys.readouterr().out.splitlines()]
    assert names == [
        "page.md",
        "a-toy-scores.png",
        f"{MADE_UP}-scores.png",
        f"{MADE_UP}-curves.png",
    ]
    planners, policies = page.read_text(encoding="utf-8").split("## Policies")
    assert f"--out {results.as_posix()} --leaderboard {page.as_posix()}` from" in planners
    assert "in [results](results);" in planners
    assert "### a-toy" in planners
    assert MADE_UP not in planners
    lines = [line for line in policies.splitlines() if line.startswith("| `")]
    assert [line.split(" | ")[0] for line in lines] == ["| `bound`", "| `mine`"]
    assert " planner | ? | ? | ? | " in lines[0]
    assert (
        " | 1.1500 | 66.7 | 91.7 | 7.50 | radius 3 | no | 1 234 | 1 000 000 | 4 s | 3 |" in lines[1]
    )
    # A score from another rule is not comparable.
    made("other", scenario=MADE_UP, scale=Scale(local_rule=1.3, open_cost=20)).write(results)
    with pytest.raises(InputError, match="scale: expected that of"):
        read_groups(results)


def test_a_scenario_states_how_it_is_scored() -> None:
    assert scenarios.get(GATES).has_local_rule("test")
    assert not scenarios.get("toy-4x4-v0").has_local_rule("test")
