"""The page of ``marouting view``: what is in it, and how a browser shows it."""

import base64
import builtins
import json
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from strategies import solved_problems

from marouting import InputError, Solution, evaluate, generate, sequential_astar

pytest.importorskip("plotly")
view = pytest.importorskip("policies.figures.view", exc_type=ImportError)
cli = pytest.importorskip("policies.cli.main", exc_type=ImportError)

HOSTILE = (
    "<script>window.hacked=1</script>",
    "</script><script>window.hacked=2</script>",
    "<img/src=x/onerror=window.hacked=3>",
    "{{plotly}}",
    "$&<b>bold</b>&lt;i&gt;",
    "<!--",
    '";window.hacked=4;"',
    "é🙂",
)


class Page(HTMLParser):
    """The scripts and the attributes of a page."""

    def __init__(self, text):
        super().__init__()
        self.scripts, self.attributes, self.tags, self._inside = [], [], [], False
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name) for name, _ in attrs]
        self._inside = tag == "script"
        if self._inside:
            self.scripts.append("")

    def handle_endtag(self, _):
        self._inside = False

    def handle_data(self, data):
        if self._inside:
            self.scripts[-1] += data


def array(pair):
    kind, text = pair
    return np.frombuffer(base64.b64decode(text), f"<{kind}")


def routed(nets=12, names=None, capacity=4):
    (problem,) = generate(1, nets=nets, capacity=capacity, max_pins=3, seed=4)
    if names:
        nets = [replace(net, name=name) for net, name in zip(problem.nets, names, strict=False)]
        problem = replace(problem, nets=(*nets, *problem.nets[len(nets) :]))
    return problem, sequential_astar(problem)


def empty(problem):
    return Solution(problem, [np.empty(0, np.int64)] * len(problem.nets))


@given(solved_problems())
def test_the_data_of_a_page_are_the_solution(solution):
    problem = solution.problem
    data = json.loads(json.dumps(view.page_data(problem, {"one": solution}, "title")))
    (shown,), figures = data["solutions"], evaluate(problem, solution)
    assert (data["grid"], data["nets"]) == (list(problem.grid), [net.name for net in problem.nets])
    assert [shown[name] for name in ("overflow", "max_overflow", "wirelength", "vias")] == [
        figures.overflow, figures.max_overflow, figures.wirelength, figures.vias,
    ]  # fmt: skip
    assert [problem.nets[net].name for net in shown["open"]] == list(figures.disconnected)
    # The runs, walked edge by edge, are the routes.
    routes = [[] for _ in problem.nets]
    runs = zip(
        *(array(shown[key]).tolist() for key in ("net", "x", "y", "z", "axis", "length")),
        strict=True,
    )
    for net, x, y, z, axis, length in runs:
        for step in range(length):
            at = [x, y, z]
            at[axis] += step
            routes[net].append(3 * problem.topology.number(*at) + axis)
    assert Solution(problem, [np.array(route, np.int64) for route in routes]) == solution
    assert array(shown["wirelength_of"]).tolist() == [len(edges) for edges in solution.edges]
    # Every edge inside a layer is in a map, or has neither capacity nor demand.
    capacity, demand = np.zeros((2, problem.topology.edges), np.int64)
    columns, rows, _ = problem.grid
    for kind, tracks in zip(data["maps"], shown["demand"], strict=True):
        z, axis = kind["layer"] - 1, kind["axis"]
        wide, high = columns - (axis == 0), rows - (axis == 1)
        for e in range(wide * high):
            edge = 3 * problem.topology.number(*divmod(e, high), z) + axis
            capacity[edge], demand[edge] = array(kind["capacity"])[e], array(tracks)[e]
    inside = np.arange(problem.topology.edges) % 3 != 2
    assert np.array_equal(capacity[inside], problem.capacity[inside])
    assert np.array_equal(demand[inside], solution.edge_demand[inside])
    pins = {
        (net, problem.topology.number(x, y, z))
        for net, x, y, z in zip(
            *(array(data["pins"][key]).tolist() for key in ("net", "x", "y", "z")), strict=True
        )
    }
    assert pins == {
        (n, gcell) for n, own in enumerate(problem.pin_gcells) for gcell in own.tolist()
    }


def test_a_page_is_whole_the_same_twice_and_loads_nothing():
    problem, solution = routed()
    solutions = {"astar": solution, "nothing": empty(problem)}
    text = view.page(problem, solutions, "name")
    assert text == view.page(problem, solutions, "name")
    found = Page(text)
    assert not {name for _, name in found.attributes} & {"src", "href", "srcset", "action"}
    assert "link" not in found.tags
    assert "default-src 'none'" in text
    assert json.loads(found.scripts[0]) == view.page_data(problem, solutions, "name")
    assert "plotly.js" in found.scripts[1][:500]
    assert len(found.scripts) == 3


