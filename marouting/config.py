"""From plain data to checked options: YAML, dataclasses as schemas, and pieces by name.

What a configuration may hold is what a dataclass says, strictly typed, and the dataclass is the one
place of the defaults. An unknown key is an error that names the nearest key there is.

A **piece** is a part that users may bring themselves, named in a configuration as its kind says in
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
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_type_hints

import yaml
from pydantic import PlainValidator, Tag, TypeAdapter, ValidationError
from pydantic.errors import PydanticUserError

from marouting.errors import InputError
from marouting.files import unusable
from marouting.registry import lookup, name_of, names

MOST = 2**31 - 1
"""The largest count: compiled code and arrays take no arbitrary integers."""


class _Loader(yaml.SafeLoader):
    """The safe loader, with two rules of YAML 1.2.

    ``1e-4`` is a number, not a text; and no key may stand twice in a mapping.
    """

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """A mapping as it is written, before anything is merged into it."""
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                problem = f"the key {key.value} stands twice"
                raise yaml.composer.ComposerError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return node


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|^[-+]?\.(inf|Inf|INF)$"),
    list("-+0123456789."),
)


def parse_yaml(text: str, name: str) -> Any:
    """Plain data from YAML text by the safe loader; InputError names ``name`` and the line."""
    name = one_line(name)
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
        # What PyYAML does with values like `!!bool perhaps` or `!!int ""`.
        raise InputError(f"{name}: expected YAML: a value is not of its tag's type") from None


def config_file(path: str | os.PathLike[str]) -> Path:
    """The file that the path of a configuration names.

    ``configs/paper/default.yaml`` and the others that the package brings are found in any working
    directory; files that are there come first.
    """
    found, here = Path(path), Path(__file__).parent
    if found.parts[:1] != ("configs",) or found.exists():
        return found
    # In an installed package they lie inside it, in a checkout beside it.
    shipped = (here / found, here.parent / found)
    return next((file for file in shipped if file.is_file()), found)


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The mapping in a YAML file; raises InputError naming the file and the line.

    Args:
        path: a path as :func:`config_file` takes it.
    """
    try:
        text = config_file(path).read_text(encoding="utf-8")
    except OSError as error:
        raise unusable(path, "cannot be read", error) from None
    except UnicodeDecodeError:
        raise InputError(f"{os.fspath(path)}: expected UTF-8 text") from None
    data = parse_yaml(text, os.fspath(path))
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise InputError(f"{os.fspath(path)}: expected a mapping of keys to values")
    return data


Schema = TypeVar("Schema")


def build(schema: type[Schema], raw: Mapping[str, Any], where: str = "") -> Schema:
    """Fills a dataclass from plain data, strictly: only its keys, only the types it declares.

    Args:
        schema: the dataclass.
        raw: plain data, as from YAML.
        where: what an error message starts with: the file, or the key that leads here.

    Raises:
        InputError: names the key, what was expected and what was found.
    """
    try:
        # In JSON a list can be a tuple and an integer a float, and nothing else is converted.
        text = json.dumps(raw, default=_jsonable)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(one_line(f"{_prefix(where)}expected plain data: {error}")) from None
    try:
        built: Schema = _adapter(cast(Any, schema)).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(one_line(_prefix(where) + _explain(schema, error))) from None
    except PydanticUserError as error:
        reason = str(error).splitlines()[0]
        what = f"{_prefix(where)}{schema.__name__} cannot be configured"
        raise InputError(f"{what}: {reason}") from None
    return built


@functools.cache
def _adapter(schema: Any) -> TypeAdapter[Any]:
    return TypeAdapter(schema)


def _jsonable(value: Any) -> Any:
    """What JSON does not know: paths, NumPy's numbers, dataclasses, pieces."""
    if isinstance(value, Piece):
        return plain(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} is not")


# --- pieces ---------------------------------------------------------------------------------------

_CONTEXT = {"network": 2, "learner": 1}
"""How many arguments the constructor of a piece is given before its options."""


@dataclass(frozen=True)
class Piece:
    """A piece that a configuration names, before it is made.

    Attributes:
        kind: one of :data:`marouting.registry.KINDS`.
        name: a registered name or ``module:Class``.
        cls: the class.
        options: checked, with the defaults filled in: the piece itself where its class is a
            dataclass, an instance of the class's ``Options`` where it has them, otherwise keyword
            arguments by name.
        given: whether the piece is an object that was handed over ready made.
    """

    kind: str
    name: str
    cls: type[Any]
    options: Any
    given: bool = False

    def make(self, *context: Any) -> Any:
        """The piece.

        Args:
            *context: what its kind is made for: a network gets the shape of an observation and the
                number of outputs, a learner its :class:`policies.learned.learner.Setup`.
        """
        if self.given:
            return self.options
        if isinstance(self.options, Mapping):
            return self.cls(*context, **self.options)
        if isinstance(self.options, self.cls):
            return dataclasses.replace(self.options)
        return self.cls(*context, self.options)


Named = Annotated[Piece, PlainValidator(lambda value: value)]
"""The type of a field that holds a piece; :func:`take_pieces` makes one of what stands there."""


