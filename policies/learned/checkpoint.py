"""Checkpoints and policy files, read with care: plain data and tensors, nothing that runs code."""

import os
import zipfile
from collections.abc import Mapping
from typing import Any

import torch

from marouting import InputError
from marouting.files import unusable

FORMAT = "marouting-dqn-2"
"""Marks a checkpoint; the number goes up when its content changes."""


def read_checkpoint(path: str | os.PathLike[str]) -> Mapping[str, Any]:
    """What a checkpoint or policy file holds, tensors and plain data alone.

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
    if not isinstance(state, Mapping) or state.get("format") != FORMAT:
        raise InputError(f"{os.fspath(path)}: expected a checkpoint of format {FORMAT}")
    return state
