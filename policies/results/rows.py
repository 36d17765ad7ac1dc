"""Rows of results: one router on one problem, as result files and tables hold them.

Every file of rows, ours or another's, is read by the types that stand here.
"""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

from marouting import InputError, Solution, evaluate
from marouting.config import Meets, between, build, build_json, check
from marouting.files import FILE_NAME, is_file_name, read_text

MOST_BYTES = 2**30
"""The largest file of results that is read."""

RESULTS, SUMMARY = "results.json", "summary.json"
"""The files of an experiment with its rows and with their statistics."""

Row = dict[str, Any]
"""One router on one problem (in an experiment: with one seed), plain data by column."""


Name = Annotated[str, Meets(is_file_name, FILE_NAME)]
"""The name of a set, a problem or a router: files are called after it."""

Line = Annotated[str, Meets(str.isprintable, "one line without control characters")]
"""A text that pages and tables show."""

Count = Annotated[int, between(0, 2**63 - 1)]
"""A whole number from 0."""

LARGEST = 2.0**63
"""What is larger than the largest count is no result but a mistake."""

Measure = Annotated[float, between(-LARGEST, LARGEST)]
"""A number, neither infinite nor NaN; also one that JSON writes as a whole number."""

Seconds = Annotated[float, between(0, LARGEST)]
"""A time."""

ResultRow = TypedDict(
    "ResultRow",
    {
        "problem": Name,
        "router": Name,
        "overflow": Count,
        "max_overflow": Count,
        "wirelength": Count,
        "vias": Count,
        "pruned_overflow": NotRequired[Count],
        "pruned_wirelength": NotRequired[Count],
        "open_nets": NotRequired[Count],
        "connected": bool,
        "joined": Count,
        "tasks": Count,
        "seconds": Seconds,
        "from": NotRequired[str | None],
    },
)
"""A row of a training's results, in the columns of :class:`ExperimentRow`."""

ExperimentRow = TypedDict(
    "ExperimentRow",
    {
        "set": Name,
        "problem": Name,
        "router": Name,
        "kind": Name,
        "seed": Count | None,
        "overflow": Count,
        "max_overflow": Count | None,
        "wirelength": Count,
        "vias": Count | None,
        "pruned_overflow": NotRequired[Count | None],
        "pruned_wirelength": NotRequired[Count | None],
        "open_nets": NotRequired[Count | None],
        "connected": bool | None,
        "joined": Count | None,
        "tasks": Count | None,
        "proven": bool | None,
        "seconds": Seconds | None,
        "gap": Measure | None,
        "from": str | None,
    },
)
"""A row of an experiment's results.

``router`` is the name of the experiment's entry and ``kind`` the registered name (or
``module:Class``) of the router behind it. Overflow and wirelength are those of the routes as they
are; ``pruned_overflow`` and ``pruned_wirelength`` are those of :meth:`marouting.Solution.pruned`,
which earlier results lack. ``open_nets`` is the number of nets that are not joined (earlier results
lack it, too), ``joined`` and ``tasks`` count two-pin tasks, ``proven`` says whether the solution is
known to be optimal, ``seconds`` is the time to route the problem,
``gap`` is the wirelength above the proven optimum in %, and ``from`` names the episode or policy
that a learner's routes come from. A value that is not known is None: published results give only
overflow and wirelength.
"""

COLUMNS = tuple(ExperimentRow.__annotations__)
"""The columns of an experiment's rows."""


_PARTS = (
    ("max_overflow", "overflow"),
    ("vias", "wirelength"),
    ("pruned_overflow", "overflow"),
    ("pruned_wirelength", "wirelength"),
)
"""Columns that are at most another one."""


class PublishedRow(TypedDict):
    """What published results say of a problem."""

    set: Name
    problem: Name
    overflow: Count
    wirelength: Count


def solution_row(solution: Solution, seconds: float | None) -> Row:
    """The figures of a solution, and its time if it is known, under the names that all rows use."""
    return {**figures_of(solution), "seconds": None if seconds is None else round(seconds, 6)}


def figures_of(solution: Solution) -> Row:
    """The figures of a solution but its time: as it is, and without dangling branches and loops."""
    judged, less = evaluate(solution.problem, solution), solution.pruned()
    figures = asdict(judged)
    figures["open_nets"] = len(figures.pop("disconnected"))
    pruned = judged if less is solution else evaluate(solution.problem, less)
    figures |= {"pruned_overflow": pruned.overflow, "pruned_wirelength": pruned.wirelength}
    return {column: figures[column] for column in COLUMNS if column in figures}


