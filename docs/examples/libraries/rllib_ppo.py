"""RLlib's PPO on its new stack, one policy for all nets: ``pip install "ray[rllib]"``.

Run it with ``masked`` behind its name for RLlib's action-masking module.
"""

import numpy as np
import ray
import torch
import tree
from curve import Curve
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module import MultiRLModuleSpec, RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
from ray.tune.registry import register_env

from marouting import global_routing_v0, scenarios

torch.set_num_threads(1)
curve = Curve("plain", "masked", steps=100_000)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"reward": "normalised", "max_steps": 20}
if masked := curve.algorithm == "masked":  # the module looks for these names
    options |= {"mask": {"in_observation": True, "observation_key": "observations"}}
make = global_routing_v0.parallel_env
register_env("routing", lambda _: ParallelPettingZooEnv(make(problem, **options)))
ray.init(num_cpus=1, include_dashboard=False)
network = {"fcnet_hiddens": [128, 128], "fcnet_activation": "relu", "vf_share_layers": False}
module = RLModuleSpec(ActionMaskingTorchRLModule if masked else None, model_config=network)
algorithm = (
    PPOConfig()
    .environment("routing")
    .env_runners(num_env_runners=0, num_envs_per_env_runner=8)
    .multi_agent(policies={"nets"}, policy_mapping_fn=lambda *_, **__: "nets")
    .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs={"nets": module}))
    .training(train_batch_size=1_000, minibatch_size=500, num_epochs=8, lr=1e-3)
    .training(gamma=0.95, lambda_=0.9, entropy_coeff=0.03, use_kl_loss=False)
    .debugging(seed=curve.seed, log_level="ERROR")
).build_algo()
test = make(problem, agents_persist=True, **options)


def joined():
    """The share of the nets that the policy joins without exploration."""
    policy, (seen, _) = algorithm.get_module("nets"), test.reset()
    while test.agents:
        rows = tree.map_structure(lambda *row: torch.tensor(np.stack(row)), *seen.values())
        with torch.no_grad():
            moves = policy.forward_inference({"obs": rows})["action_dist_inputs"].argmax(-1)
        seen, *_ = test.step(dict(zip(test.agents, moves.tolist(), strict=True)))
    return test.metrics()["joined"] / test.metrics()["tasks"]


going = True
while going:
    steps = algorithm.train()["env_runners"]["num_module_steps_sampled_lifetime"]["nets"]
    going = curve.row(steps, joined())
curve.end()
