"""Routers and policies, against the same moves made by hand through the environment's faces."""

import gc
import itertools
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from conftest import some_slow
from hypothesis import given
from hypothesis import strategies as st
from numba.core.dispatcher import Dispatcher
from reference import STEPS, Edge, between, capacity_of, distance, gcell_of, is_via
from strategies import problems

from marouting import (
    Engine,
    EnvOptions,
    InputError,
    Problem,
    Solution,
    evaluate,
    generate,
    global_routing_v0,
    sequential_astar,
)
from marouting.config import build
from marouting.env.single import GlobalRoutingSingle
from marouting.search.guides import AStar
from policies.generalist.router import GeneralistOptions, GeneralistRouter
from policies.learned.config import Config
from policies.learned.networks.mlp import MLP
from policies.learned.policy import TrainedPolicy
from policies.learned.router import LearnedRouter
from policies.learned.trainer import Episode, Trainer
from policies.routers.astar import AStarRouter
from policies.routers.base import solve, warm_up
from policies.routers.greedy import GreedyRouter
from policies.routers.random import RandomRouter


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> None:
    torch.set_num_threads(1)  # more of them cost more than they save on networks this small


def problem_of(seed: int, **options: Any) -> Problem:
    return generate(1, **{"grid": (5, 4, 2), "nets": 6, "capacity": 2, "seed": seed, **options})[0]


def policy_of(seed: int, masking: bool = False, **env: Any) -> TrainedPolicy:
    """A policy of random weights."""
    module = MLP((12,), 6, hidden=(9,))
    numbers = torch.Generator().manual_seed(seed)
    for weights in module.parameters():
        weights.data = torch.randn(weights.shape, generator=numbers)
    return TrainedPolicy(module, masking, (12,), EnvOptions(**env), "random weights")


def routes_of(policy: TrainedPolicy, problem: Problem) -> Solution:
    return policy.solve(problem).solution


def by_gymnasium(policy: TrainedPolicy, problem: Problem, **options: Any) -> Solution:
    env = GlobalRoutingSingle(problem, **options)
    seen, info = env.reset()
    over = False
    while not over:
        seen, _, terminated, truncated, info = env.step(policy.act(seen, info["action_mask"]))
        over = terminated or truncated
    return env.solution()


def by_aec(policy: TrainedPolicy, problem: Problem, **options: Any) -> Solution:
    env = global_routing_v0.env(problem, **options)
    env.reset()
    for _ in env.agent_iter():
        seen, _, terminated, truncated, info = env.last()
        over = terminated or truncated
        env.step(None if over else policy.act(seen, info["action_mask"]))
    return env.unwrapped.solution()


def by_parallel(policy: TrainedPolicy, problem: Problem, **options: Any) -> Solution:
    env = global_routing_v0.parallel_env(problem, **options)
    seen, infos = env.reset()
    while env.agents:
        moves = {a: policy.act(seen[a], infos[a]["action_mask"]) for a in env.agents}
        seen, _, _, _, infos = env.step(moves)
    return env.solution()


@pytest.fixture(scope="module")
def trained() -> dict[str, Trainer]:
    """Trainers after a short training, which walk further than random weights do."""
    trainers = {}
    for agents in ("single", "multi"):
        learner = {
            "gamma": 0.9,
            "learning_rate": 2e-3,
            "burn_in_size": 500,
            "target_period": 100,
            "masking": True,
        }
        env = {"agents": agents, "max_steps": 20}
        config = build(Config, {"env": env, "learner": learner, "train": {"episodes": 40}})
        trainers[agents] = Trainer({"p": problem_of(0), "q": problem_of(1)}, config)
        for _ in trainers[agents].run():
            pass
    return trainers


def saved(trainer: Trainer, path: Path) -> Path:
    torch.save(trainer.saved.state(), path)
    return path


