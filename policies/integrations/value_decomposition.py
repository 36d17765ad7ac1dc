"""VDN and QMIX of BenchMARL on a cooperative scenario, as rows of docs/cooperation.md.

::

    python -m policies.integrations.value_decomposition qmix --scenario gates-8x7-v0 \
        --steps 1000000 --seed 0 --out runs/qmix-0

All nets of a round move at once, see what the scenario suggests, and get one reward: the reduction
of the team's cost, with :data:`REWARD` as its scale. Nets that are done have a single move, which
does nothing. ``--steps`` are agent-steps, the moves that nets make. What is printed has the keys of
``marouting train --json``; ``file`` is BenchMARL's checkpoint. One row of several seeds is made by
``marouting benchmark`` with ``--seeds 5`` and, as the router,
``policies.integrations.benchmarl:Policy file=runs/qmix-{seed}/checkpoints/checkpoint_last.pt``.

What is set here, of BenchMARL 1.5's options (``benchmarl/conf``); :class:`Options` has those that
``--set`` can change:

==============================  ==========  ========================================================
``lr``                          5e-4        5e-5, the default, is for ten times as many frames
``gamma``                       0.99        as our PPO has
``polyak_tau``                  0.01        not 0.005: the targets follow twice as fast
moves between updates           3200        of 64 games
optimiser steps, of moves       40, of 640  a move is learned from eight times
memory                          125 000     moves of agents, 0.6 GB
ε                               1 to 0.05   over the first third of the agent-steps
networks                        2 × 128     as our learners have
==============================  ==========  ========================================================

BenchMARL counts all this in frames, moves of all agents of a game; :func:`train` divides by the
mean number of nets. No value was chosen by results. All else is as BenchMARL has it. An
evaluation on the validation problems after every twentieth of the steps gives the learning curve;
the last network is kept.

Every ten minutes the whole training is written to a file beside ``--out``, ``qmix-0.state.pt``
beside ``qmix-0``. With the moves that are learned from it has 0.6 to 1 GB. The same command goes on
from there, to the same result, and removes the file at the end. Loading the file runs the code that
it holds.
"""

import contextlib
import json
import logging
import pickle
import pkgutil
import shutil
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torch import nn

from marouting import evaluate_policy, scenarios
from marouting.config import build, build_json, check
from marouting.files import read_text, write_text, writing
from marouting.yaml_files import override
from policies.command import Command
from policies.integrations.benchmarl import ROW, Moves, RoutingClass
from policies.integrations.saved import load
from policies.integrations.torchrl import GROUP

REWARD = {"kind": "team", "overflow": 1.0, "open": 1.0, "wirelength": 0.05}
"""The team reward of the cooperative scenarios, divided by 20."""

GAMES = 64
"""Games that are played side by side."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of BenchMARL's experiment that can be set, with BenchMARL's names."""

    lr: float = 5e-4
    gamma: float = 0.99
    polyak_tau: float = 0.01
    off_policy_n_optimizer_steps: int = 40
    exploration_eps_init: float = 1.0
    exploration_eps_end: float = 0.05

    def __post_init__(self) -> None:
        for name in ("gamma", "polyak_tau", "exploration_eps_init", "exploration_eps_end"):
            check(name, 0 <= getattr(self, name) <= 1, "a number from 0 to 1")
        check("lr", self.lr > 0, "a number above 0")
        steps = self.off_policy_n_optimizer_steps
        check("off_policy_n_optimizer_steps", steps >= 1, "a number from 1")


