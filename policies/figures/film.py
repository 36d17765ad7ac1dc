"""An animation as SVG that moves by itself: nets grow behind the heads of their agents."""

import html
import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marouting.errors import InputError, printable
from marouting.problem.grid import VIA_AXIS, Grid
from marouting.render import Scene, colour_of
from policies.figures.routes import side_by_side

HOLD = 2.0
"""Seconds that the last picture stays before the animation starts again."""


MOST_PARTS = 20_000
"""The most elements of an SVG, for browsers to play it smoothly."""

MOST_CAPTIONS = 24
"""The most lines about step and score that an SVG shows one after the other."""

EDGE, HEAD, FOOT = 14, 50, 30
"""Around the drawing of an SVG, for the words above, and for those below it, in px."""

Point = tuple[int, int]
"""A column of Gcells: x and y."""


def svg(scenes: Sequence[Scene], title: str, fps: float) -> str:
    """The game seen from above, as an SVG that moves by itself, without script, forever.

    Every net grows in its own colour behind the head of its agent. Nets lie side by side, on the
    same track in all Gcells. Where nothing moves, as on paper, the last moment is shown.

    Returns:
        The text; the same for the same input.
    """
    film = _Film(scenes, fps)
    # The name of a file may hold what XML does not take.
    name = html.escape(printable(title))
    parts = [
        *film.ground(),
        *film.walls(),
        *film.overflows(),
        *film.routes(),
        *film.vias(),
        *film.pins(),
        *film.heads(),
        *film.words(name),
    ]
    if len(parts) > MOST_PARTS:
        raise InputError(
            f"animation: expected at most {MOST_PARTS} parts of an SVG, found "
            f"{len(parts)}: ask for fewer frames, or for a GIF"
        )
    size = f"{film.width} {film.height}"
    style = "text { font-family: system-ui, sans-serif; font-size: 15px; white-space: pre }"
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" width="{film.width}">',
            f"<title>{name}</title>",
            f"<style>{style}</style>",
            f'<rect width="{film.width}" height="{film.height}" rx="10" fill="#fff"/>',
            *parts,
            "</svg>\n",
        ]
    )


@dataclass
class _Use:
    """An edge that a net uses from one moment on until another one.

    Attributes:
        net: the net.
        start: (x, y) of the Gcell that it comes from.
        end: (x, y) of the one that it goes to; the same for a via.
        first: the moment at which it is there.
        last: the first moment at which it is gone; the number of moments if it stays.
    """

    net: int
    start: Point
    end: Point
    first: int
    last: int


