"""Nets cut into two-pin tasks along Steiner trees.

The distance of two Gcells is the Manhattan distance over x, y and layer, as in
:mod:`marouting.trees.decomposition`. There a net's tasks join its pins along a minimum spanning
tree; here they may also lead to **Steiner points**, Gcells without a pin where the net branches. A
net in one layer stays in that layer.

Nets of up to :data:`EXACT_PINS` pins get a shortest tree, larger ones a tree by iterated 1-Steiner
(Kahng and Robins 1992), longer by a few tenths of a percent.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled
from marouting.problem.grid import AXES
from marouting.trees.exact_tree import Search, make_search
from marouting.trees.hanan import Web, exact_points, iterated_points, make_web, set_hanan_grid
from marouting.trees.lattice import Lattice, make_lattice

EXACT_PINS = 9
"""Up to this many pins a net's tree is a shortest one; the time for it grows as 3^pins."""


@compiled
def _cut(
    first: Any,
    position: Any,
    grid: Any,
    lattice: Lattice,
    s: Search,
    web: Web,
    tasks: Any,
) -> int:
    """Writes the tasks of all nets to ``tasks`` (…, 3); returns how many there are."""
    row = 0
    for net in range(len(first) - 1):
        pins = first[net + 1] - first[net]
        if pins < 2:
            continue
        for pin in range(pins):
            for axis in range(AXES):
                web.point[pin, axis] = position[first[net] + pin, axis]
        set_hanan_grid(lattice, web, pins)
        if pins <= EXACT_PINS:
            points = exact_points(lattice, s, web, pins)
        else:
            points = iterated_points(lattice, s, web, pins)
        for i in range(1, points):
            tasks[row, 0] = net
            for end in range(2):
                p = web.order[i]
                if end == 0:
                    p = web.parent[p]
                gcell = web.point[p, 0] * grid[1] + web.point[p, 1]
                tasks[row, 1 + end] = gcell * grid[2] + web.point[p, 2]
            row += 1
    return row


def steiner_tasks(
    first: NDArray[np.int64], gcells: NDArray[np.int64], grid: tuple[int, int, int]
) -> NDArray[np.int32]:
    """Cuts every net into two-pin tasks between its pins and Steiner points.

    Every task starts at a Gcell that an earlier task of the net has reached, or at its first pin.
    The result for a net depends only on its own pins and their order. For a net of n > EXACT_PINS
    pins the time grows as n·h, where h is the number of points of its Hanan grid: at most n² per
    layer, and no more than there are Gcells in the box around the net.

    Args:
        first: (nets + 1,) the pins of net i are ``gcells[first[i] : first[i + 1]]``.
        gcells: (pins,) their Gcells, each once in a net.
        grid: the grid's columns, rows and layers.

    Returns:
        (K, 3) int32: net, start Gcell and target Gcell of each task, nets in file order.
    """
    pins = np.diff(first)
    hanan = np.minimum(pins[:, None], grid).prod(axis=1)
    small = hanan * (pins <= EXACT_PINS)
    most = int(pins.max())
    lattice = make_lattice(int(hanan.max()), most)
    labels = int((small << np.clip(pins - 1, 0, EXACT_PINS - 1)).max())
    search = make_search(int(hanan.max()), labels, EXACT_PINS - 1)
    web = make_web(most)
    tasks = np.empty((2 * int(pins.sum()), 3), np.int32)
    position = np.stack(np.unravel_index(gcells, grid), axis=1)
    first = np.array(first)  # not read-only, for which the kernel would be compiled once more
    rows = _cut(first, position, np.array(grid, np.int64), lattice, search, web, tasks)
    return tasks[:rows].copy()
