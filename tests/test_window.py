"""The observation ``window``, number by number.

The oracle here is plain Python over Gcells as (x, y, layer) and edges as pairs of them. It shares
nothing with the compiled code but the state of the game.
"""

import copy
import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import examples
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pettingzoo.test import api_test, parallel_api_test, seed_test, state_test
from reference import Edge, all_edges, between, contested, edge_number
from seeing import Gcell, expected, gcell, open_tasks, option_state, squash

import marouting
from marouting import (
    Adjustment,
    Engine,
    InputError,
    Net,
    PaperReward,
    Pin,
    Problem,
    WindowObservation,
    generate,
    global_routing_v0,
)
from marouting.batch.state import Option
from marouting.batch.window import CHANNELS, mirrored, move_order
from marouting.config import build
from marouting.game import NOBODY, Ending, Status
from marouting.player import Player
from marouting.vector import BatchEnv
from policies.learned.config import Config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run

ALL: dict[str, Any] = {
    "observation": {"kind": "window", "radius": 1, "channels": list(CHANNELS)},
    "message_bits": 1,
}
"""Options of games whose agents see all channels."""


# --- the oracle -----------------------------------------------------------------------------------


def blocks(engine: Engine, window: WindowObservation, m: int, n: int) -> dict[str, NDArray[Any]]:
    """What agent n of problem m sees, block by block."""
    problem, agent = engine.problems[m], engine.agents[m, n]
    sides = problem.grid
    here, target = gcell(engine, agent["cell"]), gcell(engine, agent["target"])
    sign = [1 if target[axis] >= here[axis] else -1 for axis in (0, 1)]
    far = [sign[0] * (target[0] - here[0]), sign[1] * (target[1] - here[1]), target[2] - here[2]]
    mask = engine.masks(np.array([m]), np.array([n]))[0, :6].tolist()
    if mask == [1] * 6:  # also that of an agent which is boxed in
        from_here = [np.add(here, step) for step in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))]
        if (
            not all(0 <= a[0] < sides[0] and 0 <= a[1] < sides[1] for a in from_here)
            or sides[2] < 3
        ):
            mask = [0] * 6
    order = [0, 1, 2, 3, 4, 5]
    if sign[0] < 0:
        order[0], order[1] = 1, 0
    if sign[1] < 0:
        order[2], order[3] = 3, 2
    tasks = open_tasks(engine, m, n)
    numbers = [
        *sign,
        *map(squash, far),
        *(math.copysign(math.log2(1 + abs(d)) / 8, d) for d in far),
        *(mask[move] for move in order),
        1 - agent["steps"] / engine.max_steps,
        squash(len(tasks)),
    ]

    r, deep = window.radius, window.layers

    def at(i: int, j: int, k: int) -> Gcell | None:
        """The Gcell of the grid at a place of the window."""
        found = here[0] + sign[0] * i, here[1] + sign[1] * j, here[2] + k
        return found if all(0 <= a < side for a, side in zip(found, sides, strict=True)) else None

    others = [k for k in range(engine.nets.shape[1]) if k != n]
    taken = expected(engine, m, others)
    heads = [
        gcell(engine, engine.agents[m, k]["cell"])
        for k in others
        if engine.agents[m, k]["status"] == Status.ACTIVE
    ]
    used = np.unpackbits(engine.dynamic.used[m, n], bitorder="little")

    def seen(channel: str, edge: Edge) -> float:
        number = edge_number(problem, edge)
        remaining = int(engine.dynamic.remaining[m, number])
        track = max(int(engine.static.demand[m, n, edge[0][2]]), 1)
        if channel == "capacity":
            return squash(remaining // track)
        if channel == "demand":
            return squash((remaining - taken[edge]) / track)
        if channel == "history":
            history = option_state(engine, Option.HISTORY)
            return squash(history[m, number]) if history.shape[1] else 0.0
        return float(used[number])

    found = {"numbers": np.array(numbers)}
    kinds = {"capacity": "xy", "demand": "xy", "history": "xy", "own": "xyz"}
    for channel, axes in kinds.items():
        for axis, name in enumerate(axes):
            shape = [2 * r + 1, 2 * r + 1, 2 * deep + 1]
            shape[axis] += 1
            block = np.zeros(shape)
            for index in np.ndindex(*shape):
                end = np.array(index) - (r, r, deep)
                start = end.copy()
                start[axis] -= 1
                near, beyond = at(*start.tolist()), at(*end.tolist())
                if near is not None and beyond is not None:
                    block[index] = seen(channel, between(near, beyond))
            found[f"{channel}_{name}"] = block
    written = [
        (gcell(engine, other["cell"]), int(other["message"]))
        for other in engine.agents[m]
        if other["status"] == Status.ACTIVE
    ]
    for bit in range(window.message_bits):
        block = np.zeros((2 * r + 1, 2 * r + 1, 2 * deep + 1))
        for index in np.ndindex(*block.shape):
            place = at(index[0] - r, index[1] - r, index[2] - deep)
            block[index] = any(where == place and message >> bit & 1 for where, message in written)
        found[f"messages_{bit}"] = block
    for channel in ("pins", "heads"):
        block = np.zeros((2 * r + 1, 2 * r + 1, 2 * deep + 1))
        for index in np.ndindex(*block.shape):
            place = at(index[0] - r, index[1] - r, index[2] - deep)
            if place is not None and channel == "pins":
                block[index] = place in [end for _, end in tasks]
            elif place is not None:
                block[index] = squash(heads.count(place))
        found[channel] = block
    return found


def rows_of(engine: Engine, window: WindowObservation) -> NDArray[np.float32]:
    """(M · N, size) what everybody sees."""
    problems, agents = engine.pairs(everyone=True)
    out = np.full((len(agents), window.size), np.nan, np.float32)
    window.write(engine, problems, agents, out)
    return out


windows = st.builds(
    WindowObservation,
    st.integers(0, 3),
    st.integers(0, 2),
    st.lists(st.sampled_from(CHANNELS), unique=True, min_size=1).map(tuple),
    st.integers(1, 3),
)


rules = st.fixed_dictionaries(
    {
        "overflow": st.sampled_from(["forbidden", "allowed"]),
        "target": st.sampled_from(["pin", "tree"]),
        "next_pin": st.sampled_from(["listed", "nearest"]),
        "rip_up": st.sampled_from([None, {"rounds": 2}, {"rounds": 2, "choose": "agents"}]),
        "mask": st.fixed_dictionaries({"visited": st.booleans()}),
        "wait": st.booleans(),
        "message_bits": st.integers(0, 2),
    }
)


@given(
    contested(max_nets=5),
    windows,
    rules,
    st.booleans(),
    st.integers(0, 1000),
)
def test_every_number_is_as_the_oracle_says(
    problem: Problem, window: WindowObservation, rules: dict[str, Any], history: bool, seed: int
) -> None:
    engine = Engine([problem, problem], turn_order="round_robin", max_steps=7, **rules)
    rng = np.random.default_rng(seed)
    if history and rules["rip_up"]:
        past = option_state(engine, Option.HISTORY)
        past[...] = rng.integers(0, 9, past.shape)
    space = window.space([problem], rules["overflow"] == "allowed")
    for _ in range(3):
        rows = rows_of(engine, window)
        for row, m, n in zip(rows, *engine.pairs(everyone=True), strict=True):
            assert space.contains(row)
            if rng.random() < 0.5:
                continue  # the oracle takes its time
            answer = blocks(engine, window, m, n)
            for name, (where, shape) in window.layout.items():
                mine = row[where].reshape(shape)
                np.testing.assert_allclose(mine, answer[name], atol=3e-5, err_msg=name)
        for _ in range(rng.choice([1, 2, 5, 30])):
            engine.step(rng.integers(-1, engine.actions, engine.nets.shape))


def test_long_columns_are_as_the_oracle_says() -> None:
    """Kernels count down the numbers of a column in the bits of one word."""
    problem = generate(1, grid=(3, 80, 1), nets=12, capacity=3, seed=1)[0]
    window = WindowObservation(30, 0, ("capacity", "demand", "own", "pins", "heads"))
    engine, rng = Engine([problem], turn_order="round_robin"), np.random.default_rng(0)
    for _ in range(20):
        engine.step(rng.integers(0, 6, engine.nets.shape))
    for n, row in enumerate(rows_of(engine, window)):
        answer = blocks(engine, window, 0, n)
        for name, (where, shape) in window.layout.items():
            np.testing.assert_allclose(row[where].reshape(shape), answer[name], atol=3e-5)


def test_the_layout_of_a_row() -> None:
    window = WindowObservation(radius=1, layers=0, channels=("pins", "own"))
    assert window.layout == {
        "numbers": (slice(0, 16), (16,)),
        "own_x": (slice(16, 28), (4, 3, 1)),
        "own_y": (slice(28, 40), (3, 4, 1)),
        "own_z": (slice(40, 58), (3, 3, 2)),
        "pins": (slice(58, 67), (3, 3, 1)),
    }
    assert window.size == 67
    assert WindowObservation(0, 0, ("pins",)).size == 17


def test_a_small_example_by_hand() -> None:
    """Two nets on three Gcells in a row: one looks east, the other west."""
    nets = [
        Net("a", 0, (Pin(0, 0, 1), Pin(2, 0, 1)), 1),
        Net("b", 1, (Pin(2, 0, 1), Pin(0, 0, 1)), 1),
    ]
    problem = Problem((3, 1, 1), (0,), (4,), tuple(nets), (1,), (0,), (0,))
    engine = Engine([problem], turn_order="round_robin", nets={"order": "file"})
    window = WindowObservation(radius=2, layers=0, channels=("capacity", "demand", "pins", "heads"))
    for row, sign in zip(rows_of(engine, window), (1, -1), strict=True):
        assert row[:2].tolist() == [sign, 1]
        block = {name: row[at].reshape(shape) for name, (at, shape) in window.layout.items()}
        # Edges from −3 to 3 along x: the second to last two are there, four tracks each.
        middle = block["capacity_x"][:, 2, 0].tolist()
        assert middle == pytest.approx([0, 0, 0, 0.8, 0.8, 0])
        assert block["demand_x"][:, 2, 0].tolist() == pytest.approx([0, 0, 0, 0.75, 0.75, 0])
        assert block["pins"][:, 2, 0].tolist() == [0, 0, 0, 0, 1]
        assert block["heads"][:, 2, 0].tolist() == [0, 0, 0, 0, 0.5]
        assert not block["capacity_y"].any()
        assert not block["capacity_x"][:, [0, 1, 3, 4]].any()


# --- the mirror -----------------------------------------------------------------------------------


def mirror_of(problem: Problem, axes: tuple[bool, bool]) -> Problem:
    """The problem seen in a mirror, in x and/or in y."""

    def pin(p: Pin) -> Pin:
        at = [p.x, p.y]
        for axis in (0, 1):
            if axes[axis]:
                size = problem.grid[axis] * problem.tile[axis]
                at[axis] = 2 * problem.origin[axis] + size - 1 - at[axis]
        return Pin(at[0], at[1], p.layer)

    def end(x: int, y: int, z: int) -> Gcell:
        columns, rows, _ = problem.grid
        return (columns - 1 - x if axes[0] else x, rows - 1 - y if axes[1] else y, z)

    adjustments = [
        Adjustment(*end(a.x1, a.y1, a.layer1), *end(a.x2, a.y2, a.layer2), a.capacity)
        for a in problem.adjustments
    ]
    nets = [replace(net, pins=tuple(map(pin, net.pins))) for net in problem.nets]
    return replace(problem, nets=tuple(nets), adjustments=tuple(adjustments))


@examples(15)
@given(
    contested(max_nets=5, max_pins=2),
    st.sampled_from([(True, False), (False, True), (True, True)]),
    st.integers(0, 1000),
)
def test_a_mirrored_problem_looks_the_same(
    problem: Problem, axes: tuple[bool, bool], seed: int
) -> None:
    window = WindowObservation(2, 1, CHANNELS)
    plain, turned = (
        Engine([p], turn_order="round_robin", max_steps=9)
        for p in (problem, mirror_of(problem, axes))
    )
    rng = np.random.default_rng(seed)
    swap = np.arange(6) ^ np.repeat([*axes, False], 2)
    for _ in range(8):
        position = plain.static.position
        agents = plain.agents[0]
        far = position[agents["target"]] - position[agents["cell"]]
        # Where the target is straight ahead, the window is not mirrored.
        clear = ((far[:, 0] != 0) | (not axes[0])) & ((far[:, 1] != 0) | (not axes[1]))
        one, other = rows_of(plain, window), rows_of(turned, window)
        np.testing.assert_array_equal(one[clear, 2:], other[clear, 2:])
        for axis in (0, 1):
            assert (one[clear, axis] == (-1 if axes[axis] else 1) * other[clear, axis]).all()
        moves = rng.integers(0, 6, plain.nets.shape)
        plain.step(moves)
        turned.step(swap[moves])


def test_moves_of_the_window_lead_to_the_target() -> None:
    """Where its +x and +y are free and the target is not reached, they come nearer to it."""
    problems = generate(20, grid=(6, 6, 1), nets=5, capacity=9, reduced_edges=0, seed=2)
    env = BatchEnv(problems, observation={"kind": "window", "radius": 0, "channels": ["own"]})
    obs, info = env.reset()
    moved = 0
    for _ in range(20):
        np.testing.assert_array_equal(
            np.take_along_axis(info["action_mask"], move_order(obs), -1)[info["active"]],
            obs[..., 8:14][info["active"]],
        )
        ahead = np.where(obs[..., 2] > 0, 0, 2)
        ahead[~info["active"]] = NOBODY
        before, asked = obs.copy(), info["active"].copy()
        moves = mirrored(ahead, obs)
        np.testing.assert_array_equal(mirrored(moves, obs), ahead)
        assert (moves[~asked] == NOBODY).all()
        obs, *_, info = env.step(moves)
        goes_on = asked & (info["task_ended"] == 0)
        assert (obs[goes_on, 2:4].sum(axis=1) < before[goes_on, 2:4].sum(axis=1)).all()
        assert (info["task_ended"] != 2).all()
        moved += int(goes_on.sum())
    assert moved > 100
    assert mirrored(np.array([0, 1, 2, 3, 4, 5, -1]), np.tile([-1.0, 1.0], (7, 1))).tolist() == [
        1, 0, 2, 3, 4, 5, -1,
    ]  # fmt: skip


# --- any grid -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grid", "capacity"),
    [((2, 1, 1), 0), ((1, 2, 4), 3), ((8, 8, 2), 5), ((33, 17, 9), 10**6), ((33, 17, 9), 1)],
)
@pytest.mark.parametrize("overflow", ["forbidden", "allowed"])
def test_one_shape_for_every_grid(grid: Gcell, capacity: int, overflow: Any) -> None:
    rng = np.random.default_rng(1)
    columns, rows, layers = grid
    nets = [
        Net(f"n{i}", i, tuple(Pin(*rng.integers((0, 0, 1), (columns, rows, layers + 1)).tolist())
                              for _ in range(4)), int(rng.integers(1, 4)))
        for i in range(30)
    ]  # fmt: skip
    nets.append(Net("ends", 30, (Pin(0, 0, 1), Pin(columns - 1, rows - 1, layers))))
    problem = Problem(
        grid, (capacity,) * layers, (capacity,) * layers, tuple(nets),
        (1,) * layers, (1,) * layers, (0,) * layers,
    )  # fmt: skip
    window = WindowObservation(3, 2, CHANNELS)
    space = window.space([problem], overflow == "allowed")
    assert space == window.space(generate(1), overflow=False)
    assert space.shape == (window.size,)
    engine = Engine([problem], overflow=overflow, turn_order="round_robin", max_steps=40)
    for _ in range(60):
        engine.step(rng.integers(0, 6, engine.nets.shape))
        rows_now = rows_of(engine, window)
        assert all(map(space.contains, rows_now))
        assert window.state_space([problem], overflow == "allowed").contains(
            window.state(engine)[0]
        )


