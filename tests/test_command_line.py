"""What all commands have in common: --json with stable keys, times, completion, messages."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

import marouting
from marouting import Problem, Solution
from policies.cli.main import cli, status
from policies.experiment import Experiment, load_experiment
from policies.interrupts import ENDING

QUIET = ("train.figures=false", "train.tensorboard=false", "learner.burn_in_size=100")
ROUTED = {
    "router", "overflow", "max_overflow", "wirelength", "vias", "pruned_overflow",
    "pruned_wirelength", "connected", "joined", "tasks", "seconds", "open_nets",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a problem, a solution of it, and an experiment's configuration."""
    folder = tmp_path_factory.mktemp("json")
    problem = marouting.generate(1, grid=(4, 4, 2), nets=3, seed=1)[0]
    problem.write(folder / "p.gr")
    marouting.sequential_astar(problem).write(folder / "p.solution")
    (folder / "e.yaml").write_text(
        "out: e\njobs: 1\nproblems: {small: {grid: [4, 4, 2], nets: 3, count: 2}}\n"
        "routers: {astar: {router: astar}}\n"
    )
    return folder


@pytest.fixture
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(folder)
    return folder


COMMANDS: dict[str, tuple[list[str], set[str]]] = {
    "generate": (
        ["--grid", "4", "4", "2", "--nets", "3", "--count", "2", "--out", "g"],
        {"out", "count", "files"},
    ),
    "convert": (["p.gr", "q.gr"], {"out", "grid", "nets"}),
    "route": (["p.gr"], {*ROUTED, "processor_seconds"}),
    "evaluate": (["p.gr", "p.solution"], ROUTED),
    "view": (["p.gr", "p.solution", "--out", "p.html"], {"out", "solutions"}),
    "config": (["e.yaml"], {"config", "origins"}),
    "train": (
        ["configs/paper/default.yaml", "env.problem=p.gr", "train.episodes=2", "out=t", *QUIET],
        {"out", "episodes", "rows"},
    ),
    "experiment": (["e.yaml"], {"sets", "reference"}),
    "plot": (["p.gr", "p.solution"], {"files"}),
    "benchmark": (
        ["--scenario", "toy-4x4-v0", "--router", "astar", "--out", "b", "jobs=1"],
        {"files", "rows"},
    ),
}
"""Arguments, and keys that the object has; ``quickstart`` takes too long."""


def test_every_command_has_an_option_for_json() -> None:
    assert {*COMMANDS, "quickstart"} == set(cli.commands)
    for name, command in cli.commands.items():
        assert "as_json" in [parameter.name for parameter in command.params], name