def test_names_are_text():
    problem, solution = routed(names=HOSTILE)
    harmless, plain = routed()
    assert "\\udcff" in view.page(problem, {"\udcff": solution}, "\udcff")  # of a file's name
    title = "</title><script>window.hacked=5</script>"
    text = view.page(problem, {HOSTILE[1]: solution}, title)
    found, usual = Page(text), Page(view.page(harmless, {"astar": plain}, "t"))
    assert found.tags == usual.tags
    assert found.scripts[1:] == usual.scripts[1:]
    data = json.loads(found.scripts[0])
    assert data["nets"][: len(HOSTILE)] == list(HOSTILE)
    assert (data["title"], data["solutions"][0]["name"]) == (title, HOSTILE[1])


def test_nets_keep_their_places_and_colours_in_all_solutions():
    problem, solution = routed()
    both = view.page_data(problem, {"a": solution, "b": empty(problem)}, "")
    assert (
        array(both["shift"]).tolist()
        == array(
            view.page_data(problem, {"b": empty(problem), "a": solution}, "")["shift"]
        ).tolist()
    )
    assert len(set(both["palette"])) == len(both["palette"]) > 20


def test_what_cannot_be_shown():
    problem, _ = routed()
    other, _ = routed(nets=3)
    with pytest.raises(InputError, match="at least one solution"):
        view.page(problem, {}, "")
    with pytest.raises(InputError, match="wrong: expected a solution of this problem"):
        view.page(problem, {"wrong": empty(other)}, "")


def test_a_missing_extra_is_one_line(monkeypatch, tmp_path, capfd):
    problem, solution = routed()
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.split(".")[0] == "plotly":
            raise ModuleNotFoundError(f"No module named {name!r}", name="plotly")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    problem.write(tmp_path / "p.gr")
    solution.write(tmp_path / "s.solution")
    out = tmp_path / "page.html"
    assert (
        cli.status(
            ["view", str(tmp_path / "p.gr"), str(tmp_path / "s.solution"), "--out", str(out)]
        )
        == 2
    )
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "pip install 'marouting[view]'" in error
    assert not out.exists()


def test_the_command_takes_files_folders_and_run_folders(tmp_path, capfd):
    problem, solution = routed()
    problem.write(tmp_path / "p.gr")
    run, rounds = tmp_path / "run/solutions", tmp_path / "rounds"
    for file in (
        run / "p.astar.solution",
        run / "q.astar.solution",
        rounds / "r10.solution",
        rounds / "r9.solution",
    ):
        solution.write(file)
    empty(problem).write(run / "p.mine.solution")

    def names(*paths):
        out = tmp_path / "page.html"
        arguments = ["view", str(tmp_path / "p.gr"), *map(str, paths), "--out", str(out)]
        assert cli.status(arguments) == 0, capfd.readouterr().err
        return [s["name"] for s in json.loads(Page(out.read_text("utf-8")).scripts[0])["solutions"]]

    assert names(run / "q.astar.solution") == ["q.astar"]
    assert names(tmp_path / "run") == ["A*", "mine"]  # as figures call it
    assert names(rounds, run / "p.astar.solution") == ["r9", "r10", "A*"]
    assert names(rounds / "r9.solution", rounds / "r9.solution") == ["r9", "r9 (2)"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["p.gr", "missing.solution"], "missing.solution: cannot be read"),
        (["missing.gr", "s.solution"], "missing.gr: cannot be read"),
        (["p.gr", "damaged.solution"], "damaged.solution:1"),
        (["p.gr", "nothing"], "nothing: expected files of solutions of p"),
    ],
)
def test_bad_input_is_one_line(tmp_path, monkeypatch, capfd, arguments, expected):
    problem, solution = routed()
    monkeypatch.chdir(tmp_path)
    problem.write("p.gr")
    solution.write("s.solution")
    (tmp_path / "damaged.solution").write_text("A1 0 x\n")
    (tmp_path / "nothing").mkdir()
    assert cli.status(["view", *arguments, "--out", "page.html"]) == 2
    error = capfd.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not (tmp_path / "page.html").exists()


# In a browser -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api")
    chromium = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )
    if chromium is None:
        pytest.skip("no Chromium is installed")
    with api.sync_playwright() as play:
        # The software renderer: a machine for tests has no graphics card.
        options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        running = play.chromium.launch(executable_path=chromium, args=options)
        yield running
        running.close()


@pytest.fixture
def shown(browser, tmp_path):
    """Opens solutions of a problem; gives the page, and the errors and requests it made."""
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    trouble = []
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("console", lambda message: message.type == "error" and trouble.append(message.text))
    page.on("dialog", lambda dialog: trouble.append(dialog.message))
    page.on(
        "request", lambda r: None if r.url.startswith(("file:", "blob:")) else trouble.append(r.url)
    )

    def show(problem, solutions, title="problem"):
        file = tmp_path / "page.html"
        file.write_text(view.page(problem, solutions, title), encoding="utf-8")
        page.goto(file.as_uri(), wait_until="commit")
        wait(page)
        return page

    yield show
    page.close()
    assert trouble == []


