"""An episode as an animation: SVG that moves by itself, or GIF."""

import io
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from marouting.batch.engine import Engine
from marouting.errors import InputError
from marouting.files import writing
from marouting.game import NOBODY
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import Scene, rgb_array, scene_of
from marouting.rules import MOST_STEPS, TurnOrder
from marouting.search.guides import RouteFollower
from policies.figures.film import HOLD, svg


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
) -> None:
    """Writes an animation, whole or not at all.

    Args:
        scenes: the moments, as from :func:`record`.
        path: the file; its suffix tells the format, ``.svg`` or ``.gif``.
        title: what the SVG is called.
    """
    kind = Path(path).suffix.lower()
    if kind not in (".svg", ".gif"):
        raise InputError(f"{os.fspath(path)}: expected a name with the suffix .svg or .gif")
    fps = float(np.clip(len(scenes) / 12, 2, 20))  # about 12 seconds
    content = gif(scenes, fps) if kind == ".gif" else svg(scenes, title, fps).encode()
    with writing(path) as temporary:
        temporary.write_bytes(content)


def gif(scenes: Sequence[Scene], fps: float) -> bytes:
    """The pictures of :func:`marouting.render.rgb_array` as a GIF that repeats forever."""
    last = len(scenes) - 1
    pictures = (rgb_array(scene) for scene in scenes)
    first, *others = _with_one_palette(pictures) or map(Image.fromarray, map(rgb_array, scenes))
    durations = [round(1000 / fps) + (n == last) * round(1000 * HOLD) for n in range(last + 1)]
    out = io.BytesIO()
    first.save(out, "GIF", save_all=True, append_images=others, duration=durations, loop=0)
    return out.getvalue()


def _with_one_palette(pictures: Iterable[NDArray[np.uint8]]) -> list[Image.Image]:
    """The pictures (H, W, 3) with one palette; none if that is too small for all their colours.

    Pillow would look for a palette for every picture: nine tenths of the time of writing a GIF.
    """
    index_of = np.full(1 << 24, -1, np.int16)  # by colour
    colours = np.zeros(0, np.uint32)
    found: list[Image.Image] = []
    for picture in pictures:
        colour = picture @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        new = np.unique(colour[index_of[colour] < 0])
        index_of[new] = np.arange(len(colours), len(colours) + len(new))
        colours = np.append(colours, new)
        if len(colours) > 256:
            return []
        found.append(Image.fromarray(index_of[colour].astype(np.uint8)))
    palette = (colours[:, None] >> np.array([16, 8, 0], np.uint32) & 255).astype(np.uint8)
    for image in found:
        image.putpalette(palette.tobytes())
    return found
