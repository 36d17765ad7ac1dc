"""The rules of the game: the engine side by side with a plain model of them, and by hand."""

from typing import Any

import networkx as nx
import numpy as np
import pytest
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from reference import Game, contested, edge_number, gcell_of, random_moves
from seeing import option_state

from marouting import Adjustment, Engine, InputError, Move, Net, Pin, Problem, evaluate, generate
from marouting.batch.prices import Negotiation
from marouting.batch.state import Option
from marouting.game import NOBODY, Crossing, Ending, Status
from marouting.problem.problem import UNLIMITED
from marouting.search.guides import AStar

E, W, N, S, U, D = Move

options = st.fixed_dictionaries(
    {
        "turn_order": st.sampled_from(["sequential", "round_robin"]),
        "nets": st.fixed_dictionaries(
            {
                "order": st.sampled_from(["half_perimeter", "half_perimeter_up", "file"]),
                "decomposition": st.sampled_from(["mst", "steiner"]),
            }
        ),
        "overflow": st.sampled_from(["forbidden", "allowed"]),
        "max_steps": st.sampled_from([1, 3, 10, 30]),
    }
)
extensions = st.fixed_dictionaries(
    {
        "target": st.sampled_from(["pin", "tree"]),
        "next_pin": st.sampled_from(["listed", "nearest"]),
        "mask": st.fixed_dictionaries({"visited": st.booleans()}),
        "release_failed": st.booleans(),
        "rip_up": st.none()
        | st.fixed_dictionaries(
            {
                "rounds": st.sampled_from([1, 2, 3]),
                "choose": st.sampled_from(["all", "conflicts", "history", "agents"]),
                "neighbours": st.sampled_from([0, 1, 2]),
            }
        ),
        "negotiation": st.builds(
            Negotiation,
            prices=st.booleans(),
            patience=st.sampled_from([0, 1]),
            present_factor=st.sampled_from([0.1, 0.6, 2]),
            step_decay=st.sampled_from([0, 0.3, 2]),
        ),
    }
)
seeds = st.integers(0, 2**32)
LIMIT = 300  # steps of an example


def compare(engine: Engine, game: Game) -> None:
    """Asserts that engine and model agree in all there is."""
    problem, capacity = game.problem, game.capacity
    records, agents = engine.agents[0], game.agents
    assert [gcell_of(problem, c) for c in records["cell"].tolist()] == [a.at for a in agents]
    targets = [gcell_of(problem, c) for c in records["target"].tolist()]
    assert targets == [a.target for a in agents]
    for name, kind in (("status", Status), ("crossing", Crossing), ("ending", Ending)):
        found = [kind(value).name for value in records[name].tolist()]
        assert found == [getattr(a, name) for a in agents], name
    for name in ("added_overflow", "joined", "steps"):
        assert records[name].tolist() == [getattr(a, name) for a in agents], name

    turn = engine.games[0]["agent"]
    assert turn == (NOBODY if game.turn is None else game.turn)
    assert engine.games[0]["active"] == len(game.active())

    remaining = np.zeros(engine.grid.edges, np.int64)
    for edge in capacity:
        left = game.remaining(edge)
        remaining[edge_number(problem, edge)] = UNLIMITED if left is None else left
    np.testing.assert_array_equal(engine.dynamic.remaining[0], remaining)
    for found, expected in zip(engine.solution().edges, game.solution().edges, strict=True):
        np.testing.assert_array_equal(found, expected)

    masks = engine.masks(*engine.pairs(everyone=True))
    assert masks.dtype == np.int8
    assert masks.any(axis=1).all()
    active = game.active()
    assert masks[active].tolist() == [game.action_mask(n) for n in active]

    now = engine.metrics()
    assert (now.overflow, now.wirelength) == (game.overflow_sum(), game.wirelength())
    assert now.steps == game.steps
    assert now.joined == sum(a.joined for a in agents)
    assert now.tasks == sum(len(a.tasks) for a in agents)


forms = st.sampled_from(["turn", "all", "mixed"])


