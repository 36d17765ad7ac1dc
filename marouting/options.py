"""The options of an environment: the ``env:`` part of a configuration."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from marouting.config import Component, build, check, component_field, take_components
from marouting.errors import InputError, UnknownOption
from marouting.generator import GeneratorOptions
from marouting.old_names import unknown_key
from marouting.problem.controls import ProblemFile
from marouting.rules import Agents as Agents
from marouting.rules import Rules, TurnOrder
from marouting.scenarios import Scenario, Split, load, names
from marouting.scenarios.scenario import PLAYED as PLAYED
from marouting.yaml_files import merged

RenderMode = Literal["ansi", "rgb_array", "human"]

SMALL = GeneratorOptions(nets=10, reduced_edges=0)
"""The default problem of an environment: 10 nets on 8×8×2.

It has no reduced edges. Finding those takes a search, and compiling the search would double the
time that the first ``env()`` takes on a new machine."""


ProblemSource = str | tuple[str, ...] | ProblemFile | GeneratorOptions


@dataclass(frozen=True, kw_only=True)
class GameOptions(Rules):
    """The options of every interface of the environment; the defaults are the paper's.

    The options of the rules come from :class:`marouting.rules.Rules`.

    Attributes:
        problem: a problem's file, a folder of ``.gr`` files, a list of both, a file with controls
            such as ``{path: chip.def, layers: 2..6}``
            (:class:`marouting.problem.controls.ProblemFile`), or generator options
            (:class:`marouting.generator.GeneratorOptions`). With several problems, every reset
            draws one; with ``seed: null`` the generator makes a new one. None: a small problem,
            or those of the scenario.
        scenario: the name of a scenario (:mod:`marouting.scenarios`), or ``module:NAME`` for one of
            your own, instead of ``problem``. A scenario may set other defaults for the options.
        split: which of the scenario's problems: ``train``, a new one at every reset;
            ``validation`` or ``test``, a random one of this fixed set at every reset.
        observation: what agents see: the name of a registered observation, ``module:Class``, a
            mapping with the name under ``kind`` and its options beside it, or an object. See
            :mod:`marouting.observations`.
        reward: what moves pay, given in the same way as ``observation``. See
            :mod:`marouting.rewards`.
        agents_persist: whether agents that are done stay in ``agents`` until all are done. With
            several problems, ``agents`` is then the same in each, and agents that a problem lacks
            are inactive. For libraries that need a fixed set of agents, and for rewards that pay
            agents that are done.
        render_mode: ``ansi``, ``rgb_array``, ``human`` or None.
    """

    problem: ProblemSource | None = None
    scenario: str | None = None
    split: Split = "train"
    observation: Component = component_field("observation", "paper")
    reward: Component = component_field("reward", "paper")
    agents_persist: bool = False
    render_mode: RenderMode | None = None

    @property
    def endless(self) -> bool:
        """Whether every episode plays a new problem."""
        generated = isinstance(self.problem, GeneratorOptions) and self.problem.seed is None
        return generated if self.scenario is None else self.split == "train"

    @property
    def persists(self) -> bool:
        """Whether agents stay until all are done: by choice, or because they may be rerouted."""
        return self.agents_persist or bool(self.rip_up and self.rip_up.rounds)

    def __post_init__(self) -> None:
        super().__post_init__()
        take_components(self)
        if self.scenario is None:
            check("split", self.split == "train", "a scenario beside it")
            object.__setattr__(self, "problem", SMALL if self.problem is None else self.problem)
        else:
            load(self.scenario)
            check("problem", self.problem is None, "none beside a scenario, which has its own")
        for name, (columns, plain, *methods) in FORMS.items():
            given = getattr(self, name)
            defined = {method for base in given.cls.__mro__ for method in vars(base)}
            what = " and ".join((*methods, f"{columns} or {plain}"))
            fits = defined.issuperset(methods) and defined & {columns, plain}
            check(name, fits, f"an object that has {what}, found {given.name}")
        shown = getattr(self.observation.options, "shown_bits", 0)
        what = f"{shown}, as in observation.message_bits, found {self.message_bits}"
        check("message_bits", shown in (0, self.message_bits), what)
        taken = {self.mask.observation_key, *TOLD}
        what = f"none of {', '.join(sorted(taken))}, found {self.mask.mask_key}"
        check("mask.mask_key", self.mask.mask_key not in taken, what)
        what = "a name that does not begin with _, as Gymnasium's vectors have keys of that form"
        check("mask.mask_key", not self.mask.mask_key.startswith("_"), what)

    @property
    def rules(self) -> Rules:
        """The rules of the game alone."""
        return Rules(**{field.name: getattr(self, field.name) for field in fields(Rules)})


FORMS = {"observation": ("write", "see", "space"), "reward": ("__call__", "pay")}
"""For each kind of component: its method for columns, that for a plain game, and further ones."""

TOLD = (
    "active", "final_info", "final_obs", "is_success", "joined", "metrics", "net", "open",
    "overflow", "problem", "steps", "task_ended", "task_mask", "task_obs", "tasks", "wirelength",
)  # fmt: skip
"""The keys of infos besides the mask, those of Gymnasium's vectors among them."""

