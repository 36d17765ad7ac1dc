"""``marouting animate``: an episode as a moving picture."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from marouting import InputError, Problem, Solution, evaluate
from marouting.files import check_writable
from marouting.game import TurnOrder
from policies.cli.completion import routers
from policies.cli.options import FILE, NUMBER, WHOLE, allow_code_option, json_option, tell
from policies.cli.source import ProblemFile, problem_argument
from policies.results.run_folder import solution_name
from policies.routers.registry import is_learner, make_router, router_label

if TYPE_CHECKING:
    from marouting import Engine


@click.command()
@problem_argument
@click.argument("solution", type=FILE, required=False)
@click.option(
    "--out", type=FILE, required=True, help="File for the animation, with the suffix .svg or .gif."
)
@click.option(
    "--router",
    metavar="NAME",
    shell_complete=routers,
    help="What routes PROBLEM if there is no SOLUTION: a router's name or module:Class.  "
    "[default: astar]",
)
@click.option(
    "--checkpoint",
    type=FILE,
    help="File of a trained policy, whose own game is shown; without it, a replay.",
)
@click.option(
    "--turn-order",
    type=click.Choice(get_args(TurnOrder)),
    help="Whether a net finishes before the next one starts.  "
    "[default: sequential, or as the policy was trained]",
)
@click.option("--frames", type=WHOLE, default=240, show_default=True, help="The most pictures.")
@click.option(
    "--fps", type=NUMBER, help="Pictures per second.  [default: 3 to 20, for about 12 seconds]"
)
@allow_code_option
@json_option
def animate(
    problem: ProblemFile,
    solution: Path | None,
    out: Path,
    router: str | None,
    checkpoint: Path | None,
    turn_order: TurnOrder | None,
    frames: int,
    fps: float | None,
    as_json: bool,
) -> None:
    """Draw an episode on PROBLEM as an animation, SVG or GIF.

    SOLUTION, a solution file, is played as a game in which every net walks along its own route.
    """
    from policies.figures.animation import animation_format, record, replay, save_animation

    if sum(given is not None for given in (solution, router, checkpoint)) > 1:
        raise InputError("animate: expected only one of SOLUTION, --router and --checkpoint")
    if checkpoint is not None and turn_order is not None:
        raise InputError("--turn-order: expected none with --checkpoint: the policy has its own")
    animation_format(out)
    loaded = problem.read()
    check_writable(out)
    if checkpoint is not None:
        states = _policy(checkpoint, loaded, problem.stem)
        name = checkpoint.stem
    else:
        if solution is not None:
            routes, name = Solution.read(solution, loaded), solution_name(solution, problem.stem)
        else:
            name = router or "astar"
            if is_learner(name, "--router"):
                raise InputError(f"--router {name}: expected --checkpoint, a trained policy")
            routes = make_router(name, {}, f"--router {name}").route(loaded)
        if open_nets := len(evaluate(loaded, routes).disconnected):
            click.echo(f"{open_nets} open nets go on as A* would", err=True)
        states = replay(loaded, routes, turn_order or "sequential")
    scenes = record(states, frames)
    save_animation(scenes, loaded, out, f"{problem.stem}: {router_label(name)}", fps)
    count, caption = len(scenes), scenes[-1].caption
    tell(as_json, f"{count} pictures in {out}: {caption}", out=out, pictures=count, caption=caption)


def _policy(checkpoint: Path, problem: Problem, network: str) -> "Iterator[Engine]":
    """The game of a trained policy, again and again as it goes on."""
    from policies.learned.policy import TrainedPolicy

    return TrainedPolicy.load(checkpoint, network).play(problem)
