"""What the fields of options may be: told by their types, and for numbers by bounds."""

import functools
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from marouting.config import Piece, unknown_key
from marouting.errors import InputError


def check_fields(options: Any, **bounds: tuple[float, float]) -> None:
    """Checks the fields of a dataclass whose types are Literal, bool, int or float, or None too.

    A field that is itself a dataclass may be given as a mapping, and becomes one.

    Args:
        options: an object of the dataclass.
        **bounds: for each field that is a number the least and the largest one.

    Raises:
        InputError: a value is none of its field's; the message names the field, what was expected
            and what was found.
    """
    cls: Any = type(options)
    for name, hint in _hints(cls).items():
        value = getattr(options, name)
        parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        kind = parts[0]
        if value is None and type(None) in parts:
            continue
        if is_dataclass(kind) and kind is not Piece:
            object.__setattr__(options, name, _nested(name, kind, value))
        elif get_origin(kind) is Literal:
            if value not in get_args(kind):
                expected = f"one of {', '.join(get_args(kind))}"
                raise InputError(f"{name}: expected {expected}, found {value}")
        elif kind is bool:
            if not isinstance(value, bool):
                raise InputError(f"{name}: expected true or false, found {value!r}")
        elif name in bounds:
            least, most = bounds[name]
            number = (
                isinstance(value, int | float) if kind is float else hasattr(value, "__index__")
            )
            if not (number and not isinstance(value, bool) and least <= value <= most):
                raise InputError(f"{name}: expected {least:g} to {most:.7g}, found {value!r}")


def _nested(name: str, kind: Any, value: Any) -> Any:
    """An object of a dataclass, made from a mapping of its fields if it is not one already."""
    if isinstance(value, kind):
        return value
    known = [field.name for field in fields(kind)]
    if not isinstance(value, Mapping):
        expected = f"a mapping of {', '.join(known)}"
        raise InputError(f"{name}: expected {expected}, found {value!r}")
    for key in value:
        if key not in known:
            raise InputError(unknown_key(f"{name}.{key}", known))
    try:
        return kind(**value)
    except InputError as error:
        raise InputError(f"{name}.{error}") from None


@functools.cache
def _hints(cls: Any) -> dict[str, Any]:
    return get_type_hints(cls)
