"""The training loop: what it stores, logs, saves and finds.

Oracles: the Gymnasium and Parallel environments, played again move by move, for everything that the
trainer stores and logs; the same training uninterrupted, alone, or by another learner.
"""

import hashlib
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from conftest import some_slow
from numpy.typing import NDArray

from marouting import (
    EnvOptions,
    InputError,
    Problem,
    Solution,
    evaluate,
    generate,
    global_routing_v0,
    sequential_astar,
)
from marouting.batch.engine import Engine
from marouting.batch.state import Dynamic
from marouting.config import build
from marouting.env.single import GlobalRoutingSingle
from marouting.problem.grid import MOVES
from marouting.rewards import PaperReward
from policies.learned.config import Config, TrainOptions, config_of, load_config
from policies.learned.memory.replay import GOES_ON, MASK, MOVE, REWARD
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run
from policies.learned.trainer import Episode, Trainer
from policies.routers.pathfinder import PathfinderRouter

REACHED = 100.0
BACKENDS = (True, False)
"""Whether the fused learner does it."""


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)  # more of them cost more than they save on networks this small


def memory_of(trainer: Trainer) -> SimpleNamespace:
    """The fields of all transitions in a trainer's memory, (L, capacity) or (L, capacity, …)."""
    learner: Any = trainer.learner
    rows = learner.memory.store.numpy()
    features = learner.memory.features
    rest = 2 * features
    return SimpleNamespace(
        obs=rows[..., :features],
        next_obs=rows[..., features:rest],
        move=rows[..., rest + MOVE].astype(int),
        reward=rows[..., rest + REWARD],
        goes_on=rows[..., rest + GOES_ON],
        mask=rows[..., rest + MASK : rest + MASK + MOVES],
    )


# --- the trainer ----------------------------------------------------------------------------------


def tiny(seed: int = 0, nets: int = 3, **options: Any) -> Problem:
    """One of the paper's small problems for its studies of parameters: 4x4x2."""
    return generate(1, **{"grid": (4, 4, 2), "nets": nets, "capacity": 2, "seed": seed, **options})[
        0
    ]


def small_config(episodes: int = 6, seed: int = 0, **options: Any) -> Config:
    """A configuration whose trainings take a moment.

    Args:
        episodes: see TrainOptions.
        seed: see Config.
        **options: keys of ``env`` and ``train``, and of the learner.
    """
    fields = {
        part: {k: options.pop(k) for k in list(options) if k in schema.__dataclass_fields__}
        for part, schema in (("env", EnvOptions), ("train", TrainOptions))
    }
    small = {
        "epsilon_final": None,
        "burn_in_size": 100,
        "buffer_size": 5000,
        "network": {"hidden": [8]},
    }
    raw = {
        "seed": seed,
        "env": {"max_steps": 12, **fields["env"]},
        "learner": {**small, **options},
        "train": {"episodes": episodes, **fields["train"]},
    }
    return build(Config, raw)


def train(trainer: Trainer) -> list[Episode]:
    """Runs a training to its end."""
    return [episode for finished in trainer.run() for episode in finished]


def networks_of(trainer: Trainer) -> torch.Tensor:
    """(networks, P) the saved networks."""
    saved = trainer.saved.state()["weights"]
    return torch.stack([torch.cat([t.flatten() for t in one.values()]) for one in saved])


def bits(trainer: Trainer) -> list[bytes]:
    """All weights and optimiser states."""
    return [tensor.numpy().tobytes() for tensor in trainer.learner.state().values()]


HERE, COMPONENTS = __name__, "test_components"


class Together(PaperReward):
    """The paper's reward, and a little for all nets whenever one moves."""

    def __init__(self, share: float = 0.25) -> None:
        super().__init__()
        object.__setattr__(self, "share", share)

    def __call__(self, game: Engine, before: Dynamic, movers: NDArray[np.int32]) -> Any:
        return super().__call__(game, before, movers) - self.share  # type: ignore[attr-defined]


