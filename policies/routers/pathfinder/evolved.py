"""Negotiated congestion by schedules that were learned: with less overflow where not all fits.

How fast prices rise, when the linear program sets them, when a round is over, which nets get
cheapest trees: these options were chosen by evolution (:mod:`policies.bench.evolution`), one set
for searches that have time for a few passes over the nets, one for some dozens, one for hundreds
and one for more. The router takes the set that fits its time and the problem, whatever the
problem's size. Numbers are rounded. How the sets were found, what they bring on other problems and
what they cost, is in docs/negotiation.md.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from marouting import Problem
from marouting.problem.grid import VIA_AXIS
from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.router import PathfinderRouter

SECONDS_PER_POINT = 6e-8
"""Processor time that a pass takes per Gcell in the boxes of all nets, about."""

MARGIN = 2
"""Gcells by which such a box extends beyond the net's pins on each side."""


@dataclass(frozen=True, kw_only=True)
class EvolvedOptions(PathfinderOptions):
    """The options of :class:`PathfinderOptions`, with defaults that were learned.

    The defaults are those of a search that has time for many hundreds of passes. With less time,
    options that are left at their defaults get other values (:data:`SHORT`).

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
    patience: int = 3


SHORT: dict[float, PathfinderOptions] = {
    20.0: PathfinderOptions(
        exact_pins=3,
        growth=1.29,
        history=0.4,
        stuck=13,
        least_gain=0.0004,
        again=0.2,
        patience=7,
    ),
    100.0: PathfinderOptions(
        margin=1,
        exact_pins=2,
        present=0.028,
        growth=1.2,
        history=0.65,
        calm=0.05,
        stuck=13,
        again=0.08,
        probe=10,
        priced=3,
        worth=13.5,
        patience=3,
    ),
    600.0: PathfinderOptions(
        margin=1,
        exact_pins=3,
        present=0.018,
        history=0.65,
        calm=0.0,
        stuck=13,
        least_gain=0.0007,
        again=0.0,
        priced=3,
        worth=13.5,
        patience=3,
    ),
}
"""The options of searches that have time for fewer passes than the number before them."""


def passes_in_time(problem: Problem, seconds: float | None) -> float:
    """About how many passes over the nets a search makes in so much processor time."""
    if seconds is None:
        return np.inf
    low, high = problem.pin_boxes()
    reach = np.minimum(high - low + 1 + 2 * MARGIN, problem.grid)[:, :VIA_AXIS]
    several = np.diff(problem.flat_pin_gcells[0]) > 1
    points = float(reach[several].prod(axis=1).sum()) * problem.grid[VIA_AXIS]
    return np.inf if points == 0 else seconds / (SECONDS_PER_POINT * points)


class EvolvedRouter(PathfinderRouter):
    """Negotiated congestion with these options.

    More time can come with another schedule, so it need not always bring a better solution.

    Args:
        options: the options; None for the defaults.
    """

    Options = EvolvedOptions

    def warm_up(self, problem: Problem) -> None:
        """Compiles what routing needs by any of the sets."""
        super().warm_up(problem)
        for learned in SHORT.values():
            PathfinderRouter(learned).warm_up(problem)

    def options_for(self, problem: Problem) -> PathfinderOptions:
        """The options with what was learned for the time that the problem gets."""
        passes = passes_in_time(problem, self.options.seconds)
        learned = next((SHORT[most] for most in SHORT if passes < most), EvolvedOptions())
        chosen = {
            field.name: value
            for field in fields(self.options)
            if (value := getattr(self.options, field.name)) != field.default
        }
        return replace(learned, **chosen)
