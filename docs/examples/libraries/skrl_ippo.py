"""Independent PPO in skrl, with networks of its own for each net: ``pip install skrl``."""

import torch
from curve import Curve
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.multi_agents.torch.ippo import IPPO
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from skrl.utils.model_instantiators.torch import categorical_model, deterministic_model

from marouting import global_routing_v0, scenarios

torch.set_num_threads(1)
curve = Curve(steps=200_000)
set_seed(curve.seed)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"reward": "normalised", "max_steps": 20, "agents_persist": True}
games = (global_routing_v0.parallel_env(problem, **options) for _ in range(2))
env, test = (wrap_env(game, "pettingzoo") for game in games)
agents = env.possible_agents
KINDS = "observation_space", "state_space", "action_space"
layers = [{"name": "net", "input": "OBSERVATIONS", "layers": [128, 128], "activations": "relu"}]


def networks(agent):
    """What moves a net, and what tells what is still to be paid."""
    known = {"network": layers, **{k: getattr(env, k)(agent) for k in KINDS}}
    value = deterministic_model(output="ONE", **known)
    return {"policy": categorical_model(output="ACTIONS", **known), "value": value}


spaces = {f"{kind}s": getattr(env, f"{kind}s") for kind in KINDS}
rollout = {"rollouts": 500, "learning_epochs": 8, "mini_batches": 4, "learning_rate": 1e-3}
returns = {"discount_factor": 0.95, "gae_lambda": 0.9, "entropy_loss_scale": 0.02}
parts = "learning_rate_scheduler", *(f"{x}_preprocessor" for x in ("observation", "state", "value"))
kwargs = {f"{part}_kwargs": {agent: {} for agent in agents} for part in parts}
kwargs["experiment"] = {"write_interval": 0, "checkpoint_interval": 0}
models = {agent: networks(agent) for agent in agents}
memories = {agent: RandomMemory(memory_size=500) for agent in agents}
rows = {"models": models, "memories": memories, "cfg": {**rollout, **returns, **kwargs}}
learner = IPPO(possible_agents=agents, **rows, **spaces)
trainer = SequentialTrainer(env=env, agents=learner, cfg={"timesteps": 500, "headless": True})


def joined():
    """The share of the nets that the policies join without exploration."""
    (seen, _), none = test.reset(), dict.fromkeys(agents)
    while test.agents:
        told = learner.act(seen, none, timestep=0, timesteps=0)[1]
        seen, *_ = test.step({a: told[a]["net_output"].argmax(-1, keepdim=True) for a in agents})
    return test.metrics()["joined"] / test.metrics()["tasks"]


steps, going = 0, True
while going:
    trainer.train()
    steps += 500 * len(agents)
    going = curve.row(steps, joined())
curve.end()
