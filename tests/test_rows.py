"""Rows of results: what files of them hold is read whole, or refused in one line."""

import csv
import io
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from policies import figures
from policies.figures.plot import experiment_figures, reward_figures
from policies.results.rows import COLUMNS, ResultRow, read_published, read_rows, to_csv
from policies.results.run_folder import read_rewards
from policies.results.statistics import add_gaps, by_set, summarise

DOCS = Path(__file__).resolve().parents[1] / "docs" / "results"


def row(problem: str, router: str, seed: int | None, **figures: Any) -> dict[str, Any]:
    """A row of an experiment."""
    known = {"overflow": 1, "max_overflow": 1, "wirelength": 20, "vias": 4, "connected": True}
    known |= {"pruned_overflow": 0, "pruned_wirelength": 18}
    known |= {"open_nets": 0, "joined": 3, "tasks": 3, "seconds": 0.5}
    about = {"set": "s", "problem": problem, "router": router, "kind": router, "seed": seed}
    return {**dict.fromkeys(COLUMNS), **about, **known, **figures}


ROWS = [
    row("p", "astar", None),
    row("q", "astar", None, wirelength=22),
    *(row(problem, "dqn", seed, **{"from": "episode 3"}) for problem in "pq" for seed in (0, 4)),
    row("p", "optimal", None, overflow=0, max_overflow=0, wirelength=19, proven=True, gap=0.0),
    row("q", "optimal", None, overflow=1, proven=True),
    row("p", "random", 0, set="t", joined=1, connected=False),
]
RESULTS = [
    {key: value for key, value in of.items() if key in {*ResultRow.__annotations__, "from"}}
    for of in ROWS[2:4:2]
]
EPISODE = {"reward": -12.5, "joined": 2, "tasks": 3, "overflow": 0, "wirelength": 17, "steps": 40}
EPISODE |= {"epsilon": 0.05, "loss": 0.25, "updates": 7, "best": False}
EPISODES = [{"problem": name, "episode": n, **EPISODE} for n in range(2) for name in "pq"]


def sane(value: Any) -> bool:
    """Whether plain data has only finite numbers."""
    if isinstance(value, dict):
        return all(map(sane, value.values()))
    if isinstance(value, list):
        return all(map(sane, value))
    return not isinstance(value, float) or math.isfinite(value)


def summarised(file: Path) -> None:
    """Reads the rows of an experiment and does with them all that is done but pictures."""
    rows = read_rows(file)
    add_gaps(rows)
    for of in rows:
        counts = (of[key] for key in ("overflow", "wirelength", "joined", "tasks", "vias"))
        assert all(count is None or (type(count) is int and count >= 0) for count in counts)
    assert sane(rows)
    summary = {name: summarise(own, "dqn") for name, own in by_set(rows).items()}
    assert sane(summary)
    for of in (of for own in summary.values() for of in own):
        assert of["problems"] > 0
        assert min(of["overflow"], of["open"], of["zero_overflow"]) >= 0
        assert of["zero_overflow"] <= of["problems"]
    assert len(list(csv.reader(io.StringIO(to_csv(rows))))) == len(rows) + 1


def drawn(file: Path) -> None:
    """Draws the rows of an experiment."""
    (file.parent / "config.yaml").write_text("{}")
    experiment_figures(file.parent)


def finished(file: Path) -> None:
    """Reads the rows of a training."""
    assert all(of["wirelength"] >= of["vias"] >= 0 for of in read_rows(file, ResultRow))


def rewarded(file: Path) -> None:
    """Reads the episodes of a training."""
    assert sane(read_rewards(file))


def quoted(file: Path) -> None:
    """Reads published rows."""
    for names, counts in read_published(str(file)).items():
        assert all(names)
        assert all(type(count) is int and 0 <= count < 2**63 for count in counts)


def as_lines(episodes: Any) -> str:
    return "".join(json.dumps(of) + "\n" for of in episodes)


def as_table(rows: Any) -> str:
    """Rows of results as CSV, one for each problem."""
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow(COLUMNS)
    table.writerows(of.values() if isinstance(of, dict) else [of] for of in rows)
    return text.getvalue()


Kind = tuple[str, Any, Callable[[Any], str], Callable[[Path], object]]
READ: dict[str, Kind] = {
    "an experiment": ("results.json", ROWS, json.dumps, summarised),
    "a training": ("result.json", RESULTS, json.dumps, finished),
    "episodes": ("metrics.jsonl", EPISODES, as_lines, rewarded),
    "published": ("published.csv", ROWS[:2], as_table, quoted),
}
DRAWN: dict[str, Kind] = {
    "an experiment": ("results.json", ROWS, json.dumps, drawn),
    "episodes": (
        "metrics.jsonl",
        EPISODES,
        as_lines,
        lambda file: reward_figures(file, file.parent),
    ),
}


@pytest.mark.parametrize("kind", [*READ.values(), *DRAWN.values()], ids=[*READ, *map(str, DRAWN)])
def test_the_files_are_good_before_they_are_spoiled(kind: Kind, tmp_path: Path) -> None:
    name, data, as_text, read = kind
    (tmp_path / name).write_text(as_text(data))
    read(tmp_path / name)


def test_published_files_are_read(tmp_path: Path) -> None:
    for name in ("shuffle26_single.json", "shuffle26_multi.json"):
        # A*, the best episode and the policy in the end, on eleven problems.
        assert len(read_rows(DOCS / name, ResultRow)) == 33
    tables = [*DOCS.glob("paper/*.csv"), DOCS / "liao2019.csv"]
    assert len(tables) == 8
    for path in tables:
        with path.open(newline="") as lines:
            found = list(csv.DictReader(lines))
        # A router and a seed at a time: a table of ours has several.
        for one in {(of["router"], of["seed"]) for of in found}:
            own = [of for of in found if (of["router"], of["seed"]) == one]
            (tmp_path / "one.csv").write_text(as_table(own))
            table = path.read_text().splitlines()[0]
            text = (tmp_path / "one.csv").read_text().split("\n", 1)[1]
            (tmp_path / "one.csv").write_text(f"{table}\n{text}")
            assert read_published(str(tmp_path / "one.csv")) == {
                (of["set"], of["problem"]): (int(of["overflow"]), int(of["wirelength"]))
                for of in own
            }


