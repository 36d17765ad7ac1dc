"""Connected parts of a graph, as a forest in an array (union-find)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled


def joined_parts(
    near: NDArray[np.int64], far: NDArray[np.int64], vertices: int
) -> NDArray[np.int64]:
    """(vertices,) for each vertex the lowest one in its part, given the ends of all edges."""
    part = np.arange(vertices)
    if len(near) > 5 * MANY:
        mark_joins(near, far, np.arange(len(near)), part, np.zeros(len(near), np.bool_))
    while True:
        apart = part[near] != part[far]
        near, far = part[near[apart]], part[far[apart]]
        if not len(near):
            break
        high = np.maximum(near, far)  # each root joins the lowest one beside it, if that is lower
        np.minimum.at(part, high, np.minimum(near, far))
        while ((lower := part[part[high]]) != part[high]).any():
            part[high] = lower
    return lowest(part)


def lowest(part: NDArray[np.int64]) -> NDArray[np.int64]:
    """(vertices,) for each the root of its tree, given the parent of each; roots are their own."""
    while ((lower := part[part]) != part).any():
        part = lower
    return part


MANY = 200_000
"""For so many edges, plain Python takes longer than loading the compiler; NumPy for five times."""


def mark_joins(near: Any, far: Any, order: Any, part: Any, kept: Any) -> None:
    """Joins vertices by edges (n,), in an order; marks in ``kept`` those that joined two parts."""
    join = _mark_joins if len(order) > MANY else _mark_joins.py_func
    join(near, far, order, part, kept)


@compiled
def _mark_joins(near: Any, far: Any, order: Any, part: Any, kept: Any) -> None:
    for edge in order:
        a, b = near[edge], far[edge]
        while part[a] != a:  # to the root; ways to it get shorter
            part[a] = part[part[a]]
            a = part[a]
        while part[b] != b:
            part[b] = part[part[b]]
            b = part[b]
        if a != b:
            part[max(a, b)] = min(a, b)
            kept[edge] = True
