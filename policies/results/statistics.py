"""Statistics of an experiment's rows: gaps, wins, means and their intervals.

A row is one router on one problem with one seed. Every figure is computed for each row, then
averaged over a problem's seeds, and then summed or averaged over the problems. Intervals are taken
over the problems, spreads over the seeds.
"""

import itertools
import math
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from policies.results.rows import Row

CONFIDENCE = 0.95
"""The confidence level of all intervals."""

ALL = "all"
"""The name of all sets together, which no set may have."""

_Problems = Mapping[tuple[str, str], Sequence[Row]]
"""The rows of one router by set and problem, one for each seed; none where it has no results."""


def rank(row: Mapping[str, Any]) -> tuple[int, int, int]:
    """Open tasks, overflow and wirelength: solutions compare by these in turn, lower is better.

    Published rows do not say how many two-pin tasks are open; all count as joined.
    """
    open_tasks = 0 if row["joined"] is None else row["tasks"] - row["joined"]
    return open_tasks, row["overflow"], row["wirelength"]


def add_gaps(rows: Sequence[Row]) -> None:
    """Fills in ``gap`` of every row: its wirelength above the proven optimum's, in %.

    The gap is None if no row of the problem is proven optimal, or if the solution has open tasks or
    overflow that the optimum lacks: its wirelength is then not comparable. It is also None for an
    optimum of 0, if every net lies in one Gcell.
    """
    optimum: dict[tuple[str, str], Row] = {}
    for row in rows:
        if row["proven"]:
            optimum.setdefault((row["set"], row["problem"]), row)
    for row in rows:
        best = optimum.get((row["set"], row["problem"]))
        row["gap"] = None if best is None else gap(rank(row), rank(best))


def gap(found: tuple[int, int, int], best: tuple[int, int, int]) -> float | None:
    """How far one :func:`rank` is above the optimum's, in %; None as in :func:`add_gaps`."""
    if found[:2] != best[:2]:
        return None
    if found[2] == best[2]:
        return 0.0
    return 100 * (found[2] / best[2] - 1) if best[2] else None


def mean_interval(values: NDArray[np.float64]) -> dict[str, float | None]:
    """The mean of (n,) values and its 95 % interval by Student's t.

    Returns:
        ``mean``, ``low`` and ``high``; None where there are too few values.
    """
    from scipy.special import stdtrit  # takes as long to import as all else that commands need

    count = len(values)
    mean = float(values.mean()) if count else None
    if mean is None or count < 2:
        return {"mean": mean, "low": None, "high": None}
    half = float(stdtrit(count - 1, (1 + CONFIDENCE) / 2) * values.std(ddof=1) / math.sqrt(count))
    return {"mean": mean, "low": mean - half, "high": mean + half}


def share_interval(share: float, count: int) -> tuple[float, float]:
    """The 95 % interval of a share of ``count`` problems by Wilson's score (1927)."""
    from scipy.special import ndtri

    z = float(ndtri((1 + CONFIDENCE) / 2))
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2) / (1 + z * z / count)
    # At the ends the bounds are exact, and rounding would show: 5.55e-15 in place of 0.
    low = 0.0 if share == 0 else max(centre - half, 0.0)
    return low, 1.0 if share == 1 else min(centre + half, 1.0)


RESAMPLES = 2000
"""Of a bootstrap."""

_CUT = 0.25
"""The share of values that an interquartile mean leaves out at each end."""


def interquartile_mean(values: NDArray[np.float64]) -> float:
    """The mean of the middle half of (n,) values."""
    return float(_trimmed(values))