class _Film:
    """The parts of an SVG that shows moments of a game."""

    def __init__(self, scenes: Sequence[Scene], fps: float) -> None:
        self.scenes, self.count = scenes, len(scenes)
        self._seconds = self.count / fps + HOLD
        self._fps = fps
        grid = scenes[0].grid
        columns, rows, _ = grid.shape
        self._pitch = min(52.0, max(600 / max(columns, rows), 2.0))
        self._rows = rows
        self.width = round(max(columns * self._pitch, 420)) + 2 * EDGE
        self.height = round(rows * self._pitch) + 2 * EDGE + HEAD + FOOT
        self._left = (self.width - columns * self._pitch) / 2
        self._runs: defaultdict[int, list[list[_Use]]] = defaultdict(list)
        self._pins = {
            (net, cell)
            for scene in scenes
            for net, cell in zip(scene.active.tolist(), scene.targets.tolist(), strict=True)
        } | set(zip(scenes[0].active.tolist(), scenes[0].heads.tolist(), strict=True))
        self._uses = list(_uses(scenes))
        for net, own in itertools.groupby(self._uses, lambda use: use.net):
            self._runs[net] = _runs([use for use in own if use.start != use.end])
        passed: defaultdict[int, set[Point]] = defaultdict(set)
        for net, cell in self._pins:
            passed[net].add(_point(grid, cell))
        for use in self._uses:
            passed[use.net] |= {use.start, use.end}
        nets = sorted(passed)
        shift, self._track = side_by_side([sorted(passed[net]) for net in nets])
        self._shift = dict(zip(nets, shift.tolist(), strict=True))

    def _at(self, point: Point, net: int | None = None) -> tuple[str, str]:
        """Where the middle of a Gcell is, or a net in it."""
        shift = 0.0 if net is None else self._shift[net]
        x = self._left + (point[0] + 0.5 + shift) * self._pitch
        y = EDGE + HEAD + (self._rows - 0.5 - point[1] - shift) * self._pitch
        return f"{x:.1f}".removesuffix(".0"), f"{y:.1f}".removesuffix(".0")

    def ground(self) -> Iterator[str]:
        """The Gcells that an edge leads to."""
        columns, rows, _ = self.scenes[0].grid.shape
        gap = 0.06 * self._pitch if max(columns, rows) <= 64 else 0
        side = self._pitch - gap
        squares = (
            f"M{self._left + x * self._pitch + gap / 2:.4g} "
            f"{EDGE + HEAD + (rows - 1 - y) * self._pitch + gap / 2:.4g}"
            f"h{side:.4g}v{side:.4g}h-{side:.4g}z"
            for x, y in np.argwhere(self._reached()).tolist()
        )
        whole = f"M{self._left} {EDGE + HEAD}h{columns * self._pitch}v{rows * self._pitch}H"
        yield f'<path fill="#eef0f4" d="{"".join(squares) if gap else f"{whole}{self._left}z"}"/>'

    def _tracks(self) -> NDArray[np.int64]:
        """(X, Y, 2), the tracks from each column of Gcells to the next one along x and y."""
        grid = self.scenes[0].grid
        return self.scenes[0].capacity.reshape(*grid.shape, -1)[..., :VIA_AXIS].sum(2)

    def _reached(self) -> NDArray[np.bool_]:
        """(X, Y) bool, the columns of Gcells that have a neighbour."""
        along_x, along_y = np.moveaxis(self._tracks() > 0, -1, 0)
        reached = along_x | along_y
        reached[1:] |= along_x[:-1]
        reached[:, 1:] |= along_y[:, :-1]
        return reached

    def walls(self) -> Iterator[str]:
        """A line between neighbours that no edge joins."""
        tracks, reached, lines = self._tracks(), self._reached(), []
        half = self._pitch / 2
        for x, y, axis in np.argwhere(tracks == 0).tolist():
            other = (x + 1, y) if axis == 0 else (x, y + 1)
            if other[axis] == tracks.shape[axis] or not (reached[x, y] and reached[other]):
                continue
            left, top = map(float, self._at(other))
            start = (left - half, top - half) if axis == 0 else (left - half, top + half)
            lines.append(f"M{start[0]:.4g} {start[1]:.4g}{'vh'[axis]}{self._pitch:.4g}")
        if lines:
            wide = f"{max(0.1 * self._pitch, 1):.3g}"
            yield f'<path stroke="#202020" stroke-width="{wide}" d="{"".join(lines)}"/>'

    def overflows(self) -> Iterator[str]:
        """Bands on edges that overflow, below the routes."""
        shown: defaultdict[int, list[int]] = defaultdict(list)
        for moment, scene in enumerate(self.scenes):
            for edge in np.flatnonzero(scene.remaining < 0).tolist():
                shown[edge].append(moment)
        grid = self.scenes[0].grid
        for edge, moments in shown.items():
            near, far = (_point(grid, int(cell)) for cell in grid.ends(np.array(edge)))
            (a, b), (c, d) = self._at(near), self._at(far)
            look = f'stroke="#f7a52b" stroke-opacity=".6" stroke-width="{0.5 * self._pitch:.3g}"'
            yield self._shown("path", f'{look} d="M{a} {b}L{c} {d}"', moments)

    def routes(self) -> Iterator[str]:
        """Every run of edges as a line that grows."""
        width = f"{max(0.7 * self._track * self._pitch, 0.6):.3g}"
        yield f'<g fill="none" stroke-width="{width}" stroke-linejoin="round">'
        for net, runs in self._runs.items():
            for run in runs:
                yield self._growing(net, run)
        yield "</g>"

    def vias(self) -> Iterator[str]:
        """A dot for every via, from when it is there."""
        vias: defaultdict[tuple[int, int], list[str]] = defaultdict(list)
        for use in self._uses:
            if use.start == use.end:
                x, y = self._at(use.start, use.net)
                vias[use.first, use.last].append(f"M{x} {y}h0")
        wide = f"{max(1.05 * self._track * self._pitch, 1.2):.3g}"
        look = f'stroke="#202020" stroke-linecap="round" stroke-width="{wide}"'
        for (first, last), dots in vias.items():
            path = f'{look} d="{"".join(dict.fromkeys(dots))}"'
            yield self._shown("path", path, range(first, last))

    def heads(self) -> Iterator[str]:
        """The heads of the agents."""
        radius = max(min(1.6 * self._track, 0.24) * self._pitch, 2.5)
        yield f'<g stroke="#fff" stroke-width="{radius / 4:.2g}">'
        for net, runs in self._runs.items():
            if runs:
                yield self._head(net, runs, radius)
        yield "</g>"

    def _path(self, net: int, run: Sequence[_Use]) -> str:
        """A run as the data of a path; straight on is one line."""
        points = [run[0].start, *(use.end for use in run)]
        turns = [
            b
            for a, b, c in zip(points, points[1:], points[2:], strict=False)
            if (b[0] - a[0], b[1] - a[1]) != (c[0] - b[0], c[1] - b[1])
        ]
        places = (" ".join(self._at(point, net)) for point in [points[0], *turns, points[-1]])
        return f"M{'L'.join(places)}"

    def _growing(self, net: int, run: Sequence[_Use]) -> str:
        """A run of edges that appear one after the other and vanish together."""
        length, last = len(run), run[0].last
        grown = [(0, 0), *_steps(run)]
        if last < self.count:
            grown += [(last - 1, length), (last, 0)]
        left = [(moment, length - edges) for moment, edges in grown]
        times, values = self._timed(left)
        change = (
            f'<animate attributeName="stroke-dashoffset" dur="{self._seconds:g}s" '
            f'repeatCount="indefinite" values="{values}" keyTimes="{times}"/>'
        )
        still = "" if last == self.count else f' stroke-dashoffset="{length}"'
        return (
            f'<path stroke="{_css(net)}" pathLength="{length}" stroke-dasharray="{length}"{still} '
            f'd="{self._path(net, run)}">{change}</path>'
        )

    def _head(self, net: int, runs: Sequence[Sequence[_Use]], radius: float) -> str:
        """The head of an agent, which moves in front of its route until the agent is done."""
        uses = [use for run in runs for use in run]
        route = "".join(self._path(net, run) for run in runs)
        active = [n for n, scene in enumerate(self.scenes) if net in scene.active]
        stops: list[tuple[int, float]] = [(0, 0.0)]
        done = 0
        for run in runs:
            # A run ends just before the next one begins, which may be elsewhere.
            own = [(moment, (done + edges) / len(uses)) for moment, edges in _steps(run)]
            stops += [(own[0][0], stops[-1][1]), *own[:-1]]
            stops.append((own[-1][0], own[-1][1] - 1e-4))
            done += len(run)
        times, values = self._timed(stops)
        motion = (
            f'<animateMotion dur="{self._seconds:g}s" repeatCount="indefinite" calcMode="linear" '
            f'keyTimes="{times}" keyPoints="{values}" path="{route}"/>'
        )
        return self._shown("circle", f'r="{radius:.3g}" fill="{_css(net)}"', active, motion)

    def pins(self) -> Iterator[str]:
        """The pins, as squares in the colour of their net."""
        half = max(0.75 * self._track * self._pitch, 1.5)
        by_net: defaultdict[int, list[str]] = defaultdict(list)
        for net, cell in sorted(self._pins):
            x, y = self._at(_point(self.scenes[0].grid, cell), net)
            left, top = float(x) - half, float(y) - half
            side = f"{2 * half:.3g}"
            by_net[net].append(f"M{left:.4g} {top:.4g}h{side}v{side}h-{side}z")
        width = f"{half / 2:.2g}"
        for net, squares in by_net.items():
            yield (
                f'<path fill="#fff" stroke="{_css(net)}" stroke-width="{width}" '
                f'd="{"".join(squares)}"/>'
            )

    def words(self, title: str) -> Iterator[str]:
        """Title, step and score above, what the marks mean below."""
        yield f'<text x="{EDGE}" y="{EDGE + 14}" font-weight="bold">{title}</text>'
        every = max(1, -(-self.count // MOST_CAPTIONS))
        shown = sorted({*range(0, self.count, every), self.count - 1})
        for moment, after in itertools.pairwise([*shown, self.count]):
            caption = html.escape(self.scenes[moment].caption)
            place = f'x="{EDGE}" y="{EDGE + 36}"'
            yield self._shown("text", place, range(moment, after), caption)
        y = self.height - EDGE - 5
        yield f'<circle cx="{EDGE + 7}" cy="{y - 5}" r="7" fill="{_css(0)}"/>'
        yield f'<text x="{EDGE + 20}" y="{y}">agent</text>'
        yield (
            f'<rect x="{EDGE + 76}" y="{y - 11}" width="11" height="11" fill="#fff" '
            f'stroke="{_css(0)}" stroke-width="3"/>'
        )
        yield f'<text x="{EDGE + 94}" y="{y}">pin</text>'
        yield f'<circle cx="{EDGE + 137}" cy="{y - 5}" r="4"/>'
        yield f'<text x="{EDGE + 147}" y="{y}">via</text>'
        if any((scene.remaining < 0).any() for scene in self.scenes):
            yield f'<rect x="{EDGE + 186}" y="{y - 12}" width="14" height="14" fill="#f7a52b"/>'
            yield f'<text x="{EDGE + 206}" y="{y}">overflow</text>'

    def _shown(self, tag: str, attributes: str, moments: Sequence[int], inside: str = "") -> str:
        """An element that is there at some moments, and where nothing moves if at the last one."""
        there = [False] * self.count
        for moment in moments:
            there[moment] = True
        hidden = "" if there[-1] else ' visibility="hidden"'
        change = ""
        if not all(there):
            changes = [n for n in range(self.count) if n == 0 or there[n] != there[n - 1]]
            times = ";".join(self._time(n) for n in changes)
            values = ";".join("visible" if there[n] else "hidden" for n in changes)
            change = (
                f'<animate attributeName="visibility" calcMode="discrete" dur="{self._seconds:g}s" '
                f'repeatCount="indefinite" values="{values}" keyTimes="{times}"/>'
            )
        return f"<{tag} {attributes}{hidden}>{change}{inside}</{tag}>"

    def _timed(self, stops: Sequence[tuple[int, float]]) -> tuple[str, str]:
        """Times and values of stops as SVG has them, without those on the way between two."""
        kept: list[tuple[int, float]] = []
        for stop in stops:
            while len(kept) > 1 and _straight(kept[-2], kept[-1], stop):
                kept.pop()
            if stop not in kept[-1:]:
                kept.append(stop)
        times = [*(self._time(moment) for moment, _ in kept), "1"]
        values = [*(f"{value:.5g}" for _, value in kept), f"{kept[-1][1]:.5g}"]
        return ";".join(times), ";".join(values)

    def _time(self, moment: int) -> str:
        """A moment as a share of the whole time."""
        return f"{moment / self._fps / self._seconds:.4f}".rstrip("0").rstrip(".") or "0"


def _uses(scenes: Sequence[Scene]) -> list[_Use]:
    """All uses of edges by net, in the order in which its agent makes them."""
    grid, count = scenes[0].grid, len(scenes)
    found: defaultdict[int, list[_Use]] = defaultdict(list)
    now: dict[tuple[int, int], _Use] = {}
    heads: dict[int, int] = {}
    for moment, scene in enumerate(scenes):
        there = set(zip(scene.nets.tolist(), scene.edges.tolist(), strict=True))
        for gone in now.keys() - there:
            now.pop(gone).last = moment
        fresh: defaultdict[int, list[int]] = defaultdict(list)
        for net, edge in sorted(there - now.keys()):
            fresh[net].append(edge)
        for net, edges in fresh.items():
            for edge, start, end in _in_order(grid, edges, heads.get(net, -1)):
                use = _Use(net, _point(grid, start), _point(grid, end), moment, count)
                found[net].append(use)
                now[net, edge] = use
        heads |= dict(zip(scene.active.tolist(), scene.heads.tolist(), strict=True))
    return [use for net in sorted(found) for use in found[net]]


def _in_order(grid: Grid, edges: list[int], head: int) -> Iterator[tuple[int, int, int]]:
    """Edges with both ends, each from where the last one has ended if it can be."""
    near, far = grid.ends(np.array(edges))
    left = dict(zip(edges, zip(near.tolist(), far.tolist(), strict=True), strict=True))
    while left:
        on = next((edge for edge, ends in left.items() if head in ends), next(iter(left)))
        start, end = left.pop(on)
        if end == head:
            start, end = end, start
        yield on, start, end
        head = end


def _runs(uses: Sequence[_Use]) -> list[list[_Use]]:
    """Uses of a net, together where one begins at the end of another and they vanish together."""
    runs: list[list[_Use]] = []
    for use in uses:
        if runs and runs[-1][-1].end == use.start and runs[-1][-1].last == use.last:
            runs[-1].append(use)
        else:
            runs.append([use])
    return runs


def _steps(uses: Sequence[_Use]) -> Iterator[tuple[int, int]]:
    """Stops of a growing line: at which moment it has how many edges, and from when on it grows."""
    done = 0
    for moment, own in itertools.groupby(uses, lambda use: use.first):
        yield max(moment - 1, 0), done
        done += sum(1 for _ in own)
        yield moment, done


def _straight(a: tuple[int, float], b: tuple[int, float], c: tuple[int, float]) -> bool:
    """Whether the second of three stops lies on the way from the first to the third."""
    on = (b[1] - a[1]) * (c[0] - a[0]) - (c[1] - a[1]) * (b[0] - a[0])
    return a[0] < c[0] and abs(on) < 1e-9


def _point(grid: Grid, cell: int) -> Point:
    """X and y of a Gcell."""
    x, y, _ = np.unravel_index(cell, grid.shape)
    return int(x), int(y)


def _css(net: int) -> str:
    """The colour of a net."""
    return "#{:02x}{:02x}{:02x}".format(*colour_of(net))
