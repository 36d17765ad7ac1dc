"""The learner: gradient steps, memory, random streams and the training loop.

Oracles: torch's autograd with its own Adam for the gradient step; the Gymnasium and Parallel faces
of the environment, played again move by move, for everything that the trainer stores and logs.
"""

import importlib
import itertools
import pkgutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray
from torch import nn

import marouting
import policies
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
from marouting.env.single import GlobalRoutingSingle
from marouting.game.reward import PaperReward
from marouting.problem.grid import MOVES
from policies.learned.compiled.small_gemm import small_gemm as product
from policies.learned.config import Config, DQNOptions, TrainOptions
from policies.learned.dqn import DQN, Backend, Rule, backends
from policies.learned.qnetwork import initial
from policies.learned.replay import Batch, Replay
from policies.learned.stack import Lanes
from policies.learned.streams import keys, uniform, uniforms
from policies.learned.trainer import Episode, Trainer
from policies.routers.pathfinder import PathfinderRouter

FEATURES = 12
REACHED = 100.0
BACKENDS: tuple[Backend, ...] = ("compiled", "torch")


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)  # more of them cost more than they save on networks this small


# --- the gradient step ----------------------------------------------------------------------------


def network(sizes: Sequence[int], row: torch.Tensor) -> nn.Sequential:
    """A network of torch's own layers, in float64, with the weights of a row of the stack.

    In the row every layer's weights (inputs, outputs) are followed by its biases.
    """
    layers: list[nn.Module] = []
    at = 0
    for inputs, outputs in itertools.pairwise(sizes):
        linear = nn.Linear(inputs, outputs, dtype=torch.float64)
        end = at + inputs * outputs
        with torch.no_grad():
            linear.weight.copy_(row[at:end].reshape(inputs, outputs).T)
            linear.bias.copy_(row[end : end + outputs])
        at = end + outputs
        layers += [linear, nn.ReLU()]
    assert at == len(row)
    return nn.Sequential(*layers[:-1])


def flat(net: nn.Sequential) -> NDArray[np.float64]:
    """The weights of a network as a row of the stack."""
    parts = []
    for linear in net:
        if isinstance(linear, nn.Linear):
            parts += [linear.weight.detach().T.reshape(-1), linear.bias.detach()]
    return torch.cat(parts).numpy()


def memory_of(replay: Replay) -> SimpleNamespace:
    """The fields of all transitions in a memory, (L, capacity) or (L, capacity, numbers)."""
    fields = vars(Batch.of(replay.rows, replay.features, replay.masks))
    return SimpleNamespace(
        **{
            name: None
            if field is None
            else field.numpy()[..., 0]
            if field.shape[-1] == 1
            else field.numpy()
            for name, field in fields.items()
        }
    )


def lanes_of(**fields: NDArray[Any]) -> Lanes:
    """What a step's agents saw, did and got; what is not given is nothing."""
    problems, lanes = fields["moved"].shape
    empty = np.zeros((problems, lanes))
    whole = {name: fields.get(name, empty) for name in Lanes._fields}
    for name, of in (("over", np.bool_), ("total", float), ("epsilon", float), ("counters", int)):
        whole[name] = np.zeros(problems, of)
    whole["keys"] = np.zeros(problems, np.uint64)
    whole["agents"] = np.zeros((problems, lanes), np.int32)
    whole["mask"] = whole["arrived_mask"] = fields.get(
        "arrived_mask", np.ones((problems, lanes, MOVES), np.int8)
    )
    whole["values"] = np.zeros((problems, lanes, MOVES), np.float32)
    return Lanes(**whole)


def filled(problems: int, rows: int, masking: bool, seed: int = 0) -> Replay:
    """A memory of random transitions, other ones for every problem."""
    rng = np.random.default_rng(seed)
    replay = Replay(problems, rows, FEATURES, masking)
    shape = (problems, rows)
    mask = rng.integers(2, size=(*shape, MOVES), dtype=np.int8)
    mask[..., 0] |= ~mask.any(axis=2)
    replay.add(
        lanes_of(
            moved=np.ones(shape, np.bool_),
            seen=rng.normal(size=(*shape, FEATURES)).astype(np.float32),
            moves=rng.integers(MOVES, size=shape, dtype=np.int8),
            reward=rng.choice(np.array([-1, 10], np.float32), size=shape),
            arrived=rng.normal(size=(*shape, FEATURES)).astype(np.float32),
            goes_on=rng.random(shape) < 0.8,
            arrived_mask=mask,
        )
    )
    return replay


def learner_of(backend: Backend, replay: Replay, hidden: Sequence[int] = (8,), **rule: Any) -> DQN:
    """A learner on a memory; its networks are called a, b, c and so on."""
    given = {"batch": 8, "gamma": 0.9, "target_period": 2, "learning_rate": 1e-2, **rule}
    names = "abcdefgh"[: len(replay.stored)]
    return backends()[backend](
        replay,
        hidden,
        MOVES,
        seeds=range(5, 5 + len(names)),
        keys=keys(3, names, "sample"),
        rule=Rule(**given),
    )


