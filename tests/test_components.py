"""Own observations and rewards: the same in every face, in the batch and for the array player.

One game is played in AEC; the moves are played again in the Parallel and Gymnasium environments and
in the batch, and everything that agents see and get is compared. Components by name: registered
ones, ``module:Class`` and objects.
"""

import math
from collections.abc import Callable
from dataclasses import InitVar, dataclass, field
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from reference import contested

import marouting
from marouting import (
    Engine,
    EnvOptions,
    InputError,
    PaperObservation,
    PaperReward,
    Problem,
    generate,
    global_routing_v0,
    registry,
)
from marouting.batch.state import Dynamic
from marouting.columns import Before, Games
from marouting.config import component, plain
from marouting.env.single import GlobalRoutingSingle
from marouting.game import NOBODY, Ending, Game
from marouting.options import GameOptions
from marouting.player import Player
from marouting.rewards import Prices
from marouting.vector import BatchEnv

HERE = __name__


class Crowd:
    """The paper's numbers, how many nets still route, and where all others stand."""

    def __init__(self, scale: float = 1.0) -> None:
        self.paper, self.scale = PaperObservation(), scale

    def space(self, problems: Any, overflow: bool) -> Box:
        size = self.paper.space(problems, overflow).shape[0] + 2
        return Box(-np.inf, np.inf, (size,), np.float32)

    def write(
        self, engine: Engine, problems: NDArray[Any], agents: NDArray[Any], out: NDArray[Any]
    ) -> None:
        self.paper.write(engine, problems, agents, out[:, :-2])
        there = agents != NOBODY
        out[:, -2] = there * self.scale * (engine.agents["status"] == 0).sum(axis=1)[problems]
        out[:, -1] = there * engine.agents["cell"].sum(axis=1)[problems]


class Picture:
    """An observation of two dimensions: the distance to the target, and the remaining capacity."""

    def space(self, problems: Any, overflow: bool) -> Box:
        del problems, overflow
        return Box(-np.inf, np.inf, (2, 3), np.float32)

    def write(
        self, engine: Engine, problems: NDArray[Any], agents: NDArray[Any], out: NDArray[Any]
    ) -> None:
        seen = np.zeros((len(agents), 12), np.float32)
        PaperObservation().write(engine, problems, agents, seen)
        out[:, 0], out[:, 1] = seen[:, 3:6], seen[:, 6:9]


class Team:
    """Every net gets the change in wirelength and overflow, and what tells the states apart."""

    def __init__(self, price: float = 10.0, share: float = 1.0) -> None:
        self.price, self.share = price, share

    def __call__(self, games: Games, before: Before, movers: NDArray[np.int32]) -> Any:
        now, then = games.games, before.games
        change = then["wirelength"] - now["wirelength"]
        change = change + self.price * (then["overflow"] - now["overflow"])
        # Where everybody stands, before and after, and what is left: nothing of it may differ.
        seen = games.agents["cell"].sum(axis=1) - 2.0 * before.agents["cell"].sum(axis=1)
        left = games.remaining.sum(axis=1) - before.remaining.sum(axis=1)
        every, mover = np.arange(len(movers)), np.maximum(movers, 0)
        used = games.uses(every, mover, games.grid.edge[before.agents["cell"][every, mover], 0])
        whole = change + seen / 64 + left / 4 + used / 8
        number = np.arange(games.nets.shape[1])
        return self.share * whole[:, None] + number + 100.0 * (number == movers[:, None])


def walk(problem: Problem, seed: int, **options: Any) -> dict[str, Any]:
    """A game in AEC by random moves: moves, observations at every turn, rewards of every move."""
    env = global_routing_v0.raw_env(problem, **options)
    env.reset()
    rng = np.random.default_rng(seed)
    turns, total = [], dict.fromkeys(env.agents, 0.0)
    for agent in env.agent_iter():
        obs, reward, terminated, truncated, info = env.last()
        total[agent] += reward
        if terminated or truncated:
            env.step(None)
            continue
        move = int(rng.choice(np.flatnonzero(info["action_mask"])))
        turn = {"agent": agent, "obs": obs, "mask": info["action_mask"], "move": move}
        env.step(move)
        turns.append({**turn, "rewards": dict(env.rewards), "over": env.terminations[agent]})
    return {"turns": turns, "total": total, "metrics": env.metrics()}


