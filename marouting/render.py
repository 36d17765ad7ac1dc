"""Pictures of a running game: text for a terminal, RGB frames for videos, or a window.

All three draw the same :class:`Scene`, a moment of an engine's game. Nothing here needs more than
numpy, except that :class:`Window` loads matplotlib when it is first shown.
"""

import colorsys
import contextlib
import enum
import functools
import math
import os
import sys
import textwrap
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.game import NOBODY, Status
from marouting.problem.grid import AXES, VIA_AXIS, Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


@dataclass(frozen=True, eq=False)
class Scene:
    """One moment of the game, as pictures show it.

    Attributes:
        grid: the grid of Gcells.
        capacity: (E,) int32, capacity of every edge at the start, in tracks.
        remaining: (E,) int32, remaining capacity now; negative for an overflowed edge.
        nets: (uses,) int64, the net of each use of an edge by a net, including vias; ordered by
            edge, and within an edge by the turn order of the nets.
        edges: (uses,) int64, the edge.
        active: (n,) int64, the nets that are still being routed.
        heads: (n,) int32, the Gcell that the route of each of them has reached.
        targets: (n,) int32, the Gcell of the target pin of each of them.
        labels: their agents' names.
        turn: index into ``heads`` of the net to move next; None if all nets move or none does.
        caption: one line about the moment, such as "step 12  joined 3/50  overflow 0".
    """

    grid: Grid
    capacity: NDArray[np.int32]
    remaining: NDArray[np.int32]
    nets: NDArray[np.int64]
    edges: NDArray[np.int64]
    active: NDArray[np.int64]
    heads: NDArray[np.int32]
    targets: NDArray[np.int32]
    labels: tuple[str, ...]
    turn: int | None
    caption: str


def scene_of(engine: Engine, m: int = 0) -> Scene:
    """The present state of one of an engine's games; the caption tells its rip-up round."""
    agents, game, nets = engine.agents[m], engine.games[m], engine.nets[m]
    active = np.flatnonzero(agents["status"] == Status.ACTIVE)
    turn = np.flatnonzero(active == game["agent"])
    place = np.zeros(len(engine.problems[m].nets), np.int64)
    order = engine.static.order[m]
    order = order[order != NOBODY]
    place[nets[order]] = np.arange(len(order))
    net, edge = engine.solution(m).uses
    sorting = np.lexsort((place[net], edge))
    now = engine.metrics(m)
    again = f"round {game['round']}  " if game["round"] else ""
    return Scene(
        grid=engine.grid,
        capacity=engine.static.capacity[m],
        remaining=engine.dynamic.remaining[m].copy(),
        nets=net[sorting],
        edges=edge[sorting],
        active=nets[active].astype(np.int64),
        heads=agents["cell"][active],
        targets=agents["target"][active],
        labels=tuple(f"net_{net}" for net in nets[active]),
        turn=int(turn[0]) if game["agent"] != NOBODY and len(turn) else None,
        caption=f"{again}step {now.steps}  joined {now.joined}/{now.tasks}  "
        f"overflow {now.overflow}  wirelength {now.wirelength}",
    )


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
        [
            EdgeState.ABSENT,
            EdgeState.OVERFLOWED,
            EdgeState.ABSENT,
            EdgeState.FULL,
            EdgeState.USED,
        ],
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


# RGB --------------------------------------------------------------------------------------------

_SHORTEST, _LONGEST = 200, 1200  # bounds of the longer side of a picture, px
_PITCH = 48  # distance between Gcells if there is room, px
_SMALLEST = 4  # with a smaller pitch, a Gcell and its edges cannot be told apart, px
_ROOMY = 12  # with a smaller pitch, nets side by side cannot be told apart, px

_BACKGROUND = (255, 255, 255)
_GCELL = (208, 211, 217)
_FREE = (232, 234, 239)
_OVERFLOWED = (214, 39, 40)
_INK = (20, 20, 20)
_HALO = (255, 196, 61)  # background of the head and the target of the net to move

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

# Viridis from light to dark: on a white background, dark means heavily used.
_RAMP = np.array(
    [(253, 231, 37), (94, 201, 98), (33, 145, 140), (59, 82, 139), (68, 1, 84)], np.float64
)

