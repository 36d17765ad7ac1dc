"""The scenarios for policies: what they promise, and what local rules cost in them."""

import heapq
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from strategies import problems as any_problem

from marouting import (
    Field,
    InputError,
    Problem,
    evaluate,
    global_routing_v0,
    scenarios,
    sequential_astar,
)
from marouting.game import Game, Status
from marouting.problem.grid import OFF_GRID
from marouting.rules import Mask, Nets, Rules
from marouting.scenarios import COOPERATION
from marouting.scenarios.cooperation import Braess, Gates
from policies.experiment.anarchy import (
    DETOUR,
    FOLDER,
    NO_SHORT_CUT,
    RULES,
    SELFISH,
    Row,
    best_local,
    main,
    measure,
    read_rows,
    refused,
    rules_of,
)
from policies.routers.local import LocalRouter

NAMES = [scenario.name for scenario in COOPERATION]
LARGE = "two-pin-once-32x32-v0"

every = pytest.mark.parametrize("name", NAMES)
ONE_SHOT = Rules(turn_order="round_robin", mask=Mask(visited=True), release_failed=True)


def path_length(problem: Problem, start: int, end: int, least: int = 1) -> int | None:
    """Edges of a shortest path over edges with so many tracks; None if there is none."""
    grid, capacity = problem.topology, problem.capacity
    waiting, lengths = deque([start]), {start: 0}
    while waiting:
        cell = waiting.popleft()
        for edge, ahead in zip(grid.edge[cell], grid.neighbour[cell], strict=True):
            if ahead != OFF_GRID and capacity[edge] >= least and ahead not in lengths:
                lengths[int(ahead)] = lengths[cell] + 1
                waiting.append(int(ahead))
    return lengths.get(end)


# The levels --------------------------------------------------------------------------------------


@every
def test_levels_are_played_once_by_local_policies(name: str) -> None:
    env = global_routing_v0.parallel_env(scenario=name, split="test")
    rules = env.unwrapped.game.rules
    assert (rules.overflow, rules.rip_up, rules.release_failed) == ("forbidden", None, True)
    assert rules.mask.visited
    assert rules.turn_order == ("sequential" if name == "online-8x8-v0" else "round_robin")
    env.reset(seed=0)
    # What a window of radius 3 shows, and not what others are expected to take.
    options = scenarios.get(name).env["observation"]
    assert (options["kind"], options["radius"]) == ("window", 3)
    assert not {"demand", "history"} & set(options["channels"])


@every
def test_a_level_is_worth_playing(name: str) -> None:
    """Selfish nets lose 15 % or more, and no fixed rule comes within 3 % of the optimum."""
    rows = read_rows(FOLDER / f"{name}.csv")
    assert refused(rows) == ""
    assert {(row.split, row.rule, row.radius, row.price, row.seen) for row in rows} >= {
        (split, rule.rule, rule.radius, rule.price, rule.seen)
        for split in ("validation", "test")
        for rule in RULES
    }
    scenario = scenarios.get(name)
    for split, best in best_local(rows).items():
        assert best.local
        assert scenario.score(best.cost, split) == 0  # type: ignore[arg-type]
        assert scenario.score(1, split) == 1  # type: ignore[arg-type]
        assert 0 < scenario.score((1 + best.cost) / 2, split) < 1  # type: ignore[arg-type]


@every
def test_stored_costs_are_those_of_the_rules(name: str) -> None:
    rows = read_rows(FOLDER / f"{name}.csv")
    rules = (RULES[1], RULES[4]) if name == LARGE else (*RULES[:2], SELFISH, DETOUR, *RULES[-9:-7])
    for rule in rules:
        stored = next(row for row in rows if row.split == "test" and row.router == rule)
        assert replace(measure(scenarios.get(name), "test", rule), seconds=stored.seconds) == stored


def test_what_is_not_worth_playing() -> None:
    rows = read_rows(FOLDER / "gates-8x7-v0.csv")

    def costing(rule: LocalRouter, cost: float) -> list[Row]:
        return [replace(row, cost=cost) if row.router == rule else row for row in rows]

    assert refused(costing(SELFISH, 1.149)).startswith("selfish nets cost 1.149, less than 1.15")
    assert "radius 2, price 4" in refused(costing(LocalRouter(radius=2, price=4), 1.02))


def test_a_scenario_without_rules_has_no_score() -> None:
    with pytest.raises(InputError, match=r"^toy-4x4-v0: expected a scenario with a known best loc"):
        scenarios.get("toy-4x4-v0").score(1.1)


