"""Files as others leave them: compressed, with a byte order mark, Windows line ends, capitals."""

import gzip
import json
import os
import threading
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from test_bad_files import GR, SOLUTION
from test_ispd2024 import CAP, NET, ROUTES

from marouting import InputError, Problem, Solution
from marouting.files import beside, read_text, stem_of, suffix_of
from marouting.source import load_problems
from marouting.yaml_files import read_yaml
from policies.cli.main import status
from policies.figures.plot import plot
from policies.results.rows import read_published

CASES = Path(__file__).resolve().parents[2] / "shared" / "data" / "cases"
BOM = b"\xef\xbb\xbf"
CSV = "set,problem,of,wl\ns,p,0,12\n"
FORMS: dict[str, Callable[[bytes], bytes]] = {
    "mark": lambda content: BOM + content,
    "windows": lambda content: content.replace(b"\n", b"\r\n"),
    "gzip": gzip.compress,
    "all": lambda content: gzip.compress(BOM + content.replace(b"\n", b"\r\n")),
    # cat of two compressed files is one compressed file.
    "parts": lambda content: gzip.compress(content[:20]) + gzip.compress(content[20:]),
}


def put(folder: Path, content: dict[str, str], form: str = "", named: str = "{}") -> None:
    """Writes files in one of the forms."""
    for name, text in content.items():
        raw = text.encode()
        (folder / named.format(name)).write_bytes(FORMS[form](raw) if form else raw)


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """A folder with problems and solutions in all formats, as they are written here."""
    folder = tmp_path / "plain"
    folder.mkdir()
    put(folder, {"p.gr": GR, "p.solution": SOLUTION, "x.cap": CAP, "x.net": NET})
    put(folder, {"x.PR_output": ROUTES, "s.csv": CSV, "c.yaml": "a: 1\nb: [é]\n"})
    problem = Problem.read(folder / "p.gr")
    Solution.read(folder / "p.solution", problem).write(folder / "p.guide")
    return folder


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("zipped", [False, True])
def test_all_readers(plain: Path, tmp_path: Path, form: str, zipped: bool) -> None:
    own, suffix = tmp_path / "own", ".gz" if zipped else ""
    own.mkdir()
    for file in plain.iterdir():
        put(own, {file.name: file.read_text()}, form, f"{{}}{suffix}")
    problem = Problem.read(own / f"p.gr{suffix}")
    assert problem == Problem.read(plain / "p.gr")
    for name in ("p.solution", "p.guide"):
        routes = Solution.read(plain / name, problem)
        assert len(routes.uses[1])
        assert Solution.read(own / f"{name}{suffix}", problem) == routes
    contest = Problem.read(own / f"x.cap{suffix}")
    assert contest == Problem.read(plain / "x.cap")
    assert contest.chip is not None
    assert contest.chip.contest is not None
    routes = Solution.read(plain / "x.PR_output", contest)
    assert Solution.read(own / f"x.PR_output{suffix}", contest) == routes
    assert read_yaml(own / f"c.yaml{suffix}") == {"a": 1, "b": ["é"]}
    published = read_published(own / f"s.csv{suffix}", "of", "wl")
    assert published == {("s", "p"): (0, 12)}


@pytest.mark.parametrize(
    ("design", "library"),
    [
        ("chip.def", "chip.lef"),
        ("chip.def.gz", "chip.lef"),
        ("chip.def", "chip.lef.gz"),
        ("chip.def.gz", "chip.lef.gz"),
        ("CHIP.DEF", "CHIP.LEF"),
        ("chip.DEF", "chip.LEF.gz"),
    ],
)
@pytest.mark.parametrize("form", ["", "mark", "windows", "gzip", "all"])
def test_designs(tmp_path: Path, design: str, library: str, form: str) -> None:
    pytest.importorskip("klayout.db")
    from test_lefdef import DEF, LEF

    put(tmp_path, {"plain.def": DEF, "plain.lef": LEF})
    put(tmp_path, {design: DEF, library: LEF}, form)
    assert Problem.read(tmp_path / design) == Problem.read(tmp_path / "plain.def")
    given = Problem.read(tmp_path / design, lef=[tmp_path / library])
    assert given == Problem.read(tmp_path / "plain.def")


@pytest.mark.skipif(not CASES.exists(), reason="needs the cases in ../shared/data")
@pytest.mark.parametrize("name", ["p.gr", "chip.def"])
def test_the_case_of_byte_order_marks(name: str) -> None:
    if name == "chip.def":
        pytest.importorskip("klayout.db")
    file = CASES / "bom" / name
    assert file.read_bytes().startswith(BOM)
    assert Problem.read(file).nets


