"""The move that stays, and messages: what they do in every interface.

``tests/test_game.py`` and ``tests/test_one_game.py`` hold the plain game and the batch equal.
"""

import re
from typing import Any

import gymnasium
import numpy as np
import pytest

import marouting
from marouting import InputError, Net, Pin, Problem, global_routing_v0
from marouting.batch.window import mirrored, move_order
from marouting.game import Ending
from marouting.observations import move_order_of
from marouting.rules import Rules
from marouting.vector import BatchEnv
from policies.learned.config import load_config
from policies.learned.run import Run

WAIT, MOVES = 6, 7

SEES = {"kind": "window", "radius": 1, "layers": 0, "channels": ["messages"], "message_bits": 2}


def two_nets() -> Problem:
    """Two nets on four Gcells in a row, with one track: they meet in the middle."""
    nets = Net("a", 0, (Pin(0, 0, 1), Pin(3, 0, 1))), Net("b", 1, (Pin(3, 0, 1), Pin(0, 0, 1)))
    return Problem((4, 1, 1), (1,), (1,), nets, (1,), (0,), (0,))


def test_waiting_takes_a_step_and_no_edge() -> None:
    env = global_routing_v0.parallel_env(two_nets(), wait=True, max_steps=3)
    _, infos = env.reset()
    assert env.action_space("net_0").n == MOVES
    assert infos["net_0"]["action_mask"].tolist() == [1, 0, 0, 0, 0, 0, 1]
    for step in range(3):
        _, rewards, _, cut, infos = env.step({"net_0": WAIT, "net_1": WAIT})
        assert rewards == {"net_0": -1, "net_1": -1}
        assert cut == {"net_0": step == 2, "net_1": step == 2}
    assert infos["net_0"]["task_ended"] == Ending.FAILED
    assert env.metrics() == {"overflow": 0, "wirelength": 0, "joined": 0, "tasks": 2, "steps": 6}
    assert env.game.cell[0] == env.game.tasks[0][0][0]


def test_who_is_boxed_in_can_only_wait() -> None:
    """Without the option the mask is all ones."""
    for wait in (False, True):
        env = BatchEnv([two_nets()], wait=wait)
        _, info = env.reset()
        for _ in range(2):
            _, *_, info = env.step(np.array([[0, 1]]))
        # Net 1 was blocked by net 0, which went first: of the three edges two are taken by net 0.
        assert env.engine.dynamic.remaining[0].reshape(-1, 3)[:3, 0].tolist() == [0, 0, 0]
        assert info["action_mask"][0].tolist() == [
            [0, 1, 0, 0, 0, 0] + [1] * wait,
            [1, 0, 0, 0, 0, 0] + [1] * wait,
        ]
    net = Net("a", 0, (Pin(0, 0, 1), Pin(1, 0, 1)))
    blocked = Problem((2, 1, 1), (0,), (0,), (net,), (1,), (0,), (0,))
    for options, mask in (({}, [1] * 6), ({"wait": True}, [0] * 6 + [1])):
        plain = global_routing_v0.parallel_env(blocked, **options)
        _, infos = plain.reset()
        assert infos["net_0"]["action_mask"].tolist() == mask
        _, info = BatchEnv([blocked], **options).reset()
        assert info["action_mask"][0, 0].tolist() == mask


def test_waiting_comes_after_ripping_up() -> None:
    rules = Rules(wait=True, message_bits=2, rip_up=marouting.rules.RipUp(choose="agents"))
    assert (rules.moves, rules.messages, rules.actions) == (8, 4, 32)
    env = global_routing_v0.env(two_nets(), wait=True, rip_up={"choose": "agents"}, max_steps=1)
    env.reset()
    masks = []
    for agent in env.agent_iter():
        *_, terminated, truncated, info = env.last()
        if not (terminated or truncated):
            masks.append((env.unwrapped.game.asked, info["action_mask"][-2:].tolist()))
        env.step(None if terminated or truncated else 7 if agent else 0)
    assert masks == [(False, [0, 1])] * 2 + [(True, [1, 0])] * 2


def messages_seen(row: np.ndarray, bit: int) -> list[float]:
    """Along x, on the grid: what an agent sees of a bit in the Gcells next to it."""
    window = marouting.WindowObservation(1, 0, ("messages",), 2)
    where, shape = window.layout[f"messages_{bit}"]
    seen: list[float] = row[where].reshape(shape)[:, 1, 0].tolist()
    return seen if row[0] > 0 else seen[::-1]


