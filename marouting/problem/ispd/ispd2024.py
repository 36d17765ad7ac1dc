"""Problems of the ISPD 2024 and 2025 contests: routing resources (``.cap``), nets (``.net``).

A ``.cap`` file holds the number of layers, columns and rows; the costs of a unit of wire, of a via
and, for each layer, of overflow; the distances between columns, X - 1 numbers, and between rows,
Y - 1 numbers; and for each layer a line ``name direction minimum-length`` (direction 0 is
horizontal, 1 vertical) with Y lines of X capacities. A Gcell's capacity is that of the edge to the
next Gcell along the layer's direction. The lowest layer holds pins and no wires.

As in the contest's evaluator the numbers up to the distances are read one after another, however
they are spread over lines, and what is left of the last line is passed over. So where a file gives
X distances between columns, as its toy cases do, the last one is that of the first two rows.

A ``.net`` file holds for each net its name, a line ``(``, a line ``[(layer, x, y), …]`` for each
pin with the Gcells by which it can be reached, and a line ``)``; all are counted from 0.

In the ISPD 2025 contest, the pin's name and slack precede the list: ``name, slack, [(layer, x, y),
…]``, as the contest's own OpenROAD writes them. The last edition of its ``.cap`` files has four
weights of timing, power and overflow in its second line, the first two of which are negative.
Neither is of use here.
"""

import os
import re
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError
from marouting.problem.chip import Chip, Contest, Places, as_adjustments
from marouting.problem.grid import MAX_GCELLS
from marouting.problem.ispd.lines import Lines, Record, is_decimal, is_number, reading, unexpected
from marouting.problem.ispd.problem_text import ProblemRecord
from marouting.problem.net import MAX_NUMBER, Net, Pin

_PLACE = r"\([0-9]{1,9},[0-9]{1,9},[0-9]{1,9}\)"
_SLACK = r"[+-]?([0-9.]+(e[+-]?[0-9]+)?|inf|nan)"
_pin = re.compile(rf"([^(]+,{_SLACK},)?(?P<places>\[{_PLACE}(,{_PLACE})*\])").fullmatch
_places = re.compile(r"\(([0-9]+),([0-9]+),([0-9]+)\)").findall


@dataclass(frozen=True)
class _Nets(Record):
    """What a ``.net`` file holds.

    ``lines`` has the line of each net's name, as ``"nets"``, and of each pin, as ``"pins"``.
    """

    names: tuple[str, ...]
    first_pin: NDArray[np.int64]  # (nets + 1,)
    first_access: NDArray[np.int64]  # (pins + 1,)
    access: NDArray[np.int64]  # (accesses, 3) layer, x, y


def read_contest(resources: str | os.PathLike[str], nets: str | os.PathLike[str]) -> ProblemRecord:
    """Reads a problem of the contest.

    Coordinates of the problem are columns and rows. Capacities are cut to whole tracks. A pin is
    put where it can be reached nearest to the middle (the median) of all such places of its net.
    """
    layer_names, contest = _read_resources(resources)
    listed = _read_nets(nets)
    columns, rows, layers = contest.capacity.shape
    inside = (listed.access < np.array([layers, columns, rows])).all(axis=1)
    if not inside.all():
        place = int(inside.argmin())
        pin = int(np.searchsorted(listed.first_access, place, "right")) - 1
        net = int(np.searchsorted(listed.first_pin, pin, "right")) - 1
        raise InputError(
            f"{listed.file}:{listed.lines['pins'][pin]}: net {listed.names[net]}: expected places "
            f"(layer, x, y) on the {columns}x{rows} grid of {layers} layers, counted from 0, "
            f"found {tuple(listed.access[place].tolist())}"
        )
    chosen = listed.access[_nearest(listed)].tolist()
    pins = [Pin(x, y, layer + 1) for layer, x, y in chosen]
    bounds = listed.first_pin.tolist()
    wires = np.arange(layers) > 0
    whole = np.floor(np.minimum(contest.capacity, MAX_NUMBER)).astype(np.int64)
    capacities = as_adjustments(whole, contest.axis, wires)
    z, x, y = listed.access.T
    places = Places(listed.first_pin, listed.first_access, (x * rows + y) * layers + z)
    allowed = np.stack((wires & (contest.axis == 0), wires & (contest.axis == 1)), axis=1)
    chip = Chip(
        layer_names,
        np.arange(columns + 1),
        np.arange(rows + 1),
        allowed,
        places,
        contest,
    )
    fields = {
        "grid": (columns, rows, layers),
        "nets": tuple(
            Net(name, number, tuple(pins[bounds[number] : bounds[number + 1]]))
            for number, name in enumerate(listed.names)
        ),
        "min_width": (1,) * layers,
        "min_spacing": (0,) * layers,
        "via_spacing": (0,) * layers,
        "chip": chip,
        **capacities._asdict(),
    }
    return ProblemRecord(listed.file, listed.lines, fields)


