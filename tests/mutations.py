"""Accidents to text, data and checkpoints: what tests/fuzz.py lets the package read.

Everything is drawn from a ``random.Random``, so the seed of that is all it takes to see an input
again. Text is changed at its tokens and lines, data at any of its values, checkpoints at the
numbers, types and shapes of their tensors and at the entries of their archive.
"""

import io
import math
import re
import zipfile
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from copy import deepcopy
from random import Random
from typing import Any

import torch

HUGE = "9" * 5000
NUMBERS = [0, 1, -1, 2, 7, 2**31, 2**63 - 1, 2**63, -(2**63), 10**400, 0.5, 1e-300, 1e18, 1e300]
TEXTS = ["", "p", "q", "dqn", "t", "..", "a/b", "\0", "\ud800", "１２", " 5 ", "1_000", "5", "=1+1"]
TEXTS += ["$\\frac$", "[/]", "_x", "x" * 300, "a\nb", "a\u2028b", "\x1b[2J"]
TEXTS += ["astar", "ppo", "os:path"]
NASTY: list[Any] = [None, True, False, math.nan, math.inf, [], [[]], {}, {"a": 1}]
NASTY += [*NUMBERS, *TEXTS]
"""Values that few keys accept."""

MODEST: list[Any] = [None, True, False, -1, 0, 1, 2, 3, 7, 64, 0.5, 1.0, -0.5, 1e-300, 1e300]
MODEST += [
    [],
    {},
    [8, 8],
    "",
    *["dqn", "ppo", "conv", "mlp", "multi", "single", "goal", "steiner", "allowed"],
]
"""Values that keep a training short where it takes them."""

TOKENS = (
    rb"-1 0 1 2 7 999999999 1e3 ! grid (1,1,1) NaN -Infinity 1e999 , ] { } -0 0x1 '= &a *a".split()
)
TOKENS += rb'" "\ud800" << !!int !!binary | # ~ ?'.split()
TOKENS += [b"", b"- ", b"\n", b"\r", b"\x00", b"\x1c", b"\xff", b"\xef\xbb\xbf", b"[" * 3000]
TOKENS += [HUGE.encode(), "０".encode()]


