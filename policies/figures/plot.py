"""Writes the figures of a run, of an experiment, of a benchmark, or of problem and solution files.

What the folders look like on disk is known to :mod:`policies.results`.
"""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution
from marouting.files import exists, is_dir, reading, stem_of, suffix_of
from policies import figures
from policies.results import experiment_folder, run_folder
from policies.results.rows import Row
from policies.results.run_folder import read_rewards
from policies.results.scaling import read_scaling
from policies.results.statistics import (
    baseline,
    by_router,
    by_set,
    mean_overflow,
    mean_wirelength,
    open_wirelength,
)
from policies.results.study import FigureOptions, Study, StudyColumn
from policies.routers.astar import AStarRouter
from policies.routers.registry import labelled, router_label


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
    """Writes the figures of a problem and its solutions as PNG.

    Args:
        problem: the problem.
        solutions: its solutions by the router's name.
        folder: the folder for the figures; it is made if it does not exist.

    Returns:
        The files: for each router ``ROUTER_heat_maps.png``, ``ROUTER_histogram.png``,
        ``ROUTER_edges.png``, ``ROUTER_solution_2d.png`` and ``ROUTER_solution_3d.png``; for two
        routers or more ``comparison.png``.

    Raises:
        InputError: the folder cannot be written to, or a solution belongs to another problem.
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
        write(figures.comparison(labelled(solutions)), "comparison")
    return written


def run_figures(
    run: Path, folder: Path | None = None, rows: Sequence[Row] | None = None
) -> list[Path]:
    """Writes all figures of a run folder.

    Args:
        run: the run folder; of a training that is not finished, only the rewards are drawn.
        folder: the folder for the figures; None stands for ``figures`` in the run folder.
        rows: those of ``result.json``; None to read them there.

    Returns:
        The pictures written.

    Raises:
        InputError: a file cannot be used, or the folder cannot be written to.
    """
    folder = run / "figures" if folder is None else folder
    written = reward_figures(run / run_folder.METRICS, folder)
    if rows is None:
        finished = (run / run_folder.RESULT).exists()
        rows = run_folder.read_result(run) if finished else []
    for path in sorted((run / "problems").glob("*.gr")):
        problem = Problem.read(path)
        solutions = {
            row["router"]: Solution.read(file, problem)
            for row in rows
            if row["problem"] == path.stem
            and (file := run_folder.solution_file(run, path.stem, row["router"])).exists()
        }
        written += problem_figures(problem, solutions, _of(folder, path))
    return written


def experiment_figures(experiment: Path, folder: Path | None = None) -> list[Path]:
    """Writes the figures of an experiment.

    Args:
        experiment: the experiment's folder.
        folder: the folder for the figures; None stands for ``figures`` in the experiment's.

    Returns:
        The pictures written. For each set, and for ``all`` if there are several:
        ``SET_wirelength.png`` and ``SET_overflow.png``, problem by problem, and, where A* is one of
        several routers, ``SET_decrease.png``; for each study ``STUDY.png``.

    Raises:
        InputError: there are no results, a file that a study shows is missing, or the folder cannot
            be written to.
    """
    folder = experiment / "figures" if folder is None else folder
    written: list[Path] = []

    def write(figure: Figure, name: str) -> None:
        figures.save(figure, folder / f"{name}.png")
        written.append(folder / f"{name}.png")

    results = experiment_folder.read_results(experiment)
    options = FigureOptions.read(experiment / experiment_folder.CONFIG)
    for name, rows in by_set(results).items():
        astar = baseline(rows)
        # A* first: this gives it the paper's colour.
        routers = dict(sorted(by_router(rows).items(), key=lambda router: router[0] != astar))
        lengths = {router: mean_wirelength(own) for router, own in routers.items()}
        sort_by = astar or next(iter(routers))
        order = np.argsort(lengths[sort_by], kind="stable")
        title = f"{name}: {len(order)} problems"
        by = f"{options.label(sort_by)}'s wirelength"
        for quantity, unit, (whole, opened) in (
            ("wirelength", "edges", _wirelengths(routers, options)),
            ("overflow", "tracks", _overflows(routers, options)),
        ):
            figure = figures.by_problem(whole, order, f"{quantity} [{unit}]", by, title, opened)
            write(figure, f"{name}_{quantity}")
        if astar is None:
            continue
        decreases = {
            options.label(router): lengths[astar] - values
            for router, values in lengths.items()
            if router != astar
        }
        # One of them may join what the other leaves open.
        if not all(np.isnan(values).all() for values in decreases.values()):
            figure = figures.decrease_histogram(decreases, options.label(astar), title)
            write(figure, f"{name}_decrease")
    for name, study in options.studies.items():
        found = {
            title: _column(experiment, results, study, column, options)
            for title, column in study.columns.items()
        }
        if columns := {title: column for title, column in found.items() if column}:
            write(figures.study(columns, study.panels), name)
    return written


_Values = dict[str, NDArray[np.float64]]
"""(problems,) values by the router's label."""


def _wirelengths(
    routers: Mapping[str, Mapping[tuple[str, str], list[Row]]], options: FigureOptions
) -> tuple[_Values, _Values]:
    """Mean wirelength where all tasks were joined, and where some stayed open; NaN elsewhere."""
    whole = {options.label(router): mean_wirelength(rows) for router, rows in routers.items()}
    opened = {options.label(router): open_wirelength(rows) for router, rows in routers.items()}
    return whole, opened


