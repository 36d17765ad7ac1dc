"""The command line: ``marouting COMMAND``.

Results go to standard output, progress and messages to standard error. The exit status is 0 when
a command is done, 2 for input that cannot be used (one line names the file, line or key and says
what was expected), and 130 for an interrupt. Heavy libraries are imported by the commands that need
them.
"""

import contextlib
import io
import json
import os
import sys
import threading
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

try:
    import click
except ImportError:  # pragma: no cover - the command line needs the extra
    sys.exit("marouting: the command line needs more packages: pip install 'marouting[learn]'")

from marouting import InputError, ProblemFile, Solution, __version__, evaluate
from marouting.files import check_apart, naming
from marouting.generator import GeneratorOptions
from marouting.problem.ispd import FORMATS, Format
from marouting.problem.solution import ROUTE_FORMATS, RouteFormat
from marouting.registry import importing_from
from policies.cli.benchmark import benchmark
from policies.cli.completion import file_or_keys, keys_of
from policies.cli.evaluate import evaluate_command
from policies.cli.options import (
    FILE,
    allow_code_option,
    json_option,
    keep_stdout_for_results,
    options_of,
    overrides_argument,
    print_result,
    split_config,
)
from policies.cli.route import route
from policies.cli.source import problem_argument
from policies.cli.train import train
from policies.cli.view import view
from policies.interrupts import interruptible
from policies.routers.base import LEFT_ALONE
from policies.routers.registry import unknown

_RENAMED = {
    "animate": "view … --out FILE.svg",
    "guide": "convert PROBLEM FILE.guide --solution SOLUTION",
    "report": "evaluate --report",
    "bench": "python -m policies.bench",
}
"""Commands removed in version 0.3, and their replacements."""

_RENAMED_OPTIONS = {
    "benchmark --jobs": "jobs=N",
    "benchmark --page": "--leaderboard PAGE",
    "benchmark --results": "--out FOLDER",
    "config --show": "marouting config FILE",
    "route --seed": "seed=N",
    "view --fps": "--frames N: an animation takes about 12 seconds",
    "view --router": "marouting route PROBLEM --router NAME --out FILE, and view of that file",
}
"""Options removed in version 0.3, and their replacements."""

_EXTRAS = {
    **dict.fromkeys(("stable_baselines3", "sb3_contrib"), "sb3"),
    **dict.fromkeys(("torchrl", "tensordict"), "torchrl"),
    "benchmarl": "benchmarl",
    "ray": "rllib",
    **dict.fromkeys(("PIL", "filelock", "matplotlib", "rich", "supersuit"), "learn"),
    **dict.fromkeys(("scipy", "tensorboard", "torch"), "learn"),
}
"""The extra that brings a package which commands and integrations import."""


class _Commands(click.Group):
    """The commands; an unknown name is an error that lists them."""

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command of a name."""
        found = super().get_command(ctx, name)
        if found is None and not ctx.resilient_parsing:
            if name in _RENAMED:
                new = _RENAMED[name]
                whole = new if new.startswith("python") else f"marouting {new}"
                raise InputError(f"marouting {name}: it is now {whole}")
            raise unknown("command", name, tuple(self.list_commands(ctx)))
        return found


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="marouting")
@click.pass_context
def cli(context: click.Context) -> None:
    """Multi-agent global routing: every net is an agent on one shared capacity grid.

    Each command explains its options: marouting COMMAND --help.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@cli.command()
@options_of(GeneratorOptions, without=("least", "reduced_capacity", "reduced_per"))
@click.option("--out", type=FILE, required=True, help="Folder for the .gr files.")
@json_option
def generate(out: Path, as_json: bool, **options: Any) -> None:
    """Generate random problems: OUT/problem_000.gr and so on.

    Files of these names in OUT are overwritten. OUT must hold no other problems, so that two sets
    are never mixed.
    """
    from marouting.generator import generate_each
    from marouting.source import generated_name
    from policies.cli.progress import problems_bar
    from policies.results.folder import working_in

    checked = GeneratorOptions(**options)
    with naming(out, "cannot be read"):
        held = sorted(out.glob("*.gr"))
    for path in held:
        digits = path.stem.removeprefix("problem_")
        number = int(digits) if digits.isdecimal() else checked.count
        if number >= checked.count or generated_name(number) != path.stem:
            raise InputError(f"{out}: expected no other problems, found {path.name}")
    problems = generate_each(checked)
    files = [out / f"{generated_name(number)}.gr" for number in range(checked.count)]
    with working_in(out), problems_bar(str(out)) as watch:
        for number, problem in enumerate(problems):
            problem.write(files[number])
            watch(number + 1, checked.count)
    count = f"{checked.count} problem{'s' if checked.count > 1 else ''}"
    print_result(as_json, f"{count} in {out}", out=out, count=checked.count, files=files)


