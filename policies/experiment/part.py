"""A part of an experiment's work, which one process can do."""

import json
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from marouting import InputError, Problem, Solution
from marouting.config import build, code_named
from marouting.files import is_file, write_text
from marouting.registry import allowing_code
from policies.experiment.config import PARTS, PUBLISHED, Entry, Published
from policies.learned.burn_in import read_solutions, solution_files
from policies.learned.config import Config, load_config
from policies.results import experiment_folder, run_folder
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
        return experiment_folder.label(self.entry.name, self.seed)

    @property
    def rows(self) -> Path:
        """The file with the rows; it exists when the part is finished."""
        return experiment_folder.rows_file(
            self.folder, self.set, self.entry.name, self.seed, self.problems[0]
        )

    @property
    def run(self) -> Path:
        """The run folder, if the router is trained."""
        runs = experiment_folder.runs_folder(self.folder, self.set, self.entry.name, self.seed)
        return runs / self.problems[0]

    def problem(self, name: str) -> Path:
        """The file of a problem."""
        return experiment_folder.problem_file(self.folder, self.set, name)

    def solution(self, name: str) -> Path:
        """The file for the solution of a problem."""
        return experiment_folder.solution_file(
            self.folder, self.set, name, self.entry.name, self.seed
        )

    @property
    def gpus(self) -> int:
        """The number of GPUs that it needs."""
        return int(self.entry.trains and self.entry.options["train"]["device"] != "cpu")

    @property
    def named(self) -> Mapping[str, tuple[Path, ...]]:
        """The files that options name, by the option: a file, or a burn-in's folder of solutions.

        Any text that looks like a file's name, and is one, is taken for it.
        """
        found: dict[str, tuple[Path, ...]] = {
            text: (Path(text),)
            for text in _texts(self.entry.options)
            if (Path(text).suffix or os.sep in text) and is_file(text)
        }
        if self.entry.trains and "burn_in" in self.entry.options["learner"]:
            burn_in = self.entry.options["learner"]["burn_in"]
            found[burn_in] = tuple(solution_files(burn_in, self.problems))
        return {text: files for text, files in found.items() if files}

    def reads(self) -> list[Path]:
        """The files that it reads, but for those of a training that has begun."""
        named = (path for files in self.named.values() for path in files)
        return list(dict.fromkeys((*map(self.problem, self.problems), *named)))

    def work(self) -> None:
        """Routes the problems, writes the solutions, and then the rows."""
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

    def check(self, problems: Mapping[str, Problem]) -> None:
        """Raises InputError for files that the router cannot use: now, not after hours.

        Args:
            problems: all problems of the set, by name.
        """
        if self.entry.router == PUBLISHED:
            self.quote()
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
        solution = solution.pruned() if self.entry.prune else solution
        seconds = time.perf_counter() - started
        solution.write(self.solution(name))
        proven = report["status"] == "optimal" if "status" in report else None
        row = {"problem": name, **solution_row(solution, seconds), "proven": proven}
        return {**row, "from": report.get("from")}

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
            solution = Solution.read(file, problem)
            if self.entry.prune:
                solution = solution.pruned()
                row |= figures_of(solution)
            solution.write(self.solution(name))
        return rows

    def _training(self) -> Config:
        parts = {key: dict(self.entry.options[key]) for key in PARTS}
        parts["env"]["problem"] = [str(self.problem(name)) for name in self.problems]
        return build(Config, {"seed": self.seed, **parts})


_warm: set[str] = set()
"""The routers that this process has used already, and whether for large problems."""


def _texts(value: Any) -> Iterator[str]:
    """All texts in plain data but the keys."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _texts(one)
