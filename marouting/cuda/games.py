"""The batch of games on a CUDA device.

The rules are those of the processor: the kernels of :mod:`marouting.batch` and
:mod:`marouting.player`, compiled for the device. One thread plays one game, and one thread writes
what one agent sees; a warp clears a game whose episode begins. A step is five launches: games
begin, games move, agents whose tasks have ended see where they arrived, games settle, agents see.

Scattered reads set the pace. So agents are numbered in turn order: threads that play neighbouring
games then read neighbouring addresses. What an agent reads around itself lies together, in the
smallest types that hold it (:mod:`marouting.cuda.env`).

Compiled kernels are not kept on disk. ``cache=True`` of numba-cuda would take old ones for as long
as this file does not change, whatever becomes of the rules, and would raise an error where nothing
can be written. What it would take is in :mod:`marouting.compiling`.

Without a device, numba's simulator runs the same code as Python (``NUMBA_ENABLE_CUDASIM=1``), which
is slow and meant for tests.
"""

import contextlib
import functools
import sys
import warnings
import weakref
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from marouting import kernels
from marouting.batch.expected import Maps
from marouting.batch.observation import write_paper, write_state
from marouting.batch.rules import clear_problem
from marouting.batch.state import Dynamic, Static
from marouting.batch.step import (
    SETTLE_ALL,
    SETTLE_NOTHING,
    FastPath,
    StepBuffers,
    move_game,
    settle_game,
    start_game,
    write_mask,
)
from marouting.batch.window import write_window_state
from marouting.batch.window_rows import Offsets, count_heads, write_window
from marouting.errors import InputError
from marouting.game import NOBODY, Ending
from marouting.kernels import i64, mixed

THREADS = 256
"""Threads of a block."""

WARP = 32
"""Threads that run in step; so many clear a game together."""

DEFAULT_STREAM = 0
"""The stream of all launches and copies, which torch uses as well."""

cuda: Any = None
"""The module ``numba.cuda``, once there is a :class:`Device`."""


class Pool(NamedTuple):
    """The problems from which games draw, in arrays of P problems; empty where problems stay."""

    capacity: Any  # (P, E) as in Static, and so on
    demand: Any  # (P, N, Z)
    first: Any  # (P, N + 1)
    order: Any  # (P, N)
    key: Any  # (M,) uint64, from which the draws of a game follow
    episode: Any  # (M,) int64, the episodes that a game has begun
    number: Any  # (M,) int32, the problem that it plays


class Step(NamedTuple):
    """What the launches of a step pass on to each other."""

    which: Any  # (M,) bool, in a reset: the games that begin
    begins: Any  # (M,) bool, games that begin in this step
    on_turn: Any  # (M,) int32, the agent whose turn it was


class Paper(NamedTuple):
    """What the paper's observation needs."""

    via_capacity: float


