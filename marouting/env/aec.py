"""The AEC environment: nets move one after the other (PettingZoo's ``AECEnv``)."""

from typing import Any

from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle
from pettingzoo import AECEnv

from marouting.env.base import METADATA, NetEnv, checked_move, result_of
from marouting.game import ACTIVE, NOBODY, Status
from marouting.source import Source


class GlobalRoutingAEC(NetEnv, AECEnv):
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
    _saved_names = (
        "agents", "rewards", "_cumulative_rewards", "terminations", "truncations", "infos",
        "agent_selection", "_skip_agent_selection", "_number", "_mover", "_ended",
    )  # fmt: skip

    def __init__(self, problem: Source = None, **options: Any) -> None:
        EzPickle.__init__(self, problem, **options)
        AECEnv.__init__(self)
        self._open(problem, "multi", options)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Starts an episode.

        Args:
            seed: decides which problems this and later episodes play, if there are several.
            options: ignored; PettingZoo's interface has them.
        """
        del options
        self._restart(seed)
        self._number = dict.fromkeys(self.possible_agents, NOBODY) | self._agent_of
        self.agents = list(self.possible_agents if self._persists else self._names)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self._ended: dict[str, dict[str, Any]] = {}  # by the last move of each agent
        # Nothing but masks: libraries take these for the keys of all infos.
        masks = self._mask_all([self._number[agent] for agent in self.agents])
        self.infos = {
            agent: {self._mask_key: mask} for agent, mask in zip(self.agents, masks, strict=True)
        }
        self._skip_agent_selection: str | None = None
        self._mover = self.agents[0]
        self.agent_selection = self._names[self.game.turn]

    def observe(self, agent: str) -> Any:
        """The agent's observation at this moment; raises ResetNeeded before the first episode."""
        self._check_begun()
        return self._shown(self._number[agent])

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
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            agent = self.agent_selection
            if not self._persists and agent in self.infos:
                # Others may have taken capacity since this info was made.
                info = self._ended.get(agent, {})
                self.infos[agent] = {self._mask_key: self._mask(self._number[agent])} | info
            return
        game, n = self.game, self._number[agent]
        move = checked_move(action, self._actions)
        if self._pays_mover:
            game.move(n, move)
            paid = self._pay_mover(game, n)
        else:
            paid = self._move(n, move)
        if game.ending[n]:
            self._ended[agent] = self._task_end(n)
            game.settle(n)
        elif agent in self._ended:
            del self._ended[agent]
        game.pass_turn(n)
        self._pay(agent, paid)
        following, status = game.turn, game.status[n]
        persists = self._persists
        if persists and game.moves == 1:
            for name in self.agents:
                self.infos[name]["active"] = self._is_active(self._number[name])
        if persists and status != ACTIVE:
            self.infos[agent] = self._info(agent, n)
        if persists and following == NOBODY:
            self._end_together()
        elif persists or status == ACTIVE:
            agent = self.agent_selection = self._names[following]
            self.infos[agent] = self._info(agent, following)
        else:
            self.terminations[agent] = status == Status.TERMINATED
            self.truncations[agent] = status == Status.TRUNCATED
            info = result_of(self.game.metrics()) if following == NOBODY else {}
            info |= self._ended.get(agent, {})
            self.infos[agent] = {self._mask_key: self._mask(n)} | info
            # The agent is selected once more, to be removed from the list, before the next one is.
            self._skip_agent_selection = None if following == NOBODY else self._names[following]
        if self.render_mode == "human":
            self.render()

    def _info(self, agent: str, n: int) -> dict[str, Any]:
        """The info of agent n during its episode."""
        info: dict[str, Any]
        if self._persists:
            info = {self._mask_key: self._mask(n), "active": self._is_active(n)}
        else:  # as in _mask, without another call
            info = {self._mask_key: self._masks[self.game.free_moves(n)].copy()}
        if agent in self._ended:
            info |= self._ended[agent]
        return info

    def _end_together(self) -> None:
        """Ends the episodes of all agents: those that failed a task are truncated."""
        status = self.game.status
        for agent in self.agents:
            n = self._number[agent]
            failed = n != NOBODY and status[n] == Status.TRUNCATED
            self.truncations[agent], self.terminations[agent] = failed, not failed
            self.infos[agent] |= result_of(self.game.metrics())
        self.agent_selection = self.agents[0]

    def _pay(self, mover: str, paid: Any) -> None:
        """Sets the rewards of a move, and adds them to what each agent got since its last move."""
        self._cumulative_rewards[mover] = 0.0
        if self._pays_mover:
            if self._mover in self.rewards:
                self.rewards[self._mover] = 0.0
            self.rewards[mover] = self._cumulative_rewards[mover] = paid
            self._mover = mover
            return
        for agent in self.agents:
            n = self._number[agent]
            self.rewards[agent] = 0.0 if n == NOBODY else paid[n].item()
        self._accumulate_rewards()
