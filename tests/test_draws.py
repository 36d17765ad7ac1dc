"""Games that play another problem in every episode, against games of one problem each."""

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from marouting import Engine, InputError, Problem, generate, scenarios
from marouting.batch.setup import Room
from marouting.game import NOBODY
from marouting.source import ProblemSampler, ProblemStream, load_problem
from marouting.vector import BatchEnv

SET = [
    problem
    for nets, pins, capacity in ((6, 3, 2), (3, 2, 1), (5, 4, 3))
    for problem in generate(2, (4, 4, 2), nets, max_pins=pins, capacity=capacity, seed=nets)
]
"""Problems of different sizes on one grid."""

LOOKS: dict[str, dict[str, Any]] = {
    "compiled": {},
    "half": {"observation": {"kind": "window", "radius": 1}},
    "turn by turn": {"reward": "test_env:TeamReward"},
    "window, turn by turn": {
        "observation": {"kind": "window", "channels": ["demand", "pins", "heads", "history"]},
        "reward": "test_env:TeamReward",
    },
}
TASKS = {"target": "tree", "next_pin": "nearest", "mask": {"visited": True}, "release_failed": True}
RULES: dict[str, dict[str, Any]] = {
    "paper": {},
    "rounds": {"rip_up": {"neighbours": 1}, **TASKS},
    "asked": {"rip_up": {"choose": "agents"}, "nets": {"decomposition": "steiner"}},
}


