"""Games, and trainings, on a CUDA device.

Without a device, numba's simulator runs the same code as Python; ``-m gpu`` runs it on a device.
"""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import marouting
from marouting.batch.setup import static_state
from marouting.config import build
from marouting.cuda.env import _narrow, _without_vias
from marouting.options import game_options
from marouting.vector import BatchEnv
from policies.bench.cuda import CASES
from policies.cli.main import status
from policies.learned.algorithms.ppo import PPOOptions
from policies.learned.config import load_config
from policies.learned.device_trainer import on_device
from policies.learned.on_device import DevicePPO
from policies.learned.run import problems_of, trainer_of

SIMULATED = Path(__file__).with_name("simulated.py")


def simulate(*names: str, simulator: bool = True) -> dict[str, list[str]]:
    """The lines that parts of tests/simulated.py print in the simulator, or on a real device."""
    settings = {
        **os.environ, "NUMBA_ENABLE_CUDASIM": str(int(simulator)), "PYTHONWARNINGS": "ignore",
    }  # fmt: skip
    run = subprocess.run(
        [sys.executable, str(SIMULATED), *names],
        env=settings, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-2000:]
    parts = run.stdout.split("== ")[1:]
    return {name: lines for name, *lines in (part.split("\n")[:-1] for part in parts)}


@pytest.fixture(
    scope="module",
    params=[True, pytest.param(False, marks=pytest.mark.gpu)],
    ids=["simulator", "real"],
)
def printed(request: pytest.FixtureRequest) -> dict[str, list[str]]:
    """What tests/simulated.py prints, by its parts."""
    return simulate("play", "resume", "draw", "check", simulator=request.param)


def test_a_device_plays_the_same_games_as_the_processor(printed: dict[str, list[str]]) -> None:
    assert printed["play"] == ["None"] * len(CASES)


def test_a_training_on_a_device_goes_on_from_its_checkpoint(printed: dict[str, list[str]]) -> None:
    *same, steps, episodes = printed["resume"]
    assert same == ["True"] * 3
    for counts in (steps, episodes):  # so that games end, and others begin, in it
        assert len(set(counts.split())) == 1
        assert int(counts.split()[0]) > 0


def test_games_draw_their_problems_anew_and_leave_nothing_of_the_last(
    printed: dict[str, list[str]],
) -> None:
    differs, counts = printed["draw"]
    assert differs == "None"
    episodes, problems = map(int, counts.split())
    assert episodes >= 6
    assert problems > 2  # of two games


def test_what_cannot_be_used_is_told_and_scenarios_order_turns(
    printed: dict[str, list[str]],
) -> None:
    assert printed["check"] == [
        "actions: expected 0 to 5, or -1, found others",  # at the next reset
        "actions: expected integers of shape (1, 3), found float64 of shape (1, 3)",
        "actions: expected integers of shape (1, 3), found float64 of shape (1, 3)",
        "seed: expected a whole number from 0, found -1",
        *4 * ["saved: expected the state of a game with this problem and options"],
        "threads: expected 1: they are the processor's, found True",
        "problems: expected a list of problems, or a problem or scenario as well; found 1",
        "pool: expected a number from 1, found 0.5",
        "True WindowObservation",
        "False PaperObservation",
    ]


def test_what_the_device_does_not_know_trains_with_the_networks_alone_on_it() -> None:
    changes = ["learner.kind=ippo", "env.scenario=gates-8x7-v0", "train.device=cuda"]
    assert on_device(load_config(None, changes))
    for other in (
        "env.observation.channels=[demand]", "env.message_bits=1", "learner.kind=dqn",
        "train.device=cpu",
    ):  # fmt: skip
        assert not on_device(load_config(None, [*changes, other]))


def test_games_are_on_the_first_device_alone() -> None:
    changes = ["learner.kind=ippo", "env.scenario=gates-8x7-v0", "train.device=cuda:1"]
    config = load_config(None, changes)
    with pytest.raises(marouting.InputError, match=r"^train.device: expected cuda, .*cuda:1$"):
        trainer_of(*problems_of(config), config)


@pytest.mark.gpu
def test_a_real_device_plays_the_same_games() -> None:
    from policies.bench.cuda import compare

    problems = marouting.generate(64, nets=8, max_pins=3, grid=(6, 6, 2), capacity=2)
    assert [compare(problems, 100, **options) for options in CASES] == [None] * len(CASES)


