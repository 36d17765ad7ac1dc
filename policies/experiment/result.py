"""The result file of a benchmark: one router on the problems of one scenario.

A file holds all that a row of the leaderboard is made of, so anyone adds a row by adding a file.
``docs/scenarios.md`` explains the protocol. Figures that are not known are None: results published
without routes do not say which nets are open, and then have no score.
"""

import json
import re
import statistics
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from marouting.config import Meets, between, build_json, check
from marouting.files import read_text, write_text
from marouting.scenarios.score import Figures, score
from policies.experiment.config import Split
from policies.experiment.played import About
from policies.results.rows import LARGEST, Count, Line, Measure, Name, Row, Seconds
from policies.results.statistics import bootstrap_interval, gap, interquartile_mean

MOST_BYTES = 2**26
"""The largest result file that is read."""

CLOSE = 1e-6
"""How far a score in a file may be from what its figures give."""

Score = Annotated[float, between(-3, 4)]
"""A score."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A problem, with the solutions that have the scores 0 and 1.

    Attributes:
        problem: its name in the scenario.
        astar: open nets, overflow and wirelength of sequential A* as in the paper: score 0.
        reference: those of the proven optimum or the best solution known: score 1. None: the
            scenario has no references.
        proven: whether the reference is proven to be optimal.
        tasks: two-pin tasks of the problem, in scenarios of policies.
    """

    problem: Name
    astar: tuple[Count, Count, Count]
    reference: tuple[Count, Count, Count] | None
    proven: bool
    tasks: Count | None = None

    def __post_init__(self) -> None:
        fits = self.reference is None or self.reference <= self.astar
        check("reference", fits, "one at least as good as A*")

    def score(self, found: Figures) -> float | None:
        """The score of a solution of the problem; None without a reference."""
        if self.reference is None:
            return None
        return score(found, Figures(*self.astar), Figures(*self.reference))


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A problem routed with a seed.

    Attributes:
        problem: its name.
        seed: None for a router that draws no random numbers.
        open: nets that are not joined, not their two-pin tasks; None if not known.
        overflow: in tracks.
        wirelength: in edges.
        vias: None if not known.
        seconds: wall time, with the training if there was one for this problem; None if not known.
        score: see :mod:`marouting.scenarios.score`; None where ``open`` or the reference is, and in
            scenarios of policies, whose problems have one score together.
        open_tasks: two-pin tasks that are not joined, in scenarios of policies; None if not known.
    """

    problem: Name
    seed: Count | None
    open: Count | None
    overflow: Count
    wirelength: Count
    vias: Count | None = None
    seconds: Seconds | None = None
    score: Score | None
    open_tasks: Count | None = None

    @staticmethod
    def of(row: Row, task: Task) -> "Outcome":
        """The outcome that a row of an experiment holds."""
        columns = ("problem", "seed", "overflow", "wirelength", "vias", "seconds")
        figures = {column: row[column] for column in columns}
        opened = row.get("open_nets")
        found = None if opened is None else Figures(opened, row["overflow"], row["wirelength"])
        if task.tasks is not None:
            tasks = None if row["joined"] is None else row["tasks"] - row["joined"]
            return Outcome(**figures, open=opened, score=None, open_tasks=tasks)
        score = None if found is None else task.score(found)
        return Outcome(**figures, open=opened, score=None if score is None else round(score, 9))

    @property
    def figures(self) -> Figures | None:
        """What solutions compare by; None if not all of it is known."""
        return None if self.open is None else Figures(self.open, self.overflow, self.wirelength)


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How a split of a scenario of policies is scored; see :class:`marouting.scenarios.Scenario`.

    Attributes:
        local_rule: cost of the best local rule, which has the score 0.
        open_cost: what an open task costs, in edges of wire.
    """

    local_rule: Annotated[float, between(1, 1000)]
    open_cost: Annotated[float, between(0, LARGEST)]

    def __post_init__(self) -> None:
        check("local_rule", self.local_rule > 1, "a cost above 1")

    def score(self, cost: float) -> float:
        """The score of a cost: 1 for the optimum."""
        return (self.local_rule - cost) / (self.local_rule - 1)


