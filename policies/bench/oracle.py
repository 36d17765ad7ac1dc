"""How much less negotiated congestion would overflow if it knew more: an upper bound on learning.

    python -m policies.bench.oracle prices --out FILE.json
    python -m policies.bench.oracle evolved --out FILE.json

``prices`` lets the router begin with the prices at which a long search of the same problem ended,
as they are and at a half. ``evolved`` is the router whose schedule was learned
(:mod:`policies.routers.pathfinder.evolved`). Both are compared with the defaults at the same
processor time, on the problems of :mod:`policies.bench.negotiation`.
"""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from marouting import Problem, evaluate
from policies.bench.negotiation import (
    families_option,
    numbers,
    problems,
    report,
)
from policies.routers.base import warm_up
from policies.routers.pathfinder import EvolvedRouter, PathfinderOptions, PathfinderRouter

SCALES = (1.0, 0.5)
"""Shares of the converged prices that a search begins with."""

EVOLVED = "evolved"
"""The router whose schedule was learned."""

LONG_SEED = 100
"""Seed of the searches that find the prices: none of those that are compared."""


def play(
    problem: Problem,
    options: dict[str, Any],
    prices: Any = None,
    router: type[PathfinderRouter] = PathfinderRouter,
) -> dict[str, int]:
    """Routes a problem: overflow and wirelength."""
    routed = router(router.Options(**options)).solve(problem, prices=prices)
    figures = evaluate(problem, routed.solution)
    return {"overflow": figures.overflow, "wirelength": figures.wirelength}


def with_prices(
    family: str, seeds: int, times: Sequence[float], long: float
) -> Iterator[dict[str, Any]]:
    """Rows of the defaults, of the long search, and of searches that begin with its prices."""
    for index, problem in enumerate(problems(family)):
        router = PathfinderRouter(PathfinderOptions(seconds=long, seed=LONG_SEED))
        prices = router.solve(problem).prices
        for seconds, seed in itertools.product(times, range(seeds)):
            where = {"family": family, "problem": index, "seconds": seconds}
            options = {"seconds": seconds, "seed": seed}
            yield {"router": "defaults", **where, "seed": seed, **play(problem, options)}
            for scale in SCALES:
                row = play(problem, options, scale * prices)
                yield {"router": f"prices x {scale:g}", **where, "seed": seed, **row}


def with_evolved(family: str, seeds: int, times: Sequence[float]) -> Iterator[dict[str, Any]]:
    """Rows of the defaults, and of the router whose schedule was learned."""
    for seconds, (index, problem) in itertools.product(times, enumerate(problems(family))):
        where = {"family": family, "problem": index, "seconds": seconds}
        for seed in range(seeds):
            options = {"seconds": seconds, "seed": seed}
            yield {"router": "defaults", **where, "seed": seed, **play(problem, options)}
            found = play(problem, options, router=EvolvedRouter)
            yield {"router": EVOLVED, **where, "seed": seed, **found}


@click.command()
@click.argument("oracle", type=click.Choice(("prices", EVOLVED)))
@families_option
@click.option("--seeds", default=3, show_default=True, help="Seeds of the router per problem.")
@click.option(
    "--seconds",
    default="1",
    show_default=True,
    callback=numbers,
    help="Processor time of a search: 1,5.",
)
@click.option("--long", default=30.0, show_default=True, help="The same where prices are found.")
@click.option("--out", type=Path, required=True, help="The JSON file to write.")
def main(
    oracle: str,
    families: list[str],
    seeds: int,
    seconds: list[float],
    long: float,
    out: Path,
) -> None:
    """Measures what an oracle brings; writes rows to a file, a table to standard output."""
    for router in (PathfinderRouter, EvolvedRouter):
        warm_up(router())

    def rows(family: str) -> Iterator[dict[str, Any]]:
        if oracle == EVOLVED:
            return with_evolved(family, seeds, seconds)
        return with_prices(family, seeds, seconds, long)

    report(itertools.chain.from_iterable(map(rows, families)), out)


if __name__ == "__main__":
    main()
