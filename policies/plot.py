"""The figures of a run folder, or of problem and solution files."""

import json
import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from marouting import InputError, Problem, Solution
from marouting.files import unusable
from policies import figures
from policies.classical.astar import AStarRouter


def reward_figures(metrics: Path, folder: Path) -> list[Path]:
    """Writes the reward curves of a ``metrics.jsonl``, plain and log; raises InputError."""
    curves: dict[str, list[float]] = defaultdict(list)
    try:
        for number, line in enumerate(metrics.read_text(encoding="utf-8").splitlines(), 1):
            try:
                entry: Any = json.loads(line)
                curves[str(entry["problem"])].append(float(entry["reward"]))
            except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
                raise InputError(
                    f"{metrics}:{number}: expected an episode with problem and reward"
                ) from None
    except OSError as error:
        raise unusable(metrics, "cannot be read", error) from None
    except UnicodeDecodeError:
        raise InputError(f"{metrics}: expected UTF-8 text") from None
    if not curves:
        raise InputError(f"{metrics}: expected at least one episode")
    written = []
    for name, log in (("reward.png", False), ("reward_log.png", True)):
        figures.save(figures.reward_curves(curves, log=log), folder / name)
        written.append(folder / name)
    return written


def run_figures(run: Path, folder: Path | None = None) -> list[Path]:
    """Writes all figures of a run folder, as a rule into its ``figures/``; raises InputError."""
    folder = run / "figures" if folder is None else folder
    written = reward_figures(run / "metrics.jsonl", folder)
    for path in sorted((run / "problems").glob("*.gr")):
        problem = Problem.read(path)
        solutions = {
            router: Solution.read(file, problem)
            for router in ("astar", "dqn")
            if (file := run / "solutions" / f"{path.stem}.{router}.solution").exists()
        }
        written += figures.problem_figures(problem, solutions, folder / path.stem)
    return written


def plot(paths: Sequence[str | os.PathLike[str]], out: Path | None = None) -> list[Path]:
    """Draws what it is given.

    Args:
        paths: run folders; ``metrics.jsonl`` files; ``.gr`` files, each drawn with the solution
            files that follow it, or with sequential A*'s solution where none follows.
        out: folder for the figures; None: ``figures`` in a run folder, beside a file otherwise.

    Returns:
        The pictures written.

    Raises:
        InputError: a path is none of these, or cannot be used.
    """
    written: list[Path] = []
    groups: list[tuple[Path, list[Path]]] = []
    for path in map(Path, paths):
        if path.is_dir():
            if not (path / "config.yaml").exists():
                raise InputError(f"{path}: expected a run folder, with a config.yaml in it")
            written += run_figures(path, out)
        elif not path.exists():
            raise InputError(f"{path}: expected a run folder or a file, found nothing")
        elif path.suffix == ".jsonl":
            written += reward_figures(path, out or path.parent / "figures")
        elif path.suffix == ".gr":
            groups.append((path, []))
        elif groups:
            groups[-1][1].append(path)
        else:
            raise InputError(f"{path}: expected a .gr file before a solution of it")
    for path, files in groups:
        problem = Problem.read(path)
        solutions = {_router(file, path): Solution.read(file, problem) for file in files}
        solutions = solutions or {"astar": AStarRouter().route(problem)}
        folder = (out or path.parent / "figures") / path.stem
        written += figures.problem_figures(problem, solutions, folder)
    return written


def _router(file: Path, problem: Path) -> str:
    """What to call a solution: its file name without the problem's and the endings."""
    name = file.name.removeprefix(problem.stem).removesuffix(".solution").strip(".")
    return name or file.stem
