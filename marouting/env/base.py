"""What the interfaces of the environment have in common: a plain game made from options."""

import copy
import operator
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np
from gymnasium import Space
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.utils import EzPickle, seeding
from numpy.typing import NDArray

from marouting.columns import Columns
from marouting.game import ACTIVE, NOBODY, Game, mask_table
from marouting.memory import PLAYED, STATE, TABLES, check_memory
from marouting.observations import has_form, state_of, state_space_of
from marouting.options import game_options
from marouting.problem.grid import Grid
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import Window, ansi, rgb_array, scene_of
from marouting.rewards import paid_by
from marouting.rules import Rules, TurnOrder
from marouting.source import ProblemStream, Source

METADATA: dict[str, Any] = {
    "name": "global_routing_v0",
    "render_modes": ["ansi", "rgb_array", "human"],
    "render_fps": 10,
}


class BaseGame:
    """A game of one problem with its observation, reward, masks, state and pictures.

    Args:
        problem: what to play, see :class:`marouting.source.ProblemStream`.
        turn_order: the turn order if the options give none.
        options: the fields of :class:`marouting.options.GameOptions`.
        kind: the class of the game, if its rules are others.

    Attributes:
        columns: the game as observations and rewards see it.
        many: whether there are several problems.
        numbers: the game's agents by their names.
        everyone: the names of all nets that are agents in any episode.
        box: the space of one agent's observation, without its mask.
        masked: whether observations hold the mask.
        persists: whether agents that are done stay until all are done.
        pays_mover: whether a move pays only the agent that makes it.
        no_op: (A,) the mask of an agent that is done and stays.
        rng: what draws the problem of an episode, if there are several.
    """

    metadata = METADATA

    def __init__(
        self,
        problem: Source,
        turn_order: TurnOrder,
        options: Mapping[str, Any],
        kind: type[Game] = Game,
    ) -> None:
        checked = game_options(options)
        rules = {field.name: getattr(checked, field.name) for field in fields(Rules)}
        self._rules = Rules(**{**rules, "turn_order": checked.turn_order or turn_order})
        self._kind = kind
        self._observation = checked.observation.make()
        self._sees_plainly = has_form(self._observation, "see", "write")
        self.reward: Any = checked.reward.make()
        self.pays_mover = has_form(self.reward, "pay", "__call__")
        self.render_mode = checked.render_mode
        self.masked = checked.mask.in_observation
        self.mask_key, self._observation_key = checked.mask.mask_key, checked.mask.observation_key
        self.persists = checked.persists
        self.actions = checked.actions
        self.no_op = np.eye(1, self.actions, dtype=np.int8)[0]
        self._table = mask_table(checked.moves, checked.messages)
        self._masks = list(self._table)  # a list's rows are found faster
        self.begun = False
        self._window = Window()
        self.rng, _ = seeding.np_random(0)

        self._episodes = ProblemStream(problem, checked.scenario, checked.split)
        self.many = self._episodes.many
        problems = self._episodes.bounds
        grid = Grid.of(problems[0].grid)
        check_memory(
            grid.gcells * (TABLES + PLAYED + STATE), "an environment on a grid of {}", grid
        )
        self.everyone = [f"net_{net}" for net in self._episodes.nets]
        name, first = next(iter(self._episodes.problems.items()))
        self._play(name, kind(first, self._rules))
        overflow = self.game.overflow_allowed
        self.box: Box = self._observation.space(problems, overflow)
        self.state_space: Box = state_space_of(self._observation, problems, overflow)

    def _play(self, name: str, game: Game) -> None:
        """Takes up the game of a problem."""
        self.name, self.game, self.columns = name, game, Columns(game)
        self.names = [f"net_{net}" for net in game.nets]
        self.numbers = {agent: n for n, agent in enumerate(self.names)}
        self._figures = self.columns.figures()

    def restart(self, seed: int | None) -> None:
        """Starts a new episode, of another problem if there are several."""
        if seed is not None:
            self.rng, _ = seeding.np_random(seed)
        name, problem = self._episodes.next(self.rng)
        if problem is not self.problem:
            self._play(name, self._kind(problem, self._rules))
        else:
            self.game.reset()
        self._figures = self.columns.figures()
        self.begun = True

    def check_begun(self) -> None:
        """Raises ResetNeeded before the first episode."""
        if not self.begun:
            raise ResetNeeded("step: expected a call of reset() before it")

    def save(self) -> dict[str, Any]:
        """A copy of the state of the game, for :meth:`restore`."""
        return {
            "name": self.name,
            "game": self.game.copy(),
            "figures": dict(self._figures),
            "rng": copy.deepcopy(self.rng),
            "begun": self.begun,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Goes back to a saved state; raises ValueError if it is that of another game."""
        game: Game = saved["game"]
        same = game.problem == self.problem or self.many
        if not (type(game) is self._kind and game.rules == self._rules and same):
            raise ValueError("saved: expected the state of a game with this problem and options")
        problem = self.problem
        self._play(saved["name"], game.copy())
        if not self.many:  # the next episode begins with this one, and not with an equal one
            self.game.problem = problem
            self.columns.problems = (problem,)
        self._figures = dict(saved["figures"])
        self.rng = copy.deepcopy(saved["rng"])
        self.begun = saved["begun"]

    @property
    def problem(self) -> Problem:
        """The problem that is played."""
        return self.game.problem

    # --- what agents see --------------------------------------------------------------------------

    def new_observation_space(self) -> Space[Any]:
        """An observation space of its own for each agent, so that each can be seeded separately."""
        # The copied space has no random numbers yet. Making a new one takes ten times as long.
        box = copy.copy(self.box)
        if not self.masked:
            return box
        mask = Box(0, 1, (self.actions,), np.int8)
        return Dict({self._observation_key: box, self.mask_key: mask})

    def see(self, agent: int) -> NDArray[np.float32]:
        """A new observation of one agent; zeros for NOBODY."""
        if agent == NOBODY:
            return np.zeros(self.box.shape, np.float32)
        if self._sees_plainly:
            seen: NDArray[np.float32] = self._observation.see(self.game, agent)
            return seen
        return self.see_all([agent])[0]

    def see_all(self, agents: Sequence[int]) -> NDArray[np.float32]:
        """(K, *S) new observations of many agents, or NOBODY."""
        if not hasattr(self._observation, "write"):
            return np.array([self.see(agent) for agent in agents], np.float32)
        out = np.empty((len(agents), *self.box.shape), np.float32)
        rows = np.zeros(len(agents), np.int32), np.array(agents, np.int32)
        self._observation.write(self.columns, *rows, out)
        return out

    def observation(self, agent: int) -> Any:
        """A new observation of one agent, in the form that the options ask for."""
        if self._sees_plainly and agent != NOBODY:
            seen = self._observation.see(self.game, agent)
        else:
            seen = self.see(agent)
        return self.seen(seen, self.mask(agent)) if self.masked else seen

    def seen(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> Any:
        """An observation with its mask, in the form that the options ask for."""
        if self.masked:
            return {self._observation_key: observation, self.mask_key: mask.copy()}
        return observation

    # --- masks ------------------------------------------------------------------------------------

    def active(self, agent: int) -> bool:
        """Whether an agent still has a task to route."""
        return agent != NOBODY and self.game.status[agent] == ACTIVE

    def mask(self, agent: int) -> NDArray[np.int8]:
        """(A,) int8, a new action mask of one agent; that of NOBODY is all ones."""
        if self.persists and not self.active(agent):
            return self.no_op.copy()
        return self._masks[0 if agent == NOBODY else self.game.free_moves(agent)].copy()

    def masks(self, agents: Sequence[int]) -> NDArray[np.int8]:
        """(K, A) int8, new action masks of many agents."""
        free_moves = self.game.free_moves
        out = self._table[[0 if n == NOBODY else free_moves(n) for n in agents]]
        if self.persists:
            out[[not self.active(n) for n in agents]] = self.no_op
        return out

    # --- moves ------------------------------------------------------------------------------------

    def move(self, n: int, action: int) -> Any:
        """An agent moves: what that pays it if ``pays_mover``, otherwise (N,) float32 for all."""
        if self.pays_mover:
            self.game.move(n, action)
            return self.reward.pay(self.game, n)
        before = self.columns.before(self._figures)
        self.game.move(n, action)
        self._figures = self.columns.figures()
        return paid_by(self.reward, self.columns, before, np.array([n], np.int32))[0]

    def task_end(self, n: int) -> dict[str, Any]:
        """What the info after a move says of the task that has ended with it; empty if none has.

        The agent still stands where it arrived.
        """
        ending = self.game.ending[n]
        if not ending:
            return {}
        mask = self._masks[self.game.free_moves(n)].copy()
        seen = self.seen(self.see(n), mask)
        return {"task_ended": ending, "task_obs": seen, "task_mask": mask}

    # --- results ----------------------------------------------------------------------------------

    def info(self, mask: NDArray[np.int8], over: bool) -> dict[str, Any]:
        """An agent's info: its mask and, when the game is over, the metrics."""
        info: dict[str, Any] = {self.mask_key: mask}
        if over:
            info |= self.result()
        return info

    def result(self) -> dict[str, Any]:
        """What infos hold when the game is over: the metrics, also where loggers look for them."""
        metrics = self.game.metrics()
        return {
            "metrics": metrics,
            **metrics,
            "open": metrics["tasks"] - metrics["joined"],
            "is_success": metrics["tasks"] == metrics["joined"] and not metrics["overflow"],
        }

    def state(self) -> NDArray[np.float32]:
        """The global state; see :func:`marouting.observations.state_of`."""
        return state_of(self._observation, self.columns)[0]

    def picture(self) -> str | NDArray[np.uint8] | None:
        """Renders the game according to ``render_mode``."""
        if self.render_mode is None:
            from gymnasium import logger

            logger.warn("render() needs a render_mode: give one when you make the environment.")
            return None
        if self.render_mode == "ansi":
            return ansi(scene_of(self.columns))
        pixels = rgb_array(scene_of(self.columns))
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

    Attributes:
        game_class: the rules; a subclass of the environment may name its own
            :class:`marouting.game.Game`.
    """

    game_class: ClassVar[type[Game]] = Game
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
    def game(self) -> Game:
        """The game, to be read."""
        return self._game.game

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
        """The global state, float32: (X, Y, 5 Z), see :func:`marouting.observations.state_space`.

        Observations can define their own state; see :func:`marouting.observations.state_of`.
        """
        return self._game.state()

    def metrics(self) -> dict[str, int]:
        """The present overflow, wirelength, tasks joined, number of tasks, and steps."""
        return self._game.game.metrics()

    def solution(self) -> Solution:
        """The present routes."""
        return self._game.game.solution()

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
