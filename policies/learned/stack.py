"""The problems that are trained side by side, and what their agents see, do and get in a step.

A step of a problem has three parts, compiled functions of one problem each: its agents *look*, they
*pick* moves by the values that their network gives what they see, and they *move*. Whoever holds
the networks calls them: compiled code that goes through whole steps of one problem after the other,
or torch, which has the values of all problems at once and therefore one part after the other for
all of them (:meth:`Stack.look` and so on).
"""

import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.game.engine import Engine
from marouting.game.observation import PaperObservation, write_paper
from marouting.game.reward import PaperReward, paper_reward
from marouting.game.rules import (
    move_everyone,
    move_player,
    settle_everyone,
    settle_player,
    write_mask,
)
from marouting.game.state import NOBODY, Crossing, Dynamic, Ending, Static, Status
from marouting.kernels import compiled, wide
from marouting.problem.grid import MOVES
from policies.learned.streams import uniform


class Lanes(NamedTuple):
    """What the agents of M problems see, do and get in a step; K of them are asked at a time."""

    agents: NDArray[np.int32]  # (M, K) the agents asked, NOBODY for none
    seen: NDArray[np.float32]  # (M, K, F) what they see before their moves
    mask: NDArray[np.int8]  # (M, K, 6) the moves that cross an edge; written if `masked`
    values: NDArray[np.float32]  # (M, K, 6) what their network expects of each move
    moves: NDArray[np.int8]  # (M, K) their moves, NOBODY for none
    moved: NDArray[np.bool_]  # (M, K) whether they moved
    reward: NDArray[np.float32]  # (M, K) what they got for it
    goes_on: NDArray[np.bool_]  # (M, K) false where the move joined the task
    arrived: NDArray[np.float32]  # (M, K, F) what they see where the move led, in the same task
    arrived_mask: NDArray[np.int8]  # (M, K, 6) the mask there; written if `masked`
    over: NDArray[np.bool_]  # (M,) whether the episode ended with the step
    total: NDArray[np.float64]  # (M,) sum of the rewards of the episode
    epsilon: NDArray[np.float64]  # (M,) chance of a random move
    keys: NDArray[np.uint64]  # (M,) of the random numbers
    counters: NDArray[np.int64]  # (M,) steps in which somebody was asked


class Rules(NamedTuple):
    """What holds for all problems of a stack."""

    everyone: bool  # whether all agents are asked, or the one whose turn it is
    masked: bool  # whether to pick among the moves that cross an edge only
    via_capacity: float  # see PaperObservation
    rewards: NDArray[np.float32]  # (4, 3) see PaperReward
    overflow_price: float


@compiled
def look(static: Static, dynamic: Dynamic, lanes: Lanes, rules: Rules, m: int) -> None:
    """The agents asked, and what they see."""
    if not rules.everyone:
        lanes.agents[m, 0] = dynamic.games[m].agent
    for k in range(lanes.agents.shape[1]):
        n = wide(lanes.agents[m, k])
        write_paper(static, dynamic, rules.via_capacity, m, n, lanes.seen[m], k)
        if rules.masked:
            write_mask(static, dynamic, m, n, lanes.mask[m], k)


@compiled
def pick(dynamic: Dynamic, lanes: Lanes, rules: Rules, m: int) -> None:
    """ε-greedy moves of the agents that may move."""
    asked = False
    for k in range(lanes.agents.shape[1]):
        n = lanes.agents[m, k]
        lanes.moves[m, k] = NOBODY
        if n == NOBODY or dynamic.agents[m, n].status != Status.ACTIVE:
            continue
        asked = True
        # Two draws a lane: whether to explore, and where to.
        if uniform(lanes.keys[m], lanes.counters[m], 2 * k) < lanes.epsilon[m]:
            allowed = MOVES
            if rules.masked:
                allowed = 0
                for move in range(MOVES):
                    allowed += lanes.mask[m, k, move]
            left = np.int64(uniform(lanes.keys[m], lanes.counters[m], 2 * k + 1) * allowed)
            for move in range(MOVES):
                if rules.masked and lanes.mask[m, k, move] == 0:
                    continue
                if left == 0:
                    lanes.moves[m, k] = move
                    break
                left -= 1
            continue
        best = NOBODY
        for move in range(MOVES):
            if rules.masked and lanes.mask[m, k, move] == 0:
                continue
            if best == NOBODY or lanes.values[m, k, move] > lanes.values[m, k, best]:
                best = move
        lanes.moves[m, k] = best
    lanes.counters[m] += asked


