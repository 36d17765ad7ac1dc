"""The leaderboard: a page with a table and plots for each scenario, from result files alone.

References only get better. So that all rows of a scenario are scored alike, each problem has the
best reference that any of its files or the package knows.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from marouting import InputError, scenarios
from marouting.config import check
from marouting.files import is_file, write_text
from marouting.scenarios.references import Best, references_in
from marouting.scenarios.score import Figures
from policies.experiment.result import Result, Task, read_result, summarise
from policies.results.rows import RESULTS

PICTURES = Path("pictures/leaderboard")
"""Where the plots lie, from the page's folder."""

_Group = tuple[str, str]
"""A scenario and a split."""


def write_leaderboard(results: Path, page: Path) -> list[Path]:
    """Writes the page and its plots from the result files in a folder; returns all files.

    Raises:
        InputError: there are no result files, one is damaged, or two do not fit together.
    """
    groups = read_groups(results)
    drawn = []
    for group, found in groups.items():
        drawn += _draw(group, found, page.parent / PICTURES)
    write_text(page, _page(groups, {path.name for path in drawn}, results, page))
    return [page, *drawn]


def read_groups(results: Path) -> dict[_Group, list[Result]]:
    """The results in a folder by scenario and split, all with the same tasks, the best first."""
    files = sorted(path for path in results.glob("*.json") if path.name != RESULTS)
    if not files:
        raise InputError(f"{results}: expected result files of marouting benchmark (*.json)")
    found: dict[_Group, dict[Path, Result]] = {}
    for file in files:
        result = read_result(file)
        found.setdefault((result.scenario, result.split), {})[file] = result
    known = scenarios.names()
    order = sorted(
        found, key=lambda group: (known.index(group[0]) if group[0] in known else len(known), group)
    )
    return {group: _aligned(found[group], _shipped(*group)) for group in order}


def _shipped(scenario: str, split: str) -> dict[str, Best]:
    """The references of a split that come with the package; none for your own scenarios."""
    if scenario not in scenarios.SHIPPED:
        return {}
    best = references_in(scenarios.SHIPPED[scenario].references).references.values()
    return {each.problem: each for each in best if each.problem.startswith(f"{split}_")}


def _aligned(found: Mapping[Path, Result], shipped: Mapping[str, Best]) -> list[Result]:
    """Results of one scenario with the best solutions that are known, the best first."""
    first = next(iter(found))
    tasks, scale = found[first].by_name, found[first].scale
    if shipped:
        what = f"those of {found[first].scenario}, {found[first].split}"
        check(f"{first}: tasks", tasks.keys() == shipped.keys(), what)
    names: dict[str, Path] = {}
    for file, result in found.items():
        twice = f"another than {result.name}, as in {names.get(result.name)}"
        check(f"{file}: name", result.name not in names, twice)
        names[result.name] = file
        check(f"{file}: tasks", result.by_name.keys() == tasks.keys(), f"those of {first}")
        for task in result.tasks:
            known = tasks[task.problem]
            where = f"{file}: tasks: {task.problem}: astar"
            check(where, task.astar == known.astar, f"{list(known.astar)}, as in {first}")
        check(f"{file}: scale", result.scale == scale, f"that of {first}, found another")
    tasks = {name: _best_known(task, found, shipped.get(name)) for name, task in tasks.items()}
    return sorted((_rescored(result, tasks) for result in found.values()), key=_rank)


def _best_known(task: Task, found: Mapping[Path, Result], shipped: Best | None) -> Task:
    """A task with the best solution that is known; raises InputError if it cannot be.

    Args:
        task: the task.
        found: results, whose references and solutions count.
        shipped: the reference that comes with the package, if there is one.
    """
    references: list[tuple[Figures, str]] = []
    optimum: Figures | None = None
    for file, result in found.items():
        own = result.by_name[task.problem]
        if own.reference is not None:
            references.append((Figures(*own.reference), f"{file}: tasks"))
            optimum = references[-1][0] if own.proven else optimum
    if shipped is not None:
        references.append((Figures(0, shipped.overflow, shipped.wirelength), "the package"))
        optimum = references[-1][0] if shipped.proven else optimum
    if not references:
        return task
    routed = [
        (row.figures, f"{file}: outcomes")
        for file, result in found.items()
        for row in result.outcomes
        if row.problem == task.problem and row.figures is not None
    ]
    best, where = min(references + routed)
    what = f"none better than the proven optimum {optimum and tuple(optimum)}, found {tuple(best)}"
    check(f"{where}: {task.problem}", optimum in (None, best), what)
    return replace(task, reference=(*best,), proven=optimum is not None)


