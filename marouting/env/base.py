"""What the faces of the environment have in common: options in, a game to look at."""

import copy
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Box, Dict, MultiBinary
from gymnasium.utils import seeding
from numpy.typing import NDArray

from marouting.config import GameOptions, build
from marouting.game.engine import NOBODY, Engine, Status, TurnOrder
from marouting.game.observation import Observation, nets_on_edges, state, state_space, writer
from marouting.game.reward import Reward, payer
from marouting.generator import GeneratorOptions
from marouting.problem.grid import MOVES
from marouting.problem.net import MAX_NUMBER
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution
from marouting.render import Scene, Window, ansi, rgb_array
from marouting.source import Source, checked_source, load_problem
from marouting.vector import Arrays, Board

METADATA: dict[str, Any] = {
    "name": "global_routing_v0",
    "render_modes": ["ansi", "rgb_array", "human"],
    "render_fps": 10,
    "is_parallelizable": True,
}

# As types of arrays to be made: NumPy looks these up no more.
FLOAT32, INT8 = np.dtype(np.float32), np.dtype(np.int8)

_MOVES = range(MOVES)


class BaseGame:
    """A game of one problem with its observation, reward, masks, state and pictures.

    Args:
        problem: what to play.
        turn_order: the order if the options leave it open.
        options: the fields of :class:`marouting.config.GameOptions`; ``observation`` and
            ``reward`` may also be any object of their protocol.

    Raises:
        InputError: an option or a problem that cannot be used.
    """

    metadata = METADATA

    def __init__(self, problem: Source, turn_order: TurnOrder, options: Mapping[str, Any]) -> None:
        plain = dict(options)
        # Pieces of other classes are injected as they are; everything else goes by the schema.
        pieces = {
            name: plain.pop(name)
            for name in ("observation", "reward")
            if name in plain and not isinstance(plain[name], Mapping)
        }
        checked = build(GameOptions, plain)
        self._observation: Observation = pieces.get("observation", checked.observation)
        self._reward: Reward = pieces.get("reward", checked.reward)
        self._options = checked
        self._turn_order: TurnOrder = turn_order
        self.render_mode = checked.render_mode
        self.masked = checked.mask_in_observation
        self._window = Window()
        self._rng, _ = seeding.np_random(0)

        source = checked_source(problem)
        self._drawn: GeneratorOptions | None = None
        if isinstance(source, GeneratorOptions) and source.seed is None:
            self._drawn = source
            source = replace(source, seed=0)
        self._play(load_problem(source))
        problems, overflow = self.engine.problems, checked.overflow == "allowed"
        self._box = self._observation.space(problems, overflow)
        self._one = np.zeros(1, np.int32), np.empty((1, 1), np.int32)
        self._paid = np.empty(1, np.float32)
        self._row = 1, *self._box.shape
        self.state_space: Box = state_space(problems, overflow)

    def _play(self, problem: Problem) -> None:
        """Sets up the game of a problem."""
        self.engine = self._options.engine([problem], self._turn_order)
        self.names = [f"net_{net}" for net in self.engine.nets[0]]  # of the engine's agents
        self.everyone = [f"net_{net}" for net in range(len(problem.nets))]
        self._write = writer(self._observation, self.engine)
        self._pay = payer(self._reward, self.engine)

    def restart(self, seed: int | None) -> None:
        """A new episode; a new problem where one is to be drawn for every episode."""
        if seed is not None:
            self._rng, _ = seeding.np_random(seed)
        if self._drawn is not None:
            number = int(self._rng.integers(MAX_NUMBER))
            self._play(load_problem(replace(self._drawn, seed=number)))
        else:
            self.engine.reset()

    @property
    def problem(self) -> Problem:
        """The problem that is played."""
        return self.engine.problems[0]

    def new_observation_space(self) -> Space[Any]:
        """A space of its own for an agent, so that each can be seeded apart."""
        # The one copied has no random numbers yet. Making a new one takes ten times as long.
        box = copy.copy(self._box)
        if not self.masked:
            return box
        return Dict({"observation": box, "action_mask": MultiBinary(MOVES)})

    def board(self) -> Board:
        """The game to be played through arrays."""
        arrays = Arrays.of(*self.engine.nets.shape, *self._box.shape)
        return Board(self.engine, self._observation, self._reward, arrays)

    def masks(self) -> NDArray[np.int8]:
        """(N, 6) int8, fresh action masks of all agents."""
        return self.engine.masks(*self.engine.pairs(everyone=True))

    def observation(self, agent: int) -> Any:
        """A fresh observation of one agent in the form that the options ask for."""
        problems, agents = self._one
        agents[0, 0] = agent
        out = np.empty(self._row, FLOAT32)
        self._write(problems, agents, out)
        return self.seen(out[0], self.mask(agent)) if self.masked else out[0]

    def mask(self, agent: int) -> NDArray[np.int8]:
        """(6,) int8, a fresh action mask of one agent."""
        problems, agents = self._one
        agents[0, 0] = agent
        return self.engine.masks(problems, agents[0])[0]

    def seen(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> Any:
        """An observation and its mask in the form that the options ask for."""
        return {"observation": observation, "action_mask": mask} if self.masked else observation

    def reward(self, agent: int) -> float:
        """The reward of an agent's last move."""
        problems, agents = self._one
        agents[0, 0] = agent
        self._pay(problems, agents, self._paid)
        return self._paid.item()

    def info(self, mask: NDArray[np.int8], over: bool) -> dict[str, Any]:
        """An agent's info: its mask, and the metrics as they stand when its episode is over."""
        info: dict[str, Any] = {"action_mask": mask}
        if over:
            info["metrics"] = self.metrics()
        return info

    def metrics(self) -> dict[str, int]:
        """The figures of the problem as it stands; see :class:`marouting.game.engine.Metrics`."""
        return asdict(self.engine.metrics())

    def solution(self) -> Solution:
        """The routes as they stand."""
        return self.engine.solution()

    def state(self) -> NDArray[np.float32]:
        """(X, Y, 5 Z) float32, the global grid; see :func:`marouting.game.observation.state`."""
        return state(self.engine)[0]

    def scene(self) -> Scene:
        """What a picture of the game shows."""
        engine = self.engine
        agents, game = engine.agents[0], engine.games[0]
        active = np.flatnonzero(agents["status"] == Status.ACTIVE)
        turn = np.flatnonzero(active == game["agent"])
        now = engine.metrics()
        return Scene(
            grid=engine.grid,
            capacity=engine.static.capacity[0],
            remaining=engine.dynamic.remaining[0],
            used=nets_on_edges(engine),
            heads=agents["cell"][active],
            targets=agents["target"][active],
            labels=tuple(self.names[n] for n in active),
            turn=int(turn[0]) if game["agent"] != NOBODY and len(turn) else None,
            caption=f"step {now.steps}  joined {now.joined}/{now.tasks}  "
            f"overflow {now.overflow}  wirelength {now.wirelength}",
        )

    def picture(self) -> str | NDArray[np.uint8] | None:
        """Renders the game as ``render_mode`` says."""
        if self.render_mode is None:
            from gymnasium import logger

            logger.warn("render() without a render_mode: give one when making the environment.")
            return None
        if self.render_mode == "ansi":
            return ansi(self.scene())
        pixels = rgb_array(self.scene())
        if self.render_mode == "rgb_array":
            return pixels
        self._window.show(pixels, self.metadata["render_fps"])
        return None

    def close(self) -> None:
        """Closes the window of ``render_mode="human"``."""
        self._window.close()


def checked_move(action: Any, name: str = "action") -> int:
    """An action as a move's number; raises ValueError, with its name, for all but 0 to 5."""
    if action not in _MOVES:
        raise ValueError(f"{name}: expected 0 to {MOVES - 1}, found {action}")
    return int(action)


class GameMethods:
    """What every face shows besides its interface's own methods."""

    _game: BaseGame

    @property
    def engine(self) -> Engine:
        """The game, of one problem, to be read: for guides such as A* (:mod:`astar`)."""
        return self._game.engine

    def state(self) -> NDArray[np.float32]:
        """(X, Y, 5 Z) float32, the global grid; see :func:`marouting.game.observation.state`."""
        return self._game.state()

    def metrics(self) -> dict[str, int]:
        """Overflow, wirelength, tasks joined, tasks and steps of the episode as it stands."""
        return self._game.metrics()

    def solution(self) -> Solution:
        """The routes as they stand."""
        return self._game.solution()

    def render(self) -> Any:
        """A picture of the game as ``render_mode`` says."""
        return self._game.picture()

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._game.close()
