"""Passes of large problems: nets are planned in batches, by as many threads as there are.

All nets of a batch are planned against the same trees: those that stand when the batch begins.
Then the plans are carried out one after another, but none whose tree costs more by then than the
net's present one. So no net gets worse, as when nets take turns, and what comes out does not
depend on the number of threads.
"""

import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, i64
from marouting.problem.grid import AXES
from policies.routers.pathfinder.kernels import draw, set_box
from policies.routers.pathfinder.passes import advance
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DONE,
    EDGES,
    FIRST_BOX,
    LAYERS,
    NEGOTIATE,
    POOL_TOO_SMALL,
    PROGRESS,
    SQUEEZE,
    Memory,
    Parameters,
    ProblemArrays,
    Routing,
    make_memory,
    widened,
    with_larger_pool,
)
from policies.routers.pathfinder.trees import adopt, compact, is_settled, overflows, plan, use_tree

_POINTS = 1 << 22
"""Points in the boxes of a batch, after which no further net joins it: about 0.2 s of work."""

_SPREAD = 8
"""How many nets a batch is chosen from, for each that has room in it. Nets that come later see what
the batch has changed."""

_ROW = 16
"""Room for the new trees of a batch at first, for each thread, in edges."""

_PARTS = 8
"""Into how many parts, per thread, a batch is cut, so that no thread waits long for another."""


class Batch(NamedTuple):
    """The nets of a batch, and what is planned for them."""

    net: NDArray[np.int64]  # (most,) the nets
    random: NDArray[np.int64]  # (most,) the state of their random numbers
    plan: NDArray[np.int64]  # (most, 2) as NetBuffers.plan
    row: NDArray[np.int64]  # (most,) the thread that made the plan
    first: NDArray[np.int64]  # (most,) where the new tree begins in that row of ``edge``
    edge: NDArray[np.int32]  # (threads, size) edges of the new trees
    top: NDArray[np.int64]  # (threads,) end of the used part of each row
    low: NDArray[np.int64]  # (3,) a box; working memory, like the next
    size: NDArray[np.int64]  # (3,)


@compiled
def _gather(problem: ProblemArrays, parameters: Parameters, routing: Routing, batch: Batch) -> int:
    """Puts the next nets of the pass into a batch; returns how many there are.

    Where nets negotiate, a net whose edges would not overflow without those that are in the batch
    waits for the next batch: by then it may be better to stay.
    """
    progress, order = routing.progress[0], routing.order
    negotiated = progress.kind == NEGOTIATE
    begin, count, points = i64(progress.next), i64(0), i64(0)
    end = min(begin + _SPREAD * len(batch.net), len(order))
    while progress.next < end and count < len(batch.net) and points < _POINTS:
        net = order[progress.next]
        progress.next += 1
        if negotiated and not overflows(routing, net):
            continue
        if is_settled(problem, parameters, routing, net):
            continue
        batch.net[count], batch.random[count] = net, draw(progress)
        margin = parameters.margin
        points += set_box(problem, routing, net, margin, i64(LAYERS), batch.low, batch.size)
        if negotiated:
            use_tree(problem, routing, net, i64(-1))
            order[progress.next - 1], order[begin + count] = order[begin + count], net
        count += 1
    if negotiated:
        for i in range(count):
            use_tree(problem, routing, batch.net[i], i64(1))
        for i in range(progress.next - 1, begin + count - 1, -1):
            net = order[i]
            if overflows(routing, net):
                progress.next -= 1
                order[i], order[progress.next] = order[progress.next], net
    for row in range(len(batch.top)):
        batch.top[row] = 0
    return count


@compiled
def _plan_some(
    problem: ProblemArrays,
    parameters: Parameters,
    routing: Routing,
    memory: Memory,
    batch: Batch,
    row: int,
    last: int,
) -> int:
    """Plans some nets of a batch in a thread; POOL_TOO_SMALL: its row of ``edge`` is full."""
    progress, buffers = routing.progress[0], memory.buffers
    while progress.next < last:
        i = progress.next
        progress.random = batch.random[i]
        code = plan(problem, parameters, routing, memory, batch.net[i])
        if code != DONE:
            return code
        edges, first = buffers.plan[EDGES], batch.top[row]
        if first + edges > batch.edge.shape[1]:
            progress.need = first + edges
            return POOL_TOO_SMALL
        for j in range(len(buffers.plan)):
            batch.plan[i, j] = buffers.plan[j]
        for j in range(edges):
            batch.edge[row, first + j] = buffers.tree[0, j]
        batch.row[i], batch.first[i] = row, first
        batch.top[row] = first + edges
        progress.next += 1
    return DONE


@compiled
def _adopt_all(problem: ProblemArrays, routing: Routing, batch: Batch, begin: int, end: int) -> int:
    """Carries out plans in order; returns the first that the pool lacks room for, or ``end``."""
    for i in range(begin, end):
        net, row, first = batch.net[i], batch.row[i], batch.first[i]
        code = POOL_TOO_SMALL
        while code != DONE:
            code = adopt(problem, routing, net, batch.plan[i], batch.edge, row, first)
            if code == POOL_TOO_SMALL and not compact(routing):
                return i
    return end


