"""Run folders: what they hold, and trainings that are killed and go on as if they were not."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from conftest import some_slow
from numpy.typing import NDArray
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from marouting import EnvOptions, InputError, Problem, Solution, evaluate, generate
from marouting.config import MOST, build, plain
from marouting.player import Player
from marouting.source import load_problems
from policies.cli.main import status
from policies.experiment.benchmark import from_text
from policies.generalist import SHIPPED
from policies.learned.algorithms.dqn import DQN, DQNOptions
from policies.learned.algorithms.fused_dqn import FusedDQN
from policies.learned.checkpoint import POLICY_FORMAT, TRAINING_FORMAT
from policies.learned.config import Config, TrainOptions, load_config
from policies.learned.learner import Setup
from policies.learned.logs import Logs
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run, clear
from policies.learned.trainer import Episode, Trainer
from policies.results.rows import COLUMNS
from policies.results.run_folder import GreedyEvaluation
from policies.results.validation import Validation
from policies.routers.astar import AStarRouter

PROBLEMS: dict[str, Any] = {"count": 2, "grid": [4, 4, 2], "nets": 3, "capacity": 2, "seed": 5}
SMALL: dict[str, dict[str, Any]] = {
    "dqn": {
        "burn_in_size": 100,
        "buffer_size": 500,
        "epsilon": 0.2,
        "epsilon_final": None,
        "target_period": 7,
    },
    "ppo": {"num_envs": 2, "rollout": 48, "minibatch": 16},
}
"""Options of learners whose trainings take a moment."""

DRAWN = {**PROBLEMS, "count": 1, "seed": None, "max_pins": 3}
"""A generator of another problem for every episode."""


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)  # more of them cost more than they save on networks this small


def config_in(folder: Path, episodes: int = 20, kind: str = "dqn", **options: Any) -> Config:
    """A small configuration of two problems.

    Args:
        folder: the run folder.
        episodes: see TrainOptions.
        kind: of learner.
        **options: ``seed``, keys of ``env`` and ``train``, and of the learner.
    """
    fields = {
        part: {key: options.pop(key) for key in list(options) if key in schema.__dataclass_fields__}
        for part, schema in (("env", EnvOptions), ("train", TrainOptions))
    }
    train = {"tensorboard": False, "figures": False, "evaluate_every": 3, **fields["train"]}
    small = {**SMALL.get(kind, SMALL["dqn"])}
    if "games" in train:
        small.pop("num_envs", None)
    raw = {
        "seed": options.pop("seed", 0),
        "out": str(folder),
        "env": {"problem": PROBLEMS, "max_steps": 12, **fields["env"]},
        "learner": {
            "kind": kind,
            "network": {"hidden": [8]},
            **small,
            **options,
        },
        "train": {"episodes": episodes, **train},
    }
    return build(Config, raw)


def metrics(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def walks(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]


def results(folder: Path) -> list[dict[str, Any]]:
    """The rows of result.json without the times."""
    rows = json.loads((folder / "result.json").read_text())
    assert all(row.pop("seconds") >= 0 for row in rows)
    return rows


def content(value: Any) -> Any:
    """What a saved file holds, with tensors as their shapes, types and bytes."""
    if isinstance(value, torch.Tensor):
        return tuple(value.shape), value.dtype, value.numpy().tobytes()
    if isinstance(value, dict):
        return {key: content(inner) for key, inner in value.items()}
    return [content(inner) for inner in value] if isinstance(value, list) else value


def outcome(folder: Path) -> dict[str, Any]:
    """Everything of a finished run that has to be the same however often it was stopped."""
    files = [folder / "metrics.jsonl", folder / "evaluations.jsonl"]
    files += sorted((folder / "solutions").iterdir())
    checkpoint = torch.load(folder / "checkpoint.pt", weights_only=True)
    policy = torch.load(folder / "policy.pt", weights_only=True)
    del checkpoint["seconds"]
    for saved in (checkpoint, policy):
        assert saved["figures"].pop("processor_seconds") > 0
    return {
        **{path.name: path.read_bytes() for path in files},
        "result": results(folder),
        "policy": content(policy),
        "checkpoint": content(checkpoint),
    }


# --- across problems ------------------------------------------------------------------------------

TOY = "env.scenario=toy-4x4-v0"


@pytest.mark.parametrize(
    ("learner", "agents", "critic"),
    [
        ("dqn", "single", None),
        ("ppo", "single", "local"),
        ("iql", "multi", None),
        ("ippo", "multi", "local"),
        ("mappo", "multi", "central"),
    ],
)
def test_a_scenario_and_a_learner_are_all_that_has_to_be_said(
    learner: str, agents: str, critic: str | None
) -> None:
    config = load_config(None, [f"learner.kind={learner}", TOY])
    train = config.train
    assert (config.env.problem, config.env.split, config.env.agents) == (None, "train", agents)
    assert (config.learner.name, config.env.observation.name) == (learner, "window")
    assert getattr(config.learner.options, "critic", None) == critic
    assert (train.shared, train.games, train.episodes) == (True, 32, 10_000)
    assert build(Config, plain(config)) == config
    # As in a file that says no more, and with what is told in place of it.
    told = load_config(None, [f"learner.kind={learner}", TOY, "train.games=4", "train.episodes=9"])
    assert (told.train.shared, told.train.games, told.train.episodes) == (True, 4, 9)
    own = load_config(None, [f"learner.kind={learner}", "env.problem={count: 3}"])
    assert (own.train.shared, own.train.games, own.train.episodes) == (None, None, 1000)
    assert own.env.observation.name == "paper"
    if critic is None:
        assert [c.learner.options.steps_per_update for c in (config, told, own)] == [8, 8, 1]


def test_a_change_of_kind_or_source_discards_what_belongs_to_the_one_before(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(
        "learner: {kind: dqn, gamma: 0.5, burn_in_size: 100}\n"
        "env: {problem: {count: 3}, reward: {kind: paper, reached: 1}}\ntrain: {games: null}\n"
    )
    config = load_config(file, ["learner.kind=ppo", TOY, "env.reward.kind=normalised"])
    assert config.learner == load_config(None, ["learner.kind=ppo", TOY]).learner
    assert config.env.scenario == "toy-4x4-v0"
    assert config.train.games == 32
    # In any order, options on the command line belong to the kind there.
    both = ["learner.clip=0.1", "learner.kind=ppo"]
    for given in (both, both[::-1]):
        assert load_config(file, given).learner.options.clip == 0.1
    assert load_config(file, ["learner.gamma=0.6"]).learner.options.burn_in_size == 100
    file.write_text("learner: ppo\nenv: {scenario: toy-4x4-v0, split: validation}\n")
    config = load_config(file, ["learner.clip=0.1", "env.problem={nets: 4}"])
    assert (config.learner.name, config.learner.options.clip) == ("ppo", 0.1)
    assert config.env.scenario is None


def test_a_scenario_suggests_how_a_training_runs() -> None:
    config = load_config(None, ["learner.kind=ppo", "env.scenario=gates-8x7-v0"])
    train, options = config.train, config.learner.options
    assert (train.games, train.steps, train.episodes) == (128, 1_500_000, MOST)
    assert (config.env.agents, config.env.reward.name) == ("multi", "team")
    assert options.final_failures
    assert options.network.options["hidden"] == (128, 128)
    assert build(Config, plain(config)) == config
    told = load_config(
        None, ["learner.kind=ppo", "env.scenario=gates-8x7-v0", "train.games=2", "train.steps=9"]
    )
    assert (told.train.games, told.train.steps) == (2, 9)
    with pytest.raises(InputError, match=r"train.steps: expected null without train.games"):
        load_config(None, ["train.steps=9"])


def gates(folder: Path, *more: str) -> Config:
    """A small training on problems in which agents are done at different times."""
    small = ["learner.rollout=256", "learner.minibatch=128", "learner.network.hidden=[16]"]
    small += ["train.games=4", "train.steps=3000", "train.evaluate_every=20", "train.validation=6"]
    small += ["train.tensorboard=false", "train.figures=false", f"out={folder}"]
    scenario = ["learner.kind=ppo", "env.scenario=gates-8x7-v0"]
    return load_config(None, [*scenario, *small, *more])


def test_a_training_ends_after_so_many_steps(tmp_path: Path) -> None:
    run = Run(gates(tmp_path / "a"))
    done: list[Episode] = []
    assert run.progress == (0, 3000, "steps")
    run.execute(done.extend)
    made = int(run.trainer.steps.sum())
    assert 3000 <= made < 3000 + 256 + 4 * 4  # it ends within a rollout
    player = run.trainer.player  # type: ignore[union-attr]
    playing = player.engine.games["steps"][~player.buffers.over]
    assert sum(episode.steps for episode in done) + playing.sum() == made
    assert run.progress == (3000, 3000, "steps")
    assert run.trainer.learner.progress[0] == 1  # type: ignore[attr-defined]
    assert run.finished is not None
    again = Run(run.config, resume=True)
    assert again.finished == run.finished
    policy = TrainedPolicy.load(tmp_path / "a" / "policy.pt")
    found = policy.evaluate("gates-8x7-v0", "validation")
    assert again.scenario_results()[0] == found
    solved = {row["problem"]: row for row in run.finished if row["router"] == "ppo_policy"}
    for row in found.rows[:6]:  # in a batch of all problems as alone
        assert (row.wirelength, row.joined) == tuple(
            solved[row.problem][name] for name in ("wirelength", "joined")
        )


def test_a_training_may_end_before_its_first_episode(tmp_path: Path) -> None:
    short = ["learner.rollout=4", "learner.minibatch=4", "train.steps=4", "train.figures=true"]
    config = gates(tmp_path / "a", *short)
    rows = Run(config).execute()
    assert (tmp_path / "a" / "metrics.jsonl").read_text() == ""
    assert len(rows) == 12
    again = Run(config, resume=True)
    assert again.episodes[0] == 0
    assert again.finished == rows
    assert again.scenario_results()[0].problems == 50
    assert status(["train", "--resume", str(tmp_path / "a")]) == 0


def test_a_training_with_rules_of_its_own_has_no_score(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["learner.kind=ppo", "env.scenario=gates-8x7-v0", "train.games=2", "train.steps=300"]
    words += ["env.overflow=allowed", "train.figures=false", "train.tensorboard=false"]
    assert status(["train", *words, f"out={tmp_path / 'a'}"]) == 0
    told = capsys.readouterr()
    said = "not scored on gates-8x7-v0: overflow: expected forbidden, as gates-8x7-v0 is played"
    assert said in told.err
    assert told.err.endswith("nothing was learned: the training ended before its first update\n")
    assert "next:" not in told.out  # a benchmark would refuse it
    assert "score" not in told.out


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["learner.kind=ippo", "env.agents=single"], "env.agents: expected multi for ippo, found"),
        (["learner.kind=iql", "env.agents=single"], "env.agents: expected multi for iql, found si"),
        (["learner.kind=ippo", "learner.critic=central"], "learner.critic: expected one of local"),
        (["learner.kind=mappo", "learner.critic=local"], "learner.critic: expected one of central"),
        ([TOY, "env.problem=p.gr"], "env.problem: expected none beside a scenario"),
        ([TOY, "train.shared=false"], "train.shared: expected true: games draw problems for one"),
        (["learner.kind=ppo", "learner.burn_in=astar"], "learner.burn_in: unknown key"),
    ],
)
def test_what_contradicts_a_scenario_or_a_name(given: list[str], said: str) -> None:
    with pytest.raises(InputError, match=f"^{said}"):
        load_config(None, given)


def test_independent_q_learning_is_the_dqn_with_every_net_an_agent(tmp_path: Path) -> None:
    ends = []
    for kind in ("dqn", "iql"):
        trainer = Trainer(load_problems(PROBLEMS), config_in(tmp_path, 4, kind, agents="multi"))
        list(trainer.run())
        ends.append(trainer.learner.networks.flat.numpy().tobytes())
    assert ends[0] == ends[1]


def test_a_training_across_problems_ends_with_means(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As do those of many problems; the folder is an entry of a benchmark."""
    monkeypatch.chdir(tmp_path)
    few = ["train.episodes=40", "train.evaluate_every=20", "train.tensorboard=false"]
    small = ["learner.rollout=128", "learner.minibatch=64", "learner.network.hidden=[8]"]
    given = ["learner.kind=mappo", TOY, "out=run", *few, *small]
    assert status(["train", *given]) == 0
    shown = capsys.readouterr().out
    assert "run: means over 20 validation problems" in shown
    assert "validation_000" not in shown
    validation, test, following = shown.splitlines()[-3:]
    assert following == "next: marouting benchmark --scenario toy-4x4-v0 --router run"
    assert validation.startswith("toy-4x4-v0 validation: cost ")
    assert test.startswith("toy-4x4-v0 test: cost ")
    rows = [row for row in results(tmp_path / "run") if row["router"] == "mappo_policy"]
    assert len(rows) == 20
    connected = sum(row["joined"] == row["tasks"] for row in rows)
    (line,) = [line.split() for line in shown.splitlines() if line.split()[:1] == ["mappo_policy"]]
    wirelength = sum(row["wirelength"] for row in rows) / 20
    assert line[1:4] == [f"{connected}/20", "0.00", f"{wirelength:.1f}"]
    assert status(["train", "--resume", "run"]) == 0
    assert capsys.readouterr().out == shown
    assert status(["config", "--schema", "train"]) == 0
    schema = json.loads(capsys.readouterr().out)["properties"]["learner"]
    assert {"dqn", "ppo", "iql", "ippo", "mappo"} <= set(schema["examples"])
    entry = from_text("run", None, None)
    assert (entry.name, entry.router, entry.trains) == ("run", "mappo", False)
    assert TrainedPolicy.load(entry.options["checkpoint"]).env.agents == "multi"


