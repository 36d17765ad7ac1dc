"""Sequential A* over the capacity grid (paper, section "Problem breakdown and A* Search Solver").

A step costs 1, or 1000 across an edge without remaining capacity, and the heuristic is the
Manhattan distance. An edge that the net already uses costs 1 however full it is: crossing it again
takes nothing. With that it makes no difference whether a net's demand is taken after each task or
after the whole net.

A search leads from one Gcell to the nearest of its **goals**: one pin, or with ``target="tree"``
all Gcells of the net's own tree so far. The heuristic is then the distance to the box around them.

Ties are broken the same way everywhere: of the Gcells with the lowest f = g + h the one found last
is opened first, and neighbours are found in the order of :class:`marouting.problem.grid.Move`.
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.game.engine import Engine
from marouting.game.options import NetOrder, RuleOptions
from marouting.game.rules import begin_task, has_room, move_agent
from marouting.game.setup import static_state
from marouting.game.state import AGENT, GAME, NOBODY, Crossing, Dynamic, Static, Status
from marouting.kernels import compiled, inlined, place, wide
from marouting.problem.grid import AXES, MOVES, Grid
from marouting.problem.problem import Problem, check_choice
from marouting.problem.solution import Solution
from marouting.trees.decomposition import Decomposition

Target = Literal["pin", "tree"]

STEP_COST = 1
FULL_COST = 1000
"""Cost of a step, and of one across an edge without remaining capacity (paper, section 3.3)."""

_WALL_COST = FULL_COST - STEP_COST
"""What an edge without remaining capacity adds to the cost of a way, at least."""

_LEVELS = 1 << (FULL_COST + 1 + _WALL_COST).bit_length()
"""Heads of the open list. The heuristic is consistent: along a step f = g + h does not fall, and it
grows by the step's cost, a step and a wall at most. No two entries' f are farther apart."""

_MASK = _LEVELS - 1
_NONE = -1
_UNKNOWN = -1  # cost of a way

_EDGES_A_TASK = 8  # room to begin with for the edges of the routes; it is doubled as they grow

NODE = np.dtype(
    [
        ("stamp", np.int64),  # the search that found the Gcell; negative once it is opened
        ("cost", np.int64),  # cheapest way found to the Gcell, where stamp is the search's
        ("came", np.int8),  # the move that the cheapest way ends with
    ],
    align=True,
)
"""A Gcell in a search."""


class SearchBuffers(NamedTuple):
    """Working arrays of a search, reused from one to the next without clearing."""

    nodes: NDArray[Any]  # (G,) NODE
    head: NDArray[np.int32]  # (_LEVELS,) entry found last of those with an f; _NONE: there is none
    below: NDArray[np.int32]  # (6 G,) the entry with the same f found before an entry
    cell: NDArray[np.int32]  # (6 G,) the Gcell of an entry
    path: NDArray[np.int8]  # (G,) the moves of the path
    depth: NDArray[np.int64]  # (G,) walls between a Gcell and the goals, see _INSIDE
    ring: NDArray[np.int32]  # (G,) Gcells around the goals
    goals: NDArray[np.int32]  # (G,) the goals, the first size[0] of them
    size: NDArray[np.int64]  # (1,)
    mark: NDArray[np.int64]  # (G,) goal[0] for a goal
    goal: NDArray[np.int64]  # (1,) sets of goals so far
    box: NDArray[np.int64]  # (3, 2) lowest and highest x, y, z of a goal
    search: NDArray[np.int64]  # (1,) searches so far
    walls: NDArray[np.int64]  # (3,) see the constants below


_INSIDE = 0  # the depth of Gcells behind no wall; what is less stems from an earlier search
_KNOWN = 1  # walls that are known
_NEXT = 2  # how many Gcells a search opens before it looks for more


def search_buffers(grid: Grid) -> SearchBuffers:
    """Working arrays for one grid shape."""
    g = grid.gcells
    return SearchBuffers(
        nodes=np.zeros(g, NODE),
        head=np.empty(_LEVELS, np.int32),
        below=np.empty(MOVES * g, np.int32),
        cell=np.empty(MOVES * g, np.int32),
        path=np.empty(g, np.int8),
        depth=np.zeros(g, np.int64),
        ring=np.empty(g, np.int32),
        goals=np.empty(g, np.int32),
        size=np.zeros(1, np.int64),
        mark=np.zeros(g, np.int64),
        goal=np.zeros(1, np.int64),
        box=np.empty((AXES, 2), np.int64),
        search=np.zeros(1, np.int64),
        walls=np.zeros(3, np.int64),
    )


@inlined
def _distance(position: Any, cell: int, box: Any) -> int:
    """Manhattan distance of a Gcell from a box (3, 2), over x, y and layer."""
    distance = wide(0)
    for axis in range(AXES):
        at = position[cell, axis]
        distance += max(box[axis, 0] - at, 0) + max(at - box[axis, 1], 0)
    return distance


@inlined
def _no_goals(s: SearchBuffers) -> None:
    """Forgets all goals."""
    s.goal[0] += 1
    s.size[0] = 0


@inlined
def _add_goal(static: Static, s: SearchBuffers, cell: int) -> None:
    """Makes a Gcell a goal, unless it is one."""
    if s.mark[cell] == s.goal[0]:
        return
    s.mark[cell] = s.goal[0]
    s.goals[s.size[0]] = cell
    for axis in range(AXES):
        at = wide(static.position[cell, axis])
        s.box[axis, 0] = at if s.size[0] == 0 else min(s.box[axis, 0], at)
        s.box[axis, 1] = at if s.size[0] == 0 else max(s.box[axis, 1], at)
    s.size[0] += 1


@inlined
def _look_around(
    static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int, budget: int
) -> int:
    """Finds walls around the goals: edges without capacity that no way gets around.

    Floods the Gcells that a goal can be reached from for nothing but steps, then those behind one
    wall, and so on, until the source is reached or the budget of more Gcells is used up.

    Returns:
        The walls that every way crosses from where has not been flooded.
    """
    s.walls[_INSIDE] += len(s.depth) + 1
    inside = s.walls[_INSIDE]
    first = last = at = walls = 0  # the Gcells behind as many walls begin with the first
    size = s.size[0]
    budget += size
    for i in range(size):
        s.ring[i] = s.goals[i]
        s.depth[s.goals[i]] = inside
    flooding = True  # as far as there is room; otherwise looking behind the next wall
    while True:
        if at == (size if flooding else last):
            if flooding:
                walls += 1
                last = size
            else:
                first = last
            at = first
            flooding = not flooding
            continue
        if flooding and size > budget:
            return walls
        cell = place(s.ring[at])
        at += 1
        for move in range(MOVES):
            if not static.exits[cell] >> move & 1:
                continue
            beside = place(static.neighbour[cell, move])
            if s.depth[beside] >= inside:
                continue
            if flooding and not has_room(static, dynamic, m, n, cell, move):
                continue
            if beside == source:
                return walls
            s.depth[beside] = inside + walls
            s.ring[size] = beside
            size += 1


@inlined
def _search(
    static: Static,
    dynamic: Dynamic,
    s: SearchBuffers,
    m: int,
    n: int,
    source: int,
    distance: int,
    most: int,
) -> tuple[int, int]:
    """One A* search from source to the goals.

    A goal that is walled in makes plain A* open the whole grid, in the vain hope of a way around
    that is cheaper than a full edge. So where a search takes long it looks for walls around the
    goals. Those that it knows of are part of the heuristic as long as the cost of a cheapest way
    is not known. Once it is, plain A* finds the way, without the Gcells from which the walls make
    every way cost more: none of them, and nothing found from there, is on a cheapest way.

    Args:
        static: the game.
        dynamic: how it stands.
        s: working arrays; ``s.walls`` tells what is known of walls.
        m: the problem.
        n: the agent.
        source: the Gcell to start from.
        distance: of it from the box around the goals.
        most: what a cheapest way costs, or _UNKNOWN.

    Returns:
        What a cheapest way costs, or _UNKNOWN if more walls came to light; and the goal it ends at.
    """
    s.search[0] += 1
    found = s.search[0]
    walls = s.walls[_KNOWN]
    for level in range(_LEVELS):
        s.head[level] = _NONE
    s.nodes[source].cost = 0
    f = distance
    if most == _UNKNOWN:
        f += _WALL_COST * walls  # the source lies behind all walls that are known
    entries = opened = 0
    cell, goal = source, s.goal[0]
    while s.mark[cell] != goal:
        s.nodes[cell].stamp = -found  # the heuristic is consistent: this cost is final
        opened += 1
        if opened == s.walls[_NEXT] and most == _UNKNOWN:
            s.walls[_NEXT] *= 4
            s.walls[_KNOWN] = _look_around(static, dynamic, s, m, n, source, opened // 4)
            if s.walls[_KNOWN] > walls:
                return wide(_UNKNOWN), cell
        exits = static.exits[cell]
        so_far, left = s.nodes[cell].cost, _distance(static.position, cell, s.box)
        for move in range(MOVES):
            if not exits >> move & 1:
                continue
            beside = place(static.neighbour[cell, move])
            node = s.nodes[beside]
            if node.stamp == -found:
                continue
            cost = so_far + (
                STEP_COST if has_room(static, dynamic, m, n, cell, move) else FULL_COST
            )
            if node.stamp == found and node.cost <= cost:
                continue
            # Even moves go up their axis, odd ones down: nearer outside the box, or farther.
            at, low, high = (
                static.position[cell, move >> 1],
                s.box[move >> 1, 0],
                s.box[move >> 1, 1],
            )
            nearer = at > high if move & 1 else at < low
            farther = at <= low if move & 1 else at >= high
            level = cost + left + farther - nearer
            if walls > 0:
                depth = s.depth[beside] - s.walls[_INSIDE]
                least = level + _WALL_COST * (depth if 0 <= depth < walls else walls)
                if most == _UNKNOWN:
                    level = least
                elif least > most:
                    continue
            node.stamp = found
            node.cost = cost
            node.came = move
            s.cell[entries] = beside
            s.below[entries] = s.head[level & _MASK]
            s.head[level & _MASK] = entries
            entries += 1
        while s.nodes[cell].stamp != found:
            while s.head[f & _MASK] == _NONE:
                f += 1
            entry = place(s.head[f & _MASK])
            s.head[f & _MASK] = s.below[entry]
            cell = place(s.cell[entry])
    return s.nodes[cell].cost, cell


@compiled
def _path(static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int) -> int:
    """Finds a cheapest path to the goals, into ``s.path``; returns the number of moves."""
    s.walls[_KNOWN] = 0
    distance = _distance(static.position, source, s.box)
    s.walls[_NEXT] = 16 * (distance + 8)
    most = wide(_UNKNOWN)
    while True:
        cost, cell = _search(static, dynamic, s, m, n, source, distance, most)
        if most != _UNKNOWN or (cost != _UNKNOWN and s.walls[_KNOWN] == 0):
            break
        most = cost
    length = 0
    while cell != source:
        came = s.nodes[cell].came
        s.path[length] = came
        length += 1
        cell = wide(static.neighbour[cell, came ^ 1])  # the opposite move
    for i in range(length // 2):
        s.path[i], s.path[length - 1 - i] = s.path[length - 1 - i], s.path[i]
    return length


@compiled
def shortest_path(
    static: Static, dynamic: Dynamic, s: SearchBuffers, m: int, n: int, source: int, target: int
) -> int:
    """A cheapest path of agent n in problem m as it stands.

    Returns:
        The number of moves, which lie in ``s.path``; 0 if source and target are one Gcell.
    """
    _no_goals(s)
    _add_goal(static, s, target)
    return _path(static, dynamic, s, m, n, source)


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
    """Routes a problem's nets, one after the other in turn order, along cheapest paths.

    A net that is routed takes part in the game only by the capacity that is gone. So the game is
    one of a single agent, the first, which is every net in turn: memory does not grow by a map of
    the grid for every net.

    Args:
        static: the problem; the demand of the first agent is written over.
        dynamic: the game, with room for a single agent.
        s: working arrays.
        demand: (N, Z) the demand of all agents.
        nets: (N,) the net of every agent.
        to_tree: whether a task leads from its target to the nearest Gcell of the net's tree.
        turn: place in the turn order to go on from.
        uses: where net · E + edge goes for every net and edge that it uses. Routing stops where
            there might not be room for another net.
        size: how many there are already.

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
                _no_goals(s)
            if to_tree:
                _add_goal(static, s, wide(agent.cell))
                agent.cell = agent.target
            else:
                _add_goal(static, s, wide(agent.target))
            length = _path(static, dynamic, s, m, n, wide(agent.cell))
            for i in range(length):
                edge = wide(static.edge[agent.cell, s.path[i]])
                if to_tree:
                    _add_goal(static, s, wide(agent.cell))
                move_agent(static, dynamic, m, n, wide(s.path[i]))
                if agent.crossing == Crossing.NEW:
                    uses[size] = net * edges + edge
                    size += 1
        for i in range(before, size):
            edge = uses[i] - net * edges
            dynamic.used[m, n, edge >> 3] = 0
    return turn, size


