"""The plain game and the compiled batch play the same game.

Random problems are played by random options and moves through :class:`marouting.game.Game` and
:class:`marouting.batch.engine.Engine`, and all that others see of them is compared after every
step. Every seed is a problem with options of its own; ``-m slow`` plays many more. Errors planted
in the rules show that the comparison would notice them.
"""

import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seeing import option_state

from marouting import Adjustment, Engine, Net, Pin, Problem
from marouting import game as source
from marouting.batch.state import Option
from marouting.game import NOBODY, Game, Status
from marouting.rules import Mask, Nets, RipUp, Rules

FIRST = (0, 1, 4, 5, 10, 18)
"""These games notice all planted errors between them."""

SEEDS = (*FIRST, *(seed for seed in range(24) if seed not in FIRST))
MANY = range(24, 1500)


def random_problem(rng: np.random.Generator) -> Problem:
    """A small problem with little capacity, odd coordinates, and nets of one to five pins."""
    sides = [(1, 5), (2, 2), (3, 4), (4, 4), (5, 3), (2, 6), (6, 6)][rng.integers(7)]
    columns, rows, layers = grid = (*sides, int(rng.integers(1, 4)))
    tile = [(1, 1), (10, 10), (3, 7)][rng.integers(3)]
    origin = [(0, 0), (-5, 20)][rng.integers(2)]
    most = int(rng.integers(1, 5))

    def pin() -> Pin:
        x, y = rng.integers(0, (columns * tile[0], rows * tile[1])) + np.array(origin)
        return Pin(int(x), int(y), int(rng.integers(1, layers + 1)))

    def numbers(most: int) -> tuple[int, ...]:
        return tuple(rng.integers(0, most + 1, layers).tolist())

    nets = [
        Net(f"n{i}", i, tuple(pin() for _ in range(rng.integers(1, 6))), int(rng.integers(3)))
        for i in range(rng.integers(1, 9))
    ]
    last = Pin(origin[0] + columns * tile[0] - 1, origin[1] + rows * tile[1] - 1, layers)
    ends = Net("ends", 99, (Pin(*origin, 1), last))  # so that there is something to route
    nets.insert(int(rng.integers(len(nets) + 1)), ends)
    edges = [
        ((x, y, z), (x + dx, y + dy, z))
        for x, y, z in np.ndindex(grid)
        for dx, dy in ((1, 0), (0, 1))
        if x + dx < columns and y + dy < rows
    ]
    adjustments = [
        Adjustment(*a[:2], a[2] + 1, *b[:2], b[2] + 1, int(rng.integers(most + 1)))
        for a, b in (edges[i] for i in rng.permutation(len(edges))[: rng.integers(7)])
    ]
    return Problem(
        grid=grid,
        vertical_capacity=numbers(most),
        horizontal_capacity=numbers(most),
        nets=tuple(nets),
        min_width=numbers(2),
        min_spacing=numbers(1),
        via_spacing=(0,) * layers,
        origin=origin,
        tile=tile,
        adjustments=tuple(adjustments),
    )


