"""A benchmark in its folder: what is not done yet is done, and a result file written for each row.

The folder holds SCENARIO.NAME.json for every row (:mod:`policies.benchmark.result`), and a folder
for every scenario with the work behind them: problems, solutions and run folders as an experiment
has them (:mod:`policies.results.experiment_folder`), and what each row was asked to do
(``contenders/NAME.json``). A benchmark that was stopped goes on from there.
"""

import json
import platform
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from marouting import InputError, Problem, Solution, __version__, evaluate, scenarios
from marouting.config import build_json, check, check_same
from marouting.files import read_text, write_text
from marouting.scenarios import Scenario
from policies.benchmark.contenders import SEEDS, SOLUTIONS, Contender
from policies.benchmark.result import MOST_BYTES, Outcome, Result, Split, Task
from policies.benchmark.score import Figures
from policies.benchmark.statistics import interquartile_mean
from policies.engines import EngineName, check_engine, cores, processor
from policies.experiment.config import PUBLISHED, Published
from policies.experiment.part import Part
from policies.experiment.work import work_on
from policies.results.folder import working_in
from policies.results.rows import read_rows
from policies.results.run_folder import METRICS, read_episodes
from policies.routers.astar import AStarRouter

POINTS = 40
"""Points of a learning curve."""


@dataclass(frozen=True)
class _Set:
    """The problems of a split of a scenario, and where the work on them lies."""

    scenario: Scenario
    split: Split
    folder: Path

    @property
    def name(self) -> str:
        return self.scenario.name if self.split == "test" else f"{self.scenario.name}.{self.split}"

    @property
    def problems(self) -> dict[str, Problem]:
        return self.scenario.problems(self.split)

    def write(self) -> None:
        """Writes the problems that are not there yet; raises InputError where others are."""
        for name, problem in self.problems.items():
            path = self.folder / "problems" / self.name / f"{name}.gr"
            if not path.exists():
                problem.write(path)
            elif Problem.read(path) != problem:
                raise InputError(f"{path}: expected the problem of {self.name}: another --out?")

    def tasks(self) -> tuple[Task, ...]:
        """The problems with their A* and their reference."""
        tasks = []
        for name, problem in self.problems.items():
            best = self.scenario.reference(problem)
            tasks.append(
                Task(
                    problem=name,
                    astar=Figures.of(evaluate(problem, AStarRouter().route(problem))),
                    reference=(0, best.overflow, best.wirelength),
                    proven=best.proven,
                )
            )
        return tuple(tasks)


