"""Problem sets as the paper's generator makes them (section "Problem Sets Generator").

Layers alternate: layer 1 has capacity along x, layer 2 along y, and so on; a single layer has both.
Pins lie in layer 1. Some edges then get a reduced capacity: those that the solutions of sequential
A* use most, in each problem by itself or in the whole set.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from marouting.checks import check_fields
from marouting.config import check
from marouting.errors import InputError
from marouting.memory import ADJUSTMENT, NET, PIN, check_memory
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.net import MAX_NUMBER, Adjustment, Net, Pin
from marouting.problem.problem import UNLIMITED, Problem, check_choice, check_grid
from marouting.search.astar import sequential_astar

TILE = 10  # width and height of a Gcell in chip coordinates, as in the authors' published problems
REDUCTION = 2  # by how much capacity is reduced by default: the authors' 5 becomes 3
_MACRO = 10  # the fewest columns and rows on which there is room for macros
_FREE_LAYERS = 2  # how many of the highest layers macros leave free
ReducedPer = Literal["problem", "set"]  # whose A* solutions decide which edges are reduced


@dataclass(frozen=True, kw_only=True)
class Least:
    """The smallest problems of a generator whose problems differ in size.

    Attributes:
        grid: columns, rows and layers of Gcells that can be used.
        nets: nets per problem, if it uses the whole grid.
        max_pins: the most pins of a net.
        capacity: tracks of an edge.
    """

    grid: tuple[int, int, int] = (4, 4, 1)
    nets: int = 1
    max_pins: int = 2
    capacity: int = 1

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class GeneratorOptions:
    """The arguments of :func:`generate`, checked.

    Attributes:
        count: number of problems.
        grid: columns, rows and layers of Gcells.
        nets: nets per problem.
        max_pins: pins per net, drawn uniformly from 2…max_pins.
        capacity: capacity, in tracks, of an edge along its layer's direction.
        reduced_edges: number of edges with reduced capacity, those that sequential A* uses most.
            Where the grid has fewer edges, all are reduced.
        reduced_capacity: capacity of these edges, at most that of all; None: ``capacity`` − 2, but
            at least 0.
        reduced_per: ``problem``: each problem has its own edges reduced; ``set``: all problems have
            the same edges reduced, those most used in all of them together, as in the authors'
            published sets.
        seed: seed of the random numbers, from 0; None: different ones every time, in an environment
            a new problem at every reset.
        least: the smallest problems. The size of each problem is then drawn between ``least`` and
            the size above: the reciprocals of columns and rows uniformly, since larger problems
            have more moves, and all else uniformly. A smaller problem uses a part of the grid;
            edges outside of it have no capacity. Its number of nets is proportional to the
            geometric mean of its columns and rows, so that all sizes are equally congested.
            None: all problems have the size above.
        rent: Rent's exponent, 0 to 1; 0.6 to 0.75 are usual for logic. It makes nets local, as on
            chips: the probability of a distance l between a net's first pin and another is
            proportional to l^(2 rent − 3) (Cotter and Christie, "The analytical form of the length
            distribution function for computer interconnection", IEEE Transactions on Circuits and
            Systems 38(3), 1991). Of the Gcells at a distance, the two in the same row are twice as
            likely as the others. None: pins are uniformly distributed.
        macros: number of blockages: rectangles of up to a fifth of the columns and rows that have
            capacity in the two highest layers only, and no pins.
        hot_spots: number of centres around which half of the nets begin, normally distributed with
            a standard deviation of a sixteenth of the columns and rows. A net that would begin off
            the grid is drawn again, perhaps elsewhere: a third of the nets begin around a centre
            at the border.

    Raises:
        InputError: a value is out of range.
    """

    count: int = 1
    grid: tuple[int, int, int] = (8, 8, 2)
    nets: int = 50
    max_pins: int = 2
    capacity: int = 5
    reduced_edges: int = 3
    reduced_capacity: int | None = None
    reduced_per: ReducedPer = "problem"
    seed: int | None = 0
    least: Least | None = None
    rent: float | None = None
    macros: int = 0
    hot_spots: int = 0

    def __post_init__(self) -> None:
        counted = dict.fromkeys(("count", "nets"), (1, MAX_NUMBER))
        many = ("capacity", "reduced_edges", "reduced_capacity", "macros", "hot_spots")
        counted |= dict.fromkeys(many, (0, MAX_NUMBER))
        check_fields(self, max_pins=(2, MAX_NUMBER), seed=(0, math.inf), rent=(0, 1), **counted)
        check_grid(self.grid)
        if self.grid[0] * self.grid[1] < 2:
            raise InputError(
                f"grid {self.grid}: expected at least two Gcells in layer 1, for a net to span"
            )
        if self.macros and (min(self.grid[:2]) < _MACRO or self.grid[2] < _FREE_LAYERS + 1):
            raise InputError(
                f"macros: expected 0 on a grid of {self.grid}: they need {_MACRO} columns and rows "
                f"and {_FREE_LAYERS + 1} layers"
            )
        if self.reduced_capacity is not None:
            what = f"at most the capacity, {self.capacity}, found {self.reduced_capacity}"
            check("reduced_capacity", self.reduced_capacity <= self.capacity, what)
        if self.least is not None:
            self._check_least(self.least)

    def _check_least(self, least: Least) -> None:
        """Raises InputError unless all problems from ``least`` up to these options can be made."""
        check_choice("least: reduced_per", self.reduced_per, Literal["problem"])
        if any(not 1 <= a <= b for a, b in zip(least.grid, self.grid, strict=True)):
            raise InputError(f"least.grid: expected 1 to {self.grid}, found {least.grid}")
        try:
            _ = replace(self, least=None, **vars(least))
        except InputError as error:
            raise InputError(f"least.{error}") from None
        for name in ("nets", "max_pins", "capacity"):
            low, high = getattr(least, name), getattr(self, name)
            if low > high:
                raise InputError(f"least.{name}: expected at most {high}, found {low}")


def generate(
    count: int = 1,
    grid: tuple[int, int, int] = (8, 8, 2),
    nets: int = 50,
    max_pins: int = 2,
    capacity: int = 5,
    reduced_edges: int = 3,
    seed: int | None = 0,
    **options: Any,
) -> list[Problem]:
    """Generates problems; the same arguments give the same problems.

    Every net spans at least two Gcells. The nets of problem i do not depend on the count. The
    arguments are the attributes of :class:`GeneratorOptions`, where they are explained; ``options``
    are its other ones.

    Returns:
        The problems, ``count`` of them.

    Raises:
        InputError: a value is out of range, or the problems take too much memory.
    """
    return generate_from(
        GeneratorOptions(
            count=count,
            grid=grid,
            nets=nets,
            max_pins=max_pins,
            capacity=capacity,
            reduced_edges=reduced_edges,
            seed=seed,
            **options,
        )
    )


def generate_from(options: GeneratorOptions) -> list[Problem]:
    """:func:`generate` with its arguments in one object."""
    check_memory(options.count * _size(options), "count: {} problems", options.count)
    return list(generate_each(options))


def generate_each(options: GeneratorOptions) -> Iterator[Problem]:
    """The problems of :func:`generate_from`, generated one by one.

    Raises:
        InputError: a single problem takes too much memory.
    """
    check_memory(_size(options), "nets: a problem of {}", options.nets)
    return _each(options)


def _each(options: GeneratorOptions) -> Iterator[Problem]:
    """See :func:`generate_each`, which checks before the first of them is asked for."""
    if options.least is not None:
        yield from _of_many_sizes(options, options.least)
        return
    capacity = options.reduced_capacity
    if capacity is None:
        capacity = max(options.capacity - REDUCTION, 0)
    seed = np.random.SeedSequence(options.seed)

    def unreduced() -> Iterator[Problem]:
        for number in range(options.count):
            # The children of seed.spawn(count), without a list of all of them.
            stream = np.random.SeedSequence(seed.entropy, spawn_key=(number,))
            yield _unreduced(options, np.random.default_rng(stream))

    if not options.reduced_edges:
        yield from unreduced()
    elif options.reduced_per == "problem":
        for problem in unreduced():
            adjustments = _reduced([problem], options.reduced_edges, capacity)
            yield replace(problem, adjustments=adjustments)
    else:  # each problem is made twice, so that no two need be kept at a time
        adjustments = _reduced(unreduced(), options.reduced_edges, capacity)
        for problem in unreduced():
            yield replace(problem, adjustments=adjustments)


def _of_many_sizes(options: GeneratorOptions, least: Least) -> Iterator[Problem]:
    """The problems of a generator whose problems differ in size."""
    seed = np.random.SeedSequence(options.seed)
    for number in range(options.count):
        stream = np.random.SeedSequence(seed.entropy, spawn_key=(number,))
        rng = np.random.default_rng(stream)
        low = [least.grid[2], least.nets, least.max_pins, least.capacity]
        high = [options.grid[2], options.nets, options.max_pins, options.capacity]
        layers, nets, max_pins, capacity = rng.integers(low, np.add(high, 1)).tolist()
        fewest, most = np.array(least.grid[:2]), np.array(options.grid[:2])
        sides = 1 / rng.uniform(1 / (most + 1), 1 / fewest)
        columns, rows = np.clip(sides.astype(int), fewest, most).tolist()
        part = columns, rows, layers
        # Nets of a part are shorter, in proportion to its sides, and it has fewer edges.
        share = math.sqrt(columns * rows / (options.grid[0] * options.grid[1]))
        inner = replace(
            options,
            count=1,
            grid=part,
            nets=max(round(nets * share), 1),
            max_pins=max_pins,
            capacity=capacity,
            seed=int(rng.integers(MAX_NUMBER)),
            least=None,
        )
        yield _within(next(_each(inner)), options.grid)


def _within(problem: Problem, grid: tuple[int, int, int]) -> Problem:
    """A problem in the corner of a larger grid whose other edges have no capacity."""
    more = grid[2] - problem.grid[2]
    whole = replace(
        problem,
        grid=grid,
        vertical_capacity=(*problem.vertical_capacity, *[0] * more),
        horizontal_capacity=(*problem.horizontal_capacity, *[0] * more),
        min_width=(*problem.min_width, *[1] * more),
        min_spacing=(*problem.min_spacing, *[0] * more),
        via_spacing=(*problem.via_spacing, *[0] * more),
    )
    outside = np.ones(grid[:2], np.bool_)
    outside[: problem.grid[0], : problem.grid[1]] = False
    return _without(whole, outside, grid[2])


def _size(options: GeneratorOptions) -> float:
    """About what a problem takes in memory, in bytes."""
    pins = (2 + options.max_pins) / 2
    most = AXES * math.prod(options.grid)
    edges = most if options.least else min(options.reduced_edges, most)
    return options.nets * (NET + PIN * pins) + ADJUSTMENT * edges


def _unreduced(options: GeneratorOptions, rng: np.random.Generator) -> Problem:
    """A problem without reduced edges."""
    layers = np.arange(options.grid[2])
    macros = _macros(options, rng)
    if options.grid[2] == 1:
        along_x = along_y = np.array([options.capacity])  # a single layer takes both directions
    else:
        along_x = np.where(layers % 2 == 0, options.capacity, 0)
        along_y = np.where(layers % 2 == 1, options.capacity, 0)
    problem = Problem(
        grid=options.grid,
        vertical_capacity=tuple(along_y.tolist()),
        horizontal_capacity=tuple(along_x.tolist()),
        nets=_nets(options, rng, macros),
        min_width=(1,) * options.grid[2],
        min_spacing=(0,) * options.grid[2],
        via_spacing=(0,) * options.grid[2],
        tile=(TILE, TILE),
    )
    if not options.macros:
        return problem
    return _without(problem, macros, options.grid[2] - _FREE_LAYERS)


def _without(problem: Problem, closed: NDArray[np.bool_], layers: int) -> Problem:
    """A problem without capacity at some Gcells in its lowest layers."""
    none = np.zeros((*problem.grid, AXES), np.bool_)
    for axis in range(VIA_AXIS):
        none[:, :, :layers, axis] = (closed | np.roll(closed, -1, axis))[..., None]
    within = (problem.capacity > 0) & (problem.capacity < UNLIMITED)
    closed_edges = np.flatnonzero(none.reshape(-1) & within)
    return replace(problem, adjustments=problem.adjustments + _adjusted(problem, closed_edges, 0))


def _macros(options: GeneratorOptions, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(X, Y) whether Gcells are in macros."""
    sides = np.array(options.grid[:2])
    inside = np.zeros(sides, np.bool_)
    for _ in range(options.macros):
        size = rng.integers(1, sides // 5 + 1)
        x, y = rng.integers(0, sides - size + 1)
        inside[x : x + size[0], y : y + size[1]] = True
    return inside


def _reduced(problems: Iterable[Problem], edges: int, capacity: int) -> tuple[Adjustment, ...]:
    """A capacity for the edges that the A* solutions of these problems together use most."""
    demand: Any = 0
    for problem in problems:
        demand = demand + sequential_astar(problem).edge_demand
    # All have the same grid and capacities. Vias have unlimited capacity, edges across their
    # layer's direction have none.
    reducible = np.flatnonzero((problem.capacity > 0) & (problem.capacity < UNLIMITED))
    busiest = np.argsort(-demand[reducible], kind="stable")[:edges]
    return _adjusted(problem, reducible[busiest], capacity)


def _adjusted(
    problem: Problem, edges: NDArray[np.integer], capacity: int
) -> tuple[Adjustment, ...]:
    """The capacity adjustments of edges; their layers count from 1."""
    position = problem.topology.position + np.array([0, 0, 1])
    ends = (position[end].tolist() for end in problem.topology.ends(edges))
    return tuple(Adjustment._make((*a, *b, capacity)) for a, b in zip(*ends, strict=True))


def _nets(
    options: GeneratorOptions, rng: np.random.Generator, macros: NDArray[np.bool_]
) -> tuple[Net, ...]:
    """The nets of a problem: pins lie in layer 1 outside of macros, in two Gcells or more."""
    sides = np.array(options.grid[:2])
    spots = rng.integers(sides, size=(options.hot_spots, 2))
    # How often each distance is drawn; pins off the grid are drawn again.
    lengths = np.arange(1, int(sides.sum()) - 1)
    chances = np.cumsum(lengths ** (2.0 * options.rent - 3)) if options.rent is not None else None
    most = 300 * max(options.max_pins, 100)  # draws for a net, many more than nets with room take

    def first() -> NDArray[np.integer]:
        if options.hot_spots and rng.random() < 0.5:
            spot = spots[rng.integers(len(spots))]
            return np.floor(rng.normal(spot, sides / 16)).astype(int)
        return rng.integers(sides)

    def pins(draws: Iterator[int]) -> NDArray[np.integer] | None:
        """(K, 2) chip coordinates of the pins of a net; None if these draws give none."""
        if options.rent is None and not (options.macros or options.hot_spots):
            return rng.integers(TILE * sides, size=(rng.integers(2, options.max_pins + 1), 2))
        found = [first()]
        count = rng.integers(2, options.max_pins + 1)
        off = (np.maximum(-found[0], 0) + np.maximum(found[0] - sides + 1, 0)).sum()
        if chances is not None and off > lengths[-1]:
            return None
        while len(found) < count:
            if chances is None:
                found.append(rng.integers(sides))
                continue
            if next(draws, None) is None:
                return None
            far = lengths[np.searchsorted(chances, rng.random() * chances[-1])]
            across = rng.integers(-far, far + 1)
            away = np.array([across, (far - abs(across)) * (2 * rng.integers(2) - 1)])
            if ((found[0] + away >= 0) & (found[0] + away < sides)).all():
                found.append(found[0] + away)
        return TILE * np.array(found) + rng.integers(TILE, size=(len(found), 2))

    def net(index: int) -> Net:
        draws = iter(range(most))
        for _ in draws:
            if (at := pins(draws)) is None:
                continue
            gcells = at // TILE
            if (gcells < 0).any() or (gcells >= sides).any() or macros[tuple(gcells.T)].any():
                continue
            if (gcells != gcells[0]).any():
                place = tuple(Pin(int(x), int(y), 1) for x, y in at)
                return Net(f"A{index + 1}", index + 1, place)
        name = "macros" if options.macros else "hot_spots"
        what = "Gcells on the grid and outside of macros for all pins, found none for those of net"
        raise InputError(f"{name}: expected {what} {index + 1} in {most} draws")

    return tuple(map(net, range(options.nets)))
