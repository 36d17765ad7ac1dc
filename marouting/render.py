"""Pictures of a running game: text for a terminal, RGB frames for videos, or a window.

All three draw the same :class:`Scene`, a moment of a game; pictures on the :class:`Sheet` of its
problem. Nothing here needs more than numpy, except that :class:`Window` loads matplotlib when it is
first shown.
"""

import base64
import colorsys
import contextlib
import enum
import functools
import math
import os
import sys
import textwrap
import warnings
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from marouting.columns import Games
from marouting.game import NOBODY, Status
from marouting.problem.grid import AXES, VIA_AXIS, Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


@dataclass(frozen=True, eq=False)
class Scene:
    """One moment of the game, as pictures show it."""

    grid: Grid  # the grid of Gcells
    capacity: NDArray[np.int32]  # (E,) of every edge at the start, in tracks
    remaining: NDArray[np.int32]  # (E,) what is left now; negative if it overflows
    nets: NDArray[np.int64]  # (uses,) the net of each use of an edge, by edge and turn order
    edges: NDArray[np.int64]  # (uses,) int64, the edge
    active: NDArray[np.int64]  # (n,) int64, the nets that are still being routed
    heads: NDArray[np.int32]  # (n,) int32, the Gcell that the route of each of them has reached
    targets: NDArray[np.int32]  # (n,) int32, the Gcell of the target pin of each of them
    labels: tuple[str, ...]  # their agents' names
    turn: int | None  # index into ``heads`` of the only net to move next, if any
    caption: str  # one line about the moment, such as "step 12 joined 3/50 overflow 0"


def scene_of(games: Games, m: int = 0) -> Scene:
    """The present state of one of several games; the caption tells its rip-up round."""
    status, nets = games.agents["status"][m], games.nets[m]
    now = {name: games.games[name][m] for name in ("agent", "round", "steps", *_TOLD)}
    active = np.flatnonzero(status == Status.ACTIVE)
    turn = np.flatnonzero(active == now["agent"])
    place = np.zeros(len(games.problems[m].nets), np.int64)
    order = games.order[m]
    order = order[order != NOBODY]
    place[nets[order]] = np.arange(len(order))
    net, edge = games.solution(m).uses
    sorting = np.lexsort((place[net], edge))
    again = f"round {now['round']}  " if now["round"] else ""
    return Scene(
        grid=games.grid,
        capacity=games.problems[m].capacity,
        remaining=games.remaining[m].copy(),
        nets=net[sorting],
        edges=edge[sorting],
        active=nets[active].astype(np.int64),
        heads=games.agents["cell"][m, active],
        targets=games.agents["target"][m, active],
        labels=tuple(f"net_{net}" for net in nets[active]),
        turn=int(turn[0]) if now["agent"] != NOBODY and len(turn) else None,
        caption=f"{again}step {now['steps']}  joined {now['joined']}/{games.tasks[m].sum()}  "
        f"overflow {now['overflow']}  wirelength {now['wirelength']}",
    )


_TOLD = ("joined", "overflow", "wirelength")


class EdgeState(enum.IntEnum):
    """How far an edge is used up; a picture draws each state differently."""

    ABSENT = 0  #: no capacity, or off the grid
    FREE = 1
    USED = 2
    FULL = 3  #: capacity used up exactly
    OVERFLOWED = 4


def edge_states(scene: Scene) -> NDArray[np.int8]:
    """(E,) int8, the EdgeState of every edge; an edge used without capacity is overflowed."""
    capacity, remaining = scene.capacity, scene.remaining
    state = np.select(
        [~scene.grid.exists, remaining < 0, capacity <= 0, remaining == 0, remaining < capacity],
        [EdgeState.ABSENT, EdgeState.OVERFLOWED, EdgeState.ABSENT, EdgeState.FULL, EdgeState.USED],
        EdgeState.FREE,
    )
    return state.astype(np.int8)


