"""What each part of the observation ``outlook`` is worth to the generalist: trainings without it.

    python -m policies.bench.features --out FILE.json

Short trainings by ``configs/generalist.yaml``, as it stands and with a part of what agents see set
to 0. Each is judged on the same generated problems, which nobody practises on: by a single shot,
and by games of as many rounds as the training plays, both by the best moves, against a second of
negotiated congestion. Trainings that are finished in their folder are not run again.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from marouting import Problem, evaluate
from marouting.columns import Games
from marouting.config import check, config_file
from marouting.game import RipUp
from policies.bench.negotiation import write_rows
from policies.generalist.outlook import OutlookObservation
from policies.learned.config import load_config
from policies.learned.policy import TrainedPolicy
from policies.learned.run import Run, problems_of
from policies.results.run_folder import POLICY
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

PARTS = {
    "nothing": [],
    "the other pins": ["pins"],
    "the spanning tree": ["span"],
    "the cheapest ways": ["detour"],
    "the window": ["room_x", "room_y", "slack_x", "slack_y", "own", "open"],
}
"""What a training is left without, by name."""


@dataclass(frozen=True)
class Blind(OutlookObservation):
    """The outlook without some of its blocks, which are 0.

    Attributes:
        without: the blocks' names. The block ``numbers`` tells how the frame lies, so it must stay.
    """

    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        known = [name for name in self.layout if name != "numbers"]
        check("without", set(self.without) <= set(known), f"some of {', '.join(known)}")

    def write(
        self,
        games: Games,
        problems: NDArray[np.integer],
        agents: NDArray[np.integer],
        out: NDArray[np.float32],
    ) -> None:
        """Fills ``out`` (K, ``size``) like the outlook."""
        super().write(games, problems, agents, out)
        for name in self.without:
            out[:, self.layout[name]] = 0


def trained(name: str, seed: int, episodes: int, count: int, folder: Path) -> TrainedPolicy:
    """The policy of a training, which is run or gone on with if need be."""
    out = folder / f"{name.replace(' ', '_')}_{seed}"
    blind = json.dumps({"kind": "policies.bench.features:Blind", "without": PARTS[name]})
    changes = {"out": out, "seed": seed, "env.observation": blind}
    changes |= {"train.episodes": episodes, "train.evaluate_every": episodes}
    changes |= {"train.validation": count, "train.tensorboard": "false", "train.figures": "false"}
    words = [f"{key}={value}" for key, value in changes.items()]
    if not (out / POLICY).exists():
        config = load_config(config_file("configs/generalist.yaml"), words)
        Run(config, resume=(out / "checkpoint.pt").exists()).execute()
    return TrainedPolicy.load(out / POLICY)


def judged(
    policy: TrainedPolicy, problems: dict[str, Problem], known: dict[str, Any], rounds: int
) -> dict[str, float]:
    """The gaps in % of games by the best moves to negotiation.

    Returns:
        ``wirelength`` on the problems that negotiation routes without overflow, with ``fails``, how
        many of them are left with overflow; and ``overflow`` on the others.
    """
    rip_up = policy.env.rip_up and replace(policy.env.rip_up, rounds=rounds)
    env, negotiation = replace(policy.env, rip_up=rip_up), policy.negotiation
    player = TrainedPolicy(
        policy.module, policy.masking, policy.obs_shape, env, negotiation=negotiation
    )
    found = {name: evaluate(p, player.solve(p).solution) for name, p in problems.items()}
    fits = [name for name in problems if known[name].overflow == 0]
    over = [name for name in problems if known[name].overflow > 0]

    def gap(names: list[str], what: str) -> float:
        ours, theirs = (sum(getattr(of[name], what) for name in names) for of in (found, known))
        return 100 * (ours / theirs - 1)

    return {
        "wirelength": gap(fits, "wirelength"),
        "fails": float(sum(found[name].overflow > 0 for name in fits)),
        "overflow": gap(over, "overflow"),
    }


def compared(seeds: int, episodes: int, count: int, folder: Path) -> Iterator[dict[str, Any]]:
    """A row for each training."""
    config = load_config(config_file("configs/generalist.yaml"), [f"train.validation={count}"])
    problems, _ = problems_of(config)
    router = PathfinderRouter(PathfinderOptions(seconds=1.0))
    known = {name: evaluate(problem, router.route(problem)) for name, problem in problems.items()}
    for name in PARTS:
        for seed in range(seeds if name == "nothing" else 1):
            policy = trained(name, seed, episodes, count, folder)
            row: dict[str, Any] = {"without": name, "seed": seed, "episodes": episodes}
            for game, rounds in (("shot", 0), ("rounds", (config.env.rip_up or RipUp()).rounds)):
                for what, value in judged(policy, problems, known, rounds).items():
                    row[f"{game}_{what}"] = round(value, 3)
            yield row


@click.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="File of results.")
@click.option("--seeds", default=3, show_default=True, help="Trainings with everything in sight.")
@click.option("--episodes", default=600, show_default=True, help="Of a training.")
@click.option("--problems", default=60, show_default=True, help="To judge on.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=Path("runs/features"),
    show_default=True,
    help="Of the trainings.",
)
def main(out: Path, seeds: int, episodes: int, problems: int, folder: Path) -> None:
    """Trains without parts of the observation, and compares."""
    rows: list[dict[str, Any]] = []
    for row in compared(seeds, episodes, problems, folder):
        rows.append(row)
        click.echo(json.dumps(row))
        write_rows(out, rows)


if __name__ == "__main__":
    main()
