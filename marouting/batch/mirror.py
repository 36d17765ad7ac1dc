"""A plain game mirrored in the batch, for observations that are kernels.

The observations ``window`` and ``outlook`` read the batch's arrays. Where an environment shows
them, its plain game (:mod:`marouting.game`) is copied into an engine of one problem before they
are read; of its sets only those that have changed since.
"""

import numpy as np

from marouting.batch.bits import put_numbers
from marouting.batch.engine import Engine
from marouting.batch.state import Option
from marouting.columns import Columns, Games
from marouting.game import Game

_SETS = {"tree": Option.TREE, "visited": Option.VISITED, "begun": Option.BEGUN}


def engine_of(games: Games) -> Engine:
    """The games as an engine, brought up to date if they are a plain game."""
    if isinstance(games, Engine):
        return games
    if not isinstance(games, Columns):
        raise TypeError(f"games: expected an Engine or Columns, found {type(games).__name__}")
    if games.mirror is None:
        games.mirror = _Mirror(games.game)
    games.mirror.update()
    engine: Engine = games.mirror.engine
    return engine


class _Mirror:
    """An engine that stands like a plain game."""

    def __init__(self, game: Game) -> None:
        self.game = game
        self.engine = Engine([game.problem], game.rules)
        options = self.engine.static.options
        self._options = {name: int(options[at]) for name, at in _SETS.items() if options[at] >= 0}
        # Sets that are in the engine, and how large they were then: sets only grow in their place.
        self._known: dict[tuple[str, int], tuple[set[int], int]] = {}

    def update(self) -> None:
        """Copies what has changed."""
        game, engine = self.game, self.engine
        agents, record = engine.agents[0], engine.games[0]
        for name in game.COLUMNS:
            agents[name] = np.frombuffer(getattr(game, name), np.int32)
        agents["task"] += engine.static.first[0, :-1]
        record["agent"], record["active"] = game.turn, len(game.active)
        record["asked"], record["round"], record["plain"] = game.asked, game.round, game.round
        record["joined"], record["steps"] = game.joined_tasks, game.moves
        record["overflow"], record["wirelength"] = game.overflow, game.wirelength
        engine.dynamic.remaining[0] = np.frombuffer(game.remaining, np.int32)
        history = int(engine.static.options[Option.HISTORY])
        if history >= 0:
            numbers = engine.dynamic.numbers[0, history : history + engine.grid.edges]
            numbers[:] = 0
            numbers[list(game.history)] = list(game.history.values())
        for n, used in enumerate(game.used):
            self._copy("used", n, used)
        for name in self._options:
            for n, own in enumerate(getattr(game, name)):
                self._copy(name, n, own)

    def _copy(self, name: str, n: int, own: set[int]) -> None:
        """Copies a set of agent n, unless it is known."""
        known, size = self._known.get((name, n), (None, 0))
        if own is known and len(own) == size:
            return
        self._known[name, n] = own, len(own)
        numbers, dynamic = np.fromiter(own, np.int64, len(own)), self.engine.dynamic
        rows, row = dynamic.used, n
        if name != "used":
            rows, row = dynamic.sets, self._options[name] + n
        rows[0, row] = 0
        put_numbers(rows, 0, np.full(len(own), row), numbers)
