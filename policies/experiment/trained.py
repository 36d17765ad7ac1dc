"""Trains the rows of the table of policies in docs/cooperation.md.

Usage, from a checkout::

    python -m policies.experiment.trained gates-8x7-v0            # all rows, five seeds
    python -m policies.experiment.trained gates-mixed-v0 --row ippo-team --row mappo-team
    python -m policies.experiment.trained gates-8x7-v0 --steps 10000000 --seeds 3
    python -m policies.experiment.trained --table                 # the table of what is known

Every row is ``marouting train`` with the options of :data:`ROWS`. A policy is trained on the
scenario's training problems and then plays its validation and test problems as it is. Options were
chosen on validation problems, of ``gates-8x7-v0`` only; all scenarios have the same.

A training that was stopped goes on from its checkpoint when the command is given again, and one
that is finished is not repeated. Its figures are added to :data:`FOLDER` as soon as it ends.
"""

import csv
import io
import statistics
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from marouting import InputError, scenarios
from marouting.config import check
from marouting.files import exists, read_text, write_text
from marouting.scenarios.cooperation import COOPERATION
from policies.experiment.cloned import cloned
from policies.learned.config import load_config
from policies.learned.run import Run
from policies.learned.threads import use_threads
from policies.results.run_folder import (
    CONFIG,
    EVALUATIONS,
    METRICS,
    read_episodes,
    read_evaluations,
)
from policies.routers.local import LocalRouter

FOLDER = Path("docs/results/cooperation")
"""Where the figures are: ``trained.csv`` and the learning curves, ``curves.csv``."""

_SELFISH = "env.reward={kind: difference, overflow: 20, open: 20}"
_COUNTERFACTUAL = "env.reward={kind: counterfactual, overflow: 20, open: 20}"
_IQL = (
    "learner.kind=iql",
    "learner.network={kind: mlp, hidden: [128, 128]}",
    "learner.gamma=0.99",
    "learner.burn_in=random",
    "learner.burn_in_size=10000",
    "learner.epsilon=0.3",
)
_SMALL_TEAM = "env.reward={kind: team, overflow: 1, open: 1, wirelength: 0.05}"
_TEACHER = LocalRouter(radius=3)
"""What cloned starts imitate: shortest paths within the window, planned anew at every move."""

_CLONED = "train.start=runs/cooperation/CLONE"

ROWS: Mapping[str, tuple[str, ...]] = {
    "ippo-selfish": ("learner.kind=ippo", _SELFISH),
    "ippo-team": ("learner.kind=ippo",),
    "ippo-counterfactual": ("learner.kind=ippo", _COUNTERFACTUAL),
    "mappo-selfish": ("learner.kind=mappo", _SELFISH),
    "mappo-team": ("learner.kind=mappo",),
    "mappo-counterfactual": ("learner.kind=mappo", _COUNTERFACTUAL),
    "iql-team": (*_IQL, _SMALL_TEAM),
    "ippo-selfish-cloned": ("learner.kind=ippo", _SELFISH, _CLONED),
    "ippo-team-cloned": ("learner.kind=ippo", _CLONED),
    "mappo-team-cloned": ("learner.kind=mappo", _CLONED),
}
"""What ``marouting train`` is told, by row. The scenarios suggest the reward ``team``."""


def overrides(scenario: str, row: str, seed: int, steps: int) -> list[str]:
    """What is said on the command line of a training."""
    own = (said.replace("CLONE", f"{scenario}.clone.{seed}.pt") for said in ROWS[row])
    return [f"env.scenario={scenario}", f"train.steps={steps}", f"seed={seed}", *own]


def train(folder: Path, said: Sequence[str]) -> tuple[Run, float]:
    """Trains to the end, or what is left of a training; returns it and its processor time in s."""
    quiet = ("train.figures=false", "train.tensorboard=false", f"out={folder}")
    spent = folder / "processor_seconds.txt"
    resume = exists(folder / CONFIG)
    before = float(read_text(spent, 100)) if exists(spent) else 0.0
    config = load_config(None, [*said, *quiet])
    start = config.train.start
    if start is not None and not exists(start):
        cloned(replace(config, train=replace(config.train, start=None)), _TEACHER, Path(start))
    run = Run(config, resume=resume)
    if run.finished is not None:
        return run, before
    began = told = time.process_time()

    def watch(_: object) -> None:
        nonlocal told
        if (now := time.process_time()) > told + 10:
            told = now
            write_text(spent, str(before + now - began))
            done, of, what = run.progress
            click.echo(f"{folder.name}: {done} of {of} {what}", err=True)

    run.execute(watch)
    seconds = before + time.process_time() - began
    write_text(spent, str(seconds))
    return run, seconds


