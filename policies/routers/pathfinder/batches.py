"""Passes of large problems: nets are planned in batches, by as many threads as there are.

All nets of a batch are planned against the same trees: those that stand when the batch begins.
Then the plans are carried out one after another, but none whose tree costs more by then than the
net's present one. So no net gets worse, as when nets take turns, and what comes out does not
depend on the number of threads.
"""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.kernels import compiled, i64
from policies.routers.pathfinder.kernels import draw, set_box
from policies.routers.pathfinder.state import (
    BOX_TOO_SMALL,
    DONE,
    FIRST_BOX,
    LAYERS,
    NEGOTIATE,
    POOL_TOO_SMALL,
    PROGRESS,
    Memory,
    ProblemArrays,
    Routing,
    make_memory,
    widened,
    with_larger_pool,
)
from policies.routers.pathfinder.trees import (
    assign_tree,
    compact,
    is_settled,
    overflows,
    plan,
    use_tree,
)

MANY = 20_000
"""With more nets than these, they are planned in batches; otherwise they take turns."""

_SHARE = 64
"""One net of so many, at most, is in a batch, so that few of them meet."""

_MOST = 1024
"""Nets in a batch, at most."""

_POINTS = 1 << 22
"""Points in the boxes of a batch, after which no further net joins it: about 0.2 s of work."""

_SPREAD = 8
"""How many nets a batch is chosen from, for each that has room in it. Nets that come later see what
the batch has changed."""

_ROOM = 16
"""Room for the new trees of a batch at first, for each thread, in edges."""

_PARTS = 8
"""Into how many parts, per thread, a batch is cut, so that no thread waits long for another."""


class Batch(NamedTuple):
    """The nets of a batch, and what is planned for them."""

    net: NDArray[np.int64]  # (most,) the nets
    random: NDArray[np.int64]  # (most,) the state of their random numbers
    exact: NDArray[np.bool_]  # (most,) whether no tree in the net's box is cheaper
    worker: NDArray[np.int64]  # (most,) the worker that made the plan
    first: NDArray[np.int64]  # (most,) where the new tree begins among its edges
    last: NDArray[np.int64]  # (most,) and where it ends


def make_batch(nets: int) -> Batch:
    """Room for a batch of so many nets to be routed."""
    most = min(nets // _SHARE, _MOST)
    return Batch(
        net=np.empty(most, np.int64),
        random=np.empty(most, np.int64),
        exact=np.empty(most, np.bool_),
        worker=np.empty(most, np.int64),
        first=np.empty(most, np.int64),
        last=np.empty(most, np.int64),
    )


@compiled
def _gather(problem: ProblemArrays, routing: Routing, memory: Memory, batch: Batch) -> int:
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
        if is_settled(problem, routing, net):
            continue
        batch.net[count], batch.random[count] = net, draw(progress)
        margin, layers = problem.margin, i64(LAYERS)
        points += set_box(problem, routing, memory, net, margin, layers)
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
    return count


@compiled
def _plan_some(
    problem: ProblemArrays,
    routing: Routing,
    memory: Memory,
    batch: Batch,
    edges: Any,
    worker: int,
    last: int,
) -> int:
    """Plans some nets of a batch in a thread; POOL_TOO_SMALL: ``edges`` is full."""
    progress = routing.progress[0]
    while progress.next < last:
        i = progress.next
        progress.random = batch.random[i]
        size, exact = plan(problem, routing, memory, batch.net[i])
        if size == BOX_TOO_SMALL:
            return BOX_TOO_SMALL
        if progress.top + size > len(edges):
            progress.need = progress.top + size
            return POOL_TOO_SMALL
        batch.exact[i], batch.worker[i] = exact, worker
        batch.first[i], batch.last[i] = progress.top, progress.top + size
        for j in range(size):
            edges[progress.top + j] = memory.buffers.tree[j]
        progress.top += size
        progress.next += 1
    return DONE


@compiled
def _assign_planned(
    problem: ProblemArrays, routing: Routing, batch: Batch, edges: Any, begin: int, end: int
) -> int:
    """Carries out plans in order; returns the first that the pool lacks room for, or ``end``."""
    for i in range(begin, end):
        net, first, last = batch.net[i], batch.first[i], batch.last[i]
        code = POOL_TOO_SMALL
        while code != DONE:
            code = assign_tree(problem, routing, net, edges, first, last, batch.exact[i])
            if code == POOL_TOO_SMALL and not compact(routing):
                return i
    return end


class Worker:
    """A thread's own progress and working memory.

    Attributes:
        memory: the working memory.
        edges: (progress["top"],) the new trees that it has planned for a batch; more room.
        seconds: processor time that it took for that.
    """

    def __init__(self, number: int, problem: ProblemArrays) -> None:
        self.edges = np.empty(_ROOM, np.int32)
        self.seconds = 0.0
        self.progress: NDArray[Any] = np.zeros(1, PROGRESS)
        self._number, self._problem = number, problem
        self.make_room(min(FIRST_BOX, len(problem.position)))

    def make_room(self, points: int) -> None:
        """Makes the working memory large enough for boxes of so many points."""
        self.memory = make_memory(self._problem, points)

    def work(self, routing: Routing, batch: Batch, parts: Iterator[range]) -> None:
        """Plans one part of a batch after another; all workers share the iterator."""
        began = time.thread_time()
        self.progress[:] = routing.progress
        own, progress = routing._replace(progress=self.progress), self.progress[0]
        progress["top"] = 0
        for part in parts:
            progress["next"], code = part.start, BOX_TOO_SMALL
            while code != DONE:
                known = self._problem, own, self.memory, batch, self.edges
                code = _plan_some(*known, self._number, part.stop)
                if code == BOX_TOO_SMALL:
                    self.make_room(2 * int(progress["need"]))
                elif code == POOL_TOO_SMALL:
                    self.edges = widened(self.edges, 2 * int(progress["need"]))
        self.seconds = time.thread_time() - began


def advance_batch(
    problem: ProblemArrays, routing: Routing, batch: Batch, workers: list[Worker]
) -> Routing:
    """Gives the next nets of the pass new trees, unless theirs are as good.

    Args:
        problem: the problem.
        routing: the trees.
        batch: working memory.
        workers: plan the trees, each in a thread of its own, the first one in the caller's.

    Returns:
        The routing, with a larger pool if it needed one.
    """
    first, *others = workers
    end = _gather(problem, routing, first.memory, batch)
    count = _PARTS * len(workers) if others else 1
    size = max(-(-end // count), 1)
    # An iterator over a list gives each part to one thread; a generator could not be shared.
    parts = iter([range(i, min(i + size, end)) for i in range(0, end, size)])
    with ThreadPoolExecutor(len(workers)) as threads:
        waiting = [threads.submit(other.work, routing, batch, parts) for other in others]
        first.work(routing, batch, parts)
    for each in waiting:
        each.result()
    tops = np.array([worker.progress["top"][0] for worker in workers], np.int64)
    edges = np.concatenate([worker.edges[:top] for worker, top in zip(workers, tops, strict=True)])
    begin = (tops.cumsum() - tops)[batch.worker[:end]]
    batch.first[:end] += begin
    batch.last[:end] += begin
    planned = 0
    while planned < end:
        planned = _assign_planned(problem, routing, batch, edges, planned, end)
        if planned < end:
            routing = with_larger_pool(routing, 2 * int(routing.progress["need"][0]))
    return routing
