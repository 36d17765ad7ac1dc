"""What selfishness costs in the scenarios for policies: the price of anarchy of local rules.

Usage, from a checkout::

    python -m policies.experiment.anarchy                 # all of them: a minute or two on one core
    python -m policies.experiment.anarchy braess-v0
    python -m policies.experiment.anarchy own_levels:mine # a scenario of your own with references
    python -m policies.experiment.anarchy --table         # the table of docs/cooperation.md

Every rule of :data:`RULES` (:mod:`policies.routers.local`) plays the validation and the test
problems once, by the options that the scenario suggests. Its **cost** is the wirelength plus the
scenario's cost of every open task and every track of overflow, summed over the problems and divided
by that of the references. Two rules stand out:

* **selfish**: shortest paths with sight of the whole grid, planned anew at every move;
* **best local**: of the rules that see no further than a radius of 3, the one with the least cost
  on the validation problems. Scores are measured from it
  (:meth:`marouting.scenarios.Scenario.score`).

A scenario is worth playing if the selfish rule costs :data:`LEAST_SELFISH` or more and no rule,
even with full sight, costs less than :data:`LEAST_FIXED`.
"""

import csv
import io
import json
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import click

from marouting import Problem, scenarios
from marouting.config import check
from marouting.evaluation import rules_of
from marouting.files import read_text, write_text
from marouting.scenarios import Scenario
from marouting.scenarios.cooperation import COOPERATION, Braess
from marouting.scenarios.references import FOLDER as REFERENCES
from marouting.scenarios.references import references_in
from policies.command import Command
from policies.routers.local import LocalRouter, Rule

FOLDER = Path("docs/results/cooperation")
"""Where the figures are, SCENARIO.csv; those of your own scenarios are beside its references."""

LEAST_SELFISH, LEAST_FIXED = 1.15, 1.03

RADIUS = 3
"""How far local rules may see, as policies do in these scenarios."""

PRICES = (0.5, 1, 2, 4, 8, 16, 100)

SELFISH = LocalRouter(radius=None)
DETOUR = LocalRouter(radius=None, price=PRICES[-1])
"""Prices so high that it makes long detours around nearly full edges."""

RULES = (
    LocalRouter(rule="random", radius=None),
    LocalRouter(rule="greedy", radius=None),
    *(LocalRouter(radius=near) for near in (1, 2, RADIUS, None)),
    *(LocalRouter(radius=near, price=p) for near in (1, 2, RADIUS, None) for p in PRICES),
    *(
        LocalRouter(radius=radius, price=p, seen=True)
        for radius in (2, RADIUS, None)
        for p in PRICES
    ),
)