def test_means_over_problems() -> None:
    rows = [
        {"problem": "a", "joined": 3, "tasks": 3, "overflow": 0, "wirelength": 22},
        {"problem": "b", "joined": 3, "tasks": 3, "overflow": 2, "wirelength": 20},
        {"problem": "c", "joined": 2, "tasks": 3, "overflow": 0, "wirelength": 12},
    ]
    reference = dict.fromkeys("abc", (0, 20))
    found = Validation.of(rows, reference)
    assert found == Validation(3, 2, 2 / 3, 18.0, pytest.approx(10.0), 1)
    means = "2 of 3 problems connected, overflow 0.67, wirelength 18.0"
    assert str(found) == f"{means}, 10.00 % above the reference on 1"
    assert Validation.of(rows, {}).gap is None


# --- what a folder holds --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run, without the figures."""
    folder = tmp_path_factory.mktemp("runs") / "deep" / "run"
    Run(config_in(folder, tensorboard=True)).execute()
    return folder


def test_folder_holds_what_it_should(finished: Path) -> None:
    assert sorted(path.name for path in finished.iterdir()) == [
        "checkpoint.pt",
        "config.yaml",
        "evaluations.jsonl",
        "metrics.jsonl",
        "policy.pt",
        "problems",
        "result.json",
        "solutions",
        "tensorboard",
    ]


def test_config_reloads(finished: Path) -> None:
    config = config_in(finished, tensorboard=True)
    assert load_config(finished / "config.yaml") == config
    # The whole of it, defaults included.
    assert yaml.safe_load((finished / "config.yaml").read_text()) == plain(config)


def test_problems_are_those_routed(finished: Path) -> None:
    written = {path.stem: Problem.read(path) for path in (finished / "problems").glob("*.gr")}
    generated = generate(2, grid=(4, 4, 2), nets=3, capacity=2, seed=5)
    assert written == {"problem_000": generated[0], "problem_001": generated[1]}


