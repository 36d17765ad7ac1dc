"""BenchMARL on the environment as a task: ``pip install benchmarl``.

Run it with ``ippo`` (the default), ``mappo``, ``iql``, ``vdn`` or ``qmix`` behind its name.
"""

import tempfile

import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from curve import Curve
from torch import nn

from marouting import scenarios
from policies.integrations.benchmarl import RoutingTask

torch.set_num_threads(1)
curve = Curve("ippo", "mappo", "iql", "vdn", "qmix", steps=400_000)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"problem": problem, "reward": "normalised", "max_steps": 20, "max_cycles": 20}
task = RoutingTask.TOY_4X4.get_task(options)

config = ExperimentConfig.get_from_yaml()
config.max_n_frames = curve.steps // len(problem.nets)
config.gamma, config.lr = 0.95, 1e-3
config.on_policy_collected_frames_per_batch = config.off_policy_collected_frames_per_batch = 2_000
config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = 20
config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 8, 500
config.off_policy_n_optimizer_steps = 100
config.exploration_anneal_frames = 30_000
config.evaluation, config.evaluation_interval, config.evaluation_episodes = True, 6_000, 1
config.loggers, config.create_json, config.render = ["csv"], False, False
config.save_folder = tempfile.mkdtemp()


class Rows(Callback):
    """Prints what the policy joins without exploration."""

    def on_evaluation_end(self, rollouts):
        """The figure of the last step of the game."""
        steps = len(problem.nets) * self.experiment.total_frames
        if not curve.row(steps, rollouts[0]["next", "info", "joined"][-1].item()):
            curve.end()


network = {"num_cells": [128, 128], "layer_class": nn.Linear, "activation_class": nn.ReLU}
Experiment(
    task=task,
    algorithm_config=algorithm_config_registry[curve.algorithm].get_from_yaml(),
    model_config=MlpConfig(**network),
    critic_model_config=MlpConfig(**network),
    config=config,
    seed=curve.seed,
    callbacks=[Rows()],
).run()
curve.end()
