"""A page to look at a problem and its solutions in a browser: routes in 3-D, and heat maps."""

import base64
import html
import importlib.resources
import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.memory import DRAWN, check_memory
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.problem import Problem
from marouting.problem.segments import longest_segments
from marouting.problem.solution import Solution, evaluate
from marouting.render import PALETTE
from policies.figures.routes import shifts

MOST_GCELLS = 2**21
"""The most Gcells of a page; a browser draws no more heat maps than these need."""


def page(problem: Problem, solutions: Mapping[str, Solution], title: str = "") -> str:
    """A page that shows solutions of a problem, complete in itself: it loads nothing.

    Two solutions are side by side; of more than two, one is on the left and a slider leads through
    all of them on the right. All drawings turn and zoom together.

    Args:
        problem: the problem.
        solutions: its solutions by name, in the order of the slider; at least one.
        title: the problem's name.

    Returns:
        HTML with plotly.js in it; the same for the same input and version of plotly.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise InputError("view: expected plotly: pip install 'marouting[view]'") from None
    # What stands in a script ends at no tag, so no name can start one.
    data = json.dumps(page_data(problem, solutions, title), separators=(",", ":"))
    parts = {
        # The name of a file may hold what is no character.
        "title": html.escape(title or "marouting").encode("ascii", "xmlcharrefreplace").decode(),
        "data": data.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026"),
        "plotly": get_plotlyjs().replace("</script", r"<\/script"),
    }
    template = importlib.resources.files("policies.figures").joinpath("view.html")
    # All at once: names may contain any text.
    return re.sub(r"{{(\w+)}}", lambda place: parts[place[1]], template.read_text(encoding="utf-8"))


def page_data(problem: Problem, solutions: Mapping[str, Solution], title: str) -> dict[str, Any]:
    """What a page shows, as plain data; arguments and errors are those of :func:`page`.

    Arrays are pairs of a type and base64 of their bytes.

    Returns:
        ``grid``; ``nets``, their names; ``palette``, colours as in CSS, repeated over the nets;
        ``shift``, of every net within its Gcells; ``pins``; ``maps``, the kinds of edges with
        capacity or demand, each with the capacity of its edges; ``solutions``, each with its
        figures, its straight runs of edges, and the demand on the edges of every map.
    """
    if not solutions:
        raise InputError("view: expected at least one solution")
    for name, solution in solutions.items():
        if (solution.problem.grid, solution.problem.nets) != (problem.grid, problem.nets):
            raise InputError(f"view: {name}: expected a solution of this problem")
    columns, rows, layers = problem.grid
    if columns * rows * layers > MOST_GCELLS:
        raise InputError(
            f"view: expected at most {MOST_GCELLS} Gcells, found {columns}x{rows}x{layers}"
        )
    drawn = sum(len(solution.uses[1]) for solution in solutions.values())
    check_memory(DRAWN * drawn, "a page with drawings of {} edges", drawn)

    first, gcell = problem.flat_pin_gcells
    demands = [_by_axis(problem, solution.edge_demand) for solution in solutions.values()]
    capacities = _by_axis(problem, problem.capacity)
    maps = [
        (layer, axis)
        for layer in range(layers)
        for axis in range(VIA_AXIS)
        if any(table[axis][..., layer].any() for table in (capacities, *demands))
    ]
    return {
        "title": title,
        "grid": list(problem.grid),
        "nets": [net.name for net in problem.nets],
        "palette": [f"rgb({r},{g},{b})" for r, g, b in PALETTE.tolist()],
        "shift": _array(shifts(problem, list(solutions.values()))[0].astype(np.float32)),
        "pins": {
            "net": _array(np.repeat(np.arange(len(problem.nets)), np.diff(first))),
            **_positions(problem, gcell),
        },
        "maps": [
            {"layer": z + 1, "axis": axis, "capacity": _array(capacities[axis][..., z])}
            for z, axis in maps
        ],
        "solutions": [
            {
                "name": name,
                **_figures(problem, solution),
                **_runs(problem, solution),
                "demand": [_array(demand[axis][..., z]) for z, axis in maps],
            }
            for (name, solution), demand in zip(solutions.items(), demands, strict=True)
        ],
    }


def _by_axis(problem: Problem, edges: NDArray[Any]) -> list[NDArray[Any]]:
    """A table of all edges (E,) as one of those along x, (X − 1, Y, Z), and y, (X, Y − 1, Z)."""
    table = edges.reshape(*problem.grid, AXES)
    return [table[:-1, :, :, 0], table[:, :-1, :, 1]]


def _figures(problem: Problem, solution: Solution) -> dict[str, Any]:
    found = evaluate(problem, solution)
    number = {net.name: n for n, net in enumerate(problem.nets)}
    lengths = np.bincount(solution.uses[0], minlength=len(problem.nets))
    return {
        "overflow": found.overflow,
        "max_overflow": found.max_overflow,
        "wirelength": found.wirelength,
        "vias": found.vias,
        "open": [number[name] for name in found.disconnected],
        "wirelength_of": _array(lengths),
    }


def _runs(problem: Problem, solution: Solution) -> dict[str, Any]:
    """The longest straight runs of every net: net, lower end, axis, and length in edges."""
    net, points = longest_segments(problem, *solution.uses)
    ends = problem.gcells(points.reshape(-1, 3)).reshape(-1, 2)
    position = np.stack(np.unravel_index(ends, problem.grid), axis=-1)
    span = position[:, 1] - position[:, 0]
    return {
        "net": _array(net),
        **_positions(problem, ends[:, 0]),
        "axis": _array(span.argmax(axis=1)),
        "length": _array(span.sum(axis=1)),
    }


def _positions(problem: Problem, gcells: NDArray[np.int64]) -> dict[str, list[str]]:
    """x, y and layer from 0 of Gcells."""
    return dict(zip("xyz", map(_array, np.unravel_index(gcells, problem.grid)), strict=True))


def _array(values: NDArray[Any]) -> list[str]:
    """The smallest type that holds the values of an array, and base64 of its bytes."""
    if values.dtype.kind != "f":
        values = values.clip(max=2**32 - 1)
        values = values.astype(np.min_scalar_type(int(values.max(initial=0))))
    values = np.ascontiguousarray(values)
    kind = values.dtype.newbyteorder("<")
    return [kind.str[1:], base64.b64encode(values.astype(kind).tobytes()).decode("ascii")]
