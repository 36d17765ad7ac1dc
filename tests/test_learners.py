"""The learners: networks, memories, exploration, DQN and PPO.

Oracles: torch's autograd with its own Adam for gradient steps; plain loops over transitions for
returns and advantages.
"""

import contextlib
import copy
import itertools
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor, nn

from marouting import InputError, PaperObservation, PaperReward, Problem, generate
from marouting.batch.engine import Engine
from marouting.batch.step import StepBuffers
from marouting.config import component
from marouting.game import NOBODY, Ending
from marouting.player import Player
from marouting.problem.grid import MOVES
from marouting.rules import TurnOrder
from marouting.vector import BatchEnv
from policies.learned.algorithms.dqn import DQN, DQNOptions
from policies.learned.algorithms.fused_dqn import FusedDQN, obstacle
from policies.learned.algorithms.ppo import PPO, PPOOptions, losses
from policies.learned.compiled.products import product, product_row
from policies.learned.counter_rng import keys, uniform, uniforms
from policies.learned.exploration import Exploration
from policies.learned.learner import Learner, Setup, new_network
from policies.learned.memory.pre_step import PreStep
from policies.learned.memory.replay import Batch, Replay
from policies.learned.memory.rollout import Rollout, shuffled
from policies.learned.networks.adam import Adam
from policies.learned.networks.conv import Conv
from policies.learned.networks.graph import WARM_UP, CudaGraph
from policies.learned.networks.mlp import MLP
from policies.learned.networks.stack import Stack

FEATURES = 12
CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)  # more of them cost more than they save on networks this small


# --- games to learn from --------------------------------------------------------------------------


def tiny(seed: int = 0, nets: int = 3, **options: Any) -> Problem:
    """One of the paper's small problems for its studies of parameters: 4x4x2."""
    return generate(1, **{"grid": (4, 4, 2), "nets": nets, "capacity": 2, "seed": seed, **options})[
        0
    ]


class Telling(PaperObservation):
    """The paper's observation, not known as such: the player asks for it."""


def player_of(
    problems: Sequence[Problem],
    multi: bool,
    observation: Any = None,
    turn_order: str | None = None,
    max_steps: int = 12,
) -> Player:
    """A player at the start of its games."""
    order = turn_order or ("round_robin" if multi else "sequential")
    engine = Engine(problems, turn_order=order, max_steps=max_steps)
    player = Player(engine, observation or PaperObservation(), PaperReward(), everyone=multi)
    player.reset()
    return player


def setup_of(player: Player, names: Sequence[str] = ("a", "b", "c"), **changes: Any) -> Setup:
    """What a learner of a player's games starts with."""
    b, (columns, rows, layers) = player.buffers, player.engine.grid.shape
    each = len(b.over) // len(names)
    given: dict[str, Any] = {
        "names": tuple(names),
        "games": len(b.over),
        "rows": b.acted.shape[1],
        "obs_shape": b.obs.shape[2:],
        "state_shape": (columns, rows, 5 * layers),
        "player": player,
        "seed": 3,
        "device": CPU,
        "threads": 1,
        "episodes": 10,
        "game_names": tuple(f"{name}#{i}" for name in names for i in range(each)),
    }
    return Setup(**{**given, **changes})


def state_dicts(stack: Stack) -> list[dict[str, torch.Tensor]]:
    """The networks as ordinary modules have them."""
    rows = (stack.row(n) for n in range(len(stack.flat)))
    return [
        {name: t.detach().clone() for name, t in (row.weights | row.buffers).items()}
        for row in rows
    ]


SMALL: dict[str, Any] = {
    "network": component("network", {"kind": "mlp", "hidden": [8]}),
    "gamma": 0.9,
    "learning_rate": 1e-2,
    "batch_size": 8,
    "buffer_size": 1000,
    "burn_in_size": 1,
    "target_period": 2,
    "epsilon": 0.3,
    "epsilon_final": None,
}
SMALL_PPO: dict[str, Any] = {
    "network": component("network", {"kind": "mlp", "hidden": [8]}),
    "rollout": 64,
    "minibatch": 16,
    "num_envs": 2,
}


def options_of(kind: str, **changes: Any) -> Any:
    if kind == "ppo":
        return PPOOptions(**{**SMALL_PPO, **changes})
    return DQNOptions(**{**SMALL, **changes})