# 5 columns for each letter, two hexadecimal digits a column; the lowest bit is the top row of 8.
_FONT = {
    " ": "0000000000", "%": "2313086462", "(": "001c224100", ")": "0041221c00", "+": "08083e0808",
    ",": "0080703000", "-": "0808080808", ".": "0000606000", "/": "2010080402", ":": "0000140000",
    "=": "1414141414", "?": "0201590906", "_": "4040404040",
    "0": "3e5149453e", "1": "00427f4000", "2": "7249494946", "3": "2141494d33", "4": "1814127f10",
    "5": "2745454539", "6": "3c4a494931", "7": "4121110907", "8": "3649494936", "9": "464949291e",
    "a": "2054547840", "b": "7f28444438", "c": "3844444428", "d": "384444287f", "e": "3854545418",
    "f": "00087e0902", "g": "18a4a49c78", "h": "7f08040478", "i": "00447d4000", "j": "2040403d00",
    "k": "7f10284400", "l": "00417f4000", "m": "7c04780478", "n": "7c08040478", "o": "3844444438",
    "p": "fc18242418", "q": "18242418fc", "r": "7c08040408", "s": "4854545424", "t": "04043f4424",
    "u": "3c4040207c", "v": "1c2040201c", "w": "3c4030403c", "x": "4428102844", "y": "4c9090907c",
    "z": "4464544c44",
}  # fmt: skip
_ADVANCE, _LINE = 6, 10  # px of a letter of scale 1, with the space to the next, and of a line
_CAPTION = 64  # letters of a caption that there is room for


