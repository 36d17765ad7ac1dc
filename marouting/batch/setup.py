"""Setting up the game: the arrays of a batch of problems."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.batch.prices import PRICE_SCALE, Negotiation
from marouting.batch.state import AGENT, GAME, Choice, Dynamic, Option, Static
from marouting.errors import InputError
from marouting.game import NOBODY
from marouting.memory import PLAYED, TABLES, check_memory
from marouting.problem.grid import MOVES, Grid
from marouting.problem.problem import UNLIMITED, Problem
from marouting.rules import RipUp, Rules, net_ranks
from marouting.trees.decomposition import two_pin_tasks

Make = Callable[[str, tuple[int, ...], Any], Any]
"""Makes an array of zeros, of a name, a shape and a dtype, where the games are to be."""


def zeros(name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """An array of zeros on the processor."""
    del name
    return np.zeros(shape, dtype)


class Room(NamedTuple):
    """How large problems are at most that take each other's place in a game."""

    nets: int  # nets of a problem
    pins: int  # pins of a problem, of all its nets together

    @classmethod
    def of(cls, problems: Sequence[Problem]) -> "Room":
        """Room for each of some problems."""
        pins = max(sum(len(net.pins) for net in problem.nets) for problem in problems)
        return cls(max(len(problem.nets) for problem in problems), pins)

    @property
    def tasks(self) -> int:
        """Two-pin tasks at most: a Steiner tree of p pins has less than 2 p edges."""
        return 2 * self.pins


def static_state(
    problems: Sequence[Problem],
    rules: Rules,
    room: Room | None = None,
    negotiation: Negotiation | None = None,
    options: NDArray[np.int64] | None = None,
) -> tuple[Static, NDArray[np.int32]]:
    """The constant arrays of M problems with one grid shape.

    Args:
        problems: the problems.
        rules: the options of the rules.
        room: the size of the arrays; None: what these problems need.
        negotiation: how nets negotiate; None: they do not.
        options: :attr:`.Static.options`, if they are known already.

    Returns:
        The arrays, and (M, N) int32, the net of every agent, NOBODY where there is no agent.

    Raises:
        InputError: the problems cannot be played, or take too much memory.
    """
    if not problems:
        raise InputError("problems: expected at least one")
    for problem in problems:
        if not isinstance(problem, Problem):
            raise InputError(f"problems: expected objects of class Problem, found {problem!r}")
    if any(problem.grid != problems[0].grid for problem in problems):
        shapes = sorted({problem.grid for problem in problems})
        raise InputError(f"problems: expected one grid shape, found {shapes}")
    grid = Grid.of(problems[0].grid)
    overflow = rules.overflow == "allowed"
    routed = [np.flatnonzero(p.to_route) for p in problems]
    for m, nets in enumerate(routed):
        if not len(nets):
            raise InputError(f"problem {m}: expected a net with pins in two Gcells or more")
    shape = len(problems), room.nets if room else max(map(len, routed))
    check_memory(
        grid.gcells * (TABLES + PLAYED * shape[0]) + 8 * math.prod(shape) * grid.shape[2],
        "{} problems of up to {} nets on a grid of {}",
        *shape,
        grid,
    )
    agent_net, order = np.full((2, *shape), NOBODY, np.int32)
    first = np.zeros((shape[0], shape[1] + 1), np.int32)
    demand = np.zeros((*shape, grid.shape[2]), np.int32)
    extended = rules.target == "tree" or rules.next_pin == "nearest" or rules.mask.visited
    extended |= rules.release_failed or bool(rules.rip_up and rules.rip_up.rounds)
    extended |= rules.actions > MOVES
    tasks = [two_pin_tasks(problem, rules.nets.decomposition) for problem in problems]
    begins = np.cumsum([0, *map(len, tasks)]) if room is None else room.tasks * np.arange(shape[0])
    table = np.zeros((int(begins[-1]) + (room.tasks if room else 0), 2), np.int32)
    for m, (problem, nets, own) in enumerate(zip(problems, routed, tasks, strict=True)):
        if room is not None:
            _check_room(room, len(nets), len(own))
        table[begins[m] : begins[m] + len(own)] = own[:, 1:]
        first[m] = begins[m] + len(own)  # also where there is no agent
        first[m, : len(nets)] = begins[m] + np.searchsorted(own[:, 0], nets)
        agent_net[m, : len(nets)], demand[m, : len(nets)] = nets, problem.net_demand[nets]
        if overflow and demand[m].max(axis=1).sum(dtype=np.int64) > UNLIMITED:
            raise InputError(f"problem {m}: expected demands that add up to at most {UNLIMITED}")
        ranks = net_ranks(problem, rules.nets.order)[nets]
        order[m, : len(nets)] = np.argsort(ranks, kind="stable")
    if options is None and extended:
        options = _options(rules, (int(shape[1]), grid.gcells, grid.edges), negotiation)
    static = Static(
        neighbour=grid.neighbour,
        edge=grid.edge,
        exits=grid.exits,
        position=grid.position,
        capacity=np.array([problem.capacity for problem in problems]),
        demand=demand,
        tasks=table,
        first=first,
        order=order,
        sequential=rules.turn_order != "round_robin",
        overflow_allowed=overflow,
        max_steps=rules.steps_per_task(problems[0].grid),
        extended=True if extended else None,
        options=_PLAIN if options is None else options,
    )
    return static, agent_net