def _overflows(
    routers: Mapping[str, Mapping[tuple[str, str], list[Row]]], options: FigureOptions
) -> tuple[_Values, _Values]:
    """Mean overflow, likewise."""
    whole, opened = _wirelengths(routers, options)
    every = {options.label(router): mean_overflow(rows) for router, rows in routers.items()}
    return (
        {name: np.where(np.isnan(whole[name]), np.nan, every[name]) for name in every},
        {name: np.where(np.isnan(opened[name]), np.nan, every[name]) for name in every},
    )


CURVES = 10
"""How many problems a composed figure shows the rewards of (paper)."""


def _column(
    experiment: Path,
    results: Sequence[Row],
    study: Study,
    column: StudyColumn,
    options: FigureOptions,
) -> figures.ColumnData | None:
    """What a column of a composed figure shows; None if its router or A* is not finished.

    Raises:
        InputError: a file is missing.
    """
    own_sets = [row["set"] for row in results if row["router"] == column.router]
    name = column.set or next(iter(own_sets), None)
    rows = [row for row in results if row["set"] == name]
    routers = by_router(rows)
    astar = baseline(rows)
    if name is None or astar is None or column.router not in routers:
        return None
    own = routers[column.router]
    first = next(rows for rows in own.values() if rows)[0]
    shown = {router: routers[router] for router in (astar, column.router)}
    if options.reference in routers:
        shown[options.reference] = routers[options.reference]
    chosen = column.problem or first["problem"]
    problem = Problem.read(experiment_folder.problem_file(experiment, name, chosen))

    def solution(router: str) -> Solution:
        if not routers[router].get((name, chosen)):
            raise InputError(f"{experiment}: expected a row of {router} on {name}, {chosen}")
        seed = routers[router][name, chosen][0]["seed"]
        file = experiment_folder.solution_file(experiment, name, chosen, router, seed)
        return Solution.read(file, problem)

    def rewards(router: str, seed: int) -> dict[str, list[float]]:
        runs = experiment_folder.runs_folder(experiment, name, router, seed)
        found: dict[str, list[float]] = {}
        for metrics in sorted(runs.glob(f"*/{run_folder.METRICS}")):
            found |= read_rewards(metrics)
        if not found:
            raise InputError(f"{runs}: expected run folders, with {run_folder.METRICS} in them")
        return found

    some: dict[str, list[float]] = {}
    if "reward" in study.panels:
        every = rewards(column.router, first["seed"])
        chance = np.random.default_rng(0).permutation(sorted(every))[:CURVES]
        some = {problem: every[problem] for problem in sorted(chance.tolist())}
    means: dict[str, NDArray[np.float64]] = {}
    if "mean_reward" in study.panels:
        for router in (column.router, *column.beside):
            if router in routers:
                seeds = dict.fromkeys(row["seed"] for of in routers[router].values() for row in of)
                curves = [curve for seed in seeds for curve in rewards(router, seed).values()]
                # One of them may be of a training that is not finished.
                common = min(map(len, curves))
                means[options.label(router)] = np.mean([c[:common] for c in curves], axis=0)
    lengths, open_lengths = _wirelengths(shown, options)
    overflow, open_overflow = _overflows(shown, options)
    return figures.ColumnData(
        problem,
        solution(astar),
        solution(column.router),
        lengths,
        overflow,
        some,
        means,
        open_lengths,
        open_overflow,
    )


def scaling_figure(bench: Path, folder: Path) -> Path:
    """Draws how time grows with the size of problems, as ``marouting bench`` measured it.

    Args:
        bench: the JSON file that ``marouting bench scaling --out`` wrote.
        folder: the folder for ``scaling.png``.

    Raises:
        InputError: the file cannot be read, or lacks the section ``scaling``.
    """
    report = read_scaling(bench)
    figure = figures.scaling(report["scaling"], f"measured {report['machine']['date']}")
    path = folder / "scaling.png"
    figures.save(figure, path)
    return path


def plot(paths: Sequence[str | os.PathLike[str]], out: Path | None = None) -> list[Path]:
    """Draws folders and files, each in the way that suits it.

    Args:
        paths: folders of runs and experiments; ``metrics.jsonl`` files; files that ``marouting
            bench`` wrote; problems in any format, each drawn with the solution files that follow
            it, or with sequential A*'s solution if none follows.
        out: the folder for the figures; None stands for ``figures`` in a folder that is drawn, or
            beside a file that is drawn.

    Returns:
        The pictures written.

    Raises:
        InputError: a path is none of these, or a file cannot be used.
    """
    written: list[Path] = []
    groups: list[tuple[Path, list[Path]]] = []
    for path in map(Path, paths):
        if is_dir(path):
            if (path / experiment_folder.RESULTS).exists():
                written += experiment_figures(path, out)
            elif (path / run_folder.CONFIG).exists():
                written += run_figures(path, out)
            else:
                raise InputError(
                    f"{path}: expected a run folder, with {run_folder.CONFIG} in it, or an "
                    f"experiment's, with {experiment_folder.RESULTS}"
                )
        elif not exists(path):
            raise InputError(f"{path}: expected a folder or a file, found nothing")
        elif suffix_of(path) == ".jsonl":
            written += reward_figures(path, out or path.parent / "figures")
        elif suffix_of(path) == ".json":
            written.append(scaling_figure(path, out or path.parent / "figures"))
        elif _is_problem(path):
            groups.append((path, []))
        elif groups:
            groups[-1][1].append(path)
        else:
            raise InputError(f"{path}: expected a problem before a solution of it")
    for path, files in groups:
        problem = Problem.read(path)
        solutions = {
            run_folder.solution_name(file, stem_of(path)): Solution.read(file, problem)
            for file in files
        }
        solutions = solutions or {"astar": AStarRouter().route(problem)}
        folder = _of(out or path.parent / "figures", path)
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
        raise InputError(f"{problem}: expected another name: figures would leave their folder")
    return folder / stem
