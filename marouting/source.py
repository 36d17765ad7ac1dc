"""The forms in which a problem can be given."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from marouting.config import build
from marouting.errors import InputError
from marouting.generator import GeneratorOptions, generate_from
from marouting.options import SMALL, GameOptions
from marouting.problem.problem import Problem

Source = (
    Problem | GeneratorOptions | str | os.PathLike[str] | Sequence[str] | Mapping[str, Any] | None
)
"""A problem, options of the generator, a file, a folder, a list of both; None: a small problem."""


def checked_source(source: Source) -> Problem | GeneratorOptions | tuple[str, ...]:
    """A source in one of three forms; raises InputError for anything else."""
    if source is None:
        return SMALL
    if isinstance(source, Problem | GeneratorOptions):
        return source
    if isinstance(source, str | os.PathLike):
        return (os.fspath(source),)  # which need not be UTF-8, as the text of a configuration is
    checked = build(GameOptions, {"problem": source}).problem
    return (checked,) if isinstance(checked, str) else checked


def load_problems(source: Source) -> dict[str, Problem]:
    """The problems that a source names.

    Returns:
        The problems by name. The name is the file's stem, preceded by its folder's name if stems
        repeat; generated problems are named problem_000 and so on.

    Raises:
        InputError: the source is not one, a file cannot be read, or a folder holds no ``.gr`` file.
    """
    source = checked_source(source)
    if isinstance(source, Problem):
        return {"problem": source}
    if isinstance(source, GeneratorOptions):
        return {generated_name(i): p for i, p in enumerate(generate_from(source))}
    files: list[Path] = []
    for entry in map(Path, source):
        inside = sorted(entry.glob("*.gr")) if entry.is_dir() else [entry]
        if not inside:
            raise InputError(f"{entry}: expected a .gr file in this folder")
        files += inside
    names = [file.stem for file in files]
    if len(set(names)) < len(names):
        names = [f"{file.parent.name}_{file.stem}" for file in files]
    if len(set(names)) < len(names):
        raise InputError("problem: expected every file once, with different names")
    return {name: Problem.read(file) for name, file in zip(names, files, strict=True)}


def generated_name(number: int) -> str:
    """The name of a generated problem, given its place in the set."""
    return f"problem_{number:03d}"


def load_problem(source: Source) -> Problem:
    """The only problem that a source names; raises InputError for none or several."""
    source = checked_source(source)
    if isinstance(source, GeneratorOptions) and source.count != 1:
        raise InputError(f"problem: expected one, found {source.count}")
    problems = load_problems(source)
    if len(problems) != 1:
        raise InputError(f"problem: expected one, found {len(problems)}")
    return next(iter(problems.values()))
