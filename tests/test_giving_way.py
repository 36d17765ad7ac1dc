"""Nets that give way: a problem by hand, what must hold in every round, and every interface."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pettingzoo.test import api_test, parallel_api_test
from seeing import option_state

from marouting import Engine, InputError, Move, Net, Pin, Problem, evaluate, generate
from marouting import global_routing_v0 as game
from marouting.batch.prices import Negotiation
from marouting.batch.state import Option
from marouting.env.single import GlobalRoutingSingle
from marouting.game import NOBODY, RIP_UP
from marouting.search.guides import AStar
from marouting.vector import BatchEnv
from policies.learned.config import load_config

E, W, N, S, U, D = Move


def net(name: str, *pins: tuple[int, int]) -> Net:
    return Net(name, int(name), tuple(Pin(x, y, 1) for x, y in pins))


# Two rows of three Gcells in one layer, with one track each.
CROSSING = Problem(
    grid=(3, 2, 1),
    vertical_capacity=(1,),
    horizontal_capacity=(1,),
    nets=(net("1", (0, 0), (2, 0)), net("2", (0, 0), (2, 0)), net("3", (1, 1), (2, 1))),
    min_width=(1,),
    min_spacing=(0,),
    via_spacing=(0,),
    tile=(1, 1),
)


def walk(engine: Engine, *moves: int) -> None:
    for move in moves:
        engine.step(np.array([move]))


def test_a_net_that_blocks_another_gives_way() -> None:
    """Net 1 walks along both rows at once; net 2 has no way; net 1 walks again, straight."""
    engine = Engine([replace(CROSSING, nets=CROSSING.nets[:2])], max_steps=6, rip_up={})
    # It crosses (0,0)-(1,0), turns up, and takes (1,1)-(2,1) as well.
    walk(engine, E, N, E, S)
    assert engine.metrics().joined == 1
    walk(engine, N, E, E, E, E)  # the way over the upper row is closed half-way
    assert (engine.metrics().joined, engine.metrics().wirelength) == (1, 6)
    walk(engine, E)
    # Its task has failed. The round begins: net 1 has given its edges back.
    assert engine.games[0]["agent"] == 0
    assert engine.metrics().joined == 0
    assert engine.metrics().wirelength == 2
    walk(engine, E, E)
    assert engine.metrics().joined == 1
    # Net 2 gives back its stub and is joined.
    walk(engine, N, E, E, S)
    assert engine.games[0]["agent"] == NOBODY
    assert (engine.metrics().joined, engine.metrics().wirelength) == (2, 6)
    assert evaluate(engine.problems[0], engine.solution()).connected


def test_a_round_that_is_worse_is_undone() -> None:
    engine = Engine([replace(CROSSING, nets=CROSSING.nets[:1])], max_steps=4, rip_up={})
    walk(engine, E, E)
    assert engine.metrics().wirelength == 0
    walk(engine, N, E, S, E)  # a detour: joined, but longer
    assert engine.games[0]["agent"] == NOBODY
    assert engine.metrics().wirelength == 2
    straight = engine.grid.ends(engine.solution().edges[0])
    assert [engine.grid.position[ends].tolist() for ends in straight] == [
        [[0, 0, 0], [1, 0, 0]],
        [[1, 0, 0], [2, 0, 0]],
    ]


def test_a_failed_task_gives_its_edges_back() -> None:
    problem = replace(CROSSING, nets=(net("1", (0, 0), (1, 0), (2, 1)),))
    for release_failed, wirelength in ((False, 3), (True, 1)):
        engine = Engine([problem], max_steps=3, release_failed=release_failed)
        walk(engine, E)  # joined
        walk(engine, W, N, N)  # over the own edge and up, then off the grid: failed
        assert engine.metrics().joined == 1
        assert engine.metrics().wirelength == wirelength - (not release_failed)


def test_agents_are_asked() -> None:
    asked = {"rounds": 2, "choose": "agents"}
    engine = Engine([CROSSING], nets={"order": "file"}, rip_up=asked, max_steps=5)
    walk(engine, E, E, N, E, E, S, N, N, N, N, N)
    before = engine.solution()
    assert engine.games[0]["asked"]
    masks = engine.masks(*engine.pairs(everyone=False))
    assert masks.tolist() == [[1, 0, 0, 0, 0, 0, 1]]
    walk(engine, 3)  # any of the six moves keeps the routes
    assert engine.solution() == before
    assert engine.games[0]["agent"] == 1
    walk(engine, RIP_UP)
    assert engine.masks(*engine.pairs(everyone=False))[0, RIP_UP] == 0
    assert not len(engine.solution().edges[1])
    walk(engine, RIP_UP)  # is a blocked move while the net walks
    walk(engine, N, E, E, S)
    assert engine.solution() == before
    walk(engine, 0)
    # In a round in which nobody gives way, the episode ends.
    walk(engine, 0, 0, 0)
    assert engine.games[0]["agent"] == NOBODY


def test_neighbours_come_by_and_by() -> None:
    problem = generate(1, grid=(4, 4, 2), nets=12, max_pins=3, capacity=1, seed=3)[0]
    rip_up = {"rounds": 8, "neighbours": 3}
    patient = Negotiation(prices=False, patience=2)
    engine = Engine([problem], rip_up=rip_up, negotiation=patient, max_steps=9)
    rng = np.random.default_rng(0)
    most = np.zeros(9, int)
    while engine.games[0]["agent"] != NOBODY:
        masks = engine.masks(*engine.pairs(everyone=False))
        engine.step(np.array([rng.choice(np.flatnonzero(masks[0]))]))
        number = engine.games[0]["round"]
        most[number] = max(most[number], engine.games[0]["ripped"])
    assert most.tolist()[1:] == [1, 1, 2, 2, 3, 3, 4, 4]


CHOICES = st.sampled_from(["all", "conflicts", "history", "agents"])
rounds = st.fixed_dictionaries(
    {
        "rip_up": st.fixed_dictionaries(
            {"rounds": st.just(3), "choose": CHOICES, "neighbours": st.sampled_from([0, 2])}
        ),
        "negotiation": st.sampled_from([None, Negotiation(prices=False, patience=1)]),
        "turn_order": st.sampled_from(["sequential", "round_robin"]),
        "overflow": st.sampled_from(["forbidden", "allowed"]),
        "target": st.sampled_from(["pin", "tree"]),
        "release_failed": st.booleans(),
    }
)


@given(rounds, st.integers(0, 999))
def test_no_round_makes_anything_worse(options: dict[str, Any], seed: int) -> None:
    problem = generate(1, grid=(5, 5, 2), nets=8, max_pins=3, capacity=1, seed=seed)
    engine = Engine(problem, max_steps=12, **options)
    guide, rng = AStar(engine), np.random.default_rng(seed)
    best = None
    while engine.games[0]["agent"] != NOBODY:
        game = engine.games[0]
        if game["round"] > 0 and (game["asked"] or game["active"] == 0):
            best = judged(engine, best)
        problems, agents = engine.pairs(everyone=False)
        mask = engine.masks(problems, agents)[0]
        if rng.random() < 0.7 and not game["asked"]:
            move = guide.moves(problems, agents)
        else:
            move = rng.choice(np.flatnonzero(mask), 1)
        was = engine.games[0]["just_ripped"]
        engine.step(np.asarray(move, np.int8))
        if engine.games[0]["just_ripped"] and not was:
            now = engine.games[0]
            kept = (-now["kept_joined"], now["kept_overflow"], now["kept_wirelength"])
            assert best is None or kept <= best
            best = kept
    _ = judged(engine, best)
    ended = evaluate(problem[0], engine.solution())
    now = engine.metrics()
    assert (ended.overflow, ended.wirelength) == (now.overflow, now.wirelength)
    assert ended.joined >= now.joined


@given(
    CHOICES,
    st.sampled_from(["sequential", "round_robin"]),
    st.sampled_from(["pin", "tree"]),
    st.integers(0, 999),
)
def test_nets_negotiate_and_end_with_the_best_routes(
    choose: Any, turn_order: Any, target: Any, seed: int
) -> None:
    """Prices rise where there is overflow; a state can be saved at any time and goes on alike."""
    problem = generate(1, grid=(5, 5, 2), nets=9, max_pins=3, capacity=1, seed=seed)
    engine = Engine(
        problem,
        turn_order=turn_order,
        target=target,
        max_steps=14,
        overflow="allowed",
        rip_up={"rounds": 12, "choose": choose, "neighbours": 1},
        negotiation=Negotiation(),
    )
    guide, rng = AStar(engine), np.random.default_rng(seed)
    scores, number, over = [], 0, np.zeros(engine.grid.edges, np.bool_)
    prices = option_state(engine, Option.PRICES)[0].copy()
    while engine.games[0]["agent"] != NOBODY:
        problems, agents = engine.pairs(everyone=False)
        move = guide.moves(problems, agents)
        if rng.random() < 0.3 or engine.games[0]["asked"]:
            move = rng.choice(np.flatnonzero(engine.masks(problems, agents)[0]), 1)
        engine.step(np.asarray(move, np.int8))
        game = engine.games[0]
        if game["round"] > number:
            number = game["round"]
            scores.append((-game["began_joined"], game["began_overflow"], game["began_wirelength"]))
            over = engine.dynamic.remaining[0] < 0
            risen = option_state(engine, Option.PRICES)[0] > prices
            if game["plain"] == 0 and not game["just_ripped"]:
                assert (risen == over).all() or number == 1
            prices = option_state(engine, Option.PRICES)[0].copy()
    now = engine.metrics()
    assert all((-now.joined, now.overflow, now.wirelength) <= score for score in scores)
    assert (now.overflow, now.wirelength) == (
        int(np.maximum(-engine.dynamic.remaining[0], 0).sum()),
        int(sum(map(len, engine.solution().edges))),
    )


def test_prices_part_two_nets() -> None:
    """Two nets on one track: the one that finds the free way nearly as short leaves, by itself."""
    wide_ = replace(CROSSING, nets=CROSSING.nets[:2])
    engine = Engine(
        [wide_], rip_up={"rounds": 40}, negotiation=Negotiation(), overflow="allowed", max_steps=6
    )
    walk(engine, E, E, E, E)
    assert engine.games[0]["began_overflow"] == 2
    prices = [0]
    while engine.games[0]["began_overflow"] > 0:
        assert engine.games[0]["plain"] == 0
        prices.append(int(option_state(engine, Option.PRICES)[0].max()))
        # Each in its turn tries the way over the upper row, which is two edges longer.
        walk(engine, N, E, E, S)
    assert prices == sorted(prices)
    assert len(set(prices)) > 2  # not at once: at first two edges more cost more than sharing
    assert engine.games[0]["began_wirelength"] == 6
    assert engine.games[0]["plain"] == 1


@pytest.mark.parametrize(("present", "overflow"), [(0.5, 2), (0.6, 0)])
def test_how_cheaply_nets_share_at_first(present: float, overflow: int) -> None:
    """Two nets share two edges. The other way takes four, which have no price.

    In the first round the two have grown dearer by 3/16, and ``present`` by a quarter: they cost
    2 (1 + 3/16) (1 + 1.25 present), which is 4 at 0.55.
    """
    problem = replace(CROSSING, nets=CROSSING.nets[:2])
    options: dict[str, Any] = {
        "negotiation": Negotiation(present_factor=present),
        "overflow": "allowed",
    }
    engine = Engine([problem], rip_up={"rounds": 2}, max_steps=6, **options)
    walk(engine, E, E, E, E)
    assert engine.games[0]["began_overflow"] == 2
    walk(engine, N, E, E, S)  # net 1 tries the other way
    walk(engine, E, E)
    assert engine.games[0]["round"] == 2
    assert engine.games[0]["began_overflow"] == overflow


def test_agents_that_are_not_there_have_no_routes() -> None:
    """Taking the best routes, nobody looks at tasks that belong to the next problem or to none."""
    more = net("4", (0, 1), (1, 0)), net("5", (2, 0), (0, 1))
    few, many = CROSSING, replace(CROSSING, nets=CROSSING.nets + more)
    engine = Engine(
        [few, many, few],
        target="tree",
        rip_up={"rounds": 5},
        negotiation=Negotiation(),
        overflow="allowed",
        max_steps=6,
    )
    rng = np.random.default_rng(0)
    while (engine.games["agent"] != NOBODY).any():
        masks = engine.masks(*engine.pairs(everyone=False))
        engine.step(np.array([rng.choice(np.flatnonzero(mask)) for mask in masks]))
    assert option_state(engine, Option.TREE)[:, :3].any(axis=2).all()
    assert option_state(engine, Option.TREE)[1].any(axis=1).all()
    assert not option_state(engine, Option.TREE)[[0, 2], 3:].any()


def judged(engine: Engine, best: Any) -> Any:
    """The present score, no worse than the best so far."""
    now = engine.metrics()
    score = (-now.joined, now.overflow, now.wirelength)
    assert best is None or score <= best
    return score


OPTIONS: dict[str, Any] = {
    "max_steps": 9,
    "target": "tree",
    "next_pin": "nearest",
    "mask": {"visited": True},
    "release_failed": True,
    "rip_up": {"rounds": 2, "neighbours": 1},
}
PROBLEM = generate(1, grid=(4, 4, 2), nets=4, max_pins=3, capacity=1, seed=3)[0]


@pytest.mark.parametrize("choose", ["all", "conflicts", "history", "agents"])
def test_every_interface_plays_the_same_rounds(choose: str) -> None:
    options = {**OPTIONS, "rip_up": {**OPTIONS["rip_up"], "choose": choose}}
    aec = game.env(PROBLEM, **options, turn_order="sequential")
    parallel = game.parallel_env(PROBLEM, **options, turn_order="sequential")
    single = GlobalRoutingSingle(PROBLEM, **options)
    batch = BatchEnv([PROBLEM], everyone=False, **options)
    rng = np.random.default_rng(0)
    aec.reset()
    _, infos = parallel.reset()
    seen, info = single.reset()
    rows, batch_info = batch.reset()
    total = dict.fromkeys(aec.possible_agents, 0.0)
    over = False
    while not over:
        mover = aec.agent_selection
        assert mover == info["net"]
        assert infos[mover].get("active", True)
        mask = info["action_mask"]
        for other in (aec.last()[4]["action_mask"], infos[mover]["action_mask"]):
            np.testing.assert_array_equal(other, mask)
        np.testing.assert_array_equal(batch_info["action_mask"][0, 0], mask)
        np.testing.assert_array_equal(aec.observe(mover), seen)
        np.testing.assert_array_equal(rows[0, 0], seen)
        move = int(rng.choice(np.flatnonzero(mask)))
        aec.step(move)
        total[mover] += aec.rewards[mover]
        _, paid, ended, cut, infos = parallel.step(
            dict.fromkeys(parallel.agents, 0) | {mover: move}
        )
        seen, reward, joined, failed, info = single.step(move)
        rows, batch_paid, *_, batch_info = batch.step(np.array([[move]]))
        assert paid[mover] == reward == batch_paid[0, 0]
        over = joined or failed
        assert over == batch_info["over"][0]
        assert all(ended[a] or cut[a] for a in ended) == over
        assert not over or not parallel.agents
    assert aec.terminations | aec.truncations
    assert all(aec.terminations[a] or aec.truncations[a] for a in aec.agents)
    assert aec.metrics() == parallel.metrics() == single.metrics()
    assert info["is_success"] == (joined and info["overflow"] == 0)
    assert aec.solution() == single.solution()


@pytest.mark.parametrize("choose", ["all", "agents"])
@pytest.mark.parametrize("more", [{}, {"mask": {"in_observation": True}, "reward": "team"}])
def test_pettingzoo_accepts_rounds(choose: str, more: dict[str, Any]) -> None:
    options = {**OPTIONS, "rip_up": {**OPTIONS["rip_up"], "choose": choose}, **more}
    parallel_api_test(game.parallel_env(PROBLEM, **options), 300)
    api_test(game.env(PROBLEM, **options), 300)


def test_only_the_generalist_negotiates() -> None:
    said = r"rip_up_\w+: unknown key; .*only the generalist negotiates by prices"
    for name in ("prices", "patience", "present", "calm"):
        option: dict[str, Any] = {f"rip_up_{name}": 1}
        for make in (game.env, game.parallel_env, GlobalRoutingSingle):
            with pytest.raises(TypeError, match=said):
                make(PROBLEM, **option)
        with pytest.raises(TypeError, match=said):
            BatchEnv([PROBLEM], **option)
        with pytest.raises(InputError, match=rf"env\.{said}"):
            load_config(None, [f"env.rip_up_{name}=1"])


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ({"target": "net"}, "target: expected one of pin, tree"),
        ({"next_pin": "best"}, "next_pin: expected one of listed, nearest"),
        (
            {"next_pin": "nearest", "nets": {"decomposition": "steiner"}},
            "next_pin: expected listed",
        ),
        (
            {"rip_up": "all"},
            "rip_up: expected a mapping of rounds, choose, neighbours or null, found 'all'",
        ),
        ({"rip_up": {"choose": "price"}}, "rip_up.choose: expected one of all, conflicts, history"),
        ({"rip_up": {"round": 1}}, "rip_up.round: unknown key; did you mean rounds"),
        ({"rip_up": {"rounds": -1}}, "rip_up.rounds: expected 0 to"),
        ({"rip_up": {"neighbours": 1000}}, "rip_up.neighbours: expected 0 to"),
        ({"negotiation": Negotiation()}, "prices: expected false, unless overflow is allowed"),
        ({"release_failed": 2}, "release_failed: expected true or false"),
        ({"mask": {"visited": "no"}}, "mask.visited: expected true or false"),
    ],
)
def test_bad_options(bad: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        Engine([PROBLEM], **bad)


def test_bad_options_of_negotiation() -> None:
    for bad, expected in [
        ({"patience": -1}, "patience: expected 0 to"),
        ({"prices": 1}, "prices: expected true or false"),
        ({"present_factor": 0}, "present_factor: expected 0.01 to 2, found 0"),
        ({"present_factor": float("nan")}, "present_factor: expected a number, found nan"),
        ({"present_factor": True}, "present_factor: expected a number, found True"),
        ({"step_decay": -0.1}, "step_decay: expected 0 to 1000, found -0.1"),
    ]:
        with pytest.raises(InputError, match=expected):
            Negotiation(**bad)  # type: ignore[arg-type]
