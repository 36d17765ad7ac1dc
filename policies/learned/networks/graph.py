"""Work on a GPU, recorded once and replayed.

A gradient step of a small stack is some fifty small operations. Starting them one by one takes
longer than carrying them out, so the step is recorded as a CUDA graph.
"""

from collections.abc import Callable

import torch

Work = Callable[[], None]

WARM_UP = 3
"""Calls before recording: libraries set themselves up in the first ones."""


class Recorded:
    """A function that is recorded after its first calls and replayed from then on.

    The function takes everything from tensors that stay where they are, and never looks at a
    number of theirs.

    Args:
        work: the function.
        record: makes a replayable function of it; None: it is called every time.
    """

    def __init__(self, work: Work, record: Callable[[Work], Work] | None) -> None:
        self._work, self._record, self._calls = work, record, 0

    def __call__(self) -> None:
        """Does the work once."""
        self._work()
        self._calls += 1
        if self._record is not None and self._calls == WARM_UP:
            self._work = self._record(self._work)


def recorder(device: torch.device) -> Callable[[Work], Work] | None:
    """What records work on a device; None where nothing does."""
    return cuda_graph if device.type == "cuda" else None


def cuda_graph(work: Work) -> Work:
    """Records work as a CUDA graph, without doing it."""
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        work()
    return graph.replay
