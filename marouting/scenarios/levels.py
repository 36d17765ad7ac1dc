"""The parameters of every scenario, and how a problem is drawn from them."""

from dataclasses import dataclass

import numpy as np

from marouting.generator import GeneratorOptions, generate_from
from marouting.problem.problem import Problem

Range = tuple[int, int]  # the least and the largest value, both included


@dataclass(frozen=True, kw_only=True)
class Level:
    """What the problems of a scenario are drawn from."""

    name: str  # the scenario's name; it ends with the version
    description: str  # one sentence
    grid: tuple[int, int, int]  # columns, rows and layers of Gcells, the same in all problems
    nets: Range  # nets per problem, drawn uniformly
    max_pins: Range  # the most pins of a net, drawn for each problem
    capacity: Range  # tracks of an edge along its layer's direction, drawn likewise
    reduced_edges: int = 0  # how many of the most used edges lose two tracks
    validation: int = 20  # number of validation problems
    test: int = 40  # number of test problems
    feasible: bool = True  # whether every problem has a solution without overflow

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
        description="Five two-pin nets with one track per edge, to be learnt in minutes.",
        grid=(4, 4, 2),
        nets=(5, 5),
        max_pins=(2, 2),
        capacity=(1, 1),
    ),
    Level(
        name="two-pin-8x8-v0",
        description="Fifty two-pin nets that just fit.",
        grid=(8, 8, 2),
        nets=(50, 50),
        max_pins=(2, 2),
        capacity=(4, 4),
    ),
    Level(
        name="paper-table2-row3-v0",
        description="The paper's problems of fifty two-pin nets and three reduced edges "
        "(Liao et al. 2019, table 2, row 3).",
        grid=(8, 8, 2),
        nets=(50, 50),
        max_pins=(2, 2),
        capacity=(5, 5),
        reduced_edges=3,
    ),
    Level(
        name="multi-pin-8x8-v0",
        description="Thirty nets of up to five pins that just fit.",
        grid=(8, 8, 2),
        nets=(30, 30),
        max_pins=(5, 5),
        capacity=(4, 4),
    ),
    Level(
        name="mixed-v0",
        description="Problems that differ in nets, pins and capacity, on one grid of three layers.",
        grid=(10, 10, 3),
        nets=(20, 60),
        max_pins=(2, 5),
        capacity=(3, 5),
    ),
    Level(
        name="large-64x64-v0",
        description="A thousand nets of up to four pins on a grid of 8192 Gcells.",
        grid=(64, 64, 2),
        nets=(1000, 1000),
        max_pins=(4, 4),
        capacity=(16, 16),
        validation=5,
        test=10,
    ),
    Level(
        name="tight-16x16-v0",
        description="A hundred two-pin nets that do not fit: overflow is to be as small as can be.",
        grid=(16, 16, 2),
        nets=(100, 100),
        max_pins=(2, 2),
        capacity=(3, 3),
        validation=10,
        test=20,
        feasible=False,
    ),
    Level(
        name="tight-32x32-v0",
        description="Five hundred nets of up to four pins that nearly fit, if at all.",
        grid=(32, 32, 2),
        nets=(500, 500),
        max_pins=(4, 4),
        capacity=(11, 11),
        validation=5,
        test=10,
        feasible=False,
    ),
)
"""All scenarios, easiest first."""
