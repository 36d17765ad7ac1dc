"""Every block of code of README.md, CONTRIBUTING.md and docs/ does what it says.

Python runs as it stands. Commands run in the order of the page, in a folder that holds the files
that pages speak of. What would take long is marked in the page, in a comment before the block:

* ``<!-- run shorter (PHRASE): KEY=VALUE … -->``: commands with the phrase run with these keys;
* ``<!-- parsed only (PHRASE): WHY -->``: commands with the phrase run up to the work itself, so
  files, options and keys are checked. Without a phrase: all commands of the block.

A block ``text`` holds all that the block before it prints. Of other programs than ours it is only
checked that what they name is there. A block ``bash`` is for the reader's own files, a block
``console`` shows output that differs from run to run: neither is run.
"""

import importlib.util
import inspect
import json
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pettingzoo
import pytest
import yaml
from test_ispd2024 import CAP, NET

import marouting
from marouting import registry
from marouting.config import build
from policies.cli.main import status
from policies.experiment import ExperimentConfig
from policies.learned.config import Config

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]

BLOCK = re.compile(
    r"((?:^<!--[^\n]*-->\n)*)^( *)```(\w*)[^\n]*\n(.*?)^\2```$", re.MULTILINE | re.DOTALL
)
MARK = re.compile(r"<!-- (run shorter|parsed only)(?: \((.*?)\))?: (.*?) -->")
OTHERS = {"pip", "git", "ruff", "mypy", "mkdocs", "pre-commit", ".", "curl"}
"""Programs that are not ours: nothing of them is checked."""


LIBRARIES = {
    *("agilerl", "benchmarl", "pufferlib", "ray", "sb3_contrib", "skrl", "stable_baselines3"),
    *("tensordict", "tianshou", "torchrl"),
}
"""Other people's libraries, whose blocks run where they are installed."""


@dataclass(frozen=True)
class Block:
    """A block of code of a page."""

    page: str
    line: int
    language: str
    code: str
    marks: tuple[tuple[str, str, str], ...]

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"


