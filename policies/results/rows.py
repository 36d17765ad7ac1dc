"""Rows of results: one router on one problem, as result files and tables hold them."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from marouting import InputError, Solution, evaluate
from marouting.files import read_text

Row = dict[str, Any]
"""One router on one problem (in an experiment: with one seed), plain data by column."""

MOST_BYTES = 2**30
"""The largest file of results that is read."""

COLUMNS = {
    "set": str,
    "problem": str,
    "router": str,
    "kind": str,
    "seed": int | None,
    "overflow": int,
    "max_overflow": int | None,
    "wirelength": int,
    "vias": int | None,
    "connected": bool | None,
    "joined": int | None,
    "tasks": int | None,
    "proven": bool | None,
    "seconds": float | int | None,
    "gap": float | int | None,
    "from": str | None,
}
"""The columns of an experiment's rows and their types.

``router`` is the name of the experiment's entry and ``kind`` the registered name (or
``module:Class``) of the router behind it. ``joined`` and ``tasks`` count two-pin tasks, ``proven``
says whether the solution is known to be optimal, ``seconds`` is the time to route the problem,
``gap`` is the wirelength above the proven optimum in %, and ``from`` names the episode or policy
that a learner's routes come from. A value that is not known is None: published results give only
overflow and wirelength.
"""


def solution_row(solution: Solution, seconds: float) -> Row:
    """The figures of a solution under the names that all rows use.

    Args:
        solution: the solution of a problem.
        seconds: the time that it took.
    """
    figures = asdict(evaluate(solution.problem, solution))
    del figures["disconnected"]
    return {**figures, "seconds": round(seconds, 6)}


def read_rows(path: Path, columns: Mapping[str, Any] = COLUMNS) -> list[Row]:
    """Reads the rows in a JSON file.

    Args:
        path: the file.
        columns: the columns that every row must have, with their types.

    Raises:
        InputError: the file cannot be read or does not hold such rows.
    """
    try:
        rows = json.loads(read_text(path, MOST_BYTES))
    except InputError:
        raise
    except (ValueError, RecursionError):
        rows = None
    if not isinstance(rows, list) or not all(
        isinstance(row, dict)
        and all(name in row and isinstance(row[name], kind) for name, kind in columns.items())
        for row in rows
    ):
        raise InputError(f"{path}: expected rows in JSON, with {', '.join(columns)}")
    return rows


def to_csv(rows: Sequence[Row]) -> str:
    """Rows of an experiment as CSV text; unknown values are empty fields."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
