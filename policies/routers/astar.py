"""The paper's baseline: nets routed one after another along A* paths."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from marouting import Problem, Solution, evaluate, sequential_astar
from marouting.config import MOST, check
from marouting.rules import NetOrder, Target
from marouting.trees.decomposition import Decomposition


@dataclass(frozen=True)
class AStarRouter:
    """Sequential A* (:mod:`marouting.search.astar`).

    A* is due to Hart, Nilsson and Raphael, "A formal basis for the heuristic determination of
    minimum cost paths", IEEE Transactions on Systems Science and Cybernetics 4, 1968. The defaults
    give the paper's baseline.

    Attributes:
        net_order: which nets come first: ``half_perimeter``, those with the largest bounding box
            (as in the authors' code); ``half_perimeter_up``, those with the smallest; ``file``,
            the order in the problem; or ``random``.
        best_of: number of orders to try, ``net_order`` first and then random ones. The solution
            with the least overflow is taken, and among those the one with the least wirelength.
        target: where the path of a two-pin task ends: ``pin``, at the task's other pin (the
            paper), or ``tree``, at the nearest Gcell of the net's routed part.
        decomposition: how nets are cut into two-pin tasks: ``mst``, along a minimum spanning tree
            (the paper), or ``steiner``, along a Steiner tree.
        seconds: limit of processor time; None for no limit. No order is begun after it, apart from
            the first.
        seed: seed of the random orders.

    Raises:
        InputError: ``best_of``, ``seconds`` or ``seed`` is out of range.
    """

    net_order: Literal[NetOrder, "random"] = "half_perimeter"
    best_of: int = 1
    target: Target = "pin"
    decomposition: Decomposition = "mst"
    seconds: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check("best_of", 1 <= self.best_of <= MOST, f"a number from 1 to {MOST}")
        check("seconds", self.seconds is None or self.seconds >= 0, "a number from 0, or null")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")

    @property
    def seeded(self) -> bool:
        """Whether the router draws random numbers with these options."""
        return self.net_order == "random" or self.best_of > 1

    def route(self, problem: Problem) -> Solution:
        """Routes a problem.

        Returns:
            A solution in which every net is joined, with overflow where A* finds no way without.
        """
        return min(self._routes(problem), key=_figures)

    def _routes(self, problem: Problem) -> Iterator[Solution]:
        """The solution of each order."""
        rng = np.random.default_rng(self.seed)
        began = time.thread_time()
        order: Any = self.net_order
        for _ in range(self.best_of):
            if order == "random":
                order = rng.permutation(len(problem.nets))
            yield sequential_astar(
                problem, order, target=self.target, decomposition=self.decomposition
            )
            order = "random"
            if self.seconds is not None and time.thread_time() - began >= self.seconds:
                break


def _figures(solution: Solution) -> tuple[int, int]:
    """Overflow and wirelength; the smaller tuple is better."""
    found = evaluate(solution.problem, solution)
    return found.overflow, found.wirelength
