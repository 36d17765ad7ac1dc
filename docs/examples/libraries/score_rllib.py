"""Train here, score there: RLlib's PPO with masks on a scenario of docs/cooperation.md.

::

    python score_rllib.py folder --steps 300000
    marouting benchmark --scenario gates-8x7-v0 \
        --router 'policies.integrations.rllib:Policy folder=folder teacher=false'
"""

import argparse

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module import MultiRLModuleSpec, RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
from ray.tune.registry import register_env

from marouting import evaluate_policy, global_routing_v0
from policies.integrations.rllib import Policy, save

SCENARIO = "gates-8x7-v0"
MASK = {"visited": True, "in_observation": True, "observation_key": "observations"}
REWARD = {"kind": "team", "overflow": 1.0, "open": 1.0, "wirelength": 0.05}
OPTIONS = {"scenario": SCENARIO, "mask": MASK, "reward": REWARD, "agents_persist": True}

parser = argparse.ArgumentParser()
parser.add_argument("folder")
parser.add_argument("--steps", type=int, default=300_000)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()

make = global_routing_v0.parallel_env
register_env("routing", lambda _: ParallelPettingZooEnv(make(**OPTIONS)))
ray.init(num_cpus=1, include_dashboard=False)
network = {"fcnet_hiddens": [128, 128], "fcnet_activation": "relu", "vf_share_layers": False}
module = RLModuleSpec(ActionMaskingTorchRLModule, model_config=network)
algorithm = (
    PPOConfig()
    .environment("routing")
    .env_runners(num_env_runners=0, num_envs_per_env_runner=8)
    .multi_agent(policies={"nets"}, policy_mapping_fn=lambda *_, **__: "nets")
    .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs={"nets": module}))
    .training(train_batch_size=2_000, minibatch_size=500, num_epochs=4, lr=1e-3)
    .training(gamma=0.99, lambda_=0.95, entropy_coeff=0.01, use_kl_loss=False)
    .debugging(seed=given.seed, log_level="ERROR")
).build_algo()

steps = 0
while steps < given.steps:
    steps = algorithm.train()["env_runners"]["num_module_steps_sampled_lifetime"]["nets"]
save(algorithm, "nets", OPTIONS, given.folder)

policy = Policy(given.folder)
OPTIONS = {name: value for name, value in policy.options.items() if name != "mask"}
print(evaluate_policy(policy.moves, SCENARIO, local=3, **OPTIONS))
