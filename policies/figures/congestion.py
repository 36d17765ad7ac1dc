"""Congestion maps: what is drawn of routes that are too many to be told apart."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from marouting.problem.grid import AXES
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution, evaluate
from policies.figures.style import MAGENTA, literal
from policies.results.utilisation import MOST_FIELDS

MOST_NETS = 1000
"""The most nets that are drawn one by one."""

_NO_CAPACITY = "#D3D6DC"


def crowded(problem: Problem) -> bool:
    """Whether a problem has too many nets to draw each."""
    return len(problem.nets) > MOST_NETS


def crowded_note(problem: Problem) -> str:
    """What titles say of a map that stands for a drawing of routes."""
    return f"{len(problem.nets)} nets are too many to draw: congestion map"


def congestion(
    problem: Problem, solution: Solution, most: int = MOST_FIELDS
) -> tuple[NDArray[np.float64], int]:
    """Demand / capacity in %, of the fullest edge in each field of each layer.

    Args:
        problem: the problem, which gives the capacities.
        solution: the routes.
        most: the most fields along x and y; on longer grids a field is a square of Gcells.

    Returns:
        (Z, X, Y) float64, of the edges from each Gcell towards +x and +y; NaN without capacity or
        demand, infinite for demand without capacity. Then how many Gcells a field is wide and high,
        by which X and Y are divided, rounded up.
    """
    columns, rows, layers = problem.grid
    side = -(-max(columns, rows) // most)
    shape = (layers, -(-columns // side), -(-rows // side))
    found = np.full(shape, np.nan)

    def at(edges: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
        x, y = np.divmod(edges // (AXES * layers), rows)
        return edges // AXES % layers, x // side, y // side

    # Where there is capacity and no demand; a layer's edges are alike but for adjustments.
    adjusted, capacity = problem.adjusted
    found[(problem.layer_capacity[:, :2] > 0).any(axis=1)] = 0
    np.fmax.at(found, at(adjusted), np.where(capacity > 0, 0, np.nan))
    edge, demand = solution.used_edges
    demand = np.where(edge % AXES == 2, 0, demand)
    edge, demand = edge[demand > 0], demand[demand > 0]
    with np.errstate(divide="ignore"):
        share = 100 * demand / problem.capacity_of(edge)
    np.fmax.at(found, at(edge), share)
    return found, side


def _colours(values: NDArray[np.float64]) -> ScalarMappable:
    """Blue up to 100 %, the darker the fuller; above, orange to dark red; infinity is purple."""
    finite = values[np.isfinite(values)]
    most = float(max(100, finite.max(initial=0)))
    full = 100 / most
    stops = [(0.0, "#F2F5FA"), (full / 2, "#8FB4D9"), (full, "#123A75")]
    if most > 100:
        stops += [(full + 1e-4 * (1 - full), "#F7A52B"), (1.0, "#8C0D0D")]
    colours = LinearSegmentedColormap.from_list("congestion", stops, N=1024)
    return ScalarMappable(Normalize(0, most), colours.with_extremes(over=MAGENTA, bad=_NO_CAPACITY))


def _label(values: NDArray[np.float64]) -> dict[str, Any]:
    """The label of a colour bar, and its arrow where demand without capacity is beyond it."""
    label = "demand / capacity [%] of the fullest edge"
    if not np.isinf(values).any():
        return {"label": label}
    return {"label": f"{label} (arrow: demand without capacity)", "extend": "max"}


def _show(
    axes: Axes, problem: Problem, values: NDArray[np.float64], side: int, scale: ScalarMappable
) -> None:
    """Draws (squares along x, along y) values in percent, of squares of ``side`` Gcells."""
    wide, high = values.shape
    axes.imshow(
        # Demand without capacity is infinite, which matplotlib would take for missing.
        np.minimum(values, 1e9).T,
        origin="lower",
        extent=(-0.5, wide * side - 0.5, -0.5, high * side - 0.5),
        cmap=scale.cmap,
        vmin=0,
        vmax=scale.get_clim()[1],
        interpolation="nearest",
    )
    axes.set(xlim=(-0.5, problem.grid[0] - 0.5), ylim=(-0.5, problem.grid[1] - 0.5))


def draw_congestion(axes: Axes, problem: Problem, solution: Solution, across: float) -> None:
    """Draws the fullest edge of all layers by Gcell; ``across`` is about the width in inches."""
    values, side = congestion(problem, solution)
    scale = _colours(values)
    _show(axes, problem, np.fmax.reduce(values, axis=0), side, scale)
    place = axes.inset_axes((1 + 0.1 / across, 0, 0.18 / across, 1))
    axes.figure.colorbar(scale, cax=place, **_label(values))


def congestion_map(problem: Problem, solution: Solution, title: str) -> Figure:
    """The use of every Gcell's fullest edge, over all layers and layer by layer.

    Returns:
        A large panel for all layers, and a small one for each.
    """
    judged = evaluate(problem, solution)
    values, side = congestion(problem, solution)
    layers = len(values)
    scale = _colours(values)
    across = min(4, -(-layers // 3))
    down = -(-layers // across)
    figure = Figure(figsize=(6.4 + 2.1 * across, max(5.4, 2 * down)), layout="constrained")
    figure.suptitle(
        literal(
            f"{title}: overflow {judged.overflow}, wirelength {judged.wirelength} "
            f"({judged.vias} vias), {len(judged.disconnected)} open nets"
        ),
        fontsize=12,
    )
    parts: Any = figure.subfigures(1, 2, width_ratios=(6, 2.1 * across))
    large, small = parts
    names = problem.chip_or_default.layers
    panels = [large.subplots()]
    panels += list(np.ravel(small.subplots(down, across, squeeze=False)))
    maps = [np.fmax.reduce(values, axis=0), *values]
    for number, axes in enumerate(panels):
        if number >= len(maps):
            axes.set_axis_off()
            continue
        _show(axes, problem, maps[number], side, scale)
        if number:
            axes.set_title(literal(names[number - 1]), fontsize=9)
            axes.tick_params(labelsize=7)
        else:
            axes.set(xlabel="column of Gcells", ylabel="row of Gcells", title="all layers")
    figure.colorbar(scale, ax=panels[0], shrink=0.8, location="left", pad=0.02, **_label(values))
    return figure
