"""Negotiated congestion by a schedule that was learned: with less overflow where not all fits.

How fast prices rise, when a round is over, which nets get cheapest trees: these options were chosen
by evolution, one set for problems of all kinds and sizes. Differential evolution (Storn and Price,
Journal of Global Optimization 11, 1997) tried 180 sets on twelve problems that do not fit, with a
second of processor time for each problem (``python -m policies.bench.oracle schedule --together``);
numbers are rounded. In much less time, or on far larger problems, the defaults of
:class:`PathfinderOptions` may be better. What they bring on other problems, and what they cost, is
in docs/negotiation.md.
"""

from dataclasses import dataclass

from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.router import PathfinderRouter


@dataclass(frozen=True, kw_only=True)
class EvolvedOptions(PathfinderOptions):
    """The options of :class:`PathfinderOptions`, with defaults that were learned.

    Raises:
        InputError: an option is out of range; the message names it and the range.
    """

    present: float = 0.074
    growth: float = 1.103
    history: float = 0.64
    decay: float = 0.85
    calm: float = 0.21
    stuck: int = 19
    exact_pins: int = 4
    again: float = 0.49
    patience: int = 2


class EvolvedRouter(PathfinderRouter):
    """Negotiated congestion with these options.

    Args:
        options: the options; None for the defaults.
    """

    Options = EvolvedOptions
