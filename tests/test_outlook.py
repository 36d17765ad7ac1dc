"""The observation ``outlook``, number by number, and the loop that walks with it."""

import copy
from typing import Any

import networkx as nx
import numpy as np
import pytest
import torch
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st
from reference import Edge, all_edges, between, contested, edge_number
from seeing import Gcell, edge_costs, expected, gcell, is_priced, open_tasks, option_state, squash
from torch import nn

import marouting
from marouting import Engine, EnvOptions, InputError, Problem, evaluate
from marouting.batch.prices import Negotiation
from marouting.batch.state import Option
from marouting.batch.window import mirrored
from marouting.game import NOBODY, RIP_UP, Status
from marouting.rules import RipUp
from policies.generalist import SHIPPED
from policies.generalist.outlook import OutlookObservation
from policies.generalist.walk import Walker
from policies.learned import greedy
from policies.learned.learner import play_steps
from policies.learned.policy import TrainedPolicy, player_of

STEPS = (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)


def far(distance: float) -> float:
    """A distance as it is seen."""
    eighths = abs(distance) / 8
    return float(np.copysign(eighths if eighths <= 1 else min(1 + np.log(eighths), 4), distance))


def apart(a: Gcell, b: Gcell) -> int:
    return sum(abs(p - q) for p, q in zip(a, b, strict=True))


def ways(engine: Engine, m: int, n: int, costs: dict[Edge, float | None], margin: int) -> Any:
    """(Gcell: cost of the cheapest way to the end) inside the box, and the box."""
    problem, agent, static = engine.problems[m], engine.agents[m, n], engine.static
    tasks = open_tasks(engine, m, n)
    both = [gcell(engine, int(g)) for g in static.tasks[agent["task"]]]
    ends = [*both, gcell(engine, agent["target"]), *(far for _, far in tasks[1:])]
    if is_priced(engine, m):
        margin += 2 * int(engine.games[m]["stuck"])
    low, high = np.min(ends, axis=0)[:2] - margin, np.max(ends, axis=0)[:2] + margin
    graph: nx.Graph[Gcell] = nx.Graph()
    inside = [
        cell
        for cell in np.ndindex(*problem.grid)
        if (low <= cell[:2]).all() and (cell[:2] <= high).all()
    ]
    graph.add_nodes_from(inside)
    for (a, b), cost in costs.items():
        if cost is not None and a in graph and b in graph:
            graph.add_edge(a, b, weight=cost)
    found = [gcell(engine, agent["target"])]
    if engine.rules.target == "tree":
        tree = np.unpackbits(option_state(engine, Option.TREE)[m, n], bitorder="little")
        found = [gcell(engine, int(g)) for g in np.flatnonzero(tree)]
    found = [cell for cell in found if cell in graph]
    return nx.multi_source_dijkstra_path_length(graph, set(found)), graph, found


def spanning(there: Gcell, pins: list[Gcell], cost: dict[Gcell, float], wired: set[Gcell]) -> Any:
    """Edges of the least tree that spans a Gcell with what is wired, the end and other pins."""
    unknown = 2.0**28  # as long as they stay the same for all moves they do not matter
    graph: nx.Graph[Any] = nx.Graph()
    graph.add_edge("here", "end", weight=cost[there])
    for k, pin in enumerate(pins):
        graph.add_edge("end", k, weight=cost.get(pin, unknown))
        graph.add_edge("here", k, weight=min(apart(pin, cell) for cell in wired | {there}))
        for j, other in enumerate(pins[:k]):
            graph.add_edge(k, j, weight=apart(pin, other))
    return nx.minimum_spanning_tree(graph).size(weight="weight")


