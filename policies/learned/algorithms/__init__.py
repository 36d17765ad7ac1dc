"""Algorithms: a file each. A new one is a file and a line here, or ``module:Class`` outside."""

from marouting.registry import register

# The first is the default. It is algorithms.dqn, in compiled code where that applies.
register("learner", "dqn", "policies.learned.algorithms.fused_dqn:FusedDQN")
register("learner", "ppo", "policies.learned.algorithms.ppo:PPO")
register("learner", "iql", "policies.learned.algorithms.fused_dqn:IQL")
register("learner", "ippo", "policies.learned.algorithms.ppo:IPPO")
register("learner", "mappo", "policies.learned.algorithms.ppo:MAPPO")
register("learner", "imitation", "policies.generalist.imitation:Imitation")
