"""The game of global routing: all of its rules, in one file, to be read from top to bottom.

Every net is an **agent**. Its pins are split into two-pin **tasks**; the agent walks from a task's
start to its target, one Gcell a move. The edges that it crosses become the net's route.

* A move **crosses** an edge that the net already uses, a via, or an edge whose remaining capacity
  covers the net's demand; with ``overflow="allowed"`` any edge. From then on the net uses the edge.
* Any other move is **blocked**: the agent stays where it is. Either way the step counts.
* A task ends **joined** when the agent reaches the target, or **failed** after ``max_steps`` steps.
  Then the next task begins at its own start. Either way the net keeps the edges that it used.
* An agent is **terminated** when all its tasks are joined, **truncated** when all have ended and
  some failed. The game is over when no agent is active.
* Nets move in **turn order**: one after the other to its end, or one move each in turn.

These are the paper's rules; the options of :mod:`marouting.rules` add to them. A step has three
parts, between which observations and rewards read the state: :meth:`Game.move` makes the move,
:meth:`Game.settle` begins the next task, and :meth:`Game.pass_turn` selects the next agent::

    game = Game(problem, Rules(turn_order="round_robin"))
    while game.active:
        game.step(some_action)
    print(game.metrics())

To change a rule, override the method that it is in. :mod:`marouting.batch` plays the same game for
many problems at once, compiled; ``tests/test_game.py`` checks that both give the same results.
"""

import copy
import functools
from array import array
from collections import Counter
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.problem.grid import AXES, MOVES, OFF_GRID, VIA_AXIS, Grid
from marouting.problem.problem import UNLIMITED, Problem
from marouting.problem.solution import Solution
from marouting.rules import RipUp, Rules, net_ranks
from marouting.trees.decomposition import two_pin_tasks

RIP_UP = MOVES
"""Action 6, with ``rip_up.choose: agents``: the agent rips up its net and reroutes it."""

NOBODY = NO_TASK = -1
"""No agent, such as after the end of the game, and no task."""


class Status(IntEnum):
    """The status of an agent."""

    ACTIVE = 0  #: still has a task to route
    TERMINATED = 1  #: all tasks joined
    TRUNCATED = 2  #: all tasks ended, at least one of them failed
    ABSENT = 3  #: no net: padding in a batch whose problems have different numbers of nets
    WAITING = 4  #: all tasks ended, but the net may still be ripped up and rerouted


class Crossing(IntEnum):
    """What an agent's last move did."""

    NONE = 0  #: the agent did not move
    BLOCKED = 1  #: too little capacity, or off the grid: the agent stayed
    NEW = 2  #: crossed an edge that the net now uses
    OWN = 3  #: crossed an edge that the net already used
    ANSWERED = 4  #: the agent was asked whether to rip up its net, and answered


class Ending(IntEnum):
    """What an agent's last move did to its task."""

    NONE = 0  #: the task goes on
    JOINED = 1  #: the target is reached
    FAILED = 2  #: the steps are used up


# Plain integers: looking up the member of an enumeration takes as long as the rest of a rule.
ACTIVE, WAITING = Status.ACTIVE.value, Status.WAITING.value
BLOCKED, NEW, OWN = Crossing.BLOCKED.value, Crossing.NEW.value, Crossing.OWN.value
ANSWERED = Crossing.ANSWERED.value
GOES_ON, JOINED, FAILED = Ending.NONE.value, Ending.JOINED.value, Ending.FAILED.value


