"""The configuration of an experiment: sets of problems, routers, seeds."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from marouting import InputError, Problem, scenarios
from marouting.config import build, check, plain
from marouting.files import is_dir, is_file_name, naming
from marouting.options import PLAYED
from marouting.registry import allowing_code, lookup
from marouting.source import load_problems, problems_in
from marouting.yaml_files import merged, override, read_yaml
from policies.engines import EngineName
from policies.experiment.played import is_policy
from policies.learned.config import config_of, for_learner
from policies.results.rows import read_published
from policies.results.statistics import ALL
from policies.routers.registry import (
    has_seed,
    is_learner,
    is_seeded,
    router_component,
    router_names,
    unknown,
)

PUBLISHED = "published"
"""The ``router`` of an entry whose rows are read from a file."""

SOLUTIONS = "solutions"
"""The ``router`` of an entry whose solutions are read from a folder."""

PARTS = ("env", "learner", "train")
"""The parts of a training's configuration that an entry holds."""

RULE_COST = (
    "a known best local rule (`python -m policies.experiment.anarchy module:NAME` finds that of "
    "your own scenario)"
)
"""What scenarios need in which policies play, in words."""

Split = Literal["test", "validation"]
"""The problems of a scenario that can be compared on."""


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """An experiment, as a YAML file holds it; ``configs/yardstick.yaml`` explains the keys.

    Attributes:
        out: the folder of the experiment. An experiment that it holds already is continued, with
            the same routers and sets or with others.
        seeds: a router that draws random numbers is run once for each seed.
        engine: where the work is done: ``local``, in processes of this machine, or ``ray``, as
            tasks of Ray (docs/performance.md).
        jobs: the number of processes; None stands for one per core. A Ray that runs already has
            its own.
        reference: the name of a router that all others are compared with, besides A*.
        problems: problem sources by the set's name (as ``env.problem`` of a training, or
            ``{scenario: NAME, split: test}``); or a folder, whose ``.gr`` files are a set, as are
            those of each folder in it.
        routers: the routers' options, by the name that tables give the router. The key ``router``
            says what routes: the name of a router, ``module:Class``, the name of a learner (see
            :class:`Training`), ``published`` (see :class:`Published`) or ``solutions`` (see
            :class:`ExternalSolutions`). The key ``only`` lists the sets that the entry is for, by
            default all; ``prune: true`` takes dangling branches and loops
            (:meth:`marouting.Solution.pruned`) from its solutions before they are judged; ``label``
            is what figures call it; ``budget`` is what it may spend (see :class:`Budget`). All
            other keys are options of the router, and those left out are filled in. None in place of
            the options leaves a router out, as ``routers.NAME=null`` does on the command line.
        train: keys of the run of every training, such as ``episodes``, in place of those of the
            entries. They become the entries' own.
    """

    out: str = "runs/experiment"
    seeds: tuple[int, ...] = (0,)
    engine: EngineName = "local"
    jobs: int | None = None
    reference: str | None = None
    problems: Any = None
    routers: dict[str, dict[str, Any] | None] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kept = {name: raw for name, raw in self.routers.items() if raw is not None}
        check("seeds", len(self.seeds) > 0, "at least one")
        check("seeds", all(0 <= seed < 2**63 for seed in self.seeds), "numbers from 0")
        check("seeds", len(set(self.seeds)) == len(self.seeds), "every seed once")
        check("jobs", self.jobs is None or 1 <= self.jobs <= 1024, "a number from 1 to 1024")
        check("problems", isinstance(self.problems, str | dict), "a folder or sets by their name")
        check("problems", len(self.problems) > 0, "at least one set")
        check("routers", len(kept) > 0, "at least one")
        for name in self.problems if isinstance(self.problems, dict) else ():
            _check_set(name)
        for name in kept:  # in file names, a dot and the seed follow
            _check_name(f"routers.{name}", name)
        if self.reference is not None and self.reference not in kept:
            raise unknown("reference", self.reference, tuple(kept))
        entries = [Entry.of(name, raw) for name, raw in kept.items()]
        if self.train:
            trained = [entry.name for entry in entries if entry.trains]
            check("train", trained, "none: no router of this experiment is trained")
            training = {"train": self.train}
            kept |= {name: merged(kept[name], training) for name in trained}
            entries = [Entry.of(name, raw) for name, raw in kept.items()]
            object.__setattr__(self, "train", {})
        object.__setattr__(self, "routers", {entry.name: entry.plain for entry in entries})

    @property
    def entries(self) -> tuple["Entry", ...]:
        """The routers."""
        return tuple(Entry.of(name, raw or {}) for name, raw in self.routers.items())


