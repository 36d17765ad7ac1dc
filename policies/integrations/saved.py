"""What is saved with a library's policy, so that it plays the game that it was trained in."""

import time
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from marouting.config import plain
from marouting.options import ORDERS, PLAYED, GameOptions, game_options


class Training:
    """Counts what a training takes.

    Attributes:
        options: those of its environment as plain data, with all defaults, but which problems are
            played.
        agent_steps: moves that agents made.
    """

    def __init__(self, options: Mapping[str, Any], *, everyone: bool = True) -> None:
        known = {field.name for field in fields(GameOptions)} - {"problem"}
        game = game_options({name: value for name, value in options.items() if name in known})
        order = game.turn_order or ORDERS["multi" if everyone else "single"]
        self.options: dict[str, Any] = {**plain(game), "turn_order": order}
        for name in (*PLAYED, "render_mode"):
            del self.options[name]
        self.agent_steps = 0
        self._began = time.process_time()

    def saved(self) -> dict[str, Any]:
        """What a policy's file holds beside the policy."""
        seconds = round(time.process_time() - self._began, 1)
        training = {"agent_steps": self.agent_steps, "processor_seconds": seconds}
        return {"options": self.options, "training": training}
