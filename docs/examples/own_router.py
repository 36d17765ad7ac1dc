"""An own router, in an experiment beside the others and on the command line.

A router is any class with a method ``route(problem)`` that returns a solution. Its options are the
keyword arguments of its constructor. Where a router's name stands, ``module:Class`` may stand::

    marouting route problem.gr --router own_router:PatternRouter price=10
"""

import numpy as np

import marouting
from marouting import Move, Solution
from marouting.trees.decomposition import two_pin_tasks

X, Y, Z = 0, 1, 2


class PatternRouter:
    """Pattern routing: each two-pin task takes one of its two L-shapes, short tasks first.

    Args:
        price: what a unit of overflow costs, in edges.
    """

    def __init__(self, price: float = 100.0) -> None:
        self.price = price

    def route(self, problem: marouting.Problem) -> Solution:
        """A solution with every net joined; where both L-shapes are full there is overflow."""
        grid = problem.topology
        remaining = problem.capacity.astype(np.int64)
        along_x = int(np.argmax(problem.horizontal_capacity))  # the layer for wires along x
        along_y = int(np.argmax(problem.vertical_capacity))
        used = [set() for _ in problem.nets]

        def demand(net, edge):
            return problem.net_demand[net, grid.position[edge // 3, Z]]

        def cost(net, path):
            new = set(path) - used[net]
            overflow = sum(max(0, demand(net, e) - max(0, remaining[e])) for e in new)
            return len(new) + self.price * overflow

        tasks = two_pin_tasks(problem)
        length = np.abs(grid.position[tasks[:, 1]] - grid.position[tasks[:, 2]]).sum(axis=1)
        for net, start, target in tasks[np.argsort(length, kind="stable")].tolist():
            x, y, z = grid.position[target].tolist()
            x_first = ((Z, along_x), (X, x), (Z, along_y), (Y, y), (Z, z))
            y_first = ((Z, along_y), (Y, y), (Z, along_x), (X, x), (Z, z))
            paths = [walk(grid, start, legs) for legs in (x_first, y_first)]
            best = min(paths, key=lambda path: cost(net, path))
            for edge in set(best) - used[net]:
                remaining[edge] -= demand(net, edge)
            used[net] |= set(best)
        return Solution(problem, [np.array(sorted(edges), np.int64) for edges in used])


def walk(grid, gcell, legs):
    """The edges on a way of straight legs, each along an axis to a coordinate."""
    edges = []
    for axis, goal in legs:
        while grid.position[gcell, axis] != goal:
            move = Move(2 * axis + (grid.position[gcell, axis] > goal))
            edges.append(int(grid.edge[gcell, move]))
            gcell = grid.neighbour[gcell, move]
    return edges


if __name__ == "__main__":
    from policies.cli.tables import show_experiment
    from policies.experiment import Experiment, ExperimentConfig

    config = ExperimentConfig(
        out="own_router",
        jobs=1,
        problems={"generated": {"count": 5, "nets": 30, "seed": 0}},
        routers={
            "astar": {"router": "astar"},
            "own": {"router": "own_router:PatternRouter", "price": 10},
        },
    )
    show_experiment(Experiment(config).execute())
