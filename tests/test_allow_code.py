"""Code that files name: it is imported only where the user says so."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

import marouting
from marouting import InputError
from marouting.config import build, code_named, component_field, take_components
from marouting.registry import allowing_code, code_allowed, importing_from
from marouting.yaml_files import read_yaml, yaml_text
from policies.cli.main import status
from policies.experiment import Experiment, load_experiment
from policies.generalist import SHIPPED
from policies.learned.config import Config, load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run

CODE = """
from pathlib import Path
Path("ran").touch()
"""
COMPONENTS = """
from marouting.rewards import PaperReward as Team
from policies.routers.astar import AStarRouter as Mine
"""
QUIET = "train: {episodes: 1, figures: false, tensorboard: false}\n"
SMALL = "problem: {grid: [4, 4, 2], nets: 3}"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that is finished."""
    folder = tmp_path_factory.mktemp("run") / "run"
    raw = {
        "out": str(folder),
        "env": {"problem": {"grid": [4, 4, 2], "nets": 3}},
        "learner": {"burn_in_size": 20},
        "train": {"episodes": 1, "figures": False, "tensorboard": False},
    }
    Run(build(Config, raw)).execute()
    return folder


@pytest.fixture
def here(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a module, and with files that name what is in it."""
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    Path("evil.py").write_text(CODE + COMPONENTS)
    marouting.generate(1, grid=(4, 4, 2), nets=3)[0].write("p.gr")
    Path("train.yaml").write_text(
        f"out: t\nenv:\n  {SMALL}\n  reward: {{kind: 'evil:Team'}}\n{QUIET}"
    )
    Path("short.yaml").write_text("env:\n  observation: paper\n  reward: evil:Team\n")
    Path("mixed.yaml").write_text(
        "env:\n  reward:\n    kind: mixed\n    parts: [{kind: paper}, {kind: 'evil:Team'}]\n"
    )
    Path("learner.yaml").write_text("learner: evil:Learner\n")
    Path("network.yaml").write_text("learner:\n  network: {kind: 'evil:Network'}\n")
    Path("outer.yaml").write_text("include: train.yaml\nseed: 3\n")
    Path("anchor.yaml").write_text(
        "learner: {network: &x {kind: 'evil:Team'}}\nenv: {reward: *x}\n"
    )
    sets = "jobs: 1\nproblems: {s: {grid: [4, 4, 2], nets: 3}}\n"
    Path("e.yaml").write_text(f"out: e\n{sets}routers: {{a: {{router: 'evil:Mine'}}}}\n")
    Path("f.yaml").write_text(f"out: f\n{sets}routers:\n  a: {{router: dqn, config: train.yaml}}\n")
    Path("g.yaml").write_text(f"out: g\n{sets}routers: {{a: {{router: astar}}}}\n")
    Path("b.yaml").write_text("routers:\n  a: {router: 'evil:Mine'}\n")
    for name, change in POLICIES.items():
        state = torch.load(run / "policy.pt", weights_only=True)
        change(state)
        torch.save(state, f"{name}.pt")
    shutil.copytree(run, "run")
    config = read_yaml("run/config.yaml")
    Path("run/config.yaml").write_text(
        yaml_text({**config, "env": {**config["env"], "reward": "evil:Team"}})
    )
    shutil.copytree(run, "other")
    state = torch.load(run / "checkpoint.pt", weights_only=True)
    state["env"]["reward"] = {"kind": "evil:Team"}
    torch.save(state, "other/checkpoint.pt")
    yield tmp_path
    sys.path[:] = before
    sys.modules.pop("evil", None)


def shipped(state: dict[str, Any]) -> None:
    """A policy that the generalist takes, but for its reward."""
    state.clear()
    state.update(torch.load(SHIPPED, weights_only=True))
    state["env"]["reward"] = "evil:Team"


POLICIES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "reward": lambda state: state["env"].update(reward={"kind": "evil:Team"}),
    "observation": lambda state: state["env"].update(observation="evil:Seen"),
    "learner": lambda state: state["learner"].update(kind="evil:Learner"),
    "network": lambda state: state["learner"]["network"].update(kind="evil:Network"),
    "part": lambda state: state["env"].update(
        reward={"kind": "mixed", "parts": [{"kind": "paper"}, {"kind": "evil:Team"}]}
    ),
    "generalist": shipped,
}

ROUTE = ("route", "p.gr", "--router", "dqn")
BENCHMARK = ("benchmark", "--scenario", "toy-4x4-v0", "jobs=1")

COMMANDS: dict[str, tuple[tuple[str, ...], str]] = {
    "train": (("train", "train.yaml"), "train.yaml:4: env.reward.kind: found code, evil:Team; "),
    "train short": (("train", "short.yaml"), "short.yaml:3: env.reward: found code, evil:Team; "),
    "train mixed": (("train", "mixed.yaml"), "mixed.yaml:4: env.reward.parts.1.kind: found code"),
    "train learner": (("train", "learner.yaml"), "learner.yaml:1: learner: found code, evil:L"),
    "train network": (("train", "network.yaml"), "network.yaml:2: learner.network.kind: found"),
    "train include": (("train", "outer.yaml"), "train.yaml:4: env.reward.kind: found code"),
    "train alias": (("train", "anchor.yaml"), "anchor.yaml:1: learner.network.kind: found code"),
    "train another reward": (("train", "train.yaml", "env.reward=paper"), "train.yaml:4: env.rew"),
    "train start": (("train", f"env={{{SMALL}}}", "train.start=reward.pt"), "reward.pt: env.rew"),
    "train --resume": (("train", "--resume", "run"), "run/config.yaml:"),
    "train --resume checkpoint": (
        ("train", "--resume", "other", "train.episodes=2"), "other/checkpoint.pt: env.reward.kind",
    ),
    "config": (("config", "train.yaml"), "train.yaml:4: env.reward.kind: found code"),
    "route --config": ((*ROUTE, "--config", "train.yaml"), "train.yaml:4: env.reward.kind: found"),
    **{
        f"route {name}": ((*ROUTE, "--checkpoint", f"{name}.pt"), f"{name}.pt: {key}: found code")
        for name, key in (
            ("reward", "env.reward.kind"),
            ("observation", "env.observation"),
            ("learner", "learner.kind"),
            ("network", "learner.network.kind"),
            ("part", "env.reward.parts.1.kind"),
        )
    },
    "route learned": (
        ("route", "p.gr", "--router", "generalist", "weights=generalist.pt", "seconds=0.1"),
        "generalist.pt: env.reward: found code",
    ),
    "view": (
        ("view", "p.gr", "--checkpoint", "reward.pt", "--out", "a.svg"), "reward.pt: env.reward",
    ),
    "experiment": (("experiment", "e.yaml"), "e.yaml:4: routers.a.router: found code, evil:Mine"),
    "experiment config": (("experiment", "f.yaml"), "f.yaml: train.yaml:4: env.reward.kind: found"),
    "experiment checkpoint": (
        ("experiment", "g.yaml", "routers.b={router: dqn, checkpoint: reward.pt}"),
        "reward.pt: env.reward.kind: found code, evil:Team; ",
    ),
    "benchmark": ((*BENCHMARK, "--config", "b.yaml"), "b.yaml:2: routers.a.router: found code"),
    "benchmark policy": ((*BENCHMARK, "--router", "reward.pt"), "reward.pt: env.reward.kind: foun"),
}  # fmt: skip


@pytest.mark.parametrize(("words", "said"), COMMANDS.values(), ids=COMMANDS)
def test_files_name_no_code_unless_the_command_says_so(
    words: tuple[str, ...], said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(words) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f"marouting: {said}")
    assert "; pass --allow-code if you trust it" in line
    assert not (here / "ran").exists()
    assert str(here) not in sys.path
    if "other" in words or "env.reward=paper" in words:
        return  # nothing is imported of it, after all
    Path("evil.py").write_text(CODE)
    assert status([*words, "--allow-code"]) == 2
    assert "there is no class" in capsys.readouterr().err
    assert (here / "ran").exists()


@pytest.mark.usefixtures("at_once", "undrawn")
def test_what_the_user_says_is_code_that_may_run(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["env.reward=evil:Team", "train.episodes=1", "train.figures=false", "out=own"]
    words += [
        "train.tensorboard=false",
        "learner.burn_in_size=20",
        f"env.{SMALL.replace(': ', '=', 1)}",
    ]
    assert status(["route", "p.gr", "--router", "evil:Mine"]) == 0
    assert status(["train", *words]) == 0
    # The run folder is of files.
    assert status(["train", "--resume", "own"]) == 2
    assert status(["route", "p.gr", "--router", "dqn", "--checkpoint", "own/policy.pt"]) == 2
    assert "own/policy.pt: env.reward.kind: found code" in capsys.readouterr().err
    assert status(["train", "--resume", "own", "--allow-code"]) == 0
    assert status(["plot", "own", "--out", "plots"]) == 0
    experiment = ["experiment", "g.yaml", "routers.a={router: 'evil:Mine'}"]
    for _ in range(2):  # and once more, in a folder that names what the command does
        assert status(experiment) == 0
    assert status(["experiment", "e/config.yaml"]) == 2
    row = json.loads((here / "g" / "results.json").read_text())[0]
    assert row["kind"] == "evil:Mine"


def test_processes_of_an_experiment_may_what_the_command_may(here: Path) -> None:
    config = yaml_text({**read_yaml("g.yaml"), "out": "h"})
    policy = {"router": "dqn", "checkpoint": "reward.pt"}
    Path("h.yaml").write_text(config)
    words = ["experiment", "h.yaml", f"routers.b={json.dumps(policy)}", "--allow-code"]
    assert status(words) == 0
    assert (here / "h" / "results.json").exists()


def test_python_says_so_by_an_argument(here: Path) -> None:
    with importing_from(here):
        for read in (marouting.make, load_config, TrainedPolicy.load):
            file = "reward.pt" if read is TrainedPolicy.load else "train.yaml"
            with pytest.raises(
                InputError, match=r"found code, evil:Team; pass --allow-code .* \(allow"
            ):
                read(file)
            assert not Path("ran").exists()
            assert read(file, allow_code=True) is not None  # type: ignore[operator]
            Path("ran").unlink()
            del sys.modules["evil"]
        with pytest.raises(InputError, match=r"e.yaml:4: routers.a.router: found code, evil:Mine"):
            load_experiment("e.yaml")
        Experiment(load_experiment("e.yaml", allow_code=True)).execute()
        assert marouting.make({"env": {"reward": "evil:Team"}}) is not None


def test_a_run_goes_on_in_python_with_the_code_that_its_configuration_names(here: Path) -> None:
    with importing_from(here):
        config = load_config("train.yaml", ["learner.burn_in_size=20"], allow_code=True)
        Run(config)
        Run(config)  # it never began
        first = Run(config, resume=True).execute()
        assert Run(config, resume=True).finished == first


def test_only_some_code(here: Path) -> None:
    assert code_allowed() is False
    with allowing_code({"evil:Team"}):
        assert read_yaml("train.yaml")["env"]["reward"] == {"kind": "evil:Team"}
        with pytest.raises(InputError, match="found code, evil:Mine"):
            read_yaml("e.yaml")
        with allowing_code(["evil:Mine"]), allowing_code(False):
            assert read_yaml("train.yaml")
            assert read_yaml("e.yaml")
        with allowing_code(), allowing_code(["x:Y"]):
            assert code_allowed() is True
    assert code_allowed() is False
    assert here.exists()


def test_names_that_are_no_code(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(
        "out: C:runs\nenv: {problem: 'C:p.gr', reward: paper}\nlearner: {burn_in: 'C:folder'}\n"
        "routers: {a: {router: astar, label: 'Ours: better'}}\n"
    )
    assert read_yaml(tmp_path / "a.yaml")["out"] == "C:runs"


def test_components_stand_where_code_is_looked_for() -> None:
    """Under the name of their kind: otherwise what a file names there would be imported."""

    class Options:
        inner: Any = component_field("reward")

    import dataclasses

    options = dataclasses.dataclass(Options)
    made = options(inner="evil:Team")
    with pytest.raises(InputError, match="inner: expected a mapping with kind, found 'evil:Team'"):
        take_components(made)
    nested = {"a": [{"kind": "b:C"}], "reward": "d:E", "c": "f:G", "router": {"kind": 3}}
    assert list(code_named(nested)) == [(("a", "0", "kind"), "b:C"), (("reward",), "d:E")]