class Replayed:
    """The moves in a trainer's memory, played again through the faces of the environment.

    Everything that the trainer stored is compared with what the face shows on the way.

    Args:
        trainer: of one problem, after its training, with room in memory for every transition.
        burnt: how many transitions at the start of memory are burn-in.
    """

    def __init__(self, trainer: Trainer, burnt: int) -> None:
        self.memory = memory_of(trainer)
        self.rows = int(trainer.learner.stored[0])
        assert burnt < self.rows <= self.memory.obs.shape[1], "the memory must not have wrapped"
        self.at = burnt
        self.masks: list[NDArray[np.int8]] = []  # of every move
        self.failed = 0  # tasks
        self.everyone = trainer.config.env.agents == "multi"
        env = trainer.config.env
        self.options = {
            "max_steps": env.max_steps,
            "overflow": env.overflow,
            "turn_order": env.turn_order,
            "reward": env.reward.make(),
            "observation": env.observation.make(),
        }
        self.problem = trainer.player.engine.problems[0]

    def episode(self, episode: Episode) -> Solution:
        """Plays one episode, compares it with what the trainer logged, returns its routes."""
        env, total = (self._multi if self.everyone else self._single)()
        metrics = env.metrics()
        assert metrics == {name: getattr(episode, name) for name in metrics}
        assert episode.reward == total
        return env.solution()

    def _single(self) -> tuple[Any, float]:
        env = GlobalRoutingSingle(self.problem, **self.options)
        seen, info = env.reset()
        total, over, steps = 0.0, False, dict[str, int]()
        while not over:
            net = info["net"]
            move = self._take(self.at, seen, info["action_mask"])
            seen, reward, terminated, truncated, info = env.step(move)
            over = terminated or truncated
            shown = seen if info["net"] == net else None  # where another net is next, not this one
            steps[net] = self._gave(reward, shown, steps.get(net, 0) + 1)
            total += reward
        assert terminated == (env.metrics()["joined"] == env.metrics()["tasks"])
        return env, total

    def _multi(self) -> tuple[Any, float]:
        env = global_routing_v0.parallel_env(self.problem, agents_persist=True, **self.options)
        seen, infos = env.reset()
        total, steps = 0.0, dict.fromkeys(env.possible_agents, 0)
        while env.agents:
            playing = [agent for agent in env.agents if infos[agent].get("active", True)]
            moves = {  # all look before anyone moves
                agent: self._take(self.at + i, seen[agent], infos[agent]["action_mask"])
                for i, agent in enumerate(playing)
            }
            seen, rewards, _, _, infos = env.step(dict.fromkeys(env.agents, 0) | moves)
            for agent in moves:
                steps[agent] = self._gave(rewards[agent], seen[agent], steps[agent] + 1)
            total += sum(rewards.values())
        return env, total

    def _take(self, row: int, seen: NDArray[np.float32], mask: NDArray[np.int8]) -> int:
        """A row's move, its observation checked."""
        assert np.array_equal(self.memory.obs[0, row], seen)
        self.masks.append(mask)
        return int(self.memory.move[0, row])

    def _gave(self, reward: float, seen: NDArray[np.float32] | None, steps: int) -> int:
        """Checks what came of the next row's move; returns the steps of the task, 0 at its end."""
        memory, row = self.memory, self.at
        joined = reward > REACHED / 2  # overflow may have a price
        failed = not joined and steps == self.options["max_steps"]
        arrived = memory.next_obs[0, row]
        assert memory.reward[0, row] == reward
        assert memory.goes_on[0, row] == (not joined)
        assert arrived[3:6].any() == (not joined)  # the way that is left to this task's target
        if not joined and not failed and seen is not None:
            assert np.array_equal(arrived, seen)
        self.at += 1
        self.failed += failed
        return 0 if joined or failed else steps


LEARNERS: dict[str, dict[str, Any]] = {
    "single": {},
    "single, masked": {"masking": True, "epsilon": 0.5, "target_period": 10},
    "single, torch": {"fused": False, "steps_per_update": 3},
    "single, round robin": {"turn_order": "round_robin"},
    "single, overflow": {
        "overflow": "allowed",
        "reward": {"own_edge": 0, "overflow_price": 2.5},
    },
    "multi, best by reward": {"agents": "multi", "best": "reward"},
    "multi": {"agents": "multi"},
    "multi, a step for three moves": {"agents": "multi", "steps_per_update": 3},
    "multi, overflow": {
        "agents": "multi",
        "overflow": "allowed",
        "reward": {"overflow_price": 1},
    },
    "multi, masked, torch": {"agents": "multi", "masking": True, "fused": False},
    "single, own components": {"observation": f"{COMPONENTS}:Crowd", "reward": f"{HERE}:Together"},
    "multi, own components": {
        "agents": "multi",
        "observation": {"kind": f"{COMPONENTS}:Crowd", "scale": 3},
        "reward": {"kind": f"{HERE}:Together", "share": 0.125},
    },
}


