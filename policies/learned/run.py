"""A training in its run folder: logs, checkpoints, resuming, solutions, figures.

The run folder is described in :mod:`policies.results.run_folder`.
"""

import contextlib
import functools
import json
import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import torch

from marouting import InputError, PolicyResult, Problem, Solution
from marouting.config import allowing_code_of, check, plain
from marouting.files import FILE_NAME, exists, is_file_name, naming, write_text, writing
from marouting.generator import GeneratorOptions
from marouting.registry import allowing_code
from marouting.scenarios import get
from marouting.source import (
    MOST_PROBLEMS,
    ProblemSampler,
    ProblemStream,
    check_routed,
    fixed_problems,
    load_problems,
)
from marouting.yaml_files import check_same, read_yaml, yaml_text
from policies.interrupts import ENDING, holding
from policies.learned.checkpoint import read_checkpoint
from policies.learned.config import Config, load_config
from policies.learned.device_trainer import DeviceTrainer, on_device
from policies.learned.logs import Logs
from policies.learned.policy import TrainedPolicy
from policies.learned.trainer import Trainer
from policies.results.folder import check_own, working_in
from policies.results.rows import Row, read_reference, solution_row
from policies.results.run_folder import (
    CHECKPOINT,
    CONFIG,
    EVALUATIONS,
    METRICS,
    NO_ROUTES,
    POLICY,
    RESULT,
    Episode,
    TrainingFigures,
    read_episodes,
    read_result,
    solution_file,
)
from policies.routers.astar import AStarRouter
from policies.routers.base import warm_up

_FILES = (CONFIG, METRICS, EVALUATIONS, CHECKPOINT, POLICY, RESULT)


def write_config(config: Config, path: Path) -> None:
    """Writes a whole configuration as YAML."""
    write_text(path, yaml_text(plain(config)))


def _never_began(folder: Path) -> bool:
    """Whether a folder holds only what a run writes before its first episode."""
    config, metrics = folder / CONFIG, folder / METRICS
    if exists(folder / CHECKPOINT) or (exists(metrics) and metrics.stat().st_size > 0):
        return False
    try:
        text = config.read_text(encoding="utf-8")
        with allowing_code():  # nothing is made of what is read
            raw = read_yaml(config)
    except (InputError, OSError, UnicodeDecodeError):
        return False  # not written by a run
    # A run writes every key, and in this form.
    return set(raw) == {f.name for f in fields(Config)} and text == yaml_text(raw)


def _save(state: Mapping[str, Any], path: Path) -> None:
    with writing(path) as temporary:
        try:
            torch.save(dict(state), temporary)
        except RuntimeError as error:  # torch's word for a full disk
            reason = f"is the disk full? {error}"
            raise OSError(0, reason.splitlines()[0]) from None


def problems_of(
    config: Config, kept: Mapping[str, Problem] | None = None
) -> tuple[dict[str, Problem], ProblemStream | None]:
    """The problems of a training by name, and what its games draw theirs from.

    Args:
        config: what to do.
        kept: the problems that its run folder holds, where the training goes on.

    Returns:
        The problems that each have games of their own, and None; or those that the network is
        evaluated on, and what all games draw from. They are in an order that does not depend on
        where they come from.

    Raises:
        InputError: they cannot be read, or the training cannot use them.
    """
    train, env = config.train, config.env
    generated = isinstance(env.problem, GeneratorOptions) and env.problem.seed is None
    if train.games is None:
        found, episodes = fixed_problems(env) if kept is None else kept, None
    elif env.scenario is not None and env.split == "train":
        found = get(env.scenario).problems("validation")
        shown = len(found) if train.validation is None else train.validation
        what = f"at most {len(found)}, those of the split, found {shown}"
        check("train.validation", shown <= len(found), what)
        found = dict(list(found.items())[:shown])
        episodes = ProblemStream(None, env.scenario, most=train.problems)
    elif env.scenario is None and generated:
        shown = _GENERATED if train.validation is None else train.validation
        episodes = ProblemStream(env.problem, held_out=shown, most=train.problems)
        found = dict(map(episodes.problem, range(shown)))
    else:
        check("train.validation", train.validation is None, "null: a set is evaluated whole")
        check("train.problems", train.problems is None, "null: a set is played whole")
        found = fixed_problems(env) if kept is None else kept
        episodes = ProblemStream.of(dict(sorted(found.items())))
    problems = dict(sorted((found if kept is None else kept).items()))
    for name, problem in problems.items():
        check_routed(name, problem)
    return problems, episodes


