"""Files, configurations, checkpoints and folders with accidents in them: sane, or refused.

``python tests/fuzz.py`` reads a few inputs of every kind and prints how many were accepted,
``--slow`` very many, ``KIND [FIRST [COUNT]]`` those of one kind from a seed on. A seed is all it
takes to see an input again. Whatever takes longer than :data:`LONGEST` seconds ends the process, as
compiled code that crashes does: the seed at work is in ``seed.txt`` of the folder.
"""

import argparse
import contextlib
import csv
import faulthandler
import functools
import json
import math
import os
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import torch
import yaml
from conftest import in_this_process
from matplotlib.figure import Figure
from mutations import MODEST, NASTY, in_archive, in_data, in_state, in_text, saved
from reference import plain_evaluation
from test_bad_files import GR
from test_benchmark import made
from test_experiment import everything
from test_ispd import CONTEST
from test_ispd98 import FLAT, LAYERED, said
from test_ispd2024 import CAP, NET, ROUTES
from test_lefdef import BLOCKED, DEF, LEF, RULES, SPECIAL
from test_openroad_segments import FILES as ISPD2025
from test_openroad_segments import as_segments
from test_rows import DRAWN, READ
from test_run import config_in

from marouting import InputError, Net, Pin, Problem, Solution, errors, evaluate, sequential_astar
from marouting.config import build, plain
from marouting.problem.contest import contest_cost
from marouting.problem.ispd import Format
from marouting.yaml_files import override, read_yaml
from policies import figures
from policies.experiment import Experiment, ExperimentConfig, experiment, load_experiment
from policies.experiment.leaderboard import read_groups
from policies.experiment.result import summarise
from policies.figures.plot import plot
from policies.learned.config import Config, config_of, load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run
from policies.results.rows import Row, read_rows

LONGEST = 30
"""Seconds that an input may take; most take a thousandth."""

CONFIGS = Path(__file__).resolve().parents[1] / "configs"


class Refused(Exception):
    """An input is refused, as it should be; the message is of the InputError."""


# --- problems and solutions -----------------------------------------------------------------------

OFFSET = GR.replace("0 0 10 10", "-30 50 3 7").replace("5 5 1\n25 15 1", "-30 50 1\n-22 63 2")
OFFSET = OFFSET.replace("15 5 1", "-27 56 1")
PROBLEMS: dict[Format, tuple[str, ...]] = {
    "ispd2008": (GR, OFFSET, CONTEST),
    "ispd98": (LAYERED,),
    "ispd98-flat": (FLAT,),
}


def any_problem(rng: Random) -> Problem:
    """A problem of any numbers that are right."""
    grid = rng.randint(1, 5), rng.randint(1, 5), rng.randint(1, 3)
    (x, y), (width, height) = rng.choices(range(-30, 30), k=2), rng.choices(range(1, 13), k=2)

    def layers() -> tuple[int, ...]:
        return tuple(rng.choices(range(10), k=grid[2]))

    def any_width() -> int | tuple[int, ...]:
        return rng.choice((rng.randrange(10), layers()))

    def pin() -> Pin:
        left, low = rng.randrange(grid[0] * width), rng.randrange(grid[1] * height)
        return Pin(x + left, y + low, rng.randint(1, grid[2]))

    nets = [
        Net(f"{rng.choice('n(1é!&')}{i}", rng.randrange(10**9), tuple(pins), any_width())
        for i in range(rng.randint(1, 5))
        if (pins := [pin() for _ in range(rng.randint(1, 4))])
    ]
    about = layers(), layers(), tuple(nets), layers(), layers(), layers()
    return Problem(grid, *about, origin=(x, y), tile=(width, height))


def problems(rng: Random, folder: Path, format: Format) -> None:
    """What is accepted is written and read back equal, and can be routed."""
    file = folder / "p.gr"
    if rng.random() < 0.5:
        file.write_text(rng.choice(PROBLEMS[format]))
    else:
        said(any_problem(rng), format).write(file, format)
    file.write_bytes(in_text(rng, file.read_bytes()))
    problem = Problem.read(file)
    problem.write(file)
    assert Problem.read(file) == problem
    if math.prod(problem.grid) <= 500:
        try:
            solution = sequential_astar(problem)
        except InputError as error:
            raise Refused(str(error)) from None  # of a problem in memory, not of a file
        assert evaluate(problem, solution) == plain_evaluation(solution)


def sane_problem(problem: Problem, file: Path) -> None:
    """A problem from another format is written as text and read back equal."""
    problem.write(file)
    assert Problem.read(file) == problem


