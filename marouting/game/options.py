"""The options of the rules, for an engine and every interface of the environment."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import ConfigDict

from marouting.config import check
from marouting.problem.net import is_whole
from marouting.problem.problem import check_choice
from marouting.trees.decomposition import Decomposition

TurnOrder = Literal["sequential", "round_robin"]
NetOrder = Literal["half_perimeter", "half_perimeter_up", "file"]
Overflow = Literal["forbidden", "allowed"]

_MAX_STEPS = 50

MOST_STEPS = 1_000_000
"""The largest ``max_steps``: a policy that goes in circles takes them all."""


@dataclass(frozen=True, kw_only=True)
class RuleOptions:
    """The options of the rules; the defaults are the paper's.

    Attributes:
        turn_order: ``sequential``, a net finishes before the next one starts (the paper), or
            ``round_robin``, each net takes one step in turn. None: ``round_robin`` in the
            interfaces where every net is an agent, otherwise ``sequential``.
        net_order: ``half_perimeter``, largest bounding box first (the authors' code), ties in file
            order; ``half_perimeter_up``, smallest first; or ``file``.
        max_steps: steps after which a task fails (the paper's T_max), up to a million. None: 50 as
            in the paper, or 2 (X + Y) if that is more, because 50 steps do not cross a large grid.
        overflow: ``forbidden``, a move across a full edge is blocked (the paper), or ``allowed``,
            it overflows the edge, at a price that the reward sets.
        decomposition: the tree along which a net's pins are split into tasks: ``mst``, a minimum
            spanning tree (the paper), or ``steiner``, a rectilinear Steiner tree.

    Raises:
        InputError: an option is out of range.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    turn_order: TurnOrder | None = None
    net_order: NetOrder = "half_perimeter"
    max_steps: int | None = None
    overflow: Overflow = "forbidden"
    decomposition: Decomposition = "mst"

    def __post_init__(self) -> None:
        if self.turn_order is not None:
            check_choice("turn_order", self.turn_order, TurnOrder)
        check_choice("net_order", self.net_order, NetOrder)
        check_choice("overflow", self.overflow, Overflow)
        check_choice("decomposition", self.decomposition, Decomposition)
        steps = self.max_steps
        in_range = steps is None or (is_whole(steps) and 1 <= steps <= MOST_STEPS)
        check("max_steps", in_range, f"1 to {MOST_STEPS}, found {steps}")

    def steps_per_task(self, grid: tuple[int, int, int]) -> int:
        """Steps after which a task fails on a grid of X×Y×Z Gcells."""
        width, height, _ = grid
        return max(_MAX_STEPS, 2 * (width + height)) if self.max_steps is None else self.max_steps