@dataclass(frozen=True, kw_only=True)
class Result:
    """One router on the problems of one scenario.

    Attributes:
        format: says which format the file has; the number goes up when the keys change.
        scenario: the scenario's name.
        split: ``test`` or ``validation``.
        name: what tables call the router.
        router: the router or learner, ``module:Class``, or ``solutions`` or ``published`` for what
            was routed elsewhere.
        options: its options, as plain data.
        budget: per problem, in words; None if there was none.
        version: of marouting, which judged the solutions.
        machine: in words.
        command: that makes the file again.
        date: when the file was written, as YYYY-MM-DD.
        scale: how the split is scored, in scenarios of policies; None: by problem, from A*.
        policy: what there is to say of what plays there.
        seconds: all that it takes to make the rows again on one core, training included; None if
            not known.
        training_seconds: the part of it that is training, or what training the checkpoint took; 0
            for what does not learn, None if not known. In scenarios of policies it is processor
            time, the mean over the seeds.
        tasks: the problems.
        outcomes: one for each problem and seed.
        curve: of a learner trained on the problems: episodes per problem, and the interquartile
            mean of the scores of the best routes so far. Of a policy trained for a scenario:
            agent-steps, and the mean over the seeds of the scores on the validation problems.
    """

    format: Literal["marouting-benchmark-1"] = "marouting-benchmark-1"
    scenario: Name
    split: Split = "test"
    name: Name
    router: Name
    options: dict[str, Any]
    budget: Line | None = None
    version: Line
    machine: Line
    command: Line
    date: Annotated[str, Meets(re.compile("[0-9]{4}-[0-9]{2}-[0-9]{2}").fullmatch, "YYYY-MM-DD")]
    scale: Scale | None = None
    policy: About | None = None
    seconds: Seconds | None
    training_seconds: Seconds | None
    tasks: tuple[Task, ...]
    outcomes: tuple[Outcome, ...]
    curve: tuple[tuple[Count, Measure], ...] = ()

    def __post_init__(self) -> None:
        check("tasks", len(self.tasks) > 0, "at least one")
        check("tasks", len(self.by_name) == len(self.tasks), "every problem once")
        seeds: Counter[str] = Counter()
        seen = set()
        for number, row in enumerate(self.outcomes, 1):
            where = f"outcomes: row {number}"
            check(f"{where}: problem", row.problem in self.by_name, "one of the tasks")
            check(where, (row.problem, row.seed) not in seen, "every problem once for each seed")
            seen.add((row.problem, row.seed))
            seeds[row.problem] += 1
            fits = row.vias is None or row.vias <= row.wirelength
            check(f"{where}: vias", fits, "at most the wirelength")
            known = row.figures
            right = None if known is None else self.by_name[row.problem].score(known)
            if self.scale is not None:
                check(f"{where}: score", row.score is None, "null: all problems have one score")
                most = self.by_name[row.problem].tasks
                fits = row.open_tasks is None or most is None or row.open_tasks <= most
                check(f"{where}: open_tasks", fits, "at most the tasks")
            elif right is None:
                what = "null, as the open nets or the reference are unknown"
                check(f"{where}: score", row.score is None, what)
            else:
                fits = row.score is not None and abs(row.score - right) <= CLOSE
                check(f"{where}: score", fits, f"{right:.6f}, found {row.score}")
        if self.scale is not None:
            known_tasks = all(task.tasks is not None for task in self.tasks)
            check("tasks", known_tasks, "the number of two-pin tasks of each")
            known_best = all(task.reference is not None for task in self.tasks)
            check("tasks", known_best, "the reference of each")
        alike = len({row.seed is None for row in self.outcomes}) <= 1
        check("outcomes", alike, "a seed in all of them or in none")
        check("policy", (self.policy is None) == (self.scale is None), "one with a scale")
        whole = len(seeds) == len(self.tasks) and len(set(seeds.values())) == 1
        check("outcomes", whole, "every problem with the same number of seeds")

    @cached_property
    def by_name(self) -> Mapping[str, Task]:
        """The tasks by the problem's name."""
        return {task.problem: task for task in self.tasks}

    @property
    def references(self) -> dict[str, tuple[int, int, int]]:
        """The references that there are, by the problem's name."""
        return {task.problem: task.reference for task in self.tasks if task.reference is not None}

    @property
    def file_name(self) -> str:
        """What the file is called."""
        split = "" if self.split == "test" else f".{self.split}"
        return f"{self.scenario}{split}.{self.name}.json"

    def write(self, folder: Path) -> Path:
        """Writes the file into a folder, whole or not at all; returns its path."""
        path = folder / self.file_name
        plain = _without_nulls(asdict(self), ("scale", "policy"))
        lists = {key: plain.pop(key) for key in ("tasks", "outcomes", "curve")}
        for key in ("tasks", "outcomes"):
            lists[key] = [_without_nulls(row, ("tasks", "open_tasks")) for row in lists[key]]
        text = json.dumps(plain, indent=1, ensure_ascii=False).removesuffix("\n}")
        for key, rows in lists.items():  # a line each, so that files can be compared
            lines = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in rows)
            text += f',\n "{key}": [\n  {lines}\n ]' if rows else f',\n "{key}": []'
        write_text(path, f"{text}\n}}\n")
        return path


