"""Checkpoints and policy files: plain data and tensors, nothing that runs code.

:func:`read_checkpoint` checks the form of a file, and :func:`checked` every tensor against the one
that it replaces.
"""

import math
import os
import warnings
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting import InputError
from marouting.config import check_code
from marouting.files import unusable

POLICY_FORMAT, TRAINING_FORMAT = "marouting-policy-1", "marouting-training-8"
"""Mark a file of trained networks, and the checkpoint of a training, which holds them too; the
number goes up when the content changes."""

FINITE = (-float(np.finfo(np.float64).max), float(np.finfo(np.float64).max))
"""The limits of numbers that may be any but NaN or infinite."""

ANY = (-math.inf, math.inf)
"""The limits of numbers that may be any but NaN."""

_MOST_VALUES = 1_000_000
_DEEPEST = 50


def read_checkpoint(path: str | os.PathLike[str], *, training: bool) -> Mapping[str, Any]:
    """What a checkpoint or policy file holds: only tensors and plain data.

    Args:
        path: the file.
        training: whether it has to be the checkpoint of a training, to go on from; otherwise it
            may also be a file of trained networks.

    Raises:
        InputError: the file is missing, damaged, or holds anything else, or names code that files
            may not name here (:func:`marouting.config.check_code`).
    """
    try:
        # torch does not look at the archive's checksums.
        with zipfile.ZipFile(path) as archive:
            # A few compressed bytes can stand for more than fits in memory.
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise zipfile.BadZipFile("it is compressed")
            damaged = archive.testzip()
        if damaged is not None:
            raise zipfile.BadZipFile(f"bad checksum of {damaged}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of kinds of tensors that are refused below
            state = torch.load(path, map_location="cpu", weights_only=True)
        _count(state, _MOST_VALUES, _DEEPEST)
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
    check_code(state, os.fspath(path))
    return state


def _count(value: Any, most: int, deep: int) -> int:
    """How many values there are; raises ValueError for any but plain data and plain tensors.

    The same list may stand in a list more than once: a small file can stand for many values.
    """
    if deep == 0:
        raise ValueError(f"values are nested more than {_DEEPEST} deep")
    inner: Any = ()
    if type(value) is dict:
        if not all(type(key) is str for key in value):
            raise ValueError("expected strings as keys")
        inner = value.values()
    elif type(value) in (list, tuple):
        inner = value
    elif type(value) is Tensor:
        if value.layout != torch.strided or value.is_quantized or value.is_nested or value.is_meta:
            raise ValueError("expected dense tensors")
        if value.requires_grad:
            raise ValueError("expected tensors without gradients")
    elif type(value) not in (str, int, float, bool, type(None)):
        raise ValueError(f"expected plain data and tensors, found {type(value).__name__}")
    count = 1
    for part in inner:
        count += _count(part, most - count, deep - 1)
        if count > most:
            raise ValueError(f"there are more than {_MOST_VALUES} values")
    return count


def checked(kept: Any, now: Tensor, name: str, limits: tuple[float, float] = FINITE) -> Tensor:
    """A tensor from a file, in place of another one.

    Args:
        kept: what the file holds.
        now: a tensor of the right type and shape.
        name: what it is called in messages.
        limits: the least and the largest of its numbers.

    Raises:
        InputError: it is something else.
    """
    expected, found = _form(now), _form(kept)
    if found != expected:
        raise InputError(f"{name}: expected {expected}, found {found}")
    if kept.dtype == torch.bool:
        limits = (0, 1)
    if kept.numel() and (kept.is_floating_point() or limits != FINITE):
        numbers = kept.contiguous().view(torch.uint8) if kept.dtype == torch.bool else kept
        least, most = (float(end) for end in torch.aminmax(numbers))
        if not (limits[0] <= least and most <= limits[1]):  # NaN is neither
            text = "finite numbers" if limits == FINITE else f"{limits[0]:g} to {limits[1]:g}"
            raise InputError(f"{name}: expected {text}, found {least:g} to {most:g}")
    return kept


def as_rows(array: NDArray[Any]) -> Tensor:
    """An array (M, …) of any type as the tensor (M, B) uint8 of its bytes."""
    rows = np.ascontiguousarray(array).reshape(len(array), math.prod(array.shape[1:]))
    return torch.from_numpy(rows.view(np.uint8))


def from_rows(kept: Any, now: NDArray[Any], name: str) -> NDArray[Any]:
    """The array that :func:`as_rows` made ``kept`` of, in place of ``now``.

    Raises:
        InputError: it is something else; ``name`` says what.
    """
    rows = checked(kept, as_rows(now), name).contiguous()
    return rows.numpy().view(now.dtype).reshape(now.shape)


def _form(value: Any) -> str:
    if not isinstance(value, Tensor):
        return type(value).__name__
    return f"{value.dtype} of shape {tuple(value.shape)}".removeprefix("torch.")
