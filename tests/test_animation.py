"""Animations: every picture is a state of the game."""

import io
import itertools
import xml.etree.ElementTree as ElementTree
from collections import Counter

import numpy as np
import pytest
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st
from strategies import problems

from marouting import Engine, Field, InputError, Solution, evaluate, generate, sequential_astar
from marouting.render import colour_of, rgb_array, scene_of
from marouting.search.guides import AStar

animation = pytest.importorskip("policies.figures.animation", exc_type=ImportError)
film = pytest.importorskip("policies.figures.film", exc_type=ImportError)
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

    def value(self, element, attribute, moment, still):
        """An attribute at the beginning of a moment; None: where nothing moves."""
        found = [e for e in element.findall(f"{SVG}animate") if e.get("attributeName") == attribute]
        if not found or moment is None:
            return element.get(attribute, still)
        times = [float(time) for time in found[0].get("keyTimes").split(";")]
        values = found[0].get("values").split(";")
        if found[0].get("calcMode") == "discrete":
            return values[np.searchsorted(times, (moment + 0.5) * self.share, side="right") - 1]
        return np.interp(moment * self.share, times, np.array(values, float))

    def lines(self, moment):
        """The length of the drawn line of every net, by its colour, in edges."""
        found = Counter()
        for path in self.root.iter(f"{SVG}path"):
            if path.get("pathLength"):
                length = int(path.get("pathLength"))
                hidden = float(self.value(path, "stroke-dashoffset", moment, 0))
                found[path.get("stroke")] += round(length - hidden)
        return +found

    def vias(self, moment):
        """The number of vias that are shown."""
        return sum(
            path.get("d").count("h0")
            for path in self.root.iter(f"{SVG}path")
            if path.get("stroke-linecap")
            and self.value(path, "visibility", moment, "visible") == "visible"
        )

    def heads(self, moment):
        """The colours of the heads that are shown."""
        return Counter(
            head.get("fill")
            for head in self.root.iter(f"{SVG}circle")
            if head.findall(f"{SVG}animateMotion")
            and self.value(head, "visibility", moment, "visible") == "visible"
        )


def css(net):
    return "#{:02x}{:02x}{:02x}".format(*colour_of(net))


