"""Nets cut into two-pin tasks along a tree.

The tree is a minimum spanning tree (paper, section 3.3) or a rectilinear Steiner tree. The distance
between two pins is the Manhattan distance of their Gcells over x, y and layer. Pins in the same
Gcell count once; a net whose pins all lie in one Gcell has no task.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

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
    return tasks_between(*problem.flat_pin_gcells, problem.grid, decomposition)


def tasks_between(
    first: NDArray[np.int64],
    gcells: NDArray[np.int64],
    grid: tuple[int, int, int],
    decomposition: Decomposition,
) -> NDArray[np.int32]:
    """:func:`two_pin_tasks` of nets with pins in ``gcells[first[i] : first[i + 1]]``, each once."""
    if decomposition == "steiner":
        return steiner_tasks(first, gcells, grid)
    pins = np.diff(first)
    tasks = [np.empty((0, 3), np.int32)]
    for count in np.unique(pins[pins > 1]).tolist():
        nets = np.flatnonzero(pins == count)  # those with so many pins, side by side
        own = gcells[first[nets, None] + np.arange(count)]
        ends = _breadth_first(_parents(np.stack(np.unravel_index(own, grid), axis=2)))
        rows = np.take_along_axis(own, ends.reshape(len(nets), -1), axis=1).reshape(-1, 2)
        tasks.append(np.column_stack((np.repeat(nets, count - 1), rows)).astype(np.int32))
    found = np.concatenate(tasks)
    return found[np.argsort(found[:, 0], kind="stable")]


def _parents(at: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K, P) of the pins ``at`` (K, P, 3) of K nets: the pin by which Prim's tree reaches each.

    Among pairs of pins at equal distance, the first in the order (0, 1), (0, 2), …, (1, 2), … goes
    into the tree. So no two pairs tie, and there is exactly one shortest tree.
    """
    nets, pins, _ = at.shape
    every, pin = np.arange(nets), np.arange(pins)
    far = np.iinfo(np.int64).max
    parent = np.zeros((nets, pins), np.int64)
    key = np.full((nets, pins), far)  # of the best pair that joins a pin to the tree
    outside = np.ones((nets, pins), np.bool_)
    latest = np.zeros(nets, np.int64)
    for _ in range(pins - 1):
        outside[every, latest] = False
        other = latest[:, None]
        distance = np.abs(at - at[every, latest][:, None]).sum(axis=2, dtype=np.int64)
        pair = np.minimum(pin, other) * pins + np.maximum(pin, other)
        new = distance * pins**2 + pair
        nearer = new < key
        parent = np.where(nearer & outside, other, parent)
        key = np.where(nearer, new, key)
        latest = np.where(outside, key, far).argmin(axis=1)
    return parent


def _breadth_first(parent: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K, P − 1, 2) the edges of K trees: pin that is reached already, new pin.

    Of a pin's branches those to later pins come before those to earlier ones.
    """
    nets, pins = parent.shape
    if pins == 2:
        return np.tile(np.array([0, 1]), (nets, 1, 1))
    edges = []
    for tree in parent.tolist():
        branches: dict[int, list[int]] = {}
        for pin in range(1, pins):
            branches.setdefault(tree[pin], []).append(pin)
        reached = [0]
        for start in reached:  # which grows as it is gone through
            later = sorted(branches.get(start, ()), key=lambda pin: (pin - start) % pins)
            edges += [(start, pin) for pin in later]
            reached += later
    return np.array(edges).reshape(nets, pins - 1, 2)