def rounds(turns: list[dict[str, Any]], sequential: bool) -> list[list[dict[str, Any]]]:
    """Turns as rounds, in which every agent that is left moves once."""
    if sequential:
        return [[turn] for turn in turns]
    found: list[list[dict[str, Any]]] = []
    for turn in turns:
        if not found or turn["agent"] in {other["agent"] for other in found[-1]}:
            found.append([])
        found[-1].append(turn)
    return found


COMPONENTS: dict[str, dict[str, Any]] = {
    "paper": {},
    "team": {"reward": {"kind": f"{HERE}:Team", "price": 3}},
    "crowd": {"observation": {"kind": f"{HERE}:Crowd", "scale": 2}},
    "both": {"observation": f"{HERE}:Crowd", "reward": Team(share=0.5)},
    "picture": {"observation": Picture(), "reward": Team()},
}


@given(
    contested(max_nets=6),
    st.sampled_from(sorted(COMPONENTS)),
    st.sampled_from(["sequential", "round_robin"]),
    st.sampled_from(["forbidden", "allowed"]),
    st.integers(0, 1000),
)
def test_the_same_moves_give_the_same_everywhere(
    problem: Problem, components: str, order: Any, overflow: Any, seed: int
) -> None:
    options = {**COMPONENTS[components], "turn_order": order, "overflow": overflow, "max_steps": 6}
    game = walk(problem, seed, **options)
    turns = game["turns"]

    # What moves pay all agents, those that are done among them.
    persistent = global_routing_v0.raw_env(problem, agents_persist=True, **options)
    persistent.reset()
    for turn in turns:
        while persistent.agent_selection != turn["agent"]:
            persistent.step(4)  # agents that are done wait
        persistent.step(turn["move"])
        turn["all"] = dict(persistent.rewards)

    # Parallel, and the batch: the rewards of a step are those of all its moves.
    parallel = global_routing_v0.parallel_env(problem, **options)
    seen, infos = parallel.reset()
    batch = BatchEnv([problem, problem], threads=2, autoreset=False, **options)
    rows, info = batch.reset()
    names = list(parallel.agents)
    for moves in rounds(turns, order == "sequential"):
        first = moves[0]
        np.testing.assert_array_equal(seen[first["agent"]], first["obs"])
        np.testing.assert_array_equal(infos[first["agent"]]["action_mask"], first["mask"])
        actions = dict.fromkeys(parallel.agents, 0)
        actions |= {turn["agent"]: turn["move"] for turn in moves}
        asked = list(parallel.agents)
        seen, rewards, terminated, _, infos = parallel.step(actions)
        paid = {a: sum(turn["rewards"].get(a, 0.0) for turn in moves) for a in asked}
        assert rewards == pytest.approx(paid, rel=1e-5, abs=1e-4)
        assert all(terminated[turn["agent"]] == turn["over"] for turn in moves)
        numbers = [names.index(agent) for agent in asked]
        array = np.full((2, len(names)), NOBODY)
        array[:, numbers] = [actions[agent] for agent in asked]
        rows, reward, _, _, info = batch.step(array)
        late = [sum(turn["all"][agent] for turn in moves) for agent in names]
        for m in (0, 1):
            assert reward[m].tolist() == pytest.approx(late, rel=1e-5, abs=1e-4)
            for number, agent in zip(numbers, asked, strict=True):
                np.testing.assert_array_equal(rows[m, number], seen[agent])
                mask = infos[agent]["action_mask"]
                np.testing.assert_array_equal(info["action_mask"][m, number], mask)
    assert not parallel.agents
    assert parallel.metrics() == game["metrics"]

    # Gymnasium: one player, who gets what all nets are paid, those that are done among them.
    env = gymnasium.make(marouting.ENVIRONMENT_ID, problem=problem, **options).unwrapped
    obs, info = env.reset()
    over = False
    for turn in turns:
        assert info["net"] == turn["agent"]
        np.testing.assert_array_equal(obs, turn["obs"])
        np.testing.assert_array_equal(info["action_mask"], turn["mask"])
        obs, single, terminated, truncated, info = env.step(turn["move"])  # type: ignore[assignment]
        assert single == pytest.approx(sum(turn["all"].values()), rel=1e-5, abs=1e-4)
        over = terminated or truncated
    assert over

    # The same in the batch, with one row per problem.
    alone = BatchEnv([problem, problem], everyone=False, autoreset=False, **options)
    rows, info = alone.reset()
    for turn in turns:
        assert info["agents"].tolist() == [[names.index(turn["agent"])]] * 2
        np.testing.assert_array_equal(rows[:, 0], np.stack([turn["obs"]] * 2))
        np.testing.assert_array_equal(info["action_mask"][1, 0], turn["mask"])
        rows, reward, _, _, info = alone.step(np.full((2, 1), turn["move"]))
        assert reward[1, 0] == pytest.approx(sum(turn["all"].values()), rel=1e-5, abs=1e-4)
    assert (info["agents"] == NOBODY).all()

    # In AEC what others' moves pay accumulates until an agent's turn; nothing of it is lost.
    for agent, total in game["total"].items():
        paid = sum(turn["rewards"].get(agent, 0.0) for turn in turns)
        assert total == pytest.approx(paid, rel=1e-5, abs=1e-3)


