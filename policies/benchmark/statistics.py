"""What a result file says, in a few figures.

Scores are averaged by their **interquartile mean**: the mean of the middle half, over all problems
and seeds, as Agarwal et al. propose ("Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021). Its 95 % interval comes from a bootstrap in two stages: problems are
drawn with replacement, and for each of them seeds with replacement.
"""

import statistics
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from policies.benchmark.result import Outcome, Result
from policies.benchmark.score import Figures
from policies.results.statistics import CONFIDENCE, gap

RESAMPLES = 2000

_CUT = 0.25
"""The share of values left out at each end."""


def interquartile_mean(values: NDArray[np.float64]) -> float:
    """The mean of the middle half of (n,) values."""
    return float(trim_mean(values, _CUT))


def interval(scores: NDArray[np.float64]) -> tuple[float, float]:
    """The 95 % bootstrap interval of the interquartile mean.

    Args:
        scores: (problems, seeds).
    """
    rng = np.random.default_rng(0)
    problems, seeds = scores.shape
    drawn = rng.integers(problems, size=(RESAMPLES, problems, 1))
    of = rng.integers(seeds, size=(RESAMPLES, problems, seeds))
    means = trim_mean(scores[drawn, of].reshape(RESAMPLES, -1), _CUT, axis=1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def summarise(result: Result) -> dict[str, Any]:
    """The figures of a result, None where something is not known.

    Returns:
        ``name``, ``scenario``, ``split``, ``router``, ``budget``, the numbers of ``problems`` and
        ``seeds``;
        ``score``: ``mean`` (interquartile), ``low`` and ``high``;
        ``open``: problems with open nets, and ``overflow``: the total in tracks, averaged over the
        seeds;
        ``gap``: mean wirelength above the reference's in %, of the solutions with as few open nets
        and as little overflow, and ``gap_problems``, how many problems have one;
        ``at_reference``: percent of the solutions that are as good as the reference, and
        ``proven``: percent of the problems whose reference is proven;
        ``wins``, ``ties`` and ``losses`` against A*, averaged over the seeds;
        ``solution_seconds``: the median time per problem and seed, ``seconds`` and
        ``training_seconds``: see :class:`policies.benchmark.result.Result`.
    """
    rows = result.outcomes
    problems, seeds = len(result.tasks), len(rows) // len(result.tasks)
    known = [row.figures for row in rows]
    times = [row.seconds for row in rows if row.seconds is not None]
    summary = {
        "name": result.name,
        "scenario": result.scenario,
        "split": result.split,
        "router": result.router,
        "budget": result.budget,
        "problems": problems,
        "seeds": seeds,
        "overflow": _whole(sum(row.overflow for row in rows) / seeds),
        "proven": 100 * sum(task.proven for task in result.tasks) / problems,
        "solution_seconds": statistics.median(times) if len(times) == len(rows) else None,
        "seconds": result.seconds,
        "training_seconds": result.training_seconds,
    }
    figures = [found for found in known if found is not None]
    if len(figures) < len(rows):
        unknown = ("score", "open", "gap", "gap_problems", "at_reference", "wins", "ties", "losses")
        return {**summary, **dict.fromkeys(unknown)}
    scores = score_table(result)
    low, high = interval(scores)
    references = [Figures(*result.by_name[row.problem].reference) for row in rows]
    astars = [Figures(*result.by_name[row.problem].astar) for row in rows]
    found = zip(rows, figures, references, strict=True)
    above = [(row.problem, gap(own, best)) for row, own, best in found]
    gaps = [(problem, percent) for problem, percent in above if percent is not None]
    return {
        **summary,
        "score": {"mean": interquartile_mean(scores.ravel()), "low": low, "high": high},
        "open": _whole(sum(own.open > 0 for own in figures) / seeds),
        "gap": statistics.fmean(percent for _, percent in gaps) if gaps else None,
        "gap_problems": len({problem for problem, _ in gaps}),
        "at_reference": 100
        * sum(own <= best for own, best in zip(figures, references, strict=True))
        / len(rows),
        "wins": _whole(sum(a < b for a, b in zip(figures, astars, strict=True)) / seeds),
        "ties": _whole(sum(a == b for a, b in zip(figures, astars, strict=True)) / seeds),
        "losses": _whole(sum(a > b for a, b in zip(figures, astars, strict=True)) / seeds),
    }


def score_table(result: Result) -> NDArray[np.float64]:
    """(problems, seeds) scores; every row must have one."""
    own: dict[str, list[Outcome]] = {task.problem: [] for task in result.tasks}
    for row in result.outcomes:
        own[row.problem].append(row)
    return np.array([[row.score for row in rows] for rows in own.values()], np.float64)


def _whole(value: float) -> float:
    """An int if it is whole."""
    return int(value) if value == int(value) else value
