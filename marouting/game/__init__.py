"""The game: its state and rules, what agents see, and what moves pay."""

from marouting.registry import register

register("observation", "paper", "marouting.game.observation:PaperObservation")
register("observation", "window", "marouting.game.window:WindowObservation")
register("observation", "outlook", "marouting.game.outlook:OutlookObservation")
register("reward", "paper", "marouting.game.reward:PaperReward")
register("reward", "normalised", "marouting.game.reward:NormalisedReward")
register("reward", "team", "marouting.game.team_rewards:TeamReward")
register("reward", "difference", "marouting.game.team_rewards:DifferenceReward")
register("reward", "potential", "marouting.game.team_rewards:PotentialReward")
register("reward", "mixed", "marouting.game.team_rewards:MixedReward")
