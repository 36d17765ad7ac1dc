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

    See :func:`pins_among`. A Gcell in which all pins of a net are joins them without any edge.
    """
    places = None if problem.chip is None else problem.chip.places
    if places is None:
        return problem.gcell_of_pins
    near = edge // AXES
    far = near + problem.strides[edge - AXES * near]
    ends = np.stack((near, far)) + int(np.prod(problem.grid)) * net
    vertices = distinct(np.concatenate((ends.reshape(-1), _shared_places(problem, places))))
    starts, stops = np.searchsorted(vertices, ends)
    part = joined_parts(starts, stops, len(vertices))
    return pins_among(problem, vertices, part)


def pins_among(
    problem: Problem, vertices: NDArray[np.int64], part: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(pins,) the Gcell where routes reach each pin; where the problem has it, if they do not.

    Of a pin that is reached in several Gcells it is one in the part of the route that holds most of
    the net's pins: so a part that holds all of them is found. Of equal parts it is the first one
    with edges. In this part it is the Gcell where the problem has the pin, or else the first one.

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
    held = np.bincount(distinct(at * len(pins) + pin) // len(pins), minlength=len(part))
    alone = np.bincount(part)[at] == 1
    order = np.lexsort((touched, at, alone, -held[at], pin))
    reached, first = np.unique(pin[order], return_index=True)
    chosen = gcell[touched[order[first]]]
    if (chosen == own[reached]).all():
        return own
    found = own.copy()
    found[reached] = chosen
    return found


def _shared_places(problem: Problem, places: Places) -> NDArray[np.int64]:
    """Nets · G + Gcell of the first Gcell that all pins of a net have in common."""
    size = int(np.prod(problem.grid))
    pins = np.diff(places.first_pin)
    owner = np.repeat(np.arange(len(pins)), pins)
    pin = np.repeat(np.arange(len(owner)), np.diff(places.first))
    order = np.lexsort((pin, owner[pin] * size + places.gcell))
    each = (owner[pin] * size + places.gcell)[order]
    again = np.zeros(len(each), np.bool_)  # a pin that is listed twice in one Gcell
    again[1:] = (each[1:] == each[:-1]) & (pin[order][1:] == pin[order][:-1])
    key, count = np.unique(each[~again], return_counts=True)
    shared = key[count == pins[key // size]]
    return shared[np.unique(shared // size, return_index=True)[1]]