def piece_field(kind: str, name: str | None = None) -> Any:
    """A field of a schema for a piece of a kind.

    Args:
        kind: one of :data:`marouting.registry.KINDS`.
        name: the piece that the field holds by default; None: the first one registered.
    """
    return field(default=None, metadata={"kind": kind, "name": name})


def take_pieces(options: Any) -> None:
    """Replaces names, mappings and objects in the piece fields of a schema by pieces.

    Called by a schema's ``__post_init__``.

    Raises:
        InputError: names the key and what was expected.
    """
    for f in fields(options):
        if "kind" in f.metadata:
            taken = piece(f.metadata["kind"], getattr(options, f.name), f.metadata["name"], f.name)
            object.__setattr__(options, f.name, taken)


def piece(kind: str, raw: Any, default: str | None = None, where: str = "") -> Piece:
    """A piece from what a configuration or an argument holds.

    Args:
        kind: one of :data:`marouting.registry.KINDS`.
        raw: a name or ``module:Class``; a mapping with the key ``kind`` for the name, all others
            being options; a piece; None, for the default; or an object that is the piece.
        default: the name where none is given; None: the first one registered.
        where: what an error message starts with.

    Raises:
        InputError: names the key, what was expected and what was found.
    """
    if isinstance(raw, Piece):
        return raw
    if isinstance(raw, bool | int | float | list | tuple):
        raise InputError(f"{_prefix(where)}expected a name, options with kind, or a piece")
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
            raise InputError(one_line(_unknown_key(str(unknown[0]), known)))
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
    """The dataclass of a class's options, and whether others may come with them."""
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
        InputError: a piece was handed over as an object whose options cannot be told.
    """
    if isinstance(value, Piece):
        options = value.options
        if value.given and not is_dataclass(options):
            raise InputError(
                f"{value.kind}: expected a name or module:Class with its options, to write it "
                f"down; found an object of {value.name}"
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
    """Raises InputError, ``name: expected …``, unless a condition holds."""
    if not holds:
        raise InputError(f"{name}: expected {expected}")


def override(raw: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Plain data with single keys changed.

    Args:
        raw: plain data, as from YAML.
        overrides: ``key=value`` as in :func:`policies.learned.config.load_config`.

    Raises:
        InputError: an override is none.
    """
    changed = dict(raw)
    for given in overrides:
        key, equals, value = given.partition("=")
        if not equals or not key:
            raise InputError(one_line(f"{given}: expected key=value"))
        *parts, last = key.split(".")
        place = changed
        for part in parts:
            inner = place.get(part)
            # A copy: by YAML's anchors a mapping can stand in several places.
            place[part] = dict(inner) if isinstance(inner, Mapping) else {}
            place = place[part]
        place[last] = parse_yaml(value, given)
    return changed


def check_same(mine: Mapping[str, Any], kept: Mapping[str, Any], where: Path) -> None:
    """Raises InputError, naming the key, unless two configurations in plain data are the same.

    Args:
        mine: what is asked for.
        kept: what was started with.
        where: the file that keeps it.
    """
    found, expected = _flat(mine), _flat(kept)
    # A key may be there in one of them only, as those of a problem's files or its generator.
    for key in dict.fromkeys((*expected, *found)):
        if expected.get(key) != found.get(key):
            raise InputError(
                f"{key}: expected {expected.get(key)!r}, as in {where}, found {found.get(key)!r}"
            )


def _flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, keys joined by dots; sequences as tuples."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            flat[prefix + key] = tuple(value)
        else:
            flat[prefix + key] = value
    return flat


def one_line(text: str) -> str:
    """A text without its line breaks, which keys and paths may contain."""
    return " ".join(text.splitlines())


def _prefix(where: str) -> str:
    return f"{where}: " if where else ""


def _unknown_key(key: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(key.rpartition(".")[2], known, n=1, cutoff=0.5)
    expected = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(known)}"
    return f"{key}: unknown key; {expected}"


def _explain(schema: type, error: ValidationError) -> str:
    """The first error of a validation as one line."""
    first = error.errors(include_url=False)[0]
    # What a union is told apart by stands in the path as if it were a key.
    tags = {hint.tag for hint in _flatten(schema) if isinstance(hint, Tag)}
    loc = [str(part) for part in first["loc"]]
    path = [p for i, p in enumerate(loc) if not (p in tags and i and loc[i - 1] == "problem")]
    key = ".".join(path)
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return _unknown_key(key, _keys(schema, path[:-1]))
    message = first["msg"].replace("\n", " ")
    message = message.removeprefix("Value error, ").replace("Input should be", "expected")
    found = f", found {first['input']!r}"[:200] if first["type"] != "value_error" else ""
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
    """A type hint and all hints inside it; of a dataclass also those of its fields."""
    inner = list(get_args(hint))
    if isinstance(hint, type) and is_dataclass(hint):
        inner += get_type_hints(hint, include_extras=True).values()
    return [hint, *(deeper for one in inner for deeper in _flatten(one))]
