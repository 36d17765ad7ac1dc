"""Configurations in YAML: files that include others, changed by ``key=value``.

What comes out is plain data, of which :mod:`marouting.config` makes checked options.
"""

import functools
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

import yaml
from yaml.composer import Composer, ComposerError

from marouting.config import MOST, Keys, check, check_code, plain
from marouting.errors import InputError
from marouting.files import exists, is_file, read_text
from marouting.registry import KINDS

MOST_TEXT = 2**24  # the largest YAML file, in bytes
MOST_VALUES = 100_000
"""The largest number of values in YAML text; an alias counts as all that it stands for."""

DEEPEST = 50  # how deep they may be nested


class _Loader(Composer, yaml.CSafeLoader):
    """The safe loader with YAML 1.2's numbers, and with bounds, on libyaml.

    libyaml parses in a tenth of the time of PyYAML's own parser. All wheels of PyYAML have it.

    ``1e-4`` is a number and not a string, ``1:30`` is a string and not 90, ``010`` is 10 and not 8.
    A key may occur only once in a mapping. A few aliases of aliases can stand for more values than
    fit in memory, so they are counted before anything is made of them.
    """

    def __init__(self, text: str) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)

    def compose_document(self) -> yaml.Node | None:
        """A document as written, if it is not too large."""
        self._sizes: dict[yaml.Node, int] = {}
        self._depth = 0
        return super().compose_document()

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        """A value as written, or the one that an alias stands for."""
        event: Any = self.peek_event()
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
        text = str(self.construct_scalar(node))
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))

    @staticmethod
    def _refuse(problem: str, mark: Any) -> NoReturn:
        raise ComposerError(None, None, problem, mark)


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


@dataclass(frozen=True)
class _File:
    """A file of a configuration: its name for messages, what it says, and on which lines."""

    name: str
    data: dict[str, Any]
    lines: dict[Keys, int]


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The mapping in a YAML file, merged with those that it includes.

    Files that name a ``module:Class`` are refused unless it is allowed
    (:func:`marouting.registry.allowing_code`).

    The key ``include`` names a file, or a list of files: paths relative to the including file, or
    files of the package (``configs/…``). Values of a file replace those of the files that it
    includes, and later files in a list replace earlier ones (:func:`merged`).
    """
    return _whole(_files(path))


def origins_of(path: str | os.PathLike[str]) -> dict[Keys, tuple[str, int]]:
    """The file and line of every value that :func:`read_yaml` reads, by the keys to it."""
    files = _files(path)
    # A value is from the last file that has one there.
    lines = {keys: (file.name, line) for file in files for keys, line in file.lines.items()}
    return {keys: lines[keys] for keys, _ in leaves(_whole(files)) if keys in lines}


def _whole(files: Sequence[_File]) -> dict[str, Any]:
    """What files say together, later ones before earlier ones."""
    return functools.reduce(merged, (file.data for file in files), {})


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


def override(raw: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Plain data with single keys changed; see :func:`merged`.

    Args:
        raw: plain data, as from YAML.
        overrides: ``key=value``, with dots between the parts of a key and the value as in YAML. A
            mapping replaces the whole of one, and the name of a component all of its options. Keys
            of what is replaced may be given as well, in any order: ``reward.step=-1 reward=paper``.
            Of values for the same key the last one counts.

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
