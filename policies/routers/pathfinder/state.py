"""The arrays that the compiled code works on, and how they are set up for a problem.

Costs and lengths are whole numbers, in units of which an edge inside a layer has :data:`UNIT`.
Sizes: G Gcells, E edge numbers, N nets, Z layers (:mod:`marouting.problem.grid`).
"""

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution, evaluate
from marouting.config import check
from marouting.memory import NEGOTIATION, check_memory
from marouting.problem.controls import layers_of
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.exact_tree import Search, make_search
from marouting.trees.lattice import Lattice, make_lattice
from policies.routers.pathfinder.options import PathfinderOptions

UNIT = 256
"""Cost of an edge inside a layer, so that prices can be fractions of an edge."""

FULL = 4096 * UNIT
"""Cost of one track of overflow where overflow is to be avoided; higher than any price of an edge.
With extreme weights of vias or of crowding a whole way around may cost more."""

EXACT_LABELS = 1 << 17
"""Largest search for a cheapest tree, in labels: points in the box times 2^(pins - 1)."""

NEGOTIATED_LABELS = 1 << 12
"""The same in negotiating passes, which are many: good trees reach further than few best ones."""

MENDED = 80
"""Of a hundred nets that negotiate and are too large for a cheapest tree, so many keep their tree
but for the paths that overflow. The others grow new ones, or all would keep their trees' shapes."""

LAYERS = 2
"""Layers by which a net's box extends beyond its pins and its tree: boxes with all ten layers of a
chip would take twice the time. A net that is rerouted again comes higher each time."""

FIRST_BOX = 4096
"""Points in the largest box that the working memory has room for at first."""

MOST_TOGETHER = 16
"""Nets that are rerouted together to repair a solution."""

Kind = Literal["relax", "negotiate", "squeeze", "repair", "pattern"]
KINDS: tuple[Kind, ...] = ("relax", "negotiate", "squeeze", "repair", "pattern")
RELAX, NEGOTIATE, SQUEEZE, REPAIR, PATTERN = range(len(KINDS))

DISPLACE, PRICES, RESTORE = -1, -2, -3
"""No kinds of passes. DISPLACE: within a repairing pass, costs are as if all negotiated, but
without prices. PRICES: the linear program sets prices. RESTORE: the best solution is put in
place."""

DONE, PAUSED, BOX_TOO_SMALL, POOL_TOO_SMALL = range(0, -4, -1)
"""Why a call of compiled code returned. Numbers above 0 are results."""

PROGRESS = np.dtype(
    [
        ("kind", np.int64),  # of the current pass: RELAX, NEGOTIATE, SQUEEZE, REPAIR or PATTERN
        ("next", np.int64),  # index in Routing.order of the next net
        ("routed", np.int64),  # nets rerouted in this pass
        ("overflow", np.int64),  # of all edges, in tracks
        ("length", np.int64),  # of all trees, in units of cost
        ("present", np.float64),  # factor for one net too many, now; 0: nets share edges freely
        ("top", np.int64),  # end of the used part of Routing.edge
        ("need", np.int64),  # the size required, after BOX_TOO_SMALL or POOL_TOO_SMALL
        ("until", np.int64),  # the search looks at the clock when it has opened so many labels
        ("random", np.int64),  # state of the random numbers
        ("unproven", np.int64),  # nets whose ideal length may not be the shortest possible
        ("linked", np.int64),  # whether Routing.head leads to the users of every edge
    ],
    align=True,
)
"""How far the search has come."""


class ProblemArrays(NamedTuple):
    """The problem, and the options that compiled code needs."""

    size: NDArray[np.int64]  # (3,) columns, rows, layers
    position: NDArray[np.int32]  # (G, 3) x, y, z of each Gcell
    capacity: NDArray[np.int32]  # (E,) in tracks; negative where there must be no wires
    widest: NDArray[np.int32]  # (Z, 2) the largest capacity along each axis in each layer
    demand: NDArray[np.int32]  # (N, Z) tracks that a net takes from an edge in a layer
    layer_cost: NDArray[np.int32]  # (N, Z) what a net's wire costs more in a layer, in UNIT
    first: NDArray[np.int64]  # (N + 1,) a net's pins are pin[first[net] : first[net + 1]]
    pin: NDArray[np.int64]  # (pins,) their Gcells
    height: NDArray[np.int64]  # (Z,) what the vias up to a layer from the lowest one cost
    exact_pins: int
    margin: int
    reroute_fraction: int  # in parts of 2^20
    least_repaired: int  # nets that a repairing pass reroutes
    crowding: float  # what an edge costs more when it is full, in edges
    crowded_from: float  # the share of its capacity from which on it does
    contest: bool  # whether costs are those of ISPD 2024
    # By the rules of ISPD 2024, in units of cost and in tracks; otherwise empty:
    wire: NDArray[np.int64]  # (2, columns or rows) along each axis a wire to the next Gcell
    overflow_cost: NDArray[np.float64]  # (Z,) of a Gcell that is just full
    tracks: NDArray[np.float64]  # (E,) capacities
    along: NDArray[np.int64]  # (Z,) the axis of each layer's wires