def row_of(engine: Engine, seen: OutlookObservation, m: int, n: int) -> dict[str, Any]:
    """What agent n of problem m ought to see, but for the block ``numbers``."""
    problem, agent, r = engine.problems[m], engine.agents[m, n], seen.radius
    here, target = gcell(engine, agent["cell"]), gcell(engine, agent["target"])
    sign = [1 if target[axis] >= here[axis] else -1 for axis in (0, 1)]
    others = [k for k in range(engine.nets.shape[1]) if k != n]
    taken = expected(engine, m, others)
    tasks = open_tasks(engine, m, n)
    static, dynamic = engine.static, engine.dynamic

    def beside(step: tuple[int, int, int], start: Gcell = here) -> Gcell | None:
        """The Gcell a step of the frame away."""
        x, y, z = start[0] + sign[0] * step[0], start[1] + sign[1] * step[1], start[2] + step[2]
        there = x, y, z
        return there if all(0 <= a < s for a, s in zip(there, problem.grid, strict=True)) else None

    def figures(edge: Edge) -> tuple[float, float]:
        """Tracks of remaining capacity and of predicted slack."""
        number, track = edge_number(problem, edge), max(int(static.demand[m, n, edge[0][2]]), 1)
        remaining = int(dynamic.remaining[m, number])
        return squash(remaining // track), squash((remaining - taken[edge]) / track)

    detours, ahead_of = [], []
    for scarce in (None, taken):
        costs = edge_costs(engine, m, n, scarce)
        cost, graph, ends = ways(engine, m, n, costs, seen.margin)
        whole = []
        ahead_of = []
        for step in STEPS:
            ahead = beside(step)
            crossing = costs[between(here, ahead)] if ahead is not None else None
            there = ahead in graph and ahead in cost and crossing is not None
            ahead_of.append(ahead if there else None)
            whole.append(crossing + cost[ahead] if there else np.inf)
        detours += [1.0 if w == np.inf else squash(w - min(whole)) for w in whole]
        if scarce is None:
            plain, roads, arrivals, reached = cost, graph, ends, ahead_of
            crossings = [costs[between(here, there)] if there else None for there in reached]
    crossed = []
    for step in STEPS[:4]:
        ahead = beside(step)
        crossed.append((-1.0, -1.0) if ahead is None else figures(between(here, ahead)))
    later = sorted((apart(pin, here), k, pin) for k, (_, pin) in enumerate(tasks[1:]))[:4]
    others_seen = [pin for *_, pin in later]
    used = {
        cell
        for edge in all_edges(problem)
        if np.unpackbits(dynamic.used[m, n], bitorder="little")[edge_number(problem, edge)]
        for cell in edge
    }
    pins, nearest = np.zeros((5, 6)), []
    for k, pin in enumerate([target, *others_seen]):
        away = np.subtract(pin, here) * [*sign, 1]
        pins[k, :4] = [1, *map(far, away)]
        pins[k, 4] = far(plain[pin]) if pin in plain else 4
        pins[k, 5] = far(min(apart(pin, cell) for cell in used | {here}))
        # Where cheapest ways end, as far as it is seen; there may be several.
        nearest.append(
            {
                tuple(map(far, (np.subtract(end, here) * [*sign, 1])[:2]))
                for end in arrivals
                if pin in plain and nx.dijkstra_path_length(roads, pin, end) <= plain[pin] + 1e-9
            }
        )
    spans = [
        np.inf if there is None else crossing + spanning(there, others_seen, plain, used | {here})
        for there, crossing in zip(reached, crossings, strict=True)
    ]
    found = {
        "detour": np.array(detours),
        "span": np.array([1.0 if s == np.inf else squash(s - min(spans)) for s in spans]),
        "crossed": np.array(crossed).T.reshape(-1),
        "pins": pins,
        "ends": nearest,
    }
    side, layers = 2 * r + 1, range(problem.grid[2])
    for axis, name in enumerate("xy"):
        shape = (side + (axis == 0), side + (axis == 1))
        room, slack = np.zeros((2, *shape))
        for i, j in np.ndindex(*shape):
            end = (i - r, j - r, -here[2])
            start = (end[0] - (axis == 0), end[1] - (axis == 1), end[2])
            near, beyond = beside(start), beside(end)
            if near is not None and beyond is not None:
                both = [figures(between((*near[:2], z), (*beyond[:2], z))) for z in layers]
                room[i, j], slack[i, j] = np.max(both, axis=0)
        found[f"room_{name}"], found[f"slack_{name}"] = room.reshape(-1), slack.reshape(-1)
    own, opened = np.zeros((2, side, side))
    for i, j in np.ndindex(side, side):
        place = beside((i - r, j - r, -here[2]))
        if place is not None:
            own[i, j] = place[:2] in [cell[:2] for cell in used]
            opened[i, j] = place[:2] in [far[:2] for _, far in tasks]
    return found | {"own": own.reshape(-1), "open": opened.reshape(-1)}


rules = st.fixed_dictionaries(
    {
        "overflow": st.sampled_from(["forbidden", "allowed"]),
        "target": st.sampled_from(["pin", "tree"]),
        "next_pin": st.sampled_from(["listed", "nearest"]),
        "rip_up": st.sampled_from([None, {"rounds": 4}]),
        "negotiation": st.sampled_from([None, Negotiation()]),
        "mask": st.fixed_dictionaries({"visited": st.booleans()}),
    }
)


@examples(15)
@given(
    contested(max_nets=4),
    st.builds(OutlookObservation, st.integers(0, 2), st.integers(1, 4)),
    rules,
    st.sampled_from(["round_robin", "sequential"]),
    st.integers(0, 1000),
)
def test_every_number_is_as_the_oracle_says(
    problem: Problem, seen: OutlookObservation, rules: dict[str, Any], order: str, seed: int
) -> None:
    if rules["overflow"] == "forbidden":
        rules = rules | {"negotiation": None}
    engine = Engine([problem, problem], turn_order=order, max_steps=7, **rules)
    rng = np.random.default_rng(seed)
    space = seen.space([problem], rules["overflow"] == "allowed")
    for _ in range(3):
        who = engine.pairs(everyone=True)
        rows = np.full((len(who[0]), seen.size), np.nan, np.float32)
        seen.write(engine, *who, rows)
        for row, m, n in zip(rows, *who, strict=True):
            if n == NOBODY:
                continue
            assert space.contains(row)
            if engine.agents[m, n]["status"] != Status.ACTIVE or rng.random() < 0.6:
                continue  # the oracle takes its time
            answers = row_of(engine, seen, m, n)
            pins = row[seen.layout["pins"]].reshape(5, 8)
            for mine, ends in zip(pins[:, 5:7].tolist(), answers.pop("ends"), strict=False):
                assert not ends or any(np.allclose(mine, end, atol=3e-5) for end in ends)
            for name, answer in answers.items():
                mine = pins[:, [0, 1, 2, 3, 4, 7]] if name == "pins" else row[seen.layout[name]]
                np.testing.assert_allclose(mine, answer, atol=3e-5, err_msg=name)
        for _ in range(rng.choice([1, 2, 5, 30])):
            engine.step(rng.integers(-1, 6, engine.nets.shape))


@examples(15)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["pin", "tree"]), st.booleans(), st.booleans())
def test_rows_do_not_depend_on_what_was_seen_before(
    seed: int, target: Any, own: bool, prices: bool
) -> None:
    """Ways are kept while an agent walks; whatever happens between, they are those found anew."""
    rng = np.random.default_rng(seed)
    problems = marouting.generate(2, grid=(5, 5, 2), nets=5, max_pins=3, capacity=2, seed=seed)
    rules: dict[str, Any] = {
        "turn_order": "sequential" if own else "round_robin",
        "overflow": "allowed",
        "target": target,
        "rip_up": {"rounds": 4},
        "negotiation": Negotiation(prices=prices),
    }
    engine = Engine(problems, **rules)
    seen = [OutlookObservation(margin=1), OutlookObservation(margin=2)]
    saved = engine.save()
    for _ in range(40):
        agents = engine.games["agent"] if own else rng.integers(0, 5, 2)
        which = np.array([0, 1], np.int32), agents.astype(np.int32)
        look = seen[0 if own else rng.integers(2)]
        kept, fresh = np.zeros((2, 2, look.size), np.float32)
        look.write(engine, *which, kept)
        another = Engine(problems, **rules)
        another.restore(engine.save())
        look.write(another, *which, fresh)
        np.testing.assert_array_equal(kept, fresh)
        jump = rng.random()
        if jump < 0.05:
            saved = engine.save()
        elif jump < 0.1:
            engine.restore(saved)
        elif jump < 0.15:
            engine.reset()
        moves = rng.integers(0, 6, engine.nets.shape)
        engine.step(moves[:, 0] if own else moves)


