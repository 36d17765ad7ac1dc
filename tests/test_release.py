"""What is released: wheel and sdist, as they are installed, and what their metadata say."""

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import wheels
import yaml

import marouting

ROOT = Path(__file__).resolve().parents[1]


def test_version_changelog_and_citation_are_in_step() -> None:
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    released = [heading for heading in headings if heading != "Unreleased"]
    assert headings[0] == "Unreleased" or headings[0] == marouting.__version__
    assert released[0] == marouting.__version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert str(citation["version"]) == marouting.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert citation["license"] == project["project"]["license"]


def test_the_container_installs_what_there_is() -> None:
    text = (ROOT / ".container" / "Containerfile").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (extras,) = re.findall(r'"/source\[([\w,]+)\]"', text)
    assert set(extras.split(",")) <= project["optional-dependencies"].keys()
    (python,) = re.findall(r"^FROM python:(\d+\.\d+)-slim$", text, flags=re.MULTILINE)
    assert project["requires-python"] == f">={python}"
    assert 'ENTRYPOINT ["marouting"]' in text
    assert "marouting" in project["scripts"]


# --- another package called `policies` ------------------------------------------------------------


def command(path: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Runs the command as the installed script does, with this path for Python."""
    code = "from marouting.__main__ import main; main()"
    given = {**os.environ, "PYTHONPATH": path}
    program = [sys.executable, "-P", "-c", code, *arguments]
    return subprocess.run(program, env=given, capture_output=True, text=True, check=False)


def test_another_package_of_the_name_is_told_apart(tmp_path: Path) -> None:
    other = tmp_path / "policies"
    other.mkdir()
    (other / "__init__.py").write_text("DISTRIBUTION = None\n")
    first = os.pathsep.join((str(tmp_path), str(ROOT)))
    done = command(first, "--version")
    assert done.returncode == 2
    assert done.stderr.startswith(f"marouting: {other}: expected the package `policies` of marou")
    assert len(done.stderr.splitlines()) == 1
    assert command(os.pathsep.join((str(ROOT), str(tmp_path))), "--version").returncode == 0
    (other / "__init__.py").unlink()  # a mere folder of this name does no harm
    assert command(first, "--version").returncode == 0


# --- installed ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An sdist of this checkout, and wheels of the checkout and of the sdist."""
    folder = tmp_path_factory.mktemp("built")
    copy = wheels.source(folder)
    code = "import sys; from setuptools import build_meta as b; print(b.build_sdist(sys.argv[1]))"
    program = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(program, cwd=copy, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    sdist = folder / done.stdout.splitlines()[-1]
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    found = {"sdist": sdist}
    for name, source in (("wheel", copy), ("wheel of the sdist", unpacked)):
        (folder / name).mkdir()
        found[name] = wheels.build(source, folder / name)
    return found


def contents(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


@pytest.mark.slow
def test_both_releases_hold_the_same(built: dict[str, Path]) -> None:
    files = contents(built["wheel"])
    assert files == contents(built["wheel of the sdist"])
    for package in ("marouting", "policies"):
        own = {
            str(path.relative_to(ROOT))
            for path in (ROOT / package).rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        }
        assert own <= files
    configs = {f"marouting/{path.relative_to(ROOT)}" for path in (ROOT / "configs").rglob("*.yaml")}
    assert configs <= files


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wheel", "wheel of the sdist"])
def test_what_is_installed_runs_outside_the_checkout(
    name: str, built: dict[str, Path], tmp_path: Path
) -> None:
    """In a fresh environment, whose dependencies are those of this one."""
    venv, work = tmp_path / "venv", tmp_path / "work"
    work.mkdir()
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    python = venv / "bin" / "python"
    (site,) = (venv / "lib").glob("python*/site-packages")
    # What lies on PYTHONPATH, pip would take for installed.
    given = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    install = [python, "-m", "pip", "--quiet", "install", "--no-deps", "--no-index", built[name]]
    subprocess.run(install, env=given, check=True)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    def run(*arguments: str) -> str:
        program = [str(venv / "bin" / "marouting"), *arguments]
        done = subprocess.run(
            program, cwd=work, env=given, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    where = [str(python), "-c", "import marouting, policies; print(policies.__file__)"]
    found = subprocess.run(where, cwd=work, env=given, capture_output=True, text=True, check=True)
    assert Path(found.stdout.strip()).is_relative_to(site)
    assert marouting.__version__ in run("--version")
    assert "default.yaml:" in run("config", "configs/multi.yaml")
    if name != "wheel":
        return  # it holds the same
    run("generate", "--count", "2", "--nets", "10", "--out", "problems")
    run("route", "problems/problem_000.gr", "--router", "generalist", "--out", "a.solution")
    run("evaluate", "problems/problem_000.gr", "a.solution", "--json")
    run("view", "problems/problem_000.gr", "a.solution", "--out", "page.html")
    run("quickstart")
    assert (work / "quickstart" / "solutions.png").exists()
