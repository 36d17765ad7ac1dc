"""Work on a GPU, recorded once and replayed.

A gradient step of a small stack is some fifty small operations. Starting them one by one takes
longer than carrying them out, so the step is recorded as a CUDA graph.
"""

from collections.abc import Callable

import torch

WARM_UP = 3
"""Calls before recording: libraries set themselves up in the first ones."""


class CudaGraph:
    """A function that is recorded after its first calls and replayed from then on.

    It takes everything from tensors that stay where they are, and never looks at their numbers.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        self._work, self._calls = work, 0

    def __call__(self) -> None:
        """Does the work once."""
        self._work()
        self._calls += 1
        if self._calls == WARM_UP:
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph):
                self._work()
            self._work = graph.replay
