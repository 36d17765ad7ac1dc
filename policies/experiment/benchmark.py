"""A benchmark: an experiment on the splits of scenarios, with a result file for each row.

Beside what an experiment writes, its folder holds SCENARIO.NAME.json for every scenario and router
(:mod:`policies.experiment.result`), of which the leaderboard is made.
"""

import json
import os
import platform
import re
import shlex
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from marouting import InputError, __version__, evaluate, scenarios, sequential_astar
from marouting.config import build, build_json, check
from marouting.errors import printable
from marouting.files import is_dir, is_file, read_text, stem_of, suffix_of
from marouting.scenarios.score import Figures
from marouting.yaml_files import override, read_yaml
from policies.engines import EngineName, cores, processor
from policies.experiment.config import (
    PUBLISHED,
    SEED,
    SOLUTIONS,
    Budget,
    Entry,
    ExperimentConfig,
    Split,
)
from policies.experiment.experiment import Experiment
from policies.experiment.part import Part
from policies.experiment.played import PLANNER, UNLEARNED, About
from policies.experiment.result import Outcome, Result, Scale, Task
from policies.results.rows import Row
from policies.results.run_folder import (
    EVALUATIONS,
    METRICS,
    policy_file,
    read_episodes,
    read_evaluations,
)
from policies.results.statistics import interquartile_mean
from policies.routers.registry import is_learner, router_names

SEEDS = 3
"""The default number of seeds."""

POINTS = 40
"""Points of a learning curve."""

_SPREAD = 1.5
"""Trainings of one budget differ by less, in agent-steps or in processor time."""

_ABOUT_BYTES = 2**16
"""The largest file about a policy that is read."""


# --- what is compared -----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class BenchmarkConfig:
    """Routers to compare, as a YAML file holds them; ``configs/benchmark/baselines.yaml`` has some.

    Attributes:
        routers: entries by name, as in an experiment
            (:class:`policies.experiment.config.ExperimentConfig`); ``only`` lists the scenarios
            that an entry is for. Beside the options, ``training_seconds`` is what training its
            checkpoint took.
        budget: of the entries that do not give their own, see
            :class:`policies.experiment.config.Budget`.
        seeds: how many seeds.
        jobs: the number of processes; None stands for one per core.
        engine: where the work is done, as in an experiment.
        train: keys of the run of every training, such as ``steps``, as in an experiment.
    """

    routers: dict[str, dict[str, Any] | None] = field(default_factory=dict)
    budget: str | None = None
    seeds: int | None = None
    jobs: int | None = None
    engine: EngineName = "local"
    train: dict[str, Any] = field(default_factory=dict)


def from_text(
    text: str, name: str | None, budget: Budget | None, scenario: str | None = None
) -> Entry:
    """An entry as the command line names it.

    Args:
        text: the name of a router or a learner, or ``module:Class``, each with options after it
            (``astar best_of=16 target=tree``; a folder of that name is ``./astar``); the file of a
            trained policy or the run folder of a training, of which there is one for each seed
            where ``{seed}`` stands in the name; a folder of solutions; or a CSV file with overflow
            and wirelength of solutions that are not at hand.
        name: what tables call it; None: the router and its options, or the name of the file.
        budget: the budget, applied to the options where they do not say otherwise.
        scenario: on whose training problems it is trained if it is a learner; None: on each
            problem that it routes.

    Raises:
        InputError: it is none of these, or an option is wrong.
    """
    raw: dict[str, Any]
    check("--router", text.strip(), "a name, a file or a folder, found nothing")
    path = Path(text.replace(SEED, "0"))
    is_name = text in router_names()
    policy = None if is_name else policy_file(path)
    if is_file(path) and suffix_of(path) == ".csv":
        raw, called = {"router": PUBLISHED, "file": text}, stem_of(path)
    elif policy is not None:
        file = Path(text) / policy.relative_to(path)  # with {seed} in its name
        raw = {"router": _learner_of(policy), "checkpoint": str(file)}
        called = file.stem if policy == path else file.absolute().parent.name
        called = called.replace(SEED, "")
    elif is_dir(path) and not is_name:
        raw, called = {"router": SOLUTIONS, "folder": text}, path.resolve().name
    else:
        try:
            router, *options = shlex.split(text)
        except ValueError as error:
            raise InputError(f"--router {text}: {error}") from None
        named = ":" in router or router in router_names()
        if not named and (os.sep in router or "." in router):
            raise InputError(f"--router {text}: expected a file or a folder, found none there")
        is_learner(router, "--router")
        raw = {**override({}, options), "router": router}
        called = "-".join([router, *(option.partition("=")[2] for option in options)])
    called = name or re.sub(r"[^\w-]+", "-", called).strip("-_") or "router"
    source = ["--router", text, *(["--name", name] if name else [])]
    return _entry(called, raw, budget, source, scenario)


