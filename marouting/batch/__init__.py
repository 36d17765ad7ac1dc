"""The game for many problems at once, compiled: state, rules, and observations that are kernels."""

COMPILES = "the batch of games", 8
