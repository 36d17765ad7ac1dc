"""Games as observations and rewards see them: by columns, with the problem as the first axis.

Components are written once and work everywhere: in the batch, whose games are such columns
(:class:`marouting.batch.engine.Engine`), and in the environments, where one plain game is shown as
columns of a single problem (:class:`Columns`).

There are M problems on one grid, with N agents each; problems with fewer agents are padded, and
``nets`` is NOBODY (−1) there. Everything is to be read only.
"""

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marouting.game import ACTIVE, NOBODY, Game
from marouting.problem.grid import AXES, Grid
from marouting.problem.problem import Problem
from marouting.problem.solution import Solution


class Games(Protocol):
    """What observations and rewards can see of games.

    Attributes:
        problems: the M problems.
        grid: their grid, with ``grid.position`` (G, 3) and other tables.
        nets: (M, N) the net of every agent, or NOBODY.
        tasks: (M, N) how many two-pin tasks every agent has.
        order: (M, N) the agents in turn order, then NOBODY.
        agents: columns (M, N) by name: ``agents["cell"]`` and the other columns of
            :class:`marouting.game.Game`. Some are not alike everywhere: in the batch, ``task``
            is a row of all problems' tasks, in the plain game one of the net's own (``joined`` is
            alike); ``crossing``, ``ending`` and ``added_overflow`` are those of the last move, or 0
            if the agent did not move in this step. So read these only of agents that moved, as
            rewards get them in ``movers``.
        games: figures (M,) by name: ``agent`` to move, agents ``active``, ``joined`` tasks,
            ``overflow``, ``wirelength``, ``steps`` made, ``round`` and ``asked``.
        remaining: (M, E) what is left of the capacity of every edge.
        max_steps: steps after which a task fails.
        overflow_allowed: whether moves cross full edges.
    """

    @property
    def problems(self) -> Sequence[Problem]: ...  # noqa: D102
    @property
    def grid(self) -> Grid: ...  # noqa: D102
    @property
    def nets(self) -> NDArray[np.int32]: ...  # noqa: D102
    @property
    def tasks(self) -> NDArray[np.int32]: ...  # noqa: D102
    @property
    def order(self) -> NDArray[np.int32]: ...  # noqa: D102
    @property
    def agents(self) -> Any: ...  # noqa: D102
    @property
    def games(self) -> Any: ...  # noqa: D102
    @property
    def remaining(self) -> NDArray[np.int32]: ...  # noqa: D102
    @property
    def max_steps(self) -> int: ...  # noqa: D102
    @property
    def overflow_allowed(self) -> bool: ...  # noqa: D102

    def uses(
        self, problems: NDArray[np.integer], agents: NDArray[np.integer], edges: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """(K,) whether agents (K,) of problems (K,) use edges (K,); no agent may be NOBODY."""
        ...

    def solution(self, m: int = 0) -> Solution:
        """The routes of a problem at this moment."""
        ...

    def state(self, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """(M, X, Y, 5 Z) the global states; see :func:`marouting.observations.state_space`."""
        ...


class Before(Protocol):
    """What rewards can see of the games before a move: ``agents``, ``games`` and ``remaining``.

    ``games`` holds the figures at the end of the last move: where nets have been ripped up since,
    the move is paid for it, and rewards add up.
    """

    @property
    def agents(self) -> Any: ...  # noqa: D102
    @property
    def games(self) -> Any: ...  # noqa: D102
    @property
    def remaining(self) -> NDArray[np.int32]: ...  # noqa: D102


FIGURES: dict[str, Callable[[Game], int]] = {
    "agent": lambda game: game.turn,
    "active": lambda game: game.status.count(ACTIVE),
    "joined": lambda game: game.joined_tasks,
    "overflow": lambda game: game.overflow,
    "wirelength": lambda game: game.wirelength,
    "steps": lambda game: game.moves,
    "round": lambda game: game.round,
    "asked": lambda game: game.asked,
}
"""The figures of a plain game."""


class _Agents(dict[str, NDArray[np.int32]]):
    """Columns by name."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(1, N)."""
        return self["cell"].shape


class _Figures:
    """The figures of a game by name, as they are when they are asked for."""

    def __init__(self, game: Game) -> None:
        self._game = game

    def __getitem__(self, name: str) -> NDArray[Any]:
        return np.array([FIGURES[name](self._game)])


class Columns:
    """A plain game as a batch of one problem: views of its columns; see :class:`Games`."""

    def __init__(self, game: Game) -> None:
        self.game, self.grid, self.problems = game, game.grid, (game.problem,)
        self.nets = np.array([game.nets], np.int32)
        self.tasks = np.array([list(map(len, game.tasks))], np.int32)
        self.order = np.array([game.order], np.int32)
        self.agents = _Agents(
            {name: np.frombuffer(getattr(game, name), np.int32)[None] for name in game.COLUMNS}
        )
        self.games: Any = _Figures(game)
        self.remaining = np.frombuffer(game.remaining, np.int32)[None]
        self.max_steps, self.overflow_allowed = game.max_steps, game.overflow_allowed
        self.static = SimpleNamespace(position=game.grid.position)  # as it was called before 0.3
        self.mirror: Any = None  # of the game in the batch, see marouting.batch.mirror

    def uses(
        self, problems: NDArray[np.integer], agents: NDArray[np.integer], edges: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """See :class:`Games`."""
        del problems
        used = self.game.used
        pairs = zip(agents.tolist(), edges.tolist(), strict=True)
        return np.array([edge in used[n] for n, edge in pairs], np.bool_)

    def solution(self, m: int = 0) -> Solution:
        """The routes at this moment."""
        del m
        return self.game.solution()

    def state(self, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """(1, X, Y, 5 Z); see :func:`marouting.observations.state_space`."""
        game, via = self.game, AXES - 1
        state = np.zeros((self.grid.gcells, AXES + 2), np.float32)
        state[:, :via] = self.remaining.reshape(-1, AXES)[:, :via]
        vias = [edge // AXES for used in game.used for edge in used if edge % AXES == via]
        np.add.at(state[:, via], vias, 1)
        routing = [n for n in game.active if game.status[n] == ACTIVE]  # until the round is over
        np.add.at(state[:, AXES], [game.cell[n] for n in routing], 1)
        np.add.at(state[:, AXES + 1], [game.target[n] for n in routing], 1)
        whole = state.reshape(1, *self.grid.shape[:2], -1)
        if out is None:
            return whole
        out[...] = whole
        return out

    def before(self, figures: Mapping[str, int]) -> Before:
        """A copy for rewards, made before a move; the figures are of the end of the last one."""
        agents = _Agents({name: column.copy() for name, column in self.agents.items()})
        now = {name: self.games[name] for name in FIGURES}
        games = {**now, **{name: np.array([figure]) for name, figure in figures.items()}}
        return SimpleNamespace(agents=agents, games=games, remaining=self.remaining.copy())

    def figures(self) -> dict[str, int]:
        """What ``before`` is to show after this move."""
        return {name: FIGURES[name](self.game) for name in ("joined", "overflow", "wirelength")}


def check_rows(
    games: Games,
    problems: NDArray[np.integer],
    agents: NDArray[np.integer],
    out: NDArray[Any],
    width: int,
) -> None:
    """Raises ValueError unless there are K such agents, and ``out`` has a row for each of them."""
    check_shapes(problems, agents, out, width)
    m, n = games.nets.shape
    there = (problems >= 0) & (problems < m) & (agents >= NOBODY) & (agents < n)
    if not there.all():
        raise ValueError(f"expected agents of the games, found {problems}, {agents}")


def as_int32(*arrays: NDArray[np.integer]) -> tuple[NDArray[np.int32], ...]:
    """The arrays as contiguous int32: a kernel is compiled once more for every other type.

    Raises:
        ValueError: a number does not fit.
    """
    found = tuple(np.ascontiguousarray(array, np.int32) for array in arrays)
    for array, whole in zip(arrays, found, strict=True):
        if array.dtype != np.int32 and (array != whole).any():
            raise ValueError(f"expected numbers of 32 bits, found {array}")
    return found


def check_shapes(
    problems: NDArray[np.integer], agents: NDArray[np.integer], out: NDArray[Any], width: int
) -> None:
    """:func:`check_rows` for kernels that look at every agent's number themselves."""
    whole = problems.dtype.kind in "iu" and agents.dtype.kind in "iu"
    if not whole or len(problems) != len(agents) or out.shape != (len(agents), width):
        raise ValueError(
            f"expected integers for {len(out)} rows of {width}, found {problems}, {agents}"
        )