def test_names_in_capitals(plain: Path) -> None:
    put(plain, {"X.CAP": CAP, "X.NET": NET, "Y.CAP": CAP, "Y.net": NET, "Z.Gr": GR})
    put(plain, {"P.SOLUTION": SOLUTION})
    problem = Problem.read(plain / "x.cap")
    assert Problem.read(plain / "X.CAP") == Problem.read(plain / "Y.CAP") == problem
    assert Problem.read(plain / "Z.Gr") == Problem.read(plain / "p.gr")
    routes = Solution.read(plain / "x.PR_output", problem)
    routes.write(plain / "again.pr_OUTPUT")
    routes.write(plain / "again.PR_output")
    assert (plain / "again.pr_OUTPUT").read_bytes() == (plain / "again.PR_output").read_bytes()
    with pytest.raises(InputError, match=r"expected no net: only \.cap files take it"):
        Problem.read(plain / "p.gr", net=plain / "x.net")


def test_what_names_say(tmp_path: Path) -> None:
    for name in ("chip.def", "CHIP.DEF", "chip.def.gz", "a.b.DEF.GZ"):
        assert suffix_of(tmp_path / name) == ".def"
    assert [stem_of(name) for name in ("a/chip.def.gz", "b/a.b.DEF", "c")] == ["chip", "a.b", "c"]
    assert suffix_of("chip.gz") == ""
    # What is there counts; of several, the plainest name; of none, the message names the plain one.
    assert beside(tmp_path / "chip.def.gz", ".lef") == tmp_path / "chip.lef"
    for name in ("chips.lef", "chip.LEF.gz", "chip.lef.gz", "chip.lef"):
        (tmp_path / name).touch()
    assert beside(tmp_path / "chip.def.gz", ".lef") == tmp_path / "chip.lef"
    (tmp_path / "chip.lef").unlink()
    assert beside(tmp_path / "chip.def.gz", ".lef") == tmp_path / "chip.LEF.gz"
    assert beside(tmp_path / "missing" / "chip.def", ".lef") == tmp_path / "missing" / "chip.lef"


def test_a_folder_of_problems(tmp_path: Path) -> None:
    put(tmp_path, {"b.gr.gz": GR}, "gzip")
    put(tmp_path, {"A.GR": GR, "c.gr": GR, "d.gr.txt": "no problem"})
    assert list(load_problems(str(tmp_path))) == ["A", "b", "c"]
    put(tmp_path, {"c.gr.gz": GR}, "gzip")
    with pytest.raises(InputError, match="expected every file once, with different names"):
        load_problems(str(tmp_path))


@pytest.mark.parametrize("form", ["", "gzip", "all"])
def test_a_pipe_that_gives_byte_after_byte(form: str) -> None:
    content = GR.encode()
    content = FORMS[form](content) if form else content
    out, into = os.pipe()

    def fill() -> None:
        with os.fdopen(into, "wb", buffering=0) as pipe:
            for at in range(len(content)):
                pipe.write(content[at : at + 1])
                time.sleep(0.001 * (at < 20))

    thread = threading.Thread(target=fill)
    thread.start()
    try:
        assert Problem.read(f"/dev/fd/{out}").grid == (3, 2, 2)
    finally:
        thread.join()
        os.close(out)


def test_damaged_data_are_one_line(tmp_path: Path) -> None:
    file, whole = tmp_path / "p.gr.gz", gzip.compress(GR.encode())
    damaged = [whole[:size] for size in range(2, len(whole))]
    damaged += [
        whole + b"more",
        whole[:-8] + b"\0\0\0\0" + whole[-4:],
        whole[:-4] + b"\0\0\0\0",
        whole[:10] + b"\xff" + whole[11:],
        b"\x1f\x8b\x09" + whole[3:],
    ]
    for content in damaged:
        file.write_bytes(content)
        with pytest.raises(InputError) as caught:
            Problem.read(file)
        assert str(caught.value).startswith(f"{file}: expected gzip data: ")
        assert "\n" not in str(caught.value)
        with pytest.raises(InputError, match="expected gzip data: "):
            read_text(file, 10**6)


