"""The rules of the game once more, from the design and not from the engine: slow, plain, obvious.

Gcells are (x, y, z) tuples with z from 0, an edge is the pair of its Gcells, the nets that use an
edge are a set. Also here: a strategy for problems on which nets get in each other's way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import networkx as nx
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from marouting import Adjustment, Engine, Evaluation, Net, Pin, Problem, Solution
from marouting.batch.prices import Negotiation
from marouting.trees.decomposition import two_pin_tasks
from marouting.trees.steiner import steiner_tasks

Gcell = tuple[int, int, int]
Edge = tuple[Gcell, Gcell]

STEPS = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def gcell_of(problem: Problem, number: int) -> Gcell:
    """(x, y, z) of a Gcell's number."""
    _, rows, layers = problem.grid
    return number // layers // rows, number // layers % rows, number % layers


def edge_number(problem: Problem, edge: Edge) -> int:
    """The number of an edge."""
    (x, y, z), far = edge
    axis = [far[i] - edge[0][i] for i in range(3)].index(1)
    return 3 * ((x * problem.grid[1] + y) * problem.grid[2] + z) + axis


def pin_gcells(problem: Problem, net: int) -> list[Gcell]:
    """The Gcells of a net's pins, each once, in pin order."""
    (left, low), (width, height) = problem.origin, problem.tile
    cells = [
        ((pin.x - left) // width, (pin.y - low) // height, pin.layer - 1)
        for pin in problem.nets[net].pins
    ]
    return list(dict.fromkeys(cells))


def lot(number: int, n: int, other: int) -> int:
    """The lot of two agents in a round, from 1 to 1024."""
    mixed = (number * 0x9E3779B1 ^ n * 0x85EBCA6B ^ other * 0xC2B2AE35) % 2**32
    for _ in range(2):
        mixed = (mixed ^ mixed >> 16) * 0x45D9F3B % 2**32
    return 1 + mixed // 2**22


def distance(a: Gcell, b: Gcell) -> int:
    """Manhattan distance over x, y and layer."""
    return sum(abs(i - j) for i, j in zip(a, b, strict=True))


def between(a: Gcell, b: Gcell) -> Edge:
    """The edge that joins two neighbouring Gcells."""
    return (a, b) if a < b else (b, a)


def is_via(edge: Edge) -> bool:
    """Whether an edge joins two layers."""
    return edge[0][2] != edge[1][2]


def all_edges(problem: Problem) -> list[Edge]:
    """Every edge of the grid."""
    columns, rows, layers = problem.grid
    return [
        (cell, (cell[0] + dx, cell[1] + dy, cell[2] + dz))
        for cell in np.ndindex(columns, rows, layers)
        for dx, dy, dz in STEPS[::2]
        if cell[0] + dx < columns and cell[1] + dy < rows and cell[2] + dz < layers
    ]


def capacity_of(problem: Problem, edge: Edge) -> int | None:
    """The capacity of an edge; None for a via, which has no end."""
    if is_via(edge):
        return None
    for x1, y1, layer1, x2, y2, layer2, capacity in reversed(problem.adjustments):
        if between((x1, y1, layer1 - 1), (x2, y2, layer2 - 1)) == edge:
            return capacity
    along_x = edge[0][0] != edge[1][0]
    return (problem.horizontal_capacity if along_x else problem.vertical_capacity)[edge[0][2]]


def steiner_length(problem: Problem) -> NDArray[np.int64]:
    """(nets,) int64, the length of each net's Steiner tree in edges; 0 within one Gcell."""
    net, start, target = steiner_tasks(*problem.flat_pin_gcells, problem.grid).T
    position = problem.topology.position
    length = np.zeros(len(problem.nets), np.int64)
    np.add.at(length, net, np.abs(position[start] - position[target]).sum(axis=1))
    return length


def own_width(net: Net, layer: int) -> int:
    """The minimum width of a net's wires in a layer, from 0."""
    return net.min_width[layer] if isinstance(net.min_width, tuple) else net.min_width


def plain_evaluation(solution: Solution) -> Evaluation:
    """The figures of a solution, from its edges as pairs of Gcells."""
    problem = solution.problem
    taken: dict[Edge, int] = {}
    open_nets, joined, tasks, lengths, vias = [], 0, 0, 0, 0
    for index, (net, numbers) in enumerate(zip(problem.nets, solution.edges, strict=True)):
        graph: nx.Graph[Gcell] = nx.Graph()
        pins = pin_gcells(problem, index)
        graph.add_nodes_from(pins)
        for number in numbers.tolist():
            near = gcell_of(problem, number // 3)
            far = tuple(a + d for a, d in zip(near, STEPS[2 * (number % 3)], strict=True))
            edge: Edge = (near, far)  # type: ignore[assignment]
            graph.add_edge(*edge)
            vias += is_via(edge)
            if not is_via(edge):
                width = max(own_width(net, near[2]), problem.min_width[near[2]])
                taken[edge] = taken.get(edge, 0) + width + problem.min_spacing[near[2]]
        lengths += len(numbers)
        pieces = sum(not set(pins).isdisjoint(part) for part in nx.connected_components(graph))
        tasks += len(pins) - 1
        joined += len(pins) - pieces
        if pieces > 1:
            open_nets.append(net.name)
    over = [max(0, tracks - (capacity_of(problem, edge) or 0)) for edge, tracks in taken.items()]
    return Evaluation(
        overflow=sum(over),
        max_overflow=max(over, default=0),
        wirelength=lengths,
        vias=vias,
        connected=not open_nets,
        joined=joined,
        tasks=tasks,
        disconnected=tuple(open_nets),
    )


@dataclass
class Agent:
    """A net on its way."""

    net: int
    tasks: list[tuple[Gcell, Gcell]]
    at: Gcell
    task: int = 0
    steps: int = 0
    joined: int = 0
    status: str = "ACTIVE"
    crossing: str = "NONE"
    ending: str = "NONE"
    added_overflow: int = 0
    target: Gcell = (0, 0, 0)
    begun: set[int] = field(default_factory=set)
    visited: set[Gcell] = field(default_factory=set)
    taken: set[Edge] = field(default_factory=set)


@dataclass
class Game:
    """One problem, played by the rules."""

    problem: Problem
    turn_order: str = "sequential"
    max_steps: int = 50
    overflow: str = "forbidden"
    target: str = "pin"
    next_pin: str = "listed"
    release_failed: bool = False
    nets: dict[str, Any] = field(default_factory=dict)
    mask: dict[str, Any] = field(default_factory=dict)
    rip_up: dict[str, Any] | None = None
    negotiation: Negotiation = field(default_factory=lambda: Negotiation(prices=False))
    agents: list[Agent] = field(init=False)
    rounds: int = field(init=False)
    choose: str = field(init=False)
    neighbours: int = field(init=False)
    order: list[int] = field(init=False)
    users: dict[Edge, set[int]] = field(init=False)
    capacity: dict[Edge, int | None] = field(init=False)
    turn: int | None = field(init=False)
    steps: int = field(init=False, default=0)
    round: int = field(init=False, default=0)
    line: list[int] = field(init=False, default_factory=list)
    picked: int = field(init=False, default=0)
    history: dict[Edge, int] = field(init=False, default_factory=dict)
    again: dict[int, tuple[set[Edge], int]] = field(init=False, default_factory=dict)
    before: tuple[int, int, int] = field(init=False, default=(0, 0, 0))
    before_cost: int = field(init=False, default=0)
    asked: bool = field(init=False, default=False)
    prices: dict[Edge, int] = field(init=False, default_factory=dict)
    present: int = field(init=False)
    plain: int = field(init=False, default=0)
    stuck: int = field(init=False, default=0)
    negotiations: int = field(init=False, default=0)
    fewest: float = field(init=False, default=float("inf"))
    began: tuple[int, int, int] = field(init=False, default=(0, 0, 0))
    best: tuple[tuple[int, int, int], list[tuple[set[Edge], int]]] | None = field(
        init=False, default=None
    )

    def __post_init__(self) -> None:
        problem, rip_up = self.problem, {"rounds": 0, "choose": "all", **(self.rip_up or {})}
        self.rounds, self.choose = rip_up["rounds"], rip_up["choose"]
        self.neighbours = rip_up.get("neighbours", 0)
        tasks: dict[int, list[tuple[Gcell, Gcell]]] = {}
        decomposition: Any = self.nets.get("decomposition", "mst")
        for net, start, target in two_pin_tasks(problem, decomposition).tolist():
            ends = gcell_of(problem, start), gcell_of(problem, target)
            tasks.setdefault(net, []).append(ends)
        self.agents = [Agent(net, tasks[net], tasks[net][0][0]) for net in sorted(tasks)]
        self.order = list(range(len(self.agents)))
        order = self.nets.get("order", "half_perimeter")
        if order != "file":
            up = order == "half_perimeter_up"
            self.order.sort(key=lambda n: self.half_perimeter(n) * (1 if up else -1))
        self.capacity = {edge: capacity_of(problem, edge) for edge in all_edges(problem)}
        self.users = {edge: set() for edge in self.capacity}
        self.turn = self.order[0]
        for n in range(len(self.agents)):
            self.begin_net(n)
        self.present = self.first_present()

    # --- tasks by the options ----------------------------------------------------------------

    def keeps_tree(self) -> bool:
        """Whether the options know the net's tree."""
        return self.target == "tree" or self.next_pin == "nearest"

    def tree(self, n: int) -> set[Gcell]:
        """The Gcells that an agent's edges join to its first pin."""
        graph: nx.Graph[Gcell] = nx.Graph(list(self.edges_of(n)))
        root = self.agents[n].tasks[0][0]
        graph.add_node(root)
        return set(nx.node_connected_component(graph, root))

    def begin_net(self, n: int) -> None:
        """The agent's first task."""
        agent = self.agents[n]
        agent.begun, agent.joined, agent.task, agent.status = set(), 0, -1, "ACTIVE"
        following = self.following(n)
        assert following is not None
        self.begin(n, following)

    def following(self, n: int) -> int | None:
        """The task after an agent's present one."""
        agent = self.agents[n]
        if not self.keeps_tree():
            return agent.task + 1 if agent.task + 1 < len(agent.tasks) else None
        tree = self.tree(n)
        rest = [t for t, (_, pin) in enumerate(agent.tasks) if pin not in tree]
        if self.next_pin == "listed":
            return next((t for t in rest if t > agent.task), None)
        rest = [t for t in rest if t not in agent.begun]
        near = {t: min(distance(cell, agent.tasks[t][1]) for cell in tree) for t in rest}
        return min(rest, key=lambda t: (near[t], t), default=None)

    def begin(self, n: int, task: int) -> None:
        """The agent stands at the beginning of a task."""
        agent = self.agents[n]
        agent.task, agent.steps = task, 0
        agent.begun.add(task)
        agent.at, agent.target = agent.tasks[task]
        if self.keeps_tree():
            pin = agent.tasks[task][1]
            near = min(self.tree(n), key=lambda cell: (distance(cell, pin), cell))
            agent.at, agent.target = (pin, near) if self.target == "tree" else (near, pin)
        agent.visited, agent.taken = {agent.at}, set()

    # --- rip-up rounds -----------------------------------------------------------------------

    def full(self, edge: Edge) -> bool:
        """Whether all capacity of an edge is taken."""
        remaining = self.remaining(edge)
        return remaining is not None and remaining <= 0 < (self.capacity[edge] or 0)

    def is_open(self, n: int) -> int:
        """How many tasks of an agent are open."""
        return len(self.agents[n].tasks) - self.agents[n].joined

    def score(self) -> tuple[int, int, int]:
        """What is to be as small as possible."""
        return sum(map(self.is_open, self.order)), self.overflow_sum(), self.wirelength()

    def price(self, n: int) -> tuple[int, int]:
        """Open tasks first, then the history of the edges."""
        return self.is_open(n), sum(self.history.get(edge, 0) for edge in self.edges_of(n))

    def in_the_way(self, n: int) -> list[int]:
        """Those that use full edges that matter to an agent, by their number and a lot."""
        cells = [cell for task in self.agents[n].tasks for cell in task]
        beyond = 1 if self.is_open(n) else 0
        low = [min(c[i] for c in cells) - beyond for i in (0, 1)]
        high = [max(c[i] for c in cells) + beyond for i in (0, 1)]

        def near(edge: Edge) -> bool:
            return all(low[i] <= edge[0][i] <= high[i] for i in (0, 1))

        edges = {
            edge
            for edge, users in self.users.items()
            if self.full(edge) and (n in users or near(edge))
        }
        counts = {o: len(edges & self.edges_of(o)) for o in range(len(self.agents)) if o != n}
        weights = {o: count * lot(self.round, n, o) for o, count in counts.items() if count}
        most = self.neighbours
        if self.negotiation.patience:
            most = min(most, (self.plain - 1) // self.negotiation.patience)
        if self.priced():
            most = 0
        return sorted(weights, key=lambda o: (-weights[o], o))[:most]

    def release(self, n: int) -> None:
        """A net and those in its way walk again."""
        self.before = self.score()
        members = [n, *self.in_the_way(n)]
        self.again = {o: (self.edges_of(o), self.agents[o].joined) for o in members}
        self.picked += 1
        self.before_cost = self.cost(n)
        for o in members:
            for edge in self.edges_of(o):
                self.users[edge].remove(o)
            agent = self.agents[o]
            agent.crossing, agent.ending, agent.added_overflow = "NONE", "NONE", 0
            self.begin_net(o)

    def judge(self) -> None:
        """Undoes what made things worse."""
        worse = self.score() > self.before
        if self.priced():
            (n,) = self.again
            worse = (self.score()[0], self.cost(n)) > (self.before[0], self.before_cost)
        if worse:
            for o, (edges, joined) in self.again.items():
                self.give(o, edges, joined)
        self.again = {}

    def give(self, n: int, edges: set[Edge], joined: int) -> None:
        """A net has just these edges."""
        for edge in self.edges_of(n):
            self.users[edge].remove(n)
        for edge in edges:
            self.users[edge].add(n)
        self.agents[n].joined = joined

    # --- priced rounds -----------------------------------------------------------------------

    def priced(self) -> bool:
        """Whether edges have prices in the present round."""
        return self.negotiation.prices and self.rounds > 0 and self.plain == 0

    def first_present(self) -> int:
        """What one net too many adds to the cost of an edge at first, in 1024ths."""
        return round(1024 * self.negotiation.present_factor)

    def calm(self) -> int:
        """What steps of the prices are divided by, in hundredths."""
        if self.best is not None and self.best[0][1] > 0:
            return 100
        return 100 + round(100 * self.negotiation.step_decay) * self.negotiations

    def cost(self, n: int) -> int:
        """What a net's edges cost it at the prices, in sixteenths."""
        return sum(self.edge_cost(n, edge) for edge in self.edges_of(n))

    def edge_cost(self, n: int, edge: Edge) -> int:
        """What an edge costs a net, whether it uses it or not."""
        demand, capacity = self.demand(n, edge), self.capacity[edge]
        if capacity is None:
            return 16
        if demand > capacity:
            return 60 * 16
        over = sum(self.demand(o, edge) for o in self.users[edge] - {n}) + demand - capacity
        cost = 16 + int(self.prices.get(edge, 0) / 64 + 0.5)
        if over > 0 and demand:
            cost = cost * (1024 + self.present * over // demand) // 1024
        return min(cost, 60 * 16)

    def note_best(self) -> None:
        """Notes the routes if there were none better after any round."""
        if self.best is None or self.score() < self.best[0]:
            self.best = (
                self.score(),
                [(self.edges_of(n), agent.joined) for n, agent in enumerate(self.agents)],
            )

    def put_best(self) -> None:
        """Nets take the best routes."""
        self.note_best()
        assert self.best is not None
        for n, (edges, joined) in enumerate(self.best[1]):
            self.give(n, edges, joined)

    def choose_kind(self) -> None:
        """Whether the next round is priced."""
        if not self.negotiation.prices:
            self.plain += 1
            return
        self.note_best()
        open_, overflow, wirelength = self.score()
        if self.plain:
            gained = (
                open_ < self.began[0]
                or overflow < 0.99 * self.began[1]
                or 2000 * wirelength < 1999 * self.began[2]
            )
            self.stuck = 0 if gained else self.stuck + 1
            if self.stuck < 2:
                self.plain += 1
                return
            for edge, price in self.prices.items():
                left = price - 100 * (price * 10 // 100) // self.calm()
                self.prices[edge] = left // 64 * 64
            self.negotiations += 1
            self.plain = self.stuck = self.present = 0
            self.fewest = float("inf")
        else:
            self.stuck += 1
            if overflow < 0.99 * self.fewest:
                self.fewest, self.stuck = overflow, 0
            if overflow == 0 or self.stuck == 10:
                self.plain, self.stuck = 1, 0
                assert self.best is not None
                if self.best[0][:2] < (open_, overflow):
                    self.put_best()
                return
        first = self.first_present()
        rise = min(192 * max(self.present, first) // first, 640)
        for edge in self.capacity:
            if self.overflow_of(edge):
                self.prices[edge] = self.prices.get(edge, 0) + 100 * rise // self.calm()
        grown = self.present + self.present * (15 if self.negotiations else 25) // 100
        self.present = min(max(first, grown), 2048)

    def next_walk(self) -> int | None:
        """Who walks again, or is asked, when nobody is active; None: the end."""
        while True:
            if not self.line:
                if self.round == self.rounds or (self.round and not self.picked):
                    if self.negotiation.prices:
                        self.put_best()
                    for agent in self.agents:
                        all_joined = agent.joined == len(agent.tasks)
                        agent.status = "TERMINATED" if all_joined else "TRUNCATED"
                    return None
                self.choose_kind()
                self.round, self.picked, self.line = self.round + 1, 0, list(self.order)
                self.began = self.score()
                if self.priced():
                    self.line.sort(key=lambda n: -lot(self.round, n, -1))
                for edge in filter(self.full, self.capacity):
                    self.history[edge] = self.history.get(edge, 0) + 1
                if self.choose == "history":
                    self.line = list(self.order)
                    self.line.sort(key=lambda n: self.price(n), reverse=True)
            n = self.line.pop(0)
            if self.choose == "agents":
                agent = self.agents[n]
                agent.status, self.asked = "ACTIVE", True
                agent.task, agent.steps = 0, 0
                agent.at, agent.target = agent.tasks[0]
                return n
            full = any(map(self.full, self.edges_of(n)))
            if self.choose == "conflicts" and not (self.is_open(n) or full):
                continue
            if self.choose == "history" and not any(self.price(n)):
                continue
            self.release(n)
            return n

    # --- the paper's rules -------------------------------------------------------------------

    def half_perimeter(self, n: int) -> int:
        """Width and height of the box around an agent's pins, in Gcells."""
        cells = pin_gcells(self.problem, self.agents[n].net)
        return sum(max(c[i] for c in cells) - min(c[i] for c in cells) for i in (0, 1))

    def demand(self, n: int, edge: Edge) -> int:
        """What an edge costs an agent's net."""
        if is_via(edge):
            return 0
        layer = edge[0][2]
        net = self.problem.nets[self.agents[n].net]
        width = max(own_width(net, layer), self.problem.min_width[layer])
        return width + self.problem.min_spacing[layer]

    def remaining(self, edge: Edge) -> int | None:
        """Capacity less the demand of all users; None for a via."""
        capacity = self.capacity[edge]
        if capacity is None:
            return None
        return capacity - sum(self.demand(n, edge) for n in self.users[edge])

    def overflow_of(self, edge: Edge) -> int:
        """Demand over capacity."""
        remaining = self.remaining(edge)
        return 0 if remaining is None else max(0, -remaining)

    def has_room(self, n: int, edge: Edge) -> bool:
        """Whether the agent uses the edge or its capacity can take the agent's demand."""
        remaining = self.remaining(edge)
        return n in self.users[edge] or remaining is None or remaining >= self.demand(n, edge)

    def way(self, n: int, move: int) -> Edge | None:
        """The edge that a move would cross; None where it is blocked."""
        at = self.agents[n].at
        to = tuple(a + d for a, d in zip(at, STEPS[move], strict=True))
        edge = between(at, to)  # type: ignore[arg-type]
        if edge not in self.capacity:
            return None
        return edge if self.overflow == "allowed" or self.has_room(n, edge) else None

    def action_mask(self, n: int) -> list[int]:
        """The action mask: never all zero."""
        mask = [int(self.way(n, move) is not None) for move in range(6)]
        if self.mask.get("visited"):
            at, visited = self.agents[n].at, self.agents[n].visited
            ahead = [tuple(a + d for a, d in zip(at, step, strict=True)) for step in STEPS]
            fresh = [int(m and a not in visited) for m, a in zip(mask, ahead, strict=True)]
            mask = fresh if any(fresh) else mask
        mask = mask if any(mask) else [1] * 6
        if self.rounds and self.choose == "agents":
            mask = [1, 0, 0, 0, 0, 0, 1] if self.asked else [*mask, 0]
        return mask

    def active(self) -> list[int]:
        """Agents that still have a task to walk, in turn order."""
        return [n for n in self.order if self.agents[n].status == "ACTIVE"]

    def go(self, n: int, move: int) -> None:
        """One agent's move, the end of its task and the beginning of its next."""
        agent = self.agents[n]
        agent.added_overflow = 0
        if self.asked:
            self.asked = False
            self.steps += 1
            if move == 6:
                self.release(n)
            else:
                agent.status = "WAITING"
            agent.crossing, agent.ending = "ANSWERED", "NONE" if move == 6 else "JOINED"
            return
        edge = self.way(n, move) if move < 6 else None
        if edge is None:
            agent.crossing = "BLOCKED"
        else:
            before = self.overflow_of(edge)
            agent.crossing = "OWN" if n in self.users[edge] else "NEW"
            agent.taken |= {edge} - self.edges_of(n)
            self.users[edge].add(n)
            agent.added_overflow = self.overflow_of(edge) - before
            agent.at = edge[1] if agent.at == edge[0] else edge[0]
        agent.steps += 1
        self.steps += 1
        agent.ending = "NONE"
        agent.visited.add(agent.at)
        arrived = agent.at == agent.target
        if self.target == "tree":
            before = [e for e in self.edges_of(n) if e not in agent.taken]
            graph: nx.Graph[Gcell] = nx.Graph(before)
            graph.add_node(agent.tasks[0][0])
            arrived = agent.at in nx.node_connected_component(graph, agent.tasks[0][0])
        if arrived:
            agent.ending = "JOINED"
            agent.joined += 1
        elif agent.steps == self.max_steps:
            agent.ending = "FAILED"
        if agent.ending == "NONE":
            return
        if agent.ending == "FAILED" and self.release_failed:
            for taken in agent.taken:
                self.users[taken].remove(n)
        if self.keeps_tree():
            tree = self.tree(n)
            agent.joined = sum(pin in tree for _, pin in agent.tasks)
        following = self.following(n)
        if following is not None:
            self.begin(n, following)
        elif self.rounds:
            agent.status = "WAITING"
            if self.again and not any(self.agents[o].status == "ACTIVE" for o in self.again):
                self.judge()
        else:
            agent.status = "TERMINATED" if agent.joined == len(agent.tasks) else "TRUNCATED"

    def step(self, move: int) -> None:
        """The agent whose turn it is moves, and the turn passes."""
        mover, answers = self.turn, self.asked
        assert mover is not None
        self.go(mover, move)
        if self.turn_order == "sequential" and self.agents[mover].status == "ACTIVE":
            return
        self.turn = self.first() if answers else self.next_after(mover)

    def next_after(self, mover: int) -> int | None:
        """The next active agent in turn order, the mover itself last."""
        place = self.order.index(mover)
        cycle = self.order[place + 1 :] + self.order[: place + 1]
        active = next((n for n in cycle if self.agents[n].status == "ACTIVE"), None)
        return self.first() if active is None else active

    def first(self) -> int | None:
        """The first active agent in turn order; if there is none, nets walk again."""
        if self.active() or not self.rounds:
            return next(iter(self.active()), None)
        walker = self.next_walk()
        return walker if self.turn_order == "sequential" else next(iter(self.active()), None)

    def step_all(self, moves: Sequence[int]) -> None:
        """Every active agent moves once; in sequential order only the one whose turn it is."""
        assert self.turn is not None
        for agent in self.agents:  # what those did who do not move now is forgotten
            agent.crossing, agent.ending, agent.added_overflow = "NONE", "NONE", 0
        for n in [self.turn] if self.turn_order == "sequential" else self.active():
            self.go(n, moves[n])
        if self.turn_order == "round_robin":
            self.turn = self.first()
        elif self.agents[self.turn].status != "ACTIVE":
            self.turn = self.next_after(self.turn)

    def edges_of(self, n: int) -> set[Edge]:
        """The edges that an agent's net uses."""
        return {edge for edge, users in self.users.items() if n in users}

    def solution(self) -> Solution:
        """The routes."""
        routes: list[list[int]] = [[] for _ in self.problem.nets]
        for n, agent in enumerate(self.agents):
            routes[agent.net] = [edge_number(self.problem, edge) for edge in self.edges_of(n)]
        return Solution(self.problem, tuple(np.array(route, np.int64) for route in routes))

    def overflow_sum(self) -> int:
        """Overflow of all edges."""
        return sum(self.overflow_of(edge) for edge in self.capacity)

    def wirelength(self) -> int:
        """Edges used, summed over the nets."""
        return sum(len(users) for users in self.users.values())

    def graph(self, n: int) -> nx.Graph:
        """The grid as an agent finds it: 1 a step, 1000 across an edge without room."""
        graph = nx.Graph()
        for edge in self.capacity:
            graph.add_edge(*edge, weight=1 if self.has_room(n, edge) else 1000)
        return graph


def random_moves(
    engine: Engine, rng: np.random.Generator, wild: float = 0.2
) -> NDArray[np.integer]:
    """(M, N) moves: some anything, some towards the target, most what the mask allows."""
    shape = engine.agents.shape
    masks = engine.masks(*engine.pairs(everyone=True)).reshape(*shape, engine.actions)
    moves = rng.random(masks.shape) * masks
    position = engine.grid.position
    away = position[engine.agents["target"]] - position[engine.agents["cell"]]
    wanted = np.stack((away > 0, away < 0), axis=-1).reshape(*shape, 6)
    moves[..., :6] += wanted * masks[..., :6] * (rng.random((*shape, 1)) < 0.5)
    choice = moves.argmax(axis=-1)
    return np.where(rng.random(shape) < wild, rng.integers(engine.actions, size=shape), choice)


@st.composite
def contested(
    draw: st.DrawFn,
    grid: tuple[int, int, int] | None = None,
    max_nets: int = 6,
    max_pins: int = 4,
    max_capacity: int = 4,
) -> Problem:
    """Problems with something to route: tight capacities, pins that repeat, nets of one Gcell."""
    if grid is None:
        sides = draw(st.sampled_from([(1, 5), (2, 2), (3, 4), (4, 4), (5, 3), (2, 6)]))
        grid = (*sides, draw(st.integers(1, 3)))
    columns, rows, layers = grid
    tile = draw(st.sampled_from([(1, 1), (10, 10), (3, 7)]))
    origin = draw(st.sampled_from([(0, 0), (-5, 20)]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))

    def pin() -> Pin:
        x, y = rng.integers(columns * tile[0]), rng.integers(rows * tile[1])
        return Pin(int(origin[0] + x), int(origin[1] + y), int(rng.integers(1, layers + 1)))

    nets = []
    for index in range(draw(st.integers(1, max_nets))):
        pins = [pin() for _ in range(rng.integers(1, max_pins + 1))]
        width: int | tuple[int, ...] = int(rng.integers(0, 3))
        if rng.random() < 0.2:
            width = tuple(rng.integers(0, 3, layers).tolist())
        nets.append(Net(f"n{index}", index, tuple(pins), width))
    # One net surely has something to route.
    far = Pin(origin[0] + columns * tile[0] - 1, origin[1] + rows * tile[1] - 1, layers)
    ends = (Pin(*origin, 1), far)
    nets.insert(int(rng.integers(len(nets) + 1)), Net("ends", 99, ends, 1))

    edges = [
        (a, (a[0] + dx, a[1] + dy, a[2]))
        for a in np.ndindex(columns, rows, layers)
        for dx, dy in ((1, 0), (0, 1))
        if a[0] + dx < columns and a[1] + dy < rows
    ]
    chosen = rng.permutation(len(edges))[: draw(st.integers(0, 6))]
    adjustments = []
    for (x1, y1, z1), (x2, y2, z2) in (edges[i][:: rng.choice((-1, 1))] for i in chosen):
        capacity = int(rng.integers(0, max_capacity + 1))
        adjustments.append(Adjustment(x1, y1, z1 + 1, x2, y2, z2 + 1, capacity))

    def numbers(most: int) -> tuple[int, ...]:
        return tuple(rng.integers(0, most + 1, layers).tolist())

    return Problem(
        grid=grid,
        vertical_capacity=numbers(max_capacity),
        horizontal_capacity=numbers(max_capacity),
        nets=tuple(nets),
        min_width=numbers(2),
        min_spacing=numbers(1),
        via_spacing=(0,) * layers,
        origin=origin,
        tile=tile,
        adjustments=tuple(adjustments),
    )