def _nearest(listed: _Nets) -> NDArray[np.int64]:
    """(pins,) for each pin the place nearest to the median of its net's places; the first such."""
    counts = np.diff(listed.first_access)
    pin = np.repeat(np.arange(len(counts)), counts)
    net = np.repeat(np.arange(len(listed.names)), np.diff(listed.first_pin))[pin]
    distance = np.zeros(len(pin), np.int64)
    for column in (1, 2):
        value = listed.access[:, column]
        order = np.lexsort((value, net))
        first = np.searchsorted(net[order], np.arange(len(listed.names)))
        size = np.bincount(net, minlength=len(listed.names))
        median = value[order][first + (size - 1) // 2]
        distance += np.abs(value - median[net])
    order = np.lexsort((distance, pin))
    nearest: NDArray[np.int64] = order[listed.first_access[:-1]]
    return nearest


def _read_resources(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], Contest]:
    """The names of the layers, and what else a ``.cap`` file holds."""
    with reading(path) as lines:
        numbers = _Numbers(lines)
        layers, columns, rows = numbers.whole_line("numbers of layers, columns and rows", 3)
        if not min(layers, columns, rows) >= 1 or layers * columns * rows > MAX_GCELLS:
            raise InputError(
                "expected numbers of layers, columns and rows from 1, "
                f"at most {MAX_GCELLS} Gcells in all, found {layers} {columns} {rows}"
            )
        numbers.skip_weights()
        wire_cost, via_cost = numbers.take("the costs of wire and via", 2)
        overflow_cost = numbers.take("the cost of overflow in each layer", layers)
        x_length = numbers.take("the distances between columns", columns - 1)
        y_length = numbers.take("the distances between rows", rows - 1)
        names: list[str] = []
        axis: list[int] = []
        capacity = []
        for layer in range(layers):
            tokens = lines.next()
            if len(tokens) != 3 or tokens[1] not in ("0", "1"):
                raise unexpected(
                    f"layer {layer + 1} of {layers} (name, direction 0 or 1, minimum length)",
                    tokens,
                )
            if tokens[0] in names:
                raise InputError(f"layer {tokens[0]}: expected a name no earlier layer has")
            names.append(tokens[0])
            axis.append(int(tokens[1]))
            _floats("a minimum length", tokens[2:])
            for row in range(rows):
                tokens = lines.next()
                if len(tokens) != columns:
                    raise unexpected(
                        f"row {row + 1} of {rows} of layer {names[-1]}, {columns} capacities",
                        tokens,
                    )
                capacity.append(_floats("capacities", tokens))
        if tokens := lines.next():
            raise unexpected(f"the end of the file after {layers} layers", tokens)
    listed = np.array(capacity).reshape(layers, rows, columns)
    table = np.ascontiguousarray(listed.transpose(2, 1, 0))
    costs = float(wire_cost), float(via_cost), overflow_cost
    contest = Contest(*costs, x_length, y_length, table, table, np.array(axis))
    return tuple(names), contest


class _Numbers:
    """The numbers of some lines, one after another."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._tokens: list[str] = []

    def take(self, what: str, count: int) -> NDArray[np.float64]:
        """The next ``count`` numbers, from 0."""
        found: list[str] = []
        while len(found) < count:
            if not self._tokens:
                self._tokens = self._lines.next()
                if not self._tokens:
                    raise unexpected(f"{what}, {count} numbers", [])
            need = count - len(found)
            found += self._tokens[:need]
            self._tokens = self._tokens[need:]
        return _floats(what, found)

    def skip_weights(self) -> None:
        """Passes over ISPD 2025's weights in the next line, which are told by their signs."""
        self._tokens = self._lines.next()
        signs = "".join("-" if token.startswith("-") else "+" for token in self._tokens)
        if "-" in signs:
            at = signs.find("--++")
            if signs.count("-") != 2 or at < 0:
                raise unexpected(
                    "costs from 0, or with them the four weights of ISPD 2025, of which the first "
                    "two are negative",
                    self._tokens,
                )
            _floats("weights", [token.removeprefix("-") for token in self._tokens[at : at + 4]])
            del self._tokens[at : at + 4]

    def whole_line(self, what: str, count: int) -> list[int]:
        """The next line, which must be ``count`` whole numbers."""
        tokens = self._lines.next()
        if len(tokens) != count or not all(map(is_number, tokens)):
            raise unexpected(f"{what}, {count} whole numbers", tokens)
        return list(map(int, tokens))


def _floats(what: str, tokens: list[str]) -> NDArray[np.float64]:
    """Numbers from 0 to MAX_NUMBER; raises InputError for anything else."""
    numbers = np.array(tokens if all(map(is_decimal, tokens)) else ["nan"], np.float64)
    if not ((numbers >= 0) & (numbers <= MAX_NUMBER)).all():
        raise unexpected(f"{what}: numbers from 0 to {MAX_NUMBER}", tokens)
    return numbers


def _read_nets(path: str | os.PathLike[str]) -> _Nets:
    names: list[str] = []
    where = {"nets": array("q"), "pins": array("q")}
    first_pin, first_access, access = array("q", [0]), array("q", [0]), array("q")
    with reading(path) as lines:
        while tokens := lines.next():
            if len(tokens) != 1 or tokens[0] in ("(", ")") or tokens[0].startswith("["):
                raise unexpected("a net's name", tokens)
            name = tokens[0]
            where["nets"].append(lines.number)
            if (tokens := lines.next()) != ["("]:
                raise unexpected(f"'(' after the name of net {name}", tokens)
            while (tokens := lines.next()) != [")"]:
                if not tokens:
                    raise InputError(f"file ends inside net {name}, expected ')'")
                if not (pin := _pin("".join(tokens))):
                    raise unexpected(
                        "a pin '[(layer, x, y), …]' or 'name, slack, [(layer, x, y), …]' "
                        f"of net {name}, or ')'",
                        tokens,
                    )
                for place in _places(pin["places"]):
                    access.extend(map(int, place))
                first_access.append(len(access) // 3)
                where["pins"].append(lines.number)
            if len(first_access) - 1 == first_pin[-1]:
                raise InputError(f"net {name}: expected at least one pin")
            names.append(name)
            first_pin.append(len(first_access) - 1)
        if not names:
            raise InputError("expected at least one net")
    return _Nets(
        os.fspath(path),
        where,
        tuple(names),
        np.frombuffer(first_pin, np.int64),
        np.frombuffer(first_access, np.int64),
        np.frombuffer(access, np.int64).reshape(-1, 3),
    )