def _check_room(room: Room, agents: int, tasks: int) -> None:
    """Raises InputError for a problem that is too large."""
    if agents > room.nets or tasks > room.tasks:
        raise InputError(
            f"problem: expected at most {room.nets} nets with {room.tasks} two-pin tasks to route, "
            f"found {agents} with {tasks}"
        )


def replace_problem(
    static: Static, nets: NDArray[np.int32], m: int, problem: Problem, rules: Rules, room: Room
) -> None:
    """Puts another problem on the same grid in place m of arrays that have room for it.

    Raises:
        InputError: the problem is too large, on another grid, or has nothing to route.
    """
    own, own_nets = static_state([problem], rules, options=static.options)
    shapes = [tuple(state.position[-1].tolist()) for state in (static, own)]
    if shapes[0] != shapes[1]:
        raise InputError(f"problem: expected one grid shape, found another, {problem.grid}")
    agents, tasks, begin = own_nets.shape[1], len(own.tasks), static.first[m, 0]
    _check_room(room, agents, tasks)
    static.capacity[m] = own.capacity[0]
    static.demand[m], static.demand[m, :agents] = 0, own.demand[0]
    static.first[m], static.first[m, : agents + 1] = begin + tasks, begin + own.first[0]
    static.tasks[begin : begin + tasks] = own.tasks
    static.order[m], static.order[m, :agents] = NOBODY, own.order[0]
    nets[m], nets[m, :agents] = NOBODY, own_nets[0]


def _options(
    rules: Rules, shape: tuple[int, int, int], negotiation: Negotiation | None = None
) -> NDArray[np.int64]:
    """(len(Option),) int64, what the options say, for N agents, G Gcells and E edges."""
    agents, gcells, edges = shape
    rip_up = rules.rip_up or RipUp(rounds=0)
    rounds = rip_up.rounds > 0
    negotiation = negotiation or Negotiation(prices=False)
    prices = rounds and negotiation.prices
    nearest = rules.next_pin == "nearest"
    tree = rules.target == "tree" or nearest
    most_ripped = (1 + rip_up.neighbours) * rounds
    options = np.full(len(Option), -1, np.int64)
    options[Option.TREE_TARGET] = rules.target == "tree"
    options[Option.NEAREST_NEXT] = nearest
    options[Option.MASK_VISITED] = rules.mask.visited
    options[Option.RELEASE_FAILED] = rules.release_failed
    options[Option.ROUNDS] = rip_up.rounds
    options[Option.RIP_UP] = Choice[rip_up.choose.upper()]
    options[Option.RIPPED_MOST] = most_ripped
    options[Option.PATIENCE] = negotiation.patience
    options[Option.PRESENT] = round(negotiation.present_factor * PRICE_SCALE)
    options[Option.STEP_DECAY] = round(negotiation.step_decay * 100)
    options[Option.MOVES] = rules.moves
    options[Option.WAIT] = rules.wait
    rows = {
        Option.TREE: agents * tree,
        Option.VISITED: agents * rules.mask.visited,
        Option.TAKEN: agents * rules.release_failed,
        Option.KEPT: most_ripped,
        Option.BEGUN: agents * nearest,
        Option.BEST: agents * prices,
    }
    columns = {
        Option.LINE: agents * rounds,
        Option.RIPPED: most_ripped,
        Option.KEPT_JOINED: most_ripped,
        Option.HISTORY: edges * rounds,
        Option.PRICES: edges * prices,
        Option.BEST_JOINED: agents * prices,
        Option.QUEUE: max(gcells * tree, most_ripped),
    }
    for total, sizes in ((Option.ROWS, rows), (Option.COLUMNS, columns)):
        options[total] = 0
        for option, size in sizes.items():  # one after another
            if size:
                options[option] = options[total]
                options[total] += size
    return options


_PLAIN = _options(Rules(), (0, 0, 0))  # the options of the paper's game: all are switched off


def dynamic_state(
    static: Static, grid: Grid, agents: int, games: int | None = None, make: Make | None = None
) -> Dynamic:
    """The arrays that change during an episode, of zeros.

    Args:
        static: those that do not.
        grid: the grid.
        agents: N.
        games: M; None: as many as the problems of ``static``.
        make: makes them; None: on the processor.

    Raises:
        InputError: they take too much memory.
    """
    edges = static.capacity.shape[1]
    m = len(static.capacity) if games is None else games
    row_bytes, rows = -(-edges // 8), int(static.options[Option.ROWS])
    columns = int(static.options[Option.COLUMNS])
    if make is None:
        check_memory(
            m * ((agents + rows) * row_bytes + 8 * columns),
            "a batch with {} nets on a grid of {} (global_routing_v0.env has room for more)",
            m * agents,
            grid,
        )
        make = zeros
    return Dynamic(
        remaining=make("remaining", (m, edges), np.int32),
        used=make("used", (m, agents, row_bytes), np.uint8),
        agents=make("agents", (m, agents), AGENT),
        games=make("games", (m,), GAME),
        sets=make("sets", (m, rows, row_bytes), np.uint8),
        numbers=make("numbers", (m, columns), np.int64),
    )
