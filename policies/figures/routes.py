"""Figures of a problem and its solutions: edge utilisation and routes."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import DRAWN, check_memory
from marouting.problem.grid import AXES
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution, evaluate
from marouting.render import USE
from policies.figures.congestion import (
    NO_CAPACITY,
    congestion_map,
    crowded,
    crowded_note,
    draw_congestion,
    label_of_use,
    scale_of_use,
    show_use,
)
from policies.figures.style import (
    BAND,
    BLUE,
    INK,
    LINES,
    ORANGE,
    PALE,
    RED,
    VIA,
    fitted,
    literal,
)
from policies.results.utilisation import (
    MOST_FIELDS,
    congestion,
    histogram_counts,
    overflowed_edges,
    routable_edges,
    stray_edges,
    via_counts,
)

# Edge utilisation -------------------------------------------------------------------------------


def heat_maps(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """Maps of via, vertical and horizontal edge utilisation (paper, heat map figures).

    An edge lies between two Gcells, and so does its field: the field from y = 2 to y = 3 shows the
    fullest of the edges from row 2 to row 3 in any layer. Full is dark blue, and what overflows is
    orange to red. Where a few Gcells have far more vias than all others, the scale of vias ends
    below them and says so.

    Returns:
        Three panels with colour bars: number of vias, and twice demand / capacity in %.
    """
    columns, rows, _ = problem.grid
    values, side = congestion(problem, solution, MOST_FIELDS)
    along_x, along_y = np.fmax.reduce(values, axis=0)
    # The last Gcell in a row or column has no edge to a next one.
    horizontal = along_x[: -(-(columns - 1) // side)]
    vertical = along_y[:, : -(-(rows - 1) // side)]
    # Side by side; one above the other where the grid is wide. In inches.
    stacked = columns > 2 * rows
    across = 9 if stacked else float(np.clip(3.4 * columns / rows, 0.8, 3.4))
    height = across * rows / columns
    height = max(height, 1) if stacked else min(height, 9)
    size = (across + 1.6, 3 * height + 4)
    if not stacked:
        size = (3 * max(across + 1.2, 3), height + 1.5)
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(fitted(_heading(problem, solution, title), size[0] - 0.5, 12), fontsize=12)
    panels = figure.subplots(3, 1) if stacked else figure.subplots(1, 3)
    scale = scale_of_use(values)
    # A field of one Gcell's size lies in the middle between the Gcells it joins.
    for axes, own, name, corner in (
        (panels[0], via_counts(solution, side), "Vias\n(edges between layers)", (-0.5, -0.5)),
        (panels[1], vertical, "Vertical edges\n(between row y and y + 1)", (-0.5, 0.0)),
        (panels[2], horizontal, "Horizontal edges\n(between column x and x + 1)", (0.0, -0.5)),
    ):
        _prepare(axes, problem, name)
        if not own.size:
            middle: Any = {"ha": "center", "va": "center", "transform": axes.transAxes}
            turn = "horizontal" if columns > 2 * rows else "vertical"
            axes.text(0.5, 0.5, "no such edges", rotation=turn, **middle)
            continue
        # Inside the panel's own axes, so that it is as high as the map.
        place = axes.inset_axes((1 + 0.1 / across, 0, 0.18 / across, 1))
        if axes is panels[0]:
            vias, largest = _scale_of_vias(own)
            show_use(axes, own, side, vias, corner)
            more = f", at most {largest}" if largest > vias.get_clim()[1] else ""
            extend = "max" if more else "neither"
            bar = figure.colorbar(vias, cax=place, extend=extend, label=f"vias [count]{more}")
            bar.locator = MaxNLocator(nbins=8, integer=True)
        else:
            show_use(axes, own, side, scale, corner)
            figure.colorbar(scale, cax=place, **label_of_use(values))
        # The last fields may reach beyond the grid, which is all that is to be seen.
        axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))
    notes = []
    if np.isnan(vertical).any() or np.isnan(horizontal).any():
        notes.append(Patch(facecolor=NO_CAPACITY, label="no capacity"))
    if side > 1:
        label = f"a field shows {side}x{side} Gcells"
        notes.append(Patch(facecolor="none", edgecolor=INK, label=label))
    if notes:
        figure.legend(handles=notes, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _scale_of_vias(counts: NDArray[np.int64]) -> tuple[ScalarMappable, int]:
    """Pale to dark blue, and the largest count.

    If that is more than twice the 98th percentile of the fields with any, and two more, the scale
    ends at the percentile: a few outliers do not spoil it.
    """
    largest = int(counts.max(initial=0))
    top = int(np.quantile(counts[counts > 0], 0.98, method="lower")) if largest else 1
    top = top if largest > 2 * top + 2 else max(largest, 1)
    blues = [tuple(part / 255 for part in ink) for share, ink in USE if share <= 1]
    colours = LinearSegmentedColormap.from_list("vias", blues)
    return ScalarMappable(Normalize(0, top), colours.with_extremes(over=INK)), largest


def utilisation_histogram(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """The number of edges by utilisation (paper, histograms beside the heat maps).

    Args:
        problem: the problem, which gives the capacities; edges without capacity and vias are left
            out.
        solution: the routes.
        title: text before wirelength and overflow in the title.

    Returns:
        Bars for horizontal and vertical edges, with fully used and overflowed ones marked.
    """
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    counts = histogram_counts(problem, solution)
    bins = np.arange(12)
    for row, (label, colour, hatch) in enumerate(
        (("horizontal edges", BLUE, ""), ("vertical edges", ORANGE, "///"))
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
    axes.axvspan(9.5, 11.5, color=RED, alpha=0.12, zorder=0)
    axes.set_xticks(bins, [*(f"{10 * n}–{10 * n + 10}" for n in range(10)), "100", "> 100"])
    axes.tick_params(axis="x", labelsize=9)
    axes.set(xlim=(-0.6, 11.5), ylim=(0, max(1.0, 1.3 * counts.max())), ylabel="edges [count]")
    axes.set_xlabel("utilisation = demand / capacity [%], a range without its upper end")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    note = f"{int(counts[:, 10:].sum())} of {_edges(int(counts.sum()))}\nat or above 100 %"
    if stray := stray_edges(problem, solution):
        note += f"\n(and {_edges(stray)} used\nwithout capacity)"
    place: Any = {"ha": "center", "va": "top", "transform": axes.get_xaxis_transform()}
    axes.text(10.5, 0.985, note, color=RED, fontsize=9, **place)
    axes.set_title(fitted(_heading(problem, solution, title), 8, 12), fontsize=12)
    axes.legend(frameon=False, loc="upper center")
    return figure


def edges_before_after(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """Capacity of every edge before (blue) and after (red) routing (paper, edge utilisation plot).

    Args:
        problem: the problem, which gives the capacities; edges without capacity and vias are left
            out.
        solution: the routes.
        title: text before the number of edges fully used in the title.

    Returns:
        One plot, each curve in descending order of remaining capacity, with fully used edges
        marked. The same rank need not be the same edge; the area between the curves is the demand.
    """
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    _, _, before, demand, count = routable_edges(problem, solution)
    after = before - demand
    edges = int(count.sum())
    full, over = int(count[after <= 0].sum()), int(count[after < 0].sum())
    axes.axhline(0, color=INK, linewidth=0.8)
    curves = [_descending(remaining, count) for remaining in (before, after)]
    if edges:
        # Both curves step at the borders of either.
        common = np.union1d(curves[0][1], curves[1][1])
        upper, lower = (
            values[np.searchsorted(borders, common[:-1], "right") - 1] for values, borders in curves
        )
        axes.stairs(upper, common, baseline=lower, fill=True, color=BLUE, alpha=0.1)
    looks: list[dict[str, Any]] = [
        {"color": BLUE, "linestyle": "-", "label": "before routing"},
        {"color": RED, "linestyle": "--", "label": "after routing"},
    ]
    for (remaining, borders), look in zip(curves, looks, strict=True):
        axes.stairs(remaining, borders, baseline=None, linewidth=2, **look)
    if over:
        axes.plot(
            np.arange(edges - over, edges),
            np.repeat(curves[1][0], np.diff(curves[1][1]).astype(np.int64))[-over:],
            linestyle="none",
            marker="v",
            markersize=5,
            color=RED,
            label=f"overflowed ({_edges(over)})",
        )
    top, bottom = max(int(before.max(initial=1)), 1), min(int(after.min(initial=0)), 0)
    axes.set_ylim(bottom - 0.08 * (top - bottom), top + 0.25 * (top - bottom))
    if full:
        start = edges - full
        axes.axvspan(start - 0.5, edges - 0.5, color=RED, alpha=0.12, linewidth=0)
        axes.annotate(
            f"{full} of {edges} fully used",
            xy=((start + edges - 1) / 2, 0),
            xytext=(0.45 * edges, 0.12 * top),
            color=RED,
            ha="center",
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1},
            arrowprops={"arrowstyle": "->", "color": RED, "linewidth": 1.5},
        )
    axes.set_xlim(-0.5, max(edges, 1) - 0.5)
    axes.set_xlabel("edges, each curve sorted by remaining capacity [rank]")
    axes.set_ylabel("remaining capacity [tracks]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True) if edges else NullLocator())
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    kind = f"{_edges(full)} fully used" if full else "no edge fully used"
    if stray := stray_edges(problem, solution):
        kind += f" (and {_edges(stray)} used without capacity)"
    axes.set_title(fitted(literal(f"{title}: {kind}" if title else kind), 8, 12), fontsize=12)
    axes.legend(frameon=False, loc="upper left", ncols=3)
    return figure


def _descending(
    values: NDArray[np.int64], count: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(k,) values in descending order, each once, and (k + 1,) their borders among the ranks."""
    levels, index = np.unique(-values, return_inverse=True)
    numbers = np.zeros(len(levels), np.int64)
    np.add.at(numbers, index, count)
    return -levels, np.cumsum([0, *numbers]) - 0.5


