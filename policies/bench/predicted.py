"""Prices of negotiated congestion, predicted by a network: what is left of the oracle's gain.

    python -m policies.bench.predicted --out FILE.json

An oracle that knows the prices at which a long search ends has less overflow after one second
(:mod:`policies.bench.oracle`). Here a small convolution predicts them from the demand of the nets'
first patterns. It is trained on generated problems of 13 to 43 columns and rows, most of which do
not fit at once. The router begins with a share of what it predicts on the problems of
:mod:`policies.bench.negotiation`, at the same processor time as the defaults, the prediction
counted. No price is plain negotiation.
"""

import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from marouting import Problem, generate
from marouting.problem.grid import AXES, VIA_AXIS
from policies.bench.negotiation import families_option, numbers, problems, report
from policies.bench.oracle import play
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter, Routed

SEED = 90_000
"""Of the problems that the network practises on: none of those that are compared."""

LONG_SEEDS = (200, 201)
"""Of the searches whose mean prices are to be predicted."""

CHANNELS = 7
"""Demand per capacity of the edge, of the one across it, and what exceeds 1; one over the capacity;
pins per track; whether there is an edge; the problem's mean demand per capacity."""

_ALONG = (0, 2, 3, 5)
"""The channels that tell of edges along the axis; 1 tells of those across it."""


class Prices(nn.Module):
    """A convolution over the Gcells, for the edges along one axis; the other axis is transposed.

    Residual layers of 3x3, dilated, look 19 Gcells far.
    """

    def __init__(self, units: int = 24, dilations: Sequence[int] = (1, 2, 4, 8, 2, 1)) -> None:
        super().__init__()
        self.first = nn.Conv2d(CHANNELS, units, 3, padding=1)
        self.layers = nn.ModuleList(
            nn.Conv2d(units, units, 3, padding=d, dilation=d) for d in dilations
        )
        self.last = nn.Conv2d(units, 1, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, CHANNELS, columns, rows) to prices (B, columns, rows), in edges."""
        x = self.first(x).relu()
        for layer in self.layers:
            x = x + layer(x).relu()
        return self.last(x)[:, 0]


class Example(NamedTuple):
    """The edges of a problem along one axis."""

    seen: Tensor  # (CHANNELS, columns, rows)
    prices: Tensor  # (columns, rows) those of long searches, in edges


def _along(problem: Problem, values: NDArray[Any], axis: int) -> NDArray[np.float64]:
    """(columns, rows) the sum over the layers of what edges (E,) along an axis have."""
    there = (problem.capacity > 0).reshape(*problem.grid, AXES)[..., axis]
    found = (values.reshape(*problem.grid, AXES)[..., axis] * there).sum(axis=VIA_AXIS)
    return found.T if axis else found


def see(problem: Problem) -> list[Tensor]:
    """What the network sees of the edges along x and along y.

    Returns:
        float32 (CHANNELS, columns, rows) for the edges along x, (CHANNELS, rows, columns) for those
        along y.
    """
    demand = PathfinderRouter(PathfinderOptions(passes=1)).solve(problem).solution.edge_demand
    capacity = [_along(problem, problem.capacity, axis) for axis in range(VIA_AXIS)]
    used = [
        _along(problem, demand, axis) / np.maximum(capacity[axis], 1) for axis in range(VIA_AXIS)
    ]
    gcells = problem.flat_pin_gcells[1]
    pins = np.bincount(gcells, minlength=len(problem.capacity) // AXES)
    pins = pins.reshape(problem.grid).sum(axis=VIA_AXIS)
    seen = []
    for axis in range(VIA_AXIS):
        own = capacity[axis]
        channels = [
            used[axis],
            used[1 - axis].T,
            np.maximum(used[axis] - 1, 0),
            (own > 0) / np.maximum(own, 1),
            (pins.T if axis else pins) / max(own.max(), 1),
            own > 0,
            np.full(own.shape, np.mean([u.mean() for u in used])),
        ]
        seen.append(torch.from_numpy(np.stack(channels).astype(np.float32)))
    return seen


def practice(index: int, longest: float) -> list[Example]:
    """A generated problem with the mean prices of long searches; nothing if one proves its optimum.

    Args:
        index: which problem.
        longest: most processor seconds of a search.
    """
    rng = np.random.default_rng(SEED + index)
    columns, rows = (int(rng.choice((16, 24, 32, 32, 40)) + rng.integers(-3, 4)) for _ in range(2))
    nets, most = int(columns * rows * rng.uniform(0.3, 0.7)), int(rng.integers(2, 6))
    share = rng.uniform(0.6, 0.92)  # of the capacity that the first patterns would take

    def made(capacity: int) -> Problem:
        grid = (columns, rows, 2)
        return generate(1, grid, nets=nets, max_pins=most, capacity=capacity, seed=SEED + index)[0]

    def solved(problem: Problem, **options: Any) -> Routed:
        return PathfinderRouter(PathfinderOptions(**options)).solve(problem)

    edges = columns * (rows - 1) + rows * (columns - 1)
    length = solved(made(1000), passes=1).history[0].wirelength
    problem = made(max(2, round(length / edges / share)))
    seconds = min(max(nets * most / 400, 1.5), longest)
    found = [solved(problem, seconds=seconds, seed=seed) for seed in LONG_SEEDS]
    if any(routed.stop == "optimal" for routed in found):
        return []
    prices = np.mean([routed.prices for routed in found], axis=0)
    layers = [_along(problem, problem.capacity > 0, axis) for axis in range(VIA_AXIS)]
    return [
        Example(seen, torch.from_numpy(_along(problem, prices, axis) / np.maximum(n, 1)).float())
        for axis, (seen, n) in enumerate(zip(see(problem), layers, strict=True))
    ]


def _flipped(example: Example, rng: np.random.Generator) -> Example:
    """The same turned round along either axis. An edge is where its lower Gcell is."""
    seen, prices = example.seen.clone(), example.prices
    if rng.random() < 0.5:
        seen, prices = seen.flip(1), prices.flip(0).roll(-1, 0)
        for channel in _ALONG:
            seen[channel] = seen[channel].roll(-1, 0)
    if rng.random() < 0.5:
        seen, prices = seen.flip(2), prices.flip(1)
        seen[1] = seen[1].roll(-1, 1)
    return Example(seen, prices)


def loss_of(network: Prices, example: Example) -> Tensor:
    """Huber's loss of the prices, in relation to their mean in the problem."""
    level = example.prices.mean() + 0.3
    there = example.seen[5]
    wrong = network(example.seen[None])[0] / level - example.prices / level
    huber = nn.functional.huber_loss(wrong, torch.zeros_like(wrong), reduction="none", delta=2.0)
    return (huber * there).sum() / there.sum()