OPTIONS: tuple[dict[str, Any], ...] = (
    {"max_steps": 20},
    {"max_steps": 7, "nets": {"order": "file"}},
    {"max_steps": 1},
    {"max_steps": 15, "nets": {"order": "half_perimeter_up"}, "overflow": "allowed"},
)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("masking", [False, True])
@pytest.mark.parametrize("seed", [3, 4])
def test_route_is_the_walk_through_the_faces(
    seed: int, masking: bool, options: dict[str, Any]
) -> None:
    problem = problem_of(seed)
    one = policy_of(seed, masking, agents="single", **options)
    routed = routes_of(one, problem)
    assert routed == by_gymnasium(one, problem, **options)
    assert routed == by_aec(one, problem, turn_order="sequential", **options)
    many = policy_of(seed, masking, agents="multi", **options)
    routed = routes_of(many, problem)
    assert routed == by_parallel(many, problem, **options)
    assert evaluate(problem, routed).wirelength <= 6 * options["max_steps"]
    # Without a mask, random weights can stand before a full edge all day.
    assert evaluate(problem, routed).wirelength > 0 or not masking
    if "overflow" not in options:
        assert evaluate(problem, routed).overflow == 0


def test_the_turn_order_of_the_game_counts() -> None:
    problem = problem_of(2)
    policy = policy_of(3, masking=True, turn_order="round_robin", max_steps=20)
    assert routes_of(policy, problem) == by_gymnasium(
        policy, problem, turn_order="round_robin", max_steps=20
    )
    policy = policy_of(3, masking=True, agents="multi", turn_order="sequential", max_steps=20)
    routed = routes_of(policy, problem)
    assert routed == by_parallel(policy, problem, turn_order="sequential", max_steps=20)
    assert routed == by_aec(policy, problem, turn_order="sequential", max_steps=20)


def test_trained_policies_walk_the_same_everywhere(
    trained: dict[str, Trainer], tmp_path: Path
) -> None:
    for agents, trainer in trained.items():
        path = saved(trainer, tmp_path / f"{agents}.pt")
        for name, seed in (("p", 0), ("q", 1)):
            policy = TrainedPolicy.load(path, name)
            for problem in (problem_of(seed), problem_of(7, nets=9, grid=(6, 6, 3))):
                routed = routes_of(policy, problem)
                by_hand = by_gymnasium if agents == "single" else by_parallel
                assert routed == by_hand(policy, problem, max_steps=20)
            figures = evaluate(problem_of(seed), routes_of(policy, problem_of(seed)))
            assert figures.joined > 0
            assert LearnedRouter(checkpoint=path, network=name).route(problem) == routed


def test_the_network_is_asked_with_torch_layers(
    trained: dict[str, Trainer], tmp_path: Path
) -> None:
    """Which move is best, and best of those that cross an edge."""
    path = saved(trained["single"], tmp_path / "policy.pt")
    saved_weights = torch.load(path, weights_only=True)["weights"]
    rng = np.random.default_rng(0)
    for weights, name in zip(saved_weights, ("p", "q"), strict=True):
        net = torch.nn.Sequential()
        for layer, (inputs, outputs) in enumerate(((12, 32), (32, 64), (64, 32), (32, 6))):
            linear = torch.nn.Linear(inputs, outputs)
            linear.weight.data = weights[f"layers.{layer}.weight"].T
            linear.bias.data = weights[f"layers.{layer}.bias"]
            net.extend([linear, torch.nn.ReLU()])
        policy = TrainedPolicy.load(path, name)
        unmasked = TrainedPolicy(policy.module, False, (12,), policy.env)
        differ = 0
        for _ in range(50):
            seen = rng.integers(-3, 6, 12).astype(np.float32)
            mask = rng.integers(2, size=6, dtype=np.int8)
            mask[rng.integers(6)] = 1
            with torch.no_grad():
                values = net[:-1](torch.from_numpy(seen)).numpy()
            best = int(np.where(mask == 1, values, -np.inf).argmax())
            assert policy.act(seen, mask) == best
            assert unmasked.act(seen, mask) == int(values.argmax())
            differ += best != int(values.argmax())
        assert differ > 0


def test_a_network_for_other_inputs_is_refused() -> None:
    policy = TrainedPolicy(MLP((13,), 6, hidden=()), False, (13,), EnvOptions())
    with pytest.raises(InputError, match=r"expected .* shape \(12,\), found .* for \(13,\)"):
        policy.solve(problem_of(0))


def test_observations_of_another_shape_are_refused() -> None:
    policy, masks = policy_of(0), np.ones((2, 6), np.int8)
    seen = np.zeros((2, 12))  # float64, too
    assert policy.moves(seen, masks).shape == (2,)
    with pytest.raises(InputError, match=r"^observations: expected shape \(K, 12\), found"):
        policy.moves(seen[:, :1], masks)


