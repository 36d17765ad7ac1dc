"""A* on a problem's capacity grid: the search, and the paper's benchmark router that is made of it.

A path leads from one Gcell to the nearest of its goals (paper, section "Problem breakdown and A*
Search Solver"). A step costs 1, or 1000 across an edge without remaining capacity. An edge that the
net already uses costs 1 however full it is, because crossing it again takes no capacity.

The heuristic is the Manhattan distance, over x, y and layer, to the box around the goals. Along a
step it falls by no more than the step costs, so f = g + h never falls along a path, and the cost of
a Gcell is final once the Gcell is opened.

Ties are broken in one way everywhere: of the Gcells with the lowest f the one found last is opened
first, and the neighbours of a Gcell are found in the order of
:class:`marouting.problem.grid.Move`.

The **open list** is a stack of entries for each f, so the entry found last is on top. A Gcell that
is found again by a cheaper path gets a second entry; the entry left behind is skipped when its turn
comes. As all f in the list lie close together, the stacks are kept in a ring, f modulo LEVELS.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.kernels import as_index, compiled, i64
from marouting.memory import SEARCH, TABLES, check_memory
from marouting.problem.grid import AXES, MOVES, VIA_AXIS, Grid
from marouting.problem.problem import UNLIMITED, Problem, check_choice, check_problem
from marouting.problem.solution import Solution
from marouting.rules import NetOrder, Target, net_ranks
from marouting.trees.decomposition import Decomposition, two_pin_tasks

COMPILES = "A*", 8

STEP_COST = 1
FULL_COST = 1000
"""Cost of a step, and of one across an edge without remaining capacity (paper, section 3.3)."""

LEVELS = 1 << (FULL_COST + 1).bit_length()
"""Stacks of the open list. Along a step f grows by FULL_COST + 1 at most; no two f in the list are
farther apart."""

_RING = LEVELS - 1
_EMPTY = -1
_EDGES_PER_TASK = 8  # initial room for the edges of routes; it doubles as needed

NODE = np.dtype(
    [
        ("stamp", np.int64),  # the search that found the Gcell; negative once it is opened
        ("cost", np.int64),  # g: cost of the cheapest path found, where stamp is the search's
        ("came", np.int8),  # the last move of that path
    ],
    align=True,
)
"""A Gcell in a search."""


class Capacities(NamedTuple):
    """What a search sees: the grid, what is left of its edges, and one net's part in them."""

    neighbour: NDArray[np.int32]  # (G, 6) Gcell that a move leads to
    edge: NDArray[np.int32]  # (G, 6) edge that a move crosses
    exits: NDArray[np.uint8]  # (G,) bit per move: it is possible
    position: NDArray[np.int32]  # (G, 3) x, y, z of a Gcell
    remaining: NDArray[np.int32]  # (E,) remaining capacity
    demand: NDArray[np.int32]  # (Z,) the net's demand on an edge of each layer
    own: NDArray[np.int64]  # (E,) the number of the last net that used an edge
    net: NDArray[np.int64]  # (1,) the number of the present net


class Search(NamedTuple):
    """Working arrays of searches, reused from one to the next without clearing."""

    number: NDArray[np.int64]  # (1,) of the current search, from 1
    nodes: NDArray[Any]  # (G,) NODE
    head: NDArray[np.int32]  # (LEVELS,) top entry of each stack, or _EMPTY
    below: NDArray[np.int32]  # (6 G,) the entry below each entry, or _EMPTY
    cell: NDArray[np.int32]  # (6 G,) the Gcell of each entry
    goal_set: NDArray[np.int64]  # (1,) number of the current set of goals
    goal_mark: NDArray[np.int64]  # (G,) the latest set of goals that a Gcell was in
    goals: NDArray[np.int32]  # (G,) the current goals, goal_count[0] of them
    goal_count: NDArray[np.int64]  # (1,)
    box: NDArray[np.int64]  # (3, 2) lowest and highest x, y, z of a goal
    path: NDArray[np.int8]  # (G,) the moves of the path found


def make_search(grid: Grid) -> Search:
    """Working arrays for grids of this shape."""
    g = grid.gcells
    return Search(
        number=np.zeros(1, np.int64),
        nodes=np.zeros(g, NODE),
        head=np.empty(LEVELS, np.int32),
        below=np.empty(MOVES * g, np.int32),
        cell=np.empty(MOVES * g, np.int32),
        goal_set=np.zeros(1, np.int64),
        goal_mark=np.zeros(g, np.int64),
        goals=np.empty(g, np.int32),
        goal_count=np.zeros(1, np.int64),
        box=np.empty((AXES, 2), np.int64),
        path=np.empty(g, np.int8),
    )