def train(examples: Sequence[Example], epochs: int) -> Prices:
    """The network, trained with four examples to a gradient step."""
    torch.manual_seed(0)
    rng, network, batch = np.random.default_rng(0), Prices(), 4
    steps = epochs * len(examples) // batch
    optimiser = torch.optim.AdamW(network.parameters(), weight_decay=1e-4)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps + 1)
    for step in range(steps):
        optimiser.zero_grad()
        chosen = [_flipped(examples[k], rng) for k in rng.integers(0, len(examples), batch)]
        loss = torch.stack([loss_of(network, example) for example in chosen]).mean()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        rate.step()
        if step % max(1, steps // 10) == 0:
            click.echo(f"step {step} of {steps}: loss {loss.item():.3f}", err=True)
    return network


@torch.no_grad()
def predict(network: Prices, problem: Problem) -> NDArray[np.float64]:
    """(E,) the prices of a problem's edges, in edges; 0 across layers."""
    prices = np.zeros((*problem.grid, AXES))
    for axis, seen in enumerate(see(problem)):
        found = network(seen[None])[0].relu().double().numpy()
        prices[..., axis] = (found.T if axis else found)[..., None]
    return np.where(problem.capacity > 0, prices.reshape(-1), 0.0)


def compared(
    network: Prices, family: str, seeds: int, seconds: float, shares: Sequence[float]
) -> Iterator[dict[str, Any]]:
    """Rows of the defaults and of searches that begin with shares of what is predicted."""
    for index, problem in enumerate(problems(family)):
        for seed in range(seeds):
            for share in (0.0, *shares):
                began = time.process_time()
                prices = share * predict(network, problem) if share else None
                left = seconds - (time.process_time() - began)
                router = f"predicted x {share:g}" if share else "defaults"
                where = {"family": family, "problem": index, "seconds": seconds, "seed": seed}
                options = {"seconds": left, "seed": seed}
                yield {"router": router, **where, **play(problem, options, prices)}


@click.command()
@families_option
@click.option("--seeds", default=3, show_default=True, help="Seeds of the router per problem.")
@click.option(
    "--seconds",
    default="1",
    show_default=True,
    callback=numbers,
    help="Processor time: 0.3,1,5.",
)
@click.option(
    "--shares",
    default="0.15,0.3",
    show_default=True,
    callback=numbers,
    help="Of the predicted prices.",
)
@click.option("--count", default=150, show_default=True, help="Problems to practise on.")
@click.option("--longest", default=6.0, show_default=True, help="Time of their searches.")
@click.option("--epochs", default=80, show_default=True, help="Of the training.")
@click.option("--out", type=Path, required=True, help="The JSON file to write.")
def main(
    families: list[str],
    seeds: int,
    seconds: list[float],
    shares: list[float],
    count: int,
    longest: float,
    epochs: int,
    out: Path,
) -> None:
    """Measures what predicted prices bring; writes rows to a file, a table to standard output."""
    torch.set_num_threads(1)
    examples: list[Example] = []
    for index in range(count):
        examples += practice(index, longest)
        click.echo(f"problem {index + 1} of {count}: {len(examples)} examples", err=True)
    network = train(examples, epochs)
    found = (
        compared(network, family, seeds, limit, shares)
        for limit, family in itertools.product(seconds, families)
    )
    report(itertools.chain.from_iterable(found), out)


if __name__ == "__main__":
    main()
