"""What is saved with a library's policy, so that it plays the game that it was trained in."""

import os
import time
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import torch

from marouting.config import check, plain
from marouting.errors import InputError
from marouting.files import unusable
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
        self._continues = False

    def continues(self, before: Mapping[str, Any]) -> None:
        """Adds what an earlier training took, unless that has been told before."""
        if not self._continues:
            self._continues = True
            self.agent_steps += before.get("agent_steps", 0)
            self._began -= before.get("processor_seconds", 0.0)

    def saved(self) -> dict[str, Any]:
        """What a policy's file holds beside the policy."""
        seconds = round(time.process_time() - self._began, 1)
        training = {"agent_steps": self.agent_steps, "processor_seconds": seconds}
        return {"options": self.options, "training": training}


def load(file: str | os.PathLike[str], keys: set[str], what: str) -> dict[str, Any]:
    """What ``torch.save`` has written, by its keys. Loading it runs the code that it holds.

    Args:
        file: the file.
        keys: those that it has at least.
        what: what it is, in words, for errors.

    Raises:
        InputError: the file cannot be read, or is another one.
    """
    try:
        kept = torch.load(file, map_location="cpu", weights_only=False)
    except OSError as error:
        raise unusable(file, "cannot be read", error) from None
    except Exception as error:  # other files fail in the archive or in the unpickler
        raise another(file, what, error) from None
    check(str(file), isinstance(kept, dict) and keys <= kept.keys(), what)
    return dict(kept)


def another(file: str | os.PathLike[str], what: str, error: Exception) -> InputError:
    """The InputError for a file that a library could not load."""
    reason = ""
    if isinstance(error, ImportError | AttributeError):  # code that is gone
        reason = f": {(str(error).splitlines() or [type(error).__name__])[0][:120]}"
    return InputError(f"{os.fspath(file)}: expected {what}{reason}")
