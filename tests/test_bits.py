"""Rows of bits, wide and hashed, and games that are played with either."""

import contextlib
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from reference import contested, random_moves

import marouting
from marouting import Engine, Net, Pin, Problem, global_routing_v0
from marouting.batch import bits, setup
from marouting.config import build
from marouting.game import NOBODY
from marouting.kernels import compiled, wide
from marouting.vector import BatchEnv
from policies.generalist.outlook import OutlookObservation
from policies.generalist.walk import Walker
from policies.learned.config import Config
from policies.learned.trainer import Trainer
from policies.routers.heuristic import HeuristicRouter

ROWS, BYTES = 3, 40


@compiled
def change(rows: Any, m: int, row: int, number: int, how: int) -> int:
    """Changes rows and returns whether the number had been there."""
    had = wide(bits.has(rows, m, row, number))
    if how < 2:
        bits.put(rows, m, row, number, wide(how))
    elif how == 2:
        bits.set_byte(rows, m, row, number >> 3, number * 37 & 255)
    elif how == 3:
        bits.empty(rows, m, row)
    elif how == 4:
        bits.forget(rows, m)
    elif how == 5:
        bits.copy_row(rows, m, row, rows, m, (row + 1) % ROWS)
    return had


@compiled
def swap(rows: Any, others: Any, m: int, row: int) -> None:
    bits.swap_rows(rows, others, m, row)


changes = st.lists(
    st.tuples(
        st.integers(0, 1),
        st.integers(0, ROWS - 1),
        st.integers(0, 8 * BYTES - 1),
        st.sampled_from([0, 1, 1, 1, 1, 1, 1, 2, 2, 3, 4, 5]),
    ),
    max_size=300,
)


def changed(some: list[tuple[int, int, int, int]]) -> tuple[NDArray[Any], list[list[set[int]]]]:
    """Hashed rows after some changes, with the sets that they should hold."""
    rows = bits.longer(bits.make_rows(2, ROWS, BYTES, hashed=True), 3000)
    sets: list[list[set[int]]] = [[set() for _ in range(ROWS)] for _ in range(2)]
    for m, row, number, how in some:
        of, byte = sets[m], number >> 3
        assert change(rows, m, row, number, how) == (number in of[row])
        if how == 1:
            of[row].add(number)
        elif how == 2:
            of[row] = {other for other in of[row] if other >> 3 != byte}
            of[row] |= {8 * byte + bit for bit in range(8) if number * 37 >> bit & 1}
        elif how == 3:
            of[row] = set()
        elif how == 4:
            sets[m] = [set() for _ in range(ROWS)]
        elif how == 5:
            of[row] = set(of[(row + 1) % ROWS])
    return rows, sets


def content(rows: NDArray[Any]) -> list[list[set[int]]]:
    """What rows hold."""
    found: list[list[set[int]]] = [[set() for _ in range(ROWS)] for _ in range(2)]
    for m in range(2):
        pairs = list(zip(*(part.tolist() for part in bits.numbers_of(rows, m)), strict=True))
        assert pairs == sorted(set(pairs))
        for row, number in pairs:
            found[m][row].add(number)
    return found


@settings(deadline=None)
@given(changes, changes)
@example([(1, 2, 72, 1)], [(1, 2, 0, 1), (1, 2, 8, 1), (1, 2, 16, 1), (1, 2, 24, 1)])
def test_hashed_rows_are_sets(
    some: list[tuple[int, int, int, int]], more: list[tuple[int, int, int, int]]
) -> None:
    rows, sets = changed(some)
    assert content(rows) == sets
    others, other_sets = changed(more)
    swap(rows, others, 1, 2)
    sets[1][2], other_sets[1][2] = other_sets[1][2], sets[1][2]
    assert content(rows) == sets
    assert content(others) == other_sets
    bits.adopt(rows, others, np.array([True, False]))
    assert content(rows) == [other_sets[0], sets[1]]


def test_rows_without_room_say_so() -> None:
    rows = bits.make_rows(1, ROWS, BYTES, hashed=True)
    with pytest.raises(MemoryError, match="rows of bits without room"):
        change(rows, 0, 0, 5, 1)


# --- games ----------------------------------------------------------------------------------------