def test_messages_are_seen_from_the_next_step_on() -> None:
    options: dict[str, Any] = {"wait": True, "message_bits": 2, "observation": SEES}
    plain = global_routing_v0.parallel_env(two_nets(), **options)
    batch = BatchEnv([two_nets()], **options)
    seen, _ = plain.reset()
    obs, _ = batch.reset()
    assert messages_seen(seen["net_0"], 0) == messages_seen(obs[0, 0], 0) == [0, 0, 0]
    steps = [
        # Net 0 goes east and says 1, net 1 waits and says 2: they are two Gcells apart.
        ((0 + MOVES * 1, WAIT + MOVES * 2), [0, 1, 0], [0, 0, 0], [0, 0, 0], [0, 1, 0]),
        # Net 0 waits and says 3, net 1 comes next to it and says 2.
        ((WAIT + MOVES * 3, 1 + MOVES * 2), [0, 1, 0], [1, 0, 0], [0, 1, 1], [1, 1, 0]),
        # Net 0 says nothing more.
        ((WAIT, WAIT + MOVES * 1), [0, 0, 1], [0, 1, 0], [0, 0, 0], [0, 0, 0]),
    ]
    for actions, low_0, low_1, high_0, high_1 in steps:
        seen, *_ = plain.step(dict(zip(["net_0", "net_1"], actions, strict=True)))
        obs, *_ = batch.step(np.array([actions]))
        for rows in ([seen["net_0"], seen["net_1"]], obs[0]):
            assert [messages_seen(row, 0) for row in rows] == [low_0, low_1]
            assert [messages_seen(row, 1) for row in rows] == [high_0, high_1]
    batch.reset()
    assert not batch.engine.agents["message"].any()
    plain.reset()
    assert list(plain.game.message) == [0, 0]


def test_learners_choose_messages_among_mirrored_moves() -> None:
    """Every message goes with every move of the window, and waiting is the same in a mirror."""
    window = marouting.WindowObservation(1, 0, ("messages",), 1)
    obs = np.zeros((1, window.size), np.float32)
    obs[0, :2] = -1, 1
    order = move_order_of(window, obs, 14, 2)
    assert order.tolist() == move_order(obs, 14, 2).tolist()
    assert mirrored(np.arange(14), obs.repeat(14, axis=0), 14, 2).tolist() == order[0].tolist()
    assert order.tolist() == [[1, 0, 2, 3, 4, 5, 6, 8, 7, 9, 10, 11, 12, 13]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"message_bits": 9}, "message_bits: expected 0 to 8, found 9"),
        ({"message_bits": -1}, "message_bits: expected 0 to 8, found -1"),
        ({"wait": 1}, "wait: expected"),
    ],
)
def test_options_that_cannot_be_had(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        global_routing_v0.parallel_env(two_nets(), **options)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("channels", "shown", "written", "message"),
    [
        ("messages", 1, 2, "message_bits: expected 1, as in observation.message_bits, found 2"),
        ("messages", 1, 0, "message_bits: expected 1, as in observation.message_bits, found 0"),
        ("messages", 3, 2, "message_bits: expected 3, as in observation.message_bits, found 2"),
        ("messages", 2, 2, None),
        ("heads", 1, 2, None),  # nothing shows the messages, but an observation may read them
    ],
)
def test_windows_show_all_bits_that_agents_write(
    channels: str, shown: int, written: int, message: str | None
) -> None:
    sees = {"kind": "window", "channels": [channels], "message_bits": shown}
    env = {"message_bits": written, "observation": sees}
    window = marouting.WindowObservation(channels=(channels,), message_bits=shown)  # type: ignore[arg-type]
    single = lambda **options: gymnasium.make("marouting/GlobalRouting-v0", **options)  # noqa: E731
    config = [
        f"env.message_bits={written}", "env.observation.kind=window",
        f"env.observation.channels=[{channels}]", f"env.observation.message_bits={shown}",
    ]  # fmt: skip
    for make in (
        lambda: global_routing_v0.env(two_nets(), **env),
        lambda: global_routing_v0.parallel_env(two_nets(), **env),
        lambda: global_routing_v0.parallel_env(
            two_nets(), message_bits=written, observation=window
        ),
        lambda: single(problem=two_nets(), **env),
        lambda: gymnasium.make_vec("marouting/GlobalRouting-v0", problem=two_nets(), **env),
        lambda: BatchEnv([two_nets()], **env),
        lambda: marouting.make({"env": env}),
        lambda: load_config(None, config),
    ):
        if message is None:
            make()
            continue
        with pytest.raises(InputError, match=rf"(^|: |\.){re.escape(message)}$"):
            make()


@pytest.mark.parametrize("kind", ["dqn", "ppo"])
def test_trainings_with_messages(kind: str, tmp_path: Any) -> None:
    config = load_config(
        None,
        [
            f"out={tmp_path}/run", f"learner.kind={kind}", "train.episodes=4",
            "train.tensorboard=false", "train.figures=false", "train.shared=true",
            "env.agents=multi", "env.wait=true", "env.message_bits=2", "env.max_steps=6",
            "env.observation.kind=window", "env.observation.channels=[heads,messages]",
            "env.observation.message_bits=2",
            "env.problem.grid=[4,4,1]", "env.problem.nets=3", "env.problem.reduced_edges=0",
        ],
    )  # fmt: skip
    Run(config).execute()
    assert (tmp_path / "run" / "policy.pt").exists()
