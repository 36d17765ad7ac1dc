"""PPO with masks in TorchRL: ``pip install torchrl``; ``mappo``: the critic sees all nets."""

import torch
from curve import Curve
from tensordict.nn import TensorDictModule, set_composite_lp_aggregate
from torchrl.collectors import SyncDataCollector
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from marouting import scenarios
from policies.integrations.torchrl import RoutingEnv

torch.set_num_threads(1)
curve = Curve("ippo", "mappo", steps=200_000)
torch.manual_seed(curve.seed)
set_composite_lp_aggregate(False).set()
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"reward": "normalised", "max_steps": 20}
env, test = RoutingEnv([problem] * 20, **options), RoutingEnv([problem], **options)
SEEN, MASK, LOGITS = ("nets", "observation"), ("nets", "action_mask"), ("nets", "logits")
network = {"num_cells": [128, 128], "activation_class": torch.nn.ReLU, "share_params": True}
network |= {"n_agents": len(problem.nets), "n_agent_inputs": 12}
logits = MultiAgentMLP(n_agent_outputs=6, centralized=False, **network)
policy = ProbabilisticActor(
    TensorDictModule(logits, [SEEN], [LOGITS]),
    **{"in_keys": {"logits": LOGITS, "mask": MASK}, "out_keys": [("nets", "action")]},
    distribution_class=MaskedCategorical,
    **{"return_log_prob": True, "log_prob_key": ("nets", "log_prob")},
)
values = MultiAgentMLP(n_agent_outputs=1, centralized=curve.algorithm == "mappo", **network)
critic = TensorDictModule(values, [SEEN], [("nets", "value")])
loss = ClipPPOLoss(policy, critic, entropy_coeff=0.01)
keys = {key: ("nets", key) for key in ("reward", "action", "value", "done", "terminated")}
loss.set_keys(sample_log_prob=("nets", "log_prob"), **keys)
loss.make_value_estimator(ValueEstimators.GAE, gamma=0.95, lmbda=0.9)
optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
collector = SyncDataCollector(
    env, policy, frames_per_batch=2_000, total_frames=curve.steps // len(problem.nets)
)

for i, data in enumerate(collector):
    shape = data["next", "nets", "reward"].shape  # the end of a game is that of all its nets
    for key in ("done", "terminated"):
        data["next", "nets", key] = data["next", key].unsqueeze(-2).expand(shape)
    loss.value_estimator(data, params=loss.critic_network_params)
    for _ in range(8):
        for part in data.reshape(-1)[torch.randperm(data.numel())].split(500):
            optimiser.zero_grad()
            sum(value for key, value in loss(part).items() if key.startswith("loss_")).backward()
            torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimiser.step()
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        share = test.rollout(20, policy)["next", "info", "joined"][0, -1].item()
    steps = 2_000 * len(problem.nets) * (i + 1)
    if not curve.row(steps, share):
        break
curve.end()
