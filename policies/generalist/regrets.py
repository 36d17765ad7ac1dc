"""The regret of every move, from which imitation learns.

With all other nets in place, the rest of a net's routing is a small Steiner problem: connect the
agent and every other open pin to the net's tree. The **regret** of a move is the extra cost of the
cheapest routing that begins with it. An agent that only makes moves with regret 0 routes its net
optimally, given the other nets.

Costs: an edge that the net uses costs nothing. In a priced round any other costs what
:mod:`marouting.batch.prices` says; elsewhere 1, and 64 more without capacity for the net. The
demand of nets that are not yet routed can be given as **coming**, for instance from a solution.
Then capacity is kept for them: if all agents make moves with regret 0, the result is no worse than
that solution. In priced rounds no capacity is kept.

The costs are exact for nets with up to four open pins beside the agent's own (of larger nets the
four nearest count), inside the box around these pins and ``margin`` Gcells more. When a task
begins, a table is filled of the cheapest trees that join each set of open pins, with the net's tree
or without it, to each Gcell (Dreyfus and Wagner, "The Steiner problem in graphs", Networks 1,
1971); after that a move takes less than a microsecond.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.edges import demand_of, uses
from marouting.batch.engine import Engine
from marouting.batch.places import grid_of, position
from marouting.batch.prices import UNIT, edge_cost, is_priced
from marouting.batch.rules import free_moves
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import holds, next_nearest
from marouting.columns import check_rows
from marouting.config import check
from marouting.game import NOBODY
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import AXES, MOVES, VIA_AXIS
from marouting.problem.solution import Solution
from policies.generalist.outlook import widened

PINS = 4
"""The most open pins, beside the agent's own, that are looked at."""

MASKED = 2**28
"""The regret of a move that the mask leaves out."""

OVERFLOW = 64
"""What an edge without room costs more."""

_FAR = MASKED


class Lessons(NamedTuple):
    """What is known about the present tasks of M games, and working arrays.

    A set of open pins has a bit for each from the second on; the first bit is the net's tree.
    """

    coming: NDArray[np.int32]  # (M, E) demand of nets that have still to walk
    table: NDArray[np.int32]  # (M, 32, G) cost of the cheapest tree of a set and a Gcell
    attach: NDArray[np.int32]  # (M, 32) cost of the cheapest tree of a set and a Gcell of the walk
    pins: NDArray[np.int32]  # (M, 4) Gcells of the open pins
    many: NDArray[np.int32]  # (M,) how many they are
    low: NDArray[np.int32]  # (M, 2) the box that the table is of, in x and y
    high: NDArray[np.int32]  # (M, 2)
    cost: NDArray[np.int32]  # (G, 3) working: of the edges of a Gcell
    joined: NDArray[np.int32]  # (16,) working


