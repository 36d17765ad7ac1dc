"""The argument PROBLEM of commands, and the options that tell where the rest of a problem is."""

import functools
import itertools
import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from marouting import Controls, ProblemFile
from marouting.config import build
from marouting.errors import InputError
from marouting.yaml_files import override
from policies.cli.options import FILE


def problem_argument(command: Callable[..., None]) -> Callable[..., None]:
    """Gives a command the argument PROBLEM, as a :class:`ProblemFile`, and its options."""

    @click.argument("problem", type=FILE)
    @click.option(
        "--lef",
        type=FILE,
        multiple=True,
        help="LEF file of a .def file; may be given several times, technology first.  "
        "[default: the .lef file of the same name]",
    )
    @click.option(
        "--tile",
        type=click.Tuple([int, int]),
        help="Width and height of a Gcell, in units of the .def file.  "
        "[default: its GCELLGRID, or 15 tracks]",
    )
    @click.option(
        "--net",
        type=FILE,
        help="The .net file of a .cap file.  [default: the .net file of the same name]",
    )
    @click.option(
        "--control",
        "controls",
        metavar="KEY=VALUE",
        multiple=True,
        help="Changes the problem before it is used, such as layers=2..6, derate={2..: 0.8} or "
        "keep=FILE; may be given several times, each key once. The keys are "
        f"{', '.join(own.name for own in fields(Controls))}. "
        "Without it, the problem stays as the file gives it.",
    )
    @functools.wraps(command)
    def with_file(
        problem: Path,
        lef: tuple[Path, ...],
        tile: tuple[int, int] | None,
        net: Path | None,
        controls: tuple[str, ...],
        **rest: Any,
    ) -> None:
        keys = sorted(f"{control.partition('=')[0]}." for control in controls)
        for key, other in itertools.pairwise(keys):
            if other.startswith(key):  # one would replace the other
                given = f"{key[:-1]} and {other[:-1]}" if other != key else "it twice"
                raise InputError(f"--control {key[:-1]}: expected one value, found {given}")
        adjusting = build(Controls, override({}, controls), "--control")
        file = ProblemFile(
            path=os.fspath(problem),
            lef=tuple(map(os.fspath, lef)),
            tile=tile,
            net=None if net is None else os.fspath(net),
            **vars(adjusting),
        )
        command(problem=file, **rest)

    return with_file