def trainer_of(
    problems: Mapping[str, Problem], episodes: ProblemStream | None, config: Config
) -> Trainer | DeviceTrainer:
    """What trains: on the processor, or with all games on a CUDA device.

    Args:
        problems: as :func:`problems_of` gives them.
        episodes: likewise.
        config: what to do.
    """
    if episodes is None:
        return Trainer(problems, config)
    if on_device(config):
        return DeviceTrainer(problems, config, episodes)
    games = config.train.games or 1
    what = f"1 to {MOST_PROBLEMS} on the processor, found {games}"
    check("train.games", games <= MOST_PROBLEMS, what)
    draws = ProblemSampler(episodes, config.seed, games)
    return Trainer(problems, config, draws)


_GENERATED = 10
"""Problems that a network is evaluated on that learns from a generator without a seed."""


LENGTHS = ("episodes", "steps", "seconds")
"""Keys of ``train`` that end a training; a run that is resumed may be given larger numbers."""

_WITHOUT_EFFECT = "threads", "checkpoint_seconds", "tensorboard", "wandb", "reference", "figures"
"""Keys of ``train`` on which no weight depends."""

FALLING = ("epsilon_final", "anneal")
"""Options of learners that depend on how long the training is."""


def _affecting_weights(config: Config) -> dict[str, Any]:
    """What weights depend on, as plain data: all but the folder and how long the training is."""
    kept: dict[str, Any] = plain(config)
    for name in (*LENGTHS, *_WITHOUT_EFFECT):
        del kept["train"][name]
    del kept["out"]
    return kept