# --- files of trained networks --------------------------------------------------------------------


def transposed(state: dict[str, Any]) -> None:
    weights = state["weights"][0]
    weights["layers.0.weight"] = weights["layers.0.weight"].T.clone()


CHANGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    **{
        f"no {key}": lambda state, key=key: state.pop(key)  # type: ignore[misc]
        for key in ("format", "names", "episodes", "learner", "obs_shape", "env", "weights")
    },
    "another format": lambda state: state.update(format="marouting-dqn-1"),
    "no networks": lambda state: state.update(names=[], weights=[], episodes=[]),
    "a network too few": lambda state: state["weights"].pop(),
    "an evaluation too few": lambda state: state["episodes"].pop(),
    "names that are none": lambda state: state.update(names=7),
    "episodes that are none": lambda state: state.update(episodes=["few", "many"]),
    "endless episodes": lambda state: state.update(episodes=[float("inf")] * 2),
    "a layer too few": lambda state: state["weights"][0].pop("layers.3.bias"),
    "a layer too many": lambda state: state["weights"][0].update(more=torch.zeros(3)),
    "a layer of another shape": transposed,
    "a layer that is no tensor": lambda state: state["weights"][0].update({"layers.0.bias": [1]}),
    "weights of one network": lambda state: state.update(weights=state["weights"][0]),
    "weights that are none": lambda state: state.update(weights=[1, 2]),
    "other observations": lambda state: state.update(obs_shape=[13]),
    "empty observations": lambda state: state.update(obs_shape=[0]),
    "observations of negative size": lambda state: state.update(obs_shape=[-12]),
    "endless observations": lambda state: state.update(obs_shape=[float("inf")]),
    "an unknown learner": lambda state: state["learner"].update(kind="qdn"),
    "another learner": lambda state: state.update(learner="ppo"),
    "a learner that is none": lambda state: state.update(learner=3),
    "an unknown option": lambda state: state["learner"].update(colour="red"),
    "another network": lambda state: state["learner"].update(network={"kind": "conv"}),
    "an unknown game": lambda state: state["env"].update(agents="some"),
    "a game that is none": lambda state: state.update(env=[1]),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_damaged_policy_is_refused(
    change: Callable[[dict[str, Any]], Any], trained: dict[str, Trainer], tmp_path: Path
) -> None:
    path = tmp_path / "policy.pt"
    state = trained["single"].saved.state()
    state["env"] = dict(state["env"])
    change(state)
    torch.save(state, path)
    with pytest.raises(InputError) as caught:
        TrainedPolicy.load(path, "p")
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(InputError):
        LearnedRouter(checkpoint=path, network="p")


def test_the_checkpoint_of_a_training_is_a_policy_too(
    trained: dict[str, Trainer], tmp_path: Path
) -> None:
    trainer, path = trained["multi"], tmp_path / "checkpoint.pt"
    torch.save(trainer.state(), path)
    for name, problem in trainer.problems.items():
        own = trainer.policy_of(name).solve(problem)
        loaded = TrainedPolicy.load(path, name).solve(problem)
        assert loaded.solution == own.solution
        assert loaded.report == own.report


# --- LearnedRouter --------------------------------------------------------------------------------

LEARNERS: dict[str, dict[str, Any]] = {
    "dqn": {"burn_in_size": 100, "buffer_size": 500, "network": {"hidden": [8]}, "epsilon": 0.3},
    "dqn, torch": {
        **{"burn_in_size": 100, "buffer_size": 500, "network": {"hidden": [8]}, "epsilon": 0.3},
        "fused": False,
    },
    "ppo": {"kind": "ppo", "num_envs": 2, "rollout": 48, "minibatch": 16},
}


def short(kind: str = "dqn", agents: str = "single") -> Config:
    """A training that takes a moment."""
    env = {"agents": agents, "max_steps": 15}
    raw = {"env": env, "learner": LEARNERS[kind], "train": {"episodes": 6}}
    return build(Config, raw)


ALONE = [("dqn, torch", "single"), ("ppo", "single")]


