"""Configurations that begin from other files."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import marouting
from marouting import InputError
from marouting.yaml_files import merged, origins_of, read_yaml
from policies.cli.main import status
from policies.experiment import load_experiment
from policies.experiment.benchmark import load_entries
from policies.learned.config import load_config

ROOT = Path(__file__).parent.parent


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    return tmp_path


def write(files: Mapping[str, str]) -> None:
    for name, text in files.items():
        Path(name).write_text(text)


FILES = {
    "own.yaml": "include: sub/middle.yaml\nlearner: {kind: ppo}\ntrain:\n  episodes: 9\n",
    "sub/middle.yaml": "include: [one.yaml, two.yaml]\nenv:\n  max_steps: 12\n",
    "sub/one.yaml": "seed: 1\nenv: {max_steps: 11, agents: multi}\nlearner: {gamma: 0.5}\n",
    "sub/two.yaml": "\nseed: 2\ntrain: {episodes: 3, threads: 2}\n"
    "learner: {kind: dqn, batch_size: 2}\n",
}


@pytest.mark.usefixtures("here")
def test_a_file_begins_from_others_beside_it() -> None:
    write(FILES)
    assert read_yaml("own.yaml") == {
        "seed": 2,
        "env": {"max_steps": 12, "agents": "multi"},
        "learner": {"kind": "ppo"},  # another component takes none of a component's options
        "train": {"episodes": 9, "threads": 2},
    }
    assert read_yaml("sub/middle.yaml")["learner"] == {"kind": "dqn", "batch_size": 2}
    assert origins_of("own.yaml") == {
        ("seed",): ("sub/two.yaml", 2),
        ("env", "max_steps"): ("sub/middle.yaml", 3),
        ("env", "agents"): ("sub/one.yaml", 2),
        ("learner", "kind"): ("own.yaml", 2),
        ("train", "episodes"): ("own.yaml", 4),
        ("train", "threads"): ("sub/two.yaml", 3),
    }


def test_the_whole_is_shown_with_its_origins(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(FILES)
    monkeypatch.chdir(here.parent)
    arguments = ["config", f"{here.name}/own.yaml", "train.threads=1"]
    assert status(arguments) == 0
    text = capsys.readouterr().out
    origins = {line.split("#")[1].strip() for line in text.splitlines() if "#" in line}
    assert origins == {
        "own.yaml:2", "own.yaml:4", "sub/middle.yaml:3", "sub/one.yaml:2", "sub/two.yaml:2",
        "command line", "default",
    }  # fmt: skip
    (here / "whole.yaml").write_text(text)
    expected = load_config(here / "own.yaml", ["train.threads=1"])
    assert load_config(here / "whole.yaml") == expected
    assert status([*arguments, "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["origins"]["env.agents"] == "sub/one.yaml:2"
    assert shown["config"] == yaml.safe_load(text)


@pytest.mark.usefixtures("here")
def test_one_mechanism_for_every_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    write(
        {
            "table.yaml": "include: configs/paper/size16.yaml\n"
            "problems: {capacity3: {count: 2}}\nrouters: {dqn: null}\n",
            "scores.yaml": "include: configs/benchmark/baselines.yaml\nseeds: 1\n",
            "game.yaml": "include: [configs/paper/default.yaml]\nenv: {agents: multi}\n",
            "router.yaml": "include: sub/astar.yaml\nnet_order: file\n",
            "sub/astar.yaml": "net_order: random\ntarget: tree\n",
        }
    )
    experiment = load_experiment("table.yaml")
    assert set(experiment.routers) == {"astar", "astar-best", "pathfinder", "optimal"}
    assert experiment.problems["capacity3"]["grid"] == [16, 16, 2]
    assert experiment.problems["capacity3"]["count"] == 2
    entries, scores = load_entries("scores.yaml", (), None)
    assert (scores.seeds, scores.budget) == (1, "1s")
    assert "optimal" in [entry.name for entry in entries]
    assert marouting.make("game.yaml").possible_agents
    marouting.generate(1, grid=(4, 4, 2), nets=3)[0].write("p.gr")
    assert status(["route", "p.gr", "--config", "router.yaml"]) == 0
    capsys.readouterr()


WRONG = {
    "none": ("include: sub/none.yaml\n", "own.yaml:1: include: expected a file, found none at"),
    "a folder": ("\ninclude: sub\n", "own.yaml:2: include: expected a file, found none at sub"),
    "itself": ("include: own.yaml\n", "own.yaml:1: include: expected no circular include"),
    "a number": ("include: 3\n", "own.yaml:1: include: expected a file or a list of files"),
    "numbers": ("include: [3]\n", "own.yaml:1: include: expected a file or a list of files"),
    "a circle": (
        "include: sub/back.yaml\n",
        "sub/back.yaml:1: include: expected no circular include",
    ),
    "no YAML": ("include: sub/not.yaml\n", "sub/not.yaml:2: expected YAML"),
    "no mapping": ("include: sub/list.yaml\n", "sub/list.yaml: expected a mapping of keys"),
    "too many": ("include: sub/m1.yaml\n", "include: expected at most 100 files in all"),
    "unknown": ("include: sub/key.yaml\n", "own.yaml: sede: unknown key; did you mean seed?"),
}


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=WRONG)
@pytest.mark.usefixtures("here")
def test_what_cannot_be_included_is_one_line(
    text: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write({f"sub/m{i}.yaml": f"include: {[f'm{i + 1}.yaml'] * 2}\n" for i in range(1, 9)})
    write({"sub/m9.yaml": "", "sub/back.yaml": "include: ../own.yaml\n"})
    write({"sub/not.yaml": "\na: }", "sub/list.yaml": "[1]", "sub/key.yaml": "sede: 1"})
    write({"own.yaml": text})
    assert status(["train", "own.yaml"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


def test_a_file_may_be_included_twice(here: Path) -> None:
    write({"own.yaml": "include: [sub/a.yaml, sub/b.yaml, sub/a.yaml]\n"})
    write({"sub/a.yaml": "seed: 1\n", "sub/b.yaml": "seed: 2\n"})
    assert read_yaml(here / "own.yaml") == {"seed": 1}


@pytest.mark.parametrize(
    "path", sorted((ROOT / "configs").rglob("*.yaml")), ids=lambda path: path.stem
)
def test_editors_accept_the_files_of_the_project(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As they are written: an editor does not follow includes."""
    commands = {"benchmark": "benchmark", "benchmarl": None}
    raw = yaml.load(path.read_text(), Loader=yaml.SafeLoader)
    command = commands.get(path.parent.name, "experiment" if "routers" in raw else "train")
    if command is None or path.stem == "pathfinder":  # not ours; a router's options
        return
    assert status(["config", "--schema", command]) == 0
    jsonschema.validate(raw, json.loads(capsys.readouterr().out))