@contextlib.contextmanager
def hashing() -> Iterator[None]:
    """Every game has hashed rows, however small it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setup, "PER_NET", -1)
        patch.setattr(setup, "PER_EDGE", -1)
        yield


MOST: dict[str, Any] = {
    "target": "tree",
    "next_pin": "nearest",
    "mask_visited": True,
    "release_failed": True,
    "rip_up": {"rounds": 2, "choose": "history", "neighbours": 2},
    "overflow": "allowed",
    "max_steps": 12,
    "turn_order": "round_robin",
}
"""Every option that keeps rows of bits."""


def assert_alike(hashed: Engine, plain: Engine) -> None:
    """Asserts that two engines stand alike, whatever rows they have."""
    assert hashed.hashed
    assert not plain.hashed
    for name in ("remaining", "agents", "games", "numbers"):
        found, expected = getattr(hashed.dynamic, name), getattr(plain.dynamic, name)
        np.testing.assert_array_equal(found, expected, err_msg=name)
    for name in ("used", "sets"):
        for m in range(len(plain.games)):
            found, expected = (
                bits.numbers_of(getattr(engine.dynamic, name), m) for engine in (hashed, plain)
            )
            np.testing.assert_array_equal(found, expected, err_msg=name)
    assert hashed.solution() == plain.solution()


@settings(deadline=None, max_examples=25)
@given(contested(), st.integers(0, 2**32))
def test_games_with_hashed_rows_are_the_same(problem: Problem, seed: int) -> None:
    rng = np.random.default_rng(seed)
    plain = Engine([problem] * 2, **MOST)
    with hashing():
        hashed = Engine([problem] * 2, **MOST)
    saved = hashed.save(), plain.save()
    for k in range(60):
        moves = random_moves(plain, rng)
        for engine in (hashed, plain):
            engine.step(moves)
        assert_alike(hashed, plain)
        if k == 20:
            saved = pickle.loads(pickle.dumps(hashed.save())), plain.save()
            hashed, plain = hashed.part(np.array([1, 0])), plain.part(np.array([1, 0]))
    for engine, state in zip((hashed, plain), saved, strict=True):
        engine.restore(state)
    assert_alike(hashed, plain)
    which = np.array([True, False])
    for engine in (hashed, plain):
        engine.reset(which)
    assert_alike(hashed, plain)


def side_by_side(nets: int) -> Problem:
    """Nets on 256×256×2 Gcells, where a bit for each edge would be 48 KB."""
    pins = [
        (Pin(n % 256, n // 256 % 200, 1), Pin(n % 256, n // 256 % 200 + 9, 1)) for n in range(nets)
    ]
    return Problem(
        (256, 256, 2), (0, 99), (99, 0), tuple(Net(f"n{n}", n, own) for n, own in enumerate(pins)),
        (1, 1), (0, 0), (0, 0),
    )  # fmt: skip


def test_memory_goes_with_routed_edges() -> None:
    """20 000 nets that would take 1 GB with a bit for each edge, and three times that for sets."""
    engine = Engine([side_by_side(20_000)], **MOST)
    rng = np.random.default_rng(0)
    for _ in range(8):
        engine.step(random_moves(engine, rng))
    assert engine.metrics().wirelength > 50_000
    assert sum(array.nbytes for array in engine.in_use()) < 60e6
    assert sum(array.nbytes for array in engine.dynamic) < 300e6  # with what is free
    assert len(pickle.dumps(engine.save())) < 60e6
    assert engine.solution().uses[0].size == engine.metrics().wirelength


@pytest.mark.slow
def test_whatever_plays_does_so_with_hashed_rows() -> None:
    """Whole episodes in compiled loops, threads and pieces of one's own, each with both rows."""
    problems = marouting.generate(2, nets=15, max_pins=4, capacity=3, seed=3)

    def loop() -> tuple[Engine, ...]:
        seen = OutlookObservation(radius=1)
        asked = {**MOST["rip_up"], "choose": "agents"}
        engine = Engine(problems, **{**MOST, "turn_order": "sequential", "rip_up": asked})
        sizes = (seen.size, 16, 6)
        weights = np.random.default_rng(0).normal(size=17 * 6 + (seen.size + 1) * 16)
        cold, keys = np.zeros(2, np.float32), np.zeros(2, np.uint64)
        walker = Walker(engine, seen, sizes, weights.astype(np.float32) * 0.3, cold, keys)
        while not walker.walk(7):
            pass
        return (engine,)

    def batches() -> Iterator[Engine]:
        for more in ({}, {"threads": 2}, {"reward": "team"}, {"reward": "team", "threads": 2}):
            for options in ({}, MOST):
                env = BatchEnv(problems, **{**options, **more})
                _, info = env.reset()
                rng = np.random.default_rng(1)
                for _ in range(150):
                    draws = rng.random(info["action_mask"].shape) * info["action_mask"]
                    *_, info = env.step(np.where(info["active"], draws.argmax(-1), NOBODY))
                yield env.engine

    plain, plain_loop = list(batches()), loop()
    routed = [HeuristicRouter().route(problem) for problem in problems]
    env = global_routing_v0.parallel_env(problems[0])
    with hashing():
        for hashed, expected in zip([*batches(), *loop()], [*plain, *plain_loop], strict=True):
            assert_alike(hashed, expected)
        assert [HeuristicRouter().route(problem) for problem in problems] == routed
        hashed_env = global_routing_v0.parallel_env(problems[0])
    for each in (env, hashed_env):
        each.reset(seed=0)
        for k in range(30):
            _ = each.step(dict.fromkeys(each.agents, k % 6))
    with hashing():
        hashed_env = pickle.loads(pickle.dumps(hashed_env))
    assert_alike(hashed_env.engine, env.engine)


@pytest.mark.slow
def test_trainings_go_on_from_checkpoints_with_hashed_rows() -> None:
    problems = {f"p{m}": p for m, p in enumerate(marouting.generate(2, nets=20, seed=1))}
    config = build(Config, {"learner": {"fused": False}, "train": {"episodes": 3}})

    def train(*, broken_off: bool) -> Trainer:
        trainer = Trainer(problems, config)
        for k, _ in enumerate(trainer.run()):
            if broken_off and k == 8:
                state, trainer = trainer.state(), Trainer(problems, config)
                trainer.load_state(state, "")
                for _ in trainer.run():
                    pass
                break
        return trainer

    plain = train(broken_off=False)
    with hashing():
        hashed = train(broken_off=True)
    assert hashed.player.engine.hashed
    assert hashed.solutions() == plain.solutions()
