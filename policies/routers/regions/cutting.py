"""Cutting: from a solution of a whole chip to the problems of its regions, and back."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from marouting import Problem, Solution
from marouting.problem.chip import Chip
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.net import Adjustment, Net, Pin

LEAST = 8
"""Columns or rows between two lines, at least."""

_REACH = 0.04
"""How far regions reach beyond their lines, as a share of a region of mean width."""

_ASIDE = 0.125
"""How far the first lines may be from where regions are as wide as each other, as a share of a
region."""

_AGAIN = 49
"""How much more work the wire of a net on a full edge is than that of others, which stay."""


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
        shared: (k,) edges of which others have some tracks.
        taken: (k,) how many of them.
        first: (nets + 1,) the pins of a net are those from its first to the first of the next.
        pin: (pins,) their Gcells.
        width: (nets, Z) minimum width of the nets' wires.
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
    shared: NDArray[np.int32]
    taken: NDArray[np.int32]
    first: NDArray[np.int32]
    pin: NDArray[np.int32]
    width: NDArray[np.int32]
    net: NDArray[np.int32]
    edge: NDArray[np.int32]
    priced: NDArray[np.int32]
    price: NDArray[np.float32]

    def problem(self) -> Problem:
        """The problem; a Gcell is a unit wide."""
        x, y, z = np.unravel_index(self.pin, self.grid)
        pins = [Pin(*at) for at in zip(x.tolist(), y.tolist(), (z + 1).tolist(), strict=True)]
        bounds = self.first.tolist()
        nets = tuple(
            Net(str(i), i, tuple(pins[bounds[i] : bounds[i + 1]]), tuple(width))
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


class Division(NamedTuple):
    """A chip in regions between lines, and which of them moves which net.

    Attributes:
        axis: across which the lines go: 0 if they part columns, 1 if rows.
        lines: for each line, ascending, the column or row behind it.
        reach: how far regions reach beyond their lines, in columns or rows.
        owner: (nets,) the region that moves a net: the one that has the middle of its pins.
        work: (regions,) about how much work each has, in edges of nets that stay.
    """

    axis: int
    lines: tuple[int, ...]
    reach: int
    owner: NDArray[np.int64]
    work: NDArray[np.float64]

    @classmethod
    def calm(cls, solution: Solution, axes: Sequence[int], regions: int) -> Self:
        """Lines where the fewest nets on full edges cross; regions are about as wide as each other.

        Args:
            solution: the routes.
            axes: across which the lines may go.
            regions: how many regions, at most: fewer if there is no room for them.
        """
        problem = solution.problem
        net, edge = solution.uses
        edge = edge[_disturbed(solution)[net]]
        found = []
        for axis in axes:
            size = problem.grid[axis]
            own = edge[edge % AXES == axis]
            at = own // AXES // problem.strides[axis] % size
            crossing = np.bincount(at + 1, minlength=size)  # by the line behind which they end
            parts = min(regions, size // LEAST)
            lines, total = [], 0
            for i in range(1, parts):
                low = round(size * (i - _ASIDE) / parts)
                high = max(round(size * (i + _ASIDE) / parts), low + 1)
                lines.append(low + int(crossing[low:high].argmin()))
                total += int(crossing[lines[-1]])
            found.append((1 - parts, total, axis, lines))
        *_, axis, lines = min(found)
        return cls._between(solution, axis, lines, regions)

    @classmethod
    def even(cls, solution: Solution, axis: int, regions: int) -> Self:
        """Lines that part the work evenly.

        Args:
            solution: the routes.
            axis: across which the lines go.
            regions: how many regions, at most: fewer if there is no room for them.
        """
        size = solution.problem.grid[axis]
        upto = np.bincount(_middle(solution.problem, axis), _work(solution), size).cumsum()
        lines: list[int] = []
        for i in range(1, regions):
            line = int(np.searchsorted(upto, upto[-1] * i / regions)) + 1
            line = max(line, LEAST + (lines[-1] if lines else 0))
            if size - line >= LEAST:
                lines.append(line)
        return cls._between(solution, axis, lines, regions)

    @classmethod
    def _between(cls, solution: Solution, axis: int, lines: list[int], regions: int) -> Self:
        middle = _middle(solution.problem, axis)
        owner = np.searchsorted(np.array(lines, np.int64), middle, side="right")
        reach = max(round(_REACH * solution.problem.grid[axis] / regions), 1)
        work = np.bincount(owner, _work(solution), len(lines) + 1).astype(np.float64)
        return cls(axis, tuple(lines), reach, owner, work)

    def box(self, region: int, size: int) -> Box:
        """Where a region may move its nets, on a chip of so many columns or rows."""
        low = self.lines[region - 1] - self.reach if region else 0
        high = self.lines[region] + self.reach if region < len(self.lines) else size
        return Box(self.axis, max(low, 0), min(high, size))

    def share_upto(self, region: int, at: NDArray[np.int64]) -> NDArray[np.float64]:
        """How many of the free tracks at columns or rows belong to this region or one before it.

        Half of them at a line, and evenly less or more across the reach of the regions beside it.
        """
        if region < 0 or region >= len(self.lines):
            return np.full(len(at), float(region >= 0))
        behind = (at + 0.5 - self.lines[region]) / (2 * self.reach)
        return np.clip(0.5 - behind, 0.0, 1.0)


def _middle(problem: Problem, axis: int) -> NDArray[np.int64]:
    """(nets,) the column or row of the middle of a net's pins."""
    middle: NDArray[np.int64] = problem.pin_boxes()[:, :, axis].sum(axis=0) // 2
    return middle


