"""A part of an experiment's work, which one process can do, and the processes that do parts."""

import hashlib
import importlib.util
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

from marouting import InputError, Problem, Solution
from marouting.config import allowing_code_of, build, code_named
from marouting.files import exists, is_dir, is_file, naming, suffix_of, write_text
from marouting.registry import is_ours, lookup
from policies.engines import Call, EngineName, opened
from policies.experiment.config import (
    PARTS,
    PUBLISHED,
    SEED,
    SOLUTIONS,
    Entry,
    Published,
    ScenarioSet,
)
from policies.experiment.played import MovesPolicy, play
from policies.learned.burn_in import read_solutions
from policies.learned.config import Config, load_config
from policies.results import run_folder
from policies.results.rows import COLUMNS, Row, figures_of, solution_row
from policies.routers.base import Router, solve, warm_up
from policies.routers.local import LocalRouter
from policies.routers.registry import has_seed, is_learner, make_router


@dataclass(frozen=True)
class Part:
    """Some problems of a set, for one router with one seed.

    Attributes:
        folder: the experiment's folder.
        set: the set's name.
        entry: the router.
        seed: the seed; None for a router that draws no random numbers.
        problems: the names of the problems; the part's files are named after the first.
        scenario: the split of a scenario of policies that they are; None for other problems.
    """

    folder: Path
    set: str
    entry: Entry
    seed: int | None
    problems: tuple[str, ...]
    scenario: ScenarioSet | None = None

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
    def columns(self) -> dict[str, Any]:
        """What all rows say alike."""
        return {"set": self.set, "router": self.entry.name, "kind": self.entry.router}

    @property
    def finished(self) -> bool:
        """Whether its rows and solutions are on disk."""
        return exists(self.rows) and all(exists(self.solution(name)) for name in self.problems)

    @property
    def about_file(self) -> Path:
        """The file that says what is known of a policy that plays all problems at once."""
        return self.folder / "policies" / self.set / f"{self.label}.json"

    @property
    def options(self) -> dict[str, Any]:
        """The options of the router, with the seed in names of files."""
        seed = str(self.seed)
        return {
            name: value.replace(SEED, seed) if isinstance(value, str) else value
            for name, value in self.entry.options.items()
        }

    def digests(self) -> dict[str, str]:
        """SHA-256 of the files that its options name and of the user's own classes, by their names.

        Folders count only under the key ``folder``. A class stands for the file that it is in.
        """
        files = {name: Path(name) for name in _files_named(self.options)}
        kind, policy = self.entry.router, self.options.get("checkpoint")
        cls = lookup("learner" if is_learner(kind) else "router", kind)
        named = [f"{cls.__module__}:{cls.__qualname__}"]
        named += [name for _, name in code_named(dict(self.options))]
        if is_learner(kind) and policy is not None and is_file(policy):
            from policies.learned.checkpoint import read_checkpoint  # torch: only if needed

            state = read_checkpoint(policy, training=False)
            named += [name for _, name in code_named({k: state[k] for k in ("env", "learner")})]
        for name in named:
            source = None if is_ours(name) else _source_of(name.partition(":")[0])
            if source is not None:
                files[name] = source
        return {name: _digest(path) for name, path in sorted(files.items()) if exists(path)}

    @property
    def gpus(self) -> int:
        """The number of GPUs that it needs."""
        return int(self.entry.trains and self.entry.options["train"]["device"] != "cpu")

    def work(self) -> None:
        """Routes the problems, writes the solutions, and then the rows."""
        try:
            if self.entry.router == PUBLISHED:
                rows = self._published_rows()
            elif self.scenario is not None and self.entry.plays:
                rows = self._played_rows(self.scenario)
            elif self.entry.trains:
                rows = self._trained_rows()
            else:
                rows = [self._routed_row(name) for name in self.problems]
        except InputError as error:
            raise InputError(f"{self.set}, {self.label}: {error}") from None
        except Exception as error:  # of the user's code: a traceback shows where
            error.add_note(f"while {self.label} worked on {self.set}")
            raise
        full = [
            {**dict.fromkeys(COLUMNS), **row, **self.columns, "seed": self.seed} for row in rows
        ]
        write_text(self.rows, json.dumps(full, indent=1) + "\n")

    def check(self, problems: Mapping[str, Problem]) -> None:
        """Raises InputError for files that the router cannot use: now, not after hours.

        Args:
            problems: all problems of the set, by name.
        """
        if self.entry.router == PUBLISHED:
            self._published_rows()
        elif self.entry.router == SOLUTIONS:
            for name, problem in problems.items():
                self._external(name, problem)
        elif self.entry.trains_on is not None:
            _ = self._training()
        elif self.scenario is not None and self.entry.plays:
            _ = self._policy()
        elif self.entry.trains:
            from policies.learned.trainer import Trainer  # torch: only if something learned

            first = self.problems[0]
            trainer = Trainer({first: problems[first]}, self._training())
            learner, _ = trainer.learner, trainer.saved.start()
            if learner.learning_starts:
                _ = read_solutions(learner.burn_in, problems)
        elif "checkpoint" in self.entry.options and is_learner(self.entry.router):
            from policies.learned.policy import TrainedPolicy

            for name, problem in problems.items():
                TrainedPolicy.load(self.options["checkpoint"], name).check(problem)
        else:
            _ = self._router("")

    def _published_rows(self) -> list[Row]:
        """The rows of a published router; raises InputError if one is missing."""
        published = Published(**self.entry.options)
        found = published.read()
        sets = self.set, self.set.removesuffix(".validation")
        rows = []
        for name in self.problems:
            key = next(((own, name) for own in sets if (own, name) in found), None)
            if key is None:
                raise InputError(f"{published.file}: expected a row for {sets[-1]},{name}")
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
                if path.name.startswith(f"{name}.") and suffix_of(path) != ".gr" and path.is_file()
            )
        if len(files) != 1:
            raise InputError(
                f"{folder}: expected one solution {name}.*, found {', '.join(files) or 'none'}"
            )
        return Solution.read(folder / files[0], problem)

    def _routed_row(self, name: str) -> Row:
        problem = Problem.read(self.problem(name))
        report: Mapping[str, Any] = {}
        seconds: float | None = None
        if self.entry.router == SOLUTIONS:
            solution = self._pruned_if_set(self._external(name, problem))
        else:
            router = self._router(name)
            self._warm_up(router)
            started = time.perf_counter()
            solution, report = solve(router, problem)
            solution = self._pruned_if_set(solution)
            seconds = time.perf_counter() - started
        solution.write(self.solution(name))
        proven = report["status"] == "optimal" if "status" in report else None
        row = {"problem": name, **solution_row(solution, seconds), "proven": proven}
        return {**row, "from": report.get("from")}

    def _played_rows(self, scenario: ScenarioSet) -> list[Row]:
        """The rows of a policy that plays all problems at once; writes what is known of it."""
        if self.entry.trains:
            self._train()
        policy = self._policy()
        started = time.perf_counter()
        engine, about = play(policy, scenario.scenario, scenario.split)
        seconds = (time.perf_counter() - started) / len(self.problems)
        rows = []
        for m, name in enumerate(self.problems):
            solution = self._pruned_if_set(engine.solution(m))
            solution.write(self.solution(name))
            metrics = engine.metrics(m)
            played = {"joined": metrics.joined, "tasks": metrics.tasks}
            rows.append({"problem": name, **solution_row(solution, seconds), **played})
        write_text(self.about_file, json.dumps(asdict(about), indent=1) + "\n")
        return rows

    def _policy(self) -> LocalRouter | MovesPolicy:
        """What plays; raises InputError if its file cannot be used."""
        if not is_learner(self.entry.router):
            return cast(LocalRouter | MovesPolicy, self._router(""))
        from policies.learned.policy import TrainedPolicy  # torch: only if something learned

        trained = self.run / run_folder.POLICY
        return TrainedPolicy.load(trained if self.entry.trains else self.options["checkpoint"])

    def _pruned_if_set(self, solution: Solution) -> Solution:
        """A solution as it is judged."""
        return solution.pruned() if self.entry.prune else solution

    def _router(self, problem: str) -> Router:
        if "checkpoint" in self.entry.options and is_learner(self.entry.router):
            from policies.learned.router import LearnedRouter  # torch: only if something learned

            return LearnedRouter(checkpoint=self.options["checkpoint"], network=problem)
        seeded = self.seed is not None and has_seed(self.entry.router)
        seed = {"seed": self.seed} if seeded else {}
        return make_router(self.entry.router, {**self.options, **seed})

    def _warm_up(self, router: Router) -> None:
        """Does so once per process, so that no time includes compiling."""
        if self.entry.name not in _warm:
            warm_up(router)
            _warm.add(self.entry.name)

    def _train(self) -> None:
        """Trains in the run folder, or goes on there."""
        from policies.learned.router import LearnedRouter
        from policies.learned.run import Run

        kept = self.run / run_folder.CONFIG
        if not (self.run / run_folder.POLICY).exists():
            with allowing_code_of(self.entry):
                config = load_config(kept) if kept.exists() else self._training()
            # The folder may have been renamed since the training was started.
            config = replace(config, out=str(self.run))
            if not kept.exists() and self.entry.trains_on is None:
                self._warm_up(LearnedRouter(config))
            Run(config, resume=kept.exists()).execute()
        # The checkpoint of a finished training is large and of no use.
        (self.run / run_folder.CHECKPOINT).unlink(missing_ok=True)

    def _trained_rows(self) -> list[Row]:
        self._train()
        found = run_folder.read_result(self.run)
        rows = [row for row in found if row["router"] == self.entry.router]
        for row in rows:
            name = row["problem"]
            problem = Problem.read(self.problem(name))
            file = run_folder.solution_file(self.run, name, self.entry.router)
            solution = self._pruned_if_set(Solution.read(file, problem))
            row |= figures_of(solution)
            solution.write(self.solution(name))
        return rows

    def _training(self) -> Config:
        parts = {key: dict(self.entry.options[key]) for key in PARTS}
        if self.entry.trains_on is None:
            parts["env"]["problem"] = [str(self.problem(name)) for name in self.problems]
        else:
            parts["env"]["scenario"] = self.entry.trains_on
        return build(Config, {"seed": self.seed, **parts})


