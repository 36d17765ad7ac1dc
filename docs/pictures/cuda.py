"""Draws cuda.svg: agent-steps per second on a GPU, by the number of games.

python docs/pictures/cuda.py
"""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.ticker import EngFormatter

from policies.figures.style import BLUE, MAGENTA, ORANGE, TEAL

DOCS = Path(__file__).resolve().parents[1]

Curve = list[tuple[int, float]]


def curves(report: dict[str, Any]) -> dict[str, Curve]:
    """Numbers of games and agent-steps per second, of everything that was measured."""
    found: dict[str, Curve] = {
        name: [(row["games"], row["agent_steps_per_s"]) for row in report[section]]
        for section, name in (
            ("paper", "paper's observation"),
            ("window", "window of radius 3"),
        )
    }
    found["Connector of Jumanji"] = [
        (row["games"], row["rows_per_s"]) for row in report["connector"] if not row["radius"]
    ]
    found["IPPO on gates-8x7-v0"] = [
        (row["games"], row["agent_steps_per_s"])
        for row in report["learning"]
        if row["learner"] == "ippo" and "agent_steps_per_s" in row
    ]
    return found


def draw(path: Path) -> None:
    """Draws one curve for each, all on logarithmic axes."""
    report = json.loads((DOCS / "results" / "cuda.json").read_text(encoding="utf-8"))
    mpl.rcParams.update({"font.size": 11, "svg.fonttype": "path", "svg.hashsalt": "cuda"})
    figure, panel = plt.subplots(figsize=(7.4, 3.4), layout="constrained")
    # Told apart by colour, mark and dashes, so that colours are not needed.
    looks = ((BLUE, "o", "-"), (TEAL, "s", "--"), (MAGENTA, "D", "-."), (ORANGE, "^", ":"))
    for (name, curve), (colour, mark, dashes) in zip(curves(report).items(), looks, strict=True):
        panel.plot(*zip(*curve, strict=True), color=colour, marker=mark, linestyle=dashes)
        shift = {"xytext": (8, 0), "textcoords": "offset points", "va": "center"}
        panel.annotate(name, max(curve), color=colour, **shift)
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    games = [4**power for power in range(6, 10)]
    thin = "\N{NARROW NO-BREAK SPACE}"
    panel.set_xticks(games, [f"{count:,}".replace(",", thin) for count in games])
    panel.set_xticks([], minor=True)
    panel.yaxis.set_major_formatter(EngFormatter(sep="\N{NO-BREAK SPACE}"))
    panel.set_xlim(right=2.2e6)  # room for the names
    panel.set(xlabel="games at once", ylabel="agent-steps a second", ylim=(1e6, 5e9))
    panel.grid(axis="y", alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    draw(Path(__file__).with_suffix(".svg"))
