"""Negotiated congestion against an earlier checkout of this project.

    python -m policies.bench.negotiation --against EARLIER_CHECKOUT --out FILE.json

Each checkout routes in a process of its own. Both get the same problems, seeds and processor time,
in turns, so that whatever else the machine does slows both. The time of a run ends by the router's
option ``seconds``; compiling is done before. Families of problems, none of them used to choose the
router's defaults:

* ``a``: 16×16×2 Gcells, 80 nets of up to 5 pins, capacity 4.
* ``b``: 32×32×2 Gcells, 500 nets of up to 4 pins, capacity 9: far too much for the grid.
* ``c``: 16×16×2 Gcells, 80 two-pin nets, capacity 3.
* ``chip``: 64×64×2 Gcells, 8000 nets of up to 6 pins, most of them local, with two hot spots: about
  the size of ibm01.
* the test problems of the scenarios ``tight-16x16-v0`` and ``tight-32x32-v0``, which do not fit,
  and of ``mixed-v0`` and ``multi-pin-8x8-v0``, which do.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import click

from marouting import InputError, Problem, evaluate, generate, scenarios
from marouting.files import write_text
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

GENERATED: dict[str, dict[str, Any]] = {
    "a": {"count": 8, "grid": (16, 16, 2), "nets": 80, "max_pins": 5, "capacity": 4},
    "b": {"count": 3, "grid": (32, 32, 2), "nets": 500, "max_pins": 4, "capacity": 9},
    "c": {"count": 8, "grid": (16, 16, 2), "nets": 80, "max_pins": 2, "capacity": 3},
    "chip": {
        "count": 3,
        "grid": (64, 64, 2),
        "nets": 8000,
        "max_pins": 6,
        "capacity": 18,
        "reduced_edges": 0,
        "rent": 0.65,
        "hot_spots": 2,
    },
}
SCENARIOS = ("tight-16x16-v0", "tight-32x32-v0", "mixed-v0", "multi-pin-8x8-v0")
SEED = 2026
"""Of the generated problems."""


def problems(family: str) -> list[Problem]:
    """The problems of a family.

    Raises:
        InputError: there is no such family.
    """
    if family in SCENARIOS:
        return list(scenarios.get(family).test)
    if family in GENERATED:
        return generate(**GENERATED[family], seed=SEED)
    raise InputError(f"family: expected one of {', '.join((*GENERATED, *SCENARIOS))}")


def answer() -> None:
    """Routes what standard input asks for, a JSON object a line; the first line compiles."""
    known: dict[str, list[Problem]] = {}
    for line in sys.stdin:
        asked = json.loads(line)
        family = asked.pop("family")
        if family not in known:
            known[family] = problems(family)
        problem = known[family][asked.pop("problem")]
        began = time.process_time()
        solution = PathfinderRouter(PathfinderOptions(**asked)).route(problem)
        seconds = time.process_time() - began
        figures = evaluate(problem, solution)
        row = {"overflow": figures.overflow, "wirelength": figures.wirelength, "cpu": seconds}
        print(json.dumps({**row, "connected": figures.connected}), flush=True)


class Checkout:
    """A process that routes with one checkout's router.

    Args:
        folder: the checkout.
    """

    def __init__(self, folder: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(folder)}
        self._process = subprocess.Popen(
            [sys.executable, __file__, "answer"],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.route("a", 0, 0, 0.2)

    def route(self, family: str, problem: int, seed: int, seconds: float) -> dict[str, Any]:
        """Routes a problem and says how well, and in how many processor seconds (``cpu``).

        Raises:
            RuntimeError: the process has ended.
        """
        asked = {"family": family, "problem": problem, "seed": seed, "seconds": seconds}
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(asked), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("a checkout's process has ended")
        row: dict[str, Any] = json.loads(line)
        return row

    def close(self) -> None:
        """Ends the process."""
        self._process.communicate()


def measure(
    checkouts: dict[str, Checkout], families: Sequence[str], seeds: int, times: Sequence[float]
) -> Iterator[dict[str, Any]]:
    """Routes every problem with every seed and time, with the checkouts in turns."""
    for family in families:
        for seconds in times:
            for problem in range(len(problems(family))):
                for seed in range(seeds):
                    for name, checkout in checkouts.items():
                        row = checkout.route(family, problem, seed, seconds)
                        where = {"router": name, "family": family, "problem": problem}
                        yield {**where, "seed": seed, "seconds": seconds, **row}


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A table in Markdown: sums over the problems, mean and standard deviation over seeds.

    The router whose rows come first is the one that the others are compared with.
    """
    yield "| family | seconds | | overflow | wirelength |\n|---|---:|---|---:|---:|\n"
    for family, seconds in dict.fromkeys((row["family"], row["seconds"]) for row in rows):
        base: float | None = None
        for router in dict.fromkeys(row["router"] for row in rows):
            sums: dict[int, list[int]] = {}
            for row in rows:
                if (row["family"], row["seconds"], row["router"]) == (family, seconds, router):
                    total = sums.setdefault(row["seed"], [0, 0])
                    total[0] += row["overflow"]
                    total[1] += row["wirelength"]
            if not sums:
                continue
            overflow, wirelength = zip(*sums.values(), strict=True)
            mean = fmean(overflow)
            spread = stdev(overflow) if len(overflow) > 1 else 0.0
            gain = f" ({mean / base - 1:+.1%})" if base else ""
            base = mean if base is None else base
            yield (
                f"| {family} | {seconds:g} | {router} | {mean:.1f} ± {spread:.1f}{gain} | "
                f"{fmean(wirelength):.0f} |\n"
            )