NO_SHORT_CUT = "braess-v0 without its short-cut"


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a rule costs on a split; the columns of a file.

    Attributes:
        scenario: its name.
        split: ``validation`` or ``test``.
        rule, radius, price, seen: the rule; the radius is None for the whole grid.
        problems: number of problems.
        solved: how many have no open task and no overflow.
        open: open two-pin tasks, not nets.
        wirelength: of all routes.
        reference: cost of the references: their wirelength where they have no overflow.
        cost: see the module.
        seconds: of processor time.
    """

    scenario: str
    split: str
    rule: Rule
    radius: int | None
    price: float
    seen: bool
    problems: int
    solved: int
    open: int
    wirelength: int
    reference: float
    cost: float
    seconds: float

    @property
    def local(self) -> bool:
        """Whether the rule sees no further than policies do."""
        return self.rule != "shortest" or (self.radius is not None and self.radius <= RADIUS)

    @property
    def router(self) -> LocalRouter:
        """The rule."""
        return LocalRouter(self.rule, self.radius, self.price, self.seen)


def measure(
    scenario: Scenario,
    split: scenarios.Split,
    rule: LocalRouter,
    played: Sequence[Problem] | None = None,
) -> Row:
    """What a rule costs on a split of a scenario, or on ``played`` in place of its problems."""
    problems = list(scenario.problems(split).values())
    reference = scenario.reference_cost(split)
    began = time.process_time()
    engine = rule.play(problems if played is None else played, rules_of(scenario.name))
    seconds = time.process_time() - began
    found = [engine.metrics(m) for m in range(len(problems))]
    open_tasks = [metrics.tasks - metrics.joined for metrics in found]
    wirelength = sum(metrics.wirelength for metrics in found)
    overflow = sum(metrics.overflow for metrics in found)
    return Row(
        scenario=scenario.name,
        split=split,
        rule=rule.rule,
        radius=rule.radius,
        price=rule.price,
        seen=rule.seen,
        problems=len(problems),
        solved=sum(not (m.tasks > m.joined or m.overflow) for m in found),
        open=sum(open_tasks),
        wirelength=wirelength,
        reference=reference,
        cost=round(scenario.cost(wirelength, sum(open_tasks), overflow) / reference, 4),
        seconds=round(seconds, 3),
    )


def measure_all(scenario: Scenario) -> Iterator[Row]:
    """The rows of a scenario."""
    _ = SELFISH.play(scenario.test[:1], rules_of(scenario.name))  # compiles
    for split in scenarios.SPLITS[1:]:
        for rule in RULES:
            yield measure(scenario, split, rule)
    if scenario.name == "braess-v0":
        closed = Scenario("braess-v0", Braess(short_cut=False), validation=50, test=100)
        row = measure(scenario, "test", SELFISH, closed.test)
        yield replace(row, scenario=NO_SHORT_CUT)


def best_local(rows: Iterable[Row]) -> dict[str, Row]:
    """By split, the local rule that is the best one on the validation problems."""
    local = [row for row in rows if row.local]
    best = min((row for row in local if row.split == "validation"), key=lambda row: row.cost)
    return {row.split: row for row in local if row.router == best.router}


def write_rows(scenario: Scenario, rows: Sequence[Row]) -> None:
    """Writes the file of a scenario, and the cost of the best local rule to its references."""
    text = io.StringIO()
    names = [field.name for field in fields(Row)]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        values = (getattr(row, name) for name in names)
        writer.writerow(
            [value if isinstance(value, str) else json.dumps(value) for value in values]
        )
    path = file_of(scenario)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.getvalue())
    kept = json.loads(read_text(scenario.references, 2**24))
    kept["heuristic"] = {split: row.cost for split, row in best_local(rows).items()}
    what = "problems on which every local rule costs more than the references, or policies have "
    what += f"nothing to learn; found rules that cost {kept['heuristic']} ({path})"
    check(scenario.name, min(kept["heuristic"].values()) > 1, what)
    write_text(scenario.references, json.dumps(kept, indent=1) + "\n")
    references_in.cache_clear()


def file_of(scenario: Scenario) -> Path:
    """The file with the figures of a scenario."""
    own = scenario not in COOPERATION
    return scenario.references.with_suffix(".csv") if own else FOLDER / f"{scenario.name}.csv"


def read_rows(path: Path) -> list[Row]:
    """The rows of a file that :func:`write_rows` wrote."""
    rows = []
    for line in csv.DictReader(io.StringIO(read_text(path, 2**24))):
        values: dict[str, Any] = {
            field.name: line[field.name]
            if field.type in (str, Rule)
            else json.loads(line[field.name])
            for field in fields(Row)
        }
        rows.append(Row(**values))
    return rows


def refused(rows: Sequence[Row]) -> str:
    """Why a scenario is not worth playing; empty if it is."""
    test = [row for row in rows if row.split == "test" and row.scenario != NO_SHORT_CUT]
    selfish = next(row for row in test if row.router == SELFISH)
    least = min(test, key=lambda row: row.cost)
    if selfish.cost < LEAST_SELFISH:
        return f"selfish nets cost {selfish.cost:.3f}, less than {LEAST_SELFISH}"
    if least.cost < LEAST_FIXED:
        return f"a fixed rule costs {least.cost:.3f}, less than {LEAST_FIXED}: {rule_text(least)}"
    return ""


def rule_text(row: Row) -> str:
    """A rule in a table's words."""
    if row.rule != "shortest":
        return row.rule
    sight = "full sight" if row.radius is None else f"radius {row.radius}"
    price = f", price {row.price:g}" if row.price else ""
    return f"{sight}{price}" + (" if others are seen" if row.seen else "")


def table(files: Iterable[Path]) -> Iterator[str]:
    """The lines of the table of docs/cooperation.md."""
    columns = "random", "greedy", "best local rule", "always detour", "selfish", "best of all rules"
    yield f"| scenario | {' | '.join(columns)} |"
    yield "|---|---:|---:|---|---:|---:|---|"
    for path in files:
        rows = read_rows(path)
        test = [row for row in rows if row.split == "test" and row.scenario != NO_SHORT_CUT]
        random, greedy, detour, selfish = (
            f"{next(row.cost for row in test if row.router == rule):.3f}"
            for rule in (*RULES[:2], DETOUR, SELFISH)
        )
        local, least = best_local(rows)["test"], min(test, key=lambda row: row.cost)
        best, all_best = (f"{row.cost:.3f}: {rule_text(row)}" for row in (local, least))
        cells = (f"`{path.stem}`", random, greedy, best, detour, selfish, all_best)
        yield f"| {' | '.join(cells)} |"


@click.command(cls=Command)
@click.argument("names", nargs=-1)
@click.option("--table", "shown", is_flag=True, help="Only print the table of what is known.")
def main(names: Sequence[str], shown: bool) -> None:
    """Measures what selfishness costs in scenarios for policies (all, unless NAMES are given).

    module:NAME stands for a scenario of your own, which needs references.
    """
    known = [scenario.name for scenario in COOPERATION]
    for name in names:
        what = f"module:NAME or one of {', '.join(known)}, found {name!r}"
        check("scenario", name in known or ":" in name, what)
    chosen = [scenarios.load(name) for name in names or known]
    for scenario in chosen:
        own = scenario.references.parent != REFERENCES
        what = "one with a file of references"
        check(f"{scenario.name}: scenario", scenario in COOPERATION or own, what)
    if shown:
        click.echo("\n".join(table(map(file_of, chosen))))
        return
    for scenario in chosen:
        rows = list(measure_all(scenario))
        write_rows(scenario, rows)
        best = best_local(rows)["test"]
        why = refused(rows)
        text = f"not worth playing: {why}" if why else "worth playing"
        click.echo(f"{scenario.name}: {best.cost:.3f} by {rule_text(best)}; {text}", err=True)


if __name__ == "__main__":
    main()
