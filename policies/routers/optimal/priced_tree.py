"""The cheapest tree that joins the pins of a net at given edge prices, by dynamic programming.

Consider a cheapest tree that joins a set of pins and one more Gcell. Either it splits at that
Gcell into two trees that each join some of the pins, or it reaches the Gcell along a cheapest path
from a Gcell where it splits (Dreyfus and Wagner, "The Steiner problem in graphs", Networks 1,
1971). With every pin, memory doubles and time triples.

Prices are whole numbers from 0, one for each edge of a grid or of a rectangle cut out of it, as an
int64 array (X, Y, Z, 3) in the order of edge numbers (:mod:`marouting.problem.grid`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES, VIA_AXIS, Move

NEVER = 1 << 60
"""The price of an edge that must not be used, and the cost of a tree that does not exist. All
other prices have to add up to less."""

_PIN = -1
_SPLIT = len(Move)
"""Entries of the table ``way``: the last move on the way to a Gcell; _PIN where a way begins;
_SPLIT + S where a tree splits into one for the pins in S and one for the others."""

_EAST, _WEST, _NORTH, _SOUTH, _UP, _DOWN = map(int, Move)  # members are slow to compile


@compiled
def _shorter(cost: Any, way: Any, price: Any, here: int, there: int, edge: int, move: int) -> bool:
    """Takes the way to ``here`` from its neighbour ``there`` if it is cheaper; returns whether."""
    over = cost[there] + price[edge]
    if over >= cost[here]:
        return False
    cost[here] = over
    way[here] = move
    return True


@compiled
def _spread(cost: Any, way: Any, price: Any, columns: int, rows: int, layers: int) -> None:
    """Lowers costs (G,) along cheapest paths, in sweeps over the grid until nothing changes.

    One sweep follows a path as long as it keeps to two of the four directions, vias included.
    Cheapest paths rarely turn back, so a few sweeps are enough (Zhao, "A fast sweeping method for
    Eikonal equations", Mathematics of Computation 74, 2005).
    """
    changed = True
    while changed:
        changed = False
        for sweep in range(4):
            east, north = sweep < 2, sweep % 2 == 0
            along_x, move_x = (-rows * layers, _EAST) if east else (rows * layers, _WEST)
            along_y, move_y = (-layers, _NORTH) if north else (layers, _SOUTH)
            for i in range(columns):
                for j in range(rows):
                    x = i if east else columns - 1 - i
                    y = j if north else rows - 1 - j
                    lowest = (x * rows + y) * layers
                    for here in range(lowest, lowest + layers):
                        if i > 0:
                            there = here + along_x
                            edge = AXES * min(here, there)
                            changed |= _shorter(cost, way, price, here, there, edge, move_x)
                        if j > 0:
                            there = here + along_y
                            edge = AXES * min(here, there) + 1
                            changed |= _shorter(cost, way, price, here, there, edge, move_y)
                    for here in range(lowest + 1, lowest + layers):
                        edge = AXES * (here - 1) + VIA_AXIS
                        changed |= _shorter(cost, way, price, here, here - 1, edge, _UP)
                    for here in range(lowest + layers - 2, lowest - 1, -1):
                        edge = AXES * here + VIA_AXIS
                        changed |= _shorter(cost, way, price, here, here + 1, edge, _DOWN)


@compiled
def _join(price: Any, pins: Any, columns: int, rows: int, layers: int, cost: Any, way: Any) -> None:
    """Fills the tables (2^pins, G); row S is for the pins whose bits are set in S."""
    gcells = cost.shape[1]
    for pin_set in range(1, cost.shape[0]):
        for cell in range(gcells):
            cost[pin_set, cell] = NEVER
            way[pin_set, cell] = _PIN
        rest = pin_set & (pin_set - 1)
        if rest == 0:
            for pin in range(len(pins)):
                if pin_set == 1 << pin:
                    cost[pin_set, pins[pin]] = 0
        part = rest
        while part > 0:  # all nonempty sets of the pins other than the first
            for cell in range(gcells):
                split = cost[part, cell] + cost[pin_set ^ part, cell]
                if split < cost[pin_set, cell]:
                    cost[pin_set, cell] = split
                    way[pin_set, cell] = _SPLIT + part
            part = (part - 1) & rest
        _spread(cost[pin_set], way[pin_set], price, columns, rows, layers)


@compiled
def _walk(way: Any, pin_set: int, cell: int, strides: Any, stack: Any, out: Any) -> int:
    """Writes the edges of the tree for a set of pins and a Gcell to ``out``; returns how many."""
    stack[0, 0], stack[0, 1] = pin_set, cell
    size, edges = 1, 0
    while size > 0:
        size -= 1
        pin_set, cell = i64(stack[size, 0]), i64(stack[size, 1])
        while 0 <= way[pin_set, cell] < _SPLIT:
            axis, backward = divmod(i64(way[pin_set, cell]), 2)
            there = cell + (strides[axis] if backward else -strides[axis])
            out[edges] = AXES * min(cell, there) + axis
            edges += 1
            cell = there
        if way[pin_set, cell] >= _SPLIT:
            part = way[pin_set, cell] - _SPLIT
            stack[size, 0], stack[size, 1] = part, cell
            stack[size + 1, 0], stack[size + 1, 1] = pin_set ^ part, cell
            size += 2
    return edges


@compiled
def _cross(price: Any, cost: Any, strides: Any, least: Any, split: Any) -> None:
    """Finds the cheapest tree through each edge: its cost, and the pins on the near side."""
    everything = cost.shape[0] - 1
    for edge in range(len(price)):
        least[edge] = NEVER
        if price[edge] < NEVER:
            near = edge // AXES
            far = near + strides[edge % AXES]
            # Without the edge the tree falls into two parts, and each has pins.
            for part in range(1, everything):
                across = cost[part, near] + price[edge] + cost[everything ^ part, far]
                if across < least[edge]:
                    least[edge] = across
                    split[edge] = part


class _Tables:
    """The cheapest trees for every set of the pins and every further Gcell.

    Args:
        price: as for :func:`cheapest_priced_tree`.
        pins: likewise, but one pin suffices.

    Attributes:
        cost: (2^k, G) int64, the trees' costs; row S is for the pins whose bits are set in S.
        way: (2^k, G) int32, how the trees are put together.
        strides: (3,) how far a step along an axis leads in the numbers of Gcells.
    """

    def __init__(self, price: NDArray[np.int64], pins: NDArray[np.int64]) -> None:
        columns, rows, layers, _ = price.shape
        shape = (1 << len(pins), columns * rows * layers)
        self.cost = np.empty(shape, np.int64)
        self.way = np.empty(shape, np.int32)
        self.strides = np.array((rows * layers, layers, 1))
        _join(price.reshape(-1), pins, columns, rows, layers, self.cost, self.way)
        # Where edges are free, the parts of a tree may share edges, so there may be more of them.
        self._edges = np.empty((2 * len(pins) + 1) * shape[1], np.int64)
        self._stack = np.empty((len(pins) + 2, 2), np.int64)

    def tree(self, pin_set: int, cell: int) -> NDArray[np.int64]:
        """The edges of the tree that joins a set of pins and a Gcell; some may repeat."""
        count = _walk(self.way, pin_set, cell, self.strides, self._stack, self._edges)
        return self._edges[:count].copy()


def cheapest_priced_tree(
    price: NDArray[np.int64], pins: NDArray[np.int64]
) -> tuple[int, NDArray[np.int64]]:
    """The cheapest tree that joins two or more pins (Dreyfus and Wagner, 1971).

    Args:
        price: (X, Y, Z, 3) int64, price of every edge from 0; NEVER for edges that must not be
            used and for those that lead off the grid.
        pins: (k,) int64, the pins' Gcells, numbered in the grid of ``price``, all different.

    Returns:
        The tree's cost and its edges (n,) int64, numbered in the grid of ``price``, ascending;
        NEVER and no edges if the pins cannot be joined.
    """
    tables = _Tables(price, pins[:-1])
    cost = int(tables.cost[-1, pins[-1]])
    if cost >= NEVER:
        return NEVER, np.empty(0, np.int64)
    return cost, np.unique(tables.tree(len(tables.cost) - 1, int(pins[-1])))


class TreesByEdge:
    """For every edge the cheapest tree that joins the pins and uses that edge.

    Args:
        price: as for :func:`cheapest_priced_tree`.
        pins: likewise.

    Attributes:
        cost: (edges,) int64, the trees' costs; NEVER where there is no tree.
    """

    def __init__(self, price: NDArray[np.int64], pins: NDArray[np.int64]) -> None:
        self._tables = _Tables(price, pins)
        self.cost = np.empty(price.size, np.int64)
        self._near = np.empty(price.size, np.int64)
        _cross(price.reshape(-1), self._tables.cost, self._tables.strides, self.cost, self._near)

    def tree(self, edge: int) -> NDArray[np.int64]:
        """The edges (n,) int64 of the tree that uses an edge, ascending; ``cost[edge]`` < NEVER."""
        cell, axis = divmod(edge, AXES)
        near = int(self._near[edge])
        far = len(self._tables.cost) - 1 - near
        beyond = cell + int(self._tables.strides[axis])
        parts = self._tables.tree(near, cell), self._tables.tree(far, beyond), [edge]
        return np.unique(np.concatenate(parts))


@dataclass(frozen=True)
class Window:
    """A rectangle cut out of a grid, with all its layers.

    Attributes:
        grid: columns, rows and layers of the whole grid.
        low: the window's first column and row.
        high: one past the window's last column and row.
    """

    grid: tuple[int, int, int]
    low: tuple[int, int]
    high: tuple[int, int]

    @staticmethod
    def around(grid: tuple[int, int, int], gcells: NDArray[np.int64], margin: int) -> "Window":
        """The box around Gcells (n,), extended by a margin on all sides within the grid."""
        x, y, _ = np.unravel_index(gcells, grid)
        low = max(int(x.min()) - margin, 0), max(int(y.min()) - margin, 0)
        high = min(int(x.max()) + margin + 1, grid[0]), min(int(y.max()) + margin + 1, grid[1])
        return Window(grid, low, high)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Columns, rows and layers."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1], self.grid[2]

    def cut(self, price: NDArray[np.int64]) -> NDArray[np.int64]:
        """A copy of the prices (X, Y, Z, 3) in the window; edges that leave it get NEVER."""
        part = price[self.low[0] : self.high[0], self.low[1] : self.high[1]].copy()
        part[-1, :, :, 0] = NEVER
        part[:, -1, :, 1] = NEVER
        return part

    def gcells_in_window(self, gcells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers in the window of Gcells (n,) in it, given by their numbers in the grid."""
        x, y, z = np.unravel_index(gcells, self.grid)
        return np.ravel_multi_index((x - self.low[0], y - self.low[1], z), self.shape)

    def edges_in_grid(self, edges: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers in the grid of edges (n,) given by their numbers in the window."""
        gcell, axis = np.divmod(edges, AXES)
        x, y, z = np.unravel_index(gcell, self.shape)
        whole = np.ravel_multi_index((x + self.low[0], y + self.low[1], z), self.grid)
        return AXES * whole + axis
