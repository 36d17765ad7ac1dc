"""What an experiment is told: sets of problems, routers, seeds, figures."""

import csv
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from marouting import InputError, Problem
from marouting.config import build, check, override, read_yaml
from marouting.config import plain as as_plain
from marouting.files import unusable
from marouting.source import load_problems
from policies.experiment.study import Study
from policies.learned.config import Config
from policies.results.statistics import ALL
from policies.routers.registry import ROUTERS, has_seed, is_seeded, schema, unknown

PUBLISHED = "published"
"""The router of an entry whose rows are not routed but read from a file."""


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """An experiment, as a YAML file holds it; ``configs/yardstick.yaml`` explains the keys.

    Attributes:
        out: the folder of the experiment; it may hold an experiment with the same routers and
            sets, or others, which then goes on.
        seeds: one run of each router that draws random numbers for every seed.
        jobs: processes at work; None: one a core.
        reference: the name of a router that all others are compared with, besides A*.
        problems: problem sources by the set's name (as ``env.problem`` of a training); or a
            folder, whose ``.gr`` files are a set and whose folders with such files are one each.
        routers: options by the name that tables call the router, with the keys ``router``, a name
            of :data:`policies.routers.registry.ROUTERS` or ``published``, and ``only``, the sets
            that it is for; all the others are the router's own. For ``dqn`` see :class:`Training`,
            for ``published`` :class:`Published`. What is left out is filled in. None in place of
            the options leaves a router out: for ``routers.NAME=null`` on the command line.
        studies: composed figures by their name, besides those of every set. Columns of routers that
            are left out, or not done, are left out.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    out: str = "runs/experiment"
    seeds: tuple[int, ...] = (0,)
    jobs: int | None = None
    reference: str | None = None
    problems: Any = None
    routers: dict[str, dict[str, Any] | None] = field(default_factory=dict)
    studies: dict[str, Study] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, study in self.studies.items():
            check(f"studies.{name}", _is_name(name), "a name of letters, digits, _ and -")
            for title, column in study.columns.items():
                key = f"studies.{name}.columns.{title}"
                for part, routers in (("router", (column.router,)), ("beside", column.beside)):
                    for router in routers:
                        if router not in self.routers:
                            raise unknown(f"{key}.{part}", router, tuple(self.routers))
        kept = {name: raw for name, raw in self.routers.items() if raw is not None}
        object.__setattr__(self, "routers", kept)
        check("seeds", len(self.seeds) > 0, "at least one")
        check("seeds", all(0 <= seed < 2**63 for seed in self.seeds), "numbers from 0")
        check("seeds", len(set(self.seeds)) == len(self.seeds), "every seed once")
        check("jobs", self.jobs is None or 1 <= self.jobs <= 1024, "a number from 1 to 1024")
        check("problems", isinstance(self.problems, str | dict), "a folder or sets by their name")
        check("problems", len(self.problems) > 0, "at least one set")
        check("routers", len(self.routers) > 0, "at least one")
        for name in self.problems if isinstance(self.problems, dict) else ():
            _check_set(name)
        for name in self.routers:  # in files a dot and the seed follow
            check(f"routers.{name}", _is_name(name), "a name of letters, digits, _ and -")
        if self.reference is not None and self.reference not in self.routers:
            raise unknown("reference", self.reference, tuple(self.routers))
        studies = {}
        for name, study in self.studies.items():
            columns = {
                title: replace(column, beside=tuple(r for r in column.beside if r in kept))
                for title, column in study.columns.items()
                if column.router in kept
            }
            if columns:
                studies[name] = replace(study, columns=columns)
        object.__setattr__(self, "studies", studies)
        plain = {entry.name: entry.plain for entry in self.entries}
        object.__setattr__(self, "routers", plain)

    @property
    def entries(self) -> tuple["Entry", ...]:
        """The routers; raises InputError for one that is none."""
        return tuple(Entry.of(name, raw or {}) for name, raw in self.routers.items())


def _is_name(name: str) -> bool:
    return re.fullmatch(r"\w[\w-]*", name) is not None


def _check_set(name: str) -> None:
    """Raises InputError unless files can carry the name of a set."""
    check(f"problems.{name}", re.fullmatch(r"\w[\w.-]*", name), "a name of letters, digits, _ - .")
    check(f"problems.{name}", name != ALL, "another name: that is what all sets are called")


@dataclass(frozen=True, kw_only=True)
class Training:
    """The options of an entry of the router ``dqn``: what to train, or a trained policy.

    Attributes:
        config: a training's configuration that the other keys change.
        stack: problems that one process trains side by side. More than one save time on a GPU, not
            on a processor. With ``dqn.shared`` it is all of a set.
        env: keys of the game, as in a training's configuration; ``problem`` is the experiment's.
        dqn: keys of the learner.
        train: keys of the run. ``figures`` and ``tensorboard`` are off unless they stand here.
        checkpoint: a trained policy, which walks; then nothing else stands here.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    config: str | None = None
    stack: int = 1
    env: dict[str, Any] = field(default_factory=dict)
    dqn: dict[str, Any] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)
    checkpoint: str | None = None

    def __post_init__(self) -> None:
        check("stack", self.stack >= 1, "a number from 1")
        check("env.problem", "problem" not in self.env, "none: the experiment has its sets")
        told = self.config or self.env or self.dqn or self.train
        check("checkpoint", not (self.checkpoint and told), "nothing to train beside it")

    def resolved(self, where: str) -> dict[str, Any]:
        """The same with every key of the training; raises InputError for one that there is not."""
        if self.checkpoint:
            return {"checkpoint": self.checkpoint}
        raw = {} if self.config is None else read_yaml(self.config)
        quiet = {"train": {"figures": False, "tensorboard": False}}
        told = {"env": self.env, "dqn": self.dqn, "train": self.train}
        plain = as_plain(build(Config, _merged(_merged(raw, quiet), told), where))
        del plain["env"]["problem"]
        return {"stack": self.stack, **{part: plain[part] for part in ("env", "dqn", "train")}}