def test_the_layout_of_a_row() -> None:
    seen = OutlookObservation(radius=1)
    assert list(seen.layout) == [
        "numbers", "detour", "span", "crossed", "pins", "room_x", "room_y", "slack_x", "slack_y",
        "own", "open",
    ]  # fmt: skip
    assert seen.layout["pins"] == slice(42, 82)
    assert seen.layout["room_x"] == slice(82, 94)
    assert seen.size == 82 + 4 * 12 + 2 * 9


@pytest.mark.parametrize("given_", [{"radius": -1}, {"radius": 33}, {"margin": 0}, {"margin": 1.5}])
def test_options_out_of_range(given_: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(given_))):
        OutlookObservation(**given_)


def test_the_first_numbers_are_those_of_the_window() -> None:
    problem = marouting.generate(1, nets=10, max_pins=4)[0]
    engine = Engine([problem], target="tree")
    who = engine.pairs(everyone=True)
    window, seen = marouting.WindowObservation(), OutlookObservation()
    rows = [np.zeros((len(who[0]), each.size), np.float32) for each in (window, seen)]
    window.write(engine, *who, rows[0])
    seen.write(engine, *who, rows[1])
    np.testing.assert_array_equal(rows[0][:, :16], rows[1][:, :16])


# --- the loop -------------------------------------------------------------------------------------

