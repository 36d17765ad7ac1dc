"""The folder of an experiment on disk: the names of its files, and reading them.

================================  ==============================================================
config.yaml                       the whole configuration, defaults included
problems/SET/NAME.gr              the problems
rows/SET/ROUTER[.seedN]/*.json    the rows of finished work, part by part
runs/SET/ROUTER[.seedN]/*/        the run folders of trainings
solutions/SET/NAME.ROUTER[.seedN].solution
results.json, results.csv         all rows (:mod:`policies.results.rows`)
summary.json                      their statistics (:mod:`policies.results.statistics`)
figures/                          the paper's figures
================================  ==============================================================
"""

from pathlib import Path

from policies.results.rows import Row, read_rows

CONFIG, RESULTS, SUMMARY = "config.yaml", "results.json", "summary.json"


def label(router: str, seed: int | None) -> str:
    """A router's name with the seed, as file names carry it."""
    return router if seed is None else f"{router}.seed{seed}"


def problem_file(folder: Path, set: str, problem: str) -> Path:
    """The file of a problem."""
    return folder / "problems" / set / f"{problem}.gr"


def solution_file(folder: Path, set: str, problem: str, router: str, seed: int | None) -> Path:
    """The file of a router's solution of a problem."""
    return folder / "solutions" / set / f"{problem}.{label(router, seed)}.solution"


def rows_file(folder: Path, set: str, router: str, seed: int | None, first: str) -> Path:
    """The file with the rows of one part of the work, named after its first problem."""
    return folder / "rows" / set / label(router, seed) / f"{first}.json"


def runs_folder(folder: Path, set: str, router: str, seed: int | None) -> Path:
    """The folder that holds the run folders of a router's trainings on a set."""
    return folder / "runs" / set / label(router, seed)


def read_results(folder: Path) -> list[Row]:
    """The rows of all routers that are finished; raises InputError if there are none."""
    return read_rows(folder / RESULTS)