def _entry(
    name: str,
    raw: Mapping[str, Any],
    budget: Budget | None,
    source: list[str],
    scenario: str | None,
) -> Entry:
    """An entry with a budget, unless it has its own, and bound to this version."""
    options, router = dict(raw), raw.get("router")
    named = isinstance(router, str) and router not in (PUBLISHED, SOLUTIONS)
    learns = named and is_learner(str(router))
    if scenario is not None and learns and "checkpoint" not in raw:
        what = f"--training-steps or --training-seconds: {name} is trained once"
        check("--budget", budget is None and "budget" not in raw, what)
        options["scenario"] = scenario
    elif budget is not None:
        options.setdefault("budget", budget.text)
        source = [*source, "--budget", budget.text]
    entry = Entry.of(name, options)
    version = __version__ if entry.routes else None
    return replace(entry, version=version, source=shlex.join(source))


def _learner_of(checkpoint: Path) -> str:
    """The learner whose policy a file holds; raises InputError if it holds none."""
    from policies.learned.checkpoint import read_checkpoint  # torch: only if something learned

    state = read_checkpoint(checkpoint, training=False)
    learner = state.get("learner")
    kind = learner.get("kind") if isinstance(learner, Mapping) else None
    if not isinstance(kind, str):
        raise InputError(f"{checkpoint}: expected a trained policy")
    return kind


