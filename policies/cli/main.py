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
import shlex
import sys
import threading
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

try:
    import click
except ImportError:  # pragma: no cover - the command line needs the extra
    sys.exit("marouting: the command line needs more packages: pip install 'marouting[learn]'")

from marouting import InputError, ProblemFile, Solution, __version__, evaluate
from marouting.config import check, code_named
from marouting.files import (
    check_apart,
    check_suffix,
    check_writable,
    exists,
    naming,
    suffix_of,
)
from marouting.generator import GeneratorOptions
from marouting.problem.contest import contest_cost, with_pins_covered
from marouting.problem.guides import check_guide, read_record
from marouting.problem.ispd import FORMATS, Format
from marouting.problem.solution import ROUTE_FORMATS, RouteFormat
from marouting.registry import importing_from, names
from marouting.yaml_files import override, read_yaml
from policies.cli.benchmark import benchmark
from policies.cli.completion import file_or_keys, keys_of, options_of_the_router, routers
from policies.cli.options import (
    FILE,
    allow_code_option,
    as_text,
    file_apart,
    json_option,
    options_of,
    overrides_argument,
    results_alone,
    tell,
)
from policies.cli.source import problem_argument
from policies.cli.view import view
from policies.interrupts import Held, interruptible
from policies.results.run_folder import policy_file
from policies.routers.base import LEFT_ALONE, solve, warm_up
from policies.routers.registry import is_learner, make_router, router_names, unknown

if TYPE_CHECKING:
    from policies.learned.router import LearnedRouter
    from policies.routers.base import Router

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
@options_of(GeneratorOptions, but=("least", "reduced_capacity", "reduced_per"))
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
    tell(as_json, f"{count} in {out}", out=out, count=checked.count, files=files)


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
    size, nets = list(loaded.grid), len(loaded.nets)
    if solution is None:
        loaded.write(out, cast(Format, format or "ispd2008"))
        if lost := ", ".join(loaded.beyond_text):
            click.echo(f"{out}: ISPD text does not hold: {lost}", err=True)
        tell(as_json, f"{loaded.topology}, {nets} nets in {out}", out=out, grid=size, nets=nets)
        return
    routes = Solution.read(solution, loaded)
    routes.write(out, cast(RouteFormat | None, format))
    open_nets = list(evaluate(loaded, routes).disconnected)
    if open_nets:
        click.echo(f"{len(open_nets)} open nets, whose routes are not connected", err=True)
    text = f"{nets} nets in {out}"
    tell(as_json, text, out=out, grid=size, nets=nets, open_nets=open_nets)


