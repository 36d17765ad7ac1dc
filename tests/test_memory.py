"""Memory in proportion to what a file holds, and a limit for the rest that names how to lift it."""

import os
import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from marouting import Engine, InputError, Net, Pin, Problem, Solution, generate
from marouting.generator import GeneratorOptions, generate_each
from marouting.global_routing_v0 import parallel_env, raw_env
from marouting.memory import VARIABLE, check_memory
from marouting.source import load_problem
from marouting.vector import BatchEnv

PROMISE = """\
grid 4096 4096 1
vertical capacity 4
horizontal capacity 4
minimum width 1
minimum spacing 0
via spacing 0
0 0 10 10
num net 1
A 0 2 1
5 5 1
25 15 1
0
"""
ROUTES = "A 0\n(5,5,1)-(25,5,1)\n(25,5,1)-(25,15,1)\n!\n"

RUN = """
import sys
from policies.cli.main import status
done = status(sys.argv[1:])
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(peak.split()[1])
sys.exit(done)
"""


def run(*arguments: object, most_gib: float | None = None) -> tuple[int, int, str]:
    """Runs a command on its own; returns the status, the memory in MB at most, and the message."""
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc to read a process's memory from")

    def bound() -> None:  # a test that fails must not take the machine along
        resource.setrlimit(resource.RLIMIT_DATA, (8 * 2**30, 8 * 2**30))

    environment = os.environ | ({} if most_gib is None else {VARIABLE: str(most_gib)})
    done = subprocess.run(
        [sys.executable, "-c", RUN, *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=bound,
        timeout=300,
    )
    return done.returncode, int(done.stdout.split()[-1]) // 1000, done.stderr


@pytest.fixture
def promise(tmp_path: Path) -> tuple[Path, Path]:
    """A problem of twelve lines with 16.7 million Gcells, and a solution."""
    (tmp_path / "promise.gr").write_text(PROMISE)
    (tmp_path / "promise.solution").write_text(ROUTES)
    return tmp_path / "promise.gr", tmp_path / "promise.solution"


def test_evaluating_a_promise_takes_memory_for_its_routes(promise: tuple[Path, Path]) -> None:
    done, peak, said = run("evaluate", *promise)
    assert (done, said) == (0, "")
    assert peak < 300


@pytest.mark.slow
def test_drawing_a_promise_takes_memory_for_its_routes(
    promise: tuple[Path, Path], tmp_path: Path
) -> None:
    done, peak, said = run("plot", *promise, "--out", tmp_path / "figures")
    assert (done, said) == (0, "")
    assert len(list((tmp_path / "figures" / "promise").iterdir())) == 5
    assert peak < 600


@pytest.mark.parametrize("router", ["astar", "pathfinder", "optimal", "random"])
def test_routing_a_promise_is_refused_beyond_the_limit(
    promise: tuple[Path, Path], router: str
) -> None:
    done, peak, said = run("route", promise[0], "--router", router, most_gib=1)
    assert done == 2
    errors = [line for line in said.splitlines() if line.startswith("marouting: ")]
    assert len(errors) == 1  # a slow machine tells its progress, too
    assert "Traceback" not in said
    assert "4096x4096x1: expected to take at most 1.0 GiB of memory, found an estimate of" in said
    assert said.endswith("GiB; the environment variable MAROUTING_MAX_GIB sets the limit\n")
    assert peak < 300


def test_drawing_without_a_solution_is_refused_beyond_the_limit(
    promise: tuple[Path, Path], tmp_path: Path
) -> None:
    done, _, said = run("plot", promise[0], "--out", tmp_path / "figures", most_gib=1)
    assert done == 2
    assert said.startswith("marouting: A* on a grid of 4096x4096x1: expected to take at most")


def test_long_segments_count(promise: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A line of a solution may cover thousands of edges."""
    problem = Problem.read(promise[0])
    promise[1].write_text("A 0\n" + "(5,5,1)-(40955,5,1)\n" * 1000 + "!\n")
    monkeypatch.setenv(VARIABLE, "0.5")
    with pytest.raises(InputError, match="a solution of 4095000 edges: expected to take at most"):
        Solution.read(promise[1], problem)


def wide(nets: int, layers: int = 1) -> Problem:
    """Nets side by side on 256×256 Gcells."""
    pins = tuple((Pin(n % 256, 0, 1), Pin(n % 256, 1, 1)) for n in range(nets))
    return Problem(
        (256, 256, layers),
        (1,) * layers,
        (1,) * layers,
        tuple(Net(f"n{n}", n, own) for n, own in enumerate(pins)),
        (1,) * layers,
        (0,) * layers,
        (0,) * layers,
    )


def test_what_nets_use_counts_in_games(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a batch by the net and edge of every problem; the plain game has room for more."""
    problem = wide(12_000)
    monkeypatch.setenv(VARIABLE, "0.02")
    said = (
        r"12000 nets on a grid of 256x256x1 \(global_routing_v0.env has room for more\): expected"
    )
    with pytest.raises(InputError, match=said):
        Engine([problem])
    with pytest.raises(InputError, match="12000 nets on a grid"):
        BatchEnv([wide(6000)] * 2)
    Engine([wide(600)])
    raw_env(problem).reset()


@pytest.mark.parametrize("kind", [raw_env, parallel_env])
def test_a_promise_is_no_environment_beyond_the_limit(
    promise: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, kind: Callable[[str], object]
) -> None:
    monkeypatch.setenv(VARIABLE, "1")
    with pytest.raises(InputError, match="an environment on a grid of 4096x4096x1: expected to"):
        kind(str(promise[0]))


@pytest.mark.parametrize("value", ["", "x", "0", "-1", "nan"])
def test_a_limit_that_is_none(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv(VARIABLE, value)
    with pytest.raises(InputError, match=f"^MAROUTING_MAX_GIB: .* above 0, found '{value}'$"):
        check_memory(2**30, "anything")


def test_the_limit_is_a_share_of_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    check_memory(2**25, "little")
    with pytest.raises(InputError, match="much: expected"):
        check_memory(2**60, "much")
    monkeypatch.setenv(VARIABLE, "inf")
    check_memory(2**60, "much")


# --- generated problems ---------------------------------------------------------------------------


@pytest.mark.parametrize("reduced", [{"reduced_edges": 0}, {"reduced_edges": 3}])
def test_problems_are_generated_one_at_a_time(reduced: dict[str, int]) -> None:
    many = GeneratorOptions(count=10**9, nets=5, **reduced)
    assert list(islice(generate_each(many), 3)) == generate(3, nets=5, **reduced)


def test_the_children_of_a_seed_are_those_that_numpy_spawns() -> None:
    for child, stream in zip(generate(3, nets=1), np.random.SeedSequence(0).spawn(3), strict=True):
        first = np.random.default_rng(stream).integers(2, 3)  # the number of pins
        assert len(child.nets[0].pins) == first
    assert len({problem.nets for problem in generate(3, nets=1, seed=None)}) == 3


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"count": 10**9}, "count: 1000000000 problems: expected to take at most 4.0 GiB"),
        ({"nets": 10**9}, "count: 1 problems: expected to take at most 4.0 GiB"),
        ({"nets": 1, "max_pins": 10**9}, "count: 1 problems: expected to take at most 4.0 GiB"),
        ({"count": 10**400}, "count: expected 1 to 1000000000"),
        ({"nets": 10**10}, "nets: expected 1 to 1000000000"),
    ],
)
def test_sets_that_fit_no_memory_are_refused(
    monkeypatch: pytest.MonkeyPatch, options: dict[str, int], said: str
) -> None:
    monkeypatch.setenv(VARIABLE, "4")
    with pytest.raises(InputError, match=said):
        generate(**options)


