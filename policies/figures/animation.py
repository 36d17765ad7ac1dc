"""An episode as an animation: SVG that moves by itself, or GIF."""

import html
import io
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from marouting.batch.engine import Engine
from marouting.errors import InputError
from marouting.files import writing
from marouting.game import MOST_STEPS, NOBODY, TurnOrder
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import PALETTE, EdgeState, Scene, edge_states, rgb_array, scene_of
from marouting.search.guides import RouteFollower
from policies.figures.routes import shifts

HOLD = 2.0
"""Seconds that the last picture stays before the animation starts again."""


MOST_PARTS = 20_000
"""The most moving parts of an SVG that browsers play smoothly."""


def replay(
    problem: Problem, solution: Solution, turn_order: TurnOrder = "sequential"
) -> Iterator[Engine]:
    """Plays a solution as a game, in which every net walks along its own route.

    Args:
        problem: the problem.
        solution: its solution. Where it leaves a net open, the net goes on as A* would.
        turn_order: whether a net finishes before the next one starts, or all take turns.

    Yields:
        The same engine at the beginning and after every step.

    Raises:
        InputError: the solution belongs to another problem, or there is nothing to route.
    """
    engine = Engine([problem], turn_order=turn_order, overflow="allowed", max_steps=MOST_STEPS)
    guide = RouteFollower(engine, [solution])
    everyone = not engine.static.sequential
    yield engine
    while (engine.games["agent"] != NOBODY).any():
        moves = guide.moves(*engine.pairs(everyone=everyone))
        engine.step(moves.reshape(engine.nets.shape) if everyone else moves)
        yield engine


def record(states: Iterable[Engine], most: int = 240) -> list[Scene]:
    """Keeps moments of a game, evenly spaced: the first, the last, and at most ``most`` in all.

    Args:
        states: the engine of one game, again and again, as it goes on; any game, with rip-ups too.
        most: at least 2.

    Raises:
        InputError: ``most`` is less, or there is no state.
    """
    if most < 2:
        raise InputError(f"frames: expected at least 2, found {most}")
    scenes: list[Scene] = []
    every, step, engine = 1, -1, None
    for step, engine in enumerate(states):
        if step % every:
            continue
        if len(scenes) == most:
            scenes, every = scenes[::2], 2 * every
            if step % every:
                continue
        scenes.append(scene_of(engine))
    if engine is None:
        raise InputError("animation: expected a game with at least one state")
    if step % every:
        scenes = [*(scenes[::2] if len(scenes) == most else scenes), scene_of(engine)]
    return scenes


def save_animation(
    scenes: Sequence[Scene],
    problem: Problem,
    path: str | os.PathLike[str],
    title: str = "",
    fps: float | None = None,
) -> None:
    """Writes an animation, whole or not at all.

    Args:
        scenes: the moments, as from :func:`record`.
        problem: the problem that is played.
        path: the file; its suffix tells the format, ``.svg`` or ``.gif``.
        title: what the SVG is called.
        fps: pictures per second; None: 3 to 20, for an animation of about 12 seconds.

    Raises:
        InputError: the suffix is another, ``fps`` is out of range, there is too much for SVG, or
            the file cannot be written.
    """
    kind = animation_format(path)
    if fps is None:
        fps = float(np.clip(len(scenes) / 12, 3, 20))
    if not 0.1 <= fps <= 50:
        raise InputError(f"fps: expected 0.1 to 50 pictures per second, found {fps}")
    content = gif(scenes, fps) if kind == ".gif" else svg(scenes, problem, title, fps).encode()
    with writing(path) as temporary:
        temporary.write_bytes(content)


def animation_format(path: str | os.PathLike[str]) -> str:
    """``.svg`` or ``.gif``; raises InputError for a file with another suffix."""
    kind = Path(path).suffix.lower()
    if kind not in (".svg", ".gif"):
        raise InputError(f"{os.fspath(path)}: expected a name with the suffix .svg or .gif")
    return kind


# GIF ---------------------------------------------------------------------------------------------


def gif(scenes: Sequence[Scene], fps: float) -> bytes:
    """The pictures of :func:`marouting.render.rgb_array` as an animated GIF that repeats forever.

    Args:
        scenes: the moments; at least one.
        fps: pictures per second; GIF counts in hundredths of a second.
    """
    palette = _palette(scenes)
    if palette is None:  # shrunk drawings of large grids have many shades
        model = Image.fromarray(rgb_array(scenes[-1])).quantize(256, dither=Image.Dither.NONE)

    def picture(scene: Scene) -> Image.Image:
        pixels = rgb_array(scene)
        if palette is None:
            return Image.fromarray(pixels).quantize(palette=model, dither=Image.Dither.NONE)
        image = Image.fromarray(np.searchsorted(palette, _packed(pixels)).astype(np.uint8), "P")
        parts = np.stack([palette >> 16, palette >> 8 & 255, palette & 255], axis=1)
        image.putpalette(parts.astype(np.uint8).tobytes())
        return image

    last = len(scenes) - 1
    durations = [round(1000 / fps) + (n == last) * round(1000 * HOLD) for n in range(last + 1)]
    out = io.BytesIO()
    picture(scenes[0]).save(
        out,
        format="GIF",
        save_all=True,
        append_images=map(picture, scenes[1:]),
        duration=durations,
        loop=0,
    )
    return out.getvalue()