def designs(rng: Random, folder: Path) -> None:
    """A LEF/DEF design that is accepted is a problem."""
    sections = f"{SPECIAL}{BLOCKED}{RULES['def']}"
    text = {
        "chip.lef": LEF.replace("END LIBRARY", f"{RULES['lef']}END LIBRARY"),
        "chip.def": DEF.replace("NETS 2", f"{sections}NETS 2").replace(
            "( u1 Z )", "( u1 Z ) + NONDEFAULTRULE wide + USE CLOCK"
        ),
    }
    spoiled = rng.choice(("chip.lef", "chip.def", "chip.def"))
    for name, content in text.items():
        own = content.encode()
        (folder / name).write_bytes(in_text(rng, own) if name == spoiled else own)
    sane_problem(Problem.read(folder / "chip.def"), folder / "p.gr")


def contests(rng: Random, folder: Path, files: tuple[str, str, str]) -> None:
    """A problem of ISPD 2024 or 2025 that is accepted is one, and routes of it have a cost."""
    text = dict(zip(("p.cap", "p.net", "p.PR_output"), files, strict=True))
    spoiled = rng.choice(list(text))
    for name, content in text.items():
        own = content.encode()
        (folder / name).write_bytes(in_text(rng, own) if name == spoiled else own)
    problem = Problem.read(folder / "p.cap")
    sane_problem(problem, folder / "p.gr")
    solution = Solution.read(folder / "p.PR_output", problem)
    assert 0 <= contest_cost(solution).total < math.inf
    assert evaluate(problem, solution) == plain_evaluation(solution)


def guides(rng: Random, folder: Path) -> None:
    """A guide that is accepted has routes inside it, which are written and read back."""
    problem = any_problem(rng)
    existing = np.flatnonzero(problem.topology.exists).tolist()
    some = [rng.choices(existing, k=rng.randint(0, 20)) if existing else [] for _ in problem.nets]
    file = folder / "p.guide"
    Solution(problem, [np.array(edges, np.int64) for edges in some]).write(file)
    file.write_bytes(in_text(rng, file.read_bytes()))
    solution = Solution.read(file, problem)
    assert evaluate(problem, solution) == plain_evaluation(solution)
    solution.write(file)
    joined = evaluate(problem, Solution.read(file, problem)).joined
    assert joined >= evaluate(problem, solution).joined


def segments(rng: Random, folder: Path) -> None:
    """OpenROAD's segments that are accepted are routes, which are written and read back."""
    problem = any_problem(rng)
    existing = np.flatnonzero(problem.topology.exists).tolist()
    some = [rng.choices(existing, k=rng.randint(0, 20)) if existing else [] for _ in problem.nets]
    solution, file = Solution(problem, [np.array(own, np.int64) for own in some]), folder / "p.segs"
    text = as_segments(solution, rng.randrange(13))
    file.write_bytes(in_text(rng, text.encode()))
    read = Solution.read(file, problem)
    assert evaluate(problem, read) == plain_evaluation(read)
    read.write(folder / "p.solution")
    assert Solution.read(folder / "p.solution", problem) == read


def compressed(rng: Random, folder: Path) -> None:
    """Compressed data that are accepted are those that were compressed: they hold a checksum."""
    file, problem = folder / "p.gr.gz", any_problem(rng)
    problem.write(file)
    content = bytearray(file.read_bytes())
    for _ in range(rng.randint(0, 3)):
        at = rng.randrange(len(content))
        how = rng.random()
        if how < 0.2:
            del content[at:]
        elif how < 0.6:
            content[at] ^= 1 << rng.randrange(8)
        else:
            content[at:at] = rng.randbytes(rng.randint(1, 9))
        content = content or bytearray(b"\0")
    file.write_bytes(content)
    assert Problem.read(file) == problem


def solutions(rng: Random, folder: Path) -> None:
    """What is accepted is written and read back equal, and judged as by the plain definitions."""
    problem, file = any_problem(rng), folder / "p.solution"
    existing = np.flatnonzero(problem.topology.exists).tolist()
    some = [rng.choices(existing, k=rng.randint(0, 20)) if existing else [] for _ in problem.nets]
    Solution(problem, [np.array(edges, np.int64) for edges in some]).write(file)
    file.write_bytes(in_text(rng, file.read_bytes()))
    solution = Solution.read(file, problem)
    assert evaluate(problem, solution) == plain_evaluation(solution)
    solution.write(file)
    assert Solution.read(file, problem) == solution


