"""docs/examples/problems/fetch.py, with archives made of the problems at hand."""

import csv
import importlib.util
import sys
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="needs the problems in ../shared/data")


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which fetches from this folder; whatever is not put there is not found."""
    file = ROOT / "docs" / "examples" / "problems" / "fetch.py"
    spec = importlib.util.spec_from_file_location("fetch", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in module.URLS:
        monkeypatch.setitem(module.URLS, name, (tmp_path / name).as_uri())
    return module


def run(script: ModuleType, monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    monkeypatch.setattr(sys, "argv", ["fetch.py", *words])
    script.main()


@needs_data
def test_sets_are_laid_out_as_configurations_expect(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with zipfile.ZipFile(tmp_path / "liao2019", "w") as archive:
        for file in (DATA / "liao2019").glob("*/*.gr"):
            archive.write(file, f"HEAD/ExperimentResults/{file.parent.name}/eval/{file.name}")
    with tarfile.open(tmp_path / "ispd18", "w:gz") as tar:
        for file in (DATA / "ispd18").iterdir():
            tar.add(file, file.name)
    ibm = "ispd98/ibm01.modified.txt"
    (tmp_path / "ispd98").write_bytes((DATA / ibm).read_bytes())
    to = tmp_path / "data"
    run(script, monkeypatch, "--to", str(to))
    for path in [*script.known("liao2019"), *script.known("ispd18"), ibm]:
        assert (to / path).read_bytes() == (DATA / path).read_bytes()
    assert len(script.known("liao2019")) == 121

    def table(folder: Path) -> dict[tuple[str, str], dict[str, str]]:
        with (folder / "liao2019" / "results.csv").open(newline="") as lines:
            return {(row["set"], row["problem"]): row for row in csv.DictReader(lines)}

    found, expected = table(to), table(DATA)
    assert found.keys() == expected.keys()
    assert all(row.items() <= expected[key].items() for key, row in found.items())


def test_what_cannot_be_fetched_or_has_changed_is_said_in_a_line(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit, match=r"^ispd98: file:.*No such file"):
        run(script, monkeypatch, "ispd98", "--to", str(tmp_path / "data"))
    (tmp_path / "ispd98").write_text("grid 1 1 1\n")
    with pytest.raises(SystemExit, match=r"^ispd98: 1 of 1 files have changed"):
        run(script, monkeypatch, "ispd98", "--to", str(tmp_path / "data"))
    assert not (tmp_path / "data").exists()
    with pytest.raises(SystemExit) as stop:
        run(script, monkeypatch, "ispd99")
    assert stop.value.code == 2