def test_a_team_reward_accumulates_in_aec() -> None:
    problem = marouting.generate(1, grid=(4, 4, 2), nets=4, seed=1, reduced_edges=0)[0]

    def one_each(game: Engine, before: Dynamic, movers: NDArray[np.int32]) -> Any:
        del before, movers
        return np.full(game.nets.shape, -1.0)

    parallel = global_routing_v0.parallel_env(problem, reward=one_each)
    parallel.reset()
    count = len(parallel.agents)
    _, rewards, *_ = parallel.step(dict.fromkeys(parallel.agents, 4))
    assert set(rewards.values()) == {-float(count)}
    aec = global_routing_v0.env(problem, reward=one_each)
    aec.reset()
    for turn in range(2 * count):
        _, reward, *_ = aec.last()
        assert reward == -min(turn, count)
        aec.step(4 if turn < count else 5)


@pytest.mark.parametrize("key", ["reached", "step", "own_edge", "overflow_price"])
def test_rewards_that_float32_cannot_hold_are_refused(key: str) -> None:
    for value in (1e300, -1e300, float("nan")):
        expected = rf"^{key}: expected (-1e\+30 to 1e\+30|a number( or null)?), found"
        with pytest.raises(InputError, match=expected):
            PaperReward(**{key: value})


@given(contested(max_nets=6), st.booleans(), st.booleans(), st.integers(0, 1000))
def test_any_components_play_as_the_compiled_ones(
    problem: Problem, everyone: bool, sequential: bool, seed: int
) -> None:
    """The turn-by-turn player against the compiled one, in all it writes."""

    class Seen(PaperObservation):
        """Known to nobody, like any subclass."""

    class Paid(PaperReward):
        """Likewise."""

    order = "sequential" if sequential else "round_robin"
    engines = [Engine([problem] * 3, turn_order=order, max_steps=5) for _ in range(4)]
    paper, reward = PaperObservation(), PaperReward(own_edge=-0.5)
    players = [
        Player(engines[0], paper, reward, everyone=everyone),
        Player(engines[1], Seen(), reward, everyone=everyone),
        Player(engines[2], paper, Paid(own_edge=-0.5), everyone=everyone),
        Player(engines[3], Seen(), Paid(own_edge=-0.5), everyone=everyone),
    ]
    assert [player.compiled for player in players] == [True, False, False, False]
    rng = np.random.default_rng(seed)
    for player in players:
        player.reset()
    saved: Any = None
    for step in range(60):
        actions = rng.integers(-1, 6, players[0].buffers.actions.shape)
        agents = players[0].buffers.agents.copy()
        for player in players:
            player.buffers.actions[:] = actions
            player.step(restart=step > 30)
        expected = players[0].buffers
        left = expected.agents != agents if not everyone else np.zeros(agents.shape, bool)
        ended = (expected.ending != Ending.NONE) | (expected.acted & left)
        for player in players[1:]:
            found = player.buffers
            for name in expected._fields:
                of: Any = ended if name in ("final_obs", "final_mask") else ...
                mine, theirs = getattr(found, name)[of], getattr(expected, name)[of]
                if name == "final":
                    mine, theirs = mine.tolist(), theirs.tolist()
                    mine = [[row[i] for i in (3, 4, 5, 6)] for row in mine]
                    theirs = [[row[i] for i in (3, 4, 5, 6)] for row in theirs]
                np.testing.assert_array_equal(mine, theirs, err_msg=name)
        if step == 40:
            saved = [player.save() for player in players]
    for player, kept in zip(players, saved, strict=True):
        before = player.buffers.obs.copy()
        player.restore(kept)
        assert player.engine.games["steps"].tolist() == kept.dynamic.games["steps"].tolist()
        again = Player(player.engine, player.observation, player.reward, everyone=everyone)
        again.buffers.obs[:] = before
        again.restore(kept)
        np.testing.assert_array_equal(again.buffers.obs, kept.buffers.obs)