class _Steps(Callback):
    """Counts agent-steps, evaluates on the validation problems, and ends the training."""

    def __init__(self, scenario: str, most: int, every: int) -> None:
        super().__init__()
        self.scenario, self.most, self.every = scenario, most, every
        self.steps = 0
        self.curve: list[tuple[int, float | None]] = []

    def on_batch_collected(self, batch: Any) -> None:
        """Counts the moves that nets made, and has ε fall by them: BenchMARL counts frames."""
        acted = int(batch["next", "info", "acted"].sum())
        self.steps += acted
        explores = self.experiment.group_policies[GROUP][-1]
        explores.annealing_num_steps = self.most / 3 * batch.numel() / max(acted, 1)

    def on_train_end(self, training_td: Any, group: str) -> None:
        """Evaluates, and ends the training when all steps are made."""
        del training_td, group
        if self.steps >= self.every * (len(self.curve) + 1) or self.steps >= self.most:
            result = evaluate_policy(Moves(self.experiment).moves, self.scenario, "validation")
            cost = None if result.cost is None else round(result.cost, 4)
            self.curve.append((self.steps, cost))
            click.echo(f"{self.steps} agent-steps: {result}", err=True)
        if self.steps >= self.most:
            self.file.parent.mkdir(exist_ok=True)
            torch.save(self.experiment.state_dict(), self.file)
            raise _AllMadeError

    @property
    def file(self) -> Path:
        """BenchMARL's checkpoint."""
        return Path(self.experiment.folder_name) / "checkpoints" / "checkpoint_last.pt"


class _AllMadeError(KeyboardInterrupt):
    """All agent-steps are made: BenchMARL counts frames only."""


class _Resumable(Experiment):
    """An experiment that is written to a file from time to time, and goes on from there.

    BenchMARL's own checkpoints lack the games, the optimiser and the random numbers.

    Args:
        file: where the state is written.
        every: seconds between two states.
        asked: what is trained; the state of another training is refused.
        counter: counts the agent-steps.
        **options: those of BenchMARL's experiment.
    """

    def __init__(
        self, file: Path, every: float, asked: dict[str, Any], counter: _Steps, **options: Any
    ) -> None:
        self._file, self._every, self._asked, self._counter = file, every, asked, counter
        self._wrote, self._began = time.monotonic(), time.process_time()
        self._kept: dict[str, Any] | None = None
        if file.exists():
            what = f"the state of {asked}"
            self._kept = load(file, {"asked", "seconds"}, what)
            check(str(file), self._kept["asked"] == asked, what)
            self._began -= self._kept["seconds"]
        super().__init__(callbacks=[counter], **options)

    @property
    def seconds(self) -> float:
        """Processor time so far."""
        return time.process_time() - self._began

    def _collection_loop(self) -> None:
        """Trains, from the state that was written if there is one."""
        if (kept := self._kept) is not None:
            self.load_state_dict(kept["experiment"])
            self.replay_buffers[GROUP].load_state_dict(kept["memory"])
            for name, adam in self.optimizers[GROUP].items():
                adam.load_state_dict(kept["optimizers"][name])
            self.collector.env.base_env.batch = pickle.loads(kept["batch"])
            self.collector._carrier = kept["carrier"]
            self._counter.steps, self._counter.curve = kept["steps"], kept["curve"]
            torch.set_rng_state(kept["random"])
            shutil.rmtree(kept["folder"], ignore_errors=True)
            self._kept = None
            click.echo(f"{self._file}: goes on after {self._counter.steps} agent-steps", err=True)
        super()._collection_loop()

    def _save_experiment(self) -> None:
        """Writes the state if it is time: BenchMARL asks after every iteration."""
        if time.monotonic() < self._wrote + self._every:
            return
        state = {
            "asked": self._asked,
            "experiment": self.state_dict(),
            "memory": self.replay_buffers[GROUP].state_dict(),
            "optimizers": {n: adam.state_dict() for n, adam in self.optimizers[GROUP].items()},
            "batch": pickle.dumps(self.collector.env.base_env.batch),
            "carrier": self.collector._carrier,
            "steps": self._counter.steps,
            "curve": self._counter.curve,
            "random": torch.get_rng_state(),
            "folder": str(self.folder_name),
            "seconds": self.seconds,
        }
        with writing(self._file) as temporary:
            torch.save(state, temporary)
        self._wrote = time.monotonic()


