"""Chip-like problems by which routers are timed: ``python -m policies.bench.chips FOLDER``.

Two have the size of designs in nangate45 (aes) and in sky130; the third is one of 50 000 nets in
the form of the ISPD 2024 contest.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from marouting import InputError, Problem, generate

CHIPS = {
    "nangate45": ((217, 295, 10), 18_908, 6, 5),
    "sky130": ((57, 101, 6), 7_508, 9, 6),
}
"""Grid, nets, capacity and most pins by name."""


def _local_nets(
    grid: tuple[int, int, int], nets: int, capacity: int, pins: int, hot_spots: int = 0
) -> Problem:
    """A problem with local nets and layers of one direction each."""
    options: Any = {"reduced_edges": 0, "rent": 0.7, "seed": 1, "hot_spots": hot_spots}
    return generate(1, grid, nets=nets, max_pins=pins, capacity=capacity, **options)[0]


def write_contest(path: Path, nets: int) -> None:
    """Writes a problem of the ISPD 2024 contest, PATH.cap and PATH.net.

    A wire of one Gcell costs 5 and a via 4, as in the contest; a Gcell that is just full 0.8 to
    2.6. There are 4 to 8 tracks in a Gcell.
    """
    side = round(nets**0.5)
    grid, rng = (side, side, 8), np.random.default_rng(1)
    problem = _local_nets(grid, nets, 9, 5)
    lines = [
        f"{grid[2]} {side} {side}",
        "0.00131579 4 " + " ".join(str(0.5 + 0.3 * z) for z in range(grid[2])),
        " ".join(["3800"] * (side - 1)),
        " ".join(["3800"] * (side - 1)),
    ]
    for z in range(grid[2]):
        lines.append(f"metal{z + 1} {z % 2} 400")
        free = rng.integers(4, 9, (side, side)) if z else np.zeros((side, side), int)
        lines += [" ".join(map(str, row)) for row in free.tolist()]
    path.with_suffix(".cap").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = []
    gcells = problem.pin_gcells
    for net, own in zip(problem.nets, gcells, strict=True):
        at = np.stack(np.unravel_index(np.asarray(own), problem.grid), axis=1)
        pins = [f"[({layer},{x},{y})]" for x, y, layer in at.tolist()]
        text.append("\n".join([net.name, "(", *pins, ")"]))
    path.with_suffix(".net").write_text("\n".join(text) + "\n", encoding="utf-8")


def main(folder: Path) -> None:
    """Writes all three."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, options in CHIPS.items():
        _local_nets(*options, hot_spots=3).write(folder / f"{name}.gr")
    write_contest(folder / "contest", 50_000)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"marouting: {InputError('expected a folder')}")
    main(Path(sys.argv[1]))
