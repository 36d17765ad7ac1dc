"""Nets cut into two-pin tasks along a tree.

The tree is a minimum spanning tree (paper, section 3.3) or a rectilinear Steiner tree. The distance
between two pins is the Manhattan distance of their Gcells over x, y and layer. Pins in the same
Gcell count once; a net whose pins all lie in one Gcell has no task.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled
from marouting.problem.grid import AXES
from marouting.problem.problem import Problem
from marouting.trees.steiner import steiner_tasks

Decomposition = Literal["mst", "steiner"]


def two_pin_tasks(problem: Problem, decomposition: Decomposition = "mst") -> NDArray[np.int32]:
    """Cuts every net into two-pin tasks.

    Every task starts at a Gcell that an earlier task of the net has reached, or at its first pin.
    The choice among trees of equal length depends only on the order of the pins, so the result is
    the same on every machine.

    Args:
        problem: the problem.
        decomposition: ``mst``, between pins along a minimum spanning tree, walked breadth first
            from the first pin (the paper); ``steiner``, between pins and Steiner points, see
            :func:`marouting.trees.steiner.steiner_tasks`.

    Returns:
        (K, 3) int32: net, start Gcell and target Gcell of each task, nets in file order.
    """
    if decomposition == "steiner":
        return steiner_tasks(problem)
    first, gcells = problem.flat_pin_gcells
    tasks = np.empty((len(gcells) - len(problem.nets), 3), np.int32)
    working = np.empty((4, len(gcells)), np.int64)
    _span(first, gcells, problem.topology.position, *working, tasks)
    return tasks


@compiled
def _span(
    first: Any, gcells: Any, position: Any, parent: Any, near: Any, rank: Any, queue: Any, out: Any
) -> None:
    """Writes the spanning trees of all nets (Prim) as tasks.

    Among pairs of pins at equal distance, the first in the order (0, 1), (0, 2), …, (1, 2), … goes
    into the tree. So no two pairs tie, and there is exactly one shortest tree.

    Args:
        first: (nets + 1,) see :attr:`marouting.problem.problem.Problem.flat_pin_gcells`.
        gcells: (pins,) see there.
        position: (G, 3) x, y, z of every Gcell.
        parent: (pins,) working array, one net at a time: for each pin the nearest pin in the tree.
        near: (pins,) working array: their distance; negative for a pin in the tree.
        rank: (pins,) working array: the place of this pair in the order of pairs.
        queue: (pins,) working array: pins in the order in which the tree reaches them.
        out: (K, 3) receives the tasks.
    """
    row = 0
    for net in range(len(first) - 1):
        base, pins = first[net], first[net + 1] - first[net]
        for pin in range(pins):
            near[pin] = 1 << 62
        latest = 0
        for _ in range(pins - 1):
            near[latest] = -1
            closest = -1
            for pin in range(pins):
                if near[pin] < 0:
                    continue
                distance = 0
                for axis in range(AXES):
                    distance += abs(
                        position[gcells[base + pin], axis] - position[gcells[base + latest], axis]
                    )
                pair = pin * pins + latest if pin < latest else latest * pins + pin
                if distance < near[pin] or (distance == near[pin] and pair < rank[pin]):
                    parent[pin], near[pin], rank[pin] = latest, distance, pair
                if (
                    closest < 0
                    or near[pin] < near[closest]
                    or (near[pin] == near[closest] and rank[pin] < rank[closest])
                ):
                    closest = pin
            latest = closest
        # Breadth first; of a pin's branches those to later pins come before those to earlier ones.
        queue[0], size = 0, 1
        parent[0] = -1
        for place in range(pins - 1):
            start = queue[place]
            for k in range(pins):
                pin = (start + k) % pins
                if parent[pin] == start:
                    queue[size] = pin
                    size += 1
                    out[row, 0] = net
                    out[row, 1] = gcells[base + start]
                    out[row, 2] = gcells[base + pin]
                    row += 1
