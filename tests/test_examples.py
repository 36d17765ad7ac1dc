"""The scripts in docs/examples do what they say: in a checkout, and with an installed wheel."""

import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import wheels
from conftest import some_slow

import marouting
from marouting import registry
from marouting.scenarios.references import path_of
from marouting.yaml_files import config_file, read_yaml

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
NAMES = sorted(file.stem for file in EXAMPLES.glob("*.py"))
LONG = ("own_algorithm", "own_network")


def python(*arguments: str | Path, cwd: Path, path: Path) -> str:
    """What Python prints, with ``path`` as the one place it finds the packages in."""
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(path)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(pattern: str, text: str) -> list[float]:
    """The numbers that stand at the groups of a pattern."""
    found = re.search(pattern, text)
    assert found, f"{pattern} is not in:\n{text}"
    return [float(number) for number in found.groups()]


def router_rows(text: str) -> dict[str, list[float]]:
    """The first table's numbers by the name that begins a line."""
    rows: dict[str, list[float]] = {}
    for line in text.splitlines():
        name, *figures = re.split(r"\s+", line.strip())
        if figures and not name.endswith(":") and re.fullmatch(r"\d+", figures[0]):
            rows.setdefault(name, [float(n) for n in figures if re.fullmatch(r"[\d.]+", n)])
    return rows


def check_aec_loop(out: str) -> None:
    lines = dict(line.split(":") for line in out.splitlines())
    joined, wirelength, paid = (
        [numbers(pattern, lines[policy])[0] for policy in ("at_random", "towards_the_target")]
        for pattern in (r"joined (\d+) of 20", r"wirelength (\d+)", r"rewards (-?\d+)")
    )
    assert joined[0] < 10 < joined[1]
    assert wirelength[0] > wirelength[1]
    assert paid[0] < 0 < paid[1]


def check_rip_up(out: str) -> None:
    rows = [line.rsplit(maxsplit=5) for line in out.splitlines()[1:]]
    left_open = [int(row[1]) for row in rows]
    joined = [int(row[2]) for row in rows]
    assert len(rows) == 7
    assert min(left_open[4:]) < 0.3 * min(left_open[:4])
    assert min(joined[4:]) > max(joined[:4])


def check_own_observation(out: str) -> None:
    assert "shape: (13,)" in out
    crowd = re.search(r"two Gcells: \[(.*)\]", out)
    assert crowd
    found = [int(number) for number in crowd[1].split(",")]
    assert len(found) == 30
    assert 0 < max(found) < 30
    assert numbers(r"stands: (\d+)", out)[0] <= max(found)


def check_own_reward(out: str) -> None:
    joined, wirelength = numbers(r"joined (\d+) of 10, wirelength (\d+)", out)
    assert numbers(r"all that happened: (-?\d+)", out) == [10 * joined - wirelength]
    assert joined > 0


def check_own_rule(out: str) -> None:
    used, crossed = numbers(r"wirelength: (\d+) = new edges crossed: (\d+)", out)
    assert used == crossed > 0
    assert 0 <= numbers(r"fullest via: (\d+)", out)[0] < 10


def check_own_policy(out: str) -> None:
    assert numbers(r"joined=(\d+), tasks=(\d+)", out) == [8, 8]


def check_own_router(out: str) -> None:
    rows = router_rows(out)
    assert rows.keys() == {"astar", "own"}
    overflow, without, left_open, wirelength, *_ = rows["own"]
    assert left_open == 0
    assert without + overflow > 0
    assert wirelength == pytest.approx(rows["astar"][3], rel=0.1)


def check_own_network(out: str) -> None:
    assert "torch" in out.splitlines()[0]
    assert "LayerNorm" in out
    # Between wirelength and tasks there may be the pruned wirelength.
    (astar,), (dqn,) = (
        numbers(rf" {name} +0 +(\d+)(?: +\d+)? +6/6", out) for name in ("astar", "dqn")
    )
    assert dqn <= 1.2 * astar
    assert numbers(r" dqn_policy +0 +\d+(?: +\d+)? +(\d+)/6", out)[0] >= 5


