"""How much less negotiated congestion would overflow if it knew more: an upper bound on learning.

    python -m policies.bench.oracle prices --out FILE.json
    python -m policies.bench.oracle schedule --out FILE.json
    python -m policies.bench.oracle evolved --out FILE.json

``prices`` lets the router begin with the prices at which a long search of the same problem ended,
as they are and at a half. ``schedule`` looks for the options with which the router does best on
other problems of the family, by differential evolution, and lets it begin with these; with
``--together``, for one set of options for all families. ``evolved`` takes the set that is shipped
(:mod:`policies.routers.pathfinder.evolved`). All compare with the defaults at the same processor
time, on the problems of :mod:`policies.bench.negotiation`. What does not help here need not be
learned.
"""

import itertools
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from scipy.optimize import Bounds, differential_evolution

from marouting import Problem, evaluate, generate, scenarios
from policies.bench.negotiation import (
    GENERATED,
    SCENARIOS,
    SEED,
    families_option,
    numbers,
    problems,
    report,
)
from policies.routers.pathfinder import EvolvedOptions, PathfinderOptions, PathfinderRouter

SCALES = (1.0, 0.5)
"""Shares of the converged prices that a search begins with."""

EVOLVED = "evolved"
"""The router whose options were found so."""

LONG_SEED = 100
"""Seed of the searches that find the prices: none of those that are compared."""


class Range(NamedTuple):
    """The values that an option may take in the search for the best schedule."""

    low: float
    high: float
    logarithmic: bool = False
    whole: bool = False


RANGES = {
    "present": Range(0.02, 2.0, logarithmic=True),
    "growth": Range(1.01, 1.5),
    "history": Range(0.03, 3.0, logarithmic=True),
    "decay": Range(0.0, 1.0),
    "stuck": Range(3, 60, logarithmic=True, whole=True),
    "margin": Range(0, 5, whole=True),
    "exact_pins": Range(2, 5, whole=True),
    "again": Range(0.0, 0.5),
    "calm": Range(0.0, 1.0),
    "patience": Range(1, 30, logarithmic=True, whole=True),
}
"""The options that make a schedule."""


def others(family: str, count: int) -> list[Problem]:
    """Problems of a family to look for options on: none of :func:`~.negotiation.problems`."""
    if family in SCENARIOS:
        return list(scenarios.get(family).validation)[:count]
    return generate(**{**GENERATED[family], "count": count}, seed=SEED + 1)


def play(problem: Problem, options: dict[str, Any], prices: Any = None) -> dict[str, int]:
    """Routes a problem: overflow and wirelength."""
    routed = PathfinderRouter(PathfinderOptions(**options)).solve(problem, prices=prices)
    figures = evaluate(problem, routed.solution)
    return {"overflow": figures.overflow, "wirelength": figures.wirelength}


def with_prices(
    family: str, seeds: int, times: Sequence[float], long: float
) -> Iterator[dict[str, Any]]:
    """Rows of the defaults, of the long search, and of searches that begin with its prices."""
    for index, problem in enumerate(problems(family)):
        router = PathfinderRouter(PathfinderOptions(seconds=long, seed=LONG_SEED))
        prices = router.solve(problem).prices
        for seconds, seed in itertools.product(times, range(seeds)):
            where = {"family": family, "problem": index, "seconds": seconds}
            options = {"seconds": seconds, "seed": seed}
            yield {"router": "defaults", **where, "seed": seed, **play(problem, options)}
            for scale in SCALES:
                row = play(problem, options, scale * prices)
                yield {"router": f"prices x {scale:g}", **where, "seed": seed, **row}


def values(point: Any) -> dict[str, Any]:
    """The options that a point of the search's space, one number per range, stands for."""
    chosen: dict[str, Any] = {}
    for (name, allowed), number in zip(RANGES.items(), point, strict=True):
        value = math.exp(number) if allowed.logarithmic else float(number)
        chosen[name] = round(value) if allowed.whole else value
    return chosen


