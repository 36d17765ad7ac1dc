"""Figures of trainings, experiments and measurements."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, SymmetricalLogLocator
from numpy.typing import NDArray

from marouting.errors import InputError
from policies.figures.style import BLUE, INK, LINES, PALE, RED, fitted, literal

# Training ---------------------------------------------------------------------------------------

_TASK_REWARD = 100  # of reaching a target pin (paper, section on the reward)

_NAMED = 12
"""The most curves that are told apart by colour; more are drawn alike, with their mean."""


def reward_curves(
    curves: Mapping[str, Sequence[float] | NDArray[np.floating]],
    log: bool = False,
    smoothing: int = 50,
    title: str = "",
) -> Figure:
    """Reward of every episode over the course of training (paper, reward curves and log-plots).

    The paper's log-plots leave out the first episodes, whose reward is negative. Here ``log`` gives
    a signed logarithmic axis, which shows them too and keeps the order of all values: it is linear
    from −100 to +100, the reward of one joined two-pin task, and logarithmic beyond.

    Args:
        curves: reward of each episode by the curve's name.
        log: whether the reward's axis is logarithmic.
        smoothing: episodes in the running mean, which is drawn dark over the pale rewards; 1 for
            no mean.
        title: the first line of the title.

    Returns:
        One plot with a legend. More than twelve curves are drawn alike, with their mean.
    """
    if not curves:
        raise InputError("reward curves: expected at least one curve")
    if smoothing < 1:
        raise InputError(f"smoothing: expected a number of episodes from 1, found {smoothing}")
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    axes = figure.subplots()
    many = len(curves) > _NAMED
    if many:
        _draw_alike(axes, curves, smoothing)
    # Pale ones first, so that no curve's noise covers another's mean.
    for index, (name, rewards) in enumerate(() if many else curves.items()):
        values = np.asarray(rewards, np.float64)
        episode = np.arange(1, len(values) + 1)
        look: dict[str, Any] = {"color": LINES[index % len(LINES)]}
        if smoothing > 1:
            axes.plot(episode, values, linewidth=0.6, alpha=0.25, zorder=1, **look)
        look["linestyle"] = ("-", "--", ":")[index // len(LINES) % 3]
        mean = _running_mean(values, smoothing)
        axes.plot(episode, mean, linewidth=1.6, label=literal(name), zorder=2, **look)
    scale = ""
    if log:
        axes.set_yscale("symlog", linthresh=_TASK_REWARD, linscale=0.5)
        axes.yaxis.set_major_locator(
            SymmetricalLogLocator(base=10, linthresh=_TASK_REWARD, subs=(1, 2, 5))
        )
        axes.yaxis.set_major_formatter("{x:g}")
        scale = f", signed logarithm, linear within ±{_TASK_REWARD}"
    _style(axes, "episode", f"reward of an episode{scale}")
    axes.set_xlim(left=0)
    note = f"pale: every episode, dark: mean of the last {smoothing} episodes"
    lines = [title or "Rewards of a training", *([note] if smoothing > 1 else [])]
    axes.set_title(fitted(literal("\n".join(lines)), 8), fontsize=11)
    figure.legend(frameon=False, loc="outside lower center", fontsize=9, ncols=_across(axes, 6))
    return figure


def _style(axes: Axes, across: str, up: str) -> None:
    """A pale grid, and the names of the axes, of which the first counts things."""
    axes.grid(color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set(xlabel=across, ylabel=up)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _across(axes: Axes, most: int) -> int:
    """How many columns the legend of a plot may have, below it and no wider."""
    _, labels = axes.get_legend_handles_labels()
    longest = max(map(len, labels), default=0)
    return max(1, min(len(labels), most, int(110 / (longest + 6))))


def _draw_alike(
    axes: Axes, curves: Mapping[str, Sequence[float] | NDArray[np.floating]], smoothing: int
) -> None:
    """Draws the running means of many curves alike, and the mean of all up to the shortest."""
    for index, rewards in enumerate(curves.values()):
        mean = _running_mean(np.asarray(rewards, np.float64), smoothing)
        label = None if index else f"each of {len(curves)}"
        episode = np.arange(1, len(mean) + 1)
        axes.plot(episode, mean, color=BLUE, linewidth=0.8, alpha=0.3, label=label, zorder=1)
    common = min(map(len, curves.values()))
    together = np.mean([np.asarray(rewards)[:common] for rewards in curves.values()], axis=0)
    axes.plot(
        np.arange(1, common + 1),
        _running_mean(together, smoothing),
        color=RED,
        linewidth=2,
        label=f"mean of all {len(curves)}",
        zorder=2,
    )


def _running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """The mean of the last ``window`` values at each place, or of fewer at the beginning."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    last = np.arange(1, len(total))
    first = np.maximum(last - window, 0)
    return np.asarray((total[last] - total[first]) / (last - first), np.float64)