def figures(row: str, run: Run, seconds: float, command: str) -> Iterator[dict[str, Any]]:
    """The lines of ``trained.csv`` of a training: the two splits."""
    module = run.trainer.policy_of(run.trainer.names[0]).module
    parameters = sum(weights.numel() for weights in module.parameters())
    for result in run.standing():
        yield {
            "scenario": result.scenario,
            "row": row,
            "seed": run.config.seed,
            "agent_steps": int(run.trainer.steps.sum()),
            "processor_seconds": round(seconds),
            "split": result.split,
            "problems": result.problems,
            "solved": round(result.solved, 4),
            "connected": round(result.connected, 4),
            "wirelength": result.wirelength,
            "cost": round(result.cost, 4),
            "score": round(result.score, 4),
            "parameters": parameters,
            "command": command,
        }


def curve(row: str, run: Run) -> Iterator[dict[str, Any]]:
    """The lines of ``curves.csv`` of a training: the cost on validation as it went on."""
    scenario = scenarios.get(str(run.config.env.scenario))
    reference = sum(scenario.reference(p).wirelength for p in run.problems.values())
    moves = [0]
    for episode in read_episodes(run.folder / METRICS):
        moves.append(moves[-1] + episode.steps)
    judged = read_evaluations(run.folder / EVALUATIONS)
    for at in range(0, len(judged), len(run.problems)):
        once = judged[at : at + len(run.problems)]
        wirelength = sum(of.wirelength for of in once)
        still_open = sum(of.tasks - of.joined for of in once)
        yield {
            "scenario": scenario.name,
            "row": row,
            "seed": run.config.seed,
            "agent_steps": moves[once[0].episodes],
            "validation_cost": round(scenario.cost(wirelength, still_open) / reference, 4),
        }


def read_rows(name: str) -> list[dict[str, str]]:
    """The lines of a file in :data:`FOLDER`; none if there is no file."""
    path = FOLDER / name
    if not exists(path):
        return []
    return list(csv.DictReader(io.StringIO(read_text(path, 2**24))))


def add_rows(name: str, new: Sequence[Mapping[str, Any]]) -> None:
    """Adds lines to a file in :data:`FOLDER`."""
    text = io.StringIO()
    writer = csv.DictWriter(text, new[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows([*read_rows(name), *new])
    FOLDER.mkdir(parents=True, exist_ok=True)
    write_text(FOLDER / name, text.getvalue())


def table() -> Iterator[str]:
    """The lines of the table of docs/cooperation.md: costs on the test problems."""
    groups: dict[tuple[str, str, int], list[dict[str, str]]] = {}
    for line in read_rows("trained.csv"):
        if line["split"] == "test":
            # A training ends with a whole round of its games, a little above the steps asked for.
            steps = int(float(f"{int(line['agent_steps']):.1e}"))
            groups.setdefault((line["scenario"], line["row"], steps), []).append(line)
    yield "| scenario | row | agent-steps | seeds | median cost | least to most | solved, % |"
    yield "|---|---|---:|---:|---:|---|---|"
    for (scenario, row, steps), lines in groups.items():
        costs = sorted(float(line["cost"]) for line in lines)
        solved = sorted(round(100 * float(line["solved"])) for line in lines)
        yield (
            f"| `{scenario}` | `{row}` | {steps / 1e6:g} M | {len(costs)} | "
            f"{statistics.median(costs):.3f} | {costs[0]:.3f} to {costs[-1]:.3f} | "
            f"{solved[0]} to {solved[-1]} |"
        )


@click.command()
@click.argument("names", nargs=-1)
@click.option("--row", "rows", multiple=True, help="Name of a row. [default: all]")
@click.option("--seeds", default=5, show_default=True, help="Seeds from 0.")
@click.option("--steps", default=1_000_000, show_default=True, help="Moves of agents.")
@click.option("--out", default="runs/cooperation", show_default=True, help="Run folders.")
@click.option("--table", "shown", is_flag=True, help="Only print the table of what is known.")
def main(
    names: Sequence[str], rows: Sequence[str], seeds: int, steps: int, out: str, shown: bool
) -> None:
    """Trains policies in the scenarios NAMES and scores them on the test problems."""
    known = [scenario.name for scenario in COOPERATION]
    try:
        for name in names:
            check("scenario", name in known, f"one of {', '.join(known)}, found {name!r}")
        for row in rows:
            check("--row", row in ROWS, f"one of {', '.join(ROWS)}, found {row!r}")
        if shown:
            for line in table():
                click.echo(line)
            return
        use_threads(1)  # two on these small networks are slower than one
        wanted = [(n, r, s) for n in names for s in range(seeds) for r in rows or ROWS]
        for name, row, seed in wanted:
            said = overrides(name, row, seed, steps)
            command = f"marouting train {' '.join(said)}"
            if command in {line["command"] for line in read_rows("trained.csv")}:
                continue
            run, seconds = train(Path(out) / f"{name}.{row}.{steps}.{seed}", said)
            found = list(figures(row, run, seconds, command))
            add_rows("curves.csv", list(curve(row, run)))
            add_rows("trained.csv", found)  # last: it says that the training is finished
            click.echo(f"{name} {row}, seed {seed}: cost {found[-1]['cost']:.4f}", err=True)
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
