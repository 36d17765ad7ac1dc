"""The game: its state and rules, what agents see, and what moves pay."""

from marouting.registry import register

register("observation", "paper", "marouting.batch.observation:PaperObservation")
register("observation", "window", "marouting.batch.window:WindowObservation")
register("observation", "outlook", "marouting.batch.outlook:OutlookObservation")
register("reward", "paper", "marouting.batch.reward:PaperReward")
register("reward", "normalised", "marouting.batch.reward:NormalisedReward")
register("reward", "team", "marouting.batch.team_rewards:TeamReward")
register("reward", "difference", "marouting.batch.team_rewards:DifferenceReward")
register("reward", "potential", "marouting.batch.team_rewards:PotentialReward")
register("reward", "mixed", "marouting.batch.team_rewards:MixedReward")