def blocks_of(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    name = page.relative_to(ROOT).as_posix()
    found = 0
    for match in BLOCK.finditer(text):
        found += 2
        marks = tuple(MARK.findall(match[1]))
        assert len(marks) == len(re.findall(r"run shorter|parsed only", match[1])), match[1]
        yield Block(name, text[: match.start(3)].count("\n") + 1, match[3], match[4], marks)
    assert found == len(re.findall(r"^ *```", text, re.MULTILINE)), f"{name}: a fence is not closed"


class WorkBegins(BaseException):
    """A command has come to its work."""


def begins(*_: Any, **__: Any) -> None:
    raise WorkBegins


class Entries:
    """In the place of an experiment: takes what the configuration names."""

    def __init__(self, config: Any) -> None:
        assert config.entries
        raise WorkBegins


class Scored:
    """In the place of a benchmark: takes what the command names."""

    def __init__(self, chosen: list[str], entries: list[Any], *_: Any, **__: Any) -> None:
        assert entries
        assert all(marouting.scenarios.get(name) for name in chosen)
        raise WorkBegins


def drawn(paths: tuple[Path, ...], _: Path | None) -> None:
    """In the place of ``marouting plot``: what is to be drawn is there."""
    assert all(path.exists() for path in paths)
    raise WorkBegins


def stop_before_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("policies.learned.run.Run", begins)
    monkeypatch.setattr("policies.experiment.Experiment", Entries)
    monkeypatch.setattr("policies.experiment.benchmark.Benchmark", Scored)
    monkeypatch.setattr("policies.bench.__main__.run", begins)
    monkeypatch.setattr("policies.cli.route.warm_up", begins)
    monkeypatch.setattr("policies.figures.plot.plot", drawn)
    monkeypatch.setattr("policies.cli.quickstart.run", begins)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all files that pages speak of without making them."""
    folder = tmp_path_factory.mktemp("inputs")
    problems = marouting.generate(2, grid=(5, 5, 2), nets=6, seed=1, reduced_edges=0)
    solution = marouting.sequential_astar(problems[0])
    (folder / "FOLDER").mkdir()
    for number, problem in enumerate(problems):
        problem.write(folder / "FOLDER" / f"problem_{number:03}.gr")
    problems[0].write(folder / "problem.gr")
    problems[0].write(folder / "ibm01.modified.txt", format="ispd98")
    for name in ("astar", "pathfinder", "my", "routes"):
        solution.write(folder / f"{name}.solution")
    for name in ("generalist", "ppo"):
        (folder / "runs" / name).mkdir(parents=True)
        weights = ROOT / "policies" / "generalist" / "generalist.pt"
        shutil.copy(weights, folder / "runs" / name / "policy.pt")
    (folder / "X.cap").write_text(CAP)
    (folder / "X.net").write_text(NET)
    (folder / "my_package").mkdir()
    (folder / "my_package" / "rewards.py").write_text(
        "class TeamReward:\n"
        "    def __init__(self, price: float = 10.0) -> None: ...\n"
        "    def __call__(self, game, before, movers): ...\n"
    )
    shutil.copytree(ROOT / "docs" / "examples", folder / "docs" / "examples")
    for file in (ROOT / "docs" / "examples").glob("own_*.py"):
        shutil.copy(file, folder)
    return folder


def take_what_is_named(inputs: Path, folder: Path, code: str) -> None:
    """Copies those files, and folders with files, whose names stand in the code of a page."""
    for path in inputs.iterdir():
        name = path.name if path.suffix != ".py" else path.stem
        if re.search(rf"(?<![\w/]){re.escape(name)}\b", code):
            (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)


def add_designs(folder: Path) -> None:
    """LEF/DEF designs and their routes; they need the extra ``lefdef``."""
    pytest.importorskip("klayout.db")
    from test_lefdef import DEF, LEF
    from test_openroad_segments import as_segments

    head, macro = LEF.split("MACRO")
    (folder / "tech.lef").write_text(f"{head}END LIBRARY\n")
    (folder / "cells.lef").write_text(f"MACRO{macro}")
    for name in ("chip", "ispd18_test1.input"):
        (folder / f"{name}.lef").write_text(LEF)
        (folder / f"{name}.def").write_text(DEF)
        problem = marouting.Problem.read(folder / f"{name}.def")
        solution = marouting.sequential_astar(problem)
        solution.write(folder / f"{name}.guide")
    shutil.copy(folder / "chip.guide", folder / "theirs.guide")
    solution.write(folder / "routes.solution")
    segments = as_segments(solution, 1).replace("Metal", "M")
    (folder / "openroad.segs").write_text(segments)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to work in, and a process that is left as it was."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)
    monkeypatch.syspath_prepend(str(home))
    registry.registered()  # the package's own components are registered when first asked for
    kinds = {kind: dict(known) for kind, known in registry._registered.items()}
    monkeypatch.setattr(registry, "_registered", kinds)
    known = set(sys.modules)
    yield home
    for name in set(sys.modules) - known:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(str(home)):
            del sys.modules[name]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_block_of_a_page(
    page: Path,
    folder: Path,
    inputs: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    blocks = list(blocks_of(page))
    code = "".join(block.code for block in blocks)
    take_what_is_named(inputs, folder, code)
    missing: list[str] = []
    printed = ""
    if re.search(r"\.def\b", code):
        add_designs(folder)
    for block in blocks:
        monkeypatch.chdir(folder)
        check = {"python": run_python, "sh": run_shell, "yaml": check_yaml, "toml": check_toml}
        try:
            if block.language == "text":
                assert printed == block.code, printed
            elif block.language not in ("bash", "bibtex", "console"):
                check[block.language](block, monkeypatch)
        except Exception as error:
            if isinstance(error, ModuleNotFoundError) and error.name in LIBRARIES:
                missing.append(f"{block.where} needs {error.name}")
                continue
            out, err = capfd.readouterr()
            raise AssertionError(f"{block.where}: {error!r}\n{block.code}\n{out}{err}") from error
        printed = capfd.readouterr().out
    if missing:
        pytest.skip(f"all blocks ran but these: {', '.join(missing)}")


def run_python(block: Block, _: pytest.MonkeyPatch) -> None:
    code = block.code
    if not hasattr(pettingzoo, "make"):  # before 1.27, as the block says
        code = re.sub(r"^pettingzoo\.make\(.*$", "", code, flags=re.MULTILINE)
    program = compile(code, block.where, "exec")
    if not any(what == "parsed only" for what, *_ in block.marks):
        exec(program, {"__name__": "__main__"})


def check_yaml(block: Block, _: pytest.MonkeyPatch) -> None:
    """A configuration of an experiment, or a part of a training's."""
    found = yaml.safe_load(block.code)
    build(ExperimentConfig if "routers" in found else Config, found)


def check_toml(block: Block, _: pytest.MonkeyPatch) -> None:
    (points,) = tomllib.loads(block.code)["project"]["entry-points"].items()
    assert points[0].removeprefix("marouting.") in registry.KINDS
    assert all(re.fullmatch(r"[\w.]+:\w+", target) for target in points[1].values())


def run_shell(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    marked = [0] * len(block.marks)
    for line in block.code.replace("\\\n", " ").splitlines():
        for command in line.split("&&"):
            words = shlex.split(command, comments=True)
            if not words:
                continue
            parse, more = False, list[str]()
            for number, (what, phrase, text) in enumerate(block.marks):
                if phrase in command:
                    marked[number] += 1
                    parse |= what == "parsed only"
                    more += shlex.split(text) if what == "run shorter" else []
            words = [found for word in words for found in expanded(word)]
            run_command([*words, *more], parse, monkeypatch)
    assert all(marked), f"a mark belongs to no command: {block.marks}"


def expanded(word: str) -> list[str]:
    if "*" not in word or "=" in word:
        return [word]
    return sorted(str(path) for path in Path().glob(word)) or [word]


def run_command(words: list[str], parse: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    program, *arguments = words
    if program == "cd":
        monkeypatch.chdir(arguments[0])
    elif program == "marouting":
        run_marouting(arguments, parse, monkeypatch)
    else:
        assert parse, f"{shlex.join(words)}: mark it as parsed only, or run it"
        if program == "python":
            check_python_command(arguments)
        else:
            assert program in OTHERS, program


def run_marouting(arguments: list[str], parse: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        if parse:
            stop_before_work(patch)
        path = list(sys.path)
        try:
            done = status(arguments)
        except WorkBegins:
            return
        finally:
            sys.path[:] = path
    assert done == 0, shlex.join(arguments)
    assert not parse, f"{shlex.join(arguments)}: it has run to its end; no mark is needed"


def check_python_command(arguments: list[str]) -> None:
    """``python FILE`` or ``python -m MODULE``: there is such a thing, with such options."""
    if arguments[0] != "-m":
        assert (ROOT / arguments[0]).exists(), arguments[0]
        return
    _, module, *rest = arguments
    assert importlib.util.find_spec(module), module
    if module == "pytest":
        files = [word for word in rest if word.endswith(".py")]
        assert all((ROOT / file).exists() for file in files), files
    elif module.startswith("policies."):
        folder = (ROOT / module.replace(".", "/")).is_dir()
        command = importlib.import_module(f"{module}.__main__" if folder else module).main
        assert isinstance(command, click.Command)
        with command.make_context(module, rest):
            pass


def test_blocks_are_found_and_marks_are_read() -> None:
    text = '<!-- parsed only (b): long -->\n```sh\na\nb\n```\n\n```python\n"x"\n```\n'
    found = BLOCK.findall(text)
    assert [(language, code) for _, _, language, code in found] == [
        ("sh", "a\nb\n"),
        ("python", '"x"\n'),
    ]
    assert MARK.findall(found[0][0]) == [("parsed only", "b", "long")]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("marouting train configs/paper/default.yaml train.episode=5", "did you mean episodes?"),
        ("marouting route problem.gr --router dqn train.episode=5", "did you mean episodes?"),
        ("marouting experiment configs/yardstick.yaml seed=0", "seed"),
        ("marouting benchmark --scenario toy-4x4-v1 --router astar", "toy-4x4-v1"),
        ("marouting plot --ouch problem.gr", "--ouch"),
    ],
)
def test_what_is_only_parsed_is_parsed_to_the_end(
    command: str,
    said: str,
    folder: Path,
    inputs: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    take_what_is_named(inputs, folder, command)
    with pytest.raises(AssertionError):
        run_command(shlex.split(command), parse=True, monkeypatch=monkeypatch)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"https?:", link):
            path, _, anchor = link.partition("#")
            target = (page.parent / path) if path else page
            assert target.exists(), link
            assert not anchor or anchor in anchors(target), link
    for path in re.findall(r"`((?:marouting|policies|tests|configs|docs)/[\w/.]*)`", text):
        assert (ROOT / path).exists(), path


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize(
    ("mark", "command"),
    [
        ("install", "python -m pip install -e '.[learn]' && marouting quickstart"),
        ("test", "python -m pip install -e '.[test]' && python -m pytest"),
    ],
)
def test_the_commands_stand_where_ci_reads_them(mark: str, command: str) -> None:
    readme = PAGES[0].read_text(encoding="utf-8")
    assert re.search(rf"<!-- ci: {mark} -->\n```sh\n{re.escape(command)}\n```", readme)


@pytest.mark.parametrize("name", ["astar", "optimal", "greedy", "local", "random"])
def test_the_page_of_routers_has_every_option(name: str) -> None:
    text = (ROOT / "docs" / "routers.md").read_text(encoding="utf-8")
    table = text.partition("| router | options and their defaults |")[2].partition("## ")[0]
    (row,) = re.findall(rf"^\| `{name}` \| (.+) \|$", table, re.MULTILINE)
    for option, parameter in inspect.signature(registry.lookup("router", name)).parameters.items():
        default = parameter.default
        told = default if isinstance(default, str) else json.dumps(default).removesuffix(".0")
        # Options of the game, and those without a default, are named alone.
        assert re.search(rf"`{option}(={re.escape(told)})?`", row), option
