"""A binary heap of whole numbers, in an array."""

from typing import Any

from marouting.kernels import compiled


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
def pop(heap: Any, size: int) -> int:
    """Takes the smallest key out of the heap ``heap[:size]``, which is then one shorter."""
    first, key = heap[0], heap[size - 1]
    at, below = 0, 1
    while below < size - 1:
        if below + 1 < size - 1 and heap[below + 1] < heap[below]:
            below += 1
        if heap[below] >= key:
            break
        heap[at] = heap[below]
        at = below
        below = 2 * at + 1
    heap[at] = key
    return first
