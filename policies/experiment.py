"""Experiments: problem sets × routers × seeds, compared in tables and figures.

What the folder of an experiment holds:

===============================  ===============================================================
config.yaml                      the whole configuration, defaults included
problems/SET/NAME.gr             what is routed
rows/SET/ROUTER[.seedN]/*.json   the rows of what is done, part by part
runs/SET/ROUTER[.seedN]/*/       the run folders of trainings (:mod:`policies.learned.run`)
solutions/SET/NAME.ROUTER[.seedN].solution
results.json, results.csv        all rows
summary.json                     what they say (:mod:`policies.statistics`)
figures/                         the paper's figures
===============================  ===============================================================

The work is cut into parts that know nothing of one another; processes take one after the other. A
part is done when its rows are there, so an experiment that was stopped, however, goes on when it is
started again, and does what is new when it is asked for more routers, seeds or sets: all that must
stay are the problems of a set and the options of a router. The results are there as soon as a
router is done with all its problems, of all routers that are. Solutions do not depend on the number
of processes, nor on the stops.
"""

import csv
import io
import json
import os
import re
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from marouting import InputError, Problem, Solution, evaluate, generate
from marouting.config import build, read_yaml
from marouting.files import unusable, write_text
from marouting.source import load_problems
from policies.base import Router, solve
from policies.config import Config, check, check_same, load_config, override
from policies.processes import cores, work_on
from policies.routers import ROUTERS, has_seed, is_seeded, make_router, schema, unknown
from policies.statistics import ALL, Row, add_gaps, baseline, by_set, summarise
from policies.study import Column, Study
from policies.utilisation import problem_type

CONFIG, RESULTS, SUMMARY = "config.yaml", "results.json", "summary.json"

PUBLISHED = "published"
"""The router of an entry whose rows are not routed but read from a file."""

COLUMNS = {
    "set": str,
    "problem": str,
    "router": str,
    "kind": str,
    "seed": int | None,
    "overflow": int,
    "max_overflow": int | None,
    "wirelength": int,
    "vias": int | None,
    "connected": bool | None,
    "joined": int | None,
    "tasks": int | None,
    "proven": bool | None,
    "seconds": float | int | None,
    "gap": float | int | None,
}
"""What a row holds: ``router`` is the name of the entry, ``kind`` what routes. ``proven``: whether
the solution is known to be optimal; ``gap``: to such a one, in %. None where there is nothing to
say: only overflow and wirelength are published."""


# --- what an experiment is told -------------------------------------------------------------------


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
            of :data:`policies.routers.ROUTERS` or ``published``, and ``only``, the sets that it
            is for; all the others are the router's own. For ``dqn`` see :class:`Training`, for
            ``published`` :class:`Published`. What is left out is filled in. None in place of the
            options leaves a router out: for ``routers.NAME=null`` on the command line.
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
        plain = asdict(build(Config, _merged(_merged(raw, quiet), told), where))
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
        overrides: as of :func:`policies.config.load_config`.

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


# --- a part of the work, in a process of its own --------------------------------------------------


def label(router: str, seed: int | None) -> str:
    """A router's name with the seed, as files carry it."""
    return router if seed is None else f"{router}.seed{seed}"


def problem_file(folder: Path, set: str, problem: str) -> Path:
    """Where an experiment keeps a problem."""
    return folder / "problems" / set / f"{problem}.gr"


def solution_file(folder: Path, set: str, problem: str, router: str, seed: int | None) -> Path:
    """Where an experiment keeps a solution."""
    return folder / "solutions" / set / f"{problem}.{label(router, seed)}.solution"


