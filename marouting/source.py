"""The forms in which a problem can be given."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from marouting.config import build
from marouting.errors import InputError
from marouting.generator import GeneratorOptions, generate_from
from marouting.options import SMALL, GameOptions
from marouting.problem.net import MAX_NUMBER
from marouting.problem.problem import Problem

Source = (
    Problem
    | Sequence[Problem]
    | GeneratorOptions
    | str
    | os.PathLike[str]
    | Sequence[str]
    | Mapping[str, Any]
    | None
)
"""A problem or several, options of the generator, a file, a folder, a list of both; None: a small
problem."""

MOST_PROBLEMS = 10_000
"""The most problems that an environment keeps."""


def checked_source(source: Source) -> tuple[Problem, ...] | GeneratorOptions | tuple[str, ...]:
    """A source in one of three forms; raises InputError for anything else."""
    if source is None:
        return SMALL
    if isinstance(source, GeneratorOptions):
        return source
    if isinstance(source, Problem):
        return (source,)
    if isinstance(source, list | tuple) and source and isinstance(source[0], Problem):
        if not all(isinstance(problem, Problem) for problem in source):
            raise InputError("problem: expected only objects of class Problem in the list")
        return tuple(source)
    if isinstance(source, str | os.PathLike):
        return (os.fspath(source),)  # which need not be UTF-8, as the text of a configuration is
    checked = build(GameOptions, {"problem": source}).problem
    return (checked,) if isinstance(checked, str) else checked


def load_problems(source: Source) -> dict[str, Problem]:
    """The problems that a source names.

    Returns:
        The problems by name. The name is the file's stem, preceded by its folder's name if stems
        repeat; others are named problem_000 and so on, or problem if there is only one.

    Raises:
        InputError: the source is not one, a file cannot be read, or a folder holds no ``.gr`` file.
    """
    source = checked_source(source)
    if isinstance(source, GeneratorOptions):
        return {generated_name(i): p for i, p in enumerate(generate_from(source))}
    if not source:
        raise InputError("problem: expected at least one, found an empty list")
    if isinstance(source[0], Problem):
        return {generated_name(i) if source[1:] else "problem": p for i, p in enumerate(source)}
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


class Episodes:
    """The problems that an environment plays, one per episode.

    Args:
        source: one problem; several, of which every episode plays one drawn at random; or options
            of the generator with ``seed=None``, by which every episode plays a new one.

    Attributes:
        problems: those known beforehand, by name; of a generator without a seed an example.
        many: whether there are several.

    Raises:
        InputError: a problem cannot be used, or their grids differ.
    """

    def __init__(self, source: Source) -> None:
        source = checked_source(source)
        self._drawn: GeneratorOptions | None = None
        if isinstance(source, GeneratorOptions):
            if source.count > (1 if source.seed is None else MOST_PROBLEMS):
                most = "1 without a seed" if source.seed is None else f"at most {MOST_PROBLEMS}"
                raise InputError(f"problem.count: expected {most}, found {source.count}")
            if source.seed is None:
                self._drawn = source
                source = replace(source, seed=0)
        self.problems = load_problems(source)
        self.many = self._drawn is not None or len(self.problems) > 1
        grids = {problem.grid for problem in self.problems.values()}
        if len(grids) > 1:
            raise InputError(f"problem: expected one grid shape, found {sorted(grids)}")
        for name, problem in self.problems.items():
            if (np.diff(problem.flat_pin_gcells[0]) < 2).all():
                raise InputError(f"{name}: expected a net with pins in two Gcells or more")

    def next(self, rng: np.random.Generator) -> tuple[str, Problem]:
        """The problem of the next episode and its name."""
        if self._drawn is not None:
            number = int(rng.integers(MAX_NUMBER))
            return f"seed_{number}", load_problem(replace(self._drawn, seed=number))
        names = list(self.problems)
        name = names[int(rng.integers(len(names)))] if len(names) > 1 else names[0]
        return name, self.problems[name]
