"""The AEC face: nets move one after the other (PettingZoo's ``AECEnv``)."""

from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from pettingzoo import AECEnv

from marouting.config import ORDERS
from marouting.env.base import INT8, METADATA, BaseGame, GameMethods, checked_move
from marouting.game.engine import NOBODY, Status
from marouting.problem.grid import MOVES
from marouting.source import Source

# Plain numbers compare many times quicker than members of an IntEnum.
_ACTIVE, _TERMINATED = int(Status.ACTIVE), int(Status.TERMINATED)

_MASK = 1, MOVES


class GlobalRoutingAEC(GameMethods, AECEnv, EzPickle):
    """Global routing with every net an agent, one move at a time.

    An agent's observation and mask are those of the moment it is selected; its reward is that of
    its own last move. See :mod:`marouting.global_routing_v0` for spaces and options.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.config.GameOptions`.
    """

    metadata = METADATA

    def __init__(self, problem: Source = None, **options: Any) -> None:
        EzPickle.__init__(self, problem, **options)
        super().__init__()
        self._game = BaseGame(problem, ORDERS["multi"], options)
        self.render_mode = self._game.render_mode
        self.state_space = self._game.state_space
        self.possible_agents = list(self._game.everyone)
        self.observation_spaces = {
            agent: self._game.new_observation_space() for agent in self.possible_agents
        }
        self.action_spaces = {agent: Discrete(MOVES) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Space[Any]:
        """The agent's observation space, the same object every time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """The agent's action space, the same object every time."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Starts an episode.

        Args:
            seed: matters where a new problem is drawn for each episode, and then decides it.
            options: accepted for the interface's sake; there are none.
        """
        del options
        self._game.restart(seed)
        engine = self._game.engine
        self._number = dict.fromkeys(self.possible_agents, NOBODY)
        self._number |= {agent: n for n, agent in enumerate(self._game.names)}
        self.agents = list(self._game.names)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos = {
            agent: self._game.info(mask, over=False)
            for agent, mask in zip(self.agents, self._game.masks(), strict=True)
        }
        self._skip_agent_selection: str | None = None
        self._rewarded = self.agents[0]
        self.agent_selection = self._game.names[engine.games[0]["agent"]]

    def observe(self, agent: str) -> Any:
        """The agent's observation as the game stands."""
        return self._game.observation(self._number[agent])

    def step(self, action: int | None) -> None:
        """Moves the selected agent; None for one that is terminated or truncated.

        Raises:
            ValueError: the action is none of the six moves, or not None for a dead agent.
        """
        game, agent = self._game, self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            agent = self.agent_selection
            if agent in self.infos:  # others may have taken capacity since its info was made
                self.infos[agent] = game.info(game.mask(self._number[agent]), over=False)
            return
        mask = np.empty(_MASK, INT8)
        following, status = game.engine.play_turn(checked_move(action), mask)

        # Only the mover gets a reward; the last mover's is over.
        if self._rewarded in self.rewards:
            self.rewards[self._rewarded] = 0.0
        self._rewarded = agent
        reward = game.reward(self._number[agent])
        self.rewards[agent] = self._cumulative_rewards[agent] = reward
        if status == _ACTIVE:
            agent = self.agent_selection = game.names[following]
            self.infos[agent] = {"action_mask": mask[0]}
        else:
            self.terminations[agent] = status == _TERMINATED
            self.truncations[agent] = status != _TERMINATED
            self.infos[agent] = game.info(mask[0], over=True)
            # The agent is selected once more, to be taken off the list, before the next one.
            self._skip_agent_selection = None if following == NOBODY else game.names[following]
        if self.render_mode == "human":
            self.render()