# Experiments ------------------------------------------------------------------------------------

_MARKERS = "os^Dv<>"
_MARKS = 7.0  # points


def by_problem(
    values: Mapping[str, NDArray[np.floating]],
    order: NDArray[np.integer],
    quantity: str,
    order_by: str,
    title: str = "",
) -> Figure:
    """A quantity of every problem, router by router (paper, comparisons of WL and of OF).

    Args:
        values: (problems,) values of each router, NaN where it has none or leaves nets open; the
            legend counts these. The first router is drawn in blue, as A* in the paper, and the
            second in red, as the paper's DQN.
        order: (problems,) the problems from left to right.
        quantity: the name of the values, with the unit.
        order_by: the name of what the problems are sorted by.
        title: the title.

    Returns:
        One plot, with marks for each router. No line joins the problems, whose ranks mean nothing;
        a pale one joins the marks of a problem.
    """
    if not values:
        raise InputError("by problem: expected the values of at least one router")
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    axes = figure.subplots()
    rank = np.arange(1, len(order) + 1)
    shown = {name: np.asarray(own, np.float64)[order] for name, own in values.items()}
    every = np.array(list(shown.values()))
    some = ~np.isnan(every).all(axis=0)
    ends = np.nanmin(every[:, some], axis=0), np.nanmax(every[:, some], axis=0)
    axes.vlines(rank[some], *ends, color=PALE, linewidth=1.2, zorder=1)
    for index, (name, own) in enumerate(shown.items()):
        missing = int(np.isnan(own).sum())
        note = f" (open nets on {missing} of {len(own)} problems)" if missing else ""
        axes.plot(
            rank,
            own,
            label=literal(f"{name}{note}"),
            color=LINES[index % len(LINES)],
            linestyle="none",
            marker=_MARKERS[index % len(_MARKERS)],
            # Smaller from router to router, so that all of them show where they agree.
            markersize=max(0.3 * _MARKS, _MARKS - 1.2 * index) * min(1.0, (60 / len(order)) ** 0.5),
        )
    _style(axes, literal(f"problems, sorted by {order_by} [rank]"), quantity)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0, len(order) + 1)
    low, high = axes.get_ylim()
    if high - low < 1:  # all values alike, such as no overflow at all: show this one and the next
        value = round((low + high) / 2)
        axes.set_ylim(min(low, value - 0.5), max(high, value + 1.5))
    axes.set_title(fitted(literal(title), 8, 12), fontsize=12)
    figure.legend(frameon=False, loc="outside lower center", ncols=_across(axes, 4))
    return figure


