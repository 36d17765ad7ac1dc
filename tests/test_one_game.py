"""The same moves are the same game in every interface, and a copy goes on as its original does.

Problems, options of the rules (rip-up rounds among them) and moves are drawn.
"""

import copy
import pickle
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from reference import contested

from marouting import Engine, Move, Net, Pin, Problem, global_routing_v0
from marouting.columns import FIGURES, Before, Games
from marouting.env.single import GlobalRoutingSingle
from marouting.game import NOBODY, RIP_UP, Game
from marouting.gym_vector import GlobalRoutingVector
from marouting.vector import BatchEnv

seeds = st.integers(0, 2**32)


class Digest:
    """Pays by all that a reward may look at, the state before a move above all."""

    def __call__(self, games: Games, before: Before, movers: NDArray[np.int32]) -> Any:
        paid = np.zeros(games.agents.shape)
        for m in range(len(movers)):
            read: list[Any] = [int(movers[m])]
            for moment in (games, before):
                read += [moment.agents[name][m].tolist() for name in Game.COLUMNS]
                read += [int(moment.games[name][m]) for name in FIGURES]
                read.append(moment.remaining[m].tolist())
            paid[m] = zlib.crc32(repr(read).encode()) % 1000
        return paid


PARTS = [{"kind": "potential", "gamma": 0.5}, {"kind": "team"}, {"kind": "counterfactual"}]
MIXED = {"kind": "mixed", "parts": PARTS}
PAPER = {"kind": "paper", "overflow_price": 2.5, "own_edge": 0.0}
rewards = st.sampled_from(
    [
        "paper",
        PAPER,
        "normalised",
        "team",
        "difference",
        "counterfactual",
        "potential",
        "mixed",
        MIXED,
    ]
)


@st.composite
def rules(draw: st.DrawFn) -> dict[str, Any]:
    """Options of the rules that go together."""
    options: dict[str, Any] = {
        "turn_order": draw(st.sampled_from(["round_robin", "sequential"])),
        "nets": {
            "order": draw(st.sampled_from(["half_perimeter", "half_perimeter_up", "file"])),
            "decomposition": draw(st.sampled_from(["mst", "steiner"])),
        },
        "overflow": draw(st.sampled_from(["forbidden", "allowed"])),
        "target": draw(st.sampled_from(["pin", "tree"])),
        "mask": {"visited": draw(st.booleans())},
        "release_failed": draw(st.booleans()),
        "max_steps": draw(st.sampled_from([2, 5, 10])),
    }
    if options["nets"]["decomposition"] == "mst":
        options["next_pin"] = draw(st.sampled_from(["listed", "nearest"]))
    if draw(st.booleans()):
        options |= {"wait": draw(st.booleans()), "message_bits": draw(st.sampled_from([0, 1, 8]))}
    if draw(st.integers(0, 3)):
        options["rip_up"] = {
            "rounds": draw(st.integers(1, 4)),
            "choose": draw(st.sampled_from(["all", "conflicts", "history", "agents"])),
            "neighbours": draw(st.integers(0, 3)),
        }
    return options


def moves_of(options: dict[str, Any]) -> int:
    """How many moves an agent has by these options, whatever its message."""
    asks = (options.get("rip_up") or {}).get("choose") == "agents"
    return 6 + asks + options.get("wait", False)


def same(found: Any, expected: Any) -> None:
    """Asserts that two results are equal, arrays with their types."""
    assert type(found) is type(expected)
    if isinstance(expected, dict):
        assert list(found) == list(expected)
        for key, value in expected.items():
            same(found[key], value)
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected)
        for mine, theirs in zip(found, expected, strict=True):
            same(mine, theirs)
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected


# One game in every interface ----------------------------------------------------------------------


