"""Compiled code: what is on disk is never staler than the sources, and numba's private parts."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
import wheels

import marouting
from marouting import compiling, kernels

_PLAY = """
import marouting, numpy as np
from marouting.vector import BatchEnv
assert marouting.__file__.startswith({copy!r}), marouting.__file__
env = BatchEnv(marouting.generate(1, grid=(4, 4, 2), nets=3, reduced_edges=0))
env.reset()
_, reward, _, _, info = env.step(np.full((1, env.num_agents), 4))  # UP
print(int(info["steps"][0]), int(info["wirelength"][0]))
"""


def play(copy: Path, cache: Path | None) -> list[int]:
    """Steps and wirelength after one step of three nets, by the package in a folder."""
    variables = {**os.environ, "PYTHONPATH": str(copy)}
    variables.pop("NUMBA_CACHE_DIR", None)  # None: beside the sources
    if cache is not None:
        variables["NUMBA_CACHE_DIR"] = str(cache)
    code = _PLAY.format(copy=str(copy))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=copy,
        env=variables,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return list(map(int, done.stdout.split()))


@pytest.mark.slow
def test_an_edited_rule_is_played_by_code_that_was_compiled_before(tmp_path: Path) -> None:
    """The batch inlines the rule into a function of another file, whose own source is the same."""
    copy, cache = tmp_path / "copy", tmp_path / "cache"
    package = Path(marouting.__file__).parent
    shutil.copytree(package, copy / "marouting", ignore=shutil.ignore_patterns("__pycache__"))
    assert play(copy, cache) == [3, 3]
    kept = sorted(cache.rglob("*.nbc"))
    assert kept
    assert play(copy, cache) == [3, 3]
    assert sorted(cache.rglob("*.nbc")) == kept  # nothing was compiled again

    rules = copy / "marouting" / "batch" / "rules.py"
    source = rules.read_text(encoding="utf-8")
    assert source.count("game.wirelength += new\n") == 1
    rules.write_text(source.replace("game.wirelength += new\n", "game.wirelength += 5 * new\n"))
    assert play(copy, cache) == [3, 15]


@pytest.mark.slow
def test_an_upgrade_is_played_by_code_that_was_compiled_before_it(tmp_path: Path) -> None:
    """Two wheels that differ in a rule, the second installed over the first."""
    site, source = tmp_path / "site", wheels.source(tmp_path)
    first = wheels.build(source, tmp_path / "first")
    rules = source / "marouting" / "batch" / "rules.py"
    text = rules.read_text(encoding="utf-8")
    rules.write_text(text.replace("game.wirelength += new\n", "game.wirelength += 5 * new\n"))
    second = wheels.build(source, tmp_path / "second")
    for cache in (tmp_path / "cache", None):  # pip leaves __pycache__ behind as well
        for wheel, wirelength in ((first, 3), (second, 15), (first, 3)):
            wheels.install(wheel, site)
            assert play(site, cache) == [3, wirelength]
            assert play(site, cache) == [3, wirelength]


SOURCES = {
    "calls": "from pack.other import Y\nfrom pack.rules import add\n"
    "from marouting.kernels import compiled\nX = Y\n\n\n"
    "@compiled\ndef call():\n    return add(X, 2)\n",
    "rules": "from pack.deeper import Point, least\n"
    "from marouting.kernels import compiled\n\n\n"
    "@compiled\ndef add(a, b: Point):\n    return least(a + b)\n",
    "deeper": "from typing import NamedTuple\nfrom marouting.kernels import compiled\n"
    "LEAST = 1\nEVEN = 1\nODD = 7\n\n\nclass Point(NamedTuple):\n    x: int\n\n\n"
    "@compiled\ndef least(a):\n    return later(a)\n\n\n"
    "@compiled\ndef later(a):\n    return max(a, LEAST, EVEN, ODD, len(repr(THING)))\n\n\n"
    "class Thing:\n    __module__ = None\n\n\nTHING = Thing()\n",
    "other": "Y = 4  # 1\n",
    "__init__": "",
}


def python(code: str, path: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs code in a process that finds modules in a folder, and this checkout."""
    checkout = str(Path(marouting.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(path), checkout)), **variables},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done


def imported(folder: Path, name: str, sources: dict[str, str]) -> Any:
    """A module by its sources, imported anew as in another process."""
    package = name.partition(".")[0]
    for known in [known for known in sys.modules if known.partition(".")[0] == package]:
        del sys.modules[known]
    for file, text in sources.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setattr(sys, "dont_write_bytecode", True)
        return importlib.import_module(name)


def test_a_stamp_depends_on_what_is_compiled_into_a_function(tmp_path: Path) -> None:
    def stamp(number: int, **sources: str) -> str:
        files = {f"pack/{name}.py": text for name, text in (SOURCES | sources).items()}
        return compiling.stamp(imported(tmp_path / str(number), "pack.calls", files).call.py_func)

    before = stamp(0)
    code = "from marouting import compiling; from pack import calls; "
    code += "print(compiling.stamp(calls.call.py_func))"
    for seed in "12":
        assert python(code, tmp_path / "0", PYTHONHASHSEED=seed).stdout == f"{before}\n"
    for number, (file, old, new, same) in enumerate(
        [
            ("calls", "X, 2)", "X, 3)", False),  # the function itself
            ("rules", "a + b", "a - b", False),  # what it calls
            ("deeper", "LEAST = 1", "LEAST = 2", False),  # a constant of what that calls
            ("deeper", "EVEN = 1", "EVEN = 7", False),  # another; something is equal to both
            ("deeper", "x: int", "y: int", False),  # a field of an argument
            ("other", "1", "2", True),  # imported, and not compiled into it
        ]
    ):
        assert SOURCES[file].count(old) == 1
        changed = {file: SOURCES[file].replace(old, new)}
        assert (stamp(number + 1, **changed) == before) == same, (file, old)


