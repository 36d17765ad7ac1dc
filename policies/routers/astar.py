"""The paper's benchmark: nets one after the other along A* paths."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from marouting import Problem, Solution, evaluate, sequential_astar
from marouting.config import MOST, check
from marouting.game.options import NetOrder
from marouting.search.astar import Target
from marouting.trees.decomposition import Decomposition


@dataclass(frozen=True)
class AStarRouter:
    """Sequential A* (:mod:`marouting.search.astar`); the defaults are the paper's benchmark.

    Attributes:
        net_order: which nets come first: ``half_perimeter`` (the largest bounding box, as in the
            authors' code), ``half_perimeter_up`` (the smallest), ``file``, or ``random``.
        best_of: orders to try, of which the solution with the least overflow, and then the least
            wirelength, is taken: that of ``net_order`` first, the others random.
        target: where a task's path ends: ``pin``, at the task's other pin (the paper), or ``tree``,
            at the nearest Gcell of what is routed of the net.
        decomposition: of nets into tasks: ``mst`` (the paper) or ``steiner``.
        seed: where random orders start.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    name: ClassVar[str] = "astar"
    net_order: NetOrder | Literal["random"] = "half_perimeter"
    best_of: int = 1
    target: Target = "pin"
    decomposition: Decomposition = "mst"
    seed: int = 0

    def __post_init__(self) -> None:
        check("best_of", 1 <= self.best_of <= MOST, f"a number from 1 to {MOST}")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")

    @property
    def seeded(self) -> bool:
        """Whether it draws random numbers."""
        return self.net_order == "random" or self.best_of > 1

    def route(self, problem: Problem) -> Solution:
        """A solution with every net joined, with overflow where there is no other way."""
        return min(self._routes(problem), key=_figures)

    def _routes(self, problem: Problem) -> Iterator[Solution]:
        """The solutions of all orders."""
        rng = np.random.default_rng(self.seed)
        order: Any = self.net_order
        for _ in range(self.best_of):
            if order == "random":
                order = rng.permutation(len(problem.nets))
            yield sequential_astar(
                problem, order, target=self.target, decomposition=self.decomposition
            )
            order = "random"


def _figures(solution: Solution) -> tuple[int, int]:
    """What is better is less."""
    found = evaluate(solution.problem, solution)
    return found.overflow, found.wirelength
