"""The interfaces of the environment: AEC, Parallel, Gymnasium. The rules are in the game."""