@compiled
def _first_moves(
    static: Static, dynamic: Dynamic, s: SearchBuffers, problems: Any, agents: Any, out: Any
) -> None:
    for i in range(len(problems)):
        m, n = wide(problems[i]), wide(agents[i])
        out[i] = NOBODY
        if n != NOBODY and dynamic.agents[m, n].status == Status.ACTIVE:
            agent = dynamic.agents[m, n]
            shortest_path(static, dynamic, s, m, n, wide(agent.cell), wide(agent.target))
            out[i] = s.path[0]


class AStar:
    """Moves along A* paths in a running game.

    Every move is the first of a cheapest path from where the agent stands to its target, with the
    capacities as they are: alone on the grid the agent walks an A* path, and among others it
    finds a new one whenever they take its capacity.

    Args:
        engine: the game to move in.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._scratch = search_buffers(engine.grid)

    def moves(self, problems: NDArray[np.integer], agents: NDArray[np.integer]) -> NDArray[np.int8]:
        """(K,) int8 moves of K agents; NOBODY for one that is not active."""
        out = np.empty(len(problems), np.int8)
        _first_moves(
            self._engine.static, self._engine.dynamic, self._scratch, problems, agents, out
        )
        return out


def sequential_astar(
    problem: Problem,
    net_order: NetOrder | NDArray[np.integer] = "half_perimeter",
    *,
    target: Target = "pin",
    decomposition: Decomposition = "mst",
) -> Solution:
    """The paper's benchmark router: nets one after the other, each task along a cheapest path.

    Args:
        problem: the problem to route.
        net_order: which nets come first, see :class:`marouting.game.engine.Engine`; or (nets,)
            numbers, the net with the least first.
        target: where a task's path ends: ``pin``, at the task's other pin (the paper); or ``tree``,
            at the nearest Gcell of what is routed of the net.
        decomposition: of nets into tasks, see :func:`marouting.trees.decomposition.two_pin_tasks`.

    Returns:
        A solution with every net joined, overflow where A* preferred it to no way at all.

    Raises:
        InputError: no such target or decomposition.
    """
    check_choice("target", target, Target)
    grid = problem.topology
    _, gcells = problem.flat_pin_gcells
    joints = len(gcells) - len(problem.nets)
    uses, size, turn = np.empty(_EDGES_A_TASK * joints + grid.edges, np.int64), 0, 0
    if joints:
        rules = RuleOptions(
            net_order=net_order if isinstance(net_order, str) else "file",
            overflow="allowed",
            decomposition=decomposition,
            max_steps=grid.gcells,  # as long as a path without a loop can be
        )
        ranks = None if isinstance(net_order, str) else net_order
        static, (nets,) = static_state((problem,), rules, ranks)
        dynamic = Dynamic(
            remaining=static.capacity.copy(),
            used=np.zeros((1, 1, (grid.edges + 7) // 8), np.uint8),
            agents=np.zeros((1, 1), AGENT),
            games=np.zeros(1, GAME),
        )
        working, demand, to_tree = search_buffers(grid), static.demand[0].copy(), target == "tree"
        while True:
            turn, size = _route(static, dynamic, working, demand, nets, to_tree, turn, uses, size)
            if turn == len(nets):
                break
            uses = np.concatenate((uses, np.empty_like(uses)))
    uses = uses[:size]
    uses.sort()
    return Solution.of_uses(problem, *np.divmod(uses, grid.edges))
