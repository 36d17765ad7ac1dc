"""From plain data to checked options: YAML, dataclasses as schemas, and pieces by name.

A dataclass defines the keys of a configuration, their types and their defaults, which are found
nowhere else. Types are checked strictly. For an unknown key, the error message suggests the nearest
known one.

A **piece** is a part that users may write themselves. A configuration refers to it by its name in
:mod:`marouting.registry`::

    reward: {kind: paper, reached: 10}
    reward: {kind: "my_package.rewards:Selfless", share: 0.5}

The options of a piece are the fields of its class if that is a dataclass, the fields of its nested
dataclass ``Options`` if it has one, and the keyword parameters of its constructor otherwise.
"""

import dataclasses
import difflib
import functools
import inspect
import json
import math
import operator
import os
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    NoReturn,
    NotRequired,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import yaml

from marouting.errors import InputError
from marouting.files import exists, is_file, read_text
from marouting.registry import KINDS, allowing_code, code_allowed, lookup, name_of, names

MOST = 2**31 - 1
"""The largest count; compiled code and arrays do not support integers of arbitrary size."""


MOST_TEXT = 2**24  # the largest YAML file, in bytes
MOST_VALUES = 100_000
"""The largest number of values in YAML text; an alias counts as all that it stands for."""

DEEPEST = 50  # how deep they may be nested


class _Loader(yaml.SafeLoader):
    """The safe loader with YAML 1.2's numbers, and with bounds.

    ``1e-4`` is a number and not a string, ``1:30`` is a string and not 90, ``010`` is 10 and not 8.
    A key may occur only once in a mapping. A few aliases of aliases can stand for more values than
    fit in memory, so they are counted before anything is made of them.
    """

    def compose_document(self) -> yaml.Node | None:
        """A document as written, if it is not too large."""
        self._sizes: dict[yaml.Node, int] = {}
        self._depth = 0
        return super().compose_document()

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        """A value as written, or the one that an alias stands for."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        self._depth += 1
        if self._depth > DEEPEST:
            self._refuse(f"values are nested more than {DEEPEST} deep", mark)
        node: Any = super().compose_node(parent, index)
        self._depth -= 1
        if node not in self._sizes:
            if isinstance(event, yaml.AliasEvent):
                self._refuse("a value contains itself", mark)
            inner: list[Any] = []
            if isinstance(node, yaml.MappingNode):
                inner = [part for pair in node.value for part in pair]
            elif isinstance(node, yaml.SequenceNode):
                inner = node.value
            elif "\0" in node.value:
                self._refuse("a text contains the character NUL", mark)
            self._sizes[node] = 1 + sum(self._sizes[part] for part in inner)
        if self._sizes[node] > MOST_VALUES:
            self._refuse(f"there are more than {MOST_VALUES} values", mark)
        return cast(yaml.Node, node)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """A mapping as written, before anything is merged into it."""
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                self._refuse(f"the key {key.value} occurs twice", key.start_mark)
            seen.add(key.value)
        return node

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        """``10``, ``-010``, ``0o17`` or ``0x1f``."""
        text = node.value
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))

    @staticmethod
    def _refuse(problem: str, mark: Any) -> NoReturn:
        raise yaml.composer.ComposerError(None, None, problem, mark)


_Loader.yaml_implicit_resolvers = {
    first: [rule for rule in rules if not rule[0].endswith((":int", ":float", ":timestamp"))]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int",
    re.compile(r"^[-+]?[0-9]+$|^0o[0-7]+$|^0x[0-9a-fA-F]+$"),
    list("-+0123456789"),
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$"
        r"|^[-+]?\.(inf|Inf|INF)$|^\.(nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_integer)


class _Dumper(yaml.SafeDumper):
    """The safe dumper, which quotes all text that would be a number by either version of YAML."""


_Dumper.yaml_implicit_resolvers = {
    first: [*_Loader.yaml_implicit_resolvers.get(first, []), *rules]
    for first, rules in yaml.SafeDumper.yaml_implicit_resolvers.items()
}


def yaml_text(data: Mapping[str, Any]) -> str:
    """YAML text that :func:`parse_yaml` reads as the same plain data."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False)
    return text


def yaml_line(value: Any) -> str:
    """A value, or a key, as YAML in a single line."""
    # In a list, where a text alone would be followed by the end of a document.
    text: str = yaml.dump(
        [value], Dumper=_Dumper, sort_keys=False, default_flow_style=True, width=MOST
    )
    return text.strip()[1:-1]


