"""The paper's figures: edge utilisation, routed solutions and reward curves.

Every function returns a :class:`matplotlib.figure.Figure` of its own and touches no global state
of matplotlib, so figures can be made without a display and in threads; :func:`save` writes one.
Gcell (0, 0) lies at the lower left, and layers count from 1 as in the problem files.
"""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator, SymmetricalLogLocator
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.files import writing
from marouting.grid import AXES, VIA_AXIS
from marouting.problem import Problem
from marouting.solution import Solution, evaluate

# Paul Tol's "vibrant" scheme: told apart in print and by colour-blind readers.
_BLUE, _RED, _TEAL, _ORANGE = "#0077BB", "#CC3311", "#009988", "#EE7733"
_MAGENTA, _CYAN, _INK = "#EE3377", "#33BBEE", "#202020"
_LINES = (_BLUE, _RED, _TEAL, _ORANGE, _MAGENTA, _CYAN, _INK)
_PALE = "#E3E5E8"
_BAND = "#FFD24D"
_VIA = "#808080"

_DPI = 150


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Writes a figure at 150 dpi, whole or not at all.

    Args:
        figure: the figure.
        path: the file; its suffix gives the format (``.png`` when it has none).

    Raises:
        InputError: the file cannot be written, or matplotlib does not know the format.
    """
    target = Path(path)
    kind = target.suffix[1:].lower() or "png"
    if kind not in figure.canvas.get_supported_filetypes():
        raise InputError(f"{target}: expected a picture's suffix such as .png, .pdf or .svg")
    with writing(target) as temporary:
        figure.savefig(temporary, format=kind, dpi=_DPI, bbox_inches="tight", pad_inches=0.1)


# Edge utilisation -------------------------------------------------------------------------------


class UtilisationMaps(NamedTuple):
    """How far the edges of each direction are used, all layers taken together.

    Attributes:
        via: (X, Y) int64, vias in use at each column of Gcells, counted once a net.
        vertical: (X, Y − 1) float64, demand / capacity in % of the edges from row y to y + 1; NaN
            where there is neither, infinite where there is demand without capacity.
        horizontal: (X − 1, Y) float64, the same from column x to x + 1.
        vertical_overflow: (X, Y − 1) bool, whether one of the layers' edges overflows.
        horizontal_overflow: (X − 1, Y) bool.
    """

    via: NDArray[np.int64]
    vertical: NDArray[np.float64]
    horizontal: NDArray[np.float64]
    vertical_overflow: NDArray[np.bool_]
    horizontal_overflow: NDArray[np.bool_]


def utilisation_maps(problem: Problem, solution: Solution) -> UtilisationMaps:
    """The numbers behind :func:`heat_maps`."""
    shape = (*problem.grid, AXES)
    demand = _demand(problem, solution).reshape(shape)
    _, used = solution.uses
    uses = np.bincount(used, minlength=demand.size).reshape(shape)
    capacity = problem.capacity.astype(np.int64).reshape(shape)

    def direction(axis: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        part = (slice(-1), slice(None))[:: 1 if axis == 0 else -1]
        wanted, offered = demand[*part, :, axis], capacity[*part, :, axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            percent = 100 * wanted.sum(axis=2) / offered.sum(axis=2)
        return percent, np.any(wanted > offered, axis=2)

    horizontal, horizontal_overflow = direction(0)
    vertical, vertical_overflow = direction(1)
    return UtilisationMaps(
        uses[..., VIA_AXIS].sum(axis=2),
        vertical,
        horizontal,
        vertical_overflow,
        horizontal_overflow,
    )


def heat_maps(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """Maps of via, vertical and horizontal edge utilisation (paper, heat map figures).

    As in the paper darker is less and lighter is more. An edge lies between two Gcells, and so
    does its field: the field from y = 2 to y = 3 shows the edges from row 2 to row 3, summed over
    the layers. Fields with an overflowed edge in any layer are outlined in red.

    Args:
        problem: whose capacities count.
        solution: the routes.
        title: put before wirelength and overflow.

    Returns:
        Three panels with colour bars: number of vias, and demand / capacity in %.
    """
    maps = utilisation_maps(problem, solution)
    columns, rows, _ = problem.grid
    # Side by side; one above the other where the grid is wide. In inches.
    stacked = columns > 2 * rows
    across = 9 if stacked else float(np.clip(3.4 * columns / rows, 0.8, 3.4))
    height = across * rows / columns
    height = max(height, 1) if stacked else min(height, 9)
    size = (across + 1.6, 3 * height + 4) if stacked else (3 * max(across + 1.2, 3), height + 1.5)
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(_heading(problem, solution, title), fontsize=12)
    panels = figure.subplots(3, 1) if stacked else figure.subplots(1, 3)
    colours = matplotlib.colormaps["viridis"].with_extremes(over=_RED, bad="#BBBBBB")
    fields: tuple[tuple[str, NDArray[np.float64], NDArray[np.bool_] | None], ...] = (
        ("Vias\n(edges between layers)", maps.via.astype(np.float64), None),
        ("Vertical edges\n(between row y and y + 1)", maps.vertical, maps.vertical_overflow),
        (
            "Horizontal edges\n(between column x and x + 1)",
            maps.horizontal,
            maps.horizontal_overflow,
        ),
    )
    for axes, (name, values, overflow) in zip(panels, fields, strict=True):
        _prepare(axes, problem, name)
        if not values.size:
            axes.text(
                0.5,
                0.5,
                "no such edges",
                ha="center",
                va="center",
                rotation="horizontal" if stacked else "vertical",
                transform=axes.transAxes,
            )
            continue
        # A field is one Gcell wide and high and lies in the middle between the Gcells it joins.
        left, bottom = (columns - len(values)) / 2 - 0.5, (rows - values.shape[1]) / 2 - 0.5
        extent = (left, left + len(values), bottom, bottom + values.shape[1])
        largest = 100 if overflow is not None else max(1, values.max())
        image = axes.imshow(
            # Demand without capacity is infinite, which matplotlib would take for missing.
            np.minimum(values, 1e9).T,
            origin="lower",
            extent=extent,
            cmap=colours,
            vmin=0,
            vmax=largest,
        )
        over = overflow is not None and bool(np.any(values > 100))
        # Inside the panel's own axes, so that it is as high as the map.
        place = axes.inset_axes((1 + 0.1 / across, 0, 0.18 / across, 1))
        bar = figure.colorbar(image, cax=place, extend="max" if over else "neither")
        if overflow is None:
            bar.set_label("vias [count]")
            bar.locator = MaxNLocator(nbins=8, integer=True)
            continue
        bar.set_label("demand / capacity [%]")
        outlines = [Rectangle((x + left, y + bottom), 1, 1) for x, y in np.argwhere(overflow)]
        axes.add_collection(
            PatchCollection(outlines, facecolor="none", edgecolor=_RED, linewidth=2, zorder=3)
        )
    notes = []
    if maps.vertical_overflow.any() or maps.horizontal_overflow.any():
        label = "a layer's edge overflows (demand > capacity)"
        notes.append(Patch(facecolor="none", edgecolor=_RED, linewidth=2, label=label))
    if np.isnan(maps.vertical).any() or np.isnan(maps.horizontal).any():
        notes.append(Patch(facecolor="#BBBBBB", label="no capacity"))
    if notes:
        figure.legend(handles=notes, loc="outside lower center", ncols=2, frameon=False)
    return figure


def histogram_counts(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """Counts the edges by utilisation, vias and edges without capacity left out.

    Returns:
        (2, 12) int64: horizontal and vertical edges with utilisation 0 to below 10 %, …, 90 to
        below 100 %, exactly 100 %, above 100 %.
    """
    edge = _routable(problem)
    demand, capacity = _demand(problem, solution)[edge], problem.capacity[edge].astype(np.int64)
    # In integers: 29 of 100 tracks are exactly 29 %.
    tenth = np.minimum(10 * demand // capacity, 10) + (demand > capacity)
    return np.stack([np.bincount(tenth[edge % AXES == axis], minlength=12) for axis in (0, 1)])


def utilisation_histogram(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """How many edges are used how far (paper, histograms beside the heat maps).

    Args:
        problem: whose capacities count; edges without capacity and vias are left out.
        solution: the routes.
        title: put before wirelength and overflow.

    Returns:
        Bars for horizontal and vertical edges; the fully used and overflowed ones marked.
    """
    counts = histogram_counts(problem, solution)
    bins = np.arange(12)
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    for row, (label, colour, hatch) in enumerate(
        (("horizontal edges", _BLUE, ""), ("vertical edges", _ORANGE, "///"))
    ):
        bars = axes.bar(
            bins + 0.4 * row - 0.2,
            counts[row],
            width=0.4,
            color=colour,
            edgecolor="white",
            hatch=hatch,
            label=label,
        )
        axes.bar_label(bars, labels=[str(n) if n else "" for n in counts[row]], fontsize=8)
    full = int(counts[:, 10:].sum())
    note = f"{full} of {_edges(int(counts.sum()))}\nat or above 100 %"
    if stray := _stray(problem, solution):
        note += f"\n(and {_edges(stray)} used\nwithout capacity)"
    axes.axvspan(9.5, 11.5, color=_RED, alpha=0.12, zorder=0)
    axes.text(
        10.5,
        0.985,
        note,
        ha="center",
        va="top",
        color=_RED,
        fontsize=9,
        transform=axes.get_xaxis_transform(),
    )
    axes.set_xticks(bins, [*(f"{10 * n}–{10 * n + 10}" for n in range(10)), "100", "> 100"])
    axes.tick_params(axis="x", labelsize=9)
    axes.set_xlim(-0.6, 11.5)
    axes.set_ylim(0, max(1.0, 1.3 * counts.max()))
    axes.set_xlabel("utilisation = demand / capacity [%], a range without its upper end")
    axes.set_ylabel("edges [count]")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_title(_heading(problem, solution, title), fontsize=12)
    axes.legend(frameon=False, loc="upper center")
    return figure


def depleted_edges(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """The edges that had capacity and whose capacity the solution uses up (or exceeds).

    A problem with such edges after A* is of the paper's Type II (partial edge depletion), one
    without is of Type I (paper, section on the comparison of DQN and A*).

    Returns:
        Sorted edge numbers, int64.
    """
    edge = _routable(problem)
    return edge[_demand(problem, solution)[edge] >= problem.capacity[edge]]


def edges_before_after(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """Capacity of every edge before (blue) and after (red) routing (paper, edge utilisation plot).

    Args:
        problem: whose capacities count; edges without capacity and vias are left out.
        solution: the routes.
        title: put before the type of the problem.

    Returns:
        One plot, edges in falling order of what remains, fully used ones pointed out.
    """
    edge = _routable(problem)
    before = problem.capacity[edge].astype(np.int64)
    after = before - _demand(problem, solution)[edge]
    order = np.lexsort((-before, -after))
    before, after = before[order], after[order]
    borders = np.arange(len(edge) + 1) - 0.5
    full, over = int(np.count_nonzero(after <= 0)), int(np.count_nonzero(after < 0))
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    axes.axhline(0, color=_INK, linewidth=0.8)
    axes.stairs(before, borders, baseline=after, fill=True, color=_BLUE, alpha=0.1)
    for remaining, colour, style, label in (
        (before, _BLUE, "-", "before routing"),
        (after, _RED, "--", "after routing"),
    ):
        axes.stairs(
            remaining,
            borders,
            baseline=None,
            color=colour,
            linewidth=2,
            linestyle=style,
            label=label,
        )
    if over:
        axes.plot(
            np.arange(len(edge) - over, len(edge)),
            after[-over:],
            linestyle="none",
            marker="v",
            markersize=5,
            color=_RED,
            label=f"overflowed ({_edges(over)})",
        )
    top, bottom = max(int(before.max(initial=1)), 1), min(int(after.min(initial=0)), 0)
    axes.set_ylim(bottom - 0.08 * (top - bottom), top + 0.25 * (top - bottom))
    if full:
        start = len(edge) - full
        axes.axvspan(start - 0.5, len(edge) - 0.5, color=_RED, alpha=0.12, linewidth=0)
        axes.annotate(
            f"{full} of {_edges(len(edge))} fully used",
            xy=((start + len(edge) - 1) / 2, 0),
            xytext=(0.45 * len(edge), 0.12 * top),
            color=_RED,
            ha="center",
            arrowprops={"arrowstyle": "->", "color": _RED, "linewidth": 1.5},
        )
    axes.set_xlim(-0.5, max(len(edge), 1) - 0.5)
    axes.set_xlabel("edges, sorted by remaining capacity after routing [rank]")
    axes.set_ylabel("remaining capacity [tracks]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    kind = f"Type II: {_edges(full)} fully used" if full else "Type I: no edge fully used"
    if stray := _stray(problem, solution):
        kind += f" (and {_edges(stray)} used without capacity)"
    axes.set_title(f"{title}: {kind}" if title else kind, fontsize=12)
    axes.legend(frameon=False, loc="upper left", ncols=3)
    return figure


def _demand(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """(E,) the solution's demand in tracks; raises InputError unless the grids are the same."""
    if solution.problem.grid != problem.grid:
        raise InputError(
            f"solution: expected one for the grid {problem.grid}, found {solution.problem.grid}"
        )
    return solution.demand


