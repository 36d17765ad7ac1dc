"""The command line: ``marouting COMMAND``.

Results go to standard output, progress and messages to standard error. The exit status is 0 when
done, 2 for input that cannot be used (one line says which file, line or key, and what was
expected), 130 when interrupted. The heavy libraries are imported by the commands that need them.
"""

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, get_args

try:
    import click
except ImportError:  # pragma: no cover - the command line needs the extra
    sys.exit("marouting: the command line needs more packages: pip install 'marouting[learn]'")

from marouting import InputError, Problem, Solution, __version__, evaluate
from marouting.files import check_writable, write_text
from marouting.generator import ReducedPer
from marouting.problem.ispd import FORMATS, Format
from policies.routers.base import solve
from policies.routers.registry import ROUTERS, has_seed, make_router

if TYPE_CHECKING:
    from policies.learned.config import Config
    from policies.learned.trainer import Episode
    from policies.routers.base import Router

GridShape = click.Tuple([int, int, int])


@click.group(no_args_is_help=False, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="marouting")
def cli() -> None:
    """Multi-agent global routing: every net is an agent on one shared capacity grid."""


@cli.command()
@click.option("--count", default=1, show_default=True, help="Number of problems.")
@click.option(
    "--grid", type=GridShape, default=(8, 8, 2), show_default=True, help="Columns, rows, layers."
)
@click.option("--nets", default=50, show_default=True, help="Nets a problem.")
@click.option("--max-pins", default=2, show_default=True, help="Pins a net, at most.")
@click.option("--capacity", default=5, show_default=True, help="Capacity of an edge.")
@click.option(
    "--reduced-edges", default=3, show_default=True, help="How many of the busiest edges to reduce."
)
@click.option(
    "--reduced-capacity", type=int, help="Their capacity.  [default: two less than --capacity]"
)
@click.option(
    "--reduced-per",
    type=click.Choice(get_args(ReducedPer)),
    default="problem",
    show_default=True,
    help="Whose A* solutions tell which are the busiest: each problem's own, or the set's.",
)
@click.option("--seed", default=0, show_default=True, help="Where the random numbers start.")
@click.option("--out", type=Path, required=True, help="Folder for the .gr files.")
def generate(out: Path, **options: Any) -> None:
    """Generate problems: OUT/problem_000.gr and so on."""
    from marouting.generator import GeneratorOptions
    from marouting.source import load_problems

    problems = load_problems(GeneratorOptions(**options))
    for name, problem in problems.items():
        problem.write(out / f"{name}.gr")
    click.echo(f"{len(problems)} problems in {out}")


@cli.command()
@click.argument("problem", type=Path)
@click.argument("out", type=Path)
@click.option("--format", type=click.Choice(FORMATS), default="ispd2008", show_default=True)
def convert(problem: Path, out: Path, format: Format) -> None:
    """Write a problem to OUT in another format.

    The format of PROBLEM is told by its header. OUT is read as the same problem; a format that
    cannot hold it is refused.
    """
    loaded = Problem.read(problem)
    loaded.write(out, format)
    columns, rows, layers = loaded.grid
    click.echo(f"{columns}x{rows}x{layers}, {len(loaded.nets)} nets in {out}")