@dataclass
class Player:
    """Answers the same in every interface, and keeps what every interface tells alike.

    A move depends on the agent, on how many moves it has made, and on what it sees of itself: where
    it stands and where its target is. What others have done since differs, as it should, between
    interfaces in which agents choose one after the other and in which all choose at once.
    """

    seed: int
    kinds: int
    moves: dict[str, list[Any]] = field(default_factory=dict)
    endings: dict[str, list[Any]] = field(default_factory=dict)
    paid: dict[str, float] = field(default_factory=dict)
    ends: dict[str, Any] = field(default_factory=dict)
    seen: list[Any] = field(default_factory=list)

    def move(self, agent: str, seen: NDArray[np.float32], mask: NDArray[np.int8]) -> int:
        """The agent's next move."""
        own = self.moves.setdefault(agent, [])
        rng = np.random.default_rng([self.seed, int(agent.removeprefix("net_")), len(own)])
        away = seen[3:6]
        wanted = np.flatnonzero(np.stack((away > 0, away < 0), axis=1).reshape(-1))
        if self.kinds > RIP_UP and mask[RIP_UP]:
            move = int(rng.choice([*Move, *[RIP_UP] * 6]))
        elif len(wanted) and rng.random() < 0.8:
            move = int(rng.choice(wanted))
        else:
            move = int(rng.integers(self.kinds))
        move += self.kinds * int(rng.integers(len(mask) // self.kinds))
        own.append((seen[:6].tolist(), move))
        return move

    def ended(self, agent: str, ending: int, seen: NDArray[np.float32]) -> None:
        """A task of an agent has ended with its last move, and that is what it saw."""
        row = (len(self.moves[agent]), ending, seen[:6].tolist())
        self.endings.setdefault(agent, []).append(row)

    def pay(self, agent: str, reward: float) -> None:
        """An agent is paid."""
        self.paid[agent] = self.paid.get(agent, 0.0) + reward


def play_aec(problem: Problem, options: dict[str, Any], seed: int) -> tuple[Player, Any]:
    env, player = global_routing_v0.env(problem, **options), Player(seed, moves_of(options))
    env.reset()
    for agent in env.agent_iter():
        seen, reward, terminated, truncated, info = env.last()
        player.pay(agent, reward)
        if "task_ended" in info:
            player.ended(agent, info["task_ended"], info["task_obs"])
        if terminated or truncated:
            player.ends[agent] = terminated, truncated
            env.step(None)
            continue
        player.seen.append((agent, seen.copy(), info["action_mask"].copy()))
        env.step(player.move(agent, seen, info["action_mask"]))
    return player, env.unwrapped


def play_parallel(problem: Problem, options: dict[str, Any], seed: int) -> tuple[Player, Any]:
    env, player = (
        global_routing_v0.parallel_env(problem, **options),
        Player(seed, moves_of(options)),
    )
    seen, infos = env.reset()
    while env.agents:
        actions = dict.fromkeys(env.agents, 0)
        active = [agent for agent in env.agents if infos[agent].get("active", True)]
        masks = {agent: infos[agent]["action_mask"] for agent in active}
        for agent in (f"net_{env.game.nets[n]}" for n in env.game.movers()):
            actions[agent] = player.move(agent, seen[agent], masks[agent])
        player.seen.append({agent: (seen[agent], masks[agent]) for agent in active})
        seen, paid, ended, cut, infos = env.step(actions)
        for agent, info in infos.items():
            player.pay(agent, paid[agent])
            if "task_ended" in info:
                player.ended(agent, info["task_ended"], info["task_obs"])
            if ended[agent] or cut[agent]:
                player.ends[agent] = ended[agent], cut[agent]
    return player, env


def movers(engine: Engine) -> list[str]:
    """The agents that move in the next step of all agents."""
    game, agents = engine.games[0], engine.agents[0]
    if engine.rules.turn_order == "sequential" or game["asked"]:
        numbers = [int(game["agent"])]
    else:
        numbers = np.flatnonzero(agents["status"] == 0).tolist()
    return [f"net_{engine.nets[0, n]}" for n in numbers]


def play_single(problem: Problem, options: dict[str, Any], seed: int) -> tuple[Player, Any]:
    env, player = GlobalRoutingSingle(problem, **options), Player(seed, moves_of(options))
    seen, info = env.reset()
    over = False
    while not over:
        agent = info["net"]
        player.seen.append((agent, seen.copy(), info["action_mask"].copy()))
        seen, paid, ended, cut, info = env.step(player.move(agent, seen, info["action_mask"]))
        player.pay("all", paid)
        if "task_ended" in info:
            player.ended(agent, info["task_ended"], info["task_obs"])
        over = ended or cut
    return player, env


def play_batch(
    problem: Problem, options: dict[str, Any], seed: int, *, everyone: bool
) -> tuple[Player, Any]:
    env = BatchEnv([problem], everyone=everyone, autoreset=False, **options)
    player = Player(seed, moves_of(options))
    seen, info = env.reset()
    names = [f"net_{net}" for net in env.engine.nets[0]]
    while info["active"].any():
        actions = np.full(info["agents"].shape, NOBODY)
        rows = {names[n]: k for k, n in enumerate(info["agents"][0].tolist())}
        masks = {agent: info["action_mask"][0, k].copy() for agent, k in rows.items()}
        shown = {agent: seen[0, k].copy() for agent, k in rows.items()}
        if everyone:
            active = [agent for agent, k in rows.items() if info["active"][0, k]]
            player.seen.append({agent: (shown[agent], masks[agent]) for agent in active})
        else:
            player.seen += [(agent, shown[agent], masks[agent]) for agent in rows]
        for agent in movers(env.engine) if everyone else rows:
            actions[0, rows[agent]] = player.move(agent, shown[agent], masks[agent])
        seen, paid, ended, cut, info = env.step(actions)
        for agent, k in rows.items():
            player.pay(agent if everyone else "all", float(paid[0, k]))
            if info["task_ended"][0, k]:
                player.ended(agent, int(info["task_ended"][0, k]), info["final_obs"][0, k])
            if everyone:
                player.ends[agent] = bool(ended[0, k]), bool(cut[0, k])
    return player, env


def routes(env: Any) -> list[list[int]]:
    """The edges of every net."""
    played = env.engine if isinstance(env, BatchEnv) else env
    return [edges.tolist() for edges in played.solution().edges]


@examples(36)
@given(contested(max_nets=5), rules(), rewards, st.booleans(), seeds)
def test_the_same_moves_are_the_same_game(
    problem: Problem, options: dict[str, Any], reward: Any, persist: bool, seed: int
) -> None:
    options = {**options, "reward": reward}
    stays = {**options, "agents_persist": persist}
    aec, env = play_aec(problem, stays, seed)
    expected = env.metrics(), routes(env)
    paid_whole, _ = play_aec(problem, {**options, "agents_persist": True}, seed)
    parallel, env = play_parallel(problem, stays, seed)
    assert (env.metrics(), routes(env)) == expected
    single, env = play_single(problem, options, seed)
    assert (env.metrics(), routes(env)) == expected
    every, env = play_batch(problem, options, seed, everyone=True)
    assert (vars(env.engine.metrics()), routes(env)) == expected
    turns, env = play_batch(problem, options, seed, everyone=False)
    assert (vars(env.engine.metrics()), routes(env)) == expected

    for player in (parallel, single, every, turns):
        assert player.moves == aec.moves
        assert player.endings == aec.endings
    assert aec.ends == parallel.ends == every.ends
    assert all(map(any, aec.ends.values()))
    assert parallel.paid == pytest.approx(aec.paid, abs=1e-3)
    # Where agents that are done leave, they are not paid any more.
    whole = paid_whole.paid
    assert every.paid == pytest.approx(whole, abs=1e-3)
    assert single.paid == turns.paid == pytest.approx({"all": sum(whole.values())}, abs=1e-3)
    same(single.seen, aec.seen)
    same(turns.seen, aec.seen)
    same(parallel.seen, every.seen)


def test_nets_that_walk_again_together_take_turns_in_net_order() -> None:
    """Two nets want one track. The second gives way with the first, and the first moves first."""
    nets = Net("a", 0, (Pin(0, 0, 1), Pin(1, 0, 1))), Net("b", 1, (Pin(1, 0, 1), Pin(0, 0, 1)))
    problem = Problem((2, 1, 1), (1,), (1,), nets, (1,), (0,), (0,))
    env = global_routing_v0.env(
        problem, rip_up={"neighbours": 1}, turn_order="round_robin", max_steps=2
    )
    env.reset()
    moved = []
    for agent in env.agent_iter():
        *_, terminated, truncated, _ = env.last()
        if not (terminated or truncated):
            moved.append((env.unwrapped.game.reroutes, agent))
        env.step(None if terminated or truncated else [Move.EAST, Move.WEST][agent == "net_1"])
    walks = {number: [agent for n, agent in moved if n == number] for number, _ in moved}
    assert walks == {
        0: ["net_0", "net_1", "net_1"],
        1: ["net_0"],  # nobody is in its way
        2: ["net_0", "net_1", "net_1"],
    }
    assert routes(env.unwrapped) == [[0], []]


# Copies -------------------------------------------------------------------------------------------


def chosen(rng: np.random.Generator, mask: NDArray[np.int8]) -> int:
    """A move, most often one that the mask allows."""
    return int(rng.integers(len(mask)) if rng.random() < 0.2 else rng.choice(np.flatnonzero(mask)))


def step_aec(env: Any, rng: np.random.Generator) -> Any:
    if not env.agents:
        env.reset()
    *_, terminated, truncated, info = env.last()
    env.step(None if terminated or truncated else chosen(rng, info["action_mask"]))
    told = env.rewards, env.infos, env.terminations, env.truncations
    return copy.deepcopy((env.agents, told, env.last() if env.agents else None))


def step_parallel(env: Any, rng: np.random.Generator) -> Any:
    if not env.agents:
        return env.reset()
    return env.step({agent: chosen(rng, env.action_mask(agent)) for agent in env.agents})


def step_single(env: Any, rng: np.random.Generator) -> Any:
    if env.game.turn == NOBODY:
        return env.reset()
    return env.step(chosen(rng, env.action_masks()))


def step_batch(env: Any, rng: np.random.Generator) -> Any:
    masks = env.engine.masks(*env.engine.pairs(env.engine.nets.shape == env._buffers.agents.shape))
    moves = np.array([chosen(rng, mask) for mask in masks])
    return copy.deepcopy(env.step(moves.reshape(len(env.engine.games), -1)))


def step_vector(env: Any, rng: np.random.Generator) -> Any:
    return env.step(np.array([chosen(rng, mask) for mask in env.action_masks()]))


INTERFACES: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "aec": (global_routing_v0.raw_env, step_aec),
    "parallel": (global_routing_v0.parallel_env, step_parallel),
    "single": (GlobalRoutingSingle, step_single),
    "batch": (lambda problem, **o: BatchEnv([problem] * 2, threads=2, **o), step_batch),
    "rows": (lambda problem, **o: BatchEnv([problem] * 2, everyone=False, **o), step_batch),
    "vector": (lambda problem, **o: GlobalRoutingVector(2, problem, **o), step_vector),
}


BATCHES = ("batch", "rows", "vector")


@pytest.mark.parametrize("interface", INTERFACES)
@given(
    contested(max_nets=5),
    rules(),
    st.one_of(rewards, st.just(f"{__name__}:Digest"), st.builds(Digest)),
    st.integers(1, 60),
    seeds,
)
def test_copies_pay_what_the_original_pays(
    interface: str,
    problem: Problem,
    options: dict[str, Any],
    reward: Any,
    steps: int,
    seed: int,
) -> None:
    make, step = INTERFACES[interface]
    options = {**options, "reward": reward}
    env, rng = make(problem, **options), np.random.default_rng(seed)
    env.reset()
    for _ in range(steps):
        step(env, rng)
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    saved = None
    if interface != "vector":
        saved = env.save()
        other = make(problem, **options)
        other.reset()
        for _ in range(steps // 2):
            step(other, rng)
        other.restore(saved)
        twins.append(other)
    rngs = [np.random.default_rng(seed + 1) for _ in (env, *twins)]
    told = []
    for _ in range(20):
        told.append(step(env, rngs[0]))
        for twin, own in zip(twins, rngs[1:], strict=True):
            same(step(twin, own), told[-1])
    if saved is not None:
        env.restore(saved)
        again = np.random.default_rng(seed + 1)
        for expected in told:
            same(step(env, again), expected)