def test_widths_scale_with_capacities() -> None:
    """Ten times the widths and ten times the capacities look the same."""

    def scaled(factor: int) -> Engine:
        problem = generate(1, nets=20, capacity=3, max_pins=3, seed=4)[0]
        wide = replace(
            problem,
            vertical_capacity=tuple(factor * c for c in problem.vertical_capacity),
            horizontal_capacity=tuple(factor * c for c in problem.horizontal_capacity),
            min_width=tuple(factor * w for w in problem.min_width),
            min_spacing=tuple(factor * w for w in problem.min_spacing),
            nets=tuple(replace(net, min_width=factor * net.min_width) for net in problem.nets),
            adjustments=tuple(
                a._replace(capacity=factor * a.capacity) for a in problem.adjustments
            ),
        )
        return Engine([wide], turn_order="round_robin")

    window, rng = WindowObservation(2, 1, CHANNELS), np.random.default_rng(0)
    one, ten = scaled(1), scaled(10)
    for _ in range(15):
        np.testing.assert_allclose(rows_of(one, window), rows_of(ten, window), atol=1e-4)
        np.testing.assert_allclose(window.state(one), window.state(ten), atol=1e-4)
        moves = rng.integers(0, 6, one.nets.shape)
        one.step(moves)
        ten.step(moves)


