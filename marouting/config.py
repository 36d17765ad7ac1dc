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

import contextlib
import dataclasses
import difflib
import functools
import inspect
import json
import math
import os
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NoReturn,
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
from marouting.registry import KINDS, code_allowed, lookup, name_of, names

if TYPE_CHECKING:
    from pydantic import TypeAdapter, ValidationError

# Pydantic takes a tenth of a second to import. What plainly fits a schema is taken without it; it
# judges the rest, and knows what to say (:func:`build`).

MOST = 2**31 - 1
"""The largest count; compiled code and arrays do not support integers of arbitrary size."""


MOST_TEXT = 2**24
"""The largest YAML file, in bytes."""

MOST_VALUES = 100_000
"""The largest number of values in YAML text; an alias counts as all that it stands for."""

DEEPEST = 50
"""How deep they may be nested."""


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
        line = f":{mark.line + 1}" if mark else ""
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


INCLUDE = "include"
"""The key of a YAML file that names one or more files to begin from."""

_MOST_FILES = 100
"""The largest number of files that one begins from."""

Keys = tuple[str, ...]
"""The keys that lead to a value."""


@dataclass(frozen=True)
class _File:
    """A file of a configuration: its name for messages, what it says, and on which lines."""

    name: str
    data: dict[str, Any]
    lines: dict[Keys, int]


def code_named(data: Any, above: Keys = ()) -> Iterator[tuple[Keys, str]]:
    """The pieces that data calls by ``module:Class``, which is code, and the keys that lead there.

    Names of pieces stand under the key ``kind``, or under that of their kind, such as ``reward``.

    Args:
        data: plain data, or a configuration that is made of it.
        above: the keys that lead to the data.
    """
    if isinstance(data, Piece):
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
            if ":" in value and key in ("kind", *KINDS):
                yield keys, value
        else:
            yield from code_named(value, keys)


def check_code(data: Any, file: str, lines: Mapping[Keys, int] | None = None) -> None:
    """Raises InputError if a file names code that files may not name here.

    What reads a file in which names of pieces can stand calls this before it makes anything of it.

    Args:
        data: what the file holds.
        file: its name.
        lines: where its values stand, if it has lines.
    """
    allowed = code_allowed()
    for keys, name in () if allowed is True else code_named(data):
        if not allowed or name not in cast(frozenset[str], allowed):
            at = next(
                (keys[:n] for n in range(len(keys), 0, -1) if keys[:n] in (lines or {})), None
            )
            line = "" if at is None or lines is None else f":{lines[at]}"
            raise InputError(
                f"{file}{line}: {'.'.join(keys)}: names code, {name}; pass --allow-code to import "
                "it (allow_code=True in Python)"
            )


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The mapping in a YAML file, and in those that it includes.

    Where they name code (:func:`code_named`), they are refused unless files may name it here
    (:func:`marouting.registry.allowing_code`).

    The key ``include`` names a file to begin from, or a list of them, each relative to the file
    that includes it, or one of those that the package brings (``configs/…``). What a file says
    replaces what those say that it includes, and later ones in a list replace earlier ones: see
    :func:`merged`.

    Args:
        path: a path as :func:`config_file` takes it.

    Raises:
        InputError: names the file and the line.
    """
    whole: dict[str, Any] = {}
    for file in _files(path):
        whole = merged(whole, file.data)
    return whole


def origins_of(path: str | os.PathLike[str]) -> dict[Keys, tuple[str, int]]:
    """The file and the line of every value that :func:`read_yaml` reads.

    Args:
        path: a path as :func:`config_file` takes it.

    Returns:
        The file's name and the line, from 1, by the keys that lead to the value; of mappings only
        what is in them.
    """
    files = _files(path)
    whole: dict[str, Any] = {}
    for file in files:
        whole = merged(whole, file.data)
    # A value is from the last file that has one there.
    lines = {keys: (file.name, line) for file in files for keys, line in file.lines.items()}
    return {keys: lines[keys] for keys, _ in leaves(whole) if keys in lines}


def merged(raw: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data in which the values of ``more`` replace those of ``raw``, at any depth.

    A mapping with another ``kind`` replaces all of a mapping: options belong to their piece.
    """
    result = dict(raw)
    for key, value in more.items():
        inner = result.get(key)
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
                raise InputError(f"{place}: expected no circle, found {shown}, which includes it")
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


