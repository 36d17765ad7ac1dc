"""Cutting: from a solution of a whole chip to the problems of its regions, and back."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from marouting import Problem, Solution
from marouting.problem.chip import Chip
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.net import Adjustment, Net, Pin

_SLACK = 0.1
"""How far a line may be from where it parts the work evenly, as a share of all work."""

_AGAIN = 9
"""About how often a net on a full edge is rerouted before all nets are rerouted once."""


class Box(NamedTuple):
    """Gcells of all layers between two lines across the chip.

    Attributes:
        axis: 0 if the lines go along y, so that columns are parted; 1 if rows are.
        low: the first column or row in it.
        high: the first one behind it.
    """

    axis: int
    low: int
    high: int


class Piece(NamedTuple):
    """The problem of a box, as arrays that are quickly sent.

    Attributes:
        grid: columns, rows and layers.
        capacity: (2, Z) of the edges along x and along y that are not adjusted.
        rules: (2, Z) minimum width and minimum spacing of wires.
        wires: (Z, 2) whether there may be wires along x and y; None if all may be.
        adjusted: (n,) edges with another capacity.
        adjusted_capacity: (n,) theirs.
        first: (nets + 1,) the pins of a net are those from its first to the first of the next.
        pin: (pins,) their Gcells.
        width: (nets,) minimum width of the nets' wires.
        net: (uses,) the net of every use of an edge as the routes are now, ascending.
        edge: (uses,) the edge, ascending for each net.
        priced: (m,) edges with a price.
        price: (m,) what past overflow adds to their cost, in edges.
    """

    grid: tuple[int, int, int]
    capacity: NDArray[np.int32]
    rules: NDArray[np.int32]
    wires: NDArray[np.bool_] | None
    adjusted: NDArray[np.int32]
    adjusted_capacity: NDArray[np.int32]
    first: NDArray[np.int32]
    pin: NDArray[np.int32]
    width: NDArray[np.int32]
    net: NDArray[np.int32]
    edge: NDArray[np.int32]
    priced: NDArray[np.int32]
    price: NDArray[np.float32]

    @property
    def size(self) -> int:
        """The bytes of its arrays."""
        return sum(part.nbytes for part in self if isinstance(part, np.ndarray))

    def problem(self) -> Problem:
        """The problem; a Gcell is a unit wide."""
        x, y, z = np.unravel_index(self.pin, self.grid)
        pins = [Pin(*at) for at in zip(x.tolist(), y.tolist(), (z + 1).tolist(), strict=True)]
        bounds = self.first.tolist()
        nets = tuple(
            Net(str(i), i, tuple(pins[bounds[i] : bounds[i + 1]]), width)
            for i, width in enumerate(self.width.tolist())
        )
        near = np.stack(np.unravel_index(self.adjusted // AXES, self.grid), axis=1)
        far = near.copy()
        far[np.arange(len(far)), self.adjusted % AXES] += 1
        near[:, VIA_AXIS] += 1  # layers count from 1 there
        far[:, VIA_AXIS] += 1
        table = np.column_stack((near, far, self.adjusted_capacity))
        chip = None
        if self.wires is not None:
            names = tuple(map(str, range(self.grid[2])))
            columns, rows = (np.arange(size + 1, dtype=np.int64) for size in self.grid[:2])
            chip = Chip(names, columns, rows, self.wires)
        return Problem(
            grid=self.grid,
            horizontal_capacity=tuple(self.capacity[0].tolist()),
            vertical_capacity=tuple(self.capacity[1].tolist()),
            nets=nets,
            min_width=tuple(self.rules[0].tolist()),
            min_spacing=tuple(self.rules[1].tolist()),
            via_spacing=(0,) * self.grid[2],
            adjustments=tuple(map(Adjustment._make, table.tolist())),
            chip=chip,
        )


def work(solution: Solution) -> NDArray[np.float64]:
    """About how much work negotiation has with each use of an edge: more where nets overflow.

    Returns:
        (uses,) 1 for a net that nothing disturbs.
    """
    problem = solution.problem
    net, edge = solution.uses
    used, tracks = solution.used_edges
    full = used[(used % AXES != VIA_AXIS) & (tracks > problem.capacity_of(used))]
    disturbed = np.zeros(len(problem.nets), np.bool_)
    disturbed[net[np.isin(edge, full)]] = True
    return np.where(disturbed[net], 1.0 + _AGAIN, 1.0)


def work_inside(solution: Solution, boxes: Sequence[Box]) -> NDArray[np.float64]:
    """The :func:`work` in each of several boxes with the same axis."""
    problem, axis = solution.problem, boxes[0].axis
    at = solution.uses[1] // AXES // problem.strides[axis] % problem.grid[axis]
    upto = np.bincount(at, work(solution), problem.grid[axis]).cumsum()
    upto = np.concatenate(([0.0], upto))
    return np.array([upto[box.high] - upto[box.low] for box in boxes])


def lines(solution: Solution, regions: int) -> tuple[int, list[int]]:
    """Where to cut a chip: axis and places of ``regions`` - 1 lines.

    Each is where the fewest wires cross, of those places near where the work is parted evenly.

    Returns:
        The axis of the wires that are cut, and for each line, ascending, the column or row behind
        it. Fewer lines if there is no room for them.
    """
    problem = solution.problem
    edge = solution.uses[1]
    places = np.unravel_index(edge // AXES, problem.grid)
    weight = work(solution)
    found = []
    for axis in range(VIA_AXIS):
        size = problem.grid[axis]
        crossing = np.bincount(places[axis][edge % AXES == axis], minlength=size)
        upto = np.bincount(places[axis], weight, size).cumsum() / max(weight.sum(), 1.0)
        at: list[int] = []
        for i in range(1, regions):
            share = np.abs(upto[:-1] - i / regions)
            near = np.flatnonzero(share <= max(_SLACK / regions, share.min()))
            line = int(near[crossing[near].argmin()]) + 1
            if line - (at[-1] if at else 0) >= LEAST and size - line >= LEAST:
                at.append(line)
        found.append((-len(at), int(crossing[np.array(at, np.int64) - 1].sum()), axis, at))
    *_, axis, best = min(found)
    return axis, best


LEAST = 8
"""Columns or rows of the smallest region."""


def cut(
    solution: Solution, prices: NDArray[np.float32], box: Box
) -> tuple[Piece, NDArray[np.int64]]:
    """The problem of a box: its parts of the nets, as the routes leave the box now.

    The parts of a net in the box are those that its edges in the box join, and each becomes a net.

    Args:
        solution: the routes.
        prices: (E,) what past overflow adds to the cost of every edge of the chip, in edges.
        box: the box.

    Returns:
        The problem, and the net of each of its nets. Parts with all pins in one Gcell are left out.
    """
    problem = solution.problem
    gcells = int(np.prod(problem.grid))
    net, edge = solution.uses
    near, axis = np.divmod(edge, AXES)
    far = near + problem.strides[axis]
    from_inside, to_inside = (_inside(problem, box, gcell) for gcell in (near, far))
    both = from_inside & to_inside
    first, pin = problem.flat_pin_gcells
    owner = np.repeat(np.arange(len(problem.nets)), np.diff(first))
    own = _inside(problem, box, pin)
    ends = np.concatenate(
        (
            owner[own] * gcells + pin[own],
            (net * gcells + near)[from_inside & ~to_inside],
            (net * gcells + far)[to_inside & ~from_inside],
        )
    )
    ways = np.concatenate(((net * gcells + near)[both], (net * gcells + far)[both]))
    vertex, number = np.unique(np.concatenate((ways, ends)), return_inverse=True)
    a, b = number[: len(ways)].reshape(2, -1)
    links = csr_array((np.ones(len(a), np.int8), (a, b)), shape=(len(vertex), len(vertex)))
    _, part = connected_components(links, directed=False)
    # Each Gcell of a part that is an end of it, once, part by part.
    end = np.unique(number[len(ways) :])
    end = end[np.argsort(part[end], kind="stable")]
    parts, counts = np.unique(part[end], return_counts=True)
    several = parts[counts > 1]
    end, counts = end[np.isin(part[end], several)], counts[counts > 1]
    # What these parts use now.
    routed = np.isin(part[a], several)
    number_of = np.searchsorted(several, part[a[routed]])
    used = _local_edges(problem, box, edge[both][routed])
    order = np.lexsort((used, number_of))
    starts = np.concatenate(([0], np.cumsum(counts)))
    nets = vertex[end[starts[:-1]]] // gcells
    adjusted, capacity = problem.adjusted
    there = _within(problem, box, adjusted)
    priced = np.flatnonzero(prices)
    priced = priced[_within(problem, box, priced)]
    width = np.fromiter((problem.nets[i].min_width for i in nets.tolist()), np.int32, len(nets))
    piece = Piece(
        grid=_grid(problem, box),
        capacity=problem.layer_capacity[:, :VIA_AXIS].T.copy(),
        rules=np.array((problem.min_width, problem.min_spacing), np.int32),
        wires=None if problem.chip is None else problem.chip.wires,
        adjusted=_local_edges(problem, box, adjusted[there]),
        adjusted_capacity=capacity[there],
        first=starts.astype(np.int32),
        pin=_local(problem, box, vertex[end] % gcells).astype(np.int32),
        width=width,
        net=number_of[order].astype(np.int32),
        edge=used[order],
        priced=_local_edges(problem, box, priced),
        price=prices[priced],
    )
    return piece, nets


def joined(
    solution: Solution, box: Box, net: NDArray[np.int64], edge: NDArray[np.int32]
) -> Solution:
    """The solution with other routes in a box.

    Args:
        solution: the routes.
        box: the box.
        net: (uses,) the net of each use of an edge in the box.
        edge: (uses,) the edge, by its number in the box's problem.
    """
    problem = solution.problem
    kept_net, kept_edge = solution.uses
    inside = _within(problem, box, kept_edge)
    size = AXES * int(np.prod(problem.grid))
    uses = np.concatenate((
        kept_net[~inside] * size + kept_edge[~inside], net * size + chip_edges(problem, box, edge)
    ))  # fmt: skip
    return Solution.of_uses(problem, *np.divmod(np.unique(uses), size))


def figures(solution: Solution) -> tuple[int, int]:
    """Overflow in tracks, and wirelength; less is better."""
    edge, tracks = solution.used_edges
    wires = edge % AXES != VIA_AXIS
    over = tracks[wires] - solution.problem.capacity_of(edge[wires])
    return int(np.maximum(over, 0).sum()), len(solution.uses[1])


def _grid(problem: Problem, box: Box) -> tuple[int, int, int]:
    size = list(problem.grid)
    size[box.axis] = box.high - box.low
    return size[0], size[1], size[2]


def _inside(problem: Problem, box: Box, gcell: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether Gcells are in a box."""
    at = gcell // problem.strides[box.axis] % problem.grid[box.axis]
    inside: NDArray[np.bool_] = (at >= box.low) & (at < box.high)
    return inside


def _local(problem: Problem, box: Box, gcell: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers that Gcells of a box have in its problem."""
    at = list(np.unravel_index(gcell, problem.grid))
    at[box.axis] = at[box.axis] - box.low
    return np.ravel_multi_index(tuple(at), _grid(problem, box)).astype(np.int64)


def _within(problem: Problem, box: Box, edge: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether both ends of edges are in a box."""
    near, axis = np.divmod(edge, AXES)
    return _inside(problem, box, near) & _inside(problem, box, near + problem.strides[axis])


def chip_edges(problem: Problem, box: Box, edge: NDArray[np.int32]) -> NDArray[np.int64]:
    """The numbers that edges of a box's problem have in the chip."""
    x, y, z = np.unravel_index(edge // AXES, _grid(problem, box))
    at = [x.astype(np.int64), y.astype(np.int64)]
    at[box.axis] += box.low
    gcell = at[0] * problem.strides[0] + at[1] * problem.strides[1] + z
    return AXES * gcell + edge % AXES


def _local_edges(problem: Problem, box: Box, edge: NDArray[np.int64]) -> NDArray[np.int32]:
    return (AXES * _local(problem, box, edge // AXES) + edge % AXES).astype(np.int32)
