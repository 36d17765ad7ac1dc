"""Global routing, version 0: every net of a chip is an agent, and all share one grid of Gcells.

    from marouting import global_routing_v0

    env = global_routing_v0.env(problem={"nets": 10, "seed": 1}, render_mode="ansi")
    env.reset(seed=42)
    for agent in env.agent_iter():
        observation, reward, terminated, truncated, info = env.last()
        over = terminated or truncated
        env.step(None if over else env.action_space(agent).sample(info["action_mask"]))
    print(env.render())

``parallel_env`` is the same game with PettingZoo's Parallel interface, ``raw_env`` is ``env``
without the wrappers. docs/environment.md describes agents, actions, observations, rewards and all
options; :mod:`marouting.game` has the rules.
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
