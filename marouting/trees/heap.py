"""A binary heap of whole numbers, in an array."""

from typing import Any

from marouting.kernels import compiled, i64


@compiled
def push(heap: Any, size: int, key: int) -> None:
    """Puts a key into the heap ``heap[:size]``, which is then one longer."""
    at = size
    while at > 0:
        above = (at - 1) >> 1
        if heap[above] <= key:
            break
        heap[at] = heap[above]
        at = above
    heap[at] = key


@compiled
def exchange(heap: Any, size: int, key: int) -> int:
    """Takes the smallest key out of the heap ``heap[:size]`` and puts another one in."""
    first = heap[0]
    # The hole moves all the way down, since the key nearly always belongs there, and then up.
    # The smaller child is chosen by arithmetic: a branch would be guessed wrongly half of the time.
    at, below = 0, 1
    while below + 1 < size:
        below += i64(heap[below + 1] < heap[below])
        heap[at] = heap[below]
        at, below = below, 2 * below + 1
    if below < size:
        heap[at] = heap[below]
        at = below
    push(heap, at, key)
    return first


@compiled
def pop(heap: Any, size: int) -> int:
    """Takes the smallest key out of the heap ``heap[:size]``, which is then one shorter."""
    return exchange(heap, size - 1, heap[size - 1]) if size > 1 else heap[0]
