"""``marouting view``: a page, an animation or a picture of solutions."""

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from marouting import InputError, Problem, ProblemFile, Solution, evaluate, sequential_astar
from marouting.config import check
from marouting.files import check_apart, check_writable, is_dir, stem_of, suffix_of, write_text
from marouting.rules import TurnOrder
from policies.cli.options import FILE, TRAINED, allow_code_option, json_option, print_result
from policies.cli.source import problem_argument
from policies.results.run_folder import solutions_by_name
from policies.routers.registry import by_label, router_label

if TYPE_CHECKING:
    from marouting.render import Scene

PAGE, MOVING = ".html", (".svg", ".gif")
FRAMES = 240
"""The most frames of an animation, unless told otherwise."""


@click.command()
@problem_argument
@click.argument("solutions", nargs=-1, type=FILE, metavar="[SOLUTION]...")
@click.option(
    "--out",
    type=FILE,
    required=True,
    help="File to write. Its suffix selects a page (.html), an animation (.svg, .gif) or a "
    "picture (.png, .pdf).",
)
@click.option(
    "--checkpoint",
    type=TRAINED,
    help="File of a trained policy, which routes PROBLEM in the animation; without it, SOLUTION is "
    "replayed.",
)
@click.option(
    "--turn-order",
    type=click.Choice(get_args(TurnOrder)),
    help="Order of the nets in an animation: one after the other, or one move each in turn.  "
    "[default: sequential, or as the policy was trained]",
)
@click.option(
    "--frames",
    type=int,
    help=f"The most frames of an animation.  [default: {FRAMES}]",
)
@allow_code_option
@json_option
def view(
    problem: ProblemFile,
    solutions: tuple[Path, ...],
    out: Path,
    checkpoint: Path | None,
    turn_order: TurnOrder | None,
    frames: int | None,
    as_json: bool,
) -> None:
    """Show solutions of PROBLEM: a page with routes in 3-D, an animation, or a picture.

    SOLUTION is a solution file, a folder of them (taken in the order of their names), or the run
    folder of a training; without one, sequential A* routes PROBLEM. A page is one file that any
    browser shows offline. Two solutions appear side by side; with more, a slider selects the one
    next to the first. An animation replays one solution, move by move.
    """
    from policies import figures
    from policies.cli.progress import working
    from policies.figures.animation import record, replay, save_animation
    from policies.figures.style import is_picture
    from policies.figures.view import page

    kind = suffix_of(out)
    if solutions and checkpoint:
        raise InputError("view: expected only one of SOLUTION and --checkpoint")
    moving = {"--checkpoint": checkpoint, "--turn-order": turn_order, "--frames": frames}
    for option, value in moving.items():
        if value is not None and kind not in MOVING:
            raise InputError(f"{option}: expected an animation, --out FILE.svg or FILE.gif")
    frames = FRAMES if frames is None else frames
    check("--frames", frames >= 2, f"a number from 2, found {frames}")
    if checkpoint is not None and turn_order is not None:
        raise InputError("--turn-order: expected none with --checkpoint: the policy has its own")
    check_apart(out, *problem.files, *solutions, *([checkpoint] if checkpoint else []))
    if kind not in (PAGE, *MOVING) and not is_picture(out):
        kinds = ".html (a page), .svg, .gif (an animation), .png or .pdf (a picture)"
        raise InputError(f"{out}: expected a name with the suffix {kinds}")
    loaded = problem.read()
    check_writable(out)
    found = {} if checkpoint else _solutions(problem, loaded, solutions)
    if kind not in MOVING:
        if kind == PAGE:
            write_text(out, page(loaded, by_label(found), problem.stem))
        else:
            figures.save(figures.comparison(by_label(found)), out)
        text = f"{len(found)} solution{'s' if len(found) > 1 else ''} in {out}"
        print_result(as_json, text, out=out, solutions=list(found))
        return
    if checkpoint is None:
        if len(found) > 1:
            raise InputError(f"{out}: expected one SOLUTION to animate, found {len(found)}")
        ((name, routes),) = found.items()
        what = "a net with pins in two Gcells or more, for an animation"
        check(os.fspath(problem.path), loaded.to_route.any(), what)
        if open_nets := len(evaluate(loaded, routes).disconnected):
            click.echo(f"{open_nets} open nets: A* completes them in the animation", err=True)
    with working(f"drawing {out}"):
        if checkpoint is None:
            scenes = record(replay(loaded, routes, turn_order or "sequential"), frames)
        else:
            scenes, name = _policy(checkpoint, loaded, problem.stem, frames), checkpoint.stem
        save_animation(scenes, out, f"{problem.stem}: {router_label(name)}")
    count, caption = len(scenes), scenes[-1].caption
    print_result(
        as_json, f"{count} pictures in {out}: {caption}", out=out, pictures=count, caption=caption
    )


def _solutions(
    problem: ProblemFile, loaded: Problem, paths: tuple[Path, ...]
) -> dict[str, Solution]:
    """The solutions by name: those in files, or sequential A*'s."""
    if not paths:
        return {"astar": sequential_astar(loaded)}
    files = (file for path in paths for file in _files(path, Path(problem.path)))
    called = solutions_by_name(files, problem.stem)
    return {name: Solution.read(file, loaded) for name, file in called.items()}


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


def _policy(checkpoint: Path, problem: Problem, network: str, frames: int) -> "list[Scene]":
    """Moments of a trained policy's own game."""
    from policies.figures.animation import record
    from policies.learned.policy import TrainedPolicy

    return record(TrainedPolicy.load(checkpoint, network).play(problem), frames)
