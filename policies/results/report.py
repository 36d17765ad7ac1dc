"""What a solution does with a chip: wire and vias by layer, hot spots, detours, use of edges."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting import Problem, Solution, evaluate
from marouting.problem.grid import AXES, VIA_AXIS, distinct
from marouting.trees.decomposition import Decomposition, tasks_between
from marouting.trees.steiner import EXACT_PINS
from policies.results.utilisation import EdgeGroups, edge_groups, histogram_counts

MOST_SPOTS = 10
"""Hot spots, and detours, that a report lists."""

MOST_NAMES = 20
"""Nets that a hot spot names."""

_WAYS = {
    (False, False): "none",
    (True, False): "horizontal",
    (False, True): "vertical",
    (True, True): "both",
}


def report(solution: Solution) -> dict[str, Any]:
    """The report on a solution of a problem, as plain data.

    Returns:
        ``overflow``, ``max_overflow``, ``wirelength``, ``vias`` and ``connected`` as
        :func:`marouting.evaluate` judges them; ``wires``, the wirelength without vias;
        ``overflowed_edges``; ``open_nets``, names. ``layers``: a row for each. ``hot_spots``: the
        edges with most overflow, then those with the largest share of their capacity in use, and
        the nets that meet there. ``detours``: how much longer than a lower bound wires are (without
        vias), and the nets with most. ``histogram``: edges by use.
    """
    problem = solution.problem
    judged = evaluate(problem, solution)
    groups = edge_groups(problem, solution)
    return {
        "grid": list(problem.grid),
        "nets": len(problem.nets),
        "overflow": judged.overflow,
        "max_overflow": judged.max_overflow,
        "overflowed_edges": int(groups.number[groups.demand > groups.capacity].sum()),
        "wirelength": judged.wirelength,
        "wires": judged.wirelength - judged.vias,
        "vias": judged.vias,
        "connected": judged.connected,
        "open_nets": list(judged.disconnected),
        "layers": list(_layers(problem, solution, groups)),
        "hot_spots": list(_hot_spots(problem, solution)),
        "detours": _detours(problem, solution, set(judged.disconnected)),
        "histogram": _histogram(problem, solution),
    }


def _layers(problem: Problem, solution: Solution, groups: EdgeGroups) -> Iterator[dict[str, Any]]:
    chip = problem.chip_or_default
    layers = problem.grid[2]
    _, edge = solution.uses
    layer, axis = edge // AXES % layers, edge % AXES
    # Groups of edges that are not in use nor adjusted come last, by layer and axis.
    layer_of = np.where(
        groups.edge >= 0,
        groups.edge // AXES % layers,
        (np.arange(len(groups.edge)) - (len(groups.edge) - 2 * layers)) // 2,
    )
    capacity = np.bincount(layer_of, groups.capacity * groups.number, layers)
    demand = np.bincount(layer_of, groups.demand * groups.number, layers)
    over = np.maximum(groups.demand - groups.capacity, 0) * groups.number
    overflow = np.bincount(layer_of, over, layers)
    wires = np.bincount(layer[axis != VIA_AXIS], minlength=layers)
    vias = np.bincount(layer[axis == VIA_AXIS], minlength=layers)
    for z, name in enumerate(chip.layers):
        yield {
            "layer": name,
            "direction": _WAYS[bool(chip.wires[z, 0]), bool(chip.wires[z, 1])],
            "wires": int(wires[z]),
            "vias_up": int(vias[z]),
            "demand": int(demand[z]),
            "capacity": int(capacity[z]),
            "overflow": int(overflow[z]),
        }


def _hot_spots(problem: Problem, solution: Solution) -> Iterator[dict[str, Any]]:
    chip = problem.chip_or_default
    edges, tracks = solution.used_edges
    wire = edges % AXES != VIA_AXIS
    edges, tracks = edges[wire], tracks[wire]
    capacity = problem.capacity_of(edges).astype(np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(tracks > 0, tracks / capacity, 0.0)
    worst = np.lexsort((edges, -share, -np.maximum(tracks - capacity, 0)))[:MOST_SPOTS]
    net, edge = solution.uses
    for at in worst.tolist():
        here, axis = int(edges[at]) // AXES, int(edges[at]) % AXES
        near = [int(i) for i in np.unravel_index(here, problem.grid)]
        far = [near[i] + (i == axis) for i in (0, 1)]
        names = [problem.nets[i].name for i in net[edge == edges[at]].tolist()]
        yield {
            "layer": chip.layers[near[2]],
            "from": near[:2],
            "to": far,
            "at": [
                int(chip.x[far[0]] if axis == 0 else (chip.x[near[0]] + chip.x[near[0] + 1]) // 2),
                int(chip.y[far[1]] if axis == 1 else (chip.y[near[1]] + chip.y[near[1] + 1]) // 2),
            ],
            "demand": int(tracks[at]),
            "capacity": int(capacity[at]),
            "overflow": int(max(0, tracks[at] - capacity[at])),
            "nets": len(names),
            "names": names[:MOST_NAMES],
        }


def _detours(problem: Problem, solution: Solution, without: set[str]) -> dict[str, Any]:
    """Wires beyond the lower bound; nets in ``without``, which are not joined, are left out."""
    net, edge = solution.uses
    wires = np.bincount(net[edge % AXES != VIA_AXIS], minlength=len(problem.nets))
    bound, exact = steiner_bounds(problem)
    judged = np.array([own.name not in without for own in problem.nets])
    more = np.where(judged, wires - bound, 0)
    worst = np.lexsort((np.arange(len(more)), -more))[:MOST_SPOTS]
    return {
        "wires": int(wires[judged].sum()),
        "bound": int(bound[judged].sum()),
        "nets_with": int(np.count_nonzero(more)),
        "worst": [
            {
                "net": problem.nets[i].name,
                "wires": int(wires[i]),
                "bound": int(bound[i]),
                "detour": int(more[i]),
                "exact": bool(exact[i]),
            }
            for i in worst.tolist()
            if more[i]
        ],
    }


def steiner_bounds(problem: Problem) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(nets,) twice: a bound from below on each net's edges inside layers, and whether it is exact.

    Seen from above, a route is a tree that joins the columns of Gcells with the net's pins. For
    nets of up to EXACT_PINS such columns the bound is the length of a shortest one, which a route
    can have where capacity allows. For others, which may well need a tenth more, it is the larger
    of half the perimeter of the box around them and of two thirds of their minimum
    spanning tree (Hwang 1976), rounded up.
    """
    grid = (*problem.grid[:2], 1)
    columns = int(np.prod(grid))
    key = distinct(problem.net_of_pins * columns + problem.gcell_of_pins // problem.grid[2])
    first = np.searchsorted(key, columns * np.arange(len(problem.nets) + 1))
    few = np.diff(first) <= EXACT_PINS
    bound = np.empty(len(few), np.int64)
    bound[few] = _tree_lengths(key % columns, first, few, grid, "steiner")
    spanning = _tree_lengths(key % columns, first, ~few, grid, "mst")
    half = problem.half_perimeters
    bound[~few] = np.maximum(half[~few], -(-2 * spanning // 3))
    return bound, few


def _tree_lengths(
    gcells: NDArray[np.int64],
    first: NDArray[np.int64],
    nets: NDArray[np.bool_],
    grid: tuple[int, int, int],
    kind: Decomposition,
) -> NDArray[np.int64]:
    """The lengths of trees in one layer, of some of the nets with pins in ``gcells``."""
    pins = np.diff(first)
    if not nets.any():
        return np.empty(0, np.int64)
    bounds = np.concatenate(([0], np.cumsum(pins[nets])))
    tasks = tasks_between(bounds, gcells[np.repeat(nets, pins)], grid, kind)
    net, start, end = tasks.astype(np.int64).T
    rows = grid[1]
    length = np.abs(start // rows - end // rows) + np.abs(start % rows - end % rows)
    return np.bincount(net, length, len(bounds) - 1).astype(np.int64)


def _histogram(problem: Problem, solution: Solution) -> list[dict[str, Any]]:
    """Edges with capacity by use; ``to`` is not included, None at the end stands for no limit."""
    counts = histogram_counts(problem, solution)
    starts: list[int] = [*range(0, 110, 10), 100]
    ends: list[int | None] = [*range(10, 110, 10), 100, None]
    return [
        {"from": start, "to": end, "horizontal": int(along), "vertical": int(across)}
        for start, end, (along, across) in zip(starts, ends, counts.T, strict=True)
    ]
