"""Tianshou's DQN with masks, one player for all nets: ``pip install tianshou``."""

import gymnasium
import numpy as np
import torch
from curve import Curve
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Batch, Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

import marouting
from marouting import scenarios

torch.set_num_threads(1)
curve = Curve(steps=100_000)
torch.manual_seed(curve.seed)
np.random.seed(curve.seed)  # noqa: NPY002
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"problem": problem, "reward": "normalised", "max_steps": 20}
names = {"mask": {"in_observation": True, "observation_key": "obs", "mask_key": "mask"}}
make = [lambda: gymnasium.make(marouting.ENVIRONMENT_ID, **options, **names)] * 8
test, envs = make[0](), DummyVectorEnv(make)
network = Net(state_shape=12, action_shape=6, hidden_sizes=[128, 128])
policy = DiscreteQLearningPolicy(model=network, action_space=test.action_space)
optimiser = AdamOptimizerFactory(lr=1e-3)
learner = DQN(policy=policy, optim=optimiser, gamma=0.95, target_update_freq=500)


def joined():
    """The share of the nets that the policy joins without exploration."""
    (seen, info), over = test.reset(), False
    while not over:
        rows = Batch({key: value[None] for key, value in seen.items()})
        seen, _, terminated, truncated, info = test.step(policy(Batch(obs=rows, info={})).act[0])
        over = terminated or truncated
    return info["joined"] / info["tasks"]


def report(_, step):
    """Prints how it stands after every 2000 steps; the training ends when enough is joined."""
    policy.set_eps_training(max(0.05, 1 - step / 10_000))
    if step and step % 2_000 == 0 and not curve.row(step, joined()):
        curve.end()


collector = Collector(learner, envs, VectorReplayBuffer(50_000, 8), exploration_noise=True)
run = {"max_epochs": 1, "epoch_num_steps": curve.steps, "collection_step_num_env_steps": 80}
often = {"update_step_num_gradient_steps_per_sample": 0.25, "batch_size": 128}
shown = {"training_fn": report, "show_progress": False}
learner.run_training(OffPolicyTrainerParams(training_collector=collector, **run, **often, **shown))
curve.end()