def wait(page):
    page.wait_for_function("document.body.dataset.ready === 'yes'", timeout=120_000)


def traces(page, scene="scene"):
    """The number of points by the trace's name."""
    return page.evaluate(
        """(scene) => Object.fromEntries(document.getElementById("scene").data
            .filter((t) => t.scene === scene)
            .map((t) => [t.name, t.x.filter((x) => !Number.isNaN(x)).length]))""",
        scene,
    )


@pytest.mark.slow
def test_titles_side_by_side_do_not_meet(shown):
    problem, solution = routed()
    name = "a router that somebody has tuned for days and days, and then for days"
    page = shown(problem, {name: solution, f"{name} again": empty(problem)})
    for panels in ("scene", "map0"):
        titles = page.locator(f"#{panels} .annotation-text")
        left, right = (titles.nth(n).bounding_box() for n in range(2))
        assert left["x"] + left["width"] < right["x"]
        assert "wirelength" in titles.first.text_content()
    assert name in page.locator(".card").first.text_content()


@pytest.mark.slow
def test_two_solutions_in_a_browser(shown):
    problem, solution = routed(names=HOSTILE, capacity=2)
    page = shown(problem, {"astar": solution, HOSTILE[0]: empty(problem)}, HOSTILE[1])
    figures = evaluate(problem, solution)
    assert page.evaluate("window.hacked") is None
    assert page.locator("#nets .name").all_text_contents() == [net.name for net in problem.nets]
    left, right = page.locator(".card").all_text_contents()
    assert f"overflow {figures.overflow} " in left
    assert f"wirelength {figures.wirelength} " in left
    assert HOSTILE[0] in right
    assert f"open nets {len(evaluate(problem, empty(problem)).disconnected)} of 12" in right
    # Every run of the left solution has a point at each Gcell, and the right one has none.
    before = traces(page)
    drawn = before["layer 1"] + before["layer 2"] + before["via"]
    runs = len(array(view.page_data(problem, {"a": solution}, "")["solutions"][0]["net"]))
    assert drawn == figures.wirelength + runs
    assert traces(page, "scene2")["layer 1"] == 0
    # The heat maps hold demand / capacity of every edge.
    kinds = view.page_data(problem, {"a": solution}, "")["maps"]
    demand, capacity = (
        table.astype(np.int64).reshape(*problem.grid, 3)
        for table in (solution.edge_demand, problem.capacity)
    )
    for m, kind in enumerate(kinds):
        z, axis = kind["layer"] - 1, kind["axis"]
        cut = (slice(problem.grid[0] - (axis == 0)), slice(problem.grid[1] - (axis == 1)), z, axis)
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = 100 * demand[cut] / capacity[cut]
        values = page.evaluate(f"document.getElementById('map{m}').data[0].z")
        for (x, y), value in np.ndenumerate(expected):
            if not np.isinf(value):
                assert values[y][x] == (None if np.isnan(value) else pytest.approx(value))
    # Layers, nets, cameras.
    page.uncheck("#layer2")
    wait(page)
    assert traces(page) == {**before, "layer 2": 0, "overflowed": traces(page)["overflowed"],
                            "pin": before["pin"]}  # fmt: skip
    page.check("#layer2")
    wait(page)
    busiest = int(np.argmax([len(edges) for edges in solution.edges]))
    page.click(f"#nets li:nth-child({busiest + 1})")
    wait(page)
    assert traces(page)["pin"] == len(problem.pin_gcells[busiest])
    assert page.locator("#nets li[aria-selected=true]").count() == 1
    page.click("#all")
    wait(page)
    assert traces(page) == before
    eye = {"x": 1, "y": 2, "z": 0.5}
    page.evaluate("(eye) => Plotly.relayout('scene', {'scene.camera': {eye}})", eye)
    page.wait_for_function("document.getElementById('scene').layout.scene2.camera.eye.y === 2")
    assert page.evaluate("document.getElementById('scene').layout.scene2.camera.eye") == eye
    page.fill("#find", "bold")
    assert page.locator("#nets li:visible").count() == 1
    assert page.evaluate("window.hacked") is None


@pytest.mark.slow
def test_a_slider_leads_through_many_solutions(shown):
    problem, solution = routed()
    half = Solution(
        problem, [edges if n % 2 else edges[:0] for n, edges in enumerate(solution.edges)]
    )
    page = shown(problem, {"first": empty(problem), "second": half, "third": solution})
    assert page.locator(".card h2").all_text_contents() == ["A: first", "B: third"]
    page.fill("#right", "1")
    wait(page)
    assert page.locator(".card h2").all_text_contents() == ["A: first", "B: second"]
    assert (
        f"wirelength {evaluate(problem, half).wirelength} "
        in page.locator(".card").last.text_content()
    )
    page.select_option("#left", "2")
    wait(page)
    assert page.locator(".card h2").all_text_contents() == ["A: third", "B: second"]
    assert page.locator("#where").text_content() == "2 of 3: second"
