"""Learners act in the order of an observation's own moves; environments in that of the grid."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray

from marouting import EnvOptions, InputError, PaperObservation, generate, global_routing_v0
from marouting.batch.engine import Engine
from marouting.batch.window import mirrored, move_order
from marouting.game import NOBODY, Ending
from marouting.options import game_options
from marouting.player import Player
from marouting.search.guides import AStar
from policies.learned.networks.mlp import MLP
from policies.learned.policy import TrainedPolicy, player_of

PROBLEMS = generate(3, (5, 4, 2), 5, max_pins=4, capacity=2, seed=3)
ASKED = {"rip_up": {"choose": "agents"}}
WINDOW = {"kind": "window", "radius": 1}


@dataclass(frozen=True)
class Rolled:
    """The paper's observation with moves that no mirror makes: 0 is 2, 1 is 3, and so on."""

    by: int = 2
    paper: PaperObservation = PaperObservation()  # noqa: RUF009 - it has no state

    def space(self, problems: Any, overflow: bool) -> Box:
        return self.paper.space(problems, overflow)

    def write(self, *arguments: Any) -> None:
        self.paper.write(*arguments)

    def move_order(self, obs: NDArray[np.float32]) -> NDArray[np.int64]:
        by = self.by + (obs[:, 0] > 1)  # another one on the right
        return (np.arange(6) + by[:, None].astype(int)) % 6


def players(everyone: bool, **options: Any) -> list[Player]:
    """Two players of the same games: by the grid's moves, and by the observation's."""
    checked = game_options({"max_steps": 8, "turn_order": "round_robin", **options})
    observation = checked.observation.make()
    return [
        Player(
            Engine(PROBLEMS, checked),
            observation,
            checked.reward.make(),
            everyone=everyone,
            reorder_moves=turned,
        )
        for turned in (False, True)
    ]


@pytest.mark.parametrize("everyone", [True, False])
@pytest.mark.parametrize("reward", ["paper", "team"])
@pytest.mark.parametrize("rules", [{}, ASKED], ids=["six moves", "seven"])
@pytest.mark.parametrize("look", [WINDOW, Rolled()], ids=["window", "rolled"])
def test_turned_moves_are_those_of_the_grid_in_another_order(
    look: Any, rules: dict[str, Any], reward: str, everyone: bool
) -> None:
    plain, turned = players(everyone, observation=look, reward=reward, **rules)
    rng = np.random.default_rng(0)
    plain.reset()
    turned.reset()
    ended = differ = 0
    for step in range(150):
        one, other = plain.buffers, turned.buffers
        assert np.array_equal(one.obs, other.obs)
        order: NDArray[np.int64] = np.arange(one.mask.shape[2]) + np.zeros_like(one.mask)
        if isinstance(look, Rolled):
            order[..., :6] = look.move_order(one.obs.reshape(-1, 12)).reshape(*one.agents.shape, 6)
        else:
            order[..., :6] = move_order(one.obs)
        assert np.array_equal(other.mask, np.take_along_axis(one.mask, order.astype(int), -1))
        for m, k in np.argwhere(one.ending != Ending.NONE):
            final = one.final_obs[m, k]
            own = look.move_order(final[None])[0] if isinstance(look, Rolled) else move_order(final)
            assert np.array_equal(other.final_mask[m, k, :6], one.final_mask[m, k, own])
            ended += 1
        chosen = rng.integers(-1, one.mask.shape[2], one.actions.shape).astype(np.int8)
        on_grid = np.take_along_axis(order, np.maximum(chosen, 0)[..., None].astype(int), -1)
        one.actions[:] = np.where(chosen == NOBODY, NOBODY, on_grid[..., 0])
        differ += int((one.actions != chosen).sum())
        if not isinstance(look, Rolled):
            count = one.mask.shape[2]
            assert np.array_equal(mirrored(chosen, one.obs, count), one.actions)
        other.actions[:] = chosen
        assert np.array_equal(turned.actions_of(one.actions), chosen)
        assert np.array_equal(plain.actions_of(one.actions), one.actions)
        plain.step(restart=True)
        turned.step(restart=True)
        assert np.array_equal(other.actions, chosen)  # as learners remember it
        for name in ("agents", "acted", "reward", "ending", "terminated", "truncated", "active"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
        assert all(map(np.array_equal, plain.engine.dynamic, turned.engine.dynamic))
        if step % 40 == 17:  # what is not started anew keeps its masks
            which = np.array([True, False, False])
            plain.reset(which)
            turned.reset(which)
    assert ended > 10
    assert differ > 20


def test_the_papers_observation_is_not_turned() -> None:
    for player in players(True, observation="paper"):
        assert player.compiled
        assert not player.reorders_moves


def test_a_guide_leads_a_turned_player_where_it_leads_any_other() -> None:
    plain, turned = players(True, observation=WINDOW, max_steps=30)
    for player in (plain, turned):
        player.reset()
        guide = AStar(player.engine)
        while player.buffers.active.any():
            moves = guide.moves(*player.engine.pairs(everyone=True))
            player.buffers.actions[:] = player.actions_of(moves.reshape(player.buffers.acted.shape))
            player.step()
    assert all(map(np.array_equal, plain.engine.dynamic, turned.engine.dynamic))
    assert turned.engine.games["joined"].sum() > 20


@pytest.mark.parametrize("masking", [False, True])
@pytest.mark.parametrize("look", [WINDOW, Rolled()], ids=["window", "rolled"])
def test_a_policy_acts_in_the_environment_as_it_routes(look: Any, masking: bool) -> None:
    """``act`` takes and gives what environments show; ``solve`` plays by the observation's."""
    torch.manual_seed(1)
    options = EnvOptions(
        observation=game_options({"observation": look}).observation,
        max_steps=8,
        turn_order="round_robin",
    )
    size = player_of(options, PROBLEMS).buffers.obs.shape[2]
    policy = TrainedPolicy(MLP((size,), 6, hidden=(16,)), masking, (size,), options)
    for problem in PROBLEMS:
        face = global_routing_v0.env(problem, observation=look, max_steps=8)
        face.reset()
        for _ in face.agent_iter():
            observation, _, terminated, truncated, info = face.last()
            over = terminated or truncated
            face.step(None if over else policy.act(observation, info["action_mask"]))
        assert face.unwrapped.metrics()["wirelength"] > 0
        assert policy.solve(problem).solution == face.unwrapped.solution()


class Wrong(Rolled):
    """An order in which a move is missing."""

    def move_order(self, obs: NDArray[np.float32]) -> NDArray[np.int64]:
        return np.full((len(obs), 6), self.by)


class Long(Rolled):
    """An order of too many moves."""

    def move_order(self, obs: NDArray[np.float32]) -> NDArray[np.int64]:
        return np.tile(np.arange(7), (len(obs), 1))


class Ragged(Rolled):
    """Orders of different lengths."""

    def move_order(self, obs: NDArray[np.float32]) -> Any:
        return [list(range(6 - (i == 0))) for i in range(len(obs))]


@pytest.mark.parametrize("look", [Wrong(0), Wrong(5), Wrong(-1), Wrong(99), Long(), Ragged()])
def test_an_order_that_is_none_is_refused(look: Rolled) -> None:
    _, turned = players(True, observation=look)
    with pytest.raises(InputError, match=r"move_order: expected the moves 0 to 5, each once, for"):
        turned.reset()
