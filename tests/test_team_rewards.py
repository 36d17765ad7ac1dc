"""Rewards for nets that share add up to what happened, in every interface and any mixture."""

from typing import Any

import numpy as np
import pytest
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from reference import contested

from marouting import InputError, Net, Pin, Problem, generate, global_routing_v0
from marouting.config import component
from marouting.env.single import GlobalRoutingSingle
from marouting.game import NOBODY, Ending, Game
from marouting.rewards import PricedReward, Prices, prices_of
from marouting.vector import BatchEnv
from policies.learned.config import load_config
from policies.learned.trainer import Trainer

seeds = st.integers(0, 2**32)
plain = {
    "seed": st.integers(0, 1000),
    "overflow": st.sampled_from(["forbidden", "allowed"]),
    "turn_order": st.sampled_from(["sequential", "round_robin"]),
    "max_steps": st.sampled_from([3, 12]),
}
games = st.fixed_dictionaries(
    {
        **plain,
        "target": st.sampled_from(["pin", "tree"]),
        "release_failed": st.booleans(),
        "rip_up": st.none()
        | st.fixed_dictionaries(
            {
                "rounds": st.sampled_from([2]),
                "choose": st.sampled_from(["all", "conflicts", "history", "agents"]),
                "neighbours": st.sampled_from([0, 2]),
            }
        ),
    }
)
prices = st.fixed_dictionaries(
    {name: st.floats(0, 50, width=16) for name in ("overflow", "open", "wirelength")}
)

rewards = st.one_of(
    st.builds(
        lambda kind, own: {"kind": kind, **own},
        st.sampled_from(["team", "difference", "counterfactual"]),
        prices,
    ),
    st.sampled_from(
        [
            {"kind": "paper", "overflow_price": 2.5, "own_edge": 0.0},
            {"kind": "potential", "gamma": 0.9, "scale": 0.5},
            {
                "kind": "mixed",
                "parts": [
                    {"kind": "paper", "weight": 0.1},
                    {"kind": "team", "weight": -0.5},
                    {"kind": "counterfactual"},
                    {"kind": "mixed", "parts": [{"kind": "potential"}], "weight": 2.0},
                ],
            },
        ]
    ),
)


def masked_moves(rng: np.random.Generator, mask: NDArray[np.int8]) -> NDArray[np.int8]:
    """(M, K) random moves, most often allowed ones."""
    wanted = rng.random(mask.shape) + mask * (rng.random(mask.shape[:2]) < 0.9)[..., None]
    return wanted.argmax(axis=-1).astype(np.int8)


def play(game: dict[str, Any], reward: dict[str, Any]) -> tuple[Any, dict[str, float], set[str]]:
    """A random episode: the environment, what each net was paid, and who played to the end."""
    options = dict(game)
    problem = generate(1, grid=(4, 4, 2), nets=5, max_pins=3, capacity=1, seed=options.pop("seed"))
    env = global_routing_v0.parallel_env(problem[0], reward=reward, **options)
    rng = np.random.default_rng(game["seed"])
    env.reset()
    paid, last = dict.fromkeys(env.agents, 0.0), set()
    while env.agents:
        last = set(env.agents)
        moves = {agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents}
        _, rewards, *_ = env.step(moves)
        for agent, reward_now in rewards.items():
            paid[agent] += reward_now
    return env, paid, last


def gained(env: Any, prices: dict[str, float]) -> float:
    """By how much the cost of a problem fell during an episode."""
    end = env.metrics()
    return (
        prices["open"] * end["joined"]
        - prices["overflow"] * end["overflow"]
        - prices["wirelength"] * end["wirelength"]
    )


@given(games, prices)
def test_differences_add_up_to_the_change_of_the_metrics(game: Any, prices: Any) -> None:
    env, paid, _ = play(game, {"kind": "difference", **prices})
    assert sum(paid.values()) == pytest.approx(gained(env, prices), abs=0.05)


@given(games, prices)
def test_a_member_of_the_team_that_stays_is_paid_the_whole_change(game: Any, prices: Any) -> None:
    env, paid, last = play(game, {"kind": "team", **prices})
    # Within a step, those who are done no longer see what others do after them.
    played = env.unwrapped.game
    order = [f"net_{played.nets[n]}" for n in played.order]
    agent = next(agent for agent in reversed(order) if agent in last)
    assert paid[agent] == pytest.approx(gained(env, prices), abs=0.05)


