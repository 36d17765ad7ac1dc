"""The options of the rules in the batch: those of the game, and those of nets that negotiate."""

from dataclasses import dataclass

from marouting.checks import check_fields
from marouting.config import check
from marouting.game import MOST_ROUNDS, Rules

LEAST_PRESENT, MOST_PRESENT = 0.01, 2.0
"""The smallest and the largest ``rip_up_present``: a smaller one would not grow, being counted in
whole parts, and a larger one would hide what prices say."""

MOST_CALM = 1000.0
"""The largest ``rip_up_calm``: from the second negotiation on prices no longer rise."""


@dataclass(frozen=True, kw_only=True)
class RuleOptions(Rules):
    """The options of the rules in the batch.

    They are those of :class:`marouting.game.Rules`, and four more for nets that negotiate, which
    the plain game does not know.

    Attributes:
        rip_up_patience: rounds after which one more net of ``rip_up_neighbours`` is ripped up with
            a net, from none in the first rounds; 0: all of them from the first round on.
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

    rip_up_patience: int = 0
    rip_up_prices: bool = False
    rip_up_present: float = 0.1
    rip_up_calm: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        bounds = {
            "rip_up_patience": (0, MOST_ROUNDS),
            "rip_up_present": (LEAST_PRESENT, MOST_PRESENT),
            "rip_up_calm": (0.0, MOST_CALM),
        }
        check_fields(self, **bounds)
        allowed = not self.rip_up_prices or self.overflow == "allowed"
        check("rip_up_prices", allowed, "false, unless overflow is allowed")
