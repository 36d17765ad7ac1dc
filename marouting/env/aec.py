"""The AEC environment: nets move one after the other (PettingZoo's ``AECEnv``)."""

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import AECEnv

from marouting.env.base import METADATA, BaseGame, NetMethods, checked_move
from marouting.game import NOBODY, Status
from marouting.options import ORDERS
from marouting.source import Source


class GlobalRoutingAEC(NetMethods, AECEnv):
    """Global routing in which every net is an agent, one move at a time.

    An agent's observation and mask are those of the moment when it is selected. Its reward is what
    its own last move paid it plus what the moves of others have paid it since. See
    :mod:`marouting.global_routing_v0` for spaces and options.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.options.GameOptions`.
    """

    # PettingZoo's conversion of AEC wants agents in the order of their list, who all die at the end
    # of a cycle. Nets move in their own order and leave when they are done; parallel_env is the
    # same game in parallel.
    metadata = METADATA | {"is_parallelizable": False}
    _episode = (
        "agents", "rewards", "_cumulative_rewards", "terminations", "truncations", "infos",
        "agent_selection", "_skip_agent_selection", "_number", "_mover", "_ended",
    )  # fmt: skip

    def __init__(self, problem: Source = None, **options: Any) -> None:
        EzPickle.__init__(self, problem, **options)
        AECEnv.__init__(self)
        self._open(BaseGame(problem, ORDERS["multi"], options))

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Starts an episode.

        Args:
            seed: decides which problems this and later episodes play, if there are several.
            options: ignored; PettingZoo's interface has them.
        """
        del options
        self._game.restart(seed)
        engine = self._game.engine
        self._number = dict.fromkeys(self.possible_agents, NOBODY) | self._game.numbers
        everyone = self._game.persists
        self.agents = list(self.possible_agents if everyone else self._game.names)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self._ended: dict[str, dict[str, Any]] = {}  # by the last move of each agent
        masks = dict.fromkeys(self.agents, self._game.no_op)
        masks |= zip(self._game.names, self._game.masks(), strict=True)
        # Nothing but masks: libraries take these for the keys of all infos.
        self.infos = {a: self._game.info(masks[a].copy(), over=False) for a in self.agents}
        self._skip_agent_selection: str | None = None
        self._mover = self.agents[0]
        self.agent_selection = self._game.names[engine.games[0]["agent"]]

    def observe(self, agent: str) -> Any:
        """The agent's observation at this moment."""
        return self._game.observation(self._number[agent])

    def step(self, action: int | None) -> None:
        """Moves the selected agent.

        Args:
            action: one of the actions; None for an agent that is terminated or truncated.

        Raises:
            ResetNeeded: there is no episode, or it is over.
            ValueError: the action is none of these, or not None for an agent that is
                terminated or truncated.
        """
        if not self.agents:
            raise ResetNeeded("step: expected a call of reset() before it")
        game, agent = self._game, self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            agent = self.agent_selection
            if not game.persists and agent in self.infos:
                # Others may have taken capacity since this info was made.
                told = self._ended.get(agent, {})
                self.infos[agent] = game.info(game.mask(self._number[agent]), over=False) | told
            return
        player, number = game.player, self._number[agent]
        buffers = player.buffers
        buffers.actions[0, 0] = checked_move(action, game.actions)
        player.step()
        self._ended[agent] = game.task_end()
        self._pay(agent, buffers.reward.item())
        terminated, truncated = buffers.terminated.item(), buffers.truncated.item()
        following = buffers.agents.item()
        done = terminated or truncated
        if game.persists and game.engine.games[0]["steps"] == 1:
            for name in self.agents:
                self.infos[name]["active"] = game.active(self._number[name])
        if game.persists and not game.active(number):
            self.infos[agent] = self._info(game.no_op, active=False) | self._ended[agent]
        if following == NOBODY and game.persists:
            self._end_together()
        elif not done or game.persists:
            agent = self.agent_selection = game.names[following]
            told = self._ended.get(agent, {})
            self.infos[agent] = self._info(buffers.mask[0, 0], active=True) | told
        else:
            self.terminations[agent] = terminated
            self.truncations[agent] = truncated
            told = game.info(game.mask(number), over=following == NOBODY)
            self.infos[agent] = told | self._ended[agent]
            # The agent is selected once more, to be removed from the list, before the next one is.
            self._skip_agent_selection = None if following == NOBODY else game.names[following]
        if self.render_mode == "human":
            self.render()

    def _info(self, mask: NDArray[np.int8], *, active: bool) -> dict[str, Any]:
        """An agent's info during its episode."""
        info = self._game.info(mask.copy(), over=False)
        if self._game.persists:
            info["active"] = active
        return info

    def _end_together(self) -> None:
        """Ends the episodes of all agents: those that failed a task are truncated."""
        status = self._game.engine.agents[0]["status"]
        for agent in self.agents:
            number = self._number[agent]
            failed = number != NOBODY and bool(status[number] == Status.TRUNCATED)
            self.truncations[agent], self.terminations[agent] = failed, not failed
            self.infos[agent] |= self._game.result()
        self.agent_selection = self.agents[0]

    def _pay(self, mover: str, reward: float) -> None:
        """Sets the rewards of a move, and adds them to what each agent got since its last move.

        Args:
            mover: the agent that moved.
            reward: its reward; only used if the reward pays just the agent that moves.
        """
        self._cumulative_rewards[mover] = 0.0
        paid = self._game.player.paid
        if paid is None:
            if self._mover in self.rewards:
                self.rewards[self._mover] = 0.0
            self.rewards[mover] = self._cumulative_rewards[mover] = reward
            self._mover = mover
            return
        for agent in self.agents:
            number = self._number[agent]
            self.rewards[agent] = 0.0 if number == NOBODY else paid[0, number].item()
        self._accumulate_rewards()
