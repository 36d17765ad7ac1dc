"""A policy that imitates a local rule, for trainings that begin with one (``train.start``).

Usage, from a checkout::

    python -m policies.experiment.cloned gates-8x7-v0 --out runs/cloned.pt
    marouting train learner.kind=ippo env.scenario=gates-8x7-v0 train.start=runs/cloned.pt

A rule of :mod:`policies.routers.local` plays training problems of the scenario. The actor that
``marouting train learner.kind=ppo`` would have learns to make its moves (behavioural cloning: the
negative logarithm of their probability is minimised). The critic is not trained.
"""

from pathlib import Path

import click
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from marouting.config import check
from marouting.files import check_writable, writing
from marouting.observations import has_move_order, move_order_of
from marouting.scenarios.cooperation import COOPERATION
from marouting.source import ProblemSampler
from marouting.vector import BatchEnv
from policies.command import Command
from policies.learned.config import Config, load_config
from policies.learned.machine import use_threads
from policies.learned.run import problems_of
from policies.learned.trainer import Trainer
from policies.routers.local import LocalRouter

GAMES = 64
"""Games that are played side by side."""

MOVES = 100_000
"""Moves of the rule that a network learns from."""

EPOCHS, BATCH, LEARNING_RATE = 5, 1024, 1e-3


def demonstrations(
    scenario: str, rule: LocalRouter, moves: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]]:
    """What agents saw when they had a choice, and what the rule made of it.

    Args:
        scenario: its training problems are played, by the options that it suggests.
        rule: makes all moves.
        moves: how many there are to be, at least.
        seed: decides which problems are drawn.

    Returns:
        (K, *S) observations, (K, A) masks and (K,) moves, in the observation's own order of moves.
    """
    env = BatchEnv(GAMES, scenario=scenario, seed=seed)
    rng = np.random.default_rng(seed)
    seen: list[NDArray[np.float32]] = []
    masks: list[NDArray[np.bool_]] = []
    made: list[NDArray[np.int64]] = []
    found = 0
    obs, info = env.reset()
    while found < moves:
        chosen = rule.moves(env.engine, rng)
        shown, mask = obs.copy(), info["action_mask"] != 0
        obs, *_, info = env.step(chosen)
        # In sequential order only one net of a game moves.
        rows = info["acted"] & (mask.sum(-1) > 1)
        now, allowed, move = shown[rows], mask[rows], chosen[rows].astype(np.int64)
        if has_move_order(env.observation):
            order = move_order_of(
                env.observation, now, env.engine.actions, env.engine.rules.messages
            )
            allowed = np.take_along_axis(allowed, order, -1)
            move = (order == move[:, None]).argmax(-1)
        seen.append(now)
        masks.append(allowed)
        made.append(move)
        found += len(move)
    env.close()
    return np.concatenate(seen), np.concatenate(masks), np.concatenate(made)


def imitate(
    module: nn.Module,
    shown: tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]],
    seed: int,
) -> float:
    """Trains a network to make the moves; returns the share that it makes in the last epoch."""
    obs, masks, moves = map(torch.from_numpy, shown)
    adam = torch.optim.Adam(module.parameters(), lr=LEARNING_RATE)
    generator = torch.Generator().manual_seed(seed)
    same = 0.0
    for _ in range(EPOCHS):
        hits = 0
        for some in torch.split(torch.randperm(len(moves), generator=generator), BATCH):
            ratings: Tensor = module(obs[some]).masked_fill(~masks[some], -torch.inf)
            loss = nn.functional.cross_entropy(ratings, moves[some])
            adam.zero_grad()
            torch.autograd.backward(loss)
            adam.step()
            hits += int((ratings.argmax(-1) == moves[some]).sum())
        same = hits / len(moves)
    return same


def cloned(config: Config, rule: LocalRouter, out: Path, moves: int = MOVES) -> float:
    """Writes a file of networks that imitate a rule; returns the share of moves they agree on.

    Args:
        config: a training on a scenario; what the network is, and what it sees.
        rule: what is imitated.
        out: the file, for ``train.start``.
        moves: how many of the rule's moves are learned from.
    """
    problems, episodes = problems_of(config)
    assert episodes is not None  # a scenario's training problems are drawn
    draws = ProblemSampler(episodes, config.seed, GAMES)
    trainer = Trainer(problems, config, draws)
    networks, setup = trainer.learner.networks, trainer.learner.setup
    module: nn.Module = config.learner.cls.network(
        config.learner.options, setup.obs_shape, setup.actions
    )
    nn.utils.vector_to_parameters(networks.flat[0], module.parameters())
    shown = demonstrations(str(config.env.scenario), rule, moves, config.seed)
    same = imitate(module, shown, config.seed)
    figures = {"teacher": rule.rule == "shortest" and rule.radius is None}
    state = trainer.saved.state() | {"weights": [dict(module.state_dict())], "figures": figures}
    with writing(out) as temporary:
        torch.save(state, temporary)
    return same


@click.command(cls=Command)
@click.argument("name")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="File to write.")
@click.option("--radius", default=3, show_default=True, help="How far the rule sees.")
@click.option("--price", default=0.0, show_default=True, help="The rule's price of full edges.")
@click.option("--moves", default=MOVES, show_default=True, help="Moves to learn from.")
@click.option("--seed", default=0, show_default=True, help="Of problems and weights.")
def main(name: str, out: Path, radius: int, price: float, moves: int, seed: int) -> None:
    """Trains a policy that imitates a local rule in the scenario NAME."""
    known = [scenario.name for scenario in COOPERATION]
    check("scenario", name in known, f"one of {', '.join(known)}, found {name!r}")
    check("--moves", moves > 0, "a number above 0")
    check_writable(out)
    use_threads(1)
    config = load_config(None, [f"env.scenario={name}", "learner.kind=ippo", f"seed={seed}"])
    same = cloned(config, LocalRouter(radius=radius, price=price), out, moves)
    click.echo(f"{out}: makes {same:.1%} of the rule's moves", err=True)


if __name__ == "__main__":
    main()