@examples(60)
@given(contested(max_nets=8, max_capacity=2), options, st.just({}) | extensions, seeds, forms)
def test_engine_plays_by_the_rules(
    problem: Problem, chosen: dict[str, Any], more: dict[str, Any], seed: int, form: str
) -> None:
    chosen = {**chosen, **more}
    if "next_pin" in more and more["next_pin"] == "nearest":
        chosen["nets"] = {**chosen["nets"], "decomposition": "mst"}
    if "negotiation" in more and more["negotiation"].prices:
        chosen["overflow"] = "allowed"
    rng = np.random.default_rng(seed)
    engine, game = Engine([problem], **chosen), Game(problem, **chosen)
    assert engine.nets[0].tolist() == [a.net for a in game.agents]
    assert engine.tasks[0].tolist() == [len(a.tasks) for a in game.agents]
    compare(engine, game)
    while game.turn is not None and game.steps < LIMIT:
        moves = random_moves(engine, rng)
        if form == "all" or (form == "mixed" and rng.random() < 0.5):
            engine.step(moves)
            game.step_all(moves[0].tolist())
        else:
            engine.step(moves[:, game.turn])
            game.step(int(moves[0, game.turn]))
        compare(engine, game)
    if game.turn is None:
        # When it is over nothing moves any more.
        engine.step(random_moves(engine, rng))
        engine.step(np.array([0]))
        assert engine.metrics().steps == game.steps


@pytest.mark.parametrize("decay", [0, 0.3])
def test_nets_negotiate_again_and_again(decay: float) -> None:
    """Prices are as the model says, in games so long that they rise to the full and fall again."""
    negotiations, lasted = 0, False
    for seed in range(4):
        problem = generate(1, grid=(4, 4, 1), nets=9, max_pins=2, capacity=1, seed=seed)[0]
        rules: dict[str, Any] = {
            "turn_order": "sequential",
            "overflow": "allowed",
            "rip_up": {"rounds": 60},
            "negotiation": Negotiation(step_decay=decay),
            "max_steps": 8,
        }
        engine, game = Engine([problem], **rules), Game(problem, **rules)
        guide, rng, number = AStar(engine), np.random.default_rng(seed), 0
        while game.turn is not None:
            pairs = engine.pairs(everyone=False)
            move = guide.moves(*pairs)
            if rng.random() < 0.2:
                move = rng.choice(np.flatnonzero(engine.masks(*pairs)[0]), 1)
            engine.step(np.asarray(move, np.int8))
            game.step(int(move[0]))
            if game.round > number:
                number = game.round
                compare(engine, game)
                now, prices = engine.games[0], np.zeros(engine.grid.edges, np.int64)
                for edge, price in game.prices.items():
                    prices[edge_number(problem, edge)] = price
                np.testing.assert_array_equal(option_state(engine, Option.PRICES)[0], prices)
                assert (now["present"], now["plain"]) == (game.present, game.plain)
                assert now["negotiations"] == game.negotiations
                lasted |= game.present > 10 * game.first_present() and game.plain == 0
        assert number == 60
        negotiations = max(negotiations, game.negotiations)
    assert negotiations > 3
    assert lasted  # so long that overflow adds the most to prices


@given(contested(max_nets=10), options, seeds)
def test_what_must_hold_in_every_game(problem: Problem, chosen: dict[str, Any], seed: int) -> None:
    """Properties that need no model of the rules."""
    rng = np.random.default_rng(seed)
    engine = Engine([problem], **chosen)
    neighbour, edge = engine.grid.neighbour, engine.grid.edge
    while engine.games[0]["agent"] != NOBODY and engine.games[0]["steps"] < LIMIT:
        n = int(engine.games[0]["agent"])
        before = engine.agents[0, n].copy()
        grid, used = engine.dynamic.remaining.copy(), engine.dynamic.used.copy()
        mask = engine.masks(*engine.pairs(everyone=False))[0]
        moves = random_moves(engine, rng, wild=0.4)[:, n]
        move = int(moves[0])
        engine.move(moves)
        after = engine.agents[0, n]
        if after["crossing"] == Crossing.BLOCKED:
            # No blocked move changes the grid, and an allowed one is never blocked.
            assert after["cell"] == before["cell"]
            np.testing.assert_array_equal(engine.dynamic.remaining, grid)
            np.testing.assert_array_equal(engine.dynamic.used, used)
            assert not mask[move] or mask.all()
        else:
            assert mask[move]
            assert after["cell"] == neighbour[before["cell"], move]
            changed = np.flatnonzero(engine.dynamic.remaining[0] != grid[0])
            assert set(changed) <= {edge[before["cell"], move]}
        assert after["steps"] == before["steps"] + 1
        engine.settle(everyone=False)

    solution = engine.solution()
    judged, now = evaluate(problem, solution), engine.metrics()
    assert (judged.overflow, judged.wirelength) == (now.overflow, now.wirelength)
    if chosen["overflow"] == "forbidden":
        assert judged.overflow == 0
    # Capacity is conserved: what is taken is the demand of the routes.
    np.testing.assert_array_equal(
        engine.dynamic.remaining[0], problem.capacity - solution.edge_demand
    )

    records = engine.agents[0]
    for n, net in enumerate(engine.nets[0].tolist()):
        # Every walk begins at its task's start, a pin or a Steiner point: no piece is loose.
        graph = nx.Graph(zip(*engine.grid.ends(solution.edges[net]), strict=True))
        first, end = engine.static.first[0, n : n + 2]
        starts = set(engine.static.tasks[first:end, 0].tolist())
        if chosen["nets"]["decomposition"] == "mst":
            assert starts <= set(problem.pin_gcells[net].tolist())
        assert all(starts & part for part in nx.connected_components(graph))
        joined = records["joined"][n] == engine.tasks[0, n]
        if records["status"][n] != Status.ACTIVE:
            assert joined == (records["status"][n] == Status.TERMINATED)
        if joined:
            assert problem.nets[net].name not in judged.disconnected


