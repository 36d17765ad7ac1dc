"""Scenarios in which selfish nets pay: decentralised games whose best joint routes are known.

All nets move in turns, once: no net is ripped up, full edges are closed, and what a net sees is
local. ``docs/cooperation.md`` shows the levels and what selfishness costs in each.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from marouting.problem.field import Field
from marouting.problem.problem import Problem
from marouting.scenarios.planning import RandomNets, random_nets
from marouting.scenarios.scenario import Scenario, routable

Range = tuple[int, int]  # the least and the largest value, both included


def one_shot(
    channels: tuple[str, ...] = ("capacity", "own", "heads"), *, layers: int = 1, **options: Any
) -> dict[str, Any]:
    """Options of a game that is played once, by nets that see a window of radius 3.

    Args:
        channels: what the window shows.
        layers: layers of the grid.
        options: further options, or others in place of these.
    """
    return {
        "agents": "multi",
        "turn_order": "round_robin",
        "mask": {"visited": True},
        "release_failed": True,
        "observation": {
            "kind": "window",
            "radius": 3,
            "layers": layers - 1,
            "channels": list(channels),
        },
        "reward": {"kind": "team", "overflow": 20.0, "open": 20.0},
        **options,
    }


TRAINING = {
    "games": 128, "problems": 4096, "steps": 1_500_000, "evaluate_every": 1000, "policy": "last",
}  # fmt: skip
"""How a training runs: about three minutes of one core.