class Run:
    """A training in a run folder.

    Args:
        config: what to do; its ``out`` is the folder.
        resume: whether the folder holds a run to go on with; otherwise it must hold none. The run
            may be given more episodes, steps or seconds than it had.

    Attributes:
        folder: the run folder.
        problems: the problems by name; where games draw theirs, those to evaluate on.
        trainer: what trains.
        reference: overflow and wirelength of the best known solution by the problem's name, to
            which TensorBoard shows gaps.
        had: keys of ``train`` that are larger than before, with what they were: ``episodes``,
            ``steps`` or ``seconds``.

    Raises:
        InputError: the folder, the configuration or a problem cannot be used.
    """

    def __init__(self, config: Config, *, resume: bool = False) -> None:
        self.config = config
        self.reference: dict[str, tuple[int, int]] = {}
        if config.train.reference is not None:
            self.reference = read_reference(Path(config.train.reference))
        self.folder = Path(config.out)
        self.had: dict[str, Any] = {}  # keys of ``train`` that were smaller
        if resume:
            self._check_same()
        else:
            self._check_new()
        kept = load_problems(str(self.folder / "problems")) if resume else None
        self.problems, episodes = problems_of(config, kept)
        if config.train.reference is None and config.env.scenario is not None:
            scenario, split = get(config.env.scenario), config.env.split
            if scenario.has_references("validation" if split == "train" else split):
                self.reference = {
                    name: scenario.reference(problem)[:2] for name, problem in self.problems.items()
                }
        for name, problem in self.problems.items():
            fits = is_file_name(name, f".{config.learner.name}_policy.solution")
            check(f"problem {name[:80]!r}", fits, FILE_NAME)
            check("env.problem.keep", problem.kept is None, f"none: {NO_ROUTES}")
        self.trainer = trainer_of(self.problems, episodes, config)
        self._seconds = self._processor_seconds = 0.0
        self._began = time.process_time()
        self.trainer.clock = self._share_of_time
        self._logged = self._evaluated = 0
        if resume:
            self._load()
        else:
            # Errors now, not when there is a folder.
            _ = self.trainer.saved.start(), self.trainer.replayed
            with naming(self.folder, "cannot be written"):
                others = {path.stem for path in (self.folder / "problems").glob("*.gr")}
            others -= self.problems.keys()
            if others:
                raise InputError(
                    f"{self.folder / 'problems'}: expected only problems of this run, "
                    f"found {min(others)}.gr"
                )
            with working_in(self.folder):
                self._check_new()
                for name, problem in self.problems.items():
                    problem.write(self.folder / "problems" / f"{name}.gr")
                write_config(config, self.folder / CONFIG)

    def _check_new(self) -> None:
        """A new run starts in a folder of its own, or in place of one without any episode."""
        if not exists(self.folder / CONFIG):
            check_own(self.folder, ("problems", CONFIG))
            return
        if not _never_began(self.folder):
            raise InputError(
                f"{self.folder}: holds a run: expected another out=, or --resume {self.folder}"
            )

    def _check_same(self) -> None:
        """A resumed run has the configuration of its folder, or is longer."""
        with allowing_code_of(self.config):
            kept = load_config(self.folder / CONFIG)
        for name in LENGTHS:
            had, now = getattr(kept.train, name), getattr(self.config.train, name)
            if had is not None and now is not None and had != now:
                what = f"{had}, as in {self.folder / CONFIG}, or more, found {now}"
                check(f"train.{name}", now > had, what)
                self.had[name] = had
        train = replace(self.config.train, **self.had)
        mine = replace(self.config, out=kept.out, train=train)
        check_same(plain(mine), plain(kept), self.folder / CONFIG)

    def _load(self) -> None:
        path = self.folder / CHECKPOINT
        if not exists(path):
            return  # killed before the first checkpoint: it starts again
        with allowing_code_of(self.config):
            state = read_checkpoint(path, training=True)
        try:
            check_same(_affecting_weights(self.config), state["config"], path)
            self._seconds, self._logged = state["seconds"], state["logged"]
            self._evaluated = state["evaluated"]
            self._processor_seconds = state["figures"]["processor_seconds"]
            for name, time_ in (
                ("seconds", self._seconds),
                ("processor_seconds", self._processor_seconds),
            ):
                if not (type(time_) is float and 0 <= time_ < math.inf):
                    raise InputError(f"{path}: {name}: expected a number from 0")
            self._began = time.process_time() - self._processor_seconds
            self.trainer.spent = self.trainer.clock()  # schedules go on from there
            self.trainer.load_state(state, str(path))
            for name, size in (("logged", self._logged), ("evaluated", self._evaluated)):
                if not (type(size) is int and size >= 0):
                    raise InputError(f"{path}: {name}: expected a whole number from 0")
        except InputError:
            raise
        except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(f"{path}: expected a complete checkpoint: {error!r}") from None

    def _state(self) -> dict[str, Any]:
        return {
            **self.trainer.state(),
            "config": _affecting_weights(self.config),
            "figures": asdict(self.figures),
            "seconds": self._seconds,
            "logged": self._logged,
            "evaluated": self._evaluated,
        }

    @property
    def figures(self) -> TrainingFigures:
        """What the training took so far."""
        return TrainingFigures(
            agent_steps=int(self.trainer.steps.sum()),
            processor_seconds=self._processor_seconds,
            teacher=self._teacher,
        )

    @functools.cached_property
    def _teacher(self) -> bool | None:
        """Whether it learns from something with sight of the whole problem; None: not known."""
        learner, start = self.config.learner, self.config.train.start
        guide = getattr(learner.options, "burn_in", "random")
        if guide != "random" or learner.name == "imitation" or start == "generalist":
            return True
        if start is None:
            return False
        teacher = None  # what the weights to start from learned from
        with contextlib.suppress(InputError), allowing_code_of(self.config):
            teacher = TrainedPolicy.load(start, self.trainer.names[0]).training.get("teacher")
        return teacher

    @property
    def updates(self) -> int:
        """Updates so far of the network that has had most."""
        return int(self.trainer.updates.max())

    @property
    def parameters(self) -> int:
        """The number of the parameters of the network that plays."""
        return self.trainer.policy_of(self.trainer.names[0]).parameters

    def _share_of_time(self) -> float:
        """The share of ``train.seconds`` that has passed; 0 without such a bound."""
        seconds = self.config.train.seconds
        if seconds is None:
            return 0.0
        return (time.process_time() - self._began) / seconds

    @property
    def episodes(self) -> tuple[int, int]:
        """The episodes finished so far and the total, of all problems together."""
        total = self.config.train.episodes * len(self.trainer.episodes)
        return int(self.trainer.episodes.sum()), total

    def scenario_results(self) -> list[PolicyResult]:
        """What the saved network makes of a scenario's fixed problems, if it learned from others.

        That is without rip-up by prices (``train.negotiation``), which only routers have.

        Raises:
            InputError: the training has other rules than the scenario, see
                :func:`marouting.evaluate_policy`.
        """
        env, names = self.config.env, self.trainer.names
        if env.scenario is None or not env.endless or self.config.train.negotiation is not None:
            return []
        policy = self.trainer.policy_of(names[0])
        return [policy.evaluate(env.scenario, split) for split in ("validation", "test")]

    @property
    def progress(self) -> tuple[int, int, str]:
        """What has been done so far, and what there is to do, in episodes or steps of agents."""
        if (steps := self.config.train.steps) is None:
            return *self.episodes, "episodes"
        return min(int(self.trainer.steps.sum()), steps), steps, "steps"

    @property
    def length(self) -> str:
        """The key of ``train`` that ends the training."""
        if self.trainer.spent >= 1:
            return "seconds"
        return "episodes" if self.config.train.steps is None else "steps"

    @property
    def finished(self) -> list[Row] | None:
        """The rows of ``result.json`` if the run is finished, else None; raises InputError."""
        if self.trainer.running.any() or not exists(self.folder / RESULT):
            return None
        _ = self.best  # a folder whose files do not belong together is not taken for finished
        return read_result(self.folder)

    @property
    def best(self) -> list[Episode]:
        """The best episode so far of each problem that has one; raises InputError."""
        if not self._logged:
            return []
        logged = read_episodes(self.folder / METRICS, self._logged)
        episodes = {(episode.problem, episode.episode): episode for episode in logged}
        places = zip(self.trainer.names, self.trainer.best_episode.tolist(), strict=False)
        return [episodes[place] for place in places if place in episodes]

    def execute(self, watch: Callable[[Sequence[Episode]], Any] | None = None) -> list[Row]:
        """Trains to the end and writes everything.

        Args:
            watch: called after some steps with the episodes that have finished since, perhaps none.

        Returns:
            The rows of ``result.json``.
        """
        with working_in(self.folder):
            return self._execute(watch)

    def _execute(self, watch: Callable[[Sequence[Episode]], Any] | None) -> list[Row]:
        config, trainer = self.config, self.trainer
        if self.had:
            # It is no finished run any more, wherever it is stopped now.
            write_config(config, self.folder / CONFIG)
            (self.folder / RESULT).unlink(missing_ok=True)
        started = time.monotonic() - self._seconds
        self._began = time.process_time() - self._processor_seconds
        pause = config.train.checkpoint_seconds
        due = time.monotonic() + pause
        with (
            Logs(
                self.folder,
                (self._logged, self._evaluated),
                config.train.tensorboard,
                tuple(self.problems),
                self.reference,
                drawn=trainer.drawn,
                wandb=plain(config) if config.train.wandb else None,
            ) as logs,
            holding(*ENDING) as held,
        ):

            def keep() -> None:
                """Writes the checkpoint; then answers a signal that has been held back."""
                self._seconds = time.monotonic() - started
                self._processor_seconds = time.process_time() - self._began
                if not exists(self.folder / CONFIG):
                    raise InputError(f"{self.folder}: expected this run's folder, which is gone")
                self._logged, self._evaluated = logs.flush()
                _save(self._state(), self.folder / CHECKPOINT)
                held.leave()
                if held.numbers:
                    raise KeyboardInterrupt

            for episodes in trainer.run():
                held.begun = True
                if episodes or trainer.evaluations:
                    logs.write(episodes, trainer.evaluations)
                if watch is not None:
                    watch(episodes)
                if held.numbers or time.monotonic() >= due:
                    begun = time.monotonic()
                    keep()
                    # Of a large game it has gigabytes: writing takes a tenth of the time at most.
                    took = time.monotonic() - begun
                    due = time.monotonic() + (max(pause, 9 * took) if pause else 0)
            keep()  # nothing is trained again if the results below are interrupted
        rows = self._results()
        training = {"figures": asdict(self.figures)}
        _save({**self.trainer.saved.state(), **training}, self.folder / POLICY)
        if config.train.figures and self._logged:  # an episode has ended
            # matplotlib: only if it is wanted
            from policies.figures.plot import reward_figures, run_figures

            if not trainer.drawn:
                run_figures(self.folder, rows=rows)
            else:  # `marouting plot` draws the validation problems
                reward_figures(self.folder / METRICS, self.folder / "figures")
        # The mark of a finished run, so it comes last.
        write_text(self.folder / RESULT, json.dumps(rows, indent=1) + "\n")
        return rows

    def _results(self) -> list[Row]:
        """Writes the solutions; returns the rows of ``result.json``."""
        rows = []
        each = self._seconds / len(self.problems)
        learner = self.config.learner.name
        best = self.trainer.solutions()
        for name, problem in self.problems.items():
            warm_up(AStarRouter())
            start = time.perf_counter()
            astar = AStarRouter().route(problem)
            seconds = time.perf_counter() - start
            policy = self.trainer.policy_of(name)
            start = time.perf_counter()
            found = policy.solve(problem)
            # A network that was not trained on the problem costs no more than its moves.
            spent = each if best else time.perf_counter() - start
            routes: list[tuple[str, Solution, float, str | None]] = [
                ("astar", astar, seconds, None),
                (f"{learner}_policy", found.solution, spent, found.report["from"]),
            ]
            if name in best:
                routes.insert(1, (learner, best[name], each, self.trainer.origin(name)))
            for router, routed, spent, origin in routes:
                routed.write(solution_file(self.folder, name, router))
                row = {"problem": name, "router": router, **solution_row(routed, spent)}
                rows.append(row if origin is None else {**row, "from": origin})
        return rows


def clear(folder: Path) -> None:
    """Removes a run from its folder, and nothing else that lies there."""
    if not exists(folder / CONFIG):
        return
    for name in _FILES:
        (folder / name).unlink(missing_ok=True)
    for name in ("problems", "solutions", "tensorboard", "wandb", "figures"):
        shutil.rmtree(folder / name, ignore_errors=True)