@dataclass(frozen=True)
class Part:
    """Some problems of a set that one router routes, with one seed.

    Attributes:
        folder: of the experiment.
        set: the set's name.
        entry: the router.
        seed: the seed; None for a router that draws no random numbers.
        problems: names of the problems; the first is that of the part.
    """

    folder: Path
    set: str
    entry: Entry
    seed: int | None
    problems: tuple[str, ...]

    @property
    def label(self) -> str:
        """The router's name with the seed, as files carry it."""
        return label(self.entry.name, self.seed)

    @property
    def rows(self) -> Path:
        """The file with the rows: there when the part is done."""
        return self.folder / "rows" / self.set / self.label / f"{self.problems[0]}.json"

    @property
    def run(self) -> Path:
        """The run folder of a training."""
        return self.folder / "runs" / self.set / self.label / self.problems[0]

    def problem(self, name: str) -> Path:
        """The file of a problem."""
        return problem_file(self.folder, self.set, name)

    def solution(self, name: str) -> Path:
        """The file for the solution of a problem."""
        return solution_file(self.folder, self.set, name, self.entry.name, self.seed)

    def work(self) -> None:
        """Routes the problems; writes the solutions, and then the rows."""
        try:
            if self.entry.router == PUBLISHED:
                rows = self.quote()
            elif self.entry.trains:
                rows = self._train()
            else:
                rows = [self._route(name) for name in self.problems]
        except InputError as error:
            raise InputError(f"{self.set}, {self.label}: {error}") from None
        about = {"set": self.set, "router": self.entry.name, "kind": self.entry.router}
        full = [{**dict.fromkeys(COLUMNS), **row, **about, "seed": self.seed} for row in rows]
        write_text(self.rows, json.dumps(full, indent=1) + "\n")

    def quote(self) -> list[Row]:
        """The rows of a published router; raises InputError if one is missing."""
        published = Published(**self.entry.options)
        found = published.read()
        rows = []
        for name in self.problems:
            if (self.set, name) not in found:
                raise InputError(f"{published.file}: expected a row for {self.set},{name}")
            overflow, wirelength = found[self.set, name]
            figures = {"overflow": overflow, "wirelength": wirelength}
            rows.append({"problem": name, **figures, "proven": published.optimal})
        return rows

    def _route(self, name: str) -> Row:
        problem = Problem.read(self.problem(name))
        router = self._router(name)
        self._warm_up(router)
        started = time.perf_counter()
        solution, report = solve(router, problem)
        seconds = time.perf_counter() - started
        solution.write(self.solution(name))
        figures = asdict(evaluate(problem, solution))
        del figures["disconnected"]
        proven = report["status"] == "optimal" if "status" in report else None
        return {"problem": name, **figures, "proven": proven, "seconds": round(seconds, 6)}

    def _router(self, problem: str) -> Router:
        if self.entry.router == "dqn":
            from policies.learned.router import DQNRouter

            return DQNRouter(checkpoint=self.entry.options["checkpoint"], network=problem)
        seed = {} if self.seed is None else {"seed": self.seed}
        return make_router(self.entry.router, {**self.entry.options, **seed})

    def _warm_up(self, router: Router) -> None:
        """Routes a small problem once a process: compiling is no part of a router's time."""
        if self.entry.name not in _warm:
            router.route(generate(1, (4, 4, 2), nets=6, capacity=1, reduced_edges=0)[0])
            _warm.add(self.entry.name)

    def _train(self) -> list[Row]:
        from policies.learned import run as folders

        kept = self.run / folders.CONFIG
        if not (self.run / folders.POLICY).exists():
            config = load_config(kept) if kept.exists() else self._training()
            # The folder may have another name than when it was started.
            config = replace(config, out=str(self.run))
            folders.Run(config, resume=kept.exists(), progress=False).execute()
        # The memories of what is done are no use to anybody, and large.
        (self.run / folders.CHECKPOINT).unlink(missing_ok=True)
        named = _read_rows(self.run / folders.RESULT, {"router": str, "problem": str})
        rows = [row for row in named if row["router"] == "dqn"]
        for row in rows:
            name = row["problem"]
            problem = Problem.read(self.problem(name))
            solution = Solution.read(self.run / "solutions" / f"{name}.dqn.solution", problem)
            solution.write(self.solution(name))
        return rows

    def _training(self) -> Config:
        parts = {key: dict(self.entry.options[key]) for key in ("env", "dqn", "train")}
        parts["env"]["problem"] = [str(self.problem(name)) for name in self.problems]
        return build(Config, {"seed": self.seed, **parts})