@given(games, prices)
def test_all_of_a_team_that_stays_are_paid_the_whole_change(game: Any, prices: Any) -> None:
    env, paid, _ = play({**game, "agents_persist": True}, {"kind": "team", **prices})
    assert list(paid.values()) == pytest.approx([gained(env, prices)] * 5, abs=0.05)


class ByColumns(PricedReward):
    """A reward by its columns' form: the player does not know its prices."""

    def __init__(self, **options: Any) -> None:
        self.reward: Any = component("reward", options, where="reward").make()

    @property
    def prices(self) -> Prices:
        found = prices_of(self.reward)
        assert found is not None
        return found


@examples(60)
@given(contested(max_nets=6), games, st.booleans(), rewards, seeds)
def test_compiled_rewards_are_those_by_columns(
    problem: Problem, game: Any, everyone: bool, reward: Any, seed: int
) -> None:
    options = {**game, "everyone": everyone}
    del options["seed"]
    batches = [
        BatchEnv([problem, generate(1, problem.grid, nets=3, seed=seed)[0]], reward=one, **options)
        for one in (reward, ByColumns(**reward))
    ]
    compiled, by_columns = batches
    assert compiled._players[0].fast.pays_prices
    assert not by_columns._players[0].fast.pays_prices
    rng = np.random.default_rng(seed)
    for batch in batches:
        batch.reset()
    for _ in range(40):
        info = compiled._info()
        moves = masked_moves(rng, info["action_mask"])
        steps = [batch.step(moves) for batch in batches]
        np.testing.assert_allclose(steps[0][1], steps[1][1], rtol=1e-5, atol=1e-3)
        np.testing.assert_array_equal(steps[0][0], steps[1][0])


@given(games, rewards)
def test_environments_pay_as_the_columns_form_does(game: Any, reward: Any) -> None:
    """Prices for the mover and the team have a form of their own for a single game."""
    options = dict(game)
    problem = generate(1, (4, 4, 2), nets=5, max_pins=3, capacity=1, seed=options.pop("seed"))[0]
    envs = [
        global_routing_v0.parallel_env(problem, reward=one, **options)
        for one in (reward, ByColumns(**reward))
    ]
    rng = np.random.default_rng(game["seed"])
    for env in envs:
        env.reset()
    while envs[0].agents:
        moves = {agent: int(rng.integers(6)) for agent in envs[0].agents}
        paid, by_columns = (env.step(moves)[1] for env in envs)
        assert paid == pytest.approx(by_columns, rel=1e-5, abs=1e-3)


def accounted_for(game: Game, n: int, prices: Any, failures: dict[int, int]) -> float:
    """The cost that a net accounts for, computed from nothing but routes and capacities."""
    without = dict.fromkeys(range(len(game.capacity)), 0)
    whole = dict(without)
    for other, used in enumerate(game.used):
        for edge in used:
            if edge % 3 != 2:
                demand = game.demand[other][edge // 3 % game.layers]
                whole[edge] += demand
                without[edge] += demand * (other != n)
    overflow = sum(
        max(whole[edge] - game.capacity[edge], 0) - max(without[edge] - game.capacity[edge], 0)
        for edge in whole
    )
    open_tasks = len(game.tasks[n]) - game.joined[n] + failures.get(n, 0)
    return (
        prices["overflow"] * overflow
        + prices["open"] * open_tasks
        + prices["wirelength"] * len(game.used[n])
    )


@examples(40)
@given(
    contested(max_nets=5),
    st.fixed_dictionaries({**plain, "release_failed": st.booleans()}),
    prices,
    seeds,
)
def test_counterfactuals_add_up_to_what_each_net_accounts_for(
    problem: Problem, options: Any, prices: Any, seed: int
) -> None:
    options = {name: value for name, value in options.items() if name != "seed"}
    reward = {"kind": "counterfactual", **prices}
    env = global_routing_v0.parallel_env(problem, reward=reward, agents_persist=True, **options)
    env.reset()
    played, rng = env.unwrapped.game, np.random.default_rng(seed)
    begin = {n: prices["open"] * len(tasks) for n, tasks in enumerate(played.tasks)}
    paid, failures = dict.fromkeys(begin, 0.0), dict.fromkeys(begin, 0)
    move = Game.move

    def watched(game: Game, n: int, action: int) -> None:
        move(game, n, action)
        if game.ending[n] == Ending.FAILED:
            for other in shut_in_by(game, n):
                failures[other] += 1

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Game, "move", watched)
        while env.agents:
            moves = {a: int(rng.choice(np.flatnonzero(env.action_mask(a)))) for a in env.agents}
            _, rewards, *_ = env.step(moves)
            for n, net in enumerate(played.nets):
                paid[n] += rewards[f"net_{net}"]
    for n in paid:
        whole = begin[n] - accounted_for(played, n, prices, failures)
        assert paid[n] == pytest.approx(whole, abs=0.05)


