"""What the composed figures of an experiment show: routers side by side, quantities in rows.

The paper's figures of this kind are those of the generator, of the two types of problems, of the
case study, of the discount factor, of the burn-in memory and of the solutions. An experiment's
configuration describes them, and its folder keeps that configuration.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from marouting.config import build, check, read_yaml
from marouting.files import FILE_NAME, is_file_name
from marouting.registry import allowing_code
from policies.routers.registry import router_label, router_names

Panel = Literal[
    "edges",
    "vias",
    "vertical",
    "horizontal",
    "histogram",
    "routes",
    "wirelength",
    "overflow",
    "decrease",
    "reward",
    "mean_reward",
]
"""What a panel shows.

Panels of one problem: ``edges`` shows the edges' capacities before and after A*; ``vias``,
``vertical`` and ``horizontal`` are heat maps of the router's solution, ``histogram`` its
utilisation, and ``routes`` its routes.

Panels of a set: ``wirelength`` and ``overflow`` compare the router, A* and the reference problem by
problem; ``decrease`` shows how much less wirelength the router needs than A*; ``reward`` shows the
rewards of ten random problems over the training; ``mean_reward`` shows the mean over all problems
and seeds, for the router and those beside it.

With several seeds, solutions and ``reward`` are those of the first seed; wirelength and overflow
are means over the seeds.
"""


@dataclass(frozen=True, kw_only=True)
class StudyColumn:
    """One router on one set of problems.

    Attributes:
        router: the name of the experiment's entry.
        set: the set's name; None stands for the only set that the router is for.
        problem: the problem that panels of one problem show; None stands for the set's first.
        beside: other routers to show in ``mean_reward``.
    """

    router: str
    set: str | None = None
    problem: str | None = None
    beside: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Study:
    """A composed figure.

    Attributes:
        panels: what the rows show, from top to bottom.
        columns: what the columns show, by title, from left to right.
    """

    panels: tuple[Panel, ...] = ("wirelength", "decrease", "reward")
    columns: dict[str, StudyColumn] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check("panels", len(self.panels) > 0, "at least one")
        check("panels", len(set(self.panels)) == len(self.panels), "every panel once")
        check("columns", len(self.columns) > 0, "at least one")


@dataclass(frozen=True, kw_only=True)
class FigureOptions:
    """The part of an experiment's configuration that its figures depend on.

    Attributes:
        reference: the router that all others are compared with, besides A*.
        labels: what figures call routers, by the name of the entry; no two are alike.
        studies: composed figures by name.
    """

    reference: str | None = None
    labels: dict[str, str] = field(default_factory=dict)
    studies: dict[str, Study] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.studies:
            check(f"studies.{name}", is_file_name(name, ".png"), FILE_NAME)

    @staticmethod
    def read(config: Path) -> "FigureOptions":
        """Reads them from an experiment's configuration; raises InputError."""
        with allowing_code():  # nothing is imported for labels
            raw = read_yaml(config)
        own = {key: value for key, value in raw.items() if key in ("reference", "studies")}
        return build(FigureOptions, {**own, "labels": _labels(raw.get("routers"))}, str(config))

    def label(self, router: str) -> str:
        """What figures call a router."""
        return self.labels.get(router, router)


def _labels(routers: object) -> dict[str, str]:
    """What figures call the entries of an experiment's configuration.

    That is an entry's own label, or what its kind of router is called if it is the only one of its
    kind or bears its name; any other is called by its name. Labels that two share have the names
    beside them.
    """
    entries = {
        str(name): entry
        for name, entry in (routers.items() if isinstance(routers, Mapping) else ())
        if isinstance(entry, Mapping)
    }
    kinds = Counter(str(entry.get("router")) for entry in entries.values())
    called = {}
    for name, entry in entries.items():
        kind = str(entry.get("router"))
        ours = kind in router_names() and (kind == name or kinds[kind] == 1)
        called[name] = str(entry.get("label") or (router_label(kind) if ours else name))
    alike = Counter(called.values())
    return {
        name: f"{label} ({name})" if alike[label] > 1 else label for name, label in called.items()
    }