def gaps_by_router(gaps: Mapping[str, NDArray[np.floating]], title: str = "") -> Figure:
    """How far each router's wirelength is above the optimum's, a dot for every problem.

    Args:
        gaps: (problems,) gap to the optimum of each router, NaN where it has open nets or overflow
            that the optimum lacks, or where no optimum is known.
        title: the title.

    Returns:
        One row per router with its mean, and the number of problems that are not shown.
    """
    if not gaps:
        raise InputError("gaps: expected the values of at least one router")
    figure = Figure(figsize=(9, 1.5 + 0.5 * len(gaps)), layout="constrained")
    axes = figure.subplots()
    labels = []
    for row, (name, values) in enumerate(gaps.items()):
        known = np.sort(values[~np.isnan(values)])
        labels.append(literal(f"{name}\n{_gap_note(values)}"))
        # A dot lies above or below its row so that it hides no other.
        height = row + 0.3 * (np.arange(len(known)) * 0.618034 % 1 - 0.5)
        axes.plot(known, height, "o", color=BLUE, markersize=4, alpha=0.35, markeredgewidth=0)
        if len(known):
            axes.plot(known.mean(), row, "|", color=INK, markersize=18, markeredgewidth=2)
    axes.set_yticks(range(len(gaps)), labels, fontsize=9)
    axes.set_ylim(len(gaps) - 0.5, -0.5)
    axes.grid(axis="x", color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.axvline(0, color=INK, linewidth=1, linestyle="--")
    axes.set_xlabel(
        "wirelength above the optimum's [%]; a dot for each problem, bars: means\n"
        "no gap: more overflow or open tasks than the optimum, or no known optimum",
        fontsize=9,
    )
    axes.set_title(fitted(literal(title), 6, 12), fontsize=12)
    return figure


def _gap_note(values: NDArray[np.floating]) -> str:
    """The mean gap, and on how many problems there is none."""
    known = values[~np.isnan(values)]
    mean = [f"mean {known.mean():.2f} %"] if len(known) else []
    left_out = len(values) - len(known)
    return ", ".join(mean + [f"{left_out} without a gap"] * (left_out > 0))


def decrease_histogram(
    decreases: Mapping[str, NDArray[np.floating]], baseline: str, title: str = ""
) -> Figure:
    """How much less wirelength routers need than A* (paper, decrease in WL).

    Args:
        decreases: (problems,) A*'s wirelength minus the router's, for each router; NaN where
            either has none.
        baseline: the name of A*'s entry.
        title: the title.

    Returns:
        One panel per router, all with the same axes. To the right of the dashed line the router's
        wirelength is lower.
    """
    together = np.concatenate([np.empty(0), *decreases.values()])
    together = together[~np.isnan(together)]
    if not together.size:
        raise InputError("decrease: expected the values of at least one problem")
    low, high = min(0, np.floor(together.min())), max(0, np.ceil(together.max()))
    # The bars' width is a whole number of edges, and 0 lies in the middle of one.
    width = int(max(1, -(-(high - low) // 40)))
    bins = width * (np.arange(low // width - 1, high // width + 3) - 0.5)
    figure = Figure(figsize=(9, 1.4 + 1.8 * len(decreases)), layout="constrained")
    panels = figure.subplots(len(decreases), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, (name, values) in zip(panels, decreases.items(), strict=True):
        # No outline: it would hide the bar of a single problem.
        axes.hist(values[~np.isnan(values)], bins=bins.tolist(), color=RED)
        axes.axvline(0, color=INK, linewidth=1, linestyle="--")
        axes.set_ylabel("problems [count]")
        axes.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True, min_n_ticks=1))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelbottom=True)
        note = literal(f"{name}: {_decrease_note(values)}")
        axes.set_title(fitted(note, 8, 10), fontsize=10)
    less = f"decrease in wirelength = {baseline}'s minus the router's [edges]"
    panels[-1].set_xlabel(literal(less))
    figure.suptitle(fitted(literal(title), 8.5, 12), fontsize=12)
    return figure


def _decrease_note(values: NDArray[np.floating]) -> str:
    """A note that sums up some decreases; those that are NaN are of problems with open nets."""
    known = values[~np.isnan(values)]
    left_out = len(values) - len(known)
    end = f"; {left_out} with open nets not shown" if left_out else ""
    if not len(known):
        return f"no problem{end}"
    return (
        f"lower on {np.count_nonzero(known > 0)} of {len(known)} problems, "
        f"equal on {np.count_nonzero(known == 0)}, mean decrease {known.mean():.3g}{end}"
    )
