"""The threads and the device that learners use."""

import numba
import torch

from marouting.errors import InputError


def use_threads(threads: int) -> None:
    """Sets how many threads the compiled loops and torch's products share.

    Numba has no more than there were cores when it started.
    """
    torch.set_num_threads(threads)
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(min(threads, most))


def torch_device(name: str) -> torch.device:
    """A device of torch's; raises InputError if it cannot be used."""
    try:
        device = torch.device(name)
    except RuntimeError:
        device = None
    if device is None or device.type not in ("cpu", "cuda"):
        raise InputError(f"train.device: expected cpu, cuda or cuda:1, found {name}")
    try:
        torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        what = f"train.device: expected cpu or an available cuda device: {reason}"
        raise InputError(what) from None
    return device
