"""Controls of a chip's problem: layers, less capacity, and nets that stay as they are.

A problem is adjusted once, after it is read. The game, all routers and ``evaluate`` then see the
adjusted problem and need to know nothing else:

* A layer outside of all **ranges of layers** has no capacity. Where nets have different ranges, a
  net has a width in the layers that it must leave free that exceeds the capacity of every edge
  there: a wire in one is overflow. Vias lead through all layers, so pins outside the range are
  reached.
* **Derating** multiplies capacities of layers and of areas, and rounds down.
* Nets that are **kept** leave the problem, and capacities lack what their routes take. Solutions
  are written with them (:class:`marouting.problem.problem.Kept`).
"""

import os
import re
from collections.abc import Collection
from dataclasses import dataclass, field, fields, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.checks import check_fields
from marouting.config import check
from marouting.errors import InputError, nearest
from marouting.files import beside, stem_of, suffix_of
from marouting.problem.chip import Chip, Contest, as_adjustments
from marouting.problem.grid import AXES, VIA_AXIS, distinct
from marouting.problem.guides import gcells_in_boxes, has_boxes, read_record
from marouting.problem.net import MAX_NUMBER, Adjustment
from marouting.problem.problem import Kept, Problem, check_problem
from marouting.problem.solution import Solution, evaluate


@dataclass(frozen=True, kw_only=True)
class Area:
    """A rectangle of Gcells in which edges have less capacity.

    Attributes:
        columns: the first and the last column, from 0.
        rows: the first and the last row, from 0.
        factor: by which the capacity of edges at its Gcells is multiplied, 0 to 1.
        layers: in which layers, as in :class:`Controls`; None: in all.
    """

    columns: tuple[int, int]
    rows: tuple[int, int]
    factor: float
    layers: str | int | None = None

    def __post_init__(self) -> None:
        check_fields(self, factor=(0, 1))


@dataclass(frozen=True, kw_only=True)
class Controls:
    """How a problem is adjusted.

    Layers are given as a number from 1, a name, or a range of them, both ends included: ``3``,
    ``met3``, ``2..6``, ``met1..met5``, ``2..``. Nets are given as a name or a list of names, which
    may hold ``*`` and ``?``.

    Attributes:
        layers: the layers of wires; None: all, but for the layer that holds only pins of a LEF/DEF
            design.
        clock_layers: the layers of the wires of clock nets, which are those with USE CLOCK in a DEF
            file and those that ``clock_nets`` names; None: as ``layers``.
        clock_nets: names of clock nets.
        long_layers: the layers of the wires of long nets; None: as ``layers``.
        long_nets: half the perimeter of the pins' bounding box, in Gcells, from which a net is
            long.
        derate: factors from 0 to 1 by layers, such as ``{met1: 0.8, 3..4: 0.9}``, by which capacity
            is multiplied.
        areas: the same in rectangles of Gcells (:class:`Area`).
        keep: a file of routes or a guide; the nets that it routes stay as they are. Those of a
            guide take the tracks of the shortest routes inside it, and guides are written with all
            of it. None: none do.
        keep_nets: names of nets of that file that stay; empty: all do.

    Raises:
        InputError: a value is none of its field's.
    """

    layers: str | int | None = None
    clock_layers: str | int | None = None
    clock_nets: tuple[str, ...] | str = ()
    long_layers: str | int | None = None
    long_nets: int | None = None
    derate: dict[str, float] = field(default_factory=dict)
    areas: tuple[Area, ...] = ()
    keep: str | None = None
    keep_nets: tuple[str, ...] | str = ()

    def __post_init__(self) -> None:
        # Not those of a subclass: paths need not be UTF-8, as the text of a configuration is.
        check_fields(self, Controls, long_nets=(1, 2**31 - 1))
        for layers, factor in self.derate.items():
            check(f"derate.{layers}", 0 <= factor <= 1, f"a number from 0 to 1, found {factor}")
        long_layers, long_nets = self.long_layers is not None, self.long_nets is not None
        check("long_layers", long_nets or not long_layers, "long_nets beside it, from what length")
        check("long_nets", long_layers or not long_nets, "long_layers beside it, a range of layers")
        check("clock_nets", not self.clock_nets or self.clock_layers, "clock_layers beside them")
        check("keep_nets", not self.keep_nets or self.keep, "keep beside them, a file of routes")


