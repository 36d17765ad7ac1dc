"""The figures of a run, of an experiment, or of problem and solution files."""

import json
import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution
from marouting.files import unusable
from policies import figures
from policies.experiment import (
    CONFIG,
    RESULTS,
    Study,
    StudyColumn,
    label,
    load_experiment,
    problem_file,
    read_results,
    solution_file,
)
from policies.results.statistics import (
    Row,
    baseline,
    by_router,
    by_set,
    joined_wirelength,
    overflow,
)
from policies.routers.astar import AStarRouter


def read_rewards(metrics: Path) -> dict[str, list[float]]:
    """The reward of every episode in a ``metrics.jsonl``, by problem; raises InputError."""
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
    return curves


def reward_figures(metrics: Path, folder: Path) -> list[Path]:
    """Writes the reward curves of a ``metrics.jsonl``, plain and log; raises InputError."""
    curves = read_rewards(metrics)
    written = []
    for name, log in (("reward.png", False), ("reward_log.png", True)):
        figures.save(figures.reward_curves(curves, log=log), folder / name)
        written.append(folder / name)
    return written


def problem_figures(
    problem: Problem, solutions: Mapping[str, Solution], folder: str | os.PathLike[str]
) -> list[Path]:
    """Writes the figures of one problem and its solutions as PNG.

    Args:
        problem: what was routed.
        solutions: the solutions by router's name.
        folder: where to; made when missing.

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
            write(figure(problem, solution, name), f"{stem}_{kind}")
    if len(solutions) > 1:
        write(figures.comparison(solutions), "comparison")
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
        written += problem_figures(problem, solutions, folder / path.stem)
    return written


def experiment_figures(experiment: Path, folder: Path | None = None) -> list[Path]:
    """Writes the figures of an experiment's sets, as a rule into its ``figures/``.

    Returns:
        For each set, and of several for ``all``: ``SET_wirelength.png`` and ``SET_overflow.png``,
        problem by problem, and where A* is one of several routers ``SET_decrease.png``; for each
        study ``STUDY.png``.

    Raises:
        InputError: there are no results, a file that a study shows is missing, or the folder cannot
            be written to.
    """
    folder = experiment / "figures" if folder is None else folder
    written: list[Path] = []

    def write(figure: Figure, name: str) -> None:
        figures.save(figure, folder / f"{name}.png")
        written.append(folder / f"{name}.png")

    results = read_results(experiment)
    for name, rows in by_set(results).items():
        astar = baseline(rows)
        # A* first: it has the paper's colour then.
        routers = dict(sorted(by_router(rows).items(), key=lambda router: router[0] != astar))
        lengths = {router: joined_wirelength(own) for router, own in routers.items()}
        sort_by = astar or next(iter(routers))
        order = np.argsort(lengths[sort_by], kind="stable")
        title = f"{name}: {len(order)} problems"
        by = f"{sort_by}'s wirelength"
        # What joins nothing has no figures to look at.
        shown = {router: values for router, values in lengths.items() if not np.isnan(values).all()}
        if not shown:
            continue
        for quantity, unit, values in (
            ("wirelength", "edges", shown),
            ("overflow", "tracks", {router: overflow(routers[router]) for router in shown}),
        ):
            figure = figures.by_problem(values, order, f"{quantity} [{unit}]", by, title)
            write(figure, f"{name}_{quantity}")
        decreases = {
            router: lengths[astar] - values
            for router, values in shown.items()
            if astar is not None and router != astar
        }
        if astar is not None and decreases:
            write(figures.decrease_histogram(decreases, astar, title), f"{name}_decrease")
    config = load_experiment(experiment / CONFIG)
    for name, study in config.studies.items():
        found = {
            title: _column(experiment, results, study, column, config.reference)
            for title, column in study.columns.items()
        }
        if columns := {title: column for title, column in found.items() if column}:
            write(figures.study(columns, study.panels), name)
    return written


CURVES = 10
"""How many problems' rewards a composed figure shows (paper)."""


