"""Looks for the schedule with which negotiated congestion overflows least, by evolution.

    python -m policies.bench.evolution --on tight-32x32-v0:5:1,chip:1:5 --minutes 25 --out FILE.json

A set of options is judged by the overflow that it leaves on problems of some families, in relation
to the defaults at the same processor time. New sets come from the best ones: some options change at
random, some are taken from another good set. Every fourth trial gives one of the four best another
seed, so that no set stays among them by luck. The sets of
:mod:`policies.routers.pathfinder.evolved` for searches that have less time were found so.
"""

import json
import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from marouting import Problem, generate, scenarios
from marouting.files import write_text
from policies.bench.negotiation import GENERATED, SCENARIOS, SEED
from policies.bench.oracle import play
from policies.routers.pathfinder import PathfinderOptions

CHANGED, TAKEN = 0.3, 0.4
"""Share of the options that change; share of those taken from another set, where any are."""

DOUBT = 0.03
"""What a single trial counts worse than many, as a share of the defaults' overflow."""

TRIALS_ARE_SEEDS = 10
"""The first trial of a set has this seed, the second the next one."""


class Range(NamedTuple):
    """The values that an option may take."""

    low: float
    high: float
    logarithmic: bool = False
    whole: bool = False

    def moved(self, value: float, rng: np.random.Generator) -> float:
        """Another value near this one."""
        if self.logarithmic:
            value *= math.exp(0.35 * rng.normal())
        elif self.whole:
            value += rng.choice((-2, -1, 1, 2))
        else:
            value += 0.15 * (self.high - self.low) * rng.normal()
        value = min(max(float(value), self.low), self.high)
        return round(value) if self.whole else round(value, 4)


RANGES = {
    "calm": Range(0.0, 0.5),
    "least_gain": Range(0.0003, 0.01, logarithmic=True),
    "present": Range(0.004, 0.3, logarithmic=True),
    "growth": Range(1.04, 1.5),
    "history": Range(0.05, 3.0, logarithmic=True),
    "again": Range(0.0, 0.5),
    "exact_pins": Range(2, 4, whole=True),
    "stuck": Range(3, 30, logarithmic=True, whole=True),
    "probe": Range(3, 18, whole=True),
    "priced": Range(1, 7, whole=True),
    "worth": Range(3.0, 60.0, logarithmic=True),
    "margin": Range(1, 5, whole=True),
    "patience": Range(1, 10, logarithmic=True, whole=True),
}
"""The options that make a schedule."""

FIRST: dict[str, Any] = {
    "calm": 0.05,
    "least_gain": 0.0005,
    "present": 0.018,
    "growth": 1.2,
    "history": 0.65,
    "again": 0.0,
    "exact_pins": 4,
    "stuck": 13,
    "probe": 12,
    "priced": 3,
    "worth": 13.55,
    "margin": 1,
    "patience": 2,
}
"""The set that evolution begins with."""


class Task(NamedTuple):
    """Problems of a family, and the processor time that a search has for each."""

    problems: list[Problem]
    seconds: float


class Tried(NamedTuple):
    """A set of options and what came of it."""

    options: dict[str, Any]
    losses: list[float]  # of every trial: overflow in relation to the defaults, mean over tasks

    @property
    def loss(self) -> float:
        """The mean loss, and some more where it comes from few trials."""
        return float(np.mean(self.losses)) + DOUBT / len(self.losses)


def others(family: str, count: int) -> list[Problem]:
    """Problems of a family to look for options on: none of :func:`~.negotiation.problems`.

    Raises:
        InputError: there is no such family.
    """
    if family in GENERATED:
        return generate(**{**GENERATED[family], "count": count}, seed=SEED + 1)
    return list(scenarios.get(family).validation)[:count]


def child(best: list[Tried], rng: np.random.Generator) -> dict[str, Any]:
    """A new set of options.

    Args:
        best: the sets so far, best first.
        rng: random numbers.
    """
    options = dict(best[min(int(rng.exponential(2)), len(best) - 1)].options)
    parent = dict(options)
    while options == parent:
        for name, allowed in RANGES.items():
            if rng.random() < CHANGED:
                options[name] = allowed.moved(options[name], rng)
    if len(best) > 3 and rng.random() < 0.4:
        other = best[rng.integers(min(6, len(best)))].options
        taken = {name: value for name, value in other.items() if rng.random() < TAKEN}
        options.update(taken)
    return options