def _merged(raw: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data in which ``more`` goes before ``raw``, key by key."""
    merged = dict(raw)
    for key, value in more.items():
        inner = merged.get(key)
        if isinstance(inner, Mapping) and isinstance(value, Mapping):
            value = _merged(inner, value)
        merged[key] = value
    return merged


@dataclass(frozen=True, kw_only=True)
class Published:
    """The options of an entry ``published``: results of others, not judged here.

    Attributes:
        file: a CSV file with the columns ``set`` and ``problem``, and a row for every problem.
        overflow: the column of the overflow.
        wirelength: the column of the wirelength.
        optimal: whether these are proven optima, which gaps are taken to.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    file: str
    overflow: str = "overflow"
    wirelength: str = "wirelength"
    optimal: bool = False

    def read(self) -> dict[tuple[str, str], tuple[int, int]]:
        """Overflow and wirelength by set and problem; raises InputError naming file and line."""
        found: dict[tuple[str, str], tuple[int, int]] = {}
        try:
            with Path(self.file).open(encoding="utf-8", newline="") as lines:
                reader = csv.DictReader(lines)
                for column in ("set", "problem", self.overflow, self.wirelength):
                    if column not in (reader.fieldnames or ()):
                        raise InputError(f"{self.file}:1: expected a column {column}")
                for line in reader:
                    where = f"{self.file}:{reader.line_num}"
                    key = line["set"], line["problem"]
                    if key in found:
                        raise InputError(f"{where}: expected {'/'.join(key)} once")
                    try:
                        found[key] = int(line[self.overflow]), int(line[self.wirelength])
                    except (TypeError, ValueError):
                        raise InputError(f"{where}: expected whole numbers") from None
        except OSError as error:
            raise unusable(self.file, "cannot be read", error) from None
        except (UnicodeDecodeError, csv.Error):
            raise InputError(f"{self.file}: expected CSV in UTF-8") from None
        return found


@dataclass(frozen=True)
class Entry:
    """A router of an experiment.

    Attributes:
        name: what tables call it.
        router: what it is.
        only: the sets that it is for; None: all.
        options: all other options, in plain data, defaults included.
    """

    name: str
    router: str
    only: tuple[str, ...] | None
    options: Mapping[str, Any]

    @property
    def trains(self) -> bool:
        """Whether it is a DQN that is trained on the problems."""
        return self.router == "dqn" and "checkpoint" not in self.options

    @property
    def seeded(self) -> bool:
        """Whether it is run for every seed."""
        if self.router in ("dqn", PUBLISHED):
            return self.trains
        return is_seeded(self.router, self.options)

    @property
    def plain(self) -> dict[str, Any]:
        """The entry as a configuration holds it."""
        return {"router": self.router, "only": self.only, **self.options}

    @staticmethod
    def of(name: str, raw: Mapping[str, Any]) -> "Entry":
        """An entry of a configuration; raises InputError if it is none."""
        where = f"routers.{name}"
        options = dict(raw)
        router, only = options.pop("router", None), options.pop("only", None)
        if router not in (*ROUTERS, PUBLISHED):
            raise unknown(f"{where}: router", str(router), (*ROUTERS, PUBLISHED))
        if only is not None and not (
            isinstance(only, list | tuple) and only and all(isinstance(name, str) for name in only)
        ):
            raise InputError(f"{where}: only: expected a list of sets, found {only!r}")
        if router == "dqn":
            options = build(Training, options, where).resolved(where)
        elif router == PUBLISHED:
            options = asdict(build(Published, options, where))
        else:
            if "seed" in options and has_seed(router):
                raise InputError(f"{where}: seed: expected none: the experiment has its seeds")
            options = asdict(build(schema(router), options, where))
            options.pop("seed", None)
        return Entry(name, router, None if only is None else tuple(only), options)


def load_experiment(
    path: str | os.PathLike[str], overrides: Sequence[str] = ()
) -> ExperimentConfig:
    """Reads the configuration of an experiment and changes single keys of it.

    Args:
        path: a YAML file.
        overrides: as of :func:`policies.learned.config.load_config`.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    return build(ExperimentConfig, override(read_yaml(path), overrides), os.fspath(path))


def load_sets(problems: str | Mapping[str, Any]) -> dict[str, dict[str, Problem]]:
    """The sets of an experiment: problems by name, by the set's name; raises InputError."""
    if isinstance(problems, Mapping):
        sets = {}
        for name, source in problems.items():
            try:
                sets[name] = load_problems(source)
            except InputError as error:
                raise InputError(f"problems.{name}: {error}") from None
        return sets
    folder = Path(problems)
    folders = [folder, *sorted(path for path in folder.glob("*") if path.is_dir())]
    paths = {path.resolve().name: path for path in folders if any(path.glob("*.gr"))}
    if not paths:
        raise InputError(f"problems: {folder}: expected .gr files in this folder or those in it")
    for name in paths:
        _check_set(name)
    return {name: load_problems(str(path)) for name, path in paths.items()}
