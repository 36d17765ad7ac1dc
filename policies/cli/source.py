"""The argument PROBLEM of commands, and the options that tell where the rest of a problem is."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from marouting import Problem
from marouting.files import stem_of
from policies.cli.options import FILE, WHOLE


@dataclass(frozen=True)
class ProblemFile:
    """The file that a command is given as PROBLEM, and what its format needs beside it.

    Attributes:
        path: the file.
        lef: the LEF files of a ``.def`` file.
        tile: the size of a Gcell of a ``.def`` file.
        net: the ``.net`` file of a ``.cap`` file.
    """

    path: Path
    lef: tuple[Path, ...] = ()
    tile: tuple[int, int] | None = None
    net: Path | None = None

    @property
    def stem(self) -> str:
        """The problem's name."""
        return stem_of(self.path)

    def read(self) -> Problem:
        """The problem; raises InputError if it cannot be read."""
        return Problem.read(self.path, lef=self.lef, tile=self.tile, net=self.net)


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
        type=click.Tuple([WHOLE, WHOLE]),
        help="Width and height of a Gcell, in units of the .def file.  "
        "[default: its GCELLGRID, or 15 tracks]",
    )
    @click.option(
        "--net",
        type=FILE,
        help="The .net file of a .cap file.  [default: the .net file of the same name]",
    )
    @functools.wraps(command)
    def with_file(
        problem: Path,
        lef: tuple[Path, ...],
        tile: tuple[int, int] | None,
        net: Path | None,
        **rest: Any,
    ) -> None:
        command(problem=ProblemFile(problem, lef, tile, net), **rest)

    return with_file
