"""Problems drawn by hand: an empty grid with walls, gates and nets.

>>> from marouting import Field
>>> field = Field(8, 7, capacity=6)
>>> _ = field.wall(right_of=3).gate(right_of=3, row=2, tracks=1).gate(right_of=3, row=5)
>>> problem = field.net((0, 2), (6, 2)).net((1, 3), (7, 4)).problem()

A **wall** closes edges, a **gate** opens one again with the tracks that it is given. Both lie
between two columns (``right_of=3``: between columns 3 and 4) or between two rows (``above=2``:
between rows 2 and 3). Columns and rows count from 0. What is drawn later replaces what was drawn
before.
"""

from collections.abc import Sequence
from typing import TypeGuard, cast

from marouting.errors import InputError
from marouting.problem.net import Adjustment, Net, Pin, check_numbers, is_whole
from marouting.problem.problem import Problem, check_grid

Ends = tuple[int, int]
"""The first and the last column or row, both included."""

_X, _Y = 0, 1


class Field:
    """An empty grid, to be drawn on; every method but :meth:`problem` returns the field.

    A single layer has tracks in both directions. Of several layers, the first has tracks along x,
    the second along y, and so on, as in :func:`marouting.generate`. Walls, gates and areas are the
    same in all layers that have tracks in their direction.

    Args:
        columns: Gcells along x.
        rows: Gcells along y.
        layers: routing layers.
        capacity: tracks of every edge.

    Raises:
        InputError: there is no such grid.
    """

    def __init__(self, columns: int, rows: int, layers: int = 1, capacity: int = 6) -> None:
        check_numbers("columns, rows, layers and capacity", (columns, rows, layers, capacity))
        check_grid((columns, rows, layers))
        self._sides, self._layers = (columns, rows), layers
        self.capacity = capacity
        # By axis and by the left or lower one of an edge's two Gcells: column and row.
        self._tracks: dict[tuple[int, int, int], int] = {}
        self._nets: list[tuple[str, tuple[Pin, ...]]] = []

    def wall(
        self,
        *,
        right_of: int | None = None,
        above: int | None = None,
        columns: Ends | None = None,
        rows: Ends | None = None,
    ) -> "Field":
        """Closes the edges between two columns or between two rows.

        Args:
            right_of: the wall is between this column and the next; or
            above: the wall is between this row and the next.
            columns: where a wall between rows begins and ends; None: all columns.
            rows: where a wall between columns begins and ends; None: all rows.

        Raises:
            InputError: there is no such place on the grid.
        """
        axis, at = self._between(right_of, above)
        name, given, other = ("rows", rows, columns) if axis == _X else ("columns", columns, rows)
        if other is not None:
            raise InputError(f"wall: expected {name}, where it begins and ends, found {other}")
        first, last = self._ends(name, given, 1 - axis)
        for place in range(first, last + 1):
            self._set(axis, at, place, 0)
        return self

    def gate(
        self,
        *,
        right_of: int | None = None,
        above: int | None = None,
        column: int | None = None,
        row: int | None = None,
        tracks: int | None = None,
    ) -> "Field":
        """Gives one edge a number of tracks.

        Args:
            right_of: the edge is between this column and the next, in ``row``; or
            above: the edge is between this row and the next, in ``column``.
            column: the column of an edge between rows.
            row: the row of an edge between columns.
            tracks: its capacity; None: that of the field.

        Raises:
            InputError: there is no such edge.
        """
        axis, at = self._between(right_of, above)
        name, place, other = ("row", row, column) if axis == _X else ("column", column, row)
        if place is None or other is not None:
            raise InputError(f"gate: expected a {name} beside where it lies")
        first, _ = self._ends(name, (place, place), 1 - axis)
        self._set(axis, at, first, self.capacity if tracks is None else tracks)
        return self

    def area(self, columns: Ends, rows: Ends, tracks: int = 0) -> "Field":
        """Gives all edges of the Gcells of a rectangle a number of tracks; 0 for a blockage.

        The edges that lead out of the rectangle are among them.

        Raises:
            InputError: the rectangle is not on the grid.
        """
        (left, right), (low, high) = (
            self._ends("columns", columns, _X),
            self._ends("rows", rows, _Y),
        )
        for row in range(low, high + 1):
            for column in range(max(left - 1, 0), min(right + 1, self._sides[_X] - 1)):
                self._set(_X, column, row, tracks)
        for column in range(left, right + 1):
            for row in range(max(low - 1, 0), min(high + 1, self._sides[_Y] - 1)):
                self._set(_Y, row, column, tracks)
        return self

    def net(self, *pins: Sequence[int], name: str | None = None) -> "Field":
        """Adds a net.

        Args:
            *pins: (column, row), or (column, row, layer) with layers from 1; the layer is 1 unless
                given.
            name: the net's name; None: n0, n1 and so on.

        Raises:
            InputError: a pin is not two or three whole numbers. All else is checked by
                :meth:`problem`.
        """
        for pin in pins:
            if not (_are_whole(pin) and len(pin) in (2, 3)):
                raise InputError(
                    f"pin: expected (column, row) or (column, row, layer), found {pin}"
                )
        placed = tuple(Pin(*map(int, (*pin, 1)[:3])) for pin in pins)
        self._nets.append((f"n{len(self._nets)}" if name is None else name, placed))
        return self

    def mirrored(self, *, columns: bool = False, rows: bool = False) -> "Field":
        """The field as seen in a mirror; this one stays as it is.

        Args:
            columns: whether the first column becomes the last.
            rows: whether the first row becomes the last.
        """
        for name, flip in (("columns", columns), ("rows", rows)):
            if not isinstance(flip, bool):
                raise InputError(f"{name}: expected true or false, found {flip!r}")
        turned = Field(*self._sides, self._layers, self.capacity)
        flips = (columns, rows)

        def place(axis: int, at: int, edge: bool = False) -> int:
            return self._sides[axis] - 1 - at - edge if flips[axis] else at

        for (axis, column, row), tracks in self._tracks.items():
            x, y = place(_X, column, axis == _X), place(_Y, row, axis == _Y)
            turned._tracks[axis, x, y] = tracks
        turned._nets = [
            (name, tuple(Pin(place(_X, pin.x), place(_Y, pin.y), pin.layer) for pin in pins))
            for name, pins in self._nets
        ]
        return turned

    def problem(self) -> Problem:
        """The problem.

        Raises:
            InputError: there is no net, or a net or a capacity is not valid.
        """
        layers = range(1, self._layers + 1)
        along = [layers if self._layers == 1 else layers[axis::2] for axis in (_X, _Y)]
        return Problem(
            grid=(*self._sides, self._layers),
            horizontal_capacity=tuple(self.capacity * (layer in along[_X]) for layer in layers),
            vertical_capacity=tuple(self.capacity * (layer in along[_Y]) for layer in layers),
            nets=tuple(Net(name, number, pins) for number, (name, pins) in enumerate(self._nets)),
            min_width=(1,) * self._layers,
            min_spacing=(0,) * self._layers,
            via_spacing=(0,) * self._layers,
            adjustments=tuple(
                Adjustment(x, y, layer, x + (axis == _X), y + (axis == _Y), layer, tracks)
                for (axis, x, y), tracks in self._tracks.items()
                if tracks != self.capacity
                for layer in along[axis]
            ),
        )

    def _set(self, axis: int, at: int, place: int, tracks: int) -> None:
        """Gives the edge beyond column (axis 0) or row ``at`` some tracks, at ``place`` across."""
        check_numbers("tracks", (tracks,))
        self._tracks[(axis, at, place) if axis == _X else (axis, place, at)] = tracks

    def _between(self, right_of: int | None, above: int | None) -> tuple[int, int]:
        """The axis, and the column or row after which something lies."""
        if (right_of is None) == (above is None):
            raise InputError("wall or gate: expected right_of, a column, or above, a row")
        axis, at = (_X, right_of) if right_of is not None else (_Y, above)
        most = self._sides[axis] - 2
        if at is None or not (is_whole(at) and 0 <= at <= most):
            many, name = ("columns", "right_of") if axis == _X else ("rows", "above")
            what = f"0 to {most}" if most >= 0 else f"a grid of at least two {many}"
            raise InputError(f"{name}: expected {what}, found {at!r}")
        return axis, int(at)

    def _ends(self, name: str, given: Ends | None, axis: int) -> Ends:
        """The first and the last column or row, checked."""
        most = self._sides[axis] - 1
        ends = (0, most) if given is None else given
        if not (_are_whole(ends) and len(ends) == 2 and 0 <= ends[0] <= ends[1] <= most):
            raise InputError(f"{name}: expected numbers from 0 to {most}, found {given!r}")
        return int(ends[0]), int(ends[1])


def _are_whole(values: object) -> TypeGuard[Sequence[int]]:
    """Whether this is a sequence of whole numbers."""
    return hasattr(values, "__len__") and all(map(is_whole, cast(Sequence[object], values)))