# --- Goals ----------------------------------------------------------------------------------------


@compiled
def clear_goals(s: Search) -> None:
    """Starts a new, empty set of goals."""
    s.goal_set[0] += 1
    s.goal_count[0] = 0


@compiled
def is_goal(s: Search, cell: int) -> bool:
    """Whether a Gcell is one of the current goals."""
    return s.goal_mark[cell] == s.goal_set[0]


@compiled
def add_goal(w: Capacities, s: Search, cell: int) -> None:
    """Makes a Gcell a goal, unless it is one already."""
    if is_goal(s, cell):
        return
    count = s.goal_count[0]
    s.goal_mark[cell] = s.goal_set[0]
    s.goals[count] = cell
    s.goal_count[0] = count + 1
    for axis in range(AXES):
        at = i64(w.position[cell, axis])
        s.box[axis, 0] = at if count == 0 else min(s.box[axis, 0], at)
        s.box[axis, 1] = at if count == 0 else max(s.box[axis, 1], at)


@compiled
def _distance_left(w: Capacities, s: Search, cell: int) -> int:
    """The heuristic h: distance of a Gcell from the box around the goals."""
    distance = i64(0)
    for axis in range(AXES):
        at = w.position[cell, axis]
        distance += max(s.box[axis, 0] - at, 0) + max(at - s.box[axis, 1], 0)
    return distance


@compiled
def _has_room(w: Capacities, cell: int, move: int) -> bool:
    """Whether a move crosses a via, an edge that the net uses, or one with room for it."""
    edge = as_index(w.edge[cell, move])
    via = move >> 1 == VIA_AXIS
    room = w.remaining[edge] >= w.demand[as_index(w.position[cell, VIA_AXIS])]
    return via | room | (w.own[edge] == w.net[0])


# --- The search -----------------------------------------------------------------------------------


