"""The paper's benchmark: nets one after the other along A* paths."""

from dataclasses import dataclass
from typing import ClassVar

from marouting import Problem, Solution, sequential_astar
from marouting.engine import NetOrder


@dataclass(frozen=True)
class AStarRouter:
    """Sequential A* (:mod:`marouting.search`).

    Attributes:
        net_order: which nets come first; the authors' code starts with the largest bounding box.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    name: ClassVar[str] = "astar"
    net_order: NetOrder = "half_perimeter"

    def route(self, problem: Problem) -> Solution:
        """A solution with every net joined, with overflow where there is no other way."""
        return sequential_astar(problem, self.net_order)