GAME: dict[str, Any] = {
    "turn_order": "sequential",
    "overflow": "allowed",
    "target": "tree",
    "next_pin": "nearest",
    "mask": {"visited": True},
}


@pytest.mark.parametrize(("choose", "rounds"), [("all", 2), ("agents", 2), ("agents", 25)])
def test_the_loop_walks_as_the_network_does(choose: str, rounds: int) -> None:
    """The same moves as by the observation, a product of matrices and the engine's steps."""
    more: dict[str, Any] = {"rip_up": {"rounds": rounds, "choose": choose, "neighbours": 1}}
    more["negotiation"] = Negotiation(prices=rounds > 2)
    problems = marouting.generate(2, nets=15, max_pins=4, capacity=4, seed=3)
    seen = OutlookObservation(radius=1)
    sizes = (seen.size, 16, 6)
    rng = np.random.default_rng(0)
    weights = rng.normal(size=17 * 6 + (seen.size + 1) * 16).astype(np.float32) * 0.3
    first, second = np.split(weights, [(seen.size + 1) * 16])
    # A network that likes short ways, so that nets get shorter and have no reason to give way.
    ways = first[:-16].reshape(-1, 16)[seen.layout["detour"]]
    ways[:6, :6], second[:36].reshape(6, 6)[:] = np.eye(6), -5 * np.eye(6)
    engine, loop = Engine(problems, **GAME, **more), Engine(problems, **GAME, **more)
    cold = np.zeros(2, np.float32)
    walker = Walker(loop, seen, sizes, weights, cold, np.zeros(2, np.uint64))
    while not walker.walk(7):
        pass
    rows, steps = np.zeros((2, seen.size), np.float32), 0
    shortest: dict[tuple[int, int], int] = {}
    answers: set[bool] = set()
    kinds: set[tuple[bool, bool]] = set()

    def length(m: int, n: int) -> int:
        return int(np.unpackbits(engine.dynamic.used[m, n]).sum())

    def rips_up(m: int, n: int) -> bool:
        game, edges = engine.games[m], engine.dynamic.used[m, n]
        over = np.packbits(engine.dynamic.remaining[m] < 0, bitorder="little")
        if engine.agents[m, n]["joined"] < engine.tasks[m, n]:
            return True
        first = game["present"] == 102 or game["round"] == 1
        kinds.add((is_priced(engine, m), bool(first)))
        if is_priced(engine, m) and not first:
            return bool((edges & over[: len(edges)]).any())
        if (game["turn"] + game["round"]) % 8 == 0:
            return True
        if is_priced(engine, m):
            costs, bits = edge_costs(engine, m, n, None), np.unpackbits(edges, bitorder="little")
            uses = [e for e in costs if bits[edge_number(engine.problems[m], e)]]
            return sum(costs[e] or 0 for e in uses) > shortest[m, n]
        if game["overflow"] > 0:
            return bool((edges & over[: len(edges)]).any())
        return length(m, n) > shortest[m, n]

    while (engine.games["agent"] != NOBODY).any():
        who = np.arange(2, dtype=np.int32), engine.games["agent"].copy()
        seen.write(engine, *who, rows)
        hidden = np.maximum(rows @ first[:-16].reshape(-1, 16) + first[-16:], 0)
        scores = hidden @ second[:-6].reshape(16, 6) + second[-6:]
        masks, moves = engine.masks(*who), np.full(2, NOBODY)
        for m, n in zip(*who, strict=True):
            if n == NOBODY:
                continue
            if engine.games[m]["asked"]:
                answers.add(rips_up(m, n))
                moves[m] = RIP_UP if rips_up(m, n) else 0
                continue
            late = 4 * engine.agents[m, n]["steps"] >= engine.max_steps
            by = -rows[m, seen.layout["detour"]][:6] if late else scores[m]
            grid = mirrored(np.arange(6), np.tile(rows[m], (6, 1)))
            free = [w for w in range(6) if late or masks[m, grid[w]]]
            moves[m] = grid[max(free, key=lambda w, by=by: by[w])]
        engine.step(moves)
        steps += 1
        for m, n in zip(*who, strict=True):
            agent = engine.agents[m, n]
            if agent["status"] != Status.ACTIVE and agent["joined"] == engine.tasks[m, n]:
                shortest[m, n] = min(shortest.get((m, n), length(m, n)), length(m, n))
    assert steps > 50
    assert answers == ({True, False} if choose == "agents" else set())
    assert rounds == 2 or {(True, True), (True, False), (False, False)} <= kinds
    for m in range(2):
        assert engine.metrics(m) == loop.metrics(m)
    np.testing.assert_array_equal(engine.dynamic.used, loop.dynamic.used)


