"""Draws architecture.png: the rooms of the two floors.

python docs/pictures/architecture.py
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.patches import FancyBboxPatch

# Rows from bottom to top; a room: its name, what is in it, its share of the row's width, and
# whether users can bring their own.
ENVIRONMENT = (
    (
        (
            "kernels · errors · files · registry · config",
            "what all rooms use; pieces by name",
            1,
            False,
        ),
    ),
    (
        ("problem/", "Problem, Solution, evaluate; ISPD, LEF/DEF", 1, False),
        ("trees/", "two-pin tasks of nets", 0.7, False),
    ),
    (("batch/rules, tasks, rounds, state, engine", "the game: M problems in arrays", 1, False),),
    (
        ("batch/observation, window", "what agents see", 1, True),
        ("batch/reward, team_rewards", "what moves pay", 1, True),
    ),
    (
        ("search/", "A*", 0.7, False),
        ("generator", "problem sets", 0.8, False),
        ("scenarios/", "the benchmark's levels", 1, False),
    ),
    (("player", "the one array player: actions in, step buffers out", 1, False),),
    (
        ("env/", "AEC, Parallel, Gymnasium", 1, False),
        ("vector", "BatchEnv", 0.7, False),
        ("make", "from a configuration", 0.7, False),
    ),
)
POLICIES = (
    (("engines/", "processes of this machine, or tasks of Ray", 1, False),),
    (
        ("routers/", "route(problem) → Solution", 1, True),
        ("results/", "rows, folders, statistics", 1, False),
        ("figures/", "pictures, pages, animations", 0.9, False),
    ),
    (
        ("learned/networks", "modules, stacked", 1, True),
        ("learned/memory, exploration", "replay, rollouts, ε", 1, False),
        ("learned/compiled", "kernels", 0.6, False),
    ),
    (("learned/algorithms", "dqn, ppo, imitation: subclasses of Learner", 1, True),),
    (("learned/trainer, run, router", "any learner, on any problems, in a run folder", 1, False),),
    (
        ("experiment/", "problem sets × routers × seeds", 1, False),
        ("benchmark/", "scores on the scenarios", 0.8, False),
        ("bench/", "speed", 0.6, False),
    ),
    (("cli/", "the command marouting", 1, False),),
)
BLUE, ORANGE, OPEN = "#dbe7f3", "#f6e3d0", "#2f7d4f"
ROW, GAP, WIDTH = 1.0, 0.16, 10.0


def floor(axes, rows, bottom, colour):
    """Draws the rows of a floor; returns where its top is."""
    for row in rows:
        scale = (WIDTH - GAP * (len(row) - 1)) / sum(share for *_, share, _ in row)
        left = 0.0
        for name, content, share, own in row:
            box = FancyBboxPatch(
                (left, bottom),
                share * scale,
                ROW - GAP,
                boxstyle="round,pad=0,rounding_size=0.08",
                facecolor=colour,
                edgecolor=OPEN if own else "#5b6470",
                linewidth=2.2 if own else 0.8,
            )
            axes.add_patch(box)
            middle = left + share * scale / 2
            axes.text(middle, bottom + 0.54, name, ha="center", va="center", weight="bold")
            axes.text(middle, bottom + 0.26, content, ha="center", va="center", size=8.5)
            left += share * scale + GAP
        bottom += ROW
    return bottom


def main():
    """Draws the picture."""
    mpl.rcParams["font.size"] = 9.5
    figure, axes = plt.subplots(figsize=(8.6, 8.8))
    middle = floor(axes, ENVIRONMENT, 0.0, BLUE)
    top = floor(axes, POLICIES, middle + 0.7, ORANGE)
    for text, where in (("marouting/", 0.0), ("policies/", middle + 0.7)):
        axes.text(-0.28, where, text, rotation=90, va="bottom", ha="center", size=13, weight="bold")
    axes.text(
        WIDTH / 2, middle + 0.24, "policies/ imports marouting/, never the other way round",
        ha="center", va="center", style="italic",
    )  # fmt: skip
    axes.annotate(
        "", (WIDTH + 0.3, 0), (WIDTH + 0.3, top - GAP), arrowprops={"arrowstyle": "->", "lw": 1.4}
    )
    axes.text(
        WIDTH + 0.5,
        top / 2,
        "imports go down, or left in a row",
        rotation=270,
        va="center",
        ha="center",
    )
    axes.text(
        WIDTH, -0.28, "green frame: users bring their own by name", color=OPEN, ha="right",
        va="center",
    )  # fmt: skip
    axes.set(xlim=(-0.5, WIDTH + 0.7), ylim=(-0.5, top))
    axes.axis("off")
    figure.savefig(Path(__file__).with_suffix(".png"), bbox_inches="tight", dpi=100)


if __name__ == "__main__":
    main()
