"""Tables that compare routers."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

COLUMNS = (
    ("problem", "problem"),
    ("router", "router"),
    ("overflow", "overflow"),
    ("wirelength", "wirelength"),
    ("joined", "tasks joined"),
    ("seconds", "seconds"),
)


def show(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Prints rows as ``result.json`` holds them to standard output.

    Where nets stayed open, less wirelength is no merit: the tasks joined stand beside it. A column
    that no row has is left out.
    """
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
    columns = [(key, heading) for key, heading in COLUMNS if any(key in row for row in rows)]
    for _, heading in columns:
        left = heading in ("problem", "router")
        table.add_column(heading, justify="left" if left else "right", no_wrap=True)
    for row in rows:
        joined = f"{row['joined']}/{row['tasks']}"
        shown = {**row, "joined": joined, "seconds": f"{row['seconds']:.2f}"}
        table.add_row(*(str(shown[key]) for key, _ in columns))
    Console().print(table)
