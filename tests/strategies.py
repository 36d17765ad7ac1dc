"""Hypothesis strategies for small problems and their solutions; used by several test files."""

import numpy as np
from hypothesis import strategies as st

from marouting import Adjustment, Net, Pin, Problem, Solution

names = st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1, max_size=6)
numbers = st.integers(0, 9)


@st.composite
def problems(draw: st.DrawFn, max_side: int = 5, max_layers: int = 3, max_nets: int = 6) -> Problem:
    """Valid problems: any layers, widths, spacings, origin, tile, adjustments; pins may repeat."""
    side = st.integers(1, max_side)
    grid = draw(st.tuples(side, side, st.integers(1, max_layers)))
    origin = draw(st.tuples(st.integers(-30, 30), st.integers(-30, 30)))
    tile = draw(st.tuples(st.integers(1, 12), st.integers(1, 12)))
    layer = st.tuples(*[numbers] * grid[2])
    pins = st.builds(
        Pin,
        st.integers(origin[0], origin[0] + grid[0] * tile[0] - 1),
        st.integers(origin[1], origin[1] + grid[1] * tile[1] - 1),
        st.integers(1, grid[2]),
    )
    nets = st.builds(
        Net,
        names,
        st.integers(0, 10**9),
        st.lists(pins, min_size=1, max_size=5).map(tuple),
        numbers,
    )
    return Problem(
        grid=grid,
        vertical_capacity=draw(layer),
        horizontal_capacity=draw(layer),
        nets=tuple(
            draw(st.lists(nets, min_size=1, max_size=max_nets, unique_by=lambda net: net.name))
        ),
        min_width=draw(layer),
        min_spacing=draw(layer),
        via_spacing=draw(layer),
        origin=origin,
        tile=tile,
        adjustments=draw(_adjustments(grid)),
    )


@st.composite
def _adjustments(draw: st.DrawFn, grid: tuple[int, int, int]) -> tuple[Adjustment, ...]:
    """Capacities of some edges, either end first; some of them twice."""
    columns, rows, layers = grid
    edges = [
        ((x, y, z), (x + dx, y + dy, z))
        for x in range(columns)
        for y in range(rows)
        for z in range(1, layers + 1)
        for dx, dy in ((1, 0), (0, 1))
        if x + dx < columns and y + dy < rows
    ]
    if not edges:
        return ()
    found = []
    for near, far in draw(st.lists(st.sampled_from(edges), max_size=5, unique=True)):
        for flipped in draw(st.lists(st.booleans(), min_size=1, max_size=2)):
            first, second = (far, near) if flipped else (near, far)
            found.append(Adjustment(*first, *second, draw(numbers)))
    return tuple(draw(st.permutations(found)))


@st.composite
def solutions(draw: st.DrawFn, problem: Problem) -> Solution:
    """Any edges of the grid for every net, whether they join its pins or not."""
    existing = np.flatnonzero(problem.topology.exists).tolist()
    some = st.lists(st.sampled_from(existing), max_size=25) if existing else st.just([])
    return Solution(problem, tuple(np.array(draw(some), np.int64) for _ in problem.nets))


@st.composite
def solved_problems(draw: st.DrawFn) -> Solution:
    """Solutions of any problem."""
    return draw(solutions(draw(problems())))