def _files_named(options: Mapping[str, Any]) -> Iterator[str]:
    """The values of options, also inside others, that are names of files."""
    for key, value in options.items():
        if isinstance(value, Mapping):
            yield from _files_named(value)
        elif isinstance(value, str) and (is_file(value) or (key == "folder" and is_dir(value))):
            yield value


def _source_of(module: str) -> Path | None:
    """The file of a module; None if there is none."""
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError):  # of scripts
        return None
    return Path(spec.origin) if spec is not None and spec.origin else None


def _digest(path: Path) -> str:
    """A digest of a file, or of all files in a folder with their names."""
    found = hashlib.sha256()
    with naming(path, "cannot be read"):
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                found.update(f"{file.relative_to(path)}\n".encode())
                with file.open("rb") as content:
                    found.update(hashlib.file_digest(content, "sha256").digest())
    return found.hexdigest()


_warm: set[str] = set()
"""The routers that this process has used already."""


def work_on(
    parts: Sequence[Part], jobs: int, threads: int, engine: EngineName = "local"
) -> Iterator[list[Part]]:
    """Works on parts, beginning in order; yields about every second those that were done since.

    All work ends at once when the iteration ends early, by an error or Ctrl-C, or when this process
    is killed.

    Raises:
        InputError: a process was killed.
        Exception: whatever a part raises.
    """
    with opened(engine, min(jobs, len(parts)), threads) as pool:
        for done in pool.run([Call(part.work, (), part.gpus) for part in parts]):
            yield [parts[number] for number in done]
