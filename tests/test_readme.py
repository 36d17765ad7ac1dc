"""README's examples run as they stand, and its two commands are those that .ci/run looks for."""

import re
import subprocess
import sys
from pathlib import Path

import pettingzoo
import pytest

import marouting

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_runs(example: str, tmp_path: Path) -> None:
    if "pettingzoo.make(" in example and not hasattr(pettingzoo, "make"):
        pytest.skip("this PettingZoo has no registry")
    marouting.generate(1, nets=5)[0].write(tmp_path / "problem.gr")
    done = subprocess.run(
        [sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("mark", "command"),
    [
        ("install", "python -m pip install -e '.[test]' && marouting quickstart"),
        ("test", "python -m pytest"),
    ],
)
def test_the_commands_stand_where_ci_reads_them(mark: str, command: str) -> None:
    assert f"<!-- ci: {mark} -->\n```sh\n{command}\n```" in README


def test_links_lead_to_files() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert link.startswith("https://") or (ROOT / link).exists(), link
