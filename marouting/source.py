"""The forms in which a problem can be given."""

import copy
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.setup import Room
from marouting.config import build, check
from marouting.errors import InputError
from marouting.files import is_dir, stem_of, suffix_of
from marouting.generator import GeneratorOptions, generate_from
from marouting.options import SMALL, GameOptions
from marouting.problem.controls import ProblemFile
from marouting.problem.net import MAX_NUMBER, is_whole
from marouting.problem.problem import Problem
from marouting.scenarios import Scenario, Split, get

Source = (
    Problem
    | Sequence[Problem]
    | GeneratorOptions
    | ProblemFile
    | str
    | os.PathLike[str]
    | Sequence[str]
    | Mapping[str, Any]
    | None
)
"""A problem or several, options of the generator, a file, perhaps with controls, a folder, a list
of files and folders; None: a small problem."""

Checked = tuple[Problem, ...] | GeneratorOptions | ProblemFile | tuple[str, ...]
"""A source that has been checked."""

OTHER_GAME = "saved: expected the state of a game with this problem and options"
"""The message where a saved state is restored into another environment."""

AHEAD = 1024  # problems of a stream without end that are drawn ahead
MOST_PROBLEMS = 10_000  # the most problems that an environment keeps


def checked_source(source: Source) -> Checked:
    """A source in one of four forms; raises InputError for anything else."""
    if source is None:
        return SMALL
    if isinstance(source, GeneratorOptions | ProblemFile):
        return source
    if isinstance(source, Problem):
        return (source,)
    if isinstance(source, list | tuple) and any(isinstance(one, Problem) for one in source):
        if not all(isinstance(one, Problem) for one in source):
            raise InputError(
                "problem: expected only objects of class Problem in the list, or only files"
            )
        return tuple(source)
    if isinstance(source, str | os.PathLike):
        return (os.fspath(source),)  # which need not be UTF-8, as the text of a configuration is
    if isinstance(source, Scenario):
        raise InputError(f"problem: expected scenario={source.name!r} in place of it")
    if isinstance(source, Iterator):
        raise InputError(
            "problem: expected a list, whose problems are drawn at random, or a generator's "
            f"options, found a {type(source).__name__}, which can be read only once"
        )
    checked = build(GameOptions, {"problem": source}).problem
    checked = SMALL if checked is None else checked
    return (checked,) if isinstance(checked, str) else checked


def load_problems(source: Source) -> dict[str, Problem]:
    """The problems that a source names.

    Returns:
        The problems by name. The name is the file's stem, preceded by its folder's name if stems
        repeat; others are named problem_000 and so on, or problem if there is only one.
    """
    source = checked_source(source)
    if isinstance(source, GeneratorOptions):
        return {generated_name(i): p for i, p in enumerate(generate_from(source))}
    if isinstance(source, ProblemFile):
        return {source.stem: source.read()}
    if not source:
        raise InputError("problem: expected at least one, found an empty list")
    if isinstance(source[0], Problem):
        return {generated_name(i) if source[1:] else "problem": p for i, p in enumerate(source)}
    check("problem", "" not in source, "a file or a folder, found ''")
    files: list[Path] = []
    for entry in map(Path, source):
        inside = problems_in(entry) if is_dir(entry) else [entry]
        if not inside:
            raise InputError(f"{entry}: expected a .gr file in this folder")
        files += inside
    names = [stem_of(file) for file in files]
    if len(set(names)) < len(names):
        names = [f"{file.parent.name}_{stem_of(file)}" for file in files]
    if len(set(names)) < len(names):
        raise InputError("problem: expected every file once, with different names")
    return {name: Problem.read(file) for name, file in zip(names, files, strict=True)}


def problems_in(folder: Path) -> list[Path]:
    """The ``.gr`` files of a folder, in the order of their names."""
    return sorted(file for file in folder.glob("*") if suffix_of(file) == ".gr")


def check_routed(name: str, problem: Problem) -> None:
    """Raises InputError for a problem, called by its name, without a net to route."""
    if not problem.to_route.any():
        raise InputError(f"{name}: expected a net with pins in two Gcells or more")


