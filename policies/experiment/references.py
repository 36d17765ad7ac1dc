"""Computes the references of scenarios: the best solutions known, and bounds.

Usage, from a checkout::

    python -m policies.experiment.references                       # whatever has none yet
    python -m policies.experiment.references tight-16x16-v0 --seconds 60 --again
    python -m policies.experiment.references own_levels:mine       # a scenario of your own

Each problem goes to the router ``optimal``, which has ``--seconds`` to prove an optimum. If it
cannot, negotiated congestion tries with several seeds to find a better solution. What was known
before is kept where it is better, so more time never makes a reference worse. The file of a
scenario is written after every problem; a run that was stopped goes on from there.
"""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import NamedTuple

import click

from marouting import (
    Problem,
    evaluate,
    generate,
    scenarios,
)
from marouting.config import check
from marouting.files import write_text
from marouting.scenarios import Scenario
from marouting.scenarios.references import FOLDER, Best, read_references, references_in
from policies.command import Command
from policies.routers.optimal import OptimalRouter
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter


class Effort(NamedTuple):
    """What is spent on a problem."""

    seconds: float  # for ``optimal``
    seeds: int = 0  # of negotiated congestion, where that proves nothing
    each: float = 0.0  # seconds for each of these


def solve(problem: Problem, name: str, effort: Effort, known: Best | None = None) -> Best:
    """The better solution and the better bound of what is known and what is found in addition."""
    began = time.monotonic()
    found = OptimalRouter(time_limit=effort.seconds).solve(problem)
    score, solver = (found.overflow, found.wirelength), "optimal"
    bound = found.bound_overflow, found.bound_wirelength
    if found.status != "optimal":
        for seed in range(effort.seeds):
            options = PathfinderOptions(
                seconds=effort.each, least_gain=0.0, repair_after=1000, seed=seed
            )
            figures = evaluate(problem, PathfinderRouter(options).route(problem))
            if (figures.overflow, figures.wirelength) < score:
                score, solver = (figures.overflow, figures.wirelength), f"pathfinder, seed {seed}"
    how = f"solution by {solver}"
    if bound < score:
        how += f", bound by optimal in {effort.seconds:g} s"
    record = Best(
        problem=name,
        overflow=score[0],
        wirelength=score[1],
        bound_overflow=bound[0],
        bound_wirelength=bound[1],
        how=how,
        seconds=round(time.monotonic() - began, 3),
    )
    return record if known is None else _better(known, record)


def _better(known: Best, new: Best) -> Best:
    """The better solution and the better bound of two records, with the time of both."""
    better = known if (known.overflow, known.wirelength) <= (new.overflow, new.wirelength) else new
    bound = max(known.bound, new.bound)
    return replace(
        better,
        bound_overflow=bound[0],
        bound_wirelength=bound[1],
        how=better.how if better.bound == bound else f"{known.how}; then {new.how}",
        seconds=round(known.seconds + new.seconds, 3),
    )


def _with_references(name: str) -> Scenario:
    """A scenario with a file for its references; raises InputError."""
    scenario = scenarios.load(name)
    what = "a file to write them to, in scenarios.register(…, references=…)"
    fits = scenario.name in scenarios.SHIPPED or scenario.references.parent != FOLDER
    check(f"{scenario.name}: references", fits, what)
    return scenario


def solve_scenario(name: str, effort: Effort, *, again: bool = False) -> Iterator[Best]:
    """Computes the references of a scenario and writes them to its file, one by one.

    Args:
        name: the scenario's name, or ``module:NAME``.
        effort: what is spent on each problem.
        again: whether it is also spent on problems whose reference is known but not proven.

    Raises:
        InputError: there is no such scenario, or it is one of your own that names no file.
    """
    scenario = _with_references(name)
    path = scenario.references
    kept = read_references(path)
    known = kept.references
    problems = {**scenario.problems("validation"), **scenario.problems("test")}
    places = {scenarios.digest(item[1]): item for item in problems.items()}
    known = {digest: known[digest] for digest in places if digest in known}
    for digest, (problem_name, problem) in places.items():
        before = known.get(digest)
        if before is not None and (before.proven or not again):
            continue
        known[digest] = solve(problem, problem_name, effort, before)
        in_order = {d: asdict(known[d]) for d in places if d in known}
        whole = {"references": in_order, "heuristic": kept.heuristic}
        write_text(path, json.dumps(whole, indent=1) + "\n")
        references_in.cache_clear()
        yield known[digest]


@click.command(cls=Command)
@click.argument("names", nargs=-1)
@click.option("--seconds", default=30.0, show_default=True, help="Time of `optimal` per problem.")
@click.option("--seeds", default=2, show_default=True, help="Seeds of negotiated congestion.")
@click.option("--each", default=15.0, show_default=True, help="Time of each seed per problem.")
@click.option("--again", is_flag=True, help="Spend it also on what is known but not proven.")
def main(
    names: Sequence[str],
    seconds: float,
    seeds: int,
    each: float,
    again: bool,
) -> None:
    """Computes the references of scenarios: NAMES, module:NAME for your own, or all."""
    check("--seconds", seconds >= 0, "a number from 0")
    check("--each", each >= 0, "a number from 0")
    check("--seeds", seeds >= 0, "a number from 0")
    for name in names:
        _ = _with_references(name)
    # So that no time of a reference includes compiling.
    solve(generate(1, (4, 4, 2), nets=9, capacity=1)[0], "", Effort(0.1, 1, 0.1))
    for name in names or scenarios.names():
        for record in solve_scenario(name, Effort(seconds, seeds, each), again=again):
            click.echo(
                f"{name} {record.problem}: {record.overflow} / {record.wirelength}, bound "
                f"{record.bound_overflow} / {record.bound_wirelength}, {record.how}, "
                f"{record.seconds:.1f} s",
                err=True,
            )


if __name__ == "__main__":
    main()
