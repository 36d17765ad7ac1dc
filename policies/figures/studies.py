"""Composed figures: routers side by side, quantities in rows.

:class:`policies.results.study.Study` describes one.
"""

from collections.abc import Callable, Mapping, Sequence
from string import ascii_lowercase
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from policies.figures.charts import (
    decrease_bins,
    decrease_note,
    draw_by_problem,
    draw_decreases,
    draw_rewards,
)
from policies.figures.routes import (
    SECOND_BAR,
    SHIFTED,
    Direction,
    draw_edges,
    draw_histogram,
    draw_map,
    draw_routes,
    map_notes,
    map_scale,
    route_notes,
)
from policies.figures.style import INK, fitted
from policies.results.study import Panel
from policies.results.utilisation import utilisation_maps


class ColumnData(NamedTuple):
    """The data of a column of a composed figure: one router on one set of problems.

    Attributes:
        problem: the problem that panels of one problem show.
        astar: A*'s solution of this problem.
        solution: the router's solution of this problem.
        wirelength: (problems,) float64 by router, A* first and the column's router second (unless
            it is A* itself); NaN where tasks stayed open.
        overflow: (problems,) float64, by the same routers; NaN where tasks stayed open.
        rewards: the reward of each episode, by problem.
        mean_rewards: each episode's reward, averaged over problems and seeds, by router.
        open_wirelength: (problems,) float64, by router: where tasks stayed open, NaN elsewhere.
        open_overflow: (problems,) float64, likewise.
    """

    problem: Problem
    astar: Solution
    solution: Solution
    wirelength: Mapping[str, NDArray[np.floating]]
    overflow: Mapping[str, NDArray[np.floating]]
    rewards: Mapping[str, Sequence[float]]
    mean_rewards: Mapping[str, NDArray[np.floating]]
    open_wirelength: Mapping[str, NDArray[np.floating]] = MappingProxyType({})
    open_overflow: Mapping[str, NDArray[np.floating]] = MappingProxyType({})


