"""Train here, score there: independent PPO in TorchRL on a scenario of docs/cooperation.md.

::

    python score_torchrl.py policy.pt --steps 300000
    marouting benchmark --scenario gates-8x7-v0 \
        --router 'policies.integrations.torchrl:Policy file=policy.pt teacher=false'
"""

import argparse

import torch
from tensordict.nn import TensorDictModule, set_composite_lp_aggregate
from torchrl.collectors import SyncDataCollector
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from marouting import evaluate_policy
from policies.integrations.torchrl import Policy, RoutingEnv, save

SCENARIO = "gates-8x7-v0"
REWARD = {"kind": "team", "overflow": 1.0, "open": 1.0, "wirelength": 0.05}
SEEN, MASK, LOGITS = ("nets", "observation"), ("nets", "action_mask"), ("nets", "logits")

parser = argparse.ArgumentParser()
parser.add_argument("file")
parser.add_argument("--steps", type=int, default=300_000)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()

torch.set_num_threads(1)
torch.manual_seed(given.seed)
set_composite_lp_aggregate(False).set()
env = RoutingEnv(64, scenario=SCENARIO, reward=REWARD, seed=given.seed)
(inputs,) = env.batch.single_observation_space.shape
agents, actions = env.batch.num_agents, int(env.batch.single_action_space.n)
network = {"num_cells": [128, 128], "activation_class": torch.nn.ReLU, "share_params": True}
network |= {"n_agents": agents, "n_agent_inputs": inputs, "centralized": False}
policy = ProbabilisticActor(
    TensorDictModule(MultiAgentMLP(n_agent_outputs=actions, **network), [SEEN], [LOGITS]),
    **{"in_keys": {"logits": LOGITS, "mask": MASK}, "out_keys": [("nets", "action")]},
    distribution_class=MaskedCategorical,
    **{"return_log_prob": True, "log_prob_key": ("nets", "log_prob")},
)
values = MultiAgentMLP(n_agent_outputs=1, **network)
critic = TensorDictModule(values, [SEEN], [("nets", "value")])
loss = ClipPPOLoss(policy, critic, entropy_coeff=0.01)
keys = {key: ("nets", key) for key in ("reward", "action", "value", "done", "terminated")}
loss.set_keys(sample_log_prob=("nets", "log_prob"), **keys)
loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
adam = torch.optim.Adam(loss.parameters(), lr=1e-3)

for data in SyncDataCollector(env, policy, frames_per_batch=2_048, total_frames=-1):
    shape = data["next", "nets", "reward"].shape  # the end of a game is that of all its nets
    for key in ("done", "terminated"):
        data["next", "nets", key] = data["next", key].unsqueeze(-2).expand(shape)
    loss.value_estimator(data, params=loss.critic_network_params)
    for _ in range(4):
        for part in data.reshape(-1)[torch.randperm(data.numel())].split(512):
            adam.zero_grad()
            sum(value for key, value in loss(part).items() if key.startswith("loss_")).backward()
            torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            adam.step()
    if env.taken.agent_steps >= given.steps:
        break
save(policy, env, given.file)

trained = Policy(given.file)
print(evaluate_policy(trained.moves, SCENARIO, local=3, **trained.options))
