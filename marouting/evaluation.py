"""Scores a policy on the fixed problems of a scenario, in one line.

>>> from marouting import evaluate_policy
>>> result = evaluate_policy(my_policy, "gates-8x7-v0", split="test")
>>> print(result)
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.locality import check_local
from marouting.config import check, plain
from marouting.errors import InputError
from marouting.options import ORDERS, game_options
from marouting.problem.net import is_whole
from marouting.problem.solution import evaluate
from marouting.rules import Rules
from marouting.scenarios import Reference, Scenario, Split, get, load
from marouting.scenarios.score import Figures, score
from marouting.search.astar import sequential_astar
from marouting.vector import BatchEnv, check_plain_arrays

_CHECKED = 8
"""Problems in which observations are checked to be local, which takes as long as to play them."""

Policy = Callable[[NDArray[np.float32], NDArray[np.int8]], Any]
"""(B, *S) float32 observations and (B, A) int8 masks of agents to (B,) actions."""


@dataclass(frozen=True)
class ProblemResult:
    """The result of a policy on one problem.

    Attributes:
        problem: the name of the problem.
        joined: two-pin tasks that it connected.
        tasks: two-pin tasks of the problem.
        open: nets that are not connected, each counted once; ``open`` in the environments' infos
            counts two-pin tasks instead, here ``tasks`` − ``joined``.
        overflow: in tracks.
        wirelength: in edges, a via counts 1.
        cost: the wirelength, and :attr:`marouting.scenarios.Scenario.open_cost` for every task that
            is not connected and every track of overflow.
        reference: overflow and wirelength of the best solution known.
        score: the score of the leaderboard, see :mod:`marouting.scenarios.score`.
        gap: wirelength above the reference, in %; None if it has open nets or more overflow.

    Reference, score and gap are None in a scenario without references.
    """

    problem: str
    joined: int
    tasks: int
    open: int
    overflow: int
    wirelength: int
    cost: float
    reference: tuple[int, int] | None
    score: float | None
    gap: float | None


@dataclass(frozen=True)
class PolicyResult:
    """The result of a policy on the problems of a split.

    Attributes:
        scenario: the name of the scenario.
        split: ``validation`` or ``test``.
        problems: the number of problems.
        cost: of all problems together, divided by that of the references: 1 is as good as they are.
        score: 1 for the reference. 0 for the best local rule where it is known
            (:meth:`marouting.scenarios.Scenario.score`). Otherwise 0 for A*; the score is then that
            of the leaderboard, the interquartile mean over the problems.
        solved: share of the problems in which everything is connected without overflow.
        connected: share of the two-pin tasks that are connected.
        overflow: of all problems together, in tracks.
        wirelength: of all problems together, in edges.
        gap: mean wirelength above the reference, in %, of the problems that are connected with its
            overflow; None if there is none.
        compared: the number of these problems.
        agent_steps: the moves that all agents made.
        rows: the results of the problems one by one.

    Cost, score and gap are None in a scenario without references.
    """

    scenario: str
    split: Split
    problems: int
    cost: float | None
    score: float | None
    solved: float
    connected: float
    overflow: int
    wirelength: int
    gap: float | None
    compared: int
    agent_steps: int
    rows: tuple[ProblemResult, ...]

    def as_dict(self, rows: bool = True) -> dict[str, Any]:
        """All figures as plain data, with those of each problem or without."""
        figures = asdict(self)
        if not rows:
            del figures["rows"]
        return figures

    def __str__(self) -> str:
        gap = "" if self.gap is None else f"; solved ones {self.gap:.2f} % above the reference"
        scored = "no score without references"
        if self.score is not None:
            scored = f"cost {self.cost:.4f}, score {self.score:.3f}"
        return (
            f"{self.scenario} {self.split}: {scored}, "
            f"{self.solved:.0%} of {self.problems} problems solved, {self.connected:.1%} of tasks "
            f"connected, overflow {self.overflow}, wirelength {self.wirelength}{gap}"
        )


def evaluate_policy(
    policy: Policy,
    scenario: str,
    split: Split = "test",
    *,
    local: bool | int = False,
    threads: int = 1,
    **options: Any,
) -> PolicyResult:
    """Plays every problem of a split once, all nets by one policy.

    Args:
        policy: called with the observations (B, *S) float32 and masks (B, A) int8 of all agents
            that are to move, of all problems together; returns their actions (B,). Actions are the
            moves of the grid, also where an observation is mirrored
            (:mod:`marouting.batch.window`).
        scenario: the name of a scenario.
        split: ``validation`` or ``test``.
        local: with True, observations that are not local are refused; with a number, also those
            that see further than this many Gcells (:mod:`marouting.batch.locality`).
        threads: among which the games are divided.
        **options: of the environment (:class:`marouting.options.GameOptions`), such as the
            observation that the policy is made for. The defaults are what the scenario suggests. In
            the scenarios of policies (docs/cooperation.md) the rules must be those that the
            scenario suggests; only ``wait`` and ``message_bits`` may differ.

    Returns:
        The figures of the leaderboard, for the split and for each problem.

    Raises:
        InputError: there is no such scenario or split, an option cannot be used, the game is not
            that of the scenario, or the observation is not local; or the policy returns something
            other than one action for each agent.
    """
    check_plain_arrays(options)
    env = play_split(policy, scenario, split, local=local, threads=threads, **options)
    return result_of(env.engine, scenario, split)


def play_split(
    policy: Policy,
    scenario: str,
    split: Split = "test",
    *,
    local: bool | int = False,
    threads: int = 1,
    **options: Any,
) -> BatchEnv:
    """The games of :func:`evaluate_policy`, at their end."""
    check("policy", callable(policy), f"a function of observations and masks, found {policy!r}")
    whole = is_whole(local) and local >= 0
    what = f"true, false or a number of Gcells from 0, found {local!r}"
    check("local", whole or isinstance(local, bool), what)
    given: dict[str, Any] = {**options, "scenario": scenario, "split": split}
    _ = load(scenario).problems(split)  # or an error
    game = game_options(given)
    given["mask"] = {"visited": game.mask.visited}  # the rest is of other interfaces
    _ = given.pop("render_mode", None)
    agents = given.pop("agents", "multi")
    if get(scenario).has_local_rule(split):
        check_rules(game, scenario)
    sequential = (game.turn_order or ORDERS[agents]) == "sequential"
    env = BatchEnv(everyone=not sequential, play_once=True, threads=threads, **given)
    if local is not False:
        some = env.engine.part(slice(_CHECKED))
        check_local(env.observation, some, None if local is True else local)
    play(policy, env)
    env.close()
    return env


_CHOICES = ("wait", "message_bits")
"""Rules in which a policy's game may differ from what the scenario suggests."""