def play(learner: Learner, player: Player, steps: int) -> list[Any]:
    """Plays on, restarting games that are over; returns all that was seen and done."""
    seen = []
    for step in range(steps):
        learner.set_episodes(np.full(len(player.buffers.over), step // 10))
        learner.play(player, 3)
        over = player.buffers.over.copy()
        seen.append([player.buffers.actions.copy(), player.buffers.obs.copy()])
        if over.any():
            player.reset(over)
    return seen


def same(a: Any, b: Any) -> bool:
    return len(a) == len(b) and all(
        np.array_equal(x, y)
        for one, other in zip(a, b, strict=True)
        for x, y in zip(one, other, strict=True)
    )


# --- networks -------------------------------------------------------------------------------------


def reference_weights(sizes: Sequence[int], seed: int, bound: float | None) -> list[Tensor]:
    """The weights of the first release, layer by layer; biases are 0 where a bound is given."""
    generator = torch.Generator().manual_seed(seed)
    found = []
    for inputs, outputs in itertools.pairwise(sizes):
        b = bound or inputs**-0.5
        found.append(torch.empty(inputs, outputs).uniform_(-b, b, generator=generator))
        bias = torch.empty(outputs).uniform_(-b, b, generator=generator)
        found.append(torch.zeros(outputs) if bound else bias)
    return found


@pytest.mark.parametrize(("init", "bound"), [("torch", None), ("uniform", 0.5)])
def test_a_seed_gives_the_weights_that_it_always_gave(init: Any, bound: float | None) -> None:
    seeds = [1, 2, 2**62 + 1]
    state = torch.get_rng_state()
    stack = Stack(lambda: MLP((FEATURES,), MOVES, hidden=(32, 64, 32), init=init), seeds, CPU)
    assert torch.equal(torch.get_rng_state(), state)
    for row, seed in enumerate(seeds):
        expected = reference_weights((FEATURES, 32, 64, 32, MOVES), seed, bound)
        assert torch.equal(stack.flat[row], torch.cat([w.reshape(-1) for w in expected]))


class Scaled(nn.Module):
    """A module of anybody's, with a buffer and without knowing of stacks."""

    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__()
        self.register_buffer("scale", torch.full(obs_shape, 0.5))
        self.inner = nn.Sequential(nn.Linear(*obs_shape, 9), nn.Tanh(), nn.Linear(9, outputs))
        self.temperature = nn.Parameter(torch.rand(()))

    def forward(self, obs: Tensor) -> Tensor:
        return self.inner(obs * self.scale) * self.temperature


NETWORKS: dict[str, tuple[tuple[int, ...], Any]] = {
    "mlp": ((FEATURES,), lambda: MLP((FEATURES,), MOVES, hidden=(8, 5))),
    "linear": ((FEATURES,), lambda: MLP((FEATURES,), MOVES, hidden=())),
    "dueling": ((3, 4), lambda: MLP((3, 4), MOVES, hidden=(8,), dueling=True, activation="tanh")),
    "conv": ((2, 4, 3), lambda: Conv((2, 4, 3), MOVES, channels=(3, 4), hidden=(7,))),
    "own": ((FEATURES,), lambda: Scaled((FEATURES,), MOVES)),
}


@pytest.mark.parametrize("kind", NETWORKS)
@pytest.mark.parametrize("count", [1, 3])
def test_a_stack_is_its_networks_one_by_one(kind: str, count: int) -> None:
    shape, make = NETWORKS[kind]
    stack = Stack(make, range(count), CPU)
    modules = [make() for _ in range(count)]
    for module, state in zip(modules, state_dicts(stack), strict=True):
        module.load_state_dict(state)
    obs, slope = torch.randn(count, 5, *shape), torch.randn(count, 5, MOVES)
    outputs = stack.view(obs)
    found = torch.empty_like(stack.flat)
    stack.view.gradient(outputs, found, slope)
    for row, module in enumerate(modules):
        expected = module(obs[row])
        torch.testing.assert_close(outputs[row], expected, atol=1e-6, rtol=1e-5)
        torch.testing.assert_close(stack.row(row)(obs[row : row + 1])[0], expected)
        module.zero_grad()
        (expected * slope[row]).sum().backward()
        grads = torch.cat([p.grad.reshape(-1) for p in module.parameters()])
        torch.testing.assert_close(found[row], grads, atol=1e-5, rtol=1e-4)


class RandomBuffer(Scaled):
    """A projection that is not saved."""

    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__(obs_shape, outputs)
        self.register_buffer("drawn", torch.rand(obs_shape))


class Dropping(Scaled):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__(obs_shape, outputs)
        self.inner.append(nn.Dropout(0.5))


class Normed(Scaled):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__(obs_shape, outputs)
        self.inner.append(nn.BatchNorm1d(outputs))


class Wide(Scaled):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__(obs_shape, outputs + 1)


class Pairs(Scaled):
    def forward(self, obs: torch.Tensor) -> Any:
        return super().forward(obs), obs


class Narrow(Scaled):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__((obs_shape[0] + 1,), outputs)


class Frozen(Scaled):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__(obs_shape, outputs)
        self.inner[0].requires_grad_(False)


class Tied(Scaled):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        super().__init__(obs_shape, outputs)
        self.again = self.inner[0]


class Fixed(nn.Module):
    def __init__(self, obs_shape: tuple[int, ...], outputs: int) -> None:
        del obs_shape
        super().__init__()
        self.outputs = outputs

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        return obs.new_zeros(len(obs), self.outputs)


@pytest.mark.parametrize(
    ("network", "expected"),
    [
        (Frozen, r"expected parameters that are all trained, found inner\.0\.weight, which is not"),
        (Tied, r"expected no parameters that layers share, found again\.weight"),
        (Fixed, "expected parameters to train, found none"),
        (Wide, rf"expected one from \(B, {FEATURES}\) to \(B, {MOVES}\), found \(2, 7\) for B = 2"),
        (Pairs, rf"expected one from \(B, {FEATURES}\) to \(B, {MOVES}\), found None for B = 2"),
        (Narrow, rf"expected one from \(B, {FEATURES}\) to \(B, {MOVES}\): "),
        (RandomBuffer, "expected buffers without random numbers, found drawn"),
        (Dropping, "expected layers that work alike in training and in play, found Dropout"),
        (Normed, "expected layers that work alike in training and in play, found BatchNorm1d"),
    ],
)
def test_networks_that_cannot_be_saved_or_played_as_trained_are_refused(
    network: type[nn.Module], expected: str
) -> None:
    for made, error in ((network, expected), (Scaled, "")):
        options = SimpleNamespace(network=SimpleNamespace(make=made))
        with pytest.raises(InputError, match=error) if error else contextlib.nullcontext():
            assert not new_network(options, (FEATURES,), MOVES).training


def test_dueling_adds_advantages_over_their_mean() -> None:
    plain = MLP((FEATURES,), 1 + MOVES, hidden=(8,))
    dueling = MLP((FEATURES,), MOVES, hidden=(8,), dueling=True)
    dueling.load_state_dict(plain.state_dict())
    obs = torch.randn(4, FEATURES)
    both = plain(obs)
    expected = both[:, :1] + both[:, 1:] - both[:, 1:].mean(dim=1, keepdim=True)
    torch.testing.assert_close(dueling(obs), expected)


def test_a_convolution_wants_a_picture() -> None:
    with pytest.raises(InputError, match=r"conv: expected observations \(channels, height, width"):
        Conv((12,), MOVES)


def test_adam_is_that_of_torch_for_those_that_are_due() -> None:
    torch.manual_seed(0)
    weights = torch.randn(3, 40)
    adam = Adam(weights)
    rows = [nn.Parameter(row.double()) for row in weights]
    others = [torch.optim.Adam([row], lr=1e-2) for row in rows]
    for step in range(60):
        gradient = torch.randn(3, 40) * (torch.arange(40) > 3)  # some of them never
        due = torch.tensor([1, step % 2, 0])
        adam.step(weights, gradient, due[:, None].float(), 1e-2)
        for row, other, g, now in zip(rows, others, gradient, due, strict=True):
            if now:
                row.grad = g.double()
                other.step()
    torch.testing.assert_close(weights.double(), torch.stack([*rows]), atol=1e-5, rtol=1e-4)
    assert adam.count.tolist() == [60, 30, 0]


def test_work_is_recorded_after_the_first_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    class Graph:
        def replay(self) -> None:
            calls.append("replayed")

    monkeypatch.setattr(torch.cuda, "CUDAGraph", Graph)
    monkeypatch.setattr(torch.cuda, "graph", lambda _: contextlib.nullcontext())
    step = CudaGraph(lambda: calls.append("called"))
    for _ in range(WARM_UP + 2):
        step()
    assert calls == ["called"] * (WARM_UP + 1) + ["replayed"] * 2  # once more, to be recorded


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
    product(held, *strides, b.ravel(), 0, start, 0, out, rows, depth, columns, np.float32(floor))
    expected = np.maximum(a.astype(float) @ b.astype(float) + start, floor)
    np.testing.assert_allclose(out[:-1].reshape(rows, columns), expected, atol=1e-4)
    assert out[-1] == 7


@given(st.integers(1, 70), st.sampled_from([1, 6, 16, 64, 100, 160]), st.integers(0, 9999))
def test_a_row_with_zeros_comes_out_the_same(depth: int, columns: int, seed: int) -> None:
    """To the last bit, whatever is passed over, and as in a tile of many rows."""
    rng = np.random.default_rng(seed)
    a = (rng.normal(size=depth) * (rng.random(depth) < rng.random())).astype(np.float32)
    b = rng.normal(size=(depth + 1) * columns + 1).astype(np.float32)
    start, floor = 1 + depth * columns, np.float32(rng.choice([0, -np.inf]))
    sparse, tiled = np.full(columns, 7, np.float32), np.full(8 * columns, 7, np.float32)
    product_row(a, 0, 1, depth, b, 1, b, start, sparse, floor)
    product(np.tile(a, 8), depth, 1, b, 1, b, start, tiled, 8, depth, columns, floor)
    np.testing.assert_array_equal(tiled.reshape(8, columns), np.tile(sparse, (8, 1)))


# --- memory ---------------------------------------------------------------------------------------


def step_of(
    games: int, rows: int, rng: np.random.Generator, numbers: NDArray[np.float32] | None = None
) -> tuple[PreStep, StepBuffers]:
    """A step of random transitions; with ``numbers`` (M, K) each carries its number everywhere."""
    after = StepBuffers.of(games, rows, (FEATURES,))
    shape = (games, rows)
    after.agents[:] = np.arange(rows)
    after.acted[:] = True
    after.actions[:] = rng.integers(MOVES, size=shape)
    after.ending[:] = rng.choice([0, 0, 0, 1, 2], size=shape)
    after.reward[:] = np.where(after.ending == Ending.JOINED, 10, -1)
    for mask in (after.mask, after.final_mask):
        mask[:] = rng.integers(2, size=mask.shape)
        mask[..., 0] |= ~mask.any(axis=2)
    for obs in (after.obs, after.final_obs):
        obs[:] = rng.normal(size=obs.shape)
    before = PreStep(after.agents.copy(), after.obs.copy(), after.mask.copy())
    before.obs[:] = rng.normal(size=before.obs.shape)
    if numbers is not None:
        before.obs[:] = numbers[..., None]
        after.obs[:] = after.final_obs[:] = numbers[..., None] + 1
        after.reward[:] = numbers
        after.actions[:] = numbers % MOVES
        after.ending[:] = numbers.astype(np.int64) % 2 == 1
    return before, after


def replay_of(names: str, capacity: int, masks: bool = False, **more: Any) -> Replay:
    return Replay(keys(1, [*names], "s"), capacity, (FEATURES,), masks, CPU, **more)


def everything(replay: Replay) -> Batch:
    """All transitions in the stores, (L, capacity, …)."""
    networks, capacity, _ = replay.store.shape
    return replay._batch(torch.arange(capacity).expand(networks, capacity))


def remember(replay: Replay, numbers: NDArray[np.float32], acted: NDArray[np.bool_]) -> None:
    """Stores transitions that carry a number in every field."""
    before, after = step_of(*numbers.shape, np.random.default_rng(0), numbers)
    after.acted[:] = acted
    replay.add(before, after)


def test_memory_is_a_ring_that_keeps_the_newest() -> None:
    replay = replay_of("ab", 10)
    stored: tuple[list[float], list[float]] = ([], [])
    rng = np.random.default_rng(0)
    for step in range(30):
        numbers = np.array([[3 * step + k for k in range(3)] for _ in range(2)], np.float32)
        acted = rng.random((2, 3)) < np.array([[0.3], [0.8]])
        remember(replay, numbers, acted)
        for m in range(2):
            stored[m].extend(numbers[m][acted[m]].tolist())
            size = min(int(replay.stored[m]), 10)
            held = everything(replay).reward[m, :size, 0]
            assert sorted(held.tolist()) == stored[m][-10:]
    assert replay.stored.tolist() == [len(stored[0]), len(stored[1])]
    assert replay.stored.min() > 10  # both have wrapped
    batch = replay.sample(64, torch.zeros(2, dtype=torch.int64))
    number = batch.reward
    assert torch.equal(batch.obs, number.expand(-1, -1, FEATURES))
    assert torch.equal(batch.next_obs, number.expand(-1, -1, FEATURES) + 1)
    assert torch.equal(batch.move, number.long() % MOVES)
    assert torch.equal(batch.goes_on, 1 - number % 2)
    assert batch.mask is None


@pytest.mark.parametrize("stored", [1, 7, 25, 40])
def test_samples_are_uniform(stored: int) -> None:
    replay = replay_of("a", 25)
    remember(replay, np.arange(stored, dtype=np.float32)[None], np.ones((1, stored), np.bool_))
    there = list(range(max(stored - 25, 0), stored))
    drawn: list[float] = []
    for counter in range(200):
        drawn += replay.sample(50, torch.tensor([counter])).reward.flatten().tolist()
    counts = np.array([drawn.count(number) for number in there])
    assert counts.sum() == len(drawn)
    expected = len(drawn) / len(there)
    chi_square = ((counts - expected) ** 2 / expected).sum()
    freedom = len(there) - 1
    assert chi_square <= freedom + 6 * (2 * freedom) ** 0.5


def test_samples_do_not_depend_on_the_rest_of_the_stack() -> None:
    small, large = replay_of("b", 25), replay_of("abc", 25)
    numbers = np.arange(20, dtype=np.float32)[None]
    remember(small, numbers, np.ones((1, 20), np.bool_))
    acted = np.ones((3, 20), np.bool_)
    acted[0, 7:] = False  # the problem before holds less, the one after holds other numbers
    remember(large, np.concatenate((numbers + 100, numbers, numbers + 200)), acted)
    alone = small.sample(30, torch.tensor([4]))
    beside = large.sample(30, torch.tensor([9, 4, 2]))
    assert torch.equal(alone.reward[0], beside.reward[1])
    assert torch.equal(alone.obs[0], beside.obs[1])
    assert beside.reward[0].min() >= 100
    assert beside.reward[2].min() >= 200


def steps_of_agents(replay: Replay, steps: int) -> list[list[dict[str, Any]]]:
    """Random play of two games of three agents; what each agent lived through, in order."""
    rng = np.random.default_rng(5)
    lived: list[list[dict[str, Any]]] = [[] for _ in range(6)]
    for _ in range(steps):
        before, after = step_of(2, 3, rng)
        after.acted[:] = rng.random((2, 3)) < 0.7
        replay.add(before, after)
        for m, k in itertools.product(range(2), range(3)):
            if after.acted[m, k]:
                ended = after.ending[m, k] != 0
                lived[3 * m + k].append(
                    {
                        "obs": before.obs[m, k],
                        "move": int(after.actions[m, k]),
                        "reward": float(after.reward[m, k]),
                        "ending": int(after.ending[m, k]),
                        "next": (after.final_obs if ended else after.obs)[m, k].copy(),
                        "mask": (after.final_mask if ended else after.mask)[m, k].copy(),
                    }
                )
    return lived


@pytest.mark.parametrize("masks", [False, True])
def test_memory_holds_the_transitions_of_all_agents(masks: bool) -> None:
    replay = replay_of("a", 500, masks)
    expected = []
    for now in itertools.chain(*steps_of_agents(replay, 60)):
        goes_on = now["ending"] != Ending.JOINED
        masks_of = now["mask"] if masks else ()
        row = (*now["obs"], now["move"], now["reward"], goes_on, *now["next"], *masks_of)
        expected.append(row)
    found, size = everything(replay), int(replay.stored[0])
    fields = [found.obs, found.move, found.reward, found.goes_on, found.next_obs]
    fields += [] if found.mask is None else [found.mask]
    rows = torch.cat([f[0, :size].float() for f in fields], dim=1).numpy()
    assert len(rows) == len(expected) > 150
    by_obs = {tuple(row[:FEATURES]): row for row in rows}
    for row in np.array(expected, np.float32):
        np.testing.assert_array_equal(by_obs[tuple(row[:FEATURES])], row)


def test_late_pay_is_added_to_the_transition_that_ended_a_task() -> None:
    rng = np.random.default_rng(7)
    replay = replay_of("a", 6, agents=(2, 2), final_failures=True, late=True)

    def add(acted: Any, paid: Any, ending: Any, over: Any = (False, False)) -> None:
        before, after = step_of(2, 2, rng)
        after.acted[:], after.reward[:] = acted, paid
        after.ending[:], after.over[:] = ending, over
        replay.add(before, after)

    on, off, joined, failed = True, False, Ending.JOINED, Ending.FAILED
    add([[on, off], [off, off]], [[1, 0], [0, 0]], [[0, 0], [0, 0]])
    add([[on, off], [off, off]], [[2, 5], [0, 0]], [[failed, 0], [0, 0]])  # 5 is for nobody
    found = everything(replay)
    assert found.reward[0, :2, 0].tolist() == [1, 2]
    assert found.goes_on[0, :2, 0].tolist() == [1, 0]
    add([[off, on], [on, off]], [[8, 3], [4, 0]], [[0, 0], [joined, 0]])
    add([[off, on], [off, off]], [[0, 1], [16, 0]], [[0, 0], [0, 0]], [False, True])
    add([[off, off], [off, off]], [[0, 0], [32, 0]], [[0, 0], [0, 0]])  # of the next episode
    found = everything(replay)
    assert found.reward[0, :2, 0].tolist() == [1, 10]
    assert found.reward[0, 3, 0] == 20
    add([[off, on], [off, off]], [[0, 1], [0, 0]], [[0, joined], [0, 0]])
    replay.cut()  # nobody's task has ended in games that start anew
    add([[off, off], [off, off]], [[0, 64], [0, 0]], [[0, 0], [0, 0]])
    assert everything(replay).reward[0, 5, 0] == 1
    # What has left the memory is not paid.
    for _ in range(8):
        add([[off, off], [on, off]], [[0, 0], [1, 0]], [[0, 0], [joined, 0]])
    add([[off, off], [off, off]], [[100, 0], [7, 0]], [[0, 0], [0, 0]])
    rewards = sorted(everything(replay).reward[0, :, 0].tolist())
    assert rewards == [1, 1, 1, 1, 1, 8]


def test_advantages_and_returns_of_every_agent() -> None:
    gamma, lam, size = 0.9, 0.8, 40
    rng = np.random.default_rng(1)
    rollout = Rollout(2, size, 2, 3, 3, MOVES, (FEATURES,), (2,), scale=0.5)
    lived: dict[tuple[int, int], list[list[Any]]] = {}
    while (rollout.count < size).any():
        before, after = step_of(4, 3, rng)
        after.acted[:] = rng.random((4, 3)) < 0.6
        chance, value, final = rng.normal(size=(3, 4, 3)).astype(np.float32)
        states = rng.normal(size=(4, 2)).astype(np.float32)
        places = rollout.count.copy()
        rollout.add(before, after, chance, value, final, states)
        for m, k in itertools.product(range(4), range(3)):
            if after.acted[m, k]:
                n, i = m // 2, int(places[m // 2])
                places[n] += 1
                assert np.array_equal(rollout.obs[n, i], before.obs[m, k])
                assert np.array_equal(rollout.mask[n, i], before.mask[m, k])
                assert np.array_equal(rollout.state_[n, i], states[m])
                assert rollout.action[n, i] == after.actions[m, k]
                assert rollout.chance[n, i] == chance[m, k]
                lived.setdefault((m, k), []).append(
                    [n, i, 0.5 * after.reward[m, k], after.ending[m, k], value[m, k], final[m, k]]
                )
        full = rollout.full()
        if len(full) == 1:
            break
    which = rollout.full()
    last = rng.normal(size=(2, 6)).astype(np.float32)
    advantage, returns = rollout.advantages(which, last, gamma, lam)
    assert advantage.shape == (len(which), size)
    compared = 0
    for (m, k), life in lived.items():
        for start, (n, i, *_) in enumerate(life):
            if n not in which or i >= size:
                continue
            total, weight = 0.0, 1.0
            for at in range(start, len(life)):
                _, _, reward, ending, value, final = life[at]
                following = life[at + 1][4] if at + 1 < len(life) else last[n, m % 2 * 3 + k]
                following = {0: following, 1: 0.0, 2: final}[int(ending)]
                total += weight * (reward + gamma * following - value)
                weight *= gamma * lam
                if ending:
                    break
            row = which.tolist().index(n)
            assert advantage[row, i] == pytest.approx(total, abs=1e-4)
            assert returns[row, i] == pytest.approx(total + life[start][4], abs=1e-4)
            compared += 1
    assert compared == size * len(which)
    # What came in beyond the rollout begins the next one.
    beyond = rollout.obs[which[0], size : rollout.count[which[0]]].copy()
    rollout.drop(which)
    assert rollout.count[which[0]] == len(beyond)
    assert np.array_equal(rollout.obs[which[0], : len(beyond)], beyond)


def test_what_agents_are_paid_when_they_are_done_is_paid_for_their_last_move() -> None:
    rng = np.random.default_rng(5)
    rollout = Rollout(1, 4, 2, 2, 2, MOVES, (FEATURES,), late=True)
    value = np.array([[1, 2], [3, 4]], np.float32)
    nothing = np.zeros((2, 2), np.float32)

    def add(acted: Any, paid: Any, done: Any, over: Any) -> PreStep:
        before, after = step_of(2, 2, rng)
        after.acted[:], after.reward[:], after.over[:] = acted, paid, over
        after.active[:] = ~np.array(done, bool)
        after.ending[:] = np.where(after.acted & ~after.active, Ending.JOINED, Ending.NONE)
        rollout.add(before, after, nothing, value, nothing, None)
        return before

    # Agent 0 of game 0 is done, agent 1 goes on; in game 1 both are done at once.
    first = add([[1, 1], [1, 1]], [[1, 2], [3, 4]], [[1, 0], [1, 1]], [0, 1])
    assert rollout.count == [3]
    assert rollout.waits.tolist() == [[True, False, False, False]]
    add([[0, 1], [0, 0]], [[10, 20], [7, 7]], [[1, 0], [1, 1]], [0, 0])
    assert rollout.full().tolist() == [0]
    # Learned from now, the agent's earlier moves lead to a state of the value 1.
    last = np.full((1, 4), 50, np.float32)
    advantage, _ = rollout.advantages(np.array([0]), last, 0.5, 0.0)
    assert advantage.tolist() == [[2 + 0.5 * 2 - 2, 3 - 3, 4 - 4, 20 + 0.5 * 50 - 2]]
    rollout.drop(np.array([0]))
    add([[0, 1], [0, 0]], [[100, 200], [0, 0]], [[1, 1], [1, 1]], [1, 0])
    assert not rollout.waits.any()
    assert rollout.count == [2]
    assert rollout.reward[0, :2].tolist() == [111, 200]
    assert rollout.stream[0, :2].tolist() == [0, 1]
    np.testing.assert_array_equal(rollout.obs[0, 0], first.obs[0, 0])
    assert rollout.advantages(np.array([0]), last, 1.0, 1.0)[0][0, :2].tolist() == [110, 198]


@pytest.mark.parametrize(
    "rip_up", [None, {"rounds": 2, "choose": "conflicts"}, {"rounds": 1, "choose": "agents"}]
)
def test_rollouts_hold_all_that_is_paid_once(rip_up: Any) -> None:
    problems = [tiny(seed, nets=4) for seed in range(3)]
    env = BatchEnv(problems, reward="team", max_steps=7, rip_up=rip_up)
    rng = np.random.default_rng(0)
    b, nothing = env._buffers, np.zeros((3, env.num_agents), np.float32)
    shape = env.single_observation_space.shape
    actions = int(env.single_action_space.n)
    rollout = Rollout(1, 16, 3, env.num_agents, env.num_agents, actions, shape, late=True)
    _, info = env.reset()
    paid = held = 0.0
    made = kept = 0
    for _ in range(100):
        before = PreStep(b.agents.copy(), b.obs.copy(), b.mask.copy())
        mask = info["action_mask"]
        *_, info = env.step((mask * rng.random(mask.shape)).argmax(-1))
        paid, made = paid + float(b.reward.sum()), made + int(b.acted.sum())
        rollout.add(before, b, nothing, nothing, nothing, None)
        while len(full := rollout.full()):
            held, kept = held + float(rollout.reward[0, :16].sum()), kept + 16
            rollout.drop(full)
    waiting = rollout.reward[0, rollout._waiting :][rollout.waits[0]]
    left = rollout.reward[0, : rollout.count[0]]
    assert held + float(left.sum() + waiting.sum()) == pytest.approx(paid)
    assert kept + len(left) + len(waiting) == made


def test_rollouts_are_shuffled_by_key_and_counter() -> None:
    own = keys(0, ["a", "b"], "x")
    orders = [shuffled(100, own[0], np.int64(0)), shuffled(100, own[0], np.int64(1)),
              shuffled(100, own[1], np.int64(0))]  # fmt: skip
    assert all(sorted(order.tolist()) == list(range(100)) for order in orders)
    assert len({tuple(order.tolist()) for order in orders}) == 3
    assert np.array_equal(orders[0], shuffled(100, own[0], np.int64(0)))
    firsts = np.bincount([shuffled(4, own[0], np.int64(c))[0] for c in range(2000)])
    assert abs(firsts - 500).max() < 5 * (2000 * 0.25 * 0.75) ** 0.5


# --- exploration ----------------------------------------------------------------------------------


def asking(count: int, masking: bool) -> tuple[StepBuffers, NDArray[np.float32]]:
    """One game in which many rows ask for a move with the same numbers; the last row does not."""
    now = StepBuffers.of(1, count + 1, (FEATURES,))
    now.active[:, :-1] = True
    now.mask[:] = np.array([1, 1, 0, 1, 0, 1]) if masking else 1
    return now, np.tile(np.array([1, 0.5, 4, 2, 3, -1], np.float32), (1, count + 1, 1))


@pytest.mark.parametrize("masking", [False, True])
def test_moves_are_epsilon_greedy(masking: bool) -> None:
    count = 20_000
    now, values = asking(count, masking)
    explore = Exploration(keys(0, ["a"], "explore").reshape(1, 1))
    explore.epsilon[:] = 0.4
    explore.epsilon_greedy(now, values, masking)
    assert now.actions[0, -1] == -1
    made = np.bincount(now.actions[0, :-1], minlength=MOVES) / count
    allowed = now.mask[0, 0] / now.mask[0, 0].sum()
    expected = 0.4 * allowed + 0.6 * (np.arange(MOVES) == (3 if masking else 2))
    assert abs(made - expected).max() < 5 * (0.25 / count) ** 0.5
    assert (made[expected == 0] == 0).all()
    assert explore.counters.tolist() == [[1]]
    again = Exploration(keys(0, ["a"], "explore").reshape(1, 1))
    again.epsilon[:] = 0
    again.epsilon_greedy(now, values, masking)
    assert (now.actions[0, :-1] == (3 if masking else 2)).all()


@pytest.mark.parametrize("masking", [False, True])
def test_moves_are_drawn_by_their_scores(masking: bool) -> None:
    count = 20_000
    now, scores = asking(count, masking)
    chance = np.zeros((1, count + 1), np.float32)
    explore = Exploration(keys(0, ["a"], "explore").reshape(1, 1))
    explore.sample(now, now.active, scores, masking, chance)
    weights = np.exp(scores[0, 0]) * now.mask[0, 0]
    expected = weights / weights.sum()
    made = np.bincount(now.actions[0, :-1], minlength=MOVES) / count
    assert abs(made - expected).max() < 5 * (0.25 / count) ** 0.5
    assert (made[expected == 0] == 0).all()
    logarithms = np.log(expected[now.actions[0, :-1]])
    np.testing.assert_allclose(chance[0, :-1], logarithms, rtol=1e-4, atol=1e-5)
    assert now.actions[0, -1] == -1


# --- DQN ------------------------------------------------------------------------------------------


def learner_of(kind: type[DQN], steps: int = 60, seed: int = 0, **options: Any) -> DQN:
    """A DQN of three networks that has been shown random transitions."""
    player = player_of([tiny(nets=3)] * 3, multi=True)
    learner = kind(setup_of(player), options_of("dqn", **options))
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        learner.memory.add(*step_of(3, 3, rng))
    return learner


DQNS = [DQN, FusedDQN]


def module_of(learner: DQN, row: int, weights: Tensor) -> nn.Module:
    """An ordinary module in float64 with a row of weights (P,)."""
    module = learner.network(learner.options, learner.setup.obs_shape).double()
    at = 0
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.copy_(weights[at : at + parameter.numel()].view_as(parameter))
            at += parameter.numel()
    assert at == len(weights), row
    return module


def flat(module: nn.Module) -> Tensor:
    return torch.cat([p.detach().reshape(-1) for p in module.parameters()])


CASES: list[dict[str, Any]] = [
    {"hidden": [32, 64, 32], "batch_size": 32, "target_period": 0},
    {"hidden": [32, 64, 32], "batch_size": 32, "target_period": 7, "masking": True},
    {"hidden": [5], "batch_size": 1, "target_period": 0, "masking": True},
    {"hidden": [], "batch_size": 16, "target_period": 3},
    {"hidden": [17, 3], "batch_size": 64, "target_period": 1},
]
SWITCHES: list[dict[str, Any]] = [
    {"double": True, "target_period": 7},
    {"double": True, "target_period": 7, "masking": True},
    {"dueling": True},
    {"double": True, "dueling": True, "target_period": 4},
]


@pytest.mark.parametrize(
    ("kind", "case"), [*itertools.product(DQNS, CASES), *((DQN, case) for case in SWITCHES)]
)
def test_gradient_step_is_that_of_autograd_and_adam(kind: type[DQN], case: dict[str, Any]) -> None:
    case = dict(case)
    network = {
        "kind": "mlp",
        "hidden": case.pop("hidden", [8]),
        "dueling": case.pop("dueling", 0) == 1,
    }
    gamma, rate, problems = 0.9, 1e-3, 3
    learner = learner_of(
        kind, 100, network=component("network", network), gamma=gamma, learning_rate=rate, **case
    )
    o = learner.options
    nets = [module_of(learner, row, weights) for row, weights in enumerate(learner.networks.flat)]
    targets = [copy.deepcopy(net) if o.target_period else net for net in nets]
    optimizers = [torch.optim.Adam(net.parameters(), lr=rate) for net in nets]
    assert len({tuple(flat(net)[:4].tolist()) for net in nets}) == problems
    for step in range(1, 51):
        batch = learner.memory.sample(o.batch_size, torch.from_numpy(learner.updates))
        before = learner.loss.numpy().copy()
        learner.learn(np.ones(problems, np.int64))
        loss = learner.loss.numpy() - before
        for m, (net, target, optimizer) in enumerate(zip(nets, targets, optimizers, strict=True)):
            with torch.no_grad():
                following = target(batch.next_obs[m].double())
                chooser = net(batch.next_obs[m].double()) if o.double else following.clone()
                if batch.mask is not None:
                    chooser[batch.mask[m] == 0] = -1e9
                best = following[torch.arange(o.batch_size), chooser.argmax(dim=1)]
                wanted = batch.reward[m, :, 0] + gamma * batch.goes_on[m, :, 0] * best
            chosen = net(batch.obs[m].double())[torch.arange(o.batch_size), batch.move[m, :, 0]]
            expected = ((chosen - wanted) ** 2).mean()
            optimizer.zero_grad()
            expected.backward()
            optimizer.step()
            if o.target_period and step % o.target_period == 0:
                target.load_state_dict(net.state_dict())
            assert loss[m] == pytest.approx(expected.item(), rel=1e-3)
            if step in (1, 5, 50):
                moved = (flat(net) - learner.networks.flat[m].double()).abs().max()
                assert moved < 1e-5 + 2e-4 * rate * step, (step, moved)
        assert learner.updates.tolist() == [step] * problems
    if o.target_period:
        held = torch.stack([flat(target) for target in targets])
        torch.testing.assert_close(learner.target.double(), held, atol=1e-4, rtol=1e-3)


def tensors(learner: Learner) -> list[NDArray[Any]]:
    return [tensor.numpy().copy() for tensor in learner.state().values()]


@pytest.mark.parametrize("kind", DQNS)
def test_steps_due_together_are_steps_one_by_one(kind: type[DQN]) -> None:
    together, apart = learner_of(kind), learner_of(kind)
    together.learn(np.array([3, 0, 1]))
    for due in ([1, 0, 1], [1, 0, 0], [1, 0, 0]):
        apart.learn(np.array(due))
    assert together.updates.tolist() == [3, 0, 1]
    assert together.loss[1] == 0
    for a, b in zip(tensors(together), tensors(apart), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("kind", DQNS)
def test_networks_that_are_not_due_stay_as_they_are(kind: type[DQN]) -> None:
    learner = learner_of(kind)
    learner.learn(np.full(3, 3))
    before = {name: tensor.clone() for name, tensor in learner.state().items()}
    learner.learn(np.array([5, 0, 5]))
    after = learner.state()
    assert learner.updates.tolist() == [8, 3, 8]
    for name in ("networks.flat", "target", "adam.mean", "adam.square", "adam.count", "loss"):
        assert torch.equal(before[name][1], after[name][1])
        assert not torch.equal(before[name][0], after[name][0])
        assert not torch.equal(before[name][2], after[name][2])


@pytest.mark.parametrize("kind", DQNS)
def test_only_a_joined_task_ends_the_sum_of_rewards(kind: type[DQN]) -> None:
    # One transition, over and over: what the network wants for it is r, or r + γ max Q'.
    for ending in (Ending.NONE, Ending.JOINED, Ending.FAILED):
        learner = kind(
            setup_of(player_of([tiny()], multi=False), ["a"]),
            options_of("dqn", target_period=10**6, buffer_size=4),
        )
        before, after = step_of(1, 1, np.random.default_rng(0))
        before.obs[:], after.obs[:] = 0.5, 1.0
        after.final_obs[:] = 1.0 if ending == Ending.FAILED else 7.0
        if ending == Ending.FAILED:
            after.obs[:] = 7.0  # the next task
        after.actions[:], after.reward[:], after.ending[:] = 2, 3, ending
        learner.memory.add(before, after)
        view = learner.networks.row(0)
        bootstrapped = view(torch.ones(1, 1, FEATURES)).max().item()
        learner.learn(np.array([400]))
        value = view(torch.full((1, 1, FEATURES), 0.5))[0, 0, 2].item()
        expected = 3 + (0 if ending == Ending.JOINED else 0.9 * bootstrapped)
        assert value == pytest.approx(expected, abs=0.02)
        assert abs(0.9 * bootstrapped) > 0.02


def test_epsilon_falls_from_an_episode_to_the_last() -> None:
    player = player_of([tiny()], multi=False)
    setup = setup_of(player, ["a"], episodes=5001)
    constant = DQN(setup, options_of("dqn", epsilon=0.07, epsilon_final=None))
    assert {constant.exploration(e) for e in range(5001)} == {0.07}
    # The paper's Table 2, row 7: 0.05, falling to 0.01 from episode 2000 to the last.
    falling = DQN(
        setup, options_of("dqn", epsilon=0.05, epsilon_final=0.01, epsilon_decay_from=2000)
    )
    values = [falling.exploration(e) for e in range(5001)]
    assert set(values[:2001]) == {0.05}
    assert values[3500] == pytest.approx(0.03)
    assert values[-1] == pytest.approx(0.01)
    assert np.diff(values[2000:]) == pytest.approx(-0.04 / 3000)
    falling.set_episodes(np.array([3500]))
    assert falling.explore.epsilon[0, 0] == pytest.approx(0.03)


# --- DQN in play ----------------------------------------------------------------------------------

GAMES: dict[str, dict[str, Any]] = {
    "single": {"multi": False},
    "single, round robin": {"multi": False, "turn_order": "round_robin"},
    "multi": {"multi": True},
    "multi, sequential": {"multi": True, "turn_order": "sequential"},
}


@pytest.mark.parametrize("game", GAMES)
@pytest.mark.parametrize("masking", [False, True])
@pytest.mark.parametrize("shared", [False, True])
def test_the_fused_dqn_does_what_torch_does(game: str, masking: bool, shared: bool) -> None:
    problems = [tiny(), tiny(1, nets=1), tiny(2, nets=5)]
    states = []
    for kind in DQNS:
        player = player_of(problems, **GAMES[game])
        names = ["all"] if shared else ["a", "b", "c"]
        setup = setup_of(player, names, game_names=("a", "b", "c"))
        learner = kind(setup, options_of("dqn", masking=masking, steps_per_update=2))
        seen = []
        for _ in range(40):
            learner.set_episodes(np.zeros(3, np.int64))
            learner.play(player, 1)  # one network after the other: both stop alike
            seen.append((player.buffers.actions.copy(), player.buffers.obs.copy()))
            player.reset(player.buffers.over.copy())
        states.append((seen, learner.state()))
    (mine, a), (theirs, b) = states
    for (x, y), (v, w) in zip(mine, theirs, strict=True):
        assert np.array_equal(x, v)
        assert np.array_equal(y, w)
    assert a.keys() == b.keys()
    assert a["memory.stored"].min() > 20
    assert torch.equal(a["memory.store"], b["memory.store"])
    assert torch.equal(a["updates"], b["updates"])
    torch.testing.assert_close(a["networks.flat"], b["networks.flat"], atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("kind", DQNS)
def test_memory_holds_what_the_game_shows(kind: type[DQN]) -> None:
    """Transitions of a turn that passes on: what the mover saw, not the one after it."""
    problem = tiny(nets=4)
    player = player_of([problem], multi=False, turn_order="round_robin", max_steps=5)
    learner = kind(setup_of(player, ["a"]), options_of("dqn", masking=True, steps_per_update=10**6))
    engine = Engine([problem], turn_order="round_robin", max_steps=5)
    shown, obs = PaperObservation(), np.zeros((1, FEATURES), np.float32)
    none = np.zeros(1, np.int32)
    learner.set_episodes(np.zeros(1, np.int64))
    for row in range(12):
        agent = engine.games["agent"].copy()
        shown.write(engine, none, agent, obs)
        learner.play(player, 1)
        held = everything(learner.memory)
        assert np.array_equal(held.obs[0, row].numpy(), obs[0])
        engine.move(player.buffers.actions[:, 0].astype(np.int64))
        shown.write(engine, none, agent, obs)
        assert np.array_equal(held.next_obs[0, row].numpy(), obs[0])
        assert np.array_equal(held.mask[0, row].numpy(), engine.masks(none, agent)[0])
        engine.settle(everyone=False)


@pytest.mark.slow  # the time is the compiler's
def test_threads_change_nothing() -> None:
    states = []
    for threads in (1, 2):
        player = player_of([tiny(seed) for seed in range(3)], multi=True)
        learner = FusedDQN(setup_of(player, threads=threads), options_of("dqn"))
        seen = play(learner, player, 20)
        states.append((seen, tensors(learner)))
    assert same(states[0][0], states[1][0])
    assert all(np.array_equal(a, b) for a, b in zip(states[0][1], states[1][1], strict=True))


def test_the_fused_dqn_is_chosen_where_it_applies() -> None:
    player = player_of([tiny()], multi=False)
    setup = setup_of(player, ["a"])

    def path(setup: Setup = setup, **options: Any) -> str:
        return FusedDQN.start(setup, options_of("dqn", **options)).backend

    own = setup_of(player_of([tiny()], multi=False, observation=Telling()), ["a"])
    dueling = component("network", {"kind": "mlp", "dueling": True})
    assert path() == path(fused=True) == "fused"
    assert path(fused=False).startswith("torch")
    for there, options in [
        (own, {}),
        (setup, {"double": True}),
        (setup, {"final_failures": True}),
        (setup, {"network": dueling}),
        (setup, {"network": component("network", {"kind": "mlp", "activation": "tanh"})}),
        (setup, {"network": component("network", "tests.test_learners:Scaled")}),
    ]:
        assert obstacle(there, options_of("dqn", **options)) is not None
        assert path(there, **options).startswith("torch")
        with pytest.raises(InputError, match="fused: expected false: the fused DQN does not do "):
            path(there, fused=True, **options)


# --- all learners ---------------------------------------------------------------------------------

LEARNERS: dict[str, tuple[str, dict[str, Any]]] = {
    "dqn, fused": ("dqn", {}),
    "dqn, torch": ("dqn", {"fused": False, "steps_per_update": 3}),
    "dqn, all switches": (
        "dqn",
        {"double": True, "masking": True, "steps_per_update": 3},
    ),
    "ppo": ("ppo", {}),
    "ppo, central": ("ppo", {"critic": "central", "masking": False}),
}


def started(
    name: str,
    multi: bool,
    player: Player | None = None,
    names: Sequence[str] = ("a", "b"),
    **changes: Any,
) -> tuple[Learner, Player]:
    """A learner of one network for each name, with two games each."""
    kind, options = LEARNERS[name]
    a, b = tiny(nets=4), tiny(1, nets=2)
    player = player or player_of([a, a, b, b], multi)
    setup = setup_of(player, list(names), **changes)
    start: Any = PPO.start if kind == "ppo" else FusedDQN.start
    return start(setup, options_of(kind, **options)), player


@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.parametrize("multi", [False, True])
def test_a_learner_goes_on_from_its_state(name: str, multi: bool) -> None:
    first, player = started(name, multi)
    play(first, player, 25)
    second, other = started(name, multi, seed=4)
    play(second, other, 3)
    second.load_state({key: tensor.clone() for key, tensor in first.state().items()})
    other.restore(player.save())
    assert same(play(first, player, 25), play(second, other, 25))
    assert first.updates.min() > 0
    for a, b in zip(tensors(first), tensors(second), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("name", LEARNERS)
def test_a_network_plays_and_learns_alone_as_beside_others(name: str) -> None:
    a, b = tiny(nets=2), tiny(1, nets=2)
    both, players = [], [player_of(problems, True) for problems in ([a, a, b, b], [b, b])]
    for player, names in zip(players, (["a", "b"], ["b"]), strict=True):
        both.append(started(name, True, player=player, names=names)[0])
    for step in range(40):
        for learner, player in zip(both, players, strict=True):
            learner.set_episodes(np.full(len(player.buffers.over), step // 10))
            learner.play(player, 1)
        beside, alone = (player.buffers for player in players)
        assert np.array_equal(beside.actions[2:], alone.actions)
        for player in players:
            player.reset(player.buffers.over.copy())
    assert both[1].updates.min() > 0
    for (key, one), other in zip(both[0].state().items(), both[1].state().values(), strict=True):
        torch.testing.assert_close(one[1:], other, atol=1e-5, rtol=1e-4, msg=key)


@pytest.mark.parametrize("name", LEARNERS)
def test_the_seed_decides_everything(name: str) -> None:
    runs = [(play(*pair, 20), pair[0]) for pair in (started(name, True), started(name, True))]
    assert same(runs[0][0], runs[1][0])
    other, player = started(name, True, seed=4)
    assert not same(play(other, player, 20), runs[0][0])


@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.parametrize("multi", [False, True])
def test_saved_networks_are_ordinary_modules_that_walk_alike(name: str, multi: bool) -> None:
    learner, player = started(name, multi)
    play(learner, player, 10)
    problems = [tiny(7, nets=5), tiny(8, nets=3)]
    pairs = player_of([*problems, *problems], multi)  # of both networks beside one another
    learner.play_greedily(pairs, np.arange(2))
    for row, weights in enumerate(state_dicts(learner.networks)):
        walked, other = player_of(problems, multi), player_of(problems, multi)
        learner.play_greedily(walked, np.array([row]))
        module = learner.network(learner.options, (FEATURES,))
        module.load_state_dict(weights)
        now = other.buffers
        while now.active.any():
            with torch.no_grad():
                outputs = module(torch.from_numpy(now.obs.reshape(-1, FEATURES)))
            values = outputs.numpy().reshape(now.mask.shape)
            if learner.options.masking:
                values = np.where(now.mask == 0, -np.inf, values)
            now.actions[:] = np.where(now.active, values.argmax(axis=2), -1)
            other.step()
        assert other.engine.games["steps"].min() > 0
        for m in range(2):
            assert walked.engine.solution(m) == other.engine.solution(m)
            assert walked.engine.metrics(m) == other.engine.metrics(m)
            assert walked.engine.metrics(m) == pairs.engine.metrics(2 * row + m)


# --- PPO ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("masking", [False, True])
@pytest.mark.parametrize("critic", ["local", "central"])
def test_the_clipped_loss(masking: bool, critic: Any) -> None:
    torch.manual_seed(0)
    count, o = 50, PPOOptions(clip=0.1, entropy=0.3, masking=masking, critic=critic)
    sees = FEATURES + (4 if critic == "central" else 0)
    actor = Stack(lambda: MLP((FEATURES,), MOVES), [0], CPU).row(0)
    judge = Stack(lambda: MLP((sees,), 1), [1], CPU).row(0)
    part = {
        "obs": torch.randn(count, FEATURES),
        "state_": torch.randn(count, 2, 2),
        "mask": torch.randint(2, (count, MOVES)),
        "action": torch.randint(MOVES, (count,)),
        "chance": torch.full((count,), -1.8),
        "advantage": torch.randn(count),
        "returns": torch.randn(count),
    }
    part["mask"][torch.arange(count), part["action"]] = 1
    policy, value = losses(actor, judge, part, o)
    advantages = part["advantage"].numpy()
    advantages = (advantages - advantages.mean()) / advantages.std(ddof=1)
    scores = actor(part["obs"][None])[0].detach().numpy().astype(float)
    gains, entropies, clipped = [], [], 0
    for i in range(count):
        weights = np.exp(scores[i]) * (part["mask"][i].numpy() if masking else 1)
        chances = weights / weights.sum()
        ratio = chances[part["action"][i]] / np.exp(-1.8)
        gain = ratio * advantages[i]
        limited = min(max(ratio, 0.9), 1.1) * advantages[i]
        clipped += limited < gain
        gains.append(min(gain, limited))
        entropies.append(-sum(c * np.log(c) for c in chances if c > 0))
    assert policy.item() == pytest.approx(-np.mean(gains) - 0.3 * np.mean(entropies), rel=1e-4)
    assert 0 < clipped < count
    seen = part["obs"]
    if critic == "central":
        seen = torch.cat((part["state_"].flatten(1), seen), dim=1)
    errors = judge(seen[None])[0, :, 0] - part["returns"]
    assert value.item() == pytest.approx(0.5 * errors.square().mean().item(), rel=1e-5)


def test_ppo_learns_the_one_game_there_is() -> None:
    problem = tiny(5, capacity=5, reduced_edges=0)
    player = player_of([problem] * 8, multi=True, max_steps=30)
    options = PPOOptions(
        network=component("network", {"kind": "mlp", "hidden": [32]}),
        rollout=1024, minibatch=256, learning_rate=3e-3, anneal=False,
    )  # fmt: skip
    learner = PPO.start(setup_of(player, ["a"], episodes=400), options)
    joined: list[int] = []
    while len(joined) < 400:
        learner.play(player, 200)
        over = player.buffers.over.copy()
        joined += [player.engine.metrics(m).joined for m in np.flatnonzero(over).tolist()]
        player.reset(over)
    assert np.mean(joined[:50]) < 2
    assert np.mean(joined[-50:]) > 2.5


# --- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (
            "dqn",
            {"double": True, "target_period": 0},
            "double: expected false, or target_period above 0",
        ),
        ("dqn", {"n_step": 3}, "n_step: unknown key; version 0.3 removed returns of n steps"),
        (
            "dqn",
            {"prioritised": True},
            "prioritised: unknown key; version 0.3 removed prioritised replay",
        ),
        ("dqn", {"buffer_size": 10, "burn_in_size": 11}, "buffer_size: expected at least"),
        ("dqn", {"gama": 1}, "did you mean gamma?"),
        ("dqn", {"network": {"kind": "mlp", "width": 3}}, "width: unknown key"),
        ("dqn", {"network": {"kind": "lmp"}}, "unknown network 'lmp'; did you mean mlp?"),
        ("ppo", {"rollout": 100, "minibatch": 64}, "rollout: expected a multiple of minibatch"),
        ("ppo", {"critic": "mine"}, "critic: expected one of local, central"),
        ("ppo", {"clip": 0}, "clip: expected a number above 0"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    kind: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as error:
        component("learner", {"kind": kind, **options})
    assert message in str(error.value)


def test_setups_that_do_not_fit_are_refused() -> None:
    multi, single = player_of([tiny(nets=6)], multi=True), player_of([tiny()], multi=False)
    with pytest.raises(InputError, match="buffer_size: expected at least 6, the moves of one step"):
        DQN(setup_of(multi, ["a"]), options_of("dqn", buffer_size=5))
    with pytest.raises(InputError, match="critic: expected local: there is no global state"):
        PPO(setup_of(single, ["a"], state_shape=()), options_of("ppo", critic="central"))
    passing = player_of([tiny()], multi=False, turn_order="round_robin")
    with pytest.raises(InputError, match="turn_order: expected sequential"):
        PPO(setup_of(passing, ["a"]), options_of("ppo"))


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


@pytest.mark.parametrize("order", ["sequential", "round_robin"])
@pytest.mark.parametrize("choose", ["conflicts", "agents"])
def test_movers_are_the_rows_whose_agents_act(order: TurnOrder, choose: str) -> None:
    """They are known before the step: in sequential order, or while one is asked, a single row."""
    games = [tiny(seed, nets=5) for seed in range(4)]
    rules = {"turn_order": order, "rip_up": {"rounds": 2, "choose": choose}}
    engine = Engine(games, max_steps=12, **rules)
    player = Player(engine, PaperObservation(), PaperReward())
    player.reset()
    b, rng, seen = player.buffers, np.random.default_rng(0), set()
    while b.active.any():
        movers = player.movers
        choices = np.where(b.mask > 0, rng.random(b.mask.shape), -1)
        b.actions[:] = np.where(b.active, choices.argmax(axis=2), NOBODY)
        player.step()
        np.testing.assert_array_equal(b.acted, movers)
        seen |= set(movers.sum(axis=1).tolist())
    assert (max(seen) == 1) == (order == "sequential")
