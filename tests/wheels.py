"""Wheels of this checkout, for tests of what is installed."""

import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_NOT_BUILT = {".git", "runs", "docs", "tests", "build", "dist"}


def source(folder: Path) -> Path:
    """A copy of the checkout in a folder: setuptools leaves files where it builds."""
    copy = folder / "source"
    shutil.copytree(
        ROOT, copy, ignore=lambda where, _: _NOT_BUILT if Path(where) == ROOT else set()
    )
    return copy


def build(source: Path, folder: Path) -> Path:
    """Builds a wheel of a copy of the checkout; returns its path."""
    # Where setuptools is installed and new enough nothing has to be fetched.
    version = next(iter(metadata.distributions(name="setuptools")), None)
    offline = version is not None and int(version.version.split(".")[0]) >= 77
    shutil.rmtree(source / "build", ignore_errors=True)
    _pip("wheel", "--no-deps", *(["--no-build-isolation"] if offline else []), "-w", folder, source)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(wheel: Path, site: Path) -> None:
    """Installs a wheel, without its dependencies, over what a folder holds."""
    _pip("install", "--no-deps", "--no-index", "--upgrade", "--target", site, wheel)


def _pip(*arguments: str | Path) -> None:
    pip = sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"
    done = subprocess.run(
        [*pip, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
