"""The Parallel face: all nets move at once (PettingZoo's ``ParallelEnv``).

Written on the engine, not by conversion from AEC. The moves of one step are carried out in turn
order, so that the same moves give the same game as in AEC.
"""

from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Discrete
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from marouting.config import ORDERS
from marouting.engine import NOBODY, Status
from marouting.env.face import METADATA, Face, Looks, checked_move
from marouting.grid import MOVES
from marouting.source import Source

# Plain numbers compare many times quicker than members of an IntEnum.
_ACTIVE, _TERMINATED, _TRUNCATED = map(int, (Status.ACTIVE, Status.TERMINATED, Status.TRUNCATED))


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
        self._face = Face(problem, ORDERS["multi"], options)
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
        self._numbers = np.arange(len(self.agents))  # of the agents in the game
        self._moves = np.full((1, len(self.agents)), NOBODY, np.int8)
        return self._look(self._face.engine.agents["status"][0])

    def _look(self, status: NDArray[np.int8]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Observations and infos of the agents that are in the game; ``status`` (K,) is theirs."""
        face = self._face
        seen: Any = face.observations()[self._numbers]
        masks = face.masks()[self._numbers]
        if face.masked:
            seen = [face.seen(*both) for both in zip(seen, masks, strict=True)]
        infos = [{"action_mask": mask} for mask in masks]
        for k in np.flatnonzero(status != _ACTIVE):
            infos[k] = face.info(masks[k], over=True)
        agents = self.agents
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
            KeyError: an agent's action is missing.
            ValueError: an action is none of the six moves.
        """
        engine, agents, numbers = self._face.engine, self.agents, self._numbers
        moves = np.array([actions[agent] for agent in agents])
        whole = moves.dtype.kind in "iu"
        if len(moves) and not (whole and 0 <= moves.min() <= moves.max() < MOVES):
            for agent in agents:
                checked_move(actions[agent], f"action of {agent}")
        self._moves[:] = NOBODY
        self._moves[0, numbers] = moves
        engine.step(self._moves)

        records = engine.agents[0, numbers]
        status = records["status"]
        observations, infos = self._look(status)
        rewards = dict(zip(agents, self._face.rewards(records).tolist(), strict=True))
        terminated = dict(zip(agents, (status == _TERMINATED).tolist(), strict=True))
        truncated = dict(zip(agents, (status == _TRUNCATED).tolist(), strict=True))
        playing = status == _ACTIVE
        if not playing.all():
            self._numbers = numbers[playing]
            self.agents = [self.possible_agents[n] for n in self._numbers]
        if self.render_mode == "human":
            self.render()
        return observations, rewards, terminated, truncated, infos