MINE = (
    "from marouting.kernels import compiled\nfrom mine.rules import part\n\n\n"
    "@compiled\ndef double(x):\n    return part(x)\n"
)
RULES = "from marouting.kernels import compiled\n\n\n@compiled\ndef part(x):\n    return {source}\n"


def mine_in(source: str) -> dict[str, str]:
    """A package with a kernel, and the rule in another file that is compiled into it."""
    files = {"__init__": "", "calls": MINE, "rules": RULES.format(source=source)}
    return {f"mine/{name}.py": text for name, text in files.items()}


@pytest.fixture
def run_mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, int]]:
    """Runs the kernel as in another process: its result, and whether the code was on disk."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    compiling.stamp.cache_clear()

    def run_mine(source: str = "2 * x", argument: int = 21) -> tuple[int, int]:
        double = imported(tmp_path, "mine.calls", mine_in(source)).double
        return double(argument), sum(double.stats.cache_hits.values())

    return run_mine


@pytest.fixture
def kept(tmp_path: Path, run_mine: Callable[..., tuple[int, int]]) -> dict[Path, bytes]:
    """The files with the kernel's code on disk."""
    assert run_mine() == (42, 0)
    assert run_mine() == (42, 1)
    files = {file: file.read_bytes() for file in (tmp_path / "cache").rglob("*.nb?")}
    assert {file.suffix for file in files} == {".nbi", ".nbc"}
    return files


def test_an_edited_rule_is_compiled_into_what_calls_it(
    kept: dict[Path, bytes], run_mine: Callable[..., tuple[int, int]]
) -> None:
    """The file of the function that is called from Python is the same."""
    assert run_mine("3 * x") == (63, 0)
    assert run_mine("3 * x") == (63, 1)
    # As after a process that was killed between writing the index and writing the code: older code
    # under the name of newer code.
    for file, content in kept.items():
        if file.suffix == ".nbc":
            file.write_bytes(content)
    assert run_mine("3 * x") == (63, 0)


def test_a_damaged_file_of_compiled_code_is_made_again(
    kept: dict[Path, bytes], run_mine: Callable[..., tuple[int, int]]
) -> None:
    def flipped(content: bytes) -> bytes:
        half = len(content) // 2
        return content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]

    for suffix in (".nbi", ".nbc"):
        for damage in (lambda _: b"", lambda c: c[: len(c) // 2], lambda _: b"no pickle", flipped):
            for file, content in kept.items():
                file.write_bytes(damage(content) if file.suffix == suffix else content)
            assert run_mine() in ((42, 0), (42, 1))
            assert run_mine() == (42, 1)


def test_compiling_is_announced_before_it_begins(
    run_mine: Callable[..., tuple[int, int]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Once in a process, and not where the code is on disk."""
    monkeypatch.setattr("test_kernels.MINE", f'COMPILES = "what is mine", 7\n{MINE}')
    for source, argument, said in (
        ("2 * x", 21, 1),
        ("2 * x", 21, 0),  # on disk
        ("x + x", 21, 1),
        ("x + x", 2.0, 0),  # compiled, and announced before
    ):
        if argument == 21:
            monkeypatch.setattr(compiling, "_said", set())  # as in another process
        assert run_mine(source, argument)[0] == 2 * argument
        line = "compiling what is mine, each variant once per version: about 7 s\n"
        assert capsys.readouterr().err == line * said


@pytest.mark.slow
def test_routing_announces_what_it_compiles(tmp_path: Path) -> None:
    problem, cache = tmp_path / "problem.gr", tmp_path / "cache"
    marouting.generate(1, (4, 4, 2), nets=5)[0].write(problem)
    for lines in (1, 0):
        done = subprocess.run(
            [sys.executable, "-m", "marouting", "route", problem, "--router", "pathfinder",
             "--json"],
            env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
            capture_output=True,
            text=True,
            timeout=600,
        )  # fmt: skip
        assert json.loads(done.stdout)["connected"]
        assert done.stderr.count("compiling the router, each variant once per version: ") == lines
        assert done.stderr.count("compiling") == lines


_FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))"
_NOWHERE = "import numba.core.caching as c; c.CacheImpl._locator_classes = []"


@pytest.mark.parametrize("trouble", [_FULL, _NOWHERE], ids=["full disk", "nowhere to write"])
def test_where_nothing_can_be_kept_one_line_says_so(tmp_path: Path, trouble: str) -> None:
    imported(tmp_path, "mine", mine_in("2 * x"))
    code = f"{trouble}\nfrom mine.calls import double\nprint(double(21), double.stats.cache_hits)"
    for _ in range(2):
        # Python itself would keep damaged files of modules on a full disk.
        kept = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        done = python(code, tmp_path, **kept)
        assert done.stdout == "42 Counter()\n"
        (line,) = done.stderr.splitlines()
        assert "compiled code is not kept on disk: " in line


@kernels.compiled
def _sum(numbers: Any) -> Any:
    total = numbers[0]
    for i in range(1, len(numbers)):
        total += numbers[i]
    return total


def test_bound_code_is_found_again_by_the_types_of_its_arguments() -> None:
    whole, parts = np.arange(4, dtype=np.int32), np.arange(4) / 2
    found = [kernels.specialised(_sum, numbers) for numbers in (whole, parts, whole + 1, parts[:2])]
    assert found[0] is found[2]
    assert found[1] is found[3]
    assert found[0](whole) == 6
    assert found[1](parts) == 3
    assert found[0](whole[:2]) == 1
