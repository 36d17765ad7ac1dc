"""The Parallel environment: all nets move at once (PettingZoo's ``ParallelEnv``).

It plays the game directly, not by a conversion from AEC. The moves of one step are carried out in
turn order, so the same moves give the same game as in AEC.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import EzPickle
from pettingzoo import ParallelEnv

from marouting.env.base import METADATA, NetEnv, checked_move, result_of
from marouting.game import ACTIVE, NOBODY, WAITING, Game, Status
from marouting.memory import check_memory
from marouting.source import Source


class GlobalRoutingParallel(NetEnv, ParallelEnv):
    """Global routing in which every net is an agent and all agents move in every step.

    With ``turn_order="sequential"`` every agent gives an action, but only the agent whose turn it
    is moves; the others wait. See :mod:`marouting.global_routing_v0` for spaces and options.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.options.GameOptions`.
    """

    metadata = METADATA | {"is_parallelizable": True}
    _saved_names = ("agents", "_numbers")

    def __init__(self, problem: Source = None, **options: Any) -> None:
        EzPickle.__init__(self, problem, **options)
        self._open(problem, "multi", options)
        agents, numbers = len(self.possible_agents), math.prod(self._box.shape)
        size = agents * numbers * np.dtype(np.float32).itemsize
        check_memory(size, "{} observations of {} numbers", agents, numbers)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Starts an episode.

        Args:
            seed: decides which problems this and later episodes play, if there are several.
            options: ignored; PettingZoo's interface has them.
        """
        del options
        self._restart(seed)
        self.agents = list(self.possible_agents if self._persists else self._names)
        # Those in the game; NOBODY for one that this problem does not have.
        self._numbers = [self._agent_of.get(agent, NOBODY) for agent in self.agents]
        return self._look(first=True)

    def _look(self, *, first: bool) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """New observations and infos of all agents; the first infos hold nothing but masks."""
        numbers, agents = self._numbers, self.agents
        seen: Any = self._see_all(numbers)
        masks = self._mask_all(numbers)
        infos: list[dict[str, Any]] = [{self._mask_key: mask} for mask in masks]
        if self._persists and not first:
            for info, n in zip(infos, numbers, strict=True):
                info["active"] = self._is_active(n)
        if self._masked:
            seen = [self._with_mask(*both) for both in zip(seen, masks, strict=True)]
        return dict(zip(agents, seen, strict=True)), dict(zip(agents, infos, strict=True))

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        dict[str, Any],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Moves all agents.

        Args:
            actions: a move for every agent in ``agents``.

        Raises:
            ResetNeeded: no episode has begun. Once it is over, a step changes nothing.
            KeyError: an agent's action is missing.
            ValueError: ``actions`` is no mapping, or an action is out of range.
        """
        self._check_begun()
        agents, numbers, game = self.agents, self._numbers, self.game
        try:
            moves = _moves([actions[agent] for agent in agents], agents, self._actions)
        except KeyError as error:
            raise KeyError(f"step: expected an action for {error.args[0]}") from None
        except (TypeError, IndexError):
            found = type(actions).__name__
            what = f"step: expected a mapping from agents to actions, found {found}"
            raise ValueError(what) from None
        rewards, ended = self._move_all(dict(zip(numbers, moves, strict=True)))
        observations, infos = self._look(first=False)
        for n, task_end in ended.items():
            infos[self._names[n]] |= task_end
        status = [WAITING if n == NOBODY else game.status[n] for n in numbers]
        over = not game.active
        if self._persists:  # all end together
            cut = [over and s == Status.TRUNCATED for s in status]
            done = [over and not c for c in cut]
        else:
            cut = [s == Status.TRUNCATED for s in status]
            done = [s == Status.TERMINATED for s in status]
        if over and agents:  # the figures of the game change no more
            result = result_of(self.game.metrics())
            for info in infos.values():
                info |= {**result, "metrics": dict(result["metrics"])}
            self.agents, self._numbers = [], []
        elif not self._persists and any(status):
            stays = [k for k, s in enumerate(status) if s == ACTIVE]
            self.agents = [agents[k] for k in stays]
            self._numbers = [numbers[k] for k in stays]
        if self.render_mode == "human":
            self.render()
        return (
            observations,
            dict(zip(agents, (rewards.get(n, 0.0) for n in numbers), strict=True)),
            dict(zip(agents, done, strict=True)),
            dict(zip(agents, cut, strict=True)),
            infos,
        )

    def _move_all(
        self, moves: dict[int, int]
    ) -> tuple[dict[int, float], dict[int, dict[str, Any]]]:
        """Makes the moves in turn order: what pays each agent, and infos of tasks that ended."""
        game = self.game
        movers = game.movers()
        if self._pays_mover:
            move, pay, rewards = game.move, self._pay_mover, {}
            for n in movers:
                move(n, moves[n])
                rewards[n] = pay(game, n)
            ending = [n for n in movers if game.ending[n]]
            ended = {n: self._task_end(n) for n in ending}
            for n in ending:
                game.settle(n)
        else:
            # The reward of a move is to see that earlier movers have begun their next tasks, as it
            # does where they move one at a time; what agents saw where they arrived, they saw when
            # all had moved.
            paid, arrived = np.zeros(len(game.nets), np.float32), {}
            stays = np.ones(len(game.nets), np.bool_)
            for n in movers:
                if not self._persists:  # those who are done have left
                    stays = np.array(game.status) == ACTIVE
                paid += self._move(n, moves[n]) * stays
                if game.ending[n]:
                    arrived[n] = _standing(game, n)
                game.settle(n)
            settled = {n: _standing(game, n) for n in arrived}
            _stand(game, arrived)
            ended = {n: self._task_end(n) for n in arrived}
            _stand(game, settled)
            rewards = dict(enumerate(paid.tolist()))
        if movers:
            game.pass_turns()
        return rewards, ended


def _standing(game: Game, n: int) -> tuple[list[int], list[set[int]]]:
    """All that changes when an agent begins its next task."""
    columns = [getattr(game, name)[n] for name in game.COLUMNS]
    return columns, [game.begun[n], game.visited[n], game.taken[n]]


def _stand(game: Game, agents: dict[int, tuple[list[int], list[set[int]]]]) -> None:
    """Makes agents stand as they stood."""
    for n, (columns, sets) in agents.items():
        for name, value in zip(game.COLUMNS, columns, strict=True):
            getattr(game, name)[n] = value
        game.begun[n], game.visited[n], game.taken[n] = sets


def _moves(actions: list[Any], agents: list[str], count: int) -> Sequence[int]:
    """Actions as integers; raises ValueError, naming the agent, for all but 0 to count - 1."""
    try:
        moves = bytes(actions)  # integers from 0 to 255 of any type
    except (TypeError, ValueError):
        moves = None
    if moves is None or max(moves, default=0) >= count:
        named = zip(actions, agents, strict=True)
        return [checked_move(a, count, f"action of {agent}") for a, agent in named]
    return moves
