"""A digest of what is to be routed, by which problems are told apart."""

import hashlib

import numpy as np

from marouting.problem.problem import Problem


def digest(problem: Problem) -> str:
    """A digest of a problem as routers see it, in 64 hexadecimal digits.

    Two problems have the same digest if a solution of one is a solution of the other, with the same
    overflow and wirelength: same grid, same capacities, same nets by their pins' Gcells and their
    demand. Names, the order of nets and pins, where in its Gcell a pin lies, and nets inside one
    Gcell make no difference.
    """
    nets = sorted(
        (*sorted(gcells.tolist()), -1, *demand)
        for gcells, demand in zip(problem.pin_gcells, problem.net_demand.tolist(), strict=True)
        if len(gcells) > 1
    )
    numbers = [*problem.grid, *problem.capacity.tolist(), *(n for net in nets for n in (*net, -2))]
    return hashlib.sha256(np.array(numbers, "<i8").tobytes()).hexdigest()