def random_rules(rng: np.random.Generator) -> dict[str, Any]:
    """Options of the rules: in a quarter of all cases the paper's, otherwise any."""

    def one_of(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    rules: dict[str, Any] = {
        "turn_order": one_of("sequential", "round_robin"),
        "nets": Nets(order=one_of("half_perimeter", "half_perimeter_up", "file")),
        "max_steps": one_of(None, 3, 10, 20),
    }
    if rng.random() < 0.25:
        return rules
    rules |= {
        "overflow": one_of("forbidden", "allowed"),
        "nets": replace(rules["nets"], decomposition=one_of("mst", "mst", "steiner")),
        "target": one_of("pin", "tree"),
        "mask": Mask(visited=one_of(False, True)),
        "release_failed": one_of(False, True),
    }
    if rules["nets"].decomposition == "mst":
        rules["next_pin"] = one_of("listed", "nearest")
    if rng.random() < 0.6:
        rounds = int(rng.integers(1, 4))
        choose = one_of("all", "conflicts", "history", "agents")
        rules["rip_up"] = RipUp(rounds=rounds, choose=choose, neighbours=int(rng.integers(4)))
    if rng.random() < 0.4:
        rules |= {"wait": one_of(False, True), "message_bits": one_of(0, 1, 3, 8)}
    return rules


def state_of_game(game: Game) -> dict[str, Any]:
    """All that others can see of a plain game."""
    return {
        "agent": game.turn,
        "asked": game.asked,
        "round": game.round,
        "metrics": game.metrics(),
        "columns": {name: list(getattr(game, name)) for name in game.COLUMNS},
        "remaining": list(game.remaining),
        "routes": [sorted(used) for used in game.used],
        "trees": [sorted(tree) for tree in game.tree] if game.keeps_tree else [],
        "masks": [mask_of(game, n) for n in range(len(game.nets))],
    }


def mask_of(game: Game, n: int) -> list[int]:
    """An agent's action mask; ones for the six moves if it can do nothing."""
    bits, rules = game.free_moves(n) or 63, game.rules
    return [bits >> action & 1 for action in range(rules.moves)] * 2**rules.message_bits


def state_of_engine(engine: Engine, m: int = 0) -> dict[str, Any]:
    """The same of a game of the batch."""
    count = int((engine.nets[m] != NOBODY).sum())
    agents, game = engine.agents[m, :count], engine.games[m]
    routes = engine.solution(m).edges
    return {
        "agent": int(game["agent"]),
        "asked": bool(game["asked"]),
        "round": int(game["round"]),
        "metrics": vars(engine.metrics(m)),
        "columns": {name: agents[name].tolist() for name in Game.COLUMNS}
        | {"task": (agents["task"] - engine.static.first[m, :count]).tolist()},
        "remaining": engine.dynamic.remaining[m].tolist(),
        "routes": [routes[net].tolist() for net in engine.nets[m, :count]],
        "trees": [
            np.flatnonzero(np.unpackbits(bits, bitorder="little")).tolist()
            for bits in option_state(engine, Option.TREE)[m, :count]
        ],
        "masks": engine.masks(np.full(count, m), np.arange(count)).tolist(),
    }


def assert_same(game: Game, engine: Engine, *, everyone: bool) -> None:
    """Asserts that two games stand alike."""
    found, expected = state_of_game(game), state_of_engine(engine)
    if everyone:
        # In a step of all the batch clears what the last move of those did who did not move.
        for state in (found, expected):
            for name in ("crossing", "ending", "added_overflow"):
                del state["columns"][name]
    assert found == expected


def play_alike(seed: int, *, everyone: bool, plain: type[Game] = Game) -> int:
    """Plays two episodes of a random game both ways; returns the number of moves."""
    rng = np.random.default_rng(seed)
    problem, rules = random_problem(rng), random_rules(rng)
    game, engine = plain(problem, Rules(**rules)), Engine([problem], Rules(**rules))
    moves = 0
    for _ in range(2):
        assert_same(game, engine, everyone=everyone)
        while game.active:
            movers = game.movers() if everyone else [game.turn]
            actions = np.full(engine.nets.shape if everyone else 1, NOBODY)
            for n in movers:
                mask = mask_of(game, n)
                wild = rng.random() < 0.2
                action = rng.integers(len(mask)) if wild else rng.choice(np.flatnonzero(mask))
                actions[..., n if everyone else 0] = action
            if rng.random() < 0.05:
                game = game.copy()
            for n in movers:
                game.move(n, int(actions[..., n if everyone else 0].item()))
            engine.move(actions)
            for n in movers:
                for name in ("crossing", "ending", "added_overflow"):
                    assert getattr(game, name)[n] == engine.agents[0, n][name]
            for n in movers:
                game.settle(n)
            if everyone:
                game.pass_turns()
            else:
                game.pass_turn(movers[0])
            engine.settle(everyone=everyone)
            moves += len(movers)
            assert_same(game, engine, everyone=everyone)
        assert game.solution() == engine.solution()
        assert all(s in (Status.TERMINATED, Status.TRUNCATED) for s in game.status)
        game.reset()
        engine.reset()
    return moves


@pytest.mark.parametrize("everyone", [False, True])
def test_the_plain_game_is_that_of_the_batch(everyone: bool) -> None:
    moves = sum(play_alike(seed, everyone=everyone) for seed in SEEDS)
    assert moves > 50 * len(SEEDS)


PLANTED = {
    "own edges": ("if edge in used or remaining", "if remaining"),
    "overflow allowed": ("anything if self.overflow_allowed else own", "own"),
    "capacity": ("self.remaining[edge] >= self.needed", "self.remaining[edge] > self.needed"),
    "demand by layer": ("self.demand[n][edge // AXES % self.layers]", "self.demand[n][0]"),
    "overflow": ("max(demand - left, 0) - max(-left, 0)", "max(demand - left, 0)"),
    "steps of blocked moves": (
        "self.steps[n] += 1",
        "self.steps[n] += self.crossing[n] != BLOCKED",
    ),
    "steps of a task": ("self.steps[n] >= self.max_steps", "self.steps[n] > self.max_steps"),
    "waiting": ("return free | self.waits", "return free"),
    "waiting across an edge": ("if action >= MOVES else", "if action == RIP_UP else"),
    "messages": ("divmod(action, self.rules.moves)", "divmod(action, MOVES)"),
    "visited": ("free = free & new or free", "free = free & new"),
    "turn order": ("self._at += 1", "self._at += 2"),
    "end of a turn": ("del self.active[self._at]  #", "self.active.remove(n); self._at = 0  #"),
    "released edges": ("self.used[n] - self.taken[n]", "self.used[n]"),
    "tree": ("if edge in used and ahead not in tree", "if edge in used and ahead > cell"),
    "ties of tasks": ("return min(later, key", "return max(later, key"),
    "where tasks begin": ("start, target = target, start", "pass"),
    "full edges": ("self.remaining[edge] <= 0 <", "self.remaining[edge] < 0 <"),
    "order of nets to rip up": ("self.queue.reverse()", "pass"),
    "nets in the way": ("key=lambda o: (-weight[o], o))[:", "key=lambda o: o)[:"),
    "around open tasks": ("beyond = 1 if self.open_tasks(n) else 0", "beyond = 0"),
    "judging": ("if self._score() > self.score_before", "if self._score() >= self.score_before"),
    "last round": ("(self.round and not self.reroutes)", "False"),
    "joined tasks of old routes": ("self._add_joined(n, joined - self.joined[n])\n", "pass\n"),
    "status": ("Status.TRUNCATED.value if self.open_tasks(n)", "Status.TRUNCATED.value if False"),
}
"""Errors planted in the source of the plain game: what stands there, and what is put there."""


@pytest.mark.parametrize("error", PLANTED)
def test_planted_errors_are_noticed(error: str) -> None:
    right, wrong = PLANTED[error]
    text = Path(source.__file__).read_text(encoding="utf-8")
    assert text.count(right) == 1
    module = types.ModuleType("planted")
    module.__dict__["__name__"] = source.__name__  # where dataclasses look for their types
    exec(compile(text.replace(right, wrong), source.__file__, "exec"), module.__dict__)
    with pytest.raises((AssertionError, LookupError, TypeError, ValueError)):
        play_all(module.Game)


def play_all(plain: type[Game]) -> None:
    """Plays all games, turn by turn and in steps of all."""
    for seed in SEEDS:
        for everyone in (False, True):
            play_alike(seed, everyone=everyone, plain=plain)


@pytest.mark.slow
@pytest.mark.parametrize("everyone", [False, True])
def test_many_more_games(everyone: bool) -> None:
    for seed in MANY:
        play_alike(seed, everyone=everyone)