class Benchmark:
    """Contenders on the problems of scenarios.

    Its processes import the main module, so a script that runs a benchmark needs the usual
    ``if __name__ == "__main__":``.

    Args:
        names: the scenarios' names.
        contenders: what to compare.
        folder: where all files go.
        split: which problems: ``test`` or ``validation``.
        seeds: how many seeds, from 0; None for SEEDS.
        jobs: the largest number of processes; None for one per core.
        engine: where the work is done, as in an experiment.

    Raises:
        InputError: there is no such scenario or contender, two have one name, or a file is not one.
    """

    def __init__(
        self,
        names: Sequence[str],
        contenders: Sequence[Contender],
        folder: Path,
        *,
        split: Split = "test",
        seeds: int | None = None,
        jobs: int | None = None,
        engine: EngineName = "local",
    ) -> None:
        check_engine(engine)
        check("seeds", seeds is None or 1 <= seeds <= 1000, "a number from 1 to 1000")
        check("jobs", jobs is None or 1 <= jobs <= 1024, "a number from 1 to 1024")
        called = [contender.entry.name for contender in contenders]
        for name in called:
            check(f"routers.{name}", called.count(name) == 1, "another name: there are two")
        for contender in contenders:
            for scenario in contender.entry.only or ():
                _ = scenarios.get(scenario)  # or an error
        self.folder, self.contenders = folder, tuple(contenders)
        self.sets = tuple(
            _Set(scenarios.get(name), split, folder / name) for name in dict.fromkeys(names)
        )
        for one in self.sets:
            for problem in one.problems.values():
                _ = one.scenario.reference(problem)  # or an error, before hours of work
        self._seeds = SEEDS if seeds is None else seeds
        self._jobs = jobs or cores()
        self._engine: EngineName = engine

    @property
    def _rows(self) -> Iterator[tuple[_Set, Contender]]:
        """What the result files are about, slow ones last."""
        order = sorted(self.contenders, key=lambda contender: contender.entry.trains)
        for contender in order:
            only = contender.entry.only
            for one in self.sets:
                if only is None or one.scenario.name in only:
                    yield one, contender

    def _parts(self, one: _Set, contender: Contender) -> tuple[Part, ...]:
        """The work on a row; nothing for what was routed elsewhere."""
        if not contender.routes:
            return ()
        entry = contender.entry
        seeds = range(self._seeds) if entry.seeded else (None,)
        names = list(one.problems)
        size = 1
        if entry.trains:
            size = len(names) if entry.options["train"]["shared"] else entry.options["stack"]
        return tuple(
            Part(one.folder, one.name, entry, seed, tuple(names[i : i + size]))
            for seed in seeds
            for i in range(0, len(names), size)
        )

    def execute(self, watch: Callable[[float, int], Any] | None = None) -> list[Path]:
        """Does the work that is left and writes the result files.

        Args:
            watch: called about once a second with the number of problems routed so far, once for
                each row and seed, and their number in all.

        Returns:
            The result files, scenario by scenario in the order of the contenders.
        """
        with ExitStack() as stack:
            for one in self.sets:
                stack.enter_context(working_in(one.folder))
            for one, contender in self._rows:
                self._begin(one, contender)
            parts = [part for row in self._rows for part in self._parts(*row)]
            left = [part for part in parts if not part.rows.exists()]
            total = sum(len(part.problems) for part in parts)
            done = total - sum(len(part.problems) for part in left)
            threads = [p.entry.options["train"]["threads"] for p in left if p.entry.trains]
            written: dict[tuple[str, str], Path] = {}
            tasks: dict[str, tuple[Task, ...]] = {}

            def write_finished() -> None:
                for one, contender in self._rows:
                    key = one.name, contender.entry.name
                    own = self._parts(one, contender)
                    if key not in written and all(part.rows.exists() for part in own):
                        if one.name not in tasks:
                            tasks[one.name] = one.tasks()
                        result = self._result(one, contender, tasks[one.name])
                        written[key] = result.write(self.folder)

            write_finished()
            if left:
                most = max(threads, default=1)
                for finished in work_on(left, self._jobs, most, self._engine):
                    done += sum(len(part.problems) for part in finished)
                    if finished:
                        write_finished()
                    if watch is not None:
                        watch(done, total)
        return [
            written[one.name, contender.entry.name]
            for one in self.sets
            for contender in self.contenders
            if (one.name, contender.entry.name) in written
        ]

    def _begin(self, one: _Set, contender: Contender) -> None:
        """Keeps what a row is asked to do; raises InputError if it was asked something else."""
        one.write()
        entry = contender.entry
        if not contender.routes:
            return
        path = one.folder / "contenders" / f"{one.split}.{entry.name}.json"
        asked = {"version": __version__, "router": entry.router, **entry.options}
        if path.exists():
            kept = build_json(dict[str, Any], read_text(path, MOST_BYTES), str(path))
            mine = json.loads(json.dumps(asked))
            try:
                check_same(mine, kept, path)
            except InputError as error:
                hint = "another name or folder starts anew"
                raise InputError(f"{entry.name}: {error}; {hint}") from None
            return
        parts = self._parts(one, contender)
        parts[0].check(one.problems)
        write_text(path, json.dumps(asked, indent=1) + "\n")

    def _result(self, one: _Set, contender: Contender, tasks: tuple[Task, ...]) -> Result:
        """The result of a row that is finished."""
        by_name = {task.problem: task for task in tasks}
        entry = contender.entry
        if entry.router == SOLUTIONS:
            outcomes = list(self._read_folder(one, Path(entry.options["folder"]), by_name))
        elif entry.router == PUBLISHED:
            outcomes = list(self._read_published(one, Published(**entry.options)))
        else:
            outcomes = list(self._read_parts(one, contender, by_name))
        times = [outcome.seconds for outcome in outcomes]
        spent = None if None in times else round(sum(t for t in times if t is not None), 3)
        trained = spent if entry.trains else contender.training_seconds
        options = json.loads(json.dumps(dict(entry.options)))
        size = "1 core" if cores() == 1 else f"{cores()} cores"
        seeds = [] if not entry.seeded else ["--seeds", str(self._seeds)]
        split = [] if one.split == "test" else ["--split", one.split]
        given = shlex.join(["marouting", "benchmark", "--scenario", one.scenario.name, *split])
        return Result(
            scenario=one.scenario.name,
            split=one.split,
            name=entry.name,
            router=entry.router,
            options=options,
            budget=contender.budget,
            version=__version__,
            machine=", ".join((processor(), size, platform.system())),
            command=" ".join([given, contender.source, *seeds]),
            date=time.strftime("%Y-%m-%d"),
            seconds=None if None in (spent, trained) else _total(spent, trained, entry.trains),
            training_seconds=trained,
            tasks=tasks,
            outcomes=tuple(outcomes),
            curve=self._curve(one, contender, by_name),
        )

    def _read_parts(
        self, one: _Set, contender: Contender, tasks: dict[str, Task]
    ) -> Iterator[Outcome]:
        """What was routed here, problem by problem and then seed by seed."""
        found = {}
        for part in self._parts(one, contender):
            for row in read_rows(part.rows):
                known = row["problem"] in part.problems and row["seed"] == part.seed
                check(f"{part.rows}", known, f"rows of {', '.join(part.problems)}")
                solution = Solution.read(
                    part.solution(row["problem"]), one.problems[row["problem"]]
                )
                found[row["problem"], part.seed] = outcome(
                    tasks[row["problem"]], part.seed, solution, row["seconds"]
                )
        place = {name: number for number, name in enumerate(one.problems)}
        yield from (found[key] for key in sorted(found, key=lambda k: (place[k[0]], k[1] or 0)))

    def _read_folder(self, one: _Set, folder: Path, tasks: dict[str, Task]) -> Iterator[Outcome]:
        """The solutions in a folder; raises InputError unless there is one for each problem."""
        files = sorted(path.name for path in folder.iterdir() if path.is_file())
        for name, problem in one.problems.items():
            own = [file for file in files if file.startswith(f"{name}.") and file != f"{name}.gr"]
            if len(own) != 1:
                raise InputError(
                    f"{folder}: expected one solution {name}.*, found {', '.join(own) or 'none'}"
                )
            solution = Solution.read(folder / own[0], problem)
            yield outcome(tasks[name], None, solution, None)

    def _read_published(self, one: _Set, published: Published) -> Iterator[Outcome]:
        """Overflow and wirelength without routes, which do not tell what is open."""
        found = published.read()
        for name in one.problems:
            if (one.scenario.name, name) not in found:
                raise InputError(f"{published.file}: expected a row for {one.scenario.name},{name}")
            overflow, wirelength = found[one.scenario.name, name]
            yield Outcome(
                problem=name,
                seed=None,
                open=None,
                overflow=overflow,
                wirelength=wirelength,
                score=None,
            )

    def _curve(
        self, one: _Set, contender: Contender, tasks: dict[str, Task]
    ) -> tuple[tuple[int, float], ...]:
        """The learning curve of what was trained here."""
        if not contender.entry.trains:
            return ()
        episodes = contender.entry.options["train"]["episodes"]
        at = np.unique(np.geomspace(1, episodes, POINTS).round().astype(int))
        curves = []
        for part in self._parts(one, contender):
            best: dict[str, list[Figures]] = {name: [] for name in part.problems}
            for played in read_episodes(part.run / METRICS):
                own = best[played.problem]
                # Two-pin tasks stand for nets here: a net is open if one of its tasks is.
                found = Figures(played.tasks - played.joined, played.overflow, played.wirelength)
                own.append(min(found, own[-1]) if own else found)
            curves += [
                [tasks[name].score(own[min(i, len(own)) - 1]) for i in at]
                for name, own in best.items()
            ]
        means = [interquartile_mean(column) for column in np.array(curves).T]
        return tuple((int(i), round(mean, 6)) for i, mean in zip(at, means, strict=True))


def outcome(task: Task, seed: int | None, solution: Solution, seconds: float | None) -> Outcome:
    """A solution of a problem, judged."""
    found = evaluate(solution.problem, solution)
    figures = Figures.of(found)
    return Outcome(
        problem=task.problem,
        seed=seed,
        **figures._asdict(),
        vias=found.vias,
        seconds=seconds,
        score=round(task.score(figures), 9),
    )


def _total(spent: float | None, trained: float | None, trains: bool) -> float:
    """All that a row takes: a training of the problems is in the rows' time already."""
    return round((spent or 0) + (0 if trains else trained or 0), 3)
