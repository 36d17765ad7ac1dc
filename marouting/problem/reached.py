"""Where routes reach pins: one of the Gcells that each pin has shapes in."""

import numpy as np
from numpy.typing import NDArray

from marouting.problem.chip import Places
from marouting.problem.grid import AXES, distinct, is_among
from marouting.problem.parts import joined_parts
from marouting.problem.problem import Problem


def pins_reached(
    problem: Problem, net: NDArray[np.int64], edge: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(pins,) the Gcell of every pin where edges (k,) of nets (k,) reach it.

    See :func:`pins_among`. The pins of a net without edges are in the first Gcell where all of them
    are, if there is one.
    """
    places = None if problem.chip is None else problem.chip.places
    if places is None:
        return problem.gcell_of_pins
    near = edge // AXES
    far = near + problem.strides[edge - AXES * near]
    ends = np.stack((near, far)) + int(np.prod(problem.grid)) * net
    vertices = distinct(np.concatenate((ends.reshape(-1), _shared_places(problem, places, net))))
    starts, stops = np.searchsorted(vertices, ends)
    part = joined_parts(starts, stops, len(vertices))
    return pins_among(problem, vertices, part)


def pins_among(
    problem: Problem, vertices: NDArray[np.int64], part: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(pins,) the Gcell where routes reach each pin; where the problem has it, if they do not.

    Of a pin that is reached in several Gcells it is one in the part of the route that holds most of
    the net's pins: so a part that holds all of them is found. In this part it is the Gcell where
    the problem has the pin, or else the first one.

    Args:
        problem: the problem.
        vertices: nets · G + Gcell of all Gcells of routes, ascending.
        part: for each the part of the route that it belongs to, the index of one of them.
    """
    own = problem.gcell_of_pins
    places = None if problem.chip is None else problem.chip.places
    if places is None:
        return own
    pins = np.arange(len(own))
    pin = np.concatenate((pins, np.repeat(pins, np.diff(places.first))))
    gcell = np.concatenate((own, places.gcell))
    key = problem.net_of_pins[pin] * int(np.prod(problem.grid)) + gcell
    touched = np.flatnonzero(is_among(key, vertices))
    pin, at = pin[touched], part[np.searchsorted(vertices, key[touched])]
    # Among parts with equally many pins it is the one with most pins where the problem has them.
    held = np.bincount(distinct(at * len(pins) + pin) // len(pins), minlength=len(part))
    as_given = np.bincount(at[touched < len(pins)], minlength=len(part))
    order = np.lexsort((touched, at, -as_given[at], -held[at], pin))
    reached, first = np.unique(pin[order], return_index=True)
    chosen = gcell[touched[order[first]]]
    if (chosen == own[reached]).all():
        return own
    found = own.copy()
    found[reached] = chosen
    return found


def _shared_places(
    problem: Problem, places: Places, routed: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Nets · G + Gcell of the first Gcell that all pins of a net without edges have in common."""
    size = int(np.prod(problem.grid))
    pins = np.diff(places.first_pin)
    owner = np.repeat(np.arange(len(pins)), pins)
    pin = np.repeat(np.arange(len(owner)), np.diff(places.first))
    without = ~is_among(owner[pin], routed)
    each = np.unique(np.stack((owner[pin] * size + places.gcell, pin), axis=1)[without], axis=0)
    key, count = np.unique(each[:, 0], return_counts=True)
    shared = key[count == pins[key // size]]
    return shared[np.unique(shared // size, return_index=True)[1]]
