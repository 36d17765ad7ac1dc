"""The whole of a configuration, defaults included, and where each of its values is from."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from marouting.config import Component, Keys, attributes, build, hints_of, plain
from marouting.errors import InputError
from marouting.registry import allowing_code, names
from marouting.yaml_files import (
    INCLUDE,
    leaves,
    origins_of,
    override,
    parse_yaml,
    read_yaml,
    yaml_line,
)

Origins = dict[Keys, str]
"""Where each value is from, by its key and the keys that lead there."""

_COLUMN = 56
"""Where the comments begin."""


def kinds() -> dict[str, type[Any]]:
    """The kinds of configuration by the command that takes them."""
    from policies.experiment.benchmark import BenchmarkConfig
    from policies.experiment.config import ExperimentConfig
    from policies.learned.config import Config

    return {"train": Config, "experiment": ExperimentConfig, "benchmark": BenchmarkConfig}


def kind_of(raw: Mapping[str, Any], expected: str = "train") -> str:
    """The command that knows most keys of a configuration; among equals the one expected."""
    known = {
        kind: len(raw.keys() & schema.__dataclass_fields__) for kind, schema in kinds().items()
    }
    return max(known, key=lambda kind: (known[kind], kind == expected))


def check_kind(path: str | os.PathLike[str], command: str) -> None:
    """Raises InputError if another command knows more keys of a file than this one."""
    with allowing_code():  # nothing is imported for that
        kind = kind_of(read_yaml(path), command)
    if kind != command:
        raise InputError(
            f"{os.fspath(path)}: expected a configuration for `marouting {command}`, found one for "
            f"`marouting {kind}`"
        )


def resolve(
    path: str | os.PathLike[str] | None, overrides: Sequence[str] = ()
) -> tuple[dict[str, Any], Origins]:
    """A configuration as a command gets it.

    Args:
        path: a YAML file, of a training, an experiment or a benchmark; None: a training without.
        overrides: ``key=value``, as :func:`marouting.yaml_files.override` takes them.

    Returns:
        All its values as plain data, and where they are from: ``FILE:LINE``, with files named from
        the folder of the first, ``command line`` or ``default``.
    """
    from policies.learned.config import config_of

    raw, name = ({}, "") if path is None else (read_yaml(path), os.fspath(path))
    kind, changed = kind_of(raw), override(raw, overrides)
    whole = plain(
        config_of(changed, name) if kind == "train" else build(kinds()[kind], changed, name)
    )
    folder = Path(name).parent
    left = {keys for keys, _ in leaves(changed)}  # a change of a kind discards others
    given = {
        keys: f"{os.path.relpath(file, folder)}:{line}"
        for keys, (file, line) in ({} if path is None else origins_of(path)).items()
        if not left.isdisjoint((keys, (*keys, "kind")))
    }
    for text in overrides:
        key, _, value = text.partition("=")
        keys = tuple(key.split("."))
        for inner, _ in leaves({key: parse_yaml(value, text)}):
            given[(*keys, *inner[1:])] = "command line"
    return whole, {keys: _origin(keys, given) for keys, _ in leaves(whole)}


def schema_of(command: str) -> dict[str, Any]:
    """The JSON schema of a command's configurations, with what docstrings say of the keys."""
    schema = _schema(kinds()[command])
    files = {"anyOf": [_schema(str), _schema(list[str])]}
    schema["properties"][INCLUDE] = {**files, "description": "Files to begin from."}
    return schema


def _schema(hint: Any) -> dict[str, Any]:
    """The JSON schema of the values that :func:`marouting.config.taken` takes for a type."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return {"anyOf": [_schema(one) for one in inner]}
    if origin is Literal:
        return {"enum": list(inner)}
    if origin is tuple and inner[-1] is not ...:
        return {"type": "array", "prefixItems": [_schema(one) for one in inner], "items": False}
    if origin in (tuple, list):
        return {"type": "array", "items": _schema(inner[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema(inner[1])}
    if hint is Component:  # its name, or a mapping with the name as kind
        kind = {"type": "object", "properties": {"kind": _schema(str)}}
        return {"anyOf": [_schema(str), kind]}
    if not isinstance(hint, type) or not is_dataclass(hint):
        return {"type": _TYPES[hint]} if hint in _TYPES else {}
    return {"type": "object", "properties": _properties(hint), "additionalProperties": False}


def _properties(kind: Any) -> dict[str, Any]:
    """The schemas of the fields of a dataclass."""
    about: dict[str, str] = {}
    for base in kind.__mro__:
        about |= attributes(base)
    found = {name: _schema(hint) for name, hint in hints_of(kind).items()}
    for field in fields(kind):
        if field.name in found and field.name in about:
            found[field.name]["description"] = about[field.name]
        if field.name in found and "kind" in field.metadata:
            found[field.name]["examples"] = list(names(field.metadata["kind"]))
        if field.name in found and isinstance(field.default, bool | int | float | str):
            found[field.name]["default"] = field.default
    return found


_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}


def _origin(keys: tuple[str, ...], given: Origins) -> str:
    """Where a value is from; a component's name may stand for all of it, as in ``reward: team``."""
    component = keys[:-1] if keys[-1] == "kind" else keys
    return given.get(keys, given.get(component, "default"))


def text_of(whole: Mapping[str, Any], origins: Origins) -> str:
    """YAML text in which a comment says of each value where it is from."""
    lines: list[str] = []
    above: tuple[str, ...] = ()
    for keys, value in leaves(whole):
        shared = 0
        while shared < min(len(above), len(keys)) - 1 and above[shared] == keys[shared]:
            shared += 1
        for depth in range(shared, len(keys) - 1):
            lines.append(f"{'  ' * depth}{yaml_line(keys[depth])}:")
        entry = f"{'  ' * (len(keys) - 1)}{yaml_line(keys[-1])}: {yaml_line(value)}"
        lines.append(f"{entry:<{_COLUMN}}  # {origins[keys]}")
        above = keys
    return "\n".join(lines) + "\n"
