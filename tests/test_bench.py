"""The speed command: what it measures is there and adds up; how fast it is, no test asks."""

import itertools
import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import click
import numpy as np
import pytest
import torch

from marouting import Engine, InputError, generate
from policies.bench import SECTIONS, Bench, environment, evolution, negotiation, oracle, predicted
from policies.bench.features import Blind
from policies.bench.measure import rate
from policies.bench.training import operations
from policies.cli import main as cli
from policies.generalist.outlook import OutlookObservation
from policies.routers.pathfinder import PathfinderOptions


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


def test_operations_of_a_gradient_step() -> None:
    # One layer of 3 by 5: forward twice, and its derivative by weights, two operations each.
    assert operations((3, 5), 7) == 2 * 7 * 3 * 15
    # A second layer of 5 by 2 adds its derivative by the inputs.
    assert operations((3, 5, 2), 7) == 2 * 7 * (3 * 15 + 4 * 10)


def test_the_command_prints_and_stores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "speed.json"
    assert cli.status(["bench", "search", "--repeats", "1", "--out", str(file), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(file.read_text())
    assert printed["machine"]["numba"]
    (row, *_) = printed["rows"]
    assert row["section"] == "search"
    assert row["unit"] == "tasks/s"
    assert row["ratio"] == pytest.approx(row["value"] / row["against"])
    assert cli.status(["bench", "search", "--repeats", "1"]) == 0
    assert "sequential A*" in " ".join(capsys.readouterr().out.split())


def test_negotiation_is_compared_over_seeds() -> None:
    rows = [
        {"router": router, "family": "a", "problem": problem, "seed": seed, "seconds": 1.0}
        | {"overflow": overflow, "wirelength": 100}
        for router, found in (("before", ((10, 30), (20, 40))), ("now", ((9, 27), (18, 36))))
        for seed, sums in enumerate(found)
        for problem, overflow in enumerate(sums)
    ]
    lines = "".join(negotiation.summary(rows)).splitlines()[2:]
    assert lines == [
        "| a | 1 | before | 50.0 ± 14.1 | 200 |",
        "| a | 1 | now | 45.0 ± 12.7 (-10.0%) | 200 |",
    ]


def test_rows_of_every_observation_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "_RADII", (1,))
    monkeypatch.setattr(environment, "_KINDS", {"few": ({"nets": 3}, 2)})
    rows = itertools.islice(environment.observation(Bench(repeats=1)), 3)  # what a row costs
    names = [row.name for row in rows if row.unit == "ns a row" and row.value > 0]
    assert names == [
        "window, radius 1, 322 numbers, few",
        "window, radius 2, no demand, 476 numbers, few",
        "outlook, 252 numbers, few",
    ]


@pytest.mark.slow
def test_negotiation_against_another_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This one, in a process of its own; with next to no time, results are those of one pass."""
    monkeypatch.setitem(negotiation.GENERATED["c"], "count", 2)
    file = tmp_path / "rows.json"
    folder = str(Path(__file__).resolve().parents[1])
    arguments = ["--against", folder, "--families", "c", "--seeds", "1", "--seconds", "0"]
    negotiation.main([*arguments, "--out", str(file)], standalone_mode=False)
    rows = json.loads(file.read_text())
    assert [row["router"] for row in rows] == ["before", "now"] * 2
    assert all(row["connected"] for row in rows)


@pytest.mark.slow
def test_growth_is_measured_in_processes_of_their_own(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    subprocess.run(
        [sys.executable, "-m", "policies.bench.growth", "--nets", "100,400", "--out", str(file)],
        check=True,
    )
    rows = json.loads(file.read_text())
    assert [(row["nets"], row["grid"]) for row in rows] == [(100, "10x10x9"), (400, "20x20x9")]
    assert all(row["connected"] and row["overflow"] == 0 for row in rows)


@pytest.mark.parametrize(
    ("kind", "others"),
    [("prices", ["prices x 1", "prices x 0.5"]), ("evolved", ["evolved"])],
)
def test_oracles_are_compared_with_the_defaults(
    kind: str,
    others: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(negotiation.GENERATED["c"], "count", 1)
    file = tmp_path / "rows.json"
    arguments = [kind, "--families", "c", "--seeds", "2", "--seconds", "0.01", "--long", "0.02"]
    arguments += ["--out", str(file)]
    oracle.main(arguments, standalone_mode=False)
    rows = json.loads(file.read_text())
    assert [row["router"] for row in rows] == ["defaults", *others] * 2
    assert all(row["wirelength"] > 0 for row in rows)
    assert f"| c | 0.01 | {others[-1]} | " in capsys.readouterr().out


def test_evolution_judges_sets_by_several_trials(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "sets.json"
    arguments = ["--on", "c:2:0.01", "--trials", "9", "--first", '{"stuck": 30}']
    evolution.main([*arguments, "--out", str(file)], standalone_mode=False)
    sets = json.loads(file.read_text())
    assert len(sets) == 7  # the fourth and the eighth trial were of sets that there were
    losses = [each.pop("losses") for each in sets]
    assert sum(map(len, losses)) == 9
    assert max(map(len, losses)) > 1
    judged = [np.mean(found) + evolution.DOUBT / len(found) for found in losses]
    assert judged == sorted(judged)
    assert {**evolution.FIRST, "stuck": 30} in sets
    for each in sets:
        PathfinderOptions(**each)
        for name, allowed in evolution.RANGES.items():
            assert allowed.low <= each[name] <= allowed.high
    assert json.loads(capsys.readouterr().out) == sets[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--on", "c:2"], "expected FAMILY:COUNT:SECONDS, found c:2"),
        (["--on", "c:two:1"], "expected FAMILY:COUNT:SECONDS, found c:two:1"),
        (["--on", "d:2:1"], "expected one of a, b, c, chip, tight-16x16-v0, .* as"),
        (["--on", "c:1:1", "--first", "{"], "expected options in JSON"),
        (["--on", "c:1:1", "--first", '{"growth": 0}'], "growth: expected a number from 1"),
    ],
)
def test_evolution_says_what_it_expects(arguments: list[str], message: str) -> None:
    with pytest.raises(click.BadParameter, match=message):
        evolution.main([*arguments, "--out", "x.json"], standalone_mode=False)


def test_predicted_prices_are_compared_with_the_defaults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(negotiation.GENERATED["c"], "count", 1)
    file = tmp_path / "rows.json"
    arguments = ["--families", "c", "--seeds", "2", "--seconds", "0.05", "--shares", "0.5"]
    arguments += ["--count", "2", "--longest", "0.05", "--epochs", "1", "--out", str(file)]
    predicted.main(arguments, standalone_mode=False)
    rows = json.loads(file.read_text())
    assert [row["router"] for row in rows] == ["defaults", "predicted x 0.5"] * 2
    assert "| c | 0.05 | predicted x 0.5 | " in capsys.readouterr().out


def test_predicted_prices_are_where_the_edges_are() -> None:
    """What the network sees and what it says lies on the edges that have capacity."""
    torch.manual_seed(1)
    network = predicted.Prices(units=4, dilations=(1,))
    problem = generate(1, (7, 5, 2), nets=6, max_pins=3, capacity=2, reduced_edges=0, seed=4)[0]
    prices = predicted.predict(network, problem)
    assert prices.shape == problem.capacity.shape
    assert prices[problem.capacity > 0].any()
    assert not prices[problem.capacity == 0].any()
    along_x, along_y = predicted.see(problem)
    assert along_x.shape == (predicted.CHANNELS, 7, 5)
    assert along_y.shape == (predicted.CHANNELS, 5, 7)
    for seen in (along_x, along_y):  # the last column has no edges, and no demand
        assert not seen[5, -1].any()
        assert seen[5, :-1].all()
        assert not seen[0, -1].any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["everything"], "everything: expected one of start"),
        (["search", "--repeats", "0"], "repeats"),
        (["search", "--threads", "0"], "threads"),
        (["search", "--out", "/dev/null/x.json"], "/dev/null/x.json"),
        pytest.param(
            ["jumanji"],
            "expected the package jumanji",
            marks=pytest.mark.skipif(find_spec("jumanji") is not None, reason="it is installed"),
        ),
    ],
)
def test_what_cannot_be_measured(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.status(["bench", *arguments]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert message in err
    assert "Traceback" not in err


@pytest.mark.slow
@pytest.mark.parametrize("section", [name for name in SECTIONS if name != "jumanji"])
def test_every_section_measures(section: str) -> None:
    rows = list(SECTIONS[section](Bench(repeats=1)))
    assert rows
    for row in rows:
        assert row.value > 0
        assert row.best > 0


def test_a_part_of_what_the_generalist_sees_can_be_left_out() -> None:
    """The blocks named are 0 and all others as they are; the frame's signs must stay."""
    engine = Engine(generate(1, (6, 6, 2), nets=8, max_pins=4, seed=0), target="tree")
    whole, less = OutlookObservation(), Blind(without=("span", "pins"))
    seen = np.ones((2, 1, whole.size), np.float32)
    for each, out in zip((whole, less), seen, strict=True):
        each.write(engine, np.zeros(1, np.int32), np.zeros(1, np.int32), out)
    for name, block in whole.layout.items():
        left_out = name in less.without
        assert seen[0, 0, block].any() or not left_out
        np.testing.assert_array_equal(seen[1, 0, block], seen[0, 0, block] * (not left_out))
    for wrong in ("numbers", "pin"):
        with pytest.raises(InputError, match="without: expected some of detour, span"):
            Blind(without=(wrong,))