def _via_gcells(scene: Scene) -> NDArray[np.intp]:
    """The Gcells at both ends of the vias in use, possibly with repetitions."""
    return np.concatenate(scene.grid.ends(scene.edges[scene.edges % AXES == VIA_AXIS]))


# Text -------------------------------------------------------------------------------------------

# One glyph for each EdgeState.
_ALONG_X = np.array(list(" ╌─━×"))
_ALONG_Y = np.array(list(" ╎│┃×"))
# The distance between Gcells is three columns and two rows, which looks about square.
_COLUMNS, _ROWS = 3, 2


def ansi(scene: Scene) -> str:
    """Draws the scene as text: caption, one map per layer with layer 1 first, legend.

    As in the figures, each map has row Y − 1 on top and column 0 on the left. Edges are drawn
    between the Gcells that they join. The head and target of the net to move are ``H`` and ``T``;
    those of the other nets are ``h`` and ``t``.

    Returns:
        Lines joined by newlines, plain Unicode without escape sequences.
    """
    grid = scene.grid
    width, height, layers = grid.shape
    state = edge_states(scene).reshape(width, height, layers, AXES)
    gcells = np.full(grid.gcells, "·")
    gcells[_via_gcells(scene)] = "o"
    gcells[scene.targets] = "t"
    gcells[scene.heads] = "h"
    if scene.turn is not None:
        gcells[scene.targets[scene.turn]] = "T"
        gcells[scene.heads[scene.turn]] = "H"
    gcells = gcells.reshape(grid.shape)

    # The canvas has row 0 first; the output has it last.
    canvas = np.full((layers, _ROWS * (height - 1) + 1, _COLUMNS * (width - 1) + 1), " ")
    canvas[:, ::_ROWS, ::_COLUMNS] = gcells.transpose(2, 1, 0)
    along_x = _ALONG_X[state[:-1, :, :, 0]].transpose(2, 1, 0)
    for column in range(1, _COLUMNS):
        canvas[:, ::_ROWS, column::_COLUMNS] = along_x
    canvas[:, 1::_ROWS, ::_COLUMNS] = _ALONG_Y[state[:, :-1, :, 1]].transpose(2, 1, 0)

    margin = len(str(height - 1))
    every = 1 if width <= 100 else 5
    ruler = "".join(f"{x:<{_COLUMNS * every}}" for x in range(0, width, every)).rstrip()
    lines = [scene.caption] if scene.caption else []
    for layer in range(layers):
        lines += ["", f"layer {layer + 1}"]
        for row in range(canvas.shape[1] - 1, -1, -1):
            y, between = divmod(row, _ROWS)
            label = "" if between else str(y)
            lines.append(f"{label:>{margin}} {''.join(canvas[layer, row])}".rstrip())
        lines.append(f"{'':{margin}} {ruler}")
    mover = ""
    if scene.turn is not None:
        mover = f"H head and T target of {scene.labels[scene.turn]}, to move; "
    lines += [
        "",
        f"{mover}h heads and t targets of {'other' if mover else 'the'} nets; o via",
        "edges: ╌ free  ─ used  ━ full  × overflowed  (blank: no capacity)",
    ]
    return "\n".join(lines)


# Pictures ---------------------------------------------------------------------------------------

_SHORTEST, _LONGEST = 200, 1200  # bounds of the longer side of a picture, px
_PITCH = 48  # distance between Gcells if there is room, px
_SMALLEST = 2  # a smaller pitch is drawn at this one and shrunk, px
_ROOMY = 16  # with a smaller pitch, nets side by side cannot be told apart, px
_MARK = 3  # the least reach of heads and targets, px

Ink = tuple[int, ...]
"""A colour: red, green and blue, 0 to 255."""

Pixels = NDArray[np.uint8]
"""(H, W, 3), a picture."""

