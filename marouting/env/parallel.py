"""The Parallel environment: all nets move at once (PettingZoo's ``ParallelEnv``).

It uses the engine directly, not a conversion from AEC. The moves of one step are carried out in
turn order, so the same moves give the same game as in AEC.
"""

from typing import Any

import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from marouting.env.base import METADATA, BaseGame, NetMethods, checked_move
from marouting.game import NOBODY
from marouting.options import ORDERS
from marouting.source import Source


class GlobalRoutingParallel(NetMethods, ParallelEnv):
    """Global routing in which every net is an agent and all agents move in every step.

    With ``turn_order="sequential"`` every agent gives an action, but only the agent whose turn it
    is moves; the others wait. See :mod:`marouting.global_routing_v0` for spaces and options.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.options.GameOptions`.
    """

    metadata = METADATA | {"is_parallelizable": True}
    _episode = ("agents", "_numbers")

    def __init__(self, problem: Source = None, **options: Any) -> None:
        EzPickle.__init__(self, problem, **options)
        self._open(BaseGame(problem, ORDERS["multi"], options, everyone=True))

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Starts an episode.

        Args:
            seed: decides which problems this and later episodes play, if there are several.
            options: ignored; PettingZoo's interface has them.
        """
        del options
        self._game.restart(seed)
        game = self._game
        self.agents = list(self.possible_agents if game.persists else game.names)
        # The rows of the agents in the game; NOBODY for one that this problem does not have.
        self._numbers = np.array([game.numbers.get(agent, NOBODY) for agent in self.agents])
        return self._look(first=True)

    def _look(self, *, first: bool) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """New observations and infos of the agents that are in the game.

        Args:
            first: whether they are those of the beginning, when infos hold nothing but masks.
        """
        buffers, numbers, agents = self._game.player.buffers, self._numbers, self.agents
        seen: Any = buffers.obs[0].take(numbers, axis=0)
        masks = buffers.mask[0].take(numbers, axis=0)
        infos: list[dict[str, Any]] = [{self._game.mask_key: mask} for mask in masks]
        if self._game.persists:
            active = buffers.active[0].take(numbers) & (numbers != NOBODY)
            seen[numbers == NOBODY] = 0
            masks[~active] = self._game.no_op
            for info, moves in zip(infos, active.tolist(), strict=True) if not first else ():
                info["active"] = moves
        if self._game.masked:
            seen = [self._game.seen(*both) for both in zip(seen, masks, strict=True)]
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
            ValueError: an action is out of range.
        """
        self._game.check_begun()
        agents, numbers, player = self.agents, self._numbers, self._game.player
        buffers = player.buffers
        there = numbers != NOBODY
        moves = _moves([actions[agent] for agent in agents], agents, self._game.actions)
        buffers.actions[0, numbers[there]] = moves[there]
        player.step()

        observations, infos = self._look(first=False)
        terminated, truncated, stays = (
            flags[0].take(numbers)
            for flags in (buffers.terminated, buffers.truncated, buffers.active)
        )
        paid = buffers.reward[0].take(numbers)
        if buffers.ending.any():
            for k in np.flatnonzero(there & (buffers.ending[0].take(numbers) != 0)):
                infos[agents[k]] |= self._game.task_end(numbers[k])
        if self._game.persists:  # all end together
            stays[:] = buffers.active.any()
            paid[~there] = 0
            truncated &= ~stays & there
            terminated = ~stays & ~truncated
        ended = dict(zip(agents, terminated.tolist(), strict=True))
        cut = dict(zip(agents, truncated.tolist(), strict=True))
        rewards = dict(zip(agents, paid.tolist(), strict=True))
        if not stays.all():
            if not stays.any():  # the game is over: its figures change no more
                result = self._game.result()
                for info in infos.values():
                    info |= {**result, "metrics": dict(result["metrics"])}
            self._numbers = numbers[stays]
            self.agents = [agents[k] for k in np.flatnonzero(stays)]
        if self.render_mode == "human":
            self.render()
        return observations, rewards, ended, cut, infos


def _moves(actions: list[Any], agents: list[str], count: int) -> NDArray[np.int8]:
    """Actions as an array; raises ValueError, naming the agent, for all but 0 to count - 1."""
    try:
        moves = bytes(actions)  # integers from 0 to 255 of any type
    except (TypeError, ValueError):
        moves = bytes([count])
    if moves and max(moves) >= count:
        named = zip(actions, agents, strict=True)
        moves = bytes([checked_move(a, count, f"action of {agent}") for a, agent in named])
    return np.frombuffer(moves, np.int8)
