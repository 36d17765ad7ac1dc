"""From plain data to checked options: dataclasses as schemas, and components by name.

A dataclass defines the keys of a configuration, their types and their defaults, which are found
nowhere else. Types are checked strictly. For an unknown key, the error message suggests the nearest
known one.

A **component** is a part that users may write themselves. A configuration refers to it by its name
in :mod:`marouting.registry`::

    reward: {kind: paper, reached: 10}
    reward: {kind: "my_package.rewards:Selfless", share: 0.5}

The options of a component are the fields of its class if that is a dataclass, the fields of its
nested dataclass ``Options`` if it has one, and the keyword parameters of its constructor otherwise.
"""

import dataclasses
import functools
import inspect
import json
import math
import operator
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import MISSING, field, fields, is_dataclass
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    NotRequired,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from marouting.errors import InputError
from marouting.old_names import RENAMED_VALUES, unknown_key
from marouting.registry import KINDS, allowing_code, code_allowed, lookup, name_of, names

MOST = 2**31 - 1
"""The largest count; compiled code and arrays do not support integers of arbitrary size."""


def check(name: str, holds: object, expected: str) -> None:
    """Raises InputError, ``name: expected …``, if a condition does not hold."""
    if not holds:
        raise InputError(f"{name}: expected {expected}")


# --- plain data and types -------------------------------------------------------------------------

Schema = TypeVar("Schema")


def build(schema: type[Schema], raw: Any, where: str = "") -> Schema:
    """Fills a dataclass or another type from plain data, which must be what the type declares.

    Nothing is converted, except that a whole number may stand for any number and a list for a
    tuple. A dataclass takes the keys of its fields and no others; a TypedDict leaves others out.

    Raises:
        InputError: the data does not fit; after ``where`` the message names the key, what was
            expected and what was found.
    """
    try:
        return cast(Schema, taken(raw, schema))
    except InputError as error:
        raise InputError(f"{_prefix(where)}{error}") from None


def build_json(schema: type[Schema], text: str | bytes, where: str = "") -> Schema:
    """Fills a schema from JSON text, as :func:`build` does from plain data; raises InputError."""
    try:
        raw = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{_prefix(where)}expected JSON: {error}") from None
    return build(schema, raw, where)


class Meets(NamedTuple):
    """A condition on a value and, in words, what is expected: ``Annotated[str, Meets(…)]``."""

    holds: Callable[[Any], object]
    expected: str


def between(least: float, most: float) -> Meets:
    """The condition that a number is in a range, both ends included."""
    return Meets(lambda value: least <= value <= most, f"a number from {least:g} to {most:g}")


def taken(value: Any, hint: Any) -> Any:
    """A value, in plain data, NumPy's numbers or paths, as its type has it."""
    if hasattr(value, "tolist"):  # NumPy's
        value = value.tolist()
    forms = _forms(hint)
    fitting = [form for form in forms if form.fits(value)]
    if len(fitting) > 1 and (isinstance(value, Mapping) or is_dataclass(value)):
        given = value if isinstance(value, Mapping) else [f.name for f in fields(value)]
        fitting = [form for form in fitting if form.keys <= set(given)] or fitting
    if fitting:
        return fitting[0].take(value)
    *words, last = dict.fromkeys(form.words for form in forms)
    expected = f"{', '.join(words)} or {last}" if words else last
    new = RENAMED_VALUES.get(value) if isinstance(value, str) else None
    renamed = f", which is now {new}" if new and re.search(rf"\b{new}\b", expected) else ""
    raise InputError(f"expected {expected}, found {_shown(value)}{renamed}")


class _Form(NamedTuple):
    """What a type takes: in words; whether a value may be one; the value as the type has it."""

    words: str
    fits: Callable[[Any], object]
    take: Callable[[Any], Any]
    keys: frozenset[str] = frozenset()  # of a schema: those without a default


def _text(value: str | os.PathLike[str]) -> str:
    text = os.fspath(value)
    if not text.isascii() and any("\ud800" <= character <= "\udfff" for character in text):
        raise InputError(f"expected text in UTF-8, found {_shown(text)}")
    return text


def _is_number(value: Any) -> bool:
    """Whether a value is a finite number that a float can hold."""
    try:
        return not isinstance(value, bool | str) and math.isfinite(value)
    except (TypeError, OverflowError):
        return False


