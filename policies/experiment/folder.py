"""The folder of an experiment: its files, and the rows in them."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from marouting import InputError
from marouting.files import unusable
from policies.results.statistics import Row

CONFIG, RESULTS, SUMMARY = "config.yaml", "results.json", "summary.json"

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
}
"""What a row holds: ``router`` is the name of the entry, ``kind`` what routes. ``proven``: whether
the solution is known to be optimal; ``gap``: to such a one, in %. None where there is nothing to
say: only overflow and wirelength are published."""


def label(router: str, seed: int | None) -> str:
    """A router's name with the seed, as files carry it."""
    return router if seed is None else f"{router}.seed{seed}"


def problem_file(folder: Path, set: str, problem: str) -> Path:
    """Where an experiment keeps a problem."""
    return folder / "problems" / set / f"{problem}.gr"


def solution_file(folder: Path, set: str, problem: str, router: str, seed: int | None) -> Path:
    """Where an experiment keeps a solution."""
    return folder / "solutions" / set / f"{problem}.{label(router, seed)}.solution"


def read_rows(path: Path, columns: Mapping[str, Any] = COLUMNS) -> list[Row]:
    """The rows in a file, with these columns at least; raises InputError if it holds none."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None
    except (ValueError, RecursionError):
        rows = None
    if not isinstance(rows, list) or not all(
        isinstance(row, dict)
        and all(name in row and isinstance(row[name], kind) for name, kind in columns.items())
        for row in rows
    ):
        raise InputError(f"{path}: expected rows in JSON, with {', '.join(columns)}")
    return rows


def read_results(folder: Path) -> list[Row]:
    """The rows of an experiment that is done; raises InputError."""
    return read_rows(folder / RESULTS)


def to_csv(rows: Sequence[Row]) -> str:
    """Rows as CSV; empty where there is nothing to say."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
