"""Step 2: an integer program chooses one of the trees found for each net."""

import operator
from typing import Any

import numpy as np

from policies.routers.optimal.candidates import Candidates
from policies.routers.optimal.programs import Deadline, Objective, Program, tree_columns


def choose(candidates: Candidates, objective: Objective, deadline: Deadline) -> None:
    """Chooses trees for least overflow beyond the objective's, then for least length.

    The solver stops at the first node of its search tree: hard cases are left to step 3. What it
    finds is added to the candidates.

    Args:
        candidates: the trees to choose from.
        objective: what is minimised.
        deadline: when to stop.
    """

    def solved() -> Any:
        columns = tree_columns(candidates)
        longest = np.zeros(len(candidates.nets))
        np.maximum.at(longest, [net for net, _ in candidates.trees], columns.length)
        excess = 1 + longest.sum()
        program = Program(columns, candidates.capacity, objective, excess)
        return program.solve_whole(deadline, node_limit=1)

    result = deadline.bounded(solved)
    if result is not None and result.x is not None:
        trees = candidates.trees
        chosen = (trees[i] for i in np.flatnonzero(result.x[: len(trees)] > 0.5))
        candidates.add_routes([tree for _, tree in sorted(chosen, key=operator.itemgetter(0))])
