"""Multi-pin nets become two-pin tasks along a minimum spanning tree (paper, section 3.3).

The distance of two pins is the Manhattan distance of their Gcells over x, y and layer. Pins in the
same Gcell count once; a net whose pins all lie in one Gcell needs no task.
"""

from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from marouting.problem import Problem


def two_pin_tasks(problem: Problem) -> NDArray[np.int32]:
    """Cuts every net into two-pin tasks.

    The tree of a net is walked breadth first from its first pin, so every task starts at a pin
    that an earlier task of the net has reached. Among trees of equal length the choice depends on
    the order of the pins alone: the result is the same on every machine.

    Returns:
        (K, 3) int32: net, start Gcell and target Gcell of each task, nets in file order.
    """
    pins = problem.pin_gcells
    sizes = np.array([len(p) for p in pins])
    first = np.concatenate(([0], np.cumsum(sizes)))
    gcells = np.concatenate(pins)
    position = problem.topology.position[gcells].astype(np.int64)

    # The candidate edges of all nets at once, nets of equal size together: one sparse graph and
    # one call instead of one for every net.
    by_size = sorted(range(len(pins)), key=lambda net: sizes[net])
    ends, weights = [], []
    for size, group in groupby(by_size, key=lambda net: sizes[net]):
        a, b = np.triu_indices(size, 1)
        base = first[list(group)][:, None]
        near, far = base + a, base + b
        distance = np.abs(position[near] - position[far]).sum(axis=-1)
        # The rank of the pair within its net decides between equal distances.
        ranks = max(len(a), 1)
        weights.append((distance + (np.arange(len(a)) + 1) / (ranks + 1)).ravel())
        ends.append(np.stack((near.ravel(), far.ravel())))
    # scipy's graph routines take int32 indices; before 1.16 they refuse others.
    near, far = np.concatenate(ends, axis=1).astype(np.int32)
    weight = np.concatenate(weights)
    total = len(gcells)
    tree = minimum_spanning_tree(coo_array((weight, (near, far)), shape=(total, total)).tocsr())

    # A root above the first pins of all nets makes the forest one tree to walk.
    branches = coo_array(tree)
    root = np.full(len(pins), total)
    rows = np.concatenate((branches.row, root)).astype(np.int32)
    columns = np.concatenate((branches.col, first[:-1])).astype(np.int32)
    joined = coo_array((np.ones(len(rows)), (rows, columns)), shape=(total + 1, total + 1))
    order, parent = breadth_first_order(joined.tocsr(), total, directed=False)
    reached = order[(parent[order] >= 0) & (parent[order] < total)]
    net = np.repeat(np.arange(len(pins)), sizes)
    reached = reached[np.argsort(net[reached], kind="stable")]
    return np.stack((net[reached], gcells[parent[reached]], gcells[reached]), axis=1).astype(
        np.int32
    )
