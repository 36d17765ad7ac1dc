"""Scenarios: their problems never change, are kept apart, and are known as well as is claimed."""

import copy
import hashlib
import itertools
import json
import pickle
import re
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import some_slow
from hypothesis import given
from hypothesis import strategies as st
from pettingzoo.test import api_test, parallel_api_test
from strategies import problems as any_problem

import marouting
from marouting import (
    ENVIRONMENT_ID,
    Field,
    InputError,
    Net,
    Pin,
    Problem,
    WindowObservation,
    evaluate,
    evaluate_policy,
    global_routing_v0,
    scenarios,
    sequential_astar,
)
from marouting.config import build
from marouting.gym_vector import GlobalRoutingVector
from marouting.registry import importing_from
from marouting.scenarios import (
    COOPERATION,
    PLANNING,
    RandomNets,
    Scenario,
    digest,
    mirror_digest,
    routable,
)
from marouting.scenarios.references import Best, path_of, read_references, references_in
from marouting.source import load_problem
from marouting.vector import BatchEnv
from marouting.yaml_files import parse_yaml
from policies.cli.main import status
from policies.experiment import anarchy
from policies.experiment.leaderboard import read_groups
from policies.experiment.references import (
    Effort,
    main,
    solve,
    solve_scenario,
)
from policies.experiment.result import summarise
from policies.learned.config import Config, config_of
from policies.learned.run import Run, problems_of
from policies.learned.trainer import Trainer
from policies.results.run_folder import read_rewards
from policies.routers.optimal import OptimalRouter
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

NAMES = scenarios.names()
FEASIBLE = [name for name in NAMES if not name.startswith("tight")]
SMALL = [name for name in FEASIBLE if name != "large-64x64-v0"]
"""Those whose optima take a moment to prove."""

every = pytest.mark.parametrize("name", NAMES)


def fixed(name: str) -> dict[str, Problem]:
    """The validation and the test problems of a scenario by their names."""
    scenario = scenarios.get(name)
    return {**scenario.problems("validation"), **scenario.problems("test")}


# Names -------------------------------------------------------------------------------------------


def test_names() -> None:
    assert NAMES[0] == "toy-4x4-v0"
    assert len(set(NAMES)) == len(NAMES) >= 8
    assert all(name.endswith("-v0") for name in NAMES)
    assert marouting.scenarios is scenarios
    for name in NAMES:
        scenario = scenarios.get(name)
        assert scenarios.get(name) is scenario
        assert scenario.name == name
        assert scenario.description.endswith(".")
        assert scenario.description.count(". ") <= 1


def test_an_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(InputError, match=r"^scenario: did you mean toy-4x4-v0\?"):
        scenarios.get("toy-4x4")
    with pytest.raises(InputError, match=r"expected one of toy-4x4-v0, two-pin.*found 'xyzzy'$"):
        scenarios.get("xyzzy")


@every
def test_the_problems_have_names(name: str) -> None:
    scenario = scenarios.get(name)
    for split, problems in (("validation", scenario.validation), ("test", scenario.test)):
        assert list(scenario.problems(split)) == [f"{split}_{i:03d}" for i in range(len(problems))]
        assert list(scenario.problems(split).values()) == problems
        assert all(problem.grid == scenario.grid for problem in problems)
    assert all(a is b for a, b in zip(scenario.test, scenario.test, strict=True))
    count = len(scenario.test)
    scenario.test.clear()
    assert len(scenario.test) == count >= 10


def test_splits_without_end_or_existence_are_refused() -> None:
    toy = scenarios.get("toy-4x4-v0")
    with pytest.raises(InputError, match=r"^split: expected validation or test, found train"):
        toy.problems("train")
    with pytest.raises(InputError, match=r"^split: expected validation or test, found 'tst'"):
        toy.problems("tst")  # type: ignore[arg-type]
    for seed in (-1, 1.0, None, "1"):
        with pytest.raises(InputError, match=r"^seed: expected a whole number from 0"):
            toy.train(seed)  # type: ignore[arg-type]


# Problems ----------------------------------------------------------------------------------------

DIGESTS = {
    "toy-4x4-v0": ("75bc954ee67010c2", "be474f0270418ee8", "9fde4f5b7523e1ed"),
    "two-pin-8x8-v0": ("3302b817d7a5115c", "c9e1e1036c4ccd63", "79278ce341c33968"),
    "paper-table2-row3-v0": ("765c2060233f359b", "86fe01ea3bb5879b", "a7879bab022279fc"),
    "multi-pin-8x8-v0": ("37da1c4c38c1ed70", "431db64b8e38bedd", "3d1d15700b24bde9"),
    "mixed-v0": ("c2a81d184acccaaf", "364a25138bb16a68", "0f28ce50f83fc328"),
    "large-64x64-v0": ("f1707dff51af4e50", "77d6f129782e6495", "ba7935b33c5e1e49"),
    "tight-16x16-v0": ("d01285e06abc9564", "67c3cca46be39948", "082415c9186f3699"),
    "tight-32x32-v0": ("4166a3c481b46238", "d66271c72ef43861", "20b4413a597669c0"),
    "gates-8x7-v0": ("ee17aedf629a49c6", "e91912e94461fee0", "2965620860e87a68"),
    "gates-2x-v0": ("0761434c8b5b35de", "d092e3733ff3fa74", "4be857d313dc8c30"),
    "gates-mixed-v0": ("197bb8efc2a89024", "f20dbc66e2f88aa5", "d817a7c5d20c1865"),
    "braess-v0": ("75f838df22155ca4", "7d65cc13be6a951f", "e8f77b090eb2851f"),
    "crossing-v0": ("cc1bdd72dd9ee458", "62870b966a4c0a8f", "d43adb3aca4f89ba"),
    "two-pin-once-8x8-v0": ("146dde958ef6ee39", "a04be8ec48fb8500", "b5851dcb6920c394"),
    "multi-pin-once-8x8-v0": ("29e8daf123933638", "42872b592d913c86", "c0ea9970c140554b"),
    "two-pin-once-32x32-v0": ("1294461af5910ae7", "fe720a5828d018f5", "3a3bddecbe8f7447"),
    "online-8x8-v0": ("c00816a1602e21f3", "0665eae5311238f7", "9f3a3d201547b658"),
}
"""SHA-256 of the exact problems of each scenario: validation, test, the first three of seed 0."""


def exact(problems: Sequence[Problem]) -> str:
    """A digest of all that the problems hold, names and coordinates too."""
    return hashlib.sha256(repr(list(problems)).encode()).hexdigest()[:16]


@every
def test_a_version_never_changes(name: str) -> None:
    """If this fails, results of the scenario have changed: it needs a new version."""
    scenario = scenarios.get(name)
    first = list(itertools.islice(scenario.train(0), 3))
    assert (exact(scenario.validation), exact(scenario.test), exact(first)) == DIGESTS[name]


def test_a_scenario_depends_on_nothing_but_its_parameters() -> None:
    toy = scenarios.get("toy-4x4-v0")
    options: dict[str, Any] = {"accept": routable, "mirrors": False}
    again = Scenario(toy.name, toy.generator, **options)
    assert next(again.train(5)) == next(toy.train(5))
    assert again.test == toy.test
    assert Scenario("toy-4x4-v1", toy.generator, **options).test != again.test


def test_training_problems_come_from_their_seed() -> None:
    toy = scenarios.get("toy-4x4-v0")
    first = list(itertools.islice(toy.train(3), 5))
    stream = toy.train(3)
    assert [next(stream) for _ in range(5)] == first
    assert list(itertools.islice(toy.train(np.int64(3)), 5)) == first
    assert next(toy.train(4)) != first[0]
    assert len({digest(problem) for problem in first}) == 5


