"""The tuned schedules: with less overflow where not all fits.

How fast prices rise, when the linear program sets them, when a round is over, which nets get
cheapest trees: these options were chosen by evolution, one set for searches that have time for a
few passes over the nets, one for some dozens, one for hundreds and one for more. Numbers are
rounded. How the sets were found, what they bring on other problems and what they cost, is in
docs/routers.md.
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np

from marouting import Problem
from marouting.problem.grid import VIA_AXIS
from policies.routers.pathfinder.options import PathfinderOptions

SECONDS_PER_POINT = 6e-8
"""Processor time that a pass takes per Gcell in the boxes of all nets, about."""

MARGIN = 2
"""Gcells by which such a box extends beyond the net's pins on each side."""

TUNED: dict[float, dict[str, Any]] = {
    20.0: {
        "exact_pins": 3,
        "present_growth": 1.29,
        "history_increment": 0.4,
        "stall_passes": 13,
        "min_wirelength_gain": 0.0004,
        "reroute_fraction": 0.2,
        "repair_after": 7,
    },
    100.0: {
        "margin": 1,
        "exact_pins": 2,
        "present_factor": 0.028,
        "present_growth": 1.2,
        "history_increment": 0.65,
        "step_decay": 0.05,
        "stall_passes": 13,
        "reroute_fraction": 0.08,
        "lp_after_pass": 10,
        "lp_passes": 3,
        "lp_price_scale": 13.5,
        "repair_after": 3,
    },
    600.0: {
        "margin": 1,
        "exact_pins": 3,
        "present_factor": 0.018,
        "history_increment": 0.65,
        "step_decay": 0.0,
        "stall_passes": 13,
        "min_wirelength_gain": 0.0007,
        "reroute_fraction": 0.0,
        "lp_passes": 3,
        "lp_price_scale": 13.5,
        "repair_after": 3,
    },
    np.inf: {
        "exact_pins": 4,
        "present_factor": 0.074,
        "present_growth": 1.103,
        "history_increment": 0.64,
        "history_decay": 0.85,
        "step_decay": 0.21,
        "stall_passes": 19,
        "reroute_fraction": 0.49,
        "repair_after": 3,
    },
}
"""The options of searches that have time for fewer passes than the number before them."""


def passes_in_time(problem: Problem, seconds: float | None) -> float:
    """About how many passes over the nets a search makes in so much processor time."""
    if seconds is None:
        return np.inf
    low, high = problem.pin_boxes()
    reach = np.minimum(high - low + 1 + 2 * MARGIN, problem.grid)[:, :VIA_AXIS]
    points = float(reach[problem.to_route].prod(axis=1).sum()) * problem.grid[VIA_AXIS]
    return np.inf if points == 0 else seconds / (SECONDS_PER_POINT * points)


def scheduled(options: PathfinderOptions, problem: Problem) -> PathfinderOptions:
    """The options by which a problem is routed: what has its default is as the schedule says."""
    if options.schedule == "standard":
        return options
    passes = passes_in_time(problem, options.seconds)
    tuned = next((values for most, values in TUNED.items() if passes < most), TUNED[np.inf])
    default = {field.name: field.default for field in fields(options)}
    left = {name: value for name, value in tuned.items() if getattr(options, name) == default[name]}
    return replace(options, schedule="standard", **left)