def shut_in_by(game: Game, n: int) -> list[int]:
    """The nets each of which alone keeps agent n from its target."""

    def reaches(without: int) -> bool:
        reached, last = {game.cell[n]}, None
        while last != len(reached):
            last = len(reached)
            for cell in list(reached):
                layer = cell % game.layers
                for _, edge, ahead in game.grid.exits_of[cell]:
                    left = game.remaining[edge]
                    if without != NOBODY and edge in game.used[without]:
                        left += game.demand[without][layer]
                    if edge % 3 == 2 or edge in game.used[n] or left >= game.demand[n][layer]:
                        reached.add(ahead)
        return game.target[n] in reached

    if game.overflow_allowed or reaches(NOBODY):  # where no edge is closed, nobody is in the way
        return []
    return [other for other in range(len(game.nets)) if other != n and reaches(other)]


def test_nobody_stands_in_the_way_where_overflow_is_allowed() -> None:
    """The same two nets: the second may cross the full edge, and fails because it does not."""
    nets = Net("a", 0, (Pin(0, 0, 1), Pin(1, 0, 1))), Net("b", 1, (Pin(0, 0, 1), Pin(1, 0, 1)))
    problem = Problem((2, 1, 1), (0,), (1,), nets, (1,), (0,), (0,))
    options = {"max_steps": 2, "overflow": "allowed", "release_failed": True}
    reward = {"kind": "counterfactual", "open": 20}
    env = BatchEnv([problem], reward=reward, **options)
    parallel = global_routing_v0.parallel_env(
        problem, reward=reward, agents_persist=True, **options
    )
    env.reset()
    parallel.reset()
    for moves in ([0, 1], [0, 1]):  # net a goes east, net b west, where the grid ends
        paid = env.step(np.array([moves], np.int8))[1]
        _, rewards, *_ = parallel.step(dict(zip(["net_0", "net_1"], moves, strict=True)))
        assert paid.tolist() == [list(rewards.values())]
    assert paid.tolist() == [[0, 0]]


def test_who_stands_in_the_way_is_charged() -> None:
    """Two nets want the only track between two Gcells, and the first one to move gets it."""
    nets = Net("a", 0, (Pin(0, 0, 1), Pin(1, 0, 1))), Net("b", 1, (Pin(0, 0, 1), Pin(1, 0, 1)))
    problem = Problem((2, 1, 1), (0,), (1,), nets, (1,), (0,), (0,))
    env = BatchEnv([problem], reward={"kind": "counterfactual", "open": 20}, max_steps=2)
    env.reset()
    east = np.zeros((1, 2), np.int8)
    _, paid, ended, _, info = env.step(east)
    assert paid.tolist() == [[20 - 1, 0]]
    assert ended.tolist() == [[True, False]]
    _, paid, _, cut, info = env.step(east)
    assert paid.tolist() == [[-20, 0]]
    assert cut.tolist() == [[False, True]]
    assert info["over"].all()
    team = BatchEnv([problem], reward={"kind": "team", "open": 20}, max_steps=2)
    team.reset()
    assert team.step(east)[1].tolist() == [[19, 19]]


