"""What the interfaces of the environment have in common: a game made from options."""

import copy
import operator
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, ClassVar

import numpy as np
from gymnasium import Space
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.utils import EzPickle, seeding
from numpy.typing import NDArray

from marouting.batch.engine import Engine
from marouting.batch.observation import state_of, state_space_of
from marouting.game import NOBODY, Status, TurnOrder
from marouting.memory import PLAYED, STATE, TABLES, check_memory
from marouting.options import game_options
from marouting.player import Player
from marouting.problem.grid import Grid
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import Window, ansi, rgb_array, scene_of
from marouting.source import Episodes, Source

METADATA: dict[str, Any] = {
    "name": "global_routing_v0",
    "render_modes": ["ansi", "rgb_array", "human"],
    "render_fps": 10,
}


class BaseGame:
    """A game of one problem with its observation, reward, masks, state and pictures.

    Args:
        problem: what to play, see :class:`marouting.source.Episodes`.
        turn_order: the turn order if the options give none.
        options: the fields of :class:`marouting.options.GameOptions`; ``observation`` and
            ``reward`` may also be any object of their protocol.
        everyone: whether all agents move in a step, or only the one whose turn it is.

    Attributes:
        engine: the game.
        player: the player of the game.
        name: the name of the problem that is played.
        many: whether there are several problems.
        names: the names of the engine's agents.
        numbers: the engine's agents by their names.
        everyone: the names of all nets that are agents in any episode.
        begun: whether an episode has begun.
        masked: whether observations hold the mask.
        mask_key: the name of the mask in observations and infos.
        persists: whether agents that are done stay until all are done.
        actions: A, the number of actions.
        no_op: (A,) the mask of an agent that is done and stays: the one move it may make does
            nothing.
        rng: what draws the problem of an episode, if there are several.

    Raises:
        InputError: an option or the problem cannot be used.
    """

    metadata = METADATA

    def __init__(
        self,
        problem: Source,
        turn_order: TurnOrder,
        options: Mapping[str, Any],
        *,
        everyone: bool = False,
    ) -> None:
        checked = game_options(options)
        self._rules = checked if checked.turn_order else replace(checked, turn_order=turn_order)
        self._observation = checked.observation.make()
        self._reward = checked.reward.make()
        self._together = everyone
        self.render_mode = checked.render_mode
        self.masked = checked.mask_in_observation
        self.mask_key, self._observation_key = checked.mask_key, checked.observation_key
        self.persists = checked.persists
        self.actions = checked.actions
        self.no_op = np.eye(1, self.actions, dtype=np.int8)[0]
        self.begun = False
        self._window = Window()
        self.rng, _ = seeding.np_random(0)

        self._episodes = Episodes(problem, checked.scenario, checked.split)
        self.many = self._episodes.many
        problems = self._episodes.bounds
        grid = Grid.of(problems[0].grid)
        check_memory(
            grid.gcells * (TABLES + PLAYED + STATE), "an environment on a grid of {}", grid
        )
        self.everyone = [f"net_{net}" for net in self._episodes.nets]
        self._play(*next(iter(self._episodes.problems.items())))
        overflow = self.engine.static.overflow_allowed
        self._box = self._observation.space(problems, overflow)
        self.state_space: Box = state_space_of(self._observation, problems, overflow)

    def _play(self, name: str, problem: Problem) -> None:
        """Sets up the game of a problem."""
        self.name = name
        self.engine = Engine([problem], self._rules)
        self.player = Player(self.engine, self._observation, self._reward, everyone=self._together)
        self.names = [f"net_{net}" for net in self.engine.nets[0]]
        self.numbers = {agent: n for n, agent in enumerate(self.names)}

    def restart(self, seed: int | None) -> None:
        """Starts a new episode, of another problem if there are several."""
        if seed is not None:
            self.rng, _ = seeding.np_random(seed)
        name, problem = self._episodes.next(self.rng)
        if problem is not self.problem:
            self._play(name, problem)
        self.player.reset()
        self.begun = True

    def check_begun(self) -> None:
        """Raises ResetNeeded before the first episode."""
        if not self.begun:
            raise ResetNeeded("step: expected a call of reset() before it")

    def save(self) -> dict[str, Any]:
        """A copy of the state of the game, for :meth:`restore`."""
        return {
            "problem": (self.name, self.problem) if self.many else None,
            "rng": copy.deepcopy(self.rng),
            "order": self.engine.static.order.copy(),
            "begun": self.begun,
            "player": self.player.save(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Goes back to a saved state; raises ValueError if it is that of another game."""
        if saved["problem"] is not None and saved["problem"][1] != self.problem:
            self._play(*saved["problem"])
        self.player.restore(saved["player"])
        self.engine.static.order[...] = saved["order"]
        self.rng = copy.deepcopy(saved["rng"])
        self.begun = saved["begun"]

    @property
    def problem(self) -> Problem:
        """The problem that is played."""
        return self.engine.problems[0]

    def new_observation_space(self) -> Space[Any]:
        """An observation space of its own for each agent, so that each can be seeded separately."""
        # The copied space has no random numbers yet. Making a new one takes ten times as long.
        box = copy.copy(self._box)
        if not self.masked:
            return box
        mask = Box(0, 1, (self.actions,), np.int8)
        return Dict({self._observation_key: box, self.mask_key: mask})

    def masks(self) -> NDArray[np.int8]:
        """(N, A) int8, new action masks of all agents."""
        return self.engine.masks(*self.engine.pairs(everyone=True))

    def observation(self, agent: int) -> Any:
        """A new observation of one agent, in the form that the options ask for."""
        buffers = self.player.buffers
        if not self._together and buffers.agents[0, 0] == agent != NOBODY:
            return self.seen(buffers.obs[0, 0].copy(), buffers.mask[0, 0])
        problems, agents = np.zeros(1, np.int32), np.full(1, agent, np.int32)
        out = np.empty((1, *self._box.shape), np.float32)
        self._observation.write(self.engine, problems, agents, out)
        return self.seen(out[0], self.mask(agent)) if self.masked else out[0]

    def active(self, agent: int) -> bool:
        """Whether an agent still has a task to route."""
        return agent != NOBODY and bool(self.engine.agents[0, agent]["status"] == Status.ACTIVE)

    def mask(self, agent: int) -> NDArray[np.int8]:
        """(A,) int8, a new action mask of one agent; that of NOBODY is all ones."""
        if self.persists and not self.active(agent):
            return self.no_op.copy()
        return self.engine.masks(np.zeros(1, np.int32), np.full(1, agent, np.int32))[0]

    def seen(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> Any:
        """An observation with its mask, in the form that the options ask for."""
        if self.masked:
            return {self._observation_key: observation, self.mask_key: mask.copy()}
        return observation

    def info(self, mask: NDArray[np.int8], over: bool) -> dict[str, Any]:
        """An agent's info: its mask and, when the game is over, the metrics."""
        info: dict[str, Any] = {self.mask_key: mask}
        if over:
            info |= self.result()
        return info

    def task_end(self, row: int = 0) -> dict[str, Any]:
        """What the info after a move says of the task that has ended with it; empty if none has.

        Args:
            row: that of the agent in the player's buffers.
        """
        buffers = self.player.buffers
        ending = buffers.ending[0, row].item()
        if not ending:
            return {}
        mask = buffers.final_mask[0, row].copy()
        seen = self.seen(buffers.final_obs[0, row].copy(), mask)
        return {"task_ended": ending, "task_obs": seen, "task_mask": mask}

    def result(self) -> dict[str, Any]:
        """What infos hold when the game is over: the metrics, also where loggers look for them."""
        metrics = self.metrics()
        return {
            "metrics": metrics,
            **metrics,
            "open": metrics["tasks"] - metrics["joined"],
            "is_success": metrics["tasks"] == metrics["joined"] and not metrics["overflow"],
        }

    def metrics(self) -> dict[str, int]:
        """The present metrics; see :class:`marouting.batch.engine.Metrics`."""
        return asdict(self.engine.metrics())

    def solution(self) -> Solution:
        """The present routes."""
        return self.engine.solution()

    def state(self) -> NDArray[np.float32]:
        """The global state; see :func:`marouting.batch.observation.state_of`."""
        return state_of(self._observation, self.engine)[0]

    def picture(self) -> str | NDArray[np.uint8] | None:
        """Renders the game according to ``render_mode``."""
        if self.render_mode is None:
            from gymnasium import logger

            logger.warn("render() needs a render_mode: give one when you make the environment.")
            return None
        if self.render_mode == "ansi":
            return ansi(scene_of(self.engine))
        pixels = rgb_array(scene_of(self.engine))
        if self.render_mode == "rgb_array":
            return pixels
        self._window.show(pixels, self.metadata["render_fps"])
        return None

    def close(self) -> None:
        """Closes the window of ``render_mode="human"``."""
        self._window.close()


def checked_move(action: Any, actions: int, name: str = "action") -> int:
    """An integer of any type as an int; raises ValueError, naming it, for all but an action."""
    try:
        move = operator.index(action)
    except TypeError:
        move = actions
    if not 0 <= move < actions:
        raise ValueError(f"{name}: expected 0 to {actions - 1}, found {action}")
    return move


class GameMethods(EzPickle):
    """The methods of every environment beyond those of PettingZoo or Gymnasium.

    A copy by :mod:`copy` or :mod:`pickle` goes on where the environment stands. Pieces of your own
    that keep a state are only copied with it if they were given as objects.
    """

    _game: BaseGame
    _episode: ClassVar[tuple[str, ...]]
    """The attributes that change during an episode, beside the game."""

    def save(self) -> dict[str, Any]:
        """A copy of the state of the environment, for :meth:`restore`."""
        rest = {name: vars(self)[name] for name in self._episode if name in vars(self)}
        return {"game": self._game.save(), **copy.deepcopy(rest)}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Puts the environment back into a saved state.

        Args:
            saved: returned by :meth:`save` of this environment, or of one with the same problem and
                options.

        Raises:
            ValueError: it is the state of another game.
        """
        rest = dict(saved)
        self._game.restore(rest.pop("game"))
        vars(self).update(copy.deepcopy(rest))

    def __getstate__(self) -> dict[str, Any]:
        """What made the environment, and where it stands."""
        return {**super().__getstate__(), "saved": self.save()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes the environment anew and puts it where the copied one stands."""
        super().__setstate__(state)
        self.restore(state["saved"])

    @property
    def engine(self) -> Engine:
        """The game, to be read, for guides such as A*."""
        return self._game.engine

    @property
    def problem_name(self) -> str:
        """The name of the problem that is played, of its file or in its set or scenario."""
        return self._game.name

    def action_mask(self, agent: str) -> NDArray[np.int8]:
        """(A,) int8, 1 for the moves of a net that cross an edge now; never all zero.

        Raises:
            KeyError: there is no such net.
        """
        if agent not in self._game.everyone:
            raise KeyError(agent)
        return self._game.mask(self._game.numbers.get(agent, NOBODY))

    @property
    def idle_nets(self) -> list[str]:
        """The names of the problem's nets with all pins in one Gcell: nothing to route, no agents.

        Solutions and metrics count them as joined.
        """
        agents = self._game.numbers
        nets = (f"net_{net}" for net in range(len(self._game.problem.nets)))
        return [net for net in nets if net not in agents]

    def state(self) -> NDArray[np.float32]:
        """The global state, float32: (X, Y, 5 Z), see :func:`marouting.batch.observation.state`.

        Other observations than the paper's may have another one, see
        :func:`marouting.batch.observation.state_of`.
        """
        return self._game.state()

    def metrics(self) -> dict[str, int]:
        """The present overflow, wirelength, tasks joined, number of tasks, and steps."""
        return self._game.metrics()

    def solution(self) -> Solution:
        """The present routes."""
        return self._game.solution()

    def render(self) -> Any:
        """Renders the game according to ``render_mode``."""
        return self._game.picture()

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._game.close()


class NetMethods(GameMethods):
    """The methods that the environments in which every net is an agent share."""

    possible_agents: list[str]

    def _open(self, game: BaseGame) -> None:
        """Sets up the attributes that PettingZoo asks for."""
        self._game = game
        self.render_mode = game.render_mode
        self.state_space = game.state_space
        self.possible_agents = list(game.everyone)
        self.observation_spaces = {
            agent: game.new_observation_space() for agent in self.possible_agents
        }
        self.action_spaces = {agent: Discrete(game.actions) for agent in self.possible_agents}
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> Space[Any]:
        """The agent's observation space, the same object every time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """The agent's action space, the same object every time."""
        return self.action_spaces[agent]

    @property
    def np_random(self) -> np.random.Generator:
        """The environment's random numbers, for wrappers; ``reset(seed)`` seeds them."""
        return self._game.rng
