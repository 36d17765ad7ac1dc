"""BatchEnv against the Parallel face, problem by problem."""

import numpy as np
import pytest

import marouting
from marouting import global_routing_v0
from marouting.engine import TurnOrder
from marouting.vector import BatchEnv

PROBLEMS = [
    *marouting.generate(2, grid=(4, 4, 2), nets=6, max_pins=3, capacity=2, seed=5),
    *marouting.generate(1, grid=(4, 4, 2), nets=3, max_pins=2, capacity=2, seed=6),
]


@pytest.mark.parametrize("turn_order", ["round_robin", "sequential"])
def test_every_problem_plays_as_in_the_parallel_face(turn_order: TurnOrder) -> None:
    batch = BatchEnv(PROBLEMS, turn_order=turn_order, max_steps=7)
    faces = [
        global_routing_v0.parallel_env(p, turn_order=turn_order, max_steps=7) for p in PROBLEMS
    ]
    rng = np.random.default_rng(0)
    seen, info = batch.reset()
    expected = [face.reset() for face in faces]
    ended = np.zeros(len(faces), int)
    starting = [True] * len(faces)
    for _ in range(300):
        for m, (observations, infos) in enumerate(expected):
            for agent in faces[m].agents:
                n = int(agent.removeprefix("net_"))
                np.testing.assert_array_equal(seen[m, n], observations[agent])
                np.testing.assert_array_equal(
                    info["action_mask"][m, n], infos[agent]["action_mask"]
                )
        actions = rng.integers(0, 6, (batch.num_problems, batch.num_agents))
        seen, rewards, terminated, truncated, info = batch.step(actions)
        for m, face in enumerate(faces):
            if not face.agents:  # its episode was over: this step starts the next
                expected[m] = face.reset()
                assert not rewards[m].any()
                assert not terminated[m].any()
                assert not truncated[m].any()
                starting[m] = True
                continue
            starting[m] = False
            agents = list(face.agents)
            numbers = [int(agent.removeprefix("net_")) for agent in agents]
            seen_now, paid, done, cut, infos = face.step(
                {agent: actions[m, n] for agent, n in zip(agents, numbers, strict=True)}
            )
            expected[m] = seen_now, infos
            assert rewards[m, numbers].tolist() == [paid[agent] for agent in agents]
            assert terminated[m, numbers].tolist() == [done[agent] for agent in agents]
            assert truncated[m, numbers].tolist() == [cut[agent] for agent in agents]
            waiting = np.setdiff1d(np.arange(batch.num_agents), numbers)
            assert not rewards[m, waiting].any()
            assert info["over"][m] == (not face.agents)
            assert {key: info[key][m] for key in ("overflow", "wirelength", "joined")} == {
                key: face.metrics()[key] for key in ("overflow", "wirelength", "joined")
            }
            ended[m] += info["over"][m]
    assert (ended > 2).all()


def test_rows_of_small_problems_are_filled_up() -> None:
    batch = BatchEnv(PROBLEMS)
    seen, info = batch.reset()
    assert batch.present.sum(axis=1).tolist() == [6, 6, 3]
    assert not seen[2, 3:].any()
    assert not info["active"][2, 3:].any()
    assert (info["action_mask"][2, 3:] == 1).all()


def test_arrays_are_reused_and_in_their_space() -> None:
    batch = BatchEnv(PROBLEMS)
    first, _ = batch.reset()
    moves = np.zeros((batch.num_problems, batch.num_agents), np.int8)
    second, rewards, *_ = batch.step(moves)
    third, again, *_ = batch.step(moves)
    assert first is second is third
    assert rewards is again
    assert all(batch.single_observation_space.contains(row) for row in third[batch.present])


def test_without_autoreset_an_episode_stays_over() -> None:
    batch = BatchEnv(PROBLEMS, max_steps=1, autoreset=False)
    batch.reset()
    moves = np.ones((batch.num_problems, batch.num_agents), np.int8)
    for _ in range(4):
        *_, terminated, truncated, info = batch.step(moves)
    assert (terminated | truncated)[batch.present].all()
    assert not info["active"].any()
    assert not info["over"].any()  # they ended with an earlier step


def test_actions_of_another_shape_are_refused() -> None:
    batch = BatchEnv(PROBLEMS)
    batch.reset()
    with pytest.raises(ValueError, match=r"actions: expected shape \(3, 6\)"):
        batch.step(np.zeros(3, np.int8))
    with pytest.raises(ValueError, match="moves"):
        batch.step(np.full((3, 6), 6, np.int8))
