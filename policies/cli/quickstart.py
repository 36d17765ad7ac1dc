"""The main job in about a minute: generate, route, train with one agent and with many, draw."""

import time
from pathlib import Path
from typing import get_args

import click

from marouting import InputError, Problem, Solution
from marouting.generator import GeneratorOptions
from marouting.options import Agents, EnvOptions
from marouting.source import load_problem
from policies import figures
from policies.cli.options import json_text
from policies.cli.progress import training_bar
from policies.cli.tables import show
from policies.figures.plot import reward_figures, run_figures
from policies.learned.config import Config, TrainOptions
from policies.learned.router import LearnedRouter
from policies.learned.run import Run, clear
from policies.results.folder import check_own
from policies.results.rows import Row, solution_row
from policies.results.run_folder import METRICS, solution_file
from policies.routers.astar import AStarRouter
from policies.routers.base import Router
from policies.routers.random import RandomRouter
from policies.routers.registry import router_label

PROBLEM = GeneratorOptions(nets=30, capacity=4, seed=29)
"""A small problem, tight enough for sequential A* to overflow an edge."""

EPISODES = 350


def run(out: Path, as_json: bool = False) -> None:
    """Does the whole job and writes the results; raises InputError if that is impossible.

    Args:
        out: the folder for the results.
        as_json: whether one JSON object is printed instead of a table.
    """
    problem = load_problem(PROBLEM)
    check_own(out, ("problem.gr", "solutions.png", *get_args(Agents)))
    kept = out / "problem.gr"
    if (
        out.is_dir()
        and any(out.iterdir())
        and not (kept.exists() and Problem.read(kept) == problem)
    ):
        raise InputError(f"{out}: expected a new or an empty folder, or one of quickstart's")
    problem.write(kept)
    click.echo("Loading the router and the learners ...", err=True)
    _compile()
    rows, solutions = [], {}
    routers: dict[str, Router] = {"random": RandomRouter(), "astar": AStarRouter()}
    for name, router in routers.items():
        started = time.perf_counter()
        solutions[name] = router.route(problem)
        seconds = time.perf_counter() - started
        rows.append({"router": name, **solution_row(solutions[name], seconds)})
    del solutions["random"]  # a tangle that shows nothing
    learner = Config().learner.name
    games: dict[str, Agents] = {
        f"{learner}, one agent": "single",
        f"{learner}, every net an agent": "multi",
    }
    for name, agents in games.items():
        click.echo(f"Training {name}: {EPISODES} episodes ...", err=True)
        result, solutions[name] = _train(problem, out, agents)
        rows.append({**result, "router": name})
    titles = [name.replace(learner, router_label(learner)) for name in map(router_label, solutions)]
    drawn = dict(zip(titles, solutions.values(), strict=True))
    figures.save(figures.comparison(drawn), out / "solutions.png")
    run_figures(out / "single")
    reward_figures(out / "multi" / METRICS, out / "multi" / "figures")
    nets, grid = len(problem.nets), "x".join(map(str, problem.grid))
    pictures = {
        "solutions": out / "solutions.png",
        "heat maps": out / "single" / "figures" / "problem" / f"{learner}_heat_maps.png",
        "reward curve": out / "single" / "figures" / "reward.png",
    }
    if as_json:
        click.echo(json_text({"out": out, "rows": rows, "files": list(pictures.values())}))
        return
    show(rows, f"{nets} nets on {grid} Gcells")
    for what, path in pictures.items():
        click.echo(f"{what:>12}: {path}")


def _compile() -> None:
    """Compiles everything that is timed later."""
    tiny = load_problem(GeneratorOptions(grid=(3, 3, 2), nets=2))
    RandomRouter().route(tiny)
    for agents in get_args(Agents):
        config = Config(env=EnvOptions(agents=agents), train=TrainOptions(episodes=1))
        LearnedRouter(config).route(tiny)


def _train(problem: Problem, out: Path, agents: Agents) -> tuple[Row, Solution]:
    """A short training in a run folder: the learner's row, without the problem, and its routes."""
    folder = out / agents
    clear(folder)
    config = Config(
        out=str(folder),
        env=EnvOptions(problem=str(out / "problem.gr"), agents=agents),
        train=TrainOptions(episodes=EPISODES, figures=False),
    )
    training, learner = Run(config), config.learner.name
    with training_bar(*training.episodes) as watch:
        (row,) = [row for row in training.execute(watch) if row["router"] == learner]
    del row["problem"]
    return row, Solution.read(solution_file(folder, "problem", learner), problem)
