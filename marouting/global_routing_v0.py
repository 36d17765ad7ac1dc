"""# Global Routing, version 0.

Every net of a chip is an agent that routes over one shared grid of Gcells. Routes take capacity
from the edges that they cross, so the nets have to share it.

| | |
|---|---|
| Import | `from marouting import global_routing_v0` |
| Agents | `net_0`, `net_1`, …: every net; those with all pins in one Gcell are in `idle_nets` |
| Actions | Discrete(6): EAST +x, WEST −x, NORTH +y, SOUTH −y, UP +z, DOWN −z |
| Observation | Box(12), float32: x, y, z; dx, dy, dz to the target; six remaining capacities |
| Action mask | `info["action_mask"]` and `action_mask(agent)`, int8 of length 6 |
| State | Box(X, Y, 5 Z), float32 |
| Reward | +100 for reaching the target pin, −1 for any other move |
| Parallel | yes, natively |

A net's pins are split into two-pin tasks, which its agent routes one after the other. A move across
an edge without enough remaining capacity, or off the grid, is blocked: the agent stays, and the
step counts. An edge that the net already uses is free to cross again. A task fails after
`max_steps` steps. An agent is terminated when all its tasks are joined, and truncated when its last
task has ended and some failed; its last info holds the `metrics`, and as `overflow`, `wirelength`,
`joined`, `tasks`, `open`, `steps` and `is_success` what loggers look for.
:mod:`marouting.game.rules` has all rules. With `agents_persist` agents that are done stay among the
agents, with rewards of 0 and a mask whose only move does nothing, and all agents end together.

With `rip_up_rounds` nets give their edges back after all have routed, and walk again with the
others in place (:mod:`marouting.game.rounds`). Agents stay then, as with `agents_persist`. With
`rip_up="agents"` there is a seventh action: to give way when asked.

The options of `env`, `raw_env` and `parallel_env` are the fields of
:class:`marouting.options.GameOptions`. The problem may be a `Problem`, a `.gr` file, or a mapping
of the generator's options (:class:`marouting.generator.GeneratorOptions`); or several of them, such
as a folder: then every episode plays one, drawn at random. With `scenario` and `split` it plays a
level of the benchmark (:mod:`marouting.scenarios`): a new training problem in every episode, or one
of the validation or test problems.

## Version history

* v0: first release.
"""

from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import AssertOutOfBoundsWrapper, OrderEnforcingWrapper

from marouting.env.aec import GlobalRoutingAEC as raw_env
from marouting.env.parallel import GlobalRoutingParallel as parallel_env
from marouting.source import Source

__all__ = ["env", "parallel_env", "raw_env"]


def env(problem: Source = None, **options: Any) -> AECEnv:
    """The AEC environment with the wrappers that check actions and the order of calls.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.options.GameOptions`.

    Raises:
        InputError: an option or the problem cannot be used.
    """
    return OrderEnforcingWrapper(AssertOutOfBoundsWrapper(raw_env(problem, **options)))