@pytest.mark.parametrize(
    "trained", some_slow(itertools.product(LEARNERS, ("single", "multi")), ALONE)
)
def test_learned_router_gives_the_best_episode_of_a_training(trained: tuple[str, str]) -> None:
    problem = problem_of(3)
    config = short(*trained)
    watched: list[Episode] = []
    router = LearnedRouter(config, watch=watched.extend)
    routed = router.route(problem)
    trainer = Trainer({"problem": problem}, config)
    episodes = [episode for finished in trainer.run() for episode in finished]
    assert watched == episodes
    best = min(episodes, key=lambda e: (-e.joined, e.overflow, e.wirelength))
    figures = evaluate(problem, routed)
    assert (figures.overflow, figures.wirelength) == (best.overflow, best.wirelength)
    assert figures.joined >= best.joined
    assert routed == trainer.solutions()["problem"]
    again = LearnedRouter(config).solve(problem)
    assert again.solution == routed
    assert again.report == {"from": f"episode {best.episode + 1} of 6"}
    # Problems routed before make no difference.
    other = problem_of(4)
    assert router.route(other) == LearnedRouter(config).route(other)


def test_learned_router_with_a_checkpoint_trains_nothing(
    trained: dict[str, Trainer], tmp_path: Path
) -> None:
    path = saved(trained["single"], tmp_path / "policy.pt")
    watched: list[Episode] = []
    router = LearnedRouter(short(), path, watched.extend, network="q")
    problem = problem_of(5)
    routed, expected = router.solve(problem), TrainedPolicy.load(path, "q").solve(problem)
    assert router.route(problem) == routed.solution == expected.solution
    after = int(trained["single"].saved.episodes[1])
    assert routed.report == expected.report == {"from": f"policy after {after} episodes, greedy"}
    assert not watched
    with pytest.raises(InputError, match="expected the name of a problem in"):
        LearnedRouter(short(), path)


# --- classical ------------------------------------------------------------------------------------


class Drawn:
    """Draws each move evenly from those that cross an edge."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Any, mask: Any) -> int:
        del observation
        return int(self._rng.choice(np.flatnonzero(mask)))


def test_random_router_walks_by_its_seed() -> None:
    problem = problem_of(0)
    first = RandomRouter(3).route(problem)
    assert first == RandomRouter(3).route(problem)
    assert first != RandomRouter(4).route(problem)
    router = RandomRouter(3)
    assert router.route(problem) == router.route(problem) == first
    assert first == by_gymnasium(Drawn(3), problem)
    short = RandomRouter(3, max_steps=2).route(problem)
    assert short == by_gymnasium(Drawn(3), problem, max_steps=2)
    assert evaluate(problem, short).wirelength <= 2 * len(problem.nets)


@given(problems(), st.integers(0, 3))
def test_random_routes_take_no_more_than_there_is(problem: Problem, seed: int) -> None:
    router = RandomRouter(seed, max_steps=20)
    if all(len(gcells) == 1 for gcells in problem.pin_gcells):
        with pytest.raises(InputError, match="pins in two Gcells"):
            router.route(problem)
    else:
        assert evaluate(problem, router.route(problem)).overflow == 0


def test_astar_router_is_sequential_astar() -> None:
    for seed in range(3):
        problem = problem_of(seed, max_pins=4, nets=12)
        assert AStarRouter().route(problem) == sequential_astar(problem)
        up = AStarRouter(net_order="half_perimeter_up").route(problem)
        assert up == sequential_astar(problem, "half_perimeter_up")
        assert evaluate(problem, up).connected


# --- the greedy router ----------------------------------------------------------------------------


def greedily(problem: Problem, **options: Any) -> tuple[Solution, int]:
    """The greedy router in plain Python, and how many moves it made along detours."""
    engine = Engine([problem], turn_order="sequential", **options)
    astar, detour = AStar(engine), 0
    users: dict[Edge, set[int]] = {}
    nearest = 0
    while (n := int(engine.games[0]["agent"])) >= 0:
        agent = engine.agents[0, n]
        cell, target = (gcell_of(problem, int(agent[key])) for key in ("cell", "target"))
        if int(agent["steps"]) == 0:
            nearest = distance(cell, target)
        nearest = min(nearest, distance(cell, target))
        best, most = None, 0.0
        for move, step in enumerate(STEPS):
            ahead = tuple(a + d for a, d in zip(cell, step, strict=True))
            if not all(0 <= a < size for a, size in zip(ahead, problem.grid, strict=True)):
                continue
            edge = between(cell, ahead)  # type: ignore[arg-type]
            own = n in users.get(edge, ())
            limit = None if own or is_via(edge) else capacity_of(problem, edge)
            # Own edges before all others, and vias after them.
            free = 9e9 if own else 1e-9 if limit is None else limit - len(users.get(edge, ()))
            if free > most and distance(ahead, target) < nearest:  # type: ignore[arg-type]
                best, most = move, free
        if best is None:
            best, detour = int(astar.moves(np.array([0]), np.array([n]))[0]), detour + 1
        engine.step(np.array([best]))
        ahead = tuple(a + d for a, d in zip(cell, STEPS[best], strict=True))
        if engine.agents[0, n]["crossing"] > 1:
            users.setdefault(between(cell, ahead), set()).add(n)  # type: ignore[arg-type]
    return engine.solution(), detour


def test_the_heuristic_is_its_plain_version() -> None:
    detours = open_nets = 0
    for seed in range(12):
        problem = problem_of(seed, nets=8 + seed % 5, max_pins=2 + seed % 3)
        nets: dict[str, Any] = {"decomposition": "steiner"} if seed % 4 == 3 else {}
        expected, detour = greedily(problem, nets=nets)
        routed = GreedyRouter(**nets).route(problem)
        assert routed == expected
        found = evaluate(problem, routed)
        assert found.overflow == 0
        detours += detour
        open_nets += len(found.disconnected)
    assert detours > 0
    assert open_nets > 0


def test_nothing_is_left_to_compile_after_warming_up() -> None:
    problem = generate(1, nets=20, max_pins=3, seed=1)[0]
    router = GeneralistRouter(GeneralistOptions(seconds=2))
    warm_up(router)
    kernels = [one for one in gc.get_objects() if issubclass(type(one), Dispatcher)]
    before = [len(kernel.signatures) for kernel in kernels]
    assert router.solve(problem).report["rounds"] > 1
    assert [len(kernel.signatures) for kernel in kernels] == before


_COMPILED_LATE = """
import gc, json, os, sys
import policies.routers.registry
from marouting import generate
from policies.routers.base import solve, warm_up