@pytest.mark.parametrize("prices", [False, True])
def test_games_with_many_rounds_are_played_out_as_step_by_step(prices: bool) -> None:
    """Two networks, two games each: the moves are those of the plain player."""
    problems = marouting.generate(4, nets=12, max_pins=4, capacity=2, seed=1)
    rounds: dict[str, Any] = {"rip_up": RipUp(rounds=6, neighbours=1)}
    negotiation = Negotiation(prices=prices)
    # So few steps that agents are slow, and some tasks fail.
    few: dict[str, Any] = {"max_steps": 14, "agents": "single", "observation": {"kind": "outlook"}}
    options = EnvOptions(**few, **GAME, **rounds)
    module = TrainedPolicy.load(SHIPPED).module
    own = nn.utils.parameters_to_vector(module.parameters()).detach()
    weights = torch.stack((own, own + torch.linspace(-0.02, 0.02, len(own))))
    player, other = (player_of(options, problems, negotiation) for _ in range(2))
    player.reset()
    other.reset()
    layers = greedy.layers_of(player, module, masking=True)
    assert layers is not None
    assert greedy.layers_of(player, module, masking=False) is None
    greedy.play_out(player, layers, weights.numpy(), masking=True)
    assert not player.buffers.active.any()
    modules = [copy.deepcopy(module), copy.deepcopy(module)]
    for one, row in zip(modules, weights, strict=True):
        nn.utils.vector_to_parameters(row, one.parameters())

    def rate(seen: torch.Tensor) -> torch.Tensor:
        return torch.stack([one(part) for one, part in zip(modules, seen, strict=True)])

    for _ in play_steps(other, rate, networks=2, masking=True):
        pass
    metrics = [[p.engine.metrics(m) for m in range(4)] for p in (player, other)]
    assert metrics[0] == metrics[1]
    np.testing.assert_array_equal(player.engine.dynamic.used, other.engine.dynamic.used)
    assert len({one.steps for one in metrics[0]}) > 1


