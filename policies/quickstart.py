"""The main job in about a minute: generate, route, train with one agent and with many, draw."""

import time
from pathlib import Path

import click

from marouting import Solution
from marouting.config import EnvOptions
from marouting.generator import GeneratorOptions
from marouting.source import load_problem
from policies import figures
from policies.classical.astar import AStarRouter
from policies.classical.random import RandomRouter
from policies.config import Config, DQNOptions, TrainOptions
from policies.learned.run import Run, clear, row
from policies.plot import run_figures
from policies.table import show

PROBLEM = GeneratorOptions(nets=20, seed=1)
EPISODES = {"single": 300, "multi": 300}


def run(out: Path) -> None:
    """Does it all, and writes it into a folder; raises InputError if that cannot be."""
    problem = load_problem(PROBLEM)
    problem.write(out / "problem.gr")
    rows, solutions = [], {}
    for router in (RandomRouter(), AStarRouter()):
        started = time.perf_counter()
        solutions[router.name] = router.route(problem)
        seconds = time.perf_counter() - started
        rows.append(row("quickstart", router.name, solutions[router.name], seconds))
    for agents in ("single", "multi"):
        folder = out / agents
        clear(folder)
        config = Config(
            out=str(folder),
            env=EnvOptions(problem=str(out / "problem.gr"), agents=agents),
            dqn=DQNOptions(gamma=0.95, target_period=1000),
            train=TrainOptions(episodes=EPISODES[agents], figures=False),
        )
        (result,) = [r for r in Run(config).execute() if r["router"] == "dqn"]
        name = f"dqn ({agents} agent{'s' if agents == 'multi' else ''})"
        rows.append({**result, "problem": "quickstart", "router": name})
        path = folder / "solutions" / "problem.dqn.solution"
        solutions[name] = Solution.read(path, problem)
        run_figures(folder)
    del solutions["random"]  # a tangle that shows nothing
    figures.save(figures.comparison(solutions), out / "solutions.png")
    show(rows, "20 nets on 8x8x2")
    click.echo(f"Pictures: {out / 'solutions.png'}, {out / 'single' / 'figures'}")
