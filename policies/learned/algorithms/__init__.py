"""Algorithms: a file each. A new one is a file and a line here, or ``module:Class`` outside."""

from marouting.registry import register

register("learner", "dqn", "policies.learned.algorithms.dqn:DQN")
register("learner", "ppo", "policies.learned.algorithms.ppo:PPO")