@cli.command()
@problem_argument
@click.argument("out", type=FILE)
@click.option(
    "--format",
    type=click.Choice((*FORMATS, *(f for f in ROUTE_FORMATS if f not in FORMATS))),
    help="Format of OUT.  [default: ispd2008; with --solution, by the suffix of OUT]",
)
@click.option("--solution", type=FILE, help="Solution to write; without it, PROBLEM is written.")
@json_option
def convert(
    problem: ProblemFile, out: Path, format: str | None, solution: Path | None, as_json: bool
) -> None:
    """Write PROBLEM, or a solution of it, to OUT in another format.

    PROBLEM is a LEF/DEF design (.def), a problem of the ISPD 2024 or 2025 contest (.cap), or ISPD
    text, whose header tells the format. Solutions are ISPD text (ispd2008), a routing guide
    (.guide; --format patched-guide gives more room around pins and at crowded places) or ISPD
    2024's output (.PR_output); OpenROAD's route segments are read as well. Any of
    them may be compressed (.gz). Routes that a format cannot hold are an error. A note on
    standard error says what is lost of a chip's files in ISPD text.
    """
    known: Sequence[str] = FORMATS if solution is None else ROUTE_FORMATS
    if format is not None and format not in known:
        what = "a problem" if solution is None else "--solution"
        raise InputError(f"--format: expected {', '.join(known)} for {what}, found {format}")
    check_apart(out, *problem.files, *([] if solution is None else [solution]))
    loaded = problem.read()
    size, nets = list(loaded.grid), len((loaded.kept.whole if loaded.kept else loaded).nets)
    if solution is None:
        loaded.write(out, cast(Format, format or "ispd2008"))
        if lost := ", ".join(loaded.beyond_text):
            click.echo(f"{out}: ISPD text does not hold: {lost}", err=True)
        print_result(
            as_json, f"{loaded.topology}, {nets} nets in {out}", out=out, grid=size, nets=nets
        )
        return
    routes = Solution.read(solution, loaded)
    routes.write(out, cast(RouteFormat | None, format))
    open_nets = list(evaluate(loaded, routes).disconnected)
    if open_nets:
        click.echo(f"{len(open_nets)} open nets, whose routes are not connected", err=True)
    text = f"{nets} nets in {out}"
    print_result(as_json, text, out=out, grid=size, nets=nets, open_nets=open_nets)


@cli.command("config")
@click.argument("config", type=FILE, required=False, shell_complete=file_or_keys)
@overrides_argument(keys_of("train"))
@click.option(
    "--schema",
    type=click.Choice(["train", "experiment", "benchmark"]),
    help="Print the JSON schema of a command's configurations instead, for editors.  "
    "[default: none]",
)
@allow_code_option
@json_option
def config_command(
    config: Path | None, overrides: tuple[str, ...], schema: str | None, as_json: bool
) -> None:
    """Show all values of a configuration, and where each comes from.

    CONFIG is the YAML file of a training, an experiment or a benchmark; without it, the defaults of
    a training are shown. Keys that it leaves out have their defaults. KEY=VALUE changes a key:
    "marouting config learner.kind=ppo".
    """
    from policies.cli.resolved import resolve, schema_of, text_of

    config, overrides = split_config(config, overrides)
    if schema is not None:
        if config is not None or overrides:
            raise InputError("--schema: expected no configuration beside it")
        click.echo(json.dumps(schema_of(schema), indent=None if as_json else 1))
        return
    whole, origins = resolve(config, overrides)
    if as_json:
        by_key = {".".join(keys): origin for keys, origin in origins.items()}
        click.echo(json.dumps({"config": whole, "origins": by_key}))
    else:
        click.echo(text_of(whole, origins), nl=False)