class Device:
    """The CUDA device that numba has chosen.

    Attributes:
        simulated: whether numba only simulates a device.

    Raises:
        InputError: numba-cuda is not installed, there is no device, or its driver is too old.
    """

    def __init__(self) -> None:
        global cuda
        cuda = _load()
        self.simulated = "simulator" in cuda.jit.__module__
        if not self.simulated:
            _make_known()

    def jit(self, function: Any) -> Any:
        """A kernel that is launched from Python."""
        if not self.simulated:
            return cuda.jit(extensions=[_Arguments])(function)
        kernel = cuda.jit(function)
        kernel.extensions = [_Arguments]
        return kernel

    def zeros(self, shape: tuple[int, ...], dtype: Any, order: str = "F") -> Any:
        """A new array of zeros; with ``F`` what belongs to neighbouring games is side by side."""
        if self.simulated:
            return self.of(np.zeros(shape, dtype, "F" if order == "F" else "C"))
        array: Any = cuda.device_array(shape, dtype, order=order)
        if array.size:
            from numba.cuda.cudadrv import driver

            memset: Any = driver.device_memset
            memset(array, 0, array.size * array.dtype.itemsize)
        return array

    def of(self, value: Any) -> Any:
        """A copy of an array on the device; anything else as it is."""
        return cuda.to_device(value) if isinstance(value, np.ndarray) else value

    def array(self, value: Any) -> Any:
        """An array that another library has on the device, without a copy."""
        return value if self.simulated else cuda.as_cuda_array(value)

    def synchronize(self) -> None:
        """Waits until all work on the device is done."""
        cuda.synchronize()

    def column(self, records: Any, name: str) -> Any:
        """A view of a field of an array of records."""
        if self.simulated:
            return type(records)(records._ary[name])
        kind, offset = records.dtype.fields[name][:2]
        pointer, read_only = records.__cuda_array_interface__["data"]
        interface = {
            "shape": records.shape,
            "strides": records.strides,
            "typestr": kind.str,
            "data": (pointer + offset, read_only),
            "version": 3,
        }
        return cuda.from_cuda_array_interface(interface, owner=records)

    @contextlib.contextmanager
    def allocating(self) -> Iterator[None]:
        """Raises InputError where the device has too little memory."""
        try:
            yield
        except Exception as error:
            if "OUT_OF_MEMORY" not in str(error):
                raise
            free, whole = cuda.current_context().get_memory_info()
            text = f"{free / 2**30:.1f} of its {whole / 2**30:.1f} GiB are free"
            raise InputError(f"device: expected more memory for these games, {text}") from None

    def launch(self, kernel: Any, threads: int, stream: Any, *arguments: Any) -> None:
        """Runs a kernel in so many threads."""
        block = min(THREADS, threads)
        kernel[-(-threads // block), block, stream](*arguments)


class Recorded:
    """Launches that are recorded once, as a CUDA graph, and then repeated by a single call.

    Numba takes a third of a millisecond to pass on the arguments of a launch. The arrays and the
    kernels have to outlive this object, which does not keep them: whoever owns both would otherwise
    be part of a cycle, and its memory on the device would wait for Python's garbage collector.
    """

    def __init__(self, launch: Callable[[Any], None]) -> None:
        from cuda.bindings import driver

        self._driver = driver
        stream = cuda.stream()
        handle = int(stream.handle)
        mode = driver.CUstreamCaptureMode.CU_STREAM_CAPTURE_MODE_RELAXED
        self._checked(driver.cuStreamBeginCapture(handle, mode))
        launch(stream)
        graph = self._checked(driver.cuStreamEndCapture(handle))
        self._graph = self._checked(driver.cuGraphInstantiate(graph, 0))
        self._checked(driver.cuGraphDestroy(graph))
        destroys = weakref.finalize(self, driver.cuGraphExecDestroy, self._graph)
        destroys.atexit = False  # a process that ends frees everything

    def __call__(self) -> None:
        """Repeats the launches."""
        self._checked(self._driver.cuGraphLaunch(self._graph, DEFAULT_STREAM))

    @staticmethod
    def _checked(answer: Any) -> Any:
        error, *found = answer
        if int(error) != 0:
            raise RuntimeError(f"CUDA: {error!r}")
        return found[0] if found else None


def _load() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            from numba import cuda as found
        except ImportError:
            raise InputError("device: expected numba-cuda (extra cuda), found none") from None
    available: Any = found.is_available
    if not available():
        error = getattr(found, "cuda_error", lambda: None)() or "none"
        reason = " ".join(str(error).split())
        raise InputError(f"device: expected a CUDA device and its driver, found {reason}")
    if "simulator" not in found.jit.__module__ and "numba_cuda" not in str(found.__file__):
        raise InputError("device: expected numba-cuda (extra cuda), found none")
    return found


@functools.cache
def _make_known() -> None:
    """Lets code for the device call kernels: numba-cuda sees a device function."""
    from numba.core.registry import cpu_target
    from numba.cuda.typing.typeof import typeof_impl

    # Arrays are indexed by members of an IntEnum, which numba-cuda takes from numba once that is
    # there.
    cpu_target.typing_context.refresh()
    made: dict[kernels.Kernel, Any] = {}

    def type_of(kernel: Any, context: Any) -> Any:
        if kernel not in made:
            made[kernel] = cuda.jit(device=True)(kernel.py_func)
        return typeof_impl(made[kernel], context)

    typeof_impl.register(kernels.Kernel)(type_of)


class _Arguments:
    """How arguments that numba-cuda does not know are passed to kernels."""

    @staticmethod
    def prepare_args(kind: Any, value: Any, **_: Any) -> tuple[Any, Any]:
        if kind is None:  # in the simulator
            from marouting.cuda.simulator import arguments

            return kind, arguments(value)
        from numba import types

        # All there is to know of None is its type; what is passed is a null pointer.
        return (types.int64, 0) if isinstance(kind, types.NoneType) else (kind, value)


# --- kernels --------------------------------------------------------------------------------------


@kernels.compiled
def drawn(key: Any, episode: int, problems: int) -> int:
    """The number of the problem that a game plays in an episode."""
    z = mixed(key + np.uint64(episode) * np.uint64(0x9E3779B97F4A7C15))
    return i64((z >> np.uint64(11)) % np.uint64(problems))


@kernels.compiled
def put_problem(static: Static, pool: Pool, m: int, p: int, first: int, step: int) -> None:
    """Puts problem p of the pool in the place of game m; one thread of ``step`` does its share."""
    for edge in range(first, pool.capacity.shape[1], step):
        static.capacity[m, edge] = pool.capacity[p, edge]
    for n in range(first, pool.order.shape[1], step):
        static.order[m, n] = pool.order[p, n]
        for layer in range(pool.demand.shape[2]):
            static.demand[m, n, layer] = pool.demand[p, n, layer]
    for n in range(first, pool.first.shape[1], step):
        static.first[m, n] = pool.first[p, n]


@kernels.inlined
def see_paper(
    static: Static, dynamic: Dynamic, look: Paper, m: int, n: int, out: Any, row: int
) -> None:
    """Writes what an agent sees by the paper's observation."""
    write_paper(static, dynamic, look.via_capacity, m, n, out, row)


class Surroundings(NamedTuple):
    """What the observation ``window`` needs."""

    heads: Any  # (M, G) or (M, 2 G), see count_heads
    offsets: Offsets
    maps: Maps  # of which only track is there, (M, Z)
    tracks: Any  # (P, Z) track of the problems of the pool
    number: Any  # (M,) the problem that a game plays


@kernels.inlined
def see_window(
    static: Static, dynamic: Dynamic, look: Surroundings, m: int, n: int, out: Any, row: int
) -> None:
    """Writes what an agent sees by the observation ``window``."""
    write_window(static, dynamic, look.heads, look.maps, look.offsets, m, n, out, row)


@kernels.inlined
def prepare_window(dynamic: Dynamic, look: Surroundings, m: int) -> None:
    """Counts the agents in every Gcell."""
    if max(look.offsets.heads, look.offsets.messages) >= 0:
        count_heads(dynamic, look.heads, m)


@kernels.inlined
def tell_window(static: Static, dynamic: Dynamic, look: Surroundings, m: int, out: Any) -> None:
    """Writes the global state that goes with the observation ``window``."""
    for layer in range(look.tracks.shape[1]):
        look.maps.track[m, layer] = look.tracks[look.number[m], layer]
    write_window_state(static, dynamic, look.maps, look.heads, look.offsets, m, out)


@kernels.inlined
def tell_paper(
    static: Static,  # noqa: ARG001
    dynamic: Dynamic,
    look: Paper,  # noqa: ARG001
    m: int,
    out: Any,
) -> None:
    """Writes the global state."""
    write_state(dynamic, m, out)


@kernels.inlined
def prepare_nothing(dynamic: Dynamic, look: Paper, m: int) -> None:
    """The paper's observation needs nothing but the state."""


class Launches(NamedTuple):
    """The kernels of a step, see :func:`launches`."""

    take: Any
    begin: Any
    move: Any
    arrive: Any
    settle: Any
    show: Any
    look: Any
    state: Any


@functools.cache
def launches(see: Any, prepare: Any, tell: Any) -> Launches:
    """The kernels of a step, for an observation.

    With ``window`` the arguments of ``move`` take 4089 bytes. CUDA before 12.1 refuses more than
    4096: one array more, and drivers before that cannot be used.

    Args:
        see: writes what an agent sees, with arguments (static, dynamic, look, m, n, out, row).
        prepare: makes what ``see`` needs of game m, with arguments (dynamic, look, m).
        tell: writes the global state, with arguments (static, dynamic, look, m, out).
    """
    device = Device()
    if not device.simulated:
        text = "compiling the games for the device, in every process: about 20 s"
        print(text, file=sys.stderr, flush=True)
    jit = device.jit

    @jit
    def take(given: Any, actions: Any, most: int, refused: Any) -> None:
        place = i64(cuda.grid(1))
        row = place // len(actions)
        m = place - row * len(actions)
        if row >= actions.shape[1]:
            return
        move = i64(given[m, row])
        fits = NOBODY <= move < most
        actions[m, row] = move if fits else NOBODY
        if not fits:
            refused[0] = 1

    @jit
    def begin(
        static: Static,
        dynamic: Dynamic,
        b: StepBuffers,
        pool: Pool,
        step: Step,
        steps: bool,
        restarts: bool,
    ) -> None:
        place = i64(cuda.grid(1))
        m = place // WARP
        if m >= len(b.over):
            return
        lane = place - m * WARP
        begins = b.over[m] and restarts if steps else step.which[m]
        if lane == 0:
            step.begins[m] = begins
        if begins:
            if len(pool.capacity) > 0:
                p = drawn(pool.key[m], i64(pool.episode[m]), i64(len(pool.capacity)))
                put_problem(static, pool, m, p, lane, i64(WARP))
            clear_problem(static, dynamic, m, lane, i64(WARP))

    @jit
    def move(
        static: Static,
        dynamic: Dynamic,
        b: StepBuffers,
        fast: FastPath,
        look: Any,
        pool: Pool,
        step: Step,
        steps: bool,
    ) -> None:
        m = i64(cuda.grid(1))
        if m >= len(b.over):
            return
        step.on_turn[m] = dynamic.games[m].agent
        if step.begins[m]:
            if len(pool.capacity) > 0:
                pool.number[m] = drawn(pool.key[m], i64(pool.episode[m]), i64(len(pool.capacity)))
                pool.episode[m] += 1
                for n in range(b.agents.shape[1] * fast.everyone):
                    there = static.first[m, n] < static.first[m, n + 1]
                    b.agents[m, n] = n if there else NOBODY
            start_game(static, dynamic, b, m)
        elif steps:
            move_game(static, dynamic, b, fast, m)
        prepare(dynamic, look, m)

    @jit
    def arrive(
        static: Static, dynamic: Dynamic, b: StepBuffers, look: Any, step: Step, everyone: bool
    ) -> None:
        place = i64(cuda.grid(1))
        row = place // len(b.over)
        m = place - row * len(b.over)
        if row >= b.agents.shape[1]:
            return
        ended = b.ending[m, row] != Ending.NONE
        passes = not everyone and not static.sequential and dynamic.games[m].active > 1
        if step.begins[m] or not (ended or (passes and b.acted[m, row])):
            return
        n = row if everyone else i64(step.on_turn[m])
        see(static, dynamic, look, m, n, b.final_obs[m], row)
        write_mask(static, dynamic, b.final_mask, m, n, row)

    @jit
    def settle(
        static: Static,
        dynamic: Dynamic,
        b: StepBuffers,
        fast: FastPath,
        look: Any,
        step: Step,
        steps: bool,
    ) -> None:
        m = i64(cuda.grid(1))
        if m >= len(b.over):
            return
        if not steps and not step.begins[m]:
            return
        what = i64(SETTLE_ALL) if steps and not step.begins[m] else i64(SETTLE_NOTHING)
        settle_game(static, dynamic, b, fast, m, i64(step.on_turn[m]), what)
        prepare(dynamic, look, m)

    @jit
    def show(static: Static, dynamic: Dynamic, b: StepBuffers, look: Any) -> None:
        place = i64(cuda.grid(1))
        row = place // len(b.over)
        m = place - row * len(b.over)
        if row >= b.agents.shape[1]:
            return
        n = i64(b.agents[m, row])
        see(static, dynamic, look, m, n, b.obs[m], row)
        write_mask(static, dynamic, b.mask, m, n, row)

    @jit
    def look(dynamic: Dynamic, look: Any) -> None:
        m = i64(cuda.grid(1))
        if m < len(dynamic.games):
            prepare(dynamic, look, m)

    @jit
    def state(static: Static, dynamic: Dynamic, look: Any, out: Any) -> None:
        m = i64(cuda.grid(1))
        if m < len(out):
            tell(static, dynamic, look, m, out)

    return Launches(take, begin, move, arrive, settle, show, look, state)
