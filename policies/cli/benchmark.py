"""``marouting benchmark``: routers scored on the problems of scenarios, and the leaderboard."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import click
from click.core import ParameterSource

from marouting import InputError
from policies.cli.completion import complete_router, keys_of, scenario_names
from policies.cli.options import (
    FILE,
    allow_code_option,
    json_option,
    keep_stdout_for_results,
    overrides_argument,
    print_result,
)

NAME = "{name}"
"""In --name: the name that a row has otherwise."""

BASELINES = Path("configs/benchmark/baselines.yaml")
"""What is scored unless a router is named."""

RULES = BASELINES.with_name("rules.yaml")
"""The same in scenarios of docs/cooperation.md."""

OUT = Path("runs/benchmark")
"""The default of --out where no learner is trained for the scenario."""


@click.command()
@overrides_argument(keys_of("benchmark"))
@click.option(
    "--scenario",
    "requested",
    multiple=True,
    metavar="NAME",
    shell_complete=scenario_names,
    help="Scenario whose problems are routed, module:NAME for one of your own, or `all`; may be "
    "given several times. Without it, --leaderboard is required.",
)
@click.option(
    "--router",
    "routers",
    multiple=True,
    metavar="ROUTER",
    shell_complete=complete_router,
    help="Name of a router or learner, or module:Class, each with options, as in 'astar "
    "best_of=16'; file of a trained policy or run folder of a training; folder of solutions; or "
    "CSV file of published figures. May be given several times.  [default: those of --config]",
)
@click.option(
    "--name",
    help="The router's name in tables. {name} in it stands for the default name; with it, one "
    "--name serves several routers.  [default: derived from --router, or that in --config]",
)
@click.option(
    "--config",
    type=FILE,
    help="YAML file of more routers, by name.  [default: without --router, "
    "configs/benchmark/baselines.yaml, routers that do not learn; in scenarios of "
    "docs/cooperation.md configs/benchmark/rules.yaml, fixed rules]",
)
@click.option(
    "--budget",
    help="What a router may spend on a problem: time such as 1s, or tries and episodes such "
    "as 16.  [default: as each router's options say]",
)
@click.option(
    "--seeds",
    type=int,
    help="Number of seeds of randomised routers.  [default: as --config says, or 3]",
)
@click.option(
    "--training-steps",
    type=int,
    metavar="N",
    help="In a scenario of docs/cooperation.md, how many agent-steps a learner is trained on the "
    "training problems before it plays the split.  [default: as the scenario suggests]",
)
@click.option(
    "--training-seconds",
    type=click.FloatRange(0, min_open=True),
    metavar="S",
    help="Limit of processor time of such a training.  [default: no limit]",
)
@click.option(
    "--split",
    type=click.Choice(["test", "validation"]),
    default="test",
    show_default=True,
    help="Which problems of the scenario.",
)
@click.option(
    "--out",
    type=FILE,
    help="Folder for the result files and the routers' own files.  [default: runs/benchmark, or "
    "runs/benchmark-SCENARIO if a learner is trained for the scenario]",
)
@click.option(
    "--leaderboard",
    type=FILE,
    metavar="PAGE",
    help="Only write the leaderboard to this file, from the result files in --out. Its plots go to "
    "pictures/leaderboard in the same folder. Without it, none is written.",
)
@allow_code_option
@json_option
def benchmark(
    overrides: tuple[str, ...],
    requested: tuple[str, ...],
    routers: tuple[str, ...],
    name: str | None,
    config: Path | None,
    budget: str | None,
    seeds: int | None,
    training_steps: int | None,
    training_seconds: float | None,
    split: str,
    out: Path | None,
    leaderboard: Path | None,
    as_json: bool,
) -> None:
    """Score routers on the problems of a scenario.

    The score is 0 for sequential A* and 1 for the best solution known; docs/scenarios.md explains
    it. In the scenarios of docs/cooperation.md nets decide for themselves, and it is 0 for the best
    local rule; learners are trained once, on the scenario's training problems. Each router gets a
    result file OUT/SCENARIO.NAME.json. A benchmark that was stopped continues when the same command
    is given again. KEY=VALUE changes a key of the file in --config; without --config, it is an
    option of the one --router. jobs=N sets the number of processes (default: one per core), and
    engine=ray distributes the work with Ray.
    """
    if leaderboard is not None:
        _write_leaderboard(overrides, out or OUT, leaderboard, as_json)
        return

    from marouting import scenarios
    from marouting.config import build, check
    from marouting.yaml_files import override
    from policies.cli.progress import problems_bar
    from policies.cli.resolved import check_kind
    from policies.cli.tables import show_benchmark
    from policies.experiment.benchmark import Benchmark, BenchmarkConfig, from_text, load_entries
    from policies.experiment.config import RULE_COST, Budget, Entry, Split
    from policies.experiment.result import read_result, summarise
    from policies.routers.registry import unknown

    keep_stdout_for_results()
    if not requested:
        known = ", ".join(scenarios.names())
        raise InputError(f"--scenario: expected one of {known}, or all")
    if name is not None and NAME not in name and len(routers) != 1:
        raise InputError(f"--name: expected one --router with it, or {NAME} in it")
    given = None if budget is None else Budget.parse(budget)
    # The benchmark's own wherever it stands: an option of the same name is said in --router.
    own = [text for text in overrides if text.startswith(("engine=", "jobs="))]
    overrides = tuple(text for text in overrides if text not in own)
    settings = build(BenchmarkConfig, override({}, own))
    names = [scenarios.load(text).name if ":" in text else text for text in requested]
    for scenario in names:
        if scenario not in (*scenarios.names(), "all"):
            raise unknown("--scenario", scenario, (*scenarios.names(), "all"))
    chosen = scenarios.names() if "all" in names else list(dict.fromkeys(names))
    scored = [one for one in chosen if scenarios.get(one).has_local_rule(cast(Split, split))]
    alone = scored[0] if len(chosen) == 1 and scored else None
    if not routers and config is None:
        config = RULES if scored == chosen else BASELINES
    bounds = {"steps": training_steps, "seconds": training_seconds}
    bounds = {key: most for key, most in bounds.items() if most is not None}
    for key in bounds:
        twice = any(f"train.{key}=" in text for text in (*overrides, *routers))
        check(f"train.{key}", not twice, f"none beside --training-{key}")
    entries: list[Entry] = []
    if config is not None:
        check_kind(config, "benchmark")
        entries, settings = load_entries(config, [*overrides, *own], given, alone)
    elif overrides and len(routers) != 1:
        raise InputError(f"{overrides[0]}: expected --config or one --router with it")
    for text in routers:
        more = "" if config is not None else f" {shlex.join(overrides)}" if overrides else ""
        own_name = None if name is None or NAME in name else name
        entries.append(from_text(f"{text}{more}", own_name, given, alone))
    if name is not None and NAME in name:
        option = f" --name {shlex.quote(name)}"
        entries = [
            replace(e, name=name.replace(NAME, e.name), source=e.source + option) for e in entries
        ]
    trained = any(entry.trains_on for entry in entries)
    if out is None:  # a folder holds one router of a name, and this one is for one scenario
        out = OUT.with_name(f"{OUT.name}-{alone}") if trained else OUT
    for key, most in bounds.items():
        what = f"a learner to train, and one scenario with {RULE_COST}"
        check(f"--training-{key}", trained, what)
        option = f" --training-{key} {most}"
        entries = [replace(e, source=e.source + option * bool(e.trains_on)) for e in entries]
    run = Benchmark(
        chosen,
        entries,
        out,
        split=cast(Split, split),
        seeds=settings.seeds if seeds is None else seeds,
        jobs=settings.jobs,
        engine=settings.engine,
        train={**settings.train, **bounds},
    )
    for scenario in chosen:
        if not scenarios.get(scenario).has_references(cast(Split, split)):
            lacks = "no score and no gap without references; docs/scenarios.md says how to get them"
            click.echo(f"{scenario}: {lacks}", err=True)
    with problems_bar("benchmark") as watch:
        files = run.execute(watch)["files"]
    summaries = [summarise(read_result(path)) for path in files]
    if as_json:
        click.echo(json.dumps({"files": [str(path) for path in files], "rows": summaries}))
    else:
        show_benchmark(summaries)
        for path in files:
            click.echo(path)


def _write_leaderboard(overrides: Sequence[str], folder: Path, page: Path, as_json: bool) -> None:
    """Writes the leaderboard from a folder of result files, and prints what was written."""
    from policies.experiment.leaderboard import write_leaderboard

    context = click.get_current_context()
    free = ("leaderboard", "out", "as_json", "allow_code")
    beside = [
        own.opts[0] if own.opts[0].startswith("-") else " ".join(overrides)
        for own in context.command.params
        if context.get_parameter_source(own.name or "") is ParameterSource.COMMANDLINE
        and own.name not in free
    ]
    if beside:
        raise InputError(f"--leaderboard: expected only --out with it, found {', '.join(beside)}")
    files = write_leaderboard(folder, page)
    print_result(as_json, "\n".join(map(str, files)), files=files)
