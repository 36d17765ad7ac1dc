"""Pictures of a running game: text for a terminal, RGB frames for videos, or a window.

All three draw the same :class:`Scene`, which the environments fill from the engine. Everything here
needs only numpy, except that :class:`Window` loads matplotlib when it is first shown.
"""

import colorsys
import contextlib
import enum
import functools
import math
import os
import sys
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from marouting.problem.grid import AXES, VIA_AXIS, Grid, Move

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
        used: (E,) int64, how many nets use each edge, including vias.
        heads: (n,) int32, the Gcell that each active net's route has reached.
        targets: (n,) int32, the Gcell of the target pin of each of them.
        labels: n agent names.
        turn: index into ``heads`` of the net to move next; None if all nets move or none does.
        caption: one line about the moment, such as "step 12  joined 3/50  overflow 0".
    """

    grid: Grid
    capacity: NDArray[np.int32]
    remaining: NDArray[np.int32]
    used: NDArray[np.int64]
    heads: NDArray[np.int32]
    targets: NDArray[np.int32]
    labels: tuple[str, ...]
    turn: int | None
    caption: str


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
    used = np.flatnonzero((scene.used > 0) & scene.grid.exists)
    return np.concatenate(scene.grid.ends(used[used % AXES == VIA_AXIS]))


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

_BACKGROUND = (255, 255, 255)
_GCELL = (208, 211, 217)
_FREE = (232, 234, 239)
_OVERFLOWED = (214, 39, 40)
_INK = (20, 20, 20)
_NET = (86, 180, 233)  # heads and targets of nets that wait
_TURN = (230, 97, 0)  # head and target of the net to move
_HALO = (255, 221, 176)  # background of these two Gcells

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

# 3 wide and 5 high, one bit per pixel from the top left.
_FONT = {
    "0": "111101101101111",
    "1": "010110010010111",
    "2": "111001111100111",
    "3": "111001111001111",
    "4": "101101111001001",
    "5": "111100111001111",
    "6": "111100111101111",
    "7": "111001001001001",
    "8": "111101111101111",
    "9": "111101111001111",
    "L": "100100100100111",
}


@dataclass(frozen=True)
class _Layout:
    """Where the layers are in a picture, in px; the same for every scene of a grid shape."""

    pitch: int
    columns: int
    rows: int
    margin: int
    header: int
    shrink: int

    @staticmethod
    def of(shape: tuple[int, int, int]) -> "_Layout":
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
        return _Layout(pitch, columns, rows, margin, 20 * shrink, shrink)


def rgb_array(scene: Scene) -> NDArray[np.uint8]:
    """Draws the scene as a picture, with a panel ("L1", "L2", …) per layer and y pointing upwards.

    Gcells are grey squares, and the edges between them are bars. Free edges are light; used ones go
    from yellow over green to dark violet (full); overflowed ones are red and wide; edges without
    capacity are left out. A black dot in a Gcell means that a via up or down from it is in use.
    Discs are the heads of the nets, and outlined squares their targets: orange on an orange
    background for the net to move, blue for the others.

    Returns:
        (H, W, 3) uint8. H and W are even and the same for every scene of a grid shape; the longer
        one is between about 200 and 1200. (Grids of more than about 250 Gcells per side are drawn
        larger and shrunk.)
    """
    layout = _Layout.of(scene.grid.shape)
    return _arrange(_draw_gcells(scene, layout.pitch), scene.grid, layout)


def _draw_gcells(scene: Scene, pitch: int) -> NDArray[np.uint8]:
    """(G, pitch, pitch, 3) uint8, a tile for every Gcell with its square and half of each edge."""
    grid = scene.grid
    state = edge_states(scene)
    colour = np.empty((grid.edges + 1, 3), np.uint8)
    colour[:-1] = _shade(scene, state)
    colour[-1] = _BACKGROUND  # OFF_GRID points here

    square = max(2, pitch // 4 * 2)
    inset = (pitch - square) // 2
    bar = 2 * max(1, pitch // 10)
    wide = min(2 * bar, square)
    middle, body = slice((pitch - bar) // 2, (pitch + bar) // 2), slice(inset, inset + square)
    broad = slice((pitch - wide) // 2, (pitch + wide) // 2)
    # The rows of a picture run downwards, so north has the low indices.
    low, high = slice(0, inset), slice(inset + square, pitch)
    tiles = np.empty((grid.gcells, pitch, pitch, 3), np.uint8)
    tiles[:] = _BACKGROUND
    if scene.turn is not None:
        tiles[[scene.heads[scene.turn], scene.targets[scene.turn]]] = _HALO
    overflowed = np.append(state == EdgeState.OVERFLOWED, False)
    absent = np.append(state == EdgeState.ABSENT, True)
    for move, side in ((Move.EAST, high), (Move.WEST, low), (Move.NORTH, low), (Move.SOUTH, high)):
        edge = grid.edge[:, move]
        along_x = move in (Move.EAST, Move.WEST)
        for which, across in ((~absent[edge], middle), (overflowed[edge], broad)):
            rows, columns = (across, side) if along_x else (side, across)
            tiles[which, rows, columns] = colour[edge[which]][:, None, None]
    tiles[:, body, body] = _GCELL

    # Distance from the middle of the tile, in half pixels.
    distance = 2 * np.indices((pitch, pitch)) - (pitch - 1)
    radius, reach = np.hypot(*distance), np.abs(distance).max(axis=0)
    line = max(1, pitch // 16)
    outline = (reach < square) & (reach > square - 2 * line)
    disc = radius < max(0.75 * square, 2)
    dot = radius < max(0.3 * square, 1.5)

    def stamp(
        gcells: NDArray[np.integer], mask: NDArray[np.bool_], ink: tuple[int, int, int]
    ) -> None:
        rows, columns = np.nonzero(mask)
        tiles[gcells[:, None], rows, columns] = ink

    stamp(scene.targets, outline, _NET)
    stamp(scene.heads, disc, _NET)
    if scene.turn is not None:
        turn = slice(scene.turn, scene.turn + 1)
        stamp(scene.targets[turn], outline, _TURN)
        stamp(scene.heads[turn], disc, _TURN)
    stamp(_via_gcells(scene), dot, _INK)
    return tiles


def _shade(scene: Scene, state: NDArray[np.int8]) -> NDArray[np.uint8]:
    """(E, 3) uint8, the colour of every edge."""
    capacity = np.maximum(scene.capacity, 1).astype(np.float64)
    utilisation = (capacity - scene.remaining) / capacity
    stops = np.linspace(0, 1, len(_RAMP))
    ramp = np.stack([np.interp(utilisation, stops, c) for c in _RAMP.T], axis=1)
    ramp[state == EdgeState.ABSENT] = _BACKGROUND
    ramp[state == EdgeState.FREE] = _FREE
    ramp[state == EdgeState.OVERFLOWED] = _OVERFLOWED
    return ramp.astype(np.uint8)


def _arrange(tiles: NDArray[np.uint8], grid: Grid, layout: _Layout) -> NDArray[np.uint8]:
    """Joins the tiles of each layer, and puts the layers next to one another."""
    width, height, _ = grid.shape
    pitch, margin, header = layout.pitch, layout.margin, layout.header
    panel = (height * pitch, width * pitch)
    unit = 2 * layout.shrink
    canvas = np.full(
        (
            _up_to(layout.rows * (header + panel[0] + margin), unit),
            _up_to(layout.columns * (panel[1] + margin) + margin, unit),
            3,
        ),
        _BACKGROUND,
        np.uint8,
    )
    panels = tiles.reshape(*grid.shape, pitch, pitch, 3)[:, ::-1].transpose(2, 1, 3, 0, 4, 5)
    for layer, picture in enumerate(panels):
        row, column = divmod(layer, layout.columns)
        top = row * (header + panel[0] + margin) + header
        left = margin + column * (panel[1] + margin)
        canvas[top : top + panel[0], left : left + panel[1]] = picture.reshape(*panel, 3)
        name = _lettering(f"L{layer + 1}", 2 * layout.shrink)
        # The name may be wider than a grid of one column.
        space = canvas[top - header + 5 * layout.shrink :, left:][: name.shape[0], : name.shape[1]]
        space[name[:, : space.shape[1]]] = _INK
    if layout.shrink == 1:
        return canvas
    shrink = layout.shrink
    blocks = canvas.reshape(canvas.shape[0] // shrink, shrink, -1, shrink, 3)
    return np.asarray(blocks.mean(axis=(1, 3)), np.uint8)


def _up_to(length: int, unit: int) -> int:
    """The smallest multiple of ``unit`` that is at least ``length``."""
    return -(-length // unit) * unit


@functools.lru_cache(maxsize=256)
def _lettering(text: str, scale: int) -> NDArray[np.bool_]:
    """(5 · scale, 4 · scale · len(text)) bool, where the letters have ink."""
    letters = [np.array(list(_FONT[c])).reshape(5, 3) == "1" for c in text]
    line = np.concatenate([np.pad(letter, ((0, 0), (0, 1))) for letter in letters], axis=1)
    return line.repeat(scale, axis=0).repeat(scale, axis=1)


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