def _without_nulls(row: Mapping[str, Any], keys: Collection[str]) -> dict[str, Any]:
    """Without these keys where they are None: they are for scenarios of policies."""
    return {key: value for key, value in row.items() if key not in keys or value is not None}


def read_result(path: Path) -> Result:
    """Reads a result file; raises InputError naming the file, the key and what was expected."""
    return build_json(Result, read_text(path, MOST_BYTES), str(path))


def summarise(result: Result) -> dict[str, Any]:
    """The figures of a result, None where something is not known.

    Those of scenarios of policies are :func:`policy_figures` in place of the ones from ``score`` to
    ``losses``.

    Returns:
        ``name``, ``scenario``, ``split``, ``router``, ``budget``, the numbers of ``problems`` and
        ``seeds``;
        ``score``: ``mean`` (interquartile), ``low`` and ``high``;
        ``open``: problems with open nets, and ``overflow``: the total in tracks, averaged over the
        seeds;
        ``gap``: mean wirelength above the reference's in %, of the solutions with as few open nets
        and as little overflow, and ``gap_problems``, how many problems have one, averaged over the
        seeds;
        ``at_reference``: percent of the solutions that are as good as the reference, and
        ``proven``: percent of the problems whose reference is proven;
        ``wins``, ``ties`` and ``losses`` against A*, averaged over the seeds;
        ``solution_seconds``: the median time per problem and seed, ``seconds`` and
        ``training_seconds``: see :class:`Result`.
    """
    rows, tasks = result.outcomes, result.by_name
    seeds = len(rows) // len(tasks)
    times = [row.seconds for row in rows if row.seconds is not None]
    summary = {
        "name": result.name,
        "scenario": result.scenario,
        "split": result.split,
        "router": result.router,
        "budget": result.budget,
        "problems": len(tasks),
        "seeds": seeds,
        "overflow": _whole(sum(row.overflow for row in rows) / seeds),
        "proven": 100 * sum(task.proven for task in result.tasks) / len(tasks),
        "solution_seconds": statistics.median(times) if len(times) == len(rows) else None,
        "seconds": result.seconds,
        "training_seconds": result.training_seconds,
    }
    if result.scale is not None:
        return {**summary, **policy_figures(result)}
    scored = ("score", "gap", "gap_problems", "at_reference")
    found = [(tasks[row.problem], row.figures) for row in rows if row.figures is not None]
    if len(found) < len(rows):
        return {**summary, **dict.fromkeys((*scored, "open", "wins", "ties", "losses"))}
    compared = {
        "open": _whole(sum(figures.open > 0 for _, figures in found) / seeds),
        "wins": _whole(sum(figures < task.astar for task, figures in found) / seeds),
        "ties": _whole(sum(figures == task.astar for task, figures in found) / seeds),
        "losses": _whole(sum(figures > task.astar for task, figures in found) / seeds),
    }
    best = result.references
    if len(best) < len(tasks):
        return {**summary, **dict.fromkeys(scored), **compared}
    own: dict[str, list[float]] = {task.problem: [] for task in result.tasks}
    for row in rows:
        own[row.problem].append(row.score or 0.0)
    scores = np.array(list(own.values()), np.float64)
    low, high = bootstrap_interval(scores)
    gaps = [gap(figures, best[task.problem]) for task, figures in found]
    known = [above for above in gaps if above is not None]
    return {
        **summary,
        "score": {"mean": interquartile_mean(scores.ravel()), "low": low, "high": high},
        "gap": statistics.fmean(known) if known else None,
        "gap_problems": _whole(round(len(known) / seeds, 1)),
        "at_reference": 100 * sum(f <= best[task.problem] for task, f in found) / len(rows),
        **compared,
    }