def test_one_problem_of_many_is_asked_for_before_they_are_made() -> None:
    with pytest.raises(InputError, match="problem: expected one, found 1000000000"):
        load_problem({"count": 10**9})


def test_generate_refuses_a_problem_that_fits_no_memory(tmp_path: Path) -> None:
    done, peak, said = run("generate", "--nets", 10**9, "--out", tmp_path / "set", most_gib=4)
    assert done == 2
    assert said.startswith("marouting: nets: a problem of 1000000000: expected to take at most 4.0")
    assert peak < 300
    assert not (tmp_path / "set").exists()


def test_equal_coordinates_are_kept_once(tmp_path: Path) -> None:
    file, nets = tmp_path / "many.gr", 5000
    head = PROMISE.replace("num net 1", f"num net {nets}").partition("A 0 2 1")[0]
    rows = (
        f"n{n} {n} 2 1\n{7 * n % 4000} {n % 4000} 1\n{3 * n % 4000} 999 1\n" for n in range(nets)
    )
    file.write_text(f"{head}{''.join(rows)}0\n")
    Problem.read(file)  # what is made once and kept is no matter
    tracemalloc.start()
    try:
        problem = Problem.read(file)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(problem.nets) == nets
    assert kept / nets < 440  # a number for each coordinate would make it 95 more
