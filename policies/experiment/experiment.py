"""A whole experiment: its parts are distributed to processes, its results are collected."""

import json
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

from marouting import InputError, Problem, Solution
from marouting.config import allowing_code_of, build, build_json, check, check_code
from marouting.files import FILE_NAME, exists, is_file_name, naming, read_text, write_text
from marouting.registry import allowing_code, lookup
from marouting.scenarios import get
from marouting.source import generated_name, load_problems
from marouting.yaml_files import MOST_TEXT, check_same, read_yaml, yaml_text
from policies.engines import check_engine, cores
from policies.experiment.config import (
    RULE_COST,
    Entry,
    ExperimentConfig,
    ScenarioSet,
    load_set,
    load_sets,
)
from policies.experiment.part import Part, work_on
from policies.results.folder import check_own, working_in
from policies.results.rows import RESULTS, SUMMARY, Row, read_rows, to_csv
from policies.results.run_folder import CONFIG, METRICS, NO_ROUTES
from policies.results.statistics import ALL, add_gaps, baseline, by_set, summarise
from policies.results.utilisation import problem_type
from policies.routers.registry import is_learner, unknown


class Experiment:
    """An experiment in its folder, new or to be continued.

    Its processes import the main module, so a script that runs an experiment needs the usual
    ``if __name__ == "__main__":``.

    Args:
        config: the configuration, as :func:`load_experiment` returns it.

    Raises:
        InputError: the configuration, a problem or the folder cannot be used, or the folder holds
            another experiment.
    """

    def __init__(self, config: ExperimentConfig) -> None:
        check_engine(config.engine)
        self.config = config
        self.folder = Path(config.out)
        self.entries = config.entries
        before = self._read_stored()
        # In an order that does not depend on the source.
        self.sets = {name: dict(sorted(own.items())) for name, own in self._load(before).items()}
        for entry in self.entries:
            for name in entry.only or ():
                if name not in self.sets:
                    raise unknown(f"routers.{entry.name}.only", name, tuple(self.sets))
        self._write_inputs(before)

    def _read_stored(self) -> ExperimentConfig | None:
        """What the folder holds, with the routers that are asked for; raises InputError."""
        kept = self.folder / CONFIG
        self._stored_routers: dict[str, Any] = {}
        if not exists(kept):
            check_own(self.folder, ("problems", CONFIG))
            return None
        with allowing_code():  # of routers that are not asked for nothing is imported
            raw = read_yaml(kept)
        routers = raw.get("routers")
        if not isinstance(routers, Mapping):
            training = "env" in raw or "learner" in raw
            found = "a training" if training else f"{CONFIG} without routers"
            raise InputError(f"{self.folder}: holds {found}: expected another folder for out")
        asked = self.config.routers
        self._stored_routers = dict(routers)
        entries = {name: entry for name, entry in routers.items() if name in asked} or asked
        with allowing_code_of(asked):
            check_code(entries, str(kept))
            raw = {**raw, "routers": entries, "reference": None}
            before = build(ExperimentConfig, raw, str(kept))
        theirs = self._rows_depend_on(before, before)
        try:
            check_same(self._rows_depend_on(self.config, before), theirs, kept)
        except InputError as error:
            raise InputError(
                f"{error}: expected another folder for out, or another name for the router"
            ) from None
        return before

    def _rows_depend_on(
        self, asked: ExperimentConfig, before: ExperimentConfig
    ) -> dict[str, dict[str, Any] | str]:
        """What must not change: the problems and options of sets and routers that are in both."""
        routers = {
            name: {k: value for k, value in (options or {}).items() if k not in _CHANGEABLE_KEYS}
            for name, options in asked.routers.items()
            if name in self.config.routers and name in before.routers
        }
        problems = asked.problems
        if isinstance(self.config.problems, Mapping) and isinstance(before.problems, Mapping):
            both = self.config.problems.keys() & before.problems.keys()
            problems = {name: problems[name] for name in problems if name in both}
        return {"problems": problems, "routers": routers}

    def _load(self, before: ExperimentConfig | None) -> dict[str, dict[str, Problem]]:
        """The sets, in the order of the configuration; what the folder holds is read from it.

        Raises:
            InputError: a set is another one now. Of problems drawn without a seed only the names
                are compared; files that are gone are not.
        """
        problems, folder = self.config.problems, self.folder / "problems"
        if isinstance(problems, str):
            if before is None:
                return load_sets(problems)
            found = sorted(path for path in folder.iterdir() if path.is_dir())
            kept = {path.name: load_problems(str(path)) for path in found}
            for name, now in (_or_none(load_sets, problems) or {}).items():
                self._check_kept(name, kept.get(name, {}), now)
            return kept
        held = {} if before is None else before.problems
        sets = {}
        for name, source in problems.items():
            if name not in held:
                sets[name] = load_set(name, source)
                continue
            own = sets[name] = load_problems(str(folder / name))
            drawn = isinstance(source, Mapping) and "path" not in source
            if not drawn:
                self._check_kept(name, own, _or_none(load_set, name, source))
            elif ScenarioSet.of(source) or source.get("seed", 0) is not None:
                self._check_kept(name, own, load_set(name, source))
            else:
                names = map(generated_name, range(source.get("count", 1)))
                self._check_kept(name, own, {problem: own.get(problem) for problem in names})
        return sets

    def _check_kept(
        self, name: str, kept: Mapping[str, Problem], now: Mapping[str, Problem | None] | None
    ) -> None:
        """Raises InputError unless the problems of a set are those that the folder holds.

        Args:
            name: of the set.
            kept: what the folder holds.
            now: what the set is; None if that is not known.
        """
        now = kept if now is None else now
        for problem in sorted(kept.keys() | now.keys()):
            if problem not in kept or kept[problem] != now.get(problem):
                file = self.folder / "problems" / name / f"{problem}.gr"
                found = "another" if problem in kept else "none"
                raise InputError(
                    f"{file}: expected the problem of {name}, found {found}: if the set has "
                    "changed, give another folder for out"
                )

    def _write_inputs(self, before: ExperimentConfig | None) -> None:
        """Writes the new problems, and then the configuration of all that the folder holds."""
        for part in self.parts:
            for name in part.problems:
                fits = is_file_name(name, f".{part.label}.solution")
                check(f"problems.{part.set}: {name[:80]!r}", fits, FILE_NAME)
        for name, problems in self.sets.items():
            kept = any(problem.kept is not None for problem in problems.values())
            check(f"problems.{name}.keep", not kept, f"none: {NO_ROUTES}")
        new = dict(self.sets)
        if before is not None:
            held = self.sets if isinstance(before.problems, str) else before.problems
            new = {name: own for name, own in self.sets.items() if name not in held}
        with naming(self.folder, "cannot be written"):
            there = sorted((self.folder / "problems").glob("*/*.gr"))
        for path in there:
            name = path.parent.name
            if (before is None or name in new) and path.stem not in self.sets.get(name, ()):
                raise InputError(f"{path}: expected only problems of this experiment")
        # One part of each router and set, of those that are not finished: that of the largest seed.
        left = sorted(self._left(), key=lambda part: part.seed or 0)
        parts = {(part.set, part.entry.name): part for part in left}
        for part in parts.values():
            part.check(self.sets[part.set])
        digests = self._digests()
        for name, problems in new.items():
            lost = sorted({what for problem in problems.values() for what in problem.beyond_text})
            if lost:
                text = "routed and judged as ISPD text, which does not hold"
                warnings.warn(f"problems.{name}: {text}: {', '.join(lost)}", stacklevel=2)
            for problem in problems:
                problems[problem].write(self.folder / "problems" / name / f"{problem}.gr")
        plain = asdict(self.config)
        plain["routers"] = {**self._stored_routers, **plain["routers"]}
        if before is not None and isinstance(before.problems, Mapping):
            plain["problems"] = {**before.problems, **plain["problems"]}
        text = yaml_text(json.loads(json.dumps(plain)))
        if before is None or text != read_text(self.folder / CONFIG, MOST_TEXT):
            write_text(self.folder / CONFIG, text)
        if digests:
            write_text(self.folder / DIGESTS, json.dumps(digests, indent=1) + "\n")

    def _digests(self) -> dict[str, dict[str, str]]:
        """By router, digests of what its options name: files of policies, and code of the user's.

        Raises:
            InputError: rows were made with another content. What is gone is not compared.
        """
        file = self.folder / DIGESTS
        kept: dict[str, dict[str, str]] = {}
        if file.exists():
            kept = build_json(dict[str, dict[str, str]], read_text(file, MOST_TEXT), str(file))
        for entry in self.entries:
            if not entry.routes:
                continue  # what others made is read again every time
            parts = [part for part in self.parts if part.entry.name == entry.name]
            seeds = {part.seed: part for part in parts}.values()
            now = {name: digest for part in seeds for name, digest in part.digests().items()}
            before = kept.get(entry.name, {}) if any(part.rows.exists() for part in parts) else {}
            for name in now.keys() & before.keys():
                if now[name] != before[name]:
                    raise InputError(
                        f"{name}: changed since the rows in {self.folder} were made: expected "
                        "another folder for out"
                    )
            if now or entry.name in kept:
                kept[entry.name] = before | now
        return kept

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """All the work, router by router; routers that take long come last."""
        return tuple(
            Part(self.folder, name, entry, seed, share, self._scenario(name))
            for entry in sorted(self.entries, key=_slowness)
            for name, own in self.sets.items()
            if entry.only is None or name in entry.only
            for seed in (self.config.seeds if entry.seeded else (None,))
            for share in _shares(entry, own, self._scenario(name))
        )

    def _scenario(self, name: str) -> ScenarioSet | None:
        """The split of a scenario of policies that a set is; None for other sets."""
        if not isinstance(self.config.problems, Mapping):
            return None
        split = ScenarioSet.of(self.config.problems[name])
        known = split is not None and get(split.scenario).has_local_rule(split.split)
        return split if known else None

    def _left(self) -> list[Part]:
        """The work that is left; what others made is read again every time."""
        return [part for part in self.parts if not (part.entry.routes and part.finished)]

    def execute(self, watch: Callable[[float, int], Any] | None = None) -> dict[str, Any]:
        """Does the work that is left and writes the results.

        Whenever a router has finished all its problems, the results of all finished routers are
        written.

        Args:
            watch: called about once a second with the number of problems routed so far, a training
                under way counting as a fraction, and the total. A problem counts once for each
                router and seed.

        Returns:
            What ``summary.json`` holds; of a benchmark ``files``, the paths of its result files.
        """
        with working_in(self.folder):
            left = self._left()
            for part in left:
                if not part.entry.routes:
                    part.work()
            if left := [part for part in left if part.entry.routes]:
                self._work(left, watch)
            return self._write(self.entries)

    def _write(self, entries: Sequence[Entry]) -> dict[str, Any]:
        """Writes the results of finished routers; returns what ``summary.json`` holds."""
        rows = self._write_rows(entries)
        reference = self.config.reference
        if reference not in {entry.name for entry in entries}:
            reference = None
        sets = {name: summarise(own, reference) for name, own in by_set(rows).items()}
        summary = {"reference": reference, "types": self._types(rows), "sets": sets}
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=1) + "\n")
        from policies.figures.plot import experiment_figures  # matplotlib: not in the processes

        experiment_figures(self.folder)
        return summary

    def _write_rows(self, entries: Sequence[Entry]) -> list[Row]:
        """Writes the rows of finished routers in both forms; returns them."""
        rows = self._rows(entries)
        write_text(self.folder / RESULTS, json.dumps(rows, indent=1) + "\n")
        write_text(self.folder / "results.csv", to_csv(rows))
        return rows

    def _types(self, rows: Sequence[Row]) -> dict[str, dict[str, int]]:
        """By set, the number of problems of each of the paper's types, told by A*'s solutions."""
        types: dict[str, dict[str, int]] = {}
        for name, own in by_set(rows).items():
            astar = baseline(own)
            if name == ALL or astar is None:
                continue
            first = {row["problem"]: row for row in reversed(own) if row["router"] == astar}
            types[name] = {"I": 0, "II": 0}
            for problem, row in first.items():
                entry = next(entry for entry in self.entries if entry.name == row["router"])
                path = Part(self.folder, name, entry, row["seed"], (problem,)).solution(problem)
                routed = self.sets[name][problem]
                types[name][problem_type(routed, Solution.read(path, routed))] += 1
        return types

    def _work(self, left: Sequence[Part], watch: Callable[[float, int], Any] | None) -> None:
        """Works on parts; see :meth:`execute`."""
        trainings = {part.run: part.entry.options["train"] for part in left if part.entry.trains}
        threads = max((train["threads"] for train in trainings.values()), default=1)
        total = sum(len(part.problems) for part in self.parts)
        done = total - sum(len(part.problems) for part in left)
        missing = Counter(part.entry.name for part in left)
        written = 0  # routers in the results
        for parts in work_on(left, self.config.jobs or cores(), threads, self.config.engine):
            for part in parts:
                trainings.pop(part.run, None)
                done += len(part.problems)
            missing -= Counter(part.entry.name for part in parts)
            finished = [entry for entry in self.entries if not missing[entry.name]]
            if missing and len(finished) > written:
                self._write(finished)
                written = len(finished)
            if watch is not None:
                # A line is an episode of one problem.
                begun = (
                    _lines(run / METRICS) / train["episodes"] for run, train in trainings.items()
                )
                watch(done + sum(begun), total)

    def _rows(self, entries: Sequence[Entry]) -> list[Row]:
        """The rows of some routers, by set, problem, router and seed in the given order."""
        rows = {}
        names = {entry.name for entry in entries}
        for part in self.parts:
            if part.entry.name not in names:
                continue
            found = read_rows(part.rows)
            own = [{**part.columns, "seed": part.seed, "problem": name} for name in part.problems]
            if [{key: row[key] for key in own[0]} for row in found] != own:
                raise InputError(
                    f"{part.rows}: expected rows of {part.set}, {part.label}, "
                    f"{', '.join(part.problems)}; the results in this folder are of other options, "
                    "or of a scenario without a best local rule: give another --out"
                )
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


