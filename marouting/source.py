"""The forms in which a problem can be given."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from marouting.config import build, check
from marouting.errors import InputError
from marouting.generator import GeneratorOptions, generate_from
from marouting.options import SMALL, GameOptions
from marouting.problem.net import MAX_NUMBER
from marouting.problem.problem import Problem
from marouting.scenarios import Scenario, Split, get

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
    checked = SMALL if checked is None else checked
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


def fixed_problems(options: GameOptions) -> dict[str, Problem]:
    """The problems that the options of a game name, by name.

    Raises:
        InputError: they cannot be read, or there is no end of them.
    """
    if options.scenario is None:
        return load_problems(options.problem)
    if options.split == "train":
        raise InputError(
            f"split: expected validation or test, found train: of {options.scenario} there is no "
            "end of training problems, and these are to be known beforehand"
        )
    return get(options.scenario).problems(options.split)


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
        scenario: the name of a scenario, in place of a source.
        split: which problems of the scenario: every episode plays a new one of ``train``, or one
            drawn at random of ``validation`` or ``test``.

    Attributes:
        problems: those known beforehand, by name; where every episode plays a new one, an example.
        bounds: problems of which one has at least as many nets, and one at least as much capacity,
            as any that will be played.
        many: whether there are several.
        nets: the numbers of the nets that have something to route in at least one of them.

    Raises:
        InputError: a problem cannot be used, their grids differ, or there is no such scenario.
    """

    def __init__(self, source: Source, scenario: str | None = None, split: Split = "train") -> None:
        self._drawn: GeneratorOptions | Scenario | None = None
        if scenario is not None:
            check("problem", source is None, "none beside a scenario, which has its own")
            found, self.many = get(scenario), True
            # The same bounds in every split: what learns in one can play in the others.
            self.bounds = [found.largest]
            self.nets = list(range(len(found.largest.nets)))
            if split == "train":
                self._drawn, self.problems = found, {"example": found.largest}
            else:
                self.problems = found.problems(split)
            return
        source = checked_source(source)
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
        nets: set[int] = set()
        for name, problem in self.problems.items():
            routed = np.flatnonzero(np.diff(problem.flat_pin_gcells[0]) > 1)
            if not len(routed):
                raise InputError(f"{name}: expected a net with pins in two Gcells or more")
            nets.update(routed.tolist())
        self.nets = sorted(nets)
        # A generator's problems all have the same numbers of nets and of edges of each capacity.
        self.bounds = list(self.problems.values())

    def next(self, rng: np.random.Generator) -> tuple[str, Problem]:
        """The problem of the next episode and its name."""
        if self._drawn is not None:
            number = int(rng.integers(MAX_NUMBER))
            if isinstance(self._drawn, Scenario):
                return f"train_{number}", next(self._drawn.train(number))
            return f"seed_{number}", load_problem(replace(self._drawn, seed=number))
        names = list(self.problems)
        name = names[int(rng.integers(len(names)))] if len(names) > 1 else names[0]
        return name, self.problems[name]
