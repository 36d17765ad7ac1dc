"""Compiled code: what is on disk is never staler than the sources, and numba's private parts."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import wheels

import marouting
from marouting import kernels

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


@pytest.mark.parametrize(
    ("file", "old", "new", "same"),
    [
        ("calls", "X, 2)", "X, 3)", False),  # the function itself
        ("rules", "a + b", "a - b", False),  # what it calls
        ("deeper", "LEAST = 1", "LEAST = 2", False),  # a constant of what that calls
        ("deeper", "EVEN = 1", "EVEN = 7", False),  # another, and there is something equal to both
        ("deeper", "x: int", "y: int", False),  # a field of an argument
        ("other", "1", "2", True),  # imported, and not compiled into it
    ],
)
def test_a_stamp_depends_on_what_is_compiled_into_a_function(
    tmp_path: Path, file: str, old: str, new: str, same: bool
) -> None:
    sources = {
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

    def stamp(seed: int = 0) -> str:
        (tmp_path / "pack").mkdir(exist_ok=True)
        for name, text in sources.items():
            (tmp_path / "pack" / f"{name}.py").write_text(text)
        code = "from marouting import compiling; from pack import calls; "
        done = subprocess.run(
            [sys.executable, "-c", f"{code}print(compiling.stamp(calls.call.py_func))"],
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(
                    (str(tmp_path), str(Path(marouting.__file__).parents[1]))
                ),
                "PYTHONDONTWRITEBYTECODE": "1",
                "PYTHONHASHSEED": str(seed),
            },
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    before = stamp()
    assert [stamp(seed) for seed in (1, 2, 3)] == [before] * 3
    assert sources[file].count(old) == 1
    sources[file] = sources[file].replace(old, new)
    assert (stamp() == before) == same


def run_mine(
    folder: Path, cache: Path, before: str = "", source: str = "2 * x"
) -> tuple[list[int], str]:
    """The result of a compiled function and whether it was on disk, and standard error."""
    (folder / "mine.py").write_text(
        "from marouting.kernels import compiled\n\n\n@compiled\ndef part(x):\n"
        f"    return {source}\n\n\n@compiled\ndef double(x):\n    return part(x)\n"
    )
    path = os.pathsep.join((str(folder), str(Path(marouting.__file__).parents[1])))
    done = subprocess.run(
        [sys.executable, "-c", f"{before}\nimport mine\nprint(mine.double(21))\n"
         "print(sum(mine.double.stats.cache_hits.values()))"],
        env={**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(map(int, done.stdout.split())), done.stderr


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[Path, bytes]]:
    """A folder with a module, a cache that has its code, and the files there."""
    folder = tmp_path_factory.mktemp("mine")
    cache = folder / "cache"
    assert run_mine(folder, cache)[0] == [42, 0]
    assert run_mine(folder, cache)[0] == [42, 1]
    files = {file: file.read_bytes() for file in sorted(cache.rglob("mine*.nb?"))}
    assert {file.suffix for file in files} == {".nbi", ".nbc"}
    return folder, cache, files


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["empty", "truncated", "garbage", "flipped"])
def test_a_damaged_file_of_compiled_code_is_made_again(
    mine: tuple[Path, Path, dict[Path, bytes]], suffix: str, damage: str
) -> None:
    folder, cache, files = mine
    for file, content in files.items():
        file.write_bytes(content)
        if file.suffix == suffix:
            half = len(content) // 2
            flipped = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
            file.write_bytes(
                {"empty": b"", "truncated": content[:half], "garbage": b"no pickle"}.get(
                    damage, flipped
                )
            )
    assert run_mine(folder, cache) in (([42, 0], ""), ([42, 1], ""))
    assert run_mine(folder, cache) == ([42, 1], "")


def test_older_code_under_the_name_of_newer_code_is_not_run(
    mine: tuple[Path, Path, dict[Path, bytes]],
) -> None:
    """As after a process that was killed between writing the index and writing the code."""
    folder, cache, files = mine
    assert run_mine(folder, cache, source="3 * x")[0] == [63, 0]
    for file, content in files.items():
        if file.suffix == ".nbc":
            file.write_bytes(content)
    assert run_mine(folder, cache, source="3 * x")[0] == [63, 0]


def test_compiling_is_announced_before_it_begins(tmp_path: Path) -> None:
    """Once in a process, and not where the code is on disk."""
    before = 'import mine\nmine.COMPILES = "what is mine", 7\n'
    line = "compiling what is mine, once per version: about 7 s\n"
    assert run_mine(tmp_path, tmp_path / "cache", before) == ([42, 0], line)
    assert run_mine(tmp_path, tmp_path / "cache", before) == ([42, 1], "")
    again = before + "print(mine.part(21), int(mine.double(2.0)))"
    assert run_mine(tmp_path, tmp_path / "cache", again, "x + x") == ([42, 4, 42, 0], line)


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
        assert done.stderr.count("compiling the router, once per version: about ") == lines
        assert done.stderr.count("compiling") == lines


_FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))"
_NOWHERE = "import numba.core.caching as c; c.CacheImpl._locator_classes = []"


@pytest.mark.parametrize("trouble", ["full disk", "nowhere to write"])
def test_where_nothing_can_be_kept_one_line_says_so(tmp_path: Path, trouble: str) -> None:
    cache = tmp_path / "cache"
    before = {"full disk": _FULL, "nowhere to write": _NOWHERE}[trouble]
    for _ in range(2):
        results, errors = run_mine(tmp_path, cache, before)
        assert results == [42, 0]
        (line,) = errors.splitlines()
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
