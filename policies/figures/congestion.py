"""Congestion maps: what is drawn of routes that are too many to be told apart."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from marouting.problem.problem import Problem
from marouting.problem.solution import Solution, evaluate
from marouting.render import USE
from policies.figures.style import fitted, literal
from policies.results.utilisation import congestion, free_tracks

MOST_NETS = 1000
"""The most nets that are drawn one by one."""

NO_CAPACITY, STRAY = "#D3D6DC", "#3D0000"
"""Where there is no capacity: without demand, and with demand."""


def crowded(problem: Problem) -> bool:
    """Whether a problem has too many nets to draw each."""
    return len(problem.nets) > MOST_NETS


def crowded_note(problem: Problem) -> str:
    """What titles say of a map that stands for a drawing of routes."""
    return f"{len(problem.nets)} nets are too many to draw: congestion map"


_SHADES = 8192
"""Of a scale: so many that a hundredth of a per cent above full is seen."""


def scale_of_use(values: NDArray[np.float64]) -> ScalarMappable:
    """The colours of demand / capacity in %, as in all pictures; of infinity it is the darkest."""
    finite = values[np.isfinite(values)]
    most = float(max(100, finite.max(initial=0)))
    known = [(100 * share, tuple(part / 255 for part in ink)) for share, ink in USE]
    stops = [(value, ink) for value, ink in known if value <= 100]
    if most > 100:
        step = 2 * most / _SHADES  # exactly full has the colour of full
        stops[-1] = (100 + step, stops[-1][1])
        stops += [(100 + 2 * step, known[-2][1]), (max(most, 100 + 3 * step), known[-1][1])]
    colours = LinearSegmentedColormap.from_list(
        "use", [(value / stops[-1][0], ink) for value, ink in stops], N=_SHADES
    )
    shown = colours.with_extremes(over=STRAY, bad=NO_CAPACITY)
    return ScalarMappable(Normalize(0, stops[-1][0]), shown)


def label_of_use(values: NDArray[np.float64]) -> dict[str, Any]:
    """The label of a colour bar, and its arrow where demand without capacity is beyond it."""
    label = "demand / capacity [%]"
    if not np.isinf(values).any():
        return {"label": label}
    return {"label": f"{label}\n(arrow: no capacity)", "extend": "max"}


def show_use(
    axes: Axes,
    values: NDArray[Any],
    side: int,
    scale: ScalarMappable,
    corner: tuple[float, float] = (-0.5, -0.5),
) -> None:
    """Draws (X, Y) fields of ``side`` Gcells from a corner on."""
    left, bottom = corner
    wide, high = values.shape
    axes.imshow(
        # Demand without capacity is infinite, which matplotlib would take for missing.
        np.minimum(values, 1e9).T,
        origin="lower",
        extent=(left, left + wide * side, bottom, bottom + high * side),
        cmap=scale.cmap,
        vmin=0,
        vmax=scale.get_clim()[1],
        interpolation="nearest",
    )


def draw_congestion(axes: Axes, problem: Problem, solution: Solution, across: float) -> None:
    """Draws by Gcell the fullest of its edges towards +x and +y in all layers.

    ``across`` is about the width in inches.
    """
    values, side = congestion(problem, solution)
    scale = scale_of_use(values)
    show_use(axes, np.fmax.reduce(values, axis=(0, 1)), side, scale)
    axes.set(xlim=(-0.5, problem.grid[0] - 0.5), ylim=(-0.5, problem.grid[1] - 0.5))
    place = axes.inset_axes((1 + 0.1 / across, 0, 0.18 / across, 1))
    axes.figure.colorbar(scale, cax=place, **label_of_use(values))


def congestion_map(problem: Problem, solution: Solution, title: str) -> Figure:
    """How full edges are: all layers together, and layer by layer.

    The field of a Gcell has the colour of the fullest of its edges towards +x and +y. Layers
    without any route are named and not drawn. For a chip's design the tracks that shapes leave free
    in these layers follow, if they block any: stripes of power grids are seen there.

    Returns:
        Panels of one size, with one scale for use and one for tracks.
    """
    judged = evaluate(problem, solution)
    values, side = congestion(problem, solution)
    layers = np.fmax.reduce(values, axis=1)
    names = problem.chip_or_default.layers
    used = [z for z, layer in enumerate(layers) if np.nanmax(layer, initial=0) > 0]
    unused = [names[z] for z in range(len(layers)) if z not in used]
    panels = [("all layers", np.fmax.reduce(layers, axis=0))]
    panels += [(names[z], layers[z]) for z in used]
    tracks: list[tuple[str, NDArray[np.float64]]] = []
    if problem.chip is not None:
        free = free_tracks(problem)
        blocked = [z for z in used if np.nanmin(free[z], initial=100) < 100]
        tracks = [(f"tracks of {names[z]}", free[z]) for z in blocked]
    across = min(len(panels), 4 if len(panels) in (4, 7, 8) else 3)
    rows_of_use = -(-len(panels) // across)
    down = rows_of_use + -(-len(tracks) // across)
    columns, rows, _ = problem.grid
    ratio = float(np.clip(rows / columns, 0.3, 2))
    figure = Figure(
        figsize=(4.2 * across + 1, (3.9 * ratio + 0.5) * down + 0.7), layout="constrained"
    )
    heading = (
        f"{title}: overflow {judged.overflow}, wirelength {judged.wirelength} "
        f"({judged.vias} vias), {len(judged.disconnected)} open nets"
    )
    if unused:
        heading += f"\nno routes in {', '.join(unused)}"
    figure.suptitle(fitted(literal(heading), 4.2 * across, 12), fontsize=12)
    drawn = figure.subplots(down, across, squeeze=False)
    scale = scale_of_use(values)
    for axes, (name, own) in zip(drawn.flat, panels, strict=False):
        show_use(axes, own, side, scale)
        axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5), title=literal(name))
        axes.set(xlabel="x [Gcell]", ylabel="y [Gcell]")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    for axes in drawn[:rows_of_use].flat[len(panels) :]:
        axes.set_axis_off()
    shown = drawn[:rows_of_use]
    figure.colorbar(scale, ax=shown, shrink=0.9, aspect=40, **label_of_use(values))
    if tracks:
        _draw_tracks(figure, drawn[rows_of_use:], tracks, side)
    return figure


def _draw_tracks(figure: Figure, drawn: Any, tracks: Sequence[tuple[str, Any]], side: int) -> None:
    """Draws the tracks that are free in some layers, light where all are, as panels."""
    scale = ScalarMappable(Normalize(0, 100), "Greys_r")
    for axes, (name, own) in zip(drawn.flat, tracks, strict=False):
        show_use(axes, own, side, scale)
        axes.set(title=literal(name), xlabel="x [Gcell]", ylabel="y [Gcell]")
    for axes in drawn.flat[len(tracks) :]:
        axes.set_axis_off()
    label = "free tracks [% of most Gcells]"
    figure.colorbar(scale, ax=drawn, shrink=0.9, aspect=40, label=label)
