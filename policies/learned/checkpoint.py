"""Checkpoints and policy files, read with care: plain data and tensors, nothing that runs code."""

import os
import zipfile
from collections.abc import Mapping
from typing import Any

import torch

from marouting import InputError
from marouting.files import unusable

POLICY_FORMAT, TRAINING_FORMAT = "marouting-policy-1", "marouting-training-1"
"""Mark a file of trained networks, and the checkpoint of a training, which holds them too; the
number goes up when the content changes."""


def read_checkpoint(path: str | os.PathLike[str], *, training: bool) -> Mapping[str, Any]:
    """What a checkpoint or policy file holds: only tensors and plain data.

    Args:
        path: the file.
        training: whether it has to be the checkpoint of a training, to go on from; otherwise it
            may also be a file of trained networks.

    Raises:
        InputError: the file is missing, damaged, or holds anything else.
    """
    try:
        # torch does not look at the archive's checksums.
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
        if damaged is not None:
            raise zipfile.BadZipFile(f"bad checksum of {damaged}")
        state = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None
    except Exception as error:
        # A damaged file can fail in the archive, the unpickler or the tensors, each in its way.
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{os.fspath(path)}: expected a checkpoint of this package, undamaged: {reason[:120]}"
        ) from None
    known = (TRAINING_FORMAT,) if training else (POLICY_FORMAT, TRAINING_FORMAT)
    if not isinstance(state, Mapping) or state.get("format") not in known:
        raise InputError(f"{os.fspath(path)}: expected a file of format {' or '.join(known)}")
    return state