@cli.command()
@click.argument("problem", type=Path)
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--router", type=click.Choice(ROUTERS), default="astar", show_default=True)
@click.option("--checkpoint", type=Path, help="A trained policy for the router dqn.")
@click.option(
    "--config", type=Path, help="A file of the router's options; for dqn, of what it trains."
)
@click.option(
    "--seed", type=int, help="Where random numbers start.  [default: 0, or as in --config]"
)
@click.option("--out", type=Path, help="File for the solution.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def route(
    problem: Path,
    overrides: tuple[str, ...],
    router: str,
    checkpoint: Path | None,
    config: Path | None,
    seed: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Route a problem and judge the solution.

    KEY=VALUE changes options of the router (net_order=file; for optimal on a large
    problem bound=relaxation time_limit=60). Without --checkpoint the router dqn trains on the
    problem, as the paper does; its options are the keys of its configuration (train.episodes=200).
    """
    if router != "dqn" and checkpoint:
        raise InputError("--checkpoint: expected --router dqn with it")
    if checkpoint and (config or overrides):
        raise InputError("--checkpoint: expected no configuration with it: nothing is trained")
    loaded = Problem.read(problem)
    if out is not None:
        check_writable(out)
    solver = _router(router, seed, checkpoint, problem.stem, config, overrides)
    started = time.perf_counter()
    solution, report = solve(solver, loaded)
    seconds = time.perf_counter() - started
    if out is not None:
        solution.write(out)
    _report(router, loaded, solution, seconds, as_json, report)


def _router(
    name: str,
    seed: int | None,
    checkpoint: Path | None,
    problem: str,
    config: Path | None,
    overrides: Sequence[str],
) -> "Router":
    from marouting.config import override, read_yaml
    from policies.learned.config import load_config

    given = [] if seed is None or not has_seed(name) else [f"seed={seed}"]
    if name != "dqn":
        options = {} if config is None else read_yaml(config)
        where = f"--router {name}" if config is None else str(config)
        return make_router(name, override(options, [*given, *overrides]), where)
    from policies.learned.router import DQNRouter

    settings = load_config(config, [*given, *overrides])
    return DQNRouter(settings, checkpoint, _counter(settings), network=problem)


def _counter(config: "Config") -> Any:
    """What shows the progress of a training without a run folder, on standard error."""
    from rich.console import Console
    from rich.progress import Progress

    if not sys.stderr.isatty():
        return None
    progress = Progress(console=Console(stderr=True), transient=True)
    task = progress.add_task("training", total=config.train.episodes)
    progress.start()

    def watch(episodes: "list[Episode]") -> None:
        progress.update(task, advance=len(episodes))
        if episodes[-1].episode + 1 == config.train.episodes:
            progress.stop()

    return watch


def _report(
    router: str | None,
    problem: Problem,
    solution: Solution,
    seconds: float,
    as_json: bool,
    report: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Prints the figures of a solution, and those that its router adds."""
    figures = evaluate(problem, solution)
    fields = {
        "router": router,
        "overflow": figures.overflow,
        "max_overflow": figures.max_overflow,
        "wirelength": figures.wirelength,
        "vias": figures.vias,
        "connected": figures.connected,
        "joined": figures.joined,
        "tasks": figures.tasks,
        "seconds": round(seconds, 6),
        **report,
    }
    if as_json:
        click.echo(json.dumps(fields))
        return
    width = max(map(len, fields))
    for name, value in fields.items():
        if value is not None:
            click.echo(f"{name:>{width}}  {value}")
    if figures.disconnected:
        shown = " ".join(figures.disconnected[:10])
        more = len(figures.disconnected) - 10
        click.echo(f"{'open nets':>{width}}  {shown}{f' and {more} more' if more > 0 else ''}")


@cli.command("evaluate")
@click.argument("problem", type=Path)
@click.argument("solution", type=Path)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def evaluate_command(problem: Path, solution: Path, as_json: bool) -> None:
    """Judge a solution file by the rules of the ISPD 2008 evaluator."""
    loaded = Problem.read(problem)
    routes = Solution.read(solution, loaded)
    started = time.perf_counter()
    evaluate(loaded, routes)
    _report(None, loaded, routes, time.perf_counter() - started, as_json)


@cli.command()
@click.argument("config", type=Path)
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--resume", type=Path, help="Go on with the run in this folder.")
def train(config: Path, overrides: tuple[str, ...], resume: Path | None) -> None:
    """Train a DQN on every problem of CONFIG; KEY=VALUE changes keys of it.

    Everything goes into the run folder, the key `out`.
    """
    from policies.cli.tables import show
    from policies.learned.config import load_config
    from policies.learned.run import Run

    if resume is not None and not (resume / "config.yaml").exists():
        raise InputError(f"--resume {resume}: expected a run folder, with a config.yaml in it")
    settings = load_config(config, overrides)
    if resume is not None:
        settings = replace(settings, out=str(resume))
    run = Run(settings, resume=resume is not None)
    show(run.execute(), str(run.folder))


@cli.command()
@click.argument("config", type=Path)
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
def experiment(config: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Compare routers on sets of problems, as CONFIG says; KEY=VALUE changes keys of it.

    Everything goes into the folder of the experiment, the key `out`. One that was stopped, or
    killed, goes on when the same command is given again.
    """
    from policies.cli.tables import show_experiment
    from policies.experiment import Experiment, load_experiment

    summary = Experiment(load_experiment(config, overrides)).execute()
    if as_json:
        click.echo(json.dumps(summary))
    else:
        show_experiment(summary)


@cli.command()
@click.argument("paths", nargs=-1, required=True, type=Path, metavar="RUN_OR_FILE...")
@click.option("--out", type=Path, help="Folder for the figures.")
def plot(paths: tuple[Path, ...], out: Path | None) -> None:
    """Draw the figures of runs, experiments, metrics.jsonl, bench files, or .gr and solution files.

    A .gr file is drawn with the solution files that follow it, or with sequential A*'s solution.
    """
    from policies.figures.plot import plot as draw

    for path in draw(paths, out):
        click.echo(path)


@cli.command()
@click.argument("sections", nargs=-1, metavar="[SECTION]...")
@click.option("--repeats", default=7, show_default=True, help="Of every measurement.")
@click.option("--threads", default=2, show_default=True, help="Where several threads work.")
@click.option("--against", type=click.Choice(["jumanji"]), help="Another library to compare with.")
@click.option("--out", type=Path, help="File for the figures, JSON.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def bench(
    sections: tuple[str, ...],
    repeats: int,
    threads: int,
    against: str | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Measure speed, as ratios to comparators that run in turns with it.

    Without SECTION everything is measured, which takes several minutes.
    """
    from policies.bench import SECTIONS, Bench, Measurement, run
    from policies.cli.tables import number, show_speed

    if out is not None:
        check_writable(out)
    chosen = list(sections or (name for name in SECTIONS if name != "jumanji"))
    if against is not None and against not in chosen:
        chosen.append(against)

    def watch(section: str, row: Measurement | None) -> None:
        if row is None:
            click.echo(f"{section} ...", err=True)
        else:
            click.echo(f"  {row.name}: {number(row.value)} {row.unit}", err=True)

    report = run(chosen, Bench(repeats, threads), watch)
    if out is not None:
        write_text(out, json.dumps(report, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(report))
    else:
        show_speed(report)


@cli.command()
@click.option(
    "--out", type=Path, default=Path("quickstart"), show_default=True, help="Folder for the result."
)
def quickstart(out: Path) -> None:
    """Route, train and draw a small problem in about a minute."""
    from policies.cli.quickstart import run

    run(out)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line and exits with its status."""
    sys.exit(status(arguments))


def status(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; returns the exit status."""
    try:
        cli.main(args=arguments, prog_name="marouting", standalone_mode=False)
    except InputError as error:
        return _complain(str(error))
    except click.ClickException as error:
        return _complain(error.format_message())
    except ModuleNotFoundError as error:
        return _complain(f"{error.name} is missing: pip install 'marouting[learn]'")
    except MemoryError as error:
        return _complain(f"expected a smaller problem or configuration: out of memory: {error}")
    except OSError as error:
        return _complain(f"{error.filename or 'input or output'}: {error.strerror or error}")
    except (KeyboardInterrupt, click.Abort):
        click.echo("marouting: interrupted", err=True)
        return 130
    return 0


def _complain(message: str) -> int:
    """One line on standard error; returns the status for bad input."""
    click.echo(f"marouting: {' '.join(message.split())}", err=True)
    return 2


if __name__ == "__main__":
    main()