def _rescored(result: Result, tasks: Mapping[str, Task]) -> Result:
    """A result with other references, and the scores that follow."""
    outcomes = []
    for row in result.outcomes:
        figures = row.figures
        known = figures is not None and result.scale is None
        score = tasks[row.problem].score(figures) if known and figures else None
        outcomes.append(replace(row, score=score))
    own = tuple(tasks[task.problem] for task in result.tasks)
    return replace(result, tasks=own, outcomes=tuple(outcomes))


def _rank(result: Result) -> tuple[float | str | bool, ...]:
    """Where a result stands: by score, share at the reference, gap; without a score at the end."""
    row = summarise(result)
    if row["score"] is None:
        return True, result.name
    gap = float("inf") if row["gap"] is None else row["gap"]
    at_reference = 0 if result.scale is not None else row["at_reference"]
    return False, -row["score"]["mean"], -at_reference, gap, result.name


def _title(group: _Group) -> str:
    scenario, split = group
    return scenario if split == "test" else f"{scenario}, {split} problems"


def _picture(group: _Group, kind: str) -> str:
    scenario, split = group
    return f"{scenario}{'' if split == 'test' else f'-{split}'}-{kind}.png"


def _draw(group: _Group, found: Sequence[Result], folder: Path) -> list[Path]:
    """Draws the plots of a scenario; returns their paths."""
    from policies.figures.leaderboard import learning_curves, score_intervals
    from policies.figures.style import save

    rows = [row for row in map(summarise, found) if row["score"] is not None]
    curves = {result.name: result.curve for result in found if result.curve}
    drawn = []
    if rows:
        drawn.append(folder / _picture(group, "scores"))
        save(score_intervals(rows, _title(group), policies=_of_policies(found)), drawn[-1])
    if curves:
        drawn.append(folder / _picture(group, "curves"))
        save(learning_curves(curves, _title(group), policies=_of_policies(found)), drawn[-1])
    return drawn


def _of_policies(found: Sequence[Result]) -> bool:
    """Whether these are results of a scenario of policies."""
    return found[0].scale is not None


def _page(
    groups: Mapping[_Group, Sequence[Result]], drawn: set[str], results: Path, page: Path
) -> str:
    folder = Path(os.path.relpath(results, page.parent)).as_posix()
    protocol = "`docs/scenarios.md`"
    if is_file(page.parent / "../scenarios.md"):
        protocol = "[Scenarios](../scenarios.md)"
    lines = [
        "# Leaderboard",
        "",
        f"All scores of the benchmark, by scenario. Made by `marouting benchmark --out "
        f"{results.as_posix()} --leaderboard {page.as_posix()}` from the files in "
        f"[{folder.removeprefix('../')}]({folder}); do not edit it. "
        f"{protocol} explains the protocol and how to add a row.",
    ]
    tracks = (("Planners", _PLANNERS, False), ("Policies", _POLICIES, True))
    for title, notes, policies in tracks:
        own = {group: found for group, found in groups.items() if _of_policies(found) == policies}
        if own:
            lines += ["", f"## {title}", "", notes]
        for group, found in own.items():
            lines += _section(group, found, drawn)
    return "\n".join(lines) + "\n"


PLANNER_NOTES = (
    "**Score**: 0 for sequential A*, 1 for the reference (the proven optimum, or the best "
    "solution known); by open nets, then overflow, then wirelength; interquartile mean over "
    "problems and seeds with its 95 % bootstrap interval. **Open**: problems with open nets. "
    "**Overflow**: the sum, in tracks. **Gap**: mean wirelength above the reference, of the "
    "solutions with its open nets and overflow; in brackets how many problems have one, if not "
    "all. **At reference**: solutions as good as it. **W/T/L**: wins, ties and losses against "
    "A*. All of these are per seed. **Seconds**: median wall time per problem."
)
"""What the columns of planners mean."""

POLICY_NOTES = (
    "**Score**: 0 for the best local rule, 1 for the optimum; interquartile mean "
    "over the seeds with its 95 % bootstrap interval. **Cost**: wirelength, open tasks and "
    "overflow, divided by the optimum's wirelength; interquartile mean over the seeds. **Solved**: "
    "problems without open tasks and overflow. **Connected**: share of the tasks. **Gap**: mean "
    "wirelength above the optimum, of the solved problems. **Sees**: what a net sees when it "
    "chooses, verified for radii. Planners see the whole problem: they are bounds, not "
    "competitors. **Teacher**: whether it learned from a router with sight of the whole problem. "
    "**Agent-steps** and **training** (processor time): of one seed."
)
"""What the columns of policies mean."""

_PLANNERS = (
    "Routers that see the whole problem, and learners that are trained on each problem. "
    f"{PLANNER_NOTES} **Rerun**: what the whole row takes on one core, training included. "
    "**?**: not known."
)

_POLICIES = (
    "Nets that decide for themselves, once ([Cooperation](../cooperation.md)), and no training on "
    f"test problems. {POLICY_NOTES} **?**: not known."
)


