"""A* as a router and as a player: the paper's benchmark, and moves in a running game.

Both walk the paths of plain A* (:mod:`marouting.search.plain` explains costs, heuristic and ties;
paper, section "Problem breakdown and A* Search Solver"), found as :mod:`marouting.search.bounded`
does. The goals of a search are one pin, or with ``target="tree"`` all Gcells of the net's own tree
so far.

A net's own edges are free of demand, so it makes no difference whether the demand is taken after
each task or after the whole net.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.bits import set_byte
from marouting.batch.engine import Engine
from marouting.batch.rules import move_agent
from marouting.batch.setup import dynamic_state, static_state
from marouting.batch.state import Dynamic, Static
from marouting.batch.tasks import begin_task
from marouting.game import NOBODY, Crossing, NetOrder, Rules, Status, Target
from marouting.kernels import compiled, wide
from marouting.memory import PLAYED, SEARCH, TABLES, check_memory
from marouting.problem.problem import Problem, check_choice, check_problem
from marouting.problem.solution import Solution
from marouting.search.bounded import SearchBuffers, path_to_goals, search_buffers, shortest_path
from marouting.search.plain import add_goal, clear_goals
from marouting.trees.decomposition import Decomposition

_EDGES_PER_TASK = 8  # initial room for the edges of routes; it doubles as needed


@compiled
def _route(
    static: Static,
    dynamic: Dynamic,
    s: SearchBuffers,
    demand: Any,
    nets: Any,
    to_tree: bool,
    turn: int,
    uses: Any,
    size: int,
) -> tuple[int, int]:
    """Routes a problem's nets, one after another in turn order, along cheapest paths.

    A routed net matters to the others only through the capacity it took. So the game has a single
    agent, which stands for every net in turn: no net needs its own map of used edges.

    Args:
        static: the problem; the demand of its first agent is overwritten.
        dynamic: the game, with room for one agent.
        s: working arrays.
        demand: (N, Z) the demand of every agent on an edge of each layer.
        nets: (N,) the net of every agent.
        to_tree: whether a task's path leads from its target to the nearest Gcell of the net's
            tree, instead of from its start to its target.
        turn: place in the turn order to go on from.
        uses: receives net · E + edge for every net and every edge that it uses. Routing stops
            when there might not be room for another net.
        size: how many uses there are already.

    Returns:
        Place in the turn order of the next net to route, and how many uses there are.
    """
    m = n = wide(0)
    agent = dynamic.agents[m, n]
    edges = static.capacity.shape[1]
    while turn < len(nets) and size + edges <= len(uses):
        member = wide(static.order[m, turn])
        net = wide(nets[member])
        turn += 1
        for layer in range(demand.shape[1]):
            static.demand[m, n, layer] = demand[member, layer]
        before = size
        first = wide(static.first[m, member])
        for task in range(first, wide(static.first[m, member + 1])):
            begin_task(static, dynamic, m, n, task)
            if task == first or not to_tree:
                clear_goals(s.plain)
            if to_tree:
                add_goal(static, s.plain, wide(agent.cell))
                agent.cell = agent.target
            else:
                add_goal(static, s.plain, wide(agent.target))
            length = path_to_goals(static, dynamic, s, m, n, wide(agent.cell))
            for i in range(length):
                edge = wide(static.edge[agent.cell, s.path[i]])
                if to_tree:
                    add_goal(static, s.plain, wide(agent.cell))
                move_agent(static, dynamic, m, n, wide(s.path[i]))
                if agent.crossing == Crossing.NEW:
                    uses[size] = net * edges + edge
                    size += 1
        for i in range(before, size):
            edge = uses[i] - net * edges
            set_byte(dynamic.used, m, n, edge >> 3, wide(0))
    return turn, size


@compiled
def _first_moves(
    static: Static, dynamic: Dynamic, s: SearchBuffers, problems: Any, agents: Any, out: Any
) -> None:
    """Writes the moves of agents (K,) of problems (K,) to ``out`` (K,) int8."""
    for i in range(len(problems)):
        m, n = wide(problems[i]), wide(agents[i])
        out[i] = NOBODY
        if n != NOBODY and dynamic.agents[m, n].status == Status.ACTIVE:
            agent = dynamic.agents[m, n]
            shortest_path(static, dynamic, s, m, n, wide(agent.cell), wide(agent.target))
            out[i] = s.path[0]


class AStar:
    """Moves along A* paths in a running game.

    Every move is the first of a cheapest path from where the agent is to its target, with the
    capacities as they are now. An agent alone on the grid walks one A* path; among others it finds
    a new one whenever they take its capacity.

    Args:
        engine: the game to move in.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._buffers = search_buffers(engine.grid)

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """The next moves of K agents, which the caller may make or not.

        Args:
            problems: (K,) integers, the problem of each agent.
            agents: (K,) integers, the agents; NOBODY for none.

        Returns:
            (K,) int8; NOBODY for an agent that is not active.
        """
        out = np.empty(len(problems), np.int8)
        _first_moves(
            self._engine.static, self._engine.dynamic, self._buffers, problems, agents, out
        )
        return out


def sequential_astar(
    problem: Problem,
    net_order: NetOrder | NDArray[np.integer] = "half_perimeter",
    *,
    target: Target = "pin",
    decomposition: Decomposition = "mst",
) -> Solution:
    """The paper's benchmark router: nets one after another, each task along a cheapest path.

    Args:
        problem: the problem to route.
        net_order: which nets come first, see :class:`marouting.game.Rules`; or
            (nets,) integers, smallest first.
        target: where a task's path ends: ``pin``, at the task's other pin (the paper); ``tree``, at
            the nearest Gcell of the net's route so far.
        decomposition: how nets are cut into tasks, see
            :func:`marouting.trees.decomposition.two_pin_tasks`.

    Returns:
        A solution in which every net is joined, with overflow where A* found no cheaper way.

    Raises:
        InputError: there is no such order, target or decomposition, or the grid takes too much
            memory.
    """
    check_problem(problem)
    check_choice("target", target, Target)
    grid = problem.topology
    check_memory(grid.gcells * (TABLES + PLAYED + SEARCH), "A* on a grid of {}", grid)
    _, gcells = problem.flat_pin_gcells
    tasks = len(gcells) - len(problem.nets)
    uses, size, turn = np.empty(_EDGES_PER_TASK * tasks + grid.edges, np.int64), 0, 0
    if tasks:
        rules = Rules(
            net_order=net_order if isinstance(net_order, str) else "file",
            overflow="allowed",
            decomposition=decomposition,
            max_steps=grid.gcells,  # as long as a path without a loop can be
        )
        ranks = None if isinstance(net_order, str) else net_order
        static, (nets,) = static_state((problem,), rules, ranks)
        dynamic = dynamic_state(static, grid, 1)
        dynamic.remaining[...] = static.capacity
        buffers, demand, to_tree = search_buffers(grid), static.demand[0].copy(), target == "tree"
        while True:
            turn, size = _route(static, dynamic, buffers, demand, nets, to_tree, turn, uses, size)
            if turn == len(nets):
                break
            uses = np.concatenate((uses, np.empty_like(uses)))
    uses = uses[:size]
    uses.sort()
    return Solution.of_uses(problem, *np.divmod(uses, grid.edges))