def test_rewards_are_only_paid_to_those_who_play() -> None:
    problems = marouting.generate(2, grid=(4, 4, 2), nets=4, seed=3, reduced_edges=0)

    def everybody(game: Engine, before: Dynamic, movers: NDArray[np.int32]) -> Any:
        del before, movers
        return np.ones(game.nets.shape)

    env = BatchEnv(problems, reward=everybody, max_steps=2, autoreset=False)
    env.reset()
    for _ in range(12):
        active = env.engine.agents["status"] == 0
        _, reward, *_ = env.step(np.zeros((2, env.num_agents), int))
        assert not reward[~active].any()
        assert reward[active].all()


def test_a_reward_of_another_shape_is_refused() -> None:
    env = global_routing_v0.parallel_env(reward=lambda *_: np.zeros(3))
    env.reset()
    with pytest.raises(ValueError, match=r"reward: expected shape \(1, 10\), found \(3,\)"):
        env.step(dict.fromkeys(env.agents, 0))


class Seen:
    """An observation in its simple form."""

    def space(self, problems: Any, overflow: bool) -> Box:
        del overflow
        return Box(-1, len(problems[0].capacity), (2,), np.float32)

    def see(self, game: Game, n: int) -> NDArray[np.float32]:
        return np.array([game.cell[n], game.target[n]], np.float32)


class Paid:
    """A reward in its simple form."""

    def pay(self, game: Game, n: int) -> float:
        return 2.0 * game.steps[n]


def test_the_simple_forms_of_components() -> None:
    problem = marouting.generate(1, grid=(4, 4, 2), nets=4, seed=1, reduced_edges=0)[0]
    components: dict[str, Any] = {"observation": Seen(), "reward": Paid()}
    aec = global_routing_v0.env(problem, **components)
    aec.reset()
    parallel = global_routing_v0.parallel_env(problem, **components)
    seen, _ = parallel.reset()
    for agent in parallel.agents:
        np.testing.assert_array_equal(aec.observe(agent), seen[agent])
    _, rewards, *_ = parallel.step(dict.fromkeys(parallel.agents, 4))
    assert set(rewards.values()) == {2.0}
    aec.step(4)
    assert sum(aec.rewards.values()) == 2
    single = gymnasium.make(marouting.ENVIRONMENT_ID, problem=problem, **components).unwrapped
    single.reset()
    assert [single.step(4)[1], single.step(5)[1]] == [2, 4]
    for name in components:
        with pytest.raises(InputError, match=rf"{name}: expected .* gymnasium.make need"):
            BatchEnv([problem], **{name: components[name]})


