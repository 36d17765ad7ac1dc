"""Stable-Baselines3's PPO for all nets at once, through SuperSuit.

Every net is an agent, and all share one policy. Agents have to stay to the end for SuperSuit's
vectors: ``agents_persist``. Needs ``pip install stable-baselines3 supersuit``. The environment of
``sb3_masked.py`` steps twenty times as quickly.
"""

import supersuit
import torch
from curve import Curve
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

from marouting import global_routing_v0, scenarios

torch.set_num_threads(1)
curve = Curve(steps=200_000)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"reward": "normalised", "max_steps": 20, "agents_persist": True}
nets = supersuit.pettingzoo_env_to_vec_env_v1(global_routing_v0.parallel_env(problem, **options))
env = supersuit.concat_vec_envs_v1(nets, 8, num_cpus=0, base_class="stable_baselines3")
test = global_routing_v0.parallel_env(problem, **options)
set_random_seed(curve.seed)  # in place of seed=: SuperSuit's vector has no method of that name
model = PPO("MlpPolicy", env, n_steps=64, learning_rate=1e-3, gamma=0.95, device="cpu")


def joined():
    """The share of the nets that the policy joins without exploration."""
    observations, _ = test.reset()
    while test.agents:
        actions = {
            agent: int(model.predict(seen, deterministic=True)[0])
            for agent, seen in observations.items()
        }
        observations, *_ = test.step(actions)
    return test.metrics()["joined"] / test.metrics()["tasks"]


going = True
while going:
    model.learn(10_000, reset_num_timesteps=False)
    going = curve.row(model.num_timesteps, joined())
curve.end()
