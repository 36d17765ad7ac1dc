"""Draws libraries.svg: what the recipes of docs/examples/libraries join while they train.

python docs/pictures/libraries.py
"""

import csv
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from policies.figures.style import BLUE, INK, ORANGE, TEAL

DOCS = Path(__file__).resolve().parents[1]

# A library's recipes, as docs/results/libraries.csv calls them, and what the picture calls them.
PANELS = {
    "Stable-Baselines3": {
        "sb3_gymnasium ppo": "PPO",
        "sb3_gymnasium dqn": "DQN",
        "sb3_supersuit": "PPO, SuperSuit",
    },
    "sb3-contrib": {"sb3_masked": "MaskablePPO"},
    "TorchRL": {"torchrl_ippo": "independent PPO", "torchrl_ippo mappo": "MAPPO"},
    "BenchMARL": {
        "benchmarl_task ippo": "IPPO",
        "benchmarl_task iql": "IQL",
        "benchmarl_task qmix": "QMIX",
    },
    "RLlib": {"rllib_ppo": "PPO", "rllib_ppo masked": "PPO, masked"},
    "Tianshou": {"tianshou_dqn": "DQN"},
    "AgileRL": {"agilerl_ippo": "IPPO"},
    "skrl": {"skrl_ippo": "IPPO"},
    "PufferLib": {"pufferlib_emulation": "PPO written out"},
    "BatchEnv alone": {"batch_ppo": "PPO in one file"},
}
# Told apart by colour, mark and dashes, so that colours are not needed.
LINES = ((BLUE, "o", "-"), (ORANGE, "s", "--"), (TEAL, "^", ":"))


def curves() -> dict[str, list[tuple[float, float]]]:
    """Thousands of steps and the share of nets joined, of every recipe."""
    found: dict[str, list[tuple[float, float]]] = {}
    with (DOCS / "results" / "libraries.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            point = int(row["steps"]) / 1000, float(row["joined"])
            found.setdefault(row["recipe"], []).append(point)
    return found


def draw(path: Path) -> None:
    """Draws one panel for each library.

    Args:
        path: the picture's file.

    Raises:
        ValueError: a recipe has a curve and no panel, or a panel and no curve.
    """
    found = curves()
    shown = [recipe for recipes in PANELS.values() for recipe in recipes]
    if sorted(shown) != sorted(found):
        raise ValueError(f"panels and curves differ in {set(shown) ^ set(found)}")
    mpl.rcParams.update({"font.size": 11, "svg.fonttype": "path", "svg.hashsalt": "libraries"})
    figure, axes = plt.subplots(2, 5, figsize=(14, 6), sharey=True, layout="constrained")
    for panel, (library, recipes) in zip(axes.flat, PANELS.items(), strict=True):
        for (recipe, label), (colour, mark, dashes) in zip(recipes.items(), LINES, strict=False):
            steps, joined = zip(*found[recipe], strict=True)
            panel.plot(
                steps,
                joined,
                color=colour,
                marker=mark,
                linestyle=dashes,
                markersize=4,
                label=label,
            )
        panel.axhline(0.95, color=INK, linewidth=0.8, alpha=0.5)
        panel.set_title(library, fontsize=12, weight="bold")
        panel.set(xlim=(0, None), ylim=(0, 1.05))
        panel.legend(loc="lower right", fontsize=10, framealpha=0.9)
        panel.spines[["top", "right"]].set_visible(False)
    figure.supxlabel("steps, in thousands (every panel has its own scale)")
    figure.supylabel("share of nets joined; the thin line is 0.95")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    draw(Path(__file__).with_suffix(".svg"))
