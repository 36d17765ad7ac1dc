"""A part of an experiment's work, which one process can do, and the processes that do parts."""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from marouting import InputError, Problem, Solution
from marouting.config import build, code_named
from marouting.files import naming, write_text
from marouting.registry import allowing_code
from policies.engines import Call, EngineName, opened
from policies.experiment.config import PARTS, PUBLISHED, SOLUTIONS, Entry, Published
from policies.learned.burn_in import read_solutions
from policies.learned.config import Config, load_config
from policies.results import run_folder
from policies.results.rows import COLUMNS, Row, figures_of, solution_row
from policies.routers.base import Router, solve, warm_up
from policies.routers.registry import is_learner, make_router


@dataclass(frozen=True)
class Part:
    """Some problems of a set, for one router with one seed.

    Attributes:
        folder: the experiment's folder.
        set: the set's name.
        entry: the router.
        seed: the seed; None for a router that draws no random numbers.
        problems: the names of the problems; the part's files are named after the first.
    """

    folder: Path
    set: str
    entry: Entry
    seed: int | None
    problems: tuple[str, ...]

    @property
    def label(self) -> str:
        """The router's name with the seed, as file names carry it."""
        return self.entry.name if self.seed is None else f"{self.entry.name}.seed{self.seed}"

    @property
    def rows(self) -> Path:
        """The file with the rows; it exists when the part is finished."""
        return self.folder / "rows" / self.set / self.label / f"{self.problems[0]}.json"

    @property
    def run(self) -> Path:
        """The run folder, if the router is trained."""
        return self.folder / "runs" / self.set / self.label / self.problems[0]

    def problem(self, name: str) -> Path:
        """The file of a problem."""
        return self.folder / "problems" / self.set / f"{name}.gr"

    def solution(self, name: str) -> Path:
        """The file for the solution of a problem."""
        return self.folder / "solutions" / self.set / f"{name}.{self.label}.solution"

    @property
    def gpus(self) -> int:
        """The number of GPUs that it needs."""
        return int(self.entry.trains and self.entry.options["train"]["device"] != "cpu")

    def work(self) -> None:
        """Routes the problems, writes the solutions, and then the rows."""
        try:
            if self.entry.router == PUBLISHED:
                rows = self._quote()
            elif self.entry.trains:
                rows = self._train()
            else:
                rows = [self._route(name) for name in self.problems]
        except InputError as error:
            raise InputError(f"{self.set}, {self.label}: {error}") from None
        about = {"set": self.set, "router": self.entry.name, "kind": self.entry.router}
        full = [{**dict.fromkeys(COLUMNS), **row, **about, "seed": self.seed} for row in rows]
        write_text(self.rows, json.dumps(full, indent=1) + "\n")

    def check(self, problems: Mapping[str, Problem]) -> None:
        """Raises InputError for files that the router cannot use: now, not after hours.

        Args:
            problems: all problems of the set, by name.
        """
        if self.entry.router == PUBLISHED:
            self._quote()
        elif self.entry.router == SOLUTIONS:
            for name, problem in problems.items():
                self._external(name, problem)
        elif self.entry.trains:
            from policies.learned.trainer import Trainer  # torch: only if something learned

            first = self.problems[0]
            trainer = Trainer({first: problems[first]}, self._training())
            learner, _ = trainer.learner, trainer.start
            if learner.learning_starts:
                _ = read_solutions(learner.burn_in, problems)
        elif "checkpoint" in self.entry.options and is_learner(self.entry.router):
            from policies.learned.policy import TrainedPolicy

            for name, problem in problems.items():
                TrainedPolicy.load(self.entry.options["checkpoint"], name).check(problem)

    def _quote(self) -> list[Row]:
        """The rows of a published router; raises InputError if one is missing."""
        published = Published(**self.entry.options)
        found = published.read()
        known = self.set, self.set.removesuffix(".validation")
        rows = []
        for name in self.problems:
            key = next(((of, name) for of in known if (of, name) in found), None)
            if key is None:
                raise InputError(f"{published.file}: expected a row for {known[-1]},{name}")
            overflow, wirelength = found[key]
            figures = {"overflow": overflow, "wirelength": wirelength}
            rows.append({"problem": name, **figures, "proven": published.optimal})
        return rows

    def _external(self, name: str, problem: Problem) -> Solution:
        """The solution of a problem in a folder; raises InputError if there is none."""
        folder = Path(self.entry.options["folder"])
        with naming(folder, "cannot be read"):
            files = sorted(
                path.name
                for path in folder.iterdir()
                if path.name.startswith(f"{name}.") and path.suffix != ".gr" and path.is_file()
            )
        if len(files) != 1:
            raise InputError(
                f"{folder}: expected one solution {name}.*, found {', '.join(files) or 'none'}"
            )
        return Solution.read(folder / files[0], problem)

    def _route(self, name: str) -> Row:
        problem = Problem.read(self.problem(name))
        report: Mapping[str, Any] = {}
        seconds: float | None = None
        if self.entry.router == SOLUTIONS:
            solution = self._finished(self._external(name, problem))
        else:
            router = self._router(name)
            self._warm_up(router)
            started = time.perf_counter()
            solution, report = solve(router, problem)
            solution = self._finished(solution)
            seconds = time.perf_counter() - started
        solution.write(self.solution(name))
        proven = report["status"] == "optimal" if "status" in report else None
        row = {"problem": name, **solution_row(solution, seconds), "proven": proven}
        return {**row, "from": report.get("from")}

    def _finished(self, solution: Solution) -> Solution:
        """A solution as it is judged."""
        return solution.pruned() if self.entry.prune else solution

    def _router(self, problem: str) -> Router:
        if "checkpoint" in self.entry.options and is_learner(self.entry.router):
            from policies.learned.router import LearnedRouter  # torch: only if something learned

            return LearnedRouter(checkpoint=self.entry.options["checkpoint"], network=problem)
        seed = {} if self.seed is None else {"seed": self.seed}
        return make_router(self.entry.router, {**self.entry.options, **seed})

    def _warm_up(self, router: Router) -> None:
        """Does so once per process, so that no time includes compiling."""
        if self.entry.name not in _warm:
            warm_up(router)
            _warm.add(self.entry.name)

    def _train(self) -> list[Row]:
        from policies.learned.router import LearnedRouter
        from policies.learned.run import Run

        kept = self.run / run_folder.CONFIG
        if not (self.run / run_folder.POLICY).exists():
            with allowing_code(name for _, name in code_named(self.entry)):
                config = load_config(kept) if kept.exists() else self._training()
            # The folder may have been renamed since the training was started.
            config = replace(config, out=str(self.run))
            if not kept.exists():
                self._warm_up(LearnedRouter(config))
            Run(config, resume=kept.exists()).execute()
        # The checkpoint of a finished training is large and of no use.
        (self.run / run_folder.CHECKPOINT).unlink(missing_ok=True)
        found = run_folder.read_result(self.run)
        rows = [row for row in found if row["router"] == self.entry.router]
        for row in rows:
            name = row["problem"]
            problem = Problem.read(self.problem(name))
            file = run_folder.solution_file(self.run, name, self.entry.router)
            solution = self._finished(Solution.read(file, problem))
            row |= figures_of(solution)
            solution.write(self.solution(name))
        return rows

    def _training(self) -> Config:
        parts = {key: dict(self.entry.options[key]) for key in PARTS}
        parts["env"]["problem"] = [str(self.problem(name)) for name in self.problems]
        return build(Config, {"seed": self.seed, **parts})


_warm: set[str] = set()
"""The routers that this process has used already, and whether for large problems."""


def work_on(
    parts: Sequence[Part], jobs: int, threads: int, engine: EngineName = "local"
) -> Iterator[list[Part]]:
    """Works on parts, in order as far as there is room; about every second those done since.

    All work ends at once when the iteration ends early, by an error or Ctrl-C, or when this process
    is killed.

    Raises:
        InputError: a process was killed.
        Exception: whatever a part raises.
    """
    with opened(engine, min(jobs, len(parts)), threads) as pool:
        for done in pool.run([Call(part.work, (), part.gpus) for part in parts]):
            yield [parts[number] for number in done]
