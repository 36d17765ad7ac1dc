"""``marouting report`` and ``marouting guide``: what becomes of a solution on a chip."""

import json
from pathlib import Path

import click

from marouting import Solution, evaluate
from marouting.files import check_writable
from policies.cli.options import FILE, json_option, tell
from policies.cli.source import ProblemFile, problem_argument


@click.command()
@problem_argument
@click.argument("solution", type=FILE)
@click.option(
    "--map",
    "picture",
    type=FILE,
    help="Picture for a congestion map, such as map.png; without it, none.",
)
@json_option
def report(problem: ProblemFile, solution: Path, picture: Path | None, as_json: bool) -> None:
    """Say where a solution of PROBLEM is crowded, and which nets make detours.

    Wires and vias by layer, overflow and the edges where it is worst, with the nets that meet
    there, detours by net against the shortest tree, a histogram of use, and open nets.
    """
    from policies.cli.tables import show_report
    from policies.results.report import report as report_on

    loaded = problem.read()
    routes = Solution.read(solution, loaded).at_reached_pins()
    if picture is not None:
        check_writable(picture)
    found = report_on(routes)
    if picture is not None:
        from policies import figures

        figures.save(figures.congestion_map(routes.problem, routes, problem.stem), picture)
    if as_json:
        click.echo(json.dumps(found))
    else:
        show_report(found, str(solution))


@click.command()
@problem_argument
@click.argument("solution", type=FILE)
@click.option("--out", type=FILE, required=True, help="File for the guide.")
@json_option
def guide(problem: ProblemFile, solution: Path, out: Path, as_json: bool) -> None:
    """Write a solution of PROBLEM as a routing guide for detailed routers.

    The format is that of the ISPD 2018 contest: for every net boxes of layers, connected and over
    every pin.
    """
    loaded = problem.read()
    routes = Solution.read(solution, loaded)
    routes.write(out, "guide")
    reached = routes.at_reached_pins()
    open_nets = evaluate(reached.problem, reached).disconnected
    if open_nets:
        click.echo(f"{len(open_nets)} open nets, whose guides are not connected", err=True)
    nets = len(loaded.nets)
    tell(as_json, f"{nets} nets in {out}", out=out, nets=nets, open_nets=list(open_nets))