def seen_as(space: Any, see: Callable[[], Any]) -> Any:
    """An observation in its simple form, with any space and any answer."""
    return type("Odd", (), {"space": lambda *_: space, "see": lambda *_: see()})()


PAIR = Box(0, 1, (2,), np.float32)


@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.parallel_env])
def test_what_an_observation_shows_is_float32_of_its_shape(make: Callable[..., Any]) -> None:
    for row in ((0, 0.5), [0, 0.5], np.array([0, 0.5])):
        env = make(observation=seen_as(PAIR, lambda row=row: row))
        env.reset()
        seen = env.observe("net_0") if hasattr(env, "observe") else env.reset()[0]["net_0"]
        assert (seen.dtype, seen.tolist()) == (np.float32, [0, 0.5])
    for row in (None, 3, [1, 2, 3], "x", [[1, 2]]):
        env = make(observation=seen_as(PAIR, lambda row=row: row))
        with pytest.raises(InputError, match=r"expected numbers of shape \(2,\) from Odd.see, fou"):
            env.reset() if make is global_routing_v0.parallel_env else (env.reset(), env.last())


@pytest.mark.parametrize(
    "space",
    [Box(0, 255, (2,), np.uint8), Box(0, 1, (0,), np.float32), Discrete(3), None, (0, 1)],
)
def test_spaces_are_boxes_of_float32(space: Any) -> None:
    own = seen_as(space, lambda: None)
    own.write = lambda *_: None
    for make in (global_routing_v0.env, GlobalRoutingSingle):
        with pytest.raises(InputError, match=r"^observation: expected a Box of float32 from Odd.s"):
            make(observation=own)
    with pytest.raises(InputError, match=r"^observation: expected a Box of float32 from Odd.spac"):
        Player(Engine([marouting.generate(1)[0]], GameOptions()), own, PaperReward())


@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.parallel_env])
@pytest.mark.parametrize("paid", [None, math.nan, math.inf, 1e39, "x", np.zeros(2)])
def test_a_reward_pays_finite_numbers(make: Callable[..., Any], paid: Any) -> None:
    env = make(reward=type("Odd", (), {"pay": lambda *_: paid})())
    env.reset()
    action = 0 if make is global_routing_v0.env else dict.fromkeys(env.agents, 0)
    with pytest.raises(InputError, match=r"^reward: expected a finite number from Odd.pay, found"):
        env.step(action)


class Changed(PaperObservation):
    """Only its form by columns is another one."""

    def write(self, games: Games, problems: Any, agents: Any, out: Any) -> None:
        super().write(games, problems, agents, out)
        out += 1


class SeesOnly(PaperObservation):
    def see(self, game: Any, n: int) -> Any:
        return super().see(game, n) * 0 + 7


class PaysOnly(PaperReward):
    def pay(self, *_: Any) -> float:
        return 42.0


def test_a_subclass_that_changes_the_plain_form_is_seen_by_it_or_refused() -> None:
    env = global_routing_v0.parallel_env(observation=SeesOnly(), reward=PaysOnly())
    observations, _ = env.reset()
    assert all((seen == 7).all() for seen in observations.values())
    observations, rewards, *_ = env.step(dict.fromkeys(env.agents, 0))
    assert all((seen == 7).all() for seen in observations.values())
    assert set(rewards.values()) == {42.0}
    problems = marouting.generate(1)
    for options, said in (
        ({"observation": SeesOnly()}, "method write, .* inherited one in SeesOnly, .* own see"),
        ({"reward": PaysOnly()}, "method __call__, .* inherited one in PaysOnly, .* own pay"),
    ):
        with pytest.raises(InputError, match=said):
            BatchEnv(problems, **options)