def test_metrics_are_complete(finished: Path) -> None:
    lines = metrics(finished)
    names = list(Episode.__dataclass_fields__)
    assert all(list(line) == names for line in lines)
    for name in ("problem_000", "problem_001"):
        own = [line for line in lines if line["problem"] == name]
        assert [line["episode"] for line in own] == list(range(20))
        assert all(0 <= line["joined"] <= line["tasks"] == 3 for line in own)
        assert own[-1]["updates"] == sum(line["steps"] for line in own)
    assert len(lines) == 40


def test_results_are_those_of_the_solutions(finished: Path) -> None:
    rows = results(finished)
    assert [(row["problem"], row["router"]) for row in rows] == [
        (problem, router)
        for problem in ("problem_000", "problem_001")
        for router in ("astar", "dqn", "dqn_policy")
    ]
    lines = metrics(finished)
    for row in rows:
        problem = Problem.read(finished / "problems" / f"{row['problem']}.gr")
        path = finished / "solutions" / f"{row['problem']}.{row['router']}.solution"
        solution = Solution.read(path, problem)
        expected = asdict(evaluate(problem, solution))
        expected["open_nets"] = len(expected.pop("disconnected"))
        pruned = evaluate(problem, solution.pruned())
        expected["pruned_overflow"] = pruned.overflow
        expected["pruned_wirelength"] = pruned.wirelength
        assert expected == {name: row[name] for name in expected}
        origin = {"from"} if row["router"] != "astar" else set()
        assert set(row) == {"problem", "router", *expected, *origin}
        if row["router"] == "dqn":
            # Of the best episode: most joined, then overflow, wirelength.
            own = [line for line in lines if line["problem"] == row["problem"]]
            best = min((-line["joined"], line["overflow"], line["wirelength"]) for line in own)
            assert (row["overflow"], row["wirelength"]) == best[1:]
            assert row["joined"] >= -best[0]
            marked = [line for line in own if line["best"]][-1]
            assert (-marked["joined"], marked["overflow"], marked["wirelength"]) == best
            assert row["from"] == f"episode {marked['episode'] + 1} of 20"
        if row["router"] == "dqn_policy":
            policy = TrainedPolicy.load(finished / "policy.pt", row["problem"])
            routed = policy.solve(problem)
            assert (routed.solution, routed.report) == (solution, {"from": row["from"]})


def test_figures_of_every_router_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their content, and that they are pictures, is for others to test."""
    drawn: list[Path] = []
    monkeypatch.setattr("policies.figures.save", lambda _, path: drawn.append(path))
    config = config_in(tmp_path / "run", 2, problem={**PROBLEMS, "count": 1}, figures=True)
    Run(config).execute()
    figures = tmp_path / "run" / "figures"
    kinds = ("heat_maps", "histogram", "edges", "solution_2d", "solution_3d")
    routers = ("astar", "dqn", "dqn_policy")
    expected = {"reward.png", "reward_log.png"} | {
        f"problem_000/{stem}.png"
        for stem in ("comparison", *(f"{r}_{kind}" for r in routers for kind in kinds))
    }
    assert {str(path.relative_to(figures)) for path in drawn} == expected


def test_tensorboard_shows_the_metrics(finished: Path) -> None:
    events = EventAccumulator(str(finished / "tensorboard"))
    events.Reload()
    curves = ("reward", "joined", "overflow", "wirelength", "steps", "epsilon", "loss")
    figures = ("open", "overflow", "wirelength")
    more = [f"{prefix}_{figure}" for prefix in ("best", "greedy") for figure in figures]
    names = ("problem_000", "problem_001", "mean")
    expected = {f"{curve}/{name}" for curve in (*curves, *more) for name in names}
    expected = {"/".join(t.split("/")[::-1]) if t.endswith("/mean") else t for t in expected}
    assert set(events.Tags()["scalars"]) == expected | {"speed/steps_per_second"}
    lines = [line for line in metrics(finished) if line["problem"] == "problem_001"]
    for curve in curves:
        shown = events.Scalars(f"{curve}/problem_001")
        assert [event.step for event in shown] == list(range(20))
        assert [event.value for event in shown] == pytest.approx([line[curve] for line in lines])


def shown(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """The curves in TensorBoard's files."""
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def test_tensorboard_shows_means_the_best_and_what_is_greedy(finished: Path) -> None:
    curves = shown(finished)
    names = ("problem_000", "problem_001")
    lines = {
        name: [line for line in metrics(finished) if line["problem"] == name] for name in names
    }
    both = [[line["reward"] for line in pair] for pair in zip(*lines.values(), strict=True)]
    assert [step for step, _ in curves["mean/reward"]] == list(range(20))
    assert [value for _, value in curves["mean/reward"]] == pytest.approx(
        [sum(x) / 2 for x in both]
    )
    for name, own in lines.items():
        ranks = [(x["tasks"] - x["joined"], x["overflow"], x["wirelength"]) for x in own]
        best = [min(ranks[: n + 1]) for n in range(len(ranks))]
        for i, figure in enumerate(("open", "overflow", "wirelength")):
            assert curves[f"best_{figure}/{name}"] == list(enumerate(b[i] for b in best))
    of = [walk for walk in walks(finished) if walk["problem"] == names[0]]
    assert [walk["episodes"] for walk in of] == [3, 6, 9, 12, 15, 18, 20]
    greedy = [(walk["episodes"], walk["wirelength"]) for walk in of]
    assert curves[f"greedy_wirelength/{names[0]}"] == greedy
    assert [step for step, _ in curves["mean/greedy_open"]] == [3, 6, 9, 12, 15, 18, 20]
    # The saved policy is the last that was the best, and walks as it did then.
    kept = [walk for walk in of if walk["best"]][-1]
    rows = json.loads((finished / "result.json").read_text())
    (row,) = [r for r in rows if (r["router"], r["problem"]) == ("dqn_policy", names[0])]
    assert row["from"] == f"policy after {kept['episodes']} episodes, greedy"
    for key in ("joined", "overflow", "wirelength"):
        assert row[key] == kept[key]
    assert all(value > 0 for _, value in curves["speed/steps_per_second"])
    moves = sum(line["steps"] for line in metrics(finished))
    assert curves["speed/steps_per_second"][-1][0] <= moves


def test_tensorboard_shows_gaps_to_a_reference(tmp_path: Path) -> None:
    """Of what has the reference's overflow and no open task; the best of two episodes stays."""
    first = Episode("p", 0, 1.0, 3, 3, 0, 25, 30, 0.0, None, 0, True)
    episodes = [
        first,
        replace(first, problem="q", overflow=1),
        replace(first, episode=1, wirelength=40, best=False),
        replace(first, problem="q", episode=1, wirelength=22),
        replace(first, problem="r", wirelength=20),
        replace(first, problem="r", episode=1, wirelength=20, best=False),
    ]
    walked = [
        GreedyEvaluation("p", 2, 50, 3, 3, 0, 20, 9, True),
        GreedyEvaluation("q", 2, 50, 2, 3, 0, 9, 9, True),
    ]
    reference = {"p": (0, 20), "q": (0, 20)}  # of r nothing is known
    with Logs(tmp_path, (0, 0), True, ("p", "q", "r"), reference) as logs:
        logs.write(episodes, walked)
        logs.flush()
    curves = shown(tmp_path)
    assert {tag: curves[tag] for tag in curves if "gap" in tag} == {
        "best_gap/p": [(0, pytest.approx(25)), (1, pytest.approx(25))],
        "best_gap/q": [(1, pytest.approx(10))],
        "mean/best_gap": [(0, pytest.approx(25)), (1, pytest.approx(17.5))],
        "greedy_gap/p": [(2, 0)],
    }
    assert curves["mean/best_wirelength"] == [
        (0, pytest.approx(70 / 3)),
        (1, pytest.approx(67 / 3)),
    ]
    assert "mean/greedy_open" not in curves  # r has not been evaluated
    ((moves, speed),) = curves["speed/steps_per_second"]
    assert moves == 6 * 30
    assert speed > 0