def read_rows(path: Path, schema: type[Any] = ExperimentRow) -> list[Row]:
    """Reads the rows in a JSON file; columns that the schema lacks are left out.

    Args:
        path: the file.
        schema: the columns that every row must have, and their types.

    Raises:
        InputError: the file cannot be read or does not hold such rows; the message names the row,
            counted from 1, and the column.
    """
    text = read_text(path, MOST_BYTES)
    rows: dict[tuple[Any, ...], Row] = {}
    for number, raw in enumerate(build_json(list[Any], text, f"{path}: expected rows in JSON"), 1):
        where = f"{path}: row {number}"
        row: Row = build(schema, raw, where)
        for less, more in _PARTS:
            smaller = row.get(less)
            check(
                f"{where}: {less}", smaller is None or smaller <= row[more], f"at most the {more}"
            )
        joined, tasks = row["joined"], row["tasks"]
        fits = joined == tasks if None in (joined, tasks) else joined <= tasks
        check(f"{where}: joined", fits, "at most the tasks")
        key = tuple(row.get(column) for column in ("set", "problem", "router", "seed"))
        check(where, key not in rows, "every router once for each problem and seed")
        rows[key] = row
    return list(rows.values())


def read_reference(path: Path) -> dict[str, tuple[int, int]]:
    """Overflow and wirelength of the proven optima in an experiment's ``results.json``.

    Raises:
        InputError: the file cannot be read, has no proven rows, or two that differ for one name.
    """
    found: dict[str, tuple[int, int]] = {}
    for row in read_rows(path):
        if row["proven"]:
            best = row["overflow"], row["wirelength"]
            same = found.setdefault(row["problem"], best) == best
            check(f"{path}: {row['problem']}", same, "one optimum for all problems of that name")
    check(f"{path}", bool(found), "rows that are proven optimal, as the router optimal gives them")
    return found


_FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""What spreadsheets take for a formula, which can do harm, unless an apostrophe stands before it.

One more is put before apostrophes that are there already, so that it can be taken away again.
"""


def to_csv(rows: Sequence[Row]) -> str:
    """Rows of an experiment as CSV text; unknown values are empty fields.

    Text that a spreadsheet would take for a formula has an apostrophe before it, as OWASP
    recommends.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        formulas = {
            column: f"'{cell}"
            for column, cell in row.items()
            if isinstance(cell, str) and _FORMULA.match(cell)
        }
        writer.writerow({**row, **formulas})
    return text.getvalue()


def read_published(
    path: str, overflow: str = "overflow", wirelength: str = "wirelength"
) -> dict[tuple[str, str], tuple[int, int]]:
    """Reads overflow and wirelength by set and problem in a CSV file.

    Args:
        path: the file, with the columns ``set`` and ``problem``; further columns do not matter.
        overflow: the name of the overflow's column.
        wirelength: the name of the wirelength's column.

    Raises:
        InputError: the file cannot be read or does not hold such rows; the message names the line.
    """
    columns = {"set": "set", "problem": "problem", "overflow": overflow, "wirelength": wirelength}
    content = read_text(path, MOST_BYTES)
    found: dict[tuple[str, str], tuple[int, int]] = {}
    try:
        with io.StringIO(content, newline="") as lines:
            reader = csv.reader(lines, strict=True)
            header = next(reader, [])
            for column in columns.values():
                check(f"{path}:1", header.count(column) == 1, f"a column {column}, and only one")
            for cells in reader:
                where = f"{path}:{reader.line_num}"
                if not cells:
                    continue
                fits = len(cells) == len(header)
                check(where, fits, f"{len(header)} cells as in line 1, found {len(cells)}")
                text = {key: cells[header.index(column)] for key, column in columns.items()}
                names = {
                    key: text[key][_FORMULA.match(text[key]) and text[key][0] == "'" :]
                    for key in ("set", "problem")
                }
                # Only plain digits are a number: int() takes more, such as 1_000.
                counts = {
                    key: int(text[key]) if re.fullmatch("[0-9]{1,19}", text[key]) else text[key]
                    for key in ("overflow", "wirelength")
                }
                row = build(PublishedRow, {**names, **counts}, where)
                key = row["set"], row["problem"]
                check(where, key not in found, f"{'/'.join(key)} once")
                found[key] = row["overflow"], row["wirelength"]
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}: expected CSV: {error}") from None
    return found
