"""Independent PPO in AgileRL, with networks of its own for each net.

Needs ``pip install agilerl peft``: AgileRL 2.58.0 imports the second without asking for it.
"""

import numpy as np
import torch
from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from curve import Curve

from marouting import global_routing_v0, scenarios

torch.set_num_threads(1)
curve = Curve(steps=100_000)
torch.manual_seed(curve.seed)
np.random.seed(curve.seed)  # noqa: NPY002
problem = scenarios.get("toy-4x4-v0").test[0]
# AgileRL's IPPO takes masks for its moves but not for learning: they have a name unknown to it.
options = {"reward": "normalised", "max_steps": 20, "agents_persist": True}
options |= {"mask": {"mask_key": "edges"}}
env, test = (global_routing_v0.parallel_env(problem, **options) for _ in range(2))


class OwnNetworks(IPPO):
    """Nets that share a network would learn from each other's rewards in AgileRL 2.58.0."""

    def get_group_id(self, agent_id):
        """A group for each net."""
        return agent_id


agents = env.possible_agents
network = {"encoder_config": {"hidden_size": [128]}, "head_config": {"hidden_size": [128]}}
rollout = {"learn_step": 500, "batch_size": 500, "update_epochs": 8, "lr": 1e-3}
returns = {"gamma": 0.95, "gae_lambda": 0.9, "ent_coef": 0.03}
spaces = [env.observation_space(a) for a in agents], [env.action_space(a) for a in agents]
learner = OwnNetworks(*spaces, agent_ids=agents, net_config=network, **rollout, **returns)


def joined():
    """The share of the nets that the policy joins without exploration."""
    seen, _ = test.reset()
    while test.agents:
        moves = {}
        for agent, row in seen.items():
            with torch.no_grad():
                learner.actors[agent](torch.tensor(row)[None])
            moves[agent] = learner.actors[agent].head_net.dist.logits.argmax().item()
        seen, *_ = test.step(moves)
    return test.metrics()["joined"] / test.metrics()["tasks"]


known, steps, going = {"evo_steps": 500, "eval_steps": 1, "verbose": False}, 0, True
while going:
    steps += 500
    train_multi_agent_on_policy(env, "routing", "IPPO", [learner], max_steps=steps, **known)
    going = curve.row(steps * len(agents), joined())
curve.end()