_warm: set[str] = set()
"""The routers that this process has used."""


def _read_rows(path: Path, columns: Mapping[str, Any] = COLUMNS) -> list[Row]:
    """The rows in a file, with these columns at least; raises InputError if it holds none."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None
    except (ValueError, RecursionError):
        rows = None
    if not isinstance(rows, list) or not all(
        isinstance(row, dict)
        and all(name in row and isinstance(row[name], kind) for name, kind in columns.items())
        for row in rows
    ):
        raise InputError(f"{path}: expected rows in JSON, with {', '.join(columns)}")
    return rows


def read_results(folder: Path) -> list[Row]:
    """The rows of an experiment that is done; raises InputError."""
    return _read_rows(folder / RESULTS)


# --- the whole ------------------------------------------------------------------------------------


class Experiment:
    """An experiment in its folder, new or to go on with.

    Its processes import the main module: a script that runs one needs the usual
    ``if __name__ == "__main__":``.

    Args:
        config: what to do, as :func:`load_experiment` gives it.
        progress: whether to show a progress bar on standard error.

    Raises:
        InputError: the configuration, a problem or the folder cannot be used, or the folder holds
            something else.
    """

    def __init__(self, config: ExperimentConfig, *, progress: bool = True) -> None:
        self.config = config
        self.folder = Path(config.out)
        self._progress = progress
        self.entries = config.entries
        before = self._before()
        # In an order that does not depend on where they come from.
        self.sets = {name: dict(sorted(own.items())) for name, own in self._load(before).items()}
        for entry in self.entries:
            for name in entry.only or ():
                if name not in self.sets:
                    raise unknown(f"routers.{entry.name}.only", name, tuple(self.sets))
        # As far as it goes that can be told before there are results.
        for name, study in config.studies.items():
            taken = re.fullmatch(r"(.+)_(wirelength|overflow|decrease)", name)
            check(f"studies.{name}", not (taken and taken[1] in {*self.sets, ALL}), "another name")
            for title, column in study.columns.items():
                self._check_column(f"studies.{name}.columns.{title}", study, column)
        self._keep(before)

    def _before(self) -> ExperimentConfig | None:
        """All that the folder was asked for so far; raises InputError if it does not fit."""
        kept = self.folder / CONFIG
        if not kept.exists():
            return None
        if "routers" not in read_yaml(kept):
            raise InputError(f"{self.folder}: holds a training: expected another out=")
        before = load_experiment(kept)
        mine, theirs = (self._rows_depend_on(asked, before) for asked in (self.config, before))
        check_same(mine, theirs, kept)
        return before

    def _rows_depend_on(
        self, asked: ExperimentConfig, before: ExperimentConfig
    ) -> dict[str, dict[str, Any] | str]:
        """What must stay: the problems of a set and the options of a router, of those in both."""
        routers = {
            name: {key: value for key, value in (options or {}).items() if key != "only"}
            for name, options in asked.routers.items()
            if name in self.config.routers and name in before.routers
        }
        problems = asked.problems
        if isinstance(self.config.problems, Mapping) and isinstance(before.problems, Mapping):
            both = self.config.problems.keys() & before.problems.keys()
            problems = {name: problems[name] for name in problems if name in both}
        return {"problems": problems, "routers": routers}

    def _check_column(self, key: str, study: Study, column: Column) -> None:
        entry = next(entry for entry in self.entries if entry.name == column.router)
        sets = tuple(name for name in self.sets if entry.only is None or name in entry.only)
        if column.set is None:
            check(f"{key}.set", len(sets) == 1, f"one of {', '.join(sets)}")
        elif column.set not in sets:
            raise unknown(f"{key}.set", column.set, sets)
        of = column.set or sets[0]
        if column.problem is not None and column.problem not in self.sets[of]:
            raise unknown(f"{key}.problem", column.problem, tuple(self.sets[of]))
        check(f"{key}.router", entry.router != PUBLISHED, "one that routes here")
        against = [
            e for e in self.entries if e.router == "astar" and (e.only is None or of in e.only)
        ]
        check(key, against, f"a router of the kind astar that is for {of}")
        learns = {"reward", "mean_reward"} & set(study.panels)
        check(f"{key}.router", entry.trains or not learns, "one that is trained")
        for other in (e for e in self.entries if e.name in column.beside):
            known = other.trains and (other.only is None or of in other.only)
            check(f"{key}.beside", known, f"routers that are trained on {of}")

    def _load(self, before: ExperimentConfig | None) -> dict[str, dict[str, Problem]]:
        """The sets, in the order of the configuration: what the folder holds stays as it is."""
        folder = self.folder / "problems"
        if isinstance(self.config.problems, str):
            if before is None:
                return load_sets(self.config.problems)
            names = sorted(path.name for path in folder.iterdir() if path.is_dir())
            return {name: load_problems(str(folder / name)) for name in names}
        held = {} if before is None else before.problems
        return {
            name: load_problems(str(folder / name))
            if name in held
            else load_sets({name: source})[name]
            for name, source in self.config.problems.items()
        }

    def _keep(self, before: ExperimentConfig | None) -> None:
        """Writes the problems that are new, and then the configuration of all that is there."""
        if before is None and (self.folder / "rows").exists():
            raise InputError(f"{self.folder}: holds rows without {CONFIG}: expected another out=")
        new = dict(self.sets)
        if before is not None:
            held = self.sets if isinstance(before.problems, str) else before.problems
            new = {name: own for name, own in self.sets.items() if name not in held}
        for path in sorted((self.folder / "problems").glob("*/*.gr")):
            name = path.parent.name
            if (before is None or name in new) and path.stem not in self.sets.get(name, ()):
                raise InputError(f"{path}: expected no problems but the experiment's")
        for part in self.parts:
            if part.entry.router == PUBLISHED and not part.rows.exists():
                part.quote()  # complains now, not after hours
        for name, problems in new.items():
            for problem in problems:
                problems[problem].write(self.folder / "problems" / name / f"{problem}.gr")
        plain = asdict(self.config)
        if before is not None:
            plain["routers"] = {**before.routers, **plain["routers"]}
            if isinstance(before.problems, Mapping):
                plain["problems"] = {**before.problems, **plain["problems"]}
        if before is None or plain != asdict(before):
            text = yaml.safe_dump(json.loads(json.dumps(plain)), sort_keys=False)
            write_text(self.folder / CONFIG, text)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """All the work, router by router: what takes long comes last."""
        return tuple(
            Part(self.folder, name, entry, seed, share)
            for entry in sorted(self.entries, key=lambda entry: _SLOW.get(entry.router, 0))
            for name, own in self.sets.items()
            if entry.only is None or name in entry.only
            for seed in (self.config.seeds if entry.seeded else (None,))
            for share in _shares(entry, own)
        )

    def execute(self) -> dict[str, Any]:
        """Does what is left to do and writes the results; returns what ``summary.json`` holds.

        Whenever a router is done with all its problems, the results are written of those that are.
        """
        left = [part for part in self.parts if not part.rows.exists()]
        if left:
            self._work(left)
        return self._write(self.entries)

    def _write(self, entries: Sequence[Entry]) -> dict[str, Any]:
        """Writes the results of routers that are done; returns what ``summary.json`` holds."""
        rows = self._rows(entries)
        reference = self.config.reference
        if reference not in {entry.name for entry in entries}:
            reference = None
        sets = {name: summarise(own, reference) for name, own in by_set(rows).items()}
        summary = {"reference": reference, "types": self._types(rows), "sets": sets}
        write_text(self.folder / RESULTS, json.dumps(rows, indent=1) + "\n")
        write_text(self.folder / "results.csv", _csv(rows))
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=1) + "\n")
        from policies.plot import experiment_figures

        experiment_figures(self.folder)
        return summary

    def _types(self, rows: Sequence[Row]) -> dict[str, dict[str, int]]:
        """How many problems of each set are of the paper's types, by A*'s solutions."""
        types: dict[str, dict[str, int]] = {}
        for name, own in by_set(rows).items():
            astar = baseline(own)
            if name == ALL or astar is None:
                continue
            first = {row["problem"]: row for row in reversed(own) if row["router"] == astar}
            types[name] = {"I": 0, "II": 0}
            for problem, row in first.items():
                path = solution_file(self.folder, name, problem, row["router"], row["seed"])
                routed = self.sets[name][problem]
                types[name][problem_type(routed, Solution.read(path, routed))] += 1
        return types

    def _work(self, left: Sequence[Part]) -> None:
        """Works on parts and shows how many of all problems are done."""
        trainings = {
            part.run: (_Lines(part.run / "metrics.jsonl"), part.entry.options["train"])
            for part in left
            if part.entry.trains
        }
        threads = max((train["threads"] for _, train in trainings.values()), default=1)
        total = sum(len(part.problems) for part in self.parts)
        done = total - sum(len(part.problems) for part in left)
        missing = Counter(part.entry.name for part in left)
        written = 0  # routers in the results
        with self._bar() as bar:
            task = bar.add_task(str(self.folder), total=total, completed=done)
            for parts in work_on(left, self.config.jobs or cores(), threads):
                for part in parts:
                    trainings.pop(part.run, None)
                    done += len(part.problems)
                missing -= Counter(part.entry.name for part in parts)
                finished = [entry for entry in self.entries if not missing[entry.name]]
                if missing and len(finished) > written:
                    self._write(finished)
                    written = len(finished)
                # A line is an episode of one problem.
                begun = sum(
                    lines.count() / train["episodes"] for lines, train in trainings.values()
                )
                bar.update(task, completed=done + begun)

    def _bar(self) -> Progress:
        return Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("problems"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            disable=not self._progress,
        )

    def _rows(self, entries: Sequence[Entry]) -> list[Row]:
        """The rows of routers, by set, problem, router and seed in the configuration's order."""
        rows = {}
        names = {entry.name for entry in entries}
        for part in self.parts:
            if part.entry.name not in names:
                continue
            found = _read_rows(part.rows)
            if [row["problem"] for row in found] != list(part.problems):
                raise InputError(f"{part.rows}: expected rows of {', '.join(part.problems)}")
            for row in found:
                rows[part.set, row["problem"], part.entry.name, part.seed] = row
        ordered = [
            rows[name, problem, entry.name, seed]
            for name, own in self.sets.items()
            for problem in own
            for entry in entries
            if entry.only is None or name in entry.only
            for seed in (self.config.seeds if entry.seeded else (None,))
        ]
        add_gaps(ordered)
        return ordered