def late(name, options):
    from numba.core.dispatcher import Dispatcher
    problem = generate(1, (8, 8, 3), nets=30, max_pins=5, capacity=2, seed=1)[0]
    router = policies.routers.registry.make_router(name, options)
    warm_up(router)
    kernels = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    before = {one: len(one.signatures) for one in kernels}
    solve(router, problem)[0].pruned()
    kernels = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    return [one.__name__ for one in kernels if len(one.signatures) != before.get(one, 0)]

for number, router in enumerate(json.loads(sys.argv[1])):
    if not os.fork():
        print(number, late(*router), flush=True)
        os._exit(0)
    os.wait()
"""


def test_no_router_compiles_in_the_seconds_of_a_route() -> None:
    """In processes of their own, where no other test has compiled or loaded anything."""
    routers: list[tuple[str, dict[str, Any]]] = [
        ("astar", {}),
        ("random", {}),
        ("greedy", {}),
        ("pathfinder", {"seconds": 0.5}),  # ends in the middle of a pass
        ("pathfinder", {"seconds": 0.5, "schedule": "tuned"}),
    ]
    done = subprocess.run(
        [sys.executable, "-c", _COMPILED_LATE, json.dumps(routers)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [f"{number} []" for number in range(len(routers))], (
        done.stderr
    )


class Nothing:
    def route(self, problem: Problem) -> Any:
        """Forgets to return the solution."""


def test_what_is_no_solution_is_refused() -> None:
    error = "Nothing: expected a marouting.Solution from route, found None"
    with pytest.raises(InputError, match=error):
        solve(Nothing(), generate(1)[0])


def test_a_solution_of_another_problem_is_refused() -> None:
    asked, other = generate(2, (4, 4, 2), nets=4, reduced_edges=0)

    class Other:
        def route(self, _: Problem) -> Solution:
            return sequential_astar(other)

    with pytest.raises(InputError, match=r"Other: expected a solution of the problem given, found"):
        solve(Other(), asked)
    copied = pickle.loads(pickle.dumps(asked))
    assert solve(AStarRouter(), copied)[0].problem == asked