def check_own_algorithm(out: str) -> None:
    assert "learner: expected SARSA" in out
    first, last = numbers(r"joined: (\S+) in the first 100 episodes, (\S+) in the last", out)
    assert first < 0.5
    assert last > 0.8
    assert len(re.findall(r" sarsa +0 +\d+ +8/8", out)) == 2


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("name", some_slow(NAMES, LONG))
def test_an_example_does_what_it_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    registry.registered()  # the package's own components are registered when first asked for
    known = {kind: {**own} for kind, own in registry._registered.items()}
    monkeypatch.setattr(registry, "_registered", known)
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    sys.modules.pop(name, None)
    globals()[f"check_{name}"](capsys.readouterr().out)


def test_every_example_is_listed_and_short() -> None:
    listed = re.findall(r"\]\((\w+)\.py\)", (EXAMPLES / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == NAMES
    assert len(NAMES) == 9
    for name in NAMES:
        lines = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 150, name


def test_configurations_are_found_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    named = "configs/paper/default.yaml"
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    assert named in text
    for config in set(re.findall(r"configs/[\w/]+\.yaml", text)):
        assert read_yaml(config) == read_yaml(ROOT / config)
    assert config_file("configs/none.yaml") == Path("configs/none.yaml")
    with pytest.raises(marouting.InputError, match=r"^configs/none\.yaml: cannot be read"):
        read_yaml("configs/none.yaml")
    # A file that is there comes first, and no other path is looked for elsewhere.
    (tmp_path / "configs" / "paper").mkdir(parents=True)
    (tmp_path / named).write_text("seed: 7\n", encoding="utf-8")
    assert read_yaml(named) == {"seed": 7}
    with pytest.raises(marouting.InputError, match="cannot be read"):
        read_yaml("paper/default.yaml")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which a wheel of this checkout is installed, without its dependencies."""
    folder = tmp_path_factory.mktemp("wheel")
    target = folder / "installed"
    wheels.install(wheels.build(wheels.source(folder), folder), target)
    return target


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("own_")])
def test_own_components_with_an_installed_wheel(name: str, installed: Path, tmp_path: Path) -> None:
    where = python(
        "-c", "import marouting; print(marouting.__file__)", cwd=tmp_path, path=installed
    )
    assert Path(where.strip()).is_relative_to(installed)
    shutil.copy(EXAMPLES / f"{name}.py", tmp_path)
    globals()[f"check_{name}"](python(f"{name}.py", cwd=tmp_path, path=installed))


@pytest.mark.slow
def test_a_wheel_brings_every_configuration(installed: Path, tmp_path: Path) -> None:
    brought = {p.relative_to(installed / "marouting") for p in installed.rglob("*.yaml")}
    assert brought == {p.relative_to(ROOT) for p in (ROOT / "configs").rglob("*.yaml")}
    references = {path_of(name).relative_to(ROOT) for name in marouting.scenarios.names()}
    assert {p.relative_to(installed) for p in installed.rglob("data/*.json")} == references
    out = python(
        installed / "bin" / "marouting", "train", "configs/paper/default.yaml", "out=run",
        "env.problem.count=1", "env.problem.nets=5", "learner.burn_in_size=100",
        "train.episodes=2", "train.figures=false", "train.tensorboard=false",
        cwd=tmp_path, path=installed,
    )  # fmt: skip
    assert "dqn_policy" in out
    assert (tmp_path / "run" / "result.json").exists()


def test_the_wheel_lists_every_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = project["tool"]["setuptools"]["packages"]
    folders = {
        ".".join(file.relative_to(ROOT).parent.parts)
        for package in ("marouting", "policies")
        for file in (ROOT / package).rglob("*.py")
    }
    configs = {
        ".".join(("marouting", *file.relative_to(ROOT).parent.parts))
        for file in (ROOT / "configs").rglob("*.yaml")
    }
    assert sorted(listed) == sorted(folders | configs)