def _trimmed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The means of the middle halves along the last axis."""
    count = values.shape[-1]
    cut = int(_CUT * count)
    return np.asarray(np.sort(values)[..., cut : count - cut].mean(axis=-1))


def bootstrap_interval(scores: NDArray[np.float64]) -> tuple[float, float]:
    """The 95 % interval of the interquartile mean of (problems, seeds) scores.

    It comes from a bootstrap in two stages: problems are drawn with replacement, and for each of
    them seeds with replacement (Agarwal et al., "Deep reinforcement learning at the edge of the
    statistical precipice", NeurIPS 2021).
    """
    rng = np.random.default_rng(0)
    problems, seeds = scores.shape
    drawn = rng.integers(problems, size=(RESAMPLES, problems, 1))
    seed = rng.integers(seeds, size=(RESAMPLES, problems, seeds))
    means = _trimmed(scores[drawn, seed].reshape(RESAMPLES, -1))
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def by_router(rows: Sequence[Row]) -> dict[str, dict[tuple[str, str], list[Row]]]:
    """The rows by router, and then by set and problem, one for each seed, in their order.

    Every router has the same problems, those of all the rows, some of them perhaps without a row.
    """
    problems = dict.fromkeys((row["set"], row["problem"]) for row in rows)
    grouped: dict[str, dict[tuple[str, str], list[Row]]] = {}
    for row in rows:
        own = grouped.setdefault(row["router"], {problem: [] for problem in problems})
        own[row["set"], row["problem"]].append(row)
    return grouped


def by_set(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows by set; if there are several, also ``all``: those of the routers run on all sets."""
    grouped: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        grouped[row["set"]].append(row)
    sets = dict(grouped)
    on: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        on[row["router"]].add(row["set"])
    everywhere = {name for name, own in on.items() if own == sets.keys()}
    if len(sets) > 1 and everywhere:
        sets[ALL] = [row for row in rows if row["router"] in everywhere]
    return sets


def baseline(rows: Sequence[Row]) -> str | None:
    """The router that others are compared with as A*: the first of kind ``astar``."""
    return next((row["router"] for row in rows if row["kind"] == "astar"), None)


def mean_over_seeds(problems: _Problems, column: str) -> NDArray[np.float64]:
    """(problems,) a column, averaged over the seeds; NaN where nothing is known.

    Beside ``gap``, rows with open tasks do not count: less wirelength is no merit there.
    """

    def value(row: Row) -> float | None:
        return None if column != "gap" and rank(row)[0] else row[column]

    return _over_seeds(_values(problems, value))


def _values(problems: _Problems, value: Callable[[Row], float | None]) -> NDArray[np.float64]:
    """(problems, seeds) a value of every row; NaN for None, and where there is no row."""
    return _array([[value(row) for row in rows] for rows in problems.values()])


def _array(values: Sequence[Sequence[float | None]]) -> NDArray[np.float64]:
    """(problems, seeds) values; NaN for None, and where a problem has fewer than another."""
    columns = list(itertools.zip_longest(*values))
    return np.array(columns, np.float64).reshape(-1, len(values)).T


def _against(
    problems: _Problems, others: _Problems, value: Callable[[Row, Row], float]
) -> NDArray[np.float64]:
    """(problems, seeds) a value of every row and the other router's, seed by seed, as above."""

    def pairs(rows: Sequence[Row], other: Sequence[Row]) -> list[tuple[Row, Row]]:
        # A router without seeds has one row, which is compared with all seeds of the other.
        count = max(len(rows), len(other)) if rows and other else 0
        cycles = itertools.cycle(rows), itertools.cycle(other)
        return list(itertools.islice(zip(*cycles, strict=False), count))

    return _array(
        [[value(*pair) for pair in pairs(rows, others[key])] for key, rows in problems.items()]
    )


def _over_seeds(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(problems,) the means over the seeds, ignoring NaN."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a mean of nothing but NaN
        return np.asarray(np.nanmean(values, axis=1), np.float64)


def summarise(rows: Sequence[Row], reference: str | None = None) -> list[dict[str, Any]]:
    """A summary of each router, in the order of the rows.

    Args:
        rows: the rows of one set of problems, or of several taken as one.
        reference: a router to compare all others with, besides A*.

    Returns:
        For each router, of the problems that it has rows on:

        ``router``, ``kind``, and the numbers of ``problems`` and ``seeds``;
        ``overflow``, the total in tracks; ``zero_overflow``, the number of problems without
        overflow and without open tasks; ``open``, the total of open two-pin tasks, not nets;
        ``wirelength``: ``mean``, ``low`` and ``high`` (95 % by Student's t over the problems);
        ``pruned_wirelength``: the same without dangling branches and loops, None if a row lacks it;
        ``gap``: the same for the gap to the optimum in %, and ``problems``, on how many it is
        known;
        ``lower_wirelength``: ``percent`` of the problems with less wirelength than A* and no more
        open tasks, ``low`` and ``high`` (95 % by Wilson's score);
        ``paper_wins``: the same, however many tasks are open (the paper's wins);
        ``against_astar`` and ``against_reference``: ``wins``, ``ties`` and ``losses`` by
        :func:`rank`, on the problems that both have rows on;
        ``seconds``: the median over the problems;
        ``spread``: standard deviations over the seeds of the set's figures; None for one seed.

        A figure that is not known is None. With several seeds, counts need not be whole numbers.
    """
    grouped = by_router(rows)
    astar = baseline(rows)
    return [
        _summary(
            name,
            problems,
            None if astar in (None, name) else grouped[astar],
            None if reference == name else grouped.get(reference or ""),
        )
        for name, problems in grouped.items()
    ]


def _summary(
    name: str, problems: _Problems, astar: _Problems | None, reference: _Problems | None
) -> dict[str, Any]:
    problems = {key: rows for key, rows in problems.items() if rows}
    seeds = max(map(len, problems.values()))
    overflow = _values(problems, lambda row: row["overflow"])
    wirelength = _values(problems, lambda row: row["wirelength"])
    clean = _values(problems, lambda row: rank(row)[:2] == (0, 0))
    pruned = _over_seeds(_values(problems, lambda row: row.get("pruned_wirelength")))
    gap = _values(problems, lambda row: row["gap"])
    lower = None if astar is None else _against(problems, astar, _is_lower)
    shorter = None if astar is None else _against(problems, astar, _is_shorter)
    gaps = _over_seeds(gap)
    gaps = gaps[~np.isnan(gaps)]
    seconds = _over_seeds(_values(problems, lambda row: row["seconds"]))
    return {
        "router": name,
        "kind": next(iter(problems.values()))[0]["kind"],
        "problems": len(problems),
        "seeds": seeds,
        "overflow": _total(overflow),
        "zero_overflow": _total(clean),
        "open": _total(_values(problems, lambda row: rank(row)[0])),
        "wirelength": mean_interval(_over_seeds(wirelength)),
        "pruned_wirelength": None if np.isnan(pruned).any() else mean_interval(pruned),
        "gap": {**mean_interval(gaps), "problems": len(gaps)} if len(gaps) else None,
        "lower_wirelength": None if lower is None else _share(lower),
        "paper_wins": None if shorter is None else _share(shorter),
        "against_astar": None if astar is None else _record(problems, astar),
        "against_reference": None if reference is None else _record(problems, reference),
        "seconds": None if np.isnan(seconds).any() else float(np.median(seconds)),
        "spread": None
        if seeds == 1
        else {
            "overflow": _spread(overflow.sum(axis=0)),
            "zero_overflow": _spread(clean.sum(axis=0)),
            "wirelength": _spread(wirelength.mean(axis=0)),
            "gap": _spread(_over_seeds(gap.T)),
            "lower_wirelength": None if lower is None else _spread(100 * lower.mean(axis=0)),
        },
    }


def _is_lower(row: Row, other: Row) -> float:
    """Whether a row has less wirelength than another and no more open tasks."""
    return rank(row)[0] <= rank(other)[0] and _is_shorter(row, other)


def _is_shorter(row: Row, other: Row) -> bool:
    """Whether a row has less wirelength than another."""
    return bool(row["wirelength"] < other["wirelength"])


def _record(problems: _Problems, others: _Problems) -> dict[str, float] | None:
    """Wins, ties and losses against another router; None if no problem has rows of both."""

    def sign(row: Row, other: Row) -> int:
        return (rank(row) > rank(other)) - (rank(row) < rank(other))

    signs = _against(problems, others, sign)
    unknown = np.isnan(signs)
    if unknown.all():
        return None
    results = {"wins": signs < 0, "ties": signs == 0, "losses": signs > 0}
    return {name: _total(np.where(unknown, np.nan, holds)) for name, holds in results.items()}


def _share(holds: NDArray[np.float64]) -> dict[str, float] | None:
    """The share of problems where a condition (problems, seeds) holds, and its interval, in %."""
    known = _over_seeds(holds)
    known = known[~np.isnan(known)]
    if not len(known):
        return None
    share = float(known.mean())
    low, high = share_interval(share, len(known))
    return {"percent": 100 * share, "low": 100 * low, "high": 100 * high}


def _total(values: NDArray[np.float64]) -> float:
    """The sum over the problems of the means over the seeds; an int if it is whole."""
    total = float(np.nansum(_over_seeds(values)))
    return round(total) if math.isclose(total, round(total), abs_tol=1e-9) else total


def _spread(of_seeds: NDArray[Any]) -> float | None:
    """The standard deviation of (seeds,) figures; None if there are none, or one of them is NaN."""
    known = len(of_seeds) and not np.isnan(of_seeds).any()
    return float(np.std(of_seeds, ddof=1)) if known else None