ORDERS: dict[Agents, TurnOrder] = {"single": "sequential", "multi": "round_robin"}
"""The turn order for one agent and for many, if the options give none."""


@dataclass(frozen=True, kw_only=True)
class EnvOptions(GameOptions):
    """The ``env:`` part of a configuration: the options of the game and its interface.

    Attributes:
        agents: ``single``, one player moves all nets (Gymnasium; the paper), or ``multi``, every
            net is an agent (PettingZoo).
    """

    agents: Agents = "single"


def with_suggestions(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain data; those that are not given are the scenario's suggestions."""
    scenario = options.get("scenario")
    check("scenario", not isinstance(scenario, Scenario), f"a name, found the object {scenario!r}")
    if isinstance(scenario, str) and (scenario in names() or ":" in scenario):
        return merged(load(scenario).env, options)
    return dict(options)


def game_options(options: Mapping[str, Any], agents: Agents | None = None) -> GameOptions:
    """Checks options given as keywords, and adds those that their scenario suggests.

    Args:
        options: fields of :class:`GameOptions`; ``observation`` and ``reward`` may also be objects.
            ``agents`` may be among them, as in a scenario's options, and must fit the interface.
        agents: what the interface plays with, which also decides the turn order if the options give
            none; None: either, and the turn order stays open.

    Raises:
        UnknownOption: there is no such option.
        InputError: an option cannot be used; the message names it and what was expected.
    """
    known = [field.name for field in fields(EnvOptions)]
    for name in options:
        if name not in known:
            what = f"got an unexpected keyword argument {name!r}"
            raise UnknownOption(f"{unknown_key(name, known)} ({what})")
    found = options.get("agents", agents)
    fits = found in (None, *ORDERS) and agents in (None, found)
    what = " or ".join(ORDERS) if agents is None else f"{agents} in this interface"
    check("agents", fits, f"{what}, found {found!r}")
    plain = with_suggestions(options)
    plain.pop("agents", None)
    for name in ("observation", "reward"):
        check(name, plain.get(name, name) is not None, "a name, a mapping or an object, found None")
    components = {
        name: plain.pop(name)
        for name in ("observation", "reward")
        if not isinstance(plain.get(name), Mapping | str | None)
    }
    try:
        checked = build(GameOptions, plain)
    except InputError as error:
        if re.split(r"[.:]", str(error))[0] in plain.keys() - options.keys():
            raise InputError(f"{options['scenario']}: env.{error}") from None
        raise
    checked = replace(checked, **components)
    if agents is None or checked.turn_order is not None:
        return checked
    return replace(checked, turn_order=ORDERS[agents])
