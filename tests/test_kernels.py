"""Compiled code: what is on disk is never staler than the sources, and numba's private parts."""

import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.cpu import CPUTargetOptions

import marouting
import policies
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


def play(copy: Path, cache: Path) -> list[int]:
    """Steps and wirelength after one step of three nets, by the package in a folder."""
    variables = {**os.environ, "PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(cache)}
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

    rules = copy / "marouting" / "game" / "rules.py"
    source = rules.read_text(encoding="utf-8")
    assert source.count("game.wirelength += new\n") == 1
    rules.write_text(source.replace("game.wirelength += new\n", "game.wirelength += 5 * new\n"))
    assert play(copy, cache) == [3, 15]


def test_a_stamp_depends_on_all_sources_of_the_package() -> None:
    own = kernels.stamp("marouting.game.rules")
    assert own == kernels.stamp("marouting.kernels")
    assert own != kernels.stamp(f"{policies.__name__}.learned.streams")
    assert own != kernels.stamp(__name__)


def double(x: Any) -> Any:
    """What the tests below compile."""
    return 2 * x


def test_private_options_are_left_out_where_numba_lacks_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = {"nogil": True, "_nrt": False, "forceinline": True}
    assert kernels._known(options) == options

    parse = CPUTargetOptions.parse_as_flags

    def older(flags: Any, given: Any) -> Any:
        if "_nrt" in given:
            raise KeyError("Unrecognized options")
        return parse(flags, given)

    monkeypatch.setattr(CPUTargetOptions, "parse_as_flags", older)
    assert kernels._known(options) == {"nogil": True}
    assert kernels._decorator(**options)(double)(21) == 42


def test_without_a_cache_functions_are_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def changed(*_: Any, **__: Any) -> None:
        raise AttributeError("no such attribute")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.__init__", changed)
    kernels._warn_once.cache_clear()
    with pytest.warns(RuntimeWarning, match="compiled code is not kept on disk"):
        compiled = kernels._decorator()(double)
    assert compiled(21) == 42
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kernels._decorator()(double)(4) == 8  # said once


def test_bound_functions_without_machine_code() -> None:
    class Overload:
        """A compiled function of a numba that does not give its machine code away."""

    class Kernel:
        def __init__(self) -> None:
            self.overloads: Any = {}

        def compile(self, signature: Any) -> None:
            self.overloads = {signature: Overload()}

        def __call__(self, x: int) -> int:
            return x + 1

    assert kernels.bound(Kernel(), 1)(2) == 3
    compiled = kernels.compiled(double)
    assert kernels.bound(compiled, np.int64(1))(3) == 6
