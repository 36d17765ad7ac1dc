"""The options of the rules, for an engine and every interface of the environment."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import ConfigDict

from marouting.config import check
from marouting.problem.grid import MOVES
from marouting.problem.net import is_whole
from marouting.problem.problem import check_choice
from marouting.trees.decomposition import Decomposition

TurnOrder = Literal["sequential", "round_robin"]
NetOrder = Literal["half_perimeter", "half_perimeter_up", "file"]
Overflow = Literal["forbidden", "allowed"]
Target = Literal["pin", "tree"]
NextTask = Literal["listed", "nearest"]
RipUpChoice = Literal["all", "conflicts", "price", "agents"]

_MAX_STEPS = 50

MOST_STEPS = 1_000_000
"""The largest ``max_steps``: a policy that goes in circles takes them all."""

MOST_ROUNDS = 100_000
"""The largest ``rip_up_rounds`` and ``rip_up_patience``."""

MOST_NEIGHBOURS = 100
"""The largest ``rip_up_neighbours``."""

LEAST_PRESENT, MOST_PRESENT = 0.01, 2.0
"""The smallest and the largest ``rip_up_present``: a smaller one would not grow, being counted in
whole parts, and a larger one would hide what prices say."""

MOST_CALM = 1000.0
"""The largest ``rip_up_calm``: from the second negotiation on prices no longer rise."""


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
        target: what ends a task: ``pin``, the task's target pin (the paper), or ``tree``: the agent
            starts at the new pin, and any Gcell that the net's edges join to its first pin will do.
        next_task: ``listed``, tasks in the order of the decomposition (the paper), or ``nearest``,
            the open pin nearest to the net's tree is next. For ``decomposition: mst`` only.
        mask_visited: whether masks leave out moves to Gcells that the agent has visited in its
            task, as long as other moves are left.
        give_back: whether a failed task gives the edges back that it took.
        rip_up_rounds: how often nets give their edges back and walk again after all have routed;
            see :mod:`marouting.batch.rounds`. Agents then stay until the last round is over.
        rip_up: which nets do so, and in which order: ``all``; ``conflicts``, those with open tasks
            or on full edges; ``price``, those on edges that were full in this or earlier rounds,
            the costliest first; or ``agents``, those whose agents choose so by a seventh action.
        rip_up_neighbours: how many nets that stand in its way walk again together with a net.
        rip_up_patience: rounds after which one more of them does so, from none in the first rounds;
            0: all of them from the first round on.
        rip_up_prices: whether nets negotiate: in the first walk they share edges cheaply, in some
            of the rounds edges with overflow get dearer, and nets keep the routes that cost them
            less. With ``overflow: allowed`` only; without rounds nothing is priced.
        rip_up_present: what one net too many adds to the cost of an edge in the first walk, as a
            part of it, 0.01 to 2. It grows from round to round. The more there is of it,
            the sooner there is no overflow, and the longer routes are. For ``rip_up_prices``.
        rip_up_calm: how soon prices come to rest: when nets negotiate for the r-th time after the
            first, prices rise and fall by 1 / (1 + rip_up_calm · r) of what they did, once there
            are routes without overflow. 0 to 1000, in hundredths. For ``rip_up_prices``, with many
            rounds.

    Raises:
        InputError: an option is out of range.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    turn_order: TurnOrder | None = None
    net_order: NetOrder = "half_perimeter"
    max_steps: int | None = None
    overflow: Overflow = "forbidden"
    decomposition: Decomposition = "mst"
    target: Target = "pin"
    next_task: NextTask = "listed"
    mask_visited: bool = False
    give_back: bool = False
    rip_up_rounds: int = 0
    rip_up: RipUpChoice = "all"
    rip_up_neighbours: int = 0
    rip_up_patience: int = 0
    rip_up_prices: bool = False
    rip_up_present: float = 0.1
    rip_up_calm: float = 0.0

    def __post_init__(self) -> None:
        if self.turn_order is not None:
            check_choice("turn_order", self.turn_order, TurnOrder)
        check_choice("net_order", self.net_order, NetOrder)
        check_choice("overflow", self.overflow, Overflow)
        check_choice("decomposition", self.decomposition, Decomposition)
        steps = self.max_steps
        in_range = steps is None or (is_whole(steps) and 1 <= steps <= MOST_STEPS)
        check("max_steps", in_range, f"1 to {MOST_STEPS}, found {steps}")
        check_choice("target", self.target, Target)
        check_choice("next_task", self.next_task, NextTask)
        check_choice("rip_up", self.rip_up, RipUpChoice)
        numbers = {
            "rip_up_rounds": MOST_ROUNDS,
            "rip_up_neighbours": MOST_NEIGHBOURS,
            "rip_up_patience": MOST_ROUNDS,
        }
        for name, most in numbers.items():
            number = getattr(self, name)
            in_range = is_whole(number) and 0 <= number <= most
            check(name, in_range, f"0 to {most}, found {number}")
        for name in ("mask_visited", "give_back", "rip_up_prices"):
            value = getattr(self, name)
            check(name, isinstance(value, bool), f"true or false, found {value!r}")
        allowed = not self.rip_up_prices or self.overflow == "allowed"
        check("rip_up_prices", allowed, "false, unless overflow is allowed")
        factors = {
            "rip_up_present": (LEAST_PRESENT, MOST_PRESENT),
            "rip_up_calm": (0.0, MOST_CALM),
        }
        for name, (low, high) in factors.items():
            factor = getattr(self, name)
            in_range = not isinstance(factor, bool) and isinstance(factor, int | float)
            in_range = in_range and low <= factor <= high
            check(name, in_range, f"{low:g} to {high:g}, found {factor!r}")
        pins_only = self.next_task == "listed" or self.decomposition == "mst"
        check("next_task", pins_only, "listed, for a decomposition other than mst")

    @property
    def actions(self) -> int:
        """How many actions an agent has: six moves and, with ``rip_up: agents``, giving way."""
        return MOVES + (self.rip_up_rounds > 0 and self.rip_up == "agents")

    def steps_per_task(self, grid: tuple[int, int, int]) -> int:
        """Steps after which a task fails on a grid of X×Y×Z Gcells."""
        width, height, _ = grid
        return max(_MAX_STEPS, 2 * (width + height)) if self.max_steps is None else self.max_steps
