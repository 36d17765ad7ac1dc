"""What agents ought to see, in plain Python: Gcells are (x, y, layer), edges pairs of them.

It shares nothing with the compiled code but the state of the game.
"""

from fractions import Fraction
from itertools import combinations
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from reference import Edge, all_edges, edge_number

from marouting import Engine
from marouting.batch.state import Option
from marouting.game import Status

Gcell = tuple[int, int, int]


def squash(number: Any) -> float:
    return float(number) / (1 + abs(float(number)))


def gcell(engine: Engine, number: int) -> Gcell:
    x, y, z = engine.static.position[number].tolist()
    return x, y, z


def option_state(engine: Engine, option: Option) -> NDArray[Any]:
    """The agents' sets of an option, as bits, or its numbers of edges; empty if it is off."""
    begin, agents = int(engine.static.options[option]), engine.nets.shape[1]
    array, size = engine.dynamic.numbers, engine.grid.edges
    if option < Option.LINE:
        array, size = engine.dynamic.sets, agents
    return array[:, begin : begin + size] if begin >= 0 else array[:, :0]


def open_tasks(engine: Engine, m: int, n: int) -> list[tuple[Gcell, Gcell]]:
    """The ends of an agent's open tasks, the present one from where the agent is."""
    agent = engine.agents[m, n]
    if agent["status"] != Status.ACTIVE:
        return []
    first, end = engine.static.first[m, n : n + 2].tolist()
    rows = [row for row in range(first, end) if row > agent["task"]]
    if engine.rules.next_pin == "nearest":
        tried = np.unpackbits(option_state(engine, Option.BEGUN)[m, n], bitorder="little")
        rows = [row for row in range(first, end) if not tried[row - first]]
    if engine.rules.next_pin == "nearest" or engine.rules.target == "tree":
        # The tree as it was when the present task began: test_engine holds it against the model.
        tree = np.unpackbits(option_state(engine, Option.TREE)[m, n], bitorder="little")
        rows = [row for row in rows if not tree[engine.static.tasks[row, 1]]]
    later = [engine.static.tasks[row] for row in rows]
    return [
        (gcell(engine, a), gcell(engine, b)) for a, b in [(agent["cell"], agent["target"]), *later]
    ]


def is_priced(engine: Engine, m: int) -> bool:
    game = engine.games[m]
    return engine.priced and bool(game["plain"] == 0)


def edge_costs(
    engine: Engine, m: int, n: int, taken: dict[Edge, Any] | None
) -> dict[Edge, float | None]:
    """What every edge costs net n; None for one that it cannot cross."""
    problem = engine.problems[m]
    costs: dict[Edge, float | None] = {}
    for edge in all_edges(problem):
        costs[edge] = 1.0
        if edge[0][2] != edge[1][2]:
            continue
        number = edge_number(problem, edge)
        demand = int(engine.static.demand[m, n, edge[0][2]])
        own = np.unpackbits(engine.dynamic.used[m, n], bitorder="little")[number]
        remaining = int(engine.dynamic.remaining[m, number]) + demand * int(own)
        if is_priced(engine, m):
            game, price = engine.games[m], int(option_state(engine, Option.PRICES)[m, number])
            cost, over = 16 + int(price / 64 + 0.5), demand - remaining
            if over > 0 and demand:
                cost = cost * (1024 + int(game["present"]) * over // demand) // 1024
            blocked = demand > engine.static.capacity[m, number]
            costs[edge] = 60.0 if blocked else min(cost / 16, 60)
        elif remaining < demand:
            costs[edge] = 33.0 if engine.static.overflow_allowed else None
        elif taken is not None:
            # In float32 like the router's, so that both round the same quarters down.
            slack = (np.float32(remaining) - np.float32(taken[edge])) / np.float32(max(demand, 1))
            scarce = max(-4 * (slack - np.float32(1)), 0)
            costs[edge] += min(int(scarce), 16) / 4  # type: ignore[operator]
    return costs


def cheapest_tree(costs: dict[Edge, float | None], pins: set[Gcell]) -> float:
    """What the cheapest tree that joins pins costs, after Dreyfus and Wagner."""
    graph: nx.Graph[Gcell] = nx.Graph()
    graph.add_weighted_edges_from((*edge, cost) for edge, cost in costs.items())
    apart = dict(nx.all_pairs_dijkstra_path_length(graph))
    root, *others = sorted(pins)
    trees: dict[frozenset[Gcell], dict[Gcell, float]] = {}
    for size in range(1, len(others) + 1):
        for group in map(frozenset, combinations(others, size)):
            halves = [frozenset(part) for k in range(1, size) for part in combinations(group, k)]
            met = {
                cell: min(trees[half][cell] + trees[group - half][cell] for half in halves)
                if halves
                else (0.0 if cell in group else np.inf)
                for cell in graph
            }
            trees[group] = {a: min(met[b] + apart[a][b] for b in graph) for a in graph}
    return trees[frozenset(others)][root] if others else 0.0


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