@pytest.mark.slow
@pytest.mark.parametrize("capability", [(8, 0), (9, 0)])
def test_all_kernels_compile_for_a_device(
    capability: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numba_cuda")
    pytest.importorskip("nvidia.cu13")  # NVVM, which compiles
    import numba.cuda.dispatcher
    from numba import cuda, types
    from numba.cuda.typing.typeof import typeof

    import marouting.cuda.games as device

    class Array(np.ndarray):
        def copy_to_device(self, other: Any) -> None:
            self[...] = other

    def type_of(value: Any) -> Any:
        if isinstance(value, tuple) and hasattr(value, "_fields"):
            return types.NamedTuple([type_of(part) for part in value], type(value))
        plain = {bool: types.boolean, int: types.int64, float: types.float64}
        return plain.get(type(value)) or typeof(
            np.asarray(value) if isinstance(value, Array) else value
        )

    compiled = []

    def launch(_: Any, kernel: Any, *arguments: Any) -> None:
        kinds = tuple(map(type_of, arguments[2:]))  # without threads and stream
        code, _ = cuda.compile(kernel.py_func, kinds, cc=capability, device=False, abi="numba")
        compiled.append(code)

    def begin(self: Any) -> None:
        device.cuda, self.simulated = cuda, False
        device._make_known()

    given = SimpleNamespace(compute_capability=capability)
    monkeypatch.setattr(numba.cuda.dispatcher, "get_current_device", lambda: given)
    for name, method in {
        "__init__": begin,
        "launch": launch,
        "zeros": lambda _, shape, dtype, order="F": np.zeros(shape, dtype, order).view(Array),
        "of": lambda _, value: value.view(Array) if isinstance(value, np.ndarray) else value,
        "column": lambda _, records, name: records[name],
    }.items():
        monkeypatch.setattr(device.Device, name, method)
    problems = marouting.generate(3, nets=4, reduced_edges=0)
    for options in (CASES[0], CASES[10], CASES[11]):
        env: Any = BatchEnv(3, problem=problems, device="cuda", **options)
        env._launch(0, steps=True, restarts=True)
        env.state()
    assert len(compiled) == 3 * 6
    assert all(f".target sm_{capability[0]}{capability[1]}" in code for code in compiled)


def test_edges_cannot_overflow_their_small_types_while_routes_are_put_back() -> None:
    problems = marouting.generate(1, nets=200, reduced_edges=0)
    for rounds, kind in ((0, np.int8), (1, np.int16)):
        rules = game_options({"rip_up": {"rounds": rounds}} if rounds else {})
        static, _ = static_state(problems, rules)
        assert _narrow(_without_vias(static))["remaining"] == kind


def test_what_a_device_cannot_do_is_refused_in_one_line() -> None:
    problems = marouting.generate(1, nets=3, reduced_edges=0)
    with pytest.raises(marouting.InputError, match="device: expected cpu or cuda, found 'tpu'"):
        BatchEnv(problems, device="tpu")
    with pytest.raises(marouting.InputError, match="seed: expected a whole number from 0"):
        BatchEnv(problems, device="cuda", seed=-1)
    with pytest.raises(marouting.InputError, match="threads: expected 1"):
        BatchEnv(problems, device="cuda", threads=2)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a device")
def test_without_a_device_a_command_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(marouting.InputError, match=r"^device: expected .*found "):
        BatchEnv(marouting.generate(1, nets=3, reduced_edges=0), device="cuda")
    changes = ["learner.kind=ippo", "env.scenario=gates-8x7-v0", "train.device=cuda"]
    assert status(["train", *changes, f"out={tmp_path / 'run'}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "device: expected" in line
    assert not (tmp_path / "run").exists()


# --- PPO on arrays of the processor ---------------------------------------------------------------


def learner(steps: int, games: int = 4, **options: Any) -> DevicePPO:
    scenario = marouting.scenarios.get("gates-8x7-v0")
    problems = [problem for problem, _ in zip(scenario.train(0), range(64), strict=False)]
    batch = BatchEnv(games, problem=problems, **scenario.env)
    wanted = {"network": {"kind": "mlp", "hidden": [64, 64]}, "final_failures": True, **options}
    observation = game_options(scenario.env).observation.make()
    return DevicePPO(batch, observation, build(PPOOptions, wanted), steps=steps)


def test_advantages_are_those_of_a_loop_over_moves() -> None:
    ppo = learner(40, gamma=0.9, gae_lambda=0.8)
    ppo.play()
    found, waits = ppo.advantages()
    active, games = ppo.flat(ppo.info["active"]), ppo.games
    for row in range(ppo.rows):
        ahead, gain, late = float(ppo.value[-1, row]), 0.0, 0.0
        for t in reversed(range(ppo.steps)):
            if ppo.over[t, row % games]:
                ahead = gain = late = 0.0
            late += float(ppo.reward[t, row])
            if not ppo.acted[t, row]:
                continue
            if ppo.joined[t, row] or ppo.failed[t, row]:
                ahead = gain = 0.0  # failures are final here
            value = float(ppo.value[t, row])
            gain = late + 0.9 * ahead - value + 0.9 * 0.8 * gain
            ahead, late = value, 0.0
            assert float(found[t, row]) == pytest.approx(gain, abs=1e-4)
            last = not ppo.acted[t + 1 :, row].any() and not ppo.over[t:, row % games].any()
            assert bool(waits[t, row]) == (last and not active[row])
            gain *= not waits[t, row]
    assert ppo.over.any()
    assert waits.any()
    assert ppo.acted.any()
    assert not ppo.acted.all()


def test_a_last_move_is_paid_until_its_game_is_over() -> None:
    ppo = learner(8)
    paid: dict[int, float] = {}  # by row: of the moves that wait
    late = made = learned = 0
    for _ in range(12):
        ppo.play()
        _, waits = ppo.advantages()
        moves = ppo._learned_from()
        for t, some in enumerate(moves):
            for row in paid:
                paid[row] += float(ppo.reward[t, row])
            over = [row for row in sorted(paid) if ppo.over[t, row % ppo.games]]
            at_once = int((ppo.acted[t] & ~waits[t]).sum())
            assert some.returns[at_once:].tolist() == pytest.approx(
                [paid.pop(row) for row in over], abs=1e-4
            )
            late += len(over)
        for row in waits.any(dim=0).nonzero()[:, 0].tolist():
            t = int(waits[:, row].nonzero()[0, 0])  # failures are final here
            paid[row] = float(ppo.reward[t:, row].sum())
        made += int(ppo.acted.sum())
        learned += sum(len(some.action) for some in moves)
    assert late
    assert learned + len(paid) == made


@pytest.mark.parametrize("steps", [1, 4, 40])
@pytest.mark.parametrize("rip_up", [{}, {"rounds": 2, "choose": "conflicts"}])
def test_all_that_is_paid_is_learned_from_once(rip_up: dict[str, Any], steps: int) -> None:
    options: dict[str, Any] = {"reward": "team", "max_steps": 7, "rip_up": rip_up or None}
    problems = marouting.generate(3, nets=4, grid=(4, 4, 2), capacity=1, reduced_edges=0)
    batch = BatchEnv(3, problem=problems, **options)
    wanted = {"final_failures": True, "gamma": 1.0, "gae_lambda": 0.0}
    observation = game_options(options).observation.make()
    ppo = DevicePPO(batch, observation, build(PPOOptions, wanted), steps=steps)
    paid = learned = 0.0
    for _ in range(-(-40 // steps)):
        ppo.play()
        ppo.value.zero_()
        paid += float(ppo.reward.sum())
        learned += sum(float(moves.returns.sum()) for moves in ppo._learned_from())
    waiting = float(ppo.waiting.returns[ppo.waits].sum())
    assert learned + waiting == pytest.approx(paid, abs=1e-3)
    assert paid != 0
    ppo.iterate()  # also where all moves of a rollout wait


def test_moves_of_the_window_are_turned_into_those_of_the_grid() -> None:
    ppo = learner(4)
    ppo.play()
    info, obs = ppo.info, ppo.now
    flat, mask = ppo.flat(obs), ppo.flat(info["action_mask"])
    turned = ppo._turned(mask, flat)
    for move in range(6):
        chosen = torch.full((ppo.rows,), move)
        grid = ppo._moves(chosen, flat)
        assert torch.equal(turned[move], mask.gather(0, grid[None])[0].bool())


@pytest.mark.slow
def test_it_learns_to_give_way() -> None:
    ppo = learner(32, 128, learning_rate=1e-3)
    first = marouting.evaluate_policy(ppo, "gates-8x7-v0", "validation")
    for _ in range(60):
        ppo.iterate()
    last = marouting.evaluate_policy(ppo, "gates-8x7-v0", "validation")
    assert last.cost < 1.25 < first.cost
