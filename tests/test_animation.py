"""Animations: every picture is a state of the game."""

import io
import itertools
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import problems

from marouting import Engine, InputError, Solution, evaluate, generate, sequential_astar
from marouting.render import EdgeState, edge_states, rgb_array, scene_of

animation = pytest.importorskip("policies.figures.animation", exc_type=ImportError)
cli = pytest.importorskip("policies.cli.main", exc_type=ImportError)
Image = pytest.importorskip("PIL.Image")

SVG = "{http://www.w3.org/2000/svg}"


def wandering(problem, seed=0, steps=60):
    """A game of random moves with overflow, in which routes are given back again and again."""
    engine = Engine([problem], turn_order="round_robin", overflow="allowed", max_steps=999)
    rng = np.random.default_rng(seed)
    saved = engine.save()
    yield engine
    for step in range(steps):
        if step % 7 == 3:
            saved = engine.save()
        if step % 11 == 10:
            engine.restore(saved)  # edges vanish
        engine.step(rng.integers(0, 6, engine.nets.shape))
        yield engine


class Film:
    """What an SVG shows at each moment, read from its elements alone."""

    def __init__(self, text, moments, fps):
        self.root = ElementTree.fromstring(text)
        self.share = 1 / fps / (moments / fps + animation.HOLD)

    def at(self, element, attribute, moment):
        """The value of an attribute in the middle of a moment."""
        for child in element.findall(f"{SVG}animate"):
            if child.get("attributeName") == attribute:
                times = [float(time) for time in child.get("keyTimes").split(";")]
                now = (moment + 0.5) * self.share
                place = np.searchsorted(times, now, side="right") - 1
                return child.get("values").split(";")[place]
        return element.get(attribute, "visible")

    def shown(self, tag, moment):
        for element in self.root.iter(f"{SVG}{tag}"):
            if self.at(element, "visibility", moment) == "visible":
                yield element

    def grid(self, shape):
        """Gcells from points: the lattice tells where they are."""
        numbers = re.findall(r"M(\S+) (\S+)V([\d.]+)", self.root.find(f"{SVG}path").get("d"))
        (left, _, bottom), (second, _, _) = (map(float, found) for found in numbers[:2])
        side = second - left
        return lambda x, y: (int((x - left) // side), int((bottom - y) // side)), shape

    def edges(self, element, grid):
        gcell, _ = grid
        name = element.get("class")
        for x, y, kind, to in re.findall(r"M([\d.]+) ([\d.]+)([HVh])([\d.]+)", element.get("d")):
            near = gcell(float(x), float(y))
            axis = "HVh".index(kind)
            far = gcell(float(to), float(y)) if axis == 0 else gcell(float(x), float(to))
            assert axis == 2 or abs(sum(far) - sum(near)) == 1
            layer = int(name[1:]) - 1 if name[1:].isdigit() else None
            yield axis, min(near, far) if axis < 2 else near, layer

    def uses(self, moment, shape):
        """(net, edge) of every use that is to be seen."""
        grid, found = self.grid(shape), []
        hidden = {
            id(element)
            for element in self.root.iter()
            if self.at(element, "visibility", moment) != "visible"
        }
        for group in self.root.iter(f"{SVG}g"):
            if group.get("data-net") is None:
                continue
            for path in group.findall(f"{SVG}path"):
                if id(path) in hidden:
                    continue
                for axis, (x, y), z in self.edges(path, grid):
                    found.append(
                        (int(group.get("data-net")), 3 * ((x * shape[1] + y) * shape[2] + z) + axis)
                    )
        return sorted(found)


def check(problem, scenes, fps=7.0):
    text = animation.svg(scenes, problem, "title", fps)
    assert text == animation.svg(scenes, problem, "title", fps)
    film = Film(text, len(scenes), fps)
    shape = problem.grid
    for moment, scene in enumerate(scenes):
        uses = sorted(zip(scene.nets.tolist(), scene.edges.tolist(), strict=True))
        assert film.uses(moment, shape) == uses
        (caption,) = [e.text for e in film.shown("text", moment) if e.get("class") == "score"]
        assert caption == scene.caption
        states, grid = edge_states(scene), film.grid(shape)
        for state, name in ((EdgeState.FULL, "full"), (EdgeState.OVERFLOWED, "over")):
            bands = [
                (axis, at)
                for path in film.shown("path", moment)
                if path.get("class") == name
                and path.get("visibility") != "none"
                and "M0 0" not in path.get("d")
                for axis, at, _ in film.edges(path, grid)
            ]
            expected = []
            for edge in np.flatnonzero(states == state).tolist():
                x, y, _ = np.unravel_index(edge // 3, shape)
                expected.append((edge % 3, (int(x), int(y))))
            assert sorted(bands) == sorted(expected)
        heads = [
            grid[0](float(film.at(disc, "cx", moment)), float(film.at(disc, "cy", moment)))
            for disc in film.shown("circle", moment)
            if disc.get("class") == "head" and disc.get("cy")
        ]
        moving = [
            tuple(map(int, np.unravel_index(head, shape)[:2]))
            for n, (net, head) in enumerate(zip(scene.active, scene.heads, strict=True))
            if n == scene.turn or net in scene.nets
        ]
        assert sorted(heads) == sorted(moving)
    return film


@settings(deadline=None, max_examples=12)
@given(problems(), st.integers(0, 9))
def test_an_svg_shows_the_states_of_the_game(problem, seed):
    if any(len(cells) > 1 for cells in problem.pin_gcells):
        check(problem, animation.record(wandering(problem, seed, 25)))


def test_what_is_given_back_vanishes_and_comes_again():
    (problem,) = generate(1, nets=6, capacity=1, seed=1)
    scenes = animation.record(wandering(problem), 200)
    pairs = [set(zip(s.nets.tolist(), s.edges.tolist(), strict=True)) for s in scenes]
    assert any(before - after for before, after in itertools.pairwise(pairs))
    film = check(problem, scenes)
    values = [a.get("values") for a in film.root.iter(f"{SVG}animate")]
    assert any(v.count("visible") > 1 for v in values if "visible" in v)


@pytest.mark.parametrize("turn_order", ["sequential", "round_robin"])
def test_a_solution_is_replayed_to_its_end(turn_order):
    (problem,) = generate(1, nets=20, max_pins=3, capacity=3, seed=5)
    solution = sequential_astar(problem)
    scenes = animation.record(animation.replay(problem, solution, turn_order), 500)
    figures = evaluate(problem, solution)
    assert f"overflow {figures.overflow}  wirelength {figures.wirelength}" in scenes[-1].caption
    assert scenes[0].caption.startswith("step 0 ")
    film = check(problem, scenes)
    last = film.uses(len(scenes) - 1, problem.grid)
    assert last == sorted(zip(*(column.tolist() for column in solution.uses), strict=True))
    # Nothing runs in it but the animation, and where nothing moves, the end is to be seen.
    assert not {e.tag.removeprefix(SVG) for e in film.root.iter()} & {
        "script",
        "foreignObject",
        "image",
        "use",
    }
    for element in list(film.root.iter()):
        for child in element.findall(f"{SVG}animate"):
            element.remove(child)
    assert film.uses(0, problem.grid) == last


@pytest.mark.parametrize("most", [2, 3, 10, 86, 87, 500])
def test_moments_are_evenly_spaced_from_the_first_to_the_last(most):
    (problem,) = generate(1, nets=10, seed=2)
    solution = sequential_astar(problem)
    captions = [scene_of(engine).caption for engine in animation.replay(problem, solution)]
    assert len(captions) == 86
    states = animation.replay(problem, solution)
    scenes = [scene.caption for scene in animation.record(states, most)]
    assert (scenes[0], scenes[-1]) == (captions[0], captions[-1])
    assert len(scenes) <= most
    assert len(scenes) >= min(len(captions), most // 2)
    if most >= len(captions):
        assert scenes == captions
    apart = np.diff([captions.index(caption) for caption in scenes])
    assert len(set(apart[:-1].tolist())) <= 1
    assert apart[-1] <= 2 * apart[0] or most == 2


def test_a_gif_holds_the_pictures_of_the_game():
    (problem,) = generate(1, nets=8, capacity=2, seed=3)
    scenes = animation.record(wandering(problem), 12)
    content = animation.gif(scenes, 5)
    assert content == animation.gif(scenes, 5)
    with Image.open(io.BytesIO(content)) as film:
        assert film.n_frames == len(scenes)
        assert film.info["loop"] == 0
        for n, scene in enumerate(scenes):
            film.seek(n)
            assert np.array_equal(np.asarray(film.convert("RGB")), rgb_array(scene))
            hold = 1000 * animation.HOLD * (n == len(scenes) - 1)
            assert film.info["duration"] == 200 + hold


def test_a_gif_of_a_large_grid_has_few_colours_and_the_same_look(monkeypatch):
    (problem,) = generate(1, nets=8, capacity=2, seed=3)
    scenes = animation.record(wandering(problem), 3)
    monkeypatch.setattr(animation, "rgb_array", lambda scene: rgb_array(scene) // 3 + noise)
    noise = np.random.default_rng(0).integers(0, 99, rgb_array(scenes[0]).shape, np.uint8)
    with Image.open(io.BytesIO(animation.gif(scenes, 5))) as film:
        film.seek(2)
        shown = np.asarray(film.convert("RGB")).astype(int)
    assert np.abs(shown - animation.rgb_array(scenes[2])).mean() < 20


def test_names_are_text(tmp_path):
    names = ("<script>alert(1)</script>", "</title>&amp;", "]]>", '"é🙂"')
    (problem,) = generate(1, nets=5, seed=1)
    nets = [replace(net, name=name) for net, name in zip(problem.nets, names, strict=False)]
    problem = replace(problem, nets=(*nets, *problem.nets[4:]))
    scenes = animation.record(animation.replay(problem, sequential_astar(problem)))
    path = tmp_path / "a.svg"
    animation.save_animation(scenes, problem, path, f"{names[0]}\udcff")
    root = ElementTree.fromstring(path.read_bytes())
    titles = [title.text for title in root.iter(f"{SVG}title")]
    assert titles[0].startswith(names[0])
    assert titles[1:] == [net.name for net in problem.nets]
    assert not list(root.iter(f"{SVG}script"))


def test_what_cannot_be_drawn(tmp_path, monkeypatch):
    (problem,) = generate(1, nets=5, seed=1)
    scenes = animation.record(wandering(problem))
    with pytest.raises(InputError, match=r"a\.mp4: expected a name with the suffix \.svg or \.gif"):
        animation.save_animation(scenes, problem, tmp_path / "a.mp4")
    with pytest.raises(InputError, match=r"fps: expected 0\.1 to 50"):
        animation.save_animation(scenes, problem, tmp_path / "a.gif", fps=float("nan"))
    with pytest.raises(InputError, match="frames: expected at least 2"):
        animation.record(wandering(problem), 1)
    with pytest.raises(InputError, match="at least one state"):
        animation.record([])
    monkeypatch.setattr(animation, "MOST_PARTS", 5)
    with pytest.raises(InputError, match="expected at most 5 moving parts"):
        animation.save_animation(scenes, problem, tmp_path / "a.svg")
    assert not list(tmp_path.iterdir())


def test_the_command(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (problem,) = generate(1, nets=5, seed=1)
    problem.write("p.gr")
    sequential_astar(problem).write("p.astar.solution")
    Solution(problem, [np.empty(0, np.int64)] * 5).write("nothing.solution")

    def run(*arguments):
        status = cli.status(["animate", "p.gr", *arguments])
        return status, *capfd.readouterr()

    for out in ("a.svg", "b.gif"):
        status, text, _ = run("--out", out)
        assert (status, f"in {out}: step" in text) == (0, True)
    assert run("p.astar.solution", "--out", "c.svg")[0] == 0
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "c.svg").read_bytes()
    assert "<title>p: A*</title>" in (tmp_path / "a.svg").read_text("utf-8")
    status, text, notes = run("nothing.solution", "--out", "d.svg", "--frames", "4")
    assert (status, notes) == (0, "5 open nets go on as A* would\n")
    assert text.startswith("4 pictures") or text.startswith("3 pictures")
    for arguments, expected in (
        (["--out", "x.png"], "x.png: expected a name with the suffix"),
        (["--out", "x.svg", "--router", "dqn"], "--router dqn: expected --checkpoint"),
        (["--out", "x.svg", "--router", "astra"], "did you mean astar?"),
        (["--out", "x.svg", "p.astar.solution", "--router", "astar"], "only one of SOLUTION"),
        (["--out", "x.svg", "--frames", "1"], "frames: expected at least 2"),
        (["--out", "x.svg", "--fps", "0"], "fps: expected"),
        (["--out", "x.svg", "missing"], "missing: cannot be read"),
        (["--out", "x.svg", "--checkpoint", "p.gr"], "p.gr: "),
        (["--out", "x.svg", "--checkpoint", "p.gr", "--turn-order", "sequential"], "--turn-order"),
        (["--out", "p.gr/x.svg"], "cannot be written"),
    ):
        status, _, error = run(*arguments)
        assert (status, error.count("\n")) == (2, 1)
        assert expected in error
    assert not (tmp_path / "x.svg").exists()


@pytest.mark.slow
def test_a_trained_policy_plays_its_own_game(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    generate(1, grid=(4, 4, 2), nets=3, seed=1)[0].write("p.gr")
    (tmp_path / "c.yaml").write_text(
        "{env: {problem: p.gr, agents: multi, max_steps: 9}, out: run,"
        " train: {episodes: 2, figures: false, tensorboard: false}}"
    )
    assert cli.status(["train", "c.yaml"]) == 0
    capfd.readouterr()
    assert (
        cli.status(
            ["route", "p.gr", "--router", "dqn", "--checkpoint", "run/policy.pt", "--out", "s"]
        )
        == 0
    )
    routed = dict(line.split(maxsplit=1) for line in capfd.readouterr().out.splitlines())
    assert cli.status(["animate", "p.gr", "--checkpoint", "run/policy.pt", "--out", "a.svg"]) == 0
    assert f"wirelength {routed['wirelength']}" in capfd.readouterr().out