# --- up to date -----------------------------------------------------------------------------------


@examples(10)
@given(contested(max_nets=6), st.integers(0, 1000))
def test_the_past_of_an_engine_makes_no_difference(problem: Problem, seed: int) -> None:
    """Steps, resets, saved states, parts: the same as in an engine that just got there."""
    window, rng = WindowObservation(1, 1, CHANNELS), np.random.default_rng(seed)

    def engine_of(problems: list[Problem]) -> Engine:
        return Engine(problems, turn_order="round_robin", max_steps=5)

    engine = engine_of([problem] * 3)
    saved = engine.save()
    for _ in range(12):
        what = rng.integers(7)
        if what == 0:
            engine.reset(rng.integers(0, 2, 3).astype(bool))
        elif what == 1:
            saved = engine.save()
        elif what == 2:
            engine.restore(saved)
        else:
            engine.step(rng.integers(-1, 6, engine.nets.shape))
        fresh = engine_of([problem] * 3)
        fresh.restore(engine.save())
        np.testing.assert_array_equal(rows_of(engine, window), rows_of(fresh, window))
        np.testing.assert_array_equal(window.state(engine), window.state(fresh))
        part = engine.part(np.array([2, 0]))
        rows = rows_of(engine, window).reshape(3, -1, window.size)
        np.testing.assert_array_equal(
            rows_of(part, window).reshape(2, -1, window.size), rows[[2, 0]]
        )


