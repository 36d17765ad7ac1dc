"""An episode as an animation: SVG that moves by itself, or GIF."""

import html
import io
import itertools
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from marouting.batch.engine import Engine
from marouting.errors import InputError
from marouting.files import writing
from marouting.game import NOBODY
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import Box, Disc, Ink, Scene, Shape, Sheet, Words, rgb_array, scene_of, shapes
from marouting.rules import MOST_STEPS, TurnOrder
from marouting.search.guides import RouteFollower

HOLD = 2.0
"""Seconds that the last picture stays before the animation starts again."""


MOST_PARTS = 50_000
"""The most shapes of an SVG that come and go, for browsers to play it smoothly."""


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
    path: str | os.PathLike[str],
    title: str = "",
    fps: float | None = None,
) -> None:
    """Writes an animation, whole or not at all.

    Args:
        scenes: the moments, as from :func:`record`.
        path: the file; its suffix tells the format, ``.svg`` or ``.gif``.
        title: what the SVG is called.
        fps: pictures per second; None: 3 to 20, for an animation of about 12 seconds.
    """
    kind = animation_format(path)
    if fps is None:
        fps = float(np.clip(len(scenes) / 12, 3, 20))
    if not 0.1 <= fps <= 50:
        raise InputError(f"fps: expected 0.1 to 50 pictures per second, found {fps}")
    content = gif(scenes, fps) if kind == ".gif" else svg(scenes, title, fps).encode()
    with writing(path) as temporary:
        temporary.write_bytes(content)


def animation_format(path: str | os.PathLike[str]) -> str:
    """``.svg`` or ``.gif``; raises InputError for a file with another suffix."""
    kind = Path(path).suffix.lower()
    if kind not in (".svg", ".gif"):
        raise InputError(f"{os.fspath(path)}: expected a name with the suffix .svg or .gif")
    return kind


def gif(scenes: Sequence[Scene], fps: float) -> bytes:
    """The pictures of :func:`marouting.render.rgb_array` as a GIF that repeats forever."""
    last = len(scenes) - 1
    first, *others = (Image.fromarray(rgb_array(scene)) for scene in scenes)
    durations = [round(1000 / fps) + (n == last) * round(1000 * HOLD) for n in range(last + 1)]
    out = io.BytesIO()
    first.save(out, "GIF", save_all=True, append_images=others, duration=durations, loop=0)
    return out.getvalue()


def svg(scenes: Sequence[Scene], title: str, fps: float) -> str:
    """The same pictures as an SVG that moves by itself, without script, and repeats forever.

    Where nothing moves, as on paper, the last moment is shown.

    Returns:
        The text; the same for the same input.
    """
    sheet, count = Sheet.of(scenes[0]), len(scenes)
    moments: defaultdict[tuple[int, Shape], list[int]] = defaultdict(list)
    for moment, scene in enumerate(scenes):
        for level, drawn in enumerate(shapes(scene)):
            for shape in dict.fromkeys(drawn):
                moments[level, shape].append(moment)
    if len(moments) > MOST_PARTS:
        raise InputError(
            f"animation: expected at most {MOST_PARTS} moving parts in an SVG, found "
            f"{len(moments)}: ask for fewer frames, or for a GIF"
        )
    # What is there at the same moments comes and goes together.
    alike: defaultdict[tuple[int, tuple[int, ...]], list[Shape]] = defaultdict(list)
    for (level, shape), own in moments.items():
        alike[level, tuple(own)].append(shape)
    height, width, _ = sheet.canvas.shape
    # The name of a file may hold what XML does not take.
    name = html.escape("".join(c if c.isprintable() else ascii(c)[1:-1] for c in title))
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width // sheet.shrink}" height="{height // sheet.shrink}">',
            f"<title>{name}</title>",
            "<style>text { font-family: monospace; fill: #141414; white-space: pre; }</style>",
            '<rect width="100%" height="100%" fill="#fff"/>',
            *_elements(sheet.shapes),
            *(
                _group(shown, own, count, fps)
                for (_, own), shown in sorted(alike.items(), key=lambda item: item[0][0])
            ),
            "</svg>",
            "",
        ]
    )


def _group(drawn: Sequence[Shape], moments: Sequence[int], count: int, fps: float) -> str:
    """Shapes that are there at some of so many moments, of which the last one lasts longer."""
    there = [False] * count
    for moment in moments:
        there[moment] = True
    inside = "".join(_elements(drawn))
    changes = [n for n in range(count) if n == 0 or there[n] != there[n - 1]]
    if len(changes) == 1:
        return f"<g>{inside}</g>"
    length = count / fps + HOLD
    times = ";".join(f"{n / fps / length:.5f}" for n in changes)
    values = ";".join("visible" if there[n] else "hidden" for n in changes)
    hidden = "" if there[-1] else ' visibility="hidden"'
    return (
        f'<g{hidden}><animate attributeName="visibility" calcMode="discrete" dur="{length:g}s" '
        f'repeatCount="indefinite" values="{values}" keyTimes="{times}"/>{inside}</g>'
    )


def _elements(drawn: Sequence[Shape]) -> Iterator[str]:
    """Shapes as elements of SVG; boxes that follow each other in one colour are one path."""
    for kind, group in itertools.groupby(drawn, lambda s: s.ink if isinstance(s, Box) else None):
        if kind is not None:
            boxes = (f"M{b[0]} {b[1]}H{b[2]}V{b[3]}H{b[0]}z" for b in group)
            yield f'<path fill="{_css(kind)}" d="{"".join(boxes)}"/>'
            continue
        for shape in group:
            if isinstance(shape, Disc):
                place = f'cx="{shape.x}" cy="{shape.y}" r="{shape.radius}"'
                yield f'<circle {place} fill="{_css(shape.ink)}"/>'
            elif isinstance(shape, Words):
                below, size = shape.y + 7 * shape.scale, 10 * shape.scale
                text = html.escape(shape.text)
                yield f'<text x="{shape.x}" y="{below}" font-size="{size}">{text}</text>'


def _css(ink: Ink) -> str:
    return "#{:02x}{:02x}{:02x}".format(*ink)