@pytest.mark.parametrize("name", [scenario.name for scenario in PLANNING])
def test_random_nets_are_as_their_generator_says(name: str) -> None:
    scenario = scenarios.get(name)
    level = scenario.generator
    assert isinstance(level, RandomNets)
    drawn = [*scenario.validation, *scenario.test]
    nets = {len(problem.nets) for problem in drawn}
    assert set(range(level.nets[0], level.nets[1] + 1)) >= nets
    assert len(nets) > 1 or level.nets[0] == level.nets[1]
    pins = {len(net.pins) for problem in drawn for net in problem.nets}
    assert pins <= set(range(2, level.max_pins[1] + 1))
    assert level.max_pins[1] in pins
    capacity = {problem.horizontal_capacity[0] for problem in drawn}
    assert capacity == set(range(level.capacity[0], level.capacity[1] + 1))
    assert {len(problem.adjustments) for problem in drawn} == {level.reduced_edges}


ONE_NET = RandomNets(grid=(3, 2, 2), nets=(1, 1), max_pins=(2, 2), capacity=(1, 1))
"""There are 15 different problems: pairs of six Gcells."""


def one_net(validation: int = 4, test: int = 4, mirrors: bool = False) -> Scenario:
    """A scenario of so few problems that the held-out ones are drawn again and again."""
    return Scenario("one-net-v0", ONE_NET, validation=validation, test=test, mirrors=mirrors)


def test_held_out_problems_never_occur_in_training() -> None:
    scenario = one_net()
    held = [digest(problem) for problem in (*scenario.validation, *scenario.test)]
    assert len(set(held)) == 8
    # Without the promise, training problems would be drawn from among them.
    drawn = {digest(ONE_NET(np.random.default_rng(i))) for i in range(300)}
    assert len(drawn) == 15
    assert drawn > set(held)
    for seed in range(2):
        found = {digest(problem) for problem in itertools.islice(scenario.train(seed), 150)}
        assert found == drawn - set(held)


