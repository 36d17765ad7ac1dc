"""Computes the references of scenarios: the best solutions known, and bounds.

Usage, from a checkout::

    python -m policies.benchmark.references                       # whatever has none yet
    python -m policies.benchmark.references tight-16x16-v0 --seconds 60 --again
    python -m policies.benchmark.references --table docs/scenarios.md

Each problem goes to the router ``optimal``, which has ``--seconds`` to prove an optimum. If it
cannot, negotiated congestion tries with several seeds to find a better solution. What was known
before is kept where it is better, so more time never makes a reference worse. The file of a
scenario is written after every problem; a run that was stopped goes on from there.

The table of the scenarios measures sequential A* and negotiated congestion on the test problems.
"""

import itertools
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from marouting import (
    InputError,
    Problem,
    Solution,
    evaluate,
    generate,
    scenarios,
    sequential_astar,
)
from marouting.config import check
from marouting.files import read_text, write_text
from marouting.scenarios import Scenario
from marouting.scenarios.references import Record, path_of, read_references
from marouting.scenarios.scenario import routable
from policies.routers.optimal import OptimalRouter
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter


class Effort(NamedTuple):
    """What is spent on a problem."""

    seconds: float  # for ``optimal``
    seeds: int = 0  # of negotiated congestion, where that proves nothing
    each: float = 0.0  # seconds for each of these


def solve(problem: Problem, name: str, effort: Effort, known: Record | None = None) -> Record:
    """Finds out about a problem's best solution.

    Args:
        problem: the problem.
        name: its name.
        effort: what to spend.
        known: what is known already.

    Returns:
        The better solution and the better bound of what is known and what was found.
    """
    began = time.monotonic()
    found = OptimalRouter(time_limit=effort.seconds).solve(problem)
    score, solver = (found.overflow, found.wirelength), "optimal"
    bound = found.bound_overflow, found.bound_wirelength
    if found.status != "optimal":
        for seed in range(effort.seeds):
            options = PathfinderOptions(seconds=effort.each, patience=1000, seed=seed)
            figures = evaluate(problem, PathfinderRouter(options).route(problem))
            if (figures.overflow, figures.wirelength) < score:
                score, solver = (figures.overflow, figures.wirelength), f"pathfinder, seed {seed}"
    how = f"solution by {solver}"
    if bound < score:
        how += f", bound by optimal in {effort.seconds:g} s"
    record = Record(
        problem=name,
        overflow=score[0],
        wirelength=score[1],
        bound_overflow=bound[0],
        bound_wirelength=bound[1],
        how=how,
        seconds=round(time.monotonic() - began, 3),
    )
    return record if known is None else _better(known, record)


def _better(known: Record, new: Record) -> Record:
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


def solve_scenario(name: str, effort: Effort, *, again: bool = False) -> Iterator[Record]:
    """Computes the references of a scenario and writes them to the package's file.

    Args:
        name: the scenario.
        effort: what to spend on a problem.
        again: whether to spend it also on problems whose reference is known but not proven.

    Yields:
        Each new reference, once it is written.

    Raises:
        InputError: there is no such scenario, or its file cannot be read or written.
    """
    scenario = scenarios.get(name)
    path = path_of(name)
    known = read_references(path)
    problems = {**scenario.problems("validation"), **scenario.problems("test")}
    places = {scenarios.digest(problem): (of, problem) for of, problem in problems.items()}
    known = {digest: known[digest] for digest in places if digest in known}
    for digest, (of, problem) in places.items():
        before = known.get(digest)
        if before is not None and (before.proven or not again):
            continue
        known[digest] = solve(problem, of, effort, before)
        in_order = {d: asdict(known[d]) for d in places if d in known}
        write_text(path, json.dumps({"references": in_order}, indent=1) + "\n")
        yield known[digest]


MARKS = ("<!-- table: begin -->", "<!-- table: end -->")
"""What surrounds the table in its file."""

_HEADER = """\
| scenario | grid | nets | pins | capacity | problems | proven | best known | A\\* | \
negotiated congestion, {limit:g} s | kept | new problems |
|---|---|---|---|---|---|---|---|---|---|---|---|
"""

_MOST = 1000
"""The most problems that are drawn to see how many are kept."""