def test_a_reference_is_read_from_proven_rows(tmp_path: Path) -> None:
    rows = [
        {
            **dict.fromkeys(COLUMNS), "set": "s", "problem": "problem_000", "router": router,
            "kind": router, "overflow": 0, "wirelength": length, "joined": 3, "tasks": 3,
            "proven": router == "optimal",
        }
        for router, length in (("astar", 30), ("optimal", 20))
    ]  # fmt: skip
    (tmp_path / "r.json").write_text(json.dumps(rows))
    told = config_in(tmp_path / "run", reference=str(tmp_path / "r.json"))
    assert Run(told).reference == {"problem_000": (0, 20)}
    (tmp_path / "r.json").write_text(json.dumps(rows[:1]))
    with pytest.raises(InputError, match=r"r\.json: expected rows that are proven"):
        Run(replace(told, out=str(tmp_path / "other")))
    assert not (tmp_path / "other").exists()


def test_policy_file_plays(finished: Path) -> None:
    """Alone and in a checkpoint, which can be given in its place."""
    saved = torch.load(finished / "policy.pt", weights_only=True)
    assert saved["format"] == POLICY_FORMAT
    whole = torch.load(finished / "checkpoint.pt", weights_only=True)
    assert whole["format"] == TRAINING_FORMAT
    assert content(whole["weights"]) == content(saved["weights"])
    for row, name in enumerate(("problem_000", "problem_001")):
        policy = TrainedPolicy.load(finished / "policy.pt", name)
        assert policy.obs_shape == (12,)
        assert policy.env.max_steps == 12
        problem = Problem.read(finished / "problems" / f"{name}.gr")
        routed = policy.solve(problem)
        assert evaluate(problem, routed.solution).tasks == 3
        *_, engine = policy.play(problem)  # move by move, by the module
        assert engine.solution() == routed.solution
        same = TrainedPolicy.load(finished / "checkpoint.pt", name).solve(problem)
        assert (same.solution, same.report) == (routed.solution, routed.report)
        seen = np.arange(12, dtype=np.float32)
        one = saved["weights"][row]
        hidden = torch.relu(torch.from_numpy(seen) @ one["layers.0.weight"] + one["layers.0.bias"])
        values = hidden @ one["layers.1.weight"] + one["layers.1.bias"]
        assert policy.act(seen, np.ones(6, np.int8)) == int(values.argmax())
    with pytest.raises(InputError, match="problem_000"):
        TrainedPolicy.load(finished / "policy.pt", "another")


def test_the_network_that_is_saved_is_the_best_or_the_last(tmp_path: Path) -> None:
    """The training is the same, whichever is saved."""
    saved, best = {}, {}
    for which in ("best", "last"):
        Run(config_in(tmp_path / which, 13, policy=which, learning_rate=0.3)).execute()
        saved[which] = torch.load(tmp_path / which / "policy.pt", weights_only=True)
        final = torch.load(tmp_path / which / "checkpoint.pt", weights_only=True)
        best[which] = {
            walk["problem"]: walk["episodes"] for walk in walks(tmp_path / which) if walk["best"]
        }
        flat = [np.concatenate([np.ravel(w) for w in one.values()]) for one in final["weights"]]
        same = [
            np.array_equal(kept, row)
            for kept, row in zip(flat, final["training"]["networks.flat"].numpy(), strict=True)
        ]
        assert all(same) == (which == "last")
    assert best["best"] == best["last"]
    assert saved["best"]["episodes"] == list(best["best"].values()) != [13, 13]
    assert saved["last"]["episodes"] == [13, 13]


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("kind", ["dqn", "ppo"])
def test_a_training_begins_with_networks_of_another(
    kind: str, fused: bool, finished: Path, tmp_path: Path
) -> None:
    """Without a gradient step the networks stay those of the file, by the problems' names."""
    never: dict[str, Any] = {"steps_per_update": 10**6, "fused": fused}
    never = never if kind == "dqn" else {"rollout": 16_000}
    file = tmp_path / "begin.pt"
    shutil.copy(finished / "policy.pt", file)
    config = config_in(tmp_path / "run", 2, kind, seed=7, start=str(file), **never)
    run = Run(config)
    run.execute()
    assert {row["updates"] for row in metrics(tmp_path / "run")} == {0}
    begun, kept = (
        torch.load(path, weights_only=True)["weights"] for path in (file, run.folder / "policy.pt")
    )
    assert content(kept) == content(begun)
    learner = run.trainer.learner
    if isinstance(learner, DQN):
        assert torch.equal(learner.target, learner.networks.flat)
    file.unlink()
    Run(config, resume=True).execute()  # the checkpoint has all


@pytest.mark.slow  # compiles what the generalist sees
def test_a_training_begins_with_the_weights_that_are_shipped(tmp_path: Path) -> None:
    network = {"kind": "mlp", "hidden": [160, 128]}
    options: dict[str, Any] = {"observation": "outlook", "network": network, "burn_in_size": 10}
    run = Run(config_in(tmp_path / "run", 1, start="generalist", steps_per_update=10**6, **options))
    run.execute()
    weights = dict(TrainedPolicy.load(SHIPPED).module.state_dict())
    kept = torch.load(run.folder / "policy.pt", weights_only=True)["weights"]
    assert content(kept) == content([weights, weights])


def test_the_same_configuration_gives_the_same_run(finished: Path, tmp_path: Path) -> None:
    Run(config_in(tmp_path / "run")).execute()
    assert outcome(tmp_path / "run") == outcome(finished)


# --- stopped and resumed --------------------------------------------------------------------------


class Untaught(DQN):
    """A learner that has learned and stored nothing when it is saved, in the middle of episodes."""

    def __init__(self, setup: Setup, options: DQNOptions) -> None:
        super().__init__(setup, options)
        self.learning_starts = 0

    @property
    def stored(self) -> NDArray[np.int64]:
        return np.zeros(len(self.updates), np.int64)

    def play(self, player: Player, steps: int) -> None:
        super().play(player, min(steps, 5))

    def learn(self, due: NDArray[np.int64]) -> None:
        """Learns nothing."""


class Killed(Exception):
    """Stands for a kill: nothing of the run catches it."""


KINDS: dict[str, dict[str, Any]] = {
    "single": {"tensorboard": True},
    "multi, masked": {"agents": "multi", "masking": True},
    "shared": {"shared": True},
    "torch": {"fused": False, "target_period": 0, "steps_per_update": 2},
    "torch, all switches": {
        "agents": "multi",
        "double": True,
        "network": {"hidden": [8], "dueling": True},
    },
    "ppo": {"kind": "ppo"},
    "ppo, central": {"kind": "ppo", "agents": "multi", "critic": "central", "episodes": 20},
    "a user's": {"kind": f"{__name__}:Untaught"},
    "drawn": {"shared": True, "games": 3, "problem": DRAWN, "tensorboard": True, "episodes": 24},
    "drawn from a set": {
        "shared": True,
        "games": 2,
        "agents": "multi",
        "masking": True,
        "episodes": 24,
    },
    "drawn, torch": {
        "shared": True,
        "episodes": 18,
        "games": 2,
        "agents": "multi",
        "scenario": "toy-4x4-v0",
        "validation": 2,
        "problem": None,
        "observation": {"kind": "window", "radius": 1},
        "reward": "team",
        "burn_in": "random",
    },
    "drawn, ppo": {
        "kind": "ppo",
        "episodes": 40,
        "shared": True,
        "games": 3,
        "agents": "multi",
        "problem": DRAWN,
        "critic": "central",
    },
    "drawn, paid when done": {
        "kind": "ppo",
        "episodes": 40,
        "steps": 900,
        "shared": True,
        "games": 3,
        "agents": "multi",
        "problem": DRAWN,
        "reward": "team",
        "final_failures": True,
    },
}