@cli.command()
@problem_argument
@overrides_argument(options_of_the_router)
@click.option(
    "--router",
    metavar="NAME",
    default="astar",
    show_default=True,
    shell_complete=routers,
    help=f"Router or learner: {', '.join(router_names())}, module:Class, or a trained policy: "
    "its file or its training's folder.",
)
@click.option(
    "--checkpoint",
    type=FILE,
    help="Trained policy, its file or its training's folder; without it, a learner is trained on "
    "the problem.",
)
@click.option(
    "--config",
    type=FILE,
    help="YAML file of the router's options, or of a learner's training; without it, the defaults.",
)
@click.option(
    "--prune",
    is_flag=True,
    help="Remove dead ends and loops before the solution is evaluated and written.",
)
@click.option(
    "--out",
    type=FILE,
    help="File for the solution; without it, none is written. In a long search, the best solution "
    "so far is written every five minutes.",
)
@allow_code_option
@json_option
def route(
    problem: ProblemFile,
    overrides: tuple[str, ...],
    router: str,
    checkpoint: Path | None,
    config: Path | None,
    prune: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Route PROBLEM and evaluate the solution.

    KEY=VALUE changes an option of the router, such as net_order=file, seed=1, or time_limit=60
    (seconds) for optimal. A learner uses the policy of --checkpoint; without one it is trained on
    the problem, as in the paper, and its options are the keys of a training's configuration, such
    as train.episodes=200. Overflow and wirelength are given with and without (pruned) dead ends
    and loops, which --prune removes. The seconds, of wall time and of processor time, exclude
    compiling, loading and files.
    """
    from policies.cli.progress import waiting

    results_alone()
    policy = None if router in router_names() else policy_file(Path(router))
    if policy is not None:
        from policies.learned.policy import TrainedPolicy  # torch

        check("--checkpoint", checkpoint is None, f"none beside --router {router}")
        checkpoint, router = policy, TrainedPolicy.load(policy, problem.stem).learner
    elif checkpoint is not None:
        checkpoint = policy_file(checkpoint) or checkpoint
    learner = is_learner(router, "--router")
    if checkpoint and not learner:
        expected = " or ".join(names("learner"))
        raise InputError(f"--checkpoint: expected --router {expected}")
    if checkpoint and (config or overrides):
        raise InputError("--checkpoint: expected no configuration with it: nothing is trained")
    if out is not None:
        check_suffix(out)
        check_apart(out, *problem.files, *(file for file in (checkpoint, config) if file))
    loaded = problem.read()
    if out is not None:
        check_writable(out)
    held = Held()
    with contextlib.ExitStack() as stack:
        if learner:
            learned = _learned(router, checkpoint, problem.stem, config, overrides, stack)
            solver: Router = learned
            if checkpoint is None and max(map(len, loaded.pin_gcells), default=0) > 1:
                click.echo(
                    f"{router}: no --checkpoint, so it is trained on this problem as in the paper: "
                    f"{learned.config.train.episodes} episodes (train.episodes=N)",
                    err=True,
                )
        else:
            options = override({} if config is None else read_yaml(config), overrides)
            where = f"--router {router}" if config is None else str(config)
            solver = make_router(router, options, where)
            what = (
                f"one with a method route, found {router}, which plays scenarios of policies only"
            )
            check("--router", hasattr(solver, "route"), what)
            save = None if out is None else lambda best: _finished(best, prune).write(out)
            held = stack.enter_context(waiting(router, solver, save))
        warm_up(solver)
        started, worked = time.perf_counter(), _processor_seconds()
        solution, report = solve(solver, loaded)
        solution = _finished(solution, prune)
        seconds, worked = time.perf_counter() - started, _processor_seconds() - worked
    if out is not None:
        solution.write(out)
    _report(router, solution, seconds, as_json, {"processor_seconds": round(worked, 2), **report})
    held.leave()


def _processor_seconds() -> float:
    """Processor time so far, of all threads and of processes that have ended."""
    return sum(os.times()[:4])


def _finished(solution: Solution, prune: bool) -> Solution:
    """A router's solution as it is written."""
    solution = solution.pruned() if prune else solution
    chip = solution.problem.chip
    return solution if chip is None or chip.contest is None else with_pins_covered(solution)


_NOT_ROUTED = {
    **dict.fromkeys(("env.problem", "env.scenario", "env.split"), "PROBLEM is routed"),
    **dict.fromkeys(
        ("out", "train.checkpoint_seconds", "train.evaluate_every", "train.figures", "train.policy",
         "train.reference", "train.tensorboard", "train.wandb"),
        "nothing but --out is written",
    ),
}  # fmt: skip
"""Keys of a training that have no effect on one for a problem that is routed."""


def _learned(
    learner: str,
    checkpoint: Path | None,
    problem: str,
    config: Path | None,
    overrides: Sequence[str],
    stack: contextlib.ExitStack,
) -> "LearnedRouter":
    """A learner as a router, with a progress bar for its training until the stack is closed."""
    from policies.cli.progress import training_bar
    from policies.learned.config import load_config
    from policies.learned.router import LearnedRouter

    for key in (text.partition("=")[0] for text in overrides):
        for part, reason in _NOT_ROUTED.items():
            check(key, not f"{key}.".startswith(f"{part}."), f"no such key: {reason}")
    settings = load_config(config, overrides, learner)
    watch = None
    if checkpoint is None:
        watch = stack.enter_context(training_bar(0, settings.train.episodes))
    router = LearnedRouter(settings, checkpoint, watch, network=problem)
    if router.policy is not None:
        kind = router.policy.learner
        check("--router", kind == learner, f"{kind}, as in {checkpoint}, found {learner}")
    return router


def _report(
    router: str | None,
    solution: Solution,
    seconds: float,
    as_json: bool,
    report: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Prints the figures of a solution, and those that its router adds."""
    from policies.results.rows import solution_row

    fields = {"router": router, **solution_row(solution, seconds), **report}
    del fields["open_nets"]  # their names follow
    disconnected = evaluate(solution.problem, solution).disconnected
    chip = solution.problem.chip
    if chip is not None and chip.contest is not None:
        cost = asdict(contest_cost(solution))
        disconnected = cost.pop("open")
        fields |= {f"ispd2024_{name}": value for name, value in cost.items()}
    if as_json:
        click.echo(as_text({**fields, "open_nets": disconnected}))
        return
    width = max(map(len, fields))
    for name, value in fields.items():
        if value is not None:
            click.echo(f"{name:>{width}}  {value}")
    if disconnected:
        shown = " ".join(disconnected[:10])
        more = len(disconnected) - 10
        click.echo(f"{'open nets':>{width}}  {shown}{f' and {more} more' if more > 0 else ''}")


@cli.command("evaluate")
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
    if in_detail:
        from policies.cli.tables import show_report
        from policies.results.report import report

        found = report(routes)
        click.echo(json.dumps(found)) if as_json else show_report(found, str(solution))
        return
    started = time.perf_counter()
    evaluate(routes.problem, routes)
    seconds = time.perf_counter() - started
    is_guide = suffix_of(solution) == ".guide"
    checked = check_guide(record, loaded) if is_guide else None
    if is_guide and checked is None:
        click.echo(f"{solution}: no boxes, so it is not checked as a guide", err=True)
    of_guide = {} if checked is None else {f"guide_{k}": v for k, v in asdict(checked).items()}
    _report(None, routes, seconds, as_json, of_guide)


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

    config, overrides = file_apart(config, overrides)
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
@click.argument("config", type=FILE, required=False, shell_complete=file_or_keys)
@overrides_argument(keys_of("train"))
@click.option(
    "--resume",
    type=FILE,
    help="Run folder of a training to continue; CONFIG may be left out.  "
    "[default: a new training, in the folder `out`]",
)
@allow_code_option
@json_option
def train(
    config: Path | None, overrides: tuple[str, ...], resume: Path | None, as_json: bool
) -> None:
    """Train a learner on the problems of CONFIG, a YAML file.

    Without CONFIG every key has its default. KEY=VALUE changes a key, such as train.episodes=200
    or learner.kind=ppo; the kinds are dqn, ppo, iql, ippo, mappo, imitation and module:Class, and
    each has its own defaults. env.scenario=toy-4x4-v0 trains one network on problems drawn from
    the scenario's training split, and evaluates it on the validation problems. Everything is
    written to the run folder, the key `out`. --resume DIR goes on with a run that was stopped;
    with a larger train.episodes (or train.steps, train.seconds) also with one that is finished.
    """
    from policies.cli.progress import training_bar
    from policies.cli.resolved import check_kind
    from policies.cli.tables import FEW, show, show_training
    from policies.learned.config import load_config
    from policies.learned.run import FALLING, Run
    from policies.results.run_folder import CHECKPOINT

    config, overrides = file_apart(config, overrides)
    if resume is not None and not exists(resume / "config.yaml"):
        raise InputError(f"--resume {resume}: expected a run folder, with a config.yaml in it")
    if config is not None:
        check_kind(config, "train")
    settings = load_config(config or (resume and resume / "config.yaml"), overrides)
    if resume is not None:
        settings = replace(settings, out=str(resume))
    run = Run(settings, resume=resume is not None)

    def tell_rows(rows: Sequence[Mapping[str, Any]]) -> None:
        try:
            standing = run.standing()
        except InputError as error:  # rules of its own
            standing = []
            click.echo(f"not scored on {settings.env.scenario}: {error}", err=True)
        if as_json:
            told = {"out": run.folder, "episodes": run.episodes[0], "rows": rows}
            splits: dict[str, Any] = {r.split: r.as_dict(rows=False) for r in standing}
            if standing:
                told |= {**asdict(run.figures), "parameters": run.parameters}
            click.echo(as_text({**told, **splits}))
            return
        if len(run.problems) > FEW:
            show_training(run, rows)
        else:
            show(rows, str(run.folder))
        for result in standing:
            click.echo(result)
        if standing:
            folder = shlex.quote(str(run.folder))
            command = f"marouting benchmark --scenario {settings.env.scenario} --router {folder}"
            code = " --allow-code" if any(code_named(settings)) else ""
            click.echo(f"next: {command}{code}")
        if not run.updates:
            click.echo("nothing was learned: the training ended before its first update", err=True)

    if run.finished is not None:
        more = f"train.{run.length}=N adds {run.length}"
        click.echo(f"{resume}: already finished; {more}", err=True)
        tell_rows(run.finished)
        return
    if resume is not None and not (resume / CHECKPOINT).exists():
        click.echo(f"{resume}: no checkpoint yet, so the training starts again", err=True)
    options = settings.learner.options
    set_to = ((key, getattr(options, key, None)) for key in FALLING)
    falls = [key for key, value in set_to if value is not None and value is not False]
    for name, had in run.had.items():
        now = getattr(settings.train, name)
        longer = f"; learner.{falls[0]} now refers to the longer training" if falls else ""
        click.echo(f"{resume}: train.{name} was {had}, now {now}{longer}", err=True)
    click.echo(f"learner {settings.learner.name}: {run.trainer.path}", err=True)
    with training_bar(*run.progress, run.best, run.reference) as watch:
        rows = run.execute(lambda some: watch(some, run.trainer.walks, run.progress[0]))
    tell_rows(rows)


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

    results_alone()
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
    from policies.figures.plot import plot as draw

    if as_json:
        click.echo(as_text({"files": list(draw(paths, out))}))
        return
    for path in draw(paths, out):
        click.echo(path)


cli.add_command(view)


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


cli.add_command(benchmark)


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
