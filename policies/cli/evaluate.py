"""``marouting evaluate``: a solution judged; and how the figures of one are shown."""

import json
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

from marouting import ProblemFile, Solution, evaluate
from marouting.files import check_apart, check_writable, suffix_of
from marouting.problem.contest import contest_cost
from marouting.problem.guides import check_guide, read_record
from policies.cli.options import FILE, json_option, json_text
from policies.cli.source import problem_argument


@click.command("evaluate")
@problem_argument
@click.argument("solution", type=FILE)
@click.option(
    "--report",
    "in_detail",
    is_flag=True,
    help="Print a report of congestion and detours instead.",
)
@click.option(
    "--map",
    "picture",
    type=FILE,
    help="File for a congestion map, such as map.png; without it, none is drawn.",
)
@json_option
def evaluate_command(
    problem: ProblemFile, solution: Path, in_detail: bool, picture: Path | None, as_json: bool
) -> None:
    """Evaluate a solution file by the rules of the ISPD 2008 contest's evaluator.

    Overflow and wirelength are given with and without (pruned) dead ends and loops. A routing guide
    is evaluated by the shortest routes inside it. A .guide file is also checked for boxes off the
    grid of Gcells, pins that it does not cover, and nets whose boxes are not all connected.
    Problems of the ISPD 2024 contest also get the contest's cost. A pin with shapes in several
    Gcells may be reached in any of them.

    A report has wires and vias by layer, the edges with the most overflow and the nets on them,
    each net's detour over the shortest tree, a histogram of edge use, and the open nets.
    """
    if picture is not None:
        check_apart(picture, *problem.files, solution)
    loaded = problem.read()
    record = read_record(solution, loaded)
    routes = Solution.of_record(record, loaded).at_reached_pins()
    if picture is not None:
        from policies import figures

        check_writable(picture)
        figures.save(figures.congestion_map(routes.problem, routes, problem.stem), picture)
    is_guide = suffix_of(solution) == ".guide"
    checked = check_guide(record, loaded) if is_guide else None
    if is_guide and checked is None:
        click.echo(f"{solution}: no boxes, so it is not checked as a guide", err=True)
    of_guide = {} if checked is None else {f"guide_{k}": v for k, v in asdict(checked).items()}
    if in_detail:
        from policies.cli.tables import show_report
        from policies.results.report import report

        more = contest_figures(routes) | of_guide
        found = {**report(routes), **more}
        click.echo(json.dumps(found)) if as_json else show_report(found, str(solution), more)
        return
    started = time.perf_counter()
    evaluate(routes.problem, routes)
    seconds = time.perf_counter() - started
    show_figures(None, routes, seconds, as_json, of_guide)


def contest_figures(solution: Solution) -> dict[str, Any]:
    """The cost of the ISPD 2024 contest, and the open nets by its rules; empty for others."""
    chip = solution.problem.chip
    if chip is None or chip.contest is None:
        return {}
    cost = asdict(contest_cost(solution))
    open_nets = cost.pop("open")
    return {**{f"ispd2024_{name}": value for name, value in cost.items()}, "open_nets": open_nets}


def show_figures(
    router: str | None,
    solution: Solution,
    seconds: float,
    as_json: bool,
    report: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Prints the figures of a solution, and those that its router adds."""
    from policies.results.rows import solution_row

    fields = {"router": router, **solution_row(solution, seconds), **report}
    fields["open_nets"] = evaluate(solution.problem, solution).disconnected
    fields |= contest_figures(solution)
    disconnected = fields.pop("open_nets")  # they come last
    if as_json:
        click.echo(json_text({**fields, "open_nets": disconnected}))
        return
    width = max(map(len, fields))
    for name, value in fields.items():
        if value is not None:
            click.echo(f"{name:>{width}}  {value}")
    if disconnected:
        shown = " ".join(disconnected[:10])
        more = len(disconnected) - 10
        click.echo(f"{'open nets':>{width}}  {shown}{f' and {more} more' if more > 0 else ''}")