def _disturbed(solution: Solution) -> NDArray[np.bool_]:
    """(nets,) whether a net uses an edge that overflows."""
    problem = solution.problem
    net, edge = solution.uses
    used, tracks = solution.used_edges
    full = np.zeros(AXES * int(np.prod(problem.grid)), np.bool_)
    full[used] = (used % AXES != VIA_AXIS) & (tracks > problem.capacity_of(used))
    disturbed = np.zeros(len(problem.nets), np.bool_)
    disturbed[net[full[edge]]] = True
    return disturbed


def _work(solution: Solution) -> NDArray[np.float64]:
    """(nets,) about how much work negotiation has with a net: its wire, more if it overflows."""
    wire = np.bincount(solution.uses[0], minlength=len(solution.problem.nets)).astype(np.float64)
    return wire * np.where(_disturbed(solution), 1.0 + _AGAIN, 1.0)


def taken_from(
    solution: Solution, division: Division, region: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The tracks in a region's box that it may not use.

    What nets use that nobody moves there is not to be had. Of each edge the regions share the rest:
    each has what its own nets use, and of what is free as much as :meth:`Division.share_upto` says;
    where it is too little for all, each has to give up as large a share. Together they have no more
    than there is, unless nets that nobody moves overflow. So what all regions find fits together.

    Returns:
        Edges, by their numbers in the region's problem, ascending; and tracks of each.
    """
    problem, axis = solution.problem, division.axis
    box = division.box(region, problem.grid[axis])
    net, edge = solution.uses
    inside = _within(problem, box, edge)
    net, edge = net[inside], edge[inside]
    grid = _grid(problem, box)
    size = AXES * int(np.prod(grid))
    place = _local_edges(problem, box, edge)
    tracks = problem.net_demand[net, edge // AXES % problem.grid[2]]
    owner = division.owner[net]
    before, own, moved = np.zeros(size), np.zeros(size), np.zeros(size)
    for other in range(len(division.lines) + 1):
        beside = _within(problem, division.box(other, problem.grid[axis]), edge)
        of_it = np.flatnonzero((owner == other) & beside)
        use = np.bincount(place[of_it], tracks[of_it], size).astype(np.float64)
        moved += use
        if other == region:
            own = use
        elif other < region:
            before += use
    where = (slice(None),) * axis + (slice(box.low, box.high),)
    capacity = problem.capacity.reshape(*problem.grid, AXES)[where].reshape(-1)
    free = capacity - np.bincount(place, tracks, size)
    shape = [1] * (VIA_AXIS + 2)
    shape[axis] = grid[axis]
    at = np.arange(box.low, box.high)
    first, last = (
        (division.share_upto(i, at).reshape(shape) * np.ones((*grid, AXES))).reshape(-1)
        for i in (region - 1, region)
    )
    gained = np.floor(last * free) - np.floor(first * free)
    over = np.minimum(-free, moved) / np.maximum(moved, 1)
    lost = np.floor(over * (before + own)) - np.floor(over * before)
    taken = (capacity - own - np.where(free >= 0, gained, -lost)).astype(np.int32)
    by_place = taken.reshape(*grid, AXES)
    by_place[..., VIA_AXIS] = 0
    by_place[(slice(None),) * axis + (-1, ..., axis)] = 0  # these leave the box
    shared = np.flatnonzero(taken)
    return shared.astype(np.int32), taken[shared]


def cut(
    solution: Solution, prices: NDArray[np.float32], division: Division, region: int
) -> tuple[Piece, NDArray[np.int64]]:
    """The problem of a region: its own nets' parts in its box, as the routes leave the box now.

    The parts of a net in the box are those that its edges in the box join, and each becomes a net.

    Args:
        solution: the routes.
        prices: (E,) what past overflow adds to the cost of every edge of the chip, in edges.
        division: the regions.
        region: the number of this one.

    Returns:
        The problem, and the net of each of its nets. Parts with all pins in one Gcell are left out.
    """
    problem = solution.problem
    box = division.box(region, problem.grid[division.axis])
    gcells = int(np.prod(problem.grid))
    net, edge = solution.uses
    moved = division.owner == region
    net, edge = net[moved[net]], edge[moved[net]]
    near, axis = np.divmod(edge, AXES)
    far = near + problem.strides[axis]
    from_inside, to_inside = (_inside(problem, box, gcell) for gcell in (near, far))
    both = from_inside & to_inside
    first, pin = problem.flat_pin_gcells
    owner = np.repeat(np.arange(len(problem.nets)), np.diff(first))
    own = moved[owner] & _inside(problem, box, pin)
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
    shared, taken = taken_from(solution, division, region)
    priced = np.flatnonzero(prices)
    priced = priced[_within(problem, box, priced)]
    piece = Piece(
        grid=_grid(problem, box),
        capacity=problem.layer_capacity[:, :VIA_AXIS].T.copy(),
        rules=np.array((problem.min_width, problem.min_spacing), np.int32),
        wires=None if problem.chip is None else problem.chip.wires,
        adjusted=_local_edges(problem, box, adjusted[there]),
        adjusted_capacity=capacity[there],
        shared=shared,
        taken=taken,
        first=starts.astype(np.int32),
        pin=_local(problem, box, vertex[end] % gcells).astype(np.int32),
        width=problem.net_width[nets],
        net=number_of[order].astype(np.int32),
        edge=used[order],
        priced=_local_edges(problem, box, priced),
        price=prices[priced],
    )
    return piece, nets


def joined(
    solution: Solution,
    division: Division,
    found: Mapping[int, tuple[NDArray[np.int64], NDArray[np.int32]]],
) -> Solution:
    """The solution with other routes in regions.

    Args:
        solution: the routes.
        division: the regions.
        found: of some regions by their numbers, the net of each use of an edge, by its number in
            the chip, and the edge, by its number in the region's problem.
    """
    problem, axis = solution.problem, division.axis
    net, edge = solution.uses
    kept = np.ones(len(edge), np.bool_)
    size = AXES * int(np.prod(problem.grid))
    uses = []
    for region, (new_net, new_edge) in found.items():
        box = division.box(region, problem.grid[axis])
        kept &= ~((division.owner == region)[net] & _within(problem, box, edge))
        uses.append(new_net * size + chip_edges(problem, box, new_edge))
    together = np.unique(np.concatenate((net[kept] * size + edge[kept], *uses)))
    return Solution.of_uses(problem, *np.divmod(together, size))


def size_of(pieces: Iterable[tuple[Any, ...]]) -> int:
    """The bytes of all arrays of some pieces, or of what comes back."""
    return sum(part.nbytes for piece in pieces for part in piece if isinstance(part, np.ndarray))


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
