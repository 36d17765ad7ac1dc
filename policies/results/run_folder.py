"""The run folder of a training on disk: the names of its files, and reading them.

=====================  ==========================================================================
config.yaml            the whole configuration, defaults included
problems/NAME.gr       the problems
metrics.jsonl          a line of JSON for every episode
tensorboard/           the same for TensorBoard
checkpoint.pt          everything needed to resume the training
policy.pt              only the networks, the best by evaluation, when the training is finished
solutions/NAME.*       the routes of the learner's best episode (``dqn``, say), of its saved policy
                       (``dqn_policy``) and of sequential A* (``astar``)
result.json            a row for each problem and router (:mod:`policies.results.rows`)
figures/               pictures
=====================  ==========================================================================
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

from marouting import InputError
from marouting.files import read_text
from policies.results.rows import MOST_BYTES, Row, read_rows

CONFIG, METRICS, CHECKPOINT = "config.yaml", "metrics.jsonl", "checkpoint.pt"
POLICY, RESULT = "policy.pt", "result.json"


def solution_file(folder: Path, problem: str, router: str) -> Path:
    """The file of a router's solution of a problem."""
    # A learner may be called module:Class, and not every file system takes a colon.
    return folder / "solutions" / f"{problem}.{router.replace(':', '-')}.solution"


def read_result(folder: Path) -> list[Row]:
    """The rows of a finished training; raises InputError if there are none."""
    return read_rows(folder / RESULT, {"router": str, "problem": str})


def read_rewards(metrics: Path) -> dict[str, list[float]]:
    """The reward of every episode in a ``metrics.jsonl``, by problem; raises InputError."""
    curves: dict[str, list[float]] = defaultdict(list)
    for number, line in enumerate(read_text(metrics, MOST_BYTES).splitlines(), 1):
        try:
            entry: Any = json.loads(line)
            curves[str(entry["problem"])].append(float(entry["reward"]))
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            raise InputError(
                f"{metrics}:{number}: expected an episode with problem and reward"
            ) from None
    if not curves:
        raise InputError(f"{metrics}: expected at least one episode")
    return curves
