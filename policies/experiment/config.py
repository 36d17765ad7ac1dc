"""The configuration of an experiment: sets of problems, routers, seeds, figures."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from marouting import InputError, Problem
from marouting.config import build, check, merged, override, plain, read_yaml
from marouting.files import is_dir, is_file_name, naming
from marouting.generator import GeneratorOptions
from marouting.options import PLAYED
from marouting.registry import allowing_code
from marouting.source import generated_name, load_problems, problems_in
from policies.engines import EngineName
from policies.learned.config import Config, for_learner
from policies.results.rows import read_published
from policies.results.statistics import ALL
from policies.results.study import Study, StudyColumn
from policies.routers.registry import (
    has_seed,
    is_learner,
    is_seeded,
    router_names,
    router_piece,
    unknown,
)

PUBLISHED = "published"
"""The ``router`` of an entry whose rows are read from a file."""


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """An experiment, as a YAML file holds it; ``configs/yardstick.yaml`` explains the keys.

    Attributes:
        out: the folder of the experiment. An experiment that it holds already is continued, with
            the same routers and sets or with others.
        seeds: a router that draws random numbers is run once for each seed.
        engine: where the work is done: ``local``, in processes of this machine, or ``ray``, as
            tasks of Ray (docs/scale.md).
        jobs: the number of processes; None stands for one per core. A Ray that runs already has
            its own.
        reference: the name of a router that all others are compared with, besides A*.
        problems: problem sources by the set's name (as ``env.problem`` of a training); or a folder,
            whose ``.gr`` files are a set, as are those of each folder in it.
        routers: the routers' options, by the name that tables give the router. The key ``router``
            says what routes: the name of a router, ``module:Class``, the name of a learner (see
            :class:`Training`) or ``published`` (see :class:`Published`). The key ``only`` lists the
            sets that the entry is for, by default all; ``prune: true`` takes what joins nothing
            (:meth:`marouting.Solution.pruned`) from its solutions before they are judged; ``label``
            is what figures call it. All other keys are options of the router, and those left out
            are filled in. None in place of the options leaves a router out, as
            ``routers.NAME=null`` does on the command line.
        train: keys of the run of every training, such as ``episodes``, in place of those of the
            entries. They become the entries' own.
        studies: composed figures by name, besides the figures of every set; None leaves one out.
            Columns of routers that are left out or not finished are left out, and so are those of
            problems that a smaller ``count`` on the command line leaves out.
    """

    out: str = "runs/experiment"
    seeds: tuple[int, ...] = (0,)
    engine: EngineName = "local"
    jobs: int | None = None
    reference: str | None = None
    problems: Any = None
    routers: dict[str, dict[str, Any] | None] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)
    studies: dict[str, Study | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, study in self.drawn.items():
            _check_name(f"studies.{name}", name)
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
        for name in self.routers:  # in file names, a dot and the seed follow
            _check_name(f"routers.{name}", name)
        if self.reference is not None and self.reference not in self.routers:
            raise unknown("reference", self.reference, tuple(self.routers))
        if self.train:
            entries = {entry.name: entry for entry in self.entries}
            trained = {name for name, entry in entries.items() if entry.trains}
            check("train", trained, "none: no router of this experiment is trained")
            told = {"train": self.train}
            kept = {name: merged(r, told) if name in trained else r for name, r in kept.items()}
            object.__setattr__(self, "routers", kept)
            object.__setattr__(self, "train", {})
        studies = {}
        for name, study in self.drawn.items():
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
    def drawn(self) -> dict[str, Study]:
        """The composed figures that are not left out."""
        return {name: study for name, study in self.studies.items() if study is not None}

    @property
    def entries(self) -> tuple["Entry", ...]:
        """The routers; raises InputError if one of them is wrong."""
        return tuple(Entry.of(name, raw or {}) for name, raw in self.routers.items())


def _check_name(key: str, name: str, also: str = "") -> None:
    """Raises InputError unless names of files can contain a name."""
    fits = re.fullmatch(rf"\w[\w{also}-]*", name) and is_file_name(name, _SUFFIX)
    check(key, fits, f"a name of letters, digits, _ and -{also and ' and '}{also}, not too long")


_SUFFIX = 48 * "."
"""As long as what follows a set, a router or a study in names of files, at most."""


def _check_set(name: str) -> None:
    """Raises InputError unless a set may have a name."""
    _check_name(f"problems.{name}", name, ".")
    check(f"problems.{name}", name != ALL, "another name: all sets together are called this")


@dataclass(frozen=True, kw_only=True)
class Training:
    """The options of an entry whose ``router`` is a learner: what to train, or a trained policy.

    Attributes:
        config: a YAML file with a training's configuration, which the other keys change.
        stack: the number of problems that one process trains side by side. More than one save time
            on a GPU, but not on a CPU. A learner shared by all problems takes a whole set.
        env: keys of the game, as in a training's configuration; the experiment gives the problems.
        learner: options of the learner.
        train: keys of the run; ``figures`` and ``tensorboard`` are off unless they are given here.
        checkpoint: the file of a trained policy, which routes without any training; no other key
            may then be given.
    """

    config: str | None = None
    stack: int = 1
    env: dict[str, Any] = field(default_factory=dict)
    learner: dict[str, Any] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)
    checkpoint: str | None = None

    def __post_init__(self) -> None:
        check("stack", self.stack >= 1, "a number from 1")
        for name in PLAYED:
            check(f"env.{name}", name not in self.env, "none: the experiment has its sets")
        told = self.config or self.env or self.learner or self.train
        check("checkpoint", not (self.checkpoint and told), "nothing to train beside it")

    def resolved(self, learner: str, where: str) -> dict[str, Any]:
        """The same options with every key of the training filled in.

        Args:
            learner: the learner's name, or ``module:Class``.
            where: what an error message starts with.

        Raises:
            InputError: a key is unknown or wrong.
        """
        if self.checkpoint:
            return {"checkpoint": self.checkpoint}
        raw = {} if self.config is None else read_yaml(self.config)
        raw = for_learner(raw, learner, self.config or where)
        quiet = {"train": {"figures": False, "tensorboard": False}}
        told = {"env": self.env, "learner": self.learner, "train": self.train}
        raw = merged(merged(raw, quiet), told)
        config: dict[str, Any] = plain(build(Config, for_learner(raw, learner, where), where))
        for name in PLAYED:
            del config["env"][name]
        return {"stack": self.stack, **{part: config[part] for part in PARTS}}


PARTS = ("env", "learner", "train")
"""The parts of a training's configuration that an entry holds."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """The options of an entry ``published``: results as others report them.

    Attributes:
        file: a CSV file with the columns ``set`` and ``problem``, and a row for every problem, as
            :func:`policies.results.rows.read_published` reads it.
        overflow: the name of the overflow's column.
        wirelength: the name of the wirelength's column.
        optimal: whether these are proven optima, from which gaps are measured.
    """

    file: str
    overflow: str = "overflow"
    wirelength: str = "wirelength"
    optimal: bool = False

    def read(self) -> dict[tuple[str, str], tuple[int, int]]:
        """Overflow and wirelength by set and problem; raises InputError naming file and line."""
        return read_published(self.file, self.overflow, self.wirelength)


@dataclass(frozen=True)
class Entry:
    """A router of an experiment.

    Attributes:
        name: the name that tables give it.
        router: the name of a router or a learner, ``module:Class`` or ``published``.
        only: the sets that it is for; None stands for all.
        prune: whether its solutions are pruned before they are judged.
        label: what figures call it; None stands for its name.
        options: all other options as plain data, defaults included.
        trains: whether it is a learner that is trained on the problems.
        seeded: whether it is run for every seed.
    """

    name: str
    router: str
    only: tuple[str, ...] | None
    prune: bool
    label: str | None
    options: Mapping[str, Any]
    trains: bool
    seeded: bool

    @property
    def plain(self) -> dict[str, Any]:
        """The entry as a configuration holds it."""
        own = {"router": self.router, "only": self.only, "prune": self.prune, "label": self.label}
        return {**own, **self.options}

    @staticmethod
    def of(name: str, raw: Mapping[str, Any]) -> "Entry":
        """An entry of a configuration; raises InputError if it is wrong."""
        where = f"routers.{name}"
        options = dict(raw)
        router, only = options.pop("router", None), options.pop("only", None)
        if only is not None and not (
            isinstance(only, list | tuple) and only and all(isinstance(name, str) for name in only)
        ):
            raise InputError(f"{where}: only: expected a list of sets, found {only!r}")
        prune, label = options.pop("prune", False), options.pop("label", None)
        check(f"{where}: prune", isinstance(prune, bool), "true or false")
        named = label is None or (isinstance(label, str) and label.strip() and len(label) <= _LABEL)
        check(f"{where}: label", named, f"a text of at most {_LABEL} characters")
        check(f"{where}: prune", not (prune and router == PUBLISHED), "none: there are no routes")
        trains = seeded = False
        if router == PUBLISHED:
            options = asdict(build(Published, options, where))
        elif not isinstance(router, str):
            raise unknown(f"{where}: router", str(router), (*router_names(), PUBLISHED))
        elif is_learner(router, f"{where}: router"):
            options = build(Training, options, where).resolved(router, where)
            trains = seeded = "checkpoint" not in options
        else:
            if "seed" in options and has_seed(router):
                raise InputError(f"{where}: seed: expected none: the experiment has its seeds")
            seed = {"seed": 0} if has_seed(router) else {}
            made = router_piece(router, {**options, **seed}, where)
            seeded = is_seeded(made)
            options = {key: value for key, value in plain(made).items() if key not in seed}
            del options["kind"]
        sets = None if only is None else tuple(only)
        return Entry(name, router, sets, prune, label, options, trains, seeded)


_LABEL = 80
"""The longest label, in characters."""


def load_experiment(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_code: bool = False
) -> ExperimentConfig:
    """Reads the configuration of an experiment and changes single keys of it.

    Args:
        path: a YAML file.
        overrides: ``key=value``, as :func:`marouting.config.override` takes them.
        allow_code: whether the file, and configurations that it names, may name pieces as
            ``module:Class``, which is code that is imported. Overrides always may.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    with allowing_code(allow_code):
        raw = read_yaml(path)
        config = build(ExperimentConfig, override(raw, overrides), os.fspath(path))
    sets = raw.get("problems")
    return _without_those_gone(config, sets) if isinstance(sets, Mapping) else config