def _packed(pixels: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(H, W) the colours of pixels (H, W, 3) as numbers."""
    r, g, b = pixels.astype(np.uint32).transpose(2, 0, 1)
    return r << 16 | g << 8 | b


def _palette(scenes: Sequence[Scene]) -> NDArray[np.uint32] | None:
    """All colours of the pictures, ascending; None if they are more than a GIF can have."""
    found = np.empty(0, np.uint32)
    for scene in scenes:
        found = np.union1d(found, _packed(rgb_array(scene)))
        if len(found) > 256:
            return None
    return found


# SVG ---------------------------------------------------------------------------------------------

_STYLE = """\
text { font: 14px "DejaVu Sans Mono", Menlo, Consolas, monospace; fill: #202020; }
.title { font-weight: bold; } .sign { font-size: 12px; }
.route { fill: none; stroke-linecap: round; stroke-linejoin: round; }
.full { stroke: #ffd24d; } .over { stroke: #e0443a; }
.pin { stroke: #202020; } .head { stroke: #202020; }"""


class _Place(NamedTuple):
    """Where Gcells are in the drawing.

    Attributes:
        side: of a Gcell, px.
        left: x of the middle of column 0.
        bottom: y of the middle of row 0.
        shift: (nets,) px, of every net within its Gcells, along x = y.
        shape: of the grid.
    """

    side: float
    left: float
    bottom: float
    shift: NDArray[np.float64]
    shape: tuple[int, int, int]

    def of(self, gcells: NDArray[np.integer], net: int | None = None) -> NDArray[np.float64]:
        """(…, 2) px, where a net has its point in each Gcell; None: the middle."""
        x, y, _ = np.unravel_index(gcells, self.shape)
        shift = 0.0 if net is None else float(self.shift[net])
        return np.stack(
            [self.left + self.side * x + shift, self.bottom - self.side * y - shift], axis=-1
        )


def svg(scenes: Sequence[Scene], problem: Problem, title: str, fps: float) -> str:
    """The moments of a game as an SVG that moves by itself, without script, and repeats forever.

    All layers lie upon each other. Every net has its colour and its track within the Gcells; what
    a net gives back disappears. Discs are heads, squares are pins, and a frame is the target of the
    net to move. Full edges are yellow, overflowed ones red. The score counts above. Where nothing
    moves, as on paper, the last moment is shown.

    Args:
        scenes: the moments; at least one.
        problem: the problem that is played.
        title: what stands above.
        fps: moments per second.

    Returns:
        The text; the same for the same input.

    Raises:
        InputError: there are more than MOST_PARTS moving parts.
    """
    columns, rows, _ = problem.grid
    side = float(np.clip(720 / max(columns, rows), 6, 56))
    nothing = np.empty(0, np.int64)
    edges = [
        np.unique(np.concatenate([nothing, *(s.edges[s.nets == net] for s in scenes)]))
        for net in range(len(problem.nets))
    ]
    shift, pitch = shifts(problem, [Solution(problem, edges)])
    width = max(columns * side + 32, 592.0)
    place = _Place(
        side,
        (width - (columns - 1) * side) / 2,
        64 + (rows - 0.5) * side,
        side * shift,
        problem.grid,
    )
    clock = _Clock(len(scenes), fps)
    height = 64 + rows * side + 44
    line = float(np.clip(0.62 * pitch * side, 0.8, 3.2))

    body = [
        f'<path d="{_lattice(place)}" stroke="#e3e5e8" stroke-width="1"/>',
        *_bands(scenes, place, clock),
        f'<g class="route" stroke-width="{line:.2f}">',
        *_routes(scenes, problem, place, clock, line),
        "</g>",
        *_pins(problem, place, line),
        *_heads(scenes, problem, place, clock, line),
        *_score(scenes, clock),
        *_svg_legend(height - 18, line),
    ]
    parts = sum(part.count("<animate") for part in body)
    if parts > MOST_PARTS:
        raise InputError(
            f"animation: expected at most {MOST_PARTS} moving parts in an SVG, found {parts}: "
            "ask for fewer frames, or for a GIF"
        )
    # The name of a file may hold what XML does not take.
    name = html.escape("".join(c if c.isprintable() else ascii(c)[1:-1] for c in title))
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
            f'width="{width:g}" height="{height:g}">',
            f"<title>{name}</title>",
            f"<style>{_STYLE}</style>",
            '<rect width="100%" height="100%" fill="#fff"/>',
            f'<text class="title" x="16" y="24">{name}</text>',
            *body,
            "</svg>",
            "",
        ]
    )


class _Clock:
    """When moments are shown: each for the same time, the last one for longer."""

    def __init__(self, moments: int, fps: float) -> None:
        self.moments = moments
        self.length = moments / fps + HOLD
        self._share = 1 / fps / self.length

    def steps(self, attribute: str, values: Sequence[str]) -> str:
        """An animation of an attribute that has a value at each moment; empty if it is constant."""
        kept = [n for n, value in enumerate(values) if n == 0 or value != values[n - 1]]
        if len(kept) == 1:
            return ""
        times = ";".join(f"{n * self._share:.5f}".rstrip("0").rstrip(".") for n in kept)
        return (
            f'<animate attributeName="{attribute}" calcMode="discrete" dur="{self.length:g}s" '
            f'repeatCount="indefinite" values="{";".join(values[n] for n in kept)}" '
            f'keyTimes="{times}"/>'
        )

    def shown(self, there: Sequence[bool]) -> tuple[str, str]:
        """An attribute and an animation for something that is there at some moments."""
        values = ["visible" if here else "hidden" for here in there]
        return f' visibility="{values[-1]}"' if not there[-1] else "", self.steps(
            "visibility", values
        )


def _lattice(place: _Place) -> str:
    """Lines between the Gcells."""
    columns, rows, _ = place.shape
    left, bottom = place.left - place.side / 2, place.bottom + place.side / 2
    right, top = left + columns * place.side, bottom - rows * place.side
    uprights = [f"M{left + x * place.side:g} {top:g}V{bottom:g}" for x in range(columns + 1)]
    return "".join(
        uprights + [f"M{left:g} {bottom - y * place.side:g}H{right:g}" for y in range(rows + 1)]
    )


def _moments(rows: Iterable[tuple[int, NDArray[np.integer]]]) -> dict[int, set[int]]:
    """For each number that occurs the moments at which it does."""
    found: defaultdict[int, set[int]] = defaultdict(set)
    for moment, numbers in rows:
        for number in numbers.tolist():
            found[number].add(moment)
    return found


def _bands(scenes: Sequence[Scene], place: _Place, clock: _Clock) -> Iterator[str]:
    """Full and overflowed edges."""
    states = [edge_states(scene) for scene in scenes]
    for state, name in ((EdgeState.FULL, "full"), (EdgeState.OVERFLOWED, "over")):
        there = _moments((n, np.flatnonzero(own == state)) for n, own in enumerate(states))
        alike: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
        for edge, own_moments in sorted(there.items()):
            alike[tuple(sorted(own_moments))].append(edge)
        for moments, edges in alike.items():
            attribute, animation = clock.shown([n in moments for n in range(len(scenes))])
            lines = _lines(scenes[0], np.array(edges), place, None)
            yield (
                f'<path class="{name}" stroke-width="{0.8 * place.side:g}" d="{lines}"{attribute}>'
                f"{animation}</path>"
            )


def _lines(scene: Scene, edges: NDArray[np.int64], place: _Place, net: int | None) -> str:
    near, far = scene.grid.ends(edges)
    points = np.concatenate([place.of(near, net), place.of(far, net)], axis=1)
    return "".join(
        f"M{x:.1f} {y:.1f}{f'H{to_x:.1f}' if abs(to_y - y) < 1e-6 else f'V{to_y:.1f}'}"
        for x, y, to_x, to_y in points.tolist()
    )


def _routes(
    scenes: Sequence[Scene], problem: Problem, place: _Place, clock: _Clock, line: float
) -> Iterator[str]:
    """The edges of every net, those with the same moments in one path; vias are dots."""
    uses = _moments((n, s.nets * s.grid.edges + s.edges) for n, s in enumerate(scenes))
    alike: defaultdict[tuple[int, int, bool, tuple[int, ...]], list[int]] = defaultdict(list)
    grid = scenes[0].grid
    for number, own_moments in sorted(uses.items()):
        net, edge = divmod(number, grid.edges)
        layer, axis = edge // AXES % grid.shape[2], edge % AXES
        alike[net, layer, axis == VIA_AXIS, tuple(sorted(own_moments))].append(edge)
    before = -1
    for (net, layer, via, moments), edges in sorted(alike.items()):
        if net != before:
            name = html.escape(problem.nets[net].name)
            yield "</g>" * (before >= 0)
            yield f'<g data-net="{net}" stroke="{_fill(net)}"><title>{name}</title>'
            before = net
        attribute, animation = clock.shown([n in moments for n in range(len(scenes))])
        if via:  # a line without length, which has round ends
            points = place.of(grid.ends(np.array(edges))[0], net).tolist()
            lines = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)
            kind = f'class="v{layer + 1}" stroke-width="{2.4 * line:.2f}"'
            yield f'<path {kind} d="{lines}"{attribute}>{animation}</path>'
        else:
            lines = _lines(scenes[0], np.array(edges), place, net)
            yield f'<path class="l{layer + 1}" d="{lines}"{attribute}>{animation}</path>'
    yield "</g>" * (before >= 0)


def _fill(net: int) -> str:
    return "#{:02x}{:02x}{:02x}".format(*PALETTE[net % len(PALETTE)].tolist())


def _pins(problem: Problem, place: _Place, line: float) -> Iterator[str]:
    """A square for every pin."""
    half = 1.3 * line
    for net, gcells in enumerate(problem.pin_gcells):
        squares = "".join(
            f"M{x - half:.1f} {y - half:.1f}h{2 * half:.1f}v{2 * half:.1f}h{-2 * half:.1f}z"
            for x, y in place.of(gcells, net).tolist()
        )
        kind = f'class="pin" stroke-width="{0.25 * line:.2f}" fill="{_fill(net)}"'
        yield f'<path {kind} d="{squares}"/>'


def _heads(
    scenes: Sequence[Scene], problem: Problem, place: _Place, clock: _Clock, line: float
) -> Iterator[str]:
    """A disc for every net under way, and a frame around the target of the net to move."""
    radius = max(2.2 * line, 3.0)
    where = np.full((len(problem.nets), len(scenes)), -1)
    target: list[tuple[float, float] | None] = []
    for n, scene in enumerate(scenes):
        under_way = np.isin(scene.active, scene.nets)
        if scene.turn is not None:
            under_way[scene.turn] = True
        where[scene.active[under_way], n] = scene.heads[under_way]
        goal = None
        if scene.turn is not None:
            at = scene.targets[scene.turn : scene.turn + 1]
            x, y = place.of(at, int(scene.active[scene.turn]))[0].tolist()
            goal = x, y
        target.append(goal)

    def moving(points: Sequence[tuple[float, float] | None], rest: str) -> str:
        # Where there is nothing, it stays out of sight at its last place.
        last = next(point for point in points if point is not None)
        places = []
        for point in points:
            last = last if point is None else point
            places.append(last)
        attribute, animation = clock.shown([point is not None for point in points])
        moves = (
            f"{clock.steps('cx', [f'{x:.1f}' for x, _ in places])}"
            f"{clock.steps('cy', [f'{y:.1f}' for _, y in places])}"
        )
        x, y = places[-1]
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" {rest}{attribute}>{animation}{moves}</circle>'

    for net, cells in enumerate(where):
        if (cells >= 0).any():
            points = [
                None if cell < 0 else tuple(place.of(np.array(cell), net).tolist())
                for cell in cells.tolist()
            ]
            rest = (
                f'class="head" r="{radius:.1f}" stroke-width="{0.4 * line:.2f}" fill="{_fill(net)}"'
            )
            yield moving(points, rest)
    if any(target):
        width = max(0.5 * line, 1)
        rest = f'r="{1.7 * radius:.1f}" fill="none" stroke="#202020" stroke-width="{width:.2f}"'
        yield moving(target, rest)


def _score(scenes: Sequence[Scene], clock: _Clock) -> Iterator[str]:
    """The caption of every moment."""
    captions = [scene.caption for scene in scenes]
    for caption in dict.fromkeys(captions):
        attribute, animation = clock.shown([own == caption for own in captions])
        kind = 'class="score" x="16" y="46" xml:space="preserve"'
        yield f"<text {kind}{attribute}>{html.escape(caption)}{animation}</text>"


def _svg_legend(y: float, line: float) -> Iterator[str]:
    """What the signs mean."""
    colour, x = _fill(0), 16
    signs = {
        "net": f'<path d="M0 0H18" stroke="{colour}" stroke-width="{line:.2f}"/>',
        "pin": f'<path class="pin" fill="{colour}" stroke-width=".5" d="M6 -4h8v8h-8z"/>',
        "via": f'<circle cx="10" r="{max(1.2 * line, 2.5):.1f}" fill="{colour}"/>',
        "head": f'<circle class="head" cx="10" r="6" fill="{colour}"/>',
        "target": '<circle cx="10" r="6" fill="none" stroke="#202020" stroke-width="1.5"/>',
        "full edge": '<path class="full" d="M0 0H18" stroke-width="12"/>',
        "overflowed": '<path class="over" d="M0 0H18" stroke-width="12"/>',
    }
    for name, sign in signs.items():
        text = f'<text class="sign" x="24" y="4">{name}</text>'
        yield f'<g transform="translate({x} {y:g})">{sign}{text}</g>'
        x += 38 + round(7.6 * len(name))