Schema = TypeVar("Schema")


def build(schema: type[Schema], raw: Mapping[str, Any], where: str = "") -> Schema:
    """Fills a dataclass from plain data, and accepts only its keys and the types that it declares.

    Args:
        schema: the dataclass.
        raw: plain data, as from YAML.
        where: the start of error messages: the file, or the key that leads here.

    Raises:
        InputError: the data does not fit; the message names the key, what was expected and what was
            found.
    """
    try:
        return cast(Schema, _filled(schema, raw))
    except _UnsureError:
        pass
    try:
        # From JSON, a list can become a tuple and an integer a float; nothing else is converted.
        text = json.dumps(raw, default=_jsonable, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        found = error.object[max(0, error.start - 40) : error.end]
        raise InputError(f"{_prefix(where)}expected text in UTF-8, found {found!r}") from None
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{_prefix(where)}expected plain data: {error}") from None
    return build_json(schema, text, where)


def build_json(schema: type[Schema], text: str | bytes, where: str = "") -> Schema:
    """Fills a schema from JSON text, as :func:`build` does from plain data; raises InputError."""
    from pydantic import ValidationError
    from pydantic.errors import PydanticUserError

    try:
        built: Schema = _adapter(cast(Any, schema)).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(_prefix(where) + _explain(schema, error)) from None
    except PydanticUserError as error:
        reason = str(error).splitlines()[0]
        what = f"{_prefix(where)}{schema.__name__} cannot be configured"
        raise InputError(f"{what}: {reason}") from None
    return built


@functools.cache
def _adapter(schema: Any) -> "TypeAdapter[Any]":
    from pydantic import TypeAdapter

    return TypeAdapter(schema)


class _UnsureError(Exception):
    """A value that does not plainly fit: pydantic shall judge it."""


def _filled(schema: Any, raw: Mapping[str, Any]) -> Any:
    """A dataclass filled from plain data that plainly fits; raises _UnsureError for any other."""
    hints = _hints(schema)
    if not isinstance(raw, Mapping) or not all(name in hints for name in raw):
        raise _UnsureError
    values = {name: _taken(value, hints[name]) for name, value in raw.items()}
    try:
        return schema(**values)
    except (InputError, TypeError):
        raise _UnsureError from None


def _taken(value: Any, hint: Any) -> Any:
    """A value that plainly is of a type."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated and isinstance(inner[1], OneOf):
        return _taken(value, inner[1].type_of(value))
    if origin in (Union, UnionType):
        for one in inner:
            with contextlib.suppress(_UnsureError):
                return _taken(value, one)
    elif origin is Literal:
        if isinstance(value, str) and value in inner:
            return value
    elif origin is tuple and isinstance(value, list | tuple):
        if inner[-1] is ...:
            return tuple(_taken(one, inner[0]) for one in value)
        if len(inner) == len(value):
            return tuple(map(_taken, value, inner))
    elif hint is float:
        if type(value) in (int, float) and math.isfinite(value):
            return float(value)
    elif hint is Piece:
        return value
    elif is_dataclass(hint) and isinstance(value, Mapping):
        return _filled(hint, value)
    elif hint is str and isinstance(value, str):
        with contextlib.suppress(UnicodeEncodeError):
            value.encode()  # half a character is no text
            return value
    elif hint in (bool, int, NoneType) and type(value) is hint:
        return value
    raise _UnsureError


@functools.cache
def _hints(schema: Any) -> dict[str, Any]:
    """The types of a schema's fields; none if it is no dataclass."""
    if not is_dataclass(schema):
        return {}
    hints = get_type_hints(schema, include_extras=True)
    return {field.name: hints[field.name] for field in fields(schema) if field.init}


@dataclass(frozen=True, eq=False)
class OneOf:
    """An annotation of a type: it is one of several, and a function tells by the value which.

    Attributes:
        types: the types by their names.
        name_of: gives the name of a value's type.
    """

    types: Mapping[str, Any]
    name_of: Callable[[Any], str]

    def type_of(self, value: Any) -> Any:
        """The type that a value is to be of."""
        return self.types[self.name_of(value)]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Says it in pydantic's words."""
        from pydantic import Discriminator, Tag

        del source
        tagged = tuple(Annotated[kind, Tag(name)] for name, kind in self.types.items())
        return handler.generate_schema(Annotated[Union[tagged], Discriminator(self.name_of)])  # noqa: UP007


def _jsonable(value: Any) -> Any:
    """Converts what JSON does not know: paths, NumPy's numbers, dataclasses, pieces."""
    if isinstance(value, Piece):
        return plain(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"found {value!r}")


# --- pieces ---------------------------------------------------------------------------------------

_CONTEXT = {"network": 2, "learner": 1}
"""The number of arguments that the constructor of a piece gets before its options."""


@dataclass(frozen=True)
class Piece:
    """A piece that a configuration names, before it is made.

    Attributes:
        kind: one of :data:`marouting.registry.KINDS`.
        name: a registered name or ``module:Class``.
        cls: the class.
        options: the checked options, with defaults filled in: the piece itself if its class is a
            dataclass, an instance of the class's ``Options`` if it has one, and keyword arguments
            by name otherwise.
        given: whether the piece was given as an object.
    """

    kind: str
    name: str
    cls: type[Any]
    options: Any
    given: bool = False

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """To pydantic anything may be one: :func:`take_pieces` judges it."""
        from pydantic import PlainValidator

        del source
        return handler.generate_schema(Annotated[Any, PlainValidator(lambda value: value)])

    def make(self, *context: Any) -> Any:
        """Makes the piece.

        Args:
            *context: what its kind needs. A network gets the shape of an observation and the number
                of outputs, a learner its :class:`policies.learned.learner.Setup`.
        """
        if self.given:
            return self.options
        if isinstance(self.options, Mapping):
            return self.cls(*context, **self.options)
        if isinstance(self.options, self.cls):
            return dataclasses.replace(self.options)
        return self.cls(*context, self.options)


Named = Piece
"""The type of a field that holds a piece; :func:`take_pieces` turns its value into one."""


def piece_field(kind: str, name: str | None = None, **options: Any) -> Any:
    """A field of a schema that holds a piece.

    Args:
        kind: one of :data:`marouting.registry.KINDS`.
        name: the default piece; None: the first one registered.
        **options: the options of the default piece that differ from its own defaults.
    """
    return field(default=None, metadata={"kind": kind, "name": name, "options": options})


def take_pieces(options: Any) -> None:
    """Replaces names, mappings and objects in the piece fields of a schema by pieces.

    A schema's ``__post_init__`` calls this.

    Raises:
        InputError: a value is not a piece; the message names the key and what was expected.
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


def piece(kind: str, raw: Any, default: str | None = None, where: str = "") -> Piece:
    """Turns the value of a configuration or an argument into a piece.

    Args:
        kind: one of :data:`marouting.registry.KINDS`.
        raw: a name or ``module:Class``; a mapping with the name under ``kind`` and options under
            all other keys; a :class:`Piece`; None for the default; or the piece itself, as an
            object.
        default: the name if none is given; None: the first one registered.
        where: the start of error messages.

    Raises:
        InputError: the value is not a piece; the message names the key, what was expected and what
            was found.
    """
    if isinstance(raw, Piece):
        return raw
    if isinstance(raw, bool | int | float | list | tuple):
        raise InputError(f"{_prefix(where)}expected a name, a mapping with kind, or a piece")
    if raw is not None and not isinstance(raw, str | Mapping):
        return Piece(kind, name_of(kind, type(raw)), type(raw), raw, given=True)
    plainly: dict[str, Any] = {"kind": raw} if isinstance(raw, str) else dict(raw or {})
    name = plainly.pop("kind", None) or default or names(kind)[0]
    if not isinstance(name, str):
        raise InputError(f"{_prefix(where)}kind: expected a name, found {name!r}")
    cls = lookup(kind, name, where)
    schema, varied = _options_of(kind, cast(Any, cls))
    known = [f.name for f in fields(schema)]
    unknown = [key for key in plainly if key not in known]
    try:
        if unknown and not varied:
            raise InputError(unknown_key(str(unknown[0]), known))
        options = build(schema, {k: v for k, v in plainly.items() if k not in unknown})
    except InputError as error:
        raise InputError(f"{where}.{error}" if where else str(error)) from None
    if schema.__name__ == _KEYWORDS:
        keywords = {key: getattr(options, key) for key in known}
        return Piece(kind, name, cls, keywords | {key: plainly[key] for key in unknown})
    return Piece(kind, name, cls, options)


_KEYWORDS = "Keywords"


@functools.cache
def _options_of(kind: str, cls: type[Any]) -> tuple[type[Any], bool]:
    """The dataclass of a class's options, and whether the class accepts other options too."""
    if "__dataclass_fields__" in vars(cls):  # a plain subclass of one may have a constructor
        return cls, False
    options = getattr(cls, "Options", None)
    if isinstance(options, type) and is_dataclass(options):
        return options, False
    try:
        parameters = list(inspect.signature(cls).parameters.values())
        hints = get_type_hints(cls.__init__, include_extras=True)
    except (TypeError, ValueError, NameError):
        return dataclasses.make_dataclass(_KEYWORDS, []), True
    declared: list[Any] = []
    for parameter in parameters[_CONTEXT.get(kind, 0) :]:
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        hint = hints.get(parameter.name, Any)
        if parameter.default is parameter.empty:
            declared.append((parameter.name, hint))
        else:
            default = field(default_factory=functools.partial(_same, parameter.default))
            declared.append((parameter.name, hint, default))
    varied = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
    return dataclasses.make_dataclass(_KEYWORDS, declared, kw_only=True), varied


def _same(value: Any) -> Any:
    return value


def plain(value: Any) -> Any:
    """A configuration as plain data, such as YAML and JSON hold.

    A piece becomes a mapping of its options, with its name under ``kind``.

    Raises:
        InputError: a piece was given as an object whose options are unknown.
    """
    if isinstance(value, Piece):
        options = value.options
        if value.given and not is_dataclass(options):
            raise InputError(
                f"{value.kind}: expected a name or module:Class with its options, which can be "
                f"written to a file; found an object of {value.name}"
            )
        return {"kind": value.name, **plain(options)}
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return value


# --- changes and checks ---------------------------------------------------------------------------


def check(name: str, holds: object, expected: str) -> None:
    """Raises InputError, ``name: expected …``, if a condition does not hold."""
    if not holds:
        raise InputError(f"{name}: expected {expected}")


def override(raw: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Plain data with single keys changed.

    Args:
        raw: plain data, as from YAML.
        overrides: ``key=value``, with dots between the parts of a key and the value as in YAML.

    Raises:
        InputError: an override does not have this form.
    """
    changed = dict(raw)
    for given in overrides:
        key, equals, value = given.partition("=")
        if not equals or not key:
            raise InputError(f"{given}: expected key=value")
        *parts, last = key.split(".")
        place = changed
        for part in parts:
            inner = place.get(part)
            # A copy, because YAML's anchors can put one mapping in several places.
            place[part] = dict(inner) if isinstance(inner, Mapping) else {}
            place = place[part]
        place[last] = parse_yaml(value, given)
    return changed


def check_same(mine: Mapping[str, Any], kept: Mapping[str, Any], where: Path) -> None:
    """Raises InputError, naming the key, if two configurations in plain data differ.

    Args:
        mine: the present configuration.
        kept: the configuration at the start.
        where: the file that holds it.
    """
    found, expected = _flat(mine), _flat(kept)
    # Some keys may be in only one of them, such as those of a problem's files or its generator.
    for key in dict.fromkeys((*expected, *found)):
        if expected.get(key) != found.get(key):
            raise InputError(
                f"{key}: expected {expected.get(key)!r}, as in {where}, found {found.get(key)!r}"
            )


def _flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flattens nested mappings, with keys joined by dots and sequences as tuples."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            flat[prefix + key] = tuple(value)
        else:
            flat[prefix + key] = value
    return flat


def _prefix(where: str) -> str:
    return f"{where}: " if where else ""


_LISTED = 280
"""The most characters of a list of known keys."""


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
    "rip_up_rounds": "rip_up: {rounds: …}",
    "rip_up_neighbours": "rip_up: {neighbours: …}",
}
"""Names that keys had before version 0.3, and what they are called now."""


def unknown_key(key: str, known: Sequence[str]) -> str:
    """The message about a key that is not one of those known."""
    new = RENAMED.get(key.rpartition(".")[2])
    if new:
        return f"{key}: unknown key; it is now {new}"
    close = difflib.get_close_matches(key.rpartition(".")[2], known, n=1, cutoff=0.5)
    # What follows must not lie in the middle of a long message, which is left out.
    listed = textwrap.shorten(", ".join(known), _LISTED, placeholder=" …")
    expected = f"did you mean {close[0]}?" if close else f"expected one of {listed}"
    return f"{key}: unknown key; {expected}"


def _explain(schema: type, error: "ValidationError") -> str:
    """The first error of a validation, in one line."""
    errors = error.errors(include_url=False)
    first = errors[0]
    # The tag of a union appears in the path as if it were a key.
    tags = {tag for hint in _flatten(schema) if isinstance(hint, OneOf) for tag in hint.types}

    def path_of(loc: tuple[int | str, ...]) -> list[str]:
        parts = [str(part) for part in loc if not str(part).startswith("literal[")]
        return [
            p for i, p in enumerate(parts) if not (p in tags and i and parts[i - 1] == "problem")
        ]

    path = path_of(first["loc"])
    key = ".".join(path)
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return unknown_key(key, _keys(schema, path[:-1]))
    message = first["msg"].replace("\n", " ").replace("Invalid JSON", "expected JSON")
    message = message.removeprefix("Value error, ").replace("Input should be", "expected")
    message = message.replace("a valid array", "a list").replace("an object", "a mapping")
    message = message.replace("Field required", "expected a value, found none")
    if first["type"] == "literal_error":
        # Of a union, every part has an error of its own.
        same = [e for e in errors if e["type"] == first["type"] and path_of(e["loc"]) == path]
        known = [name for e in same for name in re.split(", | or ", e["ctx"]["expected"])]
        message = f"expected {', '.join(known[:-1])} or {known[-1]}" if known[1:] else message
    elif first["type"] == "dataclass_type" and (known := _keys(schema, path)):
        message = f"expected a mapping of {', '.join(known)}"
    elif first["loc"][-1:] == ("file",) and path[-1:] == ["problem"]:
        message = "expected a file, a folder, a list of them, or a generator's options"
    said = first["type"] in ("value_error", "json_invalid", "missing", "missing_argument")
    found = "" if said else f", found {first['input']!r}"[:200]
    return f"{_prefix(key)}{message}{found}"


def _keys(schema: Any, path: list[str]) -> list[str]:
    """The keys of the dataclass that a path of keys leads to."""
    for name in path:
        schema = get_type_hints(schema, include_extras=True).get(name)
        schema = next(
            (t for t in _flatten(schema) if isinstance(t, type) and is_dataclass(t)), None
        )
        if schema is None:
            return []
    return [f.name for f in fields(schema)]


def _flatten(hint: Any) -> list[Any]:
    """A type hint and all hints inside it, including those of a dataclass's fields."""
    inner = list(get_args(hint))
    if isinstance(hint, type) and is_dataclass(hint):
        inner += get_type_hints(hint, include_extras=True).values()
    return [hint, *(deeper for one in inner for deeper in _flatten(one))]