def test_the_loop_stops_when_nets_have_walked_and_goes_on() -> None:
    problem = marouting.generate(1, nets=10, max_pins=3)[0]
    engine = Engine([problem] * 2, rip_up={"rounds": 3}, **GAME)
    seen = OutlookObservation()
    weights = np.zeros((seen.size + 1) * 6, np.float32)
    warmth, keys = np.ones(2, np.float32), np.arange(2).astype(np.uint64)
    walker = Walker(engine, seen, (seen.size, 6), weights, warmth, keys)
    assert walker.walk(10**6, stops=True)
    assert (engine.games["active"] == 0).all()
    assert (engine.games["round"] == 0).all()
    before = [engine.metrics(m).wirelength for m in range(2)]
    assert walker.walk(10**6, stops=True)
    assert (engine.games["round"] == 0).all()
    walker.playing[1] = False
    assert not walker.walk(1)
    assert walker.walk(10**6, stops=True)
    assert engine.games["round"].tolist() == [1, 0]
    assert walker.walk(10**6)
    assert engine.games["agent"].tolist()[0] == NOBODY
    assert engine.metrics(0).wirelength <= before[0]
    assert engine.metrics(1).wirelength == before[1]


@given(seed=st.integers(0, 2**32), nets=st.integers(1, 20), max_pins=st.integers(2, 6))
def test_nets_follow_the_routes_of_another_game(seed: int, nets: int, max_pins: int) -> None:
    """By ordinary moves; what does not lead from pin to pin is left out."""
    problem = marouting.generate(1, (6, 5, 2), nets=nets, max_pins=max_pins, seed=seed)[0]
    other: dict[str, Any] = {"nets": {"decomposition": "steiner"}, "next_pin": "listed"}
    guide, engine = Engine([problem], **GAME | other), Engine([problem] * 2, **GAME)
    seen = OutlookObservation()
    # Along the cheapest ways.
    weights = np.zeros((seen.size + 1, 6), np.float32)
    weights[seen.layout["detour"]][:6] = -9 * np.eye(6)
    cold, drawn = np.zeros(2, np.float32), np.arange(2).astype(np.uint64)

    def walker(where: Engine, games: int) -> Walker:
        sizes = (seen.size, 6)
        return Walker(where, seen, sizes, weights.ravel(), cold[:games], drawn[:games])

    assert walker(guide, 1).walk(10**6)
    assert guide.metrics().joined == guide.metrics().tasks
    follower = walker(engine, 2)
    follower.follow(guide)
    assert follower.walk(10**6)
    for n in range(len(engine.tasks[0])):
        taken, given_ = engine.dynamic.used[0, n], guide.dynamic.used[0, n]
        assert not (taken & ~given_).any()
    followed, led = engine.metrics(0), guide.metrics()
    assert (followed.joined, followed.tasks) == (engine.metrics(1).tasks,) * 2
    assert followed.wirelength <= led.wirelength
    assert evaluate(problem, engine.solution(0)).connected
