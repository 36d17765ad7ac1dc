"""``marouting view``: a page with a problem and its solutions."""

import re
from pathlib import Path

import click

from marouting import InputError, Solution
from marouting.files import check_writable, is_dir, stem_of, suffix_of, write_text
from policies.cli.options import FILE, json_option, tell
from policies.cli.source import ProblemFile, problem_argument
from policies.results.run_folder import solution_name
from policies.routers.registry import labelled


@click.command()
@problem_argument
@click.argument("solutions", nargs=-1, required=True, type=FILE, metavar="SOLUTION...")
@click.option("--out", type=FILE, required=True, help="HTML file for the page.")
@json_option
def view(problem: ProblemFile, solutions: tuple[Path, ...], out: Path, as_json: bool) -> None:
    """Make a page with the routes of PROBLEM in 3-D and heat maps of its congestion.

    The page is one file that any browser shows without a network. SOLUTION is a solution file, a
    folder of them (taken in the order of their names), or the run folder of a training. Two
    solutions are shown side by side; of more, a slider shows one after the other beside the first.
    """
    from policies.figures.view import page

    loaded = problem.read()
    found: dict[str, Solution] = {}
    for file in (file for path in solutions for file in _files(path, problem.path)):
        name = base = solution_name(file, problem.stem)
        while name in found:
            name = f"{base} ({len(found) + 1})"
        found[name] = Solution.read(file, loaded)
    check_writable(out)
    write_text(out, page(loaded, labelled(found), problem.stem))
    text = f"{len(found)} solution{'s' if len(found) > 1 else ''} in {out}"
    tell(as_json, text, out=out, solutions=list(found))


def _files(path: Path, problem: Path) -> list[Path]:
    """The solution files that a path stands for; raises InputError if there are none."""
    if not is_dir(path):
        return [path]
    inside = path / "solutions"
    stem, run = stem_of(problem), inside.is_dir()
    path = inside if run else path
    files = [file for file in path.glob("*") if suffix_of(file) == ".solution"]
    if run:  # perhaps with other problems
        files = [file for file in files if file.name.startswith(f"{stem}.")]
    if not files:
        raise InputError(f"{path}: expected files of solutions of {stem}, named *.solution")
    return sorted(files, key=_natural)


def _natural(file: Path) -> list[tuple[int, str]]:
    """Names in the order of the numbers in them: round9 before round10."""
    parts = re.split(r"([0-9]+)", file.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
