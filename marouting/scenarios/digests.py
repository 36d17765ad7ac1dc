"""A digest of what is to be routed, by which problems are told apart."""

import functools
import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.problem.grid import AXES, VIA_AXIS, Grid
from marouting.problem.problem import Problem


def digest(problem: Problem) -> str:
    """A digest of a problem as routers see it, in 64 hexadecimal digits.

    Two problems have the same digest if a solution of one is a solution of the other, with the same
    overflow and wirelength: same grid, same capacities, same nets by their pins' Gcells and their
    demand. Names, the order of nets and pins, where in its Gcell a pin lies, and nets inside one
    Gcell make no difference.
    """
    return _digest(problem, problem.pin_gcells, problem.capacity)


def mirror_digest(problem: Problem) -> str:
    """A digest that a problem shares with its mirror images.

    These are the problem with its columns, its rows or both reversed and, on a square grid, each of
    them with columns and rows exchanged in every layer.
    """
    return min(
        _digest(problem, (image[gcells] for gcells in problem.pin_gcells), problem.capacity[edges])
        for image, edges in _mirrors(problem.grid)
    )


def _digest(problem: Problem, pins: Iterable[NDArray[Any]], capacity: NDArray[np.int32]) -> str:
    """The digest of a problem with these Gcells of its nets' pins and these capacities."""
    nets = sorted(
        (*sorted(gcells.tolist()), -1, *demand)
        for gcells, demand in zip(pins, problem.net_demand.tolist(), strict=True)
        if len(gcells) > 1
    )
    numbers = [*problem.grid, *capacity.tolist(), *(n for net in nets for n in (*net, -2))]
    return hashlib.sha256(np.array(numbers, "<i8").tobytes()).hexdigest()


@functools.lru_cache(maxsize=16)
def _mirrors(shape: tuple[int, int, int]) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The mirrors of a grid: (G,) where each Gcell goes, and (E,) which edge comes in its place."""
    grid = Grid.of(shape)
    gcells = np.arange(grid.gcells).reshape(shape)
    edges = np.flatnonzero(grid.exists)
    ends = grid.ends(edges)
    found = []
    for exchange in (False, True)[: 1 + (shape[0] == shape[1])]:
        for x in (1, -1):
            for y in (1, -1):
                turned = gcells[::x, ::y]
                image = (turned.swapaxes(0, 1) if exchange else turned).reshape(-1)
                axis = edges % AXES
                if exchange:
                    axis = np.where(axis == VIA_AXIS, VIA_AXIS, 1 - axis)
                source = np.arange(grid.edges)  # edges off the grid have no capacity anywhere
                source[AXES * np.minimum(*(image[end] for end in ends)) + axis] = edges
                found.append((image, source))
    return found