def parse_yaml(text: str, name: str) -> Any:
    """Plain data from YAML text; raises InputError with ``name`` and the line."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark and not name.endswith(text) else ""  # key=value has none
        raise InputError(f"{name}{line}: expected YAML: {error.problem}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = (str(error).splitlines() or ["it cannot be read"])[0]
        raise InputError(f"{name}: expected YAML: {reason}") from None
    except (LookupError, AttributeError):
        # PyYAML raises these for values like `!!bool perhaps` or `!!int ""`.
        raise InputError(f"{name}: expected YAML: a value does not fit its tag") from None


def config_file(path: str | os.PathLike[str]) -> Path:
    """The file that the path of a configuration names.

    ``configs/paper/default.yaml`` and the others that the package brings are found in any working
    directory; files that are there come first.
    """
    found, here = Path(path), Path(__file__).parent
    if found.parts[:1] != ("configs",) or exists(found):
        return found
    # In an installed package they lie inside it, in a checkout beside it.
    shipped = (here / found, here.parent / found)
    return next((file for file in shipped if is_file(file)), found)


INCLUDE = "include"  # the key of a YAML file that names one or more files to begin from
_MOST_FILES = 100  # the largest number of files that one begins from
Keys = tuple[str, ...]  # the keys that lead to a value


@dataclass(frozen=True)
class _File:
    """A file of a configuration: its name for messages, what it says, and on which lines."""

    name: str
    data: dict[str, Any]
    lines: dict[Keys, int]


def code_named(data: Any, above: Keys = ()) -> Iterator[tuple[Keys, str]]:
    """Every ``module:Class`` in the data, with the keys that lead to it.

    Names of pieces are under the key ``kind``, or under that of their kind, such as ``reward``;
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

    Every reader of files that can name pieces calls this first.
    """
    allowed = code_allowed()
    for keys, name in () if allowed is True else code_named(data):
        if not allowed or name not in cast(frozenset[str], allowed):
            at = next(
                (keys[:n] for n in range(len(keys), 0, -1) if keys[:n] in (lines or {})), None
            )
            line = "" if at is None or lines is None else f":{lines[at]}"
            raise InputError(
                f"{file}{line}: {'.'.join(keys)}: found code, {name}; pass --allow-code to import "
                "it (allow_code=True in Python)"
            )


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The mapping in a YAML file, merged with those that it includes.

    Files that name a ``module:Class`` are refused unless it is allowed
    (:func:`marouting.registry.allowing_code`).

    The key ``include`` names a file, or a list of files: paths relative to the including file, or
    files of the package (``configs/…``). Values of a file replace those of the files that it
    includes, and later files in a list replace earlier ones (:func:`merged`).
    """
    whole: dict[str, Any] = {}
    for file in _files(path):
        whole = merged(whole, file.data)
    return whole


def origins_of(path: str | os.PathLike[str]) -> dict[Keys, tuple[str, int]]:
    """The file and line of every value that :func:`read_yaml` reads, by the keys to it."""
    files = _files(path)
    whole: dict[str, Any] = {}
    for file in files:
        whole = merged(whole, file.data)
    # A value is from the last file that has one there.
    lines = {keys: (file.name, line) for file in files for keys, line in file.lines.items()}
    return {keys: lines[keys] for keys, _ in leaves(whole) if keys in lines}


_INSTEAD = {"scenario": ("problem",), "problem": ("scenario", "split")}
"""For each key, the keys that it replaces."""


