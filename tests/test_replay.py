"""Solutions as games: the moves of a replay lead to the solution's own edges and figures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import problems

from marouting import (
    Engine,
    InputError,
    Problem,
    Solution,
    evaluate,
    generate,
    global_routing_v0,
    sequential_astar,
)
from marouting.game import NOBODY
from marouting.search.guides import AStar, RouteFollower
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

IBM01 = Path(__file__).resolve().parents[2] / "shared/data/ispd98/ibm01.modified.txt"
LONG = 10**6  # steps a task: more than any way needs


def played(engine: Engine, solutions: list[Solution]) -> list[Solution]:
    """The solutions of a game whose agents follow solutions, all of its problems at once."""
    guide = RouteFollower(engine, solutions)
    everyone = not engine.static.sequential
    while (engine.games["agent"] != NOBODY).any():
        m, n = engine.pairs(everyone=everyone)
        moves = guide.moves(m, n)
        engine.step(moves.reshape(engine.nets.shape) if everyone else moves)
    return [engine.solution(m) for m in range(len(solutions))]


@pytest.mark.parametrize("turn_order", ["sequential", "round_robin"])
@pytest.mark.parametrize("decomposition", ["mst", "steiner"])
def test_routes_come_out_as_they_went_in(turn_order: Any, decomposition: Any) -> None:
    sets = generate(4, nets=30, max_pins=4, capacity=6, seed=5)
    routed = [PathfinderRouter(PathfinderOptions(seed=1)).route(problem) for problem in sets]
    assert all(evaluate(p, s).overflow == 0 for p, s in zip(sets, routed, strict=True))
    engine = Engine(
        sets, turn_order=turn_order, max_steps=LONG, nets={"decomposition": decomposition}
    )
    again = played(engine, routed)
    for m, (problem, solution) in enumerate(zip(sets, routed, strict=True)):
        figures, metrics = evaluate(problem, solution), engine.metrics(m)
        if decomposition == "mst":
            assert again[m] == solution
            assert (metrics.overflow, metrics.wirelength) == (0, figures.wirelength)
            assert metrics.joined == metrics.tasks
        else:  # Steiner points off the route are reached by A*, or not at all
            assert evaluate(problem, again[m]).connected or metrics.joined < metrics.tasks


@given(problems(), st.sampled_from(["sequential", "round_robin"]))
def test_overflow_is_replayed_where_it_is_allowed(problem: Problem, turn_order: Any) -> None:
    if not any(len(cells) > 1 for cells in problem.pin_gcells):
        return
    solution = sequential_astar(problem)
    engine = Engine([problem], turn_order=turn_order, max_steps=LONG, overflow="allowed")
    (again,) = played(engine, [solution])
    before, after = evaluate(problem, solution), evaluate(problem, again)
    # Where a net's paths close a circle a replay may leave out a side of it, and no more.
    own = [np.isin(new, old).all() for old, new in zip(solution.edges, again.edges, strict=True)]
    assert all(own)
    assert after.connected
    assert (after.overflow, after.wirelength) <= (before.overflow, before.wirelength)
    assert engine.metrics().wirelength == after.wirelength
    assert engine.metrics().overflow == after.overflow


def test_a_full_edge_is_walked_around() -> None:
    """Where a route may not be followed the game goes on as A* would."""
    (problem,) = generate(1, nets=50, max_pins=3, capacity=4, seed=2)
    solution = sequential_astar(problem)
    assert evaluate(problem, solution).overflow > 0
    engine = Engine([problem])
    (again,) = played(engine, [solution])
    assert evaluate(problem, again).overflow == 0
    alone = Engine([problem])
    guide = AStar(alone)
    while alone.games["agent"][0] != NOBODY:
        alone.step(guide.moves(*alone.pairs(everyone=False)))
    assert engine.metrics().joined >= 0.9 * alone.metrics().joined
    # Nothing to follow at all: A* alone, that of the paper.
    (easy,) = generate(1, nets=10, seed=1)
    nothing = Solution(easy, [np.empty(0, np.int64)] * 10)
    (by_astar,) = played(Engine([easy]), [nothing])
    assert by_astar == sequential_astar(easy)


def test_what_cannot_be_replayed() -> None:
    (problem,), (other,) = generate(1, nets=5, seed=1), generate(1, nets=5, seed=2)
    engine, solution = Engine([problem]), sequential_astar(other)
    with pytest.raises(InputError, match="expected 1 solutions, found 2"):
        RouteFollower(engine, [solution, solution])
    with pytest.raises(InputError, match="solution 0: expected one of a problem with its nets"):
        RouteFollower(engine, [solution])


@pytest.mark.slow
@pytest.mark.skipif(not IBM01.exists(), reason="../shared/data/ispd98 is not there")
def test_ibm01_as_a_game() -> None:
    """11 507 nets, of which 9 128 have something to route; solutions replayed move by move."""
    problem = Problem.read(IBM01)
    assert len(problem.nets) == 11_507

    negotiated = PathfinderRouter(PathfinderOptions(seconds=30)).route(problem)
    env = global_routing_v0.parallel_env(problem, max_steps=2000, overflow="allowed")
    engine = Engine([problem], max_steps=2000, overflow="allowed", turn_order="round_robin")
    for solution in (sequential_astar(problem), negotiated):
        env.reset(seed=0)
        engine.reset()
        assert env.agents == env.possible_agents
        assert len(env.agents) == sum(len(pins) > 1 for pins in problem.pin_gcells) == 9128
        guide = RouteFollower(engine, [solution])
        number = {agent: n for n, agent in enumerate(env.agents)}
        while env.agents:
            moves = guide.moves(*engine.pairs(everyone=True))
            engine.step(moves[None])
            env.step({agent: moves[number[agent]] for agent in env.agents})
        figures, metrics = evaluate(problem, solution), env.metrics()
        assert metrics["joined"] == metrics["tasks"] == figures.tasks
        if solution is negotiated:
            assert env.solution() == solution
            assert (figures.overflow, figures.connected) == (0, True)
            assert figures.wirelength - figures.vias <= 63_611  # BoxRouter 2.0, without vias
        # A* may close circles, of which a replay leaves out a side.
        assert metrics["overflow"] <= figures.overflow
        assert metrics["wirelength"] <= figures.wirelength
        assert metrics["wirelength"] >= 0.99 * figures.wirelength
