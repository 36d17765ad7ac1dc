"""The arrays that the compiled code works on, and how they are set up for a problem.

Costs and lengths are whole numbers, in units of which an edge inside a layer has :data:`UNIT`.
Sizes: G Gcells, E edge numbers, N nets, Z layers (:mod:`marouting.problem.grid`).
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution, evaluate
from marouting.memory import NEGOTIATION, check_memory
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.exact_tree import Search, make_search
from marouting.trees.lattice import Lattice, make_lattice
from policies.routers.pathfinder.options import PathfinderOptions

UNIT = 256
"""Cost of an edge inside a layer, so that prices can be fractions of an edge."""

FULL = 4096 * UNIT
"""Cost of one track of overflow where overflow is to be avoided; higher than any price."""

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

EARLY = 20
"""A solution that is found in an earlier pass counts as found in this one when the search decides
whether to go on: passes over few nets take next to no time."""

LARGE = 5_000
"""With more nets than these, negotiating begins with patterns; otherwise with shortest trees."""

MANY = 20_000
"""With more nets than these, they are planned in batches; otherwise they take turns."""

SHARE = 64
"""One net of so many, at most, is in a batch, so that few of them meet."""

MOST_PLANNED = 1024
"""Nets in a batch, at most."""

_HISTORY_ROWS = 64  # passes after which the compiled code returns, at the latest

Kind = Literal["relax", "negotiate", "squeeze", "repair", "pattern"]
KINDS: tuple[Kind, ...] = ("relax", "negotiate", "squeeze", "repair", "pattern")
RELAX, NEGOTIATE, SQUEEZE, REPAIR, PATTERN = range(len(KINDS))

DISPLACE = -1
"""No kind of pass: within a repairing pass, costs are as if all negotiated, but without prices."""

DONE, PAUSED, BOX_TOO_SMALL, POOL_TOO_SMALL = range(4)
"""Why a call of compiled code returned."""

EDGES, EXACT = range(2)
"""Places in ``NetBuffers.plan``: number of edges of the new tree; whether no tree in the box is
cheaper."""

PROGRESS = np.dtype(
    [
        ("kind", np.int64),  # of the current pass: RELAX, NEGOTIATE, SQUEEZE, REPAIR or PATTERN
        ("next", np.int64),  # index in Routing.order of the next net
        ("routed", np.int64),  # nets rerouted in this pass
        ("passes", np.int64),  # completed passes
        ("large", np.int64),  # whether negotiating begins with the patterns
        ("most", np.int64),  # nets in a batch, at most; 1: they take turns
        ("stuck", np.int64),  # passes since the overflow last fell in this round
        ("fewest", np.int64),  # least overflow in this round
        ("since", np.int64),  # rounds (in the end repairing passes) since the last better solution
        ("began", np.int64),  # completed passes when this round began
        ("found", np.int64),  # completed passes when the best solution was found
        ("overflow", np.int64),  # of all edges, in tracks
        ("length", np.int64),  # of all trees, in units of cost
        ("last_overflow", np.int64),  # before this pass
        ("last_length", np.int64),
        ("best_overflow", np.int64),
        ("best_length", np.int64),
        ("present", np.float64),  # factor for one net too many, now
        ("pool", np.int64),  # which of the two pools in Routing.edge is in use
        ("top", np.int64),  # end of the used part of that pool
        ("need", np.int64),  # the size required, after BOX_TOO_SMALL or POOL_TOO_SMALL
        ("work", np.int64),  # labels to open before the caller looks at the clock
        ("random", np.int64),  # state of the random numbers
        ("unproven", np.int64),  # nets whose ideal length may not be the shortest possible
        ("proven", np.int64),  # whether the present solution is known to be the best
        ("rounds", np.int64),  # completed rounds
        ("pricing", np.int64),  # further relaxing passes of this round, each at new prices
        ("crowding", np.float64),  # what an edge costs more when it is full, in edges
        ("crowded_from", np.float64),  # the share of its capacity from which on it does
        ("contest", np.int64),  # whether costs are those of ISPD 2024
        ("linked", np.int64),  # whether Routing.head leads to the users of every edge
        ("history", np.int64),  # filled rows of Routing.history
    ],
    align=True,
)
"""How far the search has come."""


class ProblemArrays(NamedTuple):
    """The problem."""

    size: NDArray[np.int64]  # (3,) columns, rows, layers
    position: NDArray[np.int32]  # (G, 3) x, y, z of each Gcell
    capacity: NDArray[np.int32]  # (E,) in tracks; negative where there must be no wires
    demand: NDArray[np.int32]  # (N, Z) tracks that a net takes from an edge in a layer
    first: NDArray[np.int64]  # (N + 1,) a net's pins are pin[first[net] : first[net + 1]]
    pin: NDArray[np.int64]  # (pins,) their Gcells
    height: NDArray[np.int64]  # (Z,) what the vias up to a layer from the lowest one cost
    # By the rules of ISPD 2024, in units of cost and in tracks; otherwise empty:
    wire: NDArray[np.int64]  # (2, columns or rows) along each axis a wire to the next Gcell
    overflow_cost: NDArray[np.float64]  # (Z,) of a Gcell that is just full
    tracks: NDArray[np.float64]  # (E,) capacities
    along: NDArray[np.int64]  # (Z,) the axis of each layer's wires


class Parameters(NamedTuple):
    """The options as numbers that the compiled code uses directly."""

    exact_pins: int
    margin: int
    present_factor: float
    present_growth: float
    history_increment: float
    history_decay: float
    step_decay: float
    stall_passes: int
    min_overflow_drop: float
    min_wirelength_gain: float
    reroute_fraction: int  # in parts of 2^20
    lp_after_pass: int
    lp_passes: int
    repair_after: int
    overflow_stall_weight: int
    repair_stall_passes: int
    min_repair_fraction: float
    patience_factor: int
    passes: int


class Routing(NamedTuple):
    """The nets' trees, the prices and the best solution so far."""

    progress: NDArray[Any]  # (1,) PROGRESS
    order: NDArray[np.int64]  # (routable nets,) the order of the nets in this pass
    remaining: NDArray[np.int64]  # (E,) capacity minus demand; negative where edges overflow
    vias: NDArray[np.float64]  # (E,) ISPD 2024: tracks that vias and kept nets take; or empty
    price: NDArray[np.float64]  # (E,) price from past overflow, in units of cost
    # (N,) length of the shortest tree so far (ISPD 2024: what the latest one cost); -1: none yet
    ideal: NDArray[np.int64]
    edge: NDArray[np.int32]  # (2, pool) edges of the trees, in the pool in use
    start: NDArray[np.int64]  # (N,) a net's edges are edge[pool, start : start + length]
    length: NDArray[np.int64]  # (N,)
    head: NDArray[np.int32]  # (E,) an edge's users: the place in the pool of one of them; -1: none
    after: NDArray[np.int32]  # (pool,) the place of the next one
    owner: NDArray[np.int32]  # (pool,) the net whose tree has a place
    best: NDArray[np.int32]  # (pool,) edges of the best solution
    best_first: NDArray[np.int64]  # (N + 1,) a net's are best[best_first[n] : best_first[n + 1]]
    together: NDArray[np.int64]  # (MOST_TOGETHER, 3) nets repaired together, their old trees
    history: NDArray[np.int64]  # (_HISTORY_ROWS, 4) kind, overflow, length, routed of new passes