def train(
    algorithm: str,
    scenario: str,
    steps: int,
    seed: int,
    out: Path,
    *,
    every: float = 600.0,
    **changes: Any,
) -> dict[str, Any]:
    """Trains on the scenario's training problems; returns the row.

    Args:
        algorithm: ``vdn`` or ``qmix``.
        scenario: the name of a scenario.
        steps: agent-steps.
        seed: a whole number from 0.
        out: the folder for BenchMARL's files. If it holds this very training, finished, its row is
            returned.
        every: after so many seconds the state of the training is written.
        **changes: see :class:`Options`.

    Raises:
        InputError: there is no such scenario, an option cannot be used, or the folder or the state
            beside it is that of another training.
    """
    options = build(Options, changes)
    found = scenarios.get(scenario)
    check("steps", steps >= 1, "a number from 1")
    check("seed", 0 <= seed < 2**32, f"a number from 0 to {2**32 - 1}")
    asked = {"algorithm": algorithm, "scenario": found.name, "steps": steps, "seed": seed}
    asked |= asdict(options)
    if (known := out / ROW).exists():
        row = build_json(dict[str, Any], read_text(known, 2**24), str(known))
        other = f"a new folder: {out} holds another training, {row.get('asked')}"
        check("out", row.get("asked") == asked, other)
        return row
    check("out", not out.exists(), f"a new folder, found {out}")
    torch.set_num_threads(1)
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # its messages go to the standard output
    task = RoutingClass.of(
        {"scenario": scenario, "reward": REWARD, "shared": True, "max_cycles": 1}
    )
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames = steps  # at least: a frame is one agent-step or more
    problems = found.problems("validation").values()
    nets = sum(len(problem.nets) for problem in problems) / len(problems)
    config.off_policy_n_envs_per_worker = GAMES
    config.off_policy_collected_frames_per_batch = GAMES * max(round(3200 / GAMES / nets), 1)
    config.off_policy_train_batch_size = max(round(640 / nets), 1)
    config.off_policy_memory_size = round(125_000 / nets)
    config.evaluation, config.loggers, config.create_json = False, [], False
    config.render, config.save_folder = False, str(out.parent)
    config.exclude_buffer_from_checkpoint = True
    config.checkpoint_interval = config.off_policy_collected_frames_per_batch
    for name, value in asdict(options).items():
        setattr(config, name, value)
    network = MlpConfig(num_cells=[128, 128], layer_class=nn.Linear, activation_class=nn.ReLU)
    counter = _Steps(found.name, steps, max(steps // 20, 1))
    out.parent.mkdir(parents=True, exist_ok=True)
    state = out.with_name(f"{out.name}.state.pt")
    with contextlib.redirect_stdout(sys.stderr):
        experiment = _Resumable(
            state,
            every,
            asked,
            counter,
            task=task,
            algorithm_config=algorithm_config_registry[algorithm].get_from_yaml(),
            model_config=network,
            critic_model_config=network,
            config=config,
            seed=seed,
        )
        with contextlib.suppress(_AllMadeError):
            experiment.run()
    seconds = experiment.seconds
    file = out / counter.file.relative_to(experiment.folder_name)
    Path(experiment.folder_name).rename(out)
    policy = Moves(experiment)
    row = {
        "asked": asked,
        "row": algorithm,
        "scenario": found.name,
        "seed": seed,
        "agent_steps": counter.steps,
        "processor_seconds": round(seconds, 1),
        "parameters": policy.parameters,
        "file": str(file),
        "curve": counter.curve,
    }
    for split in scenarios.SPLITS[1:]:
        row[split] = evaluate_policy(policy.moves, found.name, split, local=3).as_dict(rows=False)
    write_text(known, json.dumps(row, indent=1) + "\n")
    state.unlink(missing_ok=True)
    return row


@click.command(cls=Command)
@click.argument("algorithm", type=click.Choice(["vdn", "qmix"]))
@click.option("--scenario", required=True, help="Cooperative scenario to learn.")
@click.option("--steps", default=1_000_000, show_default=True, help="Agent-steps.")
@click.option("--seed", default=0, show_default=True)
@click.option("--out", type=Path, default=Path("runs/value_decomposition"), show_default=True)
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="Option of BenchMARL.")
def main(
    algorithm: str, scenario: str, steps: int, seed: int, out: Path, changes: tuple[str, ...]
) -> None:
    """Trains VDN or QMIX for so many agent-steps and prints the row in JSON."""
    row = train(algorithm, scenario, steps, seed, out, **override({}, changes))
    click.echo(json.dumps(row))


if __name__ == "__main__":
    # By its name, under which BenchMARL's checkpoints name what they hold.
    pkgutil.resolve_name("policies.integrations.value_decomposition:main")()
