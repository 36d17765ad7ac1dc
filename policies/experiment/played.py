"""Policies that play all problems of a scenario's split, each once, in the scenario's game.

They are the rows of the policies' table (docs/cooperation.md). What plays is a fixed rule
(:class:`policies.routers.local.LocalRouter`), a trained policy
(:class:`policies.learned.policy.TrainedPolicy`), or an object with

* ``moves(observations, masks)``: the actions (B,) of the agents that move next, by what they
  observe (B, *S) float32 and their masks (B, A) int8, as :func:`marouting.evaluate_policy` takes
  them;
* ``options``, if it was trained in an environment with others than the scenario suggests: these;
* ``parameters``, their number, and ``training``, a mapping with the fields of
  :class:`policies.results.run_folder.TrainingFigures`, where these are known.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from marouting import Engine, scenarios
from marouting.config import allowing_code_of, build, check
from marouting.evaluation import check_rules, play_split, rules_of
from marouting.observations import local_radius_of, space_of
from marouting.options import PLAYED, game_options
from policies.results.rows import Count, Seconds
from policies.results.run_folder import TrainingFigures
from policies.routers.local import LocalRouter

FULL, WHOLE, PLANNER = "full sight", "whole board", "planner"
"""What may be seen beside a radius: by a rule that plans on the whole grid, in an observation that
is not local, and by a router of whole problems, which is no policy but a bound."""


@runtime_checkable
class MovesPolicy(Protocol):
    """Chooses the actions of all agents that move next, each by what it observes."""

    def moves(self, observations: NDArray[np.float32], masks: NDArray[np.int8]) -> Any:
        """(B,) actions for observations (B, *S) and masks (B, A)."""
        ...


@dataclass(frozen=True, kw_only=True)
class About:
    """What the policies' table says of a row beside its figures.

    Attributes:
        sight: what a net sees when it chooses: ``radius 3``, or one of :data:`FULL`, :data:`WHOLE`
            and :data:`PLANNER`. Radii are verified, see :mod:`marouting.batch.locality`.
        teacher: whether it learned from routes of something with sight of the whole problem.
        parameters: of what plays, 0 for a fixed rule.
        agent_steps: that it was trained for.
        training_seconds: processor time of the training.

    What is not known is None.
    """

    sight: str
    teacher: bool | None = None
    parameters: Count | None = None
    agent_steps: Count | None = None
    training_seconds: Seconds | None = None


UNLEARNED = {"teacher": False, "parameters": 0, "agent_steps": 0, "training_seconds": 0.0}
"""What there is to say of a rule or a router that does not learn."""


def play(
    policy: LocalRouter | MovesPolicy, scenario: str, split: scenarios.Split
) -> tuple[Engine, About]:
    """Plays all problems of a split; returns the games at their end, and what is known.

    Raises:
        InputError: the policy plays another game than the scenario's, or its observation shows more
            than it says.
    """
    if isinstance(policy, LocalRouter):
        problems = list(scenarios.get(scenario).problems(split).values())
        engine = policy.play(problems, rules_of(scenario))
        # The other rules look at the edges of a net's own Gcell.
        radius = policy.radius if policy.rule == "shortest" else 0
        sight = FULL if radius is None else f"radius {radius}"
        return engine, build(About, {"sight": sight, **UNLEARNED})
    check("moves", callable(policy.moves), "a method")
    options: Mapping[str, Any] = getattr(policy, "options", None) or {}
    check("options", isinstance(options, Mapping), f"a mapping, found {options!r}")
    with allowing_code_of(options):
        own = {name: value for name, value in options.items() if name not in PLAYED}
        game = game_options({**own, "scenario": scenario, "split": split})
        check_rules(game, scenario)
        observation = game.observation.make()
        problems = list(scenarios.get(scenario).problems(split).values())
        shape = space_of(observation, problems, game.overflow == "allowed").shape
        known = getattr(policy, "obs_shape", shape)
        check("obs_shape", isinstance(known, list | tuple), f"a shape, found {known!r}")
        known = tuple(known)
        check("policy", known == shape, f"one for observations of shape {shape}, found {known}")
        radius = local_radius_of(observation)
        env = play_split(policy.moves, scenario, split, local=radius is not None, **own)
    sight = WHOLE if radius is None else f"radius {radius}"
    if game.message_bits:
        sight += f", {game.message_bits} bit{'s' * (game.message_bits > 1)}"
    training = build(TrainingFigures, getattr(policy, "training", None) or {}, "training")
    about = {
        "sight": sight,
        "teacher": training.teacher,
        "parameters": getattr(policy, "parameters", None),
        "agent_steps": training.agent_steps,
        "training_seconds": training.processor_seconds,
    }
    return env.engine, build(About, about)


def is_policy(cls: type[Any]) -> bool:
    """Whether objects of a class play all problems of a split at once."""
    return issubclass(cls, LocalRouter) or hasattr(cast(Any, cls), "moves")
