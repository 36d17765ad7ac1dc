"""What the composed figures of an experiment show: routers side by side, quantities below another.

The paper's figures of this kind are those of the generator, of the two types of problems, of the
case study, of the discount factor, of the burn-in memory and of the solutions.
"""

from dataclasses import dataclass, field
from typing import Literal

from marouting.config import check

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
"""Of one problem: ``edges``, capacities before and after A*; after the router heat maps of the
``vias``, ``vertical`` and ``horizontal`` edges, the ``histogram`` of utilisation, and its
``routes``. Of a set: ``wirelength`` and ``overflow`` of the router, of A* and of the reference,
problem by problem; ``decrease``, how much less wirelength the router needs than A*; ``reward`` of
ten random problems over the training; ``mean_reward`` of all problems and seeds, of the router and
those beside it. Of several seeds solutions and rewards are else the first's, wirelength and
overflow the mean."""


@dataclass(frozen=True, kw_only=True)
class StudyColumn:
    """One router on one set of problems.

    Attributes:
        router: the name of the experiment's entry.
        set: the set's name; None: the only one that the router is for.
        problem: the one problem to show; None: the set's first.
        beside: other routers, for ``mean_reward``.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    router: str
    set: str | None = None
    problem: str | None = None
    beside: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Study:
    """A composed figure.

    Attributes:
        panels: what is shown, from above to below.
        columns: of what, by title, from left to right.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012

    panels: tuple[Panel, ...] = ("wirelength", "decrease", "reward")
    columns: dict[str, StudyColumn] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check("panels", len(self.panels) > 0, "at least one")
        check("panels", len(set(self.panels)) == len(self.panels), "every panel once")
        check("columns", len(self.columns) > 0, "at least one")