@dataclass(frozen=True, kw_only=True)
class ProblemFile(Controls):
    """A problem in a file, and how it is adjusted after it is read.

    Attributes:
        path: the file.
        lef: the LEF files of a ``.def`` file, technology first; empty: the one beside it.
        tile: width and height of a Gcell of a ``.def`` file; None: as its GCELLGRID says.
        net: the ``.net`` file of a ``.cap`` file; None: the one beside it.
    """

    path: str
    lef: tuple[str, ...] = ()
    tile: tuple[int, int] | None = None
    net: str | None = None

    @property
    def stem(self) -> str:
        """The problem's name."""
        return stem_of(self.path)

    @property
    def files(self) -> list[str]:
        """All files that the problem is read from."""
        suffix, found = suffix_of(self.path), [self.path, *self.lef]
        if suffix == ".def" and not self.lef:
            found.append(os.fspath(beside(self.path, ".lef")))
        if suffix == ".cap":
            found.append(self.net or os.fspath(beside(self.path, ".net")))
        return found if self.keep is None else [*found, self.keep]

    def read(self) -> Problem:
        """The adjusted problem; raises InputError if it cannot be read or adjusted so."""
        wires = self.layers is not None
        problem = Problem.read(
            self.path, lef=self.lef, tile=self.tile, net=self.net, pin_layer_wires=wires
        )
        try:
            return adjusted(problem, self)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None


_NONE = Controls()
"""Controls that change nothing."""


def adjusted(problem: Problem, controls: Controls) -> Problem:
    """A problem as controls adjust it; this one, if they say nothing.

    Args:
        problem: as it was read. Its contest's cost, if it has one, stays that of its files.
        controls: how to adjust it.

    Returns:
        A problem on the same grid, with fewer nets if some are kept.

    Raises:
        InputError: a layer, a net or an area does not exist, a range of layers has wires along one
            axis only, or kept routes cannot be read or do not join their pins. The message names
            the control. Or the problem has nets that stay already.
    """
    check_problem(problem)
    check("controls", isinstance(controls, Controls), f"Controls, found {controls!r}")
    if all(getattr(controls, own.name) == getattr(_NONE, own.name) for own in fields(_NONE)):
        return problem
    what = "a problem without nets that stay: give all controls at once"
    check("problem", problem.kept is None, what)
    kept_nets, kept_routes, covered = _kept_routes(problem, controls)
    free = np.setdiff1d(np.arange(len(problem.nets)), kept_nets)
    check("keep", len(free), f"at least one net that does not stay, found all in {controls.keep}")
    allowed = _allowed_layers(problem, controls)
    whole = _derated(problem, controls, np.any(allowed[free], axis=0))
    if kept_routes is None:
        return _with_widths(whole, allowed, free)
    used, tracks = kept_routes.used_edges
    inside = used % AXES != VIA_AXIS
    used, tracks = used[inside], tracks[inside]
    edge = distinct(np.concatenate((whole.adjusted[0], used)))
    left = whole.capacity_of(edge)
    left[np.searchsorted(edge, used)] -= tracks
    found = _with_capacities(whole, edge, np.maximum(left, 0), whole.layer_capacity)
    found = _with_widths(found, allowed, free)
    nets = tuple(found.nets[i] for i in free.tolist())
    chip, own = _chip_of(whole.chip, free), Kept(whole, free, kept_routes.uses, covered)
    return replace(found, nets=nets, chip=chip, kept=own)


# --- Layers ---------------------------------------------------------------------------------------


def layers_of(problem: Problem, name: str, given: str | int | None) -> NDArray[np.bool_]:
    """(Z,) which layers of a problem a range means; all for None.

    Args:
        problem: with the layers and their names.
        name: of the option, for messages.
        given: a number from 1, a name, or a range of them such as ``2..6`` or ``met1..``.

    Raises:
        InputError: there are no such layers.
    """
    count, names = problem.grid[2], problem.chip_or_default.layers
    if given is None:
        return np.ones(count, np.bool_)

    def number(text: str, default: int) -> int:
        if not text:
            return default
        if text in names:
            return names.index(text)
        if re.fullmatch("[0-9]{1,9}", text) and 1 <= int(text) <= count:
            return int(text) - 1
        raise InputError(
            f"{name}: {nearest(text, names)}expected a layer from 1 to {count} or by its name, "
            f"{', '.join(names)}, or a range such as 2..{count}, found {given!r}"
        )

    low, dots, high = str(given).partition("..")
    first = number(low, 0 if dots else -1)
    last = number(high, count - 1) if dots else first
    check(name, 0 <= first <= last, f"a range from a lower to a higher layer, found {given!r}")
    within: NDArray[np.bool_] = (first <= np.arange(count)) & (np.arange(count) <= last)
    return within


