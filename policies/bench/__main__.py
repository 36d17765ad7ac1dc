"""The command ``python -m policies.bench``: measures sections and prints or stores the figures."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from marouting import InputError
from marouting.files import check_writable, write_text
from policies.bench.environment import batch, interfaces, observation, search, start
from policies.bench.measure import Bench, Measurement, machine
from policies.bench.training import training
from policies.cli.main import status
from policies.cli.options import FILE, json_option

SECTIONS: Mapping[str, Callable[[Bench], Iterator[Measurement]]] = {
    "start": start,
    "batch": batch,
    "observation": observation,
    "interfaces": interfaces,
    "search": search,
    "training": training,
}
"""What can be measured, by name."""


def run(sections: Sequence[str], bench: Bench) -> dict[str, Any]:
    """Measures sections and tells of every row on standard error.

    Returns:
        The machine and the rows, plain data.
    """
    for name in sections:
        if name not in SECTIONS:
            raise InputError(f"{name}: expected one of {', '.join(SECTIONS)}")
    rows = []
    for name in sections:
        click.echo(f"{name} ...", err=True)
        for row in SECTIONS[name](bench):
            rows.append({"section": name, **asdict(row)})
            click.echo(f"  {row.name}: {number(row.value)} {row.unit}", err=True)
    return {"machine": machine(), "repeats": bench.repeats, "rows": rows}


def show(report: Mapping[str, Any]) -> None:
    """Prints what :func:`run` measured, a few lines for each figure."""
    click.echo(", ".join(f"{key} {value}" for key, value in report["machine"].items() if value))
    for row in report["rows"]:
        threads = f", {row['threads']} threads" if row["threads"] > 1 else ""
        click.echo(f"\n{row['name']}{threads}")
        click.echo(f"    {number(row['value'])} {row['unit']}, best {number(row['best'])}")
        if row["ratio"] is not None:
            click.echo(f"    {row['ratio']:.3g} × {row['comparator']} ({number(row['against'])})")


def number(value: float) -> str:
    """A figure with three significant digits, thousands apart by a space that does not break."""
    if value >= 1000:
        digits = 3 - len(f"{value:.0f}")
        return f"{round(value, digits):,.0f}".replace(",", "\N{NO-BREAK SPACE}")
    return f"{value:.3g}"


@click.command()
@click.argument("sections", nargs=-1, metavar="[SECTION]...")
@click.option(
    "--repeats", type=int, default=7, show_default=True, help="Repeats of every measurement."
)
@click.option(
    "--threads",
    type=int,
    default=2,
    show_default=True,
    help="Threads of the multi-threaded measurements.",
)
@click.option("--out", type=FILE, help="JSON file for the results; without it, none is written.")
@json_option
def main(
    sections: tuple[str, ...], repeats: int, threads: int, out: Path | None, as_json: bool
) -> None:
    """Measure speed, as ratios to comparators that run in turns with the code.

    SECTION is one of start, batch, observation, interfaces, search and training; without it
    everything is measured, which takes several minutes.
    """
    if out is not None:
        check_writable(out)
    report = run(sections or tuple(SECTIONS), Bench(repeats, threads))
    if out is not None:
        write_text(out, json.dumps(report, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(report))
    else:
        show(report)


if __name__ == "__main__":
    sys.exit(status(None, main, "python -m policies.bench"))
