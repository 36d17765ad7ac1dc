"""Draws docs/pictures/cooperation/trained.svg and prints the tables of docs/cooperation.md.

python docs/pictures/trained.py

Both are made from docs/results/benchmark: the costs of every seed of the policies that were trained
for 1 M or 10 M agent-steps.
"""

import statistics
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from policies.experiment.result import policy_figures, read_result
from policies.figures.style import BLUE, INK, ORANGE, RED, save

DOCS = Path(__file__).parents[1]
BUDGETS = {10**6: "1 M", 10**7: "10 M"}
COLOURS = {"selfish": RED, "team": BLUE, "counterfactual": ORANGE}
MAIN = ("gates-8x7-v0", "gates-mixed-v0", "multi-pin-once-8x8-v0", "two-pin-once-8x8-v0")
"""The levels on which all algorithms are trained; the others have a table of their own."""


Rows = dict[str, dict[int, list[float]]]
"""The costs of all seeds of a scenario, by row without its budget, and by budget."""


def trained() -> tuple[dict[str, Rows], dict[str, float]]:
    """The costs of policies, and that of the best local rule, by scenario."""
    found: dict[str, Rows] = {}
    rules = {}
    for file in sorted((DOCS / "results/benchmark").glob("*.json")):
        result = read_result(file)
        steps = (result.policy and result.policy.agent_steps) or 0
        for budget in BUDGETS:
            if result.split == "test" and budget <= steps < 1.5 * budget:
                row = result.name.removesuffix("-10m")
                costs = policy_figures(result)["costs"]
                found.setdefault(result.scenario, {}).setdefault(row, {})[budget] = costs
                assert result.scale is not None
                rules[result.scenario] = result.scale.local_rule
    return found, rules


def reward_of(row: str) -> str:
    """What a row is paid for: ``LEARNER-REWARD``, or ``LEARNER-REWARD-cloned``."""
    return row.split("-")[1]


def order(row: str) -> tuple[int, str]:
    """Rows with the same reward stand together."""
    return list(COLOURS).index(reward_of(row)), row


def told(costs: list[float]) -> str:
    """The median, the range and, unless there are five, the number of seeds."""
    seeds = "" if len(costs) == 5 else f", {len(costs)} seed{'s' * (len(costs) > 1)}"
    if len(costs) == 1:
        return f"{costs[0]:.3f} (one seed)"
    return f"{statistics.median(costs):.3f} ({min(costs):.3f}–{max(costs):.3f}{seeds})"


def table(found: dict[str, Rows], rules: dict[str, float], budget: int) -> str:
    """Costs by row and scenario for a budget, as Markdown; empty if there are none."""
    levels = [of for of, rows in found.items() if any(budget in own for own in rows.values())]
    if not levels:
        return ""
    rows = {row for of in levels for row, own in found[of].items() if budget in own}
    lines = [f"| {BUDGETS[budget]} agent-steps | " + " | ".join(f"`{of}`" for of in levels) + " |"]
    lines += ["|---|" + "---:|" * len(levels)]
    for row in sorted(rows, key=order):
        cells = [found[level].get(row, {}).get(budget) for level in levels]
        shown = " | ".join("–" if cell is None else told(cell) for cell in cells)
        lines.append(f"| `{row}` | {shown} |")
    best = " | ".join(f"{rules[level]:.3f}" for level in levels)
    return "\n".join([*lines, f"| best local rule | {best} |", ""])


def draw(axes: Axes, scenario: str, rows: Rows, rule: float) -> None:
    """A panel: the costs of the seeds of each row."""
    names = sorted(rows, key=order)
    for at, name in enumerate(names):
        colour = COLOURS[reward_of(name)]
        for budget, costs in rows[name].items():
            long = budget == max(BUDGETS)
            aside = 0 if len(rows[name]) == 1 else 0.15 if long else -0.15
            x = [at + aside] * len(costs)
            fill = colour if long else "white"
            axes.plot(x, costs, "o", color=colour, markerfacecolor=fill, markersize=5, zorder=2)
    axes.axhline(rule, color=INK, linestyle=":", linewidth=1, zorder=1)
    axes.axhline(1, color=INK, linewidth=1, zorder=1)
    axes.set_xlim(-0.5, len(names) - 0.5)
    labels = [name.replace("-", "\n").replace("counterf", "counter-\nf") for name in names]
    axes.set_xticks(range(len(names)), labels, fontsize=7)
    axes.set_title(scenario, fontsize=10, color=INK)
    axes.tick_params(axis="y", labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def main() -> None:
    """Prints the tables and draws the picture."""
    mpl.rcParams["svg.hashsalt"] = "marouting"
    found, rules = trained()
    main_ones = {level: found[level] for level in MAIN if level in found}
    others = {level: rows for level, rows in found.items() if level not in MAIN}
    for budget in BUDGETS:
        for levels in (main_ones, others):
            print(table(levels, rules, budget))
    shown = [*main_ones, *others]
    lines = -(-len(shown) // 2)
    figure = Figure(figsize=(9.5, 2.6 * lines), layout="constrained")
    panels = figure.subplots(lines, 2, squeeze=False).ravel()
    for axes, scenario in zip(panels, shown, strict=False):
        draw(axes, scenario, found[scenario], rules[scenario])
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    figure.supylabel("cost on the test problems", fontsize=9, color=INK)
    save(figure, DOCS / "pictures/cooperation/trained.svg")


if __name__ == "__main__":
    main()