def study(columns: Mapping[str, ColumnData], panels: Sequence[Panel]) -> Figure:
    """Routers side by side, quantities in rows (paper, studies of γ and of the burn-in).

    Args:
        columns: the data of each column, by its title.
        panels: the quantity that each row shows.

    Returns:
        A panel for each column and quantity, lettered row by row. What is to be compared along a
        row has the same limits, colours and places of pins: maps, decreases and rewards always;
        wirelength, overflow, edges and routes where columns show the same problems. Problems are
        sorted by A*'s wirelength.

    Raises:
        InputError: there is no column or no panel.
    """
    if not columns or not panels:
        raise InputError("study: expected at least one column and one panel")
    of = list(columns.values())
    kinds = [_KINDS[panel] for panel in panels]
    widths, heights = zip(*(kind.size(of) for kind in kinds), strict=True)
    figure = Figure(
        figsize=(max(widths) * len(columns) + 0.6, sum(heights) + 0.8), layout="constrained"
    )
    grid = figure.subplots(
        len(panels), len(columns), squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    for kind, row in zip(kinds, grid, strict=True):
        kind.draw(row, of)
    titles = list(columns)  # above the first row
    for index, axes in enumerate(grid.ravel()):
        title = titles[index] if index < len(titles) else ""
        note = axes.get_title().replace("\n", " ")  # it may have been fitted to another width
        axes.set_title("")
        letter = f"({ascii_lowercase[index % 26]})"
        # Above the numbers of the axis, so that the title has all the width of the panel.
        axes.set_title(letter, fontsize=10, loc="left", x=-0.02, ha="right")
        # A configuration's titles may contain dollar signs that do not mean formulas.
        both = "\n".join(filter(None, (title, note)))
        both = fitted(both, max(widths) - _AXIS, 9)
        axes.set_title(both, fontsize=9, parse_math=False)
        axes.xaxis.label.set_fontsize(9)
        axes.yaxis.label.set_fontsize(9)
    handles = [note for kind in kinds for column in of for note in kind.notes(column)]
    notes = {handle.get_label(): handle for handle in handles}
    if notes:
        figure.legend(
            handles=list(notes.values()),
            loc="outside lower center",
            ncols=min(len(notes), 3),
            frameon=False,
            fontsize=9,
            title=SHIFTED if "routes" in panels else None,
            title_fontsize=9,
        )
    return figure


_Draw = Callable[[Sequence[Axes], Sequence[ColumnData]], None]


def _edges_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    for axes, column in zip(row, columns, strict=True):
        draw_edges(axes, column.problem, column.astar)
        axes.set_xlabel("edges, each curve by capacity [rank]")
        axes.legend(frameon=False, fontsize=8, loc="upper center", ncols=2)


def _map_row(direction: Direction) -> _Draw:
    def draw(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
        scale = map_scale([utilisation_maps(of.problem, of.solution) for of in columns])
        for axes, column in zip(row, columns, strict=True):
            draw_map(axes, column.problem, column.solution, direction, 2.4, scale)

    return draw


def _histogram_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    for axes, column in zip(row, columns, strict=True):
        note = draw_histogram(axes, column.problem, column.solution)
        axes.set_title(note)
        axes.tick_params(axis="x", labelsize=7, labelrotation=60)
        for count in axes.texts:
            count.set(rotation="vertical", fontsize=7)
        axes.set_xlabel("demand / capacity [%]")
        axes.legend(frameon=False, fontsize=8, loc="upper left")


def _routes_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    for axes, column in zip(row, columns, strict=True):
        gcell = 3.5 / max(column.problem.grid[:2])
        beside = [other.solution for other in columns if other.problem == column.problem]
        draw_routes(axes, column.problem, column.solution, "", gcell, beside)


def _wirelength_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    values = [(column.wirelength, column.open_wirelength) for column in columns]
    _by_problem_row(row, columns, "wirelength [edges]", values)


def _overflow_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    values = [(column.overflow, column.open_overflow) for column in columns]
    _by_problem_row(row, columns, "overflow [tracks]", values)


_Values = Mapping[str, NDArray[np.floating]]


def _by_problem_row(
    row: Sequence[Axes],
    columns: Sequence[ColumnData],
    quantity: str,
    values: Sequence[tuple[_Values, _Values]],
) -> None:
    """Draws values and those with open nets of each column."""
    same: dict[bytes, list[Axes]] = {}
    for axes, column, (whole, opened) in zip(row, columns, values, strict=True):
        astar, lengths = next(iter(column.wirelength.items()))
        order = np.argsort(lengths, kind="stable")
        by = f"{astar}'s wirelength"
        draw_by_problem(axes, whole, order, quantity, by, 5.0, opened)
        same.setdefault(lengths.tobytes(), []).append(axes)
    width, height = (inches - _AXIS for inches in _by_problem_size(columns))
    for panels in same.values():
        lows, highs = zip(*(axes.get_ylim() for axes in panels), strict=True)
        low, high = min(lows), max(highs)
        legends = []
        for axes in panels:
            handles, labels = axes.get_legend_handles_labels()
            legends.append((handles, [fitted(label, width - 0.5, 8) for label in labels]))
        lines = max(sum(label.count("\n") + 1 for label in labels) for _, labels in legends)
        # Legends lie above everything that is drawn.
        high = low + (high - low) / (1 - min((0.16 * lines + 0.1) / height, 0.6))
        for axes, (handles, labels) in zip(panels, legends, strict=True):
            axes.set_ylim(low, high)
            look = {"frameon": False, "fontsize": 8, "borderaxespad": 0.2, "labelspacing": 0.3}
            axes.legend(handles, labels, loc="upper left", **look)


def _decrease_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    decreases = []
    for column in columns:
        astar, *own = list(column.wirelength.values())[:2]
        decreases.append(astar - (own[0] if own else astar))
    if all(np.isnan(values).all() for values in decreases):
        for axes, values in zip(row, decreases, strict=True):
            axes.set_title(decrease_note(values))
            axes.set_axis_off()
        return
    bins = decrease_bins(decreases)
    highest = max(np.histogram(values[~np.isnan(values)], bins)[0].max() for values in decreases)
    for axes, values in zip(row, decreases, strict=True):
        draw_decreases(axes, values, bins)
        axes.set_ylim(0, 1.05 * highest)
        axes.set_xlabel("decrease in wirelength [edges]")
        axes.set_title(decrease_note(values))


def _reward_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    everything = np.concatenate([curve for column in columns for curve in column.rewards.values()])
    positive = everything[everything > 0]
    low, high = everything.min() - 1, everything.max() + 1
    if positive.size:
        # As in the paper, the first episodes are left out: their reward is negative or small.
        high = 1.1 * positive.max()
        low = min(np.quantile(positive, 0.02), high / 10)
    for axes, column in zip(row, columns, strict=True):
        draw_rewards(axes, column.rewards, log=False, smoothing=_SMOOTHING)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
        axes.set_ylim(low, high)
        if positive.size:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter("{x:g}")
            axes.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
            axes.tick_params(axis="y", which="minor", labelsize=8)
            axes.set_ylabel("reward of an episode, logarithmic")
        count = len(column.rewards)
        axes.set_title(f"{count} random problems, a colour each" if count > 1 else "")


def _mean_reward_row(row: Sequence[Axes], columns: Sequence[ColumnData]) -> None:
    for axes, column in zip(row, columns, strict=True):
        draw_rewards(axes, column.mean_rewards, log=False, smoothing=_SMOOTHING)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
        axes.set_ylabel("mean reward of an episode")
        axes.legend(frameon=False, fontsize=8, loc="lower right")
    low, high = zip(*(axes.get_ylim() for axes in row), strict=True)
    for axes in row:
        axes.set_ylim(min(low), max(high))


def _plain_size(columns: Sequence[ColumnData]) -> tuple[float, float]:
    return (3.6 if len(columns) < 4 else 3.0), 2.9


def _by_problem_size(columns: Sequence[ColumnData]) -> tuple[float, float]:
    width, height = _plain_size(columns)
    return width, height + 0.6  # for the legend


def _map_size(columns: Sequence[ColumnData]) -> tuple[float, float]:
    over = map_scale([utilisation_maps(of.problem, of.solution) for of in columns]).overflow
    return 4.2 + SECOND_BAR * bool(over), 3.3


def _routes_size(columns: Sequence[ColumnData]) -> tuple[float, float]:
    largest = max(max(column.problem.grid[:2]) for column in columns)
    side = float(np.clip(0.25 * largest, 4.2, 7))
    return side, side


def _no_notes(_column: ColumnData) -> Sequence[Artist]:
    return ()


def _map_notes(column: ColumnData) -> Sequence[Artist]:
    return map_notes(column.problem, column.solution)


def _route_notes(column: ColumnData) -> Sequence[Artist]:
    return route_notes(column.problem, [column.solution])


def _reward_notes(_column: ColumnData) -> Sequence[Artist]:
    return (
        Line2D([], [], color=INK, linewidth=0.6, alpha=0.4, label="every episode"),
        Line2D([], [], color=INK, linewidth=1.6, label=f"mean of the last {_SMOOTHING} episodes"),
    )


_SMOOTHING = 50

_AXIS = 0.7
"""Inches of a panel beside or below its axes."""


class _Kind(NamedTuple):
    """A kind of panel.

    Attributes:
        draw: draws a row of such panels.
        size: the width and height of one panel in inches.
        notes: entries of a column for the legend below all panels.
    """

    draw: _Draw
    size: Callable[[Sequence[ColumnData]], tuple[float, float]] = _plain_size
    notes: Callable[[ColumnData], Sequence[Artist]] = _no_notes


_KINDS: dict[Panel, _Kind] = {
    "edges": _Kind(_edges_row),
    "vias": _Kind(_map_row("vias"), _map_size),
    "vertical": _Kind(_map_row("vertical"), _map_size, _map_notes),
    "horizontal": _Kind(_map_row("horizontal"), _map_size, _map_notes),
    "histogram": _Kind(_histogram_row),
    "routes": _Kind(_routes_row, _routes_size, _route_notes),
    "wirelength": _Kind(_wirelength_row, _by_problem_size),
    "overflow": _Kind(_overflow_row, _by_problem_size),
    "decrease": _Kind(_decrease_row),
    "reward": _Kind(_reward_row, notes=_reward_notes),
    "mean_reward": _Kind(_mean_reward_row, notes=_reward_notes),
}