_PLAIN: dict[Any, _Form] = {
    bool: _Form("true or false", lambda v: isinstance(v, bool), bool),
    int: _Form(
        "a whole number",
        lambda v: hasattr(v, "__index__") and not isinstance(v, bool),
        operator.index,
    ),
    float: _Form("a number", lambda v: _is_number(v), float),
    str: _Form("a text", lambda v: isinstance(v, str | os.PathLike), _text),
    NoneType: _Form("null", lambda v: v is None, lambda v: v),
}


_FEW = 5  # with fewer keys than so many, a message names all keys of a mapping


@functools.cache
def _forms(hint: Any) -> tuple[_Form, ...]:
    """What a type, or each part of a union, takes."""
    if get_origin(hint) is NotRequired:
        (hint,) = get_args(hint)
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return tuple(map(_form, kinds))


def _form(kind: Any) -> _Form:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _form(inner[0])._replace(take=functools.partial(_met, inner[0], inner[1:]))
    if origin is Literal:
        known = f"one of {', '.join(inner)}"
        return _Form(known, lambda v: isinstance(v, str) and v in inner, lambda v: v)
    if origin in (tuple, list):
        take = functools.partial(_sequence, origin, inner)
        return _Form("a list", lambda v: isinstance(v, list | tuple), take)
    if origin is dict:
        take = functools.partial(_mapping, inner[1])
        return _Form("a mapping", lambda v: isinstance(v, Mapping), take)
    if is_dataclass(kind) or hasattr(kind, "__required_keys__"):  # or a TypedDict
        take, keys = functools.partial(_record, kind), list(hints_of(kind))
        words = f"a mapping of {', '.join(keys)}" if len(keys) < _FEW else "a mapping"
        fits = lambda v: isinstance(v, Mapping) or is_dataclass(type(v))  # noqa: E731
        return _Form(words, fits, take, frozenset(_required(kind)))
    return _PLAIN.get(kind, _Form("a value", lambda _: True, lambda v: v))


def _met(hint: Any, conditions: Sequence[Meets], value: Any) -> Any:
    found = taken(value, hint)
    for holds, expected in conditions:
        if not holds(found):
            raise InputError(f"expected {expected}, found {_shown(value)}")
    return found


def _sequence(origin: Any, inner: tuple[Any, ...], value: Sequence[Any]) -> Any:
    hints = inner if origin is tuple and inner[-1] is not ... else inner[:1] * len(value)
    if len(hints) != len(value):
        raise InputError(f"expected {len(hints)} values, found {len(value)}")
    return origin(of_key(i, *pair) for i, pair in enumerate(zip(value, hints, strict=True)))


def _mapping(hint: Any, value: Mapping[Any, Any]) -> dict[str, Any]:
    return {str(key): of_key(key, one, hint) for key, one in value.items()}


def _record(kind: Any, value: Any) -> Any:
    """A dataclass or a TypedDict from a mapping."""
    if is_dataclass(value):
        if isinstance(value, kind):
            return value
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    hints, required = hints_of(kind), _required(kind)
    if is_dataclass(kind):
        for key in value:
            if key not in hints:
                raise InputError(unknown_key(str(key), list(hints)))
        for f in fields(kind):
            none = f.name in value and value[f.name] is None
            check(f.name, not ("kind" in f.metadata and none), f"{_COMPONENT}, found null")
    for name in required:
        if name not in value:
            raise InputError(f"{name}: expected a value, found none")
    given = {key: of_key(key, value[key], hint) for key, hint in hints.items() if key in value}
    try:
        return kind(**given)
    except InputError as error:
        key = str(error).partition(": expected ")[0]
        if key not in given or ", found " in str(error):
            raise
        raise InputError(f"{error}, found {_shown(value[key])}") from None


@functools.cache
def _required(kind: Any) -> list[str]:
    """The keys without a default."""
    if not is_dataclass(kind):
        return [name for name in hints_of(kind) if name in kind.__required_keys__]
    kept = (f for f in fields(kind) if f.init and f.default is f.default_factory is MISSING)
    return [f.name for f in kept]


def of_key(key: object, value: Any, hint: Any) -> Any:
    """The value of a key, or an error that begins with the key."""
    try:
        return taken(value, hint)
    except InputError as error:
        raise under(str(key), error) from None


def under(key: str, error: InputError) -> InputError:
    """An error about what a key holds, as one that begins with the key."""
    join = "" if not key else ": " if str(error).startswith("expected ") else "."
    return InputError(f"{key}{join}{error}")


