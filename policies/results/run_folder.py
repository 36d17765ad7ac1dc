"""The run folder of a training on disk: the names of its files, and reading them.

=====================  ==========================================================================
config.yaml            the whole configuration, defaults included
problems/NAME.gr       the problems; where games draw theirs, those that networks are evaluated on
metrics.jsonl          a line of JSON for every episode
evaluations.jsonl      a line of JSON for every evaluation without exploration
tensorboard/           the same for TensorBoard
checkpoint.pt          everything needed to resume the training
policy.pt              only the networks, the best by evaluation, when the training is finished
solutions/NAME.*       the routes of the learner's best episode (``dqn``, say), of its saved policy
                       (``dqn_policy``) and of sequential A* (``astar``); where games draw their
                       problems, there is no best episode
result.json            a row for each problem and router (:mod:`policies.results.rows`)
figures/               pictures
=====================  ==========================================================================
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

from marouting import InputError
from marouting.config import between, build_json, check
from marouting.files import is_file, plain_name, read_text, stem_of, suffix_of
from policies.results.rows import (
    MOST_BYTES,
    Count,
    Measure,
    Name,
    ResultRow,
    Row,
    Seconds,
    read_rows,
)

CONFIG, METRICS, CHECKPOINT = "config.yaml", "metrics.jsonl", "checkpoint.pt"
EVALUATIONS = "evaluations.jsonl"
POLICY, RESULT = "policy.pt", "result.json"

NO_ROUTES = "run folders hold problems as ISPD text, which has no routes of nets that stay"


Line = TypeVar("Line")


def policy_file(path: Path) -> Path | None:
    """The file of a trained policy that a path leads to: itself, or the one in a run folder."""
    return next(filter(is_file, (path / POLICY, path / CHECKPOINT, path)), None)


def solution_file(folder: Path, problem: str, router: str) -> Path:
    """The file of a router's solution of a problem."""
    # A learner may be called module:Class, and not every file system takes a colon.
    return folder / "solutions" / f"{problem}.{router.replace(':', '-')}.solution"


def solution_name(file: Path, problem: str) -> str:
    """Whose solution of a problem a file holds: its name without the problem's and the suffix."""
    stem = stem_of(file) if suffix_of(file) == ".solution" else plain_name(file)
    own = stem.removeprefix(problem) if f"{stem}.".startswith(f"{problem}.") else stem
    return own.strip(".") or stem_of(file)


def solutions_by_name(files: Iterable[Path], problem: str) -> dict[str, Path]:
    """Files of solutions of a problem, by :func:`solution_name`; equal names get a number."""
    found: dict[str, Path] = {}
    for file in files:
        name = base = solution_name(file, problem)
        while name in found:
            name = f"{base} ({len(found) + 1})"
        found[name] = file
    return found


def read_result(folder: Path) -> list[Row]:
    """The rows of a finished training; raises InputError if there are none."""
    return read_rows(folder / RESULT, ResultRow)


@dataclass(frozen=True)
class Episode:
    """One finished episode of one problem, as ``metrics.jsonl`` holds it.

    Attributes:
        problem: the problem's name.
        episode: counted from 0; through all games where these draw their problems.
        reward: summed over all moves.
        joined: two-pin tasks joined.
        tasks: two-pin tasks in all.
        overflow: of the routes, joined or not.
        wirelength: of the routes, joined or not.
        steps: moves made.
        epsilon: chance of a random move.
        loss: mean loss of the gradient steps taken during the episode; None if it is no finite
            number any more.
        updates: gradient steps of the problem's network so far.
        best: whether no earlier episode was better; false where games draw their problems.
    """

    problem: Name
    episode: Count
    reward: Measure
    joined: Count
    tasks: Count
    overflow: Count
    wirelength: Count
    steps: Count
    epsilon: Annotated[float, between(0, 1)]
    loss: Measure | None
    updates: Count
    best: bool

    def __post_init__(self) -> None:
        check("joined", self.joined <= self.tasks, "at most the tasks")


@dataclass(frozen=True, kw_only=True)
class TrainingFigures:
    """What a policy's training took; None where that is not known.

    Attributes:
        agent_steps: moves of agents that it was trained for.
        processor_seconds: processor time.
        teacher: whether it learned from routes of something with sight of the whole problem.
    """

    agent_steps: Count | None = None
    processor_seconds: Seconds | None = None
    teacher: bool | None = None


@dataclass(frozen=True)
class GreedyEvaluation:
    """An episode that a network played without exploration, as ``evaluations.jsonl`` holds it.

    Attributes:
        problem: the problem's name.
        episodes: episodes of the problem that the network had been trained on; all of them where
            games draw their problems.
        agent_steps: moves that the network had been trained for.
        joined: two-pin tasks joined.
        tasks: two-pin tasks in all.
        overflow: of the routes, joined or not.
        wirelength: of the routes, joined or not.
        steps: moves made in this episode.
        best: whether no earlier network was better on all problems that it is for.
    """

    problem: Name
    episodes: Count
    agent_steps: Count
    joined: Count
    tasks: Count
    overflow: Count
    wirelength: Count
    steps: Count
    best: bool

    def __post_init__(self) -> None:
        check("joined", self.joined <= self.tasks, "at most the tasks")


def read_episodes(metrics: Path, size: int | None = None) -> list[Episode]:
    """The episodes in a ``metrics.jsonl``, or in its first bytes; raises InputError."""
    return _read_lines(metrics, Episode, size)


def read_evaluations(evaluations: Path) -> list[GreedyEvaluation]:
    """The evaluations in an ``evaluations.jsonl``; raises InputError naming the line."""
    return _read_lines(evaluations, GreedyEvaluation)


def _read_lines(path: Path, schema: type[Line], size: int | None = None) -> list[Line]:
    # Only line feeds end a line: JSON may hold other separators. All characters are ASCII.
    text = read_text(path, MOST_BYTES)
    if size is not None and len(text) < size:
        raise InputError(f"{path}: expected at least {size} bytes, as at the checkpoint")
    text = text[:size]
    lines = text.removesuffix("\n").split("\n") if text else []
    return [build_json(schema, line, f"{path}:{n}") for n, line in enumerate(lines, 1)]


def read_rewards(metrics: Path) -> dict[str, list[float]]:
    """The reward of every episode in a ``metrics.jsonl``, by problem; raises InputError.

    Where games drew their problems, the episodes of all of them are one curve, ``all``.
    """
    curves: dict[str, list[float]] = defaultdict(list)
    episodes = read_episodes(metrics)
    each = drawn = True  # whether the episodes of each problem are counted, or of all together
    for n, episode in enumerate(episodes):
        curve = curves[episode.problem]
        of_problem, of_all = episode.episode == len(curve), episode.episode == n
        if not ((each and of_problem) or (drawn and of_all)):
            expected = len(curve) if each else n
            raise InputError(
                f"{metrics}:{n + 1}: episode: expected {expected}, found {episode.episode}"
            )
        each, drawn = each and of_problem, drawn and of_all
        curve.append(episode.reward)
    if not curves:
        raise InputError(f"{metrics}: expected at least one episode")
    return curves if each else {"all": [episode.reward for episode in episodes]}