# --- configurations -------------------------------------------------------------------------------


@functools.cache
def shipped(trainings: bool) -> list[dict[str, Any]]:
    """The configurations of the package, of trainings or of experiments."""
    raw = [read_yaml(path) for path in sorted(CONFIGS.rglob("*.yaml"))]
    return [own for own in raw if ("env" if trainings else "routers") in own]


def in_yaml(rng: Random, raw: dict[str, Any], values: Sequence[Any] = (*NASTY, *MODEST)) -> bytes:
    """YAML with accidents to its values, its text or both."""
    how = rng.random()
    data = in_data(rng, raw, values) if how < 0.8 else raw
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=rng.random() < 0.5)
    content = text.encode(errors="surrogatepass")
    return in_text(rng, content) if how > 0.6 else content


def trainings(rng: Random, folder: Path) -> None:
    """A configuration that is accepted is written in full and read back equal."""
    file = folder / "c.yaml"
    file.write_bytes(in_yaml(rng, rng.choice(shipped(True))))
    config = load_config(file)
    file.write_text(yaml.safe_dump(plain(config), sort_keys=False))
    assert load_config(file) == config


def experiments(rng: Random, folder: Path) -> None:
    """As trainings; problems are looked at when they are loaded, and may still be NaN."""
    file = folder / "c.yaml"
    file.write_bytes(in_yaml(rng, rng.choice(shipped(False))))
    config = load_experiment(file)
    assert repr(build(ExperimentConfig, plain(config))) == repr(config)


def overrides(rng: Random, _: Path) -> None:
    """What is accepted on the command line is what it says in a file."""
    flat = list(_keys(read_yaml(CONFIGS / "paper" / "default.yaml")))
    given = []
    for _ in range(rng.choice((1, 1, 2, 3))):
        key, value = rng.choice(flat)
        new = rng.choice((value, rng.choice(MODEST)))
        text = yaml.safe_dump(new, default_flow_style=True).strip()
        one = f"{key}={text.removesuffix('...').strip()}".encode()
        given.append((in_text(rng, one) if rng.random() < 0.4 else one).decode(errors="ignore"))
    try:
        config = load_config(None, given)
    except InputError as error:
        raise Refused(str(error)) from None
    assert config_of(override({}, given)) == config
    assert build(Config, plain(config)) == config