def test_rows_in_any_order_and_rows_of_nobody() -> None:
    engine = Engine(generate(3, grid=(4, 4, 2), nets=4, seed=1), turn_order="round_robin")
    window, rng = WindowObservation(1, 1, CHANNELS), np.random.default_rng(0)
    engine.step(rng.integers(0, 6, engine.nets.shape))
    rows = rows_of(engine, window)
    problems, agents = engine.pairs(everyone=True)
    order = rng.permutation(len(agents))
    out = np.full((len(order) + 1, window.size), np.nan, np.float32)
    window.write(engine, np.append(problems[order], 1), np.append(agents[order], NOBODY), out)
    np.testing.assert_array_equal(out[:-1], rows[order])
    assert not out[-1].any()
    for bad in (engine.nets.shape[1], -2):
        with pytest.raises(ValueError, match="expected agents of the games"):
            window.write(engine, np.array([0]), np.array([bad]), out[:1])
    far = np.array([0, 2**32])  # in 32 bits it would be agent 0
    with pytest.raises(ValueError, match="expected numbers of 32 bits"):
        window.write(engine, np.array([0, 0]), far, out[:2])
    with pytest.raises(ValueError, match="expected integers for 2 rows of"):
        window.write(engine, problems[:1], agents[:1], out[:2])