class Regrets:
    """The regrets of the moves of agents in M games.

    The options ``target: tree`` and ``turn_order: sequential`` have to be on: others' tasks change
    while an agent walks, or end at a pin.

    Args:
        engine: the games.
        margin: Gcells around the open pins; more in priced rounds that gain nothing, as in
            :mod:`policies.generalist.outlook`.

    Attributes:
        lessons: what is known; it is to be saved and restored with the games.

    Raises:
        InputError: the games are of another kind.
    """

    def __init__(self, engine: Engine, margin: int = 3) -> None:
        check("env.target", engine.rules.target == "tree", "tree, to learn from regrets")
        check("env.turn_order", engine.static.sequential, "sequential, to learn from regrets")
        games, sets, cells = len(engine.games), 2 << PINS, engine.grid.gcells
        self._engine, self._margin = engine, margin
        self.lessons = Lessons(
            coming=np.zeros((games, engine.static.capacity.shape[1]), np.int32),
            table=np.zeros((games, sets, cells), np.int32),
            attach=np.zeros((games, sets), np.int32),
            pins=np.zeros((games, PINS), np.int32),
            many=np.zeros(games, np.int32),
            low=np.zeros((games, 2), np.int32),
            high=np.zeros((games, 2), np.int32),
            cost=np.zeros((cells, AXES), np.int32),
            joined=np.zeros(sets, np.int32),
        )

    def expect(self, m: int, agents: NDArray[np.integer], solution: Solution, sign: int) -> None:
        """Counts the routes of some agents' nets as coming (``sign`` 1), or no longer (−1)."""
        static, nets = self._engine.static, self._engine.nets[m]
        for n in agents.tolist():
            edges = np.asarray(solution.edges[nets[n]])
            edges = edges[edges % AXES != VIA_AXIS]
            layers = static.position[edges // AXES, VIA_AXIS]
            self.lessons.coming[m, edges] += sign * static.demand[m, n, layers]

    def write(
        self, problems: NDArray[np.integer], agents: NDArray[np.integer], out: NDArray[np.int32]
    ) -> None:
        """Writes the regrets of K agents' moves; to be called before every move of an agent.

        Args:
            problems: (K,) their problems.
            agents: (K,) their numbers, of each problem the one whose turn it is, or NOBODY.
            out: (K, 6) int32 filled, in parts of :data:`marouting.batch.prices.UNIT` of an edge: 0
                for the best moves; MASKED for those that the mask leaves out, and for all moves of
                NOBODY.

        Raises:
            ValueError: there are no such agents.
        """
        engine = self._engine
        check_rows(engine, problems, agents, out, MOVES)
        _write(engine.static, engine.dynamic, self.lessons, self._margin, problems, agents, out)


@compiled
def _edge_cost(
    static: Static, dynamic: Dynamic, lessons: Lessons, m: int, n: int, cell: int, axis: int
) -> int:
    """What the edge of a Gcell along an axis costs a net."""
    edge = as_index(AXES * cell + axis)
    if uses(dynamic.used, m, n, edge):
        return i64(0)
    if axis == VIA_AXIS:
        return i64(UNIT)
    demand = i64(demand_of(static, m, n, cell, 2 * axis))
    remaining = i64(dynamic.remaining[m, edge])
    if is_priced(static, dynamic, m):
        return edge_cost(static, dynamic, m, i64(edge), demand, remaining)
    if remaining - lessons.coming[m, edge] >= demand:
        return i64(UNIT)
    # What comes can still change; what is there cannot.
    if remaining < demand and not static.overflow_allowed:
        return i64(_FAR)
    return i64(UNIT * (1 + OVERFLOW))


@compiled
def _find_pins(static: Static, dynamic: Dynamic, lessons: Lessons, m: int, n: int) -> None:
    """Finds the nearest open pins beside the agent's own."""
    lessons.many[m] = 0
    task, far = next_nearest(static, dynamic, m, n, i64(-1), i64(NOBODY))
    while task != NOBODY and lessons.many[m] < PINS:
        lessons.pins[m, lessons.many[m]] = static.tasks[task, 1]
        lessons.many[m] += 1
        task, far = next_nearest(static, dynamic, m, n, far, task)


@compiled
def _begin(static: Static, dynamic: Dynamic, lessons: Lessons, m: int, n: int, margin: int) -> None:
    """Fills the table for a task that begins."""
    agent = dynamic.agents[m, n]
    columns, rows, layers = grid_of(static)
    _find_pins(static, dynamic, lessons, m, n)
    x0, y0, _ = position(static, as_index(agent.cell))
    x1, y1 = x0, y0
    for k in range(-1, lessons.many[m]):
        x, y, _ = position(static, as_index(agent.target if k < 0 else lessons.pins[m, k]))
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    x0, x1 = max(x0 - margin, 0), min(x1 + margin, columns - 1)
    y0, y1 = max(y0 - margin, 0), min(y1 + margin, rows - 1)
    lessons.low[m, 0], lessons.low[m, 1] = x0, y0
    lessons.high[m, 0], lessons.high[m, 1] = x1, y1
    for x in range(x0, x1 + 1):
        for y in range(y0, y1 + 1):
            for z in range(layers):
                cell = as_index((x * rows + y) * layers + z)
                for axis in range(AXES):
                    # An edge that leads out of the box is none.
                    inside = z < layers - 1
                    if axis < VIA_AXIS:
                        inside = x < x1 if axis == 0 else y < y1
                    lessons.cost[cell, axis] = _FAR
                    if inside:
                        cost = _edge_cost(static, dynamic, lessons, m, n, cell, i64(axis))
                        lessons.cost[cell, axis] = cost
    table, cost = lessons.table[m], lessons.cost
    for joined in range(1, i64(2) << i64(lessons.many[m])):
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(layers):
                    cell = as_index((x * rows + y) * layers + z)
                    least = i64(_FAR)
                    if joined == 1:
                        if holds(static, dynamic, m, Option.TREE, n, cell):
                            least = i64(0)
                    elif joined & (joined - 1) == 0:
                        pin = i64(0)
                        while joined >> pin != 2:
                            pin += 1
                        if lessons.pins[m, pin] == cell:
                            least = i64(0)
                    else:
                        part = (joined - 1) & joined
                        while part >= joined ^ part:
                            both = i64(table[part, cell]) + i64(table[joined ^ part, cell])
                            least = min(least, both)
                            part = (part - 1) & joined
                    table[joined, cell] = least
        # Sweeps to and fro until nothing gets cheaper: few are needed, most edges cost the same.
        changed = True
        while changed:
            changed = False
            for back in range(2):
                for i in range(x1 - x0 + 1):
                    x = x1 - i if back else x0 + i
                    for j in range(y1 - y0 + 1):
                        y = y1 - j if back else y0 + j
                        for k in range(layers):
                            z = layers - 1 - k if back else k
                            cell = as_index((x * rows + y) * layers + z)
                            now = i64(table[joined, cell])
                            # Written out: a loop over the axes takes twice as long.
                            least = now
                            if x < x1:
                                far = as_index(cell + rows * layers)
                                least = min(least, i64(table[joined, far]) + cost[cell, 0])
                            if x > x0:
                                far = as_index(cell - rows * layers)
                                least = min(least, i64(table[joined, far]) + cost[far, 0])
                            if y < y1:
                                far = as_index(cell + layers)
                                least = min(least, i64(table[joined, far]) + cost[cell, 1])
                            if y > y0:
                                far = as_index(cell - layers)
                                least = min(least, i64(table[joined, far]) + cost[far, 1])
                            if z < layers - 1:
                                far = as_index(cell + 1)
                                least = min(least, i64(table[joined, far]) + cost[cell, 2])
                            if z > 0:
                                far = as_index(cell - 1)
                                least = min(least, i64(table[joined, far]) + cost[far, 2])
                            if least < now:
                                table[joined, cell] = least
                                changed = True
    for joined in range(lessons.attach.shape[1]):
        lessons.attach[m, joined] = _FAR


@compiled
def _regret(static: Static, dynamic: Dynamic, lessons: Lessons, m: int, n: int, out: Any) -> None:
    """Fills ``out`` (6,) with the regrets of an agent's moves; see :meth:`Regrets.write`."""
    cell = as_index(dynamic.agents[m, n].cell)
    table, joined, attach = lessons.table[m], lessons.joined, lessons.attach[m]
    every = (i64(1) << i64(lessons.many[m])) - 1  # of the open pins, without the tree
    for pins in range(1, every + 1):
        attach[pins] = min(attach[pins], table[2 * pins, cell])
    free = free_moves(static, dynamic, m, n)
    least = i64(_FAR)
    for move in range(MOVES):
        out[move] = _FAR
        if not free >> move & 1:
            continue
        ahead = as_index(static.neighbour[cell, move])
        x, y, _ = position(static, ahead)
        inside = lessons.low[m, 0] <= x <= lessons.high[m, 0]
        if not (inside and lessons.low[m, 1] <= y <= lessons.high[m, 1]):
            out[move] = _FAR - 1
            continue
        # Some pins hang on the walk so far, this move included; the rest is joined along with the
        # tree by what is still to be walked.
        joined[0] = 0
        for pins in range(1, every + 1):
            joined[pins] = _FAR
            part = pins
            while part > 0:
                if part & pins & -pins:
                    hung = min(i64(attach[part]), i64(table[2 * part, ahead]))
                    joined[pins] = min(i64(joined[pins]), hung + i64(joined[pins ^ part]))
                part = (part - 1) & pins
        whole = i64(_FAR)
        for pins in range(every + 1):
            rest = i64(table[2 * pins + 1, ahead]) + i64(joined[every ^ pins])
            whole = min(whole, rest)
        lower = as_index(min(cell, ahead))
        cost = _edge_cost(static, dynamic, lessons, m, n, lower, i64(move // 2))
        out[move] = min(whole + cost, _FAR - 1)
        least = min(least, i64(out[move]))
    least = min(least, _FAR - 1)
    for move in range(MOVES):
        if out[move] < _FAR:
            out[move] -= least


@compiled
def _write(
    static: Static,
    dynamic: Dynamic,
    lessons: Lessons,
    margin: int,
    problems: Any,
    agents: Any,
    out: Any,
) -> None:
    """See :meth:`Regrets.write`."""
    for k in range(len(problems)):
        m, n = i64(problems[k]), i64(agents[k])
        if n == NOBODY:
            for move in range(MOVES):
                out[k, move] = _FAR
            continue
        m, n = as_index(m), as_index(n)
        if dynamic.agents[m, n].steps == 0:
            _begin(static, dynamic, lessons, m, n, widened(static, dynamic, m, i64(margin)))
        _regret(static, dynamic, lessons, m, n, out[k])