DIGESTS = "rows/digests.json"
"""Of files and code that the rows of an experiment depend on."""

_CHANGEABLE_KEYS = ("only", "label", "training_seconds")
"""Keys of entries that may change: no row depends on them."""


def _or_none(load: Callable[..., Any], *arguments: Any) -> Any:
    """What is loaded; None if it cannot be."""
    try:
        return load(*arguments)
    except InputError:
        return None


def _lines(path: Path) -> int:
    """The number of lines in a file; 0 as long as there is none."""
    try:
        return path.read_bytes().count(b"\n")
    except OSError:
        return 0


def _slowness(entry: Entry) -> int:
    """The rank of a router by how long it takes: provers take long, trainings take longest."""
    return 2 if entry.trains else int(entry.router == "optimal")


def _shares(
    entry: Entry, problems: Mapping[str, Problem], scenario: ScenarioSet | None
) -> list[tuple[str, ...]]:
    """The problems of a set, in groups that one process does at a time."""
    where = f"routers.{entry.name}"
    if entry.trains_on is not None:
        found = None if scenario is None else scenario.scenario
        what = f"{found}, whose problems it plays, found {entry.trains_on}"
        check(f"{where}.scenario", found == entry.trains_on, what)
    if scenario is None and entry.plays and not is_learner(entry.router):
        known = hasattr(lookup("router", entry.router), "route")
        what = f"a class with a method route: one with moves alone plays scenarios with {RULE_COST}"
        check(f"{where}.router", known, what)
    if not entry.routes or (scenario is not None and entry.plays):
        return [tuple(problems)]
    if not entry.trains:
        return [(name,) for name in problems]
    grids: dict[tuple[int, int, int], list[str]] = {}
    for name, problem in problems.items():
        grids.setdefault(problem.grid, []).append(name)  # a stack has only one grid shape
    size = entry.options["stack"]
    if entry.options["train"]["shared"]:
        if len(grids) > 1:
            raise InputError(
                f"routers.{entry.name}.train.shared: expected a set of one grid shape, "
                f"found {sorted(grids)}"
            )
        size = len(problems)
    return [
        tuple(names[i : i + size]) for names in grids.values() for i in range(0, len(names), size)
    ]
