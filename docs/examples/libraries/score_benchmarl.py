"""Train here, score there: BenchMARL's VDN or QMIX on a scenario of docs/cooperation.md.

::

    python score_benchmarl.py folder --steps 300000
    marouting benchmark --scenario gates-8x7-v0 \
        --router 'policies.integrations.benchmarl:Policy file=….pt teacher=false'
"""

import argparse
from pathlib import Path

from marouting import evaluate_policy
from policies.integrations.benchmarl import Policy
from policies.integrations.value_decomposition import train

SCENARIO = "gates-8x7-v0"

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=Path)
parser.add_argument("algorithm", nargs="?", choices=("vdn", "qmix"), default="vdn")
parser.add_argument("--steps", type=int, default=300_000)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()
row = train(given.algorithm, SCENARIO, given.steps, given.seed, given.folder)

policy = Policy(row["file"])
print(row["file"])
print(evaluate_policy(policy.moves, SCENARIO, local=3, **policy.options))