def shown(env: BatchEnv, info: dict[str, Any], *arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """All that an environment shows, copied."""
    figures = [info["final_info"][name] for name in sorted(info["final_info"])]
    rest = [info[name] for name in sorted(info) if name not in ("final_info", "problem")]
    return [array.copy() for array in (*arrays, *rest, *figures, env.state())]


def walk(env: BatchEnv, steps: int) -> tuple[list[list[NDArray[Any]]], list[list[str]]]:
    """What an environment shows on a random walk, and the names of the problems it plays."""
    rng = np.random.default_rng(1)
    seen, info = env.reset()
    found, played = [shown(env, info, seen)], [list(info.get("problem", ()))]
    for _ in range(steps):
        mask = info["action_mask"]
        chosen = (rng.random(mask.shape) * (mask + 0.2)).argmax(-1)
        *arrays, info = env.step(chosen)
        found.append(shown(env, info, *arrays))
        played.append(list(info.get("problem", ())))
    return found, played


def same(one: list[NDArray[Any]], other: list[NDArray[Any]]) -> bool:
    return len(one) == len(other) and all(map(np.array_equal, one, other))


STEP = ("agents", "action_mask", "active", "acted", "task_ended")
FIGURES = ("over", "overflow", "wirelength", "joined", "steps")


@pytest.mark.parametrize("everyone", [True, False])
@pytest.mark.parametrize("rules", RULES)
@pytest.mark.parametrize("look", LOOKS)
def test_an_episode_is_that_of_a_game_of_its_problem(look: str, rules: str, everyone: bool) -> None:
    """Step by step a game shows what a batch of its problem alone shows after the same moves."""
    options: dict[str, Any] = {"max_steps": 5, "everyone": everyone, **LOOKS[look], **RULES[rules]}
    env, named = BatchEnv(3, problem=SET, seed=4, **options), ProblemStream(SET).problems
    rng = np.random.default_rng(2)
    obs, info = env.reset()
    arrays: list[NDArray[Any]] = [obs]
    alone: list[Any] = [None] * 3
    begins, sizes, episodes = np.ones(3, np.bool_), set(), 0
    actions = np.zeros(info["agents"].shape, np.int8)
    while episodes < 10:
        for m in range(3):
            if begins[m]:
                alone[m] = BatchEnv([named[info["problem"][m]]], **options)
                first, own = alone[m].reset()
                expected, episodes = [first], episodes + 1
                sizes.add(alone[m].num_agents)
            rows = alone[m].num_agents if everyone else 1
            if not begins[m]:
                *expected, own = alone[m].step(actions[m : m + 1, :rows])
                ended = own["task_ended"][0] != 0
                for name in ("final_obs", "final_mask"):
                    assert np.array_equal(info[name][m, :rows][ended], own[name][0][ended])
            for one, other in zip(arrays, expected, strict=False):
                assert np.array_equal(one[m, :rows], other[0])
            for name in STEP:
                assert np.array_equal(info[name][m, :rows], own[name][0]), name
            for name in FIGURES:
                assert info[name][m] == own[name][0], name
            assert np.array_equal(env.state()[m], alone[m].state()[0])
            assert env.present[m].sum() == alone[m].num_agents
            # Rows of agents that are not there, or no longer.
            assert all(not array[m, rows:].any() for array in arrays)
            assert not info["active"][m, rows:].any()
            assert (info["action_mask"][m, rows:, :6] == 1).all()
            assert (info["agents"][m, rows:] == NOBODY).all()
        begins = info["over"].copy()
        mask = info["action_mask"]
        actions = (rng.random(mask.shape) * (mask + 0.2)).argmax(-1)
        *arrays, info = env.step(actions)
    assert len(sizes) > 1


SOURCES: dict[str, dict[str, Any]] = {
    "scenario": {"scenario": "toy-4x4-v0"},
    "split": {"scenario": "toy-4x4-v0", "split": "test"},
    "generator": {"problem": {"grid": [4, 4, 2], "nets": 4, "max_pins": 4, "seed": None}},
    "set": {"problem": SET},
    "one": {"problem": SET[0]},
}


@pytest.mark.parametrize("source", SOURCES)
def test_a_seed_gives_the_same_problems_for_any_number_of_threads(source: str) -> None:
    options: dict[str, Any] = {**SOURCES[source], "max_steps": 5}
    expected, played = walk(BatchEnv(5, seed=3, **options), 60)
    for threads in (2, 3, 8):
        found, names = walk(BatchEnv(5, seed=3, threads=threads, **options), 60)
        assert names == played
        assert all(map(same, found, expected))
    # Nor do the problems of a game depend on how many games there are.
    few = walk(BatchEnv(2, seed=3, **options), 60)[1]
    one, other = (
        list(dict.fromkeys(names[:1] for names in map(tuple, of))) for of in (few, played)
    )
    assert all(a == b for a, b in zip(one, other, strict=False))
    changed = len({tuple(names) for names in played})
    assert changed == 1 if source == "one" else changed > 5
    if source != "one":
        assert walk(BatchEnv(5, seed=4, **options), 0)[1] != played[:1]


def test_the_problems_are_those_of_their_names() -> None:
    env = BatchEnv(3, scenario="toy-4x4-v0", seed=1, max_steps=4)
    seen = set()
    for _ in range(5):
        _, info = env.reset()
        for name, problem in zip(info["problem"], env.engine.problems, strict=True):
            number = int(name.removeprefix("train_"))
            assert problem == next(scenarios.get("toy-4x4-v0").train(number))
            seen.add(number)
    assert len(seen) == 15
    env = BatchEnv(2, problem={"grid": [4, 4, 2], "nets": 4, "seed": None})
    _, info = env.reset()
    for name, problem in zip(info["problem"], env.engine.problems, strict=True):
        number = int(name.removeprefix("seed_"))
        assert problem == load_problem({"grid": [4, 4, 2], "nets": 4, "seed": number})
    toy = scenarios.get("toy-4x4-v0").problems("validation")
    env = BatchEnv(4, scenario="toy-4x4-v0", split="validation")
    _, info = env.reset()
    assert [toy[name] for name in info["problem"]] == list(env.engine.problems)


@pytest.mark.parametrize("look", LOOKS)
def test_a_copy_in_mid_episode_goes_on_with_the_same_problems(look: str) -> None:
    env = BatchEnv(3, scenario="toy-4x4-v0", seed=1, max_steps=4, threads=2, **LOOKS[look])
    _ = walk(env, 17)
    twin, kept = pickle.loads(pickle.dumps(env)), env.save()
    moves = np.random.default_rng(0).integers(0, 6, (40, *env.present.shape))

    def played(of: BatchEnv) -> list[Any]:
        found = []
        for move in moves:
            *arrays, info = of.step(move)
            found += [[*shown(of, info, *arrays), np.array(info["problem"])]]
        return found

    expected = played(env)
    assert len({tuple(found[-1]) for found in expected}) > 5
    assert all(map(same, played(twin), expected))
    env.restore(kept)  # back to problems that have been replaced
    assert all(map(same, played(env), expected))


def test_a_copy_knows_the_seeds_that_games_have_begun_with() -> None:
    env = BatchEnv(3, problem=SET, seed=1, max_steps=4)
    env.reset(seed=5)
    env.reset(seed=7, options={"reset_mask": np.array([False, True, False])})
    kept, now = env.save(), env.engine.problems
    names, problems = list(env.reset()[1]["problem"]), env.engine.problems
    env.restore(kept)
    for twin in (env, pickle.loads(pickle.dumps(env))):
        assert twin.engine.problems == now
        assert list(twin.reset()[1]["problem"]) == names
        assert twin.engine.problems == problems
        assert env.reset(seed=9)[1]["problem"][0] == BatchEnv(
            3, problem=SET, seed=9, max_steps=4
        ).reset()[1]["problem"][0]  # fmt: skip
        env.restore(kept)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"problems": SET, "problem": SET}, "problem: expected a number of games first"),
        ({"problem": {"nets": 3}}, r"problem: expected a number of games first, as in BatchEnv\(8"),
        ({"problems": 1, "problem": ""}, "problem: expected a file or a folder, found ''"),
        ({"problems": 1, "problem": ["a.gr", ""]}, "problem: expected a file or a folder, found"),
        ({"problems": 20_000, "problem": SET}, "number of games: expected 1 to 10000, found 20000"),
        ({"problems": 3}, "problems: expected a list of problems, or a problem or scenario"),
        ({"problems": 0, "problem": SET}, "number of games: expected 1 to 10000, found 0"),
        ({"problems": 3, "problem": SET, "seed": -1}, "seed: expected a whole number from 0"),
        ({"problems": 3, "problem": SET, "scenario": "toy-4x4-v0"}, "problem: expected none besi"),
        ({"problems": 2, "problem": {"seed": None, "count": 2}}, "problem.count: expected 1 with"),
        ({"problems": 2, "problem": [*SET, *generate(1, nets=2)]}, "problem: expected one grid s"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=f"^{said}"):
        BatchEnv(**arguments)


