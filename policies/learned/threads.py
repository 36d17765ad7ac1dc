"""How many threads the compiled loops and torch's products share."""

import numba
import torch


def use_threads(threads: int) -> None:
    """Sets it for both; numba has no more than there were cores when it started."""
    torch.set_num_threads(threads)
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(min(threads, most))
