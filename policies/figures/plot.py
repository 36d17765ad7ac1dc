"""Writes the figures of a run, of an experiment, or of problem and solution files.

What the folders look like on disk is known to :mod:`policies.results`.
"""

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from marouting import InputError, Problem, Solution
from marouting.files import exists, is_dir, reading, stem_of, suffix_of
from marouting.registry import allowing_code
from marouting.yaml_files import read_yaml
from policies import figures
from policies.results import run_folder
from policies.results.rows import RESULTS, Row, read_rows
from policies.results.run_folder import read_rewards
from policies.results.statistics import (
    baseline,
    by_router,
    by_set,
    mean_over_seeds,
)
from policies.routers.astar import AStarRouter
from policies.routers.registry import by_label, router_label, router_names


def reward_figures(metrics: Path, folder: Path) -> list[Path]:
    """Writes the reward curves of a ``metrics.jsonl``, plain and log; raises InputError."""
    curves = read_rewards(metrics)
    longest = max(map(len, curves.values()))
    count = f"{len(curves)} problems" if len(curves) > 1 else "1 problem"
    title = f"Rewards of the training {metrics.absolute().parent.name}: {count}, {longest} episodes"
    written = []
    for name, log in (("reward.png", False), ("reward_log.png", True)):
        figures.save(figures.reward_curves(curves, log=log, title=title), folder / name)
        written.append(folder / name)
    return written


def problem_figures(
    problem: Problem, solutions: Mapping[str, Solution], folder: str | os.PathLike[str]
) -> list[Path]:
    """Writes the figures of a problem's solutions, by the router's name, as PNG; returns the files.

    For each router ``ROUTER_heat_maps.png``, ``ROUTER_histogram.png``, ``ROUTER_edges.png``,
    ``ROUTER_solution_2d.png`` and ``ROUTER_solution_3d.png``; for two routers or more
    ``comparison.png``.
    """
    draw = {
        "heat_maps": figures.heat_maps,
        "histogram": figures.utilisation_histogram,
        "edges": figures.edges_before_after,
        "solution_2d": figures.solution_2d,
        "solution_3d": figures.solution_3d,
    }
    written: list[Path] = []

    def write(figure: Figure, stem: str) -> None:
        path = Path(folder) / f"{stem}.png"
        figures.save(figure, path)
        written.append(path)

    stems: set[str] = set()
    for name, solution in solutions.items():
        stem = base = re.sub(r"[^\w.-]+", "_", name).strip("._") or "router"
        while stem in stems:
            stem = f"{base}_{len(stems)}"
        stems.add(stem)
        for kind, figure in draw.items():
            write(figure(problem, solution, router_label(name)), f"{stem}_{kind}")
    if len(solutions) > 1:
        write(figures.comparison(by_label(solutions)), "comparison")
    return written


def run_figures(
    run: Path, folder: Path | None = None, rows: Sequence[Row] | None = None
) -> list[Path]:
    """Writes all figures of a run folder, by default into its ``figures``; returns the files.

    Of a training that is not finished only the rewards are drawn.

    Raises:
        InputError: a finished training lacks a problem or a solution, or a file cannot be used.
    """
    folder = run / "figures" if folder is None else folder
    if rows is None:
        finished = (run / run_folder.RESULT).exists()
        rows = run_folder.read_result(run) if finished else []
    files = {row["problem"]: run / "problems" / f"{row['problem']}.gr" for row in rows}
    problems = {name: Problem.read(files[name]) for name in sorted(files)}
    solutions: dict[str, dict[str, Solution]] = {name: {} for name in problems}
    for row in rows:
        name, router = row["problem"], row["router"]
        file = run_folder.solution_file(run, name, router)
        solutions[name][router] = Solution.read(file, problems[name])
    written = reward_figures(run / run_folder.METRICS, folder)
    for name, problem in problems.items():
        written += problem_figures(problem, solutions[name], _of(folder, files[name]))
    return written


def experiment_figures(experiment: Path, folder: Path | None = None) -> list[Path]:
    """Writes the figures of an experiment, by default into its ``figures``; returns the files.

    For each set, and for ``all`` if there are several: ``SET_gap.png``, the gap to the optimum, or
    where none is known ``SET_wirelength.png``, problem by problem; ``SET_overflow.png``; and, where
    A* is one of several routers, ``SET_decrease.png``. In the experiment's own folder, those of an
    earlier state that there are none of now are removed.
    """
    own, folder = folder is None, experiment / "figures" if folder is None else folder
    written: list[Path] = []

    def write(figure: Figure, name: str) -> None:
        figures.save(figure, folder / f"{name}.png")
        written.append(folder / f"{name}.png")

    results = read_rows(experiment / RESULTS)
    called = read_labels(experiment / run_folder.CONFIG)
    for name, rows in by_set(results).items():
        astar = baseline(rows)
        # A* first: this gives it the paper's colour.
        routers = sorted(by_router(rows).items(), key=lambda router: router[0] != astar)
        lengths, gaps, over = (
            {called.get(router, router): mean_over_seeds(rows, column) for router, rows in routers}
            for column in ("wirelength", "gap", "overflow")
        )
        first = next(iter(lengths))
        order = np.argsort(lengths[first], kind="stable")
        title, by = f"{name}: {len(order)} problems", f"{first}'s wirelength"
        if not all(np.isnan(values).all() for values in gaps.values()):
            write(figures.gaps_by_router(gaps, title), f"{name}_gap")
        else:
            figure = figures.by_problem(lengths, order, "wirelength [edges]", by, title)
            write(figure, f"{name}_wirelength")
        figure = figures.by_problem(over, order, "overflow [tracks]", by, title)
        write(figure, f"{name}_overflow")
        decreases = {
            router: lengths[first] - values
            for router, values in lengths.items()
            if router != first and astar is not None
        }
        # One of them may join what the other leaves open.
        if not all(np.isnan(values).all() for values in decreases.values()):
            figure = figures.decrease_histogram(decreases, first, title)
            write(figure, f"{name}_decrease")
        for kind in ("gap", "wirelength", "decrease"):
            file = folder / f"{name}_{kind}.png"
            if own and file not in written:
                file.unlink(missing_ok=True)
    return written


