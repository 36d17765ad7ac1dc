"""sb3-contrib's MaskablePPO for all nets of many games, which are stepped in arrays.

Every net of every game is an environment, and all share one policy. Needs ``pip install
sb3-contrib``. MaskablePPO also takes ``gymnasium.make(marouting.ENVIRONMENT_ID, …)`` as it is.
"""

import numpy as np
import torch
from curve import Curve
from sb3_contrib import MaskablePPO
from stable_baselines3.common.vec_env import VecNormalize

from marouting import scenarios
from policies.integrations.sb3 import RoutingVecEnv

torch.set_num_threads(1)
curve = Curve(steps=500_000)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"reward": "normalised", "max_steps": 20}
env = VecNormalize(RoutingVecEnv([problem] * 32, **options), norm_reward=False)
test = RoutingVecEnv([problem], **options)
model = MaskablePPO(
    "MlpPolicy",
    env,
    n_steps=32,
    batch_size=512,
    n_epochs=4,
    learning_rate=1e-3,
    gamma=0.95,
    gae_lambda=0.9,
    ent_coef=0.01,
    policy_kwargs={"net_arch": [128, 128], "activation_fn": torch.nn.ReLU},
    stats_window_size=5 * env.num_envs,  # for success_rate; 100 is less than an episode of each
    device="cpu",
    seed=curve.seed,
)


def joined():
    """The share of the nets that the policy joins without exploration."""
    obs, ended, success = test.reset(), np.zeros(test.num_envs, bool), 0
    while not ended.all():
        obs = env.normalize_obs(obs)
        moves, _ = model.predict(obs, action_masks=test.action_masks(), deterministic=True)
        obs, _, dones, infos = test.step(moves)
        for row in np.flatnonzero(dones & ~ended):
            success += infos[row]["is_success"]
        ended |= dones
    return success / test.num_envs


def report(known, _):
    """Prints how it stands after every second rollout; the training ends when enough is joined."""
    steps = known["self"].num_timesteps
    return bool(steps % (2 * model.n_steps * env.num_envs)) or curve.row(steps, joined())


model.learn(curve.steps, callback=report)
curve.end()
