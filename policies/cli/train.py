"""``marouting train``: a training in a run folder, and what came of it."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from marouting import InputError
from marouting.config import check, code_named
from marouting.files import exists
from policies.cli.completion import file_or_keys, keys_of
from policies.cli.options import (
    FILE,
    allow_code_option,
    json_option,
    json_text,
    overrides_argument,
    split_config,
)


@click.command()
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
    from policies.cli.progress import training_bar, working
    from policies.cli.resolved import check_kind
    from policies.cli.tables import FEW, show, show_training
    from policies.results.run_folder import CHECKPOINT

    config, overrides = split_config(config, overrides)
    if resume is not None and not exists(resume / "config.yaml"):
        raise InputError(f"--resume {resume}: expected a run folder, with a config.yaml in it")
    if config is not None:
        check_kind(config, "train")
    with working("loading the learner and the problems"):
        from policies.learned.config import load_config
        from policies.learned.run import FALLING, Run

        settings = load_config(config or (resume and resume / "config.yaml"), overrides)
        if resume is not None:
            given = any(text.startswith("out=") for text in overrides)
            moved = given and Path(settings.out).resolve() != resume.resolve()
            check("out", not moved, f"{resume}, where --resume goes on, found {settings.out}")
            settings = replace(settings, out=str(resume))
        run = Run(settings, resume=resume is not None)

    def tell_rows(rows: Sequence[Mapping[str, Any]]) -> None:
        try:
            standing = run.scenario_results()
        except InputError as error:  # rules of its own
            standing = []
            click.echo(f"not scored on {settings.env.scenario}: {error}", err=True)
        if as_json:
            summary = {"out": run.folder, "episodes": run.episodes[0], "rows": rows}
            splits: dict[str, Any] = {r.split: r.as_dict(rows=False) for r in standing}
            if standing:
                summary |= {**asdict(run.figures), "parameters": run.parameters}
            click.echo(json_text({**summary, **splits}))
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
    click.echo(f"learner {settings.learner.name}: {run.trainer.backend}", err=True)
    with training_bar(*run.progress, run.best, run.reference) as watch:
        rows = run.execute(lambda some: watch(some, run.trainer.evaluations, run.progress[0]))
    tell_rows(rows)
