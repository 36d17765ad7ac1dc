"""Train here, score there: sb3-contrib's MaskablePPO on a scenario of docs/cooperation.md.

::

    python score_sb3.py model.zip --steps 300000
    marouting benchmark --scenario gates-8x7-v0 \
        --router 'policies.integrations.sb3:Policy file=model.zip teacher=false'
"""

import argparse

import torch
from sb3_contrib import MaskablePPO

from marouting import evaluate_policy
from policies.integrations.sb3 import Policy, RoutingVecEnv, save

SCENARIO = "gates-8x7-v0"
# Not the team's: here a net's episode ends when it is done, and what others do then is not paid.
REWARD = {"kind": "difference", "overflow": 1.0, "open": 1.0, "wirelength": 0.05}

parser = argparse.ArgumentParser()
parser.add_argument("file")
parser.add_argument("--steps", type=int, default=300_000)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()

torch.set_num_threads(1)
env = RoutingVecEnv(64, scenario=SCENARIO, reward=REWARD, seed=given.seed)
model = MaskablePPO(
    "MlpPolicy",
    env,
    n_steps=32,
    batch_size=1024,
    n_epochs=4,
    learning_rate=1e-3,
    ent_coef=0.01,
    policy_kwargs={"net_arch": [128, 128]},
    device="cpu",
    seed=given.seed,
)
save(model.learn(given.steps), given.file)

policy = Policy(given.file)
print(evaluate_policy(policy.moves, SCENARIO, local=3, **policy.options))
