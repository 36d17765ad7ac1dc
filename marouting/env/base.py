"""What the environments have in common: a plain game with its observation, reward and masks."""

import copy
import operator
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium import Space, logger
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.utils import EzPickle, seeding
from numpy.typing import NDArray

from marouting.columns import Columns
from marouting.game import ACTIVE, NOBODY, Game, mask_table
from marouting.memory import PLAYED, STATE, TABLES, check_memory
from marouting.observations import (
    has_form,
    seen_by,
    space_of,
    state_of,
    state_space_of,
    write_rows,
)
from marouting.options import Agents, game_options
from marouting.problem.grid import Grid
from marouting.problem.solution import Solution
from marouting.render import Scene, Window, ansi, rgb_array, scene_of
from marouting.rewards import TeamPay, paid_by, payer_of
from marouting.source import OTHER_GAME, ProblemStream, Source

ONE_PLAYER = "false: one player moves all nets, so no agent can stay behind"
"""What interfaces with one player say to ``agents_persist``."""

METADATA: dict[str, Any] = {
    "name": "global_routing_v0",
    "render_modes": ["ansi", "rgb_array", "human"],
    "render_fps": 10,
}


class GameEnv(EzPickle):
    """A game of one problem with its components: what every environment has beyond its interface.

    A copy by :mod:`copy` or :mod:`pickle` goes on where the environment stands; only its spaces
    draw samples of their own. Components of your own that keep a state are only copied with it if
    they were given as objects.

    Attributes:
        game_class: the rules; a subclass of the environment may name its own
            :class:`marouting.game.Game`.
        game: the game, to be read.
        problem_name: the name of the problem that is played, of its file or in its set or scenario.
    """

    game_class: ClassVar[type[Game]] = Game
    render_mode: str | None
    _saved_names: ClassVar[tuple[str, ...]]
    """The attributes of an interface that change during an episode."""

    def _open(self, problem: Source, agents: Agents, options: Mapping[str, Any]) -> None:
        """Makes the game of an interface with one agent or many."""
        checked = game_options(options, agents)
        self._rules = checked.rules
        self._observation = checked.observation.make()
        self._sees_plainly = has_form(self._observation, "see", "write")
        self._reward: Any = checked.reward.make()
        self._pays_mover = has_form(self._reward, "pay", "__call__", "prices")
        if self._pays_mover:
            self._pay_mover = payer_of(self._reward)
        self._team_pay = TeamPay.of(self._reward)
        self.render_mode = checked.render_mode
        self._masked = checked.mask.in_observation
        self._mask_key, self._observation_key = checked.mask.mask_key, checked.mask.observation_key
        self._persists = checked.persists and agents == "multi"
        self._actions = checked.actions
        self._no_op = np.eye(1, self._actions, dtype=np.int8)[0]  # of agents that are done and stay
        self._table = mask_table(checked.moves, checked.messages)
        self._masks = list(self._table)  # a list's rows are found faster
        self._begun = False
        self._window = Window()
        self._rng, _ = seeding.np_random()  # draws the problems of episodes

        self._stream = ProblemStream(problem, checked.scenario, checked.split)
        problems = self._stream.bounds
        grid = Grid.of(problems[0].grid)
        check_memory(
            grid.gcells * (TABLES + PLAYED + STATE), "an environment on a grid of {}", grid
        )
        self._everyone = [f"net_{net}" for net in self._stream.nets]
        name, first = next(iter(self._stream.problems.items()))
        self._play(name, self.game_class(first, self._rules))
        overflow = self.game.overflow_allowed
        self._box: Box = space_of(self._observation, problems, overflow)
        if self._sees_plainly:
            self._see_one = seen_by(self._observation, self._box.shape)
        self.state_space: Box = state_space_of(self._observation, problems, overflow)

    def _play(self, name: str, game: Game) -> None:
        """Takes up the game of a problem."""
        self.problem_name, self.game, self._columns = name, game, Columns(game)
        self._names = [f"net_{net}" for net in game.nets]
        self._agent_of = {agent: n for n, agent in enumerate(self._names)}
        self._figures = self._columns.figures()

    def _restart(self, seed: int | None) -> None:
        """Starts a new episode, of another problem if there are several."""
        if seed is not None:
            self._rng, _ = seeding.np_random(seed)
        name, problem = self._stream.next(self._rng)
        if problem is not self.game.problem:
            self._play(name, self.game_class(problem, self._rules))
        else:
            self.game.reset()
        self._figures = self._columns.figures()
        self._begun = True

    def _check_begun(self) -> None:
        """Raises ResetNeeded before the first episode."""
        if not self._begun:
            raise ResetNeeded("expected a call of reset() before anything else")

    # --- copies -----------------------------------------------------------------------------------

    def save(self) -> dict[str, Any]:
        """A copy of the state of the environment, for :meth:`restore`."""
        names = ("problem_name", "_figures", "_rng", "_begun", *self._saved_names)
        rest = {name: vars(self)[name] for name in names if name in vars(self)}
        kind = type(self).__name__
        fixed = {"interface": kind, "persists": self._persists}
        return {**fixed, "game": self.game.copy(), **copy.deepcopy(rest)}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Puts the environment back into a saved state.

        Wrappers do not know of it: call their ``reset`` once before.

        Args:
            saved: returned by :meth:`save` of this environment, or of one with the same problem and
                options.

        Raises:
            ValueError: it is the state of another game.
        """
        rest, problem = dict(saved) if isinstance(saved, Mapping) else {}, self.game.problem
        game: Any = rest.pop("game", None)
        fixed = rest.pop("interface", None), rest.pop("persists", None)
        same = fixed == (type(self).__name__, self._persists)
        if not (same and type(game) is self.game_class and game.rules == self._rules):
            raise ValueError(OTHER_GAME)
        known = self._stream.problems.values()
        if not (game.problem in known or (self._stream.endless and game.grid == self.game.grid)):
            raise ValueError(OTHER_GAME)
        self._play(rest["problem_name"], game.copy())
        if not self._stream.many:  # the next episode begins with this one, not with an equal one
            self.game.problem = problem
            self._columns.problems = (problem,)
        vars(self).update(copy.deepcopy(rest))

    def __getstate__(self) -> dict[str, Any]:
        """What made the environment, and where it stands."""
        return {**super().__getstate__(), "saved": self.save()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes the environment anew and puts it where the copied one stands."""
        super().__setstate__(state)
        self.restore(state["saved"])

    # --- what agents see --------------------------------------------------------------------------

    def _new_space(self) -> Space[Any]:
        """An observation space of its own for each agent, so that each can be seeded separately."""
        # The copied space has no random numbers yet. Making a new one takes ten times as long.
        box = copy.copy(self._box)
        if not self._masked:
            return box
        mask = Box(0, 1, (self._actions,), np.int8)
        return Dict({self._observation_key: box, self._mask_key: mask})

    def _see(self, agent: int) -> NDArray[np.float32]:
        """A new observation of one agent; zeros for NOBODY."""
        if agent == NOBODY:
            return np.zeros(self._box.shape, np.float32)
        if self._sees_plainly:
            return self._see_one(self.game, agent)
        return self._see_all([agent])[0]

    def _see_all(self, agents: Sequence[int]) -> NDArray[np.float32]:
        """(K, *S) new observations of many agents, or NOBODY."""
        if not has_form(self._observation, "write", "see"):
            return np.array([self._see(agent) for agent in agents], np.float32)
        out = np.zeros((len(agents), *self._box.shape), np.float32)
        rows = np.zeros(len(agents), np.int32), np.array(agents, np.int32)
        write_rows(self._observation, self._columns, *rows, out)
        return out

    def _shown(self, agent: int) -> Any:
        """A new observation of one agent, in the form that the options ask for."""
        plainly = self._sees_plainly and agent != NOBODY  # as in _see, without another call
        seen = self._see_one(self.game, agent) if plainly else self._see(agent)
        return self._with_mask(seen, self._mask(agent)) if self._masked else seen

    def _with_mask(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> Any:
        """An observation with its mask, in the form that the options ask for."""
        if self._masked:
            return {self._observation_key: observation, self._mask_key: mask.copy()}
        return observation

    def _is_active(self, agent: int) -> bool:
        """Whether an agent still has a task to route."""
        return agent != NOBODY and self.game.status[agent] == ACTIVE

    def _mask(self, agent: int) -> NDArray[np.int8]:
        """(A,) int8, a new action mask of one agent; that of NOBODY is all ones."""
        if self._persists and not self._is_active(agent):
            return self._no_op.copy()
        return self._masks[0 if agent == NOBODY else self.game.free_moves(agent)].copy()

    def _mask_all(self, agents: Sequence[int]) -> NDArray[np.int8]:
        """(K, A) int8, new action masks of many agents."""
        free_moves = self.game.free_moves
        out = self._table[[0 if n == NOBODY else free_moves(n) for n in agents]]
        if self._persists:
            out[[not self._is_active(n) for n in agents]] = self._no_op
        return out

    # --- moves ------------------------------------------------------------------------------------

    def _move(self, n: int, action: int) -> Any:
        """An agent moves: what that pays it if ``_pays_mover``, or else (N,) float32 for all."""
        if self._pays_mover:
            self.game.move(n, action)
            return self._pay_mover(self.game, n)
        then, team = self._figures, self._team_pay
        before = self._columns.before(then) if team is None else None
        self.game.move(n, action)
        self._figures = self._columns.figures()
        if team is not None:
            return team(self.game, n, then, self._figures)
        assert before is not None
        return paid_by(self._reward, self._columns, before, np.array([n], np.int32))[0]

    def _task_end(self, n: int) -> dict[str, Any]:
        """What the info after a move says of the task that has ended with it; empty if none has.

        The agent still stands where it arrived.
        """
        ending = self.game.ending[n]
        if not ending:
            return {}
        mask = self._masks[self.game.free_moves(n)].copy()
        seen = self._with_mask(self._see(n), mask)
        return {"task_ended": ending, "task_obs": seen, "task_mask": mask}

    # --- methods beyond those of PettingZoo and Gymnasium -----------------------------------------

    def action_mask(self, agent: str) -> NDArray[np.int8]:
        """(A,) int8, 1 for the moves of a net that cross an edge now; never all zero.

        Raises:
            KeyError: there is no such net.
        """
        if agent not in self._everyone:
            raise KeyError(agent)
        return self._mask(self._agent_of.get(agent, NOBODY))

    @property
    def idle_nets(self) -> list[str]:
        """The names of the problem's nets with all pins in one Gcell: nothing to route, no agents.

        Solutions and metrics count them as joined.
        """
        nets = (f"net_{net}" for net in range(len(self.game.problem.nets)))
        return [net for net in nets if net not in self._agent_of]

    def state(self) -> NDArray[np.float32]:
        """The global state, float32: (X, Y, 5 Z), see :func:`marouting.observations.state_space`.

        Observations can define their own state; see :func:`marouting.observations.state_of`.
        """
        return state_of(self._observation, self._columns)[0]

    def metrics(self) -> dict[str, int]:
        """The present overflow, wirelength, tasks joined, number of tasks, and steps."""
        return self.game.metrics()

    def solution(self) -> Solution:
        """The present routes."""
        return self.game.solution()

    def scene(self) -> Scene:
        """The present moment, as :meth:`render` draws it and animations show it."""
        return scene_of(self._columns)

    def render(self) -> Any:
        """Renders the game according to ``render_mode``."""
        if self.render_mode is None:
            logger.warn("render() needs a render_mode: give one when you make the environment.")
            return None
        scene = self.scene()
        if self.render_mode == "ansi":
            return ansi(scene)
        pixels = rgb_array(scene)
        if self.render_mode == "rgb_array":
            return pixels
        self._window.show(pixels, METADATA["render_fps"])
        return None

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._window.close()


def result_of(metrics: dict[str, int]) -> dict[str, Any]:
    """What infos hold when the game is over: the metrics, also where loggers look for them.

    ``open`` is the number of two-pin tasks that are not joined.
    """
    still_open = metrics["tasks"] - metrics["joined"]
    success = still_open == 0 == metrics["overflow"]
    return {"metrics": metrics, **metrics, "open": still_open, "is_success": success}


def checked_move(action: Any, actions: int, name: str = "action") -> int:
    """An integer of any type as an int; raises ValueError, naming it, for all but an action."""
    try:
        move = operator.index(action)
    except TypeError:
        move = actions
    if not 0 <= move < actions:
        raise ValueError(f"{name}: expected 0 to {actions - 1}, found {action}")
    return move


class NetEnv(GameEnv):
    """What the environments in which every net is an agent have in common."""

    def _open(self, problem: Source, agents: Agents, options: Mapping[str, Any]) -> None:
        """Makes the game, and sets up the attributes that PettingZoo asks for."""
        super()._open(problem, agents, options)
        self.possible_agents = list(self._everyone)
        self.observation_spaces = {agent: self._new_space() for agent in self.possible_agents}
        self.action_spaces = {agent: Discrete(self._actions) for agent in self.possible_agents}
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
        return self._rng