@dataclass(frozen=True)
class _Layout:
    """Where everything is in a picture, in px; the same for every scene of a grid shape.

    Attributes:
        pitch: distance between Gcells.
        columns: panels side by side, one for each layer.
        rows: panels one above the other.
        margin: around the panels.
        header: above each panel, for its name.
        shrink: how many pixels of the drawing, along each side, become one of the picture.
        scale: pixels of the drawing for a pixel of the font.
        lines: lines of the caption.
        roomy: whether nets are drawn side by side.
        layers: how many panels there are.
        width: of the drawing.
    """

    pitch: int
    columns: int
    rows: int
    margin: int
    header: int
    shrink: int
    scale: int
    lines: int
    roomy: bool
    layers: int
    width: int

    @staticmethod
    def of(shape: tuple[int, int, int], tracks: int) -> "_Layout":
        """The layout for a grid shape; ``tracks`` are the most that an edge has."""
        width, height, layers = shape
        # About as many columns of layers as rows; two layers are side by side.
        columns = math.ceil(math.sqrt(layers))
        rows = math.ceil(layers / columns)
        longest = max(columns * width, rows * height)
        # All lengths are even, because video encoders need even sides.
        pitch = min(max(_PITCH, math.ceil(_SHORTEST / longest)), 9 * _LONGEST // (10 * longest))
        pitch = max(pitch // 2 * 2, _SMALLEST)
        margin = max(pitch // 4 * 2, 8)
        side = longest * pitch + (max(columns, rows) + 1) * margin
        shrink = max(1, math.ceil(side / _LONGEST))
        across = _up_to(columns * (width * pitch + margin) + margin, 2 * shrink)
        scale = shrink * (2 if across >= 400 * shrink else 1)
        letters = max(1, (across - 2 * margin) // (_ADVANCE * scale))
        lines = 1 if letters >= _CAPTION else math.ceil(1.3 * _CAPTION / letters)
        roomy = pitch >= _ROOMY and tracks <= pitch // 4 * 2
        return _Layout(
            pitch, columns, rows, margin, 20 * shrink, shrink, scale, lines, roomy, layers, across
        )


def rgb_array(scene: Scene) -> NDArray[np.uint8]:
    """Draws the scene as a picture, with a panel for each layer and y pointing upwards.

    The caption stands above, a legend below. Gcells are grey squares, and the roads between them
    are edges. Where there is room for it, every net that uses an edge is a line on it, in the
    colour that the net has in all pictures; edges that are used up have dark borders, overflowed
    ones red borders. Otherwise edges are bars, and used ones go from yellow over green to dark
    violet (full); overflowed ones are red and wide. Edges without capacity are left out. A black
    dot in a Gcell means that a via up or down from it is in use. Discs are the heads of the nets,
    and outlined squares their targets; the net to move has them on a yellow background.

    Returns:
        (H, W, 3) uint8. H and W are even and the same for every scene of a problem; the longer one
        is between about 200 and 1200. (Grids of more than about 250 Gcells per side are drawn
        larger and shrunk.)
    """
    inside = np.arange(scene.grid.edges) % AXES != VIA_AXIS
    tracks = int(scene.capacity.max(initial=1, where=inside))
    layout = _Layout.of(scene.grid.shape, tracks)
    tiles = _draw_gcells(scene, layout, max(tracks, 1))
    return _arrange(tiles, scene, layout)


def _draw_gcells(scene: Scene, layout: _Layout, tracks: int) -> NDArray[np.uint8]:
    """(G, pitch, pitch, 3) uint8, a tile for every Gcell with its square and half of each edge."""
    grid, pitch = scene.grid, layout.pitch
    state = edge_states(scene)
    square = max(2, pitch // 4 * 2)
    inset = (pitch - square) // 2
    tiles = np.empty((grid.gcells, pitch, pitch, 3), np.uint8)
    tiles[:] = _BACKGROUND
    if scene.turn is not None:
        tiles[[scene.heads[scene.turn], scene.targets[scene.turn]]] = _HALO
    # The rows of a picture run downwards, so north has the low indices.
    low, high = slice(0, inset), slice(inset + square, pitch)

    def bars(edges: NDArray[np.integer], across: slice, colour: Any) -> None:
        """Draws bars of some edges; ``across`` says where between the borders of a tile."""
        near, far = grid.ends(edges)
        for axis, sides in ((0, (high, low)), (1, (low, high))):
            chosen = edges % AXES == axis
            ink = colour[chosen][:, None, None] if isinstance(colour, np.ndarray) else colour
            for gcells, side in zip((near, far), sides, strict=True):
                rows, columns = (side, across) if axis else (across, side)
                tiles[gcells[chosen], rows, columns] = ink

    def of(which: EdgeState) -> NDArray[np.intp]:
        return np.flatnonzero(state == which)

    if layout.roomy:
        line = square // tracks
        start = (pitch - line * tracks) // 2
        border = max(1, pitch // 16)
        room = np.where(state == EdgeState.FULL, scene.capacity, tracks)
        for which, width, ink in (
            (EdgeState.FULL, border, _INK), (EdgeState.OVERFLOWED, 2 * border, _OVERFLOWED)
        ):  # fmt: skip
            edges = of(which)
            for own in np.unique(room[edges]).tolist():
                across = slice(start - width, start + line * own + width)
                bars(edges[room[edges] == own], across, ink)
        first = np.searchsorted(scene.edges, scene.edges)
        slot = np.arange(len(scene.edges)) - first
        there = np.flatnonzero(grid.exists & (state != EdgeState.ABSENT))
        for track in range(tracks):
            across = slice(start + track * line, start + (track + 1) * line)
            bars(
                there[(scene.capacity[there] > track) | (state[there] == EdgeState.OVERFLOWED)],
                across,
                _FREE,
            )
            mine = slot == track
            bars(scene.edges[mine], across, PALETTE[scene.nets[mine] % len(PALETTE)])
    else:
        bar = 2 * max(1, pitch // 10)
        wide = min(2 * bar, square)
        shown = np.flatnonzero(state != EdgeState.ABSENT)
        middle = slice((pitch - bar) // 2, (pitch + bar) // 2)
        bars(shown, middle, _shade(scene, state)[shown])
        bars(of(EdgeState.OVERFLOWED), slice((pitch - wide) // 2, (pitch + wide) // 2), _OVERFLOWED)
    tiles[:, inset : inset + square, inset : inset + square] = _GCELL

    # Distance from the middle of the tile, in half pixels.
    distance = 2 * np.indices((pitch, pitch)) - (pitch - 1)
    radius, reach = np.hypot(*distance), np.abs(distance).max(axis=0)
    outline = (reach < square) & (reach > square - 2 * max(1, pitch // 12))
    disc = radius < max(0.75 * square, 2)
    rim = disc & (radius > 0.75 * square - 2 * max(1, pitch // 24))
    dot = radius < max(0.3 * square, 1.5)

    def stamp(gcells: NDArray[np.integer], mask: NDArray[np.bool_], ink: Any) -> None:
        rows, columns = np.nonzero(mask)
        tiles[gcells[:, None], rows, columns] = ink

    own = PALETTE[scene.active % len(PALETTE)][:, None]
    everyone = np.arange(len(own))
    for who in (everyone, everyone[scene.turn :][:1] if scene.turn is not None else everyone[:0]):
        # Once more the net to move, which is in the foreground.
        stamp(scene.targets[who], outline, own[who])
        stamp(scene.heads[who], disc, own[who])
        if pitch >= _ROOMY:
            stamp(scene.heads[who], rim, _INK)
    stamp(_via_gcells(scene), dot, _INK)
    return tiles


def _shade(scene: Scene, state: NDArray[np.int8]) -> NDArray[np.uint8]:
    """(E, 3) uint8, the colour of every edge by its utilisation."""
    capacity = np.maximum(scene.capacity, 1).astype(np.float64)
    utilisation = (capacity - scene.remaining) / capacity
    stops = np.linspace(0, 1, len(_RAMP))
    ramp = np.stack([np.interp(utilisation, stops, c) for c in _RAMP.T], axis=1)
    ramp[state == EdgeState.FREE] = _FREE
    ramp[state == EdgeState.OVERFLOWED] = _OVERFLOWED
    return ramp.astype(np.uint8)


def _arrange(tiles: NDArray[np.uint8], scene: Scene, layout: _Layout) -> NDArray[np.uint8]:
    """Joins the tiles of each layer, puts the layers next to one another, and adds the words."""
    width, height, _ = scene.grid.shape
    pitch, margin, header, scale = layout.pitch, layout.margin, layout.header, layout.scale
    panel = (height * pitch, width * pitch)
    top = layout.lines * _LINE * scale + margin // 2
    legend = _legend(layout)
    bottom = top + layout.rows * (header + panel[0] + margin)
    canvas = np.full(
        (_up_to(bottom + len(legend), 2 * layout.shrink), layout.width, 3), _BACKGROUND, np.uint8
    )
    letters = max(1, (layout.width - 2 * margin) // (_ADVANCE * scale))
    words = textwrap.wrap(scene.caption, letters, replace_whitespace=False)[: layout.lines]
    for n, words_of_line in enumerate(words):
        _write(canvas, words_of_line, (margin // 2 + n * _LINE * scale, margin), scale)
    panels = tiles.reshape(*scene.grid.shape, pitch, pitch, 3)[:, ::-1].transpose(2, 1, 3, 0, 4, 5)
    for layer, picture in enumerate(panels):
        row, column = divmod(layer, layout.columns)
        above = top + row * (header + panel[0] + margin)
        left = margin + column * (panel[1] + margin)
        picture = picture.reshape(*panel, 3)
        canvas[above + header : above + header + panel[0], left : left + panel[1]] = picture
        name = f"layer {layer + 1}"
        if _ADVANCE * scale * len(name) > panel[1]:
            name = f"l{layer + 1}"
        _write(canvas, name, (above + header - 9 * scale, left), scale)
    canvas[bottom : bottom + len(legend)] = legend
    if layout.shrink == 1:
        return canvas
    shrink = layout.shrink
    blocks = canvas.reshape(canvas.shape[0] // shrink, shrink, -1, shrink, 3)
    return np.asarray(blocks.mean(axis=(1, 3)), np.uint8)


@functools.lru_cache(maxsize=16)
def _legend(layout: _Layout) -> NDArray[np.uint8]:
    """(height, width, 3) uint8, what the marks and colours mean."""
    scale = layout.scale
    side = 8 * scale
    distance = 2 * np.indices((side, side)) - (side - 1)
    radius, reach = np.hypot(*distance), np.abs(distance).max(axis=0)

    def mark(*parts: tuple[Any, Any]) -> NDArray[np.uint8]:
        sample = np.full((side, side, 3), _BACKGROUND, np.uint8)
        for where, colour in parts:
            sample[where] = colour
        return sample

    third = [slice((1 + 2 * k) * scale, (3 + 2 * k) * scale) for k in range(3)]
    nets = [(part, PALETTE[k]) for k, part in enumerate(third)]
    entries = [
        (mark((radius < 0.9 * side, _INK), (radius < 0.7 * side, PALETTE[0])), "head"),
        (mark(((reach < side) & (reach > 0.6 * side), PALETTE[0])), "target"),
        (mark((slice(None), _HALO)), "to move"),
    ]  # fmt: skip
    if layout.layers > 1:
        entries.append((mark((slice(None), _GCELL), (radius < 0.5 * side, _INK)), "via"))
    if layout.roomy:
        ends = [slice(0, scale), slice(7 * scale, None)]
        entries += [
            (mark(*nets), "nets, by colour"),
            (mark(*nets, *((end, _INK) for end in ends)), "full"),
            (mark(*nets, *((end, _OVERFLOWED) for end in ends)), "overflowed"),
        ]
    else:
        steps = np.linspace(0, len(_RAMP) - 1, side)
        ramp = np.stack([np.interp(steps, range(len(_RAMP)), c) for c in _RAMP.T], axis=1)
        entries += [
            (mark((slice(None), ramp.astype(np.uint8))), "used to full"),
            (mark((slice(None), _OVERFLOWED)), "overflowed"),
        ]
    places = []
    line, left = 0, layout.margin
    for sample, name in entries:
        width = side + scale * (_ADVANCE * len(name) + 10)
        if left > layout.margin and left + width - 10 * scale > layout.width:
            line, left = line + 1, layout.margin
        places.append((line * _LINE * scale, left, sample, name))
        left += width
    height = (line + 1) * _LINE * scale + layout.margin // 2
    picture = np.full((height, layout.width, 3), _BACKGROUND, np.uint8)
    for top, left, sample, name in places:
        space = picture[top : top + side, left : left + side]
        space[:] = sample[:, : space.shape[1]]
        _write(picture, name, (top, left + side + 3 * scale), scale)
    picture.setflags(write=False)
    return picture


def _up_to(length: int, unit: int) -> int:
    """The smallest multiple of ``unit`` that is at least ``length``."""
    return -(-length // unit) * unit


def _write(picture: NDArray[np.uint8], text: str, at: tuple[int, int], scale: int) -> None:
    """Writes a line of text; ``at`` is its upper left corner. What does not fit is left out."""
    letters = _lettering(text, scale)
    space = picture[at[0] : at[0] + letters.shape[0], at[1] : at[1] + letters.shape[1]]
    space[letters[: space.shape[0], : space.shape[1]]] = _INK


@functools.lru_cache(maxsize=256)
def _lettering(text: str, scale: int) -> NDArray[np.bool_]:
    """(8 · scale, 6 · scale · len(text)) bool, where the letters have ink."""
    columns = b"".join(bytes.fromhex(_FONT.get(c, _FONT["?"])) + b"\0" for c in text.lower())
    bits = np.unpackbits(np.frombuffer(columns, np.uint8)[None], axis=0, bitorder="little")
    return bits.astype(np.bool_).repeat(scale, axis=0).repeat(scale, axis=1)


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
        """Shows a frame and waits ``1 / fps`` seconds, during which the window stays responsive.

        Args:
            rgb: (H, W, 3) uint8.
            fps: frames per second; 0 does not wait.
        """
        if not self._works:
            return
        try:
            if self._figure is None:
                self._open(rgb)
            self._draw(rgb, fps)
        except ImportError as error:
            self._give_up(f"{error}; matplotlib comes with marouting[learn]")
        except Exception as error:
            # Toolkits raise their own exceptions when a display is missing or disappears, and a
            # game must not end because it cannot be shown.
            self._give_up(f"there is no display: {error}")

    def close(self) -> None:
        """Closes the window, if there is one; the next :meth:`show` opens a new one."""
        if self._figure is not None:
            from matplotlib import pyplot

            # The display may have disappeared in the meantime.
            with contextlib.suppress(Exception):
                pyplot.close(self._figure)
        self._figure = self._image = None

    def _open(self, rgb: NDArray[np.uint8]) -> None:
        # Some toolkits abort the program if there is no display, so this is checked first.
        if sys.platform.startswith("linux") and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ):
            raise RuntimeError("DISPLAY is not set")
        from matplotlib import pyplot

        dpi = 100
        figure = pyplot.figure(figsize=(rgb.shape[1] / dpi, rgb.shape[0] / dpi), dpi=dpi)
        if figure.canvas.required_interactive_framework is None:
            pyplot.close(figure)
            raise RuntimeError(f"matplotlib's backend {pyplot.get_backend()} opens no windows")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._figure, self._image = figure, axes.imshow(rgb)
        figure.show()

    def _draw(self, rgb: NDArray[np.uint8], fps: float) -> None:
        from matplotlib import pyplot

        if self._figure is None or self._image is None:
            return
        if not pyplot.fignum_exists(self._figure.number):
            return
        self._image.set_data(rgb)
        self._figure.canvas.draw_idle()
        if fps > 0:
            self._figure.canvas.start_event_loop(1 / fps)
        else:
            self._figure.canvas.flush_events()

    def _give_up(self, reason: str) -> None:
        self._works = False
        self._figure = self._image = None
        warnings.warn(
            f'render_mode="human" cannot open a window: {reason} '
            '(render_mode="rgb_array" or "ansi" works without one)',
            stacklevel=3,
        )
