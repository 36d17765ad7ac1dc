"""Multi-agent global routing: every net is an agent on one shared capacity grid.

>>> import marouting
>>> problem = marouting.generate(1, nets=10)[0]
>>> env = marouting.global_routing_v0.env(problem)
"""

from marouting import first  # isort: skip  # noqa: F401 (before all that takes time)

import gymnasium

from marouting import global_routing_v0, scenarios, vector
from marouting._version import __version__
from marouting.batch.engine import Engine
from marouting.batch.window import WindowObservation
from marouting.errors import InputError
from marouting.evaluation import PolicyResult, evaluate_policy
from marouting.generator import generate
from marouting.make import make
from marouting.observations import Observation, PaperObservation
from marouting.options import EnvOptions
from marouting.problem.controls import Area, Controls, ProblemFile, adjusted
from marouting.problem.field import Field
from marouting.problem.grid import Move
from marouting.problem.net import Adjustment, Net, Pin
from marouting.problem.problem import Problem
from marouting.problem.solution import Evaluation, Solution, evaluate
from marouting.registry import register
from marouting.rewards import PaperReward, Reward
from marouting.search.astar import sequential_astar

__all__ = [
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

ENVIRONMENT_ID = "marouting/GlobalRouting-v0"

gymnasium.register(
    ENVIRONMENT_ID,
    entry_point="marouting.env.single:GlobalRoutingSingle",
    vector_entry_point="marouting.gym_vector:GlobalRoutingVector",
)

try:  # PettingZoo has a registry from version 1.27 on
    from pettingzoo import register as _register
except ImportError:
    pass
else:
    _register("aec", ENVIRONMENT_ID, "marouting.global_routing_v0:env")
    _register("parallel", ENVIRONMENT_ID, "marouting.global_routing_v0:parallel_env")