_BACKGROUND = (255, 255, 255)
_GCELL = (208, 211, 217)
_FREE = (232, 234, 239)
_OVERFLOWED = (226, 88, 12)
_INK = (20, 20, 20)
_HALO = (255, 196, 61)  # around the head and the target of the net to move

PALETTE = np.array(
    [
        [
            round(255 * part)
            # Hues one golden ratio apart: neighbours differ, and no hue comes again.
            for part in colorsys.hls_to_rgb(
                (0.58 + 0.618034 * i) % 1, (0.42, 0.56, 0.3)[i % 3], 0.8
            )
        ]
        for i in range(48)
    ],
    np.uint8,
)
"""(48, 3) uint8, the colours of nets: net i has the colour i % 48, in every picture."""

USE: tuple[tuple[float, Ink], ...] = (
    (0.0, (242, 245, 250)),
    (0.5, (143, 180, 217)),
    (1.0, (18, 58, 117)),
    (1.001, (247, 165, 43)),
    (2.0, (140, 13, 13)),
)
"""The colours of demand / capacity in all pictures: pale to dark blue, orange to red above 1."""

# DejaVu Sans Mono, the printable characters of ASCII from the space on, side by side in one picture
# with 2 bits a pixel, compressed.
_FONT = (
    "eNrdlr9v20YUxx95rQSS1qZBhU5RBhp4cWWTDq6J0qbgLe3WoYCHDhkE1wWyBDgYHBTAgDl1KBJAyZIOCcDRQ4YOGTy0"
    "KP+AFuDSrQMH/QEeMiiA7PQ9Uj9s13aADikQAiTuJ+9z733fuwP4oJ6R8x4WEQWAl81rPn+Q3kMu24mVIURX/+CVrTcW"
    "Ffu7ecnKxPugL1fiknOK3k5mZapcTWEntha6KjUGomXpdfAKW3O7pRfD0Cu6WTtv53AUHNWLaOIVXrH8i1fUxyKLito4"
    "GgXTYFovQhlMvKOwgxCv96VXBDQ+ovf3EyUHjbymOqYRHQsI2U5Ea+tT9Ppy+vq/6O0Ffc33iqfQAt6Rlaxu2XP+sBdb"
    "mR/7sf2LD50m+Ij9ePmXproh67nCTiuMkdZcb4aSLGi4NvzyrsQYexirITbtREkjR27L9xF6gsZamZueVY74j/T7Jze2"
    "noJkevqrN1rQDxSShwmsZnxQAEZhiCIhq30CsEOLGccdKYkQItMrqOg3c4T7Dz6X1NNRkuYA0ytMHWcgDcSC1rKylqr8"
    "9yn5zjsgP028g7Wim3QzRAH7w7WC+7wD9zcv35/4aCT5DsOVYCI0q2RO74Sr+gFeI3ra42n6XEmiVxA7JshvF5CiH/aY"
    "vjbeP24nkD5506AdMjXTmxn9Fxrhhxe3ydrYMVKpOyU9qu8f13N3BLkgvVuZkaXl1Tp2mjgkYo3Dnl9GbSpg91HPR+rD"
    "oafxep3c7uPI6Ri/BWqDVfa6ogdYGVxLasnu16WHstWt/eNZDCc3nxN96hUtslgfIfeK/h73POTP0E6eOTKMCqYPJsHE"
    "/BpNmT5KELb/vHmP6HtGRjSL6WW4/YcgtduJoHWsec5pYek7JYUOiZDp12jE9jcET30KXbIL07fUNu1eKhjV2fbZxldV"
    "rLydWq92DtO/OBtYmVVqiqNTaLY98cShAeQyYvvlkl7oHz9GpXoL28vK9p+RcrYfb/5tZDAm29Ncpm8Mbj13R3ZSp1Uo"
    "vmb07YlPcw3uT4U2M/qNrKIPpS9DdMBNmX7F7D4SScOQ6ln3ybeHs+1n1j3rp3SPea1ZJqhihXXv0gDyRmkdJcvMDDPl"
    "wDMnmqjGQvclvTahQRg0wpccEax3kEzvjO7cl7R2g22UzOkVVrYPYWl7Vs7S9pRVfaZ30ls/uyM3dc9ELXVmq0Qf71XR"
    "zPTcKhIHOOcg+EMw12PEOvSxGbPvq6gV+skbsm1vkXNK+p2U90L0e0jg5BvJTIi1rDdUXOKMki/oh6T7j0j3Ldb9jL4v"
    "NNOj6pHuHYoN7qvl60OpSDvn6DeT9hgO2y+Wp5Uo6SXppzuNJu0CTJfU60K78EZlzqlGaQNpIxpX+R7BG5f6T8JGcEz0"
    "d72C2grltkn3XiEyVGnDTjjfw2BO3z2Y5Zyx0N6Bj9GU6DvWhOmrnOPwSUT5SGRSxVJkwWR5Ws3iU5+9KVR9eNlZuZjZ"
    "effBai68KYTLm8Kpx4fFKbxoaJ07Z/X5m8Ip+tlTqw6rS4Bqy9Lrd9L7F7ZeaJhmPFfD5fT15R7+5+ftydm6l/M30FfR"
    "r38wF+J/ABnyg7o="
)
_ADVANCE, _HEIGHT, _LINE = 8, 16, 18  # px of a letter of scale 1, and of a line of text
_CAPTION = 80  # letters of a caption that there is room for
_WIDEST_SIGN = 160  # px of the widest entry of a legend with letters of scale 1


