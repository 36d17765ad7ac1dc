"""Draws generalist.svg: how the generalist learns.

python docs/pictures/generalist.py
"""

import csv
import json
from collections import defaultdict
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from marouting import Problem, evaluate
from policies.figures.style import BLUE, ORANGE, TEAL
from policies.learned.config import load_config
from policies.learned.run import problems_of
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

DOCS = Path(__file__).resolve().parents[1]
LEARNED = DOCS / "results" / "learned"


def loss() -> tuple[list[int], list[float]]:
    """Episodes, and the mean loss of the hundred up to there."""
    with (LEARNED / "loss.csv").open(encoding="utf-8") as file:
        rows = [(int(row["episodes"]), float(row["loss"])) for row in csv.DictReader(file)]
    episodes, losses = zip(*rows, strict=True)
    return list(episodes), list(losses)


def negotiated(problem: Problem) -> tuple[int, int]:
    """Overflow and wirelength of negotiated congestion after a second."""
    found = evaluate(problem, PathfinderRouter(PathfinderOptions(seconds=1.0)).route(problem))
    return found.overflow, found.wirelength


def gaps() -> tuple[list[int], list[float], list[float]]:
    """Episodes, and the gaps in % of games by the best moves to negotiation.

    Returns:
        Episodes; the gaps in wirelength on the problems that negotiation routes without overflow;
        those in overflow on the others.
    """
    problems, _ = problems_of(load_config(DOCS.parent / "configs" / "generalist.yaml"))
    known = {name: negotiated(problem) for name, problem in problems.items()}
    seen: dict[int, list[dict[str, int]]] = defaultdict(list)
    for line in (LEARNED / "evaluations.jsonl").read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        seen[row["episodes"]].append({**row, "fits": known[row["problem"]][0] == 0})
    whole = sum(overflow for overflow, _ in known.values())
    wires = sum(wirelength for overflow, wirelength in known.values() if not overflow)
    longer = [
        100 * (sum(row["wirelength"] for row in rows if row["fits"]) / wires - 1)
        for rows in seen.values()
    ]
    over = [
        100 * (sum(row["overflow"] for row in rows if not row["fits"]) / whole - 1)
        for rows in seen.values()
    ]
    return list(seen), longer, over


def draw(path: Path) -> None:
    """Draws the loss, and the gaps of games by the best moves."""
    mpl.rcParams.update({"font.size": 11, "svg.fonttype": "path", "svg.hashsalt": "generalist"})
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.plot(*loss(), color=BLUE)
    left.set(xlabel="episodes", ylabel="loss, mean of 100 episodes", yscale="log")
    episodes, longer, over = gaps()
    right.plot(episodes, longer, color=TEAL, marker="o", label="wirelength, where all fits")
    right.plot(
        episodes, over, color=ORANGE, marker="s", linestyle="--", label="overflow, elsewhere"
    )
    right.set(xlabel="episodes", ylabel="above negotiation, %", ylim=(0, None))
    right.legend(loc="center right")
    for panel in (left, right):
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    draw(Path(__file__).with_suffix(".svg"))