@compiled
def path_to_goals(w: Capacities, s: Search, source: int) -> int:
    """Finds a cheapest path to the nearest goal, in ``s.path``; returns its moves."""
    s.number[0] += 1
    s.head[:] = _EMPTY
    s.nodes[source].cost = 0
    cell, f, entries = source, _distance_left(w, s, source), i64(0)
    while not is_goal(s, cell):
        s.nodes[cell].stamp = -s.number[0]  # its cost is final
        so_far, left = s.nodes[cell].cost, _distance_left(w, s, cell)
        for move in range(MOVES):
            if not w.exits[cell] >> move & 1:
                continue
            ahead = as_index(w.neighbour[cell, move])
            node = s.nodes[ahead]
            cost = so_far + (STEP_COST if _has_room(w, cell, move) else FULL_COST)
            if node.stamp == -s.number[0] or (node.stamp == s.number[0] and node.cost <= cost):
                continue
            # By how much the heuristic changes; even moves go up their axis, odd ones down.
            at, low, high = w.position[cell, move >> 1], s.box[move >> 1, 0], s.box[move >> 1, 1]
            nearer = at > high if move & 1 else at < low
            farther = at <= low if move & 1 else at >= high
            f_ahead = cost + left + farther - nearer
            node.stamp = s.number[0]
            node.cost = cost
            node.came = move
            s.cell[entries] = ahead
            s.below[entries] = s.head[f_ahead & _RING]
            s.head[f_ahead & _RING] = entries
            entries += 1
        while True:  # the next Gcell from the open list that is not opened yet
            while s.head[f & _RING] == _EMPTY:
                f += 1
            entry = as_index(s.head[f & _RING])
            s.head[f & _RING] = s.below[entry]
            cell = as_index(s.cell[entry])
            if s.nodes[cell].stamp == s.number[0]:
                break
    length = 0
    while cell != source:
        came = s.nodes[cell].came
        s.path[length] = came
        length += 1
        cell = i64(w.neighbour[cell, came ^ 1])  # the opposite move
    for i in range(length // 2):
        s.path[i], s.path[length - 1 - i] = s.path[length - 1 - i], s.path[i]
    return length


# --- Sequential A* --------------------------------------------------------------------------------


@compiled
def _route(
    w: Capacities,
    s: Search,
    tasks: Any,
    first: Any,
    demand: Any,
    order: Any,
    to_tree: bool,
    turn: int,
    uses: Any,
    size: int,
) -> tuple[int, int]:
    """Routes nets one after another along cheapest paths, from place ``turn`` in the order on.

    It adds net · E + edge to ``uses`` for every edge that a net uses, and stops when there might
    not be room for another net. Returns the place to go on from, and how many uses there are.
    """
    edges = len(w.remaining)
    while turn < len(order) and size + edges <= len(uses):
        net = i64(order[turn])
        turn += 1
        w.net[0] = turn
        for layer in range(demand.shape[1]):
            w.demand[layer] = demand[net, layer]
        for task in range(first[net], first[net + 1]):
            start, target = i64(tasks[task, 0]), i64(tasks[task, 1])
            if task == first[net] or not to_tree:
                clear_goals(s)
            if to_tree:
                start, target = target, start
            add_goal(w, s, target)
            cell = start
            for i in range(path_to_goals(w, s, start)):
                move = i64(s.path[i])
                edge = i64(w.edge[cell, move])
                if w.own[edge] != turn:  # otherwise it is free
                    w.own[edge] = turn
                    if move >> 1 != VIA_AXIS:  # vias have no limit
                        w.remaining[edge] -= w.demand[as_index(w.position[cell, VIA_AXIS])]
                    uses[size] = net * edges + edge
                    size += 1
                if to_tree:
                    add_goal(w, s, cell)
                cell = i64(w.neighbour[cell, move])
    return turn, size


def _exits(problem: Problem) -> NDArray[np.uint8]:
    """(G,) uint8, a bit per move: it stays on the grid, and its edge is not closed."""
    grid = problem.topology
    if not problem.closed.any():
        return grid.exits
    closed = np.packbits(problem.closed[grid.edge], axis=1, bitorder="little")
    exits = grid.exits & ~closed.reshape(-1)
    exits.setflags(write=False)  # as the grid's, or numba would compile the search once more
    return exits


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
        net_order: which nets come first, see :class:`marouting.rules.Nets`; or (nets,) integers,
            smallest first.
        target: where a task's path ends: ``pin``, at the task's other pin (the paper); ``tree``, at
            the nearest Gcell of the net's route so far.
        decomposition: how nets are cut into tasks, see
            :func:`marouting.trees.decomposition.two_pin_tasks`.

    Returns:
        A solution in which every net is joined, with overflow where A* found no cheaper way. It
        has no wires on edges that are closed (:attr:`marouting.Problem.closed`).

    Raises:
        InputError: there is no such order, target or decomposition, or the grid takes too much
            memory.
    """
    check_problem(problem)
    check_choice("target", target, Target)
    check_choice("decomposition", decomposition, Decomposition)
    grid, nets = problem.topology, len(problem.nets)
    check_memory(grid.gcells * (TABLES + SEARCH), "A* on a grid of {}", grid)
    if not isinstance(net_order, str):
        if np.shape(net_order) != (nets,):
            found = np.shape(net_order)
            raise InputError(f"net_order: expected one number per net, found shape {found}")
        ranks = np.asarray(net_order)
    else:
        check_choice("net_order", net_order, NetOrder)
        ranks = net_ranks(problem, net_order)
    rows = two_pin_tasks(problem, decomposition)
    demand = problem.net_demand
    if demand[np.unique(rows[:, 0])].max(axis=1, initial=0).sum(dtype=np.int64) > UNLIMITED:
        raise InputError(f"problem: expected demands that add up to at most {UNLIMITED}")
    first = np.searchsorted(rows[:, 0], np.arange(nets + 1))
    way = Capacities(
        neighbour=grid.neighbour,
        edge=grid.edge,
        exits=_exits(problem),
        position=grid.position,
        remaining=problem.capacity.copy(),
        demand=np.empty(grid.shape[2], np.int32),
        own=np.zeros(grid.edges, np.int64),
        net=np.zeros(1, np.int64),
    )
    search, tasks = make_search(grid), np.ascontiguousarray(rows[:, 1:])
    order = np.argsort(ranks, kind="stable")
    uses, size, turn = np.empty(_EDGES_PER_TASK * len(rows) + grid.edges, np.int64), 0, 0
    while turn < nets:
        turn, size = _route(
            way, search, tasks, first, demand, order, target == "tree", turn, uses, size
        )
        if turn < nets:
            uses = np.concatenate((uses, np.empty_like(uses)))
    return Solution.of_uses(problem, *np.divmod(np.sort(uses[:size]), grid.edges))