@st.composite
def batches(draw: st.DrawFn) -> list[Problem]:
    """One to four problems of one grid shape with different numbers of nets."""
    grid = draw(st.sampled_from([(3, 3, 2), (5, 2, 1), (1, 4, 3)]))
    return draw(st.lists(contested(grid=grid), min_size=1, max_size=4))


def assert_same_play(batch: Engine, m: int, single: Engine) -> None:
    """Asserts that problem m of a batch stands as a game of its own does."""
    count = len(single.nets[0])
    for name in single.agents.dtype.names or ():
        shift = batch.static.first[m, 0] if name == "task" else 0
        np.testing.assert_array_equal(
            batch.agents[m, :count][name], single.agents[0][name] + shift, err_msg=name
        )
    assert (batch.agents["status"][m, count:] == Status.ABSENT).all()
    assert (batch.nets[m, count:] == NOBODY).all()
    assert batch.games[m] == single.games[0]
    np.testing.assert_array_equal(batch.dynamic.remaining[m], single.dynamic.remaining[0])
    np.testing.assert_array_equal(batch.dynamic.used[m, :count], single.dynamic.used[0])
    assert not batch.dynamic.used[m, count:].any()
    assert batch.metrics(m) == single.metrics()


@given(batches(), options, seeds, st.booleans())
def test_a_batch_is_its_problems_played_alone(
    problems: list[Problem], chosen: dict[str, Any], seed: int, everyone: bool
) -> None:
    rng = np.random.default_rng(seed)
    batch = Engine(problems, **chosen)
    singles = [Engine([problem], **chosen) for problem in problems]
    for _ in range(40):
        masks = batch.masks(*batch.pairs(everyone=True)).reshape(*batch.agents.shape, 6)
        moves = random_moves(batch, rng)
        turns = batch.games["agent"].copy()
        own = moves if everyone else moves[np.arange(len(problems)), turns]
        batch.step(own)
        for m, single in enumerate(singles):
            count = len(single.nets[0])
            np.testing.assert_array_equal(
                masks[m, :count], single.masks(*single.pairs(everyone=True))
            )
            assert masks[m].any(axis=1).all()
            single.step(moves[m : m + 1, :count] if everyone else own[m : m + 1])
            assert_same_play(batch, m, single)
    for m, single in enumerate(singles):
        assert batch.solution(m) == single.solution()


