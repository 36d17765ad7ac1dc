"""The options of the rules of the game, which :mod:`marouting.game` plays by."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from marouting.checks import check_fields
from marouting.errors import InputError
from marouting.problem.grid import MOVES
from marouting.problem.problem import Problem
from marouting.trees.decomposition import Decomposition

MOST_STEPS, MOST_ROUNDS, MOST_NEIGHBOURS, MOST_BITS = 1_000_000, 100_000, 100, 8
"""The largest ``max_steps``, ``rip_up.rounds``, ``rip_up.neighbours`` and ``message_bits``."""

Agents = Literal["single", "multi"]
TurnOrder = Literal["sequential", "round_robin"]
NetOrder = Literal["half_perimeter", "half_perimeter_up", "file"]
Target = Literal["pin", "tree"]


@dataclass(frozen=True, kw_only=True)
class Nets:
    """How nets become agents with tasks.

    Attributes:
        order: the order of the nets: ``half_perimeter``, largest half perimeter of the bounding box
            first (the authors' code), ties in file order; ``half_perimeter_up``, smallest first; or
            ``file``, as in the file.
        decomposition: the tree that splits a net's pins into two-pin tasks: ``mst``, a minimum
            spanning tree (the paper), or ``steiner``, a rectilinear Steiner tree.
    """

    order: NetOrder = "half_perimeter"
    decomposition: Decomposition = "mst"

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class Mask:
    """The action mask: what it leaves out, and where it is shown. The game uses ``visited`` only.

    Attributes:
        visited: whether moves into Gcells already visited in the task are masked too, as long as
            another move remains.
        in_observation: whether observations are ``{"observation", "action_mask"}``; the mask is in
            ``info["action_mask"]`` either way.
        observation_key: the key of the observation in that dictionary, for libraries that expect
            another one (RLlib: ``observations``).
        mask_key: the key of the mask, in observations and infos.
    """

    visited: bool = False
    in_observation: bool = False
    observation_key: str = "observation"
    mask_key: str = "action_mask"

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class RipUp:
    """Rip-up and reroute: after all nets have routed, some are routed again around the others.

    Attributes:
        rounds: the number of rounds. Agents stay until the last one is over.
        choose: the nets that a round rips up: ``all``; ``conflicts``, those with unconnected tasks
            or on full edges; ``history``, those with unconnected tasks, or on edges that are full
            or were at the start of an earlier round, the worst first; or ``agents``, those whose
            agents choose action 6.
        neighbours: at most this many of the nets in a net's way are ripped up together with it.
    """

    rounds: int = 1
    choose: Literal["all", "conflicts", "history", "agents"] = "all"
    neighbours: int = 0

    def __post_init__(self) -> None:
        check_fields(self, rounds=(0, MOST_ROUNDS), neighbours=(0, MOST_NEIGHBOURS))


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The options of the rules; the defaults are the paper's.

    Attributes:
        turn_order: ``sequential``, a net finishes before the next one starts (the paper), or
            ``round_robin``, each net makes one move in turn. None: ``round_robin`` in the
            interfaces where every net is an agent, otherwise ``sequential``.
        max_steps: steps after which a task fails (the paper's T_max), up to a million. None: 50 as
            in the paper, or 2 (X + Y) if that is more, because 50 steps do not cross a large grid.
        overflow: ``forbidden``, a move across a full edge is blocked (the paper), or ``allowed``,
            the edge overflows and the reward may charge for it.
        target: what ends a task: ``pin``, reaching the target pin (the paper), or ``tree``: the
            agent starts at the new pin and may end in any Gcell of the tree routed so far.
        next_pin: which task is next: ``listed``, in the order of the decomposition (the paper), or
            ``nearest``, that of the unconnected pin nearest to the net's tree; not with Steiner
            trees.
        release_failed: whether a failed task releases the edges that the net first used in it.
        nets: the nets' order and decomposition, a :class:`Nets` or a mapping of its fields.
        mask: the action mask, a :class:`Mask` or a mapping of its fields.
        rip_up: rip-up and reroute, a :class:`RipUp` or a mapping of its fields; None: off.
        wait: whether there is one more move, numbered last: the agent stays where it is. It counts
            as a step.
        message_bits: bits of the message that an agent writes with every action, 0 to 8. An action
            is then ``move + moves * message``, where ``moves`` is the number of moves.
    """

    turn_order: TurnOrder | None = None
    max_steps: int | None = None
    overflow: Literal["forbidden", "allowed"] = "forbidden"
    target: Target = "pin"
    next_pin: Literal["listed", "nearest"] = "listed"
    release_failed: bool = False
    nets: Nets = Nets()
    mask: Mask = Mask()
    rip_up: RipUp | None = None
    wait: bool = False
    message_bits: int = 0

    def __post_init__(self) -> None:
        check_fields(self, max_steps=(1, MOST_STEPS), message_bits=(0, MOST_BITS))
        if self.next_pin == "nearest" and self.nets.decomposition != "mst":
            raise InputError("next_pin: expected listed, for a nets.decomposition other than mst")

    @property
    def moves(self) -> int:
        """How many moves an agent has: six, ripping up when asked, and waiting."""
        return MOVES + self.asks + self.wait

    @property
    def messages(self) -> int:
        """How many messages there are to choose from; 1 without messages."""
        return 1 << self.message_bits

    @property
    def actions(self) -> int:
        """How many actions an agent has: every move with every message."""
        return self.moves * self.messages

    @property
    def asks(self) -> bool:
        """Whether agents are asked whether to rip up their nets."""
        rip_up = self.rip_up
        return rip_up is not None and rip_up.rounds > 0 and rip_up.choose == "agents"

    def steps_per_task(self, grid: tuple[int, int, int]) -> int:
        """Steps after which a task fails on a grid of X×Y×Z Gcells."""
        return self.max_steps or max(50, 2 * (grid[0] + grid[1]))


def net_ranks(problem: Problem, order: NetOrder) -> NDArray[np.int64]:
    """(nets,) numbers by which nets are ordered, lowest first; equal ones stay in file order."""
    sign = {"half_perimeter": -1, "half_perimeter_up": 1, "file": 0}[order]
    return sign * problem.half_perimeters