def _edges(count: int) -> str:
    return f"{count} edge" if count == 1 else f"{count} edges"


def _stray(problem: Problem, solution: Solution) -> int:
    """How many edges without capacity are used all the same: overflow without utilisation."""
    return int(np.count_nonzero((problem.capacity == 0) & (_demand(problem, solution) > 0)))


def _routable(problem: Problem) -> NDArray[np.int64]:
    """The edges along x and y that have capacity."""
    along = np.arange(len(problem.capacity)) % AXES != VIA_AXIS
    return np.flatnonzero(along & (problem.capacity > 0)).astype(np.int64)


# Solutions --------------------------------------------------------------------------------------

# The part of a Gcell's width that the tracks of its nets may take up, and one track at most.
_SPREAD, _TRACK = 0.76, 0.12


class _Drawing(NamedTuple):
    """A solution as lines and points; every net is shifted to its own track, along x = y.

    Attributes:
        lines: for each layer (k, 2, 2) float64, the ends of its edges.
        vias: (v, 2) float64, once a net and column of Gcells.
        via_layers: (v, 2) int64, the lowest and highest layer each of them joins, from 0.
        pins: (p, 3) float64, x, y and layer from 0.
        overflowed: (o, 2, 3) float64, the ends of the overflowed edges, not shifted.
        pitch: from a track to the next, in Gcells.
    """

    lines: tuple[NDArray[np.float64], ...]
    vias: NDArray[np.float64]
    via_layers: NDArray[np.int64]
    pins: NDArray[np.float64]
    overflowed: NDArray[np.float64]
    pitch: float


