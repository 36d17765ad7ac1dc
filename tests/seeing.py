"""What agents ought to see, in plain Python: Gcells are (x, y, layer), edges pairs of them.

It shares nothing with the compiled code but the state of the game.
"""

from fractions import Fraction
from typing import Any

import numpy as np
from reference import Edge, all_edges, edge_number

from marouting import Engine
from marouting.game.state import Status

Gcell = tuple[int, int, int]


def squash(number: Any) -> float:
    return float(number) / (1 + abs(float(number)))


def gcell(engine: Engine, number: int) -> Gcell:
    x, y, z = engine.static.position[number].tolist()
    return x, y, z


def open_tasks(engine: Engine, m: int, n: int) -> list[tuple[Gcell, Gcell]]:
    """The ends of an agent's open tasks, the present one from where the agent is."""
    agent = engine.agents[m, n]
    if agent["status"] != Status.ACTIVE:
        return []
    first, end = engine.static.first[m, n : n + 2].tolist()
    rows = [row for row in range(first, end) if row > agent["task"]]
    if engine.rules.next_task == "nearest":
        tried = np.unpackbits(engine.more.tried[m, n], bitorder="little")
        rows = [row for row in range(first, end) if not tried[row - first]]
    if engine.rules.next_task == "nearest" or engine.rules.target == "tree":
        # The tree as it was when the present task began: test_engine holds it against the model.
        tree = np.unpackbits(engine.more.tree[m, n], bitorder="little")
        rows = [row for row in rows if not tree[engine.static.tasks[row, 1]]]
    later = [engine.static.tasks[row] for row in rows]
    return [
        (gcell(engine, a), gcell(engine, b)) for a, b in [(agent["cell"], agent["target"]), *later]
    ]


def expected(engine: Engine, m: int, agents: list[int]) -> dict[Edge, Fraction]:
    """The demand that agents are expected to put on edges."""
    problem = engine.problems[m]
    edges = [edge for edge in all_edges(problem) if edge[0][2] == edge[1][2]]
    taken: dict[Edge, Fraction] = dict.fromkeys(edges, Fraction(0))
    lanes: dict[int, set[int]] = {}
    for axis in (0, 1):
        along = [edge for edge in edges if edge[0][axis] != edge[1][axis]]
        layers = {
            edge[0][2]
            for edge in along
            if engine.static.capacity[m, edge_number(problem, edge)] > 0
        }
        lanes[axis] = layers or set(range(problem.grid[2]))
    for n in agents:
        for near, far in open_tasks(engine, m, n):
            low, high = np.minimum(near, far), np.maximum(near, far)
            for edge in edges:
                inside = all(
                    low[axis] <= end[axis] <= high[axis] for end in edge for axis in (0, 1)
                )
                axis = 0 if edge[0][0] != edge[1][0] else 1
                if inside and edge[0][2] in lanes[axis]:
                    choices = int(high[1 - axis] - low[1 - axis] + 1) * len(lanes[axis])
                    demand = int(engine.static.demand[m, n, edge[0][2]])
                    # Counted in parts of 2**-20, rounded down.
                    taken[edge] += Fraction((demand << 20) // choices, 1 << 20)
    return taken