def read_labels(config: Path) -> dict[str, str]:
    """What figures call the entries of an experiment's configuration.

    That is an entry's own label, or what its kind of router is called if it is the only one of its
    kind or bears its name; any other is called by its name. Labels that two share have the names
    beside them.
    """
    with allowing_code():  # nothing is imported for labels
        routers = read_yaml(config).get("routers")
    entries = {
        str(name): entry
        for name, entry in (routers.items() if isinstance(routers, Mapping) else ())
        if isinstance(entry, Mapping)
    }
    kinds = Counter(str(entry.get("router")) for entry in entries.values())
    called = {}
    for name, entry in entries.items():
        kind = str(entry.get("router"))
        ours = kind in router_names() and (kind == name or kinds[kind] == 1)
        called[name] = str(entry.get("label") or (router_label(kind) if ours else name))
    alike = Counter(called.values())
    return {
        name: f"{label} ({name})" if alike[label] > 1 else label for name, label in called.items()
    }


def plot(paths: Sequence[str | os.PathLike[str]], out: Path | None = None) -> list[Path]:
    """Draws folders and files, each in the way that suits it.

    Args:
        paths: folders of runs and experiments; ``metrics.jsonl`` files; problems in any format,
            each drawn with the solution files that follow it, or with sequential A*'s solution if
            none follows.
        out: the folder for the figures, in which those of problems, and of each of several folders
            or ``metrics.jsonl``, are in a folder of its name; None stands for ``figures`` in a
            folder that is drawn, or beside a file that is drawn.

    Returns:
        The pictures written.

    Raises:
        InputError: a path is none of these, or a file cannot be used.
    """
    written: list[Path] = []
    groups: list[tuple[Path, list[Path]]] = []
    own: set[Path] = set()

    def alone(folder: Path) -> Path:
        """A folder that no other of the paths has."""
        found, number = folder, 1
        while found in own:
            number += 1
            found = folder.with_name(f"{folder.name}_{number}")
        own.add(found)
        return found

    runs = [path for path in map(Path, paths) if is_dir(path) or suffix_of(path) == ".jsonl"]
    for path in map(Path, paths):
        into = out
        if out is not None and path in runs and len(runs) > 1:
            into = alone(out / (path if is_dir(path) else path.parent).resolve().name)
        if is_dir(path):
            if (path / RESULTS).exists():
                written += experiment_figures(path, into)
            elif (path / run_folder.CONFIG).exists():
                written += run_figures(path, into)
            else:
                raise InputError(
                    f"{path}: expected a run folder, with {run_folder.CONFIG} in it, or an "
                    f"experiment's, with {RESULTS}"
                )
        elif not exists(path):
            raise InputError(f"{path}: expected a folder or a file, found nothing")
        elif suffix_of(path) == ".jsonl":
            written += reward_figures(path, into or path.parent / "figures")
        elif _is_problem(path):
            groups.append((path, []))
        elif groups:
            groups[-1][1].append(path)
        else:
            raise InputError(f"{path}: expected a problem before a solution of it")
    for path, files in groups:
        problem = Problem.read(path)
        solutions = {
            name: Solution.read(file, problem)
            for name, file in run_folder.solutions_by_name(files, stem_of(path)).items()
        }
        solutions = solutions or {"astar": AStarRouter().route(problem)}
        folder = alone(_of(out or path.parent / "figures", path))
        written += problem_figures(problem, solutions, folder)
    return written


def _is_problem(path: Path) -> bool:
    """Whether a file is a problem, by its name or because it begins with the size of the grid."""
    if suffix_of(path) in (".gr", ".def", ".cap"):
        return True
    with reading(path) as file:
        return file.read(256).split()[:1] == [b"grid"]


def _of(folder: Path, problem: Path) -> Path:
    """The folder for the figures of a problem; raises InputError if none can be called after it."""
    stem = stem_of(problem)
    if stem in (".", ".."):
        raise InputError(f"{problem}: expected another name: figures go to a folder of this name")
    return folder / stem