def best_schedule(
    families: Sequence[str], seconds: float, trials: int, count: int
) -> dict[str, Any]:
    """The options with the least overflow, in relation to the defaults, on other problems.

    Args:
        families: the families. Every problem counts alike.
        seconds: processor time per problem.
        trials: sets of options that are tried, about.
        count: problems of each family for each of them.
    """
    tried = [problem for family in families for problem in others(family, count)]
    defaults = PathfinderOptions()

    def scaled(allowed: Range, value: float) -> float:
        return math.log(value) if allowed.logarithmic else value

    def overflows(seed: int, **options: Any) -> Any:
        given = {"seconds": seconds, "seed": seed, **options}
        return np.array([play(problem, given)["overflow"] for problem in tried]) + 1

    base = np.mean([overflows(seed) for seed in range(3)], axis=0)
    counter = itertools.count()

    def loss(point: Any) -> float:
        # Seeds change, so that no set of options wins by the luck of one.
        number = next(counter)
        found = float(np.mean(overflows(10 + number % 3, **values(point)) / base))
        click.echo(f"{number}: {found:.3f} {json.dumps(values(point))}", err=True)
        return found

    result = differential_evolution(
        loss,
        Bounds(
            [scaled(allowed, allowed.low) for allowed in RANGES.values()],
            [scaled(allowed, allowed.high) for allowed in RANGES.values()],
        ),
        x0=[scaled(allowed, getattr(defaults, name)) for name, allowed in RANGES.items()],
        popsize=1,
        maxiter=max(1, trials // len(RANGES) - 1),
        mutation=(0.4, 0.9),
        recombination=0.8,
        polish=False,
        tol=0,
        seed=1,
    )
    return values(result.x)


def with_schedule(
    name: str, family: str, seeds: int, times: Sequence[float], schedule: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Rows of the defaults, and of a schedule under a name, with its options."""
    for seconds, (index, problem) in itertools.product(times, enumerate(problems(family))):
        where = {"family": family, "problem": index, "seconds": seconds}
        for seed in range(seeds):
            options = {"seconds": seconds, "seed": seed}
            row = {"router": "defaults", **where, "seed": seed, **play(problem, options)}
            yield row
            found = play(problem, {**options, **schedule})
            yield {**row, "router": name, **found, "options": schedule}


@click.command()
@click.argument("oracle", type=click.Choice(("prices", "schedule", EVOLVED)))
@families_option
@click.option("--seeds", default=3, show_default=True, help="Seeds of the router per problem.")
@click.option(
    "--seconds",
    default="1",
    show_default=True,
    callback=numbers,
    help="Processor time of a search: 1,5. Schedules are sought with the first.",
)
@click.option("--together", is_flag=True, help="One schedule for all families.")
@click.option("--long", default=30.0, show_default=True, help="The same where prices are found.")
@click.option("--trials", default=160, show_default=True, help="Schedules tried, about.")
@click.option("--count", default=5, show_default=True, help="Problems per schedule tried.")
@click.option("--out", type=Path, required=True, help="The JSON file to write.")
def main(
    oracle: str,
    families: list[str],
    seeds: int,
    seconds: list[float],
    together: bool,
    long: float,
    trials: int,
    count: int,
    out: Path,
) -> None:
    """Measures what an oracle brings; writes rows to a file, a table to standard output."""
    for exact in (2, 5):
        play(problems(families[0])[0], {"seconds": 0.2, "exact_pins": exact})  # compiles

    shipped = {name: getattr(EvolvedOptions(), name) for name in RANGES}

    def rows(group: Sequence[str]) -> Iterator[dict[str, Any]]:
        if oracle == "prices":
            priced = (with_prices(family, seeds, seconds, long) for family in group)
            return itertools.chain.from_iterable(priced)
        name, schedule = oracle, shipped
        if oracle == "schedule":
            name, schedule = "best schedule", best_schedule(group, seconds[0], trials, count)
        found = (with_schedule(name, family, seeds, seconds, schedule) for family in group)
        return itertools.chain.from_iterable(found)

    groups = [families] if together else [[name] for name in families]
    report(itertools.chain.from_iterable(map(rows, groups)), out)


if __name__ == "__main__":
    main()