# --- the global state -----------------------------------------------------------------------------


@examples(10)
@given(contested(max_nets=5), windows, rules, st.integers(0, 1000))
def test_the_state_is_as_the_oracle_says(
    problem: Problem, window: WindowObservation, rules: dict[str, Any], seed: int
) -> None:
    rules = {**rules, "overflow": "allowed"}
    engine = Engine([problem], turn_order="round_robin", max_steps=7, **rules)
    rng = np.random.default_rng(seed)
    for _ in range(rng.integers(0, 12)):
        engine.step(rng.integers(-1, engine.actions, engine.nets.shape))
    columns, rows, layers = problem.grid
    state = window.state(engine)[0]
    assert window.state_space([problem], overflow=True).contains(state)
    state = state.reshape(columns, rows, layers, -1)
    everyone = list(range(engine.nets.shape[1]))
    taken = expected(engine, 0, everyone)
    tasks = [open_tasks(engine, 0, n) for n in everyone]
    targets = [end for of in tasks for _, end in of]
    heads = [of[0][0] for of in tasks if of]
    messages = engine.agents["message"][0, [n for n in everyone if tasks[n]]].tolist()
    used = np.unpackbits(engine.dynamic.used[0], axis=1, bitorder="little").sum(axis=0)
    edges, past = set(all_edges(problem)), option_state(engine, Option.HISTORY)[0]
    for here in np.ndindex(columns, rows, layers):
        track = engine.static.demand[0, :, here[2]].mean() or 1.0
        answer: list[float] = []
        beyond = [
            between(here, (here[0] + dx, here[1] + dy, here[2] + dz))
            for dx, dy, dz in ((1, 0, 0), (0, 1, 0), (0, 0, 1))
        ]
        for channel in CHANNELS:
            if channel not in window.channels:
                continue
            if channel == "pins":
                answer.append(squash(targets.count(here)))
            elif channel == "heads":
                answer.append(squash(heads.count(here)))
            elif channel == "messages":
                there = [m for head, m in zip(heads, messages, strict=True) if head == here]
                for bit in range(window.message_bits):
                    answer.append(any(message >> bit & 1 for message in there))
            else:
                for edge in beyond[: 3 if channel == "own" else 2]:
                    if edge not in edges:
                        answer.append(0)
                        continue
                    number = edge_number(problem, edge)
                    remaining = engine.dynamic.remaining[0, number]
                    answer.append(
                        {
                            "capacity": lambda r=remaining, t=track: squash(r / t),
                            "demand": lambda r=remaining, e=edge, t=track: squash(
                                (int(r) - taken[e]) / Fraction(t)
                            ),
                            "history": lambda i=number: squash(past[i]) if len(past) else 0,
                            "own": lambda i=number: squash(used[i]),
                        }[channel]()
                    )
        np.testing.assert_allclose(state[here], answer, atol=3e-5)