def _tracks(problem: Problem, solution: Solution) -> NDArray[np.int64]:
    """(nets,) a track for each net, such that no two nets in one column of Gcells share one.

    Long nets choose first and each takes the first free track, so the answer is deterministic and
    needs few of them.
    """
    layers = problem.grid[2]
    columns = [
        np.unique(np.concatenate((*problem.topology.ends(edges), pins)) // layers).tolist()
        for edges, pins in zip(solution.edges, problem.pin_gcells, strict=True)
    ]
    taken = [0] * (problem.grid[0] * problem.grid[1])  # bit t: track t
    track = np.zeros(len(columns), np.int64)
    for net in sorted(range(len(columns)), key=lambda net: -len(columns[net])):
        busy = 0
        for column in columns[net]:
            busy |= taken[column]
        free = ~busy & (busy + 1)
        track[net] = free.bit_length() - 1
        for column in columns[net]:
            taken[column] |= free
    return track


def _drawing(problem: Problem, solution: Solution) -> _Drawing:
    grid = problem.topology
    track = _tracks(problem, solution)
    pitch = min(_TRACK, _SPREAD / (int(track.max()) + 1))
    # 0, +1, −1, +2, …: the first tracks in the middle.
    shift = pitch * np.where(track % 2, track // 2 + 1, -(track // 2))

    net, edge = solution.uses
    near, far = grid.ends(edge)
    start, stop = grid.position[near].astype(np.float64), grid.position[far].astype(np.float64)
    start[:, :2] += shift[net, None]
    stop[:, :2] += shift[net, None]
    ends, layer, is_via = np.stack([start, stop], axis=1), near % problem.grid[2], edge % AXES == 2
    lines = tuple(ends[~is_via & (layer == z), :, :2] for z in range(problem.grid[2]))

    stack, index = np.unique(
        np.stack([net, near // problem.grid[2]], axis=1)[is_via], axis=0, return_inverse=True
    )
    via_layers = np.stack([np.full(len(stack), problem.grid[2]), np.zeros(len(stack), np.int64)], 1)
    np.minimum.at(via_layers[:, 0], index, layer[is_via])
    np.maximum.at(via_layers[:, 1], index, layer[is_via] + 1)
    vias = np.stack(np.divmod(stack[:, 1], problem.grid[1]), axis=1) + shift[stack[:, 0], None]

    pins = grid.position[np.concatenate(problem.pin_gcells)].astype(np.float64)
    owner = np.repeat(np.arange(len(problem.nets)), [len(p) for p in problem.pin_gcells])
    pins[:, :2] += shift[owner, None]
    overflow = np.flatnonzero(_demand(problem, solution) > problem.capacity)
    overflowed = grid.position[np.stack(grid.ends(overflow), axis=1)].astype(np.float64)
    return _Drawing(lines, vias, via_layers, pins, overflowed, pitch)


def solution_2d(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """The routes seen from above (paper, visualised solutions; blue: layer 1, red: layer 2).

    Nets that pass through the same Gcell are drawn on tracks side by side, so that they can be
    told apart.

    Args:
        problem: what was routed.
        solution: the routes.
        title: put before wirelength and overflow.

    Returns:
        One drawing, with pins, vias and overflowed edges marked.
    """
    columns, rows, _ = problem.grid
    side = float(np.clip(0.45 * max(columns, rows), 5.5, 11))
    size = (side * min(1, max(columns / rows, 0.5)), side * min(1, max(rows / columns, 0.3)) + 1.2)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    _draw_2d(axes, problem, solution, title, side / max(columns, rows))
    _legend(figure, problem, [solution], 3 if size[0] < 7 else 6)
    return figure


def _draw_2d(axes: Axes, problem: Problem, solution: Solution, title: str, gcell: float) -> None:
    """Draws the routes; ``gcell`` is about the width of a Gcell in inches."""
    _prepare(axes, problem, _heading(problem, solution, title))
    for x in range(problem.grid[0] + 1):
        axes.axvline(x - 0.5, color=_PALE, linewidth=0.5, zorder=0)
    for y in range(problem.grid[1] + 1):
        axes.axhline(y - 0.5, color=_PALE, linewidth=0.5, zorder=0)
    drawing = _drawing(problem, solution)
    points = 72 * gcell
    width = float(np.clip(0.65 * points * drawing.pitch, 0.6, 2))
    axes.add_collection(
        LineCollection(
            list(drawing.overflowed[..., :2]),
            colors=_BAND,
            linewidths=0.8 * points,
            capstyle="butt",
            zorder=1,
        )
    )
    for layer, lines in enumerate(drawing.lines):
        colour = _layer_colour(layer, problem.grid[2])
        axes.add_collection(
            LineCollection(
                list(lines), colors=colour, linewidths=width, capstyle="round", zorder=2 + layer
            )
        )
    top = 3 + problem.grid[2]
    axes.plot(*drawing.pins[:, :2].T, "s", color=_INK, markersize=2 * width + 1.2, zorder=top)
    axes.plot(
        *drawing.vias.T,
        "o",
        markersize=1.2 * width + 0.8,
        markerfacecolor="white",
        markeredgecolor=_INK,
        markeredgewidth=0.4 * width,
        zorder=top + 1,
    )


def solution_3d(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """The routes in space, layers above one another; the arguments of :func:`solution_2d`."""
    columns, rows, layers = problem.grid
    figure = Figure(figsize=(9, 8), layout="constrained")
    # Three-dimensional axes have no type stubs.
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_title(_heading(problem, solution, title), fontsize=12)
    drawing = _drawing(problem, solution)
    width = float(np.clip(300 / max(columns, rows) * drawing.pitch, 0.5, 1.8))

    def draw(segments: NDArray[np.float64], colour: str, width: float, zorder: int) -> None:
        # One line with gaps: NaN after each segment.
        ends = np.pad(segments, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
        axes.plot(*ends.reshape(-1, 3).T, color=colour, linewidth=width, zorder=zorder)

    draw(drawing.overflowed + np.array([0, 0, 1]), _BAND, 8 * width, 1)
    feet = np.concatenate([drawing.vias, drawing.via_layers[:, :1] + 1], axis=1)
    heads = np.concatenate([drawing.vias, drawing.via_layers[:, 1:] + 1], axis=1)
    draw(np.stack([feet, heads], axis=1), _VIA, 0.7 * width, 2)
    for layer, lines in enumerate(drawing.lines):
        level = np.pad(lines, ((0, 0), (0, 0), (0, 1)), constant_values=layer + 1)
        draw(level, _layer_colour(layer, layers), width, 3 + layer)
    x, y, z = drawing.pins.T
    axes.plot(x, y, z + 1, "s", color=_INK, markersize=1.5 * width + 1, zorder=3 + layers)
    axes.set(
        xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5), zlim=(1, max(layers, 2)),
        zlabel="layer",
    )  # fmt: skip
    _number_gcells(axes, problem)
    axes.set_zticks(range(1, layers + 1))
    longest = max(columns, rows)
    axes.set_box_aspect((max(columns / longest, 0.2), max(rows / longest, 0.2), 0.4))
    axes.grid(False)
    axes.view_init(elev=32, azim=-62)
    _legend(figure, problem, [solution], 6, upright=True)
    return figure


def comparison(solutions: Mapping[str, Solution]) -> Figure:
    """The solutions of several routers for one problem, drawn side by side as :func:`solution_2d`.

    Args:
        solutions: the solutions by router's name, all of one problem.

    Returns:
        One drawing a router; wirelength and overflow stand in its title.

    Raises:
        InputError: there is no solution, or one belongs to another problem.
    """
    if not solutions:
        raise InputError("comparison: expected at least one solution")
    problem = next(iter(solutions.values())).problem
    across = min(len(solutions), 3)
    down = -(-len(solutions) // across)
    columns, rows, _ = problem.grid
    side = float(np.clip(0.25 * max(columns, rows), 4.8, 7))
    ratio = float(np.clip(rows / columns, 0.3, 2))
    figure = Figure(
        figsize=(across * side * min(1, 1 / ratio), down * (side * min(1, ratio) + 0.5) + 0.6),
        layout="constrained",
    )
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes, (name, solution) in zip(panels, solutions.items(), strict=False):
        _draw_2d(axes, problem, solution, name, 0.8 * side / max(columns, rows))
    for axes in panels[len(solutions) :]:
        axes.set_axis_off()
    _legend(figure, problem, list(solutions.values()), 3 if across == 1 else 6)
    return figure


def _heading(problem: Problem, solution: Solution, title: str) -> str:
    """Title, wirelength and overflow; and how many nets are not joined, where there are any."""
    figures = evaluate(problem, solution)
    line = f"WL {figures.wirelength}, OF {figures.overflow}"
    if figures.disconnected:
        line += f", {len(figures.disconnected)} of {len(problem.nets)} nets not joined"
    return f"{title}: {line}" if title else line


def _prepare(axes: Axes, problem: Problem, title: str) -> None:
    """Axes in Gcells: integer ticks, square Gcells, (0, 0) at the lower left."""
    columns, rows, _ = problem.grid
    axes.set_title(title, fontsize=11)
    axes.set(aspect="equal", xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))
    _number_gcells(axes, problem)


def _number_gcells(axes: Any, problem: Problem) -> None:
    """Integer ticks along x and y, few of them on the short side of a narrow grid."""
    columns, rows, _ = problem.grid
    axes.set_xlabel("x [Gcell]", labelpad=12 if axes.name == "3d" else 4)
    axes.set_ylabel("y [Gcell]", labelpad=12 if axes.name == "3d" else 4)
    for axis, length, other in ((axes.xaxis, columns, rows), (axes.yaxis, rows, columns)):
        nbins = int(np.clip(9 * length / other, min(3, length), min(9, length)))
        axis.set_major_locator(MaxNLocator(nbins=nbins, integer=True, min_n_ticks=1))


def _layer_colour(layer: int, layers: int) -> str:
    """Blue for layer 1 and red for layer 2 as in the paper; many layers from a colour map."""
    if layers < len(_LINES):
        return _LINES[layer]
    return to_hex(matplotlib.colormaps["plasma"](0.75 * layer / (layers - 1)))


def _legend(
    figure: Figure,
    problem: Problem,
    solutions: Sequence[Solution],
    ncols: int,
    upright: bool = False,
) -> None:
    """What the lines and marks of a drawing mean; vias are upright lines in three dimensions."""
    layers = problem.grid[2]
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_layer_colour(z, layers), linewidth=2, label=f"layer {z + 1}")
        for z in range(layers)
    ]
    handles.append(Line2D([], [], color=_INK, marker="s", linestyle="none", label="pin"))
    handles.append(
        Line2D([], [], color=_VIA, label="via")
        if upright
        else Line2D(
            [], [], color=_INK, marker="o", markerfacecolor="white", linestyle="none", label="via"
        )
    )
    if any((_demand(problem, solution) > problem.capacity).any() for solution in solutions):
        handles.append(Patch(color=_BAND, label="overflowed edge"))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=ncols,
        frameon=False,
        title="nets are shifted within their Gcells to be told apart",
        title_fontsize=9,
    )


# Training ---------------------------------------------------------------------------------------

_TASK_REWARD = 100  # of reaching a target pin (paper, section on the reward)


def reward_curves(
    curves: Mapping[str, Sequence[float] | NDArray[np.floating]],
    log: bool = False,
    smoothing: int = 50,
    title: str = "",
) -> Figure:
    """Reward of every episode over the course of training (paper, reward curves and log-plots).

    The paper's log-plots leave out the first episodes, whose reward is negative. Here ``log``
    takes the signed logarithm, which keeps them and the order of all values: linear from −100 to
    +100, the reward of one joined two-pin task, and logarithmic beyond.

    Args:
        curves: reward of each episode by the curve's name.
        log: whether the reward's axis is logarithmic.
        smoothing: episodes in the running mean, drawn dark over the pale rewards; 1 for none.
        title: the title.

    Returns:
        One plot, with a legend for up to ten curves.

    Raises:
        InputError: there is no curve, or ``smoothing`` is below 1.
    """
    if not curves:
        raise InputError("reward curves: expected at least one curve")
    if smoothing < 1:
        raise InputError(f"smoothing: expected a number of episodes from 1, found {smoothing}")
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    axes = figure.subplots()
    # Pale ones first, so that no curve's noise covers another's mean.
    for index, (name, rewards) in enumerate(curves.items()):
        values = np.asarray(rewards, np.float64)
        episode = np.arange(1, len(values) + 1)
        colour = _LINES[index % len(_LINES)]
        style = ("-", "--", ":")[index // len(_LINES) % 3]
        if smoothing > 1:
            axes.plot(episode, values, color=colour, linewidth=0.6, alpha=0.25, zorder=1)
        mean = _running_mean(values, smoothing)
        axes.plot(episode, mean, color=colour, linewidth=1.6, linestyle=style, label=name, zorder=2)
    scale = ""
    if log:
        axes.set_yscale("symlog", linthresh=_TASK_REWARD, linscale=0.5)
        axes.yaxis.set_major_locator(
            SymmetricalLogLocator(base=10, linthresh=_TASK_REWARD, subs=(1, 2, 5))
        )
        axes.yaxis.set_major_formatter("{x:g}")
        scale = f", signed logarithm, linear within ±{_TASK_REWARD}"
    axes.grid(color=_PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("episode")
    axes.set_ylabel(f"reward of an episode{scale}")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(left=0)
    mean_note = f"dark: mean of the last {smoothing} episodes" if smoothing > 1 else ""
    axes.set_title("\n".join(filter(None, (title, mean_note))), fontsize=11)
    if len(curves) <= 10:
        axes.legend(frameon=False, loc="lower right", fontsize=9, ncols=-(-len(curves) // 5))
    return figure


def _running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """The mean of the last ``window`` values at each place, of fewer at the beginning."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    last = np.arange(1, len(total))
    first = np.maximum(last - window, 0)
    return np.asarray((total[last] - total[first]) / (last - first), np.float64)


# Experiments ------------------------------------------------------------------------------------

_MARKERS = "os^Dv<>"


def by_problem(
    values: Mapping[str, NDArray[np.floating]],
    order: NDArray[np.integer],
    quantity: str,
    order_by: str,
    title: str = "",
) -> Figure:
    """A quantity of every problem, router by router (paper, comparisons of WL and of OF).

    Args:
        values: (problems,) of each router, NaN where there is none; the paper has A* in blue, the
            first, and the DQN in red, the second.
        order: (problems,) the problems from left to right.
        quantity: what the values are, with its unit.
        order_by: what the problems rise by in this order.
        title: the title.

    Returns:
        One plot, a line a router.

    Raises:
        InputError: there is no router.
    """
    if not values:
        raise InputError("by problem: expected the values of at least one router")
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    axes = figure.subplots()
    rank = np.arange(1, len(order) + 1)
    for index, (name, own) in enumerate(values.items()):
        missing = int(np.isnan(own).sum())
        axes.plot(
            rank,
            np.asarray(own, np.float64)[order],
            color=_LINES[index % len(_LINES)],
            linestyle=("-", "--", ":")[index // len(_LINES) % 3],
            linewidth=1.2,
            marker=_MARKERS[index % len(_MARKERS)],
            # Smaller with the routers, so that where they agree all of them can be seen.
            markersize=max(2.0, 7.0 - 1.2 * index) * min(1.0, (60 / len(order)) ** 0.5),
            label=f"{name} (without {missing})" if missing else name,
        )
    axes.grid(color=_PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel(f"problems, sorted by {order_by} [rank]")
    axes.set_ylabel(quantity)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0, len(order) + 1)
    axes.set_title(title, fontsize=12)
    figure.legend(frameon=False, loc="outside lower center", ncols=min(len(values), 4))
    return figure


def decrease_histogram(
    decreases: Mapping[str, NDArray[np.floating]], baseline: str, title: str = ""
) -> Figure:
    """How much less wirelength routers need than A* (paper, decrease in WL).

    Args:
        decreases: (problems,) A*'s wirelength less the router's, of each router; NaN where there
            is none.
        baseline: what A* is called.
        title: the title.

    Returns:
        One panel a router, all with the same axes; to the right of the dashed line the router's
        wirelength is lower.

    Raises:
        InputError: there is no router, or not one value.
    """
    known = {name: values[~np.isnan(values)] for name, values in decreases.items()}
    together = np.concatenate([np.empty(0), *known.values()])
    if not together.size:
        raise InputError("decrease: expected the values of at least one problem")
    low, high = min(0, np.floor(together.min())), max(0, np.ceil(together.max()))
    # Bars as wide as a whole number of edges, with 0 in the middle of one.
    width = int(max(1, -(-(high - low) // 40)))
    edges = width * (np.arange(low // width - 1, high // width + 3) - 0.5)
    figure = Figure(figsize=(9, 1.4 + 1.8 * len(known)), layout="constrained")
    panels = figure.subplots(len(known), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, (name, values) in zip(panels, known.items(), strict=True):
        # No outline: it would hide bars of a single problem.
        axes.hist(values, bins=edges, color=_RED)
        axes.axvline(0, color=_INK, linewidth=1, linestyle="--")
        axes.set_title(
            f"{name}: lower on {np.count_nonzero(values > 0)} of {len(values)} problems, "
            f"equal on {np.count_nonzero(values == 0)}, mean decrease {values.mean():.3g}"
            if len(values)
            else f"{name}: no problem",
            fontsize=10,
        )
        axes.set_ylabel("problems [count]")
        axes.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True, min_n_ticks=1))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelbottom=True)
    panels[-1].set_xlabel(f"decrease in wirelength = {baseline}'s less the router's [edges]")
    figure.suptitle(title, fontsize=12)
    return figure


# Speed ------------------------------------------------------------------------------------------


def growth(
    panels: Mapping[str, Mapping[str, NDArray[np.floating]]],
    amount: str,
    quantity: str,
    title: str = "",
) -> Figure:
    """How quantities grow with an amount, on logarithmic axes.

    Args:
        panels: by panel and curve, (2, points) the amounts and the quantities, all positive.
        amount: what the amounts are, with their unit.
        quantity: what the quantities are, with their unit.
        title: the title.

    Returns:
        The panels side by side with the same axes; a dashed line is as steep as growth in
        proportion.

    Raises:
        InputError: there is no panel.
    """
    if not panels:
        raise InputError("growth: expected at least one panel")
    figure = Figure(figsize=(4.6 * len(panels) + 0.6, 5), layout="constrained")
    drawn = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (name, curves) in zip(drawn, panels.items(), strict=True):
        for index, (label, (amounts, quantities)) in enumerate(curves.items()):
            axes.loglog(
                amounts,
                quantities,
                color=_LINES[index % len(_LINES)],
                marker=_MARKERS[index % len(_MARKERS)],
                markersize=5,
                linewidth=1.4,
                label=label,
            )
        amounts = np.concatenate([points[0] for points in curves.values()])
        quantities = np.concatenate([points[1] for points in curves.values()])
        ends = np.array([amounts.min(), amounts.max()])
        # Below all curves, through the lowest of all points in proportion.
        axes.loglog(
            ends,
            ends * (quantities / amounts).min() / 2,
            color=_INK,
            linewidth=1,
            linestyle="--",
            label="in proportion",
        )
        axes.grid(color=_PALE, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_title(name, fontsize=11)
        axes.set_xlabel(amount)
        axes.set_ylabel(quantity)
        axes.tick_params(labelleft=True)
        axes.legend(frameon=False, loc="upper left", fontsize=9)
    figure.suptitle(title, fontsize=12)
    return figure


# All of them ------------------------------------------------------------------------------------


def problem_figures(
    problem: Problem, solutions: Mapping[str, Solution], folder: str | os.PathLike[str]
) -> list[Path]:
    """Writes the figures of one problem and its solutions as PNG.

    Args:
        problem: what was routed.
        solutions: the solutions by router's name.
        folder: where to; made when missing.

    Returns:
        The files: for each router ``ROUTER_heat_maps.png``, ``ROUTER_histogram.png``,
        ``ROUTER_edges.png``, ``ROUTER_solution_2d.png`` and ``ROUTER_solution_3d.png``; for two
        routers or more ``comparison.png``.

    Raises:
        InputError: the folder cannot be written to, or a solution belongs to another problem.
    """
    draw = {
        "heat_maps": heat_maps,
        "histogram": utilisation_histogram,
        "edges": edges_before_after,
        "solution_2d": solution_2d,
        "solution_3d": solution_3d,
    }
    written: list[Path] = []

    def write(figure: Figure, stem: str) -> None:
        path = Path(folder) / f"{stem}.png"
        save(figure, path)
        written.append(path)

    stems: set[str] = set()
    for name, solution in solutions.items():
        stem = base = re.sub(r"[^\w.-]+", "_", name).strip("._") or "router"
        while stem in stems:
            stem = f"{base}_{len(stems)}"
        stems.add(stem)
        for kind, figure in draw.items():
            write(figure(problem, solution, name), f"{stem}_{kind}")
    if len(solutions) > 1:
        write(comparison(solutions), "comparison")
    return written