def merged(raw: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data in which the values of ``more`` replace those of ``raw``, at any depth.

    A mapping with another ``kind`` replaces the whole mapping, options included. A scenario
    replaces a problem, and vice versa.
    """
    instead = {old for key in more if more[key] is not None for old in _INSTEAD.get(key, ())}
    result = {key: value for key, value in raw.items() if key not in instead}
    for key, value in more.items():
        inner = result.get(key)
        if isinstance(inner, str) and key in KINDS:
            inner = {"kind": inner}
        result[key] = value
        if isinstance(inner, Mapping) and isinstance(value, Mapping):
            kind = inner.get("kind")
            result[key] = merged(inner, value) if value.get("kind", kind) == kind else value
    return result


def leaves(data: Mapping[str, Any], above: Keys = ()) -> Iterator[tuple[Keys, Any]]:
    """Every value that is not itself a mapping with keys, and the keys that lead to it."""
    for key, value in data.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, (*above, str(key)))
        else:
            yield (*above, str(key)), value


def _files(path: str | os.PathLike[str]) -> list[_File]:
    """A YAML file after all those that it includes, in the order in which they are merged."""
    found: list[_File] = []

    def read(name: str, file: Path, above: tuple[Path, ...]) -> None:
        text = read_text(file, MOST_TEXT)
        data = parse_yaml(text, name)
        data = {} if data is None else data
        if not isinstance(data, dict):
            raise InputError(f"{name}: expected a mapping of keys to values")
        lines = _lines(text)
        given = data.pop(INCLUDE, [])
        included = [given] if isinstance(given, str) else given
        place = f"{name}:{lines.get((INCLUDE,), 1)}: {INCLUDE}"
        lines = {keys: line for keys, line in lines.items() if keys[0] != INCLUDE}
        if not isinstance(included, list) or not all(isinstance(one, str) for one in included):
            raise InputError(f"{place}: expected a file or a list of files, found {given!r}")
        here = (*above, file.resolve())
        for one in included:
            inner, shown = file.parent / one, os.path.normpath(Path(name).parent / one)
            if not exists(inner) and Path(one).parts[:1] == ("configs",):
                inner, shown = config_file(one), one
            if not one or not is_file(inner):
                raise InputError(f"{place}: expected a file, found none at {shown}")
            if inner.resolve() in here:
                raise InputError(f"{place}: expected no circular include, found {shown}")
            if len(found) + len(here) >= _MOST_FILES:
                raise InputError(f"{place}: expected at most {_MOST_FILES} files in all")
            read(shown, inner, here)
        check_code(data, name, lines)
        found.append(_File(name, data, lines))

    read(os.fspath(path), config_file(path), ())
    return found


def _lines(text: str) -> dict[Keys, int]:
    """The line, from 1, of every value in YAML text that :func:`parse_yaml` reads."""
    lines: dict[Keys, int] = {}

    def walk(node: yaml.Node | None, above: Keys, line: int) -> None:
        if not isinstance(node, yaml.MappingNode) or not node.value:
            lines[above] = line
            return
        loader.flatten_mapping(node)
        for key, value in node.value:
            walk(value, (*above, key.value), key.start_mark.line + 1)

    loader = _Loader(text)
    root = loader.get_single_node()
    if isinstance(root, yaml.MappingNode) and root.value:
        walk(root, (), 1)
    return lines


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
    hint = f", which is now {new}" if new and re.search(rf"\b{new}\b", expected) else ""
    raise InputError(f"expected {expected}, found {_shown(value)}{hint}")


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
            check(f.name, not ("kind" in f.metadata and none), f"{_PIECE}, found null")
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


# --- pieces ---------------------------------------------------------------------------------------

_PIECE = "a name, a mapping with kind, or an object in Python"

_CONTEXT = {"network": 2, "learner": 1}
"""The number of arguments that the constructor of a piece gets before its options."""


class Component(NamedTuple):
    """A piece that a configuration names, before it is made."""

    kind: str  # one of :data:`marouting.registry.KINDS`
    name: str  # a registered name or ``module:Class``
    cls: type[Any]  # the class
    options: Any  # checked: the piece, its class's ``Options`` or keyword arguments
    given: bool = False  # whether the piece was given as an object

    def make(self, *context: Any) -> Any:
        """Makes the piece with what its kind needs: a network's shapes, a learner's Setup."""
        if self.given:
            return self.options
        if isinstance(self.options, Mapping):
            return self.cls(*context, **self.options)
        if isinstance(self.options, self.cls):
            return dataclasses.replace(self.options)
        return self.cls(*context, self.options)


Named = Component
"""The type of a field that holds a piece; :func:`take_pieces` turns its value into one."""


def piece_field(kind: str, name: str | None = None, **options: Any) -> Any:
    """A field of a schema that holds a piece, by default that of a name with these options."""
    return field(default=None, metadata={"kind": kind, "name": name, "options": options})


def take_pieces(options: Any) -> None:
    """Replaces names, mappings and objects in the piece fields of a schema by pieces.

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
            object.__setattr__(options, f.name, piece(kind, value, name, f.name))


def piece(kind: str, raw: Any, default: str | None = None, where: str = "") -> Component:
    """Turns the value of a configuration or an argument into a piece.

    Args:
        kind: one of :data:`marouting.registry.KINDS`.
        raw: a name or ``module:Class``; a mapping with ``kind`` and options; None for the default;
            or the piece itself, as an object.
        default: the name if none is given; None: the first one registered.
        where: the start of error messages.
    """
    if isinstance(raw, Component):
        return raw
    if isinstance(raw, bool | int | float | list | tuple | type):
        raise InputError(f"{_prefix(where)}expected {_PIECE}, found {raw!r}")
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
                raise InputError(unknown_key(str(key), known, f"the {kind} {name}"))
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

    A piece becomes a mapping of its options, with its name under ``kind``.
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


# --- changes and checks ---------------------------------------------------------------------------


def check(name: str, holds: object, expected: str) -> None:
    """Raises InputError, ``name: expected …``, if a condition does not hold."""
    if not holds:
        raise InputError(f"{name}: expected {expected}")


def override(raw: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Plain data with single keys changed; see :func:`merged`.

    Args:
        raw: plain data, as from YAML.
        overrides: ``key=value``, with dots between the parts of a key and the value as in YAML. A
            mapping replaces the whole of one, and the name of a piece all of its options. Keys of
            what is replaced may be given as well, in any order: ``reward.step=-1 reward=paper``. Of
            values for the same key the last one counts.

    Raises:
        InputError: a text is not such, or a key has both keys of its own and a value without keys.
    """
    changed, given = dict(raw), dict[str, Any]()
    for text in sorted(overrides, key=lambda text: text.partition("=")[0].count(".")):
        key, equals, written = text.partition("=")
        if not equals or not key:
            raise InputError(f"{text}: expected key=value")
        value = parse_yaml(written, text)
        *parts, last = key.split(".")
        place = given
        for part in parts:
            inner = place.get(part, {})
            if isinstance(inner, str) and part in KINDS:
                inner = {"kind": inner}
            check(text, isinstance(inner, dict), f"{part} to have keys, found {inner!r}")
            place[part] = place = inner
        place[last] = value
        if isinstance(value, Mapping) or (isinstance(value, str) and last in KINDS):
            alone: dict[str, Any] = {last: None}
            for part in reversed(parts):
                alone = {part: alone}
            changed = merged(changed, alone)
    return merged(changed, given)


def check_same(mine: Mapping[str, Any], kept: Mapping[str, Any], where: Path) -> None:
    """Raises InputError, naming the key, if two configurations in plain data differ."""
    found, expected = ({".".join(keys): v for keys, v in leaves(plain(c))} for c in (mine, kept))
    # Some keys may be in only one of them, such as those of a problem's files or its generator.
    for key in dict.fromkeys((*expected, *found)):
        if expected.get(key) != found.get(key):
            raise InputError(
                f"{key}: expected {_in_yaml(expected.get(key))}, as in {where}, "
                f"found {_in_yaml(found.get(key))}"
            )


def _in_yaml(value: Any) -> str:
    """A value as messages about files show it."""
    return json.dumps(value) if value is None or isinstance(value, bool) else repr(value)


def _prefix(where: str) -> str:
    return f"{where}: " if where else ""


_LISTED = 280  # the most characters of a list of known keys


RENAMED_VALUES = {"chance": "random", "own": "local", "price": "history", "ways": "greedy"}
"""Values of options before version 0.3, and what they are called now."""

_PRICES = "train.negotiation of a training: only the generalist negotiates by prices"

RENAMED = {
    "rip_up_calm": _PRICES,
    "rip_up_patience": _PRICES,
    "rip_up_present": _PRICES,
    "rip_up_prices": _PRICES,
    "copies": "num_envs",
    "give_back": "release_failed",
    "helped": "expert_moves",
    "mind": "policy: network, greedy or random",
    "next_task": "next_pin",
    "taught": "expert_fraction",
    "warmth": "temperature",
    "net_order": "nets: {order: …}",
    "decomposition": "nets: {decomposition: …}",
    "mask_visited": "mask: {visited: …}",
    "mask_in_observation": "mask: {in_observation: …}",
    "observation_key": "mask: {observation_key: …}",
    "mask_key": "mask: {mask_key: …}",
    "rip_up_rounds": "rip_up: {rounds: …}",
    "rip_up_neighbours": "rip_up: {neighbours: …}",
    "present": "present_factor",
    "growth": "present_growth",
    "history": "history_increment",
    "decay": "history_decay",
    "calm": "step_decay",
    "stuck": "stall_passes",
    "least_fall": "min_overflow_drop",
    "least_gain": "min_wirelength_gain",
    "again": "reroute_fraction",
    "probe": "lp_after_pass",
    "priced": "lp_passes",
    "worth": "lp_price_scale",
    "patience": "repair_after",
    "worse": "overflow_stall_weight",
    "repairs": "repair_stall_passes",
    "least_repaired": "min_repair_fraction",
    "persistence": "patience_factor",
}
"""Names that keys had before version 0.3, and what they are called now."""

REMOVED = {
    "importance_exponent": "prioritised replay",
    "n_step": "returns of n steps",
    "prioritised": "prioritised replay",
    "priority_exponent": "prioritised replay",
}
"""Keys that version 0.3 removed without a replacement, and what they were for."""


def unknown_key(key: str, known: Sequence[str], of: str = "") -> str:
    """The message about a key that is not one of those known, perhaps of a piece."""
    name = key.rpartition(".")[2]
    new = RENAMED.get(name)
    if new and (new == _PRICES or new.partition(":")[0] in known):
        return f"{key}: unknown key; it is now {new}"
    if name in REMOVED:
        return f"{key}: unknown key; version 0.3 removed {REMOVED[name]}"
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    # What follows must not lie in the middle of a long message, which is left out.
    listed = textwrap.shorten(", ".join(known), _LISTED, placeholder=" …")
    listed = (f"one of {listed}" if known else "none") + (f" for {of}" if of else "")
    expected = f"did you mean {close[0]}?" if close else f"expected {listed}"
    return f"{key}: unknown key; {expected}"