def write_rows(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes rows to a JSON file, one a line."""
    lines = ",\n".join(json.dumps(row) for row in rows)
    write_text(file, f"[\n{lines}\n]\n")


def report(found: Iterable[dict[str, Any]], out: Path) -> None:
    """Writes rows to a file as they come, and their table to standard output."""
    rows: list[dict[str, Any]] = []
    for row in found:
        rows.append(row)
        click.echo(json.dumps(row), err=True)
        write_rows(out, rows)
    click.echo("".join(summary(rows)), nl=False)


def _checked(_context: click.Context, _option: click.Parameter, text: str) -> list[str]:
    names = text.split(",")
    try:
        for name in names:
            problems(name)
    except InputError as error:
        raise click.UsageError(str(error)) from None
    return names


def numbers(_context: click.Context, _option: click.Parameter, text: str) -> list[float]:
    """The numbers of an option's text, which commas part."""
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise click.BadParameter(f"expected numbers such as 0.2,1, found {text}") from None


families_option = click.option(
    "--families",
    default=",".join((*GENERATED, *SCENARIOS)),
    show_default=True,
    callback=_checked,
    help="Families of problems.",
)


@click.command()
@click.option("--against", type=Path, help="An earlier checkout of this project.")
@families_option
@click.option("--seeds", default=3, show_default=True, help="Seeds of the router per problem.")
@click.option(
    "--seconds",
    default="1",
    show_default=True,
    callback=numbers,
    help="Processor time: 0.2,1,5.",
)
@click.option("--out", type=Path, required=True, help="The JSON file to write.")
def main(
    against: Path | None, families: list[str], seeds: int, seconds: list[float], out: Path
) -> None:
    """Measures negotiated congestion; writes rows to a file, a table to standard output."""
    checkouts = {} if against is None else {"before": Checkout(against)}
    checkouts["now"] = Checkout(Path(__file__).resolve().parents[2])
    report(measure(checkouts, families, seeds, seconds), out)
    for checkout in checkouts.values():
        checkout.close()


if __name__ == "__main__":
    if sys.argv[1:] == ["answer"]:
        answer()
    else:
        main()