@pytest.mark.parametrize("name", ["gates-8x7-v0", "gates-2x-v0", "gates-mixed-v0"])
def test_captives_need_the_narrow_gate_and_others_do_not(name: str) -> None:
    scenario = scenarios.get(name)
    captives = [0, 0]
    for problem in scenario.test:
        for gcells in problem.pin_gcells:
            start, end = gcells.tolist()
            assert path_length(problem, start, end) is not None
            captives[path_length(problem, start, end, least=3) is None] += 1
        # Where no captive is, nets go through the wide gates alone.
    assert min(captives) > len(scenario.test) / 4
    # Without captives a narrow gate saves every flexible net a detour, or costs it none.
    saved = [
        path_length(problem, *gcells.tolist(), least=3) or 0  # type: ignore[misc]
        for problem in scenario.test
        for gcells in problem.pin_gcells
    ]
    plain = [
        path_length(problem, *gcells.tolist()) or 0
        for problem in scenario.test
        for gcells in problem.pin_gcells
    ]
    detours = [wide - narrow for wide, narrow in zip(saved, plain, strict=True) if wide]
    assert min(detours) >= 0
    assert max(detours) >= 4


def test_gates_vary() -> None:
    draw = Gates(columns=(7, 10), wall=(2, 6), motifs=(1, 2), rows=14, tracks=(1, 2))
    rng = np.random.default_rng(0)
    drawn = [draw(rng) for _ in range(60)]
    assert {problem.grid for problem in drawn} == {(10, 14, 1)}
    closed = {int((p.capacity.reshape(10, 14, 3)[..., :2] > 0).sum()) for p in drawn}
    assert len(closed) > 10
    assert len({len(problem.nets) for problem in drawn}) > 4


def test_the_short_cut_makes_all_worse_off() -> None:
    with_it, without = Braess(), Braess(short_cut=False)
    longer = []
    for seed in range(40):
        problem, other = (draw(np.random.default_rng(seed)) for draw in (with_it, without))
        assert problem.nets == other.nets
        closed = np.flatnonzero(problem.capacity != other.capacity)
        assert len(closed) == 1
        longer += [
            (path_length(other, *gcells.tolist()) or 0)
            - (path_length(problem, *gcells.tolist()) or 0)
            for gcells in problem.pin_gcells
        ]
    assert min(longer) >= 0
    assert max(longer) == 4
    rows = read_rows(FOLDER / "braess-v0.csv")
    closed_cost = next(row.cost for row in rows if row.scenario == NO_SHORT_CUT)
    assert closed_cost < next(
        row.cost for row in rows if row.split == "test" and row.router == SELFISH
    )


def test_nets_that_arrive_later_are_not_seen() -> None:
    """What the first net sees, and all that it does, does not depend on the others."""
    scenario = scenarios.get("online-8x8-v0")
    problem = scenario.test[0]
    alone = replace(problem, nets=problem.nets[:1])
    envs = [global_routing_v0.env(p, **scenario.env) for p in (problem, alone)]
    for env in envs:
        env.reset()
    while "net_0" in envs[1].agents and not any(envs[1].last()[2:4]):
        seen = [env.last() for env in envs]
        assert [env.agent_selection for env in envs] == ["net_0", "net_0"]
        assert np.array_equal(seen[0][0], seen[1][0])
        for env, (_, _, _, _, info) in zip(envs, seen, strict=True):
            env.step(int(np.flatnonzero(info["action_mask"])[-1]))
    assert envs[0].agent_selection in ("net_0", "net_1")


# The rules in plain Python -----------------------------------------------------------------------


def plain_way(game: Game, n: int, rule: LocalRouter) -> int | None:
    """The first move of a cheapest path, as policies.routers.local says."""
    grid, start, target = game.grid, game.cell[n], game.target[n]
    radius = 10**6 if rule.radius is None else rule.radius
    here = grid.position_of[start]

    def away(cell: int) -> int:
        at = grid.position_of[cell]
        return max(abs(at[0] - here[0]), abs(at[1] - here[1]))

    others = [game.cell[k] for k in game.active if k != n]
    met = not game.sequential and any(away(cell) <= radius for cell in others)
    price = int(rule.price * 1024) if met or not rule.seen else 0
    free, best, move = game.free_moves(n), 10**15, None
    costs, first, waiting = {start: 0}, {start: 0}, [(0, start)]
    while waiting:
        cost, cell = heapq.heappop(waiting)
        if cost > costs[cell] or cost >= best:
            continue
        if cell == target:
            best, move = cost, first[cell]
            continue
        for step, (edge, ahead) in enumerate(grid.ways[cell]):
            if ahead == OFF_GRID:
                continue
            if away(ahead) > radius:
                left = cost + 1024 * (
                    grid.distance(cell, target) + plain_detour(game, cell, target)
                )
                if cell != start and left < best:
                    best, move = left, first[cell]
                continue
            layer = grid.position_of[cell][2]
            open_ = edge in game.used[n] or game.remaining[edge] >= game.needed[n][layer]
            if not (free >> step & 1 if cell == start else open_ and ahead not in game.visited[n]):
                continue
            length = 1024
            if edge in game.used[n]:
                length = 1
            elif step < 4:
                length += price // max(game.remaining[edge], 1)
            if cost + length < costs.get(ahead, 10**15):
                costs[ahead] = cost + length
                first[ahead] = step if cell == start else first[cell]
                heapq.heappush(waiting, (cost + length, ahead))
    return move