def _check_name(key: str, name: str, also: str = "") -> None:
    """Raises InputError unless names of files can contain a name."""
    fits = re.fullmatch(rf"\w[\w{also}-]*", name) and is_file_name(name, _SUFFIX)
    check(key, fits, f"a name of letters, digits, _ and -{also and ' and '}{also}, not too long")


_SUFFIX = 48 * "."
"""As long as what follows a set or a router in names of files, at most."""


def _check_set(name: str) -> None:
    """Raises InputError unless a set may have a name."""
    _check_name(f"problems.{name}", name, ".")
    check(f"problems.{name}", name != ALL, "another name: this one means all sets together")


@dataclass(frozen=True)
class Budget:
    """What a router may spend on a problem.

    Time sets the option ``seconds`` or ``time_limit``, samples set ``best_of``, unless the router
    has no such option or the user has set it. Samples set ``train.episodes`` of a learner.

    Attributes:
        seconds: time; None if the budget is of samples.
        samples: solutions tried, or episodes of a training; None if the budget is of time.
    """

    seconds: float | None = None
    samples: int | None = None

    @staticmethod
    def parse(text: str) -> "Budget":
        """A budget such as ``1s``, ``2min``, ``16`` or ``500 episodes``; raises InputError."""
        matched = re.fullmatch(
            r"([0-9]{1,9}(?:\.[0-9]{1,6})?)\s*(s|min|samples|episodes|)", text.strip()
        )
        expected = "seconds such as 1s, or a number of samples such as 16"
        if matched is None:
            raise InputError(f"budget: expected {expected}, found {text[:80]!r}")
        number, unit = float(matched[1]), matched[2]
        check("budget", number > 0, f"{expected}, above 0")
        if unit in ("s", "min"):
            return Budget(seconds=number * (60 if unit == "min" else 1))
        check("budget", number == int(number), expected)
        return Budget(samples=int(number))

    @property
    def text(self) -> str:
        """The budget as :meth:`parse` takes it."""
        return f"{self.samples}" if self.seconds is None else f"{self.seconds:g}s"

    def fill(self, router: str, options: Mapping[str, Any], where: str) -> dict[str, Any]:
        """A router's options with the budget in them."""
        if is_learner(router, f"{where}: router"):
            if self.samples is None or "checkpoint" in options:
                return dict(options)
            return override(options, [f"train.episodes={self.samples}"])
        seed = {"seed": 0} if has_seed(router) else {}
        known = plain(router_component(router, {**options, **seed}, where))
        if self.samples is not None:
            return {**({_TRIES: self.samples} if _TRIES in known else {}), **options}
        time = next((option for option in _TIMES if option in known), None)
        if time is None or known.get(_TRIES) == 1:  # a single try cannot use more time
            return dict(options)
        return {time: self.seconds, **options}


_TRIES = "best_of"
"""The option of a router that tries several solutions and takes the best."""