@cli.command()
@click.argument("config", type=FILE)
@overrides_argument(keys_of("experiment"))
@allow_code_option
@json_option
def experiment(config: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Compare routers on sets of problems, as the YAML file CONFIG says.

    KEY=VALUE changes a key of CONFIG, such as seeds=[0,1,2]. Everything is written to the folder
    that the key `out` names. An experiment that was stopped continues when the same command is
    given again.
    """
    from policies.cli.progress import problems_bar
    from policies.cli.resolved import check_kind
    from policies.cli.tables import show_experiment
    from policies.experiment import Experiment, load_experiment

    keep_stdout_for_results()
    check_kind(config, "experiment")
    task = Experiment(load_experiment(config, overrides))
    with problems_bar(str(task.folder)) as watch:
        summary = task.execute(watch)
    if as_json:
        click.echo(json.dumps(summary))
    else:
        show_experiment(summary)


@cli.command()
@click.argument("paths", nargs=-1, required=True, type=FILE, metavar="RUN_OR_FILE...")
@click.option(
    "--out",
    type=FILE,
    help="Folder for the figures.  [default: `figures`, inside a folder or beside a file]",
)
@json_option
def plot(paths: tuple[Path, ...], out: Path | None, as_json: bool) -> None:
    """Draw figures of runs, experiments and files.

    Draws run folders, experiment folders, metrics.jsonl files, and problems, each with the solution
    files that follow it, or with sequential A*'s solution if none follows. Prints the paths of the
    pictures.
    """
    from policies.cli.progress import working

    with working("drawing"):
        from policies.figures.plot import plot as draw

        drawn = list(draw(paths, out))
    print_result(as_json, "\n".join(map(str, drawn)), files=drawn)


@cli.command()
@click.option(
    "--out",
    type=FILE,
    default=Path("quickstart"),
    show_default=True,
    help="Folder for the results.",
)
@json_option
def quickstart(out: Path, as_json: bool) -> None:
    """Route a small problem, train on it and draw it, in about a minute."""
    from policies.cli.quickstart import run

    run(out, as_json)


for command in (benchmark, evaluate_command, route, train, view):
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line and exits with its status."""
    for stream in (sys.stdout, sys.stderr):
        # Not every terminal has the characters of every name, and a path need not be UTF-8. A
        # question mark is as wide as what it stands for, so tables stay in order.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    warnings.showwarning = _warn
    code = status(arguments)
    if any(thread.name == LEFT_ALONE for thread in threading.enumerate()):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    sys.exit(code)


def status(
    arguments: Sequence[str] | None = None, command: click.Command = cli, name: str = "marouting"
) -> int:
    """Runs a command, by default the whole command line; returns the exit status."""
    try:
        # module:Class is looked up in the current folder, wherever the command is installed.
        with interruptible(), importing_from(Path.cwd()):
            command.main(args=arguments, prog_name=name, standalone_mode=False)
    except InputError as error:
        return _complain(str(error))
    except click.NoSuchOption as error:
        asked = f"{error.ctx.info_name if error.ctx else ''} {error.option_name}"
        new = _RENAMED_OPTIONS.get(asked)
        return _complain(f"{asked}: it is now {new}" if new else error.format_message())
    except click.ClickException as error:
        return _complain(error.format_message())
    except ModuleNotFoundError as error:
        extra = _EXTRAS.get(str(error.name).partition(".")[0])
        hint = f": pip install 'marouting[{extra}]'" if extra else ""
        return _complain(f"{error.name} is missing{hint}")
    except UnicodeEncodeError as error:  # of a path; all that is printed can be
        return _complain(f"{error.object[:200]}: expected a path in the encoding {error.encoding}")
    except MemoryError as error:
        return _complain(f"expected a smaller problem or configuration: out of memory: {error}")
    except OSError as error:
        return _complain(f"{error.filename or 'input or output'}: {error.strerror or error}")
    except (KeyboardInterrupt, click.Abort):
        click.echo("marouting: interrupted", err=True)
        return 130
    return 0


def _warn(message: Warning | str, category: type[Warning], *where: Any, **others: Any) -> None:
    """A warning of ours as a line; those of libraries as Python shows them."""
    if category is UserWarning:
        click.echo(f"marouting: warning: {InputError(' '.join(str(message).split()))}", err=True)
    else:
        _show(message, category, *where, **others)


_show = warnings.showwarning


def _complain(message: str) -> int:
    """Prints one line, without control characters, on standard error; returns the status."""
    click.echo(f"marouting: {InputError(' '.join(message.split()))}", err=True)
    return 2


if __name__ == "__main__":
    main()