PLAIN: st.SearchStrategy[Any] = st.recursive(
    st.integers() | st.none() | st.lists(st.integers(), max_size=2),
    lambda inner: st.dictionaries(st.sampled_from("abcd"), inner, max_size=3),
    max_leaves=8,
)
MAPPINGS = st.dictionaries(st.sampled_from("abcd"), PLAIN, max_size=3)


def flat(data: Any, above: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    if not isinstance(data, dict) or not data:
        return {above: data}
    return {key: value for name in data for key, value in flat(data[name], (*above, name)).items()}


@given(MAPPINGS, MAPPINGS)
def test_merging_keeps_all_of_the_later_and_the_rest_of_the_earlier(
    first: dict[str, Any], later: dict[str, Any]
) -> None:
    whole = merged(first, later)
    found, own, others = flat(whole), flat(later), flat(first)
    for keys, value in own.items():
        if value != {}:  # an empty mapping replaces nothing
            assert found[keys] == value
    assert all(found[keys] == own.get(keys, others.get(keys)) for keys in found if keys)
    assert merged(whole, later) == whole
    assert merged({}, later) == later


def test_wrong_values_name_the_file_that_was_given(here: Path) -> None:
    write({"own.yaml": "include: sub/a.yaml\n", "sub/a.yaml": "train: {episodes: many}\n"})
    with pytest.raises(InputError, match=r"own\.yaml: train\.episodes: expected"):
        load_config(here / "own.yaml")