@functools.cache
def hints_of(kind: Any) -> dict[str, Any]:
    """The types of the fields that a dataclass or a TypedDict is made with."""
    hints = _type_hints(kind)
    return (
        {f.name: hints.get(f.name, Any) for f in _made_with(kind)} if is_dataclass(kind) else hints
    )


def _type_hints(annotated: Any) -> dict[str, Any]:
    """Its types by name; none if it names types that exist for type checkers only."""
    try:
        return get_type_hints(annotated, include_extras=True)
    except NameError:
        return {}


def _made_with(schema: Any) -> list[dataclasses.Field[Any]]:
    """The fields that a dataclass is made with."""
    return [f for f in fields(schema) if f.init]


def _is_schema(cls: type[Any]) -> bool:
    """Whether a class is a dataclass that is made with its fields and nothing else."""
    if not is_dataclass(cls):
        return False
    # A plain subclass of one may have a constructor; an InitVar is no field.
    return set(inspect.signature(cls).parameters) == {f.name for f in _made_with(cls)}


def attributes(kind: type[Any]) -> dict[str, str]:
    """What the section Attributes of a docstring says, by name, each in one line."""
    section = inspect.cleandoc(vars(kind).get("__doc__") or "").partition("Attributes:\n")[2]
    entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", section.split("\n\n")[0], re.MULTILINE)
    return {name: " ".join(text.replace("``", "`").split()) for name, text in entries}


def _shown(value: Any) -> str:
    return repr(value)[:200]


def _prefix(where: str) -> str:
    return f"{where}: " if where else ""


# --- components -----------------------------------------------------------------------------------

_COMPONENT = "a name, a mapping with kind, or an object in Python"

_CONTEXT = {"network": 2, "learner": 1}
"""The number of arguments that the constructor of a component gets before its options."""


class Component(NamedTuple):
    """A component that a configuration names, before it is made; see :func:`take_components`."""

    kind: str  # one of :data:`marouting.registry.KINDS`
    name: str  # a registered name or ``module:Class``
    cls: type[Any]  # the class
    options: Any  # checked: the component, its class's ``Options`` or keyword arguments
    given: bool = False  # whether the component was given as an object

    def make(self, *context: Any) -> Any:
        """Makes the component with what its kind needs: a network's shapes, a learner's Setup."""
        if self.given:
            return self.options
        if isinstance(self.options, Mapping):
            return self.cls(*context, **self.options)
        if isinstance(self.options, self.cls):
            return dataclasses.replace(self.options)
        return self.cls(*context, self.options)


def component_field(kind: str, name: str | None = None, **options: Any) -> Any:
    """A field of a schema that holds a component, by default that of a name with these options."""
    return field(default=None, metadata={"kind": kind, "name": name, "options": options})


def take_components(options: Any) -> None:
    """Replaces names, mappings and objects in the component fields of a schema by components.

    A schema's ``__post_init__`` calls this.
    """
    for f in fields(options):
        if "kind" in f.metadata:
            kind, name = f.metadata["kind"], f.metadata["name"]
            value = getattr(options, f.name)
            value = f.metadata["options"] if value is None else value
            if isinstance(value, str) and ":" in value and f.name != kind:
                # Elsewhere code_named would not find it.
                raise InputError(f"{f.name}: expected a mapping with kind, found {value!r}")
            object.__setattr__(options, f.name, component(kind, value, name, f.name))


def component(kind: str, raw: Any, default: str | None = None, where: str = "") -> Component:
    """Turns the value of a configuration or an argument into a component.

    Args:
        kind: one of :data:`marouting.registry.KINDS`.
        raw: a name or ``module:Class``; a mapping with ``kind`` and options; None for the default;
            or the component itself, as an object.
        default: the name if none is given; None: the first one registered.
        where: the start of error messages.
    """
    if isinstance(raw, Component):
        return raw
    if isinstance(raw, bool | int | float | list | tuple | type):
        raise InputError(f"{_prefix(where)}expected {_COMPONENT}, found {raw!r}")
    if raw is not None and not isinstance(raw, str | Mapping):
        return Component(kind, name_of(kind, type(raw)), type(raw), raw, given=True)
    plainly: dict[str, Any] = {"kind": raw} if isinstance(raw, str) else dict(raw or {})
    name = plainly.pop("kind", default or names(kind)[0])
    if not isinstance(name, str) or not name:
        raise under(where, InputError(f"kind: expected a name, found {name!r}"))
    cls = lookup(kind, name, where)
    schema, varied = _options_of(kind, cast(Any, cls))
    known = [f.name for f in _made_with(schema)]
    others = {key: plainly.pop(key) for key in list(plainly) if varied and key not in known}
    try:
        for key in plainly:
            if key not in known:
                raise InputError(unknown_key(str(key), known, f"the {kind} {name}", ("kind",)))
        options = build(schema, plainly)
    except InputError as error:
        raise under(where, error) from None
    if schema.__name__ == _KEYWORDS:
        return Component(kind, name, cls, {key: getattr(options, key) for key in known} | others)
    return Component(kind, name, cls, options)