@given(st.fixed_dictionaries(plain), st.sampled_from([0.25, 1.0, 3.0]))
def test_potentials_pay_the_way_from_start_to_target(game: Any, scale: float) -> None:
    env, paid, _ = play(game, {"kind": "potential", "scale": scale})
    played = env.unwrapped.game
    for n, tasks in enumerate(played.tasks):
        whole = scale * sum(played.grid.distance(start, target) for start, target in tasks)
        agent = f"net_{played.nets[n]}"
        if played.joined[n] == len(tasks):
            assert paid[agent] == pytest.approx(whole, abs=0.01)
        assert paid[agent] <= whole + 0.01


@given(games)
def test_a_mixture_is_the_weighted_sum(game: Any) -> None:
    parts: list[dict[str, Any]] = [
        {"kind": "paper"},
        {"kind": "team", "open": 3.0},
        {"kind": "potential", "gamma": 0.5},
    ]
    weights = [1, -0.5, 2.0]
    mixed = [{**part, "weight": w} for part, w in zip(parts, weights, strict=True)]
    _, paid, _ = play(game, {"kind": "mixed", "parts": mixed})
    alone = [play(game, part)[1] for part in parts]
    for agent in paid:
        expected = sum(w * own[agent] for w, own in zip(weights, alone, strict=True))
        assert paid[agent] == pytest.approx(expected, abs=0.05)


def test_hand_worked() -> None:
    """One net from corner to corner of 2x1x2: a via, an edge, a via."""
    problem = generate(1, grid=(2, 1, 2), nets=1, capacity=1, reduced_edges=0)[0]
    env = GlobalRoutingSingle(problem, reward={"kind": "team", "open": 7, "wirelength": 2})
    env.reset()
    east = int(problem.pin_gcells[0][0] == 0)
    move = 0 if east else 1
    assert env.step(4)[1] == -2
    assert env.step(4)[1] == 0  # blocked
    assert env.step(5)[1] == 0  # the net has this edge already
    _, paid, joined, _, _ = env.step(move)
    assert paid == 7 - 2
    assert joined


def test_trainings_and_batches_take_them() -> None:
    reward = {"kind": "mixed", "parts": [{"kind": "difference"}, {"kind": "potential"}]}
    batch = BatchEnv(generate(2, nets=4), reward=reward)
    batch.reset()
    assert batch.step(np.full((2, 4), 4))[1].any()
    config = load_config(
        None,
        [
            "env.reward={kind: mixed, parts: [{kind: team, weight: 0.5}, {kind: paper}]}",
            "env.problem.nets=3",
            "train.episodes=3",
            "learner.burn_in_size=50",
        ],
    )
    trainer = Trainer({"p": generate(1, nets=3)[0]}, config)
    episodes = [episode for done in trainer.run() for episode in done]
    assert len(episodes) == 3


class OnlyPays:
    """A reward in the simple form."""

    def pay(self, *_: Any) -> float:
        return 1.0


@pytest.mark.parametrize(
    ("reward", "message"),
    [
        ({"kind": "team", "opne": 1}, "reward.opne: unknown key; did you mean open"),
        ({"kind": "potential", "gamma": 2}, "gamma: expected 0 to 1"),
        ({"kind": "mixed", "parts": []}, "parts: expected at least one reward"),
        ({"kind": "mixed", "parts": [{"kind": "tame"}]}, "parts.0: unknown reward 'tame'; did you"),
        ({"kind": "mixed", "parts": [{"weight": "much"}]}, "parts.0.weight: expected a number"),
        ({"kind": "mixed", "parts": [{"weight": 1e300}]}, r"parts.0.weight: expected -1e\+06 to"),
        ({"kind": "mixed", "parts": ["paper"]}, "parts.0: expected a mapping with the key kind"),
        ({"kind": "team", "open": 1e39}, r"open: expected -1e\+30 to"),
        ({"kind": "potential", "scale": -1e31}, r"scale: expected -1e\+30 to"),
        (
            {"kind": "mixed", "parts": [{"kind": "paper"}, {"kind": f"{__name__}:OnlyPays"}]},
            "reward.parts.1: expected a reward that has __call__, not pay alone, found OnlyPays",
        ),
        (
            {"kind": "mixed", "parts": [{"kind": f"{__name__}:OnlyPays", "price": 2}]},
            "^reward.parts.0.price: unknown key; expected none for the reward .*:OnlyPays$",
        ),
    ],
)
def test_rewards_that_cannot_be_used(reward: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        global_routing_v0.env(reward=reward)