def policy_figures(result: Result) -> dict[str, Any]:
    """What the table of policies shows; figures of seeds are averaged.

    Returns:
        ``score``: ``mean`` (interquartile over the seeds), ``low`` and ``high`` (95 % bootstrap);
        ``costs``: of each seed, as :func:`marouting.evaluate_policy` gives it, and ``cost``, their
        interquartile mean; ``solved``, ``connected``: shares of the problems without open tasks and
        overflow, and of the tasks; ``gap``: mean wirelength above the reference in % of the solved
        problems; and ``sight``, ``teacher``, ``parameters`` and ``agent_steps`` of
        :class:`.played.About`. None for what is not known.
    """
    scale, about = result.scale, result.policy
    assert scale is not None and about is not None  # noqa: PT018
    by_seed: dict[int | None, list[Outcome]] = {}
    for row in result.outcomes:
        by_seed.setdefault(row.seed, []).append(row)
    figures = asdict(about)
    del figures["training_seconds"]  # the result's own
    if any(row.open_tasks is None for row in result.outcomes):
        unknown = ("score", "costs", "cost", "solved", "connected", "gap")
        return {**dict.fromkeys(unknown), **figures}
    references = result.references
    best = sum(length + scale.open_cost * over for _, over, length in references.values())
    tasks = sum(task.tasks or 0 for task in result.tasks)
    costs, solved, connected, gaps = [], [], [], []
    for rows in by_seed.values():
        lost = sum((row.open_tasks or 0) + row.overflow for row in rows)
        costs.append((sum(row.wirelength for row in rows) + scale.open_cost * lost) / best)
        done = [row for row in rows if not (row.open_tasks or row.overflow)]
        solved.append(len(done) / len(rows))
        connected.append(1 - sum(row.open_tasks or 0 for row in rows) / tasks)
        for row in rows:
            _, overflow, least = references[row.problem]
            if not row.open_tasks and row.overflow == overflow:
                gaps.append(100 * (row.wirelength / max(least, 1) - 1))
    scores = [scale.score(cost) for cost in costs]
    # As of one problem: the cost is that of all problems together.
    low, high = bootstrap_interval(np.array([scores]))
    return {
        "score": {"mean": interquartile_mean(np.array(scores)), "low": low, "high": high},
        "costs": costs,
        "cost": interquartile_mean(np.array(costs)),
        "solved": statistics.fmean(solved),
        "connected": statistics.fmean(connected),
        "gap": statistics.fmean(gaps) if gaps else None,
        **figures,
    }


def _whole(value: float) -> float:
    """An int if it is whole."""
    return int(value) if value == int(value) else value
