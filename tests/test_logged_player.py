"""Games follow from their moves: a player that makes them again stands where the first one does."""

from typing import Any

import numpy as np
import pytest

import marouting
from marouting.config import build
from marouting.options import EnvOptions
from policies.learned.logged_player import LoggedPlayer
from policies.learned.policy import player_of

GAMES: list[dict[str, Any]] = [
    {"agents": "multi"},
    {"agents": "single", "turn_order": "round_robin", "observation": "window"},
    {"agents": "multi", "reward": "difference", "rip_up": {"rounds": 2, "neighbours": 1}},
    {"agents": "single", "rip_up": {"rounds": 3, "choose": "agents"}, "observation": "window"},
]


@pytest.mark.parametrize("env", GAMES)
def test_games_are_played_again(env: dict[str, Any]) -> None:
    problems = marouting.generate(3, grid=(4, 4, 2), nets=4, max_pins=3, capacity=2, seed=1)
    options = build(EnvOptions, {"max_steps": 6, **env})
    first, second = (player_of(options, problems, kind=LoggedPlayer) for _ in range(2))
    assert isinstance(first, LoggedPlayer)
    assert isinstance(second, LoggedPlayer)
    rng, looked = np.random.default_rng(0), 0
    first.reset()
    for step in range(120):
        b = first.buffers
        b.actions[:] = np.where(rng.random(b.active.shape) < 0.9, (b.mask * 1.0).argmax(-1), 0)
        b.actions[~b.active] = -1
        first.step()
        begun: list[np.ndarray[Any, Any]] = []
        if step % 20 == 7:
            second.replay(first.moves, first.made, begun.append)
            for name in ("agents", "games", "remaining", "used"):
                mine, theirs = (getattr(p.engine.dynamic, name) for p in (second, first))
                np.testing.assert_array_equal(mine, theirs, err_msg=name)
            for name in ("agents", "obs", "mask", "active"):
                mine, theirs = (getattr(p.buffers, name) for p in (second, first))
                np.testing.assert_array_equal(mine, theirs, err_msg=name)
            assert np.array_equal(np.any(begun, axis=0), first.made > 0)
            looked += 1
        if b.over.any():
            first.reset(b.over.copy())
    assert looked == 6
    assert first.made.max() < 120  # games have begun anew
