"""Scenarios of nets with random pins, in which all edges of a layer have one capacity."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from marouting.generator import GeneratorOptions, generate_from
from marouting.problem.problem import Problem
from marouting.scenarios.scenario import Scenario, routable

Range = tuple[int, int]  # the least and the largest value, both included


@dataclass(frozen=True, kw_only=True)
class RandomNets:
    """Draws problems of nets with random pins (:func:`marouting.generate`)."""

    grid: tuple[int, int, int]  # columns, rows and layers of Gcells, the same in all problems
    nets: Range  # nets per problem, drawn uniformly
    max_pins: Range  # the most pins of a net, drawn for each problem
    capacity: Range  # tracks of an edge along its layer's direction, drawn likewise
    reduced_edges: int = 0  # how many of the most used edges lose two tracks

    def __call__(self, rng: np.random.Generator) -> Problem:
        """Draws a problem, which need not be feasible."""
        nets, max_pins, capacity = (
            int(rng.integers(least, most + 1))
            for least, most in (self.nets, self.max_pins, self.capacity)
        )
        return self._generate(nets, max_pins, capacity, int(rng.integers(2**63)))

    def largest(self) -> Problem:
        """A problem with the most nets, pins and capacity, by which spaces can be bounded."""
        most = self.max_pins[1]
        problem = self._generate(self.nets[1], most, self.capacity[1], seed=0)
        # A pin that is there twice is routed once.
        filled = (
            replace(net, pins=(*net.pins, *net.pins[:1] * most)[:most]) for net in problem.nets
        )
        return replace(problem, nets=tuple(filled))

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


def random_nets(
    name: str, description: str, draw: RandomNets, *, feasible: bool = True, **options: Any
) -> Scenario:
    """A scenario of random nets; those for planners do not hold out mirror images."""
    accept = routable if feasible else None
    known = {"description": description, "accept": accept, "largest": draw.largest}
    return Scenario(name, draw, **{"mirrors": False, **known, **options})


PLANNING = (
    random_nets(
        "toy-4x4-v0",
        "Five two-pin nets with one track per edge, to be learnt in minutes.",
        RandomNets(grid=(4, 4, 2), nets=(5, 5), max_pins=(2, 2), capacity=(1, 1)),
    ),
    random_nets(
        "two-pin-8x8-v0",
        "Fifty two-pin nets that just fit.",
        RandomNets(grid=(8, 8, 2), nets=(50, 50), max_pins=(2, 2), capacity=(4, 4)),
    ),
    random_nets(
        "paper-table2-row3-v0",
        "The paper's problems of fifty two-pin nets and three reduced edges "
        "(Liao et al. 2019, table 2, row 3).",
        RandomNets(
            grid=(8, 8, 2), nets=(50, 50), max_pins=(2, 2), capacity=(5, 5), reduced_edges=3
        ),
    ),
    random_nets(
        "multi-pin-8x8-v0",
        "Thirty nets of up to five pins that just fit.",
        RandomNets(grid=(8, 8, 2), nets=(30, 30), max_pins=(5, 5), capacity=(4, 4)),
    ),
    random_nets(
        "mixed-v0",
        "Problems that differ in nets, pins and capacity, on one grid of three layers.",
        RandomNets(grid=(10, 10, 3), nets=(20, 60), max_pins=(2, 5), capacity=(3, 5)),
    ),
    random_nets(
        "large-64x64-v0",
        "A thousand nets of up to four pins on a grid of 8192 Gcells.",
        RandomNets(grid=(64, 64, 2), nets=(1000, 1000), max_pins=(4, 4), capacity=(16, 16)),
        validation=5,
        test=10,
    ),
    random_nets(
        "tight-16x16-v0",
        "A hundred two-pin nets that do not fit: overflow is to be as small as can be.",
        RandomNets(grid=(16, 16, 2), nets=(100, 100), max_pins=(2, 2), capacity=(3, 3)),
        validation=10,
        test=20,
        feasible=False,
    ),
    random_nets(
        "tight-32x32-v0",
        "Five hundred nets of up to four pins that nearly fit, if at all.",
        RandomNets(grid=(32, 32, 2), nets=(500, 500), max_pins=(4, 4), capacity=(11, 11)),
        validation=5,
        test=10,
        feasible=False,
    ),
)
"""Scenarios for planners, easiest first."""
