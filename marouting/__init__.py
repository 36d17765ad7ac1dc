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

if TYPE_CHECKING:  # all others, which are imported when they are first used
    from marouting import global_routing_v0 as global_routing_v0
    from marouting import scenarios as scenarios
    from marouting import vector as vector
    from marouting.batch.engine import Engine as Engine
    from marouting.batch.window import WindowObservation as WindowObservation
    from marouting.configured import make as make
    from marouting.errors import InputError as InputError
    from marouting.evaluation import PolicyResult as PolicyResult
    from marouting.evaluation import evaluate_policy as evaluate_policy
    from marouting.generator import generate as generate
    from marouting.observations import Observation as Observation
    from marouting.observations import PaperObservation as PaperObservation
    from marouting.options import EnvOptions as EnvOptions
    from marouting.problem.controls import Area as Area
    from marouting.problem.controls import Controls as Controls
    from marouting.problem.controls import ProblemFile as ProblemFile
    from marouting.problem.controls import adjusted as adjusted
    from marouting.problem.field import Field as Field
    from marouting.problem.grid import Move as Move
    from marouting.problem.net import Adjustment as Adjustment
    from marouting.problem.net import Net as Net
    from marouting.problem.net import Pin as Pin
    from marouting.problem.problem import Problem as Problem
    from marouting.problem.solution import Evaluation as Evaluation
    from marouting.problem.solution import Solution as Solution
    from marouting.problem.solution import evaluate as evaluate
    from marouting.rewards import PaperReward as PaperReward
    from marouting.rewards import Reward as Reward
    from marouting.search.astar import sequential_astar as sequential_astar

_NAMES = {
    "batch.engine": ["Engine"],
    "batch.window": ["WindowObservation"],
    "configured": ["make"],
    "errors": ["InputError"],
    "evaluation": ["PolicyResult", "evaluate_policy"],
    "generator": ["generate"],
    "observations": ["Observation", "PaperObservation"],
    "options": ["EnvOptions"],
    "problem.controls": ["Area", "Controls", "ProblemFile", "adjusted"],
    "problem.field": ["Field"],
    "problem.grid": ["Move"],
    "problem.net": ["Adjustment", "Net", "Pin"],
    "problem.problem": ["Problem"],
    "problem.solution": ["Evaluation", "Solution", "evaluate"],
    "rewards": ["PaperReward", "Reward"],
    "search.astar": ["sequential_astar"],
}
"""The modules and their names that are imported when they are first used."""

_HOMES = {name: home for home, names in _NAMES.items() for name in names}

__all__ = ["ENVIRONMENT_ID", "__version__", "global_routing_v0", "register", "scenarios", "vector"]
__all__ += _HOMES

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
