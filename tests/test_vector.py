"""BatchEnv against the Parallel environment, problem by problem."""

import os
import pickle
import signal
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

import marouting
from marouting import InputError, generate, global_routing_v0
from marouting.game import NOBODY
from marouting.observations import PaperObservation
from marouting.rewards import PaperReward
from marouting.rules import TurnOrder
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
            for agent, n in zip(agents, numbers, strict=True):
                assert infos[agent].get("task_ended", 0) == info["task_ended"][m, n]
                if "task_ended" in infos[agent]:
                    for mine, theirs in (("task_obs", "final_obs"), ("task_mask", "final_mask")):
                        np.testing.assert_array_equal(infos[agent][mine], info[theirs][m, n])
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


def test_in_sequential_order_one_agent_moves_in_a_step() -> None:
    for order, movers in (("sequential", 1), ("round_robin", 6)):
        batch = BatchEnv(PROBLEMS[:1], turn_order=order)
        _, info = batch.reset()
        for _ in range(2):
            assert info["active"].all()
            *_, info = batch.step(info["action_mask"].argmax(axis=-1))
            assert info["acted"].sum() == movers


def test_actions_of_another_shape_are_refused() -> None:
    batch = BatchEnv(PROBLEMS)
    batch.reset()
    with pytest.raises(ValueError, match=r"actions: expected shape \(3, 6\)"):
        batch.step(np.zeros(3, np.int8))
    with pytest.raises(ValueError, match="actions: expected"):
        batch.step(np.full((3, 6), 6, np.int8))


def walk(env: BatchEnv, steps: int = 60) -> list[NDArray[Any]]:
    """Everything that an environment shows on a random walk, copied."""
    rng = np.random.default_rng(1)
    seen, info = env.reset()
    shown = [seen.copy(), info["action_mask"].copy()]
    for _ in range(steps):
        *arrays, info = env.step(rng.integers(-1, 6, info["agents"].shape))
        figures = [info["final_info"][name] for name in sorted(info["final_info"])]
        plain = [info[name] for name in sorted(info) if name != "final_info"]
        shown += [array.copy() for array in (*arrays, *plain, *figures, env.state())]
    return shown


def same(one: list[NDArray[Any]], other: list[NDArray[Any]]) -> bool:
    return len(one) == len(other) and all(
        a.dtype == b.dtype and np.array_equal(a, b) for a, b in zip(one, other, strict=True)
    )


@pytest.mark.parametrize("turn_order", ["round_robin", "sequential"])
def test_threads_change_nothing(turn_order: TurnOrder) -> None:
    expected = walk(BatchEnv(PROBLEMS, turn_order=turn_order, max_steps=7))
    for threads in (2, 3, 8):
        env = BatchEnv(PROBLEMS, turn_order=turn_order, max_steps=7, threads=threads)
        assert same(walk(env), expected)
    with pytest.raises(InputError, match="threads: expected a whole number from 1, found 0"):
        BatchEnv(PROBLEMS, threads=0)


class Plain:
    """A component without its compiled form: what anybody may inject."""

    def __init__(self, component: Any) -> None:
        self._component = component

    def space(self, *arguments: Any) -> Any:
        return self._component.space(*arguments)

    def write(self, *arguments: Any) -> None:
        self._component.write(*arguments)

    def __call__(self, *arguments: Any) -> Any:
        return self._component(*arguments)


def test_injected_components_are_as_good_as_the_compiled_ones() -> None:
    observation = PaperObservation(via_capacity=3)
    reward = PaperReward(reached=7, own_edge=-0.25, overflow_price=2)
    options: dict[str, Any] = {"overflow": "allowed", "max_steps": 9}
    expected = walk(BatchEnv(PROBLEMS, observation=observation, reward=reward, **options))
    components = {"observation": Plain(observation), "reward": Plain(reward)}
    for threads in (1, 2):
        assert same(walk(BatchEnv(PROBLEMS, **components, **options, threads=threads)), expected)


