"""Tables on standard output that compare routers and speeds, as wide as the terminal or 80 columns.

Names may wrap; figures never do. A table with more columns than fit is cut into several.
"""

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from policies.results.run_folder import POLICY, RESULT
from policies.results.validation import Validation

if TYPE_CHECKING:
    from policies.learned.run import Run

HEADINGS = (
    ("problem", "problem"),
    ("router", "router"),
    ("overflow", "overflow"),
    ("wirelength", "wirelength"),
    ("pruned_wirelength", "pruned"),
    ("joined", "tasks connected"),
    ("seconds", "seconds"),
    ("from", "routes from"),
)
"""The columns of a row that :func:`show` prints, with their headings."""

_NAME = 24
"""The width of a column of names, at most; longer names wrap."""


def show(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Prints rows of results.

    Beside the wirelength stand the tasks connected, as less of it is no merit where nets stayed
    open, and the pruned wirelength, without dangling branches and loops, where a row has any. A
    column that all rows lack is left out.
    """
    shown = [
        {**row, "joined": f"{row['joined']}/{row['tasks']}", "seconds": f"{row['seconds']:.2f}"}
        for row in rows
    ]
    columns = {
        heading: [str(row.get(key, "")) for row in shown]
        for key, heading in HEADINGS
        if any(key in row for row in shown)
    }
    if columns.get("pruned") == columns["wirelength"]:
        del columns["pruned"]
    names = ["problem", "router"] if "problem" in columns else ["router"]
    _print(title, columns, names)


FEW = 5
"""Problems whose rows are printed one by one; of more, :func:`show_training` prints means."""


def show_training(run: "Run", rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints the results of a training on many problems."""
    routers = list(dict.fromkeys(row["router"] for row in rows))
    found = [
        Validation.of((row for row in rows if row["router"] == router), run.reference)
        for router in routers
    ]
    columns = {
        "router": routers,
        "problems\nconnected": [f"{one.connected}/{one.problems}" for one in found],
        "overflow": [f"{one.overflow:.2f}" for one in found],
        "wirelength": [f"{one.wirelength:.1f}" for one in found],
        "gap\n%": ["" if one.gap is None else f"{one.gap:.2f} ({one.compared})" for one in found],
    }
    if not run.reference:
        del columns["gap\n%"]
    config, saved = run.config, rows[-1].get("from", "")
    split = "validation problems" if config.env.endless else "problems"
    _print(f"{run.folder}: means over {len(run.problems)} {split}", columns, ["router"])
    notes = [f"{rows[-1]['router']}: the saved network, {saved}, in {run.folder / POLICY}"]
    if run.reference:
        notes.append(
            "gap: mean wirelength above the scenario's reference, over the problems without open "
            "tasks and with the reference's overflow (in brackets: their number)"
        )
    elif config.env.scenario is not None:
        notes.append(f"{config.env.scenario} has no references: no gap, see docs/scenarios.md")
    notes.append(f"all problems: {run.folder / RESULT}")
    click.echo("\n".join(map(_wrapped, notes)))


def show_experiment(summary: Mapping[str, Any]) -> None:
    """Prints the summary that :meth:`policies.experiment.Experiment.execute` returns.

    One comparison for each set, and if there are several one of all problems together, of the
    routers that are for all sets.
    """
    reference = summary["reference"]
    for name, rows in summary["sets"].items():
        count = rows[0]["problems"]
        title = f"{name}: {count} problem{'s' * (count > 1)}"
        if name in summary["types"]:
            title += "".join(f", {n} of Type {type}" for type, n in summary["types"][name].items())
        columns = {
            "router": [row["router"] for row in rows],
            "overflow": [f"{row['overflow']:.6g}" for row in rows],
            "problems\nwithout": [f"{row['zero_overflow']:.4g}" for row in rows],
            "open": [f"{row['open']:.6g}" for row in rows],
            "wirelength": [_estimate(row["wirelength"], 1) for row in rows],
            "pruned": [_pruned(row) for row in rows],
            "gap\n%": [_gap(row) for row in rows],
            "less WL\n% of problems": [_share(row["lower_wirelength"]) for row in rows],
            "paper's\nwins %": [_share(row["paper_wins"]) for row in rows],
            "A*\nW/T/L": [_record(row["against_astar"]) for row in rows],
        }
        if columns["paper's\nwins %"] == columns["less WL\n% of problems"]:
            del columns["paper's\nwins %"]
        if not any(columns["pruned"]):
            del columns["pruned"]
        if reference:
            heading = textwrap.fill(reference, _NAME)
            columns[f"{heading}\nW/T/L"] = [_record(row["against_reference"]) for row in rows]
        columns["seconds"] = [
            "" if row["seconds"] is None else f"{row['seconds']:.3g}" for row in rows
        ]
        _print(title, columns, ["router"])
    click.echo(_wrapped(_NOTES))


_NOTES = (
    "overflow, open (two-pin tasks not connected): totals over the problems. problems without: "
    "those with neither. wirelength, gap: means over the problems ± half the 95 % interval "
    "(Student's t). pruned: the mean wirelength without dangling branches and loops, where "
    "routes have any; all other columns count them. The gap is to the proven optimum, over the "
    "problems (in brackets: their number) with the optimum's overflow and open tasks. less "
    "WL: share of problems with less wirelength than A* and no more open tasks [95 % interval, "
    "Wilson]; paper's wins: the same, however many tasks are open. W/T/L: wins, ties and losses by "
    "open tasks, then overflow, then wirelength. seconds: median time per problem. Everything is "
    "averaged over the seeds first. Type II: A* uses up the capacity of an edge (the paper's "
    "partial edge depletion)."
)


def show_benchmark(summaries: Sequence[Mapping[str, Any]]) -> None:
    """Prints rows of a benchmark, best first, a table for each scenario.

    Args:
        summaries: as :func:`policies.experiment.result.summarise` returns them.
    """
    # Not for the other tables.
    from policies.experiment import leaderboard

    for scenario in dict.fromkeys(row["scenario"] for row in summaries):
        rows = [row for row in summaries if row["scenario"] == scenario]
        rows.sort(key=lambda row: (row["score"] is None, -(row["score"] or {"mean": 0})["mean"]))
        columns = {"router": [row["name"] for row in rows]}
        of_policies = "sight" in rows[0]
        headings = leaderboard.POLICY_COLUMNS if of_policies else _PLANNER_COLUMNS
        cells = leaderboard.policy_cells if of_policies else leaderboard.planner_cells
        columns |= zip(headings, map(list, zip(*map(cells, rows), strict=True)), strict=True)
        problems, seeds = rows[0]["problems"], max(row["seeds"] for row in rows)
        title = f"{problems} {rows[0]['split']} problems"
        if seeds > 1:
            title += f", up to {seeds} seeds"
        _print(f"{scenario}: {title}", columns, ["router"])
    for notes, of_policies, page in (
        (leaderboard.PLANNER_NOTES, False, "scenarios"),
        (leaderboard.POLICY_NOTES, True, "cooperation"),
    ):
        if any(("sight" in row) == of_policies for row in summaries):
            plain = notes.replace("**", "")
            click.echo(_wrapped(f"{plain} ?: not known. docs/{page}.md explains the protocol."))


_PLANNER_COLUMNS = ("score", "open", "overflow", "gap\n%", "at ref.\n%", "A*\nW/T/L", "seconds")
"""The headings of a benchmark's table."""


def show_report(found: Mapping[str, Any], title: str, further: Mapping[str, Any]) -> None:
    """Prints what :func:`policies.results.report.report` returns, and further figures."""
    detours = found["detours"]
    beyond = detours["wires"] - detours["bound"]
    share = f" ({100 * beyond / detours['bound']:.2f} %)" if detours["bound"] else ""
    lines = [
        f"{title}: grid {'x'.join(map(str, found['grid']))}, {found['nets']} nets",
        f"overflow {found['overflow']} on {found['overflowed_edges']} edges, "
        f"at most {found['max_overflow']}",
        f"wirelength {found['wirelength']}: {found['wires']} without vias, {found['vias']} vias",
        f"detours: {beyond} edges{share} above the lower bound {detours['bound']}, "
        f"in {detours['nets_with']} nets",
        *(f"{name} {value}" for name, value in further.items() if name != "open_nets"),
        f"open nets: {len(found['open_nets'])}",
    ]
    click.echo("\n".join(map(_wrapped, lines)))
    if found["open_nets"]:
        click.echo(_wrapped(" ".join(found["open_nets"][:_MOST_OPEN]), "  "))
        if (more := len(found["open_nets"]) - _MOST_OPEN) > 0:
            click.echo(f"  and {more} more")
    click.echo()
    _print(
        "Layers",
        {
            "layer": [row["layer"] for row in found["layers"]],
            "wires go": [row["direction"] for row in found["layers"]],
            **{
                heading: [str(row[key]) for row in found["layers"]]
                for heading, key in (("wires", "wires"), ("vias up", "vias_up"))
            },
            "use\n%": [
                f"{100 * row['demand'] / row['capacity']:.1f}" if row["capacity"] else ""
                for row in found["layers"]
            ],
            "overflow": [str(row["overflow"]) for row in found["layers"]],
        },
        ["layer"],
    )
    spots = found["hot_spots"]
    if spots:
        columns = {
            "layer": [row["layer"] for row in spots],
            "Gcells": ["-".join(f"({x},{y})" for x, y in (r["from"], r["to"])) for r in spots],
            "at": [f"({row['at'][0]}, {row['at'][1]})" for row in spots],
            "demand": [f"{row['demand']}/{row['capacity']}" for row in spots],
            "nets": [str(row["nets"]) for row in spots],
            "such as": [" ".join(row["names"][:3])[:_NAME] for row in spots],
        }
        _print("Fullest edges: demand/capacity, and the nets that meet there", columns, ["layer"])
    if detours["worst"]:
        rows = detours["worst"]
        columns = {"net": [row["net"] for row in rows]}
        for key in ("wires", "bound", "detour"):
            columns[key] = [str(row[key]) for row in rows]
        columns["bound is"] = ["exact" if row["exact"] else "low" for row in rows]
        _print("Longest detours, in edges inside layers", columns, ["net"])
    rows = found["histogram"]
    columns = {"use %": [_bin(row["from"], row["to"]) for row in rows]}
    for key in ("horizontal", "vertical"):
        columns[key] = [str(row[key]) for row in rows]
    _print("Edges with capacity by use", columns, ["use %"])


_MOST_OPEN = 50
"""Open nets that a report names; JSON has all."""


def _bin(start: int, end: int | None) -> str:
    """The name of a bin of a histogram."""
    if end is None:
        return f"> {start}"
    return str(start) if start == end else f"{start} to < {end}"


def _print(title: str, columns: Mapping[str, Sequence[str]], names: Sequence[str]) -> None:
    """Prints columns by heading; those of names, on the left, stand in every piece."""
    console = Console(markup=False, emoji=False, highlight=False)
    click.echo(f"{_wrapped(title)}\n")
    for headings in _pieces(columns, names, console.width):
        table = Table(box=SIMPLE_HEAD, show_edge=False)
        for heading in headings:
            if heading in names:
                table.add_column(heading, max_width=_NAME, overflow="fold")
            else:
                table.add_column(heading, justify="right", no_wrap=True)
        for cells in zip(*(columns[heading] for heading in headings), strict=True):
            table.add_row(*cells)
        console.print(table)
        click.echo()


def _pieces(
    columns: Mapping[str, Sequence[str]], names: Sequence[str], width: int
) -> Iterator[list[str]]:
    """The headings of each table, so that no table is wider than the console."""

    def wide(heading: str) -> int:
        longest = max(map(len, (*heading.split("\n"), *columns[heading])))
        return min(longest, _NAME) if heading in names else longest

    def fits(headings: Iterable[str]) -> bool:
        # Two spaces of padding each, and one between two columns.
        return sum(wide(heading) + 3 for heading in headings) - 1 <= width

    piece = list(names)
    for heading in columns:
        if heading in names:
            continue
        if len(piece) > len(names) and not fits([*piece, heading]):
            yield piece
            piece = list(names)
        piece.append(heading)
    yield piece


def _wrapped(text: str, indent: str = "") -> str:
    """A text in lines that the console holds; indented, with more of it in further lines."""
    lines = [
        textwrap.fill(
            line,
            Console().width,
            initial_indent=indent,
            subsequent_indent=2 * indent,
            break_on_hyphens=False,
        )
        for line in text.split("\n")
    ]
    return "\n".join(lines)


def _estimate(estimate: Mapping[str, Any], digits: int) -> str:
    """A mean, and half its interval where it has one."""
    if estimate["high"] is None:
        return f"{estimate['mean']:.{digits}f}"
    return f"{estimate['mean']:.{digits}f} ± {estimate['high'] - estimate['mean']:.{digits}f}"


def _pruned(row: Mapping[str, Any]) -> str:
    """The mean wirelength without dangling branches and loops, if that is less."""
    pruned = row["pruned_wirelength"]
    less = pruned is not None and pruned["mean"] < row["wirelength"]["mean"]
    return _estimate(pruned, 1) if less else ""


def _gap(row: Mapping[str, Any]) -> str:
    """The gap to the optimum, with the number of problems unless it is known on all of them."""
    gap = row["gap"]
    if not gap:
        return ""
    few = f" ({gap['problems']})" if gap["problems"] < row["problems"] else ""
    return _estimate(gap, 2) + few


def _share(share: Mapping[str, float] | None) -> str:
    """A percentage and its interval."""
    return f"{share['percent']:.1f} [{share['low']:.0f}, {share['high']:.0f}]" if share else ""


def _record(record: Mapping[str, float] | None) -> str:
    """Wins, ties and losses."""
    return "/".join(f"{count:.6g}" for count in record.values()) if record else ""
