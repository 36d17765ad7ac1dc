"""The faces of the environment: AEC, Parallel, Gymnasium; thin, the rules are in the engine."""