class _Lines:
    """Counts the lines of a growing file without reading any twice."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = self._count = 0

    def count(self) -> int:
        """How many there are by now; 0 as long as there is no file."""
        try:
            if self._path.stat().st_size < self._read:  # cut off by a training that goes on
                self._read = self._count = 0
            with self._path.open("rb") as lines:
                lines.seek(self._read)
                new = lines.read()
        except OSError:
            return self._count
        self._read += len(new)
        self._count += new.count(b"\n")
        return self._count


_SLOW = {"optimal": 1, "dqn": 2}
"""Routers that take longest, and the order that puts them last."""


def _shares(entry: Entry, problems: Mapping[str, Problem]) -> list[tuple[str, ...]]:
    """The problems of a set, cut into what one process does at a time."""
    if entry.router == PUBLISHED:
        return [tuple(problems)]
    if not entry.trains:
        return [(name,) for name in problems]
    grids: dict[tuple[int, int, int], list[str]] = {}
    for name, problem in problems.items():
        grids.setdefault(problem.grid, []).append(name)  # a stack has one grid shape
    size = entry.options["stack"]
    if entry.options["dqn"]["shared"]:
        if len(grids) > 1:
            raise InputError(
                f"routers.{entry.name}.dqn.shared: expected a set of one grid shape, "
                f"found {sorted(grids)}"
            )
        size = len(problems)
    return [
        tuple(names[i : i + size]) for names in grids.values() for i in range(0, len(names), size)
    ]


def _csv(rows: Sequence[Row]) -> str:
    """Rows as CSV; empty where there is nothing to say."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