def mirrored(problem: Problem, *, columns: bool, rows: bool, exchanged: bool = False) -> Problem:
    """A problem whose columns or rows are reversed, and then exchanged, pin by pin."""
    (width, height, _), (wide, high) = problem.grid, problem.tile
    assert problem.origin == (0, 0)
    assert not exchanged or (wide, width) == (high, height)

    def place(x: int, y: int) -> tuple[int, int]:
        x, y = width - 1 - x if columns else x, height - 1 - y if rows else y
        return (y, x) if exchanged else (x, y)

    def moved(pin: Pin) -> Pin:
        x, y = place(pin.x // wide, pin.y // high)
        return Pin(x * wide, y * high, pin.layer)

    along, across = problem.horizontal_capacity, problem.vertical_capacity
    return replace(
        problem,
        horizontal_capacity=across if exchanged else along,
        vertical_capacity=along if exchanged else across,
        nets=tuple(replace(net, pins=tuple(map(moved, net.pins))) for net in problem.nets),
        adjustments=tuple(
            marouting.Adjustment(
                *place(a.x1, a.y1), a.layer1, *place(a.x2, a.y2), a.layer2, a.capacity
            )
            for a in problem.adjustments
        ),
    )


MIRRORS = [
    {"columns": columns, "rows": rows} for columns in (False, True) for rows in (False, True)
]


@pytest.mark.parametrize("name", ["gates-8x7-v0", "toy-4x4-v0", "paper-table2-row3-v0"])
def test_mirror_images_share_a_digest(name: str) -> None:
    problems = scenarios.get(name).test[:4]
    square = problems[0].grid[0] == problems[0].grid[1]
    own = set()
    for problem in problems:
        images = [mirrored(problem, **mirror) for mirror in MIRRORS]
        if square:
            images += [mirrored(problem, **mirror, exchanged=True) for mirror in MIRRORS]
        assert len(set(map(digest, images))) == len(images)
        assert {mirror_digest(image) for image in images} == {mirror_digest(problem)}
        own.add(mirror_digest(problem))
    assert len(own) == len(problems)


def test_mirror_images_of_held_out_problems_never_occur_in_training() -> None:
    scenario = one_net(2, 2, mirrors=True)
    held = [*scenario.validation, *scenario.test]
    images = {digest(mirrored(problem, **mirror)) for problem in held for mirror in MIRRORS}
    drawn = {digest(ONE_NET(np.random.default_rng(i))) for i in range(300)}
    found = {digest(problem) for problem in itertools.islice(scenario.train(0), 150)}
    assert found == drawn - images
    assert len(images) > 4
    # With mirror images allowed, they do occur.
    loose = one_net(2, 2)
    images = {
        digest(mirrored(problem, **mirror))
        for problem in (*loose.validation, *loose.test)
        for mirror in MIRRORS
    }
    assert images & {digest(problem) for problem in itertools.islice(loose.train(0), 150)}


@pytest.mark.parametrize("name", [scenario.name for scenario in COOPERATION])
@pytest.mark.parametrize("draws", some_slow((8, 20), (20,)))
def test_levels_for_policies_hold_mirror_images_out(name: str, draws: int) -> None:
    scenario = scenarios.get(name)
    held = [mirror_digest(problem) for problem in (*scenario.validation, *scenario.test)]
    assert len(set(held)) == len(held)
    drawn = itertools.islice(scenario.train(7), 50 * draws if name == "gates-8x7-v0" else draws)
    assert not set(held) & {
        digest(mirrored(problem, **mirror)) for problem in drawn for mirror in MIRRORS
    }


def test_a_scenario_with_too_few_problems_is_refused() -> None:
    scenario = one_net(5, 10)
    assert len({digest(p) for p in (*scenario.validation, *scenario.test)}) == 15
    with pytest.raises(InputError, match=r"^one-net-v0: .* that fit: 1000 of 1000 draws equal"):
        next(scenario.train(0))
    with pytest.raises(InputError, match="one-net-v0: the generator draws too few"):
        _ = one_net(16).validation


@every
def test_the_splits_are_disjoint(name: str) -> None:
    scenario = scenarios.get(name)
    held = list(map(digest, fixed(name).values()))
    assert len(set(held)) == len(held)
    count = 3 if name == "large-64x64-v0" else 15
    assert not set(held) & {digest(p) for p in itertools.islice(scenario.train(1), count)}


@pytest.mark.parametrize("name", FEASIBLE)
def test_training_problems_are_feasible(name: str) -> None:
    """By a router that the scenario does not use."""
    count = 1 if name == "large-64x64-v0" else 5
    router = PathfinderRouter(PathfinderOptions(seconds=3))
    for problem in itertools.islice(scenarios.get(name).train(2), count):
        judged = evaluate(problem, router.route(problem))
        assert judged.connected
        assert judged.overflow == 0


def test_infeasible_problems_are_not_kept() -> None:
    draw = RandomNets(grid=(4, 4, 2), nets=(6, 6), max_pins=(2, 2), capacity=(1, 1))
    raw = [draw(np.random.default_rng(i)) for i in range(12)]
    least = [OptimalRouter().solve(problem).overflow for problem in raw]
    assert 0 < sum(overflow > 0 for overflow in least) < 12
    # Whatever A* has proven feasible is; it may miss some.
    assert all(overflow == 0 for p, overflow in zip(raw, least, strict=True) if routable(p))
    assert any(map(routable, raw))
    scenario = Scenario("six-nets-v0", draw, validation=1, test=1, accept=routable)
    for problem in itertools.islice(scenario.train(0), 5):
        assert OptimalRouter().solve(problem).overflow == 0


# Digests -----------------------------------------------------------------------------------------


@given(any_problem(), st.data())
def test_a_digest_tells_what_is_to_be_routed(problem: Problem, data: st.DataObject) -> None:
    nets = data.draw(st.permutations(problem.nets))
    width, height = problem.tile

    def elsewhere(pin: Pin) -> Pin:
        """Another place in the same Gcell."""
        x = (pin.x - problem.origin[0]) // width * width + problem.origin[0]
        y = (pin.y - problem.origin[1]) // height * height + problem.origin[1]
        return Pin(
            x + data.draw(st.integers(0, width - 1)),
            y + data.draw(st.integers(0, height - 1)),
            pin.layer,
        )

    renamed = [
        Net(f"n{i}", i, tuple(map(elsewhere, data.draw(st.permutations(net.pins)))), net.min_width)
        for i, net in enumerate(nets)
    ]
    assert digest(replace(problem, nets=tuple(renamed))) == digest(problem)
    inside = Net("inside one Gcell".replace(" ", "_"), 1, (problem.nets[0].pins[0],) * 2)
    assert digest(replace(problem, nets=(*problem.nets, inside))) == digest(problem)


def test_digests_differ_where_routing_does() -> None:
    problem = scenarios.get("mixed-v0").test[0]
    first, *others = problem.nets
    wide = replace(first, min_width=2)
    moved = replace(first, pins=(*first.pins, Pin(1, 1, 3)))
    changed = [
        replace(problem, nets=(wide, *others)),
        replace(problem, nets=(moved, *others)),
        replace(problem, nets=tuple(others)),
        replace(problem, nets=(*problem.nets, replace(first, name="again"))),
        replace(problem, horizontal_capacity=(9, 0, 9)),
        replace(problem, adjustments=(marouting.Adjustment(0, 0, 1, 1, 0, 1, 0),)),
    ]
    assert len({digest(p) for p in (problem, *changed)}) == 1 + len(changed)


# References --------------------------------------------------------------------------------------


@every
def test_every_fixed_problem_has_a_reference(name: str) -> None:
    scenario, problems = scenarios.get(name), fixed(name)
    records = references_in(path_of(name)).references
    assert {record.problem for record in records.values()} == set(problems)
    for of, problem in problems.items():
        best = scenario.best(problem)
        overflow, wirelength, proven = scenario.reference(problem)
        assert (overflow, wirelength, proven) == (best.overflow, best.wirelength, best.proven)
        assert records[digest(problem)].problem == of
        assert proven == ((overflow, wirelength) == best.bound)
        assert best.bound <= (overflow, wirelength)
        assert best.how.startswith("solution by")
        assert best.seconds > 0
        if name in FEASIBLE:
            assert overflow == 0
        astar = evaluate(problem, sequential_astar(problem))
        assert (overflow, wirelength) <= (astar.overflow, astar.wirelength)


@pytest.mark.parametrize("name", ["toy-4x4-v0", "two-pin-8x8-v0", "paper-table2-row3-v0"])
def test_all_references_of_the_easy_ones_are_proven(name: str) -> None:
    assert all(record.proven for record in references_in(path_of(name)).references.values())


def check_proven(name: str, names: Sequence[str]) -> None:
    """Proves optima again, and compares."""
    for of in names:
        problem = fixed(name)[of]
        best = scenarios.get(name).best(problem)
        found = OptimalRouter(time_limit=20).solve(problem)
        assert best.bound <= (found.overflow, found.wirelength)
        assert (found.bound_overflow, found.bound_wirelength) <= (best.overflow, best.wirelength)
        if best.proven and found.status == "optimal":
            assert (found.overflow, found.wirelength) == (best.overflow, best.wirelength)


@pytest.mark.parametrize("name", SMALL)
def test_some_references_are_optimal(name: str) -> None:
    proven = [
        record.problem
        for record in references_in(path_of(name)).references.values()
        if record.proven
    ]
    check_proven(name, proven[:: max(len(proven) // 4, 1)])


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_all_references_are_optimal(name: str) -> None:
    check_proven(name, list(fixed(name)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tight-16x16-v0", "tight-32x32-v0"])
def test_no_solution_is_below_a_bound(name: str) -> None:
    """By negotiated congestion, which has no part in the bounds."""
    for problem in scenarios.get(name).test[:3]:
        routed = PathfinderRouter(PathfinderOptions(seconds=3, seed=7)).route(problem)
        judged = evaluate(problem, routed)
        assert scenarios.get(name).best(problem).bound <= (judged.overflow, judged.wirelength)


def test_a_reference_belongs_to_what_is_routed(tmp_path: Path) -> None:
    toy = scenarios.get("toy-4x4-v0")
    problem = toy.test[3]
    problem.write(tmp_path / "test_003.gr")
    assert toy.reference(Problem.read(tmp_path / "test_003.gr")) == toy.reference(problem)
    turned = replace(problem, nets=problem.nets[::-1])
    assert toy.reference(turned) == toy.reference(problem)
    for other in (next(toy.train(0)), scenarios.get("mixed-v0").test[0]):
        with pytest.raises(InputError, match=r"^problem: expected a validation or test problem of"):
            toy.reference(other)


def test_what_is_known_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "toy.json"
    assert read_references(path).references == {}
    good = path_of("toy-4x4-v0").read_text(encoding="utf-8")
    for bad, said in (
        ("{", "expected JSON"),
        ('{"references": 3}', "references"),
        (good.replace('"overflow": 0', '"overflow": -1', 1), "expected numbers from 0"),
        (good.replace('"wirelength": ', '"wirelength": 1.5, "x": ', 1), "wirelength|x: unknown"),
        (good.replace('"seconds": ', '"seconds": "1", "x": ', 1), "seconds|x: unknown"),
    ):
        path.write_text(bad, encoding="utf-8")
        with pytest.raises(InputError, match=said) as error:
            read_references(path)
        assert str(error.value).startswith(str(path))
    about: dict[str, Any] = {"how": "", "seconds": 1.0}
    for overflow, wirelength, bound in ((1, 5, (1, 6)), (1, 5, (2, 0)), (1, 5, (-1, 9))):
        with pytest.raises(InputError, match="bound of at most"):
            Best(
                problem="",
                overflow=overflow,
                wirelength=wirelength,
                bound_overflow=bound[0],
                bound_wirelength=bound[1],
                **about,
            )


def test_references_are_computed_once_and_only_get_better(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "two-pin-8x8-v0"
    best = {of: scenarios.get(name).best(problem) for of, problem in fixed(name).items()}
    monkeypatch.setattr(scenarios.get(name), "references", tmp_path / name)
    hasty = Effort(seconds=0)  # A* and the bound of nets alone
    steps = solve_scenario(name, hasty)
    first = next(steps)
    assert not first.proven
    assert read_references(tmp_path / name).references
    steps.close()
    assert len(read_references(tmp_path / name).references) == 1  # it goes on from here
    assert [record.problem for record in solve_scenario(name, hasty)] == list(fixed(name))[1:]
    assert list(solve_scenario(name, hasty)) == []
    better = next(solve_scenario(name, Effort(seconds=20), again=True))
    problem = fixed(name)["validation_000"]
    assert better.problem == first.problem == "validation_000"
    assert better.proven
    known = best["validation_000"]
    assert (known.overflow, known.wirelength) == (better.overflow, better.wirelength)
    assert better.seconds > first.seconds
    assert read_references(tmp_path / name).references[digest(problem)] == better


def test_a_worse_search_changes_nothing() -> None:
    toy = scenarios.get("toy-4x4-v0")
    router = OptimalRouter(time_limit=0)  # A* and the bound of nets alone
    of, problem, least = next(
        (of, problem, toy.best(problem))
        for of, problem in toy.problems("test").items()
        if router.solve(problem).overflow > 0
    )
    for bound in (0, least.wirelength):
        known = replace(
            references_in(path_of(toy.name)).references[digest(problem)], bound_wirelength=bound
        )
        found = solve(problem, of, Effort(0), known)
        assert (found.overflow, found.wirelength) == (least.overflow, least.wirelength)
        assert (0, bound) <= found.bound <= (least.overflow, least.wirelength)
        assert found.bound_wirelength > 0
        assert found.how.startswith("solution by optimal")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["toy"], "Error: scenario: did you mean toy-4x4-v0?"),
        (["--seconds", "-1"], "Error: --seconds: expected a number from 0"),
        (["--seeds", "-1"], "Error: --seeds: expected a number from 0"),
    ],
)
def test_the_command_says_what_is_wrong(arguments: list[str], said: str) -> None:
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 2
    assert done.output.startswith(said)
    assert done.output.count("\n") == 1


# Environments ------------------------------------------------------------------------------------

MAKERS: dict[str, Callable[..., Any]] = {
    "env": global_routing_v0.env,
    "raw_env": global_routing_v0.raw_env,
    "parallel_env": global_routing_v0.parallel_env,
    "gymnasium.make": lambda **options: gymnasium.make(ENVIRONMENT_ID, **options),
    "make, multi": lambda **options: marouting.make({"env": {**options, "agents": "multi"}}),
    "make, single": lambda **options: marouting.make({"env": options}),
}
makers = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)


def names_played(env: Any, episodes: int, seed: int | None = None) -> list[str]:
    """The names of the problems of some episodes."""
    names = []
    for _ in range(episodes):
        env.reset(seed=seed)
        seed = None
        names.append(env.unwrapped.problem_name)
    return names


@makers
def test_training_plays_a_new_problem_every_episode(make: Callable[..., Any]) -> None:
    env, other = make(scenario="toy-4x4-v0"), make(scenario="toy-4x4-v0", split="train")
    first = names_played(env, 6, seed=1)
    assert len(set(first)) == 6
    assert names_played(other, 6, seed=1) == first
    assert names_played(other, 6, seed=2) != first
    toy = scenarios.get("toy-4x4-v0")
    for _ in range(3):
        (name,) = names_played(env, 1)
        played = env.unwrapped.solution().problem
        assert played == next(toy.train(int(name.removeprefix("train_"))))
        with pytest.raises(InputError, match="expected a validation or test problem"):
            toy.reference(played)


@makers
@pytest.mark.parametrize("split", ["validation", "test"])
def test_the_other_splits_play_their_problems(make: Callable[..., Any], split: Any) -> None:
    env = make(scenario="toy-4x4-v0", split=split)
    problems = scenarios.get("toy-4x4-v0").problems(split)
    first = names_played(env, 8, seed=3)
    assert len(set(first)) > 3
    for name in first:
        assert problems[name].grid == (4, 4, 2)
    (name,) = names_played(env, 1)
    assert env.unwrapped.solution().problem is problems[name]
    assert names_played(env, 8, seed=3) == first


@makers
@pytest.mark.parametrize("split", scenarios.SPLITS)
def test_spaces_hold_for_all_problems_of_a_scenario(make: Callable[..., Any], split: str) -> None:
    env = make(scenario="mixed-v0", split=split, overflow="allowed")
    rng = np.random.default_rng(0)
    sizes = set()
    for seed in range(12):
        result = env.reset(seed=seed)
        problem = env.unwrapped.solution().problem
        sizes.add(len(problem.nets))
        for _ in range(30):
            if result is None:
                agents = [env.agent_selection]
                assert set(env.agents) <= set(env.possible_agents)
                seen = {agent: env.observe(agent) for agent in agents}
                env.step(None if any(env.last()[2:4]) else int(rng.integers(6)))
            elif isinstance(result[0], dict):
                assert set(env.agents) <= set(env.possible_agents)
                seen, *_ = env.step({agent: int(rng.integers(6)) for agent in env.agents})
            else:
                assert env.observation_space.contains(result[0])
                result = env.step(int(rng.integers(6)))
                seen = {}
            for agent, observation in seen.items():
                assert env.observation_space(agent).contains(observation)
        space = getattr(env.unwrapped, "state_space", None)
        assert space is None or space.contains(env.unwrapped.state())
    assert len(sizes) > 5


@pytest.mark.parametrize("persist", [False, True])
def test_pettingzoo_finds_nothing_wrong(persist: bool) -> None:
    options: dict[str, Any] = {"scenario": "mixed-v0", "agents_persist": persist, "max_steps": 9}
    api_test(global_routing_v0.env(**options), num_cycles=300)
    parallel_api_test(global_routing_v0.parallel_env(**options), num_cycles=60)


def test_spaces_and_agents_are_the_same_in_all_splits() -> None:
    envs = [global_routing_v0.parallel_env(scenario="mixed-v0", split=s) for s in scenarios.SPLITS]
    for env in envs:
        assert env.possible_agents == [f"net_{n}" for n in range(60)]
        assert env.observation_space("net_0") == envs[0].observation_space("net_0")
        assert env.state_space == envs[0].state_space


def test_spaces_hold_for_all_problems_of_a_generator_without_seed() -> None:
    """However many of the edges are reduced."""
    for edges in (0, 5, 17, 10_000):
        source = {
            "grid": (4, 4, 2), "nets": 3, "max_pins": 3, "capacity": 3, "seed": None,
            "reduced_edges": edges, "reduced_capacity": 1,
        }  # fmt: skip
        env = global_routing_v0.parallel_env(source)
        for seed in range(20):
            seen, _ = env.reset(seed=seed)
            assert env.agents == env.possible_agents
            assert env.state_space.contains(env.state())
            for agent, observation in seen.items():
                assert env.observation_space(agent).contains(observation)


@makers
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_with_the_same_problems(
    make: Callable[..., Any], copied: Callable[[Any], Any]
) -> None:
    env = make(scenario="mixed-v0")
    names_played(env, 2, seed=5)
    twin = copied(env)
    assert twin.unwrapped.solution().problem == env.unwrapped.solution().problem
    assert names_played(twin, 4) == names_played(env, 4)


def test_gymnasium_vectors() -> None:
    envs = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=3, scenario="toy-4x4-v0", split="test")
    _, infos = envs.reset(seed=4)
    again = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=3, scenario="toy-4x4-v0", split="test")
    assert list(infos["problem"]) == list(again.reset(seed=4)[1]["problem"])
    assert set(infos["problem"]) <= set(scenarios.get("toy-4x4-v0").problems("test"))
    envs.close()


def test_a_configuration_names_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "toy.yaml"
    path.write_text("env: {scenario: toy-4x4-v0, split: test, agents: multi}\n", encoding="utf-8")
    env = marouting.make(path)
    assert set(names_played(env, 3)) <= set(scenarios.get("toy-4x4-v0").problems("test"))


def test_batches_of_a_scenario() -> None:
    batch = BatchEnv(2, scenario="mixed-v0", seed=3, turn_order="sequential")
    _, info = batch.reset()
    for name, problem in zip(info["problem"], batch.engine.problems, strict=True):
        number = int(name.removeprefix("train_"))
        assert problem == next(scenarios.get("mixed-v0").train(number))
    assert batch.num_agents == 60  # of the largest
    twin = pickle.loads(pickle.dumps(batch))
    assert twin.engine.problems == batch.engine.problems
    assert BatchEnv(2, scenario="mixed-v0", seed=4).engine.problems != batch.engine.problems
    for split in ("validation", "test"):
        batch = BatchEnv(scenario="toy-4x4-v0", split=split)
        assert list(batch.engine.problems) == getattr(scenarios.get("toy-4x4-v0"), split)


GENERATED = marouting.generate(2, nets=3)


@pytest.mark.parametrize(
    ("problem", "options", "said"),
    [
        (GENERATED[0], {"scenario": "toy-4x4-v0"}, "problem: expected none beside a scenario"),
        (None, {"scenario": "toy-4x4-v1"}, r"scenario: did you mean toy-4x4-v0\?"),
        (None, {"scenario": "toy-4x4-v0", "split": "tst"}, "split: expected one of train, valid"),
        (None, {"split": "test"}, "split: expected a scenario beside it"),
        (None, {"scenario": 3}, "scenario: expected a text or null, found 3"),
    ],
)
@makers
def test_what_environments_refuse(
    make: Callable[..., Any], problem: Any, options: dict[str, Any], said: str
) -> None:
    given_problem = {} if problem is None else {"problem": problem}
    if problem is not None and make in (MAKERS["make, multi"], MAKERS["make, single"]):
        given_problem = {"problem": {"nets": 3}}  # configurations hold plain data
    with pytest.raises(InputError, match=rf"^(config: env: )?{said}"):
        make(**given_problem, **options)


@pytest.mark.parametrize(
    ("problems", "options", "said"),
    [
        (None, {}, "problems: expected a list of problems, or a scenario; found None"),
        (3, {}, "problems: expected a list of problems, or a problem or scenario as well; foun"),
        (None, {"scenario": "toy-4x4-v0"}, "problems: expected a number of games that draw from t"),
        (0, {"scenario": "toy-4x4-v0"}, "number of games: expected 1 to 10000, found 0"),
        (GENERATED, {"scenario": "toy-4x4-v0"}, "problems: expected a number of .* found a list"),
        (GENERATED, {"scenario": "toy-4x4-v0", "split": "test"}, "problems: expected none, or a "),
        (3, {"scenario": "toy-4x4-v0", "seed": -1}, "seed: expected a whole number from 0"),
        (GENERATED, {"split": "test"}, "split: expected a scenario beside it"),
    ],
)
def test_what_batches_refuse(problems: Any, options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=f"^{said}"):
        BatchEnv(problems, **options)


# Own scenarios ------------------------------------------------------------------------------------


def corridor(rng: np.random.Generator) -> Problem:
    """One to four nets through a wall with a gate."""
    field = Field(6, 4).wall(right_of=2).gate(right_of=2, row=int(rng.integers(4)), tracks=4)
    for start, end in rng.integers(4, size=(rng.integers(1, 5), 2)).tolist():
        field.net((0, start), (5, end))
    return field.problem()


@pytest.fixture
def own() -> Iterator[Scenario]:
    """A registered scenario, which is forgotten afterwards."""
    suggested = {
        "turn_order": "round_robin", "mask": {"visited": True}, "agents": "multi",
        "observation": {"kind": "window", "radius": 1},
    }  # fmt: skip
    yield scenarios.register("corridor-v0", corridor, validation=3, test=6, env=suggested)
    del scenarios._known["corridor-v0"]


def test_an_own_generator_is_a_scenario(own: Scenario) -> None:
    assert scenarios.get("corridor-v0") is own
    assert "corridor-v0" in scenarios.names()
    assert (len(own.validation), len(own.test), own.grid) == (3, 6, (6, 4, 1))
    assert next(own.train(3)) == next(own.train(3)) != next(own.train(4))
    env = global_routing_v0.parallel_env(scenario="corridor-v0")
    seen, _ = env.reset(seed=0)
    assert len(env.possible_agents) == max(len(p.nets) for p in (*own.validation, *own.test))
    assert seen["net_0"].shape == own_window(1)
    batch = BatchEnv(scenario="corridor-v0", split="test")
    assert list(batch.engine.problems) == own.test
    assert not batch.engine.static.sequential
    assert BatchEnv(5, scenario="corridor-v0").num_problems == 5
    config = config_of({"env": {"scenario": "corridor-v0"}, "learner": {"kind": "ppo"}})
    assert config.env.observation.options.radius == 1
    assert config.env.mask.visited


def own_window(radius: int, **options: Any) -> tuple[int, ...]:
    """The shape of what a window shows."""
    return (WindowObservation(radius=radius, **options).size,)


@pytest.mark.usefixtures("own")
def test_a_batch_leaves_out_what_a_scenario_suggests_for_other_interfaces() -> None:
    shown = {"mask": {"in_observation": True}, "agents": "single"}
    scenarios.register("corridor-v0", corridor, validation=3, test=6, env=shown)
    assert BatchEnv(2, scenario="corridor-v0", everyone=False, mask={"visited": True}).num_envs == 2
    assert GlobalRoutingVector(2, scenario="corridor-v0").num_envs == 2
    result = evaluate_policy(
        lambda _, masks: masks.argmax(-1), "corridor-v0", "validation", max_steps=5
    )
    assert result.problems == 3
    with pytest.raises(InputError, match=r"^mask: expected no key but visited"):
        BatchEnv(2, scenario="corridor-v0", everyone=False, mask={"in_observation": True})


@makers
@pytest.mark.usefixtures("own")
def test_options_that_a_scenario_suggests_can_be_changed(make: Callable[..., Any]) -> None:
    env = make(scenario="corridor-v0")
    assert env.unwrapped.game.rules.mask.visited
    assert not env.unwrapped.game.sequential
    changed = make(
        scenario="corridor-v0", turn_order="sequential", mask={"in_observation": True},
        observation={"radius": 2},
    )  # fmt: skip
    rules = changed.unwrapped.game.rules
    assert (rules.turn_order, rules.mask.visited, rules.mask.in_observation) == (
        "sequential", True, True,
    )  # fmt: skip
    assert make(scenario="corridor-v0", observation="paper").unwrapped is not None
    assert make(scenario="toy-4x4-v0").unwrapped.game.rules == make().unwrapped.game.rules


def first_free(_: Any, masks: np.ndarray) -> np.ndarray:
    """A policy: the first move that crosses an edge."""
    return masks.argmax(axis=1)


def test_the_options_of_a_scenario_play_any_problem() -> None:
    """Its key ``agents`` must fit the interface."""
    gates = scenarios.get("gates-8x7-v0")
    problem, other = gates.test[:2]
    for make in (global_routing_v0.env, global_routing_v0.parallel_env):
        env = make(problem=problem, **gates.env).unwrapped
        env.reset()
        same = make(scenario="gates-8x7-v0").unwrapped
        assert env.game.problem is problem
        assert env.game.rules == same.game.rules
        assert env.observation_space("net_0") == same.observation_space("net_0")
    batch = BatchEnv([problem, other], **gates.env)
    assert batch.single_observation_space == env.observation_space("net_0")
    single = {**gates.env, "agents": "single"}
    env = gymnasium.make(ENVIRONMENT_ID, problem=problem, **single).unwrapped
    assert env.game.problem is problem
    assert gymnasium.make_vec(ENVIRONMENT_ID, problem=problem, **single).num_envs == 1
    assert BatchEnv([problem], everyone=False, **single).num_agents == len(problem.nets)
    plain = marouting.evaluate_policy(first_free, "gates-8x7-v0", "validation")
    given = marouting.evaluate_policy(first_free, "gates-8x7-v0", "validation", **gates.env)
    assert given == plain
    for call, expected in (
        (lambda: gymnasium.make(ENVIRONMENT_ID, problem=problem, **gates.env), "single"),
        (lambda: gymnasium.make_vec(ENVIRONMENT_ID, problem=problem, **gates.env), "single"),
        (lambda: BatchEnv([problem], everyone=False, **gates.env), "single"),
        (lambda: BatchEnv([problem], **single), "multi"),
        (lambda: global_routing_v0.env(problem, **single), "multi"),
        (lambda: global_routing_v0.parallel_env(agents="many"), "multi"),
    ):
        with pytest.raises(InputError, match=f"^agents: expected {expected} in this interface, fo"):
            call()


def sized(rng: np.random.Generator) -> Problem:
    """Of any number of nets and any capacity."""
    field = Field(5, 5, capacity=int(rng.integers(1, 1000)))
    for _ in range(rng.integers(1, 30)):
        field.net((0, 0), *rng.integers(1, 5, size=(rng.integers(1, 4), 2)).tolist())
    return field.problem()


def test_training_problems_are_no_larger_than_the_fixed_ones() -> None:
    scenario = Scenario("sized-v0", sized, validation=2, test=2)
    fixed = [*scenario.validation, *scenario.test]
    for problem in itertools.islice(scenario.train(0), 20):
        assert len(problem.nets) <= max(len(p.nets) for p in fixed)
        assert problem.horizontal_capacity <= max(p.horizontal_capacity for p in fixed)
        pins = [sum(len(net.pins) for net in p.nets) for p in (problem, *fixed)]
        assert pins[0] <= max(pins[1:])
    free = [len(sized(np.random.default_rng(i)).nets) for i in range(100)]
    assert max(free) > max(len(p.nets) for p in fixed)


def test_draws_with_nothing_to_route_are_thrown_away() -> None:
    def seldom(rng: np.random.Generator) -> Problem:
        return Field(3, 3).net(*rng.integers(0, 3, size=(2, 2)).tolist()).problem()

    assert any(seldom(np.random.default_rng(i)).half_perimeters[0] == 0 for i in range(50))
    scenario = Scenario("seldom-v0", seldom, validation=5, test=5, mirrors=False)
    drawn = [*scenario.test, *scenario.validation, *itertools.islice(scenario.train(0), 20)]
    assert all(problem.half_perimeters[0] > 0 for problem in drawn)


@pytest.mark.usefixtures("own")
def test_what_own_scenarios_are_refused() -> None:
    for name in ("toy-4x4-v0", "", 3, "a:b", "a/b-v0", "a b-v0", ["a"]):
        with pytest.raises(InputError, match=r"^name: expected (another one: |letters, digits, )"):
            scenarios.register(name, corridor)  # type: ignore[arg-type]
    for env, said in (
        ({"max_stepz": 3}, "max_stepz: unknown key; did you mean max_steps?"),
        ({"max_steps": -3}, "max_steps: expected"),
        ({"mask": {"visited": 3}}, "mask.visited: expected true or false"),
    ):
        scenarios.register("corridor-v0", corridor, env=env)
        with pytest.raises(InputError, match=rf"^corridor-v0: env\.{re.escape(said)}"):
            global_routing_v0.parallel_env(scenario="corridor-v0")
    again = scenarios.register("corridor-v0", corridor, test=2)
    assert scenarios.get("corridor-v0") is again
    with pytest.raises(InputError, match=r"^max_steps: expected"):
        global_routing_v0.parallel_env(scenario="corridor-v0", max_steps=-3)

    def growing(rng: np.random.Generator) -> Problem:
        return Field(int(rng.integers(3, 99)), 4).net((0, 0), (1, 1)).problem()

    with pytest.raises(InputError, match=r"^none-v0: .* 0 of 1000 draws .* and 1000 have nothing"):
        _ = Scenario("none-v0", corridor, accept=lambda _: False).test
    with pytest.raises(InputError, match=r"^three-v0: generator: expected a Problem, found 3"):
        _ = Scenario("three-v0", lambda _: 3).test  # type: ignore[arg-type, return-value]
    with pytest.raises(InputError, match=r"^large-v0: largest: expected a Problem, found None"):
        _ = Scenario("large-v0", corridor, largest=lambda: None).grid  # type: ignore[arg-type,return-value]
    small = Scenario("small-v0", sized, largest=lambda: Field(5, 5).net((0, 0), (1, 1)).problem())
    for use in (lambda: small.test, lambda: next(small.train(0))):
        with pytest.raises(
            InputError, match=r"^small-v0: largest: expected a grid, nets, pins and"
        ):
            use()
    for call in (scenarios.get, lambda found: global_routing_v0.parallel_env(scenario=found)):
        with pytest.raises(InputError, match=r"^scenario: expected a name, found the object Scen"):
            call(again)
    with pytest.raises(InputError, match=r"^growing-v0: expected problems with one grid shape"):
        _ = Scenario("growing-v0", growing).test


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"validation": 0}, "validation: expected a number from 1 to 100000, found 0"),
        ({"validation": 1.5}, "validation: expected a whole number, found 1.5"),
        ({"test": True}, "test: expected a whole number, found True"),
        ({"open_cost": -5}, "open_cost: expected a number from 0 to 1e+09, found -5"),
        ({"open_cost": float("nan")}, "open_cost: expected a number, found nan"),
        ({"open_cost": "x"}, "open_cost: expected a number, found 'x'"),
        ({"mirrors": "x"}, "mirrors: expected true or false, found 'x'"),
        ({"env": {"split": "test"}}, "env: expected no key split: the scenario is what is play"),
        ({"references": 3}, "references: expected a path, found 3"),
        ({"training": 3}, "training: expected a mapping, found 3"),
        ({"accept": 3}, "accept: expected a function, found 3"),
        ({"description": 3}, "description: expected a text, found 3"),
        ({"env": {"agents": "x"}}, "env.agents: expected one of single, multi, found 'x'"),
    ],
)
def test_arguments_of_own_scenarios(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(said)}"):
        scenarios.register("arguments-v0", corridor, **options)
    assert "arguments-v0" not in scenarios.names()