def _allowed_layers(problem: Problem, controls: Controls) -> NDArray[np.bool_]:
    """(nets, Z) the layers in which each net may have wires."""
    signal = _layers_with_wires(problem, "layers", controls.layers)
    allowed = np.tile(signal, (len(problem.nets), 1))
    if controls.long_layers is not None and controls.long_nets is not None:
        long = problem.half_perimeters >= controls.long_nets
        allowed[long] = _layers_with_wires(problem, "long_layers", controls.long_layers)
    if controls.clock_layers is not None:
        clock = _named(problem, "clock_nets", controls.clock_nets)
        if problem.chip is not None and problem.chip.clock is not None:
            clock |= problem.chip.clock
        check("clock_layers", clock.any(), "clock nets: clock_nets=NAMES, or USE CLOCK in DEF")
        allowed[clock] = _layers_with_wires(problem, "clock_layers", controls.clock_layers)
    return allowed


def _layers_with_wires(problem: Problem, name: str, given: str | int | None) -> NDArray[np.bool_]:
    """:func:`layers_of`; raises InputError if they lack wires along an axis that others have."""
    layers = layers_of(problem, name, given)
    chip = problem.chip_or_default
    if given is not None and chip.only_pins and layers[0]:
        raise InputError(
            f"{name}: expected layers above {chip.layers[0]}, which was read as a layer of pins "
            f"without wires, found {given!r}; also give layers, from which other nets take theirs "
            "(2.. or 1..), or read the file with pin_layer_wires=True"
        )
    there = problem.wired
    for axis, way in enumerate(("horizontal", "vertical")):
        lacks = there[:, axis].any() and not there[layers, axis].any()
        check(name, not lacks, f"a layer for {way} wires among them, found none in {given!r}")
    return layers


