"""Environments that do nothing: what PettingZoo itself costs, to compare others with."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray
from pettingzoo import AECEnv

from marouting.problem.grid import MOVES


class EmptyAEC(AECEnv):
    """An AEC environment whose step passes the turn on.

    It has 50 agents. What it hands out is made once: a constant observation, a reward of 0, an info
    with a constant action mask. Nobody ever terminates.
    """

    metadata = {"name": "empty_v0", "is_parallelizable": True}  # noqa: RUF012

    def __init__(self) -> None:
        super().__init__()
        self.possible_agents = [f"net_{n}" for n in range(50)]
        following = self.possible_agents[1:] + self.possible_agents[:1]
        self._following = dict(zip(self.possible_agents, following, strict=True))
        self._observation = np.zeros(12, np.float32)
        self._mask = np.ones(MOVES, np.int8)
        self.observation_spaces = {
            agent: Box(-np.inf, np.inf, (12,), np.float32) for agent in self.possible_agents
        }
        self.action_spaces = {agent: Discrete(MOVES) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Box:
        """The agent's observation space."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """The agent's action space."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Puts all agents into the game; the seed and the options do not matter."""
        del seed, options
        self.agents = list(self.possible_agents)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos = {agent: {"action_mask": self._mask} for agent in self.agents}
        self.agent_selection = self.agents[0]

    def observe(self, agent: str) -> NDArray[np.float32]:
        """The constant observation."""
        del agent
        return self._observation

    def step(self, action: int | None) -> None:
        """Passes the turn on."""
        del action
        self.agent_selection = self._following[self.agent_selection]