class SeesState:
    """Keeps the state of the game after every move."""

    def __init__(self) -> None:
        self.seen: list[NDArray[np.float32]] = []

    def __call__(self, games: Games, *_: Any) -> NDArray[np.float64]:
        self.seen.append(games.state().copy())
        return np.zeros(games.nets.shape)


def test_rewards_see_the_same_state_in_the_plain_game_and_the_batch() -> None:
    """Also after the first nets of a round are done."""
    problem = marouting.generate(1, (4, 4, 2), nets=5, capacity=2, reduced_edges=0, seed=3)[0]
    plain, batch = SeesState(), SeesState()
    env = global_routing_v0.parallel_env(problem, reward=plain, max_steps=12, agents_persist=True)
    many = BatchEnv([problem], reward=batch, max_steps=12, play_once=True)
    rng = np.random.default_rng(0)
    env.reset()
    _, info = many.reset()
    names = env.possible_agents
    while info["active"].any():
        mask = info["action_mask"][0]
        moves = (mask * rng.random(mask.shape)).argmax(-1)
        env.step(dict(zip(names, moves.tolist(), strict=True)))
        *_, info = many.step(moves[None])
    assert len(plain.seen) == len(batch.seen) > 20
    for one, other in zip(plain.seen, batch.seen, strict=True):
        np.testing.assert_array_equal(one, other)


class OneHot:
    """Writes a single number of each row."""

    def space(self, problems: Any, _overflow: bool) -> Box:
        return Box(0, 1, (problems[0].grid[0],), np.float32)

    def write(self, games: Games, problems: Any, agents: Any, out: Any) -> None:
        x = games.agents["cell"][problems, agents] // (games.grid.shape[1] * games.grid.shape[2])
        out[np.arange(len(out)), x] = 1


def test_rows_are_zero_before_they_are_written() -> None:
    env = BatchEnv(marouting.generate(2), observation=OneHot(), max_steps=3)
    obs, info = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(12):
        mask = info["action_mask"]
        obs, *_, info = env.step((mask * rng.random(mask.shape)).argmax(-1))
        assert (obs.sum(-1) == 1).all()
        ended = info["task_ended"] != 0
        assert (info["final_obs"][ended].sum(-1) == 1).all()


class Wrong:
    def __init__(self, paid: Any) -> None:
        self.paid = paid

    def __call__(self, *_: Any) -> Any:
        return self.paid


@pytest.mark.parametrize("paid", [-1.0, np.zeros(1), None, {"net_0": 1.0}])
@pytest.mark.parametrize("mixed", [False, True])
def test_rewards_of_another_shape_are_refused_alone_and_in_mixtures(paid: Any, mixed: bool) -> None:
    own: Any = Wrong(paid)
    if mixed:
        plain = None if isinstance(paid, dict) else 0.0
        told = [0.0] if isinstance(paid, np.ndarray) else plain
        parts = [{"kind": "paper"}, {"kind": "test_components:Wrong", "paid": told}]
        own = {"kind": "mixed", "parts": parts}
    env = BatchEnv(marouting.generate(1, nets=10), reward=own)
    env.reset()
    with pytest.raises(InputError, match=r"^reward: expected shape \(1, 10\), found .* from Wrong"):
        env.step(np.zeros((1, 10), int))


def test_a_subclass_that_changes_one_form_is_seen_by_that_form() -> None:
    problem = marouting.generate(1, nets=4, seed=1, reduced_edges=0)[0]
    changed, paper = (
        global_routing_v0.env(problem, observation=kind) for kind in (Changed(), PaperObservation())
    )
    for env in (changed, paper):
        env.reset()
    assert (changed.observe("net_0") == paper.observe("net_0") + 1).all()


class Generous(Game):
    """A rule of one's own: every edge has room."""

    def free_moves(self, n: int) -> int:
        del n
        return 63