class Routing(NamedTuple):
    """The nets' trees, the prices and the best solution so far."""

    progress: NDArray[Any]  # (1,) PROGRESS
    order: NDArray[np.int64]  # (routable nets,) the order of the nets in this pass
    remaining: NDArray[np.int64]  # (E,) capacity minus demand; negative where edges overflow
    vias: NDArray[np.float64]  # (E,) ISPD 2024: tracks that vias and kept nets take; or empty
    price: NDArray[np.float64]  # (E,) price from past overflow, in units of cost
    # (N,) length of the shortest tree so far (ISPD 2024: what the latest one cost); -1: none yet
    ideal: NDArray[np.int64]
    edge: NDArray[np.int32]  # (pool,) edges of the trees
    start: NDArray[np.int64]  # (N,) a net's edges are edge[start : start + length]
    length: NDArray[np.int64]  # (N,)
    head: NDArray[np.int32]  # (E,) an edge's users: the place in the pool of one of them; -1: none
    after: NDArray[np.int32]  # (pool,) the place of the next one
    owner: NDArray[np.int32]  # (pool,) the net whose tree has a place
    best: NDArray[np.int32]  # (pool,) edges of the best solution
    best_first: NDArray[np.int64]  # (N + 1,) a net's are best[best_first[n] : best_first[n + 1]]
    together: NDArray[np.int64]  # (MOST_TOGETHER, 3) nets repaired together, their old trees


class NetBuffers(NamedTuple):
    """Working memory for one net; points are those of its box."""

    low: NDArray[np.int64]  # (3,) x, y, z of the box's first point
    far: NDArray[np.int64]  # (pins,) a pin's distance from the tree; -1 once it has joined
    pin: NDArray[np.uint8]  # (points,) 1 where the net has a pin; all 0 between nets
    inside: NDArray[np.uint8]  # (points,) 1 where a walk has been; all 0 between walks
    key: NDArray[np.int64]  # (2 points,) list of pins and branching points; of a pattern's points
    layers: NDArray[np.int64]  # (2, Z) what the wires of a pattern cost in every layer
    tree: NDArray[np.int32]  # (points,) edges of the new tree


class Memory(NamedTuple):
    """All working memory."""

    lattice: Lattice
    search: Search
    buffers: NetBuffers


def _height(problem: Problem, options: PathfinderOptions) -> NDArray[np.int64]:
    """(Z,) what the vias up to each layer from the lowest one cost."""
    steps, weights = problem.grid[VIA_AXIS] - 1, options.via_weight
    if not isinstance(weights, tuple):
        weights = (weights,) * steps
    if len(weights) != steps:
        raise InputError(
            f"via_weight: expected {steps} numbers, one for each layer but the highest, "
            f"found {len(weights)}"
        )
    return np.cumsum([0, *(round(weight * UNIT) for weight in weights)])


def _layer_costs(problem: Problem, options: PathfinderOptions) -> NDArray[np.int32]:
    """(N, Z) what a wire of a net costs more in a layer, because the net prefers others."""
    cost = np.zeros((len(problem.nets), problem.grid[VIA_AXIS]), np.int32)
    if options.prefer_layers is not None and options.prefer_from is not None:
        preferred = layers_of(problem, "prefer_layers", options.prefer_layers)
        edges = problem.capacity.reshape(-1, problem.grid[VIA_AXIS], AXES)
        wires = bool((edges[:, preferred, :VIA_AXIS] > 0).any()) and not preferred.all()
        check("prefer_layers", wires, "some of the layers in which there may be wires")
        long = problem.half_perimeters >= options.prefer_from
        cost[np.ix_(long, ~preferred)] = round(options.prefer_weight * UNIT)
    return cost


def _capacity(problem: Problem) -> NDArray[np.int32]:
    """(E,) the capacity of every edge; -1 if it is closed."""
    capacity = np.where(problem.closed, np.int32(-1), problem.capacity)
    capacity.setflags(write=False)  # as the problem's, or numba would compile the router once more
    return capacity


