"""Routers that learn."""

from marouting.registry import register

register("learner", "dqn", "policies.learned.algorithms.dqn:DQN")
