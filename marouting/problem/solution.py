"""A solution of a global routing problem, and how good it is, judged from the routes alone."""

import functools
import itertools
import os
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.files import check_suffix, suffix_of
from marouting.kernels import compiled
from marouting.problem import ispd
from marouting.problem.boxes import Boxes, boxes_of, edges_in_boxes
from marouting.problem.grid import AXES, OFF_GRID, VIA_AXIS, distinct, is_among
from marouting.problem.guides import Record, patches, read_record
from marouting.problem.net import FieldError
from marouting.problem.parts import MANY, joined_parts
from marouting.problem.problem import Problem, check_problem
from marouting.problem.reached import pins_reached
from marouting.problem.segments import (
    covered_edges,
    edges_between,
    longest_runs,
    longest_segments,
    with_pins_at,
)

RouteFormat = Literal["ispd2008", "guide", "patched-guide", "ispd2024"]
"""The formats of solutions (:meth:`Solution.write`)."""

ROUTE_FORMATS: tuple[RouteFormat, ...] = get_args(RouteFormat)

_BY_SUFFIX: dict[str, RouteFormat] = {".guide": "guide", ".pr_output": "ispd2024"}


@dataclass(frozen=True, eq=False, init=False)
class Solution:
    """The edges that every net uses.

    Args:
        problem: what is routed.
        edges: for each net an array of the numbers of its edges (:mod:`marouting.problem.grid`), in
            any order; repetitions count once.

    Attributes:
        problem: what is routed.
        uses: (uses,) int64 twice: net and edge of every use of an edge by a net; ordered by net,
            then edge, each pair once, read-only.

    Raises:
        InputError: there is not one array per net, or an edge does not exist on the grid.
    """

    problem: Problem
    uses: tuple[NDArray[np.int64], NDArray[np.int64]]

    def __init__(self, problem: Problem, edges: Sequence[NDArray[np.integer]]) -> None:
        nets = len(problem.nets)
        if len(edges) != nets:
            raise InputError(f"solution: expected the edges of {nets} nets, found {len(edges)}")
        given = [_edges_of(problem, net, own) for net, own in enumerate(edges)]
        net = np.repeat(np.arange(nets), [len(own) for own in given])
        edge = np.concatenate(given)
        # Computed for the given edges only: the grid's tables would take memory for every edge.
        near, axis = np.divmod(edge, AXES)
        limit = np.array(problem.grid)
        position = np.stack(np.unravel_index(near.clip(0, limit.prod() - 1), limit), axis=1)
        missing = (near < 0) | (near >= limit.prod())
        missing |= position[np.arange(len(edge)), axis] + 1 >= limit[axis]
        if missing.any():
            row = missing.argmax()
            raise InputError(
                f"solution, net {problem.nets[net[row]].name}: "
                f"expected edges of the grid, found {edge[row]}"
            )
        size = AXES * limit.prod()
        self._keep(problem, *np.divmod(distinct(net * size + edge), size))

    def _keep(self, problem: Problem, net: NDArray[np.int64], edge: NDArray[np.int64]) -> None:
        for column in (net, edge):
            column.setflags(write=False)
        object.__setattr__(self, "problem", problem)
        object.__setattr__(self, "uses", (net, edge))

    @classmethod
    def of_uses(
        cls, problem: Problem, net: NDArray[np.int64], edge: NDArray[np.int64]
    ) -> "Solution":
        """A solution from uses that are right, ordered by net, then edge: nothing is checked."""
        solution = object.__new__(cls)
        solution._keep(problem, net, edge)
        return solution

    def __eq__(self, other: object) -> bool:
        """Whether the other is a solution of an equal problem with the same edges."""
        if not isinstance(other, Solution):
            return NotImplemented
        return self.problem == other.problem and all(map(np.array_equal, self.uses, other.uses))

    @functools.cached_property
    def edges(self) -> tuple[NDArray[np.int64], ...]:
        """For each net the numbers of its edges, int64: sorted, each once, read-only."""
        net, edge = self.uses
        bounds = np.searchsorted(net, np.arange(len(self.problem.nets) + 1)).tolist()
        return tuple(edge[a:b] for a, b in itertools.pairwise(bounds))

    @functools.cached_property
    def used_edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(used edges,) int64 twice: the edges in use, ascending, and the tracks taken of each.

        A net takes max(its width, the layer's minimum width) + the layer's minimum spacing of every
        edge that it uses, once (:attr:`Problem.net_demand`), and nothing of a via.
        """
        return _used_edges(self.problem, self)

    @functools.cached_property
    def edge_demand(self) -> NDArray[np.int64]:
        """(E,) the tracks of :attr:`used_edges`; 0 for all other edges."""
        demand = np.zeros(self.problem.topology.edges, np.int64)
        edge, tracks = self.used_edges
        demand[edge] = tracks
        return demand

    def pruned(self) -> "Solution":
        """The solution without the edges that join nothing: dead ends, loops, parts without pins.

        In each connected part of a net's route, the shortest paths along the net's own edges from
        its first pin Gcell to the others are kept, always the same ones. All other edges are
        removed, and so are parts with fewer than two pin Gcells. What is left of a part is a tree
        that ends in pins: without any further edge it would join fewer of them. So ``connected``,
        ``joined`` and ``disconnected`` of its :func:`evaluate` are the same, and overflow,
        wirelength and vias are not higher. Time and memory are in proportion to the edges in use,
        but for one sort.

        Returns:
            Another solution of the same problem, or this one if no edge joins nothing.
        """
        return self._pruned(self._graph)

    @functools.cached_property
    def _graph(self) -> "_Graph":
        """The graph of the routes and the problem's pins."""
        first, pins = self.problem.flat_pin_gcells
        return _graph(self, np.repeat(np.arange(len(self.problem.nets)), np.diff(first)), pins)

    def _pruned(self, graph: "_Graph") -> "Solution":
        """:meth:`pruned` with the pins of a graph."""
        net, edge = self.uses
        ends, at_pins, part = graph
        size, kept = len(part), np.zeros(len(edge), np.bool_)
        if _are_trees(graph):
            return self
        order = np.argsort(ends.T.reshape(-1), kind="stable")
        first = np.searchsorted(ends.T.reshape(-1)[order], np.arange(size + 1))
        back, queue = np.full(size, _UNKNOWN), np.empty(size, np.int64)
        columns = (ends[0], ends[1], at_pins, first, order // 2, back, queue, kept)
        if len(edge) > MANY:
            _mark_ways(*columns)
        else:
            lists = [column.tolist() for column in columns]
            _mark_ways.py_func(*lists)
            kept = np.array(lists[-1])
        return Solution.of_uses(self.problem, net[kept], edge[kept])

    def at_reached_pins(self) -> "Solution":
        """The same routes for the problem with its pins where these routes reach them.

        A pin with shapes in several Gcells can be reached in any of them
        (:attr:`marouting.problem.chip.Chip.places`), and a problem has it in one. Routers join
        these; routes of others may end in other ones, and are judged rightly by this solution and
        its problem.

        Returns:
            A solution of a problem in which every pin is where the routes reach it, in the part of
            them that holds most pins of the net (:mod:`marouting.problem.reached`). This solution,
            if none moves.
        """
        gcell = pins_reached(self.problem, *self.uses)
        if gcell is self.problem.gcell_of_pins:
            return self
        return Solution.of_uses(with_pins_at(self.problem, gcell), *self.uses)

    @staticmethod
    def read(path: str | os.PathLike[str], problem: Problem) -> "Solution":
        """Reads routes: ISPD solution text, a guide, OpenROAD's segments or ISPD 2024's output.

        The file's first lines tell the format (:mod:`marouting.problem.ispd`). A net without a
        block is routed with no edges. An edge that a net lists several times counts once, with one
        ``UserWarning`` for the file. Segments of ISPD 2024's output whose second end is not beyond
        the first count as any other, with one ``UserWarning``; the contest has no such segments.

        Boxes, of which guides consist, say where a route may be. The solution has the shortest ways
        inside them (:meth:`pruned`), along the directions of the layers' wires.

        Args:
            path: the file.
            problem: what it solves; its origin and tile map points to Gcells, its chip boxes.
                Routes of nets that it keeps (:attr:`Problem.kept`) are passed over.

        Raises:
            InputError: the file cannot be read, is of none of these formats, or does not fit the
                problem; the message names the file, the line, and what was expected.
        """
        check_problem(problem)
        return Solution.of_record(read_record(path, problem), problem)

    @staticmethod
    def of_record(record: Record, problem: Problem) -> "Solution":
        """:meth:`read` for a file that :func:`marouting.problem.guides.read_record` has read."""
        if problem.kept is not None:
            whole, free = Solution.of_record(record, problem.kept.whole), problem.kept.free
            net, edge = whole.uses
            routed = is_among(net, free)
            return Solution.of_uses(problem, np.searchsorted(free, net[routed]), edge[routed])
        try:
            if isinstance(record, ispd.SolutionRecord):
                segment, edge = covered_edges(problem, record.points)
                _warn_of_other_grid(problem, record)
            elif len(record.boxes):
                boxes = Boxes(record.net, record.boxes[:, :4], record.boxes[:, 4])
                *uses, pins = edges_in_boxes(problem, boxes)
                region = Solution.of_uses(problem, *uses)
                return region._pruned(_graph(region, problem.net_of_pins, pins))
            elif len(record.points):
                segment, edge = _edges_of_points(problem, record)
            else:
                segment, edge = _edges_of_gcells(problem, record.segments)
                _warn_of_turned(problem, record)
        except FieldError as error:
            raise record.located(error) from None
        size = AXES * int(np.prod(problem.grid))
        uses, first = np.unique(record.net[segment] * size + edge, return_index=True)
        if repetitions := len(edge) - len(uses):
            repeated = np.ones(len(edge), np.bool_)
            repeated[first] = False
            at = segment[repeated.argmax()]
            warnings.warn(
                f"{record.file}:{record.lines['segments'][at]}: "
                f"net {problem.nets[record.net[at]].name} lists an edge twice; "
                f"{repetitions} repeated edges in this file are counted once",
                stacklevel=3,
            )
        return Solution.of_uses(problem, *np.divmod(uses, size))

    @property
    def whole(self) -> "Solution":
        """With the routes of nets that the problem keeps; this solution if there are none."""
        kept = self.problem.kept
        if kept is None:
            return self
        (net, edge), (kept_net, kept_edge) = self.uses, kept.uses
        owner = np.concatenate((kept.free[net], kept_net))
        edges = np.concatenate((edge, kept_edge))
        order = np.lexsort((edges, owner))
        return Solution.of_uses(kept.whole, owner[order], edges[order])

    def write(self, path: str | os.PathLike[str], format: RouteFormat | None = None) -> None:
        """Writes the routes, whole or not at all.

        - ``guide``, for a suffix ``.guide``: a routing guide as in the ISPD 2018 contest
          (:func:`marouting.problem.boxes.boxes_of`).
        - ``patched-guide``: the same with more room around pins and at crowded places
          (:func:`marouting.problem.guides.patches`).
        - ``ispd2024``, for a suffix ``.PR_output``: the output of the ISPD 2024 contest.
        - ``ispd2008``, for all others: ISPD solution text. Nets come in the problem's order, each
          as its longest straight segments between the centres of Gcells, ordered by their lower
          end.

        Nets that the problem keeps (:attr:`Problem.kept`) are written with their routes, and those
        of a guide with all that its boxes cover.

        Args:
            path: the file.
            format: one of these; None: as the file's suffix says.

        Raises:
            InputError: the format cannot hold the routes, the suffix is that of a format that is
                only read (``.def``, ``.lef``, ``.cap``, ``.net``, ``.segs``), or the file cannot
                be written.
        """
        check_suffix(path)
        format = format or _BY_SUFFIX.get(suffix_of(path), "ispd2008")
        whole, kept = self.whole, self.problem.kept
        problem, uses = whole.problem, whole.uses
        nets = problem.nets
        if format in ("guide", "patched-guide"):
            layers = problem.chip_or_default.layers
            reached = whole.at_reached_pins().problem
            more = [] if kept is None else [kept.room]
            if format == "patched-guide":
                more.append(patches(reached, uses, whole.used_edges))
            net, box, layer = boxes_of(reached, *uses, more)
            rows = [
                f"{left} {low} {right} {high} {layers[z]}"
                for left, low, right, high, z in zip(*box.T.tolist(), layer.tolist(), strict=True)
            ]
            ispd.write_routes(path, [net.name for net in nets], net, rows)
        elif format == "ispd2024":
            whole._check_directions(os.fspath(path))
            net, ends = longest_runs(problem, *uses)
            position = np.stack(np.unravel_index(ends, problem.grid), axis=-1)
            rows = [" ".join(map(str, row)) for row in position.reshape(-1, 6).tolist()]
            ispd.write_routes(path, [net.name for net in nets], net, rows)
        else:
            net, points = longest_segments(problem, *uses)
            ispd.write_solution(path, [(net.name, net.id) for net in nets], net, points)

    def _check_directions(self, path: str) -> None:
        """Raises InputError for a wire along an axis on which its layer has none."""
        chip = self.problem.chip_or_default
        net, edge = self.uses
        layer, axis = edge // AXES % self.problem.grid[2], edge % AXES
        wrong = (axis != VIA_AXIS) & ~chip.wires[layer, np.minimum(axis, 1)]
        if wrong.any():
            at = int(wrong.argmax())
            way = ("horizontal", "vertical")[axis[at]]
            raise InputError(
                f"{path}: the format ISPD 2024 cannot hold it: "
                f"net {self.problem.nets[net[at]].name}: expected no {way} wires in layer "
                f"{chip.layers[layer[at]]}; {np.count_nonzero(wrong)} edges are such wires"
            )


def _edges_of_gcells(
    problem: Problem, ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges of segments (n, 2, 3) in columns, rows and layers from 0, as covered_edges does."""
    inside = ((ends >= 0) & (ends < np.array(problem.grid))).all(axis=2)
    gcells = np.where(inside, ends @ problem.strides, OFF_GRID)
    columns, rows, layers = problem.grid
    extent = f"a Gcell of the {columns}x{rows}x{layers} grid, counted from 0"
    return edges_between(problem, gcells, ends, extent)


def _edges_of_points(
    problem: Problem, record: ispd.RoutesRecord
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The edges of a file's segments in chip coordinates, as covered_edges does."""
    chip = problem.chip_or_default
    borders: list[NDArray[Any]] = [chip.x, chip.y]
    if chip.contest is not None:
        # A .cap file says how far Gcells are apart but not where they begin; those of the ISPD 2025
        # contest are squares from (0, 0) on, as its evaluator takes them.
        sides = np.unique(np.concatenate((chip.contest.x_length, chip.contest.y_length)))
        if len(sides) != 1 or not sides[0] > 0:
            raise InputError(
                f"{record.file}: expected segments in columns and rows: coordinates need square "
                "Gcells of one size"
            )
        borders = [sides[0] * lines for lines in borders]
    ends = record.points.copy()
    for axis, lines in enumerate(borders):
        ends[..., axis] = np.searchsorted(lines, ends[..., axis], "right") - 1
    inside = ((ends >= 0) & (ends < np.array(problem.grid))).all(axis=2)
    gcells = np.where(inside, ends @ problem.strides, OFF_GRID)
    low, high = (tuple(int(lines[end]) for lines in borders) for end in (0, -1))
    extent = f"a point of the chip, from {low} to {high}"
    return edges_between(problem, gcells, record.points[..., :2], extent)


def _warn_of_other_grid(problem: Problem, record: ispd.SolutionRecord) -> None:
    """Warns if most ends of segments are no centers of a design's Gcells."""
    if problem.chip is None or not len(record.points):
        return
    tile = np.array(problem.tile)
    beside = (record.points[..., :2] - np.array(problem.origin)) % tile != tile // 2
    if (share := beside.any(axis=2).mean()) > 0.5:
        warnings.warn(
            f"{record.file}: {share:.0%} of the ends of segments are no centers of Gcells: the "
            "routes may be of a grid of another size (tile)",
            stacklevel=4,
        )


def _warn_of_turned(problem: Problem, record: ispd.RoutesRecord) -> None:
    """Warns of segments that the contest's evaluator rejects."""
    turned = np.flatnonzero((record.segments[:, 1] - record.segments[:, 0]).sum(axis=1) <= 0)
    if len(turned):
        warnings.warn(
            f"{record.file}:{record.lines['segments'][turned[0]]}: "
            f"net {problem.nets[record.net[turned[0]]].name}: expected a segment from its lower to "
            f"its higher end; the ISPD 2024 evaluator rejects such segments, {len(turned)} in this "
            "file; marouting accepts them",
            stacklevel=4,
        )


def _edges_of(problem: Problem, net: int, edges: object) -> NDArray[np.int64]:
    """The edges given for a net; raises InputError unless they are integers."""
    given = np.asarray(edges)
    if given.size and given.dtype.kind not in "iu":  # an empty list is an array of floats
        raise InputError(
            f"solution, net {problem.nets[net].name}: "
            f"expected whole numbers of edges, found {textwrap.shorten(str(edges), 80)}"
        )
    return given.astype(np.int64).reshape(-1)


@dataclass(frozen=True)
class Evaluation:
    """The quality of a solution: lower (overflow, wirelength) is better, compared in that order.

    Attributes:
        overflow: sum over the edges inside layers of max(0, demand − capacity), in tracks.
        max_overflow: the largest of these, in tracks.
        wirelength: sum over the nets of the number of edges used, a via counting 1.
        vias: how many of these edges are vias.
        connected: whether every net's route joins all its pins.
        joined: connections made between pins: for each net the number of its pin Gcells minus the
            number of connected parts that they are left in; summed over the nets.
        tasks: connections needed: for each net one less than its pin Gcells; summed over the nets.
            Pins that the routes reach in one Gcell count once.
        disconnected: the names of the nets whose route does not join all their pins.
    """

    overflow: int
    max_overflow: int
    wirelength: int
    vias: int
    connected: bool
    joined: int
    tasks: int
    disconnected: tuple[str, ...]


def evaluate(problem: Problem, solution: Solution) -> Evaluation:
    """Judges a solution by the rules of the ISPD 2008 contest's evaluator, which the paper uses.

    A pin with shapes in several Gcells may be reached in any of them
    (:meth:`Solution.at_reached_pins`).

    Args:
        problem: the problem whose capacities count; grid and nets must be those of the solution's.
        solution: the routes.

    Returns:
        Its quality.

    Raises:
        InputError: the solution belongs to a problem with another grid or other nets, or these are
            no problem and solution.
    """
    check_problem(problem)
    if not isinstance(solution, Solution):
        raise InputError(
            f"solution: expected a Solution, as Solution.read gives, found {solution!r}"
        )
    own = solution.problem
    if own is not problem and (own.grid, own.origin, own.tile, own.nets) != (
        problem.grid,
        problem.origin,
        problem.tile,
        problem.nets,
    ):
        raise InputError("solution: expected one of a problem with the same grid and nets")
    # Looked up for the edges in use only: a file may promise a grid far larger than its routes.
    used, tracks = solution.used_edges if own is problem else _used_edges(problem, solution)
    overflow = np.maximum(tracks - problem.capacity_of(used), 0)
    _, edge = solution.uses
    judged = solution.at_reached_pins()
    bounds = judged.problem.flat_pin_gcells[0]
    first = bounds[:-1]
    pin_net = np.repeat(np.arange(len(first)), np.diff(bounds))
    pin_part = judged._graph.part[judged._graph.pins]
    disconnected = distinct(pin_net[pin_part != pin_part[first][pin_net]])
    return Evaluation(
        overflow=int(overflow.sum()),
        max_overflow=int(overflow.max(initial=0)),
        wirelength=len(edge),
        vias=int(np.count_nonzero(edge - edge // AXES * AXES == VIA_AXIS)),
        connected=not len(disconnected),
        joined=len(pin_net) - len(distinct(pin_part)),
        tasks=len(pin_net) - len(problem.nets),
        disconnected=tuple(problem.nets[net].name for net in disconnected),
    )


def _used_edges(
    problem: Problem, solution: Solution
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """:attr:`Solution.used_edges`, but with the widths and spacings of ``problem``."""
    net, edge = solution.uses
    gcell = edge // AXES
    tracks = problem.net_demand[net, gcell % problem.grid[2]].astype(np.int64)
    tracks[edge - AXES * gcell == VIA_AXIS] = 0
    order = np.argsort(edge, kind="stable")
    used, first = np.unique(edge[order], return_index=True)
    return used, np.add.reduceat(tracks[order], first) if len(first) else tracks


class _Graph(NamedTuple):
    """One graph that holds the routes of all nets, and pins.

    Its vertices are pairs of a net and a Gcell where the net has a pin or an edge, in this order.
    """

    ends: NDArray[np.int64]  # (2, uses) the vertices at the near and the far end of every use
    pins: NDArray[np.int64]  # (pins,) those of the pins
    part: NDArray[np.int64]  # (vertices,) the lowest vertex that each is connected to


def _graph(solution: Solution, pin_net: NDArray[np.int64], pins: NDArray[np.int64]) -> _Graph:
    """The graph of a solution and of pins in Gcells (pins,) of nets (pins,)."""
    net, edge = solution.uses
    topology = solution.problem.topology
    near, far = topology.ends(edge)
    pairs = np.concatenate((net, net, pin_net)) * topology.gcells
    pairs += np.concatenate((near, far, pins))
    vertices, index = np.unique(pairs, return_inverse=True)
    ends = index[: 2 * len(edge)].reshape(2, -1)
    return _Graph(ends, index[2 * len(edge) :], joined_parts(ends[0], ends[1], len(vertices)))


def _are_trees(graph: _Graph) -> bool:
    """Whether all parts of a graph are trees that end in pins."""
    size = len(graph.part)
    leaf = np.bincount(graph.ends.reshape(-1), minlength=size) == 1
    leaf[graph.pins] = False
    parts = np.count_nonzero(graph.part == np.arange(size))
    return not leaf.any() and graph.ends.shape[1] == size - parts


_UNKNOWN, _BEGINS = -2, -1


@compiled
def _mark_ways(
    near: Any, far: Any, pins: Any, first: Any, at: Any, back: Any, queue: Any, kept: Any
) -> None:
    """Marks the edges on the shortest ways from pins to other pins of the same connected part.

    ``at[first[v] : first[v + 1]]`` are the edges at vertex v, and ``back[v]`` will be the one by
    which it was found, on the way to where its part begins.
    """
    for pin in pins:
        if back[pin] == _UNKNOWN:
            back[pin], queue[0] = _BEGINS, pin
            done, found = 0, 1
            while done < found:
                vertex = queue[done]
                done += 1
                for place in range(first[vertex], first[vertex + 1]):
                    use = at[place]
                    other = near[use] + far[use] - vertex
                    if back[other] == _UNKNOWN:
                        back[other], queue[found] = use, other
                        found += 1
        vertex = pin
        while back[vertex] != _BEGINS and not kept[back[vertex]]:
            use = back[vertex]
            kept[use] = True
            vertex = near[use] + far[use] - vertex