def colour_of(net: int) -> Ink:
    """A net's colour, one of :data:`PALETTE`."""
    return _COLOURS[net % len(_COLOURS)]


_COLOURS = [tuple(colour) for colour in PALETTE.tolist()]


def rgb_array(scene: Scene) -> NDArray[np.uint8]:
    """Draws the scene as a picture, with a panel for each layer and y pointing upwards.

    The caption stands above, a legend below. Gcells are grey squares, and edges are the gaps
    between them. Where there is room for it, every net that uses an edge is a line on it, in the
    colour that the net has in all pictures (a thinner one where an edge has more nets than any edge
    has tracks); edges that are used up have dark borders, overflowed ones orange borders. Otherwise
    every edge is a field between its two Gcells, whose colour says how full it is: pale to dark
    blue (full), and orange to red where it overflows. Edges without capacity are left out. A black
    dot in a Gcell means that a via up or down from it is in use.
    Discs are the heads of the nets, and outlined squares their targets; those of the net to move
    have yellow frames.

    Returns:
        (H, W, 3) uint8. H and W are even and the same for every scene of a problem; the longer one
        is between about 200 and 1300. (Where a Gcell has less than 2 px, the picture is drawn
        larger and shrunk.)
    """
    sheet = Sheet.of(scene)
    canvas = sheet.canvas.copy()
    sheet.draw(canvas, scene)
    shrink = sheet.shrink
    if shrink == 1:
        return canvas
    blocks = canvas.reshape(canvas.shape[0] // shrink, shrink, -1, shrink, 3)
    return np.asarray(blocks.mean(axis=(1, 3)), np.uint8)


def _box(canvas: Pixels, x: int, y: int, reach: int, ink: Ink) -> None:
    """Draws a filled square around a point."""
    canvas[y - reach : y + reach, x - reach : x + reach] = ink


def _disc(canvas: Pixels, x: int, y: int, radius: int, ink: Ink) -> None:
    canvas[y - radius : y + radius, x - radius : x + radius][_round(radius)] = ink


def _words(canvas: Pixels, x: int, y: int, text: str, scale: int) -> None:
    """Draws a line of text in letters 8 · scale px wide and 16 · scale px high, as far as fits."""
    letters = _lettering(text, scale)
    space = canvas[y:, x:][: letters.shape[0], : letters.shape[1]]
    np.minimum(space, letters[: space.shape[0], : space.shape[1]], out=space)


@functools.lru_cache(maxsize=64)
def _round(radius: int) -> NDArray[np.bool_]:
    distance = 2 * np.indices((2 * radius, 2 * radius)) - (2 * radius - 1)
    return np.hypot(*distance) < 2 * radius


@functools.lru_cache(maxsize=256)
def _lettering(text: str, scale: int) -> NDArray[np.uint8]:
    """(16 · scale, 8 · scale · len(text), 1) uint8, letters on white, from white to black."""
    letters = _letters()
    known = [ord(c) - ord(" ") if " " <= c <= "~" else ord("?") - ord(" ") for c in text]
    drawn = letters[:, known].reshape(_HEIGHT, -1, 1)
    return drawn.repeat(scale, axis=0).repeat(scale, axis=1)


@functools.cache
def _letters() -> NDArray[np.uint8]:
    """(16, 95, 8) uint8, each letter on white."""
    bits = np.unpackbits(np.frombuffer(zlib.decompress(base64.b64decode(_FONT)), np.uint8))
    levels = bits.reshape(-1, 2) @ [2, 1]
    levels = levels[: _HEIGHT * 95 * _ADVANCE].reshape(_HEIGHT, 95, _ADVANCE)
    return np.array([255, 177, 98, _INK[0]], np.uint8)[levels]


class Sheet:
    """The picture of a problem before anything is routed, and where things are in it, in px.

    Attributes:
        shrink: how many of its pixels, along each side, become one of a scene's picture.
        pitch: distance between Gcells.
        square: side of a Gcell.
        mark: half the side of heads and targets.
        margin: around the panels, one for each layer.
        roomy: whether nets are drawn side by side.
        tracks: the most that an edge has.
        track: width of a net's line, or of an edge where nets are not drawn side by side.
        start: where the first one begins, from the border between two rows of Gcells.
        letters: how many of them, of size ``scale``, a line of the caption has.
        lines: how many lines the caption has.
    """

    def __init__(self, grid: Grid, capacity: NDArray[np.int32]) -> None:
        width, height, layers = grid.shape
        # About as many columns of panels as rows; two layers are side by side.
        columns = math.ceil(math.sqrt(layers))
        rows = math.ceil(layers / columns)
        longest = max(columns * width, rows * height)
        pitch = min(max(_PITCH, math.ceil(_SHORTEST / longest)), 9 * _LONGEST // (10 * longest))
        pitch = pitch // 2 * 2 if pitch >= _ROOMY else max(pitch, _SMALLEST)
        self.pitch, self.square = pitch, max(2, pitch // 4 * 2)
        shrink = longest * pitch / (_LONGEST - 9 * (max(columns, rows) + 1))
        # Whole Gcells become a pixel, or a Gcell whole pixels: no pattern comes of it.
        self.shrink = 1 if shrink <= 1 else _up_to(math.ceil(shrink), _SMALLEST)
        self.mark = max(self.square // 2, _MARK * self.shrink)
        self.margin = margin = max(pitch // 4 * 2, 8 * self.shrink)
        # Video encoders need even sides.
        self.scale = self.shrink
        panels = columns * (width * pitch + margin) + margin
        across = _up_to(max(panels, _WIDEST_SIGN * self.scale + 2 * margin), 2 * self.shrink)
        self.letters = max(1, (across - 2 * margin) // (_ADVANCE * self.scale))
        self.lines = math.ceil(_CAPTION / self.letters)

        inside = grid.exists & (np.arange(grid.edges) % AXES != VIA_AXIS)
        self.tracks = int(capacity.max(initial=1, where=inside))
        self.roomy = pitch >= _ROOMY and self.tracks <= self.square
        self.track = self.square // self.tracks if self.roomy else pitch
        self.start = (pitch - self.track * self.tracks) // 2 if self.roomy else 0

        self._grid, line = grid, _LINE * self.scale
        x, y, z = np.unravel_index(np.arange(grid.gcells), grid.shape)
        row, column = np.divmod(z, columns)
        panel = line + height * pitch + margin
        self._x = margin + column * (width * pitch + margin) + x * pitch + pitch // 2
        top = (self.lines + 1) * line + 6 * self.scale
        self._y = top + row * panel + (height - 1 - y) * pitch + pitch // 2
        free = np.flatnonzero(inside & (capacity > 0))
        end = self.start + self.track * (capacity[free] if self.roomy else 1)
        bottom = top - line + rows * panel
        # The legend has a line for each of its signs, at most.
        canvas = np.full((bottom + 8 * line, across, 3), _BACKGROUND, np.uint8)
        self._bars(canvas, free, self.start, end, _FREE, whole=not self.roomy)
        for gcell in range(grid.gcells if self.roomy else 0):
            _box(canvas, *self._at(gcell), self.square // 2, _GCELL)
        fits = 8 * _ADVANCE * self.scale <= width * pitch + margin
        for layer in range(layers):
            x0, y0 = self._at(grid.number(0, height - 1, layer))
            name = f"{'layer ' if fits else 'l'}{layer + 1}"
            _words(canvas, x0 - pitch // 2, y0 - pitch // 2 - line, name, self.scale)
        last = self._legend(canvas, layers > 1, bottom, across - margin)
        self.canvas = canvas[: _up_to(last + line + margin // 2, 2 * self.shrink)]
        self.canvas.setflags(write=False)

    @staticmethod
    def of(scene: Scene) -> "Sheet":
        """The sheet of a scene, which all scenes of its problem share."""
        return _sheet(scene.grid, scene.capacity.tobytes())

    def draw(self, canvas: Pixels, scene: Scene) -> None:
        """Draws what a scene adds to its sheet."""
        state = edge_states(scene)
        (self._nets if self.roomy else self._uses)(canvas, scene, state)
        half, rim = self.mark, max(1, self.pitch // 12)
        at = [self._at(gcell) for gcell in scene.targets.tolist()]
        heads = [self._at(gcell) for gcell in scene.heads.tolist()]
        inks, turn = [colour_of(net) for net in scene.active.tolist()], scene.turn
        # The net to move is in the foreground.
        nets = sorted(range(len(inks)), key=lambda n: n == turn)
        if self.roomy:
            for gcell in np.unique(_via_gcells(scene)).tolist():
                _disc(canvas, *self._at(gcell), max(1, round(0.3 * half)), _INK)
        if turn is not None:
            for reach, ink in ((half + 2 * rim, _HALO), (half, _GCELL)):
                _box(canvas, *at[turn], reach, ink)
                _box(canvas, *heads[turn], reach, ink)
        for n in nets:
            _box(canvas, *at[n], half, inks[n])
        for n in nets:
            _box(canvas, *at[n], half - rim, _GCELL)
        for n in nets:
            _disc(canvas, *heads[n], max(1, half), _INK)
        for n in nets:
            _disc(canvas, *heads[n], max(1, round(half - rim / 2)), inks[n])
        for row, text in enumerate(textwrap.wrap(scene.caption, self.letters)[: self.lines]):
            _words(canvas, self.margin, (2 + row * _LINE) * self.scale, text, self.scale)

    def _nets(self, canvas: Pixels, scene: Scene, state: NDArray[np.int8]) -> None:
        """Every use of an edge as a line; full and overflowed edges have borders."""
        border = max(1, self.pitch // 16)
        full, over = (np.flatnonzero(state == s) for s in (EdgeState.FULL, EdgeState.OVERFLOWED))
        room = self.start + self.track * np.minimum(scene.capacity[full], self.tracks)
        most = self.start + self.track * self.tracks
        self._bars(canvas, full, self.start - border, room + border, _INK)
        self._bars(canvas, over, self.start - 2 * border, most + 2 * border, _OVERFLOWED)
        self._bars(canvas, full, self.start, room, _FREE)
        self._bars(canvas, over, self.start, most, _FREE)
        inside = scene.edges % AXES != VIA_AXIS
        edges = scene.edges[inside]
        first = np.searchsorted(edges, edges)
        slot, uses = np.arange(len(edges)) - first, np.searchsorted(edges, edges, "right") - first
        # Where there are more nets than tracks, lines are as much thinner.
        wide, share = most - self.start, np.maximum(uses, self.tracks)
        low = self.start + slot * wide // share
        high = np.maximum(self.start + (slot + 1) * wide // share, low + 1)
        inks = PALETTE[scene.nets[inside] % len(PALETTE)]
        self._bars(canvas, edges, low, high, inks, whole=True)

    def _uses(self, canvas: Pixels, scene: Scene, state: NDArray[np.int8]) -> None:
        """Every edge in use as a field that shows how full it is, the fullest on top."""
        used = np.flatnonzero(state >= EdgeState.USED)
        capacity = np.maximum(scene.capacity[used], 1)
        share = (scene.capacity[used] - scene.remaining[used]) / capacity
        order = np.argsort(share, kind="stable")
        share = np.where(scene.capacity[used] > 0, share, USE[-1][0])[order]
        stops, colours = zip(*USE, strict=True)
        inks = np.stack([np.interp(share, stops, part) for part in np.array(colours).T], axis=1)
        self._bars(canvas, used[order], 0, self.pitch, inks, whole=True)

    def _bars(
        self, canvas: Pixels, edges: NDArray[np.integer], low: Any, high: Any, inks: Any,
        whole: bool = False,
    ) -> None:  # fmt: skip
        """Draws bars on edges inside layers, ``low`` to ``high`` beyond the border of two rows.

        ``whole`` ones run from the middle of a Gcell to that of the next, others between Gcells.
        """
        near, far = self._grid.ends(edges)
        low, high = low - self.pitch // 2, high - self.pitch // 2
        half = 0 if whole else self.square // 2
        x, y = self._x[near], self._y[near]
        along_x = np.stack((x + half, y + low, self._x[far] - half, y + high), axis=1)
        along_y = np.stack((x + low, self._y[far] + half, x + high, y - half), axis=1)
        sides = np.where((edges % AXES == 0)[:, None], along_x, along_y).tolist()
        inks = np.broadcast_to(np.asarray(inks).astype(np.uint8), (len(sides), 3))
        for (left, top, right, bottom), ink in zip(sides, inks, strict=True):
            canvas[top:bottom, left:right] = ink

    def _at(self, gcell: int) -> tuple[int, int]:
        """The middle of a Gcell."""
        return int(self._x[gcell]), int(self._y[gcell])

    def _legend(self, canvas: Pixels, vias: bool, top: int, right: int) -> int:
        """Draws what the marks and colours mean; returns where the last line of it begins."""
        unit = 2 * self.scale
        side, net = 8 * unit, [colour_of(n) for n in range(3)]
        lines = [(0, (1 + 2 * n) * unit, side, (3 + 2 * n) * unit, net[n]) for n in range(3)]

        def box(inset: int, ink: Ink) -> tuple[Any, ...]:
            return inset, inset, side - inset, side - inset, ink

        # Discs by radius and boxes by their sides, each with its colour.
        signs: dict[str, list[tuple[Any, ...]]] = {
            "head": [(4 * unit, _INK), (3 * unit, net[0])],
            "target": [box(0, net[0]), box(unit, _BACKGROUND)],
            "to move": [box(0, _HALO)],
        }
        if vias and self.roomy:
            signs["via"] = [box(0, _GCELL), (2 * unit, _INK)]
        if self.roomy:
            signs["nets, by colour"] = lines
            signs["full"] = [box(0, _INK), *lines]
            signs["overflowed"] = [box(0, _OVERFLOWED), *lines]
        else:
            ramp = [ink for _, ink in USE]
            for words, part in (("free to full", ramp[:3]), ("overflowed", ramp[3:])):
                wide = side // len(part)
                signs[words] = [(n * wide, 0, (n + 1) * wide, side, i) for n, i in enumerate(part)]
        left = self.margin
        for words, sign in signs.items():
            width = side + self.scale * _ADVANCE * len(words) + 3 * unit
            if left > self.margin and left + width > right:
                top, left = top + _LINE * self.scale, self.margin
            at = canvas[top:, left:]
            for *sides, ink in sign:
                if len(sides) == 1:
                    _disc(at, side // 2, side // 2, sides[0], ink)
                else:
                    at[sides[1] : sides[3], sides[0] : sides[2]] = ink
            _words(canvas, left + side + 3 * unit, top, words, self.scale)
            left += width + 7 * unit
        return top


@functools.lru_cache(maxsize=8)
def _sheet(grid: Grid, capacity: bytes) -> Sheet:
    return Sheet(grid, np.frombuffer(capacity, np.int32))


def _up_to(length: int, unit: int) -> int:
    """The smallest multiple of ``unit`` that is at least ``length``."""
    return -(-length // unit) * unit


# Window -----------------------------------------------------------------------------------------


class Window:
    """A window for ``render_mode="human"``. If none can be opened, it warns once and does nothing.

    It needs a display and matplotlib (extra ``learn``) with a backend that opens windows. It never
    blocks: a frame takes no longer than ``1 / fps`` seconds. If the user closes the window, it
    stays closed until :meth:`close` is called.
    """

    def __init__(self) -> None:
        self._figure: Figure | None = None
        self._image: AxesImage | None = None
        self._works = True

    def show(self, rgb: NDArray[np.uint8], fps: float) -> None:
        """Shows a frame (H, W, 3) uint8, then stays responsive for ``1 / fps`` seconds, if any."""
        if not self._works:
            return
        try:
            self._draw(rgb, fps)
            return
        except ImportError as error:
            reason = f"{error}; matplotlib comes with marouting[learn]"
        except Exception as error:
            # Toolkits raise their own exceptions when a display is missing or disappears, and a
            # game must not end because it cannot be shown.
            reason = f"there is no display: {error}"
        self._works = False
        self._figure = self._image = None
        warnings.warn(
            f'render_mode="human" cannot open a window: {reason} '
            '(render_mode="rgb_array" or "ansi" works without one)',
            stacklevel=2,
        )

    def close(self) -> None:
        """Closes the window, if there is one; the next :meth:`show` opens a new one."""
        if self._figure is not None:
            from matplotlib import pyplot

            # The display may have disappeared in the meantime.
            with contextlib.suppress(Exception):
                pyplot.close(self._figure)
        self._figure = self._image = None

    def _draw(self, rgb: NDArray[np.uint8], fps: float) -> None:
        # Some toolkits abort the program if there is no display, so this is checked first.
        if sys.platform.startswith("linux") and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ):
            raise RuntimeError("DISPLAY is not set")
        from matplotlib import pyplot

        if self._figure is None:
            dpi = 100
            figure = pyplot.figure(figsize=(rgb.shape[1] / dpi, rgb.shape[0] / dpi), dpi=dpi)
            if figure.canvas.required_interactive_framework is None:
                pyplot.close(figure)
                raise RuntimeError(f"matplotlib's backend {pyplot.get_backend()} opens no windows")
            axes = figure.add_axes((0, 0, 1, 1))
            axes.set_axis_off()
            self._figure, self._image = figure, axes.imshow(rgb)
            figure.show()
        if self._image is None or not pyplot.fignum_exists(self._figure.number):
            return
        self._image.set_data(rgb)
        self._figure.canvas.draw_idle()
        if fps > 0:
            self._figure.canvas.start_event_loop(1 / fps)
        else:
            self._figure.canvas.flush_events()