def _column(
    experiment: Path,
    results: Sequence[Row],
    study: Study,
    column: StudyColumn,
    reference: str | None,
) -> figures.ColumnData | None:
    """What a column of a composed figure shows; None where its router or A* is not done.

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
    # The paper's legend says what routes; a router's name tells apart what would be the same.
    first = next(iter(own.values()))[0]
    alike = {column.router, first["kind"]} & {astar, reference}
    title = column.router if alike else first["kind"]
    shown = {astar: routers[astar], title: own}
    if reference in routers:
        shown[reference] = routers[reference]
    chosen = column.problem or next(iter(own))[1]
    problem = Problem.read(problem_file(experiment, name, chosen))

    def solution(router: str) -> Solution:
        seed = routers[router][name, chosen][0]["seed"]
        return Solution.read(solution_file(experiment, name, chosen, router, seed), problem)

    def rewards(router: str, seed: int) -> dict[str, list[float]]:
        runs = experiment / "runs" / name / label(router, seed)
        found: dict[str, list[float]] = {}
        for metrics in sorted(runs.glob("*/metrics.jsonl")):
            found |= read_rewards(metrics)
        if not found:
            raise InputError(f"{runs}: expected folders of trainings, with metrics.jsonl")
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
                seeds = [row["seed"] for row in next(iter(routers[router].values()))]
                curves = [curve for seed in seeds for curve in rewards(router, seed).values()]
                means[router] = np.mean(curves, axis=0)
    return figures.ColumnData(
        problem,
        solution(astar),
        solution(column.router),
        {router: joined_wirelength(rows) for router, rows in shown.items()},
        {router: overflow(rows) for router, rows in shown.items()},
        some,
        means,
    )


def growth_figure(bench: Path, folder: Path) -> Path:
    """Draws how time grows with the size of problems, as ``marouting bench`` stored it.

    Raises:
        InputError: the file cannot be read, or holds no such measurement.
    """
    from policies.bench import scaling

    try:
        report = json.loads(bench.read_text(encoding="utf-8"))
        figure = scaling.draw(report["growth"], f"measured {report['machine']['date']}")
    except OSError as error:
        raise unusable(bench, "cannot be read", error) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(
            f"{bench}: expected what marouting bench --out stores, with the section growth"
        ) from None
    path = folder / "growth.png"
    figures.save(figure, path)
    return path


def plot(paths: Sequence[str | os.PathLike[str]], out: Path | None = None) -> list[Path]:
    """Draws what it is given.

    Args:
        paths: folders of runs and experiments; ``metrics.jsonl`` files; what ``marouting bench``
            stored; ``.gr`` files, each drawn with the solution files that follow it, or with
            sequential A*'s solution where none follows.
        out: folder for the figures; None: ``figures`` in a folder, beside a file otherwise.

    Returns:
        The pictures written.

    Raises:
        InputError: a path is none of these, or cannot be used.
    """
    written: list[Path] = []
    groups: list[tuple[Path, list[Path]]] = []
    for path in map(Path, paths):
        if path.is_dir():
            if (path / RESULTS).exists():
                written += experiment_figures(path, out)
            elif (path / "config.yaml").exists():
                written += run_figures(path, out)
            else:
                raise InputError(
                    f"{path}: expected a run folder, with a config.yaml in it, or an "
                    f"experiment's, with {RESULTS}"
                )
        elif not path.exists():
            raise InputError(f"{path}: expected a folder or a file, found nothing")
        elif path.suffix == ".jsonl":
            written += reward_figures(path, out or path.parent / "figures")
        elif path.suffix == ".json":
            written.append(growth_figure(path, out or path.parent / "figures"))
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
        written += problem_figures(problem, solutions, folder)
    return written


def _router(file: Path, problem: Path) -> str:
    """What to call a solution: its file name without the problem's and the endings."""
    name = file.name.removeprefix(problem.stem).removesuffix(".solution").strip(".")
    return name or file.stem