def _edges(count: int) -> str:
    return f"{count} edge" if count == 1 else f"{count} edges"


# Solutions --------------------------------------------------------------------------------------

# The most that the tracks of all nets, and a single track, may take up of a Gcell's width.
_SPREAD, _TRACK = 0.76, 0.12


class _Drawing(NamedTuple):
    """A solution as lines and points; every net is shifted to its own track, along x = y.

    Attributes:
        lines: for each layer (k, 2, 2) float64, the ends of its edges.
        vias: (v, 2) float64, one for each net and column of Gcells.
        via_layers: (v, 2) int64, the lowest and highest layer each of them joins, from 0.
        pins: (p, 3) float64, x, y and layer from 0.
        overflowed: (o, 2, 3) float64, the ends of the overflowed edges, not shifted.
        pitch: the distance between two tracks, in Gcells.
    """

    lines: tuple[NDArray[np.float64], ...]
    vias: NDArray[np.float64]
    via_layers: NDArray[np.int64]
    pins: NDArray[np.float64]
    overflowed: NDArray[np.float64]
    pitch: float


def side_by_side(columns: Sequence[Sequence[Any]]) -> tuple[NDArray[np.float64], float]:
    """How far to shift nets along x = y so that no two lie upon each other, in Gcells.

    Long nets choose first and each takes the first free track, so the result is deterministic and
    needs few tracks.

    Args:
        columns: the columns of Gcells that each net passes.

    Returns:
        (nets,) float64, and the distance between two tracks.
    """
    taken: defaultdict[Any, int] = defaultdict(int)  # bit t: track t
    track = np.zeros(len(columns), np.int64)
    for net in sorted(range(len(columns)), key=lambda net: -len(columns[net])):
        busy = 0
        for column in columns[net]:
            busy |= taken[column]
        free = ~busy & (busy + 1)
        track[net] = free.bit_length() - 1
        for column in columns[net]:
            taken[column] |= free
    pitch = min(_TRACK, _SPREAD / (int(track.max(initial=0)) + 1))
    # 0, +1, −1, +2, …: the first tracks in the middle.
    return pitch * np.where(track % 2, track // 2 + 1, -(track // 2)), pitch


def shifts(problem: Problem, solutions: Sequence[Solution]) -> tuple[NDArray[np.float64], float]:
    """:func:`side_by_side` of a problem's nets, the same in all of its solutions."""
    layers = problem.grid[2]
    columns = [
        np.unique(
            np.concatenate([*(end for own in edges for end in problem.topology.ends(own)), pins])
            // layers
        ).tolist()
        for *edges, pins in zip(
            *(solution.edges for solution in solutions), problem.pin_gcells, strict=True
        )
    ]
    return side_by_side(columns)


def _drawing(problem: Problem, solution: Solution, beside: Sequence[Solution] = ()) -> _Drawing:
    grid = problem.topology
    drawn = len(solution.uses[1])
    check_memory(DRAWN * drawn, "a drawing of {} edges", drawn)
    shift, pitch = shifts(problem, [solution, *beside])
    net, edge = solution.uses
    near, far = grid.ends(edge)
    start, stop = _points(problem, near), _points(problem, far)
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

    first, gcell = problem.flat_pin_gcells
    pins = _points(problem, gcell)
    owner = np.repeat(np.arange(len(problem.nets)), np.diff(first))
    pins[:, :2] += shift[owner, None]
    overflow = overflowed_edges(problem, solution)
    overflowed = _points(problem, np.stack(grid.ends(overflow), axis=1))
    return _Drawing(lines, vias, via_layers, pins, overflowed, pitch)


def _points(problem: Problem, gcells: NDArray[np.int64]) -> NDArray[np.float64]:
    """(…, 3) x, y and layer of Gcells (…)."""
    return np.stack(np.unravel_index(gcells, problem.grid), axis=-1).astype(np.float64)


def solution_2d(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """The routes seen from above (paper, visualised solutions; blue: layer 1, red: layer 2).

    Nets that pass through the same Gcell are drawn on tracks side by side, so that they can be
    told apart. Of more than 1000 nets, a map of the congestion is drawn instead.

    Returns:
        One drawing, with pins, vias and overflowed edges marked.
    """
    columns, rows, _ = problem.grid
    side = float(np.clip(0.45 * max(columns, rows), 5.5, 11))
    size = (side * min(1, max(columns / rows, 0.5)), side * min(1, max(rows / columns, 0.3)) + 1.2)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    _draw_routes(axes, problem, solution, title, side / max(columns, rows))
    _legend(figure, problem, [solution], 3 if size[0] < 7 else 6)
    return figure


def _draw_routes(
    axes: Axes,
    problem: Problem,
    solution: Solution,
    title: str,
    gcell: float,
    beside: Sequence[Solution] = (),
) -> None:
    """Draws :func:`solution_2d`.

    ``gcell`` is about the width of a Gcell in inches; pins lie at the same places in the solutions
    ``beside`` this one.
    """
    heading = _heading(problem, solution, title)
    width = max(gcell * problem.grid[0], 3)
    if crowded(problem):
        _prepare(axes, problem, fitted(f"{heading}\n{crowded_note(problem)}", width))
        draw_congestion(axes, problem, solution, gcell * problem.grid[0])
        return
    _prepare(axes, problem, fitted(heading, width))
    points = 72 * gcell
    if points >= 1:  # the lines of a finer grid would cover all
        for x in range(problem.grid[0] + 1):
            axes.axvline(x - 0.5, color=PALE, linewidth=0.5, zorder=0)
        for y in range(problem.grid[1] + 1):
            axes.axhline(y - 0.5, color=PALE, linewidth=0.5, zorder=0)
    drawing = _drawing(problem, solution, beside)
    width = float(np.clip(0.65 * points * drawing.pitch, 0.6, 2))
    axes.add_collection(
        LineCollection(
            list(drawing.overflowed[..., :2]),
            colors=BAND,
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
    axes.plot(*drawing.pins[:, :2].T, "s", color=INK, markersize=2 * width + 1.2, zorder=top)
    axes.plot(
        *drawing.vias.T,
        "o",
        markersize=1.2 * width + 0.8,
        markerfacecolor="white",
        markeredgecolor=INK,
        markeredgewidth=0.4 * width,
        zorder=top + 1,
    )


def solution_3d(problem: Problem, solution: Solution, title: str = "") -> Figure:
    """The routes in three dimensions, layer above layer; arguments as for :func:`solution_2d`.

    Of more than 1000 nets, a map of the congestion of every layer is drawn instead.
    """
    if crowded(problem):
        return congestion_map(problem, solution, f"{title}\n{crowded_note(problem)}")
    columns, rows, layers = problem.grid
    figure = Figure(figsize=(9, 8), layout="constrained")
    # Three-dimensional axes have no type stubs.
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_title(fitted(_heading(problem, solution, title), 8, 12), fontsize=12)
    drawing = _drawing(problem, solution)
    width = float(np.clip(300 / max(columns, rows) * drawing.pitch, 0.5, 1.8))

    def draw(segments: NDArray[np.float64], colour: str, width: float, zorder: int) -> None:
        # One line with gaps: NaN after each segment.
        ends = np.pad(segments, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
        axes.plot(*ends.reshape(-1, 3).T, color=colour, linewidth=width, zorder=zorder)

    draw(drawing.overflowed + np.array([0, 0, 1]), BAND, 8 * width, 1)
    feet = np.concatenate([drawing.vias, drawing.via_layers[:, :1] + 1], axis=1)
    heads = np.concatenate([drawing.vias, drawing.via_layers[:, 1:] + 1], axis=1)
    draw(np.stack([feet, heads], axis=1), VIA, 0.7 * width, 2)
    for layer, lines in enumerate(drawing.lines):
        level = np.pad(lines, ((0, 0), (0, 0), (0, 1)), constant_values=layer + 1)
        draw(level, _layer_colour(layer, layers), width, 3 + layer)
    x, y, z = drawing.pins.T
    axes.plot(x, y, z + 1, "s", color=INK, markersize=1.5 * width + 1, zorder=3 + layers)
    axes.set(zlim=(1, max(layers, 2)), zlabel="layer")
    axes.zaxis.set_major_locator(MaxNLocator(nbins=10, integer=True))
    _number_gcells(axes, problem)
    longest = max(columns, rows)
    axes.set_box_aspect((max(columns / longest, 0.2), max(rows / longest, 0.2), 0.4))
    axes.grid(False)
    axes.view_init(elev=32, azim=-62)
    _legend(figure, problem, [solution], 6, upright=True)
    return figure


def comparison(solutions: Mapping[str, Solution]) -> Figure:
    """The solutions of several routers for one problem, drawn side by side as :func:`solution_2d`.

    Returns:
        One drawing per router, with wirelength and overflow in its title.
    """
    if not solutions:
        raise InputError("comparison: expected at least one solution")
    problem = next(iter(solutions.values())).problem
    for solution in solutions.values():
        _ = evaluate(problem, solution)  # refuses one of another problem
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
        gcell = 0.8 * side / max(columns, rows)
        _draw_routes(axes, problem, solution, name, gcell, list(solutions.values()))
    for axes in panels[len(solutions) :]:
        axes.set_axis_off()
    _legend(figure, problem, list(solutions.values()), 3 if across == 1 else 6)
    return figure


def _heading(problem: Problem, solution: Solution, title: str) -> str:
    """Title, wirelength and overflow, and the number of nets not joined if there are any.

    Where routes have dead ends or loops, the wirelength without them follows in brackets.
    """
    figures = evaluate(problem, solution)
    line = f"WL {figures.wirelength}"
    blank = "\N{NO-BREAK SPACE}"
    less = len(solution.pruned().uses[1])
    if less < figures.wirelength:
        line += f"{blank}({less}{blank}pruned)"
    line += f", OF {figures.overflow}"
    if figures.disconnected:
        line += f", {len(figures.disconnected)} of {len(problem.nets)} nets not joined"
    return literal(f"{title}: {line}" if title else line)


def _prepare(axes: Axes, problem: Problem, title: str) -> None:
    """Axes in Gcells: integer ticks, square Gcells, (0, 0) at the lower left."""
    axes.set_title(title, fontsize=11)
    axes.set_aspect("equal")
    _number_gcells(axes, problem)


def _number_gcells(axes: Any, problem: Problem) -> None:
    """The limits along x and y and integer ticks, few of them on the short side of a grid."""
    columns, rows, _ = problem.grid
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))
    axes.set_xlabel("x [Gcell]", labelpad=12 if axes.name == "3d" else 4)
    axes.set_ylabel("y [Gcell]", labelpad=12 if axes.name == "3d" else 4)
    for axis, length, other in ((axes.xaxis, columns, rows), (axes.yaxis, rows, columns)):
        nbins = int(np.clip(9 * length / other, min(3, length), min(9, length)))
        axis.set_major_locator(MaxNLocator(nbins=nbins, integer=True, min_n_ticks=1))


def _layer_colour(layer: int, layers: int) -> str:
    """Blue for layer 1 and red for layer 2 as in the paper.

    Many layers go from blue to green and, every other one, from red to orange.
    """
    if layers < len(LINES):
        return LINES[layer]
    colours = matplotlib.colormaps["autumn" if layer % 2 else "winter"]
    return to_hex(colours(0.75 * layer / (layers - 1)))


def _legend(
    figure: Figure,
    problem: Problem,
    solutions: Sequence[Solution],
    ncols: int,
    upright: bool = False,
) -> None:
    """Adds a legend of lines and marks; vias are upright lines in three dimensions."""
    if crowded(problem):
        return
    layers = problem.grid[2]
    mark: Any = {"color": INK, "linestyle": "none"}
    upright_via = Line2D([], [], color=VIA, label="via")
    round_via = Line2D([], [], marker="o", markerfacecolor="white", label="via", **mark)
    handles: list[Line2D | Patch] = [
        *(
            Line2D([], [], color=_layer_colour(z, layers), linewidth=2, label=f"layer {z + 1}")
            for z in range(layers)
        ),
        Line2D([], [], marker="s", label="pin", **mark),
        upright_via if upright else round_via,
    ]
    if any(len(overflowed_edges(problem, solution)) for solution in solutions):
        handles.append(Patch(color=BAND, label="overflowed edge"))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=ncols,
        frameon=False,
        title="nets are shifted within their Gcells to be told apart",
        title_fontsize=9,
    )