@pytest.mark.parametrize("content", [b"\0", b"7 ", b"grid 9 9 9\n"])
def test_a_bomb_takes_no_more_memory_than_text(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "p.gr.gz"
    with gzip.open(file, "wb", 1) as bomb:
        for _ in range(64):
            bomb.write(content * (2**20 // len(content)))
    assert file.stat().st_size < 2**20
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            Problem.read(file)
        with pytest.raises(InputError, match="expected at most 1 MiB"):
            read_text(file, 2**20)
        assert tracemalloc.get_traced_memory()[1] < 12 * 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("zipped", [False, True])
def test_utf_16_is_named(tmp_path: Path, encoding: str, zipped: bool) -> None:
    content = ("\ufeff" + GR).encode(encoding)
    file = tmp_path / "p.gr"
    file.write_bytes(gzip.compress(content) if zipped else content)
    for read in (Problem.read, read_yaml):
        with pytest.raises(InputError) as caught:
            read(file)
        assert str(caught.value) == f"{file}: expected UTF-8 text, found UTF-16"


def test_what_is_written_under_the_name_gz_is_compressed(plain: Path, tmp_path: Path) -> None:
    problem = Problem.read(plain / "x.cap")
    routes = Solution.read(plain / "x.PR_output", problem)
    for name in ("r.solution", "r.guide", "r.PR_output", "r.PR_OUTPUT"):
        for file in (tmp_path / name, tmp_path / f"{name}.gz", tmp_path / f"other-{name}.GZ"):
            routes.write(file)
        content = (tmp_path / f"{name}.gz").read_bytes()
        assert gzip.decompress(content) == (tmp_path / name).read_bytes()
        # Neither the time nor the name is in it: equal routes give equal files.
        assert content == (tmp_path / f"other-{name}.GZ").read_bytes()
        assert content[4:8] == bytes(4)
    problem.write(tmp_path / "p.gr.gz")
    assert (tmp_path / "p.gr.gz").read_bytes()[:2] == b"\x1f\x8b"
    assert Problem.read(tmp_path / "p.gr.gz") == problem


def test_commands(
    plain: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(plain)
    put(plain, {"P.GR.gz": GR, "p.astar.solution.gz": SOLUTION}, "all")

    def judged(*arguments: str) -> dict[str, object]:
        assert status([*arguments, "--json"]) == 0, capsys.readouterr().err
        found: dict[str, object] = json.loads(capsys.readouterr().out)
        return {key: value for key, value in found.items() if key != "seconds"}

    expected = judged("evaluate", "p.gr", "p.solution")
    assert judged("evaluate", "P.GR.gz", "p.astar.solution.gz") == expected
    judged("evaluate", "P.GR.gz", "p.astar.solution.gz", "--report")
    judged("convert", "P.GR.gz", "g.guide.gz", "--solution", "p.astar.solution.gz")
    assert gzip.decompress(Path("g.guide.gz").read_bytes()) == Path("p.guide").read_bytes()
    of_guide = judged("evaluate", "p.gr", "p.guide")
    assert judged("evaluate", "P.GR.gz", "g.guide.gz") == of_guide
    judged("convert", "P.GR.gz", "again.gr.gz")
    assert Problem.read("again.gr.gz") == Problem.read("p.gr")
    judged("convert", "p.gr", "r.solution.gz", "--solution", "g.guide.gz")
    figures = {key: value for key, value in of_guide.items() if not key.startswith("guide_")}
    assert judged("evaluate", "p.gr", "r.solution.gz") == figures
    viewed = judged("view", "P.GR.gz", "p.astar.solution.gz", "g.guide.gz", "--out", "v.html")
    assert viewed["solutions"] == ["p.astar", "g.guide"]
    # A solution is called by what its name says beyond the problem's.
    put(plain, {"p.gr.gz": GR}, "gzip")
    viewed = judged("view", "p.gr.gz", "p.astar.solution.gz", "--out", "v.html")
    assert viewed["solutions"] == ["astar"]
    routed = judged("route", "p.gr.gz", "--router", "astar", "--out", "a.solution.gz")
    assert judged("evaluate", "p.gr", "a.solution.gz")["wirelength"] == routed["wirelength"]


@pytest.mark.usefixtures("undrawn")
def test_pictures_of_a_compressed_problem(plain: Path, tmp_path: Path) -> None:
    put(plain, {"q.gr.gz": GR, "q.txt": GR, "q.astar.solution.gz": SOLUTION}, "gzip")
    for name in ("q.gr.gz", "q.txt"):
        written = plot([plain / name, plain / "q.astar.solution.gz"], tmp_path / name)
        assert written
        assert {file.parent.name for file in written} == {"q"}
