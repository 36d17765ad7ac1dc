"""Arguments from Python: what is no whole number is refused, and nothing is read out of bounds."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marouting import (
    Engine,
    InputError,
    Net,
    PaperObservation,
    Pin,
    Problem,
    Solution,
    generate,
    global_routing_v0,
)
from marouting.generator import GeneratorOptions, Least
from marouting.gym_vector import GlobalRoutingVector
from marouting.problem.net import Adjustment
from marouting.rewards import MixedReward
from marouting.vector import BatchEnv

PROBLEM = generate(1, grid=(4, 4, 2), nets=3, reduced_edges=0)[0]
PINS = Pin(0, 0, 1), Pin(3, 3, 1)


def net(*pins: Any, **fields: Any) -> tuple[Net]:
    return (Net(**{"name": "a", "id": 1, "pins": pins or PINS, **fields}),)


@pytest.mark.parametrize("nothing", [1.5, 1.0, float("nan"), float("inf"), "1", None, 1j, b"1"])
@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("grid", lambda x: {"grid": (4, x, 2)}),
        ("origin", lambda x: {"origin": (x, 0)}),
        ("tile", lambda x: {"tile": (1, x)}),
        ("vertical_capacity", lambda x: {"vertical_capacity": (x, 1)}),
        ("min_width", lambda x: {"min_width": (1, x)}),
        ("pins", lambda x: {"nets": net((x, 0, 1), (3, 3, 1))}),
        ("pins", lambda x: {"nets": net((0, 0, x), (3, 3, 1))}),
        ("net a", lambda x: {"nets": net(id=x)}),
        ("net a", lambda x: {"nets": net(min_width=x)}),
        ("adjustments", lambda x: {"adjustments": (Adjustment(0, 0, 1, 1, 0, 1, x),)}),
        ("adjustments", lambda x: {"adjustments": (Adjustment(x, 0, 1, 1, 0, 1, 1),)}),
    ],
)
def test_numbers_of_a_problem_are_whole(field: str, values: Any, nothing: Any) -> None:
    with pytest.raises(InputError, match=f"^{field}: "):
        replace(PROBLEM, **values(nothing))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nets": net((0, 0), (3, 3, 1))}, "pins: expected 3 numbers each"),
        ({"nets": net((0, 0), (3, 3, 1, 1))}, "pins: expected 3 numbers each"),
        ({"nets": (None,)}, "nets: expected nets with names, found None"),
        ({"nets": net(name=5)}, "nets: expected nets with names"),
        ({"grid": (4, 4)}, "grid: expected 3 numbers"),
        ({"vertical_capacity": None}, "vertical_capacity: expected whole numbers, found None"),
    ],
)
def test_fields_of_a_problem_have_their_form(changes: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(PROBLEM, **changes)


def test_integers_of_any_type_are_integers() -> None:
    given = {
        "grid": [np.int64(4), np.uint8(4), 2],
        "vertical_capacity": np.array([0, 5]),
        "nets": list(PROBLEM.nets),
    }
    same = replace(PROBLEM, **given)
    assert same == replace(PROBLEM, vertical_capacity=(0, 5))
    assert hash(same.grid) == hash(PROBLEM.grid)
    assert {type(number) for number in same.vertical_capacity} == {int}


@pytest.mark.parametrize("edges", [[0.7], [1.0], ["0"], [True], [None], [2**70], [np.nan]])
def test_edges_of_a_solution_are_whole(edges: Any) -> None:
    with pytest.raises(InputError, match="solution, net A2: expected whole numbers of edges"):
        Solution(PROBLEM, [[], edges, []])


AGENTS: list[tuple[Any, Any]] = [
    ([0], [-2]),
    ([0], [3]),
    ([0], [2**40]),
    ([1], [0]),
    ([-1], [0]),
    ([0, 0], [0]),
    ([0], [0, 1]),
    ([0.0], [0]),
    ([0], [0.5]),
]


@pytest.mark.parametrize(("problems", "agents"), AGENTS)
def test_masks_and_observations_are_those_of_agents(problems: Any, agents: Any) -> None:
    engine = Engine([PROBLEM])
    pair = np.array(problems), np.array(agents)
    with pytest.raises(ValueError, match="expected"):
        engine.masks(*pair)
    with pytest.raises(ValueError, match="expected"):
        engine.masks(np.array([0]), np.array([0]), np.zeros((2, 6), np.int8))
    with pytest.raises(ValueError, match="expected"):
        PaperObservation().write(engine, *pair, np.zeros((1, 12), np.float32))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: global_routing_v0.env(reward=None), "reward: expected a name, .* found None"),
        (lambda: global_routing_v0.env(observation=None), "observation: expected a name"),
        (lambda: global_routing_v0.env(observation=object()), "an object that has space and write"),
        (lambda: global_routing_v0.env(reward=object()), "an object that has __call__"),
        (
            lambda: Engine([PROBLEM], max_steps=2.5),
            "max_steps: expected a whole number or null, found 2.5",
        ),
        (lambda: Engine(["a.gr"]), "problems: expected objects of class Problem, found 'a.gr'"),
        (lambda: BatchEnv("a.gr"), r"a list of Problem objects \(problem= .*; found 'a.gr'"),
        (
            lambda: BatchEnv(["a.gr"]),
            r"a list of Problem objects \(problem= .*; found 'a.gr'",
        ),
        (lambda: BatchEnv([PROBLEM], threads=1.5), "threads: expected a whole number from 1"),
        (lambda: BatchEnv([PROBLEM], autoreset="no"), "autoreset: expected true or false, found"),
        (lambda: BatchEnv([PROBLEM], play_once="no"), "play_once: expected true or false, found"),
        (lambda: BatchEnv([PROBLEM], everyone="no"), "everyone: expected true or false, found"),
        (lambda: BatchEnv([PROBLEM], render_mode="human"), "render_mode: expected null: a batch"),
        (
            lambda: BatchEnv([PROBLEM], mask={"in_observation": True}),
            "mask: expected no key but visited",
        ),
        (lambda: BatchEnv([PROBLEM], mask={"mask_key": "m"}), "mask: expected no key but visited"),
        (lambda: BatchEnv([PROBLEM], seed="x"), "seed: expected a whole number from 0, found 'x'"),
        (lambda: BatchEnv([PROBLEM]).reset(seed="a"), "seed: expected a whole number from 0"),
        (lambda: BatchEnv([PROBLEM]).reset(seed=-1), "seed: expected a whole number from 0"),
        (lambda: BatchEnv(True, problem=PROBLEM), "problem: expected a number of games first"),
        (lambda: BatchEnv(2.0, scenario="toy-4x4-v0"), "toy-4x4-v0, found 2.0"),
        (
            lambda: GlobalRoutingVector(1.5, problem=PROBLEM),
            "num_envs: expected a whole number from 1 to 10000, found 1.5",
        ),
        (lambda: GeneratorOptions(grid=(4.0, 4.0, 2.0)), "grid.0: expected a whole number"),
        (lambda: generate(1.5), "count: expected a whole number"),
        (lambda: generate(1, nets=2.5), "nets: expected a whole number"),
        (lambda: generate(1, seed=1.5), "seed: expected a whole number or null, found 1.5"),
    ],
)
def test_other_arguments(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


PLACES = [(0, 0, 1), (3, 3, 1)]
EDGE = (0, 0, 1, 1, 0, 1, 1)


@pytest.mark.parametrize(
    "pins",
    [
        [Pin(*place) for place in PLACES],
        PLACES,
        tuple(map(list, PLACES)),
        np.array(PLACES),
        [np.array(place, np.uint8) for place in PLACES],
    ],
)
@pytest.mark.parametrize("adjustments", [[EDGE], ([*EDGE],), np.array([EDGE])])
def test_rows_of_any_kind_are_records(pins: Any, adjustments: Any, tmp_path: Path) -> None:
    found = Net("a", 1, pins)
    assert found == Net("a", 1, PINS) == Net("a", 1, (pin for pin in pins))
    assert hash(found) == hash(Net("a", 1, PINS))
    assert {type(pin) for pin in found.pins} == {Pin}
    problem = replace(PROBLEM, nets=[found], adjustments=adjustments)
    expected = replace(PROBLEM, nets=net(), adjustments=(Adjustment(*EDGE),))
    assert problem == expected
    assert hash(problem) == hash(expected)
    assert repr(problem) == repr(expected)
    assert problem.capacity.tolist() == expected.capacity.tolist()
    problem.write(tmp_path / "a.gr")
    assert Problem.read(tmp_path / "a.gr") == problem


@pytest.mark.parametrize("pins", [5, None, PINS[0], [5], [None], [[[1], 2, 3]], [np.array(1.5)]])
def test_what_holds_no_pins_is_refused(pins: Any) -> None:
    with pytest.raises(InputError, match=r"a: expected pins, each \(x, y, layer\), found|^pins: "):
        replace(PROBLEM, nets=[Net("a", 1, pins)])


@pytest.mark.parametrize("rows", [5, None, [5], [(1, 2)], [(*EDGE[:6], 1.5)]])
def test_what_holds_no_adjustments_is_refused(rows: Any) -> None:
    with pytest.raises(InputError, match=r"^adjustments: expected"):
        replace(PROBLEM, adjustments=rows)


def test_options_from_lists_are_those_from_tuples() -> None:
    assert hash(Least(grid=[3, 3, 1])) == hash(Least(grid=(3, 3, 1)))  # type: ignore[arg-type]
    parts = [{"kind": "paper"}]
    assert MixedReward(parts) == MixedReward(tuple(parts))  # type: ignore[arg-type]
