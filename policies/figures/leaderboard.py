"""Figures of the leaderboard: scores with their intervals, and learning curves."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from policies.figures.style import BLUE, INK, LINES, PALE, literal

LEAST = -1.0
"""Scores below are drawn as arrows at the edge, with the number beside them."""


ENDS = {False: ("A*", "reference"), True: ("best local rule", "optimum")}
"""What has the scores 0 and 1: in scenarios of planners, and of policies."""


def score_intervals(
    rows: Sequence[Mapping[str, Any]], title: str = "", *, policies: bool = False
) -> Figure:
    """The score of every router with its interval, in the order of the rows, on a linear axis.

    Each has a ``name`` and a ``score`` (``mean``, ``low`` and ``high``). Lines stand at the scores
    0 and 1.
    """
    figure = Figure(figsize=(9, 1.6 + 0.34 * max(len(rows), 3)), layout="constrained")
    axes = figure.subplots()
    for x, label in enumerate(ENDS[policies]):
        axes.axvline(x, color=INK, linewidth=1, linestyle="--")
        place: Any = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        axes.annotate(label, (x, 1), xytext=(0, 3), ha="center", fontsize=9, **place)
    least = max(LEAST, min((row["score"]["low"] for row in rows), default=0.0))
    for y, row in enumerate(rows):
        score = row["score"]
        ends = [max(score["low"], least), max(score["high"], least)]
        axes.plot(ends, [y, y], color=BLUE, linewidth=3, alpha=0.4)
        if score["mean"] >= least:
            axes.plot(score["mean"], y, "o", color=BLUE, markersize=6)
        else:
            axes.plot(least, y, "<", color=BLUE, markersize=7)
            axes.text(least + 0.03, y - 0.15, f"{score['mean']:.1f}", fontsize=9)
    axes.set_yticks(range(len(rows)), [literal(row["name"]) for row in rows], fontsize=9)
    axes.invert_yaxis()
    highest = max((row["score"]["high"] for row in rows), default=1.0)
    axes.set_xlim(min(least, 0) - 0.06, max(highest, 1) + 0.06)
    axes.grid(axis="x", color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("score: interquartile mean and 95 % interval (arrows: lower than shown)")
    figure.suptitle(literal(title), fontsize=12)
    return figure


def learning_curves(
    curves: Mapping[str, Sequence[tuple[int, float]]], title: str = "", *, policies: bool = False
) -> Figure:
    """The score of the best routes so far over the course of trainings.

    Points are (episodes, score), by the learner's name; the axis of episodes is logarithmic. Those
    of policies are (agent-steps, score on the validation problems).
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
    if policies:
        axes.xaxis.set_major_formatter(EngFormatter(sep="\N{NO-BREAK SPACE}"))
    else:
        axes.set_xscale("log")
    axes.grid(color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    zero, one = ENDS[policies]
    across = "episodes per problem (logarithmic: most is learnt in the first of them)"
    axes.set_xlabel("agent-steps" if policies else across)
    up = "score on the validation problems" if policies else "score of the best routes so far"
    axes.set_ylabel(f"{up}\n({zero} 0, {one} 1)")
    axes.set_title(literal(title), fontsize=12)
    axes.legend(frameon=False, fontsize=9)
    return figure
