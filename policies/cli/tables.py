"""Tables that compare routers."""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import click
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


def show_speed(report: Mapping[str, Any]) -> None:
    """Prints what :func:`policies.bench.run` measured to standard output, a few lines a row."""
    click.echo(", ".join(f"{key} {value}" for key, value in report["machine"].items() if value))
    for row in report["rows"]:
        threads = f", {row['threads']} threads" if row["threads"] > 1 else ""
        target = f"; target {row['target']}" if row["target"] else ""
        click.echo(f"\n{row['name']}{threads}")
        click.echo(f"    {number(row['value'])} {row['unit']}, best {number(row['best'])}{target}")
        if row["ratio"] is not None:
            against = f"{row['comparator']} ({number(row['against'])})"
            click.echo(f"    {row['ratio']:.3g} × {against}")


def show_experiment(summary: Mapping[str, Any]) -> None:
    """Prints what :meth:`policies.experiment.Experiment.execute` found to standard output.

    A table for each set, and of several one for the routers that are for all of them.
    """
    # Wide enough for any row where there is no terminal to fit into.
    console = Console(width=None if sys.stdout.isatty() else 140)
    reference = summary["reference"]
    headings = ["router", "overflow", "problems\nwithout", "open", "wirelength", "gap\n%"]
    headings += ["less WL\n% of problems", "A*\nW/T/L"]
    headings += [f"{reference}\nW/T/L"] if reference else []
    for name, rows in summary["sets"].items():
        title = f"{name}: {rows[0]['problems']} problems"
        if name in summary["types"]:
            title += "".join(f", {n} of Type {type}" for type, n in summary["types"][name].items())
        table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
        for heading in (*headings, "seconds"):
            right = heading != "router"
            table.add_column(heading, justify="right" if right else "left", no_wrap=not right)
        for row in rows:
            gap, less = row["gap"], row["lower_wirelength"]
            few = f" ({gap['problems']})" if gap and gap["problems"] < row["problems"] else ""
            table.add_row(
                row["router"],
                f"{row['overflow']:.6g}",
                f"{row['zero_overflow']:.4g}",
                f"{row['open']:.6g}",
                _estimate(row["wirelength"], 1),
                _estimate(gap, 2) + few if gap else "",
                f"{less['percent']:.1f} [{less['low']:.0f}, {less['high']:.0f}]" if less else "",
                _record(row["astar"]),
                *([_record(row["reference"])] if reference else []),
                "" if row["seconds"] is None else f"{row['seconds']:.3g}",
            )
        console.print(table)
    console.print(_NOTES, highlight=False)


_NOTES = (
    "overflow, open connections: of all problems; without: problems with neither. wirelength, gap: "
    "mean over the problems ± half of its 95 % interval (Student's t); the gap is to the proven "
    "optimum, on the problems (how many) where overflow and open connections are the optimum's. "
    "less WL: problems with less wirelength than A* [95 % interval, Wilson]. W/T/L: wins, ties and "
    "losses by open connections, then overflow, then wirelength. seconds: median a problem. All of "
    "it is averaged over the seeds first. Type II: A* uses up an edge that had "
    "capacity (the paper's partial edge depletion)."
)


def _estimate(of: Mapping[str, Any], digits: int) -> str:
    if of["high"] is None:
        return f"{of['mean']:.{digits}f}"
    return f"{of['mean']:.{digits}f} ± {of['high'] - of['mean']:.{digits}f}"


def _record(record: Mapping[str, float] | None) -> str:
    return "/".join(f"{count:.3g}" for count in record.values()) if record else ""


def number(value: float) -> str:
    """A figure with three digits that count, thousands apart."""
    if value >= 1000:
        digits = 3 - len(f"{value:.0f}")
        return f"{round(value, digits):,.0f}".replace(",", " ")
    return f"{value:.3g}"