def _section(group: _Group, found: Sequence[Result], drawn: set[str]) -> list[str]:
    """The lines about a scenario."""
    rows = [summarise(result) for result in found]
    lines = ["", f"### {_title(group)}", ""]
    if group[0] in scenarios.names():
        lines += [scenarios.get(group[0]).description, ""]
    lines += [
        f"{rows[0]['problems']} problems; the reference is proven on "
        f"{rows[0]['proven']:.0f} % of them.",
        "",
    ]
    if _of_policies(found):
        lines.append(f"| {' | '.join(('router', *POLICY_COLUMNS))} |")
        lines.append("|---|---|---:|---:|---:|---:|---|---|---:|---:|---:|---:|")
        lines += [f"| `{row['name']}` | {' | '.join(policy_cells(row))} |" for row in rows]
    else:
        lines += [
            "| router | score | open | overflow | gap, % | at reference, % | W/T/L | seconds | "
            "budget | seeds | rerun | training |",
            "|---|---|---:|---:|---:|---:|---:|---:|---|---:|---:|---:|",
        ]
        lines += [_line(row) for row in rows]
    for kind, title in (("scores", "Scores"), ("curves", "Learning curves")):
        if (name := _picture(group, kind)) in drawn:
            lines += ["", f"![{title}, {_title(group)}]({(PICTURES / name).as_posix()})"]
    lines += ["", "<details><summary>How each row was made</summary>", ""]
    return [*lines, *_commands(found), "", "</details>"]


def _commands(found: Sequence[Result]) -> list[str]:
    """How each row was made; rows of one command share a line."""
    names: dict[str, list[str]] = {}
    for result in found:
        made = f"{result.date}, marouting {result.version}, {result.machine}"
        names.setdefault(f"`{result.command}` ({made})", []).append(f"`{result.name}`")
    return [f"- {', '.join(rows)}: {how}" for how, rows in names.items()]


def _line(row: Mapping[str, Any]) -> str:
    """A row of a table."""
    cells = [
        f"`{row['name']}`",
        *planner_cells(row),
        row["budget"] or "",
        str(row["seeds"]),
        _duration(row["seconds"]),
        _duration(row["training_seconds"]),
    ]
    return f"| {' | '.join(cells)} |"


def planner_cells(row: Mapping[str, Any]) -> list[str]:
    """Score, open, overflow, gap, at reference, W/T/L and seconds of a summary, in words.

    Args:
        row: as :func:`policies.experiment.result.summarise` returns it.
    """
    overflow = f"{round(row['overflow'], 1):.10g}"
    seconds = "?" if row["solution_seconds"] is None else f"{row['solution_seconds']:.2g}"
    score = gap = at_reference = opened = record = "?"
    if row["score"] is not None:
        few = f" ({row['gap_problems']:g})" if row["gap_problems"] < row["problems"] else ""
        score = "{mean:.3f} [{low:.3f}, {high:.3f}]".format(**row["score"])
        gap = "" if row["gap"] is None else f"{row['gap']:.2f}{few}"
        at_reference = f"{row['at_reference']:.0f}"
    if row["open"] is not None:
        opened = f"{row['open']:.4g}"
        record = "/".join(f"{row[outcome]:.3g}" for outcome in ("wins", "ties", "losses"))
    return [score, opened, overflow, gap, at_reference, record, seconds]


POLICY_COLUMNS = (
    "score",
    "cost",
    "solved, %",
    "connected, %",
    "gap, %",
    "sees",
    "teacher",
    "parameters",
    "agent-steps",
    "training",
    "seeds",
)
"""The columns of :func:`policy_cells`."""


def policy_cells(row: Mapping[str, Any]) -> list[str]:
    """The figures of a summary of a policy in words, in the order of :data:`POLICY_COLUMNS`."""

    def figure(key: str, form: str, factor: float = 1) -> str:
        return "?" if row[key] is None else format(factor * row[key], form).replace(",", " ")

    score, interval = row["score"], ""
    if score is not None and row["seeds"] > 1:
        interval = f" [{score['low']:.3f}, {score['high']:.3f}]"
    return [
        "?" if score is None else f"{round(score['mean'], 3) + 0:.3f}{interval}",
        figure("cost", ".4f"),
        figure("solved", ".1f", 100),
        figure("connected", ".1f", 100),
        figure("gap", ".2f"),
        row["sight"],
        "?" if row["teacher"] is None else "yes" if row["teacher"] else "no",
        figure("parameters", ",d"),
        figure("agent_steps", ",d"),
        _duration(row["training_seconds"]),
        str(row["seeds"]),
    ]


def _duration(seconds: float | None) -> str:
    """A time in the unit that fits."""
    if seconds is None:
        return "?"
    if seconds == 0:
        return "–"
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds >= size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"
