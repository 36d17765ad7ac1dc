"""Multi-agent global routing: every net is an agent on one shared capacity grid.

>>> import marouting
>>> problem = marouting.generate(1, nets=10)[0]
>>> env = marouting.global_routing_v0.env(problem)
"""

from marouting import first  # isort: skip

import importlib
from typing import TYPE_CHECKING, Any

from marouting._version import __version__
from marouting.registry import ENVIRONMENT_ID, register, register_environments

if TYPE_CHECKING:
    from marouting import global_routing_v0, scenarios, vector
    from marouting.batch.engine import Engine
    from marouting.batch.window import WindowObservation
    from marouting.configured import make
    from marouting.errors import InputError
    from marouting.evaluation import PolicyResult, evaluate_policy
    from marouting.generator import generate
    from marouting.observations import Observation, PaperObservation
    from marouting.options import EnvOptions
    from marouting.problem.controls import Area, Controls, ProblemFile, adjusted
    from marouting.problem.field import Field
    from marouting.problem.grid import Move
    from marouting.problem.net import Adjustment, Net, Pin
    from marouting.problem.problem import Problem
    from marouting.problem.solution import Evaluation, Solution, evaluate
    from marouting.rewards import PaperReward, Reward
    from marouting.search.astar import sequential_astar

__all__ = [
    "ENVIRONMENT_ID",
    "Adjustment",
    "Area",
    "Controls",
    "Engine",
    "EnvOptions",
    "Evaluation",
    "Field",
    "InputError",
    "Move",
    "Net",
    "Observation",
    "PaperObservation",
    "PaperReward",
    "Pin",
    "PolicyResult",
    "Problem",
    "ProblemFile",
    "Reward",
    "Solution",
    "WindowObservation",
    "__version__",
    "adjusted",
    "evaluate",
    "evaluate_policy",
    "generate",
    "global_routing_v0",
    "make",
    "register",
    "scenarios",
    "sequential_astar",
    "vector",
]

_HOMES = {
    "Adjustment": "problem.net",
    "Area": "problem.controls",
    "Controls": "problem.controls",
    "Engine": "batch.engine",
    "EnvOptions": "options",
    "Evaluation": "problem.solution",
    "Field": "problem.field",
    "InputError": "errors",
    "Move": "problem.grid",
    "Net": "problem.net",
    "Observation": "observations",
    "PaperObservation": "observations",
    "PaperReward": "rewards",
    "Pin": "problem.net",
    "PolicyResult": "evaluation",
    "Problem": "problem.problem",
    "ProblemFile": "problem.controls",
    "Reward": "rewards",
    "Solution": "problem.solution",
    "WindowObservation": "batch.window",
    "adjusted": "problem.controls",
    "evaluate": "problem.solution",
    "evaluate_policy": "evaluation",
    "generate": "generator",
    "make": "configured",
    "sequential_astar": "search.astar",
}
"""The modules of the names above, which are imported when a name is first used."""

if not first.IS_THE_COMMAND:  # which does so before it imports code of its user
    register_environments()

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """A name of this package, or a module of it."""
        try:
            found = importlib.import_module(f"marouting.{_HOMES.get(name, name)}")
        except ModuleNotFoundError as error:
            if error.name != f"marouting.{name}":
                raise
            raise AttributeError(f"module 'marouting' has no attribute {name!r}") from None
        value = globals()[name] = getattr(found, name) if name in _HOMES else found
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
