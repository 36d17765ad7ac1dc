"""The game: its state, its rules, what agents see and get."""
