"""Scenarios in which selfish nets pay: decentralised games whose best joint routes are known.

All nets move in turns, once: no net is ripped up, full edges are closed, and what a net sees is
local. ``docs/cooperation.md`` shows the levels and what selfishness costs in each.
"""

from typing import Any

import numpy as np

from marouting.problem.field import Field
from marouting.problem.problem import Problem
from marouting.scenarios.scenario import Scenario

Range = tuple[int, int]  # the least and the largest value, both included


def one_shot(layers: int = 1, **options: Any) -> dict[str, Any]:
    """Options of a game that is played once, by nets that see a window of radius 3.

    Args:
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
            "channels": ["capacity", "own", "heads"],
        },
        **options,
    }


def _drawn(rng: np.random.Generator, ends: Range) -> int:
    return int(rng.integers(ends[0], ends[1] + 1))


def gates(rng: np.random.Generator) -> Problem:
    """A wall with a narrow gate, which a captive may need, and a wide one a detour away.

    The wall is right of column 3. Its narrow gate, of one track, is in row 3, the wide one 1 to 3
    rows below. Left of the narrow gate a pocket of 2 or 3 rows opens into the gate's Gcell, in
    column 3. With probability 1/2 a captive net starts at the pocket's end, whose only way out is
    the narrow gate. One to three flexible nets start further left; the narrow gate is nearest to
    them. Columns and rows may be reversed. All problems are feasible: the flexible nets fit through
    the wide gate.
    """
    field, gate, wall = Field(8, 7), 3, 3
    depth, detour = _drawn(rng, (2, 3)), _drawn(rng, (1, 3))
    field.wall(right_of=wall)
    field.gate(right_of=wall, row=gate, tracks=1).gate(right_of=wall, row=gate - detour)
    field.gate(right_of=wall - 1, row=gate, tracks=1)
    field.wall(right_of=wall - 1, rows=(gate + 1, gate + depth))
    field.wall(above=gate - 1, columns=(wall, wall))
    if gate + depth < 6:
        field.wall(above=gate + depth, columns=(wall, wall))
    nets = []
    if rng.random() < 0.5:
        nets.append(((wall, gate + depth), (_drawn(rng, (wall + 1, 7)), gate)))
    for _ in range(_drawn(rng, (1, 3))):
        start = _drawn(rng, (0, wall - 1)), _drawn(rng, (gate, gate + 1))
        nets.append((start, (_drawn(rng, (wall + 1, 7)), _drawn(rng, (gate, gate + 1)))))
    for net in rng.permutation(len(nets)).tolist():
        field.net(*nets[net])
    columns, rows = (rng.random(2) < 0.5).tolist()
    return field.mirrored(columns=columns, rows=rows).problem()


COOPERATION = (
    Scenario(
        "gates-8x7-v0",
        gates,
        description="Nets with a choice of two gates, and one that has none and may be shut in.",
        validation=50,
        test=100,
        env=one_shot(),
    ),
)
"""Scenarios for policies that decide by what they see, easiest first."""