def evolve(
    tasks: list[Task], seconds: float, first: dict[str, Any], trials: int | None = None
) -> list[Tried]:
    """Looks for good sets of options.

    Args:
        tasks: what they are judged by; all count alike, however many problems they have.
        seconds: how long to look.
        first: the set to begin with.
        trials: how many trials at most; None: no limit.

    Returns:
        All sets that were tried, best first.
    """

    def overflows(seed: int, options: dict[str, Any]) -> Any:
        sums = np.zeros(len(tasks))
        for index, task in enumerate(tasks):
            given = {"seconds": task.seconds, "seed": seed, **options}
            sums[index] = sum(play(problem, given)["overflow"] for problem in task.problems)
        return 1 + sums

    rng = np.random.default_rng(1)
    defaults = np.mean([overflows(seed, {}) for seed in range(2)], axis=0)
    tried: list[Tried] = []
    ends, number = time.monotonic() + seconds, 0
    while time.monotonic() < ends and (trials is None or number < trials):
        number += 1
        if number % 4 == 0:
            judged = min(tried[:4], key=lambda each: len(each.losses))
        else:
            judged = Tried(child(tried, rng) if tried else dict(first), [])
            tried.append(judged)
        found = overflows(TRIALS_ARE_SEEDS + len(judged.losses), judged.options)
        judged.losses.append(float(np.mean(found / defaults)))
        click.echo(f"{number}: {judged.losses[-1]:.4f} {json.dumps(judged.options)}", err=True)
        tried.sort(key=lambda each: each.loss)
    return tried


def _tasks(_context: click.Context, _option: click.Parameter, text: str) -> list[Task]:
    """The tasks of an option's text, FAMILY:COUNT:SECONDS each, which commas part."""
    tasks = []
    for part in text.split(","):
        try:
            family, count, seconds = part.split(":")
            number, limit = int(count), float(seconds)
        except ValueError:
            raise click.BadParameter(f"expected FAMILY:COUNT:SECONDS, found {part}") from None
        if family not in (*GENERATED, *SCENARIOS):
            known = ", ".join((*GENERATED, *SCENARIOS))
            raise click.BadParameter(f"expected one of {known} as family, found {family}")
        tasks.append(Task(others(family, number), limit))
    return tasks


def _set(_context: click.Context, _option: click.Parameter, text: str) -> dict[str, Any]:
    """A set of options, in JSON."""
    try:
        chosen = {**FIRST, **json.loads(text)}
        PathfinderOptions(**chosen)
    except (ValueError, TypeError) as error:
        raise click.BadParameter(f"expected options in JSON: {error}") from None
    return chosen


@click.command()
@click.option("--on", "tasks", required=True, callback=_tasks, help="FAMILY:COUNT:SECONDS,...")
@click.option("--minutes", default=25.0, show_default=True, help="How long to look.")
@click.option("--trials", type=int, help="How many trials at most.")
@click.option("--first", default="{}", callback=_set, help="Options to begin with, in JSON.")
@click.option("--out", type=Path, required=True, help="The JSON file to write.")
def main(
    tasks: list[Task], minutes: float, trials: int | None, first: dict[str, Any], out: Path
) -> None:
    """Looks for the schedule with the least overflow; writes the best sets to a file."""
    small = others("a", 1)[0]
    for exact in (2, 5):  # compiles
        play(small, {"passes": 30, "seconds": None, "exact_pins": exact, "priced": 2, "probe": 3})
    best = evolve(tasks, 60 * minutes, first, trials)
    lines = ",\n".join(json.dumps({"losses": each.losses, **each.options}) for each in best)
    write_text(out, f"[\n{lines}\n]\n")
    click.echo(json.dumps(best[0].options))


if __name__ == "__main__":
    main()