LONG_KINDS = ("torch, all switches", "ppo, central", "drawn, torch")


@pytest.mark.parametrize("kind", some_slow(KINDS, LONG_KINDS))
def test_a_run_killed_anywhere_goes_on_as_if_not(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, folder = tmp_path / "whole", tmp_path / "killed"
    options = {"episodes": 8, **KINDS[kind]}
    Run(config_in(whole, **options)).execute()
    write = Logs.write
    left = 0

    def count_down(self: Logs, *lines: Any) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            for name in ("metrics.jsonl", "evaluations.jsonl"):
                with (folder / name).open("a") as file:
                    file.write('{"problem": "prob')  # killed in the middle of a line
            raise Killed
        write(self, *lines)

    monkeypatch.setattr(Logs, "write", count_down)
    # Before the first checkpoint; with a checkpoint after every step; long after the last one.
    for resume, (seconds, writes) in enumerate([(3600.0, 3), (0.0, 3), (3600.0, 5), (0.0, 2)]):
        left = writes
        config = config_in(folder, **options)
        run = Run(config, resume=resume > 0)
        run.config = replace(config, train=replace(config.train, checkpoint_seconds=seconds))
        with pytest.raises(Killed):
            run.execute()
        assert (folder / "checkpoint.pt").exists() == (resume > 0)
        assert not (folder / "result.json").exists()
    monkeypatch.undo()
    Run(config_in(folder, **options), resume=True).execute()
    assert outcome(folder) == outcome(whole)
    if options.get("tensorboard"):  # every episode once, those before the kills as well
        events = EventAccumulator(str(folder / "tensorboard"))
        events.Reload()
        name = "train" if "games" in options else "problem_000"
        assert [event.step for event in events.Scalars(f"reward/{name}")] == list(
            range(options["episodes"])
        )
    # Once more: there is nothing left to do, and nothing changes.
    Run(config_in(folder, **options), resume=True).execute()
    assert outcome(folder) == outcome(whole)


@pytest.mark.parametrize("file", ["checkpoint.pt", "policy.pt", "result.json"])
def test_a_run_killed_while_it_writes_goes_on_as_if_not(
    file: str, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a file is never taken for a whole one; with a checkpoint after every step."""
    folder, replaced, left = tmp_path / "run", os.replace, 3 if file == "checkpoint.pt" else 1

    def killed(source: Any, target: Any) -> None:
        nonlocal left
        if Path(target).name == file:
            left -= 1
            if left == 0:
                Path(source).write_bytes(b"half a file")
                raise Killed
        replaced(source, target)

    config = config_in(folder)
    run = Run(config)
    run.config = replace(config, train=replace(config.train, checkpoint_seconds=0))
    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(Killed):
        run.execute()
    monkeypatch.undo()
    assert left == 0
    assert (folder / "policy.pt").exists() == (file == "result.json")
    assert not (folder / "result.json").exists()
    Run(config, resume=True).execute()
    assert outcome(folder) == outcome(finished)


@pytest.fixture
def _answering() -> Iterator[None]:
    """Ctrl-C answered as in a terminal: a test run in the background inherits that it is not."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_answering")
def test_an_interrupt_waits_for_the_end_of_a_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C in the middle of steps, where moves are made and learned from; not in burn-in."""
    whole, folder = tmp_path / "whole", tmp_path / "stopped"
    Run(config_in(whole)).execute()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    for owner, method, calls in (
        (Trainer, "burn_in", 1),
        (FusedDQN, "play", 2),
        (Trainer, "_finish", 3),
    ):
        original: Callable[..., Any] = getattr(owner, method)
        countdown = calls

        def interrupted(self: Any, *arguments: Any, original: Any = original) -> Any:
            nonlocal countdown
            countdown -= 1
            if countdown == 0:
                signal.raise_signal(signal.SIGINT)
            return original(self, *arguments)

        monkeypatch.setattr(owner, method, interrupted)
        run = Run(config_in(folder), resume=method != "burn_in")
        with pytest.raises(KeyboardInterrupt):
            run.execute()
        monkeypatch.undo()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert (folder / "checkpoint.pt").exists() == (method != "burn_in")
        assert not (folder / "result.json").exists()
    Run(config_in(folder), resume=True).execute()
    assert outcome(folder) == outcome(whole)


@pytest.mark.usefixtures("_answering")
def test_an_interrupt_after_the_last_step_loses_no_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, folder = tmp_path / "whole", tmp_path / "stopped"
    Run(config_in(whole)).execute()

    def interrupted(_self: Run) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Run, "_results", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Run(config_in(folder)).execute()
    monkeypatch.undo()
    assert not (folder / "result.json").exists()
    monkeypatch.setattr(Logs, "write", killed)  # as the first episode trained again would be
    Run(config_in(folder), resume=True).execute()
    assert outcome(folder) == outcome(whole)


@pytest.mark.parametrize("answering", [signal.default_int_handler, signal.SIG_IGN])
def test_sigterm_leaves_a_checkpoint(
    answering: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also in a process that ignores Ctrl-C, as those in the background do."""
    burn_in, whole, folder = Trainer.burn_in, tmp_path / "whole", tmp_path / "stopped"
    Run(config_in(whole)).execute()

    def terminated(self: Trainer) -> None:
        signal.raise_signal(signal.SIGTERM)
        burn_in(self)

    before = signal.signal(signal.SIGINT, answering)
    try:
        monkeypatch.setattr(Trainer, "burn_in", terminated)
        with pytest.raises(SystemExit) as caught:
            Run(config_in(folder)).execute()
        assert caught.value.code == 128 + signal.SIGTERM
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        assert signal.getsignal(signal.SIGINT) is answering
    finally:
        signal.signal(signal.SIGINT, before)
    monkeypatch.undo()
    assert (folder / "checkpoint.pt").exists()
    Run(config_in(folder), resume=True).execute()
    assert outcome(folder) == outcome(whole)


@pytest.mark.usefixtures("_answering")
def test_a_second_interrupt_does_not_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play, calls = FusedDQN.play, 0

    def twice(self: FusedDQN, *arguments: Any) -> None:
        nonlocal calls
        calls += 1
        if calls == 1:
            play(self, *arguments)
            return
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        pytest.fail("expected the second interrupt at once")

    monkeypatch.setattr(FusedDQN, "play", twice)
    with pytest.raises(KeyboardInterrupt):
        Run(config_in(tmp_path / "run")).execute()
    assert not (tmp_path / "run" / "checkpoint.pt").exists()


def test_a_run_in_another_thread(tmp_path: Path) -> None:
    """Where no signal handler can be set."""
    run = Run(config_in(tmp_path / "run", 2))
    thread = threading.Thread(target=run.execute)
    thread.start()
    thread.join()
    assert len(results(tmp_path / "run")) == 6


def command(*arguments: str) -> subprocess.Popen[str]:
    """The command line in a process of its own, whatever the test's own process ignores."""
    return subprocess.Popen(
        [sys.executable, "-m", "policies.cli.main", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def stopped(process: subprocess.Popen[str], ready: Callable[[], bool], number: int) -> int:
    """Sends a signal once something is so; returns the exit status."""
    with process:
        try:
            until = time.monotonic() + 120
            while not ready():
                assert process.poll() is None, process.communicate()[1]
                assert time.monotonic() < until
                time.sleep(0.005)
            process.send_signal(number)
            _, process.errors = process.communicate(timeout=60)  # type: ignore[attr-defined]
        finally:
            process.kill()
    return process.returncode


LONG = 800  # episodes: some seconds after the first is logged


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A longer run, and beside it the configuration file that it came from."""
    folder = tmp_path_factory.mktemp("long")
    config = config_in(folder / "run", LONG, checkpoint_seconds=0.1)
    (folder / "config.yaml").write_text(yaml.safe_dump(plain(config)))
    Run(config).execute()
    return folder


def lines_in(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_an_interrupted_process_is_resumed(uninterrupted: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    arguments = ["train", str(uninterrupted / "config.yaml"), "train.checkpoint_seconds=3600"]
    process = command(*arguments, f"out={folder}")
    code = stopped(process, lambda: lines_in(folder / "metrics.jsonl") > 0, signal.SIGINT)
    assert code == 130
    errors: str = process.errors  # type: ignore[attr-defined]
    assert "Traceback" not in errors
    assert errors.splitlines()[-1] == "marouting: interrupted"
    assert (folder / "checkpoint.pt").exists()
    assert not (folder / "result.json").exists()
    logged = lines_in(folder / "metrics.jsonl")
    assert (
        torch.load(folder / "checkpoint.pt", weights_only=True)["trainer"]["episodes"].sum()
        == logged
    )
    assert 0 < logged < 2 * LONG
    assert status([*arguments, "--resume", str(folder)]) == 0
    assert outcome(folder) == outcome(uninterrupted / "run")


@pytest.mark.parametrize(
    ("part", "key", "value"),
    [("learner", "learning_rate", 0.5), ("env", "overflow", "allowed"), (None, "seed", 5)],
)
def test_a_configuration_that_was_edited_is_refused(
    part: str | None, key: str, value: Any, tmp_path: Path
) -> None:
    Run(config_in(tmp_path / "run", 4)).execute()
    file = tmp_path / "run" / "config.yaml"
    raw = yaml.safe_load(file.read_text())
    raw["train"]["threads"] = 2  # has no effect on what is learned
    file.write_text(yaml.safe_dump(raw))
    assert Run(load_config(file), resume=True).finished is not None
    (raw[part] if part else raw)[key] = value
    file.write_text(yaml.safe_dump(raw))
    with pytest.raises(InputError, match=rf"{key}: expected .*, as in .*checkpoint\.pt, found"):
        Run(load_config(file), resume=True)


def test_a_run_whose_folder_is_moved_ends(tmp_path: Path) -> None:
    folder = tmp_path / "run"

    def move(_: Any) -> None:
        if (folder / "checkpoint.pt").exists():
            folder.rename(tmp_path / "moved")

    with pytest.raises(InputError, match="run: expected this run's folder, which is gone"):
        Run(config_in(folder, 200, checkpoint_seconds=0)).execute(move)
    assert not (folder / "checkpoint.pt").exists()
    moved = load_config(tmp_path / "moved" / "config.yaml", [f"out={tmp_path / 'moved'}"])
    assert Run(moved, resume=True).execute()


def test_a_resumed_run_stays_in_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Run(config_in(tmp_path / "run", 2)).execute()
    assert status(["train", "--resume", str(tmp_path / "run"), "out=other"]) == 2
    assert f"out: expected {tmp_path / 'run'}, where --resume goes on" in capsys.readouterr().err


def test_a_training_starts_with_networks_of_its_own_kind(tmp_path: Path) -> None:
    shared = {"shared": True, "figures": False}
    Run(config_in(tmp_path / "run", 2, **shared)).execute()
    again = config_in(tmp_path / "more", 2, start=str(tmp_path / "run"), **shared)
    assert Run(again).execute()
    network = {"hidden": [8], "activation": "tanh"}
    other = config_in(tmp_path / "other", 2, start=str(tmp_path / "run"), network=network, **shared)
    with pytest.raises(InputError, match=r"train.start: expected networks .*tanh.*, found .*relu"):
        Run(other).execute()


def test_problems_of_an_aborted_start_are_not_taken_for_the_runs(tmp_path: Path) -> None:
    config = config_in(tmp_path / "run", 1)
    other = tmp_path / "run" / "problems" / "other.gr"
    generate(1, grid=(4, 4, 2), nets=2)[0].write(other)
    with pytest.raises(InputError, match=r"problems: expected only problems of this run, .*other"):
        Run(config)
    assert not (tmp_path / "run" / "config.yaml").exists()
    other.rename(other.with_name("problem_000.gr"))  # of the run's own name: written over
    Run(config).execute()


def test_the_order_of_files_does_not_matter_to_a_resumed_run(tmp_path: Path) -> None:
    files = []
    for seed, name in enumerate(("b", "a-b", "a")):
        files.append(tmp_path / f"{name}.gr")
        generate(1, grid=(4, 4, 2), nets=2, seed=seed)[0].write(files[-1])
    config = config_in(tmp_path / "run", 2, problem=[str(file) for file in files])
    first = Run(config).execute()
    again = Run(config, resume=True).execute()
    assert [row["problem"] for row in first] == [*["a"] * 3, *["a-b"] * 3, *["b"] * 3]
    assert [row["wirelength"] for row in again] == [row["wirelength"] for row in first]


def test_resume_takes_another_place_of_the_folder(tmp_path: Path) -> None:
    config = config_in(tmp_path / "run", 3)
    Run(config).execute()
    before = outcome(tmp_path / "run")
    (tmp_path / "run").rename(tmp_path / "moved")
    Run(replace(config, out=str(tmp_path / "moved")), resume=True).execute()
    assert outcome(tmp_path / "moved") == before
    assert not (tmp_path / "run").exists()


# --- more episodes --------------------------------------------------------------------------------

STEADY = {"epsilon_final": None}
"""A DQN none of whose options goes by the share of all episodes."""

LONGER: dict[str, dict[str, Any]] = {
    "single": STEADY,
    "multi, masked": {**STEADY, "agents": "multi", "masking": True},
    "shared": {**STEADY, "shared": True, "problem": {**PROBLEMS, "count": 1}},
    "torch": {**STEADY, "fused": False},
    "ppo": {"kind": "ppo", "anneal": False, "num_envs": 1, "problem": {**PROBLEMS, "count": 1}},
    "drawn": {**STEADY, "shared": True, "games": 1, "problem": DRAWN},
}


def test_games_side_by_side_are_given_once(tmp_path: Path) -> None:
    drawn = {"kind": "ppo", "shared": True, "problem": DRAWN, "games": 2}
    with pytest.raises(InputError, match=r"learner\.num_envs: expected no number"):
        Run(config_in(tmp_path, **drawn, num_envs=3))


def test_evaluations_tell_for_how_many_moves_the_network_was_trained(tmp_path: Path) -> None:
    config = config_in(tmp_path, 9, kind="ppo", shared=True, problem=DRAWN, games=2)
    run = Run(config)
    run.execute()
    steps = list(dict.fromkeys(walk["agent_steps"] for walk in walks(tmp_path)))
    assert 0 < steps[0] < steps[-1] == run.trainer.steps.sum()
    assert steps == sorted(steps)


@pytest.mark.parametrize("name", ["steps", "seconds"])
def test_runs_that_steps_or_seconds_end_can_be_longer(name: str, tmp_path: Path) -> None:
    drawn = {"kind": "ppo", "shared": True, "problem": DRAWN, "games": 2}
    first = Run(config_in(tmp_path, 10**6, **drawn, **{name: 1}))
    first.execute()
    again = Run(config_in(tmp_path, 10**6, **drawn, **{name: 1}), resume=True)
    assert again.finished is not None
    assert again.length == name
    for other in (None, 0.5 if name == "seconds" else None):
        with pytest.raises(InputError, match=rf"train\.{name}: expected 1(\.0)?, as in "):
            Run(config_in(tmp_path, 10**6, **drawn, **{name: other}), resume=True)
    longer = {"steps": 999, "seconds": first.figures.processor_seconds + 1}[name]
    more = Run(config_in(tmp_path, 10**6, **drawn, **{name: longer}), resume=True)
    assert more.had == {name: 1}
    assert more.finished is None
    more.execute()
    assert more.trainer.steps.sum() > first.trainer.steps.sum()
    assert getattr(load_config(tmp_path / "config.yaml").train, name) > 1


def test_schedules_go_on_from_the_time_that_was_spent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three quarters of the seconds are gone, but only half of the episodes."""
    monkeypatch.setattr(Run, "_share_of_time", lambda _: 0.75)
    drawn = {"kind": "ppo", "shared": True, "problem": DRAWN, "games": 2, "seconds": 1000.0}
    Run(config_in(tmp_path, 6, **drawn)).execute()
    run = Run(config_in(tmp_path, 12, **drawn), resume=True)
    assert run.trainer.learner.progress.tolist() == [0.75]


@pytest.mark.parametrize("options", LONGER.values(), ids=LONGER)
def test_more_episodes_are_those_of_a_longer_run(options: dict[str, Any], tmp_path: Path) -> None:
    # Evaluations fall on the last episode of a part, and no option goes by the share of all.
    whole, folder = tmp_path / "whole", tmp_path / "parts"
    config = config_in(whole, 9, **options)
    Run(config).execute()
    Run(config_in(folder, 3, **options)).execute()
    first = metrics(folder)
    run = Run(config_in(folder, 6, **options), resume=True)
    assert run.had == {"episodes": 3}
    assert run.finished is None
    run.execute()
    assert metrics(folder)[: len(first)] == first
    Run(config_in(folder, 9, **options), resume=True).execute()
    assert load_config(folder / "config.yaml").train.episodes == 9
    again, expected = outcome(folder), outcome(whole)
    if len(run.problems) == 2 and run.trainer.config.train.games is None:
        # The two problems' episodes are logged in another order: the first part ends in between.
        for name in ("metrics.jsonl", "evaluations.jsonl"):
            by_problem = [sorted(of[name].splitlines()) for of in (again, expected)]
            assert by_problem[0] == by_problem[1]
            del again[name], expected[name]
    assert again == expected


def test_a_longer_run_is_no_finished_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run"
    Run(config_in(folder, 3)).execute()
    before = snapshot(folder)
    run = Run(config_in(folder, 6), resume=True)
    assert snapshot(folder) == before  # until it trains
    monkeypatch.setattr(Logs, "write", killed)
    with pytest.raises(Killed):
        run.execute()
    monkeypatch.undo()
    assert not (folder / "result.json").exists()
    assert load_config(folder / "config.yaml").train.episodes == 6
    with pytest.raises(InputError, match=r"train\.episodes: expected 6, as in .* or more, found 3"):
        Run(config_in(folder, 3), resume=True)
    assert {row["episode"] for row in metrics(folder)} == {0, 1, 2}
    Run(config_in(folder, 6), resume=True).execute()
    assert len(metrics(folder)) == 12


def killed(*_: Any) -> None:
    raise Killed


# --- refused --------------------------------------------------------------------------------------

OTHERS: dict[str, dict[str, Any]] = {
    "seed": {"seed": 1},
    "learner.kind": {"kind": "ppo"},
    "learner.gamma": {"gamma": 0.5},
    "learner.network.hidden": {"network": {"hidden": [8, 8]}},
    "env.max_steps": {"max_steps": 13},
    "env.reward.reached": {"reward": {"reached": 7}},
    "env.problem.nets": {"problem": {**PROBLEMS, "nets": 4}},
    "env.problem.count": {"problem": "some.gr"},
    "train.episodes": {"episodes": 2},
    "train.shared": {"shared": True},
}


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("short") / "run"
    Run(config_in(folder, 3)).execute()
    return folder


def snapshot(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize(("key", "other"), OTHERS.items(), ids=OTHERS)
def test_resume_with_another_configuration_is_refused(
    key: str, other: dict[str, Any], short: Path
) -> None:
    before = snapshot(short)
    config = config_in(short, **{"episodes": 3, **other})
    with pytest.raises(InputError) as caught:
        Run(config, resume=True)
    assert str(caught.value).startswith(f"{key}: expected ")
    assert str(short / "config.yaml") in str(caught.value)
    assert snapshot(short) == before


def test_resume_of_files_with_a_generator_is_refused(tmp_path: Path) -> None:
    generate(1, grid=(4, 4, 2), nets=3)[0].write(tmp_path / "a.gr")
    config = config_in(tmp_path / "run", 2, problem=str(tmp_path / "a.gr"))
    Run(config).execute()
    with pytest.raises(InputError, match=r"^env\.problem: expected '.*a\.gr'"):
        Run(config_in(tmp_path / "run", 2), resume=True)
    (tmp_path / "a.gr").unlink()  # the run folder has its own
    Run(config, resume=True).execute()


def test_a_folder_with_a_run_is_refused(short: Path) -> None:
    before = snapshot(short)
    with pytest.raises(InputError, match="holds a run") as caught:
        Run(config_in(short, 3))
    assert str(short) in str(caught.value)
    assert snapshot(short) == before


def test_a_folder_of_somebody_elses_is_refused(tmp_path: Path) -> None:
    (tmp_path / "tensorboard").mkdir()
    (tmp_path / "metrics.jsonl").write_text("mine\n")
    with pytest.raises(InputError, match=r"a new or an empty folder, found metrics\.jsonl"):
        Run(config_in(tmp_path, 2))
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["metrics.jsonl", "tensorboard"]
    assert (tmp_path / "metrics.jsonl").read_text() == "mine\n"


def test_one_process_at_a_time_works_in_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, said = tmp_path / "run", []
    first, original = Run(config_in(folder)), Trainer.burn_in

    def meanwhile(self: Trainer) -> None:
        monkeypatch.undo()
        before = snapshot(folder)
        for arguments in ({}, {"resume": True}):
            with pytest.raises(InputError) as caught:
                Run(config_in(folder), **arguments).execute()
            said.append(str(caught.value))
        assert snapshot(folder) == before
        original(self)

    monkeypatch.setattr(Trainer, "burn_in", meanwhile)
    first.execute()
    process = f"process {os.getpid()} on {socket.gethostname()}"
    assert said == [f"{folder}: in use by {process}"] * 2
    assert not (folder / ".lock").exists()
    Run(config_in(folder), resume=True).execute()


def test_what_killed_runs_left_is_removed(short: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(short, folder)
    for name in (".lock", ".ab12_xyz.marouting-tmp", ".mine.tmp", "mine.marouting-tmp"):
        (folder / name).write_text("")
        (folder / "problems" / name).write_text("")
    Run(config_in(folder, 3), resume=True).execute()
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*m*p"))
    names = [".mine.tmp", "mine.marouting-tmp"]
    assert left == [*names, *(f"problems/{name}" for name in names)]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"burn_in": "garbage.solution"}, r"garbage\.solution:1: expected"),
        ({"burn_in": "nowhere.solution"}, "burn_in: expected one of astar, random"),
        ({"start": "nowhere.pt"}, r"nowhere\.pt: cannot be read"),
        ({"start": "generalist"}, "start: expected networks that see .*paper.*, found .*outlook"),
        (
            {"start": "generalist", "observation": "outlook"},
            r"networks .*\[8\].*, found .*160, 128.*generalist",
        ),
        ({"device": "cuda:99"}, "device: expected cpu"),
        ({"kind": "ppo", "turn_order": "round_robin"}, "turn_order: expected sequential"),
    ],
)
def test_what_is_wrong_is_said_before_there_is_a_folder(
    wrong: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("garbage.solution").write_text("garbage\n")
    one = {**PROBLEMS, "count": 1}
    with pytest.raises(InputError, match=message):
        Run(config_in(tmp_path / "run", 2, problem=one, **wrong))
    assert not (tmp_path / "run").exists()


def test_a_resumed_run_no_longer_needs_the_files_of_its_burn_in(tmp_path: Path) -> None:
    problem = generate(1, grid=(4, 4, 2), nets=3)[0]
    problem.write(tmp_path / "a.gr")
    file = tmp_path / "a.solution"
    AStarRouter().route(problem).write(file)
    config = config_in(tmp_path / "run", 2, problem=str(tmp_path / "a.gr"), burn_in=str(file))
    Run(config).execute()
    file.unlink()
    Run(config, resume=True).execute()


class Broken:
    """A reward that fails with the first move."""

    def __call__(self, *_: Any) -> Any:
        raise InputError("broken")


def test_a_run_that_never_began_gives_its_folder_up(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(InputError, match="broken"):
        Run(config_in(folder, 2, reward=f"{__name__}:Broken")).execute()
    assert (folder / "config.yaml").exists()
    Run(config_in(folder, 2)).execute()
    with pytest.raises(InputError, match="holds a run"):
        Run(config_in(folder, 2))


def test_a_configuration_of_ones_own_is_no_run_that_never_began(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("seed: 1\n")
    with pytest.raises(InputError, match="holds a run"):
        Run(config_in(tmp_path, 2))
    assert (tmp_path / "config.yaml").read_text() == "seed: 1\n"


def test_clear_removes_a_run_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    Run(config_in(folder, 2, tensorboard=True)).execute()
    (folder / "mine.txt").write_text("mine")
    clear(folder)
    assert [path.name for path in folder.iterdir()] == ["mine.txt"]
    (folder / "metrics.jsonl").write_text("not a run's")
    clear(folder)  # no config.yaml, no run
    assert (folder / "metrics.jsonl").exists()


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flipped(path: Path) -> None:
    """A bit of a tensor is another: the archive is whole, its checksum is not."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 64
    path.write_bytes(data)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def folder_instead(path: Path) -> None:
    path.unlink()
    path.mkdir()


def random_bytes(path: Path) -> None:
    path.write_bytes(np.random.default_rng(0).bytes(5000))


def policy_only(path: Path) -> None:
    path.write_bytes((path.parent / "policy.pt").read_bytes())


def changed(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    """A checkpoint of which something is changed and saved in order."""

    def damage(path: Path) -> None:
        state = torch.load(path, weights_only=True)
        change(state)
        torch.save(state, path)

    return damage


def another_learner(state: dict[str, Any], **options: Any) -> None:
    """What a learner keeps is that of another one, on the same problems."""
    config = config_in(Path("unused"), 3, **options)
    trainer = Trainer(load_problems(config.env.problem), config)
    state["training"] = trainer.learner.state()


def reshaped(part: str, name: str) -> Callable[[Path], None]:
    """A tensor of a checkpoint lacks its last column."""
    return changed(lambda state: state[part].update({name: state[part][name][..., :-1].clone()}))


DAMAGES: dict[str, Callable[[Path], None]] = {
    "truncated": truncated,
    "flipped": flipped,
    "random": random_bytes,
    "empty": empty,
    "folder": folder_instead,
    "policy": policy_only,
    "format": changed(lambda state: state.update(format="marouting-dqn-0")),
    "problems": changed(lambda state: state.update(problems=["problem_000", "x"])),
    "problems of no names": changed(lambda state: state.update(problems=torch.ones(3, 3))),
    **{
        f"no {key}": changed(lambda state, key=key: state.pop(key))  # type: ignore[misc]
        for key in ("problems", "training", "trainer", "seconds", "figures", "logged", "evaluated")
    },
    "no policies": changed(lambda state: state["trainer"].pop("policies")),
    "no games": changed(lambda state: state["trainer"].pop("games.agents")),
    "games of fewer nets": reshaped("trainer", "games.agents"),
    "games of another type": changed(
        lambda state: state["trainer"].update({"step.obs": state["trainer"]["step.obs"].int()})
    ),
    "agents off the grid": changed(lambda state: state["trainer"]["games.agents"].fill_(99)),
    "turns of no agent": changed(lambda state: state["trainer"]["games.games"].fill_(99)),
    "rows of no agent": changed(lambda state: state["trainer"]["step.agents"].fill_(99)),
    "no routes": changed(lambda state: state.update(routes=[None, None])),
    "routes off the grid": changed(lambda state: state["routes"][0].fill_(10**6)),
    "routes of no net": changed(lambda state: state["routes"][0][0].fill_(99)),
    "no number of episodes": changed(lambda state: state.pop("in_all")),
    "more episodes": changed(lambda state: state.update(in_all=4)),
    "fewer episodes": changed(lambda state: state.update(in_all=2)),
    "episodes of no number": changed(lambda state: state.update(in_all=torch.tensor(3))),
    "no networks": changed(lambda state: state["training"].pop("networks.flat")),
    "weights": reshaped("training", "networks.flat"),
    "target": reshaped("training", "target"),
    "mean": reshaped("training", "adam.mean"),
    "policies": reshaped("trainer", "policies"),
    "memory": reshaped("training", "memory.store"),
    "smaller memory": changed(
        lambda state: state["training"].update({"memory.store": torch.zeros(2, 400, 32)})
    ),
    "ppo": changed(lambda state: another_learner(state, kind="ppo")),
    "no tensor": changed(lambda state: state["trainer"].update(episodes=[1, 2])),
    "no mapping": changed(lambda state: state.update(training=[1, 2])),
    "no best episode": changed(lambda state: state["trainer"]["best_episode"].fill_(-1)),
    "a best episode to come": changed(lambda state: state["trainer"]["episodes"].fill_(1)),
    "a parameter": changed(
        lambda state: state["training"].update(
            {"networks.flat": torch.nn.Parameter(state["training"]["networks.flat"])}
        )
    ),
    "gradients": changed(lambda state: state["training"]["networks.flat"].requires_grad_()),
    "no number": changed(lambda state: state.update(seconds="long")),
    "endless": changed(lambda state: state.update(logged=float("inf"))),
    "logged": changed(lambda state: state.update(logged=10**6)),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_resume_from_a_damaged_checkpoint_is_refused(
    damage: Callable[[Path], None], short: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    for name, content in snapshot(short).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    damage(folder / "checkpoint.pt")
    before = snapshot(folder)
    with pytest.raises(InputError) as caught:
        Run(config_in(folder, 3), resume=True).execute()
    assert str(folder) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert "InputError" not in str(caught.value)
    assert status(["train", str(folder / "config.yaml"), "--resume", str(folder)]) == 2
    assert snapshot(folder) == before


@pytest.mark.parametrize("depth", [1, 2])
def test_a_folder_that_cannot_be_made_is_refused(depth: int, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a file")
    folder = tmp_path / "file" if depth == 1 else tmp_path / "file" / "run"
    with pytest.raises(InputError, match="cannot be written") as caught:
        Run(config_in(folder, 2))
    assert str(folder) in str(caught.value)
    assert snapshot(tmp_path) == {"file": b"a file"}


def test_a_metrics_file_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run = Run(config_in(folder, 2))
    (folder / "metrics.jsonl").mkdir()
    with pytest.raises(InputError, match=r"metrics\.jsonl: cannot be written"):
        run.execute()
    assert list((folder / "metrics.jsonl").iterdir()) == []


class Endless:
    """A reward that grows beyond all numbers."""

    def __call__(self, game: Any, before: Any, movers: Any) -> Any:
        del before, movers
        return np.full(game.agents.shape, np.inf)


def test_rewards_that_are_no_numbers_end_a_training(tmp_path: Path) -> None:
    run = Run(config_in(tmp_path, reward="test_run:Endless"))
    with pytest.raises(InputError, match="reward: expected finite numbers, found inf"):
        run.execute()
    assert metrics(tmp_path) == []


@pytest.mark.parametrize("change", [{"reward": None}, {"joined": 99}, {"episode": -1}, {"best": 1}])
def test_a_resumed_run_reads_what_was_logged(
    change: dict[str, Any], finished: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    lines[2] = json.dumps({**json.loads(lines[2]), **change})
    # No shorter than it was, or it would be refused for that.
    (folder / "metrics.jsonl").write_text("\n".join(lines) + "\n" + 200 * "\n")
    run = Run(replace(load_config(folder / "config.yaml"), out=str(folder)), resume=True)
    with pytest.raises(InputError, match=rf"metrics\.jsonl:3: {next(iter(change))}: expected"):
        run.execute()