class Game:
    """One problem, played by the rules; None stands for the paper's.

    The state of agent n is element n of the **columns**. They are arrays of the standard library,
    which Python reads as fast as lists and NumPy without a copy.

    Attributes:
        nets: the net of every agent, by its number in the problem. Nets with all pins in one Gcell
            have nothing to route and are no agents.
        tasks: the (start, target) Gcells of every agent's tasks.
        order: the agents in turn order.
        active: the agents that still have a task to route, in turn order.
        remaining: (E,) what is left of every edge's capacity; negative where it overflows.
        used: the edges that every net uses: its route.
        cell, target, task, steps: columns: where the agent is, the Gcell that it walks to, which
            of its tasks that is, and the steps made in it.
        joined, status: columns: how many of the agent's tasks are joined; its :class:`Status`.
        crossing, ending, added_overflow: columns: what the agent's last move did.
        message: column: what the agent wrote with its last move, with ``message_bits``.
        joined_tasks, overflow, wirelength, moves: figures of the whole problem.
        round: of rip-up and reroute, from 1; 0 while nets are routed for the first time.
        asked: whether the agent to move decides about rip-up: action 6 rips up its net.

    Raises:
        InputError: the problem has nothing to route, or demands do not fit into 32 bits.
    """

    COLUMNS = (
        "cell", "target", "task", "steps", "joined",
        "status", "crossing", "ending", "added_overflow", "message",
    )  # fmt: skip

    def __init__(self, problem: Problem, rules: Rules | None = None) -> None:
        self.problem, self.rules = problem, rules or Rules()
        self.grid, self.layers = Grid.of(problem.grid), problem.grid[2]
        tasks: dict[int, list[tuple[int, int]]] = {}
        for net, start, target in two_pin_tasks(problem, self.rules.nets.decomposition).tolist():
            tasks.setdefault(net, []).append((start, target))
        self.nets, self.tasks = list(tasks), list(tasks.values())
        if not self.nets:
            raise InputError("problem: expected a net with pins in two Gcells or more")
        self.overflow_allowed = self.rules.overflow == "allowed"
        self.demand: list[list[int]] = problem.net_demand[self.nets].tolist()  # by layer
        # The capacity that a net needs to cross an edge, by layer; vias always have enough.
        anything = [-UNLIMITED - 1] * self.layers
        self.needed = [anything if self.overflow_allowed else own for own in self.demand]
        if self.overflow_allowed and sum(map(max, self.demand)) > UNLIMITED:
            raise InputError(f"problem: expected demands that add up to at most {UNLIMITED}")
        self.capacity = array("i", problem.capacity.tobytes())
        self.remaining = array("i", self.capacity)
        self.low, self.high = (end[self.nets, :2] for end in problem.pin_boxes())  # column, row
        ranks = net_ranks(problem, self.rules.nets.order)[self.nets]
        self.order: list[int] = np.argsort(ranks, kind="stable").tolist()
        self.max_steps = self.rules.steps_per_task(problem.grid)
        self.sequential = self.rules.turn_order != "round_robin"
        self.rip_up = self.rules.rip_up or RipUp(rounds=0)
        self.to_tree = self.rules.target == "tree"
        self.keeps_tree = self.to_tree or self.rules.next_pin == "nearest"
        self.waits = self.rules.wait << self.rules.moves - 1  # the bit of the move that stays
        columns = [array("i", bytes(4 * len(self.nets))) for _ in self.COLUMNS]
        self.cell, self.target, self.task, self.steps, self.joined = columns[:5]
        self.status, self.crossing, self.ending, self.added_overflow, self.message = columns[5:]
        self.reset()

    def reset(self) -> None:
        """Begins an episode: all capacity is free, every agent is at the start of a task."""
        self.remaining[:] = self.capacity
        for name in self.COLUMNS:
            getattr(self, name)[:] = array("i", bytes(4 * len(self.nets)))
        self.used: list[set[int]] = [set() for _ in self.nets]
        self.tree: list[set[int]] = [set() for _ in self.nets]  # see "Tasks"
        self.begun: list[set[int]] = [set() for _ in self.nets]  # tasks begun
        self.visited: list[set[int]] = [set() for _ in self.nets]  # Gcells, in the present task
        self.taken: list[set[int]] = [set() for _ in self.nets]  # edges to release if it fails
        self.joined_tasks = self.overflow = self.wirelength = self.moves = 0
        self.active, self._at = list(self.order), 0  # whose turn it is: active[_at]
        self.queue: list[int] = []  # nets that may still be ripped up in this round, last one first
        self.ripped: dict[int, tuple[set[int], int]] = {}  # nets rerouted now: what each had before
        self.round, self.asked, self.reroutes = 0, False, 0  # reroutes: in the present round
        self.history: Counter[int] = Counter()  # in how many rounds an edge was full at the start
        for n in self.order:
            self._begin_net(n)

    # --- A step -----------------------------------------------------------------------------------

    @property
    def turn(self) -> int:
        """The agent whose turn it is, or NOBODY."""
        return self.active[self._at] if self.active else NOBODY

    def step(self, action: int) -> None:
        """The agent whose turn it is moves."""
        n = self.turn
        self.move(n, action)
        self.settle(n)
        self.pass_turn(n)

    def movers(self) -> list[int]:
        """Who moves in a step of all agents: those that are active, or only the one to move."""
        alone = self.sequential or self.asked
        return [self.turn] if alone and self.active else list(self.active)

    def move(self, n: int, action: int) -> None:
        """An active agent crosses an edge, is blocked or waits, and its task may end."""
        self.moves += 1
        if self.rules.message_bits:
            self.message[n], action = divmod(action, self.rules.moves)
        self.added_overflow[n], self.ending[n] = 0, GOES_ON
        if self.asked:
            self._answer(n, rip_up=action == RIP_UP)
            return
        cell = self.cell[n]
        # Waiting counts as a blocked move. So does RIP_UP, because the agent is not asked here.
        edge, ahead = (0, OFF_GRID) if action >= MOVES else self.grid.ways[cell][action]
        if ahead == OFF_GRID:
            self.crossing[n] = BLOCKED
        elif edge in self.used[n]:
            self.crossing[n], self.cell[n] = OWN, ahead
        elif self.remaining[edge] >= self.needed[n][cell % self.layers]:
            self.crossing[n], self.cell[n] = NEW, ahead
            self.used[n].add(edge)
            self.wirelength += 1
            self.added_overflow[n] = self._take(n, edge)
            if self.rules.release_failed:
                self.taken[n].add(edge)
        else:
            self.crossing[n] = BLOCKED
        cell = self.cell[n]
        self.steps[n] += 1
        if self.rules.mask.visited:
            self.visited[n].add(cell)
        if cell in self.tree[n] if self.to_tree else cell == self.target[n]:
            self._end_task(n, JOINED)
        elif self.steps[n] >= self.max_steps:
            self._end_task(n, FAILED)

    def settle(self, n: int) -> None:
        """After its move: an agent whose task has ended begins its next one, or is done."""
        if not self.ending[n] or self.status[n] != ACTIVE:
            return
        # After the first routing nets only move to be rerouted, and until that is judged.
        task = NO_TASK if self.round and not self.ripped else self._next_task(n)
        if task != NO_TASK:
            self._begin_task(n, task)
        else:
            self.status[n] = WAITING if self.rip_up.rounds else self._final_status(n)

    def pass_turn(self, n: int) -> None:
        """Passes the turn from agent n to the next one; in sequential order only when n is done."""
        if self.status[n] != ACTIVE:
            del self.active[self._at]  # now the next one is in its place
        elif not self.sequential and self.crossing[n] != ANSWERED:  # see _rip_up
            self._at += 1
        if self._at >= len(self.active):
            self._at = 0
        if not self.active:
            self._rip_up_next()

    def pass_turns(self) -> None:
        """:meth:`pass_turn` after a step of all agents."""
        if self.sequential:
            self.pass_turn(self.turn)
            return
        self.active, self._at = [n for n in self.active if self.status[n] == ACTIVE], 0
        if not self.active:
            self._rip_up_next()

    def free_moves(self, n: int) -> int:
        """The moves of an agent that are not blocked, one bit each; see :func:`mask_table`."""
        if self.asked and n == self.turn:
            return 1 | 1 << RIP_UP  # any of the six moves keeps the route: one is enough
        cell, used, remaining = self.cell[n], self.used[n], self.remaining
        exits, needed, free = self.grid.exits_of[cell], self.needed[n][cell % self.layers], 0
        for bit, edge, _ in exits:
            if edge in used or remaining[edge] >= needed:  # as in move
                free |= bit
        if self.rules.mask.visited:
            new = sum(bit for bit, _, ahead in exits if ahead not in self.visited[n])
            free = free & new or free
        return free | self.waits

    # --- Edges ------------------------------------------------------------------------------------

    def _take(self, n: int, edge: int, sign: int = 1) -> int:
        """A net takes its demand of an edge (−1: releases it); returns the overflow this adds."""
        if edge % AXES == VIA_AXIS:  # vias have no limit
            return 0
        demand, left = sign * self.demand[n][edge // AXES % self.layers], self.remaining[edge]
        added = max(demand - left, 0) - max(-left, 0)
        self.remaining[edge] = left - demand
        self.overflow += added
        return added

    def _set_route(self, n: int, edges: set[int]) -> None:
        """Makes a net use just these edges: it releases the others, and takes what is new."""
        for edge in self.used[n] - edges:
            self._take(n, edge, -1)
        for edge in edges - self.used[n]:
            self._take(n, edge)
        self.wirelength += len(edges) - len(self.used[n])
        self.used[n] = edges

    def is_full(self, edge: int) -> bool:
        """Whether an edge has capacity, and all of it is taken."""
        return self.remaining[edge] <= 0 < self.capacity[edge]

    # --- Tasks ------------------------------------------------------------------------------------
    # By the paper's rules tasks are begun in the order of the decomposition, each at its own start.
    # Two options use the net's **tree**: all Gcells that its edges join to its first pin. The tree
    # grows when a task ends; then all tasks whose pins are in it are joined, and those not begun
    # yet are skipped. With ``target="tree"`` agents walk from the new pin; what they see as their
    # target is the Gcell of the tree that was nearest at the beginning. With ``next_pin="nearest"``
    # and ``target="pin"`` they start at the Gcell nearest to the pin. Ties go to the task listed
    # first, and to the Gcell with the lowest number.

    def _begin_net(self, n: int) -> None:
        """An agent whose net uses no edge begins its first task."""
        self._add_joined(n, -self.joined[n])
        self.status[n], self.task[n], self.begun[n] = ACTIVE, NO_TASK, set()
        self._grow_tree(n)
        self._begin_task(n, self._next_task(n))

    def _begin_task(self, n: int, task: int) -> None:
        """Puts an agent at the beginning of a task."""
        start, target = self.tasks[n][task]
        if self.keeps_tree:
            _, start = self._nearest_in_tree(n, target)
            if self.to_tree:
                start, target = target, start
        self.task[n], self.steps[n], self.cell[n], self.target[n] = task, 0, start, target
        # New sets: the Parallel environment keeps those of the task that has ended.
        self.begun[n] = self.begun[n] | {task}
        self.visited[n], self.taken[n] = {start}, set()

    def _next_task(self, n: int) -> int:
        """The task that an agent begins after its present one, or NO_TASK."""
        tasks, tree = self.tasks[n], self.tree[n]
        if self.rules.next_pin == "listed":
            later = (t for t in range(self.task[n] + 1, len(tasks)) if tasks[t][1] not in tree)
            return next(later, NO_TASK)
        later = (t for t in range(len(tasks)) if t not in self.begun[n] and tasks[t][1] not in tree)
        return min(later, key=lambda t: self._nearest_in_tree(n, tasks[t][1])[0], default=NO_TASK)

    def _end_task(self, n: int, ending: int) -> None:
        """A task is joined or has failed."""
        self.ending[n] = ending
        if ending == JOINED:
            self._add_joined(n, 1)
        elif self.rules.release_failed:
            self._set_route(n, self.used[n] - self.taken[n])
        self._grow_tree(n)
        # Judged within the last move, so that this move is paid for the outcome.
        if self.ripped and all(map(self._is_rerouted, self.ripped)):
            self._judge()

    def _grow_tree(self, n: int) -> None:
        """Finds the Gcells that a net's edges join to its first pin, and the tasks now joined."""
        if not self.keeps_tree:
            return
        first_pin, used, exits_of = self.tasks[n][0][0], self.used[n], self.grid.exits_of
        tree, found = {first_pin}, [first_pin]
        for cell in found:  # a list that grows during the loop
            for _, edge, ahead in exits_of[cell]:
                if edge in used and ahead not in tree:
                    tree.add(ahead)
                    found.append(ahead)
        self.tree[n] = tree
        self._add_joined(n, sum(pin in tree for _, pin in self.tasks[n]) - self.joined[n])

    def _nearest_in_tree(self, n: int, pin: int) -> tuple[int, int]:
        """The distance of a pin from its net's tree, and the Gcell of the tree nearest to it."""
        return min((self.grid.distance(cell, pin), cell) for cell in self.tree[n])

    def _add_joined(self, n: int, tasks: int) -> None:
        self.joined[n] += tasks
        self.joined_tasks += tasks

    def open_tasks(self, n: int) -> int:
        """How many of an agent's tasks are not joined."""
        return len(self.tasks[n]) - self.joined[n]

    def _final_status(self, n: int) -> int:
        """The status of an agent that has no more tasks."""
        return Status.TRUNCATED.value if self.open_tasks(n) else Status.TERMINATED.value

    # --- Rip-up and reroute -----------------------------------------------------------------------
    # Rounds follow after all nets have routed. In a round the nets that ``choose`` selects are
    # ripped up one after the other, each together with up to ``neighbours`` nets that stand in its
    # way, and rerouted around all the others. When their last tasks have ended, the result is
    # judged: if the problem now has fewer tasks joined, more overflow or more wirelength (in this
    # order), these nets get their old routes back. A round that rips up no net is the last one.

    def _rip_up_next(self) -> None:
        """When no agent is active: the next net is ripped up or asked, or the game is over."""
        while self.queue or self._begin_round():
            n = self.queue.pop()
            if self.rules.asks:
                self._ask(n)
                return
            if self._is_chosen(n):
                self._rip_up(n)
                return
        for n in self.order:
            if self.status[n] == WAITING:
                self.status[n] = self._final_status(n)

    def _begin_round(self) -> bool:
        """Lines up the nets for the next round; returns whether there is one."""
        if self.round == self.rip_up.rounds or (self.round and not self.reroutes):
            return False
        self.round, self.reroutes = self.round + 1, 0
        self.history.update(np.flatnonzero(self._full_edges()).tolist())
        self.queue = list(self.order)
        if self.rip_up.choose == "history":
            self.queue.sort(key=self._conflicts, reverse=True)  # equal ones stay in turn order
        self.queue.reverse()
        return True

    def _conflicts(self, n: int) -> tuple[int, int]:
        """A net's open tasks, then the rounds in which its edges were full, summed over edges."""
        return self.open_tasks(n), sum(self.history[edge] for edge in self.used[n])

    def _is_chosen(self, n: int) -> bool:
        """Whether a net is ripped up now that it is its turn in a round."""
        if self.rip_up.choose == "conflicts":
            return self.open_tasks(n) > 0 or any(map(self.is_full, self.used[n]))
        return self.rip_up.choose == "all" or any(self._conflicts(n))

    def _ask(self, n: int) -> None:
        """Asks an agent: RIP_UP, or any move to keep the route? It stands at its first pin."""
        self.asked, self.active, self._at = True, [n], 0
        self.status[n], self.task[n], self.steps[n] = ACTIVE, 0, 0
        self.cell[n], self.target[n] = self.tasks[n][0]

    def _answer(self, n: int, *, rip_up: bool) -> None:
        """The agent that was asked answers, which counts as a step."""
        self.asked = False
        if rip_up:
            self._rip_up(n)
        self.crossing[n] = ANSWERED
        self.ending[n] = GOES_ON if rip_up else JOINED  # so that it settles: its tasks are over

    def _rip_up(self, n: int) -> None:
        """Rips up a net and those that stand in its way; all begin their first tasks again."""
        self.score_before = self._score()
        self.reroutes += 1
        members = sorted((n, *self._in_the_way(n)), key=self.order.index)
        self.ripped = {o: (self.used[o], self.joined[o]) for o in members}
        for o in members:
            self._set_route(o, set())
            self.crossing[o], self.ending[o], self.added_overflow[o] = 0, GOES_ON, 0
            self._begin_net(o)
        # In sequential order the net itself is rerouted first, and the others after it; otherwise
        # all move in turn order, from the first one on. So after an answer the turn stays.
        self.active, self._at = members, members.index(n) if self.sequential else 0

    def _in_the_way(self, n: int) -> list[int]:
        """The nets that block a net most, at most ``neighbours``.

        They are ranked by the number of full edges that they use among the net's own and those
        around its pins, times a random number, so that the choice varies from round to round.
        """
        edges = set(filter(self.is_full, self.used[n])) | self._full_around(n)
        others = [o for o, used in enumerate(self.used) if o != n and not edges.isdisjoint(used)]
        weight = {o: len(edges & self.used[o]) * lot(self.round, n, o) for o in others}
        return sorted(others, key=lambda o: (-weight[o], o))[: self.rip_up.neighbours]

    def _is_rerouted(self, n: int) -> bool:
        """Whether an agent has ended its last task, settled or not."""
        ended = self.ending[n] and self.steps[n]  # or else its next task has begun already
        return self.status[n] != ACTIVE or (bool(ended) and self._next_task(n) == NO_TASK)

    def _judge(self) -> None:
        """Nets that have been rerouted get their old routes back if the problem is worse now."""
        ripped, self.ripped = self.ripped, {}
        if self._score() > self.score_before:
            for n, (route, joined) in ripped.items():
                self._set_route(n, route)
                self._add_joined(n, joined - self.joined[n])
                self._grow_tree(n)

    def _score(self) -> tuple[int, int, int]:
        """The objective, to be minimised: open tasks, then overflow, then wirelength."""
        return -self.joined_tasks, self.overflow, self.wirelength

    def _full_edges(self) -> NDArray[np.bool_]:
        """(X, Y, 3 Z) :meth:`is_full` of all edges."""
        remaining, capacity = (np.frombuffer(a, np.int32) for a in (self.remaining, self.capacity))
        return ((remaining <= 0) & (capacity > 0)).reshape(*self.grid.shape[:2], -1)

    def _full_around(self, n: int) -> set[int]:
        """The full edges in the box around a net's pins, and one Gcell beyond if a task is open."""
        beyond = 1 if self.open_tasks(n) else 0
        left, low = np.maximum(self.low[n] - beyond, 0)
        right, high = self.high[n] + beyond
        box = np.zeros((*self.grid.shape[:2], 1), np.bool_)
        box[left : right + 1, low : high + 1] = True
        return set(np.flatnonzero(self._full_edges() & box).tolist())

    # --- Results ----------------------------------------------------------------------------------

    def metrics(self) -> dict[str, int]:
        """The figures at this moment; they do not depend on the reward."""
        return {
            "overflow": self.overflow,
            "wirelength": self.wirelength,
            "joined": self.joined_tasks,
            "tasks": sum(map(len, self.tasks)),
            "steps": self.moves,
        }

    def solution(self) -> Solution:
        """The routes at this moment."""
        routes = [np.zeros(0, np.int64) for _ in self.problem.nets]
        for net, used in zip(self.nets, self.used, strict=True):
            routes[net] = np.array(sorted(used), np.int64)
        return Solution(self.problem, routes)

    def copy(self) -> "Game":
        """An independent copy of the game in its present state; constant parts are shared.

        A subclass with a state of its own extends this.
        """
        twin = copy.copy(self)
        for name in ("remaining", *self.COLUMNS, "active", "queue", "ripped", "history"):
            setattr(twin, name, copy.copy(getattr(self, name)))
        for name in ("used", "tree", "begun", "visited", "taken"):
            setattr(twin, name, [set(one) for one in getattr(self, name)])
        return twin


@functools.cache
def mask_table(moves: int, messages: int = 1) -> NDArray[np.int8]:
    """(2^moves, A) int8, the action mask of every set of :meth:`Game.free_moves`.

    Without a free move the six that cross edges are 1, so a mask is never all zero. Every message
    goes with every move.
    """
    free = np.arange(1 << moves)
    free[0] = (1 << MOVES) - 1
    return np.tile((free[:, None] >> np.arange(moves) & 1).astype(np.int8), messages)


def lot(number: int, n: int, other: int) -> int:
    """A pseudo-random number from 1 to 1024 that depends only on a round and two agents."""
    mixed = (number * 0x9E3779B1 ^ n * 0x85EBCA6B ^ other * 0xC2B2AE35) & 0xFFFFFFFF
    for _ in range(2):
        mixed = (mixed ^ mixed >> 16) * 0x45D9F3B & 0xFFFFFFFF
    return 1 + (mixed >> 22)