def rules_of(scenario: str) -> Rules:
    """The rules of the game that a scenario suggests."""
    return game_options({"scenario": scenario, "split": "test"}).rules


def check_rules(game: Rules, scenario: str) -> None:
    """Raises InputError unless a game has the rules that a scenario suggests."""
    wanted, found = (_of_the_game(rules) for rules in (rules_of(scenario), game))
    for name, expected in wanted.items():
        what = f"{expected}, as {scenario} is played, found {found[name]}"
        check(name, found[name] == expected, what)


def _of_the_game(rules: Rules) -> dict[str, Any]:
    """Rules that a policy cannot choose, as plain data."""
    options = {field.name: plain(getattr(rules, field.name)) for field in fields(Rules)}
    options["mask"] = {"visited": rules.mask.visited}  # its other keys are of interfaces
    return {name: value for name, value in options.items() if name not in _CHOICES}


def result_of(engine: Engine, scenario: str, split: Split = "test") -> PolicyResult:
    """The result of the games of a split, which all have ended.

    Raises:
        InputError: there is no such scenario or split.
    """
    found = get(scenario)
    known = found.has_references(split)
    problems = found.problems(split).items()
    rows = [
        _row(engine, m, name, found, found.reference(problem) if known else None)
        for m, (name, problem) in enumerate(problems)
    ]
    gaps = [row.gap for row in rows if row.gap is not None]
    cost = total = None
    if known and (best := found.reference_cost(split)):
        cost = sum(row.cost for row in rows) / best
    if cost is not None and found.has_local_rule(split):
        total = found.score(cost, split)
    elif scores := np.sort([row.score for row in rows if row.score is not None]).tolist():
        cut = len(scores) // 4
        total = float(np.mean(scores[cut : len(scores) - cut]))
    return PolicyResult(
        scenario=scenario,
        split=split,
        problems=len(rows),
        cost=cost,
        score=total,
        solved=sum(not (row.open or row.overflow) for row in rows) / len(rows),
        connected=sum(row.joined for row in rows) / sum(row.tasks for row in rows),
        overflow=sum(row.overflow for row in rows),
        wirelength=sum(row.wirelength for row in rows),
        gap=sum(gaps) / len(gaps) if gaps else None,
        compared=len(gaps),
        agent_steps=int(engine.games["steps"].sum()),
        rows=tuple(rows),
    )


def play(policy: Policy, env: BatchEnv) -> Mapping[str, Any]:
    """Plays the games of an environment with ``play_once`` to their end; returns the last info."""
    obs, info = env.reset()
    while (active := info["active"]).any():
        chosen = policy(obs[active].copy(), info["action_mask"][active])
        try:
            moves = np.asarray(chosen)
        except ValueError:  # lists of different lengths
            moves = np.asarray(chosen, object)
        except RuntimeError as error:  # PyTorch's, of a tensor with a gradient
            raise InputError(f"policy: expected actions that NumPy can read: {error}") from None
        if moves.shape != (active.sum(),) or moves.dtype.kind not in "iu":
            expected = f"({active.sum()},) integers, one for each observation"
            raise InputError(f"policy: expected {expected}, found {moves.dtype} {moves.shape}")
        most = env.engine.actions - 1
        if moves.min() < 0 or moves.max() > most:
            found = f"{moves.min()} to {moves.max()}"
            raise InputError(f"policy: expected actions from 0 to {most}, found {found}")
        actions = np.full(active.shape, -1, np.int64)
        actions[active] = moves
        obs, *_, info = env.step(actions)
    return info


def _row(
    engine: Engine, m: int, name: str, scenario: Scenario, reference: Reference | None
) -> ProblemResult:
    """The result of problem m."""
    problem, metrics = engine.problems[m], engine.metrics(m)
    figures = Figures.of(evaluate(problem, engine.solution(m)))
    scored = gap = None
    if reference is not None:
        astar = Figures.of(evaluate(problem, sequential_astar(problem)))
        best = Figures(0, reference.overflow, reference.wirelength)
        scored = score(figures, astar, best)
        if figures[:2] == best[:2]:
            gap = 100 * (figures.wirelength / max(best.wirelength, 1) - 1)
    return ProblemResult(
        problem=name,
        joined=metrics.joined,
        tasks=metrics.tasks,
        open=figures.open,
        overflow=figures.overflow,
        wirelength=figures.wirelength,
        cost=scenario.cost(figures.wirelength, metrics.tasks - metrics.joined, figures.overflow),
        reference=None if reference is None else reference[:2],
        score=scored,
        gap=gap,
    )