def table(names: Sequence[str], limit: float = 1.0, sample: float = 4.0) -> Iterator[str]:
    """Measures what ``docs/scenarios.md`` shows.

    Args:
        names: the scenarios.
        limit: seconds of negotiated congestion per problem.
        sample: seconds in which training problems are drawn.

    Yields:
        Lines of a table in Markdown, each as soon as it is measured.
    """
    yield _HEADER.format(limit=limit)
    for name in names:
        scenario = scenarios.get(name)
        level, reduced = scenario.level, scenario.level.reduced_edges
        best = [scenario.reference(problem) for problem in scenario.test]
        known = [*best, *map(scenario.reference, scenario.validation)]
        least = sum(one.overflow for one in best), sum(one.wirelength for one in best)
        router = PathfinderRouter(PathfinderOptions(seconds=limit))
        cells = [
            name,
            "×".join(map(str, level.grid)),
            _range(level.nets),
            "2" if level.max_pins == (2, 2) else f"2–{level.max_pins[1]}",
            _range(level.capacity) + (f", {reduced} reduced" if reduced else ""),
            f"{level.validation} + {level.test}",
            f"{sum(one.proven for one in known)} of {len(known)}",
            f"{least[0]} / {least[1]}",
            _gap(sequential_astar, scenario.test, least),
            _gap(router.route, scenario.test, least),
            _kept(scenario, sample),
            _speed(scenario, sample),
        ]
        yield f"| {' | '.join(cells)} |\n"


def _range(bounds: tuple[int, int]) -> str:
    return str(bounds[0]) if bounds[0] == bounds[1] else f"{bounds[0]}–{bounds[1]}"


def _gap(
    route: Callable[[Problem], Solution], problems: Sequence[Problem], least: tuple[int, int]
) -> str:
    """What a router leaves: overflow, and wirelength above the best known; its processor time."""
    began = time.process_time()
    solutions = [route(problem) for problem in problems]
    each = (time.process_time() - began) / len(problems)
    found = [evaluate(*pair) for pair in zip(problems, solutions, strict=True)]
    overflow, wirelength = sum(f.overflow for f in found), sum(f.wirelength for f in found)
    more = 100 * (wirelength / least[1] - 1)
    above = f" ({100 * (overflow / least[0] - 1):+.1f} %)" if least[0] else ""
    return f"{overflow}{above} / {more:+.1f} %, {each:.2g} s"


def _speed(scenario: Scenario, seconds: float) -> str:
    """New training problems per second of the processor."""
    _ = scenario.test, scenario.validation  # made once
    end, began = time.monotonic() + seconds, time.process_time()
    count = sum(1 for _ in itertools.takewhile(_until(end), scenario.train(0)))
    rate = count / (time.process_time() - began)
    return f"{rate:.0f}/s" if rate >= 10 else f"{rate:.1f}/s"


def _kept(scenario: Scenario, seconds: float) -> str:
    """The share of the problems drawn that A* proves feasible."""
    if not scenario.feasible:
        return "all"
    began, found = time.monotonic(), []
    for seed in itertools.takewhile(_until(began + seconds), range(_MOST)):
        found.append(routable(scenario.level.problem(np.random.default_rng(seed))))
    return f"{100 * sum(found) / len(found):.0f} %"


def _until(end: float) -> Callable[[object], bool]:
    """Whether it is earlier than ``end``."""
    return lambda _: time.monotonic() < end


def write_table(path: Path, lines: Iterable[str]) -> None:
    """Puts the lines of a table between the :data:`MARKS` of a file.

    Raises:
        InputError: the file cannot be read or written, or has no marks.
    """
    text = read_text(path, 2**20)
    before, begin, rest = text.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    check(str(path), begin and end, f"the marks {' and '.join(MARKS)}")
    written = []
    for line in lines:
        written.append(line)
        click.echo(line, nl=False, err=True)
    write_text(path, f"{before}{begin}\n\n{''.join(written)}\n{end}{after}")


@click.command()
@click.argument("names", nargs=-1)
@click.option("--seconds", default=30.0, show_default=True, help="Time of `optimal` per problem.")
@click.option("--seeds", default=2, show_default=True, help="Seeds of negotiated congestion.")
@click.option("--each", default=15.0, show_default=True, help="Time of each seed per problem.")
@click.option("--again", is_flag=True, help="Spend it also on what is known but not proven.")
@click.option("--table", "file", type=Path, help="Write the table of this file instead.")
def main(
    names: Sequence[str],
    seconds: float,
    seeds: int,
    each: float,
    again: bool,
    file: Path | None,
) -> None:
    """Computes the references of scenarios (all, unless NAMES are given)."""
    try:
        check("--seconds", seconds >= 0, "a number from 0")
        check("--each", each >= 0, "a number from 0")
        check("--seeds", seeds >= 0, "a number from 0")
        if file is not None:
            write_table(file, table(names or scenarios.names()))
            return
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
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
