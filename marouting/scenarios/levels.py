"""The parameters of every scenario, and how a problem is drawn from them."""

from dataclasses import dataclass

import numpy as np

from marouting.generator import GeneratorOptions, generate_from
from marouting.problem.problem import Problem

Range = tuple[int, int]
"""The least and the largest value, both included."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """What the problems of a scenario are drawn from.

    Attributes:
        name: the scenario's name; it ends with the version.
        description: one sentence.
        grid: columns, rows and layers of Gcells, the same in all problems.
        nets: nets per problem, drawn uniformly for each problem.
        max_pins: the most pins of a net, drawn uniformly for each problem; each net then has 2 to
            ``max_pins``.
        capacity: tracks of an edge along its layer's direction, drawn uniformly for each problem.
        reduced_edges: how many of the most used edges lose two tracks, see
            :mod:`marouting.generator`.
        validation: number of validation problems.
        test: number of test problems.
        feasible: whether every problem has a solution without overflow.
    """

    name: str
    description: str
    grid: tuple[int, int, int]
    nets: Range
    max_pins: Range
    capacity: Range
    reduced_edges: int = 0
    validation: int = 20
    test: int = 40
    feasible: bool = True

    def problem(self, rng: np.random.Generator) -> Problem:
        """Draws a problem, which need not be feasible."""
        nets, max_pins, capacity = (
            int(rng.integers(least, most + 1))
            for least, most in (self.nets, self.max_pins, self.capacity)
        )
        return self._generate(nets, max_pins, capacity, int(rng.integers(2**63)))

    def largest(self) -> Problem:
        """A problem with the most nets, pins and capacity, by which spaces can be bounded."""
        return self._generate(self.nets[1], self.max_pins[1], self.capacity[1], seed=0)

    def _generate(self, nets: int, max_pins: int, capacity: int, seed: int) -> Problem:
        options = GeneratorOptions(
            grid=self.grid,
            nets=nets,
            max_pins=max_pins,
            capacity=capacity,
            reduced_edges=self.reduced_edges,
            seed=seed,
        )
        return generate_from(options)[0]


LEVELS = (
    Level(
        name="toy-4x4-v0",
        description="Five two-pin nets on a 4x4 grid with one track per edge: learnt in minutes.",
        grid=(4, 4, 2),
        nets=(5, 5),
        max_pins=(2, 2),
        capacity=(1, 1),
    ),
    Level(
        name="two-pin-8x8-v0",
        description="Fifty two-pin nets on an 8x8 grid that just fit.",
        grid=(8, 8, 2),
        nets=(50, 50),
        max_pins=(2, 2),
        capacity=(4, 4),
    ),
)
"""All scenarios, easiest first."""
