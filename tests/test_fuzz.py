"""Inputs with accidents in them: refused in a line, or read, to results that can be."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz import KINDS


def read(folder: Path, *arguments: str) -> str:
    """Reads inputs in a process of its own, since compiled code may crash; what it prints."""
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("fuzz.py")), "--folder", folder, *arguments],
        capture_output=True,
        text=True,
        timeout=3000,
        check=False,
    )
    at = (folder / "seed.txt").read_text()
    assert done.returncode == 0, f"{done.stdout}\nlast: {at}\n{done.stderr[-10000:]}"
    print(done.stdout)
    return done.stdout


def test_a_few_of_every_kind_are_sane_or_refused(tmp_path: Path) -> None:
    lines = read(tmp_path).splitlines()[1:]
    assert [line.split("  ")[-1] for line in lines] == list(KINDS)
    for line in lines:  # neither is the rule
        inputs, accepted, refused = map(int, re.findall(r"\d+", line)[:3])
        assert inputs == accepted + refused
        assert min(accepted, refused) > 0, line


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_are_sane_or_refused(kind: str, tmp_path: Path) -> None:
    read(tmp_path, "--slow", kind)