_TIMES = ("seconds", "time_limit")
"""The options of routers that say how long they may take."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """The options of an entry whose ``router`` is a learner: what to train, or a trained policy.

    Attributes:
        config: a YAML file with a training's configuration, which the other keys change.
        scenario: a scenario on whose training problems one network is trained, which then plays the
            set, a split of the same scenario (docs/cooperation.md). None: trained on the problems
            of the set.
        stack: the number of problems that one process trains side by side. More than one save time
            on a GPU, but not on a CPU. A learner shared by all problems takes a whole set.
        env: keys of the game, as in a training's configuration; the experiment gives the problems.
        learner: options of the learner.
        train: keys of the run; ``figures`` and ``tensorboard`` are off unless they are given here.
        checkpoint: the file of a trained policy, which routes without any training; no other key
            may then be given. ``{seed}`` in it stands for the seed.
    """

    config: str | None = None
    scenario: str | None = None
    stack: int = 1
    env: dict[str, Any] = field(default_factory=dict)
    learner: dict[str, Any] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)
    checkpoint: str | None = None

    def __post_init__(self) -> None:
        check("stack", self.stack >= 1, "a number from 1")
        for name in PLAYED:
            check(f"env.{name}", name not in self.env, "none: the experiment has its sets")
        keys = self.config or self.scenario or self.env or self.learner or self.train
        check("checkpoint", not (self.checkpoint and keys), "no keys of a training beside it")

    def resolved(self, learner: str, where: str) -> dict[str, Any]:
        """The same options of a learner with every key of the training filled in."""
        if self.checkpoint:
            return {"checkpoint": self.checkpoint}
        raw = {} if self.config is None else read_yaml(self.config)
        raw = for_learner(raw, learner, self.config or where)
        quiet = {"train": {"figures": False, "tensorboard": False}}
        given = {"env": self.env, "learner": self.learner, "train": self.train}
        raw = merged(merged(raw, quiet), given)
        if isinstance(raw.get("env"), Mapping):  # the problems are the experiment's
            raw["env"] = {key: value for key, value in raw["env"].items() if key not in PLAYED}
        if self.scenario is not None:
            raw["env"] = {**raw.get("env", {}), "scenario": self.scenario}
        config: dict[str, Any] = plain(config_of(for_learner(raw, learner, where), where))
        for name in PLAYED:
            del config["env"][name]
        scenario = {} if self.scenario is None else {"scenario": self.scenario}
        return {**scenario, "stack": self.stack, **{part: config[part] for part in PARTS}}


@dataclass(frozen=True, kw_only=True)
class Published:
    """The options of an entry ``published``: results as others report them.

    Attributes:
        file: a CSV file with the columns ``set`` (the set's name, or its scenario) and ``problem``,
            and a row for every problem, as :func:`policies.results.rows.read_published` reads it.
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


@dataclass(frozen=True, kw_only=True)
class ExternalSolutions:
    """The options of an entry ``solutions``: routes made elsewhere.

    Attributes:
        folder: holds a solution for each problem, in a file called ``PROBLEM.…``.
    """

    folder: str


@dataclass(frozen=True)
class Entry:
    """A router of an experiment.

    Attributes:
        name: the name that tables give it.
        router: the name of a router or a learner, ``module:Class``, ``published`` or ``solutions``.
        only: the sets that it is for; None stands for all.
        prune: whether its solutions are pruned before they are judged.
        label: what figures call it; None stands for its name.
        options: all other options as plain data, defaults included.
        trains: whether it is a learner that is trained on the problems.
        seeded: whether it is run for every seed.
        version: of marouting, with which its rows have to be made; None for any.
        training_seconds: what training its checkpoint took; None if not known.
        source: the words that name it on a command line.
    """

    name: str
    router: str
    only: tuple[str, ...] | None
    prune: bool
    label: str | None
    options: Mapping[str, Any]
    trains: bool
    seeded: bool
    version: str | None = None
    training_seconds: float | None = None
    source: str = ""

    @property
    def routes(self) -> bool:
        """Whether it routes here; what others made is read."""
        return self.router not in (PUBLISHED, SOLUTIONS)

    @property
    def plays(self) -> bool:
        """Whether it is a policy, which plays the split of a scenario of policies as a whole."""
        if not self.routes:
            return False
        if is_learner(self.router):
            return not self.trains or self.trains_on is not None
        return is_policy(lookup("router", self.router))

    @property
    def trains_on(self) -> str | None:
        """The scenario on whose training problems it is trained; None for none."""
        scenario: str | None = self.options.get("scenario") if self.trains else None
        return scenario

    @property
    def plain(self) -> dict[str, Any]:
        """The entry as a configuration holds it."""
        always = {
            "router": self.router,
            "only": self.only,
            "prune": self.prune,
            "label": self.label,
        }
        more = {"version": self.version, "training_seconds": self.training_seconds}
        return {**always, **{k: v for k, v in more.items() if v is not None}, **self.options}

    @property
    def allowed(self) -> str | None:
        """What it may spend on a problem, in words; None if its options do not bound it."""
        if self.trains:
            train = self.options["train"]
            if self.trains_on is None:
                return f"{train['episodes']} episodes"
            bounds = [] if train["steps"] is None else [f"{train['steps']} agent-steps"]
            bounds += [] if train["seconds"] is None else [f"{train['seconds']:g} s of training"]
            return ", ".join(bounds) or f"{train['episodes']} episodes"
        tries = self.options.get(_TRIES)
        times = [self.options[name] for name in _TIMES if self.options.get(name) is not None]
        bounds = [f"best of {tries}"] if tries is not None and tries > 1 else []
        return ", ".join(bounds + [f"{seconds:g} s" for seconds in times[:1]]) or None

    @staticmethod
    def of(name: str, raw: Mapping[str, Any]) -> "Entry":
        """An entry of a configuration; raises InputError if it is wrong."""
        where = f"routers.{name}"
        options = dict(raw)
        router, only = options.pop("router", None), options.pop("only", None)
        prune, label = options.pop("prune", False), options.pop("label", None)
        budget, version = options.pop("budget", None), options.pop("version", None)
        training = options.pop("training_seconds", None)
        if only is not None and not (
            isinstance(only, list | tuple) and only and all(isinstance(name, str) for name in only)
        ):
            raise InputError(f"{where}: only: expected a list of sets, found {only!r}")
        check(f"{where}: prune", isinstance(prune, bool), "true or false")
        named = label is None or (isinstance(label, str) and label.strip() and len(label) <= _LABEL)
        check(f"{where}: label", named, f"a text of at most {_LABEL} characters")
        check(f"{where}: prune", not (prune and router == PUBLISHED), "none: there are no routes")
        number = isinstance(training, int | float) and not isinstance(training, bool)
        fits = training is None or (number and 0 <= training < 2**63)
        check(f"{where}: training_seconds", fits, "a number from 0")
        allowance = None if budget is None else Budget.parse(str(budget))
        trains = seeded = False
        if router == PUBLISHED:
            options = asdict(build(Published, options, where))
        elif router == SOLUTIONS:
            options = asdict(build(ExternalSolutions, options, where))
        elif router is None:
            raise InputError(f"{where}: expected a router, as in {{router: astar}}")
        elif not isinstance(router, str):
            raise unknown(f"{where}: router", str(router), (*router_names(), PUBLISHED, SOLUTIONS))
        elif is_learner(router, f"{where}: router"):
            options = allowance.fill(router, options, where) if allowance else options
            options = build(Training, options, where).resolved(router, where)
            trains = "checkpoint" not in options
            seeded = trains or _seeded(options)
        else:
            if "seed" in options and has_seed(router):
                raise InputError(f"{where}: seed: expected none: set seeds of the experiment")
            options = allowance.fill(router, options, where) if allowance else options
            seed = {"seed": 0} if has_seed(router) else {}
            made = router_component(router, {**options, **seed}, where)
            seeded = is_seeded(made) or _seeded(options)
            options = {key: value for key, value in plain(made).items() if key not in seed}
            del options["kind"]
        sets = None if only is None else tuple(only)
        return Entry(
            name, router, sets, prune, label, options, trains, seeded, version, training
        )  # fmt: skip


SEED = "{seed}"
"""Stands in names of files for the seed: one file for each."""


def _seeded(options: Mapping[str, Any]) -> bool:
    """Whether there is a file for each seed."""
    return any(isinstance(value, str) and SEED in value for value in options.values())


_LABEL = 80
"""The longest label, in characters."""


def load_experiment(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_code: bool = False
) -> ExperimentConfig:
    """Reads the configuration of an experiment and changes single keys of it.

    Args:
        path: a YAML file.
        overrides: ``key=value``, as :func:`marouting.yaml_files.override` takes them.
        allow_code: whether the file, and configurations that it names, may name components as
            ``module:Class``, which is code that is imported. Overrides always may.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    with allowing_code(allow_code):
        return build(ExperimentConfig, override(read_yaml(path), overrides), os.fspath(path))


@dataclass(frozen=True, kw_only=True)
class ScenarioSet:
    """A set that is the split of a scenario."""

    scenario: str
    split: Split = "test"

    @staticmethod
    def of(source: object) -> "ScenarioSet | None":
        """The set that a source stands for; None if it is of another kind."""
        if isinstance(source, Mapping) and "scenario" in source:
            return build(ScenarioSet, source)
        return None


def load_set(name: str, source: Any) -> dict[str, Problem]:
    """The problems of a source by name; raises InputError."""
    try:
        split = ScenarioSet.of(source)
        if split is None:
            return load_problems(source)
        return dict(scenarios.get(split.scenario).problems(split.split))
    except InputError as error:
        raise InputError(f"problems.{name}: {error}") from None


def load_sets(problems: str | Mapping[str, Any]) -> dict[str, dict[str, Problem]]:
    """The sets of an experiment: problems by name, by the set's name; raises InputError."""
    if isinstance(problems, Mapping):
        return {name: load_set(name, source) for name, source in problems.items()}
    folder = Path(problems)
    with naming(folder, "cannot be read"):
        folders = [folder, *sorted(path for path in folder.glob("*") if is_dir(path))]
        paths = {path.resolve().name: path for path in folders if problems_in(path)}
    if not paths:
        raise InputError(f"problems: {folder}: expected .gr files in this folder or its subfolders")
    for name in paths:
        _check_set(name)
    return {name: load_problems(str(path)) for name, path in paths.items()}
