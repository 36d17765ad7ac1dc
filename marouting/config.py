"""Options: dataclasses are the schema and the one place of defaults, YAML and keywords fill them.

What a configuration may hold is what the dataclass says, strictly typed; an unknown key names the
nearest one there is.
"""

import difflib
import functools
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast, get_args, get_type_hints

import yaml
from pydantic import ConfigDict, Discriminator, Tag, TypeAdapter, ValidationError

from marouting.errors import InputError
from marouting.files import unusable
from marouting.game.engine import Engine, NetOrder, Overflow, TurnOrder
from marouting.game.observation import PaperObservation
from marouting.game.reward import PaperReward
from marouting.generator import GeneratorOptions
from marouting.problem.problem import Problem
from marouting.trees.decomposition import Decomposition

Agents = Literal["single", "multi"]
RenderMode = Literal["ansi", "rgb_array", "human"]

SMALL = GeneratorOptions(nets=10, reduced_edges=0)
"""What an environment plays when it is given no problem: 10 nets on 8×8×2.

No edges are reduced: that takes a search, and compiling it would double the time that a first
``env()`` takes on a new machine."""


def _kind_of_source(value: Any) -> str:
    if isinstance(value, Mapping | GeneratorOptions):
        return "generator"
    return "files" if isinstance(value, list | tuple) else "file"


ProblemSource = Annotated[
    Annotated[str, Tag("file")]
    | Annotated[tuple[str, ...], Tag("files")]
    | Annotated[GeneratorOptions, Tag("generator")],
    Discriminator(_kind_of_source),
]
_TAGS = ("file", "files", "generator")


@dataclass(frozen=True, kw_only=True)
class GameOptions:
    """The options of every face of the environment; the defaults are the paper's.

    Attributes:
        problem: a ``.gr`` file, a folder of them, a list of both, or what the generator takes
            (:class:`marouting.generator.GeneratorOptions`). An environment plays one problem. A
            generator with ``seed: null`` draws a new problem at every reset.
        turn_order: ``sequential``, a net routes to its end before the next starts (the paper), or
            ``round_robin``, one step each. None: ``sequential`` for one agent, ``round_robin`` for
            many.
        net_order: ``half_perimeter`` (largest first, as the authors' code), ``half_perimeter_up``
            or ``file``.
        max_steps: steps after which a task fails, the paper's T_max. None: 50 as in the paper, or
            twice X + Y where that is more.
        overflow: ``forbidden``, a move across a full edge is blocked (the paper), or ``allowed``,
            at ``reward.overflow_price``.
        decomposition: what tasks a net's pins are cut into, along a tree: ``mst``, a minimum
            spanning tree (the paper), or ``steiner``, a rectilinear Steiner tree.
        observation: the paper's 12 numbers; see
        :class:`marouting.game.observation.PaperObservation`.
        reward: the paper's +100 and −1; see :class:`marouting.game.reward.PaperReward`.
        mask_in_observation: whether an observation is ``{"observation", "action_mask"}``; the
            mask is in ``info["action_mask"]`` either way.
        render_mode: ``ansi``, ``rgb_array``, ``human`` or None.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    problem: ProblemSource = SMALL
    turn_order: TurnOrder | None = None
    net_order: NetOrder = "half_perimeter"
    max_steps: int | None = None
    overflow: Overflow = "forbidden"
    decomposition: Decomposition = "mst"
    observation: PaperObservation = field(default_factory=PaperObservation)
    reward: PaperReward = field(default_factory=PaperReward)
    mask_in_observation: bool = False
    render_mode: RenderMode | None = None

    def engine(self, problems: Sequence[Problem], turn_order: TurnOrder) -> Engine:
        """The engine that plays problems by these options; raises InputError if it cannot.

        Args:
            problems: what to play, whatever ``problem`` says.
            turn_order: the order where the options leave it open.
        """
        return Engine(
            problems,
            turn_order=self.turn_order or turn_order,
            net_order=self.net_order,
            max_steps=self.max_steps,
            overflow=self.overflow,
            decomposition=self.decomposition,
        )


ORDERS: dict[Agents, TurnOrder] = {"single": "sequential", "multi": "round_robin"}
"""The turn order of each face, where the options leave it open."""


@dataclass(frozen=True, kw_only=True)
class EnvOptions(GameOptions):
    """The part ``env:`` of a configuration: the game's options and the face to play it through.

    Attributes:
        agents: ``single``, one player moves all nets (Gymnasium; the paper), or ``multi``, every
            net is an agent (PettingZoo).
    """

    agents: Agents = "single"


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


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The mapping in a YAML file; raises InputError naming the file and the line."""
    try:
        text = Path(path).read_text(encoding="utf-8")
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
    """Fills a dataclass from plain data, strictly: no key too many, no type but the schema's.

    Args:
        schema: the dataclass.
        raw: plain data, as from YAML.
        where: what the message of an error starts with: the file, or the key that leads here.

    Raises:
        InputError: names the key, what was expected and what was found.
    """
    try:
        # In JSON a list can be a tuple and an integer a float, and nothing else is converted.
        text = json.dumps(raw, default=_plain)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(one_line(f"{_prefix(where)}expected plain data: {error}")) from None
    try:
        built: Schema = _adapter(cast(Any, schema)).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(one_line(_prefix(where) + _explain(schema, error))) from None
    return built


@functools.cache
def _adapter(schema: Any) -> TypeAdapter[Any]:
    return TypeAdapter(schema)


def _plain(value: Any) -> Any:
    """What JSON does not know: paths, NumPy's numbers, dataclasses."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} is not")


def one_line(text: str) -> str:
    """A text without its line breaks, which keys and paths may hold."""
    return " ".join(text.splitlines())


def _prefix(where: str) -> str:
    return f"{where}: " if where else ""


def _explain(schema: type, error: ValidationError) -> str:
    """The first error of a validation as one line."""
    first = error.errors(include_url=False)[0]
    # A tag stands behind the field that it belongs to; elsewhere it is a key like any other.
    loc = [str(part) for part in first["loc"]]
    path = [p for i, p in enumerate(loc) if not (p in _TAGS and i and loc[i - 1] == "problem")]
    key = ".".join(path)
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        known = _keys(schema, path[:-1])
        close = difflib.get_close_matches(path[-1], known, n=1, cutoff=0.5)
        expected = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(known)}"
        return f"{key}: unknown key; {expected}"
    message = first["msg"].replace("\n", " ")
    message = message.removeprefix("Value error, ").replace("Input should be", "expected")
    found = f", found {first['input']!r}"[:200] if first["type"] != "value_error" else ""
    return f"{_prefix(key)}{message}{found}"


def _keys(schema: Any, path: list[str]) -> list[str]:
    """The keys of the dataclass that a path of keys leads to."""
    for name in path:
        schema = get_type_hints(schema).get(name)
        schema = next((t for t in _flatten(schema) if is_dataclass(t)), None)
        if schema is None:
            return []
    return [f.name for f in fields(schema)]


def _flatten(hint: Any) -> list[Any]:
    """A type hint and all hints inside it."""
    return [hint, *(inner for arg in get_args(hint) for inner in _flatten(arg))]