def fixed_problems(options: GameOptions) -> dict[str, Problem]:
    """The problems that the options of a game name, by name."""
    if options.scenario is None:
        return load_problems(options.problem)
    if options.split == "train":
        raise InputError(
            "split: expected validation or test, found train: the training problems of "
            f"{options.scenario} are endless; to train on them, set train.shared: true and "
            "train.games"
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


class ProblemStream:
    """The problems that an environment plays, one per episode.

    Every problem that may be drawn has a number, from which it can be made again.

    Args:
        source: one problem; several, from which every episode draws one; or options of the
            generator with ``seed=None``, which makes a new one for every episode.
        scenario: the name of a scenario, instead of a source.
        split: which problems of the scenario.
        held_out: how many of the first numbers of a generator's problems are never drawn.
        most: how many of a scenario's training problems, or of a generator's, are ever drawn; they
            are kept, because making a problem takes longer than playing it. None: no limit.

    Attributes:
        problems: by name; if every episode has a new one, an example.
        bounds: problems with at least as many nets, and as much capacity, as any to be played.
        room: the array sizes that fit all of them.
        many: whether there are several problems.
        held_out: how many of the first numbers are never drawn.
        most: how many numbers may be drawn; None: all.
        nets: the numbers of the nets that have something to route in at least one of them.

    Raises:
        InputError: a problem cannot be used, their grids differ, or there is no such scenario.
    """

    def __init__(
        self,
        source: Source,
        scenario: str | None = None,
        split: Split = "train",
        *,
        held_out: int = 0,
        most: int | None = None,
    ) -> None:
        self.held_out, self.most = held_out, most
        self._numbers = MAX_NUMBER - held_out if most is None else most
        self._kept: dict[int, tuple[str, Problem]] | None = None if most is None else {}
        self._drawn: GeneratorOptions | Scenario | None = None
        if scenario is not None:
            check("problem", source is None, "none beside a scenario, which has its own")
            found, self.many = get(scenario), True
            # The same bounds in every split: what learns in one can play in the others.
            self.bounds = found.bounds
            self.room = Room.of(self.bounds)
            self.nets = list(range(self.room.nets))
            if split == "train":
                largest = max(self.bounds, key=lambda problem: len(problem.nets))
                self._drawn, self.problems = found, {"example": largest}
            else:
                self.problems = found.problems(split)
            return
        source = checked_source(source)
        if isinstance(source, GeneratorOptions):
            if source.count > (1 if source.seed is None else MOST_PROBLEMS):
                what = "1 without a seed" if source.seed is None else f"at most {MOST_PROBLEMS}"
                raise InputError(f"problem.count: expected {what}, found {source.count}")
            if source.seed is None:
                self._drawn = source
                source = replace(source, seed=0, least=None)  # as large as any of them
        self.problems = load_problems(source)
        self.many = self._drawn is not None or len(self.problems) > 1
        grids = {problem.grid for problem in self.problems.values()}
        if len(grids) > 1:
            raise InputError(f"problem: expected one grid shape, found {sorted(grids)}")
        nets: set[int] = set()
        for name, problem in self.problems.items():
            check_routed(name, problem)
            nets.update(np.flatnonzero(problem.to_route).tolist())
        self.nets = sorted(nets)
        # A generator's problems all have the same numbers of nets and of edges of each capacity.
        self.bounds = list(self.problems.values())
        self.room = Room.of(self.bounds)
        if isinstance(self._drawn, GeneratorOptions):
            self.room = Room(self._drawn.nets, self._drawn.nets * self._drawn.max_pins)

    @classmethod
    def of(cls, problems: Mapping[str, Problem]) -> "ProblemStream":
        """Episodes that each play one of some problems, which have names; raises InputError."""
        found = cls(list(problems.values()))
        found.problems = dict(problems)
        return found

    @property
    def endless(self) -> bool:
        """Whether every episode has a new problem."""
        return self._drawn is not None

    @property
    def identity(self) -> tuple[Any, ...]:
        """What is equal for the same problems."""
        drawn = self._drawn.name if isinstance(self._drawn, Scenario) else self._drawn
        return drawn, self.held_out, self.most, *self.problems.values()

    def number(self, rng: np.random.Generator) -> int:
        """Draws the number of a problem."""
        if self._drawn is not None:
            return self.held_out + int(rng.integers(self._numbers))
        return int(rng.integers(len(self.problems))) if len(self.problems) > 1 else 0

    def problem(self, number: int) -> tuple[str, Problem]:
        """The problem with a number, and its name."""
        if self._kept is None:
            return self._made(number)
        if number not in self._kept:
            self._kept[number] = self._made(number)
        return self._kept[number]

    def _made(self, number: int) -> tuple[str, Problem]:
        """The problem with a number, made anew, and its name."""
        if isinstance(self._drawn, Scenario):
            return f"train_{number}", next(self._drawn.train(number))
        if self._drawn is not None:
            return f"seed_{number}", load_problem(replace(self._drawn, seed=number))
        return list(self.problems.items())[number]

    def ahead(self, count: int | None, seed: int) -> list[tuple[str, Problem]]:
        """Problems to draw ahead of all episodes, with their names.

        Args:
            count: how many; None: all that there are, or 1024 of a stream without end.
            seed: decides which, where there are more.
        """
        numbers = range(self.held_out, self.held_out + (self.most or 0))
        if not self.endless:
            numbers = range(len(self.problems))
        if len(numbers) and (count is None or count >= len(numbers)):
            return list(map(self.problem, numbers))
        rng = np.random.default_rng(seed)
        return [self.next(rng) for _ in range(count or AHEAD)]

    def next(self, rng: np.random.Generator) -> tuple[str, Problem]:
        """The problem of the next episode and its name."""
        return self.problem(self.number(rng))


class ProblemSampler:
    """Draws the problems of M games, one for every episode.

    The problem depends only on the seed, the game's index and the number of the episode, not on
    other games.

    Attributes:
        seeds: (M,) objects, the seed of each game.
        counts: (M,) int64, the episodes that each game has begun.
        problems: (M,) objects, what each game plays, or will play first.
        names: (M,) objects, their names.
    """

    def __init__(self, episodes: ProblemStream, seed: int, games: int) -> None:
        whole = is_whole(games) and 1 <= games <= MOST_PROBLEMS
        check("number of games", whole, f"1 to {MOST_PROBLEMS}, found {games!r}")
        self.episodes = episodes
        self.seeds = np.full(games, checked_seed(seed), object)
        self.counts = np.zeros(games, np.int64)
        self._games = np.arange(games)
        self._numbers = np.array([self._number(m) for m in range(games)])
        self.names, self.problems = np.empty((2, games), object)
        for m, number in enumerate(self._numbers.tolist()):
            self.names[m], self.problems[m] = episodes.problem(number)

    def part(self, which: NDArray[np.integer] | slice) -> "ProblemSampler":
        """The draws of some of the games (indices); with a slice, the two share their arrays."""
        part = copy.copy(self)
        for name in ("seeds", "counts", "names", "problems", "_games", "_numbers"):
            setattr(part, name, getattr(self, name)[which])
        return part

    def begin(self, seeds: Sequence[int | None], which: NDArray[np.bool_]) -> None:
        """Begins with other seeds and first episodes in games ``which`` (M,) that are given one."""
        for m in np.flatnonzero(which).tolist():
            if seeds[m] is not None:
                self.seeds[m], self.counts[m] = checked_seed(seeds[m]), 0

    def go_to(
        self, counts: NDArray[np.integer], seeds: NDArray[np.object_] | None = None
    ) -> list[int]:
        """Goes to some numbers of begun episodes (M,); returns the games whose problem changes."""
        if seeds is not None:
            self.seeds[:] = seeds
        self.counts[:] = counts
        return self._place(range(len(counts)))

    def begin_next(self, which: NDArray[np.bool_]) -> list[int]:
        """Goes on to the next episodes of the games in ``which`` (M,); returns as :meth:`go_to`."""
        self.counts += which
        return self._place(np.flatnonzero(which).tolist())

    def _place(self, games: Iterable[int]) -> list[int]:
        """Puts the problems of games in place; returns those where it is another one."""
        changed = []
        for m in games:
            number = self._number(m)
            if number != self._numbers[m]:
                self._numbers[m] = number
                self.names[m], self.problems[m] = self.episodes.problem(number)
                changed.append(m)
        return changed

    def _number(self, m: int) -> int:
        """The number of the problem that game m plays now, or will play first."""
        episode = max(int(self.counts[m]) - 1, 0)
        rng = np.random.default_rng([self.seeds[m], int(self._games[m]), episode])
        return self.episodes.number(rng)


class OwnProblemSampler(ProblemSampler):
    """Draws of games that have a seed of their own: each draws as an environment of its own does.

    The first seed of game m is ``seed + m``, as in Gymnasium's vectors.
    """

    def __init__(self, episodes: ProblemStream, seed: int, games: int) -> None:
        # By place: the seed, what draws, the number of the last episode, and that of its problem.
        self._last: dict[int, tuple[int, np.random.Generator, int, int]] = {}
        super().__init__(episodes, seed, games)
        self.seeds[:] = [int(self.seeds[m]) + m for m in range(games)]
        self.go_to(self.counts)

    def _number(self, m: int) -> int:
        """The number of the problem that game m plays now, or will play first."""
        place, seed, episode = int(self._games[m]), self.seeds[m], max(int(self.counts[m]) - 1, 0)
        last = self._last.get(place)
        if last is None or last[0] != seed or last[2] > episode:
            rng = np.random.default_rng(seed)
            last = seed, rng, 0, self.episodes.number(rng)
        _, rng, at, number = last
        for _ in range(at, episode):
            number = self.episodes.number(rng)
        self._last[place] = seed, rng, episode, number
        return number


def checked_seed(seed: Any) -> int:
    """A seed as an int; raises InputError for all but a whole number from 0."""
    check("seed", is_whole(seed) and seed >= 0, f"a whole number from 0, found {seed!r}")
    return int(seed)