@given(batches(), options, seeds)
def test_reset_of_some_problems_leaves_the_others_alone(
    problems: list[Problem], chosen: dict[str, Any], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    engine, untouched = Engine(problems, **chosen), Engine(problems, **chosen)
    fresh = Engine(problems, **chosen)
    for _ in range(10):
        moves = random_moves(engine, rng)
        engine.step(moves)
        untouched.step(moves)
    which = rng.random(len(problems)) < 0.5
    engine.reset(which)
    for m, chosen_one in enumerate(which):
        like = fresh if chosen_one else untouched
        for state in ("remaining", "used", "agents", "games"):
            np.testing.assert_array_equal(
                getattr(engine.dynamic, state)[m], getattr(like.dynamic, state)[m], err_msg=state
            )
    engine.reset()
    for state in ("remaining", "used", "agents", "games"):
        np.testing.assert_array_equal(getattr(engine.dynamic, state), getattr(fresh.dynamic, state))


def assert_equal_play(one: Engine, other: Engine) -> None:
    """Asserts that two engines stand alike."""
    for state in ("remaining", "used", "agents", "games"):
        np.testing.assert_array_equal(
            getattr(one.dynamic, state), getattr(other.dynamic, state), err_msg=state
        )


@given(batches(), options, seeds, st.booleans())
def test_move_and_settle_make_a_step(
    problems: list[Problem], chosen: dict[str, Any], seed: int, everyone: bool
) -> None:
    rng = np.random.default_rng(seed)
    halves, whole = Engine(problems, **chosen), Engine(problems, **chosen)
    rows = np.arange(len(problems))
    for _ in range(40):
        moves = random_moves(halves, rng)
        if not everyone:
            moves = moves[rows, halves.games["agent"]]
        tasks = halves.agents["task"].copy()
        halves.move(moves)
        # After the first half nobody has begun another task: the place reached can be seen.
        np.testing.assert_array_equal(halves.agents["task"], tasks)
        arrived = halves.agents["ending"] == Ending.JOINED
        moved = halves.agents["crossing"] != Crossing.NONE
        if everyone:
            assert (halves.agents["cell"] == halves.agents["target"])[arrived & moved].all()
        halves.settle(everyone)
        whole.step(moves)
        assert_equal_play(halves, whole)


@given(contested(), options, seeds)
def test_turns_of_a_cycle_are_one_step_of_all(
    problem: Problem, chosen: dict[str, Any], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    chosen = {**chosen, "turn_order": "round_robin"}
    one_by_one, at_once = Engine([problem], **chosen), Engine([problem], **chosen)
    for _ in range(25):
        moves = random_moves(at_once, rng)
        active = at_once.agents["status"] == Status.ACTIVE
        for _ in range(int(active.sum())):
            one_by_one.step(moves[:, one_by_one.games[0]["agent"]])
        at_once.step(moves)
        for name in one_by_one.agents.dtype.names or ():
            # Whoever was out of the game before did not move: their last move is no matter.
            of = active if name in ("crossing", "ending", "added_overflow") else ...
            np.testing.assert_array_equal(
                one_by_one.agents[name][of], at_once.agents[name][of], err_msg=name
            )
        for name in set(one_by_one.games.dtype.names or ()) - {"turn"}:
            assert one_by_one.games[name] == at_once.games[name], name
        np.testing.assert_array_equal(one_by_one.dynamic.remaining, at_once.dynamic.remaining)
        np.testing.assert_array_equal(one_by_one.dynamic.used, at_once.dynamic.used)


@given(batches(), options, seeds, st.booleans())
def test_nobody_moves_nothing(
    problems: list[Problem], chosen: dict[str, Any], seed: int, everyone: bool
) -> None:
    rng = np.random.default_rng(seed)
    engine = Engine(problems, **chosen)
    for _ in range(5):
        engine.step(random_moves(engine, rng))
    remaining, used = engine.dynamic.remaining.copy(), engine.dynamic.used.copy()
    agents, games = engine.agents.copy(), engine.games.copy()
    shape = engine.agents.shape if everyone else len(problems)
    engine.step(np.full(shape, NOBODY))
    np.testing.assert_array_equal(engine.dynamic.remaining, remaining)
    np.testing.assert_array_equal(engine.dynamic.used, used)
    for name in ("cell", "target", "task", "steps", "joined", "status"):
        np.testing.assert_array_equal(engine.agents[name], agents[name])
    for name in ("active", "joined", "steps", "overflow", "wirelength"):
        np.testing.assert_array_equal(engine.games[name], games[name])
    if everyone:
        np.testing.assert_array_equal(engine.games["agent"], games["agent"])
        assert (engine.agents["crossing"] == Crossing.NONE).all()
        assert (engine.agents["ending"] == Ending.NONE).all()


# By hand ----------------------------------------------------------------------------------------

# Four Gcells in a row, two layers, capacity 1 in layer 1. Net A has three pins, net B two.
ROW = Problem(
    grid=(4, 1, 2),
    vertical_capacity=(0, 0),
    horizontal_capacity=(1, 1),
    nets=(
        Net("B", 0, (Pin(1, 0, 1), Pin(2, 0, 1))),
        Net("dot", 1, (Pin(0, 0, 1), Pin(0, 0, 1))),
        Net("A", 2, (Pin(1, 0, 1), Pin(0, 0, 1), Pin(3, 0, 1))),
    ),
    min_width=(1, 1),
    min_spacing=(0, 0),
    via_spacing=(0, 0),
)


def play(engine: Engine, *moves: int) -> list[tuple[str, str]]:
    """What a row of turns does: crossing and ending of every move."""
    found = []
    for move in moves:
        n = engine.games[0]["agent"]
        engine.step(np.array([move]))
        record = engine.agents[0, n]
        found.append((Crossing(record["crossing"]).name, Ending(record["ending"]).name))
    return found


def test_an_episode_by_hand() -> None:
    engine = Engine([ROW], max_steps=4)
    assert engine.nets.tolist() == [[0, 2]]  # "dot" has nothing to route
    assert engine.games[0]["agent"] == 1  # A is larger
    # First task of A: from x = 1 to x = 0. Off the grid, then there.
    assert play(engine, N, W) == [("BLOCKED", "NONE"), ("NEW", "JOINED")]
    # Second: from x = 1 again, to x = 3; back and forth over the edge of the first task.
    assert engine.grid.position[engine.agents[0, 1]["cell"]].tolist() == [1, 0, 0]
    assert play(engine, W, E) == [("OWN", "NONE")] * 2
    assert play(engine, E, E) == [("NEW", "NONE"), ("NEW", "JOINED")]
    assert engine.agents["status"][0].tolist() == [Status.ACTIVE, Status.TERMINATED]
    # B finds its edge taken and goes by layer 2.
    assert engine.masks(*engine.pairs(everyone=False)).tolist() == [[0, 0, 0, 0, 1, 0]]
    assert play(engine, E, U, E, D) == [
        ("BLOCKED", "NONE"),
        ("NEW", "NONE"),
        ("NEW", "NONE"),
        ("NEW", "JOINED"),
    ]
    assert engine.games[0]["agent"] == NOBODY
    now = engine.metrics()
    assert (now.overflow, now.wirelength, now.joined, now.tasks, now.steps) == (0, 6, 3, 3, 10)
    judged = evaluate(ROW, engine.solution())
    assert (judged.wirelength, judged.vias, judged.connected) == (6, 2, True)


def test_a_failed_task_truncates_after_the_last() -> None:
    engine = Engine([ROW], max_steps=2)
    # The first task fails, what it used stays used, and the second begins at its own start.
    assert play(engine, U, D) == [("NEW", "NONE"), ("OWN", "FAILED")]
    assert play(engine, E, E) == [("NEW", "NONE"), ("NEW", "JOINED")]
    assert engine.agents["status"][0].tolist() == [Status.ACTIVE, Status.TRUNCATED]
    assert engine.metrics().wirelength == 3
    assert not evaluate(ROW, engine.solution()).connected


def test_reaching_the_target_with_the_last_step_is_joined() -> None:
    engine = Engine([ROW], max_steps=1)
    assert play(engine, W, E, U) == [("NEW", "JOINED"), ("NEW", "FAILED"), ("NEW", "FAILED")]
    assert engine.agents["status"][0].tolist() == [Status.TRUNCATED, Status.TRUNCATED]


def test_overflow_is_counted_beyond_capacity_only() -> None:
    engine = Engine([ROW], overflow="allowed", nets={"order": "file"}, turn_order="round_robin")
    play(engine, E, E)  # B, then A, over the same edge of capacity 1
    assert engine.agents[0, 1]["added_overflow"] == 1
    assert engine.metrics().overflow == 1
    assert engine.masks(*engine.pairs(everyone=True)).tolist() == [[1, 1, 0, 0, 1, 0]] * 2
    play(engine, W)  # A goes back over its own edge: nothing more
    assert engine.agents[0, 1]["added_overflow"] == 0
    assert engine.metrics().overflow == 1


def test_boxed_in_agents_get_all_ones() -> None:
    walled = Problem(
        grid=(3, 1, 1),
        vertical_capacity=(0,),
        horizontal_capacity=(0,),
        nets=(Net("A", 0, (Pin(0, 0, 1), Pin(2, 0, 1))),),
        min_width=(1,),
        min_spacing=(0,),
        via_spacing=(0,),
        adjustments=(Adjustment(1, 0, 1, 2, 0, 1, 1),),
    )
    engine = Engine([walled], max_steps=3)
    assert engine.masks(*engine.pairs(everyone=True)).tolist() == [[1] * 6]
    assert play(engine, E, E, E) == [("BLOCKED", "NONE")] * 2 + [("BLOCKED", "FAILED")]
    assert engine.metrics().wirelength == 0
    # Also asked for when the episode is over, a mask is never all zero.
    assert engine.masks(*engine.pairs(everyone=False)).tolist() == [[1] * 6]


@pytest.mark.parametrize(
    ("order", "first"), [("half_perimeter", 1), ("half_perimeter_up", 0), ("file", 0)]
)
def test_net_order(order: Any, first: int) -> None:
    engine = Engine([ROW], nets={"order": order})
    assert engine.games[0]["agent"] == first


@pytest.mark.parametrize(("grid", "steps"), [((8, 8, 2), 50), ((12, 13, 1), 50), ((20, 9, 1), 58)])
def test_default_of_max_steps(grid: tuple[int, int, int], steps: int) -> None:
    layers = (9,) * grid[2]
    nets = (Net("A", 0, (Pin(0, 0, 1), Pin(1, 0, 1))),)
    problem = Problem(grid, layers, layers, nets, layers, layers, layers)
    assert Engine([problem]).max_steps == steps


def test_views_are_those_of_now() -> None:
    engine = Engine([ROW])
    agents, games = engine.agents, engine.games
    play(engine, E)
    engine.reset()
    play(engine, U)
    assert games[0]["steps"] == 1
    assert engine.grid.position[agents[0, 1]["cell"]].tolist() == [1, 0, 1]


# What cannot be used ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ({"turn_order": "random"}, "turn_order: expected one of"),
        ({"nets": {"order": "largest"}}, "nets.order: expected one of"),
        ({"overflow": True}, "overflow: expected one of"),
        ({"nets": {"decomposition": "tree"}}, "nets.decomposition: expected one of"),
        ({"max_steps": 0}, "max_steps: expected 1 to 1000000, found 0"),
    ],
)
def test_bad_options(bad: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected) as caught:
        Engine([ROW], **bad)
    assert "\n" not in str(caught.value)