@pytest.mark.parametrize("options", LEARNERS.values(), ids=LEARNERS)
def test_memory_and_episodes_are_what_the_environment_shows(options: dict[str, Any]) -> None:
    config = small_config(**{"epsilon": 0.3, **options}, max_steps=9)
    env, problem = config.env, tiny(nets=5)
    trainer = Trainer({"p": problem}, config)
    trainer.burn_in()
    burnt = int(trainer.learner.stored[0])
    lanes = 5 if config.env.agents == "multi" else 1
    assert 100 <= burnt < 100 + lanes
    episodes = train(trainer)
    assert [episode.episode for episode in episodes] == list(range(6))

    replayed = Replayed(trainer, burnt)
    walked = [replayed.episode(episode) for episode in episodes]
    assert replayed.at == replayed.rows
    assert replayed.failed > 0  # among them tasks that ran out of steps
    assert all(episode.overflow == 0 for episode in episodes) == (env.overflow == "forbidden")
    moves = memory_of(trainer).move[0, burnt : replayed.rows]
    allowed = np.stack(replayed.masks)[np.arange(len(moves)), moves]
    assert allowed.all() == config.learner.options.masking
    assert trainer.updates.tolist() == [len(moves) // config.learner.options.steps_per_update]
    assert [episode.updates for episode in episodes] == (
        np.cumsum([episode.steps for episode in episodes])
        // config.learner.options.steps_per_update
    ).tolist()

    # The best episode: most tasks joined, then overflow, wirelength (or reward), the earliest.
    def rank(episode: Episode) -> tuple[float, ...]:
        if config.train.best == "reward":
            return -episode.joined, -episode.reward, episode.episode
        return -episode.joined, episode.overflow, episode.wirelength, episode.episode

    best = min(episodes, key=rank)
    assert trainer.solutions() == {"p": walked[best.episode]}
    running = [
        episode for i, episode in enumerate(episodes) if episode == min(episodes[: i + 1], key=rank)
    ]
    assert [episode for episode in episodes if episode.best] == running
    figures = evaluate(problem, trainer.solutions()["p"])
    assert (figures.overflow, figures.wirelength) == (best.overflow, best.wirelength)
    assert figures.joined >= best.joined


def test_masks_in_memory_are_those_of_where_the_move_arrived() -> None:
    trainer = Trainer({"p": tiny(nets=5)}, small_config(masking=True, epsilon=0.5, max_steps=9))
    trainer.burn_in()
    burnt = int(trainer.learner.stored[0])
    episode = train(trainer)[0]
    env = GlobalRoutingSingle(trainer.player.engine.problems[0], max_steps=9)
    env.reset()
    memory, compared = memory_of(trainer), 0
    for row in range(burnt, burnt + episode.steps):
        seen, *_, info = env.step(int(memory.move[0, row]))
        if np.array_equal(seen, memory.next_obs[0, row]):  # the task went on
            assert np.array_equal(info["action_mask"], memory.mask[0, row])
            compared += 1
    assert compared > episode.steps / 2


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("masking", [False, True])
def test_moves_are_epsilon_greedy(agents: Any, masking: bool) -> None:
    # Never updated, the networks keep their first weights.
    config = small_config(
        20,
        agents=agents,
        masking=masking,
        epsilon=0.4,
        steps_per_update=10**6,
        buffer_size=20_000,
    )
    trainer = Trainer({"p": tiny(nets=5)}, config)
    first = config.learner.cls.network(config.learner.options, (12,))
    first.load_state_dict(trainer.learner.networks.row(0).weights)
    trainer.burn_in()
    burnt = int(trainer.learner.stored[0])
    episodes = train(trainer)
    replayed = Replayed(trainer, burnt)
    assert trainer.updates.tolist() == [0]
    memory, rows = memory_of(trainer), slice(burnt, replayed.rows)
    with torch.no_grad():
        values = first(torch.from_numpy(memory.obs[0, rows])).numpy()
    for episode in episodes:
        replayed.episode(episode)
    masks = np.stack(replayed.masks)
    allowed = masks if masking else np.ones_like(masks)
    best = np.where(allowed == 1, values, -np.inf).argmax(axis=1)
    moves = memory.move[0, rows]
    assert allowed[np.arange(len(moves)), moves].all()
    # Whether the best move is made: 1 - epsilon, and its share of the random ones.
    expected = 0.6 + 0.4 / allowed.sum(axis=1)
    spread = (expected * (1 - expected)).sum() ** 0.5
    assert abs((best == moves).sum() - expected.sum()) < 5 * spread
    # Every move's share of the random ones.
    share = np.where(
        np.arange(MOVES) == best[:, None], 0, 0.4 * allowed / allowed.sum(axis=1)[:, None]
    )
    made = (moves[:, None] == np.arange(MOVES)) & (best != moves)[:, None]
    spread = (share * (1 - share)).sum(axis=0) ** 0.5
    assert (abs(made.sum(axis=0) - share.sum(axis=0)) < 5 * spread).all()


def test_epsilon_schedule() -> None:
    config = small_config(epsilon=0.8, epsilon_final=0.2, epsilon_decay_from=2)
    logged = [episode.epsilon for episode in train(Trainer({"p": tiny()}, config))]
    assert logged == pytest.approx([0.8, 0.8, 0.8, 0.6, 0.4, 0.2])


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_seeds_decide_everything(backend: bool, agents: Any) -> None:
    problems = {"p": tiny(), "q": tiny(1)}
    config = small_config(4, fused=backend, agents=agents, epsilon=0.2)
    first, second = Trainer(problems, config), Trainer(problems, config)
    assert train(first) == train(second)
    assert bits(first) == bits(second)
    assert first.solutions() == second.solutions()
    other = Trainer(problems, replace(config, seed=1))
    assert train(other) != train(first)
    assert bits(other) != bits(first)


@pytest.mark.parametrize("purpose", ["weights", "explore", "sample"])
def test_the_seed_decides_each_kind_of_number(purpose: str) -> None:
    """Two seeds that differ in one thing only: first weights, random moves or samples."""
    options = {
        "weights": {"steps_per_update": 10**6, "epsilon": 0},
        "explore": {"steps_per_update": 10**6, "epsilon": 1},
        "sample": {"epsilon": 0},
    }[purpose]
    trainers = [
        Trainer({"p": tiny()}, small_config(3, seed=seed, learning_rate=1e-9, **options))
        for seed in (0, 1)
    ]
    if purpose != "weights":
        trainers[1].learner.networks.flat.copy_(trainers[0].learner.networks.flat)
    first, second = map(train, trainers)
    if purpose == "sample":  # too small a rate to show in the moves
        assert [e.loss for e in first] != [e.loss for e in second]
        assert [replace(e, loss=0) for e in first] == [replace(e, loss=0) for e in second]
    else:
        moves = [memory_of(trainer).move for trainer in trainers]
        assert not np.array_equal(*moves)


@pytest.mark.parametrize("agents", ["single", "multi"])
def test_loss_is_the_mean_of_the_gradient_steps_of_an_episode(
    agents: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small_config(4, agents=agents, fused=False)  # the compiled one trains alike
    trainer = Trainer({"p": tiny(), "q": tiny(1)}, config)
    kind = type(trainer.learner)
    learn = kind.learn
    taken: dict[str, list[tuple[int, float]]] = {name: [] for name in trainer.names}

    def note(self: Any, due: NDArray[np.integer]) -> None:
        steps, loss = self.updates.copy(), self.loss.numpy().copy()
        learn(self, due)
        for row, problem in enumerate(trainer.names):
            change = int(self.updates[row] - steps[row]), float(self.loss[row] - loss[row])
            taken[problem].append(change)

    monkeypatch.setattr(kind, "learn", note)
    for finished in trainer.run():
        for episode in finished:
            steps, losses = np.array(taken[episode.problem]).T
            taken[episode.problem].clear()
            assert steps.sum() == episode.steps
            assert episode.loss == pytest.approx(losses.sum() / steps.sum())


@pytest.mark.slow  # the time is the compiler's
@pytest.mark.parametrize("agents", ["single", "multi"])
def test_threads_change_nothing(agents: Any) -> None:
    problems = {name: tiny(seed) for seed, name in enumerate("abc")}
    config = small_config(3, fused=True, agents=agents, epsilon=0.2)
    one = Trainer(problems, config)
    expected = train(one)
    two = Trainer(problems, replace(config, train=replace(config.train, threads=2)))
    assert train(two) == expected
    assert bits(two) == bits(one)


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_problem_trains_alone_as_in_a_stack(backend: bool, agents: Any) -> None:
    # The others have more nets, other rates of ending, and train before and after it.
    config = small_config(5, fused=backend, agents=agents, epsilon=0.2, learning_rate=1e-3)
    stack = {"a": tiny(1, nets=6), "p": tiny(0), "z": tiny(2, nets=1)}
    alone = Trainer({"p": stack["p"]}, config)
    beside = Trainer(stack, config)
    expected = train(alone)
    found = [episode for episode in train(beside) if episode.problem == "p"]
    for mine, theirs in zip(found, expected, strict=True):
        assert mine.loss == pytest.approx(theirs.loss, rel=1e-3)
        assert replace(mine, loss=0) == replace(theirs, loss=0)
    np.testing.assert_allclose(networks_of(beside)[1], networks_of(alone)[0], atol=1e-4)
    assert beside.solutions()["p"] == alone.solutions()["p"]


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("shared", [False, True])
def test_backends_train_alike(agents: Any, shared: bool) -> None:
    options = {"epsilon": 0.2, "target_period": 5, "agents": agents, "shared": shared}
    problems = {"p": tiny(), "q": tiny(1, nets=1)}
    compiled, batched = (
        Trainer(problems, small_config(4, fused=backend, **options)) for backend in BACKENDS
    )
    # What ends between two looks at the trainer is in the order of the problems.
    episodes = [train(trainer) for trainer in (compiled, batched)]
    for name in problems:
        mine, theirs = ([episode for episode in e if episode.problem == name] for e in episodes)
        for a, b in zip(mine, theirs, strict=True):
            assert a.loss == pytest.approx(b.loss, rel=1e-3)
            assert replace(a, loss=0) == replace(b, loss=0)
    np.testing.assert_allclose(networks_of(compiled), networks_of(batched), atol=1e-5)


@pytest.mark.gpu
@pytest.mark.parametrize("agents", ["single", "multi"])
def test_a_gpu_trains_alike(agents: Any) -> None:
    problems = {"p": tiny(), "q": tiny(1, nets=1)}
    config = small_config(6, agents=agents, fused=False, epsilon=0.2, target_period=5)
    here = Trainer(problems, config)
    there = Trainer(problems, replace(config, train=replace(config.train, device="cuda")))
    for mine, theirs in zip(train(here), train(there), strict=True):
        assert mine.loss == pytest.approx(theirs.loss, rel=1e-3)
        assert replace(mine, loss=0) == replace(theirs, loss=0)
    np.testing.assert_allclose(networks_of(here), networks_of(there), atol=1e-4)


def test_one_network_learns_from_all_nets() -> None:
    trainer = Trainer({"p": tiny(nets=4)}, small_config(2, agents="multi"))
    assert len(trainer.learner.updates) == 1
    episodes = train(trainer)
    burnt = int(trainer.learner.stored[0]) - sum(episode.steps for episode in episodes)
    first = memory_of(trainer).obs[0, burnt : burnt + 4]
    env = global_routing_v0.parallel_env(trainer.player.engine.problems[0])
    seen, _ = env.reset()
    assert np.array_equal(first, np.stack([seen[agent] for agent in env.possible_agents]))


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_one_network_learns_from_all_problems(backend: bool, agents: Any) -> None:
    problems = {"p": tiny(nets=4), "q": tiny(1, nets=2), "r": tiny(2, nets=3)}
    config = small_config(3, agents=agents, fused=backend, shared=True, epsilon=0.3)
    trainer = Trainer(problems, config)
    trainer.burn_in()
    burnt = int(trainer.learner.stored[0])
    assert 100 <= burnt < 100 + sum(len(problem.nets) for problem in problems.values())
    episodes = train(trainer)
    moves = sum(episode.steps for episode in episodes)
    assert len(networks_of(trainer)) == 1
    assert trainer.learner.stored.tolist() == [burnt + moves]
    assert trainer.learner.updates.tolist() == [moves]
    assert {episode.updates for episode in episodes[-1:]} == {moves}
    # What each problem's first observation was is in the one memory, in turn.
    memory = memory_of(trainer)
    at = burnt
    for problem in problems.values():
        env = GlobalRoutingSingle(problem) if agents == "single" else None
        if env is None:
            faces = global_routing_v0.parallel_env(problem)
            seen = list(faces.reset()[0].values())
        else:
            seen = [env.reset()[0]]
        for one in seen:
            assert np.array_equal(memory.obs[0, at], one)
            at += 1
    assert set(trainer.solutions()) == set(problems)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shared", [False, True])
def test_a_problem_that_is_done_plays_no_more(shared: bool, backend: bool) -> None:
    # One net against thirty: it is done long before.
    problems = {"long": tiny(nets=30), "short": tiny(1, nets=1)}
    trainer = Trainer(problems, small_config(3, epsilon=0.9, shared=shared, fused=backend))
    playing = []
    for _ in trainer.run():
        playing.append([trainer.names[problem] for problem in np.flatnonzero(trainer.running)])
        active = trainer.player.engine.games["active"] > 0
        assert not (active & ~trainer.running).any()
    assert playing[0] == ["long", "short"]
    assert ["long"] in playing
    assert trainer.episodes.tolist() == [3, 3]
    assert set(trainer.solutions()) == set(problems)


@pytest.mark.parametrize(("seconds", "steps"), [(0.0, 200), (10.0, 1)])
def test_a_slow_training_looks_at_the_clock_more_often(
    seconds: float, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = Trainer({"p": tiny()}, small_config(5, fused=False))
    now, asked, play = itertools.count(0, seconds), [], type(trainer.learner).play

    def noted(learner: Any, player: Any, ahead: int) -> None:
        asked.append(ahead)
        play(learner, player, ahead)

    monkeypatch.setattr(type(trainer.learner), "play", noted)
    clock = SimpleNamespace(monotonic=lambda: next(now))
    monkeypatch.setattr("policies.learned.trainer.time", clock)
    train(trainer)
    assert set(asked[1:]) == {steps}


def test_options_of_trainings_without_an_effect_are_refused() -> None:
    with pytest.raises(InputError, match=r"^best: expected routes with train.games"):
        TrainOptions(games=2, shared=True, best="reward")
    visited = {"env": {"mask": {"visited": True}}}
    config_of({**visited, "learner": {"kind": "dqn", "masking": True}})
    with pytest.raises(InputError, match=r"^env.mask.visited: expected false with learner.masking"):
        config_of({**visited, "learner": {"kind": "dqn", "masking": False}})


def test_a_shared_memory_holds_the_moves_of_a_step() -> None:
    config = small_config(agents="multi", shared=True, burn_in_size=4, buffer_size=5)
    with pytest.raises(InputError, match="buffer_size: expected at least 6"):
        Trainer({"p": tiny(), "q": tiny(1)}, config)


@pytest.mark.parametrize("agents", ["single", "multi"])
def test_burn_in(agents: Any) -> None:
    # A*'s moves join every task on the shortest way where there is room; random walks hardly do.
    problems = {"p": tiny(capacity=9, nets=5), "q": tiny(1, capacity=9, nets=2)}
    rates = {}
    for kind in ("astar", "random"):
        config = small_config(burn_in=kind, burn_in_size=600, agents=agents, max_steps=10)
        trainer = Trainer(problems, config)
        trainer.burn_in()
        lanes = np.array([5, 2]) if agents == "multi" else np.ones(2)
        assert (trainer.learner.stored >= 600).all()
        assert (trainer.learner.stored < 600 + lanes).all()
        rewards = memory_of(trainer).reward[:, :600]
        assert np.isin(rewards, (-1, REACHED)).all()
        rates[kind] = (rewards == REACHED).mean(axis=1)
        assert (trainer.player.engine.games["steps"] == 0).all()  # training starts from the start
    for m, problem in enumerate(problems.values()):
        lengths = []
        for net in problem.nets:
            (ax, ay, _), (bx, by, _) = net.pins
            dx, dy = abs(ax // 10 - bx // 10), abs(ay // 10 - by // 10)
            lengths.append(dx + dy + (2 if dy else 0))  # layer 2 runs along y: up and down again
        # Whole episodes, and the part of one at the end.
        assert rates["astar"][m] == pytest.approx(len(lengths) / sum(lengths), rel=0.1)
        assert rates["random"][m] < rates["astar"][m] / 3


@pytest.mark.parametrize("agents", ["single", "multi"])
def test_burn_in_can_replay_solutions(agents: Any, tmp_path: Path) -> None:
    """Those of a router, or the same from files: the memory is the same to the bit."""
    problems = {f"p{seed}": tiny(seed, capacity=9, nets=5) for seed in range(2)}
    routed = {name: PathfinderRouter().route(problem) for name, problem in problems.items()}
    for name, solution in routed.items():
        solution.write(tmp_path / f"{name}.mine.solution")
    memories = []
    for kind in ("pathfinder", str(tmp_path)):
        config = small_config(burn_in=kind, burn_in_size=300, agents=agents, max_steps=40)
        trainer = Trainer(problems, config)
        trainer.burn_in()
        memories.append(memory_of(trainer))
        rewards = memories[-1].reward[:, :300]
        for m, (name, solution) in enumerate(routed.items()):
            # All tasks are joined, with no more steps than twice their route's edges.
            assert (rewards[m] == REACHED).mean() > 5 / (2.1 * len(solution.uses[0])), name
    np.testing.assert_array_equal(memories[0].reward, memories[1].reward)
    np.testing.assert_array_equal(memories[0].obs, memories[1].obs)

    single = {"p0": problems["p0"]}
    config = small_config(burn_in=str(tmp_path / "p0.mine.solution"), burn_in_size=50)
    Trainer(single, config).burn_in()
    with pytest.raises(InputError, match="expected a folder"):
        Trainer(problems, config).burn_in()
    with pytest.raises(InputError, match=r"expected one of astar, random, .* found 'asrat'"):
        Trainer(single, small_config(burn_in="asrat")).burn_in()
    routed["p0"].write(tmp_path / "p0.other.solution")
    with pytest.raises(InputError, match=r"expected one file p0.solution or .* found 2"):
        Trainer(single, small_config(burn_in=str(tmp_path))).burn_in()


def test_burn_in_with_masking_walks_through_open_edges_only() -> None:
    config = small_config(burn_in="random", burn_in_size=300, masking=True)
    trainer = Trainer({"p": tiny()}, config)
    trainer.burn_in()
    memory = memory_of(trainer)
    env = GlobalRoutingSingle(tiny(), max_steps=config.env.max_steps)
    over = True
    for row in range(300):
        if over:
            _, info = env.reset()
        move = int(memory.move[0, row])
        assert info["action_mask"][move] == 1
        _, _, terminated, truncated, info = env.step(move)
        over = terminated or truncated


@pytest.mark.parametrize("fused", [False, True])
def test_episodes_do_not_depend_on_the_clock(fused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow machine looks at its clock after every step of all games, a fast one seldom."""
    problems = {"p": tiny(), "q": tiny(1, nets=1), "r": tiny(2, nets=40)}
    trainings = []
    for seconds in (1.0, 0.0):
        monkeypatch.setattr(time, "monotonic", itertools.count(step=seconds).__next__)
        trainer = Trainer(problems, small_config(3, epsilon=0.2, fused=fused))
        looks = list(trainer.run())
        trainings.append((len(looks), [episode for ended in looks for episode in ended]))
    (slow, one), (fast, other) = trainings
    assert one == other
    assert slow > 2 * fast


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("cut", [0.3, 0.8])
def test_state_goes_into_another_trainer_and_on(shared: bool, cut: float) -> None:
    """A training cut in two by its state is the training in one."""
    config = small_config(6, epsilon=0.2, target_period=5, shared=shared)
    problems = {"p": tiny(), "q": tiny(1, nets=1), "r": tiny(2, nets=40)}
    whole = Trainer(problems, config)
    expected = train(whole)
    first = Trainer(problems, config)
    episodes: list[Episode] = []
    for finished in first.run():
        episodes += finished
        if len(episodes) >= cut * len(expected):
            break
    assert (first.running.sum() < 3) == (cut == 0.8)  # one problem is done
    second = Trainer(problems, config)
    state = {
        key: {k: v.clone() for k, v in value.items()} if key in ("training", "trainer") else value
        for key, value in first.state().items()
    }
    second.load_state(state, "memory")
    assert 0 < len(episodes) < len(expected)
    assert episodes + train(second) == expected
    assert bits(second) == bits(whole)
    assert torch.equal(networks_of(second), networks_of(whole))
    assert second.solutions() == whole.solutions()


def mean(episodes: Sequence[Episode], field: str) -> float:
    return float(np.mean([getattr(episode, field) for episode in episodes]))


@pytest.mark.parametrize("agents", ["single", "multi"])
def test_it_learns_a_tiny_problem(agents: Any) -> None:
    # 4x4x2 and 3 nets, as the paper's studies of parameters, with room for every net: A*'s
    # wirelength is the least there is.
    problem = tiny(5, capacity=5, reduced_edges=0)
    optimum = evaluate(problem, sequential_astar(problem)).wirelength
    options = {"burn_in_size": 1000, "learning_rate": 1e-3, "target_period": 200}
    raw = {"env": {"agents": agents, "max_steps": 30}, "learner": options}
    config = build(Config, {**raw, "train": {"episodes": 250}})
    trainer = Trainer({"p": problem}, config)
    episodes = train(trainer)
    figures = evaluate(problem, trainer.solutions()["p"])
    assert figures.connected
    assert (figures.overflow, figures.wirelength) == (0, optimum)
    # Not by luck: the last episodes are nearly all like that, the first are not.
    assert mean(episodes[-50:], "joined") > 2.7
    assert optimum <= np.median([episode.wirelength for episode in episodes[-50:]]) < 1.1 * optimum
    assert mean(episodes[-50:], "reward") > mean(episodes[:50], "reward") + 100


@pytest.mark.slow
@pytest.mark.parametrize("agents", ["single", "multi"])
def test_it_learns_a_problem_of_twenty_nets(agents: Any) -> None:
    problem = generate(1, nets=20, seed=3)[0]
    raw = {"env": {"agents": agents, "max_steps": 50}, "train": {"episodes": 300}}
    config = build(Config, raw)  # the defaults learn
    trainer = Trainer({"p": problem}, config)
    episodes = train(trainer)
    figures = evaluate(problem, trainer.solutions()["p"])
    assert figures.connected
    assert figures.overflow == 0
    assert figures.wirelength <= 1.03 * evaluate(problem, sequential_astar(problem)).wirelength
    assert mean(episodes[-50:], "joined") > 19
    assert mean(episodes[-50:], "reward") > mean(episodes[:50], "reward") + 500


# --- what is saved, and what it routes ------------------------------------------------------------


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("agents", ["single", "multi"])
def test_the_saved_network_is_the_best_of_all_evaluations(
    agents: Any, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small_config(
        25, agents=agents, shared=shared, evaluate_every=4, learning_rate=1e-2, gamma=0.9
    )
    problems = {"p": tiny(), "q": tiny(1)}
    trainer = Trainer(problems, config)
    play_greedily = type(trainer.learner).play_greedily
    found: list[tuple[str, int, tuple[int, ...]]] = []

    def note(self: Any, player: Any, network: int) -> None:
        play_greedily(self, player, network)
        for m, problem in enumerate(player.engine.problems):
            name = next(name for name, own in problems.items() if own is problem)
            now = player.engine.metrics(m)
            after = int(
                trainer.episodes.min() if shared else trainer.episodes[trainer.names.index(name)]
            )
            score = now.tasks - now.joined, now.overflow, now.wirelength
            found.append((name, after, score))

    monkeypatch.setattr(type(trainer.learner), "play_greedily", note)
    train(trainer)
    for names in [("p", "q")] if shared else [("p",), ("q",)]:
        scores: dict[int, NDArray[np.int64]] = {}
        for name, after, score in found:
            if name in names:
                scores[after] = scores.get(after, np.zeros(3, np.int64)) + np.array(score)
        assert list(scores)[-1] == 25  # the last network is evaluated whatever comes
        assert len(scores) >= 6
        best = min(scores, key=lambda after: (tuple(scores[after]), after))
        total = np.zeros(3, np.int64)
        for name in names:
            policy = trainer.policy_of(name)
            assert policy.origin == f"policy after {best} episodes, greedy"
            figures = evaluate(problems[name], policy.solve(problems[name]).solution)
            total += [figures.tasks - figures.joined, figures.overflow, figures.wirelength]
        assert tuple(total[:2]) <= tuple(scores[best][:2])


def run_of(tmp_path: Path, **options: Any) -> tuple[Run, list[dict[str, Any]]]:
    """A training in a run folder, and its rows."""
    config = small_config(**{"episodes": 12, "tensorboard": False, "figures": False, **options})
    config = replace(config, out=str(tmp_path / "run"))
    run = Run(config)
    return run, run.execute()


def test_what_a_training_reports_of_its_policy_is_what_the_policy_routes(tmp_path: Path) -> None:
    problem = {"count": 2, "grid": [4, 4, 2], "nets": 3, "capacity": 2, "reduced_edges": 0}
    run, rows = run_of(tmp_path, problem=problem, agents="multi")
    assert [row["router"] for row in rows] == ["astar", "dqn", "dqn_policy"] * 2
    for row in rows[2::3]:
        name = row["problem"]
        policy = TrainedPolicy.load(run.folder / "policy.pt", name)
        routed = policy.solve(run.problems[name])
        assert routed.report == {"from": row["from"]}
        figures = evaluate(run.problems[name], routed.solution)
        assert (figures.joined, figures.overflow, figures.wirelength) == (
            row["joined"],
            row["overflow"],
            row["wirelength"],
        )
        kept = run.folder / "solutions" / f"{name}.dqn_policy.solution"
        assert Solution.read(kept, run.problems[name]) == routed.solution
    for row in rows[1::3]:
        assert row["from"] == f"episode {int(row['from'].split()[1])} of 12"


def test_a_shared_network_routes_problems_of_any_grid(tmp_path: Path) -> None:
    problem = {"count": 2, "grid": [4, 4, 2], "nets": 3, "capacity": 2, "reduced_edges": 0}
    run, _ = run_of(tmp_path, problem=problem, shared=True)
    policy = TrainedPolicy.load(run.folder / "policy.pt")
    for grid in ((4, 4, 2), (9, 6, 3)):
        other = generate(1, grid=grid, nets=5, reduced_edges=0)[0]
        assert len(policy.solve(other).solution.edges) == 5


SWITCHES: dict[str, dict[str, Any]] = {
    "fused": {},
    "double": {"double": True},
    "dueling": {"network": {"hidden": [8], "dueling": True}},
    "all": {
        "double": True,
        "masking": True,
        "network": {"hidden": [8], "dueling": True},
    },
}
KINDS: dict[str, dict[str, Any]] = {
    **SWITCHES,
    "ppo": {"kind": "ppo", "num_envs": 2, "network": {"hidden": [8]}},
    "ppo, central": {"kind": "ppo", "num_envs": 2, "critic": "central", "network": {"hidden": [8]}},
}


def kind_config(kind: str, agents: str, shared: bool, episodes: int = 6) -> Config:
    """A small training by a kind of learner."""
    dqn = {"burn_in_size": 100, "buffer_size": 5000, "network": {"hidden": [8]}}
    learner = KINDS[kind] if "kind" in KINDS[kind] else {**dqn, **KINDS[kind]}
    env = {"agents": agents, "max_steps": 12}
    return build(
        Config,
        {"env": env, "learner": learner, "train": {"episodes": episodes, "shared": shared}},
    )


def pairs() -> Iterator[Any]:
    """Every kind with both settings of agents and of sharing; all combinations with -m slow."""
    for number, kind in enumerate(KINDS):
        for agents, shared in itertools.product(("single", "multi"), (False, True)):
            often = ((agents == "multi") + shared + number) % 2 == 0
            yield pytest.param(kind, agents, shared, marks=[] if often else pytest.mark.slow)


@pytest.fixture
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings may stop within episodes, after every three steps."""
    monkeypatch.setattr("policies.learned.trainer._STEPS", 3)


@pytest.mark.parametrize(("kind", "agents", "shared"), [*pairs()])
@pytest.mark.usefixtures("few_steps")
def test_every_learner_goes_on_from_a_state(kind: str, agents: str, shared: bool) -> None:
    goes_on({"p": tiny(), "q": tiny(1, nets=2)}, kind_config(kind, agents, shared), 5)


GAMES: dict[str, dict[str, Any]] = {
    "trees": {"agents": "multi", "target": "tree", "mask": {"visited": True}},
    "window": {"turn_order": "round_robin", "observation": "window"},
    "rip-up": {"agents": "multi", "reward": "difference", "rip_up": {"rounds": 2, "neighbours": 1}},
    "asked": {"rip_up": {"rounds": 3, "choose": "agents"}, "observation": "window"},
}


COMPILED_ALONE = ("trees", "rip-up")  # games of their own, which no other test compiles


@pytest.mark.parametrize("name", some_slow(GAMES, COMPILED_ALONE))
@pytest.mark.usefixtures("few_steps")
def test_all_games_go_on_within_their_episodes(name: str) -> None:
    problems = {"p": tiny(nets=4, max_pins=3), "q": tiny(1, max_pins=3)}
    learner = {"burn_in_size": 100, "buffer_size": 5000, "network": {"hidden": [8]}}
    given = {"env": {"max_steps": 12, **GAMES[name]}, "learner": learner, "train": {"episodes": 6}}
    goes_on(problems, build(Config, given), 4)


def goes_on(problems: dict[str, Problem], config: Config, count: int) -> None:
    """Checks that a training goes on from within an episode as if never stopped."""
    whole = Trainer(problems, config)
    expected = train(whole)
    assert len(expected) == 12
    first = Trainer(problems, config)
    episodes: list[Episode] = []
    for finished in first.run():
        episodes += finished
        games = first.player.engine.games
        if len(episodes) >= count and ((games["steps"] > 0) & (games["active"] > 0)).any():
            break
    assert len(episodes) < 12
    second = Trainer(problems, config)
    state = first.state()
    for part in ("training", "trainer"):
        state[part] = {name: tensor.clone() for name, tensor in state[part].items()}
    second.load_state(state, "memory")
    assert episodes + train(second) == expected
    assert bits(second) == bits(whole)
    assert torch.equal(networks_of(second), networks_of(whole))


FIRST_EPISODES = {
    60: "76b79e9da054e8c549c22b293efff161106f2dc2b22df5727c583c83be888b73",
    200: "817ee8891866bd6f56ad89bed7cfa8e2fe132607ba2076579d08b68d5e8b55c6",
}


@pytest.mark.parametrize("episodes", some_slow(FIRST_EPISODES, (200,)))
def test_the_papers_training_writes_what_it_always_wrote(episodes: int, tmp_path: Path) -> None:
    """The first episodes by configs/paper/default.yaml, to the byte.

    The digests are those of the release before the learners were opened. They depend on the
    processor's fused multiply-add, which all x86-64 processors with AVX2 have.
    """
    flags = Path("/proc/cpuinfo")
    if not flags.exists() or " fma " not in flags.read_text(encoding="utf-8"):
        pytest.skip("the digests were taken on a processor with fused multiply-add")
    paper = Path(__file__).parent.parent / "configs" / "paper" / "default.yaml"
    quiet = [f"train.episodes={episodes}", "train.figures=false", "train.tensorboard=false"]
    config = load_config(paper, [*quiet, f"out={tmp_path / 'run'}"])
    Run(config).execute()
    written = (tmp_path / "run" / "metrics.jsonl").read_bytes()
    assert hashlib.sha256(written).hexdigest() == FIRST_EPISODES[episodes]


def test_a_step_may_fill_several_rollouts() -> None:
    """A network that 64 games share gets up to 192 transitions a step; 48 are a rollout."""
    learner = {"kind": "ppo", "num_envs": 32, "rollout": 48, "minibatch": 16}
    raw = {
        "env": {"max_steps": 12, "agents": "multi"},
        "learner": {**learner, "network": {"hidden": [8]}},
        "train": {"episodes": 2, "shared": True},
    }
    trainer = Trainer({"a": tiny(0), "b": tiny(1)}, build(Config, raw))
    for _ in trainer.run():
        assert trainer.player.buffers.acted.size == 192
        assert trainer.learner.rollout.count.max() < 48
    # Two epochs of three minibatches each time.
    assert trainer.learner.updates.max() % 6 == 0
    assert trainer.learner.updates.max() > 6 * 192 // 48
