"""Ctrl-C: at once, but not while LLVM is at work."""

import signal
import time
import weakref
from collections.abc import Callable, Iterator

import pytest
from llvmlite import binding, ir
from numba.core.types import abstract

from policies.interrupts import interruptible


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