class NetBuffers(NamedTuple):
    """Working memory for one net; points are those of its box."""

    low: NDArray[np.int64]  # (3,) x, y, z of the box's first point
    far: NDArray[np.int64]  # (pins,) a pin's distance from the tree; -1 once it has joined
    pin: NDArray[np.uint8]  # (points,) 1 where the net has a pin; all 0 between nets
    inside: NDArray[np.uint8]  # (points,) 1 where a walk has been; all 0 between walks
    key: NDArray[np.int64]  # (2 points,) list of pins and branching points; of a pattern's points
    layers: NDArray[np.int64]  # (2, Z) what the wires of a pattern cost in every layer
    plan: NDArray[np.int64]  # (2,) EDGES and EXACT
    tree: NDArray[np.int32]  # (1, points) edges of the new tree


class Memory(NamedTuple):
    """All working memory."""

    lattice: Lattice
    search: Search
    buffers: NetBuffers


def make_parameters(options: PathfinderOptions) -> Parameters:
    """The options as numbers for the compiled code."""
    values = {name: getattr(options, name) for name in Parameters._fields}
    values["reroute_fraction"] = round(options.reroute_fraction * (1 << 20))
    return Parameters(**values)


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


def _capacity(problem: Problem) -> NDArray[np.int32]:
    """(E,) the capacity of every edge; -1 for wires along an axis on which a layer has none.

    A chip's layers with wires along x, together with those along y, lead everywhere. Where they do
    not, such wires are overflow as any other.
    """
    chip = problem.chip
    if chip is None or not chip.wires.any(axis=0).all():
        return problem.capacity
    capacity = problem.capacity.reshape(-1, problem.grid[2], AXES).copy()
    capacity[:, :, :VIA_AXIS][:, ~chip.wires] = -1
    capacity.setflags(write=False)  # as the problem's, or numba would compile the router once more
    return capacity.reshape(-1)