@compiled
def move(static: Static, dynamic: Dynamic, lanes: Lanes, rules: Rules, m: int) -> None:
    """The moves are made, in turn order; what came of them; next tasks start, the turn passes."""
    if rules.everyone:
        move_everyone(static, dynamic, m, lanes.moves)
    else:
        move_player(static, dynamic, m, wide(lanes.moves[m, 0]))
    for k in range(lanes.agents.shape[1]):
        n = wide(lanes.agents[m, k])
        lanes.moved[m, k] = n != NOBODY and dynamic.agents[m, n].crossing != Crossing.NONE
        if not lanes.moved[m, k]:
            continue
        agent = dynamic.agents[m, n]
        reward = paper_reward(rules.rewards, rules.overflow_price, agent)
        lanes.reward[m, k] = reward
        lanes.total[m] += reward
        lanes.goes_on[m, k] = agent.ending != Ending.JOINED
        write_paper(static, dynamic, rules.via_capacity, m, n, lanes.arrived[m], k)
        if rules.masked:
            write_mask(static, dynamic, m, n, lanes.arrived_mask[m], k)
    active = dynamic.games[m].active
    if rules.everyone:
        settle_everyone(static, dynamic, m)
    else:
        settle_player(static, dynamic, m)
    lanes.over[m] = active > 0 and dynamic.games[m].active == 0


@compiled
def _look_all(static: Static, dynamic: Dynamic, lanes: Lanes, rules: Rules) -> None:
    for m in range(len(lanes.over)):
        look(static, dynamic, lanes, rules, m)


@compiled
def _pick_all(dynamic: Dynamic, lanes: Lanes, rules: Rules) -> None:
    for m in range(len(lanes.over)):
        pick(dynamic, lanes, rules, m)


@compiled
def _move_all(static: Static, dynamic: Dynamic, lanes: Lanes, rules: Rules) -> None:
    for m in range(len(lanes.over)):
        move(static, dynamic, lanes, rules, m)


class Stack:
    """M problems that are trained side by side.

    Args:
        engine: the game.
        everyone: whether all agents move in a step, or the one whose turn it is.
        masked: whether to pick among the moves that cross an edge only.
        observation: what agents see.
        reward: what they get.
        keys: (M,) uint64 keys of the random numbers.

    Attributes:
        lanes: see :class:`Lanes`.
        rules: see :class:`Rules`.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        everyone: bool,
        masked: bool,
        observation: PaperObservation,
        reward: PaperReward,
        keys: NDArray[np.uint64],
    ) -> None:
        self.engine = engine
        (features,) = observation.space(engine.problems, engine.static.overflow_allowed).shape
        problems, agents = engine.nets.shape
        shape = (problems, agents if everyone else 1)
        asked = engine.pairs(everyone)[1].reshape(shape)
        self.rules = Rules(
            everyone, masked, observation.via_capacity, reward.table, reward.overflow_price
        )
        self.lanes = Lanes(
            agents=asked.copy(),
            seen=np.zeros((*shape, features), np.float32),
            mask=np.ones((*shape, MOVES), np.int8),
            values=np.zeros((*shape, MOVES), np.float32),
            moves=np.full(shape, NOBODY, np.int8),
            moved=np.zeros(shape, np.bool_),
            reward=np.zeros(shape, np.float32),
            goes_on=np.zeros(shape, np.bool_),
            arrived=np.zeros((*shape, features), np.float32),
            arrived_mask=np.ones((*shape, MOVES), np.int8),
            over=np.zeros(problems, np.bool_),
            total=np.zeros(problems),
            epsilon=np.ones(problems),
            keys=keys.copy(),
            counters=np.zeros(problems, np.int64),
        )

    def part(self, which: NDArray[np.integer]) -> "Stack":
        """A stack of some of the problems, which goes on from how they stand."""
        part = copy.copy(self)
        part.engine = self.engine.part(which)
        part.lanes = Lanes(*(array[which] for array in self.lanes))
        return part

    def look(self) -> None:
        """The agents asked, and what they see, of all problems."""
        _look_all(self.engine.static, self.engine.dynamic, self.lanes, self.rules)

    def pick(self) -> None:
        """ε-greedy moves of the agents of all problems that may move."""
        _pick_all(self.engine.dynamic, self.lanes, self.rules)

    def move(self) -> None:
        """The moves are made in all problems."""
        _move_all(self.engine.static, self.engine.dynamic, self.lanes, self.rules)