_KEYWORDS = "Keywords"


@functools.cache
def _options_of(kind: str, cls: type[Any]) -> tuple[type[Any], bool]:
    """The dataclass of a class's options, and whether the class accepts other options too."""
    if _is_schema(cls):
        return cls, False
    options = getattr(cls, "Options", None)
    if isinstance(options, type) and is_dataclass(options):
        return options, False
    try:
        parameters = list(inspect.signature(cls).parameters.values())
    except (TypeError, ValueError):
        return dataclasses.make_dataclass(_KEYWORDS, []), True
    hints, declared = _type_hints(cls.__init__), list[Any]()
    for parameter in parameters[_CONTEXT.get(kind, 0) :]:
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        hint = hints.get(parameter.name, Any)
        hint = hint.type if isinstance(hint, dataclasses.InitVar) else hint
        if parameter.default is parameter.empty:
            declared.append((parameter.name, hint))
        else:
            # A factory, because a default may be a list.
            default = field(default_factory=functools.partial(_same, parameter.default))
            declared.append((parameter.name, hint, default))
    varied = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
    return dataclasses.make_dataclass(_KEYWORDS, declared, kw_only=True), varied


def _same(value: Any) -> Any:
    return value


def plain(value: Any) -> Any:
    """A configuration as plain data, such as YAML and JSON hold.

    A component becomes a mapping of its options, with its name under ``kind``.
    """
    if isinstance(value, Component):
        options = value.options
        if value.given and not _is_schema(value.cls):
            raise InputError(
                f"{value.kind}: expected a name or module:Class with its options, which can be "
                f"written to a file; found an object of {value.name}"
            )
        return {"kind": value.name, **plain(options)}
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in _made_with(value)}
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if hasattr(value, "tolist"):  # NumPy's
        return value.tolist()
    return os.fspath(value) if isinstance(value, os.PathLike) else value


# --- code that files name ------------------------------------------------------------------------

Keys = tuple[str, ...]  # the keys that lead to a value


def code_named(data: Any, above: Keys = ()) -> Iterator[tuple[Keys, str]]:
    """Every ``module:Class`` in the data, with the keys that lead to it.

    Names of components are under the key ``kind``, or under that of their kind, such as ``reward``;
    those of scenarios under ``scenario``.
    """
    if isinstance(data, Component):
        if ":" in data.name:
            yield (*above, "kind"), data.name
        data = data.options
    if is_dataclass(data) and not isinstance(data, type):
        data = {f.name: getattr(data, f.name) for f in fields(data)}
    inner: Any = ()
    if isinstance(data, Mapping):
        inner = data.items()
    elif isinstance(data, list | tuple):
        inner = enumerate(data)
    for key, value in inner:
        keys = (*above, str(key))
        if isinstance(value, str):
            if ":" in value and key in ("kind", "scenario", *KINDS):
                yield keys, value
        else:
            yield from code_named(value, keys)


def allowing_code_of(data: Any) -> AbstractContextManager[None]:
    """Within the block, files may also name the classes that the data names."""
    return allowing_code(name for _, name in code_named(data))


def check_code(data: Any, file: str, lines: Mapping[Keys, int] | None = None) -> None:
    """Raises InputError if a file names a ``module:Class`` that is not allowed.

    Every reader of files that can name components calls this first.
    """
    allowed = code_allowed()
    for keys, name in () if allowed is True else code_named(data):
        if not allowed or name not in cast(frozenset[str], allowed):
            at = next(
                (keys[:n] for n in range(len(keys), 0, -1) if keys[:n] in (lines or {})), None
            )
            line = "" if at is None or lines is None else f":{lines[at]}"
            raise InputError(
                f"{file}{line}: {'.'.join(keys)}: found code, {name}; pass --allow-code if you "
                "trust it (allow_code=True in Python)"
            )
