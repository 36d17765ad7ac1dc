"""The Parallel face: all nets move at once (PettingZoo's ``ParallelEnv``).

Written on the engine, not by conversion from AEC. The moves of one step are carried out in turn
order, so that the same moves give the same game as in AEC.
"""

from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from pettingzoo import ParallelEnv

from marouting.engine import NOBODY, Status
from marouting.env.face import METADATA, Face, Looks, checked_move
from marouting.grid import MOVES
from marouting.source import Source


class GlobalRoutingParallel(Looks, ParallelEnv, EzPickle):
    """Global routing with every net an agent, all moving in every step.

    With ``turn_order="sequential"`` all agents are asked and only the one whose turn it is moves;
    the others wait, with reward 0. See :mod:`marouting.global_routing_v0` for spaces and options.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.config.GameOptions`.
    """

    metadata = METADATA

    def __init__(self, problem: Source = None, **options: Any) -> None:
        EzPickle.__init__(self, problem, **options)
        self._face = Face(problem, "round_robin", options)
        self.render_mode = self._face.render_mode
        self.state_space = self._face.state_space
        self.possible_agents = list(self._face.names)
        self.observation_spaces = {
            agent: self._face.new_observation_space() for agent in self.possible_agents
        }
        self.action_spaces = {agent: Discrete(MOVES) for agent in self.possible_agents}
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> Space[Any]:
        """The agent's observation space, the same object every time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """The agent's action space, the same object every time."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Starts an episode.

        Args:
            seed: matters where a new problem is drawn for each episode, and then decides it.
            options: accepted for the interface's sake; there are none.
        """
        del options
        self._face.restart(seed)
        self.agents = list(self.possible_agents)
        self._numbers = list(range(len(self.agents)))
        self._moves = np.full((1, len(self.agents)), NOBODY, np.int8)
        return self._look()

    def _look(self) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Observations and infos of the agents that are in the game."""
        face, engine = self._face, self._face.engine
        pairs = engine.pairs(everyone=True)
        observations, masks = face.observations(*pairs), engine.masks(*pairs)
        status = engine.agents["status"][0]
        seen, infos = {}, {}
        for agent, n in zip(self.agents, self._numbers, strict=True):
            seen[agent] = face.seen(observations[n], masks[n])
            infos[agent] = face.info(masks[n], over=status[n] != Status.ACTIVE)
        return seen, infos

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
            KeyError: an agent's action is missing.
            ValueError: an action is none of the six moves.
        """
        engine = self._face.engine
        self._moves[:] = NOBODY
        for agent, n in zip(self.agents, self._numbers, strict=True):
            self._moves[0, n] = checked_move(actions[agent])
        engine.step(self._moves)

        observations, infos = self._look()
        paid = self._face.rewards(engine.agents[0]).tolist()
        status = engine.agents["status"][0].tolist()
        rewards, terminated, truncated = {}, {}, {}
        for agent, n in zip(self.agents, self._numbers, strict=True):
            rewards[agent] = paid[n]
            terminated[agent] = status[n] == Status.TERMINATED
            truncated[agent] = status[n] == Status.TRUNCATED
        self._numbers = [n for n in self._numbers if status[n] == Status.ACTIVE]
        self.agents = [self.possible_agents[n] for n in self._numbers]
        if self.render_mode == "human":
            self.render()
        return observations, rewards, terminated, truncated, infos