def test_states_of_every_face() -> None:
    problem = generate(1, grid=(5, 4, 2), nets=6, seed=3)[0]
    expected_shape = (5, 4, 2 * 12)
    for make in (global_routing_v0.env, global_routing_v0.parallel_env):
        env = make(problem, **ALL)
        env.reset()
        assert env.state_space.shape == env.state().shape == expected_shape
        assert env.state_space.contains(env.state())
    batch = BatchEnv([problem] * 3, **ALL)
    batch.reset()
    assert batch.single_state_space.shape == expected_shape
    np.testing.assert_array_equal(batch.state()[1], env.state())
    default = BatchEnv([problem])
    default.reset()
    assert default.state().shape == (1, 5, 4, 10)


# --- the player -----------------------------------------------------------------------------------


class Watchful:
    """A window, and whatever else tells moments of a game apart."""

    def __init__(self) -> None:
        self.window = WindowObservation(1, 1, CHANNELS)
        self.calls = 0

    def space(self, problems: Any, overflow: bool) -> Box:
        size = self.window.space(problems, overflow).shape[0] + 5
        return Box(-np.inf, np.inf, (size,), np.float32)

    def write(
        self, engine: Engine, problems: NDArray[Any], agents: NDArray[Any], out: NDArray[Any]
    ) -> None:
        self.calls += 1
        self.window.write(engine, problems, agents, out[:, :-5])
        game = engine.games[problems]
        out[:, -5], out[:, -4], out[:, -3] = game["active"], game["agent"], game["steps"]
        out[:, -2] = engine.agents["status"].sum(axis=1)[problems]
        out[:, -1] = engine.agents["cell"].sum(axis=1)[problems]