@pytest.mark.parametrize(
    "base",
    [global_routing_v0.raw_env, global_routing_v0.parallel_env, GlobalRoutingSingle],
)
def test_environments_with_rules_of_their_own(base: Any) -> None:
    own = type("Own", (base,), {"game_class": Generous})
    env = own(marouting.generate(1, nets=30, capacity=1, seed=1, reduced_edges=0)[0])
    env.reset()
    assert type(env.game) is Generous
    assert all(env.action_mask(f"net_{net}").all() for net in range(30))
    if base is global_routing_v0.parallel_env:
        *_, infos = env.step(dict.fromkeys(env.agents, 4))
        assert all(info["action_mask"].all() for info in infos.values())


# --- names ----------------------------------------------------------------------------------------


def test_a_registered_name_stands_wherever_a_component_does() -> None:
    marouting.register("reward", "team-of-this-test", Team)
    marouting.register("observation", "crowd-of-this-test", f"{HERE}:Crowd")
    assert "team-of-this-test" in registry.names("reward")
    options = {"reward": {"kind": "team-of-this-test", "share": 2}}
    env = marouting.make({"env": {**options, "observation": "crowd-of-this-test"}})
    assert env.observation_space.shape == (14,)
    checked = EnvOptions(**options)  # type: ignore[arg-type]
    assert plain(checked)["reward"] == {"kind": "team-of-this-test", "price": 10.0, "share": 2.0}
    assert plain(checked)["observation"] == {"kind": "paper", "via_capacity": 10.0}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "papre"}, "reward: unknown reward 'papre'; did you mean paper?"),
        ({"reward": {"kind": "paper", "reach": 1}}, "reward.reach: unknown key; did you mean"),
        ({"reward": {"kind": f"{HERE}:Team", "prise": 1}}, "reward.prise: unknown key; did you"),
        ({"reward": {"kind": f"{HERE}:Team", "price": "x"}}, "reward.price: expected a number"),
        ({"reward": f"{HERE}:Nothing"}, "there is no class Nothing"),
        ({"reward": "nowhere.at_all:Team"}, "there is no module nowhere"),
        ({"observation": {"kind": 3}}, "observation.kind: expected a name, found 3"),
        ({"observation": ""}, "observation.kind: expected a name, found ''"),
        ({"reward": {"kind": None}}, "reward.kind: expected a name, found None"),
        ({"observation": {"radius": 3}}, "expected one of via_capacity for the observation paper"),
        (
            {"observation": Crowd},
            "observation: expected a name, a mapping with kind, or an object in",
        ),
        ({"reward": Team}, "reward: expected a name, a mapping with kind, or"),
        ({"observation": {"via_capacity": -1}}, "via_capacity: expected a number from 0"),
    ],
)
def test_components_that_cannot_be_had(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=r"^[^\n]*$") as caught:
        global_routing_v0.parallel_env(**options)
    assert message in str(caught.value)


@dataclass(frozen=True)
class Halved(PaperReward):
    """A dataclass whose constructor takes more than its fields, and one of whose fields is not."""

    half: InitVar[float] = 1.0
    made: float = field(init=False, default=3.0)

    def __post_init__(self, half: float) -> None:
        object.__setattr__(self, "step", -half / 2)


class Tenfold(PaperReward):
    """A plain subclass of a dataclass, with a constructor."""

    def __init__(self, tenth: float = 2) -> None:
        super().__init__(reached=10 * tenth)


@dataclass(frozen=True)
class Derived(PaperReward):
    made: float = field(init=False, default=3.0)


def test_an_object_without_a_name_cannot_be_written_down() -> None:
    class Own:
        def __call__(self, *_: Any) -> Any: ...

    for own in (Own(), Halved(half=2), Tenfold(3)):
        with pytest.raises(InputError, match="reward: expected a name or module:Class"):
            plain(GameOptions(reward=own))  # type: ignore[arg-type]
    derived = plain(GameOptions(reward=Derived(step=-2)))["reward"]  # type: ignore[arg-type]
    assert component("reward", derived).make() == Derived(step=-2)