def make_arrays(problem: Problem, options: PathfinderOptions) -> tuple[ProblemArrays, Routing]:
    """The problem as arrays, and a routing without any trees."""
    first, pin = problem.flat_pin_gcells
    grid = problem.topology
    check_memory(NEGOTIATION * grid.gcells, "negotiated congestion on a grid of {}", grid)
    nets = len(problem.nets)
    arrays = ProblemArrays(
        size=np.array(problem.grid, np.int64),
        position=grid.position,
        capacity=_capacity(problem),
        demand=problem.net_demand,
        first=first,
        pin=pin,
        height=_height(problem, options),
        wire=np.empty((2, 0), np.int64),
        overflow_cost=np.empty(0),
        tracks=np.empty(0),
        along=np.empty(0, np.int64),
    )
    routable = np.flatnonzero(np.diff(first) > 1)
    # Short nets come first: they have fewer ways to choose from.
    low, high = problem.pin_boxes()
    extent = (high - low)[:, :VIA_AXIS].sum(axis=1)
    progress = np.zeros(1, PROGRESS)
    progress["random"] = options.seed
    progress["kind"] = PATTERN
    progress["large"] = len(routable) > LARGE
    batches = len(routable) > MANY
    progress["most"] = min(len(routable) // SHARE, MOST_PLANNED) if batches else 1
    progress["crowding"], progress["crowded_from"] = options.crowding, options.crowded_from
    progress["best_overflow"] = progress["fewest"] = np.iinfo(np.int64).max
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
        edge=np.empty((2, pool), np.int32),
        start=np.zeros(nets, np.int64),
        length=np.zeros(nets, np.int64),
        head=np.empty(grid.edges, np.int32),
        after=np.empty(pool, np.int32),
        owner=np.empty(pool, np.int32),
        best=np.empty(pool, np.int32),
        best_first=np.zeros(nets + 1, np.int64),
        together=np.zeros((MOST_TOGETHER, 3), np.int64),
        history=np.empty((_HISTORY_ROWS, 4), np.int64),
    )
    return arrays, routing


def make_memory(problem: ProblemArrays, exact_pins: int, points: int) -> Memory:
    """Working memory for boxes of at most ``points`` points."""
    buffers = NetBuffers(
        low=np.zeros(AXES, np.int64),
        far=np.empty(int(np.diff(problem.first).max()), np.int64),
        pin=np.zeros(points, np.uint8),
        inside=np.zeros(points, np.uint8),
        key=np.empty(2 * points, np.int64),
        layers=np.zeros((2, problem.size[VIA_AXIS]), np.int64),
        plan=np.zeros(2, np.int64),
        tree=np.empty((1, points), np.int32),
    )
    lattice = make_lattice(points, int(problem.size.max()))
    search = make_search(points, max(points, EXACT_LABELS), exact_pins - 1)
    return Memory(lattice, search, buffers)


def present_solution(problem: Problem, routing: Routing) -> Solution:
    """The trees that the nets have now."""
    pool = routing.edge[routing.progress[0]["pool"]]
    return solution_of(problem, pool, routing.start, routing.length)


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
    rows = np.stack([routing.best, routing.after, routing.owner])
    best, after, owner = widened(rows, size)
    edge = widened(routing.edge, size)
    return routing._replace(edge=edge, best=best, after=after, owner=owner)


def with_trees(routing: Routing, solution: Solution) -> Routing:
    """The routing with the trees of a solution, for the first pass to put in place."""
    tree = solution.pruned()
    net, edge = tree.uses
    open_nets = set(evaluate(solution.problem, tree).disconnected)
    taken = np.array([each.name not in open_nets for each in solution.problem.nets])[net]
    routing.length[:] = np.bincount(net[taken], minlength=len(routing.length))
    routing.start[:] = np.cumsum(routing.length) - routing.length
    size = int(np.count_nonzero(taken))
    routing.progress["top"] = size
    if size > routing.edge.shape[1]:
        routing = with_larger_pool(routing, 2 * size)
    routing.edge[0, :size] = edge[taken]
    return routing


def widened(rows: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """The same rows with room for ``size`` numbers in each."""
    wider = np.empty((len(rows), size), np.int32)
    wider[:, : rows.shape[1]] = rows
    return wider
