"""Draws docs/pictures/cooperation/: levels, with what selfish nets do and what is optimal.

python docs/pictures/cooperation.py                                  # still pictures
python docs/pictures/cooperation.py gates-8x7-v0 runs/ppo/policy.pt  # animated, with this policy
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marouting import Engine, Problem, Solution, evaluate, scenarios
from marouting.game import NOBODY
from marouting.problem.grid import AXES, VIA_AXIS
from policies.experiment.anarchy import SELFISH, rules_of
from policies.figures.animation import record, save_animation
from policies.figures.routes import shifts
from policies.figures.style import INK, LINES, save
from policies.learned.policy import TrainedPolicy
from policies.routers.optimal import OptimalRouter

FOLDER = Path(__file__).parent / "cooperation"
LEVELS = ("gates-8x7-v0", "gates-2x-v0", "gates-mixed-v0", "braess-v0", "crossing-v0")
GROUND, WIDE = "#DDE1E6", 3  # the colour of edges, and the tracks of the widest lines


def draw(axes: Axes, problem: Problem, solutions: list[Solution], which: int, title: str) -> None:
    """Draws one of the solutions of a single-layer problem."""
    grid = problem.topology

    def add(edges: Sequence[int], shift: float = 0, **style: Any) -> None:
        """Draws edges as lines."""
        ends = [[grid.position_of[int(end)][:2] for end in grid.ends(edge)] for edge in edges]
        points = np.full((len(edges), 3, 2), np.nan)  # with a gap after every edge
        points[:, :2] = np.array(ends, float).reshape(-1, 2, 2) + shift
        axes.plot(*points.reshape(-1, 2).T, solid_capstyle="round", **style)

    tracks = np.where(np.arange(grid.edges) % AXES < VIA_AXIS, problem.capacity, 0).clip(0, WIDE)
    for width in range(1, WIDE + 1):
        add(np.flatnonzero(tracks == width), linewidth=13 * width / WIDE, color=GROUND, zorder=1)
    shift, _ = shifts(problem, solutions)
    for net, edges in enumerate(solutions[which].edges):
        colour = LINES[net % len(LINES)]
        add(edges, shift[net], linewidth=2, color=colour, zorder=2)
        pins = [grid.position_of[int(pin)][:2] for pin in problem.pin_gcells[net]]
        start, end = np.array(pins, float) + shift[net]
        axes.plot(*start, "o", color=colour, markersize=6, zorder=3)
        axes.plot(*end, "s", color=colour, markersize=6, zorder=3)
        if not len(edges):
            axes.plot(*zip(start, end, strict=True), ":", color=colour, linewidth=1.5, zorder=2)
            axes.plot(*start, "x", color=INK, markersize=9, markeredgewidth=2, zorder=4)
    axes.set_title(title, fontsize=10, color=INK)
    axes.set_aspect("equal")
    axes.set_axis_off()


def chosen(name: str) -> tuple[Problem, Solution]:
    """The first test problem of four nets or more that selfish nets spoil, and what they do."""
    scenario = scenarios.get(name)
    for problem in scenario.test:
        selfish = SELFISH.play([problem], rules_of(name)).solution()
        found, best = evaluate(problem, selfish), scenario.reference(problem).wirelength
        if len(problem.nets) >= 4 and (found.disconnected or found.wirelength > best + 8):
            return problem, selfish
    raise AssertionError(name)


def picture(name: str) -> Figure:
    """What selfish nets do, and what is optimal."""
    problem, selfish = chosen(name)
    solutions = [selfish, OptimalRouter().route(problem)]
    columns, rows, _ = problem.grid
    figure = Figure(figsize=(0.72 * columns + 0.5, 0.36 * rows + 0.5), layout="constrained")
    panels = zip(figure.subplots(1, 2), ("selfish, full sight", "optimum"), strict=True)
    for which, (axes, title) in enumerate(panels):
        found = evaluate(problem, solutions[which])
        text = f"{title}: {found.wirelength} edges"
        text += f", {len(found.disconnected)} open" if found.disconnected else ""
        draw(axes, problem, solutions, which, text)
    return figure


def selfish_game(problem: Problem, name: str) -> Iterator[Engine]:
    """The game of selfish nets: the same engine at the beginning and after every round."""
    engine, rng = Engine([problem], rules_of(name)), np.random.default_rng(0)
    yield engine
    while engine.games["agent"][0] != NOBODY:
        engine.step(SELFISH.moves(engine, rng))
        yield engine


def animate(name: str, policy: TrainedPolicy) -> None:
    """Draws the problem of the still pictures, played by selfish nets and by a policy."""
    problem, _ = chosen(name)
    games = {"selfish": selfish_game(problem, name), "team": policy.play(problem)}
    for how, states in games.items():
        save_animation(record(states), FOLDER / f"{name}-{how}.svg", f"{name}: {how}")


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    mpl.rcParams["svg.fonttype"], mpl.rcParams["svg.hashsalt"] = "none", "marouting"
    if len(sys.argv) > 1:
        animate(sys.argv[1], TrainedPolicy.load(sys.argv[2]))
    else:
        for level in LEVELS:
            save(picture(level), FOLDER / f"{level}.svg")
