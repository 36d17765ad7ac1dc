"""The game for many problems at once, compiled: state, rules, and observations that are kernels."""

from marouting.kernels import ANNOUNCED

ANNOUNCED[__name__] = ANNOUNCED["marouting.player"] = "the batch of games", 8