def sample(replay: Replay, size: int, drawn_by: NDArray[np.uint64], counters: Any) -> Batch:
    """A sample as the learners take it."""
    return replay.sample(
        size,
        torch.from_numpy(drawn_by.view(np.int64)),
        torch.as_tensor(np.asarray(counters, np.int64)),
        torch.from_numpy(replay.stored),
    )


@pytest.mark.parametrize(
    ("hidden", "batch_size", "target_period", "masking"),
    [
        ((32, 64, 32), 32, 0, False),
        ((32, 64, 32), 32, 7, True),
        ((5,), 1, 0, True),
        ((), 16, 3, False),
        ((17, 3), 64, 1, False),
    ],
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_gradient_step_is_that_of_autograd_and_adam(
    backend: Backend,
    hidden: tuple[int, ...],
    batch_size: int,
    target_period: int,
    masking: bool,
) -> None:
    problems, gamma, rate = 3, 0.9, 1e-3
    sizes = (FEATURES, *hidden, MOVES)
    replay = filled(problems, 300, masking)
    learner = learner_of(
        backend,
        replay,
        hidden,
        gamma=gamma,
        learning_rate=rate,
        batch=batch_size,
        target_period=target_period,
    )
    nets = [network(sizes, row) for row in learner.weights]
    targets = [
        network(sizes, row) if target_period else nets[m] for m, row in enumerate(learner.weights)
    ]
    optimizers = [torch.optim.Adam(net.parameters(), lr=rate) for net in nets]
    assert len({tuple(flat(net)[:4]) for net in nets}) == problems
    for step in range(1, 51):
        batch = sample(replay, batch_size, learner.keys, learner.steps)
        before = learner.loss.numpy().copy()
        learner.learn(np.ones(problems, np.bool_))
        loss = learner.loss.numpy() - before
        for m, (net, target, optimizer) in enumerate(zip(nets, targets, optimizers, strict=True)):
            with torch.no_grad():
                following = target(batch.arrived[m].double())
                if batch.mask is not None:
                    following[batch.mask[m] == 0] = -1e9
                best = following.max(dim=1).values
                wanted = batch.reward[m, :, 0] + gamma * batch.goes_on[m, :, 0] * best
            chosen = net(batch.seen[m].double())[torch.arange(batch_size), batch.move[m, :, 0]]
            expected = nn.functional.mse_loss(chosen, wanted)
            optimizer.zero_grad()
            expected.backward()
            optimizer.step()
            if target_period and step % target_period == 0:
                target.load_state_dict(net.state_dict())
            assert loss[m] == pytest.approx(expected.item(), rel=1e-3)
            if step in (1, 5, 50):
                moved = np.abs(flat(net) - learner.weights[m].numpy()).max()
                assert moved < 1e-5 + 2e-4 * rate * step, (step, moved)
        assert learner.steps.tolist() == [step] * problems
    held = torch.stack([torch.from_numpy(flat(target)) for target in targets])
    assert torch.allclose(learner.target.double(), held, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_steps_due_together_are_steps_one_by_one(backend: Backend) -> None:
    together, apart = (learner_of(backend, filled(3, 50, masking=False)) for _ in range(2))
    together.learn(np.array([3, 0, 1]))
    for due in ([1, 0, 1], [1, 0, 0], [1, 0, 0]):
        apart.learn(np.array(due))
    assert together.steps.tolist() == [3, 0, 1]
    assert together.loss[1] == 0
    for a, b in zip(tensors(together), tensors(apart), strict=True):
        assert np.array_equal(a, b)


def test_compiled_functions_do_not_share_a_place_in_the_cache() -> None:
    # Numba's cache knows a function by its name and line, not by its options: of two compiled from
    # one, serial and parallel, the second would be the first.
    places = []
    for package in (marouting, policies):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Dispatcher) and value.__module__ == module.name:
                    code = value.py_func.__code__
                    places.append((code.co_filename, code.co_firstlineno))
    assert len(places) > 20
    assert len(set(places)) == len(places)


def tensors(learner: DQN) -> list[NDArray[Any]]:
    """Weights, optimiser states, counts and memories."""
    return [tensor.numpy().copy() for tensor in learner.state().values()]


@pytest.mark.parametrize("backend", BACKENDS)
def test_networks_that_are_not_chosen_stay_as_they_are(backend: Backend) -> None:
    learner = learner_of(backend, filled(3, 50, masking=False))
    for _ in range(3):
        learner.learn(np.ones(3, np.bool_))
    before = {name: tensor.clone() for name, tensor in learner.state().items()}
    for _ in range(5):
        learner.learn(np.array([True, False, True]))
    after = learner.state()
    assert learner.steps.tolist() == [8, 3, 8]
    for name in ("weights", "target", "mean", "square", "loss"):
        assert torch.equal(before[name][1], after[name][1])
        assert not torch.equal(before[name][0], after[name][0])
        assert not torch.equal(before[name][2], after[name][2])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_network_learns_the_same_whoever_else_is_chosen(backend: Backend) -> None:
    together, apart = (learner_of(backend, filled(3, 50, masking=False)) for _ in range(2))
    for _ in range(4):
        together.learn(np.ones(3, np.bool_))
    for row in range(3):
        for _ in range(4):
            apart.learn(np.arange(3) == row)
    for a, b in zip(tensors(together), tensors(apart), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("target_period", [0, 2])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_network_learns_the_same_when_others_have_left(
    backend: Backend, target_period: int
) -> None:
    whole, part = (
        learner_of(backend, filled(4, 50, masking=True), target_period=target_period)
        for _ in range(2)
    )
    stay = np.array([1, 3])
    for learner in (whole, part):
        for _ in range(3):
            learner.learn(np.array([1, 2, 0, 1]))
    part.keep(stay)
    for _ in range(5):
        whole.learn(np.array([0, 1, 0, 2]))
        part.learn(np.array([1, 2]))
    for a, b in zip(tensors(whole), tensors(part), strict=True):
        np.testing.assert_allclose(a[stay], b, atol=1e-6)
    assert (part.target is part.weights) == (target_period == 0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_learner_goes_on_from_its_state(backend: Backend) -> None:
    first = learner_of(backend, filled(3, 50, masking=True))
    first.learn(np.array([1, 2, 3]))
    second = learner_of(backend, filled(3, 50, masking=True, seed=1))
    second.load_state({name: tensor.clone() for name, tensor in first.state().items()})
    for learner in (first, second):
        learner.learn(np.array([2, 2, 1]))
    for a, b in zip(tensors(first), tensors(second), strict=True):
        assert np.array_equal(a, b)


def test_backends_give_the_same_values() -> None:
    seen = np.random.default_rng(0).normal(size=(3, 5, FEATURES)).astype(np.float32)
    memory = filled(3, 1, masking=False)
    compiled, batched = (learner_of(backend, memory).values(seen) for backend in BACKENDS)
    np.testing.assert_allclose(compiled, batched, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_only_a_joined_task_ends_the_sum_of_rewards(backend: Backend) -> None:
    # One transition, over and over: what the network wants for it is r, or r + γ max Q'.
    for goes_on in (False, True):
        memory = Replay(1, 4, FEATURES, masks=False)
        one = np.ones((1, 1), np.bool_)
        here = np.full((1, 1, FEATURES), 0.5, np.float32)
        memory.add(
            lanes_of(
                moved=one,
                seen=here,
                moves=np.full((1, 1), 2, np.int8),
                reward=np.full((1, 1), 3, np.float32),
                arrived=2 * here,
                goes_on=one & goes_on,
            )
        )
        learner = learner_of(backend, memory, target_period=1_000_000)
        bootstrapped = learner.values(2 * here).max()
        for _ in range(400):
            learner.learn(np.ones(1, np.bool_))
        value = learner.values(here)[0, 0, 2]
        assert value == pytest.approx(3 + (0.9 * bootstrapped if goes_on else 0), abs=0.02)
        assert abs(0.9 * bootstrapped) > 0.02


@pytest.mark.parametrize(("init", "bound"), [("torch", FEATURES**-0.5), ("uniform", 0.5)])
def test_initial_weights(init: Any, bound: float) -> None:
    weights = initial((FEATURES, 400, MOVES), [1, 2, 1], init)
    first = weights[:, : FEATURES * 400].numpy()
    biases = weights[:, FEATURES * 400 : (FEATURES + 1) * 400].numpy()
    assert np.abs(first).max() == pytest.approx(bound, rel=0.01)
    assert np.abs(first).mean() == pytest.approx(bound / 2, rel=0.05)
    assert np.abs(biases).max() == (0 if init == "uniform" else pytest.approx(bound, rel=0.05))
    assert np.array_equal(first[0], first[2])
    assert not np.array_equal(first[0], first[1])


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(1, 37),
    depth=st.integers(0, 37),
    columns=st.integers(1, 37),
    turned=st.booleans(),
    floor=st.sampled_from([0.0, -np.inf]),
    seed=st.integers(0, 99),
)
def test_products_of_matrices(
    rows: int, depth: int, columns: int, turned: bool, floor: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    a, b, start = (
        rng.normal(size=shape).astype(np.float32)
        for shape in ((rows, depth), (depth, columns), (columns,))
    )
    held = np.ascontiguousarray(a.T if turned else a).ravel()
    strides = (1, rows) if turned else (depth, 1)
    out = np.full(rows * columns + 1, 7, np.float32)
    product(
        np.append(np.float32(9), held), 1, *strides, b.ravel(), 0, start, 0, out,
        rows, depth, columns, np.float32(floor),
    )  # fmt: skip
    expected = np.maximum(a.astype(float) @ b.astype(float) + start, floor)
    np.testing.assert_allclose(out[:-1].reshape(rows, columns), expected, atol=1e-4)
    assert out[-1] == 7


# --- memory ---------------------------------------------------------------------------------------


def remember(replay: Replay, numbers: NDArray[np.float32], moved: NDArray[np.bool_]) -> None:
    """Stores transitions that carry a number in every field; numbers and moved are (M, K)."""
    wide = np.repeat(numbers[..., None], FEATURES, axis=2)
    odd = numbers.astype(np.int64) % 2 == 1
    moves = (numbers % MOVES).astype(np.int8)
    replay.add(
        lanes_of(moved=moved, seen=wide, moves=moves, reward=numbers, arrived=wide + 1, goes_on=odd)
    )


def contents(replay: Replay, m: int) -> list[float]:
    """The numbers in a problem's memory, in order."""
    size = min(int(replay.stored[m]), replay.rows.shape[1])
    return sorted(memory_of(replay).reward[m, :size].tolist())


def test_memory_is_a_ring_that_keeps_the_newest() -> None:
    replay = Replay(2, 10, FEATURES, masks=False)
    stored: tuple[list[float], list[float]] = ([], [])
    rng = np.random.default_rng(0)
    for step in range(30):
        numbers = np.array([[3 * step + k for k in range(3)] for _ in range(2)], np.float32)
        moved = rng.random((2, 3)) < np.array([[0.3], [0.8]])
        remember(replay, numbers, moved)
        for m in range(2):
            stored[m].extend(numbers[m][moved[m]].tolist())
            assert contents(replay, m) == stored[m][-10:]
    assert replay.stored.tolist() == [len(stored[0]), len(stored[1])]
    assert replay.stored.min() > 10  # both have wrapped
    batch = sample(replay, 64, keys(0, "ab", "s"), [0, 0])
    number = batch.reward
    assert torch.equal(batch.seen, number.expand(-1, -1, FEATURES))
    assert torch.equal(batch.arrived, number.expand(-1, -1, FEATURES) + 1)
    assert torch.equal(batch.move, number.long() % MOVES)
    assert torch.equal(batch.goes_on, number % 2)
    assert batch.mask is None


@pytest.mark.parametrize("stored", [1, 7, 25, 40])
def test_samples_are_uniform(stored: int) -> None:
    replay = Replay(1, 25, FEATURES, masks=False)
    remember(replay, np.arange(stored, dtype=np.float32)[None], np.ones((1, stored), np.bool_))
    there = contents(replay, 0)
    assert there == list(range(max(stored - 25, 0), stored))
    drawn: list[float] = []
    for counter in range(200):
        batch = sample(replay, 50, keys(1, ["a"], "s"), [counter])
        drawn += batch.reward.flatten().tolist()
    counts = np.array([drawn.count(number) for number in there])
    assert counts.sum() == len(drawn)
    expected = len(drawn) / len(there)
    chi_square = ((counts - expected) ** 2 / expected).sum()
    freedom = len(there) - 1
    assert chi_square <= freedom + 6 * (2 * freedom) ** 0.5


def test_samples_do_not_depend_on_the_rest_of_the_stack() -> None:
    small, large = Replay(1, 25, FEATURES, masks=False), Replay(3, 25, FEATURES, masks=False)
    numbers = np.arange(20, dtype=np.float32)[None]
    remember(small, numbers, np.ones((1, 20), np.bool_))
    moved = np.ones((3, 20), np.bool_)
    moved[0, 7:] = False  # the problem before holds less, the one after holds other numbers
    remember(large, np.concatenate((numbers + 100, numbers, numbers + 200)), moved)
    alone = sample(small, 30, keys(1, ["b"], "s"), [4])
    beside = sample(large, 30, keys(1, ["a", "b", "c"], "s"), [9, 4, 2])
    assert torch.equal(alone.reward[0], beside.reward[1])
    assert torch.equal(alone.seen[0], beside.seen[1])
    assert beside.reward[0].min() >= 100
    assert beside.reward[2].min() >= 200


# --- streams --------------------------------------------------------------------------------------


def draw(key: np.uint64, counters: int, lanes: int) -> NDArray[np.float64]:
    return np.array([[uniform(key, c, k) for k in range(lanes)] for c in range(counters)])


def test_numbers_are_uniform_and_not_correlated() -> None:
    numbers = draw(keys(0, ["a"], "x")[0], 500, 20)
    assert numbers.min() >= 0
    assert numbers.max() < 1
    assert len(np.unique(numbers)) == numbers.size
    counts, _ = np.histogram(numbers, bins=50, range=(0, 1))
    expected = numbers.size / 50
    assert ((counts - expected) ** 2 / expected).sum() < 49 + 6 * 98**0.5
    for a, b in ((numbers[1:], numbers[:-1]), (numbers[:, 1:], numbers[:, :-1])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 5 / a.size**0.5


def test_torch_draws_the_same_numbers() -> None:
    own = keys(7, ["a", "b"], "x")
    counters, lanes = [0, 10**9], 300
    drawn = uniforms(
        torch.from_numpy(own.view(np.int64)), torch.tensor(counters), torch.arange(lanes)
    )
    expected = [
        [uniform(k, c, i) for i in range(lanes)] for k, c in zip(own, counters, strict=True)
    ]
    assert drawn.tolist() == expected


def test_keys_differ_by_seed_name_and_purpose() -> None:
    named = [
        (seed, name, purpose)
        for seed in (0, 1, 2**40)
        for name in ("a", "b", "problem_000")
        for purpose in ("explore", "sample")
    ]
    found = [int(keys(seed, [name], purpose)[0]) for seed, name, purpose in named]
    assert len(set(found)) == len(named)
    assert found == [int(keys(seed, [name], purpose)[0]) for seed, name, purpose in named]
    assert keys(0, ["a", "b"], "x").tolist() == [
        int(keys(0, [name], "x")[0]) for name in ("a", "b")
    ]
    a, b = (draw(key, 100, 5) for key in keys(0, ["a", "b"], "x"))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.2


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
        **options: fields of EnvOptions, DQNOptions and TrainOptions.
    """
    fields = {
        part: {k: v for k, v in options.items() if k in part.__dataclass_fields__}
        for part in (EnvOptions, DQNOptions, TrainOptions)
    }
    learner = {"burn_in_size": 100, "buffer_size": 5000, "hidden": (8,), **fields[DQNOptions]}
    return Config(
        seed=seed,
        env=EnvOptions(**{"max_steps": 12, **fields[EnvOptions]}),
        dqn=DQNOptions(**learner),
        train=TrainOptions(episodes=episodes, **fields[TrainOptions]),
    )


def train(trainer: Trainer) -> list[Episode]:
    """Runs a training to its end."""
    return [episode for finished in trainer.run() for episode in finished]


def bits(trainer: Trainer) -> list[bytes]:
    """All weights and optimiser states."""
    return [tensor.numpy().tobytes() for tensor in trainer.learner.state().values()]


class Replayed:
    """The moves in a trainer's memory, played again through the faces of the environment.

    Everything that the trainer stored is compared with what the face shows on the way.

    Args:
        trainer: of one problem, after its training, with room in memory for every transition.
        burnt: how many transitions at the start of memory are burn-in.
    """

    def __init__(self, trainer: Trainer, burnt: int) -> None:
        replay = trainer.learner.replay
        self.memory = memory_of(replay)
        self.rows = int(replay.stored[0])
        assert burnt < self.rows <= replay.rows.shape[1], "the memory must not have wrapped"
        self.at = burnt
        self.masks: list[NDArray[np.int8]] = []  # of every move
        self.failed = 0  # tasks
        self.everyone = trainer.config.env.agents == "multi"
        env = trainer.config.env
        self.options = {
            "max_steps": env.max_steps,
            "overflow": env.overflow,
            "turn_order": env.turn_order,
            "reward": env.reward,
        }
        self.problem = trainer.engine.problems[0]

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
        env = global_routing_v0.parallel_env(self.problem, **self.options)
        seen, infos = env.reset()
        total, steps = 0.0, dict.fromkeys(env.possible_agents, 0)
        while env.agents:
            moves = {  # all look before anyone moves
                agent: self._take(self.at + i, seen[agent], infos[agent]["action_mask"])
                for i, agent in enumerate(env.agents)
            }
            seen, rewards, _, _, infos = env.step(moves)
            for agent in moves:
                steps[agent] = self._gave(rewards[agent], seen[agent], steps[agent] + 1)
                total += rewards[agent]
        return env, total

    def _take(self, row: int, seen: NDArray[np.float32], mask: NDArray[np.int8]) -> int:
        """A row's move, its observation checked."""
        assert np.array_equal(self.memory.seen[0, row], seen)
        self.masks.append(mask)
        return int(self.memory.move[0, row])

    def _gave(self, reward: float, seen: NDArray[np.float32] | None, steps: int) -> int:
        """Checks what came of the next row's move; returns the steps of the task, 0 at its end."""
        memory, row = self.memory, self.at
        joined = reward > REACHED / 2  # overflow may have a price
        failed = not joined and steps == self.options["max_steps"]
        arrived = memory.arrived[0, row]
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
    "single, torch": {"backend": "torch", "steps_per_update": 3},
    "single, round robin": {"turn_order": "round_robin"},
    "single, overflow": {
        "overflow": "allowed",
        "reward": PaperReward(own_edge=0, overflow_price=2.5),
    },
    "multi, best by reward": {"agents": "multi", "best": "reward"},
    "multi": {"agents": "multi"},
    "multi, a step for three moves": {"agents": "multi", "steps_per_update": 3},
    "multi, overflow": {
        "agents": "multi",
        "overflow": "allowed",
        "reward": PaperReward(overflow_price=1),
    },
    "multi, masked, torch": {"agents": "multi", "masking": True, "backend": "torch"},
}


@pytest.mark.parametrize("options", LEARNERS.values(), ids=LEARNERS)
def test_memory_and_episodes_are_what_the_environment_shows(options: dict[str, Any]) -> None:
    config = small_config(**{"epsilon": 0.3, **options}, max_steps=9)
    env, problem = config.env, tiny(nets=5)
    trainer = Trainer({"p": problem}, config)
    trainer.burn_in()
    burnt = int(trainer.learner.replay.stored[0])
    lanes = 5 if config.env.agents == "multi" else 1
    assert 100 <= burnt < 100 + lanes
    episodes = train(trainer)
    assert [episode.episode for episode in episodes] == list(range(6))

    replayed = Replayed(trainer, burnt)
    walked = [replayed.episode(episode) for episode in episodes]
    assert replayed.at == replayed.rows
    assert replayed.failed > 0  # among them tasks that ran out of steps
    assert all(episode.overflow == 0 for episode in episodes) == (env.overflow == "forbidden")
    moves = memory_of(trainer.learner.replay).move[0, burnt : replayed.rows]
    allowed = np.stack(replayed.masks)[np.arange(len(moves)), moves]
    assert allowed.all() == config.dqn.masking
    assert trainer.updates.tolist() == [len(moves) // config.dqn.steps_per_update]
    assert [episode.updates for episode in episodes] == (
        np.cumsum([episode.steps for episode in episodes]) // config.dqn.steps_per_update
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
    burnt = int(trainer.learner.replay.stored[0])
    episode = train(trainer)[0]
    env = GlobalRoutingSingle(trainer.engine.problems[0], max_steps=9)
    env.reset()
    memory, compared = memory_of(trainer.learner.replay), 0
    for row in range(burnt, burnt + episode.steps):
        seen, *_, info = env.step(int(memory.move[0, row]))
        if np.array_equal(seen, memory.arrived[0, row]):  # the task went on
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
    first = network((FEATURES, 8, MOVES), trainer.learner.weights[0])
    trainer.burn_in()
    burnt = int(trainer.learner.replay.stored[0])
    episodes = train(trainer)
    replayed = Replayed(trainer, burnt)
    assert trainer.updates.tolist() == [0]
    memory, rows = memory_of(trainer.learner.replay), slice(burnt, replayed.rows)
    with torch.no_grad():
        values = first(torch.from_numpy(memory.seen[0, rows]).double()).numpy()
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
    constant = DQNOptions(epsilon=0.07)
    assert {constant.epsilon_at(e, 100) for e in range(100)} == {0.07}
    # The paper's Table 2, row 7: 0.05, falling to 0.01 from episode 2000 to the last.
    falling = DQNOptions(epsilon=0.05, epsilon_final=0.01, epsilon_decay_from=2000)
    values = [falling.epsilon_at(e, 5001) for e in range(5001)]
    assert set(values[:2001]) == {0.05}
    assert values[3500] == pytest.approx(0.03)
    assert values[-1] == pytest.approx(0.01)
    assert np.diff(values[2000:]) == pytest.approx(-0.04 / 3000)
    assert DQNOptions(epsilon=0.5, epsilon_final=0).epsilon_at(0, 1) == 0.5

    config = small_config(epsilon=0.8, epsilon_final=0.2, epsilon_decay_from=2)
    logged = [episode.epsilon for episode in train(Trainer({"p": tiny()}, config))]
    assert logged == pytest.approx([0.8, 0.8, 0.8, 0.6, 0.4, 0.2])


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_seeds_decide_everything(backend: Backend, agents: Any) -> None:
    problems = {"p": tiny(), "q": tiny(1)}
    config = small_config(4, backend=backend, agents=agents, epsilon=0.2)
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
        trainers[1].learner.weights.copy_(trainers[0].learner.weights)
    first, second = map(train, trainers)
    if purpose == "sample":  # too small a rate to show in the moves
        assert [e.loss for e in first] != [e.loss for e in second]
        assert [replace(e, loss=0) for e in first] == [replace(e, loss=0) for e in second]
    else:
        moves = [memory_of(trainer.learner.replay).move for trainer in trainers]
        assert not np.array_equal(*moves)


@pytest.mark.parametrize("agents", ["single", "multi"])
def test_loss_is_the_mean_of_the_gradient_steps_of_an_episode(
    agents: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small_config(4, agents=agents, backend="torch")  # the compiled one trains alike
    trainer = Trainer({"p": tiny(), "q": tiny(1)}, config)
    kind = type(trainer.learner)
    learn = kind.learn
    taken: dict[str, list[tuple[int, float]]] = {name: [] for name in trainer.names}

    def note(self: DQN, due: NDArray[np.integer]) -> None:
        steps, loss = self.steps.copy(), self.loss.numpy().copy()
        learn(self, due)
        for row, problem in enumerate(trainer.places):
            change = int(self.steps[row] - steps[row]), float(self.loss[row] - loss[row])
            taken[trainer.names[problem]].append(change)

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
    config = small_config(3, backend="compiled", agents=agents, epsilon=0.2)
    one = Trainer(problems, config)
    expected = train(one)
    two = Trainer(problems, replace(config, train=replace(config.train, threads=2)))
    assert train(two) == expected
    assert bits(two) == bits(one)


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_problem_trains_alone_as_in_a_stack(backend: Backend, agents: Any) -> None:
    # The others have more nets, other rates of ending, and train before and after it.
    config = small_config(5, backend=backend, agents=agents, epsilon=0.2, learning_rate=1e-3)
    stack = {"a": tiny(1, nets=6), "p": tiny(0), "z": tiny(2, nets=1)}
    alone = Trainer({"p": stack["p"]}, config)
    beside = Trainer(stack, config)
    expected = train(alone)
    found = [episode for episode in train(beside) if episode.problem == "p"]
    for mine, theirs in zip(found, expected, strict=True):
        assert mine.loss == pytest.approx(theirs.loss, rel=1e-3)
        assert replace(mine, loss=0) == replace(theirs, loss=0)
    np.testing.assert_allclose(beside.weights[1].numpy(), alone.weights[0].numpy(), atol=1e-4)
    assert beside.solutions()["p"] == alone.solutions()["p"]


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("shared", [False, True])
def test_backends_train_alike(agents: Any, shared: bool) -> None:
    options = {"epsilon": 0.2, "target_period": 5, "agents": agents, "shared": shared}
    problems = {"p": tiny(), "q": tiny(1, nets=1)}
    compiled, batched = (
        Trainer(problems, small_config(4, backend=backend, **options)) for backend in BACKENDS
    )
    # What ends between two looks at the trainer is in the order of the problems.
    episodes = [train(trainer) for trainer in (compiled, batched)]
    for name in problems:
        mine, theirs = ([episode for episode in e if episode.problem == name] for e in episodes)
        for a, b in zip(mine, theirs, strict=True):
            assert a.loss == pytest.approx(b.loss, rel=1e-3)
            assert replace(a, loss=0) == replace(b, loss=0)
    np.testing.assert_allclose(compiled.weights.numpy(), batched.weights.numpy(), atol=1e-5)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("agents", ["single", "multi"])
def test_a_gpu_trains_alike(agents: Any) -> None:  # pragma: no cover - none where CI runs
    problems = {"p": tiny(), "q": tiny(1, nets=1)}
    config = small_config(6, agents=agents, backend="torch", epsilon=0.2, target_period=5)
    here = Trainer(problems, config)
    there = Trainer(problems, replace(config, train=replace(config.train, device="cuda")))
    for mine, theirs in zip(train(here), train(there), strict=True):
        assert mine.loss == pytest.approx(theirs.loss, rel=1e-3)
        assert replace(mine, loss=0) == replace(theirs, loss=0)
    np.testing.assert_allclose(here.weights.numpy(), there.weights.numpy(), atol=1e-4)


def test_one_network_learns_from_all_nets() -> None:
    trainer = Trainer({"p": tiny(nets=4)}, small_config(2, agents="multi"))
    assert trainer.learner.weights.shape[0] == 1
    episodes = train(trainer)
    burnt = int(trainer.learner.replay.stored[0]) - sum(episode.steps for episode in episodes)
    first = memory_of(trainer.learner.replay).seen[0, burnt : burnt + 4]
    env = global_routing_v0.parallel_env(trainer.engine.problems[0])
    seen, _ = env.reset()
    assert np.array_equal(first, np.stack([seen[agent] for agent in env.possible_agents]))


@pytest.mark.parametrize("agents", ["single", "multi"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_one_network_learns_from_all_problems(backend: Backend, agents: Any) -> None:
    problems = {"p": tiny(nets=4), "q": tiny(1, nets=2), "r": tiny(2, nets=3)}
    config = small_config(3, agents=agents, backend=backend, shared=True, epsilon=0.3)
    trainer = Trainer(problems, config)
    trainer.burn_in()
    burnt = int(trainer.learner.replay.stored[0])
    assert 100 <= burnt < 100 + sum(len(problem.nets) for problem in problems.values())
    episodes = train(trainer)
    moves = sum(episode.steps for episode in episodes)
    assert trainer.weights.shape == trainer.learner.weights.shape
    assert trainer.weights.shape[0] == 1
    assert trainer.learner.replay.stored.tolist() == [burnt + moves]
    assert trainer.learner.steps.tolist() == [moves]
    assert {episode.updates for episode in episodes[-1:]} == {moves}
    # What each problem's first observation was is in the one memory, in turn.
    memory = memory_of(trainer.learner.replay)
    at = burnt
    for problem in problems.values():
        env = GlobalRoutingSingle(problem) if agents == "single" else None
        if env is None:
            faces = global_routing_v0.parallel_env(problem)
            seen = list(faces.reset()[0].values())
        else:
            seen = [env.reset()[0]]
        for one in seen:
            assert np.array_equal(memory.seen[0, at], one)
            at += 1
    assert set(trainer.solutions()) == set(problems)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shared", [False, True])
def test_a_problem_that_is_done_leaves_the_stack(shared: bool, backend: Backend) -> None:
    # One net against thirty: it is done long before.
    problems = {"long": tiny(nets=30), "short": tiny(1, nets=1)}
    trainer = Trainer(problems, small_config(3, epsilon=0.9, shared=shared, backend=backend))
    stacks = []
    for _ in trainer.run():
        stacks.append([trainer.names[problem] for problem in trainer.places])
        assert len(trainer.engine.games) == len(trainer.places)
        assert len(trainer.learner.steps) == (1 if shared else len(trainer.places))
    assert stacks[0] == ["long", "short"]
    assert stacks[-2:] == [["long"], ["long"]]
    assert set(trainer.solutions()) == set(problems)


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
        assert (trainer.learner.replay.stored >= 600).all()
        assert (trainer.learner.replay.stored < 600 + lanes).all()
        rewards = memory_of(trainer.learner.replay).reward[:, :600]
        assert np.isin(rewards, (-1, REACHED)).all()
        rates[kind] = (rewards == REACHED).mean(axis=1)
        assert (trainer.engine.games["steps"] == 0).all()  # training starts from the start
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
        memories.append(memory_of(trainer.learner.replay))
        rewards = memories[-1].reward[:, :300]
        for m, (name, solution) in enumerate(routed.items()):
            # All tasks are joined, with no more steps than twice their route's edges.
            assert (rewards[m] == REACHED).mean() > 5 / (2.1 * len(solution.uses[0])), name
    np.testing.assert_array_equal(memories[0].reward, memories[1].reward)
    np.testing.assert_array_equal(memories[0].seen, memories[1].seen)

    single = {"p0": problems["p0"]}
    config = small_config(burn_in=str(tmp_path / "p0.mine.solution"), burn_in_size=50)
    Trainer(single, config).burn_in()
    with pytest.raises(InputError, match="expected a folder"):
        Trainer(problems, config)
    with pytest.raises(InputError, match=r"expected one of astar, random, .* found 'asrat'"):
        Trainer(single, small_config(burn_in="asrat"))
    routed["p0"].write(tmp_path / "p0.other.solution")
    with pytest.raises(InputError, match=r"expected one file p0.solution or .* found 2"):
        Trainer(single, small_config(burn_in=str(tmp_path)))


def test_burn_in_with_masking_walks_through_open_edges_only() -> None:
    config = small_config(burn_in="random", burn_in_size=300, masking=True)
    trainer = Trainer({"p": tiny()}, config)
    trainer.burn_in()
    memory = memory_of(trainer.learner.replay)
    env = GlobalRoutingSingle(tiny(), max_steps=config.env.max_steps)
    over = True
    for row in range(300):
        if over:
            _, info = env.reset()
        move = int(memory.move[0, row])
        assert info["action_mask"][move] == 1
        _, _, terminated, truncated, info = env.step(move)
        over = terminated or truncated


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
    assert (len(first.places) < 3) == (cut == 0.8)  # one problem has left
    second = Trainer(problems, config)
    state = {
        key: {k: v.clone() for k, v in value.items()} if key in ("learner", "trainer") else value
        for key, value in first.state().items()
    }
    second.load_state(state, "memory")
    assert 0 < len(episodes) < len(expected)
    assert episodes + train(second) == expected
    assert bits(second) == bits(whole)
    assert torch.equal(second.weights, whole.weights)
    assert second.solutions() == whole.solutions()


def mean(episodes: Sequence[Episode], field: str) -> float:
    return float(np.mean([getattr(episode, field) for episode in episodes]))


@pytest.mark.parametrize("agents", ["single", "multi"])
def test_it_learns_a_tiny_problem(agents: Any) -> None:
    # 4x4x2 and 3 nets, as the paper's studies of parameters, with room for every net: A*'s
    # wirelength is the least there is.
    problem = tiny(5, capacity=5, reduced_edges=0)
    optimum = evaluate(problem, sequential_astar(problem)).wirelength
    config = Config(
        env=EnvOptions(agents=agents, max_steps=30),
        dqn=DQNOptions(gamma=0.95, burn_in_size=1000, learning_rate=1e-3, target_period=200),
        train=TrainOptions(episodes=250),
    )
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
    config = Config(
        env=EnvOptions(agents=agents, max_steps=50),
        dqn=DQNOptions(gamma=0.95, target_period=1000),
        train=TrainOptions(episodes=300),
    )
    trainer = Trainer({"p": problem}, config)
    episodes = train(trainer)
    figures = evaluate(problem, trainer.solutions()["p"])
    assert figures.connected
    assert figures.overflow == 0
    assert figures.wirelength <= 1.03 * evaluate(problem, sequential_astar(problem)).wirelength
    assert mean(episodes[-50:], "joined") > 19
    assert mean(episodes[-50:], "reward") > mean(episodes[:50], "reward") + 500