@pytest.mark.parametrize("name", ["generator", "accept", "largest"])
def test_a_users_function_that_fails_is_named(name: str) -> None:
    functions: dict[str, Any] = {"generator": corridor, name: lambda _=None: 1 / 0}
    with pytest.raises(InputError, match=rf"^odd-v0: {name}: expected no error, found ZeroDivis"):
        _ = Scenario("odd-v0", **functions).grid


def test_a_generator_with_random_numbers_of_its_own_is_refused() -> None:
    own = np.random.default_rng(0)
    with pytest.raises(InputError, match=r"^odd-v0: generator: expected the same problem for the"):
        _ = Scenario("odd-v0", lambda _: sized(own)).test


def test_a_scenario_that_is_imported_stands_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("own_levels")
    for name in ("toy-4x4-v0", "clash-v0"):
        setattr(module, name[:3], Scenario(name, corridor))
    monkeypatch.setitem(sys.modules, "own_levels", module)
    for known in ("_known", "_imported"):
        monkeypatch.setattr(scenarios, known, dict(getattr(scenarios, known)))
    assert scenarios.load("own_levels:cla") is module.cla
    assert scenarios.get("clash-v0") is module.cla
    with pytest.raises(InputError, match=r"^scenario: own_levels:toy: expected a name that no oth"):
        scenarios.load("own_levels:toy")


