"""The cost by which the ISPD 2024 contest judges routes."""

import sys
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.problem.chip import Contest, Places
from marouting.problem.grid import AXES, VIA_AXIS, distinct, is_among, neighbours
from marouting.problem.parts import joined_parts
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution

SLOPE = 0.5  # of the exponential in the cost of overflow
WITHOUT = 1.5
"""What half a track of demand weighs, in tracks of overflow, where there is no capacity."""

_LEAST = 0.001  # what is less is no capacity


@dataclass(frozen=True)
class ContestCost:
    """The cost of a solution by the rules of the ISPD 2024 contest; less is better.

    Attributes:
        total: the sum of the three parts.
        wirelength: of the wires, by their length.
        vias: of the vias.
        overflow: over all Gcells of all layers with wires, used or not, the layer's cost times
            exp(SLOPE · (demand - capacity)).
        open: names of the nets that the contest takes for open: a pin that no wire or via of the
            net's reaches, parts that do not touch, or a wire that its layer cannot have. Nets that
            a file of routes lacks are among them if they have several pins; the evaluator counts
            those, and such of one pin, only among its incompleted nets.
    """

    total: float
    wirelength: float
    vias: float
    overflow: float
    open: tuple[str, ...]


def contest_of(problem: Problem) -> Contest:
    """The contest's costs of a problem; raises InputError for one that is none of its."""
    if problem.chip is None or problem.chip.contest is None:
        raise InputError("problem: expected one of the ISPD 2024 contest, from a .cap file")
    return problem.chip.contest


def contest_cost(solution: Solution) -> ContestCost:
    """Judges a solution as the contest's evaluator does.

    In tracks, a wire takes 1 of the edge that it crosses. A via takes a half of each of the two
    edges beside its lower Gcell, or 1 of the only one, unless a wire of the net ends there or
    passes: so a stack of vias costs capacity in every layer that it only passes. An edge's demand
    and capacity are those of its lower Gcell. An edge that a net lists several times counts once
    here, and each time in the contest. Nets that the problem keeps count with their routes.
    """
    solution = solution.whole
    problem = solution.problem
    contest = contest_of(problem)
    uses = uses_of(solution)
    wirelength = sum(
        float(length @ uses.wires[..., contest.axis == a].sum(axis=(1 - a, 2))[:-1])
        for a, length in enumerate((contest.x_length, contest.y_length))
    )
    over = np.where(
        contest.capacity > _LEAST,
        uses.half_tracks / 2 - contest.capacity,
        np.where(uses.half_tracks > 0, WITHOUT * uses.half_tracks, -np.inf),
    )
    with np.errstate(over="ignore"):
        by_layer = np.exp(SLOPE * over[..., 1:]).sum(axis=(0, 1))
        overflow = float(by_layer @ contest.overflow_cost[1:])
    parts = (
        wirelength * contest.wire_cost,
        len(uses.via) * contest.via_cost,
        min(overflow, sys.float_info.max / 4),
    )
    open_nets = np.union1d(uses.refused, _open_nets(problem, uses.wired, uses.via))
    names = tuple(problem.nets[index].name for index in open_nets.tolist())
    return ContestCost(sum(parts), *parts, names)


def with_pins_covered(solution: Solution) -> Solution:
    """The solution with a via at each pin of nets that have several pins and no edges.

    The contest counts a net as open unless a wire or via of its own reaches every pin, also where
    all pins lie in one Gcell.
    """
    problem = solution.problem
    first = _places_of(problem).first_pin
    net, edge = solution.uses
    without = np.setdiff1d(np.flatnonzero(np.diff(first) > 1), net)
    start, gcell = problem.flat_pin_gcells
    without = without[np.diff(start)[without] == 1]
    layers = problem.grid[2]
    if layers < 2 or not len(without):
        return solution
    pin = gcell[start[without]]
    below = np.where(pin % layers + 1 < layers, pin, pin - 1)
    nets, edges = np.append(net, without), np.append(edge, AXES * below + VIA_AXIS)
    order = np.lexsort((edges, nets))
    return Solution.of_uses(problem, nets[order], edges[order])


