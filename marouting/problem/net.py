"""Nets, their pins, and edges with a capacity of their own: the rows of a problem.

Everything is in the units of the ISPD 2008 ``.gr`` format: chip coordinates, layers from 1, widths
and capacities in tracks.
"""

import operator
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from marouting.errors import InputError

MAX_NUMBER = 10**9
"""The largest capacity, width or coordinate accepted; sums of them stay within 64 bits."""


class FieldError(InputError):
    """An InputError about one row of one field.

    A file reader that knows the line of every row can therefore leave all checks to the object
    that it fills, and still name the line.

    Attributes:
        field: the name of the field. For a Problem, an attribute or ``"pins"``: the pins of all
            nets, one net after another.
        row: the index within that field.
    """

    def __init__(self, message: str, field: str = "", row: int = 0) -> None:
        super().__init__(message)
        self.field = field
        self.row = row


class Pin(NamedTuple):
    """A pin of a net: x and y in chip coordinates, layer from 1."""

    x: int
    y: int
    layer: int


@dataclass(frozen=True, slots=True)
class Net:
    """A set of pins to be joined.

    Attributes:
        name: unique within its problem, printable, without white space.
        id: the number that the file gives the net.
        pins: one or more; several may lie in one Gcell. Any iterable of pins, or of other rows
            of three integers, becomes a tuple of pins.
        min_width: minimum width of the net's wires; 1 in the paper. Or one number for each layer,
            lowest first; equal numbers become one.

    Raises:
        FieldError: the pins are no rows of numbers. All else is checked by the problem.
    """

    name: str
    id: int
    pins: tuple[Pin, ...]
    min_width: int | tuple[int, ...] = 1

    def __post_init__(self) -> None:
        pins = records(f"net {self.name}: expected pins", Pin, self.pins)
        object.__setattr__(self, "pins", pins)
        if isinstance(self.min_width, tuple | list):
            widths = whole_numbers(f"net {self.name}: minimum width", self.min_width)
            one = widths[0] if len(set(widths)) == 1 else widths
            object.__setattr__(self, "min_width", one)


class Adjustment(NamedTuple):
    """The capacity of one edge, given by its two neighbouring Gcells in one layer.

    Columns and rows count from 0, layers from 1.
    """

    x1: int
    y1: int
    layer1: int
    x2: int
    y2: int
    layer2: int
    capacity: int


def check_net(net: Net, row: int = 0) -> None:
    """Raises FieldError for a name, id, width or pins that no net of any problem can have."""
    if not isinstance(net, Net) or not isinstance(net.name, str):
        raise FieldError(f"nets: expected nets with names, found {net!r}", "nets", row)
    # Control characters would break the lines of files and of messages; a lone surrogate cannot
    # be written at all.
    if not net.name or " " in net.name or not net.name.isprintable():
        raise FieldError(
            f"net {net.name!r}: expected a name of printable characters without white space",
            "nets",
            row,
        )
    if not net.pins:
        raise FieldError(f"net {net.name}: expected at least one pin", "nets", row)
    widths = net.min_width if isinstance(net.min_width, tuple) else (net.min_width,)
    check_numbers(f"net {net.name}: id and minimum width", (net.id, *widths), "nets", row)


def check_numbers(name: str, values: Iterable[int], field: str = "", row: int = 0) -> None:
    """Raises FieldError, with this field and row, unless all are whole numbers in 0…MAX_NUMBER."""
    for value in values:
        if not (is_whole(value) and 0 <= value <= MAX_NUMBER):
            raise FieldError(
                f"{name}: expected a whole number from 0 to {MAX_NUMBER}, found {value!r}",
                field,
                row,
            )


def is_whole(value: object) -> bool:
    """Whether a value is an integer, of any type; 1.0 and True are none."""
    return hasattr(value, "__index__") and not isinstance(value, bool)


def records(name: str, kind: Any, rows: Any) -> tuple[Any, ...]:
    """Rows of numbers as a tuple of records; rows and numbers that are none stay, for Problem."""
    if type(rows) is tuple and all(type(row) is kind for row in rows):
        return rows  # as files are read: a large chip has a million pins
    made, found = [], rows
    try:
        for found in rows:
            row = tuple(operator.index(n) if is_whole(n) else n for n in found)
            made.append(kind(*row) if len(row) == len(kind._fields) else row)
    except TypeError:
        fields = ", ".join(kind._fields)
        raise FieldError(f"{name}, each ({fields}), found {found!r}", row=len(made)) from None
    return tuple(made)


def whole_numbers(name: str, values: Any, count: int | None = None) -> tuple[int, ...]:
    """Integers of any type as a tuple of Python's; raises FieldError for anything else."""
    try:
        numbers = tuple(int(operator.index(value)) for value in values)
    except TypeError:
        raise FieldError(f"{name}: expected whole numbers, found {values!r}", name) from None
    if count not in (None, len(numbers)):
        raise FieldError(f"{name}: expected {count} numbers, found {values!r}", name)
    return numbers
