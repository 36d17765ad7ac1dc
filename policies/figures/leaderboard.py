"""Figures of the leaderboard: scores with their intervals, and learning curves."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from policies.figures.style import BLUE, INK, LINES, PALE, literal

WORSE = 4
"""How many times narrower scores below 0 are drawn."""


def score_intervals(rows: Sequence[Mapping[str, Any]], title: str = "") -> Figure:
    """The score of every router with its interval, in the order of the rows.

    Each has a ``name`` and a ``score`` (``mean``, ``low`` and ``high``). Lines stand at the scores
    of A* and of the reference.
    """
    figure = Figure(figsize=(9, 1.6 + 0.34 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for x, label in ((0, "A*"), (1, "reference")):
        axes.axvline(x, color=INK, linewidth=1, linestyle="--")
        axes.annotate(
            label,
            (x, 1),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=9,
        )
    for place, row in enumerate(rows):
        score = row["score"]
        axes.plot([score["low"], score["high"]], [place, place], color=BLUE, linewidth=3, alpha=0.4)
        axes.plot(score["mean"], place, "o", color=BLUE, markersize=6)
    axes.set_yticks(range(len(rows)), [literal(row["name"]) for row in rows], fontsize=9)
    axes.invert_yaxis()
    # Most of the width is for the way from A* to the reference.
    axes.set_xscale(
        "function",
        functions=(
            lambda x: np.where(x < 0, x / WORSE, x),
            lambda x: np.where(x < 0, x * WORSE, x),
        ),
    )
    axes.xaxis.set_major_locator(FixedLocator([-3, -2, -1, 0, 0.25, 0.5, 0.75, 1, 2, 3, 4]))
    axes.xaxis.set_major_formatter("{x:g}")
    ends = [score[end] for score in (row["score"] for row in rows) for end in ("low", "high")]
    axes.set_xlim(min(*ends, 0) - 0.05 * WORSE, max(*ends, 1) + 0.05)
    axes.grid(axis="x", color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel(
        f"score: interquartile mean and 95 % interval (below 0 drawn {WORSE} times narrower)"
    )
    figure.suptitle(literal(title), fontsize=12)
    return figure


def learning_curves(curves: Mapping[str, Sequence[tuple[int, float]]], title: str = "") -> Figure:
    """The score of the best routes so far over the course of trainings.

    Points are (episodes, score), by the learner's name; the axis of episodes is logarithmic.
    """
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    for index, (name, points) in enumerate(curves.items()):
        axes.plot(
            [episode for episode, _ in points],
            [score for _, score in points],
            color=LINES[index % len(LINES)],
            linestyle=("-", "--", ":")[index // len(LINES) % 3],
            linewidth=1.6,
            label=literal(name),
        )
    for height in (0, 1):
        axes.axhline(height, color=INK, linewidth=1, linestyle="--")
    axes.set_xscale("log")
    axes.grid(color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("episodes per problem")
    axes.set_ylabel("score of the best routes so far\n(A* 0, reference 1)")
    axes.set_title(literal(title), fontsize=12)
    axes.legend(frameon=False, fontsize=9)
    return figure
