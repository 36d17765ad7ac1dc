"""The game: its state and rules, what agents see, and what moves pay."""

from marouting.registry import register

register("observation", "paper", "marouting.game.observation:PaperObservation")
register("reward", "paper", "marouting.game.reward:PaperReward")