@pytest.mark.parametrize(
    ("options", "known", "expected"),
    [
        ({"kind": f"{HERE}:Halved", "half": 4.0}, "half", -2.0),
        ({"kind": f"{HERE}:Tenfold", "tenth": 4.0}, "tenth", -1.0),
        ({"kind": f"{HERE}:Derived", "step": -3.0}, "step", -3.0),
        ({"kind": f"{HERE}:Unresolved", "step": -4.0}, "step", -4.0),
    ],
)
def test_options_are_what_a_class_is_made_with(
    options: dict[str, Any], known: str, expected: float
) -> None:
    own = component("reward", options)
    assert own.make().step == expected
    written = plain(own)
    assert written[known] == options[known]
    assert component("reward", written).make().step == expected
    with pytest.raises(InputError, match=r"^mad: unknown key; "):
        component("reward", options | {"mad": 1})


class Unresolved(PaperReward):
    """Its types are known to type checkers only."""

    def __init__(self, step: "NowhereButHere" = -1, more: int = 0) -> None:  # type: ignore[name-defined]  # noqa: F821
        super().__init__(step=step + more)


def test_a_paper_reward_with_other_prices_pays_them_everywhere() -> None:
    class Priced(PaperReward):
        @property
        def prices(self) -> Prices:
            return Prices(np.full((5, 3), 7.0), 0.0, np.zeros((4, 3)))

    env = global_routing_v0.parallel_env(reward=Priced())
    env.reset(seed=0)
    rewards = env.step(dict.fromkeys(env.agents, 0))[1]
    assert set(rewards.values()) == {7.0}


def test_states_of_a_users_observation_have_the_shape_of_their_space() -> None:
    class Stated(PaperObservation):
        def state_space(self, problems: Any, overflow: bool) -> Box:
            del problems, overflow
            return Box(0, 1, (4,), np.float32)

        def state(self, games: Any, out: Any = None) -> NDArray[Any]:
            del out
            return np.zeros((len(games.problems), wide), np.float32)

    env = global_routing_v0.parallel_env(observation=Stated())
    env.reset(seed=0)
    wide = 4
    assert env.state_space.contains(env.state())
    wide = 5
    with pytest.raises(InputError, match=r"Stated.state to return an array of shape \(1, 4\), "):
        env.state()


def test_kinds_and_names_are_checked() -> None:
    with pytest.raises(InputError, match="kind: expected one of observation, reward"):
        marouting.register("rewards", "x", Team)
    with pytest.raises(InputError, match="expected a name without a colon"):
        marouting.register("reward", "a:b", Team)


def test_names_of_the_package_stay_its_own() -> None:
    import policies.learned.networks
    import policies.routers  # noqa: F401

    for kind, name, cls in registry.registered():
        if cls.startswith(("marouting.", "policies.")):
            marouting.register(kind, name, cls)  # as a process does for those that it starts
            with pytest.raises(InputError, match=f"^{kind}: expected a name that no {kind} of the"):
                marouting.register(kind, name, Team)
            assert registry.lookup(kind, name) is not Team
    # A package that announces a component may be first.
    marouting.register("network", "late-of-this-test", Team)
    with pytest.raises(InputError, match="found 'late-of-this-test'"):
        marouting.register("network", "late-of-this-test", "policies.learned.networks.mlp:MLP")


class Returns(PaperObservation):
    """It gives rows of its own instead of filling those that it gets."""

    def write(self, *given: Any) -> Any:
        return np.ones_like(given[-1])


@pytest.mark.parametrize("make", [global_routing_v0.env, global_routing_v0.parallel_env])
def test_rows_that_are_returned_are_refused(make: Any) -> None:
    error = "observation: expected Returns.write to fill its argument out, and to return nothing"
    env = make(observation=Returns())

    def begin() -> None:
        env.reset()
        if env.unwrapped.agents and hasattr(env, "last"):
            env.last()

    with pytest.raises(InputError, match=error):
        begin()
    with pytest.raises(InputError, match=error):
        BatchEnv(generate(2), observation=Returns()).reset()


def test_only_classes_have_names() -> None:
    with pytest.raises(InputError, match="reward: expected a class or module:Class, found Pap"):
        marouting.register("reward", "object", PaperReward())