def load_entries(
    path: str | os.PathLike[str],
    overrides: Sequence[str],
    budget: Budget | None,
    scenario: str | None = None,
) -> tuple[list[Entry], BenchmarkConfig]:
    """The entries of a configuration, and the configuration.

    Args:
        path: a YAML file.
        overrides: ``key=value``, as :func:`marouting.yaml_files.override` takes them.
        budget: what the command line says; None for the configuration's own.
        scenario: on whose training problems learners are trained; None: on each problem.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    where = os.fspath(path)
    config = build(BenchmarkConfig, override(read_yaml(path), overrides), where)
    source = ["--config", where, *overrides]
    if budget is None and config.budget is not None:
        budget = Budget.parse(config.budget)
        config = replace(config, budget=budget.text)
    found = [
        _entry(name, raw, budget, source, scenario)
        for name, raw in config.routers.items()
        if raw is not None
    ]
    check(f"{where}: routers", found, "at least one")
    return found, config


# --- running it -----------------------------------------------------------------------------------


class Benchmark(Experiment):
    """Entries on the problems of scenarios.

    Args:
        names: the scenarios' names.
        entries: what to compare; ``only`` are names of scenarios.
        folder: where all files go.
        split: which problems: ``test`` or ``validation``.
        seeds: how many seeds, from 0; None for SEEDS.
        jobs: the largest number of processes; None for one per core.
        engine: where the work is done, as in an experiment.
        train: keys of the run of every training, as in an experiment.

    Raises:
        InputError: there is no such scenario or entry, two have one name, a file is not one, or the
            folder holds something else.
    """

    def __init__(
        self,
        names: Sequence[str],
        entries: Sequence[Entry],
        folder: Path,
        *,
        split: Split = "test",
        seeds: int | None = None,
        jobs: int | None = None,
        engine: EngineName = "local",
        train: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        check("seeds", seeds is None or 1 <= seeds <= 1000, "a number from 1 to 1000")
        tail = "" if split == "test" else f".{split}"
        self.split: Split = split
        self.scenarios = {f"{name}{tail}": scenarios.get(name) for name in names}
        self.sources = {entry.name: entry.source for entry in entries}
        self._tasks: dict[str, tuple[Task, ...]] = {}
        called = [entry.name for entry in entries]
        routers: dict[str, dict[str, Any] | None] = {}
        for entry in entries:
            check(
                f"routers.{entry.name}",
                called.count(entry.name) == 1,
                "another name: there are two",
            )
            for name in entry.only or ():
                _ = scenarios.get(name)  # or an error
            sets = [f"{name}{tail}" for name in entry.only or names if name in names]
            for scenario in map(scenarios.get, names if entry.trains else ()):
                fits = entry.trains_on == scenario.name or not scenario.has_local_rule(split)
                what = f"{scenario.name} alone with {entry.name}, which is trained for it"
                check("--scenario", fits and (len(names) == 1 or not entry.trains_on), what)
            if sets:
                routers[entry.name] = {**entry.plain, "only": sets if entry.only else None}
        super().__init__(
            ExperimentConfig(
                out=os.fspath(folder),
                seeds=tuple(range(SEEDS if seeds is None else seeds)),
                engine=engine,
                jobs=jobs,
                problems={
                    name: {"scenario": scenario.name, "split": split}
                    for name, scenario in self.scenarios.items()
                },
                routers=routers,
                train=dict(train),
            )
        )

    def _write(self, entries: Sequence[Entry]) -> dict[str, Any]:
        """Writes the rows, and the result files of finished entries, whose paths are returned."""
        rows = self._write_rows(entries)
        files = []
        for name in self.scenarios:
            for entry in entries:
                found = [row for row in rows if (row["set"], row["router"]) == (name, entry.name)]
                if found:
                    files.append(self._result(name, entry, found).write(self.folder))
        return {"files": files}

    def _tasks_of(self, name: str) -> tuple[Task, ...]:
        """The problems of a set with their A* and their reference."""
        if name not in self._tasks:
            tasks, scenario = [], self.scenarios[name]
            known = scenario.has_references(self.split)
            for problem_name, problem in self.sets[name].items():
                best = scenario.reference(problem) if known else None
                found = evaluate(problem, sequential_astar(problem))
                tasks.append(
                    Task(
                        problem=problem_name,
                        astar=Figures.of(found),
                        reference=None if best is None else (0, best.overflow, best.wirelength),
                        proven=best is not None and best.proven,
                        tasks=found.tasks if self._scale(name) else None,
                    )
                )
            self._tasks[name] = tuple(tasks)
        return self._tasks[name]

    def _result(self, name: str, entry: Entry, rows: Sequence[Row]) -> Result:
        """The result of an entry on a set."""
        tasks = {task.problem: task for task in self._tasks_of(name)}
        outcomes = tuple(Outcome.of(row, tasks[row["problem"]]) for row in rows)
        times = [outcome.seconds for outcome in outcomes if outcome.seconds is not None]
        spent = round(sum(times), 3) if len(times) == len(outcomes) else None
        trained = spent if entry.trains else entry.training_seconds
        if trained is None and entry.routes and "checkpoint" not in entry.options:
            trained = 0.0
        scale = self._scale(name)
        policy = None if scale is None else self._about(name, entry)
        if policy is not None and entry.plays:
            trained = policy.training_seconds
        seeds_trained = len(self.config.seeds) if scale is not None and entry.seeded else 1
        total = None if None in (spent, trained) else (spent or 0) + seeds_trained * (trained or 0)
        if entry.trains and scale is None:  # which is in the time of the rows
            total = spent
        size = "1 core" if cores() == 1 else f"{cores()} cores"
        scenario = self.scenarios[name].name
        command = ["marouting", "benchmark", "--scenario", scenario]
        command += [] if self.split == "test" else ["--split", self.split]
        seeds = ["--seeds", str(len(self.config.seeds))] if entry.seeded else []
        return Result(
            scenario=scenario,
            split=self.split,
            name=entry.name,
            router=entry.router,
            options=json.loads(json.dumps(dict(entry.options))),
            budget=entry.allowed,
            version=__version__,
            machine=", ".join((processor(), size, platform.system())),
            command=printable(" ".join([shlex.join(command), self.sources[entry.name], *seeds])),
            date=time.strftime("%Y-%m-%d"),
            scale=scale,
            policy=policy,
            seconds=None if total is None else round(total, 3),
            training_seconds=trained,
            tasks=tuple(tasks.values()),
            outcomes=outcomes,
            curve=self._curve(name, entry, tasks),
        )

    def _parts_of(self, name: str, entry: Entry) -> list[Part]:
        return [part for part in self.parts if (part.set, part.entry.name) == (name, entry.name)]

    def _scale(self, name: str) -> Scale | None:
        """How a set is scored if it is the split of a scenario of policies."""
        scenario = self.scenarios[name]
        if not scenario.has_local_rule(self.split):
            return None
        return Scale(local_rule=scenario.local_rule(self.split), open_cost=scenario.open_cost)

    def _about(self, name: str, entry: Entry) -> About:
        """What is known of an entry on a split of a scenario of policies: means over the seeds."""
        if not entry.plays:
            return build(About, {"sight": PLANNER, **(UNLEARNED if entry.routes else {})})
        files = [part.about_file for part in self._parts_of(name, entry)]
        found = [build_json(About, read_text(file, _ABOUT_BYTES), str(file)) for file in files]
        for file, one in zip(files, found, strict=True):
            for key in ("sight", "teacher", "parameters"):
                expected, value = getattr(found[0], key), getattr(one, key)
                check(f"{file}: {key}", value == expected, f"{expected}, as in {files[0]}")
        took = {
            key: [getattr(one, key) for one in found] for key in ("agent_steps", "training_seconds")
        }
        known = [values for values in took.values() if None not in values]
        lengths = took["agent_steps"]
        apart = known and all(max(values) > _SPREAD * min(values) for values in known)
        what = f"trainings of one length, found agent-steps of {lengths}"
        check(f"routers.{entry.name}: seeds", not apart, what)
        means = {
            key: None if None in values else statistics.fmean(values)
            for key, values in took.items()
        }
        steps, seconds = means["agent_steps"], means["training_seconds"]
        return replace(
            found[0],
            agent_steps=None if steps is None else round(steps),
            training_seconds=None if seconds is None else round(seconds, 1),
        )

    def _curve(
        self, name: str, entry: Entry, tasks: Mapping[str, Task]
    ) -> tuple[tuple[int, float], ...]:
        """The learning curve of what was trained here, as far as there are scores."""
        if not entry.trains or any(task.reference is None for task in tasks.values()):
            return ()
        if entry.trains_on is not None:
            runs = [part.run for part in self._parts_of(name, entry)]
            return _validation_curve([validation_scores(run, entry.trains_on) for run in runs])
        episodes = entry.options["train"]["episodes"]
        at = np.unique(np.geomspace(1, episodes, POINTS).round().astype(int))
        curves = []
        for part in self._parts_of(name, entry):
            best: dict[str, list[Figures]] = {problem: [] for problem in part.problems}
            for played in read_episodes(part.run / METRICS):
                so_far = best[played.problem]
                # Two-pin tasks stand for nets here: a net is open if one of its tasks is.
                found = Figures(played.tasks - played.joined, played.overflow, played.wirelength)
                so_far.append(min(found, so_far[-1]) if so_far else found)
            curves += [
                [tasks[problem].score(so_far[min(i, len(so_far)) - 1]) for i in at]
                for problem, so_far in best.items()
            ]
        means = [interquartile_mean(column) for column in np.array(curves).T]
        return tuple((int(i), round(mean, 6)) for i, mean in zip(at, means, strict=True))


def validation_scores(run: Path, scenario: str) -> list[tuple[int, float]]:
    """Agent-steps and the score on the validation problems, of each evaluation of a training."""
    found = scenarios.get(scenario)
    problems, least = found.problems("validation"), found.reference_cost("validation")
    costs: dict[int, list[float]] = {}
    for evaluation in read_evaluations(run / EVALUATIONS):
        cost = found.cost(
            evaluation.wirelength, evaluation.tasks - evaluation.joined, evaluation.overflow
        )
        costs.setdefault(evaluation.agent_steps, []).append(cost)
    return [
        (steps, found.score(sum(problem_costs) / least, "validation"))
        for steps, problem_costs in costs.items()
        if len(problem_costs) == len(problems)
    ]


def _validation_curve(
    seeds: Sequence[Sequence[tuple[int, float]]],
) -> tuple[tuple[int, float], ...]:
    """The mean of the curves of seeds, at no more than POINTS of the steps of the first."""
    if min(map(len, seeds)) < 2:  # the training ended before an episode did
        return ()
    steps = np.array([step for step, _ in seeds[0]])
    at = steps[np.unique(np.linspace(0, len(steps) - 1, POINTS).round().astype(int))]
    scores = [np.interp(at, *np.array(curve).T) for curve in seeds]
    means = np.mean(scores, axis=0)
    return tuple((int(i), round(float(mean), 6)) for i, mean in zip(at, means, strict=True))