def test_games_that_draw_restore_only_games_that_draw() -> None:
    env = BatchEnv(2, problem=SET)
    other = BatchEnv(SET[:2])
    other.reset()
    with pytest.raises(ValueError, match="saved: expected the state of a game with this p"):
        env.restore(other.save())
    with pytest.raises(ValueError, match="saved: expected the state of a game with this p"):
        other.restore(env.save())


def test_a_batch_restores_only_its_own_games() -> None:
    env = BatchEnv(SET[:2])
    env.reset()
    games: list[Any] = [
        BatchEnv(SET[1:3]), BatchEnv(SET[:2], max_steps=9), BatchEnv(SET[:2], everyone=False),
        BatchEnv(SET[:2], observation="window"), BatchEnv(SET[:2], threads=2),
    ]  # fmt: skip
    for saved in (*(other.save() for other in games), [1], None):
        with pytest.raises(ValueError, match="saved: expected the state of a game with this p"):
            env.restore(saved)
    twin = BatchEnv(pickle.loads(pickle.dumps(SET[:2])))
    twin.restore(env.save())


# --- the engine -----------------------------------------------------------------------------------

PLACES = st.lists(st.tuples(st.integers(0, 2), st.sampled_from(SET)), min_size=1, max_size=8)


@given(PLACES, st.sampled_from(list(RULES.values())), st.booleans())
def test_a_replaced_problem_is_as_in_a_new_engine(
    places: list[tuple[int, Problem]], rules: dict[str, Any], parts: bool
) -> None:
    engine = Engine(SET[:3], room=Room.of(SET), **rules)
    held = list(SET[:3])
    for m, problem in places:
        engine.step(np.zeros(engine.agents.shape, np.int8))
        if parts:  # whoever replaces it, all that share the arrays play it
            engine.part(slice(m, m + 1)).replace(0, problem)
        else:
            engine.replace(m, problem)
        held[m] = problem
        engine.reset(np.arange(3) == m)
    engine.reset()
    fresh = Engine(held, room=Room.of(SET), **rules)
    assert engine.problems == fresh.problems
    assert np.array_equal(engine.nets, fresh.nets)
    for one, other in zip(engine.pairs(True), fresh.pairs(True), strict=True):
        assert np.array_equal(one, other)
    for name in ("capacity", "demand", "first", "order"):
        assert np.array_equal(getattr(engine.static, name), getattr(fresh.static, name))
    for m in range(3):
        first, end = fresh.static.first[m, [0, -1]]
        assert np.array_equal(engine.static.tasks[first:end], fresh.static.tasks[first:end])


def test_a_copied_part_leaves_the_engine_alone() -> None:
    engine = Engine(SET[:2], room=Room.of(SET))
    tasks, problems = engine.static.tasks.copy(), engine.problems
    engine.part(np.array([1])).replace(0, SET[4])
    assert np.array_equal(engine.static.tasks, tasks)
    assert engine.problems == problems


def test_problems_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="expected an engine with room for other problems"):
        Engine(SET[:1]).replace(0, SET[1])
    engine = Engine(SET[2:3], room=Room.of(SET[2:3]))
    before = engine.static.tasks.copy()
    with pytest.raises(InputError, match=r"expected at most 3 nets with 12 two-pin tasks"):
        engine.replace(0, SET[0])
    with pytest.raises(InputError, match="expected one grid shape, found another"):
        engine.replace(0, generate(1, nets=2)[0])
    with pytest.raises(InputError, match=r"expected at most 3 nets with 12 two-pin tasks"):
        Engine(SET[:1], room=Room.of(SET[2:3]))
    assert np.array_equal(engine.static.tasks, before)
    assert engine.problems == tuple(SET[2:3])


def test_a_limited_number_of_training_problems_is_made_once() -> None:
    stream = ProblemStream(None, "toy-4x4-v0", most=3)
    endless = ProblemStream(None, "toy-4x4-v0")
    sampler = ProblemSampler(stream, seed=1, games=8)
    played = {}
    for _ in range(6):
        sampler.begin_next(np.ones(8, np.bool_))
        played |= dict(zip(sampler.names, sampler.problems, strict=True))
        assert all(played[name] is problem for name, problem in stream._kept.values())
    assert set(played) == {"train_0", "train_1", "train_2"}
    for number in range(3):  # the same as those that are drawn without a limit
        assert played[f"train_{number}"] == endless.problem(number)[1]
    generated = ProblemStream({"nets": 3, "seed": None}, held_out=5, most=2)
    rng = np.random.default_rng(0)
    assert {generated.number(rng) for _ in range(40)} == {5, 6}