def in_text(rng: Random, content: bytes) -> bytes:
    """A text after a few accidents to its bytes, tokens and lines."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        kind = rng.choice(("byte", "token", "number", "number", "drop", "repeat", "swap", "cut"))
        if kind == "byte":
            at = rng.randint(0, len(content))
            more = rng.randbytes(rng.randint(0, 3))
            content = content[:at] + more + content[at + rng.randint(0, 2) :]
        elif kind == "cut":
            content = content[: rng.randint(0, len(content))]
        elif kind in ("token", "number"):
            parts = re.split(rb"([\s\[\]{}(),:=]+)", content)
            where = range(len(parts))
            if kind == "number":  # another one, which may be right
                where = [i for i in where if re.fullmatch(rb"-?\d+", parts[i])] or where
            at = rng.choice(where)
            own = parts[at]
            if kind == "number" and re.fullmatch(rb"-?\d{1,18}", own):
                parts[at] = b"%d" % (int(own) + rng.choice((-10, -1, 1, 1, 10)))
            else:
                parts[at] = rng.choice((rng.choice(TOKENS), rng.choice(parts)))
            content = b"".join(parts)
        else:
            lines = content.split(b"\n")
            at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
            if kind == "drop":
                del lines[at]
            elif kind == "repeat":
                lines.insert(other, lines[at])
            else:
                lines[at], lines[other] = lines[other], lines[at]
            content = b"\n".join(lines)
    return content


def places(data: Any) -> Iterator[tuple[Any, Any]]:
    """The containers in plain data, each with every key."""
    for key in range(len(data)) if isinstance(data, list) else list(data):
        yield data, key
        if isinstance(data[key], dict | list):
            yield from places(data[key])


def in_data(rng: Random, data: Any, values: Sequence[Any] = NASTY) -> Any:
    """Plain data after a few accidents to its values and keys.

    Args:
        rng: where they are drawn from.
        data: lists, mappings and values; stays as it is.
        values: what takes the place of others.
    """
    data = deepcopy(data)
    for _ in range(rng.choice((1, 1, 1, 1, 2, 3))):
        found = list(places(data))
        if not found:
            break
        container, key = rng.choice(found)
        other, place = rng.choice(found)
        kind = rng.choice(("set", "set", "set", "near", "drop", "more", "rename", "elsewhere"))
        number = type(container[key]) in (int, float)
        if kind == "near" and number:
            container[key] += rng.choice((-1, 1))
        elif kind == "drop":
            del container[key]
        elif kind == "elsewhere":
            # The same object once more: YAML writes it as an alias.
            container[key] = (
                deepcopy(other[place]) if _holds(other[place], container) else (other[place])
            )
        elif kind == "rename" and isinstance(container, dict) and isinstance(place, str):
            container[place] = container.pop(key)
        elif kind == "more" and isinstance(container, list):
            container.append(deepcopy(container[key]))
        elif kind == "more":
            container[rng.choice((str(place), "more", "kind"))] = deepcopy(rng.choice(values))
        else:
            container[key] = deepcopy(rng.choice(values))
    return data


def _holds(data: Any, container: Any) -> bool:
    """Whether data contains a container, so that it must not go into that."""
    if data is container:
        return True
    inner = data.values() if isinstance(data, dict) else data if isinstance(data, list) else ()
    return any(_holds(part, container) for part in inner)


# --- checkpoints ----------------------------------------------------------------------------------

_FLOATS = (math.nan, math.inf, -math.inf, -1.0, 1e30, -1e30, 0.0, 7.0, 0.5, 2.0**31)
_OTHERS = [
    None,
    -1,
    True,
    2**70,
    math.nan,
    math.inf,
    "x",
    "../..",
    [],
    {},
    [[]],
    b"x",
    1.5,
    0,
    10**6,
    # What torch reads as well with weights_only.
    torch.nn.Parameter(torch.ones(3)),
    OrderedDict(a=[1]),
    torch.Size([2, 3]),
    torch.float32,
    torch.device("cpu"),
    {1, 2},
    {1: 2},
    {(1, 2): torch.ones(2)},
    1j,
    (1, "x"),
    bytearray(b"x"),
    torch.ones(2).untyped_storage(),
]
_TYPES = (torch.float16, torch.float64, torch.int8, torch.int64, torch.bool, torch.complex64)


def in_state(rng: Random, state: Any) -> Any:
    """The content of a checkpoint after one or two accidents to tensors and values."""
    state = deepcopy(state)
    for _ in range(rng.choice((1, 1, 2))):
        container, key = rng.choice(list(places(state)))
        kind = rng.random()
        if kind < 0.05:
            del container[key]
        elif isinstance(container[key], torch.Tensor):
            container[key] = _other_tensor(rng, container[key])
        elif kind < 0.5 and isinstance(container[key], dict | list):
            container[key] = in_data(rng, container[key]) if container[key] else [{}]
        else:
            container[key] = deepcopy(rng.choice(_OTHERS))
    return state


def _other_tensor(rng: Random, tensor: torch.Tensor) -> Any:
    """A tensor of another type, shape or layout, or with other numbers; bytes stay those of games.

    A checkpoint's games are safe by its checksums: other bytes under new ones may be no game.
    """
    kind = rng.random() * (0.2 if tensor.dtype == torch.uint8 else 1)
    if kind < 0.06:
        return tensor.to(rng.choice(_TYPES))
    if kind < 0.14:
        flat = tensor.reshape(-1)
        return rng.choice((flat, tensor[:0] if tensor.dim() else flat, tensor.unsqueeze(0)))
    if kind < 0.2:
        large = torch.zeros(1, dtype=tensor.dtype).expand(1000, 1000, 1000)
        meta = torch.empty(3, device="meta")
        of = [large, meta, tensor.mT if tensor.dim() > 1 else None, *_OTHERS]
        if tensor.is_floating_point():
            whole = tensor.float()
            of += [
                tensor.to_sparse(),
                torch.nn.Parameter(tensor),
                tensor.clone().requires_grad_(),
                torch.nn.Buffer(tensor),
                torch.quantize_per_tensor(whole, 0.1, 0, torch.qint8),
                torch.complex(whole, whole).conj(),
                tensor.to_sparse_csr() if tensor.dim() == 2 else torch.ones(2, 2).to_sparse_csr(),
            ]
        return rng.choice(of)
    numbers = tensor.clone()
    if not numbers.numel():
        return numbers
    flat = numbers.view(-1)
    if numbers.dtype == torch.bool:
        flat.view(torch.uint8)[rng.randrange(flat.numel())] = rng.choice((0, 1, 2, 255))
        return numbers
    if numbers.dtype == torch.uint64:  # torch does not count with them
        flat.view(torch.int64)[rng.randrange(flat.numel())] += 1
        return numbers
    many = rng.choice((1, 1, 1, flat.numel()))
    for at in rng.sample(range(flat.numel()), many):
        if numbers.is_floating_point():
            flat[at] = rng.choice(_FLOATS)
        else:
            least, most = torch.iinfo(numbers.dtype).min, torch.iinfo(numbers.dtype).max
            new = rng.choice((least, most, -1, 0, 1, 2, 5, 6, 7, 100, int(flat[at]) + 1))
            flat[at] = max(least, min(most, new))
    return numbers


def saved(state: Any) -> bytes:
    """A checkpoint as torch writes it."""
    file = io.BytesIO()
    torch.save(state, file)
    return file.getvalue()


def in_archive(rng: Random, content: bytes) -> bytes:
    """A checkpoint in one entry of which there are accidents, its checksum being right."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as given, zipfile.ZipFile(file, "w") as archive:
        names = given.namelist()
        pickled = [name for name in names if name.endswith("data.pkl")]
        hit = rng.choice((*pickled, rng.choice(names)))
        for name in names:
            entry = given.read(name)
            if name == hit:
                entry = in_text(rng, entry) if rng.random() < 0.5 else _flipped(rng, entry)
            archive.writestr(name, entry)
    return file.getvalue()


def _flipped(rng: Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4)) if content else 0):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)
