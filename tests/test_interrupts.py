"""Ctrl-C: at once, but not while LLVM is at work."""

import os
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from llvmlite import binding, ir
from numba.core.types import abstract

import marouting
from marouting import Problem, Solution
from policies.interrupts import AGAIN, interruptible


@pytest.fixture(autouse=True)
def _answering() -> Iterator[None]:
    """Ctrl-C answered as in a terminal: a test run in the background inherits that it is not."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def compiled_module() -> binding.ModuleRef:
    """A function that returns at once."""
    module = ir.Module()
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), ()), "nothing")
    ir.IRBuilder(function.append_basic_block()).ret_void()
    return binding.parse_assembly(str(module))


@interruptible()
def run(work: Callable[[], object]) -> None:
    """Works as a command does."""
    work()


def test_llvm_is_not_interrupted() -> None:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(compiled_module(), machine)
    events = []

    def cached(_: binding.ModuleRef) -> None:
        signal.raise_signal(signal.SIGINT)
        events.append("went on")

    engine.set_object_cache(getbuffer_func=cached)

    def load() -> None:
        engine.finalize_object()
        events.append("loaded")
        time.sleep(10)
        events.append("slept")

    with pytest.raises(KeyboardInterrupt):
        run(load)
    assert events == ["went on", "loaded"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_type_that_numba_forgets_does_not_swallow_an_interrupt() -> None:
    events = []

    class Type:
        """Stands for a type."""

    def pop(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)
        events.append("went on")

    def work() -> None:
        held = Type()
        reference = weakref.ref(held, lambda gone: abstract._on_type_disposal(gone, pop))  # type: ignore[attr-defined]
        del held
        assert reference() is None
        time.sleep(10)
        events.append("slept")

    with pytest.raises(KeyboardInterrupt):
        run(work)
    assert events == ["went on"]


def test_what_a_library_catches_comes_again() -> None:
    events = []

    def work() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except:  # noqa: E722 (as some libraries do around what they import)
            events.append("caught")
        time.sleep(10)
        events.append("slept")

    with pytest.raises(KeyboardInterrupt):
        run(work)
    assert events == ["caught"]


def test_what_python_forgets_in_destructors_comes_again(capfd: pytest.CaptureFixture[str]) -> None:
    class Gone:
        """Is interrupted when it goes."""

        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    def work() -> None:
        held = Gone()
        del held
        time.sleep(10)

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run(work)
    assert time.monotonic() - began < 5
    assert capfd.readouterr().err == ""  # nothing about an exception that is ignored


def test_what_has_ended_the_work_does_not_come_again() -> None:
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            run(lambda: signal.raise_signal(signal.SIGINT))
    time.sleep(5 * AGAIN)  # it would come now


LONG: dict[str, list[str]] = {
    "generate": ["generate", "--count", "9999", "--grid", "32", "32", "2", "--nets", "400"],
    "pathfinder": ["route", "p.gr", "--router", "pathfinder", "seconds=99"],
    "generalist": ["route", "p.gr", "--router", "generalist", "seconds=99"],
    "optimal": ["route", "p.gr", "--router", "optimal"],
    "dqn": ["route", "p.gr", "--router", "dqn", "train.episodes=99999"],
    "astar": ["route", "p.gr", "best_of=99999"],
    "evaluate": ["evaluate", "p.gr", "p.solution"],
    "train": ["train", "env.problem=p.gr", "train.episodes=99999", "out=run"],
    "quickstart": ["quickstart"],
}
"""Commands that take long, but for one."""

STARTED = """
import sys
from signal import SIGINT, default_int_handler, signal
signal(SIGINT, default_int_handler)
sys.argv[0] = "marouting"
print("started", flush=True)
from marouting.__main__ import main
main()
"""


def interrupted(folder: Path, name: str, seconds: float) -> tuple[int, str]:
    """The status and the standard error of a command that is interrupted after some seconds."""
    words = [*LONG[name], *(["--out", "g"] if name == "generate" else [])]
    with subprocess.Popen(
        [sys.executable, "-c", STARTED, *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    return process.returncode, said


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a problem that does not fit, and a solution."""
    folder = tmp_path_factory.mktemp("long")
    problem = marouting.generate(1, (32, 32, 2), nets=600, capacity=3)[0]
    problem.write(folder / "p.gr")
    marouting.sequential_astar(problem).write(folder / "p.solution")
    return folder


def check_interrupted(folder: Path, name: str, seconds: float) -> None:
    """An interrupt ends the command, or its search; evaluating may be over before."""
    code, said = interrupted(folder, name, seconds)
    assert "Traceback" not in said
    assert "ignored" not in said
    if code == 0:
        assert name == "evaluate" or "stopping with the best solution so far" in said
    else:
        assert code == 130
        assert said.splitlines()[-1] == "marouting: interrupted"


@pytest.mark.parametrize(("name", "seconds"), [("pathfinder", 0.3), ("generate", 1), ("train", 2)])
def test_a_command_is_interrupted(folder: Path, name: str, seconds: float) -> None:
    check_interrupted(folder, name, seconds)


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_every_command_is_interrupted_at_any_time(folder: Path, name: str) -> None:
    for seconds in (0.2, 0.5, 1, 2, 4, 8, 16):
        check_interrupted(folder, name, seconds)


def test_importing_leaves_interrupts_alone() -> None:
    """Elsewhere than in the command."""
    code = "import signal, marouting; assert signal.getsignal(2) is signal.default_int_handler"
    code = f"import signal; signal.signal(2, signal.default_int_handler); {code}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_all_else_is_interrupted_at_once() -> None:
    events = []

    def work() -> None:
        signal.raise_signal(signal.SIGINT)
        events.append("went on")

    with pytest.raises(KeyboardInterrupt):
        run(work)
    assert not events


def test_who_answers_otherwise_still_does() -> None:
    events: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: events.append(number))
    run(lambda: signal.raise_signal(signal.SIGINT))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run(lambda: signal.raise_signal(signal.SIGINT))
    assert events == [signal.SIGINT]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_terminal_that_closes_leaves_the_best_route(tmp_path: Path) -> None:
    import pty

    marouting.generate(1, grid=(32, 32, 2), nets=700, seed=0)[0].write(tmp_path / "p.gr")
    command = [
        sys.executable, "-m", "marouting", "route", "p.gr", "--router", "pathfinder",
        "seconds=300", "least_gain=0", "--out", "best",
    ]  # fmt: skip
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(tmp_path)
        os.execv(command[0], command)
    shown = b""
    while b"pass " not in shown:
        shown += os.read(terminal, 2**16)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 128 + signal.SIGHUP
    assert Solution.read(tmp_path / "best", Problem.read(tmp_path / "p.gr"))
