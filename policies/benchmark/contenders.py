"""What a benchmark compares: routers, learners, checkpoints, and solutions made elsewhere."""

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from marouting import InputError
from marouting.config import build, check, override, plain, read_yaml
from marouting.files import FILE_NAME, is_dir, is_file, is_file_name, stem_of, suffix_of
from policies.engines import EngineName
from policies.experiment.config import PUBLISHED, Entry
from policies.routers.registry import has_seed, is_learner, router_piece

SOLUTIONS = "solutions"
"""The ``router`` of a contender whose solutions are read from a folder."""

SEEDS = 3
"""The default number of seeds."""

TRIES = "best_of"
"""The option of a router that tries several solutions and takes the best."""

_TIMES = ("seconds", "time_limit")
"""The options of routers that say how long they may take."""


@dataclass(frozen=True)
class Budget:
    """What a router may spend on a problem.

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


@dataclass(frozen=True, kw_only=True)
class BenchmarkConfig:
    """A list of contenders, as a YAML file holds it; ``configs/benchmark/baselines.yaml`` has one.

    Attributes:
        routers: entries by name, as in an experiment (:class:`ExperimentConfig` of
            :mod:`policies.experiment.config`); ``only`` lists the scenarios that an entry is for.
            ``router: solutions`` takes ``folder``. Beside the options, ``budget`` is the entry's
            own, and ``training_seconds`` what training its checkpoint took.
        budget: of the entries that do not give their own, see :class:`Budget`.
        seeds: how many seeds.
        engine: where the work is done, as in an experiment.
    """

    routers: dict[str, dict[str, Any] | None] = field(default_factory=dict)
    budget: str | None = None
    seeds: int | None = None
    engine: EngineName = "local"


@dataclass(frozen=True, kw_only=True)
class Elsewhere:
    """The options of a contender ``solutions``.

    Attributes:
        folder: holds a solution for each problem, in a file called ``PROBLEM.…``.
    """

    folder: str


@dataclass(frozen=True)
class Contender:
    """A row of the benchmark, before it is measured.

    Attributes:
        entry: what routes; of ``solutions`` and ``published`` only its name and options matter.
        budget: what it may spend on a problem, in words; None if its options do not bound it.
        training_seconds: what training the checkpoint took; None if not known.
        source: how the command line or the configuration names it, for the result's ``command``.
    """

    entry: Entry
    budget: str | None
    training_seconds: float | None
    source: str

    @property
    def routes(self) -> bool:
        """Whether it is run here."""
        return self.entry.router not in (SOLUTIONS, PUBLISHED)


def from_text(text: str, name: str | None, budget: Budget | None) -> Contender:
    """A contender as the command line names it.

    Args:
        text: the name of a router or a learner, or ``module:Class``, each with options after it
            (``astar best_of=16 target=tree``); the file of a trained policy; a folder of
            solutions; or a CSV file with overflow and wirelength of solutions that are not at
            hand.
        name: what tables call it; None: the router and its options, or the name of the file.
        budget: the budget, applied to the options where they do not say otherwise.

    Raises:
        InputError: it is none of these, or an option is wrong.
    """
    raw: dict[str, Any]
    path = Path(text)
    if is_dir(path):
        raw, called = {"router": SOLUTIONS, "folder": text}, path.resolve().name
    elif is_file(path) and suffix_of(path) == ".csv":
        raw, called = {"router": PUBLISHED, "file": text}, stem_of(path)
    elif is_file(path):
        raw, called = {"router": _learner_of(path), "checkpoint": text}, path.stem
    else:
        try:
            router, *options = shlex.split(text) or [""]
        except ValueError as error:
            raise InputError(f"--router {text}: {error}") from None
        if os.sep in router and ":" not in router:
            raise InputError(f"--router {text}: expected a file or a folder, found none there")
        is_learner(router, "--router")
        raw = {**override({}, options), "router": router}
        called = "-".join([router, *(option.partition("=")[2] for option in options)])
    called = name or re.sub(r"[^\w-]+", "-", called).strip("-") or "router"
    source = ["--router", text, *(["--name", name] if name else []), *_told(budget)]
    return from_entry(called, raw, budget, shlex.join(source))


def from_entry(name: str, raw: Mapping[str, Any], budget: Budget | None, source: str) -> Contender:
    """A contender as a configuration holds it; raises InputError if it is wrong.

    Args:
        name: what tables call it.
        raw: its options and those of :class:`BenchmarkConfig`.
        budget: the budget, unless it has its own.
        source: how the command names it.
    """
    where = f"routers.{name}"
    check(where, is_file_name(name, ".validation.json"), FILE_NAME)
    options = dict(raw)
    own = options.pop("budget", None)
    if own is not None:
        budget = Budget.parse(str(own))
    training = options.pop("training_seconds", None)
    number = isinstance(training, int | float) and not isinstance(training, bool)
    fits = training is None or (number and 0 <= training < 2**63)
    check(f"{where}: training_seconds", fits, "a number from 0")
    if options.get("router") == SOLUTIONS:
        del options["router"]
        only = options.pop("only", None)
        found = asdict(build(Elsewhere, options, where))
        entry = Entry(
            name, SOLUTIONS, None if only is None else tuple(only), prune=False, label=None,
            options=found, trains=False, seeded=False,
        )  # fmt: skip
        return Contender(entry, None, training, source)
    entry = Entry.of(name, options if budget is None else _with(budget, options, where))
    routed_here = entry.router != PUBLISHED and not entry.trains
    if training is None and routed_here and "checkpoint" not in entry.options:
        training = 0.0
    return Contender(entry, _allowed(entry), training, source)


def _with(budget: Budget, options: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Options with a budget in them, where the router knows one and they do not say another."""
    router = options.get("router")
    if not isinstance(router, str) or router == PUBLISHED:
        return dict(options)
    if is_learner(router, f"{where}: router"):
        if budget.samples is None or "checkpoint" in options:
            return dict(options)
        return override(options, [f"train.episodes={budget.samples}"])
    given = {key: value for key, value in options.items() if key not in ("router", "only")}
    seed = {"seed": 0} if has_seed(router) else {}
    known = plain(router_piece(router, {**given, **seed}, where))
    if budget.samples is not None:
        return {**({TRIES: budget.samples} if TRIES in known else {}), **options}
    time = next((option for option in _TIMES if option in known), None)
    if time is None or known.get(TRIES) == 1:  # a single try cannot use more time
        return dict(options)
    return {time: budget.seconds, **options}