def test_bad_problems() -> None:
    dot = Problem((1, 1, 1), (1,), (1,), (Net("A", 0, (Pin(0, 0, 1),)),), (1,), (0,), (0,))
    other = Problem(
        (4, 1, 1), (1,), (1,), (Net("A", 0, (Pin(0, 0, 1), Pin(3, 0, 1))),), (1,), (0,), (0,)
    )
    with pytest.raises(InputError, match="expected at least one"):
        Engine([])
    with pytest.raises(InputError, match="expected one grid shape"):
        Engine([ROW, other])
    with pytest.raises(InputError, match="problem 0: expected a net with pins in two Gcells"):
        Engine([dot])


@pytest.mark.parametrize(
    "moves",
    [
        np.array([6]),
        np.array([-2]),
        np.array([[0, 7]]),
        np.array([0, 0]),  # two problems' moves for one
        np.zeros((1, 3), np.int8),  # three agents' moves for two
        np.zeros((2, 2), np.int8),
        np.zeros((1, 2, 1), np.int8),
        np.array(0),
        np.array([], np.int8),
    ],
    ids=str,
)
def test_bad_moves(moves: NDArray[np.integer]) -> None:
    engine = Engine([ROW])
    for act in (engine.step, engine.move):
        with pytest.raises(ValueError, match="actions: expected"):
            act(moves)
    assert engine.metrics().steps == 0


@pytest.mark.parametrize("which", [np.ones(2, bool), np.array([0]), np.array(True)], ids=str)
def test_bad_reset(which: NDArray[Any]) -> None:
    engine = Engine([ROW])
    play(engine, E)
    with pytest.raises(ValueError, match="which: expected 1 booleans"):
        engine.reset(which)
    assert engine.metrics().steps == 1