class ByTurns(PaperReward):
    """The paper's reward, not known as such: the player asks it after every move."""


@examples(15)
@given(
    contested(max_nets=6),
    st.booleans(),
    st.sampled_from(["sequential", "round_robin"]),
    rules,
    st.integers(0, 1000),
)
def test_compiled_moves_and_moves_by_turns_are_the_same(
    problem: Problem, everyone: bool, order: Any, rules: dict[str, Any], seed: int
) -> None:
    other = generate(1, grid=problem.grid, nets=2, seed=seed, reduced_edges=0)[0]
    prices: dict[str, Any] = {"own_edge": -0.5, "overflow_price": 2.0}
    players = [
        Player(
            Engine([problem, other, problem], turn_order=order, max_steps=4, **rules),
            Watchful(),
            reward,
            everyone=everyone,
        )
        for reward in (PaperReward(**prices), ByTurns(**prices))
    ]
    fast, slow = players
    assert fast.fast.pays_prices
    assert not slow.fast.pays_prices
    rng = np.random.default_rng(seed)
    for player in players:
        player.reset()
    overs = 0
    for step in range(50):
        actions = rng.integers(-1, fast.engine.actions, fast.buffers.actions.shape)
        asked = fast.buffers.agents.copy()
        calls = fast.observation.calls
        for player in players:
            player.buffers.actions[:] = actions
            player.step(restart=step > 10)
        assert fast.observation.calls - calls <= 2
        overs += int(fast.buffers.over.sum())
        left = fast.buffers.agents != asked
        ended = (fast.buffers.ending != Ending.NONE) | (fast.buffers.acted & left & (not everyone))
        for name in fast.buffers._fields:
            of: Any = ended if name in ("final_obs", "final_mask") else ...
            mine, theirs = (getattr(player.buffers, name)[of] for player in players)
            np.testing.assert_array_equal(mine, theirs, err_msg=name)
        for name in ("cell", "target", "task", "steps", "joined", "status"):
            np.testing.assert_array_equal(*(player.engine.agents[name] for player in players))
        np.testing.assert_array_equal(*(player.engine.games for player in players))
        np.testing.assert_array_equal(*(player.engine.dynamic.used for player in players))
    if step > 40 and everyone and order == "round_robin" and not rules["rip_up"]:
        assert overs


def test_what_arrived_is_seen_before_anybody_settles() -> None:
    """The last net to arrive still counts itself as active, in either way of playing."""
    net = Net("a", 0, (Pin(0, 0, 1), Pin(1, 0, 1)))
    problem = Problem((2, 1, 1), (0,), (1,), (net,), (1,), (0,), (0,))
    for reward in (PaperReward(), ByTurns()):
        for everyone in (True, False):
            player = Player(Engine([problem]), Watchful(), reward, everyone=everyone)
            player.reset()
            player.buffers.actions[:] = 0
            player.step()
            assert player.buffers.terminated.all()
            assert player.buffers.final_obs[0, 0, -5:].tolist() == [1, 0, 1, Status.ACTIVE, 1]
            assert player.engine.games[0]["active"] == 0


@pytest.mark.parametrize("everyone", [True, False])
def test_threads_and_copies_of_a_batch(everyone: bool) -> None:
    problems = generate(5, grid=(4, 4, 2), nets=5, seed=1)

    def walk(threads: int, cut: bool) -> list[Any]:
        env = BatchEnv(problems, everyone=everyone, threads=threads, max_steps=6, **ALL)
        rng, shown = np.random.default_rng(0), [env.reset()[0].copy()]
        for step in range(30):
            if cut and step == 15:
                env = copy.deepcopy(env)
            obs, reward, *_ = env.step(rng.integers(0, 12, (5, shown[0].shape[1])))
            shown += [obs.copy(), reward.copy(), env.state().copy()]
        return shown

    plain = walk(1, cut=False)
    for one, other in zip(plain * 2, [*walk(3, cut=False), *walk(2, cut=True)], strict=True):
        np.testing.assert_array_equal(one, other)