The last network is saved: a good one solves all validation problems, so they cannot tell it from a
better one."""


def _drawn(rng: np.random.Generator, ends: Range) -> int:
    return int(rng.integers(ends[0], ends[1] + 1))


Place = tuple[int, int]  # column and row
Pins = list[tuple[Place, Place]]  # two for each net


def _finished(field: Field, rng: np.random.Generator, nets: Pins) -> Problem:
    """The problem with these nets in random order and, by chance, columns and rows reversed."""
    for net in rng.permutation(len(nets)).tolist():
        field.net(*nets[net])
    columns, rows = (rng.random(2) < 0.5).tolist()
    return field.mirrored(columns=columns, rows=rows).problem()


@dataclass(frozen=True, kw_only=True)
class Gates:
    """Draws walls with narrow gates, which captives may need, and wide ones a detour away.

    The wall lies between two columns. On the last Gcell before it, seven rows make a motif: in the
    middle row a **narrow gate** of one or two tracks, and 1 to 3 rows below it a **wide gate**,
    through which all nets fit. Above the narrow gate a pocket of 2 or 3 Gcells opens into the
    gate's own Gcell, which is closed towards the wide gate. **Captive** nets start at the pocket's
    end: their only way is the narrow gate. **Flexible** nets start further left; the narrow gate is
    the nearest for them. A flexible net in a narrow gate that a captive needs saves itself a small
    detour, and the captive is lost. All problems are feasible: there are never more captives than
    tracks of their gate.
    """

    columns: Range = (8, 8)  # of the part of the grid that is used; the rest is closed
    wall: Range = (3, 3)  # column left of the wall, counted from 0; at most columns − 4
    motifs: Range = (1, 1)  # narrow gates, each in seven rows of its own
    rows: int = 7  # of the grid
    tracks: Range = (1, 1)  # of a narrow gate
    flexible: Range = (1, 3)  # flexible nets at each narrow gate

    def __call__(self, rng: np.random.Generator) -> Problem:
        """Draws a problem."""
        field, nets = Field(self.columns[1], self.rows), Pins()
        columns, motifs = _drawn(rng, self.columns), _drawn(rng, self.motifs)
        wall = min(_drawn(rng, self.wall), columns - 4)
        field.wall(right_of=wall)
        first = _drawn(rng, (0, self.rows - 7 * motifs))
        for motif in range(motifs):
            self._draw_motif(field, rng, nets, first + 7 * motif, wall, columns - 1)
        if columns < self.columns[1]:
            field.area(columns=(columns, self.columns[1] - 1), rows=(0, self.rows - 1))
        whole = (0, self.columns[1] - 1)
        for low, high in ((0, first - 1), (first + 7 * motifs, self.rows - 1)):
            if low <= high:
                field.area(columns=whole, rows=(low, high))
        return _finished(field, rng, nets)

    def _draw_motif(
        self, field: Field, rng: np.random.Generator, nets: Pins, first: int, wall: int, last: int
    ) -> None:
        """Draws seven rows from row ``first``, with targets up to column ``last``."""
        upright = rng.random() < 0.5

        def row(of_motif: int) -> int:
            return first + (of_motif if upright else 6 - of_motif)

        def close_between(low: int) -> None:
            field.wall(above=min(row(low), row(low + 1)), columns=(wall, wall))

        gate, depth, detour = 3, _drawn(rng, (2, 3)), _drawn(rng, (1, 3))
        tracks = _drawn(rng, self.tracks)
        field.gate(right_of=wall, row=row(gate), tracks=tracks)
        field.gate(right_of=wall, row=row(gate - detour))
        field.gate(right_of=wall - 1, row=row(gate), tracks=tracks)
        close_between(gate - 1)
        for pocket in range(gate + 1, gate + depth + 1):
            field.gate(right_of=wall - 1, row=row(pocket), tracks=0)
        if depth < 3:
            close_between(gate + depth)
        elif 0 <= (beyond := row(gate + depth) + (1 if upright else -1)) < self.rows:
            field.wall(above=min(row(gate + depth), beyond), columns=(wall, wall))
        for _ in range(_drawn(rng, (0, tracks))):
            nets.append(((wall, row(gate + depth)), (_drawn(rng, (wall + 1, last)), row(gate))))
        for _ in range(_drawn(rng, self.flexible)):
            start = _drawn(rng, (0, wall - 1)), row(_drawn(rng, (gate, gate + 1)))
            nets.append(
                (start, (_drawn(rng, (wall + 1, last)), row(_drawn(rng, (gate, gate + 1)))))
            )


@dataclass(frozen=True)
class Braess:
    """Draws a road map with a short-cut that makes all nets worse off when all take it.

    Nets start in a room on the left and end in one on the right. Two ways of equal length join the
    rooms, each through one narrow gate: the upper way leaves the left room by gate A, the lower way
    enters the right room by gate B. A short-cut from A to B makes the shortest way of all, but it
    takes a track of both gates. With c tracks per gate and n nets, 2c − n of them can take it (all,
    if n is at most c); if more do, others find both gates full.

    This is Braess's paradox ("Über ein Paradoxon aus der Verkehrsplanung", Unternehmensforschung
    12, 1968) with capacities in place of delays.
    """

    short_cut: bool = True  # without it, the same nets on the same map

    def __call__(self, rng: np.random.Generator) -> Problem:
        """Draws a problem."""
        tracks, width = _drawn(rng, (1, 2)), _drawn(rng, (3, 4))
        columns, middle, room = 8, 2, 1  # the left room ends with column 1
        first, last = room + 1, room + width
        field = Field(columns, 5).wall(right_of=room).wall(right_of=last)
        field.gate(right_of=room, row=middle, tracks=tracks).gate(right_of=room, row=0)
        field.gate(right_of=last, row=middle, tracks=tracks).gate(right_of=last, row=4)
        field.area(columns=(first, last - 1), rows=(1, 1))
        field.area(columns=(first + 1, last), rows=(3, 3))
        if not self.short_cut:
            field.gate(right_of=first, row=middle, tracks=0)
        if last + 3 < columns:
            field.area(columns=(last + 3, columns - 1), rows=(0, 4))
        nets, rows = Pins(), (middle - 1, middle + 1)
        fewest = tracks + 1 if rng.random() < 0.6 else 1
        for _ in range(_drawn(rng, (fewest, 2 * tracks))):
            start = _drawn(rng, (0, room)), _drawn(rng, rows)
            nets.append((start, (_drawn(rng, (last + 1, last + 2)), _drawn(rng, rows))))
        return _finished(field, rng, nets)


def crossing(rng: np.random.Generator) -> Problem:
    """Ten to twelve nets, half from left to right, half from bottom to top, through one square.

    Edges of the square in the middle have one track, those around it two. The nets cross it or go
    around it; no single one is to blame for congestion.
    """
    square, near, far = (2, 5), (0, 1), (6, 7)
    field = Field(8, 8, capacity=2).area(columns=square, rows=square, tracks=1)
    nets = Pins()
    for net in range(_drawn(rng, (10, 12))):
        start = _drawn(rng, near), _drawn(rng, square)
        end = _drawn(rng, far), _drawn(rng, square)
        nets.append((start, end) if net % 2 else (start[::-1], end[::-1]))
    return _finished(field, rng, nets)


def _once(
    name: str, description: str, draw: RandomNets, env: dict[str, Any], **options: Any
) -> Scenario:
    """A scenario of random nets that is played once."""
    return random_nets(name, description, draw, env=env, mirrors=True, **{**SIZES, **options})


SIZES: dict[str, Any] = {"validation": 50, "test": 100}
DRAWN: dict[str, Any] = {**SIZES, "training": TRAINING}  # of problems that are quick to draw

COOPERATION = (
    Scenario(
        "gates-8x7-v0",
        Gates(),
        description="A narrow gate that saves a detour, and a net that may have no other way.",
        env=one_shot(),
        **DRAWN,
    ),
    Scenario(
        "gates-2x-v0",
        Gates(motifs=(2, 2), rows=14),
        description="Two narrow gates, one above the other, each with nets of its own.",
        env=one_shot(),
        **DRAWN,
    ),
    Scenario(
        "gates-mixed-v0",
        Gates(columns=(7, 10), wall=(2, 6), motifs=(1, 2), rows=14, tracks=(1, 2), flexible=(1, 4)),
        description="One or two gates of one or two tracks; position, size and nets vary.",
        env=one_shot(),
        **DRAWN,
    ),
    Scenario(
        "braess-v0",
        Braess(),
        description="A short-cut that makes all worse off when all take it.",
        env=one_shot(),
        **DRAWN,
    ),
    Scenario(
        "crossing-v0",
        crossing,
        description="Ten to twelve nets through one square: congestion without a culprit.",
        accept=routable,
        env=one_shot(),
        **DRAWN,
    ),
    _once(
        "two-pin-once-8x8-v0",
        "Fifty two-pin nets that just fit, routed once.",
        RandomNets(grid=(8, 8, 2), nets=(50, 50), max_pins=(2, 2), capacity=(4, 4)),
        one_shot(layers=2),
    ),
    _once(
        "multi-pin-once-8x8-v0",
        "Thirty nets of up to five pins that just fit, routed once, each to its own tree.",
        RandomNets(grid=(8, 8, 2), nets=(30, 30), max_pins=(5, 5), capacity=(4, 4)),
        one_shot(("capacity", "own", "pins", "heads"), layers=2, target="tree", next_pin="nearest"),
    ),
    _once(
        "two-pin-once-32x32-v0",
        "Five hundred two-pin nets, routed once.",
        RandomNets(grid=(32, 32, 2), nets=(500, 500), max_pins=(2, 2), capacity=(9, 9)),
        one_shot(layers=2, reward={"kind": "team", "overflow": 80.0, "open": 80.0}),
        validation=10,
        test=20,
        open_cost=80,
    ),
    _once(
        "online-8x8-v0",
        "Twenty-four nets that arrive one by one; none sees those that are still to come.",
        RandomNets(grid=(8, 8, 2), nets=(24, 24), max_pins=(2, 2), capacity=(2, 2)),
        one_shot(("capacity", "own"), layers=2, turn_order="sequential", nets={"order": "file"}),
    ),
)
"""Scenarios for policies that decide by what they see, easiest first."""
