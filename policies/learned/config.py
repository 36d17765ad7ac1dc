"""The schema of a training's configuration, and the one place of its defaults.

``configs/paper/default.yaml`` explains every key. The options of the learner are those of the class
that ``learner.kind`` names, see :mod:`policies.learned.algorithms`.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from marouting.batch.prices import Negotiation
from marouting.checks import check_fields
from marouting.config import MOST, Component, build, check, component_field, take_components
from marouting.options import EnvOptions, with_suggestions
from marouting.registry import allowing_code, lookup, names
from marouting.scenarios import get
from marouting.yaml_files import override, read_yaml


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """How a training runs.

    Attributes:
        episodes: episodes per problem; in one, all nets route all their two-pin tasks.
        steps: the training ends after this many moves of all agents together, if its games draw
            problems; ``episodes`` is then the most episodes. None: it ends after ``episodes``.
        seconds: processor time after which such a training ends, whatever is left of its steps.
            None: no bound. The same seed does then not give the same network.
        shared: whether one network learns all problems; otherwise each problem has its own. None:
            true if games draw problems.
        games: number of games played in parallel, each of which draws a problem for every episode:
            from a scenario's split ``train``, from a generator with ``seed: null``, or from a set.
            ``episodes`` and ``evaluate_every`` then count the episodes of all games together, and
            the network is evaluated on the scenario's split ``validation``, on problems of the
            generator that are never drawn, or on the set. None: 32 if the problems are endless (a
            scenario's split ``train``, ``seed: null``); otherwise every problem has its own games.
        problems: number of training problems of the scenario, or of the generator, that games draw
            from. They are kept in memory: to make a problem can take longer than to play it. None:
            every episode has a new one.
        validation: number of problems that the network is evaluated on, the first ones of the
            validation split or new ones of the generator; None: all of the split, 10 of the
            generator.
        best: how the best episode is chosen, whose routes are the solution (of equal ones the
            first): ``routes``, by tasks joined, then overflow, then wirelength; or ``reward``, by
            tasks joined, then reward (the authors' code).
        evaluate_every: episodes per problem between two evaluations of the network: it plays one
            episode without exploration.
        start: initial weights of the same shape: a ``policy.pt`` or checkpoint (if it holds several
            networks, the one of the problem's name), or ``generalist``, the weights of the package;
            None: random weights.
        negotiation: prices in the games, for the generalist
            (:class:`marouting.batch.prices.Negotiation`); None: none.
        policy: which network is saved: ``best``, that of the best evaluation, or ``last``, for a
            learner whose learning rate falls to the end.
        device: ``cpu`` or ``cuda``. With ``cuda`` the networks are on the device; for ppo, ippo and
            mappo with ``games``, so are all games (:mod:`policies.learned.device_trainer`).
        threads: threads that share the networks of a training.
        checkpoint_seconds: seconds between checkpoints, and at least nine times as many as writing
            one takes; 0: as often as possible.
        tensorboard: whether to write TensorBoard's event files beside ``metrics.jsonl``.
        wandb: whether to log the same in Weights & Biases, as a run of the project ``marouting``
            named after the run folder. ``WANDB_MODE=offline`` needs no account.
        reference: the ``results.json`` of an experiment whose proven optima TensorBoard measures
            gaps to, by the problems' names; None for no gaps.
        figures: whether to draw the figures at the end.
    """

    episodes: int = 1000
    steps: int | None = None
    seconds: float | None = None
    shared: bool | None = None
    games: int | None = None
    problems: int | None = None
    validation: int | None = None
    best: Literal["routes", "reward"] = "routes"
    evaluate_every: int = 10
    start: str | None = None
    negotiation: Negotiation | None = None
    policy: Literal["best", "last"] = "best"
    device: str = "cpu"
    threads: int = 1
    checkpoint_seconds: float = 60.0
    tensorboard: bool = True
    wandb: bool = False
    reference: str | None = None
    figures: bool = True

    def __post_init__(self) -> None:
        counts = dict.fromkeys(("episodes", "evaluate_every", "steps"), (1, MOST))
        counts |= {"games": (1, 10**6), "problems": (1, 10**5), "validation": (1, 10**4)}
        check_fields(self, threads=(1, 1024), checkpoint_seconds=(0, math.inf), **counts)
        check("seconds", self.seconds is None or self.seconds > 0, "a number above 0")
        for name in ("steps", "seconds", "problems", "validation"):
            fits = self.games is not None or getattr(self, name) is None
            check(name, fits, "null without train.games")
        routes = self.games is None or self.best == "routes"
        check("best", routes, "routes with train.games: no routes of episodes are kept")
        check(
            "shared", self.games is None or self.shared, "true: games draw problems for one network"
        )
        check("wandb", self.tensorboard or not self.wandb, "false without train.tensorboard")


@dataclass(frozen=True, kw_only=True)
class Config:
    """A training: the game, the learner, the run.

    Attributes:
        seed: where all random numbers of the training start.
        out: the run folder; it must not hold another run.
        env: the game, and ``agents: single | multi``.
        learner: what learns: the name of a registered learner or ``module:Class`` under ``kind``,
            and its options beside it.
        train: the run.
    """

    seed: int = 0
    out: str = "runs/training"
    env: EnvOptions = field(default_factory=EnvOptions)
    learner: Component = component_field("learner")
    train: TrainOptions = field(default_factory=TrainOptions)

    def __post_init__(self) -> None:
        take_components(self)
        check("seed", 0 <= self.seed < 2**63, f"0 to {2**63 - 1}, found {self.seed}")
        wanted, found = getattr(self.learner.cls, "agents", None), self.env.agents
        what = f"{wanted} for {self.learner.name}, found {found}"
        check("env.agents", wanted in (None, found), what)
        looks = getattr(self.learner.options, "masking", True) or not self.env.mask.visited
        check("env.mask.visited", looks, "false with learner.masking=false: it ignores masks")
        drawn = self.train.games is not None
        what = "true: endless problems need a shared network"
        check("train.shared", self.train.shared or not self.env.endless, what)
        check("train.games", drawn or not self.env.endless, "a number: these problems are endless")


def load_config(
    path: str | os.PathLike[str] | None,
    overrides: Sequence[str] = (),
    learner: str | None = None,
    *,
    allow_code: bool = False,
) -> Config:
    """Reads a configuration and changes single keys of it.

    Args:
        path: a YAML file; None for the defaults.
        overrides: ``key=value`` with dots between the parts of a key, the value as in YAML.
        learner: the kind of learner that it must be for; None for any.
        allow_code: whether the file may name components as ``module:Class``, which is code that is
            imported. Overrides always may.

    Raises:
        InputError: names the file or key, what was expected and what was found.
    """
    where = "" if path is None else os.fspath(path)
    with allowing_code(allow_code):
        raw = override({} if path is None else read_yaml(path), overrides)
    return config_of(raw if learner is None else for_learner(raw, learner, where), where)


def config_of(raw: Mapping[str, Any], where: str = "") -> Config:
    """The configuration in plain data.

    Some defaults depend on other keys: ``env.agents`` on the learner; the game on what its scenario
    suggests (:attr:`marouting.scenarios.Scenario.env`); what agents see, how a training runs, and
    options of learners (:attr:`.Learner.endless`) on whether its problems never end; how long it
    runs on the scenario as well (:attr:`marouting.scenarios.Scenario.training`).

    Args:
        raw: the configuration.
        where: what an error message starts with.

    Raises:
        InputError: names the key, what was expected and what was found.
    """
    env, train, learner = raw.get("env", {}), raw.get("train", {}), raw.get("learner", {})
    learner = {"kind": learner} if isinstance(learner, str) else learner
    if not all(isinstance(part, Mapping) for part in (env, train, learner)):
        return build(Config, raw, where)  # which refuses it
    kind = learner.get("kind", names("learner")[0])
    known = isinstance(kind, str) and (kind in names("learner") or ":" in kind)
    cls = lookup("learner", kind, "learner.kind") if known else None
    agents = getattr(cls, "agents", None)
    env = with_suggestions(env if agents is None else {"agents": agents, **env})
    if _endless(env):
        env = {"observation": "window", **env}
        learner = {"kind": kind, **getattr(cls, "endless", {}), **learner}
    if train.get("games") is not None or _endless(env):
        scenario = env.get("scenario")
        suggested = {} if scenario is None else get(scenario).training
        _ = build(TrainOptions, {**DRAWN, **suggested}, f"{scenario}: training")
        filled = {f.name for f in fields(TrainOptions) if f.default is None}
        given = {
            key: value for key, value in train.items() if value is not None or key not in filled
        }
        train = {**DRAWN, **suggested, **given}
        if train.get("steps") is not None and "episodes" not in given:
            train["episodes"] = MOST
    return build(Config, {**raw, "env": env, "learner": learner, "train": train}, where)


DRAWN = {"shared": True, "games": 32, "episodes": 10_000, "evaluate_every": 100}
"""How a training runs whose games draw problems, unless it is told otherwise."""


def _endless(env: Mapping[str, Any]) -> bool:
    """Whether every episode plays a new problem; see :attr:`.GameOptions.endless`."""
    problem = env.get("problem")
    if env.get("scenario") is not None:
        return env.get("split", "train") == "train"
    return isinstance(problem, Mapping) and problem.get("seed", 0) is None


def for_learner(raw: Mapping[str, Any], kind: str, where: str = "") -> dict[str, Any]:
    """A configuration in plain data with ``learner.kind`` filled in.

    Args:
        raw: the configuration.
        kind: the learner's name, or ``module:Class``.
        where: what an error message starts with.

    Raises:
        InputError: the configuration is for another kind of learner.
    """
    learner = raw.get("learner")
    learner = {"kind": learner} if isinstance(learner, str) else learner or {}
    if not isinstance(learner, Mapping):
        return dict(raw)  # refused when the configuration is built
    prefix = f"{where}: " if where else ""
    found = learner.get("kind", kind)
    check(f"{prefix}learner.kind", found == kind, f"{kind}, found {found}")
    return {**raw, "learner": {**learner, "kind": kind}}