@pytest.mark.parametrize(("name", "given"), COMMANDS.items(), ids=COMMANDS)
@pytest.mark.usefixtures("here", "undrawn")
def test_one_object_on_standard_output(
    name: str, given: tuple[list[str], set[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, keys = given
    assert status([name, *arguments, "--json"]) == 0
    text = capsys.readouterr().out
    assert len(text.splitlines()) == 1
    found = json.loads(text)
    assert keys <= found.keys()
    if name != "experiment":
        assert keys == found.keys()
    for file in (*found.get("files", ()), *([found["out"]] if "out" in found else ())):
        assert Path(file).exists()


# --- seconds --------------------------------------------------------------------------------------


class Slow:
    """Takes half a second the first time, as what is compiled or loaded does."""

    ready = False

    def route(self, problem: Problem) -> Solution:
        if not Slow.ready:
            time.sleep(0.5)
            Slow.ready = True
        return marouting.sequential_astar(problem)


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(Slow, "ready", False)
    return f"{__name__}:Slow"


@pytest.mark.usefixtures("here")
def test_seconds_are_those_of_routing(slow: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["route", "p.gr", "--router", slow, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["seconds"] < 0.25


@pytest.mark.usefixtures("here", "at_once", "undrawn")
def test_seconds_of_an_experiment_are_those_of_routing(slow: str, tmp_path: Path) -> None:
    changes = [f"routers.slow.router={slow}", f"out={tmp_path / 'out'}"]
    Experiment(load_experiment("e.yaml", changes)).execute()
    rows = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [row["seconds"] < 0.25 for row in rows] == [True] * 4


class Waits:
    """Takes as long as it is told."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def route(self, problem: Problem) -> Solution:
        time.sleep(self.seconds)
        return marouting.sequential_astar(problem)


@pytest.mark.usefixtures("here")
def test_a_route_that_takes_long_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("policies.cli.progress._QUIET", 0.1)
    for seconds, said in (("0.3", "routing, for 0.3 s at most ..."), ("0", "")):
        router = f"{__name__}:Waits"
        assert status(["route", "p.gr", "--router", router, f"seconds={seconds}"]) == 0
        found = capsys.readouterr().err
        assert found == (f"{router}: {said}\n" if said else "")


class Patient:
    """Would never end; somebody sends a signal."""

    watch: Callable[[str], bool] | None = None
    sent = signal.SIGINT

    def route(self, problem: Problem) -> Solution:
        if self.watch is None:  # to be ready
            return marouting.sequential_astar(problem)
        assert not self.watch("one of many")
        signal.raise_signal(self.sent)
        while not self.watch("two of many"):
            time.sleep(0.01)
        return marouting.sequential_astar(problem)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("sent", ENDING)
def test_a_signal_ends_a_route_with_the_best_so_far(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, sent: signal.Signals
) -> None:
    monkeypatch.setattr("policies.cli.progress._OFTEN", 0.0)
    monkeypatch.setattr(Patient, "sent", sent)
    router = f"{__name__}:Patient"
    # As in a terminal: a test run in the background inherits that Ctrl-C is ignored.
    usual = signal.default_int_handler if sent == signal.SIGINT else signal.SIG_DFL
    inherited = signal.signal(sent, usual)
    ended = pytest.raises(SystemExit) if sent != signal.SIGINT else contextlib.nullcontext()
    try:
        with ended as left:
            assert status(["route", "p.gr", "--router", router, "--out", "best", "--json"]) == 0
        assert signal.getsignal(sent) is usual
    finally:
        signal.signal(sent, inherited)
    if left is not None:
        assert left.value.code == 128 + sent
    shown = capsys.readouterr()
    assert json.loads(shown.out)["router"] == router
    lines = shown.err.splitlines()
    assert lines[0] == f"{router}: one of many"
    assert lines[1] == "stopping with the best solution so far; a second signal discards it"
    assert Path("best").exists()


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("route p.gr --out p.gr", "p.gr: expected another file: this one is read"),
        ("convert p.gr ./p.gr", "p.gr: expected another file: this one is read"),
        ("convert p.gr s --solution s", "s: expected another file: this one is read"),
        ("evaluate p.gr s --map p.gr", "p.gr: expected another file: this one is read"),
        ("evaluate p.gr s --control keep=k --map k", "k: expected another file: this one is read"),
        ("route p.gr --config k --out k", "k: expected another file: this one is read"),
        (
            "route p.gr --router dqn --checkpoint k --out k",
            "k: expected another file: this one is read",
        ),
        (
            "route p.gr --out new/../p.gr",
            "new/../p.gr: expected another file: this one is read",
        ),
        (
            "view p.gr s --out v.png --frames 5",
            "--frames: expected an animation, --out FILE.svg or FILE.gif",
        ),
        (
            "view p.gr s --out v.html --turn-order sequential",
            "--turn-order: expected an animation, --out FILE.svg or FILE.gif",
        ),
        ("view p.gr s --out s", "s: expected another file: this one is read"),
        ("view p.gr s --out p.gr", "p.gr: expected another file: this one is read"),
        ("route p.gr --out s.segs", "s.segs: expected another suffix: .segs is not written"),
        ("convert p.gr p.def", "p.def: expected another suffix: .def is not written"),
        ("convert p.gr p.CAP.gz", "p.CAP.gz: expected another suffix: .cap is not written"),
        ("convert p.gr p.guide", "p.guide: expected another suffix: .guide is for solutions"),
        (
            "evaluate p.gr s --control layers=1 --control layers=2",
            "--control layers: expected one value, found it twice",
        ),
        (
            "evaluate p.gr s --control derate.1=0.5 --control derate={2: 0.5}",
            "--control derate: expected one value, found derate and derate.1",
        ),
    ],
)
def test_files_that_are_read_and_formats_that_are_only_read_are_not_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    problem = marouting.generate(1, grid=(4, 4, 2), nets=3, seed=1)[0]
    problem.write("p.gr")
    before = Path("p.gr").read_bytes()
    for name in ("s", "k"):
        marouting.sequential_astar(problem).write(name)
    words = re.findall(r"\S*\{.*?\}|\S+", command)
    assert status(words) == 2
    assert capsys.readouterr().err == f"marouting: {says}\n"
    assert Path("p.gr").read_bytes() == before
    assert sorted(path.name for path in Path().iterdir()) == ["k", "p.gr", "s"]


class Killed(Patient):
    """Is killed where others would go on, once it has found something."""

    def best(self) -> Solution | None:
        return None if self.found is None else marouting.sequential_astar(self.found)

    found: Problem | None = None

    def route(self, problem: Problem) -> Solution:
        if self.watch is not None:
            assert not self.watch("nothing yet")
            assert not Path("kept").exists()
            self.found = problem
            assert not self.watch("one of many")
            raise SystemExit(9)
        return marouting.sequential_astar(problem)


@pytest.mark.usefixtures("here")
def test_the_best_so_far_is_written_while_others_are_looked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("policies.cli.progress.SAVED_EVERY", 0.0)
    with pytest.raises(SystemExit):
        status(["route", "p.gr", "--router", f"{__name__}:Killed", "--out", "kept"])
    kept = Solution.read("kept", Problem.read("p.gr"))
    assert kept == marouting.sequential_astar(Problem.read("p.gr"))
    assert status(["route", "p.gr", "--router", "pathfinder", "start=kept", "--json"]) == 0
    routed = json.loads(capsys.readouterr().out)
    known = marouting.evaluate(kept.problem, kept)
    assert (routed["overflow"], routed["wirelength"]) <= (known.overflow, known.wirelength)


def train_once(words: Sequence[str]) -> None:
    """Trains the run that is resumed, if one is and there is none yet."""
    if "--resume" in words and not Path("t").exists():
        assert status(["train", *COMMANDS["train"][0]]) == 0


# --- completion -----------------------------------------------------------------------------------


def completed(*words: str) -> list[str]:
    """What a shell offers for the last of these words."""
    shell = ShellComplete(cli, {}, "marouting", "_MAROUTING_COMPLETE")
    return [item.value for item in shell.get_completions(list(words[:-1]), words[-1])]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("tr",), ["train"]),
        (("train", "configs/paper/default.yaml", "train.ep"), ["train.episodes="]),
        (("train", "configs/generalist.yaml", "learner.re"), ["learner.reuse=", "learner.regret="]),
        (("train", "none.yaml", "se"), ["seed="]),
        (("train", "--resume", "t", "train.th"), ["train.threads="]),
        (("experiment", "e.yaml", "routers.astar.b"), ["routers.astar.best_of="]),
        (("experiment", "none.yaml", "ro"), ["routers="]),
        (("config", "e.yaml", "problems.small.n"), ["problems.small.nets="]),
        (("benchmark", "--config", "configs/benchmark/baselines.yaml", "bu"), ["budget="]),
        (("benchmark", "--scenario", "mi"), ["mixed-v0"]),
        (("benchmark", "--router", "op"), ["optimal"]),
        (("route", "p.gr", "--router", "pa"), ["pathfinder"]),
        (("route", "p.gr", "net"), ["net_order="]),
        (("route", "p.gr", "--router", "optimal", "b"), ["bound="]),
        (("route", "p.gr", "--router", "ppo", "learner.cr"), ["learner.critic="]),
        (("route", "p.gr", "--router", "none", "x"), []),
    ],
    ids=" ".join,
)
@pytest.mark.usefixtures("here")
def test_shells_complete_keys_and_names(words: tuple[str, ...], offered: list[str]) -> None:
    train_once(words)
    assert completed(*words) == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_get_their_script(shell: str) -> None:
    given = {**os.environ, "_MAROUTING_COMPLETE": f"{shell}_source"}
    code = "from policies.cli.main import main; main()"
    program = [sys.executable, "-c", code]
    done = subprocess.run(program, env=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "_MAROUTING_COMPLETE" in done.stdout


# --- messages -------------------------------------------------------------------------------------

SAID: dict[str, tuple[list[str], str]] = {
    "a union": (
        ["route", "p.gr", "net_order=x"],
        "net_order: expected one of half_perimeter, half_perimeter_up, file, random, found 'x'",
    ),
    "a problem": (
        ["train", "configs/multi.yaml", "env.problem=3"],
        "env.problem: expected a text, a list, a mapping or null, found 3",
    ),
    "a short list": (
        ["train", "configs/multi.yaml", "env.problem.grid=[8, 8]"],
        "env.problem.grid: expected 3 values, found 2",
    ),
    "a mapping": (["train", "configs/multi.yaml", "train=3"], "train: expected a mapping, found 3"),
    "a scenario": (["benchmark", "--scenario", "x"], "online-8x8-v0, "),
    "a command": (["rout"], "unknown name 'rout'; did you mean route? expected one of bench"),
    "an old command": (["animate"], "marouting animate: it is now marouting view … --out FILE.svg"),
    "an old option": (
        ["route", "p.gr", "--seed", "1"],
        "route --seed: it is now seed=N",
    ),
    "fewer episodes": (
        ["train", "--resume", "t", "train.episodes=1"],
        "train.episodes: expected 2, as in t/config.yaml, or more, found 1",
    ),
}


@pytest.mark.parametrize(("arguments", "said"), SAID.values(), ids=SAID)
@pytest.mark.usefixtures("here")
def test_messages_name_every_choice(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    train_once(arguments)
    capsys.readouterr()
    assert status(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "literal[" not in error
    assert len(error.splitlines()) == 1


@pytest.mark.usefixtures("here")
def test_resume_takes_keys_without_a_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    trained = [*COMMANDS["train"][0], "out=longer", "learner.epsilon_final=0"]
    assert status(["train", *trained]) == 0
    capsys.readouterr()
    assert status(["train", "--resume", "longer", "train.episodes=3", "--json"]) == 0
    found = capsys.readouterr()
    assert json.loads(found.out)["episodes"] == 3
    assert "longer: train.episodes was 2, now 3" in found.err
    assert "learner.epsilon_final now refers to the longer training" in found.err


def test_warnings_are_a_line(folder: Path) -> None:
    text = (folder / "p.solution").read_text()
    name, number, count = text.split("\n")[0].split()
    wrong = text.replace(
        f"{name} {number} {count}", f"{name} {int(number) + 7} {int(count) + 1}", 1
    )
    (folder / "wrong.solution").write_text(wrong)
    command = [sys.executable, "-m", "marouting", "evaluate", "p.gr", "wrong.solution", "--json"]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    first, second = ended.stderr.splitlines()
    assert first.startswith(
        f"marouting: warning: wrong.solution:1: net {name}: expected id {number}"
    )
    assert second.startswith(f"marouting: warning: wrong.solution:1: net {name}: expected ")
    assert json.loads(ended.stdout)["connected"]


@pytest.mark.parametrize(
    ("module", "hint"),
    [
        ("stable_baselines3", ": pip install 'marouting[sb3]'"),
        ("benchmarl", ": pip install 'marouting[benchmarl]'"),
        ("ray", ": pip install 'marouting[rllib]'"),
        ("torch", ": pip install 'marouting[learn]'"),
        ("someone_elses", ""),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_has_it(
    module: str,
    hint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / f"imports_{module}.py").write_text(f"import {module}.parts\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    words = ["route", "toy-4x4-v0/0", "--router", f"imports_{module}:Router"]
    assert status(words) == 2
    named = rf"marouting: {module}(\.parts)? is missing{re.escape(hint)}\n"
    assert re.fullmatch(named, capsys.readouterr().err)