def check(scenes, fps=7.0):
    text = animation.svg(scenes, "title", fps)
    assert text == animation.svg(scenes, "title", fps)
    shown = Film(text, len(scenes), fps)
    moving = {net for scene in scenes for net in scene.nets[scene.edges % 3 != 2].tolist()}
    for moment, scene in [*enumerate(scenes), (None, scenes[-1])]:
        inside = scene.edges % 3 != 2
        assert shown.lines(moment) == Counter(map(css, scene.nets[inside].tolist()))
        columns = zip(
            scene.nets[~inside].tolist(), (scene.edges[~inside] // 3).tolist(), strict=True
        )
        layers = scene.grid.shape[2]
        dots = len({(net, gcell // layers) for net, gcell in columns})
        assert dots <= shown.vias(moment) <= np.count_nonzero(~inside)
        assert shown.heads(moment) == Counter(css(n) for n in scene.active.tolist() if n in moving)
    # Nothing runs in it but the animation.
    tags = {e.tag.removeprefix(SVG) for e in shown.root.iter()}
    still = {"svg", "title", "style", "rect", "g", "path", "circle", "text"}
    assert tags <= {*still, "animate", "animateMotion"}
    return shown


@examples(12)
@given(problems(), st.integers(0, 9))
def test_an_svg_shows_the_states_of_the_game(problem, seed):
    if any(len(cells) > 1 for cells in problem.pin_gcells):
        check(animation.record(wandering(problem, seed, 25)))


def test_what_is_given_back_vanishes_and_comes_again():
    (problem,) = generate(1, nets=6, capacity=1, seed=1)
    scenes = animation.record(wandering(problem), 200)
    pairs = [set(zip(s.nets.tolist(), s.edges.tolist(), strict=True)) for s in scenes]
    assert any(before - after for before, after in itertools.pairwise(pairs))
    shown = check(scenes)
    drawn = [shown.lines(moment).total() for moment in range(len(scenes))]
    assert any(before > after for before, after in itertools.pairwise(drawn))


@pytest.mark.parametrize("turn_order", ["sequential", "round_robin"])
def test_a_solution_is_replayed_to_its_end(turn_order):
    (problem,) = generate(1, nets=20, max_pins=3, capacity=3, seed=5)
    solution = sequential_astar(problem)
    scenes = animation.record(animation.replay(problem, solution, turn_order), 500)
    figures = evaluate(problem, solution)
    assert f"overflow {figures.overflow}  wirelength {figures.wirelength}" in scenes[-1].caption
    assert scenes[0].caption.startswith("step 0 ")
    check(scenes)
    uses = scenes[-1].nets, scenes[-1].edges
    assert sorted(zip(*uses, strict=True)) == list(zip(*solution.uses, strict=True))


def place(head, moment, share):
    """Where the head of an agent is at a moment, in px."""
    (motion,) = head.findall(f"{SVG}animateMotion")
    times, points = (
        [float(part) for part in motion.get(name).split(";")] for name in ("keyTimes", "keyPoints")
    )
    runs = [
        np.array([point.split() for point in run.split("L")], float)
        for run in motion.get("path").split("M")[1:]
    ]
    lines = [line for run in runs for line in itertools.pairwise(run)]
    lengths = [np.abs(end - start).sum() for start, end in lines]
    left = np.interp(moment * share + 1e-6, times, points) * sum(lengths)
    for (start, end), length in zip(lines, lengths, strict=True):
        if left < length:
            return start + (end - start) * left / length
        left -= length
    return lines[-1][1]


def ripping_up(problem):
    """A* with a rip-up round, in which nets walk again from their first pins."""
    engine = Engine([problem], rip_up={"rounds": 1}, max_steps=50)
    guide = AStar(engine)
    yield engine
    while (engine.games["agent"] >= 0).any():
        engine.step(guide.moves(*engine.pairs(everyone=False)))
        yield engine


@pytest.mark.parametrize("game", ["replay", "rip-up"])
def test_heads_are_where_the_agents_are(game):
    (problem,) = generate(1, grid=(6, 6, 2), nets=12, capacity=3, seed=5)
    states = (
        ripping_up(problem)
        if game == "rip-up"
        else animation.replay(problem, sequential_astar(problem), "round_robin")
    )
    scenes = animation.record(states, 900)
    fps = 7.0
    svg = Film(animation.svg(scenes, "title", fps), len(scenes), fps)
    heads = {
        head.get("fill"): head
        for head in svg.root.iter(f"{SVG}circle")
        if head.findall(f"{SVG}animateMotion")
    }
    offsets = {}
    for moment, scene in enumerate(scenes):
        routed = set(scene.nets[scene.edges % 3 != 2].tolist())
        for net, cell in zip(scene.active.tolist(), scene.heads.tolist(), strict=True):
            if net in routed:
                x, y, _ = np.unravel_index(cell, problem.grid)
                at = place(heads[css(net)], moment, svg.share)
                offsets.setdefault(net, []).append(at - 52 * np.array([x, 5 - y]))
    assert len(offsets) > 8
    for net, own in offsets.items():  # its track, the same everywhere
        assert np.ptp(own, axis=0).max() < 1.5, net


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
    (problem,) = generate(1, nets=5, seed=1)
    scenes = animation.record(animation.replay(problem, sequential_astar(problem)))
    name = "<script>alert(1)</script></title>&amp;]]>"
    animation.save_animation(scenes, tmp_path / "a.svg", f"{name}\udcff")
    root = ElementTree.fromstring((tmp_path / "a.svg").read_bytes())
    (title,) = root.iter(f"{SVG}title")
    assert title.text.startswith(name)
    assert not list(root.iter(f"{SVG}script"))


def test_what_cannot_be_drawn(tmp_path, monkeypatch):
    (problem,) = generate(1, nets=5, seed=1)
    scenes = animation.record(wandering(problem))
    with pytest.raises(InputError, match=r"a\.mp4: expected a name with the suffix \.svg or \.gif"):
        animation.save_animation(scenes, tmp_path / "a.mp4")
    with pytest.raises(InputError, match="frames: expected at least 2"):
        animation.record(wandering(problem), 1)
    with pytest.raises(InputError, match="at least one state"):
        animation.record([])
    monkeypatch.setattr(film, "MOST_PARTS", 5)
    with pytest.raises(InputError, match="expected at most 5 parts"):
        animation.save_animation(scenes, tmp_path / "a.svg")
    assert not list(tmp_path.iterdir())


def test_the_command(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (problem,) = generate(1, nets=5, seed=1)
    problem.write("p.gr")
    sequential_astar(problem).write("p.astar.solution")
    Solution(problem, [np.empty(0, np.int64)] * 5).write("nothing.solution")

    def run(*arguments):
        status = cli.status(["view", "p.gr", *arguments])
        return status, *capfd.readouterr()

    for out in ("a.svg", "b.gif"):
        status, text, _ = run("--out", out)
        assert (status, f"in {out}: step" in text) == (0, True)
    assert run("p.astar.solution", "--out", "c.svg")[0] == 0
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "c.svg").read_bytes()
    assert "<title>p: A*</title>" in (tmp_path / "a.svg").read_text("utf-8")
    status, text, notes = run("nothing.solution", "--out", "d.svg", "--frames", "4")
    assert (status, notes) == (0, "5 open nets: A* completes them in the animation\n")
    assert text.startswith("4 pictures") or text.startswith("3 pictures")
    for arguments, expected in (
        (["--out", "x.bmp"], "x.bmp: expected a name with the suffix .html"),
        (["--out", "x.svg", "p.astar.solution", "--checkpoint", "p.pt"], "only one of SOLUTION"),
        (["--out", "x.svg", "--frames", "1"], "--frames: expected a number from 2"),
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
    assert cli.status(["view", "p.gr", "--checkpoint", "run/policy.pt", "--out", "a.svg"]) == 0
    assert f"wirelength {routed['wirelength']}" in capfd.readouterr().out


def test_walls_and_closed_gcells_are_drawn():
    # Columns 0 and 1, a wall, columns 2 and 3; the gate is in row 0; nothing leads to column 4.
    field = Field(5, 3).wall(right_of=1).gate(right_of=1, row=0, tracks=1)
    problem = field.wall(right_of=3).area((4, 4), (0, 2)).net((0, 0), (3, 0)).problem()
    text = film.svg([scene_of(Engine([problem]))], "", 2)
    (ground,) = (path for path in paths(text) if path.get("fill") == "#eef0f4")
    assert ground.get("d").count("z") == 4 * 3
    (walls,) = (path for path in paths(text) if path.get("stroke") == "#202020")
    assert walls.get("d").count("v") == 2  # the wall in rows 1 and 2
    assert "h" not in walls.get("d")
    assert len({line.split()[0] for line in walls.get("d").split("M")[1:]}) == 1


def paths(text):
    return ElementTree.fromstring(text).findall(f"{SVG}path")