NAMES = ["=1+1", "-2", "+3", "@sum", "'=1+1", "''-", "'quoted'", "a,b", 'a"b', "plain", "3"]


def test_names_in_tables_are_no_formulas_and_are_read_back(tmp_path: Path) -> None:
    rows = [row(name, "astar", None, wirelength=n) for n, name in enumerate(NAMES, 4)]
    rows[0] |= {"gap": -0.5, "from": "\tx"}
    text = to_csv(rows)
    for cells in csv.reader(io.StringIO(text)):
        for cell in cells:
            assert not re.match(r"[=+\-@\t\r]", cell) or re.fullmatch(r"-?[0-9.]+", cell)
    (tmp_path / "results.csv").write_text(text)
    assert list(read_published(str(tmp_path / "results.csv"))) == [("s", name) for name in NAMES]
    (tmp_path / "theirs.csv").write_text("set,problem,overflow,wirelength\ns,=1+1,0,2\ns,--x,0,3\n")
    found = read_published(str(tmp_path / "theirs.csv"))
    assert found == {("s", "=1+1"): (0, 2), ("s", "--x"): (0, 3)}


def test_a_table_as_excel_writes_it(tmp_path: Path) -> None:
    text = "\ufeffset,problem,overflow,wirelength\r\ns,p,0,2\r\n\r\n"
    (tmp_path / "p.csv").write_bytes(text.encode())
    assert read_published(str(tmp_path / "p.csv")) == {("s", "p"): (0, 2)}


def test_gaps_to_an_optimum_of_nothing() -> None:
    none = {"overflow": 0, "max_overflow": 0, "vias": 0, "joined": 0, "tasks": 0}
    none |= {"pruned_overflow": 0, "pruned_wirelength": 0}
    rows = [
        row("p", name, None, **none, wirelength=length, proven=name == "optimal")
        for name, length in (("optimal", 0), ("astar", 0), ("dqn", 2))
    ]
    add_gaps(rows)
    assert [of["gap"] for of in rows] == [0.0, 0.0, None]
    best, astar, dqn = summarise(rows)
    assert astar["gap"] == {"mean": 0.0, "low": None, "high": None, "problems": 1}
    assert dqn["gap"] is None
    assert best["against_astar"] == {"wins": 0, "ties": 1, "losses": 0}
    assert dqn["lower_wirelength"]["percent"] == 0


def test_routers_are_compared_where_both_have_rows() -> None:
    rows = [
        row("p", "astar", None, wirelength=20),
        row("q", "astar", None, wirelength=20),
        row("q", "dqn", 0, wirelength=18),
        row("q", "dqn", 4, wirelength=22),
        row("r", "dqn", 0, wirelength=10),
        row("r", "random", 0, wirelength=30),
    ]
    _, dqn, random = summarise(rows, "random")
    assert dqn["problems"] == dqn["seeds"] == 2
    assert dqn["wirelength"]["mean"] == 15
    assert dqn["against_astar"] == {"wins": 0.5, "ties": 0, "losses": 0.5}
    assert dqn["lower_wirelength"]["percent"] == 50
    assert dqn["against_reference"] == {"wins": 1, "ties": 0, "losses": 0}
    assert dqn["spread"]["wirelength"] is None
    assert random["against_astar"] is None
    assert random["lower_wirelength"] is None


COUNTS = st.sampled_from([0, 0, 1, 2, 3, 50, 2**31, 2**53 + 1, 2**63 - 1])


@st.composite
def valid(draw: st.DrawFn) -> list[dict[str, Any]]:
    """Rows of any routers on any problems: with every count that the columns allow, none of them
    with the same problems and seeds."""
    about = st.tuples(
        st.sampled_from("st"),
        st.sampled_from(["p", "q", "=1+1", "$\\frac$"]),
        st.sampled_from(["astar", "dqn", "_x", "pathfinder"]),
        st.sampled_from([None, 0, 4]),
    )
    rows = []
    for set, problem, router, seed in draw(st.lists(about, min_size=1, max_size=12, unique=True)):
        overflow, wirelength, tasks = draw(st.tuples(COUNTS, COUNTS, COUNTS))
        figures = {"set": set, "overflow": overflow, "max_overflow": min(overflow, draw(COUNTS))}
        figures |= {"wirelength": wirelength, "vias": min(wirelength, draw(COUNTS))}
        pruned = {"pruned_overflow": overflow, "pruned_wirelength": wirelength}
        figures |= {key: draw(st.sampled_from([None, 0, most])) for key, most in pruned.items()}
        figures |= {"joined": min(tasks, draw(COUNTS)), "tasks": tasks, "seconds": draw(COUNTS)}
        figures["proven"] = draw(st.sampled_from([None, False, True]))
        rows.append(row(problem, router, seed, **figures))
    return rows


@settings(suppress_health_check=[*HealthCheck])
@given(rows=valid())
def test_any_rows_have_statistics(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps(rows))
    summarised(tmp_path / "results.json")


@settings(examples(6), suppress_health_check=[*HealthCheck])
@given(rows=valid())
def test_any_rows_are_drawn(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps(rows))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "save", lambda figure, _: figure.draw_without_rendering())
        drawn(tmp_path / "results.json")