@pytest.mark.parametrize("everyone", [True, False])
@pytest.mark.parametrize("turn_order", ["round_robin", "sequential"])
@pytest.mark.parametrize(
    "options",
    [
        {
            "target": "tree",
            "next_pin": "nearest",
            "mask": {"visited": True},
            "release_failed": True,
        },
        {"rip_up": {"rounds": 2, "neighbours": 2}, "mask": {"visited": True}},
        {"rip_up": {"rounds": 2, "choose": "history"}, "target": "tree", "release_failed": True},
    ],
)
def test_games_with_options_are_the_same_compiled_and_not(
    options: dict[str, Any], turn_order: TurnOrder, everyone: bool
) -> None:
    options = {"max_steps": 12, "turn_order": turn_order, "everyone": everyone, **options}
    expected = walk(BatchEnv(PROBLEMS, **options), 400)
    components = {"observation": Plain(PaperObservation()), "reward": Plain(PaperReward())}
    assert same(walk(BatchEnv(PROBLEMS, **components, **options), 400), expected)


def test_the_metrics_of_the_last_episode_stay() -> None:
    env = BatchEnv(PROBLEMS, max_steps=5)
    _, info = env.reset()
    rng = np.random.default_rng(3)
    last = {name: np.zeros(len(PROBLEMS), int) for name in info["final_info"]}
    ended = np.zeros(len(PROBLEMS), int)
    for _ in range(120):
        *_, info = env.step(rng.integers(6, size=(env.num_problems, env.num_agents)))
        for m in np.flatnonzero(info["over"]):
            ended[m] += 1
            for name in last:
                last[name][m] = info[name][m]
        for name in last:
            assert np.array_equal(info["final_info"][name], last[name])
    assert ended.min() > 1
    assert last["wirelength"].min() > 0


def test_states_are_those_of_the_faces() -> None:
    env = BatchEnv(PROBLEMS, max_steps=9)
    env.reset()
    faces = [global_routing_v0.parallel_env(p, max_steps=9) for p in PROBLEMS]
    for face in faces:
        face.reset()
    rng = np.random.default_rng(0)
    for _ in range(6):
        actions = rng.integers(6, size=(env.num_problems, env.num_agents))
        env.step(actions)
        for m, face in enumerate(faces):
            face.step({a: actions[m, int(a.removeprefix("net_"))] for a in face.agents})
            assert np.array_equal(env.state()[m], face.state())
            assert env.single_state_space.contains(env.state()[m])
            assert env.single_state_space.shape == face.state_space.shape


def test_a_copy_by_pickle_plays_alike() -> None:
    env = BatchEnv(PROBLEMS, max_steps=7, threads=2)
    assert same(walk(pickle.loads(pickle.dumps(env))), walk(env))


def test_a_copy_in_mid_episode_goes_on() -> None:
    env = BatchEnv(PROBLEMS, max_steps=7, threads=2)
    env.reset()
    for _ in range(3):
        env.step(np.ones((env.num_problems, env.num_agents), np.int8))
    twin = pickle.loads(pickle.dumps(env))
    for move in (0, 2, 1, 3, 4) * 3:
        actions = np.full((env.num_problems, env.num_agents), move)
        results = [batch.step(actions) for batch in (env, twin)]
        for a, b in zip(*(result[:4] for result in results), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks on this system")
def test_a_forked_process_has_threads_of_its_own() -> None:
    env = BatchEnv(PROBLEMS, max_steps=7, threads=2)
    env.reset()
    stay = np.full((env.num_problems, env.num_agents), NOBODY, np.int8)
    env.step(stay)
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        env.step(stay)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    env.step(stay)


def test_a_step_needs_an_episode() -> None:
    env = BatchEnv(generate(2, nets=3))
    stay = np.full((2, 3), NOBODY, np.int8)
    with pytest.raises(ResetNeeded, match=r"expected a call of reset\(\)"):
        env.step(stay)
    other = BatchEnv(generate(2, nets=3))
    other.reset()
    env.restore(other.save())
    env.step(stay)