def test_what_a_scenario_suggests_for_trainings_is_named(own: Scenario) -> None:
    for training, said in (({"stepz": 3}, "stepz: unknown key"), ({"games": 0}, "games: expected")):
        own.training = training
        with pytest.raises(InputError, match=rf"^corridor-v0: training: {said}"):
            config_of({"learner": "ippo", "env": {"scenario": "corridor-v0"}})


def test_own_references(own: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def first(_: Any, masks: Any) -> Any:
        return masks.argmax(axis=1)

    with pytest.raises(InputError, match=r"^corridor-v0: references: expected a file with them"):
        own.reference(own.test[0])
    assert not own.has_references("test")
    unknown = evaluate_policy(first, "corridor-v0")
    assert (unknown.cost, unknown.score, unknown.gap, unknown.compared) == (None, None, None, 0)
    assert all((row.reference, row.score, row.gap) == (None,) * 3 for row in unknown.rows)
    assert str(unknown).startswith("corridor-v0 test: no score without references, ")
    monkeypatch.setattr(own, "references", tmp_path / "corridor.json")
    assert len(list(solve_scenario("corridor-v0", Effort(seconds=20)))) == 9
    assert own.has_references("test")
    scored = evaluate_policy(first, "corridor-v0")
    assert scored.cost is not None
    assert scored.score is not None
    assert (scored.wirelength, scored.connected) == (unknown.wirelength, unknown.connected)
    for problem in own.test:
        overflow, wirelength, proven = own.reference(problem)
        assert (overflow, proven) == (0, True)
        assert own.cost(wirelength, 0) == wirelength
        assert own.cost(wirelength - 5, 1) == wirelength + 15


@pytest.mark.usefixtures("own")
def test_references_need_a_file_and_a_scenario() -> None:
    for name, expected in (
        ("corridor-v0", "corridor-v0: references: expected a file to write them to, in"),
        ("no_such_module:mine", "scenario: no_such_module:mine: there is no module no_such_module"),
        ("toy", "scenario: did you mean toy-4x4-v0? expected one of"),
    ):
        ran = CliRunner().invoke(main, [name])
        assert ran.exit_code == 2
        assert ran.stderr.count("\n") == 1
        assert f"Error: {expected}" in ran.stderr


OWN = """
from marouting import Field, scenarios


class Policy:
    options = {"observation": "window"}

    def moves(self, obs, masks):
        return masks.argmax(1)


def draw(rng):
    field = Field(5, 5)
    for start, end in rng.integers(5, size=(2, 2)).tolist():
        field.net((0, start), (4, end))
    return field.problem()


LANES = scenarios.Scenario(
    "lanes-v0", draw, validation=2, test=3, references="lanes.json", env={"mask": {"visited": True}}
)
BARE = scenarios.Scenario("bare-v0", draw, validation=2, test=3)
gates = scenarios.get("gates-8x7-v0")
GATES = scenarios.Scenario(
    "own-gates-v0", gates.generator, validation=8, test=2, references="gates.json", env=gates.env
)
"""
"""A module with a scenario."""


@pytest.fixture
def lanes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """``module:NAME`` of a scenario in a module in the working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    name = f"own_scenarios_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(OWN, encoding="utf-8")
    yield f"{name}:LANES"
    for own in ("lanes-v0", "bare-v0", "own-gates-v0"):
        scenarios._known.pop(own, None)
    scenarios._imported.clear()


def test_commands_take_scenarios_of_modules(lanes: str, capsys: pytest.CaptureFixture[str]) -> None:
    """With and without references; figures that need them are None, and one line says so."""
    benchmark = ["benchmark", "--scenario", lanes, "jobs=1"]
    routers = [word for name in ("local", "astar") for word in ("--router", name)]
    assert status([*benchmark, *routers, "--json"]) == 0
    told = capsys.readouterr()
    assert told.err.count("lanes-v0: no score and no gap without references; docs/") == 1
    for row in json.loads(told.out)["rows"]:
        assert [row[key] for key in ("score", "gap", "at_reference")] == [None] * 3
        assert row["wins"] + row["ties"] + row["losses"] == 3
        assert row["open"] == 0
    assert status([*benchmark, *routers]) == 0
    assert re.search(r"astar +\? +0 +0 +\? +\? +0/3/0 ", capsys.readouterr().out)
    with importing_from(Path.cwd()):
        list(solve_scenario(lanes, Effort(seconds=5)))
    scenarios._known.pop("lanes-v0")
    scenarios._imported.clear()
    assert status([*benchmark, "--router", "pathfinder", "--out", "later", "--json"]) == 0
    told = capsys.readouterr()
    assert "without references" not in told.err
    assert json.loads(told.out)["rows"][0]["score"]["mean"] == 1
    # A leaderboard scores all files by the best references that one of them knows.
    Path("later/lanes-v0.pathfinder.json").rename("runs/benchmark/lanes-v0.pathfinder.json")
    found = read_groups(Path("runs/benchmark"))["lanes-v0", "test"]
    assert sorted(result.name for result in found) == ["astar", "local", "pathfinder"]
    assert all(summarise(result)["score"] is not None for result in found)
    arguments = [
        "train", f"env.scenario={lanes}", "learner.kind=ippo", "train.steps=200", "train.games=2",
        "train.figures=false", "train.tensorboard=false", "out=run",
    ]  # fmt: skip
    assert status(arguments) == 0
    assert "lanes-v0 test: cost" in capsys.readouterr().out.replace(lanes, "lanes-v0")
    for file in (Path("lanes.json"), Path("run/result.json")):
        file.unlink()
    references_in.cache_clear()
    assert status(["train", "--resume", "run", "--allow-code"]) == 0
    assert "no score without references" in capsys.readouterr().out
    config = parse_yaml(Path("run/config.yaml").read_text(encoding="utf-8"), "config.yaml")
    assert config["env"]["scenario"] == lanes
    assert config["env"]["mask"]["visited"] is True


def test_references_of_a_scenario_in_a_module(lanes: str) -> None:
    with importing_from(Path.cwd()):
        ran = CliRunner().invoke(main, [lanes, "--seconds", "20"])
    assert ran.exit_code == 0, ran.output
    assert len(read_references(Path("lanes.json")).references) == 5
    assert ran.stderr.count("\n") == 5
    assert scenarios.load(lanes).reference(scenarios.get("lanes-v0").test[0]).proven
    assert scenarios.get("lanes-v0").has_references("test")
    whole = json.loads(Path("lanes.json").read_text(encoding="utf-8"))
    del whole["references"][digest(scenarios.get("lanes-v0").test[1])]
    Path("lanes.json").write_text(json.dumps(whole), encoding="utf-8")
    references_in.cache_clear()
    what = "lanes-v0: references: expected those of all problems, or none, found none of 1 of test"
    with pytest.raises(InputError, match=what):
        scenarios.get("lanes-v0").has_references("test")


def test_the_best_local_rule_of_a_scenario_in_a_module(
    lanes: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Policies can be benchmarked once it is known."""
    gates, own = (lanes.replace(":LANES", name) for name in (":GATES", ":Policy"))
    benchmark = ["benchmark", "--scenario", gates, "--router", own, "jobs=1", "--json"]
    with importing_from(Path.cwd()):
        for name in (lanes, gates):
            list(solve_scenario(name, Effort(seconds=5)))
        assert status(benchmark) == 2
        assert "policies.experiment.anarchy module:NAME" in capsys.readouterr().err
        ran = CliRunner().invoke(anarchy.main, [gates])
        assert ran.exit_code == 0, ran.output
        assert "own-gates-v0" in Path("gates.csv").read_text(encoding="utf-8")
        assert scenarios.get("own-gates-v0").has_local_rule("test")
        assert status(benchmark) == 0
        ran = CliRunner().invoke(anarchy.main, [lanes])  # where all rules are optimal
        assert "lanes-v0: expected problems on which every local rule costs more" in ran.output
        assert "or policies have nothing to learn; found rules that cost {" in ran.output
        assert "} (lanes.csv)" in ran.output
        assert "lanes-v0" in Path("lanes.csv").read_text(encoding="utf-8")
        for more in ([], ["--table"]):  # no file of references: nothing is looked up elsewhere
            ran = CliRunner().invoke(anarchy.main, [lanes.replace(":LANES", ":BARE"), *more])
            assert ran.exit_code == 2
            assert "bare-v0: scenario: expected one with a file of references" in ran.output


def test_policies_play_scenarios_of_modules(lanes: str) -> None:
    with importing_from(Path.cwd()):
        assert evaluate_policy(first_free, lanes).problems == 3


def test_scenarios_of_modules_in_python(lanes: str) -> None:
    with importing_from(Path.cwd()):
        env = global_routing_v0.parallel_env(scenario=lanes)
    env.reset(seed=0)
    assert env.unwrapped.game.rules.mask.visited
    assert scenarios.get("lanes-v0") is scenarios.get(lanes) is scenarios.load(lanes)
    assert BatchEnv(scenario="lanes-v0", split="test").num_problems == 3
    with pytest.raises(InputError, match=r"^scenario: os:getcwd: there is no scenario getcwd"):
        scenarios.load("os:getcwd")
    with pytest.raises(InputError, match=r"^scenario: no_such:THING: there is no module no_such"):
        scenarios.load("no_such:THING")
    with pytest.raises(InputError, match=r"^scenario: .*found 'os:getcwd'$"):
        scenarios.get("os:getcwd")  # which imports nothing


def test_files_name_no_module_unless_the_command_says_so(lanes: str) -> None:
    Path("own.yaml").write_text(f"env: {{scenario: '{lanes}'}}", encoding="utf-8")
    with pytest.raises(InputError, match=r"own\.yaml:1: env\.scenario: found code, .* --allow"):
        marouting.make("own.yaml")
    with importing_from(Path.cwd()):
        assert marouting.make("own.yaml", allow_code=True) is not None


# Trainings ---------------------------------------------------------------------------------------


def training(folder: Path, **env: Any) -> Config:
    """A very short training."""
    return config_of(
        {
            "out": str(folder),
            "env": env,
            "learner": {"kind": "dqn", "burn_in_size": 100, "buffer_size": 500},
            "train": {"episodes": 1, "figures": False, "tensorboard": False},
        }
    )


def test_a_training_takes_fixed_problems_side_by_side(tmp_path: Path) -> None:
    run = Run(training(tmp_path / "run", scenario="toy-4x4-v0", split="validation"))
    assert list(run.problems) == list(scenarios.get("toy-4x4-v0").problems("validation"))
    run.execute()
    kept = {path.stem for path in (tmp_path / "run" / "problems").glob("*.gr")}
    assert kept == set(run.problems)
    with pytest.raises(InputError, match=r"env\.split: expected 'validation'"):
        Run(training(tmp_path / "run", scenario="toy-4x4-v0", split="test"), resume=True)
    again = Run(training(tmp_path / "run", scenario="toy-4x4-v0", split="validation"), resume=True)
    assert again.problems == run.problems


def test_a_training_refuses_problems_without_end() -> None:
    for train in ({"games": 2}, {"shared": False}, {}):
        with pytest.raises(InputError, match=r"^train\.shared: expected true: "):
            build(Config, {"env": {"scenario": "toy-4x4-v0"}, "train": train})
    with pytest.raises(InputError, match=r"^train\.games: expected a number: these problems"):
        build(Config, {"env": {"scenario": "toy-4x4-v0"}, "train": {"shared": True}})


def test_a_training_draws_a_new_problem_for_every_episode(tmp_path: Path) -> None:
    config = training(tmp_path / "run", scenario="toy-4x4-v0", agents="multi", max_steps=9)
    train = replace(config.train, episodes=20, games=3, validation=4, evaluate_every=8)
    run = Run(replace(config, train=train))
    toy = scenarios.get("toy-4x4-v0")
    held = dict(list(toy.problems("validation").items())[:4])
    assert run.problems == held
    rows = run.execute()
    lines = (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    episodes = [json.loads(line) for line in lines]
    assert [row["episode"] for row in episodes] == list(range(20))
    names = [row["problem"] for row in episodes]
    assert len(set(names)) == 20
    assert all(name.startswith("train_") for name in names)
    assert not any(row["best"] for row in episodes)  # each problem is played once
    lines = (tmp_path / "run" / "evaluations.jsonl").read_text().splitlines()
    walks = [json.loads(line) for line in lines]
    assert {row["problem"] for row in walks} == set(held)
    assert walks[-1]["episodes"] == 20
    # The best network by validation is kept, and its routes are the solutions.
    figures = [(w["tasks"] - w["joined"], w["overflow"], w["wirelength"]) for w in walks]
    sums = np.array(figures).reshape(-1, 4, 3).sum(axis=1)
    scores = [tuple(of) for of in sums.tolist()]
    best = [w["best"] for w in walks[::4]]
    assert best == [all(score < before for before in scores[:i]) for i, score in enumerate(scores)]
    kept = max(i for i, improved in enumerate(best) if improved)
    for row in rows:
        assert row["router"] in ("astar", "dqn_policy")
        if row["router"] == "dqn_policy":
            walk = next(w for w in walks[4 * kept :] if w["problem"] == row["problem"])
            assert (walk["overflow"], walk["wirelength"]) == (row["overflow"], row["wirelength"])
            assert row["from"] == f"policy after {walk['episodes']} episodes, greedy"
    assert {row["problem"] for row in rows} == set(held)
    assert [*read_rewards(tmp_path / "run" / "metrics.jsonl")] == ["all"]


def test_a_generator_without_seed_holds_problems_out(tmp_path: Path) -> None:
    source = {"grid": [4, 4, 2], "nets": 3, "seed": None}
    config = training(tmp_path / "run", problem=source)
    train = replace(config.train, shared=True, games=2, validation=3)
    problems, episodes = problems_of(replace(config, train=train))
    assert episodes is not None
    assert list(problems) == ["seed_0", "seed_1", "seed_2"]
    for seed, problem in enumerate(problems.values()):
        assert problem == load_problem({**source, "seed": seed})

    class Least:
        """Draws the least number there is."""

        def integers(self, most: int) -> int:
            assert most == 10**9 - 3
            return 0

    assert episodes.number(Least()) == 3  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("train", "env", "said"),
    [
        ({"games": 2}, {}, "train.shared: expected true: games draw problems for one network"),
        ({"games": 0, "shared": True}, {}, "train.games: expected 1 to 1000000, found 0"),
        ({"validation": 3}, {}, "train.validation: expected null without train.games"),
        ({"games": 2, "shared": True, "validation": 21}, {"scenario": "toy-4x4-v0"},
         "train.validation: expected at most 20, those of the split, found 21"),
        ({"games": 2, "shared": True, "validation": 2}, {"problem": {"nets": 3}},
         "train.validation: expected null: a set is evaluated whole"),
        ({"games": 2, "shared": True}, {"problem": {"nets": 3, "seed": None, "count": 2}},
         "problem.count: expected 1 without a seed, found 2"),
        ({"device": None}, {"scenario": "toy-4x4-v0"}, "train.device: expected a text, found None"),
    ],
)  # fmt: skip
def test_what_trainings_cannot_draw(
    train: dict[str, Any], env: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=f"^{said}"):
        Run(build(Config, {"out": str(tmp_path / "run"), "train": train, "env": env}))
    assert not (tmp_path / "run").exists()


def test_drawn_problems_are_not_shown_by_solutions(tmp_path: Path) -> None:
    raw = {
        "out": str(tmp_path / "run"), "env": {"problem": {"nets": 3, "seed": None}},
        "train": {"games": 2, "shared": True}, "learner": {"kind": "dqn", "burn_in": "pathfinder"},
    }  # fmt: skip
    with pytest.raises(InputError, match=r"^learner.burn_in: expected astar or random with tr"):
        Run(build(Config, raw))
    config = build(Config, {**raw, "learner": {"kind": "dqn"}})
    with pytest.raises(InputError, match=r"^train\.games: expected null: its problems"):
        Trainer({"p": GENERATED[0]}, config)