def make_arrays(problem: Problem, options: PathfinderOptions) -> tuple[ProblemArrays, Routing]:
    """The problem as arrays, and a routing without any trees."""
    first, pin = problem.flat_pin_gcells
    grid = problem.topology
    check_memory(NEGOTIATION * grid.gcells, "negotiated congestion on a grid of {}", grid)
    nets, routable = len(problem.nets), np.flatnonzero(np.diff(first) > 1)
    capacity = _capacity(problem)
    edges = np.where(grid.exists.reshape(-1), capacity, -1).reshape(-1, problem.grid[2], AXES)
    arrays = ProblemArrays(
        size=np.array(problem.grid, np.int64),
        position=grid.position,
        capacity=capacity,
        widest=edges[:, :, :VIA_AXIS].max(axis=0),
        demand=problem.net_demand,
        layer_cost=_layer_costs(problem, options),
        first=first,
        pin=pin,
        height=_height(problem, options),
        exact_pins=options.exact_pins,
        margin=options.margin,
        reroute_fraction=round(options.reroute_fraction * (1 << 20)),
        least_repaired=math.ceil(options.min_repair_fraction * len(routable)),
        crowding=float(options.crowding),
        crowded_from=float(options.crowded_from),
        contest=False,
        wire=np.empty((2, 0), np.int64),
        overflow_cost=np.empty(0),
        tracks=np.empty(0),
        along=np.empty(0, np.int64),
    )
    # Short nets come first: they have fewer ways to choose from.
    extent = problem.half_perimeters
    progress = np.zeros(1, PROGRESS)
    progress["random"] = options.seed
    progress["kind"] = PATTERN
    pool = 4 * int(extent.sum()) + 4 * len(pin) + 1
    ideal = np.zeros(nets, np.int64)
    ideal[routable] = -1
    routing = Routing(
        progress=progress,
        order=routable[np.argsort(extent[routable], kind="stable")],
        remaining=problem.capacity.astype(np.int64),
        vias=np.empty(0),
        price=np.zeros(grid.edges),
        ideal=ideal,
        edge=np.empty(pool, np.int32),
        start=np.zeros(nets, np.int64),
        length=np.zeros(nets, np.int64),
        head=np.empty(grid.edges, np.int32),
        after=np.empty(pool, np.int32),
        owner=np.empty(pool, np.int32),
        best=np.empty(pool, np.int32),
        best_first=np.zeros(nets + 1, np.int64),
        together=np.zeros((MOST_TOGETHER, 3), np.int64),
    )
    return arrays, routing


def make_memory(problem: ProblemArrays, points: int) -> Memory:
    """Working memory for boxes of at most ``points`` points."""
    buffers = NetBuffers(
        low=np.zeros(AXES, np.int64),
        far=np.empty(int(np.diff(problem.first).max()), np.int64),
        pin=np.zeros(points, np.uint8),
        inside=np.zeros(points, np.uint8),
        key=np.empty(2 * points, np.int64),
        layers=np.zeros((2, problem.size[VIA_AXIS]), np.int64),
        tree=np.empty(points, np.int32),
    )
    lattice = make_lattice(points, int(problem.size.max()))
    search = make_search(points, max(points, EXACT_LABELS), problem.exact_pins - 1)
    return Memory(lattice, search, buffers)


def solution_of(
    problem: Problem,
    edges: NDArray[np.int32],
    first: NDArray[np.int64],
    length: NDArray[np.int64],
) -> Solution:
    """The solution in which so many ``edges``, from the ``first`` on, are each net's."""
    net = np.repeat(np.arange(len(length)), length)
    place = np.arange(len(net)) + (first - np.cumsum(length) + length)[net]
    return Solution.of_uses(problem, net, edges[place].astype(np.int64))


def with_larger_pool(routing: Routing, size: int) -> Routing:
    """The routing with room for ``size`` edges in each pool; its other arrays are shared."""
    pools = routing.edge, routing.after, routing.owner, routing.best
    edge, after, owner, best = (widened(pool, size) for pool in pools)
    return routing._replace(edge=edge, after=after, owner=owner, best=best)


def with_trees(routing: Routing, solution: Solution) -> Routing:
    """The routing with the trees of a solution, for the first pass to put in place.

    Those of open nets, or with wires on closed edges, are left out.
    """
    tree = solution.pruned()
    net, edge = tree.uses
    open_nets = set(evaluate(solution.problem, tree).disconnected)
    fits = np.array([each.name not in open_nets for each in solution.problem.nets])
    fits[net[solution.problem.closed[edge]]] = False
    taken = fits[net]
    routing.length[:] = np.bincount(net[taken], minlength=len(routing.length))
    routing.start[:] = np.cumsum(routing.length) - routing.length
    size = int(np.count_nonzero(taken))
    routing.progress["top"] = size
    if size > len(routing.edge):
        routing = with_larger_pool(routing, 2 * size)
    routing.edge[:size] = edge[taken]
    return routing


def widened(row: NDArray[Any], size: int) -> NDArray[Any]:
    """The same numbers with room for ``size`` of them."""
    wider = np.empty(size, row.dtype)
    wider[: len(row)] = row
    return wider
