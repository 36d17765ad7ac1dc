"""The speed command: what it measures is there and adds up; how fast it is, no test asks."""

import json
from pathlib import Path

import pytest

from policies.bench.__main__ import SECTIONS, main, number
from policies.bench.measure import Bench, rate
from policies.cli.main import status


def test_rates_are_taken_in_turns() -> None:
    calls: list[str] = []

    def work(name: str, done: float) -> float:
        calls.append(name)
        return done

    bench = Bench(repeats=3)
    row = bench.versus("a", "things/s", lambda: work("a", 4), "b", lambda: work("b", 2))
    assert calls == ["a", "b"] * 4  # the first time is not kept
    assert row.against is not None
    assert row.ratio == pytest.approx(row.value / row.against)
    assert row.best >= row.value > 0
    assert rate(lambda: 0.0) == 0


def test_the_command_prints_and_stores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "speed.json"
    assert status(["search", "--repeats", "1", "--out", str(file), "--json"], main) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(file.read_text())
    assert printed["machine"]["numba"]
    (row, *_) = printed["rows"]
    assert row["section"] == "search"
    assert row["unit"] == "tasks/s"
    assert row["ratio"] == pytest.approx(row["value"] / row["against"])
    assert status(["search", "--repeats", "1"], main) == 0
    shown = capsys.readouterr().out
    assert "sequential A*" in shown
    assert number(row["value"])[:1] in shown


def test_the_former_command_names_the_new_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["bench", "search"]) == 2
    said = "marouting: marouting bench: it is now python -m policies.bench\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["everything"], "everything: expected one of start"),
        (["search", "--repeats", "0"], "repeats"),
        (["search", "--threads", "0"], "threads"),
        (["search", "--out", "/dev/null/x.json"], "/dev/null/x.json"),
    ],
)
def test_what_cannot_be_measured(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(arguments, main) == 2
    out, err = capsys.readouterr()
    assert not out
    assert message in err
    assert "Traceback" not in err


@pytest.mark.slow
@pytest.mark.parametrize("section", SECTIONS)
def test_every_section_measures(section: str) -> None:
    rows = list(SECTIONS[section](Bench(repeats=1)))
    assert rows
    for row in rows:
        assert row.value > 0
        assert row.best > 0