# --- faces, trainings -----------------------------------------------------------------------------


@pytest.fixture
def no_warnings() -> Iterator[None]:
    """Every warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.usefixtures("no_warnings")
@pytest.mark.parametrize("persists", [False, True])
def test_the_checks_of_pettingzoo(persists: bool) -> None:
    options: dict[str, Any] = {**ALL, "agents_persist": persists, "max_steps": 8}
    api_test(global_routing_v0.env(**options), num_cycles=100)
    parallel_api_test(global_routing_v0.parallel_env(**options), num_cycles=100)
    seed_test(lambda: global_routing_v0.env(**options), num_cycles=20)
    state_test(global_routing_v0.env(**options), global_routing_v0.parallel_env(**options))


def test_the_checks_of_gymnasium() -> None:
    env = gymnasium.make(marouting.ENVIRONMENT_ID, **ALL).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize(
    ("learner", "agents"),
    [
        ({"kind": "dqn", "burn_in_size": 50, "buffer_size": 500}, "single"),
        ({"kind": "dqn", "burn_in_size": 50, "buffer_size": 500}, "multi"),
        ({"kind": "ppo", "rollout": 64, "minibatch": 32}, "multi"),
        ({"kind": "ppo", "rollout": 64, "minibatch": 32, "critic": "central"}, "multi"),
    ],
    ids=["dqn-single", "dqn-multi", "ippo", "mappo"],
)
def test_trainings_take_it(learner: dict[str, Any], agents: str, tmp_path: Path) -> None:
    """One network for two problems, which then routes problems of other sizes."""
    raw = {
        "out": str(tmp_path / "run"),
        "env": {
            "problem": str(tmp_path / "problems"),
            "agents": agents,
            "observation": {"kind": "window", "radius": 1},
            "max_steps": 10,
        },
        "learner": {"network": {"kind": "mlp", "hidden": [16]}, **learner},
        "train": {"episodes": 3, "shared": True, "tensorboard": False, "figures": False},
    }
    (tmp_path / "problems").mkdir()
    for i, problem in enumerate(generate(2, grid=(4, 4, 2), nets=4, seed=1)):
        problem.write(tmp_path / "problems" / f"p{i}.gr")
    Run(build(Config, raw)).execute()
    policy = TrainedPolicy.load(tmp_path / "run" / "policy.pt")
    for grid in ((2, 2, 1), (9, 5, 4)):
        problem = generate(1, grid=grid, nets=3, seed=1, reduced_edges=0)[0]
        assert policy.solve(problem).solution.problem == problem


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": -1}, "radius: expected 0 to 30, found -1"),
        ({"radius": 31}, "radius: expected 0 to 30, found 31"),
        ({"radius": 1.5}, "radius: expected"),
        ({"layers": 17}, "layers: expected 0 to 16, found 17"),
        ({"message_bits": 0}, "message_bits: expected 1 to 8, found 0"),
        ({"channels": ["capacity", "capacity"]}, "channels: expected some of capacity, demand"),
        ({"channels": []}, "channels: expected some of capacity, demand"),
        ({"channels": ["wind"]}, "channels.0: expected"),
        ({"channels": 3}, "channels: expected"),
        ({"radios": 3}, "radios: unknown key; did you mean radius?"),
    ],
)
def test_options_that_cannot_be_had(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=r"^[^\n]*$") as caught:
        global_routing_v0.parallel_env(observation={"kind": "window", **options})
    assert message in str(caught.value)


def test_options_given_in_python_are_checked_alike() -> None:
    for options in ({"radius": "2"}, {"channels": ("wind",)}, {"layers": -1}):
        with pytest.raises(InputError, match=rf"^{next(iter(options))}(\.0)?: expected"):
            WindowObservation(**options)  # type: ignore[arg-type]


def test_windows_that_do_not_fit_into_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAROUTING_MAX_GIB", "0.2")
    with pytest.raises(InputError, match=r"^500 observations of \d+ numbers: expected to take"):
        global_routing_v0.parallel_env(
            problem={"nets": 500}, observation={"kind": "window", "radius": 30, "layers": 3}
        )
