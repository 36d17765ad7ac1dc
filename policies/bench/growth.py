"""How time and memory of negotiated congestion grow with the nets, from files to files.

    python -m policies.bench.growth --nets 1000,10000,100000,1000000 --out FILE.json

A chip has as many Gcells in each of nine layers as nets, of up to five pins, and macros and hot
spots in proportion: all chips are as crowded. Each is generated in one process and routed in
another: its memory is that of reading, routing, judging and writing.
"""

import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from marouting import Problem, evaluate, generate
from policies.bench.negotiation import numbers, write_rows
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

_LAYERS = 9
_MACRO, _SPOT = 25_000, 40_000
"""Nets for which there is a macro, and a hot spot."""


def chip(nets: int, capacity: int, seed: int) -> Problem:
    """The chip with so many nets."""
    side = round(math.sqrt(nets))
    return generate(
        1,
        (side, side, _LAYERS),
        nets=nets,
        max_pins=5,
        capacity=capacity,
        reduced_edges=0,
        rent=0.7,
        macros=max(1, nets // _MACRO),
        hot_spots=max(1, nets // _SPOT),
        seed=seed,
    )[0]


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What some work gives, and the processor seconds that it took."""
    began = time.process_time()
    found = work()
    return found, time.process_time() - began


def measure(path: Path, passes: int, seconds: float) -> dict[str, Any]:
    """Routes a chip and says what it took: seconds by stage, and memory at most.

    Args:
        path: the chip's file.
        passes: the search ends after so many passes, of which the first is that of patterns.
        seconds: limit of processor time of the search.
    """
    quick = PathfinderRouter(PathfinderOptions(passes=1, seconds=None))
    router = PathfinderRouter(PathfinderOptions(passes=passes, seconds=seconds))
    router.warm_up(generate(1, (8, 8, 2), nets=20, max_pins=5, capacity=3, seed=0)[0])
    problem, read = timed(lambda: Problem.read(path))
    _, patterns = timed(lambda: quick.route(problem))
    routed, search = timed(lambda: router.solve(problem))
    figures, judge = timed(lambda: evaluate(problem, routed.solution))
    _, write = timed(lambda: routed.solution.write(path.with_suffix(".solution")))
    stages = {"read": read, "patterns": patterns, "searches": search - patterns}
    return {
        "nets": len(problem.nets),
        "grid": "x".join(map(str, problem.grid)),
        **{name: round(spent, 3) for name, spent in stages.items()},
        "judge": round(judge, 3),
        "write": round(write, 3),
        "gigabytes": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9, 3),
        "passes": routed.iterations,
        "stop": routed.stop,
        "rerouted": sum(each.routed for each in routed.history),
        "overflow_of_patterns": routed.history[0].overflow,
        "overflow": figures.overflow,
        "wirelength": figures.wirelength,
        "connected": figures.connected,
    }


_COLUMNS = {
    "nets": "nets",
    "grid": "Gcells",
    "read": "read",
    "patterns": "patterns",
    "searches": "searches",
    "judge": "judge",
    "write": "write",
    "gigabytes": "GB",
    "passes": "passes",
    "overflow_of_patterns": "overflow of patterns",
    "overflow": "in the end",
}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = ["| " + " | ".join(_COLUMNS.values()) + " |", "|" + "---:|" * len(_COLUMNS)]
    lines += ["| " + " | ".join(str(row[name]) for name in _COLUMNS) + " |" for row in rows]
    return "\n".join(lines)


@click.command()
@click.option(
    "--nets",
    default="1000,10000,100000",
    show_default=True,
    callback=numbers,
    help="Nets of each chip. A million take 7 GB and a quarter of an hour.",
)
@click.option("--capacity", default=28, show_default=True, help="Of an edge, in tracks.")
@click.option("--passes", default=20, show_default=True, help="Passes of a search, at most.")
@click.option("--seconds", default=500.0, show_default=True, help="Processor time of a search.")
@click.option("--seed", default=1, show_default=True, help="Seed of the chips.")
@click.option("--out", type=Path, required=True, help="The JSON file to write.")
def main(
    nets: list[float], capacity: int, passes: int, seconds: float, seed: int, out: Path
) -> None:
    """Measures how negotiated congestion grows; writes rows to a file, a table to the output."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for count in nets:
            path = Path(folder, f"{count:.0f}.gr")
            for step in ("make", "measure"):
                asked = [step, count, capacity, passes, seconds, seed, str(path)]
                work = [sys.executable, "-m", __spec__.name, json.dumps(asked)]
                answer = subprocess.run(work, stdout=subprocess.PIPE, text=True, check=True).stdout
            rows.append(json.loads(answer))
            write_rows(out, rows)
    click.echo(table(rows))


def answer(
    step: str, nets: float, capacity: int, passes: int, seconds: float, seed: int, at: str
) -> None:
    """Makes a chip, or measures it, in a process of its own."""
    if step == "make":
        chip(round(nets), capacity, seed).write(Path(at))
    else:
        click.echo(json.dumps(measure(Path(at), passes, seconds)))


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1].startswith("["):
        answer(*json.loads(sys.argv[1]))
    else:
        main()