def _with_widths(problem: Problem, allowed: NDArray[np.bool_], nets: NDArray[np.int64]) -> Problem:
    """The problem with widths that keep some nets out of layers in which other nets have wires."""
    closed = allowed.any(axis=0) & ~allowed
    concerned = nets[closed[nets].any(axis=1)]
    if not len(concerned):
        return problem
    layers = problem.grid[2]
    most = problem.layer_capacity[:, :VIA_AXIS].max(axis=1).astype(np.int64)
    edge, capacity = problem.adjusted
    np.maximum.at(most, edge // AXES % layers, capacity)
    widths = np.where(closed[concerned], most + 1, problem.net_width[concerned])
    changed = list(problem.nets)
    for net, row in zip(concerned.tolist(), widths.tolist(), strict=True):
        changed[net] = replace(changed[net], min_width=tuple(row))
    return replace(problem, nets=tuple(changed))


# --- Capacity -------------------------------------------------------------------------------------


def _derated(problem: Problem, controls: Controls, open_layers: NDArray[np.bool_]) -> Problem:
    """The problem with the capacities that closed layers, ``derate`` and ``areas`` leave."""
    layers = problem.grid[2]
    factor = open_layers.astype(np.float64)
    for name, share in controls.derate.items():
        factor[layers_of(problem, f"derate.{name}", name)] *= share
    if problem.chip is not None and problem.chip.contest is not None:
        return _derated_contest(problem, problem.chip, problem.chip.contest, controls, factor)
    regions = [_edges_in(problem, number, area) for number, area in enumerate(controls.areas)]
    edge = distinct(np.concatenate((problem.adjusted[0], *regions)))
    own = factor[edge // AXES % layers]
    for region, area in zip(regions, controls.areas, strict=True):
        own[np.searchsorted(edge, region)] *= area.factor
    capacity = _share(problem.capacity_of(edge), own)
    by_layer = _share(problem.layer_capacity[:, :VIA_AXIS], factor[:, None])
    return _with_capacities(problem, edge, capacity, by_layer)


def _derated_contest(
    problem: Problem,
    chip: Chip,
    contest: Contest,
    controls: Controls,
    factor: NDArray[np.float64],
) -> Problem:
    """:func:`_derated` for a problem of the ISPD 2024 contest, whose tracks need not be whole."""
    left = contest.left * factor
    for number, area in enumerate(controls.areas):
        near, axis = np.divmod(_edges_in(problem, number, area), AXES)
        along = axis == contest.axis[near % problem.grid[2]]
        left.reshape(-1)[near[along]] *= area.factor
    whole = _share(np.minimum(left, MAX_NUMBER), 1)
    capacities = as_adjustments(whole, contest.axis, np.any(chip.wires, axis=1))
    chip = replace(chip, contest=replace(contest, left=left))
    return replace(problem, chip=chip, **capacities._asdict())


def _share(capacity: NDArray[Any], factor: NDArray[np.float64] | float) -> NDArray[np.int64]:
    """Capacities times factors, rounded down; 0.7 of ten tracks are seven."""
    return np.floor(capacity * factor + 1e-6).astype(np.int64)


def _edges_in(problem: Problem, number: int, area: Area) -> NDArray[np.int64]:
    """The edges inside layers that touch the Gcells of an area, each once."""
    ranges = []
    for axis, (name, (first, last)) in enumerate((("columns", area.columns), ("rows", area.rows))):
        most = problem.grid[axis] - 1
        check(
            f"areas.{number}.{name}",
            0 <= first <= last <= most,
            f"a first and a last one from 0 to {most}, found {[first, last]}",
        )
        ranges.append((first, last, most))
    z = np.flatnonzero(layers_of(problem, f"areas.{number}.layers", area.layers))
    found = []
    for axis in range(VIA_AXIS):
        begin = [first for first, _, _ in ranges]
        end = [last for _, last, _ in ranges]
        begin[axis] = max(begin[axis] - 1, 0)
        end[axis] = min(end[axis], ranges[axis][2] - 1)
        sides = (np.arange(a, b + 1) for a, b in zip(begin, end, strict=True))
        x, y, layer = np.meshgrid(*sides, z, indexing="ij")
        gcell = np.stack((x, y, layer), axis=-1).reshape(-1, 3) @ problem.strides
        found.append(AXES * gcell + axis)
    return distinct(np.concatenate(found))


def _with_capacities(
    problem: Problem,
    edge: NDArray[np.int64],
    capacity: NDArray[np.integer],
    by_layer: NDArray[np.integer],
) -> Problem:
    """The problem with other capacities: of layers and axes (Z, 2), and of single edges."""
    near, axis = np.divmod(edge, AXES)
    x, y, z = np.unravel_index(near, problem.grid)
    differs = capacity != by_layer[z, axis]
    table = np.column_stack((x, y, z + 1, x + (axis == 0), y + (axis == 1), z + 1, capacity))
    return replace(
        problem,
        horizontal_capacity=tuple(by_layer[:, 0].tolist()),
        vertical_capacity=tuple(by_layer[:, 1].tolist()),
        adjustments=tuple(map(Adjustment._make, table[differs].tolist())),
    )


# --- Nets that stay -------------------------------------------------------------------------------


def _named(problem: Problem, name: str, given: Collection[str]) -> NDArray[np.bool_]:
    """(nets,) whether a net's name fits a pattern, or one of several; each must fit a name."""
    patterns = [given] if isinstance(given, str) else given
    named = np.zeros(len(problem.nets), np.bool_)
    for pattern in patterns:
        plain = pattern.replace("[", "[[]")  # buses have brackets in their names
        fits = [fnmatchcase(net.name, plain) for net in problem.nets]
        check(name, any(fits), f"names of nets, found none named {pattern}")
        named |= fits
    return named


def _kept_routes(
    problem: Problem, controls: Controls
) -> tuple[NDArray[np.int64], Solution | None, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The nets that stay; their routes, or None without any; and the room of :class:`Kept`."""
    nothing = np.empty(0, np.int64)
    if controls.keep is None:
        return nothing, None, (nothing, nothing)
    record = read_record(controls.keep, problem)
    found = Solution.of_record(record, problem)
    net, edge = found.uses
    chosen = _named(problem, "keep_nets", controls.keep_nets)
    if not controls.keep_nets:
        chosen[net] = True
    check("keep", chosen.any(), f"a net with a route, found none in {controls.keep}")
    open_nets = set(evaluate(problem, found).disconnected)
    for i in np.flatnonzero(chosen).tolist():
        if problem.nets[i].name in open_nets:
            raise InputError(
                f"keep: {controls.keep}: net {problem.nets[i].name}: expected a route that joins "
                "all pins; keep_nets selects others"
            )
    on_kept = chosen[net]
    covered = gcells_in_boxes(record, problem) if has_boxes(record) else nothing
    owner, gcell = np.divmod(covered, int(np.prod(problem.grid)))
    routes = Solution.of_uses(problem, net[on_kept], edge[on_kept])
    return np.flatnonzero(chosen), routes, (owner[chosen[owner]], gcell[chosen[owner]])


def _chip_of(chip: Chip | None, nets: NDArray[np.int64]) -> Chip | None:
    """What a chip's files say beyond a problem, for some of its nets."""
    if chip is None:
        return None
    return replace(
        chip,
        places=None if chip.places is None else chip.places.of_nets(nets),
        clock=None if chip.clock is None else chip.clock[nets],
    )