def plain_detour(game: Game, cell: int, target: int) -> int:
    """Vias beyond the difference in layers, where layer 1 leads along x and layer 2 along y."""
    if game.layers == 1:
        return 0
    (x, y, z), (u, v, w) = game.grid.position_of[cell], game.grid.position_of[target]
    needed = ({0} if x != u else set()) | ({1} if y != v else set())
    return 0 if z != w or needed <= {z} else 2


def plain_greedy(game: Game, n: int) -> int:
    """The move nearest to the target, then with the most tracks left."""
    free, (u, v, w) = game.free_moves(n), game.grid.position_of[game.target[n]]

    def rank(step: int) -> tuple[int, int, int]:
        edge, ahead = game.grid.ways[game.cell[n]][step]
        x, y, z = game.grid.position_of[ahead]
        across = abs(x - u) + abs(y - v)
        room = 10**6 if edge in game.used[n] else game.remaining[edge] if step < 4 else 0
        return across, abs(z - w) if across == 0 else 0, -room

    return min((step for step in range(6) if free >> step & 1), key=rank, default=0)


@pytest.mark.parametrize("name", [name for name in NAMES if name != LARGE])
@pytest.mark.parametrize(
    "rule",
    [
        LocalRouter(rule="greedy"),
        LocalRouter(radius=2, price=0.5),
        LocalRouter(radius=3, price=4, seen=True),
        SELFISH,
    ],
    ids=str,
)
def test_rules_move_as_in_plain_python(name: str, rule: LocalRouter) -> None:
    problems = scenarios.get(name).test[: 12 if "8x8" not in name else 2]
    engine = rule.play(problems, rules_of(name))
    for m, problem in enumerate(problems):
        game = Game(problem, rules_of(name))
        while game.active:
            n = game.turn
            move = None if rule.rule == "greedy" else plain_way(game, n, rule)
            game.step(plain_greedy(game, n) if move is None else move)
        metrics = engine.metrics(m)
        assert (game.wirelength, game.moves) == (metrics.wirelength, metrics.steps)
        assert game.joined_tasks == metrics.joined
        plain = [np.sort(list(used)).tolist() for used in game.used]
        agents = range(len(game.nets))
        edges = engine.solution(m).edges
        assert plain == [edges[game.nets[n]].tolist() for n in agents]


# The rules ---------------------------------------------------------------------------------------


@given(any_problem(max_side=5, max_layers=2, max_nets=1))
def test_a_net_alone_with_full_sight_walks_a_shortest_path(problem: Problem) -> None:
    pins = problem.pin_gcells[0]
    if len(pins) != 2:
        return
    demand = int(problem.net_demand.max())
    engine = SELFISH.play([problem], replace(ONE_SHOT, turn_order="sequential"))
    least = path_length(problem, *pins.tolist(), least=demand)  # type: ignore[misc]
    if len(set(problem.net_demand[0].tolist())) == 1:
        assert (engine.metrics().joined == 1) == (least is not None)
        assert engine.metrics().wirelength == (least or 0)
    if engine.metrics().joined:
        assert (
            engine.metrics().wirelength == evaluate(problem, sequential_astar(problem)).wirelength
        )


