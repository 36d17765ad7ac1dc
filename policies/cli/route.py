"""``marouting route``: a problem routed by any router, learner or trained policy."""

import contextlib
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from marouting import InputError, ProblemFile, Solution
from marouting.config import check
from marouting.files import check_apart, check_suffix, check_writable
from marouting.problem.contest import with_pins_covered
from marouting.registry import names
from marouting.yaml_files import override, read_yaml
from policies.cli.completion import complete_router, options_of_the_router
from policies.cli.evaluate import show_figures
from policies.cli.options import (
    FILE,
    TRAINED,
    allow_code_option,
    json_option,
    keep_stdout_for_results,
    overrides_argument,
)
from policies.cli.source import problem_argument
from policies.interrupts import Held
from policies.results.run_folder import policy_file
from policies.routers.base import solve, warm_up
from policies.routers.registry import is_learner, make_router, router_names

if TYPE_CHECKING:
    from policies.learned.router import LearnedRouter
    from policies.routers.base import Router


@click.command()
@problem_argument
@overrides_argument(options_of_the_router)
@click.option(
    "--router",
    metavar="NAME",
    default="astar",
    show_default=True,
    shell_complete=complete_router,
    help=f"Router or learner: {', '.join(router_names())}, module:Class, or a trained policy: "
    "its file or its training's folder.",
)
@click.option(
    "--checkpoint",
    type=TRAINED,
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
    from policies.cli.progress import waiting, working

    keep_stdout_for_results()
    policy = None if router in router_names() else policy_file(Path(router))
    found = policy is not None or not router.endswith(".pt")
    check(f"--router {router}", found, "a file or a folder, found none there")
    if policy is not None:
        check("--checkpoint", checkpoint is None, f"none beside --router {router}")
        with working(f"loading {policy}"):
            from policies.learned.policy import TrainedPolicy  # torch

            checkpoint, router = policy, TrainedPolicy.load(policy, problem.stem).learner
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
    report = {"processor_seconds": round(worked, 2), **report}
    show_figures(router, solution, seconds, as_json, report)
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
    from policies.cli.progress import training_bar, working

    with working("loading the learner"):
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
