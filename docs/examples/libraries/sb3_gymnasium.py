"""Stable-Baselines3's PPO and DQN, unchanged, on the Gymnasium environment.

One player moves all nets, one after the other. Needs ``pip install stable-baselines3``. Run it with
``ppo`` or ``dqn`` behind its name.
"""

import gymnasium
import torch
from curve import Curve
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

import marouting
from marouting import scenarios

torch.set_num_threads(1)
curve = Curve("ppo", "dqn", steps=400_000)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"problem": problem, "reward": "normalised", "max_steps": 20}
test = gymnasium.make(marouting.ENVIRONMENT_ID, **options)
env = make_vec_env(marouting.ENVIRONMENT_ID, 8, seed=curve.seed, env_kwargs=options)
network = {"net_arch": [128, 128], "activation_fn": torch.nn.ReLU}
common = {"learning_rate": 1e-3, "gamma": 0.95, "policy_kwargs": network, "device": "cpu"}
if curve.algorithm == "dqn":
    often = {"train_freq": 1, "gradient_steps": 2, "target_update_interval": 2_000}
    chance = {"learning_starts": 2_000, "exploration_fraction": 0.1}
    model = DQN("MlpPolicy", env, batch_size=128, seed=curve.seed, **often, **chance, **common)
else:
    env = VecNormalize(env, norm_reward=False)  # what agents see, to the order of 1
    rollout = {"n_steps": 128, "batch_size": 256, "n_epochs": 8, "ent_coef": 0.05}
    model = PPO("MlpPolicy", env, seed=curve.seed, gae_lambda=0.9, **rollout, **common)


def joined():
    """The share of the nets that the policy joins without exploration."""
    observation, info = test.reset()
    over, scale = False, model.get_vec_normalize_env()
    while not over:
        seen = observation if scale is None else scale.normalize_obs(observation)
        action, _ = model.predict(seen, deterministic=True)
        observation, _, terminated, truncated, info = test.step(int(action))
        over = terminated or truncated
    return info["joined"] / info["tasks"]


def report(known, _):
    """Prints how it stands after every 10 000 steps; the training ends when enough is joined."""
    steps = known["self"].num_timesteps
    return bool(steps % 10_000) or curve.row(steps, joined())


model.learn(curve.steps, callback=report)
curve.end()