def _keys(raw: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in raw.items():
        yield prefix + key, value
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")


# --- trainings ------------------------------------------------------------------------------------

LEARNERS: dict[str, dict[str, Any]] = {
    "dqn": {"burn_in_size": 50, "buffer_size": 100},
    "dqn, all switches": {
        "burn_in_size": 50,
        "buffer_size": 100,
        "masking": True,
        "double": True,
        "network": {"hidden": [8], "dueling": True},
    },
    "dqn, shared": {"burn_in_size": 50, "buffer_size": 100, "shared": True},
    "ppo": {"kind": "ppo"},
    "ppo, central": {"kind": "ppo", "critic": "central", "shared": True},
}


class Stop(Exception):
    """Ends a training in its middle."""


@functools.cache
def started(learner: str, agents: str) -> Path:
    """The folder of a training that was stopped half-way, with a checkpoint."""
    folder = Path(tempfile.mkdtemp()) / "run"
    config = config_in(folder, 6, agents=agents, checkpoint_seconds=0, **LEARNERS[learner])
    seen = 0

    def watch(episodes: Sequence[Any]) -> None:
        nonlocal seen
        seen += len(episodes)
        if seen >= 8:
            raise Stop

    try:
        Run(config).execute(watch)
    except Stop:
        return folder
    raise AssertionError("expected more episodes")


@functools.cache
def ended(learner: str, agents: str) -> Path:
    """The folder of the same training, at its end."""
    folder = Path(tempfile.mkdtemp()) / "run"
    shutil.copytree(started(learner, agents), folder)
    Run(replace(load_config(folder / "config.yaml"), out=str(folder)), resume=True).execute()
    return folder


@functools.cache
def loaded(path: Path) -> Any:
    """What is in a checkpoint."""
    return torch.load(path, weights_only=True)


def resumed(folder: Path) -> None:
    """Goes on with a training, to results that can be."""
    config = replace(load_config(folder / "config.yaml"), out=str(folder))
    run = Run(config, resume=True)
    if not too_long(config, run.problems):
        trained(run)


def trained(run: Run) -> None:
    """Trains to the end; the results are those of the solutions."""
    rows = run.execute()
    assert len(rows) == 3 * len(run.problems)
    kept = {path.name for path in run.folder.iterdir()}
    assert kept >= {"config.yaml", "metrics.jsonl", "result.json", "policy.pt", "checkpoint.pt"}
    for row in rows:
        problem = run.problems[row["problem"]]
        router = row["router"].replace(":", "-")
        file = run.folder / "solutions" / f"{row['problem']}.{router}.solution"
        figures = vars(plain_evaluation(Solution.read(file, problem)))
        assert {key: row[key] for key in row.keys() & figures.keys()} == {
            key: value for key, value in figures.items() if key != "disconnected"
        }


def checkpoints(rng: Random, folder: Path) -> None:
    """A training goes on from it."""
    origin = started(rng.choice(list(LEARNERS)), rng.choice(("single", "multi")))
    shutil.copytree(origin, folder, dirs_exist_ok=True)
    (folder / "checkpoint.pt").write_bytes(in_checkpoint(rng, origin / "checkpoint.pt"))
    resumed(folder)


def policies(rng: Random, folder: Path) -> None:
    """A policy file, or a checkpoint in its place, routes a problem."""
    origin = ended(rng.choice(list(LEARNERS)), rng.choice(("single", "multi")))
    file = folder / "policy.pt"
    file.write_bytes(in_checkpoint(rng, origin / rng.choice(("policy.pt", "checkpoint.pt"))))
    problem = Problem.read(origin / "problems" / "problem_000.gr")
    policy = TrainedPolicy.load(file, "problem_000")
    try:
        solution = policy.solve(problem).solution
    except InputError as error:
        raise Refused(str(error)) from None  # of the game that it asks for; names the key
    assert evaluate(problem, solution) == plain_evaluation(solution)


def in_checkpoint(rng: Random, path: Path) -> bytes:
    """A checkpoint with accidents to its values, to an entry of its archive, or to its bytes."""
    how = rng.random()
    if how < 0.8:
        return saved(in_state(rng, loaded(path)))
    return in_archive(rng, path.read_bytes()) if how < 0.95 else in_text(rng, path.read_bytes())


def too_long(config: Config, problems: Mapping[str, Problem]) -> bool:
    """Whether a training is right, and more than a test can do."""
    train, options = config.train, plain(config.learner)
    sizes = [options.get(key) or 0 for key in ("burn_in_size", "buffer_size", "rollout", "epochs")]
    tasks = sum(len(net.pins) for problem in problems.values() for net in problem.nets)
    return max(20 * train.episodes, tasks, *sizes) > 2000


def started_anew(rng: Random, folder: Path) -> None:
    """A training by a configuration of numbers near those that are usual."""
    learner, agents = rng.choice(list(LEARNERS)), rng.choice(("single", "multi"))
    raw = plain(config_in(folder / "run", 2, agents=agents, **LEARNERS[learner]))
    (folder / "c.yaml").write_text(yaml.safe_dump(in_data(rng, raw, MODEST)))
    config = replace(load_config(folder / "c.yaml"), out=str(folder / "run"))
    config = replace(config, train=replace(config.train, figures=False, tensorboard=False))
    if too_long(config, {}):
        return
    try:
        run = Run(config)
        if not too_long(config, run.problems):
            trained(run)
    except InputError as error:
        raise Refused(str(error)) from None  # of what the keys name


def run_folders(rng: Random, folder: Path) -> None:
    """One of its files is damaged, gone, or a folder; the training goes on, or all is drawn."""
    learner, agents = rng.choice(list(LEARNERS)), rng.choice(("single", "multi"))
    finished = rng.random() < 0.4
    origin = (ended if finished else started)(learner, agents)
    shutil.copytree(origin, folder, dirs_exist_ok=True)
    damage(rng, folder)
    figures.save = undrawn
    if finished and rng.random() < 0.5:
        assert plot([folder])
    else:
        resumed(folder)


def damage(rng: Random, folder: Path) -> None:
    """Spoils a file in a folder, or two."""
    for _ in range(rng.choice((1, 1, 2))):
        file = rng.choice([path for path in sorted(folder.rglob("*")) if path.is_file()])
        content, how = file.read_bytes(), rng.random()
        if how < 0.15:
            file.unlink()
            if how < 0.05:
                file.mkdir()
        elif how < 0.2:
            file.rename(file.with_name(rng.choice(("p.gr", "５.gr", "config.yaml", "x"))))
        elif file.suffix in SPOIL and how < 0.8:
            with contextlib.suppress(yaml.YAMLError, ValueError, TypeError):  # damaged before
                file.write_bytes(SPOIL[file.suffix](rng, content))
        else:
            file.write_bytes(in_text(rng, content))


def in_lines(rng: Random, content: bytes) -> bytes:
    """Lines of JSON with accidents in one of them."""
    lines = content.splitlines()
    at = rng.randrange(len(lines))
    lines[at] = in_json(rng, json.loads(lines[at]))
    return b"\n".join(lines) + b"\n"


def in_json(rng: Random, data: Any) -> bytes:
    """JSON with accidents to its values, or to its text."""
    if rng.random() < 0.7:
        data = in_data(rng, data)
    content = json.dumps(data, ensure_ascii=rng.random() < 0.8).encode(errors="surrogatepass")
    return in_text(rng, content) if rng.random() < 0.3 else content


SPOIL: dict[str, Callable[[Random, bytes], bytes]] = {
    ".yaml": lambda rng, content: in_yaml(rng, yaml.safe_load(content), MODEST),
    ".json": lambda rng, content: in_json(rng, json.loads(content)),
    ".jsonl": in_lines,
}


# --- results and experiments ----------------------------------------------------------------------


def rows(rng: Random, folder: Path, kind: str, kinds: dict[str, Any]) -> None:
    """A file of results, with accidents to its values or its text, is read or drawn."""
    name, data, as_text, read = kinds[kind]
    how = rng.random()
    data = in_data(rng, data) if how < 0.8 else data
    try:
        content = as_text(data).encode(errors="surrogatepass")
    except (TypeError, AttributeError):  # a table of something else
        content = json.dumps(data).encode()
    (folder / name).write_bytes(in_text(rng, content) if how > 0.6 else content)
    figures.save = drawn if kinds is DRAWN else undrawn
    read(folder / name)


def drawn(figure: Figure, _: Path) -> None:
    """Draws a figure and does not write it."""
    figure.draw_without_rendering()


def undrawn(*_: object) -> None:
    """In folders, what is drawn is enough; drawing takes most of the time."""


@functools.cache
def compared() -> Path:
    """The folder of an experiment that is finished, beside the configuration and a table."""
    folder = Path(tempfile.mkdtemp())
    Experiment(load_experiment(everything(folder))).execute()
    return folder


def experiment_folders(rng: Random, folder: Path) -> None:
    """Files are damaged or gone; the same command goes on, or all is drawn once more."""
    shutil.copytree(compared(), folder, dirs_exist_ok=True)
    out = folder / "out"
    if rng.random() < 0.5:  # broken off
        for path in rng.sample(sorted((out / "rows").rglob("*.json")), 2):
            path.unlink()
    damage(rng, out if rng.random() < 0.9 else folder)
    figures.save = undrawn
    if rng.random() < 0.3:
        assert plot([out])
        return
    # The published rows are found in the folder that the copy is of.
    config = load_experiment(folder / "all.yaml", [f"out={out}"])
    summary = Experiment(config).execute()
    found = read_rows(out / "results.json")
    assert {row["router"] for row in found} == set(config.routers)
    with (out / "results.csv").open(newline="") as file:
        assert len(list(csv.reader(file))) == len(found) + 1
    assert sane(summary)
    assert all(map(possible, found))


def benchmarks(rng: Random, folder: Path) -> None:
    """A result file of a benchmark is read as the leaderboard reads it."""
    (folder / "result.json").write_bytes(in_json(rng, asdict(made())))
    ((result,),) = read_groups(folder).values()
    assert sane(summarise(result))


def sane(value: Any) -> bool:
    """Whether plain data has only finite numbers."""
    if isinstance(value, dict):
        return all(map(sane, value.values()))
    if isinstance(value, list | tuple):
        return all(map(sane, value))
    return not isinstance(value, float) or math.isfinite(value)


def possible(row: Row) -> bool:
    """Whether a row can be that of a solution."""
    return 0 <= (row["joined"] or 0) <= (row["tasks"] or 0) and row["wirelength"] >= 0


# --- all of them ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """A kind of input: what reads one, and how many of them in the short and the long run.

    What :attr:`prepare` does first, inputs need not do in their time.
    """

    read: Callable[[Random, Path], None]
    short: int
    long: int
    prepare: Callable[[], object] = int


def all_trained() -> None:
    """Runs and compiles what the inputs with trainings start from: the clock is not for that."""
    for learner in LEARNERS:
        for agents in ("single", "multi"):
            ended(learner, agents)


KINDS: dict[str, Kind] = {
    **{
        f"problem, {format}": Kind(functools.partial(problems, format=format), 25, 20_000)
        for format in PROBLEMS
    },
    "problem, LEF/DEF": Kind(designs, 25, 5_000),
    **{
        f"problem, {contest}": Kind(functools.partial(contests, files=files), 25, 5_000)
        for contest, files in (("ispd2024", (CAP, NET, ROUTES)), ("ispd2025", ISPD2025))
    },
    "problem, compressed": Kind(compressed, 25, 5_000),
    "solution": Kind(solutions, 25, 20_000),
    "guide": Kind(guides, 25, 5_000),
    "segments": Kind(segments, 25, 5_000),
    "configuration of a training": Kind(trainings, 8, 10_000),
    "configuration of an experiment": Kind(experiments, 10, 4_000),
    "overrides": Kind(overrides, 15, 10_000),
    **{
        f"rows of {kind}": Kind(functools.partial(rows, kind=kind, kinds=READ), 30, 5_000)
        for kind in READ
    },
    **{
        f"figures of {kind}": Kind(functools.partial(rows, kind=kind, kinds=DRAWN), 10, 200)
        for kind in DRAWN
    },
    "checkpoint": Kind(checkpoints, 8, 3_000, all_trained),
    "policy": Kind(policies, 10, 2_000, all_trained),
    "training": Kind(started_anew, 6, 2_000, all_trained),
    "run folder": Kind(run_folders, 6, 1_000, all_trained),
    "result of a benchmark": Kind(benchmarks, 30, 5_000),
    "experiment folder": Kind(experiment_folders, 4, 200, compared),
}


@dataclass
class Count:
    """What became of the inputs of a kind."""

    kind: str
    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    failed: int = 0
    seconds: float = 0.0


def reads(name: str, seed: int, work: Path) -> bool:
    """Whether an input is accepted; what refuses it is one line that names the file or the key."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of edges listed twice, or turned
        try:
            KINDS[name].read(Random(f"{name} {seed}"), work)
        except (InputError, Refused) as error:
            message, named = str(error), isinstance(error, Refused)
        else:
            return True
    assert message.isprintable(), ascii(message)
    assert 0 < len(message) <= errors.LONGEST, message
    assert named or str(work) in message, message
    return False


def read_all(name: str, seeds: Sequence[int], folder: Path) -> Count:
    """Reads inputs of a kind; what fails is said on standard error."""
    KINDS[name].prepare()
    count, started_at = Count(name), time.perf_counter()
    for seed in seeds:
        (folder / "seed.txt").write_text(f"{name!r} {seed}\n")
        work = folder / "work"
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        count.inputs += 1
        try:
            if reads(name, seed, work):
                count.accepted += 1
            else:
                count.refused += 1
        except Exception as error:
            count.failed += 1
            text = "".join(traceback.format_exception(error, limit=-5))
            print(f"--- {name!r} {seed}\n{text}", file=sys.stderr)
        finally:
            faulthandler.cancel_dump_traceback_later()
    count.seconds = time.perf_counter() - started_at
    return count


def main(arguments: Sequence[str] | None = None) -> int:
    """Reads inputs and prints what became of them; the number of those that failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", choices=KINDS, help="without it, all")
    parser.add_argument("first", nargs="?", type=int, default=0, help="seed")
    parser.add_argument("count", nargs="?", type=int, help="how many seeds")
    parser.add_argument("--slow", action="store_true", help="many of each kind")
    parser.add_argument("--folder", type=Path, help="where to work")
    given = parser.parse_args(arguments)
    os.environ.setdefault("MAROUTING_MAX_GIB", "1")
    torch.set_num_threads(1)
    experiment.work_on = in_this_process  # type: ignore[attr-defined]
    folder = given.folder or Path(tempfile.mkdtemp())
    failed = 0
    print(f"{'inputs':>8}{'accepted':>10}{'refused':>9}{'failed':>8}{'seconds':>9}  kind")
    for name in [given.kind] if given.kind else KINDS:
        many = given.count or (KINDS[name].long if given.slow else KINDS[name].short)
        c = read_all(name, range(given.first, given.first + many), folder)
        print(
            f"{c.inputs:8}{c.accepted:10}{c.refused:9}{c.failed:8}{c.seconds:9.1f}  {name}",
            flush=True,
        )
        failed += c.failed
    return min(failed, 100)


if __name__ == "__main__":
    sys.exit(main())