def _without_those_gone(config: ExperimentConfig, sets: Mapping[str, Any]) -> ExperimentConfig:
    """A configuration without columns of problems that sets had before they were made smaller."""
    problems = config.problems if isinstance(config.problems, Mapping) else {}
    gone: dict[str, range] = {}
    for name in problems.keys() & sets.keys():
        now, before = (
            source.get("count", GeneratorOptions().count) if isinstance(source, Mapping) else None
            for source in (problems[name], sets[name])
        )
        if isinstance(now, int) and isinstance(before, int):
            gone[name] = range(now, before)
    entries = {entry.name: entry for entry in config.entries}

    def stays(column: StudyColumn) -> bool:
        only = entries[column.router].only
        own = [name for name in problems if only is None or name in only]
        of = column.set or (own[0] if len(own) == 1 else "")
        return column.problem not in [generated_name(number) for number in gone.get(of, ())]

    studies: dict[str, Study | None] = {}
    for name, study in config.drawn.items():
        columns = {title: column for title, column in study.columns.items() if stays(column)}
        if columns:
            studies[name] = replace(study, columns=columns)
    return replace(config, studies=studies)


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
    with naming(folder, "cannot be read"):
        folders = [folder, *sorted(path for path in folder.glob("*") if is_dir(path))]
        paths = {path.resolve().name: path for path in folders if problems_in(path)}
    if not paths:
        raise InputError(f"problems: {folder}: expected .gr files in this folder or those in it")
    for name in paths:
        _check_set(name)
    return {name: load_problems(str(path)) for name, path in paths.items()}