def usable(capacity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Capacities, and 0 where there is too little to count."""
    return np.where(capacity > _LEAST, capacity, 0.0)


class Uses(NamedTuple):
    """What a solution uses, by the contest's rules. An edge along a layer is its lower Gcell's.

    Attributes:
        wires: (X, Y, Z) nets with a wire on each edge, where the layer can have it.
        half_tracks: (X, Y, Z) demand of each edge, in half tracks.
        wired: net · Gcells + Gcell for both ends of each of these wires.
        via: net · Gcells + Gcell for the lower end of each via.
        refused: nets with wires that their layer cannot have.
    """

    wires: NDArray[np.int64]
    half_tracks: NDArray[np.int64]
    wired: NDArray[np.int64]
    via: NDArray[np.int64]
    refused: NDArray[np.int64]


def uses_of(solution: Solution) -> Uses:
    """What a solution uses; raises InputError for a problem that is none of the contest."""
    problem, (net, edge) = solution.problem, solution.uses
    contest = contest_of(problem)
    assert problem.chip is not None
    size = int(np.prod(problem.grid))
    near, axis = edge // AXES, edge % AXES
    allowed = problem.chip.wires[near % problem.grid[2], np.minimum(axis, 1)]
    inside = axis != VIA_AXIS
    wire, own = inside & allowed, net * size + near
    wired = np.concatenate((own[wire], (own + problem.strides[axis])[wire]))
    via = own[~inside]
    wires = np.bincount(near[wire], minlength=size).reshape(problem.grid)
    stacked = via[~is_among(via, distinct(wired))] % size
    return Uses(
        wires=wires,
        half_tracks=2 * wires + _via_demand(problem, contest, stacked),
        wired=wired,
        via=via,
        refused=np.unique(net[inside & ~allowed]),
    )


def _via_demand(
    problem: Problem, contest: Contest, stacked: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(X, Y, Z) half tracks that stacked vias take; ``stacked`` are Gcells, with repetitions."""
    demand = np.zeros(problem.grid, np.int64)
    position = np.stack(np.unravel_index(stacked, problem.grid), axis=1)
    for a in (0, 1):
        own = position[contest.axis[position[:, 2]] == a]
        before, last = own.copy(), problem.grid[a] - 1
        if last == 0:
            continue
        before[:, a] -= 1
        at = own[:, a]
        # Along the layer, a Gcell at the border has one edge, which takes it all.
        np.add.at(demand, tuple(before[at > 0].T), np.where(at[at > 0] == last, 2, 1))
        np.add.at(demand, tuple(own[at < last].T), np.where(at[at < last] == 0, 2, 1))
    return demand


def _open_nets(
    problem: Problem, wired: NDArray[np.int64], via: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(open,) the nets whose pins are not joined.

    Neighbouring Gcells of one net are joined if wires or vias of it lie in both, whether or not an
    edge of it joins them.
    """
    assert problem.chip is not None
    size = int(np.prod(problem.grid))
    covered = distinct(np.concatenate((wired, via, via + 1)))
    ends = []
    for axis in range(AXES):
        pairs = np.stack(neighbours(problem.grid, covered, axis))
        if axis != VIA_AXIS:
            layer = covered[pairs[0]] % problem.grid[2]
            pairs = pairs[:, problem.chip.wires[layer, axis]]
        ends.append(pairs)
    near, far = np.concatenate(ends, axis=1)
    part = joined_parts(near, far, len(covered))
    places = _places_of(problem)
    pins = len(places.first) - 1
    pin = np.repeat(np.arange(pins), np.diff(places.first))
    net = np.repeat(np.arange(len(problem.nets)), np.diff(places.first_pin))
    reached = net[pin] * size + places.gcell
    at = np.searchsorted(covered, reached)
    touched = is_among(reached, covered)
    begins = np.zeros(len(covered), np.bool_)  # parts that a net's first pin lies in
    begins[part[at[touched & (places.first_pin[net[pin]] == pin)]]] = True
    joined = np.zeros(pins, np.bool_)
    joined[places.first_pin[:-1]] = True
    touched[touched] = begins[part[at[touched]]]
    joined[pin[touched]] = True
    return distinct(net[~joined])


def _places_of(problem: Problem) -> Places:
    """The places of the pins of a problem of the contest, which has some."""
    assert problem.chip is not None
    assert problem.chip.places is not None
    return problem.chip.places