def _allowed(entry: Entry) -> str | None:
    """What a router may spend on a problem, in words; None if its options do not bound it."""
    if entry.trains:
        return f"{entry.options['train']['episodes']} episodes"
    tries = entry.options.get(TRIES)
    bounds = [f"best of {tries}"] if tries is not None and tries > 1 else []
    times = [entry.options[option] for option in _TIMES if entry.options.get(option) is not None]
    return ", ".join(bounds + [f"{seconds:g} s" for seconds in times[:1]]) or None


def _told(budget: Budget | None) -> list[str]:
    """The budget as the command line takes it."""
    return [] if budget is None else ["--budget", budget.text]


def _learner_of(checkpoint: Path) -> str:
    """The learner whose policy a file holds; raises InputError if it holds none."""
    from policies.learned.checkpoint import read_checkpoint  # torch: only if something learned

    state = read_checkpoint(checkpoint, training=False)
    learner = state.get("learner")
    kind = learner.get("kind") if isinstance(learner, Mapping) else None
    if not isinstance(kind, str):
        raise InputError(f"{checkpoint}: expected a trained policy")
    return kind


def load_contenders(
    path: str | os.PathLike[str], overrides: Sequence[str], budget: Budget | None
) -> tuple[list[Contender], BenchmarkConfig]:
    """The contenders of a configuration, and the configuration.

    Args:
        path: a YAML file.
        overrides: ``key=value``, as :func:`marouting.config.override` takes them.
        budget: what the command line says; None for the configuration's own.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    where = os.fspath(path)
    config = build(BenchmarkConfig, override(read_yaml(path), overrides), where)
    source = shlex.join(["--config", where, *overrides, *_told(budget)])
    if budget is None and config.budget is not None:
        budget = Budget.parse(config.budget)
    found = [
        from_entry(name, raw, budget, source)
        for name, raw in config.routers.items()
        if raw is not None
    ]
    check(f"{where}: routers", found, "at least one")
    return found, config