@pytest.mark.parametrize("rule", [LocalRouter(radius=2), LocalRouter(radius=3, price=2, seen=True)])
def test_local_rules_do_not_see_beyond_their_radius(rule: LocalRouter) -> None:
    rng = np.random.default_rng(0)
    rules = replace(ONE_SHOT, max_steps=1)
    moved = changed = 0
    for _ in range(60):
        field = Field(11, 11, capacity=2)
        start = tuple(rng.integers(4, 7, size=2).tolist())
        target = tuple(rng.choice([0, 1, 9, 10], size=2).tolist())
        far = tuple(rng.choice([0, 10], size=2).tolist())
        field.net(start, target).net(far, (5, 5))
        problems = []
        for tracks in (2, 0, 1):  # of all that is far away
            other = Field(11, 11, capacity=tracks).net(start, target).net(far, (5, 5))
            low = [max(at - rule.radius, 0) for at in start]
            high = [min(at + rule.radius, 10) for at in start]
            other.area((low[0] + 1, high[0] - 1), (low[1] + 1, high[1] - 1), tracks=2)
            for x in range(low[0], high[0]):
                for y in (low[1], high[1]):
                    other.gate(right_of=x, row=y, tracks=2)
            for y in range(low[1], high[1]):
                for x in (low[0], high[0]):
                    other.gate(above=y, column=x, tracks=2)
            problems.append(other.problem())
        engine = rule.play(problems, replace(rules, nets=Nets(order="file")))
        cells = engine.agents["cell"][:, 0]
        assert len(set(cells.tolist())) == 1
        moved += int(cells[0] != problems[0].pin_gcells[0][0])
        whole = SELFISH.play(problems, replace(rules, nets=Nets(order="file")))
        changed += len(set(whole.agents["cell"][:, 0].tolist())) > 1
    assert moved == 60
    assert changed or rule.price  # full sight does tell the problems apart


def test_a_price_leads_around_narrow_edges() -> None:
    field = Field(6, 3, capacity=9).wall(right_of=2).gate(right_of=2, row=0, tracks=1)
    problem = field.gate(right_of=2, row=2).net((2, 0), (3, 0)).problem()
    for rule, length in ((SELFISH, 1), (DETOUR, 5), (LocalRouter(price=3), 1)):
        assert rule.play([problem], ONE_SHOT).metrics().wirelength == length
    # Alone it has nobody to give way to.
    alone = replace(DETOUR, seen=True)
    assert alone.play([problem], ONE_SHOT).metrics().wirelength == 1
    two = replace(problem, nets=(*problem.nets, replace(problem.nets[0], name="other")))
    assert alone.play([two], ONE_SHOT).metrics().wirelength > 5
    assert alone.play([two], replace(ONE_SHOT, turn_order="sequential")).metrics().wirelength == 6


def test_greedy_nets_prefer_free_edges() -> None:
    field = Field(4, 4, capacity=3).gate(right_of=0, row=0, tracks=1).net((0, 0), (3, 3))
    solution = LocalRouter(rule="greedy").route(field.problem())
    assert 1 in solution.edges[0].tolist()  # north
    assert 0 not in solution.edges[0].tolist()
    assert evaluate(solution.problem, solution).wirelength == 6


def test_random_moves_depend_on_the_seed_only() -> None:
    problems = scenarios.get("gates-8x7-v0").test[:10]
    routes: list[Any] = [
        LocalRouter(rule="random", seed=seed).play(problems, ONE_SHOT).dynamic.used.copy()
        for seed in (1, 1, 2)
    ]
    assert np.array_equal(routes[0], routes[1])
    assert not np.array_equal(routes[0], routes[2])
    assert LocalRouter(rule="random").seeded
    assert not LocalRouter().seeded


@every
def test_all_nets_end_and_nothing_overflows(name: str) -> None:
    problems = scenarios.get(name).test[:2]
    for rule in (LocalRouter(rule="random"), LocalRouter(rule="greedy"), LocalRouter(price=1)):
        engine = rule.play(problems, rules_of(name))
        assert set(np.unique(engine.agents["status"])) <= {
            Status.TERMINATED, Status.TRUNCATED, Status.ABSENT,
        }  # fmt: skip
        for m, problem in enumerate(problems):
            judged, metrics = evaluate(problem, engine.solution(m)), engine.metrics(m)
            assert (judged.overflow, judged.wirelength) == (0, metrics.wirelength)
            assert len(judged.disconnected) <= metrics.tasks - metrics.joined
            assert judged.connected == (metrics.joined == metrics.tasks)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"radius": 0}, "radius: expected 1 to"),
        ({"price": -1}, "price: expected a number from 0 to 1000"),
        ({"price": 1, "rule": "greedy"}, "price: expected 0, without rule: shortest"),
        ({"seen": True}, "seen: expected false, without a price"),
        ({"seed": -1}, "seed: expected a number from 0"),
        ({"max_steps": 0}, "max_steps: expected"),
    ],
)
def test_what_rules_refuse(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=f"^{said}"):
        LocalRouter(**options)


def test_the_command() -> None:
    done = CliRunner().invoke(main, ["--table", "gates-8x7-v0"])
    assert done.exit_code == 0
    assert len(done.stdout.splitlines()) == 3
    assert done.stdout.count("`gates-8x7-v0`") == 1
    done = CliRunner().invoke(main, ["toy-4x4-v0"])
    assert done.exit_code == 2
    assert done.output.startswith("Error: scenario: expected module:NAME or one of gates")