class _Worker:
    """A thread's own progress and working memory."""

    def __init__(self, row: int, problem: ProblemArrays, exact_pins: int) -> None:
        self.row = row
        self.progress: NDArray[Any] = np.zeros(1, PROGRESS)
        self.seconds = 0.0  # of processor time in the present batch
        self._problem, self._exact_pins = problem, exact_pins
        self.make_room(min(FIRST_BOX, len(problem.position)))

    def make_room(self, points: int) -> None:
        """Makes the working memory large enough for boxes of so many points."""
        self.memory = make_memory(self._problem, self._exact_pins, points)

    def work(
        self, parameters: Parameters, routing: Routing, batch: Batch, parts: deque[range]
    ) -> range:
        """Plans one part of a batch after another, until none is left.

        Returns:
            The nets that its row of ``batch.edge`` had no room for.
        """
        began = time.thread_time()
        self.progress[:] = routing.progress
        own, progress = routing._replace(progress=self.progress), self.progress[0]
        left = range(0)
        while not left:
            try:
                part = parts.popleft()
            except IndexError:
                break
            progress["next"], code = part.start, BOX_TOO_SMALL
            while code == BOX_TOO_SMALL:
                code = _plan_some(
                    self._problem, parameters, own, self.memory, batch, self.row, part.stop
                )
                if code == BOX_TOO_SMALL:
                    self.make_room(2 * int(progress["need"]))
            left = range(int(progress["next"]), part.stop)
        self.seconds = time.thread_time() - began
        return left


class Crew:
    """The threads that carry a search on.

    Args:
        problem: the problem.
        parameters: the options.
        most: nets that are planned at once.
        threads: how many threads plan them, the caller's included.

    Attributes:
        waited: processor time of the thread that worked longest beyond that of the caller's, in
            seconds, over all batches.
    """

    def __init__(
        self, problem: ProblemArrays, parameters: Parameters, most: int, threads: int
    ) -> None:
        self.waited = 0.0
        self._problem, self._parameters = problem, parameters
        count = threads if most > 1 else 1
        self._workers = [_Worker(row, problem, parameters.exact_pins) for row in range(count)]
        self._threads = ThreadPoolExecutor(count - 1) if count > 1 else None
        self._batch = Batch(
            net=np.empty(most, np.int64),
            random=np.empty(most, np.int64),
            plan=np.empty((most, 2), np.int64),
            row=np.empty(most, np.int64),
            first=np.empty(most, np.int64),
            edge=np.empty((count, _ROW), np.int32),
            top=np.zeros(count, np.int64),
            low=np.zeros(AXES, np.int64),
            size=np.zeros(AXES, np.int64),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._threads is not None:
            self._threads.shutdown()

    def advance(self, routing: Routing) -> tuple[bool, Routing]:
        """Carries the search on for a while.

        Returns:
            Whether the search has ended; and the routing, with a larger pool if it needed one.
        """
        progress, first = routing.progress[0], self._workers[0]
        planned = progress["most"] > 1 and progress["kind"] <= SQUEEZE
        if planned and progress["next"] < len(routing.order):
            return False, self._advance_batch(routing)
        code = advance(self._problem, self._parameters, routing, first.memory)
        if code == BOX_TOO_SMALL:
            first.make_room(2 * int(progress["need"]))
        elif code == POOL_TOO_SMALL:
            routing = with_larger_pool(routing, 2 * int(progress["need"]))
        return code == DONE, routing

    def _advance_batch(self, routing: Routing) -> Routing:
        """Gives the next nets of the pass new trees, unless theirs are as good."""
        end = _gather(self._problem, self._parameters, routing, self._batch)
        count = _PARTS * len(self._workers) if self._threads is not None else 1
        size = max(-(-end // count), 1)
        parts = deque(range(i, min(i + size, end)) for i in range(0, end, size))
        while parts:
            parts = self._plan(routing, parts)
            if parts:
                need = max(int(worker.progress[0]["need"]) for worker in self._workers)
                self._batch = self._batch._replace(edge=widened(self._batch.edge, 2 * need))
        planned = 0
        while planned < end:
            planned = _adopt_all(self._problem, routing, self._batch, planned, end)
            if planned < end:
                routing = with_larger_pool(routing, 2 * int(routing.progress[0]["need"]))
        return routing

    def _plan(self, routing: Routing, parts: deque[range]) -> deque[range]:
        """Plans parts of the batch; returns those that there was no room for, and what is left."""
        first, *others = self._workers
        arguments = self._parameters, routing, self._batch, parts
        waiting: list[Future[range]] = []
        if self._threads is not None:
            waiting = [self._threads.submit(other.work, *arguments) for other in others]
        left = [first.work(*arguments), *(other.result() for other in waiting)]
        self.waited += max(worker.seconds for worker in self._workers) - first.seconds
        return deque([*(part for part in left if part), *parts])
