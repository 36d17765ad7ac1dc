"""A global routing problem: the chip's grid, its capacities, and the nets to be joined.

A problem is frozen and in the units of the ISPD 2008 ``.gr`` format: pins in chip coordinates with
layers from 1, capacities and widths in tracks. Routers and the environment need Gcell and edge
numbers (:mod:`marouting.problem.grid`) with layers from 0; these are derived here, once.
"""

import dataclasses
import functools
import itertools
import os
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.files import beside, check_suffix, exists, naming, suffix_of
from marouting.problem import ispd, lefdef
from marouting.problem.chip import Chip
from marouting.problem.grid import AXES, MAX_GCELLS, OFF_GRID, VIA_AXIS, Grid
from marouting.problem.net import (
    MAX_NUMBER,
    Adjustment,
    FieldError,
    Net,
    check_net,
    check_numbers,
    is_whole,
    records,
    whole_numbers,
)

UNLIMITED = int(np.iinfo(np.int32).max)
"""The capacity of a via. Vias never overflow (paper, section on the problem sets generator)."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Nets that were taken out of a problem because their routes stay as they are.

    Attributes:
        whole: the problem with all nets, with the capacities that controls leave.
        free: (nets,) int64, for each net of the problem its number in ``whole``, ascending.
        uses: (uses,) int64 twice: net, by its number in ``whole``, and edge of the routes that
            stay, in this order.
        room: (k,) int64 twice: net, as above, and Gcell of what the boxes of a guide cover, if
            that is what the routes are from.
    """

    whole: "Problem"
    free: NDArray[np.int64]
    uses: tuple[NDArray[np.int64], NDArray[np.int64]]
    room: tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class Problem:
    """A grid of Gcells with capacities, and the nets to be routed over it.

    Attributes:
        grid: (X, Y, Z): columns, rows and routing layers of Gcells.
        vertical_capacity: Z numbers, capacity in tracks of the edges along y in each layer.
        horizontal_capacity: Z numbers, capacity in tracks of the edges along x in each layer.
        nets: the nets, in file order; at least one.
        min_width: Z numbers, minimum wire width in each layer.
        min_spacing: Z numbers, minimum wire spacing in each layer.
        via_spacing: Z numbers; read and written, but without influence on routing.
        origin: chip coordinates of the lower left corner of Gcell (0, 0).
        tile: width and height of a Gcell in chip coordinates.
        adjustments: edges whose capacity differs from their layer's; if an edge has several, the
            last one counts (ISPD 2008 evaluator).
        chip: names and axes of layers, lines between Gcells and costs that files give beyond the
            problem itself, or None. Equal problems may differ in it, and ``.gr`` files do not
            hold it.
        kept: nets whose routes stay (:mod:`marouting.problem.controls`), or None. The capacities
            lack what they take. Solutions are written with them and read without them.

    Raises:
        FieldError: a value is out of range or contradicts another (an InputError).
    """

    grid: tuple[int, int, int]
    vertical_capacity: tuple[int, ...]
    horizontal_capacity: tuple[int, ...]
    nets: tuple[Net, ...]
    min_width: tuple[int, ...]
    min_spacing: tuple[int, ...]
    via_spacing: tuple[int, ...]
    origin: tuple[int, int] = (0, 0)
    tile: tuple[int, int] = (1, 1)
    adjustments: tuple[Adjustment, ...] = ()
    chip: Chip | None = field(default=None, compare=False, repr=False)
    kept: Kept | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        layered = (
            "vertical_capacity", "horizontal_capacity", "min_width", "min_spacing", "via_spacing",
        )  # fmt: skip
        for name, count in (("grid", 3), ("origin", 2), ("tile", 2), *((n, None) for n in layered)):
            object.__setattr__(self, name, whole_numbers(name, getattr(self, name), count))
        try:
            object.__setattr__(self, "nets", tuple(self.nets))
        except TypeError:
            raise FieldError(f"nets: expected nets, found {self.nets!r}", "nets") from None
        adjustments = records("adjustments: expected rows", Adjustment, self.adjustments)
        object.__setattr__(self, "adjustments", adjustments)
        check_grid(self.grid)
        if not all(abs(value) <= MAX_NUMBER for value in self.origin):
            raise FieldError(
                f"origin {self.origin}: expected two numbers from -{MAX_NUMBER} to {MAX_NUMBER}",
                "origin",
            )
        if not all(1 <= side <= MAX_NUMBER for side in self.tile):
            raise FieldError(
                f"tile {self.tile}: expected a width and a height from 1 to {MAX_NUMBER}", "tile"
            )
        for name in layered:
            values = getattr(self, name)
            if len(values) != self.grid[2]:
                raise FieldError(
                    f"{name}: expected {self.grid[2]} values, one per layer, found {len(values)}",
                    name,
                )
            check_numbers(name, values, name)
        if not self.nets:
            raise FieldError("nets: expected at least one net", "nets")
        names: set[str] = set()
        for row, net in enumerate(self.nets):
            check_net(net, row)
            if isinstance(net.min_width, tuple) and len(net.min_width) != self.grid[2]:
                raise FieldError(
                    f"net {net.name}: expected one minimum width or {self.grid[2]}, one per layer, "
                    f"found {len(net.min_width)}",
                    "nets",
                    row,
                )
            if net.name in names:
                raise FieldError(f"net {net.name}: expected a name no earlier net has", "nets", row)
            names.add(net.name)
        # Both check every row, and keep what they computed for later.
        _ = self._pins, self._adjusted_edges

    def gcells(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """The numbers of the Gcells that points lie in.

        Args:
            points: (n, 3) int64, x and y in chip coordinates, layer from 1.

        Returns:
            (n,) int64 Gcell numbers, OFF_GRID for a point off the grid.
        """
        cell = points - np.array([*self.origin, 1])
        cell[:, :2] //= np.array(self.tile)
        inside = np.all((cell >= 0) & (cell < np.array(self.grid)), axis=1)
        return np.where(inside, cell @ self.strides, OFF_GRID)

    @property
    def strides(self) -> NDArray[np.int64]:
        """(3,) difference between the numbers of neighbouring Gcells along x, y, z.

        :attr:`topology` contains the same, but its tables take memory for every Gcell: too much to
        spend on a file that merely promises a large grid.
        """
        return np.array([self.grid[1] * self.grid[2], self.grid[2], 1], np.int64)

    @property
    def extent(self) -> str:
        """What a point on the grid is, for error messages."""
        return f"a point on the {self.grid[0]}x{self.grid[1]} grid, in layers 1 to {self.grid[2]}"

    @functools.cached_property
    def _pins(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(pins,) twice: net and Gcell of every pin; raises FieldError for a pin off the grid."""
        table = _table("pins", [pin for net in self.nets for pin in net.pins], 3)
        gcell = self.gcells(table)
        net = np.repeat(np.arange(len(self.nets)), [len(net.pins) for net in self.nets])
        if (off := gcell == OFF_GRID).any():
            row = int(off.argmax())
            raise FieldError(
                f"net {self.nets[net[row]].name}: expected {self.extent}, "
                f"found pin {tuple(table[row].tolist())}",
                "pins",
                row,
            )
        return net, gcell

    @property
    def gcell_of_pins(self) -> NDArray[np.int64]:
        """(pins,) the Gcell of every pin, one net after another, with repetitions."""
        return self._pins[1]

    @property
    def net_of_pins(self) -> NDArray[np.int64]:
        """(pins,) the net of every pin."""
        return self._pins[0]

    @functools.cached_property
    def _adjusted_edges(self) -> NDArray[np.int64]:
        """(adjustments,) the edge of each adjustment; raises FieldError for an unusable one."""
        table = _table("adjustments", self.adjustments, 7)
        ends, capacity = table[:, :6].reshape(-1, 2, 3) - np.array([0, 0, 1]), table[:, 6]
        near, far = ends.min(axis=1), ends.max(axis=1)
        step = far - near
        usable = np.all((near >= 0) & (far < np.array(self.grid)), axis=1)
        usable &= (step.sum(axis=1) == 1) & (step[:, VIA_AXIS] == 0)
        self._refuse_adjustment(
            ~usable,
            "two neighbouring Gcells of one layer, "
            f"columns 0 to {self.grid[0] - 1}, rows 0 to {self.grid[1] - 1}, "
            f"layers 1 to {self.grid[2]}",
        )
        self._refuse_adjustment(
            (capacity < 0) | (capacity > MAX_NUMBER), f"a capacity from 0 to {MAX_NUMBER}"
        )
        return AXES * (near @ self.strides) + step[:, 1]

    def _refuse_adjustment(self, refused: NDArray[np.bool_], expected: str) -> None:
        """Raises FieldError for the first adjustment that ``refused`` (adjustments,) marks."""
        if refused.any():
            row = int(refused.argmax())
            raise FieldError(
                f"adjustment: expected {expected}, found {tuple(self.adjustments[row])}",
                "adjustments",
                row,
            )

    @functools.cached_property
    def chip_or_default(self) -> Chip:
        """:attr:`chip`, or what stands for it: layers Metal1, Metal2, … and Gcells by tile."""
        if self.chip is not None:
            return self.chip
        x, y = (
            self.origin[axis] + self.tile[axis] * np.arange(self.grid[axis] + 1, dtype=np.int64)
            for axis in (0, 1)
        )
        layers = tuple(f"Metal{layer + 1}" for layer in range(self.grid[2]))
        return Chip(layers, x, y, self.wired)

    @functools.cached_property
    def topology(self) -> Grid:
        """Neighbours, edges and positions of this problem's Gcells, as tables."""
        return Grid.of(self.grid)

    @functools.cached_property
    def capacity(self) -> NDArray[np.int32]:
        """(E,) capacity of every edge in tracks: UNLIMITED for vias, 0 for edges off the grid."""
        exists = self.topology.exists.reshape(-1, *self.layer_capacity.shape)
        edges: NDArray[np.int32] = (exists * self.layer_capacity).reshape(-1)
        adjusted, capacity = self.adjusted
        edges[adjusted] = capacity
        edges.setflags(write=False)
        return edges

    @functools.cached_property
    def closed(self) -> NDArray[np.bool_]:
        """(E,) bool, the edges that no router lays wires on, at any price.

        They are those of a chip along an axis along which their layer has no wires. A chip's layers
        with wires along x, together with those along y, lead everywhere. Where they do not, no edge
        is closed, and such wires are overflow as any other.
        """
        edges, chip = self.topology.edges, self.chip
        if chip is None or not chip.wires.any(axis=0).all():
            return np.broadcast_to(np.False_, (edges,))
        closed = np.zeros((edges // (AXES * self.grid[2]), self.grid[2], AXES), np.bool_)
        closed[:, :, :VIA_AXIS] = ~chip.wires
        closed.setflags(write=False)
        return closed.reshape(-1)

    @functools.cached_property
    def layer_capacity(self) -> NDArray[np.int32]:
        """(Z, 3) capacity in tracks of the edges of each layer and axis that have no adjustment."""
        vias = (UNLIMITED,) * self.grid[2]
        layers = np.array((self.horizontal_capacity, self.vertical_capacity, vias), np.int32).T
        layers.setflags(write=False)
        return layers

    @functools.cached_property
    def adjusted(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """(adjusted edges,) twice: the edges with adjustments, ascending, and their capacity."""
        # Of several adjustments of one edge the last one counts: the first from behind.
        edge, last = np.unique(self._adjusted_edges[::-1], return_index=True)
        capacity = np.array([adjustment.capacity for adjustment in self.adjustments], np.int32)
        return edge, capacity[::-1][last]

    @property
    def wired(self) -> NDArray[np.bool_]:
        """(Z, 2) whether any edge of a layer along x, and along y, has capacity."""
        there = self.layer_capacity[:, :VIA_AXIS] > 0
        edge, capacity = self.adjusted
        rows = edge[capacity > 0]
        there[rows // AXES % self.grid[2], rows % AXES] = True
        return there

    def capacity_of(self, edge: NDArray[np.int64]) -> NDArray[np.int32]:
        """The capacity of some edges, without the memory that :attr:`capacity` takes for all.

        Args:
            edge: (n,) int64, edges that exist.

        Returns:
            (n,) int32, in tracks.
        """
        gcell = edge // AXES
        capacity: NDArray[np.int32] = self.layer_capacity[gcell % self.grid[2], edge - AXES * gcell]
        adjusted, value = self.adjusted
        if len(adjusted):
            at = np.minimum(np.searchsorted(adjusted, edge), len(adjusted) - 1)
            capacity = np.where(adjusted[at] == edge, value[at], capacity)
        return capacity

    @functools.cached_property
    def net_demand(self) -> NDArray[np.int32]:
        """(nets, Z) tracks that a net takes of an edge in each layer: wire width plus spacing.

        The width is the larger of the net's and the layer's minimum width, the spacing the
        layer's minimum spacing (ISPD 2008 evaluator).
        """
        demand = np.maximum(self.net_width, np.array(self.min_width, np.int32))
        demand += np.array(self.min_spacing, np.int32)
        demand.setflags(write=False)
        return demand

    @property
    def net_width(self) -> NDArray[np.int32]:
        """(nets, Z) the minimum width of each net's wires in each layer."""
        widths = [net.min_width for net in self.nets]
        by_layer = [i for i, width in enumerate(widths) if isinstance(width, tuple)]
        table = np.empty((len(widths), self.grid[2]), np.int32)
        table[:] = np.array([0 if isinstance(w, tuple) else w for w in widths], np.int32)[:, None]
        if by_layer:
            table[by_layer] = [widths[i] for i in by_layer]
        return table

    @functools.cached_property
    def flat_pin_gcells(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """:attr:`pin_gcells` of all nets, one net after another: ``first`` and ``gcell``.

        (nets + 1,) and (pin Gcells,) int64, read-only; those of net i are
        ``gcell[first[i] : first[i + 1]]``.
        """
        net, pins = self._pins
        gcells = int(np.prod(self.grid))
        distinct = np.sort(np.unique(net * gcells + pins, return_index=True)[1])
        gcell = pins[distinct]
        first = np.searchsorted(net[distinct], np.arange(len(self.nets) + 1))
        for table in (first, gcell):
            table.setflags(write=False)
        return first, gcell

    @property
    def to_route(self) -> NDArray[np.bool_]:
        """(nets,) whether a net has pins in several Gcells, and so needs a route."""
        routed: NDArray[np.bool_] = np.diff(self.flat_pin_gcells[0]) > 1
        return routed

    def pin_boxes(self) -> NDArray[np.int64]:
        """(2, nets, 3) the first and the last column, row and layer, in Gcells, of a net's pins."""
        first, gcell = self.flat_pin_gcells
        at = np.stack(np.unravel_index(gcell, self.grid), axis=1)
        return np.stack([end.reduceat(at, first[:-1]) for end in (np.minimum, np.maximum)])

    @property
    def half_perimeters(self) -> NDArray[np.int64]:
        """(nets,) columns plus rows of the bounding box of each net's pins, in edges."""
        low, high = self.pin_boxes()
        half: NDArray[np.int64] = (high - low)[:, :VIA_AXIS].sum(axis=1)
        return half

    @functools.cached_property
    def pin_gcells(self) -> tuple[NDArray[np.int64], ...]:
        """For each net the numbers of the Gcells that hold its pins, each once, in pin order."""
        first, gcell = self.flat_pin_gcells
        return tuple(gcell[a:b] for a, b in itertools.pairwise(first.tolist()))

    @staticmethod
    def read(
        path: str | os.PathLike[str],
        *,
        lef: Sequence[str | os.PathLike[str]] = (),
        tile: tuple[int, int] | None = None,
        net: str | os.PathLike[str] | None = None,
        pin_layer_wires: bool = False,
    ) -> "Problem":
        """Reads a problem.

        A file ``.def`` is a LEF/DEF design (:mod:`marouting.problem.lefdef`, which needs the extra
        ``lefdef``), a file ``.cap`` a problem of the ISPD 2024 or 2025 contest
        (:mod:`marouting.problem.ispd.ispd2024`). All others are ISPD text
        (:mod:`marouting.problem.ispd`), whose header tells the format. Suffixes may be in capitals
        and have ``.gz`` after them: any file may be compressed by gzip.

        Args:
            path: the file.
            lef: for a design its LEF files, technology first; none stands for the file beside it
                that is named alike, with the suffix ``.lef``.
            tile: for a design the width and height of a Gcell in the DEF's units; None for its
                GCELLGRID, or, where it has none, for squares of 15 tracks of the third layer.
            net: for a ``.cap`` file its ``.net`` file; None for the one beside it that is named
                alike.
            pin_layer_wires: for a design whether wires may run in its lowest layer even where that
                holds most pins of its cells.

        Raises:
            InputError: the file cannot be read, is in none of the formats, or does not describe
                a valid problem; the message names the file, the line, and what was expected. Or an
                argument is for another format.
        """
        suffix = suffix_of(path)
        if isinstance(lef, str | os.PathLike):
            raise InputError(f"lef: expected a list of files, found {os.fspath(lef)}")
        pair = isinstance(tile, tuple | list) and len(tile) == 2
        if tile is not None and not (pair and all(map(is_whole, tile))):
            raise InputError(f"tile: expected a width and a height, found {tile!r}")
        for name, given, own in (
            ("lef", lef, ".def"),
            ("tile", tile, ".def"),
            ("net", net, ".cap"),
        ):
            if given and suffix != own:
                raise InputError(f"{os.fspath(path)}: expected no {name}: only {own} files take it")
        if suffix == ".def":
            with naming(path, "cannot be read"):  # before its LEF files are looked for
                os.stat(path)  # noqa: PTH116 (PathLike without Path)
            files = lef or [beside(path, ".lef")]
            if not lef and not exists(files[0]):
                what = f"{os.fspath(files[0])} beside it, or its LEF files named (lef, --lef)"
                raise InputError(f"{os.fspath(path)}: expected {what}")
            record = lefdef.read_design(path, files, tile, pin_layer_wires)
        elif suffix == ".cap":
            record = ispd.read_contest(path, net or beside(path, ".net"))
        else:
            if suffix == ".lef":
                raise InputError(f"{os.fspath(path)}: expected the design, a .def file")
            record = ispd.read_problem(path)
        try:
            return Problem(**record.fields)
        except FieldError as error:
            raise record.located(error) from None

    @property
    def beyond_text(self) -> tuple[str, ...]:
        """What the problem's files give that :meth:`write` does not, in words."""
        if self.chip is None:
            return ()
        lost = ["names of layers", "further Gcells of pins"]
        if self.closed.any():
            lost.append("axes along which layers have no wires")
        # The last column and row reach to the die's border.
        if any(len(set(np.diff(at)[:-1])) > 1 for at in (self.chip.x, self.chip.y)):
            lost.append("sizes and so positions of Gcells")
        if self.chip.contest is not None:
            lost.append("costs of the contest")
        return tuple(lost)

    def write(self, path: str | os.PathLike[str], format: ispd.Format = "ispd2008") -> None:
        """Writes the problem in an ISPD format (:mod:`marouting.problem.ispd`).

        The file is written whole or not at all. Reading it gives an equal problem, without its
        :attr:`chip`.

        Args:
            path: the file.
            format: ``ispd2008`` (a ``.gr`` file, which can hold any problem), ``ispd98`` or
                ``ispd98-flat``.

        Raises:
            InputError: there is no such format, it cannot hold the problem, or the file cannot be
                written. No format holds the routes of nets that stay (:attr:`kept`).
        """
        if self.kept is not None:
            raise InputError(
                f"{os.fspath(path)}: expected a problem without nets that stay (keep): the format "
                "has no routes"
            )
        check_suffix(path)
        if (suffix := suffix_of(path)) in (".guide", ".pr_output"):
            raise InputError(
                f"{os.fspath(path)}: expected another suffix: {suffix} is for solutions"
            )
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        ispd.write_problem(path, fields, format)


def check_grid(grid: tuple[int, int, int]) -> None:
    """Raises FieldError unless the grid has at least one and at most MAX_GCELLS Gcells."""
    if len(grid) != 3 or min(grid) < 1 or grid[0] * grid[1] * grid[2] > MAX_GCELLS:
        raise FieldError(
            f"grid {tuple(grid)}: expected columns, rows and layers from 1, "
            f"at most {MAX_GCELLS} Gcells in all",
            "grid",
        )


def check_problem(problem: object) -> None:
    """Raises InputError unless it is a problem: the path of one is easily given instead."""
    if not isinstance(problem, Problem):
        raise InputError(f"problem: expected a Problem, as Problem.read gives, found {problem!r}")


def check_choice(name: str, value: object, choices: Any) -> None:
    """Raises InputError unless the value is one of the choices of a Literal type."""
    if value not in get_args(choices):
        raise InputError(f"{name}: expected one of {', '.join(get_args(choices))}, found {value!r}")


def _table(field: str, rows: Sequence[tuple[int, ...]], columns: int) -> NDArray[np.int64]:
    """The rows as one array (rows, columns); raises FieldError for all but such integers."""
    try:
        if not set(map(len, rows)) <= {columns}:
            raise FieldError(f"{field}: expected {columns} numbers each", field)
        # Unlike NumPy's, this array takes nothing but integers.
        flat = array("q", itertools.chain.from_iterable(rows))
    except OverflowError:
        raise FieldError(f"{field}: expected numbers of at most 64 bits", field) from None
    except TypeError:
        raise FieldError(f"{field}: expected whole numbers", field) from None
    return np.frombuffer(flat, np.int64).reshape(-1, columns)
